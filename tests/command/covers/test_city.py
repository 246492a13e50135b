"""A city goes from its files to verified tile maps, in parts all the way."""

import json

import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import encode_artifact
from alula.schemas.artifacts.parts_join import read_whole
from alula.stages.reconstruction.formats.splat import RECORD


def write_tile(path, x, rng, count=300):
    """A `.splat` file, whose rotations are lossy: a piece of ground 4 m wide, with posts on it."""
    rows = np.zeros(count, RECORD)
    rows["mean"] = rng.uniform([x, 0, 0], [x + 4, 4, 0.1], (count, 3))
    rows["mean"][::5, 2] = rng.uniform(0, 2, len(rows["mean"][::5]))
    rows["scale"] = rng.uniform(0.05, 0.2, (count, 3))
    rows["rgba"] = 255
    quat = rng.normal(size=(count, 4))
    rows["quat"] = np.rint(127.5 * (1 + quat / np.linalg.norm(quat, axis=1, keepdims=True)))
    path.write_bytes(rows.tobytes())


@pytest.mark.slow
def test_from_files_to_verified_tiles(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(2)
    for number in range(3):
        write_tile(tmp_path / f"tile_{number}.splat", 4.0 * number, rng)
    steps = [
        "import-splat tile_0.splat tile_1.splat tile_2.splat -o city.scene",
        "scale-align city.scene -o metric.scene --scale 1",
        "voxelize metric.scene -o city.voxels --size 0.2 --tile 4",
        "merge city.voxels -o city.cover --block 3.2 --per-block --hulls 12 --jobs 1",
        "verify city.cover --voxels city.voxels --scene metric.scene --jobs 1 -o city.certificate.json",
        "export city.cover -o city.tiles --tiles 4 --reach 1.5",
        "verify city.tiles --voxels city.voxels --scene metric.scene -o tiles.certificate.json",
    ]
    for step in steps:
        assert run([*step.split(), "-q"]) == 0, (step, capsys.readouterr().err)
    proven = json.loads((tmp_path / "city.certificate.json").read_text())
    assert proven["covered"]
    assert len(proven["parts"]) > 2
    checks = {check["name"]: check for check in proven["checks"]}
    assert checks["every ellipsoid lies in the voxels"]["checked"] >= 900
    assert json.loads((tmp_path / "tiles.certificate.json").read_text())["covered"]
    part = f"city.cover/{proven['parts'][0]['name']}"
    words = ["verify", part, "--certificate", "city.certificate.json", "--voxels", "city.voxels"]
    words += ["--scene", "metric.scene"]
    assert run([*words, "-q"]) == 0
    assert run(["export", "city.cover", "-o", "city.tiles", "--tiles", "4", "--reach", "1.5"]) == 0
    assert "unchanged" in capsys.readouterr().out
    joined = encode_artifact(read_whole(tmp_path / "city.cover"))
    assert (tmp_path / "city.tiles" / "whole.cover.npz").read_bytes() == joined
    (tmp_path / "city.tiles" / "whole.cover.npz").write_bytes(b"another cover")
    assert run(["verify", "city.tiles"]) == 3
