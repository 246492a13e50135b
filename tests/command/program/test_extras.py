"""Commands without the packages that they need: one line says what to install, exit code 2, no output."""

import subprocess
import sys
import tomllib

import pytest

from alula.schemas.extras import EXTRAS
from support.paths import ROOT

HIDE = """
import sys
from importlib.machinery import PathFinder

find, hidden = PathFinder.find_spec, sys.argv[1].split(",")

def find_spec(cls, name, path=None, target=None):
    return None if name in hidden else find(name, path, target)

PathFinder.find_spec = classmethod(find_spec)
from alula.cli.main import main

main(sys.argv[2:])
"""


def run_without(packages, words, folder):
    """Run a command where packages are not found, as if they were not installed."""
    command = [sys.executable, "-P", "-c", HIDE, ",".join(packages), *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True)


def test_the_project_has_the_extras_of_the_table():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    found = {
        (name.split(">=")[0].removesuffix("-cpu"), extra)
        for extra, names in project["optional-dependencies"].items()
        if extra != "all"
        for name in names
    }
    assert found == {(e.distribution.removesuffix("-cpu"), e.extra) for e in EXTRAS.values()}
    every = project["optional-dependencies"]["all"][0].removeprefix("alula[").removesuffix("]").split(",")
    # GPL, and it asks for fixed versions of other packages
    assert set(every) == {e.extra for e in EXTRAS.values()} - {"crazyflie"}


COMMANDS = [
    ("pycolmap", "scale-align tiny.scene.npz -o OUT.scene.npz --colmap MODEL --reference cameras.csv"),
    ("pycolmap", "observe tiny.metric.scene.npz -o OUT.seen.npz --colmap MODEL"),
    ("matplotlib", "report tiny.run.mcap -o OUT.html"),
    ("matplotlib", "report tiny.run.mcap -o OUT.pdf"),
    ("viser", "report tiny.run.mcap -o OUT.html"),
    ("viser", "view tiny.cover.npz -o OUT.html"),
    ("viser", "fly tiny.plan.npz --map tiny.cover.npz --link sim: -o OUT.run.mcap --live"),
    ("foxglove", "fly tiny.plan.npz --map tiny.cover.npz --link sim: -o OUT.run.mcap --foxglove"),
    ("pymavlink", "fly tiny.plan.npz --map tiny.cover.npz --link udpin:127.0.0.1:14550 -o OUT.run.mcap"),
    ("pymavlink", "identify --link udpin:127.0.0.1:14550 --box -8 -8 0 8 8 12 -o OUT.toml"),
    ("pymavlink", "sim-vehicle --link udpout:127.0.0.1:14550"),
    ("cflib", "fly tiny.plan.npz --map tiny.cover.npz --link radio://0/80/2M/E7E7E7E7E7 -o OUT.run.mcap"),
    ("rosbags", "export tiny.run.mcap -o OUT --ros2"),
    ("distributed", "simulate tiny.cover.npz -o OUT.run.mcap --trials 1 --scheduler tcp://127.0.0.1:1"),
]


@pytest.mark.every(5)
@pytest.mark.parametrize(("package", "words"), COMMANDS)
def test_a_command_without_its_package_says_what_to_install(package, words, pipeline, tmp_path):
    (tmp_path / "cameras.csv").write_text("image,x,y,z\na.jpg,0,0,1\nb.jpg,1,0,1\nc.jpg,0,1,1\n")
    for name in ("cameras", "images", "points3D"):
        (tmp_path / f"{name}.txt").touch()
    for name, path in (("cameras.csv", "cameras.csv"), ("MODEL", ""), ("OUT", "out")):
        words = words.replace(name, str(tmp_path / path))
    before = {path.name for path in tmp_path.iterdir()}
    done = run_without([package], words.split(), pipeline)
    wanted = EXTRAS[package]
    remedy = f"pip install 'alula[{wanted.extra}]'"
    assert done.stderr == f"alula: {wanted.distribution} is not installed; {wanted.purpose}: {remedy}\n"
    assert (done.returncode, done.stdout) == (2, "")
    assert {path.name for path in tmp_path.iterdir()} == before


@pytest.mark.every(4)
@pytest.mark.parametrize(
    "words",
    [
        "import-splat tiny.ply -o OUT.scene.npz",
        "scale-align tiny.scene.npz -o OUT.scene.npz --scale 2",
        "voxelize tiny.metric.scene.npz -o OUT.voxels.npz --size 0.2",
        "merge tiny.voxels.npz -o OUT.cover.npz --hulls 20",
        "verify tiny.cover.npz --voxels tiny.voxels.npz --scene tiny.metric.scene.npz",
        "plan tiny.cover.npz -o OUT.plan.npz --free-points 2",
        "simulate tiny.cover.npz -o OUT.run.mcap --trials 1",
        "export tiny.cover.npz -o OUT.glb",
        "info tiny.run.mcap",
    ],
)
def test_the_core_needs_no_extra(words, pipeline, tmp_path):
    done = run_without(EXTRAS, [*words.replace("OUT", str(tmp_path / "out")).split(), "-q"], pipeline)
    assert done.returncode in (0, 4), done.stderr
