"""A function in a process of its own: its result, and what happens where the process gives none."""

import math
import os
import subprocess
import sys
from pathlib import Path

import pytest

from alula.stages.beside import in_process

pytestmark = pytest.mark.process


def end_or_say(parent):
    """End at once, except in one process."""
    if os.getpid() != parent:
        os._exit(9)
    return "here"


def test_the_result_comes_from_another_process():
    with in_process(os.getppid) as result:
        assert result() == os.getpid()


def test_without_a_result_the_function_is_called_here(monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path, str(Path(__file__).parent)])
    with in_process(end_or_say, os.getpid()) as result:
        assert result() == "here"
    with in_process(math.sqrt, -1.0) as result, pytest.raises(ValueError, match="math domain"):
        result()


def test_a_script_without_a_guard_is_not_run_again(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import os\nfrom alula.stages.beside import in_process\nprint('once')\n"
        "with in_process(os.getppid) as result:\n    print(result() == os.getpid())\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("once\nTrue\n", "")


def test_a_result_that_nobody_asks_for_ends_with_its_context():
    with in_process(range, 3):
        pass
