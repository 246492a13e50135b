"""Every readable real scene, from the splat to judged flights."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from alula.cli.main import run
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.log.run import read_run
from support.paths import ROOT

# file: metres per unit where nothing better is known, voxel size [m], hulls, extra options of the import
SCENES = {
    "istanbul-outdoor/tile_x000_y003.splat": (1.0, 0.5, 200, ()),
    "istanbul-outdoor/tile_x001_y000.splat": (1.0, 0.5, 200, ()),
    "istanbul-outdoor/tile_x001_y001.splat": (1.0, 0.5, 200, ()),
    "cc0-corpus/leica-sofort-top8192.ply": (1.0, 0.3, 150, ("--drop-floaters",)),
    "inria-ply/train-1000.ply": (1.0, 0.2, 50, ()),
    "tiny-conformance/splatapult-axes-test.ply": (1.0, 0.1, 8, ("--min-opacity", "0")),
    "tiny-conformance/test-splat.3-points-from-train.ply": (1.0, 0.05, 3, ("--min-opacity", "0")),
    "tiny-conformance/test-splat.3-points-from-train.splat": (1.0, 0.05, 3, ("--min-opacity", "0")),
    "tiny-conformance/splat-transform-minimal.splat": (1.0, 0.1, 4, ("--min-opacity", "0")),
    "tiny-conformance/gsplat-rs-minimal_binary.ply": (1.0, 0.1, 4, ("--min-opacity", "0")),
    "tiny-conformance/gsplat-rs-minimal_ascii.ply": (1.0, 0.1, 4, ("--min-opacity", "0")),
    "tiny-conformance/epfl-pc_short-trailing-bytes.ply": (1.0, 0.1, 20, ("--min-opacity", "0")),
    "usd3dgs-fixtures-ply/three-gaussian-binary-le.ply": (1.0, 0.5, 3, ("--min-opacity", "0")),
}


@pytest.mark.parametrize("file", SCENES)
def test_a_real_scene_is_covered_and_flown_without_collision(file, data, tmp_path, monkeypatch, capsys):
    scale, size, hulls, options = SCENES[file]
    monkeypatch.chdir(tmp_path)
    steps = [
        ["import-splat", str(data / file), "-o", "s.scene.npz", *options],
        ["scale-align", "s.scene.npz", "-o", "m.scene.npz", "--scale", str(scale)],
        ["voxelize", "m.scene.npz", "-o", "v.voxels.npz", "--size", str(size)],
        ["merge", "v.voxels.npz", "-o", "c.cover.npz", "--hulls", str(hulls)],
        ["verify", "c.cover.npz", "--voxels", "v.voxels.npz", "--scene", "m.scene.npz", "-o", "cert.json"],
        [
            "simulate",
            "c.cover.npz",
            "--scene",
            "m.scene.npz",
            "-o",
            "r.run.mcap",
            "--trials",
            "10",
            "--set",
            "mission.beyond_map_m=2",
            "--set",
        ],
        ["report", "r.run.mcap", "--cover", "c.cover.npz", "--certificate", "cert.json", "-o", "r.html"],
    ]
    steps[5].append(bounds_around(steps, tmp_path))
    for step in steps[4:]:
        assert run([*step, "-q"]) == 0, (step, capsys.readouterr().err)
    certificate = json.loads(Path("cert.json").read_text())
    assert certificate["covered"] is True
    assert len(certificate["checks"]) == 7
    record = read_run(Path("r.run.mcap"))
    assert record.summary["collisions"] == 0
    assert record.summary["min_scene_clearance_m"] > 0
    assert record.summary["trials"] == 10


def bounds_around(steps: list[list[str]], folder: Path) -> str:
    """Make the cover, and find a box with room around it to fly in."""
    for step in steps[:4]:
        assert run([*step, "-q"]) == 0, step
    cover = read_artifact(folder / "c.cover.npz")
    vertices = cover["vertex"] * cover.manifest.voxel_size_m
    box = (*(vertices.min(axis=0) - 1.0), *(vertices.max(axis=0) + 1.0))
    return f"mission.bounds_m={','.join(map(str, box))}"


@pytest.mark.slow
def test_the_pictures_of_a_flight_through_a_real_splat_are_made(data, tmp_path):
    folder = shutil.copytree(
        ROOT / "examples/real-splat", tmp_path / "real-splat", ignore=shutil.ignore_patterns("out")
    )
    words = [f"ALULA={sys.executable} -P -m alula.cli", f"ALULA_DATA={data}", "SIZE=96x64", "STILL=96x72"]
    done = subprocess.run(["make", "-C", str(folder), *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr + done.stdout
    (flight,) = read_run(folder / "out/house.run.mcap").trials
    assert flight.outcome == "reached"
    assert flight.map_clearance_m > 0.1
    for name, size, most in (("flight.webp", (96, 64), 100), ("flight.png", (96, 72), 1)):
        with Image.open(folder / "out" / name) as image:
            assert image.size == size
            assert most / 2 < getattr(image, "n_frames", 1) <= most
