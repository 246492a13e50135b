"""The numbers that guarantees and certificates state in words are those that the checks used."""

import numpy as np

from alula.cli.main import run
from alula.schemas.artifacts.artifact import make_artifact, write_artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.stages.compression.verify import verify
from alula.stages.compression.voxelize import voxelize
from support.scenes.covers import cover_of

CROP = (1000000.0, -1.0, -1.0, 1000005.4, 1.0, 1.0)
FAR_M = 1000005.9375  # outside of the crop, inside 1.00001e+06


def scene_at(*x, **fields):
    count = len(x)
    arrays = {
        "mean": np.column_stack([x, np.zeros((count, 2))]),
        "scale": np.full((count, 3), 0.125),
        "quat_wxyz": np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
        "opacity": np.ones(count),
        "color": np.zeros((count, 3)),
    }
    known = {"frame": "world", "unit": "m", "parameters": {}, "summary": {}, "source": {}}
    return make_artifact(SCENE, arrays, **known | fields)


def numbers_after(mark, text):
    """The numbers that follow a word, up to the first that is none."""
    found = []
    for word in text.partition(mark)[2].split():
        try:
            found.append(float(word))
        except ValueError:
            break
    return tuple(found)


def test_the_printed_crop_is_the_crop():
    scene = scene_at(1000004.0, FAR_M)
    voxels = voxelize(VoxelizeConfig(size_m=1.0, crop=CROP), scene)
    certificate = verify(cover_of(voxels), voxels=voxels, scene=scene)
    assert certificate.covered
    for text in (voxels.manifest.guarantee.statement, certificate.left_out):
        printed = numbers_after("the crop", text)
        assert printed == CROP
        assert not printed[0] <= FAR_M <= printed[3]  # the printed crop does not claim what is not covered


def test_the_printed_level_is_the_level():
    scene = scene_at(0.0)
    voxels = voxelize(VoxelizeConfig(size_m=1.0, sigma=0.9999996, inflation_m=0.0200000004), scene)
    certificate = verify(cover_of(voxels), voxels=voxels, scene=scene)
    assert certificate.covered
    assert "beyond 0.9999996 sigma" in certificate.left_out
    assert "the 0.9999996-sigma ellipsoid" in voxels.manifest.guarantee.statement
    assert "grown by 0.0200000004 m" in voxels.manifest.guarantee.statement


def test_a_bound_is_printed_rounded_up():
    voxels = voxelize(VoxelizeConfig(size_m=1.0, inflation_m=0.01), scene_at(0.0))
    scene = scene_at(0.0, suggested_inflation_m=0.123401)
    text = verify(cover_of(voxels), voxels=voxels, scene=scene).left_out
    assert "beyond 0.01 m, where it suggests 0.124 m" in text


def test_info_prints_all_digits_of_a_guarantee(tmp_path, capsys):
    voxels = voxelize(VoxelizeConfig(size_m=1.0, sigma=0.9999996, crop=CROP), scene_at(1000004.0))
    write_artifact(tmp_path / "a.voxels.npz", voxels)
    assert run(["info", str(tmp_path / "a.voxels.npz")]) == 0
    shown = capsys.readouterr().out
    claims = [line.split() for line in shown.splitlines() if "claims.crop" in line or "claims.sigma" in line]
    assert [tuple(map(float, words[1:])) for words in claims] == [CROP, (0.9999996,)]


def test_a_place_far_from_the_origin_can_be_found():
    voxels = voxelize(VoxelizeConfig(size_m=1.0, crop=CROP), scene_at(1000004.0))
    other = voxelize(VoxelizeConfig(size_m=1.0, crop=CROP), scene_at(1000002.0))
    words = verify(cover_of(other), voxels=voxels).complaint()
    assert "member is not an occupied voxel, hull 0 at (1000001.5, -0.5, -0.5) m" in words
