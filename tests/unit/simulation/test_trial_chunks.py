"""Trials in chunks: finished chunks of a journal are not flown again, and all trials keep their order."""

import numpy as np
import pytest

from alula.stages.durations import Times
from alula.stages.simulation.chunks import FlownChunk, TrialChunk, TrialJournal, fly_missing

TIMES = Times.of(np.array([1e-3]), 1.0)


def square(first: int, count: int) -> FlownChunk:
    """A chunk whose flights are their squared numbers."""
    squares = bytes(n * n for n in range(first, first + count))
    return FlownChunk(
        first=first,
        trials=[None] * count,
        filter_times=TIMES,
        tick_times=TIMES,
        command_s=squares,
        reaction_s=b"",
        flights=[],
    )


def test_only_what_a_journal_lacks_is_flown():
    journal = TrialJournal()
    journal.add(square(4, 4))
    flown, seen = [], []

    def fly(chunk: TrialChunk) -> FlownChunk:
        flown.append((chunk.first, chunk.count))
        return square(chunk.first, chunk.count)

    chunks = fly_missing(fly, None, 10, 4, journal, progress=lambda done, total: seen.append((done, total)))
    assert sorted(flown) == [(0, 4), (8, 2)]
    assert seen == [(4, 10), (8, 10), (10, 10)]
    assert [n for chunk in chunks for n in chunk.command_s] == [n * n for n in range(10)]
    assert len(journal) == 10
    assert fly_missing(fly, None, 10, 4, journal, scheduler="tcp://127.0.0.1:9") == chunks
    assert len(flown) == 2  # nothing was left, and no scheduler was asked


def test_a_snapshot_is_the_journal_whatever_the_order_of_its_chunks():
    one, other = TrialJournal(), TrialJournal()
    chunks = [square(0, 0), square(3, 0)]
    for chunk, last in zip(chunks, reversed(chunks), strict=True):
        one.add(chunk)
        other.add(last)
    assert one.snapshot() == other.snapshot()
    assert TrialJournal(one.snapshot()).in_order() == chunks
    assert TrialJournal().in_order() == []
    with pytest.raises(ValueError, match="filter_times"):
        TrialJournal(b"\x91\x82\xa5first\x00\xa6trials\x90")
