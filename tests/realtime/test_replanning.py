"""New plans in flight, made by their process, and whole flights of the command that their filter stops."""

import json
import time
from contextlib import closing

import msgspec
import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import encode_artifact, write_artifact
from alula.schemas.artifacts.kinds import PLAN
from alula.schemas.errors import InputError
from alula.schemas.log.run import read_run
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.stages.flight.links.own_safety import Action, Failsafe, OwnSafety, WayHome
from alula.stages.flight.replan.of_mission import maps_of, replan_facts
from alula.stages.flight.replan.process import PlannerProcess
from alula.stages.flight.replan.task import ReplanRequest, ReplanTask
from alula.stages.planning.plan import plan
from support.flights.flights import mission
from support.scenes.small_scenes import box_cover

GAP = box_cover([((18, -10, 0), (22, 18, 20)), ((18, 22, 0), (22, 50, 20))])  # 0.4 m wide, in a wall
PATH = PlanConfig(beyond_map_m=3.0, start=(0.3, 2.0, 1.0), goal=(3.7, 2.0, 1.0), radius_m=0.16)
ASKED = ReplanRequest(
    number=1, position=(1.5, 2.0, 1.0), velocity=(0.0, 0.0, 0.0), acceleration=(0.0, 0.0, 0.0), via=()
)
PATIENCE_S = 20.0


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("gap")
    write_artifact(folder / "gap.cover.npz", GAP)
    write_artifact(folder / "gap.plan.npz", plan(PATH, GAP))
    return folder


def planner_of(files):
    made = mission(cover=GAP, plan=plan(PATH, GAP))
    facts = replan_facts(made)
    process = PlannerProcess(facts, made.world.vehicle, maps_of(made), {"cover": files / "gap.cover.npz"})
    return process, ReplanTask(facts, made.world.vehicle, maps_of(made))


def answer(planner):
    """The answer, and the longest that a look took."""
    until, longest = time.monotonic() + PATIENCE_S, 0.0
    while time.monotonic() < until:
        before = time.monotonic()
        found = planner.answer()
        longest = max(longest, time.monotonic() - before)
        if found is not None or planner.has_ended:
            return found, longest
        time.sleep(0.005)
    raise AssertionError("no answer")


def test_the_process_makes_the_plan_that_would_be_made_here_and_nobody_waits_for_it(files):
    planner, task = planner_of(files)
    with closing(planner):
        before = time.monotonic()
        assert planner.ask(ASKED)
        asking = time.monotonic() - before
        found, longest = answer(planner)
        assert found.reason == ""
        assert found.planning_s > 5 * max(asking, longest)
        here = task.plan(ASKED)
        for name, array in found.plan.arrays.items():
            np.testing.assert_array_equal(array, here[name])
        assert found.plan.kind is PLAN
        assert encode_artifact(found.plan) == encode_artifact(here)
        assert planner.ask(
            ReplanRequest(
                **{f: getattr(ASKED, f) for f in ASKED.__struct_fields__}
                | {"number": 2, "position": (2.0, 1.0, 1.0)}
            )
        )
        found, _ = answer(planner)
        assert (found.number, found.arrays) == (2, {})
        assert "nearer to an obstacle" in found.reason


def test_the_process_knows_the_failsafes_of_the_vehicle(files):
    planner, _ = planner_of(files)
    home = WayHome(height_m=1.0, setting="RTL_ALT 100")
    failsafe = Failsafe("the radio is lost", Action.RETURN, "FS_THR_ENABLE 1", "FS_THR_ENABLE to 3")
    with closing(planner):
        planner.know(OwnSafety((failsafe,), home, alone_s=0.5))
        planner.ask(ReplanRequest(**msgspec.structs.asdict(ASKED) | {"home": (0.3, 1.0, 0.0)}))
        found, _ = answer(planner)
        assert "flies home" in found.reason


def test_a_process_that_ends_says_so(files):
    planner, _ = planner_of(files)
    with closing(planner):
        planner._pipe.process.kill()
        found, _ = answer(planner)
        assert found is None
        assert planner.has_ended


def test_a_map_that_was_changed_is_refused(files, tmp_path):
    made = mission(cover=GAP, plan=plan(PATH, GAP))
    write_artifact(tmp_path / "other.cover.npz", box_cover([((18, 14, 0), (22, 30, 20))]))
    with pytest.raises(InputError, match="has changed"):
        PlannerProcess(
            replan_facts(made), made.world.vehicle, maps_of(made), {"cover": tmp_path / "other.cover.npz"}
        )


def flown(files, tmp_path, capsys, *more):
    """Exit code, summary and log of a flight towards the gap."""
    log = tmp_path / "f.run.mcap"
    names = (str(files / "gap.plan.npz"), "--map", str(files / "gap.cover.npz"), "--allow-tight")
    code = run(["fly", *names, "--link", "sim:?start=0.3,2,0", "-o", str(log), "--json", *more])
    return code, json.loads(capsys.readouterr().out)["summary"], log


def test_a_flight_before_the_gap_without_new_plans_takes_too_long(files, tmp_path, capsys, quick_clock):
    code, summary, _ = flown(files, tmp_path, capsys, "--replan-after", "0", "--max-time", "10")
    assert summary["collisions"] == 0
    assert (code, summary["ended_by"]) == (4, "took too long")


def test_a_flight_before_a_gap_that_its_filter_does_not_pass_goes_round(files, tmp_path, capsys):
    code, summary, log = flown(files, tmp_path, capsys)
    assert summary["collisions"] == 0
    assert summary["ended_by"] == "plan finished"
    assert code in (0, 4)  # 4: led out of the tube by velocities that are followed late
    assert summary["new_plans"] == 1
    assert summary["overruns"] <= 3  # the machine may have other work
    record = read_run(log)
    assert record.guarantee.claims["new_plans"] == 1
    from mcap.reader import make_reader

    with log.open("rb") as file:
        (attached,) = make_reader(file).iter_attachments()
    assert attached.name == "new-1.plan.npz"
    new = tmp_path / attached.name
    new.write_bytes(attached.data)
    assert run(["verify", str(new), "--map", str(files / "gap.cover.npz"), "-q"]) == 0
    assert run(["info", str(log), "-q"]) == 0
    assert run(["report", str(log), "-o", str(tmp_path / "f.html"), "-q"]) == 0
