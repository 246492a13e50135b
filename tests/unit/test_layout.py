"""The shape of the project: import directions, circles, sizes, generated files, a quick command line."""

import ast
import importlib.util
import re
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path

import pytest

from support.paths import ROOT

SOURCES = sorted(path for part in ("cli", "stages", "schemas") for path in (ROOT / part).rglob("*.py"))
MAY_IMPORT = {
    "cli": {"cli", "stages", "schemas", "_core", "__version__"},
    "stages": {"stages", "schemas", "_core"},
    "schemas": {"schemas", "__version__", "_core.commit"},
}
HEAVY = ("numpy", "scipy", "open3d", "pycolmap", "cvxpy", "trimesh", "matplotlib", "viser", "mcap", "rich")


@cache
def imports(path: Path) -> list[ast.Import | ast.ImportFrom]:
    """All of a file. Trees are not kept: every flight of a test collects garbage among them."""
    tree = ast.parse(path.read_text())
    return [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]


def named(node: ast.Import | ast.ImportFrom) -> list[str]:
    return [alias.name for alias in node.names] if isinstance(node, ast.Import) else [f"{node.module}"]


def imported_parts(path: Path) -> set[str]:
    found = set()
    for node in imports(path):
        names = named(node)
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            module = node.module or ""
            names = [
                f"{module}.{a.name}" if module in ("alula", "alula._core") else module for a in node.names
            ]
        for name in names:
            assert name.split(".")[0] not in ("cli", "stages", "schemas"), f"{path}: imports {name}"
            if name.startswith("alula."):
                part = name.split(".")[1]
                is_own = part == "_core" and path.is_relative_to(ROOT / "schemas")
                found.add(name.removeprefix("alula.") if is_own else part)
    return found


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_point_one_way(path):
    part = path.relative_to(ROOT).parts[0]
    assert imported_parts(path) <= MAY_IMPORT[part]


def test_all_that_benchmarks_examples_and_tests_import_of_alula_is_there():
    """Also what is imported inside functions; for `alula` itself mypy checks it."""
    files = [path for part in ("benchmarks", "examples", "tests") for path in (ROOT / part).rglob("*.py")]
    for path in files:
        for node in imports(path):
            if not isinstance(node, ast.ImportFrom) or not (node.module or "").startswith("alula."):
                continue
            module = importlib.import_module(node.module)
            for name in [alias.name for alias in node.names if not hasattr(module, alias.name)]:
                assert importlib.util.find_spec(f"{node.module}.{name}"), f"{path}:{node.lineno}: {name}"


def test_the_rooms_of_the_command_line_import_one_way():
    """Commands call verbs, which know neither commands nor click; what all share knows neither of them."""
    above = {"shell": {"commands", "verbs"}, "verbs": {"commands"}}
    for module, others in imported_files().items():
        room = module.split(".")[2] if module.startswith("alula.cli.") else ""
        rooms = {other.split(".")[2] for other in others if other.startswith("alula.cli.")}
        assert not rooms & above.get(room, set()), module
    for path in (ROOT / "cli/verbs").rglob("*.py"):
        for node in imports(path):
            assert "click" not in {name.partition(".")[0] for name in named(node)}, path


def test_packages_that_import_slowly_are_imported_where_they_are_used():
    """At the top of a module `scipy.optimize` doubled the start of `alula simulate`."""
    for path in SOURCES:
        for node in imports(path):
            roots = {name.partition(".")[0] for name in named(node)}
            assert node.col_offset > 0 or not {"scipy", "matplotlib"} & roots, path


@cache
def imported_files() -> dict[str, set[str]]:
    """Modules of the project by name, each with those that it imports, at its top or in a function."""
    modules = {
        ".".join(("alula", *path.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__"): path
        for path in SOURCES
    }
    found = {}
    for module, path in modules.items():
        names: set[str] = set()
        for node in imports(path):
            names |= set(named(node))
            if isinstance(node, ast.ImportFrom):
                names |= {f"{node.module}.{alias.name}" for alias in node.names}
        found[module] = names & modules.keys() - {module}
    return found


def first_circle(graph: dict[str, set[str]]) -> str:
    """The first circle of a directed graph in words, empty without any."""
    done: set[str] = set()

    def visit(node: str, chain: tuple[str, ...]) -> str:
        if node in chain:
            return " -> ".join((*chain[chain.index(node) :], node))
        if node not in done:
            for following in sorted(graph[node]):
                if found := visit(following, (*chain, node)):
                    return found
            done.add(node)
        return ""

    return next(filter(None, (visit(node, ()) for node in graph)), "")


def test_no_python_files_import_each_other_in_a_circle():
    graph = imported_files()
    assert len(graph) > 250
    assert not first_circle(graph)
    assert first_circle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == "b -> c -> b"


def folders_of_the_stages() -> dict[str, set[str]]:
    """Folders and modules at the top of `stages`, each with those that it imports."""
    graph: dict[str, set[str]] = {}
    for module, others in imported_files().items():
        if module.startswith("alula.stages."):
            folder = module.split(".")[2]
            imported = {other.split(".")[2] for other in others if other.startswith("alula.stages.")}
            graph.setdefault(folder, set()).update(imported - {folder})
    return graph


def test_no_folders_of_the_stages_import_each_other_in_a_circle():
    graph = folders_of_the_stages()
    assert len(graph) > 10
    assert not first_circle(graph)


@pytest.mark.parametrize(
    ("importer", "imported"),
    [("flight", "reporting"), ("reporting", "flight"), ("simulation", "reporting"), ("simulation", "runlog")],
)
def test_folders_of_the_stages_that_do_not_import_each_other(importer, imported):
    graph = folders_of_the_stages()
    assert imported in graph
    assert imported not in graph[importer]


def test_no_folder_of_the_stages_has_more_than_30_percent_of_their_lines():
    lines: dict[str, int] = {}
    for path in (ROOT / "stages").rglob("*.py"):
        folder = path.relative_to(ROOT / "stages").parts[0]
        lines[folder] = lines.get(folder, 0) + len(path.read_text().splitlines())
    assert len(lines) > 10
    largest = max(lines, key=lambda folder: lines[folder])
    assert lines[largest] <= 0.3 * sum(lines.values()), f"stages/{largest}: {lines[largest]} lines"


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from alula.cli.main import run; run(['--help']);"
        f"print([m for m in {HEAVY!r} if m in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"
    assert "voxelize" in done.stdout


def test_help_of_each_command_imports_nothing_heavy_and_shows_two_examples():
    code = f"""
import sys
from alula.cli.main import COMMANDS, run
for name, line in COMMANDS.items():
    import contextlib, io
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        assert run([name, '-h']) == 0, name
    text = out.getvalue()
    assert line in " ".join(text.split()), (name, text)
    assert text.count('alula ' + name) >= 3, (name, text)
heavy = [m for m in {HEAVY!r} if m in sys.modules]
assert not heavy, heavy
"""
    subprocess.run([sys.executable, "-P", "-c", code], check=True)


def test_the_command_reference_is_current():
    from alula.cli.reference import reference

    assert (ROOT / "docs/guide/commands.md").read_text() == reference(), "run make docs"


def test_the_json_schemas_are_current():
    from alula.schemas.generate import documents

    folder = ROOT / "schemas/json"
    assert {path.name for path in folder.iterdir()} == set(documents())
    for name, text in documents().items():
        assert (folder / name).read_bytes() == text, f"{name}: run make schemas"


def test_the_type_stub_of_the_native_module_is_current(tmp_path):
    pytest.importorskip("nanobind", reason="nanobind is a build dependency")
    stub = tmp_path / "_core.pyi"
    command = [sys.executable, "-P", "-m", "nanobind.stubgen", "-q", "-m", "alula._core", "-o", str(stub)]
    subprocess.run(command, check=True)
    assert (ROOT / "native/python/alula/_core.pyi").read_text() == stub.read_text(), "run make schemas"


def test_the_top_level_is_as_the_design_card_says():
    tracked = subprocess.run(["git", "-C", str(ROOT), "ls-files"], capture_output=True, text=True)
    if tracked.returncode:
        pytest.skip("not a git checkout")
    allowed = {
        *("cli", "stages", "schemas", "tests", "examples", "native", "docs", "benchmarks"),
        *(
            "Makefile",
            "mkdocs.yml",
            "pyproject.toml",
            "CMakeLists.txt",
            "README.md",
            "CHANGELOG.md",
            "CONTRIBUTING.md",
            "CITATION.cff",
            "Dockerfile",
            "LICENSE",
        ),
    }
    top = {line.split("/")[0] for line in tracked.stdout.splitlines()}
    assert {name for name in top if not name.startswith(".")} <= allowed


def test_all_locks_pin_the_same_versions_with_hashes():
    pins = {}
    for path in (ROOT / ".ci").glob("*.lock"):
        blocks = re.split(r"\n(?=\S)", path.read_text().strip())
        assert all(" --hash=sha256:" in block for block in blocks)
        found = (re.match(r"([A-Za-z0-9._-]+)==([^\s;\\]+)", block).groups() for block in blocks)
        pins[path.stem] = {re.sub(r"[._-]+", "-", package).lower(): version for package, version in found}
    assert set(pins) == {"requirements", "native", "demo", "runtime", "peers", "firmware", "firmware-build"}
    assert len(pins["runtime"]) > 80
    assert pins["runtime"].items() <= pins["requirements"].items()
    for name, versions in pins.items():
        assert pins["requirements"] == pins["requirements"] | {
            package: version for package, version in versions.items() if package in pins["requirements"]
        }, name


def test_the_locks_have_every_package_that_the_project_names():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    groups = project["dependency-groups"]
    extras = project["project"]["optional-dependencies"]
    runtime = [
        *project["project"]["dependencies"],
        *(p for e in extras if e != "crazyflie" for p in extras[e]),
    ]
    dev = [*groups["native"], *(p for p in groups["dev"] if p != {"include-group": "native"})]
    demo = [*project["project"]["dependencies"], *extras["view"]]
    named = {"runtime": runtime, "requirements": [*runtime, *dev], "demo": demo}
    named |= {group: groups[group] for group in ("native", "peers", "firmware", "firmware-build")}
    for name, packages in named.items():
        locked = set(re.findall(r"^([\w.-]+)==", (ROOT / ".ci" / f"{name}.lock").read_text(), re.MULTILINE))
        wanted = {re.match(r"[\w.-]+", package).group() for package in packages} - {"alula"}
        assert wanted <= locked, name
