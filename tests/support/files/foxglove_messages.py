"""Messages built with the classes of foxglove-sdk, which know the fields and their types."""

import base64
import inspect

import msgspec
from foxglove import messages

from alula.schemas.log.json_schema import json_schema

NUMBERS = {
    1: messages.PackedElementFieldNumericType.Uint8,
    7: messages.PackedElementFieldNumericType.Float32,
}
LEVELS = {2: messages.LogLevel.Info, 3: messages.LogLevel.Warning, 4: messages.LogLevel.Error}


def build(message, schema):
    """Object of foxglove-sdk of a message; each object has all fields of its class and no other."""
    title = schema.get("title", "")
    if isinstance(message, list):
        return [build(one, schema["items"]) for one in message]
    if schema.get("contentEncoding") == "base64":
        return base64.b64decode(message, validate=True)
    if not isinstance(message, dict):
        return message
    fields = {key: build(value, schema["properties"][key]) for key, value in message.items()}
    if title in ("time", "duration"):
        return getattr(messages, "Timestamp" if title == "time" else "Duration")(**fields)
    of = getattr(messages, title.removeprefix("foxglove."))
    assert set(fields) == set(inspect.signature(of).parameters) == set(schema["required"])
    if title == "foxglove.Log":
        fields["level"] = LEVELS[fields["level"]]
    if title == "foxglove.PackedElementField":
        fields["type"] = NUMBERS[fields["type"]]
    return of(**fields)


def encoded(message):
    """Bytes of a message in Foxglove's Protobuf."""
    fields = msgspec.json.decode(msgspec.json.encode(message))
    return build(fields, json_schema(type(message))).encode()
