"""Loss of splat formats: ellipsoids grown by it contain those of the Gaussians before the loss."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from alula.schemas.artifacts.artifact import read_artifact, write_artifact
from alula.schemas.errors import ArtifactError, DamagedError
from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
from alula.schemas.parameters.configs.scale_align import ScaleAlignConfig
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.stages.alignment.scale_align import scale_align, scale_only
from alula.stages.clearance import path_clearance
from alula.stages.compression.ellipsoids import excluded_errors, unproven_voxels
from alula.stages.compression.voxelize import voxelize
from alula.stages.reconstruction.formats.splat import decode_splat
from alula.stages.reconstruction.formats.splats import Loss, Splats, loss_bound, rounded_up
from alula.stages.reconstruction.import_splat import import_splat
from alula.stages.rotation import matrix_from_quat_wxyz, multiply_quat_wxyz
from support.effort import examples

EMPTY = np.zeros((0, 3), np.int32)


def f32(*arrays):
    return tuple(np.ascontiguousarray(a, np.float32) for a in arrays)


def unit(rng, shape):
    v = rng.normal(size=shape)
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def gaussians(rng, count, size=0.3):
    return f32(
        rng.uniform(-1, 1, (count, 3)),
        10 ** rng.uniform(-3, np.log10(size), (count, 3)),
        unit(rng, (count, 4)),
    )


def losses(rng, count):
    """Bounds of which each may be zero."""
    largest = np.array([0.05, 0.2, 0.5]) * rng.integers(0, 2, (count, 3))
    return (rng.uniform(0, 1, (count, 3)) * largest).astype(np.float32)


def originals(rng, mean, scale, quat, loss):
    """Gaussians that may have become these, as far off as the bounds allow."""
    count = len(mean)
    angle = loss[:, 2, None] / 2.0
    turn = np.concatenate([np.cos(angle), np.sin(angle) * unit(rng, (count, 3))], axis=1)
    return (
        mean + loss[:, :1] * unit(rng, (count, 3)),
        scale * (1.0 + loss[:, 1:2] * rng.integers(0, 2, (count, 3))),
        multiply_quat_wxyz(turn, quat),
    )


def surface(rng, mean, scale, quat, k, count):
    """Points of each ellipsoid, shape (N, count, 3)."""
    axes = matrix_from_quat_wxyz(quat / np.linalg.norm(quat, axis=1, keepdims=True))
    local = unit(rng, (len(mean), count, 3)) * (k * scale)[:, None]
    return mean[:, None] + np.einsum("nij,ncj->nci", axes, local)


@settings(max_examples=examples(60), deadline=None)
@given(st.integers(0, 2**32), st.sampled_from([0.03, 0.1]), st.sampled_from([1.0, 2.5]))
def test_all_that_a_row_may_stand_for_is_marked(seed, g, k):
    rng = np.random.default_rng(seed)
    mean, scale, quat = gaussians(rng, 8)
    loss = losses(rng, 8)
    index, *_ = _core.voxelize(mean, scale, quat, k, g, loss=loss)
    marked = set(map(tuple, index.tolist()))
    for _ in range(5):
        points = surface(rng, *originals(rng, mean, scale, quat, loss), k, 200).reshape(-1, 3)
        assert set(map(tuple, np.floor(points / g).astype(int).tolist())) <= marked


@settings(max_examples=examples(150), deadline=None)
@given(st.integers(0, 2**32), st.sampled_from([0.0, 0.02]))
def test_the_growth_is_that_of_the_formula_and_no_more(seed, inflation):
    """Row by row: the voxels of level k (1 + e) and radius r + p + t k (1 + e) (max s - min s)."""
    rng = np.random.default_rng(seed)
    splats, loss, g, k = gaussians(rng, 1), losses(rng, 1), 0.05, 1.7
    position, relative, angle = (Fraction(float(v)) for v in loss[0])
    level = Fraction(k) * (1 + relative)
    semi = [Fraction(float(s)) for s in splats[1][0]]
    radius = Fraction(inflation) + position + angle * level * (max(semi) - min(semi))
    index, *_ = _core.voxelize(*splats, k, g, inflation, loss=loss)
    just, *_ = _core.voxelize(*splats, float(level), g, float(radius))
    above, *_ = _core.voxelize(*splats, float(level) * (1 + 1e-13), g, float(radius) * (1 + 1e-13) + 1e-18)
    found = set(map(tuple, index.tolist()))
    assert set(map(tuple, just.tolist())) <= found <= set(map(tuple, above.tolist()))
    tiles = [(tuple(lower), tuple(lower)) for lower in index[:5].tolist()]
    for tile in tiles:
        assert _core.voxelize(*splats, k, g, inflation, tile=tile, loss=loss)[0].tolist() == [list(tile[0])]


@settings(max_examples=examples(60), deadline=None)
@given(st.integers(0, 2**32))
def test_the_proof_grows_alike(seed):
    rng = np.random.default_rng(seed)
    splats, loss, g = gaussians(rng, 6), losses(rng, 6), 0.04
    index, *_ = _core.voxelize(*splats, 1.0, g, loss=loss)
    proof = _core.unproven_voxels(*splats, 1.0, g, 0.0, None, 1, index, loss=loss)
    assert proof[0] == 0
    bare, *_ = _core.voxelize(*splats, 1.0, g)
    lacking = _core.unproven_voxels(*splats, 1.0, g, 0.0, None, 1, bare, loss=loss)[0]
    assert (lacking > 0) or len(bare) == len(index) or not loss.any()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1e-9])
def test_a_loss_that_is_no_bound_is_refused(bad):
    splats = gaussians(np.random.default_rng(0), 3)
    loss = np.zeros((3, 3), np.float32)
    loss[1, 2] = bad
    for function in (
        lambda: _core.voxelize(*splats, 1.0, 0.1, loss=loss),
        lambda: _core.tiles_of(*splats, 1.0, 0.1, 0.0, None, 8, loss=loss),
        lambda: _core.unproven_voxels(*splats, 1.0, 0.1, 0.0, None, 1, EMPTY, loss=loss),
    ):
        with pytest.raises(ValueError, match="the loss of row 1"):
            function()
    with pytest.raises(ValueError, match="mean and loss"):
        _core.voxelize(*splats, 1.0, 0.1, loss=np.zeros((2, 3), np.float32))


def a_scene(mean, scale, quat, loss=None):
    splats = Splats(
        format="test",
        mean=mean,
        scale=scale,
        quat_wxyz=quat,
        opacity=np.full(len(mean), 0.8, np.float32),
        color=np.zeros((len(mean), 3), np.uint8),
        loss=loss,
    )
    scene = import_splat(ImportSplatConfig(), splats)
    return scale_align(ScaleAlignConfig(scale=1.0), scene, scale_only(1.0), 0)


def as_splat_file(mean, scale, quat):
    """The bytes that the reference writer of `.splat` makes: quaternions truncated to a byte."""
    raw = np.zeros(len(mean), [("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])
    raw["mean"], raw["scale"], raw["rgba"] = mean, scale, 200
    raw["quat"] = np.clip(np.floor(quat * 128.0 + 128.0), 0, 255)
    return memoryview(raw.tobytes())


def test_voxels_of_a_lossy_file_contain_the_scene_it_was_made_from():
    """The guarantee speaks of the original: its ellipsoids are proven to lie in the voxels of the copy."""
    mean, scale, quat = gaussians(np.random.default_rng(5), 400, size=0.5)
    original = a_scene(mean, scale, quat)
    decoded = decode_splat(as_splat_file(mean, scale, quat))
    copy = scale_align(
        ScaleAlignConfig(scale=1.0), import_splat(ImportSplatConfig(), decoded), scale_only(1.0), 0
    )
    voxels = voxelize(VoxelizeConfig(size_m=0.02), copy)
    assert unproven_voxels(original, voxels["index"], voxel_size_m=0.02, sigma=1.0).total == 0
    assert unproven_voxels(copy, voxels["index"], voxel_size_m=0.02, sigma=1.0).total == 0
    assert "all that the splat file's format may have lost" in voxels.manifest.guarantee.statement
    assert voxels.manifest.guarantee.claims["splat_loss"]["rotation_rad"] > 0.03

    bare = voxelize(VoxelizeConfig(size_m=0.02, ignore_loss=True), copy)
    assert unproven_voxels(original, bare["index"], voxel_size_m=0.02, sigma=1.0).total > 0
    assert unproven_voxels(copy, bare["index"], voxel_size_m=0.02, sigma=1.0).total > 0
    assert unproven_voxels(copy, bare["index"], voxel_size_m=0.02, sigma=1.0, ignore_loss=True).total == 0
    assert "rotation_rad 0.0315" in bare.manifest.guarantee.statement
    assert bare.manifest.ignore_loss
    tiled = voxelize(VoxelizeConfig(size_m=0.02), copy, tile_m=0.3, jobs=2)
    np.testing.assert_array_equal(tiled["index"], voxels["index"])
    np.testing.assert_array_equal(tiled["overlap"], voxels["overlap"])


@pytest.mark.parametrize("far", [0.0, 1e6])
def test_the_alignment_scales_the_loss_of_centres_and_adds_its_own_rounding(far):
    rng = np.random.default_rng(1)
    loss = Loss(losses(rng, 9) + np.float32(0.01), 0.0)
    scene = a_scene(*gaussians(rng, 9), loss)
    similarity = scale_only(3.3)
    similarity.translation_m[0] = far + 1 / 3
    again = scale_align(ScaleAlignConfig(rescale=True, map_origin=(0.0, 0.0, 0.0)), scene, similarity, 0)
    exact = 3.3 * scene["mean"].astype(float) + [far + 1 / 3, 0, 0]
    moved = np.linalg.norm(again["mean"] - exact, axis=1)
    least = 3.3 * loss.bound[:, 0].astype(float) + moved
    assert (again["loss"][:, 0] >= least).all()
    np.testing.assert_allclose(again["loss"][:, 0], least, rtol=1e-6)
    shorter = (1 + again["loss"][:, 1:2].astype(float)) * again["scale"]  # than the longest true ones, never
    assert (shorter >= 3.3 * scene["scale"] * (1 + loss.bound[:, 1:2].astype(float))).all()
    assert (again["loss"][:, 2] >= loss.bound[:, 2].astype(float) + 2.0**-23).all()
    np.testing.assert_allclose(again["loss"][:, 1:], loss.bound[:, 1:], rtol=2e-5, atol=5e-7)
    assert again.manifest.requires == ["splat-loss"]
    assert again.manifest.arrays["loss"].unit == "m, 1, rad"


def test_a_loss_without_bound_stays_in_the_words():
    loss = Loss(loss_bound(4, scale=0.01), 0.004, {"scale": "a codebook that nothing bounds"})
    scene = a_scene(*gaussians(np.random.default_rng(1), 4), loss)
    words = excluded_errors(scene.manifest, 0.0)
    assert any("a codebook that nothing bounds" in w for w in words)
    assert not any("scale_relative" in w for w in words)
    assert any("scale_relative 0.01" in w for w in excluded_errors(scene.manifest, 0.0, ignore_loss=True))


def test_a_scene_file_keeps_the_loss_and_says_so(tmp_path):
    scene = a_scene(*gaussians(np.random.default_rng(1), 4), Loss(loss_bound(4, rotation=0.1)))
    path = tmp_path / "a.scene.npz"
    write_artifact(path, scene)
    np.testing.assert_array_equal(read_artifact(path)["loss"], scene["loss"])
    hidden = path.read_bytes().replace(b'"splat-loss"', b'"splat-lost"')
    path.write_bytes(hidden)
    with pytest.raises((ArtifactError, DamagedError)):
        read_artifact(path)


@settings(max_examples=examples(30), deadline=None)
@given(st.integers(0, 2**32))
def test_no_clearance_exceeds_that_of_what_a_row_may_stand_for(seed):
    rng = np.random.default_rng(seed)
    mean, scale, quat = gaussians(rng, 8)
    loss = losses(rng, 8)
    path = rng.uniform(-2, 2, (20, 3))
    grown = path_clearance(path, _core.EllipsoidSet(mean, scale, quat, 1.5, loss))
    for _ in range(10):
        original = f32(*originals(rng, mean, scale, quat, loss))
        assert (grown <= path_clearance(path, _core.EllipsoidSet(*original, 1.5)) + 1e-6).all()
    plain = path_clearance(path, _core.EllipsoidSet(mean, scale, quat, 1.5))
    semi = 1.5 * (1 + loss[:, 1]) * scale.max(axis=1)
    most = (loss[:, 0] + loss[:, 2] * semi + 1.5 * loss[:, 1] * scale.max(axis=1)).max()
    assert (plain - grown <= most + 1e-6).all()
    zero = np.zeros_like(loss)
    np.testing.assert_allclose(
        path_clearance(path, _core.EllipsoidSet(mean, scale, quat, 1.5, zero)), plain, rtol=0, atol=1e-13
    )


def test_rounding_up_beyond_single_precision_is_infinite_without_a_warning() -> None:
    large, small, zero = rounded_up([1e300, 0.1, 0.0])
    assert large == np.inf
    assert 0.1 <= float(small) < 0.1 * (1 + 2**-22)
    assert zero == 0
