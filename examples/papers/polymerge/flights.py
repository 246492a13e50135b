"""Figure 5 and Table II of PolyMerge: flights over the same pairs, through maps and among the ellipsoids."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from alula.schemas.errors import InputError
from alula.stages.reporting.statistics import Estimate, Rate, mean_estimate, rate, ratio_estimate
from alula.stages.reporting.table import HIGH, LOW, Table
from papers.published import POLYMERGE_FLIGHTS

OURS, RULE, COACD, SAFER = "ours", "paper's rule", "surface + CoACD", "safer-splat"
_NO_ENDS = (None, None, None)


@dataclass(frozen=True, slots=True)
class Flights:
    """All pairs of a scene, flown with one map and filter; one entry of each tuple per pair.

    Attributes:
        scene: its name.
        method: of the map or filter, such as `OURS`.
        hulls: of the map; None among ellipsoids.
        rate_hz: of the filter.
        reached: whether the vehicle came within the goal's tolerance.
        distance_m: minimum distance of the vehicle's centre to the ellipsoids; negative inside [m].
        map_distance_m: the same to the finest cover, which the paper takes for the truth; or empty [m].
        path_m: length of the flown path [m].
        radius_m: of the vehicle [m].
        inside: whether the pair's start or goal is closer to the map than the radius, where the filter
            guarantees nothing.
        steps: of each flight.
        filter_us: time of the filter per step, mean of the fastest 99 %, on one thread; 0: not measured [us].
        tolerance: of the goal, in words.
    """

    scene: str
    method: str
    hulls: int | None
    rate_hz: float
    reached: tuple[bool, ...]
    distance_m: tuple[float, ...]
    map_distance_m: tuple[float, ...]
    path_m: tuple[float, ...]
    radius_m: float
    inside: tuple[bool, ...]
    steps: tuple[int, ...]
    filter_us: float
    tolerance: str

    def __post_init__(self) -> None:
        """Refuse lists of different lengths."""
        lists = (self.reached, self.distance_m, self.path_m, self.steps, self.inside)
        if len({len(each) for each in lists}) > 1:
            raise InputError(f"{self.scene}, {self.method}: the lists of flights have different lengths")

    @property
    def collided(self) -> tuple[bool, ...]:
        """Flights that came closer to an ellipsoid than the radius."""
        return tuple(d < self.radius_m - 1e-6 for d in self.distance_m)

    @property
    def succeeded(self) -> tuple[bool, ...]:
        """Flights that reached the goal without a collision."""
        return tuple(r and not c for r, c in zip(self.reached, self.collided, strict=True))

    @property
    def outside(self) -> tuple[int, ...]:
        """Numbers of the pairs with both ends outside the map."""
        return tuple(i for i, is_inside in enumerate(self.inside) if not is_inside)

    @property
    def collided_outside(self) -> int:
        """Number of collisions of pairs with both ends outside the map."""
        return sum(self.collided[i] for i in self.outside)

    @property
    def success(self) -> Rate:
        """Fraction of the flights that succeeded [%]."""
        return rate(self.succeeded)


def from_record(record: Mapping[str, Any]) -> Flights:
    """Make the flights of a record of JSON.

    Raises:
        InputError: a field is missing or unknown.
    """
    values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in record.items()}
    try:
        return Flights(**values)
    except TypeError as error:
        raise InputError(f"a record of flights: {error}") from error


def path_ratio(theirs: Flights, ours: Flights, among: Sequence[Flights]) -> Estimate | None:
    """Path length of another method over ours, over the pairs in which all methods succeed (Figure 5c)."""
    each = [all(row) for row in zip(*(f.succeeded for f in among), strict=True)]
    pick = [i for i, good in enumerate(each) if good]
    return ratio_estimate([theirs.path_m[i] for i in pick], [ours.path_m[i] for i in pick])


def nearest(flights: Flights, distance_m: Sequence[float]) -> float | None:
    """Minimum distance over the pairs with both ends outside the map; None without such pairs [m]."""
    return min((distance_m[i] for i in flights.outside if distance_m), default=None)


def flight_ms(flights: Flights) -> float:
    """Time of the filter in a mean flight [ms]."""
    return 1e-3 * flights.filter_us * sum(flights.steps) / max(1, len(flights.steps))


def time_ratio(theirs: Flights, ours: Flights) -> Estimate | None:
    """Filter time per flight of another method over ours, over all pairs (Figure 5a)."""
    return ratio_estimate(
        [theirs.filter_us * n for n in theirs.steps], [ours.filter_us * n for n in ours.steps]
    )


def figure_5_table(flights: Sequence[Flights]) -> Table:
    """Tabulate Figure 5: run time, success and relative path length of each method."""
    rows: list[tuple[Any, ...]] = []
    for scene in dict.fromkeys(f.scene for f in flights):
        here = [f for f in flights if f.scene == scene]
        ours = next((f for f in here if f.method == OURS), None)
        for f in here:
            path = None
            if ours is not None and f is not ours:
                path = path_ratio(f, ours, [g for g in here if g.method in (OURS, f.method)])
            rows.append(
                (
                    *(scene, f.method, f.hulls, len(f.reached)),
                    *(sum(f.reached), sum(f.collided), f.collided_outside, sum(f.inside), *f.success.cells),
                    *(min(f.distance_m), f.filter_us, flight_ms(f)),
                    *((path.value, path.low, path.high, path.n) if path is not None else (*_NO_ENDS, None)),
                )
            )
    columns = (
        *("scene", "method", "hulls", "flights", "reached", "collided", "of these, from outside the map"),
        "start or goal inside the map",
        *("success [%]", LOW, HIGH, "minimum distance to an ellipsoid [m]", "filter per step [µs]"),
        *("filter per flight [ms]", "path / ours", LOW, HIGH, "pairs"),
    )
    note = (
        "All methods of a scene fly the same pairs, whose ends are clear of the ellipsoids, not of the "
        "hulls; safer-splat flies a double integrator, the others a single integrator. Success: the goal "
        "reached within 1 % of its distance, without coming closer to an ellipsoid than the radius. "
        "Distances are those of the vehicle's centre to the ellipsoids, over the whole path. Time: of the "
        "filter alone, on one thread, mean of the fastest 99 % of the steps. Path: over the pairs that "
        "this method and ours fly without a collision."
    )
    return Table("figure-5", "Figure 5: run time, success and path length", columns, tuple(rows), note)


def table_2(flights: Sequence[Flights]) -> Table:
    """Tabulate Table II: success and minimum distance by number of hulls, beside the published values."""
    note = (
        "Pairs whose straight line meets an ellipsoid, the same for every number of hulls, clear of the "
        "150 hulls. Success: within 5 cm of the goal. Minimum distances are over the flights with both "
        "ends outside the map: inside a coarse hull the filter guarantees nothing, and a flight that "
        "leaves it may touch what the hull covers. The paper measures to its 150 polytopes, over ten "
        "flights for each number."
    )
    return _by_hulls(flights, "table-2", "Table II: flights over the number of hulls", note)


def table_2_in_firmware(flights: Sequence[Flights]) -> Table:
    """Tabulate Table II as the Crazyflie's firmware flies it with the app."""
    note = (
        "The Crazyflie's firmware of August 2026 as a program of the host, in real time "
        "(tests/sitl/README.md): its own estimator, commander and PID controllers with the app's filter, "
        "a rigid body without drag, poses with 2 mm of noise. Pairs are drawn as above; the first are "
        "flown to whose start a vehicle can climb straight up from the floor. It stands there, climbs by "
        "its own commander, and gets the goal as a position set-point. The app keeps a radius of 0.1 m at "
        "the published rates. Distances are those of the true motion after the climb; collided: nearer to "
        "an ellipsoid than the body's radius of 0.075 m. The work of the app takes no time on the host: "
        "ticks that come late on the board are not shown."
    )
    title = "Table II by the app in the Crazyflie's firmware"
    return _by_hulls(flights, "table-2-crazyflie", title, note)


def _by_hulls(flights: Sequence[Flights], name: str, title: str, note: str) -> Table:
    published = {row[0]: row[1:] for row in POLYMERGE_FLIGHTS}
    rows = []
    for f in flights:
        assert f.hulls is not None
        printed = next((published[n] for n in published if 0.9 * n <= f.hulls <= n), _NO_ENDS)
        reached = [i for i, good in enumerate(f.succeeded) if good]
        typical = mean_estimate([f.distance_m[i] for i in reached])
        rows.append(
            (
                *(f.hulls, f.rate_hz, *printed[1:], len(f.reached), sum(f.inside)),
                *(sum(f.collided), f.collided_outside),
                *f.success.cells,
                *(nearest(f, f.distance_m), nearest(f, f.map_distance_m)),
                *((typical.value, typical.low, typical.high) if typical is not None else _NO_ENDS),
            )
        )
    columns = (
        *("hulls", "rate [Hz]", "published: success", "published: minimum distance [m]", "flights"),
        *("start or goal inside the map", "collided", "of these, from outside the map"),
        *("success [%]", LOW, HIGH),
        *("minimum distance to an ellipsoid [m]", "minimum distance to the 150 hulls [m]"),
        *("distance of closest approach, mean of successes [m]", LOW, HIGH),
    )
    return Table(name, title, columns, tuple(rows), note)
