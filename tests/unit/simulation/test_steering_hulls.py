"""Flights that steer among the hulls of a cover without a scene, judged from the truth."""

import functools

import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import write_artifact
from alula.schemas.errors import UsageError
from alula.schemas.log.run import read_run
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.compression.hulls import Hulls
from support.flights import world_runs
from support.models.clearances import clearance_to_hulls
from support.scenes.small_scenes import ball_scene, box_cover

RADIUS = FASTBRIDGE.body.radius_m
PILLARS = box_cover(
    [((x, y, -10), (x + 4, y + 4, 40)) for x in (8, 24) for y in (-22, -6, 10)]
    + [((x, y, -10), (x + 3, y + 5, 40)) for x in (16, 32) for y in (-14, 2)]
)
AROUND = (0.0, -2.5, 0.5, 4.5, 2.5, 2.5)


def flown(name, parameters=None, **fields):
    given = {"trials": 10, "speed_m_s": 2.0, "which": "blocked", "bounds_m": AROUND, "seed": 3}
    return world_runs.flown(name, parameters, cover=PILLARS, **(given | fields))


@functools.cache
def reached_by_the_shield_alone():
    return flown("shield").summary["reached"]


@pytest.mark.parametrize("name", ["cone-backup", "cone-ecbf"])
def test_certified_flights_steer_around_pillars(name):
    """The straight line of every pair is blocked, so the shield alone only stops in front of a pillar."""
    result = flown(name)
    assert result.summary["reached"] >= reached_by_the_shield_alone() + 6
    assert result.summary["certified_against"] == ["hulls"]
    hulls = Hulls.from_cover(PILLARS)
    for trial, flight in zip(result.trials, result.flights, strict=True):
        assert trial.certified_steps == trial.steps
        assert not trial.collision
        assert clearance_to_hulls(flight.rows("state")[:, :3], hulls).min() > RADIUS
    assert result.guarantee.claims["chain"]["holds"]


def test_an_ideal_double_integrator_behind_safer_splat_meets_no_hull():
    result = flown("safer-splat", vehicle=world_runs.IDEAL_POINT, max_time_s=20.0)
    assert result.summary["collisions"] == 0
    assert result.summary["reached"] >= reached_by_the_shield_alone() + 6
    assert result.guarantee.claims["hulls_clear"]
    assert result.guarantee.claims["certified_against"] is None
    assert "the cover's hulls" in result.guarantee.statement


def test_rows_alone_are_judged_by_the_hulls_too():
    """Without its shield a filter proves nothing; its summary names no certificate."""
    result = flown("cone-backup", {"shield": False}, trials=4)
    assert "certified_against" not in result.summary
    assert result.summary["min_map_clearance_m"] is not None
    assert result.guarantee.claims["chain"] is None
    assert result.guarantee.claims["hull_collisions"] == result.summary["collisions"]


def test_the_policy_that_escapes_from_ellipsoids_flies_among_hulls():
    found = flown("cone-backup", {"policy": "cone-escape"}, trials=3).summary
    assert found["certified_share_static"] == 1
    assert found["collisions"] == 0


def test_a_guide_steers_among_hulls_too():
    alone, guided = (
        flown("shield", guide=guide, trials=5, seed=4).summary for guide in ("none", "safer-splat")
    )
    assert guided["reached"] >= alone["reached"] + 3
    assert guided["collisions"] == 0
    assert guided["certified_share_static"] == 1


def test_with_a_scene_rows_are_of_hulls_where_the_shield_has_them():
    """The scene has nothing but a ball far away, so all steering is by the hulls."""
    scene = ball_scene([[0, 0, 30.0]], 0.3)
    reached = {}
    for against in ("ellipsoids", "hulls", "both"):
        found = flown("cone-backup", {"shield_map": against}, trials=5, which="any", scene=scene)
        summary = found.summary
        reached[against] = summary["reached"]
        assert (summary["min_map_clearance_m"] > 0) == (against != "ellipsoids")
    assert min(reached.values()) >= 4


def test_results_do_not_depend_on_jobs():
    one, other = (flown("cone-ecbf", trials=4, which="any", seed=0, jobs=jobs) for jobs in (1, 2))
    assert one.trials == other.trials
    assert one.flights == other.flights


def test_what_needs_ellipsoids_is_refused_in_one_sentence():
    with pytest.raises(UsageError, match=r"cone-di needs ellipsoids; set world.scene, or fly shield among"):
        flown("cone-di")
    with pytest.raises(UsageError, match=r"cone-ecbf.shield_map`: both needs world.scene"):
        flown("cone-ecbf", {"shield_map": "both"})
    with pytest.raises(UsageError, match=r"guide`: cone-di needs ellipsoids; set world.scene"):
        flown("cone-backup", guide="cone-di")


@pytest.mark.parametrize("name", ["cone-backup", "cone-ecbf", "safer-splat"])
def test_the_command_flies_in_a_cover_alone(name, tmp_path):
    cover, out = tmp_path / "pillars.cover.npz", tmp_path / "flown.run.mcap"
    write_artifact(cover, PILLARS)
    words = ["simulate", str(cover), "-o", str(out), "--filter", name, "--trials", "2", "--speed", "1"]
    assert (
        run(
            [
                *words,
                "--set",
                "mission.beyond_map_m=5",
                "--set",
                f"mission.bounds_m={','.join(map(str, AROUND))}",
            ]
        )
        == 0
    )
    record = read_run(out)
    assert record.summary.get("certified_against") == (None if name == "safer-splat" else ["hulls"])
    assert all(trial.scene_clearance_m is None and trial.map_clearance_m > 0 for trial in record.trials)


def test_a_cover_that_has_grown_by_less_than_the_scene_suggests_is_kept_from_by_the_rest():
    """The radius of the rows is that of the shield."""
    found = flown("safer-splat", trials=2, vehicle=world_runs.IDEAL_POINT, radius_m=0.2, inflation_m=0.1)
    assert found.summary["min_map_clearance_m"] > 0.1 - 1e-3
