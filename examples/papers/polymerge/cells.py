"""The claims of PolyMerge's Tables I and II, made cell by cell from the numbers that they print."""

from __future__ import annotations

from alula.stages.reporting.table import text
from alula.stages.verdict import wilson_interval
from papers.claims import Claim, Row
from papers.published import POLYMERGE_FLIGHTS, POLYMERGE_SCENES, POLYMERGE_SIZES

FLIGHTS_PUBLISHED = 10  # per number of hulls, in Table II
_COLUMNS = {
    "ellipsoids": ("ellipsoids of each scene", [f"{p[0] / 1e6:.2f}M" for p in POLYMERGE_SIZES]),
    "file of the ellipsoids [MB]": (
        "size of the ellipsoids of each scene [MB]",
        [f"{p[1]:.1f}" for p in POLYMERGE_SIZES],
    ),
    "hulls, the same for both": ("hulls of each scene", [f"{p[1]:,}" for p in POLYMERGE_SCENES]),
    "half-planes, surface + CoACD": (
        "half-planes of SuGaR + CoACD in each scene",
        [f"{p[2] // 1000}K" for p in POLYMERGE_SIZES],
    ),
    "file, surface + CoACD [MB]": (
        "size of SuGaR + CoACD of each scene [MB]",
        [f"{p[3]:.1f}" for p in POLYMERGE_SIZES],
    ),
    "half-planes, ours": (
        "half-planes of PolyMerge in each scene",
        [f"{p[2] // 1000}K" for p in POLYMERGE_SCENES],
    ),
    "file, ours [MB]": (
        "size of PolyMerge's hulls of each scene [MB]",
        [f"{p[4]:.1f}" for p in POLYMERGE_SIZES],
    ),
}


def published_interval(success: float) -> tuple[float, float]:
    """Wilson interval of a success that the paper prints, from its ten flights."""
    return wilson_interval(round(FLIGHTS_PUBLISHED * success), FLIGHTS_PUBLISHED)


def _column(name: str, says: str, printed: list[str]) -> Claim:
    scenes = zip(POLYMERGE_SCENES, printed, strict=True)
    row = Row(
        item="Table I",
        quantity=f"column: {name}",
        published=", ".join(f"{scene[0]} {one}" for scene, one in scenes),
        ours="{scenes:{} {}}",
        why="other scenes, of other sizes",
    )
    return Claim(
        name=f"table-1/{name}",
        where="Table I",
        says=says,
        printed=", ".join(printed),
        rows=[row],
        kind="table",
    )


def _of_hulls(n: int, hz: float, success: float, distance: float) -> list[Claim]:
    low, high = published_interval(success)
    flown = Row(
        item="Table II",
        quantity=f"success with {n} hulls [%]",
        published=f"{text(100 * success)} ({text(100 * low)} to {text(100 * high)}, ten flights)",
        ours="{value}",
        interval="{low} to {high}",
        why="{flights!s} random pairs with an obstacle between them, {inside!s} with an end inside the map; "
        "{collided!s} collided, {outside!s} of them from outside the map; the paper's ten pairs are chosen "
        "by hand",
    )
    near = Row(
        item="Table II",
        quantity=f"minimum distance with {n} hulls [m]",
        published=text(distance),
        ours=["{ellipsoids_m} to the ellipsoids", ", {map_m} to 150 hulls"],
        why="{flights!s} flights with both ends outside the map, {outside!s} below the radius of "
        "{radius_m!t} m; the value itself depends on the scene",
    )
    rate = Row(
        item="Table II",
        quantity=f"control rate with {n} hulls [Hz]",
        published=text(hz),
        ours="{hz}",
        why="worst tick of an emulated Cortex-M4 at 168 MHz with 150 hulls of 91 half-planes, which fewer "
        "hulls do not exceed, 2 cycles per instruction (onboard.md); no drone was flown",
    )
    table = [
        ("success", f"success of ten flights with {n} hulls", success, flown),
        ("distance", f"minimum distance to an obstacle with {n} hulls [m]", distance, near),
    ]
    return [
        *(
            Claim(
                name=f"table-2/{n}/{name}",
                where="Table II",
                says=says,
                printed=text(printed),
                rows=[row],
                kind="table",
            )
            for name, says, printed, row in table
        ),
        Claim(
            name=f"table-2/{n}/rate",
            where="section VI-D",
            says=f"control rate on the Crazyflie with {n} hulls [Hz]",
            printed=text(hz),
            rows=[rate],
            how="make bench-onboard",
        ),
    ]


def _in_firmware(n: int, _: float, success: float, distance: float) -> list[Row]:
    low, high = published_interval(success)
    return [
        Row(
            name=f"{n}/success",
            item="Table II, on the Crazyflie",
            quantity=f"success with {n} hulls, by the app in its firmware [%]",
            published=f"{text(100 * success)} ({text(100 * low)} to {text(100 * high)}, ten flights)",
            ours="{value}",
            interval="{low} to {high}",
            why="{flights!s} random pairs from the floor with an obstacle between them, {inside!s} with an "
            "end inside the map; {collided!s} touched, {outside!s} of them from outside the map; the "
            "firmware as a program of the host; the paper's ten pairs are chosen by hand",
        ),
        Row(
            name=f"{n}/distance",
            item="Table II, on the Crazyflie",
            quantity=f"minimum distance with {n} hulls, by the app in its firmware [m]",
            published=text(distance),
            ours=["{ellipsoids_m} to the ellipsoids", ", {map_m} to 150 hulls"],
            why="true motion of {flights!s} flights with both ends outside the map, {outside!s} below the "
            "body's radius of {radius_m!t} m; the app keeps 0.1 m; the value itself depends on the scene",
        ),
    ]


_CRAZYFLIE = Claim(
    name="crazyflie",
    where="section VI-B",
    says="ten pairs for each number of hulls, flown on a Crazyflie 2.1+",
    printed="10 pairs",
    kind="table",
    rows=[
        Row(
            name="hardware",
            item="section VI-B",
            quantity="flights of a Crazyflie 2.1+ under motion capture",
            published="ten pairs for each number of hulls",
            why="no hardware; Table II is flown in simulation, and by the app in the drone's firmware as a "
            "program of the host, at the published rates",
            verdict="not available here",
        ),
        *(row for cells in POLYMERGE_FLIGHTS for row in _in_firmware(*cells)),
    ],
)

POLYMERGE_TABLES = {
    "crazyflie": [_CRAZYFLIE],
    "table-1": [_column(name, *words) for name, words in _COLUMNS.items()],
    "table-2": [claim for row in POLYMERGE_FLIGHTS for claim in _of_hulls(*row)],
}
