"""PolyMerge's Table I and Figure 4: the numbers in them, and the surface that CoACD gets."""

from itertools import product

import numpy as np
import pytest

from alula.stages.reporting.table import table_csv
from papers.polymerge.maps import (
    curve_figure,
    curve_table,
    excess_saved,
    in_short,
    sizes_table,
    volumes_figure,
    volumes_table,
)
from papers.polymerge.voxel_mesh import voxel_mesh
from support.scenes.polymerge_maps import ROOM, TREE


def test_sizes_stand_beside_the_published_ones():
    table = sizes_table([ROOM, TREE])
    found = {row[0]: row[1:] for row in table.rows}
    assert len(found) == 2 + 9
    assert all(len(row) == len(table.columns) for row in table.rows)
    assert found["room"] == (20_000, 0.9, 0.8, 30, 500, 0.09, 0.008, 30, 400, 0.05, 0.0064, 0.0016)
    assert found["tree <&>"][3:7] == (None,) * 4
    assert found["published: Room"] == (
        *(1_060_000, 473.6, pytest.approx(42.4)),
        *(454, 26_000, 1.8, pytest.approx(0.416)),
        *(454, 33_000, 8.5, pytest.approx(0.528), None),
    )


def test_the_figures_show_the_numbers_of_their_tables():
    volumes = volumes_table([ROOM, TREE])
    assert [row[:6] for row in volumes.rows[:3]] == [
        ("room", "ours", 30, 400, 1.2, 1.0),
        ("room", "paper's rule", 30, 420, 1.25, 1.0),
        ("room", "surface + CoACD", 30, 500, 1.3, 0.875),
    ]
    assert table_csv(volumes).splitlines()[3] == "room,surface + CoACD,30,500,1.3,0.875,250,1000,0.05"
    assert [row[2:] for row in curve_table([ROOM]).rows][:3] == [
        (n, 14 * n, 1 + 6 / n) for n in (10, 30, 100)
    ]
    for drawn in (volumes_figure([ROOM, TREE]), curve_figure([ROOM, TREE])):
        assert drawn.figure.svg.startswith("<?xml")
        assert "tree &lt;&amp;&gt;" in drawn.figure.svg
        assert drawn.png.startswith(b"\x89PNG")
        assert "room" in drawn.figure.alt
    assert volumes_figure([ROOM]) == volumes_figure([ROOM])
    assert "1.3 with 0.875 inside" in volumes_figure([ROOM]).figure.alt
    assert "from 1.6 at 10 hulls to 1.06 at 100" in curve_figure([ROOM]).figure.alt


def test_in_short_says_what_was_saved():
    assert excess_saved(ROOM) == pytest.approx(0.2)
    line = in_short([ROOM])["room"]
    assert "20 % below the paper's rule" in line
    assert line.endswith("CoACD 1.3, leaves out parts of 25 % of the voxels, 12.5 % of their volume")


@pytest.mark.parametrize("seed", range(4))
def test_the_surface_of_voxels_bounds_their_volume(seed):
    cells = np.array(list(product(range(-3, 2), repeat=3)))
    index = cells[np.random.default_rng(seed).random(len(cells)) < 0.4]
    corners, triangles = voxel_mesh(index[::-1])
    assert len(np.unique(corners, axis=0)) == len(corners)
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    assert (np.cross(b - a, c - a) * a).sum() == 6 * len(index)
    assert (np.abs(np.cross(b - a, c - a)).sum(axis=1) == 1).all()
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    forward, backward = (np.sort(e[:, 0] * len(corners) + e[:, 1]) for e in (edges, edges[:, ::-1]))
    assert (forward == backward).all()
    occupied = {tuple(v) for v in index.tolist()}
    steps = [s for s in product((-1, 0, 1), repeat=3) if sum(map(abs, s)) == 1]
    free = sum(tuple(np.add(v, s)) not in occupied for v in occupied for s in steps)
    assert len(triangles) == 2 * free


def test_no_voxels_have_no_surface():
    assert [len(a) for a in voxel_mesh(np.empty((0, 3), np.int32))] == [0, 0]
