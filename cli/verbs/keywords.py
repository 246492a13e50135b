"""Keyword arguments that are the fields of a stage's configuration."""

from __future__ import annotations

import dataclasses
import difflib
import inspect
import math
import typing
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import msgspec

from alula.schemas.errors import UsageError

F = TypeVar("F", bound=Callable[..., Any])
C = TypeVar("C")


def keywords(config: type[Any], *, without: tuple[str, ...] = ()) -> Callable[[F], F]:
    """Decorator that shows the fields of a configuration as the keyword arguments of `**fields`.

    The signature lists them with their defaults. The docstring explains them where it has a line that
    begins with `**fields`.

    Args:
        without: fields that are no arguments.
    """
    shown = [one for one in dataclasses.fields(config) if one.name not in without]

    def decorate(function: F) -> F:
        signature = inspect.signature(function)
        own = [one for one in signature.parameters.values() if one.kind is not one.VAR_KEYWORD]
        given = [
            inspect.Parameter(
                field.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=inspect.Parameter.empty if field.default is dataclasses.MISSING else field.default,
                annotation=field.type,
            )
            for field in shown
        ]
        function.__signature__ = signature.replace(parameters=[*own, *given])  # type: ignore[attr-defined]
        lines = (function.__doc__ or "").split("\n")
        function.__doc__ = "\n".join(
            text
            for line in lines
            for text in (
                [f"        {one.name}: {one.metadata.get('help', '')}" for one in shown]
                if line.strip().startswith("**fields")
                else [line]
            )
        )
        return function

    return decorate


def configured(name: str, config: type[C], fields: Mapping[str, Any]) -> C:
    """A configuration with the given values, which become those that the command line would parse.

    Lists and arrays become tuples, whole numbers floats where the field is a float.

    Args:
        name: of the function, for the messages.

    Raises:
        TypeError: there is no such keyword argument.
        UsageError: a value is of another type, not finite or out of range.
    """
    hints = typing.get_type_hints(config)
    known = [field.name for field in dataclasses.fields(config)]  # type: ignore[arg-type]
    for key in fields:
        if key not in known:
            near = (
                difflib.get_close_matches(key, known, 1) or [one for one in known if one.startswith(key)][:1]
            )
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise TypeError(f"{name}() got an unexpected keyword argument {key!r}{hint}")
    values = {key: _converted(key, hints[key], value) for key, value in fields.items()}
    return config(**values)


def _converted(key: str, hint: Any, value: Any) -> Any:
    """A value of the type that the hint names."""
    try:
        found = msgspec.convert(_simple(value), hint)
    except msgspec.ValidationError as error:
        raise UsageError(f"{key}: {str(error)[:1].lower()}{str(error)[1:]}") from error
    if not _is_finite(found):
        raise UsageError(f"{key}: {value!r} is not finite")
    return found


def _simple(value: Any) -> Any:
    """Python's own values in place of those of NumPy, lists in place of other sequences."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_simple(item) for item in value]
    return value


def _is_finite(value: Any) -> bool:
    if isinstance(value, float):
        return math.isfinite(value)
    return all(map(_is_finite, value)) if isinstance(value, tuple) else True
