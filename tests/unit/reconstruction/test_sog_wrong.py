"""Damaged SOG: each fault has its own message, mutated bytes have any."""

import io
import zipfile
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.schemas.errors import AlulaError, ArtifactError
from alula.stages.reconstruction.formats.registry import read_splats
from support.effort import examples
from support.files.originals import originals
from support.files.sog_encoder import bundle, changed, encode, folder, webp


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
        with pytest.raises(ArtifactError, match=r"not a splat file|a ZIP archive with x"):
            read_splats(tmp_path / "x.json")


EDITS = st.lists(st.tuples(st.integers(0, 10**6), st.binary(min_size=1, max_size=4)), min_size=1, max_size=4)


@settings(max_examples=examples(150), deadline=None)
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


@settings(max_examples=examples(200), deadline=None)
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
