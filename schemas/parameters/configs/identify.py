"""Parameters of `identify`."""

from __future__ import annotations

from dataclasses import dataclass, field

from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.flight import FlightConfig, require_between


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifyConfig(FlightConfig):
    """Parameters of `identify`."""

    box: tuple[float, float, float, float, float, float] = field(
        metadata={
            "help": "Box that is free, and that the vehicle must not leave, XMIN YMIN ZMIN XMAX YMAX ZMAX "
            "[m]; the vehicle stands below its centre.",
            "metavar": "BOX",
        }
    )
    rates: bool = field(
        default=False,
        metadata={"help": "Also fly steps of the body rates and of the thrust."},
    )
    reserve_m: float = field(
        default=0.5,
        metadata={
            "help": "Distance that a step keeps from the box beyond the vehicle's radius and its predicted "
            "travel and braking [m].",
            "option": "--reserve",
        },
    )
    name: str = field(
        default="", metadata={"help": "Name of the vehicle in its file; default: that of --vehicle."}
    )
    date: str = field(
        default="", metadata={"help": "Date of the flight, to be recorded in the file; default: none."}
    )
    speeds_m_s: tuple[float, ...] = field(default=(0.5, 1.0, 2.0), metadata={"internal": True})

    def __post_init__(self) -> None:
        """Refuse values that are out of range."""
        FlightConfig.__post_init__(self)
        if not all(self.box[i] < self.box[i + 3] for i in range(3)):
            raise UsageError("--box needs XMIN < XMAX, YMIN < YMAX and ZMIN < ZMAX")
        for option, value, low, high in (
            ("--reserve", self.reserve_m, 0.0, 100.0),
            ("--rate", self.rate_hz, 20.0, 500.0),
            *(("--speeds", speed, 0.1, 15.0) for speed in self.speeds_m_s),
        ):
            require_between(option, value, low, high)
        if len(set(self.speeds_m_s)) < 2 or len(set(self.speeds_m_s)) != len(self.speeds_m_s):
            raise UsageError(
                "--speeds needs at least two different speeds, for a lag that grows with the speed"
            )
