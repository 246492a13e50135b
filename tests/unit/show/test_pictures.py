"""Pictures of views: what is where in them, what hides what, and which moment they show."""

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from alula.schemas.errors import UsageError
from alula.schemas.log.samples import Moving
from alula.schemas.parameters.configs.view import PictureConfig
from alula.stages.show.drawing.content import CUT, Camera, Copies, Decides, Faces, Gaussians, Lines
from alula.stages.show.drawing.picture import BACKGROUND, model_of, picture
from alula.stages.show.drawing.sight import Sight, sight_of, turned_to
from alula.stages.show.viewing import encode
from alula.stages.show.viewing.actors import ACTS_COLOR, moment, pose_at
from alula.stages.show.viewing.compose import Shown, content_of
from alula.stages.show.viewing.film import film, still
from alula.stages.show.viewing.follow import sights
from support.flights.viewed_runs import run_of
from support.scenes.fabricate import box, make_cover, make_scene, make_trial

UP = np.array([0.0, 0.0, 1.0])
SIZE = (96, 64)
FRONT = sight_of(Camera(np.array([0.0, -10, 0]), np.zeros(3)), SIZE, UP)


def ball(at, color, sigma=0.5, name="ball"):
    return Gaussians(
        name=name,
        mean=np.array([at], np.float32),
        covariance=sigma**2 * np.eye(3, dtype=np.float32)[None],
        color=np.array([color], np.uint8),
        opacity=np.ones(1, np.float32),
    )


def at(image, sight, point):
    column, row = np.floor(sight.pixels(np.array([point], float))[0]).astype(int)
    return image[row, column].astype(int)


def square(y, color, name="wall", size=9.0, **fields):
    corners = size * np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]], float) + [0, y, 0]
    return Faces(
        name=name, corners=corners, triangles=np.array([[0, 1, 2], [0, 2, 3]]), color=color, **fields
    )


def test_points_are_right_of_and_above_the_middle_where_they_are_in_the_world():
    image = picture([model_of([ball((2, 0, 1), (250, 0, 0), 0.2)])], FRONT)
    column, row = FRONT.pixels(np.array([[2.0, 0, 1]]))[0]
    assert column > SIZE[0] / 2
    assert row < SIZE[1] / 2
    assert at(image, FRONT, (2, 0, 1))[0] > 240
    assert at(image, FRONT, (2, 0, 1))[1] < 30
    assert (at(image, FRONT, (-2, 0, -1)) == BACKGROUND).all()


def test_a_parallel_projection_has_one_scale_everywhere():
    sight = Sight(
        R_camera_world=turned_to(np.array([0.0, 1, 0]), UP),
        position=np.zeros(3),
        focal=10.0,
        columns=96,
        rows=64,
        near_m=-100.0,
        is_parallel=True,
    )
    near, far = sight.pixels(np.array([[1.0, -5, 2], [1.0, 50, 2]]))
    assert near == pytest.approx([58, 12])
    assert far == pytest.approx(near)
    assert at(picture([model_of([ball((1, 50, 2), (0, 200, 0))])], sight), sight, (1, 0, 2))[0] < 20


def test_a_camera_that_looks_straight_down_has_a_rotation():
    R = turned_to(-UP, UP)
    assert pytest.approx(np.eye(3)) == R @ R.T
    assert np.linalg.det(R) == pytest.approx(1)


def test_matter_hides_what_is_behind_it_but_for_the_lines_of_a_flight():
    path = Lines(name="p", segments=np.array([[[-3.0, 2, 0], [3, 2, 0]]]), color=(255, 0, 0), width_px=60.0)
    wall, splat = model_of([square(0, (0, 0, 200))]), model_of([ball((0, 0, 0), (0, 0, 200), 3.0)])
    for hides in (wall, splat):
        hidden = at(picture([hides, model_of([path])], FRONT), FRONT, (0, 2, 0))
        assert hidden[0] < 10
        shines = at(picture([hides, model_of([path])], FRONT, through=0.4), FRONT, (0, 2, 0))
        assert shines[0] == pytest.approx(0.4 * 255, abs=8)
    front = replace(path, segments=path.segments - [0, 4, 0])
    assert at(picture([wall, model_of([front])], FRONT), FRONT, (0, -2, 0))[0] == 255


def test_near_sides_are_left_out_where_only_far_ones_are_drawn():
    facing, away = square(0, (200, 0, 0)), square(0, (200, 0, 0), far_only=True)
    assert at(picture([model_of([facing])], FRONT), FRONT, (0, 0, 0))[1] == 0
    assert (at(picture([model_of([away])], FRONT), FRONT, (0, 0, 0)) == BACKGROUND).all()  # its normal is -y
    behind = sight_of(Camera(np.array([0.0, 10, 0]), np.zeros(3)), SIZE, UP)
    assert at(picture([model_of([away])], behind), behind, (0, 0, 0))[1] == 0


def test_copies_are_drawn_where_they_are_and_hidden_parts_are_not():
    mesh = square(0, (0, 200, 0), size=1.0)
    many = Copies(
        name="c",
        corners=mesh.corners,
        triangles=mesh.triangles,
        position=np.array([[-3.0, 0, 0], [3, 0, 0]]),
        scale=np.ones((2, 3)),
        quat_wxyz=np.array([[1.0, 0, 0, 0], [0, 0, 1, 0]]),
        color=np.array([[0, 200, 0], [200, 0, 0]], np.uint8),
    )
    image = picture([model_of([many])], FRONT)
    assert at(image, FRONT, (-3, 0, 0))[0] == 0
    assert at(image, FRONT, (3, 0, 0))[1] == 0
    assert (at(image, FRONT, (0, 0, 0)) == BACKGROUND).all()
    assert (picture([model_of([replace(many, visible=False)])], FRONT) == np.array(BACKGROUND)).all()


def test_nothing_gives_the_background():
    assert (picture([model_of([])], FRONT) == np.array(BACKGROUND)).all()
    assert (still(content_of(Shown(title="t")), SIZE) == np.array(BACKGROUND)).all()


def test_the_path_so_far_is_thick_and_the_vehicle_at_its_end():
    (play,) = content_of(Shown(title="t", runs=[run_of([make_trial(0)])])).plays
    acts = np.zeros(len(play.time_s), bool)
    acts[:10] = True
    rest, flown, *vehicle = moment(replace(play, acts=acts), 2.03, color=(1, 2, 3))
    assert flown.segments[-1, 1] == pytest.approx([2.03, 0, 1], abs=1e-6)
    assert flown.segments[0, 0] == pytest.approx([0, 0, 1])
    assert rest.segments[-1, 1] == pytest.approx([5, 0, 1])
    assert flown.width_px > rest.width_px
    assert tuple(flown.color[0, 1]) == ACTS_COLOR
    assert tuple(flown.color[-1, 1]) == (1, 2, 3)
    body = next(part for part in vehicle if part.name.endswith("body"))
    assert body.corners.mean(axis=0) == pytest.approx([2.03, 0, 1], abs=0.05)


def test_a_moment_has_the_obstacle_that_decides_then_and_the_plans_joined_until_then():
    (play,) = content_of(Shown(title="t", runs=[run_of([make_trial(0)])])).plays
    corners, triangles = np.eye(3), np.array([[0, 1, 2]])
    rows = (play.time_s > 0.99) & (play.time_s < 2)
    decides = (Decides(name="hull 12", corners=corners, triangles=triangles, rows=rows),)
    plans = ((1.5, np.eye(3)), (3.0, 2 * np.eye(3)))
    play = replace(play, decides=decides, plans=plans)
    extra = {"/deciding/hull 12", "/new plan 1", "/new plan 2"}
    drawn = {at_s: {part.name for part in moment(play, at_s)} & extra for at_s in (0.5, 1.2, 1.7, 3.5)}
    assert drawn == {
        0.5: set(),
        1.2: {"/deciding/hull 12"},
        1.7: {"/deciding/hull 12", "/new plan 1"},
        3.5: {"/new plan 1", "/new plan 2"},
    }


def test_a_pose_between_samples_turns_the_short_way():
    (play,) = content_of(Shown(title="t", runs=[run_of([make_trial(0)])])).plays
    half = np.sqrt(0.5)
    turned = np.tile([half, 0, 0, half], (len(play.time_s), 1))
    turned[1::2] *= -1
    position, R = pose_at(replace(play, quat_world_body_wxyz=turned), 0.025)
    assert position == pytest.approx([0.025, 0, 1], abs=1e-6)
    assert pytest.approx(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), abs=1e-9) == R


def test_moving_obstacles_are_where_they_are_then_and_lost_tracks_are_not_drawn():
    time = np.linspace(0, 5, 51)
    place = np.stack([time, np.ones(51), np.ones(51)], axis=1)[:, None]
    track = np.where(time[:, None, None] < 2, place, np.nan)
    moving = Moving(position_world=place, track_world=track, radius_m=np.array([0.3]))
    (play,) = content_of(Shown(title="t", runs=[run_of([make_trial(0)], moving=moving)])).plays
    early, late = (
        {part.name: part for part in moment(play, at_s) if "obstacle " in part.name or "track" in part.name}
        for at_s in (1.0, 3.0)
    )
    assert early.keys() >= {"/moving obstacle 1", "/track 1"}
    assert "/track 1" not in late
    assert late["/moving obstacle 1"].corners.mean(axis=0) == pytest.approx([3, 1, 1], abs=1e-6)


def shown(**fields):
    return Shown(title="t", scenes=[("s", make_scene(200))], runs=[run_of([make_trial(0)], **fields)])


def test_each_camera_has_the_vehicle_in_its_picture():
    content = content_of(shown())
    (play,) = content.plays
    time = np.linspace(0, 5, 11).tolist()
    for kind in ("chase", "orbit", "fixed"):
        for each, when in zip(sights(kind, content, play, time, SIZE), time, strict=True):
            place = pose_at(play, when)[0]
            assert ((place - each.position) @ each.R_camera_world[2]) > each.near_m
            (pixel,) = each.pixels(place[None])
            assert (pixel > 0).all()
            assert (pixel < SIZE).all()
    chase = sights("chase", content, play, time, SIZE)[5]
    back, up = (chase.position - pose_at(play, 2.5)[0])[[0, 2]]
    assert back < 0 < up  # the flight is along x
    inside = sights("cockpit", content, play, time, SIZE)[5]
    assert inside.position == pytest.approx([2.5, 0, 1], abs=1e-6)
    assert inside.R_camera_world[2] == pytest.approx([1, 0, 0], abs=1e-3)


def test_a_camera_that_turns_with_a_flight_turns_slowly_where_it_crosses_the_middle():
    content = content_of(shown())
    middle = replace(content, camera=replace(content.camera, look_at=np.array([2.5, 1e-3, 1])))
    time = np.linspace(0, 5, 61)
    turned = sights("orbit", middle, middle.plays[0], time.tolist(), SIZE)
    ahead = np.array([each.R_camera_world[2, :2] for each in turned])
    angle = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    assert np.ptp(angle) > np.deg2rad(150)
    assert np.abs(np.diff(angle)).max() < np.deg2rad(11)


def test_what_is_far_from_the_origin_or_a_single_point_is_drawn_too():
    scene = make_scene(20)
    for place in (0.0, 1e11):
        scene["mean"][:], scene["color"][:], scene["opacity"][:] = place, 9, 1
        image = still(content_of(Shown(title="t", scenes=[("s", scene)])), SIZE)
        assert image[SIZE[1] // 2, SIZE[0] // 2].max() < 60


def test_a_film_shows_a_flight_at_its_own_speed_or_faster():
    content = content_of(shown())
    own = film(content, "fixed", SIZE, rate_hz=2, most_s=60, jobs=1)
    assert (len(own.frames), own.faster) == (11, 1.0)
    assert own.words[4][0].startswith("2.0 s   1.0 m/s")
    fast = film(content, "fixed", SIZE, rate_hz=2, most_s=2, jobs=1)
    assert (len(fast.frames), fast.faster) == (5, 2.5)
    assert fast.words[-1][0].startswith("5.0 s")
    assert (own.frames[0] != own.frames[5]).any()
    again = film(content, "fixed", SIZE, rate_hz=2, most_s=2, jobs=2)
    assert all((a == b).all() for a, b in zip(fast.frames, again.frames, strict=True))


def test_a_film_of_a_scene_without_flights_turns_around_it():
    content = content_of(Shown(title="t", scenes=[("s", make_scene(200))]))
    found = film(content, "chase", SIZE, rate_hz=1, most_s=3, jobs=1)
    assert len(found.frames) == 4
    assert found.words[0] == ("", False)
    assert (found.frames[0] != found.frames[1]).any()


def test_a_still_leaves_out_near_walls_and_a_chase_does_not(monkeypatch):
    from alula.stages.show.viewing import film as films

    drawn = []
    monkeypatch.setattr(
        films, "picture", lambda models, sight, **_: drawn.append(models) or np.zeros((2, 2, 3))
    )
    content = content_of(shown())
    content = replace(content, parts=(*content.parts, square(0, (1, 1, 1), f"{CUT}/wall")))
    still(content, SIZE)
    film(content, "chase", SIZE, rate_hz=0.1, most_s=10)
    has_wall = [any((model.color == 1).all(axis=1).any() for model in models) for models in drawn]
    assert has_wall == [False, True, True]


def test_a_map_beside_a_splat_has_faint_edges_and_no_faces_and_a_flown_plan_no_corridor():
    from alula.stages.show.viewing import film as films

    cover = make_cover([box((0, 0, 0), (10, 10, 10))])
    both = content_of(Shown(title="t", scenes=[("s", make_scene(50))], covers=[("c", cover)]))
    edges, rest = films._faded(both.parts)
    assert len(edges.ends) == 12
    assert (edges.line_opacity < 0.5).all()
    assert len(edges.corners) == len(rest.corners) == 0
    (alone,) = films._faded(content_of(Shown(title="t", covers=[("c", cover)])).parts)
    assert len(alone.corners) == 12
    assert (alone.line_opacity == 1).all()


def test_moving_pictures_keep_their_rate_and_their_last_frame():
    found = film(content_of(shown()), "fixed", SIZE, rate_hz=3, most_s=1, jobs=1)
    for data in (encode.webp(found, 3, "line"), encode.gif(found, 3, "line")):
        image = Image.open(io.BytesIO(data))
        assert (image.n_frames, image.size) == (4, SIZE)
        durations = []
        for k in range(4):
            image.seek(k)
            image.load()
            durations.append(image.info["duration"])
        assert sum(durations[:3]) == pytest.approx(1000, abs=10)
        assert durations[3] > 1000


def test_an_embedded_picture_is_bounded():
    noise = np.random.default_rng(1).integers(0, 256, (200, 300, 3)).astype(np.uint8)
    assert len(encode.still_webp(noise, 10**6)) > 40_000 > len(encode.still_webp(noise, 40_000))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"size": "640"}, "--size must be like 640x400, not 640"),
        ({"size": "-640x400"}, "--size must be like 640x400"),
        ({"size": "640x9"}, "--size must be from 16 to 4096 each way, not 640x9"),
        ({"size": "9999999999x400"}, "--size must be from 16 to 4096"),
        ({"seconds": 0.0}, "--seconds must be above 0 and at most 600, not 0"),
        ({"frames_per_second": 61.0}, "--frames-per-second must be above 0 and at most 60"),
        ({"size": "4096x4096", "seconds": 600.0}, "need too much memory"),
    ],
)
def test_pictures_that_cannot_be_made_are_refused(fields, message):
    with pytest.raises(UsageError, match=message):
        PictureConfig(**fields)
