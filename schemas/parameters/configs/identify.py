"""Parameters of `identify`."""

from __future__ import annotations

from dataclasses import dataclass

from msgspec import Meta

from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.config import Config, box_option, internal, option, require_within
from alula.schemas.parameters.configs.flight import FlightConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifyConfig(FlightConfig):
    """Parameters of `identify`."""

    box: tuple[float, float, float, float, float, float] = box_option(
        help="Box that is free, and that the vehicle must not leave, XMIN YMIN ZMIN XMAX YMAX ZMAX [m]; the "
        "vehicle stands below its centre."
    )
    rates: bool = option(False, "Also fly steps of the body rates and of the thrust.")
    reserve_m: float = option(
        0.5,
        "Distance that a step keeps from the box beyond the vehicle's radius and its predicted travel and "
        "braking [m].",
        within=(0, 100),
    )
    name: str = option("", "Name of the vehicle in its file; default: that of --vehicle.")
    date: str = option("", "Date of the flight, to be recorded in the file; default: none.")
    speeds_m_s: tuple[float, ...] = internal((0.5, 1.0, 2.0))

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        require_within("--rate", self.rate_hz, Meta(ge=20))
        for speed in self.speeds_m_s:
            require_within("--speeds", speed, Meta(ge=0.1, le=15))
        if len(set(self.speeds_m_s)) < 2 or len(set(self.speeds_m_s)) != len(self.speeds_m_s):
            raise UsageError(
                "--speeds needs at least two different speeds, for a lag that grows with the speed"
            )
