"""The memory bounds in the help of merge and verify hold, and more voxels are refused at the start.

Every step of a project stays within a bound for each Gaussian.
"""

import json
import os
import subprocess
import sys
import tracemalloc

import numpy as np
import pytest

from alula._core import EllipsoidSet
from alula.cli.main import run
from alula.schemas.artifacts.artifact import Artifact, make_artifact, read_artifact, write_artifact
from alula.schemas.artifacts.kinds import VOXELS
from alula.stages.compression import limits, merge
from alula.stages.compression import verify as certificate
from alula.stages.compression.onboard import verify as map_certificate
from alula.stages.show.drawing import splat
from support.scenes.fabricate import make_scene
from support.scenes.small_scenes import box_cover

# Runs Python in a child and prints the child's peak, in bytes (ru_maxrss counts KiB on Linux).
PEAK = (
    "import os, sys; pid = os.spawnv(os.P_NOWAIT, sys.executable, [sys.executable, '-P', *sys.argv[1:]]);"
    " _, status, used = os.wait4(pid, 0); print(status, used.ru_maxrss * 1024)"
)
# The command line, which maps small files and takes small parts beside few Gaussians, as it does large ones.
MAPPED = """
import sys
from alula.cli.main import run
from alula.schemas.artifacts import artifact
from alula.stages.show.drawing import splat
from alula.stages.reconstruction import floaters
from alula.stages.reconstruction.formats import source
artifact.READ_AT_ONCE = source.READ_AT_ONCE = 0
floaters._PART = splat._CHUNK = 2**12
floaters._TREE = 2**14
raise SystemExit(run(sys.argv[1:]))
"""
LARGE = {"MALLOC_MMAP_THRESHOLD_": "131072"}  # memory of small arrays is given back like that of large ones


LEVEL = ("--scale", "2", "--up", "0", "0", "1", "--floor")


def voxels_of(index: np.ndarray) -> Artifact:
    return make_artifact(
        VOXELS,
        {"index": np.unique(index, axis=0).astype(np.int32), "overlap": np.ones(len(index))},
        **{"frame": "world", "unit": "m", "parameters": {}, "summary": {}},
        **{"voxel_size_m": 0.5, "sigma": 1.0, "min_overlap": 1},
    )


def terrain() -> np.ndarray:
    """A surface two voxels thick, 40,000 voxels."""
    x, y = np.mgrid[:142, :142]
    z = (20 * np.sin(x / 17) + 15 * np.cos(y / 23)).astype(int)
    return np.concatenate([np.stack([x, y, z + k], axis=-1).reshape(-1, 3) for k in (0, 1)])


def scattered() -> np.ndarray:
    """One voxel in a hundred, 20,000 of them."""
    flat = np.random.default_rng(1).choice(126**3, 20_000, replace=False)
    return np.stack(np.unravel_index(flat, (126,) * 3), axis=1)


def block() -> np.ndarray:
    """A full block of 27,000 voxels; with --cluster-radius 0 each touches 26 others."""
    return np.argwhere(np.ones((30, 30, 30), bool))


def peak(*words: str, program: tuple[str, ...] = ("-m", "alula.cli")) -> int:
    env = os.environ | LARGE | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-P", "-c", PEAK, *program, *words]
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=True)
    status, used = map(int, done.stdout.splitlines()[-1].split())
    assert status == 0, done.stderr
    return used


def each_needs(peaks: dict[int, int]) -> float:
    """Bytes of one more Gaussian."""
    (few, least), (many, most) = peaks.items()
    return (most - least) / (many - few)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="ru_maxrss has another unit")
@pytest.mark.parametrize(
    ("shape", "words", "bytes_per_voxel"),
    [
        (terrain, [], 900),
        (scattered, [], limits.MERGE_BYTES),
        (block, ["--cluster-radius", "0"], limits.MERGE_BYTES),
    ],
)
def test_peaks_stay_below_what_the_help_says(tmp_path, monkeypatch, shape, words, bytes_per_voxel):
    monkeypatch.chdir(tmp_path)
    artifact = voxels_of(shape())
    write_artifact(tmp_path / "v.voxels.npz", artifact)
    count = len(artifact["index"])
    used = peak("merge", "v.voxels.npz", "-o", "c.cover.npz", "-q", *words)
    assert used <= limits.BASE_BYTES + bytes_per_voxel * count
    used = peak("verify", "c.cover.npz", "--voxels", "v.voxels.npz", "-q")
    cover = read_artifact(tmp_path / "c.cover.npz")
    held, hulls = max(count, len(cover["member_index"])), len(cover["plane_start"]) - 1
    assert used <= limits.BASE_BYTES + limits.VERIFY_BYTES * held + limits.VERIFY_HULL_BYTES * hulls


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="ru_maxrss has another unit")
def test_flights_among_hulls_hold_the_scene_for_the_judge_alone(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    slabs = [((-10, -10, -10), (90, 90, 5)), ((-10, -10, 40), (90, 90, 50))]  # voxels of 0.1 m
    write_artifact(tmp_path / "room.cover.npz", box_cover(slabs))
    # 47 bytes of the file, the judge's search tree, and for planned pairs no index beside it.
    for further in ([], ["--set", "mission.planned=true", "--set", "mission.beyond_map_m=1"]):
        used = {}
        for count in (50_000, 350_000):
            write_artifact(tmp_path / "room.scene.npz", make_scene(count, high=(8, 8, 0.3)))
            words = ["simulate", "room.cover.npz", "--scene", "room.scene.npz", "-f", "-o", "run.mcap"]
            words += ["--trials", "2", "--set", "world.inflation_m=0", *further, "-q"]
            used[count] = peak(*words, program=("-c", MAPPED))
        assert each_needs(used) <= 130


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="ru_maxrss has another unit")
def test_a_scene_is_imported_and_aligned_within_a_bound_for_each_gaussian(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    used: dict[str, dict[int, int]] = {}
    for count in (30_000, 180_000):
        assert run(["demo-scene", "-o", "room.ply", "--gaussians", str(count), "-f", "-q"]) == 0
        steps = {
            "import-splat": ["import-splat", "room.ply", "-f", "-o", "s.scene.npz", "--drop-floaters"],
            "scale-align": ["scale-align", "s.scene.npz", "-f", "-o", "m.scene.npz", *LEVEL],
        }
        for name, words in steps.items():
            used.setdefault(name, {})[count] = peak(*words, "-q", program=("-c", MAPPED))
    for peaks in used.values():  # the decoded file and the scene, or both scenes, have 94 bytes
        assert each_needs(peaks) <= 110


def test_the_gaussians_that_a_view_shows_are_chosen_within_a_bound_for_each_gaussian(monkeypatch):
    monkeypatch.setattr(splat, "_CHUNK", 2**12)
    scene = make_scene(200_000)
    tracemalloc.start()
    try:
        splat.chosen(scene, 1_000)
        used = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert used <= 32 * 200_000


def test_a_set_of_ellipsoids_holds_its_arrays_without_a_copy():
    scene = make_scene(1_000)
    arrays = [np.array(scene[name], np.float32) for name in ("mean", "scale", "quat_wxyz")]
    before = [sys.getrefcount(array) for array in arrays]
    held = EllipsoidSet(*arrays, 1.0)
    path = np.array([[2.0, 1.5, 1.0], [2.2, 1.5, 1.0]])
    expected = held.clearance(path[:1], path[1:], np.inf)
    assert all(sys.getrefcount(array) > count for array, count in zip(arrays, before, strict=True))
    del arrays
    np.testing.assert_array_equal(held.clearance(path[:1], path[1:], np.inf), expected)
    del held


def test_the_help_says_what_is_refused(capsys):
    for command, numbers in (
        ("merge", (limits.MERGE_VOXELS, limits.MERGE_BYTES)),
        ("verify", (limits.VERIFY_VOXELS, limits.VERIFY_BYTES, limits.VERIFY_HULL_BYTES)),
    ):
        assert run([command, "-h"]) == 0
        text = " ".join(capsys.readouterr().out.split())
        for number in numbers:
            assert f"{number:,}" in text


def test_more_voxels_are_refused_with_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_artifact(tmp_path / "v.voxels.npz", voxels_of(np.argwhere(np.ones((3, 3, 3), bool))))
    assert run(["merge", "v.voxels.npz", "-o", "c.cover.npz", "-q"]) == 0
    assert run(["export", "c.cover.npz", "-o", "c.map.bin", "-q"]) == 0
    for module, name in (
        (merge, "MERGE_VOXELS"),
        (certificate, "VERIFY_VOXELS"),
        (map_certificate, "VERIFY_VOXELS"),
    ):
        monkeypatch.setattr(module, name, 26)
    rest = "27 voxels, but memory limits them to 26; crop the scene or take larger voxels"
    for words, start in (
        (["merge", "v.voxels.npz", "-o", "d.cover.npz"], "alula/voxels lists"),
        (["verify", "c.cover.npz"], "alula/cover lists"),
        (["verify", "c.map.bin", "--voxels", "v.voxels.npz"], "alula/voxels lists"),
    ):
        assert run([*words, "--json"]) == 3
        out, err = capsys.readouterr()
        assert err == f"alula: {start} {rest}\n"
        assert json.loads(out)["exit_code"] == 3
    assert not (tmp_path / "d.cover.npz").exists()
