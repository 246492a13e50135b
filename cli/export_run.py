"""Exports of runs by `alula export`: a bag of ROS 2, and a layout for Foxglove."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from alula.cli.options import Common

if TYPE_CHECKING:
    from alula.schemas.progress import Progress
    from alula.schemas.provenance import Provenance


def export_bag(log: Path, common: Common) -> None:
    """Write the messages of a run as a bag of ROS 2, a folder.

    Args:
        log: of the run.
        common: common options of commands.

    Raises:
        UsageError: rosbags is not installed, or the output is a folder of other files.
        ArtifactError: the input is no run.
        DamagedError: the log is truncated or damaged.
        OutputError: the bag cannot be written.
    """
    from alula.cli.runner import run
    from alula.schemas.atomic import atomic_folder
    from alula.schemas.mcap_log import timed_messages
    from alula.schemas.run import open_log, read_run
    from alula.stages.reporting.rosbag import METADATA, count_bag, require_rosbags, write_bag

    require_rosbags()

    def make(provenance: Provenance, progress: Progress) -> tuple[Any, dict[str, Any]]:
        read_run(log)
        summary: dict[str, Any] = {"format": "rosbag2"}
        if common.dry_run:
            with open_log(log) as file:
                summary["messages"] = count_bag(timed_messages(file))

        def write() -> None:
            with open_log(log) as file, atomic_folder(common.output) as folder:
                summary["messages"] = write_bag(folder, timed_messages(file), provenance.line())

        return write, summary

    run(common, "alula/export", "1.0", {"format": "rosbag2"}, {"input": log}, make, mark=METADATA)


def export_layout(log: Path | None, common: Common) -> None:
    """Write a layout for Foxglove.

    Args:
        log: of a run, whose channels and fields it shows; None for all that a run can have.
        common: common options of commands.

    Raises:
        UsageError: the output does not end in .json.
        DamagedError: the log is truncated or damaged.
        OutputError: the file cannot be written.
    """
    import msgspec

    from alula.cli.runner import run
    from alula.schemas.atomic import atomic_output
    from alula.schemas.errors import UsageError
    from alula.schemas.mcap_log import messages
    from alula.schemas.run import open_log, read_run
    from alula.stages.reporting.foxglove_layout import contents, foxglove_layout

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
