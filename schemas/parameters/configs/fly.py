"""Parameters of `fly`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.flight import FlightConfig, require_between
from alula.schemas.parameters.configs.plan import MARGIN_M, AlongPlanConfig
from alula.schemas.parameters.filter_options import PolytopeCbfParameters
from alula.schemas.parameters.filters.values import config_field, entries, limits
from alula.schemas.parameters.flight_defaults import IN_A_COVER, IN_A_SCENE


@dataclass(frozen=True, slots=True, kw_only=True)
class FlyConfig(AlongPlanConfig, FlightConfig):
    """Parameters of `fly`; None stands for a value of the plan or the vehicle, or for a default."""

    name: str = field(default="flight", metadata={"group": "Log", "help": "Name of the flight, for reports."})
    filter: str = field(
        default=IN_A_COVER,
        metadata={
            "help": f"Safety filter, or none; in a scene without a cover {IN_A_SCENE} is the default.",
            "metavar": "NAME",
        },
    )
    margin_m: float = field(
        default=MARGIN_M,
        metadata={
            "help": "Distance that filters keep beyond the vehicle's radius, for errors of tracking and "
            "state [m].",
            "option": "--margin",
        },
    )
    fence: tuple[float, float, float, float, float, float] | None = field(
        default=None,
        metadata={
            "help": "Box that the vehicle must not leave, XMIN YMIN ZMIN XMAX YMAX ZMAX [m]; default: the "
            "plan's box and 2 m around it.",
            "metavar": "BOX",
        },
    )
    fence_map: bool = field(
        default=False,
        metadata={
            "group": "Geofence",
            "help": "The geofence also keeps the vehicle's radius from the hulls of the cover.",
        },
    )
    fence_reserve_m: float = field(
        default=0.05,
        metadata={
            "group": "Geofence",
            "help": "Distance that the geofence keeps beyond the radius, for errors of its model [m].",
            "option": "--fence-reserve",
        },
    )
    gain: float = field(
        default=2.0,
        metadata={"group": "Filter", "help": "Gain c of the nominal controller, among hulls [1/s]."},
    )
    beta: float = config_field(PolytopeCbfParameters, "beta", group="Filter")
    kappa_per_m: float = config_field(PolytopeCbfParameters, "kappa_per_m", option="--kappa", group="Filter")
    speed_m_s: float | None = field(
        default=None,
        metadata={
            "help": "Maximum speed of velocity set-points [m/s]; default: 1.5 times the plan's speed.",
            "option": "--speed",
        },
    )
    velocity_lag_s: float | tuple[float, float, float] | None = field(
        default=None,
        metadata={
            "group": "Filter",
            "help": "Lag with which the vehicle follows velocity set-points [s], of all axes: 1.25 times the "
            "duration of 63 % of a stop from --speed, in the slowest direction; default: by axis, from the "
            "vehicle's file, which alula identify writes, else that of ArduPilot Copter with its default "
            "parameters. Too long is safe, too short is not.",
            "option": "--velocity-lag",
        },
    )
    sigma: float = field(
        default=1.0,
        metadata={
            "group": "Filter",
            "help": "Level of the scene's ellipsoids as obstacles, in standard deviations.",
        },
    )
    inflation_m: float | None = field(
        default=None,
        metadata={
            "group": "Filter",
            "help": "Distance that filters among ellipsoids add to radius and margin [m]; default: as "
            "suggested by the scene's alignment.",
            "option": "--inflate",
        },
    )
    catch_up_m_s: float | None = field(
        default=None,
        metadata={
            "group": "Filter",
            "help": "Speed above that of the reference with which a vehicle may catch up among ellipsoids "
            "[m/s]; default: from the vehicle's file, else half the plan's speed.",
            "option": "--catch-up",
        },
    )
    frame_check: Literal["motion", "hand", "none"] = field(
        default="motion",
        metadata={
            "group": "Flight",
            "help": "Check that the vehicle's frame is the map's. motion: in flight, by the motion; hand: "
            "also before take-off, by moves of the vehicle by hand along the map's axes.",
        },
    )
    fallback_s: float = field(
        default=3.0,
        metadata={
            "group": "Flight",
            "help": "Maximum time in which filter or geofence may fly a fallback; then the vehicle holds "
            "[s].",
            "option": "--fallback",
        },
    )
    max_time_s: float | None = field(
        default=None,
        metadata={
            "group": "Flight",
            "help": "Maximum duration of the flight of the plan, after which the vehicle lands [s]; "
            "default: 10 s plus three times its duration.",
            "option": "--max-time",
        },
    )
    allow_blocked: bool = field(
        default=False,
        metadata={
            "group": "Flight",
            "help": "Fly a plan that is not proven to be clear of the map (plan --allow-blocked), "
            "behind the filter alone.",
        },
    )
    replan_after_s: float = field(
        default=2.0,
        metadata={
            "group": "New plans",
            "help": "Make a new plan when the filter has held the vehicle up for so long [s]; 0 makes none.",
            "option": "--replan-after",
        },
    )
    replans: int = field(
        default=5,
        metadata={
            "group": "New plans",
            "help": "Maximum number of new plans that are asked for in a flight.",
        },
    )
    log_rate_hz: float = field(
        default=100.0,
        metadata={"group": "Log", "help": "Rate of samples in the log [Hz].", "option": "--log-rate"},
    )
    filter_parameters: Mapping[str, Any] = field(default_factory=dict, metadata={"internal": True})

    def __post_init__(self) -> None:
        """Refuse values that are out of range."""
        AlongPlanConfig.__post_init__(self)
        FlightConfig.__post_init__(self)
        parameters = entries(PolytopeCbfParameters)
        for option, value, low, high in (
            ("--margin", self.margin_m, 0.0, 100.0),
            ("--fence-reserve", self.fence_reserve_m, 0.0, 10.0),
            ("--gain", self.gain, 1e-6, 2 * self.rate_hz),
            ("--beta", self.beta, limits(parameters["beta"].meta)[0], self.rate_hz),
            ("--kappa", self.kappa_per_m, *limits(parameters["kappa_per_m"].meta)),
            ("--sigma", self.sigma, 0.01, 100.0),
            ("--fallback", self.fallback_s, 0.1, 60.0),
            ("--replan-after", self.replan_after_s, 0.0, 1e3),
            ("--replans", self.replans, 1, 1000),
            ("--log-rate", self.log_rate_hz, 0.1, 500.0),
        ):
            require_between(option, value, low, high)
        for option, given, low, high in (
            ("--speed", self.speed_m_s, 1e-3, 100.0),
            ("--inflate", self.inflation_m, 0.0, 100.0),
            ("--catch-up", self.catch_up_m_s, 1e-6, 1e3),
            ("--max-time", self.max_time_s, 1.0, 1e5),
        ):
            if given is not None:
                require_between(option, given, low, high)
        lags = self.velocity_lag_s
        for lag in () if lags is None else lags if isinstance(lags, tuple) else (lags,):
            require_between("--velocity-lag", lag, 0.0, 5.0)
        if self.fence is not None and not all(self.fence[i] < self.fence[i + 3] for i in range(3)):
            raise UsageError("--fence needs XMIN < XMAX, YMIN < YMAX and ZMIN < ZMAX")
        if self.frame_check not in ("motion", "hand", "none"):
            raise UsageError(f"--frame-check must be motion, hand or none, not {self.frame_check!r}")
        if not self.name.strip():
            raise UsageError("--name must not be empty")
