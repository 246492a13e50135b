"""A scenario as TOML with all of its values and their sources, and the list of all keys."""

from __future__ import annotations

import dataclasses
import os
import types
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import msgspec

from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.fly import FlyConfig
from alula.schemas.parameters.filter_options import TABLES
from alula.schemas.scenarios.defaults import completed
from alula.schemas.scenarios.presets import preset_values
from alula.schemas.scenarios.ranges import USED
from alula.schemas.scenarios.scenario import ELSEWHERE, FILES, Read, Scenario, plain, value_at
from alula.schemas.scenarios.tables import FlyTable
from alula.schemas.scenarios.types import LARGEST
from alula.schemas.scenarios.vehicle import Vehicle
from alula.schemas.toml_file import toml_key, toml_value

_COMMENT_COLUMN = 48  # comments of shorter lines begin here


class Value(NamedTuple):
    """A value of a scenario.

    Attributes:
        path: of its key, with dots; a number is the place in a list.
        source: where it comes from: a file, `--set`, a preset, a vehicle, or `default`.
    """

    path: str
    value: Any
    source: str


def values_of(read: Read, vehicle: Vehicle, file: str) -> list[Value]:
    """All values of a scenario that take part in its run, in the order of the tables.

    Args:
        file: name of the scenario's file, for the sources.
    """
    full = completed(read.scenario, vehicle)
    own = plain(read.scenario)
    preset = preset_values(own)

    def source(path: str) -> str:
        if any(path == key or path.startswith(f"{key}.") for key in read.changed):
            return "--set"
        if value_at(read.given, path) is not None:
            return file
        if value_at(preset, path) is not None:
            return f"preset {read.scenario.estimation.preset}"
        is_own = value_at(own, path) is not None or path in ("vehicle.type", "vehicle.actuation_delay_s")
        return "default" if is_own else f"vehicle {vehicle.name}"

    return [Value(path, value, source(path)) for path, value in _walk(_used(full, read), "")]


def _used(scenario: Scenario, read: Read) -> dict[str, Any]:
    """Plain values of a scenario without tables and keys that have no effect in it and that nobody gave."""
    tree = plain(scenario)
    mission, safety = scenario.mission, scenario.safety

    def is_given(path: str) -> bool:
        return value_at(read.given, path) is not None or any(
            key == path or key.startswith(f"{path}.") for key in read.changed
        )

    for key, kinds in USED.items():
        if mission.kind not in kinds and not is_given(f"mission.{key}"):
            tree["mission"].pop(key, None)
    if scenario.world.confidence is not None:
        tree["world"].pop("sigma")
    for key in ("moving", "walls"):
        if not tree["world"][key]:
            tree["world"].pop(key)
    for key in ("preset", "sensor", "tracker"):
        if not (scenario.world.moving or is_given(f"estimation.{key}")):
            tree["estimation"].pop(key, None)
    flown = {TABLES.get(name) for name in safety.filters}
    for table in set(TABLES.values()) - flown:
        if not is_given(f"safety.{table}"):
            tree["safety"].pop(table, None)
    return tree


def _walk(tree: Mapping[str, Any], path: str) -> Iterator[tuple[str, Any]]:
    """Values of a table, then those of the tables in it."""
    inner: list[tuple[str, Any]] = []
    for key, value in tree.items():
        where = f"{path}{key}"
        if isinstance(value, dict) and where != "mission.controller.guide_parameters":
            inner.append((where, value))
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            inner += [(f"{where}.{i}", item) for i, item in enumerate(value)]
        else:
            yield where, value
    for where, value in inner:
        yield from _walk(value, f"{where}.")


def toml_of(values: list[Value]) -> str:
    """Write a scenario; each line says where its value comes from.

    Args:
        values: of `values_of`.
    """
    lines: list[str] = []
    table = ""
    for path, value, source in values:
        parent, _, key = path.rpartition(".")
        if parent != table:
            table = parent
            *parts, last = parent.split(".")
            name = ".".join(map(toml_key, parts if last.isdecimal() else [*parts, last]))
            lines += ["", f"[[{name}]]" if last.isdecimal() else f"[{name}]"]
        lines.append(f"{f'{toml_key(key)} = {toml_value(value)}':<{_COMMENT_COLUMN}}  # {source}")
    return "\n".join(lines) + "\n"


def moved(values: list[Value], old: Path, new: Path) -> list[Value]:
    """Rewrite the names of files, which are relative to the folder of the scenario.

    Args:
        values: of `values_of`.
        old: folder of the scenario.
        new: the folder to which it is written.
    """

    def name(value: str) -> str:
        return value if Path(value).is_absolute() else Path(os.path.relpath(old / value, new)).as_posix()

    return [item._replace(value=name(item.value)) if item.path in FILES else item for item in values]


class Key(NamedTuple):
    """A key that scenarios can have.

    Attributes:
        path: with dots; `*` is a place in a list.
        default: as in TOML; empty for a key without one.
        about: a phrase that explains it.
    """

    path: str
    type: str
    default: str
    about: str


def keys_of(part: str = "") -> list[Key]:
    """All keys, or those of a part.

    Args:
        part: path of a table, such as `safety.cone-backup`, or of a key; empty: all.

    Raises:
        UsageError: there is none.
    """
    part = part.replace("[", ".").replace("]", "")
    found = [key for key in _keys(Scenario, "") if _is_within(key.path, part)]
    if not found:
        parts = ", ".join(item.encode_name for item in msgspec.structs.fields(Scenario))
        raise UsageError(f"no part or key is called {part!r}; parts are {parts}")
    return found


def _is_within(path: str, part: str) -> bool:
    return not part or path == part or path.startswith(f"{part}.")


def _keys(table: type[msgspec.Struct], path: str) -> Iterator[Key]:
    hints = get_type_hints(table, include_extras=True)
    fly = {item.name: item.metadata.get("help", "") for item in dataclasses.fields(FlyConfig)}
    for item in msgspec.structs.fields(table):
        where = f"{path}{item.encode_name}"
        kind, metas = _bare(hints[item.name])
        if (
            path.removeprefix("safety.").removesuffix("."),
            item.name,
        ) in ELSEWHERE or where == "safety.others":
            continue
        if inner := _struct_in(kind):
            yield from _keys(inner, f"{where}.*." if get_origin(kind) is tuple else f"{where}.")
            continue
        default = item.default_factory() if callable(item.default_factory) else item.default
        text = "" if default in (None, msgspec.NODEFAULT) else toml_value(default)
        about = next((meta.description for meta in metas if meta.description), "")
        if table is FlyTable:
            about = fly.get(
                item.name.removesuffix("_m") if item.name == "fence_m" else item.name, "Its address."
            )
        yield Key(where, _type_words(kind, metas), text, about)


def _bare(hint: Any) -> tuple[Any, list[msgspec.Meta]]:
    """Type without None, and its limits and descriptions."""
    metas: list[msgspec.Meta] = []
    while True:
        if get_origin(hint) is Annotated:
            hint, *more = get_args(hint)
            metas += [meta for meta in more if isinstance(meta, msgspec.Meta)]
        elif get_origin(hint) in (Union, types.UnionType) and type(None) in get_args(hint):
            hint = Union[tuple(part for part in get_args(hint) if part is not type(None))]  # noqa: UP007
        else:
            return hint, metas


def _struct_in(kind: Any) -> type[msgspec.Struct] | None:
    """The table that a type is, or of which it is a list."""
    if get_origin(kind) is tuple:
        kind, _ = _bare(get_args(kind)[0])
    return kind if isinstance(kind, type) and issubclass(kind, msgspec.Struct) else None


def _type_words(kind: Any, metas: list[msgspec.Meta]) -> str:
    if get_origin(kind) is Literal:
        return " | ".join(map(str, get_args(kind)))
    if get_origin(kind) in (Union, types.UnionType):
        return " | ".join(_type_words(*_bare(part)) for part in get_args(kind))
    if get_origin(kind) is tuple:
        first, *rest = get_args(kind)
        inner = _type_words(*_bare(first))
        return f"list of {inner}" if rest and rest[-1] is Ellipsis else f"{len(rest) + 1} x {inner}"
    names = {str: "text", bool: "true | false", int: "integer", float: "number"}
    signs = (("ge", ">="), ("gt", ">"), ("le", "<="), ("lt", "<"))
    limits = [
        f"{sign} {limit:g}"
        for meta in metas
        for key, sign in signs
        if (limit := getattr(meta, key)) is not None and abs(limit) < LARGEST
    ]
    return " ".join([names.get(kind, "table"), *limits])
