"""Records of comparisons made by hand."""

from alula.schemas.artifacts.manifest import Producer
from papers.compared import (
    COMPARISON_SCHEMA,
    COMPARISON_VERSION,
    Compared,
    ComparedFigure,
    Comparison,
)

PRODUCER = Producer(name="alula", version="1.0", commit="abc")
SVG = (
    '<?xml version="1.0"?><svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 10 10" width="10pt">'
    '<path id="line" d="M0 0L9 9" style="fill: none; stroke: #0072b2"/></svg>'
)


def value(row, verdict="reproduced", *, setting="full", flights=6, command="make x", **changed):
    known = {"verdict": verdict, "flights": flights, "command": command, "setting": setting}
    return Compared(row=row, **known, **changed)


def record(rows, figures=(), paper="fastbridge", setting="full"):
    return Comparison(
        schema=COMPARISON_SCHEMA,
        version=COMPARISON_VERSION,
        paper=paper,
        producer=PRODUCER,
        machine="a machine",
        command=f"make {setting}",
        setting=setting,
        rows=list(rows),
        figures=[
            ComparedFigure(name=name, title=f"Our {name}", description="in words", setting=setting)
            for name in figures
        ],
    )


def jerk_rows():
    """Two rows of one claim, with an interval and values that are rounded, and one without a flight."""
    bad = {"value": 3.4567891, "whose": "<why>", "speeds": "1"}
    good = {"value": 0.2, "whose": "b & c", "speeds": "2"}
    long = "make -C examples/fastbridge " + "x" * 200
    return [
        value("mean-jerk", "refuted", flights=500, command=long, values=bad, low=3.1, high=3.87654),
        value("mean-jerk", "better", values=good),
        value("proposition-1", flights=None),
    ]
