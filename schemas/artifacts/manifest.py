"""Manifests: kind, origin, content and guarantee of an artifact."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from alula import __version__
from alula.schemas.artifacts import contents
from alula.schemas.errors import VersionError

VERSION = "1.0"

# Features that a manifest's `requires` may name and that this program supports.
OUTER_POLYTOPES = "outer-polytopes"
SPLAT_LOSS = "splat-loss"
UNPROVEN_PLAN = "unproven-plan"
IMPORTED_MAP = "imported-map"
FEATURES = frozenset({OUTER_POLYTOPES, SPLAT_LOSS, UNPROVEN_PLAN, IMPORTED_MAP})

# Ranges that readers accept: wide enough for everything that the commands write, narrow enough that lengths
# in double precision neither overflow nor lose their sign.
Length = Annotated[float, msgspec.Meta(ge=1e-6, le=1e6)]
Margin = Annotated[float, msgspec.Meta(ge=0, le=1e12)]
Level = Annotated[float, msgspec.Meta(gt=0, le=1e4)]
Count = Annotated[int, msgspec.Meta(ge=1, le=2**32 - 1)]
Fraction = Annotated[float, msgspec.Meta(ge=0, le=1)]
Coordinate = Annotated[float, msgspec.Meta(ge=-contents.LARGEST, le=contents.LARGEST)]
Vector = Annotated[list[Coordinate], msgspec.Meta(min_length=3, max_length=3)]
Index = Annotated[
    list[Annotated[int, msgspec.Meta(ge=-(2**31), le=2**31 - 1)]], msgspec.Meta(min_length=3, max_length=3)
]
Box = Annotated[list[float], msgspec.Meta(min_length=6, max_length=6)]


class Producer(msgspec.Struct, frozen=True):
    """The program that wrote an artifact.

    Attributes:
        name: always "alula".
        version: of the program.
        commit: of its source; "unknown" without one.
    """

    name: str
    version: str
    commit: str


class InputRef(msgspec.Struct, frozen=True, order=True):
    """A file that an artifact was made from.

    Attributes:
        role: what it is to the command, such as "scene".
        schema: its kind; empty for a file that is no artifact.
        version: of its kind; empty for a file that is no artifact.
        sha256: of the whole file.
        name: the file's name without its folder, so that equal content gives equal bytes in every folder; of
            a download its address, without user, password and query.
    """

    role: str
    schema: str
    version: str
    sha256: str
    name: str


class ArraySpec(msgspec.Struct, frozen=True):
    """One array of an artifact.

    Attributes:
        dtype: NumPy type with byte order.
        shape: lengths of the axes.
        frame: the frame of its positions and directions.
        unit: of its values.
        meaning: in words.
        sha256: of the little-endian C-order bytes.
    """

    dtype: str
    shape: list[int]
    frame: str
    unit: str
    meaning: str
    sha256: str


class Guarantee(msgspec.Struct, frozen=True):
    """Guarantee of an artifact.

    Attributes:
        statement: what is guaranteed, in a sentence.
        claims: the same for programs, by name.
    """

    statement: str
    claims: dict[str, Any] = {}


class Similarity(msgspec.Struct, frozen=True):
    """Similarity p_world = scale * rotation @ p_scene + translation_m.

    Attributes:
        scale: metres per unit of the scene.
        rotation: shape (3, 3), row by row, with determinant +1.
        translation_m: of the scene's origin [m].
    """

    scale: Annotated[float, msgspec.Meta(gt=0)]
    rotation: Annotated[list[Vector], msgspec.Meta(min_length=3, max_length=3)]
    translation_m: Vector


class Manifest(msgspec.Struct, frozen=True, kw_only=True):
    """Fields that every artifact has.

    Attributes:
        schema: the kind, such as "alula/cover".
        version: of the kind, MAJOR.MINOR; readers refuse a higher MAJOR.
        producer: the program that wrote it.
        parameters: of the command, defaults included.
        inputs: the files that it was made from.
        frame: the frame of all positions: "scene", or the name of a world frame.
        unit: of lengths: "m", or "arbitrary" before the alignment.
        arrays: type, shape, unit and hash of each array, by its name.
        summary: counts and sizes for people; no reader depends on them.
        seed: of the random numbers; null without any.
        guarantee: what holds for the content; null where nothing does.
        requires: features that a reader must know to use the file safely.
    """

    schema: str
    version: str
    producer: Producer
    parameters: dict[str, Any]
    inputs: list[InputRef]
    frame: str
    unit: str
    arrays: dict[str, ArraySpec]
    summary: dict[str, Any]
    seed: int | None = None
    guarantee: Guarantee | None = None
    requires: list[str] = []


class SceneManifest(Manifest, frozen=True, kw_only=True):
    """Manifest of `alula/scene`.

    An artifact with the array `loss` names it in `requires`: a reader that does not know `loss` must not use
    the ellipsoids as those of the original. `world_from_scene` is None until `scale-align` has run.
    `suggested_inflation_m` then bounds the alignment's position error within the scene's bounds. `source`
    describes the splat file: format, row counts, rows removed by each rule, bounds of the format's own loss.

    Attributes:
        source: the splat file: format, counts, rules that removed rows, losses.
        world_from_scene: the alignment; null until `scale-align` has run.
        alignment: evidence and residuals of the alignment; null without one.
        suggested_inflation_m: bound of the alignment's position error within the scene [m].
    """

    source: dict[str, Any]
    world_from_scene: Similarity | None = None
    alignment: dict[str, Any] | None = None
    suggested_inflation_m: Margin = 0.0

    @property
    def floor_m(self) -> float | None:
        """Height of the floor that the scene was levelled to [m]; None where it was not."""
        level = (self.alignment or {}).get("level")
        return 0.0 if isinstance(level, dict) and level.get("by") == "floor" else None

    def __post_init__(self) -> None:
        """Refuse a loss that older readers would ignore, and entries of a wrong type."""
        if ("loss" in self.arrays) != (SPLAT_LOSS in self.requires):
            raise ValueError("the array `loss` and `requires` do not agree")
        contents.check(self.source, contents.SceneSource, "source")
        contents.check(self.alignment, contents.SceneAlignment, "alignment")


class ImportedMap(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Map without Gaussians that voxels were made from, and what of it is an obstacle.

    Attributes:
        kind: triangles, points, or OctoMap's octree.
        scale: metres per unit of the file.
        up: axis of the file that points up and that became z.
        solid: of a mesh, what it encloses is an obstacle, too.
        unknown: of an octree, what space is that it does not describe, within the box of what it describes.
        map_origin_m: position in metres, with z up, that became the origin of the map.
    """

    kind: Literal["mesh", "cloud", "octree"]
    scale: Annotated[float, msgspec.Meta(gt=0, le=1e9)] = 1.0
    up: Literal["y", "z"] = "z"
    solid: bool = False
    unknown: Literal["free", "occupied"] = "free"
    map_origin_m: Vector = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])


class LevelManifest(Manifest, frozen=True, kw_only=True):
    """Definition of an obstacle on the lattice, shared by voxels and the cover made from them.

    A voxel of edge `voxel_size_m` counts when it touches `crop` and is touched by at least `min_overlap`
    ellipsoids of level `sigma`, grown by `inflation_m`, of Gaussians of at least `min_opacity`. Each
    ellipsoid is also grown by the scene's `loss`, unless `ignore_loss`.

    Where the obstacles are not Gaussians, `imported` says what they are, `sigma` is null, and `requires`
    names this. A voxel then counts when it touches `crop` and at least `min_overlap` triangles or points,
    each grown by `inflation_m`, touch it, or a leaf of an octree shares more than its surface with it.

    Attributes:
        voxel_size_m: edge of a voxel [m].
        sigma: level of the ellipsoids, in standard deviations; null where the obstacles are no ellipsoids.
        min_overlap: minimum number of ellipsoids that touch a voxel that counts.
        inflation_m: radius of the ball added to each ellipsoid [m].
        crop: box XMIN YMIN ZMIN XMAX YMAX ZMAX beyond which nothing counts [m]; null for none.
        min_opacity: minimum opacity of a Gaussian that counts.
        ignore_loss: the ellipsoids were not grown by the loss of the splat file's format.
        imported: the obstacles, where they are no ellipsoids of Gaussians; null where they are.
        floor_m: height of the floor that the scene was levelled to; null where it was not [m].
        map_origin_m: position, in the world that the scene was aligned to, that became the origin of the map;
            null where that is the world's own, and where `imported` has it [m].
    """

    unit: Literal["m"]
    voxel_size_m: Length
    sigma: Level | None
    min_overlap: Count
    inflation_m: Margin = 0.0
    crop: Box | None = None
    min_opacity: Fraction = 0.0
    ignore_loss: bool = False
    imported: ImportedMap | None = None
    floor_m: Coordinate | None = None
    map_origin_m: Vector | None = None

    def __post_init__(self) -> None:
        """Refuse an empty crop, and obstacles that older readers would take for ellipsoids."""
        _check_crop(self.crop)
        if len({self.sigma is None, self.imported is not None, IMPORTED_MAP in self.requires}) != 1:
            raise ValueError("`sigma`, `imported` and `requires` do not agree")


LEVEL = tuple(
    name
    for name in LevelManifest.__struct_fields__
    if name not in Manifest.__struct_fields__ and name not in ("floor_m", "map_origin_m")
)
"""Fields that define an obstacle."""


def level_fields(manifest: LevelManifest) -> dict[str, Any]:
    """Fields that define an obstacle, where it comes from, and what a reader must know of it, for a cover."""
    requires = [need for need in manifest.requires if need == IMPORTED_MAP]
    origin = manifest.made_from if isinstance(manifest, CoverManifest) else manifest.inputs
    further = {"requires": requires, "made_from": origin, "floor_m": manifest.floor_m}
    further["map_origin_m"] = manifest.map_origin_m
    return {name: getattr(manifest, name) for name in LEVEL} | further


def map_origin(manifest: Manifest) -> Vector | None:
    """Position in the world that became the origin of a map [m]; None where it is the world's own origin.

    The world is what a scene was aligned to, or the file of an imported map in metres with z up. Adding the
    position to coordinates of the map gives those of the world.

    Args:
        manifest: of a scene, or of what was made from a scene or an imported map.
    """
    found = None
    if isinstance(manifest, SceneManifest):
        found = (manifest.alignment or {}).get("map_origin_m")
    elif isinstance(manifest, LevelManifest):
        found = manifest.map_origin_m if manifest.imported is None else manifest.imported.map_origin_m
    return list(found) if found is not None and any(found) else None


class VoxelsManifest(LevelManifest, frozen=True, kw_only=True):
    """Manifest of `alula/voxels`: voxel i is the closed cube [i g, (i + 1) g]."""


class SeenManifest(LevelManifest, frozen=True, kw_only=True):
    """Manifest of `alula/seen`: voxels that were taken for free, and why.

    The level is that of the obstacles, none of which a voxel of the file touches. Outside of the box of
    `size` voxels from voxel `lower`, and in all of its voxels that are not listed, nothing is known. A ball
    of `radius_m` around the centres of the voxels `started_from` moves by steps of one voxel along an axis
    until it has touched each voxel of the file, and touches no other voxel.

    Attributes:
        method: whether cameras saw the voxels, or they are the closed space around a point.
        radius_m: of the ball [m].
        lower: lower corner of the box in which anything is known [voxel].
        size: of that box [voxel].
        started_from: the voxels at which the ball started.
    """

    method: Literal["cameras", "reach"]
    radius_m: Length
    lower: Index
    size: Index
    started_from: Annotated[list[Index], msgspec.Meta(min_length=1)]

    def __post_init__(self) -> None:
        """Refuse an empty box, and starts outside of it."""
        super().__post_init__()
        if min(self.size) < 1:
            raise ValueError("`size` has no voxels")
        for start in self.started_from:
            if not all(0 <= i - a < n for i, a, n in zip(start, self.lower, self.size, strict=True)):
                raise ValueError("a voxel of `started_from` lies outside of the box")


class CoverManifest(LevelManifest, frozen=True, kw_only=True):
    """Manifest of `alula/cover`: polytopes {x : normal . x <= offset} in units of voxel_size_m.

    It has the level of the covered voxels, so that a scene can be checked against the cover alone. Since 1.1
    it also names the files of the obstacles, so that a claim about them can be compared with a scene. With
    `polytopes` "hull" the polytopes are the convex hulls of their members. With "outer" they contain these
    hulls: their planes support the hull and include those of its bounding box; `requires` names this too.

    Attributes:
        conservativeness: volume of the polytopes over that of the voxels.
        certificate: what `merge` checked of its own result.
        polytopes: whether they are the convex hulls of their members or contain these.
        made_from: the files that the covered voxels were made from, as their manifest names them; empty
            where it is not known.
    """

    conservativeness: Margin
    certificate: dict[str, Any]
    polytopes: Literal["hull", "outer"] = "hull"
    made_from: list[InputRef] = []

    def __post_init__(self) -> None:
        """Refuse outer polytopes that older readers would use as hulls, and entries of a wrong type."""
        super().__post_init__()
        contents.check(self.certificate, contents.CoverRecord, "certificate")
        if (self.polytopes == "outer") != (OUTER_POLYTOPES in self.requires):
            raise ValueError(f"`polytopes` is {self.polytopes}, but `requires` says otherwise")


_Number = Annotated[int, msgspec.Meta(ge=1, le=1_000_000)]


class PlanPass(msgspec.Struct, frozen=True, kw_only=True):
    """A waypoint or gate of a plan.

    Attributes:
        kind: a point, or a hoop that is flown through along its normal.
        number: of the pass in its lap, from 1.
        lap: from 1.
        time_s: when the plan passes it; of a waypoint where it holds, the beginning of that [s].
        point_m: the waypoint, or the centre of the hoop [m].
        normal: of the hoop, unit length; empty for a waypoint.
        radius_m: of the hoop's opening [m]; 0 for a waypoint.
        tolerance_m: distance within which the waypoint counts as passed [m]; None for that of the flight.
        hold_s: time that the plan stays there [s].
    """

    kind: Literal["waypoint", "gate"]
    number: _Number
    time_s: Margin
    point_m: Vector
    lap: _Number = 1
    normal: list[float] = []
    radius_m: Margin = 0.0
    tolerance_m: float | None = None
    hold_s: Margin = 0.0

    def __post_init__(self) -> None:
        """Refuse a gate without a direction or an opening."""
        if self.kind == "gate" and not (
            len(self.normal) == 3 and 0.99 < sum(c * c for c in self.normal) < 1.01 and self.radius_m > 0
        ):
            raise ValueError("a gate needs a normal of unit length and a radius")
        if self.tolerance_m is not None and not self.tolerance_m > 0:
            raise ValueError("the tolerance of a waypoint must be positive")


class PlanZone(msgspec.Struct, frozen=True, kw_only=True):
    """A box in which the plan keeps a lower top speed.

    Attributes:
        box_m: XMIN YMIN ZMIN XMAX YMAX ZMAX [m].
        speed_m_s: top speed in it [m/s].
    """

    box_m: Annotated[list[Coordinate], msgspec.Meta(min_length=6, max_length=6)]
    speed_m_s: Length


class PlanManifest(Manifest, frozen=True, kw_only=True):
    """Manifest of `alula/plan`: piecewise degree-7 polynomials of local time.

    The plan keeps `radius_m` from all obstacles; `margin_m` of it is beyond the radius of the vehicle that it
    was made for. `via_m` are the points to pass between start and goal, in their order. Since 1.1 `maps` says
    of each map what its obstacles are and which distance (`keep_m`, at least `radius_m`) the plan keeps from
    them, `limits` are the bounds of the motion that hold at every instant, by the names of `Limits`, `method`
    is how the curve was found, and `vehicle` the name of the vehicle. Since 1.2 `passes` lists waypoints and
    gates of all laps in their order, and `via_m` where the curve passes them; `zones` have lower top speeds.
    A plan that `requires` names unproven keeps the limits, but may lead through obstacles; only its start and
    goal keep `radius_m`.

    Attributes:
        radius_m: distance that the plan keeps from all obstacles [m].
        speed_m_s: speed limit of the plan [m/s].
        certificate: what was proven of the curve, with numbers.
        margin_m: part of `radius_m` beyond the radius of the vehicle [m].
        via_m: points to pass between start and goal, in their order [m].
        limits: bounds of the motion at every instant, by name.
        method: how the curve was found.
        vehicle: name of the vehicle that it was made for.
        maps: each map, its obstacles, and the distance that the plan keeps from them.
        passes: waypoints and gates of all laps, in their order.
        zones: boxes with a lower top speed.
        beyond_map_m: distance around the mapped box in which space was taken for free [m].
    """

    unit: Literal["m"]
    radius_m: Length
    speed_m_s: Length
    certificate: dict[str, Any]
    margin_m: Margin = 0.0
    via_m: list[Vector] = []
    limits: dict[str, float] = {}
    method: str = ""
    vehicle: str = ""
    maps: list[dict[str, Any]] = []
    passes: list[PlanPass] = []
    zones: list[PlanZone] = []
    beyond_map_m: Margin = 0.0

    def __post_init__(self) -> None:
        """Refuse points to pass that are none of `passes`, by which flights and proofs are judged."""
        if len(self.via_m) > len(self.passes):
            raise ValueError("`via_m` has more points than `passes`")

    @property
    def is_proven(self) -> bool:
        """True if the plan is proven to keep its distance from the map."""
        return UNPROVEN_PLAN not in self.requires


def _check_crop(crop: list[float] | None) -> None:
    if crop is not None and not all(low < high for low, high in zip(crop[:3], crop[3:], strict=True)):
        raise ValueError("`crop` needs XMIN < XMAX, YMIN < YMAX and ZMIN < ZMAX")


def native_commit() -> str:
    """Commit that the extension module was built from; empty in an editable build."""
    from alula._core import commit

    return commit()


@cache
def producer() -> Producer:
    """This program: its version, and the commit it was built from or runs from.

    A wheel contains its commit. In a checkout the commit comes from git; without either it is 'unknown'.
    """
    commit = native_commit()
    root = Path(__file__).resolve().parents[2]
    if not commit and (root / ".git").exists():  # not the commit of a repository around an installation
        try:
            # `git describe --dirty` would lock the index, and leave the lock where it is killed
            words = ["--no-optional-locks", "status", "--porcelain=v2", "--branch", "--untracked-files=no"]
            done = subprocess.run(
                ["git", "-C", str(root), *words], capture_output=True, text=True, timeout=10, check=True
            )
            found = re.match("# branch.oid ([0-9a-f]{12})", done.stdout)
            is_dirty = re.search("^[^#]", done.stdout, re.MULTILINE) is not None
            commit = found[1] + "-dirty" * is_dirty if found is not None else ""
        except (OSError, subprocess.SubprocessError):
            commit = ""
    return Producer("alula", __version__, commit or "unknown")


def check_known(where: object, name: str, version: str, known: str, requires: Sequence[str]) -> None:
    """Refuse a file of a newer major version, or with features that this program lacks.

    Args:
        where: the file, for the message.
        name: what has the version, with a space behind it, or nothing for the file itself.
        known: version of this program.

    Raises:
        VersionError: it is one.
        ValueError: the version is not MAJOR.MINOR.
    """
    if parse_version(version)[0] > parse_version(known)[0]:
        raise VersionError(f"{where}: {name}version {version} is newer than {known}; update alula")
    if unknown := [feature for feature in requires if feature not in FEATURES]:
        raise VersionError(f"{where}: needs {', '.join(unknown)}, which this version lacks; update alula")


def parse_version(text: str) -> tuple[int, int]:
    """Parse a version string into MAJOR and MINOR.

    Args:
        text: such as "1.0".

    Raises:
        ValueError: the text is not of the form MAJOR.MINOR.
    """
    match = re.fullmatch(r"(\d{1,6})\.(\d{1,6})", text)
    if match is None:
        raise ValueError(f"not a MAJOR.MINOR version: {text!r}")
    return int(match[1]), int(match[2])
