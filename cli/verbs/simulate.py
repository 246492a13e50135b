"""`simulate`: files and options of missions, checked, and the flights through their world."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from alula.cli.verbs.missions import MAPS, Trials, names_of, scenario_of
from alula.cli.verbs.results import File, Result, Source, on_disk
from alula.cli.verbs.runs import Flown, Run
from alula.cli.verbs.sources import read_tiles_of
from alula.cli.verbs.verb import verb
from alula.schemas.errors import UsageError
from alula.schemas.files import printable
from alula.schemas.parameters.foreign_filters import provided
from alula.schemas.progress import Progress
from alula.schemas.scenarios.scenario import TEXTS

if TYPE_CHECKING:
    from alula.schemas.artifacts.artifact import Artifact
    from alula.schemas.artifacts.manifest import InputRef
    from alula.schemas.artifacts.provenance import Provenance
    from alula.schemas.artifacts.tiles import TileFiles
    from alula.stages.simulation.chunks import TrialJournal

Filters = str | Callable[..., Any] | Sequence[str | Callable[..., Any]]


@verb()
def simulate(
    source: Source,
    *,
    map: Source | None = None,
    scene: Source | None = None,
    vehicle: str | Path | None = None,
    filter: Filters | None = None,
    speed_m_s: float | None = None,
    trials: int | None = None,
    seed: int | None = None,
    planned: bool = False,
    pairs_from: Run | str | Path | None = None,
    settings: Mapping[str, Any] | None = None,
    key: str | Path | None = None,
    scheduler: str | None = None,
    jobs: int = 0,
) -> Flights:
    """Fly missions through a world behind safety filters, and judge them.

    Args:
        source: a cover, tiles or a scene, in which random start-goal pairs are flown; a plan, flown in `map`;
            or the file of a scenario.
        map: cover, tiles or scene to fly in.
        scene: beside a cover.
        vehicle: name of a built-in vehicle, or a file.
        filter: name of a filter, or a class of your own; or several in their order; "none" flies without.
        speed_m_s: of the mission [m/s].
        trials: number of flights.
        seed: of all randomness.
        planned: plan each pair first.
        pairs_from: run whose pairs are flown.
        settings: any other values by the path of their key; `alula scenario --keys` lists all.
        key: file of the key that must have signed the tiles.
        scheduler: address of a dask.distributed scheduler.
        jobs: threads; 0 is all processors.

    Returns:
        The run; its `check` refuses what the command answers with exit code 4.

    Raises:
        UsageError: files or values do not go together.
        InputError: a file cannot be read.
        InfeasibleError: there are no free pairs.
    """
    names, own = _filters(filter)
    given: dict[str, Result] = {}
    with on_disk() as folder, provided(own):

        def path_of(one: Result | Run | str | Path | None, name: str) -> Path | None:
            if one is None or isinstance(one, str | Path):
                return None if one is None else Path(one).expanduser()
            if isinstance(one, Result):
                given[one.KIND.name.removeprefix("alula/")] = one
            return one.path_in(folder, name)

        path = path_of(source, "source")
        assert path is not None
        scenario = scenario_of(
            path,
            map_path=path_of(map, "map"),
            scene_path=path_of(scene, "scene"),
            vehicle=None if vehicle is None else str(vehicle),
            pairs_path=path_of(pairs_from, "pairs"),
            planned=planned,
            filters=names,
            speed_m_s=speed_m_s,
            trials=trials,
            seed=seed,
            given=_settings(settings or {}),
        )
        mission = Trials.of(scenario, path)
        tiles = read_tiles_of(mission.paths, None if key is None else Path(key))
        inputs: dict[str, Result | Run | File] = {
            role: given[role] if role in given else File.at(file) for role, file in mission.paths.items()
        }
    if isinstance(pairs_from, Run):
        inputs["pairs"] = pairs_from
    return Flights(mission, path, tiles, inputs, own, scheduler, jobs)


@dataclass(frozen=True, slots=True)
class Flights:
    """Missions whose files and options go together, before they are flown.

    Attributes:
        own: filters that no package provides, by name.
        scheduler: address of a dask.distributed scheduler.
    """

    mission: Trials
    source: Path
    tiles: TileFiles | None
    inputs: Mapping[str, Result | Run | File]
    own: Mapping[str, Any]
    scheduler: str | None
    jobs: int

    def make(
        self,
        progress: Progress,
        provenance: Provenance | None = None,
        kept: Callable[[Progress], tuple[TrialJournal, Progress]] | None = None,
    ) -> Run:
        """Fly all trials.

        Args:
            provenance: of the run, where it is known already.
            kept: function from the progress to a journal that the flights continue, and a progress.

        Raises:
            UsageError, InputError: files and values do not go together.
            InfeasibleError: there are no free pairs.
        """
        from alula.stages.simulation.simulate import simulate_world

        mission = self.mission
        maps: dict[str, Artifact] = {}
        for role in MAPS:
            one = self.inputs.get(role)
            found = one.artifact if isinstance(one, Result) else mission.read(role)
            if found is not None:
                maps[role] = found
        note = None
        if "plan" in maps:
            plan, known = self.inputs["plan"], [] if provenance is None else [provenance.inputs]
            made = plan.manifest if isinstance(plan, Result) else maps["plan"].manifest
            known = known or [_origins(role, one) for role, one in self.inputs.items()]
            note = mission.note_of_map(made, [ref for refs in known for ref in refs])
        start = time.monotonic()
        journal, watched = (None, progress) if kept is None else kept(progress)
        already = 0 if journal is None else len(journal)
        try:
            with provided(self.own):
                flights = simulate_world(
                    mission.scenario,
                    mission.vehicle,
                    **maps,
                    tiles=self.tiles,
                    pairs=mission.pairs,
                    journal=journal,
                    jobs=self.jobs,
                    scheduler=self.scheduler,
                    progress=watched,
                )
        except UsageError as error:
            is_key = "`$." in str(error)
            raise UsageError(f"{self.source}: {error}" if is_key else str(error)) from error
        flights.notes.extend([note] if note is not None else [])
        timing = {"wall_s": time.monotonic() - start, "trials_flown": len(flights.trials) - already}
        flown = Flown(mission, flights, timing, maps, self.inputs)
        recorded = flown.provenance() if provenance is None else provenance
        return Run(flown.record(recorded, mission.summary_of(flights, recorded, maps.get("cover"))), flown)


def _origins(role: str, one: Result | Run | File) -> list[InputRef]:
    """References to a map and to what it was made from in memory; to a file alone."""
    return one.origins() if isinstance(one, Result) else [one.ref(role)]


def _filters(filter: Filters | None) -> tuple[list[str] | None, dict[str, Any]]:
    """Names of filters in their order, and the classes among them by name."""
    if filter is None:
        return None, {}
    several = [filter] if isinstance(filter, str) or callable(filter) else list(filter)
    names: list[str] = []
    own: dict[str, Any] = {}
    for one in several:
        if isinstance(one, str):
            names += names_of(one)
            continue
        name = printable(str(getattr(one, "name", None) or getattr(one, "__name__", "own")))
        own[name] = one
        names.append(name)
    return names, own


def _settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Values as a file has them: lists in place of arrays and tuples, text where a key needs it."""
    found = {}
    for key, value in settings.items():
        simple = value.tolist() if hasattr(value, "tolist") else value
        simple = list(simple) if isinstance(simple, tuple) else simple
        found[key] = str(simple) if key in TEXTS else simple
    return found
