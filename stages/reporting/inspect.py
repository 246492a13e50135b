"""Facts about a file for `alula info`: its kind, contents and origin as plain values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.artifacts.parts import Parts
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.artifacts.tiles import TilesIndex
from alula.schemas.log.run import RunRecord
from alula.stages.compression.hulls import is_outer
from alula.stages.compression.onboard.image import SCHEMA, VERSION, MapImage
from alula.stages.compression.onboard.layout import map_facts
from alula.stages.compression.onboard.tiles import tiles_facts
from alula.stages.reconstruction.faint import marked_volume
from alula.stages.reconstruction.formats.capture import lacking
from alula.stages.reconstruction.formats.splats import LOSSES, Loss, Splats

Facts = dict[str, Any]

WHAT = {
    "alula/scene": "Gaussians of a splat: ellipsoids with opacity and colour, the obstacles.",
    "alula/voxels": "Voxels that obstacles touch; voxel i is the closed cube [i g, (i + 1) g].",
    "alula/seen": "Voxels that were seen to be free and that a vehicle can reach; all else is unknown.",
    "alula/cover": "Convex polytopes with integer planes, which together contain the voxels.",
    "alula/plan": "A trajectory: polynomials of degree 7 in time for x, y, z and yaw, piece by piece.",
    "alula/run": "Flights behind a safety filter: states, margins and how each flight ended.",
    "alula/scenario": "Definition of a simulation: map, vehicle, filter and trials.",
    "alula/vehicle": "A vehicle: body, rotors, limits, controller and disturbances.",
    "alula/report": "A report on runs, a map or a plan: a page, a document, a picture or data.",
    "alula/view": "A view of artifacts and runs: a page, a picture or a moving picture.",
    "alula/export": "A copy of a cover or a scene for another program.",
    "alula/onboard-map": "A cover as a microcontroller reads it in place from flash.",
    "alula/tiles": "A cover as an onboard map per tile, with an index that is signed if it has a key_id.",
    "alula/certificate": "The result of checking again what a cover contains.",
    "alula/demo-scene": "The built-in scene as a splat file.",
}
_COMMON = ("schema", "version", "summary", "frame", "unit", "arrays", "guarantee", "producer")
_LAST = ("parameters", "seed", "inputs", "requires")


def about(kind: str, version: str) -> Facts:
    """Kind, version and a one-sentence description."""
    return {
        "kind": kind,
        "version": version,
        "what": WHAT.get(kind, "A kind that this version of alula does not support."),
    }


def manifest_facts(raw: Mapping[str, Any]) -> Facts:
    """Facts in a manifest as stored, for any version; fields of the kind come before common ones."""
    own = {key: value for key, value in raw.items() if key not in (*_COMMON, *_LAST)}
    stored = raw.get("arrays")
    arrays = {
        str(name): {key: spec.get(key) for key in ("dtype", "shape", "unit", "meaning")}
        for name, spec in (stored.items() if isinstance(stored, dict) else ())
        if isinstance(spec, dict)
    }
    facts: Facts = {
        **about(str(raw.get("schema", "")), str(raw.get("version", ""))),
        "summary": raw.get("summary", {}),
        "properties": own,
        "frame": raw.get("frame"),
        "unit": raw.get("unit"),
        "arrays": arrays,
        "guarantee": raw.get("guarantee"),
        "producer": raw.get("producer"),
    }
    return facts | {key: raw.get(key) for key in _LAST if raw.get(key)}


def artifact_facts(artifact: Artifact) -> Facts:
    """Facts in an artifact's manifest, and a few computed from its arrays."""
    facts = manifest_facts(msgspec.to_builtins(artifact.manifest))
    measured = _MEASURES[artifact.manifest.schema](artifact)
    return _after(facts, "summary", {"measured": measured})


def parts_facts(parts: Parts) -> Facts:
    """Facts in the index of an artifact in parts, which describes the whole."""
    facts = manifest_facts(msgspec.to_builtins(parts.manifest))
    counts = [ref.count for ref in parts.refs]
    lower = np.min([ref.lower for ref in parts.refs], axis=0)
    upper = np.max([ref.upper for ref in parts.refs], axis=0)
    measured = {
        "parts": len(parts),
        "elements": sum(counts),
        "elements of a part": {"fewest": min(counts), "most": max(counts)},
        "lower": lower.tolist(),
        "upper": upper.tolist(),
    }
    if parts.kind is SCENE:
        measured["longest semi-axis"] = max(ref.reach for ref in parts.refs)
    return _after(facts, "summary", {"in parts": measured})


def _after(facts: Facts, key: str, more: Facts) -> Facts:
    items = list(facts.items())
    place = list(facts).index(key) + 1
    return dict([*items[:place], *more.items(), *items[place:]])


def _bounds(points: Any, factor: float = 1.0) -> Facts:
    if len(points) == 0:
        return {"lower": None, "upper": None}
    # Print single-precision values without the digits that doubles would add.
    low, high = (np.asarray(edge * factor) for edge in (points.min(axis=0), points.max(axis=0)))
    return {name: [float(str(value)) for value in edge] for name, edge in (("lower", low), ("upper", high))}


def _scene(scene: Artifact) -> Facts:
    opacity = np.asarray(scene["opacity"], np.float64)
    scale = np.asarray(scene["scale"], np.float64).max(axis=1, initial=0.0)
    return {
        "gaussians": len(opacity),
        **_bounds(np.asarray(scene["mean"])),
        "median opacity": float(np.median(opacity)) if len(opacity) else None,
        "median longest semi-axis": float(np.median(scale)) if len(scale) else None,
    }


def _voxels(voxels: Artifact) -> Facts:
    index, edge = np.asarray(voxels["index"], np.int64), float(voxels.manifest.voxel_size_m)  # type: ignore[attr-defined]
    facts = _bounds(np.vstack([index, index + 1]), edge)
    return {"voxels": len(index), "volume_m3": len(index) * edge**3, **facts}


def _cover(cover: Artifact) -> Facts:
    edge = float(cover.manifest.voxel_size_m)  # type: ignore[attr-defined]
    planes = np.diff(np.asarray(cover["plane_start"]))
    return {
        "hulls": len(planes),
        "polytopes": "outer" if is_outer(cover) else "hulls",
        "half-planes": int(planes.sum()),
        "half-planes per hull, most": int(planes.max(initial=0)),
        "vertices": len(cover["vertex"]),
        **_bounds(np.asarray(cover["vertex"], np.int64), edge),
    }


def _plan(plan: Artifact) -> Facts:
    time = np.asarray(plan["time"])
    return {
        "pieces": len(plan["coefficient"]),
        "duration_s": float(time[-1]) if len(time) else 0.0,
        "waypoints": len(plan["waypoint"]),
        **_bounds(np.asarray(plan["waypoint"])[:, :3]),
    }


_MEASURES = {
    "alula/scene": _scene,
    "alula/voxels": _voxels,
    "alula/seen": _voxels,
    "alula/cover": _cover,
    "alula/plan": _plan,
}


def provenance_facts(found: Provenance) -> Facts:
    """Facts about a file that carries provenance and is no array artifact."""
    facts: Facts = {**about(found.schema, found.version), "summary": found.summary}
    facts |= {"producer": msgspec.to_builtins(found.producer), "parameters": found.parameters}
    facts |= {"seed": found.seed, "inputs": msgspec.to_builtins(found.inputs)}
    return facts


def map_image_facts(image: MapImage) -> Facts:
    """Facts about an onboard map."""
    edges = np.vstack([image.lower, image.upper])
    return {
        **about(SCHEMA, VERSION),
        "summary": {**map_facts(image), **_bounds(edges, image.voxel_size_m)},
        "properties": {
            "voxel_size_m": image.voxel_size_m,
            "extent_m": image.extent_m,
            "index_bytes": image.index_bytes,
            "cover sha256 begins with": image.cover_hash.hex(),
        },
        "unit": "m",
        "guarantee": "Each hull contains a hull of the cover; `alula verify` proves this for these bytes.",
    }


def tiles_index_facts(index: TilesIndex) -> Facts:
    """Facts about a map in tiles."""
    return {
        **provenance_facts(index.provenance),
        **about(index.schema, index.version),
        "summary": tiles_facts(index),
        "properties": {
            "voxel_size_m": index.voxel_size_m,
            "first_i": index.first[0],
            "first_j": index.first[1],
            "lower_m": [index.voxel_size_m * edge for edge in index.lower],
            "upper_m": [index.voxel_size_m * edge for edge in index.upper],
            "cover sha256 begins with": index.cover_hash,
        },
        "unit": "m",
        "guarantee": "Each tile contains every hull of the cover, in its hulls or its walls; `alula verify` "
        "proves this for these bytes.",
    }


def run_facts(record: RunRecord, messages: Mapping[str, int]) -> Facts:
    """Facts about a run, from its summary and the number of messages per channel."""
    facts: Facts = {**about(record.schema, record.version), "summary": record.summary}
    facts |= {"properties": {"name": record.name, "filter": record.filter, "vehicle": record.vehicle}}
    facts |= {"timing": record.timing} if record.timing else {}
    facts |= {"messages": dict(sorted(messages.items()))}
    facts |= {"guarantee": msgspec.to_builtins(record.guarantee)}
    made = provenance_facts(record.provenance)
    return facts | {key: made[key] for key in ("producer", "parameters", "seed", "inputs")}


def splat_facts(splats: Splats) -> Facts:
    """Facts about a splat file."""
    finite = np.isfinite(splats.mean).all(axis=1) & np.isfinite(splats.scale).all(axis=1)
    finite &= np.isfinite(splats.quat_wxyz).all(axis=1) & np.isfinite(splats.opacity)
    opacity = splats.opacity[finite].astype(np.float64)
    return {
        "kind": f"splat file: {splats.format}",
        "version": "",
        "what": "Gaussians from a training run or an editor; import-splat converts them to a scene.",
        "summary": {
            "gaussians": len(splats),
            "not finite": int(len(splats) - finite.sum()),
            **_bounds(splats.mean[finite]),
            "median opacity": float(np.median(opacity)) if len(opacity) else None,
            **_largest(splats.scale[finite]),
        },
        "opacity, quantiles": _quantiles(opacity),
        "removed by a minimum opacity": _opacity_facts(splats),
        "frame": "scene",
        "unit": "arbitrary",
        "lost by the format": _loss_facts(splats.loss),
        "lacks of its capture": lacking(splats.levels),
        "properties applied": list(splats.properties.applied),
        "properties of unknown meaning": list(splats.properties.unknown),
        "tags": splats.tags,
        "comments": list(splats.comments),
        "notes": list(splats.notes),
    }


def _quantiles(opacity: NDArray[np.float64]) -> Facts:
    """Quantiles by percentage; empty without rows."""
    if not len(opacity):
        return {}
    shares = (0, 5, 25, 50, 75, 95, 100)
    found = np.percentile(opacity, shares).tolist()
    return {f"{share} %": round(value, 6) for share, value in zip(shares, found, strict=True)}


def _opacity_facts(splats: Splats) -> list[Facts]:
    """Rows, fractions of the rows and fractions of the marked volume that limits of the opacity remove."""
    volume = marked_volume(splats.mean, splats.scale, splats.quat_wxyz, splats.opacity)
    if volume is None:
        return []
    return [
        {
            "--min-opacity": one.limit,
            "gaussians": one.gaussians,
            "of all": round(one.gaussians / len(splats), 4),
            "of the volume": round(volume.share(one), 4),
        }
        for one in volume.limits
    ]


def _largest(scale: NDArray[np.float32]) -> Facts:
    """Median and largest of the longest semi-axes."""
    if not len(scale):
        return {}
    longest = scale.max(axis=1)
    return {"median longest semi-axis": float(np.median(longest)), "largest semi-axis": float(longest.max())}


def _loss_facts(loss: Loss | None) -> Facts | None:
    """Maximum of each bound on the loss."""
    if loss is None:
        return None
    largest = {name: float(column.max()) for name, column in zip(LOSSES, loss.bound.T, strict=True)}
    return largest | {"opacity": loss.opacity, **{f"no bound of {k}": v for k, v in loss.unbounded.items()}}
