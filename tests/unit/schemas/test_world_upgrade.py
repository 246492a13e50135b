"""Upgrade of scenarios of version 1: all values of the examples' files and of the tests' texts carry over."""

import ast
import re
import textwrap
from contextlib import suppress
from functools import cache
from pathlib import Path

import msgspec
import pytest

from alula.schemas.encounters import is_encounters, read_encounters
from alula.schemas.errors import AlulaError, InputError, UsageError
from alula.schemas.filter_options import FILTERS
from alula.schemas.geofence import is_fence_scenario, read_fence_scenario
from alula.schemas.scenario import read_scenario
from alula.schemas.vehicles import VEHICLES
from alula.schemas.world import plain, read_world
from alula.schemas.world_defaults import completed
from support.paths import EXAMPLES, ROOT
from support.paths import VEHICLES as FILES_OF_VEHICLES

OLD_FILES = sorted(
    path
    for path in EXAMPLES.rglob("*.toml")
    if path.parent.name not in ("vehicles", "world") and "alula/mission" not in path.read_text()
)


def read_old(path):
    if is_fence_scenario(path):
        return read_fence_scenario(path)
    return read_encounters(path) if is_encounters(path) else read_scenario(path)


@cache
def texts_of_tests() -> list[str]:
    """Texts in the tests' sources that could be scenarios of version 1."""
    found = set()
    for path in sorted((ROOT / "tests").rglob("*.py")):
        source = path.read_text()
        if not re.search(r"\[(map|encounter|fence|\[obstacles\])\]", source):
            continue
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                text = textwrap.dedent(node.value)
                if re.search(r"^\[(map|encounter|fence|\[obstacles\])\]", text, re.MULTILINE):
                    found.add(text)
    return sorted(found)


def equal(pairs):
    """Check pairs of (name, value of version 1, value of version 2)."""
    wrong = [(name, old, new) for name, old, new in pairs if old != new]
    assert wrong == []


def check_encounters(old, new):
    run, body, way = old.run, old.vehicle, old.encounter
    start = way.start_speed_m_s
    if start is None:
        start = 0.0 if way.hovers else way.cruise_m_s
    named = old.filter.name if old.filter.name != "none" else "dr-acbf"
    sensor = {key: getattr(new.estimation.sensor, key) for key in old.sensor.__struct_fields__}
    equal(
        [
            ("name", old.name, new.name),
            ("type", "double-integrator", new.vehicle.type),
            ("radius", body.radius_m, new.vehicle.radius_m),
            ("speed limit", body.v_max_m_s, new.vehicle.max_speed_m_s),
            ("acceleration", body.a_max_m_s2, new.vehicle.max_acceleration_m_s2),
            ("jerk", body.j_max_m_s3, new.vehicle.max_jerk_m_s3),
            ("delay", body.actuation_delay_s, new.vehicle.actuation_delay_s or 0.0),
            ("yaw rate", body.yaw_rate_rad_s, new.estimation.sensor.yaw_rate_rad_s),
            ("start", way.start_m, new.mission.start_m),
            ("goal", None if way.hovers else way.goal_m, new.mission.goal_m),
            ("kind", "hover" if way.hovers else "goal", new.mission.kind),
            ("start speed", start, new.mission.start_speed_m_s),
            ("cruise", way.cruise_m_s, new.mission.speed_m_s),
            ("gain", way.gain_per_s, new.mission.controller.gain_per_s),
            ("receded", way.receded_s, new.mission.receded_s),
            ("obstacles", old.obstacles, new.world.moving),
            ("walls", old.walls, new.world.walls),
            ("cover", old.map.cover, new.world.cover),
            ("sensor", msgspec.structs.asdict(old.sensor), sensor),
            ("tracker", old.tracker, new.estimation.tracker),
            ("filters", () if old.filter.name == "none" else (old.filter.name,), new.safety.filters),
            ("parameters", old.filter.parameters, new.safety.parameters(named)),
            ("trials", old.trials.count, new.rules.trials),
            ("seed", old.trials.seed, new.rules.seed),
            ("logged", old.trials.logged, new.rules.logged),
            ("dt", run.dt_s, new.rules.dt_s),
            ("steps", run.plant_steps, new.rules.plant_steps),
            ("time", run.max_time_s, new.rules.max_time_s),
            ("rate", run.log_rate_hz, new.rules.log_rate_hz),
        ]
    )


def check_fence(old, new):
    body, run, trials = old.vehicle, old.run, old.trials
    named = old.filter.name if old.filter.name != "none" else "geofence"
    boxed = trials.start_box_m is not None
    fence = new.world.fence
    pilot = {key: getattr(new.mission.pilot, key) for key in old.pilot.__struct_fields__}
    disturbed = msgspec.structs.asdict(new.vehicle.disturbance)
    del disturbed["motor_time_constant_s"]
    equal(
        [
            ("name", old.name, new.name),
            ("file", body.file, new.vehicle.file),
            ("interface", "sticks", new.vehicle.interface),
            *((key, getattr(body, key), getattr(new.vehicle, key)) for key in ("radius_m", "mass_scale")),
            ("thrust", body.thrust_scale, new.vehicle.thrust_scale),
            ("rates", body.rate_gain_scale, new.vehicle.rate_gain_scale),
            ("delay", body.delay_s, new.estimation.delay_s),
            *((key, getattr(body, key), value) for key, value in disturbed.items()),
            ("box", old.fence.box_m, None if fence is None else fence.box_m),
            ("faces", old.fence.faces, () if fence is None else fence.faces),
            ("cover", old.fence.cover, new.world.cover),
            ("filters", () if old.filter.name == "none" else (old.filter.name,), new.safety.filters),
            ("parameters", old.filter.parameters, new.safety.parameters(named)),
            ("pilot", msgspec.structs.asdict(old.pilot), pilot),
            (
                "radio",
                (run.radio_from_s, run.radio_for_s),
                (new.mission.pilot.radio_from_s, new.mission.pilot.radio_for_s),
            ),
            (
                "lost",
                (run.stale_from_s, run.stale_for_s),
                (new.estimation.lost_from_s, new.estimation.lost_for_s),
            ),
            ("start", trials.start_m, new.mission.start_m),
            ("start box", trials.start_box_m, new.mission.start_box_m),
            ("velocity", trials.start_velocity_m_s, new.mission.start_velocity_m_s or (0.0, 0.0, 0.0)),
            ("yaw", trials.start_yaw_deg, new.mission.start_yaw_deg),
            ("speed", trials.start_speed_m_s if boxed else 0.0, new.mission.start_speed_m_s),
            ("tilt", trials.start_tilt_deg if boxed else 0.0, new.mission.start_tilt_deg),
            ("trials", trials.count, new.rules.trials),
            ("seed", trials.seed, new.rules.seed),
            ("tick", old.filter.parameters.tick_s, new.rules.dt_s),
            ("steps", run.plant_steps, new.rules.plant_steps),
            ("time", run.duration_s, new.rules.max_time_s),
            ("logged", run.traces, new.rules.logged),
            ("rate", run.log_rate_hz, new.rules.log_rate_hz),
        ]
    )


def check_pairs(old, new):
    mission, rules, world, safety = new.mission, new.rules, new.world, new.safety
    table, trials, run, controller = old.map, old.trials, old.run, old.controller
    name = old.filter.name or "polytope-cbf"
    count = trials.count or (100 if table.plan is None else 1)

    def given(value, default):
        return default if value is None else value

    equal(
        [
            ("name", given(old.name, "run"), new.name),
            ("cover", table.cover, world.cover),
            ("scene", table.scene, world.scene),
            ("plan", table.plan, mission.plan),
            ("sigma", given(table.sigma, 1.0), world.sigma),
            ("confidence", table.confidence, world.confidence),
            ("inflation", table.inflation_m, world.inflation_m),
            ("onboard", old.filter.parameters.get("onboard", False), world.onboard),
            ("filters", () if name == "none" else (name,), safety.filters),
            ("gain", given(controller.gain, 2.0), mission.controller.gain_per_s),
            ("guide", given(controller.guide, "none"), mission.controller.guide),
            ("guide parameters", controller.guide_parameters, mission.controller.guide_parameters),
            ("catch-up", controller.catch_up_m_s, mission.controller.catch_up_m_s),
            ("trials", count, rules.trials),
            ("logged", count, rules.logged),
            ("seed", given(trials.seed, 0), rules.seed),
            ("step", given(run.dt_s, 0.01), rules.dt_s),
            ("time", run.max_time_s, rules.max_time_s),
            ("log", given(run.log_rate_hz, 20.0), rules.log_rate_hz),
            ("controller", given(run.controller_ticks, 1), rules.controller_ticks),
            ("filter", given(run.filter_ticks, 1), rules.filter_ticks),
            ("stop", given(trials.stop_fraction, 0.01), mission.stop_fraction),
            ("via", run.via_tolerance_m, mission.via_tolerance_m),
            ("tight", given(run.allow_tight, False), mission.allow_tight),
            ("planned", given(trials.planned, False), mission.planned),
            ("which", given(trials.pairs, "any"), mission.which),
        ]
    )
    if table.plan is None:
        keys = (trials.bounds_m, given(trials.margin_m, 0.05), given(trials.separation, 0.3))
        assert keys == (mission.bounds_m, mission.margin_m, mission.separation)
    if name == "polytope-cbf":
        defaults = {"beta": 2.0, "kappa_per_m": 100.0, "smoothing": "sound", "onboard": False}
        assert defaults | old.filter.parameters == msgspec.structs.asdict(safety.polytope_cbf)
    elif name in FILTERS and name != "none":
        parameters = safety.parameters(name)
        assert {key: getattr(parameters, key) for key in old.filter.parameters} == {
            key: tuple(value) if isinstance(value, list) else value
            for key, value in old.filter.parameters.items()
        }


def check(path):
    old, new = read_old(path), read_world(path)
    if is_fence_scenario(path):
        check_fence(old, new)
    elif is_encounters(path):
        check_encounters(old, new)
    else:
        check_pairs(old, new)


@pytest.mark.parametrize("path", OLD_FILES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_every_example_carries_over(path):
    check(path)


def test_every_scenario_of_the_tests_carries_over(tmp_path):
    path = tmp_path / "old.toml"
    checked = 0
    for text in texts_of_tests():
        path.write_text(text)
        try:
            read_old(path)
            with suppress(InputError):  # of a plan that the test makes; see below
                read_world(path)
        except AlulaError:
            continue  # a test of an error
        checked += 1
        try:
            check(path)
        except InputError as error:
            assert "plan" in str(error)  # a plan that the test makes  # noqa: PT017
    assert checked >= 12


@pytest.fixture
def upgrade(tmp_path):
    def upgrade(text):
        path = tmp_path / "old.toml"
        path.write_text(text)
        return read_world(path)

    return upgrade


HULLS = "[map]\ncover = 'c.npz'\n"
SCENE = "[map]\nscene = 's.npz'\n"


def test_defaults_of_version_one_that_differ_are_written_out(upgrade):
    hulls = upgrade(HULLS).vehicle
    assert (hulls.type, hulls.radius_m, hulls.max_speed_m_s) == ("single-integrator", 0.1, 1.0)
    scene = upgrade(SCENE + "[filter]\nname = 'cone-di'")
    assert (scene.vehicle.type, scene.mission.speed_m_s) == ("fastbridge", 1.0)
    moving = upgrade("[encounter]")
    assert (moving.rules.plant_steps, moving.rules.max_time_s, moving.mission.receded_s) == (10, 14.0, 1.0)
    fence = "[fence]\nbox_m = [-1, -1, -1, 1, 1, 1]\n[vehicle]\nfile = 'x'\n[trials]\n"
    boxed = upgrade(fence + "start_box_m = [0, 0, 0, 1, 1, 1]")
    assert (boxed.mission.start_speed_m_s, boxed.mission.start_tilt_deg) == (10.0, 57.3)
    assert (boxed.rules.dt_s, boxed.rules.plant_steps) == (0.0025, 4)
    lost = upgrade(fence + "start_m = [0, 0, 0]\n[run]\nstale_from_s = 1")
    assert lost.estimation.stale_s == float("inf")


def test_a_real_flight_keeps_its_table(upgrade):
    assert upgrade(HULLS + "[fly]\nlink = 'sim:'\nrate_hz = 50").fly.rate_hz == 50.0


def test_a_plan_gives_radius_and_speed_to_a_point_without_a_file(upgrade):
    with pytest.raises(InputError, match=r"p\.plan\.npz"):
        upgrade(HULLS + "plan = 'p.plan.npz'")
    text = HULLS + "plan = 'p.plan.npz'\n[vehicle]\nradius_m = 0.2\nv_max_m_s = 3"
    assert upgrade(text).vehicle.max_speed_m_s == 3.0


def test_a_quadrotor_flown_as_a_point_becomes_one(upgrade, tmp_path):
    text = SCENE + "[filter]\nname = 'cone-di'\n[vehicle]\nplant = 'double-integrator'\n"
    vehicle = upgrade(text).vehicle
    assert (vehicle.type, vehicle.radius_m) == ("double-integrator", VEHICLES["fastbridge"].body.radius_m)
    assert vehicle.max_acceleration_m_s2 == float("inf")
    file = (FILES_OF_VEHICLES / "fastbridge.toml").read_text()
    noisy = file + "\n[disturbance]\nposition_noise_m = 0.02\ndelay_s = 0.01\n"
    Path(tmp_path / "v.toml").write_text(noisy.replace("kv_per_s = 2.0", "kv_per_s = 2.5"))
    new = upgrade(text + "file = 'v.toml'")
    assert (new.vehicle.velocity_gain_per_s, new.estimation.position_noise_m) == (2.5, 0.02)
    Path(tmp_path / "v.toml").write_text(file.replace("kp_per_s2 = 3.0", "kp_per_s2 = 4.0"))
    with pytest.raises(UsageError, match="write one of a double integrator with the gains of fastbridge"):
        upgrade(text + "file = 'v.toml'")


@pytest.mark.parametrize("path", OLD_FILES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_an_upgraded_file_reads_back(path, tmp_path):
    from alula.schemas.world import read_sources
    from alula.schemas.world_defaults import vehicle_of
    from alula.schemas.world_text import toml_of, values_of

    read = read_sources(path)
    vehicle = vehicle_of(read.scenario, path.parent)
    again = tmp_path / "new.toml"
    again.write_text(toml_of(values_of(read, vehicle, path.name)))
    assert read_world(again) == completed(read.scenario, vehicle)
    assert 'version = "2.0"' in again.read_text()
    assert plain(read_world(again))["version"] == "2.0"
