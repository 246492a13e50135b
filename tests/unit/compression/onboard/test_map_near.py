"""psi with reuse between positions has the same bits as an evaluation of every plane, and costs less."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from alula.stages.compression.onboard.layout import encode_map
from support.effort import examples
from support.paths import ROOT
from support.scenes.covers import cover_of, furniture, voxels_of
from support.scenes.fabricate import box, exact_hull, make_cover


def blobs(rng, count, spread, extent=12):
    """Overlapping lattice hulls of up to a few dozen planes each."""
    hulls = []
    while len(hulls) < count:
        points = rng.integers(0, extent, (rng.integers(6, 60), 3)) + rng.integers(-spread, spread + 1, 3)
        if np.linalg.matrix_rank(points[1:] - points[0]) == 3:
            hulls.append(exact_hull(points))
    return hulls


def path(rng, count, step, half):
    """A walk that now and then jumps, and stands still."""
    moves = rng.normal(scale=step, size=(count, 3)) * rng.choice([0.0, 0.01, 1.0], (count, 1))
    points = np.cumsum(moves, axis=0) + rng.uniform(-half, half, 3)
    jump = rng.random(count) < 0.05
    points[jump] = rng.uniform(-half, half, (jump.sum(), 3))
    return points.astype(np.float32)


def same(native, points):
    for along, alone in zip(native.psi_along(points), native.psi(points), strict=True):
        assert along.tobytes() == alone.tobytes()


@pytest.mark.slow
@settings(deadline=None, max_examples=examples(80))
@given(st.data())
def test_what_is_remembered_changes_no_bit(data):
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    count, spread = data.draw(st.sampled_from([(1, 3), (2, 3), (5, 20), (17, 20), (70, 20), (70, 60)]))
    place = data.draw(st.sampled_from([0, 0, 10**5, -(2**21)]))
    cover = make_cover(blobs(rng, count, spread), g=0.1, offset=(place, -place, 0))
    image = encode_map(
        cover, largest_normal=data.draw(st.sampled_from([1, 7, 127])), indexed=data.draw(st.booleans())
    )
    points = path(rng, 200, data.draw(st.sampled_from([0.003, 0.05, 0.5, 5.0])), 0.1 * spread + 1)
    points = (points + np.array([place, -place, 0]) * 0.1).astype(np.float32)
    same(_core.OnboardMap(image), points)


@pytest.mark.parametrize("g", [0.1, 0.07])
def test_planes_and_hulls_that_tie_change_no_bit_either(g):
    cover = make_cover([box((i, j, 0), (i + 1, j + 1, 1)) for i in range(9) for j in range(9)], g=g)
    grid = np.stack(np.meshgrid(*[np.arange(-2, 11) * 0.5 * g] * 3), -1).reshape(-1, 3).astype(np.float32)
    native = _core.OnboardMap(encode_map(cover, indexed=True))
    same(native, grid)
    same(native, grid[np.random.default_rng(0).permutation(len(grid))])


def test_a_cover_of_a_room_changes_no_bit():
    cover = cover_of(voxels_of(furniture(3, 30)), hulls=40)
    native = _core.OnboardMap(encode_map(cover, indexed=True))
    for seed, step in enumerate([0.01, 0.1, 1.0]):
        same(native, path(np.random.default_rng(seed), 4000, step, 3.0))


def test_no_hulls_are_infinitely_far():
    image = bytearray(encode_map(make_cover([box((0, 0, 0), (1, 1, 1))])))
    with pytest.raises(ValueError, match="position"):
        _core.OnboardMap(bytes(image)).psi_along(np.array([[0, np.nan, 0]], np.float32))
    value, hull, _ = _core.OnboardMap(bytes(image)).psi_along(np.zeros((0, 3), np.float32))
    assert len(value) == len(hull) == 0


@pytest.mark.every(3)
@pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler")
@pytest.mark.parametrize(("hulls", "planes"), [(1, 1), (2, 3), (7, 16)])
def test_little_room_costs_time_and_changes_no_bit(tmp_path, hulls, planes):
    words = ["cc", "-std=c99", "-O1", "-ffp-contract=off", "-fno-math-errno", "-shared", "-fPIC"]
    words += [f"-DALULA_LISTED_HULLS={hulls}U", f"-DALULA_NEAR_PLANES={planes}U"]
    words += [f"-I{ROOT / 'native/onboard/include'}"]
    sources = sorted(str(path) for path in (ROOT / "native/onboard/src").glob("alula_m*.c"))
    subprocess.run([*words, *sources, "-o", str(tmp_path / "near.so")], check=True)
    c = ctypes.CDLL(str(tmp_path / "near.so"))
    rng = np.random.default_rng(hulls)
    cover = make_cover(blobs(rng, 70, 20), g=0.1)
    for indexed in (False, True):
        image = encode_map(cover, indexed=indexed)
        opened, near = ctypes.create_string_buffer(4096), ctypes.create_string_buffer(1 << 16)
        assert c.alula_map_open(opened, image, len(image)) == 0
        c.alula_map_near_open(near, opened)
        points = path(rng, 500, 0.1, 3.0)
        wanted = _core.OnboardMap(image).psi(points)
        value = (ctypes.c_uint32 * 5)()
        for k, point in enumerate(points):
            assert c.alula_map_near_evaluate(near, point.ctypes.data_as(ctypes.c_void_p), value) == 0
            psi, hull, *normal = np.frombuffer(value, np.uint32)
            assert psi == wanted[0].view(np.uint32)[k]
            assert hull == wanted[1][k]
            assert normal == list(wanted[2].view(np.uint32)[k])
