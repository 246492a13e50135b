"""The page of `scale.py`."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from typing import Any


def page(
    rows: Sequence[Any], figures: dict[str, Any], setting: Any, source: str, per_hull: int, note: str
) -> str:
    """Write the page."""
    biggest = rows[-1]
    exponent, per_million = figures["growth_exponent"], figures["seconds_per_million"]
    at_billion = per_million * 1000 * (1000e6 / biggest.gaussians) ** (exponent - 1)
    lines = [
        "# Scale",
        "",
        "This page says what a scene of any size costs, from its files to verified tile maps, and what",
        "a larger one would.",
        "",
        f"Written by `python benchmarks/scale.py --markdown docs/scale.md` on {platform.machine()},",
        f"{os.cpu_count()} processors, Python {platform.python_version()}. Cities are {source},",
        f"repeated with jitter; voxels of {setting.voxel_m:g} m, blocks of {setting.block_m:g} m, tiles of",
        f"{setting.tile_m:g} m with a reach of {setting.reach_m:g} m, a hull for every {per_hull} Gaussians.",
        "Memory is that of all processes of a command together, shared pages counted in each.",
        *([note] if note else []),
        "",
        "| million Gaussians | km² | workers | step | CPU s | elapsed s | peak MB | largest process, MB |"
        " result |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        for name, cost in row.cost.items():
            lines.append(
                f"| {row.gaussians / 1e6:.2f} | {row.area_km2:.3f} | {row.workers} | {name} |"
                f" {cost.cpu_s:.1f} | {cost.wall_s:.1f} | {cost.peak_mb:.0f} | {cost.largest_mb:.0f} |"
                f" {_result(name, cost)} |"
            )
    lines += [
        "",
        "| million Gaussians | workers | CPU s per million | elapsed s | peak MB | hulls per km² |"
        " bytes of all tiles |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        hulls = int(_summary(row.cost["merge"]).get("hulls", 0))
        size = _summary(row.cost["export"]).get("image_bytes", "") if "export" in row.cost else ""
        lines.append(
            f"| {row.gaussians / 1e6:.2f} | {row.workers} | {row.total('cpu_s') / row.gaussians * 1e6:.1f} |"
            f" {row.total('wall_s'):.0f} | {row.peak_mb:.0f} | {hulls / row.area_km2:,.0f} | {size} |"
        )
    lines += [
        "",
        f"Processor time grows with the power {exponent:.3f} of the number of Gaussians. By this fit",
        f"10⁹ Gaussians take {at_billion / 3600:.1f} hours of one processor. That is an estimate: nothing of",
        "that size was run, and on a cluster the network adds to it.",
        "",
        "| figure | value |",
        "| --- | --- |",
        *(f"| `{name}` | {value:.4g} |" for name, value in figures.items()),
        "",
    ]
    return "\n".join(lines)


def _summary(cost: Any) -> dict[str, Any]:
    return dict(cost.facts.get("summary", cost.facts))


def _result(name: str, cost: Any) -> str:
    wanted = {
        "import-splat": ("gaussians", "parts"),
        "voxelize": ("voxels", "parts"),
        "merge": ("hulls", "half_planes", "conservativeness"),
        "export": ("tiles", "largest_image_bytes"),
        "verify": ("covered",),
        "verify tiles": ("covered",),
    }
    facts = cost.facts | _summary(cost)
    return ", ".join(f"{key} {_shown(facts[key])}" for key in wanted.get(name, ()) if key in facts)


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return str(value)
    return (
        f"{value:,}" if isinstance(value, int) else f"{value:.6g}" if isinstance(value, float) else str(value)
    )
