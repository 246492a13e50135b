"""The corpus of `support/refused`: one line with the fault, exit code 3, no output, little memory."""

import gzip
import tracemalloc

import pytest

from alula.cli.main import run
from alula.schemas.errors import AlulaError
from alula.stages.reconstruction.formats.registry import read_splats
from support.paths import SUPPORT

CORPUS = SUPPORT / "refused"
WORDS = {
    "checkpoint-of-nerfacto.ckpt": "this model is no Gaussian splat: it has no gauss_params",
    "checkpoint-runs-code.ckpt": "os.system",
    "checkpoint-without-scales.ckpt": "the checkpoint lacks scales among its gauss_params",
    "compressed-four-billion-rows.ply": "PLY: truncated: 15625000 rows of chunk need 1125000000 bytes",
    "compressed-nan-bounds.ply": "chunk 0 has x from nan to",
    "compressed-too-few-chunks.ply": "400 Gaussians have 2 chunks of 256, not 1",
    "gltf-four-billion.gltf": "POSITION: 4000000000 rows end at byte 48000000000 of 48",
    "gltf-name-leads-out.gltf": "no name of a file in the same folder",
    "gltf-node-cycle.gltf": "node 0 is reached twice",
    "gltf-reflection.gltf": "its global matrix mirrors",
    "gltf-required-extension.gltf": "requires EXT_squeezed",
    "gltf-shear.gltf": "scales by 2, 1, 1 along three directions",
    "gltf-truncated.glb": "the header announces 2060 bytes, there are 1030",
    "gltf-unknown-kernel.gltf": "kernel 'cube' is not known",
    "gltf-view-out-of-range.gltf": "buffer view 2 ends at 1000000000048 of 224 bytes",
    "json-missing.json": "Gaussians need 'scalings'",
    "json-nan.json": "values that are not finite (not_a_number 1), the first in row 0; --drop-nan",
    "json-ragged.json": "'means', row 1 has 2 numbers, row 0 3",
    "ksplat-four-billion-rows.ksplat.gz": "KSPLAT: section 1: truncated: 4294967295 records",
    "ksplat-level-7.ksplat.gz": "KSPLAT: compression level 7 is not known",
    "ksplat-millions-of-sections.ksplat.gz": "KSPLAT: truncated: the headers of 4000000 sections",
    "ksplat-truncated-header.ksplat.gz": "KSPLAT: truncated: the header has 4096 bytes, there are 3000",
    "ksplat-version-0.ksplat.gz": "KSPLAT: version 0.0 is not supported",
    "ply-ascii-billions.ply": "PLY: truncated: 4000000000 rows",
    "ply-ascii-word.ply": "PLY: row 0 of vertex: 'hello' is not a number",
    "ply-count-is-text.ply": "PLY header: line 4 makes no sense: 'element vertex four'",
    "ply-four-billion-rows.ply": "PLY: truncated: 4000000000 rows of vertex need 224000000000 bytes",
    "ply-nan.ply": "1 of 4 Gaussians have values that are not finite (not_a_number 1), the first in row 0",
    "ply-no-end-of-header.ply": "PLY: truncated, or no line 'end_header'",
    "ply-overflowing-offsets.ply": "PLY: truncated",
    "ply-point-cloud.ply": "PLY: an ordinary point cloud or mesh, not a Gaussian splat",
    "ply-truncated-row.ply": "PLY: truncated: 4 rows of vertex need 224 bytes, there are 221",
    "sog-count-beyond-image.sog": "SOG: means_l.webp has 4 x 1 pixels, fewer than the 900 Gaussians",
    "sog-four-billion.sog": "SOG: means_l.webp has 4 x 1 pixels, fewer than the 4000000000 Gaussians",
    "sog-image-is-no-image.sog": "SOG: quats.webp is a WebP image without data",
    "sog-member-missing.sog": "SOG: scales.webp is not in the archive",
    "sog-meta-too-deep.sog": "SOG: meta.json is no JSON",
    "sog-name-leads-out.sog": "'../../etc/passwd' is no name of a file in the same folder",
    "sog-nan-codebook.sog": "SOG: meta.json is no JSON: NaN is no number of JSON",
    "sog-version-3.sog": "SOG: version 3 is not supported",
    "splat-truncated.splat": ".splat: truncated, or of another format: 123 bytes",
    "spz-bomb.spz": "bytes follow the data",
    "spz-degree-9.spz": "SPZ: spherical harmonics of degree 9",
    "spz-four-billion-points.spz": "SPZ: truncated: a file of 119 bytes does not hold 4294967295 Gaussians",
    "spz-truncated.spz": "SPZ: truncated",
    "spz-version-9.spz": "SPZ: version 9",
    "spz4-broken-zstd.spz": "positions is no zstd frame",
    "spz4-four-billion-points.spz": "does not hold 4294967295 Gaussians",
    "spz4-lying-table.spz": "SPZ: 4 Gaussians need 36 bytes of positions, not 1099511627776 as announced",
    "spz4-table-beyond-the-end.spz": "the table of streams at byte 1000000000 is not within the file",
}


def test_every_file_of_the_corpus_has_its_words():
    assert sorted(path.name for path in CORPUS.iterdir()) == sorted(WORDS)
    assert sum(path.stat().st_size for path in CORPUS.iterdir()) < 100_000


def unpacked(name, folder):
    raw = (CORPUS / name).read_bytes()
    path = folder / name.removesuffix(".gz")
    path.write_bytes(gzip.decompress(raw) if name.endswith(".gz") else raw)
    return path


@pytest.mark.parametrize("name", WORDS)
def test_a_refused_file_ends_in_one_line_and_no_output(tmp_path, capsys, name):
    path = unpacked(name, tmp_path)
    assert run(["import-splat", str(path), "-o", str(tmp_path / "out.scene.npz")]) == 3
    out, error = capsys.readouterr()
    assert out == ""
    assert error.startswith(f"alula: {path}")
    assert error.count("\n") == 1
    assert WORDS[name] in error.removeprefix(f"alula: {path}: ")
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("name", WORDS)
def test_a_refused_file_takes_no_memory(tmp_path, name):
    path = unpacked(name, tmp_path)
    tracemalloc.start()
    try:
        read_splats(path)
    except AlulaError:
        pass
    else:
        assert "nan" in name  # refused by the rules for rows
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < 30e6
