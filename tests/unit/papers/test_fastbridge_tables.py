"""The tables of FastBridge against numbers counted by hand."""

import math

import numpy as np
import pytest

from alula.schemas.errors import InputError
from alula.stages.reporting.material import Run
from papers.fastbridge import figures as fastbridge_figures
from papers.fastbridge import tables as fastbridge
from papers.fastbridge.sweeps import Sweep, compare, succeeded
from papers.fastbridge.tables import comparison_table, flight_tables, gap_table, ratio_table
from support.flights.sweeps import sweep, trial


@pytest.fixture
def pair():
    theirs = [trial(0, jerk=4.0), trial(1, "timeout", jerk=6.0), trial(2, collision=True, jerk=2.0)]
    ours = [trial(0, jerk=1.0, speed=2.0), trial(1, jerk=3.0, speed=2.0), trial(2, jerk=1.0, speed=2.0)]
    return sweep("cone-ecbf", 2.1, ours), sweep("safer-splat", 2.1, theirs, seconds=1e-3)


def test_ratios_are_of_sums_over_the_same_pairs(pair):
    ours, theirs = pair
    found = compare([ours], [theirs])
    assert found.mean_jerk is not None
    assert found.mean_jerk.value == pytest.approx(5 / 12)
    assert found.mean_jerk.low <= 5 / 12 <= found.mean_jerk.high
    assert found.filter_time == pytest.approx(0.1)
    assert found.goals is not None
    assert found.goals.value == pytest.approx(2 / 3)
    assert found.top_speed is not None
    assert found.top_speed.value == pytest.approx(1.0)


def test_runs_over_other_pairs_are_not_compared(pair):
    ours, theirs = pair
    moved = sweep("cone-ecbf", 2.1, [trial(i, start_m=[0.1, 0.0, 1.0]) for i in range(3)])
    with pytest.raises(InputError, match="same pairs"):
        compare([moved], [theirs])
    with pytest.raises(InputError, match="same pairs"):
        compare([ours, moved], [theirs, theirs])


def test_a_pair_counts_only_where_both_flights_qualify(pair):
    ours, theirs = pair
    found = compare([ours], [theirs], succeeded)
    assert found.mean_jerk is not None
    assert (found.mean_jerk.value, found.mean_jerk.n) == (pytest.approx(0.25), 1)
    assert found.goals is None  # both reached theirs


def records_of(table):
    """Rows as records by column; the first of columns with the same name."""
    assert all(len(row) == len(table.columns) for row in table.rows)
    columns = list(reversed(table.columns))
    return [dict(zip(columns, reversed(row), strict=True)) for row in table.rows]


def test_the_comparison_has_both_filters_and_the_published_ones(pair):
    theirs, ours, *published = records_of(comparison_table(pair))
    assert (theirs["filter"], ours["filter"]) == ("safer-splat", "cone-ecbf")
    assert (theirs["settings"], ours["settings"]) == ("published", "ours")
    assert (theirs["goal rate"], ours["goal rate"]) == (pytest.approx(1 / 3), 1.0)
    assert [theirs[key] for key in ("trials", "reached", "collided", "neither")] == [3, 1, 1, 1]
    assert ours["filter, mean [µs]"] == pytest.approx(100)
    assert [(row["scene"], row["top speed [m/s]"]) for row in published] == [
        ("published", 3.5),
        ("published", 4.5),
    ]


def test_ratios_have_a_table_of_their_own(pair):
    found, both, published = records_of(ratio_table(pair))
    assert (found["filters"], found["flights"], found["pairs"]) == ("cone-ecbf : safer-splat", "all", 3)
    assert found["mean jerk, ratio"] == pytest.approx(5 / 12)
    assert found["filter time, ratio"] is None  # one has rows within a gate, the other of every ellipsoid
    assert found["goal rate, difference"] == pytest.approx(2 / 3)
    assert (both["pairs"], both["mean jerk, ratio"]) == (1, pytest.approx(0.25))
    assert both["95 % low"] is None  # of one pair
    assert both["goal rate, difference"] is None
    assert published["mean jerk, ratio"] == 0.53
    assert published["top speed, difference [m/s]"] == pytest.approx(1.0)


def test_times_are_compared_only_like_for_like(pair):
    ours, theirs = pair
    gated = Sweep("room", "safer-splat-gated", 2.1, theirs.run)
    alike = [row for row in records_of(ratio_table([ours, gated])) if row["scene"] == "room"]
    assert alike[0]["filter time, ratio"] == pytest.approx(0.1)
    assert all("every ellipsoid" not in row["maps"] for row in alike)
    unlike = [row for row in records_of(ratio_table(pair)) if row["scene"] == "room"]
    assert [row["filter time, ratio"] for row in unlike] == [None, None]
    assert all("every ellipsoid" in row["maps"] for row in unlike)
    words = fastbridge.in_short([ours, theirs, gated])
    assert [("filter time" in text, "safer-splat-gated" in key) for key, text in words.items()] == [
        (True, True),
        (False, False),
    ]


def test_every_filter_that_is_compared_has_words_for_its_settings():
    assert {variant for pair in fastbridge.PAIRED for variant in pair} <= fastbridge.SETTINGS.keys()
    assert "safer-splat-gated-cones" in fastbridge.COMPARED


def test_ratios_are_of_all_speeds_and_of_each():
    runs = [
        sweep(variant, speed, [trial(i, mean_jerk_m_s3=jerk * speed) for i in range(3)])
        for variant, jerk in (("cone-ecbf", 1.0), ("safer-splat", 4.0))
        for speed in (1.0, 2.0)
    ]
    rows = [row for row in records_of(ratio_table(runs)) if row["flights"] == "all"][:-1]
    assert [row["reference speed [m/s]"] for row in rows] == ["all", 1.0, 2.0]
    assert [row["mean jerk, ratio"] for row in rows] == [pytest.approx(0.25)] * 3


def test_a_collision_on_the_way_to_the_goal_is_not_a_success():
    hit = sweep("cone-di", 1.0, [trial(0, collision=True), trial(1), trial(2, "stuck")])
    (row,) = records_of(gap_table([hit]))
    assert [row[key] for key in ("trials", "reached", "collided", "neither")] == [3, 1, 1, 1]


def test_the_gap_names_its_extremes():
    runs = [sweep("cone-di", v, [trial(i) for i in range(4)]) for v in (1.1, 0.5)]
    table = gap_table(runs)
    assert [row[2] for row in table.rows] == [0.5, 1.1]
    row = dict(zip(table.columns, table.rows[0], strict=False))
    assert row["peak |e_a|, mean [m/s²]"] == pytest.approx(1.25)
    assert row["maximum"] == 2.0
    assert row["minimum γ of all"] == pytest.approx(0.2)
    assert all(len(row) == len(table.columns) for row in table.rows)


def test_the_flight_table_counts_ticks_and_keeps_the_published_row_apart(pair):
    flights, loops = flight_tables(pair, "figure-4", "Figure 4", published=True)
    assert (flights.name, loops.name) == ("figure-4", "figure-4-loop")
    ours, published = records_of(loops)[0], records_of(loops)[-1]
    assert ours["ticks"] == 300
    assert ours["infeasible"] == 9
    assert ours["feasible, fraction"] == pytest.approx(0.97)
    assert ours["on the backup, fraction"] == pytest.approx(15 / 300)
    assert ours["certified, fraction"] == 1
    assert ours["loop p99 [µs]"] == pytest.approx(300)
    assert published["ticks"] == 822
    assert published["loop p99 [µs]"] == 21043
    ours, theirs, published = records_of(flights)
    assert ours["mean speed [m/s]"] == pytest.approx(7.5 / 3)
    assert (theirs["collided"], theirs["minimum clearance [m]"]) == (1, -0.01)
    assert published["minimum clearance [m]"] == 0.154


def test_an_ablation_says_what_it_changed_and_who_has_no_shield():
    base = sweep("cone-ecbf", 1.0, [trial(0)])
    own = {"policy": "brake", "shield": False, "count": 16}
    bare = {"safety": {"filters": ["cone-ecbf"], "cone-ecbf": own}, "name": "mine"}
    other = sweep("ecbf-bare", 1.0, [trial(0)], parameters=bare, filter_name="cone-ecbf")
    foreign = sweep(
        "cone-di", 1.0, [trial(0)], parameters={"safety": {"filters": ["cone-di"], "cone-di": {"alpha": 3.0}}}
    )
    flights, loops = flight_tables([base, other, foreign], "a", "A", bases=[base])
    assert [row["changed"] for row in records_of(flights)] == ["–", "count 16, shield no", None]
    fractions = [(row["on the backup, fraction"], row["certified, fraction"]) for row in records_of(loops)]
    assert fractions == [(0.05, 1.0), (0.05, None), (None, None)]


def test_rounding_is_no_realisation_error():
    exact = sweep("cone-ecbf", 1.0, [trial(i, peak_realisation_error_m_s2=3e-15) for i in range(3)])
    (row,) = records_of(gap_table([exact]))
    assert (row["peak |e_a|, mean [m/s²]"], row["maximum"]) == (0, 0)


def test_a_run_without_times_has_none(pair):
    ours, theirs = pair
    bare = Sweep("room", "cone-ecbf", 2.1, Run("x", _without_timing(ours.run.record)))
    assert compare([bare], [theirs]).filter_time is None
    (row,) = records_of(flight_tables([bare], "t", "T")[1])
    assert row["loop p99 [µs]"] is None


def _without_timing(record):
    import msgspec

    return msgspec.structs.replace(record, timing=None)


def test_figures_say_what_they_show(pair):
    gap = fastbridge_figures.gap_figure(
        [sweep("cone-di", v, [trial(0), trial(1)]) for v in (1.1, 2.1)], "room"
    )
    assert "cone-di: from 0.75 at 1.1 m/s to 0.75 at 2.1 m/s" in gap.alt
    figure = fastbridge_figures.comparison_figure(pair, "room")
    assert figure.svg.startswith("<?xml")
    assert "safer-splat: mean jerk" in figure.alt
    assert fastbridge_figures.paths_figure(pair, "room", 0) is None  # no logs were read
    assert fastbridge_figures.telling_trial(pair, "room") == 0


def test_the_line_in_short_gives_percent_below_the_baseline(pair):
    (words,) = fastbridge.in_short(pair).values()
    assert words.startswith("mean jerk × 0.42 (")
    assert words.endswith("top speed +1.00 m/s (equal in all 3 pairs), collisions 0 against 1")


def test_values_that_are_missing_become_nan():
    found = sweep("none", 1.0, [trial(0, min_gamma=None)]).values(lambda t: t.min_gamma)
    assert math.isnan(found[0])
    assert found.dtype == np.float64
