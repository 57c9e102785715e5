# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""What an analysis found as one picture: the margin over the complex plane, and the verdicts beside it."""

import os
import textwrap

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from ..bags.run import PROPERTIES
from ..bags.style import INK, MUTED, PROPERTY, RULE, VERDICT
from ..monitors import Finding, Mode, Report, Verdict

POINTS = 241  # of the grid along the real axis
REACH = 1.35  # the plane is shown so far from the origin, farther if a mode lies outside
ATTENTION = VERDICT["NOT_PROVED"].fill
CLEAR = 40.0  # [dB] margin from which the plane is shown as clear, whatever the largest is
STEP = 20.0  # [dB] between two contours


def draw_plane(report: Report, path: str | os.PathLike[str], title: str, facts: str) -> None:
    """Draws the margin of R-controllability over the complex plane, the modes, and all verdicts.

    Args:
        report: of `analyze`.
        path: of the picture; its ending (.png, .svg, .pdf) says the format.
        title: above it.
        facts: beside the title, one line.
    """
    with mpl.rc_context({"font.family": "DejaVu Sans", "font.size": 11, "text.color": INK, "axes.edgecolor": RULE}):
        figure = Figure(figsize=(12.8, 7.2), dpi=150, facecolor="white")
        FigureCanvasAgg(figure)
        figure.text(0.03, 0.945, title, fontsize=17, fontweight="bold", va="center")
        figure.text(0.97, 0.945, facts, color=MUTED, va="center", ha="right")
        _plane(figure, report)
        _verdicts(figure.add_axes((0.6, 0.06, 0.37, 0.8)), report)
        figure.savefig(path)


def _plane(figure: Figure, report: Report) -> None:
    axis = figure.add_axes((0.06, 0.1, 0.42, 0.7467))  # as high as wide
    modes = np.array([mode.lambda_ for mode in report.modes])
    inside = modes[np.isfinite(modes)]
    reach = max(REACH, 1.15 * float(np.max([abs(inside.real), abs(inside.imag)], initial=0.0)))
    axis.set(xlim=(-reach, reach), ylim=(-reach, reach), xlabel="real part of λ", ylabel="imaginary part of λ")
    axis.set_title("margin of the rank that R-controllability needs, at every λ", color=MUTED, fontsize=11, loc="left")
    if report.pencil is None:
        axis.text(0, 0, "the data are not rich enough\nfor an answer at any λ", ha="center", va="center", color=MUTED)
    else:
        _margins(figure, axis, report, reach)
    angle = np.linspace(0, 2 * np.pi, 361)
    axis.plot(np.cos(angle), np.sin(angle), color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
    lost = report.r_controllability.verdict == Verdict.NOT_PROVED
    for mode in report.modes:
        if np.isfinite(mode.lambda_):
            face, size = (ATTENTION, 11) if lost and mode.at_fault else ("white", 6)
            axis.plot(mode.lambda_.real, mode.lambda_.imag, "o", color=face, markeredgecolor=INK, markersize=size)
    star = report.r_controllability.lambda_star
    if lost and np.isfinite(star):
        side = "right" if star.real > 0 else "left"
        axis.annotate(
            f"λ = {in_words(star)}", (star.real, star.imag), (-10 if star.real > 0 else 10, 16), ha=side,
            textcoords="offset points", fontweight="bold",
        )  # fmt: skip


def _margins(figure: Figure, axis: Axes, report: Report, reach: float) -> None:
    """Shades and contours of the margin; by symmetry only the upper half is worked out."""
    real = np.linspace(-reach, reach, POINTS)
    half = np.linspace(0, reach, POINTS // 2 + 1)
    upper = np.stack([report.margins(real + 1j * row) for row in half])
    margin = np.concatenate([upper[:0:-1], upper])
    imaginary = np.concatenate([-half[:0:-1], half])
    highest = float(np.max(margin[np.isfinite(margin)], initial=CLEAR))
    top = STEP * np.ceil(max(highest, CLEAR + STEP) / STEP)
    shown = np.clip(margin, -STEP, top)
    map_ = LinearSegmentedColormap.from_list(
        "margin", [(0.0, ATTENTION), (CLEAR / 2 / top, "#fbe3bd"), (CLEAR / top, "#f4f7fa"), (1.0, "#c3d7ea")]
    )
    shades = axis.pcolormesh(real, imaginary, shown, cmap=map_, vmin=0, vmax=top, rasterized=True)
    if shown.min() < 0:
        axis.contour(real, imaginary, shown, [0.0], colors=[INK], linewidths=1.4)
    lines = axis.contour(real, imaginary, shown, np.arange(STEP, top, STEP), colors=[MUTED], linewidths=0.6)
    axis.clabel(lines, fmt="%g dB", fontsize=8)
    scale = figure.colorbar(shades, cax=figure.add_axes((0.492, 0.1, 0.01, 0.7467)))
    scale.outline.set_visible(False)  # type: ignore[operator]
    scale.ax.tick_params(labelsize=9, color=RULE, labelcolor=MUTED)
    scale.set_label("dB over the noise bound; 0 = within the noise", color=MUTED, fontsize=10)


def _verdicts(axis: Axes, report: Report) -> None:
    axis.set(xlim=(0, 1), ylim=(0, 4))
    axis.set_axis_off()
    for i, name in enumerate(PROPERTIES):
        finding = getattr(report, name)
        look = VERDICT[finding.verdict.name]
        top = 4 - i
        axis.text(0, top - 0.1, PROPERTY[name], fontsize=13, fontweight="bold", va="center")
        axis.text(
            0.46, top - 0.1, f" {look.word} ", color=look.text, va="center",
            bbox={"facecolor": look.fill, "edgecolor": RULE, "boxstyle": "round,pad=0.25"},
        )  # fmt: skip
        if speaks(finding):
            axis.text(1, top - 0.1, f"{finding.margin:+.1f} dB", va="center", ha="right")
        reason = "\n".join(textwrap.wrap(finding.reason, 62)[:4])
        axis.text(0, top - 0.26, reason, color=MUTED, va="top", fontsize=10, linespacing=1.35)


def at_fault(report: Report) -> list[Mode]:
    """The modes that keep R-controllability from being proved, one of each conjugate pair."""
    if report.r_controllability.verdict != Verdict.NOT_PROVED:
        return []
    return [m for m in report.modes if m.at_fault and np.isfinite(m.lambda_) and m.lambda_.imag >= 0]


def speaks(finding: Finding) -> bool:
    """Whether the margin tells how near the verdict is to another one."""
    return finding.verdict in (Verdict.PROVED, Verdict.NOT_PROVED) and bool(np.isfinite(finding.margin))


def in_words(lam: complex) -> str:
    """A complex number with three decimals, without an imaginary part that is none."""
    if abs(lam.imag) < 5e-4:
        return f"{lam.real:.3f}"
    return f"{lam.real:.3f} {'+' if lam.imag > 0 else '-'} {abs(lam.imag):.3f}i"
