"""The room of the built-in scene: 8 x 6 x 3 m, furnished, with four hoops to fly through.

World frame: z up, floor at z = 0, one corner at the origin, metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.reconstruction.surfaces import (
    Color,
    Surface,
    Vector,
    box,
    disc,
    framed,
    plain,
    rectangle,
    sphere,
    striped,
    torus,
    tube,
)

SIZE: Vector = (8.0, 6.0, 3.0)
HOOP_TUBE_M = 0.03

WOOD: Color = (0.55, 0.36, 0.20)
DARK_WOOD: Color = (0.33, 0.20, 0.11)
WALL: Color = (0.88, 0.85, 0.78)
WHITE: Color = (0.93, 0.93, 0.92)
METAL: Color = (0.35, 0.36, 0.38)
SOFA: Color = (0.20, 0.33, 0.48)
SEAT: Color = (0.72, 0.30, 0.18)
STONE: Color = (0.62, 0.60, 0.57)


@dataclass(frozen=True, slots=True)
class Hoop:
    """A ring on a stand.

    Attributes:
        centre: centre of the ring, world frame [m].
        axis: horizontal unit vector in the direction of flight through the ring, world frame.
        radius_m: distance from the centre to the middle of the tube [m].
        color: red, green, blue in [0, 1].
    """

    centre: Vector
    axis: Vector
    radius_m: float
    color: Color


HOOPS = (
    Hoop((2.3, 1.6, 1.25), (1.0, 0.0, 0.0), 0.45, (0.95, 0.45, 0.05)),
    Hoop((6.5, 2.5, 1.60), (0.0, 1.0, 0.0), 0.45, (0.10, 0.70, 0.25)),
    Hoop((4.6, 4.5, 1.35), (-1.0, 0.0, 0.0), 0.40, (0.85, 0.10, 0.45)),
    Hoop((1.3, 3.0, 1.75), (0.0, -1.0, 0.0), 0.50, (0.15, 0.45, 0.95)),
)


def hoop_centres() -> FloatArray:
    """Centres of the hoops in the order of a lap, shape (4, 3), world frame [m]."""
    return np.array([hoop.centre for hoop in HOOPS])


def room() -> list[Surface]:
    """All surfaces of the room."""
    surfaces = [*_shell(), *_table(2.4, 5.0), *_sofa(3.2, 0.08), *_shelf(0.02, 0.3), *_media(7.55, 3.7)]
    for x, y, turn in ((1.85, 4.3, 0), (2.75, 4.3, 0), (1.85, 5.3, 2), (2.75, 5.3, 2)):
        surfaces += _chair(x, y, turn)
    surfaces += _lamp(7.4, 5.4)
    surfaces += _pendant(2.4, 5.0)
    surfaces += _plant(0.55, 5.35)
    surfaces += [tube((4.0, 3.0, 0.0), 0.2, SIZE[2], plain(STONE))]
    surfaces += [tube((4.0, 3.0, 0.0), 0.28, 0.12, plain(STONE)), disc((4.0, 3.0, 0.12), 0.28, plain(STONE))]
    for hoop in HOOPS:
        surfaces += _hoop(hoop)
    return surfaces


def _shell() -> list[Surface]:
    x, y, z = SIZE
    rug = framed(striped((0.62, 0.14, 0.16), (0.80, 0.62, 0.36), 9), (0.35, 0.08, 0.10), 0.08)
    sky = framed(plain((0.62, 0.80, 0.95)), WHITE, 0.06)
    picture = framed(striped((0.15, 0.35, 0.55), (0.90, 0.65, 0.25), 5, along_u=False), DARK_WOOD, 0.05)
    return [
        rectangle((0, 0, 0), (x, 0, 0), (0, y, 0), striped(WOOD, (0.66, 0.46, 0.28), 40)),
        rectangle((3.0, 1.3, 0.004), (2.4, 0, 0), (0, 1.3, 0), rug),
        rectangle((0, 0, z), (0, y, 0), (x, 0, 0), plain(WHITE), density=0.7, detail=1.2),
        rectangle((0, 0, 0), (0, 0, z), (x, 0, 0), plain(WALL), density=0.9),
        rectangle((0, y, 0), (x, 0, 0), (0, 0, z), plain(WALL), density=0.9),
        rectangle((0, 0, 0), (0, y, 0), (0, 0, z), plain((0.70, 0.78, 0.72)), density=0.9),
        rectangle((x, 0, 0), (0, 0, z), (0, y, 0), plain(WALL), density=0.9),
        rectangle((3.4, y - 0.01, 0.9), (2.4, 0, 0), (0, 0, 1.5), sky),
        rectangle((6.5, 0.01, 0.0), (0, 0, 2.1), (0.95, 0, 0), framed(plain(WOOD), DARK_WOOD, 0.06)),
        rectangle((3.6, 0.01, 1.3), (0, 0, 0.8), (1.4, 0, 0), picture),
    ]


def _legs(x: FloatArray, y: FloatArray, width: float, height: float, color: Color) -> list[Surface]:
    return [
        face
        for a in x
        for b in y
        for face in box((a, b, 0.0), (a + width, b + width, height), plain(color), density=2.0, detail=0.6)
    ]


def _table(x: float, y: float) -> list[Surface]:
    top = box((x - 0.9, y - 0.45, 0.72), (x + 0.9, y + 0.45, 0.76), striped(WOOD, DARK_WOOD, 7), density=1.4)
    edges_x, edges_y = np.array([x - 0.86, x + 0.80]), np.array([y - 0.41, y + 0.35])
    return top + _legs(edges_x, edges_y, 0.06, 0.72, WOOD)


def _chair(x: float, y: float, turn: int) -> list[Surface]:
    """A chair; `turn` is 0 (back at low y) or 2 (back at high y)."""
    side = 0.45
    fine = {"density": 2.0, "detail": 0.7}
    back = y if turn == 0 else y + side - 0.04
    return [
        *box((x, y, 0.43), (x + side, y + side, 0.47), plain(SEAT), **fine),
        *box((x, back, 0.55), (x + side, back + 0.04, 0.95), plain(SEAT), **fine),
        *box((x, back, 0.47), (x + 0.04, back + 0.04, 0.55), plain(DARK_WOOD), **fine),
        *box((x + side - 0.04, back, 0.47), (x + side, back + 0.04, 0.55), plain(DARK_WOOD), **fine),
        *_legs(np.array([x, x + side - 0.04]), np.array([y, y + side - 0.04]), 0.04, 0.43, DARK_WOOD),
    ]


def _sofa(x: float, y: float) -> list[Surface]:
    cushions = striped(SOFA, (0.26, 0.42, 0.58), 3, along_u=False)
    return [
        *box((x, y, 0.10), (x + 2.2, y + 0.9, 0.42), cushions, density=1.2),
        *box((x, y, 0.42), (x + 2.2, y + 0.25, 0.85), plain(SOFA), density=1.2),
        *box((x, y, 0.42), (x + 0.22, y + 0.9, 0.62), plain(SOFA), density=1.2),
        *box((x + 1.98, y, 0.42), (x + 2.2, y + 0.9, 0.62), plain(SOFA), density=1.2),
        *_legs(np.array([x + 0.05, x + 2.09]), np.array([y + 0.05, y + 0.79]), 0.06, 0.10, DARK_WOOD),
    ]


def _shelf(x: float, y: float) -> list[Surface]:
    depth, width, height, board = 0.32, 1.8, 2.0, 0.03
    wood = plain(WOOD)
    surfaces = [
        *box((x, y, 0.0), (x + depth, y + board, height), wood),
        *box((x, y + width - board, 0.0), (x + depth, y + width, height), wood),
        *box((x, y, 0.0), (x + 0.015, y + width, height), plain(DARK_WOOD)),
    ]
    spines = striped((0.65, 0.12, 0.10), (0.10, 0.25, 0.50), 24)
    for i in range(6):
        low = i * (height - board) / 5
        surfaces += box((x, y, low), (x + depth, y + width, low + board), wood)
        if i < 5:
            end = y + board + (0.95 + 0.13 * ((i * 3) % 5))
            surfaces += box((x + 0.05, y + board, low + board), (x + 0.25, end, low + 0.29), spines)
    return surfaces


def _media(x: float, y: float) -> list[Surface]:
    dark = (0.05, 0.05, 0.06)
    return [
        *box((x, y, 0.0), (x + 0.43, y + 1.5, 0.5), striped(DARK_WOOD, WOOD, 3)),
        *box((x + 0.22, y + 0.15, 0.6), (x + 0.27, y + 1.35, 1.28), plain(dark), density=1.5),
        *box((x + 0.2, y + 0.65, 0.5), (x + 0.3, y + 0.85, 0.6), plain(dark), density=1.5),
    ]


def _lamp(x: float, y: float) -> list[Surface]:
    shade = plain((0.98, 0.88, 0.60))
    return [
        disc((x, y, 0.02), 0.16, plain(METAL), density=1.5),
        tube((x, y, 0.0), 0.16, 0.02, plain(METAL), density=1.5),
        tube((x, y, 0.02), 0.015, 1.5, plain(METAL), density=4.0, detail=0.4),
        tube((x, y, 1.40), 0.24, 0.32, shade, top=0.14, density=1.5),
    ]


def _pendant(x: float, y: float) -> list[Surface]:
    return [
        tube((x, y, 2.2), 0.01, 0.8, plain(METAL), density=5.0, detail=0.3),
        tube((x, y, 1.95), 0.22, 0.25, plain((0.90, 0.75, 0.20)), top=0.06, density=1.5),
    ]


def _plant(x: float, y: float) -> list[Surface]:
    leaves = striped((0.10, 0.38, 0.12), (0.32, 0.58, 0.20), 17)
    return [
        tube((x, y, 0.0), 0.15, 0.35, plain((0.70, 0.36, 0.22)), top=0.19, density=1.5),
        disc((x, y, 0.33), 0.18, plain((0.22, 0.15, 0.10))),
        tube((x, y, 0.33), 0.02, 0.5, plain(DARK_WOOD), density=4.0, detail=0.4),
        sphere((x, y, 1.05), 0.34, leaves, density=1.8),
        sphere((x + 0.12, y - 0.10, 1.40), 0.22, leaves, density=1.8),
    ]


def _hoop(hoop: Hoop) -> list[Surface]:
    x, y, z = hoop.centre
    bottom = z - hoop.radius_m
    stripes = striped(hoop.color, WHITE, 16, along_u=False)
    return [
        torus(hoop.centre, hoop.axis, hoop.radius_m, HOOP_TUBE_M, stripes, density=3.0, detail=0.5),
        tube((x, y, 0.0), 0.02, bottom, plain(METAL), density=4.0, detail=0.4),
        disc((x, y, 0.015), 0.18, plain(METAL), density=1.5),
        tube((x, y, 0.0), 0.18, 0.015, plain(METAL), density=1.5),
    ]
