"""Reading and writing of array artifacts: an uncompressed ZIP of a manifest and one NPY per array.

Equal content gives equal bytes: fixed order, fixed dates, sorted keys. Every array starts at a
multiple of 64 bytes, so that it can be memory-mapped. No pickle is read or written.
"""

from __future__ import annotations

import hashlib
import io
import os
import re
import struct
import zipfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import IO, Any, BinaryIO

import msgspec
import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from alula.schemas.artifacts.checks import check_arrays, check_shapes, present
from alula.schemas.artifacts.kinds import KINDS, Kind
from alula.schemas.artifacts.manifest import ArraySpec, Manifest, check_known, producer
from alula.schemas.artifacts.mapping import let_go, owned
from alula.schemas.atomic import atomic_output
from alula.schemas.decode import MalformedError, decode_json
from alula.schemas.errors import ArtifactError, DamagedError, InputError, WrongKindError
from alula.schemas.files import READ_AT_ONCE, check_no_stream, reading, what_it_is

ALIGNMENT = 64
_MIN_THREADED_BYTES = 2**22  # fewer bytes are hashed without threads
_EPOCH = (1980, 1, 1, 0, 0, 0)
_MANIFEST_LIMIT = 64 * 2**20
_LARGEST_EXTENT = 2**48
_PADDING_ID = 0xD935  # the extra field that zipalign uses
_DTYPES = {rule.dtype for kind in KINDS.values() for rule in kind.arrays}
_NPY_HEADER = re.compile(rb"\{'descr': '([^']{1,9})', 'fortran_order': False, 'shape': \(([\d, ]*)\), \}\s*")
_LOCAL_HEADER = struct.Struct("<4s5H3I2H")

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class Artifact:
    """A manifest with its arrays, in memory or mapped from a file."""

    manifest: Manifest
    arrays: Arrays

    @property
    def kind(self) -> Kind:
        """Kind that the manifest names."""
        return KINDS[self.manifest.schema]

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.arrays[name]


def array_hash(array: NDArray[Any]) -> str:
    """SHA-256 of an array's C-order bytes, in hexadecimal."""
    return hashlib.sha256(_bytes_of(array)).hexdigest()


def array_hashes(arrays: Arrays, meanwhile: Callable[[], None] = lambda: None) -> dict[str, str]:
    """Hash all arrays, large ones in threads.

    Args:
        meanwhile: called beside the threads; its exceptions propagate.

    Returns:
        `array_hash` of each array, by name.
    """
    if sum(array.nbytes for array in arrays.values()) < _MIN_THREADED_BYTES:
        meanwhile()
        return {name: array_hash(array) for name, array in arrays.items()}
    from concurrent.futures import ThreadPoolExecutor

    names = sorted(arrays, key=lambda name: -arrays[name].nbytes)
    with ThreadPoolExecutor(min(len(names), os.cpu_count() or 1)) as pool:
        hashes = pool.map(array_hash, [arrays[name] for name in names])
        meanwhile()
        return dict(zip(names, hashes, strict=True))


def _bytes_of(array: NDArray[Any]) -> memoryview:
    return np.ascontiguousarray(array).reshape(-1).view(np.uint8).data


def file_hash(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal.

    Raises:
        InputError: the file cannot be read.
    """
    with reading(path), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def describe_arrays(
    kind: Kind, frame: str, unit: str, arrays: Arrays, hashes: Mapping[str, str] | None = None
) -> dict[str, ArraySpec]:
    """Describe arrays for a manifest.

    Args:
        unit: unit of lengths; it replaces the unit "frame" of the kind's rules.
        hashes: `array_hashes` of the arrays, when known.
    """
    hashes = array_hashes(arrays) if hashes is None else hashes
    return {
        rule.name: ArraySpec(
            dtype=rule.dtype,
            shape=list(arrays[rule.name].shape),
            frame=frame,
            unit=rule.unit.replace("frame", unit),
            meaning=rule.meaning,
            sha256=hashes[rule.name],
        )
        for rule in present(kind, arrays)
    }


def make_artifact(kind: Kind, arrays: Arrays, **fields: Any) -> Artifact:
    """Build and check an artifact.

    Args:
        arrays: by name; they are converted to the kind's types.
        **fields: fields of the kind's manifest. `producer` defaults to this program and `inputs` to an empty
            list, which the command line fills in.

    Raises:
        ArtifactError: an array is missing, of another type or shape, or has values out of range.
    """
    fitted = {}
    for rule in present(kind, arrays):
        if rule.name not in arrays:
            raise ArtifactError(f"{kind.name}: array {rule.name} is missing")
        fitted[rule.name] = np.ascontiguousarray(arrays[rule.name], dtype=np.dtype(rule.dtype))
    check_shapes(kind, fitted)
    hashes = array_hashes(fitted, partial(check_arrays, kind, fitted))
    fields.setdefault("producer", producer())
    fields.setdefault("inputs", [])
    manifest = kind.manifest(
        schema=kind.name,
        version=kind.version,
        arrays=describe_arrays(kind, fields["frame"], fields["unit"], fitted, hashes),
        **fields,
    )
    return Artifact(manifest, fitted)


def encode_manifest(manifest: Manifest) -> bytes:
    """Encode a manifest as canonical JSON: sorted keys, two spaces, a final newline."""
    return msgspec.json.format(msgspec.json.encode(manifest, order="sorted"), indent=2) + b"\n"


def write_artifact(path: Path, artifact: Artifact, *, is_final: bool = True) -> None:
    """Write an artifact atomically.

    Args:
        path: the file; it is replaced when it exists.
        is_final: as for `atomic_output`.

    Raises:
        OutputError: the file cannot be written.
    """
    with atomic_output(path, is_final=is_final) as file:
        _write_members(file, artifact)


def encode_artifact(artifact: Artifact) -> bytes:
    """Encode an artifact as the bytes of its file."""
    return b"".join(_pieces_of(artifact))


def artifact_hash(artifact: Artifact) -> str:
    """SHA-256 of an artifact's file, in hexadecimal."""
    digest = hashlib.sha256()
    for piece in _pieces_of(artifact):
        digest.update(piece)
    return digest.hexdigest()


class _Pieces(io.RawIOBase):
    """A file that keeps what is written without a copy; what is written again replaces a whole piece."""

    def __init__(self) -> None:
        self.at: dict[int, bytes | memoryview] = {}
        self._position = 0

    def write(self, data: Any) -> int:
        self.at[self._position] = data
        self._position += len(data)
        return len(data)

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        assert whence == io.SEEK_SET
        self._position = offset
        return offset

    def tell(self) -> int:
        return self._position


def _pieces_of(artifact: Artifact) -> Iterable[bytes | memoryview]:
    file = _Pieces()
    _write_members(file, artifact)
    return file.at.values()


def _write_members(file: IO[bytes] | _Pieces, artifact: Artifact) -> None:
    arrays = {name: np.ascontiguousarray(array) for name, array in artifact.arrays.items()}
    write_members(file, artifact.manifest, arrays, lambda name: [arrays[name]])


class _Archive(zipfile.ZipFile):
    """An archive that only `with` completes: not its end, when an interruption has closed the file."""

    def __del__(self) -> None:
        pass


def write_members(
    file: IO[bytes] | _Pieces, manifest: Manifest, like: Arrays, rows: Callable[[str], Iterable[NDArray[Any]]]
) -> None:
    """Write an artifact whose arrays come in pieces.

    Args:
        file: at its start.
        manifest: with the hashes of the arrays.
        like: arrays of the types and shapes by name, whose values are not read.
        rows: function that returns the rows of an array, piece by piece.
    """
    with _Archive(file, "w", zipfile.ZIP_STORED) as archive:
        text = encode_manifest(manifest)
        _write_member(archive, file, "manifest.json", len(text), [text])
        for name in sorted(like):
            header = io.BytesIO()
            npy.write_array_header_1_0(header, npy.header_data_from_array_1_0(like[name]))
            size = len(header.getvalue()) + like[name].nbytes
            pieces: Iterable[bytes | memoryview] = chain([header.getvalue()], map(_bytes_of, rows(name)))
            _write_member(archive, file, f"{name}.npy", size, pieces)


def _write_member(
    archive: zipfile.ZipFile,
    file: IO[bytes] | _Pieces,
    name: str,
    size: int,
    parts: Iterable[bytes | memoryview],
) -> None:
    info = zipfile.ZipInfo(name, _EPOCH)
    info.create_system = 3
    info.external_attr = 0o644 << 16
    info.file_size = size
    zip64 = info.file_size >= 2**31 - 1
    start = file.tell() + _LOCAL_HEADER.size + len(name) + (20 if zip64 else 0) + 4
    padding = -start % ALIGNMENT
    info.extra = struct.pack("<HH", _PADDING_ID, padding) + bytes(padding)
    with archive.open(info, "w", force_zip64=zip64) as member:
        for part in parts:
            for begin in range(0, len(part), 2**24):
                member.write(part[begin : begin + 2**24])


def read_manifest(path: Path) -> Manifest:
    """Read the manifest of an artifact file, typed by its kind, without checking the arrays.

    Raises:
        ArtifactError: the file is not an artifact, or of a version that this program cannot read.
        InputError: the file cannot be read at all.
    """
    with _open_archive(path) as archive:
        return _decode_manifest(path, archive)


def read_artifact(path: Path, kind: Kind | None = None, *, is_checked: bool = False) -> Artifact:
    """Read an artifact's arrays and check them against the manifest and the kind's rules.

    Arrays of more than `READ_AT_ONCE` bytes are mapped: if another program cuts their file while it is
    in use, the operating system ends this one (SIGBUS).

    Args:
        kind: the required kind; None for any.
        is_checked: this process has checked the file before; hashes and values are not checked again.

    Returns:
        The artifact; its arrays are read-only.

    Raises:
        WrongKindError: the artifact is of another kind.
        VersionError: its major version is higher, or it requires a feature that this program lacks.
        DamagedError: the file is truncated, or a hash, type, shape or value is wrong.
        InputError: the file cannot be read at all.
    """
    with _open_archive(path) as archive:
        manifest = _decode_manifest(path, archive)
        if kind is not None and manifest.schema != kind.name:
            raise WrongKindError(f"{path}: is {manifest.schema}, but {kind.name} is needed")
        found = KINDS[manifest.schema]
        rules = present(found, manifest.arrays)
        names = {info.filename for info in archive.infolist()}
        expected = {"manifest.json"} | {f"{rule.name}.npy" for rule in rules}
        if missing := sorted(expected - names):
            raise DamagedError(f"{path}: member {missing[0]} is missing")
        if extra := sorted(names - expected):
            raise DamagedError(f"{path}: unexpected member {extra[0]!r}")
        if len(archive.infolist()) != len(expected):  # other programs would read the other copy
            raise DamagedError(f"{path}: a member occurs twice")
        arrays = {rule.name: _map_member(path, archive, f"{rule.name}.npy") for rule in rules}
    hashes = {} if is_checked else array_hashes(arrays)
    for rule in rules:
        array, spec = arrays[rule.name], manifest.arrays.get(rule.name)
        if spec is None:
            raise DamagedError(f"{path}: the manifest does not describe array {rule.name}")
        if array.dtype.str != rule.dtype or spec.dtype != rule.dtype:
            raise DamagedError(f"{path}: array {rule.name} is {array.dtype.str}, not {rule.dtype}")
        if list(array.shape) != spec.shape:
            raise DamagedError(
                f"{path}: array {rule.name} has shape {list(array.shape)}, the manifest says {spec.shape}"
            )
        if not is_checked and hashes[rule.name] != spec.sha256:
            raise DamagedError(f"{path}: array {rule.name} does not match its SHA-256")
    try:
        check_shapes(found, arrays)
        if not is_checked:
            check_arrays(found, arrays)
    except ArtifactError as error:
        raise DamagedError(f"{path}: {error}") from error
    let_go(*arrays.values())  # a command may read a part of them
    return Artifact(manifest, arrays)


def in_memory(artifact: Artifact) -> Artifact:
    """The same artifact, none of whose arrays is mapped from a file."""
    return Artifact(artifact.manifest, {name: owned(array) for name, array in artifact.arrays.items()})


def _open_archive(path: Path) -> zipfile.ZipFile:
    try:
        if path.is_dir():
            if (path / "index.json").is_file():
                raise InputError(f"{path}: is in parts, but one file is needed here")
            raise InputError(f"{path}: is a folder, not an artifact")
        if not path.exists():
            raise InputError(f"{path}: does not exist")
        check_no_stream(path)
        if path.stat().st_size == 0:
            raise ArtifactError(f"{path}: is empty")
        return zipfile.ZipFile(path)
    except (zipfile.BadZipFile, NotImplementedError, ValueError) as error:
        with path.open("rb") as file:
            is_zip = file.read(4) == b"PK\x03\x04"
        if is_zip:
            raise DamagedError(f"{path}: truncated or corrupt artifact ({error})") from error
        raise ArtifactError(f"{path}: is not an alula artifact{what_it_is(path)}") from error
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror or error}") from error


def _decode_manifest(path: Path, archive: zipfile.ZipFile) -> Manifest:
    infos = archive.infolist()
    if not infos or infos[0].filename != "manifest.json":
        raise ArtifactError(f"{path}: is not an alula artifact (a ZIP without a leading manifest.json)")
    if infos[0].compress_type != zipfile.ZIP_STORED or infos[0].file_size > _MANIFEST_LIMIT:
        raise DamagedError(f"{path}: manifest.json is compressed or too large")
    try:
        raw = archive.read(infos[0])
        head = decode_json(raw, _Head)
    except (zipfile.BadZipFile, ValueError, RuntimeError, EOFError, OSError) as error:
        raise DamagedError(f"{path}: manifest.json is damaged ({error})") from error
    kind = KINDS.get(head.schema)
    if kind is None:
        raise WrongKindError(f"{path}: unknown kind of artifact {head.schema!r}")
    try:
        check_known(path, f"{head.schema} ", head.version, kind.version, head.requires)
    except ValueError as error:
        raise DamagedError(f"{path}: {error}") from error
    try:
        return decode_json(raw, kind.manifest)
    except MalformedError as error:
        raise DamagedError(f"{path}: manifest.json is not valid ({error})") from error


class _Head(msgspec.Struct):
    schema: str
    version: str
    requires: list[str] = []


def _npy_header(file: BinaryIO) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of a C-order NPY 1.0 array; NumPy's own reader raises and warns in too many ways."""
    if file.read(8) != b"\x93NUMPY\x01\x00":
        raise ValueError("not NPY 1.0")
    (length,) = struct.unpack("<H", file.read(2))
    header = _NPY_HEADER.fullmatch(file.read(length))
    if header is None or (text := header[1].decode()) not in _DTYPES:
        raise ValueError("not a C-order array of a known type")
    shape = tuple(int(extent) for extent in header[2].split(b",") if extent.strip())
    if max(shape, default=0) > _LARGEST_EXTENT:  # the size alone would not show it beside a zero
        raise ValueError("not a size that an array can have")
    return shape, np.dtype(text)


def _map_member(path: Path, archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    info = archive.getinfo(name)
    if info.compress_type != zipfile.ZIP_STORED:
        raise DamagedError(f"{path}: member {name} is compressed")
    try:
        with path.open("rb") as file:
            file.seek(info.header_offset)
            header = _LOCAL_HEADER.unpack(file.read(_LOCAL_HEADER.size))
            if header[0] != b"PK\x03\x04":
                raise ValueError("no local header")
            data_start = info.header_offset + _LOCAL_HEADER.size + header[9] + header[10]
            file.seek(data_start)
            shape, dtype = _npy_header(file)
            offset = file.tell()
    except (ValueError, struct.error, OSError) as error:  # OSError: an offset that no file has
        raise DamagedError(f"{path}: member {name} is not a plain NPY array") from error
    size = dtype.itemsize * int(np.prod(shape, dtype=object))
    if size != info.file_size - (offset - data_start):
        raise DamagedError(f"{path}: member {name} has {info.file_size} bytes, its header says otherwise")
    if offset + size > path.stat().st_size:
        raise DamagedError(f"{path}: truncated in member {name}")
    if size == 0:
        return np.empty(shape, dtype)
    if size > READ_AT_ONCE:
        return np.memmap(path, dtype, "r", offset, shape)
    with reading(path):
        array = np.fromfile(path, dtype, size // dtype.itemsize, offset=offset)
    if array.nbytes != size:
        raise DamagedError(f"{path}: truncated in member {name}")
    array.flags.writeable = False
    return array.reshape(shape)
