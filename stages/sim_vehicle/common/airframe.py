"""Body of the simulated vehicle: the native plant above the ground, in north-east-down."""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np

from alula._core import Plant
from alula.schemas.errors import UsageError
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.sim_vehicle.common.quaternions import (
    Quat,
    Vector,
    added,
    from_euler,
    from_mrp,
    to_euler,
    to_mrp,
)
from alula.stages.vehicles.bodies import plant, quadrotor
from alula.stages.vehicles.frames import LocalFrame, flipped_body
from alula.stages.vehicles.ground import Footing, Ground

TICK_S = 1 / 400  # period of the autopilot, that of ArduPilot's main loop
_STEPS = 3  # steps of the plant in a tick: 1200 Hz
_LYING_UP = 0.5  # cosine of the tilt beyond which a touch-down leaves it lying
_FLIP = np.tile([1.0, -1.0, -1.0], 4)


class Motion(NamedTuple):
    """Motion of the vehicle; world north-east-down (NED) from the start, body forward-right-down (FRD).

    Attributes:
        position: in NED [m].
        velocity: in NED [m/s].
        attitude: unit quaternion w, x, y, z that turns FRD vectors into NED.
        omega: body rates in FRD [rad/s].
        acceleration: derivative of the velocity, in NED [m/s^2].
    """

    position: Vector
    velocity: Vector
    attitude: Quat
    omega: Vector
    acceleration: Vector = (0.0, 0.0, 0.0)


class Terrain:
    """Ground of a map in the north-east-down frame of a start.

    Args:
        start: where the vehicle stands at first, in the map, east-north-up [m].
    """

    def __init__(self, ground: Ground, start: Vector) -> None:
        x, y, z = start
        self._frame = LocalFrame(0.0, (-x, -y, -z))
        self._start_m = z
        self._footing = Footing(ground, np.array(start))

    def down(self, position: Vector) -> float:
        """Height of the ground below a position, both NED: positive below the start [m]."""
        return self._start_m - self._footing.height(self._frame.position_from_ned(np.array(position)))


class Airframe:
    """A quadrotor on or above the ground: a flat floor at height 0, or that of a map.

    The plant's own world is north-west-up. Both of its frames then turn into the autopilot's by the same half
    turn about x, which changes the signs of y and z of every vector of the state, Rodrigues parameters
    included. On the ground the vehicle stays at rest while its thrust is below its weight. After a touch-down
    it stands level and still, unless it was tilted by more than 60 degrees: then it lies there, whatever its
    rotors do.

    Args:
        vehicle: a quadrotor; its disturbances act.
        heading_rad: initial heading, clockwise from north [rad].
        terrain: what it can stand on and where it stands at first; None for a flat floor.

    Attributes:
        sensed: motion with the sensor noise and delay of the vehicle file.
        is_lying: whether it lies on its side or back.
        are_rotors_dead: fault: the rotors give no thrust.

    Raises:
        UsageError: the vehicle is no quadrotor.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        *,
        seed: int = 0,
        heading_rad: float = 0.0,
        terrain: Terrain | None = None,
    ) -> None:
        self.body = quadrotor(vehicle)
        self._vehicle, self._seed = vehicle, seed
        flown = plant(_turned(vehicle), seed=seed)
        if not isinstance(flown, Plant):
            raise UsageError(f"{vehicle.name} is a {vehicle.model}; a quadrotor is needed")
        self._plant = flown
        self._commands = np.zeros((_STEPS, 4))
        self._wrench = np.zeros((1, 4))
        self._noisy = bool(
            vehicle.disturbance.delay_s
            or vehicle.disturbance.position_noise_m
            or vehicle.disturbance.velocity_noise_m_s
            or vehicle.disturbance.attitude_noise_rad
            or vehicle.disturbance.rate_noise_rad_s
        )
        self.on_ground = True
        self._terrain = terrain
        self._ground_m = 0.0  # down
        self._stood: Vector | None = None  # position before a hand lifted it
        self.touchdown_m_s = 0.0
        self.is_lying = self.are_rotors_dead = False
        self.truth = self.sensed = Motion((0.0,) * 3, (0.0,) * 3, from_euler(0, 0, heading_rad), (0.0,) * 3)
        self._park()

    @property
    def is_carried(self) -> bool:
        """Return whether a hand holds it."""
        return self._stood is not None

    def carry(self, by: tuple[Vector, Vector, Vector] | None) -> None:
        """Move the vehicle as a hand does, level.

        Args:
            by: displacement from where it stood [m], velocity [m/s] and acceleration [m/s^2], all NED; None
                puts it back.
        """
        if by is None:
            if self._stood is not None:
                self._park()
                self._stood = None
            return
        if self._stood is None:
            self._stood = self.truth.position
        at = added(self._stood, by[0])
        self.truth = self.sensed = Motion(at, by[1], self.truth.attitude, (0.0,) * 3, by[2])

    def blow(self, wind_m_s: Vector) -> None:
        """Change the mean wind from now on; the rotors begin at hover again, which matters with a motor lag.

        Args:
            wind_m_s: in the axes of the vehicle file: east, north, up [m/s].
        """
        state = self._plant.state
        table = msgspec.structs.replace(self._vehicle.disturbance, wind_m_s=wind_m_s)
        self._vehicle = msgspec.structs.replace(self._vehicle, disturbance=table)
        flown = plant(_turned(self._vehicle), seed=self._seed)
        assert isinstance(flown, Plant)
        self._plant = flown
        self._plant.reset(state)

    @property
    def weight_n(self) -> float:
        """Weight, the thrust of hovering [N]."""
        return self.body.mass * self.body.gravity

    def step(self, thrust_n: float, torque: Vector) -> None:
        """Simulate one tick; when rotors saturate, roll and pitch have priority over thrust and yaw."""
        if self.on_ground and not (thrust_n or any(torque)):
            return
        x, y, z = torque
        self._wrench[0] = (max(thrust_n, 0.0), x, -y, -z)
        limited = np.zeros((1, 4)) if self.are_rotors_dead else self.body.limited(self._wrench)
        if self.on_ground:
            if self.is_lying or limited[0, 0] <= self.weight_n:
                return
            self.on_ground = False
        if self._terrain is not None:
            self._ground_m = self._terrain.down(self.truth.position)
        self._commands[:] = limited
        flown = self._plant
        flown.fly(TICK_S / _STEPS, self._commands)
        flown.switch_shadow()
        acceleration = flown.acceleration
        self.truth = _motion(flown.state, acceleration)
        self.sensed = _motion(flown.measured, acceleration) if self._noisy else self.truth
        if self.truth.position[2] > self._ground_m and self.truth.velocity[2] > 0:
            self.touchdown_m_s = max(self.touchdown_m_s, self.truth.velocity[2])
            self._park()

    def _park(self) -> None:
        x, y, _ = self.truth.position if self._stood is None else self._stood
        attitude = self.truth.attitude
        self.is_lying = _up(attitude) < _LYING_UP
        if not self.is_lying:
            attitude = from_euler(0, 0, to_euler(attitude)[2])
        state = np.concatenate([[x, y, self._ground_m], to_mrp(attitude), np.zeros(6)])
        self._plant.reset(state * _FLIP)
        self.truth = self.sensed = _motion(self._plant.state, [0.0, 0.0, 0.0])
        self.on_ground = True


def _up(attitude: Quat) -> float:
    return 1 - 2 * (attitude[1] ** 2 + attitude[2] ** 2)


def _motion(state: np.ndarray, acceleration: list[float]) -> Motion:
    px, py, pz, sx, sy, sz, vx, vy, vz, wx, wy, wz = state.tolist()
    ax, ay, az = acceleration
    attitude = from_mrp((sx, -sy, -sz))
    return Motion((px, -py, -pz), (vx, -vy, -vz), attitude, (wx, -wy, -wz), (ax, -ay, -az))


def _turned(vehicle: Vehicle) -> Vehicle:
    """The vehicle with its wind and gusts turned from east-north-up to the axes of this plant."""
    frame, table = LocalFrame(), vehicle.disturbance
    wind = flipped_body(frame.vector_to_ned(np.array(table.wind_m_s)))
    gust = np.abs(frame.vector_to_ned(np.array(table.gust_m_s)))
    changed = msgspec.structs.replace(table, wind_m_s=tuple(wind.tolist()), gust_m_s=tuple(gust.tolist()))
    return msgspec.structs.replace(vehicle, disturbance=changed)
