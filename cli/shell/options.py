"""Options that all commands share, and options made from a configuration class."""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeVar

import click

from alula.cli.shell import completion, grouped
from alula.cli.shell.addresses import Address, is_address
from alula.schemas.parameters.configs.config import flags_of

F = TypeVar("F", bound=Callable[..., Any])


class FiniteFloat(click.ParamType):  # type: ignore[type-arg, unused-ignore]
    """A float that is neither NaN nor infinite."""

    name = "float"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Parse the text; refuse anything but a finite number."""
        try:
            number = float(value)
        except (TypeError, ValueError):
            self.fail(f"{value!r} is not a number", param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not finite", param, ctx)
        return number


class Numbers(click.ParamType):  # type: ignore[type-arg, unused-ignore]
    """A fixed count of finite numbers, separated by spaces or commas; see `NumbersOption`."""

    name = "numbers"

    def __init__(self, count: int) -> None:
        self.count = count

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Parse the numbers of one text."""
        if isinstance(value, tuple):
            return value
        parts = _parts(str(value))
        if len(parts) != self.count or not parts:
            given = (param.metavar or "") if param is not None else ""
            form = given.lower() if " " in given else _FORM.get(self.count, "x ...")
            self.fail(
                f"{str(value)!r} is not {self.count} numbers; write {self.count} words, or one in quotes: "
                f'"{form}"',
                param,
                ctx,
            )
        return tuple(FINITE_FLOAT.convert(part, param, ctx) for part in parts)


_FORM = {3: "x y z", 4: "x y z r", 6: "x0 y0 z0 x1 y1 z1", 7: "x0 y0 z0 x1 y1 z1 metres"}


def _parts(text: str) -> list[str]:
    return text.replace(",", " ").split()


def _are_numbers(text: str) -> bool:
    try:
        return all(math.isfinite(float(part)) for part in _parts(text)) and bool(text.strip(" ,"))
    except ValueError:
        return False


class NumbersOption(grouped.Option):
    """An option of type `Numbers`: one word in quotes, several words, or a mixture of both."""

    def add_to_parser(self, parser: Any, ctx: click.Context) -> None:
        """Let the option take further words that are numbers until it has all of its numbers."""
        super().add_to_parser(parser, ctx)
        count = typing.cast(Numbers, self.type).count
        for name in self.opts:
            # click has no public way to let an option take a varying number of words.
            entry = (parser._long_opt if name.startswith("--") else parser._short_opt)[name]
            if getattr(entry, "takes_words", False):
                continue

            def process(value: Any, state: Any, before: Any = entry.process) -> None:
                words = [str(value)]
                taken = len(_parts(words[0])) if _are_numbers(words[0]) else count
                while taken < count and state.rargs and _are_numbers(state.rargs[0]):
                    words.append(state.rargs.pop(0))
                    taken += len(_parts(words[-1]))
                before(" ".join(words), state)

            entry.process, entry.takes_words = process, True


class Whole(click.ParamType):  # type: ignore[type-arg, unused-ignore]
    """A whole number within limits; the default limits keep it exact in JSON and in C++."""

    name = "integer"

    def __init__(self, minimum: int = -(2**53), maximum: int = 2**53) -> None:
        self.minimum, self.maximum = minimum, maximum

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Parse the text; refuse anything but a whole number within the limits."""
        try:
            number = int(value)
        except (TypeError, ValueError):
            self.fail(f"{value!r} is not a whole number", param, ctx)
        if not (self.minimum <= number <= self.maximum):
            limits = f"not between {self.minimum} and {self.maximum}" if self.minimum == 0 else "out of range"
            self.fail(f"{number} is {limits}", param, ctx)
        return number


class FilePath(click.Path):
    """The name of a file or folder; the reader or writer checks the file itself, with exit code 3.

    Args:
        stdin: `-` is standard input.
        web: addresses are allowed too.
    """

    def __init__(self, *, stdin: bool = False, web: bool = False) -> None:
        super().__init__(path_type=Path)
        self.stdin, self.web = stdin, web

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Refuse text that cannot name a file; an address becomes an `Address`."""
        if value == "":
            self.fail("the name of the file is empty", param, ctx)
        if value == "-" and not self.stdin:
            self.fail("artifacts are files, not streams (./- is a file of that name)", param, ctx)
        if isinstance(value, str) and any(character in value for character in "\0\r\n"):
            self.fail("the name of the file has a line break", param, ctx)
        if isinstance(value, str) and is_address(value):
            if not self.web:
                self.fail(
                    "addresses are inputs of import-splat and info; download the file first", param, ctx
                )
            return Address(value)
        return super().convert(value, param, ctx)


FINITE_FLOAT = FiniteFloat()
POINT = Numbers(3)
PATH = FilePath()
JOBS = Whole(0, 256)
REMOTE = "Other machines"


@dataclass(frozen=True, slots=True)
class Common:
    """Values of the options that all commands that write a file share."""

    output: Path
    force: bool = False
    dry_run: bool = False
    json: bool = False
    quiet: bool = False
    verbose: int = 0
    seed: int = 0
    jobs: int = 0
    depfile: Path | None = None


common = partial(grouped.option, group=grouped.COMMON)


def reporting(function: F) -> F:
    """Add -q, -v and --json, for commands that write no file; the function gets them by name."""
    for option in (
        common("-v", "--verbose", count=True, help="More notes; -vv shows tracebacks."),
        common("-q", "--quiet", is_flag=True, help="Print nothing but errors."),
        common("--json", "json", is_flag=True, help="Print the result, or the error, as JSON."),
    ):
        function = option(function)
    return function


def output(suffix: str, *, required: bool = True) -> Callable[[F], F]:
    """Decorator that adds the common options; the function gets them as one argument `common`.

    Args:
        suffix: usual suffix of the output, for the help.
        required: refuse a command without an output; else its path is then that of the current folder.
    """

    def decorate(function: F) -> F:
        def collect(*args: Any, **kwargs: Any) -> Any:
            fields = {f.name: kwargs.pop(f.name) for f in dataclasses.fields(Common)}
            fields["output"] = fields["output"] or Path()
            return function(*args, common=Common(**fields), **kwargs)

        collect.__name__, collect.__doc__ = function.__name__, function.__doc__
        collect.__dict__.update(function.__dict__)
        decorated = reporting(collect)
        for option in (
            common("--depfile", type=PATH, help="Also write Make dependencies to this file."),
            common(
                "--jobs",
                type=JOBS,
                default=0,
                help="Threads; 0 is all processors. Results do not depend on it.",
                show_default=True,
            ),
            common(
                "--seed",
                type=Whole(0, 2**63 - 1),
                default=0,
                help="Seed of all randomness.",
                show_default=True,
            ),
            common("-n", "--dry-run", is_flag=True, help="Read and check everything, write nothing."),
            common("-f", "--force", is_flag=True, help="Replace an output of other provenance."),
            grouped.option("-o", "--output", type=PATH, required=required, help=f"File to write ({suffix})."),
        ):
            decorated = option(decorated)
        return typing.cast(F, decorated)

    return decorate


def from_config(config: type[Any], argument: str = "config") -> Callable[[F], F]:
    """Decorator that adds one option per field of a configuration dataclass; an instance is handed."""
    return _of_fields(config, lambda values: {argument: config(**values)})


def fields_of(config: type[Any], groups: Mapping[str, str] | None = None) -> Callable[[F], F]:
    """Decorator that adds one option per field of a configuration dataclass, for a verb.

    The function gets a dictionary `fields` of those that are given on the command line.

    Args:
        groups: headings by field, in place of those of the metadata.
    """

    def given(values: dict[str, Any]) -> dict[str, Any]:
        context = click.get_current_context()
        return {"fields": {name: value for name, value in values.items() if is_given(context, name)}}

    return _of_fields(config, given, groups)


def _of_fields(
    config: type[Any],
    handed: Callable[[dict[str, Any]], dict[str, Any]],
    groups: Mapping[str, str] | None = None,
) -> Callable[[F], F]:
    """Decorator that adds one option per field of a configuration dataclass; see `configs.config.option`.

    Args:
        config: the dataclass; fields with the metadata `internal` get no option.
        handed: function from the values to arguments of the decorated function.
        groups: headings by field, in place of those of the metadata.
    """

    def decorate(function: F) -> F:
        hints = typing.get_type_hints(config)
        fields = [f for f in dataclasses.fields(config) if not f.metadata.get("internal")]

        def collect(*args: Any, **kwargs: Any) -> Any:
            values = {f.name: kwargs.pop(f.name) for f in fields}
            return function(*args, **handed(values), **kwargs)

        collect.__name__, collect.__doc__ = function.__name__, function.__doc__
        collect.__dict__.update(function.__dict__)
        for field in reversed(fields):
            keywords: dict[str, Any] = {"help": field.metadata["help"], **_type_of(hints[field.name])}
            if field.name == "filter":
                keywords["shell_complete"] = completion.filters
            if field.metadata["metavar"]:
                keywords["metavar"] = field.metadata["metavar"]
            if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
                keywords["required"] = True
            else:
                default = (
                    field.default
                    if field.default is not dataclasses.MISSING
                    else typing.cast(Callable[[], Any], field.default_factory)()
                )
                keywords.update(default=default, show_default=default is not None and default != ())
            group = (groups or {}).get(field.name, field.metadata["group"])
            collect = grouped.option(*flags_of(field), field.name, group=group, **keywords)(collect)
        return typing.cast(F, collect)

    return decorate


def _type_of(hint: Any) -> dict[str, Any]:
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        inner = [a for a in typing.get_args(hint) if a is not type(None)]
        return _type_of(inner[0])
    if typing.get_origin(hint) is Literal:
        return {"type": click.Choice([str(choice) for choice in typing.get_args(hint)])}
    if typing.get_origin(hint) is tuple:
        arguments = typing.get_args(hint)
        if arguments[-1] is Ellipsis:
            return {**_type_of(arguments[0]), "multiple": True}
        return {"type": Numbers(len(arguments)), "cls": NumbersOption}
    if hint is bool:
        return {"is_flag": True}
    if hint is float:
        return {"type": FINITE_FLOAT}
    if hint is int:
        return {"type": Whole()}
    if hint is Path:
        return {"type": PATH}
    return {"type": str}


def is_given(context: click.Context, name: str) -> bool:
    """Test whether an option was given on the command line."""
    return context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE


def scheduler(what: str) -> Callable[[F], F]:
    """Add `--scheduler`, and `--allow-remote`, without which its address must be on this machine.

    Args:
        what: is sent to it, as the first word of the help.
    """

    def check(context: click.Context, _parameter: click.Parameter, value: str | None) -> str | None:
        from alula.stages.distribute import check_scheduler

        if value is not None:
            check_scheduler(value, allow_remote=context.meta.get("allow_remote", False))
        return value

    def allow(context: click.Context, _parameter: click.Parameter, value: bool) -> None:
        context.meta["allow_remote"] = value

    def add(function: F) -> F:
        grouped.option(
            "--allow-remote",
            group=REMOTE,
            is_flag=True,
            is_eager=True,
            expose_value=False,
            callback=allow,
            help="Allow a --scheduler on another machine. Scheduler and workers can run any code here, and "
            "see what they are sent: use only those that you trust.",
        )(function)
        return grouped.option(
            "--scheduler",
            group=REMOTE,
            metavar="ADDRESS",
            callback=check,
            help=f"{what} to this dask.distributed scheduler, tcp://host:port.",
        )(function)

    return add


def vehicle(help: str) -> Callable[[F], F]:
    """Add `--vehicle NAME|FILE`; the function gets `vehicle_name`, for `vehicle_named`."""
    return click.option(
        "--vehicle", "vehicle_name", metavar="NAME|FILE", help=help, shell_complete=completion.vehicles
    )


def settings(help: str, group: str = "") -> Callable[[F], F]:
    """Add `--set PATH=VALUE`, which may be repeated; the function gets `settings`; see `set_values`."""
    return grouped.option("--set", "settings", group=group, multiple=True, metavar="PATH=VALUE", help=help)
