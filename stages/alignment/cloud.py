"""Registration of a scene to a surveyed cloud in metres, with scale."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.manifest import Similarity
from alula.schemas.errors import CheckError, InputError
from alula.stages.alignment.evidence import Correspondences
from alula.stages.alignment.sampling import blocks, jackknife, thinned_to
from alula.stages.alignment.similarity import compose, is_collinear, transform_points, umeyama
from alula.stages.alignment.uncertainty import Uncertainty

_MAX_POINTS = 60_000  # of either side after thinning
_LEVELS = (8.0, 4.0, 2.0)  # maximum pair distances of the coarse stages, in thresholds
_NEIGHBOURS = 16  # of a point, which determine its plane
_STEPS = 40
_WIDE_STEPS = 6  # the first ones, with twice the maximum pair distance
_CONVERGED_STEP = 1e-2  # of the mean residual: a step that moves all points by less ends the iteration
_COARSE_MAX_POINTS = 10_000
_ROUNDS = 40  # of a coarse stage
_CONVERGED_ROUND = 2e-3  # of its pair distance: a round that moves all points by less ends the stage
_MIN_PAIRS = 50
_MIN_BLOCKS = 10
_BLOCKS = (40, 16)  # errors may be correlated over short or long distances: the larger covariance counts
_MIN_EIGENVALUE = 3e-3  # of the normalised information; below it the scene can slide along the surfaces
_MAX_RMS = 0.25  # of the threshold; unrelated surfaces leave 0.28 to 0.3
_TUKEY = 4.685
_MAX_ROUGHNESS = 2.0  # times the median of thickness over width of neighbourhoods


@dataclass(frozen=True, slots=True)
class Cloud:
    """A surveyed cloud, with a first guess of the scene's position in it.

    Attributes:
        points: shape (n, 3) [m].
        initial: world from scene, approximately, or correspondences that determine it; None: the identity.
    """

    name: str
    points: FloatArray
    initial: Similarity | Correspondences | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class CloudFit:
    """A fitted similarity onto a cloud, its residuals and its uncertainty.

    Attributes:
        similarity: cloud = scale R scene + t.
        residual: distances of pairs along the normal, shape (m,) [m].
        block: block of each pair, shape (m,).
        block_centre: mean of the paired points of each block, shape (B, 3) [m].
        block_edge: edge of the blocks [m].
        scene_fraction: fraction of the scene's thinned points with one of the cloud within the threshold.
        cloud_fraction: fraction of the cloud's thinned points with one of the scene within the threshold.
        thinning_m: edge of the cubes in which points were averaged.
        leave_one_out: smallest and largest scale with any one block left out.
        singular_values: of the paired points, centred [m].
    """

    similarity: Similarity
    uncertainty: Uncertainty
    count: int
    residual: FloatArray
    block: NDArray[np.intp]
    block_centre: FloatArray
    block_edge: float
    scene_fraction: float
    cloud_fraction: float
    thinning_m: float
    leave_one_out: tuple[float, float]
    singular_values: FloatArray


def fit_cloud(
    points: FloatArray, cloud: FloatArray, initial: Similarity, threshold: float, min_fitness: float
) -> CloudFit:
    """Register points to a cloud, starting from an approximate similarity.

    Both sides are averaged in cubes of half the threshold. First, point-to-point ICP with scale runs on the
    overlap, which is selected anew for maximum distances of 8, 4 and 2 thresholds. Then Gauss-Newton
    minimises the distances to the cloud's local planes over mutual nearest neighbours, weighted by Tukey's
    biweight: n' (c + d (1 + lambda) + omega x d + tau - q), d = mapped - c. Unlike point-to-point ICP, this
    has no bias of the scale from the sampling along the surface or from the border of the overlap.

    The covariance comes from blocks of space (`jackknife`), not from the number of pairs: it is the larger
    of those from small and from large blocks. It does not include an offset that all surfaces share, such
    as that of Gaussian centres that lie behind their surface.

    Args:
        points: means of the scene, shape (n, 3), scene units.
        cloud: surveyed points, shape (m, 3) [m].
        initial: world from scene, approximately.
        threshold: maximum distance of a pair [m].
        min_fitness: minimum overlapping fraction, of the side that overlaps more.

    Returns:
        The fit, with world from scene.

    Raises:
        CheckError: too little overlaps, or the residuals are as large as those of unrelated surfaces.
        InputError: the overlap does not determine a similarity.
    """
    from scipy.spatial import cKDTree

    if not (len(points) and len(cloud)):
        raise InputError("nothing to register: no Gaussian of the scene has an opacity of 0.1 or more")
    mapped, edge = thinned_to(transform_points(initial, points), threshold / 2, _MAX_POINTS)
    target, cloud_edge = thinned_to(cloud, threshold / 2, _MAX_POINTS)
    if min(len(mapped), len(target)) <= _NEIGHBOURS:
        raise InputError(
            f"only {min(len(mapped), len(target))} points to register, {threshold / 2:g} m apart"
        )
    tree = cKDTree(target)
    near, _ = tree.query(mapped, distance_upper_bound=_LEVELS[0] * threshold)
    widest = _LEVELS[0] * threshold
    _require_overlap(
        float(np.isfinite(near).mean()), _overlap_of_cloud(mapped, target, widest), widest, min_fitness
    )
    moved = _coarse(mapped, target, tree, threshold)
    normals, flat = _planes(target, tree)
    scene_flat = _planes(mapped, cKDTree(mapped))[1]

    def pairs_of(now: FloatArray, distance: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        first, second = _pairs(now, target, tree, distance)
        keep = scene_flat[first] & flat[second]
        return first[keep], second[keep]

    for step_number in range(_STEPS):
        distance = threshold * (2.0 if step_number < _WIDE_STEPS else 1.0)
        pairs = pairs_of(transform_points(moved, mapped), distance)
        at, jacobian, residual = _linear(transform_points(moved, mapped), target, normals, pairs)
        weight, _ = _weights(residual)
        information = (jacobian * weight[:, None]).T @ jacobian
        lever = float(np.sqrt(((transform_points(moved, mapped)[pairs[0]] - at) ** 2).sum(axis=1).mean()))
        _require_determined(information, float(weight.sum()), lever)
        gradient: FloatArray = (jacobian * weight[:, None]).T @ residual
        step = -np.asarray(np.linalg.solve(information, gradient), np.float64)
        moved = compose(_similarity_of_step(step, at), moved)
        if step_number >= _WIDE_STEPS and np.abs(jacobian @ step).max() < _CONVERGED_STEP * (
            np.abs(residual).mean() + 1e-9
        ):
            break
    final = transform_points(moved, mapped)
    scene_fraction = float(np.isfinite(tree.query(final, distance_upper_bound=threshold)[0]).mean())
    cloud_fraction = _overlap_of_cloud(final, target, threshold)
    _require_overlap(scene_fraction, cloud_fraction, threshold, min_fitness)

    pairs = pairs_of(final, threshold)
    at, jacobian, residual = _linear(final, target, normals, pairs)
    where = final[pairs[0]]
    rms = float(np.sqrt((residual**2).mean()))
    if rms > _MAX_RMS * threshold:
        raise CheckError(
            f"alignment: the RMS residual is {rms:.3g} m, above {_MAX_RMS:g} of --threshold {threshold:g} m, "
            "as for surfaces that are not the same; a better --initial or a larger --threshold is needed"
        )
    by_blocks = max(
        (_block_covariance(where, jacobian, residual, 4 * threshold, wanted) for wanted in _BLOCKS),
        key=lambda found: found.size,
    )
    similarity = compose(moved, initial)
    label = by_blocks.label
    return CloudFit(
        similarity=similarity,
        uncertainty=Uncertainty(at, by_blocks.covariance, max(1.0, by_blocks.count - 7.0)),
        count=len(mapped),
        residual=np.abs(residual),
        block=label,
        block_centre=np.array(
            [np.bincount(label, where[:, axis]) / np.bincount(label) for axis in range(3)]
        ).T,
        block_edge=by_blocks.edge,
        scene_fraction=scene_fraction,
        cloud_fraction=cloud_fraction,
        thinning_m=max(edge, cloud_edge),
        leave_one_out=(
            similarity.scale * float(1 + by_blocks.moves[:, 3].min()),
            similarity.scale * float(1 + by_blocks.moves[:, 3].max()),
        ),
        singular_values=np.linalg.svd(where - where.mean(axis=0), compute_uv=False),
    )


@dataclass(frozen=True, slots=True)
class _BlockCovariance:
    """A covariance from blocks: their labels, number and edge, and the move of the solution without each.

    `size` is the mean squared position error that the covariance means for the points.
    """

    label: NDArray[np.intp]
    count: int
    edge: float
    moves: FloatArray
    covariance: FloatArray
    size: float


def _block_covariance(
    where: FloatArray, jacobian: FloatArray, residual: FloatArray, min_edge: float, min_blocks: int
) -> _BlockCovariance:
    label, count, edge = blocks(where, min_edge, min_blocks)
    if count < _MIN_BLOCKS:
        raise InputError(
            f"the overlap is too small to estimate the error of the fit ({count} blocks of {edge:g} m)"
        )
    weight, width = _weights(residual)
    score = np.zeros((count, 7))
    np.add.at(score, label, jacobian * (weight * residual)[:, None])
    curvature = (weight * _relative_slope(residual, width))[:, None, None]
    information = np.zeros((count, 7, 7))
    np.add.at(information, label, curvature * jacobian[:, :, None] * jacobian[:, None, :])
    moves = np.linalg.solve(information.sum(axis=0) - information, score[:, :, None])[:, :, 0]
    covariance = jackknife(information, score)
    lever = float(((where - where.mean(axis=0)) ** 2).sum(axis=1).mean())
    size = float(np.trace(covariance[:3, :3]) + lever * np.trace(covariance[3:, 3:]))
    return _BlockCovariance(label, count, edge, moves, covariance, size)


def _require_overlap(
    scene_fraction: float, cloud_fraction: float, distance: float, min_fitness: float
) -> None:
    if max(scene_fraction, cloud_fraction) < min_fitness:
        raise CheckError(
            f"alignment: {scene_fraction:.1%} of the scene and {cloud_fraction:.1%} of the cloud are within "
            f"{distance:g} m of each other, below --min-fitness {min_fitness:g}; a better --initial is needed"
        )


def _overlap_of_cloud(mapped: FloatArray, target: FloatArray, distance: float) -> float:
    """Fraction of the cloud's points with a point of the scene within a distance."""
    from scipy.spatial import cKDTree

    found, _ = cKDTree(mapped).query(target, distance_upper_bound=distance)
    return float(np.isfinite(found).mean())


def _coarse(mapped: FloatArray, target: FloatArray, tree: Any, threshold: float) -> Similarity:
    """Coarse similarity: point-to-point ICP with scale, at each stage on the overlap at its distance.

    Open3D's ICP is not used: it sums in the order in which threads finish, so its bits differ between runs.
    """
    from scipy.spatial import cKDTree

    moved = Similarity(scale=1.0, rotation=np.eye(3).tolist(), translation_m=[0.0, 0.0, 0.0])
    misfit = _misfit(mapped, target, tree, threshold)
    for level in _LEVELS:
        distance = level * threshold
        fixed, edge = thinned_to(target, distance / 2, _COARSE_MAX_POINTS)
        there = cKDTree(fixed)
        found = icp(thinned_to(mapped, edge, _COARSE_MAX_POINTS)[0], fixed, there, moved, distance)
        # Shrinking onto a part of the cloud reduces the distances of one side only.
        after = _misfit(transform_points(found, mapped), target, tree, threshold)
        if after < misfit:
            moved, misfit = found, after
    return moved


def icp(points: FloatArray, fixed: FloatArray, tree: Any, start: Similarity, distance: float) -> Similarity:
    """Iterative closest point with scale: nearest neighbours and least squares in turn.

    Source: Besl and McKay 1992, with the scale of Umeyama 1991.

    Args:
        points: shape (n, 3), any units.
        fixed: points of the other side, shape (m, 3) [target units].
        start: target from points, approximately.
        distance: maximum distance of a pair [target units].

    Returns:
        Target from points; `start` where fewer than 50 pairs remain, they are collinear, or the scale
        changes by a factor of 5 or more.
    """
    found = start
    now = transform_points(found, points)
    for _ in range(_ROUNDS):
        near, index = tree.query(now, distance_upper_bound=distance)
        inside = np.isfinite(near)
        if inside.sum() < _MIN_PAIRS or is_collinear(points[inside]):
            return start
        found = umeyama(points[inside], fixed[index[inside]])
        if not (0.2 < found.scale / start.scale < 5.0):
            return start
        before, now = now, transform_points(found, points)
        if np.abs(now - before).max() < _CONVERGED_ROUND * distance:
            break
    return found


def _misfit(moved: FloatArray, target: FloatArray, tree: Any, distance: float) -> float:
    """Sum over both sides of the mean squared distance to the other side, truncated at a distance."""
    from scipy.spatial import cKDTree

    there, back = tree.query(moved)[0], cKDTree(moved).query(target)[0]
    return float(sum((np.minimum(d, distance) ** 2).mean() for d in (there, back)))


def _planes(points: FloatArray, tree: Any) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Unit normals of the planes through the nearest neighbours of each point, and a mask of the flat ones.

    Averaging rounds off edges, by an amount that depends on the sampling of each side, and planes there
    belong to neither face. So only points with neighbourhoods about as flat as most count as flat.
    """
    _, index = tree.query(points, k=_NEIGHBOURS)
    near = points[index] - points[index].mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(near.swapaxes(1, 2) @ near)
    ratio = values[:, 0] / np.maximum(values[:, 1], 1e-300)
    normals: FloatArray = vectors[:, :, 0]
    return normals, ratio <= _MAX_ROUGHNESS * float(np.median(ratio))


def _pairs(
    moved: FloatArray, target: FloatArray, tree: Any, threshold: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of mutual nearest neighbours within the threshold."""
    from scipy.spatial import cKDTree

    distance, index = tree.query(moved, distance_upper_bound=threshold)
    chosen = np.flatnonzero(np.isfinite(distance))
    if len(chosen) < _MIN_PAIRS:
        raise CheckError(
            f"alignment: only {len(chosen)} points of the scene are within {threshold:g} m of the cloud; "
            "a better --initial or a larger --threshold is needed"
        )
    _, back = cKDTree(moved[chosen]).query(target[index[chosen]])
    mutual = back == np.arange(len(chosen))
    return chosen[mutual], index[chosen[mutual]]


def _linear(
    moved: FloatArray,
    target: FloatArray,
    normals: FloatArray,
    pairs: tuple[NDArray[np.intp], NDArray[np.intp]],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Centre of the pairs, derivatives by (tau, lambda, omega) about it, and distances to the planes."""
    p, q, n = moved[pairs[0]], target[pairs[1]], normals[pairs[1]]
    centre = p.mean(axis=0)
    d = p - centre
    jacobian = np.concatenate([n, (n * d).sum(axis=1, keepdims=True), np.cross(d, n)], axis=1)
    return centre, jacobian, (n * (p - q)).sum(axis=1)


def _weights(residual: FloatArray) -> tuple[FloatArray, float]:
    """Weights of Tukey's biweight, and its width: 4.685 times the robust standard deviation."""
    size = max(_TUKEY * 1.4826 * float(np.median(np.abs(residual))), 1e-12)
    weight: FloatArray = np.clip(1 - (residual / size) ** 2, 0, None) ** 2
    return weight, size


def _relative_slope(residual: FloatArray, size: float) -> FloatArray:
    """Derivative of weight times residual, divided by the weight."""
    u = np.clip((residual / size) ** 2, 0, 1 - 1e-9)
    slope: FloatArray = 1 - 4 * u / (1 - u)
    return slope


def _require_determined(information: FloatArray, total: float, lever: float) -> None:
    """Refuse surfaces along which the scene could slide, turn or grow unnoticed.

    The information per unit of weight has angles and growth in units of the points' mean distance. An
    eigenvalue of it is the fraction of the information that constrains one direction: about 1/3 for each in
    a furnished room.
    """
    units = np.array([1, 1, 1, *[1 / lever] * 4])
    scaled = information * units[:, None] * units / total
    smallest = float(np.linalg.eigvalsh(scaled)[0])
    if not smallest >= _MIN_EIGENVALUE:
        raise InputError(
            f"the overlap does not determine the similarity (smallest eigenvalue {smallest:.2g}): on a "
            "plane, a sphere or a pipe the scene can slide, turn or grow; use a cloud with walls in more "
            "directions"
        )


def _similarity_of_step(step: FloatArray, centre: FloatArray) -> Similarity:
    """Similarity of a small step (tau, lambda, omega) about a centre."""
    x, y, z = step[4:]
    angle = float(np.linalg.norm(step[4:]))
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    half = np.sinc(angle / (2 * np.pi))
    rotation = np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * half * half * cross @ cross
    scale = float(np.exp(np.clip(step[3], -0.5, 0.5)))
    shift = centre + step[:3] - scale * rotation @ centre
    return Similarity(scale=scale, rotation=rotation.tolist(), translation_m=shift.tolist())
