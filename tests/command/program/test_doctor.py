"""The command `doctor` lists what is installed and what is missing, with the documented exit code."""

import json
import os
import subprocess
import sys

import pytest

from alula.cli.main import run
from alula.cli.verbs import doctor
from alula.cli.verbs.doctor import PACKAGES, Check
from support.paths import ROOT


@pytest.fixture(scope="module")
def done():
    return subprocess.run(
        [sys.executable, "-P", "-m", "alula.cli", "doctor", "--json"],
        capture_output=True,
        text=True,
        env=os.environ | {"ALULA_DATA": "/nowhere"},
    )


@pytest.fixture
def found(done):
    return {check["name"]: Check(**check) for check in json.loads(done.stdout)["checks"]}


def test_every_dependency_of_the_project_is_looked_for():
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    names = {word.split(">=")[0].split(";")[0].strip() for word in project["dependencies"]}
    assert {name.removesuffix("-cpu") for name in names} == {
        name.removesuffix("-cpu") for name in PACKAGES.values()
    }


@pytest.mark.slow
def test_what_runs_this_test_is_found(found):
    assert found["Python"].status == "ok"
    assert found["alula._core"].status == "ok"
    for name in ("numpy", "scipy", "click", "mcap", "matplotlib"):
        assert found[name].status == "ok"
    assert found["processors"].found.split()[0].isdigit()
    assert {check.status for check in found.values()} <= {"ok", "missing", "optional"}


@pytest.mark.slow
def test_the_command_agrees_with_its_code(done, found):
    ok = json.loads(done.stdout)["ok"]
    assert done.returncode == (0 if ok else 4)
    assert ok == all(check.status != "missing" for check in found.values())
    assert found["ALULA_DATA"] == Check("ALULA_DATA", "optional", "/nowhere", "is not a folder")
    assert "Traceback" not in done.stderr


def test_something_missing_fails_and_is_named(monkeypatch, capsys):
    checks = [
        Check("numpy", "ok", "2"),
        Check("open3d", "missing", "0.18", "apt-get install libgl1"),
        Check("git", "optional", ""),
        Check("viser", "missing", "", "pip install viser"),
    ]
    monkeypatch.setattr(doctor, "examine", lambda: checks)
    assert run(["doctor"]) == 4
    shown = capsys.readouterr()
    assert shown.err == "alula: open3d is missing: apt-get install libgl1 (and 1 more)\n"
    assert "numpy   ok        2" in shown.out
    monkeypatch.setattr(doctor, "examine", lambda: checks[:1] + checks[2:3])
    assert run(["doctor", "-q"]) == 0
    assert capsys.readouterr().out == ""


def test_a_package_that_is_not_installed_is_missing():
    check = doctor._package("no_such_module", "no-such-distribution")
    assert (check.status, check.note) == ("missing", "pip install no-such-distribution")


def test_a_package_that_cannot_be_imported_is_missing_with_the_reason(tmp_path, monkeypatch):
    (tmp_path / "broken_module.py").write_text("raise OSError('libEGL.so.1: cannot open shared object file')")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    monkeypatch.setattr(doctor, "_loads", lambda library: not library.startswith("libEGL"))
    check = doctor._package("broken_module", "numpy")
    assert check.status == "missing"
    assert check.note == "apt-get install libegl1"


def test_shared_libraries_are_named_by_their_packages():
    assert doctor._absent(lambda library: False) == list(doctor.LIBRARIES.values())
    assert doctor._absent(lambda library: True) == []


def test_what_only_some_commands_need_is_optional_and_named(monkeypatch):
    monkeypatch.setattr(doctor, "_package", lambda module, name: Check(module, "missing", "", "pip install"))
    found = doctor._extra("cflib")
    assert (found.status, found.note) == (
        "optional",
        "flying a Crazyflie needs it: pip install 'alula[crazyflie]'",
    )
    monkeypatch.setattr(doctor, "_package", lambda module, name: Check(module, "ok", "1.1"))
    assert doctor._extra("cflib") == Check("cflib", "ok", "1.1")
