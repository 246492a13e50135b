"""The first look at a splat: up, height and crop."""

import re

import numpy as np
import pytest

from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
from alula.stages.reconstruction.formats.registry import read_splats
from alula.stages.reconstruction.import_splat import import_splat
from alula.stages.reconstruction.look import (
    CONVENTION,
    Convention,
    convention_of,
    crop_of,
    height_of,
    up_given,
    up_of,
    up_of_cameras,
)
from support.files import splat_files

AXES = {
    "+x": (1, 0, 0),
    "-x": (-1, 0, 0),
    "+y": (0, 1, 0),
    "-y": (0, -1, 0),
    "+z": (0, 0, 1),
    "-z": (0, 0, -1),
}


def place(up):
    """A floor of 10 m x 8 m with posts, its z turned to an axis."""
    rng = np.random.default_rng(3)
    floor = np.column_stack([rng.uniform(-5, 5, 3000), rng.uniform(-4, 4, 3000), rng.normal(0, 0.01, 3000)])
    posts = np.column_stack([rng.normal(2, 0.5, 1500), rng.normal(1, 0.5, 1500), rng.uniform(0, 3, 1500)])
    points = np.concatenate([floor, posts])
    axis = int(np.argmax(np.abs(AXES[up])))
    sign = AXES[up][axis]
    turned = np.empty_like(points)
    turned[:, axis], turned[:, (axis + 1) % 3], turned[:, (axis + 2) % 3] = (
        sign * points[:, 2],
        *points[:, :2].T,
    )
    return turned


@pytest.mark.parametrize("up", AXES)
def test_up_is_the_axis_that_leads_away_from_the_floor(up):
    found = up_of(place(up))
    assert found.direction == AXES[up]
    assert f"{up} leads up from it" in found.why
    assert up_given(up).direction == found.direction
    assert height_of(place(up), found.direction) == pytest.approx(3, abs=0.1)


def weak(axis, share=0.05):
    """Gaussians all over a cube, some of them in a thin layer across an axis: a hint of a floor."""
    points = np.random.default_rng(4).uniform(-1, 1, (20_000, 3))
    points[: int(share * len(points)), axis] *= 0.001
    return points


Y_UP = Convention((0.0, 1.0, 0.0), "+y of a format", True)


def test_a_layer_with_few_gaussians_does_not_contradict_the_format_nor_make_x_up():
    for axis in range(3):
        found = up_of(weak(axis), Y_UP)
        assert found.direction == Y_UP.direction
        assert re.search(
            r"only \d% of the Gaussians, too few for a floor, so \+y of a format is taken", found.why
        )
    assert up_of(weak(0)).direction == CONVENTION
    found = up_of(weak(2))
    assert found.direction == AXES["+z"]
    assert "weak evidence" in found.why


def test_a_floor_counts_more_than_the_format():
    for up in AXES:
        found = up_of(place(up), Y_UP)
        assert found.direction == AXES[up]
        assert "weak" not in found.why


@pytest.mark.parametrize(
    ("frame", "up"),
    [
        ("RUB", "+y"), ("RUB by the specification; writers differ", "+y"), ("RDF", "-y"), ("LFU", "+z"),
        ("LBD", "-z"), ("glTF, y up", "+y"), ("nerfstudio training frame", "+z"), ("unnamed", "-y"),
    ],
)  # fmt: skip
def test_formats_that_state_their_frame_give_up(frame, up):
    found = convention_of({"frame": {"file": frame}})
    assert found.direction == AXES[up]
    assert found.is_stated == (frame != "unnamed")


@pytest.mark.parametrize(("axis", "direction"), [(0, (1, 0, 0)), (1, (0, -1, 0)), (2, (0, 0, 1))])
def test_between_two_equal_sides_of_a_layer_the_axis_of_most_writers_is_up(axis, direction):
    points = np.random.default_rng(4).uniform(-1, 1, (4000, 3))
    points[:1500, axis] *= 0.001
    assert up_of(points).direction == direction


def test_without_a_floor_up_is_that_of_most_trainers():
    ball = np.random.default_rng(1).normal(size=(2000, 3))
    assert up_of(ball).direction == CONVENTION
    assert "no floor" in up_of(ball).why


def test_up_of_cameras_is_opposite_to_the_mean_of_their_downward_axes():
    level = np.array([[[1.0, 0, 0], [0, 0, 1], [0, -1, 0]], [[-1.0, 0, 0], [0, 0, -1], [0, -1, 0]]])
    found = up_of_cameras(np.stack([np.column_stack([x, (0, -0.6, -0.8), z]) for x, _, z in level]))
    assert found.direction == pytest.approx((0, 0.6, 0.8))
    opposed = np.stack([np.eye(3), np.diag([1.0, -1.0, -1.0])])
    assert up_of_cameras(opposed).direction == CONVENTION


def test_the_crop_holds_the_matter_and_leaves_far_outliers_out():
    points = np.random.default_rng(2).uniform(0, 4, (5000, 3))
    assert crop_of(points) is None
    far = np.concatenate([points, [[400.0, 0, 0], [0, -300, 50]]])
    low, high, inside = crop_of(far)
    assert (low > -0.5).all()
    assert (high < 4.5).all()
    assert 0.97 < inside < 1


def test_the_twin_of_a_ply_in_spz_has_the_up_of_its_format(tmp_path):
    """Gaussians all over a place, 5 % of them in a wall across x, which is no floor."""
    g = splat_files.some_gaussians(4000)
    g.mean[:200, 0] = -3.9
    ups = {}
    for name, files in (("ply", splat_files.ply(g)), ("spz", splat_files.spz(g))):
        (file,) = files
        (tmp_path / file).write_bytes(files[file])
        splats = read_splats(tmp_path / file)
        source = import_splat(ImportSplatConfig(), splats).manifest.source
        ups[name] = up_of(splats.mean, convention_of(source))
    assert {name: up.direction for name, up in ups.items()} == {"ply": AXES["-y"], "spz": AXES["+y"]}
    assert all("too few for a floor" in up.why for up in ups.values())


@pytest.mark.parametrize(
    ("stated", "up"), [("z", "+z"), ("-Y", "-y"), ("+y", "+y"), ("x", "+x"), ("y", None), ("left", None)]
)
def test_the_vertical_axis_of_the_header_decides(stated, up):
    convention = convention_of({"frame": {"file": "unnamed"}, "tags": {"vertical_axis": stated}})
    found = up_of(place("+x"), convention)  # whatever the layers say
    assert found.direction == AXES[up or "+x"]
    assert (f"the header of the file states Vertical Axis: {stated.lower()}" == found.why) == (up is not None)


def test_a_roof_of_comparable_size_does_not_turn_a_place_upside_down():
    rng = np.random.default_rng(4)
    heights = (rng.normal(2.8, 0.01, 3000), rng.normal(0, 0.01, 2200), rng.uniform(0, 2.7, 5000))
    z = np.concatenate(heights)
    points = np.column_stack([rng.uniform(-10, 10, len(z)), rng.uniform(-8, 8, len(z)), z])
    found = up_of(points)
    assert found.direction == AXES["+z"]
    assert "weak evidence" in found.why
    assert up_of(points[np.r_[0:3000, 5200 : len(z)]]).direction == AXES["-z"]  # one layer, all below it
