"""Maps in tiles: every tile is a map of the whole, and commands across borders are those of the whole map."""

import hashlib
import hmac
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from alula.schemas.artifacts import merkle
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.artifacts.tiles import BINARY, SIGNATURE, WHOLE, read_tiles, read_tiles_index
from alula.schemas.errors import (
    ArtifactError,
    CheckError,
    DamagedError,
    InfeasibleError,
    UsageError,
    VersionError,
)
from alula.schemas.scenarios.scenario import decoded
from alula.stages.compression.hulls import ROWS
from alula.stages.compression.onboard import hull_records
from alula.stages.compression.onboard.image import decode_map
from alula.stages.compression.onboard.layout import encode_map, with_records
from alula.stages.compression.onboard.tiles import _records, cut_tiles, fastest_m_s, sealed, voxels_up
from alula.stages.compression.onboard.verify_tiles import verify_tiles
from alula.stages.filtering.obstacles import tile_set
from alula.stages.filtering.polytope_cbf import polytope_cbf
from alula.stages.filtering.protocol import FilterWorld
from alula.stages.simulation.pairs import Pairs
from alula.stages.simulation.prepare import prepare
from support.effort import examples
from support.models.wrench_flight import VEHICLE
from support.scenes.covers import cover_of, furniture, voxels_of
from support.scenes.fabricate import exact_hull, make_cover
from support.scenes.tiled import KEY, cut, folder_of, native, posts, set_key, with_image

NOBODY = Provenance.now("alula/tiles", "1.0", {}, None, [])
OPTIONS = {"extent_m": 30.0, "radius_m": 0.15, "beta": 2.0, "kappa": 100.0, "dt_s": 0.02, "v_max": 1.5}


@pytest.fixture(scope="module")
def field():
    """Posts in an area of 8 x 8 m, their whole map, and tiles of 1.2 m."""
    cover = posts()
    return SimpleNamespace(
        cover=cover, whole=encode_map(cover, indexed=True), cut=cut(cover), tiles=native(cut(cover), KEY)
    )


def legs(rng, count):
    """Straight ways through the field, along both axes and diagonally."""
    for k in range(count):
        side = rng.uniform(-4.5, 4.5, 2)
        start = [(-5.0, side[0]), (side[0], -5.0), (-5.0, -5.0 + k / 9), (5.0, side[0])][k % 4]
        goal = [(5.0, side[1]), (side[1], 5.0), (5.0, 5.0 - k / 9), (-5.0, side[1])][k % 4]
        yield np.array([*start, 0.3]), np.array([*goal, 0.5])


def test_commands_across_hundreds_of_borders_are_those_of_the_whole_map(field):
    rng = np.random.default_rng(3)
    by_whole = _core.PolytopeCbf.from_image(field.whole, **OPTIONS)
    by_tile = _core.PolytopeCbf.from_tiles(field.tiles, 0, **OPTIONS)
    ticks = borders = switches = changed = 0
    for x, goal in legs(rng, 36):
        last = tile = None
        slow = 0
        while slow < 40:
            way = goal - x
            u_nom = (1.4 * way / np.linalg.norm(way) + 0.3 * rng.normal(size=3)).tolist()
            one, other = by_whole.filter(x.tolist(), u_nom), by_tile.filter(x.tolist(), u_nom)
            assert one[:2] == other[:2]
            assert one[3] > 1.6 or one[3] == other[3]
            row, is_inside = by_tile.tile()
            assert is_inside
            switches += last not in (None, row)
            last = row
            ticks, changed = ticks + 1, changed + (one[1] > 0)
            x = x + OPTIONS["dt_s"] * np.array(one[0])
            here = tuple(np.floor(x[:2] / 1.2).astype(int))
            borders += tile not in (None, here)
            tile = here
            slow += np.linalg.norm(one[0]) < 0.2
            if np.linalg.norm(goal - x) < 0.2:
                break
    assert borders >= 200
    assert switches >= 200
    assert changed > 0.2 * ticks
    assert ticks > 5000


def differing(rng, share, count):
    """Counts, at a share of the stated reach: commands unlike the whole map's, and changed ones."""
    cover = posts(18, 18, pitch=int(rng.choice([5, 9])), seed=int(rng.integers(1000)))
    options = OPTIONS | {
        "radius_m": float(rng.choice([0.0, 0.1, 0.3])),
        "beta": float(rng.choice([0.5, 2, 10])),
        "kappa": float(rng.choice([20, 100, 1000])),
        "v_max": float(rng.choice([0.3, 1, 3])),
        "smoothing": str(rng.choice(["sound", "paper"])),
    }
    by_whole = _core.PolytopeCbf.from_image(encode_map(cover), **options)
    made = cut(cover, tile_m=float(rng.choice([0.5, 1])), reach_m=share * by_whole.reach_m, hysteresis_m=0.1)
    edge, lowest, grid = 0.1 * made.index["tile"], np.array(made.index["first"]), made.index["count"]
    by_tile = [_core.PolytopeCbf.from_image(image, **options) for image in made.images]
    different = changed = 0
    for x in rng.uniform([-2.5, -2.5, -1], [2.5, 2.5, 1.6], (count, 3)):
        at = np.clip(np.floor(x[:2] / edge).astype(int) - lowest, 0, np.subtract(grid, 1))
        u = (rng.normal(size=3) * options["v_max"]).tolist()
        one = by_whole.filter(x.tolist(), u)
        different += one[:2] != by_tile[at[1] * grid[0] + at[0]].filter(x.tolist(), u)[:2]
        changed += one[1] > 0
    return different, changed


def test_the_stated_reach_is_enough_for_all_parameters_and_less_is_not():
    rng = np.random.default_rng(7)
    enough = [differing(rng, 1.0, 300) for _ in range(4)]
    assert sum(different for different, _ in enough) == 0
    assert sum(changed for _, changed in enough) > 600
    assert sum(differing(rng, 0.3, 300)[0] for _ in range(4)) > 0


def flights(field, starts, goals, tiles=None, **world):
    """Native logs of a point that is simulated behind polytope-cbf, which reads the onboard map or tiles."""
    named = {"cover": "x"} | ({"onboard": True} if tiles is None else {"tiles": "x"}) | world
    scenario = decoded(
        {
            "vehicle": {"type": "single-integrator", "radius_m": 0.15, "max_speed_m_s": 1.5},
            "world": named,
            "mission": {"pairs_from": "x", "speed_m_s": 1.5, "beyond_map_m": 20.0},
            "safety": {"filters": ["polytope-cbf"]},
            "rules": {"max_time_s": 12.0, "dt_s": 0.02},
        }
    )
    pairs = Pairs(starts, goals, 0, 0)
    run = prepare(scenario, cover=field.cover, tiles=tiles, pairs=pairs, jobs=1)
    return run.fly(0, len(starts), jobs=1)


@pytest.fixture(scope="module")
def folder(field, tmp_path_factory):
    """The tiles of the field as a folder, signed."""
    path = tmp_path_factory.mktemp("tiles") / "field.tiles"
    folder_of(path, field.cover)
    return path


def lanes(count):
    """Starts and goals of lanes along both axes and both ways, with free ends outside the field."""
    y = np.linspace(-4.45, 4.55, count)
    ends = np.stack([np.full(count, 5.0), y, np.full(count, 0.4)], axis=1)
    starts = ends * [-1, 1, 1]
    across = [(starts, ends), (ends, starts)]
    across += [(one[:, [1, 0, 2]], other[:, [1, 0, 2]]) for one, other in across]
    return tuple(np.vstack(each) for each in zip(*across, strict=True))


def test_a_simulated_flight_through_tiles_is_that_in_the_whole_map(field, folder):
    starts, goals = lanes(11)
    whole = flights(field, starts, goals)
    tiled = flights(field, starts, goals, tiles=read_tiles(folder, KEY))
    borders = 0
    for one, other in zip(whole, tiled, strict=True):
        for name in ("state", "command", "nominal", "each_status", "status"):
            if name in one:
                assert one[name].tobytes() == other[name].tobytes(), name
        tiles = np.floor(one["state"][:, :2] / 1.2)
        borders += int((np.diff(tiles, axis=0) != 0).any(axis=1).sum())
    assert borders >= 200


def test_a_simulated_vehicle_waits_for_tiles_that_load_slowly(tmp_path):
    few = SimpleNamespace(cover=posts(40, 40, pitch=20))
    folder_of(tmp_path / "few.tiles", few.cover)
    tiles = read_tiles(tmp_path / "few.tiles", KEY)
    starts, goals = np.array([[-5.0, 1.05, 0.4]]), np.array([[5.0, 1.05, 0.4]])  # without a post in the way
    (fast,), (slow,) = (flights(few, starts, goals, tiles, tile_load_s=load_s) for load_s in (0.1, 2.0))
    by_psi = _core.PolytopeCbf.from_image(encode_map(few.cover, indexed=True), **OPTIONS)
    for one in (fast, slow):
        assert by_psi.psi(np.ascontiguousarray(one["state"][:, :3]))[1].min() >= OPTIONS["radius_m"] - 1e-4
    assert np.linalg.norm(fast["state"][-1, :3] - goals) < 0.2
    assert len(slow["state"]) > len(fast["state"])
    paths = [one["state"][one["state"][:, 0] < 3, :2] for one in (fast, slow)]  # before it slows for the goal
    speeds = [np.linalg.norm(np.diff(path, axis=0), axis=1) / 0.02 for path in paths]
    assert speeds[0].min() > 1
    assert speeds[1].min() < 0.2  # in front of walls it waits
    assert speeds[1].max() > 1.3


def test_a_tile_that_does_not_come_is_a_wall(field):
    late = _core.PolytopeCbf.from_tiles(field.tiles, 10**6, **OPTIONS)
    x = np.array([0.6, 0.05, 0.4])
    first, outside = None, 0
    for _ in range(400):
        u, status, *_ = late.filter(x.tolist(), [-1.5, 0.0, 0.0])
        assert status != 4
        first = first or late.tile()
        assert late.tile()[0] == first[0]
        outside += not late.tile()[1]
        x += OPTIONS["dt_s"] * np.array(u)
    assert outside > 50
    assert -1.8 + OPTIONS["radius_m"] <= x[0] < -1.5  # tile 0 ends at 0, and its wall is 1.6 + 0.2 m farther
    assert late.filter([-4.0, 0.05, 0.4], [1.0, 0.0, 0.0])[:2] == ([0, 0, 0], 4)
    assert late.tile() == (-1, False)
    late.reset()
    assert late.filter([-4.0, 0.05, 0.4], [1.0, 0.0, 0.0])[1] != 4


def test_tiles_that_do_not_reach_far_enough_are_refused(field):
    needed = _core.PolytopeCbf.from_image(field.whole, **OPTIONS).reach_m
    assert needed == pytest.approx(0.15 + 0.75 + 0.03 + 0.46, abs=1e-2)
    with pytest.raises(ValueError, match=r"the tiles reach 1\.6 m, and .* up to 1\.65 m away count"):
        _core.PolytopeCbf.from_tiles(field.tiles, 0, **OPTIONS | {"v_max": 2.0})
    fastest = fastest_m_s(field.whole, 1.6)
    limits = OPTIONS | {"radius_m": 0.1, "dt_s": 0.002}
    _core.PolytopeCbf.from_tiles(field.tiles, 0, **limits | {"v_max": fastest - 1e-3})
    with pytest.raises(ValueError, match="with a larger --reach"):
        _core.PolytopeCbf.from_tiles(field.tiles, 0, **limits | {"v_max": fastest + 1e-3})
    assert fastest_m_s(field.whole, 0.3) == 0
    world = FilterWorld(radius_m=0.15, dt_s=0.02, hulls=1, tiles=field.tiles, speed_m_s=4.0)
    with pytest.raises(UsageError, match=r"polytope-cbf: the tiles reach .* export with a larger --reach"):
        polytope_cbf(world, {})


@settings(deadline=None, max_examples=examples(6))
@given(st.data())
def test_every_tile_has_all_hulls_within_reach_and_walls_for_the_rest(data):
    seed = data.draw(st.integers(0, 99))
    cover = posts(
        18, 14, pitch=6, seed=seed, offset=data.draw(st.sampled_from([(0, 0, 0), (7, -2001, 5), (40, 13, 0)]))
    )
    tile_m, reach_m = data.draw(st.sampled_from([0.5, 0.9, 3.0])), data.draw(st.sampled_from([0.1, 0.4, 5.0]))
    made = cut(cover, tile_m=tile_m, reach_m=reach_m, hysteresis_m=0.1)
    raw = encode_map(cover)
    whole, image = _core.OnboardMap(raw), decode_map(raw)
    edge, reach, hysteresis = (made.index[key] for key in ("tile", "reach", "hysteresis"))
    assert (edge, reach, hysteresis) == tuple(voxels_up(each, 0.1) for each in (tile_m, reach_m, 0.1))
    lower, upper = image.lower.min(axis=0), image.upper.max(axis=0)
    last = [start + count - 1 for start, count in zip(made.index["first"], made.index["count"], strict=True)]
    assert [start * edge for start in made.index["first"]] <= lower[:2].tolist()
    assert all((end + 1) * edge >= high for end, high in zip(last, upper[:2], strict=True))
    rng = np.random.default_rng(seed)
    vertex, start = cover["vertex"], cover["vertex_start"]
    for tile, tile_image in zip(made.index["tiles"], made.images, strict=True):
        decoded_tile, native_tile = decode_map(tile_image), _core.OnboardMap(tile_image)
        assert native_tile.margin_m == whole.margin_m
        # every vertex of every hull is in a hull or a wall
        low = (np.array([tile.i, tile.j]) * edge - hysteresis - reach) * np.ones(2, int)
        high = low + edge + 2 * (hysteresis + reach)
        for h in range(len(start) - 1):
            corners = vertex[start[h] : start[h + 1]]
            meets = (corners[:, :2].min(axis=0) <= high).all() and (corners[:, :2].max(axis=0) >= low).all()
            boxes = zip(decoded_tile.lower[-tile.walls :], decoded_tile.upper[-tile.walls :], strict=True)
            walled = tile.walls and any(((corners >= a) & (corners <= b)).all() for a, b in boxes)
            assert meets or walled
        # at positions in the region psi is that of the whole where it is below the reach, and never above
        ends = [(tile.i, 0), (tile.j, 1)]
        at = np.empty((40, 3), np.float32)
        for number, k in ends:
            a = number * edge - hysteresis if number > made.index["first"][k] else lower[k] - 30
            b = (number + 1) * edge + hysteresis if number < last[k] else upper[k] + 30
            at[:, k] = 0.1 * rng.uniform(a + 1e-3, b - 1e-3, 40)
        at[:, 2] = rng.uniform(-2, 2.5, 40)
        psi, _, normal = native_tile.psi(at)
        psi_whole, _, normal_whole = whole.psi(at)
        near = psi_whole < 0.1 * reach - 1e-3
        assert (psi[near] == psi_whole[near]).all()
        assert (normal[near] == normal_whole[near]).all()
        assert (psi[~near] >= 0.1 * reach - 2e-3).all()
        assert (psi <= psi_whole).all()
    leaves = [merkle.leaf(hashlib.sha256(image).digest()) for image in made.images]
    assert made.index["merkle_root"] == merkle.root(leaves)


def test_a_shield_that_reads_the_tile_certifies_as_with_the_whole_map(field):
    """Its manoeuvres stay within the reach, so no wall and no hull that is not loaded decides."""
    policy = _core.BackupPolicy(VEHICLE, "brake")
    number = next(k for k, tile in enumerate(field.cut.index["tiles"]) if (tile.i, tile.j) == (0, 0))
    whole, tile = (
        _core.Shield(policy, _core.ImageMap(raw), 0.15) for raw in (field.whole, field.cut.images[number])
    )
    rng, safe = np.random.default_rng(4), []
    for _ in range(60):
        x = np.concatenate(
            [rng.uniform(0, 1.2, 2), [0.4], np.zeros(3), rng.normal(scale=0.5, size=3), np.zeros(3)]
        )
        one, other = whole.certify(x), tile.certify(x)
        assert one["safe"] == other["safe"]
        safe.append(one["safe"])
    assert 10 < sum(safe) < 60


def test_the_root_is_that_of_rfc_6962():
    def plain(leaves):
        if len(leaves) == 1:
            return hashlib.sha256(b"\0" + leaves[0]).digest()
        half = 1 << ((len(leaves) - 1).bit_length() - 1)
        return hashlib.sha256(b"\1" + plain(leaves[:half]) + plain(leaves[half:])).digest()

    for count in (1, 2, 3, 5, 8, 11):
        leaves = [bytes([k]) * 32 for k in range(count)]
        assert merkle.root(list(map(merkle.leaf, leaves))) == plain(leaves).hex()


def test_what_is_read_is_what_was_written_and_its_signature_is_checked(field, folder):
    found = read_tiles(folder, KEY)
    assert [raw[64:] for raw in found.images] == [raw[64:] for raw in field.cut.images]
    assert found.is_verified
    assert not read_tiles(folder).is_verified
    assert found.signature == hmac.digest(KEY, found.binary, "sha256")
    assert len(tile_set(found)) == len(found.images)
    with pytest.raises(CheckError, match="does not match the key"):
        read_tiles(folder, bytes(32))
    _core.TileSet(found.binary, list(found.images), key=KEY, signature=found.signature)
    with pytest.raises(ValueError, match="does not match the key"):
        _core.TileSet(found.binary, list(found.images), key=bytes(32), signature=found.signature)
    with pytest.raises(ValueError, match="not those of the index"):
        _core.TileSet(found.binary, list(found.images[1:]))
    with pytest.raises(ValueError, match="not an index"):
        _core.TileSet(found.images[0], list(found.images))


@pytest.fixture
def small(tmp_path):
    """A small folder of tiles, its index and its cover."""
    cover, path = cover_of(voxels_of(furniture(2, 14)[:-5]), hulls=25), tmp_path / "small.tiles"
    index = folder_of(path, cover, tile_m=0.5, reach_m=0.3, hysteresis_m=0.1)
    return path, index, cover


def flip(path, at=-1):
    raw = bytearray(path.read_bytes())
    raw[at] ^= 1
    path.write_bytes(bytes(raw))


def test_what_was_changed_is_refused(small):
    path, index, _ = small
    assert verify_tiles(read_tiles(path), cover=small[2]).covered
    for name in (index.tiles[3].file, BINARY, WHOLE):
        flip(path / name)
        with pytest.raises(ArtifactError, match=name.replace(".", r"\.")):
            read_tiles(path)
        flip(path / name)
    (path / SIGNATURE).unlink()
    with pytest.raises(CheckError, match="not signed; export it with --sign"):
        read_tiles(path, KEY)
    read_tiles(path)
    for name, value, error in (
        ("merkle_root", 64 * "a", DamagedError),
        ("hysteresis", 5, DamagedError),
        ("first", [0, 0], DamagedError),
        ("version", "2.0", VersionError),
        ("schema", "alula/other", ArtifactError),
        ("tile", 0, DamagedError),
    ):
        old = msgspec.to_builtins(read_tiles_index(path))[name]
        set_key(path, name, value)
        with pytest.raises(error):
            read_tiles_index(path)
        set_key(path, name, old)
    read_tiles(path)


def test_a_tile_without_a_hull_or_with_a_wall_too_near_is_not_proven(small):
    path, index, cover = small
    number = max(range(len(index.tiles)), key=lambda k: index.tiles[k].hulls)
    tile, raw = index.tiles[number], (path / index.tiles[number].file).read_bytes()
    records = _records(raw, decode_map(raw))
    assert tile.walls > 0
    with_image(path, number, with_records(raw, records[1:], indexed=True))
    found = verify_tiles(read_tiles(path, KEY), cover=cover)
    failed = {check.name for check in found.checks if not check.ok}
    assert "images fit the index" in failed
    assert "voxels within reach in hulls" in failed or "hulls within reach contain the cover's" in failed
    assert tile.file in found.complaint()
    wall = bytearray(records[-1])
    wall[:2] = (-200 & 0xFFFF).to_bytes(2, "little")
    with_image(path, number, with_records(raw, [*records[:-1], bytes(wall)], indexed=True))
    assert not verify_tiles(read_tiles(path, KEY), cover=cover).covered
    fewer = [*records[: tile.hulls - 1], records[tile.hulls], *records[tile.hulls :]]
    with_image(path, number, with_records(raw, fewer, indexed=True))  # a wall takes the place of a hull
    found = verify_tiles(read_tiles(path, KEY), cover=cover)
    assert {check.name for check in found.checks if not check.ok} & {
        "voxels within reach in hulls",
        "hulls within reach contain the cover's",
    }


class Parted:
    """Covers in memory as the parts of one."""

    def __init__(self, parts):
        self.manifest, self.parts, self.refs = parts[0].manifest, parts, ()

    def __len__(self):
        return len(self.parts)

    def __getitem__(self, number):
        return self.parts[number]


@pytest.mark.parametrize("is_mixed", [True, False])
def test_tiles_of_a_cover_in_parts_are_those_of_the_whole_map(monkeypatch, is_mixed):
    """Also where only some hulls need oblique planes; the records of all then have the same layout."""
    monkeypatch.setattr(hull_records, "_HELD", 0)
    corners = np.argwhere(np.ones((3, 3, 3)))
    cubes = [exact_hull(corners + np.array([40 + 9 * k, 3 * k, 0])) for k in range(9)]
    parts = [posts(18, 18), make_cover(cubes, g=0.1), posts(9, 9, offset=(-60, 2, 0))]
    parts = parts if is_mixed else [parts[1]]
    whole = encode_map(joined_cover(parts))
    image, images = decode_map(whole), []
    lengths = {"tile_m": 1.2, "reach_m": 0.5, "hysteresis_m": 0.2}
    index = cut_tiles(Parted(parts), images.append, largest_normal=127, **lengths)
    records, found = _records(whole, image), sealed(index, key_id="", provenance=NOBODY)
    assert (decode_map(images[0]).is_kdop, image.is_kdop) == (not is_mixed, not is_mixed)
    for tile, raw in zip(index["tiles"], images, strict=True):
        low, high = (np.array(ends) for ends in found.loaded(tile))
        near = ((image.lower[:, :2] <= high) & (image.upper[:, :2] >= low)).all(axis=1)
        mine = _records(raw, decode_map(raw))
        assert mine[: tile.hulls] == [records[h] for h in np.flatnonzero(near)]
        assert raw[10] == whole[10]  # the largest component of a normal


def joined_cover(parts):
    """The hulls of several covers as one cover."""
    arrays = {}
    for start, names in {**ROWS, None: ("history",)}.items():
        arrays |= {name: np.concatenate([part[name] for part in parts]) for name in names}
        if start is not None:
            sizes = np.concatenate([np.diff(part[start]) for part in parts])
            arrays[start] = np.concatenate([[0], np.cumsum(sizes)])
    return Artifact(parts[0].manifest, arrays)


def test_lengths_that_make_no_tiles_are_refused(small, monkeypatch):
    _, _, cover = small
    with pytest.raises(InfeasibleError, match="too small for a hysteresis"):
        cut(cover, tile_m=0.3, reach_m=0.3, hysteresis_m=0.2)
    empty = posts(-1, -1)
    with pytest.raises(ArtifactError, match="no hulls"):
        cut(empty)
    monkeypatch.setattr("alula.stages.compression.onboard.tiles.MOST_TILES", 3)
    with pytest.raises(InfeasibleError, match="more than 3; take larger tiles"):
        cut(cover)
