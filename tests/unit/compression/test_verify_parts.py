"""Covers in parts are proven part by part, as strictly as one file; a part can be proven against the list."""

import dataclasses
import hashlib
from pathlib import Path

import msgspec
import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.artifacts import merkle
from alula.schemas.artifacts.artifact import Artifact, write_artifact
from alula.schemas.artifacts.kinds import SCENE, VOXELS
from alula.schemas.artifacts.parts import open_parts
from alula.schemas.errors import ArtifactError, CheckError, UsageError
from alula.schemas.parameters.configs.merge import MergeConfig
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.stages.compression import verify_cubes
from alula.stages.compression import verify_parts as parts_stage
from alula.stages.compression.merge import merge
from alula.stages.compression.merge_blocks import merge_blocks, plan_blocks
from alula.stages.compression.verify import verify
from alula.stages.compression.verify_parts import OUTSIDE, prove_part, verify_parts
from alula.stages.compression.voxelize import voxelize
from support.scenes.covers import failing, with_manifest
from support.scenes.fabricate import make_scene

SIZE_M = 0.05


class Memory:
    """Parts in memory, with references as an index would have them."""

    def __init__(self, manifest, artifacts, domains=None):
        self.manifest, self.artifacts = manifest, list(artifacts)
        self.refs = tuple(
            Ref(
                *(f"part-{n:05d}", hashlib.sha256(b"%d" % n).hexdigest(), len(next(iter(a.arrays.values())))),
                *(d, *box_of(a)),
            )
            for n, (a, d) in enumerate(zip(self.artifacts, domains or [None] * len(artifacts), strict=True))
        )

    def __len__(self):
        return len(self.artifacts)

    def __getitem__(self, number):
        return self.artifacts[number]

    def touching(self, lower, upper, *, sigma=0.0, inflation=0.0):
        return list(range(len(self)))

    def but(self, number, artifact):
        """The same with one part replaced."""
        parts = list(self.artifacts)
        parts[number] = artifact
        return Memory(self.manifest, parts, [ref.domain for ref in self.refs])


@dataclasses.dataclass(frozen=True)
class Ref:
    file: str
    sha256: str
    count: int
    domain: list | None
    lower: tuple
    upper: tuple


def box_of(artifact):
    name = next(name for name in ("mean", "index", "vertex") if name in artifact.arrays)
    rows = artifact[name] if len(artifact[name]) else np.zeros((1, 3))
    rows = rows * (1.0 if name == "mean" else artifact.manifest.voxel_size_m)
    return rows.min(axis=0).tolist(), rows.max(axis=0).tolist()


def rows_of(scene, rows):
    return Artifact(scene.manifest, {name: array[rows] for name, array in scene.arrays.items()})


@pytest.fixture(scope="module")
def scene():
    return make_scene(500)


@pytest.fixture(scope="module")
def voxels(scene):
    return voxelize(VoxelizeConfig(size_m=SIZE_M, min_overlap=1), scene)


@pytest.fixture(scope="module")
def parts(voxels):
    return covered(voxels)


def covered(voxels, block=24):
    from alula.schemas.artifacts.parts import Parts

    config = MergeConfig(hulls=12, block_m=block * SIZE_M, per_block=True)
    plan = plan_blocks(config, Parts.of(voxels))
    covers = list(merge_blocks(config, plan, jobs=1))
    assert len(covers) > 2
    growth = sum((c.manifest.conservativeness - 1) * c.manifest.summary["voxels"] for c in covers)
    whole = msgspec.structs.replace(covers[0].manifest, conservativeness=1 + growth / plan.voxels)
    return Memory(whole, covers, [plan.domain(n) for n in range(len(covers))])


def single(artifact):
    return Memory(artifact.manifest, [artifact])


def split(artifact, name):
    """An artifact in three parts, row by row."""
    rows = [np.arange(k, len(artifact[name]), 3) for k in range(3)]
    return Memory(artifact.manifest, [rows_of(artifact, some) for some in rows])


def test_a_cover_in_parts_is_proven_as_strictly_as_one_file(scene, voxels, parts):
    proof = verify_parts(parts, voxels=single(voxels), scene=single(scene), jobs=1)
    assert proof.covered, failing(proof)
    whole = verify(merge(MergeConfig(hulls=60), voxels), voxels=voxels, scene=scene)
    assert {check.name for check in whole.checks} < {check.name for check in proof.checks}
    assert (proof.statement, proof.left_out, proof.level) == (whole.statement, whole.left_out, whole.level)
    assert [entry.name for entry in proof.parts] == [*(ref.file for ref in parts.refs), OUTSIDE]
    assert merkle.root([entry.certificate for entry in proof.parts]) == proof.merkle_root
    counted = {check.name: check.checked for check in proof.checks}
    assert counted["every voxel is a member"] == len(voxels["index"])
    assert len(scene["mean"]) <= counted["every ellipsoid lies in the voxels"] < 2 * len(scene["mean"])


@pytest.mark.parametrize("given", ["voxels", "scene", "nothing"])
def test_the_proof_depends_neither_on_the_parts_of_others_nor_on_jobs(scene, voxels, parts, given):
    one = {"voxels": single(voxels) if given == "voxels" else None}
    many = {"voxels": split(voxels, "index") if given == "voxels" else None}
    one["scene"] = single(scene) if given == "scene" else None
    many["scene"] = split(scene, "mean") if given == "scene" else None
    first = verify_parts(parts, **one, jobs=1)
    assert first.covered
    second = verify_parts(parts, **many, jobs=2 if given == "nothing" else 1)
    if given == "scene":  # rows come in another order, and the certificates count them alone
        assert second.covered
    assert second.merkle_root == first.merkle_root
    assert second == first


@pytest.fixture
def small_cells(monkeypatch):
    """Cells of few voxels and ellipsoids, and the tasks that were made of them."""
    made = []
    for name, value in {"CELL_VOXELS": 60, "CELL_ELLIPSOIDS": 12, "_MEMBERS": 120, "_AT_ONCE": 64}.items():
        monkeypatch.setattr(verify_cubes, name, value)
    monkeypatch.setattr(verify_cubes, "_LEAST_HALVED", 4)
    monkeypatch.setattr(
        parts_stage, "proof_of", lambda task: made.append(task) or verify_cubes.proof_of(task)
    )
    return made


@pytest.mark.parametrize("given", ["both", "scene", "nothing"])
def test_cells_bound_what_a_proof_holds_and_do_not_change_it(scene, voxels, parts, given, request):
    files = {"voxels": single(voxels)} if given == "both" else {}
    files |= {} if given == "nothing" else {"scene": single(scene)}
    at_once = verify_parts(parts, **files, jobs=1)
    made = request.getfixturevalue("small_cells")
    by_cells = verify_parts(parts, **files, jobs=1)
    assert len(made) > 1.5 * len(parts)
    for task in made:
        if (np.ptp(task.cube, axis=0) >= 7).any():
            assert len(task.near) <= 120
            assert len(task.rows) <= 12
    assert by_cells == at_once
    assert by_cells.merkle_root == at_once.merkle_root


def test_cells_find_what_a_whole_part_finds(scene, voxels, parts, small_cells):
    """A missing voxel, a hull that is not exact, and a volume that is not the recorded one."""
    lost = parts[1]["member_index"][0]
    fewer = voxels["index"][(voxels["index"] != lost).any(axis=1)]
    fewer = Artifact(voxels.manifest, {"index": fewer, "overlap": np.ones(len(fewer), np.uint32)})
    proof = verify_parts(parts, voxels=single(fewer), scene=single(scene), jobs=1)
    assert set(failing(proof)) >= {"every voxel is a member", "every ellipsoid lies in the voxels"}
    voxel = next(c for c in proof.checks if c.name == "every voxel is a member").first[0].voxel
    assert list(voxel) == lost.tolist()
    offset = parts[2]["plane_offset"].copy()
    offset[-1] -= 1
    wrong = Artifact(parts[2].manifest, {**parts[2].arrays, "plane_offset": offset})
    proof = verify_parts(parts.but(2, wrong), voxels=single(voxels), jobs=1)
    assert "hulls are exact polytopes" in failing(proof)
    first = next(c for c in proof.checks if c.name == "hulls are exact polytopes").first[0]
    assert first.hull == len(parts[2]["plane_start"]) - 2
    assert first.plane in (None, len(offset) - 1)
    other = with_manifest(parts[0], conservativeness=parts[0].manifest.conservativeness + 1e-4)
    proof = verify_parts(parts.but(0, other), voxels=single(voxels), jobs=1)
    assert "volume is as recorded" in failing(proof)


def test_a_missing_voxel_is_found_in_its_part_and_by_the_scene(scene, voxels, parts):
    number, part = 1, parts[1]
    lost = part["member_index"][0]
    fewer = voxels["index"][(voxels["index"] != lost).any(axis=1)]
    fewer = Artifact(voxels.manifest, {"index": fewer, "overlap": np.ones(len(fewer), np.uint32)})
    proof = verify_parts(parts, voxels=single(fewer), scene=single(scene), jobs=1)
    assert set(failing(proof)) >= {"every voxel is a member", "every ellipsoid lies in the voxels"}
    found = next(c for c in proof.checks if c.name == "every ellipsoid lies in the voxels").first[0]
    assert list(found.voxel) == lost.tolist()
    g = found.gaussian
    reach = 1.01 * float(scene["scale"][g].max()) + SIZE_M
    assert (np.abs(scene["mean"][g] - (lost + 0.5) * SIZE_M) <= reach).all()
    proof = verify_parts(parts.but(number, without_hull(part)), voxels=single(voxels), jobs=1)
    assert "every voxel is a member" in failing(proof)
    assert proof.complaint().startswith("not proven: ")


def without_hull(cover):
    """The cover without its last hull."""
    arrays = dict(cover.arrays)
    for start, names in (
        ("vertex_start", ["vertex"]),
        ("plane_start", ["plane_normal", "plane_offset"]),
        ("member_start", ["member_index"]),
    ):
        arrays[start] = arrays[start][:-1]
        for name in names:
            arrays[name] = arrays[name][: arrays[start][-1]]
    return Artifact(cover.manifest, arrays)


def test_an_ellipsoid_outside_of_all_cubes_is_found(scene, voxels, parts):
    """Far away, and in the cell next to a cube, where no part looks."""
    for place in ([50.0, 0.0, 0.0], ((np.array(parts.refs[0].domain[0]) - 2) * SIZE_M).tolist()):
        arrays = {name: np.concatenate([array, array[:1]]) for name, array in scene.arrays.items()}
        arrays["mean"][-1] = place
        more = Artifact(scene.manifest, arrays)
        proof = verify_parts(parts, voxels=single(voxels), scene=single(more), jobs=1)
        assert failing(proof) == ["every ellipsoid lies in the voxels"]
        assert proof.checks[-1].first[0].gaussian == len(scene["mean"])


def test_voxels_outside_of_all_cubes_and_cubes_that_overlap_are_found(voxels, parts):
    index = np.concatenate([voxels["index"], [[900, 0, 0]]]).astype(np.int32)
    more = Artifact(voxels.manifest, {"index": index, "overlap": np.ones(len(index), np.uint32)})
    proof = verify_parts(parts, voxels=single(more), jobs=1)
    assert failing(proof) == ["cubes divide the voxels"]
    domains = [ref.domain for ref in parts.refs]
    proof = verify_parts(Memory(parts.manifest, parts.artifacts, [domains[1], *domains[1:]]), jobs=1)
    assert {"cubes divide the voxels", "hulls lie in the part's cube"} <= set(failing(proof))


def test_a_whole_that_differs_from_its_parts_is_found(voxels, parts):
    wrong = msgspec.structs.replace(parts.manifest, conservativeness=parts.manifest.conservativeness + 0.01)
    proof = verify_parts(Memory(wrong, parts.artifacts, [ref.domain for ref in parts.refs]), jobs=1)
    assert failing(proof) == ["the whole is its parts"]
    other = with_manifest(parts[2], sigma=2.0)
    proof = verify_parts(parts.but(2, other), voxels=single(voxels), jobs=1)
    assert {"the whole is its parts", "files agree"} <= set(failing(proof))


@pytest.mark.parametrize("crop", [(-1.4, -1.5, -1.3, 1.6, 1.53, 1.4), (0.0, -9.0, -9.0, 1.2, 9.0, 9.0)])
def test_crop_and_overlap_hold_across_the_borders_of_cubes(scene, crop):
    """The second crop has faces in the borders of cubes."""
    scene = Artifact(scene.manifest, {**scene.arrays, "mean": scene["mean"] * np.float32(0.4)})
    for overlap in (1, 2):
        voxels = voxelize(VoxelizeConfig(size_m=SIZE_M, min_overlap=overlap, crop=crop), scene)
        parts = covered(voxels, 12)
        proof = verify_parts(parts, voxels=single(voxels), scene=single(scene), jobs=1)
        assert proof.covered, proof.complaint()


def is_in(domain, voxel):
    return bool((voxel >= domain[0]).all() and (voxel <= domain[1]).all())


def test_one_part_is_proven_against_the_list(scene, voxels, parts):
    files = {"voxels": single(voxels), "scene": single(scene)}
    whole = verify_parts(parts, **files, jobs=1)
    for number in (0, 2):
        proof = prove_part(whole, parts[number], parts.refs[number].sha256, **files)
        assert proof.covered
    with pytest.raises(CheckError, match="does not list this part"):
        prove_part(whole, parts[0], "0" * 64, **files)
    with pytest.raises(
        CheckError, match=r"not proven: part-00001: hulls are exact polytopes: there is no hull"
    ):
        prove_part(whole, without_hull(parts[1]), parts.refs[1].sha256, **files)
    with pytest.raises(UsageError, match="made with cover, voxels, scene; give the same files"):
        prove_part(whole, parts[0], parts.refs[0].sha256, single(voxels), None)
    forged = msgspec.structs.replace(whole, parts=whole.parts[:-1])
    with pytest.raises(ArtifactError, match="root of the certificate is not that of its list"):
        prove_part(forged, parts[0], parts.refs[0].sha256, **files)
    fewer = Artifact(voxels.manifest, {"index": voxels["index"][1:], "overlap": voxels["overlap"][1:]})
    home = next(n for n, r in enumerate(parts.refs) if is_in(r.domain, voxels["index"][0]))
    with pytest.raises(CheckError, match=r"not proven: part-.*: every voxel is a member"):
        prove_part(whole, parts[home], parts.refs[home].sha256, single(fewer), single(scene))


def test_the_root_of_a_list_changes_with_every_entry():
    """The vectors are the definition of RFC 6962, written out."""

    def inner(a, b):
        return hashlib.sha256(b"\x01" + bytes.fromhex(a) + bytes.fromhex(b)).hexdigest()

    a, b, c, d, e = (merkle.leaf(bytes([k])) for k in range(5))
    assert a == hashlib.sha256(b"\x00\x00").hexdigest()
    assert merkle.root([]) == hashlib.sha256(b"").hexdigest()
    assert merkle.root([a]) == a
    assert merkle.root([a, b, c]) == inner(inner(a, b), c)
    assert merkle.root([a, b, c, d, e]) == inner(inner(inner(a, b), inner(c, d)), e)
    assert merkle.root([b, a]) != merkle.root([a, b])


def test_the_command_writes_one_certificate_and_proves_a_part(tmp_path, monkeypatch, capsys, scene, voxels):
    monkeypatch.chdir(tmp_path)
    write_artifact(Path("s.scene.npz"), scene)
    write_artifact(Path("v.voxels.npz"), voxels)
    assert (scene.kind, voxels.kind) == (SCENE, VOXELS)
    block = ["--hulls", "12", "--block", str(24 * SIZE_M), "--per-block", "--jobs", "1", "-q"]
    assert run(["merge", "v.voxels.npz", "-o", "c.cover", *block]) == 0
    files = ["--voxels", "v.voxels.npz", "--scene", "s.scene.npz", "--jobs", "1"]
    assert run(["verify", "c.cover", *files, "-o", "c.json", "-q"]) == 0
    record = msgspec.json.decode(Path("c.json").read_bytes())
    assert (record["schema"], record["version"]) == ("alula/certificate", "1.3")
    assert [entry["name"] for entry in record["parts"][:-1]] == [
        r.file for r in open_parts(Path("c.cover")).refs
    ]
    first = Path("c.json").read_bytes()
    assert run(["verify", "c.cover", *files, "-o", "c.json"]) == 0
    assert Path("c.json").read_bytes() == first
    part = "c.cover/part-00001.cover.npz"
    assert run(["verify", part, "--certificate", "c.json", *files]) == 0
    assert capsys.readouterr().out.count("covered: every ellipsoid") == 2
    for words, code, message in (
        ([part, "--certificate", "c.json"], 2, "give the same files"),
        ([part, "--certificate", "v.voxels.npz", *files], 3, "is no certificate of a cover in parts"),
        (["c.cover", "--certificate", "c.json", *files], 2, "is for one part of a cover, a file"),
        ([part, "--certificate", "c.json", *files, "-o", "d.json"], 2, "leave out -o"),
        ([part, "--scheduler", "tcp://127.0.0.1:9"], 2, "--scheduler is for covers in parts"),
    ):
        assert run(["verify", *words]) == code
        assert message in capsys.readouterr().err
    text = Path("c.json").read_text().replace(record["parts"][1]["certificate"], "0" * 64)
    Path("c.json").write_text(text)
    assert run(["verify", part, "--certificate", "c.json", *files]) == 3
    assert capsys.readouterr().err == "alula: c.json: the root of the certificate is not that of its list\n"
