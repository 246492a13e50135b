"""Verdicts of the geofencing paper: one row per item, computed from the runs."""

import numpy as np
import pytest

from alula.schemas.errors import InputError
from alula.stages.reporting.papers.geofencing_verdicts import paper_rows
from alula.stages.reporting.papers.verdicts import VERDICTS, PaperRow, verdict_table
from unit.reporting.papers.test_geofencing_tables import braking, flown, trial

MEASURED = {"times": {"regulation [us]": 1.5, "backup-qp [us]": 6.0, "solver quadprog [us]": 24.0}}


def rows(**least):
    runs = [
        flown("wall", "from-40", [trial(0, least.get("wall", 0.3), speed=30.0)], braking()),
        flown("fall", "fall", [trial(0, 0.3)], braking()),
        flown("engaged", "geofence", [trial(k, 0.3) for k in range(4)]),
        flown("pilots", "sticks-geofence", [trial(k, least.get("pilots", 0.4)) for k in range(6)]),
        flown("box", "silent", [trial(k, 0.4) for k in range(3)]),
    ]
    return {(row.item, row.quantity): row for row in paper_rows(runs, [], MEASURED, 332.3)}


def test_every_figure_and_section_of_the_paper_has_a_row():
    items = " ".join(item for item, _ in rows())
    for word in ("Figures 1", "Figure 3", "Figure 4", "Figure 5a", "Figure 5b", "Figure 6", "7a", "7b", "7c"):
        assert word in items
    for word in ("Figure 8", "Proposition 1", "Theorem 1", "IV-A", "V-A", "V-B", "V-C", "abstract"):
        assert word in items
    assert len(rows()) >= 25


def test_verdicts_follow_from_the_runs():
    found = rows()
    safe = found["Proposition 1", "flights that leave the safe set"]
    assert (safe.ours, safe.verdict) == ("0 of 9 random flights", "bounded")
    assert safe.interval.endswith("% of 9")
    assert rows(pilots=-0.1)["Proposition 1", safe.quantity].verdict == "refuted"
    time = found["V-B", "time of an evaluation on a Teensy 4.1"]
    assert time.ours.startswith("332.3 µs")
    assert time.verdict == "not comparable"
    zero = found["Figure 8, V-C", "λ never reaches 0"]
    assert (zero.verdict, zero.ours[:9]) == ("refuted", "in 100 % ")
    ratio = found["Figure 4, III-C", "time of the program over that of the regulation function"]
    assert ratio.ours == "4 with our program; all rows in a general solver: quadprog 20"
    assert found["abstract", "speeds at which the drone is held"].verdict == "reproduced"
    assert "no interval" in found["Figure 5a", "peak speed, simulation"].interval


def test_the_table_has_the_columns_of_the_other_papers_and_refuses_unknown_verdicts():
    table = verdict_table(list(rows().values()))
    assert table.columns == ("item", "quantity", "published", "ours", "95 % interval", "verdict", "why")
    assert {row[5] for row in table.rows} <= set(VERDICTS)
    with pytest.raises(InputError, match="a verdict is one of"):
        PaperRow("a", "b", "c", "d", "", "confirmed", "")
    assert np.array(table.rows, dtype=object).shape[1] == 7
