"""The record of an alignment as a table on stderr."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from alula.cli.shell.present import echo, plain

_SHOWN = 10  # items without -v


def show_alignment(alignment: dict[str, Any], verbose: int = 0) -> None:
    """Print all figures, the ten largest residuals (with -v all of them), and the warnings."""
    for name, text in _rows(alignment):
        echo(f"  {name:<16}  {text}", err=True)
    items = sorted(alignment.get("items", []), key=lambda item: -item["residual_m"])
    shown = items if verbose else items[:_SHOWN]
    if items:
        echo("  residuals", err=True)
    for item in shown:
        angle = f"{item['residual_deg']:10.3f} deg" if "residual_deg" in item else ""
        mark = "" if item["inlier"] else "  outlier"
        echo(f"{item['residual_m']:12.4f} m{angle}  {item['item']}{mark}", err=True)
    if len(shown) < len(items):
        echo(f"{'':14}  and {len(items) - len(shown)} better ones (-v shows them)", err=True)
    for warning in alignment["warnings"]:
        echo(f"warning: {warning}", err=True)


def _rows(found: dict[str, Any]) -> Iterator[tuple[str, str]]:
    yield (
        "alignment",
        (
            f"by {found['method']}: {found['from_frame']} [{found['from_unit']}] to "
            f"{found['to_frame']} [{found['to_unit']}]"
        ),
    )
    scale = f"{found['scale']:.8g}"
    if found.get("scale_sigma") is not None:
        low, high = found["scale_interval"]
        scale += f", sigma {found['scale_sigma']:.3g}, 95 % interval {low:.8g} to {high:.8g}"
    else:
        scale += ", sigma not known"
    yield "scale", scale
    if "scale_leave_one_out" in found:
        low, high = found["scale_leave_one_out"]
        yield "leave one out", f"scale {low:.8g} to {high:.8g}"
    unmeasured = " (unchanged: not measured)" if "unmeasured" in found and "level" not in found else ""
    turn = f"w x y z {_numbers(found['q_world_scene_wxyz'], '.6f')}{unmeasured}"
    yield "rotation", turn + _margin(found, "rotation_interval_deg", "deg")
    shift = f"{_numbers(found['translation_m'], '.6g')} m{unmeasured}"
    yield "translation", shift + _margin(found, "translation_interval_m", "m")
    for number, row in enumerate(found["matrix"]):
        yield "" if number else "matrix", _numbers(row, "14.8g")
    if "map_origin_m" in found:
        yield "map origin", f"{_numbers(found['map_origin_m'], '.12g')} m of the world"
    yield "det R", f"{found['determinant']:+.9f}"
    yield from _evidence(found)
    for name in ("georeference", "nerfstudio", "initial", "level"):
        if name in found:
            yield name, plain(found[name])
    if found.get("position_error_m") is None:
        yield "position error", "not known"
    else:
        yield (
            "position error",
            f"{found['position_error_m']:.4g} m at the scene's bounds (95 %), suggested inflation",
        )


def _evidence(found: dict[str, Any]) -> Iterator[tuple[str, str]]:
    if "rms_m" not in found:
        return
    text = f"{found['inliers']} inliers of {found['count']}"
    if "threshold_m" in found:
        text += f", threshold {found['threshold_m']:g} m"
        text += f" and {found['threshold_deg']:g} deg" if "threshold_deg" in found else ""
        text += f", seed {found['seed']}" if "seed" in found else ""
    if found.get("unused"):
        text += f"; {found['unused']} cameras without a reference"
    if found.get("same_place"):
        text += f"; {found['same_place']} images at a place of another"
    if found.get("unmatched"):
        text += f"; {len(found['unmatched'])} references without a camera"
    yield "evidence", text
    if "fitness" in found:
        yield "fitness", f"{found['fitness']:.1%} of the scene, {found['cloud_fitness']:.1%} of the cloud"
        yield "uncertainty", f"from {found['uncertainty_from']}"
    for unit in ("m", "deg"):
        if f"rms_{unit}" in found:
            rms, median, largest = (found[f"{name}_{unit}"] for name in ("rms", "median", "max"))
            yield "residual", f"RMS {rms:.4g}, median {median:.4g}, max {largest:.4g} {unit}"
    if "singular_values" in found:
        yield "singular values", _numbers(found["singular_values"], ".4g")


def _margin(found: dict[str, Any], key: str, unit: str) -> str:
    return f", +- {_numbers(found[key], '.3g')} {unit} (95 %)" if key in found else ""


def _numbers(values: Sequence[float], form: str) -> str:
    return " ".join(f"{value:{form}}" for value in values)
