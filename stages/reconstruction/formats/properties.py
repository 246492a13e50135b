"""Known properties of splat files: what each does to the geometry, and what the import does with it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import ArtifactError
from alula.stages.reconstruction.formats.splats import rounded_up

FILTER = "filter_3D"
FILTER_WORDS = (
    f"{FILTER} was applied: each semi-axis s is sqrt(s^2 + {FILTER}^2), and the opacity falls by the ratio "
    "of the volumes"
)
_NAMED = 8  # maximum number of names in a message


class Effect(Enum):
    """What the import does with a property."""

    READ = "read"
    APPLIED = "applied"
    IGNORED = "ignored"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class Known:
    """Properties that the import knows.

    Attributes:
        names: patterns of names; `*` stands for any characters, `#` for a number.
        effect: what the import does with them.
        what: why, in words that continue "the file has ..., ".
    """

    names: tuple[str, ...]
    effect: Effect
    what: str


_NETWORK = "whose positions, sizes and opacities only the trainer's network gives"
_MOVING = "which move: their places are known at a time only"

KNOWN = (
    Known(
        ("x", "y", "z", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
        Effect.READ,
        "the ellipsoid and its opacity",
    ),
    Known(
        ("f_dc_0", "f_dc_1", "f_dc_2", "f_rest_#", "red", "green", "blue"),
        Effect.READ,
        "colours; of harmonics above the constant one the number alone is checked",
    ),
    Known(
        (FILTER,),
        Effect.APPLIED,
        "the 3D filter of Mip-Splatting, Gaussian Opacity Fields, RaDe-GS and others",
    ),
    Known(
        ("nx", "ny", "nz", "nxx", "nx2", "ny2", "nz2", "normal_#"),
        Effect.IGNORED,
        "normals, which only shade",
    ),
    Known(
        (
            "roughness", "metallic", "specular*", "diffuse_#", "fresnel_#", "albedo*", "base_color_#",
            "reflect", "refl_strength*", "incidents_*", "visibility_*", "reflection_visible", "f_sg_#",
            "sb_params_#",
        ),
        Effect.IGNORED,
        "materials and view-dependent colour (GaussianShader, Relightable 3D Gaussian, GS-IR and others)",
    ),
    Known(
        (
            "obj_dc_#", "semantic_#", "semantic_feature_#", "language_feature", "language_feature_#",
            "ins_feat_*", "label", "object_id", "object_score", "group_id", "instance_id", "segment_id",
            "confidence", "uncertainty",
        ),
        Effect.IGNORED,
        "labels and features of meaning (Gaussian Grouping, Feature 3DGS, OpenGaussian and others)",
    ),
    Known(
        ("base_occupancy_#", "occupancy_shift_#"),
        Effect.IGNORED,
        "occupancies from which MILo extracts its mesh",
    ),
    Known(
        ("level", "extra_level", "ancestry_lod_#"),
        Effect.IGNORED,
        "levels of detail (Octree-GS): the Gaussians of all levels are read together",
    ),
    Known(
        ("xr", "yr", "zr"),
        Effect.IGNORED,
        "homogeneous coordinates (HoGS), from which the trainer has already computed x, y, z and the scales",
    ),
    Known(
        ("f_offset_#", "f_anchor_feat_#", "f_anchor_sem_feat_#", "f_mask_#", "scale_3", "scale_4", "scale_5"),
        Effect.REFUSED,
        f"as anchors of Scaffold-GS, Octree-GS and HAC have, {_NETWORK}",
    ),
    Known(
        ("embedding_#", "fea_#"),
        Effect.REFUSED,
        f"as deformable Gaussians of E-D3DGS and SC-GS have, {_NETWORK}",
    ),
    Known(
        ("motion_#", "omega_#", "trbf_center", "trbf_scale"),
        Effect.REFUSED,
        f"as Gaussians of SpacetimeGaussians have, {_MOVING}",
    ),
    Known(
        ("t", "mu_t", "scale_t", "scale_t_#", "t_scale", "rot_l_#", "rot_r_#"),
        Effect.REFUSED,
        f"as four-dimensional Gaussians have, {_MOVING}",
    ),
    Known(
        ("velocity_#", "acceleration_#", "time", "duration", "delta_?_t#", "delta_rot_#_t#"),
        Effect.REFUSED,
        f"as Gaussians with velocities or frames have, {_MOVING}",
    ),
    Known(
        ("binding", "binding_#"),
        Effect.REFUSED,
        "as GaussianAvatars have, whose positions and sizes are relative to the triangles of a mesh",
    ),
    Known(
        ("beta", "shape", "wave_#"),
        Effect.REFUSED,
        "as kernels of another form than a Gaussian have (Deformable Beta Splatting, GES and others), of "
        "which ellipsoids at a sigma say nothing",
    ),
    Known(
        ("adjacency_offset", "density"),
        Effect.REFUSED,
        "as cells of Radiant Foam have, which are no Gaussians",
    ),
)  # fmt: skip
"""The one list of properties; docs/guide/splat-formats.md shows it."""

ELEMENTS = (
    Known(("delta_vertex_#", "meta_delta_*"), Effect.REFUSED, f"the frames of an animation, {_MOVING}"),
    Known(
        ("codebook_centers", "vertex_#"),
        Effect.REFUSED,
        "as quantised files of Reduced 3DGS have, whose numbers are indices into a code book",
    ),
    Known(("vertex_*",), Effect.REFUSED, f"the objects of Street Gaussians, {_MOVING}"),
    Known(("adjacency",), Effect.REFUSED, "as Radiant Foam has, whose cells are no Gaussians"),
)
"""Elements of a PLY file that change what its Gaussians are."""

FILES = (
    Known(
        ("deformation.pth", "deformation_table.pth"),
        Effect.REFUSED,
        "as 4D Gaussians have: the positions and sizes at a time are those that this network gives",
    ),
    Known(
        ("../../deform",),
        Effect.REFUSED,
        f"as Deformable 3D Gaussians and SC-GS have, {_NETWORK}",
    ),
    Known(
        ("opacity_mlp.pt", "cov_mlp.pt", "color_mlp.pt"),
        Effect.REFUSED,
        f"as anchors of Scaffold-GS have, {_NETWORK}",
    ),
)
"""Files beside a PLY file that change what its Gaussians are."""


def unknown_words(names: Sequence[str]) -> str:
    """Phrase that names properties of unknown meaning.

    Args:
        names: of the properties, at least one.
    """
    several = "properties" if len(names) > 1 else "property"
    return f"the {several} {_listed(names)} of the splat file, of unknown meaning"


def judged(
    names: Iterable[str],
    what: str = "property",
    known: tuple[Known, ...] = KNOWN,
    *,
    applied: tuple[str, ...] = (),
) -> tuple[str, ...]:
    """Refuse names whose meaning the import cannot follow.

    Args:
        names: of properties, elements or files.
        what: a name is of, for the message.
        applied: names that change the ellipsoids and that the caller applies.

    Returns:
        The names that the list does not have, in their order.

    Raises:
        ArtifactError: a name is known to need a network, a time, a mesh or another kernel.
    """
    unknown = []
    for name in names:
        found = next((one for one in known if any(_fits(name, pattern) for pattern in one.names)), None)
        if found is None:
            unknown.append(name)
        elif found.effect is Effect.REFUSED:
            raise ArtifactError(
                f"not a scene of plain Gaussians: it has {what} {name[:40]}, {found.what}; "
                "export plain Gaussians from the trainer"
            )
        elif found.effect is Effect.APPLIED and name not in applied:
            raise ArtifactError(f"{what} {name}, {found.what}, is not applied in this format")
    return tuple(unknown)


def _fits(name: str, pattern: str) -> bool:
    head, number, tail = pattern.partition("#")
    if not number:
        return fnmatchcase(name, pattern)
    if "#" in tail:  # two numbers: the first is a digit
        return any(_fits(name, f"{head}{digit}{tail}") for digit in "0123456789")
    # `?` stands for one character of the head.
    middle = name[len(head) : len(name) - len(tail)]
    return fnmatchcase(name[: len(head)], head) and name.endswith(tail) and middle.isdecimal()


def _listed(names: Sequence[str]) -> str:
    """The first names, and the number of the others; runs of numbered names count as one."""
    series = [f"{stem}*" if (stem := name.rstrip("0123456789")) != name else name for name in names]
    series = list(dict.fromkeys(series))
    shown = [one[:40] for one in series[:_NAMED]]
    return ", ".join(shown) + (f" and {len(series) - _NAMED} more" if len(series) > _NAMED else "")


def filtered(
    scale: NDArray[np.float32], opacity: NDArray[np.float32], filter_3d: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Apply a 3D smoothing filter: the convolution of each Gaussian with an isotropic one.

    Sigma' = Sigma + f^2 I, so that a semi-axis s becomes sqrt(s^2 + f^2), and
    opacity' = opacity sqrt(det Sigma / det Sigma'), in double precision and rounded up to single. A NaN or an
    infinite f makes the semi-axes so.

    Args:
        scale: semi-axes s, shape (N, 3), file units.
        opacity: alpha, shape (N,).
        filter_3d: f, shape (N,), file units.

    Returns:
        Semi-axes and opacities of the filtered Gaussians.

    Source: Yu 2024, Mip-Splatting, section 4.1.
    """
    s, f = scale.astype(np.float64), filter_3d.astype(np.float64)[:, None]
    with np.errstate(invalid="ignore", over="ignore"):
        grown = np.sqrt(s * s + f * f)
        ratio = np.divide(s, grown, out=np.ones_like(s), where=grown != 0.0)  # 0 / 0: a point stays a point
        faded = opacity.astype(np.float64) * (ratio[:, 0] * ratio[:, 1] * ratio[:, 2])
    # Infinite semi-axes give 0 or NaN here; the rows count as infinite by their scale.
    return rounded_up(grown), np.minimum(rounded_up(np.nan_to_num(faded, nan=0.0)), opacity)
