"""Capped covers from the command line: merged, verified, exported, planned and flown through."""

import json

import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import make_artifact, read_artifact, write_artifact
from alula.schemas.artifacts.kinds import COVER, VOXELS
from alula.stages.compression.hulls import Hulls

SHAPES = {
    "auto": ["--max-planes", "120"],
    "bytes": ["--max-bytes", "500"],
    "cap": ["--hulls", "9", "--facet-cap", "8"],
    "kdop": ["--hulls", "9", "--kdop", "14"],
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A sphere and a slanted slab, 0.1 m voxels."""
    grid = np.stack(np.meshgrid(*3 * [np.arange(-14, 15)], indexing="ij"), -1).reshape(-1, 3)
    x, y, z = grid.T
    solid = (np.linalg.norm(grid - [-6, 0, 0], axis=1) < 5) | (
        (np.abs(x + y - 8) < 2) & (np.abs(z) < 9) & (y > -4)
    )
    index = grid[solid]
    voxels = make_artifact(
        VOXELS,
        {"index": index, "overlap": np.ones(len(index))},
        **{"frame": "world", "unit": "m", "parameters": {}, "summary": {}},
        **{"voxel_size_m": 0.1, "sigma": 1.0, "min_overlap": 1},
    )
    write_artifact(tmp_path / "v.voxels.npz", voxels)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
def test_a_capped_cover_is_verified_planned_around_and_flown_past(folder, capsys, shape):
    for step in (
        ["merge", "v.voxels.npz", "-o", "c.cover.npz", *SHAPES[shape]],
        ["verify", "c.cover.npz", "--voxels", "v.voxels.npz"],
        [
            "plan",
            "c.cover.npz",
            "-o",
            "p.plan.npz",
            "--start",
            "-1.6 0 0",
            "--goal",
            "1.7 0.4 0",
            "--radius",
            "0.2",
            "--beyond-map",
            "2",
        ],
        ["simulate", "c.cover.npz", "-o", "r.run.mcap", "--trials", "3", "--set", "vehicle.radius_m=0.1"],
        [
            "simulate",
            "p.plan.npz",
            "-o",
            "p.run.mcap",
            "--map",
            "c.cover.npz",
            "--set",
            "vehicle.radius_m=0.1",
        ],
        ["export", "c.cover.npz", "-o", "c.stl"],
        ["export", "c.cover.npz", "-o", "c.cover.json"],
        ["report", "r.run.mcap", "--cover", "c.cover.npz", "-o", "r.html"],
    ):
        assert run([*step, "-q"]) == 0, (step, capsys.readouterr().err)
    hulls = Hulls.from_cover(read_artifact(folder / "c.cover.npz", COVER))
    lines = (folder / "c.stl").read_text().splitlines()
    corners = np.unique([[float(x) for x in t.split()[1:]] for t in lines if t.startswith("vertex ")], axis=0)
    known = np.unique(hulls.vertices_world, axis=0)
    assert np.abs(corners[:, None] - known[None]).max(axis=2).min(axis=1).max() == 0
    record = json.loads((folder / "c.cover.json").read_text())
    assert record["polytopes"] == "outer"
    for hull, mine in enumerate(record["hulls"]):
        planes, corners = np.array(mine["planes_m"]), np.array(mine["vertices_m"])
        side = corners @ planes[:, :3].T - planes[:, 3]
        assert side.max() < 1e-9
        assert ((side > -1e-9).sum(axis=1) >= 3).all(), hull
    for name in ("r", "p"):
        summary = json.loads((folder / f"{name}.run.json").read_text())["summary"]
        assert summary["collisions"] == 0
        assert summary["min_map_clearance_m"] > 0


def test_a_reader_that_lacks_outer_polytopes_refuses_them(folder, monkeypatch, capsys):
    assert run(["merge", "v.voxels.npz", "-o", "c.cover.npz", "--hulls", "5", "--facet-cap", "9", "-q"]) == 0
    assert run(["info", "c.cover.npz"]) == 0
    assert "outer" in capsys.readouterr().out
    monkeypatch.setattr("alula.schemas.artifacts.manifest.FEATURES", frozenset())
    assert run(["verify", "c.cover.npz"]) == 3
    assert "needs outer-polytopes" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "code", "text"),
    [
        (["--facet-cap", "5"], 2, "between 6 and"),
        (["--facet-cap", "some"], 2, "a number, auto or none"),
        (["--facet-cap", "auto", "--max-growth", "2"], 2, "distributes a budget"),
        (["--facet-cap", "8", "--kdop", "14"], 2, "exclude each other"),
        (["--kdop", "10"], 2, "6, 14, 18 or 26"),
        (["--max-bytes", "0"], 2, "at least 1"),
        (["--max-bytes", "60"], 5, "one hull needs 78"),
        (["--max-planes", "20", "--kdop", "26"], 5, "no cover with 20 half-planes"),
        (["--max-bytes", "80", "--facet-cap", "none"], 5, "80 bytes"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(folder, capsys, options, code, text):
    assert run(["merge", "v.voxels.npz", "-o", "c.cover.npz", *options]) == code
    error = capsys.readouterr().err
    assert text in error
    assert "Traceback" not in error
    assert not (folder / "c.cover.npz").exists()


def test_a_plane_moved_in_the_file_is_placed(folder, capsys):
    assert run(["merge", "v.voxels.npz", "-o", "c.cover.npz", *SHAPES["auto"], "-q"]) == 0
    cover = read_artifact(folder / "c.cover.npz")
    offset = cover["plane_offset"].copy()
    offset[7] -= 1
    fields = (
        "voxel_size_m",
        "sigma",
        "min_overlap",
        "conservativeness",
        "certificate",
        "polytopes",
        "requires",
    )
    common = ("frame", "unit", "parameters", "summary")
    known = {name: getattr(cover.manifest, name) for name in (*fields, *common)}
    write_artifact(
        folder / "c.cover.npz", make_artifact(COVER, {**cover.arrays, "plane_offset": offset}, **known)
    )
    capsys.readouterr()
    assert run(["verify", "c.cover.npz", "--voxels", "v.voxels.npz", "--json"]) == 4
    checks = json.loads(capsys.readouterr().out)["checks"]
    first = next(check["first"][0] for check in checks if not check["ok"])
    assert first["plane"] == 7
    assert first["hull"] == np.searchsorted(cover["plane_start"], 7, "right") - 1
    assert len(first["place_m"]) == 3
    assert (
        run(
            [
                "plan",
                "c.cover.npz",
                "-o",
                "p.plan.npz",
                "--start",
                "-1.6 0 0",
                "--goal",
                "1.7 0 0",
                "--beyond-map",
                "2",
            ]
        )
        == 3
    )
