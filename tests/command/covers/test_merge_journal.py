"""An interrupted `alula merge` continues when its command is repeated, and checks its journal first."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import numpy as np
import pytest

from alula import _core
from alula.cli.main import run
from alula.cli.shell import journal as file
from alula.schemas.artifacts.artifact import make_artifact, write_artifact
from alula.schemas.artifacts.journal import mismatches, pack, unpack
from alula.schemas.artifacts.kinds import VOXELS
from alula.schemas.artifacts.manifest import producer
from alula.schemas.artifacts.provenance import Provenance, read_provenance
from alula.schemas.errors import DamagedError, VersionError
from alula.stages.compression import merge as stage

# The command line with a journal that is written at once and often, by a program of the same commit even when
# somebody commits between two runs.
EAGER = (
    "import sys; from alula.schemas.artifacts import manifest;"
    " manifest.native_commit = lambda: sys.argv.pop(1);"
    " manifest.producer();"
    " from alula.cli.shell import journal; journal.PERIOD_S, journal.MIN_RUN_S = 0.05, 0;"
    " journal.MAX_WRITING_FRACTION = 1e9; from alula.cli.main import main; main(sys.argv[1:])"
)
WORDS = ["merge", "v.voxels.npz", "-o", "c.cover.npz", "--hulls", "50"]
JOURNAL = Path("c.cover.npz.journal")


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> tuple[bytes, bytes]:
    """Scattered voxels that merge for a quarter of a second, and their cover."""
    return merged(tmp_path_factory.mktemp("whole"), count=1000, side=21)


def merged(folder: Path, *, count: int, side: int) -> tuple[bytes, bytes]:
    """Voxels at random places of a cube, and their cover, as files."""
    flat = np.random.default_rng(3).choice(side**3, count, replace=False)
    index = np.stack(np.unravel_index(np.sort(flat), (side,) * 3), axis=1).astype(np.int32)
    voxels = make_artifact(
        VOXELS,
        {"index": index, "overlap": np.ones(len(index))},
        **{"frame": "world", "unit": "m", "parameters": {}, "summary": {}},
        **{"voxel_size_m": 0.5, "sigma": 1.0, "min_overlap": 1},
    )
    write_artifact(folder / "v.voxels.npz", voxels)
    cover = folder / "c.cover.npz"
    assert run(["merge", str(folder / "v.voxels.npz"), "-o", str(cover), *WORDS[-2:], "-q"]) == 0
    return (folder / "v.voxels.npz").read_bytes(), cover.read_bytes()


@pytest.fixture
def here(whole, tmp_path, monkeypatch) -> Path:
    (tmp_path / "v.voxels.npz").write_bytes(whole[0])
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def interrupted(here, monkeypatch, capsys) -> Path:
    """A journal of a merge that was interrupted, by an exception where Ctrl-C raises it."""
    monkeypatch.setattr(file, "MIN_RUN_S", 0.0)
    with monkeypatch.context() as patched:
        patched.setattr(stage, "merge", stopping_when(lambda journal: len(journal) > 300))
        assert run(WORDS) == 130
    error = capsys.readouterr().err.strip()
    assert error.startswith("alula: interrupted; the same command continues from c.cover.npz.journal, ")
    assert not Path("c.cover.npz").exists()
    return JOURNAL


def stopping_when(enough):
    merge = stage.merge

    def stopping(config, source, *, journal, progress, **rest):
        def stop(done, total):
            progress(done, total)
            if enough(journal):
                raise KeyboardInterrupt

        return merge(config, source, journal=journal, progress=stop, **rest)

    return stopping


def start(*words: str) -> subprocess.Popen[str]:
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.Popen(
        [sys.executable, "-P", "-c", EAGER, producer().commit, *words],
        env=env, text=True, stderr=subprocess.PIPE, stdout=subprocess.PIPE,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("signals", [("SIGINT", "SIGTERM"), ("SIGKILL", "SIGKILL")])
def test_a_merge_that_is_killed_again_and_again_ends_in_the_same_bytes(
    tmp_path, tmp_path_factory, monkeypatch, signals
):
    monkeypatch.chdir(tmp_path)
    voxels, cover = merged(tmp_path_factory.mktemp("long"), count=5000, side=36)
    Path("v.voxels.npz").write_bytes(voxels)
    chance = random.Random(signals[0])
    kept = []
    for name in signals:
        process = start(*WORDS)
        size = JOURNAL.stat().st_size if JOURNAL.exists() else 0
        while process.poll() is None and not (JOURNAL.exists() and JOURNAL.stat().st_size > size):
            time.sleep(0.01)
        time.sleep(chance.uniform(0, 0.1))
        process.send_signal(getattr(signal, name))
        error = process.communicate()[1]
        if Path("c.cover.npz").exists():  # it was faster
            break
        assert process.returncode in (130, -signal.SIGKILL)
        # The advice is missing where the signal came after the merge, while its result was written.
        assert ("alula: interrupted" in error) == (name != "SIGKILL")
        kept.append(len(_core.MergeJournal(unpack(JOURNAL.read_bytes())[1])))
    assert kept == sorted(kept)
    if not Path("c.cover.npz").exists():
        process = start(*WORDS)
        error = process.communicate()[1]
        assert process.returncode == 0
        assert error == f"alula: continuing from c.cover.npz.journal: {kept[-1]:,} of its measurements\n"
    assert run([*WORDS, "-q"]) == 0  # nothing is left to do but to remove what a late kill left behind
    assert Path("c.cover.npz").read_bytes() == cover
    assert [path.name for path in tmp_path.iterdir() if path.name.endswith("journal")] == []


def test_measurements_are_taken_from_the_journal(interrupted, whole, monkeypatch, capsys):
    taken = []

    def watching(config, source, *, journal, **rest):
        taken.append(len(journal))
        cover = merge(config, source, journal=journal, **rest)
        taken.append(journal.reused)
        return cover

    merge = stage.merge
    monkeypatch.setattr(stage, "merge", watching)
    assert run([*WORDS, "-q"]) == 0
    assert capsys.readouterr().err == ""
    assert 300 < taken[0] <= taken[1]
    assert Path("c.cover.npz").read_bytes() == whole[1]
    assert not interrupted.exists()


@pytest.mark.every(2)
@pytest.mark.parametrize(
    ("damage", "word"),
    [
        (lambda raw: raw[:-1], "it is cut off"),
        (lambda raw: raw[:10], "it is cut off"),
        (lambda raw: raw[:300] + bytes([raw[300] ^ 1]) + raw[301:], "it is damaged"),
        (lambda raw: raw[:4] + b"\x09" + raw[5:], "it has version 9 of its format, not 1"),
        (lambda raw: pack(unpack(raw)[0], b"nonsense"), "not a journal of a merge"),
    ],
)
def test_a_damaged_journal_is_left_aside_with_one_line(interrupted, whole, capsys, damage, word):
    interrupted.write_bytes(damage(interrupted.read_bytes()))
    assert run(WORDS) == 0
    assert capsys.readouterr().err.splitlines()[0] == f"alula: ignoring c.cover.npz.journal: {word}"
    assert Path("c.cover.npz").read_bytes() == whole[1]


def test_a_file_that_is_no_journal_is_neither_used_nor_touched(here, whole, monkeypatch, capsys):
    monkeypatch.setattr(file, "PERIOD_S", 0.0)
    for foreign in (b"diary", b""):
        JOURNAL.write_bytes(foreign)
        assert run([*WORDS, "-f"]) == 0
        assert "it is no journal of a merge, and is left as it is" in capsys.readouterr().err
        assert JOURNAL.read_bytes() == foreign
        Path("c.cover.npz").unlink()
    JOURNAL.unlink()
    JOURNAL.mkdir()
    assert run([*WORDS, "-q"]) == 0
    assert JOURNAL.is_dir()
    assert Path("c.cover.npz").read_bytes() == whole[1]


def test_the_journal_of_another_merge_is_of_no_use_and_stays(interrupted, capsys):
    before = interrupted.read_bytes()
    assert run([*WORDS[:-1], "49"]) == 0
    first = capsys.readouterr().err.splitlines()[0]  # a slow machine adds lines of progress
    assert first == "alula: ignoring c.cover.npz.journal: it is of another merge: hulls was 50, now 49"
    assert interrupted.read_bytes() == before


def test_another_program_has_other_measurements(interrupted):
    recorded, _ = unpack(interrupted.read_bytes())
    other = msgspec.structs.replace(recorded.producer, commit="another")
    wanted = msgspec.structs.replace(recorded, producer=other)
    assert mismatches(recorded, recorded) == []
    assert mismatches(recorded, wanted) == [f"it was written by commit {recorded.producer.commit}"]


def test_a_forged_journal_changes_what_is_merged_but_not_what_is_covered(interrupted, whole):
    recorded, measured = unpack(interrupted.read_bytes())
    entry = np.frombuffer(measured[32:], [("pair", "<u4", 2), ("weight", "<f8")]).copy()
    entry["weight"] = entry["weight"][::-1]
    print_, state = measured[16:24], int.from_bytes(measured[16:24], "little")
    for byte in entry.tobytes():
        state = (state ^ byte) * 1099511628211 % 2**64
    interrupted.write_bytes(
        pack(recorded, measured[:16] + print_ + state.to_bytes(8, "little") + entry.tobytes())
    )
    assert run([*WORDS, "-q"]) == 0
    assert Path("c.cover.npz").read_bytes() != whole[1]
    assert run(["verify", "c.cover.npz", "--voxels", "v.voxels.npz", "-q"]) == 0


def test_a_short_merge_and_a_dry_run_leave_nothing(here, monkeypatch, capsys):
    with monkeypatch.context() as patched:
        patched.setattr(stage, "merge", stopping_when(lambda journal: len(journal) > 0))
        assert run(WORDS) == 130
        patched.setattr(file, "MIN_RUN_S", 0.0)
        patched.setattr(file, "PERIOD_S", 0.0)
        assert run([*WORDS, "-n"]) == 130
    assert capsys.readouterr().err.split("\n")[1::2] == ["alula: interrupted"] * 2
    assert [path.name for path in here.iterdir()] == ["v.voxels.npz"]


def test_a_journal_that_cannot_be_written_does_not_stop_the_merge(here, whole, monkeypatch, capsys):
    from alula.schemas.errors import OutputError

    def refuse(path, **rest):
        raise OutputError(f"{path}: cannot write: No space left on device")

    monkeypatch.setattr(file, "PERIOD_S", 0.0)
    monkeypatch.setattr(file, "atomic_output", refuse)
    assert run(WORDS) == 0
    assert capsys.readouterr().err == (
        "alula: c.cover.npz.journal: cannot write: No space left on device;"
        " an interrupted merge starts anew\n"
    )
    assert Path("c.cover.npz").read_bytes() == whole[1]


def test_a_journal_beside_a_finished_output_is_removed(interrupted):
    raw = interrupted.read_bytes()
    assert run([*WORDS, "-q"]) == 0
    interrupted.write_bytes(raw)  # as when the power fails between the two
    assert run([*WORDS, "-q"]) == 0
    assert not interrupted.exists()


def test_a_journal_is_read_back_or_refused(here, whole):
    Path("c.cover.npz").write_bytes(whole[1])
    made = read_provenance(Path("c.cover.npz"))
    assert isinstance(made, Provenance)
    raw = pack(made, b"measured")
    assert unpack(raw) == (made, b"measured")
    for end in range(len(raw)):
        with pytest.raises(DamagedError):
            unpack(raw[:end])
    for at in range(len(raw)):
        with pytest.raises((DamagedError, VersionError)):
            unpack(raw[:at] + bytes([raw[at] ^ 0x10]) + raw[at + 1 :])
