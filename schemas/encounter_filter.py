"""The table `[filter]` of scenarios with moving obstacles."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

NotNegative = Annotated[float, msgspec.Meta(ge=0)]
Positive = Annotated[float, msgspec.Meta(gt=0)]
Share = Annotated[float, msgspec.Meta(gt=0, lt=1)]
Part = Annotated[float, msgspec.Meta(gt=0, le=1)]
Count = Annotated[int, msgspec.Meta(ge=1)]

MovingFilterName = Literal["dr-acbf", "dr-acbf-qp", "mpc", "cbf-qp", "rp-cbf", "none"]


class _Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table of the file: unknown keys are refused."""


class MpcTable(_Table, frozen=True, kw_only=True):
    """Of `mpc`: a horizon of 20 steps, three moves."""

    step_s: Positive = 0.02
    velocity_weight: NotNegative = 0.01
    input_weight: NotNegative = 0.001
    slack_weight: Positive = 1e5


class CbfQpTable(_Table, frozen=True, kw_only=True):
    """Of `cbf-qp`, whose variable is a velocity."""

    horizon_s: Positive = 0.4
    velocity_time_s: Positive = 0.1


class RpCbfTable(_Table, frozen=True, kw_only=True):
    """Of `rp-cbf`: rollouts of the avoiding policy."""

    horizon_s: Positive = 3.0
    step_s: Positive = 0.1
    hold_s: Positive = 0.5
    alpha: Positive = 1.0
    samples: Count = 32


class FilterParameters(_Table, frozen=True, kw_only=True):
    """What all filters share, the warning and the manoeuvre; then what the rows of DR-ACBF are made with.

    `wall_deceleration_m_s2` is by default 0.56 of the vehicle's largest acceleration.
    """

    range_m: Positive = 40.0
    latency_s: NotNegative = 0.02
    h_max_s: Positive = 0.4
    l1: NotNegative = 3.0
    l2: NotNegative = 3.0
    settle_s: NotNegative = 0.3
    envelope_start_m_s2: NotNegative = 1.0
    envelope_cap_m_s2: NotNegative = 4.0
    envelope_forget_m_s3: NotNegative = 0.5
    trigger: Literal["cvar", "simple"] = "cvar"
    tail: Part = 0.05
    wasserstein_m: NotNegative = 0.05
    obstacle_braking_m_s2: NotNegative = 6.0
    simple_quantile: NotNegative = 1.645
    clearance_m: NotNegative = 1.0
    hold_s: NotNegative = 0.2
    kp_per_s2: NotNegative = 60.0
    kd_per_s: NotNegative = 14.0
    reach_m: NotNegative = 0.15
    longest_avoid_s: NotNegative = 1.2
    improvement: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.2
    accelerated: bool = False
    stop_s: Positive = 0.5
    brake: NotNegative = 1.0
    stopped_m_s: NotNegative = 0.3
    wall_room_m: NotNegative = 0.1

    h_min_s: Positive = 0.15
    horizons: Annotated[int, msgspec.Meta(ge=1, le=16)] = 6
    alpha: Share = 0.1
    warned_alpha: Part = 0.5
    solver: Literal["exact", "gs"] = "exact"
    iterations: Annotated[int, msgspec.Meta(ge=0, le=1000)] = 15
    relaxation: Part = 1.0
    tolerance_m_s2: Share = 1e-3
    failing_ticks: Annotated[int, msgspec.Meta(ge=0, le=1_000_000)] = 5
    descent_m_s: NotNegative = 0.5
    rows_before_warning: bool = True
    wall_deceleration_m_s2: Positive | None = None

    mpc: MpcTable = MpcTable()
    cbf_qp: CbfQpTable = CbfQpTable()
    rp_cbf: RpCbfTable = RpCbfTable()


class FilterTable(_Table, frozen=True, kw_only=True):
    """The filter and its parameters."""

    name: MovingFilterName = "dr-acbf"
    parameters: FilterParameters = FilterParameters()
