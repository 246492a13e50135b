"""Parameters of `simulate`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from alula.schemas.errors import UsageError
from alula.schemas.filter_options import PolytopeCbfParameters
from alula.schemas.filters.values import complaint, config_field, entries, limits

DEFAULT_RADIUS_M = 0.1
DEFAULT_SPEED_M_S = 1.0

# Fields that only flights among the hulls of a cover have, and those among the ellipsoids of a scene.
HULLS_ONLY = ("gain", *entries(PolytopeCbfParameters))
ELLIPSOIDS_ONLY = (
    *("sigma", "confidence", "inflation_m", "plant", "guide", "guide_parameters", "catch_up_m_s"),
    *("interface", "pairs"),
)
# Fields that say which random pairs are drawn.
SAMPLING_ONLY = ("pairs", "bounds", "margin_m", "separation")


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulateConfig:
    """Parameters of `simulate`; None stands for what the plan or the vehicle says, or for the default."""

    name: str = field(default="run", metadata={"help": "Name of the run, for reports."})
    filter: str = field(
        default="polytope-cbf", metadata={"help": "Safety filter, or none.", "metavar": "NAME"}
    )
    radius_m: float | None = field(
        default=None,
        metadata={
            "help": "Radius of the vehicle [m]; default: of its file, else the plan's, "
            f"else {DEFAULT_RADIUS_M}.",
            "option": "--radius",
        },
    )
    speed_m_s: float | None = field(
        default=None,
        metadata={
            "help": f"Speed limit [m/s]; default: of the vehicle's file, else 1.5 times a plan's, else "
            f"{DEFAULT_SPEED_M_S}. Among ellipsoids: peak of the references; default: {DEFAULT_SPEED_M_S}.",
            "option": "--speed",
        },
    )
    gain: float = field(default=2.0, metadata={"help": "Gain c of the nominal controller [1/s]."})
    beta: float = config_field(PolytopeCbfParameters, "beta")
    kappa_per_m: float = config_field(PolytopeCbfParameters, "kappa_per_m", option="--kappa")
    smoothing: Literal["sound", "paper"] = config_field(PolytopeCbfParameters, "smoothing")
    onboard: bool = config_field(PolytopeCbfParameters, "onboard")
    trials: int | None = field(
        default=None, metadata={"help": "Number of random start-goal pairs; default 100."}
    )
    bounds: tuple[float, float, float, float, float, float] | None = field(
        default=None,
        metadata={
            "help": "Box for starts and goals, XMIN YMIN ZMIN XMAX YMAX ZMAX [m]; "
            "default: the central 98 % of the hulls' vertices, or the Gaussians' centres, on each axis.",
            "metavar": "BOX",
        },
    )
    margin_m: float = field(
        default=0.05,
        metadata={"help": "Starts and goals are this much clearer than needed [m].", "option": "--margin"},
    )
    separation: float = field(
        default=0.3, metadata={"help": "Least start-goal distance, as a part of the box's diagonal."}
    )
    stop_fraction: float = field(
        default=0.01,
        metadata={
            "help": "Reached within this part of the start-goal distance, or 1 mm; among ellipsoids 5 cm."
        },
    )
    dt_s: float = field(
        default=0.01,
        metadata={
            "help": "Time step of filter and vehicle [s]; a rigid body moves in steps of at most 1 ms.",
            "option": "--dt",
        },
    )
    max_time_s: float | None = field(
        default=None,
        metadata={
            "help": "A flight that takes longer has failed [s]; default: 10 s, and five times the "
            "box's diagonal at the speed limit, or a plan's duration; among ellipsoids three times the "
            "reference's duration.",
            "option": "--max-time",
        },
    )
    log_rate_hz: float = field(
        default=20.0, metadata={"help": "Samples per second in the log.", "option": "--log-rate"}
    )
    sigma: float = field(
        default=1.0,
        metadata={"help": "Level of the scene's ellipsoids as obstacles, in standard deviations."},
    )
    confidence: float | None = field(
        default=None, metadata={"help": "Probability inside the ellipsoid; sets sigma by the chi-square law."}
    )
    inflation_m: float | None = field(
        default=None,
        metadata={
            "help": "What filters add to the radius [m]; default: what the scene's alignment suggests.",
            "option": "--inflate",
        },
    )
    plant: Literal["quadrotor", "double-integrator"] | None = field(
        default=None,
        metadata={
            "help": "What flies among ellipsoids; double-integrator: accelerations come true. "
            "Default: as the vehicle's file says."
        },
    )
    guide: str = field(
        default="none",
        metadata={
            "help": "Filter of accelerations that bends what the controller asks for among ellipsoids, "
            "before the filter: cone-di or safer-splat.",
            "metavar": "NAME",
        },
    )
    catch_up_m_s: float | None = field(
        default=None,
        metadata={
            "help": "How much faster than its reference the controller asks a vehicle that was held up among "
            "ellipsoids to fly [m/s]; default: of the vehicle's file, else half the reference's peak speed.",
            "option": "--catch-up",
        },
    )
    interface: Literal["wrench", "body-rates"] = field(
        default="wrench",
        metadata={"help": "What a quadrotor is told: thrust and torque, or thrust and body rates."},
    )
    pairs: Literal["any", "blocked"] = field(
        default="any",
        metadata={
            "help": "Random pairs among ellipsoids; blocked: only those whose straight line, swept by the "
            "vehicle's sphere and what filters add to it, meets an ellipsoid."
        },
    )
    seed: int = field(default=0, metadata={"internal": True})
    filter_parameters: Mapping[str, Any] = field(default_factory=dict, metadata={"internal": True})
    guide_parameters: Mapping[str, Any] = field(
        default_factory=dict, metadata={"internal": True, "option": "--set guide.NAME"}
    )

    def __post_init__(self) -> None:
        """Refuse values that mean nothing."""
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
        if self.pairs not in ("any", "blocked"):
            raise UsageError(f"--pairs must be any or blocked, not {self.pairs!r}")
        if not self.name.strip():
            raise UsageError("--name must not be empty")

    def check_gains(self) -> None:
        """Refuse gains that are too high for the time step; only flights among hulls have them."""
        for option, gain, most in (("--gain", self.gain, 2), ("--beta", self.beta, 1)):
            if gain * self.dt_s > most * (1 + 1e-12):
                raise UsageError(
                    f"{option} must be at most {most} / dt = {most / self.dt_s:g} at --dt {self.dt_s:g}, "
                    f"not {gain:g}"
                )


def _between(option: str, value: float, low: float, high: float) -> None:
    if not (low <= value <= high) or not math.isfinite(value):
        raise UsageError(f"{option} must be between {low:g} and {high:g}, not {value:g}")
