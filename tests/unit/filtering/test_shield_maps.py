"""The shield over any static map, and the shield as a filter of its own."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from alula import _core
from alula.schemas.errors import UsageError
from alula.stages.clearance import hull_obstacles
from alula.stages.compression.hulls import Hulls
from alula.stages.compression.onboard.layout import encode_map
from alula.stages.filtering.bridge import NativeFilter
from alula.stages.filtering.ellipsoid_filters import certified_against, parameters_of
from alula.stages.filtering.protocol import FilterWorld
from alula.stages.filtering.registry import complete_parameters, make_filter
from support.models import backup_model as model
from support.models import quadrotor_model as body
from support.models.wrench_flight import (
    BACKUP,
    OK,
    RADIUS,
    RECOVERING,
    REFUSED,
    VEHICLE,
    Flight,
    admissible_start,
    attitude_controlled,
    empty_scene,
    moving,
    random_scene,
    shield_of,
    tick,
)
from support.scenes.small_scenes import box_cover

POLICY = _core.BackupPolicy(VEHICLE, "brake")


class RandomHulls:
    """Hulls of random points, as a map and as what judges paths."""

    def __init__(self, rng, count=40, size=4.0):
        normals, offsets, vertices, planes, corners = [], [], [], [0], [0]
        for _ in range(count):
            points = rng.uniform(-size, size, 3) + rng.normal(size=(10, 3)) * rng.uniform(0.05, 0.4, 3)
            hull = ConvexHull(points)
            normal = np.unique(hull.equations[:, :3].round(13), axis=0)
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            normals.append(normal)
            offsets.append((points @ normal.T).max(axis=0))
            vertices.append(points[hull.vertices])
            planes.append(planes[-1] + len(normal))
            corners.append(corners[-1] + len(hull.vertices))
        self.radius = RADIUS
        self.exact = _core.PolytopeSet(
            normals=np.vstack(normals),
            offsets=np.concatenate(offsets),
            plane_start=np.array(planes),
            vertices=np.vstack(vertices),
            vertex_start=np.array(corners),
        )
        self.map = _core.HullMap(self.exact)

    def clearance(self, positions):
        """Minimum distance of the polyline through positions (N, 3) to a hull, less the radius."""
        rows = np.ascontiguousarray(positions)
        return self.exact.clearance(rows[:-1], rows[1:], 10.0, 1).min() - self.radius


def states(rng, count):
    for _ in range(count):
        yield np.concatenate(
            [rng.uniform(-3, 3, 3), 0.2 * rng.normal(size=3), 1.5 * rng.normal(size=3), rng.normal(size=3)]
        )


def test_the_map_of_an_index_gives_the_certificates_of_the_index():
    for seed in range(3):
        rng = np.random.default_rng(seed)
        scene = random_scene(rng, 60)
        one, other = shield_of(scene), _core.Shield(POLICY, _core.EllipsoidMap(scene.index), RADIUS)
        for x in states(rng, 40):
            for thorough in (False, True):
                assert one.certify(x, thorough=thorough) == other.certify(x, thorough=thorough)


def test_certificates_among_hulls_agree_with_manoeuvres_flown_in_the_model():
    numpy, verdicts = model.Brake(), []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        hulls = RandomHulls(rng)
        shield = _core.Shield(POLICY, hulls.map, RADIUS)
        for x in states(rng, 5):
            got = shield.certify(x, thorough=True)
            positions, _ = model.manoeuvre(VEHICLE, numpy, x, 0.01, round(got["time_s"] / 0.01))
            clearance = hulls.clearance(positions)
            verdicts.append(got["safe"])
            if got["safe"]:
                assert clearance >= 0.02
            else:
                assert clearance < 0.02 + 2e-3
    assert any(verdicts)
    assert not all(verdicts)


def test_what_is_safe_in_a_union_is_safe_in_every_part():
    rng = np.random.default_rng(2)
    scene, hulls = random_scene(rng, 40), RandomHulls(rng, 20)
    box = _core.FenceMap(np.vstack([np.eye(3), -np.eye(3)]), np.full(6, 3.5))
    parts = [_core.EllipsoidMap(scene.index), hulls.map, box]
    shields = [_core.Shield(POLICY, part, RADIUS) for part in (*parts, _core.MapUnion(parts))]
    verdicts = [[shield.certify(x)["safe"] for shield in shields] for x in states(rng, 120)]
    assert [all(row[:3]) for row in verdicts] == [row[3] for row in verdicts]
    assert 5 < sum(row[3] for row in verdicts) < 100


def test_a_fence_is_a_wall_from_within():
    fence = _core.FenceMap(np.array([[1.0, 0, 0]]), np.array([3.0]))
    shield = _core.Shield(POLICY, fence, RADIUS)
    far = [x for x in np.linspace(-3, 2.8, 117) if shield.certify(moving((4, 0, 0), (x, 0, 0)))["safe"]]
    positions, _ = model.manoeuvre(VEHICLE, model.Brake(), moving((4, 0, 0), (max(far), 0, 0)), 0.01, 250)
    clearance = 3 - positions[:, 0].max() - RADIUS
    assert 0.02 - 0.01 <= clearance < 0.02 + 0.06  # steps of 5 cm
    assert not shield.certify(moving((0, 0, 0), (3.1, 0, 0)))["safe"]


def test_a_shield_without_ellipsoids_has_no_cones_to_escape():
    with pytest.raises(ValueError, match="cone-escape needs ellipsoids"):
        _core.Shield(_core.BackupPolicy(VEHICLE, "cone-escape"), _core.FenceMap(np.eye(3), np.ones(3)), 0.1)
    with pytest.raises(ValueError, match="radius"):
        _core.Shield(POLICY, _core.FenceMap(np.eye(3), np.ones(3)), -0.1)


def test_the_filter_passes_the_nominal_wrench_bit_by_bit_where_it_is_safe():
    flown = _core.ShieldFilter(POLICY, _core.EllipsoidMap(empty_scene().index), RADIUS)
    wrench = (4.6, 0.01, -0.02, 0.001)
    got = tick(flown, moving((2, 0, 0)), wrench, nominal_thrust_rate=3.0)
    assert got["status"] == OK
    assert got["wrench"] == list(wrench)
    assert got["certified"]
    assert got["thrust_rate"] == 3.0
    assert got["margin"] == np.inf
    beyond = tick(flown, moving((0, 0, 0)), (100.0, 0, 0, 0))
    assert beyond["status"] != OK
    assert VEHICLE.admissible(np.array([beyond["wrench"]]), tolerance_n=1e-9)[0]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_the_filter_refuses_what_is_not_finite(bad):
    flown = _core.ShieldFilter(POLICY, RandomHulls(np.random.default_rng(0)).map, RADIUS)
    x = moving((0, 0, 0))
    x[7] = bad
    got = tick(flown, x, (4.5, 0, 0, 0))
    assert got["status"] == REFUSED
    assert not got["certified"]
    assert got["wrench"] == [pytest.approx(VEHICLE.hover_thrust), 0, 0, 0]


@pytest.mark.parametrize("shape", ["hulls", "both"])
def test_no_nominal_input_reaches_an_obstacle(shape):
    """Straight into the nearest wall at full tilt, and random wrenches: all ticks certified and clear."""
    flights, statuses = 0, set()
    for seed in range(3):
        rng = np.random.default_rng(seed)
        hulls, scene = RandomHulls(rng, 30), random_scene(rng, 30)
        map_ = hulls.map
        if shape == "both":
            map_ = _core.MapUnion([_core.EllipsoidMap(scene.index), hulls.map])
        shield, flown = _core.Shield(POLICY, map_, RADIUS), _core.ShieldFilter(POLICY, map_, RADIUS)

        def into_the_wall(_, x, map_=map_):
            nearest = map_.near(tuple(x[:3]), 20.0, 1)
            return attitude_controlled(VEHICLE, x, -8 * nearest["normal"][0])

        def at_random(_, __, rng=rng):
            return np.array([body.fastbridge().hover_thrust + 3 * rng.normal(), *0.05 * rng.normal(size=3)])

        for nominal in (into_the_wall, into_the_wall, at_random):
            flown.reset()
            flight = Flight(hulls, VEHICLE, flown, admissible_start(rng, shield), nominal, 250)
            flights += 1
            assert all(report["certified"] for report in flight.reports)
            assert flight.clearance > 0
            if shape == "both":
                assert scene.clearance(flight.positions) > 0
            statuses |= {report["status"] for report in flight.reports}
    assert flights == 9
    assert BACKUP in statuses
    assert RECOVERING not in statuses


def world(hulls=None, **others):
    return FilterWorld(
        index=empty_scene().index,
        body=VEHICLE,
        gains=_core.TrackingGains(),
        radius_m=RADIUS,
        dt_s=0.01,
        polytopes=hulls,
        **others,
    )


@pytest.mark.parametrize("name", ["cone-ecbf", "cone-backup", "shield"])
def test_filters_certify_against_what_shield_map_names(name):
    """Beside a hull that no ellipsoid stands for, only the shields that have the hulls refuse to fly on."""
    lower, upper = np.array([1.0, -1, -1]), np.array([2.0, 1, 1])
    corners = np.array([np.where([i & 1, i & 2, i & 4], upper, lower) for i in range(8)])
    wall = _core.PolytopeSet(
        normals=np.vstack([np.eye(3), -np.eye(3)]),
        offsets=np.concatenate([upper, -lower]),
        plane_start=np.array([0, 6]),
        vertices=corners,
        vertex_start=np.array([0, 8]),
    )
    x, wrench = moving((4, 0, 0), (0.3, 0, 0)), (HOVER := VEHICLE.hover_thrust, 0, 0, 0)
    certified = {}
    for against in ("ellipsoids", "hulls", "both"):
        made = make_filter(name, world(wall, inflation_m={"hulls": 0.1 - RADIUS}), {"shield_map": against})
        assert isinstance(made, NativeFilter)
        certified[against] = tick(made.native, x, wrench, HOVER)["certified"]
        assert certified_against(name, made.parameters) == against
    assert certified == {"ellipsoids": True, "hulls": False, "both": False}
    with pytest.raises(UsageError, match=f"{name}: shield_map=both needs the hulls of a cover"):
        make_filter(name, world(), {"shield_map": "both"})
    with pytest.raises(UsageError, match="shield_map"):
        make_filter(name, world(), {"shield_map": "walls"})


def test_a_shield_certifies_against_all_that_a_flight_has():
    def of(**has):
        return complete_parameters("shield", {}, **has)["shield_map"]

    assert of(has_hulls=True) == "both"
    assert of() == "ellipsoids"
    assert of(has_ellipsoids=False, has_hulls=True) == of(has_ellipsoids=False) == "hulls"
    given = complete_parameters("cone-backup", {"shield_map": "ellipsoids"}, has_hulls=True)
    assert given["shield_map"] == "ellipsoids"


def test_shield_map_needs_a_shield():
    with pytest.raises(UsageError, match="shield_map is for shield=true"):
        parameters_of("cone-backup", {"shield": False, "shield_map": "hulls"})
    assert certified_against("cone-backup", parameters_of("cone-backup", {"shield": False})) is None
    assert certified_against("cone-di", parameters_of("cone-di", {})) is None


def test_what_is_safe_by_an_image_is_clear_of_the_hulls_of_its_cover():
    rng, verdicts = np.random.default_rng(6), []
    low = rng.integers(-30, 25, (30, 3))
    cover = box_cover(np.stack([low, low + rng.integers(2, 8, (30, 3))], axis=1))
    exact = hull_obstacles(Hulls.from_cover(cover))
    by_image = _core.Shield(POLICY, _core.ImageMap(encode_map(cover)), RADIUS)
    by_hulls = _core.Shield(POLICY, _core.HullMap(exact), RADIUS)
    for x in states(rng, 60):
        one, other = by_image.certify(x), by_hulls.certify(x)
        verdicts.append((one["safe"], other["safe"]))
        assert other["safe"] or not one["safe"]
    safe = sum(one for one, _ in verdicts)
    assert safe > 10
    assert sum(other for _, other in verdicts) < 60
