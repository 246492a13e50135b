"""What the certified steps of a shield prove, in words and as claims."""

from __future__ import annotations

from typing import Any

from alula.schemas.artifact import Artifact
from alula.schemas.configs.simulate import SimulateConfig
from alula.schemas.decimals import exact
from alula.schemas.vehicle import Vehicle
from alula.stages.compression.level import level_words
from alula.stages.filtering.ellipsoid_filters import BOTH, ELLIPSOIDS, HULLS, certified_against
from alula.stages.vehicles.bodies import left_out

_SHIELD = ("margin_m", "rest_drift_m", "early_end")  # parameters that the certificate of a step depends on
_KEPT_FROM = {
    ELLIPSOIDS: "every ellipsoid",
    HULLS: "every hull of the cover",
    BOTH: "every ellipsoid and every hull of the cover",
}


def shield_of(config: SimulateConfig) -> dict[str, Any]:
    """The parameters that a certificate depends on; None for one that the filter does not have.

    Args:
        config: see `SimulateConfig`, resolved.
    """
    return {name: config.filter_parameters.get(name) for name in _SHIELD}


def certified_words(config: SimulateConfig, vehicle: Vehicle, certified: int, steps: int) -> str:
    """State what the certified steps of a run prove.

    Args:
        config: see `SimulateConfig`, resolved.
        vehicle: that was flown.
        certified: number of certified steps.
        steps: number of all steps.
    """
    shield = shield_of(config)
    proven = "all" if certified == steps else f"{certified} of {steps}"
    obstacles = _KEPT_FROM[certified_against(config.filter, config.filter_parameters) or ELLIPSOIDS]
    words = (
        f"In {proven} steps the filter proved, by a rollout, that a backup manoeuvre from the end of the "
        f"step keeps {_kept(shield)} from {obstacles} until it rests, for {_model(config, vehicle)}."
        f"{_tested(shield)}"
    )
    if outside := left_out(vehicle):
        words += f" These flights had {', '.join(outside)}, which that model leaves out."
    return words


def chain_of(
    config: SimulateConfig,
    vehicle: Vehicle,
    cover: Artifact,
    *,
    hull_radius_m: float,
    every_step_certified: bool,
) -> dict[str, Any]:
    """The chain from the scene to the flight, when the shield certified against the hulls of a cover.

    scene within cover (`alula verify`) + every step certified against the cover => the vehicle met no
    ellipsoid of the scene.

    Args:
        config: see `SimulateConfig`, resolved.
        vehicle: that was flown.
        cover: certified against.
        hull_radius_m: radius kept from its hulls [m].
        every_step_certified: whether all steps of all flights were certified.

    Returns:
        `statement`; `holds`: whether all that the run can check does; `assumptions`, one sentence each.
    """
    assert config.radius_m is not None
    level: Any = cover.manifest
    outside, missing = left_out(vehicle), not_covered(level)
    added = hull_radius_m - config.radius_m
    delay, lag = vehicle.assumed.delay_s, vehicle.assumed.motor_time_constant_s
    assumptions = [
        "Cover: alula verify proves that its hulls contain the ellipsoids of the scene at "
        f"{level_words(level.sigma)}, grown by {exact(level.inflation_m)} m; the run does not check this."
        + (f" The cover leaves out {', '.join(missing)}." if missing else ""),
        "Model: the vehicle is a rigid body with the limits of its rotors, commanded by "
        + ("thrust and torque" if config.interface == "wrench" else "thrust and body rates")
        + f" that are held for {exact(config.dt_s * config.filter_ticks)} s"
        + _rate_loop(config, vehicle)
        + (f", with a motor time constant of {exact(lag)} s." if lag else ", and its rotors follow at once."),
        "Estimation: the state that the filter gets has no error"
        + (f"; it is {exact(delay)} s old, and the model predicts the present one." if delay else "."),
        f"Delay: the filter assumes {exact(delay)} s, which must be the true one.",
        f"Inflation: {exact(added)} m beyond the vehicle's radius and {exact(level.inflation_m)} m in the "
        "cover bound the error of the scene's alignment and whatever else the model leaves out.",
        *([f"Rest:{_tested(shield_of(config))}"] if _tested(shield_of(config)) else []),
        "World: the obstacles do not move, and the scene contains the real ones.",
    ]
    breaks = [f"The cover leaves out {', '.join(missing)}."] if missing else []
    breaks += [f"These flights had {', '.join(outside)}, which the model leaves out."] if outside else []
    words = (
        "Every step was certified against the hulls of the cover."
        if every_step_certified
        else "Not every step was certified against the hulls of the cover, so the chain is broken."
    )
    if every_step_certified:
        words += (
            " Where alula verify proves that the scene lies in the cover, the vehicle met no ellipsoid of "
            "the scene, under the assumptions listed."
        )
    return {
        "statement": " ".join([words, *breaks]),
        "holds": every_step_certified and not outside and not missing,
        "assumptions": assumptions,
    }


def not_covered(level: Any) -> list[str]:
    """What a cover leaves out of the scene by its own parameters, in words.

    Args:
        level: manifest of the cover.
    """
    found = {
        f"voxels that fewer than {level.min_overlap} ellipsoids touch": level.min_overlap > 1,
        f"Gaussians of opacity below {exact(level.min_opacity)}": level.min_opacity > 0,
        "everything outside of its crop": level.crop is not None,
        "the loss of the splat file's format": level.ignore_loss,
    }
    return [words for words, is_so in found.items() if is_so]


def _rate_loop(config: SimulateConfig, vehicle: Vehicle) -> str:
    """The modelled rate loop, in words."""
    if config.interface == "wrench":
        return ""
    return f", which a rate loop with a time constant of {exact(vehicle.rates.time_constant_s)} s follows"


def _model(config: SimulateConfig, vehicle: Vehicle) -> str:
    """The filters' model of the vehicle, in words."""
    table = vehicle.assumed
    lag = f"a motor time constant of {exact(table.motor_time_constant_s)} s"
    delay = f"states that are {exact(table.delay_s)} s old"
    loop = f"a rate loop with a time constant of {exact(vehicle.rates.time_constant_s)} s"
    parts = (
        (loop, config.interface != "wrench"),
        (lag, table.motor_time_constant_s),
        (delay, table.delay_s),
    )
    known = [text for text, value in parts if value]
    return f"the model with {' and '.join(known)}" if known else "the model without disturbances"


def _kept(shield: dict[str, Any]) -> str:
    """Distance that a certified manoeuvre keeps until it rests, in words."""
    margin = shield.get("margin_m")
    return (
        f"the radius and half of margin_m, {exact(margin / 2)} m,"
        if isinstance(margin, float)
        else "the radius"
    )


def _tested(shield: dict[str, Any]) -> str:
    """What of a certificate is tested and not proven, in words."""
    drift = shield.get("rest_drift_m")
    if not isinstance(drift, float):  # a filter of another package
        return ""
    words = (
        f" At rest the linear loop about hover drifts by at most {exact(drift)} m; that the nonlinear loop "
        "stays within half of margin_m is tested, not proven."
    )
    if shield.get("early_end"):
        words += (
            " So is the early end of rollouts, where twice the excursion of the linear loop is free "
            "(early_end=false rolls all out to rest)."
        )
    return words
