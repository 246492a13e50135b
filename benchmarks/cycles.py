"""Upper bound of the cycles of a Cortex-M4, from the instructions that an emulated core executed.

Cycles are the maxima of ARM's table (Cortex-M4 technical reference manual, 3.3 and 7.2.3): four for a taken
branch, two for loads and stores without pipelining of neighbours, one more where the next instruction uses a
float result. Wait states of memory are not included.
"""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

from emulated import CORES, replay

_INSTRUCTION = re.compile(r"^0x([0-9a-f]+):\s+((?:[0-9a-f]{4} ?)+)\s+(\S+)\s*(.*)$")
_TRACE = re.compile(r"^Trace \d+: \S+ \[[0-9a-f]+/([0-9a-f]+)/[^\]]*\] (\S*)")
_BRANCH = re.compile(r"^(b|bl|bx|blx|cbz|cbnz|b(eq|ne|hs|lo|mi|pl|vs|vc|hi|ls|ge|lt|gt|le))(\.w|\.n)?$")
_TAKEN = 4
ENTRY = {
    "polytope": "alula_polytope_cbf_filter",
    "geofence": "alula_geofence_filter",
    "stack": "alula_stack_filter",
}


@dataclass(frozen=True, slots=True)
class Step:
    """One instruction of the listing."""

    address: int
    size: int
    name: str
    operands: str

    def registers(self) -> int:
        """Number of words that a list of registers moves."""
        count = 0
        for part in self.operands[self.operands.index("{") + 1 : self.operands.index("}")].split(","):
            first, _, last = part.strip().partition("-")
            numbers = [re.sub(r"\D", "", word) for word in (first, last) if word]
            width = 2 if first.startswith("d") else 1
            count += width * (int(numbers[1]) - int(numbers[0]) + 1 if last else 1)
        return count

    def cycles(self, following: Step | None, *, is_taken: bool) -> int:
        """Maximum cycles, given the next instruction and whether this one branched."""
        name = self.name.split(".")[0]
        if _BRANCH.match(self.name):
            return _TAKEN if is_taken else 1
        if name.startswith(("tbb", "tbh")):
            return 1 + _TAKEN
        if "{" in self.operands:
            return 1 + self.registers() + (_TAKEN - 1 if is_taken else 0)
        if name.startswith(("vdiv", "vsqrt")):
            return 14
        if name.startswith(("vmla", "vmls", "vfma", "vfms", "vnml")):
            return 3
        if name.startswith(("ldrd", "strd")):
            return 3
        if name.startswith(("ldr", "str", "vldr", "vstr")):
            return 2 + (_TAKEN - 1 if is_taken else 0)
        if name.startswith(("sdiv", "udiv")):
            return 12
        if name.startswith(("mla", "mls")):
            return 2
        if name.startswith("v"):
            return 1 + self._is_awaited(name, following)
        return 1 + (_TAKEN - 1 if is_taken else 0)

    def _is_awaited(self, name: str, following: Step | None) -> int:
        if following is None:
            return 1
        if name.startswith("vcmp"):
            return int(following.name.startswith("vmrs"))
        result = self.operands.split(",")[0].strip()
        return int(re.search(rf"\b{re.escape(result)}\b", following.operands) is not None)


def trace(build_folder: Path, work: Path, name: str) -> Path:
    """Replay the inputs in `work` on the M4 and list the executed instructions."""
    board, log = CORES["m4"], work / "trace.txt"
    words = ["qemu-system-arm", "-M", board.machine, "-kernel", str(build_folder / "m4" / f"{name}.elf")]
    words += ["-nographic", "-monitor", "none", "-serial", "null", "-icount", "shift=6"]
    words += ["-semihosting-config", "enable=on,target=native", "-d", "exec,nochain,in_asm", "-D", str(log)]
    words += ["-device", f"loader,file=map.bin,addr={board.map_address:#x},force-raw=on"]
    subprocess.run(words, cwd=work, check=True, capture_output=True, stdin=subprocess.DEVNULL, timeout=300)
    return log


def count(log: Path, first: str, after: str) -> list[tuple[int, int]]:
    """Count instructions and cycles from each entry of the function `first` to the next block of `after`."""
    block: dict[int, list[Step]] = {}
    current: list[Step] = []
    path: list[list[Step]] = []
    found: list[tuple[int, int]] = []
    entry = None
    with log.open() as lines:
        for line in lines:
            if line.startswith("IN:"):
                current = []
            elif step := _INSTRUCTION.match(line):
                at, code, name, operands = step.groups()
                if not current:
                    block[int(at, 16)] = current
                current.append(Step(int(at, 16), 2 * len(code.split()), name, operands))
            elif hit := _TRACE.match(line):
                at, symbol = int(hit[1], 16), hit[2]
                if symbol == first and not path and entry in (None, at):
                    entry = at
                    path.append(block[at])
                elif path and symbol == after:
                    found.append(_sum(path))
                    path = []
                elif path:
                    path.append(block[at])
    return found


def cycles_per_instruction(build_folder: Path, work: Path, name: str, inputs: bytes, image: bytes) -> float:
    """Maximum cycles per instruction in the last tick of a replay of `polytope`, `geofence` or `stack`.

    Raises:
        RuntimeError: the traced instructions are not the counted ones.
    """
    counted = int(replay(build_folder, work, "m4", name, inputs, image).instructions[-1])
    log = trace(build_folder, work, name)
    instructions, cycles = count(log, ENTRY[name], "port_stop")[-1]
    log.unlink()
    if abs(instructions - counted) > 0.002 * counted + 100:
        raise RuntimeError(f"{instructions} instructions traced, {counted} counted")
    return cycles / instructions


def _sum(path: list[list[Step]]) -> tuple[int, int]:
    """Sum instructions and cycles of consecutive blocks; the last one returns."""
    instructions = cycles = 0
    for i, steps in enumerate(path):
        follower = path[i + 1][0] if i + 1 < len(path) else None
        for j, step in enumerate(steps):
            following = steps[j + 1] if j + 1 < len(steps) else follower
            is_taken = following is None or following.address != step.address + step.size
            cycles += step.cycles(following, is_taken=is_taken)
        instructions += len(steps)
    return instructions, cycles
