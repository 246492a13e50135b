"""PolyMerge's flights, judged by the ellipsoids, and verdicts on its numbers in both directions."""

import dataclasses
import json

import pytest

from alula.schemas.errors import InputError
from alula.stages.reporting.table import HIGH, LOW
from papers.compared import VERDICTS
from papers.papers import POLYMERGE
from papers.polymerge.figures import flights_figure
from papers.polymerge.flights import (
    COACD,
    OURS,
    SAFER,
    Flights,
    figure_5_table,
    flight_ms,
    from_record,
    path_ratio,
    table_2,
    table_2_in_firmware,
)
from papers.polymerge.verdicts import verdict_rows
from papers.verdicts import verdict_table
from support.flights.claims import open_claims, said
from support.scenes.polymerge_maps import OURS as OURS_MAP
from support.scenes.polymerge_maps import ROOM, TREE


def flights(method=OURS, *, hulls=300, good=10, close=0, n=10, path=2.0, us=1.0, steps=100, distance=0.2):
    """`good` of n flights reach; `close` of all came within half the radius of an ellipsoid."""
    return Flights(
        scene="room",
        method=method,
        hulls=hulls,
        rate_hz=100.0,
        reached=tuple(i < good for i in range(n)),
        distance_m=tuple(0.05 if i < close else distance for i in range(n)),
        map_distance_m=(),
        path_m=tuple(path + 0.01 * i for i in range(n)),
        radius_m=0.1,
        inside=(False,) * n,
        steps=(steps,) * n,
        filter_us=us,
        tolerance="1 % of the distance",
    )


def rows_of(figure_5=(), table=(), item=None, scenes=(ROOM, TREE), hz=None, firmware=()):
    found = said(POLYMERGE, verdict_rows(list(scenes), list(figure_5), list(table), hz, list(firmware)))
    return [row for row in found if item is None or row.item == item]


def test_a_flight_that_touches_an_ellipsoid_is_no_success_even_if_it_reached_its_goal():
    flown = flights(good=10, close=4)
    assert sum(flown.reached) == 10
    assert sum(flown.collided) == 4
    assert flown.success.value == 60


def test_flights_survive_json_and_lists_of_different_lengths_are_refused():
    flown = flights()
    assert from_record(json.loads(json.dumps(dataclasses.asdict(flown)))) == flown
    with pytest.raises(InputError, match="different lengths"):
        dataclasses.replace(flown, steps=(1,))
    with pytest.raises(InputError, match="record"):
        from_record({"scene": "room"})


def test_the_tables_show_what_was_flown():
    ours, theirs = flights(us=2.0), flights(COACD, close=5, path=3.0)
    table = figure_5_table([ours, theirs])
    by = dict(zip(table.columns, table.rows[1], strict=True))
    assert (by["method"], by["reached"], by["collided"], by["success [%]"]) == (COACD, 10, 5, 50.0)
    assert by["minimum distance to an ellipsoid [m]"] == 0.05
    assert by["pairs"] == 5  # only those that both fly without a collision
    assert by["path / ours"] == pytest.approx((3 + 0.07) / (2 + 0.07))
    assert flight_ms(ours) == pytest.approx(0.2)
    second = table_2([flights(hulls=10, good=7), flights(hulls=149)])
    assert [row[:4] for row in second.rows] == [(10, 100.0, 0.7, 0.268), (149, 100.0, 0.9, 0.097)]
    assert second.columns[9:11] == (LOW, HIGH)


def test_every_row_has_a_verdict_and_the_table_keeps_the_order():
    rows = rows_of([flights(), flights(SAFER, us=500.0)], [flights(hulls=10), flights(hulls=150)], hz=628.0)
    assert {row.verdict for row in rows} <= set(VERDICTS)
    assert len(verdict_table(POLYMERGE, [row.found for row in rows]).rows) == len(rows)
    items = [row.item for row in rows]
    for item in (
        "Table I",
        "Figure 3",
        "Figure 4a",
        "Figure 4b",
        "Figure 5a",
        "Figure 5b",
        "Figure 5c",
        "Table II",
    ):
        assert item in items
    assert sum(row.verdict == "not available here" for row in rows) == 5


@pytest.mark.parametrize(("us", "verdict"), [(30.0, "refuted"), (100.0, "reproduced"), (300.0, "better")])
def test_the_speed_up_is_judged_by_its_interval(us, verdict):
    steps = dataclasses.replace(flights(SAFER, us=us), steps=tuple(range(91, 111, 2)))
    (row,) = rows_of([flights(us=1.0), steps], item="Figure 5a")
    assert row.verdict == verdict
    assert row.interval


@pytest.mark.parametrize(
    ("ours", "theirs", "verdict"), [(60, 20, "reproduced"), (20, 60, "refuted"), (50, 50, "bounded")]
)
def test_more_success_is_reproduced_only_if_the_interval_says_so(ours, theirs, verdict):
    (row,) = rows_of([flights(good=ours, n=60), flights(COACD, good=theirs, n=60)], item="Figure 5b")
    assert row.verdict == verdict


@pytest.mark.parametrize(
    ("good", "verdict"), [(31, "not comparable"), (52, "reproduced"), (97, "not comparable")]
)
def test_success_is_reproduced_inside_the_interval_of_the_ten_published_flights(good, verdict):
    found = rows_of(table=[flights(hulls=30, good=good, n=100)], item="Table II")
    (row,) = (r for r in found if r.quantity.startswith("success with 30"))
    assert row.verdict == verdict


def test_a_collision_of_a_covered_map_would_be_a_refutation():
    found = rows_of(table=[flights(hulls=10), flights(hulls=150, close=1)], item="Table II")
    (row,) = (r for r in found if r.quantity.startswith("minimum distance with 150"))
    assert row.verdict == "refuted"


def test_a_collision_from_inside_a_hull_is_counted_but_refutes_nothing():
    flown = flights(hulls=150, close=3, good=9)
    flown = dataclasses.replace(flown, inside=(True,) * 3 + (False,) * 7)
    assert (sum(flown.collided), flown.collided_outside) == (3, 0)
    rows = rows_of(table=[flights(hulls=10), flown], item="Table II")
    (row,) = (r for r in rows if r.quantity.startswith("minimum distance with 150"))
    assert row.verdict == "bounded"
    assert row.ours == "0.2 to the ellipsoids"
    (row,) = (r for r in rows if r.quantity.startswith("success with 150"))
    assert "3 collided, 0 of them from outside the map" in row.why


def test_flights_in_the_firmware_have_rows_of_their_own_beside_those_in_simulation():
    flown = dataclasses.replace(flights(hulls=29, good=6, close=1), radius_m=0.075)
    rows = rows_of(table=[flights(hulls=30)], firmware=[flights(hulls=10, good=3), flown])
    found = {row.quantity: row for row in rows if row.item == "Table II, on the Crazyflie"}
    assert [row.verdict for row in found.values()] == ["not comparable", "bounded", "reproduced", "refuted"]
    assert found["success with 30 hulls, by the app in its firmware [%]"].ours == "50"
    assert "1 touched" in found["success with 30 hulls, by the app in its firmware [%]"].why
    assert all(row.found.runs == ["room.table-2-crazyflie.json"] for row in found.values())
    named = [row[:4] for row in table_2_in_firmware([flown]).rows]
    assert named == [(29, 100.0, 0.8, 0.253)]


def test_a_baseline_that_did_not_finish_is_a_row_that_says_so():
    (row,) = (r for r in rows_of() if r.quantity == "surface + CoACD")
    assert row.verdict == "not available here"
    assert row.why == "tree <&>: CoACD was not run"


def test_paths_are_compared_over_the_pairs_that_both_fly():
    ours, theirs = flights(good=6, path=2.0), flights(COACD, good=10, close=3, path=4.0)
    ratio = path_ratio(theirs, ours, (ours, theirs))
    assert ratio.n == 3
    assert ratio.value == pytest.approx((4 + 0.04) / (2 + 0.04))


def test_a_cover_that_leaves_voxels_out_refutes_the_theorem():
    whole = ROOM.same_count["default"]
    torn = dataclasses.replace(
        whole, measure=dataclasses.replace(whole.measure, intersection=990.0, open_voxels=20)
    )
    scene = dataclasses.replace(ROOM, same_count={**ROOM.same_count, "default": torn})
    (row,) = (r for r in rows_of(scenes=[scene], item="Figure 4a") if "occupied voxels inside" in r.quantity)
    assert row.verdict == "refuted"
    (row,) = (r for r in rows_of(item="Figure 4a") if "occupied voxels inside" in r.quantity)
    assert row.verdict == "reproduced"


def test_every_claim_of_the_paper_has_a_row_and_every_row_a_claim():
    table = [flights(hulls=n) for n in (10, 30, 50, 100, 150)]
    rows = rows_of([flights(), flights(COACD), flights(SAFER, us=500.0)], table, hz=628.0)
    # No map of the room has 100 to 150 hulls of a known size.
    assert open_claims(POLYMERGE, rows) == {"flash"}
    assert "figure-5a" in open_claims(POLYMERGE, rows_of())
    (pair,) = (row for row in rows if row.item == "Figure 5a")
    assert (pair.found.runs, pair.found.flights) == (["room.figure-5.json"], 20)


def test_a_smaller_map_is_better_and_a_larger_one_refutes():
    (size,) = (row for row in rows_of() if row.quantity == "bytes per half-plane")
    assert (size.ours, size.verdict) == ("4", "better")
    large = dataclasses.replace(
        ROOM, same_count={"default": dataclasses.replace(OURS_MAP, onboard_bytes=10**6)}
    )
    (size,) = (row for row in rows_of(scenes=[large]) if row.quantity == "bytes per half-plane")
    assert size.verdict == "refuted"


def test_figure_5_draws_every_method_with_its_numbers_in_words():
    figure = flights_figure([flights(), flights(SAFER, good=5, us=500.0, path=3.0)])
    assert f"room, {SAFER}: 500 µs, 50 % (" in figure.alt
    assert "path over ours" in figure.svg
    assert ">100</text>" in figure.svg  # a tick of a logarithmic axis
    assert "mathdefault" not in figure.svg
    assert flights_figure([]) is None
