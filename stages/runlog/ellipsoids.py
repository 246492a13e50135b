"""What a log says of a flight among ellipsoids: attitude, rotors, what the filter did, the map as spheres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.artifact import Artifact
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.runlog.writer import logged_ticks
from alula.stages.simulation.ellipsoids.closed_loop import SplatFlown

SHOWN_ELLIPSOIDS = 3000  # of the map, those nearest to the paths
_DECIMALS = 6


@dataclass(frozen=True, slots=True)
class SplatFlightLog:
    """One flight at the log's rate and at its end: rows of `flown` at the ticks `sample`, shape (T,).

    The state is that at the time; what controller and filter said is of the tick that begins then, in the
    last sample of the one before.
    """

    time_s: FloatArray
    position: FloatArray
    state: FloatArray
    flown: dict[str, NDArray[Any]]


_LOGGED = (
    *("a_nominal", "a_command", "a_error", "u_nominal", "u", "rotor_thrust", "margin", "gate_m", "active"),
    *("candidates", "rows", "iterations", "status", "capped", "infeasible", "certified", "saturated"),
)


def decimate(flown: SplatFlown, dt_s: float, rate_hz: float) -> SplatFlightLog:
    """Every so many ticks as the rate says, and the end. `a_error` is the largest since the sample before."""
    steps = len(flown.status)
    sample = logged_ticks(steps, dt_s, rate_hz)
    held = np.minimum(sample, steps - 1)
    rows = {name: getattr(flown, name)[held] for name in _LOGGED}
    rows["a_error"][1:] = np.maximum.reduceat(flown.a_error, sample[:-1])
    rows["a_error"][0] = flown.a_error[0]
    state = flown.state[sample]
    known = np.isfinite(state).all(axis=1)  # a flight that leaves the numbers is refused at once
    return SplatFlightLog(
        time_s=sample[known].astype(np.float64) * dt_s,
        position=state[known, :3],
        state=state[known],
        flown={name: row[known] for name, row in rows.items()},
    )


def state_fields(flight: SplatFlightLog, i: int) -> dict[str, Any]:
    """The fields of `alula.State` beyond trial, time and position."""
    row = flight.state[i]
    return {
        "velocity_m_s": xyz(row[6:9]),
        "attitude": quaternion(row[3:6]),
        "omega_body_rad_s": xyz(row[9:12]),
        "rotor_thrust_n": [number(value) for value in flight.flown["rotor_thrust"][i]],
        "thrust_n": number(flight.flown["u"][i, 0]),
        "torque_body_nm": xyz(flight.flown["u"][i, 1:]),
    }


def safety_fields(flight: SplatFlightLog, i: int) -> dict[str, Any]:
    """The fields of `alula.Safety` beyond trial and time; no margin where no obstacle gives one."""
    row = {name: array[i] for name, array in flight.flown.items()}
    status = FilterStatus(int(row["status"]))
    margin = number(row["margin"])
    return {
        **({} if margin is None else {"margin": margin}),
        "margin_unit": "of the filter's barrier",
        "status": int(status),
        "status_name": status.name.lower(),
        **{name: bool(row[name]) for name in ("infeasible", "certified", "capped", "saturated")},
        **{name: int(row[name]) for name in ("active", "candidates", "rows", "iterations")},
        "gate_m": number(row["gate_m"]),
        "a_nom_m_s2": xyz(row["a_nominal"]),
        "a_safe_m_s2": xyz(row["a_command"]),
        "realisation_error_m_s2": number(row["a_error"]),
        "thrust_nom_n": number(row["u_nominal"][0]),
        "torque_nom_body_nm": xyz(row["u_nominal"][1:]),
    }


def ellipsoid_entity(scene: Artifact, sigma: float, paths: list[FloatArray]) -> dict[str, Any]:
    """Ellipsoids at the level as Foxglove's spheres, those nearest to the paths when there are too many."""
    from scipy.spatial import cKDTree

    mean = np.asarray(scene["mean"], np.float64)
    reach = sigma * np.asarray(scene["scale"], np.float64)
    shown = np.arange(len(mean))
    if len(mean) > SHOWN_ELLIPSOIDS:
        near = cKDTree(np.concatenate(paths)).query(mean)[0] - reach.max(axis=1)
        shown = np.sort(np.argsort(near, kind="stable")[:SHOWN_ELLIPSOIDS])
    spheres = []
    for i in shown:
        w, x, y, z = (number(value) for value in scene["quat_wxyz"][i].astype(np.float64))
        red, green, blue = (round(int(value) / 255, 3) for value in scene["color"][i])
        spheres.append(
            {
                "pose": {"position": xyz(mean[i]), "orientation": {"x": x, "y": y, "z": z, "w": w}},
                "size": xyz(2 * reach[i]),
                "color": {"r": red, "g": green, "b": blue, "a": 0.6},
            }
        )
    return {
        "metadata": [
            {"key": "ellipsoids", "value": str(len(mean))},
            {"key": "shown", "value": str(len(shown))},
        ],
        "spheres": spheres,
    }


def quaternion(sigma: FloatArray) -> dict[str, float]:
    """Foxglove's quaternion, body to world, of Modified Rodrigues Parameters of the body in the world.

    q = (1 - n, 2 sigma) / (1 + n) with n = |sigma|^2 turns the world's axes into the body's.
    """
    n = float(sigma @ sigma)
    x, y, z = (number(2 * value / (1 + n)) for value in sigma)
    return {"x": x or 0.0, "y": y or 0.0, "z": z or 0.0, "w": round((1 - n) / (1 + n), _DECIMALS)}


def number(value: Any) -> float | None:
    """Six digits after the point; None for what is not finite. Adding zero turns -0.0 into 0.0."""
    return round(float(value), _DECIMALS) + 0.0 if np.isfinite(value) else None


def xyz(vector: FloatArray) -> dict[str, Any]:
    """A vector as Foxglove writes it."""
    x, y, z = (number(value) for value in vector)
    return {"x": x, "y": y, "z": z}
