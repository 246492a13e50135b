"""Nodes of a glTF scene with Gaussians, and their global matrices."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import ArtifactError
from alula.stages.reconstruction.formats.gltf_accessors import Document, Natural, Node, item
from alula.stages.rotation import matrix_from_quat_wxyz, quat_wxyz_from_matrix

NAME = "KHR_gaussian_splatting"
_NOT_RIGID = 1e-5  # maximum relative difference of the scales of a node's three axes


@dataclass(frozen=True, slots=True)
class Placed:
    """A primitive at a node.

    Attributes:
        primitive: index of its mesh, and its own index in that mesh.
        linear: 3 by 3 part of the global matrix: `scale` times the rotation `quat` (w, x, y, z), up to
            `defect`.
        shift: last column of the global matrix.
        defect: relative difference of the scales of different directions.
        exact: True when the matrix is the identity.
    """

    primitive: tuple[int, int]
    linear: NDArray[np.float64]
    shift: NDArray[np.float64]
    quat: NDArray[np.float64]
    scale: float
    defect: float
    exact: bool


def placed_primitives(document: Document, notes: list[str]) -> list[Placed]:
    """Primitives with Gaussians in the scene, in the order of its nodes.

    Args:
        notes: list to which notes about skipped parts are added.

    Raises:
        ArtifactError: there are none, the nodes do not form a tree, or a global matrix is not a rotation
            times a scale.
    """
    splats = [
        [i for i, primitive in enumerate(mesh.primitives) if NAME in primitive.extensions]
        for mesh in document.meshes
    ]
    if not any(splats):
        raise ArtifactError(f"glTF: no primitive has {NAME}: an ordinary scene, not a Gaussian splat")
    found, reached = [], set()
    stack = [(index, np.eye(4), True) for index in reversed(roots_of(document, notes))]
    while stack:
        index, above, above_exact = stack.pop()
        node = item(document.nodes, index, "node")
        if index in reached:
            raise ArtifactError(f"glTF: node {index} is reached twice: nodes must be a tree")
        reached.add(index)
        local, exact = local_matrix(node, index)
        with np.errstate(over="ignore", invalid="ignore"):
            matrix = local if above_exact else above @ local
        exact = exact and above_exact
        stack += [(child, matrix, exact) for child in reversed(node.children)]
        if node.mesh is None:
            continue
        item(document.meshes, node.mesh, "mesh")
        if splats[node.mesh]:
            for name in node.extensions:
                if name == "EXT_mesh_gpu_instancing":
                    raise ArtifactError(f"glTF: node {index} has {name}, which is not supported")
            if node.skin is not None:
                raise ArtifactError(f"glTF: node {index} has a skin; Gaussians with one are not supported")
            found += [_place((node.mesh, i), matrix, exact, index) for i in splats[node.mesh]]
    left = sum(
        1
        for index, node in enumerate(document.nodes)
        if index not in reached and node.mesh is not None and node.mesh < len(splats) and splats[node.mesh]
    )
    if left:
        notes.append(f"{left} nodes with Gaussians are not in the scene; they were not read")
    if not found:
        raise ArtifactError("glTF: no node of the scene has Gaussians")
    return found


class _Target(msgspec.Struct):
    node: Natural | None = None


class _Channel(msgspec.Struct):
    target: _Target = msgspec.field(default_factory=_Target)


class _Animation(msgspec.Struct):
    channels: list[_Channel] = []


def check_still(document: Document) -> None:
    """Check that no animation moves a node with Gaussians, or one above it.

    Args:
        document: a parsed file whose nodes form a tree.

    Raises:
        ArtifactError: one does, or an animation is damaged.
    """
    try:
        animations = [msgspec.json.decode(raw, type=_Animation) for raw in document.animations]
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ArtifactError(f"glTF: an animation is damaged: {error}") from error
    targets = (channel.target.node for one in animations for channel in one.channels)
    moved = {target for target in targets if target is not None}
    left = list(moved)
    while left:
        index = left.pop()
        node = item(document.nodes, index, "node")
        mesh = None if node.mesh is None else item(document.meshes, node.mesh, "mesh")
        if mesh is not None and any(NAME in one.extensions for one in mesh.primitives):
            raise ArtifactError(
                f"glTF: an animation moves Gaussians of node {index}, whose places are then known at a time "
                "only; export it without animations"
            )
        left += [child for child in node.children if child not in moved]
        moved |= set(node.children)


def roots_of(document: Document, notes: list[str]) -> list[int]:
    """Roots of the default scene, or of all nodes in a file without scenes.

    Args:
        notes: list to which notes about other scenes are added.
    """
    if not document.scenes:
        children = {child for node in document.nodes for child in node.children}
        notes.append("no scene: all nodes were read")
        return [i for i in range(len(document.nodes)) if i not in children]
    if document.scene is None and len(document.scenes) > 1:
        notes.append(f"no default scene: the first of {len(document.scenes)} was read")
    elif len(document.scenes) > 1:
        notes.append(f"scene {document.scene} of {len(document.scenes)}; the others were not read")
    return item(document.scenes, document.scene or 0, "scene").nodes


def local_matrix(node: Node, index: int) -> tuple[NDArray[np.float64], bool]:
    """4 by 4 matrix of a node, and True when it is exactly the identity.

    Raises:
        ArtifactError: a part of it has too few numbers, or some that are not finite.
    """
    parts = {"matrix": 16, "translation": 3, "rotation": 4, "scale": 3}
    for name, length in parts.items():
        values = getattr(node, name)
        if values is not None and not (len(values) == length and np.isfinite(values).all()):
            raise ArtifactError(f"glTF: node {index}: {name} is not {length} finite numbers")
    if node.matrix is not None:
        matrix = np.array(node.matrix).reshape(4, 4).T
    else:
        matrix = np.eye(4)
        matrix[:3, 3] = node.translation or 0.0
        x, y, z, w = node.rotation or (0.0, 0.0, 0.0, 1.0)
        norm = float(np.linalg.norm((x, y, z, w)))
        if not 0.0 < norm < np.inf:
            raise ArtifactError(f"glTF: node {index}: rotation has no length")
        if (x, y, z) != (0.0, 0.0, 0.0):
            matrix[:3, :3] = matrix_from_quat_wxyz(np.array([w, x, y, z]) / norm)
        with np.errstate(over="ignore", under="ignore"):
            matrix[:3, :3] *= np.array(node.scale or (1.0, 1.0, 1.0))
    return matrix, bool((matrix == np.eye(4)).all())


def _place(primitive: tuple[int, int], matrix: NDArray[np.float64], exact: bool, index: int) -> Placed:
    """Take a rotation, a positive uniform scale and a shift out of a global matrix."""
    linear, shift = matrix[:3, :3], matrix[:3, 3]
    if not (np.isfinite(matrix).all() and (matrix[3] == (0.0, 0.0, 0.0, 1.0)).all()):
        raise ArtifactError(f"glTF: node {index}: its global matrix is not affine and finite")
    left, stretch, right = np.linalg.svd(linear)
    scale = float(np.cbrt(stretch.prod()))
    if not 1e-30 < scale < 1e30:
        raise ArtifactError(f"glTF: node {index}: its global matrix has scale {scale:g}")
    defect = float(np.abs(stretch / scale - 1.0).max())
    if defect > _NOT_RIGID:
        axes = ", ".join(f"{value:.6g}" for value in stretch)
        raise ArtifactError(
            f"glTF: node {index}: its global matrix scales by {axes} along three directions; "
            "only the same scale along all of them is supported"
        )
    rotation = left @ right
    if np.linalg.det(rotation) < 0:
        raise ArtifactError(f"glTF: node {index}: its global matrix mirrors; that is not supported")
    return Placed(primitive, linear, shift, quat_wxyz_from_matrix(rotation), scale, defect + 1e-15, exact)
