"""The watchdog process: it survives what ends its flight, and acts in time on every kind of line."""

import os
import pty
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import tty
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from alula.schemas.artifacts.artifact import write_artifact
from alula.stages.flight.links.mavlink.signing import Signer
from alula.stages.flight.watchdog.companion import REACTION_S, STALL_S
from support.scenes.small_scenes import box_cover, line_plan
from support.vehicles.autopilot_client import EXACT
from support.vehicles.fly_process import LOOSE
from support.vehicles.lockstep import _BRISK
from support.vehicles.mavlink_peer import m
from support.vehicles.served_autopilot import Served
from support.vehicles.sim_vehicle_process import free_port

GUIDED, LAND, BRAKE, LOITER = 4, 9, 17, 5
KEY = bytes(range(32))
LOOP = """
import os, socket, sys, time
from alula.stages.flight.links.mavlink.autopilots import mode_command
from alula.stages.flight.links.mavlink.transport import open_transport
from alula.stages.flight.links.mavlink.wire import Wire
from alula.stages.flight.links.addresses import parse_address
from alula.stages.flight.links.protocol import Ward
from alula.stages.flight.watchdog.watchdog import Watchdog
from pymavlink.dialects.v20 import ardupilotmega as m

address, is_in_control, seconds, key = sys.argv[1], sys.argv[2] == "True", float(sys.argv[3]), sys.argv[4]
line = open_transport(parse_address(address), 5.0, time.monotonic)
if address.startswith("udpin"):
    while (found := line.receive()) is None:
        time.sleep(0.01)
    line.use(found[1])

def parts(mode):
    number, values = mode_command((mode, 0))
    return Wire.parts(m.MAVLink_command_long_message(1, 1, number, 0, *values, 0, 0, 0, 0))

settings = {
    **{"system": 255, "component": 191, "vehicle": 1, "key": bytes.fromhex(key) or None, "link": 1},
    **{"control": 4, "stopping": 17, "landing": 9, "stop_name": "BRAKE", "land_name": "LAND"},
    **{"heartbeat": Wire.parts(m.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))},
    **{"stop": parts(17), "land": parts(9)},
}
stamp = round((time.time() - 1420070400) * 1e5)
watchdog = Watchdog(Ward(settings, lambda: line.place, lambda: (4, float("-inf"), stamp)))
print(watchdog.process.pid, flush=True)
end = time.monotonic() + seconds
while time.monotonic() < end:
    if watchdog.has_taken_over:
        print("taken over", flush=True)
        is_in_control = False
    while line.receive() is not None:
        pass
    line.send(b".")
    watchdog.beat(time.monotonic(), is_in_control=is_in_control)
    time.sleep(0.01)
watchdog.beat(time.monotonic(), is_in_control=False)
watchdog.close()
"""


class Vehicle:
    """Reads what the loop and its watchdog send; reports a mode five times a second, to whoever sent last."""

    def __init__(self, receive, send):
        self._receive, self._send = receive, send
        self.mode, self.follows = GUIDED, True
        self.frames, self.messages, self.dot_s, self._rest = [], [], 0.0, b""
        self._mav, self._lives = m.MAVLink(None, 1, 1), True
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        beat_s = 0.0
        while self._lives:
            if time.monotonic() - beat_s > 0.2:
                beat_s = time.monotonic()
                self.beat()
            try:
                data = self._rest + self._receive()
            except OSError:
                time.sleep(0.002)
                continue
            while data:
                if data[:1] == b".":
                    self.dot_s, data = time.monotonic(), data[1:]
                    continue
                length = 12 + data[1] + (13 if data[2] & 1 else 0) if len(data) > 2 else len(data) + 1
                if len(data) < length:
                    break
                self._take(data[:length])
                data = data[length:]
            self._rest = data

    def beat(self):
        """Report the mode."""
        with suppress(OSError):
            self._send(bytes(m.MAVLink_heartbeat_message(2, 3, 209, self.mode, 4, 3).pack(self._mav)))

    def _take(self, frame):
        (message,) = m.MAVLink(None).parse_buffer(frame)
        if message.get_type() == "COMMAND_LONG" and self.follows:
            self.mode = int(message.param2)
        self.frames.append(frame)
        self.messages.append((time.monotonic(), message))

    def orders(self):
        """Times and modes of the orders."""
        return [(at, int(each.param2)) for at, each in self.messages if each.get_type() == "COMMAND_LONG"]

    def close(self):
        self._lives = False
        self._thread.join(5)


class Datagrams:
    """A socket that answers to whoever sent last."""

    def __init__(self, own):
        self.own, self.peer = own, None

    def receive(self):
        data, self.peer = self.own.recvfrom(4096)
        return data

    def send(self, data):
        if self.peer is not None:
            self.own.sendto(data, self.peer)


@contextmanager
def line(kind):
    """Address of one kind for a loop, and how its vehicle receives and sends."""
    if kind == "serial":
        master, slave = pty.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        try:
            yield (
                f"serial:{os.ttyname(slave)}:57600",
                lambda: os.read(master, 4096),
                lambda data: os.write(master, data),
            )
        finally:
            os.close(master)
            os.close(slave)
        return
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM if kind == "tcp" else socket.SOCK_DGRAM) as own:
        if kind == "udp to":
            port = free_port()
            datagrams = Datagrams(own)
            datagrams.peer = ("127.0.0.1", port)
            own.setblocking(False)
            yield f"udpin:127.0.0.1:{port}", datagrams.receive, datagrams.send
            return
        own.bind(("127.0.0.1", 0))
        place = f"127.0.0.1:{own.getsockname()[1]}"
        if kind == "udp":
            own.setblocking(False)
            datagrams = Datagrams(own)
            yield f"udpout:{place}", datagrams.receive, datagrams.send
            return
        own.listen(1)
        found = []

        def connected():
            if not found:
                found.append(own.accept()[0])
                found[0].setblocking(False)
            return found[0]

        yield f"tcp:{place}", lambda: connected().recv(4096), lambda data: found and found[0].send(data)
        found[0].close()


@contextmanager
def watched(kind="udp", *, is_in_control=True, seconds=30.0, key=b""):
    """A loop in a process group of its own, its watchdog's process id, and the vehicle."""
    with line(kind) as (address, receive, send):
        vehicle = Vehicle(receive, send)
        words = (address, str(is_in_control), str(seconds), key.hex())
        loop = subprocess.Popen(
            [sys.executable, "-P", "-c", LOOP, *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        said = loop.stdout.readline()
        pid = int(said) if said else pytest.fail(loop.stderr.read())
        try:
            time.sleep(0.5)
            yield loop, pid, vehicle
        finally:
            for end, number in ((os.killpg, loop.pid), (os.kill, pid)):
                with suppress(ProcessLookupError):
                    end(number, signal.SIGKILL)
            loop.wait(5)
            vehicle.close()
            loop.stdout.close()
            loop.stderr.close()


def wait_for(condition, timeout_s=10.0):
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def is_gone(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True


@pytest.mark.parametrize("kind", ["udp", "udp to", "tcp", "serial"])
def test_a_loop_that_is_killed_is_replaced_at_once_on_every_kind_of_line(kind):
    with watched(kind) as (loop, pid, vehicle):
        assert vehicle.orders() == []
        loop.kill()
        wait_for(lambda: vehicle.mode == LAND)
        (first_s, stop), *_ = vehicle.orders()
        assert stop == BRAKE
        assert first_s - vehicle.dot_s < REACTION_S
        wait_for(lambda: is_gone(pid))
        loop.wait(5)
        said = loop.stderr.read()
        assert said.startswith("watchdog: the loop ended, 0.0")
        assert said.endswith("taking the vehicle over: BRAKE, then LAND\nwatchdog: the vehicle lands\n")


def test_a_group_that_is_stopped_is_replaced_and_learns_of_it_when_it_goes_on():
    with watched() as (loop, pid, vehicle):
        os.killpg(loop.pid, signal.SIGSTOP)
        wait_for(lambda: vehicle.orders())
        assert STALL_S - 0.02 < vehicle.orders()[0][0] - vehicle.dot_s < REACTION_S + 0.05
        wait_for(lambda: vehicle.mode == LAND)
        time.sleep(0.3)  # until that is reported
        os.killpg(loop.pid, signal.SIGCONT)
        assert loop.stdout.readline() == "taken over\n"
        wait_for(lambda: is_gone(pid))
        assert vehicle.mode == LAND


def test_signals_of_a_terminal_do_not_end_it():
    with watched() as (loop, pid, vehicle):
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP):
            os.kill(pid, number)
        assert os.getsid(pid) == pid
        time.sleep(0.3)
        assert vehicle.orders() == []
        loop.kill()
        wait_for(lambda: vehicle.orders())


def test_a_loop_that_ends_well_or_never_had_control_is_not_replaced():
    with watched(seconds=0.8) as (loop, pid, vehicle):
        assert loop.wait(5) == 0
        wait_for(lambda: is_gone(pid), 1.0)
        assert vehicle.frames == []
    with watched(is_in_control=False) as (loop, pid, vehicle):
        os.killpg(loop.pid, signal.SIGSTOP)
        time.sleep(0.5)
        os.killpg(loop.pid, signal.SIGKILL)
        wait_for(lambda: is_gone(pid), 1.0)
        assert vehicle.frames == []


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_the_pilots_mode_is_left_alone(number):
    with watched() as (loop, pid, vehicle):
        vehicle.mode = LOITER
        vehicle.beat()
        os.killpg(loop.pid, number)
        wait_for(lambda: is_gone(pid), 1.0)
        assert vehicle.frames == []


def test_signed_frames_are_accepted(tmp_path):
    with watched(key=KEY) as (loop, _, vehicle):
        loop.kill()
        wait_for(lambda: vehicle.orders())
        signer = Signer(KEY, file=tmp_path / "s", clock=time.monotonic, wall_clock=time.time)
        assert all(signer.accepts(frame, 255, 191) for frame in list(vehicle.frames))


def test_it_is_small_and_nearly_idle():
    with watched() as (_, pid, _):
        ticks = [_cpu_s(pid)]
        time.sleep(2.0)
        ticks.append(_cpu_s(pid))
        assert ticks[1] - ticks[0] < 0.1
        (size,) = (
            int(line.split()[1])
            for line in Path(f"/proc/{pid}/status").read_text().splitlines()
            if line.startswith("VmRSS")
        )
        print(f"{size / 1024:.1f} MiB, {50 * (ticks[1] - ticks[0]):.1f} % of a core")
        assert size < 20_000


class Flown(Served):
    """A simulated ArduPilot that lives in a thread, in real time; keeps when it left GUIDED."""

    def __init__(self, **parameters):
        super().__init__(EXACT, _BRISK | parameters)
        self.left_s, self._lives = None, True
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        was_guided = False
        while self._lives:
            self.tick(time.monotonic())
            is_guided = self.copter.mode.name == "GUIDED"
            if was_guided and not is_guided and self.left_s is None:
                self.left_s = time.monotonic()
            was_guided = is_guided
            time.sleep(0.003)

    def close(self):
        self._lives = False
        self._thread.join(5)
        self.socket.close()


def test_a_flight_that_was_stopped_says_so_and_ends_with_a_code_of_4(tmp_path, monkeypatch):
    monkeypatch.setattr("alula.stages.sim_vehicle.ardupilot.copter.ArduCopter.ARMING_DELAY_S", 0.1)
    write_artifact(tmp_path / "plan.npz", line_plan((0.0, 0.0, 0.6), (5.0, 0.0, 0.6), 12.0))
    write_artifact(tmp_path / "cover.npz", box_cover([((0, 30, 0), (50, 34, 30))]))
    served = Flown()
    words = [
        "fly",
        str(tmp_path / "plan.npz"),
        "--map",
        str(tmp_path / "cover.npz"),
        "--allow-other-map",
        *LOOSE,
    ]
    words += ["--link", f"udpout:127.0.0.1:{served.port}", "-o", str(tmp_path / "f.run.mcap")]
    with subprocess.Popen(
        [sys.executable, "-P", "-m", "alula.cli", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as fly:
        try:
            lines = []
            for line in fly.stderr:
                lines.append(line)
                if "flying the plan" in line:
                    break
            time.sleep(1.5)
            fly.send_signal(signal.SIGSTOP)
            stopped_s = time.monotonic()
            wait_for(lambda: served.left_s is not None, 2.0)
            time.sleep(0.8)
            fly.send_signal(signal.SIGCONT)
            _, rest = fly.communicate(timeout=60)
        finally:
            fly.kill()
            served.close()
    said = "".join(lines) + rest
    assert served.left_s - stopped_s < 0.5, said
    assert fly.returncode == 4, said
    assert " m when this program dies, " in said
    assert "watchdog: the loop stalled, 0.2" in said
    assert "taking the vehicle over: LAND\n" in said
    assert "watchdog took over: it stops the vehicle and lands it; Ctrl-C ends this program" in said
    assert "disarmed: the flight is over" in said
    ended = re.search(
        r"was not finished: watchdog took over \(the loop stalled for ([\d.]+) s\)$", said.strip()
    )
    assert ended is not None, said
    assert 0.9 < float(ended[1]) < 3.0  # 0.2 s until it acts, and 0.8 s
    assert not served.copter.is_armed


def _cpu_s(pid):
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
