"""Scenes with a floor that random triples rarely hit: centres of Gaussians in metres, z up."""

from __future__ import annotations

import numpy as np


def apartment(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Four rooms of 10 x 8 x 2.6 m in all; 14 % of 60,000 centres lie on the floor.

    Two thirds of these lie on a carpet of 4 square metres: plain floors get few Gaussians. The rest is walls
    with a thin ceiling, furniture, what is seen through the windows, and noise.

    Returns:
        Centres, shape (n, 3), and the mask of those on the floor, z = 0.
    """
    rng = np.random.default_rng(seed)
    size = np.array([10.0, 8.0, 2.6])
    floor = rng.uniform(size=(8400, 3)) * size * [1, 1, 0] + [0, 0, 1] * rng.normal(0, 0.015, (8400, 1))
    floor[:5600, :2] = [4, 3] + rng.uniform(size=(5600, 2)) * [2.4, 1.7]  # a patterned carpet
    walls = rng.uniform(size=(18000, 3)) * size
    walls[:4000, 0], walls[4000:8000, 0] = 0, 10
    walls[8000:11000, 1], walls[11000:14000, 1] = 0, 8
    walls[14000:16000, 0], walls[16000:, 1] = 5, 4
    ceiling = rng.uniform(size=(3600, 3)) * size * [1, 1, 0] + [0, 0, 2.6] + rng.normal(0, 0.01, (3600, 3))
    parts = [floor, walls + rng.normal(0, 0.02, walls.shape), ceiling]
    for _ in range(60):  # furniture: boxes filled along their surfaces
        box = rng.uniform([0.3, 0.3, 0.3], [1.5, 1.2, 1.6])
        faces = rng.uniform(size=(420, 3))
        axis = rng.integers(0, 3, 420)
        faces[np.arange(420), axis] = rng.integers(0, 2, 420)
        place = rng.uniform([0, 0, 0], size - [1.5, 1.2, 2.6])
        turn = rng.uniform(0, np.pi)
        turned = (
            faces
            * box
            @ np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
        )
        parts.append(turned + place + rng.normal(0, 0.02, (420, 3)))
    seen = rng.normal(size=(3000, 3)) * [1, 1, 0.4]
    parts.append(seen / np.linalg.norm(seen, axis=1, keepdims=True) * rng.uniform(15, 80, (3000, 1)))
    parts.append(rng.uniform([-2, -2, -1.5], [12, 10, 3.5], (60_000 - sum(map(len, parts)), 3)))
    points = np.concatenate(parts)
    return points, np.arange(len(points)) < len(floor)


def terraces(seed: int, *, upper: float = 1.0, step: float = 0.29) -> tuple[np.ndarray, np.ndarray]:
    """A garden on two levels, with shrubs and a hedge.

    Args:
        seed: seed of the centres.
        upper: centres on the upper level relative to those on the lower one.
        step: height of the upper level [m].

    Returns:
        Centres, shape (n, 3), and the mask of those on the lower level, z = 0.
    """
    rng = np.random.default_rng(seed)
    low = rng.uniform([0, 0, 0], [7, 10, 0], (7000, 3))
    high = rng.uniform([7, 0, step], [14, 10, step], (int(7000 * upper), 3))
    floors = np.concatenate([low, high]) + rng.normal(0, 0.015, (len(low) + len(high), 3))
    shrubs = [
        rng.normal([*rng.uniform([0, 0], [14, 10]), rng.uniform(0.4, 1.6)], rng.uniform(0.2, 0.6), (500, 3))
        for _ in range(30)
    ]
    hedge = rng.uniform([0, 9, 0], [14, 10, 1.8], (5000, 3))
    points = np.concatenate([floors, *shrubs, hedge])
    return points, np.arange(len(points)) < len(low)


def street(seed: int, *, crown: float = 0.08, rough: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """A street of 60 m with a crowned road, raised pavements, facades, trees, cars and a distant background.

    Args:
        seed: seed of the centres.
        crown: height of the road's middle above its edges [m].
        rough: standard deviation of the ground's heights [m].

    Returns:
        Centres, shape (n, 3), and the mask of those on the road; the middle of the road has z = 0.
    """
    rng = np.random.default_rng(seed)
    road = rng.uniform([-30, -4, 0], [30, 4, 0], (9000, 3))
    road[:, 2] = -crown * (road[:, 1] / 4) ** 2 + rng.normal(0, rough, len(road))
    parts = [road]
    for side in (-1, 1):
        pavement = rng.uniform([-30, 4, 0.05], [30, 7, 0.05], (3000, 3)) * [1, side, 1]
        facade = rng.uniform([-30, 7, 0], [30, 7.4, 12], (12000, 3)) * [1, side, 1]
        parts += [pavement + rng.normal(0, rough, (3000, 3)) * [0, 0, 1], facade]
        for _ in range(6):
            at = [rng.uniform(-28, 28), side * rng.uniform(4.5, 6.5), rng.uniform(4, 6)]
            parts.append(rng.normal(at, [1.2, 1.0, 1.3], (1200, 3)))
        for _ in range(5):
            at = np.array([rng.uniform(-28, 24), side * 2.9 - 0.9, 0.1])
            parts.append(at + rng.uniform(size=(500, 3)) * [4.2, 1.8, 1.4])
    far = rng.normal(size=(6000, 3))
    parts.append(far / np.linalg.norm(far, axis=1, keepdims=True) * rng.uniform(60, 250, (6000, 1)))
    points = np.concatenate(parts)
    return points, np.arange(len(points)) < len(road)
