"""What `alula simulate` does for every scenario whose trials are flown in chunks."""

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
    """What a stage says of all trials."""

    @property
    def trials(self) -> list[TrialResult]:
        """In their order."""
        ...


F = TypeVar("F", bound=Flown)
Write = Callable[["Provenance", F, dict[str, Any], dict[str, Any], str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Meaning:
    """What options of `simulate` mean to a kind of scenario.

    Attributes:
        keys: fields of the configuration that mean something in it, and their keys there.
        tables: of the scenario; what --set names outside of them are the filter's parameters.
        others: parameters of the command that mean nothing in it, and their options.
        meant_for: what options are for that mean nothing in it.
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
    meaning: Meaning,
) -> dict[str, Any]:
    """What the command line replaces, by the keys of the scenario.

    Args:
        context: knows which options were given.
        config: of `simulate`.
        settings: those of --set.
        seed: of --seed.
        meaning: of the options.

    Raises:
        UsageError: an option was given that means nothing.
    """
    changes: dict[str, Any] = {}
    for field in dataclasses.fields(config):
        if field.name == "seed" or not options.is_given(context, field.name):
            continue
        if field.name not in meaning.keys:
            raise UsageError(f"{options.option_of(field)} is for {meaning.meant_for}")
        changes[meaning.keys[field.name]] = getattr(config, field.name)
    for name, option in meaning.others.items():
        if options.is_given(context, name):
            raise UsageError(f"{option} is for {meaning.meant_for}")
    if options.is_given(context, "seed"):
        changes["trials.seed"] = seed
    for name, value in settings.items():
        first = name.partition(".")[0]
        changes[name if first in meaning.tables and "." in name else f"filter.parameters.{name}"] = value
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
    """Fly all trials of a scenario and write what was found; an interrupted run goes on from its journal.

    Args:
        common: the shared options.
        parameters: the scenario, without what has no influence on results.
        paths: the files, by role: the scenario, a cover if there is one, others.
        chunk: of the journal.
        fly: the stage; called with cover, journal, jobs and progress by name.
        summarize: what the record says in short.
        write: writes the files, from provenance, what was flown, summary, measured times and the frame.
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

    # What a scenario is called in a file matters no more than how its tables are ordered.
    parameters = {key: value for key, value in parameters.items() if key not in ("schema", "version")}
    seed = parameters["trials"].pop("seed")
    run(common, RUN_SCHEMA, RUN_VERSION, parameters, dict(paths), make, seed=seed)
    kept.remove()
