"""Counts that a COLMAP model or a cloud cannot hold are refused before a library allocates for them."""

import os
import struct
import subprocess
import sys
import zipfile
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from alula.schemas.errors import InputError
from alula.stages.alignment.cloud_files import read_cloud
from alula.stages.alignment.colmap import model_files, read_model
from alula.stages.alignment.colmap_counts import check_counts

LIMIT = 3 << 30  # of the address space of a child: libraries alone map 2 GB
HUGE = 1 << 40


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    pycolmap = pytest.importorskip("pycolmap")
    folder = tmp_path_factory.mktemp("model")
    options = pycolmap.SyntheticDatasetOptions()
    options.num_cameras_per_rig = 2
    pycolmap.synthesize_dataset(options).write(str(folder))
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def written(folder, contents):
    for name, raw in contents.items():
        (folder / name).write_bytes(raw)
    return folder


def test_real_counts_pass(model, tmp_path):
    check_counts(model_files(written(tmp_path, model)))
    assert len(read_model(tmp_path).names) == sum(1 for _ in read_model(tmp_path).rows) > 5


def at(raw, place, code, value):
    return raw[:place] + struct.pack(code, value) + raw[place + struct.calcsize(code) :]


def first_image_count(raw):
    return raw.index(b"\0", 8 + 64) + 1


WRONG = {
    **{f"entries of {part}": (f"{part}.bin", lambda raw: at(raw, 0, "<Q", HUGE))
       for part in ("cameras", "images", "points3D", "frames", "rigs")},
    "points of an image": ("images.bin", lambda raw: at(raw, first_image_count(raw), "<Q", HUGE)),
    "track of a point": ("points3D.bin", lambda raw: at(raw, 8 + 43, "<Q", HUGE)),
    "data of a frame": ("frames.bin", lambda raw: at(raw, 8 + 64, "<I", 0xFFFFFFFF)),
    "sensors of a rig": ("rigs.bin", lambda raw: at(raw, 8 + 4, "<I", 0xFFFFFFFF)),
    "cut": ("images.bin", lambda raw: raw[:-1]),
    "name without an end": ("images.bin", lambda raw: raw[: 8 + 64] + b"a" * 100_000),
    "almost empty": ("points3D.bin", lambda raw: raw[:7]),
    "empty": ("points3D.bin", lambda raw: b""),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_a_model_with_impossible_counts_is_refused(model, tmp_path, case):
    name, change = WRONG[case]
    folder = written(tmp_path, model | {name: change(model[name])})
    message = rf"{name}: (states \d+ entries, but its \d+ bytes end|has 7 bytes|is empty)"
    with pytest.raises(InputError, match=message):
        read_model(folder)


def ply(count, form="binary_little_endian", body=b"\0" * 120):
    lines = ["ply", f"format {form} 1.0", f"element vertex {count}"]
    return "\n".join([*lines, *(f"property float {c}" for c in "xyz"), "end_header\n"]).encode() + body


def pcd(count, data, body, width=None):
    lines = [
        "VERSION .7",
        "FIELDS x y z",
        "SIZE 4 4 4",
        "TYPE F F F",
        "COUNT 1 1 1",
        f"WIDTH {width or count}",
    ]
    lines += ["HEIGHT 1", "VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {count}", f"DATA {data}\n"]
    return "\n".join(lines).encode() + body


def npz(points, compression=zipfile.ZIP_DEFLATED, shape=None):
    raw = BytesIO()
    np.lib.format.write_array_header_1_0(
        raw, {"descr": points.dtype.str, "fortran_order": False, "shape": shape or points.shape}
    )
    held = BytesIO()
    with zipfile.ZipFile(held, "w", compression) as archive, archive.open("points.npy", "w") as entry:
        entry.write(raw.getvalue())
        step = 1 << 16
        for start in range(0, len(points), step):
            entry.write(np.ascontiguousarray(points[start : start + step]).tobytes())
    return held.getvalue()


ZEROS = np.broadcast_to(np.zeros(3, np.float32), (8_000_000, 3))  # 96 MB in 93 kB
FACES = b"element face 999999999999\nproperty list uchar int i\n"
CLOUDS = {
    "rows.ply": (ply(HUGE), r"states \d+ rows of vertex of at least 12 bytes, but 120 bytes follow"),
    "rows_as_text.ply": (ply(HUGE, "ascii", b"0 0 0\n" * 20), "states"),
    "one_row_more.ply": (ply(11), "states 11 rows"),
    "lists.ply": (
        ply(1, body=b"").replace(b"end_header", FACES + b"end_header")
        + b"\0" * 20,
        "states 999999999999 rows of face",
    ),
    "no_columns.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 999999999999\nend_header\n0 0 0\n", "no columns"
    ),
    "rows.pcd": (pcd(HUGE, "binary", b"\0" * 120), "states"),
    "rows_as_text.pcd": (pcd(HUGE, "ascii", b"0 0 0\n" * 10), "states"),
    "width.pcd": (pcd(10, "binary", b"\0" * 120, width=HUGE), "states"),
    "held.pcd": (pcd(10, "binary_compressed", struct.pack("<II", 2**32 - 1, 120) + b"\0" * 50), "truncated"),
    "grown.pcd": (
        pcd(3 * 10**8, "binary_compressed", struct.pack("<II", 50, 2**32 - 1) + b"\0" * 50),
        "50 compressed bytes",
    ),
    "endless.pcd": (b"x" * 100_000, "no line DATA"),
    "rows.pts": (b"999999999999\n0 0 0\n", "states 999999999999 points"),
    "bomb.npz": (ZEROS, "compressed bytes would become 96000000, more than 50 times"),
    "shape.npz": (npz(np.zeros((5, 3)), shape=(HUGE, 3)), r"states \d+ bytes, its entry has"),
}  # fmt: skip


@pytest.mark.parametrize("name", CLOUDS)
def test_a_cloud_with_impossible_counts_is_refused(tmp_path, name):
    raw, message = CLOUDS[name]
    path = tmp_path / name
    path.write_bytes(npz(raw) if isinstance(raw, np.ndarray) else raw)
    with pytest.raises(InputError, match=message) as caught:
        read_cloud(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("compression", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_real_arrays_pass(tmp_path, compression):
    points = np.random.default_rng(0).normal(size=(1000, 3))
    (tmp_path / "a.npz").write_bytes(npz(points, compression))
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.npz"), points)


def test_clouds_of_open3d_pass(tmp_path):
    open3d = pytest.importorskip("open3d")
    points = np.random.default_rng(0).normal(size=(500, 3))
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    for name in ("a.ply", "a.pcd", "a.pts", "a.xyz"):
        for text in (True, False):
            for compressed in (True, False):
                open3d.io.write_point_cloud(
                    str(tmp_path / name), cloud, write_ascii=text, compressed=compressed
                )
                np.testing.assert_allclose(read_cloud(tmp_path / name), points, atol=1e-5)


CHILD = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, ({limit}, {limit}))
from pathlib import Path
from alula.schemas.errors import InputError
from alula.stages.alignment.cloud_files import read_cloud
from alula.stages.alignment.colmap import read_model
try:
    {read}(Path(sys.argv[1]))
except InputError as error:
    print(error)
    # Not ru_maxrss, which a child inherits from a large parent.
    print(next(row.split()[1] for row in open("/proc/self/status") if row.startswith("VmHWM")))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are those of Linux")
@pytest.mark.parametrize("case", ["points of an image", "bomb.npz", "rows.ply", "rows.pcd"])
def test_refusals_need_little_memory(model, tmp_path, case):
    if case in WRONG:
        name, change = WRONG[case]
        path, read = written(tmp_path, model | {name: change(model[name])}), "read_model"
    else:
        raw, _ = CLOUDS[case]
        path, read = tmp_path / case, "read_cloud"
        path.write_bytes(npz(raw) if isinstance(raw, np.ndarray) else raw)
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    words = [sys.executable, "-P", "-c", CHILD.format(limit=LIMIT, read=read), str(path)]
    done = subprocess.run(words, env=env, capture_output=True, text=True, check=True)
    message, peak = done.stdout.splitlines()
    assert Path(path).name in message or "images.bin" in message
    assert int(peak) * 1024 < 700 << 20


def test_the_model_of_a_real_scene_passes():
    root = os.environ.get("ALULA_DATA")
    if not root:
        pytest.skip("ALULA_DATA is not set")
    folder = Path(root) / "colmap-sceaux/colmap_example_model_bin"
    check_counts(model_files(folder))
    assert len(read_model(folder).names) == 11
