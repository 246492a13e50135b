"""The stage `voxelize`: mark every voxel that an ellipsoid of a scene touches."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula._core import MAX_VOXELS
from alula.schemas.artifacts.artifact import Artifact, make_artifact
from alula.schemas.artifacts.kinds import VOXELS
from alula.schemas.artifacts.manifest import SPLAT_LOSS, Guarantee, SceneManifest, map_origin
from alula.schemas.artifacts.provenance import parameters_of
from alula.schemas.decimals import at_least, exact
from alula.schemas.errors import InfeasibleError, InputError, UsageError
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.schemas.progress import Progress
from alula.stages.compression.ellipsoids import excluded_errors, lacks_of, retained, rows_of
from alula.stages.compression.forecast import (
    dominant,
    estimated_voxels,
    fitting_size,
    largest_share,
    may_exceed,
    named,
)
from alula.stages.compression.lattice_blocks import Tally, figures_of
from alula.stages.compression.level import mass_within
from alula.stages.compression.limits import MERGE_VOXELS
from alula.stages.compression.tiles import LONGEST_EDGE, Ellipsoids, Marked, mark, mark_tiles

SURE = 1.25  # an estimate above this multiple of the limit ends the command before the work
_NOTABLE = 0.25  # fraction of the voxels; a Gaussian that fills more is named
_CROWD = 100  # among fewer Gaussians a large one is nothing unusual
DEFAULT_TILE = 128  # voxels; used when a scheduler is given but no tile


def sigma_of_confidence(confidence: float) -> float:
    """Level k at which an ellipsoid contains a normal variable with a given probability.

    P(x' inv(Sigma) x <= k^2) = confidence for x normal in three dimensions: k^2 is the quantile of
    the chi-square distribution with three degrees of freedom.

    Args:
        confidence: the probability, above 0 and below 1.

    Returns:
        k, in standard deviations.
    """
    from scipy.special import gammaincinv

    return math.sqrt(2.0 * float(gammaincinv(1.5, confidence)))


def voxelize(
    config: VoxelizeConfig,
    scene: Artifact,
    *,
    tile_m: float | None = None,
    scheduler: str | None = None,
    jobs: int = 0,
    progress: Progress | None = None,
) -> Artifact:
    """Mark every voxel that an ellipsoid of the scene touches.

    The closed cube [i g, (i + 1) g] is marked when at least `min_overlap` k-sigma ellipsoids, each plus
    a ball of radius r, touch it. For r > 0 that sum is replaced by what lies in its box and in the
    ellipsoids {x : (x - mu)' inv(Sigma') (x - mu) <= 1}, Sigma' = (1 + 1/p) k^2 Sigma + (1 + p) r^2 I,
    which contain it for every p: here p = sqrt(k^2 tr Sigma / (3 r^2)) and, if that is above 1 and the
    ellipsoid goes a quarter of a voxel or more beyond the sum, p = 1/2.
    Where the scene has a `loss`, k and r of each Gaussian grow by it (`level_of` in `ellipsoid.hpp`), so that
    the sets contain those of the Gaussians that the splat file was made from. Rounding is outward: with
    `min_overlap` 1, no point of these sets lies in an unmarked voxel that touches the crop. Gaussians of an
    opacity below `min_opacity` do not count.

    Memory: 512 bytes per brick of 4 x 4 x 8 voxels with a touched voxel, until all are counted, at most
    2 GiB; 16 bytes per voxel of the result, at most 2^27 voxels; 1 byte per Gaussian. With tiles there are
    bricks for one tile per thread only, but the result takes 32 bytes per voxel while tiles are joined, and
    each Gaussian 8 bytes per tile that it may touch.

    Args:
        config: see `VoxelizeConfig`; without `inflation_m`, r is the suggestion of the scene's alignment.
        scene: an `alula/scene` in metres.
        tile_m: mark the voxels tile by tile of this edge, rounded to whole voxels; the result does not
            depend on it.
        scheduler: address of a `dask.distributed` scheduler whose workers process the tiles.

    Returns:
        An `alula/voxels` in the frame of the scene.

    Raises:
        InputError: the scene is not metric or empty, or needs more voxels than `max_voxels` or memory allows;
            the estimate of a number far above `max_voxels` ends the stage before the work.
        InfeasibleError: crop, min_overlap or min_opacity leave no voxel.
        UsageError: the tile's edge is out of range; see also `distribute`.
        LinkError: see `distribute`.

    Source: PolyMerge, sec. V-A (O(v) and V+), with exact instead of sampled overlap.
    """
    manifest = scene.manifest
    assert isinstance(manifest, SceneManifest)
    sigma, inflation = level_for(config, manifest)
    if len(scene["mean"]) == 0:
        raise InputError("the scene has no Gaussians")
    rows = retained(scene, config.min_opacity)
    if len(rows) == 0:
        raise InfeasibleError(f"no Gaussian has an opacity of at least {exact(config.min_opacity)}")
    ellipsoids = ellipsoids_of(config, scene, rows, sigma, inflation)
    limit = config.max_voxels
    if limit < MAX_VOXELS and may_exceed(ellipsoids, limit, jobs):
        about = estimated_voxels(ellipsoids)
        if about > SURE * limit:
            raise InputError(_too_many(ellipsoids, rows, about, config, manifest))
    marked = _mark(ellipsoids, tile_m, scheduler, jobs, progress)
    index, overlap = marked.index, marked.overlap
    if len(index) > limit:
        raise InputError(_too_many(ellipsoids, rows, len(index), config, manifest))
    check_some(config, len(index), marked.below, marked.max_overlap)
    left_out = {
        "removed_from_splat": dict(manifest.source.get("removed", {})),
        "gaussians_below_opacity": len(scene["mean"]) - len(rows),
        "voxels_below_min_overlap": marked.below,
        "gaussians_outside_crop": int((marked.reach == 0).sum()),
        "gaussians_cut_by_crop": int((marked.reach == 2).sum()),
    }
    tally = Tally()
    tally.add(index, overlap, marked.below)
    return make_artifact(
        VOXELS,
        {"index": index, "overlap": overlap},
        parameters=parameters_of(config),
        summary={
            "gaussians": len(scene["mean"]),
            **{name: left_out[name] for name in ("gaussians_below_opacity", "gaussians_outside_crop")},
            **figures_of(tally, config.size_m),
            "sigma": sigma,
            "inflation_m": inflation,
            **_notes(ellipsoids, rows, len(index)),
        },
        **voxels_fields(config, manifest, left_out),
    )


def level_for(config: VoxelizeConfig, scene: SceneManifest) -> tuple[float, float]:
    """Level k and radius r [m] of the obstacles.

    Raises:
        InputError: the scene is not metric.
    """
    if scene.unit != "m":
        raise InputError(
            f"the scene's unit is {scene.unit!r}, but voxels have a size in metres; run scale-align first"
        )
    sigma = config.sigma if config.confidence is None else sigma_of_confidence(config.confidence)
    return sigma, scene.suggested_inflation_m if config.inflation_m is None else config.inflation_m


def ellipsoids_of(
    config: VoxelizeConfig, scene: Artifact, rows: NDArray[np.intp], sigma: float, inflation: float
) -> Ellipsoids:
    """Ellipsoids of some Gaussians and the lattice of their voxels.

    Args:
        scene: an `alula/scene` in metres.
        rows: of the Gaussians, in ascending order.
        inflation: radius r of the ball added to each [m].
    """
    found = rows_of(scene, rows, ignore_loss=config.ignore_loss)
    return Ellipsoids(
        mean=found.mean,
        scale=found.scale,
        quat_wxyz=found.quat_wxyz,
        loss=found.loss,
        sigma=sigma,
        inflation_m=inflation,
        voxel_size_m=config.size_m,
        crop=config.crop,
        min_overlap=config.min_overlap,
    )


def check_some(config: VoxelizeConfig, voxels: int, below: int, max_overlap: int) -> None:
    """Check that there is a voxel.

    Args:
        below: number of touched voxels left out because of `min_overlap`.
        max_overlap: maximum overlap of all touched voxels.

    Raises:
        InfeasibleError: there is none.
    """
    if voxels + below == 0:
        raise InfeasibleError("no Gaussian touches the crop, so there is no voxel to mark")
    if voxels == 0:
        raise InfeasibleError(
            f"no voxel is touched by {config.min_overlap} Gaussians; the maximum is {max_overlap}"
        )


def voxels_fields(config: VoxelizeConfig, scene: SceneManifest, left_out: dict[str, Any]) -> dict[str, Any]:
    """Fields of the manifest of an `alula/voxels` that follow from the level of the obstacles.

    Args:
        config: see `VoxelizeConfig`; its crop is that of the voxels.
        left_out: numbers of Gaussians and voxels that are left out, by reason.
    """
    sigma, inflation = level_for(config, scene)
    lacks = lacks_of(scene)
    return {
        "frame": scene.frame,
        "unit": "m",
        "guarantee": _guarantee(
            config,
            sigma,
            inflation,
            left_out | ({"lacks_of_capture": lacks} if lacks else {}),
            _losses(scene, config),
            excluded_errors(scene, inflation, ignore_loss=config.ignore_loss),
        ),
        "voxel_size_m": config.size_m,
        "sigma": sigma,
        "min_overlap": config.min_overlap,
        "inflation_m": inflation,
        "crop": None if config.crop is None else list(config.crop),
        "min_opacity": config.min_opacity,
        "ignore_loss": config.ignore_loss,
        "floor_m": scene.floor_m,
        "map_origin_m": map_origin(scene),
    }


def _too_many(
    ellipsoids: Ellipsoids, rows: NDArray[np.intp], about: float, config: VoxelizeConfig, scene: SceneManifest
) -> str:
    """Message with the number of voxels, and with the size and the filter that would fit."""
    remedies = []
    if fits := fitting_size(ellipsoids, config.max_voxels):
        remedies.append(f"--size {fits[0]:g} makes about {rounded(fits[1])}")
    if few := dominant(ellipsoids, about, config.max_voxels):
        which = named(tuple(int(rows[row]) for row in few.rows))
        unit = scene.world_from_scene.scale if scene.world_from_scene is not None else 1.0
        some = "the largest Gaussian" if len(few.rows) == 1 else f"the {len(few.rows)} largest Gaussians"
        remedies.append(
            f"without {some} (row {which}; semi-axis up to {few.longest:.3g} m) there are about "
            f"{rounded(few.voxels)}: import-splat --max-scale {few.limit / unit:.3g} (file units) removes "
            f"semi-axes above {few.limit:.3g} m"
        )
    return too_many(config.size_m, about, config.max_voxels, remedies)


def too_many(size_m: float, about: float, limit: int, remedies: list[str]) -> str:
    """Message with the number of voxels, and with what would fit.

    Args:
        about: their number, roughly; infinite for one that is not known.
        limit: their maximum number.
    """
    number = "far more than" if math.isinf(about) else f"about {rounded(about)}, more than"
    words = f"voxels of {size_m:g} m: {number} the {limit:,} of --max-voxels"
    if limit == MERGE_VOXELS:
        words += ", which merge can take"
    return "; ".join([words, *remedies, "--crop marks less"])


def _notes(ellipsoids: Ellipsoids, rows: NDArray[np.intp], voxels: int) -> dict[str, Any]:
    """Note about a Gaussian that alone fills a large part of the voxels."""
    found = largest_share(ellipsoids, voxels)
    if found is None or not is_notable(found[1], len(rows)):
        return {}
    row, share = found
    return {"notes": [giant_note(f"{rows[row]} of {len(rows)}", float(ellipsoids.scale[row].max()), share)]}


def is_notable(share: float, gaussians: int) -> bool:
    """Whether a Gaussian that fills a fraction of the voxels is named among others."""
    return share >= _NOTABLE and gaussians >= _CROWD


def giant_note(which: str, longest: float, share: float) -> str:
    """Note about a Gaussian, its longest semi-axis [m] and the fraction of the voxels that it fills."""
    return (
        f"Gaussian {which}, with a semi-axis of {longest:.3g} m, alone fills {share:.0%} of the voxels; if "
        "it is no obstacle, import-splat --max-scale removes it"
    )


def rounded(number: float) -> str:
    """Number in words: two digits, with commas.

    Args:
        number: not negative.
    """
    digits = max(len(str(int(number))) - 2, 0)
    return f"{round(number / 10**digits) * 10**digits:,}"


def _losses(scene: SceneManifest, config: VoxelizeConfig) -> dict[str, float]:
    """Maximum of each kind of loss that the ellipsoids were grown by."""
    loss = scene.source.get("loss")
    if config.ignore_loss or SPLAT_LOSS not in scene.requires or not isinstance(loss, dict):
        return {}
    return {key: value for key, value in loss.items() if isinstance(value, float) and key != "opacity"}


def tile_edge(tile_m: float, size: float) -> int:
    """Edge of a tile, rounded to whole voxels.

    Args:
        size: edge of a voxel [m].

    Raises:
        UsageError: it is out of range.
    """
    edge = max(1, round(tile_m / size)) if tile_m > 0 else 0
    if not 1 <= edge <= LONGEST_EDGE:
        raise UsageError(
            f"--tile must be more than 0 and at most {exact(LONGEST_EDGE * size)} m, not {tile_m}"
        )
    return edge


def _mark(
    ellipsoids: Ellipsoids, tile_m: float | None, scheduler: str | None, jobs: int, progress: Progress | None
) -> Marked:
    size = ellipsoids.voxel_size_m
    try:
        if tile_m is None and scheduler is None:
            return mark(ellipsoids, jobs, progress)
        edge = DEFAULT_TILE if tile_m is None else tile_edge(tile_m, size)
        return mark_tiles(ellipsoids, edge, jobs, scheduler, progress)
    except OverflowError as error:
        remedy = "a larger --tile, " if "tiles" in str(error) else ""
        raise InputError(f"{error}; use {remedy}--crop or a larger --size") from error


def _guarantee(
    config: VoxelizeConfig,
    sigma: float,
    inflation: float,
    left_out: dict[str, Any],
    losses: dict[str, float],
    before: list[str],
) -> Guarantee:
    mass = at_least(100 * mass_within(sigma))
    what = f"the {exact(sigma)}-sigma ellipsoid ({mass} % of the mass) of a Gaussian of the input scene"
    if config.min_opacity > 0:
        below = left_out["gaussians_below_opacity"]
        what += f" with an opacity of at least {exact(config.min_opacity)} ({below} are below)"
    growths = [f"{exact(inflation)} m"] * (inflation > 0)
    growths += ["all that the splat file's format may have lost"] * bool(losses)
    if growths:
        what += f", grown by {' and by '.join(growths)},"
    if config.min_overlap == 1:
        statement = f"Every voxel that {what} touches is marked"
    else:
        statement = (
            f"Every voxel that {what} touches is marked if at least {config.min_overlap} Gaussians touch it; "
            f"{left_out['voxels_below_min_overlap']} touched voxels are left out"
        )
    if config.crop is not None:
        statement += f", as far as it touches the crop {exact(config.crop)} m"
        if "gaussians_cut_by_crop" in left_out:  # of a part of a whole the others have them
            outside, cut = left_out["gaussians_outside_crop"], left_out["gaussians_cut_by_crop"]
            statement += f"; {outside} Gaussians lie outside and {cut} in part"
    if before:
        statement += ". Not included: " + "; ".join(before)
    claims = {
        "sigma": sigma,
        "mass_fraction": mass_within(sigma),
        "inflation_m": inflation,
        "voxel_size_m": config.size_m,
        "min_overlap": config.min_overlap,
        "crop": None if config.crop is None else list(config.crop),
        "min_opacity": config.min_opacity,
        "ignore_loss": config.ignore_loss,
        "splat_loss": losses,
        "left_out": left_out,
    }
    return Guarantee(statement=statement + ".", claims=claims)
