"""The commands `demo-scene`, `import-splat` and `scale-align`."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.artifacts.provenance import read_provenance
from alula.stages.reconstruction.demo_scene import world_from_scene


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo")
    words = ["--gaussians", "4000", "--seed", "3", "--colmap", str(folder / "sparse")]
    words += ["--cameras", str(folder / "cameras.csv"), "--reference", str(folder / "poses.csv")]
    assert run(["demo-scene", "-o", str(folder / "room.ply"), "-q", *words]) == 0
    assert run(["import-splat", str(folder / "room.ply"), "-o", str(folder / "room.scene.npz"), "-q"]) == 0
    return folder


def align(demo, tmp_path, *words, output="m.scene.npz"):
    return run(["scale-align", str(demo / "room.scene.npz"), "-o", str(tmp_path / output), "-q", *words])


def error(capsys):
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    return lines[0]


def test_the_demo_is_aligned_by_its_colmap_model(demo, tmp_path, capfd):
    pytest.importorskip("pycolmap")
    words = ["--colmap", str(demo / "sparse"), "--reference", str(demo / "poses.csv"), "--max-rms", "0.01"]
    assert align(demo, tmp_path, *words) == 0
    assert capfd.readouterr() == ("", "")
    scene = read_artifact(tmp_path / "m.scene.npz", SCENE)
    found, truth = scene.manifest.world_from_scene, world_from_scene()
    assert found.scale == pytest.approx(truth.scale, rel=5e-4)
    np.testing.assert_allclose(found.rotation, truth.rotation, atol=1e-3)
    np.testing.assert_allclose(found.translation_m, truth.translation_m, atol=5e-3)
    np.testing.assert_allclose(np.asarray(scene["mean"]).max(axis=0), [8, 6, 3], atol=0.03)
    assert (scene.manifest.frame, scene.manifest.unit) == ("world", "m")
    roles = {ref.role for ref in scene.manifest.inputs}
    assert roles == {"scene", "reference", "colmap cameras", "colmap images", "colmap points3D"}
    assert scene.manifest.alignment["inliers"] == 58


def test_csv_cameras_do_the_same_and_repeat_to_the_byte(demo, tmp_path):
    words = ["--cameras", str(demo / "cameras.csv"), "--reference", str(demo / "poses.csv")]
    assert align(demo, tmp_path, *words) == 0
    assert align(demo, tmp_path, *words, "--jobs", "1", output="n.scene.npz") == 0
    assert (tmp_path / "m.scene.npz").read_bytes() == (tmp_path / "n.scene.npz").read_bytes()
    manifest = read_artifact(tmp_path / "m.scene.npz").manifest
    assert str(demo) not in json.dumps(manifest.alignment)


def test_the_table_goes_to_stderr_and_json_to_stdout(demo, tmp_path, capsys):
    words = ["scale-align", str(demo / "room.scene.npz"), "-o", str(tmp_path / "m.scene.npz")]
    words += ["--cameras", str(demo / "cameras.csv"), "--reference", str(demo / "poses.csv")]
    assert run(words) == 0
    out, err = capsys.readouterr()
    assert "poses.csv row 14 (walk_0012.jpg)  outlier" in err
    assert "position_error_m" in out
    assert run([*words, "-v", "-f", "--max-rms", "1"]) == 0
    assert "95 % interval" in capsys.readouterr().err
    assert run([*words, "--json", "--force"]) == 0
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert found["summary"]["inliers"] == found["alignment"]["inliers"] == 58
    assert len(found["alignment"]["items"]) == 60
    assert found["status"] == "written"
    assert run([*words, "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again == {**found, "status": "unchanged"}
    assert err == ""


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ([], 2, "exactly one of .* is needed, none was given"),
        (["--scale", "2", "--distance", "0 0 0", "1 0 0", "2"], 2, "not --distance and --scale"),
        (["--scale", "2", "--reference", "p.csv"], 2, "--reference and --poses need"),
        (["--cameras", "c.csv"], 2, "--reference and --poses need"),
        (["--scale", "2", "--max-rms", "1"], 2, "need measurements; a given similarity has none"),
        (["--scale", "nan"], 2, "is not finite"),
        (["--distance", "0 0", "1 0 0", "2"], 2, "'0 0 1 0 0 2' is not 7 numbers; write 7 words, or one in"),
        (["--correspondences", "none.csv"], 3, "cannot read"),
        (["--transform", "none.json"], 3, "cannot read"),
        (["--colmap", "none", "--reference", "none.csv"], 3, "is no COLMAP model: does not exist"),
    ],
)
def test_ways_to_ask_wrongly(demo, tmp_path, capsys, words, code, message):
    assert align(demo, tmp_path, *words) == code
    import re

    assert re.search(message, error(capsys))
    assert list(tmp_path.iterdir()) == []


def test_a_gate_that_does_not_hold_exits_4_and_writes_nothing(demo, tmp_path, capsys):
    words = ["--cameras", str(demo / "cameras.csv"), "--reference", str(demo / "poses.csv")]
    assert align(demo, tmp_path, *words, "--max-rms", "0.001") == 4
    assert "above --max-rms 0.001 m" in error(capsys)
    assert list(tmp_path.iterdir()) == []


def test_wrong_references_exit_3_and_name_the_row(demo, tmp_path, capsys):
    reference = tmp_path / "poses.csv"
    words = ["--cameras", str(demo / "cameras.csv"), "--reference", str(reference)]
    nowhere = "".join(f"nowhere{i}.jpg,1,2,{i}\n" for i in range(61))
    reference.write_text((demo / "poses.csv").read_text() + nowhere)
    assert align(demo, tmp_path, *words) == 3
    assert "poses.csv row 62 (nowhere0.jpg): no camera has an image of that name; 61 of 121 rows" in error(
        capsys
    )
    reference.write_bytes(b"\xff\xfe")
    assert align(demo, tmp_path, *words) == 3
    assert "is not text in UTF-8" in error(capsys)
    rows = (demo / "poses.csv").read_text().splitlines()
    mirrored = [rows[0]] + [",".join([a, "-" + x if x[0] != "-" else x[1:], y, z]) for a, x, y, z in
                            (row.split(",") for row in rows[1:])]  # fmt: skip
    reference.write_text("\n".join(mirrored))
    assert align(demo, tmp_path, *words) == 3
    assert "mirror images" in error(capsys)


def test_photographs_that_were_not_registered_are_skipped_and_counted(demo, tmp_path, capsys):
    reference = tmp_path / "poses.csv"
    reference.write_text((demo / "poses.csv").read_text() + "nowhere.jpg,1,2,3\n")
    words = ["--cameras", str(demo / "cameras.csv"), "--reference", str(reference)]
    assert align(demo, tmp_path, *words, "--min-matched", "0.99") == 3
    assert "1 of 61 rows name none, and 99% must name one (--min-matched)" in error(capsys)
    assert align(demo, tmp_path, *words) == 0
    found = read_artifact(tmp_path / "m.scene.npz").manifest.alignment
    assert found["count"] == 60
    assert found["unmatched"] == ["nowhere.jpg"]
    assert "1 of 61 rows were skipped: no camera has their image (nowhere.jpg)" in found["warnings"]


def test_pairs_distances_and_transforms_work(demo, tmp_path):
    rng = np.random.default_rng(0)
    source = rng.normal(size=(8, 3))
    rows = ["sx,sy,sz,wx,wy,wz", *(",".join(map(str, [*p, *(2 * p + 1)])) for p in source)]
    (tmp_path / "p.csv").write_text("\n".join(rows))
    assert align(demo, tmp_path, "--correspondences", str(tmp_path / "p.csv")) == 0
    assert read_artifact(tmp_path / "m.scene.npz").manifest.world_from_scene.scale == pytest.approx(2)
    words = ["--distance", "0 0 0", "1 0 0", "2.70", "--distance", "0,0,0", "0,0,-1", "2.72"]
    assert align(demo, tmp_path, *words, output="d.scene.npz") == 0
    manifest = read_artifact(tmp_path / "d.scene.npz").manifest
    assert manifest.world_from_scene.scale == pytest.approx(2.71)
    assert manifest.parameters["distances"][1] == [[0, 0, 0], [0, 0, -1], 2.72]
    (tmp_path / "t.json").write_text(
        '{"scale": 3, "rotation": [[1,0,0],[0,1,0],[0,0,1]], "translation_m": [0,0,1]}'
    )
    assert align(demo, tmp_path, "--transform", str(tmp_path / "t.json"), output="t.scene.npz") == 0
    again = ["scale-align", str(tmp_path / "t.scene.npz"), "-o", str(tmp_path / "u.scene.npz"), "-q"]
    assert run([*again, "--scale", "2"]) == 4
    assert run([*again, "--scale", "2", "--rescale"]) == 0
    assert read_artifact(tmp_path / "u.scene.npz").manifest.world_from_scene.scale == pytest.approx(6)


def test_the_demo_repeats_to_the_byte_and_knows_where_it_came_from(demo, tmp_path, capsys):
    output = str(tmp_path / "again.ply")
    words = ["demo-scene", "-o", output, "--gaussians", "4000", "--seed", "3"]
    assert run(words) == 0
    assert "2.3 1.6 1.25" in capsys.readouterr().out
    assert Path(output).read_bytes() == (demo / "room.ply").read_bytes()
    provenance = read_provenance(Path(output))
    assert (provenance.schema, provenance.seed) == ("alula/demo-scene", 3)
    assert run(words) == 0
    assert "unchanged" in capsys.readouterr().out
    assert run([*words, "--reference", str(tmp_path / "poses.csv")]) == 0
    assert (tmp_path / "poses.csv").read_bytes() == (demo / "poses.csv").read_bytes()
    assert run([*words, "--images", "10"]) == 2
    assert "images was 60, now 10" in capsys.readouterr().err
    scene = read_artifact(demo / "room.scene.npz").manifest
    assert [ref.schema for ref in scene.inputs] == ["alula/demo-scene"]
    assert scene.source["comments"] == []


def test_the_demo_refuses_equal_outputs_and_writes_nothing_when_dry(tmp_path, capsys):
    same = str(tmp_path / "a.ply")
    assert run(["demo-scene", "-o", same, "--cameras", same]) == 2
    assert "must be different files" in error(capsys)
    words = ["--gaussians", "2000", "--colmap", str(tmp_path / "sparse"), "-q"]
    assert run(["demo-scene", "-o", same, "-n", *words]) == 0
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "sparse").touch()
    assert run(["demo-scene", "-o", same, *words]) == 3
    assert "is a file, but --colmap is a folder" in error(capsys)


def test_import_names_the_file_and_the_reason(tmp_path, capsys, demo):
    bad = tmp_path / "cut.ply"
    bad.write_bytes((demo / "room.ply").read_bytes()[:-1])
    output = tmp_path / "s.scene.npz"
    assert run(["import-splat", str(bad), "-o", str(output)]) == 3
    assert f"alula: {bad}: PLY: truncated: 4000 rows of vertex need 272000 bytes" in error(capsys)
    assert run(["import-splat", str(demo / "room.ply"), "-o", str(output), "--min-opacity", "1"]) == 3
    assert f"{demo / 'room.ply'}: no Gaussian is left of 4000" in error(capsys)
    assert run(["import-splat", str(demo / "room.ply"), "-o", str(output), "--format", "obj"]) == 2
    assert not output.exists()


def test_import_filters_are_recorded(demo, tmp_path, capsys):
    output = tmp_path / "s.scene.npz"
    words = ["import-splat", str(demo / "room.ply"), "-o", str(output), "--json", "--crop"]
    box = ["-9", "-9", "-9", "9", "9", "0.5"]
    assert run([*words, *box, "--max-scale", "0.1", "--drop-floaters", "--min-opacity", "0.2"]) == 0
    summary = json.loads(capsys.readouterr().out)["summary"]
    manifest = read_artifact(output, SCENE).manifest
    assert manifest.parameters["crop"] == [float(x) for x in box]
    assert set(manifest.source["removed"]) == {"min_opacity", "crop", "max_scale", "floaters"}
    assert manifest.source["kept"] + sum(manifest.source["removed"].values()) == 4000
    assert summary["removed"] == manifest.source["removed"]


NOT_A_NUMBER_AND_THE_LIKE = {
    "nan-opacity-binary-le": "not_a_number",
    "out-of-range-double": "infinite_mean",
    "overflow-scale": "infinite_scale",
}


@pytest.mark.parametrize("name", NOT_A_NUMBER_AND_THE_LIKE)
def test_public_fixtures_with_unusable_rows(tmp_path, capsys, name):
    root = os.environ.get("ALULA_DATA")
    if not root:
        pytest.skip("ALULA_DATA is not set")
    path = Path(root) / f"usd3dgs-fixtures-ply/{name}.ply"
    assert run(["import-splat", str(path), "-o", str(tmp_path / "s.scene.npz")]) == 3
    why = NOT_A_NUMBER_AND_THE_LIKE[name]
    assert f"1 of 1 Gaussians have values that are not finite ({why} 1), the first in row 0" in error(capsys)
    assert run(["import-splat", str(path), "-o", str(tmp_path / "s.scene.npz"), "--drop-nan"]) == 3
    assert f"no Gaussian is left of 1: removed 1 by {why}" in error(capsys)


@pytest.mark.parametrize("command", ["demo-scene", "import-splat", "scale-align"])
def test_help_runs_without_heavy_imports(command):
    code = (
        "import sys; from alula.cli.main import run; code = run([sys.argv[1], '-h']);"
        "assert not {'scipy', 'pycolmap', 'open3d'} & set(sys.modules); sys.exit(code)"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", code, command], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "Examples:" in done.stdout
    assert done.stderr == ""
