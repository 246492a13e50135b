"""Faults in mid-flight on ArduPilot's own simulation: what the vehicle truly does, and what `alula fly` says.

Each flight follows a plan around the corner of a walled corridor behind one filter. At a drawn place of the
plan one fault is made: of the program (killed, stopped), of the vehicle (satellites, estimate, radio,
battery), of the air (wind), by another station (mode, parameter, set-points, orders), or on the network
(floods). From then on the true motion (SIM_STATE at 20 Hz) is judged against the walls until the motors stop,
and the last line and the exit code of `fly` against what is true after this fault. The simulation's world
has no walls, so a contact ends nothing.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import re
import shutil
import signal
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parent))
sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
sys.path.sort(key=lambda path: path in sys.path[-2:])  # last: modules of the same names come first

import numpy as np
from measure import FloatArray
from real_autopilot import INDOORS, FlyProcess, fly_batches, timed, vehicle, with_section
from scipy.spatial import cKDTree

from alula.cli.main import run as alula
from alula.schemas.artifacts.artifact import read_artifact, write_artifact
from alula.schemas.artifacts.kinds import COVER, PLAN
from alula.schemas.log.run import record_path
from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.clearance import hull_obstacles, path_clearance
from alula.stages.compression.hulls import Hulls
from alula.stages.planning.adherence import PlanJudge, via_tolerance
from alula.stages.planning.plan_samples import sample_plan
from alula.stages.vehicles.velocity_lag import stop_time_s

ROOT = Path(__file__).resolve().parents[1]
VEHICLE = ROOT / "examples" / "vehicles" / "arducopter.toml"
HEADING = "## Faults on the real autopilot\n"
# Filters by the set-points that carry their output, and the map that they fly in.
FILTERS = {
    "polytope-cbf": "velocities",
    "cone-di": "accelerations",
    "cone-backup": "body rates",
    "shield": "body rates, shield",
}
MAPS = {"polytope-cbf": "cover", "cone-di": "scene", "cone-backup": "cover", "shield": "cover"}
PLANS = {  # made for what the vehicle follows
    "polytope-cbf": "velocity",
    "cone-di": "acceleration",
    "cone-backup": "body-rates",
    "shield": "body-rates",
}
# A corridor of 2 m with a corner, walls 4 m high, no ceiling and no floor: corners of boxes [0.1 m].
CORRIDOR = [
    ((-20, -14, 0), (70, -10, 40)),
    ((-20, 10, 0), (45, 70, 40)),
    ((65, -10, 0), (69, 70, 40)),
    ((-24, -14, 0), (-20, 14, 40)),
    ((45, 66, 0), (65, 70, 40)),
]
START, VIA, GOAL = (0.0, 0.0, 1.5), (5.0, 0.0, 1.5), (5.5, 5.0, 1.5)
BOUNDS = "-2 -1 1 6.5 6.6 2"
# Of the vehicle and of its simulation before each flight.
WELL = {
    **INDOORS,
    **{"BATT_FS_LOW_ACT": 1, "BATT_LOW_VOLT": 11.5, "BATT_LOW_TIMER": 1, "SIM_BATT_VOLTAGE": 12.6},
    **{"SIM_GPS1_ENABLE": 1, "SIM_GPS1_GLTCH_X": 0, "SIM_RC_FAIL": 0},
    "SIM_ACC1_BIAS_Y": 0,
    **{"SIM_WIND_SPD": 0, "SIM_WIND_T": 1, "SIM_WIND_T_ALT": 0.1},
}
_PART = (0.2, 0.75)  # of the plan's length: where faults happen
_FLIGHT_S, _AFTER_S, _PILOT_S = 150.0, 100.0, 6.0
_STOPPED_S, _FLOOD_S, _FLOOD_HZ, _STATION_S, _STATION_HZ = 3.0, 3.0, 5000.0, 3.0, 10.0
_GOOD, _BAD = 1 | 2 | 4 | 16 | 32, 128 | 1024 | 1 << 15  # flags of EKF_STATUS_REPORT
BLIND_M_S = 1.0  # error of the estimated velocity, from which nothing that relies on it can stop the vehicle
TOUCHED_M = 0.1  # true clearance, where `fly` measures none
LANDED_M = 0.4  # from the plan's end, truly, where `fly` measures more than its limit of 0.5 m
_ATTEMPTS = 2
_TILE_M = 0.1  # between ellipsoids; their union lies at most 0.015 m within the walls' faces
_BATCH = 8  # flights of one vehicle before the next is started
_LATE_S = 0.05  # of a tick, from which the machine is said to have disturbed a flight


@dataclasses.dataclass
class Scene:
    """What a fault acts on.

    Attributes:
        sim: the vehicle, seen by another station.
        fly: the flying program.
        draws: of random numbers.
        toward: unit vector east, north of the motion.
    """

    sim: Any
    fly: FlyProcess
    draws: np.random.Generator
    toward: FloatArray

    def set(self, **parameters: float) -> None:
        """Set parameters of the vehicle."""
        self.sim.set(**parameters)


def kill(scene: Scene) -> None:
    """SIGKILL to the flying program, not to what it started."""
    scene.fly.process.send_signal(signal.SIGKILL)


def stop_and_go(scene: Scene) -> None:
    """SIGSTOP, and SIGCONT after 3 s."""
    scene.fly.process.send_signal(signal.SIGSTOP)
    threading.Timer(_STOPPED_S, scene.fly.process.send_signal, (signal.SIGCONT,)).start()


def wind(speed_m_s: float) -> Callable[[Scene], None]:
    """Wind from a drawn direction."""
    return lambda scene: scene.set(SIM_WIND_DIR=scene.draws.uniform(0, 360), SIM_WIND_SPD=speed_m_s)


def mode(number: int) -> Callable[[Scene], None]:
    """Another mode, by another station, with the throttle stick in the middle."""

    def begin(scene: Scene) -> None:
        scene.sim.sticks(1500)
        time.sleep(0.1)
        scene.sim.command(176, 1, number)

    return begin


def setpoints(scene: Scene) -> None:
    """Velocities of 1 m/s to the left of the motion, from another station at 10 Hz."""
    from alula.stages.sim_vehicle.common.packets import mavlink

    east, north = -scene.toward[1], scene.toward[0]
    message = mavlink.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 1, 0x0DC7, 0, 0, 0, north, east, 0, 0, 0, 0, 0, 0
    )
    _repeat(lambda: scene.sim.send(message))


def orders(scene: Scene) -> None:
    """Orders to disarm, to climb to 10 m and to go 10 m to the left, from another station at 10 Hz."""
    from alula.stages.sim_vehicle.common.packets import mavlink

    here = scene.sim.newest["SIM_STATE"]
    away = 10.0 / 111_320.0 * 1e7
    goto = mavlink.MAVLink_command_int_message(
        1, 1, 6, 192, 0, 0, -1, 1, 0, 0, round(here.lat_int + away), round(here.lon_int - away), here.alt
    )
    turns = (
        lambda: scene.sim.command(400, 0),
        lambda: scene.sim.command(22, 0, 0, 0, 0, 0, 0, 10),
        lambda: scene.sim.send(goto),
    )
    count = iter(range(10_000))
    _repeat(lambda: turns[next(count) % 3]())


def _repeat(act: Callable[[], None]) -> None:
    def work() -> None:
        for _ in range(round(_STATION_S * _STATION_HZ)):
            act()
            time.sleep(1 / _STATION_HZ)

    threading.Thread(target=work, daemon=True).start()


def flood(*, is_valid: bool) -> Callable[[Scene], None]:
    """Messages to the port of the flying program, 5000 a second for 3 s.

    Valid ones claim to be from the vehicle and say that it is disarmed, on the ground, and elsewhere. Of the
    broken ones a third are random bytes, a third have a wrong checksum, and a third are cut. The other
    station sends a tenth of them through the vehicle, which forwards them.
    """

    def begin(scene: Scene) -> None:
        from alula.stages.sim_vehicle.common.packets import mavlink

        writer = mavlink.MAVLink(None, 1, 1)
        well = [
            message.pack(writer)
            for message in (
                mavlink.MAVLink_heartbeat_message(2, 3, 1, 4, 3, 3),
                mavlink.MAVLink_local_position_ned_message(1000, 50, 50, -50, 0, 0, 0),
                mavlink.MAVLink_extended_sys_state_message(0, 1),
                mavlink.MAVLink_statustext_message(2, b"Crash: Disarming"),
            )
        ]
        broken = [
            scene.draws.bytes(64),
            bytes([*well[1][:-1], well[1][-1] ^ 0x55]),
            bytes(well[1][: len(well[1]) // 2]),
        ]
        packets = well if is_valid else broken
        through = mavlink.MAVLink_statustext_message(6, b"Crash: Disarming")

        def work() -> None:
            begun, sent = time.monotonic(), 0
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
                while (now := time.monotonic() - begun) < _FLOOD_S:
                    while sent < now * _FLOOD_HZ:
                        sent += 1
                        line.sendto(packets[sent % len(packets)], ("127.0.0.1", scene.sim.port))
                        if sent % 10 == 0 and is_valid:
                            scene.sim.send(through)
                    time.sleep(0.002)

        threading.Thread(target=work, daemon=True).start()

    return begin


@dataclasses.dataclass(frozen=True)
class Fault:
    """A kind of fault.

    Attributes:
        begin: makes it.
        true: exit codes with what the last line must contain, as regular expressions; any of them is true.
        stops: the vehicle should stop or land; else the flight may go on.
        by_pilot: another station lands the vehicle after 6 s: nothing else ends the flight.
        is_lasting: the vehicle does not forget it, and is started again.
    """

    begin: Callable[[Scene], None]
    true: tuple[tuple[int, str], ...]
    stops: bool = True
    by_pilot: bool = False
    is_lasting: bool = False


FINISHED = (0, "")
AWRY = (4, "the plan was flown, but (?!the vehicle landed away)")  # compared with the truth, see `untrue`
AWAY = (4, "the plan was flown, but the vehicle landed away")  # the same
HELD = (4, "was not finished: (held too often|took too long|motion contradicts|too close)")
TOUCHED = (4, "the flight came closer to the map")  # the same
OWN = "vehicle's own failsafe"
BLIND = (
    (6, "estimator not healthy|position jumped|health no longer reported"),
    (6, f"{OWN} .*(EKF|Dead Reckoning|GPS)"),
    (4, "position jumped|motion contradicts"),
)
PERTURBED = (FINISHED, AWRY, AWAY, HELD, TOUCHED, (4, "fallback for too long|filter has no safe input"))
FAULTS: dict[str, Fault] = {
    "fly killed": Fault(kill, ((-signal.SIGKILL, ""),)),
    "fly stopped for 3 s": Fault(
        stop_and_go, (FINISHED, AWRY, HELD, (6, OWN), (4, "watchdog took over")), stops=True
    ),
    "satellites lost": Fault(lambda scene: scene.set(SIM_GPS1_ENABLE=0), BLIND),
    "satellites 22 m off": Fault(lambda scene: scene.set(SIM_GPS1_GLTCH_X=0.0002), BLIND, is_lasting=True),
    "accelerometer 1 m/s² off": Fault(lambda scene: scene.set(SIM_ACC1_BIAS_Y=1), BLIND, is_lasting=True),
    "radio lost": Fault(lambda scene: scene.set(SIM_RC_FAIL=1), ((6, f"{OWN} .*Radio"),)),
    "battery low": Fault(
        lambda scene: scene.set(SIM_BATT_VOLTAGE=11.2),
        ((6, f"{OWN} .*Battery"), (6, "battery low")),
        is_lasting=True,
    ),
    "wind of 3 m/s": Fault(wind(3.0), PERTURBED, stops=False),
    "wind of 6 m/s": Fault(wind(6.0), PERTURBED, stops=False),
    "mode LOITER": Fault(mode(5), ((4, "mode changed by the pilot"),), by_pilot=True),
    "mode BRAKE": Fault(mode(17), ((4, "mode changed by the pilot"),), by_pilot=True),
    "GUID_OPTIONS 0": Fault(
        lambda scene: scene.set(GUID_OPTIONS=0), ((6, r"parameter changed .*GUID_OPTIONS is 0"),)
    ),
    "another's set-points": Fault(setpoints, PERTURBED, stops=False),
    "another's orders": Fault(orders, PERTURBED, stops=False),
    "flood of valid messages": Fault(flood(is_valid=True), PERTURBED, stops=False),
    "flood of broken messages": Fault(flood(is_valid=False), PERTURBED, stops=False),
}


@dataclasses.dataclass(frozen=True)
class Cell:
    """One flight."""

    fault: str
    name: str
    number: int

    @property
    def key(self) -> str:
        """Name of the flight in the file of results."""
        return f"{self.fault}/{self.name}/{self.number}"

    @property
    def draws(self) -> np.random.Generator:
        """Its random numbers."""
        return np.random.default_rng([*self.key.encode()])


def plan_path(folder: Path, name: str) -> Path:
    """Plan that is flown behind a filter."""
    return folder / f"corridor.{PLANS[name]}.plan.npz"


def velocity_at(path: FloatArray, at_s: float) -> FloatArray:
    """Velocity [m/s] at a time by a line through 0.5 s of a path: time, x, y, z, shape (T, 4)."""
    near = path[np.abs(path[:, 0] - at_s) <= 0.25]
    if len(near) < 3 or np.ptp(near[:, 0]) < 0.1:
        return np.zeros(3)
    velocity: FloatArray = np.polyfit(near[:, 0] - at_s, near[:, 1:], 1)[0]
    return velocity


class Judge:
    """Judges true paths by the corridor's walls, and what was said by the truth."""

    def __init__(self, folder: Path, name: str) -> None:
        vehicle = read_vehicle(VEHICLE)
        self.radius_m, self.following = vehicle.body.radius_m, vehicle.following
        self.plan = read_artifact(plan_path(folder, name), PLAN)
        self.walls = hull_obstacles(Hulls.from_cover(read_artifact(folder / "corridor.cover.npz", COVER)))
        self.course = sample_plan(self.plan, 0.01)
        self.away = cKDTree(self.course)
        gone = np.linalg.norm(np.diff(self.course, axis=0), axis=1).cumsum()
        self.part = np.concatenate([[0.0], gone / gone[-1]])

    def progress(self, position: FloatArray) -> float:
        """Part of the plan's length that a position lies beside."""
        return float(self.part[self.away.query(position)[1]])

    def clearance(self, path: FloatArray) -> float:
        """Least distance of a path from the walls, less the radius [m]."""
        return float(path_clearance(np.ascontiguousarray(path), self.walls).min()) - self.radius_m

    def room_m(self, position: FloatArray, velocity: FloatArray) -> float:
        """Way along a velocity until the vehicle touches a wall; at most 10 m."""
        speed = float(np.linalg.norm(velocity))
        if speed < 0.05:
            return 10.0
        line = position + np.outer(np.arange(0.0, 10.0, 0.02), velocity / speed)
        near = path_clearance(np.ascontiguousarray(line), self.walls) <= self.radius_m
        return float(0.02 * np.argmax(near)) if near.any() else 10.0

    def figures(
        self, path: FloatArray, begun_s: float, estimates: FloatArray | None = None
    ) -> dict[str, Any]:
        """Figures of a true path after a fault.

        Args:
            path: time, x, y, z, world frame, shape (T, 4), from before the fault.
            begun_s: when the fault was made [s].
            estimates: time and the vehicle's estimate of its velocity, shape (E, 4); None if it is true.
        """
        before, after = path[path[:, 0] <= begun_s], path[path[:, 0] >= begun_s - 0.05]
        velocity = velocity_at(path[path[:, 0] <= begun_s + 0.1], begun_s - 0.15)
        speed = float(np.linalg.norm(velocity))
        at, where = before[-1, 1:], after[:, 1:]
        soon = after[after[:, 0] < begun_s + 1.0, 3]
        least = self.clearance(where)
        away = path_clearance(np.ascontiguousarray(where), self.walls) - self.radius_m
        until = after[int(np.argmax(away <= 0) if least <= 0 else np.argmin(away)), 0]  # the first contact
        wrong = 0.0
        for at_s, *claimed in () if estimates is None else estimates:
            if begun_s <= at_s <= until:
                wrong = max(wrong, float(np.linalg.norm(velocity_at(path, at_s)[:2] - claimed[:2])))
        room, needed = self.room_m(at, velocity), speed * stop_time_s(self.following.horizontal_lag, speed)
        return {
            "speed_m_s": speed,
            "room_m": room,
            "needed_m": needed,
            "least_m": least,
            "contact": least <= 0,
            "estimate_off_m_s": wrong,
            "could_stop": room > needed and wrong <= BLIND_M_S,
            "moved_m": float(np.linalg.norm(where[:, :2] - at[:2], axis=1).max()),
            "sank_m": float(at[2] - soon.min()),
            "rose_m": float(where[:, 2].max() - at[2]),
        }

    def strays(self, path: FloatArray) -> bool:
        """Whether a path, shape (T, 3), leaves the tube about the plan or misses its via point."""
        tolerance = via_tolerance(None, self.radius_m)
        found = PlanJudge(self.plan, [self.walls], self.radius_m, tolerance).result(
            np.ascontiguousarray(path)
        )
        return bool(found.outside_m > 0 or found.missed)


def untrue(fault: Fault, row: dict[str, Any]) -> str:
    """Why an outcome is not true; empty if it is.

    Args:
        fault: that was made.
        row: figures of the flight.
    """
    code, said = row["code"], row["said"]
    if code is None:
        return "it did not end"
    if not any(code == one and re.search(words, said) for one, words in fault.true):
        return f"exit code {code}: {said}"
    if code == 0 and row["contact"]:
        return "exit code 0 after a contact"
    if re.search(AWRY[1], said) and not row["strays"]:
        return f"it followed its plan, but: {said}"
    if re.search(TOUCHED[1], said) and not row["least_m"] < TOUCHED_M:
        return f"it came {row['least_m']:.2f} m near, but: {said}"
    if re.search(AWAY[1], said) and not row["from_goal_m"] > LANDED_M:
        return f"it landed {row['from_goal_m']:.2f} m from the plan's end, but: {said}"
    return ""


def make_world(folder: Path) -> None:
    """Write the corridor and the plan around its corner."""
    from support.scenes.small_scenes import ball_scene, box_cover

    write_artifact(folder / "corridor.cover.npz", box_cover(CORRIDOR))
    write_artifact(folder / "corridor.scene.npz", ball_scene(*_tiles()))
    for name, interface in PLANS.items():
        words = ["plan", str(folder / "corridor.cover.npz"), "-o", str(plan_path(folder, name)), "-f", "-q"]
        words += ["--speed", "1", "--vehicle", str(VEHICLE), "--interface", interface, "--bounds", BOUNDS]
        words += ["--beyond-map", "10"]  # there is no floor and no ceiling
        for option, point in (("--start", START), ("--via", VIA), ("--goal", GOAL)):
            words += [option, "{} {} {}".format(*point)]
        if alula(words) != 0:
            raise SystemExit("there is no plan")


def _tiles() -> tuple[FloatArray, FloatArray]:
    """Centres and half-axes [m] of flat ellipsoids just within all upright faces of the walls."""
    centres, axes = [], []
    for corners in 0.1 * np.array(CORRIDOR, np.float64):
        for across in (0, 1):
            grid = [np.arange(low + _TILE_M / 2, high, _TILE_M) for low, high in corners.T]
            for face, inward in zip(corners[:, across], (_TILE_M / 2, -_TILE_M / 2), strict=True):
                grid[across] = np.array([face + inward])
                tiles = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1).reshape(-1, 3)
                half = np.full(3, _TILE_M)
                half[across] = _TILE_M / 2
                centres.append(tiles)
                axes.append(np.tile(half, (len(tiles), 1)))
    return np.concatenate(centres), np.concatenate(axes)


class Grounded(Exception):
    """The vehicle did not take off, or is not ready for the next flight."""


class Matrix:
    """Flies cells; a vehicle that does not recover from a fault is started again."""

    def __init__(self, folder: Path, cells: list[Cell], jobs: int, keep: Path) -> None:
        self.folder, self.keep, self.jobs = folder, keep, jobs
        self.judges = {name: Judge(folder, name) for name in FILTERS}
        lasting = [cell for cell in cells if FAULTS[cell.fault].is_lasting]
        others = [cell for cell in cells if not FAULTS[cell.fault].is_lasting]
        count = max(1, math.ceil(len(others) / _BATCH))
        self.batches = [others[i::count] for i in range(count)] if others else []
        for i, cell in enumerate(lasting):  # the last of a batch
            if i < len(self.batches):
                self.batches[i].append(cell)
            else:
                self.batches.append([cell])
        self.lock = threading.Lock()

    def run(self) -> None:
        """Fly everything."""
        fly_batches(self.batches, self.jobs, self._fly)

    def _fly(self, batch: list[Cell]) -> None:
        left = [(cell, _ATTEMPTS) for cell in batch]
        while left:
            with tempfile.TemporaryDirectory() as name, vehicle(Path(name), WELL) as sim:
                while left:
                    cell, attempts = left.pop(0)
                    try:
                        found = self._flight(Path(name), sim, cell)
                    except Grounded as error:
                        print(f"{cell.key}: {error}", file=sys.stderr, flush=True)
                        if attempts > 1:
                            left.insert(0, (cell, attempts - 1))
                        break
                    with self.lock, self.keep.open("a") as lines:
                        lines.write(json.dumps({"key": cell.key, **found}) + "\n")
                    if FAULTS[cell.fault].is_lasting or found["disarmed_s"] is None:
                        break

    def _flight(self, folder: Path, sim: Any, cell: Cell) -> dict[str, Any]:
        fault, draws = FAULTS[cell.fault], cell.draws
        part = float(draws.uniform(*_PART))
        sim.sticks(1000)
        sim.set(**WELL)
        _await(lambda: not is_armed(sim), 30.0, "it is still armed")
        _await(lambda: len(sim.truth) > 0 and "LOCAL_POSITION_NED" in sim.newest, 60.0, "it is silent")
        _await(lambda: is_well(sim), 120.0, "its estimate is not well")
        here, stood = sim.newest["LOCAL_POSITION_NED"], np.array(sim.truth[-1][1:4])
        base = np.array([*START[:2], 0.0]) - stood
        origin = (here.y - START[0], here.x - START[1], -here.z)
        texts, first = len(sim.texts), len(sim.truth)
        here_map = self.folder / f"corridor.{MAPS[cell.name]}.npz"
        words = [str(plan_path(self.folder, cell.name)), "--map", str(here_map)]
        words += ["--filter", cell.name, "--vehicle", str(VEHICLE), "-f", "-o", str(folder / "f.run.mcap")]
        words += ["--link", f"udpin:127.0.0.1:{sim.port}", "--origin", "{} {} {}".format(*origin)]
        words += ["--stale", "0.4", "--latency", "0.05"]

        def path(since: int = first) -> FloatArray:
            rows = np.array([row[:4] for row in sim.truth[since:]]).reshape(-1, 4)
            return rows + np.array([0.0, *base])

        with FlyProcess(*words) as fly:
            _await(
                lambda: not fly.is_running or fly.has_said("flying the plan"),
                _FLIGHT_S,
                "it did not take off",
            )
            while fly.is_running and self.judges[cell.name].progress(path(len(sim.truth) - 1)[-1, 1:]) < part:
                if time.monotonic() - fly.heard[0][0] > _FLIGHT_S:
                    raise Grounded("it did not reach the place of the fault")
                time.sleep(0.02)
            if not fly.is_running:
                raise Grounded("\n".join(["it ended before the fault", *fly.lines[-4:]]))
            recent = path(len(sim.truth) - 6)
            moved = recent[-1, 1:3] - recent[0, 1:3]
            begun = time.monotonic()
            fault.begin(Scene(sim, fly, draws, moved / max(float(np.linalg.norm(moved)), 1e-9)))
            code, disarmed = self._outcome(sim, fly, fault, begun)
        flown = path()
        heard = timed(fly.heard)
        lines = [line for _, line in heard]
        said = next((line for line in reversed(lines) if line and not line.startswith(" ")), "")
        estimates = np.array(sim.estimates).reshape(-1, 4)
        judge = self.judges[cell.name]
        figures = judge.figures(flown[flown[:, 0] < begun + (disarmed or _AFTER_S)], begun, estimates)
        figures |= {"part": part, "code": code, "said": said, "disarmed_s": disarmed}
        figures["strays"] = judge.strays(_along_the_plan(heard, flown))
        figures["from_goal_m"] = math.dist(flown[-1, 1:3], GOAL[:2])
        figures["late_s"] = _lateness(folder / "f.run.mcap", code)
        if figures["contact"] or untrue(fault, figures) or disarmed is None:
            figures["lines"] = lines[-14:]
            kept = self.keep.parent / cell.key.replace("/", " ")
            np.save(f"{kept}.npy", flown)
            Path(f"{kept}.txt").write_text("\n".join([*lines, "", *sim.texts[texts:]]) + "\n")
            if (folder / "f.run.mcap").exists():
                shutil.copy(folder / "f.run.mcap", f"{kept}.run.mcap")
        return figures

    @staticmethod
    def _outcome(sim: Any, fly: FlyProcess, fault: Fault, begun: float) -> tuple[int | None, float | None]:
        """Exit code, and time from the fault until the motors stopped [s]; None for what did not happen."""
        disarmed, by_pilot = None, not fault.by_pilot
        while (now := time.monotonic() - begun) < _AFTER_S:
            if disarmed is None and now > 0.5 and not is_armed(sim):
                disarmed = now
            if not by_pilot and now > _PILOT_S:
                by_pilot = True
                sim.command(176, 1, 9)  # LAND
            if disarmed is not None and not fly.is_running:
                break
            time.sleep(0.05)
        code = fly.end(10.0)
        if disarmed is None:
            sim.command(176, 1, 9)
        return code, disarmed


def _along_the_plan(heard: list[tuple[float, str]], flown: FloatArray) -> FloatArray:
    """Part of a path, shape (T, 4), in which the plan was flown, by the lines of `fly`; shape (T, 3)."""
    begin = next(at for at, line in heard if "flying the plan" in line)
    end = next((at for at, line in heard if at > begin and ": landing" in line), flown[-1, 0])
    return flown[(flown[:, 0] >= begin) & (flown[:, 0] <= end), 1:]


def is_armed(sim: Any) -> bool:
    """Whether the vehicle's motors are armed."""
    return bool(sim.newest["HEARTBEAT"].base_mode & 128)


def is_well(sim: Any) -> bool:
    """Whether the vehicle's estimate has an absolute position and says of nothing that it is bad."""
    if "EKF_STATUS_REPORT" not in sim.newest:
        return False
    flags = sim.newest["EKF_STATUS_REPORT"].flags
    return flags & _GOOD == _GOOD and not flags & _BAD


def _await(condition: Callable[[], bool], timeout_s: float, why: str) -> None:
    end_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > end_s:
            raise Grounded(why)
        time.sleep(0.05)


def _lateness(log: Path, code: int | None) -> float | None:
    """Largest lateness of a tick [s], as the record says."""
    record = record_path(log)
    if code is None or code < 0 or not record.exists():
        return None
    return float(json.loads(record.read_text())["timing"]["lateness_max_s"])


def table(found: dict[str, dict[str, Any]]) -> str:
    """A row for each fault and kind of set-points: counts, and the worst figures."""
    heads = ["fault", "set-points", "flights", "contacts", "with room to stop", "least clearance, m"]
    heads += ["moved, m", "sank in 1 s, m", "rose, m", "motors stopped after, s", "exit codes", "untrue"]
    lines = [heads, ["---"] * len(heads)]
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for key, row in found.items():
        fault, name, _ = key.rsplit("/", 2)
        groups.setdefault((fault, name), []).append(row)
    order, names = list(FAULTS), list(FILTERS)
    for (fault, name), rows in sorted(
        groups.items(), key=lambda each: (order.index(each[0][0]), names.index(each[0][1]))
    ):
        codes = [str(row["code"]) for row in rows]
        stopped = [row["disarmed_s"] for row in rows if row["disarmed_s"] is not None]
        still = len(rows) - len(stopped)
        stops = FAULTS[fault].stops
        lines.append(
            [
                fault,
                FILTERS[name],
                str(len(rows)),
                str(sum(row["contact"] for row in rows)),
                str(sum(row["contact"] and row["could_stop"] for row in rows)),
                f"{min(row['least_m'] for row in rows):.2f}",
                f"{max(row['moved_m'] for row in rows):.2f}" if stops else "",
                f"{max(row['sank_m'] for row in rows):.2f}",
                f"{max(row['rose_m'] for row in rows):.2f}",
                (f"{max(stopped):.1f}" if stopped else "") + (f" ({still} never)" if still else ""),
                ", ".join(f"{code}: {codes.count(code)}" for code in sorted(set(codes))),
                str(sum(bool(row["untrue"]) for row in rows)),
            ]
        )
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def remarks(found: dict[str, dict[str, Any]]) -> str:
    """Every contact and every untrue outcome, and how often the machine was late."""
    lines = []
    for key, row in sorted(found.items()):
        fault, name, _ = key.rsplit("/", 2)
        what = f"- {fault}, {FILTERS[name]}"
        if row["contact"]:
            lines.append(
                f"{what}: {-row['least_m']:.2f} m into a wall; {row['room_m']:.2f} m ahead of it at "
                f"{row['speed_m_s']:.2f} m/s, where a stop takes {row['needed_m']:.2f} m; its "
                f"estimated velocity was wrong by {row['estimate_off_m_s']:.1f} m/s"
            )
        if row["untrue"]:
            lines.append(f"{what}: {row['untrue']}")
    late = [row["late_s"] for row in found.values() if row["late_s"] is not None and row["late_s"] > _LATE_S]
    if late:
        lines.append(
            f"- {len(late)} of {len(found)} flights had a tick more than {1e3 * _LATE_S:.0f} ms late, "
            f"at most {max(late):.2f} s, the 3 s of a stopped program among them"
        )
    return "\n" + "\n".join(lines) + "\n" if lines else ""


_PREFACE = """
ArduPilot Copter in real time along a plan of 1 m/s around the corner of a walled corridor, 2 m wide, behind
`polytope-cbf` (velocities), `cone-di` (accelerations), `cone-backup` and `shield` (body rates), with
`examples/vehicles/arducopter.toml`. At a drawn place between a fifth and three quarters of the plan the fault
is made by another station or on this machine. From then until the motors stop, at most 100 s, the true motion
is judged: the least distance from the walls less the vehicle's radius (a contact is 0 or less; the landing
itself included), how far it moved horizontally after a fault that ends a flight, and how far it sank within
1 s and rose. A stop was possible where the way ahead to the next wall was longer than the distance in which
the vehicle stops (its speed times the lag of its velocities), and the vehicle's estimate of its velocity was
wrong by at most 1 m/s. Exit codes and last lines of `fly` are compared with those that are true after the
fault. Wind comes from a drawn direction. A mode of another station is ended by it after 6 s, with LAND.
Another's set-points (1 m/s to the left) and orders (disarm, take-off to 10 m, go 10 m to the left) come at
10 Hz for 3 s, and floods with 5000 messages a second for 3 s. Made by:

    ALULA_ARDUCOPTER=.../arducopter python benchmarks/faults.py --flights {flights} \\
      --markdown docs/results/benchmarks-fly.md

"""


def main() -> int:
    """Fly what is missing and print the table; return 1 after a contact with room to stop, or an untruth."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=3, metavar="N", help="of each fault and filter: 3")
    parser.add_argument("--filters", nargs="+", default=list(FILTERS), choices=list(FILTERS))
    parser.add_argument("--faults", nargs="+", default=list(FAULTS), choices=list(FAULTS), metavar="NAME")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="vehicles at once: 2")
    parser.add_argument("--keep", type=Path, default=Path("build/faults"), help="folder of map and results")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the table into this page")
    options = parser.parse_args()
    folder: Path = options.keep
    folder.mkdir(parents=True, exist_ok=True)
    make_world(folder)
    results = folder / "faults.jsonl"
    cells = [
        Cell(fault, name, number)
        for number in range(options.flights)
        for name in options.filters
        for fault in options.faults
    ]
    found = _read(results, cells)
    missing = [cell for cell in cells if cell.key not in found]
    if missing and "ALULA_ARDUCOPTER" in os.environ:
        Matrix(folder, missing, options.jobs, results).run()
    found = _read(results, cells)
    shown = table(found) + remarks(found)
    if options.markdown is not None:
        page = options.markdown.read_text() if options.markdown.exists() else ""
        options.markdown.write_text(
            with_section(page, f"{HEADING}{_PREFACE.format(flights=options.flights)}{shown}")
        )
    print(shown, end="")
    bad = any((row["contact"] and row["could_stop"]) or row["untrue"] for row in found.values())
    return int(bad or len(found) < len(cells))


def _read(results: Path, cells: list[Cell]) -> dict[str, dict[str, Any]]:
    wanted = {cell.key for cell in cells}
    lines = results.read_text().splitlines() if results.exists() else []
    found = {row.pop("key"): row for row in map(json.loads, lines) if row["key"] in wanted}
    for key, row in found.items():
        row["untrue"] = untrue(FAULTS[key.rsplit("/", 2)[0]], row)
    return found


if __name__ == "__main__":
    sys.exit(main())
