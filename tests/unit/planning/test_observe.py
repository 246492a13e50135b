"""Seen space: what is marked in rooms with known walls, its proof, and plans that stay in it."""

import dataclasses

import msgspec
import numpy as np
import pytest

from alula.schemas.artifacts.artifact import make_artifact
from alula.schemas.artifacts.kinds import SCENE, SEEN
from alula.schemas.artifacts.manifest import Similarity
from alula.schemas.errors import InfeasibleError, InputError, UsageError
from alula.schemas.parameters.configs.merge import MergeConfig
from alula.schemas.parameters.configs.observe import ObserveConfig
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.stages.alignment.evidence import Positions
from alula.stages.compression.merge import merge
from alula.stages.compression.voxelize import voxelize
from alula.stages.planning.observe import observe
from alula.stages.planning.pinholes import Pinholes, read_pinholes
from alula.stages.planning.plan import plan
from alula.stages.planning.trajectory import evaluate
from alula.stages.planning.unseen import boxes_of, hulls_of_boxes, is_seen, joined, unseen_hulls
from alula.stages.planning.verify_seen import verify_seen

G = 0.1
LOWER, UPPER = np.array([0.0, 0, 0]), np.array([4.0, 3, 2])


ROOM_OF = {"frame": "world", "unit": "m", "parameters": {}, "summary": {}, "source": {}}


def box_scene(*, hole=None, screen=None, **fields):
    """Flat Gaussians on the walls of a room; `screen`: x of a further wall; `hole`: a ball without any."""
    parts = []
    for axis in range(3):
        others = [i for i in range(3) if i != axis]
        for side in (LOWER, UPPER):
            grid = [np.arange(LOWER[i] + 0.02, UPPER[i], 0.04) for i in others]
            u, v = (each.ravel() for each in np.meshgrid(*grid))
            points = np.full((len(u), 3), side[axis])
            points[:, others[0]], points[:, others[1]] = u, v
            parts.append((points, axis))
    if screen is not None:
        u, v = (each.ravel() for each in np.meshgrid(np.arange(0.02, 3, 0.04), np.arange(0.02, 2, 0.04)))
        parts.append((np.column_stack([np.full_like(u, screen), u, v]), 0))
    mean = np.concatenate([points for points, _ in parts])
    scale = np.concatenate(
        [np.where(np.arange(3) == a, 0.001, 0.03) * np.ones((len(p), 1)) for p, a in parts]
    )
    if hole is not None:
        keep = np.linalg.norm(mean - np.array(hole[:3]), axis=1) > hole[3]
        mean, scale = mean[keep], scale[keep]
    arrays = {
        "mean": mean,
        "scale": scale,
        "quat_wxyz": np.tile([1.0, 0, 0, 0], (len(mean), 1)),
        "opacity": np.ones(len(mean)),
        "color": np.zeros((len(mean), 3)),
    }
    return make_artifact(SCENE, arrays, **ROOM_OF | fields)


def cameras(*places, half=1.0):
    """Cameras at x y z that look along +x or -x, 90 degrees wide."""
    position = np.array([place[:3] for place in places], float)
    axes = np.array([np.array([[0, 0, s], [-s, 0, 0], [0, -1, 0]], float) for *_, s in places])
    names = tuple(f"{i}.jpg" for i in range(len(places)))
    image = np.tile([-half, -half, half, half], (len(places), 1))
    return Pinholes(Positions(names, position, names, axes), image)


MADE = ("schema", "version", "arrays", "producer", "inputs")  # by make_artifact
CONFIG = ObserveConfig(size_m=G, radius_m=0.2, columns=400)
TWO = cameras((0.4, 1.5, 1, 1), (3.6, 1.5, 1, -1))


@pytest.fixture(scope="module")
def room():
    return box_scene()


@pytest.fixture(scope="module")
def seen(room):
    return observe(CONFIG, room, TWO)


def test_the_inside_of_a_room_is_seen_and_nothing_beyond_its_walls(room, seen):
    index = np.asarray(seen["index"], int)
    assert (index * G >= LOWER - 1e-9).all()
    assert ((index + 1) * G <= UPPER + 1e-9).all()
    assert seen.manifest.summary["volume_m3"] > 0.75 * 4 * 3 * 2
    assert (seen["views"] >= 1).all()
    assert seen["views"].max() == 2
    marked = set(map(tuple, np.asarray(voxelize(CONFIG, room)["index"]).tolist()))
    assert marked.isdisjoint(map(tuple, index.tolist()))


def test_a_camera_that_is_rolled_sees_to_all_four_corners_of_its_image(room):
    """Rolled by 45 degrees its image stands on a corner: it reaches as far to the sides as up and down."""
    level = cameras((0.4, 1.5, 1, 1), half=0.4)
    roll = np.array([[1, -1, 0], [1, 1, 0], [0, 0, np.sqrt(2)]]) / np.sqrt(2)
    rolled = Pinholes(dataclasses.replace(level.poses, axes=level.poses.axes @ roll), level.image)
    centre = (np.asarray(observe(CONFIG, room, rolled)["index"]) + 0.5) * G
    y, z = (centre[np.abs(centre[:, 0] - 2.05) < 0.01] - (0, 1.5, 1))[:, 1:].T
    reach = 0.4 * np.sqrt(2) * 1.65  # of the image's corners [m]
    assert (np.abs(y) + np.abs(z) <= reach).all()
    for side in (y, -y, z, -z):
        assert side.max() > reach - 3 * G


def test_space_behind_a_screen_is_unknown(room):
    one = cameras((0.4, 1.5, 1, 1))
    alone = observe(CONFIG, room, one)
    behind = observe(CONFIG, box_scene(screen=2.0), one)
    assert np.asarray(alone["index"])[:, 0].max() * G > 3.5
    assert (np.asarray(behind["index"])[:, 0].max() + 1) * G <= 2.0


def test_space_that_no_ball_reaches_from_a_camera_is_left_out():
    """A screen with a hole 1 m wide: the camera sees through; a ball of 0.15 m passes, of 0.45 m not."""
    scene, one = box_scene(screen=2.0, hole=(2.0, 1.5, 1, 0.5)), cameras((0.4, 1.5, 1, 1))
    small = observe(dataclasses.replace(CONFIG, radius_m=0.15), scene, one)
    large = observe(dataclasses.replace(CONFIG, radius_m=0.45), scene, one)
    assert np.asarray(small["index"])[:, 0].max() * G > 2.5
    assert (np.asarray(large["index"])[:, 0].max() + 1) * G <= 2.3
    assert large.manifest.summary["seen_but_not_reached"] > small.manifest.summary["seen_but_not_reached"]


def test_the_minimum_number_of_views_and_the_range_leave_less(room, seen):
    both = observe(dataclasses.replace(CONFIG, min_views=2), room, TWO)
    assert (both["views"] == 2).all()
    assert 0 < len(both["index"]) < len(seen["index"])
    hole = box_scene(hole=(4, 1.5, 1, 1.4))
    near, far = (
        observe(
            dataclasses.replace(CONFIG, range_m=r, crop=(0, 0, 0, 4, 3, 2)), hole, cameras((0.4, 1.5, 1, 1))
        )
        for r in (1.5, 10.0)
    )
    assert near.manifest.summary["upper_m"][0] < far.manifest.summary["upper_m"][0]


def test_cameras_are_in_the_frame_of_the_splat_file(seen):
    """The same room, aligned by a similarity: cameras given before it see the same voxels."""
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    move = Similarity(scale=2.0, rotation=turn.tolist(), translation_m=[1.0, -2, 0.5])
    back = Similarity(
        scale=0.5, rotation=turn.T.tolist(), translation_m=(-0.5 * turn.T @ [1.0, -2, 0.5]).tolist()
    )
    scene = box_scene(world_from_scene=move)
    found = observe(CONFIG, scene, TWO.moved(back))
    np.testing.assert_array_equal(found["index"], seen["index"])


def test_threads_change_nothing(room, seen):
    other = observe(CONFIG, room, TWO, jobs=3)
    assert msgspec.json.encode(other.manifest) == msgspec.json.encode(seen.manifest)


def test_given_voxels_define_the_level(room):
    voxels = voxelize(dataclasses.replace(CONFIG, size_m=0.2, sigma=2.0), room)
    found = observe(CONFIG, room, TWO, voxels)
    assert (found.manifest.voxel_size_m, found.manifest.sigma) == (0.2, 2.0)
    assert found.manifest.parameters["size_m"] == G  # what was asked for


def test_closed_space_is_taken_without_cameras(room):
    found = observe(dataclasses.replace(CONFIG, reach=(1.0, 1, 1)), room, None)
    assert found.manifest.method == "reach"
    assert not found["views"].any()
    assert found.manifest.summary["volume_m3"] == pytest.approx(3.8 * 2.8 * 1.8, rel=0.02)
    assert "whether it was seen or not" in found.manifest.guarantee.statement


@pytest.mark.parametrize(
    ("scene", "point", "words"),
    [
        (
            {"hole": (4, 1.5, 1, 0.5)},
            (1, 1, 1),
            "is not closed: a ball of 0.2 m leaves the scene's box near (3.95 1.35 1.05)",
        ),
        (
            {},
            (0.05, 1, 1),
            "has no room for a ball of 0.2 m; the nearest place with room is (0.35 0.95 0.95)",
        ),
        ({}, (9, 1, 1), "is outside of the scene's box"),
    ],
)
def test_space_that_is_not_closed_or_not_free_is_refused(scene, point, words):
    with pytest.raises(InfeasibleError) as raised:
        observe(dataclasses.replace(CONFIG, reach=point), box_scene(**scene), None)
    assert words in str(raised.value)


def test_what_makes_no_sense_is_refused(room):
    for config, found in ((CONFIG, None), (dataclasses.replace(CONFIG, reach=(1, 1, 1)), TWO)):
        with pytest.raises(UsageError, match="one of them"):
            observe(config, room, found)
    with pytest.raises(UsageError, match="needs a radius"):
        observe(dataclasses.replace(CONFIG, radius_m=None), room, TWO)
    with pytest.raises(InfeasibleError, match="none of 1 cameras sees a voxel"):
        observe(CONFIG, room, cameras((9, 9, 9, 1)))
    with pytest.raises(InfeasibleError, match="no camera has room for a ball of 1 m"):
        observe(dataclasses.replace(CONFIG, radius_m=1.0), room, cameras((0.4, 1.5, 1, 1)))
    with pytest.raises(InputError, match="run scale-align first"):
        observe(CONFIG, box_scene(unit="arbitrary"), TWO)


def test_the_proof_holds_for_the_file_and_for_no_changed_one(room, seen):
    voxels = voxelize(CONFIG, room)
    good = verify_seen(seen, voxels=voxels, scene=room)
    assert good.covered, good.complaint()
    assert [check.name for check in good.checks] == [
        *("files agree", "voxels lie in the box", "the ball reaches every voxel"),
        *("no voxel is an obstacle's", "no ellipsoid touches a voxel"),
    ]

    def complaint(index, **fields):
        index = np.unique(np.asarray(index, np.int32), axis=0)
        changed = make_artifact(
            SEEN,
            {"index": index, "views": np.ones(len(index), np.uint16)},
            **{f: getattr(seen.manifest, f) for f in SEEN.manifest.__struct_fields__ if f not in MADE}
            | fields,
        )
        found = verify_seen(changed, voxels=voxels, scene=room)
        assert not found.covered
        return found.complaint()

    index = np.asarray(seen["index"])
    wall = np.asarray(voxels["index"])[len(voxels["index"]) // 2]
    assert "the ball reaches every voxel" in complaint(np.vstack([index, wall]))
    lone = index[(index[:, 0] < 18) | (index[:, 0] > 21)]
    assert "the ball reaches every voxel" in complaint(lone, started_from=seen.manifest.started_from[:1])
    assert "does not fit where it starts" in complaint(index, started_from=[[0, 0, 0]])
    assert "voxels lie in the box" in complaint(np.vstack([index, [500, 0, 0]]))
    assert "sigma of the seen voxels is 2.0, of the voxels 1.0" in complaint(index, sigma=2.0)
    unreached = verify_seen(seen, voxels=voxels, scene=box_scene(screen=2.0))
    assert "no ellipsoid touches a voxel" in unreached.complaint()


@pytest.mark.parametrize(
    ("level", "words"),
    [
        ({"min_opacity": 0.9}, "300 Gaussians of opacity below 0.9"),
        ({"min_overlap": 4}, "voxels that fewer than 4 ellipsoids touch"),
    ],
)
def test_the_verdict_names_what_the_level_leaves_out_and_counts_what_it_touches(level, words):
    """A thin ball of Gaussians stands in the room, and the level does not count it."""
    whole = box_scene()
    thin = np.asarray(whole["mean"])[:300] * 0.02 + np.array([2.0, 1.5, 1.0])
    arrays = {
        "mean": np.concatenate([whole["mean"], thin]),
        "scale": np.concatenate([whole["scale"], np.full((300, 3), 0.005, np.float32)]),
        "quat_wxyz": np.concatenate([whole["quat_wxyz"], whole["quat_wxyz"][:300]]),
        "opacity": np.concatenate([whole["opacity"], np.full(300, 0.5, np.float32)]),
        "color": np.concatenate([whole["color"], whole["color"][:300]]),
    }
    if "min_overlap" in level:
        arrays = {name: rows[: -300 + 3] for name, rows in arrays.items()}  # fewer than are needed
    scene = make_artifact(SCENE, arrays, **ROOM_OF)
    config = dataclasses.replace(CONFIG, reach=(0.6, 1.5, 1.0), radius_m=0.11, **level)
    seen = observe(config, scene, None)
    found = verify_seen(seen, scene=scene)
    assert found.covered, found.complaint()
    assert "touched by no retained obstacle at 1 sigma" in found.statement
    assert words in found.statement
    assert found.omits == [words]
    index = {tuple(voxel) for voxel in np.asarray(seen["index"]).tolist()}
    centres = arrays["mean"][len(whole["mean"]) :]
    inside = index & {tuple(voxel) for voxel in np.floor(centres / G).astype(int).tolist()}
    assert inside  # the truth: seen voxels with centres of Gaussians in them
    touched = int(found.statement.split(" may touch ")[1].split(" of ")[0])
    assert touched >= len(inside)
    assert words.removeprefix("300 ") in verify_seen(seen, voxels=voxelize(config, scene)).statement
    opaque = make_artifact(SCENE, arrays | {"opacity": np.ones(len(arrays["opacity"]))}, **ROOM_OF)
    if "min_opacity" in level:  # where nothing is below the minimum, nothing is left out
        every = observe(config, opaque, None)
        assert verify_seen(every, scene=opaque).omits == []


def test_boxes_fill_what_is_marked_once():
    rng = np.random.default_rng(0)
    for share in (0.0, 0.1, 0.5, 0.95, 1.0):
        mask = rng.random((6, 7, 8)) < share
        lower, upper = boxes_of(mask)
        count = np.zeros(mask.shape, int)
        for low, high in zip(lower, upper, strict=True):
            count[tuple(slice(a, b) for a, b in zip(low, high, strict=True))] += 1
        np.testing.assert_array_equal(count, mask)


def test_every_point_is_in_seen_space_or_in_a_box(seen):
    hulls = unseen_hulls(seen)
    rng = np.random.default_rng(1)
    index = np.asarray(seen["index"], float)
    points = (
        rng.uniform(index.min(axis=0) - 1, index.max(axis=0) + 2, (20_000, 3)) * G
    )  # and one voxel around
    lower, upper = hulls.bounds()
    boxed = np.zeros(len(points), bool)
    for low, high in zip(lower, upper, strict=True):
        boxed |= ((points >= low) & (points <= high)).all(axis=1)
    np.testing.assert_array_equal(boxed, ~is_seen(seen, points))
    some = unseen_hulls(seen, lower_m=(0, 0, 0), upper_m=(0.5, 2, 1))
    assert 0 < len(some) < len(hulls)


def test_joined_polytopes_keep_their_planes_and_vertices():
    one, two = (hulls_of_boxes(np.full((n, 3), 1.0 * n), np.full((n, 3), 2.0 + n)) for n in (1, 2))
    both = joined([one, two])
    assert len(both) == 3
    np.testing.assert_array_equal(both.bounds()[1], np.concatenate([one.bounds()[1], two.bounds()[1]]))
    np.testing.assert_array_equal(both.plane_start, [0, 6, 12, 18])


def test_a_plan_stays_with_its_whole_ball_in_seen_space(room):
    """A room with a second half that only its far camera sees: without it, the plan is refused."""
    scene = box_scene(screen=2.0, hole=(2.0, 1.5, 1, 0.6))
    cover = merge(MergeConfig(hulls=60), voxelize(CONFIG, scene))
    config = PlanConfig(beyond_map_m=3.0, start=(1.3, 1.5, 1.0), goal=(2.8, 1.6, 1.2), radius_m=0.2)
    both = observe(CONFIG, scene, TWO)
    made = plan(config, cover, within=both)
    assert made.manifest.guarantee.claims["within_seen_space"] is True
    assert "every point that was not seen" in made.manifest.guarantee.statement
    time = np.linspace(0, made["time"][-1], 400)
    path = evaluate(np.asarray(made["time"]), np.asarray(made["coefficient"])[:, :3], time)
    rng = np.random.default_rng(2)
    ball = rng.normal(size=(300, 3))
    ball *= 0.2 * (1 - 1e-9) / np.linalg.norm(ball, axis=1, keepdims=True)
    assert is_seen(both, (path[:, None] + ball).reshape(-1, 3)).all()
    near = observe(CONFIG, scene, cameras((0.4, 1.5, 1, 1)))
    with pytest.raises(InfeasibleError, match=r"the goal \(2.3 2.6 1\) is not in the space that was seen"):
        plan(dataclasses.replace(config, goal=(2.3, 2.6, 1.0)), cover, within=near)
    edge = dataclasses.replace(config, goal=(2.8, 1.6, 0.34))
    with pytest.raises(InfeasibleError, match=r"the goal .* m from space that was not seen, .* keep 0.2 m"):
        plan(edge, cover, within=both)


CAMERA_LINES = {
    "PINHOLE": "1 PINHOLE 400 300 200 210 190 160",
    "OPENCV": "1 OPENCV 400 300 200 200 200 150 -0.25 0.06 0.002 -0.001",
    "pincushion": "1 SIMPLE_RADIAL 400 300 300 200 150 0.2",
    "OPENCV_FISHEYE": "1 OPENCV_FISHEYE 400 300 110 110 200 150 0.01 0 0 0",
}


def write_model(folder, line):
    folder.mkdir()
    (folder / "cameras.txt").write_text(line + "\n")
    (folder / "images.txt").write_text("1 1 0 0 0 0.5 0 1 1 a.jpg\n\n2 0.5 0.5 -0.5 0.5 0 0 2 1 b.jpg\n\n")
    (folder / "points3D.txt").write_text("")
    return folder


@pytest.mark.parametrize("name", CAMERA_LINES)
def test_all_rays_of_the_rectangle_are_in_the_photograph(tmp_path, name):
    pycolmap = pytest.importorskip("pycolmap")
    found = read_pinholes(write_model(tmp_path / "model", CAMERA_LINES[name]))
    assert len(found) == 2
    left, top, right, bottom = found.image[0]
    words = CAMERA_LINES[name].split()
    camera = pycolmap.Camera(
        model=words[1], width=int(words[2]), height=int(words[3]), params=[float(w) for w in words[4:]]
    )
    rng = np.random.default_rng(3)
    rays = np.column_stack([rng.uniform(left, right, 5000), rng.uniform(top, bottom, 5000), np.ones(5000)])
    pixel = np.asarray(camera.img_from_cam(rays))
    assert (pixel >= -1e-3).all()
    assert (pixel <= np.array([400, 300]) + 1e-3).all()
    area = (right - left) * (bottom - top)
    edge = np.asarray(camera.cam_from_img(np.array([[0.0, 150], [400, 150], [200, 0], [200, 300]])))
    widest = (min(edge[1, 0], 2) - max(edge[0, 0], -2)) * (min(edge[3, 1], 2) - max(edge[2, 1], -2))
    assert area > 0.6 * widest
    if name == "PINHOLE":
        np.testing.assert_allclose(found.image[0], [-190 / 200, -160 / 210, 210 / 200, 140 / 210])


def test_a_camera_without_a_perspective_image_is_refused(tmp_path):
    pytest.importorskip("pycolmap")
    folder = write_model(tmp_path / "model", "1 EQUIRECTANGULAR 400 200 400 200")
    with pytest.raises(
        InputError, match=r"EQUIRECTANGULAR is no perspective camera|no readable COLMAP model"
    ):
        read_pinholes(folder)


def test_cameras_of_a_real_capture_see_the_space_in_front_of_its_points(data):
    """A COLMAP model with distortion. No capture has both a splat and cameras: points are balls."""
    pycolmap = pytest.importorskip("pycolmap")
    folder = data / "colmap-sceaux/colmap_example_model_txt"
    found = read_pinholes(folder)
    assert len(found) == 11
    model = pycolmap.Reconstruction(str(folder))
    points = np.array([p.xyz for p in model.points3D.values() if p.track.length() > 2])
    distance = np.median(np.linalg.norm(points - found.poses.position.mean(axis=0), axis=1))
    scale = 20.0 / distance  # some scale in metres: half of the points are 20 m away
    mean = points * scale
    arrays = {
        "mean": mean,
        "scale": np.full((len(mean), 3), 0.2),
        "quat_wxyz": np.tile([1.0, 0, 0, 0], (len(mean), 1)),
        "opacity": np.ones(len(mean)),
        "color": np.zeros((len(mean), 3)),
    }
    scaled = Similarity(scale=float(scale), rotation=np.eye(3).tolist(), translation_m=[0.0, 0, 0])
    scene = make_artifact(
        SCENE, arrays, frame="world", unit="m", parameters={}, summary={}, source={}, world_from_scene=scaled
    )
    centre = found.poses.position.mean(axis=0) * scale
    crop = (*(centre - 12).tolist(), *(centre + 12).tolist())
    config = ObserveConfig(size_m=0.5, radius_m=0.5, range_m=10.0, crop=crop)
    seen = observe(config, scene, found)
    assert seen.manifest.summary["cameras_next_to_reached_space"] >= 1
    assert len(seen["index"]) > 300
    assert verify_seen(seen, scene=scene, voxels=voxelize(config, scene)).covered
