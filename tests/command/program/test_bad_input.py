"""All commands with all bad inputs: one line on stderr, the documented exit code, no file left."""

import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from alula.cli.main import COMMANDS, run
from support.effort import some
from support.files import damage

NPZ = (
    damage.truncated,
    damage.empty,
    damage.garbage,
    damage.missing,
    damage.folder,
    damage.flipped,
    damage.newer,
)
FLOATS = (*NPZ, damage.not_a_number)
PLY = (damage.truncated, damage.empty, damage.garbage, damage.missing, damage.folder)
LOG = (damage.truncated, damage.empty, damage.garbage, damage.missing, damage.folder)
MAP = (
    damage.truncated_map,
    damage.flipped_map,
    damage.flipped_map_header,
    damage.newer_map,
    damage.longer_map,
    damage.empty,
    damage.garbage,
    damage.missing,
    damage.folder,
)
TEXT = (damage.empty, damage.garbage, damage.missing, damage.folder)


@dataclass(frozen=True)
class Case:
    """A command line; words in `inputs` are files of the pipeline, OUT is replaced by the output."""

    words: str
    inputs: dict[str, tuple]
    out: str = "out.npz"
    wrong_kind: dict[str, str] | None = None


CASES = {
    "import-splat": Case(
        "import-splat tiny.ply -o OUT",
        {"tiny.ply": (*PLY, damage.not_a_number_ply, damage.huge_ply)},
        wrong_kind={"tiny.ply": "tiny.cover.npz"},
    ),
    "scale-align": Case(
        "scale-align tiny.scene.npz --correspondences pairs.csv -o OUT",
        {"tiny.scene.npz": FLOATS, "pairs.csv": (*TEXT, damage.not_a_number_csv, damage.words_csv)},
        wrong_kind={"tiny.scene.npz": "tiny.voxels.npz", "pairs.csv": "tiny.ply"},
    ),
    "voxelize": Case(
        "voxelize tiny.metric.scene.npz --size 0.2 -o OUT",
        {"tiny.metric.scene.npz": FLOATS},
        wrong_kind={"tiny.metric.scene.npz": "tiny.cover.npz"},
    ),
    "import-voxels": Case(
        "import-voxels tiny.bt --size 0.2 -o OUT",
        {"tiny.bt": LOG},
        wrong_kind={"tiny.bt": "tiny.ply"},
    ),
    "observe": Case(
        "observe tiny.metric.scene.npz --voxels tiny.voxels.npz --cameras cameras.csv --radius 0.15 -o OUT",
        {
            "tiny.metric.scene.npz": FLOATS,
            "tiny.voxels.npz": NPZ,
            "cameras.csv": (*TEXT, damage.not_a_number_csv, damage.words_csv),
        },
        wrong_kind={"tiny.metric.scene.npz": "tiny.cover.npz", "tiny.voxels.npz": "tiny.seen.npz"},
    ),
    "merge": Case(
        "merge tiny.voxels.npz --hulls 9 -o OUT",
        {"tiny.voxels.npz": NPZ},
        wrong_kind={"tiny.voxels.npz": "tiny.plan.npz"},
    ),
    "merge again": Case("merge tiny.cover.npz --hulls 9 -o OUT", {"tiny.cover.npz": FLOATS}),
    "verify": Case(
        "verify tiny.cover.npz --voxels tiny.voxels.npz --scene tiny.metric.scene.npz -o OUT",
        {"tiny.cover.npz": FLOATS, "tiny.voxels.npz": NPZ, "tiny.metric.scene.npz": FLOATS},
        out="out.json",
        wrong_kind={"tiny.cover.npz": "tiny.voxels.npz", "tiny.voxels.npz": "tiny.cover.npz"},
    ),
    "verify a map": Case(
        "verify tiny.map.bin --voxels tiny.voxels.npz --cover tiny.cover.npz -o OUT",
        {"tiny.map.bin": MAP, "tiny.voxels.npz": NPZ, "tiny.cover.npz": FLOATS},
        out="out.json",
        wrong_kind={
            "tiny.map.bin": "tiny.run.mcap",
            "tiny.voxels.npz": "tiny.cover.npz",
            "tiny.cover.npz": "tiny.map.bin",
        },
    ),
    "verify seen space": Case(
        "verify tiny.seen.npz --voxels tiny.voxels.npz -o OUT",
        {"tiny.seen.npz": NPZ, "tiny.voxels.npz": NPZ},
        out="out.json",
        wrong_kind={"tiny.voxels.npz": "tiny.seen.npz"},
    ),
    "plan within seen space": Case(
        "plan tiny.cover.npz --start=1,1.5,1 --goal=3,1.5,1 --radius 0.2 --within tiny.seen.npz -o OUT",
        {"tiny.seen.npz": NPZ},
        wrong_kind={"tiny.seen.npz": "tiny.voxels.npz"},
    ),
    "plan": Case(
        "plan tiny.cover.npz --start=0.5,1.5,1 --goal=3.5,1.5,1 -o OUT",
        {"tiny.cover.npz": FLOATS},
        wrong_kind={"tiny.cover.npz": "tiny.scene.npz"},
    ),
    "simulate": Case(
        "simulate tiny.plan.npz --map tiny.cover.npz -o OUT",
        {"tiny.plan.npz": FLOATS, "tiny.cover.npz": FLOATS},
        out="out.run.mcap",
        wrong_kind={"tiny.plan.npz": "tiny.voxels.npz", "tiny.cover.npz": "tiny.voxels.npz"},
    ),
    "simulate in a scene": Case(
        "simulate tiny.metric.scene.npz --filter cone-backup --trials 1 --vehicle tiny.vehicle.toml -o OUT",
        {"tiny.metric.scene.npz": FLOATS, "tiny.vehicle.toml": (*TEXT, damage.newer_toml)},
        out="out.run.mcap",
        wrong_kind={"tiny.metric.scene.npz": "tiny.voxels.npz"},
    ),
    "simulate a scenario": Case(
        "simulate tiny.toml -o OUT",
        {"tiny.toml": (*TEXT, damage.newer_toml), "tiny.cover.npz": FLOATS},
        out="out.run.mcap",
    ),
    "scenario": Case("scenario tiny.toml", {"tiny.toml": (*TEXT, damage.newer_toml)}, out=""),
    "report": Case(
        "report tiny.run.mcap --cover tiny.cover.npz --scene tiny.metric.scene.npz -o OUT",
        {"tiny.run.mcap": LOG, "tiny.cover.npz": FLOATS, "tiny.metric.scene.npz": FLOATS},
        out="out.html",
        wrong_kind={"tiny.run.mcap": "tiny.cover.npz", "tiny.cover.npz": "tiny.plan.npz"},
    ),
    "view": Case(
        "view tiny.ply tiny.cover.npz tiny.voxels.npz tiny.plan.npz tiny.run.mcap -o OUT",
        {"tiny.ply": PLY, "tiny.cover.npz": FLOATS, "tiny.plan.npz": FLOATS, "tiny.run.mcap": LOG},
        out="out.html",
    ),
    "export": Case("export tiny.cover.npz -o OUT", {"tiny.cover.npz": FLOATS}, out="out.glb"),
    "export a map": Case("export tiny.cover.npz -o OUT", {"tiny.cover.npz": FLOATS}, out="out.map.bin"),
    "export a map in C": Case("export tiny.cover.npz -o OUT", {"tiny.cover.npz": NPZ}, out="out.map.h"),
    "info": Case("info tiny.cover.npz", {"tiny.cover.npz": FLOATS}, out=""),
    "info on a run": Case("info tiny.run.mcap", {"tiny.run.mcap": LOG}, out=""),
    "info on a map": Case("info tiny.map.bin", {"tiny.map.bin": MAP}, out=""),
    "info on a splat": Case("info tiny.ply", {"tiny.ply": PLY}, out=""),
}
WRITERS = {name: case for name, case in CASES.items() if case.out} | {
    "demo-scene": Case("demo-scene --seed 3 -o OUT", {}, out="out.ply")
}
DAMAGED = [
    (name, file, how) for name, case in CASES.items() for file, ways in case.inputs.items() for how in ways
]
WRONG = [(name, *pair) for name, case in CASES.items() for pair in (case.wrong_kind or {}).items()]


@pytest.fixture
def here(pipeline, tmp_path, monkeypatch) -> Path:
    """A private copy of the pipeline's files as the working folder."""
    shutil.copytree(pipeline, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def words_of(case: Case, out: str | None = None) -> list[str]:
    return [(out or case.out) if word == "OUT" else word for word in case.words.split()]


def expect(code: int, found: int, before: set[str], folder: Path, stderr: str) -> str:
    """Check the code, that stderr is one line, and that nothing was left behind."""
    lines = [line for line in stderr.splitlines() if line.strip()]
    assert found == code, stderr
    assert len(lines) == 1, stderr
    assert lines[0].startswith("alula: ")
    assert "Traceback" not in stderr
    assert "internal error" not in stderr
    assert {file.name for file in folder.iterdir()} == before
    return lines[0]


def names(folder: Path) -> set[str]:
    return {file.name for file in folder.iterdir()}


def test_the_table_has_every_command():
    covered = {case.words.split()[0] for case in WRITERS.values()} | {"info", "scenario"}
    # What speaks to vehicles has tests of its own: test_fly_command.py, test_identify_command.py, …
    assert covered == set(COMMANDS) - {
        *("completion", "demo", "doctor", "fly", "help", "identify", "init", "sim-vehicle")
    }


@pytest.mark.every(2)
@pytest.mark.parametrize("name", WRITERS)
def test_a_good_command_line_of_the_table_succeeds(name, here):
    assert run([*words_of(WRITERS[name]), "-q"]) == 0
    assert (here / WRITERS[name].out).stat().st_size > 0


@pytest.mark.every(2)
@pytest.mark.parametrize(("name", "file", "how"), DAMAGED, ids=lambda v: getattr(v, "__name__", v))
def test_a_damaged_input_is_refused(name, file, how, here, capsys):
    how(here / file)
    before = names(here)
    code = run(words_of(CASES[name]))
    line = expect(3, code, before, here, capsys.readouterr().err)
    assert file in line


@pytest.mark.parametrize(("name", "file", "other"), WRONG)
def test_an_input_of_another_kind_is_refused(name, file, other, here, capsys):
    shutil.copyfile(other, file)
    before = names(here)
    expect(3, run(words_of(CASES[name])), before, here, capsys.readouterr().err)


@pytest.mark.parametrize("name", WRITERS)
def test_an_output_that_is_a_folder_is_refused(name, here, capsys):
    out = f"folder{Path(WRITERS[name].out).suffix}"
    (here / out).mkdir()
    before = names(here)
    expect(3, run(words_of(WRITERS[name], out)), before, here, capsys.readouterr().err)
    assert not list((here / out).iterdir())


@pytest.mark.every(3)
@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("parent", ["nowhere", "pairs.csv", "/proc"])
def test_an_output_in_no_folder_is_refused(name, parent, here, capsys):
    before = names(here)
    line = expect(
        3,
        run([*words_of(WRITERS[name], f"{parent}/{WRITERS[name].out}"), "-q"]),
        before,
        here,
        capsys.readouterr().err,
    )
    assert parent in line


@pytest.mark.parametrize("name", WRITERS)
def test_a_foreign_file_is_not_replaced_without_force(name, here, capsys):
    out = here / WRITERS[name].out
    out.write_text("a diary")
    before = names(here)
    line = expect(2, run(words_of(WRITERS[name])), before, here, capsys.readouterr().err)
    assert "-f" in line
    assert out.read_text() == "a diary"


@pytest.mark.parametrize("name", WRITERS)
def test_a_dry_run_writes_nothing(name, here):
    before = names(here)
    assert run([*words_of(WRITERS[name]), "-n", "-q"]) == 0
    assert names(here) == before


@pytest.mark.parametrize("name", WRITERS)
def test_an_unchanged_output_is_left_alone(name, here, capsys):
    out = here / WRITERS[name].out
    assert run([*words_of(WRITERS[name]), "-q"]) == 0
    content, made = out.read_bytes(), out.stat()
    os.utime(out, (0, 0))
    assert run([*words_of(WRITERS[name]), "--json"]) == 0
    assert '"unchanged"' in capsys.readouterr().out
    assert out.stat().st_ino == made.st_ino
    assert out.read_bytes() == content
    assert out.stat().st_mtime > 10**9


def small_files() -> None:
    """Make writing more than 2 kB fail, as a full disk does."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (2048, 2048))


@pytest.mark.every(6)
@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_leaves_nothing(name, here, tmp_path_factory):
    before = names(here)
    done = subprocess.run(
        [sys.executable, "-P", "-m", "alula.cli", *words_of(WRITERS[name]), "-q"],
        capture_output=True,
        text=True,
        preexec_fn=small_files,
        env=os.environ
        | {"PYTHONDONTWRITEBYTECODE": "1", "MPLCONFIGDIR": str(tmp_path_factory.mktemp("fonts"))},
    )
    if done.returncode == 0:  # the output is smaller than the limit
        assert (here / WRITERS[name].out).stat().st_size <= 2048
        return
    expect(3, done.returncode, before, here, done.stderr)


TELL_WHEN_READY = """
import sys
from alula.cli.shell.interruption import Interruption
from alula.cli.main import main

install = Interruption.install

def install_and_tell(self):
    install(self)
    print("ready", flush=True)

Interruption.install = install_and_tell
main(sys.argv[1:])
"""


@pytest.mark.every(4)
@pytest.mark.parametrize("place", range(len(WRITERS)), ids=list(WRITERS))
def test_an_interrupted_command_leaves_nothing(place, here):
    before, name = names(here), list(WRITERS)[place]
    for i, delay in enumerate(some((0.1, 0.0, 0.3), 3)):
        number = (signal.SIGINT, signal.SIGTERM)[(i + place // 4) % 2]
        process = subprocess.Popen(
            [sys.executable, "-P", "-c", TELL_WHEN_READY, *words_of(WRITERS[name]), "-q"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # background jobs ignore it
        )
        assert process.stdout.readline() == "ready\n"
        time.sleep(0.02 + delay)
        process.send_signal(number)
        _, stderr = process.communicate(timeout=60)
        if process.returncode == 0:  # it was done before the signal came
            break
        assert expect(130, process.returncode, before, here, stderr) == "alula: interrupted"
