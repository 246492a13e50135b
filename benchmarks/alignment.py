"""Coverage of the intervals of `scale-align` in many regimes, and the time of a fit.

Cameras stand like those of a synthetic COLMAP model; 40 % of their surveyed positions are gross errors
and the others have normal noise. With drift, the cameras are on a path, and all have a random walk along it
instead. The nominal coverage is 95 % for each interval, and at least 95 % for the bound of the box. Times are
not tested.
"""

from __future__ import annotations

import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import time
from collections.abc import Iterator
from itertools import product
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from alula.schemas.artifacts.manifest import Similarity
from alula.stages.alignment.poses import fit_poses
from alula.stages.alignment.robust import Fit, fit_similarity
from alula.stages.alignment.similarity import transform_points

Array = NDArray[np.float64]
Figures = dict[str, Any]

THRESHOLD_M = 0.1
ANGLE_RAD = 0.0873
COUNTS = (12, 30, 60, 200)
NOISE_M = (0.001, 0.01, 0.02, THRESHOLD_M / 3)
LOW, HIGH = 0.93, 0.97


def centres(count: int, rng: np.random.Generator) -> Array:
    """Cameras 4 to 6 units from the middle of a scene, as COLMAP's synthetic models have them."""
    import pycolmap

    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_frames_per_rig, options.num_points3D = 1, count, 10
    pycolmap.set_random_seed(int(rng.integers(2**31)))
    model = pycolmap.synthesize_dataset(options)
    return np.array([image.projection_center() for image in model.images.values()])


def truth_of(rng: np.random.Generator) -> Similarity:
    """A random similarity; the scale is within a factor of e or so."""
    return Similarity(
        scale=float(np.exp(0.5 * rng.normal())),
        rotation=Rotation.from_rotvec(2 * rng.normal(size=3)).as_matrix().tolist(),
        translation_m=rng.normal(size=3).tolist(),
    )


def surveyed(world: Array, sigma: float, outliers: float, rng: np.random.Generator) -> Array:
    """World positions with noise, and gross errors within their box."""
    measured = world + sigma * rng.normal(size=world.shape)
    wrong = rng.permutation(len(world))[: round(outliers * len(world))]
    measured[wrong] = rng.uniform(world.min(axis=0), world.max(axis=0), (len(wrong), 3))
    return np.asarray(measured, np.float64)


def on_a_path(count: int, rng: np.random.Generator) -> Array:
    """Positions of a flight around a scene, 0.6 to 1.4 rounds."""
    t = np.linspace(0, 2 * np.pi, count, endpoint=False) * rng.uniform(0.6, 1.4)
    phase = rng.uniform(0, 2 * np.pi, 3)
    return np.stack(
        [3 * np.cos(t + phase[0]), 2 * np.sin(t + phase[1]), 0.6 * np.sin(2 * t + phase[2])], axis=1
    )


def drifted(world: Array, sigma: float, rng: np.random.Generator) -> Array:
    """World positions with a random walk along the path, with a standard deviation of sigma."""
    walk = np.cumsum(rng.normal(size=world.shape), axis=0)
    walk -= walk.mean(axis=0)
    return np.asarray(world + sigma / walk.std() * walk, np.float64)


def held(fit: Fit, truth: Similarity, source: Array) -> Array:
    """Return whether the intervals contain scale, three angles and three shifts, and the bound the box."""
    record = fit.uncertainty.record(fit.similarity)
    low, high = record["scale_interval"]
    turn = np.array(truth.rotation) @ np.array(fit.similarity.rotation).T
    off = np.abs(Rotation.from_matrix(turn).as_rotvec(degrees=True))
    shift = np.abs(np.subtract(truth.translation_m, fit.similarity.translation_m))
    corners = np.array(list(product(*zip(source.min(axis=0), source.max(axis=0), strict=True))))
    mapped = transform_points(fit.similarity, corners)
    error = np.linalg.norm(transform_points(truth, corners) - mapped, axis=1).max()
    return np.array(
        [
            low <= truth.scale <= high,
            *(off <= record["rotation_interval_deg"]),
            *(shift <= record["translation_interval_m"]),
            error <= fit.uncertainty.position_error(mapped),
        ],
        np.float64,
    )


def regime(way: str, count: int, sigma: float, outliers: float, seeds: int) -> Figures:
    """Fractions of seeds in which each interval contains the truth."""
    source = centres(count, np.random.default_rng(count))
    coverage, sizes, spent = np.zeros(8), 0.0, 0.0
    for seed in range(seeds):
        rng = np.random.default_rng([seed, count])
        truth = truth_of(rng)
        world = transform_points(truth, source)
        measured = surveyed(world, sigma, outliers, rng)
        if way == "drift":
            source = on_a_path(count, rng)
            measured = drifted(transform_points(truth, source), sigma, rng)
        begin = time.perf_counter()
        if way != "poses":
            fit = fit_similarity(source, measured, THRESHOLD_M, 0)
        else:
            axes = Rotation.from_rotvec(3 * rng.normal(size=(count, 3))).as_matrix()
            noise = Rotation.from_rotvec(0.01 * rng.normal(size=(count, 3))).as_matrix()
            seen = np.array(truth.rotation) @ axes @ noise
            fit = fit_poses(source, axes, measured, seen, THRESHOLD_M, ANGLE_RAD, 0)
        spent += time.perf_counter() - begin
        coverage += held(fit, truth, source)
        sizes += fit.sigma / sigma
    coverage /= seeds
    return {
        "way": way,
        "count": count,
        "sigma_m": sigma,
        "outliers": outliers,
        "seeds": seeds,
        "scale": coverage[0],
        "rotation": coverage[1:4].tolist(),
        "translation": coverage[4:7].tolist(),
        "box": coverage[7],
        "sigma_ratio": sizes / seeds,
        "milliseconds": 1e3 * spent / seeds,
    }


def regimes(seeds: int) -> Iterator[Figures]:
    """Measure all regimes."""
    for count, sigma in product(COUNTS, NOISE_M):
        yield regime("positions", count, sigma, 0.4, seeds)
    for count in (6, 20, 60):
        yield regime("drift", count, 0.02, 0.0, seeds)
    for count, sigma in product((12, 60), (0.001, 0.01)):
        yield regime("poses", count, sigma, 0.4, seeds)


def speed() -> list[Figures]:
    """Time one fit of many correspondences, 40 % of them wrong."""
    found = []
    for count in (1_000, 10_000, 100_000):
        rng = np.random.default_rng(count)
        source = rng.normal(size=(count, 3)) * [3, 2, 1]
        measured = surveyed(transform_points(truth_of(rng), source), 0.01, 0.4, rng)
        begin = time.perf_counter()
        fit_similarity(source, measured, THRESHOLD_M, 0)
        found.append({"count": count, "seconds": time.perf_counter() - begin})
    return found


def line(row: Figures) -> str:
    """A regime as a line of the table."""
    rotation, translation = (" ".join(f"{x:.3f}" for x in row[name]) for name in ("rotation", "translation"))
    mark = "" if LOW <= row["scale"] <= HIGH else "  outside 93 to 97 %"
    return (
        f"{row['way']:<10}{row['count']:>5}{1e3 * row['sigma_m']:>9.1f}{row['scale']:>9.3f}  {rotation}  "
        f"{translation}{row['box']:>8.3f}{row['sigma_ratio']:>8.3f}{row['milliseconds']:>8.1f}{mark}"
    )


def main() -> None:
    """Print the table, or JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--seeds", type=int, default=1000, help="per regime (default: %(default)s)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of the table")
    arguments = parser.parse_args()
    if arguments.seeds < 1:
        parser.error("--seeds must be at least 1")
    rows = []
    if not arguments.json:
        error = sqrt(0.95 * 0.05 / arguments.seeds)
        print(f"Coverage of 95 % intervals over {arguments.seeds} seeds; one standard error is {error:.3f}")
        print("way        n  noise mm    scale  rotation x y z     translation x y z    box  sigma^      ms")
    for row in regimes(arguments.seeds):
        rows.append(row)
        if not arguments.json:
            print(line(row), flush=True)
    times = speed()
    if arguments.json:
        print(json.dumps({"threshold_m": THRESHOLD_M, "rows": rows, "speed": times}, indent=2))
        return
    for entry in times:
        print(f"{entry['count']:,} correspondences: {entry['seconds']:.2f} s")


if __name__ == "__main__":
    sys.exit(main())
