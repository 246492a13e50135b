"""Protocol of the vehicle: the answer to each received message, and the messages that are due."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import ClassVar

from alula.stages.sim_vehicle.ardupilot.commands import Commands, command_of
from alula.stages.sim_vehicle.ardupilot.modes import MODES
from alula.stages.sim_vehicle.ardupilot.telemetry import Telemetry
from alula.stages.sim_vehicle.common.copter import INFO, WARNING, Copter
from alula.stages.sim_vehicle.common.packets import COMPONENT, Codec, Message, mavlink

_CHUNK = 50  # characters of a STATUSTEXT
_PARAMETERS_AT_ONCE = 4  # in a tick
_NAK, _UNKNOWN_COMMAND = 129, 7  # of MAVLink FTP


class Dialogue:
    """Answers the messages that clients send when they connect and in flight.

    Messages for another system or component, and unknown messages, are ignored.

    Args:
        codec: encoder of the channel, for signing and the system id.
        time_10us: present time for signatures, in units of 10 us since 2015.
    """

    COMMANDS: ClassVar[type[Commands]] = Commands

    def __init__(self, copter: Copter, telemetry: Telemetry, codec: Codec, time_10us: int = 0) -> None:
        self._copter = copter
        self._telemetry = telemetry
        self._codec = codec
        self._time_10us = time_10us
        self._commands = self.COMMANDS(copter, telemetry)
        self._listing: deque[str] = deque()
        self._text_id = 0
        self._sent_location = (copter.estimator.origin, copter.flying.home)
        self._table: dict[str, Callable[[Message], list[Message]]] = {
            "HEARTBEAT": self._heartbeat,
            "COMMAND_LONG": self._command,
            "COMMAND_INT": self._command,
            "SET_MODE": self._set_mode,
            "SET_ATTITUDE_TARGET": self._attitude_target,
            "SET_POSITION_TARGET_LOCAL_NED": self._position_target,
            "PARAM_REQUEST_LIST": self._list_parameters,
            "PARAM_REQUEST_READ": self._read_parameter,
            "PARAM_SET": self._set_parameter,
            "REQUEST_DATA_STREAM": self._stream,
            "SET_GPS_GLOBAL_ORIGIN": self._set_origin,
            "VISION_POSITION_ESTIMATE": self._vision_position,
            "VISION_SPEED_ESTIMATE": self._vision_velocity,
            "RC_CHANNELS_OVERRIDE": self._override,
            "TIMESYNC": self._timesync,
            "PING": self._ping,
            "SETUP_SIGNING": self._setup_signing,
            "AUTOPILOT_VERSION_REQUEST": lambda message: self._one("AUTOPILOT_VERSION"),
            "MISSION_REQUEST_LIST": self._mission_list,
            "MISSION_COUNT": lambda message: [self._mission_ack(message, mavlink.MAV_MISSION_UNSUPPORTED)],
            "MISSION_CLEAR_ALL": lambda message: [self._mission_ack(message, mavlink.MAV_MISSION_ACCEPTED)],
            "MISSION_REQUEST_INT": self._mission_item,
            "MISSION_REQUEST": self._mission_item,
            "LOG_REQUEST_LIST": lambda message: [mavlink.MAVLink_log_entry_message(0, 0, 0, 0, 0)],
            "FILE_TRANSFER_PROTOCOL": self._file_transfer,
        }

    def answer(self, message: Message) -> list[Message]:
        """Process a message; returns the answers."""
        target = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        if target not in (0, self._codec.system) or component not in (0, COMPONENT):
            return []
        row = self._table.get(message.get_type())
        return [] if row is None else row(message)

    def due(self) -> list[Message]:
        """Messages that are due without a request."""
        found = self._telemetry.due()
        location = (self._copter.estimator.origin, self._copter.flying.home)
        if location != self._sent_location:  # both are sent whenever they change
            self._sent_location = location
            found += self._one("GPS_GLOBAL_ORIGIN") + self._one("HOME_POSITION")
        while self._copter.texts:
            found += self._text(*self._copter.texts.popleft())
        if self._listing:
            for _ in range(min(_PARAMETERS_AT_ONCE, len(self._listing))):
                found.append(self._parameter(self._listing.popleft()))
        return found

    def _one(self, name: str) -> list[Message]:
        message = self._telemetry.build(name)
        return [] if message is None else [message]

    def _text(self, severity: int, text: str) -> list[Message]:
        parts = [text[i : i + _CHUNK] for i in range(0, len(text), _CHUNK)]
        self._text_id = self._text_id % 65535 + 1
        number = self._text_id if len(parts) > 1 else 0
        return [
            mavlink.MAVLink_statustext_message(severity, part.encode("ascii", "replace"), number, i)
            for i, part in enumerate(parts)
        ]

    def _heartbeat(self, message: Message) -> list[Message]:
        self._copter.note_ground_station(message.get_srcSystem())
        return []

    def _command(self, message: Message) -> list[Message]:
        result, others = self._commands.execute(command_of(message))
        ack = mavlink.MAVLink_command_ack_message(
            message.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
        )
        return [ack, *others]

    def _set_mode(self, message: Message) -> list[Message]:
        result = self.COMMANDS.REFUSED
        custom = message.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        if custom and self._copter.set_mode(message.custom_mode):
            result = mavlink.MAV_RESULT_ACCEPTED
        return [mavlink.MAVLink_command_ack_message(mavlink.MAVLINK_MSG_ID_SET_MODE, result)]

    def _attitude_target(self, message: Message) -> list[Message]:
        if MODES[self._copter.mode].takes_setpoints:
            self._copter.flying.guided.attitude_target(message, self._copter.estimator.motion)
        return []

    def _position_target(self, message: Message) -> list[Message]:
        if MODES[self._copter.mode].takes_setpoints:
            self._copter.flying.guided.position_target(message, self._copter.estimator.motion)
        return []

    def _parameter(self, name: str) -> Message:
        parameters = self._copter.parameters
        return mavlink.MAVLink_param_value_message(
            name.encode(),
            self._wire_value(name),
            parameters.type_of(name),
            len(parameters),
            parameters.index_of(name),
        )

    def _wire_value(self, name: str) -> float:
        """Float that encodes the parameter in PARAM_VALUE."""
        return self._copter.parameters[name]

    def _list_parameters(self, _message: Message) -> list[Message]:
        self._listing = deque(self._copter.parameters)
        return []

    def _read_parameter(self, message: Message) -> list[Message]:
        parameters = self._copter.parameters
        if message.param_index >= 0:
            name = parameters.name_at(message.param_index)
        else:
            name = parameter_name(message.param_id)
        return [self._parameter(name)] if name is not None and name in parameters else []

    def _set_parameter(self, message: Message) -> list[Message]:
        """Set a parameter; the answer is its new value, none for an unknown name."""
        name = parameter_name(message.param_id)
        if name not in self._copter.parameters:
            return []
        self._copter.parameters.set(name, message.param_value)
        if name == "MAV_SYSID":
            self._codec.system = max(1, min(255, self._copter.parameters.whole(name)))
        for group, (rate, _) in self._telemetry.STREAMS.items():
            if name == rate:
                self._telemetry.set_stream(group, self._copter.parameters[name])
        return [self._parameter(name)]

    def _stream(self, message: Message) -> list[Message]:
        rate = message.req_message_rate if message.start_stop else 0
        self._telemetry.set_stream(message.req_stream_id, rate)
        return []

    def _set_origin(self, message: Message) -> list[Message]:
        location = (message.latitude / 1e7, message.longitude / 1e7, message.altitude / 1e3)
        self._copter.estimator.set_origin(location)
        return []

    def _vision_position(self, message: Message) -> list[Message]:
        self._copter.estimator.vision_position((message.x, message.y, message.z), message.yaw)
        return []

    def _vision_velocity(self, message: Message) -> list[Message]:
        self._copter.estimator.vision_velocity((message.x, message.y, message.z))
        return []

    def _override(self, message: Message) -> list[Message]:
        if message.get_srcSystem() == self._copter.parameters.whole("MAV_GCS_SYSID"):
            values = [getattr(message, f"chan{i}_raw") for i in range(1, 17)]
            values[8:] = [0xFFFF if value == 0 else value for value in values[8:]]
            self._copter.pilot.override(values, self._copter.time_s)
        return []

    def _timesync(self, message: Message) -> list[Message]:
        if message.tc1:
            return []
        return [mavlink.MAVLink_timesync_message(int(self._copter.time_s * 1e9), message.ts1)]

    def _ping(self, message: Message) -> list[Message]:
        if message.target_system:
            return []
        to = (message.get_srcSystem(), message.get_srcComponent())
        return [mavlink.MAVLink_ping_message(message.time_usec, message.seq, *to)]

    def _setup_signing(self, message: Message) -> list[Message]:
        if self._copter.is_armed:
            self._copter.say(WARNING, "ERROR: Won't setup signing when armed")
        else:
            self._codec.set_key(bytes(message.secret_key), max(message.initial_timestamp, self._time_10us))
            self._copter.say(INFO, "signing key set")
        return []

    def _mission_list(self, message: Message) -> list[Message]:
        to = (message.get_srcSystem(), message.get_srcComponent())
        return [mavlink.MAVLink_mission_count_message(*to, 0, message.mission_type)]

    def _mission_item(self, message: Message) -> list[Message]:
        return [self._mission_ack(message, mavlink.MAV_MISSION_INVALID_SEQUENCE)]

    def _mission_ack(self, message: Message, result: int) -> Message:
        to = (message.get_srcSystem(), message.get_srcComponent())
        return mavlink.MAVLink_mission_ack_message(*to, result, message.mission_type)

    def _file_transfer(self, message: Message) -> list[Message]:
        """Refuse every request, because there are no files; clients then continue at once."""
        request = bytes(message.payload)
        number = (int.from_bytes(request[:2], "little") + 1) % 65536
        head = number.to_bytes(2, "little") + bytes([request[2], _NAK, 1, request[3], 0, 0])
        reply = head + bytes(4) + bytes([_UNKNOWN_COMMAND])
        to = (message.get_srcSystem(), message.get_srcComponent())
        payload = list(reply.ljust(251, b"\0"))
        return [mavlink.MAVLink_file_transfer_protocol_message(0, *to, payload)]


def parameter_name(identifier: str | bytes) -> str:
    """Name in a param_id, without its padding."""
    text = identifier.decode("ascii", "replace") if isinstance(identifier, bytes) else identifier
    return text.rstrip("\0")
