"""Client of Foxglove's WebSocket protocol, as far as tests need it."""

import json
import struct
from contextlib import suppress

from websockets.exceptions import ConnectionClosedError
from websockets.sync.client import connect

_MESSAGE = 1  # opcode of message data


class FoxgloveClient:
    """Connection that subscribes to all channels.

    Attributes:
        info: the server's description of itself.
        channels: as advertised, by topic.
        subprotocol: that the server chose.
    """

    def __init__(self, port, *, reads=True):
        # The buffer of a client that does not read is small, so that the server notices.
        self._socket = connect(
            f"ws://127.0.0.1:{port}",
            subprotocols=["foxglove.sdk.v1", "foxglove.websocket.v1"],
            max_size=2**26,
            max_queue=16 if reads else 1,
        )
        self.subprotocol = self._socket.subprotocol
        self.info = json.loads(self._socket.recv(10))
        self.channels = {}
        while not self.channels:
            answer = json.loads(self._socket.recv(10))
            if answer["op"] == "advertise":
                self.channels = {channel["topic"]: channel for channel in answer["channels"]}
        self._topics = {channel["id"]: topic for topic, channel in self.channels.items()}
        wanted = [{"id": number, "channelId": number} for number in self._topics]
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def messages(self):
        """Topic, log time and fields of each message until the server closes the connection."""
        with suppress(ConnectionClosedError):  # as the server's end appears to a client that did not read
            for raw in self._socket:
                if isinstance(raw, bytes) and raw[0] == _MESSAGE:
                    number, time_ns = struct.unpack_from("<IQ", raw, 1)
                    yield self._topics[number], time_ns, json.loads(raw[13:])

    def close(self):
        """Close the connection."""
        self._socket.close()
