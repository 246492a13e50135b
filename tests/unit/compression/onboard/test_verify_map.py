"""Verification of onboard maps: valid maps are certified; faults are detected with their positions."""

import struct
from itertools import pairwise

import msgspec
import numpy as np
import pytest

from alula.schemas.artifacts.manifest import Guarantee
from alula.schemas.errors import UsageError
from alula.stages.compression.onboard.image import decode_map
from alula.stages.compression.onboard.layout import encode_map
from alula.stages.compression.onboard.verify import verify_map
from support.scenes.covers import SIZE_M, cover_of, furniture, holds_voxel, voxels_of
from support.scenes.fabricate import box, make_cover, make_scene
from support.scenes.maps import decode, half_spaces, sealed

VOXELS = voxels_of(furniture(4, 16))
COVER = cover_of(VOXELS, hulls=15)
IMAGE = encode_map(COVER)
RECORDS = [64]  # where each hull begins, and the end
while RECORDS[-1] < len(IMAGE):
    RECORDS.append(RECORDS[-1] + 14 + 5 * IMAGE[RECORDS[-1] + 12])
DEPTHS = [at for first, end in pairwise(RECORDS) for at in range(first + 17, end, 5)]


def failing(certificate) -> list[str]:
    assert certificate.covered == all(check.ok for check in certificate.checks)
    return [check.name for check in certificate.checks if not check.ok]


def changed(at: int, code: str, value) -> bytes:
    image = bytearray(IMAGE)
    struct.pack_into("<" + code, image, at, value)
    return sealed(image)


def extent(record: int) -> int:
    """The shortest edge of a hull's box."""
    low_high = struct.unpack_from("<6h", IMAGE, record)
    return min(high - low for low, high in zip(low_high[:3], low_high[3:], strict=True))


def outside_by_brute_force(raw: bytes, voxels) -> set[tuple[int, ...]]:
    left = {tuple(v) for v in voxels["index"].tolist()}
    for hull in decode(raw):
        left -= {v for v in left if holds_voxel(half_spaces(hull), v)}
    return left


@pytest.mark.parametrize("largest", [1, 3, 127])
def test_a_good_map_is_certified(largest):
    image = decode_map(encode_map(COVER, largest_normal=largest))
    certificate = verify_map(image, voxels=VOXELS, cover=COVER)
    assert certificate.covered
    assert certificate.complaint() == ""
    assert [check.checked for check in certificate.checks] == [2, 15, len(VOXELS["index"]), 15]
    assert certificate == verify_map(image, voxels=VOXELS, cover=COVER, jobs=3)
    assert verify_map(image, voxels=VOXELS).covered
    assert verify_map(image, cover=COVER).covered


@pytest.mark.every(9)
@pytest.mark.parametrize("place", DEPTHS[::3])
def test_a_plane_that_cuts_one_unit_deeper_is_caught(place):
    (depth,) = struct.unpack_from("<H", IMAGE, place)
    raw = changed(place, "H", depth + 1)
    certificate = verify_map(decode_map(raw), voxels=VOXELS, cover=COVER)
    assert "hulls contain the cover's" in failing(certificate)
    missing = outside_by_brute_force(raw, VOXELS)
    found = {
        tuple(int(v) for v in np.rint(np.array(offence.place_m) / SIZE_M - 0.5))
        for check in certificate.checks
        for offence in check.first
        if offence.fault == "voxel is in no hull"
    }
    assert found == missing
    assert ("every voxel lies in a hull" in failing(certificate)) == bool(missing)


def test_a_box_that_is_too_small_is_caught():
    thick = [at for at in RECORDS[:-1] if extent(at) > 2]
    assert thick
    for place, step in ((thick[0], 1), (thick[0] + 6, -1), (thick[-1] + 10, -1)):
        (edge,) = struct.unpack_from("<h", IMAGE, place)
        raw = changed(place, "h", edge + step)
        certificate = verify_map(decode_map(raw), voxels=VOXELS, cover=COVER)
        assert "hulls contain the cover's" in failing(certificate)
        missing = outside_by_brute_force(raw, VOXELS)
        assert ("every voxel lies in a hull" in failing(certificate)) == bool(missing)


@pytest.mark.slow
def test_each_voxel_of_random_sets_is_judged_as_by_brute_force():
    rng = np.random.default_rng(6)
    for _ in range(20):
        voxels = voxels_of(rng.integers(-14, 14, (400, 3)))
        certificate = verify_map(decode_map(IMAGE), voxels=voxels)
        by_name = {check.name: check for check in certificate.checks}
        assert by_name["every voxel lies in a hull"].failed == len(outside_by_brute_force(IMAGE, voxels))


def test_a_missing_hull_is_caught():
    image = bytearray(IMAGE[:64] + IMAGE[RECORDS[1] :])
    struct.pack_into("<II", image, 12, 14, len(image))
    certificate = verify_map(decode_map(sealed(image)), voxels=VOXELS, cover=COVER)
    assert failing(certificate) == ["every voxel lies in a hull", "hulls contain the cover's"]
    assert "not proven: every voxel lies in a hull: voxel is in no hull at (" in certificate.complaint()


def test_a_margin_that_is_too_small_is_caught():
    (margin,) = struct.unpack_from("<f", IMAGE, 48)
    certificate = verify_map(decode_map(changed(48, "f", 0.99 * margin)), voxels=VOXELS)
    assert failing(certificate) == ["margin covers single precision"]


def test_files_of_another_lattice_or_level_are_refused():
    other = voxels_of(VOXELS["index"], voxel_size_m=0.2)
    assert failing(verify_map(decode_map(IMAGE), voxels=other)) == ["files agree"]
    level = voxels_of(VOXELS["index"], sigma=2.0)
    assert failing(verify_map(decode_map(IMAGE), voxels=level)) == []  # a map records no level
    certificate = verify_map(decode_map(IMAGE), voxels=level, cover=COVER)
    assert failing(certificate) == ["files agree"]
    assert "sigma of the cover is 1.0, of the voxels 2.0" in certificate.complaint()
    opaque = voxels_of(VOXELS["index"], min_opacity=0.5)
    certificate = verify_map(decode_map(IMAGE), voxels=opaque, cover=COVER)
    assert "min_opacity of the cover is 0.0, of the voxels 0.5" in certificate.complaint()
    claimed = voxels_of(VOXELS["index"], sigma=0.1, guarantee=Guarantee("", {"sigma": 1.0}))
    certificate = verify_map(decode_map(IMAGE), voxels=claimed)
    assert "sigma of the voxels is 0.1, but its guarantee claims 1.0" in certificate.complaint()


def test_the_cover_that_it_was_made_from_is_known_again():
    sha = "0123456789abcdef" * 4
    image = decode_map(encode_map(COVER, cover_sha256=sha))
    assert image.cover_hash == bytes.fromhex(sha[:16])
    assert verify_map(image, cover=COVER, sha256={"cover": sha}).notes == []
    (note,) = verify_map(image, cover=COVER, sha256={"cover": sha[::-1]}).notes
    assert "another cover" in note
    assert verify_map(decode_map(IMAGE), cover=COVER, sha256={"cover": sha}).notes == []


def test_the_scene_is_checked_through_the_voxels():
    scene = make_scene(30, low=(-0.5, -0.5, -0.5), high=(0.5, 0.5, 0.5))
    certificate = verify_map(decode_map(IMAGE), voxels=VOXELS, scene=scene)
    assert failing(certificate) == ["every ellipsoid lies in the voxels"]
    assert verify_map(decode_map(IMAGE), cover=COVER, scene=scene).checks[-1].failed > 0


def test_nothing_to_check_against_is_no_proof():
    with pytest.raises(UsageError, match="--voxels or --cover"):
        verify_map(decode_map(IMAGE))
    nothing = make_cover([])
    certificate = verify_map(decode_map(encode_map(nothing)), cover=nothing)
    assert "every voxel lies in a hull" in failing(certificate)


def test_integers_at_the_ends_of_the_lattice_are_exact():
    far = 2**20 - 60000
    cover = make_cover([box((far, -far, 0), (far + 60000, -far + 2, 2))], g=SIZE_M)
    image = decode_map(encode_map(cover))
    inside = voxels_of([(far, -far, 0), (far + 59999, -far + 1, 1)])
    outside = voxels_of([(far - 1, -far, 0), (far + 60000, -far + 1, 1), (far, -far, 2)])
    assert verify_map(image, voxels=inside).covered
    assert verify_map(image, voxels=outside).checks[2].failed == 3


def test_the_certificate_is_plain_data():
    certificate = verify_map(decode_map(IMAGE), voxels=VOXELS, cover=COVER)
    record = msgspec.json.decode(msgspec.json.encode(certificate))
    assert record["covered"] is True
    assert "cover does not list" not in certificate.left_out
