"""Scenario files with a fence: the values that they set, and errors that name the key."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from alula.schemas.errors import InputError, UsageError, VersionError
from alula.schemas.geofence import FenceScenario, GeofenceParameters, is_fence_scenario, read_fence_scenario

LEAST = """
[fence]
box_m = [-10, -10, 0, 10, 10, 10]
[vehicle]
file = "racer.toml"
[trials]
start_m = [0, 0, 5]
"""
WHOLE = """
schema = "alula/scenario"
version = "1.0"
name = "wall at 100 km/h"
[fence]
box_m = [-100, -100, 0.5, 40, 100, 100]
faces = [[0.7071, 0.7071, 0.0, 30.0]]
cover = "room.cover.npz"
[vehicle]
file = "../vehicles/racer7.toml"
mass_scale = 1.2
delay_s = 0.02
wind_m_s = [5, 0, 0]
[filter]
name = "geofence"
parameters = { reserve_m = 2.5, latency_s = 0.02 }
[pilot]
kind = "silent"
heading_deg = 45.0
silent_after_s = 2
[trials]
count = 10000
seed = 3
start_box_m = [-30, -30, 3, 30, 30, 60]
start_speed_m_s = 12
start_tilt_deg = 40
[run]
duration_s = 6
stale_from_s = 3.0
radio_from_s = 1
radio_for_s = 0.5
traces = 3
"""


def read(tmp_path, text, changes=None):
    path = tmp_path / "s.toml"
    path.write_text(text)
    return read_fence_scenario(path, changes)


def test_a_short_file_has_defaults(tmp_path):
    scenario = read(tmp_path, LEAST)
    assert scenario.filter.name == "geofence"
    assert scenario.filter.parameters == GeofenceParameters()
    assert (scenario.pilot.kind, scenario.pilot.tilt_deg, scenario.run.traces) == ("straight", 72.0, 20)
    assert scenario.trials.count == 1


def test_keys_set_and_changes_replace(tmp_path):
    scenario = read(tmp_path, WHOLE)
    assert scenario.fence.faces == ((0.7071, 0.7071, 0.0, 30.0),)
    assert (scenario.vehicle.mass_scale, scenario.vehicle.wind_m_s) == (1.2, (5.0, 0.0, 0.0))
    assert scenario.filter.parameters.reserve_m == 2.5
    assert (scenario.run.stale_from_s, scenario.run.stale_for_s) == (3.0, None)
    changed = read(tmp_path, WHOLE, {"vehicle.mass_scale": 1, "filter.parameters.beta": 2, "trials.count": 7})
    assert (changed.vehicle.mass_scale, changed.filter.parameters.beta, changed.trials.count) == (1.0, 2.0, 7)
    assert changed.pilot == scenario.pilot


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[fence]", "[fence]\nsize = 3", r"unknown field `size` - at `\$\.fence`"),
        ("box_m = [-10, -10, 0, 10, 10, 10]", "", r"`\$\.fence` needs box_m, faces or cover"),
        ("[-10, -10, 0, 10, 10, 10]", "[-10, -10, 0, 10]", r"length 6, got 4 - at `\$\.fence\.box_m`"),
        ("[-10, -10, 0, 10, 10, 10]", "[-10, -10, 10, 10, 10, 10]", r"`\$\.fence\.box_m` needs XMIN < XMAX"),
        ("[-10, -10, 0, 10, 10, 10]", "[-10, -10, 0, 10, 10, inf]", r"`\$\.fence\.box_m\[5\]` must be a fin"),
        (
            "[-10, -10, 0, 10, 10, 10]",
            "[-1e5, -1, 0, 1, 1, 9]",
            r"`\$\.fence\.box_m\[0\]` must be at most 100",
        ),
        ("[fence]", "[fence]\nfaces = [[0, 0, 0, 1]]", r"`\$\.fence\.faces\[0\]` needs a normal"),
        ("[fence]", "[fence]\nfaces = [[0, 0, 1e-2, 1000]]", r"`\$\.fence\.faces\[0\]` is farther than 1"),
        ("[fence]", "[fence]\nfaces = [[0, 0, 1]]", r"length 4, got 3 - at `\$\.fence\.faces\[0\]`"),
        ("[fence]", "[fence]\nfaces = [" + "[0, 0, 1, 9]," * 33 + "]", r"at `\$\.fence\.faces`"),
        ("[fence]", "[fence]\ncover = ''", r"`\$\.fence\.cover` must not be empty"),
        ('file = "racer.toml"', "", r"`\$\.vehicle\.file` is needed"),
        ("[vehicle]", "[vehicle]\nmass_scale = 0", r"at `\$\.vehicle\.mass_scale`"),
        ("[vehicle]", "[vehicle]\ndelay_s = -0.1", r"at `\$\.vehicle\.delay_s`"),
        ("[vehicle]", "[vehicle]\nsag_share = 1", r"at `\$\.vehicle\.sag_share`"),
        ("start_m = [0, 0, 5]", "", r"`\$\.trials` needs start_m or start_box_m"),
        ("[trials]", "[trials]\nstart_box_m = [0,0,0,1,1,1]", r"`\$\.trials` has both start_m and start_box"),
        ("[trials]", "[trials]\nstart_speed_m_s = 3", r"`\$\.trials\.start_speed_m_s` goes with start_box_m"),
        ("start_m = [0, 0, 5]", "start_m = [0, 0, 1e4]", r"`\$\.trials\.start_m\[2\]` must be below 10000 m"),
        ("[trials]", "[trials]\ncount = 0", r"at `\$\.trials\.count`"),
        ("[trials]", "[trials]\nseed = -1", r"at `\$\.trials\.seed`"),
        ("[trials]", "[pilot]\nkind = 'mad'\n[trials]", r"Invalid enum value 'mad' - at `\$\.pilot\.kind`"),
        ("[trials]", "[pilot]\ntilt_deg = 90\n[trials]", r"at `\$\.pilot\.tilt_deg`"),
        ("[trials]", "[pilot]\nclimb_m_s2 = nan\n[trials]", r"`\$\.pilot\.climb_m_s2` must be a finite"),
        ("[trials]", "[run]\nduration_s = 0\n[trials]", r"at `\$\.run\.duration_s`"),
        ("[trials]", "[run]\nstale_for_s = 1\n[trials]", r"`\$\.run\.stale_for_s` needs stale_from_s"),
        ("[trials]", "[run]\nradio_for_s = 1\n[trials]", r"`\$\.run\.radio_for_s` needs radio_from_s"),
        ("[trials]", "[run]\nlog_rate_hz = 1e9\n[trials]", r"`\$\.run\.log_rate_hz` must be between"),
        ("[trials]", "[filter]\nname = 'cone-di'\n[trials]", r"at `\$\.filter\.name`"),
        ("[trials]", "[filter]\nparameters = { gamma = 1 }\n[trials]", r"unknown field `gamma`"),
        (
            "[trials]",
            "[filter]\nparameters = { steps = 7 }\n[trials]",
            r"multiple of 2 - at `\$\.filter\.par",
        ),
        ("[trials]", "[filter]\nparameters = { fast_m_s = 0.5 }\n[trials]", r"fast_m_s` must not be below"),
        ("[trials]", "[filter]\nparameters = { latency_s = 0.1 }\n[trials]", r"is above 32 ticks, 0\.08 s"),
        ("[fence]", "filter.name = 'backup-qp'\n[fence]\ncover = 'a'", r"`\$\.filter\.name` backup-qp knows"),
        ("[fence]", "name = ' '\n[fence]", r"`\$\.name` must not be empty"),
        ("[fence]", "schema = 'alula/vehicle'\n[fence]", r"at `\$\.schema`"),
    ],
)
def test_what_is_wrong_is_named_with_its_key(tmp_path, old, new, words):
    assert LEAST.count(old) == 1
    with pytest.raises(UsageError, match=words) as caught:
        read(tmp_path, LEAST.replace(old, new))
    assert "\n" not in str(caught.value)


def test_a_start_in_a_box_has_no_velocity(tmp_path):
    text = LEAST.replace("start_m = [0, 0, 5]", "start_box_m = [0, 0, 1, 1, 1, 2]\nstart_yaw_deg = 3")
    with pytest.raises(UsageError, match=r"`\$\.trials\.start_yaw_deg` goes with start_m, and here is"):
        read(tmp_path, text)


def test_very_many_ticks_are_refused(tmp_path):
    changes = {"run.duration_s": 3600, "filter.parameters.tick_s": 1e-4}
    with pytest.raises(UsageError, match=r"`\$\.run\.duration_s` has 3\.6e\+07 ticks"):
        read(tmp_path, LEAST, changes)


def test_files_that_are_none_or_newer_are_refused(tmp_path):
    with pytest.raises(InputError, match="is not TOML"):
        read(tmp_path, "[fence")
    with pytest.raises(VersionError, match="newer"):
        read(tmp_path, 'version = "2.0"\n[fence]\nnew = 1')
    with pytest.raises(InputError, match="cannot read"):
        read_fence_scenario(tmp_path / "none.toml")


def test_scenarios_are_told_apart(tmp_path):
    path = tmp_path / "s.toml"
    for text, found in (
        ("[fence]", True),
        ("[map]\ncover = 'a'", False),
        ("[encounter]", False),
        ("[", False),
    ):
        path.write_text(text)
        assert is_fence_scenario(path) is found


KEYS = (
    *("fence.box_m", "fence.faces", "fence.cover", "vehicle.file", "vehicle.mass_scale", "vehicle.gust_m_s"),
    *("filter.name", "filter.parameters.reserve_m", "filter.parameters.steps", "filter.parameters.tick_s"),
    *(
        "pilot.kind",
        "pilot.heading_deg",
        "trials.count",
        "trials.seed",
        "trials.start_m",
        "trials.start_box_m",
    ),
    *("run.duration_s", "run.plant_steps", "run.stale_from_s", "run.traces", "nothing", "fence.box_m.0"),
)
NUMBERS = st.one_of(st.integers(-(2**70), 2**70), st.floats(), st.floats(-50, 50))
VALUES = st.one_of(
    NUMBERS, st.booleans(), st.sampled_from(["", "none", "silent", "a.toml"]), st.none(),
    st.lists(NUMBERS, max_size=7), st.lists(st.lists(NUMBERS, min_size=4, max_size=4), max_size=2),
)  # fmt: skip


@given(st.dictionaries(st.sampled_from(KEYS), VALUES, max_size=3))
def test_any_change_gives_a_sound_scenario_or_one_line(tmp_path_factory, changes):
    path = tmp_path_factory.getbasetemp() / "least.toml"
    if not path.exists():
        path.write_text(LEAST)
    scenario, said = None, ""
    try:
        scenario = read_fence_scenario(path, changes)
    except UsageError as error:
        said = str(error)
    assert "\n" not in said
    if scenario is None:
        return
    assert isinstance(scenario, FenceScenario)
    assert scenario.fence.box_m is None or all(math.isfinite(value) for value in scenario.fence.box_m)
    assert scenario.run.duration_s / scenario.filter.parameters.tick_s <= 1e7
    assert (scenario.trials.start_m is None) != (scenario.trials.start_box_m is None)
