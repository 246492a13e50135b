"""Artifacts in parts: a folder of ordinary artifacts with an index that describes the whole.

A folder such as `city.scene/` holds `index.json` and the files that it lists. Each part is an ordinary
artifact of the same kind. The index holds the manifest that the whole would have as one file, and of each
part its hash, its number of elements and its box. A file, or an artifact in memory, is an artifact of one
part.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from alula.schemas.artifacts.artifact import Artifact, file_hash, read_artifact, read_manifest
from alula.schemas.artifacts.kinds import COVER, KINDS, SCENE, VOXELS, Kind
from alula.schemas.artifacts.manifest import (
    ArraySpec,
    Index,
    Manifest,
    Margin,
    Vector,
    check_known,
)
from alula.schemas.decode import MalformedError, convert, decode_json
from alula.schemas.errors import ArtifactError, DamagedError, InputError, WrongKindError
from alula.schemas.files import read_small

PARTS_SCHEMA = "alula/parts"
PARTS_VERSION = "1.0"
INDEX = "index.json"
PARTED = {kind.name: kind for kind in KINDS.values() if kind.folder_suffix}
INDEX_LIMIT = 2**26  # [B]
_ROUNDING = 1e-12  # relative; more than the rounding of a box's corners

Hash = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]
_Count = Annotated[int, msgspec.Meta(ge=1, le=2**48)]


class PartRef(msgspec.Struct, frozen=True, kw_only=True):
    """One part of an artifact in parts.

    Attributes:
        file: name in the folder.
        sha256: of the file.
        bytes: length of the file.
        count: number of Gaussians, voxels or hulls.
        lower: lower corner of the box of the voxels or hulls; of a scene, of the centres, grown by the
            maximum loss of a position. Frame and unit of the whole.
        upper: upper corner.
        reach: of a scene, the maximum one-sigma semi-axis, grown by the loss of scale and rotation; else 0.
            The k-sigma ellipsoids, grown by r, lie in the box grown by k reach + r.
        domain: of voxels, the lowest and the highest voxel of a region: the part has all of the whole's
            voxels there, and no other; of a cover, the hulls have these voxels as members and lie there.
            None where there is no such region.
    """

    file: Annotated[str, msgspec.Meta(pattern=r"^part-[0-9][0-9-]{0,79}\.(scene|voxels|cover)\.npz$")]
    sha256: Hash
    bytes: _Count
    count: _Count
    lower: Vector
    upper: Vector
    reach: Margin = 0.0
    domain: Annotated[list[Index], msgspec.Meta(min_length=2, max_length=2)] | None = None

    def __post_init__(self) -> None:
        """Refuse an empty box or domain."""
        if not all(low <= high for low, high in zip(self.lower, self.upper, strict=True)):
            raise ValueError("`lower` is above `upper`")
        if self.domain is not None and not all(a <= b for a, b in zip(*self.domain, strict=True)):
            raise ValueError("`domain` is empty")


_UNKNOWN = PartRef(
    file="part-0.scene.npz", sha256="0" * 64, bytes=1, count=1, lower=[0.0] * 3, upper=[0.0] * 3
)


class PartsIndex(msgspec.Struct, frozen=True, kw_only=True):
    """Contents of `index.json`.

    Attributes:
        schema: `alula/parts`.
        version: of this format.
        of: kind of the whole and of each part.
        sha256: of the text of the file with the value of this key replaced by an empty one.
        whole: manifest of the whole, as one file would have it. The hash of an array there is the SHA-256 of
            the hexadecimal hashes of that array in all parts, one after the other, without a separator.
        parts: in their order.
        requires: features that a reader must support.
    """

    schema: Literal["alula/parts"]
    version: str
    of: Literal["alula/scene", "alula/voxels", "alula/cover"]
    sha256: Hash
    whole: dict[str, Any]
    parts: Annotated[list[PartRef], msgspec.Meta(min_length=1, max_length=2**18)]
    requires: list[str] = []


class _Head(msgspec.Struct):
    schema: str
    version: str
    sha256: str = ""
    requires: list[str] = []


class Parts:
    """An artifact of one or several parts, which are read one at a time.

    A part of a folder is checked against its hash, its manifest and the index when it is read for the first
    time.

    Attributes:
        path: folder or file.
        kind: of the whole and of each part.
        manifest: of the whole.
    """

    def __init__(
        self,
        path: Path,
        kind: Kind,
        manifest: Manifest,
        refs: Sequence[PartRef],
        single: Artifact | None = None,
    ) -> None:
        self.path, self.kind, self.manifest = path, kind, manifest
        self._refs, self._single = tuple(refs), single
        self._checked: set[int] = set()

    @classmethod
    def of(cls, artifact: Artifact, path: Path = Path()) -> Parts:
        """An artifact as one part."""
        return cls(path, artifact.kind, artifact.manifest, (), artifact)

    @property
    def refs(self) -> tuple[PartRef, ...]:
        """References of the parts, in their order; that of an only part is made when it is asked for.

        Raises:
            WrongKindError: the artifact is neither scene, voxels nor cover.
            ArtifactError: it has no elements.
        """
        if self._single is not None and not self._refs:
            if self.kind.name not in PARTED:
                raise WrongKindError(f"{self.path}: is {self.manifest.schema}, which has no parts")
            if count_of(self._single) == 0:
                raise ArtifactError(f"{self.path}: is empty: it has no elements")
            self._refs = (described(self._single, _UNKNOWN),)
        return self._refs

    def __len__(self) -> int:
        return len(self._refs) if self._single is None else 1

    def __iter__(self) -> Iterator[Artifact]:
        return (self[number] for number in range(len(self)))

    def __getitem__(self, number: int) -> Artifact:
        """Read a part; nothing is kept, so memory holds the parts that the caller holds.

        Raises:
            DamagedError: the part is not the one that the index describes.
            InputError: it cannot be read.
        """
        if self._single is not None:
            return (self._single,)[number]
        ref, path = self.refs[number], self.file(number)
        if number in self._checked:
            return read_artifact(path, self.kind, is_checked=True)
        if file_hash(path) != ref.sha256:
            raise DamagedError(f"{path}: does not match its SHA-256 in {INDEX}")
        part = read_artifact(path, self.kind)
        if described(part, ref) != ref:
            raise DamagedError(f"{path}: its count or box is not that of {INDEX}")
        if ref.domain is not None and not _within(part, ref.domain):
            raise DamagedError(f"{path}: has voxels outside of its domain in {INDEX}")
        for name in ("frame", "unit"):
            if getattr(part.manifest, name) != getattr(self.manifest, name):
                raise DamagedError(f"{path}: its {name} is not that of {INDEX}")
        self._checked.add(number)
        return part

    @property
    def count(self) -> int:
        """Number of Gaussians, voxels or hulls of the whole."""
        return sum(ref.count for ref in self.refs)

    @property
    def is_folder(self) -> bool:
        """Whether the artifact is a folder of parts."""
        return self._single is None

    def file(self, number: int) -> Path:
        """Path of a part."""
        return self.path if self._single is not None else self.path / self.refs[number].file

    def touching(
        self, lower: Sequence[float], upper: Sequence[float], *, sigma: float = 0.0, inflation: float = 0.0
    ) -> list[int]:
        """Numbers of the parts whose content may touch a box; no part that touches it is left out.

        The only part is always among them.

        Args:
            lower: corner of the box, frame and unit of the whole.
            sigma: level k of the ellipsoids of a scene.
            inflation: radius of the ball that is added to each.
        """
        if self._single is not None:
            return [0]
        found = []
        for number, ref in enumerate(self.refs):
            margin = sigma * ref.reach + inflation
            slack = _ROUNDING * (margin + max(map(abs, (*ref.lower, *ref.upper, *lower, *upper))))
            near = zip(ref.lower, ref.upper, lower, upper, strict=True)
            if all(a - margin - slack <= d and c <= b + margin + slack for a, b, c, d in near):
                found.append(number)
        return found

    def check(self) -> None:
        """Read and check every part, and the hashes of the whole.

        Raises:
            DamagedError, InputError: a part is missing, damaged or of another artifact.
        """
        manifests = [part.manifest for part in self]
        if self.is_folder and whole_arrays(self.kind, manifests) != self.manifest.arrays:
            raise DamagedError(f"{self.path}: the arrays of the parts are not those of {INDEX}")


def count_of(artifact: Artifact) -> int:
    """Number of Gaussians, voxels or hulls.

    Args:
        artifact: a scene, voxels or a cover.
    """
    return _rows(artifact.kind, artifact.manifest.arrays)


def _main(kind: Kind) -> str:
    """Array of a kind that has one row per element; the hulls of a cover have one row more."""
    return {SCENE.name: "mean", VOXELS.name: "index", COVER.name: "vertex_start"}[kind.name]


def _rows(kind: Kind, arrays: dict[str, ArraySpec]) -> int:
    return arrays[_main(kind)].shape[0] - (kind is COVER)


def described(artifact: Artifact, ref: PartRef) -> PartRef:
    """Reference with the count, the box and the reach of an artifact.

    Args:
        artifact: a scene, voxels or a cover that is not empty.
        ref: with the name, the hash, the length and the domain.
    """
    kind, reach = artifact.kind, 0.0
    if kind is SCENE:
        mean, scale = artifact["mean"], artifact["scale"]
        lower, upper = mean.min(axis=0).astype(np.float64), mean.max(axis=0).astype(np.float64)
        reach = float(scale.max())
        if "loss" in artifact.arrays:
            moved, grown, turned = artifact["loss"].max(axis=0).astype(np.float64)
            lower, upper = np.nextafter(lower - moved, -np.inf), np.nextafter(upper + moved, np.inf)
            reach *= (1 + grown) * (1 + turned) * (1 + _ROUNDING)
    else:
        size = float(artifact.manifest.voxel_size_m)  # type: ignore[attr-defined]
        rows, extent = (artifact["index"], 1) if kind is VOXELS else (artifact["vertex"], 0)
        lower = np.nextafter(rows.min(axis=0) * size, -np.inf)
        upper = np.nextafter((rows.max(axis=0).astype(np.float64) + extent) * size, np.inf)
    return msgspec.structs.replace(
        ref, count=count_of(artifact), lower=lower.tolist(), upper=upper.tolist(), reach=float(reach)
    )


def _within(part: Artifact, domain: Sequence[Sequence[int]]) -> bool:
    index = part.arrays.get("index", np.zeros((0, 3), np.int32))
    return bool((index >= domain[0]).all() and (index <= domain[1]).all())


def whole_arrays(kind: Kind, manifests: Sequence[Manifest]) -> dict[str, ArraySpec]:
    """Arrays of the whole, from the manifests of its parts; see `PartsIndex.whole`."""
    whole = {}
    for rule in kind.arrays:
        specs = [manifest.arrays[rule.name] for manifest in manifests if rule.name in manifest.arrays]
        if not specs:
            continue
        rows = sum(spec.shape[0] for spec in specs)
        if rule.rule == "starts":
            rows -= len(specs) - 1
        elif rule.optional:  # rows of a part without the array have the value 0
            rows = sum(_rows(kind, manifest.arrays) for manifest in manifests)
        digest = hashlib.sha256("".join(spec.sha256 for spec in specs).encode()).hexdigest()
        whole[rule.name] = msgspec.structs.replace(specs[0], shape=[rows, *specs[0].shape[1:]], sha256=digest)
    return whole


def is_parts(path: Path) -> bool:
    """Test whether a path is a folder with an index of parts, without reading it."""
    return (path / INDEX).is_file()


def encode_index(of: Kind, whole: Manifest, parts: Sequence[PartRef], requires: Sequence[str] = ()) -> bytes:
    """Text of `index.json`, with its own hash."""
    index = {
        "schema": PARTS_SCHEMA,
        "version": PARTS_VERSION,
        "of": of.name,
        "sha256": "",
        "whole": whole,
        "parts": list(parts),
        "requires": list(requires),
    }
    raw = msgspec.json.format(msgspec.json.encode(index, order="sorted"), indent=2) + b"\n"
    return raw.replace(
        b'\n  "sha256": ""', b'\n  "sha256": "%s"' % hashlib.sha256(raw).hexdigest().encode(), 1
    )


def open_parts(path: Path, kind: Kind | None = None) -> Parts:
    """Open an artifact of any number of parts; see `Parts`.

    Args:
        kind: the required kind; None for any.

    Raises:
        WrongKindError: the artifact is of another kind.
        VersionError: its major version is higher, or it requires a feature that this program lacks.
        DamagedError: the index is damaged, or a part is missing or not listed; for a file as `read_artifact`.
        InputError: it cannot be read at all.
    """
    if path.is_dir():
        return _open_folder(path, kind)
    return Parts.of(read_artifact(path, kind), path)


def manifest_of(path: Path) -> Manifest:
    """Manifest of an artifact, of the whole where it is in parts; neither arrays nor parts are read.

    Raises:
        ArtifactError, InputError: as `open_parts`.
    """
    return _open_folder(path, None).manifest if path.is_dir() else read_manifest(path)


def _open_folder(path: Path, kind: Kind | None) -> Parts:
    if not is_parts(path):
        raise InputError(f"{path}: is a folder without {INDEX}, not an artifact in parts")
    at = path / INDEX
    raw = read_small(at, INDEX_LIMIT)
    index, found = _decoded(at, raw)
    if kind is not None and found is not kind:
        raise WrongKindError(f"{path}: is {found.name}, but {kind.name} is needed")
    try:
        whole = convert(index.whole, found.manifest)
        _check_whole(found, index, whole)
    except ValueError as error:
        raise DamagedError(f"{at}: is not valid ({error})") from error
    for ref in index.parts:
        if not (path / ref.file).is_file():
            raise DamagedError(f"{path}: {ref.file} is missing")
        if (path / ref.file).stat().st_size != ref.bytes:
            raise DamagedError(f"{path}: {ref.file} is not {ref.bytes} bytes long, as {INDEX} says")
    listed = {ref.file for ref in index.parts}
    if foreign := sorted(file.name for file in path.glob("part-*") if file.name not in listed):
        raise DamagedError(f"{path}: {foreign[0]!r} is no part of the whole: {INDEX} does not list it")
    return Parts(path, found, whole, index.parts)


def _decoded(at: Path, raw: bytes) -> tuple[PartsIndex, Kind]:
    """Index and kind of the whole, after the checks of its version and its hash."""
    try:
        head = decode_json(raw, _Head)
        if head.schema != PARTS_SCHEMA:
            raise WrongKindError(f"{at}: is {head.schema!r}, not {PARTS_SCHEMA}")
        check_known(at, "", head.version, PARTS_VERSION, head.requires)
        mark = b'\n  "sha256": "%s"' % head.sha256.encode()
        if (
            raw.count(mark) != 1
            or hashlib.sha256(raw.replace(mark, b'\n  "sha256": ""')).hexdigest() != head.sha256
        ):
            raise DamagedError(f"{at}: does not match its own SHA-256")
        index = decode_json(raw, PartsIndex)
        kind = PARTED[index.of]
        inner = convert(index.whole, _Head)
        check_known(at, f"{kind.name} ", inner.version, kind.version, inner.requires)
    except (MalformedError, ValueError) as error:
        raise DamagedError(f"{at}: is not valid ({error})") from error
    return index, kind


def _check_whole(kind: Kind, index: PartsIndex, whole: Manifest) -> None:
    """Refuse a whole that contradicts its parts; raises ValueError."""
    if whole.schema != kind.name:
        raise ValueError(f"`whole` is {whole.schema}, not {kind.name}")
    rules = {rule.name: rule for rule in kind.arrays}
    if strange := sorted(whole.arrays.keys() - rules):
        raise ValueError(f"`whole` has an unknown array {strange[0]!r}")
    for name, rule in rules.items():
        spec = whole.arrays.get(name)
        if spec is None and not rule.optional:
            raise ValueError(f"`whole` lacks the array {name}")
        if spec is not None and (spec.dtype != rule.dtype or len(spec.shape) != len(rule.shape)):
            raise ValueError(f"the array {name} of `whole` has another type or shape")
    names = [ref.file for ref in index.parts]
    if len(set(names)) < len(names):
        raise ValueError("a part is listed twice")
    if wrong := [name for name in names if not name.endswith(kind.suffix)]:
        raise ValueError(f"{wrong[0]} is not named like {kind.name}")
    total = sum(ref.count for ref in index.parts)
    if total != _rows(kind, whole.arrays):
        raise ValueError(f"the parts have {total} elements, the whole {_rows(kind, whole.arrays)}")
    if not all(math.isfinite(value) for ref in index.parts for value in (*ref.lower, *ref.upper)):
        raise ValueError("a box is not finite")
