# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A run as a picture needs it: lines with few points, strips of modes and verdicts, events. As small as it is long."""

from typing import Self

from .events import Events
from .progress import Progress, no_progress
from .recording import Recording
from .run import MODES, NO_MODE, VERDICTS, Run
from .stretches import Strip, Thin
from .summary import Summary

MAX_LINES = 24  # outputs, and inputs, that are drawn at most
_BEST_MODES = ("CONTROLLING", "SHADOW", "IDLE", "COLLECTING", "HOLDING", "FALLBACK")
_BEST_VERDICTS = ("PROVED", "UNDECIDED", "NOT_DECIDABLE", "NOT_PROVED", "PRIOR_VIOLATED", "REFUTED")
_STATE = ("rank", "rank_need", "excitation", "excitation_need", "distance", "slack")
_REPORT = ("rank", "rank_need", "excitation", "excitation_need")


class Trends:
    """A run cut down to what can be seen.

    Attributes:
        run: the last stretch: for what is said of the run as a whole.
        start, end: of the axis.
        y, ref, u: a line for each of the first 24 channels.
        solve: solve times [s]; NaN where nothing was solved.
        state, reports: lines of the controller's state, and of the monitor's reports, by field.
        modes, verdicts: strips; the latter tagged with the mode at fault.
        reports_at_end: of the last stretch that has some.
        events: what happened.
        summary: the run's numbers.
    """

    def __init__(self, run: Run) -> None:
        def lines(count: int, total: int = run.total) -> list[Thin]:
            return [Thin(total) for _ in range(count)]

        self.run, self.start, self.end = run, float(run.x[0]), float(run.x[0])
        p, m = (min(values.shape[1], MAX_LINES) for values in (run.y, run.u))
        self.y, self.ref, self.u, self.solve = lines(p), lines(p), lines(m), Thin(run.total)
        self.state = dict(zip(_STATE, lines(len(_STATE)), strict=True))
        self.reports = dict(zip(_REPORT, lines(len(_REPORT), run.reports.total), strict=True))
        self.modes = Strip(run.total, [NO_MODE, *map(MODES.index, _BEST_MODES)])
        self.verdicts = [Strip(run.reports.total, [*map(VERDICTS.index, _BEST_VERDICTS)]) for _ in range(4)]
        self.reports_at_end = run.reports
        self.events, self.summary = Events(), Summary()

    def add(self, run: Run) -> None:
        """Takes the next stretch of the run."""
        x, reports = run.x, run.reports
        self.run, self.end = run, float(x[-1] + 1)
        self.reports_at_end = reports if len(reports.k) else self.reports_at_end
        for lines, values in ((self.y, run.y), (self.ref, run.ref), (self.u, run.u)):
            for i, line in enumerate(lines):
                line.add(x, values[:, i])
        self.solve.add(x, run.solve_time)
        for name, line in self.state.items():
            line.add(x, run.state[name])
        at = x[reports.row - run.first]
        for name, line in self.reports.items():
            line.add(at, reports.series[name])
        self.modes.add(x, run.mode)
        for j, strip in enumerate(self.verdicts):
            strip.add(at, reports.verdict[:, j], reports.lambda_star[:, j])
        self.events.add(run)
        self.summary.add(run)

    @classmethod
    def of(cls, run: Run | Recording, progress: Progress = no_progress) -> Self:
        """Of a whole run.

        Args:
            run: the run.
            progress: called now and then with samples done and in all.
        """
        trends: Self | None = None
        for stretch in run.stretches():
            trends = trends or cls(stretch)
            trends.add(stretch)
            progress(stretch.first + len(stretch), stretch.total)
        assert trends is not None  # a run has a sample at least
        return trends
