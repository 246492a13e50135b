import os
import signal
from pathlib import Path

import pytest

pytest_plugins = ["support.pipeline"]

os.environ.setdefault("NUMBA_THREADING_LAYER", "workqueue")  # gsply's; it warns of others that are old

for name in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS"):  # `make test` runs tests that run make
    os.environ.pop(name, None)

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
