"""Which firmware the simulated vehicle is: the one place where it is chosen."""

from __future__ import annotations

from dataclasses import dataclass

from alula.stages.sim_vehicle.ardupilot.copter import Copter
from alula.stages.sim_vehicle.ardupilot.dialogue import Dialogue
from alula.stages.sim_vehicle.ardupilot.modes import Mode
from alula.stages.sim_vehicle.ardupilot.telemetry import Telemetry
from alula.stages.sim_vehicle.px4.modes import SWITCH
from alula.stages.sim_vehicle.px4.protocol import Px4Dialogue, Px4Telemetry
from alula.stages.sim_vehicle.px4.vehicle import Px4Copter


@dataclass(frozen=True, slots=True)
class Personality:
    """A firmware: the same body, estimator and loops with other manners.

    Attributes:
        copter: modes, arming, failsafes and names of parameters.
        telemetry: what it tells unasked, and its own messages.
        dialogue: commands, encodings, and which set-points it takes.
        switch: places of the pilot's switch by name, for the fault `mode`.
    """

    copter: type[Copter]
    telemetry: type[Telemetry]
    dialogue: type[Dialogue]
    switch: dict[str, int]


PERSONALITIES: dict[str, Personality] = {
    "ardupilot": Personality(Copter, Telemetry, Dialogue, {mode.name: int(mode) for mode in Mode}),
    "px4": Personality(Px4Copter, Px4Telemetry, Px4Dialogue, SWITCH),
}
