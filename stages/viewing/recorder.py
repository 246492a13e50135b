"""A scene of viser that is recorded and never served by it."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any

from alula.stages.loopback import LOOPBACK
