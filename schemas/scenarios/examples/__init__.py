"""Scenarios to begin with, one for each preset."""

from __future__ import annotations

from importlib.resources import files

NAMES = ("room-mocap", "outdoor-radar")
"""Presets of `schemas/scenarios/presets.py`."""


def text_of(name: str) -> str:
    """Text of a scenario.

    Args:
        name: one of `NAMES`.
    """
    return files(__package__).joinpath(f"{name}.toml").read_text(encoding="utf-8")
