"""A verdict names the level, the files that it had, and what it did not look at, in words and in JSON."""

import json

import msgspec
import numpy as np
import pytest
from scipy.stats import chi2

from alula.cli.main import run
from alula.schemas.artifacts.artifact import make_artifact, write_artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.stages.compression.level import beyond_words, level_words, mass_within
from alula.stages.compression.onboard.image import decode_map
from alula.stages.compression.onboard.layout import encode_map
from alula.stages.compression.onboard.verify import verify_map
from alula.stages.compression.verify import verify
from alula.stages.compression.voxelize import voxelize
from alula.stages.reporting.material import coverage
from support.scenes.covers import cover_of


def one_gaussian():
    arrays = {
        "mean": [[0.05, 0.05, 0.05]],
        "scale": [[0.2, 0.1, 0.1]],
        "quat_wxyz": [[1, 0, 0, 0]],
        "opacity": [1],
        "color": [[0, 0, 0]],
    }
    known = {"frame": "world", "unit": "m", "parameters": {}, "summary": {}, "source": {}}
    return make_artifact(SCENE, {name: np.array(rows, float) for name, rows in arrays.items()}, **known)


SCENE_FILE = one_gaussian()
VOXELS_FILE = voxelize(VoxelizeConfig(size_m=0.1), SCENE_FILE)
COVER_FILE = cover_of(VOXELS_FILE)


@pytest.mark.parametrize("sigma", [0.01, 0.5, 1.0, 2.0, 3.0, 10.0])
def test_the_mass_is_the_chi_square_distribution(sigma):
    assert mass_within(sigma) == pytest.approx(chi2.cdf(sigma**2, 3), rel=1e-9, abs=1e-15)


def test_the_printed_mass_is_rounded_to_claim_less():
    assert mass_within(1.0) == pytest.approx(0.198748, abs=1e-6)
    assert level_words(1.0) == "1 sigma (19.8 % of a Gaussian's mass)"
    assert beyond_words(1.0) == "what of each Gaussian lies beyond 1 sigma (80.2 % of its mass)"


@pytest.mark.parametrize(
    ("voxels", "scene", "words", "unchecked"),
    [
        (False, False, "covered: members in hulls (neither voxels nor scene were given: no ellipsoid was", 2),
        (
            True,
            False,
            "covered: every voxel in a hull (the scene was not given: no ellipsoid was checked)",
            1,
        ),
        (False, True, "covered: every ellipsoid of the scene at 1 sigma (19.8 % of a Gaussian's mass) in", 0),
        (True, True, "covered: every ellipsoid of the scene at 1 sigma (19.8 % of a Gaussian's mass) in", 0),
    ],
)
def test_a_verdict_says_what_it_had_and_what_it_did_not_look_at(voxels, scene, words, unchecked):
    found = verify(COVER_FILE, voxels=VOXELS_FILE if voxels else None, scene=SCENE_FILE if scene else None)
    assert found.covered
    assert found.statement.startswith(words)
    assert found.given == ["cover", *["voxels"] * voxels, *["scene"] * scene]
    assert len(found.not_checked) == unchecked
    assert found.level["sigma"] == 1.0
    assert found.level["mass_fraction"] == mass_within(1.0)
    assert "beyond 1 sigma (80.2 % of its mass)" in found.left_out


@pytest.mark.parametrize(
    ("level", "words"),
    [
        ({"min_opacity": 0.9}, "1 Gaussians of opacity below 0.9"),
        ({"min_overlap": 2}, "voxels that fewer than 2 ellipsoids touch"),
        ({"crop": (0.0, 0.0, 0.0, 0.1, 0.1, 0.1)}, "what lies outside the crop 0 0 0 0.1 0.1 0.1 m"),
        ({"ignore_loss": True}, "the loss of the splat file's format"),
    ],
)
def test_a_verdict_on_a_part_of_the_scene_says_so(level, words):
    arrays = {
        name: np.concatenate([SCENE_FILE[name]] * 2)
        for name in ("mean", "scale", "quat_wxyz", "opacity", "color")
    }
    arrays["opacity"] = np.array([1.0, 0.5])
    known = {"frame": "world", "unit": "m", "parameters": {}, "summary": {}}
    scene = make_artifact(SCENE, arrays, source={"removed": {"max_scale": 3, "crop": 0}}, **known)
    cover = cover_of(voxelize(VoxelizeConfig(size_m=0.1, **level), scene))
    found = verify(cover, scene=scene)
    assert found.covered
    assert found.statement.endswith(f"; not included: {words}, 3 Gaussians removed by max_scale")
    assert found.omits == [words]
    assert coverage(msgspec.to_builtins(found)) == "in part"
    silent = {key: value for key, value in msgspec.to_builtins(found).items() if key != "omits"}
    assert coverage(silent) == "in part"


def test_the_verdict_on_an_onboard_map_says_so_too():
    image = decode_map(encode_map(COVER_FILE, indexed=True, jobs=1))
    found = verify_map(image, cover=COVER_FILE)
    assert found.statement.startswith("covered: every member of the cover in a hull of the map (neither")
    assert found.given == ["map", "cover"]
    found = verify_map(image, voxels=VOXELS_FILE, scene=SCENE_FILE)
    assert found.statement.endswith("in voxels, every voxel in a hull of the map")
    assert (found.given, found.not_checked) == (["map", "voxels", "scene"], [])


def test_the_command_prints_the_verdict_and_writes_it(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, artifact in (("a.cover.npz", COVER_FILE), ("a.scene.npz", SCENE_FILE)):
        write_artifact(tmp_path / name, artifact)
    assert run(["verify", "a.cover.npz"]) == 0
    assert capsys.readouterr().out.startswith(
        "covered: members in hulls (neither voxels nor scene were given"
    )
    assert run(["verify", "a.cover.npz", "--scene", "a.scene.npz", "-o", "a.json", "--json"]) == 0
    record = json.loads((tmp_path / "a.json").read_text())
    assert record["statement"] == json.loads(capsys.readouterr().out)["statement"]
    assert record["level"]["mass_fraction"] == mass_within(1.0)
    assert (record["given"], record["not_checked"]) == (["cover", "scene"], [])
    assert record["version"] == "1.3"


def test_voxels_state_the_mass_of_their_level():
    statement = VOXELS_FILE.manifest.guarantee.statement
    assert "the 1-sigma ellipsoid (19.8 % of the mass) of a Gaussian" in statement
    assert VOXELS_FILE.manifest.guarantee.claims["mass_fraction"] == mass_within(1.0)
