"""The native core compiled for other instructions: every file that the commands write has the same bytes."""

import os
import platform
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support.paths import ROOT, SUPPORT

pytestmark = [pytest.mark.slow, pytest.mark.process]
MEASURED = (".run.json", ".html", ".report.md")  # hold times of this computer
NEEDED = {"avx2", "bmi2", "fma"}


def output(*words):
    return subprocess.run(list(map(str, words)), check=True, capture_output=True, text=True).stdout


def made_by(module, folder):
    folder.mkdir()
    output(sys.executable, "-P", SUPPORT / "other_core.py", module, folder)
    return {p.name: p.read_bytes() for p in folder.iterdir() if not p.name.endswith(MEASURED)}


@pytest.mark.skipif(
    sys.platform != "linux" or platform.machine() != "x86_64", reason="compares builds for x86"
)
def test_fused_multiplication_and_wider_registers_change_no_bit(tmp_path):
    """Against the installed module: x86-64-v3 in the place of v2, and -O2 in that of -O3 (-O1 fuses nothing).

    The core is compiled anew, in three minutes of one processor without ccache. The bindings are those of the
    installed module.
    """
    if missing := NEEDED - set(Path("/proc/cpuinfo").read_text().split()):
        pytest.skip(f"this processor has no {', '.join(sorted(missing))}")
    cmake, ninja = pytest.importorskip("cmake"), pytest.importorskip("ninja")
    built = next(iter(sorted(ROOT.glob("build/cp3*-linux_x86_64/build.ninja"))), None)
    if built is None:
        pytest.skip("the installed module was not built in this checkout")
    tools = Path(ninja.BIN_DIR) / "ninja", Path(cmake.CMAKE_BIN_DIR) / "cmake"
    module = next(built.parent.glob("_core.*.so"))
    inputs = output(tools[0], "-C", built.parent, "-t", "query", module.name).splitlines()
    bindings = [
        built.parent / line.split()[-1] for line in inputs if re.search(r"_core\.dir/|nanobind", line)
    ]
    folder = ROOT / "build/x86-64-v3"
    flags = [f"-DCMAKE_{language}_FLAGS_RELEASE=-O2 -DNDEBUG" for language in ("C", "CXX")]
    options = ["-G", "Ninja", f"-DCMAKE_MAKE_PROGRAM={tools[0]}", "-DALULA_PYTHON=OFF"]
    if shutil.which("ccache"):
        options += [f"-DCMAKE_{language}_COMPILER_LAUNCHER=ccache" for language in ("C", "CXX")]
    output(tools[1], "-S", ROOT, "-B", folder, *options, "-DALULA_MARCH=x86-64-v3", *flags)
    output(tools[1], "--build", folder, "-j", os.cpu_count())
    libraries = [folder / f"lib{name}.a" for name in ("alula_core", "alula_onboard")]
    objects = sorted(bindings, key=lambda path: path.suffix == ".a")
    other = tmp_path / "_core.so"
    output("c++", "-shared", "-o", other, *objects[:-1], *libraries, objects[-1], "-pthread")

    found, expected = made_by(other, tmp_path / "other"), made_by("-", tmp_path / "installed")
    assert len(expected) > 20
    assert sorted(name for name, content in expected.items() if found[name] != content) == []
