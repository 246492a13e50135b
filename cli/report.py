"""`alula report`."""

from __future__ import annotations

import dataclasses
import logging
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli import grouped, options
from alula.cli.options import Common
from alula.schemas.configs.report import ReportConfig

if TYPE_CHECKING:
    from alula.schemas.progress import Progress
    from alula.schemas.provenance import Provenance
    from alula.stages.reporting.material import Material

EXAMPLES = """\b
Examples:
  alula report room.run.mcap --cover room.cover.npz -o report.html
  alula report with.run.mcap without.run.mcap -o comparison.html
  alula report room.run.mcap --cover room.cover.npz -o report.pdf
"""


@grouped.command(epilog=EXAMPLES)
@click.argument("runs", nargs=-1, type=options.input_path())
@click.option("--cover", type=options.input_path(), help="Cover that the runs flew through (.cover.npz).")
@click.option("--scene", type=options.input_path(), help="Scene that the cover was made from (.scene.npz).")
@click.option("--plan", type=options.input_path(), help="Plan that was flown (.plan.npz).")
@click.option("--certificate", type=options.input_path(), help="Certificate that `verify` wrote (.json).")
@options.from_config(ReportConfig)
@options.output(".html .md .csv .json .tex .pdf .png")
def command(
    runs: tuple[Path, ...],
    cover: Path | None,
    scene: Path | None,
    plan: Path | None,
    certificate: Path | None,
    config: ReportConfig,
    common: Common,
) -> None:
    """Turn runs into a verdict, pictures, figures and tables.

    The page opens with a verdict in words, a picture and four numbers of each run. Playback, guarantees and
    figures follow; tables, parameters and provenance are folded. It loads nothing from elsewhere.

    Several runs are compared: each with the first, trial by trial where they have the same starts and goals,
    with 95 % intervals of the differences.

    Beside a page two more files are written: a .md file with the same tables and a .csv file with one row per
    trial. All formats have the same contents and the same numbers.
    """
    named = {"cover": cover, "scene": scene, "plan": plan, "certificate": certificate}
    write_report(runs, {role: path for role, path in named.items() if path is not None}, config, common)


def files_of(runs: Sequence[Path], named: Mapping[str, Path]) -> dict[str, Path]:
    """All files that a report depends on, by role.

    Args:
        runs: logs in their order; the record beside each has its measured times.
        named: the other files by role: `cover`, `scene`, `plan`, `certificate`.

    Raises:
        UsageError: there is none.
    """
    from alula.schemas.errors import UsageError
    from alula.schemas.run import record_path

    inputs: dict[str, Path] = {}
    for number, log in enumerate(runs, 1):
        inputs[f"run-{number:03d}"] = log
        if record_path(log).is_file():
            inputs[f"timing-{number:03d}"] = record_path(log)
    inputs |= named
    if not inputs:
        raise UsageError("report needs a run, or one of --cover, --scene, --plan")
    return inputs


def write_report(
    runs: Sequence[Path], named: Mapping[str, Path], config: ReportConfig, common: Common
) -> None:
    """Write a report and the files beside it, unless they are current.

    Args:
        runs: logs in their order.
        named: the other files by role: `cover`, `scene`, `plan`, `certificate`.
        config: see `ReportConfig`.
        common: the shared options.

    Raises:
        UsageError, InputError, OutputError: as `runner.run`.
    """
    from alula.cli.runner import run
    from alula.schemas.provenance import read_provenance
    from alula.schemas.report import REPORT_SCHEMA, REPORT_VERSION

    inputs = files_of(runs, named)
    parameters = config.parameters(common.output)
    form = str(parameters["format"])
    beside = [common.output.with_suffix(suffix) for suffix in (".md", ".csv") if form == "html"]
    for path in beside:
        _check_ours(path, inputs, common)
    if form == "csv" and common.output.exists() and _is_ours(common.output):
        common = dataclasses.replace(common, force=True)  # a table of trials has no room for provenance

    def build(provenance: Provenance, progress: Progress) -> tuple[dict[Path, bytes], dict[str, Any]]:
        material = read_material(config.title, runs, inputs, provenance)
        files, summary = contents_of(material, config, form, common.output, provenance, progress)
        for path in files:
            if path != common.output and path not in beside:  # figures, which are known only now
                _check_ours(path, inputs, common)
        return files, summary

    def make(provenance: Provenance, progress: Progress) -> tuple[Callable[[], None], dict[str, Any]]:
        files, summary = build(provenance, progress)
        return lambda: _write_all(files), summary

    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it warns when it cannot cache its fonts
    run(common, REPORT_SCHEMA, REPORT_VERSION, parameters, inputs, make)
    if form == "tex" and not common.dry_run:
        beside = _figures_of(common.output)
    if not common.dry_run and not all(path.exists() for path in beside):  # deleted beside an unchanged output
        recorded = read_provenance(common.output)
        assert recorded is not None
        files, _ = build(recorded, lambda done, total: None)
        _write_all({path: files[path] for path in beside if not path.exists()})


def contents_of(
    material: Material,
    config: ReportConfig,
    form: str,
    output: Path,
    provenance: Provenance,
    progress: Progress,
) -> tuple[dict[Path, bytes], dict[str, Any]]:
    """Contents of the files of a report, the output first, and the facts to print.

    Args:
        material: runs, maps and certificate.
        config: see `ReportConfig`.
        form: one of `FORMATS`.
        output: the file.
        provenance: to be recorded.
        progress: called with (done, total).
    """
    from alula.schemas.provenance import in_ascii
    from alula.stages.reporting.content import content_of, draw, to_json, to_report_markdown
    from alula.stages.reporting.page import comment, report_page
    from alula.stages.reporting.tables import to_csv

    everything = {"listed": None} if form == "json" else {}
    content = content_of(material, config.table, **everything)
    summary = dict(content.facts)
    line = provenance.line(summary)
    plain = in_ascii(line)
    progress(1, 3)

    def markdown() -> bytes:
        return to_report_markdown(content, comment(line)).encode()

    if form == "html":
        from alula.stages.viewing.report import view

        shown = view(material)
        progress(2, 3)
        page = report_page(material, content, draw(material), shown, line)
        files = {
            output: page.encode(),
            output.with_suffix(".csv"): to_csv(material).encode(),
            output.with_suffix(".md"): markdown(),
        }
    elif form == "md":
        files = {output: markdown()}
    elif form == "csv":
        files = {output: to_csv(material).encode()}
    elif form == "json":
        files = {output: to_json(content, draw(material), provenance).encode()}
    else:
        files = _on_paper(material, content, form, output, plain)
    progress(3, 3)
    return files, summary


def _on_paper(material: Material, content: Any, form: str, output: Path, line: str) -> dict[Path, bytes]:
    from alula.stages.reporting.latex import to_tex
    from alula.stages.reporting.paper import column_figures, to_pdf, to_png

    if form == "pdf":
        return {output: to_pdf(material, content, line)}
    if form == "png":
        return {output: to_png(material, content, line)}
    drawn = column_figures(material, line)
    stem = re.sub(r"[^A-Za-z0-9.+-]", "-", output.stem)  # what LaTeX takes in the name of a file
    places = [output.with_name(f"{stem}-{figure.name}.pdf") for figure, _ in drawn]
    shown = [(figure, place.name) for (figure, _), place in zip(drawn, places, strict=True)]
    figures = {place: data for (_, data), place in zip(drawn, places, strict=True)}
    return {output: to_tex(content, shown, line).encode()} | figures


def _figures_of(output: Path) -> list[Path]:
    """Files of the figures that a document of LaTeX shows."""
    found = re.findall(r"\\includegraphics\[[^\]]*\]\{([^}]*)\}", output.read_text(encoding="utf-8"))
    return [output.with_name(name) for name in found]


def read_material(
    title: str, runs: Sequence[Path], inputs: Mapping[str, Path], provenance: Provenance
) -> Material:
    """Read the files of a report.

    Args:
        title: heading.
        runs: logs in their order.
        inputs: all files by role, see `files_of`.
        provenance: of the report.

    Raises:
        InputError: a file cannot be read, or the certificate is that of another cover.
    """
    from alula.schemas.cut_run import read_logged
    from alula.schemas.errors import ArtifactError, InputError
    from alula.schemas.files import size_of
    from alula.schemas.kinds import COVER, PLAN, SCENE
    from alula.schemas.parts_join import read_whole
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
        kind.name.removeprefix("alula/"): read_whole(inputs[kind.name.removeprefix("alula/")], kind)
        for kind in (COVER, SCENE, PLAN)
        if kind.name.removeprefix("alula/") in inputs
    }
    certificate, made = None, None
    if "certificate" in inputs:
        try:
            certificate = decode_certificate(inputs["certificate"].read_bytes())
        except ValueError as error:
            raise ArtifactError(f"{inputs['certificate']}: is not a certificate ({error})") from error
        made = read_provenance(inputs["certificate"])
        if made is None:
            raise ArtifactError(f"{inputs['certificate']}: is not a certificate of alula verify")
        if of_other := {"plan", "seen"} & set(certificate["given"]):
            raise InputError(
                f"{inputs['certificate']}: is the certificate of a file of kind alula/{of_other.pop()}; give "
                "that of the cover"
            )
        if "cover" in artifacts and cover_hash(made.inputs) != cover_hash(provenance.inputs):
            raise InputError(f"{inputs['certificate']}: is the certificate of another cover")
    return Material(
        title=title,
        runs=tuple(flown),
        cover=artifacts.get("cover"),
        scene=artifacts.get("scene"),
        plan=artifacts.get("plan"),
        certificate=certificate,
        certified_cover=None if made is None else cover_hash(made.inputs),
        inputs=tuple(provenance.inputs),
        file_bytes={role: size_of(path) for role, path in inputs.items()},
    )


def _write_all(files: Mapping[Path, bytes]) -> None:
    """Write files so that all or none appear; the first appears last because it is the Make target."""
    from alula.schemas.atomic import atomic_outputs

    if not files:
        return
    with atomic_outputs(*files) as opened:
        for file, data in zip(opened, files.values(), strict=True):
            file.write(data)


def _check_ours(path: Path, inputs: dict[str, Path], common: Common) -> None:
    """Refuse to replace a file beside the output that alula did not write."""
    from alula.cli.runner import check_output
    from alula.schemas.errors import UsageError

    check_output(path, inputs)
    if path.exists() and not common.force and not _is_ours(path):
        raise UsageError(f"{path}: exists, but it is not a file of alula's; -f replaces it")


def _is_ours(path: Path) -> bool:
    """Whether a file is a report or its table of trials."""
    from alula.schemas.provenance import read_provenance
    from alula.schemas.report import REPORT_SCHEMA
    from alula.stages.reporting.tables import CSV_COLUMNS

    if path.suffix == ".csv":
        with path.open(encoding="utf-8", errors="replace") as file:
            return file.readline().strip() == ",".join(CSV_COLUMNS)
    recorded = read_provenance(path)
    return recorded is not None and recorded.schema == REPORT_SCHEMA
