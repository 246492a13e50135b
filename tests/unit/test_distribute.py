"""Distributed chunks: the same results in the same order on all workers, and clear messages on failure."""

import subprocess
import sys
import time

import numpy as np
import pytest

from alula.schemas.artifacts.artifact import write_artifact
from alula.schemas.artifacts.manifest import Producer
from alula.schemas.artifacts.parts import open_parts
from alula.schemas.errors import LinkError, UsageError
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.stages import distribute as module
from alula.stages.compression import tiles
from alula.stages.compression.voxelize import voxelize
from alula.stages.compression.voxelize_parts import BlockVoxelizer, voxelize_whole
from alula.stages.distribute import check_scheduler, distribute
from support.clusters import Cluster
from support.killers import kill, kill_once
from support.scenes.fabricate import make_scene


def square(x):
    return x * x


def test_results_come_in_order_and_chunks_are_taken_one_by_one():
    taken = []

    def chunks():
        for i in range(40):
            taken.append(i)
            yield i

    def slow_at_first(i):
        time.sleep(0.002 * (i % 5))
        return i * i

    found = []
    for result in distribute(slow_at_first, chunks(), jobs=3):
        found.append(result)
        assert len(taken) <= len(found) + 4
    assert found == [i * i for i in range(40)]
    assert list(distribute(square, [], jobs=2)) == []


def test_processes_give_the_same():
    assert list(distribute(abs, range(-5, 5), jobs=2, processes=True)) == [abs(i) for i in range(-5, 5)]


def test_a_script_without_a_guard_is_not_run_by_each_process(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "from alula.stages.distribute import distribute\nprint('once')\n"
        "print(list(distribute(abs, [-1, -2], jobs=1, processes=True)))\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("once\n[1, 2]\n", "")


def test_another_process_repeats_the_chunk_of_a_killed_one(tmp_path):
    tasks = [(str(tmp_path), i, bytes(2**20)) for i in range(1, 5)]
    assert list(distribute(kill_once, tasks, jobs=1, processes=True)) == [2, 4, 6, 8]
    assert (tmp_path / "2").exists()


@pytest.mark.slow
def test_a_chunk_that_kills_every_process_is_given_up(monkeypatch):
    monkeypatch.setattr(module, "MOST_LOSSES", 2)
    with pytest.raises(LinkError, match="lost 2 times with the same work, perhaps for lack of memory"):
        list(distribute(kill, [1], jobs=1, processes=True))


def test_what_a_chunk_raises_is_raised_and_the_rest_is_dropped():
    started = []

    def fails(i):
        started.append(i)
        if i == 3:
            raise ValueError("chunk 3")
        return i

    results = distribute(fails, range(1000), jobs=1)
    with pytest.raises(ValueError, match="chunk 3"):
        list(results)
    assert len(started) < 10


def test_a_caller_that_stops_drops_the_rest():
    started = []
    for _ in distribute(started.append, range(1000), jobs=1):
        break
    assert len(started) < 10


@pytest.mark.parametrize("address", ["host:1", "tcp://host", "", "tcp://host:99999999"])
def test_what_is_no_address_is_refused(address):
    with pytest.raises(UsageError, match="--scheduler must be an address like tcp"):
        list(distribute(square, [1], scheduler=address))


def test_without_distributed_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match=r"pip install 'alula\[cluster\]'"):
        list(distribute(square, [1], scheduler="tcp://127.0.0.1:9"))


@pytest.fixture
def cluster(tmp_path):
    started = Cluster(tmp_path, 2)
    yield started
    started.stop()


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # those of other packages
def test_tiles_on_workers_give_the_same_and_a_lost_worker_loses_nothing(cluster, monkeypatch, tmp_path):
    monkeypatch.setattr(tiles, "CHUNK", 200)
    scene, config = make_scene(4000), VoxelizeConfig(size_m=0.02, min_overlap=2)
    plain = voxelize(config, scene)
    monkeypatch.setattr(
        module.distribute, "__kwdefaults__", module.distribute.__kwdefaults__ | {"timeout_s": 60.0}
    )
    lost = []

    def progress(done, total):
        if done > total // 4 and not lost:
            lost.append(done)
            cluster.workers[0].kill()

    tiled = voxelize(config, scene, tile_m=0.3, scheduler=cluster.address, progress=progress)
    assert lost
    assert cluster.workers[0].wait() == -9
    assert cluster.workers[1].poll() is None
    assert tiled.manifest == plain.manifest
    for name in ("index", "overlap"):
        np.testing.assert_array_equal(tiled[name], plain[name])
    write_artifact(tmp_path / "a.scene.npz", scene)
    blocks = BlockVoxelizer(config, open_parts(tmp_path / "a.scene.npz"), 16, tmp_path)
    sent = voxelize_whole(blocks, scheduler=cluster.address)
    for name in ("index", "overlap"):
        np.testing.assert_array_equal(sent[name], plain[name])


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_scheduler_that_does_not_answer_or_has_no_workers_is_said(tmp_path):
    pytest.importorskip("distributed")
    with pytest.raises(LinkError, match=r"no scheduler answers at tcp://127.0.0.1:9 within 1 s"):
        list(distribute(square, [1], scheduler="tcp://127.0.0.1:9", timeout_s=1))
    alone = Cluster(tmp_path, 0)
    try:
        with pytest.raises(LinkError, match="has no workers"):
            list(distribute(square, [1], scheduler=alone.address, timeout_s=1))
    finally:
        alone.stop()


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_workers_of_another_version_are_refused(cluster, monkeypatch):
    monkeypatch.setattr(module, "producer", lambda: Producer("alula", "0.0", "none"))
    with pytest.raises(LinkError, match=r"runs alula .*, not 0\.0 \(none\)"):
        list(distribute(square, [1], scheduler=cluster.address, timeout_s=180))


@pytest.mark.parametrize("address", ["tcp://10.0.0.7:8786", "tls://cluster.example:8786", "tcp://[::2]:8786"])
def test_a_scheduler_on_another_machine_needs_permission(address):
    with pytest.raises(UsageError, match="is not this machine; pass --allow-remote"):
        check_scheduler(address, allow_remote=False)
    check_scheduler(address, allow_remote=True)
    for local in ("tcp://127.0.0.1:8786", "tcp://localhost:8786", "tcp://[::1]:8786"):
        check_scheduler(local, allow_remote=False)
