"""Parameters of a Crazyflie that flights need: set, verified and restored."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from alula.schemas.errors import LinkError
from alula.stages.flight.links.crazyflie.session import Session

_CONTROLLER, _ESTIMATOR, _HIGH_LEVEL = (
    "stabilizer.controller",
    "stabilizer.estimator",
    "commander.enHighLevel",
)
_RESET = "kalman.resetEstimation"
_INITIAL = ("kalman.initialX", "kalman.initialY", "kalman.initialZ", "kalman.initialYaw")
_KALMAN = 2

Pose = tuple[NDArray[Any], NDArray[Any]]


class Parameters:
    """Temporary changes to parameters.

    Args:
        named: values of other parameters from the address, by name.
    """

    def __init__(self, session: Session, controller: int, named: Mapping[str, float]) -> None:
        self._session, self._controller, self._named = session, controller, dict(named)
        self._changed: dict[str, tuple[float, float]] = {}  # old value, value that was set

    def change(self, pose: Pose | None) -> list[str]:
        """Set the parameters that a flight needs; a line for each change.

        Args:
            pose: position, shape (3,) [m], and attitude w, x, y, z from motion capture, vehicle's frame; the
                vehicle's estimate is reset to it. None without motion capture.

        Raises:
            LinkError: the vehicle does not have or accept one.
        """
        lines = self.set({**self._named, _CONTROLLER: self._controller})
        if self._session.read(_ESTIMATOR) != 3:  # 3: the unscented one estimates a position too
            lines += self.set({_ESTIMATOR: _KALMAN})
        if self._session.read(_HIGH_LEVEL) is not None:  # older firmwares need it
            lines += self.set({_HIGH_LEVEL: 1})
        if pose is not None:
            lines += self._begin_at(pose)
        return lines

    def set(self, values: Mapping[str, float]) -> list[str]:
        """Set parameters; a line for each change.

        Raises:
            LinkError: the vehicle does not have or accept one.
        """
        lines = []
        for name, value in values.items():
            present = self._session.read(name)
            if present is None:
                group = name.partition(".")[0]
                there = self._session.names(group)
                has = f"; {group} has {', '.join(there)}" if there else f"; it has no group {group}"
                raise LinkError(f"the vehicle has no parameter {name}{has}")
            if math.isclose(present, value, rel_tol=1e-6, abs_tol=1e-9):
                continue
            # Remembered before writing: a value that may or may not have been accepted is restored too.
            self._changed.setdefault(name, (present, value))
            self._changed[name] = (self._changed[name][0], value)
            if not self._session.write(name, value):
                raise LinkError(f"the vehicle did not take {name} = {value:g}")
            lines.append(f"{name}: {present:g} -> {value:g}")
        return lines

    def restore(self, timeout_s: float) -> list[str]:
        """Restore all changes within `timeout_s` [s], the newest first; a line for each failure."""
        lines = []
        clock = self._session.options.clock
        end_s = clock() + timeout_s
        for name, (before, ours) in reversed(self._changed.items()):
            present = self._session.read(name)
            if present is not None and not math.isclose(present, ours, rel_tol=1e-6, abs_tol=1e-9):
                lines.append(f"{name} was changed by others to {present:g} and stays so; it was {before:g}")
            elif not self._session.write(name, before, max(end_s - clock(), 0.0)):
                lines.append(f"{name} could not be put back: set it to {before:g}")
        self._changed.clear()
        return lines

    def leave(self) -> list[str]:
        """Leave all changes in place; a line for each."""
        lines = [
            f"{name} stays {ours:g}; it was {before:g}" for name, (before, ours) in self._changed.items()
        ]
        self._changed.clear()
        return lines

    def _begin_at(self, pose: Pose) -> list[str]:
        w, x, y, z = pose[1].tolist()
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        lines = []
        if all(self._session.read(name) is not None for name in _INITIAL):
            lines = self.set(dict(zip(_INITIAL, [*pose[0].tolist(), yaw], strict=True)))
        for value in (1.0, 0.0):
            if not self._session.write(_RESET, value, keeps=False):
                raise LinkError(f"the vehicle did not take {_RESET} = {value:g}")
        return lines
