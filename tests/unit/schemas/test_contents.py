"""Values of records that others wrote: what readers calculate with is checked where a file is read."""

from types import SimpleNamespace

import pytest

from alula.schemas.artifacts.contents import FenceSummary, check
from alula.stages.reporting.fenced import fence_rows
from alula.stages.reporting.inspect import manifest_facts
from support.scenes.fabricate import make_trial

FENCE = {
    **{"min_distance_m": 0.5, "violations": 0, "passed": 3},
    **{"max_speed_km_h": 90.0, "interventions": 1, "engaged_trials": 1},
}


class _Asked(dict):
    """Remembers the keys that were read."""

    def __init__(self, known):
        super().__init__(known)
        self.keys_read = set()

    def get(self, key, default=None):
        self.keys_read.add(key)
        return super().get(key, default)


def test_every_key_that_a_table_of_fences_reads_is_checked():
    summary = _Asked(FENCE)
    record = SimpleNamespace(summary={"fence": summary, "worst_trial": 0}, trials=[make_trial(0)])
    fence_rows(SimpleNamespace(record=record))
    check(FENCE, FenceSummary, "summary")
    assert {"hand_over", "longest_backup_s"} <= summary.keys_read
    for key in summary.keys_read:
        with pytest.raises(ValueError, match=key):
            check(FENCE | {key: {"a": 1}}, FenceSummary, "summary")


@pytest.mark.parametrize("arrays", [[1], 0.5, "mean", {"mean": 3}, None])
def test_a_manifest_with_other_arrays_is_still_described(arrays):
    assert manifest_facts({"schema": "alula/scene", "arrays": arrays})["arrays"] == {}
