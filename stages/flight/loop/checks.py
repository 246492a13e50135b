"""The pre-flight checks over time: observe, ask for moves by hand, judge, wait for what may still come."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from alula.schemas.arrays import FloatArray
from alula.stages.flight.links.protocol import Link
from alula.stages.flight.loop.frame_check import HandCheck
from alula.stages.flight.loop.preflight import Needs, Observed, Verdict, verdicts
from alula.stages.flight.recorder.samples import ERROR, INFO

# What time may mend, and what somebody who carries the vehicle still will.
MAY_COME = frozenset({"heartbeat", "state", "rate", "estimator", "loop", "level"})
PLACED = frozenset(
    {"start", "clearance", "landing", "fence"}
)  # said of a place, which comes with the estimator
CARRIED = PLACED | {"on the ground"}

Say = Callable[[int, str], None]


class FlightChecks:
    """Runs all checks on what was observed, again and again while only such fail that time may mend.

    Args:
        needs: of the flight.
        changed: what `Link.prepare` changed; trouble: why it failed.
        observe_s: how long to look before each verdict.
        patience_s: how long to wait for estimator and rates.
        by_hand: ask the operator to move the vehicle along the axes of the map.
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
        self.place: FloatArray | None = None  # where it stood when all held, shape (3,)
        self.room_m = 0.0  # that it has around the way up from there
        self.verdicts: list[Verdict] = []
        self._changed, self._trouble = changed or [], trouble
        self._observe_s, self._patience_s = observe_s, patience_s
        self._hand = HandCheck() if by_hand else None
        self._prompt = ""
        self._first_s: float | None = None
        self._ticks = self._states = 0
        self._late_s, self._seen_s, self._since_s = 0.0, -1.0, 0.0

    def look(self, link: Link, now_s: float, late_s: float, say: Say) -> None:
        """Take in a tick; sets `result` when it is known."""
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
        if self._hand is not None and self._asks(self._hand, now_s, say):
            return
        if now_s - self._since_s < self._observe_s:
            return
        self._judge(link, now_s, say)

    def failure(self) -> str:
        """The first check that does not hold, with what was found."""
        failed = [v for v in self.verdicts if not v.holds]
        return "; ".join(f"{v.name}: {v.words}" for v in failed)

    @property
    def is_of_link(self) -> bool:
        """Whether all that fails is for the link or the vehicle to answer."""
        failed = [v for v in self.verdicts if not v.holds]
        return bool(failed) and all(v.of_link for v in failed)

    def _asks(self, hand: HandCheck, now_s: float, say: Say) -> bool:
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
        self.needs = dataclasses.replace(self.needs, frame=None)  # also of one that was lifted again
        return True

    def _judge(self, link: Link, now_s: float, say: Say) -> None:
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
            hover=getattr(getattr(link, "hover", None), "value", None),  # of links that send throttle
        )
        before = {v.name for v in self.verdicts if not v.holds}
        self.verdicts = verdicts(seen, self.needs)
        failed = {v.name for v in self.verdicts if not v.holds}
        may_come = MAY_COME if self._hand is None else MAY_COME | CARRIED
        may_come |= {v.name for v in self.verdicts if v.is_untold}
        if failed & {"state", "estimator"}:
            may_come |= PLACED
        if (
            failed
            and not self.needs.frame
            and failed <= may_come
            and now_s - self._first_s < self._patience_s
        ):
            if failed != before:
                say(INFO, f"waiting for {', '.join(sorted(failed))}: {self.failure()}")
            self._restart(now_s)
            return
        self.result = not failed
        if self.result and link.state is not None:
            self.place = link.state.position.copy()
            self.room_m = min(self.needs.near_m, *(v.room_m for v in self.verdicts))
        for v in self.verdicts:
            say(INFO if v.holds else ERROR, f"check {v.name}: {'holds' if v.holds else 'FAILS'}, {v.words}")

    def _restart(self, now_s: float) -> None:
        self._ticks = self._states = 0
        self._late_s, self._seen_s, self._since_s = 0.0, -1.0, now_s
