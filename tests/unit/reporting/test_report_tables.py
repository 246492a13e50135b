"""The numbers of a report are those of the runs and artifacts, and nothing else."""

import csv
import io

import msgspec
import numpy as np
import pytest

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.manifest import InputRef
from alula.schemas.errors import UsageError
from alula.schemas.log.flights import Flight
from alula.schemas.log.run import ObstacleResult
from alula.stages.reporting import curves
from alula.stages.reporting.brief import brief
from alula.stages.reporting.flight_curves import closest_flight, worst_flights
from alula.stages.reporting.headline import chain, headline
from alula.stages.reporting.material import Material, Run, coverage, is_covered, proof
from alula.stages.reporting.table import text, to_markdown
from alula.stages.reporting.tables import (
    CSV_COLUMNS,
    all_tables,
    compression_table,
    cover_table,
    runs_table,
    to_csv,
)
from support.scenes.fabricate import box, make_cover, make_plan, make_record, make_scene, make_trial

TRIALS = [
    make_trial(0, clearance=0.25),
    make_trial(1, "stuck", clearance=0.125),
    make_trial(2, clearance=-0.03125),
    make_trial(3, "timeout", clearance=0.5),
]
COVER = make_cover([box((0, 0, 0), (10, 10, 10)), box((20, 0, 0), (30, 5, 2))], summary={"voxels": 700})


def flight(n=50, margin=0.5):
    time = np.linspace(0, 5, n)
    position = np.column_stack([time, np.zeros(n), np.ones(n)])
    status = tuple("recovering" if i == 7 else "ok" for i in range(n))
    return Flight(time, position, np.ones(n), time, margin + time, "m", status)


def run_of(label="a", trials=TRIALS, **fields):
    return Run(label, make_record(trials), {t.index: flight() for t in trials}, **fields)


def row_of(table, key):
    return next(row[1:] for row in table.rows if row[0] == key)


def test_the_table_of_runs_repeats_the_summaries():
    runs = [run_of("a", hulls=12), run_of("b", TRIALS[:2])]
    table = runs_table(Material("t", runs=tuple(runs)))
    assert table.columns == ("", "a", "b")
    for key, name in [
        ("success_rate", "success rate"),
        ("collisions", "collided"),
        ("stuck", "stuck"),
        ("min_map_clearance_m", "minimum clearance to the hulls [m]"),
        ("mean_path_ratio", "path / straight line, mean of successes"),
    ]:
        assert row_of(table, name) == tuple(run.record.summary[key] for run in runs)
    assert row_of(table, "success rate, 95 % low") == (0.3125, 0.3125)
    assert row_of(table, "hulls of the map") == (12, None)
    assert row_of(table, "fraction of steps changed by the filter") == (0.4, 0.4)
    assert "minimum clearance to the splats [m]" not in [row[0] for row in table.rows]  # there are none


def numbers_of(material, place=0):
    return {number.key: number for number in brief(material).subjects[place].numbers}


def test_a_collision_is_shown_as_bad_and_none_as_good():
    found = numbers_of(Material("t", runs=(run_of(),)))
    assert (found["collisions"].value, found["collisions"].shown, found["collisions"].good) == (1, "1", False)
    deep = found["min_clearance_m"]
    assert (deep.value, deep.shown, deep.good) == (-0.03125, "3.1 cm deep", False)
    assert brief(Material("t", runs=(run_of(),))).tone == "bad"
    found = numbers_of(Material("t", runs=(run_of(trials=TRIALS[:1]),)))
    assert found["collisions"].good is True


def test_compression_counts_what_is_stored():
    material = Material("t", cover=COVER, scene=make_scene(90), file_bytes={"cover": 1234, "scene": 99})
    rows = {row[0]: row[1:] for row in compression_table(material).rows}
    assert rows == {
        "Gaussians": (90, None, 90 * 40, 99),
        "voxels": (700, None, 700 * 12, None),
        "hulls": (2, 12, 12 * 16, 1234),
    }
    counts = [("90", "Gaussians"), ("700", "voxels"), ("2", "hulls"), ("12", "half-planes")]
    assert chain(material) == [*counts, ("192", "bytes of half-planes")]
    summary = {**COVER.manifest.summary, "onboard_bytes": 1_100}
    onboard = Artifact(msgspec.structs.replace(COVER.manifest, summary=summary), COVER.arrays)
    assert chain(Material("t", cover=onboard))[-1] == ("1,100", "bytes on board")


def test_voxels_are_counted_from_the_members_when_the_summary_does_not_say():
    cover = make_cover([box((0, 0, 0), (1, 1, 1)), box((0, 0, 0), (2, 1, 1))])
    assert compression_table(Material("t", cover=cover)).rows[0][:2] == ("voxels", 1)


def test_only_a_certificate_says_that_a_map_is_covered():
    covered = numbers_of(Material("t", cover=COVER))["covered"]
    assert (covered.value, covered.shown, covered.good) == ("not verified", "not checked", None)
    assert is_covered({"covered": False}) is False
    assert is_covered({"covered": "yes"}) is None
    ellipsoids = {"covered": True, "checks": [{"name": "every ellipsoid lies in the voxels", "ok": True}]}
    assert coverage(ellipsoids) == "in part"  # it does not say what it leaves out
    ellipsoids["omits"] = []
    assert coverage(ellipsoids) is True
    assert coverage({"covered": True, "checks": [{"name": "every voxel is a member"}]}) == "voxels only"
    assert coverage({"covered": False, "checks": []}) is False
    assert proof({"covered": True, "statement": "covered: members in hulls"}) == "covered: members in hulls"
    rows = dict(cover_table(Material("t", cover=COVER, certificate=ellipsoids)).rows)
    assert rows["verified: covered"] is True
    assert rows["verified: every ellipsoid lies in the voxels"].startswith("holds")
    ellipsoids["checks"][0]["ok"] = False
    rows = dict(cover_table(Material("t", cover=COVER, certificate=ellipsoids)).rows)
    assert rows["verified: every ellipsoid lies in the voxels"].startswith("DOES NOT HOLD")


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (None, "–"),
        (float("nan"), "–"),
        (True, "yes"),
        (1234567, "1,234,567"),
        (0.123456, "0.1235"),
        (123456.7, "123,457"),
        ([1, 0.5], "1, 0.5"),
        ({"a": False}, "a no"),
    ],
)
def test_values_read_well(value, shown):
    assert text(value) == shown


def test_csv_has_a_row_per_trial_with_all_digits():
    material = Material("t", runs=(run_of("a, b"), run_of("c", TRIALS[1:])))
    rows = list(csv.DictReader(io.StringIO(to_csv(material))))
    assert list(rows[0]) == list(CSV_COLUMNS)
    assert [(row["run"], row["index"]) for row in rows] == [
        *(("a, b", str(t.index)) for t in TRIALS),
        *(("c", str(t.index)) for t in TRIALS[1:]),
    ]
    for row, trial in zip(rows, [*TRIALS, *TRIALS[1:]], strict=True):
        assert float(row["path_length_m"]) == trial.path_length_m
        assert [float(x) for x in row["start_m"].split()] == trial.start_m
        assert row["scene_clearance_m"] == ""
        assert row["collision"] == str(trial.collision).lower()


def test_markdown_holds_the_same_cells_and_no_markup_of_names():
    run = run_of("evil | <b>*x*</b>\nnext")
    tables = all_tables(Material("t", runs=(run,)))
    shown = to_markdown("A <title>", headline(Material("t", cover=COVER)), tables, "alula-provenance: {}")
    assert shown.startswith("<!-- alula-provenance: {} -->")
    assert "<b>" not in shown
    assert "evil \\| &lt;b&gt;\\*x\\*&lt;/b&gt; next" in shown
    body = [line for line in shown.splitlines() if line.startswith("| ") and "---" not in line]
    assert len(body) == sum(1 + len(table.rows) for table in tables)


def test_the_headline_adds_up_the_runs():
    runs = (run_of("a"), run_of("b"))
    facts = headline(Material("t", runs=runs, cover=COVER))
    trials = [trial for run in runs for trial in run.record.trials]
    reached = sum(trial.outcome == "reached" and not trial.collision for trial in trials)
    collisions = sum(trial.collision for trial in trials)
    assert (
        facts["flights"]
        == f"polytope-cbf: {reached} of {len(trials)} reached the goal, {collisions} collided"
    )
    assert facts["least_clearance_m"] == min(t.map_clearance_m for t in trials)
    assert facts["obstacles_covered"] == "not verified"
    assert facts["compression"].endswith("bytes of half-planes")
    assert "obstacles_covered" not in headline(Material("t", runs=runs))  # there is no map to verify
    shown = to_markdown("t", facts, [], "")
    assert f"- flights: {facts['flights']}" in shown


def test_flights_past_moving_obstacles_need_not_reach_a_goal():
    kinds = [("passed", 0.5), ("timeout", 0.5), ("passed", -0.03125)]
    passed = [
        msgspec.structs.replace(make_trial(i, outcome, clearance=clearance), obstacles=[])
        for i, (outcome, clearance) in enumerate(kinds)
    ]
    facts = headline(Material("t", runs=(run_of("m", passed),)))
    assert facts["flights"] == "polytope-cbf: 2 of 3 touched nothing, 1 collided"
    success = numbers_of(Material("t", runs=(run_of("m", passed),)))["successes"]
    assert (success.value, success.shown, success.label) == (2, "2 of 3", "touched nothing")
    both = headline(Material("t", runs=(run_of("a"), run_of("m", passed))))
    assert both["flights"] == (
        "polytope-cbf: 1 of 4 reached the goal, 1 collided; polytope-cbf: 2 of 3 touched nothing, 1 collided"
    )


def flown_with(label, filter_name, parameters=(), trials=TRIALS):
    record = make_record(trials, filter_name=filter_name)
    provenance = msgspec.structs.replace(record.provenance, parameters={"filter_parameters": parameters})
    return Run(label, msgspec.structs.replace(record, provenance=provenance))


def test_the_headline_never_adds_up_different_filters():
    clear = [make_trial(i, clearance=0.25) for i in range(5)]
    runs = [
        flown_with("bare", "none", trials=[make_trial(0, clearance=-0.5), make_trial(1, clearance=0.125)]),
        flown_with("a", "cone-backup", trials=clear),
        flown_with("b", "safer-splat", ["alpha=1"]),
        flown_with("c", "safer-splat", ["alpha=10"], clear),
        flown_with("d", "cone-backup", trials=clear),
    ]
    facts = headline(Material("t", runs=tuple(runs)))
    assert facts["flights"] == (
        "cone-backup: 10 of 10 reached the goal, 0 collided; "
        "safer-splat (b): 1 of 4 reached the goal, 1 collided; "
        "safer-splat (c): 5 of 5 reached the goal, 0 collided"
    )
    assert facts["baseline"] == "no filter: 1 of 2 reached the goal, 1 collided"
    assert facts["least_clearance_m"] == -0.03125
    assert facts["baseline_least_clearance_m"] == -0.5
    only = headline(Material("t", runs=tuple(runs[:1])))
    assert "flights" not in only
    assert "least_clearance_m" not in only


def test_only_the_named_tables_are_kept():
    material = Material("t", runs=(run_of("a"), run_of("b")), cover=COVER)
    assert [t.name for t in all_tables(material, ["trials-2", "runs"])] == ["runs", "trials-2"]
    with pytest.raises(UsageError, match="this report has runs, compression, cover, parameters, trials-1"):
        all_tables(material, ["nothing"])


def test_a_run_is_matched_to_the_cover_that_it_flew_through():
    ref = InputRef("cover", "alula/cover", "1.0", "ab" * 32, "x.cover.npz")
    run = run_of()
    run.record.provenance.inputs.append(InputRef("cover", "alula/cover", "1.0", "ab" * 32, "x.cover.npz"))
    material = Material("t", runs=(run,), cover=COVER, inputs=(ref,))
    assert row_of(runs_table(material), "flew through the cover shown") == (True,)
    other = Material("t", runs=(run,), cover=COVER, inputs=(InputRef("cover", "", "", "cd" * 32, "y"),))
    assert row_of(runs_table(other), "flew through the cover shown") == (False,)
    assert curves.flight_maps(material)[0].hulls == 2
    assert curves.flight_maps(other)[0].hulls == 0


def test_distributions_are_sorted_and_end_at_one():
    (shown,) = curves.clearances([run_of()])
    assert shown.value.tolist() == [-0.03125, 0.125, 0.25, 0.5]
    assert shown.fraction.tolist() == [0.25, 0.5, 0.75, 1.0]
    (ratios,) = curves.path_ratios([run_of()])
    assert ratios.value.tolist() == [4.4 / 4.0]  # the only one that reached its goal unharmed


def test_the_flight_that_is_drawn_is_the_closest_of_each_run():
    first, second = worst_flights(Material("t", (run_of("a", TRIALS[:2]), run_of("b"))))
    assert (first.run, first.trial, first.closest_m) == ("a", 1, 0.125)
    assert (second.run, second.trial, second.closest_m) == ("b", 2, -0.03125)
    assert second.filters[0].status.count("recovering") == 1
    assert worst_flights(Material("t", (Run("a", make_record(TRIALS)),))) == []


def test_the_worst_encounter_is_known_from_the_run_and_not_from_its_samples():
    """Samples are rare: 0.89 m between spheres where the minimum of the run is 0.343 m."""

    def met(index, closest_m):
        found = ObstacleResult(
            closest_m=closest_m, separation_m=None, closing_m_s=None, detected_s=None, warned_s=None,
            reaction_s=None, avoid_s=None, collision=False,
        )  # fmt: skip
        return msgspec.structs.replace(make_trial(index), map_clearance_m=None, obstacles=[found])

    record = make_record(TRIALS)
    made = msgspec.structs.replace(
        record.provenance, parameters={"vehicle": {"radius_m": 0.3}, "obstacles": [{"radius_m": 0.5}]}
    )
    record = msgspec.structs.replace(
        record, provenance=made, trials=[met(0, 1.9), met(1, 1.143), met(2, 1.1)]
    )
    run = Run("a", record, {0: flight(margin=0.95), 1: flight(margin=0.89)})
    # the third one came closer and was not logged
    assert closest_flight(run) == (1, pytest.approx(0.343), 2)
    assert closest_flight(Run("a", record, {2: flight()}))[2] is None


def test_the_map_shows_the_hulls_at_the_heights_that_were_flown():
    cover = make_cover([box((0, 0, 0), (10, 10, 30)), box((0, 0, 40), (5, 5, 50))], g=0.05)
    (shown,) = curves.flight_maps(Material("t", runs=(run_of(),), cover=cover))
    assert shown.band_m == (1.0, 1.0)
    assert shown.hulls == 2
    assert [sorted(map(tuple, f.tolist())) for f in shown.footprints] == [
        [(0.0, 0.0), (0.0, 0.5), (0.5, 0.0), (0.5, 0.5)]
    ]
    assert {path.outcome for path in shown.paths} == {"reached", "stuck", "collision", "timeout"}
    (alone,) = curves.flight_maps(Material("t", cover=cover))
    assert len(alone.footprints) == 2


def test_footprints_are_convex_hulls():
    from scipy.spatial import ConvexHull

    rng = np.random.default_rng(2)
    for _ in range(20):
        points = rng.integers(-9, 10, (30, 2))
        polygon = curves.footprint(points)
        hull = ConvexHull(points)
        x, y = polygon.T
        area = 0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1))
        assert area == pytest.approx(hull.volume)
        assert {tuple(p) for p in polygon.tolist()} == {tuple(p) for p in points[hull.vertices].tolist()}
    assert curves.footprint(np.array([[1, 1], [1, 1]])).tolist() == [[1, 1]]


def test_plans_are_sampled_by_their_polynomials():
    points = curves.plan_positions(make_plan())
    assert points[0].tolist() == [0, 0, 1]
    assert points[-1] == pytest.approx([3, 0, 1])
    assert (np.diff(points[:, 0]) >= 0).all()


def test_the_compression_curve_comes_from_the_certificate():
    stored = {"hulls": [9, 3], "excess_sum_voxels": [0.0, 350.0], "half_planes": [90, 20]}
    curve = curves.compression(make_cover([], summary={"voxels": 700}, certificate={"curve": stored}))
    assert curve.hulls.tolist() == [9, 3]
    assert curve.growth.tolist() == [1.0, 1.5]
    assert curve.planes.tolist() == [90, 20]
    assert curves.compression(COVER) is None
    assert curves.compression(make_cover([], certificate={"curve": {"hulls": [1]}})) is None


def test_drawn_paths_are_few_and_the_bad_ones_are_among_them():
    trials = [make_trial(i, clearance=-0.1 if i == 555 else 0.1) for i in range(600)]
    paths = curves.paths_of(run_of(trials=trials))
    assert len(paths) == 300
    assert [path.outcome for path in paths].count("collision") == 1


def test_long_runs_are_listed_in_part():
    trials = [make_trial(i) for i in range(501)]
    table = all_tables(Material("t", runs=(run_of(trials=trials),)), ["trials"])[0]
    assert len(table.rows) == 500
    assert "first 500 of 501" in table.note
    assert to_csv(Material("t", runs=(run_of(trials=trials),))).count("\n") == 502


def test_thinning_keeps_the_ends():
    points = np.arange(30_000.0).reshape(-1, 3)
    thin = curves.thin(points)
    assert len(thin) == 600
    assert (thin[0] == points[0]).all()
    assert (thin[-1] == points[-1]).all()
