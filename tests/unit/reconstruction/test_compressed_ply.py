"""Compressed PLY: a test encoder with the rounding of known writers, and damaged files."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.cli import main
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.errors import AlulaError, ArtifactError
from alula.stages.reconstruction.formats.compressed_ply import decode_compressed_ply
from alula.stages.reconstruction.formats.registry import read_splats
from alula.stages.reconstruction.formats.splats import SH_C0, color_from_sh0
from support.effort import examples
from support.files.originals import fractions, originals

AXES = ("x", "y", "z")
RANGES = [f"{end}_{kind}{axis}" for kind in ("", "scale_") for end in ("min", "max") for axis in AXES]
COLORS = [f"{end}_{c}" for end in ("min", "max") for c in "rgb"]
WORDS = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
ROUNDINGS = {"rounding": lambda t, n: np.floor(t * n + 0.5), "truncating": lambda t, n: np.floor(t * n)}


def header(count, colors=True, sh=0, chunks=None, extra=()):
    chunks = -(-count // 256) if chunks is None else chunks
    lines = ["ply", "format binary_little_endian 1.0", *extra, f"element chunk {chunks}"]
    lines += [f"property float {name}" for name in RANGES + (COLORS if colors else [])]
    lines += [f"element vertex {count}", *(f"property uint {name}" for name in WORDS)]
    if sh:
        lines += [f"element sh {count}", *(f"property uchar f_rest_{i}" for i in range(sh))]
    return ("\n".join([*lines, "end_header"]) + "\n").encode()


def codes(values, lower, upper, levels, to_code):
    extent = upper - lower
    t = np.where(extent < 1e-5, 0.0, (values - lower) / np.where(extent == 0, 1, extent))
    t = np.where(values <= lower, 0.0, np.where(values >= upper, 1.0, t))
    return np.clip(to_code(t, levels), 0, levels).astype(np.uint32)


def packed(values, limits, to_code):
    x, y, z = (
        codes(values[:, i], *(end[:, i] for end in limits), n, to_code)
        for i, n in enumerate((2047, 1023, 2047))
    )
    return x << 21 | y << 11 | z


def packed_rotation(quat, to_code):
    rows, largest = np.arange(len(quat)), np.abs(quat).argmax(axis=1)
    quat = quat * np.sign(quat[rows, largest])[:, None]
    others = quat[np.arange(4) != largest[:, None]].reshape(-1, 3)
    a, b, c = np.clip(to_code(others * np.sqrt(0.5) + 0.5, 1023), 0, 1023).astype(np.uint32).T
    return largest.astype(np.uint32) << 30 | a << 20 | b << 10 | c


def encode(scene, rounding="rounding", colors=True, sh=0, comments=()):
    to_code = ROUNDINGS[rounding]
    owner = np.arange(len(scene)) // 256
    shade = scene.sh0 * SH_C0 + 0.5
    log_scale = np.clip(scene.log_scale, -20, 20)
    limits = [
        [
            fold.reduceat(values, np.arange(0, len(scene), 256)).astype("<f4").astype(float)
            for fold in (np.minimum, np.maximum)
        ]
        for values in (scene.mean, log_scale, shade)
    ]
    position, scale, color = ([end[owner] for end in pair] for pair in limits)
    rgb = [codes(shade[:, i], color[0][:, i], color[1][:, i], 255, to_code) if colors
           else np.clip(to_code(shade[:, i], 255), 0, 255).astype(np.uint32) for i in range(3)]  # fmt: skip
    alpha = to_code(scene.alpha, 255).astype(np.uint32)
    words = [
        packed(scene.mean, position, to_code),
        packed_rotation(scene.quat, to_code),
        packed(scene.log_scale, scale, to_code),
        rgb[0] << 24 | rgb[1] << 16 | rgb[2] << 8 | alpha,
    ]
    table = np.hstack([end for pair in limits[: 3 if colors else 2] for end in pair]).astype("<f4")
    body = table.tobytes() + np.stack(words, axis=1).astype("<u4").tobytes() + bytes(len(scene) * sh)
    return header(len(scene), colors, sh, extra=[f"comment {c}" for c in comments]) + body


def decode(raw):
    return decode_compressed_ply(memoryview(raw))


@pytest.mark.parametrize("rounding", ROUNDINGS)
@pytest.mark.parametrize("span", [0.01, 10.0, 2000.0])
def test_no_original_is_farther_than_the_bound(rounding, span):
    scene = originals(20_000, seed=1, span=span)
    splats = decode(encode(scene, rounding))
    used = fractions(scene, splats)
    assert max(used) <= 1
    if rounding == "truncating":
        assert min(used) > 0.6, used
    assert not splats.loss.unbounded


def test_the_bound_holds_where_a_range_is_too_small_to_be_coded():
    scene = originals(600, span=4e-6)
    scene.log_scale[:] = np.float32(-1) + scene.mean
    used = fractions(scene, decode(encode(scene)))
    assert 0.3 < used[0] <= 1
    assert used[1] <= 1
    scene.mean[:] = scene.mean[0]
    assert fractions(scene, decode(encode(scene)))[0] <= 1


@pytest.mark.parametrize("count", [1, 255, 256, 257, 70_000])
def test_each_row_has_the_range_of_its_own_chunk(count):
    scene = originals(count, seed=count)
    scene.mean += 1000.0 * (np.arange(count) // 256)[:, None]
    scene.mean = scene.mean.astype(np.float32).astype(float)
    seen = []
    splats = decode_compressed_ply(memoryview(encode(scene)), lambda done, total: seen.append((done, total)))
    assert len(splats) == count
    assert seen[-1] == (count, count)
    assert max(fractions(scene, splats)) <= 1


@pytest.mark.parametrize("colors", [True, False])
def test_colours_come_with_a_range_or_without(colors):
    scene = originals(1000)
    splats = decode(encode(scene, colors=colors))
    off = np.abs(splats.color.astype(int) - color_from_sh0(scene.sh0))
    assert off.max() <= (3 if colors else 1)


def test_log_scales_at_the_end_of_what_can_be_written_are_counted():
    scene = originals(300)
    scene.log_scale[[3, 299], [0, 2]] = 25.0, 21.0
    scene.log_scale[5] = -30.0
    splats = decode(encode(scene))
    assert "cut off at 20 in this format, which 2 Gaussians have" in splats.loss.unbounded["scale"]
    keep = ~np.isin(np.arange(300), [3, 299])
    assert (np.exp(scene.log_scale) <= splats.scale * (1 + splats.loss.bound[:, 1:2].astype(float)))[
        keep
    ].all()


def test_what_the_file_says_of_itself_is_kept():
    raw = encode(originals(3), sh=45, comments=["Generated by SuperSplat 2", "Vertical Axis: z"])
    splats = decode(raw + b"more")
    assert splats.tags == {"generator": "SuperSplat 2", "vertical_axis": "z"}
    assert splats.notes == ("4 bytes follow the data that the header announces; they were not read",)


@pytest.mark.slow
@pytest.mark.parametrize("count", [5, 1000])
def test_gsply_reads_the_same(tmp_path, count):
    gsply = pytest.importorskip("gsply")
    path = tmp_path / "a.compressed.ply"
    path.write_bytes(encode(originals(count, seed=3)))
    theirs, ours = gsply.plyread(path), read_splats(path)
    assert ours.format == "compressed-ply"
    np.testing.assert_allclose(ours.mean, theirs.means, atol=4e-6)
    np.testing.assert_allclose(np.log(ours.scale), theirs.scales, atol=4e-6)
    np.testing.assert_allclose(ours.quat_wxyz, theirs.quats, atol=2e-6)
    np.testing.assert_allclose(
        ours.opacity, 1 / (1 + np.exp(-theirs.opacities)), atol=5e-5
    )  # it clips logits
    assert np.abs(ours.color.astype(int) - color_from_sh0(theirs.sh0)).max() <= 1


@pytest.mark.slow
def test_what_gsply_writes_is_within_the_bound(tmp_path):
    gsply = pytest.importorskip("gsply")
    scene = originals(2000, seed=4)
    f4 = {name: getattr(scene, name).astype(np.float32) for name in ("mean", "log_scale", "quat", "sh0")}
    logit = np.log(scene.alpha / (1 - scene.alpha)).astype(np.float32)
    data = gsply.GSData(
        means=f4["mean"], scales=f4["log_scale"], quats=f4["quat"], opacities=logit, sh0=f4["sh0"], shN=None
    )
    gsply.plywrite(str(tmp_path / "b.ply"), data, compressed=True)
    splats = read_splats(next(tmp_path.glob("b*.ply")))
    assert splats.format == "compressed-ply"
    row = np.array([np.linalg.norm(scene.mean - m, axis=1).argmin() for m in splats.mean.astype(float)])
    assert len(np.unique(row)) == 2000  # it sorts them
    for name in ("mean", "log_scale", "quat", "alpha"):
        setattr(scene, name, getattr(scene, name)[row])
    used = fractions(scene, splats)
    assert max(used) <= 1
    assert min(used) > 0.3


GOOD = encode(originals(300), sh=9)
CUT = len(header(300, sh=9))
NAN, INF = np.float32(np.nan).tobytes(), np.float32(np.inf).tobytes()
WRONG = {
    "no rows": (header(0), "has no Gaussians"),
    "too few chunks": (GOOD.replace(b"chunk 2\n", b"chunk 1\n"), "300 Gaussians have 2 chunks of 256, not 1"),
    "huge": (GOOD.replace(b"chunk 2\n", b"chunk 3906250000\n").replace(b" 300\n", b" 1000000000000\n"),
             "truncated: 3906250000 rows of chunk need 281250000000 bytes"),
    "cut": (GOOD[:-1], "truncated: 300 rows of sh need 2700 bytes, there are 2699"),
    "no data": (GOOD[:CUT], "truncated: 2 rows of chunk"),
    "harmonics": (encode(originals(3), sh=10), "10 properties f_rest"),
    "harmonics of int": (GOOD.replace(b"uchar f_rest_0\n", b"char f_rest_0\n"), "must have 9, 24 or 45"),
    "harmonics missing": (GOOD.replace(b"uchar f_rest_4\n", b"uchar f_rest_9\n"), "f_rest_4 is missing"),
    "harmonics rows": (GOOD.replace(b"sh 300\n", b"sh 299\n"), "299 rows of sh for 300 Gaussians"),
    "no word": (GOOD.replace(b"packed_scale\n", b"packed_sc\n"), "packed_scale of vertex is missing"),
    "int": (GOOD.replace(b"uint packed_color", b"int packed_color"), "packed_color .* is not of type uint"),
    "double": (GOOD.replace(b"float max_z", b"double max_z"), "max_z of chunk is not of type float"),
    "half a colour": (GOOD.replace(b"float max_b", b"float max_d"), "max_b of chunk is missing"),
    "ascii": (GOOD.replace(b"binary_little_endian", b"ascii"), "must be binary_little_endian"),
    "no chunks": (GOOD.replace(b"element chunk", b"element junk"), "needs elements chunk and vertex"),
    "list": (GOOD.replace(b"element sh", b"element faces 3\nproperty list uchar int i\nelement sh"),
             "element faces has lists"),
    "not a number": (GOOD[:CUT] + NAN + GOOD[CUT + 4 :], "chunk 0 has x from nan to .*, which is no range"),
    "signalling": (GOOD[:CUT] + b"\1\0\x80\x7f" + GOOD[CUT + 4 :], "chunk 0 has x from nan to"),
    "infinite": (GOOD[:CUT + 72 + 36] + INF + GOOD[CUT + 72 + 40 :], "chunk 1 has scale_x from .* to inf"),
    "upside down": (GOOD[:CUT + 4] + np.float32(1e6).tobytes() + GOOD[CUT + 8 :], "chunk 0 has y from 1e.06"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_wrong_files_are_refused_by_what_is_wrong(name, tmp_path):
    raw, message = WRONG[name]
    with pytest.raises(ArtifactError, match=message):
        decode(raw)
    path = tmp_path / "x.ply"
    path.write_bytes(raw)
    with pytest.raises(ArtifactError, match="PLY: "):
        read_splats(path)


@settings(max_examples=examples(300), deadline=None)
@given(st.lists(st.tuples(st.integers(0, len(GOOD)), st.binary(max_size=6), st.integers(0, 30)), max_size=4))
def test_mutated_files_never_crash(edits):
    raw = GOOD
    for at, new, skip in edits:
        raw = raw[:at] + new + raw[at + skip :]
    try:
        splats = decode(raw)
    except AlulaError:
        return  # anything else fails the test
    assert len(splats) == len(splats.loss.bound) > 0


def test_the_loss_arrives_in_the_scene(tmp_path):
    (tmp_path / "a.ply").write_bytes(encode(originals(500)))
    scene = tmp_path / "a.scene.npz"
    assert (
        main.run(["import-splat", str(tmp_path / "a.ply"), "-o", str(scene), "-q", "--min-opacity", "0"]) == 0
    )
    artifact = read_artifact(scene)
    assert artifact.manifest.summary["format"] == "compressed-ply"
    np.testing.assert_array_equal(
        artifact.arrays["loss"], decode((tmp_path / "a.ply").read_bytes()).loss.bound
    )
