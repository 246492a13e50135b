"""`alula`: the group of all commands, and the one place where errors become exit codes."""

from __future__ import annotations

import importlib
import os
import sys
from typing import Any

import click

from alula import __version__
from alula.schemas.errors import AlulaError, ExitCode

# name: (module, first line of its help); a test holds the lines against the commands.
COMMANDS: dict[str, tuple[str, str]] = {
    "demo-scene": ("demo_scene", "Write the built-in scene: a furnished room with hoops."),
    "import-splat": ("import_splat", "Read a Gaussian splat file into a scene."),
    "scale-align": ("scale_align", "Give a scene metric scale and a named world frame."),
    "voxelize": ("voxelize", "Mark every voxel that an obstacle touches."),
    "merge": ("merge", "Cover voxels with convex polytopes, as few as asked."),
    "verify": ("verify", "Prove again that a cover contains every obstacle."),
    "plan": ("plan", "Find a smooth collision-free trajectory through a cover."),
    "simulate": ("simulate", "Fly start-goal pairs or a plan behind a safety filter."),
    "report": ("report", "Turn runs into tables, figures and one HTML page."),
    "export": ("export", "Convert a cover or a scene for other programs."),
    "info": ("info", "Explain an artifact or a splat file."),
    "doctor": ("doctor", "Check that everything alula needs is there."),
}


class LazyGroup(click.Group):
    """A group whose commands are imported only when they run."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """All commands, in the order of the pipeline."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import the module of one command."""
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"alula.cli.{COMMANDS[cmd_name][0]}")
        command: click.Command = module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Exit codes: 0 done, 1 internal error, 2 wrong usage, 3 bad input, 4 a check does not hold, "
    "5 infeasible, 6 link or vehicle, 130 interrupted, 141 broken pipe.",
)
@click.version_option(__version__, prog_name="alula")
def cli() -> None:
    """From a Gaussian splat to a safe flight."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with the documented code."""
    from alula.cli.interruption import Interruption
    from alula.schemas import atomic

    # One thread: the sums of linear algebra must not depend on the machine, and idle ones cost.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    interruption = Interruption()
    interruption.install()
    atomic.appearing = interruption.appearing
    code = run(arguments)
    interruption.ignore()
    sys.exit(code)


def run(arguments: list[str] | None = None) -> int:
    """Run the command line; every error becomes one line on stderr and a code."""
    words = sys.argv[1:] if arguments is None else arguments
    try:
        result: Any = cli.main(args=words, prog_name="alula", standalone_mode=False)
        sys.stdout.flush()
        return result if isinstance(result, int) else ExitCode.DONE
    except AlulaError as error:
        return _fail(str(error), error.exit_code, words)
    except click.UsageError as error:
        hint = f" (see 'alula {error.ctx.info_name} -h')" if error.ctx and error.ctx.parent else ""
        return _fail(error.format_message() + hint, ExitCode.USAGE, words)
    except click.ClickException as error:
        return _fail(error.format_message(), ExitCode.USAGE, words)
    except (KeyboardInterrupt, click.Abort):
        return _fail("interrupted", ExitCode.INTERRUPTED, [])
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return ExitCode.BROKEN_PIPE
    except MemoryError:
        return _fail("out of memory", ExitCode.INTERNAL, words)
    except Exception as error:  # noqa: BLE001  the last resort: no traceback reaches a user unasked
        return _fail(
            f"internal error: {type(error).__name__}: {error} (-vv shows where)", ExitCode.INTERNAL, words
        )


def _fail(message: str, code: ExitCode, words: list[str]) -> int:
    if "-vv" in words or words.count("-v") + words.count("--verbose") >= 2:
        import traceback

        traceback.print_exc()
    line = " ".join(message.split())
    click.echo(f"alula: {line}", err=True)
    return code


if __name__ == "__main__":
    main()
