"""The two files of a run: its log, and its record with the measured times."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

if TYPE_CHECKING:
    from alula.schemas.log.run import RunRecord


def check_log_name(output: Path) -> None:
    """Refuse a name that readers would not recognise as a log.

    Raises:
        UsageError: the name does not end in .mcap.
    """
    from alula.schemas.errors import UsageError
    from alula.schemas.log.run import RUN_SUFFIX

    if not output.name.endswith(".mcap"):
        raise UsageError(f"{output}: the output must end in .mcap (usually {RUN_SUFFIX})")


def write_run(
    output: Path, record: RunRecord, timing: Mapping[str, Any], write_log: Callable[[BinaryIO], None]
) -> None:
    """Write the log and the record, both or neither; the record also describes the machine.

    Args:
        record: record of the run, without measured times.
        timing: measured times [s] and counts by name.

    Raises:
        OutputError: a file cannot be written.
    """
    from alula.schemas.atomic import atomic_outputs
    from alula.schemas.log.run import record_path

    text = record_text(record, timing)
    with atomic_outputs(output, record_path(output)) as (log, beside):
        write_log(log)
        beside.write(text)


def record_text(record: RunRecord, timing: Mapping[str, Any]) -> bytes:
    """Contents of the file of a record, with measured times and a description of the machine."""
    import os
    import platform

    import msgspec

    machine = {"cpu_count": os.cpu_count(), "machine": platform.machine(), "system": platform.system()}
    timed = msgspec.structs.replace(record, timing=machine | dict(timing))
    return msgspec.json.format(msgspec.json.encode(timed, order="sorted"), indent=2) + b"\n"
