"""What a vehicle does by itself in an emergency, read before take-off: its failsafes and its own fence."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto

import numpy as np

from alula.schemas.arrays import FloatArray


class Action(Enum):
    """What a failsafe does."""

    NONE = auto()
    STOP_OR_LAND = auto()
    """It brakes, lands where it is, or stops the motors."""
    RETURN = auto()
    """It flies home as `WayHome` says."""
    RETRACE = auto()
    """It flies back roughly along the way it came."""


@dataclass(frozen=True, slots=True)
class Failsafe:
    """A failsafe of a vehicle.

    Attributes:
        cause: what triggers it, in words that follow "when".
        setting: the parameter that selects the action, with its value.
        stays: the parameter, "to", and the value with which it does not fly home.
    """

    cause: str
    action: Action
    setting: str
    stays: str


@dataclass(frozen=True, slots=True)
class WayHome:
    """The way home: straight up, level to above the take-off position, straight down.

    Attributes:
        height_m: height of the level part above the take-off position, if nothing else says more or less [m].
        climb_m: it climbs at least this far [m].
        slope: the level part is at most this many times as high as it is long; infinite without this bound.
        lowest_m: minimum height of the level part [m].
        highest_m: maximum height of the level part, where the vehicle is not higher already [m].
        setting: the parameter with `height_m`, with its value.
    """

    height_m: float
    climb_m: float = 0.0
    slope: float = math.inf
    lowest_m: float = 0.0
    highest_m: float = math.inf
    setting: str = ""

    @property
    def jumps_m(self) -> tuple[float, ...]:
        """Distances from home beyond which the height of the level part is suddenly another one [m]."""
        return ()

    def heights(self, above_m: FloatArray, away_m: FloatArray) -> FloatArray:
        """Height of the level part above the take-off position, shape (T,) [m].

        It does not fall where height or distance of the vehicle grow.

        Args:
            above_m: height of the vehicle above the take-off position, shape (T,) [m].
            away_m: horizontal distance from it, shape (T,) [m].
        """
        least = np.maximum(above_m + max(self.climb_m, 0.0), self.lowest_m)
        level = np.maximum(self.height_m, least)
        if math.isfinite(self.slope):
            level = np.minimum(level, np.maximum(self.slope * away_m, least))
        found: FloatArray = np.maximum(np.minimum(level, self.highest_m), above_m)
        return found


@dataclass(frozen=True, slots=True)
class OwnSafety:
    """Failsafes and fence of a vehicle.

    Attributes:
        failsafes: all that are known, also those without an action.
        not_home: why it may fly elsewhere than `way_home` says; empty if it does not.
        lowest_m, highest_m: heights of its fence above the take-off position [m].
        farthest_m: radius of its fence around the take-off position [m].
        fence: the parameters of its fence, with their values.
        unknown: parameters that the vehicle did not report although they decide.
        unjudged: what exists and cannot be judged, a sentence each.
        alone_s: longest time from this program's last message until it begins to stop [s]; NaN if unknown.
        watched_s: the same if only this program ends or stalls, and a watchdog acts; NaN without one.
    """

    failsafes: tuple[Failsafe, ...]
    way_home: WayHome
    not_home: tuple[str, ...] = ()
    lowest_m: float = -math.inf
    highest_m: float = math.inf
    farthest_m: float = math.inf
    fence: str = ""
    unknown: tuple[str, ...] = ()
    unjudged: tuple[str, ...] = ()
    alone_s: float = math.nan
    watched_s: float = math.nan
