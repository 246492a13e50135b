"""Progress without a terminal: a line every ten seconds on stderr."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from alula.cli.shell import progress
from alula.cli.shell.progress import PERIOD_S, ProgressLines, shown_progress


class Clock:
    """A clock that is set by hand [s]."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


def shown(times_and_shares):
    """Lines printed for progress reports at these times after the start [s]."""
    clock, lines = Clock(), []
    report = ProgressLines("a.npz", clock, lines.append)
    for at, done, total in times_and_shares:
        clock.now = 100.0 + at
        report(done, total)
    return lines


def test_a_line_appears_every_ten_seconds_and_not_more_often():
    reports = [(0.1 * k, k, 1000) for k in range(1000)]  # 100 s at a steady pace
    lines = shown(reports)
    assert len(lines) == 9
    assert lines[0] == "a.npz: 10 % after 10 s, about 1 min 30 s left"
    assert lines[-1].startswith("a.npz: 90 % after 1 min 30 s, about 10 s left")


def test_a_short_command_prints_nothing():
    assert shown([(0.5, 1, 10), (PERIOD_S - 0.1, 9, 10)]) == []


def test_an_unknown_total_gives_the_elapsed_time():
    assert shown([(3700.0, 0, 1)]) == ["a.npz: 1 h 1 min so far"]


def test_there_is_no_estimate_from_the_first_percents():
    assert shown([(10.0, 1, 1000)]) == ["a.npz: 0 % after 10 s"]


def test_the_estimate_is_smoothed():
    """A pause doubles what the newest fraction suggests, and the estimate moves half of the way."""
    lines = shown([(10.0, 500, 1000), (20.0, 500, 1000)])
    assert lines[0].endswith("about 10 s left")
    assert lines[1].endswith("about 10 s left")  # between 0 s and 20 s


@pytest.mark.parametrize(
    ("quiet", "json", "expected"), [(False, False, 1), (True, False, 0), (False, True, 1)]
)
def test_lines_go_to_stderr_unless_quiet(monkeypatch, capsys, quiet, json, expected):
    clock = Clock()
    monkeypatch.setattr(progress.time, "monotonic", clock)
    monkeypatch.setattr(
        ProgressLines.__init__, "__defaults__", (clock, ProgressLines.__init__.__defaults__[1])
    )
    common = SimpleNamespace(quiet=quiet, json=json, output=Path("folder/a.npz"))
    with shown_progress(common) as report:
        clock.now += 11.0
        report(1, 2)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("a.npz: 50 % after 11 s, about 11 s left\n") == expected
    assert len(captured.err.splitlines()) == expected
