"""Exports of runs by `alula export`: a bag of ROS 2, and a layout for Foxglove."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from alula.cli.shell.options import Common

if TYPE_CHECKING:
    from alula.schemas.artifacts.provenance import Provenance
    from alula.schemas.progress import Progress


def export_bag(log: Path, common: Common) -> None:
    """Write the messages of a run as a bag of ROS 2, a folder; of a truncated flight those that can be read.

    Raises:
        UsageError: rosbags is not installed, or the output is a folder of other files.
        ArtifactError: the input is no run.
        DamagedError: the log is damaged, or truncated and not of a real flight.
        OutputError: the bag cannot be written.
    """
    from alula.cli.shell.runner import run
    from alula.schemas.atomic import atomic_folder
    from alula.schemas.extras import require
    from alula.schemas.log.mcap import open_log, timed_messages
    from alula.stages.export.rosbag import METADATA, count_bag, write_bag

    require("rosbags")

    def make(provenance: Provenance, progress: Progress) -> tuple[Any, dict[str, Any]]:
        damage = _damage(log)
        summary: dict[str, Any] = {"format": "rosbag2", "notes": [damage] if damage else []}

        def found(file: BinaryIO) -> Iterator[tuple[str, int, bytes]]:
            return _readable(timed_messages(file), is_cut=bool(damage))

        if common.dry_run:
            with open_log(log) as file:
                summary["messages"] = count_bag(found(file))

        def write() -> None:
            with open_log(log) as file, atomic_folder(common.output) as folder:
                summary["messages"] = write_bag(folder, found(file), provenance.line())

        return write, summary

    run(
        common,
        "alula/export",
        "1.0",
        {"format": "rosbag2"},
        {"input": log},
        make,
        mark=METADATA,
        members=r".*\.mcap",
    )


def _damage(log: Path) -> str:
    """Where the log of a real flight is truncated, in words; empty for a whole log of any run."""
    from alula.schemas.errors import ArtifactError
    from alula.schemas.log.cut import salvage_run
    from alula.schemas.log.run import read_run

    try:
        read_run(log)
    except ArtifactError:
        if (found := salvage_run(log)) is None:
            raise
        return found.damage
    return ""


def _readable(found: Iterator[tuple[str, int, bytes]], *, is_cut: bool) -> Iterator[tuple[str, int, bytes]]:
    """Messages up to the damage of a log that is known to be truncated."""
    try:
        yield from found
    except ValueError:
        if not is_cut:
            raise


def export_layout(log: Path | None, common: Common) -> None:
    """Write a layout for Foxglove.

    Args:
        log: of a run, whose channels and fields it shows; None for all that a run can have.

    Raises:
        UsageError: the output does not end in .json.
        DamagedError: the log is truncated or damaged.
        OutputError: the file cannot be written.
    """
    import msgspec

    from alula.cli.shell.runner import run
    from alula.schemas.atomic import atomic_output
    from alula.schemas.errors import UsageError
    from alula.schemas.log.mcap import messages, open_log
    from alula.schemas.log.run import read_run
    from alula.stages.export.foxglove_layout import contents, foxglove_layout

    if common.output.suffix.lower() != ".json":
        raise UsageError(f"{common.output}: with --foxglove-layout the output must end in .json")

    def make(provenance: Provenance, progress: Progress) -> tuple[Any, dict[str, Any]]:
        if log is None:
            layout = foxglove_layout("world")
        else:
            read_run(log)
            with open_log(log) as file:
                layout = foxglove_layout(*contents(messages(file)))
        text = msgspec.json.format(msgspec.json.encode(layout | {"provenance": provenance}), indent=2)

        def write() -> None:
            with atomic_output(common.output) as file:
                file.write(text + b"\n")

        return write, {"format": "foxglove-layout", "panels": len(layout["configById"])}

    inputs = {} if log is None else {"input": log}
    run(common, "alula/export", "1.0", {"format": "foxglove-layout"}, inputs, make)
