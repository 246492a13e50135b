"""Files of meshes and clouds: all that they hold is read, as it stands there, or they are refused by name."""

import json
import random
import struct

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from alula.schemas.errors import InputError
from alula.stages.compression import imported_files
from alula.stages.compression.imported import Mesh
from alula.stages.compression.imported_files import read_imported
from support.attack.meshes import case, search
from support.files.mesh_files import WRITERS, Glb
from support.fuzz import fuzz_meshes
from support.fuzz.fuzz_splats import fuzz

A, B, C, D = (0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)
E = (5, 5, 5)
CORNERS = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"
XYZ = b"property float x\nproperty float y\nproperty float z\n"
PLY = b"ply\nformat ascii 1.0\nelement vertex 4\n" + XYZ
POINTS = b"0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
FACES = b"element face 1\nproperty list uchar int vertex_indices\n"


def read(tmp_path, name, raw):
    (tmp_path / name).write_bytes(raw)
    return read_imported(tmp_path / name)


def rows(triangles):
    """Triangles without their order, each from its smallest corner on."""
    found = [[tuple(float(c) for c in p) for p in t] for t in triangles]
    return sorted(min(t[k:] + t[:k] for k in range(3)) for t in found)


def facet(*points, loop=b"outer loop"):
    corners = b"".join(b" vertex %g %g %g\n" % p for p in points)
    return b"facet normal 0 0 1\n" + loop + b"\n" + corners + b"endloop\nendfacet\n"


def binary_stl(*triangles, head=b"", tail=b""):
    body = b"".join(struct.pack("<12fH", 0, 0, 1, *(c for p in t for c in p), 7) for t in triangles)
    return head.ljust(80, b" ") + struct.pack("<I", len(triangles)) + body + tail


def binary_ply(order, corner, face, *, name=b"vertex_indices", kind="f"):
    word = {"<": b"little", ">": b"big"}[order]
    real = {"f": b"float", "d": b"double"}[kind]
    head = b"ply\nformat binary_%s_endian 1.0\nelement vertex %d\n" % (word, len(corner))
    head += b"".join(b"property %s %c\n" % (real, c) for c in b"xyz")
    head += b"element face %d\nproperty list uchar uint %s\nend_header\n" % (len(face), name)
    body = b"".join(struct.pack(order + "3" + kind, *p) for p in corner)
    return head + body + b"".join(struct.pack(f"{order}B{len(f)}I", len(f), *f) for f in face)


READ = {
    "one.obj": (CORNERS + b"f 1 2 3\n", [(A, B, C)]),
    "relative.obj": (  # the first wall vanished: -3 counted from the end of the file
        CORNERS + b"f -3 -2 -1\n" + b"v 5 5 5\nv 6 5 5\nv 5 6 5\nf -3 -2 -1\n",
        [(A, B, C), (E, (6, 5, 5), (5, 6, 5))],
    ),
    "ahead.obj": (b"f 3 1 2\n" + CORNERS, [(A, B, C)]),
    "slashes.obj": (CORNERS + b"vt 0 0\nvn 0 0 1\nf 1/1 2//1 3/1/1\nf 1// 2/ 3\n", [(A, B, C)] * 2),
    "tabs.obj": (b"v\t0\t0\t0\nv  1\t0 0\n \tv 0 1 0\nf\t1\t2\t3 # f 3 2 1\n", [(A, B, C)]),
    "joined.obj": (CORNERS.replace(b"v 1 0 0", b"v 1 \\\n 0 \\\n 0") + b"f 1 2 \\\n3\n", [(A, B, C)]),
    "comment.obj": (b"# C:\\files\\\n" + CORNERS + b"# \\\nf 1 2 3", [(A, B, C)]),
    "crlf.obj": ((CORNERS + b"# a\nf 1 2 \\\n 3\n").replace(b"\n", b"\r\n"), [(A, B, C)]),
    "cr.obj": ((b"# a\n" + CORNERS + b"f 1 2 3\n").replace(b"\n", b"\r"), [(A, B, C)]),
    "colours.obj": (CORNERS.replace(b" 0 0\n", b" 0 0 1 0.5 0\n") + b"f 1 2 3\n", [(A, B, C)]),
    "weights.obj": (CORNERS.replace(b"\n", b" 1.0\n") + b"f 1 2 3\n", [(A, B, C)]),
    "groups.obj": (b"mtllib a b.mtl\no a\ng b\ns 1\nusemtl c\n" + CORNERS + b"f +1 2 3\n", [(A, B, C)]),
    "flat.obj": (CORNERS + b"v 1 1 0\nf 1 2 4 3\n", [(A, B, (1, 1, 0)), (A, (1, 1, 0), C)]),
    "bent.obj": (CORNERS + b"v 0 0 1\nf 1 2 3 4\n", [(A, B, C), (A, C, D), (A, B, D), (B, C, D)]),
    "text.stl": (b"solid a\n" + facet(A, B, C) + b"endsolid a\n", [(A, B, C)]),
    "case.stl": (b"SOLID\r\n" + facet(A, B, C).upper().replace(b"\n", b"\r\n") + b"ENDSOLID", [(A, B, C)]),
    "name.stl": (b"solid facet normal endfacet\n" + facet(A, B, D) + b"endsolid facet\n", [(A, B, D)]),
    "two.stl": ((b"solid a\n" + facet(A, B, C) + b"endsolid a\n") * 2, [(A, B, C)] * 2),
    "binary.stl": (binary_stl((A, B, C), (A, C, D)), [(A, B, C), (A, C, D)]),
    "like_text.stl": (binary_stl((A, B, C), head=b"solid a\nfacet normal 0 0 1"), [(A, B, C)]),
    "face.ply": (PLY + FACES + b"end_header\n" + POINTS + b"3 0 1 2\n", [(A, B, C)]),
    "spaces.ply": (
        (PLY + FACES).replace(b"element ", b"element  ") + b"end_header\n" + POINTS + b"3 0 1 2", [(A, B, C)]
    ),
    "tab.ply": (
        (PLY + FACES).replace(b"element face", b"element\tface") + b"end_header\n" + POINTS + b"3 0 1 2",
        [(A, B, C)],
    ),
    "long.ply": (  # the faces stand behind the first 64 kB of the header
        b"ply\nformat ascii 1.0\ncomment " + b"x" * 70_000 + b"\nelement vertex 4\n" + XYZ + FACES
        + b"end_header\n" + POINTS + b"3 0 1 2\n",
        [(A, B, C)],
    ),
    "quads.ply": (PLY + FACES + b"end_header\n" + POINTS + b"4 0 1 2 3\n",
                  [(A, B, C), (A, C, D), (A, B, D), (B, C, D)]),
    "strips.ply": (
        PLY + b"element tristrips 1\nproperty list int int vertex_indices\nend_header\n" + POINTS
        + b"9 0 1 2 3 -1 0 1 3 -1\n",
        [(A, B, C), (B, D, C), (A, B, D)],
    ),
    "more.ply": (
        PLY.replace(XYZ, b"property uchar red\n" + XYZ + b"property float quality\n")
        + b"element face 1\nproperty uchar flags\nproperty list uchar int vertex_index\n"
        b"property list uchar float texcoord\nend_header\n"
        + b"".join(b"255 " + p + b" 0.5\n" for p in POINTS.splitlines()) + b"1 3 0 1 2 2 0.5 0.5\n",
        [(A, B, C)],
    ),
    "little.ply": (binary_ply("<", [A, B, C, D], [(0, 1, 2), (0, 2, 3)]), [(A, B, C), (A, C, D)]),
    "big.ply": (binary_ply(">", [A, B, C, D], [(0, 1, 2)], name=b"vertex_index", kind="d"), [(A, B, C)]),
    "mixed.ply": (binary_ply("<", [A, B, C, (1, 1, 0)], [(0, 1, 2), (0, 1, 3, 2)]),
                  [(A, B, C), (A, B, (1, 1, 0)), (A, (1, 1, 0), C)]),
}  # fmt: skip


@pytest.mark.parametrize("name", READ)
def test_a_mesh_is_read_as_it_stands_in_the_file(name, tmp_path):
    raw, wanted = READ[name]
    found = read(tmp_path, name, raw)
    assert isinstance(found, Mesh)
    assert rows(found.surface) == rows(wanted)


SPLAT = b"".join(b"property float %s\n" % name for name in (b"scale_0", b"scale_1", b"rot_0", b"rot_1"))
REFUSED = {
    "line.obj": (CORNERS + b"f 1 2 3\nl\t1 2\n", "line 5: has elements 'l' .lines."),
    "point.obj": (CORNERS + b"f 1 2 3\np 1\n", "elements 'p'"),
    "surface.obj": (CORNERS + b"f 1 2 3\ncstype bezier\n", "elements 'cstype' .surfaces."),
    "call.obj": (CORNERS + b"f 1 2 3\ncall other.obj\n", "'call' .another file."),
    "case.obj": (CORNERS + b"f 1 2 3\nF 1 2 3\n", "statement 'F' is not known"),
    "hidden.obj": (CORNERS + b"f 1 2 3\ng a\\\nf 1 2 3\n", "line 5: 'g' ends in a backslash"),
    "weight.obj": (CORNERS.replace(b"v 1 0 0", b"v 1 0 0 2") + b"f 1 2 3\n", "weight of 2"),
    "five.obj": (CORNERS.replace(b"v 1 0 0", b"v 1 0 0 1 1") + b"f 1 2 3\n", "line 2 is malformed"),
    "comma.obj": (CORNERS.replace(b"v 1 0 0", b"v 1,0 0 0") + b"f 1 2 3\n", "line 2 is malformed"),
    "two.obj": (CORNERS + b"f 1 2\n", "line 4 is malformed"),
    "zero.obj": (CORNERS + b"f 0 1 2\n", "the corner 0"),
    "before.obj": (CORNERS + b"f 1 2 -4\n", "corner -4, and 3 vertices come before it"),
    "behind.obj": (CORNERS + b"f 1 2 4\n", "corner 3, but the 3 points count from 0"),
    "form_feed.obj": (CORNERS + b"# a\x0cf 1 2 3\nf 1 2 3\n", "byte 0x0c"),
    "wide.obj": ((CORNERS + b"f 1 2 3\n").decode().encode("utf-16"), "byte 0x00"),
    "corners.obj": (
        b"".join(b"v %d %d %d\n" % (i, i * i, i**3) for i in range(40))
        + b"f" + b"".join(b" %d" % (i + 1) for i in range(40)),
        "polygon 0 has 40 corners and is not flat",
    ),
    "less.stl": (binary_stl((A, B, C))[:-1], "states 1 triangles, which are 134 bytes, but has 133"),
    "more.stl": (binary_stl((A, B, C), tail=b"\0" * 50), "states 1 triangles"),
    "count.stl": (binary_stl((A, B, C), head=b"solid", tail=b"\0" * 50), "no facet of a text STL"),
    "cut.stl": (b"solid a\n" + facet(A, B, C), "ends in line 9 before 'endsolid'"),
    "four.stl": (b"solid\n" + facet(A, B, C, D) + b"endsolid", "line 2: no facet"),
    "word.stl": (b"solid\n" + facet(A, B, C).replace(b"1 0 0", b"1_0 0 0") + b"endsolid", "line 2: no facet"),
    "line.stl": (b"solid a " + facet(A, B, C).replace(b"\n", b" ") + b"\nendsolid", "line 1: no facet"),
    "end_line.stl": (
        b"solid a\n" + facet(A, B, C) + b"endsolid a solid b " + facet(A, B, C).replace(b"\n", b" ") + b"\n",
        "line 9: no facet",
    ),
    "behind.stl": (b"solid\n" + facet(A, B, C) + b"endsolid\n" + facet(A, B, C), "line 10: no facet"),
    "edges.ply": (
        PLY + FACES + b"element edge 1\nproperty int vertex1\nproperty int vertex2\nend_header\n" + POINTS
        + b"3 0 1 2\n0 3\n",
        "element 'edge' is not known",
    ),
    "list.ply": (PLY + FACES.replace(b"vertex_indices", b"corners") + b"end_header\n" + POINTS + b"3 0 1 2\n",
                 "one list vertex_indices or vertex_index, it has corners"),
    "both.ply": (
        PLY + FACES + b"property list uchar int vertex_index\nend_header\n" + POINTS + b"3 0 1 2 3 0 1 3\n",
        "it has vertex_indices, vertex_index",
    ),
    "segment.ply": (PLY + FACES + b"end_header\n" + POINTS + b"2 0 1\n", "face 0 has 2 corners"),
    "long_row.ply": (PLY + FACES + b"end_header\n" + POINTS + b"3 0 1 2 3\n", "line 14 is no row of face"),
    "rows.ply": (PLY + FACES + b"end_header\n" + POINTS + b"3 0 1 2\n3 0 1 3\n", "announces 5 rows, but 6"),
    "behind.ply": (binary_ply("<", [A, B, C], [(0, 1, 2)]) + b"\0" * 13, "13 bytes follow the rows"),
    "cut.ply": (binary_ply("<", [A, B, C], [(0, 1, 2)])[:-1], "truncated"),
    "negative.ply": (PLY + FACES + b"end_header\n" + POINTS + b"3 0 1 -1\n", "corner -1"),
    "splat.ply": (
        PLY + SPLAT + b"end_header\n" + b"".join(p + b" 1 1 1 1\n" for p in POINTS.splitlines()),
        "a Gaussian splat",
    ),
    "comma.xyz": (b"0 0 0\n1,2,3\n", "line 2: a point needs numbers with spaces between them, not '1,2,3'"),
    "comma_space.xyz": (b"0 0 0\n1, 2, 3\n", "line 2: a point needs numbers"),
    "header.xyz": (b"x y z\n0 0 0\n", "line 1: a point needs numbers"),
    "short.xyz": (b"0 0 0 1\n1 2 3\n", "line 2: a point has 3 numbers, but those before have 4"),
    "two.xyz": (b"0 0\n1 2\n", "lines have 2 numbers"),
    "less.pts": (b"3\n0 0 0\n1 0 0\n", "states 3 points, but 2 lines follow"),
    "scans.pts": (b"2\n0 0 0\n1 0 0\n1\n1 1 1\n", "line 4: a point has 1 numbers"),
    "none.pts": (b"0 0 0\n1 0 0\n", "begins with its number of points"),
    "twice.bt": (b"# Octomap OcTree binary file\nid OcTree\nsize 2\nres 0.1\nres 0.2\ndata\n\x02\x00",
                 "the line 'res 0.2', once too often or not known"),
    "key.bt": (b"# Octomap OcTree binary file\nid OcTree\nsize 2\nres 0.1\norigin 1 0 0\ndata\n\x02\x00",
               "the line 'origin 1 0 0'"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_would_be_left_out_is_refused_by_name(name, tmp_path):
    raw, words = REFUSED[name]
    with pytest.raises(InputError, match=words) as caught:
        read(tmp_path, name, raw)
    assert str(caught.value).startswith(str(tmp_path / name))
    assert "\n" not in str(caught.value)


def test_clouds_of_text_are_read_line_by_line(tmp_path):
    for name, raw in {
        "a.xyz": b"# x y z \xe4\r\n0 0 0\r\n\r\n1\t0  0 # b\r\n",
        "b.xyz": b"0 0 0 255 1\n1 0 0 3 4",
        "c.xyzrgb": b"0 0 0 1 1 1\r1 0 0 1 1 1\r",
        "d.pts": b"\n2\n0 0 0 -5\n1 0 0 6\n",
        "e.ply": b"ply\nformat  ascii 1.0\nelement  vertex  2\n" + XYZ + b"end_header\n0 0 0\n1 0 0\n",
    }.items():
        assert read(tmp_path, name, raw).points.tolist() == [[0, 0, 0], [1, 0, 0]], name


def made(rng=None, **node):
    """A .glb with one triangle A B C and its accessors."""
    glb = Glb()
    where = glb.accessor([A, B, C], "<f4", "VEC3")
    glb.tree["meshes"].append({"primitives": [{"attributes": {"POSITION": where}}]})
    glb.node(mesh=0, **node)
    return glb


def test_sparse_and_quantised_positions_are_what_their_accessors_define(tmp_path):
    glb = made()
    glb.tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = glb.sparse(
        [(0, 0, 5), (1, 0, 5), (0, 1, 5)], "<f4", "VEC3", None
    )
    assert rows(read(tmp_path, "sparse.glb", glb.bytes()).corners) == rows(
        [((0, 0, 5), (1, 0, 5), (0, 1, 5))]
    )

    glb = made(scale=[5, 5, 5])  # 5 m were 635 m
    glb.tree["extensionsRequired"] = ["KHR_mesh_quantization"]
    glb.tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = glb.accessor(
        [(0, 0, 0), (127, 0, 0), (0, -128, 0)], "i1", "VEC3", pad=1, normalized=True
    )
    found = read(tmp_path, "quantised.glb", glb.bytes())
    assert rows(found.corners) == rows([((0, 0, 0), (5, 0, 0), (0, -5, 0))])
    assert found.up == "y"


def test_nodes_move_turn_and_mirror_their_triangles_exactly(tmp_path):
    glb = made(translation=[0.5, 0, 0], scale=[-2, 1, 1])
    turned = read(tmp_path, "a.glb", glb.bytes())
    assert rows(turned.corners) == rows([((0.5, 1, 0), (-1.5, 0, 0), (0.5, 0, 0))])  # faces the same way
    glb = Glb()
    where = glb.accessor([(2**-20, 0, 0), B, C], "<f4", "VEC3")
    glb.tree["meshes"].append({"primitives": [{"attributes": {"POSITION": where}}]})
    inner = glb.node(root=False, mesh=0, translation=[1e9, 0, 0])
    glb.node(children=[inner], translation=[-1e9, 0, 0])
    assert read(tmp_path, "b.glb", glb.bytes()).corners[0, 0].tolist() == [2**-20, 0, 0]


def test_strips_and_fans_face_one_way(tmp_path):
    square = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)]
    for mode, order in ((5, square), (6, [square[i] for i in (0, 1, 3, 2)])):
        glb = Glb()
        primitive = {"attributes": {"POSITION": glb.accessor(order, "<f4", "VEC3")}, "mode": mode}
        glb.tree["meshes"].append({"primitives": [primitive]})
        glb.node(mesh=0)
        a, b, c = np.moveaxis(read(tmp_path, "a.glb", glb.bytes()).corners, 1, 0)
        normal = np.cross(b - a, c - a)
        assert normal.tolist() == [[0, 0, 1], [0, 0, 1]]


def _targets(glb):
    glb.tree["meshes"][0] |= {"weights": [1.0]}
    glb.tree["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": 0}]


def _external(glb):
    glb.tree["bufferViews"][0]["buffer"] = 1


GLB = {
    "morph targets": _targets,
    "KHR_draco_mesh_compression": lambda glb: glb.tree["meshes"][0]["primitives"][0].update(
        extensions={"KHR_draco_mesh_compression": {}}
    ),
    "EXT_meshopt_compression": lambda glb: glb.tree["bufferViews"][0].update(
        extensions={"EXT_meshopt_compression": {}}
    ),
    "EXT_mesh_gpu_instancing": lambda glb: glb.tree["nodes"][0].update(
        extensions={"EXT_mesh_gpu_instancing": {}}
    ),
    "KHR_gaussian_splatting": lambda glb: glb.tree.update(extensionsUsed=["KHR_gaussian_splatting"]),
    "ABC_displaced": lambda glb: glb.tree.update(extensionsUsed=["ABC_displaced"]),
    "is animated": lambda glb: glb.tree.update(skins=[{"joints": [0]}]),
    "has a skin": lambda glb: glb.tree["nodes"][0].update(skin=0),
    "mesh 1 has lines": lambda glb: glb.tree["meshes"].append(
        {"primitives": [{"attributes": {"POSITION": 0}, "mode": 1}]}
    ),
    "mesh 1 is at no node": lambda glb: glb.tree["meshes"].append(glb.tree["meshes"][0]),
    "node 1 has a mesh, but is not in the default scene": lambda glb: glb.node(root=False, mesh=0),
    "has no POSITION": lambda glb: glb.tree["meshes"][0]["primitives"][0].update(attributes={}),
    "compressed": lambda glb: glb.tree["accessors"][0].pop("bufferView"),
}  # fmt: skip


@pytest.mark.parametrize("words", GLB)
def test_a_glb_with_other_shapes_is_refused_by_name(words, tmp_path):
    glb = made()
    GLB[words](glb)
    with pytest.raises(InputError, match=words):
        read(tmp_path, "a.glb", glb.bytes())


def test_a_glb_with_two_objects_of_one_name_is_refused(tmp_path):
    raw = made().bytes()
    twice = raw.replace(b'"scene": 0, ', b'"nodes":[], ')
    assert len(twice) == len(raw)
    with pytest.raises(InputError, match="an object has a name twice"):
        read(tmp_path, "a.glb", twice)


def test_cameras_lights_and_materials_of_a_glb_do_not_matter(tmp_path):
    glb = made()
    glb.node(camera=0)
    glb.tree |= {
        "cameras": [{"type": "perspective"}],
        "materials": [{"extensions": {"KHR_materials_unlit": {}}}],
    }
    glb.tree["extensionsUsed"] = ["KHR_materials_unlit", "KHR_lights_punctual", "EXT_texture_webp"]
    assert len(read(tmp_path, "a.glb", glb.bytes()).corners) == 1


def test_buffers_in_other_files_are_refused_because_the_hash_does_not_cover_them(tmp_path):
    glb = made()
    raw = glb.bytes()
    size = int.from_bytes(raw[12:16], "little")
    tree = json.loads(raw[20 : 20 + size])
    tree["buffers"][0]["uri"] = "a.bin"
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    raw = b"glTF" + struct.pack("<4I", 2, 20 + len(text), len(text), 0x4E4F534A) + text
    (tmp_path / "a.bin").write_bytes(bytes(glb.binary))
    with pytest.raises(InputError, match="buffer 0 is another file"):
        read(tmp_path, "a.glb", raw)


@pytest.mark.parametrize("suffix", ["obj", "stl", "stl_ascii", "ply", "ply_ascii", "glb"])
def test_meshes_of_trimesh_are_read_as_trimesh_reads_them(suffix, tmp_path):
    shape = trimesh.creation.icosphere(2)
    shape.apply_transform(trimesh.transformations.rotation_matrix(0.7, [1, 2, 3]))
    scene = trimesh.Scene([shape, trimesh.creation.box((1, 2, 3))])
    path = tmp_path / f"a.{suffix.partition('_')[0]}"
    scene = scene if suffix == "glb" else scene.to_mesh()
    words = {"file_type": "stl_ascii"} if suffix == "stl_ascii" else {}
    scene.export(path, **(words | ({"encoding": "ascii"} if suffix == "ply_ascii" else {})))
    wanted = trimesh.load_scene(path, process=False).to_mesh()
    found = read_imported(path)
    assert len(found.corners) == 332
    assert not len(found.bent)
    tree = cKDTree(wanted.triangles.reshape(-1, 9))  # trimesh joins the shapes of a .glb in another order
    gap, other = tree.query(found.corners.reshape(-1, 9))
    assert gap.max() < 1e-7
    assert len(set(other.tolist())) == 332


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "glb", "pcd", "xyz", "pts"])
def test_files_of_open3d_are_read_as_it_wrote_them(suffix, tmp_path):
    open3d = pytest.importorskip("open3d")
    shape = open3d.geometry.TriangleMesh.create_torus(1.0, 0.3, 12, 8)
    shape.compute_triangle_normals()
    path = tmp_path / f"a.{suffix}"
    if suffix in ("pcd", "xyz", "pts"):
        cloud = open3d.geometry.PointCloud(shape.vertices)
        for compressed in (False, True):
            assert open3d.io.write_point_cloud(str(path), cloud, compressed=compressed)
            np.testing.assert_allclose(read_imported(path).points, np.asarray(shape.vertices), atol=1e-5)
        return
    for ascii_ in (False, True) if suffix == "ply" else (False,):
        assert open3d.io.write_triangle_mesh(str(path), shape, write_ascii=ascii_)
        found = read_imported(path).corners
        wanted = np.asarray(shape.vertices)[np.asarray(shape.triangles)]
        np.testing.assert_allclose(found, wanted, atol=1e-5)  # texts have six digits


@pytest.mark.parametrize(
    "name", ["one.obj", "text.stl", "binary.stl", "little.ply", "face.ply", "one.glb", "a.xyz", "a.pts"]
)
def test_a_reader_that_leaves_out_an_element_is_found_by_the_count_of_the_bytes(name, tmp_path, monkeypatch):
    raw = {"one.glb": made().bytes(), "a.xyz": b"0 0 0\n1 0 0\n", "a.pts": b"2\n0 0 0\n1 0 0\n"}
    raw |= {key: READ[key][0] for key in READ}
    true = imported_files._read

    def less(*words):
        found = true(*words)
        if isinstance(found, Mesh):
            return Mesh(np.concatenate([found.corners[1:], found.corners[:1], found.corners[:1]]), found.up)
        return type(found)(found.points[1:])

    read(tmp_path, name, raw[name])
    monkeypatch.setattr(imported_files, "_read", less)
    with pytest.raises(InputError, match=r"by its bytes, but \d+ were read"):
        read(tmp_path, name, raw[name])


@pytest.mark.parametrize("kind", WRITERS)
def test_random_files_are_read_to_the_last_triangle(kind, tmp_path):
    outcomes = []
    for number in range(400):
        name = f"test/{number}"
        if random.Random(name).choice(sorted(WRITERS)) == kind:
            outcome, wrong = case(name, tmp_path)
            assert not wrong, (name, wrong)
            outcomes.append(outcome)
        if len(outcomes) == 20:
            break
    assert len({*outcomes} - {"refused"}) > 1


@pytest.mark.slow
def test_mutated_maps_are_read_proven_or_refused(tmp_path):
    """Some hundreds of cases of the fuzzer, the same ones every time; `make fuzz` runs many more."""
    counts = fuzz(120, seed=5, keep=tmp_path, most=1500, inputs=fuzz_meshes.seeds(), run=fuzz_meshes.run_case)
    assert [path.read_text() for path in tmp_path.glob("*/TRACEBACK")] == []
    assert counts["read"] + counts["empty"] + counts["refused"] == 1500
    assert counts["read"] > 40


@pytest.mark.slow
def test_the_search_of_make_attack_finds_no_contradiction():
    found = search(1.0, seed=11)
    assert found.contradictions == []
    assert found.tried == found.counts.total() > 0
