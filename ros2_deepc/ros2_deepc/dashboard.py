# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""What a person sees while a run goes on."""

import time
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

_MODES = ("IDLE", "COLLECTING", "CONTROLLING", "HOLDING", "FALLBACK", "SHADOW")
_VERDICTS = (
    ("UNDECIDED", "yellow"),
    ("PROVED", "green"),
    ("NOT PROVED", "red"),
    ("PRIOR VIOLATED", "magenta"),
    ("REFUTED", "red"),
    ("NOT DECIDABLE", "bright_black"),
)
_LIGHTS = (
    ("R-ctrb", "r_controllability"),
    ("R-obsv", "r_observability"),
    ("C-ctrb", "c_controllability"),
    ("C-obsv", "c_observability"),
)
_REDRAW = 0.1  # [s]
_ENDLESS = 100  # samples a line of an endless run
_LINES = 10  # lines of progress where there is no terminal to redraw


class Dashboard:
    """Draws the newest of everything; on anything that is not a terminal it prints a line now and then instead.

    Args:
        console: where to draw.
        observer: node that keeps the newest messages.
        steps: run length K; 0 = endless.
        title: what is running.
    """

    def __init__(self, console: Console, observer: Any, steps: int, title: str) -> None:
        self._console, self._observer, self._title = console, observer, title
        self._steps = steps  # 0 = endless
        self._live = Live(console=console, auto_refresh=False, transient=False) if console.is_terminal else None
        self._drawn = 0.0
        self._printed = -1

    def __enter__(self) -> "Dashboard":
        """Starts drawing."""
        if self._live is not None:
            self._live.start()
        else:
            self._console.print(self._title)
        return self

    def __exit__(self, *_: object) -> None:
        """Draws the last state and stops."""
        if self._live is not None:
            self._live.update(self._picture(), refresh=True)
            self._live.stop()

    def draw(self) -> None:
        """Draws, if the last time was long enough ago."""
        state = self._observer.state
        if self._live is not None:
            now = time.monotonic()
            if now - self._drawn > _REDRAW:
                self._drawn = now
                self._live.update(self._picture(), refresh=True)
        elif state is not None and (part := self._part(int(state.k) + 1)) > self._printed:
            self._printed = part
            self._console.print(self._line(), soft_wrap=True)

    def _part(self, done: int) -> int:
        """Which line of progress is due: tenths of a run with an end, else every hundred samples."""
        return done * _LINES // self._steps if self._steps else done // _ENDLESS

    def _line(self) -> Text:
        state = self._observer.state
        text = Text(f"  k {state.k + 1:>5}{self._of()}  {_MODES[state.mode]:<11} ")
        if state.solver:
            text.append(f"{state.solver} {1e3 * state.solve_time:.2f} ms  ")
        text.append_text(self._lights())
        return text

    def _of(self) -> str:
        return f" of {self._steps}" if self._steps else ""

    def _lights(self) -> Text:
        report = self._observer.report
        text = Text()
        for label, field in _LIGHTS:
            verdict = _VERDICTS[0] if report is None else _VERDICTS[getattr(report, field).verdict]
            text.append("● ", style=verdict[1]).append(f"{label} {verdict[0].lower()}  ")
        return text

    def _picture(self) -> Group:
        state, outputs, info = self._observer.state, self._observer.outputs, self._observer.info
        done = 0 if state is None else int(state.k) + 1
        head = Table.grid(padding=(0, 2))
        mode = "starting" if state is None else _MODES[state.mode]
        head.add_row(
            Text(self._title, style="bold"),
            Text(mode, style="cyan"),
            ProgressBar(total=self._steps or None, completed=done, width=30, pulse=not self._steps),
            f"k {done}{self._of()}",
            "" if state is None or not state.solver else f"{state.solver} {1e3 * state.solve_time:.2f} ms",
        )
        values = Table("output", "value", "reference", "unit", box=None, padding=(0, 2))
        if info is not None and outputs is not None and state is not None:
            for i, name in enumerate(info.output_names):
                wanted = f"{state.reference[i]:.4g}" if i < len(state.reference) else "-"
                values.add_row(name, f"{outputs.values[i]: .6f}", wanted, info.output_units[i])
        reason = Text("" if state is None else state.reason, style="bright_black", overflow="ellipsis", no_wrap=True)
        return Group(head, values, self._lights(), reason)
