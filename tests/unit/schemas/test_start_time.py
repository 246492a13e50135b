"""Times of the start of a flight, as text and as log times."""

import pytest

from alula.schemas.errors import UsageError
from alula.schemas.log.start_time import start_time_ns, utc_text


@pytest.mark.parametrize(
    ("text", "time_ns"),
    [
        ("1970-01-01T00:00:00Z", 0),
        ("2000-01-01T00:00:00Z", 946_684_800 * 10**9),
        ("2026-05-01T14:00:00.123456+02:00", 1_777_636_800_123_456_000),
    ],
)
def test_a_time_with_its_zone_is_a_log_time(text, time_ns):
    assert start_time_ns(text) == time_ns
    assert start_time_ns(utc_text(time_ns)) == time_ns
    assert utc_text(time_ns).endswith("Z")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("noon", "no time like"),
        ("1e9", "no time like"),
        ("2026-05-01T12:00:00", "no time zone"),
        ("1969-12-31T23:59:59Z", "not within 1970 to 2037"),
        ("2038-01-01T00:00:00Z", "not within 1970 to 2037"),
    ],
)
def test_any_other_text_is_refused(text, words):
    with pytest.raises(UsageError, match=words):
        start_time_ns(text)
