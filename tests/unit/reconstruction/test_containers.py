"""Archives and other files are called what they are; they never become Gaussians."""

import bz2
import gzip
import io
import lzma
import tarfile
import zipfile

import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.errors import ArtifactError
from alula.stages.reconstruction.formats.registry import read_splats
from alula.stages.reconstruction.formats.splat import RECORD
from support.files import splat_files


def zipped(names):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, raw in names.items():
            archive.writestr(name, raw)
    return out.getvalue()


def tarred(raw, mode="w"):
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode=mode) as archive:
        info = tarfile.TarInfo("scan.ply")
        info.size = len(raw)
        archive.addfile(info, io.BytesIO(raw))
    return out.getvalue()


PLY = splat_files.ply(splat_files.some_gaussians(500))["a.ply"]
ARCHIVES = {
    "gzip": (gzip.compress(PLY), r"a gzip stream around a PLY file; unpack it first \(gunzip\)"),
    "tgz": (tarred(PLY, "w:gz"), r"a gzip stream around a tar archive; .*tar xzf"),
    "zip": (zipped({"scan/a.ply": PLY, "b.txt": b"x"}), "a ZIP archive with scan/a.ply, b.txt; unpack it"),
    "zip of many": (zipped({f"{k}.ply": b"x" for k in range(9)}), "with 0.ply, 1.ply, 2.ply and 6 more"),
    "cut zip": (zipped({"a.ply": PLY})[:-30], "a ZIP archive; unpack it"),
    "tar": (tarred(PLY), "a tar archive"),
    "bzip2": (bz2.compress(PLY), "a bzip2 stream"),
    "xz": (lzma.compress(PLY), "an xz stream"),
    "zstd": (b"\x28\xb5\x2f\xfd" + PLY, "a zstd stream"),
    "7z": (b"7z\xbc\xaf\x27\x1c" + PLY, "a 7z archive"),
    "jpeg": (b"\xff\xd8\xff\xe0" + PLY, "no splat, but a JPEG image"),
    "page": (b"\n<!doctype HTML><p>" + b"not found " * 40, "a web page: the download gave a page"),
    "lfs": (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "git lfs pull"),
}


@pytest.mark.parametrize("name", ARCHIVES)
@pytest.mark.parametrize("suffix", [".bin", ".splat"])
@pytest.mark.parametrize("format_", ["auto", "splat"])
def test_a_container_is_named_with_what_to_do(name, suffix, format_, tmp_path):
    raw, words = ARCHIVES[name]
    path = tmp_path / f"a{suffix}"
    path.write_bytes(raw + bytes(-len(raw) % 32))  # so that it has whole records
    with pytest.raises(ArtifactError, match=words):
        read_splats(path, format_)


def test_no_advice_leads_from_an_archive_to_gaussians(tmp_path, capsys):
    path = tmp_path / "a.ply.gz"
    path.write_bytes(ARCHIVES["gzip"][0])
    out = tmp_path / "a.scene.npz"
    for words in (
        [],
        ["--format", "splat"],
        ["--format", "ksplat"],
        ["--format", "ply"],
        ["--format", "spz"],
    ):
        assert run(["import-splat", str(path), *words, "-o", str(out)]) == 3
        assert "--format splat" not in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize("words", [["info"], ["init"], ["view", "-o", "v.html"]])
def test_every_command_that_takes_a_splat_names_the_container(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.zip").write_bytes(ARCHIVES["zip"][0])
    assert run([words[0], "a.zip", *words[1:]]) == 3
    assert "a.zip: a ZIP archive with scan/a.ply, b.txt; unpack it first" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["a.zip"]


@pytest.mark.parametrize("seed", range(20))
def test_random_bytes_are_no_splat_whatever_they_are_called(seed, tmp_path):
    path = tmp_path / "a.splat"
    path.write_bytes(np.random.default_rng(seed).bytes(32 * 2254))
    with pytest.raises(ArtifactError, match="positions or sizes that no scene has"):
        read_splats(path)


def test_a_few_wild_records_and_a_whole_file_of_nan_are_left_to_the_rules_of_rows(tmp_path):
    rows = np.frombuffer(splat_files.splat(splat_files.some_gaussians(500))["a.splat"], RECORD).copy()
    rows["mean"][:100] = 1e20
    (tmp_path / "a.splat").write_bytes(rows.tobytes())
    assert len(read_splats(tmp_path / "a.splat")) == 500
    rows["mean"] = np.nan
    (tmp_path / "a.splat").write_bytes(rows.tobytes())
    assert len(read_splats(tmp_path / "a.splat")) == 500
