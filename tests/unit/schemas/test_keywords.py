"""Keyword arguments of `import alula` are known to type checkers."""

import re
import subprocess
import sys

import pytest

from alula.schemas.generate import keyword_files
from support.paths import ROOT

SNIPPET = """
import numpy as np

import alula

scene = alula.align(alula.import_splat("room.ply", turn="x", crop=(0, 0, 0, 1, 1, 1)), scale=2.7, floor=True)
cover = alula.merge(alula.voxelize(scene, size_m=0.05, jobs=2), hulls=300, facet_cap="auto")
plan = alula.plan(cover, start=[0.5, 1.5, 1], goal=np.array([3.5, 1.5, 1]), via=[[1, 2, 3]])
alula.merge(cover, hulls="many")  # wrong: arg-type
alula.merge(cover, hull=3)  # wrong: call-arg
alula.voxelize(scene, size_m=None)  # wrong: arg-type
alula.import_splat("room.ply", turn="w")  # wrong: arg-type
alula.align(scene, origin=3)  # wrong: arg-type
alula.plan(cover, start="here", interface="sticks")  # wrong: arg-type
alula.view(cover, up="z")  # wrong: arg-type
"""


def test_the_types_of_keyword_arguments_are_generated():
    for name, text in keyword_files().items():
        assert (ROOT / name).read_text() == text, "run make schemas"


@pytest.mark.slow
@pytest.mark.process
def test_mypy_accepts_what_is_right_and_finds_what_is_wrong(tmp_path):
    pytest.importorskip("mypy")
    subprocess.run(["make", "-C", str(ROOT), "typing-view"], check=True, capture_output=True)
    (tmp_path / "snippet.py").write_text(SNIPPET)
    words = [sys.executable, "-P", "-m", "mypy", str(tmp_path / "snippet.py")]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)  # with what `make typecheck` kept
    found = re.findall(r"snippet.py:(\d+): error: .*\[([a-z-]+)\]$", done.stdout, re.MULTILINE)
    lines = enumerate(SNIPPET.splitlines(), 1)
    expected = {(str(i), line.rpartition(": ")[2]) for i, line in lines if "# wrong" in line}
    assert set(found) == expected, done.stdout + done.stderr
