"""Maps in tiles as a user makes, proves, explains and flies them: files, exit codes, messages."""

import hashlib
import hmac
import json
from pathlib import Path
from shutil import copytree

import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import write_artifact
from alula.schemas.artifacts.provenance import read_provenance
from alula.schemas.artifacts.tiles import read_tiles
from alula.schemas.log.run import read_run
from support.scenes.covers import cover_of, furniture, voxels_of
from support.scenes.small_scenes import line_plan
from support.scenes.tiled import KEY, posts

TILES = ["--tiles", "0.8", "--reach", "1.4"]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with voxels, a cover of them, another cover and two keys."""
    folder, voxels = tmp_path_factory.mktemp("made"), voxels_of(furniture(3, 16)[:-5])
    write_artifact(folder / "a.voxels.npz", voxels)
    write_artifact(folder / "a.cover.npz", cover_of(voxels, hulls=30))
    write_artifact(folder / "posts.cover.npz", posts(18, 18))
    (folder / "my.key").write_text(KEY.hex())
    (folder / "other.key").write_bytes(bytes(32))
    return folder


@pytest.fixture
def here(made, tmp_path, monkeypatch):
    """A copy of that folder, as the working folder."""
    copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def fails(capsys, code, *words):
    before = {path: path.stat().st_mtime_ns for path in Path().rglob("*")}
    assert run([str(word) for word in words]) == code
    assert {path: path.stat().st_mtime_ns for path in Path().rglob("*")} == before
    lines = capsys.readouterr().err.splitlines()
    return lines[-1]


def test_tiles_are_exported_proven_and_explained(here, capsys):
    assert run(["export", "a.cover.npz", "-o", "a.tiles", *TILES, "--sign", "my.key", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    summary, files = answer["summary"], read_tiles(Path("a.tiles"), KEY)
    assert answer["status"] == "written"
    assert summary["tiles"] == len(files.images) == summary["tiles_x"] * summary["tiles_y"]
    assert summary["largest_image_bytes"] == max(map(len, files.images))
    assert summary["hysteresis_m"] == pytest.approx(0.1)
    assert Path("a.tiles/tiles.sig").read_bytes() == hmac.digest(KEY, files.binary, "sha256")
    assert Path("a.tiles/whole.cover.npz").read_bytes() == Path("a.cover.npz").read_bytes()
    made = read_provenance(Path("a.tiles/tiles.json"))
    assert made.schema == "alula/tiles"
    assert made.inputs[0].sha256 == hashlib.sha256(Path("a.cover.npz").read_bytes()).hexdigest()
    assert KEY.hex() not in Path("a.tiles/tiles.json").read_text()

    first = Path("a.tiles/tiles.bin").read_bytes()
    assert run(["export", "a.cover.npz", "-o", "a.tiles", *TILES, "--sign", "my.key"]) == 0
    assert "a.tiles: unchanged" in capsys.readouterr().out
    line = fails(capsys, 2, "export", "a.cover.npz", "-o", "a.tiles", *TILES)
    assert "key_id was" in line
    assert run(["export", "a.cover.npz", "-o", "a.tiles", *TILES, "-f"]) == 0
    assert "not signed" in capsys.readouterr().err
    assert not Path("a.tiles/tiles.sig").exists()
    assert Path("a.tiles/tiles.bin").read_bytes() == first

    proof = ["verify", "a.tiles", "--voxels", "a.voxels.npz"]
    assert run([*proof, "-o", "a.certificate.json"]) == 0
    said = capsys.readouterr().out
    assert f"every voxel in a hull or a wall of each of {len(files.images)} tiles" in said
    assert "signature of the index does not exist" in said
    assert fails(capsys, 4, *proof, "--key", "my.key").endswith(
        "its index is not signed; export it with --sign"
    )
    assert run(["info", "a.tiles", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["kind"] == "alula/tiles"
    assert facts["summary"]["tiles"] == len(files.images)


def test_what_is_damaged_is_neither_proven_nor_flown_nor_left_as_it_is(here, capsys):
    assert run(["export", "a.cover.npz", "-o", "a.tiles", *TILES, "-q"]) == 0
    image = max(Path("a.tiles").glob("tile_*.bin"))
    raw = bytearray(image.read_bytes())
    raw[70] ^= 1
    image.write_bytes(bytes(raw))
    capsys.readouterr()
    for words in (
        ["verify", "a.tiles"],
        ["simulate", "a.tiles", "-o", "a.run.mcap"],
    ):
        assert fails(capsys, 3, *words) == f"alula: {image}: is not the image that tiles.json lists"
    assert run(["info", "a.tiles"]) == 3
    assert "tiles_x" in capsys.readouterr().out
    line = fails(capsys, 2, "export", "a.cover.npz", "-o", "a.tiles", *TILES)
    assert line.endswith("-f replaces it")
    assert run(["export", "a.cover.npz", "-o", "a.tiles", *TILES, "-f", "-q"]) == 0
    assert run(["verify", "a.tiles", "-q"]) == 0
    Path("a.tiles/mine.txt").write_text("not of alula")
    assert "other files" in fails(capsys, 2, "export", "a.cover.npz", "-o", "a.tiles", *TILES, "-f")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--tiles", "1"], "--tiles needs --reach"),
        (["--reach", "1"], "--reach and --hysteresis go with --tiles"),
        (["--tiles", "0", "--reach", "1"], "--tiles must be above 0"),
        ([*TILES, "--hysteresis", "0.5"], "at most half of --tiles"),
        ([*TILES, "--target", "c"], "--tiles goes with neither"),
        (["--sign", "my.key"], "--sign goes with --tiles"),
    ],
)
def test_options_that_make_no_sense_are_refused(here, capsys, words, message):
    assert message in fails(capsys, 2, "export", "a.cover.npz", "-o", "b.bin", *words)


def test_other_inputs_and_keys_are_refused(here, capsys):
    assert "is alula/voxels" in fails(capsys, 3, "export", "a.voxels.npz", "-o", "b.tiles", *TILES)
    bad = fails(capsys, 3, "export", "a.cover.npz", "-o", "b.tiles", *TILES, "--sign", "a.cover.npz")
    assert "a.cover.npz" in bad
    assert "too small for a hysteresis" in fails(
        capsys, 5, "export", "a.cover.npz", "-o", "b.tiles", "--tiles", "0.1", "--reach", "1"
    )
    assert "--key is for tiles" in fails(capsys, 2, "verify", "a.cover.npz", "--key", "my.key")


def test_a_simulation_reads_the_tiles_that_were_signed_and_flies_as_in_the_whole_map(here, capsys):
    export = ["export", "posts.cover.npz", "-o", "p.tiles", "--tiles", "0.6", "--reach", "1.3", "-q"]
    assert run([*export, "--sign", "my.key"]) == 0
    options = ["--trials", "4", "--set", "vehicle.radius_m=0.1", "-q"]
    whole = ["simulate", "posts.cover.npz", "-o", "whole.run.mcap", "--set", "world.onboard=true"]
    assert run([*whole, *options]) == 0
    assert run(["simulate", "p.tiles", "-o", "tiled.run.mcap", "--key", "my.key", *options]) == 0
    runs = [read_run(Path(f"{name}.run.mcap")) for name in ("whole", "tiled")]
    one, other = ([(t.outcome, t.steps, t.map_clearance_m) for t in each.trials] for each in runs)
    assert one == other
    assert {ref.role for ref in runs[1].provenance.inputs} == {"cover", "tiles"}
    capsys.readouterr()
    flown = ["simulate", "p.tiles", "-o", "no.run.mcap"]
    assert "does not match the key" in fails(capsys, 4, *flown, "--key", "other.key")
    assert "only polytope-cbf reads tiles" in fails(capsys, 2, *flown, "--filter", "dr-acbf")
    assert "the tiles reach 1.3 m" in fails(capsys, 2, *flown, "--speed", "4")
    Path("s.toml").write_text(
        'version = "2.0"\n[world]\ncover = "a.cover.npz"\ntiles = "p.tiles"\n'
        '[safety]\nfilters = ["polytope-cbf"]\n[vehicle]\ntype = "single-integrator"\n'
    )
    assert "cut from another cover" in fails(capsys, 3, "simulate", "s.toml", "-o", "no.run.mcap")
    unused = ["simulate", "posts.cover.npz", "-o", "no.run.mcap", "--set", "world.tile_load_s=1"]
    assert "there are no tiles" in fails(capsys, 2, *unused)
    lagging = [*flown, "--vehicle", "fastbridge", "--set", "vehicle.interface=velocity"]
    assert "a vehicle that lags" in fails(capsys, 2, *lagging, "--set", "world.tile_load_s=1")
    assert "--key is for tiles" in fails(capsys, 2, *unused[:4], "--key", "my.key")


def test_a_flight_is_refused_with_tiles_of_another_key_or_of_too_short_a_reach(here, capsys):
    assert run(["export", "posts.cover.npz", "-o", "p.tiles", *TILES, "--sign", "my.key", "-q"]) == 0
    write_artifact(here / "p.plan.npz", line_plan((-3.0, 0.45, 1.0), (3.0, 0.45, 1.0), 12.0))
    fly = ["fly", "p.plan.npz", "--map", "p.tiles", "--link", "sim:", "-o", "f.run.mcap"]
    assert "does not match the key" in fails(capsys, 4, *fly, "--key", "other.key")
    assert "--key is for tiles" in fails(capsys, 2, *fly[:3], "posts.cover.npz", *fly[4:], "--key", "my.key")
    assert "only polytope-cbf reads tiles" in fails(capsys, 2, *fly, "--filter", "none", "--key", "my.key")
