"""Memory does not grow with the number of parts, and stays below what the help says."""

import sys

import numpy as np
import pytest
from command.covers.test_memory_bounds import peak

from alula.schemas.artifacts.parts import open_parts
from alula.stages.compression.verify_cubes import CELL_ELLIPSOIDS

ROWS = 120_000
RECORD = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])
PER_GAUSSIAN = {"import-splat": 250, "scale-align": 300, "voxelize": 3 * 60 + 2 * 96}  # bytes, as in the help
BASE = 150 * 2**20  # the program itself
JOB, PER_VOXEL = 250 * 10**6, 60  # bytes of `verify`, as in its help


def tile(path, number):
    """A field of small Gaussians, 100 m by 100 m, with some that reach into the next tile."""
    rng = np.random.default_rng(number)
    raw = np.zeros(ROWS, RECORD)
    raw["mean"] = rng.uniform([100 * number, 0, 0], [100 * number + 100, 100, 3], (ROWS, 3))
    raw["scale"] = rng.uniform(0.02, 0.2, (ROWS, 3))
    raw["scale"][:50] = 5
    raw["rgba"], raw["quat"] = 200, rng.integers(0, 256, (ROWS, 4))
    raw.tofile(path)
    return str(path)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="ru_maxrss has another unit")
def test_four_times_as_many_parts_take_no_more_memory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    files = [tile(tmp_path / f"{number}.splat", number) for number in range(12)]
    used = {}
    for count in (3, 12):
        common = ["-q", "--jobs", "1"]
        steps = {
            "import-splat": [*files[:count], "-o", f"{count}.scene"],
            "scale-align": [f"{count}.scene", "-o", f"m{count}.scene", "--scale", "1"],
            "voxelize": [f"m{count}.scene", "-o", f"{count}.voxels", "--size", "0.5", "--tile", "100"],
        }
        for name, words in steps.items():
            used[name, count] = peak(name, *words, *common)
    for name, per_gaussian in PER_GAUSSIAN.items():
        assert used[name, 12] <= used[name, 3] + 8 * 2**20, (name, used)  # nine more parts are 63 MB
        assert used[name, 12] <= BASE + per_gaussian * ROWS, (name, used)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="ru_maxrss has another unit")
def test_a_part_of_a_cover_with_many_cells_is_proven_within_the_stated_memory(tmp_path, monkeypatch):
    """One part of the cover, with 1.4 million Gaussians: more than twice what a cell has."""
    monkeypatch.chdir(tmp_path)
    files = [tile(tmp_path / f"{number}.splat", number) for number in range(12)]
    assert len(files) * ROWS > 2 * CELL_ELLIPSOIDS
    tiled = ["--tiles", "50", "--reach", "5"]
    for words in (
        ["import-splat", *files, "-o", "a.scene"],
        ["scale-align", "a.scene", "-o", "m.scene", "--scale", "1"],
        ["voxelize", "m.scene", "-o", "a.voxels", "--size", "2", "--ignore-loss"],
        ["merge", "a.voxels", "-o", "a.cover", "--block", "100", "--hulls", "500"],
        ["export", "a.cover", "-o", "a.tiles", *tiled],
    ):
        peak(*words, "-q", "--jobs", "1")
    cover, voxels = open_parts(tmp_path / "a.cover"), open_parts(tmp_path / "a.voxels")
    assert len(cover) == 1
    proof = ["--voxels", "a.voxels", "--scene", "m.scene", "-q", "--jobs", "1"]
    allowed = BASE + JOB + PER_VOXEL * voxels.count
    assert peak("verify", "a.cover", *proof) <= allowed
    assert peak("verify", "a.tiles", *proof) <= allowed
    assert peak("export", "a.cover", "-o", "b.tiles", *tiled, "-q") <= BASE + 4000 * cover.count
