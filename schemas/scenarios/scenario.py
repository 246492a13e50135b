"""Scenarios, `alula/scenario`: a run is a choice of parts, one table a part.

    schema = "alula/scenario"
    version = "2.0"
    name = "room, two balls"

    [vehicle]                           # what flies
    type = "crazyflie21"                # built in by name; or file = "x.vehicle.toml"
    interface = "body-rates"

    [world]                             # what it must not touch: any union
    cover = "room.cover.npz"            # files are relative to the scenario's folder

    [world.fence]
    box_m = [0.1, 0.1, 0.1, 7.9, 5.9, 2.7]

    [[world.moving]]
    motion = "ballistic"
    distance_m = 4.0
    aims_at_vehicle = true

    [mission]                           # what it shall do
    kind = "pairs"

    [estimation]                        # what it knows of itself, and of what moves
    delay_s = 0.02

    [safety]                            # filters in their order; each gets the command of the one before
    filters = ["dr-acbf", "cone-backup"]

    [safety.cone-backup]                # parameters of a filter, under its name
    horizon_s = 2.0

    [rules]                             # time steps, number of trials, log
    trials = 1000

Every key has a default; `alula scenario --keys` lists and explains them all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import msgspec

from alula.schemas.artifacts.manifest import parse_version
from alula.schemas.decode import MalformedError, convert
from alula.schemas.errors import UsageError, VersionError, WrongKindError
from alula.schemas.parameters.filter_options import FILTERS, TABLES
from alula.schemas.parameters.flight_defaults import NO_FILTER
from alula.schemas.scenarios import ranges
from alula.schemas.scenarios.presets import with_preset
from alula.schemas.scenarios.tables import (
    SCENARIO_SCHEMA,
    EstimationTable,
    FlyTable,
    MissionTable,
    RulesTable,
    SafetyTable,
    VehicleTable,
    WorldTable,
    default_shield_map,
)
from alula.schemas.scenarios.types import Table, about
from alula.schemas.toml_file import read_tree

SCENARIO_VERSION = "2.0"

FILES = (
    *("vehicle.file", "world.cover", "world.tiles", "world.scene", "world.seen"),
    *("mission.plan", "mission.pairs_from"),
)
"""Keys that name files, relative to the scenario's folder."""

TEXTS = ("name", *FILES)
"""Keys whose values of --set are text as it stands."""

# Keys of which one replaces the other.
_EITHER = {
    "vehicle.type": "vehicle.file",
    "vehicle.file": "vehicle.type",
    "world.sigma": "world.confidence",
    "world.confidence": "world.sigma",
    "mission.start_m": "mission.start_box_m",
    "mission.start_box_m": "mission.start_m",
    "mission.start_velocity_m_s": "mission.start_speed_m_s",
    "mission.start_speed_m_s": "mission.start_velocity_m_s",
}
_ROWS = {"mission.waypoints_m": 3, "world.fence.faces": 4}  # lists of lists, which --set gives as one list

ELSEWHERE = {
    ("polytope-cbf", "onboard"): "world.onboard",
    ("geofence", "tick_s"): "rules.dt_s * rules.filter_ticks",
}
"""Parameters of filters, by table and name, that follow from other keys of the scenario."""


class Scenario(Table, frozen=True, kw_only=True):
    """A scenario; with the files that it names it determines the flights."""

    schema: Annotated[Literal["alula/scenario"], about("kind of the file")] = SCENARIO_SCHEMA
    version: Annotated[str, about("version of the format")] = SCENARIO_VERSION
    name: Annotated[str, about("name of the run, for reports", min_length=1)] = "run"
    vehicle: VehicleTable = VehicleTable()
    world: WorldTable = WorldTable()
    mission: MissionTable = MissionTable()
    estimation: EstimationTable = EstimationTable()
    safety: SafetyTable = SafetyTable()
    rules: RulesTable = RulesTable()
    fly: Annotated[FlyTable | None, about("a real flight: options of `alula fly`; None: not for it")] = None


class Read(NamedTuple):
    """A scenario, and where its values come from.

    Attributes:
        given: the keys of the file.
        changed: keys that --set replaced, with dots between.
    """

    scenario: Scenario
    given: Mapping[str, Any]
    changed: Sequence[str]


_NEW_PLANS = ("replan_after_s", "replans")


def read_scenario(path: Path, changes: Mapping[str, Any] | None = None) -> Scenario:
    """Read a scenario.

    Args:
        changes: values that replace those of the file, by their keys with dots between:
            `safety.cone-backup.horizon_s`, `world.moving.0.radius_m`. Tables that the file does not have are
            made. Names of files are relative to the folder of the scenario. Where one of two keys
            can be given, as `vehicle.type` and `vehicle.file`, a change removes the other.

    Raises:
        InputError: the file cannot be read or is not TOML.
        WrongKindError, VersionError: it is no scenario, or not one of version 2.
        UsageError: a key is unknown, of the wrong type or out of range; the message has its path.
    """
    return read_sources(path, changes).scenario


def read_sources(path: Path, changes: Mapping[str, Any] | None = None) -> Read:
    """Read a scenario as `read_scenario` does, and say where its values come from.

    Args:
        changes: as of `read_scenario`.

    Raises:
        InputError, WrongKindError, VersionError, UsageError: as `read_scenario`.
    """
    tree = read_tree(path)
    _check_version(path, tree)
    given = msgspec.msgpack.decode(msgspec.msgpack.encode(tree))
    return Read(changed(tree, str(path), changes), given, tuple(changes or ()))


def changed(tree: dict[str, Any], where: str, changes: Mapping[str, Any] | None = None) -> Scenario:
    """Replace values of plain values, and convert and check them.

    Args:
        tree: as of TOML; changed in place.
        where: before the messages, such as the name of the file.
        changes: as of `read_scenario`.

    Raises:
        UsageError: as `decoded`.
    """
    known = _filters(tree)
    for key, value in (changes or {}).items():
        _set(tree, key, value)
        if (other := _EITHER.get(key)) is not None and other not in (changes or {}):
            _remove(tree, other)
    return decoded(tree, where, known | _filters(tree))


def decoded(tree: dict[str, Any], where: str = "scenario", known: set[str] | None = None) -> Scenario:
    """Convert and check plain values.

    Args:
        tree: as of TOML; changed in place.
        where: before the messages, such as the name of the file.
        known: names of filters of other packages, which may have tables; default: those that are flown.

    Raises:
        UsageError: a key is unknown, of the wrong type or out of range; the message has its path.
    """
    _refuse_new_plans(tree, where)
    safety = tree.get("safety")
    if isinstance(safety, dict):
        _gather(safety, where, _filters(tree) if known is None else known)
    try:
        tree = with_preset(tree)
        scenario = _completed(convert(tree, Scenario), tree)
        ranges.check_finite(scenario)
        _check(scenario)
    except (MalformedError, UsageError) as error:
        raise UsageError(f"{where}: {error}") from error
    return scenario


def _refuse_new_plans(tree: Mapping[str, Any], where: str) -> None:
    """Refuse keys of new plans in flight, which the native runner of simulations cannot make."""
    for name in ("mission", "rules"):
        table = tree.get(name)
        for key in _NEW_PLANS:
            if isinstance(table, dict) and key in table:
                raise UsageError(
                    f"{where}: {name}.{key}: simulate makes no new plans in flight; alula fly with the link "
                    "sim: does, by this key of the table [fly]"
                )


def plain(scenario: Scenario) -> dict[str, Any]:
    """Plain values of a scenario as its file has them; keys without a value are left out."""
    tree: dict[str, Any] = _without_none(msgspec.to_builtins(scenario))
    tree["safety"] |= tree["safety"].pop("others")
    for name, key in ELSEWHERE:
        tree["safety"][name].pop(key)
    return tree


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    return [_without_none(item) for item in value] if isinstance(value, list | tuple) else value


def value_at(tree: Any, path: str) -> Any:
    """Plain value at a path, None where there is none.

    Args:
        path: of a key, with dots; a number is the place in a list.
    """
    for part in path.split("."):
        if isinstance(tree, Mapping):
            tree = tree.get(part)
        elif isinstance(tree, list) and int(part) < len(tree):
            tree = tree[int(part)]
        else:
            return None
    return tree


def _check_version(path: Path, tree: Mapping[str, Any]) -> None:
    """Refuse files of another kind or version, before their keys, which may be unknown here."""
    kind, version = tree.get("schema", SCENARIO_SCHEMA), tree.get("version")
    if kind != SCENARIO_SCHEMA:
        raise WrongKindError(f"{path}: is {kind}, but {SCENARIO_SCHEMA} is needed")
    if version is None:
        raise VersionError(
            f'{path}: has no `version`; a scenario begins with schema = "{SCENARIO_SCHEMA}" and version = '
            f'"{SCENARIO_VERSION}"'
        )
    try:
        major, _ = parse_version(str(version))
    except ValueError as error:
        raise UsageError(f"{path}: `$.version`: {error}") from error
    if major != parse_version(SCENARIO_VERSION)[0]:
        raise VersionError(f"{path}: is {SCENARIO_SCHEMA} of version {version}; {SCENARIO_VERSION} is read")


def _filters(tree: Mapping[str, Any]) -> set[str]:
    safety = tree.get("safety")
    names = safety.get("filters", ()) if isinstance(safety, dict) else ()
    return {name for name in names if isinstance(name, str)} if isinstance(names, list | tuple) else set()


def _gather(safety: dict[str, Any], where: str, known: set[str]) -> None:
    """Move the tables of other packages' filters to `others`."""
    tables = {"filters", *TABLES.values()}
    for name in [name for name in safety if name not in tables]:
        if name in TABLES:
            raise UsageError(
                f"{where}: `$.safety.{name}`: the parameters of {name} stand in the table {TABLES[name]}"
            )
        if name not in known:
            names = ", ".join(name for name in FILTERS if name != NO_FILTER)
            raise UsageError(f"{where}: `$.safety.{name}`: no filter is called {name!r}; filters are {names}")
        safety.setdefault("others", {})[name] = safety.pop(name)


def _completed(scenario: Scenario, tree: Mapping[str, Any]) -> Scenario:
    """Fill in the parameters of filters that follow from the rest of the scenario."""
    given: Mapping[str, Any] = tree.get("safety", {})
    for (name, key), other in ELSEWHERE.items():
        if key in given.get(name, {}):
            raise UsageError(f"`$.safety.{name}.{key}` follows from {other}; set that instead")
    safety, world, rules = scenario.safety, scenario.world, scenario.rules
    names = () if safety.filters == (NO_FILTER,) else safety.filters
    new: dict[str, Any] = {"filters": names}
    new["polytope_cbf"] = _with(safety, "polytope-cbf", onboard=world.onboard)
    tick_s = rules.dt_s * rules.filter_ticks
    for name in names:
        if TABLES.get(name) == "geofence" and not 1e-4 <= tick_s <= 0.1:
            raise UsageError(f"`$.rules.dt_s`: {name} runs every 0.0001 to 0.1 s, not every {tick_s:g} s")
    new["geofence"] = _with(safety, "geofence", tick_s=tick_s)
    against = default_shield_map(has_ellipsoids=world.scene is not None, has_hulls=world.has_hulls)
    for name in ("cone-ecbf", "cone-backup", "shield"):
        if "shield_map" not in given.get(name, {}) and given.get(name, {}).get("shield", True):
            new[_field(name)] = _with(safety, name, shield_map=against)
    return msgspec.structs.replace(scenario, safety=msgspec.structs.replace(safety, **new))


def _field(name: str) -> str:
    return name.replace("-", "_")


def _with(safety: SafetyTable, name: str, **values: Any) -> Any:
    """Parameters of a filter of this package with other values."""
    parameters: Any = safety.parameters(name)
    return msgspec.structs.replace(parameters, **values)


def _set(tree: Any, key: str, value: Any) -> None:
    """Replace a value; tables that are absent are made, also the next one of a list."""
    if key in _ROWS and isinstance(value, list) and not any(isinstance(item, list) for item in value):
        width = _ROWS[key]
        if len(value) % width:
            raise UsageError(f"--set {key}: needs {width} numbers for each row, not {len(value)} in all")
        value = [value[i : i + width] for i in range(0, len(value), width)]
    elif key == "safety.filters" and isinstance(value, str):
        value = [value]
    *parents, last = key.split(".")
    at = tree
    for part, following in pairwise([*parents, last]):
        if isinstance(at, list) and part.isdecimal() and int(part) <= len(at):
            if int(part) == len(at):
                at.append({})
            at = at[int(part)]
        elif isinstance(at, dict):
            at = at.setdefault(part, [] if following.isdecimal() else {})
        else:
            raise UsageError(f"--set {key}: the scenario has no {part!r} there")
    if not isinstance(at, dict) or not last:
        raise UsageError(f"--set {key}: the scenario has no {last!r} there")
    at[last] = value


def _remove(tree: Mapping[str, Any], key: str) -> None:
    table, name = key.split(".")
    if isinstance(tree.get(table), dict):
        tree[table].pop(name, None)


def _check(scenario: Scenario) -> None:
    ranges.require(bool(scenario.name.strip()), "name", "must not be empty")
    ranges.check_vehicle_table(scenario.vehicle)
    ranges.check_world_table(scenario.world)
    ranges.check_mission_table(scenario.mission)
    ranges.check_estimation_table(scenario.estimation)
    ranges.check_safety_table(scenario.safety, scenario.rules.dt_s)
    ranges.check_rules_table(scenario.rules)
    ranges.check_speeds(scenario.vehicle, scenario.mission)
