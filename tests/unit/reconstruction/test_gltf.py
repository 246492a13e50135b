"""glTF with KHR_gaussian_splatting: accessors, nodes, scenes, dialects of scale, real files."""

import os
from pathlib import Path

import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.errors import ArtifactError
from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
from alula.stages.reconstruction.formats.registry import SplatFile, read_splats
from alula.stages.reconstruction.formats.splats import color_from_sh0
from alula.stages.reconstruction.import_splat import turned
from alula.stages.rotation import matrix_from_quat_wxyz
from support.files.gltf_files import KHR, Writer, angles, gaussians, simple


@pytest.fixture
def read(tmp_path):
    def read(raw, name="a.glb"):
        (tmp_path / name).write_bytes(raw)
        return read_splats(tmp_path / name)

    return read


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


def test_the_command_reads_it(tmp_path, capsys):
    (tmp_path / "a.glb").write_bytes(simple().glb())
    assert run(["import-splat", str(tmp_path / "a.glb"), "-o", str(tmp_path / "a.scene.npz")]) == 0
    scene = read_artifact(tmp_path / "a.scene.npz")
    assert scene.manifest.source["format"] == "gltf"
    assert scene.manifest.source["frame"]["file"] == "glTF, y up"
    assert "--turn z" in capsys.readouterr().err


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
