"""Line between the vehicle and its clients, with packet faults."""

from __future__ import annotations

import heapq
import itertools
import math
from typing import Any

import numpy as np

from alula.stages.sim_vehicle.common.faults import Fault, Schedule
from alula.stages.sim_vehicle.common.packets import Codec, Message

# Motion messages, to which the faults `freeze` and `nan` apply.
_MOTION = frozenset({"LOCAL_POSITION_NED", "ATTITUDE", "ATTITUDE_QUATERNION", "ODOMETRY"})
_Heap = list[tuple[float, int, Any]]


class Line:
    """Converter between messages and packets that applies faults and keeps delayed packets."""

    def __init__(self, codec: Codec, schedule: Schedule, seed: int) -> None:
        self.codec = codec
        self._schedule = schedule
        self._random = np.random.default_rng([seed, 9])
        self._count = itertools.count()
        self._waiting: _Heap = []
        self._arriving: _Heap = []
        self._last: dict[str, Message] = {}
        self._held: dict[str, list[bytes | Message]] = {"out": [], "in": []}

    def send(self, message: Message, now_s: float) -> list[bytes]:
        """Encode a message; returns the packets to send at `now_s` [s]."""
        acting = [fault for fault in self._schedule.acting(now_s) if fault.way == "out"]
        kind = message.get_type()
        if not acting:
            if kind in _MOTION:
                self._last[kind] = message
            return self._released([self.codec.encode(message)], "out")
        hit = self._drawn(acting)
        if kind in _MOTION:
            if "freeze" in hit:
                message = self._last.get(kind, message)
            else:
                self._last[kind] = message
            if "nan" in hit:
                message = _without_numbers(message)
        system = int(hit["wrong-system"].size) % 256 if "wrong-system" in hit else None
        packet = self.codec.encode(message, system)
        if "bad-crc" in hit:
            packet = packet[:-1] + bytes([packet[-1] ^ 0x55])
        return self._passed(packet, hit, now_s, "out", self._waiting)

    def receive(self, data: bytes, now_s: float) -> list[Message]:
        """Decode bytes received at `now_s` [s]; returns the messages that arrive now."""
        found: list[Message] = []
        for message in self.codec.decode(data):
            acting = [fault for fault in self._schedule.acting(now_s) if fault.way == "in"]
            if acting:
                found += self._passed(message, self._drawn(acting), now_s, "in", self._arriving)
            else:
                found += self._released([message], "in")
        return found

    def late_packets(self, now_s: float) -> list[bytes]:
        """Delayed packets that are due at `now_s` [s]."""
        return _popped(self._waiting, now_s)

    def late_messages(self, now_s: float) -> list[Message]:
        """Delayed messages that are due at `now_s` [s]."""
        return _popped(self._arriving, now_s)

    def _drawn(self, acting: list[Fault]) -> dict[str, Fault]:
        return {
            fault.kind: fault
            for fault in acting
            if fault.probability >= 1 or self._random.random() < fault.probability
        }

    def _passed(self, item: object, hit: dict[str, Fault], now_s: float, way: str, later: _Heap) -> list[Any]:
        if "drop" in hit:
            return []
        copies = [item, item] if "duplicate" in hit else [item]
        if "delay" in hit:
            for copy in copies:
                heapq.heappush(later, (now_s + max(0.0, hit["delay"].size), next(self._count), copy))
            return []
        if "reorder" in hit and not self._held[way]:
            self._held[way] = copies
            return []
        return self._released(copies, way)

    def _released(self, items: list[Any], way: str) -> list[Any]:
        """Return these items, then those that were held back for them."""
        if self._held[way]:
            items, self._held[way] = items + self._held[way], []
        return items


def _popped(heap: _Heap, now_s: float) -> list[Any]:
    found = []
    while heap and heap[0][0] <= now_s + 1e-9:
        found.append(heapq.heappop(heap)[2])
    return found


def _without_numbers(message: Message) -> Message:
    values = [getattr(message, name) for name in message.fieldnames]
    return type(message)(*(math.nan if isinstance(value, float) else value for value in values))
