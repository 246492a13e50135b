"""The firmware glue, compiled for its boards without their firmware, and measured.

The Crazyflie's app and the Teensy's sketch (native/onboard/targets) are compiled with the cross-compiler, all
warnings as errors, against declarations that replace the firmware's headers (their folders `check`). The app
includes maps of 150 and 1,000 hulls as `alula export --target crazyflie` writes them. Flash, RAM and the
deepest stack of the objects must fit beside the Crazyflie's firmware; their undefined symbols must be
functions of the firmware or of a C library; and no instruction may be a fused multiply-add. The Teensy's loop
flies on an emulated Cortex-M7 and on the host: every frame must be the same.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.append(str(Path(__file__).resolve().parent))
sys.path.sort(key=sys.path[-1].__eq__)  # last: newer standard libraries have a package `compression`

import numpy as np
from emulated import CORES, missing_tools, stack_bound
from emulated import FIRMWARE as FIRMWARE_OF_EMULATOR
from numpy.typing import NDArray
from onboard import FIELDS, field

from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.parameters.targets import TARGETS
from alula.stages.compression.onboard.layout import encode_map, image_c_header

ROOT = Path(__file__).resolve().parents[1]
BOARDS = ROOT / "native/onboard/targets"
INCLUDE = ROOT / "native/onboard/include"
WARNINGS = ["-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wshadow", "-Wvla", "-Werror"]
COMMON = ["-mthumb", "-mfloat-abi=hard", "-ffunction-sections", "-fdata-sections", "-fcallgraph-info=su"]
EXACT = ["-ffp-contract=off", "-fno-math-errno"]
CRAZYFLIE = [*COMMON, *["-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", "-std=gnu11", "-Os"], *EXACT, *WARNINGS]
TEENSY = [*COMMON, *["-mcpu=cortex-m7", "-mfpu=fpv5-d16", "-O2", "-ffreestanding"], *EXACT, *WARNINGS]
APP_STACK_BYTES = 4 * 350  # CONFIG_APP_STACKSIZE counts words
MORE_STACK_BYTES = 4 * 500  # of app-config-obstacles
OBSTACLES = (1, 2, 4)
TICK_S = 0.5e-3  # a fifth of the shortest period of the Teensy's loop
CONTEXT_BYTES = 4 * (9 + 16 + 26)  # context of a task that uses floats, which FreeRTOS keeps on its stack
FIRMWARE = {
    "check_print",  # replaces the function that DEBUG_PRINT calls
    *("controllerPid", "controllerPidInit", "controllerPidTest"),
    *("logGetFloat", "logGetVarId", "usecTimestamp", "vTaskDelay"),
}
SKETCH = {
    *("Serial", "Serial1", "Serial2", "Serial3", "micros()"),
    *("WDOG1_WCR", "WDOG1_WMCR", "WDOG1_WSR"),
    *("HardwareSerial::", "usb_serial_class::"),
}
LIBRARY = {"memcpy", "memset", "memmove", "__aeabi_"}


def run(words: Sequence[str | Path]) -> str:
    """Run a tool and return its output.

    Raises:
        RuntimeError: the tool failed; with its output.
    """
    done = subprocess.run([str(w) for w in words], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{words[0]}: {done.stderr}{done.stdout}")
    return done.stdout


def map_header(folder: Path, hulls: int) -> int:
    """Write `cover_map.h` as the export does; return the number of bytes of the image."""
    image = encode_map(field(hulls), indexed=True)
    made_by = Provenance.now("alula/export", "1.0", {"name": "cover_map"}, None, [])
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cover_map.h").write_bytes(b"".join(image_c_header(image, made_by)))
    return len(image)


def compile_crazyflie(folder: Path, header: Path | None, obstacles: int = 0) -> list[Path]:
    """Compile the app's objects, with the map of a folder or without one, and for moving obstacles."""
    board, objects = BOARDS / "crazyflie", []
    folder.mkdir(parents=True, exist_ok=True)
    includes = [board / "check/include", INCLUDE, INCLUDE.parent / "src", *([header] if header else [])]
    for source, name in (
        ("alula_app", "alula_app"),
        ("crazyflie_filter", "alula_filter"),
        ("onboard", "alula_all"),
        ("onboard_stack", "alula_more"),
    ):
        target = folder / f"{name}.o"
        flags = [f"-I{i}" for i in includes]
        if obstacles > 0:  # as the app's Makefile
            flags += [f"-DALULA_CRAZYFLIE_OBSTACLES={obstacles}U", f"-DALULA_OBSTACLES={obstacles}U"]
            flags += ["-DALULA_WALLS=8U", "-DALULA_FENCE_FACES=1U"]
        run(["arm-none-eabi-gcc", *CRAZYFLIE, *flags, "-c", board / f"src/{source}.c", "-o", target])
        objects.append(target)
    return objects


def compile_teensy(folder: Path) -> list[Path]:
    """Compile the sketch's folder, made by its Makefile, one file at a time."""
    sketch = folder / "sketch"
    run(["make", "-s", "-C", BOARDS / "teensy", "sketch", f"SKETCH={sketch}"])
    objects = []
    for source in sorted([*sketch.glob("*.c"), *sketch.glob("*.ino")]):
        target = folder / f"alula_{source.stem.removeprefix('alula_')}.o"
        if source.suffix == ".c":
            words = ["arm-none-eabi-gcc", "-std=gnu11"]
        else:
            words = ["arm-none-eabi-g++", "-std=gnu++17", "-fno-exceptions", "-fno-rtti"]
            words += ["-I", str(BOARDS / "teensy/check/include"), "-include", "Arduino.h", "-x", "c++"]
        run([*words, *TEENSY, "-c", source, "-o", target])
        objects.append(target)
    return objects


def sizes(objects: Sequence[Path]) -> dict[str, int]:
    """Total bytes of flash (code, constants, initial values) and RAM (variables) of objects."""
    rows = run(["arm-none-eabi-size", *objects]).splitlines()[1:]
    text, data, bss = (sum(int(row.split()[i]) for row in rows) for i in range(3))
    return {"flash": text + data, "ram": data + bss}


def foreign(objects: Sequence[Path], known: set[str]) -> set[str]:
    """Undefined symbols of objects that are neither in a C library nor in `known`."""
    names = {"U": set[str](), "T": set[str]()}
    for line in run(["arm-none-eabi-nm", "-C", *objects]).splitlines():
        found = re.match(r"(?:[0-9a-f]{8})? +([A-Za-z]) (.+)$", line)
        if found:
            names["U" if found[1] == "U" else "T"].add(found[2])
    allowed = known | LIBRARY
    return {
        name
        for name in names["U"] - names["T"]
        if name not in allowed and not any(name.startswith(a) for a in allowed if a.endswith(("_", ":")))
    }


def fused(objects: Sequence[Path]) -> int:
    """Count fused multiply-add instructions."""
    code = "\n".join(run(["arm-none-eabi-objdump", "-d", "--no-show-raw-insn", o]) for o in objects)
    return len(re.findall(r"\tvfn?m[as]\.f", code))


LOOP_TICK = np.dtype(
    [
        ("frame", "u1", 25),
        ("status", "u1"),
        ("zero", "u1", 2),
        ("position", "<f4", 3),
        ("counted", "<u4"),
    ]
)


def fly_loop(folder: Path, core: str) -> NDArray[np.void]:
    """Fly the Teensy's loop on an emulated Cortex-M7 (`m7`) or the host; return its ticks.

    Raises:
        RuntimeError: the loop does not compile or ends with an error.
    """
    folder.mkdir(parents=True, exist_ok=True)
    board = BOARDS / "teensy"
    sources = [
        *sorted((INCLUDE.parent / "src").glob("*.c")),
        board / "teensy_loop.c",
        board / "teensy_velocity.c",
    ]
    sources += [
        board / "check/replay_loop.c",
        FIRMWARE_OF_EMULATOR / f"port_{'host' if core == 'host' else 'emulated'}.c",
    ]
    flags = [
        "-std=gnu11",
        "-O2",
        *EXACT,
        "-I",
        str(INCLUDE),
        "-I",
        str(board),
        "-I",
        str(FIRMWARE_OF_EMULATOR),
    ]
    (folder / "inputs.bin").write_bytes(b"")
    if core == "host":
        run(["cc", *flags, *sources, "-o", folder / "loop"])
        words = [str(folder / "loop")]
    else:
        sources.append(FIRMWARE_OF_EMULATOR / "startup.c")
        link = [
            "-nostartfiles",
            "-nostdlib",
            "-L",
            str(FIRMWARE_OF_EMULATOR),
            f"-T{core}.ld",
            "-Wl,--gc-sections",
        ]
        target = [*COMMON[:-1], "-mcpu=cortex-m7", "-mfpu=fpv5-sp-d16", "-ffreestanding"]
        run(
            ["arm-none-eabi-gcc", *target, *flags, *sources, *link, "-lc", "-lgcc", "-o", folder / "loop.elf"]
        )
        words = [
            "qemu-system-arm",
            "-M",
            CORES[core].machine,
            "-kernel",
            "loop.elf",
            "-nographic",
            "-monitor",
            "none",
        ]
        words += ["-serial", "null", "-icount", "shift=6", "-semihosting-config", "enable=on,target=native"]
    done = subprocess.run(
        words, cwd=folder, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL
    )
    if done.returncode != 0:
        raise RuntimeError(f"{core}: the loop ended with {done.returncode}: {done.stderr}")
    return np.frombuffer((folder / "outputs.bin").read_bytes()[:-4], LOOP_TICK)


def loop_figures(folder: Path) -> dict[str, Any]:
    """Compare the loop on the emulated core with the host: differences, instructions of a tick, outcomes."""
    host, target = (fly_loop(folder / core, core) for core in ("host", "m7"))
    same = [
        (host[name].view("u1") == target[name].view("u1")).all() for name in ("frame", "status", "position")
    ]
    maximum = int(np.ceil(target["counted"].max() / CORES["m7"].ticks_per_instruction))
    return {
        "teensy_flight_ticks": len(target),
        "teensy_flight_differs": int(len(host) != len(target) or not all(same)),
        "teensy_flight_outcomes": len(np.unique(target["status"])),
        "teensy_wall_cm": int(np.floor(100 * (40 - target["position"][:, 0].max()))),
        "m7_teensy_tick_instructions": maximum,
    }


def measure(folder: Path) -> dict[str, Any]:
    """Compile into a folder and measure all figures."""
    found: dict[str, Any] = {}
    app: list[Path] = []
    for hulls in FIELDS:
        found[f"map_{hulls}_bytes"] = map_header(folder / f"map{hulls}", hulls)
        app = compile_crazyflie(folder / f"app{hulls}", folder / f"map{hulls}")
        size = sizes(app)
        found[f"crazyflie_{hulls}_flash_bytes"], found["crazyflie_ram_bytes"] = size["flash"], size["ram"]
    found["crazyflie_code_bytes"] = found["crazyflie_150_flash_bytes"] - found["map_150_bytes"]
    found["crazyflie_app_stack_bytes"] = stack_bound(folder, "app150", "appMain") + CONTEXT_BYTES
    found["crazyflie_loop_stack_bytes"] = stack_bound(folder, "app150", "controllerOutOfTree")
    more = app
    for obstacles in OBSTACLES:
        more = compile_crazyflie(folder / f"more{obstacles}", folder / "map150", obstacles)
        size, name = sizes(more), f"crazyflie_{obstacles}_obstacles"
        found[f"{name}_ram_bytes"] = size["ram"]
        found[f"{name}_code_bytes"] = size["flash"] - found["map_150_bytes"]
    deepest = stack_bound(folder, f"more{max(OBSTACLES)}", "appMain")
    found["crazyflie_obstacles_app_stack_bytes"] = deepest + CONTEXT_BYTES
    sketch = compile_teensy(folder / "teensy")
    size = sizes(sketch)
    found["teensy_flash_bytes"], found["teensy_ram_bytes"] = size["flash"], size["ram"]
    found["teensy_tick_stack_bytes"] = stack_bound(folder, "teensy", "alula_teensy_tick")
    found |= loop_figures(folder / "loop")
    found["fused_instructions"] = fused([*app, *more, *sketch])
    found["unknown_symbols"] = sorted(
        foreign(app, FIRMWARE) | foreign(more, FIRMWARE) | foreign(sketch, SKETCH)
    )
    return found


def complaints(figures: dict[str, Any]) -> list[str]:
    """List figures that exceed the limits of their board or violate a requirement."""
    crazyflie, teensy = TARGETS["crazyflie"], TARGETS["teensy"]
    found = [f"{name} is not in the firmware" for name in figures["unknown_symbols"]]
    if count := figures["fused_instructions"]:
        found.append(f"{count} instructions are fused multiply-adds")
    limits = {f"crazyflie_{hulls}_flash_bytes": crazyflie.flash_bytes for hulls in FIELDS} | {
        "crazyflie_ram_bytes": crazyflie.ram_bytes - APP_STACK_BYTES,
        "crazyflie_app_stack_bytes": APP_STACK_BYTES,
        "crazyflie_obstacles_app_stack_bytes": MORE_STACK_BYTES,
        "teensy_flash_bytes": teensy.flash_bytes,
        "teensy_ram_bytes": teensy.ram_bytes,
        "teensy_flight_differs": 0,
        "m7_teensy_tick_instructions": int(teensy.clock_hz / teensy.cycles_per_instruction * TICK_S),
    }
    found += [
        f"{name} is {figures[name]}, above {limit}" for name, limit in limits.items() if figures[name] > limit
    ]
    for obstacles in OBSTACLES:
        name = f"crazyflie_{obstacles}_obstacles_ram_bytes"
        if figures[name] > (promised := crazyflie.state_bytes(obstacles)):
            found.append(f"{name} is {figures[name]}; `export` counts {promised}")
    return found


def main() -> int:
    """Print the figures; return 1 when a requirement is violated."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    options = parser.parse_args()
    if missing := missing_tools():
        print(missing, file=sys.stderr)
        return 1
    with tempfile.TemporaryDirectory() as folder:
        found = measure(Path(folder))
    violations = complaints(found)
    if options.json:
        print(json.dumps(found))
    else:
        for name, value in found.items():
            print(f"{name:30} {value:>10,}" if isinstance(value, int) else f"{name:30} {value!s:>10}")
    for line in violations:
        print(line, file=sys.stderr)
    return 1 if violations else 0


if __name__ == "__main__":
    sys.exit(main())
