"""`alula sim-vehicle --autopilot px4` end to end with a third-party client, and its refusals."""

import subprocess
import sys

import pytest

from alula.cli.main import run
from support.vehicles.sim_vehicle_process import vehicle

PX4 = ("--autopilot", "px4", "--boot-time", "1")
QUICK = {"MPC_TKO_RAMP_T": 0.25, "MPC_TKO_SPEED": 3, "MPC_LAND_SPEED": 1.2, "COM_DISARM_LAND": 0.5}
FAST = tuple(word for name, value in QUICK.items() for word in ("--param", f"{name}={value}"))

MAVSDK = """
import sys, time
from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action.action import Action
from mavsdk.plugins.offboard.offboard import Offboard, OffboardError, VelocityNedYaw
from mavsdk.plugins.telemetry.telemetry import Telemetry

mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
assert mavsdk.add_any_connection(sys.argv[1]) == 0
system = mavsdk.first_autopilot(15.0)
assert system is not None
action, telemetry, offboard = Action(system), Telemetry(system), Offboard(system)
telemetry.set_rate_position_velocity_ned(20.0)
end = time.monotonic() + 45

def wait(condition):
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)

place = lambda: telemetry.position_velocity_ned().position
wait(lambda: telemetry.health().is_armable and telemetry.health().is_global_position_ok)
action.set_takeoff_altitude(1.5)
action.arm()
wait(telemetry.armed)
action.takeoff()
wait(lambda: place().down_m < -1.2)
offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
try:
    offboard.start()
    early = "taken"
except OffboardError as error:
    early = str(error)
time.sleep(1.2)
offboard.start()
print("early", early, flush=True)
start = place()
offboard.set_velocity_ned(VelocityNedYaw(1.0, -0.5, 0.0, 0.0))
wait(lambda: place().north_m - start.north_m > 1.5)
assert place().east_m - start.east_m < -0.5
offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
time.sleep(0.5)
offboard.stop()
action.land()
wait(lambda: not telemetry.armed())
print("landed", flush=True)
mavsdk.destroy()
"""


@pytest.mark.slow
def test_mavsdk_flies_px4_by_its_offboard_plugin_and_lands_it():
    pytest.importorskip("mavsdk", reason="mavsdk 4 is needed: pip install --group dev")
    with vehicle("udpin:127.0.0.1:0", *PX4, *FAST, quick=()) as (_, link):
        url = link.replace("udpin:", "udpout://")
        done = subprocess.run(
            [sys.executable, "-P", "-c", MAVSDK, url], capture_output=True, text=True, timeout=90
        )
    assert "landed" in done.stdout, done.stdout + done.stderr
    assert "early taken" not in done.stdout  # a stream shorter than a second does not count


@pytest.mark.parametrize("hand", [(), ("--hand",)], ids=["by itself", "by hand"])
def test_px4_is_there_when_the_command_is_given(hand, capsys):
    command = ["sim-vehicle", "--link", "udpin:127.0.0.1:0", *PX4, "--duration", "0.1"]
    assert run([*command, *hand]) == 0
    assert "is on udpin:127.0.0.1:" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--param", "GUID_OPTIONS=8"], "no parameter is called 'GUID_OPTIONS'"),
        (["--autopilot", "betaflight"], "is not one of"),
        (["--fault", "mode:amount=guided"], "'guided' is not a number"),
    ],
)
def test_what_px4_does_not_have_is_refused_in_one_line(options, words, capsys):
    assert run(["sim-vehicle", "--link", "udpin:127.0.0.1:0", "--autopilot", "px4", *options]) == 2
    assert words in capsys.readouterr().err
