"""The stage `merge`: cover occupied voxels with a limited number of convex polytopes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.artifacts.artifact import Artifact, make_artifact
from alula.schemas.artifacts.kinds import COVER
from alula.schemas.artifacts.manifest import (
    OUTER_POLYTOPES,
    CoverManifest,
    Guarantee,
    VoxelsManifest,
    level_fields,
)
from alula.schemas.artifacts.provenance import parameters_of
from alula.schemas.errors import InfeasibleError, InputError
from alula.schemas.parameters.configs.merge import BOX_PLANES, MergeConfig
from alula.schemas.progress import Progress
from alula.stages.compression.block_budgets import HEADER_BYTES, HULL_BYTES
from alula.stages.compression.limits import LATTICE_LIMIT, MERGE_VOXELS, require_at_most, require_near
from alula.stages.progress import WHOLE, share

_CURVE_POINTS = 60
_GROWTH_ATTEMPTS = 4
_SAVED_SHARES = (0.4, 0.55, 0.75)  # of the hulls' bytes, by bisection: two more merges
_HULLS_SHARE = 0.45  # of the time, before planes are saved
_ARRAYS = tuple(rule.name for rule in COVER.arrays)


def merge(
    config: MergeConfig,
    source: Artifact,
    *,
    jobs: int = 0,
    progress: Progress | None = None,
    journal: _core.MergeJournal | None = None,
) -> Artifact:
    r"""Cover voxels by merging convex hulls of local clusters.

    Guarantee: every occupied voxel lies in a hull that lists it as a member; the hull is the convex
    hull of its members' corners, in exact integer arithmetic. Volumes only select the pairs to merge.

    With V+ the occupied voxels and W(C) = Vol(Hull(C) \ V+):

    - start: the greedy set cover of V+ by the clusters C_v = {v' in V+ : |v' - v|_inf <= cluster_radius},
      smallest W(C_v) per newly covered voxel first; by default a cluster keeps only the voxels that it covers
      newly, and tiles of the scene are covered each by itself;
    - method "paper": repeatedly join the pair of touching bounding boxes with the smallest W(i u j), or the
      nearest boxes when none touch;
    - method "default": repeatedly join the pair with the smallest W(i u j) - W(i) - W(j), where a hull that
      touches no other is paired with its nearest. Pairs of a joined hull are measured no earlier than the
      pairs of its parts would have been due. Large scenes are merged in tiles first, down to an eighth of the
      clusters, and a pair not measured yet is expected to add 5 % of what its common box adds. With `hulls`,
      merging stops at 1.3 times their number, and goes on after tightening: each hull is rebuilt from the
      voxels that no other contains, and hulls without any are dropped, which never enlarges the cover. At the
      end three changes are made where they reduce the sum of W: the voxels of two neighbours are divided anew
      by a plane; one hull is divided and two others are merged; voxels at an extreme point of a hull go to
      another. Then hulls are tightened again.

    With `facet_cap` or `kdop` each hull becomes an outer polytope that contains it, with the planes of
    its bounding box and few others, each supporting the hull exactly. Planes that remove most free volume
    come first, and polytopes are tightened to the voxels that no other contains. With "auto" several
    numbers of hulls of the same merge history are tried, the one with the smallest union is taken, and all
    planes of the budget are distributed. `max_planes` and `max_bytes` limit the written cover. With "auto"
    and `hulls` alone, or without any limit, the budget is the smallest of a few fractions of the bytes of the
    hulls at which the union is no larger than that of the hulls; where there is none, the hulls are kept.

    `max_growth` is enforced by the sum of W, an upper bound of the excess of the union, and checked on the
    measured union.

    Args:
        source: an `alula/voxels`, or an `alula/cover` whose hulls are merged further; V+ then is the
            union of its members.
        journal: records the measured volumes. With the journal of an interrupted run, or with a copy made
            from its `snapshot()` in `progress`, the same run gives the same result in a fraction of the time.

    Returns:
        An `alula/cover`. `conservativeness` is Vol(union of hulls) / Vol(V+).

    Raises:
        InputError: there is no voxel, or more than `MERGE_VOXELS`, or one lies more than 2^20 voxels from
            the origin.
        InfeasibleError: the limits contradict each other.

    Source: Hong et al. 2026, PolyMerge (arXiv 2606.16232), eqs. 10-15.
    """
    require_possible(config)
    manifest = source.manifest
    assert isinstance(manifest, VoxelsManifest | CoverManifest)
    voxels, member, member_start = _voxels_and_sets(source)
    run = partial(_cover, config, voxels, member, member_start, jobs)
    if config.saves_planes:
        found, is_fitted = _with_saved_planes(
            run, _core.MergeJournal() if journal is None else journal, progress
        )
    else:
        is_fitted = config.facet_cap == "auto"
        found = _within_growth(config, len(voxels), run, is_fitted, journal, progress)
    cap = config.facet_cap if isinstance(config.facet_cap, int) else 0
    growth = _growth(found, len(voxels))
    if progress is not None and (config.max_growth is not None or config.saves_planes):
        progress(WHOLE, WHOLE)
    _check_feasible(config, found, growth)
    hulls, planes = len(found["plane_start"]) - 1, len(found["plane_offset"])
    is_outer = is_fitted or cap > 0 or config.kdop is not None
    summary = {
        "voxels": len(voxels),
        "hulls": hulls,
        "half_planes": planes,
        "vertices": len(found["vertex"]),
        "conservativeness": growth,
        "most_half_planes_of_a_hull": int(np.diff(found["plane_start"]).max()),
        "start_hulls": int(found["curve"][0, 0]),
        "onboard_bytes": int(found["onboard_bytes"]),
        "geometry_bytes": sum(
            found[name].nbytes
            for name in ("vertex", "vertex_start", "plane_normal", "plane_offset", "plane_start")
        ),
    }
    level = level_fields(manifest)
    return make_artifact(
        COVER,
        {name: found[name] for name in _ARRAYS},
        frame=manifest.frame,
        unit=manifest.unit,
        parameters=parameters_of(config),
        summary=summary,
        guarantee=cover_guarantee(manifest.guarantee, len(voxels), is_outer=is_outer),
        polytopes="outer" if is_outer else "hull",
        **level | {"requires": [*[OUTER_POLYTOPES] * is_outer, *level["requires"]]},
        conservativeness=growth,
        certificate={
            "containment": "normal . v + sum of positive normal components <= offset, for each member v",
            "conservativeness": _volume_method(found),
            "curve": _curve(found["curve"], found["measured"], len(voxels)),
        },
    )


def require_possible(config: MergeConfig) -> None:
    """Refuse limits that no cover keeps.

    Raises:
        InfeasibleError: one hull needs more planes or bytes.
    """
    if config.max_planes is not None and config.max_planes < BOX_PLANES:
        raise InfeasibleError(f"no cover has {config.max_planes} half-planes: one hull needs {BOX_PLANES}")
    if config.max_bytes is not None and config.max_bytes < HEADER_BYTES + HULL_BYTES:
        raise InfeasibleError(
            f"no cover has {config.max_bytes} bytes: one hull needs {HEADER_BYTES + HULL_BYTES}"
        )


def merge_sets(config: MergeConfig, source: Artifact, *, jobs: int = 0) -> dict[str, Any]:
    """Merge like `merge` with the limits of hulls and growth, to sets that will be merged further.

    They are tightened but not changed otherwise, and limits may contradict each other.

    Args:
        source: an `alula/voxels`, or an `alula/cover`, of which only the members are used.

    Returns:
        The arrays of a cover, and its full `curve`; see `_core.merge_cover`.

    Raises:
        InputError: see `merge`.
    """
    sets = _voxels_and_sets(source)
    growth = config.max_growth or 0.0
    return _cover(config, *sets, jobs, journal=None, progress=None, max_growth=growth, is_final=False)


def _cover(
    config: MergeConfig,
    voxels: NDArray[np.int32],
    member: NDArray[np.uint32],
    member_start: NDArray[np.int64],
    jobs: int,
    *,
    journal: _core.MergeJournal | None,
    progress: Progress | None,
    max_bytes: int = 0,
    is_fitted: bool = False,
    max_growth: float = 0.0,
    is_final: bool = True,
) -> dict[str, Any]:
    """Run the native merge with some of its limits replaced."""
    found: dict[str, Any] = _core.merge_cover(
        voxels,
        member,
        member_start,
        block=config.cluster_radius,
        is_paper=config.method == "paper",
        max_hulls=config.hulls or 0,
        max_planes=config.max_planes or 0,
        max_bytes=max_bytes,
        facet_cap=config.facet_cap if isinstance(config.facet_cap, int) else 0,
        kdop=config.kdop or 0,
        is_fitted=is_fitted,
        is_final=is_final,
        max_growth=max_growth,
        jobs=jobs,
        journal=journal,
        progress=progress,
    )
    return found


def _growth(found: dict[str, Any], voxels: int) -> float:
    """Volume of the union over that of the voxels."""
    return 1.0 + float(found["union_excess"]) / voxels


def _within_growth(
    config: MergeConfig,
    voxels: int,
    run: Callable[..., dict[str, Any]],
    is_fitted: bool,
    journal: _core.MergeJournal | None,
    progress: Progress | None,
) -> dict[str, Any]:
    """Merge, again with a smaller bound of W while the measured union exceeds `max_growth`."""
    limit = config.max_growth or 0.0
    for attempt in range(_GROWTH_ATTEMPTS):
        found = run(
            journal=journal,
            max_bytes=config.max_bytes or 0,
            is_fitted=is_fitted,
            max_growth=limit,
            # Each attempt gets half of the remaining progress, as it is probably the last one.
            progress=progress
            if config.max_growth is None
            else share(progress, 1 - 0.5**attempt, 1 - 0.5 ** (attempt + 1)),
        )
        growth = _growth(found, voxels)
        if config.max_growth is None or growth <= config.max_growth or limit <= 1.0 or is_fitted:
            break
        limit = max(1.0, limit - 2 * (growth - config.max_growth))  # W of large hulls is a coarser bound
    return found


def _with_saved_planes(
    run: Callable[..., dict[str, Any]], journal: _core.MergeJournal, progress: Progress | None
) -> tuple[dict[str, Any], bool]:
    """Merge to hulls, then find fewer bytes for the same volume; whether the result is outer polytopes.

    The volumes that the first merge measured are in the journal; further merges do not measure them again.
    """
    hulls = run(journal=journal, progress=share(progress, 0.0, _HULLS_SHARE))
    best, is_outer = hulls, False
    low, high = 0, len(_SAVED_SHARES)  # the answer is in [low, high]; high stands for the hulls themselves
    trials = high.bit_length()
    for trial in range(trials):
        if low >= high or not hulls["within_budget"]:
            break
        middle = (low + high) // 2
        size = int(_SAVED_SHARES[middle] * int(hulls["onboard_bytes"]))
        begin, end = (_HULLS_SHARE + (1 - _HULLS_SHARE) * part / trials for part in (trial, trial + 1))
        found = run(journal=journal, progress=share(progress, begin, end), max_bytes=size, is_fitted=True)
        if found["within_budget"] and found["union_excess"] <= hulls["union_excess"]:
            best, is_outer, high = found, True, middle
        else:
            low = middle + 1
    return best, is_outer


def _voxels_and_sets(
    source: Artifact,
) -> tuple[NDArray[np.int32], NDArray[np.uint32], NDArray[np.int64]]:
    """Sorted voxels, and the members of the hulls to start from as voxel numbers; none for plain voxels."""
    is_cover = source.manifest.schema == COVER.name
    index = np.ascontiguousarray(source["member_index" if is_cover else "index"], np.int32)
    if len(index) == 0:
        raise InputError("there is no occupied voxel to cover")
    require_at_most(MERGE_VOXELS, len(index), f"{source.manifest.schema} lists")
    require_near(index)
    if not is_cover:
        return index, np.empty(0, np.uint32), np.empty(0, np.int64)
    start = np.ascontiguousarray(source["member_start"], np.int64)
    if (np.diff(start) == 0).any():
        raise InputError(f"hull {int(np.argmin(np.diff(start)))} has no members")
    key = (index.astype(np.int64) + LATTICE_LIMIT) @ np.array([2**42, 2**21, 1])
    _, first, number = np.unique(key, return_index=True, return_inverse=True)
    return np.ascontiguousarray(index[first]), number.astype(np.uint32), start


def _check_feasible(config: MergeConfig, found: dict[str, Any], growth: float) -> None:
    hulls, _, planes, size = found["curve"][-1]
    if not found["within_budget"]:
        wanted = [f"{config.hulls} hulls"] * (config.hulls is not None)
        wanted += [f"{config.max_planes} half-planes"] * (config.max_planes is not None)
        wanted += [f"{config.max_bytes} bytes"] * (config.max_bytes is not None)
        limit = "" if config.max_growth is None else f" at a growth of at most {config.max_growth:g}"
        raise InfeasibleError(
            f"no cover with {' and '.join(wanted)}{limit}: merging ends at {hulls:.0f} hulls with"
            f" {planes:.0f} half-planes and {size:.0f} bytes; relax a limit"
        )
    if config.max_growth is not None and growth > config.max_growth:
        raise InfeasibleError(
            f"the cover grows the voxels by {growth:.6g} already with {hulls:.0f} hulls, more than"
            f" {config.max_growth:g}; a smaller --cluster-radius starts finer"
        )


def _volume_method(found: dict[str, Any]) -> dict[str, Any]:
    """Method that measured the volume of the union, and its error."""
    if found["lines"] == 0:
        return {
            "method": "exact volume of the union, cut into convex pieces",
            "rounding_error_voxels": float(found["union_error"]),
        }
    return {
        "method": "estimate: z-intervals of the union of hulls along a midpoint grid of vertical lines,"
        " because cutting it into convex pieces would have taken too long",
        "lines_per_voxel_column": int(found["lines"]) ** 2,
        "every_nth_column": int(found["stride"]),
    }


def cover_guarantee(earlier: Guarantee | None, voxels: int, *, is_outer: bool) -> Guarantee:
    """Guarantee of a cover of a number of voxels, from that of the voxels or of an earlier cover of them."""
    before = earlier or Guarantee("", {})
    _, mark, rest = before.statement.partition("exactly, in integers.")
    kind = "an outer polytope" if is_outer else "a hull"
    statement = f"Each of the {voxels} occupied voxels lies in {kind} that lists it as a member, exactly, in"
    return Guarantee(
        f"{statement} integers. {rest.strip() if mark else before.statement}".strip(),
        {**before.claims, "covered_voxels": voxels, "uncovered_voxels": 0},
    )


def _curve(rows: NDArray[np.float64], measured: NDArray[np.float64], voxels: int) -> dict[str, Any]:
    """Merge curve: the sum of W, half-planes and bytes against the number of hulls n.

    It has at most about sixty points, evenly in log n. The estimate counts a volume once for each hull that
    encloses it, before tightening. `measured` holds the covers with a measured union, after tightening and
    capping.
    """
    count = rows[:, 0]
    wanted = np.geomspace(count[0], count[-1], _CURVE_POINTS)
    chosen = np.unique(np.clip(np.rint(count[0] - wanted), 0, len(rows) - 1).astype(np.int64))
    return {
        "hulls": [int(n) for n in rows[chosen, 0]],
        "excess_sum_voxels": [float(w) for w in rows[chosen, 1]],
        "conservativeness_estimate": [float(1.0 + w / voxels) for w in rows[chosen, 1]],
        "half_planes": [int(p) for p in rows[chosen, 2]],
        "bytes": [int(b) for b in rows[chosen, 3]],
        "measured": {
            "hulls": [int(n) for n in measured[:, 0]],
            "half_planes": [int(p) for p in measured[:, 1]],
            "bytes": [int(b) for b in measured[:, 2]],
            "conservativeness": [float(1.0 + w / voxels) for w in measured[:, 3]],
        },
    }
