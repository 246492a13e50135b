"""`report`: runs and what they flew in, read, and the files of their report."""

from __future__ import annotations

import dataclasses
import logging
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from alula.cli.shell.options import Common
from alula.cli.shell.runner import check_output, input_ref, run
from alula.cli.verbs.keywords import configured, keywords
from alula.cli.verbs.pages import Page, path_of
from alula.cli.verbs.results import Source, on_disk
from alula.cli.verbs.runs import Run
from alula.schemas.artifacts.provenance import Provenance, read_provenance
from alula.schemas.artifacts.report import REPORT_SCHEMA, REPORT_VERSION
from alula.schemas.errors import ArtifactError, InputError, UsageError
from alula.schemas.log.run import record_path
from alula.schemas.parameters.configs.report import ReportConfig
from alula.schemas.progress import Progress
from alula.stages.beside import in_process

if TYPE_CHECKING:
    from alula.schemas.parameters.keywords import ReportFields
    from alula.stages.reporting.figures import Figure
    from alula.stages.reporting.material import Material

_LARGE_BYTES = 4_000_000  # of all inputs: below it the start of a process takes longer than it saves


@keywords(ReportConfig)
def report(
    *runs: Run | str | Path,
    cover: Source | None = None,
    scene: Source | None = None,
    plan: Source | None = None,
    certificate: Any = None,
    **fields: Unpack[ReportFields],
) -> Page:
    """Turn runs into a verdict, pictures, figures and tables.

    Args:
        *runs: to report, the first compared with the others.
        cover: that the runs flew through.
        scene: that the cover was made from.
        plan: that was flown.
        certificate: of `verify`.
        **fields: as in the signature.

    Returns:
        The page; `save` writes .html with its tables beside it, or .md, .csv, .json, .tex, .pdf or .png.

    Raises:
        UsageError: there is nothing to report.
        InputError: a file cannot be read.
    """
    config = configured("report", ReportConfig, fields)
    all_named = {"cover": cover, "scene": scene, "plan": plan, "certificate": certificate}
    named = {role: one for role, one in all_named.items() if one is not None}
    if not runs and not named:
        raise UsageError("report needs a run, or one of --cover, --scene, --plan")
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it warns when it cannot cache its fonts

    def paths(folder: Path) -> tuple[list[Path], dict[str, Path]]:
        logs = [path_of(one, folder, f"run-{k}") for k, one in enumerate(runs, 1)]
        return logs, _files_of(logs, {role: path_of(one, folder, role) for role, one in named.items()})

    def make(flight: int | None, progress: Progress) -> str | None:
        if flight is not None:
            return None
        output = Path("report.html")
        with on_disk() as folder:
            logs, inputs = paths(folder)
            refs = [input_ref(role, path) for role, path in inputs.items()]
            made = Provenance.now(REPORT_SCHEMA, REPORT_VERSION, config.parameters(output), None, refs)
            with _figures_beside(config.title, logs, inputs, made, "html") as figures:
                material = _read_material(config.title, logs, inputs, made)
                files, _ = _contents_of(material, config, "html", output, made, progress, figures)
        return files[output].decode()

    def write(common: Common) -> None:
        with on_disk() as folder:
            _write_report(*paths(folder), config, common)

    return Page("report", f"Report {config.title!r} of {len(runs)} runs", make, write)


def _files_of(runs: Sequence[Path], named: dict[str, Path]) -> dict[str, Path]:
    inputs: dict[str, Path] = {}
    for number, log in enumerate(runs, 1):
        inputs[f"run-{number:03d}"] = log
        if record_path(log).is_file():
            inputs[f"timing-{number:03d}"] = record_path(log)
    return inputs | named


def _write_report(
    runs: Sequence[Path], inputs: dict[str, Path], config: ReportConfig, common: Common
) -> None:
    """Write a report and the files beside it, unless they are current."""
    parameters = config.parameters(common.output)
    form = str(parameters["format"])
    beside = [common.output.with_suffix(suffix) for suffix in (".md", ".csv") if form == "html"]
    for path in beside:
        _check_ours(path, inputs, common)
    if form == "csv" and common.output.exists() and _is_ours(common.output):
        common = dataclasses.replace(common, force=True)  # a table of trials has no room for provenance

    def build(provenance: Provenance, progress: Progress) -> tuple[dict[Path, bytes], dict[str, Any]]:
        with _figures_beside(config.title, runs, inputs, provenance, form) as figures:
            material = _read_material(config.title, runs, inputs, provenance)
            files, summary = _contents_of(
                material, config, form, common.output, provenance, progress, figures
            )
        for path in files:
            if path != common.output and path not in beside:  # figures, which are known only now
                _check_ours(path, inputs, common)
        return files, summary

    def make(provenance: Provenance, progress: Progress) -> tuple[Callable[[], None], dict[str, Any]]:
        files, summary = build(provenance, progress)
        return lambda: _write_all(files), summary

    run(common, REPORT_SCHEMA, REPORT_VERSION, parameters, inputs, make)
    if form == "tex" and not common.dry_run:
        beside = _figures_of(common.output)
    if not common.dry_run and not all(path.exists() for path in beside):  # deleted beside an unchanged output
        recorded = read_provenance(common.output)
        assert recorded is not None
        files, _ = build(recorded, lambda done, total: None)
        _write_all({path: files[path] for path in beside if not path.exists()})


@contextmanager
def _figures_beside(
    title: str, runs: Sequence[Path], inputs: dict[str, Path], provenance: Provenance, form: str
) -> Iterator[Callable[[Material], list[Figure]]]:
    """What draws the figures: for pages of large files another process, which begins at once."""
    from alula.schemas.files import size_of

    if form != "html" or sum(map(size_of, inputs.values())) < _LARGE_BYTES:
        from alula.stages.show.still import draw

        yield draw
        return
    with in_process(_figures_of_files, title, runs, inputs, provenance) as drawn:
        yield lambda _: drawn()


def _figures_of_files(
    title: str, runs: Sequence[Path], inputs: dict[str, Path], provenance: Provenance
) -> list[Figure]:
    from alula.stages.show.still import draw

    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # see `report`
    return draw(_read_material(title, runs, inputs, provenance))


def _contents_of(
    material: Material,
    config: ReportConfig,
    form: str,
    output: Path,
    provenance: Provenance,
    progress: Progress,
    figures: Callable[[Material], list[Figure]],
) -> tuple[dict[Path, bytes], dict[str, Any]]:
    """Contents of the files of a report, the output first, and the facts to print."""
    from alula.schemas.artifacts.provenance import in_ascii
    from alula.stages.reporting.content import content_of, to_json, to_report_markdown
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
        from alula.stages.show.viewing.report import view

        shown = view(material)
        progress(2, 3)
        page = report_page(material, content, figures(material), shown, line)
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
        files = {output: to_json(content, figures(material), provenance).encode()}
    else:
        files = _on_paper(material, content, form, output, plain)
    progress(3, 3)
    return files, summary


def _on_paper(material: Material, content: Any, form: str, output: Path, line: str) -> dict[Path, bytes]:
    from alula.stages.reporting.latex import to_tex
    from alula.stages.reporting.paper import column_figures, to_pdf, to_png
    from alula.stages.show.still import draw, still

    if form == "pdf":
        return {output: to_pdf(lambda: draw(material), content, line)}
    if form == "png":
        return {output: to_png(lambda: still(material), content, line)}
    drawn = column_figures(lambda: draw(material), line)
    stem = re.sub(r"[^A-Za-z0-9.+-]", "-", output.stem)  # what LaTeX takes in the name of a file
    places = [output.with_name(f"{stem}-{figure.name}.pdf") for figure, _ in drawn]
    shown = [(figure, place.name) for (figure, _), place in zip(drawn, places, strict=True)]
    figures = {place: data for (_, data), place in zip(drawn, places, strict=True)}
    return {output: to_tex(content, shown, line).encode()} | figures


def _figures_of(output: Path) -> list[Path]:
    """Files of the figures that a document of LaTeX shows."""
    found = re.findall(r"\\includegraphics\[[^\]]*\]\{([^}]*)\}", output.read_text(encoding="utf-8"))
    return [output.with_name(name) for name in found]


def _read_material(
    title: str, runs: Sequence[Path], inputs: Mapping[str, Path], provenance: Provenance
) -> Material:
    from alula.schemas.artifacts.certificate import decode_certificate
    from alula.schemas.artifacts.kinds import COVER, PLAN, SCENE
    from alula.schemas.artifacts.parts_join import read_whole
    from alula.schemas.files import size_of
    from alula.schemas.log.cut import read_logged
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
    check_output(path, inputs)
    if path.exists() and not common.force and not _is_ours(path):
        raise UsageError(f"{path}: exists, but it is not a file of alula's; -f replaces it")


def _is_ours(path: Path) -> bool:
    """Whether a file is a report or its table of trials."""
    from alula.stages.reporting.tables import CSV_COLUMNS

    if path.suffix == ".csv":
        with path.open(encoding="utf-8", errors="replace") as file:
            return file.readline().strip() == ",".join(CSV_COLUMNS)
    recorded = read_provenance(path)
    return recorded is not None and recorded.schema == REPORT_SCHEMA
