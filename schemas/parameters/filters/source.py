"""Reader of the parameter source: one TOML file per filter or shared part.

A file has the table `[struct]`, optional tables `[parts.NAME]` and one table per parameter, in the order of
the native struct.

    [struct]
    doc = "..."
    filter = "cone-di"           # name of the filter; absent for a shared part
    python = "ConeDi"            # the Python struct is ConeDiParameters
    cpp = "ConeDiOptions"        # C++ struct; `namespace` when it is not alula::flight
    c = "alula_..._config"       # C struct
    parameters_of = "dr-acbf"    # the filter has the parameters of that file

    [parts.pruning]              # member of the native struct
    schema = "pruning"           # file; default: the name with dashes
    defaults = { count = 48 }    # defaults that differ from the part's
    flat = true                  # the native constructor takes the part's fields beside its own
    member = false               # not a member of the native struct
    table = true                 # a table of its own in a scenario

    [alpha]
    default = 5.0                # its type is the parameter's type
    unit = "1/s"
    min, max, above, below       # limits; the last two are exclusive
    multiple_of = 2
    doc = "..."
    choices = { a = "...", b = "..." }
    set_by = "the vehicle"       # not a parameter of users
    optional = "..."             # users may leave it out: what stands for it then
    field = "lambda"             # name in C and C++, when it differs
    binding = "kappa"            # name in the binding, when it differs
    native = false               # Python alone uses it
    cpp_type, c_type, c_prefix, c_names, python_choices
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from dataclasses import field as made_by
from pathlib import Path
from typing import Any

Value = bool | int | float | str | list[float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One parameter; see the module's text for its keys."""

    name: str
    default: Value
    doc: str
    unit: str = ""
    min: float | None = None
    max: float | None = None
    above: float | None = None
    below: float | None = None
    multiple_of: int | None = None
    choices: dict[str, str] = made_by(default_factory=dict)
    python_choices: list[str] = made_by(default_factory=list)
    set_by: str = ""
    optional: str = ""
    field: str = ""
    binding: str = ""
    native: bool = True
    cpp_type: str = ""
    c_type: str = ""
    c_prefix: str = ""
    c_names: list[str] = made_by(default_factory=list)

    @property
    def native_field(self) -> str:
        """Name of the field in C and C++."""
        return self.field or self.name

    @property
    def text(self) -> str:
        """The documentation with the unit in brackets."""
        return f"{self.doc} [{self.unit}]" if self.unit else self.doc

    @property
    def native_choices(self) -> list[str]:
        """The choices that the native code has, in the order of its enumeration."""
        return [name for name in self.choices if name not in self.python_choices]


@dataclass(frozen=True, slots=True, kw_only=True)
class Included:
    """A struct whose parameters a filter has beside its own."""

    name: str
    struct: Struct
    defaults: dict[str, Value] = made_by(default_factory=dict)
    flat: bool = False
    member: bool = True
    table: bool = False

    def parameters(self) -> list[Parameter]:
        """The parameters of the part with the defaults that they have here."""
        return [replace(p, default=self.defaults.get(p.name, p.default)) for p in self.struct.parameters]


@dataclass(frozen=True, slots=True, kw_only=True)
class Struct:
    """One file of the source."""

    name: str
    doc: str
    parameters: list[Parameter]
    parts: list[Included]
    filter: str = ""
    python: str = ""
    cpp: str = ""
    c: str = ""
    namespace: str = "alula::flight"
    parameters_of: str = ""

    def public(self) -> Iterator[Parameter]:
        """The parameters that users can set, those of parts beside the struct's own."""
        yield from (p for p in self.parameters if not p.set_by)
        for part in self.parts:
            if not part.table:
                yield from (p for p in part.parameters() if not p.set_by)


def load(folder: Path) -> dict[str, Struct]:
    """Read all files of a folder.

    Returns:
        The structs by the names of their files; a part stands before what it is a part of.

    Raises:
        ValueError: a key is unknown, or a default is not within its limits or choices.
    """
    raw = {path.stem: tomllib.loads(path.read_text()) for path in sorted(folder.glob("*.toml"))}
    structs: dict[str, Struct] = {}

    def add(name: str) -> Struct:
        if name not in structs:
            tables = dict(raw[name])
            head, parts = tables.pop("struct"), tables.pop("parts", {})
            made = [
                Included(name=key, struct=add(keys.pop("schema", key.replace("_", "-"))), **keys)
                for key, keys in ((key, dict(keys)) for key, keys in parts.items())
            ]
            for part in made:
                _check_defaults(name, part)
            own = [_parameter(name, key, keys) for key, keys in tables.items()]
            structs[name] = Struct(name=name, parameters=own, parts=made, **head)
        return structs[name]

    for name in raw:
        add(name)
    return structs


def filters(structs: dict[str, Struct]) -> dict[str, Struct]:
    """The filters by name, each with the struct that has its parameters."""
    return {s.filter: structs[s.parameters_of or s.name] for s in structs.values() if s.filter}


def _check_defaults(struct: str, part: Included) -> None:
    """Refuse a default of a part that the part has no parameter for, or of another type."""
    known = {parameter.name: parameter.default for parameter in part.struct.parameters}
    for name, value in part.defaults.items():
        if name not in known:
            raise ValueError(f"{struct}.toml: {part.name} has no parameter {name}")
        if type(value) is not type(known[name]):
            words = type(known[name]).__name__
            raise ValueError(f"{struct}.toml: {name}: the default {value!r} must be a {words}")


def _parameter(struct: str, name: str, keys: dict[str, Any]) -> Parameter:
    try:
        parameter = Parameter(name=name, **keys)
    except TypeError as error:
        raise ValueError(f"{struct}.toml: {name}: {error}") from error
    value = parameter.default
    if isinstance(value, str) and value not in parameter.choices:
        raise ValueError(f"{struct}.toml: {name}: the default {value!r} is not one of its choices")
    if isinstance(value, int | float) and not isinstance(value, bool):
        good = (
            (parameter.min is None or value >= parameter.min)
            and (parameter.max is None or value <= parameter.max)
            and (parameter.above is None or value > parameter.above)
            and (parameter.below is None or value < parameter.below)
        )
        if not good:
            raise ValueError(f"{struct}.toml: {name}: the default {value!r} is beyond its limits")
    return parameter
