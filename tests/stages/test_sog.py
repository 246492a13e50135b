"""SOG by an encoder of our own with the roundings of writers, real scenes, and files that are wrong."""

import io
import json
import sys
import types
import zipfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

sys.path.insert(0, str(Path(__file__).parent))
from originals import angles, fractions, originals

from alula.cli import main
from alula.schemas.artifact import read_artifact
from alula.schemas.errors import AlulaError, ArtifactError
from alula.stages.reconstruction.formats.registry import SplatFile, read_splats
from alula.stages.reconstruction.formats.sog import OPACITY_LOSS
from alula.stages.reconstruction.formats.splats import color_from_sh0

ROUNDINGS = {"truncating": lambda v: np.floor(v + 1e-9), "rounding": lambda v: np.floor(v + 0.5)}
BANDS = {1: 3, 2: 8, 3: 15}


def webp(pixels, width, **options):
    """Rows of 4 channels as a lossless image, padded with zeros."""
    height = -(-len(pixels) // width)
    canvas = np.zeros((height * width, pixels.shape[1]), np.uint8)
    canvas[: len(pixels)] = pixels
    image = Image.fromarray(canvas.reshape(height, width, -1))
    raw = io.BytesIO()
    image.save(raw, "WEBP", **({"lossless": True, "exact": True, "quality": 0, "method": 0} | options))
    return raw.getvalue()


def opaque(codes):
    return np.hstack([codes, np.full((len(codes), 1), 255)]).astype(np.uint8)


def linear(values, to_code, levels=255):
    """Codes between the limits of columns, with those limits."""
    lower, upper = values.min(axis=0), values.max(axis=0)
    extent = np.where(upper > lower, upper - lower, 1.0)
    return np.clip(to_code((values - lower) / extent * levels), 0, levels), lower.tolist(), upper.tolist()


def nearest(values, table):
    order = np.sort(table)
    return np.searchsorted((order[1:] + order[:-1]) / 2, values), order.tolist()


def encode(scene, version=2, rounding="truncating", bands=0, width=None, palette=100, model=None):
    """Files by name."""
    to_code = ROUNDINGS[rounding]
    n = len(scene)
    width = width or max(4, -(-int(np.ceil(n**0.5)) // 4) * 4)
    t = np.sign(scene.mean) * np.log1p(np.abs(scene.mean))
    code, mins, maxs = linear(t, to_code, 65535)
    code = code.astype(np.uint16)
    rows, largest = np.arange(n), np.abs(scene.quat).argmax(axis=1)
    quat = scene.quat * np.sign(scene.quat[rows, largest])[:, None]
    others = quat[np.arange(4) != largest[:, None]].reshape(-1, 3)
    packed = to_code((others * np.sqrt(2) * 0.5 + 0.5) * 255)
    meta = {
        "means": {"mins": mins, "maxs": maxs, "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"files": ["sh0.webp"]},
    }
    if version == 2:
        quantiles = np.linspace(0, 1, 256)
        scales, meta["scales"]["codebook"] = nearest(scene.log_scale, np.quantile(scene.log_scale, quantiles))
        shades, meta["sh0"]["codebook"] = nearest(scene.sh0, np.quantile(scene.sh0, quantiles))
        colors = np.hstack([shades, to_code(scene.alpha[:, None] * 255)]).astype(np.uint8)
        meta = {"version": 2, "count": n, "asset": {"generator": "a test"}} | meta
    else:
        scales, meta["scales"]["mins"], meta["scales"]["maxs"] = linear(scene.log_scale, to_code)
        logit = np.log(scene.alpha / (1 - scene.alpha))
        colors, *limits = linear(np.hstack([scene.sh0, logit[:, None]]), to_code)
        meta["sh0"]["mins"], meta["sh0"]["maxs"] = limits
        meta["means"]["shape"] = [n, 3]
    if model is not None:
        meta["model"] = model
    files = {
        "means_l.webp": webp(opaque(code & 255), width),
        "means_u.webp": webp(opaque(code >> 8), width),
        "scales.webp": webp(opaque(scales), width),
        "quats.webp": webp(np.hstack([packed, 252 + largest[:, None]]).astype(np.uint8), width),
        "sh0.webp": webp(np.asarray(colors, np.uint8), width),
    }
    if bands:
        wide = 64 * BANDS[bands]
        files["shN_centroids.webp"] = webp(np.ones((wide * -(-palette // 64), 4), np.uint8), wide)
        files["shN_labels.webp"] = webp(opaque(np.zeros((n, 3))), width)
        meta["shN"] = {"files": ["shN_centroids.webp", "shN_labels.webp"]}
        if version == 2:
            meta["shN"] |= {"count": palette, "bands": bands, "codebook": [0.0] * 256}
        else:
            meta["shN"] |= {"mins": -1.0, "maxs": 1.0}
    return {"meta.json": json.dumps(meta).encode()} | files


def folder(path, files):
    path.mkdir(parents=True, exist_ok=True)
    for name, raw in files.items():
        (path / name).write_bytes(raw)
    return path


def bundle(path, files, compression=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, raw in files.items():
            archive.writestr(name, raw)
    return path


def changed(files, **edits):
    """The files with other values in `meta.json`; `a__b` means a.b, None removes."""
    meta = json.loads(files["meta.json"])
    for path, value in edits.items():
        *parents, last = path.split("__")
        place = meta
        for name in parents:
            place = place[name]
        if value is None:
            del place[last]
        else:
            place[last] = value
    return files | {"meta.json": json.dumps(meta).encode()}


@pytest.mark.parametrize("rounding", ROUNDINGS)
@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("span", [0.5, 20.0, 1000.0])
def test_no_original_is_farther_than_the_bound(tmp_path, version, rounding, span):
    scene = originals(6000, seed=version, span=span, spread=1.0)
    splats = read_splats(folder(tmp_path / "a", encode(scene, version, rounding)))
    if version == 2:  # what lies above the largest entry has no bound
        top = (splats.scale == splats.scale.max()).any(axis=1)
        scene.log_scale[top] = np.minimum(scene.log_scale[top], np.log(splats.scale[top].astype(float)))
    used = fractions(scene, splats)
    assert max(used) <= 1
    if rounding == "truncating":
        assert min(used) > 0.6, used
    assert ("scale" in splats.loss.unbounded) == (version == 2)


def test_gaussians_with_the_largest_entry_are_counted(tmp_path):
    scene = originals(1000, spread=1.0)
    splats = read_splats(folder(tmp_path / "a", encode(scene)))
    count = int((splats.scale == splats.scale.max()).any(axis=1).sum())
    assert f"for the {count} Gaussians with the largest entry" in splats.loss.unbounded["scale"]


@pytest.mark.parametrize("compression", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("bands", [0, 1, 2, 3])
def test_all_containers_hold_the_same(tmp_path, version, bands, compression):
    files = encode(originals(500), version, bands=bands, model="2dgs")
    there = folder(tmp_path / "a", files)
    packed = bundle(tmp_path / "a.sog", files, compression)
    names = set(files)
    found = [read_splats(path) for path in (there, there / "meta.json", packed)]
    for other in found[1:]:
        for name in ("mean", "scale", "quat_wxyz", "opacity", "color"):
            np.testing.assert_array_equal(getattr(found[0], name), getattr(other, name))
        np.testing.assert_array_equal(found[0].loss.bound, other.loss.bound)
    for path in (there, there / "meta.json"):
        roles = SplatFile.find(path).files()
        assert roles["splat"] == there / "meta.json"
        assert {file.name for file in roles.values()} == names
    assert SplatFile.find(packed).files() == {"splat": packed}
    assert found[0].tags["render_mode"] == "2dgs"


@pytest.mark.parametrize("count", [1, 3, 16, 17, 300_000])
def test_any_number_of_gaussians(tmp_path, count):
    scene = originals(count, seed=5)
    seen = []
    found = SplatFile.find(folder(tmp_path / "a", encode(scene, 1)))
    splats = found.decode(lambda done, total: seen.append((done, total)))
    assert len(splats) == count
    assert seen[-1] == (count, count)
    off = np.linalg.norm(splats.mean.astype(float) - scene.mean, axis=1)
    assert (off <= splats.loss.bound[:, 0]).all()


def test_invisible_gaussians_keep_their_codes(tmp_path):
    scene = originals(300)
    scene.alpha[:] = 0
    splats = read_splats(folder(tmp_path / "a", encode(scene)))
    assert not splats.opacity.any()
    assert np.abs(splats.color.astype(int) - color_from_sh0(scene.sh0)).max() <= 12


def test_colours_and_alpha(tmp_path):
    scene = originals(2000)
    for version in (1, 2):
        splats = read_splats(folder(tmp_path / str(version), encode(scene, version)))
        assert np.abs(splats.color.astype(int) - color_from_sh0(scene.sh0)).max() <= 12
        assert np.abs(splats.opacity - scene.alpha).max() <= splats.loss.opacity + 1e-7
        assert splats.loss.opacity == OPACITY_LOSS or version == 1


def test_rows_without_a_rotation_may_have_any(tmp_path):
    files = encode(originals(16), width=4)
    codes = np.full((16, 4), 255, np.uint8)
    codes[5, 3] = 251
    splats = read_splats(folder(tmp_path / "a", files | {"quats.webp": webp(codes, 4)}))
    np.testing.assert_array_equal(splats.quat_wxyz[5], [1, 0, 0, 0])
    assert splats.loss.bound[5, 2] >= np.pi > splats.loss.bound[4, 2]
    assert splats.notes[0].startswith("1 rows without a rotation")


def test_a_first_entry_of_null_is_extrapolated(tmp_path):
    files = encode(originals(500))
    table = json.loads(files["meta.json"])["scales"]["codebook"]
    exact = read_splats(folder(tmp_path / "a", files))
    early = read_splats(folder(tmp_path / "b", changed(files, scales__codebook=[None, *table[1:]])))
    first = np.exp(table[1] + (table[1] - table[255]) / 255)
    expected = np.where(exact.scale == np.float32(np.exp(table[0])), np.float32(first), exact.scale)
    np.testing.assert_allclose(early.scale, expected, rtol=1e-6)
    assert early.notes == ("the first entry of scales.codebook is null and was extrapolated",)


def test_a_table_of_one_value_loses_nothing(tmp_path):
    scene = originals(50, spread=0)
    splats = read_splats(folder(tmp_path / "a", encode(scene)))
    assert splats.loss.bound[:, 1].max() < 1e-6


@pytest.mark.parametrize("version", [1, 2])
def test_gsply_reads_the_same(tmp_path, monkeypatch, version):
    sog_reader = pytest.importorskip("gsply.sog_reader")

    def pixels(raw):
        return np.asarray(Image.open(io.BytesIO(raw)).convert("RGBA"))

    monkeypatch.setattr(sog_reader, "imagecodecs", types.SimpleNamespace(webp_decode=pixels))
    path = folder(tmp_path / "a", encode(originals(2000), version, bands=1))
    same_as_gsply(read_splats(path), sog_reader.sogread(path))


def same_as_gsply(ours, theirs):
    np.testing.assert_allclose(ours.mean, theirs.means, rtol=2e-5, atol=2e-6)
    np.testing.assert_allclose(np.log(ours.scale), theirs.scales, atol=4e-6)
    np.testing.assert_allclose(ours.quat_wxyz, theirs.quats, atol=2e-6)
    np.testing.assert_allclose(ours.opacity, 1 / (1 + np.exp(-theirs.opacities)), atol=5e-5)
    assert np.abs(ours.color.astype(int) - color_from_sh0(theirs.sh0)).max() <= 1


def noise(width, height=1):
    return webp(np.random.default_rng(0).integers(0, 256, (width * height, 4)).astype(np.uint8), width)


def riff(*chunks):
    body = b"WEBP" + b"".join(name + len(raw).to_bytes(4, "little") + raw for name, raw in chunks)
    return b"RIFF" + len(body).to_bytes(4, "little") + body


def blank(width, height):
    """The header of an image that has no pixels to speak of."""
    return riff((b"VP8L", b"\x2f" + (width - 1 | (height - 1) << 14).to_bytes(4, "little") + bytes(16)))


GOOD = encode(originals(300), bands=1)
OLD = encode(originals(300), 1)
INFINITE = changed(GOOD, means__maxs="@")
INFINITE["meta.json"] = INFINITE["meta.json"].replace(b'"@"', b"[1e999, 1, 1]")
PLAIN = [name for name in GOOD if name.endswith("webp") and name != "shN_centroids.webp"]
LOSSY = webp(np.zeros((300, 3), np.uint8), 20, lossless=False, quality=50)
WRONG = {
    "no JSON": (GOOD | {"meta.json": b"{"}, "meta.json is no JSON"),
    "no object": (GOOD | {"meta.json": b"[1]"}, "meta.json is no JSON object"),
    "deep": (GOOD | {"meta.json": b"[" * 200_000}, "meta.json is no JSON"),
    "large": (GOOD | {"meta.json": b" " * (2**22 + 1)}, "meta.json has 4194305 bytes, more than"),
    "not a number": (GOOD | {"meta.json": GOOD["meta.json"].replace(b"300", b"NaN", 1)}, "NaN is no number"),
    "not text": (GOOD | {"meta.json": b"\xff\xfe"}, "meta.json is no JSON"),
    "version": (changed(GOOD, version=3), "version 3 is not supported"),
    "version True": (changed(GOOD, version=True), "version True is not supported"),
    "no means": (changed(GOOD, means=None), "means is missing or no object"),
    "no quats": (changed(GOOD, quats=[]), "quats is missing or no object"),
    "no count": (changed(GOOD, count=None), "count is missing"),
    "count": (changed(GOOD, count=3.5), "count is missing or no count"),
    "negative": (changed(GOOD, count=-1), "count is missing or no count"),
    "no rows": (changed(GOOD, count=0), "has no Gaussians"),
    "no shape": (changed(OLD, means__shape=[]), "means.shape is missing"),
    "too many": (changed(GOOD, count=401), "means_l.webp has 20 x 15 pixels, fewer than the 401 Gaussians"),
    "huge": (changed(GOOD, count=2**31), "fewer than the 2147483648 Gaussians"),
    "far too few": (changed(GOOD | {"means_l.webp": noise(400, 200)}, count=3), "400 x 200 pixels, far more"),
    "bomb": (changed(GOOD | dict.fromkeys(PLAIN, blank(16000, 16000)), count=16000**2), "bytes can hold"),
    "no file": ({k: v for k, v in GOOD.items() if k != "sh0.webp"}, "sh0.webp(: does| is) not "),
    "name": (changed(GOOD, sh0__files=["../sh0.webp"]), "sh0.files: '../sh0.webp' is no name"),
    "names": (changed(GOOD, means__files=["means_l.webp"]), "means.files must have 2 names"),
    "twice": (changed(GOOD, means__files=["means_l.webp"] * 2), "names a file twice"),
    "limits": (changed(GOOD, means__mins=[0, 0]), "means.mins must have 3 numbers"),
    "limit": (changed(GOOD, means__mins=[0, 0, "a"]), "means.mins has a, which is no number"),
    "true": (changed(GOOD, means__mins=[0, 0, True]), "means.mins has True, which is no number"),
    "infinite": (INFINITE, "means.maxs has inf, which is no number"),
    "overflow": (changed(GOOD, means__maxs=[10**400, 1, 1]), "which is no number"),
    "upside down": (changed(GOOD, means__mins=[99, 0, 0]), "means.mins has 99 above"),
    "short table": (changed(GOOD, scales__codebook=[1.0] * 255), "scales.codebook must have 256 numbers"),
    "null in a table": (changed(GOOD, scales__codebook=[1.0, None] * 128), "codebook has None"),
    "old alpha": (changed(OLD, sh0__mins=[0, 0, 0]), "sh0.mins must have 4 numbers"),
    "bands": (changed(GOOD, shN__bands=4), "shN.bands must be 1, 2 or 3"),
    "other bands": (changed(GOOD, shN__bands=2), "centroids.webp has 192 x 2 pixels; it must be 512 wide"),
    "palette": (changed(GOOD, shN__count=1000), "it must be 192 wide and 16 to 1024 high"),
    "large palette": (changed(GOOD, shN__count=65537), "labels go to 65536"),
    "labels": (GOOD | {"shN_labels.webp": noise(10, 10)}, "shN_labels.webp has 10 x 10 pixels, fewer"),
    "no image": (GOOD | {"quats.webp": b"\x89PNG" + bytes(90)}, "quats.webp is no WebP image"),
    "lossy": (GOOD | {"quats.webp": LOSSY}, "quats.webp is not a still, lossless WebP"),
    "cut": (GOOD | {"quats.webp": GOOD["quats.webp"][:-9]}, "quats.webp is truncated"),
    "blank": (GOOD | {"quats.webp": blank(20, 15)}, None),
    "no chunk": (GOOD | {"quats.webp": riff((b"EXIF", b"1234"))}, "quats.webp is a WebP image without data"),
    "damaged": (GOOD | {"quats.webp": riff((b"VP8L", bytes(20)))}, "quats.webp is a damaged WebP image"),
    "rubbish": (GOOD | {"quats.webp": GOOD["quats.webp"][:40] + bytes(len(GOOD["quats.webp"]) - 40)}, None),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_wrong_files_are_refused_by_what_is_wrong(tmp_path, name):
    files, message = WRONG[name]
    for path in (folder(tmp_path / "a", files), bundle(tmp_path / "a.sog", files)):
        if message is None:  # a decoder may make anything of such an image, or nothing
            with suppress(ArtifactError):
                assert len(read_splats(path, "sog")) == 300
            continue
        with pytest.raises(ArtifactError, match=f"a(.sog)?: SOG: .*{message}"):
            read_splats(path, "sog")


def encrypted(raw):
    for signature, at in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        place = raw.index(signature) + at
        raw = raw[:place] + b"\1" + raw[place + 1 :]
    return raw


def zipped(files, *args, **options):
    raw = io.BytesIO()
    with zipfile.ZipFile(raw, "w", *args, **options) as archive:
        for name, member in files:
            archive.writestr(name, member)
    return raw.getvalue()


STORED = zipped(GOOD.items())
ARCHIVES = {
    "no archive": (b"PK\x03\x04" + bytes(100), "damaged ZIP archive"),
    "cut": (STORED[:-30], "damaged ZIP archive"),
    "elsewhere": (zipped((f"scene/{n}", r) for n, r in GOOD.items()), "meta.json is not in the archive"),
    "encrypted": (encrypted(STORED), "meta.json is encrypted"),
    "bzip2": (zipped(GOOD.items(), zipfile.ZIP_BZIP2), "meta.json is compressed by method 12; "),
    "checksum": (STORED.replace(b"a test", b"a pest"), "meta.json is damaged: Bad CRC-32"),
    "bomb": (zipped({"meta.json": bytes(2**23)}.items(), zipfile.ZIP_DEFLATED), "meta.json has 8388608"),
    "image bomb": (zipped((GOOD | {"sh0.webp": bytes(2**21)}).items(), zipfile.ZIP_DEFLATED),
                   "sh0.webp has 2097152 bytes, more than"),
}  # fmt: skip


@pytest.mark.parametrize("name", ARCHIVES)
def test_wrong_archives_are_refused_by_what_is_wrong(tmp_path, name):
    raw, message = ARCHIVES[name]
    (tmp_path / "a.sog").write_bytes(raw)
    with pytest.raises(ArtifactError, match=f"a.sog: SOG: {message}"):
        read_splats(tmp_path / "a.sog")


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_a_name_that_is_twice_in_an_archive_is_refused(tmp_path):
    (tmp_path / "a.sog").write_bytes(zipped([*GOOD.items(), ("sh0.webp", GOOD["quats.webp"])]))
    with pytest.raises(ArtifactError, match=r"sh0.webp is twice in the archive"):
        read_splats(tmp_path / "a.sog")


def test_an_archive_with_large_offsets_is_read(tmp_path):
    raw = io.BytesIO()
    with zipfile.ZipFile(raw, "w") as archive:
        for name, member in GOOD.items():
            with archive.open(name, "w", force_zip64=True) as file:
                file.write(member)
    (tmp_path / "no suffix").write_bytes(raw.getvalue())
    assert read_splats(tmp_path / "no suffix").format == "sog"


def test_only_what_is_sog_is_recognised(tmp_path):
    with pytest.raises(ArtifactError, match="no kind that this version recognises"):
        read_splats(folder(tmp_path / "a", {"meta.json": b'{"means": 3}'}))
    for raw in (b"{}", b"[]", b"{ broken", zipped([("x", b"y")])):
        (tmp_path / "x.json").write_bytes(raw)
        with pytest.raises(ArtifactError, match="not a splat file"):
            read_splats(tmp_path / "x.json")


EDITS = st.lists(st.tuples(st.integers(0, 10**6), st.binary(min_size=1, max_size=4)), min_size=1, max_size=4)


@settings(max_examples=150, deadline=None)
@given(st.sampled_from([STORED, zipped(GOOD.items(), zipfile.ZIP_DEFLATED)]), EDITS, st.booleans())
def test_mutated_archives_never_crash(tmp_path_factory, raw, edits, behind):
    for at, new in edits:
        at = len(raw) - 1 - at % 600 if behind else at % len(raw)  # the directory is at the end
        raw = raw[:at] + new + raw[at + len(new) :]
    path = tmp_path_factory.mktemp("m") / "a.sog"
    path.write_bytes(raw)
    try:
        splats = read_splats(path)
    except AlulaError:
        return  # anything else fails the test
    assert len(splats) == len(splats.loss.bound) > 0


@settings(max_examples=200, deadline=None)
@given(st.sampled_from(list(GOOD)), EDITS, st.integers(0, 3))
def test_mutated_members_never_crash(tmp_path_factory, name, edits, cut):
    raw = GOOD[name]
    for at, new in edits:
        at %= len(raw)
        raw = raw[:at] + new + raw[at + len(new) :]
    path = folder(tmp_path_factory.mktemp("m"), GOOD | {name: raw[: len(raw) - cut]})
    try:
        splats = read_splats(path, "sog")
    except AlulaError:
        return  # anything else fails the test
    assert len(splats) == len(splats.loss.bound) > 0


REAL = {
    "playbot-lod-sog/2_0": (125_000, [-1.029, -1.082, -1.035], [1.032, 0.047, 1.037]),
    "playbot-lod-sog/3_0": (31_000, [-1.027, -1.082, -1.034], [1.030, 0.044, 1.037]),
    "playbot-lod-sog/4_0": (8_406, [-1.025, -1.081, -1.034], [1.027, 0.037, 1.033]),
    "playbot-lod-sog/5_0": (3_000, [-1.024, -1.078, -1.029], [1.027, 0.036, 1.029]),
    "playbot-lod-sog/6_0": (1_873, [-1.023, -1.075, -1.024], [1.023, 0.038, 1.029]),
    "playcanvas-logo-sog-v1": (307_128, [-1.535, -2.782, -0.577], [1.535, 0.296, 0.577]),
    "cc0-corpus/leica-sofort-top8192.sog": (8_192, [-15.020, -10.419, 1.454], [16.257, 16.552, 24.487]),
}


@pytest.mark.parametrize("name", REAL)
def test_real_scenes_have_their_counts_and_bounds(data, monkeypatch, name):
    count, lower, upper = REAL[name]
    splats = read_splats(data / name)
    assert len(splats) == count
    np.testing.assert_allclose(splats.mean.min(axis=0), lower, atol=1.1e-3)
    np.testing.assert_allclose(splats.mean.max(axis=0), upper, atol=1.1e-3)
    assert np.isfinite(splats.loss.bound).all()
    assert not splats.notes
    sog_reader = pytest.importorskip("gsply.sog_reader")
    pixels = types.SimpleNamespace(
        webp_decode=lambda raw: np.asarray(Image.open(io.BytesIO(raw)).convert("RGBA"))
    )
    monkeypatch.setattr(sog_reader, "imagecodecs", pixels)
    same_as_gsply(splats, sog_reader.sogread(data / name))


def test_each_level_of_the_robot_fills_the_box_of_the_index(data):
    index = json.loads((data / "playbot-lod-sog/lod-meta.json").read_text())
    box = index["tree"]["bound"]
    splats = read_splats(data / "playbot-lod-sog/2_0")
    assert (splats.mean >= np.array(box["min"]) - 1e-3).all()
    assert (splats.mean <= np.array(box["max"]) + 1e-3).all()
    for path in (data / "playbot-lod-sog", data / "playbot-lod-sog/lod-meta.json"):
        with pytest.raises(
            ArtifactError, match=r"SOG: an index of levels .* name one of them: 2_0/meta.json, 3_0"
        ):
            read_splats(path)


def test_a_real_scene_is_within_the_bound_of_its_ply(data):
    from scipy.spatial import cKDTree

    exact = read_splats(data / "cc0-corpus/leica-sofort-top8192.ply")
    lossy = read_splats(data / "cc0-corpus/leica-sofort-top8192.sog")
    away, row = cKDTree(exact.mean.astype(float)).query(lossy.mean.astype(float))
    assert len(np.unique(row)) == 8192
    bound = lossy.loss.bound.astype(float)
    assert (away <= bound[:, 0]).all()
    assert away.max() < 1.6e-3
    longer = (exact.scale[row].astype(float) / lossy.scale - 1).max(axis=1)
    largest = (lossy.scale == lossy.scale.max()).any(axis=1)
    assert (longer <= bound[:, 1])[~largest].all()
    turn = angles(lossy.quat_wxyz, exact.quat_wxyz[row].astype(float))
    assert (turn <= bound[:, 2] + 4e-7).all()
    assert min(away.max() / bound[:, 0].max(), turn.max() / bound[:, 2].max()) > 0.3
    assert np.abs(lossy.opacity - exact.opacity[row]).max() <= lossy.loss.opacity + 1e-6


def test_every_file_is_an_input_of_the_scene(tmp_path):
    there = folder(tmp_path / "a", encode(originals(300, span=3, spread=0.2)))
    out, world, voxels = (str(tmp_path / name) for name in ("s.scene.npz", "w.scene.npz", "v.voxels.npz"))
    assert main.run(["import-splat", str(there), "-o", out, "-q"]) == 0
    scene = read_artifact(Path(out))
    assert len(scene.manifest.inputs) == 6
    assert scene.arrays["loss"][:, 1].max() > 0
    assert "does not hold for certain" in scene.manifest.guarantee.statement
    assert main.run(["scale-align", out, "--scale", "1", "-o", world, "-q"]) == 0
    assert main.run(["voxelize", world, "-o", voxels, "-q"]) == 0
    assert len(read_artifact(Path(voxels)).arrays["index"]) > 0
