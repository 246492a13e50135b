"""Depth images of ellipsoids are lower bounds, and voxels in front of them are seen: against samples."""

import numpy as np
import pytest

from alula import _core
from alula.stages.rotation import matrix_from_quat_wxyz
from support.effort import examples

NEAR, RANGE = 0.1, 50.0


def random_rotation(rng):
    q = rng.normal(size=4)
    return matrix_from_quat_wxyz(q / np.linalg.norm(q))


def random_camera(rng, pixels=60):
    image = np.array(
        [[-rng.uniform(0.2, 1.2), -rng.uniform(0.2, 1), rng.uniform(0.2, 1.2), rng.uniform(0.2, 1)]]
    )
    return {
        "rotation": random_rotation(rng)[None],
        "centre": rng.normal(size=(1, 3)) * 3,
        "image": image,
        "pixels": rng.integers(3, pixels, (1, 2)),
    }


def surface(rng, mean, scale, quat, k, radius, count):
    """Points on the boundary of ellipsoid + ball, and inside of the ellipsoid."""
    unit = rng.normal(size=(count, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    q = quat.astype(float)
    R, axes = matrix_from_quat_wxyz(q / np.linalg.norm(q)), k * scale.astype(float)
    normal = (unit / axes) @ R.T
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    outer = mean + (unit * axes) @ R.T + radius * normal
    return np.concatenate([outer, mean + (unit * rng.random((count, 1)) * axes) @ R.T])


def nearness_of(points, camera):
    """Largest 1 / z of points in each pixel, and their number."""
    x = (points - camera["centre"][0]) @ camera["rotation"][0].T
    x = x[x[:, 2] > 1e-9]
    left, top, right, bottom = camera["image"][0]
    columns, rows = camera["pixels"][0]
    column = np.floor((x[:, 0] / x[:, 2] - left) / (right - left) * columns).astype(int)
    row = np.floor((x[:, 1] / x[:, 2] - top) / (bottom - top) * rows).astype(int)
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    largest, number = np.zeros((rows, columns)), np.zeros((rows, columns), int)
    np.maximum.at(largest, (row[inside], column[inside]), 1 / x[inside, 2])
    np.add.at(number, (row[inside], column[inside]), 1)
    return largest, number


def random_ellipsoid(rng, camera):
    """One that may be anywhere around the camera, also around or behind it, as thin as 0.1 mm."""
    place = np.array([rng.normal() * 1.5, rng.normal() * 1.5, rng.uniform(-1, 5)])
    mean = (camera["rotation"][0].T @ place + camera["centre"][0]).astype(np.float32)
    scale = np.exp(rng.uniform(np.log(1e-4), np.log(3), 3)).astype(np.float32)
    quat = rng.normal(size=4).astype(np.float32)
    return mean, scale, quat


@pytest.mark.parametrize("seed", range(examples(20)))
def test_no_point_of_an_ellipsoid_is_nearer_than_its_pixel_says(seed):
    rng = np.random.default_rng(seed)
    crossing = 0
    for _ in range(30):
        camera = random_camera(rng)
        mean, scale, quat = random_ellipsoid(rng, camera)
        k, radius = rng.uniform(0.3, 2), rng.choice([0, 0, 0.01, 0.2])
        occluder = _core.Occluders(mean[None], scale[None], quat[None], k, radius)
        found, blind = occluder.depth(**camera, near=NEAR, range=RANGE)
        points = surface(rng, mean.astype(float), scale, quat, k, radius, 10_000)
        depth = (points - camera["centre"][0]) @ camera["rotation"][0][2]
        crossing += depth.min() < 0 < depth.max()
        if not blind:
            largest, _ = nearness_of(points, camera)
            assert (largest <= found).all()
    assert crossing >= 1


def test_a_pixel_is_as_deep_as_its_nearest_surface_point_and_not_blinded_by_a_neighbour():
    """A large thin disc, seen at a grazing angle: the bound is exact, not that of the whole disc."""
    rng = np.random.default_rng(3)
    camera = {
        "rotation": np.array([[[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]]),  # looks along y, z is up
        "centre": np.array([[0.0, 0, 1]]),
        "image": np.array([[-1.0, -1, 1, 1]]),
        "pixels": np.array([[40, 40]]),
    }
    mean = np.array([[0, 5, 0]], np.float32)
    scale, quat = np.array([[4, 4, 1e-3]], np.float32), np.array([[1, 0, 0, 0]], np.float32)
    found, blind = _core.Occluders(mean, scale, quat, 1.0).depth(**camera, near=NEAR, range=RANGE)
    assert not blind
    largest, number = nearness_of(
        surface(rng, mean[0].astype(float), scale[0], quat[0], 1.0, 0.0, 400_000), camera
    )
    often = number > 400
    assert often.sum() > 100
    assert (found[often] <= largest[often] * 1.02).all()
    assert (found[:20] == found.min()).all()  # nothing above the horizon
    assert found.min() == pytest.approx(1 / RANGE)
    assert np.ptp(1 / found[often]) > 4


def test_a_large_ellipsoid_that_reaches_behind_the_camera_hides_only_its_side():
    """A floor below the camera, from behind it to far ahead: pixels above the horizon stay free."""
    camera = {
        "rotation": np.array([[[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]]),
        "centre": np.array([[0.0, 0, 1.5]]),
        "image": np.array([[-1.0, -1, 1, 1]]),
        "pixels": np.array([[64, 64]]),
    }
    mean, scale = np.array([[0, 2, 0]], np.float32), np.array([[10, 10, 1e-3]], np.float32)
    occluder = _core.Occluders(mean, scale, np.array([[1, 0, 0, 0]], np.float32), 1.0)
    found, blind = occluder.depth(**camera, near=NEAR, range=RANGE)
    assert not blind
    assert (found[:32] == found.min()).all()
    down = 1 / found[-1]  # y/z = 1 or a little less there: the floor is 1.5 m deep
    assert (down <= 1.5 * 1.04).all()
    assert (down >= 1.5 * 0.5).all()


def test_a_camera_inside_of_an_ellipsoid_is_blind():
    rng = np.random.default_rng(1)
    camera = random_camera(rng)
    mean = camera["centre"].astype(np.float32)
    scale, quat = np.full((1, 3), 0.2, np.float32), np.array([[1, 0, 0, 0]], np.float32)
    assert _core.Occluders(mean, scale, quat, 1.0).depth(**camera, near=NEAR, range=RANGE)[1]


def seen_by(occluders, camera, size, jobs=1, blocked=None, near=NEAR, range=RANGE, margin=0.0):
    shape = (24, 22, 20)
    blocked = np.zeros(shape, np.uint8) if blocked is None else blocked
    lower = (-12, -11, -10)
    answer = _core.observe(
        occluders, **camera, near=near, range=range, voxel_size=size, lower=lower, blocked=blocked,
        margin=margin, jobs=jobs,
    )  # fmt: skip
    return answer, np.array(lower)


def random_scene(rng, count=30):
    mean = rng.uniform(-4, 4, (count, 3)).astype(np.float32)
    scale = np.exp(rng.uniform(np.log(0.01), np.log(1), (count, 3))).astype(np.float32)
    return mean, scale, rng.normal(size=(count, 4)).astype(np.float32)


def is_hidden(points, centre, mean, scale, quat):
    """Whether an ellipsoid meets the segment from the camera to each point, from a quadratic equation."""
    hidden = np.zeros(len(points), bool)
    for m, s, q in zip(mean.astype(float), scale.astype(float), quat.astype(float), strict=True):
        inverse = matrix_from_quat_wxyz(q / np.linalg.norm(q)).T / s[:, None]
        start, way = inverse @ (centre - m), (points - centre) @ inverse.T
        at = np.clip(-(way @ start) / (way**2).sum(axis=1), 0, 1)
        hidden |= ((start + at[:, None] * way) ** 2).sum(axis=1) <= 1
    return hidden


@pytest.mark.parametrize("seed", range(examples(20)))
def test_every_ray_to_a_seen_voxel_is_free_and_in_the_image(seed):
    rng = np.random.default_rng(seed)
    total = 0
    for i in range(30):
        if i >= 3 and total > 0:  # some cameras see nothing
            break
        scene, camera = random_scene(rng, 12), random_camera(rng, 200)
        (views, count, _), lower = seen_by(_core.Occluders(*scene, 1.0), camera, 0.25, range=6.0)
        voxel = np.argwhere(views) + lower
        assert count[0] == len(voxel)
        total += len(voxel)
        points = ((voxel[:, None] + rng.random((1, 40, 3))) * 0.25).reshape(-1, 3)
        centre = camera["centre"][0]
        assert not is_hidden(points, centre, *scene).any()
        x = (points - centre) @ camera["rotation"][0].T
        assert (x[:, 2] >= NEAR).all()
        ray = x[:, :2] / x[:, 2:]
        assert (ray >= camera["image"][0, :2]).all()
        assert (ray <= camera["image"][0, 2:]).all()
    assert total > 0


def test_most_voxels_with_free_rays_are_seen():
    """Of voxels whose surroundings, half a voxel wide, are in sight, nearly all are marked."""
    rng = np.random.default_rng(11)
    free = seen = 0
    for _ in range(5):
        scene, camera = random_scene(rng, 15), random_camera(rng)
        camera["pixels"] = np.array([[400, 400]])
        (views, _, blind), lower = seen_by(_core.Occluders(*scene, 1.0), camera, 0.25, range=50.0)
        if blind[0]:
            continue
        voxel = np.argwhere(np.ones(views.shape, bool)) + lower
        centre = camera["centre"][0]
        good = np.ones(len(voxel), bool)
        for offset in 0.5 + 0.75 * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, 8).T:
            points = (voxel + offset) * 0.25
            x = (points - centre) @ camera["rotation"][0].T
            ray = x[:, :2] / x[:, 2:]
            good &= (x[:, 2] > NEAR) & (ray >= camera["image"][0, :2]).all(axis=1)
            good &= (ray <= camera["image"][0, 2:]).all(axis=1) & ~is_hidden(points, centre, *scene)
        free += good.sum()
        seen += (views.ravel()[good] > 0).sum()
    assert free > 300
    assert seen > 0.95 * free


def test_the_result_does_not_depend_on_the_number_of_threads():
    rng = np.random.default_rng(5)
    scene = random_scene(rng)
    cameras = [random_camera(rng) for _ in range(9)]
    camera = {name: np.concatenate([each[name] for each in cameras]) for name in cameras[0]}
    blocked = (rng.random((24, 22, 20)) < 0.01).astype(np.uint8)
    first, _ = seen_by(_core.Occluders(*scene, 1.0, jobs=1), camera, 0.25, jobs=1, blocked=blocked)
    other, _ = seen_by(_core.Occluders(*scene, 1.0, jobs=4), camera, 0.25, jobs=4, blocked=blocked)
    assert first[0].max() > 1
    for one, two in zip(first, other, strict=True):
        np.testing.assert_array_equal(one, two)
    assert not first[0][blocked > 0].any()


def forward_camera(place=(-2.9, 0.05, 0.05)):
    """Looks along x."""
    return {
        "rotation": np.array([[[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]]),
        "centre": np.array([place]),
        "image": np.array([[-1.0, -1, 1, 1]]),
        "pixels": np.array([[200, 200]]),
    }


def test_a_blocked_voxel_closes_the_gap_between_ellipsoids_behind_it():
    """A wall of voxels without ellipsoids that block the view: nothing behind it is seen."""
    far = (
        np.array([[100, 0, 0]], np.float32),
        np.full((1, 3), 0.1, np.float32),
        np.array([[1, 0, 0, 0]], np.float32),
    )
    blocked = np.zeros((24, 22, 20), np.uint8)
    blocked[12] = 1
    (views, _, _), _ = seen_by(_core.Occluders(*far, 1.0), forward_camera(), 0.25, blocked=blocked)
    assert views[:12].any()
    assert not views[12:].any()


def test_a_pixel_without_a_surface_sees_up_to_the_range_and_one_with_a_surface_up_to_it():
    """A disc at x = 2.4 fills the lower half of the image; the range is 3 m from x = -2.9."""
    mean = np.array([[2.4, 0, -4.1]], np.float32)
    scale = np.array([[0.01, 40, 4.0]], np.float32)
    occluder = _core.Occluders(mean, scale, np.array([[1, 0, 0, 0]], np.float32), 1.0)
    (views, _, _), lower = seen_by(occluder, forward_camera(), 0.25, range=3.0)
    voxel = np.argwhere(views) + lower
    above, below = voxel[voxel[:, 2] >= 1], voxel[voxel[:, 2] < -2]
    assert (above[:, 0].max() + 1) * 0.25 == 0.0  # 2.9 m deep; a voxel more is 3.15 m
    assert (below[:, 0].max() + 1) * 0.25 == 2.25


def test_the_margin_keeps_voxels_from_the_edge_of_the_image():
    far = (
        np.array([[100, 0, 0]], np.float32),
        np.full((1, 3), 0.1, np.float32),
        np.array([[1, 0, 0, 0]], np.float32),
    )
    counts = [
        int(seen_by(_core.Occluders(*far, 1.0), forward_camera(), 0.25, margin=margin)[0][1][0])
        for margin in (0.0, 0.1, 0.5)
    ]
    assert counts[0] > counts[1] > counts[2] > 0


def test_malformed_cameras_are_refused():
    far = (
        np.array([[100, 0, 0]], np.float32),
        np.full((1, 3), 0.1, np.float32),
        np.array([[1, 0, 0, 0]], np.float32),
    )
    occluder = _core.Occluders(*far, 1.0)
    for name, value in (
        ("centre", np.array([[np.nan, 0, 0]])),
        ("image", np.array([[1.0, -1, 1, 1]])),
        ("pixels", np.array([[0, 10]])),
        ("rotation", np.zeros((2, 3, 3))),
    ):
        with pytest.raises(ValueError, match=r"camera|number of rows"):
            occluder.depth(**forward_camera() | {name: value}, near=NEAR, range=RANGE)
