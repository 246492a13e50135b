"""Rates, intervals and statements of judged trials."""

import math

import msgspec
import pytest

from alula.schemas.errors import InputError
from alula.stages.verdict import (
    distinct,
    head,
    mean,
    mean_path_ratio,
    minimum,
    statement,
    totals,
    wilson_interval,
)
from support.scenes.fabricate import make_trial


@pytest.mark.parametrize(("successes", "n"), [(0, 10), (7, 10), (10, 10), (93, 100), (1, 1)])
def test_the_wilson_interval_solves_the_score_equation(successes, n):
    lower, upper = wilson_interval(successes, n)
    assert 0 <= lower <= successes / n <= upper <= 1
    for p in (lower, upper):
        if 0 < p < 1:
            assert abs(successes / n - p) / math.sqrt(p * (1 - p) / n) == pytest.approx(1.959964, rel=1e-6)
    assert wilson_interval(0, 0) == (0.0, 1.0)
    with pytest.raises(InputError):
        wilson_interval(3, 2)


def test_the_head_of_a_summary_counts_trials_outcomes_and_successes():
    trials = [
        make_trial(0, path_length_m=3.0, straight_length_m=2.0),
        make_trial(1, path_length_m=9.0, straight_length_m=2.0, collision=True),
        make_trial(2, "stuck", path_length_m=9.0, straight_length_m=2.0),
        make_trial(3, path_length_m=0.0, straight_length_m=0.0),
    ]
    found = head(trials, ("reached", "stuck", "timeout"))
    assert found == {
        **{"trials": 4, "success_rate": 0.5, "success_interval": list(wilson_interval(2, 4))},
        **{"collisions": 1, "reached": 3, "stuck": 1, "timeout": 0},
    }
    assert head(trials, (), lambda trial: not trial.collision)["success_rate"] == 0.75
    assert mean_path_ratio(trials) == 1.5
    assert mean_path_ratio(trials[1:]) is None
    assert totals(trials, ("fallback_steps", "backup_steps")) == {"fallback_steps": 8, "backup_steps": 0}


def test_identical_records_are_one_flight_and_have_no_interval():
    """Flights of a deterministic scenario repeat each other: 50 of them are no more evidence than one."""
    first = make_trial(0)
    same = [msgspec.structs.replace(first, index=k) for k in range(50)]
    assert len(distinct(same)) == 1
    found = head(same, ())
    assert (found["trials"], found["distinct_trials"], found["success_interval"]) == (50, 1, None)
    mixed = [*same, make_trial(50, collision=True), make_trial(51)]
    found = head(mixed, (), lambda trial: not trial.collision)
    assert found["distinct_trials"] == 3
    assert found["success_interval"] == list(wilson_interval(2, 3))
    assert found["success_rate"] == 51 / 52
    assert "distinct_trials" not in head([same[0]], ())


def test_unknown_values_do_not_count():
    assert (minimum([None, 2.0, 1.0]), mean([None, 2.0, 1.0])) == (1.0, 1.5)
    assert (minimum([None]), mean([])) == (None, None)


def test_a_statement_names_how_many_trials_failed():
    assert statement("Nothing was flown.", "afterwards", 0, 3, "flights fell", "No wind.") == (
        "Nothing was flown. Judged afterwards: none of 3 flights fell. No wind."
    )
    assert statement("A.", "so", 2, 3, "fell") == "A. Judged so: 2 of 3 fell."
