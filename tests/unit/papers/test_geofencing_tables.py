"""The tables of the geofencing experiments against numbers counted by hand."""

import numpy as np
import pytest

from alula.schemas.artifacts.manifest import Guarantee
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.log.run import FenceResult, RunRecord, TrialResult
from alula.stages.verdict import wilson_interval
from papers.compared import VERDICTS
from papers.geofencing import figures as geofencing_figures
from papers.geofencing import pendulum
from papers.geofencing import tables as geofencing
from papers.geofencing.pendulum import PROGRAM, REGULATION, sweep
from papers.geofencing.ticks import Ticks
from papers.geofencing.verdicts import paper_rows
from papers.papers import GEOFENCING
from papers.verdicts import verdict_table
from support.flights.claims import open_claims, said


def trial(index, least=0.5, *, speed=20.0, interventions=1, altered=0, **steps):
    shares = {"passed": 10, "blended": 80, "backup": 10, "no_pilot": 0, "hand_over": 0, "refused": 0} | steps
    return TrialResult(
        index=index,
        start_m=[0.0, 0.0, 10.0],
        goal_m=[1.0, 0.0, 10.0],
        outcome="held",
        collision=least < 0,
        steps=sum(shares.values()),
        duration_s=1.0,
        path_length_m=4.0,
        straight_length_m=1.0,
        map_clearance_m=None,
        fence_clearance_m=least,
        scene_clearance_m=None,
        max_speed_m_s=speed,
        filtered_steps=0,
        shortened_steps=0,
        infeasible_steps=0,
        fallback_steps=0,
        mean_jerk_m_s3=1.0,
        max_jerk_m_s3=10.0,
        fence=FenceResult(
            **{f"{name}_steps": count for name, count in shares.items()},
            interventions=interventions,
            altered_passes=altered,
            out_of_range=0,
            longest_backup_s=0.1 * index,
            min_lambda=0.0,
            min_h_i_m=0.1,
            brake_distance_m=12.0,
            stop_distance_m=0.2,
        ),
    )


def flown(scenario, variant, trials, ticks=None, name="geofence", **changed):
    tree = {
        "vehicle": {"radius_m": None, "mass_scale": 1.0, "disturbance": {"wind_m_s": None}},
        "vehicle_file": {"body": {"radius_m": 0.25}},
        "safety": {"geofence": {"reserve_m": 0.0, "latency_s": 0.0, "beta": 1.5}},
        "estimation": {"lost_from_s": None, "lost_for_s": None},
    }
    for key, value in changed.items():
        *parents, last = key.split("__")
        at = tree
        for parent in parents:
            at = at[parent]
        at[last] = value
    record = RunRecord(
        schema="alula/run",
        version="1.0",
        provenance=Provenance.now("alula/run", "1.0", tree, 0, []),
        name=variant,
        filter=name,
        vehicle="racer",
        trials=trials,
        summary={},
        guarantee=Guarantee(statement="", claims={}),
        timing={"filter_p50_s": 2e-5, "filter_p99_s": 3e-5},
    )
    return geofencing.Fenced(scenario, variant, record, ticks)


def braking():
    """Ticks of 0.25 s that accelerate to 10 m/s in a second and brake in another; lambda as listed."""
    speed = np.array([0, 2.5, 5, 7.5, 10, 7.5, 5, 2.5, 0])
    return Ticks(
        time_s=0.25 * np.arange(9),
        position=np.zeros((9, 3)),
        velocity=np.stack([speed, np.zeros(9), np.zeros(9)], axis=1),
        tilt_rad=np.radians([0, 80, 70, 60, 50, 40, 75, 20, 0]),
        regulation=np.array([1, 1, 0.95, 0.6, 0.4, 0, 0, 0.3, 0.95]),
        h_i_m=np.full(9, 1.0),
        distance_m=np.array([10, 9.7, 8.75, 7.2, 5, 2.8, 1.25, 0.3, 0.4]),
        throttle=np.zeros((9, 2)),
        status=("passed",) * 2 + ("blended",) * 3 + ("backup",) * 2 + ("blended",) * 2,
    )


def row_of(table, *first):
    rows = [dict(zip(table.columns, row, strict=True)) for row in table.rows if row[: len(first)] == first]
    assert len(rows) == 1
    return rows[0]


def test_an_approach_is_read_off_its_ticks():
    a = geofencing.approach(braking())
    assert a.peak_km_h == 36
    assert (a.braking_m, a.halved_m, a.least_m, a.rest_m) == (5, 5, 0.3, 0.4)
    assert a.tilt_deg == pytest.approx(75)  # the 80 degrees are from before it was fastest
    assert (a.min_lambda, a.backup_s, a.engagements) == (0, 0.5, 1)


def test_braking_is_measured_to_the_face_that_is_flown_at():
    """Not to the floor, which is nearer."""
    faces = np.array([[1.0, 0, 0, 40.0], [0, 0, -1.0, 0.0], [-1.0, 0, 0, 100.0]])
    here, fast = np.array([10.0, 0, 19.0]), np.array([20.0, 0, -1.0])
    assert geofencing.distance_ahead(faces, here, fast) == 30
    assert geofencing.distance_ahead(faces, here, np.array([0.0, 0, -5.0])) == 19
    assert geofencing.distance_ahead(faces, here, np.zeros(3)) == 19
    ticks = braking()
    place = np.tile(here, (len(ticks.time_s), 1))
    speed = np.zeros_like(place)
    speed[:, 0] = np.linalg.norm(ticks.velocity, axis=1)
    moved = Ticks(
        **{name: getattr(ticks, name) for name in Ticks.__slots__} | {"position": place, "velocity": speed}
    )
    a = geofencing.approach(moved, faces, 0.25)
    assert (a.braking_m, a.halved_m, a.least_m) == (29.75, 29.75, 0.3)


def test_an_outage_of_the_radio_is_no_loss_of_the_share():
    ticks = braking()
    silent = geofencing.approach(
        Ticks(**{name: getattr(ticks, name) for name in Ticks.__slots__} | {"status": ("no-pilot",) * 9})
    )
    assert (silent.min_lambda, silent.backup_s, silent.engagements, silent.halved_m) == (1, 0, 0, None)


@pytest.mark.parametrize(
    ("share", "count"),
    [([], 0), ([1, 0.4, 0.6, 0.4], 1), ([1, 0.4, 0.95, 0.4, 0.2], 2), ([0.3], 1), ([0.5, 0.9, 0.5], 0)],
)
def test_engagements_begin_anew_above_nine_tenths(share, count):
    assert geofencing.engagements(share) == count


def test_distances_of_a_wall_are_of_the_centre_and_stand_beside_what_is_published():
    run = flown("wall", "from-40", [trial(0, 0.3)], braking(), vehicle__mass_scale=1.2)
    left = flown("wall", "from-40-none", [trial(0, -3.0)], braking(), name="none")
    table = geofencing.approach_table([run, left], "wall", "Wall", "")
    row = row_of(table, "from-40")
    assert row["changed"] == "mass_scale 1.2"
    assert (row["peak speed [km/h]"], row["brakes at [m]"]) == (36, 5.25)
    assert (row["minimum distance [m]"], row["minimum, centre [m]"]) == (0.3, pytest.approx(0.55))
    assert (row["λ = 0 [ms]"], row["fence"]) == (500, "held")
    without = row_of(table, "from-40-none")
    assert (without["minimum λ"], without["λ = 0 [ms]"], without["fence"]) == (None, None, "left")
    assert without["changed"] == "filter none"
    published = row_of(table, "published, flight")
    assert (published["peak speed [km/h]"], published["brakes at [m]"], published["minimum, centre [m]"]) == (
        104,
        15,
        1.7,
    )


def test_flights_are_counted_with_their_interval_and_shares_of_ticks():
    runs = [flown("box", "aggressive", [trial(0), trial(1, -0.1), trial(2), trial(3, speed=30.0)])]
    row = row_of(geofencing.flights_table(runs, "fences", "", ("box",)), "box")
    low, high = wilson_interval(1, 4)
    assert (row["flights"], row["left the fence [%]"]) == (4, 25)
    assert (row["95 % low"], row["95 % high"]) == pytest.approx((100 * low, 100 * high))
    assert (row["passed [%]"], row["blended [%]"], row["u_B alone [%]"]) == (10, 80, 10)
    assert row["peak speed [km/h]"] == 108
    assert row["longest u_B alone [s]"] == pytest.approx(0.3)


def test_passed_commands_are_added_up_of_the_geofence_alone():
    runs = [
        flown("box", "a", [trial(0), trial(1, altered=2)]),
        flown("faces", "a", [trial(0, passed=5)]),
        flown("box", "qp", [trial(0, altered=7)], name="backup-qp"),
    ]
    table = geofencing.passes_table(runs)
    row = row_of(table, "all")
    assert (row["flights"], row["passed: λ rounds to 1"], row["altered"]) == (3, 25, 2)
    assert row_of(table, "box")["altered"] == 2


def reserves(name, left_at, **changed):
    return [
        flown(
            "robustness",
            f"{name}_{reserve:g}",
            [trial(i, -0.1 if reserve in left_at and i == 0 else reserve + 0.01) for i in range(5)],
            safety__geofence__reserve_m=reserve,
            **changed,
        )
        for reserve in (0.0, 0.5, 1.0, 2.0)
    ]


def test_the_least_reserve_is_that_above_which_no_flight_left():
    runs = [
        *reserves("nominal", ()),
        *reserves("mass", (0.0, 1.0), vehicle__mass_scale=1.2),  # 0.5 m was lucky
        *reserves("gale", (2.0,), vehicle__disturbance__wind_m_s=[20.0, 0.0, 0.0]),
    ]
    enough = {group.name: group.enough for group in geofencing.disturbed(runs)}
    assert enough["nominal"].reserve_m == 0
    assert enough["mass"].reserve_m == 2
    assert enough["gale"] is None
    table = geofencing.robustness_table(runs)
    row = row_of(table, "mass")
    assert row["changed parameters"] == "mass_scale 1.2"
    assert row["no reserve: left [%]"] == 20
    assert row["with it: left [%]"] == 0
    assert row["with it: minimum distance [m]"] == 2.01
    assert row_of(table, "gale")["sufficient reserve [m]"] is None
    assert "(20, 0, 0)" in row_of(table, "gale")["changed parameters"]
    figure = geofencing_figures.robustness_figure(runs)
    assert "gale 0 % without, sufficient: none of the grid" in figure.alt


def test_pilots_are_taken_together_by_filter():
    runs = [
        *(flown("pilots", f"{kind}-geofence", [trial(i) for i in range(50)]) for kind in ("a", "b")),
        flown("pilots", "a-none", [trial(i, -1.0) for i in range(4)], name="none"),
    ]
    table = geofencing.pilots_table(runs)
    row = row_of(table, "geofence")
    assert (row["kinds of pilots"], row["flights"], row["left the fence"]) == (2, 100, 0)
    assert row["95 % high"] == pytest.approx(100 * wilson_interval(0, 100)[1])
    assert row_of(table, "none")["left [%]"] == 100
    figure = geofencing_figures.distances_figure(runs)
    assert "geofence: 100 flights, minimum 0.5 m" in figure.alt


def test_what_is_said_in_short_is_what_the_tables_say():
    swings = sweep({REGULATION: (60.0,), PROGRAM: (50.0,)}, (0.01,))
    measured = {
        "times": {"regulation [us]": 1.0, "backup-qp [us]": 3.0, "solver quadprog [us]": 12.0},
        **{"rows": 206, "states": 100},
    }
    runs = [
        flown("wall", "from-40", [trial(0, 0.3)], braking()),
        flown("engaged", "geofence", [trial(0, interventions=3), trial(1, interventions=2, backup=0)]),
        flown("box", "aggressive", [trial(0)]),
        flown("box", "stale", [trial(0, -5.0, hand_over=100)]),
        *reserves("mass", (0.0,)),
    ]
    facts = geofencing.in_short(runs, swings, measured)
    assert "takes 3 times as long" in facts["pendulum, time"]
    assert "15 times with quadprog" in facts["pendulum, time"]
    assert facts["wall, 40 m"].startswith("peak speed 36 km/h, brakes at 5.25 m, tilt 75°")
    assert "flight peak speed 104 km/h, brakes at 15 m, minimum distance 1.7 m)" in facts["wall, 40 m"]
    again = facts["repeated engagement, geofence"]
    assert again.startswith(
        "5 engagements in 2 flights at up to 72 km/h, 0 left the fence; λ falls to 0 in 1 of"
    )
    assert "for at most 0.1 s at a time" in again
    assert facts["fence box"].startswith("0 of 1 flights")  # a fence that was handed over is not guarded
    assert facts["disturbance mass"].endswith("sufficient reserve: 0.5 m")
    assert facts["passed commands"] == "0 of 250 differ from the pilot's in a bit"
    row = row_of(pendulum.time_table(measured), "program through quadprog")
    assert (row["total [µs]"], row["ratio to the regulation"]) == (15, 15)
    assert len(pendulum.gains_table(swings).rows) == 2


def test_nothing_is_drawn_or_listed_without_runs():
    assert geofencing.approach_table([], "wall", "", "") is None
    assert geofencing.flights_table([], "fences", "", ("box",)) is None
    assert geofencing.filters_table([], "filters", ("geofence",)) is None
    assert geofencing.passes_table([]) is None
    assert geofencing.robustness_table([]) is None
    assert geofencing.pilots_table([]) is None
    assert geofencing_figures.approach_figure([], "wall", ("from-40",), "", 8.0) is None
    assert geofencing_figures.engaged_figure(None) is None
    assert geofencing_figures.robustness_figure([]) is None
    assert geofencing_figures.distances_figure([]) is None
    assert geofencing_figures.chatter_figure([]) is None
    assert geofencing_figures.pendulum_figure([], {}, {}) is None


def test_figures_say_what_they_show():
    run = flown("wall", "from-40", [trial(0, 0.3)], braking())
    shown = geofencing_figures.approach_figure([run], "wall", ("from-40",), "Wall", 8.0)
    assert "from-40: 36 km/h, minimum distance 0.3 m, minimum λ 0" in shown.alt
    again = geofencing_figures.engaged_figure(flown("engaged", "geofence", [trial(0)], braking()))
    assert "engages its fence 1 times" in again.alt
    assert "0 for 500 ms" in again.alt
    assert shown.svg.startswith("<?xml")


MEASURED = {"times": {"regulation [us]": 1.5, "backup-qp [us]": 6.0, "solver quadprog [us]": 24.0}}


def rows_of(runs, swings=(), teensy_us=None):
    return said(GEOFENCING, paper_rows(runs, swings, MEASURED, teensy_us))


def verdicts(**least):
    runs = [
        flown("wall", "from-40", [trial(0, least.get("wall", 0.3), speed=30.0)], braking()),
        flown("fall", "fall", [trial(0, 0.3)], braking()),
        flown("engaged", "geofence", [trial(k, 0.3) for k in range(4)]),
        flown("pilots", "sticks-geofence", [trial(k, least.get("pilots", 0.4)) for k in range(6)]),
        flown("box", "silent", [trial(k, 0.4) for k in range(3)]),
    ]
    return {(row.item, row.quantity): row for row in rows_of(runs, [], 332.3)}


def test_every_figure_and_section_of_the_paper_has_a_row():
    items = " ".join(item for item, _ in verdicts())
    for word in ("Figures 1", "Figure 3", "Figure 4", "Figure 5a", "Figure 5b", "Figure 6", "7a", "7b", "7c"):
        assert word in items
    for word in ("Figure 8", "Proposition 1", "Theorem 1", "IV-A", "V-A", "V-B", "V-C", "abstract"):
        assert word in items
    assert len(verdicts()) >= 25


def test_verdicts_follow_from_the_runs():
    found = verdicts()
    safe = found["Proposition 1", "flights that leave the safe set"]
    assert (safe.ours, safe.verdict) == ("0 of 9 random flights", "bounded")
    assert safe.interval.endswith("% of 9")
    assert verdicts(pilots=-0.1)["Proposition 1", safe.quantity].verdict == "refuted"
    time = found["V-B", "time of an evaluation on a Teensy 4.1"]
    assert time.ours.startswith("332.3 µs")
    assert time.verdict == "not comparable"
    zero = found["Figure 8, V-C", "λ never reaches 0"]
    assert (zero.verdict, zero.ours[:9]) == ("refuted", "in 100 % ")
    ratio = found["Figure 4, III-C", "time of the program over that of the regulation function"]
    assert ratio.ours == "4 with our program; all rows in a general solver: quadprog 20"
    assert found["abstract", "speeds at which the drone is held"].verdict == "reproduced"
    assert "no interval" in found["Figure 5a", "peak speed, simulation"].interval


def test_the_table_has_the_columns_of_the_other_papers():
    table = verdict_table(GEOFENCING, [row.found for row in verdicts().values()])
    assert table.columns == ("item", "quantity", "published", "ours", "95 % interval", "verdict", "why")
    assert {row[5] for row in table.rows} <= set(VERDICTS)
    assert np.array(table.rows, dtype=object).shape[1] == 7


def test_every_claim_of_the_paper_has_a_row_and_every_row_a_claim():
    runs = [
        *(
            flown("wall", name, [trial(0, 0.3, speed=30.0)], braking())
            for name in ("from-40", "from-40-rule-10")
        ),
        *(flown("fall", name, [trial(0, 0.3)], braking()) for name in ("fall", "drag", "gentle")),
        flown("engaged", "geofence", [trial(k, 0.3) for k in range(4)]),
        flown("box", "silent", [trial(k, 0.4) for k in range(3)]),
        flown("filters", "geofence", [trial(k) for k in range(3)]),
        flown("filters", "backup-qp", [trial(k) for k in range(3)], name="backup-qp"),
    ]
    rows = rows_of(runs, sweep({REGULATION: (5.0,), PROGRAM: (50.0,)}, (0.01,)), 332.3)
    assert open_claims(GEOFENCING, rows) == set()
    assert "figure-8" in open_claims(GEOFENCING, rows_of([]))
    (fall,) = (row for row in rows if row.quantity == "vertical speed, flight")
    assert fall.found.runs == ["fall/fall.run.mcap", "fall/gentle.run.mcap", "fall/drag.run.mcap"]
    assert fall.found.flights == 3
