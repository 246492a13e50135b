"""The frame of a splat against its COLMAP model, when the trainer moved and scaled the model."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from alula.schemas.errors import CheckError
from alula.schemas.parameters.configs.demo_scene import DemoSceneConfig
from alula.stages.alignment.evidence import Landmarks
from alula.stages.alignment.model_frame import model_frame
from alula.stages.reconstruction.demo_cameras import demo_cameras
from alula.stages.reconstruction.demo_scene import demo_scene
from alula.stages.rotation import matrix_from_quat_wxyz

MIN_NEAR = 0.6


def unit(v):
    return v / np.linalg.norm(v)


def turn_onto(a, b):
    """Smallest rotation from a to b, by axis and angle."""
    axis, cosine = np.cross(a, b), a @ b
    angle = np.arctan2(np.linalg.norm(axis), cosine)
    return Rotation.from_rotvec(angle * unit(axis)).as_matrix()


def gsplat(points, cameras, axes):
    """4x4 of gsplat's examples/datasets/normalize.py: similarity_from_cameras, then align_principal_axes."""
    up = unit(np.mean(-axes[:, :, 1], axis=0))
    R = turn_onto(up, np.array([0.0, -1.0, 0.0]))
    t, forward = cameras @ R.T, axes[:, :, 2] @ R.T
    nearest = t + (forward * -t).sum(-1)[:, None] * forward
    shift = -np.median(nearest, axis=0)
    first = np.eye(4)
    first[:3, :3], first[:3, 3] = R, shift
    first[:3] *= 1 / np.median(np.linalg.norm(t + shift, axis=-1))
    moved = points @ first[:3, :3].T + first[:3, 3]
    centroid = np.median(moved, axis=0)
    values, vectors = np.linalg.eigh(np.cov(moved - centroid, rowvar=False))
    vectors = vectors[:, values.argsort()[::-1]]
    if np.linalg.det(vectors) < 0:
        vectors[:, 0] *= -1
    second = np.eye(4)
    second[:3, :3], second[:3, 3] = vectors.T, -vectors.T @ centroid
    if np.median((moved @ vectors)[:, 2]) > np.mean((moved @ vectors)[:, 2]):  # upside down
        second = np.diag([1.0, -1.0, -1.0, 1.0]) @ second
    return second @ first


def nerfstudio(points, cameras, axes):
    """4x4 of today's ns-process-data and the dataparser's orientation "up", centre "poses" and scale."""
    world = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    up = unit(np.mean(-axes[:, :, 1], axis=0) @ world.T)
    R = turn_onto(up, np.array([0.0, 0.0, 1.0])) @ world
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = R, -R @ cameras.mean(axis=0)
    matrix[:3] /= np.abs(cameras @ R.T + matrix[:3, 3]).max()
    return matrix


def opensplat(points, cameras, axes):
    centre = cameras.mean(axis=0)
    matrix = np.eye(4)
    matrix[:3, 3] = -centre
    matrix[:3] /= np.abs(cameras - centre).max()
    return matrix


def exported(points, cameras, axes):
    """OpenSplat's frame, written with y up."""
    return np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]) @ opensplat(
        points, cameras, axes
    )


def apply(matrix, points):
    return points @ matrix[:3, :3].T + matrix[:3, 3]


@pytest.fixture(scope="module")
def room():
    """Visible Gaussians of the built-in room, and a model of its cameras with noisy points beside them."""
    splats = demo_scene(DemoSceneConfig(gaussians=20_000), 5)
    rng = np.random.default_rng(5)
    visible = np.flatnonzero(splats.opacity >= 0.1)
    mean = splats.mean.astype(np.float64)
    chosen = rng.choice(np.flatnonzero(splats.opacity > 0.9), 1200, replace=False)
    others = np.setdiff1d(visible, chosen)  # no point lies on a Gaussian that is judged
    cameras = demo_cameras(60, 5)
    axes = matrix_from_quat_wxyz(cameras.quat_camera_scene_wxyz).swapaxes(1, 2)
    points = mean[chosen] + 0.004 * rng.standard_normal((1200, 3))
    return mean[others], Landmarks("sparse", points, cameras.centre_scene, axes)


def framed(landmarks, centres):
    return model_frame(landmarks, lambda: centres, MIN_NEAR)


def test_a_model_in_the_splats_frame_stays_as_it_is(room):
    centres, landmarks = room
    found = framed(landmarks, centres)
    assert found.scene_from_model is None
    assert found.facts["near"] > 0.95
    assert found.warnings == ()
    assert found.position_error(centres.min(axis=0), centres.max(axis=0)) == 0


@pytest.mark.every(4)
@pytest.mark.parametrize(
    ("trainer", "kind"),
    [
        (gsplat, "whole"),
        (nerfstudio, "half of the splat"),
        (opensplat, "a tenth of the points are outliers"),
        (exported, "whole"),
        pytest.param(gsplat, "half of the splat", marks=pytest.mark.slow),
        pytest.param(opensplat, "half of the splat", marks=pytest.mark.slow),
        pytest.param(gsplat, "a tenth of the points are outliers", marks=pytest.mark.slow),
        pytest.param(nerfstudio, "a tenth of the points are outliers", marks=pytest.mark.slow),
    ],
)
def test_the_frames_of_trainers_are_found_to_within_their_bound(room, trainer, kind):
    centres, landmarks = room
    points = landmarks.points
    if kind.startswith("half"):
        centres = centres[centres[:, 0] < np.median(centres[:, 0])]
    if kind.startswith("a tenth"):
        rng = np.random.default_rng(1)
        low, high = points.min(axis=0), points.max(axis=0)
        points = np.concatenate([points, rng.uniform(low, high, (len(points) // 9, 3))])
        landmarks = Landmarks("sparse", points, landmarks.cameras, landmarks.axes)
    matrix = trainer(points, landmarks.cameras, landmarks.axes)
    moved = apply(matrix, centres).astype(np.float32).astype(np.float64)
    found = framed(landmarks, moved)
    before = found.facts["before"]
    assert before["near"] * before["inside"] < 0.3
    assert found.scene_from_model is not None
    bound = found.position_error(moved.min(axis=0), moved.max(axis=0))
    S = found.scene_from_model
    there = S.scale * centres @ np.array(S.rotation).T + S.translation_m
    assert np.linalg.norm(there - moved, axis=1).max() <= bound
    assert bound <= 0.02 * np.linalg.norm(np.ptp(moved, axis=0))
    assert "not in the frame of the splat" in found.warnings[0]


@pytest.mark.slow
def test_a_trainer_that_rounds_its_frame_is_followed_by_icp(room):
    centres, landmarks = room
    matrix = gsplat(landmarks.points[::2], landmarks.cameras[:-3], landmarks.axes[:-3])  # not all were used
    moved = apply(matrix, centres)
    found = framed(landmarks, moved)
    there = apply(matrix, landmarks.points)
    S = found.scene_from_model
    assert S is not None
    error = np.linalg.norm(
        S.scale * landmarks.points @ np.array(S.rotation).T + S.translation_m - there, axis=1
    )
    assert error.max() <= found.position_error(moved.min(axis=0), moved.max(axis=0))


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 20))])
def test_a_frame_of_no_known_trainer_is_refused_with_the_fraction(room, seed):
    centres, landmarks = room
    rng = np.random.default_rng(seed)
    matrix = np.eye(4)
    matrix[:3, :3] = np.exp(rng.uniform(-1, 1)) * Rotation.random(random_state=seed).as_matrix()
    matrix[:3, 3] = rng.standard_normal(3)
    with pytest.raises(
        CheckError, match=r"not in the frame of the splat: \d+% of the 3D points .*--nerfstudio"
    ):
        framed(landmarks, apply(matrix, centres))


def test_a_mirrored_splat_is_refused(room):
    centres, landmarks = room
    for mirror in (np.diag([-1.0, 1, 1, 1]), np.diag([1.0, 1, -1, 1]) @ np.diag([0.4, 0.4, 0.4, 1])):
        with pytest.raises(CheckError, match="not in the frame of the splat"):
            framed(landmarks, apply(mirror, centres))


def box(count, seed, sides):
    """Points on the six faces of a box around the origin."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (count, 3))
    points[np.arange(count), rng.integers(0, 3, count)] = np.sign(rng.uniform(-1, 1, count))
    return points * sides


def cameras_in(sides):
    angle = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    where = np.stack([0.5 * np.cos(angle), 0.5 * np.sin(angle), 0 * angle + 0.1], axis=1) * sides
    level = [Rotation.from_euler("zx", [a, -np.pi / 2]).as_matrix() for a in angle]
    return where, np.array(level)


def test_two_frames_that_fit_alike_are_refused():
    sides = np.array([4.0, 3.0, 1.2])
    landmarks = Landmarks("box", box(1000, 0, sides), *cameras_in(sides))
    centres = box(20_000, 1, sides)
    matrix = opensplat(landmarks.points, landmarks.cameras, landmarks.axes)
    with pytest.raises(CheckError, match="two frames fit it"):
        framed(landmarks, apply(matrix, centres))


def test_a_plane_does_not_determine_a_frame():
    rng = np.random.default_rng(0)
    flat = lambda n: np.column_stack([rng.uniform(-5, 5, (n, 2)), np.zeros(n)])  # noqa: E731
    cameras, axes = cameras_in(np.array([4.0, 3.0, 1.0]))
    cameras[:, 2] += 3
    landmarks = Landmarks("field", flat(2000), cameras, axes)
    matrix = opensplat(landmarks.points, landmarks.cameras, landmarks.axes)
    with pytest.raises(CheckError, match=r"two frames fit it|has no bound"):
        framed(landmarks, apply(matrix, flat(20_000)))


def test_a_model_with_few_points_is_not_judged(room):
    centres, landmarks = room
    few = Landmarks("sparse", landmarks.points[:49], landmarks.cameras, landmarks.axes)
    found = framed(few, centres + 100)
    assert found.scene_from_model is None
    assert "could not be checked: sparse has 49 3D points" in found.warnings[0]


def test_a_smaller_fraction_may_be_admitted_and_is_said(room):
    centres, landmarks = room
    found = model_frame(landmarks, lambda: centres + 0.3, 0.0)
    assert found.scene_from_model is None
    assert "--min-near admits it" in found.warnings[0]
