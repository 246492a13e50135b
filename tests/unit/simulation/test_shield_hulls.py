"""Shields over the hulls of a cover: the chain from the scene to the flight, judged from the truth."""

import dataclasses

import msgspec
import numpy as np
import pytest

from alula import _core
from alula.cli.main import run
from alula.cli.verbs.runs import check_trials
from alula.schemas.artifacts.artifact import write_artifact
from alula.schemas.errors import CheckError, UsageError
from alula.schemas.log.run import read_run
from alula.schemas.parameters.configs.demo_scene import DemoSceneConfig
from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
from alula.schemas.parameters.configs.merge import MergeConfig
from alula.schemas.parameters.configs.scale_align import ScaleAlignConfig
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.alignment.scale_align import scale_align
from alula.stages.clearance import hull_obstacles
from alula.stages.compression.hulls import Hulls
from alula.stages.compression.merge import merge
from alula.stages.compression.verify import verify
from alula.stages.compression.voxelize import voxelize
from alula.stages.reconstruction.demo_scene import demo_scene, world_from_scene
from alula.stages.reconstruction.import_splat import import_splat
from support.flights.world_runs import flown, made_from
from support.models.clearances import clearance_to_hulls, clearance_to_scene
from support.models.wrench_flight import RADIUS, VEHICLE, Flight, admissible_start, attitude_controlled
from support.scenes.small_scenes import ball_scene, box_cover

BALL = ball_scene([[2.0, 0, 1]], 0.3)
BOX = box_cover([((16, -4, 6), (24, 4, 14))])  # the ball and 0.1 m around it
AROUND = (0.0, -1.5, 0.0, 4.0, 1.5, 2.0)


@dataclasses.dataclass(frozen=True)
class Room:
    """The built-in room, its cover, and the hulls as a map."""

    scene: object
    cover: object
    hulls: Hulls
    set_: _core.PolytopeSet
    radius: float = RADIUS

    def clearance(self, positions):
        """Minimum distance of a path to a hull or an ellipsoid, less the radius."""
        to_scene = clearance_to_scene(positions, self.scene, 1.0).min()
        return min(to_scene, clearance_to_hulls(positions, self.hulls).min()) - self.radius


@pytest.fixture(scope="module")
def room():
    splats = demo_scene(DemoSceneConfig(gaussians=20_000), 0)
    scene = scale_align(ScaleAlignConfig(), import_splat(ImportSplatConfig(), splats), world_from_scene(), 0)
    voxels = made_from(voxelize(VoxelizeConfig(size_m=0.1), scene), scene)
    cover = merge(MergeConfig(hulls=150), voxels)
    assert verify(cover, scene=scene).covered
    hulls = Hulls.from_cover(cover)
    return Room(scene, cover, hulls, hull_obstacles(hulls))


def quick(filters="cone-backup", parameters=None, **fields):
    return flown(filters, parameters, **({"trials": 8, "speed_m_s": 2.5} | fields))


def against(which):
    return {"shield_map": which}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "with_scene", "which"),
    [
        ("cone-backup", True, "hulls"),
        ("cone-ecbf", True, "both"),
        ("shield", True, "hulls"),
        ("shield", False, "hulls"),
    ],
)
def test_certified_flights_in_the_room_meet_neither_hulls_nor_ellipsoids(room, name, with_scene, which):
    """References run straight through the furniture: every pair is blocked where the scene can tell."""
    result = quick(
        name,
        against(which),
        which="blocked" if with_scene else "any",
        seed=5,
        scene=room.scene if with_scene else None,
        cover=room.cover,
    )
    assert len(result.trials) == 8
    for trial, flight in zip(result.trials, result.flights, strict=True):
        assert trial.certified_steps == trial.steps
        assert trial.map_clearance_m > 0
        assert not trial.collision
        assert clearance_to_scene(flight.rows("state")[:, :3], room.scene, 1.0).min() > RADIUS
        if with_scene:
            assert trial.scene_clearance_m > 0
    found = result.summary
    parts = ["ellipsoids", "hulls"] if which == "both" else [which]
    assert found["certified_against"] == parts
    assert found["certified_share_static"] == 1
    assert found["hull_radius_m"] == FASTBRIDGE.body.radius_m
    chain = result.guarantee.claims["chain"]
    assert chain["holds"]
    assert "the vehicle met no ellipsoid of the scene" in chain["statement"]
    assert [words.split(":")[0] for words in chain["assumptions"]] == [
        *("Cover", "Model", "Estimation", "Delay", "Inflation", "Rest", "World")
    ]
    assert result.guarantee.claims["hulls_clear"]
    assert chain["statement"] in result.guarantee.statement


@pytest.mark.slow
def test_no_nominal_command_flies_the_shield_into_the_room(room):
    """Into the nearest hull at full tilt, from 20 states in motion."""
    map_, rng = _core.HullMap(room.set_), np.random.default_rng(3)
    policy = _core.BackupPolicy(VEHICLE, "brake")
    shield, flown = _core.Shield(policy, map_, RADIUS), _core.ShieldFilter(policy, map_, RADIUS)
    lower, upper = (np.array(corner) for corner in room.set_.bounds())

    def into_the_wall(_, x):
        return attitude_controlled(VEHICLE, x, -8 * map_.near(tuple(x[:3]), 20.0, 1)["normal"][0])

    def start():
        while True:
            x = admissible_start(rng, shield)
            x[:3] = rng.uniform(lower + 0.3, upper - 0.3)
            if shield.certify(x)["safe"]:
                return x

    least = []
    for _ in range(20):
        flown.reset()
        flight = Flight(room, VEHICLE, flown, start(), into_the_wall, 200)
        assert all(report["certified"] for report in flight.reports)
        least.append(flight.clearance)
    assert min(least) > 0
    assert min(least) < 0.05  # the shield lets them come that near


def test_a_shield_that_has_the_hulls_keeps_clear_of_them_and_one_without_does_not():
    """The box is wider than the ball in it: straight past the ball the hull is in the way."""
    pairs = {"trials": 6, "bounds_m": AROUND, "seed": 2, "margin_m": 0.2, "scene": BALL, "cover": BOX}
    one, other = (quick("cone-backup", against(which), **pairs) for which in ("ellipsoids", "hulls"))
    assert one.summary["certified_against"] == ["ellipsoids"]
    assert one.guarantee.claims["chain"] is None
    assert one.guarantee.claims["scene_collisions"] == other.summary["collisions"] == 0
    assert one.summary["collisions"] == one.guarantee.claims["hull_collisions"] > 0  # hulls are obstacles
    assert one.summary["min_map_clearance_m"] < -0.1
    with pytest.raises(CheckError, match="cone-backup does not certify hulls, which count as obstacles"):
        check_trials("a", one.run.scenario, one.trials)
    assert other.summary["min_map_clearance_m"] > 0
    assert other.summary["min_scene_clearance_m"] >= other.summary["min_map_clearance_m"]


@pytest.mark.slow
def test_flights_among_hulls_do_not_depend_on_jobs(room):
    files = {"scene": room.scene, "cover": room.cover}
    one, many = (quick("cone-backup", against("both"), trials=4, jobs=jobs, **files) for jobs in (1, 3))
    assert one.trials == many.trials
    assert one.flights == many.flights


def late_as_assumed(lag_s, delay_s=0.0):
    late, replace = {"motor_time_constant_s": lag_s, "delay_s": delay_s}, msgspec.structs.replace
    return replace(
        FASTBRIDGE,
        disturbance=replace(FASTBRIDGE.disturbance, **late),
        assumed=replace(FASTBRIDGE.assumed, **late),
    )


def test_lag_and_delay_that_are_assumed_leave_the_chain_whole(room):
    vehicle = late_as_assumed(0.03, 0.02)
    found = quick("shield", trials=6, speed_m_s=1.5, max_time_s=8.0, vehicle=vehicle, cover=room.cover)
    assert found.summary["certified_share_static"] == 1
    assert found.summary["min_map_clearance_m"] > 0
    chain = found.guarantee.claims["chain"]
    assert chain["holds"]
    assert any("a motor time constant of 0.03 s" in words for words in chain["assumptions"])
    assert any("it is 0.02 s old" in words for words in chain["assumptions"])


@pytest.mark.parametrize(("interface", "delay_s"), [("wrench", 0.0), ("body-rates", 0.0325)])
def test_commands_held_for_some_ticks_stay_certified_with_lag(room, interface, delay_s):
    """One wrench is held for four ticks, by rotors that need longer than one."""
    found = quick(
        "shield",
        trials=6,
        speed_m_s=3.0,
        max_time_s=4.0,
        seed=11,
        interface=interface,
        filter_ticks=4,
        vehicle=late_as_assumed(0.05, delay_s),
        scene=room.scene,
        cover=room.cover,
        which="blocked",
        parameters=against("hulls"),
    )
    assert found.summary["certified_share_static"] == 1
    assert found.summary["min_map_clearance_m"] > 0.005
    assert found.guarantee.claims["chain"]["holds"]


def test_a_map_that_a_shield_needs_is_asked_for_in_one_sentence():
    for name, which, files, words in (
        ("cone-backup", "hulls", {"scene": BALL}, "shield_map`: hulls needs world.cover"),
        ("shield", "both", {"cover": BOX}, "shield_map`: both needs world.scene"),
        ("shield", "x", {"cover": BOX}, "shield_map`"),
    ):
        with pytest.raises(UsageError, match=rf"`\$.safety.{name}.{words}"):
            quick(name, against(which), **files)
    with pytest.raises(UsageError, match=r"cone-di needs ellipsoids; set world.scene, or .*safer-splat, or"):
        quick("shield", guide="cone-di", cover=BOX)


def test_hulls_that_have_grown_by_the_inflation_are_not_kept_from_again():
    grown = dataclasses.replace(BOX, manifest=msgspec.structs.replace(BOX.manifest, inflation_m=0.03))
    scene = dataclasses.replace(
        BALL, manifest=msgspec.structs.replace(BALL.manifest, suggested_inflation_m=0.05)
    )
    for cover, changes, beyond in ((BOX, {}, 0.05), (grown, {}, 0.02), (grown, {"inflation_m": 0.1}, 0.1)):
        given = {"trials": 1, "bounds_m": AROUND, "scene": scene, "cover": cover}
        found = quick("shield", against("hulls"), **given | changes).summary
        assert found["hull_radius_m"] == pytest.approx(FASTBRIDGE.body.radius_m + beyond)


def test_what_breaks_the_chain_is_said():
    windy = {"wind_m_s": (1.0, 0, 0), "linear_drag_n_s_m": (1e-3, 0, 0)}
    vehicle = msgspec.structs.replace(
        FASTBRIDGE, disturbance=msgspec.structs.replace(FASTBRIDGE.disturbance, **windy)
    )
    thin = dataclasses.replace(BOX, manifest=msgspec.structs.replace(BOX.manifest, min_overlap=2))
    for body, cover, words in (
        (vehicle, BOX, "These flights had drag (linear_drag_n_s_m 0.001 0 0), wind (wind_m_s 1 0 0), which"),
        (FASTBRIDGE, thin, "The cover leaves out voxels that fewer than 2 ellipsoids touch"),
    ):
        found = quick("shield", trials=1, bounds_m=AROUND, vehicle=body, cover=cover)
        chain = found.guarantee.claims["chain"]
        assert not chain["holds"]
        assert words in chain["statement"]


def moved_ball(**fields):
    return dataclasses.replace(BALL, manifest=msgspec.structs.replace(BALL.manifest, **fields))


@pytest.mark.parametrize(
    ("cover", "scene", "changes", "words"),
    [
        (
            made_from(BOX, BALL),
            BALL,
            {"sigma": 3.0},
            "are those at 3 sigma, and the cover contains those at 1",
        ),
        (
            made_from(BOX, moved_ball(summary={"other": 1})),
            BALL,
            {},
            "made from another scene file, scene.npz",
        ),
        (BOX, BALL, {}, "made from another scene file"),
        (
            made_from(BOX, moved_ball(suggested_inflation_m=0.05)),
            moved_ball(suggested_inflation_m=0.05),
            {"inflation_m": 0.01},
            "together is 0.01 m, less than the 0.05 m that the alignment",
        ),
    ],
    ids=["level", "another scene", "a scene unknown", "inflation"],
)
def test_the_chain_breaks_where_cover_and_scene_do_not_fit(cover, scene, changes, words):
    given = {"trials": 1, "bounds_m": AROUND, "seed": 2, "margin_m": 0.2} | changes
    chain = quick("shield", against("hulls"), cover=cover, scene=scene, **given).guarantee.claims["chain"]
    assert not chain["holds"]
    assert words in chain["statement"]
    assert "met no" not in chain["statement"]


def test_the_chain_holds_for_the_scene_that_the_cover_was_made_from():
    given = {"trials": 1, "bounds_m": AROUND, "seed": 2, "margin_m": 0.2, "scene": BALL}
    found = quick("shield", against("hulls"), cover=made_from(BOX, BALL), **given)
    chain = found.guarantee.claims["chain"]
    assert chain["holds"], chain["broken_by"]
    assert chain["made_from"][0]["sha256"] == chain["inputs"]["scene"]
    assert "met no ellipsoid of the scene at 1 sigma" in chain["statement"]
    nameless = msgspec.structs.replace(BOX.manifest, made_from=[])
    alone = quick("shield", cover=dataclasses.replace(BOX, manifest=nameless), trials=1, bounds_m=AROUND)
    chain = alone.guarantee.claims["chain"]
    assert not chain["holds"]
    assert "The cover does not name the file of its ellipsoids" in chain["statement"]


@pytest.mark.parametrize("part", ["map_clearance_m", "scene_clearance_m"])
def test_a_hit_breaks_every_claim_about_what_was_hit(part):
    """The judgement is replaced: a certificate that the truth contradicts must not be claimed."""
    given = {"trials": 1, "bounds_m": AROUND, "seed": 2, "margin_m": 0.2, "scene": BALL}
    found = quick("shield", cover=made_from(BOX, BALL), **given)
    assert found.guarantee.claims["every_step_certified"]
    hit = [msgspec.structs.replace(trial, collision=True, **{part: -0.1}) for trial in found.trials]
    claims = dataclasses.replace(found, run=dataclasses.replace(found.run, trials=hit)).guarantee
    assert not claims.claims["every_step_certified"]
    assert not claims.claims["chain"]["holds"]
    what = "a hull" if part == "map_clearance_m" else "an ellipsoid of the scene"
    assert f"This did not hold: 1 of 1 flights touched {what}." in claims.statement
    assert "met no" not in claims.statement


def test_a_shield_certifies_by_default_all_that_flights_are_judged_against():
    """The flights past the ball in the test above, of which most touch the wider box without its hulls."""
    pairs = {"trials": 6, "bounds_m": AROUND, "seed": 2, "margin_m": 0.2, "scene": BALL, "cover": BOX}
    found = quick("cone-backup", **pairs).summary
    assert found["certified_against"] == ["ellipsoids", "hulls"]
    assert found["certified_share_static"] == 1
    assert found["collisions"] == 0


def test_the_command_flies_a_quadrotor_in_a_cover_alone(tmp_path, capsys):
    cover, scene, out = (tmp_path / name for name in ("box.cover.npz", "ball.scene.npz", "flown.run.mcap"))
    write_artifact(cover, BOX)
    write_artifact(scene, BALL)
    bounds = ["--set", f"mission.bounds_m={','.join(map(str, AROUND))}"]
    beyond = ("--set", "mission.beyond_map_m=5")
    assert (
        run(["simulate", str(cover), "-o", str(out), "--filter", "shield", "--trials", "2", *bounds, *beyond])
        == 0
    )
    record = read_run(out)
    assert record.summary["certified_against"] == ["hulls"]
    assert all(trial.scene_clearance_m is None and trial.map_clearance_m > 0 for trial in record.trials)
    assert "quadrotor" in record.vehicle
    capsys.readouterr()
    given = [
        "simulate",
        str(scene),
        "-o",
        str(out),
        "-f",
        "--filter",
        "cone-backup",
        "--set",
        "safety.cone-backup.shield_map=hulls",
    ]
    assert run(given) == 2
    message = capsys.readouterr().err
    assert "`$.safety.cone-backup.shield_map`: hulls needs world.cover" in message
    assert len(message.strip().splitlines()) == 1
