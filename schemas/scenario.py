"""Scenarios: a whole simulation in one TOML file, `alula/scenario`.

    schema = "alula/scenario"     # optional, as is the version
    version = "1.0"
    name = "room, 150 hulls"

    [map]
    cover = "room.cover.npz"      # relative to this file
    scene = "room.scene.npz"      # optional: also judge the flights against its ellipsoids
    sigma = 1.0                   # level of the ellipsoids, or confidence; for filters that see them
    plan = "room.plan.npz"        # optional: fly this instead of random pairs

    [vehicle]
    radius_m = 0.1
    v_max_m_s = 1.0               # among ellipsoids: peak speed of the references
    file = "drone.vehicle.toml"   # what flies
    plant = "quadrotor"           # for filters that see ellipsoids, as is the next
    interface = "wrench"

    [filter]
    name = "polytope-cbf"
    parameters = { beta = 2.0, kappa_per_m = 100.0, smoothing = "sound", onboard = false }

    [controller]
    gain = 2.0
    guide = "cone-di"             # for filters that see ellipsoids, as are the next two
    guide_parameters = { alpha = 5.0 }
    catch_up_m_s = 1.0

    [trials]
    count = 100
    seed = 0
    bounds_m = [-3.0, -3.0, 0.2, 3.0, 3.0, 2.0]
    pairs = "any"                 # or "blocked", for filters that see ellipsoids

    [run]
    dt_s = 0.01
    filter_ticks = 1              # for filters that see ellipsoids, as is controller_ticks
    max_time_s = 60.0
    via_tolerance_m = 0.1         # along a plan: within this, a via point counts as passed
    allow_tight = false           # fly a plan that is nearer to the map than the filter lets the vehicle be

    [fly]                         # for `alula fly` alone, which flies `[map] plan`
    link = "udpin:127.0.0.1:14550"
    rate_hz = 100.0
    margin_m = 0.1
    fence_m = [-1.0, -1.0, -0.5, 9.0, 7.0, 3.0]
    frame_check = "hand"

Only `[map] cover` is required, or `[map] scene` for a filter that sees its ellipsoids. `world_upgrade`
converts such files to version 2.0, whose reader checks the ranges of their values.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, Literal

import msgspec

from alula.schemas.configs.fly import FlyConfig
from alula.schemas.errors import UsageError
from alula.schemas.filter_options import PolytopeCbfParameters
from alula.schemas.filters.values import entries
from alula.schemas.manifest import VERSION
from alula.schemas.toml_file import read_toml, read_tree

SCENARIO_SCHEMA: Literal["alula/scenario"] = "alula/scenario"

DEFAULT_FILTER = "polytope-cbf"
# The filters of this package whose parameters a scenario with a cover or a scene has.
SCENARIO_FILTERS = ("none", "polytope-cbf", "safer-splat", "cone-di", "cone-ecbf", "cone-backup", "shield")

_HULL_PARAMETERS = entries(PolytopeCbfParameters)


class _Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """A table of the file: unknown keys are refused, absent ones stay None."""


class MapTable(_Table, frozen=True, kw_only=True):
    """Files, relative to the scenario's folder, and the level of the scene's ellipsoids."""

    cover: str | None = None
    scene: str | None = None
    plan: str | None = None
    sigma: float | None = None
    confidence: float | None = None
    inflation_m: float | None = None


class VehicleTable(_Table, frozen=True, kw_only=True):
    """The vehicle: a sphere; among ellipsoids also its file, plant and interface."""

    radius_m: float | None = None
    v_max_m_s: float | None = None
    file: str | None = None
    plant: Literal["quadrotor", "double-integrator"] | None = None
    interface: Literal["wrench", "body-rates"] | None = None


class FilterTable(_Table, frozen=True, kw_only=True):
    """The filter and its parameters; another package checks the parameters of its filters itself."""

    name: str | None = None
    parameters: dict[str, Any] = {}


class ControllerTable(_Table, frozen=True, kw_only=True):
    """The nominal controller; among ellipsoids also its guide and its catch-up speed."""

    gain: float | None = None
    guide: str | None = None
    guide_parameters: dict[str, Any] = {}
    catch_up_m_s: float | None = None


class TrialsTable(_Table, frozen=True, kw_only=True):
    """Random start-goal pairs."""

    count: int | None = None
    seed: int | None = None
    bounds_m: tuple[float, float, float, float, float, float] | None = None
    margin_m: float | None = None
    separation: float | None = None
    stop_fraction: float | None = None
    pairs: Literal["any", "blocked"] | None = None
    planned: bool | None = None


class RunTable(_Table, frozen=True, kw_only=True):
    """Time steps and limits."""

    dt_s: float | None = None
    controller_ticks: int | None = None
    filter_ticks: int | None = None
    max_time_s: float | None = None
    via_tolerance_m: float | None = None
    allow_tight: bool | None = None
    log_rate_hz: float | None = None


class FlyTable(_Table, frozen=True, kw_only=True):
    """A real flight: its link, and options of `fly` by name."""

    link: str | None = None
    speed_m_s: float | None = None
    rate_hz: float | None = None
    margin_m: float | None = None
    fence_m: tuple[float, float, float, float, float, float] | None = None
    fence_map: bool | None = None
    fence_reserve_m: float | None = None
    latency_s: float | None = None
    velocity_lag_s: float | None = None
    frame_check: Literal["motion", "hand", "none"] | None = None
    near_m: float | None = None
    allow_blocked: bool | None = None
    replan_after_s: float | None = None
    replans: int | None = None
    battery: float | None = None
    stale_s: float | None = None
    fallback_s: float | None = None


class Scenario(_Table, frozen=True, kw_only=True):
    """A scenario file."""

    map: MapTable
    schema: Literal["alula/scenario"] = SCENARIO_SCHEMA
    version: str = VERSION
    name: str | None = None
    vehicle: VehicleTable = VehicleTable()
    filter: FilterTable = FilterTable()
    controller: ControllerTable = ControllerTable()
    trials: TrialsTable = TrialsTable()
    run: RunTable = RunTable()
    fly: FlyTable | None = None

    def fly_settings(self) -> dict[str, Any]:
        """Fields of `FlyConfig` that the file sets, and its link."""
        own = {} if self.fly is None else msgspec.structs.asdict(self.fly)
        own["fence"] = own.pop("fence_m", None)
        is_own = self.filter.name in (None, DEFAULT_FILTER)
        known = {item.name for item in dataclasses.fields(FlyConfig)} & _HULL_PARAMETERS.keys()
        parameters = {key: value for key, value in self.filter.parameters.items() if key in known}
        values: dict[str, Any] = {
            "name": self.name,
            "filter": self.filter.name,
            "speed_m_s": self.vehicle.v_max_m_s,
            "sigma": self.map.sigma,
            "inflation_m": self.map.inflation_m,
            "gain": self.controller.gain,
            "catch_up_m_s": self.controller.catch_up_m_s,
            "max_time_s": self.run.max_time_s,
            "via_tolerance_m": self.run.via_tolerance_m,
            "allow_tight": self.run.allow_tight,
            "log_rate_hz": self.run.log_rate_hz,
            **(parameters if is_own else {"filter_parameters": self.filter.parameters or None}),
            **own,
        }
        return {key: value for key, value in values.items() if value is not None}


def read_scenario(path: Path) -> Scenario:
    """Read a scenario.

    Raises:
        InputError: the file cannot be read or is not TOML.
        VersionError: it was written for a later major version.
        UsageError: a key is unknown, missing, of the wrong type or out of range; the message has its path.
    """
    tree = read_tree(path)
    if "version" not in tree and "map" not in tree:
        raise UsageError(
            f"{path}: has neither `version` nor `map`; a scenario of version 2.0 begins with "
            f'schema = "{SCENARIO_SCHEMA}" and version = "2.0"'
        )
    scenario = read_toml(path, Scenario, SCENARIO_SCHEMA)
    if scenario.map.cover is None and scenario.map.scene is None:
        raise UsageError(f"{path}: `$.map` needs a cover, or a scene for a filter that sees ellipsoids")
    if None not in (scenario.map.sigma, scenario.map.confidence):
        raise UsageError(f"{path}: `$.map.confidence`: sets sigma; give one of the two, not both")
    if scenario.filter.name in (None, DEFAULT_FILTER):
        _check_built_in_parameters(path, scenario.filter.parameters)
    elif scenario.filter.name == "none" and scenario.filter.parameters:
        raise UsageError(f"{path}: `$.filter.parameters`: the filter none has no parameters")
    return scenario


def _check_built_in_parameters(path: Path, parameters: dict[str, Any]) -> None:
    for key, value in parameters.items():
        where = f"{path}: `$.filter.parameters.{key}`"
        if key not in _HULL_PARAMETERS:
            raise UsageError(f"{where}: unknown; polytope-cbf has {', '.join(_HULL_PARAMETERS)}")
        entry = _HULL_PARAMETERS[key]
        wanted = str if entry.choices else entry.type
        if not (isinstance(value, wanted) or (wanted is float and type(value) is int)):
            raise UsageError(f"{where}: Expected `{wanted.__name__}`")
