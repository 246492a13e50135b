"""`alula view`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli import grouped, options
from alula.cli.options import Common
from alula.schemas.configs.view import PictureConfig, ViewConfig

if TYPE_CHECKING:
    from alula.schemas.progress import Progress
    from alula.schemas.provenance import Provenance
    from alula.stages.drawing.content import Content
    from alula.stages.viewing.compose import Shown

EXAMPLES = """\b
Examples:
  alula view scan.ply --up -y
  alula view room.scene.npz room.cover.npz room.plan.npz
  alula view room.scene.npz pairs.run.mcap -o page.html
  alula view pairs.run.mcap --flight 12
  alula view room.scene.npz room.plan.npz hoops.run.mcap -o hoops.png
  alula view room.scene.npz hoops.run.mcap -o hoops.webp --camera chase --seconds 8
"""
_PAGES, _STILLS, _MOVING = (".html", ".htm"), (".png",), (".webp", ".gif")
_STILL_PX, _MOVING_PX = (1280, 800), (640, 400)


@grouped.command(epilog=EXAMPLES)
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=options.input_path())
@click.option(
    "--port",
    type=options.Whole(0, 65535),
    default=8080,
    show_default=True,
    help="Without -o: port of this machine only; 0 takes a free one.",
)
@options.from_config(ViewConfig)
@options.from_config(PictureConfig, "pictured")
@options.output(".html, .png, .webp or .gif", required=False)
@click.pass_context
def command(
    context: click.Context,
    files: tuple[Path, ...],
    port: int,
    config: ViewConfig,
    pictured: PictureConfig,
    common: Common,
) -> None:
    """Show artifacts, runs and splat files in three dimensions.

    Without -o the page is served to a browser on this machine until Ctrl-C. With -o it is one file that
    needs no network: a page (.html), a picture (.png), or a moving picture of the first flight (.webp, .gif).
    Pictures are drawn without a graphics card. Splat files are read as import-splat reads them, without its
    options.
    """
    from alula.schemas.errors import UsageError

    inputs = page_inputs(files)
    is_file = options.is_given(context, "output")
    form = common.output.suffix if is_file else ""
    if is_file:
        check_form(common.output)
    for name in ("camera", "size", "frames_per_second", "seconds"):
        if (
            options.is_given(context, name)
            and form not in _MOVING
            and not (name == "size" and form in _STILLS)
        ):
            known = ", ".join((*_STILLS, *_MOVING) if name == "size" else _MOVING)
            raise UsageError(f"--{name.replace('_', '-')} needs an output that ends in {known}")
    if not is_file:
        if common.dry_run or common.depfile is not None:
            raise UsageError("-n and --depfile need -o")
        _serve(files, config, port, common)
        return
    write_view(files, inputs, config, pictured, common)


def check_form(output: Path) -> None:
    """Refuse a name that no form of a view has.

    Args:
        output: file to write.

    Raises:
        UsageError: its suffix is that of no page and no picture.
    """
    from alula.schemas.errors import UsageError

    if output.suffix not in (*_PAGES, *_STILLS, *_MOVING):
        raise UsageError(f"{output}: the output must end in .html, .png, .webp or .gif")


def write_view(
    files: Sequence[Path],
    inputs: Mapping[str, Path],
    config: ViewConfig,
    pictured: PictureConfig,
    common: Common,
) -> None:
    """Write the page or picture of a view, unless it is current.

    Args:
        files: artifacts, runs and splats.
        inputs: all files that the view depends on, by role.
        config: see `ViewConfig`.
        pictured: of pictures, see `PictureConfig`.
        common: the shared options.

    Raises:
        UsageError, InputError, OutputError: as `runner.run`.
    """
    from alula.cli.runner import run
    from alula.schemas.provenance import parameters_of

    check_form(common.output)
    form = common.output.suffix

    def make(provenance: Provenance, progress: Progress) -> tuple[Callable[[], None], dict[str, Any]]:
        from alula.schemas.atomic import atomic_output

        compose = composer(_read(files, config), config)
        draw = _page if form in _PAGES else _picture
        data, summary = draw(compose, config, pictured, form, provenance, progress, common.jobs)

        def write() -> None:
            with atomic_output(common.output) as file:
                file.write(data)

        return write, summary

    parameters = parameters_of(config) | ({} if form in _PAGES else _parameters(pictured, form))
    run(common, "alula/view", "1.1", parameters, inputs, make)


def _parameters(pictured: PictureConfig, form: str) -> dict[str, Any]:
    """Parameters of a picture that it depends on, with the form of its file."""
    from alula.schemas.provenance import parameters_of

    found = parameters_of(pictured) if form in _MOVING else {"size": pictured.size}
    return found | {"form": form.removeprefix(".")}


def _page(
    compose: Callable[[int], Content],
    config: ViewConfig,
    _pictured: PictureConfig,
    _form: str,
    provenance: Provenance,
    progress: Progress,
    _jobs: int,
) -> tuple[bytes, dict[str, Any]]:
    """Text of a page, and the figures to print."""
    from alula.stages.reporting.page import comment
    from alula.stages.viewing.page import within

    progress(1, 2)
    # The summary is part of the page, so it is known before the page is bounded.
    text, content = within(compose, gaussians=config.gaussians, provenance_line="PROVENANCE")
    summary = _summary(content)
    text = text.replace("PROVENANCE", comment(provenance.line(summary)), 1)
    progress(2, 2)
    return text.encode(), summary


def _picture(
    compose: Callable[[int], Content],
    config: ViewConfig,
    pictured: PictureConfig,
    form: str,
    provenance: Provenance,
    progress: Progress,
    jobs: int,
) -> tuple[bytes, dict[str, Any]]:
    """Bytes of a still or moving picture, and the figures to print."""
    from alula.schemas.provenance import in_ascii
    from alula.stages.viewing import encode
    from alula.stages.viewing.film import film, still

    content = compose(config.most_gaussians)
    summary = _summary(content)
    if form in _STILLS:
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


def page_inputs(files: Sequence[Path]) -> Mapping[str, Path]:
    """All files that the page depends on, by role; a splat may have several.

    Args:
        files: artifacts, runs and splats.

    Raises:
        UsageError: one is named twice.
        InputError: one cannot be opened, or is of no known format.
    """
    from alula.schemas.errors import UsageError
    from alula.stages.viewing.files import members

    found: dict[str, Path] = {}
    seen: set[Path] = set()
    for number, path in enumerate(files, 1):
        if (real := path.resolve()) in seen:
            raise UsageError(f"{path}: is named twice")
        seen.add(real)
        for k, member in enumerate(members(path)):
            found[f"file-{number:03d}" + (f"-{k + 1}" if k else "")] = member
    return found


def _read(files: Sequence[Path], config: ViewConfig) -> Shown:
    from alula.stages.viewing.files import read_files

    return read_files(files, config.title)


def composer(shown: Shown, config: ViewConfig) -> Callable[[int], Content]:
    """Function from a number of Gaussians to the content.

    Args:
        shown: what the files hold.
        config: see `ViewConfig`.

    Raises:
        UsageError: a flight is asked for that no log has.
    """
    from alula.schemas.errors import UsageError
    from alula.stages.viewing.compose import content_of

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
    return lambda most: content_of(shown, most_gaussians=most, flights=chosen, up=config.up)


def _summary(content: Content) -> dict[str, Any]:
    return {
        "gaussians": content.gaussians,
        "flights_played": len(content.plays),
        "notes": list(content.notes),
    }


def _serve(files: tuple[Path, ...], config: ViewConfig, port: int, common: Common) -> None:
    """Serve the page until Ctrl-C; other flights of the logs are made when they are asked for."""
    import dataclasses

    from alula.cli.present import echo, print_json
    from alula.stages.viewing.page import within
    from alula.stages.viewing.serve import PageServer

    shown = _read(files, config)

    def make(flight: int | None) -> str | None:
        if flight is not None and not any(flight in run.flights for run in shown.runs):
            return None
        asked = config if flight is None else dataclasses.replace(config, flight=(flight,))
        return within(composer(shown, asked), gaussians=config.gaussians)[0]

    with PageServer(make, port) as server:
        if common.json:
            print_json({"url": server.url})
        else:
            echo(server.url)
        if not common.quiet and not common.json:
            echo("Ctrl-C ends it", err=True)
        _open(server.url)
        try:
            server.run()
        except KeyboardInterrupt:
            return


def _open(url: str) -> None:
    """Open a browser where there is a screen; programs that draw in the terminal are left alone."""
    import os
    import sys
    import webbrowser

    has_screen = sys.platform == "darwin" or {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys()
    if sys.stdout.isatty() and has_screen:
        webbrowser.open(url)
