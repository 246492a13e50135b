"""Seen space of the built-in room, against the geometry that the room was made from."""

import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import read_artifact
from alula.stages.alignment.similarity import transform_points
from alula.stages.reconstruction.demo_cameras import demo_cameras
from alula.stages.reconstruction.demo_scene import world_from_scene
from alula.stages.reconstruction.room import SIZE
from alula.stages.rotation import matrix_from_quat_wxyz
from support.models.room_oracle import Room

HALF = np.array([1280, 720]) / 2 / 720  # of the image, as x/z and y/z


def observed(folder, gaussians, images, size):
    f = lambda name: str(folder / name)  # noqa: E731
    align = ["--colmap", f("colmap"), "--reference", f("reference.csv"), "--max-rms", "0.02"]
    for step in (
        ["demo-scene", "-o", f("room.ply"), "--gaussians", gaussians, "--images", images, *align[:4]],
        ["import-splat", f("room.ply"), "-o", f("a.scene.npz"), "--min-opacity", "0.1", "--drop-floaters"],
        ["scale-align", f("a.scene.npz"), "-o", f("m.scene.npz"), *align],
        ["voxelize", f("m.scene.npz"), "-o", f("m.voxels.npz"), "--size", size],
        [
            *("observe", f("m.scene.npz"), "--voxels", f("m.voxels.npz"), "--colmap", f("colmap")),
            *("-o", f("m.seen.npz"), "--radius", "0.075"),
        ],
        ["verify", f("m.seen.npz"), "--voxels", f("m.voxels.npz"), "--scene", f("m.scene.npz")],
    ):
        assert run([*map(str, step), "-q"]) == 0, step
    return read_artifact(folder / "m.seen.npz"), read_artifact(folder / "m.voxels.npz")


def seen_by_two(room, voxel, size, images):
    """Voxels whose centre and corners at least two cameras see, by the true poses and surfaces."""
    cameras = demo_cameras(images, 0)
    frame = world_from_scene()
    centre = transform_points(frame, cameras.centre_scene)
    rotation = matrix_from_quat_wxyz(cameras.quat_camera_scene_wxyz) @ np.array(frame.rotation).T
    corners = np.array([[a, b, c] for a in (0, 1) for b in (0, 1) for c in (0, 1)] + [[0.5, 0.5, 0.5]])
    count = np.zeros(len(voxel), int)
    for place, R in zip(centre, rotation, strict=True):
        candidate = np.ones(len(voxel), bool)
        for corner in corners:
            x = ((voxel + corner) * size - place) @ R.T
            candidate &= (x[:, 2] > 0.1) & (np.abs(x[:, :2]) < HALF * x[:, 2:]).all(axis=1)
        at = np.flatnonzero(candidate)
        for corner in corners:
            points = (voxel[at] + corner) * size
            at = at[~room.is_hidden(np.broadcast_to(place, points.shape), points)]
        count[at] += 1
    return count >= 2


@pytest.mark.slow
def test_nothing_is_marked_in_walls_and_furniture_and_nearly_all_that_two_cameras_see(tmp_path):
    """Of the voxels that touch no obstacle and that two cameras see wholly, at least 95 % are marked."""
    images, size = 60, 0.05
    seen, voxels = observed(tmp_path, 200_000, images, size)
    room = Room()
    index = np.asarray(seen["index"], int)
    assert room.depth_in_solids(index * size, (index + 1) * size).max() <= 0
    rng = np.random.default_rng(0)
    drawn = rng.integers(0, np.floor(np.array(SIZE) / size + 1e-9).astype(int), (1200, 3))
    key = lambda rows: {tuple(row) for row in rows.tolist()}  # noqa: E731
    obstacles, marked = key(np.asarray(voxels["index"])), key(index)
    free = [row for row in map(tuple, drawn.tolist()) if row not in obstacles]
    voxel = np.array(free)
    voxel = voxel[room.depth_in_solids(voxel * size, (voxel + 1) * size) <= 0]
    voxel = voxel[seen_by_two(room, voxel, size, images)]
    found = np.mean([tuple(row) in marked for row in voxel.tolist()])
    assert len(voxel) > 600
    assert found >= 0.95
