"""Flights that steer among the hulls of a cover without a scene, judged from the truth."""

import functools

import msgspec
import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.artifact import write_artifact
from alula.schemas.configs.simulate import SimulateConfig
from alula.schemas.errors import UsageError
from alula.schemas.run import read_run
from alula.schemas.vehicle import FASTBRIDGE
from alula.stages.clearance import clearance_to_hulls
from alula.stages.compression.hulls import Hulls
from alula.stages.simulation.ellipsoids.simulate import simulate_splat
from support.small_scenes import ball_scene, box_cover

RADIUS = FASTBRIDGE.body.radius_m
PILLARS = box_cover(
    [((x, y, -10), (x + 4, y + 4, 40)) for x in (8, 24) for y in (-22, -6, 10)]
    + [((x, y, -10), (x + 3, y + 5, 40)) for x in (16, 32) for y in (-14, 2)]
)
AROUND = (0.0, -2.5, 0.5, 4.5, 2.5, 2.5)


def flown(name, vehicle=FASTBRIDGE, **fields):
    config = SimulateConfig(
        **(
            {"trials": 10, "filter": name, "speed_m_s": 2.0, "pairs": "blocked", "bounds": AROUND, "seed": 3}
            | fields
        )
    )
    return simulate_splat(config, None, vehicle, cover=PILLARS)


@functools.cache
def reached_by_the_shield_alone():
    return flown("shield").summary["reached"]


@pytest.mark.parametrize("name", ["cone-backup", "cone-ecbf"])
def test_certified_flights_steer_around_pillars(name):
    """The straight line of every pair is blocked, so the shield alone only stops in front of a pillar."""
    result = flown(name)
    assert result.summary["reached"] >= reached_by_the_shield_alone() + 6
    assert result.summary["certified_against"] == "hulls"
    hulls = Hulls.from_cover(PILLARS)
    for trial, flight in zip(result.trials, result.flights, strict=True):
        assert trial.certified_steps == trial.steps
        assert not trial.collision
        assert clearance_to_hulls(flight.position, hulls).min() > RADIUS
    assert result.guarantee.claims["chain"]["holds"]


def test_an_ideal_double_integrator_behind_safer_splat_meets_no_hull():
    result = flown("safer-splat", plant="double-integrator", max_time_s=20.0)
    assert result.summary["collisions"] == 0
    assert result.summary["reached"] >= reached_by_the_shield_alone() + 6
    assert result.guarantee.claims["hulls_clear"]
    assert result.guarantee.claims["certified_against"] is None
    assert "the cover's hulls" in result.guarantee.statement


def test_rows_alone_are_judged_by_the_hulls_too():
    """Without its shield a filter proves nothing; its summary names no certificate."""
    result = flown("cone-backup", trials=4, filter_parameters={"shield": False})
    assert "certified_against" not in result.summary
    assert result.summary["min_map_clearance_m"] is not None
    assert result.guarantee.claims["chain"] is None
    assert result.guarantee.claims["hull_collisions"] == result.summary["collisions"]


def test_the_policy_that_escapes_from_ellipsoids_flies_among_hulls():
    found = flown("cone-backup", trials=3, filter_parameters={"policy": "cone-escape"}).summary
    assert found["certified_share"] == 1
    assert found["collisions"] == 0


def test_a_guide_steers_among_hulls_too():
    alone, guided = (
        flown("shield", guide=guide, trials=5, seed=4).summary for guide in ("none", "safer-splat")
    )
    assert guided["reached"] >= alone["reached"] + 3
    assert guided["collisions"] == 0
    assert guided["certified_share"] == 1


def test_with_a_scene_rows_are_of_hulls_where_the_shield_has_them():
    """The scene has nothing but a ball far away, so all steering is by the hulls."""
    scene, pairs = (
        ball_scene([[0, 0, 30.0]], 0.3),
        {"trials": 5, "bounds": AROUND, "seed": 3, "speed_m_s": 2.0},
    )
    reached = {}
    for against in ("ellipsoids", "hulls", "both"):
        config = SimulateConfig(filter="cone-backup", filter_parameters={"shield_map": against}, **pairs)
        summary = simulate_splat(config, scene, FASTBRIDGE, cover=PILLARS).summary
        reached[against] = summary["reached"]
        assert (summary["min_map_clearance_m"] > 0) == (against != "ellipsoids")
    assert min(reached.values()) >= 4


def test_results_do_not_depend_on_jobs():
    one, other = (
        simulate_splat(
            SimulateConfig(filter="cone-ecbf", trials=4, speed_m_s=2.0, bounds=AROUND),
            None,
            FASTBRIDGE,
            cover=PILLARS,
            jobs=jobs,
        )
        for jobs in (1, 2)
    )
    assert one.trials == other.trials
    for a, b in zip(one.flights, other.flights, strict=True):
        np.testing.assert_array_equal(a.state, b.state)


def test_what_needs_ellipsoids_is_refused_in_one_sentence():
    with pytest.raises(UsageError, match="cone-di needs a scene, for its ellipsoids; in a cover alone"):
        flown("cone-di")
    with pytest.raises(UsageError, match="cone-ecbf: shield_map=both needs a scene"):
        flown("cone-ecbf", filter_parameters={"shield_map": "both"})
    with pytest.raises(UsageError, match="--guide cone-di needs a scene"):
        flown("cone-backup", guide="cone-di")


@pytest.mark.parametrize("name", ["cone-backup", "cone-ecbf", "safer-splat"])
def test_the_command_flies_in_a_cover_alone(name, tmp_path):
    cover, out = tmp_path / "pillars.cover.npz", tmp_path / "flown.run.mcap"
    write_artifact(cover, PILLARS)
    words = ["simulate", str(cover), "-o", str(out), "--filter", name, "--trials", "2", "--speed", "1"]
    assert run([*words, "--bounds", *map(str, AROUND)]) == 0
    record = read_run(out)
    assert record.summary.get("certified_against") == (None if name == "safer-splat" else "hulls")
    assert all(trial.scene_clearance_m is None and trial.map_clearance_m > 0 for trial in record.trials)


def test_a_cover_that_has_grown_by_less_than_the_scene_suggests_is_kept_from_by_the_rest():
    """The radius of the rows is that of the shield."""
    vehicle = msgspec.structs.replace(FASTBRIDGE, body=msgspec.structs.replace(FASTBRIDGE.body, radius_m=0.2))
    found = flown("safer-splat", vehicle, trials=2, plant="double-integrator", inflation_m=0.1)
    assert found.summary["min_map_clearance_m"] > 0.1 - 1e-3
