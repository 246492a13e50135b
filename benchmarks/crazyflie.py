"""Flights of the Crazyflie's firmware through the room and into corners, behind `fly` and behind its app.

ALULA_CRAZYFLIE names the program (tests/sitl/README.md). Each way of flying goes along a plan there and back
at each speed, from the floor: take-off, flight, landing. All are judged by the program's true motion while
set-points were sent, joined by segments.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parent))
sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
sys.path.sort(key=lambda path: path in sys.path[-2:])  # last: modules of the same names come first

import numpy as np
from fly import GOAL, START, VIA, make_world
from measure import FloatArray
from real_autopilot import FlyProcess, fly_batches, timed, with_section
from scipy.spatial import cKDTree

from alula.cli.main import run as alula
from alula.schemas.artifacts.artifact import read_artifact, write_artifact
from alula.schemas.artifacts.kinds import COVER, PLAN, SCENE
from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.clearance import hull_obstacles, path_clearance, scene_obstacles
from alula.stages.compression.hulls import Hulls
from alula.stages.compression.onboard.layout import encode_map
from alula.stages.planning.plan_samples import sample_plan
from support.scenes.small_scenes import ball_scene, box_cover, line_plan
from support.vehicles.crazyflie_host import crazyflie

ROOT = Path(__file__).resolve().parents[1]
VEHICLE = ROOT / "examples" / "vehicles" / "crazyflie21.toml"


@dataclasses.dataclass(frozen=True)
class Way:
    """A way of flying: the firmware's controller, the filter of `fly`, its map, and the plan's interface."""

    controller: str
    filter: str
    map: str
    interface: str


WAYS = {
    "polytope-cbf, PID": Way("pid", "polytope-cbf", "cover", "velocity"),
    "cone-di, Mellinger": Way("mellinger", "cone-di", "scene", "acceleration"),
    "the app, PID": Way("oot", "none", "cover", "velocity"),
}
SPEEDS = (0.3, 0.5, 0.8, 1.0)
ROOM, CORNER = "room", "corner"
CENTRE = np.array([0.0, 0.0, 1.0])  # between the corners
_HALF, _HIGH = 12, 20  # of the walls around it [voxels of 0.1 m]
_OUT = _HALF + 3
_PEAK = 2.1875  # largest speed of a line over its mean
SECTION = "## The Crazyflie's firmware\n"
_SAFE_S = 150.0  # a flight ends before


@dataclasses.dataclass(frozen=True)
class Cell:
    """One flight: where, which way, at which speed; in the room there (even numbers) or back."""

    place: str
    name: str
    speed_m_s: float
    number: int

    @property
    def key(self) -> str:
        """Name of the flight in the file of results."""
        return f"{self.place}/{self.name}/{self.speed_m_s:g}/{self.number}"

    def plan(self, folder: Path) -> Path:
        """Its plan."""
        kind = self.number if self.place == CORNER else self.number % 2
        return folder / self.place / f"{self.speed_m_s:g}.{kind}.{WAYS[self.name].interface}.plan.npz"


def make_corner(folder: Path) -> None:
    """Write walls around a corner each, as hulls and as balls that fill them."""
    walls = [
        ((_HALF, -_OUT, 0), (_OUT, _OUT, _HIGH)),
        ((-_OUT, -_OUT, 0), (-_HALF, _OUT, _HIGH)),
        ((-_OUT, _HALF, 0), (_OUT, _OUT, _HIGH)),
        ((-_OUT, -_OUT, 0), (_OUT, -_HALF, _HIGH)),
    ]
    voxels = np.concatenate([np.argwhere(np.ones(np.subtract(b, a))) + a for a, b in walls])
    folder.mkdir(parents=True, exist_ok=True)
    write_artifact(folder / "cover.npz", box_cover(walls))
    write_artifact(folder / "scene.npz", ball_scene(0.1 * voxels + 0.05, 0.087))


def make_plan(folder: Path, cell: Cell) -> None:
    """Write the plan of a flight."""
    if cell.place == CORNER:
        aim = np.random.default_rng(cell.number).uniform(0.1 * _HALF - 0.17, 0.1 * _HALF - 0.12, 2)
        signs = ((1, 1), (-1, 1), (-1, -1), (1, -1))[cell.number % 4]
        goal = np.array([*(aim * signs), CENTRE[2]])
        seconds = float(np.linalg.norm(goal - CENTRE)) * _PEAK / cell.speed_m_s
        write_artifact(cell.plan(folder), line_plan(CENTRE, goal, seconds))
        return
    folder = folder / cell.place
    start, goal = ((START, GOAL), (GOAL, START))[cell.number % 2]
    words = [
        "plan",
        str(folder / "cover.npz"),
        "-o",
        str(cell.plan(folder.parent)),
        "--vehicle",
        str(VEHICLE),
    ]
    words += ["--speed", str(cell.speed_m_s), "--interface", WAYS[cell.name].interface, "-f", "-q"]
    words += ["--beyond-map", "10"]
    for option, point in (("--start", start), ("--via", VIA), ("--goal", goal)):
        words += [option, "{} {} {}".format(*point)]
    if alula(words) != 0:
        raise SystemExit("there is no plan")


class Place:
    """A place's hulls, ellipsoids and image for the app."""

    def __init__(self, folder: Path) -> None:
        cover = read_artifact(folder / "cover.npz", COVER)
        self.folder = folder.parent
        self.hulls = hull_obstacles(Hulls.from_cover(cover))
        self.scene = scene_obstacles(read_artifact(folder / "scene.npz", SCENE), 1.0)
        self.image = encode_map(cover, indexed=True)
        self.radius_m = read_vehicle(VEHICLE).body.radius_m

    def judge(self, cell: Cell, path: FloatArray) -> dict[str, Any]:
        """Figures of a true path, shape (T, 3)."""
        plan = read_artifact(cell.plan(self.folder), PLAN)
        away = cKDTree(sample_plan(plan, 0.01)).query(path)[0]
        return {
            "hull_clearance_m": float(path_clearance(path, self.hulls).min()) - self.radius_m,
            "scene_clearance_m": float(path_clearance(path, self.scene).min()) - self.radius_m,
            "away_p95_m": float(np.quantile(away, 0.95)),
            "away_max_m": float(away.max()),
        }

    def fly(self, cell: Cell) -> dict[str, Any]:
        """Fly a cell."""
        way = WAYS[cell.name]
        start = read_artifact(cell.plan(self.folder), PLAN)["coefficient"][0, :3, 0]
        image = self.image if way.controller == "oot" else b""
        with (
            tempfile.TemporaryDirectory() as name,
            crazyflie(Path(name), (*start[:2], 0.0), "--seed", str(cell.number + 1), image=image) as vehicle,
        ):
            words = [
                str(cell.plan(self.folder)),
                "-f",
                "--map",
                str(self.folder / cell.place / f"{way.map}.npz"),
            ]
            words += [
                "--filter",
                way.filter,
                "--vehicle",
                str(VEHICLE),
                "--link",
                vehicle.link(way.controller),
            ]
            words += ["--origin", "0 0 0", "--stale", "0.4", "--latency", "0.05"]
            if cell.place == CORNER:
                words += ["--allow-tight", "--allow-other-map", "--speed", str(1.5 * cell.speed_m_s)]
            with FlyProcess(*words, "-o", str(Path(name) / "f.run.mcap")) as process:
                code = process.end(_SAFE_S)
            rows = np.array(vehicle.truth)
            has_ended = vehicle.process.poll()
        lines = timed(process.heard)
        begin = next((at for at, line in lines if "flying the plan" in line), None)
        end = next(
            (at for at, line in lines if begin and at > begin and ": landing" in line), time.monotonic()
        )
        last = lines[-1][1] if lines else ""
        ended = next((line.split("s  ")[-1] for at, line in lines if at == end), last)
        figures: dict[str, Any] = {"ended_by": ended, "code": code}
        figures["is_finished"] = ended.startswith("plan finished") and code in (0, 4)
        if code != 0 or has_ended is not None:
            figures |= {"said": [line for _, line in lines][-12:], "host": has_ended}
        if begin is not None:
            flown = rows[(rows[:, 0] >= begin) & (rows[:, 0] <= end)]
            figures |= {"flight_s": end - begin} | self.judge(cell, np.ascontiguousarray(flown[:, 2:5]))
            lost = flown[:, 0] - flown[:, 1]  # by the program's clock, which does not catch up
            figures["clock_lost_s"] = float(lost[-1] - lost[0])
        return figures


def table(found: dict[str, dict[str, Any]]) -> str:
    """A row for each place, way and speed."""
    heads = ["where", "filter, controller", "set-points", "plan, m/s", "flights", "plan finished", "contacts"]
    heads += ["exit code 4", "least clearance, m", "from the plan, m: 95 %", "max", "flight, s"]
    lines = [heads, ["---"] * len(heads)]
    groups: dict[tuple[str, str, float], list[dict[str, Any]]] = {}
    for key, figures in found.items():
        place, name, speed, _ = key.split("/")
        if "away_max_m" in figures:
            groups.setdefault((place, name, float(speed)), []).append(figures)
    order = list(WAYS)
    for (place, name, speed), flights in sorted(
        groups.items(), key=lambda group: (group[0][0] == CORNER, order.index(group[0][1]), group[0][2])
    ):
        way = WAYS[name]
        clear = [each["scene_clearance_m" if way.map == "scene" else "hull_clearance_m"] for each in flights]
        lines.append(
            [
                *(
                    place,
                    name,
                    "full states" if way.controller == "mellinger" else "velocities",
                    f"{speed:g}",
                ),
                *(str(len(flights)), str(sum(each["is_finished"] for each in flights))),
                *(str(sum(each <= 0 for each in clear)), str(sum(each["code"] == 4 for each in flights))),
                f"{min(clear):.3f}",
                f"{np.median([each['away_p95_m'] for each in flights]):.3f}",
                f"{max(each['away_max_m'] for each in flights):.3f}",
                f"{np.median([each['flight_s'] for each in flights]):.1f}",
            ]
        )
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


_PREFACE = """
Plans with `examples/vehicles/crazyflie21.toml`, flown by `alula fly` from the floor. The firmware of
August 2026 runs as a program of the host in real time (`tests/sitl/README.md`): its own estimator,
supervisor, commander and controllers, a rigid body without drag, poses with 2 mm of noise. In the room
the plans of `alula plan` lead there and back. The app filters on board with its defaults (`radius` 0.15
m); `fly` then has no filter. Straight plans into the corner of two walls end inside of the filter's
margin of 0.175 m (radius and margin): the filter has to stop the vehicle, and a flight that it holds
there ends with "took too long". The app was flown into corners as
[firmware](../guide/firmware.md#what-it-does) says. Clearances are those of the true motion while
set-points were sent, to the hulls or the ellipsoids that the filter flies among, less the vehicle's
radius of 0.075 m; 0.1 m is what both filters of `fly` keep beyond it. Made by:

    ALULA_CRAZYFLIE=~/crazyflie-host/crazyflie-host python benchmarks/crazyflie.py \\
      --markdown docs/results/benchmarks-fly.md

"""


def main() -> int:
    """Fly what is missing, and print the table; return 1 if there was a contact."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=5, metavar="N", help="of each way and speed: 5")
    parser.add_argument("--speeds", type=float, nargs="+", default=list(SPEEDS), metavar="M_S")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="vehicles at once: 2")
    parser.add_argument("--keep", type=Path, default=Path("build/crazyflie"), help="maps and results")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the table into this page")
    options = parser.parse_args()
    folder: Path = options.keep
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / ROOM / "cover.npz").exists():
        (folder / ROOM).mkdir(exist_ok=True)
        make_world(folder / ROOM, 200_000, 0.05, 150)
    make_corner(folder / CORNER)
    results = folder / "flights.jsonl"
    lines = results.read_text().splitlines() if results.exists() else []
    found = {row.pop("key"): row for row in map(json.loads, lines)}
    cells = [
        Cell(place, name, speed, number)
        for place in (ROOM, CORNER)
        for number in range(options.flights)
        for speed in options.speeds
        for name in WAYS
        if place == ROOM or WAYS[name].controller != "oot"  # tests/sitl/crazyflie flies the app into corners
    ]
    missing = [cell for cell in cells if cell.key not in found]
    for cell in missing:
        if not cell.plan(folder).exists():
            make_plan(folder, cell)
    places = {place: Place(folder / place) for place in (ROOM, CORNER)}
    lock = threading.Lock()

    def fly(cell: Cell) -> None:
        figures = places[cell.place].fly(cell)
        with lock, results.open("a") as kept:
            kept.write(json.dumps({"key": cell.key, **figures}) + "\n")
            found[cell.key] = figures

    fly_batches(missing, options.jobs, fly)
    shown = table({cell.key: found[cell.key] for cell in cells if cell.key in found})
    if options.markdown is not None:
        page = options.markdown.read_text()
        options.markdown.write_text(with_section(page, f"{SECTION}{_PREFACE}{shown}", keeps_notes=True))
    print(shown, end="")
    return int(any(row.get("scene_clearance_m", 1.0) <= 0 for row in found.values()))


if __name__ == "__main__":
    sys.exit(main())
