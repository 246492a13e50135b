"""KSPLAT of all levels, by a test encoder that truncates like the reference or rounds."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.cli import main
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.errors import AlulaError, ArtifactError
from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
from alula.stages.reconstruction.formats.ksplat import decode_ksplat
from alula.stages.reconstruction.formats.registry import read_splats
from alula.stages.reconstruction.formats.splats import color_from_sh0
from alula.stages.reconstruction.import_splat import import_splat
from support.effort import examples
from support.files.originals import fractions, originals

BLOCK, RANGE = 5.0, 32767


def half(values, rounding):
    """Half precision, by truncation as in three.js, or to the nearest."""
    values = np.clip(values, -65504, 65504)
    near = values.astype(np.float16)
    if rounding == "rounding":
        return near
    over = np.abs(near.astype(float)) > np.abs(values)
    return np.where(over, np.nextafter(near, np.float16(0)), near)


def buckets_of(mean, size):
    """Rows in the order of the file, the centres of buckets, how many are full, and lengths of the others."""
    low = mean.min(axis=0)
    cell = np.floor((mean - low) / BLOCK)
    groups = {}
    for row, key in enumerate(map(tuple, cell)):
        groups.setdefault(key, []).append(row)
    full, partial = [], []
    for key, rows in groups.items():
        for start in range(0, len(rows), size):
            part = rows[start : start + size]
            (full if len(part) == size else partial).append((part, (np.array(key) + 0.5) * BLOCK + low))
    parts = full + partial
    return np.concatenate([p for p, _ in parts]), [c for _, c in parts], [len(p) for p, _ in parts], len(full)


def section(scene, level, degree, rounding="truncating", size=64, spare=0, scale_range=RANGE):
    """Header and data of one section, and the rows in its order."""
    values = (0, 9, 24)[degree]
    rows, centres, lengths, full = buckets_of(scene.mean, size)
    own = np.repeat(np.arange(len(lengths)), lengths)
    centre = np.array(centres)
    data = b""
    n = len(rows)
    rgba = np.hstack(
        [color_from_sh0(scene.sh0[rows]), np.floor(scene.alpha[rows, None] * 255).astype(np.uint8)]
    )
    scale = np.exp(scene.log_scale[rows])
    if level == 0:
        parts = [scene.mean[rows].astype("<f4"), scale.astype("<f4"), scene.quat[rows].astype("<f4")]
        head = (0, 0, 0.0, 0, 0, 0, 0)
    else:
        step = BLOCK / 2 / scale_range
        code = np.floor((scene.mean[rows] - centre[own]) / step + 0.5) + scale_range
        parts = [np.clip(code, 0, min(2 * scale_range + 1, 65535)).astype("<u2")]
        parts += [half(scale, rounding), half(scene.quat[rows], rounding)]
        data = np.array(lengths[full:], "<u4").tobytes() + centre.astype("<f4").tobytes()
        head = (
            size,
            len(lengths),
            BLOCK,
            12,
            scale_range if scale_range != RANGE else 0,
            full,
            len(lengths) - full,
        )
    parts += [rgba, np.zeros((n, values * (4, 2, 1)[level]), np.uint8)]
    records = np.hstack([np.ascontiguousarray(p).view(np.uint8).reshape(n, -1) for p in parts])
    data += records.tobytes() + bytes(spare * records.shape[1])
    bucket_size, buckets, block, centre_size, stored_range, full, partial = head
    header = struct.pack("<4IfHxx", n, n + spare, bucket_size, buckets, block, centre_size)
    header += struct.pack("<4IH", stored_range, 0, full, partial, degree)
    return header.ljust(1024, b"\0"), data, rows


def encode(sections, level, version=(0, 1), used=None, count=None):
    total = sum(struct.unpack("<I", header[:4])[0] for header, *_ in sections) if count is None else count
    used = len(sections) if used is None else used
    head = struct.pack("<BBxxIIIIHxx3fff", *version, len(sections), used, total, total, level, 1, 2, 3, 0, 0)
    return head.ljust(4096, b"\0") + b"".join(s[0] for s in sections) + b"".join(s[1] for s in sections)


def decode(raw):
    return decode_ksplat(memoryview(raw))


def reordered(scene, rows):
    for name, values in vars(scene).items():
        setattr(scene, name, values[rows])
    return scene


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_level_0_is_exact(degree):
    scene = originals(500)
    splats = decode(encode([section(scene, 0, degree)], 0))
    scene = reordered(scene, section(scene, 0, degree)[2])
    np.testing.assert_array_equal(splats.mean, scene.mean.astype(np.float32))
    np.testing.assert_array_equal(splats.scale, np.exp(scene.log_scale).astype(np.float32))
    np.testing.assert_array_equal(splats.quat_wxyz, scene.quat.astype(np.float32))
    np.testing.assert_array_equal(splats.color, color_from_sh0(scene.sh0))
    assert not splats.loss.bound.any()
    assert np.abs(splats.opacity - scene.alpha).max() <= splats.loss.opacity == 1 / 255


@pytest.mark.parametrize("rounding", ["truncating", "rounding"])
@pytest.mark.parametrize("degree", [0, 1, 2])
@pytest.mark.parametrize("level", [1, 2])
@pytest.mark.parametrize("span", [10.0, 3000.0])
def test_no_original_is_farther_than_the_bound(level, degree, rounding, span):
    scene = originals(5000, seed=degree, span=span, spread=1.0)
    made = section(scene, level, degree, rounding)
    splats = decode(encode([made], level))
    scene = reordered(scene, made[2])
    used = fractions(scene, splats)
    assert max(used) <= 1
    if rounding == "truncating":
        assert min(used) > 0.3, used
    np.testing.assert_array_equal(splats.color, color_from_sh0(scene.sh0))
    assert not splats.notes
    assert not splats.loss.unbounded


@pytest.mark.parametrize("rounding", ["truncating", "rounding"])
def test_the_smallest_scales_are_not_too_small_either(rounding):
    scene = originals(4000, spread=0)
    scene.log_scale = np.random.default_rng(0).uniform(-25, -8, (4000, 3))
    made = section(scene, 1, 0, rounding)
    splats = decode(encode([made], 1))
    scene = reordered(scene, made[2])
    truth = np.exp(scene.log_scale)
    assert (truth <= splats.scale.astype(float) * (1 + 2.0**-10)).all()
    assert (
        splats.scale - truth <= 1.5 * 2.0**-24 + 2.0**-11 * truth
    ).all()  # and hardly larger than they are
    assert (splats.loss.bound[:, 1] == np.float32(2.0**-10)).all()
    small = (half(truth, rounding) < 2.0**-14).any(axis=1).sum()
    assert splats.notes[0].startswith(f"{small} Gaussians with a semi-axis below 2^-14")


def test_several_sections_of_any_buckets():
    scenes = [originals(count, seed=count) for count in (700, 64, 1, 129)]
    made = [
        section(scene, 1, degree, spare=spare)
        for scene, degree, spare in zip(scenes, (0, 2, 1, 0), (0, 3, 0, 9), strict=True)
    ]
    splats = decode(encode(made, 1))
    at = 0
    for scene, (_, _, rows) in zip(scenes, made, strict=True):
        part = slice(at, at + len(rows))
        off = np.linalg.norm(splats.mean[part].astype(float) - scene.mean[rows], axis=1)
        assert (off <= splats.loss.bound[part, 0]).all()
        at += len(rows)
    assert at == len(splats) == 894
    assert len(decode(encode(made, 1, used=0))) == 894  # splat-transform's fixture says 0 sections in use


@pytest.mark.parametrize("size", [1, 3, 64, 5000])
def test_full_and_other_buckets(size):
    scene = originals(500)
    made = section(scene, 2, 0, size=size)
    assert max(fractions(reordered(scene, made[2]), decode(encode([made], 2)))) <= 1


def test_another_range_of_codes():
    scene = originals(500)
    made = section(scene, 1, 0, scale_range=100)
    splats = decode(encode([made], 1))
    used = fractions(reordered(scene, made[2]), splats)
    assert 0.6 < used[0] <= 1
    assert splats.loss.bound[:, 0].max() == pytest.approx(5 / 400 * 3**0.5, rel=1e-3)


def test_what_is_cut_off_is_counted():
    scene = originals(100, spread=0)
    scene.log_scale[7, 1] = 12.0
    scene.quat[3] *= -1
    made = section(scene, 1, 0)
    header, data, rows = made
    at = len(data) - 24 * 100
    data = data[: at + 24 * 5] + b"\xff\xff" + data[at + 24 * 5 + 2 :]
    splats = decode(encode([(header, data, rows)], 1) + b"end")
    assert splats.loss.unbounded == {
        "scale": "half precision ends at 65504, which 1 Gaussians have",
        "position": "1 Gaussians are cut off at the edge of their block",
    }
    assert splats.notes == ("3 bytes follow the sections; they were not read",)


def test_negative_scales_are_read_as_their_absolute_value():
    raw = bytearray(encode([section(originals(3), 0, 0)], 0))
    at = 4096 + 1024 + 12
    raw[at + 3] |= 0x80
    splats = decode(bytes(raw))
    assert splats.scale[0, 0] > 0
    assert splats.notes == ("1 rows with a negative scale, read as positive",)


@pytest.mark.parametrize("level", [0, 1, 2])
def test_values_that_are_not_numbers_are_passed_on(level):
    raw = encode([section(originals(1), level, 0)], level)
    tail = 44 if level == 0 else 24
    signalling = b"\1\0\x80\x7f" if level == 0 else b"\1\x7c\1\x7c"
    at = len(raw) - tail + (12 if level == 0 else 6)
    splats = decode(raw[:at] + signalling * 7 + raw[at + 28 :] if level == 0 else
                    raw[:at] + signalling * 3 + raw[at + 12 :])  # fmt: skip
    assert np.isnan(splats.scale).all()
    with pytest.raises(AlulaError, match="not_a_number 1"):
        import_splat(ImportSplatConfig(), splats)


def patched(raw, at, form, *values):
    return raw[:at] + struct.pack(form, *values) + raw[at + struct.calcsize(form) :]


GOOD = encode([section(originals(300), 1, 1, size=16)], 1)
NO_ROWS = encode([(bytes(1024), b"", [])], 1)
END = len(GOOD)
WRONG = {
    "short": (GOOD[:4095], "truncated: the header has 4096 bytes, there are 4095"),
    "version": (patched(GOOD, 0, "<BB", 0, 0), "version 0.0 is not supported"),
    "major": (patched(GOOD, 0, "<BB", 1, 1), "version 1.1 is not supported"),
    "level": (patched(GOOD, 20, "<H", 3), "compression level 3 is not known"),
    "sections": (patched(GOOD, 4, "<I", 2**32 - 1), "truncated: the headers of 4294967295 sections end"),
    "used": (patched(GOOD, 8, "<I", 2), "2 sections where there is room for 1"),
    "announced": (patched(GOOD, 16, "<I", 299), "299 Gaussians announced, but 300 in the sections"),
    "no rows": (NO_ROWS, "has no Gaussians"),
    "cut": (GOOD[:-1], f"section 1: truncated: .* end at {END}, the file at {END - 1}"),
    "huge": (patched(GOOD, 4096, "<II", 2**32 - 1, 2**32 - 1), "section 1: truncated: 4294967295 records"),
    "room": (patched(GOOD, 4096, "<II", 300, 299), "300 Gaussians where there is room for 299"),
    "degree": (patched(GOOD, 4096 + 40, "<H", 3), "spherical harmonics of degree 3"),
    "centres": (patched(GOOD, 4096 + 20, "<H", 8), "8 bytes for the centre of a bucket"),
    "block": (patched(GOOD, 4096 + 16, "<f", 0), "0 is no edge of a block"),
    "block nan": (patched(GOOD, 4096 + 16, "<f", np.nan), "nan is no edge of a block"),
    "full": (patched(GOOD, 4096 + 32, "<I", 10**6), "1000000 full and .* other buckets"),
    "held": (patched(GOOD, 4096 + 8, "<I", 1), "more than 1"),
    "lengths": (patched(GOOD, 4096 + 1024, "<I", 17), "a bucket holds 17 Gaussians, more than 16"),
    "too few": (patched(GOOD, 4096 + 1024, "<I", 0), "300 Gaussians, but its buckets hold"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_wrong_files_are_refused_by_what_is_wrong(name, tmp_path):
    raw, message = WRONG[name]
    (tmp_path / "x.ksplat").write_bytes(raw)
    with pytest.raises(ArtifactError, match=f"x.ksplat: KSPLAT: .*({message})"):
        read_splats(tmp_path / "x.ksplat")


@settings(max_examples=examples(400), deadline=None)
@given(
    st.sampled_from([GOOD, encode([section(originals(9), 2, 0, size=2)] * 3, 2)]),
    st.lists(
        st.tuples(
            st.sampled_from([0, 4096, 4096 + 1024, 4096 + 3 * 1024]),
            st.integers(0, 60),
            st.binary(min_size=1, max_size=4),
        ),
        min_size=1,
        max_size=4,
    ),
    st.integers(0, 100),
)
def test_mutated_files_never_crash(raw, edits, cut):
    for start, offset, new in edits:
        raw = raw[: start + offset] + new + raw[start + offset + len(new) :]
    try:
        splats = decode(raw[: len(raw) - cut])
    except AlulaError:
        return  # anything else fails the test
    assert len(splats) == len(splats.loss.bound) > 0


@settings(max_examples=examples(100), deadline=None)
@given(st.binary(max_size=5000))
def test_any_bytes_are_refused(raw):
    with pytest.raises(ArtifactError, match="KSPLAT"):
        decode(raw)


def test_the_fixture_of_splat_transform(data):
    splats = read_splats(data / "tiny-conformance/splat-transform-minimal.ksplat")
    other = read_splats(data / "tiny-conformance/splat-transform-minimal.splat")
    assert len(splats) == len(other) == 4
    np.testing.assert_array_equal(splats.mean, other.mean)
    np.testing.assert_allclose(splats.scale, other.scale, rtol=1e-6)
    np.testing.assert_array_equal(splats.color, other.color)
    np.testing.assert_allclose(splats.opacity, other.opacity, atol=1e-6)
    q = other.quat_wxyz / np.linalg.norm(other.quat_wxyz, axis=1, keepdims=True)
    assert (np.abs((splats.quat_wxyz * q).sum(axis=1)) > 0.9999).all()


def test_the_loss_makes_the_map_larger(tmp_path):
    scene = originals(200, span=3, spread=0.2)
    for level in (0, 1):
        (tmp_path / f"{level}.ksplat").write_bytes(encode([section(scene, level, 0)], level))
        splat, out, voxels = (
            str(tmp_path / f"{level}.{end}") for end in ("ksplat", "scene.npz", "voxels.npz")
        )
        assert main.run(["import-splat", splat, "-o", out, "-q"]) == 0
        world = str(tmp_path / f"{level}.world.npz")
        assert main.run(["scale-align", out, "--scale", "1", "-o", world, "-q"]) == 0
        assert main.run(["voxelize", world, "-o", voxels, "-q"]) == 0
    exact, lossy = (read_artifact(tmp_path / f"{level}.voxels.npz") for level in (0, 1))
    assert len(lossy.arrays["index"]) >= len(exact.arrays["index"])
    kept = {tuple(row) for row in lossy.arrays["index"]}
    assert {tuple(row) for row in exact.arrays["index"]} <= kept
