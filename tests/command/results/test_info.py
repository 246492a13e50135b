"""`info` explains complete files, and for damaged ones states the damage and the readable rest."""

import json
from pathlib import Path

import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import write_artifact
from alula.schemas.artifacts.kinds import PLAN
from alula.schemas.artifacts.salvage import salvage
from support.paths import VEHICLES
from support.scenes.fabricate import (
    box,
    make_cover,
    make_plan,
    make_record,
    make_scene,
    make_trial,
    make_voxels,
    write_run,
)


@pytest.fixture
def folder(tmp_path) -> Path:
    write_artifact(tmp_path / "a.cover.npz", make_cover([box((0, 0, 0), (9, 4, 2))]))
    write_artifact(tmp_path / "a.scene.npz", make_scene(30))
    write_artifact(tmp_path / "a.voxels.npz", make_voxels())
    write_artifact(tmp_path / "a.plan.npz", make_plan())
    write_run(tmp_path / "a.run.mcap", make_record([make_trial(0), make_trial(1, "stuck")]))
    (tmp_path / "a.toml").write_text('version = "2.0"\n[world]\ncover = "a.cover.npz"\n[rules]\ntrials = 7\n')
    return tmp_path


def info(path: Path, capsys, code=0) -> tuple[dict, str]:
    capsys.readouterr()
    assert run(["info", str(path), "--json"]) == code
    shown = capsys.readouterr()
    return json.loads(shown.out) if shown.out else {}, shown.err


def plain(path: Path, capsys, code=0) -> str:
    capsys.readouterr()
    assert run(["info", str(path)]) == code
    return capsys.readouterr().out


def test_every_kind_of_artifact_is_explained(folder, capsys):
    facts, _ = info(folder / "a.cover.npz", capsys)
    assert (facts["kind"], facts["version"], facts["undamaged"]) == ("alula/cover", "1.1", True)
    assert facts["measured"]["hulls"] == 1
    assert facts["measured"]["half-planes"] == 6
    assert facts["measured"]["upper"] == pytest.approx([0.45, 0.2, 0.1])
    assert facts["properties"]["voxel_size_m"] == 0.05
    assert facts["arrays"]["vertex"] == {
        "dtype": "<i4",
        "shape": [8, 3],
        "unit": "voxel",
        "meaning": "vertices of all hulls",
    }
    assert facts["guarantee"]["claims"] == {"covers_voxels": True}
    assert facts["parameters"] == {"hulls": 1}
    facts, _ = info(folder / "a.scene.npz", capsys)
    assert facts["measured"]["gaussians"] == 30
    assert (facts["frame"], facts["unit"]) == ("world", "m")
    facts, _ = info(folder / "a.voxels.npz", capsys)
    assert facts["measured"]["voxels"] == 12
    assert facts["measured"]["volume_m3"] == pytest.approx(12 * 0.05**3)
    assert facts["measured"]["upper"] == pytest.approx([0.2, 0.15, 0.05])
    facts, _ = info(folder / "a.plan.npz", capsys)
    assert facts["measured"]["duration_s"] == 3.0


def test_a_run_is_explained(folder, capsys):
    facts, _ = info(folder / "a.run.mcap", capsys)
    assert facts["kind"] == "alula/run"
    assert facts["summary"]["stuck"] == 1
    assert facts["properties"]["filter"] == "polytope-cbf"
    assert facts["messages"] == {"/safety": 120, "/state": 120}
    assert "polytope-cbf" in plain(folder / "a.run.mcap", capsys)


def test_a_scenario_is_explained(folder, capsys):
    facts, _ = info(folder / "a.toml", capsys)
    assert facts["kind"] == "alula/scenario"
    assert facts["world"]["cover"] == "a.cover.npz"
    assert facts["rules"]["trials"] == 7
    (folder / "bad.toml").write_text("[map\n")
    info(folder / "bad.toml", capsys, code=3)


def test_vehicles_are_explained(capsys):
    examples = VEHICLES
    for path in sorted(examples.glob("*.toml")):
        facts, _ = info(path, capsys)
        assert (facts["kind"], facts["name"]) == ("alula/vehicle", path.stem)
        assert facts["body"]["radius_m"] > 0


def test_what_alula_wrote_for_others_is_explained(folder, capsys):
    for suffix in ("glb", "obj", "stl", "json"):
        out = folder / f"x.{suffix}"
        assert run(["export", str(folder / "a.cover.npz"), "-o", str(out)]) == 0
        facts, _ = info(out, capsys)
        assert facts["kind"] == "alula/export"
        assert facts["inputs"][0]["name"] == "a.cover.npz"
    assert run(["export", str(folder / "a.scene.npz"), "-o", str(folder / "x.ply")]) == 0
    facts, _ = info(folder / "x.ply", capsys)
    assert facts["kind"] == "splat file: ply"
    assert facts["summary"]["gaussians"] == 30
    assert facts["written by"]["kind"] == "alula/export"


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("fourth-st-spz/fourth_st.spz", "splat file: spz"),
        ("cc0-corpus/leica-sofort-top8192.sog", "splat file: sog"),
        ("playbot-lod-sog/6_0", "splat file: sog"),
        ("tiny-conformance/splat-transform-minimal.ksplat", "splat file: ksplat"),
        ("tiny-conformance/khr_conformance_matrix.glb", "splat file: gltf"),
        ("tiny-conformance/brush-init.ply", "an ordinary point cloud or mesh, not a Gaussian splat"),
        ("inria-ply/train-1000.ply", "splat file: ply"),
        ("tiny-conformance/splat-transform-minimal.splat", "splat file: splat"),
    ],
)
def test_splat_files_are_named_by_content(data, name, kind, capsys):
    facts, error = info(data / name, capsys)
    assert facts["kind"].startswith(kind)
    assert not error


def test_names_of_arrays_and_units_are_shown_as_text(folder, capsys):
    text = plain(folder / "a.cover.npz", capsys)
    assert "plane_normal  i64    6 x 3  1      outward primitive normals" in text
    assert "\x1b" not in text


def test_control_characters_in_a_file_do_not_reach_the_terminal(folder, capsys):
    cover = make_cover([], parameters={"name": "\x1b[31mred\x07"})
    write_artifact(folder / "b.cover.npz", cover)
    text = plain(folder / "b.cover.npz", capsys)
    assert "?[31mred?" in text
    assert "\x1b" not in text


def test_a_truncated_artifact_is_explained_as_far_as_it_goes(folder, capsys):
    path = folder / "a.cover.npz"
    raw = path.read_bytes()
    end_of_manifest = raw.index(b"history.npy") - 30
    for size in (2, 20, 60, 400, end_of_manifest, len(raw) // 2, len(raw) - 30, len(raw) - 1):
        path.write_bytes(raw[:size])
        facts, error = info(path, capsys, code=3)
        assert len(error.strip().splitlines()) == 1
        assert path.name in error
        assert facts.get("exit_code") == 3 or facts["undamaged"] is False
        if size >= end_of_manifest:
            assert facts["kind"] == "alula/cover"
            assert facts["arrays"]["vertex"]["shape"] == [8, 3]
    path.write_bytes(raw[: raw.index(b"plane_normal.npy") + 200])
    facts, error = info(path, capsys, code=3)
    assert facts["damage"].startswith("the file ends inside plane_normal; whole: manifest.json, history")
    assert "the file ends inside plane_normal" in error


def test_a_changed_byte_is_found_in_its_array(folder, capsys):
    path = folder / "a.cover.npz"
    raw = bytearray(path.read_bytes())
    vertex = make_cover([box((0, 0, 0), (9, 4, 2))])["vertex"].tobytes()
    raw[raw.index(vertex) + 5] ^= 1
    path.write_bytes(raw)
    facts, error = info(path, capsys, code=3)
    assert "array vertex does not match its SHA-256" in error
    assert "vertex does not match its checksum" in facts["damage"]
    assert facts["measured" if "measured" in facts else "summary"] == {}
    assert facts["properties"]["voxel_size_m"] == 0.05


@pytest.mark.slow
def test_no_changed_byte_leads_to_anything_but_the_documented_codes(folder, capsys):
    path = folder / "a.plan.npz"
    raw = path.read_bytes()
    for place in [*range(0, len(raw), 13), *range(len(raw) - 320, len(raw))]:
        for flip in (0x01, 0x80):
            spoilt = bytearray(raw)
            spoilt[place] ^= flip
            path.write_bytes(spoilt)
            code = run(["info", str(path), "--json"])
            shown = capsys.readouterr()
            assert code in (0, 3), (place, flip, shown.err)
            assert "internal error" not in shown.err
            if code == 3:
                assert len(shown.err.strip().splitlines()) == 1


def test_a_truncated_or_changed_log_is_explained_as_far_as_it_goes(folder, capsys):
    path = folder / "a.run.mcap"
    raw = path.read_bytes()
    for size in (9, 100, len(raw) // 3, len(raw) - 200, len(raw) - 4):
        path.write_bytes(raw[:size])
        facts, error = info(path, capsys, code=3)
        assert "truncated or corrupt" in error
        assert "messages can still be read" in facts["damage"]
        assert len(error.strip().splitlines()) == 1
    for place in range(8, len(raw), len(raw) // 150):
        spoilt = bytearray(raw)
        spoilt[place] ^= 0x55
        path.write_bytes(spoilt)
        code = run(["info", str(path), "-q"])
        shown = capsys.readouterr()
        assert code in (0, 3), (place, shown.err)
        assert "internal error" not in shown.err


def test_a_newer_artifact_is_refused_but_its_manifest_is_shown(folder, capsys):
    import zipfile

    path = folder / "a.plan.npz"
    with zipfile.ZipFile(path) as archive:
        members = {i.filename: archive.read(i) for i in archive.infolist()}
    written = f'"version": "{PLAN.version}"'.encode()
    members["manifest.json"] = members["manifest.json"].replace(written, b'"version": "9.0"')
    with zipfile.ZipFile(path, "w") as archive:
        for name, raw in members.items():
            archive.writestr(name, raw)
    facts, error = info(path, capsys, code=3)
    assert "newer" in error
    assert facts["version"] == "9.0"
    assert facts["properties"]["radius_m"] == 0.1


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"hello", "is not an artifact, a run"),
        (b"\x00" * 5000, "is not an artifact, a run"),
    ],
)
def test_nothing_known_is_refused(tmp_path, capsys, content, message):
    path = tmp_path / "thing.bin"
    path.write_bytes(content)
    _, error = info(path, capsys, code=3)
    assert message in error


def test_folders_and_missing_files_are_refused(tmp_path, capsys):
    assert "is a folder" in info(tmp_path, capsys, code=3)[1]
    assert "cannot read" in info(tmp_path / "none", capsys, code=3)[1]


def test_salvage_reads_what_the_archive_holds(folder):
    left = salvage(folder / "a.scene.npz")
    assert left.whole == ("manifest.json", "color", "mean", "opacity", "quat_wxyz", "scale")
    assert (left.damaged, left.cut) == ((), "")
    assert left.manifest["schema"] == "alula/scene"
