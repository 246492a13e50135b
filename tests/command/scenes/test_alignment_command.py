"""The command `scale-align` with GPS, poses, nerfstudio's frame, a cloud and the floor."""

import json
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from alula.cli.main import run
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.artifacts.provenance import read_provenance
from alula.stages.alignment.colmap import read_model
from alula.stages.alignment.similarity import inverse, transform_points
from alula.stages.reconstruction.demo_scene import world_from_scene

pytest.importorskip("pycolmap")
TRUTH = world_from_scene()


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    folder = tmp_path_factory.mktemp("alignment")
    words = ["--gaussians", "15000", "--seed", "3", "--colmap", str(folder / "sparse")]
    words += ["--cameras", str(folder / "cameras.csv"), "--reference", str(folder / "poses.csv")]
    assert run(["demo-scene", "-o", str(folder / "room.ply"), "-q", *words]) == 0
    assert run(["import-splat", str(folder / "room.ply"), "-o", str(folder / "room.scene.npz"), "-q"]) == 0
    return folder


@pytest.fixture
def align(demo, tmp_path):
    def call(*words, output="m.scene.npz", scene=None, quiet=True):
        start = ["scale-align", str(scene or demo / "room.scene.npz"), "-o", str(tmp_path / output)]
        return run([*start, *(["-q"] if quiet else []), *map(str, words)])

    return call


def record(path):
    return read_artifact(path).manifest.alignment


def error(capsys):
    (line,) = capsys.readouterr().err.splitlines()
    return line


def table(header, rows):
    return "\n".join([header, *(",".join(map(repr_of, row)) for row in rows)])


def repr_of(value):
    return value if isinstance(value, str) else repr(float(value))


def surveyed(demo):
    """Names and positions of the cameras in the world, with the reference's noise and two gross errors."""
    lines = [line.split(",") for line in (demo / "poses.csv").read_text().splitlines()[1:]]
    return [line[0] for line in lines], np.array([line[1:4] for line in lines], float)


def test_gps_gives_the_frame_east_north_up_and_its_origin(demo, align, tmp_path):
    import pycolmap

    names, world = surveyed(demo)
    wgs84 = pycolmap.GPSTransform(pycolmap.GPSTransformEllipsoid.WGS84)
    geodetic = wgs84.enu_to_ellipsoid(world, 41.0, 29.0, 100.0)
    path = tmp_path / "gps.csv"
    path.write_text(table("image,lat,lon,alt", [(n, *p) for n, p in zip(names, geodetic, strict=True)]))
    words = ["--colmap", demo / "sparse", "--reference", path]
    assert align(*words, "--origin", "41 29 100") == 0
    found = read_artifact(tmp_path / "m.scene.npz").manifest
    np.testing.assert_allclose(found.world_from_scene.translation_m, TRUTH.translation_m, atol=5e-3)
    assert found.alignment["georeference"]["origin_lat_deg"] == 41.0
    assert found.parameters["origin"] == [41, 29, 100]
    assert align(*words, output="n.scene.npz") == 0
    first = record(tmp_path / "n.scene.npz")
    assert first["georeference"]["origin_is"] == f"gps.csv row 2 ({names[0]})"
    assert first["scale"] == pytest.approx(found.alignment["scale"], rel=1e-9)


def poses_of(demo, count=None, axes=None):
    """Mocap rows: the reference's positions, the true orientations turned by `axes` in the camera."""
    model = read_model(demo / "sparse")
    index = {name: i for i, name in enumerate(model.names)}
    names, world = surveyed(demo)
    rows = []
    for name, position in list(zip(names, world, strict=True))[:count]:
        turned = np.array(TRUTH.rotation) @ model.axes[index[name]]
        quat = (Rotation.from_matrix(turned) * (axes or Rotation.identity())).as_quat()[[3, 0, 1, 2]]
        rows.append((name, *position, *quat))
    return table("image,x,y,z,qw,qx,qy,qz", rows)


def test_poses_need_only_two_cameras_and_take_pose_tables_too(demo, align, tmp_path):
    path = tmp_path / "mocap.csv"
    path.write_text(poses_of(demo))
    assert align("--colmap", demo / "sparse", "--poses", path) == 0
    whole = record(tmp_path / "m.scene.npz")
    assert whole["method"] == "poses"
    assert whole["inliers"] == 58
    assert whole["scale"] == pytest.approx(TRUTH.scale, rel=5e-4)
    assert whole["rms_deg"] < 0.1
    assert set(whole["items"][0]) == {"item", "residual_m", "residual_deg", "inlier"}
    path.write_text(poses_of(demo, 2))
    assert align("--colmap", demo / "sparse", "--poses", path, output="two.scene.npz") == 0
    assert record(tmp_path / "two.scene.npz")["scale"] == pytest.approx(TRUTH.scale, rel=0.1)

    model = read_model(demo / "sparse")
    quats = Rotation.from_matrix(model.axes).as_quat()[:, [3, 0, 1, 2]]
    rows = [(n, *p, *q) for n, p, q in zip(model.names, model.position, quats, strict=True)]
    (tmp_path / "cameras.csv").write_text(table("image,x,y,z,qw,qx,qy,qz", rows))
    path.write_text(poses_of(demo))
    assert align("--cameras", tmp_path / "cameras.csv", "--poses", path, output="csv.scene.npz") == 0
    assert record(tmp_path / "csv.scene.npz")["scale"] == pytest.approx(whole["scale"], rel=1e-6)


def test_poses_with_other_axes_are_refused_with_a_hint(demo, align, tmp_path, capsys):
    path = tmp_path / "mocap.csv"
    path.write_text(poses_of(demo, axes=Rotation.from_euler("x", 180, degrees=True)))
    assert align("--colmap", demo / "sparse", "--poses", path) == 3
    assert "OpenGL axes" in error(capsys)


@pytest.fixture
def trained(demo, tmp_path):
    """The scene seen as trained by nerfstudio: its run folder, and the cameras before training."""
    A, b, scale = Rotation.from_rotvec([0.3, -1, 2]).as_matrix(), np.array([1.0, -2, 0.5]), 0.37
    folder = tmp_path / "run"
    folder.mkdir()
    frame = {"transform": np.column_stack([A, b]).tolist(), "scale": scale}
    (folder / "dataparser_transforms.json").write_text(json.dumps(frame))
    lines = [line.split(",") for line in (demo / "cameras.csv").read_text().splitlines()[1:]]
    original = (np.array([line[1:4] for line in lines], float) / scale - b) @ A
    rows = [(line[0], *p) for line, p in zip(lines, original, strict=True)]
    (tmp_path / "original.csv").write_text(table("image,x,y,z", rows))
    return folder, A, b, scale


def test_the_frame_of_nerfstudio_is_undone(demo, align, trained, tmp_path, capsys):
    folder, A, b, scale = trained
    assert align("--nerfstudio", folder) == 0
    assert align("--nerfstudio", folder / "dataparser_transforms.json", output="file.scene.npz") == 0
    before = np.asarray(read_artifact(demo / "room.scene.npz")["mean"], float)
    after = read_artifact(tmp_path / "m.scene.npz")
    np.testing.assert_allclose(after["mean"], (before / scale - b) @ A, atol=1e-5)
    assert after.manifest.alignment["method"] == "nerfstudio"
    assert "only if those were" in after.manifest.summary["warnings"][0]
    assert {ref.role for ref in after.manifest.inputs} == {"scene", "nerfstudio"}
    (folder / "transforms.json").write_text('{"applied_scale": 0.5}')
    assert align("--nerfstudio", folder, output="scaled.scene.npz") == 0
    assert "applied_scale 0.5" in record(tmp_path / "scaled.scene.npz")["warnings"][1]
    (folder / "dataparser_transforms.json").write_text('{"scale": 1}')
    assert align("--nerfstudio", folder, "-f") == 3
    assert "dataparser_transforms.json: has no 'transform'" in error(capsys)


def test_cameras_of_the_source_frame_align_the_trained_scene(demo, align, trained, tmp_path):
    words = ["--cameras", tmp_path / "original.csv", "--reference", demo / "poses.csv"]
    assert align(*words, "--nerfstudio", trained[0]) == 0
    assert align("--cameras", demo / "cameras.csv", *words[2:], output="plain.scene.npz") == 0
    composed, plain = (record(tmp_path / f"{name}.scene.npz") for name in ("m", "plain"))
    assert composed["scale"] == pytest.approx(plain["scale"], rel=1e-9)
    np.testing.assert_allclose(composed["matrix"], plain["matrix"], atol=1e-8)
    assert composed["nerfstudio"]["scale"] == trained[3]


def test_a_cloud_of_half_the_room_from_each_kind_of_first_guess(demo, align, tmp_path, capfd):
    world = transform_points(TRUTH, read_artifact(demo / "room.scene.npz")["mean"])
    half = world[world[:, 0] < 4.5]
    half = half + 0.005 * np.random.default_rng(0).normal(size=half.shape)
    np.savez(tmp_path / "survey.npz", points=half)
    turn = Rotation.from_rotvec([0.01, 0.01, -0.02]).as_matrix() @ np.array(TRUTH.rotation)
    guess = {"scale": TRUTH.scale * 1.01, "rotation": turn.tolist(), "translation_m": TRUTH.translation_m}
    (tmp_path / "guess.json").write_text(json.dumps(guess))
    cloud = ["--cloud", tmp_path / "survey.npz"]
    cameras = ["--cameras", demo / "cameras.csv", "--reference", demo / "poses.csv"]
    assert align(*cloud, "--initial", tmp_path / "guess.json") == 0
    assert align(*cloud, *cameras, output="c.scene.npz") == 0
    assert capfd.readouterr() == ("", "")
    for name in ("m", "c"):
        found = record(tmp_path / f"{name}.scene.npz")
        assert found["scale"] == pytest.approx(TRUTH.scale, rel=5e-4)
        assert abs(found["scale"] - TRUTH.scale) < 4 * found["scale_sigma"]
        assert found["cloud_fitness"] > 0.95
        assert 0 < found["position_error_m"] < 0.02
    assert align(*cloud, "--initial", tmp_path / "guess.json", "-f", "--max-rms", "0.0001") == 4
    assert "above --max-rms 0.0001 m" in capfd.readouterr().err
    assert align(*cloud, output="none.scene.npz") == 4
    assert "a better --initial is needed" in capfd.readouterr().err
    assert not (tmp_path / "none.scene.npz").exists()


def test_the_floor_levels_a_scene_of_known_scale(demo, align, tmp_path, capsys):
    up = np.array(TRUTH.rotation)[2] + [0.1, -0.1, 0.1]
    words = ["--scale", TRUTH.scale, "--floor", "--up", " ".join(map(str, up))]
    assert align(*words, quiet=False) == 0
    out = capsys.readouterr()
    assert "by floor" in out.err
    assert "sigma not known" in out.err
    found = read_artifact(tmp_path / "m.scene.npz")
    rise = np.array(found.manifest.alignment["matrix"])[2, :3] / TRUTH.scale
    assert np.degrees(np.arccos(np.clip(rise @ np.array(TRUTH.rotation)[2], -1, 1))) < 0.1
    assert np.asarray(found["mean"])[:, 2].min() == pytest.approx(0, abs=0.03)
    assert align("--floor", scene=tmp_path / "m.scene.npz", output="again.scene.npz") == 0
    assert record(tmp_path / "again.scene.npz")["level"]["turned_deg"] < 0.05


def test_the_table_has_every_figure(demo, align, capsys):
    words = ["--cameras", demo / "cameras.csv", "--reference", demo / "poses.csv"]
    assert align(*words, quiet=False) == 0
    shown = capsys.readouterr().err
    for expected in (
        "by correspondences: scene [arbitrary] to world [m]",
        *("sigma", "95 % interval", "leave one out", "w x y z", "det R", "+1.000000000", "threshold 0.1 m"),
        *("58 inliers of 60", "seed 0", "RMS", "median", "singular values", "at the scene's bounds"),
        *("outlier", "and 50 better ones"),
    ):
        assert expected in shown
    assert align("--scale", 2, quiet=False, output="s.scene.npz") == 0
    assert shown.count("matrix") == 1
    assert "unchanged: not measured" in capsys.readouterr().err


def test_json_has_the_whole_record_even_of_a_dry_run(demo, align, tmp_path, capsys):
    words = ["--cameras", demo / "cameras.csv", "--reference", demo / "poses.csv", "--json"]
    assert align(*words, "-n", quiet=False) == 0
    dry = json.loads(capsys.readouterr().out)
    assert dry["status"] == "dry-run"
    assert not (tmp_path / "m.scene.npz").exists()
    assert align(*words, quiet=False) == 0
    done = json.loads(capsys.readouterr().out)
    assert done["alignment"] == dry["alignment"] == record(tmp_path / "m.scene.npz")
    assert align(*words, "--max-rms", "0.001", "-f", quiet=False) == 4
    assert json.loads(capsys.readouterr().out)["exit_code"] == 4


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (
            ["--colmap", "m", "--reference", "a", "--poses", "b"],
            2,
            "--reference and --poses exclude each other",
        ),
        (["--poses", "p.csv"], 2, "--reference and --poses need"),
        (["--cameras", "a", "--colmap", "b", "--reference", "c"], 2, "not --colmap and --cameras"),
        (["--initial", "i.json", "--scale", "2"], 2, "--initial is the first guess for --cloud"),
        (["--cloud", "c.ply", "--scale", "2"], 2, "--cloud takes one first guess"),
        (["--cloud", "c.ply", "--initial", "i", "--correspondences", "p"], 2, "takes one first guess"),
        (["--nerfstudio", "d", "--scale", "2"], 2, "not --scale and --nerfstudio"),
        (["--nerfstudio", "d", "--correspondences", "c"], 2, "not --correspondences and --nerfstudio"),
        (["--nerfstudio", "none"], 3, "none: does not exist"),
        (["--origin", "1 2 3", "--scale", "2"], 2, "--origin goes with"),
        (["--origin", "100 2 3", "--scale", "2"], 2, "latitude, longitude"),
        (["--up", "0 0 0", "--scale", "2"], 2, "--up is no direction"),
        (["--up", "0 0 1"], 2, "alone are for scenes in metres"),
        (["--floor", "--scale", "2"], 2, "--floor needs --up"),
        (["--min-fitness", "2", "--scale", "2"], 2, "--min-fitness must be"),
        (["--angle-threshold", "0", "--scale", "2"], 2, "--angle-threshold must be"),
        (["--cloud", "none.ply"], 3, "cannot read"),
    ],
)
def test_ways_to_ask_wrongly(align, tmp_path, capsys, words, code, message):
    assert align(*words) == code
    assert re.search(message, error(capsys))
    assert not list(tmp_path.iterdir())


def test_an_alignment_can_be_undone(demo, align, tmp_path):
    """The inverse as --transform brings back the scene's own frame, to rounding."""
    assert align("--cameras", demo / "cameras.csv", "--reference", demo / "poses.csv") == 0
    undo = inverse(read_artifact(tmp_path / "m.scene.npz").manifest.world_from_scene)
    text = {"scale": undo.scale, "rotation": undo.rotation, "translation_m": undo.translation_m}
    (tmp_path / "undo.json").write_text(json.dumps(text))
    words = ["--transform", tmp_path / "undo.json"]
    assert align(*words, scene=tmp_path / "m.scene.npz", output="back.scene.npz") == 4
    words += ["--rescale"]
    assert align(*words, scene=tmp_path / "m.scene.npz", output="back.scene.npz") == 0
    before, after = (read_artifact(p)["mean"] for p in (demo / "room.scene.npz", tmp_path / "back.scene.npz"))
    np.testing.assert_allclose(after, before, atol=2e-6)


@pytest.mark.parametrize(("option", "way"), [("--min-fitness", "--cloud"), ("--angle-threshold", "--poses")])
def test_a_limit_that_does_not_apply_is_refused(tmp_path, capsys, option, way):
    words = [
        "scale-align",
        "any.scene.npz",
        "-o",
        str(tmp_path / "o.scene.npz"),
        "--scale",
        "2",
        option,
        "0.5",
    ]
    assert run(words) == 2
    assert f"{option} goes with {way}" in capsys.readouterr().err


def moved_splat(demo, folder, matrix):
    """The room's splat as a trainer writes it that moved the scene by s (R x + t) before."""
    raw = (demo / "room.ply").read_bytes()
    start = raw.index(b"end_header\n") + len(b"end_header\n")
    names = [line.split()[-1] for line in raw[:start].decode().splitlines() if line.startswith("property")]
    rows = np.frombuffer(raw[start:], [(name, "<f4") for name in names]).copy()
    scale = np.cbrt(np.linalg.det(matrix[:3, :3]))
    position = np.stack([rows[axis] for axis in "xyz"], axis=1) @ matrix[:3, :3].T + matrix[:3, 3]
    quat = Rotation.from_quat(np.stack([rows[f"rot_{i}"] for i in (1, 2, 3, 0)], axis=1))
    turned = (Rotation.from_matrix(matrix[:3, :3] / scale) * quat).as_quat()[:, [3, 0, 1, 2]]
    for i, axis in enumerate("xyz"):
        rows[axis] = position[:, i]
        rows[f"scale_{i}"] += np.log(scale)
    for i in range(4):
        rows[f"rot_{i}"] = turned[:, i]
    (folder / "moved.ply").write_bytes(raw[:start] + rows.tobytes())
    assert run(["import-splat", str(folder / "moved.ply"), "-o", str(folder / "moved.scene.npz"), "-q"]) == 0
    return folder / "moved.scene.npz"


def as_opensplat(demo):
    centre = read_model(demo / "sparse").position
    matrix = np.eye(4)
    matrix[:3, 3] = -centre.mean(axis=0)
    matrix[:3] /= np.abs(centre - centre.mean(axis=0)).max()
    return matrix


def test_a_splat_that_its_trainer_moved_is_aligned_to_within_its_bound(demo, align, tmp_path, capsys):
    matrix = as_opensplat(demo)
    scene = moved_splat(demo, tmp_path, matrix)
    words = ["--colmap", demo / "sparse", "--reference", demo / "poses.csv"]
    assert align(*words, scene=scene, quiet=False) == 0
    said = capsys.readouterr().err
    assert "not in the frame of the splat" in said
    assert "like OpenSplat's centre and scale" in said
    found = read_artifact(tmp_path / "m.scene.npz")
    truth = transform_points(TRUTH, read_artifact(demo / "room.scene.npz")["mean"])
    error = np.linalg.norm(found["mean"] - truth, axis=1).max()
    assert error < found.manifest.suggested_inflation_m < 0.03
    frame = found.manifest.alignment["model_frame"]
    assert frame["before"]["near"] * frame["before"]["inside"] < 0.3
    assert frame["near"] > 0.95
    assert 0 < frame["position_error_m"] < found.manifest.suggested_inflation_m


@pytest.mark.slow
def test_cameras_in_no_frame_of_the_splat_are_refused_wherever_they_meet(demo, align, tmp_path, capsys):
    matrix = np.eye(4)
    matrix[:3, :3] = 0.4 * Rotation.from_euler("z", 40, degrees=True).as_matrix()
    matrix[:3, 3] = [-0.32, 0.44, -0.12]
    scene = moved_splat(demo, tmp_path, matrix)
    kept = set(tmp_path.iterdir())
    words = ["--colmap", demo / "sparse", "--reference", demo / "poses.csv"]
    assert align(*words, scene=scene) == 4
    assert re.search(r"sparse: is not in the frame of the splat: \d+% of the 3D points", error(capsys))
    assert run(["init", str(tmp_path / "moved.ply"), "--colmap", str(demo / "sparse")]) == 4
    assert "or give --up" in error(capsys)
    assert align("--scale", 2, scene=scene) == 0
    kept.add(tmp_path / "m.scene.npz")
    words = ["-o", str(tmp_path / "m.seen.npz"), "--colmap", str(demo / "sparse"), "--size", "0.2"]
    assert run(["observe", str(tmp_path / "m.scene.npz"), *words, "--radius", "0.2"]) == 4
    assert "not in the frame of the splat" in error(capsys)
    assert set(tmp_path.iterdir()) == kept


def test_cameras_without_points_are_said_to_be_unchecked(demo, align, capsys):
    words = ["--cameras", demo / "cameras.csv", "--reference", demo / "poses.csv"]
    assert align(*words, quiet=False) == 0
    assert "could not be checked: they come without 3D points" in capsys.readouterr().err


def test_a_scene_in_coordinates_of_the_earth_gets_an_origin_of_its_own(demo, align, tmp_path, capsys):
    path = tmp_path / "utm.json"
    rotation = np.eye(3).tolist()
    path.write_text(json.dumps({"scale": 2.7, "rotation": rotation, "translation_m": [450003, 4500000, 9]}))
    assert align("--transform", path, quiet=False) == 0
    assert "the map's origin is (450000 4500000 0) m of the world (--map-origin)" in capsys.readouterr().err
    found = read_artifact(tmp_path / "m.scene.npz")
    assert found.manifest.alignment["map_origin_m"] == [450_000, 4_500_000, 0]
    assert found.manifest.alignment["rounding_m"] < 1e-3
    before = read_artifact(demo / "room.scene.npz")["mean"].astype(np.float64)
    np.testing.assert_allclose(found["mean"], 2.7 * before + [3, 0, 9], atol=1e-5)
    assert align("--transform", path, "--map-origin", "0 0 0", output="far.scene.npz", quiet=False) == 0
    assert "put the map's origin nearer to the scene (--map-origin)" in capsys.readouterr().err
    assert align("--transform", path, "--map-origin", "nan 0 0") == 2


def test_the_origin_of_a_map_goes_with_all_that_is_made_of_it(demo, align, tmp_path, capsys):
    origin = ["--map-origin", "12 -7.5 0"]
    assert align("--scale", 2, *origin) == 0
    scene, voxels, cover = (str(tmp_path / f"m.{kind}.npz") for kind in ("scene", "voxels", "cover"))
    assert run(["voxelize", scene, "-o", voxels, "--size", "0.4", "-q"]) == 0
    assert run(["merge", voxels, "-o", cover, "--hulls", "20", "-q"]) == 0
    capsys.readouterr()
    exports = [
        (cover, "json obj stl glb xml usda npz geojson bin h"),
        (voxels, "bt ply pcd"),
        (scene, "obj spz"),
    ]
    for source, suffixes in exports:
        for suffix in suffixes.split():
            out = tmp_path / f"out.{suffix}"
            place = ["--origin", "47", "8", "400"] if suffix == "geojson" else []
            assert run(["export", source, "-o", str(out), *place, "--json", "-f"]) == 0
            assert json.loads(capsys.readouterr().out)["summary"]["map_origin_m"] == [12, -7.5, 0], suffix
            if suffix == "npz":
                assert b'"map_origin_m":[12.0,-7.5,0.0]' in np.load(out)["provenance"].tobytes()
            else:
                assert read_provenance(out).summary["map_origin_m"] == [12, -7.5, 0], suffix
    assert align("--up", "0 0 1", scene=tmp_path / "m.scene.npz", output="up.scene.npz", quiet=False) == 0
    assert "origin of the former alignment, (12 -7.5 0) m, is not kept" in capsys.readouterr().err
    assert align("--scale", 2, "--map-origin", "4512345.25 0 0", output="far.scene.npz", quiet=False) == 0
    assert re.search(r"map_origin_m +4512345\.25 0 0\n", capsys.readouterr().out)
    model = tmp_path / "model"
    assert run(["export", cover, "-o", str(model), "--format", "gazebo", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["summary"]["map_origin_m"] == [12, -7.5, 0]
    assert read_provenance(model / "model.sdf").summary["map_origin_m"] == [12, -7.5, 0]
