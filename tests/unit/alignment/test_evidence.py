"""Tables, COLMAP models and matrices as evidence for an alignment, and the errors of wrong ones."""

import json
import os
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.schemas.errors import AlulaError, InputError
from alula.stages.alignment.colmap import model_files, read_model
from alula.stages.alignment.evidence import match
from alula.stages.alignment.similarity import transform_points
from alula.stages.alignment.tables import parse_pairs, parse_positions, parse_reference
from alula.stages.alignment.transforms import parse_transform
from support.effort import examples


def test_columns_are_found_by_name():
    text = '\ufeffz, image ,note,X,y\r\n3,a.jpg,,1,2\r\n\r\n6,"b,c.jpg",hello,4,5\r\n'
    found = parse_positions(text, "t.csv")
    assert found.names == ("a.jpg", "b,c.jpg")
    np.testing.assert_array_equal(found.position, [[1, 2, 3], [4, 5, 6]])
    assert found.rows[1] == "t.csv row 4 (b,c.jpg)"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "t.csv: is empty"),
        ("image,x,y,z\n", "t.csv: has no rows"),
        ("image,x,y\na,1,2\n", "no column 'z' in the first line; it must be image,x,y,z"),
        ("a.jpg,1,2,3\n", "no column 'image'"),
        ("image,x,y,z\na,1,2,3\nb,1,2\n", "t.csv row 3: has 3 values, not 4"),
        ("image,x,y,z\na,1,2,3\nb,1,two,3\n", "t.csv row 3: y is 'two', not a finite number"),
        ("image,x,y,z\na,1,nan,3\n", "t.csv row 2: y is 'nan'"),
        ("image,x,y,z\na,1,2,inf\n", "t.csv row 2: z is 'inf'"),
        ("image,x,y,z\na,1,2,3\na,4,5,6\n", "t.csv row 3: image 'a' occurs twice"),
        ("image,x,y,z\n,1,2,3\n", "t.csv row 2: the image has no name"),
        ('image,x,y,z\n"a,1,2,3\n', "t.csv: is not CSV"),
    ],
)
def test_wrong_tables_are_refused_by_row(text, message):
    with pytest.raises(InputError, match=message):
        parse_positions(text, "t.csv")


def positions(*names, start=0.0):
    rows = [f"{name},{start + i},{start + i * i},0" for i, name in enumerate(names)]
    return parse_positions("\n".join(["image,x,y,z", *rows]), "t.csv")


def test_cameras_are_matched_by_name_in_the_order_of_the_reference():
    found = match(positions("a", "b", "c", "d"), positions("c", "a", start=5.0))
    np.testing.assert_array_equal(found.scene[:, 0], [2, 0])
    np.testing.assert_array_equal(found.world[:, 0], [5, 6])
    assert found.unused == 2
    assert found.unmatched == ()
    (unchecked,) = found.warnings
    assert "could not be checked: they come without 3D points" in unchecked


def test_rows_without_a_camera_are_skipped_and_counted_down_to_a_fraction():
    found = match(positions("a", "b", "c"), positions("a", "e", "c", "b", start=5.0))
    assert found.rows == ("t.csv row 2 (a)", "t.csv row 4 (c)", "t.csv row 5 (b)")
    np.testing.assert_array_equal(found.scene[:, 0], [0, 2, 1])
    np.testing.assert_array_equal(found.world[:, 0], [5, 7, 8])
    assert found.unmatched == ("e",)
    skipped, unchecked = found.warnings
    assert skipped == "1 of 4 rows were skipped: no camera has their image (e)"
    assert "could not be checked: they come without 3D points" in unchecked
    assert len(match(positions("a"), positions("a", "e", start=5.0)).rows) == 1
    refused = (
        r"t.csv row 3 \(e\): no camera has an image of that name; 2 of 3 rows name none, and 50% must name"
    )
    with pytest.raises(InputError, match=refused):
        match(positions("a", "b"), positions("a", "e", "f", start=5.0))
    with pytest.raises(InputError, match="1 of 4 rows name none, and 80% must name one"):
        match(positions("a", "b", "c"), positions("a", "e", "c", "b", start=5.0), min_matched=0.8)


def test_equal_points_are_refused_by_row():
    head = "sx,sy,sz,wx,wy,wz\n0,0,0,0,0,0\n1,0,0,2,0,0\n"
    assert len(parse_pairs(head, "p.csv").rows) == 2
    with pytest.raises(InputError, match=r"p.csv row 4: the same point in the scene as p.csv row 3"):
        parse_pairs(head + "1,0,0,3,0,0\n", "p.csv")
    with pytest.raises(InputError, match=r"p.csv row 4: the same point in the world as p.csv row 2"):
        parse_pairs(head + "3,0,0,0,0,-0.0\n", "p.csv")


@settings(max_examples=examples(150), deadline=None)
@given(
    st.binary(max_size=80).map(lambda raw: raw.decode("latin-1")),
    st.sampled_from(["", "image,x,y,z\n", "sx,sy,sz,wx,wy,wz\n", "image,lat,lon,alt\n"]),
)
def test_any_text_is_a_table_or_refused(text, head):
    for parse in (parse_positions, parse_reference, parse_pairs, parse_transform):
        with suppress(AlulaError):  # anything else fails the test
            parse(head + text, "t")


MATRIX = [[0, -2, 0, 1], [2, 0, 0, 2], [0, 0, 2, 3], [0, 0, 0, 1]]


@pytest.mark.parametrize(
    "form",
    [
        MATRIX,
        {"matrix": MATRIX},
        {"scale": 2, "rotation": [[0, -1, 0], [1, 0, 0], [0, 0, 1]], "translation_m": [1, 2, 3]},
    ],
)
def test_a_transform_has_three_forms(form):
    found = parse_transform(json.dumps(form), "t.json")
    np.testing.assert_allclose(transform_points(found, np.array([[1.0, 1, 1]])), [[-1, 4, 5]], atol=1e-12)
    assert found.scale == pytest.approx(2)


@pytest.mark.parametrize(
    ("form", "message"),
    [
        ("{", "is not JSON"),
        ("[" * 100_000, "is not JSON"),
        ("[[1, 2], [3, 4]]", "4x4 matrix"),
        ("[[1, 2], [3]]", "4x4 matrix"),
        ("3", "4x4 matrix"),
        (json.dumps([*MATRIX[:3], [0, 0, 0, 2]]), "last row 0 0 0 1"),
        (json.dumps([[-row[0], *row[1:]] for row in MATRIX]), "reflection"),
        (json.dumps([MATRIX[0], MATRIX[1], [0, 0, 2.01, 0], MATRIX[3]]), "not a rotation times a scale"),
        (json.dumps([[0, 0, 0, 0]] * 3 + [MATRIX[3]]), "the scale is 0"),
        (json.dumps([[float("nan")] * 4] * 3 + [MATRIX[3]]), "not finite"),
        ('{"scale": 2}', "needs a 4x4 matrix, or scale"),
        ('{"scale": -2, "rotation": [[1]], "translation_m": [0]}', "scale must be positive"),
        ('{"scale": 2, "rotation": [[1]], "translation_m": [0]}', "rotation must be 3x3"),
    ],
)
def test_transforms_that_are_no_similarity_are_refused(form, message):
    with pytest.raises(InputError, match=message):
        parse_transform(form, "t.json")


def data(name):
    pytest.importorskip("pycolmap")
    root = os.environ.get("ALULA_DATA")
    if not root:
        pytest.skip("ALULA_DATA is not set")
    return Path(root) / name


def centres_of_text(folder):
    """Camera centres by the text format's definition: -R' t."""
    centres = {}
    for line in (folder / "images.txt").read_text().splitlines():
        words = line.split()
        if len(words) != 10 or line.startswith("#"):  # lines of pixels have a multiple of three words
            continue
        q, t = np.array(words[1:5], float), np.array(words[5:8], float)
        w, v = q[0], q[1:]
        rotate = 2 * np.cross(v, np.cross(v, t) - w * t)  # q* t q - t
        centres[words[9]] = -(t + rotate)
    return centres


@pytest.mark.parametrize(
    "name", ["colmap-sceaux/colmap_example_model_txt", "colmap-unsorted-tiny", "colmap-maupertuis"]
)
def test_colmap_models_have_the_centres_of_their_text(name):
    folder = data(name)
    found, expected = read_model(folder), centres_of_text(folder)
    assert list(found.names) == sorted(expected)
    for image, position in zip(found.names, found.position, strict=True):
        np.testing.assert_allclose(position, expected[image], atol=1e-4)


@pytest.mark.parametrize("kind", ["text", "binary"])
def test_models_with_rigs_have_the_poses_of_their_images(tmp_path, kind):
    """Two cameras per rig: poses are products of the frame's and the sensor's."""
    pycolmap = pytest.importorskip("pycolmap")
    settings = pycolmap.SyntheticDatasetOptions()
    settings.num_rigs, settings.num_cameras_per_rig, settings.num_frames_per_rig = 2, 2, 3
    settings.num_points3D = 10
    pycolmap.set_random_seed(1)
    model = pycolmap.synthesize_dataset(settings)
    folder, text = tmp_path / kind, tmp_path / "as_text"
    for path in (folder, text):
        path.mkdir()
    (model.write_text if kind == "text" else model.write_binary)(str(folder))
    model.write_text(str(text))
    assert {"rigs", "frames", "images"} < set(model_files(folder))
    found, centres = read_model(folder), centres_of_text(text)
    assert len(found.names) == 12
    for name, position, axes in zip(found.names, found.position, found.axes, strict=True):
        np.testing.assert_allclose(position, centres[name], atol=1e-9)
        image = next(i for i in model.images.values() if i.name == name)
        point = position + 2 * axes[:, 2]  # straight ahead is the middle of the image
        camera = model.cameras[image.camera_id]
        np.testing.assert_allclose(image.project_point(point), camera.params[1:3], atol=1e-6)
        below = image.project_point(point + 0.01 * axes[:, 1])
        assert below[1] > camera.params[2]


def test_binary_and_text_models_agree():
    root = data("colmap-sceaux")
    text, binary = (read_model(root / f"colmap_example_model_{kind}") for kind in ("txt", "bin"))
    assert text.names == binary.names
    assert len(text.names) == 11
    np.testing.assert_allclose(text.position, binary.position, atol=6e-6)
    assert {p.suffix for p in model_files(root / "colmap_example_model_bin").values()} == {".bin"}


def test_folders_that_are_no_model_are_refused(tmp_path):
    with pytest.raises(InputError, match="is no COLMAP model: does not exist"):
        model_files(tmp_path / "none")
    with pytest.raises(InputError, match=r"is no COLMAP model: no cameras\.bin or cameras.txt"):
        model_files(tmp_path)
    pytest.importorskip("pycolmap")
    for name in ("cameras.txt", "images.txt", "points3D.txt"):
        (tmp_path / name).write_text("# nothing\n")
    with pytest.raises(InputError, match="no image of the COLMAP model is registered"):
        read_model(tmp_path)
    (tmp_path / "images.txt").write_text("1 what is this\n\n")
    with pytest.raises(InputError, match="is no readable COLMAP model"):
        read_model(tmp_path)


def text_model(folder, names):
    folder.mkdir()
    (folder / "cameras.txt").write_text("1 PINHOLE 640 480 500 500 320 240\n")
    (folder / "points3D.txt").write_text("")
    rows = [f"{7 - k} 1 0 0 0 {k} {k * k} {k % 3} 1 {name}\n1 2 -1\n" for k, name in enumerate(names)]
    (folder / "images.txt").write_text("# IMAGE_ID, ..., NAME\n" + "".join(rows))
    return folder


def test_names_with_spaces_in_a_text_model_keep_their_images_apart(tmp_path):
    pytest.importorskip("pycolmap")
    names = ["walk 1/a b.jpg", "walk 1/a  c.jpg", "walk 2/a b.jpg", "plain.jpg"]
    found = read_model(text_model(tmp_path / "model", names))
    assert set(found.names) == set(names)
    where = dict(zip(found.names, found.position.tolist(), strict=True))
    for k, name in enumerate(names):
        np.testing.assert_allclose(where[name], [-k, -k * k, -(k % 3)], atol=1e-12)
    with pytest.raises(InputError, match=r"images 6 and 7 have the same name, 'a b\.jpg'"):
        read_model(text_model(tmp_path / "twice", ["a b.jpg", "a b.jpg", "c.jpg"]))


@pytest.mark.parametrize(
    ("row", "camera", "says"),
    [
        (
            "a/{}.jpg",
            "{}.jpg",
            "without their folders 3 would match: name 'a/0.jpg' as the camera is, '0.jpg'",
        ),
        ("C:\\fly\\{}.jpg", "fly/{}.jpg", "without their folders 3"),
        ("fly\\{}.jpg", "fly/{}.jpg", "with / instead of"),
        ("IMG{}.JPG", "img{}.jpg", "without regard to case"),
        ("{}.png", "{}.jpg", "without folders and endings"),
        ("b{}.jpg", "a{}.jpg", None),
        ("{}.jpg", "a/{}.jpg\tb/{}.jpg", None),  # which one?
    ],
)
def test_names_that_differ_alike_are_hinted_at(row, camera, says):
    cameras = [part.format(k) for k in range(3) for part in camera.split("\t")]
    with pytest.raises(InputError, match="no camera has an image of that name") as found:
        match(positions(*cameras), positions(*(row.format(k) for k in range(3)), start=5.0))
    hint = str(found.value).partition("(--min-matched)")[2]
    assert (says in hint) if says else not hint


def table_of(names, where):
    rows = (f"{name},{x!r},{y!r},{z!r}" for name, (x, y, z) in zip(names, where.tolist(), strict=True))
    return "\n".join(["image,x,y,z", *rows])


@pytest.mark.parametrize("noise", [0.0, 1e-12, 1e-3], ids=["faces", "rounded faces", "hover"])
def test_one_image_of_each_place_counts(noise):
    """Four images at each of ten places; a hover has one reading of the receiver, but moves a little."""
    rng = np.random.default_rng(0)
    place = rng.uniform(-5, 5, (10, 3))
    scene = np.repeat(place, 4, axis=0) / 2.5 + noise * rng.standard_normal((40, 3))
    world = np.repeat(place + 0.01 * rng.standard_normal((10, 3)), 4, axis=0)
    names = [f"camera{k % 4}/{k // 4:03}.jpg" for k in range(40)]
    order = rng.permutation(40)
    shuffled = [names[k] for k in order]
    cameras, reference = (
        parse_positions(table_of(*table), "t.csv") for table in ((names, scene), (shuffled, world[order]))
    )
    found = match(cameras, reference)
    first = sorted({k // 4: at for at, k in reversed(list(enumerate(order.tolist())))}.values())
    np.testing.assert_array_equal(found.world, world[order][first])
    np.testing.assert_array_equal(found.scene, scene[order][first])
    assert found.facts["same_place"] == 30
    assert any(
        "30 of 40 images" in warning and "one of each of 10 places" in warning for warning in found.warnings
    )


def test_cameras_at_one_place_that_are_apart_in_the_other_frame_are_refused():
    where = np.random.default_rng(0).uniform(-5, 5, (6, 3))
    names = [f"{k}.jpg" for k in range(6)]
    twice = where.copy()
    twice[4] = twice[1]
    tables = [parse_positions(table_of(names, points), "t.csv") for points in (where, twice)]
    with pytest.raises(
        InputError, match=r"t\.csv row 6 \(4\.jpg\): the same point in the world as t\.csv row 3"
    ):
        match(*tables)
    with pytest.raises(InputError, match=r"the same point in the scene as .* but in the world they are"):
        match(*reversed(tables))
