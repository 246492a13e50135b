"""Every table, figure, theorem and printed number of PolyMerge (arXiv 2606.16232)."""

from __future__ import annotations

from alula.stages.reporting.table import text
from papers.claims import Claim, Paper, pytest_of
from papers.published import POLYMERGE_FLIGHTS, POLYMERGE_SCENES, POLYMERGE_SIZES

_COLUMNS = (
    ("ellipsoids", "ellipsoids of each scene", [f"{p[0] / 1e6:.2f}M" for p in POLYMERGE_SIZES]),
    (
        "file of the ellipsoids [MB]",
        "size of the ellipsoids of each scene [MB]",
        [f"{p[1]:.1f}" for p in POLYMERGE_SIZES],
    ),
    ("hulls, the same for both", "hulls of each scene", [f"{p[1]:,}" for p in POLYMERGE_SCENES]),
    (
        "half-planes, surface + CoACD",
        "half-planes of SuGaR + CoACD in each scene",
        [f"{p[2] // 1000}K" for p in POLYMERGE_SIZES],
    ),
    (
        "file, surface + CoACD [MB]",
        "size of SuGaR + CoACD of each scene [MB]",
        [f"{p[3]:.1f}" for p in POLYMERGE_SIZES],
    ),
    (
        "half-planes, ours",
        "half-planes of PolyMerge in each scene",
        [f"{p[2] // 1000}K" for p in POLYMERGE_SCENES],
    ),
    (
        "file, ours [MB]",
        "size of PolyMerge's hulls of each scene [MB]",
        [f"{p[4]:.1f}" for p in POLYMERGE_SIZES],
    ),
)
_ONBOARD = "make bench-onboard"


def _table_1() -> list[Claim]:
    return [
        Claim(
            f"table-1/{row}",
            "Table I",
            says,
            ", ".join(printed),
            (f"Table I | column: {row}",),
            "table",
        )
        for row, says, printed in _COLUMNS
    ]


def _table_2() -> list[Claim]:
    found = []
    for n, hz, success, distance in POLYMERGE_FLIGHTS:
        found += [
            Claim(
                f"table-2/{n}/success",
                "Table II",
                f"success of ten flights with {n} hulls",
                text(success),
                (f"Table II | success with {n} hulls",),
                "table",
            ),
            Claim(
                f"table-2/{n}/distance",
                "Table II",
                f"minimum distance to an obstacle with {n} hulls [m]",
                text(distance),
                (f"Table II | minimum distance with {n} hulls",),
                "table",
            ),
            Claim(
                f"table-2/{n}/rate",
                "section VI-D",
                f"control rate on the Crazyflie with {n} hulls [Hz]",
                text(hz),
                (f"Table II | control rate with {n} hulls",),
                how=_ONBOARD,
            ),
        ]
    return found


POLYMERGE_PAPER = Paper(
    "polymerge",
    "PolyMerge: compressing 3D Gaussian splats with polytope coverings for provably safe "
    "resource-constrained navigation",
    "arXiv 2606.16232",
    "A map of a few convex polytopes that contains every obstacle of a splat is small enough for a "
    "microcontroller, and a drone flies safely and faster with it than among the ellipsoids.",
    "polymerge.md",
    (
        Claim(
            "figures-1-2",
            "Figures 1 and 2",
            "overview and steps of the compression",
            "",
            ("Figures 1 and 2 | ",),
            "figure",
            shows="Drawings: from the splat to voxels, local covers and merged hulls, and to the drone.",
        ),
        Claim(
            "kappa",
            "section III-C",
            "sharpness of the smooth minimum and maximum",
            "κ = 100",
            ("section III-C | setting",),
            "setting",
        ),
        Claim(
            "voxels",
            "section V-A, eqs. 6 to 9",
            "the grid has every voxel that an ellipsoid touches",
            "",
            ("section V-A, eqs. 6 to 9 | ",),
            "theorem",
            pytest_of(
                "tests/unit/compression/test_voxelize.py tests/unit/compression/test_voxelize_exact.py"
            ),
        ),
        Claim(
            "sub-cover",
            "section V-B, eqs. 10 and 11",
            "a greedy weighted set cover makes a sub-cover",
            "",
            ("section V-B, eqs. 10 and 11 | ",),
            "statement",
            pytest_of("tests/unit/compression/test_equations_polymerge.py"),
        ),
        Claim(
            "merging",
            "section V-C, eqs. 12 to 15",
            "merging pairs reduces the number of hulls one by one, down to the budget",
            "",
            ("section V-C, eqs. 12 to 15 | ",),
            "statement",
            pytest_of(
                "tests/unit/compression/test_equations_polymerge.py tests/unit/compression/test_merge.py"
            ),
        ),
        Claim(
            "theorem-1",
            "section V-D, Theorem 1",
            "every cover contains all ellipsoids",
            "",
            ("section V-D, Theorem 1 | ",),
            "theorem",
            pytest_of("tests/unit/compression/test_verify.py"),
        ),
        Claim(
            "simulation",
            "section VI-A",
            "how flights are simulated",
            "100 pairs, Δt = 0.01, 1 % of the distance",
            ("section VI-A | setting",),
            "setting",
        ),
        Claim(
            "clf",
            "section VI-A, eq. 16",
            "the nominal command is that of a control Lyapunov function",
            "",
            ("eq. 16, section VI-B | ",),
            "statement",
            pytest_of("tests/unit/onboard"),
        ),
        Claim(
            "scenes",
            "section VI-A",
            "nine scenes of mip-NeRF360",
            "9, of which 5 outdoors",
            ("Table I, Figures 4 and 5 | the nine", "Table I, Figures 4a and 5 | surface + CoACD"),
            "setting",
        ),
        Claim(
            "sugar",
            "section VI-C",
            "the baseline's mesh is made by SuGaR",
            "",
            ("Table I, Figures 4 and 5 | SuGaR",),
            "setting",
        ),
        Claim(
            "figure-3",
            "Figure 3",
            "with 150 hulls the drone flies through the hoops, with 10 around them",
            "",
            ("Figure 3 | ",),
            "figure",
            shows="A photograph of the scene, and ten flown paths each among 150 and among 10 hulls.",
        ),
        Claim(
            "crazyflie",
            "section VI-B",
            "ten pairs for each number of hulls, flown on a Crazyflie 2.1+",
            "10 pairs",
            ("section VI-B | flights of a Crazyflie",),
            "setting",
        ),
        Claim(
            "flash",
            "section VI-B",
            "the map is stored in the flash memory of the drone",
            "up to 150 hulls",
            ("section VI-B | the map of 150 hulls",),
            "statement",
        ),
        Claim(
            "floaters",
            "section VI-B",
            "voxels touched by few ellipsoids are dropped",
            "fewer than 30",
            ("section VI-B | voxels touched",),
            "setting",
        ),
        *_table_1(),
        Claim(
            "memory-ratio",
            "section VI-D, Table I",
            "hulls need up to ten times less memory than ellipsoids",
            "up to 10×",
            ("Table I | file of the ellipsoids over", "Table I | geometry of the ellipsoids"),
        ),
        Claim(
            "planes-per-hull",
            "Table I",
            "half-planes for each hull",
            "",
            ("Table I | half-planes per hull, ours",),
            "table",
        ),
        Claim(
            "planes-per-part",
            "Table I",
            "half-planes for each part of SuGaR + CoACD",
            "",
            ("Table I | half-planes per hull, surface",),
            "table",
        ),
        Claim(
            "more-planes",
            "section VI-D",
            "PolyMerge's hulls have more half-planes than as many of SuGaR + CoACD",
            "",
            ("Table I | half-planes of ours over",),
        ),
        Claim(
            "bytes-per-plane", "Table I", "bytes for each half-plane", "", ("Table I | bytes per",), "table"
        ),
        Claim(
            "figure-4a-ours",
            "Figure 4a",
            "PolyMerge's hulls contain all occupied voxels",
            "1.0",
            ("Figure 4a | fraction of the occupied voxels",),
            "figure",
            shows="Bars: volume of hulls over that of voxels in nine scenes; the part inside is hatched.",
            figures=("figure-4a",),
        ),
        Claim(
            "figure-4a-coacd",
            "Figure 4a",
            "those of SuGaR + CoACD do not",
            "below 1.0",
            ("Figure 4a | the same, surface + CoACD",),
        ),
        Claim(
            "figure-4a-volume",
            "Figure 4a",
            "volume of the hulls",
            "bars without numbers",
            ("Figure 4a | volume of the hulls",),
        ),
        Claim(
            "figure-4b",
            "Figure 4b",
            "the volume falls with the number of hulls",
            "",
            ("Figure 4b | ",),
            "figure",
            shows="Curves: volume of the hulls over their number, one for each scene.",
            figures=("figure-4b",),
        ),
        Claim(
            "finer",
            "section VI-D",
            "smaller voxels and local covers reduce the volume further",
            "",
            ("section VI-D | smaller voxels",),
            "statement",
        ),
        Claim(
            "figure-5a",
            "Figure 5a, section VI-D",
            "polytopes are about 100 times as fast as ellipsoids",
            "≈ 100×",
            ("Figure 5a | ",),
            "figure",
            shows="Bars: mean time of a simulation on a GPU, three methods in nine scenes.",
            figures=("figure-5",),
        ),
        Claim(
            "figure-5b",
            "Figure 5b",
            "PolyMerge has the highest success rate",
            "",
            ("Figure 5b | ",),
            "figure",
            shows="Bars: fraction of 100 pairs that reach the goal, three methods in nine scenes.",
            figures=("figure-5",),
        ),
        Claim(
            "figure-5c",
            "Figure 5c",
            "PolyMerge has the shortest paths",
            "",
            ("Figure 5c | ",),
            "figure",
            shows="Bars: length of the paths over those of PolyMerge, where all methods succeed.",
            figures=("figure-5",),
        ),
        Claim(
            "tolerance",
            "section VI-D",
            "a flight succeeds that comes near its goal",
            "5 cm",
            ("section VI-D | setting",),
            "setting",
        ),
        *_table_2(),
        Claim(
            "trend",
            "section VI-D, Table II",
            "with more hulls the drone flies closer to obstacles",
            "0.268 to 0.097 m",
            ("Table II | the distance falls",),
            "table",
        ),
    ),
)
