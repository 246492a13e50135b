"""A function that runs in a process of its own beside the caller."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

Result = TypeVar("Result")
_CODE = "from alula.stages.beside import answer; answer()"


@contextmanager
def in_process(function: Callable[..., Result], *arguments: Any) -> Iterator[Callable[[], Result]]:
    """Start a function in another process, and give what waits for its result.

    Unlike those of `multiprocessing` the process does not run the caller's script, which may have no guard.
    Where it ends without a result, for whatever reason, the function is called here, and raises here. At the
    end of the context the process is ended.

    Args:
        function: of a module of `alula`; its result can be pickled.
        *arguments: that can be pickled.
    """
    process = subprocess.Popen(  # in its own session, so that it does not receive Ctrl-C
        [sys.executable, "-P", "-c", _CODE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))},
    )
    task = pickle.dumps((function, arguments))

    def result() -> Result:
        try:
            found: Result = pickle.loads(process.communicate()[0])
        except (EOFError, OSError, pickle.UnpicklingError):
            return function(*arguments)
        return found

    try:
        assert process.stdin is not None
        try:
            process.stdin.write(task)
            process.stdin.flush()
        except BrokenPipeError:
            pass  # `result` finds that nothing was answered
        yield result
    finally:
        process.kill()
        process.communicate()


def answer() -> None:
    """Call the function that standard input names, and write its result to standard output."""
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what prints does not spoil the result
    function, arguments = pickle.load(sys.stdin.buffer)
    with output:
        pickle.dump(function(*arguments), output)
