"""SOG: a test encoder with the rounding of known writers, and real scenes."""

import io
import json
import types
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from alula.cli import main
from alula.schemas.artifacts.artifact import read_artifact
from alula.stages.reconstruction.formats.registry import SplatFile, read_splats
from alula.stages.reconstruction.formats.sog import OPACITY_LOSS
from alula.stages.reconstruction.formats.splats import color_from_sh0
from support.files.originals import angles, fractions, originals
from support.files.sog_encoder import ROUNDINGS, bundle, changed, encode, folder, webp


@pytest.mark.parametrize("rounding", ROUNDINGS)
@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("span", [0.5, 20.0, 1000.0])
def test_no_original_is_farther_than_the_bound(tmp_path, version, rounding, span):
    scene = originals(6000, seed=version, span=span, spread=1.0)
    splats = read_splats(folder(tmp_path / "a", encode(scene, version, rounding)))
    if version == 2:  # what lies above the largest entry has no bound
        top = (splats.scale == splats.scale.max()).any(axis=1)
        scene.log_scale[top] = np.minimum(scene.log_scale[top], np.log(splats.scale[top].astype(float)))
    used = fractions(scene, splats)
    assert max(used) <= 1
    if rounding == "truncating":
        assert min(used) > 0.6, used
    assert ("scale" in splats.loss.unbounded) == (version == 2)


@pytest.mark.parametrize("rounding", ROUNDINGS)
@pytest.mark.parametrize("centre", [0.0, 100.0, 5000.0, 300_000.0])
def test_writers_in_single_precision_stay_within_the_bound(tmp_path, rounding, centre):
    """Far from the origin a unit in the last place of the logarithm is many codes."""
    scene = originals(6000, seed=3, span=5.0)
    scene.mean = (scene.mean + centre).astype(np.float32).astype(np.float64)
    splats = read_splats(folder(tmp_path / "a", encode(scene, 2, rounding, number=np.float32)))
    position, _, rotation = fractions(scene, splats)
    assert max(position, rotation) <= 1
    assert position > 0.1


def test_gaussians_with_the_largest_entry_are_counted(tmp_path):
    scene = originals(1000, spread=1.0)
    splats = read_splats(folder(tmp_path / "a", encode(scene)))
    count = int((splats.scale == splats.scale.max()).any(axis=1).sum())
    assert f"for the {count} Gaussians with the largest entry" in splats.loss.unbounded["scale"]


@pytest.mark.parametrize("compression", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("bands", [0, 1, 2, 3])
def test_all_containers_hold_the_same(tmp_path, version, bands, compression):
    files = encode(originals(500), version, bands=bands, model="2dgs")
    there = folder(tmp_path / "a", files)
    packed = bundle(tmp_path / "a.sog", files, compression)
    names = set(files)
    found = [read_splats(path) for path in (there, there / "meta.json", packed)]
    for other in found[1:]:
        for name in ("mean", "scale", "quat_wxyz", "opacity", "color"):
            np.testing.assert_array_equal(getattr(found[0], name), getattr(other, name))
        np.testing.assert_array_equal(found[0].loss.bound, other.loss.bound)
    for path in (there, there / "meta.json"):
        roles = SplatFile.find(path).files()
        assert roles["splat"] == there / "meta.json"
        assert {file.name for file in roles.values()} == names
    assert SplatFile.find(packed).files() == {"splat": packed}
    assert found[0].tags["render_mode"] == "2dgs"


@pytest.mark.parametrize("count", [1, 3, 16, 17, 300_000])
def test_any_number_of_gaussians(tmp_path, count):
    scene = originals(count, seed=5)
    seen = []
    found = SplatFile.find(folder(tmp_path / "a", encode(scene, 1)))
    splats = found.decode(lambda done, total: seen.append((done, total)))
    assert len(splats) == count
    assert seen[-1] == (count, count)
    off = np.linalg.norm(splats.mean.astype(float) - scene.mean, axis=1)
    assert (off <= splats.loss.bound[:, 0]).all()


def test_invisible_gaussians_keep_their_codes(tmp_path):
    scene = originals(300)
    scene.alpha[:] = 0
    splats = read_splats(folder(tmp_path / "a", encode(scene)))
    assert not splats.opacity.any()
    assert np.abs(splats.color.astype(int) - color_from_sh0(scene.sh0)).max() <= 12


def test_colours_and_alpha(tmp_path):
    scene = originals(2000)
    for version in (1, 2):
        splats = read_splats(folder(tmp_path / str(version), encode(scene, version)))
        assert np.abs(splats.color.astype(int) - color_from_sh0(scene.sh0)).max() <= 12
        assert np.abs(splats.opacity - scene.alpha).max() <= splats.loss.opacity + 1e-7
        assert splats.loss.opacity == OPACITY_LOSS or version == 1


def test_rows_without_a_rotation_may_have_any(tmp_path):
    files = encode(originals(16), width=4)
    codes = np.full((16, 4), 255, np.uint8)
    codes[5, 3] = 251
    splats = read_splats(folder(tmp_path / "a", files | {"quats.webp": webp(codes, 4)}))
    np.testing.assert_array_equal(splats.quat_wxyz[5], [1, 0, 0, 0])
    assert splats.loss.bound[5, 2] >= np.pi > splats.loss.bound[4, 2]
    assert splats.notes[0].startswith("1 rows without a rotation")


def test_a_first_entry_of_null_is_extrapolated(tmp_path):
    files = encode(originals(500))
    table = json.loads(files["meta.json"])["scales"]["codebook"]
    exact = read_splats(folder(tmp_path / "a", files))
    early = read_splats(folder(tmp_path / "b", changed(files, scales__codebook=[None, *table[1:]])))
    first = np.exp(table[1] + (table[1] - table[255]) / 255)
    expected = np.where(exact.scale == np.float32(np.exp(table[0])), np.float32(first), exact.scale)
    np.testing.assert_allclose(early.scale, expected, rtol=1e-6)
    assert early.notes == ("the first entry of scales.codebook is null and was extrapolated",)


def test_a_table_of_one_value_loses_nothing(tmp_path):
    scene = originals(50, spread=0)
    splats = read_splats(folder(tmp_path / "a", encode(scene)))
    assert splats.loss.bound[:, 1].max() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("version", [1, 2])
def test_gsply_reads_the_same(tmp_path, monkeypatch, version):
    sog_reader = pytest.importorskip("gsply.sog_reader")

    def pixels(raw):
        return np.asarray(Image.open(io.BytesIO(raw)).convert("RGBA"))

    monkeypatch.setattr(sog_reader, "imagecodecs", types.SimpleNamespace(webp_decode=pixels))
    path = folder(tmp_path / "a", encode(originals(2000), version, bands=1))
    same_as_gsply(read_splats(path), sog_reader.sogread(path))


def same_as_gsply(ours, theirs):
    np.testing.assert_allclose(ours.mean, theirs.means, rtol=2e-5, atol=2e-6)
    np.testing.assert_allclose(np.log(ours.scale), theirs.scales, atol=4e-6)
    np.testing.assert_allclose(ours.quat_wxyz, theirs.quats, atol=2e-6)
    np.testing.assert_allclose(ours.opacity, 1 / (1 + np.exp(-theirs.opacities)), atol=5e-5)
    assert np.abs(ours.color.astype(int) - color_from_sh0(theirs.sh0)).max() <= 1


REAL = {
    "cc0-corpus/leica-sofort-top8192.sog": (8_192, [-15.020, -10.419, 1.454], [16.257, 16.552, 24.487]),
    "playbot-lod-sog/2_0": (125_000, [-1.029, -1.082, -1.035], [1.032, 0.047, 1.037]),
    "playbot-lod-sog/3_0": (31_000, [-1.027, -1.082, -1.034], [1.030, 0.044, 1.037]),
    "playbot-lod-sog/4_0": (8_406, [-1.025, -1.081, -1.034], [1.027, 0.037, 1.033]),
    "playbot-lod-sog/6_0": (1_873, [-1.023, -1.075, -1.024], [1.023, 0.038, 1.029]),
    "playbot-lod-sog/5_0": (3_000, [-1.024, -1.078, -1.029], [1.027, 0.036, 1.029]),
    "playcanvas-logo-sog-v1": (307_128, [-1.535, -2.782, -0.577], [1.535, 0.296, 0.577]),
}


@pytest.mark.every(4)
@pytest.mark.parametrize("name", REAL)
def test_real_scenes_have_their_counts_and_bounds(data, monkeypatch, name):
    count, lower, upper = REAL[name]
    splats = read_splats(data / name)
    assert len(splats) == count
    np.testing.assert_allclose(splats.mean.min(axis=0), lower, atol=1.1e-3)
    np.testing.assert_allclose(splats.mean.max(axis=0), upper, atol=1.1e-3)
    assert np.isfinite(splats.loss.bound).all()
    assert not splats.notes
    sog_reader = pytest.importorskip("gsply.sog_reader")
    pixels = types.SimpleNamespace(
        webp_decode=lambda raw: np.asarray(Image.open(io.BytesIO(raw)).convert("RGBA"))
    )
    monkeypatch.setattr(sog_reader, "imagecodecs", pixels)
    same_as_gsply(splats, sog_reader.sogread(data / name))


def test_each_level_of_the_robot_fills_the_box_of_the_index(data):
    index = json.loads((data / "playbot-lod-sog/lod-meta.json").read_text())
    box = index["tree"]["bound"]
    splats = read_splats(data / "playbot-lod-sog/2_0")
    assert (splats.mean >= np.array(box["min"]) - 1e-3).all()
    assert (splats.mean <= np.array(box["max"]) + 1e-3).all()


def test_a_real_scene_is_within_the_bound_of_its_ply(data):
    from scipy.spatial import cKDTree

    exact = read_splats(data / "cc0-corpus/leica-sofort-top8192.ply")
    lossy = read_splats(data / "cc0-corpus/leica-sofort-top8192.sog")
    away, row = cKDTree(exact.mean.astype(float)).query(lossy.mean.astype(float))
    assert len(np.unique(row)) == 8192
    bound = lossy.loss.bound.astype(float)
    assert (away <= bound[:, 0]).all()
    assert away.max() < 1.6e-3
    longer = (exact.scale[row].astype(float) / lossy.scale - 1).max(axis=1)
    largest = (lossy.scale == lossy.scale.max()).any(axis=1)
    assert (longer <= bound[:, 1])[~largest].all()
    turn = angles(lossy.quat_wxyz, exact.quat_wxyz[row].astype(float))
    assert (turn <= bound[:, 2] + 4e-7).all()
    assert min(away.max() / bound[:, 0].max(), turn.max() / bound[:, 2].max()) > 0.3
    assert np.abs(lossy.opacity - exact.opacity[row]).max() <= lossy.loss.opacity + 1e-6


def test_every_file_is_an_input_of_the_scene(tmp_path):
    there = folder(tmp_path / "a", encode(originals(300, span=3, spread=0.2)))
    out, world, voxels = (str(tmp_path / name) for name in ("s.scene.npz", "w.scene.npz", "v.voxels.npz"))
    assert main.run(["import-splat", str(there), "-o", out, "-q"]) == 0
    scene = read_artifact(Path(out))
    assert len(scene.manifest.inputs) == 6
    assert scene.arrays["loss"][:, 1].max() > 0
    assert "is not certain" in scene.manifest.guarantee.statement
    assert main.run(["scale-align", out, "--scale", "1", "-o", world, "-q"]) == 0
    assert main.run(["voxelize", world, "-o", voxels, "-q"]) == 0
    assert len(read_artifact(Path(voxels)).arrays["index"]) > 0


def test_the_map_of_a_real_scene_holds_that_of_its_ply(tmp_path, data):
    voxels = []
    for end in ("ply", "sog"):
        names = [str(tmp_path / f"{end}.{kind}.npz") for kind in ("scene", "world", "voxels")]
        splat = str(data / f"cc0-corpus/leica-sofort-top8192.{end}")
        assert main.run(["import-splat", splat, "-o", names[0], "-q"]) == 0
        assert main.run(["scale-align", names[0], "--scale", "1", "-o", names[1], "-q"]) == 0
        assert main.run(["voxelize", names[1], "--size", "0.2", "-o", names[2], "-q"]) == 0
        voxels.append({tuple(row) for row in read_artifact(Path(names[2])).arrays["index"]})
    exact, lossy = voxels
    assert exact < lossy
