"""`view`: artifacts, runs and splats, read, and their page or picture."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from alula.cli.shell.options import Common
from alula.cli.shell.runner import run
from alula.cli.verbs.keywords import configured, keywords
from alula.cli.verbs.pages import Page, path_of
from alula.cli.verbs.results import Source, on_disk
from alula.cli.verbs.runs import Run
from alula.schemas.artifacts.provenance import Provenance, parameters_of
from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.view import PictureConfig, ViewConfig
from alula.schemas.progress import Progress

if TYPE_CHECKING:
    from alula.schemas.parameters.keywords import ViewFields
    from alula.stages.show.drawing.content import Content
    from alula.stages.show.viewing.compose import Shown

PAGES, STILLS, MOVING = (".html", ".htm"), (".png",), (".webp", ".gif")
_STILL_PX, _MOVING_PX = (1280, 800), (640, 400)


@keywords(ViewConfig)
def view(*things: Source | Run, picture: PictureConfig | None = None, **fields: Unpack[ViewFields]) -> Page:
    """Show artifacts, runs and splat files in three dimensions.

    Args:
        *things: results, or files.
        picture: of a page that is saved as a picture.
        **fields: as in the signature.

    Returns:
        The page, which a notebook shows below the cell.

    Raises:
        UsageError: there is nothing to show.
        InputError: a file cannot be read.
    """
    config = configured("view", ViewConfig, fields)
    if not things:
        raise UsageError("view needs something to show")

    def paths(folder: Path) -> list[Path]:
        return [
            path_of(one, folder, type(one).__name__.lower() + (f"-{k}" if k > 1 else ""))
            for k, one in enumerate(things, 1)
        ]

    @cache
    def read() -> Shown:
        from alula.stages.show.viewing.files import read_files

        with on_disk() as folder:
            files = paths(folder)
            _page_inputs(files)
            return read_files(files, config.title)

    def make(flight: int | None, progress: Progress) -> str | None:
        from alula.stages.show.viewing.page import within

        found = read()
        if flight is not None and not any(flight in run.flights for run in found.runs):
            return None
        asked = config if flight is None else dataclasses.replace(config, flight=(flight,))
        return within(_composer(found, asked), gaussians=config.gaussians)[0]

    def write(common: Common) -> None:
        with on_disk() as folder:
            _write_view(paths(folder), config, picture or PictureConfig(), common)

    return Page("view", f"View of {len(things)} things", make, write)


def _write_view(files: Sequence[Path], config: ViewConfig, pictured: PictureConfig, common: Common) -> None:
    """Write the page or picture of a view, unless it is current."""
    form = common.output.suffix
    if form not in (*PAGES, *STILLS, *MOVING):
        raise UsageError(f"{common.output}: the output must end in .html, .png, .webp or .gif")
    inputs = _page_inputs(files)

    def make(provenance: Provenance, progress: Progress) -> tuple[Callable[[], None], dict[str, Any]]:
        from alula.schemas.atomic import atomic_output
        from alula.stages.show.viewing.files import read_files

        compose = _composer(read_files(files, config.title), config)
        if form in PAGES:
            data, summary = _page(compose, config.gaussians, provenance, progress)
        else:
            content = compose(config.most_gaussians)
            data, summary = _picture(content, pictured, form, provenance, progress, common.jobs)

        def write() -> None:
            with atomic_output(common.output) as file:
                file.write(data)

        return write, summary

    parameters = parameters_of(config) | ({} if form in PAGES else _parameters(pictured, form))
    run(common, "alula/view", "1.1", parameters, inputs, make)


def _parameters(pictured: PictureConfig, form: str) -> dict[str, Any]:
    found = parameters_of(pictured) if form in MOVING else {"size": pictured.size}
    return found | {"form": form.removeprefix(".")}


def _page(
    compose: Callable[[int], Content], gaussians: int | None, provenance: Provenance, progress: Progress
) -> tuple[bytes, dict[str, Any]]:
    """Text of a page, and the figures to print."""
    from alula.stages.reporting.page import comment
    from alula.stages.show.viewing.page import within

    progress(1, 2)
    # The summary is part of the page, so it is known before the page is bounded.
    text, content = within(compose, gaussians=gaussians, provenance_line="PROVENANCE")
    summary = _summary(content)
    text = text.replace("PROVENANCE", comment(provenance.line(summary)), 1)
    progress(2, 2)
    return text.encode(), summary


def _picture(
    content: Content,
    pictured: PictureConfig,
    form: str,
    provenance: Provenance,
    progress: Progress,
    jobs: int,
) -> tuple[bytes, dict[str, Any]]:
    """Bytes of a still or moving picture, and the figures to print."""
    from alula.schemas.artifacts.provenance import in_ascii
    from alula.stages.show.viewing import encode
    from alula.stages.show.viewing.film import film, still

    summary = _summary(content)
    if form in STILLS:
        size = pictured.size_px(_STILL_PX)
        summary |= {"columns": size[0], "rows": size[1]}
        return encode.png(still(content, size, jobs), in_ascii(provenance.line(summary))), summary
    size, rate_hz = pictured.size_px(_MOVING_PX), pictured.frames_per_second
    found = film(
        content, pictured.camera, size, rate_hz=rate_hz, most_s=pictured.seconds, jobs=jobs, progress=progress
    )
    summary |= {"columns": size[0], "rows": size[1], "frames": len(found.frames)}
    summary |= {"times_as_fast": round(found.faster, 3)}
    line = in_ascii(provenance.line(summary))
    return (encode.gif if form == ".gif" else encode.webp)(found, rate_hz, line), summary


def _page_inputs(files: Sequence[Path]) -> Mapping[str, Path]:
    """All files that the page depends on, by role; a splat may have several."""
    from alula.stages.show.viewing.files import members

    found: dict[str, Path] = {}
    seen: set[Path] = set()
    for number, path in enumerate(files, 1):
        if (real := path.resolve()) in seen:
            raise UsageError(f"{path}: is named twice")
        seen.add(real)
        for k, member in enumerate(members(path)):
            found[f"file-{number:03d}" + (f"-{k + 1}" if k else "")] = member
    return found


def _composer(shown: Shown, config: ViewConfig) -> Callable[[int], Content]:
    """Function from a number of Gaussians to the content."""
    from alula.stages.show.viewing.compose import composer

    chosen = None
    if config.flight:
        chosen = {
            (number, index)
            for number, run in enumerate(shown.runs)
            for index in config.flight
            if index in run.flights
        }
        for index in config.flight:
            if not any(index in run.flights for run in shown.runs):
                raise UsageError(f"--flight {index}: no log has the samples of that flight")
    return composer(shown, flights=chosen, up=config.up)


def _summary(content: Content) -> dict[str, Any]:
    return {
        "gaussians": content.gaussians,
        "flights_played": len(content.plays),
        "notes": list(content.notes),
    }
