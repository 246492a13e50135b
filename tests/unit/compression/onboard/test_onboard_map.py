"""Covers become onboard maps: exact boxes, outward planes, the documented sizes and bytes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from alula.schemas.errors import ArtifactError, InfeasibleError, InputError
from alula.stages.compression.onboard.image import decode_map
from alula.stages.compression.onboard.layout import encode_map, map_facts
from support.effort import examples
from support.scenes.covers import cover_of, furniture, holds_voxel, rows, voxels_of
from support.scenes.fabricate import box, exact_hull, make_cover
from support.scenes.maps import decode, half_spaces, holds

VOXELS = voxels_of(furniture(1, 18))
COVER = cover_of(VOXELS, hulls=20)


def solid(points) -> bool:
    return np.linalg.matrix_rank(points[1:] - points[0]) == 3


@st.composite
def covers(draw, extents=(3, 12, 60)):
    """One to four random hulls, small or large, anywhere on the lattice."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    place = [draw(st.sampled_from([0, -17, 2**20 - 200, 200 - 2**20])) for _ in range(3)]
    hulls = []
    for _ in range(draw(st.integers(1, 4))):
        extent = draw(st.sampled_from(extents))
        points = rng.integers(0, extent, (draw(st.integers(5, 40)), 3)) + rng.integers(-50, 50, 3)
        if solid(points):
            hulls.append(exact_hull(points))
    return make_cover(hulls or [box((0, 0, 0), (1, 2, 3))], offset=place)


def box_of(points):
    return tuple(map(min, zip(*points, strict=True))), tuple(map(max, zip(*points, strict=True)))


def assert_contains(raw: bytes, cover) -> list[dict]:
    """Each hull of the cover has one with its very box that holds all its vertices; no hull is left over."""
    hulls = decode(raw)
    left = list(hulls)
    for number in range(len(cover["plane_start"]) - 1):
        vertices = rows(cover, number, "vertex")
        found = [h for h in left if (h["lower"], h["upper"]) == box_of(vertices) and holds(h, vertices)]
        assert found
        left.remove(found[0])
    assert not left
    return hulls


@settings(deadline=None, max_examples=examples(60))
@given(covers(), st.sampled_from([1, 2, 7, 15, 127]))
def test_each_hull_contains_its_own_and_has_its_box(cover, largest):
    raw = encode_map(cover, largest_normal=largest)
    hulls = assert_contains(raw, cover)
    for hull in hulls:
        for normal, offset in hull["planes"]:
            assert max(map(abs, normal)) <= largest
            corner = [
                hi if n > 0 else lo for n, lo, hi in zip(normal, hull["lower"], hull["upper"], strict=True)
            ]
            assert offset < sum(n * c for n, c in zip(normal, corner, strict=True)), "it cuts its box"
    count = sum(len(hull["planes"]) for hull in hulls)
    assert len(raw) == 64 + 14 * len(hulls) + (2 if largest == 1 else 5) * count or raw[8] & 1


@settings(deadline=None, max_examples=examples(30))
@given(covers())
def test_three_decoders_agree(cover):
    raw = encode_map(cover)
    ours, image, c = decode(raw), decode_map(raw), _core.OnboardMap(raw)
    lower, upper, count, normal, depth = c.records()
    assert (
        [h["lower"] for h in ours]
        == [tuple(x) for x in lower.tolist()]
        == [tuple(x) for x in image.lower.tolist()]
    )
    assert (
        [h["upper"] for h in ours]
        == [tuple(x) for x in upper.tolist()]
        == [tuple(x) for x in image.upper.tolist()]
    )
    assert [len(h["planes"]) for h in ours] == count.tolist() == np.diff(image.plane_start).tolist()
    assert [n for h in ours for n, _ in h["planes"]] == [tuple(n) for n in image.normal.tolist()]
    assert [d for h in ours for _, d in h["planes"]] == image.offset.tolist()
    assert (normal == image.normal).all()
    hull = np.repeat(np.arange(len(ours)), count)
    corner = np.where(normal > 0, upper[hull], lower[hull]).astype(np.int64)
    assert ((normal * corner).sum(axis=1) - depth.astype(np.int64) == image.offset).all()
    assert (c.hulls, c.planes, c.margin_m) == (len(ours), len(normal), image.margin_m)


def test_every_voxel_of_a_merged_cover_stays_inside():
    for largest in (1, 3, 127):
        left = {tuple(v) for v in VOXELS["index"].tolist()}
        for hull in assert_contains(encode_map(COVER, largest_normal=largest), COVER):
            left -= {v for v in left if holds_voxel(half_spaces(hull), v)}
        assert not left


def test_normals_that_fit_lose_nothing():
    largest = int(np.abs(COVER["plane_normal"]).max())
    assert largest <= 127
    wanted, found = set(), set()
    for number in range(len(COVER["plane_start"]) - 1):
        name = box_of(rows(COVER, number, "vertex"))
        pairs = zip(rows(COVER, number, "plane_normal"), rows(COVER, number, "plane_offset"), strict=True)
        wanted |= {(name, normal, offset) for normal, (offset,) in pairs}
    for hull in decode(encode_map(COVER)):
        found |= {((hull["lower"], hull["upper"]), *plane) for plane in half_spaces(hull)}
    assert found == wanted


def test_fewer_normals_only_ever_grow_the_hulls():
    volumes, rng = [], np.random.default_rng(5)
    points = rng.uniform(-0.9, 0.9, (20000, 3)).astype(np.float32)  # furniture lies there, but for floaters
    exact = None
    for largest in (127, 15, 3, 1):
        inside = _core.OnboardMap(encode_map(COVER, largest_normal=largest)).psi(points)[0] < 0
        exact = inside if exact is None else exact
        assert inside[exact].all()
        volumes.append(inside.sum())
    assert volumes[0] == min(volumes)
    assert volumes[-1] > volumes[0]


def test_planes_of_26_directions_take_two_bytes():
    octagon = [(0, 2), (2, 0), (5, 0), (7, 2), (7, 5), (5, 7), (2, 7), (0, 5)]
    hull = exact_hull([(x, y, z) for x, y in octagon for z in (0, 4)])
    cover = make_cover([hull, box((0, 0, 9), (3, 3, 12))])
    raw = encode_map(cover)
    assert raw[8] == 1
    assert len(raw) == 64 + 2 * 14 + 4 * 2
    first = assert_contains(raw, cover)[0]
    assert len(first["planes"]) == 4
    assert decode_map(raw).is_kdop
    forced = encode_map(COVER, largest_normal=1)
    facts = map_facts(decode_map(forced))
    assert facts["directions_only"]
    assert len(forced) == 64 + 14 * facts["hulls"] + 2 * facts["oblique_planes"]


def test_a_box_takes_14_bytes_and_no_hull_at_all_64():
    assert len(encode_map(make_cover([box((-3, 0, 5), (1, 1, 6))] * 3))) == 64 + 3 * 14
    raw = encode_map(make_cover([]))
    assert len(raw) == 64
    value, hull, _ = _core.OnboardMap(raw).psi(np.zeros((1, 3), np.float32))
    assert (value[0], hull[0]) == (np.finfo(np.float32).max, 2**32 - 1)


@pytest.mark.parametrize("extent", [500, 5000, 60000])
@pytest.mark.parametrize("largest", [1, 127])
def test_large_hulls_need_a_shift_and_stay_outward(extent, largest):
    rng = np.random.default_rng(extent)
    cover = make_cover([exact_hull(rng.integers(-extent // 2, extent // 2, (40, 3)))])
    (hull,) = assert_contains(encode_map(cover, largest_normal=largest), cover)
    assert hull["shift"] > 0 or extent == 500
    vertices = rows(cover, 0, "vertex")
    for normal, offset in hull["planes"]:
        support = max(sum(n * c for n, c in zip(normal, v, strict=True)) for v in vertices)
        assert support <= offset < support + 2 ** hull["shift"]
        if largest == 127 and hull["shift"]:
            assert max(map(abs, normal)) > 63, "the unit is a small distance"


def test_a_hull_of_hundreds_of_facets_keeps_255():
    rng = np.random.default_rng(3)
    ball = rng.normal(size=(400, 3))
    points = np.rint(300 * ball / np.linalg.norm(ball, axis=1, keepdims=True)).astype(int)
    cover = make_cover([exact_hull(points)])
    assert len(cover["plane_offset"]) > 500
    (hull,) = assert_contains(encode_map(cover), cover)
    assert len(hull["planes"]) == 255


def test_the_bytes_depend_neither_on_the_order_of_hulls_nor_on_threads():
    rng = np.random.default_rng(2)
    hulls = [exact_hull(rng.integers(0, 20, (12, 3)) + rng.integers(-300, 300, 3)) for _ in range(70)]
    raw = encode_map(make_cover(hulls), jobs=1)
    assert raw == encode_map(make_cover(hulls), jobs=5)
    assert raw == encode_map(make_cover(hulls[::-1]), jobs=2)


def test_neighbours_in_the_map_are_neighbours_in_space():
    cells = [(x, y, z) for x in range(8) for y in range(8) for z in range(2)]
    cover = make_cover([box(np.array(c) * 4, np.array(c) * 4 + 4) for c in cells])
    centre = decode_map(encode_map(cover)).lower
    hop = np.abs(np.diff(centre, axis=0)).sum(axis=1)
    assert hop.mean() < 10
    assert len(np.unique(centre[:16] // 16, axis=0)) <= 2


def test_the_lattice_may_lie_anywhere_but_not_be_wider_than_16_bits():
    far = 2**20 - 1
    widest = [box((far - 65535, 0, 0), (far - 65534, 1, 1)), box((far - 1, 0, 0), (far, 1, 1))]
    assert_contains(encode_map(make_cover(widest)), make_cover(widest))
    too_wide = [box((0, 0, 0), (1, 1, 1)), box((65535, 0, 0), (65536, 1, 1))]
    with pytest.raises(InfeasibleError, match="65536 voxels wide"):
        encode_map(make_cover(too_wide))


def test_what_cannot_be_encoded_is_refused():
    with pytest.raises(InputError, match="voxels of 1e-6 m"):
        encode_map(make_cover([box((0, 0, 0), (1, 1, 1))], g=1e-7))
    flat = make_cover([(np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)]), np.array([(0, 0, 1, 0)]))])
    with pytest.raises(ArtifactError, match="no volume"):
        encode_map(flat)
    with pytest.raises(ArtifactError, match="1 to 127"):
        encode_map(COVER, largest_normal=128)
