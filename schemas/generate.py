"""`python -m alula.schemas.generate FOLDER` writes the JSON Schema of every artifact kind."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import msgspec

from alula.schemas.encounters import Encounters
from alula.schemas.geofence import FenceScenario
from alula.schemas.kinds import KINDS
from alula.schemas.manifest import VERSION
from alula.schemas.run import RUN_SCHEMA, RUN_VERSION, RunRecord
from alula.schemas.scenario import SCENARIO_SCHEMA, Scenario
from alula.schemas.vehicle import VEHICLE_SCHEMA, Vehicle


def documents() -> dict[str, bytes]:
    """File name to content, for each kind: the schema of its manifest or record."""
    types: dict[str, tuple[str, type[Any]]] = {
        kind.name: (kind.version, kind.manifest) for kind in KINDS.values()
    }
    types[RUN_SCHEMA] = (RUN_VERSION, RunRecord)
    types[SCENARIO_SCHEMA] = (VERSION, Scenario)
    types[f"{SCENARIO_SCHEMA}-encounters"] = (VERSION, Encounters)
    types[f"{SCENARIO_SCHEMA}-geofence"] = (VERSION, FenceScenario)
    types[VEHICLE_SCHEMA] = (VERSION, Vehicle)
    result = {}
    for name, (version, struct) in types.items():
        schema = msgspec.json.schema(struct)
        schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": name, **schema}
        text = msgspec.json.format(msgspec.json.encode(schema, order="sorted"), indent=2) + b"\n"
        result[f"{name.replace('/', '-')}-{version}.schema.json"] = text
    return result


def main() -> None:
    """Write all documents."""
    folder = Path(sys.argv[1])
    for name, text in documents().items():
        (folder / name).write_bytes(text)


if __name__ == "__main__":
    main()
