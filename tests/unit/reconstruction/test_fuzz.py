"""A few hundred cases of the fuzzer, the same ones every time; `make fuzz` runs many more."""

import pytest

from support.fuzz.fuzz_splats import fuzz


@pytest.mark.slow
def test_mutated_splats_are_read_or_refused(tmp_path, monkeypatch):
    monkeypatch.delenv("ALULA_DATA", raising=False)
    counts = fuzz(120, seed=5, keep=tmp_path, most=900)
    failures = [path.read_text() for path in tmp_path.glob("*/TRACEBACK")]
    assert failures == []
    assert counts["read"] + counts["refused"] == 900
    assert counts["read"] > 90
