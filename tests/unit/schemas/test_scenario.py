"""Scenarios: the values that they set, changes of --set, errors that name the key, text."""

import math

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from alula.schemas.decode import decode_toml
from alula.schemas.errors import InputError, UsageError, VersionError, WrongKindError
from alula.schemas.parameters.filter_options import TABLES
from alula.schemas.scenarios.defaults import completed, interface_of, vehicle_of
from alula.schemas.scenarios.ranges import USED
from alula.schemas.scenarios.scenario import FILES, decoded, plain, read_scenario, read_sources
from alula.schemas.scenarios.tables import MissionTable
from alula.schemas.scenarios.text import keys_of, moved, toml_of, values_of
from alula.schemas.scenarios.vehicle import check_vehicle, read_vehicle
from alula.schemas.scenarios.vehicles import VEHICLES
from alula.schemas.toml_file import toml_value
from support.paths import VEHICLES as FILES_OF_VEHICLES

HEAD = 'schema = "alula/scenario"\nversion = "2.0"\n'
WHOLE = (
    HEAD
    + """
name = "room, two balls"
[vehicle]
type = "crazyflie21"
interface = "body-rates"
mass_scale = 1.1
[vehicle.disturbance]
motor_time_constant_s = 0.03
[world]
cover = "room.cover.npz"
sigma = 2
[world.fence]
box_m = [0.1, 0.1, 0.1, 7.9, 5.9, 2.7]
[[world.moving]]
motion = "ballistic"
speed_m_s = [3, 4]
[[world.moving]]
radius_m = 0.2
[[world.walls]]
lower_m = [0, 0, 0]
upper_m = [1, 1, 1]
[mission]
kind = "pairs"
margin_m = 0.1
[mission.controller]
guide_parameters = { alpha = 4 }
guide = "cone-di"
[estimation]
delay_s = 0.02
lost_share = 0.01
[estimation.sensor]
kind = "mocap"
yaw_rate_rad_s = 0
[safety]
filters = ["dr-acbf", "cone-backup", "their-filter"]
[safety.dr-acbf]
clearance_m = 0.4
[safety.dr-acbf.mpc]
step_s = 0.03
[safety.cone-backup]
horizon_s = 2
[safety.their-filter]
depth = 3
[rules]
trials = 1000
"""
)


@pytest.fixture
def write(tmp_path):
    def write(text, name="scenario.toml"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


def test_a_file_sets_its_values_and_all_others_have_defaults(write):
    scenario = read_scenario(write(WHOLE))
    assert scenario.name == "room, two balls"
    assert scenario.vehicle.mass_scale == 1.1
    assert scenario.vehicle.thrust_scale == 1.0
    assert scenario.vehicle.disturbance.motor_time_constant_s == 0.03
    assert scenario.world.fence.box_m[5] == 2.7
    assert [obstacle.radius_m for obstacle in scenario.world.moving] == [0.15, 0.2]
    assert scenario.estimation.sensor.kind == "mocap"
    assert scenario.estimation.stale_s == 0.5
    assert scenario.safety.filters == ("dr-acbf", "cone-backup", "their-filter")
    assert scenario.safety.parameters("dr-acbf").mpc.step_s == 0.03
    assert scenario.safety.parameters("cone-backup").horizon_s == 2.0
    assert scenario.safety.parameters("their-filter") == {"depth": 3}
    assert scenario.rules.dt_s == 0.01


def test_a_file_with_nothing_is_a_scenario(write):
    assert read_scenario(write(HEAD)) == decoded({}, "")


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        ("version = '1.0'\n[map]\ncover = 'a'", VersionError, r"of version 1\.0; 2\.0 is read$"),
        ("version = '3.0'", VersionError, r"is alula/scenario of version 3\.0; 2\.0 is read$"),
        ("[map]\ncover = 'a'", VersionError, "has no `version`; a scenario begins with schema ="),
        ("# cut here", VersionError, "has no `version`"),
        ("version = 'new'", UsageError, r"`\$\.version`: "),
        ("schema = 'alula/vehicle'\nversion = '1.0'", WrongKindError, "is alula/vehicle, but alula/scen"),
        ("no toml", InputError, "is not TOML"),
    ],
)
def test_other_files_are_refused_before_their_keys_are_read(text, error, words, write):
    with pytest.raises(error, match=words) as raised:
        read_scenario(write(text))
    assert "\n" not in str(raised.value)


CHANGES = [
    ("vehicle.mass_scale", 1.2, lambda s: s.vehicle.mass_scale, 1.2),
    ("safety.cone-ecbf.lambda_", 9, lambda s: s.safety.cone_ecbf.lambda_, 9.0),
    ("world.moving.1.radius_m", 0.5, lambda s: s.world.moving[1].radius_m, 0.5),
    ("world.moving.2.radius_m", 0.5, lambda s: s.world.moving[2].radius_m, 0.5),
    ("safety.filters", "shield", lambda s: s.safety.filters, ("shield",)),
    ("safety.filters", ["cone-di", "shield"], lambda s: s.safety.filters, ("cone-di", "shield")),
    ("safety.filters", "none", lambda s: s.safety.filters, ()),
    ("vehicle.file", "x.toml", lambda s: (s.vehicle.type, s.vehicle.file), (None, "x.toml")),
    ("world.fence.faces", [1, 0, 0, 5, 0, 1, 0, 4], lambda s: len(s.world.fence.faces), 2),
    ("estimation.tracker.gate", 20, lambda s: s.estimation.tracker.gate, 20.0),
    ("safety.their-filter.depth", 4, lambda s: s.safety.parameters("their-filter"), {"depth": 4}),
    ("world.confidence", 0.9, lambda s: (s.world.sigma, s.world.confidence), (1.0, 0.9)),
]


@pytest.mark.parametrize(("key", "value", "get", "wanted"), CHANGES, ids=[row[0] for row in CHANGES])
def test_a_change_reaches_a_key_of_any_table(key, value, get, wanted, write):
    assert get(read_scenario(write(WHOLE), {key: value})) == wanted


def test_a_change_makes_tables_that_are_absent(write):
    changes = {"world.moving.0.motion": "curving", "mission.pilot.kind": "sticks", "mission.kind": "pilot"}
    scenario = read_scenario(write(HEAD), changes)
    assert scenario.world.moving[0].motion == "curving"
    assert scenario.mission.pilot.kind == "sticks"


WRONG = [
    ("[vehicle]\nx = 1", r"unknown field `x` - at `\$\.vehicle`"),
    ("[vehicle]\ntype = 'racer7'\nfile = 'a'", r"`\$\.vehicle\.file` and `\$\.vehicle\.type`: give one"),
    ("[vehicle]\nradius_m = inf", r"at `\$\.vehicle\.radius_m`"),
    ("[vehicle.disturbance]\nwind_m_s = [nan, 0, 0]", r"`\$\.vehicle\.disturbance\.wind_m_s\[0\]`"),
    ("[world]\nsigma = 2\nconfidence = 0.9", r"`\$\.world\.confidence` sets sigma"),
    ("[world.fence]", r"`\$\.world\.fence` needs box_m or faces"),
    ("[world.fence]\nbox_m = [1, 0, 0, 0, 1, 1]", r"`\$\.world\.fence\.box_m` needs XMIN < XMAX"),
    ("[world.fence]\nfaces = [[0, 0, 0, 1]]", r"`\$\.world\.fence\.faces\[0\]` needs a normal"),
    ("[world.fence]\nbox_m = [0, 0, 0, 1, 1, 1e5]", r"`\$\.world\.fence\.box_m\[5\]` must be at most 10000"),
    ("[[world.walls]]\nlower_m=[0,0,0]\nupper_m=[1,0,1]", r"`\$\.world\.walls\[0\]\.upper_m` must be above"),
    ("[[world.moving]]\nspeed_m_s = [8, 5]", r"`\$\.world\.moving\[0\]\.speed_m_s` must be a number, or"),
    (
        "[[world.moving]]\nposition_m = [0, 0, 1e7]",
        r"`\$\.world\.moving\[0\]\.position_m\[2\]` must be below",
    ),
    ("[[world.moving]]\nheading_rad = nan", r"`\$\.world\.moving\[0\]\.heading_rad` must be a finite number"),
    ("[mission]\ngoal_m = [0, 0, 1]", r"`\$\.mission\.goal_m` is for missions of kind goal, and this one is"),
    ("[mission]\nkind = 'hover'\nplanned = true", r"`\$\.mission\.planned` is for missions of kind pairs or"),
    ("[mission]\nkind='goal'\nstart_m=[0,0,1]\ngoal_m=[0,0,1]", "is the start; a mission of kind hover"),
    ("[mission]\nkind='waypoints'\nwaypoints_m=[[0,0,1],[0,0,1]]", r"waypoints_m\[1\]` is the point before"),
    (
        "[mission]\nkind='pilot'\nstart_m=[0,0,1]\nstart_box_m=[0,0,0,1,1,1]",
        r"`\$\.mission\.start_box_m` and start_m",
    ),
    ("[mission]\nkind='pilot'\nstart_m=[0,0,1]\nstart_tilt_deg=9", r"start_tilt_deg` goes with start_box_m"),
    ("[mission]\npairs_from = 'a'\nmargin_m = 1", r"`\$\.mission\.margin_m` is for random pairs"),
    ("[mission.pilot]\nradio_for_s = 1", r"`\$\.mission\.pilot` is for missions of kind pilot"),
    ("[mission]\nkind='pilot'\n[mission.pilot]\nradio_for_s = 1", r"radio_for_s` needs radio_from_s"),
    ("[mission.controller]\nguide_parameters = {a = 1}", "is for a guide, and there is none"),
    ("[mission]\nspeed_m_s = 3\n[vehicle]\nmax_speed_m_s = 2", r"speed_m_s` is above vehicle\.max_speed_m_s"),
    ("[estimation]\nlost_for_s = 1", r"`\$\.estimation\.lost_for_s` needs lost_from_s"),
    ("[estimation]\nlost_share = 1", r"at `\$\.estimation\.lost_share`"),
    ("[estimation.tracker]\nconfirm_hits = 9", r"`\$\.estimation\.tracker\.confirm_hits` is above"),
    ("[estimation.sensor]\ndelay_s = 11", r"`\$\.estimation\.sensor\.delay_s` must be at most 10"),
    ("[safety]\nfilters = ['none', 'shield']", r"`\$\.safety\.filters` has none beside others"),
    ("[safety]\nfilters = ['shield', 'shield']", r"`\$\.safety\.filters` has a filter twice"),
    ("[safety.cone-bakup]", r"`\$\.safety\.cone-bakup`: no filter is called 'cone-bakup'; filters are "),
    ("[safety.others]", "no filter is called 'others'"),
    ("[safety.cone-di]\nalfa = 1", r"unknown field `alfa` - at `\$\.safety\.cone-di`"),
    ("[safety.polytope-cbf]\nonboard = true", r"onboard` follows from world\.onboard; set that instead"),
    ("[safety.geofence]\ntick_s = 0.01", r"tick_s` follows from rules\.dt_s \* rules\.filter_ticks"),
    ("[safety.geofence]\nslow_m_s = 50", r"`\$\.safety\.geofence\.fast_m_s` must not be below slow_m_s"),
    (
        "[safety]\nfilters = ['geofence']\n[rules]\ndt_s = 0.5",
        "geofence runs every 0.0001 to 0.1 s, not every",
    ),
    ("[safety]\nfilters=['geofence']\n[safety.geofence]\nlatency_s = 0.5", "is above 32 calls of the filter"),
    ("[safety]\nfilters = ['polytope-cbf']\n[rules]\ndt_s = 0.9", r"must be at most 1 / dt_s = 1\.11"),
    ("[rules]\nmax_time_s = 0.001", r"`\$\.rules\.max_time_s` is below dt_s"),
    ("[rules]\nmax_time_s = 9e4\ndt_s = 1e-4", r"9e\+08 time steps, more than 10,000,000"),
    ("[rules]\ntrials = 0", r"at `\$\.rules\.trials`"),
    ("name = ' '", r"`\$\.name` must not be empty"),
]


@pytest.mark.parametrize(("text", "words"), WRONG, ids=[row[0].replace("\n", " ") for row in WRONG])
def test_a_wrong_value_is_refused_with_the_path_of_its_key(text, words, write):
    text = f"{text}\n{HEAD}" if text.startswith("name") else HEAD + text
    with pytest.raises(UsageError, match=words) as error:
        read_scenario(write(text))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"name.x": 1}, "--set name.x: the scenario has no 'x' there"),
        ({"world.moving.5.radius_m": 1}, "--set world.moving.5.radius_m: the scenario has no '5' there"),
        ({"mission.waypoints_m": [1, 2]}, "--set mission.waypoints_m: needs 3 numbers for each row, not 2"),
        ({"horizon_s": 1}, "unknown field `horizon_s`"),
    ],
)
def test_a_change_of_nothing_is_refused(changes, words, write):
    with pytest.raises(UsageError, match=words):
        read_scenario(write(HEAD + "name = 'x'"), changes)


def test_infinity_stands_only_where_it_is_no_limit(write):
    text = "[vehicle]\nmax_acceleration_m_s2 = inf\n[estimation]\nstale_s = inf\n[safety.cone-di]\n"
    assert read_scenario(write(HEAD + text + "max_acceleration = inf")).estimation.stale_s == math.inf
    with pytest.raises(UsageError, match=r"`\$\.safety\.cone-di\.alpha` must be a finite number"):
        read_scenario(write(HEAD + text + "alpha = inf"))


def test_shields_keep_clear_of_all_that_flights_are_judged_against(write):
    of = lambda text: read_scenario(write(HEAD + text)).safety.shield.shield_map  # noqa: E731
    assert of("[world]\ncover = 'a'") == "hulls"
    assert of("[world]\nscene = 'b'") == "ellipsoids"
    assert of("[world]\ncover = 'a'\nscene = 'b'") == "both"
    walls = "[[world.walls]]\nlower_m = [0, 0, 0]\nupper_m = [1, 1, 1]"
    assert of(f"[world]\nscene = 'b'\n{walls}") == "both"
    chosen = "[safety.shield]\nshield_map = 'ellipsoids'"
    assert of(f"[world]\ncover = 'a'\nscene = 'b'\n{chosen}") == "ellipsoids"


def test_vehicles_built_in_are_those_of_the_examples():
    for name, vehicle in VEHICLES.items():
        assert vehicle == read_vehicle(FILES_OF_VEHICLES / f"{name}.toml")
        check_vehicle(vehicle)


@pytest.mark.parametrize("name", VEHICLES)
def test_a_completed_scenario_has_the_values_of_its_vehicle_and_reads_back(name):
    scenario = decoded({"vehicle": {"type": name}}, "")
    vehicle = vehicle_of(scenario, FILES_OF_VEHICLES)
    full = completed(scenario, vehicle)
    assert full.vehicle.radius_m == vehicle.body.radius_m
    assert full.estimation.delay_s == vehicle.disturbance.delay_s
    assert full.vehicle.interface == interface_of(scenario, vehicle)
    assert decoded(plain(full), "") == full
    assert completed(full, vehicle) == full


def test_the_text_of_a_scenario_reads_back_and_says_where_values_come_from(write):
    path = write(WHOLE)
    read = read_sources(path, {"rules.seed": 7, "world.moving.1.radius_m": 0.3})
    vehicle = vehicle_of(read.scenario, path.parent)
    values = values_of(read, vehicle, path.name)
    text = toml_of(values)
    assert read_scenario(write(text, "again.toml")) == completed(read.scenario, vehicle)
    sources = {item.path: item.source for item in values}
    assert sources["vehicle.mass_scale"] == "scenario.toml"
    assert sources["vehicle.radius_m"] == "vehicle crazyflie21"
    assert sources["vehicle.disturbance.motor_time_constant_s"] == "scenario.toml"
    assert sources["vehicle.disturbance.gust_time_s"] == "vehicle crazyflie21"
    assert sources["rules.seed"] == sources["world.moving.1.radius_m"] == "--set"
    assert sources["world.moving.0.radius_m"] == sources["rules.dt_s"] == "default"
    assert "radius_m = 0.3 " in text
    # Tables without an effect are left out.
    assert not any(path.startswith(("safety.cone-di", "mission.pilot")) for path in sources)
    for line in text.splitlines():
        assert not line or line.startswith("[") or "  # " in line


def test_files_are_named_from_the_folder_that_a_scenario_is_written_to(write, tmp_path):
    path = write(HEAD + "[vehicle]\nfile = 'a/x.toml'\n[world]\ncover = '/abs.npz'\nscene = '../s.npz'")
    read = read_sources(path)
    values = values_of(read, VEHICLES["racer7"], path.name)
    names = {item.path: item.value for item in moved(values, tmp_path, tmp_path / "new")}
    assert names["vehicle.file"] == "../a/x.toml"
    assert names["world.cover"] == "/abs.npz"
    assert names["world.scene"] == "../../s.npz"


def test_every_key_is_listed_and_explained():
    keys = keys_of()
    assert len({key.path for key in keys}) == len(keys)
    assert [key.path for key in keys if not key.about] == []
    listed = {key.path for key in keys}
    assert set(FILES) <= listed
    assert {f"safety.{name}" for name in TABLES.values()} <= {
        ".".join(path.split(".")[:2]) for path in listed
    } | {"safety.none"}
    assert {key.path for key in keys_of("rules")} == {path for path in listed if path.startswith("rules.")}
    assert keys_of("safety.cone-backup.horizon_s")[0].default == "1.5"
    with pytest.raises(UsageError, match="no part or key is called 'wings'; parts are "):
        keys_of("wings")


def test_keys_of_missions_are_keys():
    assert set(USED) <= {item.name for item in msgspec.structs.fields(MissionTable)}


plain_values = st.recursive(
    st.booleans()
    | st.integers(-(2**63), 2**63 - 1)
    | st.floats(allow_nan=False)
    | st.text(st.characters(exclude_categories=["Cs"])),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text("ab-. \"'é", max_size=4), inner, max_size=3)
    ),
    max_leaves=8,
)


@given(plain_values)
def test_a_value_written_as_toml_reads_back(value):
    assert decode_toml(f"x = {toml_value(value)}  # end".encode()) == {"x": value}
