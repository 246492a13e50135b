"""Map of a function over many chunks, on threads, processes or a `dask.distributed` scheduler."""

from __future__ import annotations

import re
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.process import BaseProcess
from types import ModuleType
from typing import Any, Protocol, TypeVar

from alula.schemas.artifacts.manifest import producer
from alula.schemas.errors import LinkError, UsageError
from alula.schemas.extras import load
from alula.stages.loopback import is_loopback

Chunk = TypeVar("Chunk")
Result = TypeVar("Result")
_ADDRESS = re.compile(r"(?:tcp|tls|ucx|ws|wss)://(\S+):\d{1,5}")
TIMEOUT_S = 10.0  # maximum time for a scheduler to answer and to have a worker
MOST_LOSSES = 3  # of processes, one after the other without a result in between


class _Future(Protocol):
    def result(self) -> Any: ...

    def cancel(self) -> Any: ...


class _Workers(Protocol):
    """Workers that take chunks; `under_way` is the number of chunks that keeps all of them busy."""

    def submit(self, function: Callable[[Any], Any], chunk: Any) -> _Future: ...

    def under_way(self) -> int: ...


def distribute(
    function: Callable[[Chunk], Result],
    chunks: Iterable[Chunk],
    *,
    jobs: int = 0,
    processes: bool = False,
    scheduler: str | None = None,
    timeout_s: float = TIMEOUT_S,
) -> Iterator[Result]:
    """Yield function(chunk) for every chunk, in the order of the chunks.

    Results do not depend on the kind and number of workers, as long as `function` depends on its chunk alone.
    Chunks are taken from the iterable when a worker is about to be free, so neither all chunks nor all
    results are in memory at once. Another worker repeats the chunk of a worker that is lost, as of a process
    that is killed. When the caller stops early, or is interrupted, chunks that have not begun are dropped.

    Args:
        function: for processes and a scheduler one that is found by its name in a module of `alula`, or
            can be pickled.
        chunks: large enough that a few milliseconds of overhead do not matter, below about 100 MB each.
        jobs: threads or processes; 0 is one per processor. Not used with a scheduler.
        processes: use processes; for functions that hold the interpreter's lock.
        scheduler: address of a `dask.distributed` scheduler, tcp://host:port.
        timeout_s: maximum time for the scheduler to answer and to have a worker [s].

    Raises:
        UsageError: the address is malformed, or `distributed` is not installed.
        LinkError: the scheduler does not answer, has no worker, or its workers run another version; or
            workers are lost with the same chunk again and again.
        Exception: raised by `function`, for the first chunk in order.
    """
    pool = _local(jobs, processes) if scheduler is None else _cluster(scheduler, timeout_s)
    with pool as workers:
        waiting: deque[_Task] = deque()
        try:
            for chunk in chunks:
                waiting.append(_Task(chunk, workers.submit(function, chunk)))
                while len(waiting) >= workers.under_way():
                    yield _first_result(workers, function, waiting)
            while waiting:
                yield _first_result(workers, function, waiting)
        finally:
            for task in waiting:
                task.future.cancel()


@dataclass(slots=True)
class _Task:
    """A chunk that a worker has; the chunk is kept to send it again."""

    chunk: Any
    future: _Future


def _first_result(workers: _Workers, function: Callable[[Any], Any], waiting: deque[_Task]) -> Any:
    """Remove the first task and return its result; chunks of lost processes are sent again."""
    for _ in range(MOST_LOSSES):
        try:
            result = waiting[0].future.result()
        except BrokenExecutor:
            for task in waiting:
                if isinstance(task.future, Future) and task.future.done() and _is_lost(task.future):
                    task.future = workers.submit(function, task.chunk)
        else:
            waiting.popleft()
            return result
    raise LinkError(
        f"processes were lost {MOST_LOSSES} times with the same work, perhaps for lack of memory;"
        " try fewer --jobs"
    )


def _is_lost(future: Future[Any]) -> bool:
    return not future.cancelled() and isinstance(future.exception(), BrokenExecutor)


def check_scheduler(address: str, *, allow_remote: bool) -> None:
    """Reject the address of a scheduler that is malformed, or on another machine without permission.

    Args:
        address: of a `dask.distributed` scheduler, tcp://host:port.
        allow_remote: accept another machine.

    Raises:
        UsageError: the address is rejected.
    """
    if not (found := _ADDRESS.fullmatch(address)):
        raise UsageError(f"--scheduler must be an address like tcp://host:8786, not {address!r}")
    host = found[1].strip("[]")
    if not allow_remote and not is_loopback(host):
        raise UsageError(f"--scheduler: {host} is not this machine; pass --allow-remote to allow it")


class _Process(SpawnProcess):
    """Process that does not run the caller's script, which may do its work without a guard."""

    @staticmethod
    def _Popen(process_obj: BaseProcess) -> Any:
        script = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            return SpawnProcess._Popen(process_obj)
        finally:
            sys.modules["__main__"] = script


class _Spawning(SpawnContext):
    """Spawned, not forked: a forked process with threads may hang."""

    Process = _Process


class _Pool:
    def __init__(self, make: Callable[[], Executor], jobs: int) -> None:
        self._make, self._jobs = make, jobs
        self._executor = make()

    def submit(self, function: Callable[[Any], Any], chunk: Any) -> _Future:
        try:
            return self._executor.submit(function, chunk)
        except BrokenExecutor:  # a process was killed, and with it all others end
            # But not one that was just being started: the pool would wait for its end for ever.
            for process in list((getattr(self._executor, "_processes", None) or {}).values()):
                process.kill()
            self.close()
            self._executor = self._make()
            return self._executor.submit(function, chunk)

    def under_way(self) -> int:
        return self._jobs + 1

    def close(self) -> None:
        self._executor.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _local(jobs: int, processes: bool) -> Iterator[_Workers]:
    import os

    jobs = jobs or os.cpu_count() or 1

    def make() -> Executor:
        if processes:
            return ProcessPoolExecutor(jobs, mp_context=_Spawning(), initializer=_end_with_parent)
        return ThreadPoolExecutor(jobs)

    pool = _Pool(make, jobs)
    try:
        yield pool
    finally:
        pool.close()


def _end_with_parent() -> None:
    """End this process when its parent is killed, which would otherwise leave it waiting for work."""
    import multiprocessing
    import os
    from threading import Thread

    parent = multiprocessing.parent_process()

    def wait() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    Thread(target=wait, daemon=True).start()


class _Cluster:
    def __init__(self, client: Any) -> None:
        self._client = client

    def submit(self, function: Callable[[Any], Any], chunk: Any) -> _Future:
        future: _Future = self._client.submit(function, chunk, pure=False)
        return future

    def under_way(self) -> int:
        """Two chunks per thread of the current workers."""
        threads: int = sum(self._client.nthreads().values())
        return 2 * max(1, threads)


@contextmanager
def _cluster(address: str, timeout_s: float) -> Iterator[_Workers]:
    check_scheduler(address, allow_remote=True)
    distributed, dask = load("distributed"), load("dask")
    # Chunks are part of their tasks on purpose: the scheduler can then send them again.
    with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 GiB"}):
        try:
            client = distributed.Client(address, timeout=timeout_s, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise LinkError(f"no scheduler answers at {address} within {timeout_s:g} s") from error
        with client:
            _check_workers(client, address, timeout_s)
            try:
                yield _Cluster(client)
            except distributed.KilledWorker as error:
                raise LinkError(f"several workers of {address} were lost with the same chunk") from error
            except CancelledError as error:
                raise LinkError(f"the connection to the scheduler at {address} was lost") from error


def _check_workers(client: Any, address: str, timeout_s: float) -> None:
    """Refuse workers of another version: their results would not be those that the record describes.

    Raises:
        LinkError: there is no worker, or one has another alula.
    """
    try:
        client.wait_for_workers(1, timeout=timeout_s)
    except TimeoutError as error:
        raise LinkError(f"the scheduler at {address} has no workers") from error
    try:
        found = client.run(_version)
    except Exception as error:  # of any type: the worker may have no alula, or an older one
        raise LinkError(f"a worker of {address} cannot run alula: {error}") from error
    for worker, theirs in sorted(found.items()):
        if theirs != _version():
            raise LinkError(f"the worker {worker} of {address} runs alula {theirs}, not {_version()}")


def _version() -> str:
    return f"{producer().version} ({producer().commit})"
