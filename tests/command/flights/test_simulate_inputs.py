"""Inputs of `alula simulate` besides the map: a vehicle, and the pairs of another run."""

import msgspec
import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import write_artifact
from alula.schemas.log.mcap import MAGIC
from alula.schemas.log.run import read_run
from alula.schemas.scenarios.vehicle import FASTBRIDGE, contents, read_vehicle
from support.paths import VEHICLES
from support.scenes.fabricate import box, make_cover, make_scene

SCENE_WORDS = ["--trials", "3", "--set", "rules.max_time_s=0.3", "-q"]


@pytest.fixture(scope="module")
def maps(tmp_path_factory):
    folder = tmp_path_factory.mktemp("maps")
    write_artifact(folder / "field.scene.npz", make_scene(60, low=(0, 0, 0), high=(6, 4, 3)))
    blocks = [box((10, 10, 0), (14, 30, 20)), box((24, 0, 0), (28, 20, 20))]
    write_artifact(folder / "two.cover.npz", make_cover(blocks))
    return folder


def simulate(source, out, *words, code=0):
    assert run(["simulate", str(source), "-o", str(out), *map(str, words)]) == code
    return read_run(out) if code == 0 else None


def ends(record):
    return [(t.start_m, t.goal_m) for t in record.trials]


def test_a_single_integrator_flies_among_hulls_with_the_limits_of_its_file(maps, tmp_path):
    slow = (VEHICLES / "single-integrator.toml").read_text()
    (tmp_path / "v.toml").write_text(slow.replace("max_speed_m_s = 1.0", "max_speed_m_s = 0.7"))
    words = ["--vehicle", tmp_path / "v.toml", "--trials", 3, "-q"]
    record = simulate(maps / "two.cover.npz", tmp_path / "r.run.mcap", *words)
    assert record.vehicle == "single-integrator: sphere of radius 0.15 m, single integrator up to 0.7 m/s"
    assert {t.outcome for t in record.trials} <= {"reached", "stuck"}
    assert not any(t.collision for t in record.trials)
    assert 0.69 < max(t.max_speed_m_s for t in record.trials) <= 0.7 + 1e-9
    parameters = record.provenance.parameters
    assert parameters["vehicle_file"]["body"]["radius_m"] == 0.15
    assert parameters["vehicle_file"]["limits"]["max_speed_m_s"] == 0.7
    assert [ref.role for ref in record.provenance.inputs] == ["cover", "vehicle"]
    smaller = simulate(
        maps / "two.cover.npz",
        tmp_path / "s.run.mcap",
        *words,
        "--set",
        "vehicle.radius_m=0.1",
        "--speed",
        0.5,
    )
    assert smaller.vehicle.endswith("radius 0.1 m, single integrator up to 0.5 m/s")


def test_the_parameters_hold_the_whole_vehicle(maps, tmp_path):
    """A run can be flown again from its log: without a vehicle file, and with one that omits keys."""
    record = simulate(maps / "field.scene.npz", tmp_path / "a.run.mcap", "--filter", "none", *SCENE_WORDS)
    recorded = record.provenance.parameters["vehicle_file"]
    assert recorded == contents(FASTBRIDGE)
    assert recorded["body"]["gravity_m_s2"] == 9.81
    assert recorded["rates"] == {"max_rad_s": [10.0, 10.0, 4.0], "time_constant_s": 0.02}
    assert recorded["disturbance"]["delay_s"] == 0
    assert msgspec.convert(recorded, type(FASTBRIDGE)) == FASTBRIDGE
    for path in VEHICLES.glob("*.toml"):
        vehicle = read_vehicle(path)
        assert msgspec.convert(contents(vehicle), type(vehicle)) == vehicle


def test_the_rate_loop_is_that_of_the_file(maps, tmp_path):
    text = (VEHICLES / "fastbridge.toml").read_text()
    (tmp_path / "slow.toml").write_text(text.replace("time_constant_s = 0.02 ", "time_constant_s = 0.05 "))
    words = ["--filter", "none", "--set", "vehicle.interface=body-rates", *SCENE_WORDS]
    quick = simulate(maps / "field.scene.npz", tmp_path / "a.run.mcap", *words)
    slow = simulate(
        maps / "field.scene.npz", tmp_path / "b.run.mcap", *words, "--vehicle", tmp_path / "slow.toml"
    )
    assert ends(quick) == ends(slow)
    assert quick.trials[0].path_length_m != slow.trials[0].path_length_m


@pytest.mark.parametrize(
    ("name", "words"),
    [("field.scene.npz", ["--filter", "none", *SCENE_WORDS]), ("two.cover.npz", ["--trials", "3", "-q"])],
)
def test_the_pairs_of_another_run_are_flown_again(maps, tmp_path, name, words):
    source, first = maps / name, tmp_path / "first.run.mcap"
    record = simulate(source, first, *words, "--seed", 4)
    again = simulate(source, tmp_path / "again.run.mcap", *words[:-1], "--pairs-from", first, "-q")
    assert ends(again) == ends(record)
    assert "notes" not in again.summary
    assert [t.path_length_m for t in again.trials] == [t.path_length_m for t in record.trials]
    other = words[: words.index("--trials")] + words[words.index("--trials") + 2 :]
    faster = simulate(source, tmp_path / "faster.run.mcap", *other, "--pairs-from", first, "--speed", 2)
    assert ends(faster) == ends(record)  # as many as there are
    fewer = simulate(source, tmp_path / "few.run.mcap", *other, "--pairs-from", first, "--trials", 2)
    assert ends(fewer) == ends(record)[:2]
    assert [ref.role for ref in again.provenance.inputs] == sorted([name.split(".")[1], "pairs"])
    assert again.provenance.parameters["mission"]["which"] == "any"  # as are all keys of random pairs


def test_runs_that_keep_away_more_fly_the_same_pairs(maps, tmp_path):
    source, first = maps / "field.scene.npz", tmp_path / "first.run.mcap"
    words = ["--filter", "none", *SCENE_WORDS]
    record = simulate(source, first, *words, "--set", "mission.which=blocked")
    drawn = simulate(
        source,
        tmp_path / "a.run.mcap",
        *words,
        "--set",
        "mission.which=blocked",
        "--set",
        "world.inflation_m=0.05",
    )
    given = simulate(
        source, tmp_path / "b.run.mcap", *words, "--pairs-from", first, "--set", "world.inflation_m=0.05"
    )
    assert ends(drawn) != ends(record)
    assert ends(given) == ends(record)
    assert given.summary["notes"][0] == (
        "this run and first.run.mcap also differ in world.inflation_m "
        "(first.run.mcap: None; this run: 0.05): differences may come from these."
    )
    assert given.summary["blocked_pairs"] == 3


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--trials", "4"], "`$.rules.trials`: 4, but the run of mission.pairs_from has 3"),
        (
            ["--set", "mission.which=blocked"],
            "`$.mission.which` is for random pairs; leave it out with pairs_from",
        ),
        (["--set", "mission.margin_m=0.2"], "`$.mission.margin_m` is for random pairs"),
        (["--set", "world.inflation_m=1"], "closer to an obstacle than this run allows"),
    ],
)
def test_pairs_that_do_not_fit_are_refused(maps, tmp_path, capsys, words, message):
    source, first = maps / "field.scene.npz", tmp_path / "first.run.mcap"
    simulate(source, first, "--filter", "none", *SCENE_WORDS)
    capsys.readouterr()
    out = tmp_path / "r.run.mcap"
    simulate(source, out, "--filter", "none", "--pairs-from", first, *words, code=2)
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not out.exists()


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (
            ["COVER", "--vehicle", "QUADROTOR", "--filter", "cone-di"],
            2,
            "`$.safety.filters`: cone-di needs ellipsoids; set world.scene",
        ),
        (
            ["COVER", "--vehicle", "DOT", "--speed", "2"],
            2,
            "`$.mission.speed_m_s`: single-integrator flies at most 1 m/s",
        ),
        (
            ["SCENE", "--vehicle", "DOT", "--filter", "cone-di"],
            2,
            "cone-di is for commands of acceleration, and single-integrator takes velocity",
        ),
        (
            ["SCENE", "--filter", "none", "--set", "world.sigma=2", "--set", "world.confidence=0.9"],
            2,
            "`$.world.confidence` sets sigma; give one",
        ),
        (["BOTH"], 2, "both.toml: `$.world.confidence` sets sigma; give one of the two"),
        (["SCENE", "--filter", "none", "--pairs-from", "SCENE"], 3, "is not an MCAP log; it is an artifact"),
        (["RUN"], 3, "is not an alula artifact; it is a run, which report, view, info and"),
        (["SCENE", "--filter", "none", "--pairs-from", "absent.run.mcap"], 3, "cannot read"),
    ],
)
def test_inputs_that_do_not_fit_are_one_line(maps, tmp_path, capsys, words, code, message):
    (tmp_path / "both.toml").write_text(
        'version = "2.0"\n[world]\nscene = "x"\nsigma = 2\nconfidence = 0.9\n'
    )
    (tmp_path / "own.run.mcap").write_bytes(MAGIC)
    names = {
        "COVER": maps / "two.cover.npz",
        "SCENE": maps / "field.scene.npz",
        "BOTH": tmp_path / "both.toml",
        "RUN": tmp_path / "own.run.mcap",
        "DOT": VEHICLES / "single-integrator.toml",
        "QUADROTOR": VEHICLES / "fastbridge.toml",
    }
    simulate(names[words[0]], tmp_path / "r.run.mcap", *(names.get(w, w) for w in words[1:]), code=code)
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
