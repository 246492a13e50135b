"""Runs among the ellipsoids of a scene: pairs, the judge, vehicles, the log, filters by name."""

import msgspec
import numpy as np
import pytest

from alula import _core
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.errors import UsageError
from alula.schemas.scenarios.check import FILTER_COMMANDS
from alula.schemas.scenarios.vehicle import BodyTable, LimitsTable, Vehicle
from alula.stages.filtering import registry
from alula.stages.filtering.ellipsoid_filters import ELLIPSOID_FILTERS, parameters_of
from support.flights.foreign_filters import Broken, Limiting, provide
from support.flights.world_runs import flown
from support.models.clearances import clearance_to_scene
from support.scenes.fabricate import make_scene
from support.scenes.small_scenes import ball_scene, box_cover, rest_plan

FIELD = make_scene(60, low=(0, 0, 0), high=(6, 4, 3))
NATIVE = list(ELLIPSOID_FILTERS)


def quick(filters=(), parameters=None, scene=FIELD, **fields):
    return flown(filters, parameters, scene=scene, **({"trials": 3, "speed_m_s": 1.5} | fields))


@pytest.mark.parametrize("name", ["none", *NATIVE])
def test_a_run_does_not_depend_on_jobs(name):
    one, many = (quick(name, jobs=jobs) for jobs in (1, 3))
    assert one.trials == many.trials
    assert one.summary == many.summary
    assert one.flights == many.flights
    assert one.run.tick_times.quantile(1e-9) > 0
    assert one.run.tick_times.calls == one.summary["steps"]


def test_the_judge_measures_the_path_that_was_flown():
    scene = ball_scene([[2, 0, 1], [9, 9, 9]], [[0.2, 0.3, 0.2], [0.1, 0.1, 0.1]])
    plan = rest_plan((0, 0.9, 1), (4, 0.9, 1), 1.0)
    result = quick(trials=None, speed_m_s=None, radius_m=0.1, scene=scene, plan=plan)
    (trial,) = result.trials
    assert trial.outcome == "reached"
    assert not trial.collision
    assert trial.scene_clearance_m == pytest.approx(0.9 - 0.3 - 0.1, abs=1e-3)
    assert trial.map_clearance_m is None
    assert trial.max_speed_m_s == pytest.approx(1, abs=1e-2)
    assert trial.reference_speed_m_s == pytest.approx(1, abs=1e-3)
    assert trial.max_tracking_error_m < 0.01
    assert trial.mean_speed_m_s == pytest.approx(trial.path_length_m / trial.duration_s)
    # jerk of the septic of 4 m in 8.75 s: at most 52.5 L / T^3, in the middle
    assert trial.max_jerk_m_s3 == pytest.approx(52.5 * 4 / 8.75**3, rel=0.1)
    through = quick(
        trials=None, speed_m_s=None, sigma=2.0, scene=scene, plan=rest_plan((0, 0, 1), (4, 0, 1), 1.0)
    )
    (trial,) = through.trials
    assert trial.collision
    assert trial.scene_clearance_m == pytest.approx(-0.4 - 0.15, abs=1e-3)
    assert trial.min_gamma == pytest.approx(-1, abs=1e-3)
    assert through.guarantee.claims["scene_collisions"] == 1
    assert through.summary["success_rate"] == 0


def test_gamma_is_the_least_over_all_ellipsoids_and_points():
    rng = np.random.default_rng(4)
    index = _core.EllipsoidIndex(FIELD["mean"], FIELD["scale"], FIELD["quat_wxyz"], sigma=1.0, radius=0.1)
    centre, a = index.grown()
    for count in (1, 63, 65, 400):
        points = np.cumsum(rng.normal(size=(count, 3)) * 0.05, axis=0) + np.array([3, 2, 1.5])
        r = centre[None] - points[:, None]
        expected = np.einsum("tni,nij,tnj->tn", r, a, r).min() - 1
        assert _core.least_gamma(index, points) == pytest.approx(expected, rel=1e-12)
    assert _core.least_gamma(index, np.empty((0, 3))) == np.inf


def test_starts_and_goals_are_clear_and_the_log_says_what_was_flown():
    result = quick("cone-di", trials=5, log_rate_hz=25)
    for trial, log in zip(result.trials, result.flights, strict=True):
        for point in (trial.start_m, trial.goal_m):
            assert clearance_to_scene([point], FIELD, 1.0).min() >= 0.15 + 0.05 - 1e-9
        assert len(log.time_s(0.01)) == -(-trial.steps // 4) + 1
        assert log.time_s(0.01)[-1] == pytest.approx(trial.duration_s)
        assert log.rows("a_error").max() == trial.peak_realisation_error_m_s2
        assert trial.reference_speed_m_s == pytest.approx(1.5, rel=1e-3)
        assert trial.certified_steps == 0
        assert trial.filtered_steps <= trial.steps
        np.testing.assert_allclose(log.rows("rotor_thrust").sum(axis=1), log.rows("command")[:, 3])
    assert result.summary["filter_kind"] == "native"
    assert result.summary["sampled_points"] > 5


def test_the_summary_has_the_extremes_of_the_trials():
    result = quick("cone-ecbf", speed_m_s=3.0, which="blocked")
    for key, least in (
        ("min_gamma", min),
        ("min_margin", min),
        ("max_speed_m_s", max),
        ("max_jerk_m_s3", max),
    ):
        assert result.summary[key] == least(getattr(trial, key) for trial in result.trials)
    worst = max(trial.peak_realisation_error_m_s2 for trial in result.trials)
    assert result.summary["peak_realisation_error_m_s2"] == worst > 0
    assert result.summary["mean_jerk_m_s3"] == pytest.approx(
        np.mean([t.mean_jerk_m_s3 for t in result.trials])
    )
    assert result.summary["capped_steps"] == sum(trial.capped_steps for trial in result.trials)
    for trial in result.trials:
        assert trial.line_clearance_m < 0
        ends = _core.least_gamma(result.run.world.index, np.array([trial.start_m]))
        assert 0 < trial.min_gamma <= ends


@pytest.mark.parametrize("early_end", [True, False])
def test_the_guarantee_names_the_margin_that_is_kept_and_what_is_only_tested(early_end):
    chosen = {"margin_m": 0.03, "early_end": early_end}
    found = quick("cone-backup", chosen, trials=1).guarantee
    assert found.claims["every_step_certified"]
    assert found.claims["shield"] == {"margin_m": 0.03, "rest_drift_m": 0.008, "early_end": early_end}
    assert (
        "keeps 0.15 m, the radius, and half of margin_m, 0.015 m, from every ellipsoid until it rests"
        in found.statement
    )
    assert "drifts by at most 0.008 m; that the nonlinear loop" in found.statement
    assert ("early end of rollouts" in found.statement) == early_end
    assert "at 1 sigma (19.8 % of a Gaussian's mass)" in found.statement
    assert found.claims["mass_fraction"] == pytest.approx(0.19875, abs=1e-5)


def test_the_alignment_s_inflation_is_added_to_what_filters_see():
    manifest = msgspec.structs.replace(FIELD.manifest, suggested_inflation_m=0.07)
    grown = Artifact(manifest, FIELD.arrays)
    assert quick(trials=1, scene=grown).summary["inflation_m"] == 0.07
    without = quick(trials=1, inflation_m=0.0, scene=grown)
    assert without.summary["inflation_m"] == 0
    assert without.trials == quick(trials=1).trials


def test_a_double_integrator_of_its_own_file_keeps_its_limit():
    vehicle = Vehicle(
        name="point",
        model="double-integrator",
        body=BodyTable(radius_m=0.1),
        limits=LimitsTable(max_acceleration_m_s2=2.0),
    )
    result = quick(speed_m_s=3.0, vehicle=vehicle)
    assert result.vehicle == "point: sphere of radius 0.1 m, double integrator, commanded by acceleration"
    assert max(t.max_acceleration_m_s2 for t in result.trials) <= 2 + 1e-9
    assert result.summary["saturated_steps"] > 0
    assert result.summary["peak_realisation_error_m_s2"] > 0
    with pytest.raises(
        UsageError, match="point is a double-integrator, which takes velocity or acceleration"
    ):
        quick(interface="wrench", vehicle=vehicle)
    lone = Vehicle(name="dot", model="single-integrator", body=BodyTable(radius_m=0.1))
    with pytest.raises(UsageError, match="cone-di is for commands of acceleration, and dot takes velocity"):
        quick("cone-di", vehicle=lone)


@pytest.fixture
def others(monkeypatch):
    provide(monkeypatch, {"limiting": Limiting, "absent": None, "none": Broken})


def test_a_filter_from_another_package_flies(others):
    assert [name for name in registry.filter_names() if name not in FILTER_COMMANDS] == [
        "none",
        "absent",
        "limiting",
    ]
    assert registry.filter_kind("limiting") == "acceleration"
    result = quick("limiting", trials=2)
    assert result.summary["filter_kind"] == "python filter"
    assert result.summary["filtered_steps"] == result.summary["steps"] > 0
    assert all(t.min_margin == 0.5 for t in result.trials)
    assert result.run.filter_times.quantile(1e-9) > 0
    with pytest.raises(UsageError, match="cannot be loaded from elsewhere:absent"):
        quick("absent")
    with pytest.raises(UsageError, match="no filter is called 'nome'; known: none, polytope-cbf, cone-"):
        quick("nome")


def test_parameters_are_complete_and_checked():
    parameters = parameters_of("cone-di", {"alpha": 3, "count": 8})
    assert parameters["alpha"] == 3.0
    assert isinstance(parameters["alpha"], float)
    assert (parameters["count"], parameters["reaction_time_s"]) == (8, 0.3)
    for given, message in (
        ({"alhpa": 1.0}, "unknown parameter 'alhpa'; it has alpha, "),
        ({"alpha": "big"}, "alpha must be a number"),
        ({"count": 1.5}, "count must be a whole number"),
        ({"gate": 1}, "gate must be true or false"),
        ({"alpha": True}, "alpha must be a number"),
    ):
        with pytest.raises(UsageError, match=message):
            parameters_of("cone-di", given)
        with pytest.raises(UsageError, match=rf"`\$.safety.cone-di.{next(iter(given))}`|`\$.safety.cone-di`"):
            quick("cone-di", given)
    with pytest.raises(UsageError, match=r"`\$.safety.cone-di.alpha`"):
        quick("cone-di", {"alpha": -1.0})


def test_only_filters_that_read_ellipsoids_index_them_and_the_judge_measures_them_always():
    scene, cover = ball_scene([[2, 2, 0.5]], 0.2), box_cover([((15, 15, 0), (25, 25, 10))])
    given = {"scene": scene, "cover": cover, "bounds_m": [0, 0, 0, 4, 4, 3], "trials": 2, "speed_m_s": 1.0}
    among_hulls, among_both = flown("polytope-cbf", **given), flown("cone-backup", **given)
    assert (len(among_hulls.run.world.index), len(among_both.run.world.index)) == (0, 1)
    assert all(trial.min_gamma is None for trial in among_hulls.trials)
    assert all(trial.min_gamma > 0 for trial in among_both.trials)
    assert all(trial.scene_clearance_m > 0 for trial in among_hulls.trials + among_both.trials)
