"""Bags of ROS 2 (rosbag2): a folder with the messages of a run as CDR in an MCAP file, and metadata.yaml.

The library `rosbags` writes them: it has the definitions of the messages, which a bag must contain, and their
encoding. It needs no installation of ROS. Definitions are those of Humble; later releases read them too.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from alula.stages.export.ros_messages import LATCHED, RosMessages

METADATA = "metadata.yaml"  # written last
_VERSION = 8  # of metadata.yaml; Humble and all later releases read it


def write_bag(folder: Path, found: Iterable[tuple[str, int, bytes]], comment: str) -> dict[str, int]:
    """Write a bag; equal arguments give equal bytes with one version of rosbags.

    Args:
        folder: to create, in an existing folder.
        found: topic, log time [ns] and JSON text of the messages of a log, in its order.
        comment: a line, which becomes the last of metadata.yaml.

    Returns:
        The number of messages by topic of the bag.

    Raises:
        ValueError: a message is not of the documented form, or there is none.
        OSError: the bag cannot be written.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    writer = Writer(folder, version=_VERSION, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)  # of chunks, as MCAP has it
    connections: dict[str, Any] = {}
    counts: dict[str, int] = {}
    writer.open()
    try:
        for name, kind, message, time_ns in _converted(found, store.types):
            if name not in connections:
                qos = [_latched_qos()] if name in LATCHED else []
                connections[name] = writer.add_connection(
                    name, kind, typestore=store, offered_qos_profiles=qos
                )
            writer.write(connections[name], time_ns, store.serialize_cdr(message, kind))
            counts[name] = counts.get(name, 0) + 1
    except BaseException:
        writer.abort()
        raise
    writer.close()
    with (folder / METADATA).open("a", encoding="utf-8") as file:
        file.write(f"# {comment}\n")
    return dict(sorted(counts.items()))


def count_bag(found: Iterable[tuple[str, int, bytes]]) -> dict[str, int]:
    """Convert the messages of a log, but write nothing; return the number by topic of the bag.

    Args:
        found: as for `write_bag`.

    Raises:
        ValueError: as `write_bag`.
    """
    from rosbags.typesys import Stores, get_typestore

    names = [name for name, *_ in _converted(found, get_typestore(Stores.ROS2_HUMBLE).types)]
    return dict(sorted(Counter(names).items()))


def _converted(
    found: Iterable[tuple[str, int, bytes]], types: Mapping[str, Any]
) -> Iterator[tuple[str, str, Any, int]]:
    """Topic, type, message and log time [ns] of all messages of a bag; at least one."""
    converter, is_empty = RosMessages(types), True
    for topic, time_ns, data in found:
        for name, kind, message in converter.of(topic, data, time_ns):
            is_empty = False
            yield name, kind, message, time_ns
    if is_empty:
        raise ValueError("it has no messages")


def _latched_qos() -> Any:
    """Reliable, and the last message is kept for late subscribers."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    forever = QosTime(9223372036, 854775807)  # as rosbag2 writes a time without limit
    return Qos(
        QosHistory.KEEP_LAST,
        1,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        forever,
        forever,
        QosLiveliness.AUTOMATIC,
        forever,
        avoid_ros_namespace_conventions=False,
    )
