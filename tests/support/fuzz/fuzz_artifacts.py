"""Mutated artifacts against every command that reads them: hashes stay right, as an attacker's would.

Each mutant runs in a fork of its own with bounded memory and processor time. A command may succeed or refuse
it with one line; it may not end with 1, by a signal, with a warning, or beyond the bounds.

    python -P tests/support/fuzz/fuzz_artifacts.py --most 20000 --keep build/fuzz-artifacts
"""

from __future__ import annotations

import argparse
import gc
import hashlib
import io
import json
import multiprocessing
import os
import random
import re
import resource
import shutil
import struct
import sys
import tempfile
import time
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

CPU_S = 20  # of processor time per mutant
WALL_S = 180  # of a machine that other programs load
ROOM = 2**30  # bytes of address space beyond what the process has before it reads
ALLOWED = {0, 2, 3, 4, 5, 6}

DEEP = 3000
STRINGS = ("", "\x1b[2J", "x" * 3000, "../../a", "NaN", "\u202e", "0", "alula/scene", "9.0", "\ud800", "-")
NUMBERS = (
    *(0, -1, 1, 2, 3, 7, 255, 2**31 - 1, 2**31, 2**53, 2**63 - 1, 2**63, 2**64, -(2**63), 10**30),
    *(0.0, -0.0, 0.5, 1e-6, 1e-12, 1e-320, 1e6, 1e12, 1e30, 1e154, 1e200, 1e308, -1e308, -1e-9),
)


@dataclass(frozen=True)
class Target:
    """A command on a file: `{}` stands for the mutant, other names in braces for unchanged files.

    Attributes:
        words: of the command line; outputs go to a folder of the mutant.
        weight: how often it is chosen.
        valid: exit codes for the unchanged file.
    """

    words: str
    weight: float = 1.0
    valid: tuple[int, ...] = (0, 4)


_SHORT = "--trials 2 --set rules.max_time_s=0.3 -o {out}/o.run.mcap"
_SCENARIO = (Target("info {}", 3), Target(f"simulate {{}} {_SHORT}", 4), Target("info {} --json"))
_CSV = "--max-rms 100 -o {out}/o.scene.npz"
TARGETS: dict[str, tuple[Target, ...]] = {
    "tiny.scene.npz": (
        Target("info {}", 2),
        Target("info {} --json"),
        Target("scale-align {} --scale 2 -o {out}/o.scene.npz"),
        Target('scale-align {} --distance "0 0 0" "1 0 0" 2 --up "0 0 1" -o {out}/o.scene.npz'),
        Target('scale-align {} --scale 1 --up "0 0 1" --floor -o {out}/o.scene.npz', 0.3, (0, 2, 3, 4)),
        Target("export {} -o {out}/o.ply", 0.5),
        Target("export {} -o {out}/o.spz", 0.5),
        Target("export {} -o {out}/o.splat", 0.5),
        Target("export {} -o {out}/o.glb", 0.5),
    ),
    "tiny.metric.scene.npz": (
        Target("voxelize {} --size 0.2 --jobs 1 -o {out}/o.voxels.npz", 4),
        Target("scale-align {} --scale 1 --json -o {out}/o.scene.npz"),
        Target("verify {cover} --voxels {voxels} --scene {} --jobs 1", 2),
        Target(f"simulate {{}} --filter cone-ecbf {_SHORT}", 1),
        Target(f"simulate {{}} --filter cone-backup {_SHORT}", 1),
        Target(f"simulate {{cover}} --scene {{}} {_SHORT}"),
        Target("report --scene {} --cover {cover} -o {out}/o.html", 0.5),
        Target("view {} -o {out}/o.html", 0.5),
    ),
    "tiny.voxels.npz": (
        Target("info {}"),
        Target("merge {} --hulls 6 --jobs 1 -o {out}/o.cover.npz", 3),
        Target("merge {} --max-bytes 2000 --jobs 1 -o {out}/o.cover.npz", 0.5),
        Target("view {} -o {out}/o.html", 0.5),
        Target("verify {cover} --voxels {} --jobs 1 -o {out}/o.json", 2),
    ),
    "tiny.cover.npz": (
        Target("info {}", 2),
        Target("verify {} --jobs 1", 2),
        Target("verify {} --voxels {voxels} --scene {metric} --jobs 1", 1),
        Target("verify {map} --cover {} --jobs 1"),
        Target('plan {} --start "0.5 1.5 1" --goal "3.5 1.5 1" --jobs 1 -o {out}/o.plan.npz', 2),
        Target(f"simulate {{}} {_SHORT}", 2),
        Target("simulate {plan} --map {} --set rules.max_time_s=0.3 -o {out}/o.run.mcap"),
        *(Target(f"export {{}} -o {{out}}/o.{name}", 0.4) for name in ("glb", "obj", "json", "stl", "bin")),
        Target("export {} --target crazyflie -o {out}/o.bin", 0.4),
        Target("report --cover {} -o {out}/o.html", 0.6),
        Target("view {} -o {out}/o.html", 0.5),
    ),
    "tiny.plan.npz": (
        Target("info {}"),
        Target("simulate {} --map {cover} --set rules.max_time_s=0.3 -o {out}/o.run.mcap", 3),
        Target("simulate {} --map {cover} --filter none --set rules.max_time_s=0.3 -o {out}/o.run.mcap"),
        Target("report --plan {} --cover {cover} -o {out}/o.html", 1.0),
        Target("view {} {cover} -o {out}/o.html", 0.5),
    ),
    "tiny.map.bin": (
        Target("info {}", 2),
        Target("verify {} --cover {cover} --jobs 1", 2),
        Target("verify {} --voxels {voxels} --jobs 1"),
    ),
    "tiny.run.mcap": (
        Target("info {}", 3),
        Target("info {} --json"),
        Target(f"simulate {{cover}} --pairs-from {{}} {_SHORT.replace('2', '1')}", 3),
        Target("report {} -o {out}/o.html", 2.0),
        Target("report {} {run} --cover {cover} -o {out}/o.json", 1.0),
        Target("view {} -o {out}/o.html", 0.5),
        Target("export {} --ros2 -o {out}/bag"),
        Target("export {} --foxglove-layout -o {out}/o.json"),
    ),
    "fence.run.mcap": (
        Target("info {}"),
        Target("report {} -o {out}/o.html", 1.5),
        Target("view {} -o {out}/o.html", 0.5),
    ),
    "tiny.run.json": (Target("info {}"), Target("report {run} -o {out}/o.html", 1.0)),
    "tiny.certificate.json": (
        Target("info {}"),
        Target("report --certificate {} --cover {cover} -o {out}/o.html", 1.0),
    ),
    "tiny.toml": _SCENARIO,
    "encounters.toml": (*_SCENARIO, Target(f"simulate {{}} --filter mpc {_SHORT}")),
    "fence.toml": tuple(
        replace(one, words=one.words.replace("--trials 2", "--trials 1")) for one in _SCENARIO
    ),
    "tiny.vehicle.toml": (
        Target("info {}", 2),
        Target(f"simulate {{metric}} --vehicle {{}} --filter cone-ecbf {_SHORT}", 2),
    ),
    "pairs.csv": (Target(f"scale-align {{scene}} --correspondences {{}} {_CSV}"),),
    "poses.csv": (Target(f"scale-align {{scene}} --cameras {{poses}} --poses {{}} {_CSV}"),),
    "reference.csv": (
        Target(f"scale-align {{scene}} --cameras {{poses}} --reference {{}} {_CSV}"),
        Target(f"scale-align {{scene}} --cameras {{}} --reference {{reference}} {_CSV}"),
    ),
    "transform.json": (Target("scale-align {scene} --transform {} -o {out}/o.scene.npz"),),
    "dataparser_transforms.json": (Target("scale-align {scene} --nerfstudio {} -o {out}/o.scene.npz"),),
}
FILES = {
    "cover": "tiny.cover.npz",
    "voxels": "tiny.voxels.npz",
    "scene": "tiny.scene.npz",
    "metric": "tiny.metric.scene.npz",
    "plan": "tiny.plan.npz",
    "map": "tiny.map.bin",
    "run": "tiny.run.mcap",
    "poses": "poses.csv",
    "reference": "reference.csv",
}


def make_seeds(folder: Path) -> None:
    """Add to a pipeline's files those of the other commands."""
    from alula.cli.main import run
    from support.paths import ROOT

    for name, source in (("fence", "geofencing/wall.toml"), ("encounters", "dr-acbf/both.toml")):
        text = (ROOT / "examples" / source).read_text()
        vehicles = ROOT / "examples" / "vehicles"
        (folder / f"{name}.toml").write_text(text.replace("../vehicles", str(vehicles)))
    words = (
        f"simulate {folder}/fence.toml --trials 1 --set rules.max_time_s=0.5 -o {folder}/fence.run.mcap -q"
    )
    assert run(words.split()) in (0, 4)
    rng = np.random.default_rng(4)
    rows = ["image,x,y,z,qw,qx,qy,qz"]
    places = ["image,x,y,z"]
    for i in range(12):
        q = rng.normal(size=4)
        q /= np.linalg.norm(q)
        place = ",".join(f"{v:.6f}" for v in rng.uniform(-3, 3, 3))
        rows.append(f"{i:03d}.png,{place}," + ",".join(f"{v:.9f}" for v in q))
        places.append(f"{i:03d}.png,{place}")
    scenario = (folder / "tiny.toml").read_text()
    (folder / "tiny.toml").write_text(scenario.replace('"tiny.cover', f'"{folder}/tiny.cover'))
    (folder / "poses.csv").write_text("\n".join(rows) + "\n")
    (folder / "reference.csv").write_text("\n".join(places) + "\n")
    (folder / "transform.json").write_text(
        json.dumps({"scale": 2.0, "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "translation_m": [0, 0, 1]})
    )
    (folder / "dataparser_transforms.json").write_text(
        json.dumps({"transform": [[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 1.0, 0]], "scale": 0.5})
    )


# --- mutations --------------------------------------------------------------------------------------------


def any_value(rng: random.Random) -> Any:
    """A value of any JSON type."""
    match rng.randrange(9):
        case 0:
            return None
        case 1:
            return rng.choice((True, False))
        case 2 | 3:
            return rng.choice(STRINGS)
        case 4 | 5 | 6:
            return rng.choice(NUMBERS)
        case 7:
            return [any_value(rng) for _ in range(rng.randrange(4))]
        case _:
            return {rng.choice(STRINGS): any_value(rng) for _ in range(rng.randrange(3))}


def _places(tree: Any) -> list[tuple[Any, Any]]:
    """Containers and keys of all values."""
    found = []
    stack = [tree]
    while stack:
        at = stack.pop()
        items = at.items() if isinstance(at, dict) else enumerate(at) if isinstance(at, list) else ()
        for key, value in items:
            found.append((at, key))
            stack.append(value)
    return found


def mutate_tree(tree: Any, rng: random.Random) -> None:
    """Change one to three values of plain JSON in place."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        places = _places(tree)
        if not places:
            return
        at, key = rng.choice(places)
        value = at[key]
        match rng.randrange(8):
            case 0 if isinstance(at, dict):
                del at[key]
            case 1 if isinstance(at, dict):
                at[rng.choice(STRINGS)] = value
            case 2 if isinstance(at, list):
                at.extend([value] * rng.choice((1, 2, 100)))
            case 3 if isinstance(at, list):
                del at[key]
            case 4 if isinstance(value, int | float) and not isinstance(value, bool):
                at[key] = rng.choice((-value, value * 1e3, value * 1e9, value + 1, float(value), value / 7))
            case 5:
                at[key] = [value]
            case _:
                at[key] = any_value(rng)


def json_text(tree: Any, rng: random.Random) -> bytes:
    """Encode, now and then with what JSON does not have or what is too much."""
    text = json.dumps(tree)
    draw = rng.random()
    if draw < 0.03:
        text = re.sub(r"-?\d+\.\d+", rng.choice(("NaN", "Infinity", "1e999", "1" * 400)), text, count=1)
    elif draw < 0.06:
        opens, closes = rng.choice((("[", "]"), ('{"a":', "}")))
        deep = opens * DEEP + "1" + closes * DEEP
        places = [m.start() for m in re.finditer(r"(?<=: )(\d|\"|null|\{|\[)", text)]
        at = rng.choice(places or [0])
        text = text[:at] + deep + ', "z": ' + text[at:]
    elif draw < 0.08:
        text = text.replace('": ', '": ' + "[" * rng.choice((60, 200, 900, 100_000)), 1)
    return text.encode("utf-8", "surrogatepass")


def mutate_bytes(raw: bytes, rng: random.Random) -> bytes:
    """Truncate, flip, repeat or insert."""
    data = bytearray(raw)
    at = rng.randrange(len(data) + 1)
    match rng.randrange(5):
        case 0:
            del data[at:]
        case 1:
            for _ in range(rng.choice((1, 3, 20))):
                if data:
                    data[rng.randrange(len(data))] = rng.randrange(256)
        case 2:
            data[at:at] = data[at : at + rng.choice((1, 8, 100, 5000))]
        case 3:
            data[at:at] = bytes(rng.choice((0, 255)) for _ in range(rng.choice((1, 4, 64))))
        case _:
            data[at : at + 8] = rng.choice((0, 1, 2**31, 2**32 - 1, 2**40, 2**64 - 1)).to_bytes(8, "little")
    return bytes(data)


def mutate_array(array: np.ndarray, rng: random.Random) -> np.ndarray:
    """Change values, rows or the shape."""
    array = array.copy()
    if array.dtype.kind == "f":
        values = [
            0.0,
            -1.0,
            1.0,
            1e-30,
            1e-45,
            1e4,
            1e9,
            1e19,
            1e30,
            3e38,
            -3e38,
            np.nan,
            np.inf,
            1e150,
            1e300,
        ]
        with np.errstate(over="ignore"):
            hostile = np.array(values).astype(array.dtype)
    else:
        info = np.iinfo(array.dtype)
        values = [0, 1, 2, 255, info.max, info.min, info.max // 2, info.max - 1, 2**20, 2**24, 100_000]
        hostile = np.array([v for v in values if info.min <= v <= info.max], array.dtype)
    draw = rng.randrange(8)
    if draw == 0 or array.size == 0:
        return array[: rng.randrange(len(array) + 1)] if array.ndim else array
    if draw == 1:
        return np.concatenate([array, array[: rng.randrange(1, len(array) + 1)]])
    if draw == 2:
        array[...] = rng.choice(hostile)
    elif draw == 3:
        array[rng.randrange(len(array))] = rng.choice(hostile)
    elif draw == 4:
        with np.errstate(over="ignore", invalid="ignore"):
            array = (array * np.float64(rng.choice((1e-3, -1, 10, 1e3, 1e6)))).astype(array.dtype)
    elif draw == 5:
        flat = array.reshape(-1)
        i, j = rng.randrange(flat.size), rng.randrange(flat.size)
        flat[i], flat[j] = flat[j], flat[i]
    else:
        flat = array.reshape(-1)
        for _ in range(rng.choice((1, 1, 3, 10))):
            flat[rng.randrange(flat.size)] = rng.choice(hostile)
    return array


def mutate_artifact(raw: bytes, rng: random.Random) -> bytes:
    """Change the manifest or arrays of an artifact; hashes and shapes follow."""
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    manifest = json.loads(members.pop("manifest.json"))
    arrays = {name.removesuffix(".npy"): np.load(io.BytesIO(data)) for name, data in members.items()}
    if rng.random() < 0.5:
        for _ in range(rng.choice((1, 1, 2))):
            name = rng.choice(sorted(arrays))
            arrays[name] = mutate_array(arrays[name], rng)
        for name, array in arrays.items():
            manifest["arrays"][name]["sha256"] = hashlib.sha256(array.tobytes()).hexdigest()
            manifest["arrays"][name]["shape"] = list(array.shape)
        if rng.random() < 0.2:
            mutate_tree(manifest, rng)
    else:
        hidden = manifest.pop("arrays") if rng.random() < 0.8 else None
        mutate_tree(manifest, rng)
        if hidden is not None:
            manifest["arrays"] = hidden
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("manifest.json", json_text(manifest, rng))
        for name, array in arrays.items():
            data = io.BytesIO()
            np.lib.format.write_array(data, np.ascontiguousarray(array), version=(1, 0))
            archive.writestr(f"{name}.npy", data.getvalue())
    return stream.getvalue()


def mutate_map(raw: bytes, rng: random.Random) -> bytes:
    """Change fields of an onboard map, with the sums that it needs."""
    data = bytearray(raw)
    total = int.from_bytes(data[16:20], "little")
    for _ in range(rng.choice((1, 1, 2, 5))):
        where = rng.randrange(4, 60) if rng.random() < 0.4 else rng.randrange(64, total)
        data[where] = rng.choice((0, 1, 127, 128, 255, rng.randrange(256)))
    if rng.random() < 0.1:
        struct.pack_into("<d", data, 40, rng.choice((1e-6, 1e5, 1e-300, float("nan"), 0.2)))
    end = min(int.from_bytes(data[16:20], "little"), len(data))
    data[20:24] = zlib.crc32(bytes(data[64:end])).to_bytes(4, "little")
    data[60:64] = zlib.crc32(bytes(data[:60])).to_bytes(4, "little")
    return bytes(data)


def mutate_log(raw: bytes, rng: random.Random) -> bytes:
    """Change messages and metadata of a log, which is then written anew with its sums."""
    from mcap.reader import make_reader
    from mcap.writer import CompressionType, Writer

    reader = make_reader(io.BytesIO(raw))
    rows = [(channel.topic, m.log_time, m.data) for _, channel, m in reader.iter_messages()]
    notes = [(record.name, dict(record.metadata)) for record in reader.iter_metadata()]
    for _ in range(rng.choice((1, 1, 3))):
        if rng.random() < 0.5 and rows:
            i = rng.randrange(len(rows))
            if rng.random() < 0.5:  # any topic as often as any other
                topic = rng.choice(sorted({row[0] for row in rows}))
                i = rng.choice([k for k, row in enumerate(rows) if row[0] == topic])
            with suppress(ValueError, RecursionError):
                tree = json.loads(rows[i][2])
                mutate_tree(tree, rng)
                rows[i] = (rows[i][0], rows[i][1], json_text(tree, rng))
            if rng.random() < 0.1:
                del rows[i]
        elif notes:
            name, values = rng.choice(notes)
            key = rng.choice(sorted(values))
            try:
                tree = json.loads(values[key])
            except (ValueError, RecursionError):  # no JSON, or what an earlier change made of it
                values[key] = rng.choice(STRINGS[:5])
                continue
            if isinstance(tree, dict | list):
                mutate_tree(tree, rng)
            values[key] = json_text(tree, rng).decode(errors="replace")
    stream = io.BytesIO()
    kind = rng.choice((CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE))
    writer = Writer(stream, chunk_size=rng.choice((1000, 2**20)), compression=kind)
    writer.start(profile="", library="alula")
    channels: dict[str, int] = {}
    for topic, when, data in rows:
        if topic not in channels:
            schema = writer.register_schema(topic, "jsonschema", b"{}")
            channels[topic] = writer.register_channel(topic, "json", schema)
        writer.add_message(channels[topic], when, data, when)
    for name, values in notes:
        writer.add_metadata(name, values)
    writer.finish()
    return stream.getvalue()


def mutate_json(raw: bytes, rng: random.Random) -> bytes:
    """Change values of a JSON file."""
    tree = json.loads(raw)
    mutate_tree(tree, rng)
    return json_text(tree, rng)


def mutate_toml(raw: bytes, rng: random.Random) -> bytes:
    """Change values, keys and lines of a TOML file."""
    lines = raw.decode().splitlines()
    for _ in range(rng.choice((1, 1, 2, 3))):
        rows = [i for i, line in enumerate(lines) if "=" in line and not line.startswith("#")]
        i = rng.choice(rows)
        key, _, value = lines[i].partition("=")
        match rng.randrange(12):
            case 0:
                del lines[i]
            case 1:
                lines[i] = f"{key} = " + "[" * rng.choice((5, 100, 50_000)) + "1"
            case 2:
                lines.insert(i, ".".join(["a"] * rng.choice((3, 20, 20_000))) + " = 1")
            case 3:
                lines[i] = f"{key} = {rng.choice(('inf', '-inf', 'nan', '1979-05-27', 'true', '{}', '[]'))}"
            case 4 | 5 | 6 | 7:
                numbers = re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", value)
                new = rng.choice((*map(repr, NUMBERS), "1_000", "0x10", "1e400", "9" * 5000))
                if numbers:
                    lines[i] = f"{key} = " + value.replace(rng.choice(numbers), new, 1)
                else:
                    lines[i] = f"{key} = {new}"
            case 8:
                lines[i] = f"{key} = {json.dumps(rng.choice(STRINGS[:9]))}"
            case 9:
                lines[i] = f"{key} = [{value.strip()}, {value.strip()}]"
            case 10:
                lines[i] = lines[i].replace(
                    key.strip(), rng.choice(("a", '"\\u001b[2J"', "schema", "x.y")), 1
                )
            case _:
                j = rng.choice(rows)
                lines[i], lines[j] = lines[j], lines[i]
    return "\n".join(lines).encode() + b"\n"


def mutate_csv(raw: bytes, rng: random.Random) -> bytes:
    """Change cells of a table."""
    rows = [line.split(",") for line in raw.decode().splitlines()]
    for _ in range(rng.choice((1, 1, 3, 10))):
        row = rng.choice(rows)
        column = rng.randrange(len(row))
        match rng.randrange(6):
            case 0:
                row[column] = rng.choice(("nan", "inf", "", "x", "1e308", "-1e308", "1e-320", "\x1b[2J", '"'))
            case 1:
                del row[column]
                row.append("1") if not row else None
            case 2:
                for other in rows[1:]:
                    if column < len(other):
                        other[column] = rng.choice(("0", "1", "1e9", "1e200", "1e-200"))
            case 3:
                rows.append(list(row))
            case _:
                row[column] = repr(rng.choice(NUMBERS))
    return "\n".join(",".join(row) for row in rows).encode() + b"\n"


MUTATORS: dict[str, Callable[[bytes, random.Random], bytes]] = {
    ".npz": mutate_artifact,
    ".bin": mutate_map,
    ".mcap": mutate_log,
    ".json": mutate_json,
    ".toml": mutate_toml,
    ".csv": mutate_csv,
}


def mutant(seeds: Path, number: int, seed: int) -> tuple[str, bytes, str]:
    """Name of the file, its bytes and the words of the command of one mutant."""
    rng = random.Random(f"{seed}:{number}")
    name = list(TARGETS)[number % len(TARGETS)]
    target = rng.choices(TARGETS[name], [one.weight for one in TARGETS[name]])[0]
    raw = _read(seeds / name)
    mutated = mutate_bytes(raw, rng) if rng.random() < 0.12 else MUTATORS[Path(name).suffix](raw, rng)
    return name, mutated, target.words


@cache
def _read(path: Path) -> bytes:
    return path.read_bytes()


# --- running ----------------------------------------------------------------------------------------------


def words_of(target: str, place: Path, seeds: Path, name: str) -> list[str]:
    """Command line of a target."""
    import shlex

    files = {key: str(seeds / value) for key, value in FILES.items()}
    if target.startswith("report {run}"):  # the record beside the log is the mutant
        shutil.copy(seeds / "tiny.run.mcap", place / "tiny.run.mcap")
        files["run"] = str(place / "tiny.run.mcap")
    marked = [word.replace("{}", "{mutant}") for word in shlex.split(target)]
    return [word.format(**files, mutant=place / name, out=place / "out") for word in marked]


def run_forked(words: list[str], place: Path) -> tuple[int, str]:
    """Exit status of a command in a fork (negative: by a signal), and its stderr."""
    gc.freeze()
    child = os.fork()
    if child == 0:
        try:
            held = int(re.search(r"VmSize:\s+(\d+)", Path("/proc/self/status").read_text())[1]) * 1024  # type: ignore[index]
            resource.setrlimit(resource.RLIMIT_AS, (held + ROOM, held + ROOM))
            resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S + 1))
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            for number, name in ((1, "stdout"), (2, "stderr")):
                file = os.open(place / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
                os.dup2(file, number)
            sys.stdout = open(1, "w", closefd=False, errors="replace")  # noqa: SIM115
            sys.stderr = open(2, "w", closefd=False, errors="replace")  # noqa: SIM115
            from alula.cli.main import run

            code = run([*words, "-vv"] if "-q" not in words else words)
            sys.stdout.flush()
            sys.stderr.flush()
        except BaseException:  # noqa: BLE001  nothing may return to the parent's code
            import traceback

            traceback.print_exc()
            sys.stderr.flush()
            code = 99
        os._exit(code)
    end = time.monotonic() + WALL_S
    while True:
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            break
        if time.monotonic() > end:
            os.kill(child, 9)
            os.waitpid(child, 0)
            return -1000, "no answer"
        time.sleep(0.002)
    return os.waitstatus_to_exitcode(status), (place / "stderr").read_text(errors="replace")


def complaint(code: int, err: str, place: Path) -> str:
    """What is wrong with the end of a command; empty when nothing is."""
    if code not in ALLOWED:
        return f"exit {code}"
    if re.search(r"Warning:", err):
        return "a warning"
    if "\x1b" in err or "\x1b" in (place / "stdout").read_text(errors="replace"):
        return "an escape sequence"
    if code not in (0, 4) and list((place / "out").iterdir()):
        return "an output in spite of an error"
    if code not in (0, 4) and sum(line.startswith("alula: ") for line in err.splitlines()) < 1:
        return "no message"
    return ""


def check_targets(seeds: Path) -> None:
    """Run each command on the unchanged file: a command that could only fail would test nothing."""
    wrong = []
    with tempfile.TemporaryDirectory(prefix="alula-warm-") as scratch:
        pairs = [(name, target) for name, targets in TARGETS.items() for target in targets]
        for i, (name, target) in enumerate(pairs):
            place = Path(scratch) / str(i)
            (place / "out").mkdir(parents=True)
            shutil.copy(seeds / name, place / name)
            code, err = run_forked(words_of(target.words, place, seeds, name), place)
            if code not in target.valid:
                wrong.append(f"{target.words}: {code} {err.splitlines()[-1:]}")
    assert not wrong, "\n".join(wrong)


def preload() -> None:
    """Import what the commands import, without threads."""
    import importlib

    from alula.cli.main import COMMANDS

    for name in COMMANDS:
        importlib.import_module(f"alula.cli.commands.{name.replace('-', '_')}")
    for name in (
        *(
            "mcap.writer",
            "mcap.reader",
            "matplotlib.figure",
            "matplotlib.backends.backend_svg",
            "scipy.optimize",
        ),
        *(
            "alula.stages.reporting.content",
            "alula.stages.show.viewing.report",
            "alula.stages.reporting.page",
        ),
        *("alula.stages.show.viewing.page", "viser"),
        *("alula.stages.planning.plan", "alula.stages.compression.merge", "alula.stages.compression.verify"),
        *("alula.stages.reporting.inspect", "alula.stages.alignment.scale_align", "scipy.spatial"),
        "alula.stages.simulation.simulate",
        *("alula.stages.reconstruction.formats.registry", "alula.stages.export.export", "zstandard"),
        *("alula.cli.commands.simulate", "alula.cli.verbs.sources", "alula.stages.reporting.tables"),
        *(
            "alula.stages.alignment.transforms",
            "alula.stages.alignment.nerfstudio",
            "alula.stages.alignment.colmap",
        ),
        "alula.stages.simulation.summary",
    ):
        importlib.import_module(name)


def fuzz(seeds: Path, keep: Path, numbers: range, seed: int, jobs: int = 2) -> Counter[str]:
    """Run mutants in several processes; failures are kept as folders with the words to repeat them.

    Args:
        seeds: folder of valid files.
        keep: folder for failures.
        numbers: of the mutants.
        seed: of all mutants.
        jobs: number of processes.
    """
    preload()
    keep.mkdir(parents=True, exist_ok=True)
    context = multiprocessing.get_context("fork")
    with context.Pool(jobs) as pool:
        parts = pool.starmap(_part, [(seeds, keep, numbers[i::jobs], seed) for i in range(jobs)])
    return sum(parts, Counter())


def _part(seeds: Path, keep: Path, numbers: range, seed: int) -> Counter[str]:
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="alula-fuzz-") as scratch:
        for number in numbers:
            name, raw, target = mutant(seeds, number, seed)
            place = Path(scratch) / "case"
            (place / "out").mkdir(parents=True)
            (place / name).write_bytes(raw)
            code, err = run_forked(words_of(target, place, seeds, name), place)
            counts[f"exit {code}"] += 1
            if wrong := complaint(code, err, place):
                counts["FAILED"] += 1
                kept = keep / f"{number:07d}"
                kept.mkdir(exist_ok=True)
                (kept / name).write_bytes(raw)
                (kept / "WHY").write_text(f"{wrong}: alula {target}\n{err[-4000:]}")
            shutil.rmtree(place)
    return counts


def main() -> int:
    """Run from the command line; 1 when anything failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--most", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seeds", type=Path, help="folder of valid files; made when it is missing")
    parser.add_argument("--keep", type=Path, default=Path("fuzz-failures"))
    chosen = parser.parse_args()
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
    from support.scenes.pipeline import write_pipeline

    with tempfile.TemporaryDirectory(prefix="alula-seeds-") as made:
        seeds = chosen.seeds or Path(made)
        if not (seeds / "dataparser_transforms.json").exists():
            seeds.mkdir(exist_ok=True)
            write_pipeline(seeds)
            make_seeds(seeds)
        preload()
        check_targets(seeds)
        numbers = range(chosen.first, chosen.first + chosen.most)
        counts = fuzz(seeds, chosen.keep, numbers, chosen.seed, chosen.jobs)
    for key in sorted(counts):
        print(f"{counts[key]:9d}  {key}")
    return 1 if counts["FAILED"] else 0


if __name__ == "__main__":
    status = main()
    sys.stdout.flush()
    os._exit(status)  # the end of the interpreter would list what the imports hold
