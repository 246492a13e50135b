"""The onboard code on emulated microcontrollers: cross-compiled, run under QEMU, measured.

Inputs recorded on the host go in and commands come out, with the instructions of every tick. The counter is
SysTick under `-icount`, which is exact and the same in every run. Sizes are the compiler's, stacks the
longest path of its call graph. native/onboard/targets/emulated has the firmware.
"""

from __future__ import annotations

import re
import shutil
import struct
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
FIRMWARE = ROOT / "native/onboard/targets/emulated"
TOOLS = {"arm-none-eabi-gcc": "gcc-arm-none-eabi", "qemu-system-arm": "qemu-system-arm"}
INSTALL = (
    "apt-get install -y --no-install-recommends gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"
)
_RAN_OVER = 2**32 - 1

POLYTOPE_TICK = np.dtype(
    [
        ("status", "<u4"),
        ("u", "<f4", 3),
        ("margin_m", "<f4"),
        ("hard_margin_m", "<f4"),
        ("fraction", "<f4"),
        ("active", "<u4"),
        ("counted", "<u4"),
        *((name, "<u4") for name in ("boxes", "hulls", "planes", "made", "exponentials")),
    ]
)
CHORD_TICK = np.dtype(
    [*((name, POLYTOPE_TICK[name]) for name in POLYTOPE_TICK.names or ()), ("rows", "<u4"), ("soft", "<u4")]
)
DR_ACBF_TICK = np.dtype(
    [
        ("status", "<u4"),
        ("a", "<f4", 3),
        *((name, "<u4") for name in ("mode", "feasible", "rows", "iterations")),
        ("horizon_s", "<f4"),
        ("violation", "<f4"),
        ("counted", "<u4"),
    ]
)
GEOFENCE_TICK = np.dtype(
    [
        ("status", "<u4"),
        ("command", "<f4", 4),
        *((name, "<f4") for name in ("lambda", "h_i", "distance_m", "margin_m")),
        ("deciding", "<u4"),
        ("v_towards", "<f4"),
        ("stale_s", "<f4"),
        ("counted", "<u4"),
    ]
)
STACK_TICK = np.dtype(
    [
        ("status", "<u4"),
        ("velocity", "<f4", 3),
        ("margin_m", "<f4"),
        *((name, "<u4") for name in ("mode", "rows", "obstacle_rows", "failing")),
        ("horizon_s", "<f4"),
        ("violation_m_s", "<f4"),
        ("counted", "<u4"),
        *((name, "<u4") for name in ("boxes", "hulls", "planes", "made", "exponentials", "soft")),
    ]
)
TICKS = {
    "polytope": (2, POLYTOPE_TICK),
    "chord": (2, CHORD_TICK),
    "dr_acbf": (1, DR_ACBF_TICK),
    "geofence": (2, GEOFENCE_TICK),
    "stack": (2, STACK_TICK),
}
"""By replay: number of statuses of its set-up, and the record of a tick."""


@dataclass(frozen=True, slots=True)
class Core:
    """An emulated board.

    Attributes:
        machine: QEMU's name of it.
        clock_hz: of the emulated core, which the ticks count.
        map_address: where the image lies in its flash.
        map_room: bytes there.
    """

    machine: str
    clock_hz: float
    map_address: int
    map_room: int

    @property
    def ticks_per_instruction(self) -> float:
        """Counter ticks per instruction; with `-icount shift=6` an instruction takes 64 ns."""
        return 64e-9 * self.clock_hz


CORES = {
    "m4": Core("netduinoplus2", 168e6, 0x08020000, 896 * 1024),
    "m7": Core("mps2-an500", 25e6, 0x00100000, 3 * 2**20),
}


def missing_tools() -> str:
    """Name the missing tools that emulation needs, and how to install them; empty when none is missing."""
    missing = [name for name in (*TOOLS, "make") if shutil.which(name) is None]
    return f"{', '.join(missing)} not found; {INSTALL}" if missing else ""


def build(folder: Path, *targets: str) -> None:
    """Build the firmware, and other named targets, under `folder`.

    Raises:
        RuntimeError: it does not compile; with the message of the compiler.
    """
    words = ["make", "-s", "-C", str(FIRMWARE), f"BUILD={folder}", *(targets or ("all",))]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(done.stderr)


@dataclass(frozen=True, slots=True)
class Replay:
    """Outputs of a replay.

    Attributes:
        set_up: statuses of opening the map and of the filter's set-up, 0 means success.
        ticks: one row per tick, as in TICKS.
        instructions: of each tick, shape (ticks,); nanoseconds on the host.
        stack_bytes: that were ever used.
    """

    set_up: tuple[int, ...]
    ticks: NDArray[np.void]
    instructions: NDArray[np.int64]
    stack_bytes: int


def replay(build_folder: Path, work: Path, core: str, name: str, inputs: bytes, image: bytes = b"") -> Replay:
    """Run one replay on a core, or on `host`, in the folder `work`.

    Raises:
        RuntimeError: the program or the emulator failed, or a tick took too long to be counted.
    """
    (work / "inputs.bin").write_bytes(inputs)
    (work / "map.bin").write_bytes(image)
    (work / "outputs.bin").unlink(missing_ok=True)
    if core == "host":
        words = [str(build_folder / "host" / name)]
        per_instruction = 1.0
    else:
        board = CORES[core]
        if len(image) > board.map_room:
            raise RuntimeError(
                f"a map of {len(image)} bytes does not fit into the {board.map_room} of {core}"
            )
        words = ["qemu-system-arm", "-M", board.machine, "-kernel", str(build_folder / core / f"{name}.elf")]
        words += ["-nographic", "-monitor", "none", "-serial", "null", "-icount", "shift=6"]
        words += ["-semihosting-config", "enable=on,target=native"]
        if image:
            words += ["-device", f"loader,file=map.bin,addr={board.map_address:#x},force-raw=on"]
        per_instruction = board.ticks_per_instruction
    done = subprocess.run(
        words, cwd=work, capture_output=True, text=True, check=False, timeout=600, stdin=subprocess.DEVNULL
    )
    out = (work / "outputs.bin").read_bytes() if (work / "outputs.bin").exists() else b""
    heads, row = TICKS[name]
    if len(out) < 4 * heads:
        raise RuntimeError(f"{core}: {name} ended with {done.returncode}: {done.stderr.strip()}")
    set_up = struct.unpack_from(f"<{heads}I", out)
    if any(set_up):
        return Replay(set_up, np.empty(0, row), np.empty(0, np.int64), 0)
    if done.returncode != 0:
        raise RuntimeError(f"{core}: {name} ended with {done.returncode}: {done.stderr.strip()}")
    ticks = np.frombuffer(out[4 * heads : -4], row)
    if (ticks["counted"] == _RAN_OVER).any():
        raise RuntimeError(f"{core}: a tick of {name} took longer than the counter counts")
    instructions = np.rint(ticks["counted"] / per_instruction).astype(np.int64)
    (stack,) = struct.unpack_from("<I", out, len(out) - 4)
    return Replay(set_up, ticks, instructions, stack)


def same_bits(one: NDArray[np.void], other: NDArray[np.void]) -> NDArray[np.bool_]:
    """Return whether ticks agree in every bit of every field except the counter, shape (ticks,)."""
    if len(one) != len(other):
        raise ValueError("the numbers of ticks differ")
    equal = np.ones(len(one), bool)
    for name in one.dtype.names or ():
        if name != "counted":
            a, b = (np.ascontiguousarray(x[name]).view("<u4").reshape(len(one), -1) for x in (one, other))
            equal &= (a == b).all(axis=1)
    return equal


def single(v: Any) -> list[float]:
    """Round to single precision."""
    return np.asarray(v, np.float32).astype(float).tolist()  # type: ignore[no-any-return]


def polytope_inputs(
    positions: NDArray[np.float32], nominal: NDArray[np.float32], parameters: Sequence[float]
) -> bytes:
    """Inputs of the replay `polytope`; parameters are extent, radius, beta, kappa, dt and v_max."""
    rows = np.hstack([positions, nominal]).astype("<f4")
    return struct.pack("<I6f", len(rows), *parameters) + rows.tobytes()


def chord_inputs(states: NDArray[np.float32], parameters: Sequence[float]) -> bytes:
    """Inputs of the replay `chord`.

    Args:
        states: rows of position, velocity and nominal velocity, shape (ticks, 9).
        parameters: extent, radius, beta, lag, dt and v_max.
    """
    return struct.pack("<I6f", len(states), *parameters) + states.astype("<f4").tobytes()


def dr_acbf_inputs(
    ticks: Sequence[tuple[Sequence[float], Sequence[float], NDArray[np.float64], Sequence[float]]],
) -> bytes:
    """Inputs of the replay `dr_acbf`: position, velocity, tracks as in `MovingFilter.filter`, nominal."""
    parts = [struct.pack("<I", len(ticks))]
    for position, velocity, tracks, nominal in ticks:
        parts.append(struct.pack("<12f3f2I", *position, *velocity, *[0.0] * 6, *nominal, len(tracks), 0))
        for row in tracks:
            parts.append(struct.pack("<I31f", int(row[0]), *row[1:28], row[28], 0.0, 0.0, 0.0))
    return b"".join(parts)


@dataclass(frozen=True, slots=True)
class Flight:
    """Ticks for one geofence.

    Attributes:
        config: bytes, `Geofence.config_words`.
        fence: bytes, `Geofence.fence_words`.
        states: shape (ticks, 13); rows of NaN without navigation.
        pilots: shape (ticks, 4); rows of NaN without a pilot.
    """

    config: bytes
    fence: bytes
    states: NDArray[np.float32]
    pilots: NDArray[np.float32]


def geofence_inputs(flights: Sequence[Flight], *, has_map: bool) -> bytes:
    """Inputs of the replay `geofence`."""
    row = np.dtype([("there", "<u4"), ("state", "<f4", 13), ("pilot", "<f4", 4)])
    parts = [struct.pack("<2I", len(flights), has_map)]
    for flight in flights:
        ticks = np.zeros(len(flight.states), row)
        ticks["state"], ticks["pilot"] = flight.states, flight.pilots
        gone = [np.isnan(rows).all(axis=1) for rows in (flight.states, flight.pilots)]
        ticks["there"] = ~gone[0] + 2 * ~gone[1]
        parts += [flight.config, flight.fence, struct.pack("<I", len(ticks)), ticks.tobytes()]
    return b"".join(parts)


def sizes(build_folder: Path, core: str, name: str) -> dict[str, int]:
    """Bytes of text (code and constants), data and bss of one replay with its part of the library."""
    elf = build_folder / core / f"{name}.elf"
    out = subprocess.run(["arm-none-eabi-size", str(elf)], capture_output=True, text=True, check=True).stdout
    text, data, bss = (int(word) for word in out.splitlines()[1].split()[:3])
    return {"text": text, "data": data, "bss": bss}


def library_sizes(build_folder: Path, core: str) -> dict[str, int]:
    """Bytes of code, constants and variables of the whole library, all its filters."""
    words = ["arm-none-eabi-size", "-A", str(build_folder / core / "libalula_onboard.a")]
    out = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    found = {"text": 0, "rodata": 0, "data": 0, "bss": 0}
    for section, size in re.findall(r"^\.(text|rodata|data|bss)\S*\s+(\d+)\s", out, re.MULTILINE):
        found[section] += int(size)
    return found


def symbol_bytes(build_folder: Path, core: str, name: str, symbol: str) -> int:
    """Bytes of a variable of a replay: a filter with all its state."""
    elf = build_folder / core / f"{name}.elf"
    out = subprocess.run(
        ["arm-none-eabi-nm", "-S", str(elf)], capture_output=True, text=True, check=True
    ).stdout
    for line in out.splitlines():
        words = line.split()
        if len(words) == 4 and words[3] == symbol:
            return int(words[1], 16)
    raise KeyError(symbol)


_NODE = re.compile(r'node: \{ title: "([^"]+)" label: "[^"]*?\\n(?:(\d+) bytes \(([^)]*)\))?"')
_EDGE = re.compile(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"')


def stack_bound(build_folder: Path, core: str, function: str) -> int:
    """Maximum stack of a function of the library [bytes]: the longest path of its call graph.

    Library routines that the compiler adds (copies of memory) count 64 bytes; calls through pointers, which
    are only there for comparisons on a host, count nothing.

    Raises:
        RuntimeError: the graph has a cycle, or a frame is of no fixed size.
    """
    frame: dict[str, int] = {}
    calls: dict[str, set[str]] = {}
    for file in (build_folder / core).glob("alula_*.ci"):
        text = file.read_text()
        for name, size, kind in _NODE.findall(text):
            if size:
                if kind != "static":
                    raise RuntimeError(f"the frame of {name} is {kind}")
                frame[name] = int(size)
        for source, target in _EDGE.findall(text):
            calls.setdefault(source, set()).add(target)

    def longest(name: str, path: tuple[str, ...]) -> int:
        if name in path:
            raise RuntimeError(f"{name} calls itself")
        if name not in frame:
            return 0 if name == "__indirect_call" else 64
        below = (longest(target, (*path, name)) for target in calls.get(name, ()))
        return frame[name] + max(below, default=0)

    if function not in frame:
        raise KeyError(function)
    return longest(function, ())
