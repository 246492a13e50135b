"""Meshes and clouds in every format, in random encodings, with the triangles that were written, in fractions.

The writers follow the formats' descriptions and share nothing with the readers.
"""

import json
import struct
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import combinations

import numpy as np

CODES = {"i1": 5120, "u1": 5121, "<i2": 5122, "<u2": 5123, "<u4": 5125, "<f4": 5126}
LARGEST = {"i1": 127, "u1": 255, "<i2": 32767, "<u2": 65535}
NAMES = {
    "f4": ("float", "float32"), "f8": ("double", "float64"), "i2": ("short", "int16"), "i4": ("int", "int32"),
    "u1": ("uchar", "uint8"), "u2": ("ushort", "uint16"), "u4": ("uint", "uint32"),
}  # fmt: skip


@dataclass
class Written:
    """A file, and what it holds.

    `triangles` (or `points`) are in the file's frame, in fractions; `refused` says what makes the file one
    that no reader may accept, and is empty for others.
    """

    suffix: str
    raw: bytes
    triangles: list = field(default_factory=list)
    points: list = field(default_factory=list)
    refused: str = ""


def shapes(rng, grid=8, *, only_triangles=False, closed=False):
    """Vertices on a grid, in fractions, and polygons: triangles, bent ones, a rectangle; or a tetrahedron."""
    point = lambda: [Fraction(rng.randint(-2 * grid, 2 * grid), grid) for _ in range(3)]  # noqa: E731
    vertices = [point() for _ in range(rng.randint(5, 8))]
    if closed:
        return vertices, [[0, 1, 2], [1, 0, 3], [2, 1, 3], [0, 2, 3]]
    polygons = []
    for _ in range(rng.randint(1, 4)):
        size = 3 if only_triangles else rng.choice((3, 3, 3, 4, 5))
        polygon = rng.sample(range(len(vertices)), size)
        is_flat = any(len({vertices[i][k] for i in polygon}) == 1 for k in range(3))
        polygons.append(polygon[:3] if is_flat else polygon)
    if rng.random() < 0.1:
        polygons.append([0, 1, 1])
    if not only_triangles and rng.random() < 0.3:
        low, high, n = point(), point(), len(vertices)
        vertices += [[low[0], low[1], low[2]], [high[0], low[1], low[2]]]
        vertices += [[high[0], high[1], low[2]], [low[0], high[1], low[2]]]
        polygons.append(rng.choice(([n, n + 1, n + 2, n + 3], [n + 3, n + 2, n + 1, n])))
    return vertices, polygons


def cut(vertices, polygons):
    """All triangles of three corners of each polygon: they contain every way to cut it."""
    return [[vertices[i] for i in three] for polygon in polygons for three in combinations(polygon, 3)]


def decimal(value):
    """Decimal text of a fraction whose denominator has only the factors 2 and 5."""
    whole, digits = value, 0
    while whole.denominator != 1:
        whole *= 10
        digits += 1
    text = str(abs(whole.numerator)).rjust(digits + 1, "0")
    text = f"{text[:-digits]}.{text[-digits:]}" if digits else text
    return ("-" if value < 0 else "") + text


OBJ_POISON = {
    "l\t1 2": "line", "p 1": "point", "curv 0 1 1 2": "curve", "surf 0 1 0 1 1 2 3 4": "surface",
    "F 1 2 3": "case", "call more.obj": "file", "fo 1 2 3": "old face", "cstype bezier": "curve",
    "g a\\\nf 1 2 3": "hidden line",
}  # fmt: skip


def obj(rng):
    """Blocks of vertices and faces, with relative or absolute indices, in any spelling of the format."""
    space = lambda: rng.choice((" ", "  ", "\t", " \t"))  # noqa: E731
    end = rng.choice(("\n", "\r\n", "\r"))
    wrap = (lambda: "\\" + end) if rng.random() < 0.3 else (lambda: "")
    lines, triangles, done = ["# \\ made by a test"] if rng.random() < 0.3 else [], [], 0
    colour = rng.choice(("", "", " 1", " 0.5 0.5 1"))
    closed = rng.random() < 0.25
    for block in range(rng.randint(1, 3)):
        vertices, polygons = shapes(rng, 10, closed=closed)
        lines += rng.choice(
            ([], [f"o part {block}", "usemtl a\\b"], ["g a b", "s off", "vt 0 0", "vn 0 0 1"])
        )
        for vertex in vertices:
            words = [decimal(c) for c in vertex]
            lines.append(rng.choice(("", " ")) + f"v{space()}{space().join(words)}{colour}")
        texture = rng.choice(("", "/1", "//1", "/1/1")) if any("vt" in line for line in lines) else ""
        relative, ahead = rng.random() < 0.5, []
        for polygon in polygons:
            words = [str(i - len(vertices) if relative else done + i + 1) + texture for i in polygon]
            middle = rng.randint(1, len(words))
            comment = rng.choice(("", "", " # f 1 2 3"))
            left, right = space().join(words[:middle]), space().join(words[middle:])
            ahead.append(f"f{space()}{left}{space()}{wrap()}{space()}{right}{comment}")
        if rng.random() < 0.2 and not relative and block == 0:  # before their vertices
            lines = ahead + lines
        else:
            lines += ahead
        triangles += cut(vertices, polygons)
        done += len(vertices)
    refused = ""
    if rng.random() < 0.2:
        line, refused = rng.choice(sorted(OBJ_POISON.items()))
        lines.insert(rng.randint(0, len(lines)), line)
    return Written(".obj", (end.join(lines) + rng.choice(("", end))).encode(), triangles, refused=refused)


def stl(rng):
    """Binary, with a header that looks like text, or text in any spelling."""
    vertices, polygons = shapes(rng, only_triangles=True, closed=rng.random() < 0.25)
    triangles = [[vertices[i] for i in polygon] for polygon in polygons]
    refused = ""
    if rng.random() < 0.5:
        head = rng.choice((b"solid test\nfacet", b"COLOR=RGBA", b"")).ljust(80, b" ")
        rows = b"".join(
            struct.pack("<12fH", *(0.0, 0.0, 1.0), *(float(c) for p in t for c in p), rng.choice((0, 0x8123)))
            for t in triangles
        )
        count = len(triangles)
        if rng.random() < 0.2:
            refused, count = "count", count - 1
        return Written(".stl", head + struct.pack("<I", count) + rows, triangles, refused=refused)
    case = rng.choice((str.lower, str.upper, str.title))
    end = rng.choice(("\n", "\r\n", "\n\n  "))
    lines = [case("solid") + rng.choice(("", " endfacet facet", " a"))]
    for t in triangles:
        lines += [case("facet normal") + " 0 0 1e0", case("outer  loop")]
        lines += [case("vertex") + "\t" + "  ".join(decimal(c) for c in p) for p in t]
        lines += [case("endloop"), case("endfacet")]
        if rng.random() < 0.1:
            lines += [case("endsolid") + " a", case("solid") + " b"]
    lines.append(case("endsolid"))
    if rng.random() < 0.2:
        refused = "a fourth corner"
        lines.insert(
            rng.choice([i for i, line in enumerate(lines) if line.lower() == "endloop"]), "vertex 0 0 0"
        )
    return Written(".stl", (end.join(lines) + "\n").encode(), triangles, refused=refused)


def _ply_head(rng, form, comments):
    two = rng.choice((" ", "  ", "\t"))
    return ["ply", f"format {form} 1.0", *comments], two


def ply(rng):
    """Polygons, strips or points, as text or in either byte order, with columns that mean nothing here."""
    form, order = rng.choice((("ascii", ""), ("binary_little_endian", "<"), ("binary_big_endian", ">")))
    long = rng.random() < 0.1
    head, two = _ply_head(rng, form, ["comment " + "x" * 70_000] if long else ["obj_info a"])
    is_whole = rng.random() < 0.2
    vertices, polygons = shapes(rng, 1 if is_whole else 8, closed=rng.random() < 0.25)
    kind = rng.choice(("i2", "i4") if is_whole else ("f4", "f8"))
    strips = rng.random() < 0.2
    is_cloud = not strips and rng.random() < 0.2
    columns = [(axis, kind) for axis in "xyz"]
    for extra in rng.choice(([], [("nx", "f4")], [("red", "u1"), ("quality", "f8")])):
        columns.insert(rng.randint(0, len(columns)), extra)
    head.append(f"element{two}vertex{two}{len(vertices)}")
    head += [f"property{two}{rng.choice(NAMES[code])} {name}" for name, code in columns]
    rows = []
    for v in vertices:
        value = dict(zip("xyz", v, strict=True))
        rows.append([(code, value.get(name, Fraction(1))) for name, code in columns])
    corner, length = rng.choice(("i4", "u4", "i2", "u1")), rng.choice(("u1", "i4", "u2"))
    names = ["vertex_indices", "vertex_index"]
    refused = ""
    triangles = [] if is_cloud else cut(vertices, polygons)
    if strips:
        corner = rng.choice(("i4", "i2"))
        strip = [*rng.sample(range(len(vertices)), 5), -1, *rng.sample(range(len(vertices)), 4)]
        runs = [strip[:5], strip[6:]]
        triangles = [[vertices[i] for i in run[k : k + 3]] for run in runs for k in range(len(run) - 2)]
        head += [f"element{two}tristrips 1", f"property list int {NAMES[corner][0]} vertex_indices"]
        rows.append([("i4", Fraction(len(strip))), *((corner, Fraction(i)) for i in strip)])
    elif not is_cloud:
        flags, texture = rng.random() < 0.3, rng.random() < 0.3
        if rng.random() < 0.1:
            names, refused = ["corners"], "no known list"
        head.append(f"element{two}face {len(polygons)}")
        head += ["property uchar flags"] * flags
        head.append(
            f"property list {rng.choice(NAMES[length])} {rng.choice(NAMES[corner])} {rng.choice(names)}"
        )
        head += ["property list uchar float texcoord"] * texture
        for p in polygons:
            row = [("u1", Fraction(3))] * flags + [(length, Fraction(len(p)))]
            row += [(corner, Fraction(i)) for i in p]
            rows.append(
                row + ([("u1", Fraction(2)), ("f4", Fraction(1, 2)), ("f4", Fraction(0))] if texture else [])
            )
    if rng.random() < 0.15:
        refused = "edges"
        head += ["element edge 1", "property int vertex1", "property int vertex2"]
        rows.append([("i4", Fraction(0)), ("i4", Fraction(1))])
    head.append("end_header")
    if order:
        body = b"".join(
            np.array(float(v) if code[0] == "f" else int(v), order + code).tobytes()
            for row in rows
            for code, v in row
        )
    else:
        gap = rng.choice((" ", "\t", "  "))
        body = "\n".join(gap.join(decimal(v) for _, v in row) for row in rows).encode() + rng.choice(
            (b"", b"\n")
        )
    end = "\r\n" if rng.random() < 0.3 else "\n"
    raw = (end.join(head) + end).encode() + body
    return Written(".ply", raw, triangles, vertices if is_cloud else [], refused)


class Glb:
    """A binary glTF file being made."""

    def __init__(self):
        self.binary = bytearray()
        self.tree = {
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}], "nodes": [], "meshes": [],
            "accessors": [], "bufferViews": [],
        }  # fmt: skip

    def view(self, raw, **fields):
        self.binary += bytes(-len(self.binary) % 4)
        self.tree["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(raw), **fields}
        )
        self.binary += raw
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, rows, code, kind, pad=0, **fields):
        """Rows of stored numbers; with `pad` bytes between them."""
        table = np.array(rows, code).reshape(len(rows), -1)
        raw = b"".join(row.tobytes() + bytes(pad) for row in table)
        stride = {"byteStride": table[:1].nbytes + pad} if pad else {}
        self.tree["accessors"].append(
            {
                "bufferView": self.view(raw, **stride),
                "componentType": CODES[code],
                "count": len(rows),
                "type": kind,
            }
            | fields
        )
        return len(self.tree["accessors"]) - 1

    def sparse(self, rows, code, kind, base):
        """An accessor whose rows are those of `base`, or zeros, but for some that are listed."""
        count = len(rows)
        wrong = (
            [i for i in range(count) if any(c != 0 for c in rows[i])]
            if base is None
            else list(range(0, count, 2))
        )
        accessor = {"componentType": CODES[code], "count": count, "type": kind}
        if base is not None:
            stored = [[0.0] * 3 if i in wrong else row for i, row in enumerate(rows)]
            accessor["bufferView"] = self.view(np.array(stored, code).tobytes())
        if wrong:
            accessor["sparse"] = {
                "count": len(wrong),
                "indices": {"bufferView": self.view(np.array(wrong, "<u2").tobytes()), "componentType": 5123},
                "values": {"bufferView": self.view(np.array([rows[i] for i in wrong], code).tobytes())},
            }
        else:
            accessor["bufferView"] = self.view(np.array(rows, code).tobytes())
        self.tree["accessors"].append(accessor)
        return len(self.tree["accessors"]) - 1

    def node(self, root=True, **fields):
        self.tree["nodes"].append(fields)
        if root:
            self.tree["scenes"][0]["nodes"].append(len(self.tree["nodes"]) - 1)
        return len(self.tree["nodes"]) - 1

    def bytes(self):
        tree = self.tree | {"buffers": [{"byteLength": len(self.binary)}]}
        text = json.dumps(tree).encode()
        text += b" " * (-len(text) % 4)
        binary = bytes(self.binary) + bytes(-len(self.binary) % 4)
        chunks = (
            struct.pack("<2I", len(text), 0x4E4F534A)
            + text
            + struct.pack("<2I", len(binary), 0x004E4942)
            + binary
        )
        return b"glTF" + struct.pack("<2I", 2, 12 + len(chunks)) + chunks


def moved(node, p):
    """A point by the transform of a node, exactly for the doubles that JSON holds."""
    if "matrix" in node:
        m = [Fraction(v) for v in node["matrix"]]
        return [sum(m[4 * k + i] * p[k] for k in range(3)) + m[12 + i] for i in range(3)]
    p = [Fraction(s) * c for s, c in zip(node.get("scale", (1, 1, 1)), p, strict=True)]
    x, y, z, w = (Fraction(v) for v in node.get("rotation", (0, 0, 0, 1)))
    n = x * x + y * y + z * z + w * w
    cross = lambda a, b: [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]  # noqa: E731
    t = [2 * c for c in cross((x, y, z), p)]
    u = cross((x, y, z), t)
    turned = [c + (w * a + b) / n for c, a, b in zip(p, t, u, strict=True)]
    return [c + Fraction(s) for c, s in zip(turned, node.get("translation", (0, 0, 0)), strict=True)]


def mirrors(nodes):
    """Whether the nodes turn triangles inside out, which the standard undoes."""
    unit = [[Fraction(int(i == k)) for k in range(3)] for i in range(3)]
    ends = [[Fraction(0)] * 3, *unit]
    for node in nodes:
        ends = [moved(node, p) for p in ends]
    a, b, c = ([q - o for q, o in zip(end, ends[0], strict=True)] for end in ends[1:])
    cross = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]]
    return sum(x * y for x, y in zip(a, cross, strict=True)) < 0


def transform(rng):
    """Random fields of a node."""
    if rng.random() < 0.2:
        m = [[rng.choice((0, 0, 1, -1, 0.5, 2)) for _ in range(3)] for _ in range(3)]
        t = [rng.randint(-8, 8) / 4 for _ in range(3)]
        return {"matrix": [*m[0], 0, *m[1], 0, *m[2], 0, *t, 1]}
    found = {}
    if rng.random() < 0.5:
        found["translation"] = [rng.randint(-8, 8) / 4 for _ in range(3)]
    if rng.random() < 0.5:
        found["rotation"] = rng.choice(
            ([0, 0, 0.6, 0.8], [0.5, 0.5, 0.5, 0.5], [0, 1, 0, 0], [0.70710678, 0, 0, 0.70710678])
        )
    if rng.random() < 0.5:
        found["scale"] = [rng.choice((-1, 0.5, 1, 1.5)) for _ in range(3)]
    return found


GLB_POISON = (
    "morph",
    "skin",
    "instancing",
    "draco",
    "meshopt",
    "lines",
    "animation",
    "outside",
    "no node",
    "splat",
)


def glb(rng):
    """Triangles, strips and fans, sparse, quantised or interleaved, in a tree of nodes."""
    made, triangles = Glb(), []
    closed = rng.random() < 0.3
    for _ in range(rng.randint(1, 2) + closed):
        vertices, polygons = shapes(rng, only_triangles=True, closed=closed)
        where, stored = _positions(made, rng, vertices)
        mode = 4 if closed else rng.choice((4, 4, 5, 6))
        index = [i for p in polygons for i in p]
        primitive = {"attributes": {"POSITION": where}, "mode": mode}
        if mode == 4 and rng.random() < 0.5:
            del primitive["mode"]
        if rng.random() < 0.2:
            index = (
                list(range(len(vertices) - len(vertices) % 3)) if mode == 4 else list(range(len(vertices)))
            )
            if len(index) < len(vertices):
                primitive["indices"] = made.accessor([[i] for i in index], "u1", "SCALAR")
        else:
            primitive["indices"] = made.accessor(
                [[i] for i in index], rng.choice(("u1", "<u2", "<u4")), "SCALAR"
            )
        if mode == 4:
            threes = [index[k : k + 3] for k in range(0, len(index), 3)]
        elif mode == 5:
            threes = [index[k : k + 3] for k in range(len(index) - 2)]
        else:
            threes = [[index[0], *index[k : k + 2]] for k in range(1, len(index) - 1)]
        made.tree["meshes"].append({"primitives": [primitive]})
        nodes = [transform(rng) for _ in range(rng.randint(1, 3))]
        child = made.node(root=len(nodes) == 1, mesh=len(made.tree["meshes"]) - 1, **nodes[0])
        for depth, node in enumerate(nodes[1:], start=2):
            child = made.node(root=depth == len(nodes), children=[child], **node)
        for three in threes:
            points = [stored[i] for i in three]
            for node in nodes:
                points = [moved(node, p) for p in points]
            triangles.append(points[::-1] if mirrors(nodes) else points)
    refused = rng.choice(GLB_POISON) if rng.random() < 0.25 else ""
    _poison(made, refused)
    return Written(".glb", made.bytes(), triangles, refused=refused)


def _positions(made, rng, vertices):
    """Accessor of positions, and the numbers that it stands for."""
    form = rng.choice(("float", "float", "padded", "sparse", "sparse zeros", "integer", "normalised"))
    rows = [[float(c) for c in v] for v in vertices]
    if form in ("float", "padded"):
        return made.accessor(rows, "<f4", "VEC3", pad=4 if form == "padded" else 0), vertices
    if form.startswith("sparse"):
        return made.sparse(rows, "<f4", "VEC3", None if form == "sparse zeros" else rows), vertices
    made.tree["extensionsUsed"] = made.tree["extensionsRequired"] = ["KHR_mesh_quantization"]
    code = rng.choice(("i1", "<i2", "u1", "<u2"))
    codes = [[rng.randint(np.iinfo(code).min, np.iinfo(code).max) for _ in range(3)] for _ in vertices]
    if form == "normalised":
        stored = [[max(Fraction(c, LARGEST[code]), Fraction(-1)) for c in row] for row in codes]
        return made.accessor(codes, code, "VEC3", normalized=True), stored
    small = [[c % 5 for c in row] for row in codes]
    return made.accessor(small, code, "VEC3"), [[Fraction(c) for c in row] for row in small]


def _poison(made, name):
    """Add a feature that moves, adds or hides triangles."""
    primitive, node = made.tree["meshes"][0]["primitives"][0], made.tree["nodes"][0]
    if name == "morph":
        primitive["targets"] = [{"POSITION": primitive["attributes"]["POSITION"]}]
        made.tree["meshes"][0]["weights"] = [1.0]
    elif name == "skin":
        made.tree["skins"], node["skin"] = [{"joints": [0]}], 0
    elif name == "instancing":
        node["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": {}}}
    elif name == "draco":
        primitive["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {}}}
    elif name == "meshopt":
        made.tree["bufferViews"][0]["extensions"] = {"EXT_meshopt_compression": {"buffer": 0}}
    elif name == "lines":
        made.tree["meshes"].append({"primitives": [primitive | {"mode": 1}]})
        made.node(mesh=len(made.tree["meshes"]) - 1)
    elif name == "animation":
        made.tree["animations"] = [{"channels": [], "samplers": []}]
    elif name == "outside":
        made.node(root=False, mesh=0)
    elif name == "no node":
        made.tree["meshes"].append({"primitives": [primitive]})
    elif name == "splat":
        primitive["extensions"] = {"KHR_gaussian_splatting": {}}


def cloud(rng):
    """Points as text, in any spelling, or as a PCD."""
    points = [[Fraction(rng.randint(-16, 16), 8) for _ in range(3)] for _ in range(rng.randint(1, 12))]
    suffix = rng.choice((".xyz", ".xyzn", ".pts", ".pcd"))
    refused = rng.choice(("comma", "word", "count", "")) if rng.random() < 0.3 else ""
    if suffix == ".pcd":
        return _pcd(rng, points, "count" if refused else "")
    end = rng.choice(("\n", "\r\n", "\r"))
    gap = rng.choice((" ", "\t", "   "))
    extra = rng.choice(([], ["0.5"], ["1", "2", "3"]))
    lines = [gap.join([decimal(c) for c in p] + extra) for p in points]
    if refused == "comma":
        lines[-1] = lines[-1].replace(gap, "," if rng.random() < 0.5 else ", ")
    elif refused == "word":
        lines.insert(0, "x y z")
    elif refused == "count":
        lines[-1] = lines[-1].rpartition(gap)[0] if len(lines) > 1 else ""
    if suffix == ".pts":
        lines.insert(0, str(len(points)))
    if rng.random() < 0.3:
        lines.insert(rng.randint(0, len(lines)), "# 1 2 3 \u00e4")
        lines.insert(rng.randint(0, len(lines)), "")
    return Written(suffix, (end.join(lines) + rng.choice(("", end))).encode(), points=points, refused=refused)


def _pcd(rng, points, refused):
    kind = rng.choice(("ascii", "binary", "binary_compressed"))
    code = rng.choice(("f4", "f8"))
    count = len(points) + (1 if refused else 0)
    head = [
        "# .PCD v0.7",
        "VERSION 0.7",
        "FIELDS a x y z",
        f"SIZE 1 {code[1]} {code[1]} {code[1]}",
        "TYPE U F F F",
    ]
    head += ["COUNT 2 1 1 1", f"WIDTH {count}", "HEIGHT 1", "VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {count}"]
    row = np.dtype([("a", "u1", 2), ("p", "<" + code, 3)])
    table = np.array([((7, 9), [float(c) for c in p]) for p in points], row)
    body = table.tobytes()
    if kind == "ascii":
        body = "\n".join("7 9 " + " ".join(decimal(c) for c in p) for p in points).encode() + b"\n"
    elif kind == "binary_compressed":
        plain = table["a"].tobytes() + np.ascontiguousarray(table["p"].T).tobytes()
        literals = [plain[i : i + 32] for i in range(0, len(plain), 32)]
        packed = b"".join(bytes([len(part) - 1]) + part for part in literals)
        body = struct.pack("<2I", len(packed), len(plain)) + packed
    return Written(
        ".pcd", ("\n".join([*head, f"DATA {kind}"]) + "\n").encode() + body, points=points, refused=refused
    )


WRITERS = {"obj": obj, "stl": stl, "ply": ply, "glb": glb, "cloud": cloud}
