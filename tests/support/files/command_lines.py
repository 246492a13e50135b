"""Command lines of README.md and the pages of docs/: those in blocks of code, and those within sentences."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

from support.paths import DOCS, ROOT

PAGES = (ROOT / "README.md", *sorted(DOCS.rglob("*.md")))

_FENCE = re.compile(r"^( *)(`{3,})(\w*)")
_SHELL = ("", "sh", "bash", "console")
_WITHIN = re.compile(r"`(alula [a-z][^`]*)`")


@dataclass(frozen=True)
class CommandLine:
    """One command of a line.

    Attributes:
        page: path of the page from the root of the repository.
        number: line of the page.
        words: as a shell splits them, without comments.
        folder: to which a `cd` before it in the same block has gone; empty for the folder of the reader.
    """

    page: str
    number: int
    words: tuple[str, ...]
    folder: str = ""

    def __str__(self):
        return f"{self.page}:{self.number}: {' '.join(self.words)}"


def command_lines(page: Path) -> list[CommandLine]:
    """Commands in the blocks of a page.

    In a block of `sh` every line counts; in one without a language, or indented by four spaces, those of
    `alula`, `make` and `python`. The others are text.
    """
    found = []
    name = str(page.relative_to(ROOT)) if page.is_relative_to(ROOT) else page.name
    for is_shell, block in _blocks(page.read_text()):
        folder = ""
        for number, line in _joined(block):
            for words in _commands(line):
                if not is_shell and words[0] not in ("alula", "make", "python"):
                    continue
                if words[0] == "cd":
                    folder = f"{folder}/{words[1]}".lstrip("/")
                found.append(CommandLine(name, number, tuple(words), folder))
    return found


def spans(page: Path) -> list[str]:
    """Commands of alula within the sentences of a page."""
    text = re.sub(r"^ *```.*?^ *```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    return [" ".join(match[1].split()) for match in _WITHIN.finditer(text)]


def _blocks(text: str) -> list[tuple[bool, list[tuple[int, str]]]]:
    """Blocks of code that may have commands: whether they are of a shell, and their numbered lines."""
    blocks, fence, indented = [], None, []
    for number, line in enumerate(text.splitlines(), 1):
        match = _FENCE.match(line)
        if fence is not None:
            if match and match[2] == fence and not match[3]:
                fence = None
            elif blocks:
                blocks[-1][1].append((number, line.strip()))
        elif match:
            fence = match[2]
            blocks.append((match[3] == "sh", []))
            if match[3] not in _SHELL:
                blocks[-1] = (False, _Ignored())
        elif line.startswith("    "):
            indented.append((number, line.strip()))
    return [(is_shell, lines) for is_shell, lines in blocks if not isinstance(lines, _Ignored)] + [
        (False, indented)
    ]


class _Ignored(list):
    """Lines of a block in another language."""


def _joined(block):
    """Lines of a block; one that ends with a backslash continues."""
    waiting, first = "", 0
    for number, line in block:
        first = first if waiting else number
        if line.endswith("\\"):
            waiting += line[:-1]
            continue
        yield first, waiting + line
        waiting = ""


def _commands(line: str) -> list[list[str]]:
    """The commands of a line, which && joins, without prompt, redirections and settings of variables."""
    try:
        words = shlex.split(line, comments=True)
    except ValueError:  # a sentence with an apostrophe
        return []
    commands: list[list[str]] = [[]]
    for word, before in zip(words, ["", *words], strict=False):
        if word in ("&&", ";", "|", "&"):
            commands.append([])
        elif word in (">", "2>", "$") or before in (">", "2>"):
            continue
        elif commands[-1] or not re.match(r"^[A-Z_]+=", word):
            commands[-1].append("alula" if not commands[-1] and word.endswith("/bin/alula") else word)
    return [command for command in commands if command]
