"""The tables of DR-ACBF against numbers counted by hand, and its analysis against closed forms."""

import math

import pytest

from alula import _core
from alula.stages.reporting.table import Table, folded, text
from alula.stages.verdict import wilson_interval
from papers.dracbf import analysis as dracbf_analysis
from papers.dracbf import figures as dracbf_figures
from papers.dracbf import tables as dracbf
from papers.published import DRACBF, DRACBF_PRINTED
from support.flights.encounter_runs import flown, met, row_of, trial

FREE = flown(
    "scenario-1",
    "none",
    [trial(i, [met(hit=i < 2, warned=None), met(hit=True, warned=None)]) for i in range(4)],
)
OURS = flown(
    "scenario-1",
    "dr-acbf",
    [
        trial(0, [met(hit=True), met()], risk=0.5),
        trial(1, [met(), met(separation=None, warned=None)], risk=0.1),
        trial(2, [met(), met(hit=True)], risk=3.0),
        trial(3, [met(), met(separation=2.5, reaction=0.02)], risk=0.0),
    ],
)
QP = flown("scenario-1", "dr-acbf-qp", OURS.record.trials, mean_s=2e-5)


def test_success_is_counted_per_obstacle_and_per_run_beside_what_is_published():
    tables = {t.name: t for t in dracbf.group_tables([FREE, OURS, QP])}
    row = row_of(tables["table-1"], "dr-acbf")
    assert (row["obstacle 1 [%]"], row["obstacle 2 [%]"], row["runs [%]"]) == (75, 75, 50)
    low, high = wilson_interval(2, 4)
    assert tables["table-1"].rows[1][-4:-2] == pytest.approx((100 * low, 100 * high))
    assert (row["published: 1 [%]"], row["published: 2 [%]"]) == (99.48, 99.80)
    # Obstacle 1 hits in trials 0 and 1 without a filter, of which the second was avoided; obstacle 2 in all
    # four.
    assert row["unfiltered hits avoided, 1 [%]"] == 50
    assert row["unfiltered hits avoided, 2 [%]"] == 75
    assert row_of(tables["table-1"], "none")["unfiltered hits avoided, 1 [%]"] == 0


def test_times_are_in_milliseconds_and_over_the_first():
    tables = {t.name: t for t in dracbf.group_tables([FREE, OURS, QP])}
    row = row_of(tables["table-1-times"], "dr-acbf-qp")
    assert row["t_cp mean [ms]"] == pytest.approx(0.02)
    assert row["p50 / first row"] == pytest.approx(2)
    assert row["t_cm [ms]"] == pytest.approx(0.02)
    # Seven warnings react in the same tick, so by its end; one two ticks later.
    assert row["t_r in whole ticks [ms]"] == pytest.approx((6 * 10 + 30) / 7)
    assert "none" not in {line[0] for line in tables["table-1-times"].rows}


def test_separation_is_over_those_that_were_warned_of_and_over_all():
    tables = {t.name: t for t in dracbf.group_tables([FREE, OURS, QP])}
    rows = [line for line in tables["table-1-separation"].rows if line[0] == "dr-acbf"]
    second = dict(zip(tables["table-1-separation"].columns, rows[1], strict=True))
    assert second["warnings"] == 3
    assert second["d_s, avoidance window [m]"] == pytest.approx((1.5 + 1.5 + 2.5) / 3)
    assert second["d_cpa, whole run [m]"] == pytest.approx((3 * 2.0 + 0.1) / 4)
    assert second["published: d_s"] == 6.64


def test_a_published_value_is_the_same_in_our_tables_and_in_the_paper_s():
    closing = {name: row["v_cl"][1] for name, row in DRACBF_PRINTED["table-1"].items()}
    assert {name: row["closing_2"] for name, row in DRACBF["scenario-1"].items()} == closing
    assert closing["cbf-qp"] == 11


def test_a_table_without_two_runs_is_left_out():
    assert dracbf.group_tables([OURS]) == []
    assert dracbf.hardware_tables([OURS]) == []
    assert dracbf.wall_table([OURS]) is None
    assert dracbf_analysis.collapse_table([OURS]) is None
    assert dracbf.sensitivity_table([OURS], "sensitivity-1") is None


def test_a_choice_is_named_by_what_it_changes():
    base = flown("sensitivity-1", "dr-acbf", [trial(i, [met(), met()]) for i in range(40)])
    worse = flown(
        "sensitivity-1",
        "jerk-20",
        [trial(i, [met(hit=True), met()]) for i in range(40)],
        vehicle__max_jerk_m_s3=20.0,
    )
    table = dracbf.sensitivity_table([base, worse], "sensitivity-1")
    row = row_of(table, "jerk-20")
    assert row["changed"] == "vehicle.max_jerk_m_s3 20"
    assert (row["runs [%]"], row["against the first row"]) == (0, "apart")
    assert row_of(table, "dr-acbf")["changed"] == "as specified"


def test_the_times_of_a_small_vehicle_are_from_detection_and_to_the_end_of_hovering():
    run = flown("thrown", "as-printed", [trial(0, [met(warned=3.0, reaction=0.02)])])
    (table,) = dracbf.hardware_tables([run])
    assert table.name == "table-4"
    row = row_of(table, "thrown")
    assert row["t_d [ms]"] == pytest.approx(2020)
    assert row["t_a [ms]"] == pytest.approx(500)
    assert row["t_r, to the next tick [ms]"] == pytest.approx(30)
    assert row["published: t_d"] == 3209


def test_walls_that_are_touched_count():
    run = flown("wall", "dr-acbf", [trial(i, [met()], clearance=c) for i, c in enumerate((0.5, -0.1, 0.2))])
    row = row_of(dracbf.wall_table([run]), "dr-acbf")
    assert (row["trials that touch a wall"], row["minimum clearance to walls [m]"]) == (1, -0.1)
    assert row["obstacle [%]"] == 100
    assert row["runs [%]"] == pytest.approx(200 / 3)


def condition(trigger, delay, hits, always=None):
    return flown(
        "collapse",
        f"{trigger}_{delay}",
        [trial(i, [met(hit=i < hits)]) for i in range(10)],
        safety__dr_acbf__trigger=trigger,
        safety__dr_acbf__rows_before_warning=trigger == "cvar" if always is None else always,
        estimation__sensor__delay_s=delay,
        vehicle__actuation_delay_s=0.3,
        estimation__sensor__noise_scale=2.0,
        estimation__sensor__rate_hz=20.0,
        estimation__sensor__detection_probability=0.95,
    )


def test_a_trigger_collapses_where_it_fails_most_runs_and_the_other_does_not():
    runs = [
        *(condition("cvar", 0.0, 0), condition("simple", 0.0, 0)),
        *(condition("cvar", 0.4, 1), condition("simple", 0.4, 6)),
        *(condition("cvar", 0.8, 7), condition("simple", 0.8, 8)),
        condition("simple", 0.4, 2, always=True),
        condition("cvar", 1.6, 0),  # without the other
    ]
    cells = dracbf_analysis.collapse_cells(runs)
    assert [cell.delay_s for cell in cells] == [0.8, 0.4, 0.0]
    assert [dracbf_analysis.has_collapsed(cell) for cell in cells] == [False, True, False]
    table = dracbf_analysis.collapse_table(runs)
    assert [row[-1] for row in table.rows] == ["", "collapses", ""]
    assert [row[11] for row in table.rows] == [None, 80, None]
    line = dracbf_analysis.in_short(runs)["simple trigger"]
    assert "collapses in 1 of 3 conditions: 1 with an actuation delay, 0 without it" in line
    assert "0.4 + 0.3 s, ×2, 20 Hz, 0.95" in dracbf_figures.collapse_figure(runs).svg


@pytest.mark.parametrize("speed", [0.5, 3.0, 8.0])
@pytest.mark.parametrize("horizon", [0.15, 0.4])
def test_a_row_followed_exactly_undershoots_as_the_closed_form_says(speed, horizon):
    found = dracbf_analysis.stop(speed, horizon)
    scale = speed * horizon
    assert found.undershoot_m == pytest.approx(math.sqrt(0.5) * math.exp(-0.75 * math.pi) * scale, rel=0.01)
    assert -found.command_m_s2.min() == pytest.approx(
        math.sqrt(2) * math.exp(-math.pi / 4) * speed / horizon, rel=1e-3
    )
    assert found.time_s[-1] == pytest.approx(0.75 * math.pi * horizon, rel=2e-3)


def test_the_box_binds_only_above_the_recursive_speed():
    limit = _core.recursive_speed(6.0, 0.4)
    assert limit == pytest.approx(6 * 0.4 / 0.64479, rel=1e-4)
    for speed in (0.5 * limit, 0.999 * limit):
        free, boxed = dracbf_analysis.stop(speed, 0.4), dracbf_analysis.stop(speed, 0.4, 6.0)
        assert boxed.undershoot_m == free.undershoot_m
    fast = dracbf_analysis.stop(1.5 * limit, 0.4, 6.0)
    assert fast.undershoot_m > 1.2 * dracbf_analysis.stop(1.5 * limit, 0.4).undershoot_m
    with pytest.raises(ValueError, match="positive"):
        dracbf_analysis.stop(0.0, 0.4)


def test_the_recursion_table_says_how_many_warnings_the_rows_alone_could_answer():
    table = dracbf_analysis.recursion_table([OURS])
    fraction = [row[-1] for row in table.rows]
    assert fraction[0] == 0  # all warnings came at 10 m/s
    assert [row[1] for row in table.rows] == sorted(row[1] for row in table.rows)


def test_the_bound_of_a_run_is_capped_and_held_against_collisions():
    trials = OURS.record.trials
    one = dracbf_analysis.risk_bins(trials, 1)[0]
    assert one.estimate == pytest.approx((0.5 + 0.1 + 1.0 + 0.0) / 4)
    assert one.bound == 0.75
    assert one.observed.value == 50
    least = dracbf_analysis.risk_bins(trials, 4)[0]
    assert (least.estimate, least.observed.value) == (0, 0)
    assert len(dracbf_analysis.risk_table([OURS]).rows) == 4 + 1
    bare = flown("scenario-1", "mpc", [trial(0, [met()], risk=0.2, spent=None)])
    table = dracbf_analysis.risk_table([OURS, bare])
    mpc = dict(zip(table.columns, table.rows[-1], strict=True))
    assert (mpc["variant"], mpc["mean estimate [%]"], mpc["mean bound of rows [%]"]) == ("mpc", 20, None)
    assert text(mpc["mean bound of rows [%]"]) == "–"
    optimist = flown(
        "scenario-1", "dr-acbf", [trial(i, [met(hit=True), met()], risk=0.01) for i in range(50)]
    )
    assert {row[-1] for row in dracbf_analysis.risk_table([optimist]).rows} == {"TOO SMALL"}
    assert "risk" in dracbf_figures.risk_figure([OURS]).name


def test_figures_say_what_they_show():
    shown = dracbf_figures.success_figure([FREE, OURS, QP], "scenario-1")
    assert "dr-acbf 75 %" in shown.alt
    assert dracbf_figures.success_figure([], "scenario-1") is None
    assert dracbf_figures.risk_figure([]) is None
    assert dracbf_figures.collapse_figure([]) is None
    assert "3.72" in dracbf_figures.stop_figure().alt
    assert dracbf_figures.recursion_figure().svg.startswith("<?xml")


def test_it_is_said_whether_what_was_asked_for_is_met():
    facts = dracbf_analysis.in_short([FREE, OURS, QP])
    assert "BELOW 99.6 %" in facts["dr-acbf, scenario-1"]
    assert "obstacle 2 0 %" in facts["without a filter, scenario-1"]
    good = flown("scenario-2", "dr-acbf", [trial(i, [met(), met()]) for i in range(5)])
    assert "at least 82.5 %" in dracbf_analysis.in_short([good])["dr-acbf, scenario-2"]


def test_what_was_infeasible_or_missed_is_of_all_ticks_and_of_filters_with_rows():
    tables = {t.name: t for t in dracbf.group_tables([FREE, OURS, QP])}
    table = tables["table-1-separation"]
    found = {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.rows}
    fraction, worst = "ticks with infeasible rows [%]", "worst violation [m/s²]"
    assert (found["dr-acbf"][fraction], found["dr-acbf"][worst]) == (2, 0.25)  # 2 of 100 ticks
    assert (found["none"][fraction], found["none"][worst]) == (None, None)


def test_shares_are_read_with_their_intervals_in_one_cell():
    table = Table(
        "t",
        "T",
        ("who", "a [%]", "95 % low", "95 % high", "b"),
        (("x", 50.0, 20.0, 80.0, 3), ("y",) + 4 * (None,)),
    )
    read = folded(table)
    assert read.columns == ("who", "a [%] (95 %)", "b")
    assert read.rows == (("x", "50\u00a0(20\u00a0to\u00a080)", 3), ("y", None, None))
    assert table.rows[0][1:4] == (50.0, 20.0, 80.0)


def test_the_effort_is_counted_from_what_was_flown():
    assert dracbf.effort([OURS]) == "4 trials in 1 runs"
    timed = flown("scenario-1", "dr-acbf", OURS.record.trials)
    timed.record.timing.update(trials_flown=4, wall_s=0.04)
    assert "8 trials in 2 runs" in dracbf.effort([timed, OURS])
    assert "at 100 trials a second" in dracbf.effort([timed, OURS])
