"""JSON Schemas of the messages of a log, as Foxglove publishes those of its types: without references."""

from __future__ import annotations

from functools import cache
from typing import Any

import msgspec
from msgspec import inspect

from alula.schemas.log import foxglove
from alula.schemas.log.channels import schema_name

Schema = dict[str, Any]

_TITLES = {foxglove.Time: "time", foxglove.Duration: "duration"}
_NAMES: dict[type[inspect.Type], str] = {
    inspect.FloatType: "number",
    inspect.IntType: "integer",
    inspect.StrType: "string",
    inspect.BoolType: "boolean",
}


@cache
def json_schema(struct: type[msgspec.Struct]) -> Schema:
    """JSON Schema of a channel's messages; do not change it.

    All fields of Foxglove's types are required. Of alula's own Structs a log leaves out unknown values.
    """
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": schema_name(struct)}
    return schema | _of(inspect.type_info(struct))


def _of(kind: Any) -> Schema:
    match kind:
        case inspect.Metadata():
            return _of(kind.type)
        case inspect.UnionType():
            (inner,) = (each for each in kind.types if not isinstance(each, inspect.NoneType))
            return _of(inner)
        case inspect.ListType() | inspect.VarTupleType():
            return {"type": "array", "items": _of(kind.item_type)}
        case inspect.BytesType():
            return {"type": "string", "contentEncoding": "base64"}
        case inspect.StructType():
            return _of_struct(kind)
    bounds = {"minimum": getattr(kind, "ge", None), "maximum": getattr(kind, "le", None)}
    return {"type": _NAMES[type(kind)], **{key: value for key, value in bounds.items() if value is not None}}


def _of_struct(kind: inspect.StructType) -> Schema:
    fields = {field.encode_name: _of(field.type) for field in kind.fields}
    schema: Schema = {"type": "object", "properties": fields}
    if kind.cls in _TITLES:
        return {"title": _TITLES[kind.cls]} | schema
    name = schema_name(kind.cls)
    if name.startswith("foxglove."):
        return {"title": name} | schema | {"required": list(fields)}
    return schema | {"description": " ".join((kind.cls.__doc__ or "").split())}
