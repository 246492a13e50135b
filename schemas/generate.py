"""`python -m alula.schemas.generate ROOT` writes all files of a checkout that follow from the schemas.

The filter parameters in `schemas/parameters/filters/*.toml` become the C++ and C option structs, the field
lists of the bindings, the Python module `alula.schemas.parameters.filter_options` and the tables in the
documentation. The JSON Schema of every artifact kind follows from the Python structs.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import msgspec

from alula.schemas.parameters.filters import emit_docs, emit_native, emit_python, source

PAGES = ("docs/theory/filters.md", "docs/theory/moving.md", "docs/theory/geofence.md")


def filter_files(root: Path) -> dict[str, str]:
    """What follows from the filter parameters.

    Args:
        root: a checkout, with the parameter source and the pages that have tables.

    Returns:
        File contents by path in the checkout.
    """
    structs = source.load(root / "schemas/parameters/filters")
    native = structs.values()
    files = {
        "native/core/include/alula/filters/options.hpp": emit_native.cpp_header(native),
        "native/core/include/alula/filters/option_fields.hpp": emit_native.field_lists(native),
        "native/onboard/include/alula_options.h": emit_native.c_header(native),
        "schemas/parameters/filter_options.py": emit_python.module(structs),
    }
    return files | {page: emit_docs.with_tables((root / page).read_text(), structs) for page in PAGES}


def keyword_files() -> dict[str, str]:
    """What follows from the configurations: file contents by path in the checkout."""
    from alula.schemas.parameters.configs import emit_keywords  # depends on files that `main` writes first

    return {"schemas/parameters/keywords.py": emit_keywords.module()}


def documents() -> dict[str, bytes]:
    """The JSON Schema of the manifest or record of each kind, by file name."""
    # These modules depend on files that `main` writes first.
    from alula.schemas.artifacts.certificate import CERTIFICATE_SCHEMA, CERTIFICATE_VERSION, CertificateFile
    from alula.schemas.artifacts.kinds import KINDS
    from alula.schemas.artifacts.manifest import VERSION
    from alula.schemas.artifacts.parts import PARTS_SCHEMA, PARTS_VERSION, PartsIndex
    from alula.schemas.artifacts.report import REPORT_SCHEMA, REPORT_VERSION, Report
    from alula.schemas.artifacts.tiles import TILES_SCHEMA, TILES_VERSION, TilesIndex
    from alula.schemas.log.run import RUN_SCHEMA, RUN_VERSION, RunRecord
    from alula.schemas.scenarios.mission import MISSION_SCHEMA, Mission
    from alula.schemas.scenarios.scenario import SCENARIO_VERSION, Scenario
    from alula.schemas.scenarios.tables import SCENARIO_SCHEMA
    from alula.schemas.scenarios.vehicle import VEHICLE_SCHEMA, Vehicle

    types: list[tuple[str, str, type[Any]]] = [
        *((kind.name, kind.version, kind.manifest) for kind in KINDS.values()),
        (PARTS_SCHEMA, PARTS_VERSION, PartsIndex),
        (RUN_SCHEMA, RUN_VERSION, RunRecord),
        (CERTIFICATE_SCHEMA, CERTIFICATE_VERSION, CertificateFile),
        (REPORT_SCHEMA, REPORT_VERSION, Report),
        (TILES_SCHEMA, TILES_VERSION, TilesIndex),
        (SCENARIO_SCHEMA, SCENARIO_VERSION, Scenario),
        (VEHICLE_SCHEMA, VERSION, Vehicle),
        (MISSION_SCHEMA, VERSION, Mission),
    ]
    result = {}
    for name, version, struct in types:
        schema = msgspec.json.schema(struct)
        if struct is Scenario:
            _open_to_others(schema)
        schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": name, **schema}
        text = msgspec.json.format(msgspec.json.encode(schema, order="sorted"), indent=2) + b"\n"
        result[f"{name.replace('/', '-')}-{version}.schema.json"] = text
    return result


def _open_to_others(schema: dict[str, Any]) -> None:
    """Let `[safety]` have tables of other packages' filters; leave out what a file cannot have."""
    from alula.schemas.scenarios.scenario import ELSEWHERE

    definitions = schema["$defs"]
    safety = definitions["SafetyTable"]
    del safety["properties"]["others"]
    safety["additionalProperties"] = {"type": "object"}
    for name, key in ELSEWHERE:
        reference = safety["properties"][name]
        (table,) = (part["$ref"] for part in reference.get("allOf", [reference]))
        definitions[table.rpartition("/")[2]]["properties"].pop(key, None)
    _remove_defaults(schema)


def _remove_defaults(schema: Any) -> None:
    """Remove defaults that are tables, which say nothing new, or infinite, which JSON cannot say."""
    if isinstance(schema, dict):
        if isinstance(schema.get("default"), dict) or schema.get("default") == float("inf"):
            del schema["default"]
        for value in schema.values():
            _remove_defaults(value)
    elif isinstance(schema, list):
        for value in schema:
            _remove_defaults(value)


def main() -> None:
    """Write all files."""
    root = Path(sys.argv[1])
    for name, text in filter_files(root).items():
        (root / name).write_text(text)
    for name, text in keyword_files().items():
        (root / name).write_text(text)
    for name, document in documents().items():
        (root / "schemas/json" / name).write_bytes(document)


if __name__ == "__main__":
    main()
