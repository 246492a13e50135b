"""Pre-flight checks over time: collect observations, prompt for moves by hand, evaluate, and repeat.

The checks themselves are in `preflight`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from alula.schemas.arrays import FloatArray
from alula.schemas.log.foxglove import ERROR, INFO
from alula.stages.flight.links.protocol import Link
from alula.stages.flight.loop.frame_check import HandCheck
from alula.stages.flight.loop.preflight import Needs, Observed, Verdict, verdicts

# Checks that may pass later without any action.
TRANSIENT = frozenset({"heartbeat", "state", "latency", "rate", "estimator", "loop", "level", "arming"})
# Checks of the position; they may pass later when the estimator gets ready or somebody carries the vehicle.
OF_POSITION = frozenset({"start", "clearance", "failsafes", "landing", "fence"})
CARRIED = OF_POSITION | {"on the ground"}

Say = Callable[[int, str], None]


class FlightChecks:
    """Pre-flight checks of one flight; they are repeated while all checks that fail may pass later.

    Args:
        trouble: reason why `Link.prepare` failed; empty if it did not.
        patience_s: time after which a failed check is final even if it may pass later [s].
        by_hand: prompt the operator to move the vehicle along the axes of the map.

    Attributes:
        result: whether all checks passed; None while they run.
        position: position of the vehicle when all checks passed, shape (3,), world frame [m].
        room_m: distance by which it may leave the climb path from there without touching anything [m].
        verdicts: of the last evaluation.
    """

    def __init__(
        self,
        needs: Needs,
        *,
        changed: list[str] | None = None,
        trouble: str = "",
        observe_s: float = 2.0,
        patience_s: float = 60.0,
        by_hand: bool = False,
    ) -> None:
        self.needs = needs
        self.result: bool | None = None
        self.position: FloatArray | None = None
        self.room_m = 0.0
        self.verdicts: list[Verdict] = []
        self._changed, self._trouble = changed or [], trouble
        self._observe_s, self._patience_s = observe_s, patience_s
        self._hand = HandCheck() if by_hand else None
        self._prompt = ""
        self._first_s: float | None = None
        self._ticks = self._states = 0
        self._late_s, self._seen_s, self._since_s = 0.0, -1.0, 0.0

    def look(self, link: Link, now_s: float, late_s: float, say: Say) -> None:
        """Register a tick; sets `result` as soon as it is known."""
        if self.result is not None:
            return
        if self._first_s is None:
            self._first_s = now_s
            self._restart(now_s)
        self._ticks += 1
        self._late_s = max(self._late_s, late_s)
        state = link.state
        if state is not None and state.received_s != self._seen_s:
            self._seen_s = state.received_s
            self._states += 1
            if self._hand is not None:
                self._hand.update(state)
        if self._hand is not None and self._prompts(self._hand, now_s, say):
            return
        if now_s - self._since_s < self._observe_s:
            return
        self._evaluate(link, now_s, say)

    def failure(self) -> str:
        """Names and findings of all checks that do not hold; empty if all hold."""
        failed = [v for v in self.verdicts if not v.holds]
        return "; ".join(f"{v.name}: {v.words}" for v in failed)

    @property
    def is_of_link(self) -> bool:
        """True when checks fail, and the link or the vehicle is the cause of all of them."""
        failed = [v for v in self.verdicts if not v.holds]
        return bool(failed) and all(v.of_link for v in failed)

    def _prompts(self, hand: HandCheck, now_s: float, say: Say) -> bool:
        """Prompt for the next move; False when there is none, or when a move was wrong."""
        wrong = hand.verdict()
        prompt = "" if wrong else hand.prompt
        if prompt and prompt != self._prompt:
            say(INFO, prompt)
        self._prompt = prompt
        if wrong or not prompt:
            if self.needs.frame is None:
                self._first_s = now_s
                self._restart(now_s)
            self.needs = dataclasses.replace(self.needs, frame=wrong)
            return False
        self.needs = dataclasses.replace(self.needs, frame=None)  # also after the vehicle was lifted again
        return True

    def _evaluate(self, link: Link, now_s: float, say: Say) -> None:
        assert self._first_s is not None
        seen = Observed(
            now_s=now_s,
            seconds=now_s - self._since_s,
            status=link.status,
            state=link.state,
            accepts=link.accepts,
            changed=self._changed,
            trouble=self._trouble,
            states=self._states,
            ticks=self._ticks,
            worst_late_s=self._late_s,
            hover=getattr(
                getattr(link, "hover", None), "value", None
            ),  # only links that send throttle have it
        )
        before = {v.name for v in self.verdicts if not v.holds}
        self.verdicts = verdicts(seen, self.needs)
        failed = {v.name for v in self.verdicts if not v.holds}
        may_pass = TRANSIENT if self._hand is None else TRANSIENT | CARRIED
        may_pass |= {v.name for v in self.verdicts if v.is_unknown}
        if failed & {"state", "estimator"}:
            may_pass |= OF_POSITION
        if (
            failed
            and not self.needs.frame
            and failed <= may_pass
            and now_s - self._first_s < self._patience_s
        ):
            if failed != before:
                say(INFO, f"waiting for {', '.join(sorted(failed))}: {self.failure()}")
            self._restart(now_s)
            return
        self.result = not failed
        if self.result and link.state is not None:
            self.position = link.state.position.copy()
            self.room_m = min(self.needs.near_m, *(v.room_m for v in self.verdicts))
        for v in self.verdicts:
            say(INFO if v.holds else ERROR, f"check {v.name}: {'holds' if v.holds else 'FAILS'}, {v.words}")

    def _restart(self, now_s: float) -> None:
        self._ticks = self._states = 0
        self._late_s, self._seen_s, self._since_s = 0.0, -1.0, now_s
