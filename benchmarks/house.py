"""Size of this checkout: lines by folder, scenario keys, options of commands, and what a clone costs.

    python -P benchmarks/house.py [--time]

`--time` clones the checkout and times `make demo` and then `make test` in it, without ccache, with the size
of `.venv` after each. It takes some minutes, in which nothing else should run.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_ROOMS = ("cli", "stages", "schemas", "examples", "tests", "benchmarks", "native", "docs")
_KINDS = {"native": (".cpp", ".hpp", ".c", ".h"), "docs": (".md",)}


def lines(folder: Path, suffixes: tuple[str, ...] = (".py",)) -> int:
    """Lines of all committed files below a folder with one of the suffixes."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", str(folder)], cwd=ROOT, capture_output=True, text=True, check=True
    )
    files = [ROOT / name for name in listed.stdout.split("\0") if name.endswith(suffixes)]
    return sum(path.read_bytes().count(b"\n") for path in files if path.exists())


def sizes() -> list[tuple[str, int]]:
    """What can be counted in the checkout itself."""
    found = [(f"lines of {name}/", lines(Path(name), _KINDS.get(name, (".py",)))) for name in _ROOMS]
    found.append(("lines of Python in cli, stages and schemas", sum(count for _, count in found[:3])))
    inner = [path for name in _ROOMS[:3] for path in (ROOT / name).iterdir() if path.is_dir()]
    for path in sorted(inner):
        if count := lines(path.relative_to(ROOT)):
            found.append((f"  {path.relative_to(ROOT)}/", count))
    found.append(("lines of committed JSON", lines(Path(), (".json",))))
    return [*found, ("scenario keys", scenario_keys()), ("options of commands", options())]


def scenario_keys() -> int:
    """Number of the keys that a scenario can have."""
    from alula.schemas.scenarios.text import keys_of

    return len(keys_of())


def options() -> int:
    """Number of options of all commands, each with each name that it has once."""
    import click

    from alula.cli.main import cli

    context = click.Context(cli)
    found = [cli.get_command(context, name) for name in cli.list_commands(context)]
    return sum(isinstance(given, click.Option) for one in found if one is not None for given in one.params)


def _said(*words: str) -> str:
    return subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


def timed(folder: Path, *words: str, **environment: str) -> tuple[float, float]:
    """Run a command; seconds by the clock, and of the processors."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    done = subprocess.run(words, cwd=folder, env=os.environ | environment, capture_output=True, text=True)
    if done.returncode:
        sys.exit(
            f"{' '.join(words)} ended with {done.returncode}:\n{done.stdout[-2000:]}{done.stderr[-2000:]}"
        )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.monotonic() - begin, cpu


def costs() -> None:
    """Clone, and time what a new user does."""
    with tempfile.TemporaryDirectory() as scratch:
        clone = Path(scratch) / "alula"
        _said("git", "clone", "-q", str(ROOT), str(clone))
        for target in ("demo", "test"):
            clock_s, cpu_s = timed(clone, "make", target, CCACHE_DISABLE="1")
            size = int(_said("du", "-sm", str(clone / ".venv")).split()[0])
            print(
                f"make {target}: {clock_s:.0f} s, {cpu_s:.0f} s of processors; .venv then {size} MB",
                flush=True,
            )


def main() -> None:
    """Print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--time", action="store_true", help="also time a clone")
    given = parser.parse_args()
    for name, count in sizes():
        print(f"{name:<45}{count:>9,}")
    if given.time:
        costs()


if __name__ == "__main__":
    main()
