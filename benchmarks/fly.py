"""Real-time flights of the simulated autopilot, and the times of the control loop.

`alula sim-vehicle` runs in a process of its own in real time, like ArduPilot's simulation. In another process
`alula fly` flies it along a plan through the built-in room: arming, take-off, flight, landing. The vehicle
also sends its true pose in the format of motion capture; only the judge uses it. Clearances are those of the
true path (100 Hz samples joined by segments) while set-points were sent, to the filter's obstacles (hulls or
ellipsoids); they use nothing that `fly` measured. Times are those of every tick from the checks to the end; a
tick overruns when it ends after the scheduled start of the next one.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parent))
sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))  # how responses are measured
sys.path.sort(key=lambda path: path in sys.path[-2:])  # last: modules of the same names come first

import numpy as np
from measure import FloatArray
from scenes import room

from alula._core import EllipsoidSet, PolytopeSet
from alula.cli.main import run as alula
from alula.schemas.artifacts.artifact import read_artifact, write_artifact
from alula.schemas.artifacts.kinds import COVER, SCENE
from alula.schemas.log.mcap import open_log
from alula.schemas.log.run import record_path
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.clearance import hull_obstacles, path_clearance, scene_obstacles
from alula.stages.compression.hulls import Hulls
from alula.stages.sim_vehicle.ardupilot.copter import ArduCopter
from alula.stages.sim_vehicle.simulator import SimulatedVehicle
from support.vehicles.autopilot_client import EXACT
from support.vehicles.responses import Measurer, Stepped, stops

FILTERS = {"cone-backup": "scene", "polytope-cbf": "cover"}
START, GOAL = (0.8, 0.8, 0.9), (4.7, 3.6, 1.1)  # behind a hoop and a pillar
VIA = (2.3, 2.7, 1.0)
# Times in which velocities of ArduPilot's own simulation fell by 63 % after a stop [s], measured by another
# client than that of `support.vehicles.responses`.
_REAL_STOPS_S = {
    "stop_1_s": 0.74,
    "stop_2_s": 0.90,
    "stop_3_s": 1.11,
    "stop_up_1_s": 0.80,
    "stop_up_2_s": 1.38,
}
_ARDUCOPTER = Path(__file__).resolve().parents[1] / "examples" / "vehicles" / "arducopter.toml"
_ALULA = [sys.executable, "-P", "-m", "alula.cli"]
_INDOORS = ("--param", "FS_THR_ENABLE=3", "--param", "FS_DR_ENABLE=1")  # it must not fly home in an emergency
_BRISK = ("--boot-time", "1", "--param", "LAND_SPEED=120", "--param", "WPNAV_ACCEL_Z=250", *_INDOORS)
_PLAN_RADIUS_M = 0.25  # radius and margin of the filters
_ARRIVED_M = 0.4  # arrival radius of `fly` (0.2 m), the filter's margin, and the error of the estimate
_TIMEOUT_S = 120.0
_FLYING = ("fly", "hold")
# Tscholl, Nakka and Gunter 2026, on their own computer and vehicle.
_PUBLISHED = [
    "FastBridge, published",
    "",
    "12.3",
    "21.0",
    "34.8",
    "",
    "",
    "1 of 822",
    "755 of 822",
    "",
    "0.154",
    "",
    "",
]


class Witness(threading.Thread):
    """Receiver of the vehicle's true position on a port of this machine."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.2)
        self.address = f"udp:127.0.0.1:{self._socket.getsockname()[1]}"
        self._rows: list[tuple[float, ...]] = []
        self._ends = threading.Event()

    def run(self) -> None:
        """Receive until `end`."""
        while not self._ends.is_set():
            with contextlib.suppress(TimeoutError):
                sample = json.loads(self._socket.recv(2048))
                self._rows.append((time.monotonic(), *sample["position_m"]))

    def end(self) -> FloatArray:
        """Stop; return times of arrival [s] and positions relative to the start [m], shape (n, 4)."""
        self._ends.set()
        self.join()
        self._socket.close()
        return np.array(self._rows).reshape(-1, 4)


def make_world(folder: Path, gaussians: int, voxel_m: float, hulls: int) -> None:
    """Write the room's scene and cover to a folder."""
    write_artifact(folder / "scene.npz", room(gaussians))
    steps = (
        f"voxelize {folder}/scene.npz -o {folder}/voxels.npz --size {voxel_m} -q",
        f"merge {folder}/voxels.npz -o {folder}/cover.npz --hulls {hulls} -q",
    )
    for step in steps:
        if alula(step.split()) != 0:
            raise SystemExit(f"failed: alula {step}")


def make_plan(folder: Path, speed_m_s: float) -> Path:
    """Write the plan at a speed."""
    path = folder / f"{speed_m_s:g}.plan.npz"
    words = [
        "plan",
        str(folder / "cover.npz"),
        "-o",
        str(path),
        "--speed",
        str(speed_m_s),
        "-q",
        "--beyond-map",
        "10",
    ]
    points = {"--start": START, "--via": VIA, "--goal": GOAL}
    for option, point in points.items():
        words += [option, "{} {} {}".format(*point)]
    if alula([*words, "--radius", str(_PLAN_RADIUS_M)]) != 0:
        raise SystemExit("there is no plan")
    return path


@contextlib.contextmanager
def vehicle(witness: Witness, seed: int) -> Iterator[str]:
    """Start `alula sim-vehicle`; yield its address while it still boots."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        place = f"127.0.0.1:{probe.getsockname()[1]}"
    words = [*_ALULA, "sim-vehicle", "-q", "--link", f"udpout:{place}", "--mocap", witness.address]
    words += [*_BRISK, "--seed", str(seed)]
    with subprocess.Popen(words, stderr=subprocess.DEVNULL) as process:
        try:
            yield f"udpin:{place}"
        finally:
            process.terminate()
            process.wait(10)


def fly(folder: Path, plan: Path, name: str, seed: int) -> tuple[Path, float, FloatArray]:
    """Fly once; return the log, its start in monotonic time [s], and the true path, map frame, (n, 4)."""
    log = folder / f"{plan.stem}.{name}.{seed}.run.mcap"
    witness = Witness()
    witness.start()
    with vehicle(witness, seed) as link:
        words = [*_ALULA, "fly", str(plan), "--map", str(folder / f"{FILTERS[name]}.npz"), "--filter", name]
        if name == "cone-backup":  # by rates: the rate loops of ArduPilot
            words += ["--vehicle", str(_ARDUCOPTER)]
        words += ["--link", link, "--origin", f"{-START[0]} {-START[1]} 0", "-o", str(log)]
        with subprocess.Popen(words, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as process:
            timer = threading.Timer(_TIMEOUT_S, process.kill)
            timer.start()
            assert process.stderr is not None
            lines, begin = [], np.inf
            for (
                line
            ) in process.stderr:  # "   3.21 s  words"; the line with the smallest delay gives the clock
                lines.append(line)
                seconds, _, words_ = line.strip().partition(" s  ")
                if words_ and seconds.replace(".", "", 1).isdigit():
                    begin = min(begin, time.monotonic() - float(seconds))
            timer.cancel()
    if not log.exists() or not np.isfinite(begin):
        raise SystemExit(f"{name}: there was no flight\n{''.join(lines)}")
    seen = witness.end()
    return log, begin, seen + np.array((0.0, START[0], START[1], 0.0))


def ticks_of(log: Path) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Read the records of each tick and of each step of the supervisor from a log."""
    from mcap.reader import make_reader

    with open_log(log) as stream:
        records = [json.loads(m.data) for _, _, m in make_reader(stream).iter_messages(["/supervisor"])]
    return [row for row in records if "tick_s" in row], [row for row in records if "event_name" in row]


def obstacles_of(folder: Path, name: str) -> PolytopeSet | EllipsoidSet:
    """Obstacles of a filter: hulls, or the ellipsoids within them."""
    if FILTERS[name] == "cover":
        return hull_obstacles(Hulls.from_cover(read_artifact(folder / "cover.npz", COVER)))
    return scene_obstacles(read_artifact(folder / "scene.npz", SCENE), 1.0)


def judge(folder: Path, plan: Path, name: str, seed: int, speed_m_s: float) -> dict[str, Any]:
    """Fly once and return its figures."""
    log, begin, seen = fly(folder, plan, name, seed)
    ticks, steps = ticks_of(log)
    record = json.loads(record_path(log).read_text())
    timing, (trial,) = record["timing"], record["trials"]
    flown = [row["time_s"] for row in ticks if row["state_name"] in _FLYING]
    path = seen[(seen[:, 0] >= begin + flown[0] - 0.05) & (seen[:, 0] <= begin + flown[-1] + 0.05), 1:]
    minimum = float(path_clearance(np.ascontiguousarray(path), obstacles_of(folder, name)).min())
    end_m = float(np.linalg.norm(path[-1] - GOAL))
    tick = np.array([row["tick_s"] for row in ticks[1:]])  # of the tick before
    return {
        "filter": name,
        "speed_m_s": speed_m_s,
        "seed": seed,
        # Velocities are followed late, so a fast flight cuts corners: it may leave the tube about its plan,
        # or pass its via point too far away.
        "reached": bool(trial["outcome"] in ("reached", "off-plan", "missed-via") and end_m < _ARRIVED_M),
        "outside_m": trial["plan"]["outside_m"],
        "via_missed": len(trial["plan"]["missed"]),
        "via_m": max(trial["plan"]["closest_m"]),
        "ended_by": record["summary"]["ended_by"],
        "end_m": end_m,
        "min_clearance_m": minimum - FASTBRIDGE.body.radius_m,
        "margin_m": record["provenance"]["parameters"]["margin_m"],
        "max_speed_m_s": trial["max_speed_m_s"],
        "flight_s": flown[-1] - flown[0],
        "rate_hz": (len(ticks) - 1) / (ticks[-1]["time_s"] - ticks[0]["time_s"]),
        "ticks": timing["ticks"],
        "tick_mean_ms": 1e3 * float(tick.mean()),
        **{f"tick_{part}_ms": 1e3 * timing[f"tick_{part}_s"] for part in ("p50", "p99", "max")},
        **{f"lateness_{part}_ms": 1e3 * timing[f"lateness_{part}_s"] for part in ("p50", "p99", "max")},
        **{f"filter_{part}_ms": 1e3 * timing[f"filter_{part}_s"] for part in ("p50", "p99", "max")},
        "overruns": timing["overruns"],
        "skipped": timing["skipped"],
        "dropped_samples": timing["dropped_samples"],
        "filtered_ticks": trial["steps"],
        "feasible_ticks": trial["steps"] - trial["infeasible_steps"],
        "holds": record["summary"]["holds"],
        "supervisor": [f"{row['event_name']}: {row['state_name']}" for row in steps],
    }


def lag_ratio() -> float:
    """Times in which the simulated autopilot stops over those of the real one; the farthest from 1."""
    copter = ArduCopter(FASTBRIDGE, seed=1, options=EXACT)
    client = Measurer(Stepped(SimulatedVehicle(copter, seed=1)))
    client.take_off()
    found = stops(client)
    return max((found[name] / real for name, real in _REAL_STOPS_S.items()), key=lambda ratio: abs(ratio - 1))


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Fly all flights and return their figures."""
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_world(folder, options.gaussians, options.voxel, options.hulls)
        plans = {speed: make_plan(folder, speed) for speed in options.speeds}
        flights = [
            judge(folder, plans[speed], kind, seed, speed)
            for speed in options.speeds
            for seed in range(options.flights)
            for kind in FILTERS
        ]
    maxima = ("tick_p50_ms", "tick_p99_ms", "tick_max_ms", "lateness_p99_ms", "lateness_max_ms")
    return {
        "quick": options.quick,
        "machine": f"{platform.machine()}, {os.cpu_count()} processors",
        "python": platform.python_version(),
        "rate_hz": min(flight["rate_hz"] for flight in flights),
        **{key: max(flight[key] for flight in flights) for key in maxima},
        **{key: sum(flight[key] for flight in flights) for key in ("ticks", "overruns", "skipped")},
        "dropped_samples": sum(flight["dropped_samples"] for flight in flights),
        "lag_ratio_sim_over_real_reference": lag_ratio(),
        "via_missed": sum(flight["via_missed"] for flight in flights),
        "min_clearance_m": min(flight["min_clearance_m"] for flight in flights),
        "reached": all(flight["reached"] for flight in flights),
        "flights_reached": sum(flight["reached"] for flight in flights),
        "flights": flights,
        "total_s": time.perf_counter() - begin,
    }


def table(found: dict[str, Any]) -> str:
    """Format times, overruns and clearances as Markdown, one line per flight."""
    heads = ["filter", "plan, m/s", "tick, ms: mean", "p99", "max", "late, ms: p99", "max"]
    heads += ["overruns", "feasible ticks", "margin, m", "minimum clearance, m", "via point, m", "reached"]
    rows = [
        [
            flight["filter"],
            f"{flight['speed_m_s']:g}",
            *(f"{flight[f'tick_{part}_ms']:.2f}" for part in ("mean", "p99", "max")),
            *(f"{flight[f'lateness_{part}_ms']:.2f}" for part in ("p99", "max")),
            f"{flight['overruns']} of {flight['ticks']}",
            f"{flight['feasible_ticks']} of {flight['filtered_ticks']}",
            f"{flight['margin_m']:g}",
            f"{flight['min_clearance_m']:.3f}",
            f"{flight['via_m']:.2f}{' (missed)' if flight['via_missed'] else ''}",
            "yes" if flight["reached"] else f"NO: {flight['ended_by']}",
        ]
        for flight in found["flights"]
    ]
    lines = [heads, ["---"] * len(heads), *rows, _PUBLISHED]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


OTHERS = "## Both autopilots\n"  # heading of the section that benchmarks/autopilots.py writes
_PREFACE = """# Flights in real time, measured

Look up here how punctual the control loop of `alula fly` is, and how near to obstacles its flights come.
Written by `python benchmarks/fly.py --markdown FILE` on {machine}, Python {python}: `alula fly` at 100 Hz
over MAVLink on loopback against `alula sim-vehicle` in another process, in real time, along a plan through
the built-in room. Ticks are all of a flight, from the checks until the motors stop. A tick overruns when it
ends after the scheduled start of the next one; feasible ticks are those in which the filter's program had a
solution. Clearances are those of the vehicle's true path while set-points were sent, which its simulation
sends only to the judge, to hulls (polytope-cbf) or ellipsoids (cone-backup), less the vehicle's radius of
{radius:g} m; the filter keeps the margin (`--margin`) in addition to the radius.

"""


def main() -> int:
    """Fly everything; return 1 when a flight did not arrive or touched the map, regardless of times."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one flight with each filter, under a minute")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write the table to FILE")
    parser.add_argument("--speeds", type=float, nargs="+", metavar="M_S", help="of plans: 1 2 3, quick 1.5")
    parser.add_argument("--flights", type=int, metavar="N", help="with each filter and speed: 2, quick 1")
    parser.add_argument("--gaussians", type=int, metavar="N", help="of the room: 200,000, quick 30,000")
    parser.add_argument("--voxel", type=float, default=0.1, metavar="M", help="edge of the cover's voxels")
    parser.add_argument("--hulls", type=int, default=150, metavar="N", help="of the cover")
    options = parser.parse_args()
    for name, quick, full in (
        ("speeds", [1.5], [1.0, 2.0, 3.0]),
        ("flights", 1, 2),
        ("gaussians", 30_000, 200_000),
    ):
        if getattr(options, name) is None:
            setattr(options, name, quick if options.quick else full)
    found = run(options)
    if options.markdown is not None:
        page = options.markdown.read_text() if options.markdown.exists() else ""
        kept = page[page.find(OTHERS) - 1 :] if OTHERS in page else ""  # of benchmarks/autopilots.py
        preface = _PREFACE.format(**found, radius=FASTBRIDGE.body.radius_m)
        options.markdown.write_text(preface + table(found) + kept)
    print(json.dumps(found, indent=1) if options.json else table(found).rstrip("\n"))
    return 0 if found["reached"] and found["min_clearance_m"] > 0 else 1


if __name__ == "__main__":
    sys.exit(main())
