"""What a minimum opacity removes: the default keeps all that renderers draw, and a higher one is told."""

import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.parameters.configs.import_splat import DRAWN, ImportSplatConfig
from alula.stages.reconstruction.faint import marked_volume
from alula.stages.reconstruction.formats.ply import encode_ply
from alula.stages.reconstruction.formats.registry import read_splats
from alula.stages.reconstruction.formats.splats import Splats

EAST = np.array([1.0, 0, 0, 0], np.float32)


def splats(mean, scale, opacity):
    count = len(mean)
    return Splats(
        format="ply",
        mean=np.asarray(mean, np.float32),
        scale=np.broadcast_to(np.asarray(scale, np.float32), (count, 3)).copy(),
        quat_wxyz=np.tile(EAST, (count, 1)),
        opacity=np.asarray(opacity, np.float32),
        color=np.zeros((count, 3), np.uint8),
    )


def wall(x, opacity, layers=20):
    """A wall of 4 m x 3 m, 0.1 m thick, of layers of Gaussians of one opacity: x and the opacities."""
    y, z = np.meshgrid(np.arange(-2, 2.01, 0.1), np.arange(0, 3.01, 0.1))
    mean = [np.column_stack([np.full(y.size, x + 0.005 * k), y.ravel(), z.ravel()]) for k in range(layers)]
    return np.concatenate(mean), np.full(y.size * layers, opacity)


def room_with_a_faint_wall():
    """A solid wall at x = 0 and one of many faint Gaussians at x = 3, which lets no light pass."""
    solid, faint = wall(0.0, 0.9, 2), wall(3.0, 0.08)
    assert 1 - (1 - 0.08 * np.exp(-0.125)) ** 20 > 0.75  # what a ray between the centres of two still sees
    return splats(np.concatenate([solid[0], faint[0]]), 0.06, np.concatenate([solid[1], faint[1]]))


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "room.ply"
    path.write_bytes(b"".join(encode_ply(room_with_a_faint_wall())))
    return path


def test_a_wall_of_faint_gaussians_is_an_obstacle_by_default(file, tmp_path, capsys):
    """Each is below an opacity of 0.1, and together they are opaque."""
    names = [str(tmp_path / name) for name in ("a.scene.npz", "a.metric.scene.npz", "a.voxels.npz")]
    assert run(["import-splat", str(file), "-o", names[0]]) == 0
    assert "an opacity below 0.1 have" in capsys.readouterr().err
    assert run(["scale-align", names[0], "--scale", "1", "-o", names[1], "-q"]) == 0
    assert run(["voxelize", names[1], "--size", "0.1", "-o", names[2], "-q"]) == 0
    index = read_artifact(tmp_path / "a.voxels.npz")["index"]
    assert (np.abs((index[:, 0] + 0.5) * 0.1 - 3.0) < 0.1).sum() > 1000


def test_a_limit_that_removes_volume_says_how_much(file, tmp_path, capsys):
    out = tmp_path / "a.scene.npz"
    assert run(["import-splat", str(file), "-o", str(out), "--min-opacity", "0.1"]) == 0
    error = capsys.readouterr().err
    faint = 41 * 31 * 20
    assert f"--min-opacity 0.1 removed {faint} of {faint + 41 * 31 * 2} Gaussians (91%)" in error
    share = float(error.split("alone mark ")[1].split("%")[0]) / 100
    assert 0.45 < share < 0.65
    recorded = read_artifact(out).manifest.source["opacity"]
    assert [limit["limit"] for limit in recorded["limits"]] == [0.1]
    assert recorded["limits"][0]["cells"] / recorded["cells"] == pytest.approx(share, abs=0.006)
    assert run(["import-splat", str(file), "-o", str(out), "-f", "--min-opacity", "0.05"]) == 0
    assert "removed" not in capsys.readouterr().err


def test_info_says_it_before_the_import(file, capsys):
    assert run(["info", str(file)]) == 0
    out = capsys.readouterr().out
    assert "removed by a minimum opacity" in out
    row = next(line.split() for line in out.splitlines() if line.split()[:1] == ["0.1"])
    assert row[1] == str(41 * 31 * 20)
    assert float(row[3]) > 0.45
    row = next(line.split() for line in out.splitlines() if line.split()[:1] == ["0.05"])
    assert row[1:] == ["0", "0", "0"]


def test_the_default_removes_only_what_no_renderer_draws():
    assert ImportSplatConfig().min_opacity == DRAWN < 1 / 255
    assert np.float32(DRAWN) <= np.float32(1 / 255)  # the smallest opacity of formats of 8 bits stays


def test_cells_are_those_of_the_gaussians():
    """Points mark the cell that they lie in, and a cell is lost when all of its points are."""
    rng = np.random.default_rng(5)
    mean = (rng.uniform(-5, 5, (4000, 3)) * (1, 0.05, 0.05)).astype(np.float32)
    opacity = rng.choice([0.03, 0.15, 0.5], 4000, p=[0.5, 0.3, 0.2]).astype(np.float32)
    mean[:3] = np.nan
    found = marked_volume(*columns(splats(mean, 1e-6, opacity)), (0.1, 0.2, 0.02))
    mean, opacity = mean[3:].astype(float), opacity[3:]
    low, high = np.quantile(mean, [0.01, 0.99], axis=0)
    assert found.edge == pytest.approx((high - low).max() / 128)
    cell = np.floor((mean - low) / found.edge).astype(int)
    inside = (cell >= -8).all(axis=1) & (
        (mean - low) / found.edge < np.ceil((high - low) / found.edge) + 8
    ).all(axis=1)

    def cells(keep):
        return len({tuple(row) for row in cell[inside & keep]})

    whole = cells(opacity > 0)
    assert found.cells == pytest.approx(whole, rel=0.002)  # a point on a side marks both cells
    for limit, expected in zip(found.limits, (0.02, 0.1, 0.2), strict=True):
        assert limit.limit == expected
        assert limit.gaussians == (opacity < expected).sum()
        assert limit.cells == pytest.approx(whole - cells(opacity >= expected), rel=0.002)


def columns(made):
    return made.mean, made.scale, made.quat_wxyz, made.opacity


@pytest.mark.parametrize(
    "made",
    [
        splats([[np.nan] * 3] * 4, 1.0, [0.5] * 4),
        splats([[1.0, 2, 3]] * 4, 1.0, [0.5] * 4),
    ],
)
def test_nothing_to_measure_is_no_error(made):
    assert marked_volume(*columns(made)) is None


def test_huge_and_far_gaussians_are_measured():
    rng = np.random.default_rng(0)
    mean, scale = rng.normal(size=(300, 3)), np.full((300, 3), 0.01)
    mean[0], scale[1], scale[2], scale[3] = 1e30, 1e30, np.inf, 0.0
    found = marked_volume(*columns(splats(mean, scale, np.full(300, 0.05))))
    assert found.cells > 100_000  # one ellipsoid fills the whole box
    assert found.share(found.limits[3]) == 1.0


def test_street_tiles_lose_half_of_their_volume_below_a_tenth(data):
    """The reason for the default: these are captures of buildings."""
    made = read_splats(data / "istanbul-outdoor/tile_x000_y003.splat")
    found = marked_volume(*columns(made), (DRAWN, 0.1))
    assert found.share(found.limits[0]) == 0
    assert found.share(found.limits[1]) > 0.5
