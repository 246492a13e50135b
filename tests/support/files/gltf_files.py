"""glTF files with Gaussians, made here from the description of the format."""

import base64
import json
import struct

import numpy as np

KHR = "KHR_gaussian_splatting"


CODES = {
    "i8": (5120, "i1", 127),
    "u8": (5121, "u1", 255),
    "i16": (5122, "<i2", 32767),
    "u16": (5123, "<u2", 65535),
}


ROUNDINGS = {"rounded": np.rint, "truncated": np.trunc, "floored": np.floor, "raised": np.ceil}


def encoded(values, kind, rounding=np.rint):
    """Stored numbers and the accessor's component type, as a writer of that kind makes them."""
    if kind == "f32":
        return np.asarray(values, "<f4"), {"componentType": 5126}
    code, dtype, largest = CODES[kind.removesuffix("n")]
    exact = np.asarray(values, np.float64) * (largest if kind.endswith("n") else 1)
    info = np.iinfo(dtype)
    extra = {"normalized": True} if kind.endswith("n") else {}
    return np.clip(rounding(exact), info.min, info.max).astype(dtype), {"componentType": code, **extra}


class Writer:
    """A glTF file being made."""

    def __init__(self):
        self.binary = bytearray()
        self.tree = {
            "asset": {"version": "2.0", "generator": "test"}, "extensionsUsed": [KHR], "scene": 0,
            "scenes": [{"nodes": []}], "nodes": [], "meshes": [], "accessors": [], "bufferViews": [],
        }  # fmt: skip

    def view(self, raw, stride=None):
        self.binary += bytes(-len(self.binary) % 4)
        self.tree["bufferViews"].append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(raw)})
        if stride:
            self.tree["bufferViews"][-1]["byteStride"] = stride
        self.binary += raw
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, values, kind="f32", rounding=np.rint, pad=0, offset=0):
        stored, form = encoded(values, kind, rounding)
        stored = stored.reshape(len(stored), -1)
        size = stored[:1].nbytes
        rows = np.zeros((len(stored), size + pad), np.uint8)
        rows[:, :size] = np.ascontiguousarray(stored).view(np.uint8).reshape(len(stored), size)
        view = self.view(b"\xaa" * offset + rows.tobytes(), size + pad if pad else None)
        kinds = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
        self.tree["accessors"].append(
            {
                "bufferView": view,
                "byteOffset": offset,
                "count": len(stored),
                "type": kinds[stored.shape[1]],
                **form,
            }
        )
        return len(self.tree["accessors"]) - 1

    def mesh(self, mean, quat_wxyz, scale, alpha, sh0, kinds=(), rounding=np.rint, **layout):
        kinds = {"POSITION": "f32", "ROTATION": "f32", "SCALE": "f32", "OPACITY": "f32"} | dict(kinds)
        columns = {
            "POSITION": mean, f"{KHR}:ROTATION": np.asarray(quat_wxyz)[:, [1, 2, 3, 0]],
            f"{KHR}:SCALE": scale, f"{KHR}:OPACITY": alpha, f"{KHR}:SH_DEGREE_0_COEF_0": sh0,
        }  # fmt: skip
        attributes = {
            name: self.accessor(values, kinds.get(name.removeprefix(KHR + ":"), "f32"), rounding, **layout)
            for name, values in columns.items()
        }
        self.tree["meshes"].append(
            {
                "primitives": [
                    {"mode": 0, "attributes": attributes, "extensions": {KHR: {"kernel": "ellipse"}}}
                ]
            }
        )
        return len(self.tree["meshes"]) - 1

    def node(self, root=True, **fields):
        self.tree["nodes"].append(fields)
        if root:
            self.tree["scenes"][0]["nodes"].append(len(self.tree["nodes"]) - 1)
        return len(self.tree["nodes"]) - 1

    def glb(self):
        text = json.dumps(self.tree | {"buffers": [{"byteLength": len(self.binary)}]}).encode()
        text += b" " * (-len(text) % 4)
        binary = bytes(self.binary) + bytes(-len(self.binary) % 4)
        length = 12 + 8 + len(text) + 8 + len(binary)
        chunks = (
            struct.pack("<2I", len(text), 0x4E4F534A) + text + struct.pack("<2I", len(binary), 0x004E4942)
        )
        return b"glTF" + struct.pack("<2I", 2, length) + chunks + binary

    def gltf(self, uri=None):
        uri = uri or "data:application/octet-stream;base64," + base64.b64encode(self.binary).decode()
        return json.dumps(self.tree | {"buffers": [{"byteLength": len(self.binary), "uri": uri}]}).encode()


def gaussians(count=50, seed=0):
    rng = np.random.default_rng(seed)
    quat = rng.normal(size=(count, 4))
    return {
        "mean": rng.normal(size=(count, 3)).astype(np.float32),
        "quat_wxyz": (quat / np.linalg.norm(quat, axis=1, keepdims=True)).astype(np.float32),
        "scale": np.exp(rng.normal(-3, 1, size=(count, 3))).clip(0, 0.95).astype(np.float32),
        "alpha": rng.uniform(size=(count, 1)).astype(np.float32),
        "sh0": rng.normal(size=(count, 3)).astype(np.float32),
    }


def simple(**fields):
    writer = Writer()
    writer.node(mesh=writer.mesh(**gaussians()), **fields)
    return writer


def angles(one, other):
    """Rotations between quaternions, in double precision and well away from rounding."""
    one, other = (np.asarray(q, np.float64) / np.linalg.norm(q, axis=1, keepdims=True) for q in (one, other))
    chord = np.minimum(np.linalg.norm(one - other, axis=1), np.linalg.norm(one + other, axis=1))
    return 4 * np.arcsin(np.minimum(chord / 2, 1))
