"""`import alula`: functions like the commands, the files that these write, results that show themselves."""

import ast
import json
import re
import shutil
import subprocess
import sys
import types

import numpy as np
import pytest

import alula
from alula.cli.main import run
from alula.cli.shell import bar
from alula.cli.verbs.results import RESULTS
from alula.schemas.artifacts import kinds
from support.paths import DOCS, EXAMPLES

OWN_FILTER = DOCS / "howto/own-filter.md"


@pytest.fixture(scope="module")
def flown(pipeline, tmp_path_factory):
    """The pipeline of the commands once more, by functions; each result is saved under the same name."""
    folder = tmp_path_factory.mktemp("library")
    shutil.copy(pipeline / "tiny.ply", folder)
    scene = alula.import_splat(folder / "tiny.ply").save(folder / "tiny.scene.npz")
    metric = alula.align(scene, scale=1).save(folder / "tiny.metric.scene.npz")
    voxels = alula.voxelize(metric, size_m=0.2).save(folder / "tiny.voxels.npz")
    cover = alula.merge(voxels, hulls=12).save(folder / "tiny.cover.npz")
    proof = alula.verify(cover, voxels=voxels).save(folder / "tiny.certificate.json")
    plan = alula.plan(cover, start=[0.5, 1.5, 1], goal=np.array([3.5, 1.5, 1]))
    plan.save(folder / "tiny.plan.npz")
    flights = alula.simulate(plan, map=cover).save(folder / "tiny.run.mcap")
    names = ("scene", "metric", "voxels", "cover", "proof", "plan", "run")
    return folder, types.SimpleNamespace(
        **dict(zip(names, (scene, metric, voxels, cover, proof, plan, flights), strict=True))
    )


def test_functions_write_the_bytes_of_the_commands(pipeline, flown):
    folder, _ = flown
    for name in ("scene.npz", "metric.scene.npz", "voxels.npz", "cover.npz", "certificate.json", "plan.npz"):
        assert (folder / f"tiny.{name}").read_bytes() == (pipeline / f"tiny.{name}").read_bytes(), name
    assert (folder / "tiny.run.mcap").read_bytes() == (pipeline / "tiny.run.mcap").read_bytes()
    log = pipeline / "tiny.run.mcap"
    alula.report(log, title="Tiny").save(folder / "tiny.report.md")
    words = ["report", str(log), "-o", str(folder / "other.md"), "--title", "Tiny", "-q"]
    assert run(words) == 0
    assert (folder / "tiny.report.md").read_bytes() == (folder / "other.md").read_bytes()


def test_a_command_finds_the_file_of_a_function_current(flown, capsys):
    folder, _ = flown
    words = ["merge", str(folder / "tiny.voxels.npz"), "-o", str(folder / "tiny.cover.npz"), "--hulls", "12"]
    assert run(words) == 0
    assert "tiny.cover.npz: unchanged" in capsys.readouterr().out


def test_the_hash_of_an_unsaved_input_is_that_of_the_file_it_becomes(pipeline, tmp_path):
    voxels = alula.voxelize(pipeline / "tiny.metric.scene.npz", size_m=0.3)
    cover = alula.merge(voxels, hulls=5)
    recorded = cover.manifest.inputs[0]
    saved = voxels.save(tmp_path / "v.voxels.npz").ref("source")
    assert (recorded.sha256, recorded.name) == (saved.sha256, "")
    assert saved.name == "v.voxels.npz"


def test_results_say_what_they_are(flown):
    _, made = flown
    assert repr(made.scene) == "Scene: 800 Gaussians, 3.98 x 3 x 2 units without metric scale"
    assert repr(made.metric) == "Scene: 800 Gaussians, 3.98 x 3 x 2 m, frame world"
    assert repr(made.voxels).startswith("Voxels: 858 occupied of edge 0.2 m")
    planes, growth = len(made.cover.plane_normal), made.cover.manifest.conservativeness
    assert repr(made.cover) == (
        f"Cover: 12 hulls, {planes} half-planes, volume {growth:.3g} times the voxels'; "
        "contains all 858 voxels"
    )
    assert repr(made.plan).startswith("Plan: 3 m in 4.62 s, at most 0.975 m/s, 1.3 m from")
    assert repr(made.proof).startswith("Proof: covered: ")
    assert repr(made.run) == "Run: 1 flights, 1 reached, 0 collided, minimum clearance 1.15 m"
    for one in vars(made).values():
        html = one._repr_html_()
        assert html.count("<tr>") > 3
        assert "\n" not in repr(one)
    assert "the similarity was given: nothing checks it" in made.metric._repr_html_()


def test_arrays_are_attributes_without_copies_and_annotated(flown):
    _, made = flown
    assert made.cover.vertex is made.cover.artifact["vertex"]
    assert made.metric.opacity is made.scene.opacity or np.shares_memory(
        made.metric.mean, made.metric.artifact["mean"]
    )
    assert "plane_normal" in dir(made.cover)
    with pytest.raises(AttributeError, match="'Cover' has no attribute 'vertices'"):
        made.cover.vertices  # noqa: B018
    for kind in kinds.KINDS.values():
        assert {rule.name for rule in kind.arrays} == set(RESULTS[kind.name].__annotations__)


def test_read_gives_a_result_of_the_kind_of_a_file(pipeline, flown):
    _, made = flown
    for name in ("scene", "voxels", "seen", "cover", "plan"):
        found = alula.read(pipeline / f"tiny.{name}.npz")
        assert type(found).__name__.lower() == name
    assert repr(alula.read(pipeline / "tiny.run.mcap")) == repr(made.run)
    with pytest.raises(alula.InputError, match=r"tiny\.ply: is not an artifact .* alula\.import_splat"):
        alula.read(pipeline / "tiny.ply")


def test_plan_and_run_give_positions_over_time(flown):
    _, made = flown
    ends = made.plan.at([0, made.plan.time[-1]])
    assert ends[:, :3] == pytest.approx(np.array([[0.5, 1.5, 1], [3.5, 1.5, 1]]), abs=1e-9)
    assert np.abs(made.plan.at([0.0, 1.0], 1)[0]).max() < 1e-9
    path = made.run.flights[0].position_world
    assert path[0] == pytest.approx([0.5, 1.5, 1], abs=1e-6)
    assert np.linalg.norm(path[-1] - [3.5, 1.5, 1]) < 0.2


def test_free_points_are_those_of_the_command(flown, capsys):
    folder, made = flown
    assert run(["plan", str(folder / "tiny.cover.npz"), "--free-points", "3", "--json"]) == 0
    assert made.cover.free_points(3).tolist() == json.loads(capsys.readouterr().out)["points_m"]


def voxelized(folder, **fields):
    return alula.voxelize(folder / "tiny.metric.scene.npz", **fields)


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda f: voxelized(f, size=0.1), TypeError, r"did you mean 'size_m'\?"),
        (lambda f: voxelized(f, size_m="a"), alula.UsageError, "size_m: expected"),
        (lambda f: voxelized(f, size_m=float("nan")), alula.UsageError, "finite"),
        (lambda f: voxelized(f, size_m=-1), alula.UsageError, "--size must be"),
        (lambda f: alula.voxelize(f / "tiny.scene.npz"), alula.InputError, r"tiny\.scene\.npz: "),
        (lambda f: alula.voxelize(f / "tiny.cover.npz"), alula.InputError, "is alula/cover"),
        (lambda f: alula.voxelize(f / "none.npz"), alula.InputError, r"none\.npz: "),
        (lambda f: alula.voxelize(3), TypeError, "a path or a result is needed, not int"),
        (lambda f: alula.merge(f / "tiny.plan.npz"), alula.InputError, "voxels or a cover are needed"),
        (lambda f: alula.align(f / "tiny.scene.npz"), alula.UsageError, "none was given"),
        (lambda f: alula.import_splat(f / "tiny.toml"), alula.InputError, "tiny.toml"),
        (lambda f: alula.plan(f / "tiny.cover.npz"), alula.UsageError, "--start and --goal"),
        (
            lambda f: alula.plan(f / "tiny.cover.npz", start=(0, 0, 0), goal=(1, 1.5, 1)),
            alula.InfeasibleError,
            "the start",
        ),
        (lambda f: alula.verify(f / "tiny.plan.npz"), alula.UsageError, "--map"),
        (lambda f: alula.simulate(f / "tiny.cover.npz", filter="no"), alula.UsageError, "no filter"),
        (lambda f: alula.report(), alula.UsageError, "needs a run"),
        (lambda f: alula.report(f / "tiny.run.mcap", format="doc"), alula.UsageError, "format"),
    ],
)  # fmt: skip
def test_errors_are_those_of_the_command_line(call, error, text, pipeline):
    with pytest.raises(error, match=text):
        call(pipeline)


def test_a_cover_that_contains_less_is_not_proven(pipeline, flown):
    other = alula.voxelize(pipeline / "tiny.metric.scene.npz", size_m=0.2, sigma=2.0)
    with pytest.raises(alula.CheckError, match="cover: "):
        alula.verify(flown[1].cover, voxels=other)


def test_save_replaces_no_other_file(flown, tmp_path):
    _, made = flown
    (tmp_path / "a.voxels.npz").write_text("mine")
    with pytest.raises(alula.UsageError, match="not a file of alula's"):
        made.voxels.save(tmp_path / "a.voxels.npz")
    assert (tmp_path / "a.voxels.npz").read_text() == "mine"
    with pytest.raises(alula.UsageError, match=r"must end in \.npz"):
        made.voxels.save(tmp_path / "a.voxels")
    with pytest.raises(alula.InputError, match="does not exist"):
        made.voxels.save(tmp_path / "no/a.voxels.npz")
    made.voxels.save(tmp_path / "a.voxels.npz", force=True)
    assert repr(alula.read(tmp_path / "a.voxels.npz")) == repr(made.voxels)


def test_a_file_that_changed_since_it_was_read_is_no_input(pipeline, tmp_path):
    splat = tmp_path / "s.ply"
    shutil.copy(pipeline / "tiny.ply", splat)
    scene = alula.import_splat(splat)
    splat.write_bytes(splat.read_bytes() + b"more")
    with pytest.raises(alula.InputError, match="changed since it was read"):
        scene.save(tmp_path / "s.scene.npz")


def test_a_file_that_is_only_touched_or_saved_under_another_name_stays_the_same_input(pipeline, tmp_path):
    for name in ("voxels", "cover"):
        shutil.copy(pipeline / f"tiny.{name}.npz", tmp_path)
    cover = alula.read(tmp_path / "tiny.cover.npz")
    before = cover.ref("cover")
    (tmp_path / "tiny.cover.npz").touch()
    assert cover.ref("cover") == before
    made = alula.merge(alula.read(tmp_path / "tiny.voxels.npz"), hulls=6).save(tmp_path / "a.cover.npz")
    first = made.ref("cover")
    second = made.save(tmp_path / "b.cover.npz").ref("cover")
    assert (first.sha256, first.name, second.name) == (second.sha256, "a.cover.npz", "b.cover.npz")
    (tmp_path / "tiny.cover.npz").write_bytes((tmp_path / "a.cover.npz").read_bytes())
    with pytest.raises(alula.InputError, match="changed since it was read"):
        cover.ref("cover")


def test_signatures_and_help_list_the_parameters_of_the_command():
    import inspect

    signature = inspect.signature(alula.voxelize)
    assert signature.parameters["size_m"].default == 0.05
    assert signature.parameters["size_m"].kind is inspect.Parameter.KEYWORD_ONLY
    assert "fields" not in signature.parameters
    assert "size_m: Edge of a voxel [m]." in alula.voxelize.__doc__


def test_pages_are_shown_in_a_notebook(flown, tmp_path):
    _, made = flown
    page = alula.view(made.metric, made.cover, gaussians=100)
    html = page._repr_html_()
    assert html.startswith('<iframe srcdoc="&lt;!')
    assert '"' not in html.split('srcdoc="')[1].split('" style=')[0]
    page.save(tmp_path / "page.html")
    assert (tmp_path / "page.html").read_text().startswith("<!")
    report = alula.report(made.run, cover=made.cover, plan=made.plan, certificate=made.proof, title="Tiny")
    assert "<title>Tiny" in report.html


class Shown:
    """What `IPython.display` is to a notebook."""

    def __init__(self):
        self.texts = []

    def HTML(self, text):
        return text

    def display(self, text, display_id):
        assert display_id
        self.texts.append(text)
        return self

    def update(self, text):
        self.texts.append(text)


def test_progress_is_shown_in_a_notebook_and_nowhere_else(monkeypatch, capsys):
    with bar.shown("merge") as progress:
        progress(1, 2)
    assert capsys.readouterr() == ("", "")
    shown = Shown()
    shell = types.SimpleNamespace(kernel=object())
    monkeypatch.setitem(sys.modules, "IPython", types.SimpleNamespace(get_ipython=lambda: shell))
    monkeypatch.setitem(sys.modules, "IPython.display", shown)
    with bar.shown("merge") as progress:
        progress(1, 2)
        progress(2, 2)  # at once: not drawn again
    assert shown.texts == ["merge …", "merge <progress max='2' value='1'></progress>", ""]
    del shell.kernel  # IPython in a terminal
    with bar.shown("merge") as progress:
        progress(1, 2)
    assert len(shown.texts) == 3


def test_importing_takes_less_than_150_ms_and_imports_nothing_heavy():
    code = (
        "import sys, time; start = time.perf_counter(); import alula; took = time.perf_counter() - start;"
        "print(took, [m for m in ('numpy', 'msgspec', 'click') if m in sys.modules], alula.__version__);"
        "assert 'voxelize' in dir(alula)"
    )
    words = [sys.executable, "-P", "-c", code]
    found = [
        subprocess.run(words, capture_output=True, text=True, check=True).stdout.split() for _ in range(3)
    ]
    assert min(float(one[0]) for one in found) < 0.15
    assert {one[1] for one in found} == {"[]"}


def test_every_public_name_can_be_imported_and_explained():
    for name in alula.__all__:
        assert getattr(alula, name).__doc__, name
    with pytest.raises(AttributeError, match="module 'alula' has no attribute 'voxelise'"):
        alula.voxelise  # noqa: B018


def test_the_filter_of_the_guide_has_at_most_20_lines_and_brakes_before_hulls(pipeline):
    block, *_ = re.findall(r"^```python\n(.*?)^```", OWN_FILTER.read_text(), re.MULTILINE | re.DOTALL)
    assert len([line for line in block.splitlines() if line.strip()]) <= 20
    names = {}
    exec(compile(block, "own filter", "exec"), names)
    walls = pipeline / "tiny.cover.npz"
    around = {"mission.bounds_m": (-1, -2, 0, 5, 5, 2), "mission.beyond_map_m": 3.0}
    behind = alula.simulate(walls, filter=names["Brake"], trials=6, settings=around)
    free = alula.simulate(walls, filter="none", trials=6, settings=around)
    assert behind.summary["collisions"] == 0 < free.summary["collisions"]
    assert behind.summary["filtered_steps"] > 0
    assert behind.summary["filter_kind"] == "python filter"
    with pytest.raises(alula.UsageError, match="no filter is called 'brake'"):  # only where it was given
        alula.simulate(walls, filter="brake")


@pytest.mark.slow
def test_the_tutorial_notebook_runs_and_every_result_is_shown(tmp_path, monkeypatch):
    notebook = json.loads((EXAMPLES / "library/tutorial.ipynb").read_text())
    assert notebook["nbformat"] == 4
    monkeypatch.chdir(tmp_path)
    names, shown = {}, []
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            tree = ast.parse("".join(cell["source"]))
            last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
            exec(compile(tree, "cell", "exec"), names)
            if last is not None:
                shown.append(eval(compile(ast.Expression(last.value), "cell", "eval"), names))
    results = [one for one in shown if hasattr(one, "_repr_html_")]
    assert {type(one).__name__ for one in results} == {
        "Scene",
        "Voxels",
        "Cover",
        "Proof",
        "Plan",
        "Run",
        "Page",
    }
    report = names["report"]  # drawing its page once more takes seconds; another test shows one
    assert all(one._repr_html_() for one in results if one is not report)
    assert names["run"].summary["reached"] == 1
    assert (tmp_path / "room.report.html").exists()
    flight = names["run"].flights[0]
    inside = np.array([(0, 0, 0), (8, 6, 3)])
    assert (flight.position_world > inside[0]).all()
    assert (flight.position_world < inside[1]).all()
    assert np.abs(names["scene"].mean.min(axis=0)).max() < 0.1  # level, with a corner at the origin
    assert names["cover"].summary["conservativeness"] < 1.4
