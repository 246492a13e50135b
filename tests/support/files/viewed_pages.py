"""Files of pages of every kind: small, with colors that are found again in the picture."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from alula.cli.main import run
from alula.schemas.artifacts.artifact import write_artifact
from alula.schemas.artifacts.manifest import PlanPass
from alula.stages.flight.recorder.log import FlightRecorder
from support.flights.flight_logs import head_of, record_of
from support.flights.flights import fly, mission
from support.paths import VEHICLES
from support.scenes.fabricate import (
    box,
    make_cover,
    make_plan,
    make_record,
    make_scene,
    make_trial,
    make_voxels,
    write_run,
)

RED = (200, 30, 30)
FENCED = f"""
schema = "alula/scenario"
version = "2.0"
[vehicle]
file = "{VEHICLES / "racer7.toml"}"
interface = "sticks"
[world.fence]
box_m = [-125.0, -125.0, 0.5, 125.0, 125.0, 120.0]
[mission]
kind = "pilot"
start_box_m = [-15.0, -15.0, 3.0, 15.0, 15.0, 35.0]
start_speed_m_s = 10.0
start_tilt_deg = 57.3
[mission.pilot]
kind = "aggressive"
[safety]
filters = ["geofence"]
[rules]
dt_s = 0.0025
plant_steps = 4
trials = 2
max_time_s = 2.0
logged = 2
log_rate_hz = 50.0
"""
MOVING = """
schema = "alula/scenario"
version = "2.0"
name = "moving"
[vehicle]
type = "double-integrator"
radius_m = 0.15
max_speed_m_s = 12.0
max_acceleration_m_s2 = 6.0
max_jerk_m_s3 = 60.0
[[world.moving]]
motion = "accelerating"
position_m = [25, 0.5, 10]
velocity_m_s = [-6, 0, 0]
acceleration_m_s2 = [0, 1e-09]
radius_m = 0.8
[mission]
kind = "goal"
start_m = [0.0, 0.0, 10.0]
goal_m = [40.0, 0.0, 10.0]
start_speed_m_s = 4.0
speed_m_s = 4.0
receded_s = 1.0
[estimation.sensor]
kind = "ideal"
position_sigma_m = 0.01
[safety]
filters = ["dr-acbf"]
[rules]
plant_steps = 10
trials = 2
max_time_s = 14.0
logged = 2
"""


def write_files(folder: Path) -> None:
    """Artifacts and logs: s.scene, c.cover, v.voxels, p.plan, gates.plan, a.run, b.run."""
    scene = make_scene(300, low=(0, -1, 0), high=(5, 1, 0.5), color=RED)
    write_artifact(folder / "s.scene.npz", scene)
    write_artifact(
        folder / "c.cover.npz", make_cover([box((0, 40, 0), (100, 42, 30)), box((30, -20, 0), (40, -5, 30))])
    )
    write_artifact(folder / "v.voxels.npz", make_voxels())
    plan = make_plan()
    write_artifact(folder / "p.plan.npz", plan)
    gate = {
        "kind": "gate",
        "number": 1,
        "time_s": 1.0,
        "point_m": [1.0, 0, 1],
        "normal": [1.0, 0, 0],
        "radius_m": 0.5,
    }
    manifest = msgspec.structs.replace(plan.manifest, passes=[PlanPass(**gate)])
    write_artifact(folder / "gates.plan.npz", replace(plan, manifest=manifest))
    trials = [make_trial(i, clearance=0.1 * i + 0.05) for i in range(2)]
    for name in ("a", "b"):
        write_run(folder / f"{name}.run.mcap", make_record(trials), hulls=2)


def write_simulated(folder: Path) -> None:
    """Logs of a fence of 250 m, of moving obstacles, and of a real flight."""
    for name, text in (("fenced", FENCED), ("moving", MOVING)):
        (folder / f"{name}.toml").write_text(text)
        assert run(
            ["simulate", str(folder / f"{name}.toml"), "-o", str(folder / f"{name}.run.mcap"), "-q"]
        ) in (0, 4)
    made = mission(velocity_lag_s=0.0)
    recorder = FlightRecorder(folder / "flight.run.mcap", head_of(made), echo=False)
    loop, _ = fly(made, recorder=recorder)
    recorder.plan(2.0, np.linspace((0.3, 2.0, 1.0), (3.0, 3.0, 1.0), 20).tolist())
    assert recorder.finish(record_of(made, loop, recorder))


def write_page(folder: Path, command: str, name: str, *words: str) -> Path:
    """Write a page with a command; words that name files of the folder are found there."""
    found = [str(folder / word) if (folder / word).exists() else word for word in words]
    page = folder / f"{command}-{name}.html"
    assert run([command, *found, "-o", str(page), "-q"]) == 0
    return page
