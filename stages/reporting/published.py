"""Published values of the papers, and tables that set ours beside them."""

from __future__ import annotations

from typing import Any

import numpy as np

from alula.schemas.errors import UsageError
from alula.stages.reporting.material import Material, Run

Parts = tuple[str, str, tuple[str, ...], tuple[tuple[Any, ...], ...], str]

# PolyMerge, Table I: hulls and half-planes (in thousands as printed) per scene.
POLYMERGE_SCENES = (
    ("Bicycle", 3296, 258_000),
    ("Flowers", 2624, 209_000),
    ("Garden", 1006, 80_000),
    ("Stump", 2458, 207_000),
    ("Treehill", 2681, 217_000),
    ("Room", 454, 33_000),
    ("Counter", 1367, 82_000),
    ("Kitchen", 901, 69_000),
    ("Bonsai", 2080, 172_000),
)
# PolyMerge, Table II: hulls, control rate [Hz], success, minimum distance [m].
POLYMERGE_FLIGHTS = (
    (10, 500, 0.7, 0.268),
    (30, 250, 0.8, 0.253),
    (50, 250, 1.0, 0.098),
    (100, 167, 0.8, 0.117),
    (150, 125, 0.9, 0.097),
)
POLYMERGE_BYTES_PER_HALF_PLANE = 235


def paper_tables(paper: str, material: Material) -> list[Parts]:
    """Name, title, columns, rows and note of the tables that a paper adds.

    Raises:
        UsageError: there is nothing of ours to set beside the published values.
    """
    if paper != "polymerge":
        raise UsageError(f"--paper {paper}: no published values are known")
    tables = []
    if material.cover is not None:
        tables.append(_polymerge_sizes(material))
    if material.runs:
        tables.append(_polymerge_flights(material))
    if not tables:
        raise UsageError("--paper polymerge needs a run or --cover")
    return tables


def _polymerge_sizes(material: Material) -> Parts:
    cover = material.cover
    assert cover is not None
    hulls, planes = len(cover["plane_start"]) - 1, len(cover["plane_offset"])
    name = next((ref.name for ref in material.inputs if ref.role == "cover"), "cover")
    size = material.file_bytes.get("cover")
    rows: list[tuple[Any, ...]] = [
        (f"ours: {name}", hulls, planes, planes / hulls if hulls else None, size, _ratio(size, planes))
    ]
    rows += [
        (
            f"published: {scene}",
            n,
            f,
            f / n,
            f * POLYMERGE_BYTES_PER_HALF_PLANE,
            POLYMERGE_BYTES_PER_HALF_PLANE,
        )
        for scene, n, f in POLYMERGE_SCENES
    ]
    columns = (
        "scene",
        "hulls",
        "half-planes",
        "half-planes per hull",
        "file [bytes]",
        "bytes per half-plane",
    )
    note = (
        "Published half-planes are printed in thousands; their bytes are computed from the "
        "235 per half-plane that the paper states. "
        "Scenes differ, so only counts per hull and bytes per half-plane compare."
    )
    return "polymerge-1", "PolyMerge, Table I: size of the map", columns, tuple(rows), note


def _ratio(value: float | None, by: float) -> float | None:
    return value / by if value is not None and by else None


def _polymerge_flights(material: Material) -> Parts:
    ours: dict[int | None, list[Run]] = {}
    for run in material.runs:
        ours.setdefault(hulls_of(run, material), []).append(run)
    published = {row[0]: row[1:] for row in POLYMERGE_FLIGHTS}
    counts: list[int | None] = [*sorted({n for n in ours if n is not None} | published.keys())]
    rows: list[tuple[Any, ...]] = []
    for n in counts + ([None] if None in ours else []):
        printed = published.get(n, (None, None, None)) if n is not None else (None, None, None)
        rows += [(n, *printed, *_flown(run)) for run in ours.get(n, [])] or [(n, *printed, *_flown(None))]
    columns = (
        "hulls",
        "published: rate [Hz]",
        "published: success",
        "published: minimum distance [m]",
        "ours: run",
        "ours: trials",
        "ours: success",
        "ours: 95 % low",
        "ours: 95 % high",
        "ours: minimum distance [m]",
    )
    note = "The published flights are of another scene. Ours: distance of the vehicle's sphere to the hulls."
    return "polymerge-2", "PolyMerge, Table II: success over the number of hulls", columns, tuple(rows), note


def _flown(run: Run | None) -> tuple[Any, ...]:
    if run is None:
        return (None,) * 6
    summary = run.record.summary
    low, high = summary.get("success_interval") or (None, None)
    rate, least = summary.get("success_rate"), summary.get("min_map_clearance_m")
    return run.label, len(run.record.trials), rate, low, high, least


def hulls_of(run: Run, material: Material) -> int | None:
    """Hulls of the map that a run flew through: as it says, or of the given cover when it was its input."""
    if run.hulls is not None:
        return run.hulls
    cover_hash = next((ref.sha256 for ref in material.inputs if ref.role == "cover"), None)
    if material.cover is not None and cover_hash is not None:
        used = {ref.sha256 for ref in run.record.provenance.inputs}
        if cover_hash in used:
            return len(np.asarray(material.cover["plane_start"])) - 1
    return None
