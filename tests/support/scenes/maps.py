"""Onboard maps by their documentation: a decoder in plain Python, and exact values of psi."""

import struct
import zlib
from fractions import Fraction

import numpy as np

DIRECTIONS = [
    (x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z).count(0) <= 1
]


def decode(raw: bytes) -> list[dict]:
    """Each hull: lower, upper, shift and planes (normal, offset) with normal . x <= offset; integers."""
    assert raw[:4] == b"ALMP"
    assert [raw[4], *raw[6:8]] == [1, 64, 0]
    flags, largest, zero, count, total, crc = struct.unpack_from("<HBBIII", raw, 8)
    origin = struct.unpack_from("<3i", raw, 24)
    assert zero == 0
    assert crc == zlib.crc32(raw[64:total])
    assert struct.unpack_from("<I", raw, 60)[0] == zlib.crc32(raw[:60])
    hulls, at = [], 64
    for _ in range(count):
        *box, k, shift = struct.unpack_from("<6h2B", raw, at)
        lower, upper = ([c + o for c, o in zip(box[i : i + 3], origin, strict=True)] for i in (0, 3))
        at += 14
        planes = []
        for _ in range(k):
            if flags & 1:
                (word,) = struct.unpack_from("<H", raw, at)
                normal, depth, at = DIRECTIONS[word & 31], word >> 5, at + 2
            else:
                *normal, depth = struct.unpack_from("<3bH", raw, at)
                at += 5
            assert max(map(abs, normal)) <= largest
            corner = [hi if n > 0 else lo for n, lo, hi in zip(normal, lower, upper, strict=True)]
            reach = sum(n * c for n, c in zip(normal, corner, strict=True))
            planes.append((tuple(normal), reach - depth * 2**shift))
        hulls.append({"lower": tuple(lower), "upper": tuple(upper), "shift": shift, "planes": planes})
    assert at == total
    return hulls


def half_spaces(hull: dict) -> list[tuple[tuple[int, ...], int]]:
    """The six faces and the oblique planes."""
    faces = []
    for axis in range(3):
        unit = tuple(int(axis == i) for i in range(3))
        faces += [(unit, hull["upper"][axis]), (tuple(-n for n in unit), -hull["lower"][axis])]
    return faces + hull["planes"]


def is_at_least(hulls: list[dict], g: float, p: list[Fraction], value: float) -> bool:
    """Whether psi(p) >= value, exactly: every hull has a plane with normal . p - d g >= value |normal|."""

    def reaches(normal, offset):
        a = sum(n * c for n, c in zip(normal, p, strict=True)) - offset * Fraction(g)
        v, square = Fraction(value), sum(n * n for n in normal)
        if a >= 0 and v <= 0:
            return True
        if a < 0 < v:
            return False
        return a * a >= v * v * square if v > 0 else a * a <= v * v * square

    return all(any(reaches(*plane) for plane in half_spaces(hull)) for hull in hulls)


def psi(hulls: list[dict], g: float, p: np.ndarray) -> float:
    """psi(p) in double precision."""
    values = []
    for hull in hulls:
        rows = half_spaces(hull)
        normal, offset = np.array([n for n, _ in rows], float), np.array([d for _, d in rows], float)
        values.append(((normal @ p - offset * g) / np.linalg.norm(normal, axis=1)).max())
    return min(values)


def sealed(raw: bytes) -> bytes:
    """The image with both CRC-32 set to what its bytes need."""
    image = bytearray(raw)
    (total,) = struct.unpack_from("<I", image, 16)
    struct.pack_into("<I", image, 20, zlib.crc32(image[64:total]))
    struct.pack_into("<I", image, 60, zlib.crc32(image[:60]))
    return bytes(image)


def holds(hull: dict, points) -> bool:
    """Whether a hull contains all integer points."""
    return all(
        sum(n * int(c) for n, c in zip(normal, point, strict=True)) <= offset
        for normal, offset in half_spaces(hull)
        for point in points
    )
