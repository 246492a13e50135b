"""Conversion of latitude, longitude and height to a local frame in metres."""

import json
import os
from math import cos, radians, sin, sqrt
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from alula.schemas.errors import InputError
from alula.stages.alignment.evidence import Positions, match
from alula.stages.alignment.robust import fit_similarity
from alula.stages.alignment.tables import parse_positions, parse_reference
from support.effort import examples

pytest.importorskip("pycolmap")


def ecef(latitude, longitude, height):
    """WGS84: semi-major axis and flattening as the standard defines them."""
    a, f = 6378137.0, 1 / 298.257223563
    e2 = f * (2 - f)
    phi, lam = radians(latitude), radians(longitude)
    n = a / sqrt(1 - e2 * sin(phi) ** 2)
    return np.array(
        [
            (n + height) * cos(phi) * cos(lam),
            (n + height) * cos(phi) * sin(lam),
            (n * (1 - e2) + height) * sin(phi),
        ]
    )


def enu(point, origin):
    phi, lam = radians(origin[0]), radians(origin[1])
    axes = np.array(
        [
            [-sin(lam), cos(lam), 0],
            [-sin(phi) * cos(lam), -sin(phi) * sin(lam), cos(phi)],
            [cos(phi) * cos(lam), cos(phi) * sin(lam), sin(phi)],
        ]
    )
    return axes @ (ecef(*point) - ecef(*origin))


def table(points):
    return "\n".join(["image,lat,lon,alt", *(f"{i},{a!r},{b!r},{c!r}" for i, (a, b, c) in enumerate(points))])


near = st.floats(-0.05, 0.05)


@settings(max_examples=examples(80), deadline=None)
@given(
    st.tuples(st.floats(-89.9, 89.9), st.floats(-179.9, 179.9), st.floats(-400, 8000)),
    st.lists(st.tuples(near, near, st.floats(-500, 500)), min_size=1, max_size=4),
)
def test_positions_are_those_of_the_standard_ellipsoid(origin, steps):
    points = [origin, *((origin[0] + a, origin[1] + b, origin[2] + c) for a, b, c in steps)]
    points = [p for p in points if p[:2] != (0, 0)] or [(1.0, 1.0, 1.0)]
    found = parse_reference(table(points), "t.csv")
    np.testing.assert_allclose(found.position, [enu(p, points[0]) for p in points], atol=2e-6)
    other = parse_reference(table(points), "t.csv", origin)
    np.testing.assert_allclose(other.position, [enu(p, origin) for p in points], atol=2e-6)


def test_the_origin_is_recorded():
    found = parse_reference(table([(41.0, 29.0, 40.0), (41.001, 29.0, 40.0)]), "t.csv")
    facts = found.facts["georeference"]
    assert (facts["origin_lat_deg"], facts["origin_lon_deg"], facts["origin_alt_m"]) == (41.0, 29.0, 40.0)
    assert facts["origin_is"] == "t.csv row 2 (0)"
    np.testing.assert_array_equal(found.position[0], [0, 0, 0])
    assert found.position[1, 1] == pytest.approx(111.06, abs=0.01)  # a millidegree north at latitude 41
    given_ = parse_reference(table([(41.0, 29.0, 40.0)]), "t.csv", (41.0, 29.0, 0.0))
    assert given_.facts["georeference"]["origin_is"] == "given"
    assert given_.position[0, 2] == pytest.approx(40.0)
    assert parse_reference("image,x,y,z\na,1,2,3", "t.csv").facts == {}


@pytest.mark.parametrize(
    ("text", "origin", "message"),
    [
        ("image,lat,lon,alt\na,91,0,0", None, r"t.csv row 2 \(a\): lat is 91, not between -90 and 90"),
        ("image,lat,lon,alt\na,1,2,3\nb,1,181,0", None, r"t.csv row 3 \(b\): lon is 181, not between -180"),
        ("image,lat,lon,alt\na,0,0,0", None, "without a fix"),
        ("image,lat,lon\na,1,2", None, "no column 'alt'"),
        ("image,lat,lon,alt\na,1,nan,0", None, "lon is 'nan', not a finite number"),
        ("image,x,y,z,lat,lon,alt\na,1,2,3,4,5,6", None, "both x,y,z and lat,lon,alt"),
        ("image,x,y,z\na,1,2,3", (1.0, 2.0, 3.0), "--origin is for lat,lon,alt"),
        ("image,lat,lon,alt\na,1,2,1e308", None, "alt is 1e.308, not between -1e.06 and 1e.06 metres"),
    ],
)
def test_wrong_rows_are_refused_by_name(text, origin, message):
    with pytest.raises(InputError, match=message):
        parse_reference(text, "t.csv", origin)


def berlin():
    root = os.environ.get("ALULA_DATA")
    if not root:
        pytest.skip("ALULA_DATA is not set")
    folder = Path(root) / "opensfm-berlin-gps"
    model = json.loads((folder / "reconstruction.json").read_text())[0]
    words = [
        [word.strip() for word in line.split(",")]
        for name in ("records_camera", "records_gnss")
        for line in (folder / f"kapture-{name}.txt").read_text().splitlines()
        if not line.startswith("#")
    ]
    image = {row[0]: row[2] for row in words if len(row) == 3}
    gnss = {image[row[0]]: [float(x) for x in (row[3], row[2], row[4])] for row in words if len(row) > 3}
    return model, gnss, json.loads((folder / "reference_lla.json").read_text())


def test_real_gps_agrees_with_the_local_frame_of_another_program():
    model, gnss, reference = berlin()
    rows = [f"{name},{lat!r},{lon!r},2.0" for name, (lat, lon, _) in gnss.items()]  # it caps heights at 2 m
    origin = reference["latitude"], reference["longitude"], reference["altitude"]
    found = parse_reference("\n".join(["image,lat,lon,alt", *rows]), "gps.csv", origin)
    theirs = [model["shots"][name]["gps_position"] for name in found.names]
    np.testing.assert_allclose(found.position, theirs, atol=1e-3)


def test_real_cameras_are_aligned_by_gps():
    """Three handheld shots: GPS is good to metres, the model to millimetres."""
    model, gnss, reference = berlin()
    centres = []
    for name, shot in model["shots"].items():
        rotation = Rotation.from_rotvec(shot["rotation"])
        centre = -rotation.inv().apply(shot["translation"])
        centres.append(f"{name}," + ",".join(map(repr, centre.tolist())))
    cameras = parse_positions("\n".join(["image,x,y,z", *centres]), "cameras.csv")
    rows = [f"{name},{lat!r},{lon!r},2.0" for name, (lat, lon, _) in gnss.items()]
    origin = reference["latitude"], reference["longitude"], reference["altitude"]
    wanted = parse_reference("\n".join(["image,lat,lon,alt", *rows]), "gps.csv", origin)
    pairs = match(cameras, wanted)
    fit = fit_similarity(pairs.scene, pairs.world, 20.0, 0)
    assert fit.inlier.all()
    assert fit.residual.max() < 5
    low, high = fit.uncertainty.record(fit.similarity)["scale_interval"]
    assert low < 1 < high  # the model was brought to that frame when it was made
    assert isinstance(cameras, Positions)
