"""Artifacts in parts for tests, written without the stages that make real ones."""

import numpy as np

from alula.schemas.artifacts.artifact import make_artifact
from alula.schemas.artifacts.kinds import SCENE, VOXELS
from alula.schemas.artifacts.manifest import SPLAT_LOSS
from alula.schemas.artifacts.parts_output import part_name, parts_output, write_part
from alula.schemas.artifacts.provenance import Provenance


def scene_of(mean, scale=0.05, loss=None, **fields):
    """A scene of round Gaussians; `loss` (N, 3) is optional."""
    mean = np.asarray(mean, np.float32).reshape(-1, 3)
    rows = len(mean)
    arrays = {
        "mean": mean,
        "scale": np.broadcast_to(np.asarray(scale, np.float32).reshape(-1, 1), (rows, 3)),
        "quat_wxyz": np.tile(np.float32([1, 0, 0, 0]), (rows, 1)),
        "opacity": np.full(rows, 0.9, np.float32),
        "color": np.zeros((rows, 3), np.uint8),
    }
    if loss is not None:
        arrays["loss"] = np.broadcast_to(np.asarray(loss, np.float32), (rows, 3))
    defaults = {"frame": "world", "unit": "m", "parameters": {}, "summary": {}, "source": {"removed": {}}}
    return make_artifact(
        SCENE, arrays, **(defaults | {"requires": [SPLAT_LOSS] if loss is not None else []} | fields)
    )


def voxels_of(index, overlap=1):
    index = np.asarray(index, np.int32).reshape(-1, 3)
    return make_artifact(
        VOXELS,
        {"index": index, "overlap": np.broadcast_to(np.uint32(overlap), len(index))},
        **{"frame": "world", "unit": "m", "parameters": {}, "summary": {}},
        voxel_size_m=0.1,
        sigma=1.0,
        min_overlap=1,
    )


def provenance_of(artifact, **parameters):
    return Provenance.now(artifact.kind.name, artifact.kind.version, parameters, None, [])


def write_parts(path, artifacts, domains=None):
    """Write artifacts of one kind as the parts of a whole whose other fields are those of the first."""
    first = artifacts[0]
    fields = {
        name: getattr(first.manifest, name)
        for name in first.manifest.__struct_fields__
        if name not in ("schema", "version", "producer", "parameters", "inputs", "seed", "arrays")
    }
    requires = {need for artifact in artifacts for need in artifact.manifest.requires}
    with parts_output(path, first.kind, provenance_of(first)) as writer:
        for number, artifact in enumerate(artifacts):
            domain = None if domains is None else domains[number]
            writer.take(write_part(writer.folder, part_name(first.kind, number), artifact, domain))
        writer.finish(writer.whole(provenance_of(first), **(fields | {"requires": sorted(requires)})))
    return path
