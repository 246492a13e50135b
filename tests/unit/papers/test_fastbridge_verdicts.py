"""The verdicts on FastBridge's numbers, from runs whose answer is known."""

import pytest

from papers.fastbridge.feasibility import feasibility_table
from papers.fastbridge.verdicts import verdict_rows
from papers.papers import FASTBRIDGE
from papers.verdicts import verdict_table
from support.flights.claims import open_claims, said
from support.flights.sweeps import sweep, trial


@pytest.fixture(scope="module")
def feasibility():
    return feasibility_table(25)


def rows_of(sweeps, feasibility):
    return said(FASTBRIDGE, verdict_rows(sweeps, "room", feasibility))


def one(rows, quantity, why=""):
    (found,) = (row for row in rows if row.quantity.startswith(quantity) and why in row.why)
    return found


def test_the_backup_policy_meets_the_condition_but_not_every_row(feasibility):
    condition = [row[3] for row in feasibility.rows]
    every_row = {row[1]: row[4] for row in feasibility.rows if "printed" in row[0]}
    assert condition == [25] * len(condition)
    assert every_row[2.0] == 0  # below twice the slowest pole
    assert every_row[2.0] < every_row[3.0] <= every_row[10.0] <= every_row[20.0]


def test_a_page_without_flights_still_has_a_row_for_all_that_cannot_be_flown(feasibility):
    rows = rows_of([], feasibility)
    lone = [sweep("cone-ecbf", 3.1, [trial(0)])]  # one speed shows no growth
    assert not [row for row in rows_of(lone, feasibility) if row.item == "Figure 2, left"]
    assert "mean-jerk" in open_claims(FASTBRIDGE, rows)
    assert one(rows, "loop overruns").verdict == "not available here"
    assert one(rows, "π_b meets").verdict == "reproduced"
    assert one(rows, "π_b is a feasible point of the program, α_R = 2/s").verdict == "refuted"
    assert len(verdict_table(FASTBRIDGE, [row.found for row in rows]).rows) == len(rows)


@pytest.mark.parametrize(("jerk", "verdict"), [(0.3, "better"), (0.53, "reproduced"), (0.9, "refuted")])
def test_a_ratio_is_judged_by_its_interval(feasibility, jerk, verdict):
    theirs = [trial(i, jerk=1 + 0.1 * (i % 5)) for i in range(20)]
    ours = [trial(i, jerk=jerk * (1 + 0.1 * ((i + 1) % 5))) for i in range(20)]
    runs = [
        sweep("ecbf-gate-3m", 3.1, ours, seconds=3e-4),
        sweep("safer-splat-gated-3m", 3.1, theirs, seconds=1e-4),
    ]
    rows = rows_of(runs, feasibility)
    assert one(rows, "mean jerk, ratio").verdict == verdict
    time = one(rows, "time of the filter")
    assert (time.ours, time.verdict) == ("× 3.00", "refuted")


def test_times_are_not_judged_against_a_filter_with_a_row_for_every_ellipsoid(feasibility):
    runs = [sweep("cone-ecbf", 3.1, [trial(0)]), sweep("safer-splat", 3.1, [trial(0)], seconds=1.0)]
    assert not [row for row in rows_of(runs, feasibility) if row.quantity.startswith("time of the filter")]


def test_a_collision_refutes_that_safety_is_not_compromised(feasibility):
    runs = [
        sweep("cone-ecbf", 5.1, [trial(i) for i in range(4)]),
        sweep("safer-splat-gated-3m", 5.1, [trial(0), trial(1, collision=True)]),
    ]
    rows = rows_of(runs, feasibility)
    assert one(rows, "collisions of cone-ecbf").verdict == "reproduced"
    bad = one(rows, "collisions of safer-splat-gated-3m")
    assert (bad.ours, bad.verdict) == ("1 of 2 flights", "refuted")
    assert one(rows, "goals of cone-ecbf at a reference of 5.1 m/s").verdict == "better"  # 4 reached


def test_an_error_that_grows_is_not_near_zero_at_every_speed(feasibility):
    def at(speed, error):
        return sweep(
            "cone-ecbf",
            speed,
            [trial(i, peak_realisation_error_m_s2=error + 0.01 * i, min_gamma=1.0) for i in range(9)],
        )

    assert one(rows_of([at(1.1, 0.2), at(5.1, 3.0)], feasibility), "peak |e_a| of cone-ecbf").verdict == (
        "refuted"
    )
    assert one(rows_of([at(1.1, 0.2), at(5.1, 0.2)], feasibility), "peak |e_a| of cone-ecbf").verdict == (
        "reproduced"
    )


FLOWN = (
    *(
        "ideal-di",
        "cone-di",
        "cone-ecbf",
        "cone-backup",
        "ecbf-gate-3m",
        "safer-splat",
        "safer-splat-gated-3m",
    ),
    *("printed-ecbf-14-clf", "printed-ecbf-4", "printed-backup", "printed-backup-split"),
)


def test_every_claim_of_the_paper_has_a_row_and_every_row_a_claim(feasibility):
    runs = [sweep(name, speed, [trial(i) for i in range(3)]) for name in FLOWN for speed in (1.1, 5.1)]
    rows = rows_of(runs, feasibility)
    assert open_claims(FASTBRIDGE, rows) == set()
    gap = next(row for row in rows if row.quantity.startswith("peak |e_a| of cone-di"))
    assert gap.found.runs == ["room/cone-di@1.1.run.mcap", "room/cone-di@5.1.run.mcap"]
    assert gap.found.flights == 6
    assert [n.value for n in gap.numbers if n.cell == "ours"] == [1.0, 1.0]  # the mean of 0.5, 1 and 1.5
