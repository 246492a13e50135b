"""Checkpoints as torch.save makes them, made here without PyTorch."""

import collections
import pickle
import struct
import zipfile
from io import BytesIO
from types import ModuleType

import numpy as np


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
