"""The filters that run natively: `polytope-cbf`, and `none` with the same margins."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.errors import UsageError
from alula.schemas.filter_options import NATIVE_NAMES, PARTS, PolytopeCbfParameters
from alula.schemas.filters.values import entries
from alula.stages.filtering.protocol import FilterResult, FilterStatus, World

_NATIVE = PARTS["polytope-cbf"][0].names


class NativeFilter:
    """The onboard polytope filter behind the common protocol.

    u is the velocity nearest to u_nom with grad s . u >= -beta (s - r) and |u| <= v_max, where
    s <= psi(p) = min_k max_l (n_kl . p - d_kl); the step held for dt is then clipped against every
    hull grown by r. So a flight that starts with psi >= r keeps psi >= r at all times, between
    samples too, and stays at least r away from every hull. With smoothing "paper" nothing of
    this is guaranteed. With `world.image` the hulls are those of an onboard map, which contain the
    cover's, and the commands those of a microcontroller that has it.

    Source: PolyMerge (arXiv 2606.16232), eq. 2, 3, 17; native/onboard/include/alula_polytope_cbf.h.

    Args:
        world: obstacles, vehicle and rate.
        parameters: see `PolytopeCbfParameters`; `onboard` is not among them, `world.image` stands for it.
        enabled: False always returns the nominal input and only reports the margin.

    Raises:
        UsageError: a parameter is unknown or has no meaning.
    """

    def __init__(self, world: World, parameters: Mapping[str, Any], *, enabled: bool = True) -> None:
        known = {name: entry for name, entry in entries(PolytopeCbfParameters).items() if name in _NATIVE}
        if unknown := sorted(parameters.keys() - known.keys()):
            raise UsageError(f"polytope-cbf: unknown parameter {unknown[0]!r}; it has {', '.join(known)}")
        values = {name: parameters.get(name, entry.default) for name, entry in known.items()}
        hulls = world.hulls
        options: dict[str, Any] = {
            "extent_m": world.extent_m,
            "radius_m": world.radius_m,
            "dt_s": world.dt_s,
            "v_max": world.speed_m_s,
            **{NATIVE_NAMES["polytope-cbf"].get(name, name): value for name, value in values.items()},
        }
        try:
            if world.image and enabled:
                self.native = _core.PolytopeCbf.from_image(world.image, **options)
            else:
                self.native = _core.PolytopeCbf(
                    np.ascontiguousarray(hulls.normal_world),
                    np.ascontiguousarray(hulls.offset_m),
                    np.ascontiguousarray(hulls.plane_start),
                    **options,
                )
        except (TypeError, ValueError) as error:
            raise UsageError(f"polytope-cbf: {error}") from error
        self.enabled = enabled

    def __call__(self, x: FloatArray, u_nom: FloatArray) -> FilterResult:
        """See `Filter`; the margin is s - r."""
        u, status, margin, _, active = self.native.filter(x.tolist(), u_nom.tolist())
        if not self.enabled:
            return FilterResult(u_nom, FilterStatus.OK, margin, active)
        return FilterResult(np.array(u), FilterStatus(status), margin, active)


def polytope_cbf(world: World, parameters: Mapping[str, Any]) -> NativeFilter:
    """The filter `polytope-cbf`."""
    return NativeFilter(world, parameters)


def no_filter(world: World, parameters: Mapping[str, Any]) -> NativeFilter:
    """The filter `none`: flies the nominal input."""
    return NativeFilter(world, parameters, enabled=False)
