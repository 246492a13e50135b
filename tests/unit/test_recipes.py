"""The recipes of CONTRIBUTING.md, followed to the letter in a copy of the tree."""

import json
import re
import zipfile

import numpy as np
import pytest

from support.paths import ROOT
from support.scratch import Scratch

BLOCK = re.compile(r"^```\w+ path=(\S+)(?: after=([^\n]+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def sections():
    text = (ROOT / "CONTRIBUTING.md").read_text()
    return {part.splitlines()[0]: BLOCK.findall(part) for part in text.split("\n## ")[1:]}


@pytest.fixture
def follow(sections, tmp_path):
    def do(name):
        scratch = Scratch(tmp_path)
        assert sections[name], "a recipe without a block"
        for path, after, text in sections[name]:
            scratch.write(path, text, after)
        return scratch

    return do


@pytest.mark.slow
def test_a_stage_and_its_command(follow, pipeline, tmp_path):
    scratch = follow("A stage and its command")
    out = tmp_path / "thin.voxels.npz"
    scratch.alula("thin", pipeline / "tiny.voxels.npz", "-o", out, "--min-overlap", 3)
    before, after = np.load(pipeline / "tiny.voxels.npz"), np.load(out)
    assert len(after["index"]) == (before["overlap"] >= 3).sum() > 0
    assert "alula thin room.voxels.npz" in scratch.alula("thin", "-h")
    assert scratch.run("-m", "alula.cli", "thin", "x", "-o", "y", "--min-overlap", "0").returncode == 2
    page = tmp_path / "commands.md"
    assert scratch.run("-m", "alula.cli.reference", str(page)).returncode == 0
    assert "## alula thin" in page.read_text()


@pytest.mark.slow
def test_a_filter(follow, pipeline, tmp_path):
    scratch = follow("A filter")
    out = tmp_path / "crawl.run.mcap"
    command = ("simulate", pipeline / "tiny.cover.npz", "-o", out, "--filter", "crawl", "--trials", 2)
    done = scratch.run("-m", "alula.cli", *map(str, command))
    assert done.returncode in (0, 4), done.stderr  # 4: the filter guarantees nothing
    record = json.loads(out.with_suffix(".json").read_text())
    assert record["filter"] == "crawl"
    assert all(trial["max_speed_m_s"] < 0.11 for trial in record["trials"])


def test_a_splat_format(follow, tmp_path):
    scratch = follow("A splat format")
    rows = np.float32([[0, 0, 0, 0.1], [1, 2, 3, 0.2]])
    (tmp_path / "two.dots").write_bytes(b"DOTS" + rows.tobytes())
    scratch.alula("import-splat", tmp_path / "two.dots", "-o", tmp_path / "two.scene.npz")
    scene = np.load(tmp_path / "two.scene.npz")
    assert (scene["mean"] == rows[:, :3]).all()
    assert (scene["scale"] == rows[:, 3:]).all()
    (tmp_path / "cut.dots").write_bytes(b"DOTS" + rows.tobytes()[:-1])
    words = ("import-splat", str(tmp_path / "cut.dots"), "-o", str(tmp_path / "cut.scene.npz"))
    cut = scratch.run("-m", "alula.cli", *words)
    assert cut.returncode == 3
    assert "dots: truncated" in cut.stderr


@pytest.mark.slow
def test_a_vehicle(follow, pipeline, tmp_path):
    scratch = follow("A vehicle")
    vehicle = scratch.root / "examples/vehicles/pebble.toml"
    assert "pebble" in scratch.alula("info", vehicle)
    out = tmp_path / "pebble.run.mcap"
    scratch.alula("simulate", pipeline / "tiny.cover.npz", "--vehicle", vehicle, "-o", out, "--trials", 2)
    assert "radius 0.05 m" in json.loads(out.with_suffix(".json").read_text())["vehicle"]


@pytest.mark.slow
def test_a_new_version_of_an_artifact(follow, pipeline, tmp_path):
    scratch = follow("A new version of an artifact")
    out = tmp_path / "new.voxels.npz"
    scratch.alula("voxelize", pipeline / "tiny.metric.scene.npz", "-o", out, "--size", 0.2)
    with zipfile.ZipFile(out) as archive:
        assert json.loads(archive.read("manifest.json"))["version"] == "1.1"
    for voxels in (out, pipeline / "tiny.voxels.npz"):  # the new version, and the one before
        scratch.alula("merge", voxels, "-o", tmp_path / f"{voxels.name}.cover.npz", "--hulls", 5)
    done = scratch.run("-c", "from alula.schemas.generate import documents; print(*documents())")
    assert "alula-voxels-1.1.schema.json" in done.stdout.split()
