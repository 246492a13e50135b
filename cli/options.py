"""Options that all commands share, and options made from a configuration class."""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

import click

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


class Point(click.ParamType):  # type: ignore[type-arg, unused-ignore]
    """A point written as one argument: "x y z" or "x,y,z"."""

    name = "xyz"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, float, float]:
        """Parse three finite numbers."""
        if isinstance(value, tuple):
            return typing.cast(tuple[float, float, float], value)
        parts = str(value).replace(",", " ").split()
        if len(parts) != 3:
            self.fail(f'{value!r} is not a point; write "x y z"', param, ctx)
        x, y, z = (FINITE_FLOAT.convert(part, param, ctx) for part in parts)
        return x, y, z


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
    """The name of a file or folder; the reader or writer checks the file itself."""

    def __init__(self, *, stdin: bool = False) -> None:
        super().__init__(path_type=Path)
        self.stdin = stdin

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Refuse text that cannot name a file."""
        if value == "":
            self.fail("the name of the file is empty", param, ctx)
        if value == "-" and not self.stdin:
            self.fail("artifacts are files, not streams (./- is a file of that name)", param, ctx)
        if isinstance(value, str) and any(character in value for character in "\0\r\n"):
            self.fail("the name of the file has a line break", param, ctx)
        return super().convert(value, param, ctx)


FINITE_FLOAT = FiniteFloat()
POINT = Point()
PATH = FilePath()
JOBS = Whole(0, 256)


@dataclass(frozen=True, slots=True)
class Common:
    """Values of the options that all commands that write a file share."""

    output: Path
    force: bool
    dry_run: bool
    json: bool
    quiet: bool
    verbose: int
    seed: int
    jobs: int
    depfile: Path | None


def reporting(function: F) -> F:
    """Add -q, -v and --json, for commands that write no file; the function gets them by name."""
    for option in (
        click.option("-v", "--verbose", count=True, help="More notes; -vv shows tracebacks."),
        click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors."),
        click.option("--json", "json", is_flag=True, help="Print the result, or the error, as JSON."),
    ):
        function = option(function)
    return function


def output(suffix: str) -> Callable[[F], F]:
    """Decorator that adds the common options; the function gets them as one argument `common`.

    Args:
        suffix: usual suffix of the output, for the help.
    """

    def decorate(function: F) -> F:
        def collect(*args: Any, **kwargs: Any) -> Any:
            fields = {f.name: kwargs.pop(f.name) for f in dataclasses.fields(Common)}
            return function(*args, common=Common(**fields), **kwargs)

        collect.__name__, collect.__doc__ = function.__name__, function.__doc__
        collect.__dict__.update(function.__dict__)
        decorated = reporting(collect)
        for option in (
            click.option("--depfile", type=PATH, help="Also write Make dependencies to this file."),
            click.option(
                "--jobs",
                type=JOBS,
                default=0,
                help="Threads; 0 is all processors. Results do not depend on it.",
                show_default=True,
            ),
            click.option(
                "--seed",
                type=Whole(0, 2**63 - 1),
                default=0,
                help="Seed of all randomness.",
                show_default=True,
            ),
            click.option("-n", "--dry-run", is_flag=True, help="Read and check everything, write nothing."),
            click.option("-f", "--force", is_flag=True, help="Replace an output of other provenance."),
            click.option("-o", "--output", type=PATH, required=True, help=f"File to write ({suffix})."),
        ):
            decorated = option(decorated)
        return typing.cast(F, decorated)

    return decorate


def from_config(config: type[Any]) -> Callable[[F], F]:
    """Decorator that adds one option per field of a configuration dataclass.

    The function gets an instance as its argument `config`. The metadata of a field can have `help`, `option`
    (one name or several, when they differ from the field's name) and `metavar`.

    Args:
        config: the dataclass; fields with the metadata `internal` get no option.
    """

    def decorate(function: F) -> F:
        hints = typing.get_type_hints(config)
        fields = [f for f in dataclasses.fields(config) if not f.metadata.get("internal")]

        def collect(*args: Any, **kwargs: Any) -> Any:
            values = {f.name: kwargs.pop(f.name) for f in fields}
            return function(*args, config=config(**values), **kwargs)

        collect.__name__, collect.__doc__ = function.__name__, function.__doc__
        collect.__dict__.update(function.__dict__)
        for field in reversed(fields):
            names = field.metadata.get("option", option_of(field))
            names = (names,) if isinstance(names, str) else names
            keywords: dict[str, Any] = {"help": field.metadata.get("help"), **_type_of(hints[field.name])}
            if "metavar" in field.metadata:
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
            collect = click.option(*names, field.name, **keywords)(collect)
        return typing.cast(F, collect)

    return decorate


def _type_of(hint: Any) -> dict[str, Any]:
    """Click's keywords for a type annotation."""
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        inner = [a for a in typing.get_args(hint) if a is not type(None)]
        return _type_of(inner[0])
    if typing.get_origin(hint) is Literal:
        return {"type": click.Choice([str(choice) for choice in typing.get_args(hint)])}
    if typing.get_origin(hint) is tuple:
        arguments = typing.get_args(hint)
        if arguments[-1] is Ellipsis:
            return {**_type_of(arguments[0]), "multiple": True}
        if arguments == (float, float, float):
            return {"type": POINT}
        return {"type": FINITE_FLOAT, "nargs": len(arguments)}
    if hint is bool:
        return {"is_flag": True}
    if hint is float:
        return {"type": FINITE_FLOAT}
    if hint is int:
        return {"type": Whole()}
    if hint is Path:
        return {"type": PATH}
    return {"type": str}


def option_of(field: dataclasses.Field[Any]) -> str:
    """First name of a configuration field's option on the command line."""
    names: str | tuple[str, ...] = field.metadata.get("option", "--" + field.name.replace("_", "-"))
    return names if isinstance(names, str) else names[0]


def is_given(context: click.Context, name: str) -> bool:
    """Test whether an option was given on the command line.

    Args:
        context: context of the command.
        name: name of the option's parameter.
    """
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
        click.option(
            "--allow-remote",
            is_flag=True,
            is_eager=True,
            expose_value=False,
            callback=allow,
            help="Allow a --scheduler on another machine. Scheduler and workers can run any code here, and "
            "see what they are sent: use only those that you trust.",
        )(function)
        return click.option(
            "--scheduler",
            metavar="ADDRESS",
            callback=check,
            help=f"{what} to this dask.distributed scheduler, tcp://host:port.",
        )(function)

    return add


def input_path() -> FilePath:
    """Type of a file to read; the reader checks that it exists and is a file, with exit code 3."""
    return PATH
