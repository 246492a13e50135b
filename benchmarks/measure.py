"""Costs measured side by side: each pair is run in turns, so that other programs affect both alike."""

from __future__ import annotations

import gc
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One comparison. Every figure is a cost: a ratio below 1 is in our favour.

    Attributes:
        subject: the compared operation.
        unit: of `ours` and `reference`.
        against: the reference.
        ratio: ours / reference, the median over the runs.
        spread: minimum and maximum ratio of the runs.
        runs: number of runs in turns; 1 where the figure is not a measurement.
        agrees: whether both gave the same answer, in the sense of `check`.
        detail: further figures of this row.
    """

    subject: str
    unit: str
    ours: float
    against: str
    reference: float
    ratio: float
    spread: tuple[float, float]
    runs: int
    agrees: bool
    check: str
    detail: dict[str, float] = field(default_factory=dict)


def in_turns(actions: Sequence[Callable[[], Any]], runs: int) -> tuple[list[Any], FloatArray]:
    """Results of the last round and the CPU seconds of each run, shape (runs, len(actions)).

    CPU seconds of the process, not elapsed time, so that other programs have little effect. Everything is
    run once before, to fill caches, and the order alternates.
    """
    results = [action() for action in actions]
    seconds = np.empty((runs, len(actions)))
    gc.collect()
    gc.disable()
    try:
        for run in range(runs):
            for i in range(len(actions)) if run % 2 == 0 else reversed(range(len(actions))):
                start = time.process_time()
                results[i] = actions[i]()
                seconds[run, i] = time.process_time() - start
    finally:
        gc.enable()
    return results, seconds


def timed(
    subject: str,
    against: str,
    ours: FloatArray,
    reference: FloatArray,
    *,
    agrees: bool,
    check: str,
    unit: str = "ms",
    per: float = 1e-3,
    **detail: float,
) -> Row:
    """Make the row of two columns of `in_turns`; `per` seconds are one unit."""
    ratio = ours / np.maximum(reference, 1e-9)
    return Row(
        subject=subject,
        unit=unit,
        ours=float(np.median(ours)) / per,
        against=against,
        reference=float(np.median(reference)) / per,
        ratio=float(np.median(ratio)),
        spread=(float(ratio.min()), float(ratio.max())),
        runs=len(ratio),
        agrees=agrees,
        check=check,
        detail=detail,
    )


def counted(
    subject: str,
    unit: str,
    against: str,
    ours: float,
    reference: float,
    *,
    agrees: bool,
    check: str,
    **detail: float,
) -> Row:
    """Make the row of two figures that do not vary."""
    ratio = ours / reference
    return Row(
        subject=subject,
        unit=unit,
        ours=ours,
        against=against,
        reference=reference,
        ratio=ratio,
        spread=(ratio, ratio),
        runs=1,
        agrees=agrees,
        check=check,
        detail=detail,
    )


_PEAK = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * (1 if sys.platform == "darwin" else 1024))
"""


def peak_memory(arguments: Sequence[str]) -> int:
    """Maximum resident memory of `python ARGUMENTS` [bytes].

    A small process starts it, because a child's figure begins with the memory of its parent.
    """
    command = [sys.executable, "-P"]
    found = subprocess.run(
        [*command, "-c", _PEAK, *command, *arguments], check=True, capture_output=True, text=True
    )
    return int(found.stdout)
