"""`alula sim-vehicle --link udp://…`: the simulated Crazyflie in a process of its own."""

import json
import signal
import subprocess
import sys
import time

import pytest

from alula.cli.main import run
from support.paths import VEHICLES

CRAZYFLIE = VEHICLES / "crazyflie21.toml"
LINK = ("sim-vehicle", "--link", "udp://127.0.0.1:0")


def test_a_flight_leads_a_simulated_crazyflie_by_its_address() -> None:
    pytest.importorskip("cflib", reason="cflib, of the extra crazyflie, is not there")
    from alula.stages.flight.links.open_link import open_link
    from alula.stages.flight.links.protocol import Order

    words = [*LINK, "--vehicle", str(CRAZYFLIE), "--param", "alula.vmax=2", "--heading", "90", "--json"]
    command = [sys.executable, "-P", "-m", "alula.cli", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            place = json.loads(process.stdout.readline())["link"].removeprefix("udpin:")
            link = open_link(f"udp://{place}?controller=oot&alula.vmax=1.5")
            assert "CRTP 12" in link.open(10.0)
            assert "alula.vmax: 2 -> 1.5" in link.prepare()
            w, _, _, z = link.state.attitude_wxyz
            assert (w, z) == pytest.approx((0.7071, -0.7071), abs=5e-3)  # clockwise from above
            link.order(Order.ARM, time.monotonic())
            end = time.monotonic() + 5
            while not link.status.armed and time.monotonic() < end:
                link.poll(time.monotonic())
                time.sleep(0.01)
            assert link.status.armed
            link.close()
        finally:
            process.send_signal(signal.SIGINT)
        assert process.wait(10) == 130


@pytest.mark.parametrize(
    ("more", "text"),
    [
        ((), "needs --vehicle"),
        (("--vehicle", str(CRAZYFLIE), "--param", "alula.none=1"), "no parameter alula.none"),
        (("--vehicle", str(CRAZYFLIE), "--param", "stabilizer.controller=900"), "cannot be 900"),
        (("--vehicle", str(CRAZYFLIE), "--fault", "drop"), "has no --fault"),
    ],
)
def test_what_a_crazyflie_does_not_have_is_refused(more, text, capsys) -> None:
    assert run([*LINK, *more]) == 2
    assert text in capsys.readouterr().err
