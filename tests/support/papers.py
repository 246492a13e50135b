"""Records of comparisons made by hand."""

from alula.schemas.manifest import Producer
from papers.compared import (
    COMPARISON_SCHEMA,
    COMPARISON_VERSION,
    ComparedFigure,
    ComparedValue,
    Comparison,
)
from papers.verdicts import PaperRow, exact

PRODUCER = Producer(name="alula", version="1.0", commit="abc")
SVG = (
    '<?xml version="1.0"?><svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 10 10" width="10pt">'
    '<path id="line" d="M0 0L9 9" style="fill: none; stroke: #0072b2"/></svg>'
)


def value(claim, quantity, row=None, *, setting="full", flights=6, command="make x", **changed):
    known = row or PaperRow("item", quantity, "1", exact(1.23456), "", "reproduced", "<why>")
    return ComparedValue(
        **{
            "claim": claim,
            "item": known.item,
            "quantity": quantity,
            "published": known.published,
            "ours": known.ours,
            "interval": known.interval,
            "verdict": known.verdict,
            "why": known.why,
            "numbers": list(known.numbers),
            "flights": flights,
            "command": command,
            "setting": setting,
            **changed,
        }
    )


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
    """Two rows of one claim, with intervals and values that are rounded."""
    ratio = f"× {exact(3.4567891, '.2f')}"
    bad = PaperRow(
        "i", "mean jerk, ratio", "× 0.53", ratio, f"{exact(3.1)} to {exact(3.87654)}", "refuted", "a"
    )
    good = PaperRow("i", "mean jerk, ratio", "× 0.53", f"× {exact(0.2)}", "", "better", "b & c")
    return [
        value(
            "mean-jerk", bad.quantity, bad, flights=500, command="make -C examples/fastbridge " + "x" * 200
        ),
        value("mean-jerk", good.quantity, good),
        value("proposition-1", "rates", flights=None),
    ]
