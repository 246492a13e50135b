"""Difficulty, tuning and verdicts of DR-ACBF against numbers counted by hand."""

import pytest

from papers.dracbf import difficulty
from papers.dracbf import figures as dracbf_figures
from papers.dracbf import verdicts as dracbf_verdicts
from papers.dracbf import warning as dracbf_warning
from papers.papers import DRACBF
from papers.verdicts import verdict_table
from support.flights.claims import open_claims, said
from support.flights.encounter_runs import flown, met, row_of, trial


def rows_of(runs, times):
    return said(DRACBF, dracbf_verdicts.verdict_rows(runs, times))


def of_rate(scenario, variant, good, count=20, **parameters):
    """A run in which the first `good` trials avoid obstacle 2 and all avoid obstacle 1."""
    trials = [trial(i, [met(), met(hit=i >= good)]) for i in range(count)]
    return flown(scenario, variant, trials, **parameters)


def setting(method, condition, name, good, braking, clearance, gain):
    own = "safety__dr_acbf__"
    names = [own + key.replace(".", "__") for key in (*difficulty.SHARED, difficulty.GAINS[method])]
    values = dict(zip(names, (braking, clearance, gain), strict=True))
    return of_rate("tune", f"{method}_{condition}_{name}", good, **values)


SWEPT = [
    of_rate("scenario-2", "dr-acbf", 20),
    of_rate("scenario-2", "mpc", 20),
    of_rate("difficulty", "dr-acbf_detection_0.5", 18),
    of_rate("difficulty", "dr-acbf_detection_0.4", 10),
    of_rate("difficulty", "mpc_detection_0.5", 20),
    of_rate("difficulty", "mpc_detection_0.4", 19),
]


def test_the_published_rate_is_found_by_interpolation():
    at = difficulty.levels(SWEPT)
    assert [level.value for level in at] == [0.95, 0.5, 0.4]
    # Means of the obstacles: 100, 95 and 75 %.
    assert difficulty.crossing(at, "dr-acbf", 85.0) == pytest.approx(0.45)
    assert difficulty.crossing(at, "mpc", 85.0) is None
    table = difficulty.difficulty_table(SWEPT)
    assert [line[1] for line in table.rows] == [0.95, 0.5, 0.4]
    assert table.rows[2][3] == 75
    assert table.rows[2][4] == 50
    assert "0.4: 50 %" in dracbf_figures.difficulty_figure(SWEPT, "detection").alt
    assert dracbf_figures.difficulty_figure(SWEPT, "noise") is None


def test_tuning_takes_the_highest_success_over_all_conditions_and_the_default_of_equals():
    runs = [
        setting("mpc", "missed", "6-3-1", 12, 6.0, 3.0, 0.02),
        setting("mpc", "late", "6-3-1", 12, 6.0, 3.0, 0.02),
        setting("mpc", "missed", "0-3-1", 20, 0.0, 3.0, 0.02),
        setting("mpc", "late", "0-3-1", 4, 0.0, 3.0, 0.02),
        setting("mpc", "missed", "0-3-2", 13, 0.0, 3.0, 0.04),
        setting("mpc", "late", "0-3-2", 12, 0.0, 3.0, 0.04),
    ]
    best = difficulty.chosen(runs, "mpc")
    assert best.options == (
        "safety.dr-acbf.obstacle_braking_m_s2=0",
        "safety.dr-acbf.clearance_m=3",
        "safety.dr-acbf.mpc.step_s=0.04",
    )
    assert best.success.value == pytest.approx(62.5)
    # 24 of 40 for the first two: the first of equals is the default.
    assert difficulty.chosen(runs[:4], "mpc").options[0].endswith("=6")
    assert row_of(difficulty.tuning_table(runs), "mpc")["default: runs [%]"] == 60


def test_methods_are_compared_in_the_same_trials():
    runs = [
        of_rate("hard", "dr-acbf_late_default", 100, 200, vehicle__actuation_delay_s=1.2),
        of_rate("hard", "mpc_late_default", 160, 200, vehicle__actuation_delay_s=1.2),
        of_rate("hard", "rp-cbf_late_default", 101, 200, vehicle__actuation_delay_s=1.2),
    ]
    table = difficulty.hard_table(runs)
    lines = {line[2]: dict(zip(table.columns, line, strict=True)) for line in table.rows}
    assert lines["mpc"]["difference to dr-acbf [points]"] == pytest.approx(30)
    assert lines["mpc"]["beside it"] == "better"
    assert lines["rp-cbf"]["beside it"] == "not apart"
    assert "vehicle.actuation_delay_s = 1.2" in table.note


def test_a_published_saving_below_our_interval_is_refuted_only_if_we_save_less():
    def verdict(value, low, high):
        found = {"value": value, "low": low, "high": high}
        rows = rows_of([], {"saved": {"rp_cbf_tick": found}})
        return next(row for row in rows if "against RP-CBF" in row.quantity)

    assert verdict(0.10, 0.08, 0.12).verdict == "refuted"
    assert verdict(0.30, 0.28, 0.33).verdict == "reproduced"
    assert verdict(0.60, 0.58, 0.62).verdict == "better"
    assert verdict(0.10, 0.08, 0.12).interval == "8 to 12 %"


def test_every_table_of_the_paper_has_rows_with_and_without_runs():
    items = ("Table I", "Table II", "Table III", "Table IV", "Table V", "(19) as printed", "(24) as printed")
    for runs in ([], SWEPT):
        rows = rows_of(runs, {})
        assert {row.item for row in rows} >= set(items)
        assert len(verdict_table(DRACBF, [row.found for row in rows]).rows) == len(rows)


def test_the_reaction_of_rp_cbf_is_refuted_when_its_first_command_differs():
    run = flown("scenario-1", "rp-cbf", [trial(i, [met(), met()]) for i in range(20)])
    rows = rows_of([run], {})
    row = next(r for r in rows if r.quantity == "t_r, RP-CBF, mean")
    assert (row.published, row.ours, row.verdict) == ("59.83 ms", "10 ms", "refuted")


def test_without_a_warning_no_reaction_is_judged():
    run = flown("scenario-1", "dr-acbf", [trial(i, [met(warned=None), met(warned=None)]) for i in range(20)])
    rows = [row for row in rows_of([run], {}) if row.quantity.startswith("t_r, DR-ACBF, ")]
    assert [(row.verdict, row.ours) for row in rows if "deviation" not in row.quantity] == [
        ("not available here", "")
    ] * 3


def test_the_closed_form_is_never_below_and_64_samples_are():
    ours, few = dracbf_warning.errors(0.1, 0.3, count=30)
    assert len(ours) > 8
    assert ours.min() > -0.005
    assert few.min() < -0.02


def late(trigger, good, **parameters):
    """A run in which commands act late, with one of the triggers."""
    condition = {
        "estimation__sensor__delay_s": 0.0,
        "vehicle__actuation_delay_s": 0.3,
        "estimation__sensor__noise_scale": 2.0,
        "estimation__sensor__rate_hz": 20.0,
        "estimation__sensor__detection_probability": 0.95,
        "safety__dr_acbf__trigger": trigger,
    }
    return of_rate("collapse", f"{trigger}_0_0.3", good, **condition, **parameters)


def test_every_claim_of_the_paper_has_a_row_and_every_row_a_claim():
    others = ("mpc", "cbf-qp", "rp-cbf", "dr-acbf-gs", "dr-acbf-qp", "eq-19", "eq-24", "safe-imm-on")
    changed = ("h-max-0.2", "h-max-0.8", "clearance-1", "clearance-4", "hold-0.1", "hold-0.4")
    triggers = ("trigger-simple-rows-late", "trigger-simple-long", "all-as-printed")
    runs = [
        *(of_rate("scenario-1", name, 20) for name in ("dr-acbf", *others, "all-as-printed")),
        *(of_rate("scenario-2", name, 20) for name in ("dr-acbf", *others, *changed, *triggers)),
        *(of_rate(name, "as-printed", 20) for name in ("thrown", "moving", "both")),
        *SWEPT[2:4],
        late("cvar", 20),
        late("simple", 2, safety__dr_acbf__rows_before_warning=False),
    ]
    rows = rows_of(runs, {})
    # Made by hand, the runs have no parameters of vehicles and obstacles.
    assert open_claims(DRACBF, rows) == {"vehicle", "scenario-1", "scenario-2", "crazyflie"}
    mean = next(row for row in rows if row.quantity == "v_cl, DR-ACBF, mean")
    assert (mean.published, mean.found.flights) == ("10.7 m/s", 20)
    assert mean.found.runs == ["scenario-1/dr-acbf.run.mcap"]


def test_a_run_that_is_missing_leaves_rows_that_say_so_for_each_of_its_claims():
    rows = rows_of([], {})
    tables = {c.name for c in DRACBF.claims if c.name.startswith(("table-1/", "table-2/", "table-3/"))}
    assert not open_claims(DRACBF, rows) & tables
    one = next(row for row in rows if row.quantity == "t_cp, MPC")
    assert (one.verdict, one.why) == ("not available here", "not flown in this run")
    assert (one.published, one.ours) == ("0.956 ± 0.666 ms", "")
