"""What `polytope-cbf` guarantees among hulls, and where its condition on starts does not hold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.decimals import at_least, at_most
from alula.schemas.log.run import TrialResult
from alula.schemas.scenarios.scenario import Scenario
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.clearance import is_collision

FILTER = "polytope-cbf"
_NOISE = ("position_noise_m", "velocity_noise_m_s", "delay_s", "lost_share", "lost_from_s")


def unsafe_starts(trials: Sequence[TrialResult]) -> list[float]:
    """Margins psi - radius of the trials that violate the filter's start condition [m]."""
    return [m for trial in trials if (m := trial.start_margin_m) is not None and m < 0]


def note_of_starts(trials: Sequence[TrialResult]) -> list[str]:
    """Note for the summary where starts violate the filter's condition."""
    unsafe = unsafe_starts(trials)
    if not unsafe:
        return []
    return [
        f"{len(unsafe)} of {len(trials)} flights began with psi below the radius, by up to "
        f"{at_most(-min(unsafe))} m: the filter guaranteed nothing for them"
    ]


def note_of_psi(points: FloatArray, among: _core.PolytopeCbf, keep_m: float) -> list[str]:
    """Note for the summary where psi is below what the filter keeps, although the plan is far enough away.

    Args:
        points: along the plan, shape (K, 3), world frame [m].
        keep_m: distance that the filter keeps from hulls [m].
    """
    lowest = float(among.psi(points)[0].min(initial=math.inf))
    if lowest >= keep_m:
        return []
    return [
        f"psi falls to {at_least(lowest)} m along the plan, below the radius: near edges the filter may hold "
        "the vehicle back"
    ]


def is_exact(scenario: Scenario, vehicle: Vehicle) -> bool:
    """Whether the vehicle is the one of the filter's proof: a single integrator with exact state."""
    known = scenario.estimation
    return vehicle.model == "single-integrator" and not any(getattr(known, name) for name in _NOISE)


def proof_among_hulls(
    scenario: Scenario, vehicle: Vehicle, cover: Artifact | None, trials: Sequence[TrialResult]
) -> tuple[str, str, dict[str, Any]]:
    """State what is proven of flights behind `polytope-cbf`, and of single integrators among hulls.

    Returns:
        What was guaranteed beforehand and the limits of that, both empty where other words apply; and claims.
    """
    names = scenario.safety.filters
    is_last = bool(names) and names[-1] == FILTER
    is_sound = scenario.safety.polytope_cbf.smoothing == "sound"
    exact, unsafe = is_exact(scenario, vehicle), unsafe_starts(trials)
    proven = is_last and is_sound and exact
    met = sum(is_collision(trial.map_clearance_m) for trial in trials)
    hits = sum(is_collision(trial.map_clearance_m, trial.scene_clearance_m) for trial in trials)
    beforehand = limits = ""
    if is_last and not is_sound:
        beforehand = "UNSAFE: the smoothing as printed may exceed the true barrier and steps are not checked."
    elif proven:
        beforehand = (
            "From every start with psi >= radius, the filter keeps psi >= radius at every sample and, by "
            "clipping each held step against every hull, between samples; psi never exceeds the distance "
            "to a hull."
        )
        if unsafe:
            beforehand += (
                f" {len(unsafe)} of {len(trials)} starts violated this condition, by up to "
                f"{at_most(-min(unsafe))} m; for them nothing was guaranteed beforehand."
            )
        if met:
            beforehand += f" This did not hold: {met} of {len(trials)} flights touched a hull."
        limits = (
            "This holds for a velocity-controlled point with exact state, and for the real scene only as far "
            "as the cover contains it."
        )
    if not is_last and not (exact and scenario.world.has_hulls):
        return beforehand, limits, {}
    given = None if cover is None else cover.manifest.guarantee
    claims: dict[str, Any] = {
        "proven_by_filter": proven and not unsafe and not met,
        "map_clear": hits == 0,
        "map_collisions": hits,
        "continuous_time": True,
        "cover_claims": given.claims if given is not None else {},
    }
    if exact:
        claims["vehicle_model"] = "single integrator, exact state, input held for dt"
    if is_last:
        claims |= {"start_condition": "psi >= radius", "unsafe_starts": len(unsafe)}
    return beforehand, limits, claims
