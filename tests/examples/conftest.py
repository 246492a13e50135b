"""Examples are copied and made elsewhere; their scripts find the package `papers` in this checkout."""

import pytest

from support.paths import EXAMPLES


@pytest.fixture(scope="session", autouse=True)
def papers():
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("PYTHONPATH", str(EXAMPLES))
        yield
