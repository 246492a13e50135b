"""Errors of integers and nodes of glTF never exceed the recorded bounds."""

import dataclasses

import numpy as np
import pytest

from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
from alula.schemas.parameters.configs.scale_align import ScaleAlignConfig
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.stages.alignment.scale_align import scale_align, scale_only
from alula.stages.compression.ellipsoids import unproven_voxels
from alula.stages.compression.voxelize import voxelize
from alula.stages.reconstruction.formats.registry import read_splats
from alula.stages.reconstruction.import_splat import import_splat
from alula.stages.rotation import matrix_from_quat_wxyz, multiply_quat_wxyz
from support.files.gltf_files import CODES, ROUNDINGS, Writer, angles, gaussians


@pytest.fixture
def read(tmp_path):
    def read(raw, name="a.glb"):
        (tmp_path / name).write_bytes(raw)
        return read_splats(tmp_path / name)

    return read


@pytest.mark.parametrize("rounding", ROUNDINGS)
@pytest.mark.parametrize("kind", ["i8n", "i16n"])
def test_rotations_are_lost_by_no_more_than_recorded(read, kind, rounding):
    scene = gaussians(20_000)
    writer = Writer()
    writer.node(mesh=writer.mesh(**scene, kinds={"ROTATION": kind}, rounding=ROUNDINGS[rounding]))
    splats = read(writer.glb())
    angle = angles(splats.quat_wxyz, scene["quat_wxyz"])
    assert (angle <= splats.loss.bound[:, 2] + 1e-7).all()
    assert (angle / splats.loss.bound[:, 2]).max() > 0.3


@pytest.mark.parametrize("rounding", ROUNDINGS)
@pytest.mark.parametrize("kind", ["u8n", "u16n", "u8", "u16", "i8", "i8n", "i16", "i16n"])
def test_scales_are_lost_by_no_more_than_recorded(read, kind, rounding):
    scene = gaussians(20_000)
    rng = np.random.default_rng(1)
    logarithms = kind.startswith("i")
    if logarithms:
        stored = rng.uniform(-1, 0.9, (20_000, 3)) if kind.endswith("n") else rng.uniform(-9, 3, (20_000, 3))
        true = np.exp(stored)
    else:
        true = stored = scene["scale"].astype(np.float64) * (1 if kind.endswith("n") else 100)
    scene["scale"] = stored
    writer = Writer()
    writer.node(mesh=writer.mesh(**scene, kinds={"SCALE": kind}, rounding=ROUNDINGS[rounding]))
    splats = read(writer.glb())
    grown = splats.scale.astype(np.float64) * (1 + splats.loss.bound[:, 1:2].astype(np.float64))
    assert (true <= grown * (1 + 1e-7)).all()
    step = 1 / CODES[kind.removesuffix("n")][2] + 2**-23 if kind.endswith("n") else 1
    if logarithms:
        assert splats.loss.bound[0, 1] == pytest.approx(np.expm1(step))
        assert any("logarithms" in note for note in splats.notes)
        assert ((true / splats.scale - 1) / splats.loss.bound[:, 1:2]).max() > (
            0.3 if rounding != "raised" else -1
        )
    else:
        assert (grown <= (true + 2 * step) * (1 + 1e-6)).all()
        assert (splats.scale <= true + step * (1 + 1e-5) + 1e-7).all() or rounding in ("raised", "rounded")


def test_the_largest_code_is_no_bound(read):
    scene = gaussians()
    scene["scale"][3] = 2.0
    writer = Writer()
    writer.node(mesh=writer.mesh(**scene, kinds={"SCALE": "u8n"}))
    assert read(writer.glb()).loss.unbounded == {"scale": "1 rows hold the largest code there is"}


@pytest.mark.parametrize(("kind", "loss"), [("u8n", 1 / 255), ("u16n", 1 / 65535)])
def test_the_opacity_is_lost_by_no_more_than_recorded(read, kind, loss):
    scene = gaussians(5000)
    for rounding in ROUNDINGS.values():
        writer = Writer()
        writer.node(mesh=writer.mesh(**scene, kinds={"OPACITY": kind}, rounding=rounding))
        splats = read(writer.glb())
        assert splats.loss.opacity == pytest.approx(loss + 2**-23)
        off = np.abs(splats.opacity.astype(np.float64) - scene["alpha"][:, 0]).max()
        assert 0.3 * loss < off <= loss + 6e-8


@pytest.mark.parametrize("kind", ["i16n", "u16n", "u8n"])
def test_the_bound_holds_for_centres_just_below_a_code(read, kind):
    """A whole step is lost there, and what single precision rounds comes on top."""
    scene = gaussians(5000)
    largest = CODES[kind.removesuffix("n")][2]
    codes = np.random.default_rng(3).integers(largest // 2, largest, (5000, 1)) * [1, 1, 1]
    scene["mean"] = np.nextafter(codes / largest, 0)
    writer = Writer()
    writer.tree["extensionsRequired"] = ["KHR_mesh_quantization"]
    writer.node(mesh=writer.mesh(**scene, kinds={"POSITION": kind}, rounding=np.trunc))
    splats = read(writer.glb())
    off = np.linalg.norm(splats.mean.astype(np.float64) - scene["mean"], axis=1)
    assert (off <= splats.loss.bound[:, 0]).all()
    assert (off / splats.loss.bound[:, 0]).max() > 0.99


@pytest.mark.parametrize("kind", ["i8n", "u16", "i16"])
def test_quantised_positions_are_lost_by_no_more_than_recorded(read, kind):
    scene = gaussians(5000)
    factor = 0.2 if kind.endswith("n") else 100
    scene["mean"] = np.abs(scene["mean"]) * factor
    writer = Writer()
    writer.tree["extensionsRequired"] = ["KHR_mesh_quantization"]
    writer.node(mesh=writer.mesh(**scene, kinds={"POSITION": kind}, rounding=np.trunc), scale=[0.5] * 3)
    splats = read(writer.glb())
    off = np.linalg.norm(splats.mean - scene["mean"].clip(0, 1 if kind.endswith("n") else None) * 0.5, axis=1)
    assert (off <= splats.loss.bound[:, 0]).all()
    assert off.max() > 0.3 * splats.loss.bound[:, 0].max()


def test_a_matrix_that_is_nearly_rigid_is_within_its_bound(read):
    """The grown ellipsoid holds the exact image: its support function is nowhere smaller."""
    scene = gaussians(2000)
    shear = np.eye(3) + 3e-6 * np.array([[1, 1, 0], [1, -1, 1], [0, 1, 0.5]])
    matrix = np.eye(4)
    matrix[:3, :3] = shear @ matrix_from_quat_wxyz(np.array([0.8, 0, 0.6, 0]))
    writer = Writer()
    writer.node(mesh=writer.mesh(**scene), matrix=matrix.T.ravel().tolist())
    splats = read(writer.glb())
    rng = np.random.default_rng(2)
    normals = rng.normal(size=(64, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)

    def support(linear, quat, scale):
        quat = quat.astype(np.float64)
        quat /= np.linalg.norm(quat, axis=1, keepdims=True)
        half = linear @ (matrix_from_quat_wxyz(quat) * scale[:, None, :].astype(np.float64))
        return np.linalg.norm(np.einsum("kj,nji->nki", normals, half), axis=2)

    true = support(matrix[:3, :3], scene["quat_wxyz"], scene["scale"])
    _, e, t = splats.loss.bound.astype(np.float64).T
    grown = splats.scale * (1 + e[:, None])
    room = t * (grown.max(axis=1) - grown.min(axis=1))
    assert (true <= support(np.eye(3), splats.quat_wxyz, grown) + room[:, None]).all()


def test_voxels_of_quantised_gaussians_hold_the_originals(read):
    scene = gaussians(120, seed=4)
    scene["mean"] *= 0.3
    writer = Writer()
    kinds = {"SCALE": "u8n", "ROTATION": "i8n", "OPACITY": "u8n"}
    turn = np.array([0.6, 0.0, 0.8, 0.0])
    mesh = writer.mesh(**scene, kinds=kinds, rounding=np.trunc)
    writer.node(mesh=mesh, rotation=turn[[1, 2, 3, 0]].tolist(), translation=[1, 0, 0])
    copy = read(writer.glb())
    original = dataclasses.replace(
        copy,
        mean=(scene["mean"].astype(np.float64) @ matrix_from_quat_wxyz(turn).T + [1, 0, 0]).astype(
            np.float32
        ),
        scale=scene["scale"],
        quat_wxyz=multiply_quat_wxyz(turn, scene["quat_wxyz"]).astype(np.float32),
        opacity=scene["alpha"][:, 0],
        loss=None,
    )
    config = {"voxel_size_m": 0.02, "sigma": 1.0}
    for ignore, some in ((False, False), (True, True)):
        voxels = voxelize(VoxelizeConfig(size_m=0.02, ignore_loss=ignore), metric(copy))
        assert bool(unproven_voxels(metric(original), voxels["index"], **config).total) == some


def metric(splats):
    scene = import_splat(ImportSplatConfig(min_opacity=0.0), splats)
    return scale_align(ScaleAlignConfig(scale=1.0), scene, scale_only(1.0), 0)
