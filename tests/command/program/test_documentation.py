"""The documentation: what pages say of files, filters and errors, and the site that is built from them."""

import re
import shutil
import subprocess
import sys

import pytest
from PIL import Image

from alula.cli.main import run
from alula.cli.pages.all import generated_pages
from alula.schemas.artifacts.kinds import KINDS
from alula.schemas.errors import ExitCode
from alula.schemas.parameters.filter_options import FILTERS, TABLES
from alula.schemas.parameters.filters.values import entries
from support.files.command_lines import PAGES, command_lines
from support.paths import DOCS, ROOT

SOURCES = "".join(
    path.read_text() for part in ("cli", "stages", "schemas") for path in (ROOT / part).rglob("*.py")
)


@pytest.fixture(scope="module")
def generated():
    return generated_pages()


def test_the_reference_has_every_array_and_every_field_of_every_artifact(generated):
    for kind in KINDS.values():
        page = generated[f"reference/artifacts/{kind.name.removeprefix('alula/')}.md"]
        for rule in kind.arrays:
            shape = f"({', '.join(map(str, rule.shape))})"
            dtype = rule.dtype.replace("|", "\\|")
            assert f"| `{dtype}` | {shape} | {rule.unit} | {rule.meaning} |" in page
        for name in kind.manifest.__struct_fields__:
            row = re.search(rf"^\| `{name}` \| [^|]+ \| [^|]* \| ([^|]+) \|$", page, re.MULTILINE)
            assert row is not None, f"{kind.name}: {name}"
            assert len(row[1]) > 8, f"{kind.name}: {name} has no meaning"


def test_the_reference_has_every_parameter_of_every_filter(generated):
    page = generated["reference/filters.md"]
    for name, options in FILTERS.items():
        section = page.split(f"\n## {name}\n")[1].split("\n## ")[0]
        if TABLES[name] != name:
            assert f"Its parameters are those of `{TABLES[name]}`" in section
            continue
        for key, entry in entries(options).items():
            assert f"| `{key}` | " in section
            assert (entry.meta.description or "").replace("|", "\\|") in section


WITHOUT_MEANING = {  # their type or table says it
    *("fence_m", "link", "geofence", "mpc", "shield", "cbf_qp", "rp_cbf", "wall_deceleration_m_s2"),
}


def test_the_reference_says_what_each_field_of_a_file_means(generated):
    found = 0
    for name, page in generated.items():
        if name.startswith("reference/artifacts/"):
            tables = page.split("\n## Manifest\n")[-1]
            rows = re.findall(r"^\| `(\w+)` \| (.+) \| (?:[^|]*) \| ([^|]*) \|$", tables, re.MULTILINE)
            found += len(rows)
            without = {key for key, kind, words in rows if not words and "](#" not in kind}
            assert without <= WITHOUT_MEANING, name
    assert found > 600


def test_meanings_come_from_the_docstrings(generated):
    page = generated["reference/artifacts/run.md"]
    assert (
        "| `scene_clearance_m` | number or null | required | minimum clearance of the ellipsoids of the scene"
        in page
    )
    assert "| `start_m` | 3 × number, ≥ -1e+15, ≤ 1e+15 | required | positions, world frame [m]. |" in page


@pytest.mark.parametrize("page", ["howto/choose-a-filter.md", "theory/each-filter.md"])
def test_pages_on_filters_name_each_of_them(page):
    text = (DOCS / page).read_text()
    assert [name for name in FILTERS if not re.search(rf"(`|## |, |and ){name}\b", text)] == []


def test_the_times_of_filters_are_those_of_the_results():
    measured = (DOCS / "results/benchmarks-world.md").read_text()
    rows = re.findall(r"^\| ([\w-]+) \|.*\| (\d+) / \d+ \|$", measured, re.MULTILINE)
    shown = (DOCS / "howto/choose-a-filter.md").read_text()
    cells = re.findall(r"^\| ([^|]+) \|.*\| ([\d–.]+) \|$", shown, re.MULTILINE)
    times = {name: time.split("–") for names, time in cells for name in re.findall(r"`([\w-]+)`", names)}
    checked = [name for name, p50 in rows if name in times and name != "none"]
    assert len(checked) >= 8
    for name, p50 in rows:
        if name in checked:
            low, high = times[name][0], times[name][-1]
            assert float(low) <= float(p50) <= float(high), name


def test_troubleshooting_has_every_exit_code_and_messages_that_exist():
    codes, messages = (DOCS / "howto/troubleshooting.md").read_text().split("## Messages")
    assert {int(code) for code in re.findall(r"^\| (\d+) \|", codes, re.MULTILINE)} == {
        int(code) for code in ExitCode
    }
    quoted = re.findall(r"^\| `([^`]+)` \|", messages, re.MULTILINE)
    assert len(quoted) > 8
    strings = re.sub(r'"\s*\n\s*f?"', "", SOURCES)  # a message may be written in several strings
    generic = ("contains unknown field", "cannot read: No such file")  # of msgspec, and of the system
    assert [words for words in quoted if words not in strings and words not in generic] == []


def test_every_page_opens_with_a_paragraph(generated):
    pages = {
        str(path.relative_to(ROOT)): path.read_text() for path in PAGES if path.parent != ROOT
    } | generated
    for name, text in pages.items():
        lines = [line for line in text.splitlines() if line.strip()]
        assert lines[0].startswith("# "), name
        assert re.match(r"[A-Z`*\[]", lines[1]), f"{name} begins with {lines[1]!r}"
        assert not lines[1].startswith(("!", "|", "- ", "```")), name


def test_pictures_are_small_and_shown():
    text = "".join(path.read_text() for path in PAGES)
    for path in (DOCS / "pictures").iterdir():
        assert f"pictures/{path.name}" in text, f"{path.name} is on no page"
    for path in DOCS.glob("pictures/tutorial-*"):
        assert path.stat().st_size < 150_000
        with Image.open(path) as image:
            assert image.width >= 800


@pytest.mark.slow
def test_the_tutorial_prints_what_it_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = (DOCS / "tutorial.md").read_text()
    steps = re.findall(r"^```sh\n(.*?)^```\n(.*?)(?=^```sh|\Z)", text, re.MULTILINE | re.DOTALL)
    lines = {" ".join(line.words): line.words for line in command_lines(DOCS / "tutorial.md")}
    shown = 0
    for block, rest in steps:
        if block.startswith("alula view"):
            continue
        words = next(
            words for line, words in lines.items() if line == " ".join(block.replace('"', "").split())
        )
        assert run(list(words[1:])) == 0
        printed = capsys.readouterr().out
        for excerpt in re.findall(r"^```text\n(.*?)^```", rest, re.MULTILINE | re.DOTALL):
            for line in excerpt.splitlines():
                assert line in printed.splitlines()
                shown += 1
    assert shown > 20
    assert len(list(tmp_path.glob("room.*"))) >= 9


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("mkdocs", reason="mkdocs-material is of the development group")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-P", "-m", "mkdocs", "build", "-q", "-d", str(folder)]
    environment = {"PATH": "/usr/bin:/bin", "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr  # strict: a broken link is an error
    return folder


@pytest.mark.slow
def test_no_page_of_the_site_loads_anything_from_elsewhere(site):
    pages = list(site.rglob("*.html"))
    assert len(pages) > 60
    for page in pages:
        text = page.read_text()
        loaded = re.findall(r"<(?:script|img|iframe|source|video)\b[^>]*?\bsrc=[\"']?([^\"'> ]+)", text)
        loaded += re.findall(
            r"<link\b[^>]*?rel=[\"']?(?:stylesheet|icon|preconnect)[^>]*?href=[\"']?([^\"'> ]+)", text
        )
        loaded += re.findall(
            r"<link\b[^>]*?href=[\"']?([^\"'> ]+)[^>]*?rel=[\"']?(?:stylesheet|icon|preconnect)", text
        )
        assert len(loaded) >= 3, page
        assert [url for url in loaded if re.match(r"(https?:)?//", url)] == [], page
    for style in site.rglob("*.css"):
        assert re.findall(r"(?:url\(|@import )[\"']?(?:https?:)?//[^)\"']+", style.read_text()) == [], style


@pytest.mark.slow
def test_the_site_has_all_results_and_the_sources_that_pages_link_to(site):
    home = (site / "index.html").read_text()
    for path in DOCS.rglob("*.md"):
        name = path.relative_to(DOCS).with_suffix(".html")
        assert (site / name).is_file()
        assert f'href="{name}"' in home or name.stem in ("index", "tutorial")
    assert "speed_m_s" in (site / "source/examples/world/room.toml.html").read_text()
    assert "SafetyFilter" in (site / "reference/python.html").read_text()


@pytest.mark.slow
@pytest.mark.process
def test_a_page_opened_from_the_disk_can_be_searched(site):
    api = pytest.importorskip("playwright.sync_api", reason="playwright is needed")
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        pytest.skip("needs Chromium: apt-get install chromium")
    with api.sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=program, args=["--no-sandbox"])
        page = chromium.new_page(viewport={"width": 390, "height": 800})
        requests, errors = [], []
        page.on("request", lambda request: requests.append(request.url))
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto((site / "theory/filters.html").as_uri())
        page.wait_for_timeout(1000)
        assert (
            page.evaluate("document.documentElement.scrollWidth") == 390
        )  # tables scroll, the page does not
        page.set_viewport_size({"width": 1280, "height": 800})
        page.keyboard.press("s")
        page.wait_for_timeout(1500)
        page.keyboard.type("conservativeness")
        page.wait_for_function(
            "document.querySelectorAll('.md-search-result__item').length > 2", timeout=30_000
        )
        chromium.close()
    assert errors == []
    assert [url for url in requests if not url.startswith(("file:", "data:", "blob:", "about:"))] == []
