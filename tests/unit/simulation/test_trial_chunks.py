"""Trials in chunks: finished chunks of a journal are not flown again, and all trials keep their order."""

from dataclasses import dataclass

import pytest

from alula.stages.simulation.chunks import FlownTrials, TrialJournal, fly_missing


class Squares(FlownTrials, frozen=True, kw_only=True):
    squares: list[int]


@dataclass(frozen=True)
class Chunk:
    first: int
    count: int


def square(chunk: Chunk) -> Squares:
    numbers = range(chunk.first, chunk.first + chunk.count)
    return Squares(first=chunk.first, trials=[None] * chunk.count, squares=[n * n for n in numbers])


@pytest.mark.parametrize("jobs", [1, 3])
def test_only_what_a_journal_lacks_is_flown(jobs):
    journal = TrialJournal(Squares)
    journal.add(square(Chunk(4, 4)))
    flown, seen = [], []

    def fly(chunk):
        flown.append((chunk.first, chunk.count))
        return square(chunk)

    chunks = fly_missing(
        fly, Chunk, 10, 4, journal, jobs=jobs, progress=lambda done, total: seen.append((done, total))
    )
    assert sorted(flown) == [(0, 4), (8, 2)]
    assert seen == [(4, 10), (8, 10), (10, 10)]
    assert [n for chunk in chunks for n in chunk.squares] == [n * n for n in range(10)]
    assert len(journal) == 10
    assert fly_missing(fly, Chunk, 10, 4, journal, jobs=jobs, scheduler="tcp://127.0.0.1:9") == chunks
    assert len(flown) == 2  # nothing was left, and no scheduler was asked


def test_a_snapshot_is_the_journal_whatever_the_order_of_its_chunks():
    one, other = TrialJournal(Squares), TrialJournal(Squares)
    chunks = [square(Chunk(0, 0)), square(Chunk(3, 0))]
    for chunk, last in zip(chunks, reversed(chunks), strict=True):
        one.add(chunk)
        other.add(last)
    assert one.snapshot() == other.snapshot()
    assert TrialJournal(Squares, one.snapshot()).in_order() == chunks
    assert TrialJournal(Squares).in_order() == []
    with pytest.raises(ValueError, match="squares"):
        TrialJournal(Squares, b"\x91\x82\xa5first\x00\xa6trials\x90")
