"""`alula scenario` as a user runs it: text with sources, upgrade to a file, list of keys, refusals."""

import json
from copy import deepcopy
from typing import get_args, get_type_hints

import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import write_artifact
from alula.schemas.scenarios.examples import NAMES
from alula.schemas.scenarios.presets import PRESETS
from alula.schemas.scenarios.scenario import decoded, read_scenario
from alula.schemas.scenarios.tables import EstimationTable, SafetyTable, SensorTable
from support.paths import EXAMPLES
from support.scenes.covers import boxes_cover

WALLS = EXAMPLES / "geofencing" / "combined.toml"
NEW = """schema = "alula/scenario"
version = "2.0"
[vehicle]
type = "crazyflie21"
[world]
cover = "room.cover.npz"
[safety]
filters = ["cone-backup"]
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "room.toml"
    path.write_text(NEW)
    return path


def test_it_prints_a_scenario_that_says_everything(file, tmp_path, capsys):
    assert run(["scenario", str(file), "--set", "safety.cone-backup.horizon_s=2"]) == 0
    text = capsys.readouterr().out
    lines = [line.split("  # ") for line in text.splitlines() if "  # " in line]
    sources = {(words.strip(), source) for words, source in lines}
    assert ("horizon_s = 2.0", "--set") in sources
    assert ('cover = "room.cover.npz"', "room.toml") in sources
    assert ("radius_m = 0.075", "vehicle crazyflie21") in sources
    assert ("nodes = 20", "default") in sources
    again = tmp_path / "again.toml"
    again.write_text(text)
    assert read_scenario(again).safety.cone_backup.horizon_s == 2.0


def test_it_writes_a_file_whose_names_lead_to_the_same_files(tmp_path, capsys):
    new = tmp_path / "new.toml"
    assert run(["scenario", str(WALLS), "-o", str(new)]) == 0
    assert capsys.readouterr().out == ""
    named = read_scenario(new).vehicle.file
    assert (tmp_path / named).resolve() == (EXAMPLES / "vehicles" / "racer7.toml").resolve()
    assert run(["scenario", str(new), "-q"]) == 0
    assert run(["scenario", str(WALLS), "-o", str(new)]) == 3
    assert "exists; -f replaces it" in capsys.readouterr().err
    assert run(["scenario", str(WALLS), "-o", str(new), "-f"]) == 0


def test_its_json_has_values_and_sources(file, capsys):
    assert run(["scenario", str(file), "--json"]) == 0
    values = {item["path"]: item for item in json.loads(capsys.readouterr().out)["values"]}
    assert values["safety.cone-backup.far"] == {
        "path": "safety.cone-backup.far",
        "value": "inf",
        "source": "default",
    }
    assert values["safety.filters"]["value"] == ["cone-backup"]


def test_keys_are_listed_by_part(capsys):
    assert run(["scenario", "--keys", "safety.shield"]) == 0
    text = capsys.readouterr().out
    assert "safety.shield.margin_m = 0.02  (number > 0)\n    distance beyond the radius" in text
    assert "rules." not in text
    assert run(["scenario", "--keys", "--json"]) == 0
    keys = {key["path"]: key for key in json.loads(capsys.readouterr().out)["keys"]}
    assert keys["rules.dt_s"]["default"] == "0.01"
    assert keys["world.moving.*.motion"]["type"].startswith("constant-velocity | ")


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["scenario"], 2, "needs a FILE, --example or --keys"),
        (["scenario", "--keys", "wings"], 2, "no part or key is called 'wings'"),
        (["scenario", "FILE", "--keys", "world"], 2, "--keys lists keys, and takes no FILE"),
        (["scenario", "FILE", "--set", "vehicle.wings=2"], 2, "unknown field `wings` - at `$.vehicle`"),
        (
            ["scenario", "FILE", "--set", "vehicle.type=single-integrator"],
            2,
            "cone-backup is for commands of",
        ),
        (["scenario", "FILE", "--set", "vehicle.file=none.toml"], 3, "none.toml: cannot read"),
        (["scenario", "missing.toml"], 3, "missing.toml: cannot read"),
    ],
)
def test_what_is_wrong_is_said_in_one_line_and_nothing_is_written(words, code, message, file, capsys):
    out = file.parent / "out.toml"
    words = [str(file) if word == "FILE" else word for word in words]
    wants_keys = "--keys" in words
    assert run(words if wants_keys else [*words, "-o", str(out)]) == code
    error = capsys.readouterr().err
    assert message in error
    assert len(error.splitlines()) == 1
    assert not out.exists()


# A room of 8 x 6 x 3 m with a pillar and a shelf, in units of 0.1 m.
ROOM = [
    *((-1, -1, -1, 81, 61, 0), (-1, -1, 30, 81, 61, 31), (-1, 0, 0, 0, 60, 30), (80, 0, 0, 81, 60, 30)),
    *((-1, -1, 0, 81, 0, 30), (-1, 60, 0, 81, 61, 30), (38, 28, 0, 42, 32, 30), (0, 40, 0, 5, 60, 20)),
]


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_an_example_flies_and_its_filters_evade(name, tmp_path, capsys):
    write_artifact(tmp_path / "room.cover.npz", boxes_cover(ROOM))
    path = tmp_path / "own.toml"
    assert run(["scenario", "--example", name, "-o", str(path)]) == 0
    assert run(["simulate", str(path), "-o", str(tmp_path / "own.run.mcap"), "--json"]) in (0, 4)
    summary = json.loads(capsys.readouterr().out)["summary"]
    assert summary["trials"] == 50
    assert summary["moving_collisions"] <= 1
    assert summary["static_collisions"] == 0
    words = ["--set", "safety.filters=none", "--set", "rules.logged=0"]
    run(["simulate", str(path), "-o", str(tmp_path / "none.run.mcap"), "--json", *words])
    assert json.loads(capsys.readouterr().out)["summary"]["moving_collisions"] >= 4


def test_a_crazyflie_among_moving_obstacles_is_in_a_room_unless_the_scenario_says_otherwise():
    moving = {"vehicle": {"type": "crazyflie21"}, "world": {"moving": [{"motion": "ballistic"}]}}
    found = decoded(deepcopy(moving))
    assert found.estimation.sensor.kind == "mocap"
    assert found.safety.dr_acbf.obstacle_braking_m_s2 == 0
    compared = decoded(deepcopy(moving) | {"safety": {"filters": ["mpc"]}})
    assert compared.estimation.sensor.kind == "mocap"
    assert compared.safety.parameters("mpc") == SafetyTable().dr_acbf  # the preset tunes dr-acbf alone
    own = decoded(moving | {"estimation": {"sensor": {"rate_hz": 60}}})
    assert (own.estimation.sensor.kind, own.estimation.sensor.rate_hz) == ("mocap", 60)
    outside = decoded(moving | {"estimation": {"preset": "outdoor-radar"}})
    assert outside.estimation.sensor == SensorTable()
    assert outside.safety.dr_acbf == SafetyTable().dr_acbf
    assert decoded({"vehicle": {"type": "crazyflie21"}}).estimation == EstimationTable()


def test_presets_have_one_list_of_names():
    (literal,) = [one for one in get_args(get_type_hints(EstimationTable)["preset"]) if get_args(one)]
    assert set(get_args(literal)) == set(NAMES) == set(PRESETS)
