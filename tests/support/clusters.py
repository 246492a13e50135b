"""A `dask.distributed` scheduler and its workers, as processes that a test may kill."""

import json
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest


class Cluster:
    """A scheduler and workers as a person starts them, each a process of its own."""

    def __init__(self, folder: Path, workers: int):
        pytest.importorskip("distributed")
        self._address = folder / "scheduler.json"
        self._folder = folder
        self._scheduler = self._start(
            "scheduler", "--port", "0", "--no-dashboard", "--no-jupyter", "--scheduler-file", self._address
        )
        self.workers = [self.add_worker() for _ in range(workers)]

    def _start(self, *words) -> subprocess.Popen[bytes]:
        with (self._folder / f"{words[0]}.log").open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", "distributed.cli.dask_" + words[0], *map(str, words[1:])],
                stdout=log,
                stderr=log,
            )

    def add_worker(self) -> subprocess.Popen[bytes]:
        return self._start(
            *("worker", "--scheduler-file", self._address, "--nthreads", "1", "--no-nanny", "--no-dashboard"),
            *("--local-directory", self._folder),
        )

    @property
    def address(self) -> str:
        """Once the scheduler has written all of it."""
        deadline = time.monotonic() + 120
        while time.monotonic() < deadline:
            with suppress(FileNotFoundError, json.JSONDecodeError):
                return json.loads(self._address.read_text())["address"]
            time.sleep(0.05)
        raise TimeoutError((self._folder / "scheduler.log").read_text())

    def stop(self):
        for process in (*self.workers, self._scheduler):
            process.kill()
            process.wait()

    def wait_for_workers(self) -> str:
        """The address, once all workers have registered."""
        from distributed import Client

        with Client(self.address, timeout=60, set_as_default=False) as client:
            client.wait_for_workers(len(self.workers), timeout=120)
        return self.address
