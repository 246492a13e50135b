"""The frame of a splat against that of the COLMAP model of its cameras.

Some trainers move and scale a model before they train (see `recipes`), so that its cameras are not in the
frame of the splat. The 3D points of the model show it: in the same frame, almost each has a Gaussian near.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.manifest import Similarity
from alula.schemas.errors import AlulaError, CheckError
from alula.schemas.parameters.configs.scale_align import MIN_NEAR
from alula.stages.alignment.cloud import CloudFit, fit_cloud
from alula.stages.alignment.evidence import UNCHECKED, Landmarks
from alula.stages.alignment.recipes import recipes, right_angles
from alula.stages.alignment.similarity import compose, from_moments, transform_points
from alula.stages.alignment.uncertainty import mapped_corners

NEAR = 0.02  # of a point's distance from the nearest camera: as near as a Gaussian must be
_SPARSE = 5.0  # times as much, where the Gaussians themselves lie that far apart
_INSIDE = 0.1  # fraction of the points that must lie in the convex hull of the Gaussians
_FOUND_NEAR, _FOUND_INSIDE = 0.75, 0.3  # what a frame that was found must have
_RIVAL = 0.9  # times the fraction of the best: another frame that is as good
_AS_GOOD = 0.95  # times the fraction of the best: a recipe is preferred to what ICP made of it
_APART = 5.0  # times `NEAR`: mean distance of frames that are different
_MIN_POINTS = 50  # of the model, and Gaussians
_HULL_POINTS = 100_000
_MOST_POINTS = 5_000
_SEARCH_POINTS = 500
_REFINED = 8  # best candidates, which are refined
_LEVELS = (24.0, 12.0, 6.0, 3.0, 1.5)  # maximum distances of pairs, in `NEAR`
_ROUNDS = 12
_THRESHOLD = 3.0  # maximum distance of a pair of the final fit, in `NEAR` of the median point
_MIRROR = np.array([-1.0, 1.0, 1.0])

MEND = (
    "give the model that the splat was trained on, undo nerfstudio's change with --nerfstudio, or train "
    "without one (gsplat --no-normalize-world-space, OpenSplat --keep-crs)"
)


@dataclass(frozen=True, slots=True)
class ModelFrame:
    """The frame of a model's cameras, checked against a splat.

    Attributes:
        scene_from_model: None where the model is in the splat's frame.
        fit: the similarity's residuals and uncertainty, in the splat's frame; None as above.
    """

    scene_from_model: Similarity | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    fit: CloudFit | None = None

    def position_error(self, lower: FloatArray, upper: FloatArray) -> float:
        """Bound of the error that the similarity adds in a box, with 95 % confidence [splat units].

        Args:
            lower: smallest coordinates, shape (3,), splat frame.
            upper: largest coordinates, shape (3,), splat frame.
        """
        if self.fit is None:
            return 0.0
        same = Similarity(scale=1.0, rotation=np.eye(3).tolist(), translation_m=[0.0, 0.0, 0.0])
        return self.fit.uncertainty.position_error(mapped_corners(same, lower, upper))


def model_frame(landmarks: Landmarks, visible: Callable[[], FloatArray], min_near: float) -> ModelFrame:
    """Check that a model is in the frame of a splat; where it is not, find the similarity between them.

    A point is near a Gaussian when a centre lies within 2 % of its distance from the nearest camera; where
    the Gaussians themselves are that sparse, within their distance from each other, at most five times as
    much. Only points in the convex hull of the Gaussians are judged, because a splat may be cropped.

    Where too few are near, the recipes of the trainers, each with the turns by right angles that exporters
    add, are refined by ICP with scale. The best one is taken only if 75 % of the points are near, no other
    frame that differs is nearly as good, neither turned nor mirrored, and the surfaces determine it (see
    `fit_cloud`). A recipe that agrees with the ICP within its error is taken as it is.

    Args:
        visible: function that returns the centres of the visible Gaussians, shape (n, 3), splat frame.
        min_near: minimum fraction of the points that must be near a Gaussian.

    Raises:
        CheckError: fewer are near, and no similarity was found that is unique and tight.
    """
    points = _evenly(landmarks.points, _MOST_POINTS)
    if len(points) < _MIN_POINTS:
        return ModelFrame(warnings=(UNCHECKED.format(why=f"{landmarks.name} has {len(points)} 3D points"),))
    centres = visible()
    if len(centres) < _MIN_POINTS:
        return ModelFrame(warnings=(UNCHECKED.format(why=f"{len(centres)} Gaussians are visible"),))
    judge = _Judge(points, landmarks.cameras, centres)
    near, inside = judge.fractions(points)
    facts: dict[str, Any] = {"points": len(points), "near": near, "inside": inside, "within": NEAR}
    figure = f"{near:.0%} of the 3D points have a Gaussian near"
    if inside < _INSIDE:
        figure = f"{inside:.0%} of the 3D points are in the convex hull of the splat"
    if near >= min_near and inside >= min(_INSIDE, min_near):
        weak = near < MIN_NEAR or inside < _INSIDE
        return ModelFrame(facts=facts, warnings=(f"only {figure}; --min-near admits it",) if weak else ())
    what = (
        f"{landmarks.name}: is not in the frame of the splat: {figure}, {min_near:.0%} are needed "
        "(--min-near)"
    )
    name, found = _searched(landmarks, judge, what)
    fit = _fitted(points, judge, found, what)
    similarity, frame = fit.similarity, ModelFrame(fit=fit)
    gap = transform_points(found, points) - transform_points(similarity, points)
    is_recipe = float(np.linalg.norm(gap, axis=1).max()) <= frame.position_error(*judge.box)
    if is_recipe:  # exact, up to what the trainer rounded
        similarity = found
    near, inside = judge.fractions(points, similarity)
    facts = {
        "before": facts,
        "points": len(points),
        "near": near,
        "inside": inside,
        "within": NEAR,
        "like": name,
        "by": "the recipe" if is_recipe else "ICP",
        "scale": similarity.scale,
        "rotation": [list(row) for row in similarity.rotation],
        "translation": list(similarity.translation_m),
        "rms": float(np.sqrt((fit.residual**2).mean())),
        "pairs": len(fit.residual),
        **{
            key: value
            for key, value in fit.uncertainty.record(similarity).items()
            if key.startswith("scale_")
        },
    }
    warning = (
        f"the cameras of {landmarks.name} are not in the frame of the splat ({figure}); they were mapped to "
        f"it by a similarity like {name}, by which {near:.0%} have"
    )
    return ModelFrame(similarity, facts, (warning,), fit)


class _Judge:
    """Gaussians, and the distance that is near for each of the points that candidates map to them."""

    def __init__(self, points: FloatArray, cameras: FloatArray, centres: FloatArray) -> None:
        from scipy.spatial import ConvexHull, cKDTree

        self.centres = centres
        self.tree = cKDTree(centres)
        self.near = NEAR * cKDTree(cameras).query(points)[0]
        self.box = centres.min(axis=0), centres.max(axis=0)
        self.planes = ConvexHull(_evenly(centres, _HULL_POINTS), qhull_options="QJ").equations

    def fractions(
        self, points: FloatArray, similarity: Similarity | None = None, rows: slice = slice(None)
    ) -> tuple[float, float]:
        """Fraction of the points in the hull of the Gaussians that are near one, and of all in the hull."""
        near = self.near[rows]
        if similarity is not None:
            points, near = transform_points(similarity, points), similarity.scale * near
        inside = (points @ self.planes[:, :3].T + self.planes[:, 3]).max(axis=1) <= near
        if not inside.any():
            return 0.0, 0.0
        near = near[inside]
        distance, index = self.tree.query(points[inside], distance_upper_bound=_SPARSE * float(near.max()))
        held = np.flatnonzero(distance <= _SPARSE * near)
        apart = self.tree.query(self.centres[index[held]], k=min(5, len(self.centres)))[0][:, -1]
        good = distance[held] <= np.maximum(near[held], apart)
        return float(good.sum()) / len(near), float(inside.mean())

    def misfit(self, points: FloatArray, similarity: Similarity, rows: slice) -> float:
        """Mean distance from the nearest Gaussian, relative to the largest one of ICP and at most 1."""
        limit = _LEVELS[0] * similarity.scale * self.near[rows]
        now = transform_points(similarity, points)
        distance, _ = self.tree.query(now, distance_upper_bound=float(limit.max()))
        return float(np.minimum(distance / limit, 1).mean())

    def score(self, points: FloatArray, similarity: Similarity, rows: slice) -> float:
        """Fraction of all points that are near a Gaussian."""
        near, inside = self.fractions(points, similarity, rows)
        return near * inside

    def refined(self, points: FloatArray, start: Similarity, rows: slice) -> Similarity:
        """ICP with scale, weighted by Tukey's biweight at the distances of `_LEVELS`."""
        found, near = start, self.near[rows]
        for level in _LEVELS:
            for _ in range(_ROUNDS):
                now = transform_points(found, points)
                limit = level * found.scale * near
                distance, index = self.tree.query(now, distance_upper_bound=float(limit.max()))
                pairs = distance < limit
                if pairs.sum() < _MIN_POINTS // 2:
                    return start
                weight = ((1 - (distance / limit)[pairs] ** 2) / near[pairs]) ** 2
                following = _weighted(points[pairs], self.centres[index[pairs]], weight)
                if following is None or not 0.2 < following.scale / start.scale < 5:
                    return start
                step = np.linalg.norm(transform_points(following, points) - now, axis=1)
                found = following
                if (step < 0.05 * limit).all():
                    break
        return found


def _weighted(x: FloatArray, y: FloatArray, weight: FloatArray) -> Similarity | None:
    """Weighted least-squares similarity; None where the points determine none."""
    weight = weight / weight.sum()
    x_mean, y_mean = weight @ x, weight @ y
    dx, dy = x - x_mean, y - y_mean
    spread = float(weight @ (dx * dx).sum(axis=1))
    if not spread > 0:
        return None
    scale, rotation = from_moments((dy * weight[:, None]).T @ dx, spread)
    translation = y_mean - scale * rotation @ x_mean
    if not (scale > 0 and np.isfinite(translation).all()):
        return None
    return Similarity(scale=float(scale), rotation=rotation.tolist(), translation_m=translation.tolist())


def _evenly(points: FloatArray, count: int) -> FloatArray:
    """At most `count` of the points, by a fixed permutation."""
    return points[np.random.default_rng(0).permutation(len(points))[:count]]


def _searched(landmarks: Landmarks, judge: _Judge, what: str) -> tuple[str, Similarity]:
    """The best frame of the recipes, if it is good and no other is nearly as good."""
    rows = slice(_SEARCH_POINTS)
    points = _evenly(landmarks.points, _MOST_POINTS)[rows]
    tried = [
        _Candidate(recipe.name, compose(_turn(axes), recipe.moved_from_model), is_mirrored)
        for is_mirrored in (False, True)
        for recipe in recipes(landmarks)
        for axes in right_angles()
    ]
    best = _best(points, judge, rows, tried)
    exact = max((one for one in best if one.is_exact), key=lambda one: one.score)
    chosen = exact if exact.score >= _AS_GOOD * best[0].score else best[0]
    proper = next((one for one in best if not one.is_mirrored), chosen)
    if chosen.is_mirrored and proper.score > _RIVAL * chosen.score:  # as for a plane
        chosen = proper
    near, inside = judge.fractions(chosen.of(points), chosen.similarity, rows)
    if near < _FOUND_NEAR or inside < _FOUND_INSIDE:
        raise CheckError(f"{what}, and no known trainer's change of frame fits; {MEND}")
    if chosen.is_mirrored:
        raise CheckError(
            f"{what}; the splat is a mirror image of the model ({near:.0%} of the mirrored points fit)"
        )
    middle = np.median(points, axis=0)
    principal = np.linalg.svd(points - middle, full_matrices=False)[2]
    principal[0] *= np.linalg.det(principal)
    probes = [
        _Candidate(
            chosen.name,
            _about(
                compose(chosen.similarity, _turn(principal.T @ axes @ principal)), chosen.similarity, middle
            ),
            is_mirrored,
        )
        for is_mirrored in (False, True)
        for axes in right_angles()
    ]
    place = transform_points(chosen.similarity, points)
    for rival in [*best, *_best(points, judge, rows, probes)]:
        distance = np.linalg.norm(transform_points(rival.similarity, rival.of(points)) - place, axis=1)
        is_other = np.median(distance / judge.near[rows]) > _APART * chosen.similarity.scale
        if is_other and rival.score > _RIVAL * chosen.score:
            raise CheckError(
                f"{what}; two frames fit it, {chosen.name} by {chosen.score:.0%} of the points and the same "
                f"{'mirrored' if rival.is_mirrored else 'turned'} by {rival.score:.0%}, so that neither is "
                f"certain; {MEND}"
            )
    return chosen.name, chosen.similarity


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A frame that may be the splat's."""

    name: str
    similarity: Similarity
    is_mirrored: bool = False
    is_exact: bool = True
    score: float = 0.0

    def of(self, points: FloatArray) -> FloatArray:
        """The points that the similarity maps."""
        return points * _MIRROR if self.is_mirrored else points


def _best(points: FloatArray, judge: _Judge, rows: slice, tried: list[_Candidate]) -> list[_Candidate]:
    """The best candidates, as they are and refined, best first."""

    def scored(one: _Candidate) -> _Candidate:
        return replace(one, score=judge.score(one.of(points), one.similarity, rows))

    def refined(one: _Candidate) -> _Candidate:
        moved = judge.refined(one.of(points), one.similarity, rows)
        return scored(replace(one, similarity=moved, is_exact=False))

    ranked = sorted(tried, key=lambda one: judge.misfit(one.of(points), one.similarity, rows))[:_REFINED]
    found = [*map(scored, ranked), *map(refined, ranked)]
    return sorted(found, key=lambda one: -one.score)


def _turn(axes: NDArray[Any]) -> Similarity:
    return Similarity(scale=1.0, rotation=axes.tolist(), translation_m=[0.0, 0.0, 0.0])


def _about(turned: Similarity, found: Similarity, middle: FloatArray) -> Similarity:
    """The similarity moved so that it maps a point like another one."""
    gap = transform_points(found, middle[None])[0] - transform_points(turned, middle[None])[0]
    return Similarity(turned.scale, turned.rotation, (np.array(turned.translation_m) + gap).tolist())


def _fitted(points: FloatArray, judge: _Judge, found: Similarity, what: str) -> CloudFit:
    threshold = _THRESHOLD * found.scale * float(np.median(judge.near))
    try:
        return fit_cloud(points, judge.centres, found, threshold, _FOUND_INSIDE)
    except AlulaError as error:
        raise CheckError(
            f"{what}; a frame was found, but its error has no bound, because the surfaces are too few or do "
            f"not determine it; {MEND}"
        ) from error
