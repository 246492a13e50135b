import gc
import os
import signal
import sys
from collections import Counter
from pathlib import Path

import hypothesis
import pytest
from _pytest.assertion import rewrite

from support.effort import ALL

pytest_plugins = ["support.scenes.pipeline", "support.files.browser", "support.flights.quick_clock"]

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


def pytest_sessionstart(session: pytest.Session) -> None:
    """Rewrite the assertions of a share of the modules; each worker would rewrite all of them."""
    if "PYTEST_XDIST_WORKER" not in os.environ or sys.dont_write_bytecode:
        return
    number, count = int(os.environ["PYTEST_XDIST_WORKER"][2:]), int(os.environ["PYTEST_XDIST_WORKER_COUNT"])
    for path in sorted(Path(__file__).parent.rglob("test_*.py"))[number::count]:
        compiled = rewrite.get_cache_dir(path) / (path.stem + rewrite.PYC_TAIL)
        if not compiled.exists() and rewrite.try_makedirs(compiled.parent):
            source_hash, code = rewrite._rewrite_test(path, session.config)
            rewrite._write_pyc(session.config.stash[rewrite.assertstate_key], code, source_hash, compiled)


_THRESHOLD, _COLLECT = gc.get_threshold(), gc.collect


def pytest_collection_finish() -> None:
    """Leave garbage alone: flights make many small objects, and nearly no circles of them.

    Flights collect it before they begin, which takes long beside all that tests hold; a worker keeps no
    rate.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 50, 100)
    if "PYTEST_XDIST_WORKER" in os.environ:
        gc.collect = lambda generation=2: 0


def pytest_sessionfinish() -> None:
    """Undo `pytest_collection_finish`."""
    gc.collect = _COLLECT
    gc.unfreeze()
    gc.set_threshold(*_THRESHOLD)
