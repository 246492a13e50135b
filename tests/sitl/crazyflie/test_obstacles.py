"""The app built with OBSTACLES in the Crazyflie's real firmware dodges balls reported by its parameters."""

import threading
import time

import numpy as np
import pytest

from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.clearance import hull_obstacles, path_clearance
from alula.stages.compression.hulls import Hulls
from alula.stages.compression.onboard.layout import encode_map
from support.paths import VEHICLES
from support.scenes.small_scenes import box_cover
from support.vehicles.crazyflie_host import crazyflie

pytestmark = [pytest.mark.sitl, pytest.mark.realtime]

BODY_M = read_vehicle(VEHICLES / "crazyflie21.toml").body.radius_m
HALF, HIGH = 25, 22  # of the room [voxels of 0.1 m]
OUT = HALF + 3
COVER = box_cover(
    [
        ((HALF, -OUT, 0), (OUT, OUT, HIGH)),
        ((-OUT, -OUT, 0), (-HALF, OUT, HIGH)),
        ((-OUT, HALF, 0), (OUT, OUT, HIGH)),
        ((-OUT, -OUT, 0), (OUT, -HALF, HIGH)),
        ((-OUT, -OUT, HIGH), (OUT, OUT, HIGH + 3)),
        ((-OUT, -OUT, -1), (OUT, OUT, 0)),
    ]
)
CENTRE = np.array([0.0, 0.0, 1.0])
BALL_M, FROM_M, AFTER_S = 0.12, 4.0, 1.5
POSITION_SD_M, VELOCITY_SD_M_S = 0.03, 0.1  # of the reports


class Ball:
    """A ball that flies straight from a place at a time of the vehicle."""

    def __init__(self, number, begin_s, place, velocity):
        self.number, self.begin_s, self.place, self.velocity = number, begin_s, place, velocity

    def at(self, time_s):
        """Place at times of the vehicle [m]."""
        return self.place + np.multiply.outer(np.asarray(time_s) - self.begin_s, self.velocity)


class Reporter:
    """Sends a ball by eight parameters, again and again.

    Attributes:
        spent_s: duration of each report [s].
    """

    def __init__(self, firmware, vehicle, rng):
        self.firmware, self.vehicle, self.rng = firmware, vehicle, rng
        self.ball, self.spent_s, self._lives = None, [], True
        self._answers = {}
        self._heard = threading.Condition()
        firmware.param.add_update_callback(group="alulaBall", cb=self._hear)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _hear(self, name, value):
        with self._heard:
            self._answers[name] = self._answers.get(name, 0) + 1
            self._value = value
            self._heard.notify_all()

    def _ask(self, name, request):
        with self._heard:
            before = self._answers.get(name, 0)
            request()
            return self._heard.wait_for(lambda: self._answers.get(name, 0) > before, 1.0)

    def report(self, ball):
        """Send one report; wait until the app has taken it."""
        begin_s, param = time.monotonic(), self.firmware.param
        ahead_s = float(np.median(self.spent_s[-20:])) if self.spent_s else 0.02
        place = ball.at(self.vehicle.truth[-1][1] + ahead_s) + POSITION_SD_M * self.rng.normal(size=3)
        velocity = ball.velocity + VELOCITY_SD_M_S * self.rng.normal(size=3)
        for name, value in zip(("x", "y", "z", "vx", "vy", "vz"), (*place, *velocity), strict=True):
            param.set_value(f"alulaBall.{name}", float(value))
        param.set_value("alulaBall.radius", BALL_M)
        name = "alulaBall.id"
        self._ask(name, lambda: param.set_value(name, ball.number))
        while self._lives:
            if self._ask(name, lambda: param.request_param_update(name)) and int(float(self._value)) == 0:
                break
        self.spent_s.append(time.monotonic() - begin_s)

    def _run(self):
        while self._lives:
            if self.ball is None:
                time.sleep(0.005)
            else:
                self.report(self.ball)

    def close(self):
        """Stop sending."""
        self._lives = False
        self._thread.join(5)


def dodge(folder, speed_m_s, throws, seed, has_reports=True):
    """Hover, and throw balls at the vehicle from random sides.

    Returns:
        Least distance of the body from each ball and from the walls [m], and the duration of reports [s].
    """
    import cflib.crtp
    from cflib.crazyflie import Crazyflie
    from cflib.crazyflie.syncCrazyflie import SyncCrazyflie

    cflib.crtp.init_drivers()
    rng = np.random.default_rng(seed)
    image = encode_map(COVER, indexed=True)
    with (
        crazyflie(folder, (0.0, 0.0, 0.0), "--seed", str(seed), image=image) as vehicle,
        SyncCrazyflie(f"udp://127.0.0.1:{vehicle.port}", cf=Crazyflie(rw_cache=None)) as linked,
    ):
        firmware = linked.cf
        if "alulaBall" not in firmware.param.toc.toc:
            pytest.skip("the app in ALULA_CRAZYFLIE was built without OBSTACLES")
        firmware.param.set_value("stabilizer.controller", 6)

        def hover(seconds):
            end_s = vehicle.truth[-1][1] + seconds
            while vehicle.truth[-1][1] < end_s:
                firmware.commander.send_position_setpoint(*map(float, CENTRE), 0.0)
                time.sleep(0.02)

        time.sleep(2.0)
        firmware.supervisor.send_arming_request(True)
        time.sleep(0.5)
        firmware.high_level_commander.takeoff(CENTRE[2], 3.0)
        time.sleep(5.0)
        hover(1.0)
        assert vehicle.truth[-1][4] > 0.9
        begin = len(vehicle.truth)
        reporter, balls = Reporter(firmware, vehicle, rng), []
        for number in range(throws):
            bearing, rise = rng.uniform(0, 2 * np.pi), rng.uniform(-0.2, 0.2)
            way = np.array([np.cos(bearing), np.sin(bearing), rise])
            way /= np.linalg.norm(way)
            now_s, *motion = vehicle.truth[-1][1:5]
            ball = Ball(1 + number % 255, now_s, np.array(motion) - FROM_M * way, speed_m_s * way)
            balls.append(ball)
            reporter.ball = ball if has_reports else None
            hover(FROM_M / speed_m_s + 0.5)
            reporter.ball = None
            hover(AFTER_S)
        reporter.close()
        rows = np.array(vehicle.truth[begin:])
    path = np.ascontiguousarray(rows[:, 2:5])
    near = []
    for ball in balls:
        fine_s = np.arange(ball.begin_s, ball.begin_s + FROM_M / speed_m_s + 0.5, 0.002)
        here = np.stack([np.interp(fine_s, rows[:, 1], path[:, axis]) for axis in range(3)], axis=1)
        near.append(np.linalg.norm(ball.at(fine_s) - here, axis=1).min() - BALL_M - BODY_M)
    clear = float(path_clearance(path, hull_obstacles(Hulls.from_cover(COVER))).min()) - BODY_M
    return np.array(near), clear, np.array(reporter.spent_s)


def test_it_dodges_reported_balls(tmp_path):
    near, clear, spent_s = dodge(tmp_path, 2.0, 5, 1)
    assert clear > 0.0
    assert np.all(near > 0.0), near
    assert np.median(spent_s) < 0.2
