"""Mutated splat files against every reader: `python tests/support/fuzz/fuzz_splats.py --seconds 600`.

A reader must give Gaussians or one of alula's own errors: no other exception, no crash, no hang, no
allocation that the file does not justify, and no scene with a value that is not finite. Seeds are small
files made here and, with ALULA_DATA, real ones. What fails is kept in --keep.
"""

from __future__ import annotations

import argparse
import faulthandler
import gzip
import io
import json
import os
import random
import re
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from alula.schemas.artifacts.artifact import Artifact

Files = dict[str, bytes]  # of a folder, or one of a single name

SMALL = 40_000  # bytes of a seed file; larger real ones are left out
HANG_S = 20
ROOM = 1 << 30  # bytes that one case may allocate beyond what the process has
NUMBERS = (0, 1, 2, 3, 255, 256, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 2**63, 2**64 - 1)
FLOATS = (
    b"\x00\x00\xc0\x7f",
    b"\x00\x00\x80\x7f",
    b"\x00\x00\x80\xff",
    b"\xff\xff\x7f\x7f",
    b"\x01\x00\x00\x00",
)
WORDS = (
    b"-1",
    b"0",
    b"4294967295",
    b"99999999999999999999",
    b"1e400",
    b"NaN",
    b"null",
    b"-0",
    b'"x"',
    b"[]",
    b"{}",
)


@dataclass
class Case:
    """One input, and what to call."""

    files: Files
    main: str | None  # None: the folder itself
    format: str = "auto"


def mutated(raw: bytes, rng: random.Random) -> bytes:
    """One to four small changes; for containers mostly of what they contain."""
    if rng.random() < 0.8:
        with suppress(OSError, EOFError, zlib.error, zipfile.BadZipFile):  # a seed that is damaged already
            if raw[:2] == b"\x1f\x8b":
                return gzip.compress(mutated(gzip.decompress(raw), rng), 1, mtime=0)
            if raw[:4] == b"PK\x03\x04":
                return _rezipped(raw, rng)
    data = bytearray(raw)
    for _ in range(rng.randint(1, 4)):
        _change(data, rng)
    return bytes(data)


def _rezipped(raw: bytes, rng: random.Random) -> bytes:
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    victim = rng.choice(sorted(members))
    if rng.random() < 0.1:
        del members[victim]
    else:
        members[victim] = mutated(members[victim], rng)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return out.getvalue()


def _change(data: bytearray, rng: random.Random) -> None:
    if not data:
        data.extend(rng.randbytes(rng.randint(0, 64)))
        return
    # Headers decide most: half of all changes fall into the first 200 bytes.
    at = rng.randrange(min(len(data), 200) if rng.random() < 0.5 else len(data))
    match rng.randrange(9):
        case 0:
            data[at] ^= 1 << rng.randrange(8)
        case 1:
            data[at] = rng.choice((0, 1, 127, 128, 255))
        case 2:
            size = rng.choice((1, 2, 4, 8))
            value = rng.choice(NUMBERS) + rng.randint(-1, 1)
            data[at : at + size] = (value % 2 ** (8 * size)).to_bytes(size, rng.choice(("little", "big")))
        case 3:
            data[at : at + 4] = rng.choice(FLOATS)
        case 4:
            del data[at:]
        case 5:
            del data[at : at + rng.randint(1, 64)]
        case 6:
            end = at + rng.randint(1, 256)
            data[at:at] = data[at:end] * rng.choice((1, 2, 50))
        case 7:
            data[at:at] = rng.randbytes(rng.randint(1, 16))
        case _:  # a number or word of a text
            found = list(
                re.finditer(rb"-?[0-9][0-9.eE+-]*|true|false|null|\"[^\"]{0,40}\"", bytes(data[:4096]))
            )
            if found:
                span = rng.choice(found).span()
                data[slice(*span)] = rng.choice(WORDS)


def run_case(case: Case, folder: Path) -> str:
    """`read` or `refused`.

    Raises:
        BaseException: whatever a reader must not let out; AssertionError for a scene that is not finite.
    """
    from alula.schemas.errors import AlulaError
    from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
    from alula.stages.reconstruction.formats.registry import SplatFile
    from alula.stages.reconstruction.import_splat import import_splat

    for name, raw in case.files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(raw)
    try:
        found = SplatFile.find(folder if case.main is None else folder / case.main, case.format)
        found.files()
        splats = found.decode()
        scene = import_splat(ImportSplatConfig(min_opacity=0.0), splats)
    except AlulaError as error:
        words = str(error)
    else:
        return _checked(scene)
    assert "\n" not in words, "the message has several lines"
    assert len(words) < 1000, "the message is too long"
    return "refused"


def _checked(scene: Artifact) -> str:
    for name, array in scene.arrays.items():
        assert np.isfinite(array).all(), f"{name} is not finite"
    return "read"


def seeds() -> dict[str, Case]:
    """Valid inputs by name."""
    from support.files.splat_files import small_splats

    found = {name: Case(files, main, form) for name, (files, main, form) in small_splats().items()}
    root = os.environ.get("ALULA_DATA")
    for path in sorted(Path(root).rglob("*")) if root else ():
        if path.suffix in (".ply", ".splat", ".spz", ".ksplat", ".sog", ".glb", ".gltf") and path.is_file():
            raw = path.read_bytes()
            if len(raw) <= SMALL:
                found[f"{path.parent.name}/{path.name}"] = Case({path.name: raw}, path.name)
            elif path.suffix in (".ply", ".splat") and len(raw) > SMALL:  # the header and some rows
                found[f"{path.parent.name}/{path.name}"] = Case(
                    {path.name: raw[: SMALL // 32 * 32]}, path.name
                )
    return found


def mutants(seed: Case, rng: random.Random) -> Iterator[Case]:
    """Endless changes of one input."""
    while True:
        files = dict(seed.files)
        victim = rng.choice(sorted(files))
        if len(files) > 1 and rng.random() < 0.05:
            del files[victim]
        else:
            files[victim] = mutated(files[victim], rng)
        if seed.main is not None and seed.main not in files:
            continue
        # Half of the time the format is forced, so that a broken magic number does not end it.
        yield Case(files, seed.main, seed.format if rng.random() < 0.5 else "auto")


def _kind(name: str) -> str:
    """What takes turns: the encoders made here, without a number, and the suffixes of real files."""
    return "real " + name.rpartition(".")[2] if "/" in name else name.partition(":")[0]


def fuzz(
    seconds: float,
    seed: int,
    keep: Path,
    most: int = sys.maxsize,
    *,
    inputs: dict[str, Case] | None = None,
    run: Callable[[Case, Path], str] = run_case,
) -> Counter[str]:
    """Run until the time or the number of cases is over; failures are kept and counted.

    Args:
        seconds: time.
        seed: of the mutations.
        keep: folder for what fails.
        most: number of cases.
        inputs: valid ones by name, those of `seeds` by default.
        run: what a case is given to, and its outcome.
    """
    rng = random.Random(seed)
    streams = {name: mutants(case, rng) for name, case in (seeds() if inputs is None else inputs).items()}
    counts: Counter[str] = Counter()
    end = time.monotonic() + seconds
    kinds: dict[str, list[str]] = {}
    for name in sorted(streams):
        kinds.setdefault(_kind(name), []).append(name)

    def too_long(signum: int, frame: object) -> None:
        raise TimeoutError(f"no answer within {HANG_S} s")

    before = signal.signal(signal.SIGALRM, too_long)
    with tempfile.TemporaryDirectory(prefix="alula-fuzz-") as scratch:
        for number in range(most):
            if time.monotonic() > end:
                break
            kind = sorted(kinds)[number % len(kinds)]
            name = rng.choice(kinds[kind])
            case = next(streams[name])
            folder = Path(scratch) / "case"
            (keep / "running.json").write_text(json.dumps({"seed": name, "number": number}))
            signal.alarm(HANG_S)
            try:
                outcome = run(case, folder)
            except Exception as error:  # noqa: BLE001  whatever it is, it must not come out of a reader
                outcome = "FAILED"
                place = keep / f"{number:07d}-{type(error).__name__}"
                for part, raw in case.files.items():
                    (place / part).parent.mkdir(parents=True, exist_ok=True)
                    (place / part).write_bytes(raw)
                (place / "TRACEBACK").write_text(f"{name} as {case.format}\n{traceback.format_exc()}")
            finally:
                signal.alarm(0)
            counts[outcome] += 1
            counts[f"{kind}: {outcome}"] += 1
            for path in sorted(folder.rglob("*"), reverse=True):
                path.rmdir() if path.is_dir() else path.unlink()
    signal.signal(signal.SIGALRM, before)
    return counts


def limit_memory() -> None:
    """What is allocated beyond `ROOM` becomes a MemoryError."""
    held = int(re.search(r"VmSize:\s+(\d+)", Path("/proc/self/status").read_text())[1]) * 1024  # type: ignore[index]
    resource.setrlimit(resource.RLIMIT_AS, (held + ROOM, resource.RLIM_INFINITY))


def main() -> int:
    """Run from the command line; 1 when anything failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, default=Path("fuzz-failures"))
    chosen = parser.parse_args()
    chosen.keep.mkdir(parents=True, exist_ok=True)
    faulthandler.enable()
    warnings.simplefilter("error")
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
    counts = Counter()
    fuzz(0.0, 0, chosen.keep)  # the imports
    limit_memory()
    counts = fuzz(chosen.seconds, chosen.seed, chosen.keep)
    for key in sorted(counts):
        print(f"{counts[key]:9d}  {key}")
    return 1 if counts["FAILED"] else 0


if __name__ == "__main__":
    sys.exit(main())
