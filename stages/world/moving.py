"""Moving obstacles of a scenario as native specifications, with the sensor and the tracker that see them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec

from alula import _core
from alula.schemas.errors import UsageError
from alula.schemas.scenarios.moving import DetectorTable, ObstacleTable, TrackerTable, interval


def moving_spec(
    obstacles: Sequence[ObstacleTable],
    sensor: DetectorTable,
    tracker: TrackerTable,
    *,
    yaw_rate_rad_s: float,
) -> _core.MovingSpec:
    """Make the native obstacles with the sensor that detects them and the tracker.

    Args:
        yaw_rate_rad_s: maximum rate at which the sensor turns [rad/s].

    Raises:
        UsageError: values are inconsistent; the message has the path of their key.
    """
    detector = {key: getattr(sensor, key) for key in DetectorTable.__struct_fields__}
    options = _made(_core.TrackerOptions, msgspec.structs.asdict(tracker), "estimation.tracker")
    _made(_core.Tracker, {"options": options}, "estimation.tracker")  # its constructor checks the options
    try:
        return _core.MovingSpec(
            obstacles=[_obstacle(i, table) for i, table in enumerate(obstacles)],
            radar=_made(_core.RadarOptions, detector, "estimation.sensor"),
            tracker=options,
            yaw_rate_rad_s=yaw_rate_rad_s,
        )
    except ValueError as error:
        raise UsageError(f"`$.estimation.sensor`: {error}") from error


def _obstacle(index: int, table: ObstacleTable) -> _core.ObstacleSpec:
    values = msgspec.structs.asdict(table)
    position = values.pop("position_m")
    for key in ("azimuth_rad", "elevation_rad", "speed_m_s", "heading_rad", "acceleration_m_s2"):
        values[key] = interval(values[key])
    values |= {"kind": values.pop("motion"), "way_points": list(values.pop("way_points_m"))}
    values |= {"is_relative": position is None, "position": position or (0.0, 0.0, 0.0)}
    made: _core.ObstacleSpec = _made(_core.ObstacleSpec, values, f"world.moving[{index}]")
    return made


def _made(native: Any, values: dict[str, Any], where: str) -> Any:
    try:
        return native(**values)
    except ValueError as error:
        raise UsageError(f"`$.{where}`: {error}") from error
