"""Robust estimation of a similarity from camera poses: MSAC, then a fit to positions and orientations."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from math import comb, degrees, log, pi, radians

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.manifest import Similarity
from alula.schemas.errors import InputError
from alula.stages.alignment.correlation import CORRELATED, disagreement, with_correlation
from alula.stages.alignment.robust import Fit, fit_similarity, leave_one_out, threshold_warnings
from alula.stages.alignment.similarity import is_collinear, transform_points
from alula.stages.alignment.uncertainty import (
    correlation_warnings,
    shape_warnings,
    uncertainty_of_points,
    untruncated,
)

_MAX_SAMPLES = 2000
_REFITS = 30
_MISS_PROBABILITY = 1e-9  # that no sampled pair is free of outliers
_REFUSED_TURN = radians(5.0)  # a larger constant turn between camera axes means another convention of axes
_NOTED_TURN = radians(0.2)  # a smaller one is not worth a warning
_SIGNIFICANT = 4.0  # standard errors
_CONVENTIONS = {
    "OpenGL axes (x right, y up, z backward; negate the y and z axes of the cameras)": (1, -1, -1),
    "axes turned about y (x left, z backward)": (-1, 1, -1),
    "images upside down (x left, y up)": (-1, -1, 1),
}


def fit_poses(
    source: FloatArray,
    R_source: FloatArray,
    target: FloatArray,
    R_target: FloatArray,
    threshold: float,
    angle: float,
    seed: int,
) -> Fit:
    """Estimate the similarity of the largest consistent set of poses by MSAC on pairs of poses.

    The model is target_i = s R source_i + t and R_target_i = R R_source_i, each with independent normal
    errors. Pairs of poses propose s, R, t; the proposal with the smallest MSAC cost (see `robust`), where an
    angle above `angle` counts as an outlier too, is refitted. The fit minimises
    sum |target_i - s R source_i - t|^2 / sigma_p^2 + w |R - R_a|^2 / 2, where R_a is the chordal mean of
    R_target_i R_source_i' (Hartley et al. 2013, section 5.3) and w [1/rad^2] is the information on that
    mean: m / sigma_a^2, or less where orientations contradict the positions by a constant turn. So two poses
    are enough, and positions may lie on a line.

    Args:
        source: positions of the cameras, shape (n, 3), source frame, any units.
        R_source: axes of the cameras as columns, shape (n, 3, 3), source frame.
        target: positions of the same cameras, shape (n, 3) [m], target frame.
        R_target: axes of the same cameras as columns, shape (n, 3, 3), target frame.
        threshold: maximum distance of an inlier [m].
        angle: maximum angle of an inlier [rad].

    Returns:
        The fit to the inliers, with the angles of all poses.

    Raises:
        InputError: fewer than two poses, no two poses agree, or the axes of the cameras follow different
            conventions.
    """
    if len(source) < 2:
        raise InputError(f"{len(source)} pose; two at different positions are needed")
    inlier = _msac(source, R_source, target, R_target, threshold, angle, seed)
    by_positions = _by_positions(source, target, threshold, seed)
    if by_positions is not None:
        turned = angles(R_target, np.array(by_positions.similarity.rotation) @ R_source)
        both = by_positions.inlier & (turned <= angle)
        inlier = both if both.sum() > inlier.sum() else inlier
        if 2 * inlier.sum() <= len(source) < 2 * by_positions.inlier.sum():
            _refuse_turned(source, R_source, target, R_target, by_positions, int(inlier.sum()))
    if inlier.sum() < 2:
        raise InputError(
            f"no two of {len(source)} poses agree within {threshold:g} m and {degrees(angle):g} deg"
            + _hint(source, R_source, target, R_target)
        )
    for _ in range(_REFITS):
        fit = _evaluate(source, R_source, target, R_target, inlier, threshold)
        assert fit.angle is not None
        again = (fit.residual <= threshold) & (fit.angle <= angle)
        if (again == inlier).all() or again.sum() < inlier.sum():
            break
        inlier = again
    return fit


def chordal_mean(rotations: FloatArray) -> FloatArray:
    """Chordal mean: the rotation that minimises the sum of squared Frobenius distances.

    Args:
        rotations: shape (n, 3, 3).

    Returns:
        Shape (3, 3).
    """
    return _nearest(rotations.sum(axis=0))


def _nearest(matrix: FloatArray) -> FloatArray:
    u, _, vt = np.linalg.svd(matrix)
    u[..., :, 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    rotation: FloatArray = u @ vt
    return rotation


def angles(first: FloatArray, second: FloatArray) -> FloatArray:
    """Angles between rotations, accurate near zero too.

    Args:
        first: shape (n, 3, 3), or (1, 3, 3) to compare one with all.

    Returns:
        Shape (n,) [rad].
    """
    chord = np.linalg.norm(first - second, axis=(1, 2))
    angle: FloatArray = 2 * np.arcsin(np.clip(chord / np.sqrt(8.0), 0, 1))
    return angle


def _solve(
    x: FloatArray, y: FloatArray, R_mean: FloatArray, w: float, sigma: float, turning: bool
) -> tuple[float, FloatArray, FloatArray]:
    """Scale, rotation and translation; positions contribute to the rotation if `turning`."""
    x_mean, y_mean = x.mean(axis=0), y.mean(axis=0)
    x, y = x - x_mean, y - y_mean
    rotation = R_mean
    spread = float((x * x).sum())
    scale = max(float((y * (x @ rotation.T)).sum()) / spread, 1e-12)
    for _ in range(_REFITS if turning else 0):
        again = _nearest(scale * (y.T @ x) + 0.5 * w * sigma**2 * R_mean)
        moved = np.abs(again - rotation).max()
        rotation = again
        scale = max(float((y * (x @ rotation.T)).sum()) / spread, 1e-12)
        if moved < 1e-15:
            break
    return scale, rotation, y_mean - scale * rotation @ x_mean


def _msac(
    source: FloatArray,
    R_source: FloatArray,
    target: FloatArray,
    R_target: FloatArray,
    threshold: float,
    angle: float,
    seed: int,
) -> NDArray[np.bool_]:
    """Inliers of the MSAC proposal with the smallest cost after refitting, shape (n,)."""
    count = len(source)
    rng = np.random.default_rng(seed)
    if comb(count, 2) <= _MAX_SAMPLES:
        pairs = np.array(list(combinations(range(count), 2)))
    else:
        drawn = rng.integers(0, count, (2 * _MAX_SAMPLES, 2))
        pairs = drawn[drawn[:, 0] != drawn[:, 1]][:_MAX_SAMPLES]
    turn = R_target @ R_source.swapaxes(1, 2)
    best, best_cost = np.zeros(count, np.bool_), np.inf
    pairs = rng.permutation(pairs)
    for tried, (a, b) in enumerate(pairs.tolist()):
        inlier_fraction = best.mean()
        if tried * -log(max(1 - inlier_fraction**2, 1e-300)) > -log(_MISS_PROBABILITY):
            break
        dx, dy = source[b] - source[a], target[b] - target[a]
        length = float(np.linalg.norm(dx))
        scale = float(np.linalg.norm(dy)) / length if length > 0 else 0.0
        if scale <= 0:
            continue
        mean = _nearest(turn[a] + turn[b])
        # For distant positions the direction of their line is more accurate than the orientations.
        for rotation in (mean, _smallest_rotation(mean @ dx / length, dy / (scale * length)) @ mean):
            middle = 0.5 * (target[a] + target[b]) - 0.5 * scale * rotation @ (source[a] + source[b])
            inlier, cost = _inliers_and_cost(source, target, turn, scale, rotation, middle, threshold, angle)
            if cost < best_cost:
                best, best_cost = inlier, cost
    for _ in range(_REFITS):
        if best.sum() < 2 or np.ptp(source[best], axis=0).max() <= 0:
            break
        mean = chordal_mean(turn[best])
        scale, rotation, shift = _solve(source[best], target[best], mean, 0.0, 0.0, turning=False)
        again, _ = _inliers_and_cost(source, target, turn, scale, rotation, shift, threshold, angle)
        if (again == best).all() or again.sum() < best.sum():
            break
        best = again
    return best


def _smallest_rotation(a: FloatArray, b: FloatArray) -> FloatArray:
    """Smallest rotation that takes one unit vector to another; the identity for nearly opposite ones."""
    x, y, z = np.cross(a, b)
    v, c = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), float(a @ b)
    return np.eye(3) + v + v @ v / (1 + c) if c > -0.99 else np.eye(3)


def _inliers_and_cost(
    source: FloatArray, target: FloatArray, turn: FloatArray, scale: float, rotation: FloatArray,
    shift: FloatArray, threshold: float, angle: float,
) -> tuple[NDArray[np.bool_], float]:  # fmt: skip
    """Inliers of a similarity, and its MSAC cost."""
    squared = ((scale * source @ rotation.T + shift - target) ** 2).sum(axis=1)
    inlier = (squared <= threshold * threshold) & (angles(turn, rotation[None]) <= angle)
    return inlier, float(np.where(inlier, squared, threshold * threshold).sum())


def _evaluate(
    source: FloatArray,
    R_source: FloatArray,
    target: FloatArray,
    R_target: FloatArray,
    inlier: NDArray[np.bool_],
    limit: float,
) -> Fit:
    x, y, count = source[inlier], target[inlier], int(inlier.sum())
    if np.ptp(x, axis=0).max() <= 0:
        raise InputError("the poses that agree are all at one position; the scale is unknown")
    turn = R_target[inlier] @ R_source[inlier].swapaxes(1, 2)
    R_mean = chordal_mean(turn)
    turning = count >= 4  # fewer positions do not determine both their own errors and the rotation
    scale, rotation, shift = _solve(x, y, R_mean, 0.0, 0.0, turning=False)
    sigma_a = float(np.sqrt((angles(turn, R_mean[None]) ** 2).sum() / (3 * count - 3)))
    information = 1 / max(sigma_a**2 / count, 1e-24)
    by_positions = None if not turning or is_collinear(x) else _rotation_of(x, y)
    sigma = 0.0
    freedom = 3.0 * count - 4
    for _ in range(20):
        similarity = Similarity(scale=scale, rotation=rotation.tolist(), translation_m=shift.tolist())
        mapped = transform_points(similarity, x)
        squared = float(((mapped - y) ** 2).sum())
        centred = mapped - mapped.mean(axis=0)
        position_information = (centred * centred).sum() * np.eye(3) - centred.T @ centred
        if not turning:
            break
        if by_positions is not None:
            offset = float(angles(R_mean[None], by_positions[None])[0])
            expected = (
                sigma_a**2 / count + sigma**2 * float(np.trace(np.linalg.inv(position_information))) / 3
            )
            if sigma > 0 and offset**2 > 3 * _SIGNIFICANT**2 * expected:
                information = 3 / offset**2
        # The number of angles, up to three, that the positions determine costs as many degrees of freedom.
        total = position_information + sigma**2 * information * np.eye(3)
        determined = float(np.trace(position_information @ np.linalg.pinv(total)))
        freedom = 3.0 * count - 4 - min(determined, 3.0)
        before, sigma = sigma, float(np.sqrt(squared / freedom))
        if abs(sigma - before) <= 1e-9 * sigma:
            break
        scale, rotation, shift = _solve(x, y, R_mean, information, sigma, turning=True)
    if not turning:
        sigma = float(np.sqrt(squared / freedom))
    spread = untruncated(sigma, freedom, limit)
    singular = np.linalg.svd(x - x.mean(axis=0), compute_uv=False)
    singular = np.pad(singular, (0, 3 - len(singular)))
    warnings = [f"{text}, but orientations determine it" for text in shape_warnings(singular)[:1]
                if "collinear" in text]  # fmt: skip
    warnings += threshold_warnings(spread.error, limit)
    warnings += _constant_turn(x, R_source[inlier], y, R_target[inlier], sigma)
    warnings += correlation_warnings(x, mapped - y)
    if turning and not is_collinear(x):
        without = leave_one_out(x, y, scale)
    else:
        without = _leave_one_out_given(x, y, rotation, scale)
    independent = uncertainty_of_points(
        mapped, spread.fit, spread.freedom, information, positions_turn=turning
    )
    uncertainty, correlated = with_correlation(independent, mapped, mapped - y, spread.fit)
    parts = disagreement(mapped, y, spread.fit) if correlated > CORRELATED else None
    if parts is not None:
        uncertainty = replace(uncertainty, covariance=parts.factor * uncertainty.covariance)
        warnings.append(parts.warning())
    return Fit(
        similarity=similarity,
        inlier=inlier,
        residual=np.linalg.norm(transform_points(similarity, source) - target, axis=1),
        sigma=spread.error,
        uncertainty=uncertainty,
        leave_one_out=without,
        singular_values=singular,
        correlated=correlated,
        angle=angles(R_target, np.array(similarity.rotation) @ R_source),
        warnings=tuple(warnings),
    )


def _leave_one_out_given(
    x: FloatArray, y: FloatArray, rotation: FloatArray, scale: float
) -> tuple[float, float]:
    """Range of the scale with one pose left out and the rotation kept; `scale` itself for two poses."""
    if len(x) < 3:
        return scale, scale
    scales = []
    for i in range(len(x)):
        a, b = np.delete(x, i, axis=0), np.delete(y, i, axis=0)
        a, b = (a - a.mean(axis=0)) @ rotation.T, b - b.mean(axis=0)
        if (spread := float((a * a).sum())) > 0:
            scales.append(float((a * b).sum()) / spread)
    return (min(scales), max(scales)) if scales else (scale, scale)


def _rotation_of(x: FloatArray, y: FloatArray) -> FloatArray:
    """Rotation that positions alone determine."""
    return _nearest((y - y.mean(axis=0)).T @ (x - x.mean(axis=0)))


def _turn_of_axes(
    x: FloatArray, R_x: FloatArray, y: FloatArray, R_y: FloatArray, sigma: float
) -> tuple[FloatArray, float]:
    """Constant turn E of the camera axes in R_y = R R_x E, with R from positions, and its standard error."""
    rotation = _rotation_of(x, y)
    y = y - y.mean(axis=0)
    each = R_x.swapaxes(1, 2) @ rotation.T @ R_y
    mean = chordal_mean(each)
    scatter = float((angles(each, mean[None]) ** 2).mean()) / len(x)
    position_information = (y * y).sum() * np.eye(3) - y.T @ y
    return mean, float(np.sqrt(scatter + sigma**2 * np.trace(np.linalg.inv(position_information)) / 3))


def _constant_turn(x: FloatArray, R_x: FloatArray, y: FloatArray, R_y: FloatArray, sigma: float) -> list[str]:
    """Warn when orientations contradict positions by a constant turn; refuse a large one."""
    if len(x) < 4 or is_collinear(x):
        return []
    turn, error = _turn_of_axes(x, R_x, y, R_y, sigma)
    angle = float(angles(turn[None], np.eye(3)[None])[0])
    if angle <= max(_NOTED_TURN, _SIGNIFICANT * error):
        return []
    text = f"the cameras' axes are turned by a constant {degrees(angle):.3g} deg against the positions"
    if angle > max(_REFUSED_TURN, 2 * _SIGNIFICANT * error):
        raise InputError(f"{text}{_described(turn)}; correct the axes, or use positions alone (--reference)")
    return [f"{text}: orientations got little weight"]


def _by_positions(source: FloatArray, target: FloatArray, threshold: float, seed: int) -> Fit | None:
    """Fit to positions alone; None where they do not determine a similarity."""
    try:
        return fit_similarity(source, target, threshold, seed) if len(source) >= 4 else None
    except InputError:
        return None


def _refuse_turned(
    source: FloatArray,
    R_source: FloatArray,
    target: FloatArray,
    R_target: FloatArray,
    fit: Fit,
    agreeing: int,
) -> None:
    """Refuse poses with positions that agree much better than their orientations."""
    x, y = source[fit.inlier], target[fit.inlier]
    turn, _ = _turn_of_axes(x, R_source[fit.inlier], y, R_target[fit.inlier], fit.sigma)
    angle = degrees(float(angles(turn[None], np.eye(3)[None])[0]))
    raise InputError(
        f"the positions of {fit.inlier.sum()} of {len(source)} poses agree, but with their orientations only "
        f"{agreeing}: the axes are turned by {angle:.3g} deg{_described(turn)}; correct the axes, or use "
        "positions alone (--reference)"
    )


def _described(turn: FloatArray) -> str:
    for name, signs in _CONVENTIONS.items():
        if angles(turn[None], np.diag(np.array(signs, np.float64))[None])[0] < radians(20):
            return f", like {name}"
    vector = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    length = float(np.linalg.norm(vector))
    if length < 1e-6:
        return ""
    return " about the camera's axis " + " ".join(f"{value:.2f}" for value in vector / length)


def _hint(source: FloatArray, R_source: FloatArray, target: FloatArray, R_target: FloatArray) -> str:
    """Hint at another convention of the axes that would explain why no poses agree; empty without one."""
    best, name = pi / 4, ""
    for title, signs in _CONVENTIONS.items():
        turn = R_target @ np.diag(np.array(signs, np.float64)) @ R_source.swapaxes(1, 2)
        spread = float(np.median(angles(turn, chordal_mean(turn)[None])))
        plain = R_target @ R_source.swapaxes(1, 2)
        worse = float(np.median(angles(plain, chordal_mean(plain)[None])))
        if spread < min(best, worse / 3):
            best, name = spread, title
    return f"; the cameras of one side seem to have {name}" if name else ""
