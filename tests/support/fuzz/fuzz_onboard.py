"""libFuzzer on the onboard code, its time shared by the targets: `fuzz_onboard.py --seconds 600`.

native/onboard/fuzz has the targets, with address and undefined-behaviour sanitizers: images of maps,
tiles, and ticks of polytope-cbf, the chord filter, dr-acbf and the geofence. Seeds are maps of covers that
are merged here and, with ALULA_DATA, of a real scene. Without a clang that has libFuzzer nothing is run, and
that is said. What fails is kept in --keep.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parents[1]
SOURCES = HERE.parents[1] / "native/onboard/fuzz"
TARGETS = ("map", "tiles", "polytope", "chord", "dr_acbf", "geofence", "links", "stack")
EMPTY = "int LLVMFuzzerTestOneInput(const unsigned char *d, unsigned long n) { return !d && n; }"
LONGEST = 16_000  # bytes of an input


def why_not() -> str:
    """What is missing, empty for nothing."""
    if not shutil.which("clang") or not shutil.which("make"):
        return "clang and make are not there: .ci/system-packages --fuzz"
    with tempfile.TemporaryDirectory() as folder:
        words = ["clang", "-x", "c", "-", "-fsanitize=fuzzer,address,undefined", "-o", f"{folder}/a"]
        done = subprocess.run(words, input=EMPTY, text=True, capture_output=True, check=False)
    return "" if done.returncode == 0 else "clang has no libFuzzer: .ci/system-packages --fuzz"


def images() -> list[bytes]:
    """Onboard maps of all kinds, small ones."""
    sys.path.append(str(HERE.parent))
    from alula.stages.compression.onboard.layout import encode_map
    from support.scenes.covers import cover_of, furniture, voxels_of

    covers = [
        cover_of(voxels_of(furniture(seed, 12)), hulls=count) for seed, count in enumerate((1, 3, 9, 24))
    ]
    if scene := os.environ.get("ALULA_DATA"):
        covers.append(real_cover(Path(scene)))
    found = [
        encode_map(cover, largest_normal=largest, indexed=indexed)
        for cover in covers
        for largest, indexed in ((127, True), (127, False), (1, True))
    ]
    return [image for image in found if len(image) < LONGEST - 1000]


def tiles() -> list[tuple[bytes, bytes]]:
    """Indexes of maps in tiles, each with one of the images."""
    from support.scenes.tiled import cut, posts, sealed_binary

    made = [cut(posts(size, size), tile_m=tile_m, reach_m=0.4) for size, tile_m in ((9, 0.6), (18, 1.2))]
    return [(sealed_binary(one), max(one.images)) for one in made]


def real_cover(data: Path):
    """Of a tile of a street."""
    from alula.cli.main import run
    from alula.schemas.artifacts.artifact import read_artifact

    steps = (
        ("import-splat", [], "s.scene.npz"),
        ("scale-align", ["--scale", "1"], "m.scene.npz"),
        ("voxelize", ["--size", "0.8"], "v.voxels.npz"),
        ("merge", ["--hulls", "40"], "c.cover.npz"),
    )
    with tempfile.TemporaryDirectory() as folder:
        before = str(data / "istanbul-outdoor/tile_x000_y003.splat")
        for command, options, name in steps:
            if run([command, before, "-o", f"{folder}/{name}", "-q", *options]) != 0:
                raise RuntimeError(f"{command} failed")
            before = f"{folder}/{name}"
        return read_artifact(Path(before))


def write_seeds(folder: Path) -> None:
    """A folder per target."""
    rng = np.random.default_rng(0)
    for target in TARGETS:
        (folder / target).mkdir(parents=True, exist_ok=True)
    for k, image in enumerate(images()):
        for target in ("map", "polytope", "chord", "geofence", "stack"):
            numbers = rng.integers(0, 256, 900, np.uint8)
            head = struct.pack("<BH", 0, len(image))
            (folder / target / f"seed-{k}").write_bytes(head + image + numbers.tobytes())
    for k, (index, image) in enumerate(tiles()):
        head = struct.pack("<H", len(index)) + index + struct.pack("<BBH", 0, 0, len(image))
        numbers = rng.integers(0, 256, 900, np.uint8)
        (folder / "tiles" / f"seed-{k}").write_bytes(head + image + numbers.tobytes())
    for k in range(12):
        numbers = rng.integers(20, 256, 1500, np.uint8).tobytes()
        (folder / "dr_acbf" / f"seed-{k}").write_bytes(numbers)
        (folder / "geofence" / f"seed-bare-{k}").write_bytes(bytes(3) + numbers)


def fuzz(build: Path, keep: Path, seconds: float) -> list[str]:
    """Run every target for its share of the time; what failed, by target.

    Raises:
        RuntimeError: a target does not compile.
    """
    made = subprocess.run(
        ["make", "-s", "-C", str(SOURCES), f"BUILD={build}"], capture_output=True, text=True, check=False
    )
    if made.returncode != 0:
        raise RuntimeError(made.stderr)
    write_seeds(build / "seeds")
    keep.mkdir(parents=True, exist_ok=True)
    failed = []
    for target in TARGETS:
        corpus = build / "corpus" / target
        corpus.mkdir(parents=True, exist_ok=True)
        words = [str(build / target), str(corpus), str(build / "seeds" / target), "-print_final_stats=1"]
        words += [
            f"-max_total_time={max(int(seconds / len(TARGETS)), 1)}",
            f"-max_len={LONGEST}",
            "-timeout=20",
        ]
        words += [f"-artifact_prefix={keep}/{target}-", "-seed=1"]
        done = subprocess.run(words, capture_output=True, text=True, errors="replace", check=False)
        executed = re.findall(r"number_of_executed_units:\s*(\d+)", done.stderr)
        edges = re.findall(r"\bcov: (\d+)", done.stderr)
        total = re.findall(r"\((\d+) inline 8-bit counters\)", done.stderr)
        print(
            f"{target}: {int(executed[-1]) if executed else 0:,} inputs, {edges[-1] if edges else 0} of"
            f" {total[0] if total else 0} edges reached, {'FAILED' if done.returncode else 'good'}",
            flush=True,
        )
        if done.returncode != 0:
            failed.append(target)
            print(done.stderr[-6000:], file=sys.stderr)
    return failed


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=600)
    parser.add_argument("--build", type=Path, default=HERE.parents[1] / "build/fuzz-onboard")
    parser.add_argument("--keep", type=Path, default=HERE.parents[1] / "build/fuzz-onboard/failures")
    chosen = parser.parse_args()
    if missing := why_not():
        print(f"skipped: the onboard code is not fuzzed, {missing}", file=sys.stderr)
        return 0
    return 1 if fuzz(chosen.build.resolve(), chosen.keep.resolve(), chosen.seconds) else 0


if __name__ == "__main__":
    sys.exit(main())
