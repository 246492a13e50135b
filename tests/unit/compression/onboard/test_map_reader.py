"""The onboard reader: maps that it refuses, and its psi, which never exceeds the exact one."""

import struct
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from alula.schemas.errors import ArtifactError
from alula.stages.compression.onboard.image import decode_map
from alula.stages.compression.onboard.layout import encode_map
from support.effort import examples, some
from support.scenes.covers import cover_of, furniture, voxels_of
from support.scenes.fabricate import box, exact_hull, make_cover
from support.scenes.maps import decode, is_at_least, psi, sealed

COVER = cover_of(voxels_of(furniture(2, 12)), hulls=6)
IMAGES = {"planes": encode_map(COVER), "k-DOP": encode_map(COVER, largest_normal=1)}
NUMBERS = slice(36, 60)  # g, margin and hash: the two readers look at other halves of these


def refusal(raw: bytes) -> str:
    """What the C reader says of an image; empty when it takes it."""
    try:
        _core.OnboardMap(bytes(raw))
    except ValueError as error:
        return str(error)
    return ""


def is_refused_by_both(raw: bytes) -> bool:
    try:
        decode_map(bytes(raw))
    except ArtifactError:
        return refusal(raw) != ""
    return False


@pytest.mark.parametrize("name", IMAGES)
def test_every_truncation_is_refused(name):
    image = IMAGES[name]
    assert refusal(image) == ""
    for length in range(len(image)):
        assert refusal(image[:length]) == ("truncated" if length else "no bytes")
        assert is_refused_by_both(image[:length])


@pytest.mark.parametrize("name", IMAGES)
def test_every_changed_byte_is_refused(name):
    image = IMAGES[name]
    for at in range(len(image)):
        for change in (1, 0x80, 0xFF, 0x5A):
            changed = bytearray(image)
            changed[at] ^= change
            assert is_refused_by_both(changed), at


@settings(deadline=None, max_examples=examples(300))
@given(st.data())
def test_changes_with_matching_sums_are_refused_or_read_alike(data):
    image = bytearray(data.draw(st.sampled_from(list(IMAGES.values()))))
    for _ in range(data.draw(st.integers(1, 3))):
        image[data.draw(st.integers(4, len(image) - 1))] = data.draw(st.integers(0, 255))
    image[NUMBERS] = IMAGES["planes"][NUMBERS]
    (total,) = struct.unpack_from("<I", image, 16)
    if not 64 <= total <= len(image):
        assert is_refused_by_both(image)
        return
    raw = sealed(image)
    if refusal(raw) == "":
        found = decode_map(raw)
        lower, upper, count, normal, _ = _core.OnboardMap(raw).records()
        assert (found.lower == lower).all()
        assert (found.upper == upper).all()
        assert (found.normal == normal).all()
        assert (np.diff(found.plane_start) == count).all()
        values, _, _ = _core.OnboardMap(raw).psi(np.zeros((1, 3), np.float32))
        assert values[0] <= psi(decode(raw), found.voxel_size_m, np.zeros(3))


@pytest.mark.parametrize(
    ("at", "code", "value", "said"),
    [
        (0, "4s", b"ALMQ", "not an onboard map"),
        (4, "B", 2, "of a newer layout"),
        (6, "H", 80, "malformed"),
        (8, "H", 4, "of a newer layout"),
        (10, "B", 0, "malformed"),
        (10, "B", 200, "malformed"),
        (11, "B", 1, "malformed"),
        (12, "I", 7, "malformed"),
        (12, "I", 2**32 - 1, "malformed"),
        (16, "I", 63, "malformed"),
        (16, "I", 2**32 - 1, "truncated"),
        (12, "I", 0, "malformed"),
        (12, "I", 5, "malformed"),
        (12, "I", 2**24 + 1, "malformed"),
        (16, "I", 0, "malformed"),
        *((at, "i", value, "malformed") for at in (24, 28, 32) for value in (2**22 + 1, -(2**22) - 1, 2**30)),
        *((36, "f", g, "malformed") for g in (float("nan"), float("inf"), -1.0, 0.0, 1e-45, 1e-7, 2e5)),
        *((48, "f", m, "malformed") for m in (float("nan"), float("inf"), -1.0, 0.0, 1e-9, 1e8)),
        (64, "h", 32767, "malformed"),
        (77, "B", 17, "malformed"),
    ],
)
def test_a_header_that_lies_is_refused(at, code, value, said):
    image = bytearray(IMAGES["planes"])
    struct.pack_into("<" + code, image, at, value)
    assert refusal(sealed(image)) == said


# Bytes that say where and of what the map is: other values make another map, within the limits tested above;
# and the sums, which are set anew.
FREE = {5, 10, *range(20, 64)}


@pytest.mark.every(4)
@pytest.mark.parametrize("indexed", [False, True])
@pytest.mark.parametrize("largest", [1, 127])
def test_every_header_byte_but_those_of_the_place_is_checked_even_with_matching_sums(indexed, largest):
    image = encode_map(COVER, largest_normal=largest, indexed=indexed)
    assert refusal(image) == ""
    point = np.array([[0.3, 0.1, 0.2]], np.float32)
    for at in range(64):
        for value in some(range(256), 5):
            changed = bytearray(image)
            changed[at] = value
            if bytes(changed) == image:
                continue
            (total,) = struct.unpack_from("<I", changed, 16)
            raw = sealed(changed) if 64 <= total <= len(image) else bytes(changed)
            if at not in FREE:
                assert refusal(raw) != "", (at, value)
            elif refusal(raw) == "":
                psi_there, hull, normal = _core.OnboardMap(raw).psi(point)
                assert np.isfinite(psi_there).all()
                assert hull[0] < 6
                assert np.linalg.norm(normal) == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("indexed", [False, True])
def test_every_other_number_of_hulls_is_refused(indexed):
    image = bytearray(encode_map(COVER, indexed=indexed))
    (hulls,) = struct.unpack_from("<I", image, 12)
    for count in {*range(64), 255, 256, 2**16, 2**24, 2**31, 2**32 - 1} - {hulls}:
        struct.pack_into("<I", image, 12, count)
        assert is_refused_by_both(sealed(image)), count


def test_directions_come_with_their_largest_normal_alone():
    image = bytearray(IMAGES["k-DOP"])
    assert image[10] == 1
    for largest in (0, 2, 127):
        image[10] = largest
        assert is_refused_by_both(sealed(image))


def test_what_follows_the_records_must_be_their_index():
    image = bytearray(IMAGES["planes"] + b"an index")
    struct.pack_into("<I", image, 16, len(image))
    assert refusal(sealed(image)) == "malformed"
    image[8] |= 2
    assert is_refused_by_both(sealed(image))


@st.composite
def scenes(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    extent = draw(st.sampled_from([6, 40, 3000]))
    hulls = []
    for _ in range(draw(st.integers(1, 3))):
        points = rng.integers(0, extent, (12, 3)) + rng.integers(-extent, extent, 3)
        hulls.append(exact_hull(np.vstack([points, points[0] + 1, points[0] + np.eye(3, dtype=int)])))
    g = draw(st.sampled_from([0.05, 0.1, 0.3, 1e-6, 1 / 3, 1e3]))
    place = draw(st.sampled_from([0, 10**6 - 10**4, -(10**6)]))
    return make_cover(hulls, g=g, offset=(place, 0, -place)), rng


@settings(deadline=None, max_examples=examples(40))
@given(scenes(), st.sampled_from([1, 15, 127]))
def test_psi_never_exceeds_the_exact_value_and_misses_it_by_little(scene, largest):
    cover, rng = scene
    g = cover.manifest.voxel_size_m
    raw = encode_map(cover, largest_normal=largest)
    native, hulls = _core.OnboardMap(raw), decode(raw)
    vertices = cover["vertex"].astype(float)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = (high - low).max()
    near = vertices[rng.integers(0, len(vertices), 12)] + rng.normal(scale=0.3, size=(12, 3))
    wide = rng.uniform(low - size, high + size, (12, 3))
    x = (np.vstack([near, wide, [[0, 0, 0]], 100 * wide[:2]]) * g).astype(np.float32)
    value, nearest, normal = native.psi(x)
    for p, v, hull, n in zip(x, value, nearest, normal, strict=True):
        reach = max(float(np.abs(p).max()), native.extent_m)
        margin = reach * 2.0**-18
        for shift in ((0, 0, 0), rng.choice([-1, 1], 3)):  # three roundings in the worst directions
            moved = [
                Fraction(float(c)) + int(s) * Fraction(3 * reach) / 2**24
                for c, s in zip(p, shift, strict=True)
            ]
            assert is_at_least(hulls, g, moved, float(v))
        exact = psi(hulls, g, p.astype(float))
        # At p itself all roundings but those of the position, at most 42 of the margin's 64, can raise it.
        assert exact - 2 * margin <= v <= exact - 0.3 * margin
        assert psi([hulls[hull]], g, p.astype(float)) <= exact + 2 * margin
        assert np.linalg.norm(n) == pytest.approx(1, abs=1e-6)
        if exact > 0:  # not farther than any point of any hull
            own = cover["vertex_start"][:2]
            some = vertices[own[0] : own[1]]
            inside = rng.dirichlet(np.ones(len(some)), 5) @ some * g
            assert (np.linalg.norm(p - inside, axis=1) >= v).all()


def test_psi_of_a_unit_box_is_as_on_paper():
    native = _core.OnboardMap(encode_map(make_cover([box((0, 0, 0), (10, 10, 10))], g=0.1)))
    x = np.array([[0.5, 0.5, 0.5], [2, 0.5, 0.5], [0.5, -3, 0.5], [2, 2, 4]], np.float32)
    value, hull, normal = native.psi(x)
    assert value == pytest.approx([-0.5, 1, 3, 3], abs=3e-5)
    assert (value <= [-0.5, 1, 3, 3]).all()
    assert hull.tolist() == [0] * 4
    assert normal[1:].tolist() == [[1, 0, 0], [0, -1, 0], [0, 0, 1]]


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf"), 2e12])
@pytest.mark.parametrize("axis", range(3))
def test_a_position_that_is_none_is_refused(bad, axis):
    x = np.zeros((1, 3), np.float32)
    x[0, axis] = bad
    with pytest.raises(ValueError, match="position"):
        _core.OnboardMap(IMAGES["planes"]).psi(x)
