"""SPZ: no statement of a header is trusted without a check."""

import gzip
import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.schemas.errors import AlulaError, ArtifactError
from alula.stages.reconstruction.formats.registry import read_splats
from alula.stages.reconstruction.formats.splats import SH_C0
from support.effort import examples
from support.files.spz_files import (
    ORDER,
    arrays_of,
    data,
    file_of,
    read,
    record,
)


def valid(version=3, count=5, **options):
    return file_of(version, count, arrays_of(np.random.default_rng(0), version, count), **options)


def patched(raw, at, fmt, *values):
    raw = bytearray(raw)
    struct.pack_into(fmt, raw, at, *values)
    return bytes(raw)


V4 = valid(4)
REFUSED = {
    "neither gzip nor NGSP": b"PSGN" + bytes(40),
    "6 bytes hold no header": b"NGSP\3\0",
    "12 bytes hold no header": gzip.compress(b"NGSP" + bytes(8)),
    "does not begin with NGSP": valid(magic=b"NGSQ"),
    "version 0; this program reads 1 to 4": gzip.compress(b"NGSP" + bytes(40)),
    "version 5;": gzip.compress(patched(valid(container="raw"), 4, "<I", 5)),
    "version 4 inside gzip": gzip.compress(V4),
    "degree 5; the format has 0 to 4": gzip.compress(patched(valid(container="raw"), 12, "B", 5)),
    "25 fractional bits": valid(bits=25),
    "has no Gaussians": gzip.compress(patched(valid(container="raw"), 8, "<I", 0)),
    "does not hold 4294967295 Gaussians": gzip.compress(patched(valid(container="raw"), 8, "<I", 2**32 - 1)),
    "6 Gaussians of degree 0 need 136 bytes, there are 116": gzip.compress(
        patched(valid(container="raw"), 8, "<I", 6)
    ),
    "5 Gaussians of degree 3 need 341": gzip.compress(patched(valid(container="raw"), 12, "B", 3)),
    "gzip stream has no end": valid()[:-9],
    "stream: incorrect data check": patched(valid(), len(valid()) - 8, "<I", 1),
    "stream: incorrect length check": patched(valid(), len(valid()) - 4, "<I", 1),
    "stream: unknown compression method": patched(valid(), 2, "B", 3),
    "bytes follow the data": gzip.compress(valid(container="raw") + bytes(2**21)),
    "more than 65536 gzip members": gzip.compress(b"") * 65537,
    "31 bytes hold no header of version 4": V4[:31],
    "6 streams; degree 0 has 5": patched(V4, 15, "B", 6),
    "file of 188 bytes does not hold 30000 G": patched(V4, 8, "<I", 30000)[:188],
    "the table of streams at byte 4294967295": patched(V4, 16, "<I", 2**32 - 1),
    "the table of streams at byte 31": patched(V4, 16, "<I", 31),
    "6 Gaussians need 54 bytes of positions, not 45": patched(V4, 8, "<I", 6),
    "need 45 bytes of positions, not 18446744073709551615": patched(V4, 40, "<Q", 2**64 - 1),
    "18446744073709551615 bytes of positions announced": patched(V4, 32, "<Q", 2**64 - 1),
    "bytes of rotations announced, there are": V4[:-1],
    "positions is no zstd frame": patched(V4, 112, "<I", 0),
}  # fmt: skip


@pytest.mark.parametrize("said", REFUSED)
def test_what_is_wrong_is_said(said):
    with pytest.raises(ArtifactError, match=f"^SPZ: .*{said}"):
        read(REFUSED[said])


def with_frame(name, frame):
    """Version 4, five Gaussians, one frame replaced."""
    import zstandard

    arrays = arrays_of(np.random.default_rng(0), 4, 5)
    frames = {key: zstandard.compress(arrays[key]) for key in ORDER[:5]} | {name: frame}
    table = b"".join(struct.pack("<QQ", len(frames[key]), len(arrays[key])) for key in ORDER[:5])
    head = struct.pack("<4sIIBBBBI12x", b"NGSP", 4, 5, 0, 12, 0, 5, 32)
    return head + table + b"".join(frames[key] for key in ORDER[:5])


def unsized(raw):
    import zstandard

    return zstandard.ZstdCompressor(write_content_size=False).compress(raw)


def test_frames_that_hold_something_else_are_refused():
    import zstandard

    good = read(with_frame("alphas", unsized(bytes(5))))
    np.testing.assert_array_equal(good.opacity, 0)
    with pytest.raises(ArtifactError, match="frame of alphas holds 6 bytes, not 5"):
        read(with_frame("alphas", zstandard.compress(bytes(6))))
    with pytest.raises(ArtifactError, match="alphas inflates to more than 5 bytes"):
        read(with_frame("alphas", unsized(bytes(6))))
    with pytest.raises(ArtifactError, match="alphas inflates to 4 bytes, not 5"):
        read(with_frame("alphas", unsized(bytes(4))))
    with pytest.raises(ArtifactError, match=r"alphas inflates to [0-4] bytes, not 5"):
        read(with_frame("alphas", zstandard.compress(bytes(5))[:-2]))
    checked = zstandard.ZstdCompressor(write_checksum=True).compress(bytes(5))
    with pytest.raises(ArtifactError, match="damaged zstd frame of alphas"):
        read(with_frame("alphas", checked[:-1] + bytes([checked[-1] ^ 1])))


def test_bombs_are_not_inflated():
    bomb = unsized(bytes(2**28))
    raws = [with_frame("alphas", bomb), gzip.compress(valid(container="raw") + bytes(2**26), 9)]
    raws.append(gzip.compress(patched(valid(container="raw"), 8, "<I", 2**24), 9) + bytes(2**18))
    tracemalloc.start()
    for raw in raws:
        with pytest.raises(ArtifactError):
            read(raw)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**24


def seed(version, container):
    arrays = arrays_of(np.random.default_rng(version), version, 4, 1)
    frame = record(0xADBE0003, b"\4\0\0\0")
    return file_of(version, 4, arrays, degree=1, flags=2, extensions=frame, container=container)


SEEDS = [seed(1, "raw"), seed(2, "raw"), seed(2, "gzip"), seed(3, "raw"), seed(4, "zstd")]


@settings(max_examples=examples(400), deadline=None)
@given(
    st.sampled_from(SEEDS),
    st.lists(st.tuples(st.integers(0, 400), st.integers(0, 255)), max_size=4),
    st.integers(0, 400),
    st.booleans(),
)
def test_any_bytes_are_gaussians_or_refused(raw, changes, length, compress):
    changed = bytearray(raw)
    for at, value in changes:
        changed[at % len(changed)] = value
    changed = changed[:length] if length < 300 else changed
    changed = gzip.compress(changed) if compress else bytes(changed)
    try:
        found = read(changed)
    except AlulaError as error:
        found = error
    if isinstance(found, AlulaError):
        assert str(found).startswith("SPZ: ")
        assert "\n" not in str(found)
    else:
        assert len(found) * 16 <= 2 * len(changed) * 1100
        assert np.isfinite(found.loss.bound).all()


FIXTURES = {
    "bad-crc-v2": "incorrect data check",
    "bad-fhcrc-v2": "header crc mismatch",
    "bad-isize-v2": "incorrect length check",
    "corrupt-deflate": "invalid block type",
    "count-exceeds-stream-v2": "truncated: a file of 55 bytes does not hold 1000000",
    "empty-points-v2": "has no Gaussians",
    "gzip-not-spz": "does not begin with NGSP",
    "huge-count-v2": "truncated: a file of 32 bytes does not hold 2147483648",
    "not-spz": "not a splat file",
    "plaintext-v4": "table of streams at byte 32 is not within",
    "sh-degree-5-v2": "degree 5",
    "short-stream": "10 bytes hold no header",
    "truncated-deflate-v2": "truncated",
    "truncated-gzip-header": "truncated",
    "truncated-payload-v2": "3 Gaussians of degree 0 need 73 bytes, there are 46",
    "version-0": "version 0",
    "version-5": "version 5",
}
NOTED = {
    "extensions-v2": "8 bytes follow",
    "plaintext-v2": "not compressed",
    "trailing-after-member-v2": "8 bytes follow",
    "trailing-decompressed-v2": "6 bytes follow",
}


def test_public_fixtures_are_read_or_refused_as_their_names_say():
    paths = sorted(data("usd3dgs-fixtures-spz").glob("*.spz"))
    assert len(paths) == 35
    for path in paths:
        if path.stem in FIXTURES:
            with pytest.raises(ArtifactError, match=FIXTURES[path.stem]):
                read_splats(path)
            continue
        found = read_splats(path)
        said = [note for note in found.notes[1:] if note not in found.loss.unbounded.values()]
        assert len(said) == (path.stem in NOTED)
        assert NOTED.get(path.stem, "") in " ".join(said)
        if path.stem.startswith("minimal") or path.stem in NOTED:
            assert len(found) == 1
    golden = read_splats(data("usd3dgs-fixtures-spz/decode-degree1-v2.spz"))
    np.testing.assert_array_equal(golden.mean, [[1, 2, -0.5], [-3, 0.25, 4]])
    np.testing.assert_allclose(
        golden.scale, [[1, 2.7182817, 0.36787945], [1.6487212, 0.60653067, 1]], rtol=1e-6
    )
    np.testing.assert_allclose(golden.opacity, [0.8, 0.6], rtol=1e-6)
    expected = [
        [0.99997693, 0.003921628, 0.003921628, 0.003921628],
        [0.7043775, 0.70980394, 0.003921628, 0.003921628],
    ]
    np.testing.assert_allclose(golden.quat_wxyz, expected, atol=1e-7)
    sh0 = np.array([[0.013072093, 0.50980407, -0.5098039], [0.9019609, -0.9019607, 0.013072093]])
    np.testing.assert_array_equal(golden.color, np.rint(255 * (0.5 + SH_C0 * sh0)))


def test_zlib_of_a_stream_without_header_is_no_spz():
    with pytest.raises(ArtifactError, match="neither gzip nor NGSP"):
        read(zlib.compress(valid(container="raw")))
