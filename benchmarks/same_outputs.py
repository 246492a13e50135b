"""Run the same commands in two checkouts, and compare every file and every printed line.

    python -P benchmarks/same_outputs.py BEFORE [AFTER] [--only WORD] [--keep FOLDER]

Both are checkouts with `.venv`; AFTER is this one by default. Each uses the scenarios of its own examples.
The commands run twice in BEFORE: what differs between these two runs is a measured time, and is left out.
Prints what differs otherwise, and ends with 1 if anything does.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_SHOWN = 6  # differences of a file that are printed
_STATIC = ("none", "cone-di", "cone-ecbf", "cone-backup", "safer-splat", "polytope-cbf", "shield")
_MOVING = ("cbf-qp", "dr-acbf-qp", "mpc", "rp-cbf", "dr-acbf")
_SCENARIOS = ("room", "geofencing", "dr-acbf")
_MAPS = ("--scene", "room.metric.scene.npz")
_EXPORTS = {
    "room.cover.npz": ("glb", "obj", "json", "stl", "bin", "h", "xml", "usda", "npz"),
    "room.metric.scene.npz": ("ply", "splat", "spz", "glb"),
    "room.voxels.npz": ("bt", "pcd"),
}


def commands(root: Path) -> Iterator[tuple[str, list[str]]]:
    """Every command with its name, in an order in which its inputs exist."""
    yield (
        "demo-scene",
        [
            *("demo-scene", "-o", "room.ply", "--gaussians", "20000"),
            *("--colmap", "colmap", "--reference", "reference.csv"),
        ],
    )
    yield "import", [*("import-splat", "room.ply", "-o", "room.scene.npz"), "--drop-floaters"]
    yield (
        "align",
        [
            *("scale-align", "room.scene.npz", "-o", "room.metric.scene.npz"),
            *("--colmap", "colmap", "--reference", "reference.csv", "--max-rms", "0.02"),
        ],
    )
    yield "voxelize", ["voxelize", "room.metric.scene.npz", "-o", "room.voxels.npz", "--size", "0.1"]
    yield "merge", ["merge", "room.voxels.npz", "-o", "room.cover.npz", "--hulls", "100"]
    verify = ["--voxels", "room.voxels.npz", *_MAPS, "-o", "room.certificate.json"]
    yield "verify", ["verify", "room.cover.npz", *verify]
    yield "demo-other", ["demo-scene", "-o", "other.ply", "--gaussians", "5000", "--seed", "1"]
    yield "parts", ["import-splat", "room.ply", "other.ply", "-o", "city.scene"]
    yield "parts-align", ["scale-align", "city.scene", "-o", "metric.scene", "--scale", "1"]
    yield "parts-voxelize", ["voxelize", "metric.scene", "-o", "city.voxels", "--size", "0.2"]
    yield "parts-merge", ["merge", "city.voxels", "-o", "city.cover", "--hulls", "100", "--block", "4"]
    yield (
        "parts-verify",
        [
            *("verify", "city.cover", "--voxels", "city.voxels", "--scene", "metric.scene"),
            *("-o", "city.certificate.json"),
        ],
    )
    yield (
        "observe",
        [
            *("observe", "room.metric.scene.npz", "-o", "room.seen.npz", "--voxels", "room.voxels.npz"),
            *("--radius", "0.15", "--colmap", "colmap"),
        ],
    )
    plan = ["room.cover.npz", "--start", "0.8 0.8 1", "--goal", "7 5.2 1.2", "--radius", "0.15"]
    yield "plan", ["plan", *plan, "--filter", "none", "-o", "room.plan.npz"]
    yield "plan-filter", ["plan", *plan, "--filter", "cone-ecbf", "-o", "filtered.plan.npz"]
    yield "verify-plan", ["verify", "room.plan.npz", "--map", "room.cover.npz", "-o", "plan.certificate.json"]
    for name in _STATIC:
        flown = ["simulate", "room.plan.npz", "--map", "room.cover.npz", *_MAPS, "--filter", name]
        yield f"planned-{name}", [*flown, "-o", f"planned-{name}.run.mcap"]
        flown = ["simulate", "room.cover.npz", *_MAPS, "--filter", name, "--trials", "3", "--seed", "4"]
        yield f"pairs-{name}", [*flown, "-o", f"pairs-{name}.run.mcap"]
    for name in _MOVING:
        flown = ["simulate", "dr-acbf/scenario-1.toml", "--filter", name, "--trials", "3"]
        yield f"moving-{name}", [*flown, "-o", f"moving-{name}.run.mcap"]
    for place in [
        p
        for folder in _SCENARIOS
        for p in sorted((root / "examples" / folder).glob("*.toml"))
        if p.name != "course.toml"
    ]:
        path = f"{place.parent.name}/{place.name}"
        yield f"flown-{place.stem}", ["simulate", path, "-o", f"{place.stem}.run.mcap", "--trials", "1"]
        yield f"scenario-{place.stem}", ["scenario", path]
    runs = ["planned-shield.run.mcap", "pairs-cone-di.run.mcap"]
    yield "report", ["report", *runs, "--cover", "room.cover.npz", "-o", "report.md"]
    yield "report-page", ["report", *runs, "--cover", "room.cover.npz", "-o", "report.html"]
    for name, suffixes in _EXPORTS.items():
        for suffix in suffixes:
            yield f"export-{name}-{suffix}", ["export", name, "-o", f"{name}.exported.{suffix}"]
    yield "export-tiles", ["export", "room.cover.npz", "-o", "room.tiles", "--tiles", "4", "--reach", "2"]
    yield "export-ros2", ["export", "planned-shield.run.mcap", "-o", "room.bag", "--ros2"]
    yield "export-layout", ["export", "--foxglove-layout", "-o", "layout.json"]
    for name in (
        "room.scene.npz",
        "room.cover.npz",
        "room.plan.npz",
        "planned-shield.run.mcap",
        "city.cover",
    ):
        yield f"info-{name}", ["info", name]
        yield f"info-json-{name}", ["info", name, "--json"]


def run(root: Path, folder: Path, only: str) -> None:
    """Run all commands of a checkout in a folder; what each printed is kept beside its files."""
    folder.mkdir(parents=True)
    for name in (*_SCENARIOS, "vehicles"):
        shutil.copytree(root / "examples" / name, folder / name, ignore=shutil.ignore_patterns("out"))
    for name in _SCENARIOS:
        (folder / name / "out").symlink_to("..")  # where their maps are
    hidden = os.environ | {"GIT_DIR": str(folder / "none")}  # the commit is not a part of what is compared
    for name, words in commands(root):
        if only and only not in name:
            continue
        done = subprocess.run(
            [str(root / ".venv/bin/alula"), *words], cwd=folder, env=hidden, capture_output=True, text=True
        )
        said = f"exit {done.returncode}\n{done.stdout}\n{done.stderr}"
        (folder / f"{name}.printed").write_text(said.replace(str(root), "ROOT"))


def facts(path: Path) -> dict[str, str]:
    """Every comparable fact of a file by its place: members, keys, channels with their messages, or lines."""
    if path.suffix == ".npz":
        found: dict[str, str] = {}
        with zipfile.ZipFile(path) as archive:
            for name in archive.namelist():
                found |= _content(name, archive.read(name))
        return found
    if path.suffix == ".mcap":
        return _log(path)
    return _content("", path.read_bytes())


def _content(name: str, raw: bytes) -> dict[str, str]:
    try:
        return dict(_flat(name, json.loads(raw)))
    except ValueError:
        pass
    try:
        return {f"{name}:{i}": line for i, line in enumerate(raw.decode().splitlines())}
    except UnicodeDecodeError:
        return {name: sha256(raw).hexdigest()}


def _flat(name: str, value: object) -> Iterator[tuple[str, str]]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _flat(f"{name}.{key}", inner)
    elif isinstance(value, list) and any(isinstance(inner, dict | list) for inner in value):
        for i, inner in enumerate(value):
            yield from _flat(f"{name}[{i}]", inner)
    elif isinstance(value, str) and value[:1] in "{[":
        try:
            yield from _flat(name, json.loads(value))
        except ValueError:
            yield name, value
    else:
        yield name, json.dumps(value)


def _log(path: Path) -> dict[str, str]:
    from mcap.reader import make_reader

    found: dict[str, str] = {}
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        for schema in summary.schemas.values():
            found[f"schema {schema.name}"] = sha256(schema.data).hexdigest()
        for channel in summary.channels.values():
            found[f"channel {channel.topic}"] = f"{channel.message_encoding} {channel.metadata}"
        for record in reader.iter_metadata():
            for key, text in record.metadata.items():
                found |= dict(_flat(f"metadata {record.name}.{key}", text))
        for attached in reader.iter_attachments():
            found |= _content(f"attachment {attached.name}", attached.data)
        digests = {topic.topic: sha256() for topic in summary.channels.values()}
        for _, channel, message in reader.iter_messages():
            digests[channel.topic].update(message.log_time.to_bytes(8, "little") + message.data)
    return found | {f"messages {topic}": digest.hexdigest() for topic, digest in digests.items()}


def differences(before: Path, again: Path, after: Path) -> Iterator[str]:
    """A line for every fact that is not the same in both, and is in two runs of the first."""
    names = {
        str(p.relative_to(f))
        for f in (before, after)
        for p in f.rglob("*")
        if p.is_file() and p.suffix not in (".toml", ".py") and p.name != "Makefile"
    }
    for name in sorted(names):
        missing = [
            where for where, folder in (("before", before), ("after", after)) if not (folder / name).exists()
        ]
        if missing:
            yield f"{name}: missing {missing[0]}"
            continue
        if (before / name).read_bytes() == (after / name).read_bytes():
            continue
        old, twice, new = (facts(folder / name) for folder in (before, again, after))
        unlike = [key for key in dict.fromkeys([*old, *new]) if old.get(key) != new.get(key)]
        unlike = [key for key in unlike if ".timing." not in key and old.get(key) == twice.get(key)]
        for key in unlike[:_SHOWN]:
            yield f"{name}: {key}: {str(old.get(key))[:120]} -> {str(new.get(key))[:120]}"
        if len(unlike) > _SHOWN:
            yield f"{name}: {len(unlike) - _SHOWN} more"


def main() -> int:
    """Compare, and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("before", type=Path, metavar="BEFORE")
    parser.add_argument("after", type=Path, nargs="?", default=ROOT, metavar="AFTER")
    parser.add_argument("--only", default="", metavar="WORD", help="commands whose names hold this word")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="where the files are made and kept")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.keep.resolve() if options.keep else Path(scratch)
        made = [
            (options.before.resolve(), folder / "before"),
            (options.before.resolve(), folder / "again"),
            (options.after.resolve(), folder / "after"),
        ]
        with ThreadPoolExecutor(2) as pool:
            missing = [one for one in made if not one[1].exists()]
            list(pool.map(lambda one: run(one[0], one[1], options.only), missing))
        lines = list(differences(*(place for _, place in made)))
    for line in lines:
        print(line)
    print(f"{len(lines)} differences" if lines else "the same")
    return bool(lines)


if __name__ == "__main__":
    sys.exit(main())
