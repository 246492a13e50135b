"""The command `alula verify` checks the given files and never trusts an existing certificate."""

import dataclasses
import json
import shutil

import msgspec
import pytest

from alula.cli.main import run
from alula.cli.shell.runner import input_ref
from alula.schemas.artifacts.artifact import describe_arrays, read_artifact, write_artifact
from alula.schemas.artifacts.kinds import COVER
from alula.schemas.artifacts.manifest import producer


@pytest.fixture
def files(pipeline, tmp_path):
    for name in ("tiny.cover.npz", "tiny.voxels.npz", "tiny.certificate.json"):
        shutil.copy(pipeline / name, tmp_path)
    return tmp_path


def spoil(path, **changes):
    """Rewrite a cover with other arrays, consistently with its manifest."""
    found = read_artifact(path, COVER)
    arrays = {name: array.copy() for name, array in found.arrays.items()} | changes
    described = describe_arrays(COVER, "world", "m", arrays)
    path.unlink()
    write_artifact(
        path,
        dataclasses.replace(
            found, arrays=arrays, manifest=msgspec.structs.replace(found.manifest, arrays=described)
        ),
    )


def test_a_forged_certificate_is_not_believed(files, capsys):
    cover, voxels, out = files / "tiny.cover.npz", files / "tiny.voxels.npz", files / "tiny.certificate.json"
    offset = read_artifact(cover)["plane_offset"].copy()
    offset[3] -= 1
    spoil(cover, plane_offset=offset)
    forged = json.loads(out.read_text())
    assert forged["covered"] is True
    forged["provenance"]["inputs"] = [
        {
            "role": ref.role,
            "schema": ref.schema,
            "version": ref.version,
            "sha256": ref.sha256,
            "name": ref.name,
        }
        for ref in (input_ref("cover", cover), input_ref("voxels", voxels))
    ]
    assert forged["provenance"]["producer"]["version"] == producer().version
    out.write_text(json.dumps(forged))
    assert run(["verify", str(cover), "--voxels", str(voxels), "-o", str(out)]) == 4
    shown = capsys.readouterr()
    assert shown.out.startswith("not covered")
    assert "vertex is outside its hull" in shown.err


def test_a_certificate_that_was_edited_is_written_anew(files, capsys):
    cover, voxels, out = files / "tiny.cover.npz", files / "tiny.voxels.npz", files / "tiny.certificate.json"
    good = out.read_bytes()
    edited = json.loads(good)
    edited["left_out"] = "nothing"
    out.write_text(json.dumps(edited))
    assert run(["verify", str(cover), "--voxels", str(voxels), "-o", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["status"] == "written"
    assert out.read_bytes() == good


def test_another_voxels_file_with_the_same_content_is_noted(files, capsys):
    cover, voxels = files / "tiny.cover.npz", files / "tiny.voxels.npz"
    again = files / "again.voxels.npz"
    found = read_artifact(voxels)
    write_artifact(
        again,
        dataclasses.replace(found, manifest=msgspec.structs.replace(found.manifest, summary={"by": "hand"})),
    )
    assert run(["verify", str(cover), "--voxels", str(voxels)]) == 0
    assert "note:" not in capsys.readouterr().out
    assert run(["verify", str(cover), "--voxels", str(again)]) == 0
    assert "note: the cover was made from another voxels file, tiny.voxels.npz" in capsys.readouterr().out


def test_the_files_of_a_certificate_are_written_for_make(files, monkeypatch):
    monkeypatch.chdir(files)
    proven = ["verify", "tiny.cover.npz", "--voxels", "tiny.voxels.npz"]
    words = [*proven, "-o", "a.json", "--depfile", "a.d", "-q"]
    assert run([*words, "-n"]) == 0
    assert not (files / "a.d").exists()
    assert run(words) == 0
    assert (files / "a.d").read_text() == "a.json: tiny.cover.npz tiny.voxels.npz\n"
