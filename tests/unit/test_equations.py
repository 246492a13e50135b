"""docs/theory/equations.md: every equation has a row, and every file, name, test and word in it exists."""

import ast
import re
from functools import cache

import pytest

from support.paths import DOCS, ROOT

PAGE = (DOCS / "theory" / "equations.md").read_text()
EQUATIONS = {
    "PolyMerge": [
        *map(str, range(1, 5)),
        "5a",
        "5b",
        "5c",
        *map(str, range(6, 16)),
        "16a",
        "16b",
        "17a",
        "17b",
    ],
    "FastBridge": list(map(str, range(1, 26))),
    "DR-ACBF": list(map(str, range(1, 31))),
    "Geofencing": list(map(str, range(1, 20))),
}
RESULTS = {
    "PolyMerge": {"Thm. 1", "Rem. 1"},
    "FastBridge": {"Prop. 1", "Prop. 2", "Prop. 3", "Lemma 1"},
    "DR-ACBF": set(),
    "Geofencing": {"Prop. 1", "Thm. 1", "Ex. 1"},
}
SUFFIXES = {".py", ".c", ".h", ".cpp", ".hpp", ".ino"}
TARGET = re.compile(r"`((?:[\w-]+/)+[\w-]+\.\w+)(?:::(\w+))?`")
NAME = re.compile(r"`(\w+)`")
WORDS = "Words and symbols"


def section(title):
    """Text of a section."""
    found = re.search(rf"^## {re.escape(title)}\n(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL)
    assert found, f"equations.md has no section {title!r}"
    return found[1]


def table(title):
    """Rows of a section's table as lists of cells."""
    lines = [line for line in section(title).splitlines() if line.startswith("|")][2:]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]


EQUATION_ROWS = [(paper, row) for paper in EQUATIONS for row in table(paper)]


@cache
def text_of(path):
    return (ROOT / path).read_text()


@cache
def definitions(path):
    """Functions and classes of a Python file."""
    kinds = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
    return {node.name for node in ast.walk(ast.parse(text_of(path))) if isinstance(node, kinds)}


def is_in(name, path):
    """Whether a file has a name: by its syntax in Python, as a word elsewhere."""
    if path.endswith(".py") and name in definitions(path):
        return True
    return re.search(rf"\b{re.escape(name)}\b", text_of(path)) is not None


@pytest.mark.parametrize("paper", EQUATIONS)
def test_every_numbered_equation_has_exactly_one_row(paper):
    numbers = [row[0] for row in table(paper)]
    assert [n[1:-1] for n in numbers if n.startswith("(")] == EQUATIONS[paper]
    assert set(numbers) >= RESULTS[paper]
    assert len(set(numbers)) == len(numbers)


@pytest.mark.parametrize(("paper", "row"), EQUATION_ROWS, ids=lambda x: x if isinstance(x, str) else x[0])
def test_files_names_and_tests_of_a_row_exist(paper, row):
    assert len(row) == 7
    assert all(row), "an empty cell"
    _, _, _, here, where, test, _ = row
    targets = TARGET.findall(where)
    for path, name in targets:
        assert (ROOT / path).is_file(), path
        if not name:
            continue
        assert name in definitions(path) if path.endswith(".py") else is_in(name, path), (
            f"{path} has no {name}"
        )
    if here == "not used":
        assert where == "–"
    else:
        assert targets
        for name in NAME.findall(here):
            assert any(is_in(name, path) for path, _ in targets), f"no file of the row has {name}"
    tests = TARGET.findall(test)
    assert tests or test == "-"
    for path, name in tests:
        assert path.startswith("tests/")
        assert (ROOT / path).is_file(), path
        assert name.startswith("test_")
        assert name in definitions(path), f"{path} has no {name}"


def test_equations_without_a_test_are_named():
    missing = [f"{paper} {row[0]}" for paper, row in EQUATION_ROWS if row[5] == "-"]
    said = section("Equations without a test")
    papers = re.findall(rf"({'|'.join(EQUATIONS)})((?:[, and]*\(\w+\))+)", said)
    assert missing == [
        f"{paper} {number}" for paper, list_ in papers for number in re.findall(r"\(\w+\)", list_)
    ]


@pytest.fixture(scope="module")
def lines():
    """All lines of the code, in lower case."""
    files = (p for part in ("native", "stages", "schemas") for p in (ROOT / part).rglob("*"))
    return "\n".join(p.read_text() for p in files if p.suffix in SUFFIXES).lower()


@pytest.mark.parametrize("row", table(WORDS), ids=lambda row: row[0])
def test_a_word_of_the_glossary_is_in_the_code_and_its_place_exists(row, lines):
    assert len(row) == 4
    for word in row[0].split(" / "):
        searched = {"λ": "lambda"}.get(word, word).lower()
        assert re.search(rf"\b{re.escape(searched)}s?\b", lines), f"the code never says {word!r}"
    targets = TARGET.findall(row[3])
    assert targets
    for path, name in targets:
        assert (ROOT / path).is_file(), path
        assert not name or is_in(name, path), f"{path} has no {name}"


def test_the_glossary_is_sorted():
    words = [row[0].lower() for row in table(WORDS)]
    assert words == sorted(words)


def test_links_of_the_page_lead_somewhere():
    for target in re.findall(r"\]\(([^)#]+)", PAGE):
        assert (DOCS / "theory" / target).exists(), target
