"""Steps of `alula simulate` that all scenarios with chunks of trials share."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import click

from alula.cli import options
from alula.cli.runner import run
from alula.schemas.configs.simulate import SimulateConfig
from alula.schemas.errors import UsageError

if TYPE_CHECKING:
    from alula.schemas.progress import Progress
    from alula.schemas.provenance import Provenance
    from alula.schemas.run import TrialResult
    from alula.stages.simulation.chunks import FlownTrials


class Flown(Protocol):
    """Result of a stage that flies all trials."""

    @property
    def trials(self) -> list[TrialResult]:
        """Verdicts, in their order."""
        ...


F = TypeVar("F", bound=Flown)
Write = Callable[["Provenance", F, dict[str, Any], dict[str, Any], str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class ScenarioOptions:
    """Options of `simulate` that apply to a kind of scenario.

    Attributes:
        keys: scenario key by field of the configuration, for the fields that apply.
        tables: of the scenario; --set with any other name sets a parameter of the filter.
        others: option by parameter of the command, for those that do not apply.
        meant_for: flights that the options which do not apply are for, in words.
    """

    keys: Mapping[str, str]
    tables: Sequence[str]
    others: Mapping[str, str]
    meant_for: str


def replaced_keys(
    context: click.Context,
    config: SimulateConfig,
    settings: Mapping[str, Any],
    seed: int,
    applicable: ScenarioOptions,
) -> dict[str, Any]:
    """Keys of the scenario that the command line replaces, with their new values.

    Args:
        context: tells which options were given.
        config: of `simulate`.
        settings: names and values of --set.
        seed: of --seed.
        applicable: options that apply to the scenario.

    Raises:
        UsageError: an option was given that does not apply.
    """
    changes: dict[str, Any] = {}
    for field in dataclasses.fields(config):
        if field.name == "seed" or not options.is_given(context, field.name):
            continue
        if field.name not in applicable.keys:
            raise UsageError(f"{options.option_of(field)} is for {applicable.meant_for}")
        changes[applicable.keys[field.name]] = getattr(config, field.name)
    for name, option in applicable.others.items():
        if options.is_given(context, name):
            raise UsageError(f"{option} is for {applicable.meant_for}")
    if options.is_given(context, "seed"):
        changes["trials.seed"] = seed
    for name, value in settings.items():
        first = name.partition(".")[0]
        is_key = first in applicable.tables and "." in name
        changes[name if is_key else f"filter.parameters.{name}"] = value
    return changes


def run_trials(
    common: options.Common,
    parameters: dict[str, Any],
    paths: Mapping[str, Path],
    *,
    chunk: type[FlownTrials],
    fly: Callable[..., F],
    summarize: Callable[[F], dict[str, Any]],
    write: Write[F],
) -> None:
    """Fly all trials of a scenario and write the run; continue an interrupted run from its journal.

    Args:
        common: the shared options.
        parameters: the scenario, without names of files.
        paths: the files by role: the scenario, a cover if there is one, others.
        chunk: type of the journal's chunks.
        fly: the stage; called with cover, journal, jobs and progress by name.
        summarize: returns the summary of the flown trials.
        write: writes the files, from provenance, flown trials, summary, measured times and name of the frame.
    """
    from alula.cli.journal import JournalFile
    from alula.schemas.artifact import read_artifact
    from alula.schemas.journal import TRIALS
    from alula.schemas.kinds import COVER
    from alula.schemas.run import RUN_SCHEMA, RUN_VERSION
    from alula.stages.simulation.chunks import TrialJournal

    kept = JournalFile(common, TRIALS, partial(TrialJournal, chunk))

    def make(provenance: Provenance, progress: Progress) -> tuple[Any, dict[str, Any]]:
        cover = read_artifact(paths["cover"], COVER) if "cover" in paths else None
        kept.begin(provenance)
        start = time.monotonic()
        with kept.kept(progress) as (journal, watched):
            already = len(journal)
            try:
                flown = fly(cover=cover, journal=journal, jobs=common.jobs, progress=watched)
            except UsageError as error:
                is_key = "`$." in str(error)
                raise UsageError(f"{paths['scenario']}: {error}" if is_key else str(error)) from error
        timing = {"wall_s": time.monotonic() - start, "trials_flown": len(flown.trials) - already}
        summary = summarize(flown)
        frame = "world" if cover is None else cover.manifest.frame
        return lambda: write(provenance, flown, summary, timing, frame), summary

    # The id of the scenario's schema has no influence on results, as the order of its tables has none.
    parameters = {key: value for key, value in parameters.items() if key not in ("schema", "version")}
    seed = parameters["trials"].pop("seed")
    run(common, RUN_SCHEMA, RUN_VERSION, parameters, dict(paths), make, seed=seed)
    kept.remove()
