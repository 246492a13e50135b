"""Scenarios in a geofence, `alula/scenario` too: those with a table `[fence]`.

    name = "wall at 100 km/h"

    [fence]                                      # at least one of the three
    box_m = [-100, -100, 0.5, 40, 100, 100]      # XMIN YMIN ZMIN XMAX YMAX ZMAX
    faces = [[0.6, 0.8, 0.0, 30.0]]              # n, d: n . p <= d inside
    cover = "room.cover.npz"                     # keep out of its hulls; relative to this file

    [vehicle]
    file = "../vehicles/racer7.toml"             # relative to this file
    mass_scale = 1.2                             # true over assumed mass; the filter uses the file's

    [filter]
    name = "geofence"                            # or "backup-qp", "none"
    parameters = { reserve_m = 2.5, latency_s = 0.02 }

    [pilot]
    kind = "straight"                            # diagonal, fall, sticks, aggressive, silent, repeated
    heading_deg = 0.0

    [trials]
    count = 1
    start_m = [0, 0, 20]                         # or start_box_m = [XMIN, YMIN, ZMIN, XMAX, YMAX, ZMAX]

    [run]
    duration_s = 8.0

Every key but the fence, the vehicle's file and the start has a default. Such scenarios are upgraded to
version 2.0 to be flown, whose keys docs/theory/geofence.md explains. Source: Singletary et al. 2022 (arXiv
2201.04331).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from alula.schemas.errors import UsageError
from alula.schemas.filter_options import GeofenceParameters
from alula.schemas.manifest import VERSION
from alula.schemas.scenario import SCENARIO_SCHEMA
from alula.schemas.toml_file import first_beyond, has_key, read_changed

NotNegative = Annotated[float, Meta(ge=0)]
Positive = Annotated[float, Meta(gt=0)]
Scale = Annotated[float, Meta(ge=0.01, le=100)]
Vector = tuple[float, float, float]
Sizes = tuple[NotNegative, NotNegative, NotNegative]
Box = tuple[float, float, float, float, float, float]
Face = tuple[float, float, float, float]

MOST_TRIALS = 1_000_000
MOST_LATENCY = 32  # ticks: ALULA_GEOFENCE_LATENCY of native/onboard
MOST_FACES = 32  # ALULA_FENCE_FACES of native/onboard
FARTHEST_M = 1e4  # ALULA_FENCE_FAR of native/onboard


class _Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table of the file: unknown keys are refused."""


class FenceTable(_Table, frozen=True, kw_only=True):
    """The permitted region: inside the box and the faces, outside the hulls of the cover."""

    box_m: Box | None = None
    faces: Annotated[tuple[Face, ...], Meta(max_length=MOST_FACES)] = ()
    cover: str | None = None


class RacerTable(_Table, frozen=True, kw_only=True):
    """The vehicle's file, and deviations of the true plant from it; the filter uses the file's model.

    None stands for the value of the file.
    """

    file: str = ""
    radius_m: NotNegative | None = None
    mass_scale: Scale = 1.0
    thrust_scale: Scale = 1.0
    rate_gain_scale: Scale = 1.0
    delay_s: Annotated[float, Meta(ge=0, le=1)] | None = None
    linear_drag_n_s_m: Sizes | None = None
    quadratic_drag_n_s2_m2: Sizes | None = None
    wind_m_s: Vector | None = None
    gust_m_s: Sizes | None = None
    gust_time_s: Positive | None = None
    sag_share: Annotated[float, Meta(ge=0, lt=1)] | None = None
    sag_time_s: Positive | None = None


class GeofenceFilterTable(_Table, frozen=True, kw_only=True):
    """The filter; `none` flies the pilot's commands, and its flights are judged like all others."""

    name: Literal["geofence", "backup-qp", "none"] = "geofence"
    parameters: GeofenceParameters = GeofenceParameters()


class PilotTable(_Table, frozen=True, kw_only=True):
    """The simulated pilot."""

    kind: Annotated[
        Literal["straight", "diagonal", "fall", "sticks", "aggressive", "silent", "repeated"],
        Meta(
            description="straight, diagonal: tilted, permanently; fall: no throttle; sticks: random; "
            "aggressive: random attitudes; silent: aggressive, then no radio; repeated: from wall to wall"
        ),
    ] = "straight"
    heading_deg: Annotated[
        float,
        Meta(description="heading of straight and repeated; of diagonal 45 degrees to the left of it [deg]"),
    ] = 0.0
    tilt_deg: Annotated[
        Annotated[float, Meta(ge=0, lt=90)], Meta(description="tilt of straight, diagonal and repeated [deg]")
    ] = 72.0
    climb_m_s2: Annotated[float, Meta(description="vertical acceleration of diagonal [m/s^2]")] = 0.0
    silent_after_s: Annotated[
        NotNegative, Meta(description="minimum time until silent has no radio, at most twice as long [s]")
    ] = 1.5


class FenceTrialsTable(_Table, frozen=True, kw_only=True):
    """Number of flights, their seed, and their start: one state, or random safe states in a box."""

    count: Annotated[int, Meta(ge=1, le=MOST_TRIALS)] = 1
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 0
    start_m: Vector | None = None
    start_velocity_m_s: Vector = (0.0, 0.0, 0.0)
    start_yaw_deg: float = 0.0
    start_box_m: Box | None = None
    start_speed_m_s: Annotated[float, Meta(ge=0, le=200)] = 10.0
    start_tilt_deg: Annotated[float, Meta(ge=0, le=180)] = 57.3


class FenceRunTable(_Table, frozen=True, kw_only=True):
    """Times, outages and log settings. An outage without a duration lasts until the end of the flight."""

    duration_s: Annotated[float, Meta(gt=0, le=3600)] = 8.0
    plant_steps: Annotated[int, Meta(ge=1, le=1000)] = 4
    stale_from_s: NotNegative | None = None
    stale_for_s: NotNegative | None = None
    radio_from_s: NotNegative | None = None
    radio_for_s: NotNegative | None = None
    traces: Annotated[int, Meta(ge=0, le=1000)] = 20
    log_rate_hz: Positive = 50.0


class FenceScenario(_Table, frozen=True, kw_only=True):
    """A scenario file with a fence; with the files that it names it determines the flights."""

    fence: FenceTable
    schema: Literal["alula/scenario"] = SCENARIO_SCHEMA
    version: str = VERSION
    name: str = "geofence"
    vehicle: RacerTable = RacerTable()
    filter: GeofenceFilterTable = GeofenceFilterTable()
    pilot: PilotTable = PilotTable()
    trials: FenceTrialsTable = FenceTrialsTable()
    run: FenceRunTable = FenceRunTable()


def is_fence_scenario(path: Path) -> bool:
    """Return whether a scenario file has a fence."""
    return has_key(path, "fence")


def read_fence_scenario(path: Path, changes: Mapping[str, Any] | None = None) -> FenceScenario:
    """Read a scenario with a fence.

    Args:
        path: the file.
        changes: values that replace those of the file, by their keys with dots between: `vehicle.mass_scale`.

    Raises:
        InputError: the file cannot be read or is not TOML.
        VersionError: it was written for a later major version.
        UsageError: a key is unknown, of the wrong type or out of range; the message has its path.
    """
    scenario = read_changed(path, FenceScenario, SCENARIO_SCHEMA, changes)
    for key in ("start_m", "start_box_m"):
        if wrong := first_beyond(getattr(scenario.trials, key), f"$.trials.{key}", FARTHEST_M):
            raise UsageError(f"{path}: {wrong} must be below {FARTHEST_M:g} m")
    if wrong := first_beyond(scenario.fence.box_m, "$.fence.box_m", FARTHEST_M * (1 + 1e-12)):
        raise UsageError(f"{path}: {wrong} must be at most {FARTHEST_M:g} m")
    _check(path, scenario)
    return scenario


def _check(path: Path, scenario: FenceScenario) -> None:
    """Refuse keys that contradict each other."""

    def require(good: bool, where: str, words: str) -> None:
        if not good:
            raise UsageError(f"{path}: `$.{where}` {words}")

    fence, trials, run = scenario.fence, scenario.trials, scenario.run
    require(bool(scenario.name.strip()), "name", "must not be empty")
    require(
        fence.box_m is not None or bool(fence.faces) or fence.cover is not None,
        "fence",
        "needs box_m, faces or cover",
    )
    require(fence.cover is None or bool(fence.cover), "fence.cover", "must not be empty")
    is_qp = scenario.filter.name == "backup-qp"
    require(not is_qp or fence.cover is None, "filter.name", "backup-qp knows box and faces, but no cover")
    check_faces(fence.faces, "fence.faces", require)
    require(bool(scenario.vehicle.file), "vehicle.file", "is needed, a vehicle with a table [throttle]")
    given = trials.start_m is not None
    require(given or trials.start_box_m is not None, "trials", "needs start_m or start_box_m")
    require(not given or trials.start_box_m is None, "trials", "has both start_m and start_box_m")
    _check_unused(path, scenario)
    for where, box in (("fence.box_m", fence.box_m), ("trials.start_box_m", trials.start_box_m)):
        if box is not None:
            is_proper = all(low < high for low, high in zip(box[:3], box[3:], strict=True))
            require(is_proper, where, "needs XMIN < XMAX, YMIN < YMAX and ZMIN < ZMAX")
    for what in ("stale", "radio"):
        begins, lasts = getattr(run, f"{what}_from_s"), getattr(run, f"{what}_for_s")
        require(begins is not None or lasts is None, f"run.{what}_for_s", f"needs {what}_from_s")
    require(1e-3 <= run.log_rate_hz <= 1e5, "run.log_rate_hz", "must be between 0.001 and 100000")
    values = scenario.filter.parameters
    require(values.slow_m_s <= values.fast_m_s, "filter.parameters.fast_m_s", "must not be below slow_m_s")
    most = MOST_LATENCY * values.tick_s
    require(
        values.latency_s <= most, "filter.parameters.latency_s", f"is above {MOST_LATENCY} ticks, {most:g} s"
    )
    ticks = run.duration_s / values.tick_s
    require(ticks <= 1e7, "run.duration_s", f"has {ticks:.3g} ticks of the filter, more than 10,000,000")


def check_faces(faces: Sequence[Face], where: str, require: Callable[[bool, str, str], None]) -> None:
    """Check the half-spaces of a fence.

    Args:
        faces: (n, d) with n . p <= d inside, of a scenario.
        where: path of their key.
        require: refuses a value, from whether it is good, the path of its key and the rest of the sentence.
    """
    for i, face in enumerate(faces):
        length = math.hypot(*face[:3])
        require(1e-3 <= length <= 1e3, f"{where}[{i}]", f"needs a normal, and n has the length {length:.4g}")
        require(abs(face[3]) <= FARTHEST_M * length, f"{where}[{i}]", f"is farther than {FARTHEST_M:g} m")


def _check_unused(path: Path, scenario: FenceScenario) -> None:
    """Refuse keys of the other kind of start, which would have no effect."""
    table, default = scenario.trials, FenceTrialsTable()
    wrong, right = "start_box_m", "start_m"
    keys: tuple[str, ...] = ("start_velocity_m_s", "start_yaw_deg")
    if table.start_m is not None:
        wrong, right, keys = "start_m", "start_box_m", ("start_speed_m_s", "start_tilt_deg")
    for key in keys:
        if getattr(table, key) != getattr(default, key):
            raise UsageError(f"{path}: `$.trials.{key}` goes with {right}, and here is {wrong}")
