"""Man pages, in roff, made from the parsers; ASCII alone, so that every formatter reads them."""

from __future__ import annotations

import re
from inspect import cleandoc

import click

from alula import __version__
from alula.cli.main import COMMANDS, cli
from alula.cli.shell.grouped import Command


def man_pages() -> dict[str, str]:
    """Every page by the name of its file: that of alula, and one for each command."""
    top = cli.make_context("alula", [], resilient_parsing=True)
    pages = {"alula.1": _overview(top)}
    for name in COMMANDS:
        command = cli.get_command(top, name)
        assert isinstance(command, Command)
        pages[f"alula-{name}.1"] = _page(click.Context(command, top, name), command)
    return pages


def _overview(top: click.Context) -> str:
    options = [record for p in cli.get_params(top) if (record := p.get_help_record(top))]
    return "".join(
        [
            _head("alula", cleandoc(cli.help or "")),
            _synopsis(top),
            _section("Description", _paragraphs(cli.help or "")),
            _section("Options", _list(options)),
            _section("Commands", _list([(f"alula-{name}(1)", text) for name, text in COMMANDS.items()])),
            _exit_status(),
        ]
    )


def _page(context: click.Context, command: Command) -> str:
    text = cleandoc(command.help or "")
    first, *groups = command.sections(context).items()
    options = _list(first[1]) + "".join(f".SS {escaped(name)}\n{_list(records)}" for name, records in groups)
    examples = [line.strip() for line in cleandoc(command.epilog or "").splitlines()]
    return "".join(
        [
            _head(context.command_path, text.splitlines()[0]),
            _synopsis(context),
            _section("Description", _paragraphs(text)),
            _section("Options", options),
            _section("Examples", _lines([x for x in examples if x not in ("", "\b", "Examples:")])),
            _exit_status(),
            _section("See also", ".BR alula (1)\n"),
        ]
    )


def _head(name: str, summary: str) -> str:
    page = name.replace(" ", "-")
    title = f'.TH {escaped(page.upper())} 1 "" "alula {escaped(__version__)}" "Manual of alula"\n'
    return title + _section("Name", f"{escaped(page)} \\- {escaped(summary.rstrip('.'))}\n")


def _synopsis(context: click.Context) -> str:
    pieces = " ".join(context.command.collect_usage_pieces(context))
    return _section("Synopsis", f".B {escaped(context.command_path)}\n{escaped(pieces)}\n")


def _exit_status() -> str:
    return _section("Exit status", _paragraphs((cli.epilog or "").removeprefix("Exit codes: ")))


def _section(title: str, body: str) -> str:
    return f".SH {escaped(title.upper())}\n{body}" if body else ""


def _paragraphs(text: str) -> str:
    """Paragraphs that blank lines separate."""
    found = [" ".join(part.split()) for part in cleandoc(text).split("\n\n")]
    return "".join(f".PP\n{escaped(part)}\n" for part in found if part)


def _list(records: list[tuple[str, str]]) -> str:
    """Options or commands, each with its help."""
    return "".join(f".TP\n{_names(names)}\n{escaped(text)}\n" for names, text in records)


def _names(names: str) -> str:
    """Names of an option in bold, its value in italics."""
    words = re.split(r"(, | / | )", names)
    fonts = ["" if word in (", ", " / ", " ") else r"\fB" if _is_name(word) else r"\fI" for word in words]
    pairs = zip(fonts, words, strict=True)
    return "\\&" + "".join(f"{font}{escaped(word)}\\fR" if font else word for font, word in pairs)


def _is_name(word: str) -> bool:
    return word.startswith("-") or word.endswith("(1)")


def _lines(lines: list[str]) -> str:
    return ".nf\n" + "".join(f"{escaped(line)}\n" for line in lines) + ".fi\n" if lines else ""


def escaped(text: str) -> str:
    """Text that roff prints as it is.

    Args:
        text: of one line.
    """
    plain = text.replace("\\", "\\e").replace("-", "\\-").replace("'", "\\(aq").replace("`", "\\(ga")
    plain = plain.replace("^", "\\(ha").replace("~", "\\(ti").replace('"', "\\(dq")
    plain = "".join(c if ord(c) < 128 else f"\\[u{ord(c):04X}]" for c in plain)
    return f"\\&{plain}" if plain.startswith(".") else plain
