"""Words of files reach the terminal without control characters, whatever prints them."""

import json
import shutil
import zipfile

import pytest

from alula.cli.main import run
from support.paths import ROOT

HOSTILE = "\x1b[31m\x1b]0;owned\x07\x9b2J\u202e\r\nalula: covered\x7f"


def rewritten(path, edit) -> None:
    """Change the manifest of an artifact; arrays and their hashes stay."""
    with zipfile.ZipFile(path) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    manifest = json.loads(members["manifest.json"])
    edit(manifest)
    members["manifest.json"] = json.dumps(manifest).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, raw in members.items():
            archive.writestr(name, raw)


def hostile_manifest(manifest) -> None:
    manifest["summary"] = {HOSTILE: HOSTILE, "notes": [HOSTILE], HOSTILE + "2": {HOSTILE: [HOSTILE]}}
    manifest["parameters"] = {HOSTILE: HOSTILE}
    manifest["frame"] = HOSTILE
    manifest["guarantee"] = {"statement": HOSTILE, "claims": {HOSTILE: HOSTILE}}
    manifest["producer"] = dict.fromkeys(("name", "version", "commit"), HOSTILE)
    manifest["inputs"] = [dict.fromkeys(("role", "schema", "version", "sha256", "name"), HOSTILE)]


def assert_harmless(out: str) -> None:
    assert all(c.isprintable() for c in out.replace("\n", "")), out
    assert not any(line.startswith("alula: covered") for line in out.splitlines())


@pytest.mark.parametrize("kind", ["scene", "voxels", "cover", "plan"])
@pytest.mark.parametrize("words", [["info"], ["info", "--json"]])
def test_a_manifest_cannot_write_to_the_terminal(pipeline, tmp_path, capsys, kind, words):
    path = tmp_path / f"a.{kind}.npz"
    shutil.copy(pipeline / f"tiny.{kind}.npz", path)
    rewritten(path, hostile_manifest)
    assert run([*words, str(path)]) == 0
    shown = capsys.readouterr()
    assert_harmless(shown.out)
    assert_harmless(shown.err)


def test_notes_and_keys_of_an_output_cannot_write_to_the_terminal(capsys, tmp_path):
    from alula.cli.shell.options import Common
    from alula.cli.shell.runner import show

    common = Common(tmp_path / HOSTILE.replace("\n", ""))
    show(common, "written", {HOSTILE: HOSTILE, "b": {HOSTILE: [HOSTILE]}, "notes": [HOSTILE]})
    shown = capsys.readouterr()
    assert_harmless(shown.out)
    assert_harmless(shown.err)
    assert len(shown.err.splitlines()) == 1


@pytest.mark.parametrize(
    "text",
    [
        'version = "2.0"\n"a\\u001b[2J" = 1\n[world]\ncover = "c"\n',
        'version = "2.0"\n[world]\ncover = "c"\n[safety]\nfilters = ["\\u001b[2J"]\n',
        'version = "2.0"\n[world]\nscene = "\\u009b2J"\n[fly]\nframe_check = "\\u001b"\n',
        'version = "\\u001b[2J"\n',
        'schema = "\\u001b[2J"\n',
    ],
)
def test_errors_about_a_scenario_cannot_write_to_the_terminal(tmp_path, capsys, text):
    path = tmp_path / "a.toml"
    path.write_text(text)
    assert run(["info", str(path)]) in (0, 2, 3)
    shown = capsys.readouterr()
    assert_harmless(shown.out)
    assert_harmless(shown.err)


def test_every_line_passes_one_function():
    for path in sorted((ROOT / "cli").rglob("*.py")):
        uses = path.read_text().count("click.echo(") + path.read_text().count("secho(")
        allowed = {"present.py": 2, "main.py": 1}.get(path.name, 0)  # the function, JSON; the help
        assert uses == allowed, path
