"""What flights have and the model of their last filter leaves out, derived from every key of a scenario.

`DIFFERENCES` names the keys in which the plant can differ from that model, with the value at which it does
not. `NO_DIFFERENCE` has the reason why no value of the other keys makes one. A key belongs to exactly one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from alula.schemas.decimals import exact
from alula.schemas.scenarios.scenario import Scenario
from alula.stages.simulation.piloted import fence_filter_of
from alula.stages.world.world import PLANT_STEP_S, plant_steps_of

_BY_ROTORS = ("wrench", "body-rates")
_FOLLOWED = ("velocity", "acceleration")
_NOT_BY_STICKS = (*_FOLLOWED, *_BY_ROTORS)
_ALL = (*_NOT_BY_STICKS, "sticks")
_STEP_TOLERANCE = 1 + 1e-9  # relative; of a rounded step


@dataclass(frozen=True, slots=True)
class Difference:
    """A part of the plant that the model of a filter has in one way only.

    Attributes:
        what: it is, in words.
        keys: of the scenario, with dots between.
        modelled: value in the model; None: a key without a value.
        is_bound: whether the model holds for all values up to that.
        interfaces: of the vehicle with which the keys have an effect.
    """

    what: str
    keys: tuple[str, ...]
    modelled: Callable[[Scenario], float] | float | None = 0.0
    is_bound: bool = False
    interfaces: tuple[str, ...] = _ALL

    def words(self, scenario: Scenario) -> str | None:
        """Name the keys whose values differ from the model; None where there are none."""
        if scenario.vehicle.interface not in self.interfaces:
            return None
        known = self.modelled(scenario) if callable(self.modelled) else self.modelled
        values = {key.rpartition(".")[2]: value_at(scenario, key) for key in self.keys}
        found = [
            f"{name} {exact(value)}"
            for name, value in values.items()
            if _differs(value, known, self.is_bound)
        ]
        if found and callable(self.modelled):
            found.append(f"assumed {exact(known or 0.0)}")
        return f"{self.what} ({', '.join(found)})" if found else None


def _differs(value: Any, known: float | None, is_bound: bool) -> bool:
    if known is None or value is None:
        return value is not None and (known is None or known != 0)
    items = value if isinstance(value, tuple) else (value,)
    return any(item > known if is_bound else item != known for item in items)


def _latency_s(scenario: Scenario) -> float:
    """The delay that the geofence of a pilot makes up for [s]; 0 without one."""
    name = fence_filter_of(scenario)
    return 0.0 if name is None else float(scenario.safety.parameters(name).latency_s)  # type: ignore[union-attr]


DIFFERENCES = (
    Difference(
        "drag", ("vehicle.disturbance.linear_drag_n_s_m", "vehicle.disturbance.quadratic_drag_n_s2_m2")
    ),
    Difference("wind", ("vehicle.disturbance.wind_m_s", "vehicle.disturbance.gust_m_s")),
    Difference(
        "noise",
        (
            *("estimation.position_noise_m", "estimation.velocity_noise_m_s"),
            *("estimation.attitude_noise_rad", "estimation.rate_noise_rad_s"),
            *("estimation.sensor.own_position_sigma_m", "estimation.sensor.own_velocity_sigma_m_s"),
        ),
    ),
    # A geofence tells when measurements are missing.
    Difference("lost measurements", ("estimation.lost_share",), interfaces=_NOT_BY_STICKS),
    Difference("an outage of measurements", ("estimation.lost_from_s",), None, interfaces=_NOT_BY_STICKS),
    Difference(
        "an estimate of disturbances, whose error has no proven bound",
        ("estimation.disturbance_time_s",),
        interfaces=_BY_ROTORS,
    ),
    Difference(
        "a mass or thrust other than the model's",
        ("vehicle.mass_scale", "vehicle.thrust_scale"),
        modelled=1.0,
    ),
    Difference(
        "a rate loop other than the model's",
        ("vehicle.rate_gain_scale",),
        modelled=1.0,
        interfaces=("sticks", "body-rates"),
    ),
    # A racer has no rotors.
    Difference(
        "a motor lag other than assumed",
        ("vehicle.disturbance.motor_time_constant_s",),
        lambda scenario: scenario.vehicle.assumed.motor_time_constant_s or 0.0,
        interfaces=_NOT_BY_STICKS,
    ),
    Difference(
        "a delay other than assumed",
        ("estimation.delay_s",),
        lambda scenario: scenario.vehicle.assumed.delay_s or 0.0,
        interfaces=_NOT_BY_STICKS,
    ),
    Difference(
        "a delay other than assumed",
        ("estimation.delay_s",),
        _latency_s,
        is_bound=True,
        interfaces=("sticks",),
    ),
    Difference("a battery that sags", ("vehicle.disturbance.sag_share",), interfaces=("sticks",)),
)
"""Keys in which a plant can differ from the model; the steps of the plant and the interface besides them."""

COARSE = "rules.plant_steps"
INTERFACE = "vehicle.interface"


def value_at(scenario: Scenario, key: str) -> Any:
    """The value of a key.

    Args:
        key: with dots between.
    """
    value: Any = scenario
    for part in key.split("."):
        value = getattr(value, part)
    return value


def left_out(scenario: Scenario) -> list[str]:
    """What flights have and the model of their last filter leaves out, in words with keys and values."""
    found = [words for each in DIFFERENCES if (words := each.words(scenario)) is not None]
    if scenario.vehicle.interface in _FOLLOWED:
        found.append("the vehicle's own cascade")
    steps = plant_steps_of(scenario, is_point=False)
    step_s = scenario.rules.dt_s / steps
    if scenario.vehicle.interface in _BY_ROTORS and step_s > PLANT_STEP_S * _STEP_TOLERANCE:
        loop = " and a rate loop" if scenario.vehicle.interface == "body-rates" else ""
        found.append(
            f"a plant{loop} by steps of {exact(step_s)} s, longer than the model's "
            f"{exact(PLANT_STEP_S)} s (plant_steps {steps})"
        )
    return found
