"""Drag of the vehicle in ArduPilot's own simulation, for vehicle files without any."""

from __future__ import annotations

import msgspec

from alula.schemas.scenarios.vehicle import Vehicle

# Force over mass: rotors in hover, linear [1/s], and body, quadratic [1/m]. Upward, its air inflow takes
# thrust from the rotors, too.
_LINEAR_PER_S = (0.242, 0.242, 0.242)
_QUADRATIC_PER_M = (0.034, 0.034, 0.051)


def with_drag(vehicle: Vehicle) -> Vehicle:
    """The vehicle with drag in proportion to its mass, unless its file has drag."""
    table = vehicle.disturbance
    if any(table.linear_drag_n_s_m) or any(table.quadratic_drag_n_s2_m2) or not vehicle.body.mass_kg:
        return vehicle
    x, y, z = (vehicle.body.mass_kg * c for c in _LINEAR_PER_S)
    u, v, w = (vehicle.body.mass_kg * c for c in _QUADRATIC_PER_M)
    changed = msgspec.structs.replace(table, linear_drag_n_s_m=(x, y, z), quadratic_drag_n_s2_m2=(u, v, w))
    return msgspec.structs.replace(vehicle, disturbance=changed)
