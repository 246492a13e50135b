"""The stage `verify`: valid covers are certified; faults are detected with their positions."""

import dataclasses

import msgspec
import numpy as np
import pytest

from alula.schemas.artifacts.artifact import make_artifact
from alula.schemas.artifacts.checks import check_arrays
from alula.schemas.artifacts.kinds import COVER as COVER_KIND
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.artifacts.manifest import Guarantee, InputRef
from alula.schemas.errors import ArtifactError
from alula.stages.compression.verify import verify
from support.scenes.covers import (
    SIZE_M,
    changed,
    cover_of,
    failing,
    furniture,
    holds_voxel,
    is_covered_by_brute_force,
    offences,
    planes,
    voxels_of,
    with_manifest,
    with_row,
)

VOXELS = voxels_of(furniture(1, 14))
COVERS = {method: cover_of(VOXELS, method=method, hulls=12) for method in ("default", "paper")}
COVER = COVERS["default"]
COVERS |= {"capped": cover_of(VOXELS, max_planes=90), "kdop": cover_of(VOXELS, hulls=12, kdop=14)}
OUTER = COVERS["capped"]


@pytest.mark.parametrize("method", COVERS)
def test_a_good_cover_is_certified(method):
    certificate = verify(COVERS[method], voxels=VOXELS)
    assert certificate.covered
    assert certificate.complaint() == ""
    assert [check.checked for check in certificate.checks[3:]] == [
        len(COVERS[method]["plane_start"]) - 1,
        len(COVERS[method]["member_index"]),
        len(VOXELS["index"]),
    ]
    assert verify(COVERS[method]).covered
    assert certificate == verify(COVERS[method], voxels=VOXELS, jobs=4)


@pytest.mark.parametrize("row", range(0, len(COVER["plane_offset"]), 7))
def test_a_plane_moved_by_one_unit_is_caught(row):
    for step in (-1, 1):
        bad = with_row(COVER, "plane_offset", row, COVER["plane_offset"][row] + step)
        hull = int(np.searchsorted(COVER["plane_start"], row, "right")) - 1
        certificate = verify(bad, voxels=VOXELS)
        assert "hulls are exact polytopes" in failing(certificate)
        assert {offence.hull for offence in offences(certificate)} == {hull}
        if step < 0:
            assert "members lie in their hulls" in failing(certificate)


@pytest.mark.parametrize("change", ["scaled", "flipped", "zero", "huge", "smallest"])
def test_a_bad_normal_is_caught(change):
    for row in (0, len(COVER["plane_offset"]) // 2, len(COVER["plane_offset"]) - 1):
        normal, offset = COVER["plane_normal"][row], COVER["plane_offset"][row]
        lowest = np.iinfo(np.int64).min
        bad = {
            "scaled": (2 * normal, 2 * offset),
            "flipped": (-normal, -offset),
            "zero": (0 * normal, offset),
            "huge": (normal + 2**62, offset),
            "smallest": (np.full(3, lowest), lowest),
        }[change]
        cover = with_row(with_row(COVER, "plane_normal", row, bad[0]), "plane_offset", row, bad[1])
        assert "hulls are exact polytopes" in failing(verify(cover, voxels=VOXELS))


def test_a_missing_hull_is_caught():
    for hull in range(len(COVER["plane_start"]) - 1):
        arrays = {}
        for rows, starts in (
            (("vertex",), "vertex_start"),
            (("plane_normal", "plane_offset"), "plane_start"),
            (("member_index",), "member_start"),
        ):
            begin, end = COVER[starts][hull : hull + 2]
            arrays |= {name: np.delete(COVER[name], slice(begin, end), axis=0) for name in rows}
            start = np.delete(COVER[starts], hull + 1)
            start[hull + 1 :] -= end - begin
            arrays[starts] = start
        certificate = verify(changed(COVER, **arrays), voxels=VOXELS)
        assert failing(certificate) == ["every voxel is a member"]
        begin, end = COVER["member_start"][hull : hull + 2]
        lost = {tuple(v) for v in COVER["member_index"][begin:end].tolist()}
        for offence in offences(certificate):
            assert tuple(int(np.floor(c / SIZE_M)) for c in offence.place_m) in lost
        assert certificate.checks[-1].failed == len(lost)


def test_a_missing_plane_is_caught():
    for row in range(0, len(COVER["plane_offset"]), 11):
        hull = int(np.searchsorted(COVER["plane_start"], row, "right")) - 1
        start = COVER["plane_start"].copy()
        start[hull + 1 :] -= 1
        bad = changed(
            COVER,
            plane_normal=np.delete(COVER["plane_normal"], row, axis=0),
            plane_offset=np.delete(COVER["plane_offset"], row),
            plane_start=start,
        )
        certificate = verify(bad, voxels=VOXELS)
        assert offences(certificate)[0].fault == "hull is not closed"


def test_a_missing_member_or_voxel_is_caught_and_placed():
    row = len(COVER["member_index"]) // 3
    voxel = COVER["member_index"][row]
    hull = int(np.searchsorted(COVER["member_start"], row, "right")) - 1
    start = COVER["member_start"].copy()
    start[hull + 1 :] -= 1
    bad = changed(COVER, member_index=np.delete(COVER["member_index"], row, axis=0), member_start=start)
    certificate = verify(bad, voxels=VOXELS)
    assert "every voxel is a member" in failing(certificate)
    assert certificate.checks[-1].first[0].place_m == pytest.approx((voxel + 0.5) * SIZE_M)
    assert "voxel is not covered at" in certificate.complaint()

    keep = (VOXELS["index"] != voxel).any(axis=1)
    fewer = dataclasses.replace(VOXELS, arrays={"index": VOXELS["index"][keep], "overlap": VOXELS["overlap"]})
    certificate = verify(COVER, voxels=fewer)
    assert certificate.checks[-1].first[0].fault == "member is not an occupied voxel"
    assert certificate.checks[-1].first[0].hull == hull


def test_a_moved_vertex_is_caught():
    for row in range(0, len(COVER["vertex"]), 5):
        for axis in range(3):
            bad = COVER["vertex"].copy()
            bad[row, axis] += 1 if row % 2 else -1
            certificate = verify(changed(COVER, vertex=bad), voxels=VOXELS)
            assert failing(certificate) == ["hulls are exact polytopes"]


def test_a_hull_that_holds_more_than_its_members_is_caught():
    """A valid polytope, one voxel too large: no obstacle is lost, but it is not the hull of its members."""
    from alula import _core

    cube = voxels_of([(0, 0, 0)])
    cover = cover_of(cube)
    large = _core.lattice_hull(
        np.array([(x, y, z) for x in (0, 2) for y in (0, 1) for z in (0, 1)], np.int32)
    )
    certificate = verify(changed(cover, **large), voxels=cube)
    assert {offence.fault for offence in offences(certificate)} == {"vertex is no corner of a member"}


@pytest.mark.every(2)
@pytest.mark.parametrize("method", COVERS)
def test_random_changes_are_harmless_or_caught(method):
    cover = COVERS[method]
    rng = np.random.default_rng(5)
    names = ("vertex", "plane_normal", "plane_offset", "member_index")
    caught = 0
    for trial in range(300):
        name = names[trial % len(names)]
        array = cover[name].copy()
        at = tuple(rng.integers(0, extent) for extent in array.shape)
        limits = np.iinfo(array.dtype)
        value = rng.choice([array[at] + 1, array[at] - 1, -array[at], 0, limits.max, limits.min])
        if value == array[at]:
            continue
        array[at] = value
        bad = changed(cover, **{name: array})
        certificate = verify(bad, voxels=VOXELS)
        if certificate.covered:
            # The vertices of outer polytopes only witness that planes are tight.
            assert (
                name in ("member_index", "vertex") if method in ("capped", "kdop") else name == "member_index"
            )
            assert is_covered_by_brute_force(bad, VOXELS)
        else:
            caught += 1
            assert certificate.complaint().startswith("not proven: ")
    assert caught > 200


def test_changed_starts_are_caught():
    for name in ("vertex_start", "plane_start", "member_start"):
        for hull in range(1, len(COVER[name]) - 1):
            start = COVER[name].copy()
            start[hull] += 1
            assert not verify(changed(COVER, **{name: start}), voxels=VOXELS).covered
            start[hull] = start[hull - 1]
            assert not verify(changed(COVER, **{name: start}), voxels=VOXELS).covered


def test_flat_and_empty_hulls_are_caught():
    flat = changed(
        cover_of(voxels_of([(0, 0, 0)])),
        vertex=np.array([(0, 0, 0), (0, 1, 0), (1, 0, 0), (1, 1, 0)], np.int32),
        vertex_start=np.array([0, 4]),
        plane_normal=np.array([(0, 0, -1), (0, 0, 1)]),
        plane_offset=np.array([0, 0]),
        plane_start=np.array([0, 2]),
    )
    assert "plane is no facet of its hull" in {offence.fault for offence in offences(verify(flat))}
    nothing = changed(flat, vertex=np.empty((0, 3), np.int32), vertex_start=np.array([0, 0]))
    assert {offence.fault for offence in offences(verify(nothing))} == {"hull is empty"}


def test_brute_force_sees_what_it_must():
    assert is_covered_by_brute_force(COVER, VOXELS)
    widest = int(np.argmax(np.diff(COVER["member_start"])))
    row = COVER["plane_start"][widest]
    bad = with_row(COVER, "plane_offset", row, COVER["plane_offset"][row] - 10**6)
    assert not is_covered_by_brute_force(bad, VOXELS)
    assert not holds_voxel(planes(bad, widest), COVER["member_index"][COVER["member_start"][widest]].tolist())


@pytest.mark.parametrize(
    ("name", "value"),
    [("voxel_size_m", 0.2), ("sigma", 2.0), ("min_overlap", 3), ("inflation_m", 0.1), ("frame", "scene")],
)
def test_files_of_another_level_are_caught(name, value):
    other = dataclasses.replace(VOXELS, manifest=msgspec.structs.replace(VOXELS.manifest, **{name: value}))
    certificate = verify(COVER, voxels=other)
    assert failing(certificate) == ["files agree"]
    assert name in certificate.complaint()


def test_what_is_left_out_is_named():
    crop = [-1.0, -1.0, -1.0, 1.0, 1.0, 1.0]
    voxels = voxels_of([(0, 0, 0)], min_overlap=4, crop=crop, sigma=2.5)
    text = verify(cover_of(voxels), voxels=voxels).left_out
    assert "beyond 2.5 sigma" in text
    assert "fewer than 4 ellipsoids" in text
    assert "crop -1 -1 -1 1 1 1" in text
    assert "scene itself" in text


def test_an_empty_cover_proves_nothing():
    """Even when the voxels are empty too, as no command writes them."""
    nothing = {
        **{name: COVER[name][:0] for name in ("vertex", "plane_normal", "plane_offset", "member_index")},
        **{name: np.zeros(1, np.int64) for name in ("vertex_start", "plane_start", "member_start")},
    }
    none = dataclasses.replace(VOXELS, arrays={name: VOXELS[name][:0] for name in ("index", "overlap")})
    for voxels in (None, none):
        certificate = verify(changed(COVER, **nothing), voxels=voxels)
        assert failing(certificate) == ["hulls are exact polytopes"]
        assert certificate.complaint() == "not proven: hulls are exact polytopes: there is no hull"


@pytest.mark.parametrize("name", ["sigma", "inflation_m", "min_overlap", "voxel_size_m", "crop"])
def test_a_level_other_than_the_guarantee_claims_is_caught(name):
    level = {"sigma": 1.0, "inflation_m": 0.02, "min_overlap": 1, "voxel_size_m": SIZE_M, "crop": None}
    cover = with_manifest(COVER, guarantee=Guarantee("", dict(level)), **level)
    assert verify(cover).covered
    other = {
        "sigma": 0.01,
        "inflation_m": 0.0,
        "min_overlap": 9,
        "voxel_size_m": 1.0,
        "crop": [0, 0, 0, 1, 1, 1],
    }
    certificate = verify(with_manifest(cover, **{name: other[name]}))
    assert failing(certificate) == ["files agree"]
    assert f"{name} of the cover is" in certificate.complaint()


def one_gaussian(**fields):
    arrays = {
        "mean": [[0.05, 0.05, 0.05]],
        "scale": [[0.01, 0.01, 0.01]],
        "quat_wxyz": [[1, 0, 0, 0]],
        "opacity": [1],
        "color": [[0, 0, 0]],
    }
    known = {"frame": "world", "unit": "m", "parameters": {}, "summary": {}, "source": {}}
    return make_artifact(SCENE, {name: np.array(rows) for name, rows in arrays.items()}, **(known | fields))


def test_a_scene_in_another_unit_or_frame_is_caught():
    voxels = voxels_of([(0, 0, 0)])
    cover = cover_of(voxels)
    assert verify(cover, voxels=voxels, scene=one_gaussian()).covered
    for field, value in (("unit", "arbitrary"), ("frame", "scene")):
        certificate = verify(cover, scene=one_gaussian(**{field: value}))
        assert failing(certificate) == ["files agree"]
        assert f"{field} of the cover" in certificate.complaint()


def test_what_was_lost_before_the_scene_is_named():
    voxels = voxels_of([(0, 0, 0)])
    source = {"removed": {"min_opacity": 7, "crop": 0}, "loss": {"rotation_rad": 0.03, "position": 0.0}}
    scene = one_gaussian(source=source, suggested_inflation_m=0.02)
    text = verify(cover_of(voxels), voxels=voxels, scene=scene).left_out
    assert "7 Gaussians removed by min_opacity" in text
    assert "lost against its own source, up to rotation_rad 0.03" in text
    assert "beyond 0 m, where it suggests 0.02 m" in text
    unknown = one_gaussian(alignment={"position_error_m": None})
    assert "alignment, which is not known" in verify(cover_of(voxels), scene=unknown).left_out


def test_files_other_than_those_it_was_made_from_are_noted():
    ref = InputRef("source", "alula/voxels", "1.0", "a" * 64, "room.voxels.npz")
    cover = with_manifest(COVER, inputs=[ref])
    assert verify(cover, voxels=VOXELS, sha256={"voxels": "a" * 64}).notes == []
    certificate = verify(cover, voxels=VOXELS, sha256={"voxels": "b" * 64})
    assert certificate.covered
    assert certificate.notes == ["the cover was made from another voxels file, room.voxels.npz"]


@pytest.mark.every(2)
@pytest.mark.parametrize("method", COVERS)
def test_no_change_of_any_array_or_field_passes_for_a_cover_that_is_none(method):
    """What is called covered holds every voxel by an independent check in Python's integers."""
    cover, rng, refused = COVERS[method], np.random.default_rng(11), 0
    names = [name for name in cover.arrays if cover[name].size]
    for trial in range(40 * len(names)):
        bad, changes = cover, rng.integers(1, 4)
        for name in [names[trial % len(names)], *rng.choice(names, changes - 1)]:
            array = bad[name].copy()
            at = tuple(rng.integers(0, extent) for extent in array.shape)
            limits = np.iinfo(array.dtype) if array.dtype.kind == "i" else np.finfo(array.dtype)
            other = array.reshape(-1)[rng.integers(array.size)]
            value = array[at].item()
            choice = [value + 1, value - 1, other.item(), 0, limits.max, limits.min][rng.integers(6)]
            array[at] = min(max(choice, limits.min), limits.max)
            bad = changed(bad, **{name: array})
        if trial % 3 == 0:
            other = "hull" if cover.manifest.polytopes == "outer" else "outer"
            requires = ["outer-polytopes"] if other == "outer" else []
            bad = with_manifest(bad, polytopes=other, requires=requires)
        try:
            check_arrays(COVER_KIND, bad.arrays)  # as every reader does
        except ArtifactError:
            refused += 1
            continue
        certificate = verify(bad, voxels=VOXELS)
        if certificate.covered:
            assert is_covered_by_brute_force(bad, VOXELS)
        else:
            refused += 1
            assert certificate.complaint().startswith("not proven: ")
    assert refused > 20 * len(names)
    assert verify(cover, voxels=VOXELS).covered


def test_each_plane_of_an_outer_polytope_must_touch_it():
    for row in range(0, len(OUTER["plane_offset"]), 5):
        hull = int(np.searchsorted(OUTER["plane_start"], row, "right")) - 1
        looser = verify(with_row(OUTER, "plane_offset", row, OUTER["plane_offset"][row] + 1), voxels=VOXELS)
        assert [o.fault for o in offences(looser)] == ["plane does not touch its hull"]
        assert (offences(looser)[0].plane, offences(looser)[0].hull) == (row, hull)
        assert f"hull {hull}, plane {row} at (" in looser.complaint()
        tighter = verify(with_row(OUTER, "plane_offset", row, OUTER["plane_offset"][row] - 1), voxels=VOXELS)
        assert {"vertex is outside its hull", "member is outside its hull"} == {
            o.fault for o in offences(tighter)
        }
        assert {(o.plane, o.hull) for o in offences(tighter)} == {(row, hull)}
        first = next(o for o in offences(tighter) if o.voxel is not None)
        assert first.place_m == pytest.approx((np.array(first.voxel) + 0.5) * SIZE_M)


def test_a_recorded_volume_that_is_not_that_of_the_cover_is_caught():
    for cover in (COVER, OUTER):
        for factor in (0.5, 0.9, 1.1, 1e9, float("inf"), float("nan")):
            certificate = verify(
                with_manifest(cover, conservativeness=cover.manifest.conservativeness * factor)
            )
            assert failing(certificate) == ["volume is as recorded"]
            assert "conservativeness is" in certificate.complaint()


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda h: h.__setitem__((3, 0), 10**6), "merge 3 joins an element that is not there yet"),
        (lambda h: h.__setitem__((0, 1), -1), "merge 0 joins an element that is not there yet"),
        (lambda h: h.__setitem__((0, 1), 0.5), "merge 0 joins an element that is not there yet"),
        (lambda h: h.__setitem__((2, 1), h[0, 0]), "merge 2 joins an element that was joined before"),
        (lambda h: h.__setitem__((1, 0), h[1, 1]), "merge 1 joins an element that was joined before"),
        (lambda h: h.__setitem__((1, 2), -1), "merge 1 has a negative weight"),
    ],
)
def test_a_history_that_cannot_be_is_caught(change, fault):
    for cover in (COVER, OUTER):
        history = cover["history"].copy()
        change(history)
        certificate = verify(changed(cover, history=history), voxels=VOXELS)
        assert failing(certificate) == ["history is consistent"]
        assert fault in {o.fault for o in offences(certificate)}
    lost = dict(COVER.manifest.summary) | {"start_hulls": len(COVER["history"])}
    assert failing(verify(with_manifest(COVER, summary=lost))) == ["history is consistent"]
