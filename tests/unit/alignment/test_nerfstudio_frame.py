"""Transform from the frame that nerfstudio trains in to that of the source poses."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from alula.schemas.errors import InputError
from alula.stages.alignment.evidence import Correspondences, in_training_frame
from alula.stages.alignment.nerfstudio import parse_training_frame, transform_files
from alula.stages.alignment.robust import fit_similarity
from alula.stages.alignment.similarity import transform_points
from support.effort import examples


def frame(seed=0, scale=0.3):
    rng = np.random.default_rng(seed)
    A = Rotation.random(random_state=seed).as_matrix()
    b = rng.normal(size=3)
    return A, b, json.dumps({"transform": np.column_stack([A, b]).tolist(), "scale": scale})


@settings(max_examples=examples(30), deadline=None)
@given(st.integers(0, 2**31), st.floats(1e-3, 1e3))
def test_training_is_undone(seed, scale):
    A, b, text = frame(seed, scale)
    original = np.random.default_rng(seed).normal(size=(5, 3))
    training = scale * (original @ A.T + b)
    found = parse_training_frame(text, "d.json")
    np.testing.assert_allclose(transform_points(found.original_from_training, training), original, atol=1e-9)
    assert found.original_from_training.scale == pytest.approx(1 / scale)
    assert found.warnings == ()


def test_evidence_of_the_source_frame_is_brought_to_the_scene_of_training():
    A, b, text = frame(3, 0.2)
    rng = np.random.default_rng(0)
    original = rng.normal(size=(9, 3))
    turned = Rotation.random(9, random_state=1).as_matrix()
    pairs = Correspondences(tuple(map(str, range(9))), original, 2 * original + 1, 0, turned, turned)
    undo = parse_training_frame(text, "d.json")
    scene = in_training_frame(undo.original_from_training, pairs, undo.facts, ("doubtful",))
    np.testing.assert_allclose(scene.scene, 0.2 * (original @ A.T + b), atol=1e-12)
    np.testing.assert_allclose(scene.R_scene, A @ turned, atol=1e-12)
    assert fit_similarity(scene.scene, scene.world, 0.01, 0).similarity.scale == pytest.approx(2 / 0.2)
    assert scene.warnings == ("doubtful",)
    assert scene.facts["nerfstudio"]["scale"] == 0.2


IDENTITY = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not JSON"),
        (json.dumps({"transform": [[1e200] * 4] * 3, "scale": 1}), "are no rotation"),
        ("[1]", "is no JSON object"),
        (json.dumps({"scale": 1}), "has no 'transform'"),
        (json.dumps({"transform": IDENTITY}), "has no 'scale'"),
        (json.dumps({"transform": IDENTITY[:2], "scale": 1}), "must be 3x4"),
        (json.dumps({"transform": "x", "scale": 1}), "needs a 3x4 matrix"),
        (json.dumps({"transform": IDENTITY, "scale": 0}), "`scale` is 0"),
        (json.dumps({"transform": IDENTITY, "scale": -1}), "`scale` is -1"),
        (json.dumps({"transform": IDENTITY, "scale": float("nan")}), "`scale` is nan"),
        (json.dumps({"transform": IDENTITY, "scale": 10**400}), "needs a 3x4 matrix"),
        (json.dumps({"transform": [*IDENTITY[:2], [0, 0, 1, float("nan")]], "scale": 1}), "not finite"),
        (json.dumps({"transform": [*IDENTITY[:2], [0, 0, -1, 0]], "scale": 1}), "are no rotation"),
        (json.dumps({"transform": [*IDENTITY[:2], [0, 0, 1.01, 0]], "scale": 1}), "are no rotation"),
    ],
)
def test_what_is_no_training_frame_is_refused(text, message):
    with pytest.raises(InputError, match=message):
        parse_training_frame(text, "d.json")


def test_an_applied_scale_is_doubtful():
    text = json.dumps({"transform": [*IDENTITY, [0, 0, 0, 1]], "scale": 1})
    assert parse_training_frame(text, "d.json", '{"applied_scale": 1.0}').warnings == ()
    (warning,) = parse_training_frame(text, "d.json", '{"applied_scale": 0.5}').warnings
    assert "applied_scale 0.5" in warning
    with pytest.raises(InputError, match=r"transforms\.json: is not JSON"):
        parse_training_frame(text, "d.json", "{")


def test_the_folder_of_a_run_or_the_file_itself(tmp_path):
    with pytest.raises(InputError, match=r"has no dataparser_transforms\.json"):
        transform_files(tmp_path)
    with pytest.raises(InputError, match="does not exist"):
        transform_files(tmp_path / "none.json")
    file = tmp_path / "dataparser_transforms.json"
    file.write_text("{}")
    assert transform_files(tmp_path) == transform_files(file) == {"nerfstudio": file}
    (tmp_path / "transforms.json").write_text("{}")
    assert set(transform_files(tmp_path)) == {"nerfstudio", "nerfstudio data"}
