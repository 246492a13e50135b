"""The process that makes new plans beside a flight, so that no tick waits for them."""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

import msgspec

from alula.schemas.artifacts.artifact import Artifact, encode_manifest, in_memory
from alula.schemas.artifacts.parts_join import read_whole
from alula.schemas.errors import AlulaError, InputError
from alula.schemas.scenarios.vehicle import Vehicle, contents
from alula.stages.flight.links.own_safety import OwnSafety
from alula.stages.flight.recorder.pipe import FlightPipe, next_message
from alula.stages.flight.replan.task import ReplanAnswer, ReplanFacts, ReplanRequest, ReplanTask, answer_to

_START_S = 120.0  # maximum time in which the process reads its maps
_CLOSE_S = 1.0
_NICENESS = 5  # it gives way to the flight
_LENGTH = struct.Struct("<I")
_READ_BYTES = 2**16


class Planner(Protocol):
    """Maker of new plans that never lets the flight wait."""

    @property
    def has_ended(self) -> bool:
        """True if it makes no more plans."""
        ...

    def ask(self, request: ReplanRequest) -> bool:
        """Ask for a plan.

        Returns:
            True if the request is on its way.
        """
        ...

    def answer(self) -> ReplanAnswer | None:
        """The next answer, if there is one by now."""
        ...

    def close(self) -> None:
        """End it."""
        ...


class _Head(msgspec.Struct, frozen=True, kw_only=True):
    """First message to the process: all that is known before the flight."""

    facts: ReplanFacts
    vehicle: dict[str, Any]
    paths: dict[str, str]
    manifests: dict[str, bytes]


class PlannerProcess:
    """`Planner` in a process of its own, which has read its maps when the constructor returns.

    Raises:
        InputError: the process does not run, or its maps are not those of the flight.
    """

    def __init__(
        self,
        facts: ReplanFacts,
        vehicle: Vehicle,
        artifacts: Mapping[str, Artifact],
        paths: Mapping[str, Path],
    ) -> None:
        roles = [each.role for each in facts.maps]
        head = _Head(
            facts=facts,
            vehicle=contents(vehicle),
            paths={role: str(paths[role].absolute()) for role in roles},
            manifests={role: encode_manifest(artifacts[role].manifest) for role in roles},
        )
        code = "from alula.stages.flight.replan.process import main; main()"
        self._pipe = FlightPipe(code, (), stdout=subprocess.PIPE)
        assert self._pipe.process.stdout is not None
        self._out, self._read = self._pipe.process.stdout, bytearray()
        self._encode = msgspec.msgpack.Encoder().encode
        self._has_ended = False
        self._decoder = msgspec.msgpack.Decoder(ReplanAnswer)
        try:
            self._pipe.put(b"h" + self._encode(head), _START_S)
            ready = self._first(time.monotonic() + _START_S)
        except OSError as error:
            self.close()
            raise InputError("the process that makes new plans in flight does not run") from error
        if ready is None or ready.reason:
            self.close()
            raise InputError(f"new plans in flight: {'no answer' if ready is None else ready.reason}")

    def _first(self, until_s: float) -> ReplanAnswer | None:
        os.set_blocking(self._out.fileno(), False)
        while time.monotonic() < until_s and not self._has_ended:
            if (found := self.answer()) is not None:
                return found
            time.sleep(0.01)
        return None

    @property
    def has_ended(self) -> bool:
        """See `Planner`."""
        return self._has_ended

    @property
    def pid(self) -> int:
        """Process id."""
        return self._pipe.process.pid

    def know(self, own: OwnSafety) -> None:
        """Tell the vehicle's failsafes, which new plans must be safe with; before the flight."""
        with suppress(OSError):  # then it has ended, and the next answer says so
            self._pipe.put(b"o" + self._encode(own))

    def ask(self, request: ReplanRequest) -> bool:
        """See `Planner`."""
        return self._pipe.offer(b"r" + self._encode(request))

    def answer(self) -> ReplanAnswer | None:
        """See `Planner`."""
        try:
            raw = os.read(self._out.fileno(), _READ_BYTES)
            self._has_ended = not raw
            self._read += raw
        except BlockingIOError:
            pass
        except (OSError, ValueError):
            self._has_ended = True
        if len(self._read) < _LENGTH.size:
            return None
        end = _LENGTH.size + _LENGTH.unpack_from(self._read)[0]
        if len(self._read) < end:
            return None
        body = bytes(self._read[_LENGTH.size : end])
        del self._read[:end]
        return self._decoder.decode(body)

    def close(self) -> None:
        """See `Planner`; a plan that is being made is given up."""
        self._has_ended = True
        self._pipe.process.kill()
        self._pipe.close(_CLOSE_S)


def main() -> None:
    """Run the process: read maps and requests from standard input, write answers to standard output."""
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # it ends with the pipe
    os.nice(_NICENESS)
    source, out = sys.stdin.buffer, os.dup(1)
    os.dup2(2, 1)  # nothing else may come between the answers
    head = msgspec.msgpack.decode(next_message(source)[1:], type=_Head)
    try:
        task = _task_of(head)
    except (AlulaError, ValueError) as error:
        _send(out, ReplanAnswer(number=0, reason=str(error)))
        return
    _send(out, ReplanAnswer(number=0, reason=""))
    own: OwnSafety | None = None
    while body := next_message(source):
        if body[:1] == b"o":
            own = msgspec.msgpack.decode(body[1:], type=OwnSafety)
        else:
            request = msgspec.msgpack.decode(body[1:], type=ReplanRequest)
            _send(out, answer_to(task, request, own, time.monotonic))


def _task_of(head: _Head) -> ReplanTask:
    artifacts = {role: in_memory(read_whole(Path(path))) for role, path in head.paths.items()}
    for role, each in artifacts.items():
        if encode_manifest(each.manifest) != head.manifests[role]:
            raise InputError(f"{head.paths[role]} has changed since the flight was prepared")
    return ReplanTask(head.facts, msgspec.convert(head.vehicle, Vehicle), artifacts)


def _send(out: int, answer: ReplanAnswer) -> None:
    body = msgspec.msgpack.encode(answer)
    left = memoryview(_LENGTH.pack(len(body)) + body)
    try:
        while left:
            left = left[os.write(out, left) :]
    except OSError:
        os._exit(0)  # the flight is over
