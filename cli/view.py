"""`alula view`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli import options
from alula.cli.options import Common
from alula.schemas.configs.view import ViewConfig

if TYPE_CHECKING:
    from alula.schemas.progress import Progress
    from alula.schemas.provenance import Provenance
    from alula.stages.viewing.compose import Shown
    from alula.stages.viewing.content import Content

EXAMPLES = """\b
Examples:
  alula view scan.ply --up -y
  alula view room.scene.npz room.cover.npz room.plan.npz
  alula view room.scene.npz pairs.run.mcap -o page.html
  alula view pairs.run.mcap --flight 12
"""


@click.command(epilog=EXAMPLES)
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=options.input_path())
@click.option(
    "--port",
    type=options.Whole(0, 65535),
    default=8080,
    show_default=True,
    help="Without -o: port of this machine only; 0 takes a free one.",
)
@options.from_config(ViewConfig)
@options.output(".html", required=False)
@click.pass_context
def command(
    context: click.Context, files: tuple[Path, ...], port: int, config: ViewConfig, common: Common
) -> None:
    """Show artifacts, runs and splat files in three dimensions.

    Without -o the page is served to a browser on this machine until Ctrl-C. With -o it is one file that
    needs no network. Splat files are read as import-splat reads them, without its options.
    """
    from alula.cli.runner import run
    from alula.schemas.errors import UsageError
    from alula.schemas.provenance import parameters_of
    from alula.stages.reporting.page import comment
    from alula.stages.viewing.page import within

    inputs = _inputs(files)
    if not options.is_given(context, "output"):
        if common.dry_run or common.depfile is not None:
            raise UsageError("-n and --depfile need -o")
        _serve(files, config, port, common)
        return
    if common.output.suffix not in (".html", ".htm"):
        raise UsageError(f"{common.output}: the output must end in .html")

    def make(provenance: Provenance, progress: Progress) -> tuple[Callable[[], None], dict[str, Any]]:
        from alula.schemas.atomic import write_text

        shown = _read(files, config)
        progress(1, 2)
        # The summary is part of the page, so it is known before the page is bounded.
        text, content = within(
            _composer(shown, config), most_gaussians=config.gaussians, provenance_line="PROVENANCE"
        )
        summary = _summary(content)
        text = text.replace("PROVENANCE", comment(provenance.line(summary)), 1)
        progress(2, 2)
        return lambda: write_text(common.output, text), summary

    run(common, "alula/view", "1.0", parameters_of(config), inputs, make)


def _inputs(files: tuple[Path, ...]) -> Mapping[str, Path]:
    """All files that the page depends on, by role; a splat may have several."""
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


def _read(files: tuple[Path, ...], config: ViewConfig) -> Shown:
    from alula.stages.viewing.files import read_files

    return read_files(files, config.title)


def _composer(shown: Shown, config: ViewConfig) -> Callable[[int], Content]:
    """Function from a number of Gaussians to the content; refuses flights that no log has."""
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
        return within(_composer(shown, asked), most_gaussians=config.gaussians)[0]

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
