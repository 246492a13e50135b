"""Mission files: read as written, and each error named in one line."""

import textwrap
from pathlib import Path

import pytest

from alula.schemas.errors import InputError, UsageError, VersionError
from alula.schemas.scenarios.mission import __doc__ as EXAMPLE
from alula.schemas.scenarios.mission import read_mission
from alula.stages.reconstruction.room import HOOP_TUBE_M, HOOPS

GOOD = """
start_m = [0, 0, 1]
goal_m = [4, 0, 1]

[[pass]]
gate_m = [1, 0, 1]
normal = [2, 0, 0]
radius_m = 0.5

[[pass]]
point_m = [3, 0, 1]
"""
GATE = "[[pass]]\ngate_m = [1, 0, 1]\nnormal = [1, 0, 0]\nradius_m = 0.5\n"
POINT = "[[pass]]\npoint_m = [1, 0, 1]\n"


def mission_of(tmp_path, text):
    path = tmp_path / "mission.toml"
    path.write_text(text)
    return read_mission(path)


def test_the_example_of_the_documentation_is_read(tmp_path):
    mission = mission_of(tmp_path, textwrap.dedent(EXAMPLE.partition("\n\n")[2]))
    assert (mission.name, mission.loops, mission.yaw) == ("two laps", 2, "along")
    gate, point = mission.passes
    assert (gate.gate_m, gate.normal, gate.radius_m) == ((3.0, 2.0, 1.2), (1.0, 0.0, 0.0), 0.5)
    assert (point.point_m, point.tolerance_m, point.hold_s) == ((6.0, 4.0, 1.0), 0.3, 2.0)
    assert mission.zones[0].speed_m_s == 0.5
    assert mission_of(tmp_path, GOOD).passes[1].point_m == (3.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[pass]]\nhold_s = 1", r"`\$\.pass\[0\]` needs point_m, a waypoint, or gate_m, a gate"),
        ("[[pass]]\npoint_m = [0, 0, 0]\ngate_m = [0, 0, 0]", "and not both"),
        (POINT + "radius_m = 1", r"`\$\.pass\[0\]\.radius_m`: is for gates"),
        ("[[pass]]\ngate_m = [0, 0, 0]\nradius_m = 1", r"`\$\.pass\[0\]\.normal`: a gate needs it"),
        (GATE.replace("[1, 0, 0]", "[0, 0, 0]"), r"`\$\.pass\[0\]\.normal`: has no direction"),
        (GATE + "tolerance_m = 1", r"`\$\.pass\[0\]\.tolerance_m`: is for waypoints"),
        (GATE + "hold_s = 1", r"`\$\.pass\[0\]\.hold_s`: is for waypoints"),
        (GATE.replace("0.5", "-0.5"), r"`float` >= 0\.001 - at `\$\.pass\[0\]\.radius_m`"),
        (POINT + 'yaw = "along"\nyaw_rad = 1.0', r"`\$\.pass\[0\]\.yaw_rad`: give yaw or yaw_rad, not both"),
        ('yaw = "up"', r"Invalid enum value 'up' - at `\$\.yaw`"),
        ("yaw_rad = 90", r"at `\$\.yaw_rad`"),
        ("loops = 0", r"at `\$\.loops`"),
        ("loops = 2", r"`\$\.loops`: there is nothing to fly again"),
        ("loops = 2\n" + POINT, r"two consecutive points of the flight are the same, \(1 0 1\)"),
        (GOOD + POINT + POINT, "two consecutive points"),
        (
            GOOD.replace("[3, 0, 1]", "[4, 0, 1]"),
            r"two consecutive points of the flight are the same, \(4 0 1\)",
        ),
        ("[[zone]]\nbox_m = [0, 0, 0, 1, 1, 0]\nspeed_m_s = 1", r"`\$\.zone\[0\]\.box_m` needs XMIN < XMAX"),
        ("[[pass]]\npoint_m = [0, 0, nan]", r"`\$\.pass\[0\]\.point_m\[2\]` must be below 1e\+06"),
        ("[[pass]]\npoint_m = [0, 0]", "length 3"),
        ("gates = 3", "unknown field `gates`"),
        ('schema = "alula/vehicle"', r"at `\$\.schema`"),
    ],
)
def test_what_means_nothing_is_refused_with_its_place(tmp_path, text, message):
    with pytest.raises(UsageError, match=message) as caught:
        mission_of(tmp_path, text)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "mission.toml"))


def test_files_of_later_versions_and_no_files_are_refused(tmp_path):
    with pytest.raises(VersionError, match=r"alula/mission version 2\.0 is newer than 1\.0"):
        mission_of(tmp_path, 'version = "2.0"\nwings = 2\n')
    with pytest.raises(InputError, match="is not TOML"):
        mission_of(tmp_path, "[[pass")
    with pytest.raises(InputError, match="cannot read"):
        read_mission(tmp_path / "none.toml")


def test_the_example_mission_flies_through_the_hoops_of_the_room():
    mission = read_mission(Path(__file__).parents[3] / "examples/room/course.toml")
    for gate, hoop in zip(mission.passes, HOOPS, strict=True):
        assert (gate.gate_m, gate.normal) == (hoop.centre, hoop.axis)
        assert gate.radius_m == pytest.approx(hoop.radius_m - HOOP_TUBE_M)
