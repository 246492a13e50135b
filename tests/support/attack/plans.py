"""Forged plans: what `verify` proves of a changed plan must hold by dense evaluation."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import msgspec
import numpy as np

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.checks import check_arrays, check_shapes
from alula.schemas.artifacts.kinds import PLAN
from alula.schemas.artifacts.manifest import PlanManifest, PlanPass
from alula.schemas.errors import AlulaError
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.scenarios.mission import Mission, PassTable, ZoneTable
from alula.stages.planning.plan import plan
from alula.stages.planning.verify import verify_plan
from support.attack.outcome import Outcome
from support.attack.plan_judge import faults_of
from support.scenes.covers import boxes_cover

BOXES = [[0, 0, 0, 40, 40, 1], [0, 0, 25, 40, 40, 26], [15, 0, 1, 18, 22, 25]]
CONFIG = PlanConfig(start=(0.6, 0.6, 1.0), goal=(3.0, 0.8, 1.2), radius_m=0.2, margin_m=0.05, speed_m_s=1.5)
GATE = PassTable(gate_m=(1.6, 3.0, 1.2), normal=(1, 0, 0), radius_m=0.5)
MISSIONS = (
    Mission(passes=(GATE,)),
    Mission(passes=(PassTable(point_m=(1.0, 2.0, 1.0), tolerance_m=0.2, hold_s=0.6), GATE), yaw="along"),
    Mission(
        passes=(PassTable(point_m=(2.5, 3.0, 1.5), hold_s=0.3),),
        zones=(ZoneTable(box_m=(0, 2, 0, 4, 4, 2), speed_m_s=0.5),),
    ),
)
Rng = np.random.Generator
Change = Callable[[Rng, dict[str, Any], dict[str, Any]], None]


def genuine() -> list[Artifact]:
    """Plans to change."""
    return [plan(CONFIG, boxes_cover(BOXES), mission=mission, jobs=1) for mission in MISSIONS]


def _size(rng: Rng, low: float = -13, high: float = 1) -> float:
    return float(10 ** rng.uniform(low, high) * rng.choice([-1, 1]))


def bump(rng: Rng, arrays: dict[str, Any], _: dict[str, Any]) -> None:
    """Change one coefficient."""
    c = arrays["coefficient"]
    c[rng.integers(len(c)), rng.integers(4), rng.integers(8)] += _size(rng)


def shift(rng: Rng, arrays: dict[str, Any], _: dict[str, Any]) -> None:
    """Move all pieces from one on."""
    c = arrays["coefficient"]
    c[rng.integers(len(c)) :, rng.integers(3), 0] += _size(rng)


def stretch(rng: Rng, arrays: dict[str, Any], _: dict[str, Any]) -> None:
    """Change the duration of a piece, and as often its coefficients with it, so that its path stays."""
    k = rng.integers(len(arrays["coefficient"]))
    factor = 10 ** rng.uniform(-9, 1) if rng.random() < 0.5 else 1 + _size(rng, -9, -1)
    length = np.diff(arrays["time"])
    length[k] *= factor
    if rng.random() < 0.7:
        arrays["coefficient"][k] /= factor ** np.arange(8)
    _retime(arrays, length)


def _retime(arrays: dict[str, Any], length: Any) -> None:
    arrays["time"] = np.concatenate([[0.0], np.cumsum(length)])


def insert(rng: Rng, arrays: dict[str, Any], _: dict[str, Any]) -> None:
    """Put a short piece between two: a rest, a leap, or a change of the speed."""
    c, length = arrays["coefficient"], np.diff(arrays["time"])
    k = int(rng.integers(len(c) + 1))
    new = np.zeros((1, 4, 8))
    new[0, :, 0] = c[min(k, len(c) - 1), :, 0]
    short = 10 ** rng.uniform(-12, -1)
    leap = _size(rng, -10, 0) * (rng.random() < 0.6)
    new[0, rng.integers(3), 1] += leap / short
    c = c.copy()
    c[k:, :3, 0] += new[0, :3, 1] * short * (rng.random() < 0.5)
    arrays["coefficient"] = np.concatenate([c[:k], new, c[k:]])
    arrays["piece_cell"] = np.insert(arrays["piece_cell"], k, -1)
    _retime(arrays, np.insert(length, k, short))


def polyline(rng: Rng, arrays: dict[str, Any], fields: dict[str, Any]) -> None:
    """Straight lines through points, with short rests between them, in place of the whole curve."""
    start, goal = (np.array(fields["parameters"][name]) for name in ("start", "goal"))
    point = [start]
    for each in fields["passes"]:
        here, towards = np.array(each.point_m), np.array(each.normal or [0, 0, 0])
        near = 10 ** rng.uniform(-10, 0)
        point += [here - near * towards, here, here + near * towards] if each.normal else [here]
    point += [rng.uniform(0.3, 3.7, 3) for _ in range(rng.integers(0, 2))] + [goal]
    pieces, length = [], []
    for a, b in pairwise(point):
        rest = 10 ** rng.uniform(-12, -1)
        duration = max(np.linalg.norm(b - a) / fields["speed_m_s"] * 1.01, rest)
        for here, speed, lasts in ((a, 0 * a, rest), (a, (b - a) / duration, duration)):
            piece = np.zeros((4, 8))
            piece[:3, 0], piece[:3, 1] = here, speed
            pieces.append(piece)
            length.append(lasts)
    last = np.zeros((4, 8))
    last[:3, 0] = goal
    arrays["coefficient"] = np.array([*pieces, last])
    _retime(arrays, np.array([*length, 10 ** rng.uniform(-12, 0)]))
    arrays["piece_cell"] = np.full(len(arrays["coefficient"]), -1)
    _times_of_points(arrays, fields)
    if rng.random() < 0.7:
        fields["limits"] = {"speed_m_s": fields["speed_m_s"]}


def _times_of_points(arrays: dict[str, Any], fields: dict[str, Any]) -> None:
    """Let each pass name the first knot that is nearest to its point, after the one before."""
    first = 0
    for i, each in enumerate(fields["passes"]):
        away = np.linalg.norm(arrays["coefficient"][first:, :3, 0] - each.point_m, axis=1)
        at = first + int(away.argmin())
        fields["passes"][i] = msgspec.structs.replace(each, time_s=float(arrays["time"][at]))
        first = min(at + 1, len(arrays["coefficient"]) - 1)


def touch_gate(rng: Rng, arrays: dict[str, Any], fields: dict[str, Any]) -> None:
    """A gate across the curve at a knot, or one that short pieces cross to and fro, best where it rests."""
    c, k = arrays["coefficient"], int(rng.integers(1, len(arrays["coefficient"])))
    rests = 1 + np.flatnonzero(np.linalg.norm(c[1:, :3, 1], axis=1) < 1e-12)
    if len(rests) and rng.random() < 0.7:
        k = int(rng.choice(rests))
    along = c[k, :3, 1] if c[k, :3, 1].any() and rng.random() < 0.5 else rng.normal(size=3)
    along = along / np.linalg.norm(along) * rng.choice([-1, 1])
    if rng.random() < 0.7:
        near, short = 10 ** rng.uniform(-10, -2), 10 ** rng.uniform(-4, -1)
        new = np.zeros((4, 4, 8))
        new[:, :, 0] = c[k, :, 0]
        for i, (begin, speed) in enumerate(((0, -1), (-1, 1), (0, 1), (1, -1))):
            new[i, :3, 0] += begin * near * along
            new[i, :3, 1] = speed * near / short * along
        c = np.concatenate([c[:k], new, c[k:]])
        arrays["coefficient"] = c
        arrays["piece_cell"] = np.insert(arrays["piece_cell"], k, [-1] * 4)
        _retime(arrays, np.insert(np.diff(arrays["time"]), k, [short] * 4))
        fields["passes"] = [
            msgspec.structs.replace(each, time_s=each.time_s + 4 * short * (each.time_s > arrays["time"][k]))
            for each in fields["passes"]
        ]
        k += 2
    gate = PlanPass(
        kind="gate", number=9, time_s=float(arrays["time"][k]), point_m=c[k, :3, 0].tolist(),
        normal=along.tolist(), radius_m=0.5,
    )  # fmt: skip
    fields["passes"] = sorted([*fields["passes"], gate], key=lambda each: each.time_s)


def metadata(rng: Rng, arrays: dict[str, Any], fields: dict[str, Any]) -> None:
    """Change a claim."""
    kind = rng.integers(7)
    if kind == 0:
        fields["speed_m_s"] *= float(rng.uniform(0.5, 1.1))
    elif kind == 1:
        fields["limits"] = {k: v for k, v in fields["limits"].items() if rng.random() < 0.7}
    elif kind == 2:
        fields["limits"] = {k: v * float(rng.uniform(0.8, 1.2)) for k, v in fields["limits"].items()}
    elif kind == 3:
        fields["maps"] = [
            {**each, "keep_m": each["keep_m"] * rng.uniform(0.9, 1.5)} for each in fields["maps"]
        ]
    elif kind == 4 and fields["passes"]:
        i = rng.integers(len(fields["passes"]))
        each = fields["passes"][i]
        fields["passes"][i] = msgspec.structs.replace(
            each,
            time_s=max(0.0, each.time_s + _size(rng, -10, 0) * int(rng.integers(2))),
            hold_s=each.hold_s + max(0.0, _size(rng, -10, 0)),
            point_m=(np.array(each.point_m) + _size(rng, -10, -1) * rng.normal(size=3)).tolist(),
            normal=[-x for x in each.normal] if rng.random() < 0.3 else each.normal,
            radius_m=each.radius_m * float(rng.uniform(0.3, 1.2)),
        )
    elif kind == 5:
        fields["passes"] = fields["passes"][::-1]
    else:
        fields["zones"] = [
            msgspec.structs.replace(each, speed_m_s=each.speed_m_s * float(rng.uniform(0.8, 1.1)))
            for each in fields["zones"]
        ]


def backwards(_: Rng, arrays: dict[str, Any], fields: dict[str, Any]) -> None:
    """Fly the whole curve from its end to its beginning."""
    c, length = arrays["coefficient"], np.diff(arrays["time"])
    new = np.zeros_like(c)
    for k in range(len(c)):
        for d in range(4):
            line = np.polynomial.Polynomial(c[k, d])(np.polynomial.Polynomial([length[k], -1.0]))
            new[k, d, : len(line.coef)] = line.coef
    arrays["coefficient"], arrays["piece_cell"] = new[::-1].copy(), arrays["piece_cell"][::-1].copy()
    _retime(arrays, length[::-1])
    ends = dict(fields["parameters"])
    ends["start"], ends["goal"] = ends["goal"], ends["start"]
    fields["parameters"] = ends
    fields["passes"] = fields["passes"][::-1]
    _times_of_points(arrays, fields)


CHANGES: tuple[Change, ...] = (
    *(bump, shift, stretch, insert, polyline, touch_gate, metadata, backwards),
    *(insert, polyline, touch_gate),
)


def forged(made: Artifact, seed: int) -> tuple[Artifact, str]:
    """A plan with one to three changes, and their names."""
    rng = np.random.default_rng(seed)
    manifest = made.manifest
    assert isinstance(manifest, PlanManifest)
    arrays = {name: np.array(array) for name, array in made.arrays.items()}
    names = ("parameters", "radius_m", "speed_m_s", "margin_m", "limits", "passes", "zones", "maps")
    fields: dict[str, Any] = {name: getattr(manifest, name) for name in names}
    fields |= {name: list(fields[name]) for name in ("passes", "zones", "maps")}
    words = []
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        change = CHANGES[rng.integers(len(CHANGES))]
        change(rng, arrays, fields)
        words.append(change.__name__)
    fields |= {"via_m": [list(each.point_m) for each in fields["passes"]]}
    changed = msgspec.structs.replace(manifest, **fields)
    return dataclasses.replace(made, arrays=arrays, manifest=changed), "+".join(words)


def search(seconds: float, seed: int) -> Outcome:
    """Forge plans, and judge those that `verify` proves."""
    found = Outcome("what `verify` proves of a forged plan holds by dense evaluation")
    end = time.monotonic() + seconds
    cover, originals = boxes_cover(BOXES), genuine()
    number = 1_000_000 * seed
    while time.monotonic() < end:
        number += 1
        made, words = forged(originals[number % len(originals)], number)
        found.tried += 1
        try:
            check_shapes(PLAN, made.arrays)
            check_arrays(PLAN, made.arrays)
            is_proven = verify_plan(made, cover=cover, jobs=1).covered
        except AlulaError:
            found.counts["refused"] += 1
            continue
        found.counts["proven" if is_proven else "not proven"] += 1
        wrong = faults_of(made, BOXES) if is_proven else []
        found.contradictions += [f"plans.forged({number}), {words}: {each}" for each in wrong[:3]]
    return found
