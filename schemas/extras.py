"""Packages that only some commands need, and the extra of alula that installs each of them.

The one place that knows them: `pyproject.toml` has the same extras (a test compares them), `alula doctor`
lists them, and a missing package becomes one line that says what to install.
"""

from __future__ import annotations

import importlib
import importlib.util
import platform
import sys
from dataclasses import dataclass
from types import ModuleType

from alula.schemas.errors import UsageError


@dataclass(frozen=True, slots=True)
class Extra:
    """A package that is not part of every installation.

    Attributes:
        distribution: its name on the package index.
        extra: the extra of alula that installs it.
        purpose: what needs it, in words that end in "needs it" or "need it".
    """

    distribution: str
    extra: str
    purpose: str


_OPEN3D = "open3d-cpu" if sys.platform == "linux" and platform.machine() == "x86_64" else "open3d"
EXTRAS: dict[str, Extra] = {  # by the module that is imported
    "pycolmap": Extra("pycolmap", "align", "alignment by images or GPS needs it"),
    "open3d": Extra(_OPEN3D, "align", "alignment by point clouds needs it"),
    "matplotlib": Extra("matplotlib", "view", "report needs it"),
    "viser": Extra("viser", "view", "view, report and fly --live need it"),
    "pymavlink": Extra("pymavlink", "fly", "fly, identify and sim-vehicle need it"),
    "cflib": Extra("cflib", "crazyflie", "flying a Crazyflie needs it"),
    "foxglove": Extra("foxglove-sdk", "foxglove", "fly --foxglove needs it"),
    "rosbags": Extra("rosbags", "ros2", "export --ros2 needs it"),
    "cvxpy": Extra("cvxpy-base", "reference", "the planner's reference needs it"),
    "distributed": Extra("distributed", "cluster", "--scheduler needs it"),
    "dask": Extra("distributed", "cluster", "--scheduler needs it"),
}


def missing(module: str) -> UsageError:
    """Error for a package of `EXTRAS` that is not installed; it says what to install."""
    wanted = EXTRAS[module]
    return UsageError(
        f"{wanted.distribution} is not installed; {wanted.purpose}: pip install 'alula[{wanted.extra}]'"
    )


def require(*modules: str) -> None:
    """Check that packages of `EXTRAS` are installed, without importing them.

    Raises:
        UsageError: one is not.
    """
    for module in modules:
        if importlib.util.find_spec(module) is None:
            raise missing(module)


def load(module: str) -> ModuleType:
    """Import a module of a package of `EXTRAS`.

    Raises:
        UsageError: the package is not installed, or it cannot be imported on this machine.
    """
    package = module.partition(".")[0]
    require(package)
    try:
        return importlib.import_module(module)
    except (ImportError, OSError) as error:
        raise UsageError(
            f"{EXTRAS[package].distribution} cannot be imported: {error} (see alula doctor)"
        ) from error
