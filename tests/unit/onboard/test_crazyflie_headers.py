"""The declarations that replace the Crazyflie firmware's headers refuse and accept what the real ones do.

ALULA_CRAZYFLIE_FIRMWARE names a checkout of bitcraze/crazyflie-firmware with its submodules; what needs it is
skipped without it.
"""

import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from support.paths import ROOT

TARGETS = ROOT / "native/onboard/targets"
APP = TARGETS / "crazyflie"
STAND_INS = APP / "check/include"
OURS = [f"-I{ROOT / 'native/onboard' / name}" for name in ("include", "src")]
TARGET = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-std=gnu11", "-Werror"]
STRICT = ["-Wall", "-Wextra", "-Wconversion", "-Wshadow"]

if not APP.is_dir():
    pytest.skip("not a checkout", allow_module_level=True)


def complaint(words, code, folder):
    """What a compiler says about C code; empty if it accepts it."""
    source = folder / "tried.c"
    source.write_text(code)
    done = subprocess.run([*words, "-fsyntax-only", str(source)], capture_output=True, text=True, check=False)
    assert done.returncode in (0, 1)
    return done.stderr if done.returncode else ""


@pytest.fixture(scope="module")
def firmware():
    """The checkout of the firmware."""
    name = os.environ.get("ALULA_CRAZYFLIE_FIRMWARE")
    if not name:
        pytest.skip("ALULA_CRAZYFLIE_FIRMWARE names no checkout of the firmware (docs/guide/firmware.md)")
    folder = Path(name).expanduser().resolve()
    for needed in ("src/modules/interface/log.h", "vendor/FreeRTOS/include", "vendor/CMSIS/CMSIS"):
        if not (folder / needed).exists():
            pytest.skip(f"ALULA_CRAZYFLIE_FIRMWARE: {folder} lacks {needed}")
    if shutil.which("arm-none-eabi-gcc") is None:
        pytest.skip("arm-none-eabi-gcc is missing")
    return folder


@pytest.fixture
def real(firmware, tmp_path):
    """The compiler of the target with the firmware's headers and the app's configuration."""
    settings = dict(line.split("=") for line in (APP / "app-config").read_text().splitlines())
    values = {name: "1" if value == "y" else value for name, value in settings.items()}
    header = "".join(f"#define {name} {value}\n" for name, value in values.items())
    (tmp_path / "autoconf.h").write_text(header)
    folders = [tmp_path, firmware / "src/config", *sorted((firmware / "src").rglob("interface"))]
    folders += [each for each in sorted((firmware / "src").rglob("interface/*")) if each.is_dir()]
    folders += [firmware / f"vendor/FreeRTOS/{each}" for each in ("include", "portable/GCC/ARM_CM4F")]
    folders += [firmware / "vendor/CMSIS/CMSIS/Core/Include", firmware / "src/lib/CMSIS/STM32F4xx/Include"]
    folders += [firmware / "src/lib/STM32F4xx_StdPeriph_Driver/inc"]
    system = [word for each in folders for word in ("-isystem", str(each))]
    return [
        "arm-none-eabi-gcc",
        *TARGET,
        "-DSTM32F4XX",
        "-DSTM32F40_41xxx",
        "-DUSE_STDPERIPH_DRIVER",
        *system,
    ]


def declarations():
    """Lines of C that hold only if the firmware declares what the stand-ins declare."""
    checks = []
    for header in sorted(STAND_INS.glob("*.h")):
        text = re.sub(r"/\*.*?\*/", "", header.read_text(), flags=re.DOTALL).replace("\\\n", " ")
        text = re.sub(r",\n +", ", ", text)
        if header.name == "test_map.h":
            continue  # of the tests alone
        for name, parameters, value in re.findall(
            r"^#define ([A-Z]\w*)(\([^)]*\))? *(.*)$", text, re.MULTILINE
        ):
            if name.startswith("CHECK_") or name == "DEBUG_MODULE":
                continue
            checks.append(f"#ifndef {name}\n#error {header.name}: the firmware has no {name}\n#endif")
            if not parameters:
                checks.append(f'_Static_assert(({name}) == ({value}), "{name}");')
        for prototype in re.findall(r"^([a-z][\w ]*?\**\w+\([^;{}]*\))(?:;| \{)", text, re.MULTILINE):
            if "check_" not in prototype:
                checks.append(f"{prototype};")
        for names in re.findall(r"typedef enum \{([^}]*)\}", text):
            for value, name in enumerate(names.replace(" = 0", "").split(",")):
                checks.append(f'_Static_assert({name.strip()} == {value}, "{name.strip()}");')
        checks += [
            f"typedef {of} {to};" for of, to in re.findall(r"^typedef (\w+) (\w+);", text, re.MULTILINE)
        ]
    return checks


def test_the_stand_ins_declare_what_the_app_uses():
    checks = "\n".join(declarations())
    for name in ("logVarIdIsValid", "logGetVarId", "controllerPid", "vTaskDelay", "usecTimestamp", "appMain"):
        assert re.search(rf"^[\w ]+\b{name}\(.*\);$", checks, re.MULTILINE), name
    for name in ("RATE_MAIN_LOOP", "LOG_UINT32", "PARAM_FLOAT", "modeVelocity", "DEBUG_PRINT"):
        assert name in checks


@pytest.mark.parametrize(
    ("code", "word"),
    [
        ('void f(int n) { DEBUG_PRINT("%d hulls\\n", n); DEBUG_PRINT("none\\n"); }', ""),
        ('void f(int n) { DEBUG_PRINT(n ? "%d hulls\\n" : "none %d\\n", n); }', "expected"),
        ("int f(logVarId_t id) { return LOG_VARID_IS_VALID(id); }", "LOG_VARID_IS_VALID"),
        ("static uint8_t n;\nLOG_GROUP_START(a)\nLOG_ADD(LOG_UINT8, n, &n);\nLOG_GROUP_STOP(a)", "expected"),
        ("static uint8_t n;\nLOG_GROUP_START(a)\nLOG_ADD(LOG_UINT8, n, &n)\nLOG_GROUP_STOP(a)", ""),
        ("static uint8_t n;\nPARAM_GROUP_START(a)\nPARAM_ADD(PARAM_UINT8, n, &n)\nPARAM_GROUP_STOP(a)", ""),
        ("float f(quaternion_t q) { return (float)q.timestamp; }", "timestamp"),
    ],
)
@pytest.mark.parametrize("headers", ["stand-ins", "firmware"])
def test_stand_ins_and_firmware_refuse_the_same(headers, code, word, tmp_path, request):
    if headers == "firmware":
        words = request.getfixturevalue("real")
    elif shutil.which("cc") is None:
        pytest.skip("a C compiler is missing")
    else:
        words = ["cc", "-std=gnu11", "-Werror", f"-I{STAND_INS}"]
    before = '#define DEBUG_MODULE "A"\n#include "debug.h"\n#include "log.h"\n#include "param.h"\n'
    said = complaint(words, f'{before}#include "stabilizer_types.h"\n{code}\n', tmp_path)
    assert word in said if word else said == ""


def test_the_firmware_declares_what_the_stand_ins_declare(real, tmp_path):
    headers = [each.name for each in STAND_INS.glob("*.h") if each.name != "test_map.h"]
    includes = "".join(f'#include "{name}"\n' for name in ("FreeRTOS.h", *sorted(headers)))
    code = '#define DEBUG_MODULE "A"\n' + includes + "\n".join(declarations())
    assert complaint(real, code, tmp_path) == ""
    assert "conflicting" in complaint(real, f"{code}\ndouble logGetFloat(logVarId_t id);", tmp_path)


@pytest.mark.parametrize("obstacles", [0, 4])
def test_the_app_compiles_with_the_firmwares_headers(real, obstacles, tmp_path):
    sources = sorted((APP / "src").glob("*.c"))
    assert len(sources) == 4
    words = [*real, *STRICT, *OURS, f"-I{APP / 'src'}"]
    if obstacles:
        words += [f"-DALULA_CRAZYFLIE_OBSTACLES={obstacles}U", f"-DALULA_OBSTACLES={obstacles}U"]
    for source in sources:
        assert complaint(words, f'#include "{source}"\n', tmp_path) == ""


@pytest.mark.slow
def test_the_images_with_150_hulls_link_and_leave_room(firmware, tmp_path, monkeypatch):
    for needed in ("vendor/libdw1000/inc", "vendor/CMSIS/CMSIS/DSP/Source/CommonTables/arm_common_tables.c"):
        if not (firmware / needed).exists():
            pytest.skip(f"ALULA_CRAZYFLIE_FIRMWARE: {firmware} lacks {needed}")
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import glue

    ignored = shutil.ignore_patterns("build")
    shutil.copytree(ROOT / "native/onboard", tmp_path / "onboard", ignore=ignored)
    app = tmp_path / "onboard/targets/crazyflie"
    glue.map_header(app / "src", 150)
    words = ["make", f"-j{len(os.sched_getaffinity(0))}", "-C", str(app), f"CRAZYFLIE_BASE={firmware}"]
    for obstacles in (0, 4):  # the second one compiles what differs
        more = [f"OBSTACLES={obstacles}"] if obstacles else []
        done = subprocess.run([*words, *more], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
        rows = re.findall(r"^(Flash|RAM  ) \| +(\d+)/(\d+)", done.stdout, re.MULTILINE)
        (flash, flash_room), (ram, ram_room) = np.array([row[1:] for row in rows], int)
        print(f"{obstacles} obstacles: flash {flash} of {flash_room}, RAM {ram} of {ram_room}")
        assert flash < flash_room - 300_000
        assert ram < ram_room - 8_000
        names = subprocess.run(
            ["arm-none-eabi-nm", str(app / "build/cf2.elf")], capture_output=True, text=True, check=True
        ).stdout
        assert re.search(r" [RrTt] cover_map$", names, re.MULTILINE)  # in flash
        assert re.search(r" [Tt] controllerOutOfTree$", names, re.MULTILINE)
        assert bool(re.search(r" [Tt] alula_stack_filter$", names, re.MULTILINE)) == (obstacles > 0)
