"""`alula fly` from the command line, over `sim:`: flights, refusals, an interruption, a crash.

All but the crash fly in this process, on a clock that does not wait.
"""

import json
import re
import subprocess
import sys
import time

import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import write_artifact
from alula.schemas.log.cut import read_logged
from alula.schemas.log.run import read_run
from support.scenes.small_scenes import box_cover, rest_plan

SIM = "sim:?start=0.5,1.5,0"


def words(folder, output, *more, link=SIM, map_name="tiny.cover.npz"):
    return [
        *("fly", str(folder / "tiny.plan.npz"), "--map", str(folder / map_name)),
        *("--link", link, "-o", str(output), *more),
    ]


pytestmark = pytest.mark.usefixtures("quick_clock")


def test_a_flight_is_flown_logged_and_reported(pipeline, tmp_path, capfd):
    log = tmp_path / "f.run.mcap"
    code = run(words(pipeline, log, "--json"))
    out, err = capfd.readouterr()
    assert code == 0, err
    summary = json.loads(out)["summary"]
    assert (summary["reached"], summary["collisions"], summary["ended_by"]) == (1, 0, "plan finished")
    assert summary["min_map_clearance_m"] > 0
    assert "check clearance: holds" in err
    assert "take-off height reached: flying the plan" in err
    record = read_run(log)
    assert record.filter == "polytope-cbf"
    assert {ref.role for ref in record.provenance.inputs} == {"plan", "cover"}
    assert record.provenance.parameters["link"] == SIM
    assert record.timing["filter_calls"] == record.trials[0].steps
    assert record.timing["ticks"] > record.timing["filter_calls"]
    assert run(["info", str(log), "-q"]) == 0
    assert run(["report", str(log), "-o", str(tmp_path / "f.html"), "-q"]) == 0
    assert "reached" in (tmp_path / "f.html").read_text()
    assert run(words(pipeline, log)) == 2  # a flight is not continued
    log.unlink()
    assert run(words(pipeline, log)) == 2  # the record still belongs to another flight


def test_the_ground_of_a_simulated_vehicle_is_that_of_the_map(tmp_path):
    slabs = [((-10, 0, -2), (20, 40, 0)), ((20, 0, -12), (50, 40, -10))]  # down by 1 m at x = 2
    write_artifact(tmp_path / "step.cover.npz", box_cover(slabs))
    write_artifact(tmp_path / "step.plan.npz", rest_plan((0.8, 2.0, 1.0), (3.2, 2.0, -0.4), 0.9))
    log = tmp_path / "f.run.mcap"
    names = (str(tmp_path / "step.plan.npz"), "--map", str(tmp_path / "step.cover.npz"))
    link = ("--link", "sim:?start=0.8,2,0", "-o", str(log))
    run(
        ["fly", *names, *link, "--allow-other-map", "--allow-tight", "-q"]
    )  # this vehicle lags behind its plan
    summary = read_run(log).summary
    assert (summary["ended_by"], summary["collisions"]) == ("plan finished", 0)


def test_a_dry_run_writes_nothing_and_prints_the_checks(pipeline, tmp_path, capsys):
    log = tmp_path / "f.run.mcap"
    assert run(words(pipeline, log, "--dry-run", "--json")) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["status"] == "dry-run"
    assert {"heartbeat", "clearance", "plan", "frame"} <= found["summary"].keys()
    assert list(tmp_path.iterdir()) == []


def test_a_plan_of_another_cover_is_said(pipeline, tmp_path, capsys):
    other = tmp_path / "other.cover.npz"
    assert run(["merge", str(pipeline / "tiny.voxels.npz"), "-o", str(other), "--hulls", "5", "-q"]) == 0
    code = run(words(pipeline, tmp_path / "f.run.mcap", "-n", map_name=str(other), link="sim:?start=2,1.5,0"))
    assert code == 4
    assert "tiny.plan.npz was made in tiny.cover.npz" in capsys.readouterr().err


def test_a_failing_check_is_named_and_leaves_no_log(pipeline, tmp_path, capsys):
    log = tmp_path / "f.run.mcap"
    assert run(words(pipeline, log, "-q", link="sim:?start=2,1.5,0")) == 4
    assert "pre-flight: start: the plan starts 1.50 m away" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("more", "link", "code", "text"),
    [
        ([], "sim:?nonsense=1", 2, "nonsense"),
        ([], "carrier-pigeon", 2, "not a vehicle address"),
        ([], "udpout:192.0.2.1:14550", 2, "--allow-remote"),
        (["--rate", "1000"], SIM, 2, "--rate must be between"),
        (["--fence", "0", "0", "0", "0", "1", "1"], SIM, 2, "--fence needs"),
        (["--filter", "cone-di"], SIM, 2, "needs a scene"),
        (["--filter", "nothing-like-it"], SIM, 2, "no filter is called"),
        (["--signing-key", "{folder}/pairs.csv"], SIM, 3, "a signing key is 32 bytes"),
        (["--mocap", "127.0.0.1:9870"], "udpout:127.0.0.1:9", 2, "motion capture needs an address udp:HOST"),
        (["--fence", "0 0 0 1 1"], SIM, 2, "(see 'alula fly -h')"),
        ([], "serial:/dev/null:57600", 6, "as a serial line: Inappropriate ioctl"),
        ([], "serial:/dev/does-not-exist:57600", 6, "does-not-exist"),
    ],
)
def test_wrong_words_are_refused_in_one_line(pipeline, tmp_path, capsys, more, link, code, text):
    more = [word.format(folder=pipeline) for word in more]
    assert run(words(pipeline, tmp_path / "f.run.mcap", "-q", *more, link=link)) == code
    err = capsys.readouterr().err
    assert text in err
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_link_is_needed(pipeline, tmp_path, capsys):
    plan, cover = str(pipeline / "tiny.plan.npz"), str(pipeline / "tiny.cover.npz")
    assert run(["fly", plan, "--map", cover, "-o", str(tmp_path / "f.run.mcap")]) == 2
    assert "--link is needed" in capsys.readouterr().err
    assert run(["fly", cover, "--link", "sim:", "-o", str(tmp_path / "f.run.mcap")]) == 2
    assert "only a plan can be flown" in capsys.readouterr().err


def scenario_of(pipeline, more=""):
    return (
        'schema = "alula/scenario"\nversion = "2.0"\n'
        f'[world]\ncover = "{pipeline}/tiny.cover.npz"\n'
        f'[mission]\nkind = "plan"\nplan = "{pipeline}/tiny.plan.npz"\n{more}'
    )


def test_a_scenario_has_the_link_and_options(pipeline, tmp_path, capsys):
    text = scenario_of(pipeline, '[fly]\nlink = "sim:?start=2,1.5,0"\nnear_m = 0.25\n')
    scenario = tmp_path / "s.toml"
    scenario.write_text(text)
    log = tmp_path / "f.run.mcap"
    assert run(["fly", str(scenario), "-o", str(log), "-q"]) == 4
    assert "at most 0.25 m sideways" in capsys.readouterr().err
    assert run(["fly", str(scenario), "-o", str(log), "-q", "--near", "2", "--dry-run"]) == 0
    scenario.write_text(text + "speed_of_light = 1\n")
    assert run(["fly", str(scenario), "-o", str(log), "-q"]) == 2
    assert "speed_of_light" in capsys.readouterr().err


def test_a_scenario_that_says_everything_is_flown_by_simulate_and_fly(pipeline, tmp_path, capsys):
    scenario, whole = tmp_path / "s.toml", tmp_path / "whole.toml"
    scenario.write_text(
        scenario_of(
            pipeline,
            '[vehicle]\ntype = "crazyflie21"\ninterface = "velocity"\n'
            f'[safety]\nfilters = ["polytope-cbf"]\n[fly]\nlink = "{SIM}"\n',
        )
    )
    assert run(["scenario", str(scenario), "-o", str(whole), "-q"]) == 0
    assert run(["simulate", str(whole), "-o", str(tmp_path / "s.run.mcap"), "-q"]) == 0
    capsys.readouterr()
    assert run(["fly", str(whole), "-o", str(tmp_path / "f.run.mcap"), "--dry-run"]) == 0
    assert "link: simulated crazyflie21" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (
            "[[world.walls]]\nlower_m = [9, 9, 9]\nupper_m = [10, 10, 10]\n",
            "`$.world.walls`: is for simulate",
        ),
        ('[safety]\nfilters = ["polytope-cbf", "shield"]\n', "choose one with --filter"),
        ('[vehicle]\ntype = "single-integrator"\n', "`$.vehicle`: a single-integrator is simulated only"),
        ('[safety]\nfilters = ["dr-acbf"]\n', "dr-acbf is simulated only"),
        ("[vehicle]\nradius_m = 3\n", "polytope-cbf keeps 3.1 m"),
    ],
)
def test_what_a_real_flight_cannot_have_is_refused_in_words(pipeline, tmp_path, capsys, more, message):
    scenario = tmp_path / "s.toml"
    scenario.write_text(scenario_of(pipeline, more))
    assert run(["fly", str(scenario), "-o", str(tmp_path / "f.run.mcap"), "--link", SIM, "-q"]) != 0
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_ctrl_c_lands_and_the_log_says_so(pipeline, tmp_path, capfd, quick_clock):
    log = tmp_path / "f.run.mcap"
    quick_clock.interrupt_s = 4.5
    assert run(words(pipeline, log)) == 130
    said = capfd.readouterr().err
    assert re.search("flying the plan\n.*interrupted: landing\n.*disarmed", said), said
    (trial,) = read_run(log).trials
    assert (trial.outcome, trial.collision) == ("stopped", False)


@pytest.mark.realtime
def test_a_killed_flight_leaves_a_log_that_is_read(pipeline, tmp_path, capsys):
    log = tmp_path / "f.run.mcap"
    command = [sys.executable, "-P", "-m", "alula.cli", *words(pipeline, log)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert any("flying the plan" in line for line in process.stderr)
        time.sleep(1.0)
        process.kill()
    end = time.monotonic() + 20
    while not log.read_bytes().endswith(b"\x89MCAP0\r\n") and time.monotonic() < end:
        time.sleep(0.05)
    found = read_logged(log)
    assert "in the state fly" in found.damage
    assert len(found.flights.by_trial[0].time_s) > 100
    assert run(["info", str(log)]) == 3
    shown = capsys.readouterr()
    assert "the log of this flight was cut" in shown.out
    assert "cut" in shown.err
    assert run(["report", str(log), "-o", str(tmp_path / "f.html")]) == 0
    assert "was cut" in capsys.readouterr().err
    whole = log.read_bytes()
    log.write_bytes(whole[: len(whole) * 2 // 3])  # as after a power cut
    assert run(["info", str(log), "-q"]) == 3
    assert run(["report", str(log), "-o", str(tmp_path / "g.html"), "-q"]) == 0
