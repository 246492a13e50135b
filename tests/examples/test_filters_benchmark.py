"""The benchmark of the filters runs, every figure is a number, and all checks pass; times are not tested."""

import json
import math
import subprocess
import sys

import pytest

from support.paths import ROOT

SMALL = (
    "--quick --splats 20000 --pairs 1 --repeats 2 --qp-problems 200 --qp-seconds 600 --brute-seconds 0.1 "
    "--cbfpy-ticks 5"
)
FLOWN = (
    *("cone_di", "cone_ecbf", "cone_backup", "cone_backup_hover"),
    *("safer_splat", "safer_splat_gated", "safer_splat_same_gate"),
)
EVERY_ELLIPSOID = ("safer_splat", "safer_splat_brute", "safer_splat_published")  # the others have a gate
OPTIONAL = ("cbfpy", "daqp", "quadprog")


@pytest.fixture(scope="module")
def small_run(tmp_path_factory):
    if not (ROOT / "benchmarks").is_dir():
        pytest.skip("not a checkout")
    page = tmp_path_factory.mktemp("bench") / "page.md"
    command = [sys.executable, "-P", str(ROOT / "benchmarks/filters.py"), *SMALL.split(), "--json"]
    done = subprocess.run([*command, "--markdown", str(page)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout), page.read_text()


def test_nothing_is_wrong(small_run):
    found, _ = small_run
    for name in ("qp_wrong", "qp_infeasible_missed", "repeats_that_differ", "safer_splat_brute_differ"):
        assert found[name] == 0, name
    assert found["qp_problems"] == 200
    assert found["qp_infeasible"] > 0
    assert 15_000 < found["splats"] < 20_000


def test_every_figure_is_a_number(small_run):
    found, _ = small_run
    texts = {"machine", "python", "ratios"}
    missing = {name for name, value in found.items() if value is None}
    assert {name.split("_")[0] for name in missing} <= set(OPTIONAL)
    figures = [value for name, value in found.items() if name not in texts | missing]
    assert all(math.isfinite(value) and value >= 0 for value in figures), found
    assert all(value is None or 0 < value < math.inf for value in found["ratios"].values())


def test_no_ratio_compares_a_row_for_every_ellipsoid_with_rows_within_a_gate(monkeypatch):
    if not (ROOT / "benchmarks").is_dir():
        pytest.skip("not a checkout")
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import filters

    every = [f"{name}_p50_us" for name in EVERY_ELLIPSOID]
    for name, figures in filters._RATIOS.items():
        if any("safer" in figure for figure in figures):
            assert len({figure in every for figure in figures}) == 1, name


def test_a_figure_of_a_filter_is_of_all_its_ticks(small_run):
    found, _ = small_run
    for name in FLOWN:
        assert found[f"{name}_flights"] == 1
        assert found[f"{name}_ticks"] > 50
        for kind in (name, f"{name}_tick"):
            for suffix in ("", "_best"):
                p50, p99, most = (found[f"{kind}_{part}{suffix}_us"] for part in ("p50", "p99", "max"))
                assert 0 < p50 <= p99 <= most
            assert found[f"{kind}_max_best_us"] <= found[f"{kind}_max_us"]
    assert found["safer_splat_brute_ticks"] >= 20


def test_the_page_has_every_filter_and_no_gap(small_run):
    found, page = small_run
    for name in ("cone-di", "cone-ecbf", "cone-backup", "cone-backup, policy=hover", "safer-splat"):
        assert f"| {name} | " in page
    assert f"{found['splats']:,} Gaussians" in page
    assert "{" not in page
