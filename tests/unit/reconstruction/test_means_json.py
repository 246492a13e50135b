"""The JSON of SAFER-Splat: two dialects, values that are not numbers, and rows that do not fit."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.schemas.errors import AlulaError, ArtifactError
from alula.stages.reconstruction.formats import means_json
from alula.stages.reconstruction.formats.means_json import decode_means_json
from alula.stages.reconstruction.formats.registry import SplatFile, read_splats
from alula.stages.rotation import matrix_from_quat_wxyz
from support.effort import examples


def lists(count=40, seed=0):
    """What SAFER-Splat's loader takes, in single precision."""
    rng = np.random.default_rng(seed)
    values = {
        "means": rng.normal(size=(count, 3)),
        "rotations": rng.normal(size=(count, 4)),
        "colors": rng.uniform(size=(count, 3)),
        "opacities": rng.normal(size=(count, 1)),
        "scalings": rng.normal(-3, 1, size=(count, 3)),
    }
    return {key: value.astype(np.float32).astype(np.float64) for key, value in values.items()}


def decode(values, **options):
    text = json.dumps(
        {k: v if isinstance(v, str | list) else v.tolist() for k, v in values.items()}, **options
    )
    return decode_means_json(memoryview(text.encode()))


def sigmoid(values):
    return 1 / (1 + np.exp(-np.asarray(values, np.float64)))


@pytest.mark.parametrize(
    "options", [{}, {"indent": 4}, {"separators": (",", ":")}, {"indent": "\t", "sort_keys": True}]
)
def test_quaternions_mean_logarithms_and_logits(options):
    values = lists()
    splats = decode(values, **options)
    np.testing.assert_array_equal(splats.mean, values["means"])
    np.testing.assert_array_equal(splats.quat_wxyz, values["rotations"])
    np.testing.assert_array_equal(splats.scale, np.exp(values["scalings"]).astype(np.float32))
    np.testing.assert_array_equal(splats.opacity, sigmoid(values["opacities"][:, 0]).astype(np.float32))
    np.testing.assert_array_equal(splats.color, np.rint(values["colors"] * 255))
    assert splats.loss is None
    assert splats.notes == (
        "quaternions: scalings are logarithms, opacities logits, as SAFER-Splat's loader reads",
    )


def test_quaternions_with_values_that_could_be_plain_are_noted_and_never_read_smaller():
    values = lists()
    values |= {"scalings": np.exp(values["scalings"]), "opacities": sigmoid(values["opacities"])}
    splats = decode(values)
    assert "could be plain values as well" in splats.notes[0]
    assert (splats.scale > values["scalings"]).all()


def test_matrices_mean_plain_values():
    values = lists()
    unit = values["rotations"] / np.linalg.norm(values["rotations"], axis=1, keepdims=True)
    values |= {"scalings": np.exp(values["scalings"]), "opacities": sigmoid(values["opacities"])}
    values["rotations"] = matrix_from_quat_wxyz(unit).astype(np.float32).astype(np.float64)
    splats = decode(values)
    np.testing.assert_array_equal(splats.scale, values["scalings"].astype(np.float32))
    np.testing.assert_array_equal(splats.opacity, values["opacities"][:, 0].astype(np.float32))
    read = matrix_from_quat_wxyz(splats.quat_wxyz / np.linalg.norm(splats.quat_wxyz, axis=1, keepdims=True))
    np.testing.assert_allclose(read, values["rotations"], atol=3e-7)
    half = splats.quat_wxyz * np.sign((splats.quat_wxyz * unit).sum(axis=1, keepdims=True)) - unit
    assert (4 * np.arcsin(np.linalg.norm(half, axis=1) / 2) <= splats.loss.bound[:, 2]).all()
    assert 0 < splats.loss.bound[:, 2].max() < 2e-6
    assert splats.loss.unbounded == {}
    assert splats.notes == ("rotation matrices: scalings and opacities are plain",)
    values |= {"scalings": np.log(values["scalings"]), "opacities": values["opacities"] + 3}
    splats = decode(values)
    np.testing.assert_allclose(splats.scale, np.exp(values["scalings"]), rtol=1e-6)
    assert "read as logarithms and logits" in splats.notes[0]


def test_the_angle_of_coarse_matrices_is_recorded():
    rng = np.random.default_rng(0)
    values = lists(2000)
    unit = rng.normal(size=(2000, 4))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    values["rotations"] = np.round(matrix_from_quat_wxyz(unit), 4)
    splats = decode(values)
    read = splats.quat_wxyz.astype(np.float64)
    read /= np.linalg.norm(read, axis=1, keepdims=True)
    chord = np.minimum(np.linalg.norm(read - unit, axis=1), np.linalg.norm(read + unit, axis=1))
    angle = 4 * np.arcsin(chord / 2)
    bound = splats.loss.bound[:, 2].astype(np.float64)
    assert (angle <= bound).mean() > 0.97
    assert (angle / bound).max() > 0.3
    assert "rounded" in splats.loss.unbounded["rotation"]
    values["rotations"][7] *= 1.1
    with pytest.raises(ArtifactError, match="JSON: 'rotations', row 7 is no rotation matrix"):
        decode(values)
    values["rotations"][7] = np.diag([1, 1, -1])
    with pytest.raises(ArtifactError, match="row 7 is no rotation matrix"):
        decode(values)


def test_opacities_may_be_a_flat_list_and_colours_may_be_missing_or_bytes():
    values = lists()
    plain = decode(values)
    np.testing.assert_array_equal(
        decode(values | {"opacities": values["opacities"][:, 0]}).opacity, plain.opacity
    )
    grey = decode({key: value for key, value in values.items() if key != "colors"})
    assert (grey.color == 128).all()
    assert "no colours: grey" in grey.notes
    large = decode(values | {"colors": np.rint(values["colors"] * 255)})
    np.testing.assert_array_equal(large.color, plain.color)


def test_what_is_not_a_number_is_passed_on():
    values = {key: value.tolist() for key, value in lists().items()}
    values["means"][3][1] = float("nan")
    values["scalings"][4][0] = float("-inf")
    values["scalings"][5][0] = float("inf")
    values["opacities"][6][0] = None
    values["rotations"][7] = [None] * 4
    values["comment"] = "NaN [, Infinity"
    splats = decode(values)
    assert np.argwhere(np.isnan(splats.mean)).tolist() == [[3, 1]]
    assert splats.scale[4, 0] == 0
    assert np.isinf(splats.scale[5, 0])
    assert np.isnan(splats.opacity[6])
    assert np.isnan(splats.quat_wxyz[7]).all()
    values["rotations"] = [np.eye(3).tolist() for _ in range(40)]
    values["rotations"][9][0][0] = None
    assert np.flatnonzero(np.isnan(decode(values).quat_wxyz[:, 0])).tolist() == [9]


@pytest.mark.parametrize("chunk", [1, 3, 40])
def test_chunks_do_not_matter(monkeypatch, chunk):
    values = lists()
    whole = decode(values, indent=1)
    monkeypatch.setattr(means_json, "_CHUNK", chunk)
    monkeypatch.setattr(means_json, "_SCAN", 7 * chunk)
    pieces = decode(values, indent=1)
    for name in ("mean", "scale", "quat_wxyz", "opacity", "color"):
        np.testing.assert_array_equal(getattr(pieces, name), getattr(whole, name))
    values["means"] = values["means"].tolist()
    values["means"][17] = [1, 2]
    with pytest.raises(ArtifactError, match=r"JSON: 'means', row 1[567]"):
        decode(values)


def put(key, value):
    return lambda values: values.__setitem__(key, value)


def row(key, index, value):
    return lambda values: values[key].__setitem__(index, value)


WRONG = {
    "short row": (row("means", 5, [1, 2]), "'means', row 5 has 2 numbers, row 0 3"),
    "long row": (row("rotations", 39, [1, 2, 3, 4, 5]), "'rotations', row 39 has 5 numbers, row 0 4"),
    "nested row": (row("means", 2, [[1], 2, 3]), "'means', row 2: Expected `float . null`, got `array`"),
    "text": (row("scalings", 3, ["1", 2, 3]), "'scalings', row 3: Expected"),
    "number as row": (row("scalings", 3, 1), "'scalings' has 39 rows, 'means' 40"),
    "columns": (put("means", [[1, 2]] * 40), r"'means', row 0 is of shape \(2,\), not of 3 numbers"),
    "rotation columns": (put("rotations", [[1] * 3] * 40), "not of 4 or 3 by 3 numbers"),
    "not a list": (put("means", "[[1,2,3]]"), "'means' is not a list"),
    "counts": (put("means", [[1, 2, 3]] * 39), "'rotations' has 40 rows, 'means' 39"),
    "empty": (lambda values: values.update({key: [] for key in values}), "has no Gaussians"),
    "empty rows": (put("means", [[]] * 40), "'means', row 0 is of shape"),
    "missing": (lambda values: values.pop("scalings"), "need 'scalings', which is missing"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_refused_by_name(name):
    change, message = WRONG[name]
    values = {key: value.tolist() for key, value in lists().items()}
    change(values)
    with pytest.raises(ArtifactError, match=f"^JSON: .*{message}") as error:
        decode(values)
    assert "\n" not in str(error.value)


def test_broken_text_is_refused():
    good = json.dumps({key: value.tolist() for key, value in lists(3).items()}).encode()
    for raw in (good[:-1], good + b"x", b"{" + good, b"[]", b"", b"\xff", b'{"means":' + b"[" * 10**5,
                good.replace(b"]]", b"]", 1), good.replace(b"[[", b"[1e999,[", 1)):  # fmt: skip
        with pytest.raises(ArtifactError, match=r"^JSON: "):
            decode_means_json(memoryview(raw))
    bom = decode_means_json(memoryview(b"\xef\xbb\xbf" + good))
    assert len(bom) == 3


def test_the_content_tells_the_format(tmp_path):
    path = tmp_path / "gaussians.json"
    path.write_text(json.dumps({key: value.tolist() for key, value in lists().items()}, indent=4))
    assert SplatFile.find(path).format.name == "json"
    assert len(read_splats(path)) == 40
    path.write_text(json.dumps({"version": 2, "count": 3, "means": {"mins": [0, 0, 0]}}))
    with pytest.raises(ArtifactError):
        read_splats(path)


BASE = json.dumps({key: value.round(2).tolist() for key, value in lists(4).items()}).encode()
TOKENS = (
    b"[",
    b"]",
    b",",
    b"null",
    b"NaN",
    b"-Infinity",
    b"1e999",
    b'"',
    b"{",
    b"}",
    b"0",
    b" ",
    b"-",
    b"\xff",
)


@settings(max_examples=examples(500), deadline=None)
@given(st.data())
def test_any_change_of_text_is_read_or_refused(data):
    raw = bytearray(BASE)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(raw)))
        raw[at : at + data.draw(st.integers(0, 3))] = data.draw(
            st.sampled_from(TOKENS) | st.binary(max_size=2)
        )
    lines = 0
    try:
        splats = decode_means_json(memoryview(bytes(raw)))
    except AlulaError as error:
        lines = str(error).count("\n")
    else:
        assert len(splats) > 0
    assert lines == 0


def test_what_single_precision_rounds_is_within_the_bound():
    rng = np.random.default_rng(5)
    values = lists() | {"means": rng.normal(size=(40, 3)) * 1e5, "scalings": rng.normal(-6, 1, size=(40, 3))}
    splats = decode(values)
    bound = splats.loss.bound.astype(np.float64)
    away = np.linalg.norm(splats.mean.astype(np.float64) - values["means"], axis=1)
    assert (away <= bound[:, 0]).all()
    assert away.max() > 0.3 * bound[0, 0] > 0
    longer = (np.exp(values["scalings"]) / splats.scale - 1).max(axis=1)
    assert (longer <= bound[:, 1] + 2**-23).all()
    assert not bound[:, 2].any()


@pytest.mark.parametrize("first", ["means", "rotations", "scalings", "opacities", "colors"])
def test_the_lists_may_come_in_any_order(tmp_path, first):
    """The first one alone is longer than what formats are told by."""
    values = lists(2000)
    order = sorted(values, key=lambda key: key != first)
    path = tmp_path / "a.json"
    path.write_text(json.dumps({key: values[key].tolist() for key in order}))
    assert SplatFile.find(path).format.name == "json"
    path.write_text(json.dumps({"colors": values["colors"].tolist()}))
    with pytest.raises(ArtifactError, match="not a splat file"):
        SplatFile.find(path)
