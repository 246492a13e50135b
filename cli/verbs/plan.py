"""`plan`: files and parameters of a flight, checked, and the stage that finds it."""

from __future__ import annotations

import dataclasses
from collections.abc import Container, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from alula.cli.verbs.keywords import configured
from alula.cli.verbs.results import Cover, File, Plan, Result, Scene, Source, source_of
from alula.cli.verbs.sources import map_role
from alula.cli.verbs.verb import Step, verb
from alula.schemas.artifacts.kinds import COVER, SCENE, SEEN
from alula.schemas.errors import UsageError, WrongKindError
from alula.schemas.files import reading
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.parameters.flight_defaults import filter_in, planned_interface
from alula.schemas.progress import Progress
from alula.schemas.scenarios.mission import Mission, read_mission
from alula.schemas.scenarios.vehicles import vehicle_named

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from alula.schemas.artifacts.artifact import Artifact
    from alula.schemas.parameters.keywords import PlanFields
    from alula.schemas.scenarios.vehicle import Vehicle
    from alula.stages.planning.space import PlanSpace

Maps = Mapping[str, Result | File]


@verb(PlanConfig)
def plan(
    map: Source,
    *,
    scene: Source | None = None,
    vehicle: str | Path | None = None,
    mission: str | Path | None = None,
    within: Source | None = None,
    jobs: int = 0,
    **fields: Unpack[PlanFields],
) -> Step[Plan]:
    """Find a smooth collision-free trajectory through a map.

    Args:
        map: a cover, a scene or an onboard map.
        scene: beside a cover or an onboard map: the plan keeps away from both.
        vehicle: that will fly it, a built-in one by its name, or a file; default: FastBridge's quadrotor.
        mission: file with waypoints, gates, laps and zones.
        within: seen space to stay in.
        jobs: threads; 0 is all processors.
        **fields: as in the signature.

    Raises:
        InfeasibleError: there is no path; the message says which radius would pass.
        UsageError: start or goal is missing, or parameters contradict one another.
    """
    given = PlanInputs.of(map, scene, vehicle, mission, within, fields)
    config = given.config
    if config.start is None or config.goal is None:
        raise UsageError("--start and --goal are needed; alula plan MAP --free-points 6 prints free points")
    if config.filter is not None and config.straight:
        raise UsageError("--straight flies lines as they are, whatever a filter does; leave out --filter")
    if config.filter is not None and "image" in given.maps:
        raise UsageError("--filter flies the plan in a cover or a scene, not in an onboard map")

    def build(progress: Progress) -> Artifact:
        from alula.stages.planning.plan import plan as stage
        from alula.stages.world.world import behind_filters

        maps = given.read()
        behind = None if config.filter is None else behind_filters(config, given.vehicle, **maps, jobs=jobs)
        known: dict[str, Any] = {"mission": given.mission, "vehicle": given.vehicle, "behind": behind}
        return stage(config, **maps, **known, jobs=jobs, progress=progress)

    return Step(Plan, config, given.inputs, build)


@dataclasses.dataclass(frozen=True, slots=True)
class PlanInputs:
    """What a plan is made from.

    Attributes:
        maps: `cover`, `scene`, `image` (an onboard map) and `within`, those that there are.
        inputs: maps and further files, by role.
    """

    config: PlanConfig
    maps: Maps
    inputs: Maps
    vehicle: Vehicle
    mission: Mission | None

    @classmethod
    def of(
        cls,
        map: Source,
        scene: Source | None,
        vehicle: str | Path | None,
        mission: str | Path | None,
        within: Source | None,
        fields: Mapping[str, Any],
    ) -> PlanInputs:
        """Check what goes together; maps are read later.

        Args:
            fields: of the configuration, those that are given.

        Raises:
            UsageError: parameters or files do not go together.
            WrongKindError: a file is of another kind.
        """
        config = configured("plan", PlanConfig, fields)
        if config.radius_m is not None and vehicle is not None:
            raise UsageError("--radius is the whole distance to keep; leave out --vehicle")
        if config.confidence is not None and "sigma" in fields:
            raise UsageError("give --sigma or --confidence, not both")
        maps = _maps_of(map, scene) | ({} if within is None else {"within": source_of(within)})
        flown, further = vehicle_named(vehicle)
        course = None
        if mission is not None:
            if both := [name for name in ("via", "gate", "loops", "yaw") if name in fields]:
                raise UsageError(f"--{both[0]} and --mission: the file says this; give one of the two")
            further = further | {"mission": Path(mission)}
            course = read_mission(further["mission"])
            start, goal = config.start or course.start_m, config.goal or course.goal_m
            config = dataclasses.replace(config, start=start, goal=goal)
        files = {role: File.at(path) for role, path in further.items()}
        return cls(_resolved(config, flown, maps), maps, maps | files, flown, course)

    def read(self) -> dict[str, Any]:
        """The maps by role: artifacts, and the bytes of an onboard map."""
        kinds = {"cover": COVER, "scene": SCENE, "within": SEEN}
        return {
            role: one.path.read_bytes()
            if isinstance(one, File) and role == "image"
            else one.read(kinds[role])
            for role, one in self.maps.items()
        }

    def free_points(self, count: int, *, seed: int = 0, jobs: int = 0) -> tuple[NDArray[Any], PlanSpace]:
        """Free points to choose start and goal from, shape (count, 3) [m], and the space that they lie in.

        Args:
            count: how many.
            seed: of the draw.
            jobs: threads; 0 is all processors.

        Raises:
            InfeasibleError: there are fewer.
        """
        from alula.stages.planning.endpoints import free_points
        from alula.stages.planning.space import plan_space

        space = plan_space(self.config, **self.read(), jobs=jobs)
        return free_points(self.config, space, count, seed=seed), space


def _resolved(config: PlanConfig, vehicle: Vehicle, roles: Container[str]) -> PlanConfig:
    """Complete what follows from the vehicle, the filters and the maps."""
    from alula.stages.filtering.registry import filter_kind
    from alula.stages.planning.plan import resolve_plan

    is_guided = vehicle.model == "quadrotor" and not config.straight and "image" not in roles
    if config.filter is None and is_guided:
        config = dataclasses.replace(config, filter=filter_in(roles))
    if config.interface is None:
        names = [name.strip() for name in (config.filter or "").split(",") if name.strip()]
        try:
            interface = planned_interface(names, filter_kind, roles)
        except UsageError as error:
            raise UsageError(f"--filter {config.filter}: {error}") from error
        config = dataclasses.replace(config, interface=interface)
    return resolve_plan(config, vehicle)


def _maps_of(map: Source, scene: Source | None) -> dict[str, Result | File]:
    found = source_of(map)
    role = _role_of(found)
    if role == "scene" and scene is not None:
        name = found.path if isinstance(found, File) else "the map"
        raise UsageError(f"{name} is a scene; --scene is for covers and onboard maps")
    return {role: found} | ({} if scene is None else {"scene": source_of(scene)})


def _role_of(map: Result | File) -> str:
    from alula.stages.compression.onboard.image import is_map

    if isinstance(map, File):
        return "image" if map.path.is_file() and is_map(_first_bytes(map.path)) else map_role(map.path)
    if not isinstance(map, Cover | Scene):
        raise WrongKindError(f"a result is {map.KIND.name}, but {COVER.name} or {SCENE.name} is needed")
    return map.KIND.name.removeprefix("alula/")


def _first_bytes(path: Path) -> bytes:
    with reading(path), path.open("rb") as file:
        return file.read(4)
