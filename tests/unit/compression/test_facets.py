"""Triangles of covers, compared with Qhull, trimesh and the definition of a closed surface."""

from fractions import Fraction
from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from alula.schemas.errors import ArtifactError
from alula.stages.compression.facets import mesh, triangles
from support.effort import examples
from support.scenes.fabricate import box as fabricated_box
from support.scenes.fabricate import exact_hull, make_cover


def exact_volume(points, faces):
    """Six times the volume enclosed by triangles, in integers."""
    p = [[int(x) for x in row] for row in points]
    det = lambda a, b, c: (  # noqa: E731
        a[0] * (b[1] * c[2] - b[2] * c[1])
        - a[1] * (b[0] * c[2] - b[2] * c[0])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )
    return sum(det(p[a], p[b], p[c]) for a, b, c in faces)


points_strategy = st.lists(st.tuples(*[st.integers(-6, 6)] * 3), min_size=4, max_size=25, unique=True).filter(
    lambda p: np.linalg.matrix_rank(np.array(p)[1:] - np.array(p)[0]) == 3
)


@settings(deadline=None, max_examples=examples(150))
@given(st.lists(points_strategy, min_size=1, max_size=4), st.tuples(*[st.integers(-(2**30), 2**30)] * 3))
def test_triangles_close_and_enclose_the_volume_of_the_hull(clouds, offset):
    hulls = [exact_hull(cloud) for cloud in clouds]
    cover = make_cover(hulls, offset=offset)
    faces, start = triangles(cover)
    assert start[0] == 0
    assert start[-1] == len(faces)
    for hull, ((vertices, _), (begin, end)) in enumerate(zip(hulls, pairwise(start), strict=True)):
        first = int(cover["vertex_start"][hull])
        own = faces[begin:end] - first
        assert own.min() >= 0
        assert own.max() < len(vertices)
        edges = {(int(t[i]), int(t[(i + 1) % 3])) for t in own for i in range(3)}
        assert len(edges) == 3 * len(own)
        assert edges == {(b, a) for a, b in edges}
        assert len(own) == 2 * len(vertices) - 4  # Euler, and every vertex is used
        volume = Fraction(exact_volume(vertices, own), 6)
        assert float(volume) == pytest.approx(ConvexHull(vertices).volume, rel=1e-9)


def test_meshes_are_watertight_and_convex_for_trimesh():
    import trimesh

    rng = np.random.default_rng(5)
    hulls = [exact_hull(rng.integers(-40, 40, (n, 3))) for n in (8, 30, 200)]
    hulls.append(exact_hull(list(product((0, 3), (0, 1), (0, 2)))))
    cover = make_cover(hulls)
    result = mesh(cover)
    assert result.exact.all()
    assert len(result) == 4
    for hull in range(len(hulls)):
        faces = result.triangles[result.triangle_start[hull] : result.triangle_start[hull + 1]]
        solid = trimesh.Trimesh(result.points_voxel, faces, process=False)
        solid.remove_unreferenced_vertices()
        assert solid.is_watertight
        assert solid.is_winding_consistent
        assert solid.volume == pytest.approx(ConvexHull(hulls[hull][0]).volume, rel=1e-12)


def test_points_inside_edges_and_facets_are_not_corners():
    grid = np.array(list(product((0, 1, 2), repeat=3)))
    _, planes = exact_hull(grid)
    surface = grid[(grid != 1).any(axis=1)]
    faces, _ = triangles(make_cover([(surface, planes)]))
    assert len(faces) == 12
    assert exact_volume(surface, faces) == 6 * 8


def test_an_outer_polytope_is_meshed_from_its_planes():
    vertices, _ = exact_hull(np.random.default_rng(1).integers(-9, 10, (40, 3)))
    box = np.array(
        [(*(s * np.eye(3, dtype=int)[i]), int((s * vertices[:, i]).max())) for i in range(3) for s in (-1, 1)]
    )
    cut = np.vstack([box, [(1, 1, 1, int(vertices.sum(axis=1).max()))]])
    hulls = [(vertices, cut), fabricated_box((0, -4, 2), (5, 3, 9))]
    cover = make_cover(hulls, polytopes="outer", requires=["outer-polytopes"])
    result = mesh(cover)
    assert result.exact.tolist() == [True, True]
    own = result.points_voxel[: result.point_start[1]]
    assert (own @ cut[:, :3].T <= cut[:, 3] + 1e-9).all()
    assert ((own @ cut[:, :3].T >= cut[:, 3] - 1e-9).sum(axis=1) >= 3).all()
    for hull in range(2):
        part = result.triangles[result.triangle_start[hull] : result.triangle_start[hull + 1]]
        p = result.points_voxel[part]
        volume = np.einsum("ij,ij->i", p[:, 0], np.cross(p[:, 1], p[:, 2])).sum() / 6
        points = result.points_voxel[result.point_start[hull] : result.point_start[hull + 1]]
        assert volume == pytest.approx(ConvexHull(points).volume, rel=1e-9)


def test_planes_that_bound_no_solid_are_refused():
    vertices, planes = exact_hull(list(product((0, 1), repeat=3)))
    with pytest.raises(ArtifactError, match="hull 0"):
        mesh(make_cover([(vertices, planes[:2])]))
    with pytest.raises(ArtifactError, match="hull 0"):
        mesh(make_cover([(vertices, planes[:5])], polytopes="outer", requires=["outer-polytopes"]))


def test_an_empty_cover_has_no_triangles():
    faces, start = triangles(make_cover([]))
    assert faces.shape == (0, 3)
    assert start.tolist() == [0]
    assert len(mesh(make_cover([]))) == 0


def test_the_result_is_typed_as_documented():
    faces, start = triangles(make_cover([exact_hull(list(product((0, 1), repeat=3)))]))
    assert faces.dtype == start.dtype == np.int64
