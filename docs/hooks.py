"""Hooks of mkdocs: generated pages, pages of source files that others link to, and the results in the nav."""

from __future__ import annotations

import posixpath
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files, InclusionLevel

from alula.cli.pages.all import generated_pages

ROOT = Path(__file__).resolve().parents[1]
OUT = re.compile(r"(\]\()((?:\.\./)+[\w./-]+)(\))")
LANGUAGES = {".hpp": "cpp", ".h": "c", ".py": "python", ".toml": "toml"}


def on_startup(**_: Any) -> None:
    """Link the sources under one namespace, for the pages that are made from docstrings."""
    view = ROOT / "build/docs/alula"
    view.mkdir(parents=True, exist_ok=True)
    sources = [
        *(ROOT / "native/python/alula").iterdir(),
        *(ROOT / part for part in ("cli", "stages", "schemas")),
    ]
    for source in sources:
        with suppress(FileExistsError):
            (view / source.name).symlink_to(source)


def on_files(files: Files, *, config: Any) -> Files:
    """Add pages from outside docs/: generated ones, and source files that a page links to."""
    for uri, text in generated_pages().items():
        files.append(File.generated(config, uri, content=text))
    for page in [file for file in files.documentation_pages() if file.generated_by is None]:
        for match in OUT.finditer(page.content_string):
            path = _outside(page, match[2])
            if path and (ROOT / path).is_file() and not files.get_file_from_path(_uri(path)):
                text = (ROOT / path).read_text()
                language = LANGUAGES.get(Path(path).suffix, "text")
                content = f"# {path}\n\nThis file as it is in the repository.\n\n````{language}\n{text}````\n"
                files.append(
                    File.generated(config, _uri(path), content=content, inclusion=InclusionLevel.NOT_IN_NAV)
                )
    _add_results(files, config)
    return files


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Lead links to files outside of docs/ to their pages."""

    def inside(match: re.Match[str]) -> str:
        path = _outside(page.file, match[2])
        if not path:
            return match[0]
        return f"{match[1]}{posixpath.relpath(_uri(path), posixpath.dirname(page.file.src_uri))}{match[3]}"

    return OUT.sub(inside, markdown)


def _outside(page: File, link: str) -> str:
    """The path from the root of a file outside of docs/ that a page links to; empty for all others."""
    path = posixpath.normpath(posixpath.join("docs", posixpath.dirname(page.src_uri), link))
    return "" if path.startswith(("docs/", "..")) else path


def _uri(path: str) -> str:
    return f"source/{path}.md"


def _add_results(files: Files, config: Any) -> None:
    """Add pages of docs/results that the nav does not name to Results; the one on all papers comes first."""
    named = str(config.nav)
    (results,) = (part["Results"] for part in config.nav if "Results" in part)
    for file in sorted(files.documentation_pages(), key=lambda file: file.src_uri):
        if file.src_uri.startswith("results/") and f"'{file.src_uri}'" not in named:
            results.insert(0 if file.name == "papers" else len(results), file.src_uri)
