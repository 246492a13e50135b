"""The benchmarks run, and every pair that they compare gives the same answer; times are not tested."""

import json
import math
import subprocess
import sys

import pytest

from support.paths import ROOT

SUBJECTS = {
    "import-splat": 1,
    "voxelize": 3,
    "merge": 5,
    "verify": 1,
    "polytope-cbf": 2,
    "clearance": 1,
}


@pytest.fixture(scope="module")
def quick_run(tmp_path_factory):
    if not (ROOT / "benchmarks").is_dir():
        pytest.skip("not a checkout")
    figures = tmp_path_factory.mktemp("bench") / "figures.json"
    command = [sys.executable, "-P", ROOT / "benchmarks/pipeline.py", "--quick", "--json", figures]
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr == ""
    return done.stdout, json.loads(figures.read_text())


def test_every_pair_agrees_and_every_figure_is_a_positive_number(quick_run):
    _, document = quick_run
    assert document["quick"] is True
    for row in document["rows"]:
        assert row["agrees"], row
        low, high = row["spread"]
        figures = [row["ours"], row["reference"], row["ratio"], low, high, *row["detail"].values()]
        assert all(math.isfinite(figure) and figure >= 0 for figure in figures), row
        assert low <= row["ratio"] <= high
        if row["runs"] == 1:
            assert row["ratio"] == row["ours"] / row["reference"]


def test_every_stage_has_its_rows(quick_run):
    _, document = quick_run
    stages = [row["subject"].split()[0].rstrip(",") for row in document["rows"]]
    assert {stage: stages.count(stage) for stage in stages} == SUBJECTS


def test_what_does_not_depend_on_the_machine_is_in_our_favour(quick_run):
    _, document = quick_run
    counted = {row["subject"]: row["ratio"] for row in document["rows"] if row["unit"] in ("voxels", "of V+")}
    assert len(counted) == 2
    assert all(ratio < 1 for ratio in counted.values()), counted


def test_the_table_has_a_line_for_each_row(quick_run):
    table, document = quick_run
    lines = table.splitlines()
    assert len(lines) == 2 + len(document["rows"])
    assert len({line.count(" | ") for line in (lines[0], *lines[2:])}) == 1
    for line, row in zip(lines[2:], document["rows"], strict=True):
        assert row["subject"] in line
        assert row["check"] in line
