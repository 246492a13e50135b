"""The combined scenario that no paper has, all combinations of parts, and what the one loop costs.

A Crazyflie by body rates, 20 ms from measurement to command, among the hulls of the built-in room, inside a
fence, with two balls thrown at its path (examples/world/room.toml): flown without a filter, behind each
filter alone, and behind dr-acbf with the shield. Collisions come from the truth. `static_collisions_shield`
counts the flights behind a shield that touched a hull or left the fence, `certified_share_static` the steps
in which the shield proved a manoeuvre to rest against all of that.

    python benchmarks/world.py --quick --json          # under a minute
    python benchmarks/world.py --trials 10000 --keep FOLDER --markdown PAGE  # may be stopped and begun again
    python benchmarks/world.py --before COMMIT --json  # ticks against an older commit, side by side
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parent))
sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))  # the combinations

import msgspec
import numpy as np
from scenes import room, voxels_of

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.parameters.configs.merge import MergeConfig
from alula.schemas.scenarios.defaults import vehicle_of
from alula.schemas.scenarios.scenario import Scenario, decoded, plain, read_scenario
from alula.stages.compression.merge import merge
from alula.stages.simulation.judge import hits_static
from alula.stages.simulation.prepare import prepare
from alula.stages.simulation.simulate import simulate_world
from alula.stages.verdict import wilson_interval
from support.flights import combinations

ROOT = Path(__file__).resolve().parents[1]
SCENARIO = ROOT / "examples" / "world" / "room.toml"
LISTS: tuple[tuple[str, ...], ...] = (
    (),
    ("polytope-cbf",),
    ("safer-splat",),
    ("cone-ecbf",),
    ("cone-backup",),
    ("shield",),
    ("dr-acbf",),
    ("mpc",),
    ("cbf-qp",),
    ("rp-cbf",),
    ("dr-acbf", "shield"),
    ("dr-acbf", "cone-backup"),
)
# Baselines of DR-ACBF's paper, and a second list: a tenth of the flights.
FEWER = (("mpc",), ("cbf-qp",), ("rp-cbf",), ("dr-acbf", "cone-backup"))
SHIELDED = ("shield", "cone-backup", "cone-ecbf")
QUICK_LISTS = ((), ("polytope-cbf",), ("dr-acbf",), ("shield",), ("dr-acbf", "shield"))
TIMED = 200  # flights of which the ticks are timed, one after the other
# What the loops of simulations and of `fly` consist of, with their commands, logs and bindings.
_STAGES = (
    *(
        "stages/simulation",
        "stages/runlog",
        "stages/flight/commanders",
        "cli/verbs/simulate.py",
        "cli/verbs/runs.py",
    ),
    *("cli/verbs/missions.py", "cli/verbs/sources.py"),
    *("native/core/src/flight", "native/core/include/alula/flight", "native/core/bindings/flight"),
)


def cover(gaussians: int, hulls: int) -> Artifact:
    """Cover the built-in room."""
    return merge(MergeConfig(hulls=hulls), voxels_of(room(gaussians), 0.05))


def combined(filters: tuple[str, ...], trials: int) -> Scenario:
    """The combined scenario behind a list of filters."""
    tree = plain(read_scenario(SCENARIO))
    tree["world"]["cover"] = "room.cover.npz"
    tree["safety"]["filters"] = list(filters)
    tree["rules"] |= {"trials": trials, "logged": 0}
    return decoded(tree, "combined")


def flown(made: Artifact, filters: tuple[str, ...], trials: int, jobs: int) -> dict[str, Any]:
    """Outcomes behind one list of filters."""
    scenario = combined(filters, trials)
    start = time.monotonic()
    run = simulate_world(scenario, vehicle_of(scenario, Path()), cover=made, jobs=jobs)
    steps = sum(trial.steps for trial in run.trials)
    moving = sum(any(one.collision for one in trial.obstacles or []) for trial in run.trials)
    static = sum(map(hits_static, run.trials))
    print(f"{' + '.join(filters) or 'no filter'}: {static} static, {moving} moving", file=sys.stderr)
    return {
        "filters": list(filters),
        "trials": len(run.trials),
        "reached": sum(trial.outcome == "reached" for trial in run.trials),
        "static": static,
        "static_interval": wilson_interval(static, len(run.trials)),
        "moving": moving,
        "moving_interval": wilson_interval(moving, len(run.trials)),
        "certified": sum(trial.certified_steps or 0 for trial in run.trials) / steps,
        "certified_moving": sum(trial.certified_moving_steps or 0 for trial in run.trials) / steps,
        "wall_s": time.monotonic() - start,
    }


def kept(
    made: Artifact, filters: tuple[str, ...], trials: int, jobs: int, folder: Path | None
) -> dict[str, Any]:
    """The outcomes of `flown`, from a file in `folder` if they are there; else flown, and written to it."""
    file = None if folder is None else folder / f"{'+'.join(filters) or 'none'}-{trials}.json"
    if file is not None and file.exists():
        found: dict[str, Any] = json.loads(file.read_text())
        return found
    found = flown(made, filters, trials, jobs)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        partial = file.with_suffix(".partial")
        partial.write_text(json.dumps(found))
        partial.replace(file)
    return found


def ticks(made: Artifact, filters: tuple[str, ...], trials: int) -> dict[str, float]:
    """Times of the ticks of the first flights, on one thread."""
    scenario = combined(filters, trials)
    times = simulate_world(scenario, vehicle_of(scenario, Path()), cover=made, jobs=1).tick_times
    return {"tick_p50_us": 1e6 * times.quantile(0.5), "tick_p99_us": 1e6 * times.quantile(0.99)}


def combined_figures(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The named figures of the combined scenario."""
    by = {tuple(row["filters"]): row for row in rows}
    shielded = [row for row in rows if row["filters"] and row["filters"][-1] in SHIELDED]
    bare = [row for row in rows if row["filters"] and row["filters"][-1] not in SHIELDED]
    both = by["dr-acbf", "shield"]
    return {
        "trials": both["trials"],
        "static_collisions_none": by[()]["static"],
        "static_collisions_shield": sum(row["static"] for row in shielded),
        "static_collisions_filters": sum(row["static"] for row in bare),
        "moving_hits_shield": both["moving"],
        "moving_hits_none": by[()]["moving"],
        "certified_share_static": min(row["certified"] for row in shielded),
        "certified_share_moving": both["certified_moving"],
        "tick_p99_us_shield_hulls": both["tick_p99_us"],
    }


def count_combinations(every: int) -> dict[str, int]:
    """Fly each combination of parts for a moment, or each `every`th one."""
    made = combinations.files()
    count = {"flown": 0, "refused_in_words": 0, "broken": 0}
    cases = [
        case
        for vehicle, interfaces in combinations.VEHICLES.items()
        for interface in interfaces
        for case in combinations.cases(vehicle, interface)
    ]
    for case in cases[::every]:
        try:
            verdict = combinations.tried(case.tree, made)
        except Exception as error:  # noqa: BLE001 - a combination that breaks is what is counted
            print(f"broken: {case.name}: {error}", file=sys.stderr)
            count["broken"] += 1
            continue
        what = "broken" if verdict.faults else "flown" if verdict.trial is not None else "refused_in_words"
        count[what] += 1
    return {f"combinations_{what}": number for what, number in count.items()}


def replay_mismatches(made: Artifact) -> int:
    """Ticks in which a flight on board, fed with logged measurements, commands something else."""
    scenario = combined(("dr-acbf", "shield"), 2)
    tree = plain(scenario)
    tree["estimation"] |= {"position_noise_m": 0.002, "velocity_noise_m_s": 0.01, "lost_share": 0.05}
    scenario = decoded(tree, "replay")
    ready = prepare(scenario, vehicle_of(scenario, Path()), cover=made, jobs=1)
    wrong = 0
    for index, log in enumerate(ready.fly(0, 2, jobs=1)):
        flight = ready.on_board(index)
        tracks, size = log["tracks"], len(log["tracks"]) // max(1, int(log["track_start"][-1]))
        for tick in range(len(log["mark"])):
            row = log["measured"][tick]
            seen = tracks[size * int(log["track_start"][tick]) : size * int(log["track_start"][tick + 1])]
            sigma = scenario.estimation.position_noise_m or 0.0
            flight.observe(
                tick * scenario.rules.dt_s,
                None if np.isnan(row).any() else row,
                tracks=seen,
                position_variance=[sigma**2] * 3,
            )
            wrong += not np.array_equal(flight.decide()["command"], log["command"][tick], equal_nan=True)
            flight.sent()
    return wrong


def lines_of(commit: str | None) -> int:
    """Lines of the simulation in the working tree, or in a commit."""
    command = ["git", "-C", str(ROOT), "ls-files", "--", *_STAGES]
    if commit is not None:
        command = ["git", "-C", str(ROOT), "ls-tree", "-r", "--name-only", commit, "--", *_STAGES]
    names = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    if commit is None:
        return sum(len((ROOT / name).read_bytes().splitlines()) for name in names)
    shown = [
        subprocess.run(
            ["git", "-C", str(ROOT), "show", f"{commit}:{name}"], check=True, capture_output=True
        ).stdout
        for name in names
    ]
    return sum(len(text.splitlines()) for text in shown)


TICKS = """
import json, sys
import numpy as np
from pathlib import Path
from alula import _core
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.artifacts.kinds import COVER, SCENE
from alula.schemas.scenarios.vehicle import FASTBRIDGE
try:
    from alula.stages.filtering.polytope_cbf import barrier
    from alula.stages.filtering.protocol import FilterWorld as SplatWorld, FilterWorld as World
    from alula.stages.filtering.registry import make_filter as make_splat_filter
except ImportError:  # a commit that has a protocol for each kind of filters
    from alula.stages.filtering.protocol import World
    from alula.stages.filtering.registry import make_filter, make_splat_filter
    from alula.stages.filtering.splat_protocol import SplatWorld
    barrier = lambda world: make_filter("polytope-cbf", world, {}).native
from alula.stages.filtering.obstacles import ellipsoid_index
from alula.stages.compression.hulls import Hulls
from alula.stages.vehicles.bodies import quadrotor, tracking_gains
import time

scene = read_artifact(Path(sys.argv[1]), SCENE)
cover = read_artifact(Path(sys.argv[2]), COVER)
rng = np.random.default_rng(0)
N = 400
p = rng.uniform([0.6, 0.6, 0.6], [7.4, 5.4, 2.2], (N, 3))
v = rng.normal(0, 0.8, (N, 3))
body, gains = quadrotor(FASTBRIDGE), tracking_gains(FASTBRIDGE)
world = SplatWorld(index=ellipsoid_index(scene, 1.0, 0.15), body=body, gains=gains, radius_m=0.15, dt_s=0.01)
hulls = World(hulls=Hulls.from_cover(cover), radius_m=0.1, speed_m_s=1.0, dt_s=0.01, extent_m=20.0)
made = {name: make_splat_filter(name, world, {}).native for name in
        ("safer-splat", "cone-di", "cone-ecbf", "cone-backup", "shield")}
polytope = barrier(hulls)
moving = {name: _core.moving_filter(name.replace("-", "_"), {}) for name in
          ("dr-acbf", "dr-acbf-qp", "mpc", "cbf-qp", "rp-cbf")}
tracks = np.zeros((2, 29))
for i in range(2):
    tracks[i, 0], tracks[i, 1:4], tracks[i, 4:7], tracks[i, 28] = i, [6 + i, 1 - 2 * i, 1], [-5, 0, 0], 0.1
    for k, j in enumerate((7, 9, 12, 16, 21, 27)):
        tracks[i, j] = 0.01 if k < 3 else 0.1
def one(name):
    best = []
    for i in range(N):
        if name in made:
            state = [*p[i], 0, 0, 0, *v[i], 0, 0, 0]
            a = (-0.5 * v[i]).tolist()
            wrench = [body.hover_thrust, 0, 0, 0]
            f = made[name].filter
            call = lambda: f(state, a, wrench=wrench, thrust=body.hover_thrust)
        elif name == "polytope-cbf":
            x, u = p[i].tolist(), v[i].tolist()
            call = lambda: polytope.filter(x, u)
        else:
            x, u = p[i].tolist(), v[i].tolist()
            call = lambda: moving[name].filter(x, u, tracks, np.empty((0, 4)), [0, 0, 0])
        call()
        times = []
        for _ in range(3):
            start = time.perf_counter()
            call()
            times.append(time.perf_counter() - start)
        best.append(min(times))
    return float(np.median(best))
names = [*made, "polytope-cbf", *moving]
for line in sys.stdin:
    print(json.dumps({name: one(name) for name in names}), flush=True)
"""


def ticks_over_before(commit: str, scene: Path, made: Path, runs: int) -> dict[str, float]:
    """Each filter's median tick over that of an older commit: both built, and run in turns."""
    with tempfile.TemporaryDirectory() as folder:
        older = Path(folder) / "before"
        subprocess.run(
            ["git", "-C", str(ROOT), "worktree", "add", "--detach", str(older), commit], check=True
        )
        try:
            subprocess.run(["make", "setup"], cwd=older, check=True, stdout=sys.stderr)
            programs = [
                subprocess.Popen(
                    [python, "-P", "-c", TICKS, str(scene), str(made)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    text=True,
                    cwd=folder,
                )
                for python in (sys.executable, str(older / ".venv/bin/python"))
            ]
            rounds: list[list[dict[str, float]]] = []
            for _ in range(runs):
                pair = []
                for program in programs:
                    assert program.stdin is not None
                    assert program.stdout is not None
                    program.stdin.write("go\n")
                    program.stdin.flush()
                    pair.append(json.loads(program.stdout.readline()))
                rounds.append(pair)
            for program in programs:
                program.communicate()
        finally:
            subprocess.run(["git", "-C", str(ROOT), "worktree", "remove", "--force", str(older)], check=True)
    return {
        name: statistics.median(ours[name] / theirs[name] for ours, theirs in rounds) for name in rounds[0][0]
    }


def table(rows: list[dict[str, Any]]) -> str:
    """The rows of the combined scenario as Markdown."""
    lines = [
        "| filters | flights | reached | touched a hull or left the fence | hit by a ball | "
        "steps certified | also against tubes | tick p50 / p99 [µs] |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        n = row["trials"]
        low, high = row["moving_interval"]
        name = " + ".join(row["filters"]) or "none"
        proven = row["filters"] and row["filters"][-1] in SHIELDED
        certified = f"{100 * row['certified']:.4g} %" if proven else ""
        tubes = f"{100 * row['certified_moving']:.3g} %" if proven else ""
        lines.append(
            f"| {name} | {n} | {row['reached']} | {row['static']} | {row['moving']} "
            f"({100 * low:.1f} to {100 * high:.1f} %) | {certified} | {tubes} | "
            f"{row['tick_p50_us']:.0f} / {row['tick_p99_us']:.0f} |"
        )
    return "\n".join(lines)


def page(rows: list[dict[str, Any]], figures: dict[str, Any]) -> str:
    """The page of results."""
    given = "\n".join(f"| `{key}` | {value} |" for key, value in figures.items() if key != "rows")
    return f"""# One world: the combined scenario

Compare here how often a Crazyflie arrives, touches something or is hit behind each list of filters.
Made by `make bench-world`; do not edit. A Crazyflie by body rates, 20 ms from measurement to command, motors
with a lag of 30 ms, among the 300 hulls of the built-in room, inside a fence, with two balls thrown at its
path ([examples/world/room.toml](../../examples/world/room.toml)). Every list of filters flies the same
{figures["trials"]} flights, some lists a tenth as many; all counts are from the truth. Ticks are those
of the first {min(figures["trials"], TIMED)} flights, on one thread.

{table(rows)}

| figure | value |
| --- | --- |
{given}

A hovering drone can be hit: no filter excludes that. The shield proves, in every step, a manoeuvre to rest
that is clear of all that does not move; the tubes of tracked balls cover only a part of the steps.
"""


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="few trials and lists, under a minute")
    parser.add_argument("--trials", type=int, help="of each list of filters; default 1000, quick 24")
    parser.add_argument("--jobs", type=int, default=0, help="threads; default all processors")
    parser.add_argument(
        "--keep", type=Path, metavar="FOLDER", help="of outcomes: what it has is not flown again"
    )
    parser.add_argument("--before", metavar="COMMIT", help="also compare ticks and lines with this commit")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--markdown", type=Path, help="write the page")
    options = parser.parse_args()
    trials = options.trials or (24 if options.quick else 1000)
    scene = room(40_000 if options.quick else 200_000)
    made = merge(MergeConfig(hulls=150 if options.quick else 300), voxels_of(scene, 0.05))
    lists = QUICK_LISTS if options.quick else LISTS
    counts = [max(1, trials // 10) if names in FEWER and not options.quick else trials for names in lists]
    rows = [
        kept(made, names, count, options.jobs, options.keep)
        for names, count in zip(lists, counts, strict=True)
    ]
    rows = [row | ticks(made, names, min(trials, TIMED)) for row, names in zip(rows, lists, strict=True)]
    figures = count_combinations(8 if options.quick else 1) | combined_figures(rows)
    figures["replay_mismatches"] = replay_mismatches(made)
    if options.before and not options.quick:
        from alula.schemas.artifacts.artifact import write_artifact

        with tempfile.TemporaryDirectory() as folder:
            files = [Path(folder) / "room.scene.npz", Path(folder) / "room.cover.npz"]
            write_artifact(files[0], scene)
            write_artifact(files[1], made)
            ratios = ticks_over_before(options.before, *files, runs=7)
        figures |= {"tick_over_before": ratios, "tick_over_before_max": max(ratios.values())}
    figures["stages_lines_before"] = lines_of(options.before or "2b10e64")
    figures["stages_lines_after"] = lines_of(None)
    if options.markdown:
        options.markdown.write_text(page(rows, figures))
    if options.json:
        print(json.dumps(figures | {"rows": rows, "processors": os.cpu_count()}, indent=2))
    elif not options.markdown:
        print(table(rows))
        print(msgspec.json.format(msgspec.json.encode(figures), indent=2).decode())


if __name__ == "__main__":
    main()
