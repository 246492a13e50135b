"""Conditions of any flight: its geofence, requirements of its checks, and limits of its supervisor."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from alula._core import Fence
from alula.schemas.arrays import FloatArray
from alula.schemas.parameters.configs.flight import FlightConfig
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.flight.loop.departures import Departures
from alula.stages.flight.loop.fence_guard import FenceGuard, rates_model
from alula.stages.flight.loop.preflight import Needs, Obstacles
from alula.stages.flight.loop.supervisor import SupervisorLimits
from alula.stages.vehicles.setpoints import RatesSetpoint, Setpoint
from alula.stages.vehicles.velocity_lag import stop_m


def guard_of(
    config: FlightConfig,
    vehicle: Vehicle,
    fence: Fence,
    accepts: frozenset[type[Setpoint]],
    *,
    reserve_m: float,
) -> FenceGuard:
    """Build the geofence behind all that is sent.

    Args:
        reserve_m: distance that it keeps beyond the radius [m].
    """
    return FenceGuard(
        fence,
        vehicle,
        dt_s=1 / config.rate_hz,
        takes_rates=RatesSetpoint in accepts,
        reserve_m=reserve_m,
        latency_s=config.latency_s,
    )


def needs_of(
    config: FlightConfig,
    vehicle: Vehicle,
    *,
    setpoints: Iterable[type[Setpoint]],
    ends: tuple[FloatArray, FloatArray],
    departures: Departures,
    obstacles: Sequence[tuple[str, Obstacles]],
    margin_m: float,
    fence: Fence,
    plan: tuple[bool, str],
    speed_m_s: float,
    map_origin_m: Sequence[float] | None = None,
    map_words: str = "",
) -> Needs:
    """Requirements of a flight for the pre-flight checks.

    Args:
        setpoints: kinds of set-points; the link must accept one of them.
        ends: start and goal, each of shape (3,), world frame [m].
        departures: instants of the flight from which the vehicle may turn home, world frame.
        plan: whether the flight is proven clear of the map, and how, in words.
        map_origin_m: position in the world that became the map's origin [m]; None where it is its own.
    """
    law = vehicle.following.horizontal_lag
    model = rates_model(vehicle)
    return Needs(
        setpoints=frozenset(setpoints),
        start=ends[0],
        goal=ends[1],
        departures=departures,
        obstacles=obstacles,
        map_origin_m=map_origin_m,
        map_words=map_words,
        radius_m=vehicle.body.radius_m,
        margin_m=margin_m,
        fence=fence,
        plan=plan,
        speed_m_s=speed_m_s,
        stop_m=stop_m(law, speed_m_s),
        near_m=config.near_m,
        state_hz=min(20.0, 0.5 * config.rate_hz),
        loop_hz=config.rate_hz,
        stale_s=config.stale_s,
        latency_s=config.latency_s,
        battery_share=config.battery,
        max_thrust_m_s2=sum(model.thrust),
        gravity_m_s2=model.gravity,
    )


def limits_of(config: FlightConfig, **more: Any) -> SupervisorLimits:
    """Limits of the supervisor."""
    return SupervisorLimits(stale_s=config.stale_s, battery_share=config.landing_share, **more)
