"""The filters on emulated microcontrollers: instructions per tick, bytes, and comparison with the host.

Flights among 150 and 1,000 hulls of at least 83 half-planes (the average of PolyMerge's) are simulated with
polytope-cbf on an onboard map, 500 ticks a second, and every fiftieth tick is recorded. Ticks at unrelated
positions anywhere, also inside hulls, are added: the worst case for the data that a tick caches. Encounters
of examples/dr-acbf are recorded with dr-acbf, and flights inside fences with the geofence. All ticks are
replayed under QEMU on a Cortex-M4 and a Cortex-M7, and compared bit for bit with the library that the
simulator calls. Only host_*_us are times; instructions are counted, and are the same in every run with the
same compiler.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.append(str(Path(__file__).resolve().parent))
sys.path.sort(key=sys.path[-1].__eq__)  # last: newer standard libraries have a package `compression`

import chord_ticks
import encounter_ticks
import fence_ticks
import numpy as np
import stack_ticks
from cycles import cycles_per_instruction
from emulated import (
    FIRMWARE,
    Replay,
    build,
    library_sizes,
    missing_tools,
    polytope_inputs,
    replay,
    single,
    stack_bound,
    symbol_bytes,
)
from numpy.typing import NDArray

from alula import _core
from alula.schemas.artifacts.artifact import Artifact, make_artifact
from alula.schemas.artifacts.kinds import COVER
from alula.schemas.artifacts.manifest import Guarantee
from alula.schemas.parameters.targets import CODE_BYTES, TARGETS
from alula.stages.compression.onboard.cost import tick_instructions
from alula.stages.compression.onboard.image import decode_map
from alula.stages.compression.onboard.layout import encode_map

BUDGET = FIRMWARE / "budget.toml"
HALF_PLANES = 83  # average of a hull of PolyMerge
G = 0.05
HALVES = {
    150: (100, 80, 30),
    290: (125, 100, 40),
    1000: (200, 150, 45),
}  # hulls: half the field's size in voxels
FIELDS = (150, 1000)  # flown with polytope-cbf
KEEP_OUT, KEEP_OUT_G = 290, 0.1  # hulls outside of which the geofence stays
PARAMETERS = {"radius_m": 0.1, "beta": 2.0, "kappa": 100.0, "dt_s": 0.002, "v_max": 1.0}
RATES = {150: 500, 1000: 125}
GEOFENCE_US = 350  # time of a tick on the paper's M7
STACK_MS = 10.0  # period of the Crazyflie's app
EVERY, FLIGHTS, TICKS, ANYWHERE = 50, 10, 80, 300
FloatArray = NDArray[np.float64]
ENTRIES = (
    "alula_map_open",
    "alula_polytope_cbf_open",
    "alula_polytope_cbf_filter",
    "alula_chord_open",
    "alula_chord_filter",
    "alula_dr_acbf_init",
    "alula_dr_acbf_filter",
    "alula_geofence_init",
    "alula_geofence_filter",
    "alula_stack_init",
    "alula_stack_filter",
    "alula_tiles_open",
    "alula_tiles_select",
    "alula_tiles_loaded",
)
WORK = ("boxes", "hulls", "planes", "made", "exponentials")


def lattice_hull(points: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Vertices (n, 3) and primitive planes (m, 4) of the convex hull of lattice points."""
    from scipy.spatial import ConvexHull

    solid = ConvexHull(points)
    a, b, c = (points[solid.simplices[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    normal *= np.where((normal * solid.equations[:, :3]).sum(axis=1) < 0, -1, 1)[:, None]
    normal //= np.gcd.reduce(normal, axis=1)[:, None]
    return points[solid.vertices], np.unique(np.column_stack([normal, (normal * a).sum(axis=1)]), axis=0)


def field(hulls: int, seed: int = 1, g: float = G) -> Artifact:
    """Make a cover of overlapping round hulls, 10 to 28 voxels across."""
    rng, half = np.random.default_rng(seed), np.array(HALVES[hulls])
    parts = []
    for _ in range(hulls):
        direction = rng.normal(size=(60, 3))
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        parts.append(
            lattice_hull(
                np.rint(rng.uniform(-half, half) + direction * rng.uniform(5, 14, 3)).astype(np.int64)
            )
        )
    vertices, planes = [v for v, _ in parts], [p for _, p in parts]

    def start(rows: list[NDArray[np.int64]]) -> NDArray[np.int64]:
        return np.concatenate([[0], np.cumsum([len(r) for r in rows])])

    every = np.concatenate(planes)
    arrays = {
        "vertex": np.concatenate(vertices),
        "vertex_start": start(vertices),
        "plane_normal": every[:, :3],
        "plane_offset": every[:, 3],
        "plane_start": start(planes),
        "member_index": np.array([v[0] for v in vertices]),
        "member_start": np.arange(hulls + 1),
        "history": np.empty((0, 3)),
    }
    return make_artifact(
        COVER,
        arrays,
        frame="world",
        unit="m",
        parameters={},
        summary={},
        guarantee=Guarantee("Made for measuring."),
        certificate={},
        voxel_size_m=g,
        sigma=1.0,
        min_overlap=1,
        conservativeness=1.0,
    )


@dataclass(frozen=True, slots=True)
class Recorded:
    """Ticks of polytope-cbf and the host's results.

    Attributes:
        image: the map.
        inputs: of the replay.
        u: filtered velocity, shape (ticks, 3) [m/s].
        status: shape (ticks,).
        margin_m: shape (ticks,).
        in_flight: true for ticks of flights, false for those anywhere, shape (ticks,).
    """

    image: bytes
    inputs: bytes
    u: NDArray[np.float32]
    status: NDArray[np.int64]
    margin_m: NDArray[np.float32]
    in_flight: NDArray[np.bool_]

    def ticks(self, begin: int, end: int) -> bytes:
        """Inputs of the ticks from `begin` to `end`."""
        head, row = 4 + 4 * 6, 4 * 6
        chosen = self.inputs[head + row * begin : head + row * end]
        return (end - begin).to_bytes(4, "little") + self.inputs[4:head] + chosen


def fly(hulls: int) -> Recorded:
    """Simulate flights through a field of `hulls` hulls on its onboard map."""
    image = encode_map(field(hulls), indexed=True)
    rng, half = np.random.default_rng(2), np.array(HALVES[hulls]) * G
    extent = float(half.max()) + 2.0
    native = _core.PolytopeCbf.from_image(image, extent_m=extent, **PARAMETERS)

    rows: list[tuple[Any, ...]] = []
    for _ in range(FLIGHTS):
        x = rng.uniform(-half, half)
        while native.psi(x[None])[1][0] < PARAMETERS["radius_m"] + 0.05:
            x = rng.uniform(-half, half)
        goal = rng.uniform(-half, half)
        for tick in range(EVERY * TICKS):
            to_goal = goal - x
            at, nominal = single(x), single(to_goal / max(float(np.linalg.norm(to_goal)), 1.0))
            u, status, margin, _, _ = native.filter(at, nominal)
            if tick % EVERY == 0:
                rows.append((at, nominal, u, status, margin, True))
            x = np.array(at) + PARAMETERS["dt_s"] * np.array(u)
    for _ in range(ANYWHERE):
        at, nominal = single(rng.uniform(-half, half)), single(rng.normal(size=3))
        u, status, margin, _, _ = native.filter(at, nominal)
        rows.append((at, nominal, u, status, margin, False))
    at, nominal, u, status, margin, in_flight = (np.array(column) for column in zip(*rows, strict=True))
    order = ("radius_m", "beta", "kappa", "dt_s", "v_max")
    inputs = polytope_inputs(
        at.astype(np.float32), nominal.astype(np.float32), [extent, *(PARAMETERS[name] for name in order)]
    )
    return Recorded(
        image, inputs, u.astype(np.float32), status, margin.astype(np.float32), in_flight.astype(bool)
    )


def polytope_mismatches(recorded: Recorded, found: Replay) -> int:
    """Count the ticks whose command, status or margin differ from the host's in a bit."""
    ticks = found.ticks
    u = np.where(
        (recorded.status == 0)[:, None], ticks["u"], recorded.u
    )  # otherwise the host returns doubles
    same = (u.view(np.uint32) == np.ascontiguousarray(ticks["u"]).view(np.uint32)).all(axis=1)
    same &= (recorded.status == ticks["status"]) & (recorded.margin_m == ticks["margin_m"])
    return int((~same).sum())


@dataclass(frozen=True, slots=True)
class Measured:
    """Results of the measurement.

    Attributes:
        figures: numbers by name, as printed.
        tight: by core and field, ratio of the model's instructions to the counted ones, shape (ticks,).
    """

    figures: dict[str, Any]
    tight: dict[str, NDArray[np.float64]]


def measure(folder: Path, say: Callable[[str], None]) -> Measured:
    """Build, replay and compare everything in a folder."""
    say("building")
    firmware, work = folder / "firmware", folder / "work"
    work.mkdir(parents=True, exist_ok=True)
    build(firmware, "all", "host")
    found: dict[str, Any] = {"host_target_mismatches": 0, "ticks": 0}
    tight: dict[str, NDArray[np.float64]] = {}
    crazyflie = TARGETS["crazyflie"]
    for hulls in FIELDS:
        say(f"{hulls} hulls")
        recorded = fly(hulls)
        planes = decode_map(recorded.image).half_planes / hulls
        assert planes >= HALF_PLANES
        found |= {f"map_{hulls}_bytes": len(recorded.image), f"map_{hulls}_half_planes_per_hull": planes}
        for core in ("m4", "m7"):
            out = replay(firmware, work, core, "polytope", recorded.inputs, recorded.image)
            name = f"{core}_polytope_{hulls}"
            found[f"{name}_instructions"] = int(out.instructions.max())
            found[f"{name}_flight_instructions"] = int(out.instructions[recorded.in_flight].max())
            found[f"{name}_median_instructions"] = int(np.median(out.instructions[recorded.in_flight]))
            found[f"{core}_polytope_stack_bytes"] = max(
                out.stack_bytes, found.get(f"{core}_polytope_stack_bytes", 0)
            )
            found["host_target_mismatches"] += polytope_mismatches(recorded, out)
            found["ticks"] += len(out.ticks)
            if name == "m4_polytope_150":
                worst = max(int(out.instructions.argmax()), 1)
                found["m4_cycles_per_instruction"] = cycles_per_instruction(
                    firmware, work, "polytope", recorded.ticks(worst - 1, worst + 1), recorded.image
                )
            looked = np.column_stack([out.ticks[word].astype(np.int64) for word in WORK])
            tight[name] = tick_instructions(looked) / out.instructions
        cycles = found[f"m4_polytope_{hulls}_instructions"] * crazyflie.cycles_per_instruction
        found[f"m4_polytope_{hulls}_hz"] = int(crazyflie.clock_hz / cycles)
    say("encounters")
    parts = [encounter_ticks.measure(firmware, work)]
    say("geofences")
    kept_out = field(KEEP_OUT, g=KEEP_OUT_G)
    parts.append(fence_ticks.measure(firmware, work, kept_out, np.array(HALVES[KEEP_OUT]) * KEEP_OUT_G))
    say("stack")
    image = encode_map(field(FIELDS[0]), indexed=True)
    parts.append(stack_ticks.measure(firmware, work, image, np.array(HALVES[FIELDS[0]]) * G))
    say("vehicles that lag")
    parts.append(chord_ticks.measure(firmware, work, image, np.array(HALVES[FIELDS[0]]) * G, tight))
    for part in parts:
        for name in ("ticks", "host_target_mismatches"):
            found[name] += part.pop(name)
        found |= part
    teensy = TARGETS["teensy"]
    per_us = teensy.clock_hz / teensy.cycles_per_instruction / 1e6
    found["m7_geofence_us"] = found["m7_geofence_instructions"] / per_us
    per_ms = crazyflie.clock_hz / crazyflie.cycles_per_instruction / 1e3
    found["stack_m4_worst_ms"] = found["stack_m4_worst_instructions"] / per_ms
    found |= room(firmware, found)
    return Measured(found, tight)


def room(firmware: Path, measured: dict[str, Any]) -> dict[str, Any]:
    """Bytes on the M4: library, state of all filters, the larger map and the deepest stack."""
    sizes = library_sizes(firmware, "m4")
    state = sum(
        symbol_bytes(firmware, "m4", name, symbol)
        for name, symbol in (
            ("polytope", "replayed_map"),
            ("polytope", "replayed_polytope_cbf"),
            ("dr_acbf", "replayed_dr_acbf"),
            ("geofence", "replayed_geofence"),
            ("geofence", "replayed_fence"),
        )
    )
    composed = sum(
        symbol_bytes(firmware, "m4", "stack", f"replayed_stack{part}") for part in ("", "_map", "_fence")
    )
    stack = {entry: stack_bound(firmware, "m4", entry) for entry in ENTRIES}
    code = sizes["text"] + sizes["rodata"] + sizes["data"]
    return {
        "text_bytes": sizes["text"],
        "rodata_bytes": sizes["rodata"],
        "data_bytes": sizes["data"],
        "bss_bytes": sizes["bss"],
        "code_bytes": code,
        "flash_bytes": code + measured[f"map_{max(FIELDS)}_bytes"],
        "state_bytes": state,
        "stack_state_bytes": composed,
        "stack_bytes": max(stack.values()),
        "ram_bytes": sizes["data"] + sizes["bss"] + max(state, composed) + max(stack.values()),
        **{f"stack_{entry.removeprefix('alula_')}_bytes": value for entry, value in stack.items()},
    }


def complaints(figures: dict[str, Any]) -> list[str]:
    """List figures that exceed the checked-in budget or the Crazyflie, and differences from the host."""
    with BUDGET.open("rb") as file:
        budget = tomllib.load(file)
    crazyflie, found = TARGETS["crazyflie"], []
    for name, limit in budget["most"].items():
        if figures[name] > limit * (1 + budget["slack"]):
            found.append(f"{name} is {figures[name]}; the budget is {limit} with {budget['slack']:.0%} slack")
    if figures["host_target_mismatches"]:
        found.append(f"{figures['host_target_mismatches']} ticks differ from the host")
    if figures["code_bytes"] > CODE_BYTES:
        found.append(f"the code takes {figures['code_bytes']} bytes; maps leave {CODE_BYTES} for it")
    if figures["flash_bytes"] > crazyflie.flash_bytes:
        found.append(f"{figures['flash_bytes']} bytes do not fit into {crazyflie.flash_bytes} of flash")
    if figures["ram_bytes"] > crazyflie.ram_bytes:
        found.append(f"{figures['ram_bytes']} bytes do not fit into {crazyflie.ram_bytes} of RAM")
    for name in ("m4", "m4_geofence", "m4_geofence_faces", "m4_geofence_map", "m4_stack"):
        if figures[f"{name}_cycles_per_instruction"] > crazyflie.cycles_per_instruction:
            found.append(
                f"{name}_cycles_per_instruction is {figures[f'{name}_cycles_per_instruction']}, above 2"
            )
    if figures["m7_geofence_us"] > GEOFENCE_US:
        found.append(
            f"a tick of the geofence takes {figures['m7_geofence_us']:.0f} µs, the paper's {GEOFENCE_US} µs"
        )
    if figures["stack_m4_worst_ms"] > STACK_MS:
        found.append(f"a tick of the stack takes {figures['stack_m4_worst_ms']:.1f} ms, above {STACK_MS}")
    for hulls, rate in RATES.items():
        if figures[f"m4_polytope_{hulls}_hz"] < rate:
            found.append(f"{hulls} hulls reach {figures[f'm4_polytope_{hulls}_hz']} Hz, not {rate}")
    return found


def main() -> int:
    """Measure and print; return 4 when a figure exceeds its budget."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--keep", type=Path, help="folder for the firmware and the last replay")
    parser.add_argument("--markdown", type=Path, help="replace the table of this page")
    chosen = parser.parse_args()
    if missing := missing_tools():
        print(f"nothing can be emulated here: {missing}", file=sys.stderr)
        return 3

    def say(what: str) -> None:
        print(what, file=sys.stderr)

    with tempfile.TemporaryDirectory() as temporary:
        figures = measure(chosen.keep or Path(temporary), say).figures
    if chosen.json:
        print(json.dumps(figures, indent=2))
    else:
        for name, value in figures.items():
            print(f"{name:<40} {value:,.6g}" if isinstance(value, float) else f"{name:<40} {value:,}")
    if chosen.markdown is not None:
        write_table(chosen.markdown, figures)
    violations = complaints(figures)
    for line in violations:
        print(line, file=sys.stderr)
    return 4 if violations else 0


def write_table(page: Path, figures: dict[str, Any]) -> None:
    """Write the figures between the page's two marks."""
    begin, end = "<!-- measured: benchmarks/onboard.py --markdown -->\n", "<!-- end -->\n"
    rows = ["| figure | value |", "| --- | ---: |"]
    rows += [
        f"| `{name}` | {value:,.4g} |" if isinstance(value, float) else f"| `{name}` | {value:,} |"
        for name, value in figures.items()
    ]
    text = page.read_text()
    before, after = text.index(begin) + len(begin), text.index(end)
    page.write_text(text[:before] + "\n".join(rows) + "\n" + text[after:])


if __name__ == "__main__":
    sys.exit(main())
