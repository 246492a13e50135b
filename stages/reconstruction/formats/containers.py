"""Files that are no splats: archives around one, and others with a magic number of their own."""

from __future__ import annotations

import re
import zlib

from alula.schemas.errors import ArtifactError
from alula.schemas.files import printable
from alula.stages.reconstruction.formats.sog import archive_of
from alula.stages.reconstruction.formats.source import HEAD, Source

_GZIP, _ZIP = b"\x1f\x8b\x08", b"PK\x03\x04"
_MANIFEST = "manifest.json"  # of alula's artifacts
_LISTED = 3  # maximum number of members that are named

_PACKED = (
    (b"\x28\xb5\x2f\xfd", "a zstd stream"),
    (b"\xfd7zXZ\0", "an xz stream"),
    (b"7z\xbc\xaf\x27\x1c", "a 7z archive"),
    (b"Rar!\x1a\x07", "a RAR archive"),
)
_OTHER = (
    (b"\x89PNG\r\n", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"%PDF-", "a PDF document"),
    (b"\x89HDF\r\n", "an HDF5 file"),
    (b"SQLite format 3\0", "an SQLite database (a COLMAP database has images and matches, no Gaussians)"),
    (b"LASF", "a LAS point cloud, which alula import-voxels takes after a conversion to PLY"),
    (b"ASTM-E57", "an E57 point cloud, which alula import-voxels takes after a conversion to PLY"),
    (b"\x93NUMPY", "a NumPy array"),
    (b"<!DOCTYPE html", "a web page: the download gave a page, not the file"),
    (b"<html", "a web page: the download gave a page, not the file"),
    (b"version https://git-lfs", "a pointer of Git LFS: run git lfs pull for the file itself"),
)
_INSIDE = (
    (b"ply", "a PLY file"),
    (_ZIP, "a ZIP archive"),
    (b"NGSP", "an SPZ file"),
    (b"glTF", "a glTF file"),
)


class ContainerError(ArtifactError):
    """A file is an archive, or of a kind that holds no splat."""


def check_unpacked(source: Source) -> None:
    """Refuse archives and files of other kinds by their magic number, with what to do.

    Args:
        source: a file that no reader has recognised by its own magic number.

    Raises:
        ContainerError: it is one.
    """
    if source.is_folder:
        return
    head = source.head
    if head.startswith(_GZIP) and (start := _inflated(head)) is not None:
        kinds = [what for magic, what in _INSIDE if start.startswith(magic)]
        inside = kinds[0] if kinds else "a tar archive" if _is_tar(start) else "no SPZ file"
        tool = "tar xzf" if _is_tar(start) else "gunzip"
        raise ContainerError(
            f"a gzip stream around {inside}; unpack it first ({tool}), and name the file inside"
        )
    if head.startswith(_ZIP):
        names = _members(source)
        if names and all(name.endswith(".npy") or name == _MANIFEST for name in names):
            kind = (
                "an artifact, which alula info explains" if _MANIFEST in names else "arrays of NumPy (.npz)"
            )
            raise ContainerError(f"not a splat file, but {kind}")
        raise ContainerError(f"a ZIP archive{_listed(names)}; unpack it first, and name the splat inside")
    if re.match(rb"BZh[1-9]1AY&SY", head):
        raise ContainerError("a bzip2 stream; unpack it first (bunzip2), and name the file inside")
    if _is_tar(head):
        raise ContainerError("a tar archive; unpack it first (tar xf), and name the splat inside")
    for magic, what in _PACKED:
        if head.startswith(magic):
            raise ContainerError(f"{what}; unpack it first, and name the splat inside")
    for magic, what in _OTHER:
        if head.lstrip()[: len(magic)].lower() == magic.lower():
            raise ContainerError(f"no splat, but {what}")


def _inflated(head: bytes) -> bytes | None:
    """First bytes of a gzip stream; None where it is none."""
    try:
        return zlib.decompressobj(31).decompress(head, HEAD)
    except zlib.error:
        return None


def _is_tar(head: bytes) -> bool:
    return head[257:262] == b"ustar"


def _members(source: Source) -> list[str]:
    """Names of the files in a ZIP archive; none where it is damaged."""
    try:
        with archive_of(source.data) as archive:
            return [name for name in archive.namelist() if not name.endswith("/")]
    except ArtifactError:
        return []


def _listed(names: list[str]) -> str:
    """The first names, in words."""
    shown = [printable(name[:60]) for name in names[:_LISTED]]
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return f" with {', '.join(shown)}{more}" if shown else ""
