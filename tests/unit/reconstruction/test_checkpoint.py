"""Checkpoints of PyTorch: views stay in their storage, and no code of a pickle is ever run."""

import os
import zipfile
from io import BytesIO

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.schemas.errors import AlulaError, ArtifactError
from alula.stages.reconstruction.formats.checkpoint import Checkpoint, is_checkpoint
from alula.stages.reconstruction.formats.registry import SplatFile, read_splats
from alula.stages.reconstruction.formats.torch_pickle import unpickled
from support.effort import examples
from support.files.torch_files import (
    Called,
    Reference,
    Saved,
    TorchPickler,
    functions,
    parameters,
    saved,
    trained,
)

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


BASE = saved(trained(parameters(4)))


@pytest.mark.slow
@settings(max_examples=examples(400), deadline=None)
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


@settings(max_examples=examples(400), deadline=None)
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
