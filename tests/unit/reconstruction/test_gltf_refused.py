"""glTF that is damaged, of another kind, or made to take time or memory."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.schemas.errors import AlulaError, ArtifactError
from alula.stages.reconstruction.formats.registry import SplatFile, read_splats
from support.effort import examples
from support.files.gltf_files import KHR, gaussians, simple


@pytest.fixture
def read(tmp_path):
    def read(raw, name="a.glb"):
        (tmp_path / name).write_bytes(raw)
        return read_splats(tmp_path / name)

    return read


def changed(path, value):
    def change(tree):
        *way, last = path
        for key in way:
            tree = tree[key]
        if value is None:
            del tree[last]
        else:
            tree[last] = value

    return change


PRIMITIVE = ("meshes", 0, "primitives", 0)


SPLATTING = (*PRIMITIVE, "extensions", KHR)


WRONG = {
    "kernel": (changed((*SPLATTING, "kernel"), "customShape"), "kernel 'customShape' is not known"),
    "kernel type": (changed((*SPLATTING, "kernel"), 3), "Expected `str | null`"),
    "compression": (
        changed((*SPLATTING, "extensions"), {"KHR_gaussian_splatting_compression_spz_2": {}}),
        "compressed by KHR_gaussian_splatting_compression_spz_2",
    ),
    "required": (changed(("extensionsRequired",), ["EXT_meshopt_compression"]), "requires EXT_meshopt_comp"),
    "packed view": (
        changed(("bufferViews", 0, "extensions"), {"EXT_meshopt_compression": {}}),
        "compressed by EXT_meshopt",
    ),
    "mesh": (changed((*PRIMITIVE, "extensions"), {}), "an ordinary scene, not a Gaussian splat"),
    "mode": (changed((*PRIMITIVE, "mode"), 4), "mode 0, no indices"),
    "rotation": (changed((*PRIMITIVE, "attributes", KHR + ":ROTATION"), None), "need attribute .*ROTATION"),
    "accessor": (changed((*PRIMITIVE, "attributes", "POSITION"), 99), "accessor 99 does not exist"),
    "type": (changed(("accessors", 0, "type"), "VEC4"), "POSITION is 'VEC4', not VEC3"),
    "component": (changed(("accessors", 0, "componentType"), 5125), "POSITION is u32, not f32"),
    "unknown component": (changed(("accessors", 0, "componentType"), 7), "POSITION is component type 7"),
    "count": (changed(("accessors", 0, "count"), 10**9), "1000000000 rows end at byte 12000000000 of 600"),
    "huge count": (changed(("accessors", 0, "count"), 10**40), "accessors.0..count"),
    "counts": (changed(("accessors", 0, "count"), 49), "ROTATION has 50 rows, POSITION 49"),
    "no view": (changed(("accessors", 0, "bufferView"), None), "has no buffer view"),
    "view": (changed(("accessors", 0, "bufferView"), 7), "buffer view 7 does not exist"),
    "offset": (changed(("accessors", 0, "byteOffset"), 1), "rows end at byte 601 of 600"),
    "negative": (changed(("accessors", 0, "byteOffset"), -12), ">= 0"),
    "view offset": (changed(("bufferViews", 0, "byteOffset"), 10**6), "buffer view 0 ends at 1000600 of"),
    "stride": (changed(("bufferViews", 0, "byteStride"), 4), "a stride of 4 bytes for rows of 12"),
    "buffer": (changed(("bufferViews", 0, "buffer"), 3), "buffer 3 does not exist"),
    "scene": (changed(("scene",), 2), "scene 2 does not exist; there are 1"),
    "node": (changed(("scenes", 0, "nodes"), [1]), "node 1 does not exist"),
    "node mesh": (changed(("nodes", 0, "mesh"), 1), "mesh 1 does not exist"),
    "cycle": (changed(("nodes", 0, "children"), [0]), "node 0 is reached twice"),
    "twice": (changed(("scenes", 0, "nodes"), [0, 0]), "node 0 is reached twice"),
    "uneven": (changed(("nodes", 0, "scale"), [1, 2, 1]), "scales by 2, 1, 1 along three directions"),
    "mirror": (changed(("nodes", 0, "scale"), [-1, 1, 1]), "mirrors"),
    "flat": (changed(("nodes", 0, "scale"), [0, 0, 0]), "has scale 0"),
    "no turn": (changed(("nodes", 0, "rotation"), [0, 0, 0, 0]), "rotation has no length"),
    "short": (changed(("nodes", 0, "matrix"), [1.0] * 15), "matrix is not 16 finite numbers"),
    "projective": (
        changed(("nodes", 0, "matrix"), [1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]),
        "not affine and finite",
    ),
    "version": (changed(("asset", "version"), "1.0"), "version '1.0' is not 2.0"),
    "skin": (changed(("nodes", 0, "skin"), 0), "has a skin"),
    "instances": (changed(("nodes", 0, "extensions"), {"EXT_mesh_gpu_instancing": {}}), "EXT_mesh_gpu"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_refused_by_name(read, name):
    change, message = WRONG[name]
    writer = simple()
    change(writer.tree)
    with pytest.raises(ArtifactError, match=f"a.glb: glTF: .*{message}") as error:
        read(writer.glb())
    assert "\n" not in str(error.value)


def test_containers_that_are_damaged_are_refused(read):
    raw = simple().glb()
    chunk = struct.unpack_from("<I", raw, 12)[0]
    for damaged, message in {
        raw[:-1]: "truncated: the header announces",
        raw[:15]: "truncated: a GLB has a header",
        raw[:4] + struct.pack("<I", 1) + raw[8:]: "GLB of version 1",
        raw[:12] + struct.pack("<I", 2**31) + raw[16:]: "truncated: a chunk announces 2147483648",
        raw[:16] + b"XXXX" + raw[20:]: "first chunk of the GLB is not JSON",
        raw[:20] + b"[" + raw[21:]: "glTF: JSON: ",
        raw[:8] + struct.pack("<I", 20 + chunk) + raw[12:]: "buffer 0 has no URI and there is no binary",
    }.items():
        with pytest.raises(ArtifactError, match=message):
            read(damaged)
    assert any("5 bytes follow" in note for note in read(raw + b"extra").notes)
    for text, message in {
        b'{"asset":{"version":"2.0"},"x":' + b"[" * 10**5: "nested too deeply",
        b'{"asset":{"version":"2.0"},"nodes":[' + b"{}," * 2**20 + b"{}]}": "more than 1048576 JSON objects",
        b'{"asset":{"version":"2.0"}}': "no primitive has KHR",
        b'{"asset":{"version":"2.0"},"meshes":[{"primitives":[{"attributes":{"\xff":1}}]}]}': "JSON",
    }.items():
        with pytest.raises(ArtifactError, match=message):
            read(text, "a.gltf")
    writer = simple()
    for uri in ("data:;base64,####", "data:nothing"):
        with pytest.raises(ArtifactError, match="glTF: buffer 0: "):
            read(writer.gltf(uri), "a.gltf")


def test_a_chain_of_many_nodes_and_many_instances_end(read):
    writer = simple()
    for child in range(3000):
        writer.node(root=False, children=[child], translation=[0, 0, 1])
    writer.tree["scenes"][0]["nodes"] = [3000]
    np.testing.assert_allclose(read(writer.glb()).mean[:, 2], gaussians()["mean"][:, 2] + 3000, atol=1e-3)
    writer = simple()
    for _ in range(100):
        writer.node(mesh=0)
    with pytest.raises(ArtifactError, match=r"5050 Gaussians in \d+ bytes"):
        read(writer.glb())


BASE = simple().glb()


@settings(max_examples=examples(300), deadline=None)
@given(st.data())
def test_any_change_of_bytes_is_read_or_refused(tmp_path_factory, data):
    raw = bytearray(BASE)
    json_end = 20 + struct.unpack_from("<I", raw, 12)[0]
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, json_end))
        raw[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
    path = tmp_path_factory.getbasetemp() / "fuzzed.glb"
    path.write_bytes(raw[: data.draw(st.integers(len(raw) // 2, len(raw) + 8))])
    try:
        found = SplatFile.find(path, "gltf")
        found.files()
        splats = found.decode()
    except AlulaError as error:
        lines = str(error).count("\n")
    else:
        lines = 0
        assert len(splats) > 0
    assert lines == 0
