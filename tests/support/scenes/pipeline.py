"""A tiny scene taken through the whole pipeline, once per session."""

from pathlib import Path

import numpy as np
import pytest

from alula.cli.main import run
from support.paths import VEHICLES

FASTBRIDGE = VEHICLES / "fastbridge.toml"
COLUMNS = (
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
)


def write_tiny_splat(path: Path) -> None:
    """Two walls, 4 m x 2 m, 3 m apart: 800 Gaussians in an INRIA .ply."""
    rng = np.random.default_rng(7)
    count = 800
    rows = np.zeros(count, [(name, "<f4") for name in COLUMNS])
    rows["x"] = rng.uniform(0, 4, count)
    rows["y"] = np.where(np.arange(count) % 2, 0.0, 3.0)
    rows["z"] = rng.uniform(0, 2, count)
    rows["opacity"] = 3.0
    for axis in range(3):
        rows[f"scale_{axis}"] = np.log(rng.uniform(0.01, 0.06, count))
        rows[f"rot_{axis + 1}"] = rng.normal(size=count)
    rows["rot_0"] = 1.0
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    header += [f"property float {name}" for name in COLUMNS] + ["end_header", ""]
    path.write_bytes("\n".join(header).encode() + rows.tobytes())


# Two cameras at the ends of the walls that look at each other.
CAMERAS = """image,x,y,z,qw,qx,qy,qz,width,height,fx,fy,cx,cy
a.jpg,0.3,1.5,1,0.5,-0.5,0.5,-0.5,200,200,100,100,100,100
b.jpg,3.7,1.5,1,0.5,-0.5,-0.5,0.5,200,200,100,100,100,100
"""


@pytest.fixture(scope="session")
def pipeline(tmp_path_factory) -> Path:
    """A folder with one file of every kind, each made by its command."""
    folder = tmp_path_factory.mktemp("pipeline")
    write_pipeline(folder)
    return folder


def write_pipeline(folder: Path) -> None:
    """Make one file of every kind, each by its command."""
    write_tiny_splat(folder / "tiny.ply")
    pairs = [
        (x, y, z, 2 * x + 1, 2 * y, 2 * z)
        for x, y, z in [(0, 0, 0), (1, 0, 0), (0, 2, 0), (0, 0, 3), (1, 1, 1)]
    ]
    (folder / "pairs.csv").write_text(
        "sx,sy,sz,wx,wy,wz\n" + "".join(",".join(map(str, p)) + "\n" for p in pairs)
    )
    (folder / "cameras.csv").write_text(CAMERAS)
    (folder / "tiny.toml").write_text(SCENARIO)
    (folder / "tiny.vehicle.toml").write_bytes(FASTBRIDGE.read_bytes())
    f = lambda name: str(folder / name)  # noqa: E731
    steps = [
        ["import-splat", f("tiny.ply"), "-o", f("tiny.scene.npz")],
        ["scale-align", f("tiny.scene.npz"), "-o", f("tiny.metric.scene.npz"), "--scale", "1"],
        ["voxelize", f("tiny.metric.scene.npz"), "-o", f("tiny.voxels.npz"), "--size", "0.2"],
        [
            *("observe", f("tiny.metric.scene.npz"), "-o", f("tiny.seen.npz"), "--radius", "0.15"),
            *("--voxels", f("tiny.voxels.npz"), "--cameras", f("cameras.csv")),
        ],
        ["export", f("tiny.voxels.npz"), "-o", f("tiny.bt")],
        ["merge", f("tiny.voxels.npz"), "-o", f("tiny.cover.npz"), "--hulls", "12"],
        ["verify", f("tiny.cover.npz"), "--voxels", f("tiny.voxels.npz"), "-o", f("tiny.certificate.json")],
        ["export", f("tiny.cover.npz"), "-o", f("tiny.map.bin")],
        [
            "plan",
            f("tiny.cover.npz"),
            "-o",
            f("tiny.plan.npz"),
            "--start",
            "0.5 1.5 1",
            "--goal",
            "3.5 1.5 1",
        ],
        ["simulate", f("tiny.plan.npz"), "--map", f("tiny.cover.npz"), "-o", f("tiny.run.mcap")],
        ["report", f("tiny.run.mcap"), "-o", f("tiny.report.html")],
    ]
    for step in steps:
        assert run([*step, "-q"]) == 0, step


SCENARIO = """
schema = "alula/scenario"
version = "2.0"
[vehicle]
type = "single-integrator"
radius_m = 0.1
max_speed_m_s = 1.0
[world]
cover = "tiny.cover.npz"
[safety]
filters = ["polytope-cbf"]
[rules]
trials = 3
logged = 3
"""
