"""Reference pages of parameters: those of each filter, and those of each stage."""

from __future__ import annotations

import dataclasses
import importlib
import math
import pkgutil
import typing
from typing import Any

from alula.cli.pages.tables import code, table
from alula.schemas.parameters import configs
from alula.schemas.parameters.configs.config import flags_of
from alula.schemas.parameters.filter_options import FILTERS, TABLES
from alula.schemas.parameters.filters.values import Entry, entries
from alula.schemas.scenarios.check import FILTER_COMMANDS

COMMANDS = {
    "velocity": "velocities [m/s]",
    "acceleration": "accelerations [m/s²]",
    "wrench": "thrust [N] and torque [N m]",
    "sticks": "throttle and body rates [rad/s]",
}
"""What a filter of each kind takes and gives, in words."""


def filters_page() -> str:
    """Parameters of every filter: default, limits, meaning."""
    parts = [
        """# Filter parameters

Look up every parameter of every safety filter here, with its default, its limits and its meaning. Set one by
`--set safety.NAME.PARAMETER=VALUE` or in the table `[safety.NAME]` of a scenario, with the NAME of the table.
[One filter at a time](../theory/each-filter.md) says what each filter guarantees, and
[Choose a filter](../howto/choose-a-filter.md) which one fits.
"""
    ]
    for name, options in FILTERS.items():
        kind = FILTER_COMMANDS.get(name)
        takes = f"Takes and gives {COMMANDS[kind]}." if kind else "Passes every command unchanged."
        rows = [
            (code(key), _default(entry), _limits(entry), entry.meta.description or "")
            for key, entry in entries(options).items()
        ]
        body = (
            table(("parameter", "default", "limits", "meaning"), rows) if rows else "It has no parameters.\n"
        )
        if TABLES[name] != name:
            body = f"Its parameters are those of {code(TABLES[name])}, in one table.\n"
        parts.append(f"## {name}\n\n{takes}\n\n{body}")
    return "\n".join(parts)


def _default(entry: Entry) -> str:
    value = entry.default
    if value is None:
        return ""
    if isinstance(value, bool):
        return code(str(value).lower())
    if isinstance(value, tuple):
        return code(", ".join(f"{x:g}" for x in value))
    if isinstance(value, float):
        return "∞" if math.isinf(value) else code(f"{value:.12g}")
    return code(str(value))


def _limits(entry: Entry) -> str:
    if entry.choices:
        return ", ".join(map(code, entry.choices))
    signs = (("≥", entry.meta.ge), (">", entry.meta.gt), ("≤", entry.meta.le), ("<", entry.meta.lt))
    return ", ".join(f"{sign} {limit:g}" for sign, limit in signs if limit is not None)


def configs_page() -> str:
    """Every configuration class of the stages, with its fields."""
    parts = [
        """# Parameters of the stages

Look up the configuration class that each stage takes from Python, and the option that sets the same value on
the command line. All values end up in the manifest of the output.
"""
    ]
    for module in pkgutil.iter_modules(configs.__path__, f"{configs.__name__}."):
        found = vars(importlib.import_module(module.name)).values()
        for config in found:
            if (
                isinstance(config, type)
                and dataclasses.is_dataclass(config)
                and config.__module__ == module.name
            ):
                parts.append(_config(config))
    return "\n".join(parts)


def _config(config: type[Any]) -> str:
    hints = typing.get_type_hints(config)
    rows = []
    for field in dataclasses.fields(config):
        option = "" if field.metadata.get("internal") else flags_of(field)[0]
        rows.append(
            (
                code(field.name),
                code(_type(hints[field.name])),
                "required" if _is_required(field) else _value(field),
                code(option),
                field.metadata.get("help", ""),
            )
        )
    head = (config.__doc__ or "").strip()
    body = table(("field", "type", "default", "option", "meaning"), rows)
    return f"## {config.__name__}\n\n`{config.__module__}`. {head}\n\n{body}"


def _is_required(field: dataclasses.Field[Any]) -> bool:
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def _value(field: dataclasses.Field[Any]) -> str:
    made = field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
    return "" if made is None or made == () else code(str(made))


def _type(hint: Any) -> str:
    text = hint.__name__ if isinstance(hint, type) and not typing.get_args(hint) else str(hint)
    return text.replace("typing.", "")
