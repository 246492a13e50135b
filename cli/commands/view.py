"""`alula view`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli.shell import grouped, options
from alula.cli.shell.options import Common
from alula.cli.shell.present import echo, print_json
from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.view import PictureConfig, ViewConfig

if TYPE_CHECKING:
    from alula.cli.verbs.pages import Page

EXAMPLES = """\b
Examples:
  alula view scan.ply --up -y
  alula view room.scene.npz room.cover.npz room.plan.npz
  alula view room.scene.npz pairs.run.mcap -o page.html
  alula view pairs.run.mcap --flight 12
  alula view room.scene.npz room.plan.npz hoops.run.mcap -o hoops.png
  alula view room.scene.npz hoops.run.mcap -o hoops.webp --camera chase --seconds 8
"""


@grouped.command(epilog=EXAMPLES)
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=options.PATH)
@click.option(
    "--port",
    type=options.Whole(0, 65535),
    default=8080,
    show_default=True,
    help="Without -o: port of this machine only; 0 takes a free one.",
)
@options.fields_of(ViewConfig)
@options.from_config(PictureConfig, "picture")
@options.output(".html, .png, .webp or .gif", required=False)
@click.pass_context
def command(
    context: click.Context,
    files: tuple[Path, ...],
    port: int,
    fields: dict[str, Any],
    picture: PictureConfig,
    common: Common,
) -> None:
    """Show artifacts, runs and splat files in three dimensions.

    Without -o the page is served to a browser on this machine until Ctrl-C. With -o it is one file that
    needs no network: a page (.html), a picture (.png), or a moving picture of the first flight (.webp, .gif).
    Pictures are drawn without a graphics card. Splat files are read as import-splat reads them, without its
    options.
    """
    from alula.cli.verbs.view import MOVING, STILLS, view

    is_file = options.is_given(context, "output")
    form = common.output.suffix if is_file else ""
    for name in ("camera", "size", "frames_per_second", "seconds"):
        if options.is_given(context, name) and form not in MOVING and not (name == "size" and form in STILLS):
            known = ", ".join((*STILLS, *MOVING) if name == "size" else MOVING)
            raise UsageError(f"--{name.replace('_', '-')} needs an output that ends in {known}")
    if not is_file and (common.dry_run or common.depfile is not None):
        raise UsageError("-n and --depfile need -o")
    page = view(*files, picture=picture, **fields)
    if is_file:
        page.write(common)
    else:
        _serve(page, port, common)


def _serve(page: Page, port: int, common: Common) -> None:
    """Serve the page until Ctrl-C."""
    with page.server(port) as server:
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
