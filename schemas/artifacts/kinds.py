"""Artifact kinds that are stored as arrays: names, types, ranges and meanings of their arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from alula.schemas.artifacts.contents import LARGEST
from alula.schemas.artifacts.manifest import (
    VERSION,
    CoverManifest,
    Manifest,
    PlanManifest,
    SceneManifest,
    SeenManifest,
    VoxelsManifest,
)

Rule = Literal[
    "finite",
    "not_negative",
    "positive",
    "unit_interval",
    "unit_norm",
    "starts",
    "strictly_increasing",
    "knots",
    "any",
]


@dataclass(frozen=True, slots=True)
class ArrayRule:
    """One array of a kind.

    Attributes:
        name: name of the array.
        dtype: NumPy type with byte order.
        shape: numbers and names; equal names are equal lengths, "N+1" is one more than "N".
        unit: unit of the values; "frame" is the unit of the manifest.
        meaning: description, for the manifest.
        rule: check of the values.
        indexes: name of the array that the values index along its first axis.
        optional: the array may be missing.
        largest: maximum absolute value, for arrays whose values become lengths of other arrays or sums.
    """

    name: str
    dtype: str
    shape: tuple[int | str, ...]
    unit: str
    meaning: str
    rule: Rule = "any"
    indexes: str | None = None
    optional: bool = False
    largest: float | None = None


@dataclass(frozen=True, slots=True)
class Kind:
    """One artifact kind.

    Attributes:
        name: in manifests.
        suffix: usual suffix of a file.
        manifest: type of the manifest.
        arrays: rules of the arrays.
        version: of the kind.
        folder_suffix: suffix of a folder of parts; empty for a kind without parts.
    """

    name: str
    suffix: str
    manifest: type[Manifest]
    arrays: tuple[ArrayRule, ...]
    version: str = VERSION
    folder_suffix: str = ""


SCENE = Kind(
    "alula/scene",
    ".scene.npz",
    SceneManifest,
    (
        ArrayRule("mean", "<f4", ("N", 3), "frame", "centre of each Gaussian", "finite"),
        ArrayRule("scale", "<f4", ("N", 3), "frame", "one-sigma semi-axes", "positive"),
        ArrayRule("quat_wxyz", "<f4", ("N", 4), "1", "unit quaternion, local to frame", "unit_norm"),
        ArrayRule("opacity", "<f4", ("N",), "1", "alpha", "unit_interval"),
        ArrayRule("color", "|u1", ("N", 3), "1", "base colour, red green blue"),
        ArrayRule(
            "loss",
            "<f4",
            ("N", 3),
            "frame, 1, rad",
            "bounds of the splat format's error: of the centre, of semi-axes relatively, of the rotation",
            "not_negative",
            optional=True,
        ),
    ),
    folder_suffix=".scene",
)

VOXELS = Kind(
    "alula/voxels",
    ".voxels.npz",
    VoxelsManifest,
    (
        ArrayRule(
            "index", "<i4", ("M", 3), "voxel", "lower corner, sorted and unique", "strictly_increasing"
        ),
        ArrayRule("overlap", "<u4", ("M",), "1", "number of ellipsoids that touch the voxel"),
    ),
    folder_suffix=".voxels",
)

SEEN = Kind(
    "alula/seen",
    ".seen.npz",
    SeenManifest,
    (
        ArrayRule(
            "index", "<i4", ("M", 3), "voxel", "lower corner, sorted and unique", "strictly_increasing"
        ),
        ArrayRule("views", "<u2", ("M",), "1", "number of cameras that see the voxel"),
    ),
)

COVER = Kind(
    "alula/cover",
    ".cover.npz",
    CoverManifest,
    (
        ArrayRule("vertex", "<i4", ("V", 3), "voxel", "vertices of all hulls"),
        ArrayRule("vertex_start", "<i8", ("n+1",), "1", "first vertex of each hull", "starts", "vertex"),
        ArrayRule("plane_normal", "<i8", ("F", 3), "1", "outward primitive normals"),
        ArrayRule("plane_offset", "<i8", ("F",), "voxel", "normal . x <= offset"),
        ArrayRule("plane_start", "<i8", ("n+1",), "1", "first plane of each hull", "starts", "plane_normal"),
        ArrayRule("member_index", "<i4", ("W", 3), "voxel", "voxels that each hull was built from"),
        ArrayRule(
            "member_start", "<i8", ("n+1",), "1", "first member of each hull", "starts", "member_index"
        ),
        ArrayRule("history", "<f8", ("H", 3), "1", "merges: left, right, weight [voxels]", "finite"),
    ),
    version="1.1",
    folder_suffix=".cover",
)

LONGEST_PLAN_S = 1e4

PLAN = Kind(
    "alula/plan",
    ".plan.npz",
    PlanManifest,
    (
        ArrayRule(
            "time", "<f8", ("K+1",), "s", "knots, strictly increasing from 0", "knots", largest=LONGEST_PLAN_S
        ),
        ArrayRule(
            "coefficient",
            "<f8",
            ("K", 4, 8),
            "m, rad",
            "x, y, z, yaw: coefficient of (t - t_k)^j",
            "finite",
            largest=LARGEST,
        ),
        ArrayRule(
            "waypoint", "<f8", ("W", 4), "m, rad", "x, y, z, yaw passed through", "finite", largest=1e12
        ),
        ArrayRule(
            "cell_normal",
            "<f8",
            ("R", 3),
            "1",
            "outward unit normals of the corridor",
            "finite",
            optional=True,
        ),
        ArrayRule(
            "cell_offset",
            "<f8",
            ("R",),
            "m",
            "normal . x <= offset in the cell",
            "finite",
            optional=True,
            largest=LARGEST,
        ),
        ArrayRule(
            "cell_start",
            "<i8",
            ("C+1",),
            "1",
            "first plane of each cell",
            "starts",
            "cell_normal",
            optional=True,
        ),
        ArrayRule("piece_cell", "<i8", ("K",), "1", "cell of each piece, -1 if none", optional=True),
    ),
    version="1.2",
)

KINDS: dict[str, Kind] = {kind.name: kind for kind in (SCENE, VOXELS, SEEN, COVER, PLAN)}
