"""Rotations of one body as tuples of floats, which are faster than arrays of four at 400 Hz.

Quaternions (w, x, y, z) turn body vectors into the world; a test compares them with `alula.stages.rotation`.
"""

from __future__ import annotations

import math

Vector = tuple[float, float, float]
Quat = tuple[float, float, float, float]

IDENTITY: Quat = (1.0, 0.0, 0.0, 0.0)


def added(a: Vector, b: Vector) -> Vector:
    """The sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def scaled(a: Vector, scale: float) -> Vector:
    """The product of a vector and a number."""
    return a[0] * scale, a[1] * scale, a[2] * scale


def multiply(left: Quat, right: Quat) -> Quat:
    """The Hamilton product: the rotation `right`, then the rotation `left`."""
    a, b, c, d = left
    e, f, g, h = right
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )


def conjugate(q: Quat) -> Quat:
    """The inverse of a unit quaternion."""
    return q[0], -q[1], -q[2], -q[3]


def relative(start: Quat, end: Quat) -> Quat:
    """The rotation from one attitude to another: the inverse of `start`, multiplied by `end`."""
    a, b, c, d = start
    e, f, g, h = end
    return (
        a * e + b * f + c * g + d * h,
        a * f - b * e - c * h + d * g,
        a * g + b * h - c * e - d * f,
        a * h - b * g + c * f - d * e,
    )


def unit(q: Quat) -> Quat:
    """The quaternion scaled to length 1, with w >= 0."""
    w, x, y, z = q
    scale = math.copysign(1 / math.sqrt(w * w + x * x + y * y + z * z), w)
    return w * scale, x * scale, y * scale, z * scale


def rotate(q: Quat, v: Vector) -> Vector:
    """Rotate a vector from body to world components."""
    a, b, c, d = q
    e, f, g = v
    w = -b * e - c * f - d * g
    x = a * e + c * g - d * f
    y = a * f - b * g + d * e
    z = a * g + b * f - c * e
    return x * a - w * b - y * d + z * c, x * d - w * c + y * a - z * b, -w * d - x * c + y * b + z * a


def from_vector(v: Vector) -> Quat:
    """Quaternion of the rotation by |v| [rad] about v."""
    x, y, z = v
    angle = math.sqrt(x * x + y * y + z * z)
    scale = 0.5 if angle < 1e-9 else math.sin(angle / 2) / angle
    return math.cos(angle / 2), x * scale, y * scale, z * scale


def to_vector(q: Quat) -> Vector:
    """The shortest rotation vector of a unit quaternion [rad]."""
    w, x, y, z = q
    scale = math.copysign(1 / math.sqrt(w * w + x * x + y * y + z * z), w)
    w, x, y, z = w * scale, x * scale, y * scale, z * scale
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 if sine < 1e-9 else 2 * math.atan2(sine, w) / sine
    return x * scale, y * scale, z * scale


def from_heading(yaw: float) -> Quat:
    """Quaternion of a rotation about z [rad]."""
    return math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)


def from_euler(roll: float, pitch: float, yaw: float) -> Quat:
    """Quaternion of yaw about z, then pitch about y, then roll about x, each about the turned axis [rad]."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def to_euler(q: Quat) -> Vector:
    """Roll, pitch, yaw [rad]."""
    w, x, y, z = q
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    return roll, pitch, math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def from_mrp(sigma: Vector) -> Quat:
    """Quaternion of modified Rodrigues parameters, tan(angle / 4) times the axis."""
    x, y, z = sigma
    square = x * x + y * y + z * z
    scale = 2 / (1 + square)
    return (1 - square) / (1 + square), x * scale, y * scale, z * scale


def to_mrp(q: Quat) -> Vector:
    """Modified Rodrigues parameters of at most length 1."""
    w, x, y, z = unit(q)
    return x / (1 + w), y / (1 + w), z / (1 + w)


def cos_tilt(q: Quat) -> float:
    """Cosine of the angle between body z and world z."""
    return 1 - 2 * (q[1] * q[1] + q[2] * q[2])
