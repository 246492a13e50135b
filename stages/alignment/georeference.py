"""Positions on the Earth to a local frame: x east, y north, z up [m]."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import InputError

GEODETIC = ("lat", "lon", "alt")

Origin = tuple[float, float, float]


def enu_from_geodetic(
    geodetic: FloatArray, rows: Sequence[str], origin: Origin | None = None
) -> tuple[FloatArray, dict[str, Any]]:
    """East, north, up from latitude, longitude and height on the WGS84 ellipsoid.

    The frame is tangent at the origin and rigid: no projection distorts it. Heights above sea level
    instead of the ellipsoid shift it as a whole and tilt it by less than the geoid does, about 1e-4.

    Args:
        geodetic: latitude, longitude [deg], height [m], shape (n, 3).
        rows: where each was read.
        origin: what becomes 0; default: the first row.

    Returns:
        Positions, shape (n, 3) [m], and the origin as a fact for the record.

    Raises:
        InputError: a latitude or longitude is out of range, or a row has the position of no fix.
    """
    for row, (latitude, longitude, height) in zip(rows, geodetic.tolist(), strict=True):
        _check(row, latitude, longitude, height)
        if latitude == 0 and longitude == 0:
            raise InputError(f"{row}: lat 0, lon 0 is what receivers write without a fix")
    if origin is not None:
        _check("--origin", *origin)
    try:
        import pycolmap
    except ImportError as error:
        raise InputError("lat,lon,alt need pycolmap; x,y,z [m] do without it") from error
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
