"""`alula.report` and `alula.view`: pages for a notebook or a file."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from alula.cli.library.bar import quiet, shown
from alula.cli.verbs.keywords import configured, keywords
from alula.cli.verbs.results import Cover, Plan, Result, Scene, on_disk
from alula.cli.verbs.runs import Run
from alula.schemas.configs.report import ReportConfig
from alula.schemas.configs.view import PictureConfig, ViewConfig
from alula.schemas.errors import UsageError
from alula.schemas.provenance import Provenance

if TYPE_CHECKING:
    from alula.schemas.keywords import ReportFields, ViewFields

_HEIGHT = 640  # of a page in a notebook [pixels]


class Page:
    """A page: shown below the cell of a notebook, or written to a file by `save`.

    Attributes:
        title: of the page, in words.
    """

    def __init__(self, title: str, html: Callable[[], str], write: Callable[[Path, bool], None]) -> None:
        self.title = title
        self._html, self._write = html, write

    @cached_property
    def html(self) -> str:
        """The text of the page, which loads nothing from elsewhere."""
        return self._html()

    def save(self, path: str | Path, *, force: bool = False) -> Page:
        """Write the files that the command would write.

        Args:
            path: the file; its suffix chooses the format of a report.
            force: replace files of other provenance.

        Raises:
            UsageError: other files are there.
            OutputError: a file cannot be written.
        """
        self._write(Path(path).expanduser(), force)
        return self

    def serve(self, port: int = 0) -> None:
        """Serve the page to a browser on this machine until it is interrupted; print its address.

        Args:
            port: of this machine; 0 takes a free one.

        Raises:
            UsageError: the port is taken.
        """
        from alula.cli.present import echo
        from alula.stages.viewing.serve import PageServer

        with PageServer(lambda flight: self.html if flight is None else None, port) as server:
            echo(server.url)
            try:
                server.run()
            except KeyboardInterrupt:
                return

    def __repr__(self) -> str:
        return f"{self.title}; save(path) writes it, serve() shows it in a browser"

    def _repr_html_(self) -> str:
        text = escape(self.html, quote=True)
        return f'<iframe srcdoc="{text}" style="width:100%;height:{_HEIGHT}px;border:0"></iframe>'


@keywords(ReportConfig, without=("format",))
def report(
    *runs: Run | str | Path,
    cover: Cover | str | Path | None = None,
    scene: Scene | str | Path | None = None,
    plan: Plan | str | Path | None = None,
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
    from alula.cli.report import contents_of, files_of, read_material, write_report
    from alula.cli.runner import input_ref
    from alula.schemas.report import REPORT_SCHEMA, REPORT_VERSION

    if "format" in fields:
        raise TypeError("report() takes no format; the suffix of the file that save writes chooses it")
    config = configured("report", ReportConfig, fields)
    named = {"cover": cover, "scene": scene, "plan": plan, "certificate": certificate}
    if not runs and not any(one is not None for one in named.values()):
        raise UsageError("report needs a run, or one of cover, scene, plan")

    def paths(folder: Path) -> tuple[list[Path], dict[str, Path]]:
        found = {role: _path_of(one, folder, role) for role, one in named.items() if one is not None}
        return [_path_of(one, folder, f"run-{k}") for k, one in enumerate(runs, 1)], found

    def html() -> str:
        logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it warns when it cannot cache its fonts
        output = Path("report.html")
        with on_disk() as folder, shown("report") as progress:
            logs, others = paths(folder)
            inputs = files_of(logs, others)
            refs = [input_ref(role, path) for role, path in inputs.items()]
            parameters = config.parameters(output)
            made = Provenance.now(REPORT_SCHEMA, REPORT_VERSION, parameters, None, refs)
            material = read_material(config.title, logs, inputs, made)
            files, _ = contents_of(material, config, "html", output, made, progress)
        return files[output].decode()

    def write(output: Path, force: bool) -> None:
        with on_disk() as folder:
            logs, others = paths(folder)
            write_report(logs, others, config, quiet(output, force=force))

    return Page(f"Report {config.title!r} of {len(runs)} runs", html, write)


@keywords(ViewConfig)
def view(*things: Result | Run | str | Path, **fields: Unpack[ViewFields]) -> Page:
    """Show artifacts, runs and splat files in three dimensions.

    Args:
        *things: results, or files.
        **fields: as in the signature.

    Returns:
        The page, which a notebook shows below the cell.

    Raises:
        UsageError: there is nothing to show.
        InputError: a file cannot be read.
    """
    from alula.cli.view import composer, page_inputs, write_view
    from alula.stages.viewing.files import read_files
    from alula.stages.viewing.page import within

    config = configured("view", ViewConfig, fields)
    if not things:
        raise UsageError("view needs something to show")

    def paths(folder: Path) -> list[Path]:
        return [
            _path_of(one, folder, type(one).__name__.lower() + (f"-{k}" if k > 1 else ""))
            for k, one in enumerate(things, 1)
        ]

    def html() -> str:
        with on_disk() as folder, shown("view"):
            found = read_files(paths(folder), config.title)
            return within(composer(found, config), gaussians=config.gaussians)[0]

    def write(output: Path, force: bool) -> None:
        with on_disk() as folder:
            files = paths(folder)
            inputs: Mapping[str, Path] = page_inputs(files)
            write_view(files, inputs, config, PictureConfig(), quiet(output, force=force))

    return Page(f"View of {len(things)} things", html, write)


def _path_of(one: Any, folder: Path, name: str) -> Path:
    """Path of a file with a result; those that were not saved are written into the folder."""
    if isinstance(one, str | Path):
        return Path(one).expanduser()
    if isinstance(one, Result | Run):
        return one.path_in(folder, name)
    path = folder / f"{name}.json"
    one.save(path)
    return path
