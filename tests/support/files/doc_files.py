"""Small files for the command lines of the documentation: a made one for each name that a page uses.

The garden is an open place with a few posts, in which the points of README.md are free; the room is the
built-in one. Each file is made by its command when a line first needs it.
"""

import shutil
from functools import cache
from pathlib import Path

import numpy as np

from alula.cli.main import run
from support.files.command_lines import DOCS
from support.paths import EXAMPLES, VEHICLES
from support.scenes.pipeline import COLUMNS

ROOM_GAUSSIANS = 40000
SIZE = "0.05"  # of voxels [m]
PAIRS = "0 0 0 1 0 0\n1 0 0 3 0 0\n0 2 0 1 4 0\n0 0 3 1 0 6\n1 1 1 3 2 2\n"


def write_garden(path: Path) -> None:
    """A lawn of 10 m x 8 m at z = 0 with four posts, 2,000 Gaussians in an INRIA .ply."""
    rng = np.random.default_rng(5)
    count = 2000
    rows = np.zeros(count, [(name, "<f4") for name in COLUMNS])
    rows["x"], rows["y"] = rng.uniform(-3, 7, count), rng.uniform(-3, 5, count)
    rows["z"] = -0.1
    for k, (x, y) in enumerate([(2, 0.5), (3, 3), (-1, 2), (5, -1)]):
        post = slice(100 * k, 100 * k + 100)
        rows["x"][post], rows["y"][post] = x + rng.normal(0, 0.03, 100), y + rng.normal(0, 0.03, 100)
        rows["z"][post] = rng.uniform(0, 2, 100)
    rows["opacity"], rows["rot_0"] = 3.0, 1.0
    for axis in range(3):
        rows[f"scale_{axis}"] = np.log(rng.uniform(0.02, 0.06, count))
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    header += [f"property float {name}" for name in COLUMNS] + ["end_header", ""]
    path.write_bytes("\n".join(header).encode() + rows.tobytes())


def write_garden_model(room: Path, garden: Path, folder: Path) -> None:
    """A COLMAP model with the cameras of the room's and points on Gaussians of the garden."""
    rows = np.frombuffer(
        garden.read_bytes().split(b"end_header\n", 1)[1], [(name, "<f4") for name in COLUMNS]
    )
    folder.mkdir()
    shutil.copy(room / "cameras.txt", folder)
    poses = [line for line in (room / "images.txt").read_text().splitlines() if line.endswith(".jpg")]
    (folder / "images.txt").write_text("".join(f"{pose}\n\n" for pose in poses))
    points = (f"{k + 1} {row['x']} {row['y']} {row['z']} 0 0 0 1\n" for k, row in enumerate(rows))
    (folder / "points3D.txt").write_text("".join(points))


def write_shed(path: Path) -> None:
    """A hollow box of 4 m x 3 m x 2 m as a mesh, or points of it."""
    import trimesh

    shed = trimesh.creation.box((4, 3, 2))
    if path.suffix == ".xyz":
        np.savetxt(path, trimesh.sample.sample_surface_even(shed, 3000, seed=1)[0])
    else:
        shed.export(path)


class DocFiles:
    """Makes files by their commands, each once.

    Args:
        folder: where they are kept.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.made = cache(self._make)

    def put(self, name: str, target: Path, place: str) -> bool:
        """Put the file of a place that a page calls `name` at `target`; False if it means no file by it."""
        base = Path(name).name
        source = self._example(base) or next(
            (self.made(place, kind) for kind in _KINDS if base.endswith(kind) or name.endswith(kind)), None
        )
        if source is None:
            return False
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, target, dirs_exist_ok=True)
        else:
            shutil.copy(source, target)
            if base.endswith(".run.mcap"):
                shutil.copy(source.with_suffix(".json"), target.with_suffix(".json"))
        return True

    def _example(self, base: str) -> Path | None:
        """A file of the examples by its name, or one that a page shows."""
        if base == "fence.toml":
            return self._shown("theory/geofence.md", base)
        folders = (VEHICLES, EXAMPLES / "room", EXAMPLES / "world")
        if base in ("mine.toml", "OLD.toml"):
            return VEHICLES / "arducopter.toml" if base == "mine.toml" else EXAMPLES / "room/scenario.toml"
        return next((folder / base for folder in folders if (folder / base).is_file()), None)

    def _shown(self, page: str, base: str) -> Path:
        text = (DOCS / page).read_text()
        block = text.split("```toml\n")[1].split("```")[0]
        path = self.folder / base
        path.write_text(block)
        return path

    def _make(self, place: str, kind: str) -> Path:
        of = lambda ending: str(self.made(place, ending))  # noqa: E731
        target = self.folder / f"{place}{kind}" if kind.startswith(".") else self.folder / kind
        if kind == ".ply" and place == "garden":
            write_garden(target)
            return target
        if kind in (".obj", ".stl", ".xyz"):
            write_shed(target)
            return target
        if kind in ("sparse/0", "colmap") and place == "garden":
            self.made("room", ".ply")
            write_garden_model(
                self.folder / "cameras", self.made("garden", ".ply"), self.folder / "garden model"
            )
            return self.folder / "garden model"
        if kind in ("sparse/0", "colmap", "reference.csv", "surveyed_cameras.csv"):
            self.made("room", ".ply")
            return self.folder / ("cameras" if kind in ("sparse/0", "colmap") else "cameras.csv")
        if kind == ".key":
            target.write_bytes(bytes(range(32)))
            return target
        if kind == "pairs.csv":
            rows = [",".join(row.split()) for row in PAIRS.splitlines()]
            target.write_text("\n".join(["sx,sy,sz,wx,wy,wz", *rows, ""]))
            return target
        done = run([*self._command(place, kind, of), "-o", str(target), "-q"])
        assert done == 0, f"cannot make {target.name}"
        return target

    def _command(self, place: str, kind: str, of) -> list[str]:
        cameras = [str(self.folder / "cameras"), str(self.folder / "cameras.csv")]
        is_room = place == "room"
        match kind:
            case ".ply":
                size = ["--gaussians", str(ROOM_GAUSSIANS)]
                return ["demo-scene", *size, "--colmap", cameras[0], "--reference", cameras[1]]
            case ".splat" | ".spz":
                return ["export", of(".scene.npz")]
            case ".metric.scene.npz":
                how = ["--colmap", cameras[0], "--reference", cameras[1]] if is_room else ["--scale", "1"]
                return ["scale-align", of(".scene.npz"), *how]
            case ".scene.npz":
                return ["import-splat", of(".ply"), *(["--min-opacity", "0.1"] if is_room else [])]
            case ".metric.scene":
                return ["scale-align", of(".scene"), "--scale", "1"]
            case ".scene":
                return ["import-splat", of(".ply")]
            case ".voxels":
                return ["voxelize", of(".metric.scene"), "--size", SIZE]
            case ".bt":
                return ["export", of(".voxels.npz")]
            case ".voxels.npz" if place == "shed":
                return ["import-voxels", of(".obj"), "--size", "0.1", "--margin", "0.05"]
            case ".voxels.npz":
                return ["voxelize", of(".metric.scene.npz"), "--size", SIZE]
            case ".cover.npz":
                return ["merge", of(".voxels.npz"), "--hulls", "300"]
            case ".seen.npz":
                given = ["--voxels", of(".voxels.npz"), "--radius", "0.15"]
                return ["observe", of(".metric.scene.npz"), *given, "--colmap", cameras[0]]
            case ".certificate.json":
                given = ["--voxels", of(".voxels.npz"), "--scene", of(".metric.scene.npz")]
                return ["verify", of(".cover.npz"), *given]
            case ".plan.npz":
                points = ["0.8 0.8 1", "7 5.2 1.2"] if is_room else ["0 0 1", "4 2 1.2"]
                return [
                    "plan",
                    of(".cover.npz"),
                    "--start",
                    points[0],
                    "--goal",
                    points[1],
                    "--radius",
                    "0.25",
                ]
            case ".run.mcap":
                given = ["--filter", "cone-backup", "--speed", "3", "--set", "world.confidence=0.99"]
                return ["simulate", of(".metric.scene.npz"), *given, "--trials", "3"]
            case ".tiles":
                return ["export", of(".cover.npz"), "--tiles", "2", "--reach", "1.2", "--sign", of(".key")]
            case ".bin":
                return ["export", of(".cover.npz")]
        raise AssertionError(kind)


_KINDS = (
    *(".metric.scene.npz", ".scene.npz", ".voxels.npz", ".cover.npz", ".seen.npz", ".plan.npz"),
    *(
        ".metric.scene",
        ".scene",
        ".voxels",
        ".certificate.json",
        ".run.mcap",
        ".bin",
        ".ply",
        ".splat",
        ".spz",
        ".key",
        ".tiles",
        ".obj",
        ".stl",
        ".xyz",
        ".bt",
    ),
    *("sparse/0", "colmap", "surveyed_cameras.csv", "reference.csv", "pairs.csv"),
)
