"""Registration of a scene to a surveyed cloud in metres, with scale."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import CheckError, InputError
from alula.schemas.manifest import Similarity
from alula.stages.alignment.evidence import Correspondences
from alula.stages.alignment.sampling import blocks, jackknife, thinned_to
from alula.stages.alignment.similarity import compose, is_collinear, transform_points, umeyama
from alula.stages.alignment.uncertainty import Uncertainty

_MOST = 60_000  # points of either side after thinning
_LEVELS = (8.0, 4.0, 2.0)  # largest distances of the coarse stages, in thresholds
_NEIGHBOURS = 16  # of a point whose plane is fitted
_STEPS = 40
_WIDE_STEPS = 6  # the first ones, with twice the distance
_STILL = 1e-2  # of the mean residual: a step that moves all points by less says nothing
_COARSE_MOST = 10_000
_ROUNDS = 40  # of a coarse stage
_SETTLED = 2e-3  # of its distance: a round that moves points by less ends it
_LEAST_PAIRS = 50
_LEAST_BLOCKS = 10
_BLOCKS = (40, 16)  # errors may be alike over short or long stretches: the larger covariance counts
_WEAK = 3e-3  # least eigenvalue of the normalised information: the surfaces let it slide
_LOOSE = 0.25  # of the threshold; surfaces that have nothing to do with each other leave 0.28 to 0.3
_TUKEY = 4.685
_FLAT = 2.0  # times the median of thickness over width of neighbourhoods


@dataclass(frozen=True, slots=True)
class Cloud:
    """Surveyed points, shape (n, 3) [m], and where in the world the scene is to begin with."""

    name: str
    points: FloatArray
    initial: Similarity | Correspondences | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class CloudFit:
    """A similarity onto a cloud.

    Attributes:
        similarity: cloud = scale R scene + t.
        uncertainty: from blocks of space.
        count: thinned points of the scene.
        residual: distances of pairs along the normal, shape (m,) [m].
        block: of each pair; `block_centre`, shape (B, 3), and the edge of blocks [m].
        scene_share, cloud_share: of thinned points that have one of the other within the threshold.
        thinning_m: edge of the cubes in which points were averaged.
        leave_one_out: range of the scale without any one block.
        singular_values: of the paired points, centred [m].
    """

    similarity: Similarity
    uncertainty: Uncertainty
    count: int
    residual: FloatArray
    block: NDArray[np.intp]
    block_centre: FloatArray
    block_edge: float
    scene_share: float
    cloud_share: float
    thinning_m: float
    leave_one_out: tuple[float, float]
    singular_values: FloatArray


def fit_cloud(
    points: FloatArray, cloud: FloatArray, initial: Similarity, threshold: float, least: float
) -> CloudFit:
    """Register points to a cloud, from a similarity that is nearly right.

    Both are averaged in cubes of half the threshold. Point-to-point ICP with scale runs on the overlap,
    cropped anew for largest distances of 8, 4 and 2 thresholds. Then Gauss-Newton minimises distances to the
    cloud's local planes over pairs that are nearest to each other, weighted by Tukey's biweight:
    n' (c + d (1 + lambda) + omega x d + tau - q), d = mapped - c. Sampling along the surface and the
    border of the overlap then pull at nothing, unlike in point-to-point ICP, whose scale they bias.

    The covariance comes from blocks of space (`jackknife`), small and large ones, the larger of the two,
    and not from the number of pairs. It knows
    nothing of an offset that all surfaces share, such as centres that lie behind them.

    Args:
        points: means of the scene, shape (n, 3), scene units.
        cloud: shape (m, 3) [m].
        initial: world from scene, to begin with.
        threshold: largest distance of a pair [m].
        least: smallest admissible share of overlap, the larger one of both sides.

    Raises:
        CheckError: too little overlaps, or what does fits no better than surfaces that are not the same.
        InputError: the overlap does not determine a similarity.
    """
    from scipy.spatial import cKDTree

    if not (len(points) and len(cloud)):
        raise InputError("nothing to register: no Gaussian of the scene has an opacity of 0.1 or more")
    mapped, edge = thinned_to(transform_points(initial, points), threshold / 2, _MOST)
    target, cloud_edge = thinned_to(cloud, threshold / 2, _MOST)
    if min(len(mapped), len(target)) <= _NEIGHBOURS:
        raise InputError(
            f"only {min(len(mapped), len(target))} points to register, {threshold / 2:g} m apart"
        )
    tree = cKDTree(target)
    near, _ = tree.query(mapped, distance_upper_bound=_LEVELS[0] * threshold)
    _require(float(np.isfinite(near).mean()), _cloud_share(mapped, target, _LEVELS[0] * threshold),
             _LEVELS[0] * threshold, least)  # fmt: skip
    moved = _coarse(mapped, target, tree, threshold)
    normals, flat = _planes(target, tree)
    even = _planes(mapped, cKDTree(mapped))[1]

    def pairs_of(now: FloatArray, distance: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        first, second = _pairs(now, target, tree, distance)
        keep = even[first] & flat[second]
        return first[keep], second[keep]

    for step_number in range(_STEPS):
        distance = threshold * (2.0 if step_number < _WIDE_STEPS else 1.0)
        pairs = pairs_of(transform_points(moved, mapped), distance)
        at, jacobian, residual = _linear(transform_points(moved, mapped), target, normals, pairs)
        weight, _ = _weights(residual)
        information = (jacobian * weight[:, None]).T @ jacobian
        lever = float(np.sqrt(((transform_points(moved, mapped)[pairs[0]] - at) ** 2).sum(axis=1).mean()))
        _determined(information, float(weight.sum()), lever)
        gradient: FloatArray = (jacobian * weight[:, None]).T @ residual
        step = -np.asarray(np.linalg.solve(information, gradient), np.float64)
        moved = compose(_small(step, at), moved)
        if step_number >= _WIDE_STEPS and np.abs(jacobian @ step).max() < _STILL * (
            np.abs(residual).mean() + 1e-9
        ):
            break
    final = transform_points(moved, mapped)
    scene_share = float(np.isfinite(tree.query(final, distance_upper_bound=threshold)[0]).mean())
    cloud_share = _cloud_share(final, target, threshold)
    _require(scene_share, cloud_share, threshold, least)

    pairs = pairs_of(final, threshold)
    at, jacobian, residual = _linear(final, target, normals, pairs)
    where = final[pairs[0]]
    rms = float(np.sqrt((residual**2).mean()))
    if rms > _LOOSE * threshold:
        raise CheckError(
            f"alignment: the RMS residual is {rms:.3g} m, as of surfaces that are not the same, above "
            f"{_LOOSE:g} of --threshold {threshold:g} m; a better --initial or a larger --threshold is needed"
        )
    known = max(
        (_by_blocks(where, jacobian, residual, 4 * threshold, wanted) for wanted in _BLOCKS),
        key=lambda found: found.size,
    )
    similarity = compose(moved, initial)
    label = known.label
    return CloudFit(
        similarity=similarity,
        uncertainty=Uncertainty(at, known.covariance, max(1.0, known.count - 7.0)),
        count=len(mapped),
        residual=np.abs(residual),
        block=label,
        block_centre=np.array(
            [np.bincount(label, where[:, axis]) / np.bincount(label) for axis in range(3)]
        ).T,
        block_edge=known.edge,
        scene_share=scene_share,
        cloud_share=cloud_share,
        thinning_m=max(edge, cloud_edge),
        leave_one_out=(
            similarity.scale * float(1 + known.moves[:, 3].min()),
            similarity.scale * float(1 + known.moves[:, 3].max()),
        ),
        singular_values=np.linalg.svd(where - where.mean(axis=0), compute_uv=False),
    )


@dataclass(frozen=True, slots=True)
class _Known:
    """A covariance from blocks: their labels, number and edge, how far each moves the solution."""

    label: NDArray[np.intp]
    count: int
    edge: float
    moves: FloatArray
    covariance: FloatArray
    size: float


def _by_blocks(
    where: FloatArray, jacobian: FloatArray, residual: FloatArray, least: float, wanted: int
) -> _Known:
    label, count, edge = blocks(where, least, wanted)
    if count < _LEAST_BLOCKS:
        raise InputError(f"the overlap is too small to say how well it fits ({count} blocks of {edge:g} m)")
    weight, width = _weights(residual)
    score = np.zeros((count, 7))
    np.add.at(score, label, jacobian * (weight * residual)[:, None])
    bent = (weight * _bend(residual, width))[:, None, None]
    information = np.zeros((count, 7, 7))
    np.add.at(information, label, bent * jacobian[:, :, None] * jacobian[:, None, :])
    moves = np.linalg.solve(information.sum(axis=0) - information, score[:, :, None])[:, :, 0]
    covariance = jackknife(information, score)
    lever = float(((where - where.mean(axis=0)) ** 2).sum(axis=1).mean())
    size = float(np.trace(covariance[:3, :3]) + lever * np.trace(covariance[3:, 3:]))
    return _Known(label, count, edge, moves, covariance, size)


def _require(scene_share: float, cloud_share: float, distance: float, least: float) -> None:
    share = max(scene_share, cloud_share)
    if share < least:
        raise CheckError(
            f"alignment: {scene_share:.1%} of the scene and {cloud_share:.1%} of the cloud are within "
            f"{distance:g} m of each other, below --min-fitness {least:g}; a better --initial is needed"
        )


def _cloud_share(mapped: FloatArray, target: FloatArray, distance: float) -> float:
    from scipy.spatial import cKDTree

    found, _ = cKDTree(mapped).query(target, distance_upper_bound=distance)
    return float(np.isfinite(found).mean())


def _coarse(mapped: FloatArray, target: FloatArray, tree: Any, threshold: float) -> Similarity:
    """Point-to-point ICP with scale, at each stage on what overlaps at its distance.

    Our own, because Open3D's adds up in the order in which threads finish: not the same bits each time.
    """
    from scipy.spatial import cKDTree

    moved = Similarity(scale=1.0, rotation=np.eye(3).tolist(), translation_m=[0.0, 0.0, 0.0])
    misfit = _misfit(mapped, target, tree, threshold)
    for level in _LEVELS:
        distance = level * threshold
        fixed, edge = thinned_to(target, distance / 2, _COARSE_MOST)
        there = cKDTree(fixed)
        found = icp(thinned_to(mapped, edge, _COARSE_MOST)[0], fixed, there, moved, distance)
        # Shrinking onto a part of the cloud looks good from one side only.
        after = _misfit(transform_points(found, mapped), target, tree, threshold)
        if after < misfit:
            moved, misfit = found, after
    return moved


def icp(points: FloatArray, fixed: FloatArray, tree: Any, start: Similarity, distance: float) -> Similarity:
    """Repeat nearest neighbours within a distance and least squares; the start where too few are near.

    Source: Besl and McKay 1992, with the scale of Umeyama 1991.
    """
    found = start
    now = transform_points(found, points)
    for _ in range(_ROUNDS):
        near, index = tree.query(now, distance_upper_bound=distance)
        inside = np.isfinite(near)
        if inside.sum() < _LEAST_PAIRS or is_collinear(points[inside]):
            return start
        found = umeyama(points[inside], fixed[index[inside]])
        if not (0.2 < found.scale / start.scale < 5.0):
            return start
        before, now = now, transform_points(found, points)
        if np.abs(now - before).max() < _SETTLED * distance:
            break
    return found


def _misfit(moved: FloatArray, target: FloatArray, tree: Any, distance: float) -> float:
    """Mean squared distances to the other side, cut off, of both sides."""
    from scipy.spatial import cKDTree

    there, back = tree.query(moved)[0], cKDTree(moved).query(target)[0]
    return float(sum((np.minimum(d, distance) ** 2).mean() for d in (there, back)))


def _planes(points: FloatArray, tree: Any) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Unit normals of the planes through the nearest neighbours of each point, and where it is flat.

    Averages round off edges, on either side by as much as its sampling says, and planes there are of
    neither face: points whose neighbours are not about as flat as those of most are left out.
    """
    _, index = tree.query(points, k=_NEIGHBOURS)
    near = points[index] - points[index].mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(near.swapaxes(1, 2) @ near)
    ratio = values[:, 0] / np.maximum(values[:, 1], 1e-300)
    normals: FloatArray = vectors[:, :, 0]
    return normals, ratio <= _FLAT * float(np.median(ratio))


def _pairs(
    moved: FloatArray, target: FloatArray, tree: Any, threshold: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of points that are nearest to each other."""
    from scipy.spatial import cKDTree

    distance, index = tree.query(moved, distance_upper_bound=threshold)
    chosen = np.flatnonzero(np.isfinite(distance))
    if len(chosen) < _LEAST_PAIRS:
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
    """The middle of the pairs, derivatives by (tau, lambda, omega) about it, and distances to planes."""
    p, q, n = moved[pairs[0]], target[pairs[1]], normals[pairs[1]]
    centre = p.mean(axis=0)
    d = p - centre
    jacobian = np.concatenate([n, (n * d).sum(axis=1, keepdims=True), np.cross(d, n)], axis=1)
    return centre, jacobian, (n * (p - q)).sum(axis=1)


def _weights(residual: FloatArray) -> tuple[FloatArray, float]:
    """Tukey's biweight, and its width: 4.685 times the robust standard deviation."""
    size = max(_TUKEY * 1.4826 * float(np.median(np.abs(residual))), 1e-12)
    weight: FloatArray = np.clip(1 - (residual / size) ** 2, 0, None) ** 2
    return weight, size


def _bend(residual: FloatArray, size: float) -> FloatArray:
    """Derivative of weight times residual, relative to the weight."""
    u = np.clip((residual / size) ** 2, 0, 1 - 1e-9)
    bend: FloatArray = 1 - 4 * u / (1 - u)
    return bend


def _determined(information: FloatArray, total: float, lever: float) -> None:
    """Refuse surfaces along which the scene could slide, turn or grow unnoticed.

    Of the information per unit of weight, with angles and growth in units of the points' mean distance,
    an eigenvalue is the share of it that sees a direction: about 1/3 for each in a furnished room.
    """
    units = np.array([1, 1, 1, *[1 / lever] * 4])
    scaled = information * units[:, None] * units / total
    least = float(np.linalg.eigvalsh(scaled)[0])
    if not least >= _WEAK:
        raise InputError(
            f"the overlap does not determine the similarity (least eigenvalue {least:.2g}): on a plane, a "
            "sphere or a pipe it slides, turns or grows unnoticed; use a cloud with walls in more directions"
        )


def _small(step: FloatArray, centre: FloatArray) -> Similarity:
    """The similarity of a small step about a centre."""
    x, y, z = step[4:]
    angle = float(np.linalg.norm(step[4:]))
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    half = np.sinc(angle / (2 * np.pi))
    rotation = np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * half * half * cross @ cross
    scale = float(np.exp(np.clip(step[3], -0.5, 0.5)))
    shift = centre + step[:3] - scale * rotation @ centre
    return Similarity(scale=scale, rotation=rotation.tolist(), translation_m=shift.tolist())
