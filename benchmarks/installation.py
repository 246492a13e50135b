"""What an installation of the wheel takes: time, size by package, and a run of the pipeline without extras.

Makes a virtual environment, installs the wheel without extras, measures it, and runs the pipeline in it. Then
each extra is installed in turn, and what it adds is measured. Fails when the core is larger than the limit,
or a command fails.

    python benchmarks/installation.py dist/alula-*.whl --markdown docs/dependencies.md
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

LIMIT_MB = 330.0
ROOT = Path(__file__).resolve().parents[1]
EXTRAS = ("align", "view", "fly", "cluster", "foxglove", "ros2", "reference", "crazyflie")
UNCONSTRAINED = ("crazyflie",)  # cflib asks for fixed versions of other packages
# What the core needs each package for.
PURPOSES = {
    "alula": "this package, with its compiled core",
    "cffi": "comes with clarabel",
    "clarabel": "cone programs: headings of plans, the oracle of the quadratic programs",
    "click": "the command line",
    "lz4": "compressed chunks of logs that others wrote (comes with mcap)",
    "markdown-it-py": "comes with rich",
    "mcap": "reading and writing of logs",
    "mdurl": "comes with rich",
    "msgspec": "typed manifests and records, JSON, TOML, and their schemas",
    "numpy": "arrays",
    "pillow": "images of SOG files, pictures of flights",
    "pip": "comes with the environment; not counted",
    "pycparser": "comes with clarabel",
    "pygments": "comes with rich",
    "pyyaml": "folders of nerfstudio",
    "rich": "tables and progress on terminals",
    "scipy": "k-d trees, sparse matrices, statistics",
    "setuptools": "comes with the environment; not counted",
    "trimesh": "export to GLB",
    "zstandard": "compressed logs and SPZ version 4",
}
UNCOUNTED = ("pip", "setuptools")
# Written here although a package does something alike, each with its reason.
OWN = (
    (
        "readers of splat formats",
        "gsply",
        "it covers three of the ten formats, without the checks of rows and the bounds of what a format"
        " loses, on which the guarantee rests; tests compare with it",
    ),
    (
        "readers of meshes and clouds",
        "trimesh, open3d",
        "they skip what they do not know, so a proof could miss a wall; tests compare with both",
    ),
    (
        "ICP with scale",
        "open3d",
        "its ICP gives no covariance of the similarity; the estimate is scipy's",
    ),
    (
        "quadratic programs of filters",
        "daqp, quadprog",
        "filters need a certificate of each answer, equal bits on host and microcontroller, and no"
        " allocation; benchmarks compare with both",
    ),
    (
        "convex hulls",
        "scipy (Qhull), manifold3d",
        "in floating point they leave out lattice points; the guarantee needs exact integers",
    ),
    (
        "MAVLink connections",
        "pymavlink's mavutil",
        "it blocks, prints and reconnects on its own; messages are packed and parsed by pymavlink's dialect",
    ),
    (
        "messages of logs in JSON",
        "foxglove-sdk",
        "its writer stores its own version in the file and cannot read it back; mcap writes the container",
    ),
)
_MEASURE = """
import importlib.metadata, json, os
found = {}
for each in importlib.metadata.distributions():
    size = 0
    for file in each.files or ():
        path = each.locate_file(file)
        if os.path.isfile(path):
            size += os.path.getsize(path)
    found[each.metadata["Name"].lower().replace("_", "-")] = [each.version, size]
print(json.dumps(found))
"""
_STEPS = (
    "demo-scene -o s.ply --gaussians 20000 --colmap m --reference r.csv",
    "import-splat s.ply -o s.scene.npz --min-opacity 0.1 --drop-floaters",
    "scale-align s.scene.npz -o m.scene.npz --scale 2.5",
    "voxelize m.scene.npz -o v.voxels.npz --size 0.1",
    "merge v.voxels.npz -o c.cover.npz --hulls 100",
    "verify c.cover.npz --voxels v.voxels.npz --scene m.scene.npz",
    "plan c.cover.npz --free-points 2",
    "simulate c.cover.npz -o r.run.mcap --trials 2",
    "export c.cover.npz -o c.glb",
    "info r.run.mcap",
)


def _folder_mb(folder: Path) -> float:
    """Size of all files of a folder, compiled Python code included [MB]."""
    return (
        sum(path.stat().st_size for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
        / 1e6
    )


class Environment:
    """A virtual environment of its own."""

    def __init__(self, folder: Path) -> None:
        subprocess.run([sys._base_executable, "-m", "venv", str(folder)], check=True)  # type: ignore[attr-defined]
        self.folder = folder
        self.python = str(folder / "bin" / "python")
        self._empty_mb = self.mb()

    def mb(self) -> float:
        """Size of the packages [MB]."""
        return _folder_mb(self.folder / "lib")

    def added_mb(self) -> float:
        """Size of what was installed into it [MB]."""
        return self.mb() - self._empty_mb

    def install(self, what: str, *, constrained: bool = True) -> float:
        """Install a package, at the versions of CI if constrained; return the seconds that it took."""
        begin = time.monotonic()
        constraints = ["-c", str(self._versions())] if constrained else []
        options = ["-q", "--disable-pip-version-check", "--no-warn-script-location", *constraints]
        subprocess.run([self.python, "-m", "pip", "install", *options, what], check=True)
        return time.monotonic() - begin

    def _versions(self) -> Path:
        """The locked versions without their hashes: the wheel that is installed with them has none."""
        path = self.folder / "versions.txt"
        lines = (ROOT / ".ci" / "runtime.lock").read_text().splitlines()
        path.write_text("\n".join(line.removesuffix("\\") for line in lines if not line.startswith(" ")))
        return path

    def packages(self) -> dict[str, tuple[str, float]]:
        """Version and size [MB] of each installed distribution."""
        done = subprocess.run([self.python, "-c", _MEASURE], check=True, capture_output=True, text=True)
        return {name: (version, size / 1e6) for name, (version, size) in json.loads(done.stdout).items()}

    def run_pipeline(self, folder: Path) -> float:
        """Run every step of the pipeline in a folder; return the seconds of all."""
        begin = time.monotonic()
        for step in _STEPS:
            words = [str(self.folder / "bin" / "alula"), *step.split(), "-q"]
            done = subprocess.run(words, cwd=folder, capture_output=True, text=True)
            if done.returncode not in (0, 4):  # 4: a flight of the random pairs collided, which is an answer
                raise SystemExit(f"alula {step}: exit code {done.returncode}: {done.stderr.strip()}")
        return time.monotonic() - begin


def measured(wheel: Path, extras: tuple[str, ...]) -> dict[str, Any]:
    """Install the wheel and the extras, each into the same environment, and measure."""
    with tempfile.TemporaryDirectory(prefix="alula-install-") as name:
        folder = Path(name)
        environment = Environment(folder / "venv")
        seconds = environment.install(str(wheel))
        found: dict[str, Any] = {"install_s": seconds, "core_mb": environment.added_mb()}
        found["packages"] = environment.packages()
        (folder / "run").mkdir()
        found["pipeline_s"] = environment.run_pipeline(folder / "run")
        found["extras"] = {}
        for extra in extras:
            before, known = environment.mb(), set(environment.packages())
            taken = environment.install(f"{wheel}[{extra}]", constrained=extra not in UNCONSTRAINED)
            new = sorted(set(environment.packages()) - known)
            found["extras"][extra] = {"mb": environment.mb() - before, "s": taken, "packages": new}
    return found


def page(found: dict[str, Any]) -> str:
    """Write the page."""
    python = sys.version.split()[0]
    lines = [
        "# Dependencies",
        "",
        "This page says what `pip install alula` installs, what each package is for, and what the extras",
        "add. Sizes are those of installed files, with compiled Python code, in MB of 10⁶ bytes.",
        "",
        "Written by `python benchmarks/installation.py dist/alula-*.whl --markdown docs/dependencies.md`",
        f"on Python {python}.",
        "",
        f"The core takes **{found['core_mb']:.0f} MB** and {found['install_s']:.0f} s to install; CI fails",
        f"above {LIMIT_MB:.0f} MB. With it alone, the pipeline from a splat to a judged flight and an export",
        f"runs, in {found['pipeline_s']:.0f} s for a small scene.",
        "",
        "| package | version | MB | for |",
        "| --- | --- | --- | --- |",
    ]
    packages = {name: value for name, value in found["packages"].items() if name not in UNCOUNTED}
    for name, (version, size) in sorted(packages.items(), key=lambda item: -item[1][1]):
        lines.append(f"| {name} | {version} | {size:.1f} | {PURPOSES.get(name, '')} |")
    lines += ["", "Extras, each installed after those above it:", "", "| extra | MB more | packages | for |"]
    lines.append("| --- | --- | --- | --- |")
    from alula.schemas.extras import EXTRAS as KNOWN

    for extra, row in found["extras"].items():
        purposes = {e.purpose for e in KNOWN.values() if e.extra == extra}
        words = "; ".join(sorted(p.removesuffix(" needs it").removesuffix(" need it") for p in purposes))
        count = len(row["packages"])
        names = ", ".join(row["packages"][:6]) + (f" and {count - 6} more" if count > 6 else "")
        lines.append(f"| `{extra}` | {row['mb']:.0f} | {names} | {words} |")
    lines += [
        "",
        "`[all]` is all of them but `crazyflie`: its package is under the GPL and asks for fixed versions of",
        "other packages. `make setup` installs `[all]` and what the tests need.",
        "",
        "## Written here although a package does something alike",
        "",
        "| what | package | why it does not replace ours |",
        "| --- | --- | --- |",
        *(f"| {what} | {package} | {why} |" for what, package, why in OWN),
        "",
    ]
    return "\n".join(lines)


def main() -> None:
    """Measure, write the page, and fail above the limit."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("wheel", type=Path)
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the page to FILE")
    parser.add_argument("--core", action="store_true", help="leave the extras out")
    parser.add_argument("--json", action="store_true", help="print the figures")
    options = parser.parse_args()
    found = measured(options.wheel.resolve(), () if options.core else EXTRAS)
    if options.markdown is not None:
        options.markdown.write_text(page(found), encoding="utf-8")
    if options.json:
        print(json.dumps(found, indent=1))
    print(f"core: {found['core_mb']:.0f} MB, installed in {found['install_s']:.0f} s", file=sys.stderr)
    if found["core_mb"] > LIMIT_MB:
        raise SystemExit(f"the core takes {found['core_mb']:.0f} MB, more than {LIMIT_MB:.0f} MB")


if __name__ == "__main__":
    main()
