"""Maps for a microcontroller: indexed, with a header and their cost, and refused when too large."""

import json
import re
from pathlib import Path
from shutil import copyfile

import numpy as np
import pytest

from alula import _core
from alula.cli.main import run
from alula.schemas.artifacts.artifact import read_artifact, write_artifact
from alula.schemas.artifacts.provenance import read_provenance
from alula.schemas.parameters.targets import CODE_BYTES, TARGETS, Target
from alula.stages.compression.onboard.cost import (
    ASSUMED,
    ASSUMED_OF_CHORD,
    LAG_S,
    largest_budget,
    tick_instructions,
    worst_tick,
)
from alula.stages.compression.onboard.image import decode_map
from alula.stages.compression.onboard.layout import encode_map, index_bytes
from support.paths import ROOT


@pytest.fixture
def here(pipeline, tmp_path, monkeypatch) -> Path:
    """A folder with a tiny cover and its voxels, as the working folder."""
    for name in ("tiny.cover.npz", "tiny.voxels.npz"):
        copyfile(pipeline / name, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def exported(capsys, *words):
    assert run(["export", *words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("target", ["crazyflie", "teensy", "c"])
def test_the_image_has_an_index_and_a_header_beside_it(here, capsys, target):
    summary = exported(capsys, "tiny.cover.npz", "-o", "a.map.bin", "--target", target)["summary"]
    raw = Path("a.map.bin").read_bytes()
    image = decode_map(raw)
    assert image.index_bytes == index_bytes(12) == summary["index_bytes"]
    text = Path("a.map.h").read_text()
    listed = [int(word, 16) for word in text.split("= {")[1].split("}")[0].replace(",", " ").split()]
    assert bytes(listed) == raw[: image.image_bytes]
    assert f"#define A_MAP_BYTES {image.image_bytes}U" in text
    parameters = read_provenance(Path("a.map.bin")).parameters
    assert parameters == {"format": "onboard", "largest_normal": 127, "target": target, "name": "a_map"}
    assert read_provenance(Path("a.map.h")).parameters == parameters
    assert run(["verify", "a.map.bin", "--cover", "tiny.cover.npz", "--voxels", "tiny.voxels.npz", "-q"]) == 0


def test_what_a_tick_takes_is_told_for_each_rate(here, capsys):
    summary = exported(capsys, "tiny.cover.npz", "-o", "a.map.bin", "--target", "crazyflie")["summary"]
    crazyflie = TARGETS["crazyflie"]
    seconds = summary["tick_instructions"] * summary["cycles_per_instruction"] / crazyflie.clock_hz
    assert summary["tick_us"] == pytest.approx(1e6 * seconds, abs=0.1)
    for rate in crazyflie.rates_hz:
        assert summary[f"share_at_{rate}_hz"] == pytest.approx(seconds * rate, abs=1e-4)
    assert seconds * summary["fastest_rate_hz"] <= 1
    assert summary["tick_us"] < summary["tick_us_bound"]
    assert summary["bytes_left"] == crazyflie.map_room - summary["image_bytes"]
    plain = exported(capsys, "tiny.cover.npz", "-o", "c.map.bin", "--target", "c")["summary"]
    assert 0 < plain["tick_instructions"] < summary["tick_instructions"]  # of polytope-cbf, without a lag
    assert not {"tick_us", "bytes_left"} & plain.keys()


def test_the_costs_are_those_of_the_apps_own_parameters():
    text = (ROOT / "native/onboard/targets/crazyflie/src/crazyflie_filter.c").read_text()
    app = {name: float(value) for name, value in re.findall(r"config\.(\w+) = ([\d.]+)F;", text)}
    assumed = {"radius_m": app["radius_m"], "v_max": app["v_max"], "dt_s": app["period_s"]}
    assert {**assumed, "beta": _core.PolytopeCbfConfig().beta} == ASSUMED_OF_CHORD
    assert app["lag"] == LAG_S


def test_a_map_that_is_too_slow_for_its_rate_exits_4_and_writes_nothing(here, capsys, monkeypatch):
    words = ["export", "tiny.cover.npz", "-o", "a.map.bin", "--target", "crazyflie", "--json"]
    assert run([*words, "--rate", "50", "-n"]) == 0
    tick_us = json.loads(capsys.readouterr().out)["summary"]["tick_us"]
    before = {path.name for path in here.iterdir()}
    assert run([*words, "--rate", str(3.5e6 / tick_us)]) == 4
    (line,) = capsys.readouterr().err.splitlines()
    assert "3.5 times its period" in line
    assert "merge to fewer hulls (that tick evaluates" in line
    assert "fit), or give --rate below" in line
    slow = Target("crazyflie", 724_000, 36_000, 80 * tick_us, 2.0, (1000, 50), 100.0)  # a tick of 2.1 s
    monkeypatch.setitem(TARGETS, "crazyflie", slow)
    assert run(words) == 4
    assert "at 100 Hz" in capsys.readouterr().err
    assert {path.name for path in here.iterdir()} == before
    for target in ("none", "c"):
        assert run(["export", "tiny.cover.npz", "-o", "b.bin", "--target", target, "--rate", "50"]) == 2
        assert "--rate goes with a --target" in capsys.readouterr().err


def test_obstacles_cost_time_and_memory_and_what_fits_is_named(here, capsys):
    words = ["export", "tiny.cover.npz", "-o", "a.map.bin", "--target", "crazyflie", "--json", "-n"]
    crazyflie = TARGETS["crazyflie"]
    alone, four = (
        exported(capsys, *words[1:-2], "-n", *more)["summary"] for more in ([], ["--obstacles", "4"])
    )
    more = four["tick_instructions"] - alone["tick_instructions"]
    assert more == four["tick_instructions_bound"] - alone["tick_instructions_bound"] > 0
    assert four["ram_bytes_left"] == crazyflie.ram_bytes - crazyflie.state_bytes(4)
    assert run([*words, "--obstacles", "128"]) == 5
    (line,) = capsys.readouterr().err.splitlines()
    assert "of RAM, crazyflie has 36000" in line
    most = int(line.split("; ")[1].split()[0])
    assert crazyflie.state_bytes(most) <= crazyflie.ram_bytes < crazyflie.state_bytes(most + 1)
    assert run([*words, "--obstacles", str(most)]) == 4  # its time is the limit
    (line,) = capsys.readouterr().err.splitlines()
    assert f"and {most} moving obstacles takes up to" in line
    fits = int(line.split("give --obstacles ")[1].split(",")[0])
    assert run([*words, "--obstacles", str(fits)]) == 0
    assert run([*words, "--obstacles", str(fits + 1)]) == 4
    capsys.readouterr()
    assert run([*words, "--obstacles", "1", "--rate", "500"]) == 4
    assert "leave out --obstacles" in capsys.readouterr().err
    assert run(["export", "tiny.cover.npz", "-o", "b.bin", "--target", "teensy", "--obstacles", "1"]) == 2
    assert "--obstacles goes with --target crazyflie" in capsys.readouterr().err


def test_the_bound_holds_wherever_the_vehicle_is(here):
    cover = read_artifact(Path("tiny.cover.npz"))
    raw = encode_map(cover, indexed=True)
    image, rng = decode_map(raw), np.random.default_rng(2)
    worst = worst_tick(raw, image)
    native = _core.PolytopeCbf.from_image(raw, extent_m=30.0, **{**ASSUMED, "kappa": 1.0})  # all hulls count
    most = 0
    for x, u in zip(rng.uniform(-5, 5, (500, 3)).tolist(), rng.normal(size=(500, 3)).tolist(), strict=True):
        native.filter(x, u)
        most = max(most, int(tick_instructions(np.array(native.work()))))
    assert 0.1 * worst["bound"] < most <= worst["bound"]
    assert worst["measured"] <= worst["bound"]


@pytest.mark.parametrize("radius_m", [0.15, 1.5])
def test_the_bound_of_the_chord_holds_wherever_the_vehicle_is(here, radius_m):
    raw = encode_map(read_artifact(Path("tiny.cover.npz")), indexed=True)
    rng, worst = np.random.default_rng(2), worst_tick(raw, decode_map(raw), of_chord=True)
    native = _core.OnboardChord(raw, _core.PolytopeCbfConfig(radius_m=radius_m, dt_s=0.01), LAG_S, 30.0)
    counted = []
    for x, u in zip(rng.uniform(-5, 5, (500, 3)).tolist(), rng.normal(size=(500, 3)).tolist(), strict=True):
        native.filter(x, u, u)
        counted.append(native.work())
    counted = np.array(counted)
    assert (counted[:, 5] > 0).any()
    assert tick_instructions(counted, of_chord=True).max() <= worst["bound"]
    assert worst["measured"] <= worst["bound"]


def test_what_does_not_fit_is_refused_and_what_is_named_fits(here, capsys, monkeypatch):
    def with_room(room):
        monkeypatch.setitem(
            TARGETS, "crazyflie", Target("crazyflie", CODE_BYTES + room, 36_000, 168e6, 2.0, (500,))
        )

    whole = len(encode_map(read_artifact(Path("tiny.cover.npz")), indexed=True))
    for room in (whole - 1, whole // 2, 400):
        with_room(room)
        assert run(["export", "tiny.cover.npz", "-o", "a.map.bin", "--target", "crazyflie"]) == 5
        message = capsys.readouterr().err
        assert f"12 hulls take {whole} bytes, crazyflie has room for {room}" in message
        assert not Path("a.map.bin").exists()
        assert not Path("a.map.h").exists()
        budget = message.split("--max-bytes ")[1].split()[0]
        assert (
            run(["merge", "tiny.cover.npz", "-o", "less.cover.npz", "--max-bytes", budget, "-f", "-q"]) == 0
        )
        assert (
            run(["export", "less.cover.npz", "-o", "less.map.bin", "--target", "crazyflie", "-f", "-q"]) == 0
        )
        assert decode_map(Path("less.map.bin").read_bytes()).image_bytes <= room
    with_room(whole)
    assert run(["export", "tiny.cover.npz", "-o", "a.map.bin", "--target", "crazyflie", "-q"]) == 0


def test_the_budget_leaves_room_for_any_index():
    for room in (200, 1000, 12_345, 692_000):
        for hulls in (1, 40, 5000):
            budget = largest_budget(room, hulls)
            few = min(hulls, (budget - 64) // 14)
            assert budget + index_bytes(few) <= room
            assert budget + index_bytes((budget + 1 - 64) // 14) + 1 > room or hulls < (budget - 64) // 14


def test_the_header_comes_back_and_foreign_files_stay(here, capsys):
    words = ["export", "tiny.cover.npz", "-o", "a.map.bin", "--target", "c", "-q"]
    Path("a.map.h").write_text("mine\n")
    assert run(words) == 2
    assert Path("a.map.h").read_text() == "mine\n"
    assert not Path("a.map.bin").exists()
    assert run([*words, "-f"]) == 0
    header = Path("a.map.h").read_text()
    Path("a.map.h").unlink()
    assert run(words) == 0
    assert Path("a.map.h").read_text() == header
    Path("a.map.h").unlink()
    assert run([*words, "--dry-run"]) == 0
    assert not Path("a.map.h").exists()


@pytest.mark.parametrize(
    "words",
    [
        "export tiny.cover.npz -o a.map.h --target c",
        "export tiny.cover.npz -o a.glb --target c",
        "export tiny.cover.npz -o a.bin --format c-header --target c",
        "export tiny.cover.npz -o a.bin --target pixhawk",
        "export tiny.voxels.npz -o a.bin --target c",
    ],
)
def test_what_makes_no_sense_is_refused(here, capsys, words):
    assert run(words.split()) in (2, 3)
    assert not list(Path().glob("a.*"))


def test_an_artifact_written_again_makes_the_same_bytes(here):
    write_artifact(Path("again.cover.npz"), read_artifact(Path("tiny.cover.npz")))
    for name in ("tiny", "again"):
        assert run(["export", f"{name}.cover.npz", "-o", f"{name}.bin", "--target", "teensy", "-q"]) == 0
    images = [Path(f"{name}.bin").read_bytes() for name in ("tiny", "again")]
    lengths = [decode_map(raw).image_bytes for raw in images]
    assert images[0][: lengths[0]] == images[1][: lengths[1]]
