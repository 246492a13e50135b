"""glTF with KHR_gaussian_splatting: accessors, nodes, dialects of scale, losses, and what is refused."""

import base64
import dataclasses
import json
import os
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.cli.main import run
from alula.schemas.artifact import read_artifact
from alula.schemas.configs.import_splat import ImportSplatConfig
from alula.schemas.configs.scale_align import ScaleAlignConfig
from alula.schemas.configs.voxelize import VoxelizeConfig
from alula.schemas.errors import AlulaError, ArtifactError
from alula.stages.alignment.scale_align import scale_align, scale_only
from alula.stages.compression.ellipsoids import unproven_voxels
from alula.stages.compression.voxelize import voxelize
from alula.stages.reconstruction.formats.registry import SplatFile, read_splats
from alula.stages.reconstruction.formats.splats import color_from_sh0
from alula.stages.reconstruction.import_splat import import_splat, turned
from alula.stages.rotation import matrix_from_quat_wxyz, multiply_quat_wxyz

KHR = "KHR_gaussian_splatting"
CODES = {
    "i8": (5120, "i1", 127),
    "u8": (5121, "u1", 255),
    "i16": (5122, "<i2", 32767),
    "u16": (5123, "<u2", 65535),
}
ROUNDINGS = {"rounded": np.rint, "truncated": np.trunc, "floored": np.floor, "raised": np.ceil}


def encoded(values, kind, rounding=np.rint):
    """Stored numbers and the accessor's component type, as a writer of that kind makes them."""
    if kind == "f32":
        return np.asarray(values, "<f4"), {"componentType": 5126}
    code, dtype, largest = CODES[kind.removesuffix("n")]
    exact = np.asarray(values, np.float64) * (largest if kind.endswith("n") else 1)
    info = np.iinfo(dtype)
    extra = {"normalized": True} if kind.endswith("n") else {}
    return np.clip(rounding(exact), info.min, info.max).astype(dtype), {"componentType": code, **extra}


class Writer:
    """A glTF file being made."""

    def __init__(self):
        self.binary = bytearray()
        self.tree = {
            "asset": {"version": "2.0", "generator": "test"}, "extensionsUsed": [KHR], "scene": 0,
            "scenes": [{"nodes": []}], "nodes": [], "meshes": [], "accessors": [], "bufferViews": [],
        }  # fmt: skip

    def view(self, raw, stride=None):
        self.binary += bytes(-len(self.binary) % 4)
        self.tree["bufferViews"].append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(raw)})
        if stride:
            self.tree["bufferViews"][-1]["byteStride"] = stride
        self.binary += raw
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, values, kind="f32", rounding=np.rint, pad=0, offset=0):
        stored, form = encoded(values, kind, rounding)
        stored = stored.reshape(len(stored), -1)
        size = stored[:1].nbytes
        rows = np.zeros((len(stored), size + pad), np.uint8)
        rows[:, :size] = np.ascontiguousarray(stored).view(np.uint8).reshape(len(stored), size)
        view = self.view(b"\xaa" * offset + rows.tobytes(), size + pad if pad else None)
        kinds = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
        self.tree["accessors"].append(
            {
                "bufferView": view,
                "byteOffset": offset,
                "count": len(stored),
                "type": kinds[stored.shape[1]],
                **form,
            }
        )
        return len(self.tree["accessors"]) - 1

    def mesh(self, mean, quat_wxyz, scale, alpha, sh0, kinds=(), rounding=np.rint, **layout):
        kinds = {"POSITION": "f32", "ROTATION": "f32", "SCALE": "f32", "OPACITY": "f32"} | dict(kinds)
        columns = {
            "POSITION": mean, f"{KHR}:ROTATION": np.asarray(quat_wxyz)[:, [1, 2, 3, 0]],
            f"{KHR}:SCALE": scale, f"{KHR}:OPACITY": alpha, f"{KHR}:SH_DEGREE_0_COEF_0": sh0,
        }  # fmt: skip
        attributes = {
            name: self.accessor(values, kinds.get(name.removeprefix(KHR + ":"), "f32"), rounding, **layout)
            for name, values in columns.items()
        }
        self.tree["meshes"].append(
            {
                "primitives": [
                    {"mode": 0, "attributes": attributes, "extensions": {KHR: {"kernel": "ellipse"}}}
                ]
            }
        )
        return len(self.tree["meshes"]) - 1

    def node(self, root=True, **fields):
        self.tree["nodes"].append(fields)
        if root:
            self.tree["scenes"][0]["nodes"].append(len(self.tree["nodes"]) - 1)
        return len(self.tree["nodes"]) - 1

    def glb(self):
        text = json.dumps(self.tree | {"buffers": [{"byteLength": len(self.binary)}]}).encode()
        text += b" " * (-len(text) % 4)
        binary = bytes(self.binary) + bytes(-len(self.binary) % 4)
        length = 12 + 8 + len(text) + 8 + len(binary)
        chunks = (
            struct.pack("<2I", len(text), 0x4E4F534A) + text + struct.pack("<2I", len(binary), 0x004E4942)
        )
        return b"glTF" + struct.pack("<2I", 2, length) + chunks + binary

    def gltf(self, uri=None):
        uri = uri or "data:application/octet-stream;base64," + base64.b64encode(self.binary).decode()
        return json.dumps(self.tree | {"buffers": [{"byteLength": len(self.binary), "uri": uri}]}).encode()


def gaussians(count=50, seed=0):
    rng = np.random.default_rng(seed)
    quat = rng.normal(size=(count, 4))
    return {
        "mean": rng.normal(size=(count, 3)).astype(np.float32),
        "quat_wxyz": (quat / np.linalg.norm(quat, axis=1, keepdims=True)).astype(np.float32),
        "scale": np.exp(rng.normal(-3, 1, size=(count, 3))).clip(0, 0.95).astype(np.float32),
        "alpha": rng.uniform(size=(count, 1)).astype(np.float32),
        "sh0": rng.normal(size=(count, 3)).astype(np.float32),
    }


@pytest.fixture
def read(tmp_path):
    def read(raw, name="a.glb"):
        (tmp_path / name).write_bytes(raw)
        return read_splats(tmp_path / name)

    return read


def simple(**fields):
    writer = Writer()
    writer.node(mesh=writer.mesh(**gaussians()), **fields)
    return writer


@pytest.mark.parametrize("layout", [{}, {"pad": 4, "offset": 8}, {"pad": 1}])
def test_single_precision_is_read_exactly_from_any_layout(read, layout):
    scene = gaussians()
    writer = Writer()
    writer.node(mesh=writer.mesh(**scene, **layout))
    for name, raw in {"a.glb": writer.glb(), "a.gltf": writer.gltf(), "bare": writer.gltf()}.items():
        splats = read(raw, name)
        assert splats.loss is None
        assert splats.tags == {"frame": "glTF, y up", "generator": "test"}
        np.testing.assert_array_equal(splats.mean, scene["mean"])
        np.testing.assert_array_equal(splats.quat_wxyz, scene["quat_wxyz"])
        np.testing.assert_array_equal(splats.scale, scene["scale"])
        np.testing.assert_array_equal(splats.opacity, scene["alpha"][:, 0])
        np.testing.assert_array_equal(splats.color, color_from_sh0(scene["sh0"]))
        assert any("--turn z" in note for note in splats.notes)


def test_buffers_beside_the_file_are_inputs(tmp_path):
    writer = simple()
    (tmp_path / "part one").mkdir()
    (tmp_path / "part one" / "ä.bin").write_bytes(writer.binary)
    (tmp_path / "a.gltf").write_bytes(writer.gltf("part%20one/%C3%A4.bin"))
    found = SplatFile.find(tmp_path / "a.gltf")
    assert [path.name for path in found.files().values()] == ["a.gltf", "ä.bin"]
    np.testing.assert_array_equal(found.decode().mean, gaussians()["mean"])
    (tmp_path / "part one" / "ä.bin").write_bytes(writer.binary[:-1])
    with pytest.raises(ArtifactError, match="glTF: truncated: buffer 0 announces"):
        read_splats(tmp_path / "a.gltf")
    for uri in ("../a.bin", "/etc/passwd", "https://example.org/a.bin", "%2e%2e/a.bin", "none.bin"):
        (tmp_path / "a.gltf").write_bytes(writer.gltf(uri))
        with pytest.raises(ArtifactError, match=r"glTF: buffer 0: .*(no name of a file|does not exist)"):
            read_splats(tmp_path / "a.gltf")


def angles(one, other):
    """Rotations between quaternions, in double precision and well away from rounding."""
    one, other = (np.asarray(q, np.float64) / np.linalg.norm(q, axis=1, keepdims=True) for q in (one, other))
    chord = np.minimum(np.linalg.norm(one - other, axis=1), np.linalg.norm(one + other, axis=1))
    return 4 * np.arcsin(np.minimum(chord / 2, 1))


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
    step = 1 / CODES[kind.removesuffix("n")][2] if kind.endswith("n") else 1
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
        assert splats.loss.opacity == pytest.approx(loss)
        off = np.abs(splats.opacity.astype(np.float64) - scene["alpha"][:, 0]).max()
        assert 0.3 * loss < off <= loss + 6e-8


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


def test_negative_scales_are_logarithms_of_the_whole_file(read):
    scene = gaussians()
    logs = np.log(scene["scale"])
    other = np.abs(logs[:1])
    writer = Writer()
    writer.node(mesh=writer.mesh(**scene | {"scale": logs}))
    writer.node(mesh=writer.mesh(**{key: value[:1] for key, value in scene.items()} | {"scale": other}))
    splats = read(writer.glb())
    np.testing.assert_allclose(splats.scale, np.vstack([scene["scale"], np.exp(other)]), rtol=1e-6)
    assert any("scales are logarithms" in note for note in splats.notes)


def test_sparse_rows_replace_those_of_the_view(read):
    scene = gaussians()
    writer = Writer()
    mesh = writer.mesh(**scene)
    attributes = writer.tree["meshes"][mesh]["primitives"][0]["attributes"]
    sparse = {
        "count": 2,
        "indices": {"bufferView": writer.view(np.array([3, 49], "<u2").tobytes()), "componentType": 5123},
        "values": {"bufferView": writer.view(np.arange(6, dtype="<f4").tobytes())},
    }
    writer.tree["accessors"][attributes["POSITION"]]["sparse"] = sparse
    writer.node(mesh=mesh)
    mean = scene["mean"].copy()
    mean[[3, 49]] = np.arange(6).reshape(2, 3)
    np.testing.assert_array_equal(read(writer.glb()).mean, mean)
    del writer.tree["accessors"][attributes["POSITION"]]["bufferView"]
    mean = np.zeros_like(mean)
    mean[[3, 49]] = np.arange(6).reshape(2, 3)
    np.testing.assert_array_equal(read(writer.glb()).mean, mean)
    for key, wrong, message in (
        ("indices", {"bufferView": 0, "componentType": 5126}, "sparse indices are not unsigned"),
        ("indices", {"bufferView": 0, "componentType": 5125}, "sparse index .* of 50 rows"),
        ("values", {"bufferView": 99}, "buffer view 99 does not exist"),
        ("count", 10**6, "1000000 rows end at byte"),
    ):
        writer.tree["accessors"][attributes["POSITION"]]["sparse"] = sparse | {key: wrong}
        with pytest.raises(ArtifactError, match=f"glTF: .*{message}"):
            read(writer.glb())


def test_chains_of_nodes_move_turn_and_scale_whole_ellipsoids(read):
    scene = gaussians(300)
    turn = np.array([0.5, -0.5, 0.1, 0.7])
    turn /= np.linalg.norm(turn)
    matrix = np.eye(4)
    matrix[:3, :3] = 3 * matrix_from_quat_wxyz(turn)
    matrix[:3, 3] = (5, 6, 7)
    writer = Writer()
    mesh = writer.mesh(**scene)
    leaf = writer.node(
        root=False, mesh=mesh, translation=[1, 2, 3], scale=[0.5] * 3, rotation=[0, 0.6, 0, 0.8]
    )
    writer.node(children=[leaf], matrix=matrix.T.ravel().tolist())
    writer.node(mesh=mesh)
    splats = read(writer.glb())
    assert len(splats) == 600
    local = np.eye(4)
    local[:3, :3] = 0.5 * matrix_from_quat_wxyz(np.array([0.8, 0, 0.6, 0]))
    local[:3, 3] = (1, 2, 3)
    whole = matrix @ local
    first = slice(0, 300)
    want = scene["mean"].astype(np.float64) @ whole[:3, :3].T + whole[:3, 3]
    off = np.linalg.norm(splats.mean[first] - want, axis=1)
    assert (off <= splats.loss.bound[first, 0]).all()

    def covariances(quat, scale):
        quat = quat / np.linalg.norm(quat, axis=1, keepdims=True)
        half = matrix_from_quat_wxyz(quat) * scale[:, None, :].astype(np.float64)
        return half @ half.transpose(0, 2, 1)

    linear = whole[:3, :3]
    np.testing.assert_allclose(
        covariances(splats.quat_wxyz[first], splats.scale[first]),
        linear @ covariances(scene["quat_wxyz"], scene["scale"]) @ linear.T, rtol=0, atol=3e-6,
    )  # fmt: skip
    np.testing.assert_array_equal(splats.mean[300:], scene["mean"])
    assert (splats.loss.bound[300:] == 0).all()
    assert (splats.loss.bound[:300] < 1e-5).all()


def test_positions_are_where_another_reader_puts_them(read, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    scene = gaussians(300)
    writer = Writer()
    mesh = writer.mesh(**scene, offset=4)
    leaf = writer.node(root=False, mesh=mesh, name="leaf", translation=[1, 2, 3], rotation=[0, 0.6, 0, 0.8])
    writer.node(name="root", children=[leaf], scale=[2, 2, 2], rotation=[0.6, 0, 0, 0.8])
    splats = read(writer.glb())
    cloud = trimesh.load_scene(tmp_path / "a.glb").to_geometry()
    np.testing.assert_allclose(splats.mean, cloud.vertices, atol=2e-6)


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


def test_the_command_reads_it(tmp_path, capsys):
    (tmp_path / "a.glb").write_bytes(simple().glb())
    assert run(["import-splat", str(tmp_path / "a.glb"), "-o", str(tmp_path / "a.scene.npz")]) == 0
    scene = read_artifact(tmp_path / "a.scene.npz")
    assert scene.manifest.source["format"] == "gltf"
    assert scene.manifest.source["frame"]["file"] == "glTF, y up"
    assert "--turn z" in capsys.readouterr().err


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


def test_scenes_choose_what_is_read(read):
    writer = simple()
    mesh = 0
    writer.node(root=False, mesh=mesh)
    writer.tree["scenes"].append({"nodes": []})
    splats = read(writer.glb())
    assert len(splats) == 50
    assert "1 nodes with Gaussians are not in the scene; they were not read" in splats.notes
    assert any("scene 0 of 2" in note for note in splats.notes)
    writer.tree["scene"] = 1
    with pytest.raises(ArtifactError, match="no node of the scene has Gaussians"):
        read(writer.glb())
    del writer.tree["scene"]
    assert any("no default scene: the first of 2" in note for note in read(writer.glb()).notes)
    del writer.tree["scenes"]
    assert len(read(writer.glb())) == 100


def test_colours_fall_back_and_harmonics_must_be_whole(read):
    writer = simple()
    primitive = writer.tree["meshes"][0]["primitives"][0]
    attributes = primitive["attributes"]
    name = f"{KHR}:SH_DEGREE_"
    sh0 = attributes.pop(name + "0_COEF_0")
    with pytest.raises(ArtifactError, match="need attribute KHR_gaussian_splatting:SH_DEGREE_0_COEF_0"):
        read(writer.glb())
    rgba = np.random.default_rng(0).uniform(size=(50, 4))
    attributes["COLOR_0"] = writer.accessor(rgba, "u8n")
    splats = read(writer.glb())
    np.testing.assert_array_equal(splats.color, np.rint(rgba[:, :3] * 255))
    assert "no spherical harmonics: colours of COLOR_0" in splats.notes
    attributes[name + "0_COEF_0"] = sh0
    for coefficient in range(3):
        attributes[f"{name}1_COEF_{coefficient}"] = sh0
    assert len(read(writer.glb())) == 50
    attributes[name + "2_COEF_4"] = sh0
    with pytest.raises(ArtifactError, match="SH_DEGREE_2_COEF_0 is missing"):
        read(writer.glb())
    attributes[name + "1_COEF_3"] = sh0
    with pytest.raises(ArtifactError, match="SH_DEGREE_1_COEF_3 is no spherical"):
        read(writer.glb())


def changed(path, value):
    def change(tree):
        *way, last = path
        for key in way:
            tree = tree[key]
        if value is None:
            del tree[last]
        else:
            tree[last] = value

    return change


PRIMITIVE = ("meshes", 0, "primitives", 0)
SPLATTING = (*PRIMITIVE, "extensions", KHR)
WRONG = {
    "kernel": (changed((*SPLATTING, "kernel"), "customShape"), "kernel 'customShape' is not known"),
    "kernel type": (changed((*SPLATTING, "kernel"), 3), "Expected `str | null`"),
    "compression": (
        changed((*SPLATTING, "extensions"), {"KHR_gaussian_splatting_compression_spz_2": {}}),
        "compressed by KHR_gaussian_splatting_compression_spz_2",
    ),
    "required": (changed(("extensionsRequired",), ["EXT_meshopt_compression"]), "requires EXT_meshopt_comp"),
    "packed view": (
        changed(("bufferViews", 0, "extensions"), {"EXT_meshopt_compression": {}}),
        "compressed by EXT_meshopt",
    ),
    "mesh": (changed((*PRIMITIVE, "extensions"), {}), "an ordinary scene, not a Gaussian splat"),
    "mode": (changed((*PRIMITIVE, "mode"), 4), "mode 0, no indices"),
    "rotation": (changed((*PRIMITIVE, "attributes", KHR + ":ROTATION"), None), "need attribute .*ROTATION"),
    "accessor": (changed((*PRIMITIVE, "attributes", "POSITION"), 99), "accessor 99 does not exist"),
    "type": (changed(("accessors", 0, "type"), "VEC4"), "POSITION is 'VEC4', not VEC3"),
    "component": (changed(("accessors", 0, "componentType"), 5125), "POSITION is u32, not f32"),
    "unknown component": (changed(("accessors", 0, "componentType"), 7), "POSITION is component type 7"),
    "count": (changed(("accessors", 0, "count"), 10**9), "1000000000 rows end at byte 12000000000 of 600"),
    "huge count": (changed(("accessors", 0, "count"), 10**40), "accessors.0..count"),
    "counts": (changed(("accessors", 0, "count"), 49), "ROTATION has 50 rows, POSITION 49"),
    "no view": (changed(("accessors", 0, "bufferView"), None), "has no buffer view"),
    "view": (changed(("accessors", 0, "bufferView"), 7), "buffer view 7 does not exist"),
    "offset": (changed(("accessors", 0, "byteOffset"), 1), "rows end at byte 601 of 600"),
    "negative": (changed(("accessors", 0, "byteOffset"), -12), ">= 0"),
    "view offset": (changed(("bufferViews", 0, "byteOffset"), 10**6), "buffer view 0 ends at 1000600 of"),
    "stride": (changed(("bufferViews", 0, "byteStride"), 4), "a stride of 4 bytes for rows of 12"),
    "buffer": (changed(("bufferViews", 0, "buffer"), 3), "buffer 3 does not exist"),
    "scene": (changed(("scene",), 2), "scene 2 does not exist; there are 1"),
    "node": (changed(("scenes", 0, "nodes"), [1]), "node 1 does not exist"),
    "node mesh": (changed(("nodes", 0, "mesh"), 1), "mesh 1 does not exist"),
    "cycle": (changed(("nodes", 0, "children"), [0]), "node 0 is reached twice"),
    "twice": (changed(("scenes", 0, "nodes"), [0, 0]), "node 0 is reached twice"),
    "uneven": (changed(("nodes", 0, "scale"), [1, 2, 1]), "scales by 2, 1, 1 along three directions"),
    "mirror": (changed(("nodes", 0, "scale"), [-1, 1, 1]), "mirrors"),
    "flat": (changed(("nodes", 0, "scale"), [0, 0, 0]), "has scale 0"),
    "no turn": (changed(("nodes", 0, "rotation"), [0, 0, 0, 0]), "rotation has no length"),
    "short": (changed(("nodes", 0, "matrix"), [1.0] * 15), "matrix is not 16 finite numbers"),
    "projective": (
        changed(("nodes", 0, "matrix"), [1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]),
        "not affine and finite",
    ),
    "version": (changed(("asset", "version"), "1.0"), "version '1.0' is not 2.0"),
    "skin": (changed(("nodes", 0, "skin"), 0), "has a skin"),
    "instances": (changed(("nodes", 0, "extensions"), {"EXT_mesh_gpu_instancing": {}}), "EXT_mesh_gpu"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_refused_by_name(read, name):
    change, message = WRONG[name]
    writer = simple()
    change(writer.tree)
    with pytest.raises(ArtifactError, match=f"a.glb: glTF: .*{message}") as error:
        read(writer.glb())
    assert "\n" not in str(error.value)


def test_containers_that_are_damaged_are_refused(read):
    raw = simple().glb()
    chunk = struct.unpack_from("<I", raw, 12)[0]
    for damaged, message in {
        raw[:-1]: "truncated: the header announces",
        raw[:15]: "truncated: a GLB has a header",
        raw[:4] + struct.pack("<I", 1) + raw[8:]: "GLB of version 1",
        raw[:12] + struct.pack("<I", 2**31) + raw[16:]: "truncated: a chunk announces 2147483648",
        raw[:16] + b"XXXX" + raw[20:]: "first chunk of the GLB is not JSON",
        raw[:20] + b"[" + raw[21:]: "glTF: JSON: ",
        raw[:8] + struct.pack("<I", 20 + chunk) + raw[12:]: "buffer 0 has no URI and there is no binary",
    }.items():
        with pytest.raises(ArtifactError, match=message):
            read(damaged)
    assert any("5 bytes follow" in note for note in read(raw + b"extra").notes)
    for text, message in {
        b'{"asset":{"version":"2.0"},"x":' + b"[" * 10**5: "nested too deeply",
        b'{"asset":{"version":"2.0"},"nodes":[' + b"{}," * 2**20 + b"{}]}": "more than 1048576 JSON objects",
        b'{"asset":{"version":"2.0"}}': "no primitive has KHR",
        b'{"asset":{"version":"2.0"},"meshes":[{"primitives":[{"attributes":{"\xff":1}}]}]}': "JSON",
    }.items():
        with pytest.raises(ArtifactError, match=message):
            read(text, "a.gltf")
    writer = simple()
    for uri in ("data:;base64,####", "data:nothing"):
        with pytest.raises(ArtifactError, match="glTF: buffer 0: "):
            read(writer.gltf(uri), "a.gltf")


def test_a_chain_of_many_nodes_and_many_instances_end(read):
    writer = simple()
    for child in range(3000):
        writer.node(root=False, children=[child], translation=[0, 0, 1])
    writer.tree["scenes"][0]["nodes"] = [3000]
    np.testing.assert_allclose(read(writer.glb()).mean[:, 2], gaussians()["mean"][:, 2] + 3000, atol=1e-3)
    writer = simple()
    for _ in range(100):
        writer.node(mesh=0)
    with pytest.raises(ArtifactError, match=r"5050 Gaussians in \d+ bytes"):
        read(writer.glb())


BASE = simple().glb()


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_any_change_of_bytes_is_read_or_refused(tmp_path_factory, data):
    raw = bytearray(BASE)
    json_end = 20 + struct.unpack_from("<I", raw, 12)[0]
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, json_end))
        raw[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
    path = tmp_path_factory.getbasetemp() / "fuzzed.glb"
    path.write_bytes(raw[: data.draw(st.integers(len(raw) // 2, len(raw) + 8))])
    try:
        found = SplatFile.find(path, "gltf")
        found.files()
        splats = found.decode()
    except AlulaError as error:
        lines = str(error).count("\n")
    else:
        lines = 0
        assert len(splats) > 0
    assert lines == 0


def conformance(name):
    root = os.environ.get("ALULA_DATA")
    if not root:
        pytest.skip("ALULA_DATA is not set")
    return Path(root) / "tiny-conformance" / name


@pytest.mark.parametrize("suffix", ["gltf", "glb"])
def test_the_conformance_matrix_has_its_recorded_values(suffix):
    splats = read_splats(conformance(f"khr_conformance_matrix.{suffix}"))
    logs = [[0, 0.5, -0.5]] * 3 + [[0.2, -0.1, 0.7], [1, -2, 3], [1, 0, -1], [2, -3, 4], [1, 0, -1]]
    logs += [[0, 0.5, -0.5]] * 7
    np.testing.assert_allclose(splats.scale, np.exp(logs), rtol=1e-6)
    np.testing.assert_array_equal(splats.mean, [[1, 2, 3]] * 15)
    np.testing.assert_array_equal(splats.quat_wxyz, [[0, 1, 0, 0]] * 15)
    opacity = [0.25] * 8 + [0.75, 64 / 255, 16384 / 65535] + [0.25] * 4
    np.testing.assert_allclose(splats.opacity, opacity, rtol=1e-7)
    np.testing.assert_array_equal(splats.color, [color_from_sh0(np.float32([0.1, 0.2, 0.3]))] * 15)


def test_the_fallback_of_a_kernel_that_is_not_known_is_refused():
    with pytest.raises(ArtifactError, match="kernel 'customShape' is not known, only 'ellipse'"):
        read_splats(conformance("khr_extensible_fallback.gltf"))


def test_the_turn_of_a_known_writer_is_undone(read):
    """Some writers negate x and y of PLY data; --turn z restores them exactly."""
    scene = gaussians()
    flipped = scene | {
        "mean": scene["mean"] * np.float32([-1, -1, 1]),
        "quat_wxyz": scene["quat_wxyz"][:, [3, 2, 1, 0]] * np.float32([-1, -1, 1, 1]),
    }
    writer = Writer()
    writer.node(mesh=writer.mesh(**flipped))
    back = turned(read(writer.glb()), ImportSplatConfig(turn="z").turn)
    np.testing.assert_array_equal(back.mean, scene["mean"])
    assert angles(back.quat_wxyz, scene["quat_wxyz"]).max() < 1e-7
