"""Runs compared directly: paired where they have the same trials, else as two samples."""

import math

import msgspec
import numpy as np
import pytest

from alula.schemas.artifacts.manifest import InputRef
from alula.stages.reporting.brief import brief
from alula.stages.reporting.differences import difference_tables, difference_words, is_paired
from alula.stages.reporting.headline import headline
from alula.stages.reporting.material import Material, Run
from alula.stages.reporting.statistics import rate_difference, sign_test, two_sample_estimate
from support.scenes.fabricate import make_record, make_trial

GOAL_M = [20.0, 1.0, 1.0]
COLUMNS = ("name", "first", "second", "difference", "low", "high", "n", "higher", "lower", "p")


def run_of(label, clearances, duration_s=10.0, first=0):
    trials = [
        make_trial(first + i, clearance=clearance, duration_s=duration_s + 0.01 * i)
        for i, clearance in enumerate(clearances)
    ]
    return Run(label, make_record(trials))


def rows_of(*runs):
    (table,) = difference_tables(Material("t", runs))
    return {row[0]: dict(zip(COLUMNS, row, strict=False)) for row in table.rows}, table


def test_trials_with_the_same_starts_are_compared_one_by_one():
    """A shift that is small beside the spread of the trials is clear only by pairs."""
    rng = np.random.default_rng(5)
    first = rng.uniform(0.1, 1.0, 40)
    second = first + 0.02 + rng.uniform(-0.005, 0.005, 40)
    rows, table = rows_of(run_of("a", first), run_of("b", second, duration_s=12.0))
    found = rows["minimum clearance of a flight [m]"]
    assert found["difference"] == pytest.approx((second - first).mean())
    assert 0.015 < found["low"] < found["difference"] < found["high"] < 0.025
    assert (found["higher"], found["lower"], found["p"]) == (40, 0, 2 * 0.5**40)
    assert rows["duration of successful flights [s]"]["difference"] == pytest.approx(2.0)
    assert "percentile bootstrap of the pairs" in table.note
    assert "b: mean of the minimum clearances 2.0 cm more than a" in difference_words(table)[1]


def test_a_run_that_lacks_some_of_the_pairs_is_compared_with_the_others_by_their_places():
    """As a run of plans does where the planner found no way; its trials have other numbers then."""
    rng = np.random.default_rng(5)
    places = rng.uniform(0, 9, (40, 3)).tolist()
    first = rng.uniform(0.1, 1.0, 40)
    whole = [make_trial(i, clearance=c, start_m=places[i], goal_m=GOAL_M) for i, c in enumerate(first)]
    kept = [i for i in range(40) if i % 7]
    part = [
        make_trial(n, clearance=first[i] + 0.02, start_m=places[i], goal_m=GOAL_M) for n, i in enumerate(kept)
    ]
    rows, table = rows_of(Run("a", make_record(whole)), Run("b", make_record(part)))
    found = rows["minimum clearance of a flight [m]"]
    assert found["difference"] == pytest.approx(0.02)
    assert (found["n"], found["higher"]) == (len(kept), len(kept))
    assert table.note.startswith(f"{len(kept)} trials of both runs have the same starts and goals")
    assert "6 trials that only one of the runs has are left out" in table.note
    elsewhere = [*part[:-1], make_trial(len(part) - 1, clearance=0.5, start_m=[50.0, 0, 0], goal_m=GOAL_M)]
    _, table = rows_of(Run("a", make_record(whole)), Run("b", make_record(elsewhere)))
    assert "two samples" in table.note


def test_other_trials_are_compared_as_samples_and_the_report_says_so():
    first = run_of("a", np.linspace(0.1, 1.0, 40))
    second = run_of("b", np.linspace(0.12, 1.02, 40), first=1)
    rows, table = rows_of(first, second)
    found = rows["minimum clearance of a flight [m]"]
    assert found["low"] < 0 < found["high"]  # what pairs would show
    assert "higher" not in found
    assert "two samples" in table.note
    assert "b: mean of the minimum clearances not clearly different from a." in difference_words(table)


def described(run, vehicle=None, inputs=(), **parameters):
    tables = {"vehicle": {"radius_m": 0.1}} | parameters
    provenance = msgspec.structs.replace(
        run.record.provenance, parameters=tables, inputs=[InputRef(*one) for one in inputs]
    )
    record = msgspec.structs.replace(run.record, provenance=provenance)
    return Run(run.label, msgspec.structs.replace(record, vehicle=vehicle or record.vehicle))


COVERS = [[("cover", "alula/cover", "1.1", digit * 64, "room.cover.npz")] for digit in "12"]


@pytest.mark.parametrize(
    ("first", "second", "what", "words"),
    [
        ({}, {"vehicle": "a quadrotor"}, "vehicle", "vehicle (a: double-integrator; b: a quadrotor)"),
        (
            {"vehicle_file": {"body": {"radius_m": 0.1}}},
            {"vehicle_file": {"body": {"radius_m": 0.15}}},
            "vehicle",
            "vehicle_file.body.radius_m (a: 0.1; b: 0.15)",
        ),
        (
            {"inputs": COVERS[0]},
            {"inputs": COVERS[1]},
            "map",
            "cover (a: room.cover.npz, sha256 111111111111…; b: room.cover.npz, sha256 222222222222…)",
        ),
        ({"inputs": COVERS[0]}, {}, "map", "cover (a: room.cover.npz; b: none)"),
        ({"world": {"sigma": 1.0}}, {"world": {"sigma": 3.0}}, "map", "world.sigma (a: 1.0; b: 3.0)"),
        ({"mission": {"speed_m_s": 1.0}}, {"mission": {"speed_m_s": 3.0}}, None, "mission.speed_m_s (a: 1.0"),
        ({"safety": {"filters": ["a"]}}, {"safety": {"filters": ["b"]}}, None, None),
        ({"rules": {"trials": 5}}, {"rules": {"trials": 9}}, None, None),
    ],
)
def test_runs_that_differ_in_more_than_the_filter_say_so_first(first, second, what, words):
    runs = described(run_of("a", [0.1, 0.2]), **first), described(run_of("b", [0.1, 0.3]), **second)
    _, table = rows_of(*runs)
    material = Material("t", runs)
    verdict = f" The runs differ in their {what}, too." if what else "anything"
    assert verdict in brief(material).verdict
    assert ("differ" in brief(material).verdict) == (what is not None)
    if words is None:
        assert not any("also differ" in line for line in difference_words(table))
        assert "unlike" not in headline(material)
    else:
        assert difference_words(table)[0].startswith("b and a also differ in ")
        assert words in difference_words(table)[0]
        assert headline(material)["unlike"] == [difference_words(table)[0]]


def test_the_same_numbers_with_other_goals_are_no_pairs():
    run = run_of("a", [0.1, 0.2])
    moved = [msgspec.structs.replace(trial, goal_m=[4.0, 9.0, 1.0]) for trial in run.record.trials]
    assert is_paired(run, run_of("b", [0.3, 0.4]))
    assert not is_paired(run, Run("b", msgspec.structs.replace(run.record, trials=moved)))
    assert not is_paired(run, run_of("b", [0.1, 0.2, 0.3]))


def test_rare_collisions_keep_an_interval_with_a_width():
    """37 of 100 flights touched something without the filter; none with it."""
    clear, touched = np.full(100, 0.2), np.where(np.arange(100) < 37, -0.1, 0.2)
    rows, table = rows_of(run_of("with", clear), run_of("without", touched))
    found = rows["touched an obstacle [%]"]
    assert (found["first"], found["second"], found["difference"]) == (0, 37, 37)
    assert 25 < found["low"] < 30
    assert 44 < found["high"] < 50
    assert found["p"] == pytest.approx(2 * 0.5**37)
    assert difference_words(table)[1].startswith("without: rate of collisions 37 points higher than with")
    rows, _ = rows_of(run_of("with", clear), run_of("again", clear))
    assert "touched an obstacle [%]" not in rows  # no flight of either
    assert rows["successful flights [%]"]["low"] < 0 < rows["successful flights [%]"]["high"]


def test_each_run_is_compared_with_the_first_and_one_flight_with_none():
    runs = tuple(run_of(name, [0.1, 0.2, 0.3]) for name in "abc")
    tables = difference_tables(Material("t", runs))
    assert [table.title for table in tables] == ["b against a", "c against a"]
    assert [table.name for table in tables] == ["differences-2", "differences-3"]
    assert difference_tables(Material("t", (runs[0], run_of("one", [0.1])))) == []
    assert difference_tables(Material("t", runs[:1])) == []


def test_the_sign_test_is_exact():
    assert sign_test(0, 0) == 1.0
    assert sign_test(5, 0) == 2 / 32
    assert (
        sign_test(7, 3)
        == sign_test(3, 7)
        == pytest.approx(2 * sum(math.comb(10, k) for k in range(4)) / 1024)
    )
    assert 0.06 < sign_test(1500, 1400) < 0.07
    assert sign_test(0, 3000) == 0.0 or sign_test(0, 3000) < 1e-300


def test_two_samples_have_the_interval_of_newcombe_or_of_a_bootstrap():
    """Newcombe 1998, table II, case (a), method 10: 56 of 70 against 48 of 80."""
    found = rate_difference([True] * 56 + [False] * 14, [True] * 48 + [False] * 32)
    assert (found.value, found.low, found.high) == pytest.approx((0.2, 0.0524, 0.3339), abs=1e-4)
    rng = np.random.default_rng(0)
    a, b = rng.normal(1, 1, 300), rng.normal(0, 1, 200)
    found = two_sample_estimate(a, b)
    half = 1.96 * math.sqrt(a.var() / 300 + b.var() / 200)
    assert found.value == pytest.approx(a.mean() - b.mean())
    assert (found.low, found.high) == pytest.approx((found.value - half, found.value + half), abs=0.03)
    assert two_sample_estimate([], b) is None
    assert rate_difference([], [True]) is None
