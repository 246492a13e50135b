"""The benchmark of the formats runs, and our readers agree with others; times are not tested."""

import json
import math
import os
import subprocess
import sys

import pytest

from support.paths import ROOT

FIGURES = ("gaussians_per_s", "imported_per_s", "read_over_bytes", "import_over_bytes", "megabytes", "read_s")


@pytest.fixture(scope="module")
def quick_run(tmp_path_factory):
    if not (ROOT / "benchmarks").is_dir():
        pytest.skip("not a checkout")
    folder = tmp_path_factory.mktemp("bench")
    command = [sys.executable, "-P", ROOT / "benchmarks/formats.py", "--quick", "--rows", "3000"]
    command += ["--json", folder / "figures.json", "--markdown", folder / "page.md"]
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr == ""
    page = (folder / "page.md").read_text()
    assert page.endswith(done.stdout)
    return page, json.loads((folder / "figures.json").read_text())


def test_every_large_file_is_read_whole_and_its_figures_are_numbers(quick_run):
    _, document = quick_run
    timed = document["speed"]
    assert {row["format"] for row in timed} >= {"ply", "splat"}
    for row in timed:
        assert row["gaussians"] > 0
        for name in FIGURES:
            assert math.isfinite(row[name]), row
            assert row[name] > 0, row
        assert (row["oracle_s"] is None) == (row["oracle"] == "")
        assert row["import_over_bytes"] > row["read_over_bytes"]
    assert all(row["peak_over_kept"] > 0 for row in timed if row["format"] == "ply")


def test_readers_agree_where_there_are_files(quick_run):
    _, document = quick_run
    rows = document["agreement"]
    assert {row["format"] for row in rows} >= {"ply", "splat"}
    for row in rows:
        assert row["agrees"], row
        assert row["compared"] + len(row["unread"]) == (row["files"] if row["oracle"] else 0)
        assert (row["differences"] == {}) == (row["compared"] == 0)
        assert all(0 <= value < 1 for value in row["differences"].values())
    if os.environ.get("ALULA_DATA"):
        assert sum(row["files"] for row in rows) > 10


def test_both_tables_have_a_line_for_each_row(quick_run):
    page, document = quick_run
    tables = [block.splitlines() for block in page.split("\n\n") if block.startswith("|")]
    assert [len(lines) - 2 for lines in tables] == [len(document["agreement"]), len(document["speed"])]
    for lines in tables:
        assert len({line.count(" | ") for line in lines}) == 1


def in_benchmarks(code):
    if not (ROOT / "benchmarks").is_dir():
        pytest.skip("not a checkout")
    code = "import sys; sys.path.append(sys.argv[1])\n" + code
    subprocess.run([sys.executable, "-P", "-c", code, str(ROOT / "benchmarks")], check=True)


def test_differences_are_measured_and_a_half_turn_is_found():
    in_benchmarks("""
import numpy as np
from oracles import differences
from alula.schemas.parameters.configs.demo_scene import DemoSceneConfig
from alula.stages.reconstruction.demo_scene import demo_scene
from alula.stages.reconstruction.import_splat import turned
ours = demo_scene(DemoSceneConfig(gaussians=2000), 0)
other = turned(ours, "x")
assert differences(ours, (ours.mean, ours.scale, ours.quat_wxyz, ours.opacity)) == (
    dict.fromkeys(("mean", "scale", "rotation", "opacity"), 0.0), "none")
mean, scale, opacity = other.mean.copy(), other.scale.copy(), other.opacity.copy()
mean[3, 1] += 0.5
scale[5, 2] *= 2
opacity[7] = opacity[7] / 2
# A turn by 0.1 rad about z; the sign of a quaternion means nothing.
w, x, y, z = other.quat_wxyz.astype(np.float64).T
spin = np.stack([-z, y, -x, w], axis=1)
quat = -(np.cos(0.05) * other.quat_wxyz + np.sin(0.05) * spin)
found, turn = differences(ours, (mean, scale, quat, opacity))
assert turn == "x"
assert abs(found["mean"] - 0.5 / np.abs(mean).max()) < 1e-6, found
assert abs(found["scale"] - 0.5) < 1e-6 and abs(found["rotation"] - 0.1) < 1e-6, found
assert abs(found["opacity"] - opacity[7]) < 1e-6, found
try:
    differences(ours, (mean[1:], scale[1:], quat[1:], opacity[1:]))
except ValueError as error:
    assert "1999 rows, not 2000" in str(error)
else:
    raise AssertionError
""")
