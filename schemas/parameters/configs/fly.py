"""Parameters of `fly`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from msgspec import Meta

from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.config import (
    Config,
    box_option,
    config_field,
    internal,
    option,
    require_within,
)
from alula.schemas.parameters.configs.flight import FlightConfig
from alula.schemas.parameters.configs.plan import MARGIN_M, AlongPlanConfig
from alula.schemas.parameters.filter_options import PolytopeCbfParameters
from alula.schemas.parameters.flight_defaults import IN_A_COVER, IN_A_SCENE


@dataclass(frozen=True, slots=True, kw_only=True)
class FlyConfig(AlongPlanConfig, FlightConfig):
    """Parameters of `fly`; None stands for a value of the plan or the vehicle, or for a default."""

    name: str = option("flight", "Name of the flight, for reports.", group="Log")
    filter: str = option(
        IN_A_COVER,
        f"Safety filter, or none; in a scene without a cover {IN_A_SCENE} is the default.",
        metavar="NAME",
    )
    margin_m: float = option(
        MARGIN_M,
        "Distance that filters keep beyond the vehicle's radius, for errors of tracking and state [m].",
        within=(0, 100),
    )
    fence: tuple[float, float, float, float, float, float] | None = box_option(
        None,
        "Box that the vehicle must not leave, XMIN YMIN ZMIN XMAX YMAX ZMAX [m]; default: the plan's box "
        "and 2 m around it.",
    )
    fence_map: bool = option(
        False, "The geofence also keeps the vehicle's radius from the hulls of the cover.", group="Geofence"
    )
    fence_reserve_m: float = option(
        0.05,
        "Distance that the geofence keeps beyond the radius, for errors of its model [m].",
        group="Geofence",
        within=(0, 10),
    )
    gain: float = option(2.0, "Gain c of the nominal controller, among hulls [1/s].", group="Filter", ge=1e-6)
    beta: float = config_field(PolytopeCbfParameters, "beta", group="Filter")
    kappa_per_m: float = config_field(PolytopeCbfParameters, "kappa_per_m", group="Filter")
    speed_m_s: float | None = option(
        None,
        "Maximum speed of velocity set-points [m/s]; default: 1.5 times the plan's speed.",
        within=(1e-3, 100),
    )
    velocity_lag_s: float | tuple[float, float, float] | None = option(
        None,
        "Lag with which the vehicle follows velocity set-points [s], of all axes: 1.25 times the duration "
        "of 63 % of a stop from --speed, in the slowest direction; default: by axis, from the vehicle's "
        "file, which alula identify writes, else that of ArduPilot Copter with its default parameters. Too "
        "long is safe, too short is not.",
        group="Filter",
        within=(0, 5),
    )
    sigma: float = option(
        1.0,
        "Level of the scene's ellipsoids as obstacles, in standard deviations.",
        group="Filter",
        within=(0.01, 100),
    )
    inflation_m: float | None = option(
        None,
        "Distance that filters add to radius and margin [m]; default: as suggested by the scene's "
        "alignment, and for hulls what of that they have not grown by.",
        flag="--inflate",
        group="Filter",
        within=(0, 100),
    )
    catch_up_m_s: float | None = option(
        None,
        "Speed above that of the reference with which a vehicle may catch up among ellipsoids [m/s]; "
        "default: from the vehicle's file, else half the plan's speed.",
        group="Filter",
        within=(1e-6, 1e3),
    )
    frame_check: Literal["motion", "hand", "none"] = option(
        "motion",
        "Check that the vehicle's frame is the map's. motion: in flight, by the motion; hand: also before "
        "take-off, by moves of the vehicle by hand along the map's axes.",
        group="Flight",
    )
    fallback_s: float = option(
        3.0,
        "Maximum time in which filter or geofence may fly a fallback; then the vehicle holds [s].",
        group="Flight",
        within=(0.1, 60),
    )
    max_time_s: float | None = option(
        None,
        "Maximum duration of the flight of the plan, after which the vehicle lands [s]; default: 10 s plus "
        "three times its duration.",
        group="Flight",
        within=(1, 1e5),
    )
    allow_blocked: bool = option(
        False,
        "Fly a plan that is not proven to be clear of the map (plan --allow-blocked), behind the filter "
        "alone.",
        group="Flight",
    )
    replan_after_s: float = option(
        2.0,
        "Make a new plan when the filter has held the vehicle up for so long [s]; 0 makes none.",
        group="New plans",
        within=(0, 1e3),
    )
    replans: int = option(
        5, "Maximum number of new plans that are asked for in a flight.", group="New plans", within=(1, 1000)
    )
    log_rate_hz: float = option(100.0, "Rate of samples in the log [Hz].", group="Log", within=(0.1, 500))
    filter_parameters: Mapping[str, Any] = internal(dict)

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        require_within("--gain", self.gain, Meta(le=2 * self.rate_hz))
        require_within("--beta", self.beta, Meta(le=self.rate_hz))
        if self.frame_check not in ("motion", "hand", "none"):
            raise UsageError(f"--frame-check must be motion, hand or none, not {self.frame_check!r}")
        if not self.name.strip():
            raise UsageError("--name must not be empty")
