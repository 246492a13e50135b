"""Exports for simulators and mapping programs, each opened by the program that it is for."""

import itertools
import json
import math
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import read_artifact, write_artifact
from alula.schemas.artifacts.provenance import read_provenance
from alula.stages.clearance import hull_obstacles, segment_clearance
from alula.stages.compression.hulls import Hulls
from alula.stages.export.grids import geodetic
from support.scenes.small_scenes import G, box_cover


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """A floor and a table: 4 m x 4 m, the table 1 m x 1 m with its top at 0.8 m."""
    path = tmp_path_factory.mktemp("maps") / "room.cover.npz"
    metres = np.array([((-2, -2, -0.1), (2, 2, 0)), ((-0.5, -0.5, 0), (0.5, 0.5, 0.8))])
    write_artifact(path, box_cover(np.rint(metres / G)))
    return path


def exported(source, out, *words):
    assert run(["export", str(source), "-o", str(out), "-q", *words]) == 0
    return out


def test_a_ball_dropped_in_mujoco_rests_on_the_table(room, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    out = exported(room, tmp_path / "room.xml")
    tree = ET.parse(out)
    ball = ET.SubElement(tree.getroot().find("worldbody"), "body", name="ball", pos="0.1 0.1 1.2")
    ET.SubElement(ball, "freejoint")
    ET.SubElement(ball, "geom", type="sphere", size="0.1", mass="1")
    model = mujoco.MjModel.from_xml_string(ET.tostring(tree.getroot(), encoding="unicode"))
    data = mujoco.MjData(model)
    while data.time < 2.0:
        mujoco.mj_step(model, data)
    assert data.qpos[2] == pytest.approx(0.9, abs=2e-3)  # contacts of MuJoCo are soft
    assert np.abs(data.qvel).max() < 1e-3
    assert read_provenance(out).parameters["format"] == "mjcf"


def test_distances_in_mujoco_are_ours(pipeline, tmp_path):
    """At 10,000 points; a hull whose box is farther away than a hull already found is not asked for."""
    mujoco = pytest.importorskip("mujoco")
    source = pipeline / "tiny.cover.npz"
    out = exported(source, tmp_path / "tiny.xml")
    tree = ET.parse(out)
    radius, count = 0.05, 10_000
    ET.SubElement(tree.getroot().find("worldbody"), "geom", name="probe", type="sphere", size=f"{radius}")
    model = mujoco.MjModel.from_xml_string(ET.tostring(tree.getroot(), encoding="unicode"))
    model.opt.ccd_tolerance = 1e-10
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    probe = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, "probe")
    hulls = Hulls.from_cover(read_artifact(source))
    low, high = hulls.bounds()
    order = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, f"hull-{i:05}") for i in range(len(low))]
    drawn = np.random.default_rng(3).uniform(low.min(axis=0) - 0.5, high.max(axis=0) + 0.5, (2 * count, 3))
    ours = segment_clearance(drawn, drawn, hull_obstacles(hulls))
    outside = np.flatnonzero(ours > radius + 0.01)[:count]  # what is touched has no distance
    assert len(outside) == count
    points = drawn[outside]
    beyond = np.maximum(np.maximum(low - points[:, None], points[:, None] - high), 0)
    to_box = np.linalg.norm(beyond, axis=2) - 1e-5  # corners in MuJoCo are in single precision
    found = np.full(count, np.inf)
    for i, nearest in enumerate(np.argsort(to_box, axis=1)):
        data.geom_xpos[probe] = points[i]
        for hull in nearest:
            if to_box[i, hull] > found[i]:
                break
            found[i] = min(
                found[i], radius + mujoco.mj_geomDistance(model, data, order[hull], probe, 10.0, None)
            )
    assert np.abs(found - ours[outside]).max() < 1e-6


def test_usd_has_a_collider_for_each_hull(room, tmp_path):
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdPhysics

    out = exported(room, tmp_path / "room.usda")
    stage = Usd.Stage.Open(str(out))
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    found = [prim for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.MeshCollisionAPI)]
    assert [prim.GetName() for prim in found] == ["hull_00000", "hull_00001"]
    assert UsdPhysics.MeshCollisionAPI(found[0]).GetApproximationAttr().Get() == "convexHull"
    extent = np.array(UsdGeom.Mesh(found[1]).GetExtentAttr().Get())
    np.testing.assert_allclose(extent, [[-0.5, -0.5, 0], [0.5, 0.5, 0.8]], atol=1e-6)
    counts = np.array(UsdGeom.Mesh(found[0]).GetFaceVertexIndicesAttr().Get())
    assert UsdGeom.Mesh.ValidateTopology(counts.tolist(), [3] * (len(counts) // 3), 8)[0]
    assert read_provenance(out).parameters["format"] == "usda"


def test_mujoco_loads_the_urdf_with_its_meshes(room, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    out = exported(room, tmp_path / "model", "--format", "urdf")
    model = mujoco.MjModel.from_xml_path(str(out / "map.urdf"))
    assert model.nmesh == 2
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    centre = np.sort(data.geom_xpos[model.geom_dataid >= 0][:, 2])
    assert set(np.round(centre, 6).tolist()) == {-0.05, 0.4}
    assert run(["export", str(room), "-o", str(out), "--format", "urdf"]) == 0  # unchanged


def test_gazebo_s_model_names_files_that_are_there(room, tmp_path):
    out = exported(room, tmp_path / "model", "--format", "gazebo")
    assert ET.parse(out / "model.config").getroot().find("sdf").text == "model.sdf"
    sdf = ET.parse(out / "model.sdf").getroot()
    assert (sdf.tag, sdf.get("version")) == ("sdf", "1.9")
    link = sdf.find("model/link")
    assert sdf.find("model/static").text == "true"
    for kind in ("collision", "visual"):
        uris = [uri.text for uri in link.findall(f"{kind}/geometry/mesh/uri")]
        assert uris == ["hull-00000.obj", "hull-00001.obj"]
        assert all((out / uri).is_file() for uri in uris)


def loaded_by_drake(path):
    """The plant of a model file; warnings of Drake's parser and its SDFormat library are errors."""
    pytest.importorskip("pydrake")
    from pydrake.geometry import SceneGraph
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant

    plant, scene = MultibodyPlant(0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene)
    parser = Parser(plant)
    parser.SetStrictParsing()
    parser.AddModels(str(path))
    plant.Finalize()
    return plant


@pytest.mark.parametrize(("kind", "name"), [("gazebo", "model.sdf"), ("urdf", "map.urdf")])
def test_drake_loads_every_hull_without_a_warning(kind, name, room, tmp_path):
    out = exported(room, tmp_path / "model", "--format", kind)
    assert loaded_by_drake(out / name).num_collision_geometries() == 2


def test_the_sdformat_library_refuses_what_its_schema_does_not_have(room, tmp_path):
    sdf = exported(room, tmp_path / "model", "--format", "gazebo") / "model.sdf"
    text = sdf.read_text()
    for old, new in [("<collision", "<kollision/><collision"), (' name="hull-00001"', ""), ("true<", "no<")]:
        sdf.write_text(text.replace(old, new, 1))
        with pytest.raises(RuntimeError, match=r"not defined in SDF|is not specified in SDF|Error reading"):
            loaded_by_drake(sdf)


def voxels_of(path):
    voxels = read_artifact(path)
    return np.asarray(voxels["index"]), float(voxels.manifest.voxel_size_m)


def test_octomap_reads_every_voxel_and_no_other(pipeline, tmp_path):
    octomap = pytest.importorskip("pyoctomap")
    source = pipeline / "tiny.voxels.npz"
    out = exported(source, tmp_path / "tiny.bt")
    tree = octomap.OcTree(str(out).encode())
    index, edge = voxels_of(source)
    assert tree.getResolution() == edge
    assert int(out.read_bytes().split(b"\nsize ")[1].split()[0]) == tree.size()
    marked = {tuple(i) for i in index.tolist()}
    low, high = index.min(axis=0) - 2, index.max(axis=0) + 3
    rng = np.random.default_rng(0)
    others = [tuple(i) for i in rng.integers(low, high, (2000, 3)).tolist()]
    for i in [*marked, *others]:
        node = tree.search((np.array(i) + 0.5) * edge)
        assert (node is not None and tree.isNodeOccupied(node)) == (i in marked)


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
def test_clouds_of_voxels_are_read_by_open3d(suffix, pipeline, tmp_path):
    import open3d

    out = exported(pipeline / "tiny.voxels.npz", tmp_path / f"tiny{suffix}")
    index, edge = voxels_of(pipeline / "tiny.voxels.npz")
    read = np.asarray(open3d.io.read_point_cloud(str(out)).points)
    np.testing.assert_allclose(read, (index + 0.5) * edge, rtol=1e-7)


def test_the_field_is_off_by_no_more_than_it_says(pipeline, tmp_path):
    from scipy.interpolate import RegularGridInterpolator

    out = exported(pipeline / "tiny.cover.npz", tmp_path / "tiny.npz", "--spacing", "0.21", "--pad", "0.7")
    with np.load(out) as found:
        distance, origin, spacing, error = (
            found[name] for name in ("distance_m", "origin_m", "spacing_m", "error_m")
        )
    axes = [origin[i] + spacing * np.arange(distance.shape[i]) for i in range(3)]
    hulls = Hulls.from_cover(read_artifact(pipeline / "tiny.cover.npz"))
    low, high = hulls.bounds()
    assert all(a[0] <= low[:, i].min() - 0.7 for i, a in enumerate(axes))
    assert all(a[-1] >= high[:, i].max() + 0.7 for i, a in enumerate(axes))
    points = np.random.default_rng(1).uniform([a[0] for a in axes], [a[-1] for a in axes], (4000, 3))
    exact = segment_clearance(points, points, hull_obstacles(hulls))
    off = np.abs(RegularGridInterpolator(axes, distance.astype(float))(points) - exact)
    assert off.max() <= error
    assert error == pytest.approx(math.sqrt(3) / 2 * 0.21, rel=1e-3)


def test_the_footprint_lies_where_the_origin_is(room, tmp_path):
    out = exported(room, tmp_path / "room.geojson", "--origin", "47.3", "8.5", "400")
    found = json.loads(out.read_text())["features"]
    assert [f["properties"] for f in found] == [
        {"bottom_m": -0.1, "top_m": 0.0},
        {"bottom_m": 0.0, "top_m": 0.8},
    ]
    ring = np.array(found[0]["geometry"]["coordinates"][0])
    assert (ring[0] == ring[-1]).all()
    (x, y), (u, v) = ring[:-1, 0].min() * np.ones(2), (ring[:-1, 1].min(), ring[:-1, 1].max())
    metres = (v - u) * math.pi / 180 * 6.367e6  # of a degree along the meridian at 47.3 degrees
    assert metres == pytest.approx(4.0, rel=3e-3)
    assert x == y < 8.5 < ring[:, 0].max()
    area = 0.5 * sum(a[0] * b[1] - b[0] * a[1] for a, b in itertools.pairwise(ring))
    assert area > 0  # counter-clockwise, as RFC 7946 asks


def test_geodetic_positions_agree_with_pycolmap():
    import pycolmap

    transform = pycolmap.GPSTransform(pycolmap.GPSTransformEllipsoid.WGS84)
    origin = np.array([47.3, 8.5, 400.0])
    enu = np.random.default_rng(5).uniform(-3000, 3000, (50, 3))
    expected = transform.enu_to_ellipsoid(enu, *origin)
    np.testing.assert_allclose(geodetic(origin, enu), expected, atol=1e-3, rtol=1e-11)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["tiny.cover.npz", "-o", "x.geojson"], "GeoJSON needs --origin"),
        (["tiny.cover.npz", "-o", "x.bt"], "a cover is exported as"),
        (["tiny.voxels.npz", "-o", "x.xml"], "voxels are exported as octomap, ply, pcd, not as mjcf"),
        (["tiny.cover.npz", "-o", "x.npz", "--spacing", "0"], "--spacing must be between 0.001 and 1000"),
        (["tiny.cover.npz", "-o", "x.npz", "--spacing", "0.001"], "give a larger --spacing"),
        (["tiny.scene.npz", "-o", "x", "--format", "urdf"], "alula/scene"),
    ],
)
def test_what_cannot_be_exported_is_refused_in_one_line(
    words, message, pipeline, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    words[0] = str(pipeline / words[0])
    assert run(["export", *words]) in (2, 3)
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())
