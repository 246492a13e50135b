"""Properties of splat files that change the geometry are applied, refused or named, never passed over."""

import json
import os
import re
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.cli.main import run
from alula.schemas.errors import ArtifactError
from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
from alula.stages.compression.ellipsoids import lacks_of
from alula.stages.reconstruction.formats.capture import joined
from alula.stages.reconstruction.formats.ply import decode_ply
from alula.stages.reconstruction.formats.properties import ELEMENTS, FILES, KNOWN, Effect, filtered, judged
from alula.stages.reconstruction.formats.registry import read_splats
from alula.stages.reconstruction.import_splat import import_splat
from support.effort import examples
from support.files import splat_files, spz_files

PAGE = Path(__file__).parents[3] / "docs/guide/splat-formats.md"
DATA = os.environ.get("ALULA_DATA")


def ply(columns, rows=4, order="<", elements="", without=""):
    """A PLY of plain Gaussians with further columns, each a value or one value per row."""
    names = [*"xyz", "opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
    rng = np.random.default_rng(3)
    table = {
        name: rng.normal(-4.0 * name.startswith("scale"), 1.0, rows) for name in names if name != without
    }
    table |= {name: np.broadcast_to(value, rows) for name, value in columns.items()}
    table = {name: np.float32(values) for name, values in table.items()}
    kind = {"<": "binary_little_endian", ">": "binary_big_endian", "": "ascii"}[order]
    head = f"ply\nformat {kind} 1.0\nelement vertex {rows}\n"
    head += "".join(f"property float {name}\n" for name in table) + elements + "end_header\n"
    body = np.column_stack([*table.values()])
    if not order:
        return table, (head + "\n".join(" ".join(map(repr, row)) for row in body.tolist()) + "\n").encode()
    return table, head.encode() + body.astype(f"{order}f4").tobytes()


def decode(raw, **options):
    return decode_ply(memoryview(raw), **options)


@pytest.mark.parametrize("order", ["<", ">", ""])
def test_a_3d_filter_is_applied_as_its_paper_defines_it(order):
    f = np.array([0.0, 0.003, 0.02, 5.0])
    table, raw = ply({"filter_3D": f}, order=order)
    splats = decode(raw)
    s = np.exp(np.column_stack([table[f"scale_{i}"] for i in range(3)]).astype(float))
    f = table["filter_3D"].astype(float)
    alpha = 1 / (1 + np.exp(-table["opacity"].astype(float)))
    sigma = np.array([np.diag(row**2) for row in s])
    larger = sigma + f[:, None, None] ** 2 * np.eye(3)
    np.testing.assert_allclose(splats.scale, np.sqrt(np.diagonal(larger, axis1=1, axis2=2)), rtol=3e-7)
    expected = alpha * np.sqrt(np.linalg.det(sigma) / np.linalg.det(larger))
    np.testing.assert_allclose(splats.opacity, expected, rtol=1e-6)
    assert splats.loss is None
    assert "filter_3D was applied" in splats.properties.applied[0]


@settings(max_examples=examples(200), deadline=None)
@given(
    st.lists(st.floats(0, 2**60, width=32), min_size=3, max_size=3),
    st.floats(0, 2**60, width=32),
    st.floats(0, 1, width=32),
)
def test_filtered_semi_axes_and_opacities_are_never_below_the_exact_ones(s, f, alpha):
    scale, opacity = filtered(np.float32([s]), np.float32([alpha]), np.float32([f]))
    fading = Fraction(alpha) ** 2
    for before, after in zip(map(Fraction, s), map(Fraction, scale[0].tolist()), strict=True):
        exact = before**2 + Fraction(f) ** 2
        assert after**2 >= exact * (1 - Fraction(1, 2**50))  # the rounding of double precision
        assert after**2 <= exact * (1 + Fraction(1, 2**21)) + Fraction(1, 2**280)
        fading *= before**2 / exact if exact else 1
    assert Fraction(float(opacity[0])) ** 2 >= fading * (1 - Fraction(1, 2**48))
    assert opacity[0] <= np.float32(alpha)


def test_a_filter_without_a_number_is_a_row_without_a_number():
    _, raw = ply({"filter_3D": [np.nan, np.inf, 0.1, 0.1]})
    splats = decode(raw)
    assert np.isnan(splats.scale[0]).all()
    assert np.isinf(splats.scale[1]).all()
    scene = import_splat(ImportSplatConfig(drop_nan=True), splats)
    assert {"not_a_number": 1, "infinite_scale": 1}.items() <= scene.manifest.summary["removed"].items()


def test_a_filter_on_flat_discs_is_refused():
    _, raw = ply({"filter_3D": 0.1}, without="scale_2")
    with pytest.raises(ArtifactError, match="filter_3D beside two scales"):
        decode(raw)


def test_windows_of_rows_have_their_own_filter():
    _, raw = ply({"filter_3D": np.linspace(0, 1, 50)}, rows=50)
    whole, part = decode(raw), decode(raw, window=slice(20, 30))
    np.testing.assert_array_equal(part.scale, whole.scale[20:30])
    np.testing.assert_array_equal(part.opacity, whole.opacity[20:30])


@pytest.mark.skipif(DATA is None, reason="real data: set ALULA_DATA to the folder of scenes")
def test_a_file_with_its_filter_is_the_file_that_its_trainer_fuses():
    raw, fused = (read_splats(Path(DATA) / f"reports-3/mip_wall_{kind}.ply") for kind in ("raw", "fused"))
    np.testing.assert_allclose(raw.scale, fused.scale, rtol=3e-7)
    np.testing.assert_allclose(raw.opacity, fused.opacity, rtol=1e-5)


EXAMPLES = {  # of each trainer: properties that it adds
    "Scaffold-GS": ["f_offset_0", "f_offset_29", "f_anchor_feat_31", "scale_5"],
    "HAC": ["f_mask_3"],
    "SpacetimeGaussians": ["motion_0", "omega_3", "trbf_center", "trbf_scale"],
    "4D Gaussians": ["t", "scale_t", "scale_t_0", "mu_t", "rot_l_0", "rot_r_3", "t_scale"],
    "frames": ["delta_x_t0", "delta_rot_3_t12", "velocity_0", "duration"],
    "E-D3DGS": ["embedding_31"],
    "GaussianAvatars": ["binding_0", "binding"],
    "Deformable Beta Splatting": ["beta"],
}


@pytest.mark.parametrize("name", [name for names in EXAMPLES.values() for name in names])
def test_what_needs_a_network_a_time_or_a_mesh_is_refused_with_the_reason(name, tmp_path, capsys):
    _, raw = ply({name: 0.5})
    (tmp_path / "a.ply").write_bytes(raw)
    assert run(["import-splat", str(tmp_path / "a.ply"), "-o", str(tmp_path / "a.scene.npz")]) == 3
    said = capsys.readouterr().err
    assert re.search(rf"a\.ply: .*it has property {name}, as .*(network|time only|mesh|kernels)", said)
    assert len(said.splitlines()) == 1
    assert not (tmp_path / "a.scene.npz").exists()


def test_anchors_without_an_opacity_of_their_own_are_refused_as_anchors():
    _, raw = ply({"f_offset_0": 0.1}, without="opacity")
    with pytest.raises(ArtifactError, match="f_offset_0, as anchors of Scaffold-GS"):
        decode(raw)


@pytest.mark.parametrize(
    "element", ["delta_vertex_00001", "meta_delta_min_1", "codebook_centers", "vertex_obj_001"]
)
def test_elements_that_change_what_the_gaussians_are_are_refused(element):
    _, raw = ply({}, elements=f"element {element} 0\nproperty float x\n")
    with pytest.raises(ArtifactError, match=f"it has element {element}"):
        decode(raw)


@pytest.mark.parametrize("name", ["deformation.pth", "cov_mlp.pt"])
def test_a_network_beside_the_file_is_refused(name, tmp_path):
    _, raw = ply({})
    (tmp_path / "point_cloud.ply").write_bytes(raw)
    assert len(read_splats(tmp_path / "point_cloud.ply")) == 4
    (tmp_path / name).write_bytes(b"weights")
    with pytest.raises(ArtifactError, match=f"beside it {name}"):
        read_splats(tmp_path / "point_cloud.ply")


def test_the_deformation_of_a_training_run_is_refused(tmp_path):
    folder = tmp_path / "point_cloud/iteration_7"
    folder.mkdir(parents=True)
    (folder / "point_cloud.ply").write_bytes(ply({})[1])
    assert len(read_splats(tmp_path)) == 4
    (tmp_path / "deform").mkdir()
    with pytest.raises(ArtifactError, match="Deformable 3D Gaussians"):
        read_splats(tmp_path)


IGNORED = ["nx", "nxx", "obj_dc_15", "semantic_3", "roughness", "refl_strength", "level", "xr", "red"]


@pytest.mark.parametrize("name", IGNORED)
def test_appearance_and_labels_are_ignored_without_a_word(name):
    plain, more = decode(ply({})[1]), decode(ply({name: 0.5})[1])
    np.testing.assert_array_equal(more.scale, plain.scale)
    assert more.notes == plain.notes
    assert more.properties == plain.properties


def test_properties_of_unknown_meaning_are_named_up_to_the_verdicts():
    splats = decode(ply({"wobble": 0.5, "zeta_0": 1.0, "zeta_1": 1.0})[1])
    assert splats.properties.unknown == ("wobble", "zeta_0", "zeta_1")
    scene = import_splat(ImportSplatConfig(), splats)
    assert any(
        "wobble, zeta_* of the splat file, of unknown meaning" in note
        for note in scene.manifest.summary["notes"]
    )
    assert "wobble, zeta_*" in scene.manifest.guarantee.statement
    assert any("wobble, zeta_*" in what for what in lacks_of(scene.manifest))
    plain = import_splat(ImportSplatConfig(), decode(ply({})[1]))
    assert lacks_of(plain.manifest) == []
    assert plain.manifest.source["unknown_properties"] == []


def written(folder, files):
    for name, raw in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(raw)
    return folder


def small():
    return splat_files.some_gaussians(12)


def test_further_tensors_of_a_checkpoint_are_judged_and_its_filter_is_applied(tmp_path):
    g = small()
    prefix = "_model.gauss_params."
    state = {
        prefix + "means": g.mean,
        prefix + "scales": g.log_scale,
        prefix + "quats": g.quat,
        prefix + "opacities": g.logit[:, None],
        prefix + "features_dc": g.sh0,
    }
    (tmp_path / "a.ckpt").write_bytes(splat_files.checkpoint(state | {prefix + "wobble": g.mean}))
    assert read_splats(tmp_path / "a.ckpt").properties.unknown == ("wobble",)
    (tmp_path / "b.ckpt").write_bytes(splat_files.checkpoint(state | {prefix + "velocity_0": g.mean}))
    with pytest.raises(ArtifactError, match="known at a time only"):
        read_splats(tmp_path / "b.ckpt")
    more = {"_model.filter_3D": np.full((len(g), 1), 0.25)}
    (tmp_path / "c.ckpt").write_bytes(splat_files.checkpoint(state | more))
    found = read_splats(tmp_path / "c.ckpt")
    np.testing.assert_allclose(found.scale, np.hypot(g.scale, 0.25), rtol=1e-6)
    assert found.properties.applied


def test_further_lists_of_json_are_judged(tmp_path):
    lists = json.loads(splat_files.means_json(small())["a.json"])
    (tmp_path / "a.json").write_text(json.dumps(lists | {"wobble": [1, 2]}))
    assert read_splats(tmp_path / "a.json").properties.unknown == ("wobble",)
    (tmp_path / "a.json").write_text(json.dumps(lists | {"duration": [1, 2]}))
    with pytest.raises(ArtifactError, match="known at a time only"):
        read_splats(tmp_path / "a.json")


def test_further_sections_of_sog_are_named(tmp_path):
    folder = written(tmp_path, splat_files.sog(small(), bundled=False))
    meta = json.loads((folder / "meta.json").read_text())
    assert read_splats(folder).properties.unknown == ()
    (folder / "meta.json").write_text(json.dumps(meta | {"wobble": {}}))
    assert read_splats(folder).properties.unknown == ("wobble",)


def gltf(**edits):
    files = splat_files.gltf(small(), binary=False)
    tree = json.loads(files["a.gltf"])
    attributes = tree["meshes"][0]["primitives"][0]["attributes"]
    attributes |= dict.fromkeys(edits.pop("attributes", ()), 0)
    return files | {"a.gltf": json.dumps(tree | edits).encode()}


def test_further_attributes_of_gltf_are_judged(tmp_path):
    found = read_splats(written(tmp_path, gltf(attributes=("_WOBBLE", "NORMAL", "TEXCOORD_0"))) / "a.gltf")
    assert found.properties.unknown == ("WOBBLE",)
    with pytest.raises(ArtifactError, match="known at a time only"):
        read_splats(written(tmp_path, gltf(attributes=("_motion_0",))) / "a.gltf")


def test_animations_that_move_gaussians_are_refused_and_others_are_told(tmp_path):
    still = [{"channels": [{"target": {"node": 2, "path": "translation"}}], "samplers": []}]
    nodes = [{"mesh": 0}, {"children": [0]}, {}]
    place = written(tmp_path, gltf(animations=still, nodes=nodes, scenes=[{"nodes": [1, 2]}])) / "a.gltf"
    assert any("do not move Gaussians" in note for note in read_splats(place).notes)
    still[0]["channels"][0]["target"]["node"] = 1
    written(tmp_path, gltf(animations=still, nodes=nodes, scenes=[{"nodes": [1, 2]}]))
    with pytest.raises(ArtifactError, match="an animation moves Gaussians of node 0"):
        read_splats(place)


@pytest.mark.parametrize("version", [2, 4])
def test_extensions_of_spz_of_unknown_meaning_are_named(version, tmp_path):
    arrays = spz_files.arrays_of(np.random.default_rng(0), version, 3)
    known = spz_files.record(0xADBE0002, b"camera") + spz_files.record(0xADBE0001, b"bits")
    for records, unknown in ((known, ()), (spz_files.record(0xDEAD0001, b"?"), ("extension 0xdead0001",))):
        raw = spz_files.file_of(version, 3, arrays, flags=2, extensions=records)
        (tmp_path / "a.spz").write_bytes(raw)
        assert read_splats(tmp_path / "a.spz").properties.unknown == unknown


def test_joined_files_keep_what_was_applied_and_what_is_unknown():
    parts = [("a.ply", decode(ply({"filter_3D": 0.1})[1])), ("b.ply", decode(ply({"wobble": 0.1})[1]))]
    both = joined(parts)
    assert both.properties.unknown == ("wobble",)
    assert both.properties.applied[0].startswith("a.ply: filter_3D")


def test_every_known_property_is_on_the_page():
    page = PAGE.read_text()
    for known in (*KNOWN, *ELEMENTS, *FILES):
        for name in known.names:
            assert f"`{name}`" in page, f"{name} is not on the page"


def test_the_list_is_consistent():
    names = [name for known in KNOWN for name in known.names]
    assert len(set(names)) == len(names)
    for known in KNOWN:
        for name in known.names:
            example = name.replace("#", "7").replace("*", "x").replace("?", "y")
            if known.effect is Effect.REFUSED:
                with pytest.raises(ArtifactError, match=re.escape(known.what[:20])):
                    judged([example])
            else:
                assert judged([example], applied=known.names) == ()
    with pytest.raises(ArtifactError, match="is not applied in this format"):
        judged(["filter_3D"])


@pytest.mark.parametrize("kind", ["lengths", "fractions"])
def test_lengths_and_fractions_in_a_file_of_logarithms_and_logits_get_a_hint(kind):
    rng = np.random.default_rng(0)
    lengths = {f"scale_{i}": rng.uniform(0.001, 0.3, 50) for i in range(3)}
    columns = lengths if kind == "lengths" else {"opacity": rng.uniform(0, 1, 50)}
    hint = "as if they were lengths" if kind == "lengths" else "as if it were a fraction"
    assert any(hint in note for note in decode(ply(columns, 50)[1]).notes)
    assert not any("as if" in note for note in decode(ply({}, 50)[1]).notes)


def test_the_proof_of_a_cover_repeats_what_was_applied(tmp_path, capsys):
    _, raw = ply({"filter_3D": 0.1}, rows=3)
    (tmp_path / "a.ply").write_bytes(raw)
    s, m, v, c = (str(tmp_path / f"a.{kind}.npz") for kind in ("scene", "metric.scene", "voxels", "cover"))
    assert run(["import-splat", str(tmp_path / "a.ply"), "--min-opacity", "0", "-o", s]) == 0
    assert run(["scale-align", s, "--scale", "1", "-o", m]) == 0
    assert run(["voxelize", m, "--size", "0.05", "-o", v]) == 0
    assert run(["merge", v, "--hulls", "9", "-o", c]) == 0
    capsys.readouterr()
    assert run(["verify", c, "--voxels", v, "--scene", m]) == 0
    assert "in the scene, filter_3D was applied" in capsys.readouterr().out
