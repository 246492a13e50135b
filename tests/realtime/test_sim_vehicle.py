"""`alula sim-vehicle` end to end with stock pymavlink and third-party clients."""

import importlib.util
import json
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress

import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import write_artifact
from support.paths import ROOT
from support.scenes.small_scenes import box_cover
from support.vehicles.sim_vehicle_process import free_port, until, vehicle

GUIDED, LAND = 4, 9


def mavutil():
    return pytest.importorskip("pymavlink.mavutil", reason="pymavlink is needed")


def hop(client):
    """Arm, take off to 1.5 m and land with bare pymavlink; returns the maximum height."""

    def ordered(number, *params):
        values = [*params, *[0] * (7 - len(params))]
        client.mav.command_long_send(1, 1, number, 0, *values)
        while True:
            ack = client.recv_match(type="COMMAND_ACK", blocking=True, timeout=3)
            assert ack is not None
            if ack.command == number:
                return ack.result == 0

    assert client.wait_heartbeat(timeout=10) is not None
    until(lambda: ordered(176, 1, GUIDED))
    assert ordered(511, 32, 100000)  # LOCAL_POSITION_NED
    until(lambda: ordered(400, 1))  # without a position arming is refused, not the mode
    assert ordered(22, 0, 0, 0, 0, 0, 0, 1.5)

    def height():
        return -client.recv_match(type="LOCAL_POSITION_NED", blocking=True, timeout=3).z

    highest = until(lambda: (h := height()) > 1.3 and h)
    assert ordered(176, 1, LAND)

    def is_disarmed():
        beat = client.recv_match(type="HEARTBEAT", blocking=True, timeout=3)
        return not beat.base_mode & 128

    until(is_disarmed)
    return highest


def test_pymavlink_flies_it_over_datagrams_as_to_a_ground_station():
    util, port = mavutil(), free_port()
    client = util.mavlink_connection(f"udpin:127.0.0.1:{port}")
    with vehicle(f"udpout:127.0.0.1:{port}") as (process, link):
        assert link == f"udpout:127.0.0.1:{port}"
        assert hop(client) > 1.3
        process.send_signal(signal.SIGINT)
        assert process.wait(10) == 130
    client.close()


def test_a_stream_serves_one_client_after_another():
    util = mavutil()
    with vehicle("tcpin:127.0.0.1:0", "--duration", "20") as (_, link):
        place = link.removeprefix("tcpin:")
        for _ in range(2):
            client = util.mavlink_connection(f"tcp:{place}")
            assert client.wait_heartbeat(timeout=10) is not None
            client.close()


def test_it_ends_by_itself_after_its_duration():
    with vehicle("udpin:127.0.0.1:0", "--duration", "0.5") as (process, _):
        assert process.wait(10) == 0


@pytest.mark.slow
def test_mavsdk_arms_takes_off_and_lands_it():
    pytest.importorskip("mavsdk", reason="mavsdk 4 is needed: pip install --group dev")
    script = """
import sys, time
from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action.action import Action
from mavsdk.plugins.telemetry.telemetry import Telemetry

mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
assert mavsdk.add_any_connection(sys.argv[1]) == 0
system = mavsdk.first_autopilot(15.0)
assert system is not None
action, telemetry = Action(system), Telemetry(system)
telemetry.set_rate_position(20.0)
end = time.monotonic() + 40

def wait(condition):
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.1)

wait(lambda: telemetry.position().relative_altitude_m == telemetry.position().relative_altitude_m)
action.set_takeoff_altitude(1.5)
action.arm()
wait(telemetry.armed)
action.takeoff()
wait(lambda: telemetry.position().relative_altitude_m > 1.3)
action.land()
wait(lambda: not telemetry.armed())
print("landed", flush=True)
mavsdk.destroy()
"""
    with vehicle() as (_, link):
        url = link.replace("udpin:", "udpout://")
        done = subprocess.run(
            [sys.executable, "-P", "-c", script, url], capture_output=True, text=True, timeout=90
        )
    assert "landed" in done.stdout, done.stdout + done.stderr


@pytest.mark.slow
def test_mavproxy_arms_takes_off_and_lands_it(tmp_path):
    for needed in ("MAVProxy", "serial", "defusedxml"):
        if importlib.util.find_spec(needed) is None:
            pytest.skip("MAVProxy is needed: pip install --no-deps mavproxy, pyserial and defusedxml")
    with vehicle() as (_, link), (tmp_path / "out").open("w") as out:
        command = [sys.executable, "-m", "MAVProxy.mavproxy", "--default-modules=cmdlong,mode,arm,param"]
        command += [f"--master={link.replace('udpin', 'udpout')}", f"--state-basedir={tmp_path}"]
        command += [f"--logfile={tmp_path / 'log.tlog'}"]
        with subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=out, stderr=subprocess.STDOUT, text=True, cwd=tmp_path
        ) as proxy:

            def said():
                return (tmp_path / "out").read_text()

            def say(text, answer):
                """Repeat a command until it is accepted; before, the vehicle may refuse it."""
                for _ in range(15):
                    proxy.stdin.write(text + "\n")
                    proxy.stdin.flush()
                    end = time.monotonic() + 2
                    while time.monotonic() < end:
                        if answer in said():
                            return
                        time.sleep(0.05)
                pytest.fail(f"{text}: no {answer} in\n{said()}")

            def height():
                say("status LOCAL_POSITION_NED", "LOCAL_POSITION_NED {")
                return -float(
                    said().rpartition("LOCAL_POSITION_NED {")[2].partition(" z : ")[2].split(",")[0]
                )

            try:
                until(lambda: "Received" in said())
                say("mode guided", "Mode GUIDED")
                say("arm throttle", "ARMED")
                say("takeoff 1.5", "NAV_TAKEOFF: ACCEPTED")
                until(lambda: height() > 1.0)
                say("mode land", "Mode LAND")
                until(lambda: "DISARMED" in said())
            finally:
                proxy.kill()


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--link", "serial:/dev/ttyS0"], 2, "not one of udpout:HOST:PORT"),
        (["--link", "udpout:127.0.0.1:99999"], 2, "not one of"),
        (["--link", "udpout:192.0.2.1:14550"], 2, "--allow-remote"),
        (["--link", "tcpin:0.0.0.0:5760"], 2, "--allow-remote"),
        (["--link", "udpin:127.0.0.1:0", "--boot-time", "0"], 2, "--boot-time"),
        (["--link", "udpin:127.0.0.1:0", "--param", "NOPE=1"], 2, "no parameter is called 'NOPE'"),
        (["--link", "udpin:127.0.0.1:0", "--param", "GUID_OPTIONS"], 2, "NAME=VALUE"),
        (["--link", "udpin:127.0.0.1:0", "--mocap", "tcp:127.0.0.1:9"], 2, "must be udp:HOST:PORT"),
        (["--link", "udpin:127.0.0.1:0", "--mocap", "udp:192.0.2.1:9"], 2, "--allow-remote"),
        (["--link", "udpin:127.0.0.1:0", "--fault", "flood"], 2, "fault 'flood'"),
        (["--link", "udpin:127.0.0.1:0", "--vehicle", "none.toml"], 3, "none.toml"),
        (["--link", "udpin:127.0.0.1:0", "--signing-key", "none.key"], 3, "none.key"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line(options, code, words, capsys):
    assert run(["sim-vehicle", *options]) == code
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_a_link_that_cannot_be_opened_is_a_link_error(capsys):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        assert run(["sim-vehicle", "--link", f"udpin:127.0.0.1:{port}"]) == 6
    assert "already in use" in capsys.readouterr().err


def test_a_point_is_no_vehicle_and_a_key_is_64_digits(tmp_path, capsys):
    point = ROOT / "examples/vehicles/double-integrator.toml"
    assert run(["sim-vehicle", "--link", "udpin:127.0.0.1:0", "--vehicle", str(point)]) == 2
    assert "a quadrotor is needed" in capsys.readouterr().err
    for text in ("xyz", "ab" * 31):
        (tmp_path / "key").write_text(text)
        options = ["--link", "udpin:127.0.0.1:0", "--signing-key", str(tmp_path / "key")]
        assert run(["sim-vehicle", *options]) == 3
        assert "64 hexadecimal digits" in capsys.readouterr().err


def test_it_stands_on_the_ground_of_a_cover_or_says_that_there_is_none(tmp_path, capsys):
    cover = tmp_path / "step.cover.npz"
    write_artifact(cover, box_cover([((-10, 0, -2), (20, 40, 0))]))
    ground = ("--ground", str(cover), "--mocap-start", "0.5 2 0", "--duration", "0.2")
    with vehicle("udpin:127.0.0.1:0", *ground) as (process, _):
        assert process.wait(20) == 0
    crazyflie = ("--vehicle", "crazyflie21", "--duration", "0.2", "-q")
    assert run(["sim-vehicle", "--link", "udp://127.0.0.1:0", *ground[:4], *crazyflie]) == 0
    cover.write_bytes(b"no cover")
    assert run(["sim-vehicle", "--link", "udpin:127.0.0.1:0", *ground]) == 3
    assert "step.cover.npz" in capsys.readouterr().err
    assert run(["sim-vehicle", "--link", "udpin:127.0.0.1:0", *ground[2:]]) == 2
    assert "--mocap-start needs --mocap or --ground" in capsys.readouterr().err


def test_a_vehicle_with_a_key_answers_who_signs(tmp_path):
    util, key = mavutil(), bytes(range(32))
    (tmp_path / "key").write_text(key.hex() + "\n")
    with vehicle("udpin:127.0.0.1:0", "--signing-key", str(tmp_path / "key")) as (_, link):
        client = util.mavlink_connection(link.replace("udpin", "udpout"), source_system=255)

        def answers():
            client.mav.param_request_read_send(1, 1, b"GUID_OPTIONS", -1)
            return client.recv_match(type="PARAM_VALUE", blocking=True, timeout=0.5)

        assert not answers()
        client.setup_signing(key, sign_outgoing=True)
        assert until(answers, 10).get_signed()
        client.close()


def test_motion_capture_sees_it_until_a_fault():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as camera:
        camera.bind(("127.0.0.1", 0))
        camera.settimeout(3)
        address = f"udp:127.0.0.1:{camera.getsockname()[1]}"
        options = (
            "--mocap",
            address,
            "--heading",
            "90",
            "--fault",
            "mocap-loss:start=0.5",
            "--duration",
            "1",
        )
        with vehicle("udpin:127.0.0.1:0", *options) as (process, _):
            seen = json.loads(camera.recv(1024))
            assert seen["position_m"] == pytest.approx([0, 0, 0], abs=0.01)
            assert seen["attitude_wxyz"] == pytest.approx([1, 0, 0, 0], abs=1e-6)  # east is x
            assert process.wait(10) == 0
        camera.setblocking(False)
        times = [seen["time_s"]]
        with suppress(BlockingIOError):
            while True:
                times.append(json.loads(camera.recv(1024))["time_s"])
    assert 0.3 < max(times) < 0.51
    assert len(times) > 20
