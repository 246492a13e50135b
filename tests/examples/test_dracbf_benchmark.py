"""A short run of the benchmark of the filters among moving obstacles has all figures."""

import json
import subprocess
import sys

import pytest

from support.paths import ROOT

SCRIPT = ROOT / "benchmarks/dracbf.py"
ASKED = (
    *("tick_p50_us", "general_qp_tick_p50_us", "mpc_tick_p50_us", "rp_cbf_tick_p50_us", "cbf_qp_tick_p50_us"),
    *("tick_100_obstacles_p50_us", "trials_per_s_1_worker", "trials_per_s_2_workers", "success_pct"),
    *("exact_projection_us", "gs_projection_us", "general_qp_projection_us"),
)


def test_one_json_object_has_every_figure(tmp_path):
    if not SCRIPT.is_file():
        pytest.skip("not a checkout")
    few = ["--recorded", "2", "--repeats", "1", "--projections", "5", "--trials", "4", "--rounds", "2"]
    words = [sys.executable, "-P", str(SCRIPT), "--quick", *few, "--tick-seconds", "3"]
    markdown = tmp_path / "found.md"
    done = subprocess.run(
        [*words, "--json", "--markdown", str(markdown)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert all(found[name] > 0 for name in ASKED)
    assert found["active_ticks"] > 50
    assert found["trials"] == 8
    assert found["success_pct"] >= found["success_run_pct"]
    assert found["ratios"]["tick_over_mpc"] == found["tick_p50_us"] / found["mpc_tick_p50_us"]
    assert "| mpc | " in markdown.read_text()
