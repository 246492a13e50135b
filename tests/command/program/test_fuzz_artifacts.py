"""Two hundred mutants of the fuzzer, the same ones every time; `make fuzz` runs 20,000."""

import os
import subprocess
import sys

import pytest

from support.paths import ROOT


@pytest.mark.slow
def test_mutated_artifacts_are_read_or_refused_by_every_command(tmp_path):
    fuzzer = ROOT / "tests" / "support" / "fuzz" / "fuzz_artifacts.py"
    words = [sys.executable, "-P", str(fuzzer), "--most", "200", "--jobs", "2", "--keep", str(tmp_path)]
    environment = {key: value for key, value in os.environ.items() if key != "ALULA_DATA"}
    done = subprocess.run(words, capture_output=True, text=True, env=environment)
    failures = [path.read_text() for path in sorted(tmp_path.glob("*/WHY"))]
    assert failures == []
    assert done.returncode == 0, done.stderr[-3000:]
    ends = {line.strip().partition("  ")[2]: int(line.split()[0]) for line in done.stdout.splitlines()}
    assert sum(ends.values()) == 200
    assert ends["exit 0"] > 30  # mutants that reach the commands' own work
    assert ends["exit 3"] > 40
