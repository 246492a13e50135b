"""Reports on flights in a fence: rows, columns, windows, the closest flight."""

import dataclasses

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from alula.schemas.artifacts.manifest import Guarantee, producer
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.log.flights import Flight
from alula.schemas.log.run import FenceResult, RunRecord, TrialResult
from alula.stages.reporting.brief import brief
from alula.stages.reporting.curves import flight_maps
from alula.stages.reporting.fenced import fence_rows, fence_shape, is_fenced
from alula.stages.reporting.figures import all_figures, window
from alula.stages.reporting.flight_curves import worst_flights
from alula.stages.reporting.flight_figures import flight_figures
from alula.stages.reporting.headline import headline
from alula.stages.reporting.material import Material, Run, outcome_of
from alula.stages.reporting.tables import all_tables, runs_table, to_csv, trials_table
from alula.stages.runlog.maps import SHOWN_BEYOND_M
from alula.stages.show.still import draw

FENCE = {"box_m": [-10.0, -10, 0, 10, 10, 20], "faces": []}


def trial(index, distance):
    fence = FenceResult(
        passed_steps=60, blended_steps=30, backup_steps=10, no_pilot_steps=0, hand_over_steps=0,
        refused_steps=0, interventions=1, altered_passes=0, out_of_range=0, longest_backup_s=0.1,
        min_lambda=0.0, min_h_i_m=-0.1, brake_distance_m=6.0, stop_distance_m=None,
    )  # fmt: skip
    return TrialResult(
        index=index, start_m=[0, 0, 5], goal_m=[9, 0, 5], outcome="held",
        collision=distance < 0, steps=100, duration_s=1.0, path_length_m=9.5, straight_length_m=9.0,
        map_clearance_m=None, scene_clearance_m=None, max_speed_m_s=10.0, filtered_steps=40,
        shortened_steps=0, infeasible_steps=0, fallback_steps=10, mean_jerk_m_s3=1.0, max_jerk_m_s3=2.0,
        fence=fence, fence_clearance_m=distance, stale_steps=0,
    )  # fmt: skip


def flight(end, status=("passed", "blended", "backup", "backup", "blended")):
    time = np.linspace(0, 1, 5)
    place = np.column_stack([end * time, 0.1 * time, 5 + time])
    return Flight(
        time_s=time, position_world=place, speed_m_s=10 * time, margin_time_s=time, margin=10 - place[:, 0],
        margin_unit="of h", status=status, regulation=np.array([1, 0.5, 0, 0, 0.5]),
        fence_distance_m=10 - place[:, 0],
    )  # fmt: skip


def run_of(distances, fence=FENCE, flights=None):
    trials = [trial(index, distance) for index, distance in enumerate(distances)]
    out = sum(t.collision for t in trials)
    figures = {
        "violations": out, "min_distance_m": min(distances), "passed": 60 * len(trials),
        "backup": 10 * len(trials), "max_speed_km_h": 36.0, "interventions": len(trials),
        "engaged_trials": len(trials),
    }  # fmt: skip
    summary = {
        "success_rate": 1 - out / len(trials), "success_interval": [0.1, 0.9], "collisions": out,
        "worst_trial": int(np.argmin(distances)), "fence": figures,
    }  # fmt: skip
    parameters = {"world": {"fence": fence}, "safety": {"filters": ["geofence"]}}
    made = Provenance(
        schema="alula/run", version="1.0", producer=producer(), parameters=parameters, seed=0, inputs=[]
    )
    record = RunRecord(
        schema="alula/run", version="1.0", provenance=made, name="r", filter="geofence", vehicle="racer",
        trials=trials, summary=summary, guarantee=Guarantee("s", {}),
    )  # fmt: skip
    return Run("r", record, {0: flight(8.0), 1: flight(11.0)} if flights is None else flights)


def test_a_fence_that_was_left_is_a_collision_and_said_to_be_left():
    run = run_of([1.0, -1.0, 2.0])
    assert is_fenced(run)
    assert [outcome_of(t) for t in run.record.trials] == ["held", "collision", "held"]
    assert headline(Material("t", runs=(run,)))["flights"] == "geofence: 2 of 3 stayed in the fence"
    (found,) = brief(Material("t", runs=(run,))).subjects
    assert found.verdict == "1 of 3 flights left the fence."
    assert (found.numbers[0].shown, found.numbers[0].good) == ("2 of 3", False)
    assert (found.numbers[1].value, found.numbers[1].shown) == (-1.0, "1.0 m outside")


def test_a_log_tells_the_distance_beside_the_margin_of_the_filter():
    run = run_of([1.0, -1.0], flights={1: dataclasses.replace(flight(11.0), margin=np.zeros(5))})
    (closest,) = worst_flights(Material("t", runs=(run,)))
    (distance,) = closest.clearances
    assert (distance.name, distance.value.min()) == ("fence", pytest.approx(-1))
    assert closest.logged is None


def test_tables_have_the_rows_of_a_fence_and_no_others():
    run = run_of([1.0, -1.0, 2.0])
    rows = dict(row for row in runs_table(Material("t", runs=(run,))).rows)
    assert rows["left the fence"] == 1
    assert rows["fraction of ticks: passed"] == pytest.approx(0.6)
    assert "success rate" not in rows
    assert fence_rows(run)["fraction of ticks: no pilot"] is None  # not reported
    table = trials_table(run, "trials")
    assert table.rows[1][:4] == (1, "collision", -1.0, 36.0)
    assert len(table.columns) == len(table.rows[0])
    assert [t.name for t in all_tables(Material("t", runs=(run,)))] == [
        "runs",
        "parameters",
        "trials",
        "inputs",
    ]
    lines = to_csv(Material("t", runs=(run,))).splitlines()
    assert len(lines[0].split(",")) == len(lines[1].split(","))
    assert dict(zip(lines[0].split(","), lines[1].split(","), strict=True))["fence_backup_steps"] == "10"


def test_the_closest_of_the_logged_flights_is_drawn():
    material = Material("x", runs=(run_of([1.0, -1.0, -2.0]),))  # the last one was not logged
    (closest,) = worst_flights(material)
    assert (closest.trial, closest.logged) == (1, 2)
    assert closest.clearances[0].value.min() == pytest.approx(-1)
    assert closest.worst_s == pytest.approx(1.0)
    assert [figure.title for figure in flight_figures(material)] == [
        "The closest of 2 logged flights: r, trial 1"
    ]
    assert worst_flights(Material("x", runs=(run_of([1.0, -1.0]),)))[0].logged is None
    assert worst_flights(Material("x", runs=(run_of([1.0], flights={}),))) == []


@pytest.mark.slow
def test_figures_show_fence_flight_and_modes():
    material = Material("t", runs=(run_of([1.0, -1.0, 2.0]),))
    figures = {figure.name: figure for figure in draw(material)}
    assert figures.keys() == {"still", "flight-1", "map-1", "side-1", "clearance"}
    assert "backup alone in 40 %" in figures["flight-1"].alt
    assert "backup alone" in figures["flight-1"].svg
    assert "λ" in figures["flight-1"].svg
    assert "Below 0 is outside" in figures["clearance"].alt
    assert "dark lines are the outline" in figures["map-1"].alt
    again = {figure.name: figure for figure in draw(material)}
    assert again == figures
    (shown,) = flight_maps(material)
    assert {tuple(corner) for corner in shown.fence.tolist()} == {(-10, -10), (10, -10), (10, 10), (-10, 10)}


def test_a_run_without_log_or_without_a_fence_in_its_parameters_is_reported_all_the_same():
    assert fence_shape(run_of([1.0], fence=None)) is None
    assert fence_shape(run_of([1.0], fence={"box_m": None, "faces": []})) is None  # hulls alone
    for run in (run_of([1.0, 2.0], flights={}), run_of([1.0, 2.0], fence=None)):
        assert all_figures(Material("t", runs=(run,)))


def test_other_runs_beside_keep_their_words():
    other = run_of([1.0])
    plain = msgspec.structs.replace(other.record.trials[0], fence=None, stale_steps=None, outcome="reached")
    record = msgspec.structs.replace(other.record, trials=[plain])
    both = Material("t", runs=(run_of([1.0, -1.0]), Run("p", record, {0: flight(5.0)})))
    assert headline(both)["flights"] == (
        "geofence: 1 of 1 reached the goal, 0 collided; geofence: 1 of 2 stayed in the fence"
    )
    assert "Below 0 is a collision" in next(f.alt for f in all_figures(both) if f.name == "clearance")
    names = [figure.name for figure in all_figures(both)]
    assert names == ["map-1", "map-2", "side-1", "clearance", "path-ratio"]


POINTS = st.lists(st.tuples(st.floats(-500, 500), st.floats(-500, 500)), min_size=1, max_size=8)


@given(st.lists(POINTS, min_size=1, max_size=3))
def test_windows_hold_all_points_and_end_before_an_open_fence_is_cut(lines):
    arrays = [np.array(line) for line in lines]
    low, high = window(arrays)
    points = np.concatenate(arrays)
    assert (low < points.min(axis=0)).all()
    assert (high > points.max(axis=0)).all()
    assert (points.min(axis=0) - low < SHOWN_BEYOND_M).all()
    assert (high - points.max(axis=0) < SHOWN_BEYOND_M).all()
