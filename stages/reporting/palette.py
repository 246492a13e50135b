"""Colours of a report: one for each outcome, one for each run, the same on every page and in every figure.

All are of the palette of Okabe and Ito (2008), whose colours people with any kind of colour blindness tell
apart. Outcomes also differ in dashes, ends and words, so that no meaning hangs on a colour alone.

Figures are drawn in the light colours. A page shows them in its own: `themed` replaces the colours of an SVG
by the style sheet's variables, which have other values in the dark.
"""

from __future__ import annotations

import re

from alula.schemas.log.run import PLAN_OUTCOMES
from alula.stages.reporting.material import NOT_JUDGED

BLUE, SKY, GREEN, ORANGE, PURPLE, VERMILLION = (
    "#0072b2",
    "#56b4e9",
    "#009e73",
    "#e69f00",
    "#cc79a7",
    "#d55e00",
)
GREY, INK, SOFT, AXIS, GRID, BLACK = "#7f7f7f", "#1c2430", "#5b6673", "#8a9099", "#e6e8eb", "#222222"

COLORS = {
    "reached": BLUE,
    "passed": GREEN,
    "held": BLUE,
    "stuck": ORANGE,
    "timeout": PURPLE,
    "refused": GREY,
    "stopped": PURPLE,
    "missed-via": ORANGE,
    "off-plan": PURPLE,
    "collision": VERMILLION,
    NOT_JUDGED: GREY,
    "planned": BLACK,
}
DASHES = (
    dict.fromkeys(COLORS, "-")
    | {"stuck": "--", "timeout": "-.", "refused": ":", "stopped": "--", NOT_JUDGED: "--"}
    | dict.fromkeys(PLAN_OUTCOMES, ":")
)
RUN_COLORS = (BLUE, ORANGE, GREEN, PURPLE, SKY, VERMILLION, BLACK)

_DARK = {
    BLUE: "#4da9dd",
    SKY: "#8ccbf2",
    GREEN: "#2fbf92",
    ORANGE: "#f0b432",
    PURPLE: "#dc97bd",
    VERMILLION: "#ef7f32",
    GREY: "#9aa3ad",
    INK: "#e4e8ed",
    SOFT: "#a3adb9",
    AXIS: "#6d7783",
    GRID: "#2c333c",
    BLACK: "#dfe3e8",
}
_IN_STYLE = re.compile("(: ?)(" + "|".join(_DARK) + r")(?=[;\"])")


def run_color(number: int) -> str:
    """Colour of a run by its place in the report, from 0."""
    return RUN_COLORS[number % len(RUN_COLORS)]


def variables(*, dark: bool) -> str:
    """The colours as variables of a style sheet."""
    return " ".join(f"--c{light[1:]}: {other if dark else light};" for light, other in _DARK.items())


def themed(svg: str) -> str:
    """Replace the colours of an SVG by variables of the page that it becomes part of."""
    return _IN_STYLE.sub(lambda found: f"{found[1]}var(--c{found[2][1:]})", svg)
