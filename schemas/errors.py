"""Errors for the user, each class with its exit code."""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Self, TypeVar


class ExitCode(IntEnum):
    """Exit codes of the command line; part of its contract."""

    DONE = 0
    INTERNAL = 1
    USAGE = 2
    INPUT = 3
    CHECK = 4
    INFEASIBLE = 5
    LINK = 6
    INTERRUPTED = 130
    BROKEN_PIPE = 141


class AlulaError(Exception):
    """Base of all errors that a user can act on; the text is one line."""

    exit_code = ExitCode.INTERNAL

    def reworded(self, text: str) -> Self:
        """The same error, with all of its attributes, and another text."""
        return _remade(type(self), text, self.__dict__)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy and pickle by text and attributes, whatever arguments the class is made from."""
        return _remade, (type(self), str(self), self.__dict__)


_Error = TypeVar("_Error", bound=AlulaError)


def _remade(kind: type[_Error], text: str, attributes: dict[str, Any]) -> _Error:
    error = kind.__new__(kind)
    error.args = (text,)
    error.__dict__.update(attributes)
    return error


class UsageError(AlulaError):
    """An option or a combination of options makes no sense."""

    exit_code = ExitCode.USAGE


class InputError(AlulaError):
    """An input cannot be read, is damaged or does not fit."""

    exit_code = ExitCode.INPUT


class ArtifactError(InputError):
    """An artifact is not a valid one."""


class WrongKindError(ArtifactError):
    """An artifact is of another kind than the command needs."""


class VersionError(ArtifactError):
    """An artifact was written by a newer, incompatible version."""


class DamagedError(ArtifactError):
    """An artifact's bytes contradict its manifest."""


class OutputError(InputError):
    """An output cannot be written."""


class CheckError(AlulaError):
    """A check or gate that the user asked for does not hold."""

    exit_code = ExitCode.CHECK


class InfeasibleError(AlulaError):
    """There is no solution within the limits: no plan, no cover within the budget."""

    exit_code = ExitCode.INFEASIBLE


class LinkError(AlulaError):
    """A link or a vehicle does not respond as required."""

    exit_code = ExitCode.LINK
