"""Runs: flights through a world and their verdicts, in memory or in a log."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from alula.cli.shell import runner
from alula.cli.shell.run_files import check_log_name, write_run
from alula.cli.verbs.display import table
from alula.cli.verbs.missions import Trials
from alula.cli.verbs.results import File, Result, on_disk
from alula.schemas.artifacts.manifest import InputRef
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.errors import CheckError, UsageError
from alula.schemas.log.cut import read_logged
from alula.schemas.log.run import PLAN_OUTCOMES, RUN_SCHEMA, RUN_SUFFIX, RUN_VERSION, RunRecord, TrialResult

if TYPE_CHECKING:
    from alula.schemas.artifacts.artifact import Artifact
    from alula.schemas.log.flights import Flight
    from alula.schemas.scenarios.scenario import Scenario
    from alula.stages.simulation.simulate import WorldRun


@dataclass(frozen=True, slots=True)
class Flown:
    """Flights in memory, with all that their log needs.

    Attributes:
        timing: measured times by name [s].
    """

    mission: Trials
    flights: WorldRun
    timing: dict[str, Any]
    maps: Mapping[str, Artifact]
    inputs: Mapping[str, Result | Run | File]

    def provenance(self) -> Provenance:
        """Provenance of the run, with its inputs as they are now."""
        refs = [one.ref(role) for role, one in self.inputs.items()]
        return Provenance.now(RUN_SCHEMA, RUN_VERSION, self.mission.parameters, self.mission.seed, refs)

    def record(self, provenance: Provenance, summary: dict[str, Any]) -> RunRecord:
        """The record of the run."""
        from alula.stages.simulation.summary import world_guarantee, world_words

        scenario = self.flights.scenario
        return RunRecord.of(
            provenance,
            name=scenario.name,
            filter=" + ".join(scenario.safety.filters) or "none",
            vehicle=world_words(scenario, self.flights.vehicle),
            trials=self.flights.trials,
            summary=summary,
            guarantee=world_guarantee(self.flights, self.maps.get("cover"), provenance.inputs),
        )

    def write(self, output: Path, record: RunRecord) -> None:
        """Write the log, and the record beside it.

        Raises:
            OutputError: a file cannot be written.
        """
        from alula.stages.runlog.world import write_world_log
        from alula.stages.simulation.summary import world_timing

        flown, scenario = self.flights, self.flights.scenario
        interface = scenario.vehicle.interface
        assert interface is not None
        guide = scenario.mission.controller.guide
        write_run(
            output,
            record,
            self.timing | world_timing(flown),
            lambda log: write_world_log(
                log,
                record,
                flown.flights,
                next((one.manifest.frame for one in self.maps.values()), "world"),
                dt_s=scenario.rules.dt_s,
                interface=interface,
                filters=[*([guide] if guide != "none" else []), *scenario.safety.filters],
                radii_m=[one.radius_m for one in scenario.world.moving],
                radius_m=flown.world.radius_m,
                hulls=flown.world.hulls,
                scene=self.maps.get("scene"),
                sigma=flown.world.sigma,
                faces=flown.world.faces,
            ),
        )


class Run:
    """Flights through a world and their verdicts.

    Attributes:
        summary: rates, extremes and counts, those that the command prints.
        trials: the verdict of each flight.
        guarantee: what the filters guarantee, in a sentence.
    """

    def __init__(self, record: RunRecord, origin: Flown | File) -> None:
        self.summary, self.trials = record.summary, record.trials
        self.guarantee = "" if record.guarantee is None else record.guarantee.statement
        self._flown = origin if isinstance(origin, Flown) else None
        self._file = origin if isinstance(origin, File) else None

    @classmethod
    def read(cls, path: Path) -> Run:
        """Read a log.

        Raises:
            InputError: it cannot be read or is not the log of a run.
        """
        file = File.at(path)
        return cls(read_logged(path).record, file)

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
        provenance = self._flown.provenance()
        if runner.current(target, provenance, force=force) is None:
            self.write(target, provenance)
        self._file = File.at(target)
        return self

    def write(self, path: Path, provenance: Provenance) -> None:
        """Write log and record, whatever is there."""
        assert self._flown is not None
        self._flown.write(path, self._flown.record(provenance, self.summary))

    def check(self) -> Run:
        """Refuse what `alula simulate` answers with exit code 4.

        Raises:
            CheckError: a filtered flight touched what does not move, or a plan was not flown as planned.
        """
        if self._flown is None:
            raise UsageError("the run was read from a file; check the one that simulate returns")
        check_trials("the run", self._flown.flights.scenario, self.trials)
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
        self.write(path, self._flown.provenance())
        return path

    def ref(self, role: str) -> InputRef:
        """Reference to this run for the provenance of another result."""
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


def check_trials(name: Path | str, scenario: Scenario, trials: list[TrialResult]) -> None:
    """Refuse flights behind filters that touched what does not move, and plans that were not flown.

    Raises:
        CheckError: there is one.
    """
    from alula.stages.planning.adherence import complaint
    from alula.stages.simulation.certificate import uncertified_words
    from alula.stages.simulation.judge import hits_static
    from alula.stages.simulation.summary import good_outcomes
    from alula.stages.verdict import STATIC, clearance_of

    hits = [trial for trial in trials if hits_static(trial)]
    if hits and scenario.safety.filters:
        clearances = [clearance_of(trial, *STATIC) or 0.0 for trial in hits]
        deepest = hits[clearances.index(min(clearances))]
        start = " ".join(f"{value:.3f}" for value in deepest.start_m)
        beyond = uncertified_words(scenario, hits)
        raise CheckError(
            f"{name}: {len(hits)} of {len(trials)} filtered flights touched a static obstacle or left the "
            f"fence; the deepest is trial {deepest.index} from ({start}), {-min(clearances):.4g} m"
            + (f"; {beyond}" if beyond else "")
        )
    good = good_outcomes(scenario.mission)
    missed = [trial for trial in trials if trial.plan is not None and trial.outcome not in good]
    if missed:
        first, ends = missed[0], Counter(trial.outcome for trial in missed)
        words = complaint(first.plan) if first.outcome in PLAN_OUTCOMES else None
        words = words or f"the flight of the plan ended as {first.outcome}"
        if len(trials) > 1:
            counts = ", ".join(f"{count} {end}" for end, count in ends.items())
            words = f"{len(missed)} of {len(trials)} plans were not flown as planned: {counts}; " + (
                f"trial {first.index}: {words}"
            )
        raise CheckError(f"{name}: {words}")
