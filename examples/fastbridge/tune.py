"""Search gains for every method of the comparison, with the same number of settings for each.

Usage: python tune.py CSV --room SCENE [--tile SCENE:SIGMA ...] [--trials N]
    [--tile-trials N] [--settings N] [--seed N]

A setting is a point of a Sobol sequence over the logarithms of a method's gains; setting 0 is the published
one, or the default where none is published. All fly the same pairs: in the room TRIALS pairs whose straight
line meets an obstacle, at 4.1 m/s, and in each tile TILE_TRIALS random pairs at 3.1 m/s. The best setting
has the most flights that reach their goal without a collision, then the fewest collisions, then the lowest
jerk integrated over its flights. No page reports these scenes and pairs. All settings are written to CSV,
the best with `yes`.
"""

import argparse
import csv
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from scipy.stats import qmc

from alula.schemas.artifacts.artifact import Artifact, read_artifact
from alula.schemas.scenarios.scenario import decoded
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.simulation.simulate import simulate_world

ROOM_SPEED_M_S, TILE_SPEED_M_S = 4.1, 3.1
PRINTED = {"return_time": 0.0, "min_speed_m_s": 0.0, "release_rad_s": 0.0, "shield": False}
# Method: its filter, what is fixed, and what is searched with its limits and its value in setting 0.
METHODS = {
    "safer-splat": ("safer-splat", {"rows": "all"}, {"alpha": (2, 30, 5), "beta": (0.5, 12, 1)}),
    "cone-ecbf": (
        "cone-ecbf",
        {},
        {"lambda_": (4, 40, 14), "return_time": (3, 20, 8), "escape_rate": (2, 12, 5)},
    ),
    "cone-backup": (
        "cone-backup",
        {},
        {"alpha_running": (3, 30, 10), "alpha_terminal": (2, 15, 5), "horizon_s": (0.75, 3, 1.5)},
    ),
    "cone-di": (
        "cone-di",
        {},
        {"alpha": (1, 20, 5), "recovery": (1, 9, 3), "reaction_time_s": (0.15, 1, 0.3)},
    ),
    "printed-ecbf": (
        "cone-ecbf",
        PRINTED,
        {"lambda_": (2, 40, 14), "clf_weight": (0.1, 1e4, 1e3), "reaction_time_s": (0.15, 1, 0.3)},
    ),
}
Gains = dict[str, float]
Place = tuple[Artifact, dict[str, Any], str, float, int]  # scene, level, pairs, speed [m/s], trials
COLUMNS = ("method", "setting", "best", "gains", "flights", "collided", "reached", "jerk_m_s2")


def settings_of(searched: Mapping[str, tuple[float, float, float]], count: int) -> list[Gains]:
    """List the settings to fly: the published or default one, then points of the sequence, to 3 digits."""
    points = qmc.Sobol(len(searched), scramble=False).random(1 << (count - 1).bit_length())[1:count]
    found = [{name: start for name, (_, _, start) in searched.items()}]
    for point in points:
        values = zip(searched.items(), point, strict=True)
        found.append({name: float(f"{low * (high / low) ** x:.3g}") for (name, (low, high, _)), x in values})
    return found


def parameters_of(method: str, gains: Gains) -> dict[str, Any]:
    """List all parameters of a setting; some follow from the gains."""
    _, fixed, _ = METHODS[method]
    given = {**fixed, **gains}
    if method == "safer-splat":  # the gate that the slow pole needs, for the variant that has one
        given["reaction_time_s"] = float(f"{2 / min(gains['alpha'], gains['beta']):.3g}")
    if method == "printed-ecbf":
        given["lambda_max"] = gains["lambda_"]
    if method == "cone-ecbf":
        given["lambda_max"] = max(40.0, gains["lambda_"])
    return given


def words_of(method: str, gains: Gains) -> str:
    """Write the parameters as the words of `--set`; what the Makefile fixes is left out."""
    _, fixed, _ = METHODS[method]
    return " ".join(f"{k}={v:g}" for k, v in parameters_of(method, gains).items() if k not in fixed)


def fly(method: str, gains: Gains, places: Sequence[Place], seed: int) -> tuple[int, int, int, float]:
    """Count flights, collisions and goals over all places; last the mean integrated jerk [m/s^2]."""
    flown = []
    for scene, level, pairs, speed, trials in places:
        name = METHODS[method][0]
        tree = {
            "world": {"scene": "scene"} | level,
            "mission": {"speed_m_s": speed, "which": pairs},
            "safety": {"filters": [name], name: parameters_of(method, gains)},
            "rules": {"trials": trials, "seed": seed, "logged": 0},
        }
        flown += simulate_world(decoded(tree, method), FASTBRIDGE, scene=scene).trials
    reached = sum(t.outcome == "reached" and not t.collision for t in flown)
    jerk = sum(t.mean_jerk_m_s3 * t.duration_s for t in flown) / len(flown)
    return len(flown), sum(t.collision for t in flown), reached, jerk


def main() -> None:
    """Search and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("output", type=Path)
    parser.add_argument("--room", type=Path, required=True)
    parser.add_argument("--tile", action="append", default=[], metavar="SCENE:SIGMA")
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--tile-trials", type=int, default=10)
    parser.add_argument("--settings", type=int, default=12)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    options = parser.parse_args()
    places = [(read_artifact(options.room), {"confidence": 0.99}, "blocked", ROOM_SPEED_M_S, options.trials)]
    for word in options.tile:
        path, sigma = word.rsplit(":", 1)
        places.append(
            (read_artifact(Path(path)), {"sigma": float(sigma)}, "any", TILE_SPEED_M_S, options.tile_trials)
        )
    rows = []
    for method in options.methods:
        found = []
        for number, gains in enumerate(settings_of(METHODS[method][2], options.settings)):
            result = fly(method, gains, places, options.seed)
            found.append((-result[2], result[1], result[3], number))
            rows.append([method, number, "no", words_of(method, gains), *result[:3], f"{result[3]:.4g}"])
            print(*rows[-1], file=sys.stderr, flush=True)
        best = min(found)[3]
        next(row for row in rows if row[:2] == [method, best])[2] = "yes"
        with options.output.open("w", newline="") as file:  # after each method, so that an end loses little
            csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])


if __name__ == "__main__":
    main()
