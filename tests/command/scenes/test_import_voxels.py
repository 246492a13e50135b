"""The command `alula import-voxels`: kinds of files, round trips, refusals, and what follows it."""

import json
import shutil

import numpy as np
import pytest
import trimesh

from alula.cli.main import run
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.artifacts.kinds import COVER, VOXELS
from support.files.mesh_files import Glb

SIZE = 0.25


def box(low=(-1, -0.5, 0), high=(1, 0.5, 0.6)):
    return trimesh.creation.box(bounds=[low, high])


def imported(path, *words, size=SIZE):
    out = path.with_suffix(".voxels.npz")
    assert run(["import-voxels", str(path), "-o", str(out), "--size", str(size), "-f", "-q", *words]) == 0
    return read_artifact(out, VOXELS)


def refused(capsys, path, *words, code, says):
    out = path.parent / "refused.voxels.npz"
    assert run(["import-voxels", str(path), "-o", str(out), "--size", str(SIZE), *words]) == code
    printed = capsys.readouterr()
    assert says in printed.err
    assert len(printed.err.splitlines()) == 1, printed.err
    assert not out.exists()


def cells(index):
    return set(map(tuple, index.tolist()))


@pytest.fixture(scope="module")
def solid(tmp_path_factory):
    """Mesh, voxels of the solid, and a cover of them."""
    folder = tmp_path_factory.mktemp("solid")
    box().export(folder / "box.obj")
    imported(folder / "box.obj", "--solid", "--margin", "0.05")
    cover = folder / "box.cover.npz"
    assert run(["merge", str(folder / "box.voxels.npz"), "-o", str(cover), "--hulls", "3", "-q"]) == 0
    return folder


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".ply", ".glb"])
def test_the_same_box_gives_the_same_voxels_in_every_format(suffix, tmp_path):
    shape = box()
    if suffix == ".glb":  # its y axis points up
        shape.apply_transform(np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]))
    shape.export(tmp_path / f"a{suffix}")
    found = imported(tmp_path / f"a{suffix}")
    low, high = np.array([-5, -3, -1]), np.array([4, 2, 2])  # closed contact at -1, -0.5, 0, 0.5 and 1
    inner = (np.array([-3, -1, 1]), np.array([2, 0, 1]))
    every = np.stack(np.meshgrid(*map(np.arange, low, high + 1), indexing="ij"), axis=-1).reshape(-1, 3)
    hollow = ((every >= inner[0]) & (every <= inner[1])).all(axis=1)
    assert cells(found["index"]) == cells(every[~hollow])
    manifest = found.manifest
    assert manifest.sigma is None
    assert manifest.requires == ["imported-map"]
    assert manifest.imported.kind == "mesh"
    assert manifest.imported.up == ("y" if suffix == ".glb" else "z")
    assert [(ref.role, len(ref.sha256)) for ref in manifest.inputs] == [("source", 64)]
    assert manifest.guarantee.statement == "Every voxel that a triangle of the mesh touches is marked."


def test_parameters_change_what_is_marked_and_what_is_guaranteed(tmp_path):
    box().export(tmp_path / "a.obj")
    thin = cells(imported(tmp_path / "a.obj")["index"])
    thick = imported(tmp_path / "a.obj", "--margin", "0.1")
    assert thin < cells(thick["index"])
    assert thick.manifest.guarantee.statement == (
        "Every voxel that a triangle of the mesh, thickened by 0.1 m, touches is marked."
    )
    half = imported(tmp_path / "a.obj", "--crop", "0.1 -9 -9 9 9 9")
    assert cells(half["index"]) == {v for v in thin if v[0] >= 0}
    solid = imported(tmp_path / "a.obj", "--solid", "--crop", "0.1 -9 -9 9 9 9")
    assert cells(solid["index"]) - cells(half["index"]) == {(x, y, 1) for x in (0, 1, 2) for y in (-1, 0)}
    assert solid["overlap"].min() == 0
    small = imported(tmp_path / "a.obj", "--scale", "0.5", size=SIZE / 2)
    assert cells(small["index"]) == thin
    turned = imported(tmp_path / "a.obj", "--up", "y")
    assert cells(turned["index"]) == {(x, -1 - z, y) for x, y, z in thin}


def test_voxels_of_an_octomap_are_those_that_were_exported(solid, tmp_path):
    source = read_artifact(solid / "box.voxels.npz", VOXELS)
    out = tmp_path / "a.bt"
    assert run(["export", str(solid / "box.voxels.npz"), "-o", str(out), "-q"]) == 0
    found = imported(out)
    assert np.array_equal(found["index"], source["index"])
    assert found.manifest.guarantee.statement == (
        "The marked voxels contain every occupied leaf of the octree."
    )
    coarse = imported(out, size=3 * SIZE)
    assert cells(coarse["index"]) == cells(np.unique(source["index"] // 3, axis=0))
    finer = imported(out, size=0.1)  # 2.5 voxels for one
    wanted = set()
    for v in source["index"].tolist():
        axes = [range(5 * i // 2, -(-5 * (i + 1) // 2)) for i in v]
        wanted |= {(x, y, z) for x in axes[0] for y in axes[1] for z in axes[2]}
    assert cells(finer["index"]) == wanted
    for file in (coarse, finer):
        assert file.manifest.imported.kind == "octree"
    assert run(["verify", str(out.with_suffix(".voxels.npz")), "--source", str(out), "-q"]) == 0


def occupied_by_octomap(tree):
    """Cubes of an octree by pyoctomap: occupied and known ones at the finest level."""
    found = {True: set(), False: set()}
    for leaf in tree.begin_leafs():
        edge = round(leaf.getSize() / SIZE)
        low = np.round(np.array(leaf.getCoordinate()) / SIZE - edge / 2).astype(int)
        steps = np.stack(np.meshgrid(*[np.arange(edge)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        found[bool(tree.isNodeOccupied(leaf))] |= cells(low + steps)
    return found[True], found[False]


@pytest.mark.parametrize("suffix", [".bt", ".ot"])
def test_octomaps_own_files_are_read_as_it_reads_them(suffix, tmp_path):
    octomap = pytest.importorskip("pyoctomap")
    tree = octomap.OcTree(SIZE)
    rng = np.random.default_rng(0)
    for x, y, z in rng.integers(-4, 4, (300, 3)).tolist():
        tree.updateNode((np.array([x, y, z]) + 0.5) * SIZE, bool(rng.integers(2)))
    block = np.stack(np.meshgrid(*[np.arange(8, 12)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    for v in block:  # a leaf of 4^3 voxels, once pruned
        tree.updateNode((v + 0.5) * SIZE, True)
    path = tmp_path / f"a{suffix}"
    (tree.writeBinary if suffix == ".bt" else tree.write)(str(path))
    occupied, free = occupied_by_octomap(tree)
    assert cells(block) <= occupied
    assert any(leaf.getSize() > 3.9 * SIZE for leaf in tree.begin_leafs())
    assert cells(imported(path)["index"]) == occupied
    known = np.array(sorted(occupied | free))
    low, high = known.min(axis=0), known.max(axis=0)
    every = np.stack(np.meshgrid(*map(np.arange, low, high + 1), indexing="ij"), axis=-1).reshape(-1, 3)
    full = imported(path, "--unknown", "occupied")
    assert cells(full["index"]) == cells(every) - free
    words = ["verify", str(path.with_suffix(".voxels.npz")), "--source", str(path), "-q"]
    assert run(words) == 0


def test_points_mark_balls_and_few_of_them_are_left_out(tmp_path):
    path = tmp_path / "a.ply"
    points = np.array([[0.1, 0.1, 0.1], [0.12, 0.1, 0.1], [2.1, 0.1, 0.1]])
    trimesh.PointCloud(points).export(path)
    found = imported(path, "--radius", "0.11")
    around = {(0, 0, 0), (-1, 0, 0), (0, -1, 0), (0, 0, -1)}
    assert cells(found["index"]) == around | {(8, 0, 0), (7, 0, 0), (8, -1, 0), (8, 0, -1)}
    twice = imported(path, "--radius", "0.11", "--min-points", "2")
    assert cells(twice["index"]) == around - {(-1, 0, 0)}
    assert "; 5 touched voxels are left out" in twice.manifest.guarantee.statement


def test_the_proof_names_a_voxel_that_is_missing(solid, tmp_path, capsys):
    from alula.schemas.artifacts.artifact import make_artifact, write_artifact

    whole = read_artifact(solid / "box.voxels.npz", VOXELS)
    names = ("frame", "unit", "guarantee", "parameters", "summary", "voxel_size_m", "sigma", "min_overlap")
    fields = {name: getattr(whole.manifest, name) for name in (*names, "inflation_m", "imported", "requires")}
    for gone in ((-5, 0, 0), (0, 0, 1)):  # of the surface, and of the inside
        keep = (whole["index"] != gone).any(axis=1)
        arrays = {"index": whole["index"][keep], "overlap": whole["overlap"][keep]}
        write_artifact(tmp_path / "less.voxels.npz", make_artifact(VOXELS, arrays, **fields))
        words = ["verify", str(tmp_path / "less.voxels.npz"), "--source", str(solid / "box.obj")]
        assert run(words) == 4
        assert ("may touch" if gone[0] else "may lie inside") in capsys.readouterr().err


def test_the_cover_is_proven_against_the_mesh(solid, capsys):
    cover, voxels, mesh = (str(solid / name) for name in ("box.cover.npz", "box.voxels.npz", "box.obj"))
    out = solid / "box.certificate.json"
    words = ["verify", cover, "--voxels", voxels, "--source", mesh, "-o", str(out)]
    assert run([*words, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["statement"] == (
        "covered: every triangle of the mesh, thickened by 0.05 m, and the inside of the mesh, in voxels, "
        "every voxel in a hull"
    )
    assert record["not_checked"] == []
    assert record["given"] == ["cover", "voxels", "source"]
    assert record["level"]["imported"]["solid"]
    assert record["level"]["sigma"] is None
    assert run(["verify", cover, "--voxels", voxels]) == 0
    assert "the source was not given: no triangle was checked" in capsys.readouterr().out
    assert run(["verify", cover, "--scene", str(solid / "none.scene.npz")]) == 3
    assert run(["verify", voxels, "--source", mesh, "--voxels", voxels]) == 2
    assert run(["verify", voxels]) == 3
    capsys.readouterr()
    for command in (["info", cover], ["info", voxels]):
        assert run(command) == 0
    assert "imported" in capsys.readouterr().out


def test_a_cover_comes_back_within_its_solid(solid, tmp_path):
    mesh = tmp_path / "hulls.obj"
    assert run(["export", str(solid / "box.cover.npz"), "-o", str(mesh), "-q"]) == 0
    found = imported(mesh, "--solid")
    members = read_artifact(solid / "box.cover.npz", COVER)["member_index"]
    assert cells(members) <= cells(found["index"])


def test_an_obj_leads_to_a_plan_and_a_flight(tmp_path, capsys):
    parts = [box((-3, -2, -0.2), (3, 2, 0)), box((-0.3, -2, 0), (0.3, 0.5, 2))]
    trimesh.util.concatenate(parts).export(tmp_path / "yard.obj")
    imported(tmp_path / "yard.obj", "--solid")
    f = lambda name: str(tmp_path / name)  # noqa: E731
    ends = ("--start", "-2 -1 1", "--goal", "2 -1 1")
    lines = (
        ["merge", f("yard.voxels.npz"), "-o", f("yard.cover.npz"), "--hulls", "4"],
        ["plan", f("yard.cover.npz"), "-o", f("yard.plan.npz"), "--radius", "0.2", *ends],
        ["verify", f("yard.plan.npz"), "--map", f("yard.cover.npz")],
        ["simulate", f("yard.plan.npz"), "--map", f("yard.cover.npz"), "-o", f("yard.run.mcap")],
    )
    for words in lines:
        assert run([*words, "-q"]) == 0, capsys.readouterr().err
    assert run(["info", f("yard.run.mcap"), "--json"]) == 0


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["--radius", "1e-9"], 2, "--margin must be 0, or between 1e-06 and 1000 m"),
        (["--min-points", "2"], 2, "--min-points is for clouds, and this is a mesh"),
        (["--unknown", "occupied"], 2, "--unknown is for octrees, and this is a mesh"),
        (["--scale", "1e-10"], 2, "--scale must be between 1e-09 and"),
        (["--crop", "5 5 5 6 6 6"], 5, "nothing of the mesh touches the crop"),
        (["--scale", "1e4"], 3, "of --max-voxels, which merge can take; --size"),
        (["--max-voxels", "20"], 3, "more than the 20 of --max-voxels; --"),
    ],
)
def test_parameters_that_do_not_fit_are_refused_in_one_line(words, code, says, solid, tmp_path, capsys):
    shutil.copy(solid / "box.obj", tmp_path / "a.obj")
    refused(capsys, tmp_path / "a.obj", *words, code=code, says=says)


def test_files_with_nothing_to_mark_are_refused_in_one_line(tmp_path, capsys):
    shape = box()
    open_box = trimesh.Trimesh(shape.vertices, shape.faces[1:], process=False)
    open_box.export(tmp_path / "open.obj")
    refused(
        capsys,
        tmp_path / "open.obj",
        "--solid",
        code=3,
        says="is not watertight, as --solid needs it: 3 edges",
    )
    bad = {
        "empty.obj": b"",
        "empty.stl": b"",
        "nan.obj": b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        "lines.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nl 1 2\n",
        "noise.glb": bytes(range(256)),
        "noise.ply": b"ply" + bytes(range(256)),
        "nan.ply": b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
        b"property float z\nend_header\n0 nan 0\n",
        "noise.bt": bytes(range(256)),
        "cut.bt": b"# Octomap OcTree binary file\nid OcTree\nsize 9\nres 0.1\ndata\n\xff",
        "size.bt": b"# Octomap OcTree binary file\nid OcTree\nsize 9\nres 0.1\ndata\n\x02\x00",
        "res.bt": b"# Octomap OcTree binary file\nid OcTree\nsize 2\nres 1e999999999\ndata\n\x02\x00",
        "kind.ot": b"# Octomap OcTree file\nid OcTreeStamped\nsize 1\nres 0.1\ndata\n\x00",
        "a.txt": b"0 0 0\n",
    }
    for name, content in bad.items():
        (tmp_path / name).write_bytes(content)
        refused(capsys, tmp_path / name, code=3, says=name)
    refused(capsys, tmp_path / "none.obj", code=3, says="none.obj: cannot read")


def test_the_library_writes_the_bytes_of_the_command_and_proves_them(solid, tmp_path):
    import alula

    voxels = alula.import_voxels(solid / "box.obj", size_m=SIZE, solid=True, margin_m=0.05)
    voxels.save(tmp_path / "same.voxels.npz")
    assert (tmp_path / "same.voxels.npz").read_bytes() == (solid / "box.voxels.npz").read_bytes()
    assert repr(voxels).endswith("of a mesh")
    proof = alula.verify(voxels, source=solid / "box.obj")
    assert proof.statement.startswith("covered: every triangle of the mesh")
    trimesh.PointCloud(np.eye(3)).export(tmp_path / "a.ply")
    with pytest.raises(alula.InputError, match="a cloud, but the voxels are those of a mesh"):
        alula.verify(voxels, source=tmp_path / "a.ply")


def plate(x):
    """OBJ text of a square at x = const, with indices that count backwards."""
    corners = "".join(f"v {x} {y} {z}\n" for y, z in ((0, 0), (1, 0), (1, 1), (0, 1)))
    return f"{corners}f -4 -3 -2 -1\n"


def test_no_wall_of_an_obj_with_relative_indices_vanishes(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text(plate(0.125) + plate(2.125))
    sides = [(y, z) for y in range(-1, 5) for z in range(-1, 5)]
    found = imported(path)
    assert cells(found["index"]) == {(x, *side) for x in (0, 8) for side in sides}
    assert found.manifest.summary["triangles"] == 4
    assert run(["verify", str(path.with_suffix(".voxels.npz")), "--source", str(path), "-q"]) == 0


def test_metres_of_a_quantised_glb_stay_metres(tmp_path):
    glb = Glb()
    glb.tree["extensionsUsed"] = glb.tree["extensionsRequired"] = ["KHR_mesh_quantization"]
    corners = [(0, 0, 0), (127, 0, 0), (0, 127, 0)]
    where = glb.accessor(corners, "i1", "VEC3", pad=1, normalized=True)
    glb.tree["meshes"].append({"primitives": [{"attributes": {"POSITION": where}}]})
    glb.node(mesh=0, scale=[5, 5, 5], translation=[0.125, 0.125, 0.125])
    path = tmp_path / "a.glb"
    path.write_bytes(glb.bytes())
    found = imported(path)
    low, high = np.array(found.manifest.summary["lower_m"]), np.array(found.manifest.summary["upper_m"])
    assert low.tolist() == [0, -0.25, 0]  # y became z, and z became -y
    assert high.tolist() == [5.25, 0, 5.25]
    assert run(["verify", str(path.with_suffix(".voxels.npz")), "--source", str(path), "-q"]) == 0


def test_a_bent_polygon_marks_both_ways_to_cut_it_and_its_solid_is_closed(tmp_path):
    path = tmp_path / "a.obj"
    top = [(0, 0, 2.1), (2, 0, 4.1), (2, 2, 2.1), (0, 2, 4.1)]
    corners = [(x, y, 0.1) for x, y, _ in top] + top
    faces = [(4, 3, 2, 1), (5, 6, 7, 8), (1, 2, 6, 5), (2, 3, 7, 6), (3, 4, 8, 7), (4, 1, 5, 8)]
    text = "".join(f"v {x + 0.1} {y + 0.1} {z}\n" for x, y, z in corners)
    path.write_text(text + "".join(f"f {a} {b} {c} {d}\n" for a, b, c, d in faces))
    index = cells(imported(path)["index"])
    assert (4, 4, 8) in index  # the middle of the top's one diagonal, at 2.1 m
    assert (4, 4, 16) in index  # and of the other, at 4.1 m
    solid = imported(path, "--solid")
    assert solid.manifest.summary["triangles"] == 12
    assert solid.manifest.summary["triangles_of_polygons_that_are_not_flat"] == 2
    assert (4, 4, 4) in cells(solid["index"]) - index
    assert run(["verify", str(path.with_suffix(".voxels.npz")), "--source", str(path), "-q"]) == 0


def test_points_of_no_triangle_are_named_as_left_out(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 5 5 5\nf 1 2 3\n")
    left_out = imported(tmp_path / "a.obj").manifest.guarantee.claims["left_out"]
    assert left_out["points_of_no_triangle"] == 1


def test_points_with_commas_are_refused_by_import_and_proof(tmp_path, capsys):
    path = tmp_path / "a.xyz"
    path.write_text("0 0 0\n1 1 1\n")
    imported(path, "--radius", "0.1")
    path.write_text("0 0 0\n1,1,1\n")
    refused(capsys, path, code=3, says="a.xyz: line 2: a point needs numbers with spaces between them")
    assert run(["verify", str(path.with_suffix(".voxels.npz")), "--source", str(path)]) == 3
    assert "a.xyz: line 2" in capsys.readouterr().err


@pytest.mark.parametrize("words", [(), ("--crop", "0 0 0 900 900 900")])
def test_an_octree_with_a_huge_leaf_is_refused_before_the_work(words, tmp_path, capsys):
    node = b"\0\0\x80\x3f"
    head = b"# Octomap OcTree file\nid OcTree\nsize 2\nres 0.1\ndata\n"
    (tmp_path / "a.ot").write_bytes(head + node + b"\x80" + node + b"\0")  # 32,768 cubes along each edge
    refused(capsys, tmp_path / "a.ot", *words, code=3, says="of --max-voxels, which merge can take")


UTM = np.array([450_000.0, 4_500_000.0, 100.0])


def placed_box(path, at):
    """A box whose faces lie off the lattice, moved; an OBJ with its numbers in full."""
    low, high = np.array([-1.1, -0.6, -0.3]) + at, np.array([0.9, 0.4, 0.7]) + at
    mesh = trimesh.creation.box(bounds=[low, high])
    corners = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    path.write_text("\n".join([*corners, *(f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()), ""]))
    return mesh


def test_a_map_of_the_earth_gets_an_origin_of_its_own_and_stays_proven(tmp_path, capsys):
    placed_box(tmp_path / "near.obj", np.zeros(3))
    placed_box(tmp_path / "far.obj", UTM)
    near, far = imported(tmp_path / "near.obj"), imported(tmp_path / "far.obj")
    assert far.manifest.imported.map_origin_m == [450_000, 4_500_000, 0]
    assert near.manifest.imported.map_origin_m == [0, 0, 0]
    assert cells(far["index"]) == cells(near["index"] + [0, 0, 400])
    cover, voxels = tmp_path / "far.cover.npz", tmp_path / "far.voxels.npz"
    assert run(["merge", str(voxels), "-o", str(cover), "--hulls", "2", "-q"]) == 0
    assert run(["verify", str(cover), "--voxels", str(voxels), "--source", str(tmp_path / "far.obj")]) == 0
    assert run(["verify", str(cover), "--voxels", str(voxels), "--source", str(tmp_path / "near.obj")]) == 4
    capsys.readouterr()
    assert run(["export", str(cover), "-o", str(tmp_path / "out.obj"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["summary"]["map_origin_m"] == [450_000, 4_500_000, 0]
    given = imported(tmp_path / "far.obj", "--map-origin", "450001 4500000 100")
    assert cells(given["index"]) == cells(near["index"] - [4, 0, 0])
    words = ["--crop", "449999 4499999 99 450001 4500001 101"]
    refused(
        capsys, tmp_path / "far.obj", *words, code=3, says='give --map-origin, such as "450000 4500000 0"'
    )


@pytest.mark.parametrize("suffix", [".stl", ".ply"])
def test_numbers_that_are_coarser_than_the_voxels_are_refused(suffix, tmp_path, capsys):
    mesh = placed_box(tmp_path / "far.obj", UTM)
    mesh.export(tmp_path / f"far{suffix}")
    says = "rounded by up to 0.251 m: walls may be lost"
    refused(capsys, tmp_path / f"far{suffix}", code=3, says=says)
    grown = imported(tmp_path / f"far{suffix}", "--margin", "0.251")
    exact = imported(tmp_path / "far.obj")
    assert cells(grown["index"]) >= cells(exact["index"])  # all walls are there
    imported(tmp_path / f"far{suffix}", size=3)  # fine enough for these
