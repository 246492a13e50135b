"""Covers for physics engines: each hull becomes one convex collision body.

All numbers are metres, z up, in the cover's frame. Corners are rounded to the format's precision: double
precision in MJCF and in the OBJ meshes of URDF and SDF, single precision in USD.
"""

from __future__ import annotations

from collections.abc import Iterator
from xml.sax.saxutils import escape

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.provenance import Provenance
from alula.stages.export.pieces import ROUNDED, hull_color, obj_object, pieces

Files = Iterator[tuple[str, bytes]]


def mjcf(cover: Artifact, provenance: Provenance) -> Iterator[bytes]:
    """Write MuJoCo's model: a mesh and a geom per hull, in a body of the world that does not move.

    MuJoCo keeps vertices in single precision, about the middle of each hull.
    """
    yield _head(provenance)
    yield b'<mujoco model="map">\n  <asset>\n'
    names = []
    for name, points, _ in pieces(cover):
        names.append(name)
        yield f'    <mesh name="{name}" inertia="convex" vertex="{_numbers(points)}"/>\n'.encode()
    yield b'  </asset>\n  <worldbody>\n    <body name="map">\n'
    for number, name in enumerate(names):
        color = " ".join(f"{c / 255:.3f}" for c in hull_color(number))
        yield f'      <geom name="{name}" type="mesh" mesh="{name}" rgba="{color} 1"/>\n'.encode()
    yield b"    </body>\n  </worldbody>\n</mujoco>\n"


def usda(cover: Artifact, provenance: Provenance) -> Iterator[bytes]:
    """Write USD as text: each hull is a mesh, whose convex hull is a collider of the physics schema."""
    yield (
        f'#usda 1.0\n# {provenance.line({"note": ROUNDED})}\n(\n    defaultPrim = "map"\n'
        '    metersPerUnit = 1\n    upAxis = "Z"\n)\n\ndef Xform "map" (\n    kind = "component"\n)\n{\n'
    ).encode()
    for number, (name, points, faces) in enumerate(pieces(cover)):
        single = points.astype(np.float32)
        color = ", ".join(f"{c / 255:.3f}" for c in hull_color(number))
        corners = ", ".join(f"({x}, {y}, {z})" for x, y, z in single.tolist())
        extent = ", ".join(f"({x}, {y}, {z})" for x, y, z in (single.min(axis=0), single.max(axis=0)))
        yield (
            f'    def Mesh "{name.replace("-", "_")}" (\n'
            '        prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsMeshCollisionAPI"]\n    )\n    {\n'
            '        uniform token physics:approximation = "convexHull"\n'
            "        bool physics:collisionEnabled = 1\n"
            '        uniform token subdivisionScheme = "none"\n'
            f"        float3[] extent = [{extent}]\n"
            f"        int[] faceVertexCounts = [{', '.join(['3'] * len(faces))}]\n"
            f"        int[] faceVertexIndices = [{', '.join(map(str, faces.ravel().tolist()))}]\n"
            f"        point3f[] points = [{corners}]\n"
            f"        color3f[] primvars:displayColor = [({color})]\n    }}\n"
        ).encode()
    yield b"}\n"


def urdf(cover: Artifact, provenance: Provenance) -> Files:
    """Write a robot description with one fixed link, and the mesh of each hull beside it."""
    lines = [_head(provenance).decode(), '<robot name="map">\n  <link name="map">\n']
    for name, points, faces in pieces(cover):
        yield f"{name}.obj", obj_object(name, points, faces)
        mesh = f'<geometry><mesh filename="{name}.obj"/></geometry>'
        lines.append(f'    <visual name="{name}">{mesh}</visual>\n')
        lines.append(f'    <collision name="{name}">{mesh}</collision>\n')
    yield "map.urdf", ("".join(lines) + "  </link>\n</robot>\n").encode()


def gazebo(cover: Artifact, provenance: Provenance) -> Files:
    """Write a model of Gazebo: `model.config`, `model.sdf` of SDFormat 1.9, and the mesh of each hull."""
    lines = [
        _head(provenance).decode(),
        '<sdf version="1.9">\n  <model name="map">\n    <static>true</static>\n',
    ]
    lines.append('    <link name="map">\n')
    for name, points, faces in pieces(cover):
        yield f"{name}.obj", obj_object(name, points, faces)
        for kind in ("visual", "collision"):
            geometry = f"<geometry><mesh><uri>{name}.obj</uri></mesh></geometry>"
            lines.append(f'      <{kind} name="{name}">{geometry}</{kind}>\n')
    yield "model.sdf", ("".join(lines) + "    </link>\n  </model>\n</sdf>\n").encode()
    yield (
        "model.config",
        (
            '<?xml version="1.0"?>\n<model>\n  <name>map</name>\n  <version>1.0</version>\n'
            '  <sdf version="1.9">model.sdf</sdf>\n'
            f"  <description>{escape(provenance.line())}</description>\n</model>\n"
        ).encode(),
    )


def _head(provenance: Provenance) -> bytes:
    note = provenance.line({"note": ROUNDED}).replace("--", "\\u002d-")  # not allowed in comments of XML
    return f'<?xml version="1.0"?>\n<!-- {note} -->\n'.encode()


def _numbers(points: FloatArray) -> str:
    return " ".join(map(repr, points.ravel().tolist()))
