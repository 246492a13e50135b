"""Conversion of geodetic positions to a local frame: x east, y north, z up [m]."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import InputError
from alula.schemas.extras import load

GEODETIC = ("lat", "lon", "alt")

Origin = tuple[float, float, float]


def enu_from_geodetic(
    geodetic: FloatArray, rows: Sequence[str], origin: Origin | None = None
) -> tuple[FloatArray, dict[str, Any]]:
    """Convert latitude, longitude and height on the WGS84 ellipsoid to east, north, up.

    The frame is tangent at the origin and rigid: no projection distorts it. Heights above sea level
    instead of the ellipsoid shift it as a whole and tilt it by less than the slope of the geoid, about 1e-4.

    Args:
        geodetic: latitude, longitude [deg], height [m], shape (n, 3).
        rows: file and row of each position, for messages.
        origin: latitude, longitude [deg] and height [m] that become 0; default: the first row.

    Returns:
        Positions, shape (n, 3) [m], and the origin for the alignment's record.

    Raises:
        InputError: a latitude or longitude is out of range, a row has the 0, 0 of a receiver without a fix,
            or pycolmap is not installed.
    """
    for row, (latitude, longitude, height) in zip(rows, geodetic.tolist(), strict=True):
        _check(row, latitude, longitude, height)
        if latitude == 0 and longitude == 0:
            raise InputError(f"{row}: lat 0, lon 0: receivers write this without a fix; remove the row")
    if origin is not None:
        _check("--origin", *origin)
    pycolmap = load("pycolmap")
    latitude, longitude, height = origin or map(float, geodetic[0])
    transform = pycolmap.GPSTransform(pycolmap.GPSTransformEllipsoid.WGS84)
    position = np.asarray(
        transform.ellipsoid_to_enu(np.ascontiguousarray(geodetic), latitude, longitude, height), np.float64
    )
    facts = {
        "axes": "x east, y north, z up",
        "ellipsoid": "WGS84",
        "origin_lat_deg": latitude,
        "origin_lon_deg": longitude,
        "origin_alt_m": height,
        "origin_is": "given" if origin else rows[0],
    }
    return position, {"georeference": facts}


def _check(where: str, latitude: float, longitude: float, height: float) -> None:
    for name, value, limit, unit in (
        ("lat", latitude, 90.0, "degrees"),
        ("lon", longitude, 180.0, "degrees"),
        ("alt", height, 1e6, "metres"),
    ):
        if not abs(value) <= limit:
            raise InputError(f"{where}: {name} is {value:g}, not between -{limit:g} and {limit:g} {unit}")
