"""An encoder of SOG with the roundings that writers have, and the folders and archives of its files."""

import io
import json
import zipfile

import numpy as np
from PIL import Image

ROUNDINGS = {"truncating": lambda v: np.floor(v + 1e-9), "rounding": lambda v: np.floor(v + 0.5)}
BANDS = {1: 3, 2: 8, 3: 15}


def webp(pixels, width, **options):
    """Rows of 4 channels as a lossless image, padded with zeros."""
    height = -(-len(pixels) // width)
    canvas = np.zeros((height * width, pixels.shape[1]), np.uint8)
    canvas[: len(pixels)] = pixels
    image = Image.fromarray(canvas.reshape(height, width, -1))
    raw = io.BytesIO()
    image.save(raw, "WEBP", **({"lossless": True, "exact": True, "quality": 0, "method": 0} | options))
    return raw.getvalue()


def opaque(codes):
    return np.hstack([codes, np.full((len(codes), 1), 255)]).astype(np.uint8)


def linear(values, to_code, levels=255):
    """Codes between the limits of columns, with those limits."""
    lower, upper = values.min(axis=0), values.max(axis=0)
    extent = np.where(upper > lower, upper - lower, 1.0)
    return np.clip(to_code((values - lower) / extent * levels), 0, levels), lower.tolist(), upper.tolist()


def nearest(values, table):
    order = np.sort(table)
    return np.searchsorted((order[1:] + order[:-1]) / 2, values), order.tolist()


def encode(
    scene, version=2, rounding="truncating", bands=0, width=None, palette=100, model=None, number=np.float64
):
    """Files by name; `number` is what centres and rotations are computed in."""
    to_code = ROUNDINGS[rounding]
    n = len(scene)
    width = width or max(4, -(-int(np.ceil(n**0.5)) // 4) * 4)
    mean = scene.mean.astype(number)
    t = np.sign(mean) * (np.log1p(np.abs(mean)) if number is np.float64 else np.log(np.abs(mean) + number(1)))
    code, mins, maxs = linear(t, to_code, 65535)
    code = code.astype(np.uint16)
    rows, largest = np.arange(n), np.abs(scene.quat).argmax(axis=1)
    quat = scene.quat * np.sign(scene.quat[rows, largest])[:, None]
    others = quat[np.arange(4) != largest[:, None]].reshape(-1, 3).astype(number)
    packed = to_code((others * number(np.sqrt(2)) * number(0.5) + number(0.5)) * number(255))
    meta = {
        "means": {"mins": mins, "maxs": maxs, "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"files": ["sh0.webp"]},
    }
    if version == 2:
        quantiles = np.linspace(0, 1, 256)
        scales, meta["scales"]["codebook"] = nearest(scene.log_scale, np.quantile(scene.log_scale, quantiles))
        shades, meta["sh0"]["codebook"] = nearest(scene.sh0, np.quantile(scene.sh0, quantiles))
        colors = np.hstack([shades, to_code(scene.alpha[:, None] * 255)]).astype(np.uint8)
        meta = {"version": 2, "count": n, "asset": {"generator": "a test"}} | meta
    else:
        scales, meta["scales"]["mins"], meta["scales"]["maxs"] = linear(scene.log_scale, to_code)
        logit = np.log(scene.alpha / (1 - scene.alpha))
        colors, *limits = linear(np.hstack([scene.sh0, logit[:, None]]), to_code)
        meta["sh0"]["mins"], meta["sh0"]["maxs"] = limits
        meta["means"]["shape"] = [n, 3]
    if model is not None:
        meta["model"] = model
    files = {
        "means_l.webp": webp(opaque(code & 255), width),
        "means_u.webp": webp(opaque(code >> 8), width),
        "scales.webp": webp(opaque(scales), width),
        "quats.webp": webp(np.hstack([packed, 252 + largest[:, None]]).astype(np.uint8), width),
        "sh0.webp": webp(np.asarray(colors, np.uint8), width),
    }
    if bands:
        wide = 64 * BANDS[bands]
        files["shN_centroids.webp"] = webp(np.ones((wide * -(-palette // 64), 4), np.uint8), wide)
        files["shN_labels.webp"] = webp(opaque(np.zeros((n, 3))), width)
        meta["shN"] = {"files": ["shN_centroids.webp", "shN_labels.webp"]}
        if version == 2:
            meta["shN"] |= {"count": palette, "bands": bands, "codebook": [0.0] * 256}
        else:
            meta["shN"] |= {"mins": -1.0, "maxs": 1.0}
    return {"meta.json": json.dumps(meta).encode()} | files


def folder(path, files):
    path.mkdir(parents=True, exist_ok=True)
    for name, raw in files.items():
        (path / name).write_bytes(raw)
    return path


def bundle(path, files, compression=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, raw in files.items():
            archive.writestr(name, raw)
    return path


def changed(files, **edits):
    """The files with other values in `meta.json`; `a__b` means a.b, None removes."""
    meta = json.loads(files["meta.json"])
    for path, value in edits.items():
        *parents, last = path.split("__")
        place = meta
        for name in parents:
            place = place[name]
        if value is None:
            del place[last]
        else:
            place[last] = value
    return files | {"meta.json": json.dumps(meta).encode()}
