"""Export of covers, voxels and scenes to the formats of other programs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import numpy as np

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.manifest import map_origin
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.errors import UsageError, WrongKindError
from alula.stages.compression.hulls import Hulls
from alula.stages.compression.onboard.layout import map_binary, map_c_header
from alula.stages.export import bodies, grids
from alula.stages.export.pieces import ROUNDED, hull_color, hull_name, obj_object, pieces
from alula.stages.export.scene import COPIED, SCENE_ENCODERS

_UP_IN_GLTF = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # alula: z up; glTF: y up

Encoder = Callable[[Artifact, Provenance], Iterator[bytes]]


def export(artifact: Artifact, format_name: str, provenance: Provenance) -> Iterator[bytes]:
    """Write a cover or a scene in another format, in parts.

    JSON holds the exact integers of a cover. An onboard map (also as a C header) holds integers rounded
    outward, so its hulls contain the cover. All other formats hold rounded numbers, and a note says so where
    the format has room for one. Except in onboard maps, hulls keep their order and are named hull-00000,
    hull-00001, ... where the format has names.

    Coordinates are those of the map; `located` records where its origin is.

    Args:
        artifact: an `alula/cover`, `alula/voxels` or `alula/scene`.
        format_name: a key of `ENCODERS` for the kind of the artifact.
        provenance: recorded in the file, except in `.splat`, which has no room for it. Its parameters
            `largest_normal` and `name` apply to an onboard map, `spz_version` to an SPZ file.

    Raises:
        WrongKindError: the artifact is of another kind.
        UsageError: the kind cannot be written in that format.
        InputError: a value is too large for that format.
    """
    encoders = ENCODERS.get(artifact.manifest.schema)
    if encoders is None:
        raise WrongKindError(
            f"is {artifact.manifest.schema}; only alula/cover, alula/voxels and alula/scene can be exported"
        )
    if format_name not in encoders:
        what = artifact.manifest.schema.removeprefix("alula/")
        subject = "voxels are" if what == "voxels" else f"a {what} is"
        raise UsageError(f"{subject} exported as {', '.join(encoders)}, not as {format_name}")
    return encoders[format_name](artifact, located(provenance, artifact))


def located(provenance: Provenance, artifact: Artifact) -> Provenance:
    """Provenance whose summary has `map_origin_m`, if the map has an origin of its own in the world."""
    origin = map_origin(artifact.manifest)
    if origin is None:
        return provenance
    return msgspec.structs.replace(provenance, summary={**provenance.summary, "map_origin_m": origin})


def _cover_json(cover: Artifact, provenance: Provenance) -> Iterator[bytes]:
    manifest: Any = cover.manifest
    hulls = Hulls.from_cover(cover)
    integer = np.column_stack([cover["plane_normal"], cover["plane_offset"]])
    records = []
    for number in range(len(hulls)):
        members = slice(*cover["vertex_start"][number : number + 2].tolist())
        planes = slice(hulls.plane_start[number], hulls.plane_start[number + 1])
        corners = slice(hulls.vertex_start[number], hulls.vertex_start[number + 1])
        metres = np.column_stack([hulls.normal_world[planes], hulls.offset_m[planes]])
        records.append(
            {
                "name": hull_name(number),
                "vertices": np.asarray(cover["vertex"][members]).tolist(),
                "planes": integer[planes].tolist(),
                "vertices_m": hulls.vertices_world[corners].tolist(),
                "planes_m": metres.tolist(),
            }
        )
    document = {
        "schema": "alula/cover-json",
        "about": "normal . x <= offset for each plane [nx, ny, nz, offset]; planes and vertices are exact "
        "integers in units of voxel_size_m, planes_m has unit normals and is rounded outward; vertices_m are "
        "the corners of the polytope, rounded, vertices those of the hull of its voxels: the same, unless "
        "polytopes is outer",
        "polytopes": manifest.polytopes,
        "frame": manifest.frame,
        "voxel_size_m": manifest.voxel_size_m,
        "sigma": manifest.sigma,
        "imported": manifest.imported,
        "conservativeness": manifest.conservativeness,
        "certificate": manifest.certificate,
        "guarantee": manifest.guarantee,
        "hulls": records,
        "provenance": provenance,
    }
    yield msgspec.json.encode(document, order="sorted") + b"\n"


def _cover_obj(cover: Artifact, provenance: Provenance) -> Iterator[bytes]:
    yield _comment(provenance, ROUNDED, "Metres, z up; one object per hull.")
    first = 1
    for name, points, faces in pieces(cover):
        yield obj_object(name, points, faces, first)
        first += len(points)


def _scene_obj(scene: Artifact, provenance: Provenance) -> Iterator[bytes]:
    yield _comment(provenance, COPIED, f"Centres of Gaussians, {scene.manifest.unit}, with colours.")
    color = np.asarray(scene["color"]) / 255.0
    for (x, y, z), (r, g, b) in zip(np.asarray(scene["mean"]).tolist(), color.tolist(), strict=True):
        yield f"v {x:.9g} {y:.9g} {z:.9g} {r:.4f} {g:.4f} {b:.4f}\n".encode()


def _comment(provenance: Provenance, *notes: str) -> bytes:
    return "".join(f"# {line}\n" for line in (provenance.line(), *notes)).encode()


def _cover_stl(cover: Artifact, provenance: Provenance) -> Iterator[bytes]:
    """Write ASCII STL, one solid per hull; the name of the first solid carries the provenance."""
    note = provenance.line({"note": ROUNDED})
    for word in ("solid", "facet"):  # readers split the text at these words
        note = note.replace(word, f"\\u{ord(word[0]):04x}{word[1:]}")
    if len(cover["plane_start"]) == 1:
        yield f"solid empty {note}\nendsolid empty\n".encode()
    for number, (name, points, faces) in enumerate(pieces(cover)):
        corners = points[faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(float).tiny)
        lines = [f"solid {name}" + (f" {note}" if number == 0 else "")]
        for n, triangle in zip(normal.tolist(), corners.tolist(), strict=True):
            lines.append("facet normal {:.9g} {:.9g} {:.9g}\nouter loop".format(*n))
            lines += ["vertex {!r} {!r} {!r}".format(*corner) for corner in triangle]
            lines.append("endloop\nendfacet")
        yield ("\n".join([*lines, f"endsolid {name}"]) + "\n").encode()


def _cover_glb(cover: Artifact, provenance: Provenance) -> Iterator[bytes]:
    import trimesh

    scene = trimesh.Scene()
    for number, (name, points, faces) in enumerate(pieces(cover)):
        solid = trimesh.Trimesh(points, faces, process=False)
        solid.visual.vertex_colors = np.array([*hull_color(number), 255], np.uint8)
        scene.add_geometry(solid, node_name=name, geom_name=name, transform=_UP_IN_GLTF)
    yield _glb(scene, provenance, ROUNDED)


def _scene_glb(scene: Artifact, provenance: Provenance) -> Iterator[bytes]:
    import trimesh

    color = np.column_stack([scene["color"], np.full(len(scene["color"]), 255, np.uint8)])
    cloud = trimesh.PointCloud(np.asarray(scene["mean"], np.float64), color)
    graph = trimesh.Scene()
    graph.add_geometry(cloud, node_name="gaussians", geom_name="gaussians", transform=_UP_IN_GLTF)
    yield _glb(graph, provenance, COPIED)


def _glb(scene: Any, provenance: Provenance, note: str) -> bytes:
    from trimesh.exchange.gltf import export_glb

    def describe(tree: dict[str, Any]) -> None:
        tree["asset"]["extras"] = {"provenance": msgspec.to_builtins(provenance), "note": note}

    return bytes(export_glb(scene, include_normals=False, tree_postprocessor=describe))


ENCODERS: dict[str, dict[str, Encoder]] = {
    "alula/cover": {
        "glb": _cover_glb,
        "obj": _cover_obj,
        "json": _cover_json,
        "stl": _cover_stl,
        "mjcf": bodies.mjcf,
        "usda": bodies.usda,
        "geojson": grids.geojson,
        "field": grids.field,
        "onboard": map_binary,
        "c-header": map_c_header,
    },
    "alula/voxels": {"octomap": grids.octomap, "ply": grids.voxels_ply, "pcd": grids.voxels_pcd},
    "alula/scene": {**SCENE_ENCODERS, "glb": _scene_glb, "obj": _scene_obj},
}
