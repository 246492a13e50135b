"""Errors keep their class, exit code and attributes when they get another text, a copy or a process."""

import ast
import copy
import importlib
import inspect
import pickle
import re
from pathlib import Path

import pytest

from alula.schemas.errors import AlulaError

ROOT = Path(__file__).parents[3]


FILES = [path for folder in ("schemas", "stages", "cli") for path in (ROOT / folder).rglob("*.py")]


def classes_in_source():
    """Modules and names of the classes that derive from an error of alula, by the source text."""
    found, known = {}, {"AlulaError"}
    texts = {path: text for path in FILES if "Error):" in (text := path.read_text())}
    for _ in range(3):  # bases may be defined in later files
        for path, text in texts.items():
            for node in ast.parse(text).body:
                if isinstance(node, ast.ClassDef) and known & {getattr(b, "id", "") for b in node.bases}:
                    known.add(node.name)
                    module = ".".join(("alula", *path.relative_to(ROOT).with_suffix("").parts))
                    found[node.name] = module
    return found


CLASSES = classes_in_source()


def made(name):
    """An error of a class, with an argument of the right kind for each parameter."""
    kind = getattr(importlib.import_module(CLASSES[name]), name)
    parameters = list(inspect.signature(kind.__init__).parameters.values())[1:]
    named = [one for one in parameters if one.kind is one.POSITIONAL_OR_KEYWORD]
    arguments = {one.name: {"why": 3} if i else "the text" for i, one in enumerate(named)}
    return kind(**arguments) if arguments else kind("the text")


def test_the_classes_are_found():
    assert {"InputError", "DamagedError", "NothingLeftError"} <= set(CLASSES)


@pytest.mark.parametrize("name", CLASSES)
def test_an_error_with_another_text_keeps_all_else(name):
    error = made(name)
    other = error.reworded("file.ply: the text")
    assert type(other) is type(error)
    assert str(other) == "file.ply: the text"
    assert str(error) == "the text"
    assert other.exit_code == error.exit_code
    assert vars(other) == vars(error)


@pytest.mark.parametrize("name", CLASSES)
@pytest.mark.parametrize("through", [copy.copy, lambda error: pickle.loads(pickle.dumps(error))])
def test_an_error_survives_a_copy_and_another_process(name, through):
    error = made(name)
    other = through(error)
    assert type(other) is type(error)
    assert str(other) == str(error)
    assert vars(other) == vars(error)


def test_no_error_is_made_anew_from_its_class():
    for path in FILES:
        found = re.search(r"raise type\(\w+\)\(", path.read_text())
        assert found is None, f"{path}: an error class may take more arguments; use `reworded`"


def test_the_root_is_an_error_of_its_own():
    assert AlulaError("a").reworded("b").args == ("b",)
