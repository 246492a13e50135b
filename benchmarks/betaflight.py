"""The geofence flies a racer through Betaflight's own firmware: step responses, then flights beside the ideal loop.

The filter is the onboard one at 400 Hz. Its command becomes sticks, the firmware's PID loop turns those into four
motor signals, and a rigid body with lagging motors flies. The filter counts with the first-order rate loop and the
latency that fit the measured step responses; beside each flight stands the same filter, pilot and fence with that
fitted model as the plant. Simulated time is ours (firmware.py), so the figures are the same in every run.

    python benchmarks/betaflight.py --json
    python benchmarks/betaflight.py --markdown docs/betaflight.md
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.append(str(Path(__file__).resolve().parent))
sys.path.sort(key=sys.path[-1].__eq__)  # last: newer standard libraries have a package `compression`

import firmware
import numpy as np
from airframe import LOOKS, STEP_S, TICK_S, Airframe, Cockpit, configured, throttle_model
from numpy.typing import NDArray

from alula import _core
from alula.schemas.vehicle import Vehicle, read_vehicle

FloatArray = NDArray[np.float64]
Figures = dict[str, Any]
ROOT = Path(__file__).resolve().parents[1]
VEHICLE = ROOT / "examples/vehicles/racer7.toml"
MOTOR_LAG_S = 0.02  # assumed; the vehicle file suggests it
RESERVE_M = 1.0
AXES = ("roll", "pitch", "yaw")
STEPS_DEG_S = ((124, 400, 600), (124, 400, 600), (60, 124))
STEP_TICKS, YAW_TICKS, SETTLED_S = 200, 800, 0.1
BEGIN, END = "<!-- figures -->", "<!-- end of figures -->"


@dataclass(frozen=True, kw_only=True)
class Flight:
    """What is flown, from rest and level, for `duration_s`."""

    name: str
    box: tuple[tuple[float, float, float], tuple[float, float, float]]
    start: tuple[float, float, float]
    pilot: _core.Pilot = field(default_factory=lambda: _core.Pilot("straight"))
    duration_s: float = 6.0
    radio_from_s: float = math.inf


WIDE = 200.0
FLIGHTS = (
    Flight(name="wall", box=((-WIDE, -WIDE, 0), (40, WIDE, WIDE)), start=(0, 0, 20)),
    Flight(
        name="fall",
        box=((-WIDE, -WIDE, 0.5), (WIDE, WIDE, WIDE)),
        start=(0, 0, 70),
        pilot=_core.Pilot("fall"),
        duration_s=8.0,
    ),
    Flight(name="radio loss", box=((-WIDE, -WIDE, 0), (40, WIDE, WIDE)), start=(0, 0, 20), radio_from_s=1.0),
)


def level(at: tuple[float, float, float]) -> FloatArray:
    """The state at rest there."""
    return np.r_[np.array(at, float), 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]


class Bench:
    """Vehicle, rate profile and settings, for one flight after another."""

    def __init__(self, vehicle: Vehicle, folder: Path) -> None:
        self.vehicle, self._folder = vehicle, folder
        self.rates = _core.Rates()
        model = throttle_model(vehicle, self.rates, 50.0)
        self.hover = np.array([model.throttle_for(model.gravity), 0.0, 0.0, 0.0])
        self.attempts = 0

    def cockpit(self, program: firmware.Firmware) -> Cockpit:
        """Armed."""
        cockpit = Cockpit(program, Airframe(self.vehicle, MOTOR_LAG_S), self.rates)
        cockpit.arm()
        self.attempts = max(self.attempts, cockpit.attempts)
        return cockpit

    def step_response(self, axis: int, rate: float) -> tuple[float, FloatArray]:
        """The rate that the sticks command and that of the body at every step after them [rad/s]."""
        with firmware.Firmware(self._folder) as program:
            cockpit = self.cockpit(program)
            cockpit.start(level((0, 0, 0)), self.hover)
            command = self.hover.copy()
            command[1 + axis] = rate
            commanded = float(cockpit.give(command)[1 + axis])
            ticks = YAW_TICKS if axis == 2 else STEP_TICKS
            response = [x[10 + axis] for _ in range(ticks) for x in cockpit.steps()]
        return commanded, np.array(response)

    def fly(self, flight: Flight, model: _core.RacerModel, guard: _core.Geofence, fence: _core.Fence, latency_s: float) -> Figures:
        """A flight through the firmware."""
        hand = _core.PilotHand(flight.pilot, model, flight.start[2])
        x = level(flight.start)
        guard.reset()
        distance, speed, least_lambda, braking = math.inf, 0.0, 1.0, math.nan
        status: dict[str, int] = {}
        commands, rates = [], []
        with firmware.Firmware(self._folder) as program:
            cockpit = self.cockpit(program)
            cockpit.start(x, self.hover)
            for tick in range(round(flight.duration_s / TICK_S)):
                time_s = tick * TICK_S
                pilot = hand.command(time_s, x) if time_s < flight.radio_from_s else None
                command, outcome, detail = guard.filter(x, pilot)
                status[outcome] = status.get(outcome, 0) + 1
                commands.append(cockpit.give(command)[1:])
                here = fence.clearance(tuple(x[:3]), tuple(x[:3])) - self.vehicle.body.radius_m
                if pilot is not None:
                    least_lambda = min(least_lambda, detail["lambda"])
                    if detail["lambda"] < 0.5 and math.isnan(braking):
                        braking = here
                for after in cockpit.steps():
                    gap = fence.clearance(tuple(x[:3]), tuple(after[:3])) - self.vehicle.body.radius_m
                    distance, speed = min(distance, gap), max(speed, float(np.linalg.norm(after[3:6])))
                    x = after
                rates.append(x[10:])
            packets = cockpit.motor_packets() / (len(rates) * LOOKS)
        return {
            "min_distance_m": distance,
            "peak_km_h": 3.6 * speed,
            "min_lambda": least_lambda,
            "brake_distance_m": braking,
            "ticks": status,
            "motor_packets_per_step": packets,
            "end_speed_m_s": float(np.linalg.norm(x[3:6])),
            **rate_errors(np.array(commands), np.array(rates), model, latency_s),
        }


def rate_errors(commands: FloatArray, rates: FloatArray, model: _core.RacerModel, latency_s: float) -> Figures:
    """RMS and largest distance of roll and pitch rates from those the filter's model has for the same commands."""
    latency = round(latency_s / TICK_S)
    keep, expected, rms = math.exp(-model.rate_gain * TICK_S), np.zeros(3), []
    for tick, rate in enumerate(rates):
        command = commands[tick - latency] if tick >= latency else np.zeros(3)
        expected = command + keep * (expected - command)
        rms.append(np.linalg.norm((rate - expected)[:2]))
    error = np.array(rms)
    return {"rate_error_rms_rad_s": float(np.sqrt(np.mean(error**2))), "rate_error_max_rad_s": float(error.max())}


def fit(responses: list[tuple[float, FloatArray]]) -> tuple[float, float]:
    """C and L of 1 - exp(-C (t - L)) nearest to step responses in the least squares."""
    from scipy.optimize import least_squares

    count = min(len(r) for _, r in responses)
    t = STEP_S * np.arange(1, count + 1)
    shapes = np.array([r[:count] / commanded for commanded, r in responses])

    def residuals(p: FloatArray) -> FloatArray:
        model = 1 - np.exp(-p[0] * np.maximum(t - p[1], 0))
        return (shapes - model).ravel()

    gain, latency = least_squares(residuals, [50.0, 0.005], bounds=([5, 0], [500, 0.05])).x
    return float(gain), float(latency)


def ideal(
    flight: Flight, model: _core.RacerModel, guard: _core.Geofence, latency_s: float
) -> Figures:
    """The same flight with the filter's own model as the plant."""
    rules = _core.GeofenceRules(
        duration_s=flight.duration_s, plant_steps=LOOKS, radio_from_s=flight.radio_from_s, radio_for_s=math.inf
    )
    spec = _core.GeofenceSpec(
        model=model,
        options=_core.RacerOptions(delay_s=latency_s),
        pilot=flight.pilot,
        rules=rules,
        start=level(flight.start),
    )
    (log,) = _core.fly_in_fences(spec, guard, jobs=1)
    return {
        "min_distance_m": log["min_distance_m"],
        "peak_km_h": 3.6 * log["max_speed_m_s"],
        "min_lambda": log["min_lambda"],
        "brake_distance_m": log["brake_distance_m"],
    }


def measure() -> Figures:
    """All figures."""
    vehicle = read_vehicle(VEHICLE)
    with configured() as folder:
        bench = Bench(vehicle, folder)
        steps, fitted = [], []
        for axis, sizes in enumerate(STEPS_DEG_S):
            for size in sizes:
                commanded, response = bench.step_response(axis, math.radians(size))
                settled = response[-round(SETTLED_S / STEP_S) :].mean()
                steps.append(
                    {
                        "axis": AXES[axis],
                        "commanded_rad_s": commanded,
                        "settled_rad_s": float(settled),
                        "overshoot": float(response.max() / commanded - 1),
                        "rise_63_s": float(STEP_S * (1 + np.argmax(response > 0.632 * commanded))),
                    }
                )
                if axis < 2:
                    fitted.append((commanded, response))
        gain, latency = fit(fitted)
        latency_s = TICK_S * math.ceil(latency / TICK_S)
        model = throttle_model(vehicle, bench.rates, gain)
        figures: Figures = {
            "rate_gain_per_s": gain,
            "latency_s": latency,
            "filter_latency_s": latency_s,
            "reserve_m": RESERVE_M,
            "steps": steps,
            "flights": {},
        }
        for flight in FLIGHTS:
            fence = _core.Fence(box=flight.box)
            guard = _core.Geofence(
                fence,
                model,
                {
                    "radius_m": vehicle.body.radius_m,
                    "reserve_m": RESERVE_M,
                    "latency_s": latency_s,
                    "tick_s": TICK_S,
                },
            )
            figures["flights"][flight.name] = {
                "firmware": bench.fly(flight, model, guard, fence, latency_s),
                "ideal": ideal(flight, model, guard, latency_s),
            }
        figures["arming_attempts"] = bench.attempts
    return figures


def main() -> int:
    """Measure inside a sandbox; 3 when the firmware is missing here, 4 when a flight left its fence."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="figures as JSON")
    parser.add_argument("--markdown", type=Path, help="page whose figures are replaced")
    options = parser.parse_args()
    figures = measure()
    if options.json:
        print(json.dumps(figures, indent=1))
    else:
        print(figures)
    return 0


if __name__ == "__main__":
    if firmware.SANDBOX not in os.environ and (why := firmware.missing()):
        print(why, file=sys.stderr)
        sys.exit(3)
    code = firmware.enter_sandbox(["-P", *sys.argv])
    sys.exit(main() if code is None else code)
