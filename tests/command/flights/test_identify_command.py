"""`alula identify` from the command line: what it refuses, a dry run, and a box where the vehicle is not."""

import pytest

from alula.cli.main import run
from alula.cli.verbs.fly import contact
from alula.schemas.scenarios.vehicle import read_vehicle
from support.paths import VEHICLES
from support.vehicles.sim_vehicle_process import free_port

BOX = ("--box", "-8 -8 0 8 8 16")
SIM = ("--link", "sim:?start=0,0,0")


@pytest.fixture
def output(tmp_path):
    return tmp_path / "mine.toml"


def refused(code, words, output, capsys):
    """The only line of the error; no file is left."""
    assert run(["identify", *words, "-o", str(output), "-q"]) == code
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith("alula: ")
    assert list(output.parent.iterdir()) == []
    return lines[0]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            (*SIM, "--box", "-1 -1 0 1 1 4"),
            "too small for horizontal steps of two speeds; +x at 0.5 m/s: it needs 1.3 m",
        ),
        ((*SIM, "--box", "8 -8 0 -8 8 16"), "XMIN < XMAX"),
        ((*SIM, "--box", "1 2 3"), "is not 6 numbers"),
        (SIM, "--box"),
        (BOX, "--link"),
        ((*SIM, *BOX, "--speeds", "1"), "two different speeds"),
        ((*SIM, *BOX, "--speeds", "1,1"), "two different speeds"),
        ((*SIM, *BOX, "--speeds", "1,fast"), "'fast' is not a number"),
        ((*SIM, *BOX, "--speeds", "1,nan"), "not finite"),
        ((*SIM, *BOX, "--speeds", "1,99"), "--speeds must be between"),
        ((*SIM, *BOX, "--reserve", "-1"), "--reserve must be between"),
        (("--link", "udpin:nowhere", *BOX), "nowhere"),
        (("--link", "udpin:192.0.2.1:14550", *BOX), "allow-remote"),
        (
            (*SIM, *BOX, "--vehicle", str(VEHICLES / "single-integrator.toml")),
            "only a quadrotor is identified",
        ),
    ],
)
def test_wrong_usage_is_one_line_before_anything_is_sent(words, said, output, capsys):
    assert said in refused(2, words, output, capsys)


def test_an_output_that_exists_is_kept(output, capsys):
    output.write_text("mine")
    assert run(["identify", *SIM, *BOX, "-o", str(output), "-q"]) == 2
    assert "use -f to replace it" in capsys.readouterr().err
    assert output.read_text() == "mine"


def test_a_vehicle_file_that_is_damaged_is_refused(output, tmp_path, capsys):
    broken = tmp_path / "broken.toml"
    broken.write_text("name =")
    assert run(["identify", *SIM, *BOX, "--vehicle", str(broken), "-o", str(output), "-q"]) == 3
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert not output.exists()


def test_nobody_answers(output, capsys, monkeypatch):
    monkeypatch.setattr(contact, "OPEN_S", 0.3)
    line = refused(6, ("--link", f"udpin:127.0.0.1:{free_port()}", *BOX), output, capsys)
    assert "no vehicle heartbeat within 0.3 s" in line


def test_a_box_where_the_vehicle_is_not(output, capsys, quick_clock):
    line = refused(4, ("--link", "sim:?start=20,0,0", *BOX), output, capsys)
    assert "start: the plan starts 20.00 m away sideways" in line
    assert "or say by --origin where the map's origin is in its frame" in line
    assert "the box's centre" in line


def test_a_dry_run_checks_and_writes_nothing(output, capsys, quick_clock):
    assert run(["identify", *SIM, *BOX, "-o", str(output), "--dry-run"]) == 0
    out, err = capsys.readouterr()
    assert "steps" in out
    assert "18" in out
    assert "link: " in err
    assert not output.exists()


@pytest.mark.slow
def test_a_file_for_the_simulated_link(output, capfd, quick_clock):
    """Its lag is known: 0.27 s from 1 m/s."""
    words = [*SIM, "--box", "-4 -4 0 4 4 8", "--speeds", "0.5,1", "--date", "today", "-o", str(output)]
    assert run(["identify", *words]) == 0, capfd.readouterr().err
    vehicle = read_vehicle(output)
    a, b = vehicle.velocities.horizontal_lag
    assert a + b == pytest.approx(0.27, abs=0.03)
    assert vehicle.identified.date == "today"
    assert vehicle.identified.hover_throttle is None
    assert output.read_text().startswith("# alula-provenance: ")
    assert run(["info", str(output), "-q"]) == 0
    assert "by the first guess: measured" in capfd.readouterr().err  # that of ArduPilot


def test_an_interrupted_flight_lands_and_leaves_no_file(output, capfd, quick_clock):
    quick_clock.interrupt_s = 8.0
    words = ["identify", *SIM, "--box", "-4 -4 0 4 4 3", "--speeds", "0.5,1", "-o", str(output)]
    assert run(words) == 130
    lines = capfd.readouterr().err.splitlines()
    assert any("step: +x" in line for line in lines)
    assert not any("step: -x" in line for line in lines)
    assert "no file was written" in lines[-1]
    assert any("disarmed" in line for line in lines)
    assert list(output.parent.iterdir()) == []
