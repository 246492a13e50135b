"""Datagrams of motion capture."""

from __future__ import annotations

import json


def sample(time_s, position=(1, 2, 3), quat=(1, 0, 0, 0), **more):
    whole = {"time_s": time_s, "position_m": list(position), "attitude_wxyz": list(quat), **more}
    return json.dumps(whole).encode()
