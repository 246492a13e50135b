"""Type of the callback for the progress of a long computation."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[int, int], None]
"""Called with (parts done, total parts); the fraction never decreases."""
