"""Flights of `identify`'s steps in lock-step with the simulated autopilot; nobody waits."""

from __future__ import annotations

import math

from alula.schemas.parameters.configs.identify import IdentifyConfig
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.flight.links.open_link import open_link
from alula.stages.flight.links.options import LinkOptions
from alula.stages.flight.loop.checks import FlightChecks
from alula.stages.flight.loop.control_loop import ControlLoop
from alula.stages.identification.survey import (
    make_step_flight,
    make_step_guard,
    make_step_needs,
    make_step_options,
    make_survey,
)
from alula.stages.sim_vehicle.common.quaternions import cos_tilt
from alula.stages.sim_vehicle.px4.vehicle import Px4Copter
from alula.stages.vehicles.frames import LocalFrame
from alula.stages.vehicles.own_limits import PARAMETERS
from support.vehicles.autopilot_client import EXACT
from support.vehicles.fake_vehicle import Kept
from support.vehicles.mavlink_peer import Time
from support.vehicles.served_autopilot import Served

BOX = (-8.0, -8.0, 0.0, 8.0, 8.0, 16.0)
SLOW_LANDING = {"LAND_SPEED": 120.0, "WPNAV_SPEED_DN": 150.0, "FS_THR_ENABLE": 3.0, "FS_DR_ENABLE": 1.0}


class SurveyFlight(Served):
    """The simulated autopilot with ArduPilot's defaults, and a flight of steps on it."""

    fast = SLOW_LANDING

    def __init__(self, *, noise=EXACT, parameters=None, vehicle=FASTBRIDGE, **fields):
        super().__init__(noise, parameters)
        self.config = IdentifyConfig(**{"box": BOX, "speeds_m_s": (1.0, 2.0)} | fields)
        self.guess, self.recorder, self.truth, self.largest_lean = vehicle, Kept(), [], 0.0

    def tick(self, now):
        super().tick(now)
        truth = self.copter.airframe.truth
        self.truth.append((now, *truth.position))
        self.largest_lean = max(self.largest_lean, math.acos(max(-1.0, min(1.0, cos_tilt(truth.attitude)))))

    def fly(self, each=lambda flight: None):
        time = Time(self)
        rates = self.config.rates
        options = LinkOptions(
            frame=LocalFrame(), clock=time, sleep=time.sleep, flies_rates=rates, watches_throttle=True
        )
        self.link = link = open_link(f"udpout:127.0.0.1:{self.port}?system=1", options)
        link.clock = time
        try:
            self.said = link.open(5.0)
            link.prepare()
            self.parameters = link.read_parameters(PARAMETERS)
            self.survey = survey = make_survey(self.config, self.guess, self.parameters)
            self.steps = make_step_flight(
                survey,
                throttle=lambda: link.hover.newest,
                say=lambda now_s, words: self.loop.say(now_s, 2, words),
            )
            self.loop = ControlLoop(
                link,
                self.steps,
                make_step_guard(survey, link.accepts),
                self.steps,
                FlightChecks(make_step_needs(survey), observe_s=0.4),
                float(survey.centre[2]),
                self.recorder,
                make_step_options(survey, dry_run=False),
                clock=time,
                sleep=time.sleep,
            )
            each(self)
            self.loop.run()
        finally:
            link.close()
            self.socket.close()
        return self


class Px4Survey(SurveyFlight):
    """The same on the simulated PX4."""

    kind, fast = Px4Copter, {"MPC_TKO_SPEED": 5.0, "MPC_TKO_RAMP_T": 0.25}
