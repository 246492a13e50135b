"""Runs of the combined loop for tests: scenarios by short names of their keys, and all that a run tells."""

import hashlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import msgspec

from alula.schemas.artifacts.artifact import Artifact, encode_artifact
from alula.schemas.artifacts.kinds import COVER
from alula.schemas.artifacts.manifest import Guarantee, InputRef
from alula.schemas.log.run import TrialResult
from alula.schemas.scenarios.scenario import Scenario, decoded
from alula.schemas.scenarios.vehicle import FASTBRIDGE, LimitsTable, Vehicle
from alula.schemas.scenarios.vehicles import VEHICLES
from alula.stages.simulation.pairs import Pairs
from alula.stages.simulation.result import WorldFlight
from alula.stages.simulation.simulate import WorldRun, simulate_world
from alula.stages.simulation.summary import world_guarantee, world_summary, world_words

IDEAL_POINT = msgspec.structs.replace(VEHICLES["double-integrator"], limits=LimitsTable())
"""A double integrator without limits."""
_TABLES = {
    "vehicle": ("radius_m", "interface", "rate_gain_scale", "mass_scale"),
    "world": ("sigma", "inflation_m", "onboard"),
    "mission": ("speed_m_s", "bounds_m", "margin_m", "which", "planned", "kind", "allow_tight"),
    "mission.controller": ("guide", "guide_parameters", "catch_up_m_s"),
    "rules": ("trials", "seed", "max_time_s", "log_rate_hz", "dt_s", "filter_ticks", "controller_ticks"),
}
_TABLE = {name: table for table, names in _TABLES.items() for name in names}


@dataclass(frozen=True)
class Ran:
    """A run with its summary, its guarantee and its vehicle in words."""

    run: WorldRun
    cover: Artifact | None
    scene: Artifact | None = None

    @property
    def trials(self) -> list[TrialResult]:
        """Verdicts, in their order."""
        return self.run.trials

    @property
    def flights(self) -> list[WorldFlight]:
        """Samples of all flights."""
        return self.run.flights

    @cached_property
    def summary(self) -> dict[str, Any]:
        """Of all flights."""
        return world_summary(self.run)

    @cached_property
    def guarantee(self) -> Guarantee:
        """Statement and claims."""
        files = {"cover": self.cover, "scene": self.scene}
        refs = [ref_of(role, one) for role, one in files.items() if one is not None]
        return world_guarantee(self.run, self.cover, refs)

    @property
    def vehicle(self) -> str:
        """The vehicle in words."""
        return world_words(self.run.scenario, self.run.vehicle)


def ref_of(role: str, artifact: Artifact) -> InputRef:
    """How a manifest names an artifact that was written to a file."""
    manifest = artifact.manifest
    digest = hashlib.sha256(encode_artifact(artifact)).hexdigest()
    return InputRef(role, manifest.schema, manifest.version, digest, f"{role}.npz")


def made_from(artifact: Artifact, scene: Artifact) -> Artifact:
    """The same voxels or cover, which name a scene as the one that they were made from."""
    field = "made_from" if artifact.kind is COVER else "inputs"
    named = msgspec.structs.replace(artifact.manifest, **{field: [ref_of("scene", scene)]})
    return Artifact(named, artifact.arrays)


def set_value(tree: dict[str, Any], path: str, value: Any) -> None:
    """Set a value by its path, with dots between the tables; those that are absent are made."""
    *tables, key = path.split(".")
    at = tree
    for table in tables:
        at = at.setdefault(table, {})
    at[key] = value


def scenario_of(
    filters: str | tuple[str, ...] = (),
    parameters: dict[str, Any] | None = None,
    *,
    has_scene: bool = False,
    has_cover: bool = False,
    has_plan: bool = False,
    **keys: Any,
) -> Scenario:
    """Make a scenario that logs all its flights.

    Args:
        filters: one name, or several in their order.
        parameters: of the last one.
        has_scene, has_cover, has_plan: which files it names.
        keys: keys of its tables by their last name.
    """
    names = (filters,) if isinstance(filters, str) else filters
    tree: dict[str, Any] = {"world": {}, "mission": {}, "rules": {}, "vehicle": {}}
    tree["safety"] = {"filters": list(names)}
    if parameters is not None:
        tree["safety"][names[-1]] = dict(parameters)
    for key, value in keys.items():
        set_value(tree, f"{_TABLE[key]}.{key}", value)
    tree["world"] |= {"scene": "x.scene.npz"} if has_scene else {}
    tree["world"] |= {"cover": "x.cover.npz"} if has_cover else {}
    if has_plan:
        tree["mission"] |= {"kind": "plan", "plan": "x.plan.npz"}
    tree["mission"].setdefault("beyond_map_m", 100.0)
    tree["rules"].setdefault("logged", tree["rules"].get("trials") or 100)
    return decoded(tree, "test")


def flown(
    filters: str | tuple[str, ...] = (),
    parameters: dict[str, Any] | None = None,
    *,
    scene: Artifact | None = None,
    cover: Artifact | None = None,
    plan: Artifact | None = None,
    pairs: Pairs | None = None,
    vehicle: Vehicle = FASTBRIDGE,
    jobs: int = 0,
    **keys: Any,
) -> Ran:
    """Fly a scenario.

    Args:
        filters, parameters, keys: as of `scenario_of`.
        scene, cover, plan, pairs: what it names.
        vehicle: that flies.
        jobs: threads.
    """
    files = {"has_scene": scene is not None, "has_cover": cover is not None, "has_plan": plan is not None}
    scenario = scenario_of(filters, parameters, **files, **keys)
    run = simulate_world(scenario, vehicle, scene=scene, cover=cover, plan=plan, pairs=pairs, jobs=jobs)
    return Ran(run, cover, scene)
