"""Attitudes, inputs and moving obstacles of a flight in a log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.log.channels import Safety, State
from alula.schemas.log.foxglove import SceneUpdate, SpherePrimitive, Vector3

_LARGEST = 1e12  # [s], [m], [m/s]; larger values are no measurements, and no figure can show them


@dataclass(frozen=True, slots=True)
class Moving:
    """Moving obstacles at the times of a flight's states.

    Attributes:
        position_world: true positions, shape (n, k, 3) [m].
        track_world: positions by the tracks, NaN beyond the number of tracks, shape (n, k, 3) [m].
        radius_m: of the obstacles, shape (k,) [m].
    """

    position_world: NDArray[np.float64]
    track_world: NDArray[np.float64]
    radius_m: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Commands:
    """Nominal and filtered inputs at the times of the filter's answers.

    Attributes:
        nominal: NaN where unknown, shape (m, 3).
        filtered: NaN where unknown, shape (m, 3).
        quantity: what they are, with the unit.
    """

    nominal: NDArray[np.float64]
    filtered: NDArray[np.float64]
    quantity: str


def attitudes(states: Sequence[State]) -> NDArray[np.float64] | None:
    """Unit quaternions, the one before where a state has none; None when none has."""
    each = [state.attitude for state in states]
    if all(one is None for one in each):
        return None
    found, before = np.empty((len(each), 4)), (1.0, 0.0, 0.0, 0.0)
    for i, one in enumerate(each):
        if one is not None and 0.5 < (square := one.w**2 + one.x**2 + one.y**2 + one.z**2) < 2.0:
            length = square**0.5
            before = (one.w / length, one.x / length, one.y / length, one.z / length)
        found[i] = before
    return found


def moving(each: list[SceneUpdate | None]) -> Moving | None:
    """Spheres of the entities `obstacles` and `tracks`, by state."""
    true = [_spheres(one, "obstacles") for one in each]
    tracks = [_spheres(one, "tracks") for one in each]
    most = max((len(one) for one in true), default=0)
    if most == 0:
        return None
    shape = (len(each), most, 3)
    position, track, radius = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(most)
    for i, (bodies, seen) in enumerate(zip(true, tracks, strict=True)):
        for k, sphere in enumerate(bodies):
            position[i, k] = sphere.pose.position.tuple
            radius[k] = max(radius[k], 0.5 * (sphere.size.x or 0.0))
        for k, sphere in enumerate(seen[:most]):
            track[i, k] = sphere.pose.position.tuple
    return Moving(measured("position", position), measured("position", track), measured("size", radius))


def _spheres(bodies: SceneUpdate | None, name: str) -> list[SpherePrimitive]:
    entities = bodies.entities if bodies is not None else []
    return [sphere for entity in entities if entity.id == name for sphere in entity.spheres]


def _xyz(vector: Vector3 | None) -> tuple[float, float, float]:
    return (np.nan, np.nan, np.nan) if vector is None else vector.tuple


def commands_of(safety: Sequence[Safety]) -> Commands | None:
    """Velocities if one of them is logged, else accelerations; None without either."""
    for quantity, each in (
        ("velocity [m/s]", [(a.u_nom_m_s, a.u_safe_m_s) for a in safety]),
        ("acceleration [m/s²]", [(a.a_nom_m_s2, a.a_safe_m_s2) for a in safety]),
    ):
        if any(safe is not None for _, safe in each):
            nominal, filtered = ([_xyz(pair[k]) for pair in each] for k in (0, 1))
            return Commands(measured("command", nominal), measured("command", filtered), quantity)
    return None


def measured(name: str, values: Any, *, is_known: bool = False) -> NDArray[np.float64]:
    """Convert to an array, None to NaN; raise ValueError for values that are too large or must be known."""
    found = np.array(values, np.float64)
    if is_known and not np.isfinite(found).all():
        raise ValueError(f"a {name} is missing")
    if (np.abs(found) > _LARGEST).any():
        raise ValueError(f"a {name} of {np.nanmax(np.abs(found)):.3g} is too large to be measured")
    return found
