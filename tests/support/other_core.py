"""Make files of every kind, and flights behind every filter, with another build of `alula._core`; a program.

    python -P other_core.py MODULE FOLDER

`MODULE` is the shared library; `-` is the installed one.
"""

import importlib.util
import sys
from pathlib import Path

STATIC = ("cone-di", "cone-ecbf", "cone-backup", "safer-splat", "shield")
MOVING = ("cbf-qp", "dr-acbf-qp", "mpc", "rp-cbf", "dr-acbf")


def install(module: str) -> None:
    """Put a build in the place of the installed one, before anything of alula has imported that."""
    import alula

    spec = importlib.util.spec_from_file_location("alula._core", module)
    core = importlib.util.module_from_spec(spec)
    sys.modules["alula._core"] = alula._core = core
    spec.loader.exec_module(core)


def make(folder: Path) -> None:
    """One file of every kind, and a flight behind each filter, each made by its command."""
    from alula.cli.main import run
    from support.paths import EXAMPLES
    from support.scenes.pipeline import write_pipeline

    write_pipeline(folder)
    scene, plan = str(folder / "tiny.metric.scene.npz"), str(folder / "tiny.plan.npz")
    encounter = str(EXAMPLES / "dr-acbf/scenario-1.toml")
    flights = {name: [plan, "--map", scene, "--filter", name] for name in STATIC}
    flights |= {name: [encounter, "--filter", name, "--trials", "1"] for name in MOVING}
    wall = str(EXAMPLES / "geofencing/wall.toml")
    flights |= {name: [wall, "--filter", name, "--trials", "1"] for name in ("backup-qp", "geofence")}
    for name, words in flights.items():
        words = ["simulate", *words, "-o", str(folder / f"{name}.run.mcap"), "-q"]
        assert run(words) in (0, 4), words  # 4: touched something


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    if sys.argv[1] != "-":
        install(sys.argv[1])
    make(Path(sys.argv[2]))
