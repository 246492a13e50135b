"""polytope-cbf on an onboard map: its tree of boxes changes no bit, saves work, and is refused when wrong."""

import shutil
import struct
import subprocess
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from alula.cli.main import run
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.errors import ArtifactError
from alula.stages.compression.onboard.image import decode_map
from alula.stages.compression.onboard.layout import encode_map, index_bytes
from alula.stages.filtering.protocol import FilterStatus
from support.effort import examples
from support.paths import ROOT
from support.scenes.covers import cover_of, furniture, voxels_of
from support.scenes.fabricate import box, exact_hull, make_cover
from support.scenes.maps import decode, half_spaces, is_at_least, sealed

COVER = cover_of(voxels_of(furniture(3, 30)), hulls=40)
IMAGE = encode_map(COVER, indexed=True)
OK, FILTERED, SHORTENED, RECOVERING, *_ = FilterStatus


def blobs(rng, count, spread, extent=12):
    """Overlapping lattice hulls of a few dozen planes each."""
    hulls = []
    while len(hulls) < count:
        points = rng.integers(0, extent, (rng.integers(6, 40), 3)) + rng.integers(-spread, spread + 1, 3)
        if np.linalg.matrix_rank(points[1:] - points[0]) == 3:
            hulls.append(exact_hull(points))
    return hulls


def filters(images, **options):
    """Of each pair (image, brute force)."""
    chosen = {"extent_m": 8.0, "radius_m": 0.1, **options}
    return [_core.PolytopeCbf.from_image(image, brute_force=brute, **chosen) for image, brute in images]


def three(cover, largest_normal=127, **options):
    """With the index, without it, and looking at every plane."""
    images = [encode_map(cover, largest_normal=largest_normal, indexed=indexed) for indexed in (True, False)]
    return filters([(images[0], False), (images[1], False), (images[1], True)], **options)


def same_everywhere(found, points, nominal):
    """All filters give the same bits; the statuses they gave."""
    for values in zip(*(one.psi(points) for one in found), strict=True):
        assert len({v.tobytes() for v in values}) == 1
    seen = set()
    for x, u in zip(points.tolist(), nominal.tolist(), strict=True):
        results = [one.filter(x, u) for one in found]
        assert results[0] == results[1] == results[2]
        seen.add(results[0][1])
    return seen


@settings(deadline=None, max_examples=examples(60))
@given(st.data())
def test_the_tree_changes_no_bit(data):
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    count = data.draw(st.sampled_from([1, 2, 4, 5, 16, 17, 70]))
    cover = make_cover(blobs(rng, count, data.draw(st.sampled_from([3, 20, 60]))), g=0.1)
    dt = data.draw(st.sampled_from([0.002, 0.1, 0.5]))
    found = three(
        cover,
        data.draw(st.sampled_from([1, 7, 127])),
        kappa=data.draw(st.sampled_from([2.0, 30.0, 100.0, 1e4])),
        smoothing=data.draw(st.sampled_from(["sound", "sound", "paper"])),
        dt_s=dt,
        beta=data.draw(st.sampled_from([0.3, 1.0])) / dt,
        v_max=data.draw(st.sampled_from([0.5, 4.0])),
    )
    same_everywhere(found, rng.uniform(-7, 7, (60, 3)), rng.normal(scale=2.0, size=(60, 3)))


@pytest.mark.parametrize("g", [0.1, 0.07])
def test_planes_that_tie_change_no_bit_either(g):
    """A floor of equal tiles: all tops are as near, and all of them count."""
    cover = make_cover([box((i, j, 0), (i + 1, j + 1, 1)) for i in range(9) for j in range(9)], g=g)
    grid = np.stack(np.meshgrid(*[np.arange(-2, 11) * 0.5 * g] * 3), -1).reshape(-1, 3)
    seen = same_everywhere(three(cover, beta=10.0, dt_s=0.1), grid, np.full_like(grid, -0.3))
    assert {FILTERED, RECOVERING} <= seen


@pytest.mark.parametrize("make", ["merged", "tile"])
def test_real_covers_change_no_bit(make, request, tmp_path):
    cover = COVER
    if make == "tile":
        data, f = request.getfixturevalue("data"), lambda name: str(tmp_path / name)
        splat = data / "istanbul-outdoor/tile_x000_y003.splat"
        assert run(["import-splat", str(splat), "-o", f("s.scene.npz"), "-q"]) == 0
        assert run(["scale-align", f("s.scene.npz"), "-o", f("m.scene.npz"), "--scale", "1", "-q"]) == 0
        assert run(["voxelize", f("m.scene.npz"), "-o", f("v.voxels.npz"), "--size", "0.4", "-q"]) == 0
        assert run(["merge", f("v.voxels.npz"), "-o", f("c.cover.npz"), "--hulls", "400", "-q"]) == 0
        cover = read_artifact(tmp_path / "c.cover.npz")
    vertices = np.asarray(cover["vertex"]) * cover.manifest.voxel_size_m
    rng = np.random.default_rng(4)
    near = vertices[rng.integers(0, len(vertices), 400)] + rng.normal(scale=0.4, size=(400, 3))
    found = three(cover, extent_m=float(np.abs(vertices).max()) + 3, dt_s=0.05, beta=4.0, v_max=2.0)
    seen = same_everywhere(found, near, rng.normal(scale=2.0, size=near.shape))
    assert {OK, FILTERED, RECOVERING} <= seen


@settings(deadline=None, max_examples=examples(40))
@given(st.integers(0, 2**32 - 1), st.sampled_from([0, 10**5, -(2**19)]), st.sampled_from([1, 127]))
def test_rounding_never_brings_a_hull_closer_than_it_is(seed, place, largest):
    rng = np.random.default_rng(seed)
    cover = make_cover(blobs(rng, 3, 40, 60), offset=(place, -place, 3))
    raw = encode_map(cover, largest_normal=largest, indexed=True)
    hulls, g = decode(encode_map(cover, largest_normal=largest)), decode_map(raw).voxel_size_m
    centre = np.array([place, -place, 3]) * g
    points = (centre + rng.uniform(-4, 6, (20, 3))).astype(np.float32).astype(float)
    found = _core.PolytopeCbf.from_image(raw, extent_m=float(np.abs(points).max()) + 1, radius_m=0.0)
    _, hard, _ = found.psi(points)
    for point, value in zip(points, hard.tolist(), strict=True):
        assert is_at_least(hulls, g, [Fraction(c) for c in point], value)
        exact = min(
            max((np.dot(n, point) - d * g) / np.linalg.norm(n) for n, d in half_spaces(hull))
            for hull in hulls
        )
        assert exact - value < 1.7 * 2.0**-18 * np.abs(points).max() + 1e-4  # outward, but not by much


def street(count):
    """Blocks on a grid of 1 m, as many as asked for, around the origin."""
    side = round(count ** (1 / 2))
    blocks = [(10 * (i - side // 2), 10 * (j - side // 2)) for i in range(side) for j in range(side)]
    return make_cover([box((x, y, 0), (x + 5, y + 4, 30)) for x, y in blocks], g=0.1)


@pytest.mark.slow
def test_what_a_tick_looks_at_grows_like_the_logarithm_of_the_hulls():
    rng = np.random.default_rng(6)
    points, most = rng.uniform([-1.5, -1.5, 0.2], [1.5, 1.5, 2.8], (300, 3)), {}
    for count in (64, 256, 1024, 4096):
        (found,) = filters([(encode_map(street(count), indexed=True), False)], extent_m=50.0)
        work = []
        for x in points.tolist():
            found.filter(x, [1.0, 0.0, 0.0])
            work.append(found.work())
        most[count] = np.max(work, axis=0)
    assert most[4096][2] == most[64][2]  # planes: the same hulls are near
    steps = np.diff([most[count][0] for count in (64, 256, 1024, 4096)])
    assert (steps <= 5 * 4 * 4).all()  # boxes: passes x nodes of a level x neighbours, per level
    assert most[4096][0] < 4096 / 8


def test_the_index_has_the_documented_bytes():
    for count in (1, 4, 5, 16, 17, 64, 65, 300):
        cover = make_cover([box((2 * i, 0, 0), (2 * i + 1, 1, 1)) for i in range(count)])
        plain, indexed = encode_map(cover), encode_map(cover, indexed=True)
        assert len(indexed) - len(plain) == index_bytes(count)
        assert indexed[64 : len(plain)] == plain[64:]
        leaves = -(-count // 4)
        assert struct.unpack_from("<I", indexed, len(indexed) - 4)[0] == 64 + 14 * 4 * (leaves - 1)
    assert encode_map(make_cover([]), indexed=True) == encode_map(make_cover([]))
    assert index_bytes(0) == 0


def outcome(raw):
    """The map, None when the onboard reader refuses it; what that takes, the other reader takes."""
    try:
        native = _core.OnboardMap(bytes(raw))
    except ValueError:
        native = None
    try:
        image = decode_map(bytes(raw))
    except ArtifactError:
        image = None
    assert native is None or image is not None
    return native


def test_every_change_of_the_index_is_refused():
    begin = len(IMAGE) - index_bytes(len(decode_map(IMAGE)))
    for at in range(begin, len(IMAGE)):
        for change in (1, 0x80, 0xFF):
            raw = bytearray(IMAGE)
            raw[at] ^= change
            assert outcome(sealed(raw)) is None, at - begin
            with pytest.raises(ArtifactError):
                decode_map(sealed(raw))
    for cut in (1, 4, 12, len(IMAGE) - begin):
        raw = bytearray(IMAGE[:-cut])
        struct.pack_into("<I", raw, 16, len(raw))
        assert outcome(sealed(raw)) is None
    raw = bytearray(IMAGE + bytes(4))
    struct.pack_into("<I", raw, 16, len(raw))
    assert outcome(sealed(raw)) is None


def test_mutated_maps_are_refused_or_filtered_safely():
    """Any bytes with matching sums: a filter on what is taken answers as brute force does."""
    rng, taken = np.random.default_rng(7), 0
    for _ in range(1500):
        raw = bytearray(IMAGE)
        for at in rng.integers(8, len(raw), rng.integers(1, 4)):
            raw[at] = rng.integers(0, 256)
        raw[16:20], raw[36:60] = IMAGE[16:20], IMAGE[36:60]
        if outcome(sealed(raw)) is None:
            continue
        taken += 1
        fast, slow = filters([(sealed(raw), False), (sealed(raw), True)])
        for x in rng.uniform(-3, 3, (3, 3)).tolist():
            result = fast.filter(x, [0.5, -0.5, 0.2])
            assert result == slow.filter(x, [0.5, -0.5, 0.2])
            assert np.isfinite(result[0]).all()
            assert np.linalg.norm(result[0]) <= 1 + 1e-5
    assert taken > 20


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30])
def test_what_is_not_finite_or_too_far_is_refused(bad):
    (found,) = filters([(IMAGE, False)])
    for axis in range(3):
        wrong = [1.0, 1.0, 1.0]
        wrong[axis] = bad
        assert found.filter(wrong, [0.0, 0.0, 0.0])[:2] == ([0, 0, 0], FilterStatus.REFUSED)


@pytest.mark.parametrize("options", [{"extent_m": np.nan}, {"extent_m": -1.0}, {"kappa": 0.0}, {"beta": 1e4}])
def test_parameters_without_meaning_are_refused(options):
    with pytest.raises(ValueError, match=r"parameters|must be"):
        filters([(IMAGE, False)], **options)


PROGRAM = r"""
#include <stdio.h>
#include "alula.h"
static unsigned char bytes[1 << 20];
int main(void) {
  static alula_polytope_cbf cbf;
  alula_map map;
  const alula_polytope_cbf_config config = {0.1F, 2.0F, 100.0F, 0.01F, 1.0F, ALULA_SMOOTHING_SOUND, 0};
  const unsigned length = (unsigned)fread(bytes, 1, sizeof bytes, stdin);
  if (alula_map_open(&map, bytes, length) != ALULA_MAP_READY) return 1;
  const alula_status status = alula_polytope_cbf_open(&cbf, &map, 8.0F, &config);
  printf("%d %d\n", (int)status, (int)(map.most_planes + 6U));
  if (status != ALULA_READY) return 0;
  const float x[3] = {1.0F, 1.0F, 1.0F}, u[3] = {0.1F, 0.2F, 0.0F};
  alula_polytope_result result;
  for (unsigned i = 64U; i < length; ++i) bytes[i] = 0xFFU; /* flash that is gone */
  printf("%d\n", (int)alula_polytope_cbf_filter(&cbf, x, u, &result));
  return result.u[0] != 0.0F;
}
"""


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler")
def test_a_hull_with_more_planes_than_rows_and_a_map_that_vanished_are_refused(tmp_path):
    (tmp_path / "main.c").write_text(PROGRAM)
    sources = [str(path) for path in sorted((ROOT / "native/onboard/src").glob("*.c"))]
    said = {}
    for rows in (7, 1024):
        words = [
            "cc",
            "-std=c99",
            "-O1",
            "-fno-math-errno",
            f"-DALULA_PLANE_ROWS={rows}U",
            f"-I{ROOT / 'native/onboard/include'}",
        ]
        subprocess.run([*words, str(tmp_path / "main.c"), *sources, "-o", str(tmp_path / "a")], check=True)
        done = subprocess.run([str(tmp_path / "a")], input=IMAGE, capture_output=True, check=True)
        said[rows] = done.stdout.split()
    assert int(said[7][1]) > 7
    assert said[7][0] == b"3"  # ALULA_BAD_MAP
    assert said[1024][0] == b"0"
    assert int(said[1024][2]) == FilterStatus.REFUSED
