"""`alula.simulate`, and the runs that it flies."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from alula.cli import runner
from alula.cli.library.bar import shown
from alula.cli.missions import MAPS, Mission, names_of, scenario_of
from alula.cli.run_files import check_log_name
from alula.cli.sources import read_tiles_of
from alula.cli.verbs.display import table
from alula.cli.verbs.results import Cover, File, Plan, Result, Scene, on_disk
from alula.schemas.cut_run import read_logged
from alula.schemas.errors import UsageError
from alula.schemas.files import printable
from alula.schemas.foreign_filters import provided
from alula.schemas.manifest import InputRef
from alula.schemas.provenance import Provenance
from alula.schemas.run import RUN_SCHEMA, RUN_SUFFIX, RUN_VERSION, TrialResult
from alula.schemas.world import TEXTS

if TYPE_CHECKING:
    from alula.schemas.artifact import Artifact
    from alula.schemas.flights import Flight
    from alula.schemas.world import WorldScenario
    from alula.stages.simulation.world.simulate import WorldRun

Filters = str | Callable[..., Any] | Sequence[str | Callable[..., Any]]


class _Flown:
    """A run in memory, with all that its log needs."""

    def __init__(
        self,
        mission: Mission,
        flown: WorldRun,
        timing: dict[str, Any],
        maps: dict[str, Artifact],
        inputs: Mapping[str, Result | File],
    ) -> None:
        self.mission, self.flown, self.timing, self.maps, self.inputs = mission, flown, timing, maps, inputs
        self.summary = mission.summary_of(flown, self.provenance(), maps.get("cover"))

    def provenance(self) -> Provenance:
        refs: list[InputRef] = [one.ref(role) for role, one in self.inputs.items()]
        return Provenance.now(RUN_SCHEMA, RUN_VERSION, self.mission.parameters, self.mission.seed, refs)

    def statement(self) -> str:
        from alula.stages.simulation.world.summary import world_guarantee

        return world_guarantee(self.flown, self.maps.get("cover"), self.provenance().inputs).statement

    def write(self, path: Path) -> None:
        from alula.cli.simulate import write_flights

        write_flights(path, self.provenance(), self.flown, self.summary, self.timing, self.maps)


class Run:
    """Flights through a world and their verdicts.

    Attributes:
        summary: rates, extremes and counts, those that the command prints.
        trials: the verdict of each flight.
        guarantee: what the filters guarantee, in a sentence.
    """

    def __init__(
        self, summary: dict[str, Any], trials: list[TrialResult], guarantee: str, origin: _Flown | File
    ) -> None:
        self.summary, self.trials, self.guarantee = summary, trials, guarantee
        self._flown = origin if isinstance(origin, _Flown) else None
        self._file = origin if isinstance(origin, File) else None

    @classmethod
    def read(cls, path: Path) -> Run:
        """Read a log.

        Args:
            path: the file.

        Raises:
            InputError: it cannot be read or is not the log of a run.
        """
        file = File.at(path)
        record = read_logged(path).record
        statement = "" if record.guarantee is None else record.guarantee.statement
        return cls(record.summary, record.trials, statement, file)

    @cached_property
    def flights(self) -> Mapping[int, Flight]:
        """Samples of the flights that the log shows, by the number of the trial."""
        with on_disk() as folder:
            return read_logged(self.path_in(folder, "run")).flights.by_trial

    def save(self, path: str | Path, *, force: bool = False) -> Run:
        """Write the log and the record beside it, as `alula simulate`.

        Args:
            path: file of the log (.run.mcap).
            force: replace a file of other provenance.

        Raises:
            UsageError: a file of other provenance is there, or the run was read from a file.
            OutputError: a file cannot be written.
        """
        target = Path(path).expanduser()
        check_log_name(target)
        if self._flown is None:
            raise UsageError(f"{target}: the run was read from a file; copy that")
        runner.check_output(
            target, {role: one.path for role, one in self._flown.inputs.items() if isinstance(one, File)}
        )
        if runner.current(target, self._flown.provenance(), force=force) is None:
            self._flown.write(target)
        self._file = File.at(target)
        return self

    def check(self) -> Run:
        """Refuse what `alula simulate` answers with exit code 4.

        Raises:
            CheckError: a filtered flight touched what does not move, or a plan was not flown as planned.
        """
        from alula.cli.simulate import check_trials

        if self._flown is None:
            raise UsageError("the run was read from a file; check the one that simulate returns")
        check_trials("the run", self._flown.flown.scenario, self.trials)
        return self

    def path_in(self, folder: Path, name: str) -> Path:
        """Path of the log: its own file, or one that is written into a folder.

        Args:
            folder: for runs that were not saved.
            name: of the file there, without its suffix.
        """
        if self._file is not None and self._file.is_unchanged():
            return self._file.path
        if self._flown is None:
            assert self._file is not None
            self._file.ref("run")  # says that it has changed
            return self._file.path
        path = folder / f"{name}{RUN_SUFFIX}"
        self._flown.write(path)
        return path

    def ref(self, role: str) -> InputRef:
        """Reference to this run for the provenance of another result.

        Args:
            role: of the run there.
        """
        with on_disk() as folder:
            return runner.input_ref(role, self.path_in(folder, "run"))

    def __repr__(self) -> str:
        facts = self.summary
        words = (
            f"{facts['trials']} flights, {facts.get('reached', 0)} reached, {facts['collisions']} collided"
        )
        clearance = [facts.get(f"min_{name}_clearance_m") for name in ("map", "scene", "moving", "fence")]
        known = [one for one in clearance if one is not None]
        return f"Run: {words}" + (f", minimum clearance {min(known):.3g} m" if known else "")

    def _repr_html_(self) -> str:
        return table(repr(self), runner.facts(self.summary), self.summary.get("notes", ()))


def simulate(
    source: Result | str | Path,
    *,
    map: Result | str | Path | None = None,
    scene: Result | str | Path | None = None,
    vehicle: str | Path | None = None,
    filter: Filters | None = None,
    speed_m_s: float | None = None,
    trials: int | None = None,
    seed: int | None = None,
    planned: bool = False,
    pairs_from: Run | str | Path | None = None,
    settings: Mapping[str, Any] | None = None,
    jobs: int = 0,
) -> Run:
    """Fly missions through a world behind safety filters, and judge them.

    Args:
        source: a cover or a scene, in which random start-goal pairs are flown; a plan, flown in `map`; or the
            file of a scenario.
        map: cover or scene to fly in.
        scene: beside a cover.
        vehicle: name of a built-in vehicle, or a file.
        filter: name of a filter, or a class of your own; or several in their order; "none" flies without.
        speed_m_s: of the mission [m/s].
        trials: number of flights.
        seed: of all randomness.
        planned: plan each pair first.
        pairs_from: run whose pairs are flown.
        settings: any other values by the path of their key; `alula scenario --keys` lists all.
        jobs: threads; 0 is all processors.

    Returns:
        The run; its `check` refuses what the command answers with exit code 4.

    Raises:
        UsageError: files or values do not go together.
        InputError: a file cannot be read.
        InfeasibleError: there are no free pairs.
    """
    from alula.stages.simulation.world.simulate import simulate_world

    names, own = _filters(filter)
    given: dict[str, Result] = {}
    with on_disk() as folder, provided(own), shown("simulate") as progress:

        def path_of(one: Result | Run | str | Path | None, name: str) -> Path | None:
            if one is None or isinstance(one, str | Path):
                return None if one is None else Path(one).expanduser()
            if isinstance(one, Result):
                given[_role(one)] = one
            return one.path_in(folder, name)

        path = path_of(source, "source")
        assert path is not None
        scenario: WorldScenario = scenario_of(
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
        mission = Mission.of(scenario, path)
        tiles = read_tiles_of(mission.paths, None)
        inputs: dict[str, Result | File] = {}
        for role, file in mission.paths.items():
            known = given.get(role)
            inputs[role] = File.at(file) if known is None else known
        if isinstance(pairs_from, Run) and pairs_from._flown is not None:
            inputs["pairs"] = pairs_from  # type: ignore[assignment]
        maps: dict[str, Any] = {}
        for role in MAPS:
            found = given[role].artifact if role in given and role in mission.paths else mission.read(role)
            if found is not None:
                maps[role] = found
        note = None
        if "plan" in maps:
            made = given["plan"].manifest if "plan" in given else maps["plan"].manifest
            refs = [ref for role, one in inputs.items() for ref in _origins(role, one)]
            note = mission.note_of_map(made, refs)
        start = time.monotonic()
        flown = simulate_world(
            scenario, mission.vehicle, **maps, tiles=tiles, pairs=mission.pairs, jobs=jobs, progress=progress
        )
    flown.notes.extend([note] if note is not None else [])
    timing = {"wall_s": time.monotonic() - start, "trials_flown": len(flown.trials)}
    origin = _Flown(mission, flown, timing, maps, inputs)
    return Run(origin.summary, flown.trials, origin.statement(), origin)


def _origins(role: str, one: Result | File) -> list[InputRef]:
    """References to a map and to what it was made from in memory; to a file alone."""
    return one.origins() if isinstance(one, Result) else [one.ref(role)]


def _role(one: Result) -> str:
    found = {Cover: "cover", Scene: "scene", Plan: "plan"}.get(type(one))
    return str(found or type(one).__name__.lower())


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
