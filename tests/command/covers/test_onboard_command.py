"""Onboard maps from the command line: written, compiled in, verified, explained; also of real scenes."""

import json
import shutil
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest

from alula import _core
from alula.cli.main import run
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.artifacts.provenance import read_provenance
from alula.schemas.parameters.configs.export import c_name
from alula.stages.compression.hulls import Hulls
from alula.stages.compression.onboard.image import decode_map
from support.paths import ROOT


@pytest.fixture
def here(pipeline, tmp_path, monkeypatch) -> Path:
    """A folder with a tiny cover, its voxels and its map, as the working folder."""
    for name in ("tiny.cover.npz", "tiny.voxels.npz", "tiny.map.bin", "tiny.metric.scene.npz"):
        shutil.copyfile(pipeline / name, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_file_is_the_image_and_a_line_that_flash_does_not_need(here, capsys):
    raw = Path("tiny.map.bin").read_bytes()
    image = decode_map(raw)
    head, _, line = raw[image.image_bytes :].decode().partition("alula-provenance: ")
    assert head == "\n"
    assert json.loads(line)["parameters"] == {"format": "onboard", "largest_normal": 127}
    assert image.cover_hash.hex() == read_provenance(Path("tiny.map.bin")).inputs[0].sha256[:16]
    assert run(["export", "tiny.cover.npz", "-o", "tiny.map.bin", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["status"] == "unchanged"
    Path("bare.bin").write_bytes(raw[: image.image_bytes])
    assert run(["verify", "bare.bin", "--voxels", "tiny.voxels.npz", "-q"]) == 0
    assert run(["info", "bare.bin", "-q"]) == 0


def test_a_damaged_map_is_not_taken_for_current(here, capsys):
    raw = bytearray(Path("tiny.map.bin").read_bytes())
    raw[100] ^= 1
    Path("tiny.map.bin").write_bytes(raw)
    assert run(["export", "tiny.cover.npz", "-o", "tiny.map.bin"]) == 2
    assert run(["export", "tiny.cover.npz", "-o", "tiny.map.bin", "-f", "-q"]) == 0
    assert run(["verify", "tiny.map.bin", "--cover", "tiny.cover.npz", "-q"]) == 0


def test_the_summary_counts_what_is_there(here, capsys):
    assert run(["export", "tiny.cover.npz", "-o", "again.bin", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)["summary"]
    assert Path("again.bin").read_bytes() == Path("tiny.map.bin").read_bytes()
    assert summary["hulls"] == 12
    assert summary["image_bytes"] == 64 + 14 * 12 + 5 * summary["oblique_planes"]
    assert summary["half_planes"] == 6 * 12 + summary["oblique_planes"]
    assert summary["bytes"] == Path("again.bin").stat().st_size


def test_26_directions_on_demand(here):
    words = ["export", "tiny.cover.npz", "--largest-normal", "1", "-q", "-o"]
    assert run([*words, "small.bin"]) == 0
    assert decode_map(Path("small.bin").read_bytes()).is_kdop
    assert run(["verify", "small.bin", "--cover", "tiny.cover.npz", "--voxels", "tiny.voxels.npz", "-q"]) == 0
    assert run([*words[:2], "--largest-normal", "128", "-q", "-o", "none.bin"]) == 2
    assert not Path("none.bin").exists()


def test_a_certificate_is_written_and_kept(here, capsys):
    words = ["verify", "tiny.map.bin", "--voxels", "tiny.voxels.npz", "--cover", "tiny.cover.npz"]
    words += ["--scene", "tiny.metric.scene.npz", "-o", "map.json"]
    assert run([*words, "-q"]) == 0
    record = json.loads(Path("map.json").read_text())
    assert record["covered"] is True
    assert [check["name"] for check in record["checks"]] == [
        "files agree",
        "margin covers single precision",
        "every voxel lies in a hull",
        "hulls contain the cover's",
        "every ellipsoid lies in the voxels",
    ]
    assert [ref["role"] for ref in record["provenance"]["inputs"]] == ["cover", "map", "scene", "voxels"]
    assert run([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["status"] == "unchanged"


def test_a_map_of_something_else_fails_with_a_place(here, capsys):
    image = bytearray(Path("tiny.map.bin").read_bytes())
    image[24:28] = (int.from_bytes(image[24:28], "little", signed=True) - 1).to_bytes(
        4, "little", signed=True
    )
    image[60:64] = zlib.crc32(image[:60]).to_bytes(4, "little")
    Path("tiny.map.bin").write_bytes(image)
    assert run(["verify", "tiny.map.bin", "--voxels", "tiny.voxels.npz", "-o", "map.json"]) == 4
    assert "not proven: every voxel lies in a hull: voxel is in no hull at (" in capsys.readouterr().err
    assert not Path("map.json").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("verify tiny.map.bin", "--voxels or --cover"),
        ("verify tiny.cover.npz --cover tiny.cover.npz", "is not an onboard map"),
        ("export tiny.voxels.npz -o x.bin", "voxels are exported as"),
        ("export tiny.metric.scene.npz -o x.bin", "a scene is exported as ply, splat, spz, glb, obj"),
    ],
)
def test_what_makes_no_sense_is_refused(here, capsys, words, said):
    assert run(words.split()) in (2, 3)
    assert said in capsys.readouterr().err


def test_info_says_what_it_is(here, capsys):
    assert run(["info", "tiny.map.bin", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["kind"] == "alula/onboard-map"
    assert facts["summary"]["hulls"] == 12
    assert facts["properties"]["voxel_size_m"] == 0.2
    assert facts["written by"]["parameters"]["format"] == "onboard"


def test_a_flight_on_the_map_is_clear_of_the_cover(here, capsys):
    words = ["simulate", "tiny.cover.npz", "--trials", "3", "--seed", "4", "--json"]
    assert run([*words, "-o", "a.run.mcap", "--set", "world.onboard=true"]) == 0
    summary = json.loads(capsys.readouterr().out)["summary"]
    assert summary["collisions"] == 0
    assert summary["filter_kind"] == "native"
    assert read_provenance(Path("a.run.mcap")).parameters["world"]["onboard"] is True
    assert run([*words, "-o", "b.run.mcap", "--set", "world.onboard=true", "--filter", "none"]) == 2
    assert "`$.world.onboard`: filters read the image, and there is none" in capsys.readouterr().err


PROGRAM = r"""
#include <stdio.h>
#include "alula_map.h"
#include "tiny-1.map.h"
#include "tiny-1.map.h"
int main(void) {
  alula_map map;
  alula_map_value value;
  const float x[3] = {2.0F, 1.5F, 1.0F};
  if (alula_map_open(&map, tiny_1_map, TINY_1_MAP_BYTES) != ALULA_MAP_READY) return 1;
  if (alula_map_evaluate(&map, x, &value) != ALULA_MAP_READY) return 2;
  printf("%u %u %.9g\n", (unsigned)map.hull_count, (unsigned)value.hull, (double)value.psi_m);
  return 0;
}
"""


@pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler")
def test_the_c_header_compiles_and_is_the_same_map(here):
    assert run(["export", "tiny.cover.npz", "-o", "tiny-1.map.h", "-q"]) == 0
    assert read_provenance(Path("tiny-1.map.h")).parameters["name"] == "tiny_1_map"
    Path("main.c").write_text(PROGRAM)
    include = [f"-I{ROOT / 'native/onboard/include'}"]
    include += [str(ROOT / "native/onboard/src" / name) for name in ("alula_map.c", "alula_map_index.c")]
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-ffp-contract=off"]
    flags += ["-fno-math-errno"]
    subprocess.run(["cc", *flags, "main.c", *include, "-o", "main"], check=True)
    printed = subprocess.run(["./main"], capture_output=True, text=True, check=True).stdout.split()
    raw = Path("tiny.map.bin").read_bytes()
    value, hull, _ = _core.OnboardMap(raw).psi(np.array([[2, 1.5, 1]], np.float32))
    assert printed[:2] == ["12", str(hull[0])]
    assert np.float32(printed[2]) == value[0]


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("room.map.h", "room_map"),
        ("int.h", "int_map"),
        ("4 räume.h", "map_4_r_ume_map"),
        ("_Map.h", "map__Map"),
    ],
)
def test_the_array_is_named_after_the_file(file, name):
    assert c_name(Path("folder") / file) == name


def check_scene(voxels: Path, scene: Path, hulls: int, folder: Path) -> dict:
    """Cover, map and certificate of a scene's voxels; the growth of the union by quantisation."""
    cover, file = folder / "c.cover.npz", folder / "c.map.bin"
    assert run(["merge", str(voxels), "-o", str(cover), "--hulls", str(hulls), "-q"]) == 0
    assert run(["export", str(cover), "-o", str(file), "-q"]) == 0
    against = ["--voxels", str(voxels), "--cover", str(cover), "--scene", str(scene)]
    assert run(["verify", str(file), *against, "-q"]) == 0
    made, image = read_artifact(cover), decode_map(file.read_bytes())
    exact = Hulls.from_cover(made)
    low, high = exact.vertices_world.min(axis=0), exact.vertices_world.max(axis=0)
    points = np.random.default_rng(0).uniform(low, high, (8000, 3)).astype(np.float32)
    native = _core.PolytopeCbf(
        np.ascontiguousarray(exact.normal_world),
        np.ascontiguousarray(exact.offset_m),
        np.ascontiguousarray(exact.plane_start),
        extent_m=float(np.abs([low, high]).max()) + 1,
        radius_m=0.1,
    )
    slack = 2 * native.map_arrays()[-1]
    before = native.psi(points.astype(np.float64))[1]
    onboard = _core.OnboardMap(file.read_bytes())
    after = onboard.psi(points)[0]
    assert (after[before <= -slack] <= 0).all()
    assert (after <= before + 0.25 * float(made.manifest.voxel_size_m) + slack).all()
    assert (before <= 0).sum() > 30
    return {
        "growth": float((after + onboard.margin_m <= 0).sum() / (before <= 0).sum()),
        "bytes_per_half_plane": image.image_bytes / len(made["plane_offset"]),
    }


@pytest.mark.slow
@pytest.mark.parametrize("tile", ["x000_y003", "x001_y000"])
def test_a_real_tile_keeps_its_size_and_costs_less_than_five_bytes_a_plane(tile, data, tmp_path):
    splat, f = data / f"istanbul-outdoor/tile_{tile}.splat", lambda name: str(tmp_path / name)
    assert run(["import-splat", str(splat), "-o", f("s.scene.npz"), "-q"]) == 0
    assert run(["scale-align", f("s.scene.npz"), "-o", f("m.scene.npz"), "--scale", "1", "-q"]) == 0
    assert run(["voxelize", f("m.scene.npz"), "-o", f("v.voxels.npz"), "--size", "0.25", "-q"]) == 0
    found = check_scene(tmp_path / "v.voxels.npz", tmp_path / "m.scene.npz", 300, tmp_path)
    assert found["bytes_per_half_plane"] < 5
    assert found["growth"] < 1.005


@pytest.mark.slow
def test_the_room_keeps_its_size_too(tmp_path):
    f = lambda name: str(tmp_path / name)  # noqa: E731
    assert run(["demo-scene", "-o", f("r.ply"), "--gaussians", "30000", "-q"]) == 0
    assert (
        run(
            [
                "import-splat",
                f("r.ply"),
                "-o",
                f("s.scene.npz"),
                "--min-opacity",
                "0.1",
                "--drop-floaters",
                "-q",
            ]
        )
        == 0
    )
    assert run(["scale-align", f("s.scene.npz"), "-o", f("m.scene.npz"), "--scale", "2", "-q"]) == 0
    assert run(["voxelize", f("m.scene.npz"), "-o", f("v.voxels.npz"), "--size", "0.05", "-q"]) == 0
    found = check_scene(tmp_path / "v.voxels.npz", tmp_path / "m.scene.npz", 200, tmp_path)
    assert found["bytes_per_half_plane"] < 5
    assert found["growth"] < 1.005
