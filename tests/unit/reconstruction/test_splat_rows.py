"""Rows of PLY files in native code, compared with structured arrays and Python's own numbers."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from alula.stages.reconstruction.formats.splats import color_from_sh0
from support.effort import examples

TYPES = ["i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"]
NAMES = [f"c{i}" for i in range(14)]


def outputs(count):
    shapes = [(count, 3), (count, 3), (count, 4), (count,), (count, 3)]
    return [np.zeros(shape, np.uint8 if i == 4 else np.float32) for i, shape in enumerate(shapes)]


def table(count, order, types, seed=0, gap=0):
    """Random rows, with `gap` bytes between neighbouring columns."""
    rng = np.random.default_rng(seed)
    offsets = np.cumsum([0, *(np.dtype(t).itemsize + gap for t in types)])
    dtype = np.dtype(
        {
            "names": NAMES,
            "formats": [order + t for t in types],
            "offsets": offsets[:-1],
            "itemsize": offsets[-1],
        }
    )
    rows = np.zeros(count, dtype)
    for name, code in zip(NAMES, types, strict=True):
        values = rng.normal(size=count) * 2
        rows[name] = np.abs(values) if code[0] == "u" else values
    return rows, [(int(offset), code) for offset, code in zip(offsets, types, strict=False)]


def decode(rows, places, color="harmonic", big_endian=False, **options):
    made = outputs(len(rows))
    raw = np.frombuffer(rows.tobytes(), np.uint8)
    _core.decode_ply_rows(raw, rows.dtype.itemsize, big_endian, places, color, *made, **options)
    return made


def expected(rows):
    value = np.stack([rows[name].astype(np.float64) for name in NAMES], axis=1)
    scale = _core.portable_exp(value[:, 3:6].ravel())
    opacity = _core.portable_logistic(value[:, 10].copy())
    single = value.astype(np.float32)
    return [
        single[:, :3],
        scale.astype(np.float32).reshape(-1, 3),
        single[:, 6:10],
        opacity.astype(np.float32),
        color_from_sh0(value[:, 11:]),
    ]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("shift", range(8))
def test_every_type_in_every_place_is_read(order, shift):
    types = [TYPES[(i + shift) % 8] for i in range(14)]
    rows, places = table(301, order, types, gap=shift % 3)
    for got, wanted in zip(decode(rows, places, big_endian=order == ">"), expected(rows), strict=True):
        np.testing.assert_array_equal(got, wanted)


def test_threads_do_not_change_a_bit():
    rows, places = table(40_001, "<", ["f4"] * 14)
    one = decode(rows, places, jobs=1)
    for jobs in (2, 5):
        for got, wanted in zip(decode(rows, places, jobs=jobs), one, strict=True):
            assert got.tobytes() == wanted.tobytes()


def test_colours_are_those_of_the_other_formats_at_ties_and_ends():
    halves = ((np.arange(256) + 0.5) / 255 - 0.5) / 0.28209479177387814
    values = np.concatenate([halves, np.nextafter(halves, 9), [np.nan, np.inf, -np.inf, 9, -9, 0.0]])
    rows, places = table(len(values), "<", ["f8"] * 14)
    rows["c12"] = values
    np.testing.assert_array_equal(decode(rows, places)[4][:, 1], color_from_sh0(values))


def test_bytes_and_missing_columns():
    rows, places = table(300, "<", ["f4"] * 11 + ["u1"] * 3)
    for i in range(3):
        rows[f"c{11 + i}"] = np.arange(300) % 256
    np.testing.assert_array_equal(decode(rows, places, "bytes")[4][:, 1], np.arange(300) % 256)
    places[5] = None
    made = decode(rows, [*places[:11], None, None, None], "grey")
    assert (made[4] == 128).all()
    assert (made[1][:, 2] == 0).all()
    assert (made[1][:, :2] > 0).all()


def test_misuse_is_refused():
    rows, places = table(5, "<", ["f4"] * 14)
    raw, size = np.frombuffer(rows.tobytes(), np.uint8), rows.dtype.itemsize
    with pytest.raises(ValueError, match="fewer bytes"):
        _core.decode_ply_rows(raw[:-1], size, False, places, "harmonic", *outputs(5))
    with pytest.raises(ValueError, match="outside the row"):
        decode(rows, [(size - 3, "f4"), *places[1:]])
    with pytest.raises(ValueError, match="column is missing"):
        decode(rows, [None, *places[1:]])
    with pytest.raises(ValueError, match="no PLY file has"):
        decode(rows, [(0, "c8"), *places[1:]])
    with pytest.raises(ValueError, match="another length"):
        _core.decode_ply_rows(raw, size, False, places, "harmonic", *outputs(5)[:4], outputs(4)[4])
    doubles = [array.astype(np.float64) for array in outputs(5)]
    with pytest.raises(TypeError):  # a copy would be written instead
        _core.decode_ply_rows(raw, size, False, places, "harmonic", *doubles)


def parse(text, count, width=14, places=None):
    raw = np.frombuffer(text.encode("latin-1"), np.uint8)
    lines, trailing = _core.find_lines(raw, count)
    made = outputs(len(lines))
    places = places or [(i, "f8") for i in range(14)]
    return _core.decode_ply_text(raw, lines, width, places, "harmonic", *made), made, lines, trailing


def value_of(word):
    """The number that a word in the first place is read as; None for a refused one."""
    wrong, made, _, _ = parse(word + " 0" * 13, 1)
    if wrong is not None:
        assert wrong == (0, 14, 0, len(word))
        return None
    return float(made[0][0, 0])


@settings(max_examples=examples(300), deadline=None)
@given(
    st.floats(width=32) | st.floats(), st.sampled_from(["{!r}", "{:.3e}", "+{!r}", "{:.40f}", "{:E}", "{:g}"])
)
def test_numbers_are_read_as_python_reads_them(value, form):
    word = form.format(value).replace("+-", "-")
    with np.errstate(over="ignore"):
        wanted = np.float32(float(word))
    np.testing.assert_array_equal(value_of(word), wanted)


WORDS = [
    "1.", ".5", "-.5e1", "+0", "-0", "1e5", "1E+05", "1e-400", "-1e400", "1e999999999999999999999", "0e999",
    "0.000e-99999999999", "1e-99999999999", "inf", "-INF", "Infinity", "+nan", "NaN", "00012", "1" * 400,
    "0." + "0" * 400 + "1", "0." + "0" * 400 + "1e401", "4.9e-324", "2.4e-324", "1.7976931348623159e308",
    "9007199254740993", "1e22", "8.98846567431158e307",
]  # fmt: skip
NO_WORDS = [
    "", ".", "+", "-", "e5", "1e", "1e+", "1e5.0", "--1", "+-1", "1..2", "0x10", "1,5", "1f", "1d0", "nan(1)",
    "infin", "in", "1__0", "_1", "1e1e1", "\x00", "1\x00", "\xb2", "NULL", "n\x01n", "\x49\x6e\x47",
]  # fmt: skip


@pytest.mark.parametrize("word", WORDS)
def test_odd_spellings_of_numbers_are_read(word):
    with np.errstate(over="ignore"):
        np.testing.assert_array_equal(value_of(word), np.float32(float(word)))


@pytest.mark.parametrize("word", [word for word in NO_WORDS if word])
def test_what_is_no_number_is_refused_also_where_nothing_reads_it(word):
    assert value_of(word) is None
    with pytest.raises(ValueError):
        float(word)
    wrong, *_ = parse("0 " * 14 + word, 1, width=15)
    assert wrong == (0, 15, 28, 28 + len(word))


def test_python_reads_underscores_and_we_do_not():
    assert float("1_0") == 10
    assert value_of("1_0") is None


def test_blank_lines_and_all_white_space_between_words_do_not_count():
    row = "\t1 2\v3\f4  " + " ".join(["0"] * 10)
    wrong, made, lines, trailing = parse(f"\n \r\n{row}\r\n\n{row} \r\n\t\n5 6\n7", 2)
    assert wrong is None
    assert len(lines) == 2
    assert trailing == len("5 6\n7") + 1
    np.testing.assert_array_equal(made[0], [[1, 2, 3]] * 2)


def test_the_first_wrong_row_is_named_whatever_the_threads():
    good, few, bad = " 1" * 14 + "\n", " 1" * 13 + "\n", " 1" * 13 + " x\n"
    for rows, wanted in (
        ([good] * 5000 + [few] + [bad] * 9000, (5000, 13)),
        ([good] * 9999 + [bad] + [few], (9999, 14)),
        ([good] * 3 + [" 1" * 20 + "\n"], (3, 20)),
        ([" x" * 15 + "\n"], (0, 15)),
    ):
        for _ in range(3):
            assert parse("".join(rows), len(rows))[0][:2] == wanted


def test_text_and_binary_rows_give_the_same_bits():
    rows, places = table(3000, "<", ["f4"] * 14)
    text = "\n".join(" ".join(repr(float(value)) for value in row) for row in rows)
    wrong, made, _, _ = parse(text, 3000)
    assert wrong is None
    for got, wanted in zip(made, decode(rows, places), strict=True):
        assert got.tobytes() == wanted.tobytes()


def test_text_misuse_is_refused():
    raw = np.frombuffer(b"1 " * 14, np.uint8)
    places = [(i, "f8") for i in range(14)]
    with pytest.raises(ValueError, match="outside the text"):
        _core.decode_ply_text(raw, np.array([99], np.uint64), 14, places, "harmonic", *outputs(1))
    with pytest.raises(ValueError, match="outside the row"):
        _core.decode_ply_text(raw, np.array([0], np.uint64), 13, places, "harmonic", *outputs(1))


def test_the_nearest_double_is_rounded_once():
    # Halfway between singles in decimal: through a double it is a tie and goes to even, as numpy does.
    word = "1.000000059604644775390625"
    assert value_of(word) == np.float32(float(word)) == 1.0
    assert math.isnan(value_of("-nan"))
