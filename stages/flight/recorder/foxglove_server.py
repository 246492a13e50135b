"""Live channels of a flight for Foxglove, by its WebSocket protocol, in a process of its own.

The channels are those of the log without `/replay`, some 25 ticks a second. The server takes no orders:
clients can only read.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Iterable
from queue import SimpleQueue
from typing import Any

import msgspec

from alula.schemas.extras import require
from alula.schemas.log.channels import CHANNELS, FLIGHT_TOPICS, struct_of
from alula.schemas.log.json_schema import json_schema
from alula.schemas.text import one_line
from alula.stages.flight.recorder.channels import FlightChannels, FlightHead, Sent
from alula.stages.flight.recorder.pipe import FlightPipe, next_message
from alula.stages.flight.recorder.samples import BeginSample, TickSample, decoded
from alula.stages.flight.recorder.served import HOST, NICE, open_served

_BACKLOG = 256  # messages that wait for a slow client; the oldest are dropped
_PATH_S = 0.5  # between updates of the path
_DRAIN_S, _CLOSE_S = 0.8, 0.5  # times for the last messages, and for the end of connections
# New subscribers get the last message.
_LATCHED = {"/path", *(topic for topic, channel in CHANNELS.items() if channel.is_latched)}


def open_foxglove(port: int, head: FlightHead) -> tuple[FlightPipe, str]:
    """Start the server and wait until Foxglove can connect to it.

    Args:
        head: facts that are known before the flight.

    Returns:
        The pipe to its process, and its address.

    Raises:
        UsageError: foxglove-sdk is not installed, or the port is taken.
        OutputError: the process does not start.
    """
    require("foxglove")
    code = "from alula.stages.flight.recorder.foxglove_server import main; main()"
    live = msgspec.structs.replace(head, log_every=1)  # the flight sends fewer ticks
    pipe, found = open_served("--foxglove", port, code, msgspec.msgpack.encode(live))
    return pipe, f"ws://{HOST}:{found}"


class _Served:
    def __init__(self, head: FlightHead, port: int) -> None:
        import foxglove

        context = self._context = foxglove.Context()  # channels and server do not keep it
        self._channels = {
            topic: foxglove.Channel(topic, schema=json_schema(struct_of(topic)), context=context)
            for topic in FLIGHT_TOPICS
            if CHANNELS[topic].is_live
        }
        self._last: dict[str, tuple[bytes, int]] = {}
        self._subscribed: SimpleQueue[str] = SimpleQueue()  # filled by threads of the server
        self._head = head
        self._flight: FlightChannels | None = None
        self._path_s = 0.0
        self.server = foxglove.start_server(
            name=f"alula fly: {one_line(head.name)}",
            host=HOST,
            port=port,
            capabilities=[],
            server_listener=_listener(self._subscribed),
            context=context,
            message_backlog_size=_BACKLOG,
        )

    def take(self, message: bytes) -> None:
        """Process a message of the flight."""
        sample = decoded(message)
        if isinstance(sample, BeginSample):
            self._flight = FlightChannels(self._head, sample.start_ns)
            self._send(self._flight.first())
        elif self._flight is None:  # the times of samples are known from the start
            return
        else:
            self._send(self._flight.of(sample))
            if isinstance(sample, TickSample) and time.monotonic() - self._path_s > _PATH_S:
                self._path_s = time.monotonic()
                self._send(self._flight.path())
        self._repeat()

    def finish(self) -> None:
        """Send the whole path and close all connections; wait only a moment for clients that do not read."""
        if self._flight is not None:
            self._send(self._flight.path())
        if any(channel.has_sinks() for channel in self._channels.values()):
            time.sleep(_DRAIN_S)  # a server that is stopped drops its unsent messages
        closing = threading.Thread(target=self.server.stop, daemon=True)
        closing.start()
        closing.join(_CLOSE_S)

    def _repeat(self) -> None:
        """Send the last messages of channels again that have new subscribers."""
        while not self._subscribed.empty():
            topic = self._subscribed.get()
            if topic in self._last:
                data, time_ns = self._last[topic]
                self._channels[topic].log(data, log_time=time_ns)

    def _send(self, found: Iterable[Sent]) -> None:
        for topic, time_ns, message in found:
            channel = self._channels.get(topic)
            if channel is None or not (topic in _LATCHED or channel.has_sinks()):
                continue
            data = msgspec.json.encode(message)
            if topic in _LATCHED:
                self._last[topic] = data, time_ns
            channel.log(data, log_time=time_ns)


def _listener(subscribed: SimpleQueue[str]) -> Any:
    """Listener that notes new subscriptions; it must not send, because it runs inside the server."""
    from foxglove.websocket import ServerListener

    class Listener(ServerListener):  # type: ignore[misc]
        def on_subscribe(self, client: Any, channel: Any) -> None:
            subscribed.put(channel.topic)

    return Listener()


def main() -> None:
    """Run the process of the server: read messages from standard input until the pipe ends."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # it ends with the pipe
    os.nice(NICE)
    source, port = sys.stdin.buffer, int(sys.argv[1])
    head = msgspec.msgpack.decode(next_message(source), type=FlightHead)
    served = _Served(head, port)
    print(served.server.port, flush=True)  # noqa: T201  for `open_served`
    while message := next_message(source):
        served.take(message)
    served.finish()
    os._exit(0)  # the server's threads may still wait for a client
