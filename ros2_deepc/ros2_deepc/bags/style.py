# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Colours and words of the figure and the report, readable in grey and by the colour-blind."""

from dataclasses import dataclass

INK, MUTED, RULE = "#1a1a1a", "#5f6368", "#c9ccd1"
OUTPUT, REFERENCE = "#0b5c9e", "#1a1a1a"
# after Okabe and Ito; lightness differs from one to the next, so that they part in grey, too
INPUTS = ("#0b5c9e", "#e07b00", "#1a936f", "#a23b72", "#6f8fc9", "#8a6d1d")


@dataclass(frozen=True, slots=True)
class Look:
    """How one state is shown: its word, fill, text colour and hatch."""

    word: str
    fill: str
    text: str = INK
    hatch: str = ""


VERDICT = {
    "PROVED": Look("proved", "#0b5c9e", "#ffffff"),
    "NOT_PROVED": Look("not proved", "#f0a93b"),
    "UNDECIDED": Look("undecided", "#eceef0", MUTED),
    "PRIOR_VIOLATED": Look("prior violated", "#8c2d64", "#ffffff"),
    "REFUTED": Look("refuted", "#5f6368", "#ffffff"),
    "NOT_DECIDABLE": Look("not decidable", "#ffffff", MUTED),
}
MODE = {
    "IDLE": Look("idle", "#ffffff", MUTED),
    "COLLECTING": Look("collecting", "#eceef0", MUTED),
    "CONTROLLING": Look("controlling", "#ffffff", MUTED),
    "HOLDING": Look("holding", "#fbe3bd", INK),
    "FALLBACK": Look("fallback", "#f2c0c9", INK, "///"),
    "SHADOW": Look("shadow", "#dfeaf5", MUTED),
}
PROPERTY = {
    "r_controllability": "R-controllable",
    "c_controllability": "C-controllable",
    "r_observability": "R-observable",
    "c_observability": "C-observable",
}
