"""Every way to spoil a file that a command reads."""

import io
import json
import zipfile
from pathlib import Path

import numpy as np


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])


def empty(path: Path) -> None:
    path.write_bytes(b"")


def garbage(path: Path) -> None:
    path.write_bytes(np.random.default_rng(1).bytes(5000))


def missing(path: Path) -> None:
    path.unlink()


def folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def flipped(path: Path) -> None:
    """One bit of the content changed."""
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2] ^= 0x40
    path.write_bytes(raw)


def newer(path: Path) -> None:
    """The same content from a later major version."""
    _rewrite(path, lambda manifest, arrays: manifest.update(version="9.0"))


def truncated_map(path: Path) -> None:
    """An onboard map without the end of its image."""
    raw = path.read_bytes()
    path.write_bytes(raw[: int.from_bytes(raw[16:20], "little") * 2 // 3])


def flipped_map(path: Path) -> None:
    """One bit of the image changed."""
    raw = bytearray(path.read_bytes())
    raw[int.from_bytes(raw[16:20], "little") // 2] ^= 0x40
    path.write_bytes(raw)


def flipped_map_header(path: Path) -> None:
    raw = bytearray(path.read_bytes())
    raw[30] ^= 0x01
    path.write_bytes(raw)


def newer_map(path: Path) -> None:
    raw = bytearray(path.read_bytes())
    raw[4] = 9
    path.write_bytes(raw)


def longer_map(path: Path) -> None:
    """A header that claims four billion hulls, with the sum that it needs."""
    import zlib

    raw = bytearray(path.read_bytes())
    raw[12:16] = b"\xff" * 4
    raw[60:64] = zlib.crc32(raw[:60]).to_bytes(4, "little")
    path.write_bytes(raw)


def not_a_number(path: Path) -> None:
    """All floating-point arrays NaN, with hashes that match."""
    import hashlib

    def spoil(manifest, arrays):
        for name, array in arrays.items():
            if array.dtype.kind == "f":
                array[...] = np.nan
                manifest["arrays"][name]["sha256"] = hashlib.sha256(array.tobytes()).hexdigest()

    _rewrite(path, spoil)


def not_a_number_ply(path: Path) -> None:
    raw = path.read_bytes()
    start = raw.index(b"end_header\n") + len(b"end_header\n")
    path.write_bytes(raw[:start] + np.full((len(raw) - start) // 4, np.nan, "<f4").tobytes())


def huge_ply(path: Path) -> None:
    """A header that claims four billion rows."""
    path.write_bytes(path.read_bytes().replace(b"element vertex 800", b"element vertex 4000000000"))


def newer_toml(path: Path) -> None:
    lines = [line for line in path.read_text().splitlines() if not line.startswith("version")]
    path.write_text("\n".join(['version = "9.0"', *lines]) + "\n")


def not_a_number_csv(path: Path) -> None:
    path.write_text(path.read_text().replace("1,0,0", "nan,0,0").replace("100,100", "nan,100"))


def words_csv(path: Path) -> None:
    path.write_text(path.read_text().replace("1,0,0", "one,0,0").replace("100,100", "one,100"))


def _rewrite(path: Path, edit) -> None:
    with zipfile.ZipFile(path) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    manifest = json.loads(members.pop("manifest.json"))
    arrays = {name.removesuffix(".npy"): np.load(io.BytesIO(raw)) for name, raw in members.items()}
    edit(manifest, arrays)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("manifest.json", json.dumps(manifest))
        for name, array in arrays.items():
            stream = io.BytesIO()
            np.save(stream, array)
            archive.writestr(f"{name}.npy", stream.getvalue())
