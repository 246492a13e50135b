"""Occupancy of ellipsoids, compared with exact rational arithmetic, sampling and brute force."""

import itertools
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from alula import _core
from alula.schemas.artifacts.artifact import make_artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.errors import InfeasibleError, InputError
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.stages.compression.ellipsoids import unproven_voxels
from alula.stages.compression.voxelize import sigma_of_confidence, voxelize
from support.effort import examples

EXACT_CELLS = 40  # rational arithmetic costs about 2 ms per voxel


def rows(mean, scale, quat):
    quat = np.atleast_2d(np.asarray(quat, float))
    quat = quat / np.linalg.norm(quat, axis=1, keepdims=True)
    return tuple(np.ascontiguousarray(np.atleast_2d(a), np.float32) for a in (mean, scale, quat))


def scene_of(mean, scale, quat, **fields):
    mean, scale, quat = rows(mean, scale, quat)
    arrays = {
        "mean": mean,
        "scale": scale,
        "quat_wxyz": quat,
        "opacity": np.ones(len(mean)),
        "color": np.zeros((len(mean), 3)),
    }
    keywords = {"frame": "world", "unit": "m", "parameters": {}, "summary": {}, "source": {}} | fields
    return make_artifact(SCENE, arrays, **keywords)


def rotation(q, one=1.0):
    """Matrices of quaternions w x y z along the first axis; exact for Fractions."""
    w, x, y, z = q
    n = w * w + x * x + y * y + z * z
    return [
        [one - 2 * (y * y + z * z) / n, 2 * (x * y - w * z) / n, 2 * (x * z + w * y) / n],
        [2 * (x * y + w * z) / n, one - 2 * (x * x + z * z) / n, 2 * (y * z - w * x) / n],
        [2 * (x * z - w * y) / n, 2 * (y * z + w * x) / n, one - 2 * (x * x + y * y) / n],
    ]


def exact_form(scale, quat, sigma):
    """inv(Sigma) / k^2 as Fractions."""
    r = rotation([Fraction(float(v)) for v in quat], Fraction(1))
    inverse = [1 / (Fraction(sigma) * Fraction(float(s))) ** 2 for s in scale]
    return [[sum(r[i][k] * inverse[k] * r[j][k] for k in range(3)) for j in range(3)] for i in range(3)]


def exact_minimum(form, lower, upper):
    """Least value of x' form x over a box: the least over all faces of all dimensions."""
    found = []
    for state in itertools.product((0, 1, 2), repeat=3):
        free = [i for i in range(3) if state[i] == 2]
        x = [(lower[i], upper[i], Fraction(0))[state[i]] for i in range(3)]
        rhs = [-sum(form[f][j] * x[j] for j in range(3)) for f in free]
        if len(free) == 1:
            x[free[0]] = rhs[0] / form[free[0]][free[0]]
        elif len(free) == 2:
            f, g = free
            det = form[f][f] * form[g][g] - form[f][g] ** 2
            x[f] = (rhs[0] * form[g][g] - rhs[1] * form[f][g]) / det
            x[g] = (rhs[1] * form[f][f] - rhs[0] * form[f][g]) / det
        if all(lower[i] <= x[i] <= upper[i] for i in free):
            found.append(sum(form[i][j] * x[i] * x[j] for i in range(3) for j in range(3)))
    return min(found)


def touches_exactly(form, mean, cell, g):
    centre = [Fraction(float(c)) for c in mean]
    lower = [cell[i] * Fraction(g) - centre[i] for i in range(3)]
    upper = [(cell[i] + 1) * Fraction(g) - centre[i] for i in range(3)]
    return exact_minimum(form, lower, upper) <= 1


def touched_table(mean, scale, quat, sigma, g, lower, upper):
    """Boolean table of a block of voxels by the same enumeration in numpy, for round ellipsoids."""
    r = np.array(rotation(quat.astype(float)))
    form = r @ np.diag(1 / (sigma * scale.astype(float)) ** 2) @ r.T
    axes = [np.arange(lower[a], upper[a] + 1) for a in range(3)]
    cell = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    low, high = cell * g - mean, (cell + 1) * g - mean
    best = np.full(len(cell), np.inf)
    for state in itertools.product((0, 1, 2), repeat=3):
        free = [i for i in range(3) if state[i] == 2]
        x = np.stack([(low[:, i], high[:, i], np.zeros(len(cell)))[state[i]] for i in range(3)], axis=-1)
        if free:
            x[:, free] = np.linalg.solve(form[np.ix_(free, free)], -(x @ form)[:, free].T).T
        inside = ((x >= low) & (x <= high))[:, free].all(axis=1)
        value = np.einsum("ni,ij,nj->n", x, form, x)
        best = np.where(inside, np.minimum(best, value), best)
    return cell, best <= 1


def unit(rng):
    kinds = (rng.normal(size=4), [1, 0, 0, 0], [1, 1, 0, 0], [1, 1e-8, 0, 1e-5], [1, 1, 1, 1])
    return np.asarray(kinds[rng.choice(5, p=(0.6, 0.1, 0.1, 0.1, 0.1))], float)


SHAPES = {
    "round": lambda rng: 10 ** rng.uniform(-2.5, -0.8, 3),
    "disc": lambda rng: np.array([10 ** rng.uniform(-2.5, -0.8), 10 ** rng.uniform(-2.5, -0.8), 1e-6]),
    "leaf": lambda rng: np.array([0.1, 0.08, 1e-9]),
    "needle": lambda rng: np.array([1e-9, 10 ** rng.uniform(-2, -0.6), 1e-9]),
    "any": lambda rng: 10 ** rng.uniform(-9, -1, 3),
}


@pytest.mark.every(4)
@pytest.mark.parametrize("offset", [0.0, 1e4])
@pytest.mark.parametrize("shape", SHAPES)
def test_marked_voxels_are_exactly_those_touched(shape, offset):
    rng = np.random.default_rng(sorted(SHAPES).index(shape))
    g, sigma = 0.05, 1.5
    for trial in range(6):
        centre = rng.uniform(-0.1, 0.1, 3) + offset
        if trial % 3 == 0:
            centre = np.round(centre / g) * g  # voxel corners: exact ties
        mean, scale, quat = rows(centre, SHAPES[shape](rng), unit(rng))
        index, overlap, *_ = _core.voxelize(mean, scale, quat, sigma, g)
        marked = set(map(tuple, index.tolist()))
        assert (overlap == 1).all()
        span = [
            range(a - 1, b + 2) for a, b in zip(index.min(0).tolist(), index.max(0).tolist(), strict=True)
        ]
        cells = list(itertools.product(*span))
        form = exact_form(scale[0], quat[0], sigma)
        for i in rng.choice(len(cells), min(EXACT_CELLS, len(cells)), replace=False):
            assert touches_exactly(form, mean[0], cells[i], g) == (cells[i] in marked), (shape, cells[i])


def test_a_sphere_that_ends_on_a_voxel_face_marks_the_next_voxel():
    index, *_ = _core.voxelize(*rows([0.5, 0.5, 0.5], [0.5] * 3, [1, 0, 0, 0]), 1.0, 1.0)
    faces = {(0, 0, 0), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)}
    assert set(map(tuple, index.tolist())) == faces


def test_overlap_counts_agree_with_brute_force():
    rng = np.random.default_rng(7)
    mean, scale, quat = rows(
        rng.uniform(-0.4, 0.4, (25, 3)), rng.uniform(0.02, 0.2, (25, 3)), rng.normal(size=(25, 4))
    )
    g = 0.07
    lower, upper = np.full(3, -13), np.full(3, 12)
    total = 0
    for i in range(25):
        cell, touched = touched_table(mean[i], scale[i], quat[i], 2.0, g, lower, upper)
        total = total + touched.astype(int)
    index, overlap, reach, below, most = _core.voxelize(mean, scale, quat, 2.0, g)
    assert (reach == 1).all()
    assert (below, most) == (0, total.max())
    np.testing.assert_array_equal(index, cell[total > 0])
    np.testing.assert_array_equal(overlap, total[total > 0])


@settings(max_examples=examples(40), deadline=None)
@given(seed=st.integers(0, 2**32 - 1), inflation=st.sampled_from([0.0, 0.003, 0.05, 0.4]))
def test_no_point_of_a_grown_ellipsoid_is_free(seed, inflation):
    rng = np.random.default_rng(seed)
    g = float(rng.choice([0.02, 0.05, 0.3]))
    shape = SHAPES[rng.choice(list(SHAPES))](rng)
    mean, scale, quat = rows(rng.uniform(-5, 5, 3), shape, unit(rng))
    index, *_ = _core.voxelize(mean, scale, quat, 1.3, g, inflation)
    directions = rng.normal(size=(2, 500, 3))
    u, ball = directions / np.linalg.norm(directions, axis=2, keepdims=True)
    r = np.array(rotation(quat[0].astype(float)))
    points = mean[0] + 1.3 * (u * scale[0]) @ r.T
    # The farthest points of the Minkowski sum: the ball's point along the ellipsoid's normal, and any.
    normal = (u / scale[0]) @ r.T
    outermost = points + inflation * normal / np.linalg.norm(normal, axis=1, keepdims=True)
    touched = np.concatenate([points, outermost, points + inflation * ball])
    marked = set(map(tuple, index.tolist()))
    assert {tuple(c) for c in np.floor(touched / g).astype(int).tolist()} <= marked


@pytest.mark.every(4)
@pytest.mark.parametrize(
    "semi", [(0.2, 0.05, 0.01), (0.3, 0.3, 0.002), (0.4, 0.01, 0.01), (0.02, 0.03, 0.04)]
)
def test_inflation_marks_what_lies_in_all_outer_bounds_and_no_more(semi):
    rng = np.random.default_rng(3)
    mean, scale, quat = rows(rng.uniform(-0.2, 0.2, 3), semi, rng.normal(size=4))
    k, r, g = 2.0, 0.06, 0.05
    square = (k * scale[0].astype(float)) ** 2
    trace = np.sqrt(square.sum() / (3 * r * r))
    reach = np.sqrt((np.array(rotation(quat[0].astype(float))) ** 2) @ square) + r
    wanted = True
    for p in (trace, 0.5) if trace > 1 else (trace,):  # two ellipsoids, and the box of the Minkowski sum
        outer = np.sqrt((1 + 1 / p) * square + (1 + p) * r * r)
        cell, touched = touched_table(mean[0], outer, quat[0], 1.0, g, np.full(3, -24), np.full(3, 24))
        wanted = wanted & touched
    wanted &= (cell * g <= mean[0] + reach).all(axis=1) & ((cell + 1) * g >= mean[0] - reach).all(axis=1)
    index, *_ = _core.voxelize(mean, scale, quat, k, g, r)
    np.testing.assert_array_equal(index, cell[wanted])


def random_rows(seed, n=3000):
    rng = np.random.default_rng(seed)
    scale = np.exp(rng.uniform(np.log(1e-4), np.log(0.3), (n, 3)))
    return rows(rng.uniform(-2, 2, (n, 3)), scale, rng.normal(size=(n, 4)))


@pytest.mark.parametrize("crop", [(-0.5, -1.0, 0.1, 0.7, 0.2, 0.3), (-0.1, -0.1, -0.1, 0.1, 0.1, 0.1)])
def test_a_crop_keeps_the_voxels_that_touch_the_box(crop):
    splats, g = random_rows(1), 0.1
    index, overlap, *_ = _core.voxelize(*splats, 1.0, g)
    exact = [Fraction(g) * int(v) for v in range(-40, 41)]
    keep = np.ones(len(index), bool)
    for a in range(3):
        low = next(i for i in range(-40, 40) if exact[i + 41] >= Fraction(crop[a]))
        high = max(i for i in range(-40, 40) if exact[i + 40] <= Fraction(crop[a + 3]))
        keep &= (index[:, a] >= low) & (index[:, a] <= high)
    cropped, counts, reach, *_ = _core.voxelize(*splats, 1.0, g, 0.0, crop)
    np.testing.assert_array_equal(cropped, index[keep])
    np.testing.assert_array_equal(counts, overlap[keep])
    assert set(reach) == {0, 1, 2}


def test_results_do_not_depend_on_jobs():
    splats = random_rows(2)
    one = _core.voxelize(*splats, 1.0, 0.03, jobs=1)
    many = _core.voxelize(*splats, 1.0, 0.03, jobs=7)
    for a, b in zip(one, many, strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(np.lexsort(one[0].T[::-1]), np.arange(len(one[0])))
    assert len(np.unique(one[0], axis=0)) == len(one[0])


def test_a_huge_splat_costs_nothing_outside_the_crop():
    huge = rows(
        [[0, 0, 0], [500, 0, 0]], [[100, 120, 80], [100, 100, 1e-9]], [[1, 0.2, 0.1, 0], [1, 0, 0, 0]]
    )
    index, overlap, reach, *_ = _core.voxelize(*huge, 1.0, 0.05, 0.0, (-0.2, -0.2, -0.2, 0.21, 0.2, 0.2))
    assert len(index) == 10 * 10 * 10  # g is above 1/20, so -0.2 / g is inside voxel -4, not on its face
    assert (overlap == 1).all()
    assert reach.tolist() == [2, 0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mean", "scale", "message"),
    [
        ([0, 0, 0], [100, 120, 80], "would need at least 32169908"),
        ([0, 0, 0], [3000, 3000, 1e-9], "would need at least 11309733552 voxels"),
        ([1e12, 0, 0], [1, 1, 1], "32 bits"),
    ],
)
def test_what_does_not_fit_is_refused(mean, scale, message):
    with pytest.raises(InputError, match=message) as caught:
        voxelize(VoxelizeConfig(max_voxels=2**27), scene_of(mean, scale, [1, 0, 0, 0]))
    assert "use --crop or a larger --size" in str(caught.value)


@pytest.mark.parametrize(
    ("column", "value"), [(0, np.nan), (0, np.inf), (1, 0.0), (1, -1.0), (1, np.inf), (2, 0.0), (2, np.nan)]
)
def test_malformed_rows_are_refused(column, value):
    splats = [np.repeat(a, 3, axis=0) for a in rows([0, 0, 0], [1, 1, 1], [1, 0, 0, 0])]
    splats[column][1] = value
    with pytest.raises(ValueError, match="row 1 is not an ellipsoid"):
        _core.voxelize(*splats, 1.0, 0.5)
    with pytest.raises(ValueError, match="row 1 is not an ellipsoid"):
        _core.unproven_voxels(*splats, 1.0, 0.5, 0.0, None, 1, np.zeros((0, 3), np.int32))


def test_rows_of_unequal_number_are_refused():
    mean, scale, quat = rows([0, 0, 0], [1, 1, 1], [1, 0, 0, 0])
    with pytest.raises(ValueError, match="same number of rows"):
        _core.voxelize(np.repeat(mean, 2, axis=0), scale, quat, 1.0, 0.5)


@pytest.mark.parametrize("confidence", [0.1, 0.5, 0.9, 0.99])
def test_confidence_is_the_chi_square_quantile(confidence):
    assert sigma_of_confidence(confidence) == pytest.approx(np.sqrt(chi2.ppf(confidence, 3)), rel=1e-12)


def test_the_artifact_says_what_was_done_and_left_out():
    mean, scale, quat = random_rows(4, 400)
    scene = scene_of(mean, scale, quat, suggested_inflation_m=0.01, source={"removed": {"min-opacity": 12}})
    config = VoxelizeConfig(size_m=0.1, confidence=0.9, min_overlap=2, crop=(-1, -1, -1, 1, 1, 1))
    voxels = voxelize(config, scene)
    sigma = sigma_of_confidence(0.9)
    index, overlap, reach, *_ = _core.voxelize(mean, scale, quat, sigma, 0.1, 0.01, config.crop)
    np.testing.assert_array_equal(voxels["index"], index[overlap >= 2])
    np.testing.assert_array_equal(voxels["overlap"], overlap[overlap >= 2])
    manifest = voxels.manifest
    assert (manifest.frame, manifest.unit) == ("world", "m")
    assert (manifest.sigma, manifest.inflation_m, manifest.crop) == (sigma, 0.01, [-1, -1, -1, 1, 1, 1])
    assert manifest.guarantee.claims == {
        "sigma": sigma,
        "mass_fraction": pytest.approx(0.9, rel=1e-12),
        "inflation_m": 0.01,
        "voxel_size_m": 0.1,
        "min_overlap": 2,
        "crop": [-1, -1, -1, 1, 1, 1],
        "left_out": {
            "removed_from_splat": {"min-opacity": 12},
            "voxels_below_min_overlap": int((overlap < 2).sum()),
            "gaussians_below_opacity": 0,
            "gaussians_outside_crop": (reach == 0).sum(),
            "gaussians_cut_by_crop": (reach == 2).sum(),
        },
        "min_opacity": 0.0,
        "ignore_loss": False,
        "splat_loss": {},
    }
    assert manifest.summary["volume_m3"] == pytest.approx(len(voxels["index"]) * 1e-3)
    assert manifest.summary["lower_m"] == pytest.approx(voxels["index"].min(axis=0) * 0.1)
    assert manifest.summary["upper_m"] == pytest.approx((voxels["index"].max(axis=0) + 1) * 0.1)


def test_scenes_that_cannot_be_voxelized_are_refused():
    one = ([0, 0, 0], [0.1, 0.1, 0.1], [1, 0, 0, 0])
    with pytest.raises(InputError, match="run scale-align first"):
        voxelize(VoxelizeConfig(), scene_of(*one, frame="scene", unit="arbitrary"))
    with pytest.raises(InputError, match="no Gaussians"):
        voxelize(VoxelizeConfig(), scene_of(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 4))))
    with pytest.raises(InfeasibleError, match="touches the crop"):
        voxelize(VoxelizeConfig(crop=(5, 5, 5, 6, 6, 6)), scene_of(*one))
    with pytest.raises(InfeasibleError, match="touched by 2 Gaussians; the maximum is 1"):
        voxelize(VoxelizeConfig(min_overlap=2), scene_of(*one))


def test_progress_ends_complete_and_an_interrupt_stops():
    calls = []
    _core.voxelize(*random_rows(5), 1.0, 0.1, progress=lambda *call: calls.append(call))
    assert calls[-1] == (1000, 1000)
    assert calls == sorted(calls)

    def interrupt(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        _core.voxelize(*random_rows(5), 1.0, 0.1, progress=interrupt)


def test_a_real_street_is_voxelized_and_proven(data):
    tile = sorted((data / "istanbul-outdoor").glob("*.splat"))[0]
    record = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])
    splats = np.fromfile(tile, record)
    scene = scene_of(splats["mean"], splats["scale"], splats["quat"] / 255.0 * 2 - 1)
    config = VoxelizeConfig(size_m=0.2, min_overlap=3)
    voxels = voxelize(config, scene)
    options = {"voxel_size_m": 0.2, "sigma": 1.0, "min_overlap": 3}
    assert unproven_voxels(scene, voxels["index"], **options).total == 0
    fewer = np.delete(voxels["index"], [10, 5000], axis=0)
    found = unproven_voxels(scene, fewer, **options)
    np.testing.assert_array_equal(found.voxel, voxels["index"][[10, 5000]])


@pytest.mark.parametrize(("k", "scale", "r"), [(1e308, 1e30, 0.0), (1e300, 1e20, 0.0), (1.0, 1.0, 1e200)])
@pytest.mark.parametrize("crop", [None, (-1.0, -1.0, -1.0, 1.0, 1.0, 1.0)])
def test_an_ellipsoid_without_finite_bounds_is_refused_not_skipped(k, scale, r, crop):
    splats = rows([0, 0, 0], [scale] * 3, [1, 0, 0, 0])
    with pytest.raises(OverflowError):
        _core.voxelize(*splats, k, 0.1, r, crop)
    if r == 0:
        with pytest.raises(OverflowError):
            _core.unproven_voxels(*splats, k, 0.1, r, crop, 1, np.empty((0, 3), np.int32))


def test_an_inflation_near_zero_changes_nothing():
    """The ratio of semi-axis and inflation overflows."""
    splats = rows([[0, 0, 0], [0.01, 0, 0]], [[0.3, 0.2, 0.1], [1e-30, 1e-30, 1e-30]], [[1, 0, 0, 0]] * 2)
    index, overlap, reach, *_ = _core.voxelize(*splats, 1.0, 0.1)
    assert (reach == 1).all()
    for r in (5e-324, 1e-320, 1e-300, 1e-160):
        found = _core.voxelize(*splats, 1.0, 0.1, r)
        np.testing.assert_array_equal(found[0], index)
        np.testing.assert_array_equal(found[1], overlap)


def test_the_guarantee_says_what_was_lost_before():
    scene = scene_of(
        [0, 0, 0],
        [0.1, 0.1, 0.1],
        [1, 0, 0, 0],
        source={"removed": {"floaters": 3}, "loss": {"rotation_rad": 0.0314}},
        suggested_inflation_m=0.04,
    )
    statement = voxelize(VoxelizeConfig(inflation_m=0.01), scene).manifest.guarantee.statement
    assert "3 Gaussians removed by floaters" in statement
    assert "rotation_rad 0.0314" in statement
    assert "beyond 0.01 m, where it suggests 0.04 m" in statement
    assert (
        "Not included"
        not in voxelize(
            VoxelizeConfig(), scene_of([0, 0, 0], [0.1] * 3, [1, 0, 0, 0])
        ).manifest.guarantee.statement
    )
