# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Which data of the run the controller uses: the first rich window, or the newest."""

import numpy as np

from ros2_deepc.behavior import DataWindow, Record, SlidingFactor, SlidingGram
from ros2_deepc.behavior.hankel import Array

from .data import Snapshot, noise_norm, truncation
from .layout import lay_out
from .predictor import PoorDataError, Predictor, fit, fit_causal, fit_gram
from .settings import Sized
from .transform import Units, accumulate, unscale


class RunData:
    """The data window of a run, under the data policy of the settings.

    Until the data are rich, the window holds the newest T inputs. Then "fixed" keeps them for good. "sliding" and
    "guarded" go on, with a Gram matrix or a triangular factor of the data matrix that follows in constant time. A
    weaker window than the guard allows is not adopted by "guarded"; one that determines no predictor at all is adopted
    by neither.

    Args:
        sized: settings.
    """

    def __init__(self, sized: Sized) -> None:
        self._sized = sized
        self._layout = lay_out(sized)
        self._window = DataWindow(sized.m + sized.base.disturbances, sized.p, sized.T)
        self._ahead: list[Array] = []
        self._now: Snapshot | None = None
        self._first: Snapshot | None = None
        self._shown: Snapshot | None = None
        self._shown_at = 0
        self._stream: _Stream | None = None
        self._adopted: Predictor | None = None
        self._reference: Predictor | None = None  # of the first rich window, in scaled channels
        self._units: Units | None = None
        self.weak = ""

    @property
    def length(self) -> int:
        """Inputs in the window."""
        return min(len(self._window) + len(self._ahead), self._sized.T)

    @property
    def scale(self) -> tuple[Array, Array]:
        """Root mean square of inputs and disturbances, and of outputs, in the first rich window."""
        assert self._first is not None  # asked for only when nothing is missing
        return self._first.scale

    @property
    def moves(self) -> bool:
        """Whether the predictor changes while the plant is controlled."""
        return self._sized.base.data_policy != "fixed"

    def observe(self, w: Array, ahead: list[Array]) -> None:
        """Takes a sample w = [u; d; y] and the inputs already decided after it."""
        if self._first is not None and not self.moves:
            return
        self._window.append(w)
        self._ahead, self._now = ahead, None
        if self._stream is not None:
            self._stream.push(w)
        elif self.length >= self._sized.T and self.snapshot.rich:
            self._first = self._shown = self.snapshot
            if self.moves:
                self._stream = _Stream(self._sized, self._first.scale)
                self._stream.refill(self._window.records())

    def cut(self) -> None:
        """The next sample starts a new record."""
        if self._first is None or self.moves:
            self._window.cut()
            self._ahead = []
        if self._stream is not None:
            self._stream.cut()

    @property
    def snapshot(self) -> Snapshot:
        """What the window holds now; the data in use, if the policy is "fixed"."""
        if self._first is not None and not self.moves:
            return self._first
        if self._now is None:
            scale = self._first.scale if self._first is not None else None
            self._now = Snapshot(self._records(), self._sized, self._layout, scale)
        return self._now

    @property
    def display(self) -> Snapshot:
        """A recent snapshot, for people: ranks cost much more than a step."""
        pause = self._sized.T // (20 if self._first is not None else 100)
        if self._shown is None or self._window.pushed - self._shown_at > pause or not self._window.pushed:
            self._shown, self._shown_at = self.snapshot, self._window.pushed
        return self._shown

    def adjust(self, sized: Sized) -> None:
        """Takes settings that differ in nothing that the data depend on."""
        self._sized = sized

    def missing(self) -> str:
        """One line on what the data lack; empty if nothing."""
        if self._first is not None:
            return ""
        sized = self._sized
        if self.length < sized.T:
            return f"{sized.T - self.length} more samples: {self.length} of T = {sized.T} inputs are in the window"
        rank = f" and rank {self.snapshot.rank} is below {sized.rank_need}" if sized.base.q else ""
        return (
            f"richer inputs: they excite of order {self.snapshot.excitation_order}, needs {sized.excitation_need}"
            f"{rank}; the window moves on until either holds"
        )

    def predictor(self) -> Predictor:
        """The predictor to use now, in the units of the plant: the same object as long as it does not change."""
        assert self._first is not None  # asked for only when nothing is missing
        if self._adopted is None:
            self._reference = self._first.predictor
            self._adopted = self._in_units(self._reference)
        elif self.moves:
            newest = self._newest()
            if newest is not None:
                self._adopted = self._in_units(newest)
        return self._adopted

    def _newest(self) -> Predictor | None:
        """The newest window's predictor for scaled channels, if it may be adopted; otherwise says why in `weak`."""
        stream, guarded = self._stream, self._sized.base.data_policy == "guarded"
        assert stream is not None  # made with the first rich window
        try:
            newest = stream.predictor() or self.snapshot.predictor
            self.weak = self._weakness(newest)
            if self.weak and guarded:
                return None
            if newest.precise or stream.orthogonal:
                return newest
        except PoorDataError as error:
            self.weak = f"the newest window determines no predictor: {error}"
            if guarded or stream.orthogonal:
                return None
        return self._refined(stream)

    def _refined(self, stream: "_Stream") -> Predictor | None:
        """The newest window's predictor with all digits, after the squared matrix has lost too many of them."""
        stream.refine(self._window.records())
        try:
            newest = stream.predictor() or self.snapshot.predictor
        except PoorDataError as error:
            self.weak = f"the newest window determines no predictor: {error}"
            return None
        self.weak = self._weakness(newest)
        return newest

    def _weakness(self, newest: Predictor) -> str:
        """Why the newest window is too weak, in one line; empty if it is not."""
        first, guard = self._reference, self._sized.base.guard
        assert first is not None  # kept when the first window was adopted
        if newest.order < first.order:
            return f"the newest window shows {newest.order} of {first.order} directions of the free response"
        share = newest.input_strength / first.input_strength
        if share < guard:
            return f"the inputs of the newest window excite {share:.2g} of the first one's, guard is {guard:g}"
        if newest.state_strength < guard * first.state_strength:
            share = newest.state_strength / first.state_strength
            return f"the free response in the newest window is {share:.2g} of the first one's, guard is {guard:g}"
        return ""

    def _in_units(self, predictor: Predictor) -> Predictor:
        assert self._first is not None
        if self._units is None:
            self._units = Units.of(*self._first.scale, self._sized)
        in_units = unscale(predictor, self._units)
        return accumulate(in_units, self._sized) if self._sized.base.form == "incremental" else in_units

    def _records(self) -> tuple[Record, ...]:
        """The newest T inputs with their outputs; decided inputs appended, differences if the form asks for them."""
        records = list(self._window.records())
        if records and self._ahead:
            u, y = records[-1]
            records[-1] = Record(np.vstack([u, self._ahead]), y)
        surplus = sum(len(r.u) for r in records) - self._sized.T
        if surplus > 0 and records:
            records[0] = Record(records[0].u[surplus:], records[0].y[surplus:])
        if self._sized.base.form == "incremental":
            records = [Record(np.diff(u, axis=0), np.diff(y, axis=0)) for u, y in records if len(y) > 1]
        return tuple(records)


class _Stream:
    """The newest window's data matrix, squared or factored, followed sample by sample.

    Starts with the Gram matrix, which is fastest; goes over to the orthogonal factor for good once rounding comes near
    the weakest direction kept, or from the start if the regression needs it. The newest sample waits for the next one,
    or until the predictor is asked for: no command has to wait for it.
    """

    def __init__(self, sized: Sized, scale: tuple[Array, Array]) -> None:
        self._sized, self._scale = sized, np.concatenate(scale)
        self._layout = lay_out(sized)
        self._width = scale[0].size + scale[1].size
        rows = self._layout.timed
        self._places = rows[:, None] * (self._width * sized.rows_u) + rows  # flat places of the grouped Gram matrix
        spent = sized.base.form == "incremental"
        self._columns = sized.T - spent - sized.rows_u + 1
        self._cut = truncation(sized, noise_norm(sized, scale[1], self._columns))
        self._last: Array | None = None
        self._newest: Array | None = None  # not taken in yet
        self._matrix: SlidingGram | SlidingFactor = self._make(
            SlidingFactor if sized.base.predictor == "causal" else SlidingGram
        )

    def _make(self, kind: type[SlidingGram] | type[SlidingFactor]) -> SlidingGram | SlidingFactor:
        return kind(self._width, self._sized.rows_u, self._columns)

    def refill(self, records: tuple[Record, ...]) -> None:
        """Starts from the newest of the records in the window."""
        self.cut()
        for u, y in zip(*records[-1], strict=True):
            self.push(np.concatenate([u, y]))

    @property
    def orthogonal(self) -> bool:
        """Whether the matrix is followed by orthogonal steps, with all digits."""
        return isinstance(self._matrix, SlidingFactor)

    def refine(self, records: tuple[Record, ...]) -> None:
        """Goes over to the orthogonal factor."""
        self._matrix = self._make(SlidingFactor)
        self.refill(records)

    def push(self, w: Array) -> None:
        """Takes a sample [u; d; y]."""
        self._take_in()
        self._newest = w

    def _take_in(self) -> None:
        """Brings the matrix up to date with the newest sample."""
        if self._newest is None:
            return
        w, self._newest = self._newest / self._scale, None
        if self._sized.base.form == "incremental":
            w, self._last, before = w, w, self._last
            if before is None:
                return
            w = w - before
        self._matrix.push(w)

    def cut(self) -> None:
        """The next sample starts a new record."""
        self._matrix.clear()
        self._last = self._newest = None

    def predictor(self) -> Predictor | None:
        """The predictor for scaled channels; None while the record does not fill the window.

        Raises:
            PoorDataError: if the window determines none.
        """
        self._take_in()
        if not self._matrix.full:
            return None
        rows = self._layout.timed
        if isinstance(self._matrix, SlidingGram):
            with_noise = self._sized.base.noise_block != "off"
            S = self._matrix.matrix.ravel()[self._places]
            return fit_gram(S, self._layout, self._columns, self._cut, with_noise)
        regress = fit_causal if self._sized.base.predictor == "causal" else fit
        return regress(self._matrix.factor().T[rows], self._layout, self._columns, self._cut)
