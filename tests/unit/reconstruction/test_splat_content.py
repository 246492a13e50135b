"""Recognition of `.splat` by its content: what writers make is taken, and nothing else is."""

import base64

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.schemas.errors import ArtifactError
from alula.stages.reconstruction.formats.registry import read_splats
from alula.stages.reconstruction.formats.splat import RECORD
from alula.stages.reconstruction.formats.splat_content import LEAST, has_plausible_records
from support.effort import examples
from support.files import splat_files

WRITERS = {
    "truncated, middle 128": lambda q: np.clip(q * 128 + 128, 0, 255),
    "rounded, middle 128": lambda q: np.clip(np.rint(q * 128 + 128), 0, 255),
    "rounded, middle 127.5": lambda q: np.rint((q + 1) * 127.5),
    "truncated, middle 127.5": lambda q: (q + 1) * 127.5,
}


def records(count, seed=0, write=WRITERS["rounded, middle 128"], size=1.0):
    """Rows as a writer makes them, of random Gaussians."""
    rng = np.random.default_rng(seed)
    rows = np.zeros(count, RECORD)
    rows["mean"], rows["scale"] = rng.normal(0, size, (count, 3)), size * rng.lognormal(-4, 1, (count, 3))
    rows["rgba"] = rng.integers(0, 256, (count, 4))
    quat = rng.normal(size=(count, 4))
    rows["quat"] = write(quat / np.linalg.norm(quat, axis=1, keepdims=True))
    return rows


def is_taken(rows):
    return has_plausible_records(memoryview(rows if isinstance(rows, bytes) else rows.tobytes()))


@pytest.mark.parametrize("writer", WRITERS)
@settings(max_examples=examples(100), deadline=None)
@given(count=st.integers(LEAST, 2000), seed=st.integers(0, 2**32), size=st.floats(1e-3, 1e4))
def test_files_of_all_writers_that_normalise_are_taken(writer, count, seed, size):
    assert is_taken(records(count, seed, WRITERS[writer], size))


def test_a_length_that_a_writer_changed_most_is_taken():
    assert is_taken(records(8, 3_181_589_821, WRITERS["rounded, middle 128"]))


def test_a_file_is_read_under_any_name_and_alike(tmp_path):
    rows = records(300)
    for name in ("a.splat", "stdin", "b.bin", "c.ply"):
        (tmp_path / name).write_bytes(rows.tobytes())
        splats = read_splats(tmp_path / name)
        assert splats.format == "splat"
        np.testing.assert_array_equal(splats.mean, rows["mean"])


def test_flat_gaussians_and_a_few_broken_rows_are_taken():
    rows = records(1000)
    rows["scale"][:, 2] = 0
    rows["mean"][7], rows["scale"][400], rows["quat"][900] = np.nan, -1, 0
    assert is_taken(rows)


def test_few_records_are_not_enough_but_the_suffix_or_the_option_is(tmp_path):
    few = records(LEAST - 1).tobytes()
    assert not is_taken(few)
    (tmp_path / "few").write_bytes(few)
    with pytest.raises(ArtifactError, match=r"--format splat"):
        read_splats(tmp_path / "few")
    assert len(read_splats(tmp_path / "few", "splat")) == LEAST - 1
    (tmp_path / "few.splat").write_bytes(few)
    assert len(read_splats(tmp_path / "few.splat")) == LEAST - 1


@settings(max_examples=examples(400), deadline=None)
@given(count=st.integers(0, 300), seed=st.integers(0, 2**32), tail=st.integers(0, 31))
def test_random_bytes_are_never_taken(count, seed, tail):
    assert not is_taken(np.random.default_rng(seed).bytes(32 * count + tail * (seed % 2)))


@settings(max_examples=examples(400), deadline=None)
@given(st.binary(min_size=32, max_size=32), st.binary(max_size=64), st.integers(LEAST, 200))
def test_bytes_that_repeat_are_never_taken(row, head, count):
    raw = head + row * count
    assert not is_taken(raw[: len(raw) // 32 * 32])


@settings(max_examples=examples(200), deadline=None)
@given(
    st.sampled_from(["<f4", ">f4", "<f8", "<i4", "<i2", "u1", "<u8"]),
    st.integers(0, 2**32),
    st.sampled_from([1e-3, 1.0, 30.0, 1e4]),
)
def test_tables_of_numbers_are_never_taken(kind, seed, size):
    rng = np.random.default_rng(seed)
    smooth = np.cumsum(rng.normal(size=(512, 8)), axis=0) if seed % 2 else rng.normal(size=(512, 8))
    with np.errstate(invalid="ignore"):
        assert not is_taken(
            (np.abs(size * smooth) if kind[-2] == "u" else size * smooth).astype(kind).tobytes()
        )


@pytest.mark.slow
@settings(max_examples=examples(200), deadline=None)
@given(st.text(min_size=1, max_size=50), st.sampled_from(["utf-8", "utf-16", "utf-32"]), st.integers(40, 300))
def test_text_is_never_taken(text, encoding, times):
    raw = (text * times).encode(encoding)
    assert not is_taken(raw[: len(raw) // 32 * 32])


def test_printed_numbers_are_not_taken():
    rows = records(100)
    assert not is_taken(base64.b64encode(rows.tobytes())[:3200])
    assert not is_taken(
        "".join(f"{x:.5f} {y:.5f} {z:.5f}  @@@@"[:32] for x, y, z in rows["mean"]).encode()[:3200]
    )


@pytest.mark.parametrize("made", [splat_files.ksplat, splat_files.ply, splat_files.spz, splat_files.sog])
def test_files_of_other_formats_are_not_taken(made):
    for raw in made(splat_files.some_gaussians(500)).values():
        assert not is_taken(raw[: len(raw) // 32 * 32])


@pytest.mark.parametrize(
    ("field", "value"),
    [("mean", 1e12), ("mean", np.inf), ("scale", np.nan), ("scale", 1e-30), ("scale", -0.1), ("quat", 128)],
)
def test_each_field_counts(field, value):
    rows = records(200)
    assert is_taken(rows)
    rows[field][::5] = value
    assert not is_taken(rows)


def test_records_that_are_cut_are_not_taken():
    raw = records(200).tobytes()
    assert not is_taken(raw[:-1])
    assert not is_taken(raw[8:-24])  # whole records, but of wrong begin
