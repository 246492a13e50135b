"""The commands `alula merge` and `alula verify`."""

import json
import os

import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import Artifact, make_artifact, read_artifact, write_artifact
from alula.schemas.artifacts.kinds import COVER, VOXELS

FIELDS = (
    *("voxel_size_m", "sigma", "min_overlap", "inflation_m", "crop", "conservativeness", "certificate"),
    *("frame", "unit", "parameters", "summary"),
)


def two_walls() -> np.ndarray:
    y, z = np.divmod(np.arange(60), 6)
    return np.concatenate([np.stack([np.full(60, x), y, z], axis=1) for x in (-3, 4)]).astype(np.int32)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    index = np.unique(np.concatenate([two_walls(), [[0, 0, 0], [1, 1, 1]]]), axis=0)
    voxels = make_artifact(
        VOXELS,
        {"index": index, "overlap": np.ones(len(index))},
        **{"frame": "world", "unit": "m", "parameters": {}, "summary": {}},
        **{"voxel_size_m": 0.5, "sigma": 1.0, "min_overlap": 1},
    )
    write_artifact(tmp_path / "v.voxels.npz", voxels)
    monkeypatch.chdir(tmp_path)
    assert run(["merge", "v.voxels.npz", "-o", "c.cover.npz", "--hulls", "3", "-q"]) == 0
    return tmp_path


def damage_plane(folder) -> None:
    """Move one plane inward by one unit and write a file whose hashes are right."""
    cover = read_artifact(folder / "c.cover.npz")
    offset = cover["plane_offset"].copy()
    offset[2] -= 1
    arrays = {**cover.arrays, "plane_offset": offset}
    fields = {name: getattr(cover.manifest, name) for name in FIELDS}
    changed: Artifact = make_artifact(COVER, arrays, **fields)
    write_artifact(folder / "c.cover.npz", changed)


def test_merge_prints_and_records_what_it_did(folder, capsys):
    capsys.readouterr()
    assert run(["merge", "v.voxels.npz", "-o", "d.cover.npz", "--hulls", "2", "--json", "--jobs", "2"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["status"] == "written"
    assert shown["summary"]["voxels"] == 122
    assert shown["summary"]["hulls"] <= 2
    manifest = read_artifact(folder / "d.cover.npz", COVER).manifest
    assert manifest.parameters["hulls"] == 2
    assert manifest.parameters["method"] == "default"
    assert "jobs" not in manifest.parameters
    assert [ref.role for ref in manifest.inputs] == ["source"]
    assert manifest.guarantee.claims["uncovered_voxels"] == 0


def test_equal_runs_give_equal_bytes(folder):
    for name, jobs in (("a", "1"), ("b", "3")):
        assert (
            run(["merge", "v.voxels.npz", "-o", f"{name}.cover.npz", "--max-growth", "1.5", "--jobs", jobs])
            == 0
        )
    assert (folder / "a.cover.npz").read_bytes() == (folder / "b.cover.npz").read_bytes()


def test_a_cover_is_merged_further_and_verified(folder):
    assert run(["merge", "c.cover.npz", "-o", "one.cover.npz", "--hulls", "1", "-q"]) == 0
    assert len(read_artifact(folder / "one.cover.npz")["plane_start"]) == 2
    assert run(["verify", "one.cover.npz", "--voxels", "v.voxels.npz", "-q"]) == 0


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["--max-planes", "3"], 5),
        (["--hulls", "1", "--max-growth", "1.1"], 5),
        (["--hulls", "0"], 2),
        (["--max-growth", "nan"], 2),
        (["--method", "magic"], 2),
    ],
)
def test_limits_that_cannot_hold_are_one_line(folder, capsys, words, code):
    assert run(["merge", "v.voxels.npz", "-o", "x.cover.npz", *words]) == code
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert not (folder / "x.cover.npz").exists()


def test_verify_prints_a_table_and_writes_a_certificate(folder, capsys):
    words = ["verify", "c.cover.npz", "--voxels", "v.voxels.npz", "-o", "c.json"]
    assert run(words) == 0
    out = capsys.readouterr().out
    assert out.startswith(
        "covered: every voxel in a hull (the scene was not given: no ellipsoid was checked)\n"
    )
    assert "hulls are exact polytopes" in out
    record = json.loads((folder / "c.json").read_text())
    assert record["covered"] is True
    assert [ref["role"] for ref in record["provenance"]["inputs"]] == ["cover", "voxels"]
    content = (folder / "c.json").read_bytes()
    os.utime(folder / "c.json", (0, 0))
    assert run([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["status"] == "unchanged"
    assert (folder / "c.json").read_bytes() == content
    assert (folder / "c.json").stat().st_mtime > 10**9


def test_verify_without_output_only_answers(folder, capsys):
    before = set(folder.iterdir())
    assert run(["verify", "c.cover.npz", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["covered"] is True
    assert shown["given"] == ["cover"]
    assert len(shown["not_checked"]) == 2
    assert shown["status"] == "checked"
    assert set(folder.iterdir()) == before


def test_a_broken_cover_is_exit_4_names_the_place_and_writes_nothing(folder, capsys):
    damage_plane(folder)
    words = ["verify", "c.cover.npz", "--voxels", "v.voxels.npz", "-o", "c.json"]
    assert run([*words, "--json"]) == 4
    captured = capsys.readouterr()
    shown = json.loads(captured.out)
    assert shown["covered"] is False
    assert shown["status"] == "failed"
    assert len(captured.err.splitlines()) == 1
    assert "c.cover.npz: not proven: hulls are exact polytopes" in captured.err
    assert "hull 0" in captured.err
    assert " m" in captured.err
    assert not (folder / "c.json").exists()
    assert run(words[:2]) == 4


def test_verify_refuses_another_suffix_and_another_kind(folder, capsys):
    assert run(["verify", "c.cover.npz", "-o", "c.npz"]) == 2
    assert run(["verify", "v.voxels.npz"]) == 3
    assert run(["verify", "c.cover.npz", "--voxels", "c.cover.npz"]) == 3
    assert len(capsys.readouterr().err.splitlines()) == 3


@pytest.mark.slow
def test_the_whole_chain_is_proven_on_a_real_scene(data, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = sorted(data.glob("cc0-corpus/**/*.ply"))
    assert found
    for step in (
        ["import-splat", str(found[0]), "-o", "s.scene.npz"],
        ["scale-align", "s.scene.npz", "-o", "m.scene.npz", "--scale", "1"],
        ["voxelize", "m.scene.npz", "-o", "v.voxels.npz", "--size", "0.1"],
        ["merge", "v.voxels.npz", "-o", "c.cover.npz", "--hulls", "100"],
        ["verify", "c.cover.npz", "--voxels", "v.voxels.npz", "--scene", "m.scene.npz", "-o", "c.json"],
    ):
        assert run([*step, "-q"]) == 0, step
    smaller = read_artifact(tmp_path / "c.cover.npz")
    record = json.loads((tmp_path / "c.json").read_text())
    assert [check["ok"] for check in record["checks"]] == [True] * 7
    assert record["checks"][-1]["checked"] == len(read_artifact(tmp_path / "m.scene.npz")["mean"])
    assert smaller.manifest.conservativeness >= 1
