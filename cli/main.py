"""The program `alula`: the group of all commands, and the conversion of errors to exit codes."""

from __future__ import annotations

import difflib
import importlib
import os
import sys
from contextlib import suppress
from typing import Any

import click

from alula import __version__
from alula.cli.shell import grouped
from alula.cli.shell.interruption import InterruptedWithAdvice, Interruption
from alula.cli.shell.present import echo, print_json
from alula.cli.shell.streams import ClosedPipeError, discard_stdout, open_streams, pipe
from alula.schemas.errors import AlulaError, ExitCode
from alula.schemas.extras import EXTRAS, missing

# Names by heading, each with the first line of its help; a test compares the lines with the commands.
GROUPS: dict[str, dict[str, str]] = {
    "Pipeline": {
        "init": "Write a first project for a splat of your own, ready for make.",
        "demo": "Fly the built-in scene end to end and leave a report.",
        "demo-scene": "Write the built-in scene: a furnished room with hoops.",
        "import-splat": "Read Gaussian splat files into a scene.",
        "scale-align": "Give a scene metric scale and a named world frame.",
        "voxelize": "Mark every voxel that an obstacle touches.",
        "import-voxels": "Mark every voxel that a mesh, a cloud or an OctoMap touches.",
        "observe": "Mark the space that cameras saw to be free and that a vehicle can reach.",
        "merge": "Cover voxels with a limited number of convex polytopes.",
        "verify": "Prove independently that a cover contains the ellipsoids of a scene.",
        "plan": "Find a smooth collision-free trajectory through a map.",
        "simulate": "Fly missions through a world behind safety filters, and judge them.",
    },
    "Vehicle": {
        "fly": "Fly a plan on a real vehicle, behind a safety filter.",
        "identify": "Measure how a vehicle responds to steps, and write its vehicle file.",
        "sim-vehicle": "Simulate a MAVLink vehicle that behaves like ArduPilot Copter or PX4.",
    },
    "Look": {
        "report": "Turn runs into a verdict, pictures, figures and tables.",
        "view": "Show artifacts, runs and splat files in three dimensions.",
        "info": "Explain an artifact or a splat file.",
    },
    "Tools": {
        "scenario": "Show a scenario with all of its values and their sources.",
        "export": "Convert a cover, a scene or a run for other programs.",
        "doctor": "Check that everything alula needs is installed.",
        "help": "Show the help of alula or of a command.",
        "completion": "Print the completion script of a shell.",
    },
}
COMMANDS = {name: line for group in GROUPS.values() for name, line in group.items()}


class LazyGroup(click.Group):
    """A group whose commands are imported only when they run."""

    def make_context(self, *args: Any, **kwargs: Any) -> click.Context:
        """Parse the options of the group itself; some of them print."""
        with pipe():
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command."""
        with pipe():
            try:
                return super().invoke(ctx)
            except click.UsageError as error:
                if error.ctx is None and ctx.invoked_subcommand:  # the option parser does not set the command
                    command = self.get_command(ctx, ctx.invoked_subcommand)
                    if command is not None:
                        error.ctx = click.Context(command, ctx, ctx.invoked_subcommand)
                raise

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Print the help and exit with a usage error when there are no arguments."""
        if not args and not ctx.resilient_parsing:
            click.echo(ctx.get_help(), err=True)
            ctx.exit(ExitCode.USAGE)
        return super().parse_args(ctx, args)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find a command; for an unknown name, suggest the most similar one."""
        if args[0] not in COMMANDS and not args[0].startswith("-") and not ctx.resilient_parsing:
            near = difflib.get_close_matches(args[0], COMMANDS, 1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise click.UsageError(f"no command is called {args[0]!r}{hint}", ctx)
        return super().resolve_command(ctx, args)

    def list_commands(self, ctx: click.Context) -> list[str]:
        """All commands, in the order of the pipeline."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import the module of one command."""
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"alula.cli.commands.{cmd_name.replace('-', '_')}")
        command: click.Command = module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands by group, without importing them."""
        for heading, commands in GROUPS.items():
            with formatter.section(heading):
                formatter.write_dl(list(commands.items()))


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": grouped.HELP, "max_content_width": 100},
    epilog="Exit codes: 0 done, 1 internal error, 2 wrong usage, 3 bad input, 4 a check does not hold, "
    "5 infeasible, 6 link or vehicle, 130 interrupted, 141 broken pipe.",
)
@click.version_option(__version__, "-V", "--version", prog_name="alula")
def cli() -> None:
    """From a Gaussian splat to a safe flight."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with the documented code.

    Args:
        arguments: the words of the command line; None: those of the process.
    """
    from alula.schemas import atomic

    # One thread: the sums of linear algebra must not depend on the machine, and idle threads cost time.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    interruption = Interruption()
    interruption.install()
    atomic.appearing = interruption.appearing
    open_streams()
    code = run(arguments)
    interruption.ignore()
    sys.exit(code)


def run(arguments: list[str] | None = None) -> int:
    """Run the command line; every error becomes one line on stderr and an exit code.

    With --json, an error also prints one JSON object with `error` and `exit_code` on stdout, unless the
    command has printed a result before it failed.

    Args:
        arguments: the words of the command line; None: those of the process.

    Returns:
        The exit code.
    """
    words = sys.argv[1:] if arguments is None else arguments
    answer: dict[str, bool] = {}
    try:
        result: Any = cli.main(args=list(words), prog_name="alula", standalone_mode=False, obj=answer)
        sys.stdout.flush()
        return result if isinstance(result, int) else ExitCode.DONE
    except (ClosedPipeError, BrokenPipeError):
        discard_stdout()
        return ExitCode.BROKEN_PIPE
    except (KeyboardInterrupt, click.Abort) as error:
        advice = [str(e) for e in (error, error.__cause__) if isinstance(e, InterruptedWithAdvice)]
        message = "; ".join(["interrupted", *advice[:1]])
        return _fail(message, ExitCode.INTERRUPTED, [], answered=False)
    except Exception as error:  # noqa: BLE001  the last resort: users see no traceback without -vv
        if isinstance(error, OSError):
            discard_stdout()
        return _fail(*_worded(error), words, answered=bool(answer))


def _worded(error: Exception) -> tuple[str, ExitCode]:
    """Message of an error for the user, and its exit code."""
    match error:
        case AlulaError():
            return str(error), error.exit_code
        case click.UsageError():
            name = error.ctx.command_path if error.ctx else "alula"
            return f"{error.format_message().rstrip('.')} (see '{name} -h')", ExitCode.USAGE
        case click.ClickException():
            return error.format_message(), ExitCode.USAGE
        case ModuleNotFoundError(name=str(module)) if module.partition(".")[0] in EXTRAS:
            return str(missing(module.partition(".")[0])), ExitCode.USAGE
        case MemoryError():
            return "out of memory", ExitCode.INTERNAL
        case OSError(strerror=str(reason)):
            # Readers and writers of files raise AlulaErrors, so this error comes from stdout.
            where = os.fsdecode(error.filename) if error.filename else "cannot write the result"
            return f"{where}: {reason}", ExitCode.INPUT
    return f"internal error: {type(error).__name__}: {error} (-vv shows where)", ExitCode.INTERNAL


def _fail(message: str, code: ExitCode, words: list[str], *, answered: bool) -> int:
    """Print an error; call it in the block that caught the error, for the traceback of -vv."""
    options = words[: words.index("--")] if "--" in words else words
    line = " ".join(message.split())
    with suppress(OSError):
        if "-vv" in options or options.count("-v") + options.count("--verbose") >= 2:
            import traceback

            for text in traceback.format_exc().splitlines():
                echo(text, err=True)
        echo(f"alula: {line}", err=True)
    with suppress(OSError):
        if "--json" in options and not answered:
            print_json({"error": line, "exit_code": code})
    return code


if __name__ == "__main__":
    main()
