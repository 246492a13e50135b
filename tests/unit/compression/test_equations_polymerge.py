"""PolyMerge, eqs. 5, 10 and 11: budgets, voxel clusters and the greedy weighted set cover."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.effort import examples
from support.scenes.covers import cover_of, rows, voxels_of

MANY = 10**6  # hulls: nothing is merged, so the cover is the sub-cover


def subcover_of(index, block):
    """The sets of the greedy set cover."""
    cover = cover_of(voxels_of(sorted(index)), hulls=MANY, method="paper", cluster_radius=block)
    return [frozenset(rows(cover, i, "member_index")) for i in range(len(cover["plane_start"]) - 1)], cover


@given(
    st.sets(st.tuples(*3 * [st.integers(-4, 4)]), min_size=1, max_size=60),
    st.integers(0, 2),
)
@settings(deadline=None, max_examples=examples(60))
def test_a_subcover_consists_of_clusters_and_covers_every_voxel(index, block):
    clusters = {
        frozenset(w for w in index if max(abs(a - b) for a, b in zip(v, w, strict=True)) <= block)
        for v in index
    }
    sets, _ = subcover_of(index, block)
    assert set(sets) <= clusters
    assert frozenset().union(*sets) == index


def test_the_greedy_set_cover_takes_the_clusters_without_excess_where_they_suffice():
    """A block of 27 voxels with an arm: only clusters at the joint have W > 0, and they are not needed."""
    index = set(product(range(3), repeat=3)) | {(x, 1, 1) for x in range(3, 9)}
    sets, cover = subcover_of(index, 1)
    assert cover.manifest.conservativeness == 1
    assert sorted(map(len, sets)) == [3, 3, 27]


@pytest.mark.parametrize("hulls", [1, 3, 8])
def test_the_number_of_polytopes_is_within_its_budget(hulls):
    rng = np.random.default_rng(hulls)
    cover = cover_of(voxels_of(rng.integers(-6, 6, (80, 3))), hulls=hulls, method="paper")
    assert len(cover["plane_start"]) - 1 <= hulls
