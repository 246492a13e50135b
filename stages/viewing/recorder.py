"""A scene of viser that is recorded and never served by it."""

from __future__ import annotations
