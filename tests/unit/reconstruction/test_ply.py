"""INRIA PLY: all known variants, and all kinds of damage."""

import os
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.schemas.errors import AlulaError, ArtifactError
from alula.stages.reconstruction.formats.ply import decode_ply, encode_ply
from alula.stages.reconstruction.formats.registry import read_splats
from alula.stages.reconstruction.formats.splats import SH_C0, Splats, color_from_sh0
from support.effort import examples

COLUMNS = [
    "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity",
    "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
]  # fmt: skip
ORDER = {"<": "binary_little_endian", ">": "binary_big_endian", "": "ascii"}
NAMES = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int"}


def table(rows, columns=COLUMNS, seed=0):
    return dict(zip(columns, np.random.default_rng(seed).normal(size=(len(columns), rows)), strict=True))


def ply(
    data, order="<", types=None, newline="\n", extra_header=(), before=b"", after=b"", tail=(), alias=None
):
    """A PLY file written from the format's text, by another way than the encoder's."""
    types = types or {}
    rows = len(next(iter(data.values())))
    lines = ["ply", f"format {ORDER[order]} 1.0", *extra_header, f"element vertex {rows}"]
    for name in data:
        code = types.get(name, "f4")
        lines.append(f"property {(alias or NAMES)[code]} {name}")
    header = newline.join([*lines, *tail, "end_header"]) + newline
    if order:
        body = b"".join(
            struct.pack(
                order + {"f4": "f", "f8": "d", "u1": "B", "i4": "i"}[types.get(name, "f4")], values[i]
            )
            for i in range(rows)
            for name, values in data.items()
        )
    else:
        body = "".join(
            " ".join(repr(float(v[i])) for v in data.values()) + newline for i in range(rows)
        ).encode()
    return header.encode() + before + body + after


def decode(raw):
    return decode_ply(memoryview(raw))


def check(splats, data, *, rtol=2e-7):
    f32 = {name: np.asarray(values, np.float32).astype(np.float64) for name, values in data.items()}
    np.testing.assert_array_equal(splats.mean, np.stack([f32[n] for n in "xyz"], 1).astype(np.float32))
    np.testing.assert_allclose(
        splats.scale, np.exp(np.stack([f32[f"scale_{i}"] for i in range(3)], 1)), rtol=rtol
    )
    np.testing.assert_array_equal(splats.quat_wxyz, np.stack([f32[f"rot_{i}"] for i in range(4)], 1))
    np.testing.assert_allclose(splats.opacity, 1 / (1 + np.exp(-f32["opacity"])), rtol=rtol)
    expected = np.clip(0.5 + SH_C0 * np.stack([f32[f"f_dc_{i}"] for i in range(3)], 1), 0, 1) * 255
    assert np.abs(splats.color - expected).max() <= 0.5 + 1e-9


@pytest.mark.parametrize("order", ["<", ">", ""])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_byte_orders_and_line_ends_read_the_same(order, newline):
    data = table(7)
    f32 = {name: values.astype(np.float32) for name, values in data.items()}
    check(decode(ply(f32, order, newline=newline)), data)


def test_more_rows_than_a_chunk_are_all_read():
    rows = 2**17 + 3
    values = np.arange(rows * 14, dtype=np.float32).reshape(rows, 14) % 11 - 5
    raw = ply(dict.fromkeys(COLUMNS, ()), "<").replace(b"vertex 0", b"vertex %d" % rows) + values.tobytes()
    check(decode(raw), dict(zip(COLUMNS, values.T, strict=True)))
    text = "\n".join(" ".join(map(str, row)) for row in values[:9000]) + "\n"
    raw = ply(dict.fromkeys(COLUMNS, ()), "").replace(b"vertex 0", b"vertex 9000") + text.encode()
    check(decode(raw), dict(zip(COLUMNS, values[:9000].T, strict=True)))


def test_columns_are_found_by_name_among_others():
    data = table(5)
    shuffled = {name: data[name] for name in sorted(data, reverse=True)}
    shuffled = {"nx": np.zeros(5), **shuffled, "label": np.arange(5)}
    splats = decode(ply(shuffled, "<", types={"label": "i4"}))
    check(splats, data)


def test_double_columns_are_rounded_and_the_loss_is_named():
    data = table(5)
    splats = decode(ply(data, ">", types=dict.fromkeys(COLUMNS, "f8")))
    loss = np.abs(splats.mean - np.stack([data[n] for n in "xyz"], 1)).max()
    assert 0 < loss <= splats.loss.bound[:, 0].max() < 2e-6
    np.testing.assert_allclose(splats.scale[:, 0], np.exp(data["scale_0"]), rtol=1e-7)
    assert decode(ply(data, "<")).loss is None


@pytest.mark.parametrize("names", [{"f4": "float32", "f8": "float64", "u1": "uint8", "i4": "int32"}])
def test_type_aliases(names):
    data = table(3)
    check(decode(ply(data, "<", alias=names)), data)


def test_elements_before_and_after_are_skipped():
    data = table(3)
    head = ["element camera 2", "property double fx", "property uchar id"]
    tail = ["element extra 1", "property int a"]
    splats = decode(ply(data, "<", extra_header=head, before=b"\xff" * 18, tail=tail, after=b"abcd"))
    check(splats, data)
    assert splats.notes == ()
    ascii_ply = ply(data, "", extra_header=[*head, "property list uchar int l"], before=b"1 2 1 5\n3 4 0\n")
    check(decode(ascii_ply), {n: v.astype(np.float64) for n, v in data.items()})
    with pytest.raises(ArtifactError, match="rows of extra need 4 bytes"):
        decode(ply(data, "<", tail=tail, after=b"ab"))


def test_lists_after_the_vertices_do_not_matter_but_before_them_do():
    data = table(3)
    faces = ["element face 1", "property list uchar int vertex_indices"]
    check(decode(ply(data, "<", tail=faces, after=b"\x01abcd")), data)
    with pytest.raises(ArtifactError, match="element face before vertex has lists"):
        decode(ply(data, "<", extra_header=faces, before=b"\x01abcd"))


def test_2dgs_discs_have_no_thickness():
    data = table(4)
    del data["scale_2"]
    splats = decode(ply(data, "<"))
    assert (splats.scale[:, 2] == 0).all()
    assert (splats.scale[:, :2] > 0).all()
    assert "2DGS" in splats.notes[0]


def test_colours_from_bytes_and_without_any():
    data = {name: values for name, values in table(4).items() if not name.startswith("f_dc")}
    rgb = {"red": [0, 1, 128, 255], "green": [3, 4, 5, 6], "blue": [9, 8, 7, 6]}
    splats = decode(ply(data | rgb, "<", types=dict.fromkeys(rgb, "u1")))
    np.testing.assert_array_equal(splats.color, np.stack(list(rgb.values()), 1))
    grey = decode(ply(data, "<"))
    assert (grey.color == 128).all()
    assert "grey" in grey.notes[0]


def test_comments_become_tags_and_the_last_wins():
    comments = [
        "comment SplatRenderMode: default", "comment splatrendermode: MIP", "comment antialiased 1",
        "comment Vertical Axis: z", "obj_info Generated by a tool", "comment",
    ]  # fmt: skip
    splats = decode(ply(table(1), "<", extra_header=comments))
    assert splats.tags == {
        "render_mode": "MIP", "antialiased": "1", "vertical_axis": "z", "generator": "a tool"
    }  # fmt: skip
    assert splats.comments[1] == "splatrendermode: MIP"


@pytest.mark.parametrize("count", [0, 9, 24, 45, 72])
def test_complete_sets_of_harmonics_are_skipped(count):
    data = table(2)
    rest = {f"f_rest_{i}": np.full(2, i) for i in range(count)}
    check(decode(ply(data | rest, "<")), data)


def test_trailing_bytes_are_noted():
    assert "5 bytes follow" in decode(ply(table(2), "<", after=b"12345")).notes[0]
    assert "4 bytes follow" in decode(ply(table(2), "", after=b"1 2\n")).notes[0]


def without(name):
    return {key: value for key, value in table(2).items() if key != name}


def broken(raw, old, new):
    assert old in raw
    return raw.replace(old, new, 1)


GOOD = ply(table(2), "<")
TEXT = ply(table(2), "")
HUGE = broken(GOOD, b"vertex 2", b"vertex 4000000000")
WRONG = {
    "not PLY": (b"plyx\n" + GOOD, "first line"),
    "carriage returns only": (broken(TEXT, b"\n", b"\r"), "first line|makes no sense"),
    "no end": (GOOD[: GOOD.find(b"end_header")], "end_header"),
    "end only in the data": (b"ply\n" + b"x" * 2**20 + b"\nend_header\n", "end_header"),
    "no format": (broken(GOOD, b"format binary_little_endian 1.0\n", b""), "no line 'format'"),
    "unknown format": (broken(GOOD, b"binary_little_endian", b"binary_middle_endian"), "line 2 makes no"),
    "unknown version": (broken(GOOD, b"endian 1.0", b"endian 2.0"), "line 2 makes no sense"),
    "negative count": (broken(GOOD, b"vertex 2", b"vertex -2"), "line 3 makes no sense"),
    "endless count": (broken(GOOD, b"vertex 2", b"vertex " + b"9" * 5000), "line 3 makes no sense"),
    "unknown type": (broken(GOOD, b"property float x", b"property quad x"), "line 4 makes no sense"),
    "property first": (broken(GOOD, b"element", b"property float x\nelement"), "line 3 makes no sense"),
    "two elements": (broken(GOOD, b"end_header", b"element vertex 2\nend_header"), "makes no sense"),
    "property twice": (broken(GOOD, b"float y", b"float x"), "property x twice"),
    "no vertex": (broken(GOOD, b"element vertex", b"element point"), "no element vertex"),
    "four billion rows": (HUGE, "truncated: 4000000000 rows of vertex need 224000000000 bytes"),
    "four billion lines": (broken(TEXT, b"vertex 2", b"vertex 4000000000"), "truncated"),
    "row missing": (GOOD[:-1], "truncated: 2 rows of vertex need 112 bytes, there are 111"),
    "line missing": (TEXT[: TEXT.rstrip().rfind(b"\n")], "truncated"),
    "word missing": (TEXT[: TEXT.rstrip().rfind(b" ")] + b"\n", "row 1 of vertex has 13 values, not 14"),
    "no number": (TEXT.rstrip() + b"x\n", "row 1 of vertex: .* is not a number"),
    "no opacity": (ply(without("opacity"), "<"), "property opacity, which is missing"),
    "no rotation": (ply(without("rot_3"), "<"), "property rot_3, which is missing"),
    "no second scale": (ply(without("scale_1"), "<"), "property scale_1, which is missing"),
    "no green": (ply(without("f_dc_1"), "<"), "f_dc_1 is missing beside f_dc_0"),
    "no x": (ply(without("x"), "<"), "property x, which is missing"),
    "cloud": (ply({n: table(2)[n] for n in "xyz"}, "<"), "an ordinary point cloud or mesh"),
    "ten harmonics": (ply(table(2) | {f"f_rest_{i}": [0, 0] for i in range(10)}, "<"), "10 properties"),
    "no rows": (ply(table(0), "<"), "has no Gaussians"),
    "compressed": (
        b"ply\nformat binary_little_endian 1.0\nelement chunk 1\nproperty float min_x\nelement vertex 1\n"
        b"property uint packed_position\nend_header\n" + b"\0" * 8,
        "compressed PLY",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_wrong_files_are_refused_by_what_is_wrong(name):
    raw, message = WRONG[name]
    with pytest.raises(ArtifactError, match=message):
        decode(raw)


def splats_strategy():
    def build(args):
        rows, seed, extreme = args
        rng = np.random.default_rng(seed)
        span = 30.0 if extreme else 3.0
        return Splats(
            format="ply",
            mean=(rng.normal(size=(rows, 3)) * np.exp(span)).astype(np.float32),
            scale=np.exp(rng.uniform(-span, span, (rows, 3))).astype(np.float32),
            quat_wxyz=rng.normal(size=(rows, 4)).astype(np.float32),
            opacity=rng.choice([0.0, 1.0, *rng.uniform(0, 1, 5)], rows).astype(np.float32),
            color=rng.integers(0, 256, (rows, 3)).astype(np.uint8),
        )

    return st.tuples(st.integers(1, 40), st.integers(0, 2**32), st.booleans()).map(build)


@settings(max_examples=examples(60), deadline=None)
@given(splats_strategy())
def test_what_is_written_is_read_again(splats):
    read = decode(b"".join(encode_ply(splats, ["made by a test"])))
    np.testing.assert_array_equal(read.mean, splats.mean)
    np.testing.assert_array_equal(read.quat_wxyz, splats.quat_wxyz)
    np.testing.assert_array_equal(read.color, splats.color)
    # a logarithm up to 30 rounded up to single precision is off by up to 2e-6, so is the scale, relatively
    np.testing.assert_allclose(read.scale, splats.scale, rtol=2.1e-6)
    np.testing.assert_allclose(read.opacity, splats.opacity, atol=3e-7)
    assert ((read.opacity == 1) == (splats.opacity == 1)).all()
    assert ((read.opacity == 0) == (splats.opacity == 0)).all()
    assert read.comments == ("made by a test",)


def test_colour_of_not_a_number_is_black():
    np.testing.assert_array_equal(color_from_sh0(np.array([np.nan, np.inf, -np.inf])), [0, 255, 0])


@settings(max_examples=examples(300), deadline=None)
@given(
    st.sampled_from([GOOD, TEXT, HUGE, ply(table(2), ">", newline="\r\n")]),
    st.lists(st.tuples(st.integers(0, 700), st.binary(max_size=6), st.integers(0, 30)), max_size=4),
)
def test_mutated_files_never_crash(raw, edits):
    for at, new, skip in edits:
        raw = raw[:at] + new + raw[at + skip :]
    try:
        splats = decode(raw)
    except AlulaError:
        return  # anything else fails the test
    assert len(splats) == len(splats.opacity) > 0


def data(name):
    root = os.environ.get("ALULA_DATA")
    if not root:
        pytest.skip("ALULA_DATA is not set")
    return Path(root) / name


BOUNDS = {
    "cc0-corpus/leica-sofort-top8192.ply": (8192, [-15.02, -10.418, 1.455], [16.256, 16.553, 24.487], 0.880),
    "inria-ply/train-1000.ply": (1000, [-13.021, -3.922, -3.822], [10.293, 1.968, 13.822], 0.182),
    "tiny-conformance/test-splat.3-points-from-train.ply": (
        3, [-2.748, -1.012, -1.397], [2.008, 0.081, 1.329], 0.138,
    ),
    "tiny-conformance/splatapult-axes-test.ply": (16, [0, 0, 0], [1, 1, 1], 1.0),
    "tiny-conformance/gsplat-rs-minimal_ascii.ply": (3, [0, 0, -0.1], [0.1, 0.1, 1.2], 0.690),
    "tiny-conformance/gsplat-rs-minimal_binary.ply": (3, [0, 0, -0.1], [0.1, 0.1, 1.2], 0.690),
    "tiny-conformance/epfl-pc_short-trailing-bytes.ply": (
        100, [-0.932, -0.473, 0.333], [0.083, 0.478, 1.568], 0.980,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BOUNDS)
def test_real_files_have_the_recorded_counts_and_bounds(name):
    count, lower, upper, opacity = BOUNDS[name]
    splats = read_splats(data(name))
    assert len(splats) == count
    np.testing.assert_allclose(splats.mean.min(0), lower, atol=5.1e-4)
    np.testing.assert_allclose(splats.mean.max(0), upper, atol=5.1e-4)
    assert np.median(splats.opacity) == pytest.approx(opacity, abs=5.1e-4)
    if "trailing" in name:
        assert "14029 bytes follow" in splats.notes[0]


def test_two_writers_of_one_scene_agree():
    text = read_splats(data("tiny-conformance/gsplat-rs-minimal_ascii.ply"))
    binary = read_splats(data("tiny-conformance/gsplat-rs-minimal_binary.ply"))
    for field in ("mean", "scale", "quat_wxyz", "opacity", "color"):
        np.testing.assert_array_equal(getattr(text, field), getattr(binary, field))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["inria-ply/train-1000.ply", "cc0-corpus/leica-sofort-top8192.ply"])
def test_open3d_reads_the_same(name, capfd):
    o3d = pytest.importorskip("open3d")
    path = data(name)
    theirs = o3d.t.io.read_point_cloud(str(path))
    if "rot" not in theirs.point:
        pytest.skip("this Open3D does not read Gaussians")
    capfd.readouterr()  # it prints to stdout
    ours = read_splats(path)
    np.testing.assert_array_equal(ours.mean, theirs.point["positions"].numpy())
    np.testing.assert_allclose(ours.scale, theirs.point["scale"].numpy(), rtol=1e-6)
    np.testing.assert_array_equal(ours.quat_wxyz, theirs.point["rot"].numpy())
    logits = theirs.point["opacity"].numpy().ravel().astype(np.float64)
    np.testing.assert_allclose(ours.opacity, 1 / (1 + np.exp(-logits)), rtol=1e-6)


FIXTURES = {
    "degree-1-sh": None, "degree-2-sh": None, "degree-3-sh": None, "degree-4-sh": None,
    "one-gaussian-ascii": None,
    "one-gaussian-binary-le": None, "reordered-properties": None, "three-gaussian-binary-le": None,
    "duplicate-sh-index": "f_rest_0 occurs twice",
    "empty-vertex": "has no Gaussians", "invalid-sh-name": "f_rest_1x is no name",
    "list-property": "opacity of vertex is a list", "mesh-not-gaussian": "point cloud or mesh",
    "missing-opacity": "opacity, which is missing", "non-contiguous-sh": "f_rest_2 is missing",
    "sh-count-not-rgb": "2 properties f_rest", "sh-invalid-degree": "6 properties f_rest",
    "truncated-binary-le": "need 56 bytes, there are 12",
}  # fmt: skip


@pytest.mark.parametrize("name", FIXTURES)
def test_public_fixtures_are_read_or_refused_by_name(name):
    path = data(f"usd3dgs-fixtures-ply/{name}.ply")
    if FIXTURES[name] is not None:
        with pytest.raises(ArtifactError, match=FIXTURES[name]):
            read_splats(path)
        return
    splats = read_splats(path)
    assert len(splats) == (3 if "three" in name else 1)
    np.testing.assert_array_equal(splats.mean[0], [1, 2, 3])
    if "three" not in name:
        scale = [1, 1, 1] if "degree-4" in name else [1, 2, 0.5]
        np.testing.assert_allclose(splats.scale[0], scale, rtol=1e-7)
        assert splats.opacity[0] == 0.5


def test_no_scale_is_smaller_after_a_round_trip():
    rng = np.random.default_rng(0)
    scale = (10 ** rng.uniform(-8, 3, (20_000, 3))).astype(np.float32)
    scale[0] = (0, np.finfo(np.float32).tiny, 1)
    splats = Splats(
        format="ply",
        mean=np.zeros_like(scale),
        scale=scale,
        quat_wxyz=np.ones((len(scale), 4), np.float32),
        opacity=np.full(len(scale), 0.5, np.float32),
        color=np.zeros(scale.shape, np.uint8),
    )
    read = decode(b"".join(encode_ply(splats))).scale
    assert (read >= scale).all()
    assert (read <= scale * np.float32(1 + 1e-5)).all()


def test_centres_in_large_integers_are_lost_by_what_is_recorded():
    names = ("x", "y", "z", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3")
    rows = np.zeros(3, [(name, "<i4" if name in "xyz" else "<f4") for name in names])
    rows["x"], rows["rot_0"] = [2**24 + 1, -(2**25) - 3, 7], 1
    lines = ["ply", "format binary_little_endian 1.0", "element vertex 3"]
    lines += [f"property {'int' if name in 'xyz' else 'float'} {name}" for name in names]
    splats = decode_ply(memoryview("\n".join([*lines, "end_header", ""]).encode() + rows.tobytes()))
    off = np.abs(splats.mean[:, 0].astype(np.float64) - rows["x"])
    assert off.max() > 0
    assert (off <= splats.loss.bound[:, 0]).all()
