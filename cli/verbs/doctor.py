"""`doctor`: checks of all that alula needs."""

from __future__ import annotations

import ctypes
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from alula.schemas.extras import EXTRAS

# Module to import: the distribution that provides it. What only some commands need is in EXTRAS.
PACKAGES = {
    "click": "click",
    "numpy": "numpy",
    "scipy": "scipy",
    "msgspec": "msgspec",
    "rich": "rich",
    "mcap": "mcap",
    "trimesh": "trimesh",
    "PIL": "pillow",
    "yaml": "pyyaml",
    "zstandard": "zstandard",
    "clarabel": "clarabel",
}
# Shared library that open3d's Linux wheels load: the Debian package that provides it.
LIBRARIES = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libEGL.so.1": "libegl1",
    "libX11.so.6": "libx11-6",
    "libGL.so.1": "libgl1",
    "libgomp.so.1": "libgomp1",
}
_OLDEST = (3, 11)
_IMPORT_SECONDS = 120


@dataclass(frozen=True, slots=True)
class Check:
    """Result of one check.

    Attributes:
        status: ok, missing (required but not found) or optional (not found and not required).
        found: version or location that was found.
        note: remedy or purpose.
    """

    name: str
    status: str
    found: str
    note: str = ""


def examine() -> list[Check]:
    """Run all checks, in the order of the table."""
    with ThreadPoolExecutor(max_workers=min(8, os.cpu_count() or 1)) as pool:
        packages = list(pool.map(_package, PACKAGES, PACKAGES.values()))
        packages += pool.map(_extra, EXTRAS)
    return [
        _python(),
        _native(),
        *packages,
        *([_libraries()] if sys.platform == "linux" else []),
        _program("C++ compiler", ("c++", "g++", "clang++"), "only to build alula from source"),
        _program("git", ("git",), "only to record the commit of a checkout"),
        _program("Chromium", ("chromium", "chromium-browser", "google-chrome"), "only to look at reports"),
        _data(),
        *_machine(),
    ]


def _python() -> Check:
    good = sys.version_info >= _OLDEST
    wanted = ".".join(map(str, _OLDEST))
    note = "" if good else f"install Python {wanted} or newer"
    return Check("Python", "ok" if good else "missing", platform.python_version(), note)


def _native() -> Check:
    try:
        from alula.schemas.artifacts.manifest import producer

        made = producer()
    except ImportError as error:
        return Check(
            "alula._core", "missing", "", f"cannot be imported ({error}); build or install alula again"
        )
    return Check("alula._core", "ok", f"{made.version} ({made.commit})")


def _package(module: str, distribution: str) -> Check:
    """Import a module in a separate process, because some print and a broken one may crash."""
    try:
        found = version(distribution)
    except PackageNotFoundError:
        return Check(module, "missing", "", f"pip install {distribution}")
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-c", f"import {module}"],
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_IMPORT_SECONDS,
        )
    except (OSError, subprocess.SubprocessError) as error:
        return Check(module, "missing", found, f"cannot be imported ({error})")
    if done.returncode == 0:
        return Check(module, "ok", found)
    last = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
    wanted = [package for library, package in LIBRARIES.items() if library in last]
    note = f"apt-get install {' '.join(_absent(_loads) or wanted)}" if wanted else last
    return Check(module, "missing", found, note)


def _extra(module: str) -> Check:
    extra = EXTRAS[module]
    found = _package(module, extra.distribution)
    if found.status == "ok":
        return found
    remedy = f"pip install 'alula[{extra.extra}]'" if not found.found else found.note
    if not found.found and _has_no_wheel(module):
        remedy = "there is no wheel for this machine"
    return Check(module, "optional", found.found, f"{extra.purpose}: {remedy}")


def _has_no_wheel(module: str) -> bool:
    return module == "pycolmap" and sys.platform == "linux" and platform.machine() != "x86_64"


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _absent(loads: Callable[[str], bool]) -> list[str]:
    """Debian packages of the shared libraries that do not load."""
    return [package for library, package in LIBRARIES.items() if not loads(library)]


def _libraries() -> Check:
    absent = _absent(_loads)
    if not absent:
        return Check("shared libraries", "ok", " ".join(LIBRARIES.values()))
    note = f"apt-get install {' '.join(absent)}"
    present = " ".join(package for package in LIBRARIES.values() if package not in absent)
    return Check("shared libraries", "missing", present, note)


def _program(name: str, commands: tuple[str, ...], purpose: str) -> Check:
    for word in commands:
        if path := shutil.which(word):
            return Check(name, "ok", path)
    return Check(name, "optional", "", purpose)


def _data() -> Check:
    folder = os.environ.get("ALULA_DATA")
    if not folder:
        return Check("ALULA_DATA", "optional", "", "folder of real scenes, only for tests")
    if Path(folder).is_dir():
        return Check("ALULA_DATA", "ok", folder)
    return Check("ALULA_DATA", "optional", folder, "is not a folder")


def _machine() -> list[Check]:
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    checks = [Check("processors", "ok", f"{usable} usable, {platform.machine()}")]
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        checks.append(Check("memory", "ok", f"{memory / 2**30:.1f} GiB"))
    except (ValueError, OSError, AttributeError):
        checks.append(Check("memory", "optional", "", "unknown on this system"))
    try:
        free = shutil.disk_usage(Path.cwd()).free
        checks.append(Check("free disk here", "ok", f"{free / 2**30:.1f} GiB"))
    except OSError as error:
        checks.append(Check("free disk here", "optional", "", str(error)))
    return checks
