"""What a verb is: a checked step, which a command writes to a file and `import alula` makes at once."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, ParamSpec, Protocol, TypeVar, cast

from alula.cli.shell import runner
from alula.cli.shell.bar import shown
from alula.cli.shell.options import Common
from alula.cli.shell.parted import is_parted, run_parts
from alula.cli.verbs.keywords import keywords
from alula.cli.verbs.results import File, Result
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.provenance import parameters_of
from alula.schemas.progress import Progress

if TYPE_CHECKING:
    from alula.schemas.artifacts.manifest import Manifest
    from alula.schemas.artifacts.parts_output import PartsWriter
    from alula.schemas.artifacts.provenance import Provenance

P = ParamSpec("P")
R = TypeVar("R", bound=Result)
T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)


class Makes(Protocol[T_co]):
    """What a verb has checked, and can do."""

    def make(self, progress: Progress, /) -> T_co:
        """Do it."""


@dataclass(frozen=True, slots=True)
class Step(Generic[R]):
    """A call of a verb whose parameters and files go together, before its work.

    Attributes:
        inputs: all that the result depends on, by role; files are read by `build`.
        build: function from a progress callback to the artifact.
        into: function that writes a folder of parts and returns the manifest of the whole; None where the
            result is one file.
        extra: further parameters that a folder of parts depends on.
    """

    result: type[R]
    config: Any
    inputs: Mapping[str, Result | File]
    build: Callable[[Progress], Artifact]
    seed: int | None = None
    into: Callable[[PartsWriter, Provenance, Progress], Manifest] | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)

    def make(self, progress: Progress) -> R:
        """The result."""
        return self.result(self.build(progress), self.inputs, seed=self.seed)


class Verb(Protocol[P, T_co]):
    """A function that makes a result at once; `step` only checks, for a command that may find it current."""

    @property
    def step(self) -> Callable[P, Any]:
        """The call before its work."""

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> T_co:
        """Make the result, with a bar in a notebook and on a terminal."""


def verb(
    config: type[Any] | None = None, *, without: tuple[str, ...] = ()
) -> Callable[[Callable[P, Makes[T]]], Verb[P, T]]:
    """Decorator that makes a verb of a function that only checks, and returns what makes the result.

    The fields of the configuration are the keyword arguments `**fields` of the function; help and signature
    list them.

    Args:
        without: fields that are no arguments.
    """

    def decorate(function: Callable[P, Makes[T]]) -> Verb[P, T]:
        @functools.wraps(function)
        def made(*args: P.args, **kwargs: P.kwargs) -> T:
            return made_by(function.__name__, function(*args, **kwargs))

        made.step = function  # type: ignore[attr-defined]
        return cast(Verb[P, T], made if config is None else keywords(config, without=without)(made))

    return decorate


def made_by(name: str, step: Makes[T]) -> T:
    """What a step makes, with a bar in a notebook and on a terminal."""
    with shown(name) as progress:
        return step.make(progress)


def run_step(common: Common, step: Step[Any], *, names: Mapping[str, str] | None = None) -> None:
    """Run a step of a verb whose inputs are files, unless its output, a file or a folder, is already current.

    Args:
        names: role to name of inputs that are recorded by another name than the file's own.

    Raises:
        UsageError, InputError, OutputError: as `runner.run`.
    """
    paths = {role: one.path for role, one in step.inputs.items() if isinstance(one, File)}
    if step.into is not None and is_parted(common.output, step.result.KIND):
        parameters = parameters_of(step.config) | {**step.extra}
        run_parts(common, step.result.KIND, parameters, paths, step.into, seed=step.seed, names=names)
        return
    runner.run_stage(common, step.result.KIND, step.config, paths, step.build, seed=step.seed, names=names)
