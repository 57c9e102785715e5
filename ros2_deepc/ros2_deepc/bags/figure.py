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

from .run import MODES, NO_MODE, PROPERTIES, VERDICTS, Array, Run
from .stretches import stretches, thin
from .style import INK, INPUTS, MODE, MUTED, OUTPUT, PROPERTY, REFERENCE, RULE, VERDICT

_STYLE: Any = {
    "font.family": "DejaVu Sans", "font.size": 11, "axes.edgecolor": RULE, "axes.labelcolor": INK, "text.color": INK,
    "xtick.color": MUTED, "ytick.color": MUTED, "axes.spines.top": False, "axes.spines.right": False,
    "axes.linewidth": 0.8, "hatch.linewidth": 0.6, "hatch.color": "#9aa0a6", "axes.titlesize": 11,
}  # fmt: skip
_INCHES = (12.8, 7.2)
MAX_PANELS = 4  # outputs with a panel of their own; more share one


def draw(run: Run, path: str | os.PathLike[str], *, title: str = "", what_if: Array | None = None) -> None:
    """Draws a run at 1920 x 1080 pixels.

    Args:
        run: the run.
        path: of the picture; its ending (.png, .svg, .pdf) says the format.
        title: above the picture; default: plant and variant.
        what_if: inputs of another controller, shape (K, m), NaN where it has none; drawn over the recorded ones.
    """
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=_INCHES, dpi=150, facecolor="white")
        FigureCanvasAgg(figure)
        _fill(figure, run, title, what_if)
        figure.savefig(path)


def _fill(figure: Figure, run: Run, title: str, what_if: Array | None = None) -> None:
    groups = _output_groups(run)
    heights = [2.0 if len(groups) <= 2 else 1.5] * len(groups) + [1.6]
    rows = {"verdicts": 1.25} if len(run.reports.k) else {}
    if np.isfinite(run.solve_time).any():
        rows["solve"] = 0.75
    grid = figure.add_gridspec(
        len(heights) + len(rows), 1, height_ratios=[*heights, *rows.values()],
        left=0.095, right=0.865, top=0.868, bottom=0.085, hspace=0.28,
    )  # fmt: skip
    x, label = sample_axis(run)
    axes = [figure.add_subplot(grid[0])]
    axes += [figure.add_subplot(grid[i], sharex=axes[0]) for i in range(1, len(heights) + len(rows))]
    for axis, group in zip(axes, groups, strict=False):
        _outputs(axis, run, x, group)
    _inputs(axes[len(groups)], run, x, what_if)
    for axis, name in zip(axes[len(heights) :], rows, strict=True):
        (_verdicts if name == "verdicts" else _solve_time)(axis, run, x)
    for axis in axes[: len(heights)]:
        _phases(axis, run, x)
    _phase_words(axes[0], run, x)
    for axis in axes[:-1]:
        axis.tick_params(labelbottom=False)
    axes[0].set_xlim(x[0], x[-1] + 1)
    axes[-1].set_xlabel(label)
    figure.text(0.02, 0.955, title or _title(run), fontsize=17, fontweight="bold", va="center")
    figure.text(0.98, 0.955, _facts(run), fontsize=11, color=MUTED, va="center", ha="right")


def sample_axis(run: Run) -> tuple[Array, str]:
    """Position of every sample on the x axis, shape (K,), and the axis label."""
    period = "" if np.isnan(run.sample_time) else f"   (one sample = {seconds(run.sample_time)})"
    epochs = len(np.unique(run.epoch))
    if epochs == 1:
        return run.k.astype(np.float64), f"sample k{period}"
    return np.arange(len(run), dtype=np.float64), f"samples of {epochs} epochs, in order{period}"


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
    return "   ".join([f"{len(run):,} samples".replace(",", " "), *([f"seed {seed}"] if seed else [])])


def _output_groups(run: Run) -> list[list[int]]:
    p = run.y.shape[1]
    return [[i] for i in range(p)] if p <= MAX_PANELS else [list(range(p))]


def _outputs(axis: Axes, run: Run, x: Array, group: list[int]) -> None:
    colors = [OUTPUT if len(group) == 1 else INPUTS[i % len(INPUTS)] for i in group]
    for i, color in zip(group, colors, strict=True):
        axis.plot(*thin(x, run.y[:, i]), color=color, linewidth=1.9, zorder=3)
        axis.plot(*_steps(x, run.ref[:, i]), color=REFERENCE, linewidth=1.2, linestyle=(0, (4, 2.5)), zorder=2)
    single = group[0] if len(group) == 1 else None
    ends = [(_last(run.y[:, i]), run.output_names[i], color, True) for i, color in zip(group, colors, strict=True)]
    if single is not None:
        ends.append((_last(run.ref[:, single]), "reference", MUTED, False))
    name = "outputs" if single is None else run.output_names[single]
    _label(axis, name, run.output_units[group[0]] if len({run.output_units[i] for i in group}) == 1 else "")
    if len(group) <= len(INPUTS):
        _name_ends(axis, [end for end in ends if np.isfinite(end[0])])


def _inputs(axis: Axes, run: Run, x: Array, what_if: Array | None) -> None:
    m = run.u.shape[1]
    for i in range(m):
        color = INPUTS[i % len(INPUTS)]
        faint = 1.0 if what_if is None else 0.35
        axis.step(*thin(x, run.u[:, i]), where="post", color=color, linewidth=1.3, zorder=3, alpha=faint)
        if what_if is not None:
            axis.step(*thin(x, what_if[:, i]), where="post", color=color, linewidth=1.5, zorder=4)
    limits = {float(v) for v in (*run.input_min, *run.input_max) if np.isfinite(v)}
    for limit in sorted(limits)[:8]:
        axis.axhline(limit, color=INK, linewidth=0.9, linestyle=(0, (1, 1.5)), zorder=2)
    _label(
        axis, "inputs" if what_if is None else "what if", run.input_units[0] if len(set(run.input_units)) == 1 else ""
    )
    if m <= len(INPUTS):
        ends = [(_last(run.u[:, i]), run.input_names[i], INPUTS[i], True) for i in range(m)]
        ends += [(max(limits), "limit", MUTED, False)] if len(limits) in (1, 2) else []
        _name_ends(axis, [end for end in ends if np.isfinite(end[0])])


def _verdicts(axis: Axes, run: Run, x: Array) -> None:
    reports = run.reports
    start = np.interp(reports.t, run.t, x)
    ends = np.r_[start[1:], x[-1] + 1]
    shown: dict[int, bool] = {}
    for row, _ in enumerate(PROPERTIES):
        for a, b, verdict in stretches(reports.verdict[:, row]):
            look = VERDICT[VERDICTS[verdict]]
            left, right = start[a], ends[b - 1]
            edge = RULE if look.fill == "#ffffff" else look.fill
            axis.barh(row, right - left, left=left, height=0.8, color=look.fill, edgecolor=edge, linewidth=0.8)
            words = verdict_words(look.word, reports.lambda_star[b - 1, row], VERDICTS[verdict])
            room = (right - left) / (x[-1] + 1 - x[0]) / 0.0095
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


def verdict_words(word: str, star: complex, verdict: str) -> str:
    """The word of a verdict, with the mode at fault where one was found."""
    if verdict != "NOT_PROVED" or np.isnan(star):
        return word
    imaginary = f"{star.imag:+.3f}i" if abs(star.imag) > 5e-4 else ""
    return f"{word} at λ = {star.real:.3f}{imaginary}"


def _solve_time(axis: Axes, run: Run, x: Array) -> None:
    known = np.isfinite(run.solve_time)
    ms = 1e3 * run.solve_time[known]
    axis.plot(*thin(x[known], ms), color=OUTPUT, linewidth=0, marker=".", markersize=3)
    axis.set_ylim(0, 1.15 * ms.max() or 1.0)
    text = f"median {np.median(ms):.2g}\n99 %  {np.quantile(ms, 0.99):.2g}"
    axis.text(1.008, 0.5, text, transform=axis.transAxes, va="center", fontsize=9.5, color=MUTED)
    _label(axis, "solve", "ms")
    axis.yaxis.set_major_locator(MaxNLocator(2))


def _phases(axis: Axes, run: Run, x: Array) -> None:
    edges = np.r_[x, x[-1] + 1]
    for a, b, mode in stretches(run.mode):
        if mode != NO_MODE and MODE[MODES[mode]].fill != "#ffffff":
            look = MODE[MODES[mode]]
            axis.axvspan(edges[a], edges[b], facecolor=look.fill, hatch=look.hatch, edgecolor="#9aa0a6",
                         linewidth=0, zorder=0)  # fmt: skip


def _phase_words(axis: Axes, run: Run, x: Array) -> None:
    edges = np.r_[x, x[-1] + 1]
    width = edges[-1] - edges[0]
    for a, b, mode in stretches(run.mode):
        word = MODE[MODES[mode]].word if mode != NO_MODE else ""
        if word and (edges[b] - edges[a]) / width > 0.012 * len(word):
            axis.annotate(word, ((edges[a] + edges[b]) / 2, 1), xycoords=("data", "axes fraction"), xytext=(0, 5),
                          textcoords="offset points", ha="center", va="bottom", color=MUTED)  # fmt: skip


def _steps(x: Array, y: Array) -> tuple[Array, Array]:
    """A piecewise constant line, its jumps vertical, with no more points than it has corners."""
    corners = stretches(np.where(np.isnan(y), np.inf, y))
    xs = [v for a, b, _ in corners for v in (x[a], x[b] if b < len(x) else x[-1] + 1)]
    ys = [np.nan if np.isinf(v) else v for _, _, v in corners for _ in range(2)]
    return np.array(xs), np.array(ys)


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


def _last(values: Array) -> float:
    """The last known value, or NaN."""
    known = values[np.isfinite(values)]
    return float(known[-1]) if len(known) else np.nan


def _label(axis: Axes, name: str, unit: str) -> None:
    axis.set_ylabel(f"{name}  [{unit}]" if unit else name)
    axis.yaxis.set_label_coords(-0.052, 0.5)
    axis.margins(y=0.08)
    axis.grid(axis="y", color=RULE, linewidth=0.5, alpha=0.6)
    axis.set_axisbelow(True)
