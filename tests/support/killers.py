"""Functions that end their own process, in a module that worker processes can import."""

import os
import signal
import time
from pathlib import Path


def kill_once(task):
    """Double the number, in a process that kills itself the first time that it gets 2."""
    folder, number, _ = task
    mark = Path(folder) / f"{number}"
    if number == 2 and not mark.exists():
        mark.touch()
        time.sleep(0.2)  # the next chunk fills the pipe meanwhile
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def kill(_):
    os.kill(os.getpid(), signal.SIGKILL)
