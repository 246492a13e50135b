"""Real flights behind polytope-cbf that read a map in tiles, two at a time."""

import numpy as np
import pytest

from alula.schemas.artifacts.tiles import read_tiles
from alula.schemas.errors import UsageError
from alula.stages.flight.loop.supervisor import State
from support.flights.flights import PILLAR, fly, mission
from support.scenes.small_scenes import box_cover
from support.scenes.tiled import KEY, folder_of


@pytest.fixture
def tiles(tmp_path):
    """The pillar beside the way, and a block that makes three tiles along it."""
    folder_of(
        tmp_path / "room.tiles",
        box_cover([*PILLAR, ((0, 34, 0), (40, 36, 3))]),
        tile_m=1.0,
        reach_m=3.0,
        hysteresis_m=0.2,
    )
    return read_tiles(tmp_path / "room.tiles", KEY)


def test_a_flight_crosses_tiles_as_it_flies_the_whole_cover(tiles):
    cover = box_cover([*PILLAR, ((0, 34, 0), (40, 36, 3))])
    assert len(tiles.index.tiles) >= 12
    ends = []
    for given in (None, tiles):
        made = mission(cover=cover, tiles=given)
        assert (made.world.static.tiles is None) == (given is None)
        loop, vehicle = fly(made)
        assert loop.supervision.state is State.DONE
        ends.append(vehicle.x[:3].copy())
    assert np.linalg.norm(ends[0] - ends[1]) < 0.02


def test_tiles_are_for_polytope_cbf_and_must_reach_far_enough(tiles, tmp_path):
    cover = box_cover([*PILLAR, ((0, 34, 0), (40, 36, 3))])
    with pytest.raises(UsageError, match="only polytope-cbf reads tiles"):
        mission("none", cover=cover, tiles=tiles)
    near = folder_of(tmp_path / "near.tiles", cover, tile_m=1.0, reach_m=0.4, hysteresis_m=0.2)
    assert near.reach_m == pytest.approx(0.4)
    with pytest.raises(UsageError, match=r"the tiles reach 0\.4 m, .* export with a larger --reach"):
        mission(cover=cover, tiles=read_tiles(tmp_path / "near.tiles"))
