"""Geofence flights of a racer with Betaflight's firmware in the loop: step responses, flights, ideal plant.

The filter is the onboard one at 400 Hz. Its command becomes sticks, the firmware's PID loop converts them
into four motor signals, and a rigid body with lagging motors flies. The filter's model has the first-order
rate loop and the latency that fit the measured step responses. Each flight is repeated with the same filter,
pilot and fence and that fitted model as the plant. The benchmark controls simulated time (firmware.py), so
the figures are the same in every run.

    python benchmarks/betaflight.py --json
    python benchmarks/betaflight.py --markdown docs/results/betaflight.md
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))  # fence_flights
sys.path.append(str(Path(__file__).resolve().parent))
sys.path.sort(key=sys.path[-1].__eq__)  # last: this file has the name of the package with the firmware

import firmware
import numpy as np
from airframe import IDLE, LOOKS, STEP_S, TICK_S, Airframe, Cockpit, configured, throttle_model
from numpy.typing import NDArray

from alula import _core
from alula.schemas.scenarios.vehicle import Vehicle, read_vehicle
from support.flights.fence_flights import fly_in

FloatArray = NDArray[np.float64]
Figures = dict[str, Any]
Point = tuple[float, float, float]
ROOT = Path(__file__).resolve().parents[1]
VEHICLE = ROOT / "examples/vehicles/racer7.toml"
MOTOR_LAG_S = 0.02  # assumed; the vehicle file suggests it
RESERVE_M = 0.25
AXES = ("roll", "pitch", "yaw")
STEPS_DEG_S = ((124, 400, 600), (124, 400, 600), (60, 124))
STEP_TICKS, YAW_TICKS, SETTLED_S = 200, 800, 0.1
WIDE = 200.0
BEGIN, END = "<!-- measured: benchmarks/betaflight.py --markdown -->\n", "<!-- end -->\n"


@dataclass(frozen=True, kw_only=True)
class Flight:
    """A flight: fence, pilot and start, from rest and level."""

    name: str
    box: tuple[Point, Point]
    start: Point = (0.0, 0.0, 20.0)
    pilot: str = "straight"
    seed: int = 0
    duration_s: float = 6.0
    radio_from_s: float = math.inf
    reserve_m: float = RESERVE_M

    @property
    def state(self) -> FloatArray:
        """Initial state, shape (13,)."""
        return np.r_[np.array(self.start), 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]


BEFORE_A_WALL = ((-WIDE, -WIDE, 0.0), (40.0, WIDE, WIDE))
OVER_A_FLOOR = ((-WIDE, -WIDE, 0.5), (WIDE, WIDE, WIDE))
ROOM = ((-25.0, -25.0, 0.0), (25.0, 25.0, 30.0))


def flights(quick: bool) -> list[Flight]:
    """List the flights; quick: only those with a reserve, and one aggressive pilot."""

    def wall(reserve_m: float) -> Flight:
        return Flight(name="wall", box=BEFORE_A_WALL, reserve_m=reserve_m)

    def fall(reserve_m: float) -> Flight:
        return Flight(
            name="fall", box=OVER_A_FLOOR, start=(0, 0, 70), pilot="fall", duration_s=8, reserve_m=reserve_m
        )

    chosen = [
        wall(RESERVE_M),
        fall(RESERVE_M),
        Flight(name="radio loss", box=BEFORE_A_WALL, radio_from_s=1.3),
    ]
    chosen += [
        Flight(name="aggressive", box=ROOM, start=(0, 0, 15), pilot="aggressive", seed=seed)
        for seed in range(1 if quick else 4)
    ]
    return chosen if quick else [*chosen, wall(0), fall(0)]


class Bench:
    """Vehicle, rate profile and saved settings, for one run of the firmware after another."""

    def __init__(self, vehicle: Vehicle, folder: Path) -> None:
        self.vehicle, self._folder = vehicle, folder
        self.rates = _core.Rates()
        model = throttle_model(vehicle, self.rates, 50.0)
        self.hover = np.array([model.throttle_for(model.gravity), 0.0, 0.0, 0.0])
        self.attempts = 0

    def cockpit(self, program: firmware.Firmware) -> Cockpit:
        """Yield an armed cockpit."""
        cockpit = Cockpit(program, Airframe(self.vehicle, MOTOR_LAG_S), self.rates)
        cockpit.arm()
        self.attempts = max(self.attempts, cockpit.attempts)
        return cockpit

    def step_response(self, axis: int, rate: float) -> tuple[float, FloatArray]:
        """Commanded rate, and the rate of the body at every step after it [rad/s]."""
        with firmware.Firmware(self._folder) as program:
            cockpit = self.cockpit(program)
            cockpit.start(Flight(name="step", box=ROOM).state, self.hover)
            command = self.hover.copy()
            command[1 + axis] = rate
            commanded = float(cockpit.give(command)[1 + axis])
            ticks = YAW_TICKS if axis == 2 else STEP_TICKS
            response = [x[10 + axis] for _ in range(ticks) for x in cockpit.steps()]
        return commanded, np.array(response)

    def fly(self, flight: Flight, model: _core.RacerModel, latency_s: float) -> Figures:
        """Fly with the firmware, and again with the filter's own model as the plant."""
        fence = _core.Fence(box=flight.box)
        radius_m = self.vehicle.body.radius_m
        parameters = {
            "radius_m": radius_m,
            "reserve_m": flight.reserve_m,
            "latency_s": latency_s,
            "tick_s": TICK_S,
        }
        guard = _core.Geofence(fence, model, parameters)
        ideal = fly_ideally(flight, model, guard, latency_s)
        guard.reset()
        hand = _core.PilotHand(_core.Pilot(flight.pilot), model, flight.start[2], seed=flight.seed)
        x, distance, speed, min_lambda, braking = flight.state, math.inf, 0.0, 1.0, math.nan
        outcomes: dict[str, int] = {}
        commands, rates, motors = [], [], []
        with firmware.Firmware(self._folder) as program:
            cockpit = self.cockpit(program)
            cockpit.start(x, self.hover)
            for tick in range(round(flight.duration_s / TICK_S)):
                time_s = tick * TICK_S
                pilot = hand.command(time_s, x) if time_s < flight.radio_from_s else None
                command, outcome, detail = guard.filter(x, pilot)
                outcomes[outcome] = outcomes.get(outcome, 0) + 1
                commands.append(cockpit.give(command)[1:])
                if pilot is not None:
                    min_lambda = min(min_lambda, detail["lambda"])
                    if detail["lambda"] < 0.5 and math.isnan(braking):
                        place, velocity = tuple(x[:3]), tuple(x[3:6])
                        braking = fence.braking_distance(detail["deciding"], place, velocity) - radius_m
                for after in cockpit.steps():
                    distance = min(distance, fence.clearance(tuple(x[:3]), tuple(after[:3])) - radius_m)
                    speed = max(speed, float(np.linalg.norm(after[3:6])))
                    x = after
                rates.append(x[10:])
                motors.append(cockpit.motors)
            packets = cockpit.motor_packets() / (len(rates) * LOOKS)
        flown = summary(distance, speed, min_lambda, braking) | {
            "ticks": outcomes,
            "motor_packets_per_step": packets,
            **rate_errors(np.array(commands), np.array(rates), np.array(motors), model, latency_s),
        }
        return {
            "name": flight.name,
            "seed": flight.seed,
            "reserve_m": flight.reserve_m,
            "firmware": flown,
            "ideal": ideal,
        }


def summary(distance_m: float, speed_m_s: float, min_lambda: float, braking_m: float) -> Figures:
    """Figures that both kinds of flights have."""
    return {
        "min_distance_m": distance_m,
        "peak_km_h": 3.6 * speed_m_s,
        "min_lambda": min_lambda,
        "brake_distance_m": None if math.isnan(braking_m) else braking_m,
    }


def fly_ideally(flight: Flight, model: _core.RacerModel, guard: _core.Geofence, latency_s: float) -> Figures:
    """Fly with the filter's model as the plant: first-order rates, commands delayed by the latency."""
    (log,) = fly_in(
        guard,
        start=flight.state,
        pilot=_core.Pilot(flight.pilot),
        duration_s=flight.duration_s,
        model=model,
        options=_core.RacerOptions(delay_s=latency_s),
        losses=_core.Losses(radio_from_s=flight.radio_from_s, radio_for_s=math.inf),
        plant_steps=LOOKS,
        seed=flight.seed,
        jobs=1,
    )
    return summary(log["min_distance_m"], log["max_speed_m_s"], log["min_lambda"], log["brake_distance_m"])


def rate_errors(
    commands: FloatArray, rates: FloatArray, motors: FloatArray, model: _core.RacerModel, latency_s: float
) -> Figures:
    """Error of the roll and pitch rates against the filter's model under the same commands.

    Apart also where no motor is at a limit, at the end of a tick.
    """
    latency = round(latency_s / TICK_S)
    keep, expected, errors = math.exp(-model.rate_gain * TICK_S), np.zeros(3), []
    for tick, rate in enumerate(rates):
        command = commands[tick - latency] if tick >= latency else np.zeros(3)
        expected = command + keep * (expected - command)
        errors.append(np.linalg.norm((rate - expected)[:2]))
    error = np.array(errors)
    free = ((motors > IDLE + 0.01) & (motors < 0.99)).all(axis=1)
    return {
        "rate_error_rms_rad_s": float(np.sqrt(np.mean(error**2))),
        "rate_error_free_rms_rad_s": float(np.sqrt(np.mean(error[free] ** 2))),
        "rate_error_max_rad_s": float(error.max()),
        "saturated_share": float(1 - free.mean()),
    }


def fit(responses: list[tuple[float, FloatArray]]) -> tuple[float, float]:
    """Least-squares fit of C and L in 1 - exp(-C (t - L)) to step responses."""
    from scipy.optimize import least_squares

    shapes = np.array([response / commanded for commanded, response in responses])
    t = STEP_S * np.arange(1, shapes.shape[1] + 1)

    def residuals(p: FloatArray) -> FloatArray:
        return (shapes - (1 - np.exp(-p[0] * np.maximum(t - p[1], 0)))).ravel()

    gain, latency = least_squares(residuals, [50.0, 0.005], bounds=([5, 0], [500, 0.05])).x
    return float(gain), float(latency)


def measure(quick: bool = False) -> Figures:
    """Measure all figures."""
    vehicle = read_vehicle(VEHICLE)
    made = firmware.program()
    assert made is not None
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
                        "asked_rad_s": math.radians(size),
                        "commanded_rad_s": commanded,
                        "settled_rad_s": float(settled),
                        "overshoot": float(response.max() / commanded - 1),
                        "rise_63_s": float(STEP_S * (1 + np.argmax(response > 0.632 * commanded))),
                    }
                )
                if axis < 2:
                    fitted.append((commanded, response))
        again = bench.step_response(0, math.radians(STEPS_DEG_S[0][0]))
        gain, latency = fit(fitted)
        latency_s = TICK_S * math.ceil(latency / TICK_S)
        model = throttle_model(vehicle, bench.rates, gain)
        return {
            "firmware": made.name,
            "rate_gain_per_s": gain,
            "latency_s": latency,
            "filter_latency_s": latency_s,
            "repeats_bit_by_bit": bool(np.array_equal(again[1], fitted[0][1])),
            "steps": steps,
            "flights": [bench.fly(flight, model, latency_s) for flight in flights(quick)],
            "arming_attempts": bench.attempts,
        }


def tables(figures: Figures) -> str:
    """The figures as Markdown."""
    rows = [
        "| step | commanded | settled | overshoot | 63 % after |",
        "| --- | ---: | ---: | ---: | ---: |",
    ]
    rows += [
        f"| {s['axis']} | {s['commanded_rad_s']:.3f} rad/s | {s['settled_rad_s']:.3f} rad/s "
        f"| {s['overshoot']:.1%} | {1e3 * s['rise_63_s']:.1f} ms |"
        for s in figures["steps"]
    ]
    rows += [
        "",
        f"Fitted to roll and pitch: C = {figures['rate_gain_per_s']:.1f} 1/s after "
        f"{1e3 * figures['latency_s']:.1f} ms; "
        f"the filter's latency is {1e3 * figures['filter_latency_s']:.1f} ms.",
        "",
        "| flight | reserve | minimum distance, firmware | ideal | peak speed, firmware | ideal "
        "| braking from, firmware | ideal | minimum λ | rate error, RMS | with free motors | maximum |",
        "| --- |" + " ---: |" * 11,
    ]
    for flight in figures["flights"]:
        real, ideal = flight["firmware"], flight["ideal"]
        name = flight["name"] + (f" {flight['seed']}" if flight["name"] == "aggressive" else "")
        cells = [
            f"{flight['reserve_m']:.2f} m",
            *(f"{x['min_distance_m']:.3f} m" for x in (real, ideal)),
            *(f"{x['peak_km_h']:.1f} km/h" for x in (real, ideal)),
            *("–" if (d := x["brake_distance_m"]) is None else f"{d:.1f} m" for x in (real, ideal)),
            f"{real['min_lambda']:.2f}",
            f"{real['rate_error_rms_rad_s']:.2f} rad/s",
            f"{real['rate_error_free_rms_rad_s']:.2f} rad/s",
            f"{real['rate_error_max_rad_s']:.2f} rad/s",
        ]
        rows.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(rows) + "\n"


def main() -> int:
    """Measure; return 4 when a flight with a reserve left its fence."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parser.add_argument("--quick", action="store_true", help="fewer flights")
    parser.add_argument("--markdown", type=Path, help="replace the tables of this page")
    chosen = parser.parse_args()
    if firmware.SANDBOX not in os.environ and (why := firmware.missing()):
        print(why, file=sys.stderr)
        return 3
    firmware.enter_sandbox(["-P", *sys.argv])
    try:
        figures = measure(chosen.quick)
    except firmware.FirmwareError as error:
        print(error, file=sys.stderr)
        return 1
    print(json.dumps(figures, indent=2) if chosen.json else tables(figures))
    if chosen.markdown is not None:
        text = chosen.markdown.read_text()
        before, after = text.index(BEGIN) + len(BEGIN), text.index(END)
        chosen.markdown.write_text(text[:before] + tables(figures) + text[after:])
    inside = all(f["firmware"]["min_distance_m"] > 0 for f in figures["flights"] if f["reserve_m"] > 0)
    return 0 if inside else 4


if __name__ == "__main__":
    sys.exit(main())
