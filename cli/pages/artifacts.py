"""Reference pages of the files: arrays and manifests of artifacts, records, scenarios, vehicles, missions."""

from __future__ import annotations

import dataclasses
from functools import cache

from alula.cli.pages.tables import code, structs, summary_and_attributes, table
from alula.schemas.artifacts.kinds import KINDS, Kind
from alula.schemas.artifacts.manifest import FEATURES
from alula.schemas.decode import decode_plain_json
from alula.schemas.generate import documents
from alula.schemas.parameters.configs.fly import FlyConfig

_RULES = {
    "finite": "finite",
    "not_negative": "≥ 0",
    "positive": "> 0",
    "unit_interval": "0 to 1",
    "unit_norm": "length 1",
    "starts": "starts of the parts of `{}`",
    "strictly_increasing": "sorted, no row twice",
    "knots": "strictly increasing from 0",
    "any": "",
}

RECORDS: dict[str, tuple[str, str]] = {
    "run": ("alula-run", "the record of a run (`.run.json`, and inside `.run.mcap`)"),
    "parts": ("alula-parts", "the index of an artifact in parts (`index.json` of `NAME.scene/`, ...)"),
    "report": ("alula-report", "a report as data (`alula report -o FILE.json`)"),
    "vehicle": ("alula-vehicle", "a vehicle file (`.toml`)"),
    "mission": ("alula-mission", "a mission file (`.toml`)"),
    "scenario": ("alula-scenario-2", "a scenario (`.toml`)"),
}
"""Pages of the kinds that are not arrays: the beginning of the schema's file name, and what the kind is."""
FLY = {field.name: field.metadata.get("help", "") for field in dataclasses.fields(FlyConfig)}


def artifact_pages() -> dict[str, str]:
    """Page of each kind of file, by its name without suffix."""
    pages = {kind.name.removeprefix("alula/"): _arrays_page(kind) for kind in KINDS.values()}
    return pages | {name: _record_page(name, *what) for name, what in RECORDS.items()}


_documents = cache(documents)


def _schema(beginning: str) -> tuple[str, dict[str, object]]:
    (name,) = (
        file for file in _documents() if file.startswith(beginning + "-") or file.startswith(beginning + ".")
    )
    return name, decode_plain_json(_documents()[name])


def _arrays_page(kind: Kind) -> str:
    short = kind.name.removeprefix("alula/")
    rows = [
        (
            code(rule.name) + (" (optional)" if rule.optional else ""),
            code(rule.dtype),
            f"({', '.join(map(str, rule.shape))})",
            rule.unit,
            rule.meaning,
            _RULES[rule.rule].format(rule.indexes),
        )
        for rule in kind.arrays
    ]
    inherited: dict[str, str] = {}
    for base in reversed(kind.manifest.__mro__):
        inherited |= summary_and_attributes(base.__doc__ or "")[1]
    _, schema = _schema(f"alula-{short}-{kind.version}")
    return f"""# {short.capitalize()} files: `{kind.name}`

From this page you can read or write a `{kind.suffix}` file without alula: its arrays with type, shape and
unit, and the fields of its manifest. [File formats](../../guide/formats.md) describes the bytes around them.
Version {kind.version}.

## Arrays

Types have NumPy's names. Equal letters in shapes are equal lengths. The unit “frame” is the unit of the
manifest, “voxel” a multiple of `voxel_size_m`, and all positions are in the manifest's frame.

{table(("array", "type", "shape", "unit", "meaning", "readers require"), rows)}
A reader that meets a name in `requires` that it does not know must refuse the file. Known names:
{", ".join(map(code, sorted(FEATURES)))}.

## Manifest

{structs(schema, 3, {kind.manifest.__name__: inherited})}"""


def _record_page(name: str, beginning: str, what: str) -> str:
    file, schema = _schema(beginning)
    return f"""# {name.capitalize().removesuffix("s")}s: `alula/{name}`

From this page you learn every key of {what}. The JSON Schema is `schemas/json/{file}`.

{structs(schema, more={"FlyTable": FLY})}"""
