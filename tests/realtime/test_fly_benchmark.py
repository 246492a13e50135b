"""The benchmark of real-time flights runs, arrives and touches nothing; no time is tested."""

import json
import math
import subprocess
import sys

import pytest

from support.paths import ROOT

SMALL = "--quick --gaussians 15000 --speeds 2"


@pytest.fixture(scope="module")
def small_run(tmp_path_factory):
    if not (ROOT / "benchmarks").is_dir():
        pytest.skip("not a checkout")
    page = tmp_path_factory.mktemp("bench") / "page.md"
    command = [sys.executable, "-P", str(ROOT / "benchmarks/fly.py"), *SMALL.split(), "--json"]
    done = subprocess.run([*command, "--markdown", str(page)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout), page.read_text()


@pytest.mark.slow
def test_both_filters_arrive_and_keep_clear(small_run):
    found, _ = small_run
    assert found["reached"] is True
    assert found["min_clearance_m"] > 0
    assert [flight["filter"] for flight in found["flights"]] == ["cone-backup", "polytope-cbf"]
    for flight in found["flights"]:
        assert flight["supervisor"][-1] == "disarmed: done"
        assert flight["filtered_ticks"] > 100
        assert 0 < flight["feasible_ticks"] <= flight["filtered_ticks"] < flight["ticks"]


@pytest.mark.slow
def test_every_figure_is_a_number(small_run):
    found, page = small_run
    texts = {"machine", "python", "flights"}
    figures = [value for name, value in found.items() if name not in texts]
    assert all(math.isfinite(value) and value >= 0 for value in figures), found
    for name in ("rate_hz", "tick_p99_ms", "lateness_p99_ms", "overruns"):
        assert name in found
    assert found["ticks"] == sum(flight["ticks"] for flight in found["flights"])
    assert "{" not in page
    assert page.count("\n| ") == 4 + 1  # heads, line, flights, published
