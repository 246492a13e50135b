"""Cost of an onboard map on its target: bytes, and instructions of a tick of polytope-cbf or the chord."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.errors import CheckError, InfeasibleError
from alula.schemas.parameters.targets import Target
from alula.stages.compression.onboard.image import HEADER_BYTES, HULL_BYTES, MapImage
from alula.stages.compression.onboard.layout import LEAF_HULLS, index_bytes

# Upper bounds of the instructions of a tick per box, hull, plane, decoded plane and exponential of a plane:
# fitted to emulated ticks on a Cortex-M4 and rounded up. A test checks them against every tick that
# `make onboard` replays.
BASE_INSTRUCTIONS = 2400
INSTRUCTIONS = np.array([136, 155, 30, 43, 135])
# The same of the chord filter: box, hull, value of a plane, decoded plane, row.
CHORD_INSTRUCTIONS = np.array([136, 100, 26, 45, 1300])
# Of the search for the least violation, where the chord has entered margins; more of them cost no more.
ENTERED_INSTRUCTIONS = 320_000
# Of the stack beyond its chord: the search for a horizon, and each obstacle; fitted to ticks with 1 to 8.
SEARCH_INSTRUCTIONS, OBSTACLE_INSTRUCTIONS = 280_000, 15_000
SAMPLES, REFINED = 3000, 300
ASSUMED: dict[str, Any] = {"radius_m": 0.1, "beta": 2.0, "kappa": 100.0, "v_max": 1.0, "dt_s": 0.002}
ASSUMED_OF_CHORD: dict[str, Any] = {"radius_m": 0.15, "beta": 2.0, "v_max": 1.0, "dt_s": 0.01}
LAG_S = 0.35
# Maximum number of passes over all hulls in a tick: two guesses, psi, minimum, sum, two checks of the step.
_PASSES = 7
# The chord filter visits each hull once. It takes values of a plane: one in the walk, two at each end of the
# chord, one in each of 16 passes, and two more inside of a margin. It keeps 24 rows.
_CHORD_VALUES, _CHORD_ROWS = 23, 24


def tick_instructions(work: NDArray[np.int64], *, of_chord: bool = False) -> NDArray[np.int64]:
    """Upper bound of the instructions of ticks, from their counts of work.

    Args:
        work: what `PolytopeCbf.work` counts, shape (..., 5), or `OnboardChord.work`, shape (..., 6).
        of_chord: the latter.

    Returns:
        Instructions, shape (...).
    """
    if of_chord:
        searched = ENTERED_INSTRUCTIONS * (work[..., 5] > 0)
        chord: NDArray[np.int64] = work[..., :5] @ CHORD_INSTRUCTIONS + searched
        return chord + BASE_INSTRUCTIONS
    total: NDArray[np.int64] = np.asarray(work, np.int64) @ INSTRUCTIONS
    return total + BASE_INSTRUCTIONS


def obstacles_instructions(obstacles: int) -> int:
    """Upper bound of the instructions of a tick of the stack beyond those of its chord."""
    return SEARCH_INSTRUCTIONS + OBSTACLE_INSTRUCTIONS * obstacles if obstacles > 0 else 0


_Work = Callable[[list[float], list[float]], Sequence[int]]


def _plain(raw: bytes, extent_m: float) -> _Work:
    """Work of a tick of polytope-cbf, by position and nominal command."""
    native = _core.PolytopeCbf.from_image(raw, extent_m=extent_m, **ASSUMED)

    def work_of(x: list[float], u: list[float]) -> Sequence[int]:
        native.filter(x, u)
        return native.work()

    return work_of


def _chord(raw: bytes, extent_m: float) -> _Work:
    """Work of a tick of the chord filter at the speed limit along the nominal command, by position and it."""
    config = _core.PolytopeCbfConfig(**ASSUMED_OF_CHORD)
    native = _core.OnboardChord(raw, config, LAG_S, extent_m + LAG_S * config.v_max)

    def work_of(x: list[float], u: list[float]) -> Sequence[int]:
        speed = max(math.hypot(*u), 1e-9)
        native.filter(x, [config.v_max * each / speed for each in u], u)
        return native.work()

    return work_of


def worst_tick(raw: bytes, image: MapImage, *, of_chord: bool = False) -> dict[str, int]:
    """Maximum instructions of a tick on a map, with the parameters `ASSUMED` or those of the Crazyflie's app.

    `measured` is the maximum over `SAMPLES` positions in and around the boxes of hulls, with nominal
    commands towards them, and over further positions around the worst of these. Consecutive positions are
    far apart, so that few decoded hulls can be reused. `bound` holds for any position and any parameters: it
    assumes that every pass of a tick visits and decodes every hull.

    Args:
        of_chord: of the chord filter, at the speed limit along the nominal command; else of polytope-cbf.

    Returns:
        `measured` and `bound` [instructions], and `hulls`, the number evaluated in the tick of `measured`.
    """
    hulls = len(image)
    if hulls == 0:
        return {"measured": BASE_INSTRUCTIONS, "bound": BASE_INSTRUCTIONS, "hulls": 0}
    g, rng = image.voxel_size_m, np.random.default_rng(0)
    extent = float(np.abs([image.lower, image.upper]).max() * g) + 2.0
    chosen = rng.integers(0, hulls, SAMPLES)
    within = rng.choice([-0.2, 0.0, 0.5, 1.0, 1.2], (SAMPLES, 3)) + rng.normal(scale=0.1, size=(SAMPLES, 3))
    low, high = image.lower[chosen] * g, image.upper[chosen] * g
    points = (
        low
        + within * (high - low)
        + rng.choice([0.0, 0.0, 0.4], (SAMPLES, 1)) * rng.normal(size=(SAMPLES, 3))
    )
    nominal = 0.5 * (low + high) - points
    work_of = _chord(raw, extent) if of_chord else _plain(raw, extent)

    most = {"measured": 0, "hulls": 0}

    def cost(at: NDArray[np.float64]) -> NDArray[np.int64]:
        ticks = zip(np.clip(at, -extent, extent).tolist(), nominal.tolist(), strict=True)
        work = np.array([work_of(x, u) for x, u in ticks])
        found = tick_instructions(work, of_chord=of_chord)
        if found.max() > most["measured"]:
            most.update(measured=int(found.max()), hulls=int(work[found.argmax(), 1]))
        return found

    found = cost(points)
    for reach_m in (0.2, 0.1, 0.05, 0.02):
        worst = rng.permutation(np.argsort(-found)[:REFINED])
        points, nominal = points[worst] + reach_m * rng.normal(size=(REFINED, 3)), nominal[worst]
        found = cost(points)
    nodes = -(-hulls // LEAF_HULLS) * 4 // 3 + 16
    planes = image.half_planes
    if of_chord:
        every = np.array(
            [hulls + nodes, hulls, _CHORD_VALUES * (planes + 6 * hulls), planes + 6 * hulls, _CHORD_ROWS, 1]
        )
        return {**most, "bound": int(tick_instructions(every, of_chord=True))}
    every = np.array([hulls + nodes, hulls, planes, planes, planes])
    return {**most, "bound": int(tick_instructions(_PASSES * every))}


def largest_budget(room: int, hulls: int) -> int:
    """Largest `merge --max-bytes` for which every map, with its index, takes at most `room` bytes.

    Merging a cover further never increases the number of its hulls, and a cover of B bytes has at most
    (B - 64) / 14 hulls. The better of both limits bounds the size of the index.

    Args:
        room: space for the map [bytes].
        hulls: number of hulls of the cover to be merged further.

    Returns:
        The budget of the map without its index [bytes].
    """
    from_count = room - index_bytes(hulls)
    low, high = 0, room
    while low < high:
        middle = (low + high + 1) // 2
        fits = middle + index_bytes(max(middle - HEADER_BYTES, 0) // HULL_BYTES) <= room
        low, high = (middle, high) if fits else (low, middle - 1)
    return max(from_count, low)


def require_fit(raw: bytes, image: MapImage, target: Target) -> None:
    """Refuse a map that does not fit on a target.

    Raises:
        InfeasibleError: it is too large; the message has the `merge --max-bytes` that fits.
    """
    if target.flash_bytes == 0 or len(raw) <= target.map_room:
        return
    raise InfeasibleError(
        f"{len(image)} hulls take {len(raw)} bytes, {target.name} has room for {target.map_room} beside the"
        f" filters' code; merge this cover with --max-bytes {largest_budget(target.map_room, len(image))}"
    )


def require_memory(target: Target, obstacles: int) -> None:
    """Refuse more moving obstacles than the target's memory holds.

    Raises:
        InfeasibleError: they do not fit; the message has the number that does.
    """
    needs = target.state_bytes(obstacles)
    if obstacles == 0 or needs <= target.ram_bytes:
        return
    most = obstacles
    while most > 0 and target.state_bytes(most) > target.ram_bytes:
        most -= 1
    raise InfeasibleError(
        f"the app with {obstacles} obstacles takes {needs} bytes of RAM, {target.name} has "
        f"{target.ram_bytes}; {most} obstacles fit"
    )


def require_rate(
    facts: Mapping[str, Any], hulls: int, target: Target, rate_hz: float | None, obstacles: int = 0
) -> None:
    """Refuse a map whose worst tick takes longer than the period of its control rate.

    Args:
        rate_hz: the control rate; None is the default of the target's firmware.
        obstacles: maximum number of moving ones, counted in `facts`.

    Raises:
        CheckError: the tick takes too long; the message has the fraction of the period, and what fits.
    """
    rate = rate_hz or target.rate_hz
    if not rate or "tick_us" not in facts or (share := 1e-6 * facts["tick_us"] * rate) <= 1:
        return
    tick, fast = facts["tick_us"] / 1000, 1e6 / facts["tick_us"]
    beside = f" and {obstacles} moving obstacles" if obstacles > 0 else ""
    room = target.clock_hz / target.cycles_per_instruction / rate
    fixed = BASE_INSTRUCTIONS + obstacles_instructions(obstacles)
    fixed += ENTERED_INSTRUCTIONS if target.follows_late else 0
    near = facts["tick_hulls"]
    fit = math.floor(near * (room - fixed) / max(facts["tick_instructions"] - fixed, 1))
    fits = f"merge to fewer hulls (that tick evaluates {near}, {max(min(fit, near), 0)} fit)"
    if obstacles > 0:
        most = obstacles - math.ceil((facts["tick_instructions"] - room) / OBSTACLE_INSTRUCTIONS)
        fits += f", give --obstacles {most}" if most > 0 else ", leave out --obstacles"
    raise CheckError(
        f"a tick of the filter on {hulls} hulls{beside} takes up to {tick:.3g} ms on {target.name}, "
        f"{share:.3g} times its period at {rate:g} Hz; {fits}, or give --rate below {fast:.3g}"
    )


def target_facts(raw: bytes, image: MapImage, target: Target, obstacles: int = 0) -> dict[str, Any]:
    """Summary figures of a map on a target, whose app has at most this many moving obstacles.

    `share_at_R_hz` is the fraction of a control period at R Hz that the filter takes at the worst position
    that was tried.
    """
    more = obstacles_instructions(obstacles)
    worst = worst_tick(raw, image, of_chord=target.follows_late)
    hulls_at_once = worst.pop("hulls")
    worst = {k: n + more for k, n in worst.items()}
    facts: dict[str, Any] = {
        "target": target.name,
        "index_bytes": image.index_bytes,
        "tick_instructions": worst["measured"],
        "tick_instructions_bound": worst["bound"],
        "tick_hulls": hulls_at_once,
    }
    if obstacles > 0:
        facts |= {"obstacles": obstacles, "ram_bytes_left": target.ram_bytes - target.state_bytes(obstacles)}
    if target.flash_bytes:
        facts["bytes_left"] = target.map_room - len(raw)
    if target.clock_hz:
        seconds = {k: n * target.cycles_per_instruction / target.clock_hz for k, n in worst.items()}
        facts["cycles_per_instruction"] = target.cycles_per_instruction
        facts["tick_us"] = round(1e6 * seconds["measured"], 1)
        facts["tick_us_bound"] = round(1e6 * seconds["bound"], 1)
        for rate in target.rates_hz:
            facts[f"share_at_{rate}_hz"] = round(seconds["measured"] * rate, 4)
        fast = [rate for rate in target.rates_hz if seconds["measured"] * rate <= 1]
        facts["fastest_rate_hz"] = max(fast, default=None)
        facts["fastest_rate_hz_bound"] = max(
            (rate for rate in target.rates_hz if seconds["bound"] * rate <= 1), default=None
        )
    return facts
