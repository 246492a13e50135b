"""How the loop that flies runs, and what is counted of it."""

from __future__ import annotations

from dataclasses import dataclass, field

from alula.stages.flight.loop.supervisor import SupervisorLimits


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopOptions:
    """How the loop runs.

    Attributes:
        rate_hz: ticks per second.
        limits: of the supervisor.
        dry_run: only the checks.
        watch_frame: compare motion and frame from take-off on.
        stop_m, stop_speed_m_s: at the end of the plan this near and this slow is there.
        margin_m: how much farther a filter may keep it from there; so near is there after `rest_s` of rest.
    """

    rate_hz: float = 100.0
    limits: SupervisorLimits = field(default_factory=SupervisorLimits)
    dry_run: bool = False
    watch_frame: bool = True
    stop_m: float = 0.2
    stop_speed_m_s: float = 0.3
    margin_m: float = 0.0
    rest_s: float = 1.5


@dataclass(slots=True)
class Counters:
    """What is measured over a flight; `late_s` and `tick_s` per tick of all states."""

    late_s: list[float] = field(default_factory=list)
    tick_s: list[float] = field(default_factory=list)
    filter_s: list[float] = field(default_factory=list)
    overruns: int = 0
    skipped: int = 0
