"""Effort of a run of the tests: quick and the same every time, or all of it with new random examples."""

import os

ALL = os.environ.get("ALULA_TESTS") == "all"


def examples(count: int) -> int:
    """Examples that hypothesis draws: `count` with ALULA_TESTS=all, else a quarter of them."""
    return count if ALL else max(5, count // 4)


def some(values, every: int) -> list:
    """All values with ALULA_TESTS=all, else each `every`-th of them."""
    return list(values) if ALL else list(values)[::every]
