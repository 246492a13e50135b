import gc
import os
import signal
from collections import Counter
from pathlib import Path

import hypothesis
import pytest

from support.effort import ALL

pytest_plugins = ["support.pipeline", "support.browser", "support.quick_clock"]

os.environ.setdefault("NUMBA_THREADING_LAYER", "workqueue")  # gsply's; it warns of others that are old

if "PYTEST_XDIST_WORKER" in os.environ:  # each has a processor; threads of numpy would wait for others'
    os.environ.setdefault("OMP_NUM_THREADS", "1")

for name in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS"):  # `make test` runs tests that run make
    os.environ.pop(name, None)

os.fsync = os.fstat  # no test cuts the power, and thousands of files would wait for the disk

# Background jobs ignore Ctrl-C, and hand that on to every process that a test starts and interrupts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real scenes; tests that need it are skipped without it."""
    folder = os.environ.get("ALULA_DATA")
    if not folder or not Path(folder).is_dir():
        pytest.skip("real data: set ALULA_DATA to the folder of scenes")
    return Path(folder)


# `make test` draws the same examples every time, and fewer than by default; what a run with ALULA_TESTS=all
# finds becomes an @example.
hypothesis.settings.register_profile("quick", deadline=None, derandomize=True, database=None, max_examples=25)
hypothesis.settings.register_profile("all", deadline=None, print_blob=True)
hypothesis.settings.load_profile("all" if ALL else "quick")

MARKS = {
    "realtime": pytest.mark.realtime,
    "sitl": pytest.mark.realtime,
    "examples": pytest.mark.slow,
}  # by folder


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests by their folder, those whose module starts programs, and cases that `every` leaves out."""
    here = Path(__file__).parent
    cases: Counter[str] = Counter()
    for item in items:
        if every := item.get_closest_marker("every"):
            test = item.nodeid.partition("[")[0]
            if cases[test] % every.args[0]:
                item.add_marker(pytest.mark.slow)
            cases[test] += 1
        folder = item.path.relative_to(here).parts[0]
        if folder in MARKS:
            item.add_marker(MARKS[folder])
        if hasattr(getattr(item, "module", None), "subprocess"):
            item.add_marker(pytest.mark.process)


_THRESHOLD = gc.get_threshold()


def pytest_collection_finish() -> None:
    """Flights collect garbage before they begin: what the collection of tests left is no part of that."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 50, 100)  # flights make many small objects, and nearly no circles of them


def pytest_sessionfinish() -> None:
    """Undo `gc.freeze`."""
    gc.unfreeze()
    gc.set_threshold(*_THRESHOLD)
