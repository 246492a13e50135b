"""The coverage benchmark runs, and its figures are those of a working estimator."""

import json
import subprocess
import sys

import pytest

from support.paths import ROOT


def run(*words):
    if not (ROOT / "benchmarks").is_dir():
        pytest.skip("not a checkout")
    pytest.importorskip("pycolmap")
    command = [sys.executable, "-P", str(ROOT / "benchmarks/alignment.py"), *words]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_study_runs_in_all_regimes():
    done = run("--seeds", "4", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert {row["way"] for row in found["rows"]} == {"positions", "poses", "drift"}
    assert len(found["rows"]) == 23
    for row in found["rows"]:
        assert 0.7 < row["sigma_ratio"] < 1.3 or row["way"] == "drift"
        assert 0.5 <= row["scale"] <= 1
    assert sum(row["scale"] for row in found["rows"]) / 23 > 0.8
    assert [entry["count"] for entry in found["speed"]] == [1_000, 10_000, 100_000]


def test_no_seeds_are_refused():
    done = run("--seeds", "0")
    assert done.returncode == 2
    assert "--seeds must be at least 1" in done.stderr
