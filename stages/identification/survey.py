"""Parts of a flight of steps, built from its configuration: steps, fence, checks and options."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.identify import IdentifyConfig
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.flight.conditions import guard_of, limits_of, needs_of
from alula.stages.flight.loop.control_loop import LoopOptions
from alula.stages.flight.loop.departures import departures_at
from alula.stages.flight.loop.fence_guard import FenceGuard
from alula.stages.flight.loop.preflight import Needs
from alula.stages.identification.step_flight import StepFlight
from alula.stages.identification.steps import Steps, plan_steps
from alula.stages.vehicles.fence import fence
from alula.stages.vehicles.own_limits import first_guess, own_limits
from alula.stages.vehicles.setpoints import RatesSetpoint, Setpoint, VelocitySetpoint
from alula.stages.vehicles.velocity_lag import stop_m, stop_time_s

_BETWEEN_S = 20.0  # maximum time from the end of a step to the start of the next
_FENCE_RESERVE_M = 0.05


@dataclass(frozen=True, slots=True)
class Survey:
    """A flight of steps.

    Attributes:
        config: of the command.
        vehicle: first guess, with the limits that the vehicle's parameters give.
        steps: to fly, and those left out.
        fence: the box.
    """

    config: IdentifyConfig
    vehicle: Vehicle
    steps: Steps
    fence: _core.Fence

    @property
    def centre(self) -> FloatArray:
        """Centre of the box, shape (3,), world frame [m]."""
        box = np.array(self.config.box)
        centre: FloatArray = (box[:3] + box[3:]) / 2
        return centre

    @property
    def setpoints(self) -> tuple[type[Setpoint], ...]:
        """Kinds of set-points that the link must accept."""
        return (VelocitySetpoint, RatesSetpoint) if self.config.rates else (VelocitySetpoint,)


def make_survey(
    config: IdentifyConfig, vehicle: Vehicle, parameters: Mapping[str, float] | None = None
) -> Survey:
    """Plan the steps of a flight.

    Args:
        parameters: of the vehicle, by name, which take precedence over the first guess.

    Raises:
        UsageError: the vehicle has no rotors, or the box holds steps of fewer than two speeds along x or y.
    """
    if vehicle.model != "quadrotor":
        raise UsageError(f"{vehicle.name} is a {vehicle.model}; only a quadrotor is identified")
    guess = first_guess(vehicle, parameters or {})
    limits = own_limits(parameters or {})
    steps = plan_steps(
        guess,
        config.speeds_m_s,
        config.box,
        reserve_m=config.reserve_m,
        rates=config.rates,
        lean_rad=limits["lean"].value if "lean" in limits else math.inf,
        turns_rad_s2=limits["yaw acceleration"].value if "yaw acceleration" in limits else math.inf,
    )
    if len({abs(step.size) for step in steps.flown if step.kind == "velocity" and step.axis != 2}) < 2:
        raise UsageError(
            f"--box is too small for horizontal steps of two speeds; {steps.skipped[0]}; "
            "a larger box, lower --speeds or a smaller --reserve help"
        )
    low, high = config.box[:3], config.box[3:]
    return Survey(config, guess, steps, fence(box=(low, high), cover=None))


def make_step_flight(
    survey: Survey,
    *,
    throttle: Callable[[], float] = lambda: math.nan,
    say: Callable[[float, str], None] = lambda now_s, words: None,
) -> StepFlight:
    """Build the commander and clock.

    Args:
        throttle: throttle that the vehicle commands, a fraction; NaN if unknown.
        say: receives the time, monotonic clock [s], and the name of each step that begins.
    """
    vehicle, config = survey.vehicle, survey.config
    following, box = vehicle.following, np.array(config.box)
    fastest = max(config.speeds_m_s)

    def stop_along_m(speed_m_s: float, axis: int) -> float:
        return stop_m(following.vertical_lag if axis == 2 else following.horizontal_lag, speed_m_s)

    return StepFlight(
        survey.steps.flown,
        survey.centre,
        (box[3:] - box[:3]) / 2 - vehicle.body.radius_m,
        lag_s=max(
            stop_time_s(law, min(fastest, 1.0)) for law in (following.horizontal_lag, following.vertical_lag)
        ),
        stop_m=stop_along_m,
        gravity_m_s2=vehicle.body.gravity_m_s2,
        throttle=throttle,
        say=say,
    )


def make_step_guard(survey: Survey, accepts: frozenset[type[Setpoint]]) -> FenceGuard:
    """Build the geofence, which is the box."""
    return guard_of(survey.config, survey.vehicle, survey.fence, accepts, reserve_m=_FENCE_RESERVE_M)


def make_step_needs(survey: Survey) -> Needs:
    """Requirements for the pre-flight checks; the corners of the box stand for the path."""
    low, high = survey.config.box[:3], survey.config.box[3:]
    return needs_of(
        survey.config,
        survey.vehicle,
        setpoints=survey.setpoints,
        ends=(survey.centre, survey.centre),
        departures=departures_at(np.array(list(itertools.product(*zip(low, high, strict=True))))),
        obstacles=[],
        margin_m=0.0,
        fence=survey.fence,
        plan=(True, f"{len(survey.steps.flown)} steps in a box that is free, as the user says"),
        speed_m_s=max(survey.config.speeds_m_s),
    )


def make_step_options(survey: Survey, *, dry_run: bool) -> LoopOptions:
    """Parameters of the control loop."""
    longest_s = sum(step.duration_s + _BETWEEN_S for step in survey.steps.flown)
    limits = limits_of(survey.config, flight_s=longest_s)
    return LoopOptions(rate_hz=survey.config.rate_hz, limits=limits, dry_run=dry_run, margin_m=0.3)
