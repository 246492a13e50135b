"""Each vehicle on each mission in each world behind each list of filters flies, or is refused in words."""

import collections

import pytest

from support.effort import some
from support.flights.combinations import VEHICLES, cases, files, tried

_COMMANDED = [(name, interface) for name, interfaces in VEHICLES.items() for interface in interfaces]


@pytest.fixture(scope="module")
def made():
    return files()


@pytest.mark.every(2)
@pytest.mark.parametrize(("vehicle", "interface"), _COMMANDED)
def test_every_combination_flies_or_is_refused_in_one_sentence_with_an_alternative(vehicle, interface, made):
    count, faulty = collections.Counter(), []
    tried_cases = some(cases(vehicle, interface), 23)
    for case in tried_cases:
        verdict = tried(case.tree, made)
        count["refused" if verdict.trial is None else "flown"] += 1
        faulty += [f"{case.name}: {fault}: {verdict.words}" for fault in verdict.faults]
    assert not faulty, "\n".join(faulty[:20])
    share = len(tried_cases) / len(list(cases(vehicle, interface)))
    assert count["flown"] > 50 * share
    assert count["refused"] > 400 * share


def test_nothing_is_refused_that_the_parts_are_made_for(made):
    """The combinations that the specification names fly, filters and all."""
    wanted = {
        "single-integrator by velocity | cover | pairs | polytope-cbf",
        "single-integrator by velocity | walls | goal | polytope-cbf",
        "double-integrator by acceleration | moving | goal | dr-acbf",
        "double-integrator by acceleration | cover | goal | polytope-cbf + dr-acbf",
        "double-integrator by velocity | cover | hover | polytope-cbf",
        "crazyflie21 by body-rates | cover, fence, moving | pairs | dr-acbf + shield",
        "crazyflie21 by body-rates | cover, fence, moving | waypoints | polytope-cbf + dr-acbf + shield",
        "crazyflie21 by wrench | scene | plan | cone-backup",
        "fastbridge by wrench | cover | goal | shield",
        "fastbridge by velocity | cover | plan | polytope-cbf",
        "racer7 by sticks | fence | pilot | geofence",
        "racer7 by sticks | cover, fence, moving | pilot | geofence",
        "racer7 by sticks | fence | pilot | backup-qp",
        "racer7 by body-rates | cover, scene | goal | polytope-cbf + dr-acbf + cone-backup + geofence",
    }
    named = {case.name: case for each in _COMMANDED for case in cases(*each)}
    for name in wanted:
        assert tried(named[name].tree, made).trial is not None, name
