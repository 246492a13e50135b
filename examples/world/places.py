"""Write a made-up place as a Gaussian splat file: a grove of trees, or a hall with pillars.

Usage: python places.py grove|hall OUTPUT.ply
"""

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.float64]
Color = tuple[float, float, float]
Point = tuple[float, float, float]
Part = tuple[Rows, Rows, Rows, Rows]  # points, logarithms of scales, quaternions, colors

RNG = np.random.default_rng(7)
FIELDS = [
    *("x", "y", "z", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
    *("opacity", "f_dc_0", "f_dc_1", "f_dc_2"),
]


def disc(points: Rows, normal: Rows, size: float, color: Color) -> Part:
    """Flat Gaussians at points, shape (N, 3), turned to their normals; size in metres."""
    n = len(points)
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    w = 1 + normal[:, 2]  # the rotation that turns z to the normal
    quat = np.column_stack([w, -normal[:, 1], normal[:, 0], np.zeros(n)])
    quat[w < 1e-6] = [0, 1, 0, 0]
    scale = np.column_stack([np.full(n, size), np.full(n, size), np.full(n, size / 8)])
    return points, np.log(scale), quat, np.tile(color, (n, 1))


def cylinder(x: float, y: float, low: float, high: float, radius: float, count: int, color: Color) -> Part:
    """The wall of an upright cylinder."""
    angle, z = RNG.uniform(0, 2 * np.pi, count), RNG.uniform(low, high, count)
    out = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])
    return disc(np.array([x, y, 0]) + radius * out + z[:, None] * [0, 0, 1], out, 0.08, color)


def ball(x: float, y: float, z: float, radius: float, count: int, color: Color) -> Part:
    """A shell of leaves."""
    out = RNG.normal(size=(count, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    spread = radius * RNG.uniform(0.8, 1.0, (count, 1))
    return disc(np.array([x, y, z]) + spread * out, out + RNG.normal(0, 0.5, (count, 3)), 0.12, color)


def rectangle(origin: Point, along: Point, across: Point, count: int, color: Color) -> Part:
    """A flat piece of wall or ground."""
    u, v = RNG.uniform(0, 1, (2, count, 1))
    points = np.array(origin) + u * np.array(along) + v * np.array(across)
    normal = np.tile(np.cross(along, across), (count, 1)).astype(float)
    return disc(points, normal, 0.12, color)


def grove() -> list[Part]:
    """Forty metres of grass with eighteen trees of 7 m."""
    parts = [rectangle((-20, -20, 0), (40, 0, 0), (0, 40, 0), 9000, (0.25, 0.45, 0.2))]
    for i in range(18):
        x, y = -16 + 32 * ((i * 0.618) % 1), -15 + 30 * (i + 0.5) / 18
        parts.append(cylinder(x, y, 0, 4.2, 0.25, 700, (0.35, 0.25, 0.15)))
        parts.append(ball(x, y, 5.4, 1.7, 900, (0.15, 0.4, 0.12)))
    return parts


def hall() -> list[Part]:
    """A hall of 60 x 30 x 12 m with two rows of pillars."""
    grey, red = (0.6, 0.6, 0.62), (0.6, 0.3, 0.25)
    parts = [
        rectangle((0, 0, 0), (60, 0, 0), (0, 30, 0), 9000, grey),
        rectangle((0, 0, 12), (60, 0, 0), (0, 30, 0), 9000, grey),
        rectangle((0, 0, 0), (60, 0, 0), (0, 0, 12), 5000, red),
        rectangle((0, 30, 0), (60, 0, 0), (0, 0, 12), 5000, red),
        rectangle((0, 0, 0), (0, 30, 0), (0, 0, 12), 3000, red),
        rectangle((60, 0, 0), (0, 30, 0), (0, 0, 12), 3000, red),
    ]
    parts += [cylinder(x, y, 0, 12, 0.5, 900, grey) for x in (10, 20, 30, 40, 50) for y in (9, 21)]
    return parts


def main(place: str, output: str) -> None:
    """Write a place."""
    parts = {"grove": grove, "hall": hall}[place]()
    points, scale, quat, color = (np.concatenate(column) for column in zip(*parts, strict=True))
    opacity = np.full((len(points), 1), 4.0)  # before the logistic function: 0.98
    harmonic = (color - 0.5) / 0.28209479177387814
    rows = np.hstack([points, scale, quat, opacity, harmonic]).astype("<f4")
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    header += [f"property float {name}" for name in FIELDS] + ["end_header", ""]
    Path(output).write_bytes("\n".join(header).encode() + rows.tobytes())


if __name__ == "__main__":
    main(*sys.argv[1:])
