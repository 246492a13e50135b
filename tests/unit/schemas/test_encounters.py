"""Scenario files with moving obstacles: the values that they set, and errors that name the key."""

import pytest

from alula.schemas.encounters import Encounters, interval, is_encounters, read_encounters
from alula.schemas.errors import InputError, UsageError, VersionError


def read(tmp_path, text, changes=None):
    path = tmp_path / "s.toml"
    path.write_text(text)
    return read_encounters(path, changes)


def test_an_empty_table_has_all_defaults(tmp_path):
    scenario = read(tmp_path, "[encounter]")
    assert scenario == Encounters()
    assert scenario.sensor.rate_hz == 20
    assert scenario.filter.parameters.alpha == 0.1


def test_keys_set_and_changes_replace(tmp_path):
    text = """
    name = "two"
    [encounter]
    cruise_m_s = 3
    [[obstacles]]
    motion = "curving"
    azimuth_rad = [0.1, 0.2]
    speed_m_s = 6
    [[obstacles]]
    position_m = [50, 0, 10]
    [sensor]
    kind = "mocap"
    [filter]
    name = "mpc"
    parameters = { clearance_m = 3, mpc = { step_s = 0.04 } }
    [[walls]]
    lower_m = [0, 0, 0]
    upper_m = [1, 1, 1]
    """
    scenario = read(tmp_path, text)
    assert (scenario.name, scenario.encounter.cruise_m_s, scenario.sensor.kind) == ("two", 3.0, "mocap")
    assert interval(scenario.obstacles[0].azimuth_rad) == (0.1, 0.2)
    assert interval(scenario.obstacles[0].speed_m_s) == (6.0, 6.0)
    assert scenario.obstacles[1].position_m == (50.0, 0.0, 10.0)
    assert scenario.filter.parameters.mpc.step_s == 0.04
    assert scenario.walls[0].upper_m == (1.0, 1.0, 1.0)
    changes = {"obstacles.1.radius_m": 0.3, "filter.parameters.clearance_m": 1, "trials.count": 7}
    changed = read(tmp_path, text, changes)
    assert changed.obstacles[1].radius_m == 0.3
    assert changed.filter.parameters.clearance_m == 1.0
    assert changed.trials.count == 7
    assert changed.obstacles[0] == scenario.obstacles[0]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[encounter]\nspeed = 3", r"unknown field `speed` - at `\$\.encounter`"),
        ("[encounter]\n[sensors]", r"unknown field `sensors`"),
        ("[encounter]\n[sensor]\nrate_hz = -1", r"at `\$\.sensor\.rate_hz`"),
        ("[encounter]\n[sensor]\nrate_hz = 'fast'", r"got `str` - at `\$\.sensor\.rate_hz`"),
        ("[encounter]\n[sensor]\nrate_hz = nan", r"at `\$\.sensor\.rate_hz`"),
        ("[encounter]\n[vehicle]\na_max_m_s2 = inf", r"`\$\.vehicle\.a_max_m_s2` must be a finite number"),
        ("[encounter]\n[vehicle]\nradius_m = -0.1", r"at `\$\.vehicle\.radius_m`"),
        ("[[obstacles]]\nspeed_m_s = [5, nan]", r"`\$\.obstacles\[0\]\.speed_m_s\[1\]` must be a finite"),
        ("[[obstacles]]\n[[obstacles]]\nspeed_m_s = [8, 5]", r"`\$\.obstacles\[1\]\.speed_m_s` must be a"),
        ("[[obstacles]]\nspeed_m_s = [-1, 5]", r"`\$\.obstacles\[0\]\.speed_m_s` must be >= 0"),
        (
            "[[obstacles]]\nmotion = 'flying'",
            r"Invalid enum value 'flying' - at `\$\.obstacles\[0\]\.motion`",
        ),
        ("[[obstacles]]\nmeeting_sigma_m = [1, -1, 1]", r"at `\$\.obstacles\[0\]\.meeting_sigma_m\[1\]`"),
        ("[encounter]\n[filter]\nname = 'polytope-cbf'", r"Invalid enum value .* at `\$\.filter\.name`"),
        ("[encounter]\n[filter]\nparameters = { beta = 2 }", r"unknown field `beta` - at `\$\.filter\.par"),
        ("[encounter]\n[filter]\nparameters = { alpha = 1.5 }", r"at `\$\.filter\.parameters\.alpha`"),
        ("[encounter]\n[filter]\nparameters = { solver = 'qp' }", r"`\$\.filter\.parameters\.solver`"),
        ("[encounter]\n[tracker]\nconfirm_hits = 7", r"`\$\.tracker\.confirm_hits` is above"),
        ("[encounter]\n[trials]\ncount = 0", r"at `\$\.trials\.count`"),
        ("[encounter]\n[run]\ndt_s = 3", r"`\$\.run\.dt_s` must be between"),
        (
            "[encounter]\n[vehicle]\nv_max_m_s = 1e6",
            r"`\$\.vehicle\.v_max_m_s` must be between 0.001 and 1000",
        ),
        ("[encounter]\n[vehicle]\nradius_m = 1e5", r"`\$\.vehicle\.radius_m` must be between 0 and 1000"),
        ("[encounter]\ncruise_m_s = 20", r"`\$\.encounter\.cruise_m_s` is above vehicle\.v_max_m_s"),
        ("[encounter]\ngoal_m = [0, 0, 10]", r"`\$\.encounter\.goal_m` is the start"),
        ("[encounter]\n[[walls]]\nlower_m=[0,0,0]\nupper_m=[1,0,1]", r"`\$\.walls\[0\]\.upper_m` must be"),
        ("[encounter]\n[[walls]]\nlower_m=[0,0,0]", r"missing required field `upper_m`"),
        ("[[obstacles]]\ndistance_m = 1e300", r"`\$\.obstacles\[0\]\.distance_m` must be below 1e\+06"),
        ("[encounter]\nstart_m = [0, -1e7, 0]", r"`\$\.encounter\.start_m\[1\]` must be below"),
        ("name = ' '\n[encounter]", r"`\$\.name` must not be empty"),
    ],
)
def test_what_is_wrong_is_named_with_its_key(tmp_path, text, words):
    with pytest.raises(UsageError, match=words) as caught:
        read(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_changes_are_held_to_the_same(tmp_path):
    for changes, words in (
        ({"sensor.rate_hz": -1}, r"at `\$\.sensor\.rate_hz`"),
        ({"sensor.rate_hz": float("nan")}, r"`\$\.sensor\.rate_hz`"),
        ({"sensor.speed": 1}, r"unknown field `speed`"),
        ({"obstacles.3.radius_m": 1}, r"--set obstacles\.3\.radius_m: the scenario has no '3' there"),
        ({"nothing.at.all": 1}, r"the scenario has no 'nothing' there"),
    ):
        with pytest.raises(UsageError, match=words):
            read(tmp_path, "[encounter]", changes)


def test_files_that_are_none_or_newer_are_refused(tmp_path):
    with pytest.raises(InputError, match="is not TOML"):
        read(tmp_path, "[encounter")
    with pytest.raises(VersionError, match="newer"):
        read(tmp_path, 'version = "2.0"\n[encounter]\nnew = 1')
    with pytest.raises(InputError, match="cannot read"):
        read_encounters(tmp_path / "none.toml")


def test_scenarios_are_told_apart(tmp_path):
    path = tmp_path / "s.toml"
    for text, found in (
        ("[encounter]", True),
        ("[[obstacles]]", True),
        ("[map]\ncover = 'a'", False),
        ("[", False),
    ):
        path.write_text(text)
        assert is_encounters(path) is found
