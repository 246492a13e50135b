"""Exports, read back by other readers: the same solids, the same integers, and their provenance."""

import io
import json
import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from alula.cli.main import run
from alula.schemas.artifacts.artifact import make_artifact, read_artifact, write_artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.artifacts.provenance import read_provenance
from support.scenes.fabricate import box, exact_hull, make_cover, make_plan, make_scene, make_voxels

G = 0.05


@pytest.fixture(scope="module")
def hulls():
    rng = np.random.default_rng(4)
    round_ones = [exact_hull(rng.integers(-20, 20, (n, 3)) + np.array([50, 0, 7])) for n in (12, 60)]
    return [box((0, 0, 0), (3, 4, 5)), *round_ones]


@pytest.fixture(scope="module")
def folder(tmp_path_factory, hulls) -> Path:
    folder = tmp_path_factory.mktemp("export")
    write_artifact(folder / "solid facet.cover.npz", make_cover(hulls, g=G))
    write_artifact(folder / "empty.cover.npz", make_cover([]))
    write_artifact(folder / "m.scene.npz", make_scene(400))
    write_artifact(folder / "v.voxels.npz", make_voxels())
    write_artifact(folder / "p.plan.npz", make_plan())
    return folder


def export(source: Path, out: Path, *words, code=0) -> Path:
    assert run(["export", str(source), "-o", str(out), *words]) == code
    return out


@pytest.fixture
def cover(folder) -> Path:
    return folder / "solid facet.cover.npz"


def volumes(hulls):
    return [ConvexHull(v).volume * G**3 for v, _ in hulls]


@pytest.mark.parametrize("suffix", ["glb", "obj"])
def test_named_solids_come_back_with_their_volumes(cover, hulls, tmp_path, suffix):
    import trimesh

    loaded = trimesh.load_scene(export(cover, tmp_path / f"c.{suffix}"), process=False)
    parts = {name: loaded.geometry[name] for name in loaded.geometry}
    if suffix == "obj":  # trimesh joins the objects of an OBJ
        (solid,) = parts.values()
        found = sorted(piece.volume for piece in solid.split())
        assert found == pytest.approx(sorted(volumes(hulls)), rel=1e-9)
        names = [line[2:] for line in (tmp_path / "c.obj").read_text().splitlines() if line.startswith("o ")]
        assert names == ["hull-00000", "hull-00001", "hull-00002"]
        return
    assert sorted(parts) == ["hull-00000", "hull-00001", "hull-00002"]
    for name, volume in zip(sorted(parts), volumes(hulls), strict=True):
        solid = parts[name]
        solid.merge_vertices()
        assert solid.is_watertight
        assert solid.volume == pytest.approx(volume, rel=1e-5)  # single precision


def test_z_points_up_where_the_format_says_y_does(cover, hulls, tmp_path):
    import trimesh

    loaded = trimesh.load_scene(export(cover, tmp_path / "c.glb"))
    transform, name = loaded.graph["hull-00000"]
    points = trimesh.transform_points(loaded.geometry[name].vertices, transform)
    assert np.ptp(points, axis=0) == pytest.approx([3 * G, 5 * G, 4 * G], rel=1e-6)  # x, up, y
    assert np.linalg.det(transform) == pytest.approx(1)


def test_stl_keeps_the_coordinates_and_survives_hostile_names(cover, hulls, tmp_path):
    import trimesh

    path = export(cover, tmp_path / "c.stl")
    text = path.read_text()
    assert [line.split()[1] for line in text.splitlines() if line.startswith("solid ")] == [
        f"hull-{i:05d}" for i in range(3)
    ]
    loaded = trimesh.load_mesh(io.BytesIO(text.encode()), file_type="stl")
    loaded = loaded if isinstance(loaded, trimesh.Trimesh) else loaded.to_geometry()
    assert loaded.volume == pytest.approx(sum(volumes(hulls)), rel=1e-12)
    assert read_provenance(path).inputs[0].name == "solid facet.cover.npz"
    assert "guarantee of the cover does not carry over" in text


def test_json_holds_the_exact_integers(cover, hulls, tmp_path):
    record = json.loads(export(cover, tmp_path / "c.json").read_text())
    assert record["voxel_size_m"] == G
    assert record["guarantee"]["statement"]
    assert len(record["hulls"]) == len(hulls)
    for found, (vertices, planes) in zip(record["hulls"], hulls, strict=True):
        assert found["vertices"] == vertices.tolist()
        assert found["planes"] == planes.tolist()
        metres = np.array(found["planes_m"])
        assert np.linalg.norm(metres[:, :3], axis=1) == pytest.approx(np.ones(len(planes)))
        slack = metres[:, 3] - (np.array(found["vertices_m"]) @ metres[:, :3].T).max(axis=0)
        assert (slack >= 0).all()
        assert (slack < 1e-12).all()


def test_ply_is_a_splat_file_again(folder, tmp_path):
    path = export(folder / "m.scene.npz", tmp_path / "s.ply")
    assert run(["import-splat", str(path), "-o", str(tmp_path / "s.scene.npz"), "--min-opacity", "0"]) == 0
    from alula.schemas.artifacts.artifact import read_artifact

    first, second = read_artifact(folder / "m.scene.npz"), read_artifact(tmp_path / "s.scene.npz")
    assert len(second["mean"]) == 400
    assert (first["mean"] == second["mean"]).all()
    assert (first["color"] == second["color"]).all()
    for name in ("scale", "opacity"):
        assert second[name] == pytest.approx(first[name], rel=2e-6)


def one_json(capsys):
    return json.loads(capsys.readouterr().out)["summary"]


def scene_again(source: Path, out: Path) -> Path:
    again = out.with_name(out.name + ".scene.npz")
    assert run(["import-splat", str(out), "-o", str(again), "--min-opacity", "0", "-q"]) == 0
    return again


def check_losses(source: Path, out: Path, told) -> None:
    """The printed loss of an export is the true one, and its import allows for it."""
    first, second = read_artifact(source), read_artifact(scene_again(source, out))
    away = np.linalg.norm(first["mean"].astype(float) - second["mean"], axis=1)
    ratio = second["scale"] / first["scale"].astype(float)
    q, r = first["quat_wxyz"].astype(float), second["quat_wxyz"].astype(float)
    q, r = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (q, r))
    angle = 2 * np.arccos(np.clip(np.abs((q * r).sum(axis=1)), 0, 1))
    bound = second.arrays.get("loss", np.zeros((len(away), 3)))
    least = 2e-6 if out.suffix == ".ply" else 0  # logarithms of single precision
    assert (away <= bound[:, 0]).all()
    assert ((1 / ratio).max(axis=1) - 1 <= bound[:, 1] + least).all()
    assert (angle <= bound[:, 2] + 1e-7).all()
    assert told["position_error"] == pytest.approx(away.max(), abs=1e-9)
    assert told["scale_shorter"] == pytest.approx(1 - ratio.min(), abs=1e-6)
    assert told["scale_longer"] == pytest.approx(ratio.max() - 1, abs=1e-6)
    assert told["rotation_error_rad"] == pytest.approx(angle.max(), abs=1e-6)
    alpha = np.abs(first["opacity"].astype(float) - second["opacity"])
    assert told["opacity_error"] == pytest.approx(alpha.max(), abs=1e-6)
    assert alpha.max() <= second.manifest.source["loss"]["opacity"] + 1e-6
    color = np.abs(first["color"].astype(int) - second["color"])
    assert told["color_error"] == color.max() <= (1 if out.suffix == ".spz" else 0)


FORMS = [("ply",), ("splat",), ("spz",), ("spz", "--spz-version", "2"), ("spz", "--spz-version", "4")]


@pytest.mark.parametrize("form", FORMS, ids=" ".join)
def test_a_scene_comes_back_within_what_is_told_and_allowed_for(folder, tmp_path, form, capsys):
    suffix, *words = form
    source = folder / "m.scene.npz"
    out = export(source, tmp_path / f"s.{suffix}", "--json", *words)
    told = one_json(capsys)
    assert told["bytes"] == out.stat().st_size
    check_losses(source, out, told)
    if suffix == "spz":
        assert 0.02 < told["scale_shorter"] < 0.032
        assert (told["rotation_error_rad"] > 0.01) == ("2" in words)


@pytest.mark.parametrize("form", FORMS[2:], ids=" ".join)
def test_an_spz_knows_where_it_came_from(folder, tmp_path, form, capsys):
    suffix, *words = form
    source = folder / "m.scene.npz"
    out = export(source, tmp_path / f"s.{suffix}", *words)
    raw = out.read_bytes()
    found = read_provenance(out)
    assert found.schema == "alula/export"
    assert found.parameters == {"format": "spz", "spz_version": int(words[1]) if words else 3}
    capsys.readouterr()
    export(source, out, *words)
    assert "unchanged" in capsys.readouterr().out
    export(source, out, "--spz-version", "3" if words else "2", code=2)
    assert "spz_version was" in capsys.readouterr().err
    assert export(source, tmp_path / "t.spz", *words).read_bytes() == raw


def test_only_force_replaces_a_splat(folder, tmp_path, capsys):
    source = folder / "m.scene.npz"
    out = export(source, tmp_path / "s.splat")
    raw = out.read_bytes()
    assert len(raw) == 32 * 400
    export(source, out, code=2)
    assert "not a file of alula's; -f replaces it" in capsys.readouterr().err
    export(source, out, "-f")
    assert out.read_bytes() == raw


def test_what_the_format_cannot_hold_is_refused(tmp_path, capsys):
    arrays = dict(make_scene(5).arrays)
    arrays["scale"] = np.where(np.arange(15).reshape(5, 3) == 7, 1000, arrays["scale"])
    facts = {"frame": "world", "unit": "m", "parameters": {}, "summary": {}, "source": {"format": "ply"}}
    write_artifact(tmp_path / "a.scene.npz", make_artifact(SCENE, arrays, **facts))
    export(tmp_path / "a.scene.npz", tmp_path / "a.spz", code=3)
    error = capsys.readouterr().err
    assert "a.scene.npz: 1 Gaussians have a semi-axis longer than" in error
    assert not (tmp_path / "a.spz").exists()
    export(tmp_path / "a.scene.npz", tmp_path / "a.splat")
    export(tmp_path / "a.scene.npz", tmp_path / "b.spz", "--spz-version", "1", code=2)
    assert "--spz-version must be between 2 and 4, not 1" in capsys.readouterr().err


def test_a_dry_run_tells_and_writes_nothing(folder, tmp_path, capsys):
    export(folder / "m.scene.npz", tmp_path / "s.spz", "-n", "--json")
    assert one_json(capsys)["rotation_error_rad"] > 0
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("form", FORMS[1:], ids=" ".join)
def test_voxels_of_a_lossy_copy_contain_those_of_the_scene(folder, tmp_path, form):
    suffix, *words = form
    again = scene_again(
        folder / "m.scene.npz", export(folder / "m.scene.npz", tmp_path / f"s.{suffix}", *words)
    )
    metric = tmp_path / "again.scene.npz"
    assert run(["scale-align", str(again), "-o", str(metric), "--scale", "1", "-q"]) == 0

    def voxels(scene, *options):
        out = tmp_path / "v.npz"
        words = ["--size", "0.02", "--inflate", "0", "-f", "-q"]
        assert run(["voxelize", str(scene), "-o", str(out), *words, *options]) == 0
        return {tuple(row) for row in read_artifact(out)["index"].tolist()}

    exact = voxels(folder / "m.scene.npz")
    assert exact <= voxels(metric)
    assert not exact <= voxels(metric, "--ignore-loss")


@pytest.mark.parametrize("suffix", ["ply", "splat", "spz"])
@pytest.mark.parametrize("name", ["istanbul-outdoor/tile_x001_y000.splat", "fourth-st-spz/fourth_st.spz"])
def test_real_scenes_come_back_within_what_is_told_and_allowed_for(tmp_path, name, suffix, capsys):
    root = os.environ.get("ALULA_DATA")
    if not root:
        pytest.skip("ALULA_DATA is not set")
    source = tmp_path / "a.scene.npz"
    words = ["-o", str(source), "--min-opacity", "0", "-q"]
    assert run(["import-splat", str(Path(root) / name), *words]) == 0
    capsys.readouterr()
    out = export(source, tmp_path / f"b.{suffix}", "--json")
    told = one_json(capsys)
    assert "does not record" in told["notes"][0]
    check_losses(source, out, told)


def test_an_opaque_gaussian_gets_a_finite_logit(tmp_path):
    scene = make_scene(3)
    scene.arrays["opacity"][:] = [0.0, 0.5, 1.0]
    from alula.schemas.artifacts.provenance import Provenance
    from alula.stages.export.export import export as stage

    raw = b"".join(stage(scene, "ply", Provenance.now("alula/export", "1.0", {}, None, [])))
    body = raw[raw.index(b"end_header\n") + len(b"end_header\n") :]
    rows = np.frombuffer(body, "<f4").reshape(3, -1)
    assert np.isfinite(rows).all()


@pytest.mark.parametrize("suffix", ["glb", "obj"])
def test_a_scene_becomes_coloured_points(folder, tmp_path, suffix):
    import trimesh

    path = export(folder / "m.scene.npz", tmp_path / f"s.{suffix}")
    from alula.schemas.artifacts.artifact import read_artifact

    scene = read_artifact(folder / "m.scene.npz")
    if suffix == "glb":
        (cloud,) = trimesh.load_scene(path).geometry.values()
        points, colors = cloud.vertices, cloud.colors[:, :3]
    else:
        rows = [line.split()[1:] for line in path.read_text().splitlines() if line.startswith("v ")]
        table = np.array(rows, float)
        points, colors = table[:, :3], np.rint(table[:, 3:] * 255)
    assert (points.astype(np.float32) == scene["mean"]).all()
    assert (colors == scene["color"]).all()


@pytest.mark.parametrize("suffix", ["glb", "obj", "json", "stl"])
def test_equal_inputs_give_equal_bytes_and_are_skipped(cover, tmp_path, suffix, capsys):
    first = export(cover, tmp_path / f"a.{suffix}")
    second = export(cover, tmp_path / f"b.{suffix}")
    assert first.read_bytes() == second.read_bytes()
    capsys.readouterr()
    export(cover, first)
    assert "unchanged" in capsys.readouterr().out
    found = read_provenance(first)
    assert (found.schema, found.parameters) == ("alula/export", {"format": suffix})


@pytest.mark.parametrize("suffix", ["glb", "obj", "json", "stl"])
def test_an_empty_cover_is_exported(folder, tmp_path, suffix):
    path = export(folder / "empty.cover.npz", tmp_path / f"e.{suffix}")
    assert path.stat().st_size > 0


def test_a_format_can_be_forced(cover, tmp_path):
    path = export(cover, tmp_path / "c.txt", "--format", "json")
    assert json.loads(path.read_text())["schema"] == "alula/cover-json"
    export(cover, path, "--format", "json")  # recognised as unchanged


@pytest.mark.parametrize(
    ("source", "out", "code", "message"),
    [
        ("solid facet.cover.npz", "c.ply", 2, "a cover is exported as glb, obj, json, stl"),
        ("m.scene.npz", "s.stl", 2, "a scene is exported as ply, splat, spz, glb, obj"),
        ("m.scene.npz", "s.docx", 2, "must end in one of"),
        ("v.voxels.npz", "v.glb", 2, "voxels are exported as octomap, ply, pcd, not as glb"),
        ("p.plan.npz", "p.json", 3, "is alula/plan"),
    ],
)
def test_what_cannot_be_exported_is_refused(folder, tmp_path, capsys, source, out, code, message):
    export(folder / source, tmp_path / out, code=code)
    error = capsys.readouterr().err
    assert message in error
    assert len(error.splitlines()) == 1
    assert not list(tmp_path.iterdir())
