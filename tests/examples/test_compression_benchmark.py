"""The compression benchmark runs, covers all voxels, and two measures agree; times are not tested."""

import json
import math
import subprocess
import sys

import pytest

from support.paths import ROOT

NUMBERS = (
    "ours_cpu_s", "uncovered_voxels", "union_ratio_ours", "union_ratio_paper", "hulls", "hulls_paper",
    "half_planes_ours", "half_planes_paper", "bytes_per_half_plane",
)  # fmt: skip
OF_COACD = ("coacd_cpu_s", "coacd_over_ours", "union_ratio_coacd", "hulls_coacd")


@pytest.fixture(scope="module")
def tiny_run(tmp_path_factory):
    if not (ROOT / "benchmarks").is_dir():
        pytest.skip("not a checkout")
    page = tmp_path_factory.mktemp("bench") / "page.md"
    command = [sys.executable, ROOT / "benchmarks/compression.py", "--tiny", "--json", "--markdown", page]
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr == ""
    return json.loads(done.stdout), page.read_text()


def rows(document):
    (scene,) = document["scenes"]
    return scene["tools"]


def coacd_ran(document):
    return not rows(document)["coacd"]["note"]


def test_the_figures_that_others_rely_on_are_numbers(tiny_run):
    document, _ = tiny_run
    for name in NUMBERS + (OF_COACD if coacd_ran(document) else ()):
        assert isinstance(document[name], int | float), name
        assert math.isfinite(document[name]), name


def test_our_covers_leave_out_no_voxel_and_have_as_many_hulls_as_the_others(tiny_run):
    document, _ = tiny_run
    assert document["uncovered_voxels"] == 0
    for name in ("ours", "paper", "ours_planes"):
        row = rows(document)[name]
        assert row["note"] == ""
        assert row["voxels_outside_every_hull"] == row["voxels_with_gap"] == 0
        assert row["uncovered_volume"] < 1e-12
        assert row["union_ratio"] >= 1
    assert document["hulls"] == document["hulls_paper"]
    if coacd_ran(document):
        assert document["hulls"] == document["hulls_coacd"]
    planes = rows(document)["ours_planes"]["half_planes"]
    assert planes <= document["half_planes_paper"]


def test_volumes_agree_with_those_along_random_lines(tiny_run):
    document, _ = tiny_run
    for row in rows(document).values():
        assert row["note"] or row["agrees"], row
    stated = rows(document)["ours"]
    assert stated["union_ratio_stated"] == pytest.approx(stated["union_ratio"], rel=0.01)


def test_every_size_of_the_garden_ends_in_a_verified_cover(tiny_run):
    document, _ = tiny_run
    assert [row["gaussians"] for row in document["growth"]] == [4_000, 8_000]
    for row in document["growth"]:
        assert row["note"] == row["paper_note"] == ""
        assert row["covered"] is True
        assert 0 < row["hulls"] <= row["hulls_asked"]
    assert document["growth"][0]["voxels"] < document["growth"][1]["voxels"]
    assert document["exponents"]["n_log_n"] > 1


def test_the_page_has_a_line_for_each_row_and_target(tiny_run):
    document, page = tiny_run
    assert page.startswith("# ")
    for row in rows(document).values():
        assert f"| {row['title']} | " in page
    for target in document["targets"]:
        assert f"| {target['text']} | " in page
    assert f"may use\n**{document['limit_s']:g} s of CPU**" in page
    tables = [block.splitlines() for block in page.split("\n\n") if block.startswith("|")]
    assert len(tables) >= 4
    for lines in tables:
        assert len({line.count(" | ") for line in (lines[0], *lines[2:])}) == 1


def test_coacd_gets_the_surface_of_the_density_and_that_of_the_voxels(tiny_run):
    document, _ = tiny_run
    on_voxels, on_surface = rows(document)["coacd"], rows(document)["coacd_surface"]
    if note := on_voxels["note"] or on_surface["note"]:
        assert "is not installed" in note or note.startswith("over "), note
        pytest.skip(f"CoACD: {note}")
    assert on_surface["triangles"] != on_voxels["triangles"]
    assert rows(document)["ours_surface"]["hulls"] == on_surface["hulls"]


def test_the_full_run_gives_each_tool_both_meshes_and_all_modes():
    in_benchmarks("""
import sys as system
system.path.sort(key=system.argv[1].__eq__)
from compression import FULL, PEERS
modes = {PEERS[key][3].get("fillMode") for key in FULL.peers if PEERS[key][1] == "vhacd"}
assert modes == {"flood", "raycast", "surface"}, modes
for tool in ("coacd", "vhacd"):
    assert {PEERS[key][2] for key in FULL.peers if PEERS[key][1] == tool} == {False, True}
assert FULL.limit_s >= 300
""")


def test_kept_rows_are_not_measured_again(tmp_path):
    in_benchmarks(
        """
import sys as system
system.path.sort(key=system.argv[1].__eq__)
from pathlib import Path
import compression
kept = compression.Kept(Path(system.argv[2]) / "rows", 10.0)
made = []
for count in (5, 5, 6):
    row = kept.row("a/b.c d", count, lambda: made.append(count) or {"hulls": count})
    assert row == {"hulls": count}
assert made == [5, 6]
assert compression.Kept(Path(system.argv[2]) / "rows", 20.0).row("a/b.c d", 6, dict) == {}
""",
        tmp_path,
    )


def in_benchmarks(code, *arguments):
    if not (ROOT / "benchmarks").is_dir():
        pytest.skip("not a checkout")
    code = "import sys; sys.path.append(sys.argv[1])\n" + code
    command = [sys.executable, "-P", "-c", code, str(ROOT / "benchmarks"), *map(str, arguments)]
    subprocess.run(command, check=True)


def test_a_tool_that_is_absent_slow_or_fails_is_a_row_that_says_so(tmp_path):
    in_benchmarks(
        """
import json
from pathlib import Path
import scenes, tools
from alula.schemas.artifacts.artifact import write_artifact
folder = Path(sys.argv[2])
voxels, answer = folder / "hoop.voxels.npz", folder / "answer.json"
write_artifact(voxels, scenes.voxels_of(scenes.hoops(1, 5000), 0.1))
slow = tools.run_tool("merge", voxels, 60.0, wall_s=0.0, hulls=3)
assert slow.note == "over 0 s" and slow.figures["cpu_s"] >= 0
(folder / "burn.py").write_text("while True: pass")
tools.HERE = str(folder)
burnt = tools.run_child("burn", {}, 1.0)
assert burnt.note == "over 1 s of CPU" and 0.9 < burnt.figures["cpu_s"] < 5, burnt
tools.HERE = sys.argv[1]
wrong = tools.run_tool("merge", voxels, 60.0, hulls=-3)
assert wrong.note.startswith("failed: ") and "--hulls" in wrong.note, wrong
sys.modules["coacd"] = None
asked = folder / "asked.json"
given = {"tool": "coacd", "voxels": str(voxels), "output": str(folder / "solids.npz")}
given |= {"options": {}, "mesh": None}
asked.write_text(json.dumps(given))
tools.child([str(asked), str(answer)])
assert json.loads(answer.read_text()) == {"note": "coacd is not installed"}
""",
        tmp_path,
    )


def test_meshes_measure_like_covers_of_the_same_polytopes():
    in_benchmarks("""
import numpy as np
from solids import Solids, measure, measure_along_lines, outside_every_hull
cube = np.array(np.meshgrid([0.0, 2.0], [0.0, 1.0], [0.0, 1.0])).reshape(3, -1).T
voxels = np.array([[0, 0, 0], [1, 0, 0], [3, 0, 0]], np.int32)
for solids in (Solids.from_points([cube, cube + [0.5, 0, 0]]), Solids.from_points([cube, cube * [1, 1, 0]])):
    assert solids.plane_start[1] == 6
    wide = 2.5 if len(solids) == 2 else 2.0
    for found in (measure(solids, voxels), measure_along_lines(solids, voxels)):
        assert abs(found.union_ratio - wide / 3) < max(1e-9, 8 * found.error), found
        assert abs(found.uncovered_volume - 1 / 3) < 1e-9 + 8 * found.error, found
        assert found.voxels_with_gap == 1
    assert outside_every_hull(solids, voxels) == 1
    assert len(solids) + solids.flat == 2
""")
