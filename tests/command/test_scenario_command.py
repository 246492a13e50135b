"""`alula scenario` as a user runs it: text with sources, upgrade to a file, list of keys, refusals."""

import json

import pytest

from alula.cli.main import run
from alula.schemas.world import is_world, read_world
from support.paths import EXAMPLES

OLD = EXAMPLES / "geofencing" / "combined.toml"
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
    assert read_world(again).safety.cone_backup.horizon_s == 2.0


def test_it_upgrades_to_a_file_whose_names_lead_to_the_same_files(tmp_path, capsys):
    new = tmp_path / "new.toml"
    assert run(["scenario", str(OLD), "-o", str(new)]) == 0
    assert capsys.readouterr().out == ""
    assert is_world(new)
    named = read_world(new).vehicle.file
    assert (tmp_path / named).resolve() == (EXAMPLES / "vehicles" / "racer7.toml").resolve()
    assert run(["scenario", str(new), "-q"]) == 0
    assert run(["scenario", str(OLD), "-o", str(new)]) == 3
    assert "exists; -f replaces it" in capsys.readouterr().err
    assert run(["scenario", str(OLD), "-o", str(new), "-f"]) == 0


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
        (["scenario"], 2, "needs a FILE, or --keys"),
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
