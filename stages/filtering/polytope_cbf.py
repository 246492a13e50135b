"""The filter `polytope-cbf` of velocities, and its barrier alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from alula import _core
from alula.schemas.errors import UsageError
from alula.schemas.parameters.filter_options import NATIVE_NAMES, NATIVE_STRUCTS, PolytopeCbfParameters
from alula.schemas.parameters.filters.values import entries
from alula.stages.filtering.bridge import NativeFilter
from alula.stages.filtering.protocol import FilterWorld

_NATIVE = NATIVE_STRUCTS["polytope-cbf"][0].names


def polytope_cbf(world: FilterWorld, parameters: Mapping[str, Any]) -> NativeFilter:
    """The onboard polytope filter.

    u is the velocity nearest to u_nom with grad s . u >= -beta (s - r) and |u| <= v_max, where
    s <= psi(p) = min_k max_l (n_kl . p - d_kl); the step held for dt is then clipped against every
    hull grown by r. So a flight that starts with psi >= r keeps psi >= r at all times, between
    samples too, and stays at least r away from every hull. With smoothing "paper" nothing of
    this is guaranteed. With `world.image` the hulls are those of an onboard map, which contain the
    cover's, and the commands those of a microcontroller that has it. With `world.tiles` they are those of the
    resident tile. In its region the commands are those of the whole onboard map; beyond it the space that
    is not loaded counts as an obstacle. Without a resident tile every velocity is refused. The margin is
    s - r.

    Source: PolyMerge (arXiv 2606.16232), eq. 2, 3, 17; native/onboard/include/alula_polytope_cbf.h.

    Args:
        world: with hulls.
        parameters: see `PolytopeCbfParameters`; `onboard` is not among them, `world.image` stands for it.

    Raises:
        UsageError: a parameter is unknown or has no meaning, there are no hulls, or tiles do not reach far
            enough.
    """
    values = _values(parameters)
    reads = bool(world.image) or world.tiles is not None
    return NativeFilter(_core.VelocityFilter(_native(world, values, reads=reads)), values)


def without_filter(world: FilterWorld, parameters: Mapping[str, Any]) -> NativeFilter:
    """What passes every velocity, and reports the margin of `polytope-cbf`.

    Args:
        world: with hulls.

    Raises:
        UsageError: as of `polytope_cbf`.
    """
    values = _values(parameters)
    native = _core.VelocityFilter(_native(world, values, reads=False), is_bare=True)
    return NativeFilter(native, values)


def barrier(world: FilterWorld) -> _core.PolytopeCbf:
    """The barrier of `polytope-cbf` with its defaults, for questions about points.

    Args:
        world: with hulls.

    Raises:
        UsageError: there are no hulls, or the radius has no meaning.
    """
    return _native(world, _values({}), reads=False)


def _values(parameters: Mapping[str, Any]) -> dict[str, Any]:
    known = {name: entry for name, entry in entries(PolytopeCbfParameters).items() if name in _NATIVE}
    if unknown := sorted(parameters.keys() - known.keys()):
        raise UsageError(f"polytope-cbf: unknown parameter {unknown[0]!r}; it has {', '.join(known)}")
    return {name: parameters.get(name, entry.default) for name, entry in known.items()}


def _native(world: FilterWorld, values: Mapping[str, Any], *, reads: bool) -> _core.PolytopeCbf:
    hulls = world.hulls
    if hulls is None:
        raise UsageError("polytope-cbf needs the hulls of a cover, and there are none")
    options: dict[str, Any] = {
        "extent_m": world.extent_m,
        "radius_m": world.keeps_m("hulls"),
        "dt_s": world.dt_s,
        "v_max": world.speed_m_s,
        **{NATIVE_NAMES["polytope-cbf"].get(name, name): value for name, value in values.items()},
    }
    try:
        if reads and world.tiles is not None:
            return _core.PolytopeCbf.from_tiles(world.tiles, world.tile_load_ticks, **options)
        if reads:
            return _core.PolytopeCbf.from_image(world.image, **options)
        return _core.PolytopeCbf(
            np.ascontiguousarray(hulls.normal_world),
            np.ascontiguousarray(hulls.offset_m),
            np.ascontiguousarray(hulls.plane_start),
            **options,
        )
    except (TypeError, ValueError) as error:
        raise UsageError(f"polytope-cbf: {error}") from error
