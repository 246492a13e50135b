"""Small splat files of every format, written here from the formats' descriptions alone.

Each encoder takes Gaussians in double precision and gives the files of one splat; together they are the
seeds of the fuzzer and the other side of the round trips.
"""

from __future__ import annotations

import gzip
import io
import json
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Files = dict[str, bytes]

SH_C0 = 0.28209479177387814


@dataclass(frozen=True)
class Gaussians:
    """Activated values; quaternions w x y z of unit length."""

    mean: Array
    scale: Array
    quat: Array
    opacity: Array
    sh0: Array

    def __len__(self) -> int:
        return len(self.mean)

    @property
    def log_scale(self) -> Array:
        """Natural logarithms."""
        return np.log(self.scale)

    @property
    def logit(self) -> Array:
        """Of the opacity."""
        return np.log(self.opacity / (1 - self.opacity))

    @property
    def rgb(self) -> Array:
        """In [0, 1]."""
        return np.clip(0.5 + SH_C0 * self.sh0, 0, 1)


def some_gaussians(count: int = 300, seed: int = 0, size: float = 4.0) -> Gaussians:
    """Discs, needles and blobs in a cube, single precision throughout."""
    rng = np.random.default_rng(seed)
    quat = rng.normal(size=(count, 4))
    single = (
        rng.uniform(-size, size, (count, 3)),
        10 ** rng.uniform(-3, -0.3, (count, 3)),
        quat / np.linalg.norm(quat, axis=1, keepdims=True),
        rng.uniform(0.3, 0.95, count),
        rng.uniform(-1.5, 1.5, (count, 3)),
    )
    return Gaussians(*(np.float32(a).astype(float) for a in single))


def ply(g: Gaussians, order: str = "binary_little_endian") -> Files:
    """INRIA's columns without normals."""
    names = [*"xyz", *(f"f_dc_{i}" for i in range(3)), "opacity", *(f"scale_{i}" for i in range(3))]
    names += [f"rot_{i}" for i in range(4)]
    table = np.column_stack([g.mean, g.sh0, g.logit, g.log_scale, g.quat])
    head = f"ply\nformat {order} 1.0\ncomment SplatRenderMode: default\nelement vertex {len(g)}\n"
    head += "".join(f"property float {name}\n" for name in names) + "end_header\n"
    if order == "ascii":
        rows = "\n".join(" ".join(map(repr, row)) for row in table.tolist()) + "\n"
        return {"a.ply": (head + rows).encode()}
    return {"a.ply": head.encode() + table.astype("<f4" if "little" in order else ">f4").tobytes()}


def splat(g: Gaussians) -> Files:
    """antimatter15's records, quaternions truncated as its writer does."""
    raw = np.zeros(len(g), [("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])
    raw["mean"], raw["scale"] = g.mean, g.scale
    raw["rgba"] = np.column_stack([g.rgb, g.opacity]) * 255
    raw["quat"] = np.clip(np.floor(g.quat * 128 + 128), 0, 255)
    return {"a.splat": raw.tobytes()}


def _largest_last(quat: Array) -> tuple[NDArray[np.int64], Array]:
    """Place of the largest component and the three others, with the sign that makes that one positive."""
    place = np.abs(quat).argmax(axis=1)
    quat = quat * np.sign(quat[np.arange(len(quat)), place])[:, None]
    others = np.array([np.delete(row, i) for row, i in zip(quat, place, strict=True)])
    return place, others


def compressed_ply(g: Gaussians) -> Files:
    """PlayCanvas' chunks of 256."""
    n, chunks = len(g), -(-len(g) // 256)
    bounds, packed = [], np.zeros((n, 4), "<u4")
    for c in range(chunks):
        rows = slice(256 * c, 256 * (c + 1))
        limits = []
        for values in (g.mean[rows], g.log_scale[rows], g.rgb[rows]):
            limits.append((np.float32(values.min(axis=0)), np.float32(values.max(axis=0))))
        bounds.append(np.concatenate([np.concatenate(pair) for pair in limits]))

        def code(values: Array, which: int, bits: tuple[int, int, int], limits=limits) -> Array:  # type: ignore[no-untyped-def]
            low, high = (limit.astype(float) for limit in limits[which])
            share = (values - low) / np.where(high > low, high - low, 1)
            return np.rint(np.clip(share, 0, 1) * (2.0 ** np.array(bits) - 1)).astype(np.uint32)

        for word, values, which in ((0, g.mean[rows], 0), (2, g.log_scale[rows], 1)):
            q = code(values, which, (11, 10, 11))
            packed[rows, word] = q[:, 0] << 21 | q[:, 1] << 11 | q[:, 2]
        q = code(g.rgb[rows], 2, (8, 8, 8))
        alpha = np.rint(g.opacity[rows] * 255).astype(np.uint32)
        packed[rows, 3] = q[:, 0] << 24 | q[:, 1] << 16 | q[:, 2] << 8 | alpha
    place, others = _largest_last(g.quat)
    abc = np.rint(np.clip(others / np.sqrt(2) + 0.5, 0, 1) * 1023).astype(np.uint32)
    packed[:, 1] = place.astype(np.uint32) << 30 | abc[:, 0] << 20 | abc[:, 1] << 10 | abc[:, 2]
    columns = [f"{end}_{part}{axis}" for part, axes in (("", "xyz"), ("scale_", "xyz"), ("", "rgb"))
               for end in ("min", "max") for axis in axes]  # fmt: skip
    head = f"ply\nformat binary_little_endian 1.0\nelement chunk {chunks}\n"
    head += "".join(f"property float {name}\n" for name in columns) + f"element vertex {n}\n"
    for name in ("position", "rotation", "scale", "color"):
        head += f"property uint packed_{name}\n"
    return {
        "a.compressed.ply": (head + "end_header\n").encode() + np.float32(bounds).tobytes() + packed.tobytes()
    }


def ksplat(g: Gaussians, level: int = 1) -> Files:
    """One section; buckets of 64 Gaussians in the order of the rows, each as large as all of them."""
    n, size = len(g), 64
    full, rest = divmod(n, size)
    buckets = full + (rest > 0)
    at = np.arange(n) // size
    centre = np.array([g.mean[at == b].mean(axis=0) for b in range(buckets)], "<f4")
    block = np.float32(2.001 * np.abs(g.mean - centre[at]).max())
    position = "<f4" if level == 0 else "<u2"
    number = "<f4" if level == 0 else "<f2"
    record = [("mean", position, 3), ("scale", number, 3), ("quat", number, 4), ("rgba", "u1", 4)]
    rows = np.zeros(n, record)
    if level == 0:
        rows["mean"] = g.mean
    else:
        rows["mean"] = np.rint((g.mean - centre[at]) / (block / 2 / 32767) + 32767)
    rows["scale"], rows["quat"] = g.scale, g.quat
    rows["rgba"] = np.floor(np.column_stack([g.rgb, g.opacity]) * 255)
    main = bytearray(4096)
    struct.pack_into("<BB", main, 0, 0, 1)
    struct.pack_into("<IIIIH", main, 4, 1, 1, n, n, level)
    section = bytearray(1024)
    stored = 0 if level == 0 else 12
    used = (0, 0, 0) if level == 0 else (buckets, full, int(rest > 0))
    struct.pack_into("<IIIIfH", section, 0, n, n, size if level else 0, used[0], block, stored)
    struct.pack_into("<IIII", section, 24, 1 if level == 0 else 32767, rows.nbytes, used[1], used[2])
    data = b"" if level == 0 else (struct.pack("<I", rest) if rest else b"") + centre.tobytes()
    return {"a.ksplat": bytes(main) + bytes(section) + data + rows.tobytes()}


def spz(g: Gaussians, version: int = 3) -> Files:
    """Niantic's streams, rounded to the nearest code."""
    n = len(g)
    fixed = np.rint(g.mean * 4096).astype("<i4")
    positions = fixed.view(np.uint8).reshape(n, 3, 4)[:, :, :3].tobytes()
    if version == 1:
        positions = g.mean.astype("<f2").tobytes()
    alphas = np.rint(g.opacity * 255).astype(np.uint8).tobytes()
    colors = np.clip(np.rint((g.sh0 * 0.15 + 0.5) * 255), 0, 255).astype(np.uint8).tobytes()
    scales = np.clip(np.rint((g.log_scale + 10) * 16), 0, 255).astype(np.uint8).tobytes()
    xyzw = np.roll(g.quat, -1, axis=1)
    if version < 3:
        xyz = xyzw[:, :3] * np.where(xyzw[:, 3:] < 0, -1, 1)
        rotations = np.rint((xyz + 1) * 127.5).astype(np.uint8).tobytes()
    else:
        place, others = _largest_last(xyzw)
        words = place.astype(np.uint32)
        for j in range(3):
            magnitude = np.rint(np.abs(others[:, j]) * np.sqrt(2) * 511).astype(np.uint32)
            words = words << 10 | (others[:, j] < 0).astype(np.uint32) << 9 | magnitude
        rotations = words.astype("<u4").tobytes()
    streams = [positions, alphas, colors, scales, rotations]
    if version < 4:
        head = b"NGSP" + struct.pack("<IIBBBB", version, n, 0, 12, 0, 0)
        return {"a.spz": gzip.compress(head + b"".join(streams), mtime=0)}
    import zstandard

    packed = [zstandard.compress(stream) for stream in streams]
    head = b"NGSP" + struct.pack("<IIBBBBI12x", 4, n, 0, 12, 0, 5, 32)
    table = b"".join(struct.pack("<QQ", len(p), len(s)) for p, s in zip(packed, streams, strict=True))
    return {"a.spz": head + table + b"".join(packed)}


def sog(g: Gaussians, *, bundled: bool = True) -> Files:
    """PlayCanvas' version 2: lossless WebP images and code books of 256 entries."""
    from PIL import Image

    n = len(g)
    width = 4 * -(-int(np.ceil(np.sqrt(n))) // 4)
    height = -(-n // width)

    def image(rgba: NDArray[np.integer]) -> bytes:
        pixels = np.zeros((height * width, 4), np.uint8)
        pixels[:n] = rgba
        out = io.BytesIO()
        Image.fromarray(pixels.reshape(height, width, 4), "RGBA").save(out, "WEBP", lossless=True, exact=True)
        return out.getvalue()

    def book(values: Array) -> tuple[Array, NDArray[np.intp]]:
        entries = np.quantile(values, np.linspace(0, 1, 256)).astype(np.float32).astype(float)
        return entries, np.abs(values.reshape(-1, 1) - entries).argmin(axis=1).reshape(values.shape)

    mapped = np.sign(g.mean) * np.log1p(np.abs(g.mean))
    low, high = mapped.min(axis=0), mapped.max(axis=0)
    code = np.rint((mapped - low) / (high - low) * 65535).astype(int)
    opaque = np.full((n, 1), 255)
    scale_book, scale_code = book(g.log_scale)
    color_book, color_code = book(g.sh0)
    place, others = _largest_last(g.quat)
    quats = np.floor((others * np.sqrt(2) * 0.5 + 0.5) * 255).clip(0, 255).astype(int)
    files = {
        "means_l.webp": image(np.hstack([code & 255, opaque])),
        "means_u.webp": image(np.hstack([code >> 8, opaque])),
        "scales.webp": image(np.hstack([scale_code, opaque])),
        "quats.webp": image(np.hstack([quats, 252 + place[:, None]])),
        "sh0.webp": image(np.hstack([color_code, np.floor(g.opacity * 255).astype(int)[:, None]])),
    }
    meta = {
        "version": 2,
        "count": n,
        "means": {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": scale_book.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": color_book.tolist(), "files": ["sh0.webp"]},
    }
    files["meta.json"] = json.dumps(meta).encode()
    if not bundled:
        return files
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return {"a.sog": out.getvalue()}


def streamed_sog(g: Gaussians) -> Files:
    """A level of detail in two files, and an index of it."""
    half = len(g) // 2
    parts = [
        Gaussians(*(getattr(g, f.name)[rows] for f in fields(g))) for rows in (slice(half), slice(half, None))
    ]
    leaves = [{"lods": {"0": {"file": k, "offset": 0, "count": len(one)}}} for k, one in enumerate(parts)]
    index = {"version": 1, "lodLevels": 1, "filenames": ["0_0/meta.json", "0_1/meta.json"]}
    files = {"lod-meta.json": json.dumps(index | {"tree": {"children": leaves}}).encode()}
    for k, one in enumerate(parts):
        files |= {f"0_{k}/{name}": raw for name, raw in sog(one, bundled=False).items()}
    return files


def gltf(g: Gaussians, *, binary: bool = True) -> Files:
    """`KHR_gaussian_splatting` in single precision, one node without a transform."""
    prefix = "KHR_gaussian_splatting:"
    columns = {
        "POSITION": ("VEC3", g.mean),
        prefix + "ROTATION": ("VEC4", np.roll(g.quat, -1, axis=1)),
        prefix + "SCALE": ("VEC3", g.scale),
        prefix + "OPACITY": ("SCALAR", g.opacity[:, None]),
        prefix + "SH_DEGREE_0_COEF_0": ("VEC3", g.sh0),
    }
    data, views, accessors = b"", [], []
    for kind, values in columns.values():
        raw = np.float32(values).tobytes()
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(raw)})
        accessor = {"bufferView": len(accessors), "componentType": 5126, "count": len(g), "type": kind}
        accessors.append(accessor | {"min": values.min(0).tolist(), "max": values.max(0).tolist()})
        data += raw
    tree = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_gaussian_splatting"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{
            "mode": 0,
            "attributes": {name: i for i, name in enumerate(columns)},
            "extensions": {"KHR_gaussian_splatting": {"kernel": "ellipse", "colorSpace": "srgb_rec709"}},
        }]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(data)} | ({} if binary else {"uri": "a.bin"})],
    }  # fmt: skip
    text = json.dumps(tree).encode()
    if not binary:
        return {"a.gltf": text, "a.bin": data}
    text += b" " * (-len(text) % 4)
    chunks = (
        struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    )
    return {"a.glb": b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks}


def checkpoint(state: dict[str, Array]) -> bytes:
    """A file as torch.save makes it, written opcode by opcode: no torch is needed."""
    out = io.BytesIO()
    out.write(b"\x80\x02}X\x08\x00\x00\x00pipeline}(")
    for key, (name, values) in enumerate(state.items()):
        word = name.encode()
        out.write(b"X" + struct.pack("<I", len(word)) + word + b"ctorch._utils\n_rebuild_tensor_v2\n(")
        number = str(key).encode()
        out.write(b"(X\x07\x00\x00\x00storagectorch\nFloatStorage\n")
        out.write(b"X" + struct.pack("<I", len(number)) + number + b"X\x03\x00\x00\x00cpu")
        out.write(b"J" + struct.pack("<i", values.size) + b"tQK\x00(")
        for extent in values.shape:
            out.write(b"J" + struct.pack("<i", extent))
        out.write(b"t(")
        for extent in np.float32(values).strides:
            out.write(b"J" + struct.pack("<i", extent // 4))
        out.write(b"t\x89ccollections\nOrderedDict\n)RtR")
    out.write(b"us.")
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as zipped:
        zipped.writestr("step/data.pkl", out.getvalue())
        zipped.writestr("step/byteorder", "little")
        for key, values in enumerate(state.values()):
            zipped.writestr(f"step/data/{key}", np.float32(values).tobytes())
        zipped.writestr("step/version", "3\n")
    return archive.getvalue()


def nerfstudio(g: Gaussians) -> Files:
    """The output folder of splatfacto."""
    prefix = "_model.gauss_params."
    state = {
        prefix + "means": g.mean,
        prefix + "scales": g.log_scale,
        prefix + "quats": g.quat,
        prefix + "opacities": g.logit[:, None],
        prefix + "features_dc": g.sh0,
        prefix + "features_rest": np.zeros((len(g), 3, 3)),
    }
    config = (
        "!!python/object:nerfstudio.engine.trainer.TrainerConfig\nmethod_name: splatfacto\n"
        "pipeline: !!python/object:nerfstudio.pipelines.base_pipeline.VanillaPipelineConfig\n"
        "  model: !!python/object:nerfstudio.models.splatfacto.SplatfactoModelConfig\n    sh_degree: 3\n"
    )
    transform = {"transform": np.eye(4)[:3].tolist(), "scale": 0.5}
    return {
        "config.yml": config.encode(),
        "dataparser_transforms.json": json.dumps(transform).encode(),
        "nerfstudio_models/step-000029999.ckpt": checkpoint(state),
    }


def means_json(g: Gaussians) -> Files:
    """What SAFER-Splat loads: logarithms of scales, logits of opacities."""
    lists = {
        "means": g.mean,
        "rotations": g.quat,
        "colors": g.rgb,
        "opacities": g.logit[:, None],
        "scalings": g.log_scale,
    }
    return {"a.json": json.dumps({name: values.tolist() for name, values in lists.items()}).encode()}


Encoder = Callable[[Gaussians], Files]
ENCODERS: dict[str, tuple[str, Encoder]] = {
    "ply": ("ply", ply),
    "ply ascii": ("ply", lambda g: ply(g, "ascii")),
    "ply big-endian": ("ply", lambda g: ply(g, "binary_big_endian")),
    "compressed-ply": ("compressed-ply", compressed_ply),
    "splat": ("splat", splat),
    **{f"ksplat {level}": ("ksplat", lambda g, level=level: ksplat(g, level)) for level in (0, 1, 2)},
    **{f"spz {version}": ("spz", lambda g, version=version: spz(g, version)) for version in (1, 2, 3, 4)},
    "sog": ("sog", sog),
    "sog folder": ("sog", lambda g: sog(g, bundled=False)),
    "glb": ("gltf", gltf),
    "gltf": ("gltf", lambda g: gltf(g, binary=False)),
    "nerfstudio": ("nerfstudio", nerfstudio),
    "json": ("json", means_json),
}


def main_file(files: Files) -> str | None:
    """What a user would name: the only file, the .gltf, or the folder (None)."""
    if len(files) == 1:
        return next(iter(files))
    return next((name for name in files if name.endswith(".gltf")), None)


def small_splats(count: int = 40) -> dict[str, tuple[Files, str | None, str]]:
    """One valid splat of each kind by name: its files, what to name, and the name of its format."""
    g = some_gaussians(count)
    made = {name: (encode(g), form) for name, (form, encode) in ENCODERS.items()}
    made["streamed-sog"] = streamed_sog(g), "streamed-sog"
    return {name: (files, main_file(files), form) for name, (files, form) in made.items()}
