"""Scenario files: the values that they set, and errors that name the key."""

import pytest

from alula.schemas.errors import InputError, UsageError
from alula.schemas.scenario import read_scenario
from alula.schemas.world import read_world

WHOLE = """
name = "room"
[map]
cover = "a.cover.npz"
scene = "a.scene.npz"
plan = "a.plan.npz"
[vehicle]
radius_m = 0.2
v_max_m_s = 3
[filter]
name = "polytope-cbf"
parameters = { beta = 5, kappa_per_m = 50.0, smoothing = "paper" }
[controller]
gain = 1.5
[trials]
count = 7
seed = 9
bounds_m = [0, 0, 0, 1, 2, 3]
margin_m = 0.1
separation = 0.4
stop_fraction = 0.02
[run]
dt_s = 0.02
max_time_s = 30
log_rate_hz = 10
"""


def read(tmp_path, text):
    path = tmp_path / "s.toml"
    path.write_text(text)
    return read_scenario(path)


def test_every_key_sets_its_parameter(tmp_path):
    scenario = read(tmp_path, WHOLE)
    assert (scenario.map.cover, scenario.map.scene, scenario.map.plan) == (
        "a.cover.npz",
        "a.scene.npz",
        "a.plan.npz",
    )
    assert (scenario.name, scenario.vehicle.radius_m, scenario.vehicle.v_max_m_s) == ("room", 0.2, 3.0)
    assert scenario.filter.name == "polytope-cbf"
    assert scenario.filter.parameters == {"beta": 5, "kappa_per_m": 50.0, "smoothing": "paper"}
    trials, run = scenario.trials, scenario.run
    assert (scenario.controller.gain, trials.count, trials.seed) == (1.5, 7, 9)
    assert trials.bounds_m == (0.0, 0.0, 0.0, 1.0, 2.0, 3.0)
    assert (trials.margin_m, trials.separation, trials.stop_fraction) == (0.1, 0.4, 0.02)
    assert (run.dt_s, run.max_time_s, run.log_rate_hz) == (0.02, 30.0, 10.0)


def test_flights_among_ellipsoids_have_keys_of_their_own(tmp_path):
    text = (
        '[map]\nscene = "s"\n[filter]\nname = "cone-ecbf"\n[controller]\nguide = "cone-di"\n'
        'guide_parameters = { alpha = 2.0 }\ncatch_up_m_s = 0.5\n[trials]\npairs = "blocked"'
    )
    scenario = read(tmp_path, text)
    assert (scenario.filter.name, scenario.trials.pairs) == ("cone-ecbf", "blocked")
    controller = scenario.controller
    assert (controller.guide, controller.catch_up_m_s) == ("cone-di", 0.5)
    assert controller.guide_parameters == {"alpha": 2.0}
    with pytest.raises(UsageError, match=r"\$\.mission\.controller\.catch_up_m_s"):
        read_world(wrong(tmp_path, text.replace("0.5", "0")))
    with pytest.raises(UsageError, match=r"\$\.trials\.pairs"):
        read(tmp_path, text.replace("blocked", "free"))


def wrong(tmp_path, text):
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    return path


def test_only_the_cover_is_required(tmp_path):
    scenario = read(tmp_path, '[map]\ncover = "c"')
    assert scenario == type(scenario)(map=type(scenario.map)(cover="c"))


def test_parameters_of_a_foreign_filter_are_its_own(tmp_path):
    text = '[map]\ncover = "c"\n[filter]\nname = "mine"\nparameters = { depth = 3, mode = "x" }'
    assert read(tmp_path, text).filter.parameters == {"depth": 3, "mode": "x"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# nothing", "`map`"),
        ("[map]", r"`\$\.map` needs a cover"),
        ('map = "c"', r"\$\.map"),
        ('[map]\ncover = "c"\ncolour = 1', r"`colour` - at `\$\.map`"),
        ('[map]\ncover = "c"\n[vehicle]\nradius = 1', r"`radius` - at `\$\.vehicle`"),
        ('[map]\ncover = "c"\n[vehicle]\nradius_m = "big"', r"\$\.vehicle\.radius_m"),
        ('[map]\ncover = "c"\n[trials]\ncount = 1.5', r"\$\.trials\.count"),
        ('[map]\ncover = "c"\n[trials]\nbounds_m = [1, 2]', r"\$\.trials\.bounds_m"),
        ('[map]\ncover = "c"\n[filter.parameters]\nbta = 1', r"\$\.filter\.parameters\.bta`: unknown"),
        ('[map]\ncover = "c"\n[filter.parameters]\nbeta = "x"', r"\$\.filter\.parameters\.beta"),
        ('[map]\ncover = "c"\n[filter.parameters]\nsmoothing = 1', r"\$\.filter\.parameters\.smoothing"),
        ('[map]\ncover = "c"\n[filter.parameters]\nonboard = 1', r"\$\.filter\.parameters\.onboard"),
        ('[map]\ncover = "c"\n[filter.parameters]\nbeta = true', r"\$\.filter\.parameters\.beta"),
        ('[map]\ncover = "c"\n[filter]\nname = "none"\nparameters = { beta = 1 }', "none has no parameters"),
        ('speed = 1\n[map]\ncover = "c"', "`speed`"),
    ],
)
def test_a_wrong_key_is_named_with_its_path(tmp_path, text, message):
    with pytest.raises(UsageError, match=message):
        read(tmp_path, text)


@pytest.mark.parametrize("content", [b"[map", b"\xff\xfe\x00", b"a = 1\na = 2"])
def test_what_is_not_toml_is_bad_input(tmp_path, content):
    path = tmp_path / "s.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match="not TOML"):
        read_scenario(path)
    with pytest.raises(InputError, match="cannot read"):
        read_scenario(tmp_path / "absent.toml")
