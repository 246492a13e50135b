"""Times in UTC, as text and as nanoseconds since 1970-01-01: log times of flights."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from alula.schemas.errors import UsageError

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_LAST = datetime(2038, 1, 1, tzinfo=UTC)  # beyond it ROS 2 has no times


def start_time_ns(text: str) -> int:
    """Nanoseconds since 1970-01-01 UTC of a time with its zone.

    Args:
        text: ISO 8601, such as 2026-05-01T12:00:00Z or 2026-05-01T14:00:00.5+02:00.

    Raises:
        UsageError: it is no such time, or not within 1970 to 2037.
    """
    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        raise UsageError(f"{text!r} is no time like 2026-05-01T12:00:00Z") from None
    if time.tzinfo is None:
        raise UsageError(f"{text!r} has no time zone; append Z for UTC")
    if not _EPOCH <= time < _LAST:
        raise UsageError(f"{text!r} is not within 1970 to 2037")
    return (time - _EPOCH) // timedelta(microseconds=1) * 1000


def utc_text(time_ns: int) -> str:
    """ISO 8601 in UTC, to microseconds.

    Args:
        time_ns: nanoseconds since 1970-01-01 UTC.
    """
    time = _EPOCH + timedelta(microseconds=time_ns // 1000)
    return time.isoformat(timespec="microseconds").replace("+00:00", "Z")
