"""Callback that a long computation reports its progress to."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[int, int], None]
"""Called with (parts done, parts in all); never decreases."""
