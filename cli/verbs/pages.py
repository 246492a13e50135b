"""Pages: what `report` and `view` return, for a notebook, a browser or a file."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from alula.cli.shell.bar import shown
from alula.cli.shell.options import Common
from alula.cli.shell.present import echo
from alula.cli.verbs.results import Result
from alula.cli.verbs.runs import Run
from alula.schemas.progress import Progress

if TYPE_CHECKING:
    from alula.stages.show.viewing.serve import PageServer

_HEIGHT = 640  # of a page in a notebook [pixels]


class Page:
    """A page: shown below the cell of a notebook, or written to a file by `save`.

    Attributes:
        title: of the page, in words.
        write: function that writes the files that the command would write, with its common options.
    """

    def __init__(
        self,
        name: str,
        title: str,
        make: Callable[[int | None, Progress], str | None],
        write: Callable[[Common], None],
    ) -> None:
        self.title, self.write = title, write
        self._name, self._make = name, make

    @cached_property
    def html(self) -> str:
        """The text of the page, which loads nothing from elsewhere."""
        with shown(self._name) as progress:
            return self._make(None, progress) or ""

    def save(self, path: str | Path, *, force: bool = False) -> Page:
        """Write the files that the command would write.

        Args:
            path: the file; its suffix chooses the format.
            force: replace files of other provenance.

        Raises:
            UsageError: other files are there.
            OutputError: a file cannot be written.
        """
        self.write(Common(Path(path).expanduser(), force=force, quiet=True))
        return self

    def server(self, port: int = 0) -> PageServer:
        """A server of the page on this machine; pages of other flights are made when they are asked for.

        Args:
            port: of this machine; 0 takes a free one.

        Raises:
            UsageError: the port is taken.
        """
        from alula.stages.show.viewing.serve import PageServer

        return PageServer(lambda flight: self._make(flight, lambda done, total: None), port)

    def serve(self, port: int = 0) -> None:
        """Serve the page to a browser on this machine until it is interrupted; print its address.

        Args:
            port: of this machine; 0 takes a free one.

        Raises:
            UsageError: the port is taken.
        """
        with self.server(port) as server:
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


def path_of(one: Any, folder: Path, name: str) -> Path:
    """Path of a file with a result; those that were not saved are written into a folder.

    Args:
        one: a result, a proof or a path.
        folder: for results that were not saved.
        name: of the file there, without a suffix.
    """
    if isinstance(one, str | Path):
        return Path(one).expanduser()
    if isinstance(one, Result | Run):
        return one.path_in(folder, name)
    path = folder / f"{name}.json"
    one.save(path)
    return path
