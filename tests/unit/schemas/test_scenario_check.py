"""Which parts of a scenario go together: every combination flies, or is refused in one useful sentence."""

import itertools
import re

import pytest

from alula.schemas.errors import UsageError
from alula.schemas.scenarios.check import FILTER_COMMANDS, is_random, refusal
from alula.schemas.scenarios.scenario import _set, decoded
from alula.schemas.scenarios.vehicle import DisturbanceTable, TrackingTable
from alula.schemas.scenarios.vehicles import VEHICLES

INTERFACES = (None, "velocity", "acceleration", "wrench", "body-rates", "sticks")
MISSIONS = {
    "pairs": {},
    "goal": {"start_m": [0, 0, 1], "goal_m": [1, 0, 1]},
    "waypoints": {"start_m": [0, 0, 1], "waypoints_m": [[1, 0, 1]]},
    "plan": {"plan": "p.npz"},
    "hover": {"start_m": [0, 0, 1]},
    "pilot": {"start_m": [0, 0, 1]},
}
WORLDS = {
    "nothing": {},
    "cover": {"cover": "c.npz"},
    "scene": {"scene": "s.npz"},
    "walls": {"walls": [{"lower_m": [0, 0, 0], "upper_m": [1, 1, 1]}]},
    "fence": {"fence": {"box_m": [-9, -9, -9, 9, 9, 9]}},
    "all": {"cover": "c.npz", "scene": "s.npz", "fence": {"box_m": [-9, -9, -9, 9, 9, 9]}, "moving": [{}]},
}
FILTERS = [
    *([name] for name in FILTER_COMMANDS),
    [],
    ["dr-acbf", "cone-backup"],
    ["cone-backup", "dr-acbf"],
    ["polytope-cbf", "cone-di", "shield", "geofence"],
    ["their-filter"],
]
SOME_WORLDS = ("nothing", "cover", "all")
# One of each kind, and the lists.
SOME_FILTERS = [
    row for row in FILTERS if row not in (["dr-acbf-qp"], ["mpc"], ["cbf-qp"], ["rp-cbf"], ["cone-ecbf"])
]
SUGGESTION = re.compile(
    r"((?:vehicle|world|mission|safety|rules|estimation)\.[\w.-]+)=([\w-]+(?:[.,][\w-]+)*)"
)

ORDER = ["velocity", "acceleration", "wrench", "sticks"]
# The last command of `ORDER` that an interface takes, and the first.
LAST = {"velocity": 0, "acceleration": 1, "wrench": 2, "body-rates": 2, "sticks": 3}


def tree_of(vehicle, interface, mission, world, filters):
    tree = {
        "vehicle": {"type": vehicle},
        "mission": {"kind": mission, **MISSIONS[mission]},
        "world": dict(WORLDS[world]),
        "safety": {"filters": filters},
    }
    if interface is not None:
        tree["vehicle"]["interface"] = interface
    return tree


def refused(tree):
    scenario = decoded(tree, "x")
    return refusal(scenario, VEHICLES[scenario.vehicle.type or "fastbridge"])


def fits(vehicle, interface, mission, filters):
    """What the levels of vehicle, interface, mission and filters allow, apart from the world."""
    has_throttle, model = vehicle == "racer7", VEHICLES[vehicle].model
    if interface is None:
        interface = {"single-integrator": "velocity", "double-integrator": "acceleration"}.get(
            model, "sticks" if mission == "pilot" else "wrench"
        )
    if model == "single-integrator" and interface != "velocity":
        return False
    if model == "double-integrator" and interface not in ("velocity", "acceleration"):
        return False
    if (interface == "sticks" or mission == "pilot") and not has_throttle:
        return False
    if mission == "pilot" and interface not in ("sticks", "body-rates"):
        return False
    levels = [ORDER.index(FILTER_COMMANDS[name]) for name in filters if name in FILTER_COMMANDS]
    if levels != sorted(levels):
        return False
    if interface == "sticks" or mission == "pilot":
        return all(level == 3 for level in levels)
    most = 3 if interface == "body-rates" and has_throttle else LAST[interface]
    return all(level <= most for level in levels)


@pytest.mark.every(2)
@pytest.mark.parametrize("vehicle", VEHICLES)
def test_every_combination_is_flown_or_refused_in_a_sentence_that_helps(vehicle):
    flown = 0
    for interface, mission, world, filters in itertools.product(
        INTERFACES, MISSIONS, SOME_WORLDS, SOME_FILTERS
    ):
        words = refused(tree_of(vehicle, interface, mission, world, filters))
        what = (vehicle, interface, mission, world, filters, words)
        if words is None:
            flown += 1
        else:
            assert re.match(r"`\$\.[\w.-]+`: .", words), what
            assert "\n" not in words, what
            assert re.search(r"\b(set|fly|leave it out)\b", words), what
        if world == "all":
            assert (words is None) == fits(vehicle, interface, mission, filters), what
        elif not fits(vehicle, interface, mission, filters):
            assert words is not None, what
    assert flown > 0


@pytest.mark.every(2)
@pytest.mark.parametrize("vehicle", VEHICLES)
def test_what_a_sentence_suggests_removes_its_reason(vehicle):
    for interface, mission, world, filters in itertools.product(
        INTERFACES, MISSIONS, ("walls",), SOME_FILTERS
    ):
        given = (vehicle, interface, mission, world, filters)
        words = refused(tree_of(*given))
        for key, value in SUGGESTION.findall(words or ""):
            tree = tree_of(*given)
            _set(tree, key, value.split(",") if key == "safety.filters" else value)
            if key == "vehicle.type" and interface is not None and "interface" in words:
                continue  # the sentence is about the interface that was given
            try:
                again = refused(tree)
            except UsageError as error:
                assert "is for missions of kind" in str(error)  # noqa: PT017
                continue
            assert again != words, (given, key, value)


# The world that each filter needs at least, and one that is not enough.
NEEDS = [
    ("single-integrator", "polytope-cbf", ("cover", "walls", "all"), ("nothing", "scene", "fence")),
    ("double-integrator", "cone-di", ("scene", "all"), ("nothing", "cover", "walls", "fence")),
    ("double-integrator", "safer-splat", ("scene", "cover", "walls", "all"), ("nothing", "fence")),
    ("fastbridge", "cone-ecbf", ("scene", "cover", "walls", "all"), ("nothing", "fence")),
    ("fastbridge", "cone-backup", ("scene", "cover", "walls", "all"), ("nothing", "fence")),
    ("crazyflie21", "shield", ("scene", "cover", "walls", "fence", "all"), ("nothing",)),
    ("double-integrator", "dr-acbf", tuple(WORLDS), ()),
    ("double-integrator", "mpc", tuple(WORLDS), ()),
]


@pytest.mark.parametrize(("vehicle", "name", "good", "bad"), NEEDS, ids=[row[1] for row in NEEDS])
def test_a_filter_needs_its_part_of_the_world(vehicle, name, good, bad):
    for world in good:
        assert refused(tree_of(vehicle, None, "goal", world, [name])) is None
    for world in bad:
        assert f"{name} needs" in refused(tree_of(vehicle, None, "goal", world, [name]))


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("geofence", ("fence", "cover", "all"), ("nothing", "scene", "walls")),
        ("backup-qp", ("fence", "all"), ("nothing", "cover", "walls")),
    ],
)
def test_a_fence_is_needed_by_filters_of_sticks(name, good, bad):
    for world in good:
        assert refused(tree_of("racer7", None, "pilot", world, [name])) is None
    for world in bad:
        assert f"{name} needs a" in refused(tree_of("racer7", None, "pilot", world, [name]))


FASTBRIDGE = {"vehicle": {"type": "fastbridge"}, "world": {"scene": "s"}}
REFUSED = [
    (
        {"mission": {"kind": "goal", "start_m": [0, 0, 1]}},
        r"`\$\.mission\.goal_m`: a mission of kind goal needs",
    ),
    ({"mission": {"kind": "pairs"}, "world": {}}, r"`\$\.mission\.bounds_m`: random pairs need a box"),
    (
        {"mission": {"planned": True, "kind": "pairs", "bounds_m": [0, 0, 0, 1, 1, 1]}, "world": {}},
        r"`\$\.mission\.planned`: plans are made in a cover or a scene",
    ),
    (
        {"mission": {"kind": "pairs", "which": "blocked", "bounds_m": [0, 0, 0, 1, 1, 1]}, "world": {}},
        "can block",
    ),
    ({"world": {"onboard": True, "scene": "s"}}, r"`\$\.world\.onboard`: the image is of a cover"),
    (
        {"vehicle": {"max_speed_m_s": 2}},
        r"`\$\.vehicle\.max_speed_m_s`: is a limit of a single-integrator or",
    ),
    ({"vehicle": {"type": "single-integrator", "max_jerk_m_s3": 9}}, "is a limit of a double-integrator"),
    (
        {"vehicle": {"type": "double-integrator", "disturbance": {"wind_m_s": [1, 0, 0]}}},
        r"`\$\.vehicle\.disturbance\.wind_m_s`: is for rotors, which double-integrator has not",
    ),
    (
        {"vehicle": {"type": "double-integrator", "mass_scale": 2}},
        r"`\$\.vehicle\.mass_scale`: is for rotors",
    ),
    ({"vehicle": {"disturbance": {"wind_m_s": [1, 0, 0]}}}, "act through drag, but the drag is zero"),
    ({"vehicle": {"disturbance": {"sag_share": 0.1}}}, r"sag_share`: needs a table \[throttle\]"),
    ({"mission": {"controller": {"guide": "cone-di"}}, "world": {"cover": "c"}}, "cone-di needs ellipsoids"),
    (
        {"mission": {"controller": {"guide": "cone-di"}}, "vehicle": {"type": "single-integrator"}},
        "cone-di changes accelerations, and the vehicle takes velocity",
    ),
    ({"safety": {"filters": ["shield"], "shield": {"shield_map": "both"}}}, "both needs world.cover"),
    (
        {"safety": {"filters": ["shield"], "shield": {"shield_map": "both"}}, "world": {"cover": "c"}},
        "both needs world.scene; set it, or safety.shield.shield_map=hulls",
    ),
    (
        {"vehicle": {"type": "single-integrator"}, "mission": {"controller": {"gain_per_s": 201}}},
        r"201 is unstable with rules\.dt_s=0\.01; set it to at most 200",
    ),
    (
        {
            "vehicle": {"type": "single-integrator"},
            "mission": {"controller": {"gain_per_s": 101}},
            "rules": {"filter_ticks": 2},
        },
        r"101 is unstable with rules\.dt_s=0\.01, held for 2 ticks; set it to at most 100",
    ),
    (
        {"vehicle": {"type": "double-integrator"}, "mission": {"controller": {"gain_per_s": 101}}},
        "set it to at most 100",
    ),
    ({"vehicle": {"type": "single-integrator"}, "mission": {"speed_m_s": 2}}, "flies at most 1 m/s"),
]


@pytest.mark.parametrize(("tree", "words"), REFUSED, ids=[row[1] for row in REFUSED])
def test_other_parts_that_make_no_sense(tree, words):
    tree = {**FASTBRIDGE, **tree}
    tree["vehicle"] = {"type": "fastbridge"} | tree["vehicle"]
    assert re.search(words, refused(tree))


HOVER = {"mission": {"kind": "hover", "start_m": [0, 0, 1]}, "rules": {"trials": 9}}
FIXED = {"position_m": [5, 0, 1], "velocity_m_s": [-1, 0, 0]}
RANDOM = [
    ({}, False),
    ({"mission": {"kind": "pairs", "bounds_m": [0, 0, 0, 1, 1, 1]}}, True),
    ({"estimation": {"position_noise_m": 0.1}}, True),
    ({"estimation": {"lost_share": 0.1}}, True),
    ({"estimation": {"lost_from_s": 1.0}}, False),
    ({"vehicle": {"disturbance": {"gust_m_s": [1, 0, 0], "linear_drag_n_s_m": [1, 1, 1]}}}, True),
    ({"vehicle": {"disturbance": {"wind_m_s": [1, 0, 0], "linear_drag_n_s_m": [1, 1, 1]}}}, False),
    ({"world": {"moving": [FIXED]}}, False),
    ({"world": {"moving": [FIXED]}, "safety": {"filters": ["dr-acbf"]}}, True),
    ({"world": {"moving": [FIXED | {"acceleration_m_s2": [0, 1]}]}}, True),
    ({"world": {"moving": [{"distance_m": 5}]}}, True),
    ({"world": {"moving": [{"distance_m": 5, "speed_m_s": 3}]}}, False),
    ({"world": {"moving": [{"distance_m": 5, "speed_m_s": 3, "either_side": True}]}}, True),
    ({"world": {"moving": [{"distance_m": 5, "speed_m_s": 3, "offset_sigma_m": [0, 1, 0]}]}}, True),
    ({"mission": {"kind": "pilot", "start_m": [0, 0, 1]}, "vehicle": {"type": "racer7"}}, False),
    ({"mission": {"kind": "pilot", "start_box_m": [0, 0, 0, 1, 1, 1]}, "vehicle": {"type": "racer7"}}, True),
    (
        {
            "mission": {"kind": "pilot", "start_m": [0, 0, 1], "pilot": {"kind": "sticks"}},
            "vehicle": {"type": "racer7"},
        },
        True,
    ),
]


@pytest.mark.parametrize(("tree", "random"), RANDOM, ids=[str(row[0]) for row in RANDOM])
def test_trials_that_cannot_differ_are_flown_once(tree, random):
    tree = {**HOVER, **tree}
    scenario = decoded(tree, "x")
    vehicle = VEHICLES[scenario.vehicle.type or "fastbridge"]
    assert is_random(scenario, vehicle) == random
    words = refused(tree)
    if random:
        assert words is None
    else:
        assert re.search(r"all 9 flights would be the same.*; set rules\.trials=1, or randomise: ", words)
        assert refused(tree | {"rules": {"trials": 1}}) is None


def test_the_commands_of_other_packages_filters_are_checked_where_they_are_known():
    tree = tree_of("single-integrator", None, "goal", "all", ["theirs"])
    scenario = decoded(tree, "x")
    vehicle = VEHICLES["single-integrator"]
    assert refusal(scenario, vehicle) is None
    assert "theirs is for commands of wrench" in refusal(scenario, vehicle, {"theirs": "wrench"})


def test_noise_of_the_vehicles_file_makes_trials_differ():
    import msgspec

    noisy = msgspec.structs.replace(
        VEHICLES["double-integrator"],
        tracking=TrackingTable(),
        disturbance=DisturbanceTable(velocity_noise_m_s=0.1),
    )
    scenario = decoded(HOVER | {"vehicle": {"type": "double-integrator"}}, "x")
    assert refusal(scenario, noisy) is None
    assert refusal(scenario, VEHICLES["double-integrator"]) is not None
