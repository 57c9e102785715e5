# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A run as one picture: outputs with references, inputs with limits, verdicts, solve time."""

import os
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from .errors import BagError, why
from .recording import Recording
from .run import MODES, NO_MODE, PROPERTIES, VERDICTS, Array, Run
from .stretches import Thin
from .style import INK, INPUTS, MODE, MUTED, OUTPUT, PROPERTY, REFERENCE, RULE, VERDICT
from .trends import Trends

Points = tuple[Array, Array]

_STYLE: Any = {
    "font.family": "DejaVu Sans", "font.size": 11, "axes.edgecolor": RULE, "axes.labelcolor": INK, "text.color": INK,
    "xtick.color": MUTED, "ytick.color": MUTED, "axes.spines.top": False, "axes.spines.right": False,
    "axes.linewidth": 0.8, "hatch.linewidth": 0.6, "hatch.color": "#9aa0a6", "axes.titlesize": 11,
}  # fmt: skip
_INCHES = (12.8, 7.2)
MAX_PANELS = 4  # outputs with a panel of their own; more share one


def draw(
    run: Run | Recording | Trends, path: str | os.PathLike[str], *, title: str = "", what_if: Array | None = None
) -> None:
    """Draws a run at 1920 x 1080 pixels.

    Args:
        run: the run.
        path: of the picture; its ending (.png, .svg, .pdf) says the format.
        title: above the picture; default: plant and variant.
        what_if: inputs of another controller, shape (K, m), NaN where it has none; drawn over the recorded ones.

    Raises:
        BagError: if the picture cannot be written.
    """
    trends = run if isinstance(run, Trends) else Trends.of(run)
    others = [] if what_if is None or isinstance(run, Trends) else _lines(run, what_if)
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=_INCHES, dpi=150, facecolor="white")
        FigureCanvasAgg(figure)
        _fill(figure, trends, title, others)
        try:
            figure.savefig(path)
        except OSError as error:
            raise BagError(f"cannot write {path}: {why(error)}") from error


def _lines(run: Run | Recording, values: Array) -> list[Points]:
    """Values of each sample of a run, shape (K, m), as lines."""
    lines = [Thin(len(run)) for _ in values.T]
    for stretch in run.stretches():
        for i, line in enumerate(lines):
            line.add(stretch.x, values[stretch.first : stretch.first + len(stretch), i])
    return [line.points() for line in lines]


def _fill(figure: Figure, trends: Trends, title: str = "", what_if: Sequence[Points] = ()) -> None:
    groups = _output_groups(trends)
    heights = [2.0 if len(groups) <= 2 else 1.5] * len(groups) + [1.6]
    rows = {"verdicts": 1.25} if trends.run.reports.total else {}
    if len(trends.summary.solve_time):
        rows["solve"] = 0.75
    grid = figure.add_gridspec(
        len(heights) + len(rows), 1, height_ratios=[*heights, *rows.values()],
        left=0.095, right=0.865, top=0.868, bottom=0.085, hspace=0.28,
    )  # fmt: skip
    axes = [figure.add_subplot(grid[0])]
    axes += [figure.add_subplot(grid[i], sharex=axes[0]) for i in range(1, len(heights) + len(rows))]
    for axis, group in zip(axes, groups, strict=False):
        _outputs(axis, trends, group)
    _inputs(axes[len(groups)], trends, what_if)
    for axis, name in zip(axes[len(heights) :], rows, strict=True):
        (_verdicts if name == "verdicts" else _solve_time)(axis, trends)
    for axis in axes[: len(heights)]:
        _phases(axis, trends)
    _phase_words(axes[0], trends)
    for axis in axes[:-1]:
        axis.tick_params(labelbottom=False)
    axes[0].set_xlim(trends.start, trends.end)
    axes[-1].set_xlabel(axis_label(trends.run))
    figure.text(0.02, 0.955, title or _title(trends.run), fontsize=17, fontweight="bold", va="center")
    figure.text(0.98, 0.955, _facts(trends.run), fontsize=11, color=MUTED, va="center", ha="right")


def axis_label(run: Run) -> str:
    """Says what is on the x axis, see ``Run.x``."""
    period = "" if np.isnan(run.sample_time) else f"   (one sample = {seconds(run.sample_time)})"
    return f"sample k{period}" if run.epochs == 1 else f"samples of {run.epochs} epochs, in order{period}"


def modes(trends: Trends) -> list[tuple[float, float, str]]:
    """Start, end and name of each stretch in one mode."""
    return [(a, b, MODES[m]) for a, b, m, _ in trends.modes.runs(trends.end) if m != NO_MODE]


def seconds(value: float) -> str:
    """A duration in the unit that suits it: 0.1 s, 5 min, 2.4 h."""
    for unit, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if value >= 2 * size:
            return f"{value / size:.4g} {unit}"
    return f"{value:.4g} s"


def _title(run: Run) -> str:
    return "  ·  ".join(filter(None, (run.plant or "run", run.variant)))


def _facts(run: Run) -> str:
    seed = run.metadata.get("seed")
    return "   ".join([f"{run.total:,} samples".replace(",", " "), *([f"seed {seed}"] if seed else [])])


def _output_groups(trends: Trends) -> list[list[int]]:
    p = len(trends.y)
    return [[i] for i in range(p)] if p <= MAX_PANELS else [list(range(p))]


def _outputs(axis: Axes, trends: Trends, group: list[int]) -> None:
    run = trends.run
    colors = [OUTPUT if len(group) == 1 else INPUTS[i % len(INPUTS)] for i in group]
    for i, color in zip(group, colors, strict=True):
        axis.plot(*trends.y[i].points(), color=color, linewidth=1.9, zorder=3)
        _steps(axis, trends.ref[i].points(), trends.end, color=REFERENCE, linewidth=1.2, linestyle=(0, (4, 2.5)))
    single = group[0] if len(group) == 1 else None
    ends = [(trends.y[i].last, run.output_names[i], color, True) for i, color in zip(group, colors, strict=True)]
    if single is not None:
        ends.append((trends.ref[single].last, "reference", MUTED, False))
    name = "outputs" if single is None else run.output_names[single]
    _label(axis, name, run.output_units[group[0]] if len({run.output_units[i] for i in group}) == 1 else "")
    if len(group) <= len(INPUTS):
        _name_ends(axis, [end for end in ends if np.isfinite(end[0])])


def _inputs(axis: Axes, trends: Trends, what_if: Sequence[Points]) -> None:
    run, m = trends.run, len(trends.u)
    for i, line in enumerate(trends.u):
        color, faint = INPUTS[i % len(INPUTS)], 0.35 if what_if else 1.0
        axis.step(*line.points(), where="post", color=color, linewidth=1.3, zorder=3, alpha=faint)
        if what_if:
            axis.step(*what_if[i], where="post", color=color, linewidth=1.5, zorder=4)
    limits = {float(v) for v in (*run.input_min, *run.input_max) if np.isfinite(v)}
    for limit in sorted(limits)[:8]:
        axis.axhline(limit, color=INK, linewidth=0.9, linestyle=(0, (1, 1.5)), zorder=2)
    _label(axis, "what if" if what_if else "inputs", run.input_units[0] if len(set(run.input_units)) == 1 else "")
    if m <= len(INPUTS):
        ends = [(trends.u[i].last, run.input_names[i], INPUTS[i], True) for i in range(m)]
        ends += [(max(limits), "limit", MUTED, False)] if len(limits) in (1, 2) else []
        _name_ends(axis, [end for end in ends if np.isfinite(end[0])])


def _verdicts(axis: Axes, trends: Trends) -> None:
    shown: dict[int, bool] = {}
    for row, strip in enumerate(trends.verdicts):
        for left, right, verdict, star in strip.runs(trends.end):
            look = VERDICT[VERDICTS[verdict]]
            edge = RULE if look.fill == "#ffffff" else look.fill
            axis.barh(row, right - left, left=left, height=0.8, color=look.fill, edgecolor=edge, linewidth=0.8)
            words = verdict_words(look.word, star, VERDICTS[verdict])
            room = (right - left) / (trends.end - trends.start) / 0.0095
            words = words if room > len(words) else look.word if room > len(look.word) else ""
            axis.text((left + right) / 2, row, words, color=look.text, fontsize=9, ha="center", va="center_baseline")
            shown[verdict] = shown.get(verdict, False) or bool(words)
    nameless = [VERDICT[VERDICTS[v]] for v, named in sorted(shown.items()) if not named]
    if nameless:
        axis.legend([Patch(facecolor=n.fill, edgecolor=RULE) for n in nameless], [n.word for n in nameless],
                    loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=9)  # fmt: skip
    axis.set_yticks(range(len(PROPERTIES)), [PROPERTY[p] for p in PROPERTIES], fontsize=10, color=INK)
    axis.set_ylim(len(PROPERTIES) - 0.5, -0.5)
    axis.tick_params(left=False)
    axis.spines[["left", "bottom"]].set_visible(False)


def verdict_words(word: str, star: complex | None, verdict: str) -> str:
    """The word of a verdict, with the mode at fault where one was found."""
    if verdict != "NOT_PROVED" or star is None or np.isnan(star):
        return word
    imaginary = f"{star.imag:+.3f}i" if abs(star.imag) > 5e-4 else ""
    return f"{word} at λ = {star.real:.3f}{imaginary}"


def _solve_time(axis: Axes, trends: Trends) -> None:
    x, y = trends.solve.points()
    ms, quantile = 1e3 * y, trends.summary.solve_time
    axis.plot(x, ms, color=OUTPUT, linewidth=0, marker=".", markersize=3)
    axis.set_ylim(0, 1.15 * np.nanmax(ms) or 1.0)
    text = f"median {1e3 * quantile(0.5):.2g}\n99 %  {1e3 * quantile(0.99):.2g}"
    axis.text(1.008, 0.5, text, transform=axis.transAxes, va="center", fontsize=9.5, color=MUTED)
    _label(axis, "solve", "ms")
    axis.yaxis.set_major_locator(MaxNLocator(2))


def _phases(axis: Axes, trends: Trends) -> None:
    for a, b, mode in modes(trends):
        if MODE[mode].fill != "#ffffff":
            axis.axvspan(a, b, facecolor=MODE[mode].fill, hatch=MODE[mode].hatch, edgecolor="#9aa0a6",
                         linewidth=0, zorder=0)  # fmt: skip


def _phase_words(axis: Axes, trends: Trends) -> None:
    for a, b, mode in modes(trends):
        if (b - a) / (trends.end - trends.start) > 0.012 * len(MODE[mode].word):
            axis.annotate(MODE[mode].word, ((a + b) / 2, 1), xycoords=("data", "axes fraction"), xytext=(0, 5),
                          textcoords="offset points", ha="center", va="bottom", color=MUTED)  # fmt: skip


def _steps(axis: Axes, points: Points, end: float, **look: Any) -> None:
    """A piecewise constant line up to the end of the axis."""
    x, y = points
    axis.step([*x, end], [*y, y[-1]], where="post", zorder=2, **look)


def _name_ends(axis: Axes, ends: Sequence[tuple[float, str, str, bool]]) -> None:
    """Writes names beside the ends of lines, moved apart where they would overlap.

    Args:
        axis: the panel.
        ends: last value, name, colour, and whether it is one of the run's signals (bold).
    """
    low, high = axis.get_ylim()
    height = axis.get_position().height * _INCHES[1] * 72  # in points
    gap, place = 15.5 / height, 0.0
    wanted = sorted(((value - low) / (high - low), not bold, name, color, bold) for value, name, color, bold in ends)
    top = 1.02 - gap * (len(wanted) - 1)
    for rank, (want, _, name, color, bold) in enumerate(wanted):
        place = max(min(want, top + gap * rank), place + gap if rank else want)
        weight, size = ("bold", 11) if bold else ("normal", 9.5)
        axis.text(1.008, place, name, transform=axis.transAxes, color=color, va="center", fontweight=weight, size=size)


def _label(axis: Axes, name: str, unit: str) -> None:
    axis.set_ylabel(f"{name}  [{unit}]" if unit else name)
    axis.yaxis.set_label_coords(-0.052, 0.5)
    axis.margins(y=0.08)
    axis.grid(axis="y", color=RULE, linewidth=0.5, alpha=0.6)
    axis.set_axisbelow(True)
