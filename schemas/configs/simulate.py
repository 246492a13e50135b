"""Parameters of `simulate`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from alula.schemas.configs.plan import AlongPlanConfig
from alula.schemas.errors import UsageError
from alula.schemas.filter_options import PolytopeCbfParameters
from alula.schemas.filters.values import complaint, config_field, entries, limits

DEFAULT_RADIUS_M = 0.1
DEFAULT_SPEED_M_S = 1.0

# Fields that apply only to flights among the hulls of a cover, and only among the ellipsoids of a scene.
HULLS_ONLY = ("gain", *entries(PolytopeCbfParameters))
ELLIPSOIDS_ONLY = (
    *("sigma", "confidence", "inflation_m", "plant", "guide", "guide_parameters", "catch_up_m_s"),
    *("interface", "pairs", "controller_ticks", "filter_ticks"),
)
# Fields that determine the random pairs.
SAMPLING_ONLY = ("pairs", "bounds", "margin_m", "separation")


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulateConfig(AlongPlanConfig):
    """Parameters of `simulate`; None stands for the value of the plan or the vehicle, or for the default."""

    name: str = field(default="run", metadata={"help": "Name of the run, for reports."})
    filter: str = field(
        default="polytope-cbf", metadata={"help": "Safety filter, or none.", "metavar": "NAME"}
    )
    radius_m: float | None = field(
        default=None,
        metadata={
            "help": "Radius of the vehicle [m]; default: that of its file, else the plan's, "
            f"else {DEFAULT_RADIUS_M}.",
            "option": "--radius",
        },
    )
    speed_m_s: float | None = field(
        default=None,
        metadata={
            "help": f"In a cover: speed limit [m/s]; default: that of the vehicle's file, else 1.5 times the "
            f"plan's, else {DEFAULT_SPEED_M_S}. In a scene: peak speed of the references; default: "
            f"{DEFAULT_SPEED_M_S}.",
            "option": "--speed",
        },
    )
    gain: float = field(default=2.0, metadata={"help": "In a cover: gain c of the nominal controller [1/s]."})
    beta: float = config_field(PolytopeCbfParameters, "beta")
    kappa_per_m: float = config_field(PolytopeCbfParameters, "kappa_per_m", option="--kappa")
    smoothing: Literal["sound", "paper"] = config_field(PolytopeCbfParameters, "smoothing")
    onboard: bool = config_field(PolytopeCbfParameters, "onboard")
    trials: int | None = field(
        default=None, metadata={"help": "Number of random start-goal pairs; default: 100."}
    )
    bounds: tuple[float, float, float, float, float, float] | None = field(
        default=None,
        metadata={
            "help": "Box for starts and goals, XMIN YMIN ZMIN XMAX YMAX ZMAX [m]; "
            "default: on each axis the central 98 % of the hulls' vertices or of the Gaussians' centres.",
            "metavar": "BOX",
        },
    )
    margin_m: float = field(
        default=0.05,
        metadata={"help": "Extra clearance of random starts and goals [m].", "option": "--margin"},
    )
    separation: float = field(
        default=0.3,
        metadata={"help": "Minimum distance from start to goal, as a fraction of the box's diagonal."},
    )
    stop_fraction: float = field(
        default=0.01,
        metadata={
            "help": "The goal is reached within this fraction of the distance from start to goal, or within "
            "1 mm; in a scene within 5 cm."
        },
    )
    dt_s: float = field(
        default=0.01,
        metadata={
            "help": "Time step of filter and vehicle [s]; a quadrotor is integrated in steps of at most "
            "1 ms.",
            "option": "--dt",
        },
    )
    max_time_s: float | None = field(
        default=None,
        metadata={
            "help": "Maximum duration of a flight [s]; longer ones fail. Default: 10 s plus the plan's "
            "duration, or plus the time for five diagonals of the box at the speed limit; in a scene three "
            "times the reference's duration.",
            "option": "--max-time",
        },
    )
    log_rate_hz: float = field(
        default=20.0, metadata={"help": "Samples per second in the log.", "option": "--log-rate"}
    )
    sigma: float = field(
        default=1.0,
        metadata={"help": "Level of the scene's ellipsoids, in standard deviations."},
    )
    confidence: float | None = field(
        default=None, metadata={"help": "Probability inside the ellipsoid; sets sigma by the chi-square law."}
    )
    inflation_m: float | None = field(
        default=None,
        metadata={
            "help": "Length that filters add to the radius [m]; default: suggested by the scene's alignment.",
            "option": "--inflate",
        },
    )
    plant: Literal["quadrotor", "double-integrator"] | None = field(
        default=None,
        metadata={
            "help": "Vehicle model in a scene; a double integrator realises every acceleration exactly. "
            "Default: the model of the vehicle's file."
        },
    )
    guide: str = field(
        default="none",
        metadata={
            "help": "In a scene: filter of accelerations, cone-di or safer-splat, that changes the nominal "
            "command before the safety filter gets it.",
            "metavar": "NAME",
        },
    )
    catch_up_m_s: float | None = field(
        default=None,
        metadata={
            "help": "In a scene: speed above the reference's at which the controller lets a delayed vehicle "
            "catch up [m/s]; default: that of the vehicle's file, else half the reference's peak speed.",
            "option": "--catch-up",
        },
    )
    interface: Literal["wrench", "body-rates"] = field(
        default="wrench",
        metadata={"help": "Command of a quadrotor: thrust and torque, or thrust and body rates."},
    )
    controller_ticks: int = field(
        default=1,
        metadata={"help": "In a scene: time steps for which the controller's command is held."},
    )
    filter_ticks: int = field(
        default=1,
        metadata={"help": "In a scene: time steps for which the filter's input is held."},
    )
    pairs: Literal["any", "blocked"] = field(
        default="any",
        metadata={
            "help": "In a scene: which random pairs to fly. blocked: only pairs for which the vehicle's "
            "sphere with --inflate, moved along the straight line, meets an ellipsoid."
        },
    )
    planned: bool = field(
        default=False,
        metadata={
            "help": "Plan each pair in the cover, as alula plan does, and fly the plans; without it, every "
            "pair is flown straight at its goal. Pairs without a plan are flown straight."
        },
    )
    seed: int = field(default=0, metadata={"internal": True})
    filter_parameters: Mapping[str, Any] = field(default_factory=dict, metadata={"internal": True})
    guide_parameters: Mapping[str, Any] = field(
        default_factory=dict, metadata={"internal": True, "option": "--set guide.NAME"}
    )

    def __post_init__(self) -> None:
        """Refuse values out of range or of the wrong kind."""
        AlongPlanConfig.__post_init__(self)
        _between("--dt", self.dt_s, 1e-5, 1.0)
        if self.radius_m is not None:
            _between("--radius", self.radius_m, 0.0, 1e3)
        if self.speed_m_s is not None:
            _between("--speed", self.speed_m_s, 1e-3, 1e3)
        _between("--gain", self.gain, 1e-6, 1e6)
        parameters = entries(PolytopeCbfParameters)
        _between("--beta", self.beta, *limits(parameters["beta"].meta))
        _between("--kappa", self.kappa_per_m, *limits(parameters["kappa_per_m"].meta))
        _between("--margin", self.margin_m, 0.0, 1e3)
        _between("--separation", self.separation, 0.0, 0.9)
        _between("--stop-fraction", self.stop_fraction, 1e-6, 0.5)
        _between("--log-rate", self.log_rate_hz, 0.01, 1e5)
        if self.trials is not None:
            _between("--trials", self.trials, 1, 1_000_000)
        if self.max_time_s is not None:
            _between("--max-time", self.max_time_s, self.dt_s, 1e5)
        if self.bounds is not None and not all(self.bounds[i] < self.bounds[i + 3] for i in range(3)):
            raise UsageError("--bounds needs XMIN < XMAX, YMIN < YMAX and ZMIN < ZMAX")
        if wrong := complaint(parameters["smoothing"], self.smoothing):
            raise UsageError(f"--smoothing {wrong}")
        if self.onboard and self.filter != "polytope-cbf":
            raise UsageError("--onboard is for the filter polytope-cbf")
        _between("--sigma", self.sigma, 0.01, 100)
        if self.confidence is not None and not (0 < self.confidence < 1):
            raise UsageError(f"--confidence must be between 0 and 1, not {self.confidence}")
        if self.inflation_m is not None:
            _between("--inflate", self.inflation_m, 0.0, 1e3)
        if self.plant not in (None, "quadrotor", "double-integrator"):
            raise UsageError(f"--plant must be quadrotor or double-integrator, not {self.plant!r}")
        if self.interface not in ("wrench", "body-rates"):
            raise UsageError(f"--interface must be wrench or body-rates, not {self.interface!r}")
        if self.catch_up_m_s is not None:
            _between("--catch-up", self.catch_up_m_s, 1e-6, 1e6)
        _between("--controller-ticks", self.controller_ticks, 1, 1000)
        _between("--filter-ticks", self.filter_ticks, 1, 1000)
        if self.pairs not in ("any", "blocked"):
            raise UsageError(f"--pairs must be any or blocked, not {self.pairs!r}")
        if not self.name.strip():
            raise UsageError("--name must not be empty")

    def check_gains(self) -> None:
        """Refuse gains that are too high for the time step; they apply only among hulls."""
        for option, gain, limit in (("--gain", self.gain, 2), ("--beta", self.beta, 1)):
            if gain * self.dt_s > limit * (1 + 1e-12):
                raise UsageError(
                    f"{option} must be at most {limit} / dt = {limit / self.dt_s:g} at --dt {self.dt_s:g}, "
                    f"not {gain:g}"
                )


def _between(option: str, value: float, low: float, high: float) -> None:
    if not (low <= value <= high) or not math.isfinite(value):
        raise UsageError(f"{option} must be between {low:g} and {high:g}, not {value:g}")
