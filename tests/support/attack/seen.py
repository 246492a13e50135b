"""Seen files, covers and chains to flights, with levels and files that do not fit, against dense samples.

Three kinds of cases in turn. A room with random clutter is observed, voxelised and merged at a random level,
and verified against files of this or another scene and level, or after a change of the file. Flights in a
cover of this or another scene get their claim `chain`. The judge samples the ellipsoids themselves: a point
of an ellipsoid in a seen voxel, or outside of every hull, or within the vehicle, contradicts the verdict.
"""

from __future__ import annotations

import re
import time
from typing import Any

import msgspec
import numpy as np

from alula.schemas.artifacts.artifact import Artifact, make_artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.errors import AlulaError
from alula.schemas.parameters.configs.merge import MergeConfig
from alula.schemas.parameters.configs.observe import ObserveConfig
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.stages.compression.merge import merge
from alula.stages.compression.verify import verify
from alula.stages.compression.voxelize import voxelize
from alula.stages.planning.observe import observe
from alula.stages.planning.verify_seen import verify_seen
from support.attack.outcome import Outcome
from support.flights.world_runs import flown, made_from

G = 0.1  # voxel size [m]
SIZE = np.array([1.6, 1.2, 1.0])  # of the room [m]
RADIUS_M = 0.15  # of the quadrotor
CLOSE_M = 1e-3  # a sampled point this far inside of the vehicle is a hit
Judged = tuple[str, bool, str | None]  # the case, whether the claim is made, and what contradicts it
DIRECTIONS = 60  # sampled points on an ellipsoid, and as many in it


def search(seconds: float, seed: int) -> Outcome:
    """Draw cases until the time is over.

    Args:
        seconds: time to spend [s].
        seed: of the cases; case k has the generator (seed, k).
    """
    found = Outcome("a verdict on seen space or a cover, or a chain that holds, is true for what it names")
    begin, kinds = time.monotonic(), (_seen, _cover, _chain)
    while found.tried < len(kinds) or time.monotonic() - begin < seconds:
        case = found.tried
        rng = np.random.default_rng([seed, case])
        kind = kinds[case % len(kinds)]
        try:
            label, holds, wrong = kind(rng)
        except AlulaError:
            label, holds, wrong = kind.__name__[1:], None, None
        found.tried += 1
        about = label.split(",")[0]
        found.counts[f"{about} {'refused' if holds is None else 'proven' if holds else 'not proven'}"] += 1
        if wrong:
            found.contradictions.append(f"seed {seed}, case {case}, {label}: {wrong}")
    return found


def _scene(rng: np.random.Generator, mean: np.ndarray, scale: np.ndarray, opacity: np.ndarray) -> Artifact:
    """Gaussians of random attitude; half of the scenes have a loss."""
    n = len(mean)
    quat = rng.normal(size=(n, 4))
    quat[opacity == 1] = (1, 0, 0, 0)
    arrays = {
        "mean": mean,
        "scale": scale,
        "quat_wxyz": quat / np.linalg.norm(quat, axis=1, keepdims=True),
        "opacity": opacity,
        "color": np.zeros((n, 3)),
    }
    fields: dict[str, Any] = {"frame": "world", "unit": "m", "parameters": {}, "summary": {}, "source": {}}
    if rng.random() < 0.5:
        arrays["loss"] = rng.uniform(0, [0.02, 0.2, 0.1], (n, 3))
        fields["requires"] = ["splat-loss"]
    return make_artifact(SCENE, arrays, **fields)


def _room(rng: np.random.Generator) -> Artifact:
    """Opaque walls of flat Gaussians and clutter of any opacity."""
    mean, scale = [], []
    for axis in range(3):
        others = [i for i in range(3) if i != axis]
        u, v = (each.ravel() for each in np.meshgrid(*(np.arange(0.05, SIZE[i], 0.1) for i in others)))
        for side in (0.0, SIZE[axis]):
            points = np.full((len(u), 3), side)
            points[:, others[0]], points[:, others[1]] = u, v
            mean.append(points)
            scale.append(np.where(np.arange(3) == axis, 0.004, 0.07) * np.ones((len(u), 1)))
    count = int(rng.integers(3, 25))
    mean.append(rng.uniform(0.1, SIZE - 0.1, (count, 3)))
    scale.append(rng.uniform(0.003, 0.05, (count, 3)))
    walls = sum(map(len, mean)) - count
    opacity = np.concatenate([np.ones(walls), rng.uniform(0.02, 0.99, count)])
    return _scene(rng, np.concatenate(mean), np.concatenate(scale), opacity)


def _level(rng: np.random.Generator) -> dict[str, Any]:
    """A level, half of which leave something out."""
    found: dict[str, Any] = {"size_m": G, "sigma": float(rng.choice([0.7, 1.0, 1.5]))}
    found["inflation_m"] = float(rng.choice([0.0, 0.02]))
    for name, values in (("min_opacity", (0.5, 0.9)), ("min_overlap", (2, 3)), ("ignore_loss", (True,))):
        if rng.random() < 0.25:
            found[name] = values[int(rng.integers(len(values)))]
    return found


def _samples(
    scene: Artifact, rows: np.ndarray, sigma: float, inflation_m: float, *, is_grown: bool
) -> np.ndarray:
    """Points of ellipsoids grown by a ball and the loss, shape (rows, 2 * DIRECTIONS, 3), all inside."""
    u = np.random.default_rng(0).normal(size=(DIRECTIONS, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    mean, scale = (np.asarray(scene[name], np.float64)[rows] for name in ("mean", "scale"))
    w, x, y, z = np.asarray(scene["quat_wxyz"], np.float64)[rows].T
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    k, ball = np.full(len(rows), sigma), np.full(len(rows), inflation_m)
    if is_grown and "loss" in scene.arrays:
        shift, share, angle = np.asarray(scene["loss"], np.float64)[rows].T
        k = sigma * (1 + share)
        ball = ball + shift + angle * k * (scale.max(axis=1) - scale.min(axis=1))
    edge = np.einsum("nij,nj,dj->ndi", turn, k[:, None] * scale, u)
    normal = np.einsum("nij,ndj->ndi", turn, u[None] / scale[:, None])
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    reach = edge + ball[:, None, None] * normal
    inner = np.random.default_rng(1).random((1, DIRECTIONS, 1)) ** (1 / 3)
    return mean[:, None] + np.concatenate([reach * (1 - 1e-6), reach * inner * (1 - 1e-6)], axis=1)


def _touched(points: np.ndarray) -> dict[tuple[int, int, int], int]:
    """Number of ellipsoids with a sampled point in a voxel, by voxel."""
    found: dict[tuple[int, int, int], int] = {}
    for each in np.floor(points / G).astype(np.int64):
        for voxel in map(tuple, np.unique(each, axis=0).tolist()):
            found[voxel] = found.get(voxel, 0) + 1
    return found


def _named(scene: Artifact, level: Any, *, whole: bool) -> tuple[np.ndarray, int]:
    """Samples of the ellipsoids that a verdict is about, and how many of them make an obstacle."""
    counted = np.asarray(scene["opacity"]) >= np.float32(0 if whole else level.min_opacity)
    grown = whole or not level.ignore_loss
    points = _samples(scene, np.flatnonzero(counted), level.sigma, level.inflation_m, is_grown=grown)
    return points, 1 if whole else level.min_overlap


def _is_whole(found: Any) -> bool:
    """Whether a verdict is about all of the scene: it names nothing that it does not include."""
    return not re.search(r"retained|not included", found.statement)


def _seen(rng: np.random.Generator) -> Judged:
    room, level = _room(rng), _level(rng)
    config = ObserveConfig(**level, radius_m=0.11, reach=tuple(rng.uniform(0.3, SIZE - 0.3).tolist()))
    seen = observe(config, room, None, jobs=1)
    choice = int(rng.integers(6))
    label, truth, files = "seen", room, {"scene": room}
    voxel_config = VoxelizeConfig(**level)
    if choice == 1:
        files = {"voxels": voxelize(voxel_config, room, jobs=1)}
    elif choice == 2:
        label, truth = "seen, another scene", _room(rng)
        files = {"scene": truth}
    elif choice == 3:
        other = VoxelizeConfig(**_level(rng))
        label, files = "seen, voxels of a level", {"voxels": voxelize(other, room, jobs=1)}
    elif choice == 4:
        label = "seen, a voxel added"
        index = np.asarray(seen["index"])
        further = index[rng.integers(len(index))] + rng.integers(-2, 3, 3)
        index = np.unique(np.vstack([index, further]).astype(np.int32), axis=0)
        arrays = {"index": index, "views": np.ones(len(index), np.uint16)}
        seen = Artifact(seen.manifest, arrays)
    elif choice == 5:
        label = "seen, another level written"
        level = {name: value for name, value in _level(rng).items() if name != "size_m"}
        known = {"min_opacity": 0.0, "min_overlap": 1, "ignore_loss": False} | level
        seen = Artifact(msgspec.structs.replace(seen.manifest, **known), seen.arrays)
    found = verify_seen(seen, **files, jobs=1)
    if not found.covered:
        return label, False, None
    marked = set(map(tuple, np.asarray(seen["index"]).tolist()))
    points, enough = _named(truth, seen.manifest, whole=_is_whole(found))
    hit = [voxel for voxel, count in _touched(points).items() if count >= enough and voxel in marked]
    if hit:
        return label, True, f"{len(hit)} seen voxels are touched, such as {hit[0]}: {found.statement}"
    if (said := re.search(r"may touch (\d+) of its", found.statement)) is not None:
        points, _ = _named(truth, seen.manifest, whole=True)
        least = len(marked & _touched(points).keys())
        if least > int(said[1]):
            return label, True, f"{least} are touched, and it says {said[1]}: {found.statement}"
    return label, True, None


def _cover(rng: np.random.Generator) -> Judged:
    room, level = _room(rng), _level(rng)
    if rng.random() < 0.3:
        level["crop"] = (*rng.uniform(-0.2, 0.5, 3).tolist(), *rng.uniform(0.7, 1.8, 3).tolist())
    voxels = voxelize(VoxelizeConfig(**level), room, jobs=1)
    cover, truth, label = merge(MergeConfig(hulls=int(rng.integers(5, 60))), voxels, jobs=1), room, "cover"
    files: dict[str, Any] = {"scene": room} if rng.random() < 0.5 else {"scene": room, "voxels": voxels}
    choice = int(rng.integers(4))
    if choice == 1:
        label, truth = "cover, another scene", _room(rng)
        files["scene"] = truth
    elif choice == 2:
        label = "cover, another level written"
        other = {name: value for name, value in _level(rng).items() if name != "size_m"}
        known = {"min_opacity": 0.0, "min_overlap": 1, "ignore_loss": False} | other
        manifest = msgspec.structs.replace(cover.manifest, **known, guarantee=None)
        cover = Artifact(manifest, cover.arrays)
        files.pop("voxels", None)
    found = verify(cover, **files, jobs=1)
    if not found.covered:
        return label, False, None
    points, enough = _named(truth, cover.manifest, whole=_is_whole(found))
    counts = _touched(points)
    flat = points.reshape(-1, 3)
    if cover.manifest.crop is not None and not _is_whole(found):
        low, high = np.reshape(cover.manifest.crop, (2, 3))
        flat = flat[((flat > low) & (flat < high)).all(axis=1)]
    if enough > 1:
        flat = flat[[counts[tuple(v)] >= enough for v in np.floor(flat / G).astype(np.int64).tolist()]]
    outside = _outside(cover, flat)
    if len(outside):
        return (
            label,
            True,
            f"{len(outside)} points are in no hull, such as {outside[0]}: {found.statement}",
        )
    return label, True, None


def _outside(cover: Artifact, points: np.ndarray) -> np.ndarray:
    """Points in no polytope of a cover."""
    normal, offset = np.asarray(cover["plane_normal"], float), np.asarray(cover["plane_offset"], float)
    left = points / G
    for first, last in zip(cover["plane_start"][:-1], cover["plane_start"][1:], strict=True):
        left = left[~(left @ normal[first:last].T <= offset[first:last] + 1e-9).all(axis=1)]
    return left * G


def _balls(rng: np.random.Generator) -> Artifact:
    """A few Gaussians near the middle of a box in which flights start and end."""
    count = int(rng.integers(1, 4))
    mean = rng.uniform([1.5, -0.4, 0.8], [2.5, 0.4, 1.2], (count, 3))
    return _scene(rng, mean, rng.uniform(0.05, 0.15, (count, 3)), rng.uniform(0.3, 0.99, count))


def _chain(rng: np.random.Generator) -> Judged:
    scene, level = _balls(rng), _level(rng)
    origin = scene if (same := rng.random() < 0.6) else _balls(rng)
    cover = merge(
        MergeConfig(hulls=20), made_from(voxelize(VoxelizeConfig(**level), origin, jobs=1), origin), jobs=1
    )
    sigma = float(rng.choice([level["sigma"], 1.0, 3.0]))
    against = str(rng.choice(["hulls", "hulls", "both"]))
    is_beside = rng.random() < 0.8
    run = flown(
        "shield",
        {"shield_map": against if is_beside else "hulls"},
        scene=scene if is_beside else None,
        cover=cover,
        trials=2,
        seed=int(rng.integers(1000)),
        sigma=sigma,
        speed_m_s=2.5,
        max_time_s=4.0,
        bounds_m=(0.0, -0.7, 0.4, 4.0, 0.7, 1.6),
        margin_m=0.0,
        log_rate_hz=100.0,
        jobs=1,
    )
    label = f"chain, {'the same' if same else 'another'} scene" if is_beside else "chain, cover alone"
    if not run.guarantee.claims["chain"]["holds"]:
        return label, False, None
    met = scene if is_beside else origin
    largest = max(sigma, level["sigma"]) if is_beside else level["sigma"]
    rows = np.arange(len(met["mean"]))
    points = _samples(met, rows, largest, 0.0, is_grown=True).reshape(-1, 3)
    path = np.concatenate([flight.rows("state")[:, :3] for flight in run.flights])
    closest = min(float(np.linalg.norm(path - point, axis=1).min()) for point in points)
    if closest < RADIUS_M - CLOSE_M:
        return label, True, f"an ellipsoid is {closest:.3f} m from the centre of the vehicle"
    return label, True, None
