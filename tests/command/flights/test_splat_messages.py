"""Log and record of a flight among ellipsoids: messages, level, limits of the model."""

import json
from collections import Counter

import pytest
from mcap.reader import make_reader

from alula.cli.main import run
from alula.schemas.artifacts.artifact import write_artifact
from alula.schemas.log.run import read_run
from support.paths import VEHICLES
from support.scenes.fabricate import make_scene

FAST = ["--trials", "2", "--speed", "2"]


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("splat") / "field.scene.npz"
    write_artifact(path, make_scene(60, low=(0, 0, 0), high=(6, 4, 3)))
    return path


def test_every_message_fits_its_schema(scene, tmp_path):
    """Includes ticks in which no obstacle gives the filter a margin."""
    out = tmp_path / "a.run.mcap"
    found = Counter()
    for name in ("none", "cone-di"):
        run(["simulate", str(scene), *FAST, "--filter", name, "-o", str(out), "-q", "-f"])
        with out.open("rb") as file:
            for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
                check_fits(json.loads(message.data), json.loads(schema.data), channel.topic)
                found[channel.topic] += 1
    assert set(found) == {"/state", "/safety", "/pose", "/tf", "/path", "/map", "/vehicle", "/splat", "/log"}


def check_fits(value, schema, where):
    kinds = {
        "object": dict,
        "array": list,
        "string": str,
        "boolean": bool,
        "integer": int,
        "number": (int, float),
    }
    kind = schema["type"]
    assert isinstance(value, kinds[kind]), (where, value)
    assert isinstance(value, bool) == (kind == "boolean"), (where, value)
    if kind == "object":
        for key, item in value.items():
            check_fits(item, schema["properties"][key], f"{where}.{key}")
    elif kind == "array":
        for item in value:
            check_fits(item, schema["items"], f"{where}[]")


def test_sigma_replaces_the_confidence_of_a_scenario(scene, tmp_path):
    text = f'version = "2.0"\n[world]\nscene = "{scene}"\nconfidence = 0.99\n[rules]\ntrials = 1\n'
    (tmp_path / "s.toml").write_text(text)
    for words, sigma in (
        ([], 3.368),
        (["--set", "world.sigma=2"], 2.0),
        (["--set", "world.confidence=0.5"], 1.538),
    ):
        out = tmp_path / "a.run.mcap"
        assert run(["simulate", str(tmp_path / "s.toml"), *words, "-o", str(out), "-q", "-f"]) == 0
        assert read_run(out).summary["sigma"] == pytest.approx(sigma, abs=1e-3)


def test_what_the_model_leaves_out_is_said(scene, tmp_path):
    lagging = (VEHICLES / "fastbridge.toml").read_text() + "\n[disturbance]\nmotor_time_constant_s = 0.001\n"
    (tmp_path / "v.toml").write_text(lagging)
    words = [
        "simulate",
        str(scene),
        *FAST,
        "--filter",
        "cone-backup",
        "--set",
        "vehicle.interface=body-rates",
    ]
    out = tmp_path / "a.run.mcap"
    run([*words, "--vehicle", str(tmp_path / "v.toml"), "-o", str(out), "-q"])
    record = read_run(out)
    assert record.vehicle.endswith("commanded by thrust and body rates, with motor lag")
    assert "the model with a rate loop with a time constant of 0.02 s." in record.guarantee.statement
    assert (
        "These flights had a motor lag other than assumed (motor_time_constant_s 0.001, assumed 0), which "
        "that model leaves out." in record.guarantee.statement
    )
    run([*words, "-o", str(out), "-q", "-f"])
    assert "leaves out" not in read_run(out).guarantee.statement
    run([*words[:-2], "-o", str(out), "-q", "-f"])
    assert "rate loop" not in read_run(out).guarantee.statement


def test_a_lag_and_a_delay_that_are_known_are_part_of_the_model(scene, tmp_path):
    head = (VEHICLES / "fastbridge.toml").read_text()
    known = "motor_time_constant_s = 0.03\ndelay_s = 0.02\n"
    out, words = tmp_path / "a.run.mcap", ["simulate", str(scene), *FAST, "--filter", "cone-ecbf"]
    (tmp_path / "v.toml").write_text(f"{head}\n[disturbance]\n{known}\n[assumed]\n{known}")
    assert run([*words, "--vehicle", str(tmp_path / "v.toml"), "-o", str(out), "-q"]) == 0
    record = read_run(out)
    assert record.guarantee.claims["every_step_certified"]
    said = "for the model with a motor time constant of 0.03 s and states that are 0.02 s old."
    assert said in record.guarantee.statement
    assert "leaves out" not in record.guarantee.statement
    (tmp_path / "v.toml").write_text(f"{head}\n[disturbance]\ndelay_s = 0.02\n\n[assumed]\n{known}")
    run([*words, "--vehicle", str(tmp_path / "v.toml"), "-o", str(out), "-q", "-f"])
    assert (
        "had a motor lag other than assumed (motor_time_constant_s 0, assumed 0.03), which"
        in read_run(out).guarantee.statement
    )
