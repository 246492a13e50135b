"""The glue for a Crazyflie and a Teensy, cross-compiled: no warnings, it fits, and needs nothing unknown."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from alula.schemas.artifacts.artifact import write_artifact
from support.paths import ROOT

if not (ROOT / "benchmarks/glue.py").is_file():
    pytest.skip("not a checkout", allow_module_level=True)
sys.path.append(str(ROOT / "benchmarks"))

import emulated

if missing := emulated.missing_tools():
    pytest.skip(missing, allow_module_level=True)

import glue
import onboard

CRAZYFLIE = glue.BOARDS / "crazyflie"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """The figures, and the folder of the objects."""
    folder = tmp_path_factory.mktemp("glue")
    return glue.measure(folder), folder


def test_both_boards_compile_fit_and_need_nothing_unknown(measured):
    figures = measured[0]
    assert glue.complaints(figures) == []
    assert figures["map_1000_bytes"] < figures["crazyflie_1000_flash_bytes"] < 724_000
    assert figures["crazyflie_code_bytes"] < glue.TARGETS["crazyflie"].flash_bytes / 20


def test_the_loop_sends_the_same_frames_on_the_emulated_core(measured):
    figures = measured[0]
    assert figures["teensy_flight_ticks"] == 1600
    assert figures["teensy_flight_differs"] == 0
    assert figures["teensy_flight_outcomes"] >= 5  # passed, blended, backup, no pilot, hand over
    assert 40 < figures["teensy_wall_cm"] < 200


@pytest.mark.parametrize(
    "name",
    [
        "crazyflie_1000_flash_bytes",
        "crazyflie_ram_bytes",
        "crazyflie_app_stack_bytes",
        "crazyflie_4_obstacles_ram_bytes",
        "crazyflie_obstacles_app_stack_bytes",
        "teensy_ram_bytes",
        "teensy_flight_differs",
        "m7_teensy_tick_instructions",
        "fused_instructions",
    ],
)
def test_what_does_not_fit_is_told(measured, name):
    (line,) = glue.complaints({**measured[0], name: 10**7})
    assert "10000000" in line


def test_what_comes_from_elsewhere_and_what_is_fused_is_found(measured, monkeypatch, tmp_path):
    folder = measured[1]
    app = sorted((folder / "app150").glob("*.o"))
    assert glue.foreign(app, glue.FIRMWARE - {"controllerPid"}) == {"controllerPid"}
    alone = [file for file in app if file.stem == "alula_app"]
    assert "alula_crazyflie_step" in glue.foreign(alone, glue.FIRMWARE)
    assert "controllerPid" in glue.complaints({**measured[0], "unknown_symbols": ["controllerPid"]})[0]
    monkeypatch.setattr(
        glue, "CRAZYFLIE", [w.replace("contract=off", "contract=fast") for w in glue.CRAZYFLIE]
    )
    assert glue.fused(glue.compile_crazyflie(tmp_path, None)) > 0


def test_the_app_compiles_without_a_map(tmp_path):
    assert glue.sizes(glue.compile_crazyflie(tmp_path, None))["flash"] < 20_000


def test_the_app_takes_the_header_that_the_export_writes(monkeypatch, tmp_path):
    from alula.cli.main import run

    monkeypatch.setitem(onboard.HALVES, 5, (60, 60, 30))
    write_artifact(tmp_path / "room.cover.npz", glue.field(5))
    words = ["-o", str(tmp_path / "cover_map.bin"), "--target", "crazyflie", "-q"]
    assert run(["export", str(tmp_path / "room.cover.npz"), *words]) == 0
    with_map = glue.sizes(glue.compile_crazyflie(tmp_path / "with", tmp_path))
    without = glue.sizes(glue.compile_crazyflie(tmp_path / "without", None))
    (size,) = re.findall(r"COVER_MAP_BYTES (\d+)U", (tmp_path / "cover_map.h").read_text())
    assert 0 <= with_map["flash"] - without["flash"] - int(size) < 200


def test_the_firmwares_build_is_given_all_sources_and_flags(tmp_path):
    """oot.mk takes these variables; Kbuild has to name every source."""
    (tmp_path / "tools/make").mkdir(parents=True)
    (tmp_path / "tools/make/oot.mk").write_text(
        "include $(OOT)/src/Kbuild\nall:\n\t@echo '$(OOT)|$(OOT_CONFIG)|$(EXTRA_CFLAGS)|$(ccflags-y)'\n",
        encoding="utf-8",
    )
    words = ["make", "-s", "-C", str(CRAZYFLIE), f"CRAZYFLIE_BASE={tmp_path}"]

    def given(*more):
        out = subprocess.run([*words, *more], capture_output=True, text=True, check=True).stdout.strip()
        return out.split("|")

    folder, config, flags, none = given()
    _, other, same, more = given("OBSTACLES=3")
    assert "-DALULA_CRAZYFLIE_OBSTACLES=3U" in more.split()
    assert none == ""
    assert same == flags
    settings = dict(line.split("=") for line in Path(other).read_text().splitlines())
    assert 4 * int(settings["CONFIG_APP_STACKSIZE"]) == glue.MORE_STACK_BYTES
    assert Path(folder) == CRAZYFLIE
    assert (CRAZYFLIE / "Kbuild").read_text() == "obj-y += src/\n"
    assert "-ffp-contract=off" in flags.split()
    for flag in flags.split():
        assert not flag.startswith("-I") or Path(flag[2:]).is_dir()
    named = re.findall(r"^obj-y \+= (\w+)\.o$", (CRAZYFLIE / "src/Kbuild").read_text(), re.MULTILINE)
    assert sorted(named) == sorted(p.stem for p in (CRAZYFLIE / "src").glob("*.c"))
    settings = dict(line.split("=") for line in Path(config).read_text().splitlines())
    assert settings["CONFIG_CONTROLLER_OOT"] == settings["CONFIG_APP_ENABLE"] == "y"
    assert 4 * int(settings["CONFIG_APP_STACKSIZE"]) == glue.APP_STACK_BYTES
