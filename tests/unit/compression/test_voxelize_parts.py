"""Voxels of scenes in parts: the same marks as those of the whole, block by block."""

import dataclasses
import itertools
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.schemas.artifacts.artifact import Artifact, make_artifact, read_artifact
from alula.schemas.artifacts.kinds import SCENE, VOXELS
from alula.schemas.artifacts.manifest import SPLAT_LOSS
from alula.schemas.artifacts.parts import open_parts
from alula.schemas.artifacts.parts_join import read_whole
from alula.schemas.errors import InfeasibleError, InputError
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.stages.compression.ellipsoids import unproven_voxels
from alula.stages.compression.lattice_blocks import Block, crop_of
from alula.stages.compression.voxelize import voxelize
from alula.stages.compression.voxelize_parts import BlockVoxelizer, voxelize_whole
from support.effort import examples
from support.scenes.parted import write_parts


def some_scene(rng, rows, *, lossy, spread=2.0):
    arrays = {
        "mean": rng.uniform(-spread, spread, (rows, 3)),
        "scale": np.exp(rng.uniform(-4, -1, (rows, 3))),
        "quat_wxyz": rng.normal(size=(rows, 4)),
        "opacity": rng.uniform(0, 1, rows),
        "color": np.zeros((rows, 3), np.uint8),
    }
    arrays["quat_wxyz"] /= np.linalg.norm(arrays["quat_wxyz"], axis=1, keepdims=True)
    if lossy:
        arrays["loss"] = rng.uniform(0, 0.1, (rows, 3))
    return make_artifact(
        SCENE,
        arrays,
        frame="world",
        unit="m",
        parameters={},
        summary={},
        source={"removed": {"min_opacity": 3}},
        requires=[SPLAT_LOSS] if lossy else [],
    )


def blocks_of(config, parts, edge, folder, most=None):
    voxelizer = BlockVoxelizer(config, parts, edge, folder, most)
    blocks = voxelizer.blocks()
    return [
        (block, voxelizer.part(block, index, overlap, below))
        for block, index, overlap, below in voxelizer.marked(blocks, jobs=2)
        if len(index)
    ]


def equal(one, other):
    for name in ("index", "overlap"):
        np.testing.assert_array_equal(one[name], other[name], strict=True)


def outcome(make):
    """An artifact, or why there is none."""
    try:
        return make()
    except InfeasibleError as error:
        return str(error)


CROPS = st.one_of(
    st.none(),
    st.tuples(*[st.floats(-2.5, 1.0)] * 3, *[st.floats(0.1, 3.0)] * 3).map(
        lambda c: (*c[:3], *(a + b for a, b in zip(c[:3], c[3:], strict=True)))
    ),
)


@settings(deadline=None, max_examples=examples(20))
@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.tuples(st.integers(1, 6), st.booleans()), min_size=1, max_size=4),
    st.sampled_from([(3, None), (8, None), (100, None), (64, 1), (1024, 4)]),
    st.builds(
        VoxelizeConfig,
        size_m=st.sampled_from([0.25, 0.3]),
        sigma=st.floats(0.5, 2),
        min_overlap=st.integers(1, 2),
        crop=CROPS,
        min_opacity=st.sampled_from([0.0, 0.3]),
        inflation_m=st.sampled_from([None, 0.0, 0.05]),
        ignore_loss=st.booleans(),
    ),
)
def test_the_marks_of_parts_are_those_of_the_whole(seed, sizes, edges, config):
    """And each part is what the ordinary stage marks for the whole scene in the part's own crop."""
    edge, most = edges
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scenes = [some_scene(rng, rows, lossy=lossy) for rows, lossy in sizes]
        parts = open_parts(write_parts(folder / "a.scene", scenes))
        whole = read_whole(parts.path)
        known = outcome(lambda: voxelize(config, whole))
        made = outcome(lambda: voxelize_whole(BlockVoxelizer(config, parts, edge, folder, most)))
        if isinstance(known, str):
            assert made == known
            return
        equal(made, known)
        assert made.manifest.guarantee == known.manifest.guarantee
        for key in known.manifest.summary.keys() - {"notes"}:
            assert made.manifest.summary[key] == known.manifest.summary[key], key
        found = blocks_of(config, parts, edge, folder, most)
        for block, part in found[:: max(len(found) // 3, 1)]:
            alone = dataclasses.replace(config, crop=tuple(part.manifest.crop))
            equal(part, voxelize(alone, whole))
            assert (part["index"] >= block.lower).all()
            assert (part["index"] <= block.upper).all()


def test_blocks_that_too_many_ellipsoids_touch_are_halved(tmp_path):
    rng = np.random.default_rng(8)
    scenes = [some_scene(rng, 60, lossy=False) for _ in range(3)]
    parts = open_parts(write_parts(tmp_path / "a.scene", scenes))
    blocks = BlockVoxelizer(VoxelizeConfig(size_m=0.02), parts, 512, tmp_path, 24).blocks()
    edges = [block.upper[0] - block.lower[0] + 1 for block in blocks]
    assert len(set(edges)) > 1
    assert {512 % edge for edge in edges} == {0}
    assert [block.number for block in blocks] == list(range(len(blocks)))
    held = [sum(end - begin for _, begin, end in block.rows) for block in blocks]
    assert all(count <= 24 or edge == 16 for count, edge in zip(held, edges, strict=True))
    for one, other in itertools.combinations(blocks, 2):
        low, high = np.maximum(one.lower, other.lower), np.minimum(one.upper, other.upper)
        assert (low > high).any()


def test_a_part_is_proven_against_the_whole_scene_alone(tmp_path):
    rng = np.random.default_rng(5)
    parts = open_parts(
        write_parts(tmp_path / "a.scene", [some_scene(rng, 9, lossy=k == 0) for k in range(3)])
    )
    whole = read_whole(parts.path)
    config = VoxelizeConfig(size_m=0.2)
    for _, part in blocks_of(config, parts, 8, tmp_path)[:6]:
        level = {"voxel_size_m": 0.2, "sigma": 1.0, "crop": part.manifest.crop}
        assert unproven_voxels(whole, part["index"], **level).total == 0
        assert unproven_voxels(whole, part["index"][1:], **level).total == 1
        assert "as far as it touches the crop" in part.manifest.guarantee.statement
        assert "Gaussians lie outside" not in part.manifest.guarantee.statement
        assert part.manifest.guarantee.claims["left_out"]["removed_from_splat"] == {"min_opacity": 3}


@settings(deadline=None, max_examples=examples(200))
@given(
    st.tuples(*[st.integers(-50, 50)] * 3),
    st.integers(1, 6),
    st.sampled_from([0.05, 0.1, 1.0, 7.3]),
    st.tuples(*[st.integers(-240, 240)] * 3),
    st.tuples(*[st.integers(1, 100)] * 3),
)
def test_the_crop_of_a_block_touches_its_voxels_that_touch_the_crop(lower, edge, size, quarters, lengths):
    """Crops begin and end at quarters of voxels, at faces in particular."""
    block = Block(0, lower, tuple(c + edge - 1 for c in lower), ())
    ends = [q + n for q, n in zip(quarters, lengths, strict=True)]
    own = crop_of(block, size, [q / 4 * size for q in (*quarters, *ends)])
    everywhere = crop_of(block, size, None)
    for axis in range(3):
        assert own[axis] < own[axis + 3]
        voxels = np.arange(lower[axis] - 2, lower[axis] + edge + 2)
        inside = (voxels >= lower[axis]) & (voxels < lower[axis] + edge)
        touched = (4 * voxels + 4 >= quarters[axis]) & (4 * voxels <= ends[axis])  # exact
        if (inside & touched).any():  # other blocks have no voxels
            np.testing.assert_array_equal(touching(voxels, size, own, axis), inside & touched)
            np.testing.assert_array_equal(touching(voxels, size, everywhere, axis), inside)


def touching(voxels, size, box, axis):
    low, high = box[axis] - 1e-9 * size, box[axis + 3] + 1e-9 * size
    return ((voxels + 1) * size >= low) & (voxels * size <= high)


def test_blocks_hold_all_ellipsoids_that_reach_across_parts(tmp_path):
    """One voxel at a border is touched by ellipsoids of two parts on both sides of it."""
    rng = np.random.default_rng(3)
    scenes = []
    for x in (-0.21, 0.19):
        scene = some_scene(rng, 1, lossy=False)
        arrays = {
            **scene.arrays,
            "mean": np.float32([[x, 0.05, 0.05]]),
            "scale": np.full((1, 3), 0.25, np.float32),
            "opacity": np.ones(1, np.float32),
        }
        scenes.append(Artifact(scene.manifest, arrays))
    scenes = [make_artifact(SCENE, s.arrays, **_fields(s)) for s in scenes]
    parts = open_parts(write_parts(tmp_path / "a.scene", scenes))
    found = blocks_of(VoxelizeConfig(size_m=0.1), parts, 10, tmp_path)
    overlap = {
        tuple(i): int(n) for _, part in found for i, n in zip(part["index"], part["overlap"], strict=True)
    }
    assert overlap[-1, 0, 0] == overlap[0, 0, 0] == 2
    assert sum(1 for block, _ in found if block.lower[0] in (-10, 0)) >= 2
    assert max(len(block.rows) for block, _ in found) == 2


def _fields(scene):
    return {
        name: getattr(scene.manifest, name) for name in ("frame", "unit", "parameters", "summary", "source")
    }


def test_what_blocks_cannot_hold_is_refused(tmp_path):
    rng = np.random.default_rng(3)
    parts = open_parts(write_parts(tmp_path / "a.scene", [some_scene(rng, 20, lossy=False)]))
    config = VoxelizeConfig(size_m=0.1, max_voxels=50)
    with pytest.raises(InputError, match=r"the tile from \(.* has about .*; --max-voxels is 50;"):
        blocks_of(config, parts, 64, tmp_path)
    most = max(len(part["index"]) for _, part in blocks_of(VoxelizeConfig(size_m=0.1), parts, 64, tmp_path))
    with pytest.raises(InputError, match=r"the tile from \(.* has about "):  # after the work
        blocks_of(dataclasses.replace(config, max_voxels=most - 1), parts, 64, tmp_path)
    assert blocks_of(dataclasses.replace(config, max_voxels=most), parts, 64, tmp_path)
    with pytest.raises(InputError, match=r"write a folder \(-o NAME\.voxels\)"):
        voxelize_whole(BlockVoxelizer(config, parts, 2, tmp_path))
    with pytest.raises(InfeasibleError, match="no Gaussian has an opacity"):
        blocks_of(VoxelizeConfig(min_opacity=1.0), parts, 64, tmp_path)
    with pytest.raises(InputError, match="use a larger --tile"):
        blocks_of(VoxelizeConfig(size_m=1e-4), parts, 1, tmp_path)


def test_parts_far_from_the_crop_are_not_read(tmp_path):
    rng = np.random.default_rng(8)
    scenes = []
    for x in (0, 100):
        scene = some_scene(rng, 20, lossy=x == 0)
        arrays = {**scene.arrays, "mean": scene["mean"] + np.float32([x, 0, 0])}
        scenes.append(make_artifact(SCENE, arrays, **_fields(scene), requires=scene.manifest.requires))
    parts = open_parts(write_parts(tmp_path / "a.scene", scenes))
    crop = (-1.0, -1.0, -1.0, 1.0, 1.0, 1.0)
    configs = [VoxelizeConfig(size_m=0.2, crop=crop, min_opacity=opacity) for opacity in (0.0, 0.5)]
    known = [voxelize(config, read_whole(parts.path)) for config in configs]
    (tmp_path / "a.scene/part-00001.scene.npz").write_bytes(bytes(parts.refs[1].bytes))
    made = voxelize_whole(BlockVoxelizer(configs[0], parts, 16, tmp_path))
    equal(made, known[0])
    assert made.manifest.guarantee == known[0].manifest.guarantee
    with pytest.raises(InputError, match="does not match its SHA-256"):  # the opacities there count
        voxelize_whole(BlockVoxelizer(configs[1], parts, 16, tmp_path))


def test_large_gaussians_are_named(tmp_path):
    rng = np.random.default_rng(3)
    small = some_scene(rng, 150, lossy=False)
    large = {**small.arrays, "scale": small["scale"] * np.float32(0.1)}
    large["scale"][7] = 1.0
    scenes = [small, make_artifact(SCENE, large, **_fields(small))]
    parts = open_parts(write_parts(tmp_path / "a.scene", [scenes[1], scenes[1]]))
    note = voxelize_whole(BlockVoxelizer(VoxelizeConfig(size_m=0.1), parts, 16, tmp_path)).manifest.summary[
        "notes"
    ]
    assert note[0].startswith("Gaussian 7 of part 0, with a semi-axis of 1 m, alone fills ")


def test_the_command_writes_and_continues_parts(tmp_path, capsys, monkeypatch):
    from alula.cli import main

    rng = np.random.default_rng(11)
    city = write_parts(tmp_path / "city.scene", [some_scene(rng, 30, lossy=False) for _ in range(3)])
    out = tmp_path / "city.voxels"
    words = ["voxelize", str(city), "--size", "0.2", "--tile", "1.6"]
    one = tmp_path / "one.voxels.npz"
    assert main.run([*words, "-o", str(one), "-q"]) == 0
    assert main.run([*words, "-o", str(out), "-q"]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["city.scene", "city.voxels", "one.voxels.npz"]
    parts = open_parts(out, VOXELS)
    parts.check()
    assert len(parts) > 6
    equal(read_whole(out), read_artifact(one))
    assert parts.manifest.parameters["tile_voxels"] == 8
    assert parts.manifest.inputs == read_artifact(one).manifest.inputs
    assert parts.manifest.inputs[0].schema == "alula/scene"
    whole = {path.name: path.read_bytes() for path in out.iterdir()}

    original = BlockVoxelizer.part
    count = []

    def interrupted(self, *args):
        if len(count) == 4:
            raise KeyboardInterrupt
        count.append(1)
        return original(self, *args)

    capsys.readouterr()
    monkeypatch.setattr(BlockVoxelizer, "part", interrupted)
    again = [*words, "-o", str(tmp_path / "two.voxels")]
    assert main.run(again) == 130
    assert "4 parts" in capsys.readouterr().err
    monkeypatch.undo()
    assert main.run([*again, "-q"]) == 0
    assert {path.name: path.read_bytes() for path in (tmp_path / "two.voxels").iterdir()} == whole
    assert main.run([*words, "-o", str(out)]) == 0
    assert "unchanged" in capsys.readouterr().out
    (city / "part-00001.scene.npz").unlink()
    assert main.run([*words, "-o", str(tmp_path / "three.voxels")]) == 3
    assert capsys.readouterr().err == f"alula: {city}: part-00001.scene.npz is missing\n"
    assert not list(tmp_path.glob("three*"))
