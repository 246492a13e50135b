"""`alula merge --block`: outputs, continuation, lost processes, messages."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import pytest

from alula.cli.main import run
from alula.cli.verbs import block_store as command
from alula.schemas.artifacts.artifact import Artifact, read_artifact, write_artifact
from alula.schemas.artifacts.manifest import InputRef, producer
from alula.schemas.artifacts.parts import open_parts
from alula.stages.compression import block_tree
from support.scenes.covers import furniture, voxels_of
from support.scenes.parted import write_parts

WORDS = ["merge", "v.voxels.npz", "-o", "c.cover.npz", "--hulls", "60", "--block", "1.3"]
# The command line of the same commit even when somebody commits between two runs.
CHILD = (
    "import sys; from alula.schemas.artifacts import manifest;"
    " manifest.native_commit = lambda: sys.argv.pop(1);"
    " manifest.producer(); from alula.cli.main import main; main(sys.argv[1:])"
)


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    write_artifact(Path("v.voxels.npz"), voxels_of(furniture()))
    return tmp_path


def test_a_file_and_a_folder_have_the_same_cover_and_can_be_verified(here):
    assert run([*WORDS, "--jobs", "1", "-q"]) == 0
    cover = read_artifact(Path("c.cover.npz"))
    assert cover.manifest.parameters["block_m"] == 1.3
    assert cover.manifest.summary["blocks"] > 10
    assert run(["verify", "c.cover.npz", "--voxels", "v.voxels.npz", "-q"]) == 0
    assert (
        run(
            ["merge", "v.voxels.npz", "-o", "d.cover", "--hulls", "60", "--block", "1.3", "--jobs", "1", "-q"]
        )
        == 0
    )
    parts = open_parts(Path("d.cover"))
    parts.check()
    assert [part.manifest.arrays for part in parts] == [cover.manifest.arrays]
    assert parts.manifest.conservativeness == pytest.approx(cover.manifest.conservativeness, rel=1e-12)
    assert parts.manifest.guarantee == cover.manifest.guarantee
    assert not [*here.glob("*.partial")]


def test_every_cover_names_the_file_that_its_voxels_were_made_from(here):
    """So do covers of blocks, covers in parts, and a cover that is merged from a cover."""
    voxels = voxels_of(furniture())
    origin = InputRef("scene", "alula/scene", "1.0", "5" * 64, "hall.scene.npz")
    named = msgspec.structs.replace(voxels.manifest, inputs=[origin])
    write_artifact(Path("v.voxels.npz"), Artifact(named, voxels.arrays))
    for words in (
        [*WORDS, "-f"],
        ["merge", "v.voxels.npz", "-o", "d.cover", "--hulls", "60", "--block", "1.3"],
        ["merge", "v.voxels.npz", "-o", "e.cover.npz", "--hulls", "60"],
        ["merge", "d.cover", "-o", "f.cover.npz", "--hulls", "30"],
    ):
        assert run([*words, "--jobs", "1", "-q"]) == 0
        made = Path(words[words.index("-o") + 1])
        opened = open_parts(made) if made.is_dir() else read_artifact(made)
        assert opened.manifest.made_from == [origin]
    assert all(part.manifest.made_from == [origin] for part in open_parts(Path("d.cover")))


def test_voxels_in_parts_give_the_same(here):
    assert run([*WORDS, "--jobs", "1", "-q"]) == 0
    voxels = read_artifact(Path("v.voxels.npz"))
    halves = [voxels_of(voxels["index"][k::2]) for k in (0, 1)]
    write_parts(Path("v.voxels"), halves)
    assert (
        run(
            ["merge", "v.voxels", "-o", "p.cover.npz", "--hulls", "60", "--block", "1.3", "--jobs", "1", "-q"]
        )
        == 0
    )
    first, second = (read_artifact(Path(name)) for name in ("c.cover.npz", "p.cover.npz"))
    assert first.manifest.arrays == second.manifest.arrays


def test_limits_per_block_give_a_part_for_each(here, capsys):
    words = ["merge", "v.voxels.npz", "--hulls", "5", "--block", "1.2", "--per-block", "--jobs", "1", "-q"]
    assert run([*words, "-o", "d.cover"]) == 0
    parts = open_parts(Path("d.cover"))
    assert len(parts) > 4
    assert parts.manifest.summary["hulls"] == sum(ref.count for ref in parts.refs)
    assert max(ref.count for ref in parts.refs) <= 5
    lows = [ref.domain[0] for ref in parts.refs]
    assert all(ref.domain[1] == [c + 11 for c in ref.domain[0]] for ref in parts.refs)
    assert len(set(map(tuple, lows))) == len(parts)
    for part, ref in zip(parts, parts.refs, strict=True):
        assert (part["member_index"] >= ref.domain[0]).all()
        assert (part["member_index"] <= ref.domain[1]).all()
    assert run([*words, "-o", "one.cover.npz"]) == 2
    assert (
        capsys.readouterr()
        .err.strip()
        .endswith("parts that are not joined; give a folder, such as -o one.cover")
    )
    assert not Path("one.cover.npz").exists()


def test_an_interrupted_merge_continues_and_writes_the_same_bytes(here, monkeypatch, capsys):
    assert run([*WORDS, "--jobs", "1", "-q"]) == 0
    whole = Path("c.cover.npz").read_bytes()
    Path("c.cover.npz").unlink()
    put, made = command.FolderStore.put, []

    def stopping(store, key, cover):
        if len(made) == 9:
            raise KeyboardInterrupt
        made.append(key)
        put(store, key, cover)

    monkeypatch.setattr(command.FolderStore, "put", stopping)
    capsys.readouterr()
    assert run([*WORDS, "--jobs", "1"]) == 130
    (folder,) = here.glob("c.cover.npz.*.partial")
    expected = f"alula: interrupted; the same command continues from {folder.name}, 9 covers of blocks"
    assert capsys.readouterr().err.strip() == expected
    damaged = sorted(folder.iterdir())[3]
    damaged.write_bytes(damaged.read_bytes()[:-9])
    again = []
    monkeypatch.setattr(
        command.FolderStore, "put", lambda store, key, cover: (again.append(key), put(store, key, cover))
    )
    assert run([*WORDS, "--jobs", "1", "-q"]) == 0
    assert Path("c.cover.npz").read_bytes() == whole
    assert len({*again} & {*made}) == 1  # the damaged one
    assert not folder.exists()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_killed_workers_and_a_killed_merge_lose_nothing(here):
    assert run([*WORDS, "--jobs", "1", "-q"]) == 0
    whole = Path("c.cover.npz").read_bytes()
    Path("c.cover.npz").unlink()
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}

    def start():
        words = [sys.executable, "-P", "-c", CHILD, producer().commit, *WORDS, "--jobs", "2"]
        return subprocess.Popen(words, env=env, stderr=subprocess.PIPE, text=True)

    def blocks():
        return [*here.glob("c.cover.npz.*.partial/block-*.npz")]

    process = start()
    while process.poll() is None and len(blocks()) < 3:
        time.sleep(0.01)
    process.kill()
    process.communicate()
    kept = len(blocks())
    assert kept >= 3
    process = start()
    while process.poll() is None and not (children := workers(process.pid)):
        time.sleep(0.01)
    os.kill(children[0], signal.SIGKILL)
    error = process.communicate()[1]
    assert process.returncode == 0, error
    assert Path("c.cover.npz").read_bytes() == whole


def workers(pid: int) -> list[int]:
    """Spawned processes of a pool, which have begun to work."""
    found = []
    for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
        words = Path(f"/proc/{child}/cmdline").read_bytes()
        found += [int(child)] if b"spawn_main" in words else []
    return found


def test_lost_workers_leave_what_is_finished(here, monkeypatch, capsys):
    from alula.schemas.errors import LinkError

    put = command.FolderStore.put

    def losing(store, key, cover):
        put(store, key, cover)
        raise LinkError("the workers were lost")

    monkeypatch.setattr(command.FolderStore, "put", losing)
    assert run([*WORDS, "--jobs", "1"]) == 6
    (folder,) = here.glob("*.partial")
    assert (
        capsys.readouterr().err
        == f"alula: the workers were lost; the same command continues from {folder.name}\n"
    )
    shutil.rmtree(folder)
    assert (
        run(["merge", "v.voxels.npz", "-o", "d.cover", "--hulls", "60", "--block", "1.3", "--jobs", "1"]) == 6
    )
    assert len([*here.glob("d.cover.*.partial/block-*")]) == 1


def test_what_makes_no_sense_is_refused(here, monkeypatch, capsys):
    assert run(["merge", "v.voxels.npz", "-o", "c.cover.npz", "--hulls", "9", "-q"]) == 0
    for words, code, message in (
        (["c.cover.npz", "-o", "d.cover.npz", "--block", "1"], 2, "c.cover.npz: is a cover; --block"),
        (["v.voxels.npz", "-o", "d.cover"], 2, "d.cover: a cover in parts needs --block"),
        (
            ["v.voxels.npz", "-o", "d.cover.npz", "--scheduler", "tcp://127.0.0.1:9"],
            2,
            "--scheduler sends blocks to workers; give --block",
        ),
        (["v.voxels.npz", "-o", "d.cover.npz", "--block", "0"], 2, "--block must be above 0"),
        (["v.voxels.npz", "-o", "d.cover.npz", "--per-block"], 2, "--per-block needs --block"),
        (["v.voxels.npz", "-o", "d.cover.npz", "--block", "1", "--max-planes", "5"], 5, "one hull needs 6"),
    ):
        assert run(["merge", *words, "-q", "--jobs", "1"]) == code
        assert message in capsys.readouterr().err
    monkeypatch.setattr(block_tree.regions_of, "__defaults__", (900,))
    assert (
        run(["merge", "v.voxels.npz", "-o", "d.cover", "--block", "1", "--hulls", "2", "-q", "--jobs", "1"])
        == 5
    )
    assert "parts that are not joined needs one" in capsys.readouterr().err
    assert not [*here.glob("d.cover*")]


def test_a_dry_run_writes_nothing(here):
    assert run([*WORDS, "--jobs", "1", "-n", "-q"]) == 0
    assert [path.name for path in here.iterdir()] == ["v.voxels.npz"]
