"""What was measured for every row of PolyMerge, with a verdict: maps of our scenes, and flights in them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Any

from alula.schemas.parameters.filter_options import PolytopeCbfParameters
from alula.stages.reporting.statistics import difference_estimate, ratio_estimate
from alula.stages.reporting.table import text
from papers.compared import File, Measured, Verdict, measured
from papers.papers import POLYMERGE
from papers.polymerge.cells import published_interval
from papers.polymerge.flights import (
    OURS,
    RULE,
    SAFER,
    Flights,
    nearest,
    path_ratio,
    time_ratio,
)
from papers.polymerge.maps import Polytopes, SceneMaps
from papers.published import POLYMERGE_FLIGHTS, POLYMERGE_SCENES, POLYMERGE_SIZES
from papers.verdicts import above, holds, settings, stated

_FULL = 1e-9  # of the voxels' volume; the rounding of planes causes far smaller errors
_FLASH_BYTES = 2**20  # of the microcontroller of a Crazyflie 2.1


def verdict_rows(
    scenes: Sequence[SceneMaps],
    figure_5: Sequence[Flights],
    table_2: Sequence[Flights],
    onboard_hz: float | None,
    in_firmware: Sequence[Flights] = (),
) -> list[Measured]:
    """List the rows in the order of the paper.

    Args:
        scenes: maps of our scenes.
        figure_5: flights of every method in each scene.
        table_2: flights over the number of hulls.
        onboard_hz: rate of the filter with 150 hulls on an emulated Cortex-M4 of 168 MHz; None: not measured.
        in_firmware: flights over the number of hulls by the app in the Crazyflie's firmware.
    """
    rows = [
        settings(POLYMERGE, "kappa", [PolytopeCbfParameters().kappa_per_m]),
        *stated(POLYMERGE, "tolerance"),
        *_sizes(scenes),
        *_columns(scenes),
        *_volumes(scenes),
        *_curves(scenes),
        *_without_coacd(scenes),
    ]
    for scene in dict.fromkeys(f.scene for f in figure_5):
        here = {f.method: f for f in figure_5 if f.scene == scene}
        rows += _figure_5(scene, here)
    return [
        *rows,
        *_figure_3(table_2),
        *_table_2(table_2),
        *_by_hulls(in_firmware, "crazyflie", "table-2-crazyflie"),
        *_rates(onboard_hz),
        *stated(POLYMERGE, "figures-1-2", "figure-3/photograph", "voxels", "sub-cover", "merging", "finer"),
        *stated(
            POLYMERGE,
            "simulation",
            "clf",
            "crazyflie/hardware",
            "scenes/nine",
            "sugar",
            "theorem-1",
            "floaters",
        ),
    ]


def _ours(scenes: Iterable[SceneMaps]) -> list[Polytopes]:
    return [s.same_count["default"] for s in scenes]


def _coacd(scenes: Iterable[SceneMaps]) -> list[Polytopes]:
    return [found for s in scenes if (found := s.same_count.get("coacd")) is not None]


def _over(
    row: str, verdict: Verdict, maps: Sequence[Polytopes], values: Sequence[float], **words: Any
) -> Measured:
    """The range of values over our scenes; `most` is unknown where it reads as `least`."""
    return measured(row, verdict, _maps(maps), **_range(values), **words)


def _maps(maps: Iterable[Polytopes]) -> list[File]:
    """Maps as what a row is made from."""
    return [File(m.file) for m in maps]


def _range(values: Sequence[float], ending: str = "") -> dict[str, float | None]:
    low, high = float(min(values)), float(max(values))
    return {f"least{ending}": low, f"most{ending}": None if text(low) == text(high) else high}


def _sizes(scenes: Sequence[SceneMaps]) -> list[Measured]:
    """Table I: ratios."""
    maps = _ours(scenes)
    whole = [s.scene_bytes / m.file_bytes for s, m in zip(scenes, maps, strict=True) if m.file_bytes]
    geometry = [
        40 * s.ellipsoids / m.onboard_bytes for s, m in zip(scenes, maps, strict=True) if m.onboard_bytes
    ]
    rows = [
        _over("memory-ratio/files", "not comparable", maps, whole),
        _over("memory-ratio/geometry", "not comparable", maps, geometry),
    ]
    for row, found, printed in (
        ("planes-per-hull", maps, [planes / hulls for _, hulls, planes in POLYMERGE_SCENES]),
        (
            "planes-per-part",
            _coacd(scenes),
            [s[2] / p[1] for s, p in zip(POLYMERGE_SIZES, POLYMERGE_SCENES, strict=True)],
        ),
    ):
        each = [m.half_planes / m.hulls for m in found]
        if each:
            overlap = min(printed) <= max(each) and min(each) <= max(printed)
            outside: Verdict = "better" if max(each) < min(printed) else "refuted"
            rows.append(_over(row, holds(overlap, outside), found, each))
    each = [1.0 * m.onboard_bytes / m.half_planes for m in maps if m.onboard_bytes]
    limit = POLYMERGE.limit("bytes-per-plane")
    return [*rows, _over("bytes-per-plane", "better" if max(each) < limit else "refuted", maps, each)]


def _columns(scenes: Sequence[SceneMaps]) -> list[Measured]:
    """The columns of Table I, which are of scenes that are not at hand, and what follows from them."""
    made_of = _maps([*_ours(scenes), *_coacd(scenes)])
    ours = [(s, s.same_count["default"]) for s in scenes]
    theirs = [(s, found) for s in scenes if (found := s.same_count.get("coacd")) is not None]
    columns: dict[str, tuple[list[tuple[SceneMaps, Polytopes]], Callable[[SceneMaps, Polytopes], float]]] = {
        "ellipsoids": (ours, lambda s, m: s.ellipsoids),
        "file of the ellipsoids [MB]": (ours, lambda s, m: s.scene_bytes / 1e6),
        "hulls, the same for both": (ours, lambda s, m: m.hulls),
        "half-planes, surface + CoACD": (theirs, lambda s, m: m.half_planes),
        "file, surface + CoACD [MB]": (theirs, lambda s, m: (m.file_bytes or 0) / 1e6),
        "half-planes, ours": (ours, lambda s, m: m.half_planes),
        "file, ours [MB]": (ours, lambda s, m: (m.file_bytes or 0) / 1e6),
    }
    rows = [
        measured(
            f"table-1/{name}",
            "not comparable",
            made_of,
            scenes=[[s.name, float(value(s, m))] for s, m in found],
        )
        for name, (found, value) in columns.items()
    ]
    if theirs:
        both = [(s.same_count["default"], found) for s, found in theirs]
        ratios = [m.half_planes / found.half_planes for m, found in both]
        fewer = sum(ratio < 1 for ratio in ratios)
        verdict: Verdict = "better" if fewer == len(ratios) else "bounded" if fewer else "reproduced"
        pairs = [m for pair in both for m in pair]
        rows.append(_over("more-planes", verdict, pairs, ratios, fewer=fewer, of=len(ratios)))
    curves = [m for s in scenes for m in s.curves.get("default", ())]
    small = [m for m in curves if m.onboard_bytes and 100 < m.hulls <= 150]
    if small:
        sizes = [m.onboard_bytes or 0 for m in small]
        fits = max(sizes) < _FLASH_BYTES
        rows.append(_over("flash", holds(fits), small, [size / 1024 for size in sizes]))
    return rows


def _volumes(scenes: Sequence[SceneMaps]) -> list[Measured]:
    """Figure 4a."""
    rows = []
    maps, parts = _ours(scenes), _coacd(scenes)
    if ours := [m.measure for m in maps if m.measure is not None]:
        whole = all(m.filled >= 1 - _FULL for m in ours)
        count = {"open": sum(m.open_voxels for m in ours), "voxels": sum(m.voxels for m in ours)}
        rows.append(_over("figure-4a-ours", holds(whole), maps, [m.filled for m in ours], **count))
    if theirs := [m.measure for m in parts if m.measure is not None]:
        leaves_out = all(m.filled < 1 - _FULL for m in theirs)
        rows.append(_over("figure-4a-coacd", holds(leaves_out), parts, [m.filled for m in theirs]))
    each = [m.conservativeness for m in maps]
    return [*rows, _over("figure-4a-volume", "not comparable", maps, each)]


def _curves(scenes: Sequence[SceneMaps]) -> list[Measured]:
    """Figure 4b."""
    rows = []
    for method, row in (("paper", "figure-4b/rule"), ("default", "figure-4b/ours")):
        curves = [c for s in scenes if len(c := s.curves.get(method, ())) > 1]
        if not curves:
            continue
        falls = all(b.conservativeness <= a.conservativeness for c in curves for a, b in pairwise(c))
        first, last = ([c[end].conservativeness for c in curves] for end in (0, -1))
        rows.append(
            measured(
                row,
                holds(falls),
                _maps(m for c in curves for m in c),
                **_range(first),
                **_range(last, "_last"),
                scenes=len(curves),
                few=curves[0][0].hulls,
                many=max(c[-1].hulls for c in curves),
            )
        )
    return rows


def _without_coacd(scenes: Sequence[SceneMaps]) -> list[Measured]:
    """The baseline where it found no parts."""
    notes = "; ".join(f"{s.name}: {s.coacd_note}" for s in scenes if "coacd" not in s.same_count)
    return [measured("scenes/coacd", "not available here", notes=notes)] if notes else []


def _files(what: str, *flown: Flights) -> list[File]:
    """Flights as what a row is made from."""
    return [File(f"{f.scene}.{what}.json", len(f.reached)) for f in flown]


def _figure_5(scene: str, here: dict[str, Flights]) -> list[Measured]:
    ours = here.get(OURS)
    if ours is None:
        return []
    times, rates, lengths = [], [], []
    for method, theirs in here.items():
        made_of, words = _files("figure-5", ours, theirs), {"scene": scene, "method": method}
        ratio = time_ratio(theirs, ours) if method.startswith(SAFER) else None
        if ratio is not None:
            limit = POLYMERGE.limit("figure-5a")
            high, low = (ratio.value if end is None else end for end in (ratio.high, ratio.low))
            verdict: Verdict = "refuted" if high < limit else "better" if low > limit else "reproduced"
            us = {"theirs_us": theirs.filter_us, "ours_us": ours.filter_us}
            times.append(measured("figure-5a", verdict, made_of, ratio, value=ratio.value, **us, **words))
        if method in (OURS, RULE):
            continue
        more = difference_estimate(ours.succeeded, theirs.succeeded, bounds=(-1, 1))
        if more is not None and more.low is not None and more.high is not None:
            rates.append(
                measured(
                    "figure-5b",
                    above(more, 0, "bounded"),
                    made_of,
                    (100 * more.low, 100 * more.high),
                    ours=ours.success.value,
                    theirs=theirs.success.value,
                    value=100 * more.value,
                    pairs=len(ours.reached),
                    **words,
                    collided=sum(ours.collided),
                    collided_theirs=sum(theirs.collided),
                    inside=sum(ours.inside),
                    inside_theirs=sum(theirs.inside),
                )
            )
        length = path_ratio(theirs, ours, (ours, theirs))
        if length is not None:
            values = {"value": length.value, "pairs": length.n}
            verdict = above(length, 1, "bounded")
            lengths.append(measured("figure-5c", verdict, made_of, length, **values, **words))
    return [*times, *rates, *lengths]


def _figure_3(table_2: Sequence[Flights]) -> list[Measured]:
    """Figure 3: detours with few hulls."""
    if len(table_2) < 2:
        return []
    coarse, fine = table_2[0], table_2[-1]
    both = [i for i, (a, b) in enumerate(zip(coarse.succeeded, fine.succeeded, strict=True)) if a and b]
    ratio = ratio_estimate([coarse.path_m[i] for i in both], [fine.path_m[i] for i in both])
    if ratio is None:
        return []
    return [
        measured(
            "figure-3/paths",
            above(ratio, 1, "bounded"),
            _files("table-2", coarse, fine),
            ratio,
            coarse=coarse.hulls,
            fine=fine.hulls,
            value=ratio.value,
            both=len(both),
            arrive=sum(coarse.succeeded),
            arrive_fine=sum(fine.succeeded),
            of=len(fine.reached),
        )
    ]


def _by_hulls(flown: Sequence[Flights], claim: str, what: str) -> list[Measured]:
    """Success and minimum distance by the number of hulls, of the rows of a claim."""
    rows = []
    for n, _, success, _ in POLYMERGE_FLIGHTS:
        f = next((f for f in flown if f.hulls is not None and 0.9 * n <= f.hulls <= n), None)
        if f is None:
            continue
        low, high = published_interval(success)
        found, made_of = f.success, _files(what, f)
        is_within = found.value is not None and low <= found.value / 100 <= high
        counts = {"inside": sum(f.inside), "collided": sum(f.collided), "outside": f.collided_outside}
        rows += [
            measured(
                f"{claim}/{n}/success",
                holds(is_within, "not comparable"),
                made_of,
                found,
                value=found.value,
                flights=len(f.reached),
                **counts,
            ),
            measured(
                f"{claim}/{n}/distance",
                "bounded" if f.collided_outside == 0 else "refuted",
                made_of,
                ellipsoids_m=nearest(f, f.distance_m),
                map_m=nearest(f, f.map_distance_m),
                flights=len(f.outside),
                outside=f.collided_outside,
                radius_m=f.radius_m,
            ),
        ]
    return rows


def _table_2(table_2: Sequence[Flights]) -> list[Measured]:
    rows = _by_hulls(table_2, "table-2", "table-2")
    if len(table_2) > 1:
        first, last = (nearest(f, f.map_distance_m or f.distance_m) for f in (table_2[0], table_2[-1]))
        falls = first is not None and last is not None and first > last
        rows.append(measured("trend", holds(falls), _files("table-2", *table_2), first=first, last=last))
    return rows


def _rates(onboard_hz: float | None) -> list[Measured]:
    rows = []
    for n, hz, *_ in POLYMERGE_FLIGHTS:
        verdict: Verdict = "refuted" if n == POLYMERGE_FLIGHTS[-1][0] else "not comparable"
        if onboard_hz is None or onboard_hz > hz:
            verdict = "not available here" if onboard_hz is None else "better"
        shown = None if onboard_hz is None else float(round(onboard_hz))
        rows.append(measured(f"table-2/{n}/rate", verdict, hz=shown))
    return rows
