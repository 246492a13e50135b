"""The memory bounds in the help of merge and verify hold, and more voxels are refused at the start.

Flights in a cover with its scene stay within a bound for each Gaussian.
"""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import Artifact, make_artifact, read_artifact, write_artifact
from alula.schemas.artifacts.kinds import VOXELS
from alula.stages.compression import limits, merge
from alula.stages.compression import verify as certificate
from alula.stages.compression.onboard import verify as map_certificate
from support.fabricate import make_scene
from support.small_scenes import box_cover

# Runs the command line in a child and prints the child's peak, in bytes (ru_maxrss counts KiB on Linux).
PEAK = (
    "import os, sys; pid = os.spawnv(os.P_NOWAIT, sys.executable, [sys.executable, '-P', '-m', 'alula.cli',"
    " *sys.argv[1:]]); _, status, used = os.wait4(pid, 0); print(status, used.ru_maxrss * 1024)"
)


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


def peak(*words: str) -> int:
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-P", "-c", PEAK, *words], env=env, capture_output=True, text=True, check=True
    )
    status, used = map(int, done.stdout.split())
    assert status == 0, done.stderr
    return used


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


@pytest.mark.skipif(sys.platform != "linux", reason="ru_maxrss has another unit")
def test_flights_among_hulls_hold_the_scene_for_the_judge_alone(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    slabs = [((-10, -10, -10), (90, 90, 5)), ((-10, -10, 40), (90, 90, 50))]  # voxels of 0.1 m
    write_artifact(tmp_path / "room.cover.npz", box_cover(slabs))
    used = {}
    for count in (50_000, 350_000):
        write_artifact(tmp_path / "room.scene.npz", make_scene(count, high=(8, 8, 0.3)))
        words = ["simulate", "room.cover.npz", "--scene", "room.scene.npz", "-o", f"{count}.run.mcap"]
        used[count] = peak(*words, "--trials", "2", "--set", "world.inflation_m=0", "-q")
    each = (used[350_000] - used[50_000]) / 300_000
    assert each <= 280  # 46 bytes of the file, the judge's search tree and what it is made from


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
