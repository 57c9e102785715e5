# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the controller: checked together, immutable."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal, get_args

import numpy as np

from ros2_deepc.behavior.hankel import Array

Numbers = float | Sequence[float] | Array
Weight = float | Sequence[float] | Sequence[Sequence[float]] | Array
Terminal = Literal["none", "equilibrium", "hard", "soft"]
Solver = Literal["osqp", "daqp"]
Fallback = Literal["hold", "safe"]
DataPolicy = Literal["fixed", "sliding", "guarded"]
Form = Literal["absolute", "incremental"]
Regression = Literal["joint", "causal"]
Cut = Literal["order", "gap", "noise", "none"]
NoiseBlock = Literal["off", "ridge", "free"]

# Settings that may change while running: they need no other data.
LIVE = frozenset(
    {
        "Q",
        "R",
        "u_min",
        "u_max",
        "du_max",
        "y_min",
        "y_max",
        "terminal",
        "terminal_steps",
        "terminal_weight",
        "offset_weight",
        "mask",
        "slack_weight",
        "solver",
        "guard",
        "dither",
        "fallback",
        "u_safe",
    }
)


@dataclass(frozen=True, slots=True, kw_only=True)
class DeepcSettings:
    """Settings of a `DeepcController`; numbers per channel may be given once for all channels.

    Attributes:
        N: past samples that fix the initial condition, at least the plant's lag; the paper asks N >= q + s - 1.
        L: prediction horizon [samples].
        T: inputs in the data window; 0 takes the least number for which Corollary 1 can hold.
        s: nilpotency index of the plant, 1 if its outputs depend on no future input.
        q: order of the slow part (degree of det(zE - A)) or an upper bound; 0 if unknown, then N - s + 1 bounds it.
        Q: output weight, positive semidefinite: a number, a diagonal (p,) or a matrix (p, p).
        R: input weight, likewise (m,) or (m, m).
        u_min: lower input limit, a number or (m,).
        u_max: upper input limit.
        du_max: largest change of an input from one sample to the next.
        y_min: lower output limit, kept by the plan with a slack that is reported.
        y_max: upper output limit.
        terminal: "none"; "equilibrium": the plan ends at rest, exactly wherever a plan within the limits can, in a
            steady state of its own choice as near the reference as possible; "hard": equation (6.1c) as printed, u = 0
            and y = y_ref at the end; "soft": (6.1c) as a penalty.
        terminal_steps: samples at the end of the plan for which the terminal condition holds; 0 takes N.
        terminal_weight: price of violating the terminal condition where it cannot be met, relative to Q; up to 10 the
            rest of "equilibrium" is no condition, but costs this price.
        offset_weight: price of the distance between steady state and reference, relative to Q ("equilibrium").
        mask: weight per output in [0, 1], (p,); 0 for an output that is not to be chased.
        slack_weight: price of violating an output limit, relative to Q.
        solver: solver tried first; the other one is the second try.
        form: "absolute", or "incremental": predicts changes, offset-free under constant disturbances and at operating
            points; with terminal "none", R then weighs the moves.
        data_policy: "fixed": the first T inputs of this very run, as in the paper; "sliding": always the newest T;
            "guarded": the newest T as long as they excite, else the last window that did.
        guard: least strength of a window that "guarded" takes, relative to the first one, in (0, 1].
        dither: amplitude of white noise added to the inputs so that they keep exciting, a number or (m,): at every
            step with "sliding", with "guarded" only while the newest window is too weak.
        seed: of the dither.
        disturbances: number of measured disturbances: known inputs that cannot be chosen, given with every sample.
        noise: standard deviation of the output noise, a number or (p,); 0 for exact data. Used in rank decisions.
        cut: directions of the free response to keep: "order" at most q of them, "gap" up to the largest gap, "noise"
            those above the noise, "none" all above rounding.
        predictor: "joint" regression, or "causal", unbiased on data that were recorded in closed loop.
        noise_block: what noise adds to the behaviour: "off", "ridge" with weight `regularization`, or "free" as (6.1)
            has it when typed in.
        regularization: price of the noise block per sample of data, relative to unit covariance.
        initial_slack: price of moving the initial condition by the root mean square of the outputs; inf for never.
        fallback: what is applied when no plan is left: "hold" the last input or go to the "safe" one.
        u_safe: safe input, a number or (m,).
    """

    N: int
    L: int
    T: int = 0
    s: int = 1
    q: int = 0
    Q: Weight = 1.0
    R: Weight = 1.0
    u_min: Numbers = -np.inf
    u_max: Numbers = np.inf
    du_max: Numbers = np.inf
    y_min: Numbers = -np.inf
    y_max: Numbers = np.inf
    terminal: Terminal = "equilibrium"
    terminal_steps: int = 0
    terminal_weight: float = 1e7
    offset_weight: float = 1000.0
    mask: Numbers = 1.0
    slack_weight: float = 1000.0
    solver: Solver = "osqp"
    form: Form = "absolute"
    data_policy: DataPolicy = "fixed"
    guard: float = 0.1
    dither: Numbers = 0.0
    seed: int = 0
    disturbances: int = 0
    noise: Numbers = 0.0
    cut: Cut = "order"
    predictor: Regression = "joint"
    noise_block: NoiseBlock = "off"
    regularization: float = 100.0
    initial_slack: float = np.inf
    fallback: Fallback = "hold"
    u_safe: Numbers = 0.0

    def __post_init__(self) -> None:
        """Freezes arrays into tuples and checks everything that does not need the number of channels."""
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, (np.ndarray, list, tuple)):
                object.__setattr__(self, field.name, _frozen(value))
            elif isinstance(value, np.generic):
                object.__setattr__(self, field.name, value.item())
        for name, least in (
            ("N", 1),
            ("L", 1),
            ("T", 0),
            ("s", 1),
            ("q", 0),
            ("terminal_steps", 0),
            ("disturbances", 0),
            ("seed", 0),
        ):
            _whole(name, getattr(self, name), least)
        for name, kind in (
            ("terminal", Terminal),
            ("solver", Solver),
            ("data_policy", DataPolicy),
            ("fallback", Fallback),
            ("form", Form),
            ("predictor", Regression),
            ("cut", Cut),
            ("noise_block", NoiseBlock),
        ):
            _one_of(name, getattr(self, name), get_args(kind))
        for name in ("terminal_weight", "offset_weight", "slack_weight", "regularization", "initial_slack"):
            value = getattr(self, name)
            if not (isinstance(value, (int, float)) and value >= 0 and (np.isfinite(value) or name == "initial_slack")):
                raise ValueError(f"{name} = {value}: must be a finite number >= 0")
        if not (isinstance(self.guard, (int, float)) and 0 < self.guard <= 1):
            raise ValueError(f"guard = {self.guard}: must lie in (0, 1]")
        if self.terminal != "none" and self.tail >= self.L:
            raise ValueError(
                f'terminal = "{self.terminal}" holds for the last {self.tail} samples: needs L >= {self.tail + 1}, '
                f"got L = {self.L}"
            )

    @property
    def tail(self) -> int:
        """Samples at the end of the plan for which the terminal condition holds."""
        return self.terminal_steps or self.N

    @property
    def past(self) -> int:
        """Past samples that a step needs: N, and one more to take differences of."""
        return self.N + (self.form == "incremental")


@dataclass(frozen=True, slots=True)
class Sized:
    """Settings for a plant with m inputs and p outputs, as arrays.

    Attributes:
        base: the settings as given.
        m: inputs.
        p: outputs.
        T: inputs in the window.
        rows_u: block rows of inputs in the data matrix, N + L + s - 1: past, committed (s - 1) and planned.
        rows_y: block rows of outputs, N + L.
        delta: bound of the slow order used: q, or N - s + 1 if unknown.
        rank_need: rank of the data matrix of rich data, m (N + L + s - 1) + delta.
        excitation_need: order of persistency of excitation that Corollary 1 asks, N + L + delta + s - 1.
        Q: (p, p).
        R: (m, m).
        u_min: (m,), as all limits of inputs.
        u_max: (m,).
        du_max: (m,).
        dither: (m,).
        u_safe: (m,).
        y_min: (p,), as all numbers per output.
        y_max: (p,).
        mask: (p,).
        noise: (p,).
    """

    base: DeepcSettings
    m: int
    p: int
    T: int
    rows_u: int
    rows_y: int
    delta: int
    rank_need: int
    excitation_need: int
    Q: Array
    R: Array
    u_min: Array
    u_max: Array
    du_max: Array
    dither: Array
    u_safe: Array
    y_min: Array
    y_max: Array
    mask: Array
    noise: Array


def size(base: DeepcSettings, m: int, p: int) -> Sized:
    """Checks the settings against the number of channels and turns them into arrays.

    Raises:
        ValueError: one line that names what is wrong and the number that would work.
    """
    _whole("m", m, 1)
    _whole("p", p, 1)
    arrays = {
        name: _per_channel(name, getattr(base, name), m) for name in ("u_min", "u_max", "du_max", "u_safe", "dither")
    }
    arrays |= {name: _per_channel(name, getattr(base, name), p) for name in ("y_min", "y_max", "mask", "noise")}
    for kind in ("u", "y"):
        low, high = arrays[f"{kind}_min"], arrays[f"{kind}_max"]
        empty = np.flatnonzero(~(low <= high))
        if empty.size:
            i = empty[0]
            raise ValueError(f"no {kind}[{i}] is allowed: {kind}_min = {low[i]:g} exceeds {kind}_max = {high[i]:g}")
        if (low == np.inf).any() or (high == -np.inf).any():
            raise ValueError(
                f"{kind}_min or {kind}_max allows infinity only: {kind}_min = inf and {kind}_max = -inf do"
            )
    if not (arrays["du_max"] > 0).all():
        raise ValueError(f"du_max = {arrays['du_max'].min():g}: a rate limit must be positive")
    if ((arrays["mask"] < 0) | (arrays["mask"] > 1)).any():
        raise ValueError(f"mask = {arrays['mask'].tolist()}: each entry must lie in [0, 1]")
    if not (np.isfinite(arrays["noise"]) & (arrays["noise"] >= 0)).all():
        raise ValueError(f"noise = {arrays['noise'].tolist()}: a standard deviation must be finite and >= 0")
    if not (np.isfinite(arrays["dither"]) & (arrays["dither"] >= 0)).all():
        raise ValueError(f"dither = {arrays['dither'].tolist()}: amplitudes must be finite and >= 0")
    arrays["u_safe"] = np.clip(arrays["u_safe"], arrays["u_min"], arrays["u_max"])
    weights = {"Q": _weight("Q", base.Q, p), "R": _weight("R", base.R, m)}
    return Sized(base=base, m=m, p=p, **_counts(base, m, p), **weights, **arrays)  # type: ignore[arg-type]


def _counts(base: DeepcSettings, m: int, p: int) -> dict[str, int]:
    """Rows, ranks and orders; T checked against what it can ever reach (Corollary 1 and the rank of rich data)."""
    delta = base.q or base.N - base.s + 1
    if delta < 1:
        raise ValueError(
            f"N = {base.N} with s = {base.s} leaves no room for the initial condition: needs N >= {base.s}"
        )
    rows_u = base.N + base.L + base.s - 1
    rank, order = m * rows_u + delta, rows_u + delta
    spent = base.s - 1 + (base.form == "incremental")  # inputs without an output yet, and one for the first difference
    for_rank = rank + base.N + base.L - 1 + spent
    for_order = (m + 1) * order - 1 + (base.form == "incremental")
    for_causal = (m + base.disturbances) * rows_u + (p + 1) * (base.N + base.L) - 1 + spent
    causal = base.predictor == "causal"
    T = base.T or max(for_order, for_causal if causal else 0)
    if base.q and for_rank > T:
        raise ValueError(
            f"T = {T} can never reach the rank m(N+L+s-1)+q = {rank}: needs T >= {for_rank} "
            f"(T >= {for_order} for excitation of order {order})"
        )
    if not base.q and for_order > T:
        raise ValueError(
            f"T = {T} cannot excite of order N+L+q+s-1 = {order} (q unknown, at most N-s+1 = {delta}): "
            f"needs T >= {for_order}, or give q"
        )
    if causal and for_causal > T:
        raise ValueError(f"T = {T} has fewer columns than the causal predictor has rows: needs T >= {for_causal}")
    return {
        "T": T,
        "rows_u": rows_u,
        "rows_y": base.N + base.L,
        "delta": delta,
        "rank_need": rank,
        "excitation_need": order,
    }


def _frozen(value: Any) -> Any:
    """Nested tuples of floats, so that settings compare, hash and print."""
    if isinstance(value, (np.ndarray, list, tuple)):
        return tuple(_frozen(v) for v in value)
    return float(value)


def _whole(name: str, value: Any, least: int) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ValueError(f"{name} = {value!r}: must be a whole number >= {least}")


def _one_of(name: str, value: Any, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise ValueError(f"{name} = {value!r}: must be one of {', '.join(allowed)}")


def _per_channel(name: str, value: Any, count: int) -> Array:
    a = np.array(value, dtype=np.float64)
    if a.shape not in ((), (1,), (count,)):
        raise ValueError(f"{name} has {a.size} entries: give one number or {count}")
    if np.isnan(a).any():
        raise ValueError(f"{name} contains NaN")
    return np.array(np.broadcast_to(a, (count,)))


def _weight(name: str, value: Any, count: int) -> Array:
    """A positive semidefinite matrix from a number, a diagonal or a matrix."""
    a = np.array(value, dtype=np.float64)
    if a.ndim < 2:
        a = np.diag(_per_channel(name, a, count))
    if a.shape != (count, count):
        raise ValueError(f"{name} has shape {a.shape}: give a number, {count} numbers or a {count} x {count} matrix")
    if not np.isfinite(a).all():
        raise ValueError(f"{name} must be finite")
    largest = np.abs(a).max()
    if np.abs(a - a.T).max() > 1e-9 * largest:
        raise ValueError(f"{name} is not symmetric")
    a = (a + a.T) / 2
    least = float(np.linalg.eigvalsh(a)[0])
    if least < -1e-9 * largest:
        raise ValueError(f"{name} is not positive semidefinite: its least eigenvalue is {least:.3g}")
    return a
