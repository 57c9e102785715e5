# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""From samples to inputs: excite until the data describe the plant, then control it. The controller node wraps it."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .controller import DeepcController
from .disturbances import DisturbanceRecord
from .excitation import Excitation, Signal
from .modes import Mode, Safety, refusal
from .reference import ReferenceSchedule
from .result import Status, StepResult
from .settings import DeepcSettings
from .watch import Bounds, Watch

Array = NDArray[np.float64]
Leave = Literal["safe", "hold"]

_EXCITATION_STREAM = 1  # the plant's own randomness is stream 0 of the same seed
_KEPT = 1000  # commanded inputs that are remembered: how long a plant may hold one and still be understood


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """What was decided when outputs k arrived.

    Attributes:
        k: index of the newest outputs used.
        u: the next undecided input, u(k+s), shape (m,); None when none is to be published.
        mode: what the controller is doing.
        reason: one line on why.
        reference: reference that holds at k, shape (p,), or None.
        result: the optimisation behind u, or None.
    """

    k: int
    u: Array | None
    mode: Mode
    reason: str
    reference: Array | None
    result: StepResult | None


class Agent:
    """The decisions of one run (one epoch), sample by sample.

    Args:
        m: number of inputs.
        p: number of outputs.
        settings: of the controller; ``u_min`` and ``u_max`` must be finite, they bound the excitation.
        seed: of the excitation.
        safety: when to give up, and what to do then.
        bounds: what a healthy loop keeps to; beyond them it falls back.
        excitation: signal while collecting.
        amplitude: share of the input range that it uses, in (0, 1].
        preview: whether the plan follows references that are known to come; otherwise it takes the next one to stay.

    Raises:
        ValueError: if the settings cannot work (the message says what would).
    """

    def __init__(
        self,
        m: int,
        p: int,
        settings: DeepcSettings,
        seed: int,
        safety: Safety | None = None,
        *,
        bounds: Bounds | None = None,
        excitation: Signal = "uniform",
        amplitude: float = 1.0,
        preview: bool = False,
    ) -> None:
        self.controller = DeepcController(m, p, settings)
        self.references = ReferenceSchedule(p)
        self.disturbances = DisturbanceRecord(settings.disturbances)
        """Measured disturbances and their forecasts: those of sample k must be set before `step(k)`."""
        self.safety = safety or Safety()
        self.mode = Mode.COLLECTING
        self.failures = 0
        """Samples in control without a solved optimisation."""
        self.lost = 0
        """Samples that never came, or whose input or measured disturbance is not known."""
        low, high, du, self._safe = (
            np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), (m,)))
            for value in (settings.u_min, settings.u_max, settings.du_max, settings.u_safe)
        )
        if not (np.isfinite(low).all() and np.isfinite(high).all()):
            raise ValueError("excitation needs finite input limits: give u_min and u_max")
        self._safe = np.minimum(np.maximum(self._safe, low), high)
        rng = np.random.Generator(np.random.PCG64([seed, _EXCITATION_STREAM]))
        self._excitation = Excitation(excitation, low, high, rng, du_max=du, amplitude=amplitude)
        self._watch = Watch(p, bounds or Bounds())
        self._preview = preview
        self._modes: dict[int, tuple[complex, ...]] = {}  # reported as out of the inputs' reach, by sample
        self._predicted: tuple[int, Array] | None = None  # the sample it is for, and the outputs
        self._commands: dict[int, Array] = {}
        self._acted: dict[int, Array] = {}  # inputs that did act, by the plant's own word: a late command acts later
        self._next: int | None = None  # outputs expected next
        self._aligned = False  # the controller knows the inputs that follow its last sample
        self._rich = False  # the data have sufficed before
        self._in_a_row = 0  # optimisations that failed, the last ones
        self._held = 0  # samples in HOLDING, the last ones
        self._why = ""  # of a latched fallback
        self._ramp: tuple[Array, int] | None = None  # input at the start of the fallback, samples since

    @property
    def settings(self) -> DeepcSettings:
        """The controller's settings."""
        return self.controller.settings

    def start(self) -> list[Array]:
        """The inputs u(0), ..., u(s-1) that must be known before outputs 0 can exist; each (m,)."""
        return [self._command(k, self._excite()) for k in range(self.settings.s)]

    def step(self, k: int, y: ArrayLike, held: int = 0) -> Decision:
        """Takes outputs k and decides u(k+s).

        Args:
            k: index of the outputs, above that of the last ones. A sample whose measured disturbances nobody has told
                counts as lost.
            y: outputs, shape (p,).
            held: the plant used the input commanded ``held`` samples earlier for u(k+s-1), the newest that y(k) sees.
        """
        self._take(k, y, held)
        self._next = k + 1
        self.references.forget(k)
        result = None
        target = self._target(k)
        trouble = self._trouble(k, y)
        if self.mode is Mode.FALLBACK:
            reason = self._why
        elif trouble:
            reason = self._fall_back(trouble)
        elif lacking := self.controller.missing():
            reason = self._wait(lacking)
        elif target is None:
            reason = "the data suffice, but no reference was given"
        else:
            self._heed_modes(k)
            result = self.controller.step(target, self._forecast(k))
            reason = self._judge(result)
            self._predicted = (k + 1, result.y_plan[0])
        u = self._choose(k, result)
        return Decision(k=k, u=u, mode=self.mode, reason=reason, reference=self.references.at(k), result=result)

    def overdue(self, k: int) -> Decision:
        """Outputs k have not come in time: decides u(k+s) without them, unless that was decided before.

        They may still come. No input that was once given is changed afterwards, so what acts stays known.

        Args:
            k: index of the outputs that are missed, above that of the last ones.
        """
        missing = 0 if self._next is None else k + 1 - self._next
        reason = f"no outputs for {missing} samples"
        if self.mode is Mode.CONTROLLING:
            self.mode, self._held = Mode.HOLDING, 0
        if self.mode is Mode.HOLDING and missing > self.safety.max_gap:
            self._fall_back(f"{reason}, more than {self.safety.max_gap} are not bridged")
        if self.mode is Mode.FALLBACK:
            reason = self._why
        u = self._choose(k, None, blind=True)
        return Decision(k=k, u=u, mode=self.mode, reason=reason, reference=self.references.at(k), result=None)

    def leave(self, policy: Leave) -> tuple[int, Array] | None:
        """The last input before the controller is stopped, with its index; None if none is to be given.

        Args:
            policy: "safe" gives the safe input, "hold" leaves the plant to the last one.
        """
        released = self.mode is Mode.FALLBACK and self.safety.fallback == "release"
        if policy == "hold" or not self._commands or self.mode is Mode.SHADOW or released:
            return None
        k = max(self._commands) + 1
        return k, self._command(k, self._safe)

    def cut(self) -> None:
        """The next sample does not follow the last one: no column of the data spans the two."""
        self.controller.cut()
        self._aligned = False

    def overhear(self, k: int, u: ArrayLike) -> None:
        """Somebody else commanded input k, shape (m,); in SHADOW these are the inputs that act."""
        self._command(k, np.array(u, dtype=np.float64))

    def blame(self, k: int, modes: Iterable[complex]) -> None:
        """Modes that the inputs do not reach, as a monitor reports them: from outputs k on, until it reports others.

        Outputs that cannot be held for that (`controller.unholdable`) are then not chased; ``controller.mask`` shows
        it. No modes: all outputs count again as the settings say.
        """
        self._modes[k] = tuple(complex(mode) for mode in modes)

    def tune(self, **changes: object) -> None:
        """Changes settings of the controller that need no new data, from the next sample on.

        Raises:
            ValueError: if one cannot change while running, or does not fit; nothing is then changed.
        """
        self.controller.tune(**changes)

    def prepare(self) -> None:
        """Does the work of the next step that does not need its sample; call it once the command is out."""
        self.controller.prepare()

    def request(self, wanted: int) -> str:
        """An operator asks for a mode; see `modes.REQUESTS`.

        Returns:
            Why not, in one line; empty if the mode is taken.
        """
        if why := refusal(self.mode, wanted):
            return why
        mode = Mode(wanted)
        if mode is Mode.FALLBACK:
            self._fall_back("an operator asked for it")
            return ""
        if mode is Mode.COLLECTING:
            self.controller.reset()
            self._watch.reset()
            self._modes.clear()
            self._next, self._aligned, self._rich = None, False, False
        lacking = self.controller.missing() if mode is Mode.CONTROLLING else ""
        if lacking and not self._rich:
            return f"not ready to control: {lacking}"
        self.mode = Mode.HOLDING if lacking else mode
        self._in_a_row, self._held, self._why, self._ramp = 0, 0, "", None
        self._watch.clear()
        return ""

    # Inside

    def _target(self, k: int) -> Array | None:
        """The reference after outputs k: of the next sample, or with a preview of each sample of the plan, (L, p)."""
        if not self._preview:
            return self.references.at(k + 1)
        path = [self.references.at(j) for j in range(k + 1, k + 1 + self.settings.L)]
        return None if path[0] is None else np.array(path)

    def _forecast(self, k: int) -> Array | None:
        """The disturbances over the plan, if the settings have any."""
        settings = self.settings
        if not settings.disturbances:
            return None
        return self.disturbances.forecast(k + 1, settings.L + settings.s - 1)

    def _heed_modes(self, k: int) -> None:
        """Drops the outputs that the modes reported for this sample make impossible to hold."""
        due = [start for start in self._modes if start <= k]
        if due:
            self.controller.drop(self.controller.unholdable(self._modes[max(due)]))
            for start in due:
                del self._modes[start]

    def _take(self, k: int, y: ArrayLike, held: int) -> None:
        """Gives the sample to the controller; where anything is missing, a new record begins."""
        s = self.settings.s
        newest = k + s - 1
        acted = self._commands.get(newest - held)
        if acted is not None:
            self._acted[newest] = acted
        if k == 0 and held == 0:  # nothing earlier could be held
            self._acted |= {j: self._commands[j] for j in range(newest) if j in self._commands}
        gap = 0 if self._next is None else k - self._next
        d = self.disturbances.at(k) if self.settings.disturbances else None
        known = all(j in self._acted for j in range(k, newest + 1))
        known &= d is not None or not self.settings.disturbances
        if gap or not known:
            self.lost += gap + (not known)
            self.cut()
            if gap > self.safety.max_gap and self.mode in (Mode.CONTROLLING, Mode.HOLDING):
                self._fall_back(f"{gap} samples were lost at once, more than {self.safety.max_gap} are not bridged")
        if known:
            for j in [newest] if self._aligned else range(k, newest + 1):
                self.controller.commit(self._acted[j])
            self.controller.observe(self._acted[k], y, d)
            self._aligned = True
        self._acted = {j: u for j, u in self._acted.items() if j >= k}

    def _trouble(self, k: int, y: ArrayLike) -> str:
        """What is wrong with the outputs while the controller is responsible for them; empty if nothing."""
        if self.mode is Mode.COLLECTING:
            self._watch.learn(y)
        if self.mode not in (Mode.CONTROLLING, Mode.HOLDING):
            return ""
        expected = self._predicted[1] if self._predicted is not None and self._predicted[0] == k else None
        return self._watch.look(y, expected)

    def _wait(self, lacking: str) -> str:
        """What was in control holds until the past is known again, but not for ever."""
        if self.mode is Mode.CONTROLLING:
            self.mode, self._held = Mode.HOLDING, 0
        if self.mode is not Mode.HOLDING:
            return lacking
        self._held += 1
        if self._held > self.safety.max_hold:
            return self._fall_back(f"held for {self._held} samples, still {lacking}")
        return lacking

    def _judge(self, result: StepResult) -> str:
        """Counts failures, and moves into control or out of it."""
        failed = result.status in (Status.SHIFTED_PLAN, Status.FALLBACK)
        self.failures += failed
        self._in_a_row = self._in_a_row + 1 if failed else 0
        if self._in_a_row > self.safety.max_failures:
            return self._fall_back(f"{self._in_a_row} optimisations in a row were not solved: {result.reason}")
        self._rich = True
        if self.mode is not Mode.SHADOW:
            self.mode = Mode.CONTROLLING
        return result.reason

    def _fall_back(self, why: str) -> str:
        self.mode, self._why, self._ramp = Mode.FALLBACK, why, None
        return why

    def _choose(self, k: int, result: StepResult | None, *, blind: bool = False) -> Array | None:
        """The input u(k+s) for the mode the sample ended in; without its outputs (blind) nobody excites."""
        ahead = k + self.settings.s
        if self.mode is Mode.SHADOW or (self.mode is Mode.FALLBACK and self.safety.fallback == "release"):
            return None
        if ahead in self._commands:
            return None  # decided while outputs were overdue
        last = self._commands[max(self._commands)] if blind and self._commands else self._in_force(ahead - 1)
        if self.mode is Mode.FALLBACK:
            return self._command(ahead, self._retreat(self._safe if last is None else last))
        if self.mode is Mode.CONTROLLING and result is not None:
            return self._command(ahead, result.u)
        if (blind or self.mode is Mode.HOLDING) and last is not None:
            return self._command(ahead, last)
        return self._command(ahead, self._excite())

    def _in_force(self, k: int) -> Array | None:
        """What acts at k; where the plant has not told, what was commanded."""
        return self._acted.get(k, self._commands.get(k))

    def _retreat(self, last: Array) -> Array:
        """The fallback's next input: the last one again, or a step of the ramp to the safe one."""
        if self.safety.fallback == "hold":
            return last
        begin, done = self._ramp or (last, 0)
        self._ramp = (begin, min(done + 1, self.safety.ramp))
        return begin + (self._safe - begin) * (self._ramp[1] / self.safety.ramp)

    def _command(self, k: int, u: Array) -> Array:
        self._commands[k] = u
        if len(self._commands) > 2 * _KEPT:
            self._commands = {j: v for j, v in self._commands.items() if j > k - _KEPT}
        return u

    def _excite(self) -> Array:
        return self._excitation.next()
