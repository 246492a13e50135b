"""Logs that are cut, damaged or made to be too much: what is said about them, and what is still read."""

import io
import shutil
from pathlib import Path

import pytest
import zstandard

from alula.cli.main import run
from alula.schemas.errors import DamagedError
from alula.schemas.log.flights import count_messages, read_flights
from alula.schemas.log.mcap import entries
from alula.schemas.log.run import read_run

CHUNK = 6


@pytest.fixture
def log(pipeline, tmp_path) -> Path:
    return Path(shutil.copy(pipeline / "tiny.run.mcap", tmp_path))


def test_a_cut_log_says_where_it_ends_wherever_it_is_cut(log, capsys):
    raw = log.read_bytes()
    for part in range(1, 40):
        end = len(raw) * part // 40
        log.write_bytes(raw[:end])
        assert run(["info", str(log)]) == 3
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert f"byte {end}" in said
        assert "opcode" not in said
        assert all(int(word) <= len(raw) for word in said.replace(",", " ").split() if word.isdecimal())


def test_zeros_after_a_power_cut_are_no_records(log):
    raw = log.read_bytes()
    log.write_bytes(raw[: len(raw) // 2] + bytes(len(raw) // 2))
    with pytest.raises(DamagedError, match=r"truncated or corrupt MCAP log \(.*byte"):
        read_run(log)
    assert not count_messages(log)[1]


def test_messages_and_counts_are_those_of_the_reference_reader(log):
    from mcap.reader import make_reader

    with log.open("rb") as file:
        wanted = [
            (channel.topic, message.data)
            for _, channel, message in make_reader(file).iter_messages(log_time_order=False)
        ]
        file.seek(0)
        found = [(name, data) for kind, name, data in entries(file) if kind == "message"]
    assert found == wanted
    counts, whole = count_messages(log)
    assert whole
    assert sum(counts.values()) == len(wanted)


def with_chunk(log: Path, data: bytes, uncompressed: int, compression: str) -> None:
    """Put a chunk in front of the others."""
    raw = log.read_bytes()
    at = next(
        i
        for i in range(8, len(raw))
        if raw[i] == CHUNK and 0 < int.from_bytes(raw[i + 1 : i + 9], "little") < len(raw)
    )
    word = compression.encode()
    body = bytes(16) + uncompressed.to_bytes(8, "little") + bytes(4)
    body += len(word).to_bytes(4, "little") + word + len(data).to_bytes(8, "little") + data
    log.write_bytes(raw[:at] + bytes([CHUNK]) + len(body).to_bytes(8, "little") + body + raw[at:])


@pytest.mark.parametrize(
    ("data", "size", "compression", "words"),
    [
        (zstandard.compress(bytes(2**28)), 2**28, "zstd", "too large for a log of this size"),
        (zstandard.compress(bytes(2**28)), 1000, "zstd", "longer than it says"),
        (b"x", 2**63, "", "too large for a log of this size"),
        (b"x", 5, "", "not 5 as it says"),
        (b"x", 1, "brotli", "unknown"),
    ],
)
def test_a_chunk_that_grows_too_much_is_refused(log, data, size, compression, words):
    with_chunk(log, data, size, compression)
    with pytest.raises(DamagedError, match=words):
        read_flights(log)


def test_lz4_that_grows_beyond_what_it_says_is_refused(log):
    import lz4.frame

    stream = io.BytesIO()
    with lz4.frame.open(stream, "wb") as packed:
        for _ in range(256):
            packed.write(bytes(2**20))
    with_chunk(log, stream.getvalue(), 1000, "lz4")
    with pytest.raises(DamagedError, match="not 1000 as it says"):
        read_flights(log)
