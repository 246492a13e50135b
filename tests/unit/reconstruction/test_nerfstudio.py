"""nerfstudio's folders: the values that are read; no tag of the configuration is ever run."""

import collections
import json
import sys

import numpy as np
import pytest

from alula.cli import main
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.errors import ArtifactError
from alula.stages.reconstruction.formats.ply import encode_ply
from alula.stages.reconstruction.formats.registry import SplatFile, read_splats
from alula.stages.reconstruction.formats.splats import color_from_sh0
from support.files.torch_files import Saved, parameters, saved, trained

CONFIG = """!!python/object:nerfstudio.engine.trainer.TrainerConfig
_target: !!python/name:nerfstudio.engine.trainer.Trainer ''
data: &id003 !!python/object/apply:pathlib.PosixPath
- data
- room
method_name: splatfacto
experiment_name: room
machine: !!python/object:nerfstudio.configs.base_config.MachineConfig
  seed: 42
optimizers:
  means:
    betas: !!python/tuple
    - 0.9
    - 0.999
pipeline: !!python/object:nerfstudio.pipelines.base_pipeline.VanillaPipelineConfig
  data: *id003
  model: !!python/object:nerfstudio.models.splatfacto.SplatfactoModelConfig
    sh_degree: 3
timestamp: 2024-09-11_100724
"""


TRANSFORMS = {"transform": [[1, 0, 0, 0.5], [0, 0, 1, 0], [0, -1, 0, 0]], "scale": 0.25}


@pytest.fixture
def run(tmp_path):
    """The output folder of a training with three checkpoints."""
    folder = tmp_path / "2024-09-11_100724"
    (folder / "nerfstudio_models").mkdir(parents=True)
    (folder / "config.yml").write_text(CONFIG)
    (folder / "dataparser_transforms.json").write_text(json.dumps(TRANSFORMS))
    for step in (2000, 29999, 10000):
        raw = saved(trained(parameters(seed=step)))
        (folder / "nerfstudio_models" / f"step-{step:09d}.ckpt").write_bytes(raw)
    return folder


def check(splats, arrays, logits=False):
    sigmoid = {key: 1 / (1 + np.exp(-arrays[key].astype(np.float64))) for key in ("opacities", "features_dc")}
    np.testing.assert_array_equal(splats.mean, arrays["means"])
    np.testing.assert_array_equal(splats.quat_wxyz, arrays["quats"])
    np.testing.assert_array_equal(
        splats.scale, np.exp(arrays["scales"].astype(np.float64)).astype(np.float32)
    )
    np.testing.assert_array_equal(splats.opacity, sigmoid["opacities"][:, 0].astype(np.float32))
    color = np.rint(255 * sigmoid["features_dc"]) if logits else color_from_sh0(arrays["features_dc"])
    np.testing.assert_array_equal(splats.color, color)
    assert splats.loss is None


def test_the_last_checkpoint_of_a_folder_is_read(run):
    for named in (run, run / "config.yml"):
        found = SplatFile.find(named)
        assert found.format.name == "nerfstudio"
        paths = [str(path.relative_to(run)) for path in found.files().values()]
        last = "nerfstudio_models/step-000029999.ckpt"
        assert paths == [last, "config.yml", "dataparser_transforms.json"]
        splats = found.decode()
        check(splats, parameters(seed=29999))
        assert splats.tags == {"frame": "nerfstudio training frame", "generator": "nerfstudio splatfacto"}
        assert splats.notes[0] == "checkpoint of step 29999, the last of 3"
        assert "times 0.25; `alula scale-align --nerfstudio DIR` undoes it" in splats.notes[1]


def test_the_command_reads_a_folder(run, tmp_path):
    assert (
        main.run(["import-splat", str(run), "-o", str(tmp_path / "a.scene.npz"), "--min-opacity", "0"]) == 0
    )
    scene = read_artifact(tmp_path / "a.scene.npz")
    assert scene.manifest.source["format"] == "nerfstudio"
    assert scene.manifest.source["frame"]["file"] == "nerfstudio training frame"
    roles = {"splat", "splat config.yml", "splat dataparser_transforms.json"}
    assert {item.role for item in scene.manifest.inputs} == roles
    assert str(tmp_path) not in json.dumps(list(scene.manifest.source["notes"]))


def test_a_lone_checkpoint_is_known_by_its_content(tmp_path):
    path = tmp_path / "named.anything"
    path.write_bytes(saved(trained(parameters())))
    found = SplatFile.find(path)
    assert (found.format.name, list(found.files())) == ("nerfstudio", ["splat"])
    check(found.decode(), parameters())


@pytest.mark.parametrize(
    "prefix", ["_model.", "module._model.", "_model.module.", "_model.module.gauss_params."]
)
def test_older_and_distributed_checkpoints_are_read(tmp_path, prefix):
    (tmp_path / "a.ckpt").write_bytes(saved(trained(parameters(), prefix), byteorder=None, name="step-1"))
    check(read_splats(tmp_path / "a.ckpt"), parameters())


def test_colours_without_harmonics_are_logits(tmp_path):
    arrays = parameters(coefficients=0)
    (tmp_path / "a.ckpt").write_bytes(saved(trained(arrays)))
    check(read_splats(tmp_path / "a.ckpt"), arrays, logits=True)


def test_storages_of_other_orders_shapes_and_precision_are_read(tmp_path):
    arrays = parameters()
    (tmp_path / "a.ckpt").write_bytes(saved(trained(arrays), byteorder="big"))
    check(read_splats(tmp_path / "a.ckpt"), arrays)
    tree = trained(arrays)
    pool = np.zeros(500, np.float32)
    strided = np.ndarray((40, 3), np.float32, pool, 7 * 4, (4, 48 * 4))
    strided[:] = arrays["means"]
    tree["pipeline"]["_model.gauss_params.means"] = Saved(strided, Saved(pool), 7, (1, 48))
    (tmp_path / "a.ckpt").write_bytes(saved(tree))
    check(read_splats(tmp_path / "a.ckpt"), arrays)
    half = {key: value.astype(np.float16) for key, value in arrays.items()}
    (tmp_path / "a.ckpt").write_bytes(saved(trained(half, storage="HalfStorage")))
    check(read_splats(tmp_path / "a.ckpt"), half)


def test_an_exported_ply_is_read_by_itself_and_without_checkpoints(run):
    for file in (run / "nerfstudio_models").iterdir():
        file.unlink()
    with pytest.raises(ArtifactError, match=r"no nerfstudio_models/step-\*.ckpt and no splat.ply"):
        read_splats(run)
    arrays = parameters()
    (run / "a.ckpt").write_bytes(saved(trained(arrays)))
    splats = read_splats(run / "a.ckpt")
    (run / "splat.ply").write_bytes(b"".join(encode_ply(splats)))
    assert read_splats(run / "splat.ply").format == "ply"
    whole = read_splats(run)
    np.testing.assert_array_equal(whole.mean, arrays["means"])
    assert whole.tags["frame"] == "nerfstudio training frame"
    assert SplatFile.find(run).files()["splat"] == run / "splat.ply"


def test_other_models_are_refused_by_name(run, tmp_path):
    field = collections.OrderedDict({"_model.field.mlp": Saved(np.zeros((3, 3), np.float32))})
    raw = saved({"step": 1, "pipeline": field})
    (tmp_path / "a.ckpt").write_bytes(raw)
    with pytest.raises(ArtifactError, match="this model is no Gaussian splat: it has no gauss_params"):
        read_splats(tmp_path / "a.ckpt")
    (run / "config.yml").write_text(CONFIG.replace("splatfacto", "nerfacto"))
    with pytest.raises(ArtifactError, match="nerfacto is no Gaussian splat; splatfacto is one"):
        read_splats(run)
    (run / "config.yml").write_text(CONFIG.replace("method_name: splatfacto", "method_name: my-method"))
    check(read_splats(run), parameters(seed=29999))
    (run / "nerfstudio_models" / "step-000029999.ckpt").write_bytes(raw)
    with pytest.raises(ArtifactError, match="my-method is no Gaussian splat: it has no gauss_params"):
        read_splats(run)
    for tree, message in (({"splats": {}}, "checkpoint of gsplat: .*--save_ply"), ([], "no 'pipeline'")):
        (tmp_path / "a.ckpt").write_bytes(saved(tree))
        with pytest.raises(ArtifactError, match=message):
            read_splats(tmp_path / "a.ckpt")
    arrays = parameters()
    del arrays["quats"]
    (tmp_path / "a.ckpt").write_bytes(saved(trained(arrays)))
    with pytest.raises(ArtifactError, match="lacks quats among its gauss_params"):
        read_splats(tmp_path / "a.ckpt")
    (tmp_path / "a.ckpt").write_bytes(saved(trained(parameters(0))))
    with pytest.raises(ArtifactError, match="has no Gaussians"):
        read_splats(tmp_path / "a.ckpt")
    (tmp_path / "a.ckpt").write_bytes(saved(trained(parameters(coefficients=7))))
    with pytest.raises(ArtifactError, match="7 coefficients; not a degree"):
        read_splats(tmp_path / "a.ckpt")


def test_tags_of_the_configuration_run_nothing(run, tmp_path):
    marker = tmp_path / "ran"
    for line in (
        f"evil: !!python/object/apply:os.system ['touch {marker}']",
        f"evil: !!python/object/apply:subprocess.check_output [[touch, '{marker}']]",
        f"evil: !!python/object/new:os.system ['touch {marker}']",
        f"evil: !!python/object/apply:builtins.eval [\"open('{marker}', 'w')\"]",
        "evil: !!python/module:antigravity ''",
        "evil: !!python/name:antigravity.x ''",
        "evil: !!python/object:torch_files.Called {reduced: 1}",
        "evil: !!python/object/apply:pathlib.PosixPath [a]\nother: !!binary '####'",
        "when: 2024-99-99\nn: !!int x",
    ):
        (run / "config.yml").write_text(CONFIG + line + "\n")
        check(read_splats(run), parameters(seed=29999))
    assert not marker.exists()
    assert "antigravity" not in sys.modules


def test_configurations_that_are_wrong_are_refused(run):
    laughs = "a0: &a0 [x, x]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 40))
    (run / "config.yml").write_text(laughs + CONFIG.split("\n", 1)[1])
    check(read_splats(run), parameters(seed=29999))
    merges = "a0: &a0 {x: 1}\n" + "".join(
        f"a{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}]}}\n" for i in range(1, 40)
    )
    (run / "config.yml").write_text(merges + CONFIG.split("\n", 1)[1])
    check(read_splats(run), parameters(seed=29999))
    for text, message in {
        "a: &a x\nb: [" + "*a, " * 1001 + "]": "more than 1000 aliases",
        "a: [": "is not YAML",
        "a: *b": "is not YAML",
        "a: &a [*a]": "is not YAML",
        "[1]: 2": "is not YAML",
        'a: "\\UFFFFFFFF"': "is not YAML",
        "- a": "is not a mapping",
        "a: b": "names no method",
        "method_name: [a]": "names no method",
        "a: " + "[" * 20000: "nested more than 100 deep",
        "# " + "x" * 2**18: "more than 262144",
    }.items():
        (run / "config.yml").write_text(text)
        with pytest.raises(ArtifactError, match=f"nerfstudio: config.yml .*({message})") as error:
            read_splats(run)
        assert "\n" not in str(error.value)


def test_transforms_that_are_wrong_are_refused(run):
    path = run / "dataparser_transforms.json"
    for text in (
        "[]",
        "{",
        '{"transform": [[1]], "scale": 1}',
        json.dumps(TRANSFORMS | {"scale": 0}),
        "[" * 10**5,
    ):
        path.write_text(text)
        with pytest.raises(ArtifactError, match=r"nerfstudio: dataparser_transforms.json"):
            read_splats(run)
    path.unlink()
    assert any("not known without" in note for note in read_splats(run).notes)
