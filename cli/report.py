"""`alula report`."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli import options
from alula.cli.options import Common
from alula.schemas.configs.report import ReportConfig

if TYPE_CHECKING:
    from alula.schemas.progress import Progress
    from alula.schemas.provenance import Provenance
    from alula.stages.reporting.material import Material

EXAMPLES = """\b
Examples:
  alula report room.run.mcap --cover room.cover.npz -o report.html
  alula report a.run.mcap b.run.mcap --cover c.cover.npz --paper polymerge -o table.html
"""


@click.command(epilog=EXAMPLES)
@click.argument("runs", nargs=-1, type=options.input_path())
@click.option("--cover", type=options.input_path(), help="Cover that the runs flew through (.cover.npz).")
@click.option("--scene", type=options.input_path(), help="Scene that the cover was made from (.scene.npz).")
@click.option("--plan", type=options.input_path(), help="Plan that was flown (.plan.npz).")
@click.option("--certificate", type=options.input_path(), help="Certificate that `verify` wrote (.json).")
@options.from_config(ReportConfig)
@options.output(".html")
def command(
    runs: tuple[Path, ...],
    cover: Path | None,
    scene: Path | None,
    plan: Path | None,
    certificate: Path | None,
    config: ReportConfig,
    common: Common,
) -> None:
    """Turn runs into tables, figures and one HTML page.

    Two more files are written beside the page: a .md file with the same tables and a .csv file with one row
    per trial.
    """
    from alula.cli.runner import run
    from alula.schemas.errors import UsageError
    from alula.schemas.provenance import parameters_of, read_provenance
    from alula.schemas.run import record_path
    from alula.stages.reporting.figures import all_figures
    from alula.stages.reporting.headline import headline
    from alula.stages.reporting.page import comment, page
    from alula.stages.reporting.table import to_markdown
    from alula.stages.reporting.tables import all_tables, to_csv
    from alula.stages.viewing.report import view

    named = {"cover": cover, "scene": scene, "plan": plan, "certificate": certificate}
    inputs: dict[str, Path] = {}
    for number, log in enumerate(runs, 1):
        inputs[f"run-{number:03d}"] = log
        if record_path(log).is_file():
            inputs[f"timing-{number:03d}"] = record_path(log)
    inputs |= {role: path for role, path in named.items() if path is not None}
    if not inputs:
        raise UsageError("report needs a run, or one of --cover, --scene, --plan")
    if common.output.suffix not in (".html", ".htm"):
        raise UsageError(f"{common.output}: the output must end in .html")
    markdown, table = common.output.with_suffix(".md"), common.output.with_suffix(".csv")
    _check_beside(markdown, table, inputs, common)

    def build(provenance: Provenance, progress: Progress) -> tuple[dict[Path, str], dict[str, Any]]:
        material = _read(config.title, runs, inputs, provenance)
        tables = all_tables(material, config.table, config.paper)
        progress(1, 3)
        figures = all_figures(material)
        progress(2, 3)
        shown = view(material)
        summary = headline(material)
        line = provenance.line(summary)
        html = page(material, tables, figures, shown, line)
        progress(3, 3)
        texts = {
            common.output: html,
            table: to_csv(material),
            markdown: to_markdown(config.title, summary, tables, comment(line)),
        }
        return texts, summary

    def make(provenance: Provenance, progress: Progress) -> tuple[Callable[[], None], dict[str, Any]]:
        texts, summary = build(provenance, progress)
        return lambda: _write_all(texts), summary

    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it warns when it cannot cache its fonts
    run(common, "alula/report", "1.0", parameters_of(config), inputs, make)
    if not common.dry_run and not (markdown.exists() and table.exists()):  # deleted beside an unchanged page
        recorded = read_provenance(common.output)
        assert recorded is not None
        texts, _ = build(recorded, lambda done, total: None)
        _write_all({path: texts[path] for path in (table, markdown) if not path.exists()})


def _read(title: str, runs: tuple[Path, ...], inputs: dict[str, Path], provenance: Provenance) -> Material:
    from alula.schemas.artifact import read_artifact
    from alula.schemas.cut_run import read_logged
    from alula.schemas.errors import ArtifactError, InputError
    from alula.schemas.kinds import COVER, PLAN, SCENE
    from alula.schemas.provenance import read_provenance
    from alula.stages.reporting.certificate import decode_certificate
    from alula.stages.reporting.material import Material, Run, cover_hash

    flown: list[Run] = []
    for log in runs:
        found = read_logged(log)
        label = log.name.removesuffix(".run.mcap").removesuffix(".mcap")
        if any(label == other.label for other in flown):
            label = f"{label} ({len(flown) + 1})"
        label += " (cut)" if found.damage else ""
        flights = found.flights
        flown.append(Run(label, found.record, flights.by_trial, flights.hulls, flights.course))
    artifacts = {
        kind.name.removeprefix("alula/"): read_artifact(inputs[kind.name.removeprefix("alula/")], kind)
        for kind in (COVER, SCENE, PLAN)
        if kind.name.removeprefix("alula/") in inputs
    }
    certificate = None
    if "certificate" in inputs:
        try:
            certificate = decode_certificate(inputs["certificate"].read_bytes())
        except ValueError as error:
            raise ArtifactError(f"{inputs['certificate']}: is not a certificate ({error})") from error
        made = read_provenance(inputs["certificate"])
        if made is None:
            raise ArtifactError(f"{inputs['certificate']}: is not a certificate of alula verify")
        if "cover" in artifacts and cover_hash(made.inputs) != cover_hash(provenance.inputs):
            raise InputError(f"{inputs['certificate']}: is the certificate of another cover")
    return Material(
        title=title,
        runs=tuple(flown),
        **artifacts,
        certificate=certificate,
        inputs=tuple(provenance.inputs),
        file_bytes={role: path.stat().st_size for role, path in inputs.items()},
    )


def _write_all(texts: dict[Path, str]) -> None:
    """Write files so that all or none appear; the first appears last because it is the Make target."""
    from alula.schemas.atomic import atomic_outputs

    if not texts:
        return
    with atomic_outputs(*texts) as files:
        for file, text in zip(files, texts.values(), strict=True):
            file.write(text.encode())


def _check_beside(markdown: Path, table: Path, inputs: dict[str, Path], common: Common) -> None:
    """Refuse to replace a file beside the page that alula did not write."""
    from alula.cli.runner import check_output
    from alula.schemas.errors import UsageError
    from alula.schemas.provenance import read_provenance
    from alula.stages.reporting.tables import CSV_COLUMNS

    for path in (markdown, table):
        check_output(path, inputs)
        if not path.exists() or common.force:
            continue
        if path == markdown:
            recorded = read_provenance(path)
            ours = recorded is not None and recorded.schema == "alula/report"
        else:
            with path.open(encoding="utf-8", errors="replace") as file:
                ours = file.readline().strip() == ",".join(CSV_COLUMNS)
        if not ours:
            raise UsageError(f"{path}: exists, but it is not a file of alula's; -f replaces it")
