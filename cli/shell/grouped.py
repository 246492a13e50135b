"""Commands whose help shows the options that matter first, and the others in groups with headings."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

from alula.cli.shell.present import echo

F = TypeVar("F", bound=Callable[..., Any])
_ALL = "alula.help_of_all"  # in the context: show all options

COMMON = "Common options"
"""Heading of what nearly all commands have; always the last one."""

HELP = ["-h", "--help"]
"""Names of the option that shows the help."""

MOST = 10
"""Maximum number of options without a heading; a command with no more of them in all has no headings."""

MANY = 50
"""A command with more options shows those without a heading; --help-all shows the others."""


class Option(click.Option):
    """An option with the heading under which the help shows it.

    Args:
        group: the heading; empty for an option that matters.
    """

    def __init__(self, declarations: Any = None, *, group: str = "", **keywords: Any) -> None:
        super().__init__(declarations, **keywords)
        self.group = group


def option(*names: str, group: str = "", **keywords: Any) -> Callable[[F], F]:
    """Decorator that adds an option, as `click.option` does.

    Args:
        group: heading under which the help shows it; empty for an option that matters.
        keywords: as for `click.option`; a class must be an `Option`.
    """
    return click.option(*names, **{"cls": Option, **keywords}, group=group)


class Command(click.Command):
    """A command whose help groups its options."""

    def get_help_option_names(self, ctx: click.Context) -> list[str]:
        """The same names in every context: click keeps the option that it makes in the first one."""
        return HELP

    def sections(self, context: click.Context) -> dict[str, list[tuple[str, str]]]:
        """Options by heading, each with its names and its help.

        First those that matter, with the output at the head; then the groups, in the order in which their
        first options were declared; then the common ones.
        """
        found: dict[str, list[tuple[str, str]]] = {"Options": [], COMMON: []}
        for shown in self.get_params(context):
            if not isinstance(shown, click.Option) or (record := shown.get_help_record(context)) is None:
                continue
            is_help = not {*shown.opts}.isdisjoint(HELP)
            group = COMMON if is_help else getattr(shown, "group", "") or "Options"
            records = found.setdefault(group, [])
            records.insert(0 if shown.name == "output" else len(records), record)
        found[COMMON] = found.pop(COMMON)
        if sum(map(len, found.values())) <= MOST:
            return {"Options": [record for records in found.values() for record in records]}
        return {heading: records for heading, records in found.items() if records}

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """All parameters; where there are many options `--help-all` is one of them."""
        found = super().get_params(ctx)
        if sum(isinstance(one, click.Option) for one in found) <= MANY:
            return found

        def show(context: click.Context, _parameter: click.Parameter, is_given: bool) -> None:
            if is_given and not context.resilient_parsing:
                for line in self.help_of_all(context).splitlines():
                    echo(line)
                context.exit()

        words: dict[str, Any] = {"is_flag": True, "is_eager": True, "expose_value": False, "callback": show}
        return [Option(["--help-all"], group=COMMON, help="Show all options and exit.", **words), *found]

    def help_of_all(self, ctx: click.Context) -> str:
        """The help with all options."""
        ctx.meta[_ALL] = True
        return self.get_help(ctx)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write a list for each heading, or the first of them where there are many options."""
        sections = self.sections(ctx)
        count = sum(map(len, sections.values()))
        if count > MANY and not ctx.meta.get(_ALL):
            sections = {"Options": sections["Options"]}
        for heading, records in sections.items():
            with formatter.section(heading):
                formatter.write_dl(records)
        if more := count - sum(map(len, sections.values())):
            formatter.write_paragraph()
            with formatter.indentation():
                formatter.write_text(f"{ctx.command_path} --help-all shows {more} more options.")


def command(name: str | None = None, **keywords: Any) -> Callable[[Callable[..., Any]], Command]:
    """Decorator that makes a `Command`, as `click.command` does.

    Args:
        name: of the command; None is that of the function.
    """
    return click.command(name, cls=Command, **keywords)
