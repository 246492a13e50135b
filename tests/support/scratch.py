"""A copy of the Python sources that a test may change, and programs that import `alula` from it."""

import os
import shutil
import site
import subprocess
import sys
from pathlib import Path

from alula import _core
from support.paths import ROOT


class Scratch:
    """The tree in a folder of its own; `run` imports it, with the native module of this environment.

    The editable install finds `alula` in the checkout, so programs run without the `site` module.
    """

    def __init__(self, folder: Path) -> None:
        self.root = folder / "alula"
        self.root.mkdir()
        for name in ("cli", "stages", "schemas"):
            shutil.copytree(ROOT / name, self.root / name, ignore=shutil.ignore_patterns("__pycache__"))
        for file in (ROOT / "native/python/alula").iterdir():
            if file.is_file():
                shutil.copy(file, self.root)
        shutil.copy(_core.__file__, self.root)

    def write(self, path: str, text: str, after: str = "") -> None:
        """Write a file, or insert text after the first line that contains `after`.

        Where that line opens a bracket, the text goes behind the closing one, unless the line ends in `(`.
        """
        file = self.root / path
        if not after:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text)
            return
        lines = file.read_text().splitlines(keepends=True)
        at = next((i for i, line in enumerate(lines) if after in line), None)
        assert at is not None, f"{path} has no line with {after!r}"
        if not lines[at].rstrip().endswith("("):
            depth = lines[at].count("(") - lines[at].count(")")
            while depth > 0:
                at += 1
                depth += lines[at].count("(") - lines[at].count(")")
        lines.insert(at + 1, text)
        file.write_text("".join(lines))

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run Python with these words."""
        path = os.pathsep.join([str(self.root.parent), *site.getsitepackages()])
        return subprocess.run(
            [sys.executable, "-S", "-P", *words],
            env={**os.environ, "PYTHONPATH": path},
            capture_output=True,
            text=True,
        )

    def alula(self, *words: object) -> str:
        """Run a command; it must succeed."""
        done = self.run("-m", "alula.cli", *map(str, words))
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout
