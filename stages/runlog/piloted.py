"""Fields of a log for a pilot's flight in a fence: his command, regulation function, true distance."""

from __future__ import annotations

from typing import Any

import numpy as np

from alula.stages.runlog.messages import number, xyz
from alula.stages.simulation.result import WorldFlight

STATUSES = ("passed", "blended", "backup", "no-pilot", "hand-over", "refused")  # alula_geofence_status


def pilot_fields(flight: WorldFlight, i: int) -> dict[str, Any]:
    """Fields of `/safety` at a sample; none for other flights.

    `fence_distance_m` is the minimum true distance to the fence since the sample before, less the vehicle's
    radius, h_m the filter's h_I, and lambda the pilot's part of the command.
    """
    figure = flight.rows("figure")
    if not figure.shape[1]:
        return {}
    lambda_, h_i, _, allowance, towards = figure[i]
    pilot = flight.rows("sticks")[i]
    fields: dict[str, Any] = {
        "fence_distance_m": number(flight.rows("distance")[i, 0]),
        "status_name": STATUSES[flight.of_filters("fence_status")[i, 0]],
        "regulation": number(lambda_),
    }
    if np.isfinite(pilot).all():
        fields |= {"throttle_nom": number(pilot[0]), "rates_nom_rad_s": xyz(pilot[1:])}
    if abs(h_i) < 1e30:  # the largest float stands for one that was not evaluated
        fields |= {"h_m": number(h_i), "allowance_m": number(allowance), "towards_m_s": number(towards)}
    return fields
