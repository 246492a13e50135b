"""nerfstudio's folders and checkpoints: what is read, and that nothing in them is ever run."""

import collections
import json
import os
import pickle
import struct
import sys
import zipfile
from io import BytesIO
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.cli import main
from alula.schemas.artifact import read_artifact
from alula.schemas.errors import AlulaError, ArtifactError
from alula.stages.reconstruction.formats.checkpoint import Checkpoint, is_checkpoint
from alula.stages.reconstruction.formats.ply import encode_ply
from alula.stages.reconstruction.formats.registry import SplatFile, read_splats
from alula.stages.reconstruction.formats.splats import color_from_sh0
from alula.stages.reconstruction.formats.torch_pickle import unpickled


class Saved:
    """A tensor to be saved: an array, or a view of the storage of another one."""

    def __init__(self, array, base=None, offset=0, strides=None, storage="FloatStorage", parameter=True):
        self.array = np.asarray(array)
        self.base = self if base is None else base
        self.offset, self.storage, self.parameter = offset, storage, parameter
        self.strides = np.zeros(self.array.shape, np.int8).strides if strides is None else strides

    def __reduce_ex__(self, _protocol):
        tensor = (
            functions["_rebuild_tensor_v2"],
            (Reference(self), self.offset, self.array.shape, self.strides, False, collections.OrderedDict()),
        )
        if not self.parameter:
            return tensor
        return functions["_rebuild_parameter"], (Called(*tensor), True, collections.OrderedDict())


class Called:
    """A value that is pickled as a call."""

    def __init__(self, function, arguments, state=None):
        self.reduced = (function, arguments, *(() if state is None else (state,)))

    def __reduce_ex__(self, _protocol):
        return self.reduced


class Reference:
    """A place for a persistent id."""

    def __init__(self, saved):
        self.saved = saved


def stand_in(module, name):
    """A function that pickles as `module.name`."""
    made = ModuleType(module)

    def function(*_):
        raise AssertionError("never called")

    function.__module__, function.__name__, function.__qualname__ = module, name, name
    setattr(made, name, function)
    return function


functions = {
    name: stand_in(module, name)
    for module, name in (
        ("torch._utils", "_rebuild_tensor_v2"),
        ("torch._utils", "_rebuild_parameter"),
        ("torch", "FloatStorage"),
        ("torch", "HalfStorage"),
        ("torch", "DoubleStorage"),
        ("torch", "LongStorage"),
        ("torch", "BFloat16Storage"),
        ("numpy._core.multiarray", "scalar"),
        ("numpy", "dtype"),
        ("torch", "load"),
    )
}


class TorchPickler(pickle._Pickler):
    """Pickles as torch.save does: storages by persistent id, names without importing their modules."""

    def __init__(self, file):
        super().__init__(file, 2)
        self.storages = {}

    def persistent_id(self, value):
        if isinstance(value, Reference):
            base = value.saved.base
            key = str(
                list(self.storages).index(id(base)) if id(base) in self.storages else len(self.storages)
            )
            self.storages[id(base)] = base
            return ("storage", functions[base.storage], key, "cuda:0", base.array.size)
        return None

    def save_global(self, obj, name=None):
        if obj in functions.values():
            self.write(pickle.GLOBAL + f"{obj.__module__}\n{obj.__name__}\n".encode())
            self.memoize(obj)
        else:
            super().save_global(obj, name)

    dispatch = pickle._Pickler.dispatch.copy()
    dispatch[type(stand_in)] = save_global


def saved(
    tree, *, name="archive", byteorder="little", data=None, members=None, compression=zipfile.ZIP_STORED
):
    """The bytes that torch.save makes of a tree with `Saved`s."""
    pickled = BytesIO()
    pickler = TorchPickler(pickled)
    pickler.dump(tree)
    out = BytesIO()
    with zipfile.ZipFile(out, "w", compression) as archive:
        archive.writestr(f"{name}/data.pkl", pickled.getvalue() if data is None else data)
        if byteorder:
            archive.writestr(f"{name}/byteorder", byteorder)
        for key, storage in enumerate(pickler.storages.values()):
            array = storage.array
            order = ">" if byteorder == "big" else "<"
            archive.writestr(f"{name}/data/{key}", array.astype(array.dtype.newbyteorder(order)).tobytes())
        archive.writestr(f"{name}/version", "3\n")
        for member, raw in (members or {}).items():
            archive.writestr(member, raw)
    return out.getvalue()


def parameters(count=40, seed=0, coefficients=15):
    rng = np.random.default_rng(seed)
    shapes = {"means": (3,), "scales": (3,), "quats": (4,), "features_dc": (3,), "opacities": (1,)}
    arrays = {key: rng.normal(size=(count, *shape)).astype(np.float32) for key, shape in shapes.items()}
    return arrays | {"features_rest": rng.normal(size=(count, coefficients, 3)).astype(np.float32)}


def learning_rate():
    """A NumPy scalar, pickled as NumPy does: a call, a state, and bytes as text."""
    dtype = Called(functions["dtype"], ("f8", False, True), (3, "<", None, None, None, -1, -1, 0))
    return Called(functions["scalar"], (dtype, struct.pack("<d", 1e-4)))


def trained(arrays, prefix="_model.gauss_params.", **forms):
    """A checkpoint as nerfstudio's trainer saves it."""
    state = collections.OrderedDict((prefix + key, Saved(value, **forms)) for key, value in arrays.items())
    state["_model.camera_optimizer.pose_adjustment"] = Saved(np.zeros((5, 6), np.float32))
    state["_model.device_indicator_param"] = Saved(np.empty(0, np.float32))
    state._metadata = collections.OrderedDict({"": {"version": 1}})
    moment = Saved(arrays["means"], parameter=False)
    group = {"lr": learning_rate(), "betas": (0.9, 0.999), "params": [0], "foreach": None, "amsgrad": False}
    return {
        "step": 29999,
        "pipeline": state,
        "optimizers": {
            "means": {"state": {0: {"step": 2.0**60, "exp_avg": moment}}, "param_groups": [group]}
        },
        "schedulers": {"means": {"last_epoch": 30000, "_last_lr": [learning_rate()], "big": 2**70}},
        "scalers": {"scale": 65536.0, "growth": -3, "text": "é", "none": (), "three": (1, 300, 70000)},
    }


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


CALLS = []


def trap(*arguments):
    CALLS.append(arguments)
    return arguments


class Evil:
    def __init__(self, *reduced):
        self.reduced = reduced

    def __reduce__(self):
        return self.reduced


def attacks():
    """Pickles that run code, take time or take memory when a plain unpickler loads them."""
    by_name = {
        "os.system": b"cposix\nsystem\n(X\x04\x00\x00\x00truetR.",
        "eval": b"cbuiltins\neval\n(X\x01\x00\x00\x001tR.",
        "exec, old name": b"c__builtin__\nexec\n(X\x01\x00\x00\x001tR.",
        "getattr": b"cbuiltins\ngetattr\n(cos\npath\nX\x01\x00\x00\x00atR.",
        "dotted": b"ccollections\nOrderedDict.__init__.__globals__\n.",
        "torch.load": b"ctorch\nload\n(X\x05\x00\x00\x00x.ckpttR.",
        "own module": b"calula.cli.main\nrun\n)R.",
        "a storage from elsewhere": b"cos\nFloatStorage\n.",
        "reduce on a dictionary": b"}(tR.",
        "reduce on text": b"X\x01\x00\x00\x00a)R.",
        "reduce on a storage": b"ctorch\nFloatStorage\n)R.",
        "wrong arguments": b"ctorch._utils\n_rebuild_tensor_v2\n(K\x01K\x02tR.",
        "build on a name": b"ccollections\nOrderedDict\n}b.",
        "build on a list": b"]}b.",
        "inst": b"(X\x01\x00\x00\x001ibuiltins\neval\n.",
        "obj": b"(cbuiltins\neval\nX\x01\x00\x00\x001o.",
        "newobj": b"ccollections\nOrderedDict\n)\x81.",
        "stack global": b"\x8c\x02os\x8c\x06system\x93.",
        "extension": b"\x82\x01.",
        "string": b"S'\\z'\n.",
        "persistent text": b"Pstorage\n.",
        "persistent number": b"K\x01Q.",
        "memo far": b"j\xff\xff\xff\xff.",
        "huge text": b"X\xff\xff\xff\xffa.",
        "huge number": b"\x8a\xffa.",
        "hash bomb": b"}(" + b")" + b"2\x86" * 60 + b"K\x01u.",
        "hash bomb by memo": b"})q\x000" + b"h\x00h\x00\x86q\x000" * 60 + b"h\x00K\x01s.",
        "list key": b"}]Ns.",
        "append to a tuple": b")Na.",
        "underflow": b"R.",
        "mark": b"(.",
        "no end": b"}",
        "nothing": b"",
        "nested": b"(" * 10**5 + b".",
    }
    return by_name


@pytest.mark.parametrize("name", attacks())
def test_pickles_that_ask_for_more_are_refused(tmp_path, name):
    raw = saved(None, data=b"\x80\x02" + attacks()[name])
    with pytest.raises(ArtifactError, match=r"^checkpoint: .*data\.pkl") as error:
        Checkpoint(memoryview(raw))
    assert "\n" not in str(error.value)


def test_the_name_that_was_asked_for_is_told():
    for name, told in (
        ("os.system", "posix.system"),
        ("getattr", "builtins.getattr"),
        ("torch.load", "torch.load"),
    ):
        with pytest.raises(ArtifactError, match=f"asks for '{told}'"):
            Checkpoint(memoryview(saved(None, data=attacks()[name])))


def test_nothing_hidden_beside_the_gaussians_is_run(tmp_path):
    for evil in (
        Evil(trap, (1,)),
        Evil(os.system, ("touch " + str(tmp_path / "ran"),)),
        Evil(eval, ("trap(2)",)),
    ):
        tree = trained(parameters())
        tree["schedulers"] = evil
        hooked = trained(parameters())
        arguments = (Reference(Saved(np.zeros(3, np.float32))), 0, (3,), (1,), False, evil)  # as hooks
        hooked["pipeline"]["_model.x"] = Called(functions["_rebuild_tensor_v2"], arguments)
        for raw in (saved(tree), saved(hooked)):
            with pytest.raises(ArtifactError, match="asks for"):
                Checkpoint(memoryview(raw))
    assert CALLS == []
    assert not (tmp_path / "ran").exists()


def test_far_memo_places_and_deep_containers_cost_nothing():
    assert Checkpoint(memoryview(saved(None, data=b"\x80\x02Nr\xff\xff\xff\xff."))).tree is None
    raw = saved(None, data=b"\x80\x02)" + b"\x85" * 10**5 + b".")
    tree = Checkpoint(memoryview(raw)).tree
    del tree
    with pytest.raises(ArtifactError, match="has 2097153 bytes; more than 2097152"):
        Checkpoint(memoryview(saved(None, data=b"N" * (2**21 + 1))))


def wrong_tensors():
    good = parameters()["means"]
    base = Saved(good)
    yield "shape", Saved(good[:-1]), r"scales has shape \(40, 3\), not \(39, 3\)"
    yield "columns", Saved(good[:, :2]), r"means has shape \(40, 2\), not \(40, 3\)"
    yield (
        "strides",
        Saved(good, base, 0, (3, 2)),
        r"shape \(40, 3\) with strides \(3, 2\) from 0 reaches outside of 120",
    )
    yield "offset", Saved(good, base, 1), "from 1 reaches outside of 120 numbers"
    yield "negative offset", Saved(good, base, -1), "from -1 reaches outside"
    yield "negative stride", Saved(good, base, 119, (-3, -1)), r"with strides \(-3, -1\)"
    yield "few strides", Saved(good, base, 0, (3,)), r"with strides \(3,\)"
    yield (
        "type",
        Saved(good.astype(np.float64), storage="DoubleStorage"),
        "means is of type f8, not single or half",
    )
    yield "bfloat16", Saved(good.astype(np.float16), storage="BFloat16Storage"), "means is of type bfloat16"
    yield "integers", Saved(good.astype(np.int64), storage="LongStorage"), "means is of type i8"
    big = np.broadcast_to(np.float32(0), (2**40, 3))
    yield "repeated", Saved(big, Saved(np.zeros(4, np.float32)), 0, (0, 1)), r"reaches outside of 4 numbers"


@pytest.mark.parametrize(
    ("name", "tensor", "message"), list(wrong_tensors()), ids=[w[0] for w in wrong_tensors()]
)
def test_tensors_outside_of_their_storage_are_refused(tmp_path, name, tensor, message):
    tree = trained(parameters())
    if name == "repeated":
        for key, columns in (("scales", 3), ("quats", 4), ("opacities", 1), ("features_dc", 3)):
            many = np.broadcast_to(np.float32(0), (2**40, columns))
            tree["pipeline"]["_model.gauss_params." + key] = Saved(
                many, Saved(np.zeros(4, np.float32)), 0, (0, 1)
            )
    tree["pipeline"]["_model.gauss_params.means"] = tensor
    (tmp_path / "a.ckpt").write_bytes(saved(tree))
    with pytest.raises(ArtifactError, match=message):
        read_splats(tmp_path / "a.ckpt")


def test_storages_shorter_than_announced_are_refused(tmp_path):
    tree = trained(parameters())
    raw = saved(tree)
    out = BytesIO()
    with zipfile.ZipFile(BytesIO(raw)) as old, zipfile.ZipFile(out, "w") as new:
        for member in old.namelist():
            new.writestr(member, old.read(member)[: -4 if member.endswith("/data/0") else None])
    (tmp_path / "a.ckpt").write_bytes(out.getvalue())
    with pytest.raises(ArtifactError, match="truncated: means: 120 numbers of 4 bytes in 476 bytes"):
        read_splats(tmp_path / "a.ckpt")


def read_all(raw):
    checkpoint = Checkpoint(memoryview(raw))
    for key, value in checkpoint.tree["pipeline"].items():
        checkpoint.array(value, key)


def test_archives_that_are_wrong_are_refused():
    good = saved(trained(parameters()))
    for raw, message in {
        good[:-30]: "truncated, or not a ZIP archive",
        good[: len(good) // 2]: "truncated, or not a ZIP archive",
        b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19.": "of the format of PyTorch before 1.6",
        saved({}, compression=zipfile.ZIP_DEFLATED): "is compressed; PyTorch stores them plain",
        saved({}, members={"other/data.pkl": b"N."}): "2 members NAME/data.pkl",
        saved({}, byteorder="mixed"): "byte order b'mixed' is not known",
        good.replace(b"archive/data/1", b"archive/data/x"): "member 'archive/data/1' is missing",
        good.replace(b"PK\x03\x04", b"PK\x03\x05"): "is not where the directory says",
    }.items():
        with pytest.raises(ArtifactError, match=f"^checkpoint: .*{message}"):
            read_all(raw)
    assert is_checkpoint(good[:4096])
    assert is_checkpoint(b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19.")
    assert not is_checkpoint(b"PK\x03\x04")


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
    for tree, message in (({"splats": {}}, "no 'pipeline'"), ([], "no 'pipeline'")):
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
    module = Path(__file__).stem
    for line in (
        f"evil: !!python/object/apply:os.system ['touch {marker}']",
        f"evil: !!python/object/apply:subprocess.check_output [[touch, '{marker}']]",
        f"evil: !!python/object/new:os.system ['touch {marker}']",
        f"evil: !!python/object/apply:builtins.eval [\"open('{marker}', 'w')\"]",
        "evil: !!python/module:antigravity ''",
        "evil: !!python/name:antigravity.x ''",
        f"evil: !!python/object:{module}.Evil {{reduced: 1}}",
        "evil: !!python/object/apply:pathlib.PosixPath [a]\nother: !!binary '####'",
        "when: 2024-99-99\nn: !!int x",
    ):
        (run / "config.yml").write_text(CONFIG + line + "\n")
        check(read_splats(run), parameters(seed=29999))
    assert not marker.exists()
    assert "antigravity" not in sys.modules
    assert CALLS == []


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


BASE = saved(trained(parameters(4)))


@settings(max_examples=400, deadline=None)
@given(st.data())
def test_any_change_of_bytes_is_read_or_refused(tmp_path_factory, data):
    raw = bytearray(BASE)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(raw)))
        raw[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
    path = tmp_path_factory.getbasetemp() / "fuzzed.ckpt"
    path.write_bytes(raw[: data.draw(st.integers(len(raw) // 2, len(raw)))] or b"x")
    lines = 0
    try:
        splats = SplatFile.find(path, "nerfstudio").decode()
    except AlulaError as error:
        lines = str(error).count("\n")
    else:
        assert len(splats) == 4
    assert lines == 0


@settings(max_examples=400, deadline=None)
@given(st.binary(max_size=60), st.integers(0, 300))
def test_any_pickle_ends(junk, at):
    start = BytesIO()
    TorchPickler(start).dump(trained(parameters(2)))
    raw = start.getvalue()
    for pickled in (junk, raw[:at] + junk, raw[:at] + junk + raw[at:]):
        try:
            unpickled(pickled)
        except ArtifactError:
            continue
