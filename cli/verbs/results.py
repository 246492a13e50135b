"""Results of the library: artifacts in memory with what they were made from."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar, Union, cast

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from alula.cli.shell import runner
from alula.cli.verbs.display import table
from alula.schemas.artifacts.artifact import Artifact, artifact_hash, file_hash, write_artifact
from alula.schemas.artifacts.kinds import COVER, PLAN, SCENE, SEEN, VOXELS, Kind
from alula.schemas.artifacts.manifest import CoverManifest, InputRef, LevelManifest, Manifest
from alula.schemas.artifacts.parts import Parts, open_parts
from alula.schemas.artifacts.parts_join import read_whole
from alula.schemas.artifacts.provenance import of_manifest
from alula.schemas.errors import InfeasibleError, InputError, OutputError, WrongKindError

_Ints = NDArray[np.signedinteger[Any]]
_Floats = NDArray[np.floating[Any]]
_Path = str | Path
Source = Union["Result", str, Path]


@dataclass(frozen=True, slots=True)
class File:
    """A file that a result was made from, as it was when it was read."""

    path: Path
    state: tuple[int, ...]

    @classmethod
    def at(cls, path: Path) -> File:
        """The file as it is now."""
        return cls(path, runner.state_of(runner.index_of(path)))

    def read(self, kind: Kind) -> Artifact:
        """The artifact in the file; one in parts is joined.

        Raises:
            InputError: it cannot be read.
            WrongKindError: it is of another kind.
        """
        return read_whole(self.path, kind)

    def parts(self, kind: Kind) -> Parts:
        """The artifact as parts, which are read one at a time.

        Raises:
            InputError: it cannot be read.
            WrongKindError: it is of another kind.
        """
        return open_parts(self.path, kind)

    def is_unchanged(self) -> bool:
        """Whether the file is as it was."""
        return runner.state_of(runner.index_of(self.path)) == self.state

    def ref(self, role: str) -> InputRef:
        """Reference for a manifest.

        Raises:
            InputError: the file has changed since, or cannot be read.
        """
        if not self.is_unchanged():
            raise InputError(f"{self.path}: changed since it was read; read it again")
        return runner.input_ref(role, self.path)


class Result:
    """An artifact in memory; its arrays are attributes, without copies, read-only where a file backs them.

    `save` writes the file that the command would write from the same inputs and parameters. A result that was
    not saved is recorded as an input of others by its contents alone; save it first to record its name too.
    """

    KIND: ClassVar[Kind]
    artifact: Artifact

    def __init__(
        self,
        artifact: Artifact,
        inputs: Mapping[str, Result | File] | None = None,
        *,
        seed: int | None = None,
        file: File | None = None,
    ) -> None:
        self.artifact = artifact
        self._inputs = inputs
        self._seed = seed
        self._file = file
        self._is_read = file is not None

    def read(self, kind: Kind) -> Artifact:
        """The artifact.

        Raises:
            WrongKindError: it is of another kind.
        """
        if self.KIND is not kind:
            raise WrongKindError(f"a result is {self.KIND.name}, but {kind.name} is needed")
        return self.artifact

    def parts(self, kind: Kind) -> Parts:
        """The artifact as one part.

        Raises:
            WrongKindError: it is of another kind.
        """
        return Parts.of(self.read(kind))

    @property
    def manifest(self) -> Manifest:
        """The manifest with the provenance that `save` writes."""
        return self._stamped().manifest

    @property
    def summary(self) -> dict[str, Any]:
        """Figures by name, those that the command prints."""
        return self.artifact.manifest.summary

    @property
    def parameters(self) -> dict[str, Any]:
        """All parameters, defaults included."""
        return self.artifact.manifest.parameters

    @property
    def guarantee(self) -> str:
        """What holds for the content, in a sentence; empty where nothing does."""
        found = self.artifact.manifest.guarantee
        return "" if found is None else found.statement

    @property
    def notes(self) -> list[str]:
        """Notes and warnings, which the command prints too."""
        return [*self.summary.get("notes", ()), *self.summary.get("warnings", ())]

    def save(self, path: _Path, *, force: bool = False) -> Self:
        """Write the file that the command would write; one that is current already stays as it is.

        Args:
            path: the file, which ends in .npz.
            force: replace a file of other provenance.

        Raises:
            UsageError: a file of other provenance is there.
            OutputError: the file cannot be written.
            InputError: an input has changed since it was read.
        """
        target = _path(path)
        runner.check_array_name(target, self.KIND)
        inputs = self._inputs or {}
        runner.check_output(target, {role: one.path for role, one in inputs.items() if isinstance(one, File)})
        artifact = self._stamped()
        if runner.current(target, of_manifest(artifact.manifest), force=force) is None:
            write_artifact(target, artifact)
        self.artifact, self._inputs, self._file = artifact, None, File.at(target)
        return self

    def ref(self, role: str) -> InputRef:
        """Reference to this result for the manifest of another.

        Raises:
            InputError: its file has changed since it was read.
        """
        manifest = self.artifact.manifest
        if self._is_as_in_file():
            assert self._file is not None
            return runner.input_ref(role, self._file.path)
        if self._is_read:
            assert self._file is not None
            return self._file.ref(role)  # says that it has changed
        return InputRef(role, manifest.schema, manifest.version, self._hash(), "")

    def origins(self) -> list[InputRef]:
        """References to this result and to what it was made from in memory, in its frame in metres."""
        found: list[InputRef] = []
        waiting: list[tuple[str, Result]] = [(self.KIND.name.removeprefix("alula/"), self)]
        while waiting:
            role, one = waiting.pop()
            found.append(one.ref(role))
            if not isinstance(one, Scene):  # its origins have another frame
                waiting += [(name, of) for name, of in (one._inputs or {}).items() if isinstance(of, Result)]
        return found

    def folders(self) -> list[Path]:
        """Folders of the files of this result and of what it was made from in memory."""
        inputs = (self._inputs or {}).values()
        above = [folder for one in inputs if isinstance(one, Result) for folder in one.folders()]
        return ([] if self._file is None else [self._file.path.parent]) + above

    def _is_as_in_file(self) -> bool:
        """Whether there is a file with this result; commands touch a file that they find current."""
        if self._file is None:
            return False
        if not self._file.is_unchanged():
            now = File.at(self._file.path)
            if not now.path.is_file() or file_hash(now.path) != self._hash():
                return False
            self._file = now
        return True

    def _hash(self) -> str:
        return artifact_hash(self._stamped())

    def _stamped(self) -> Artifact:
        """The artifact with its inputs in the manifest."""
        if self._inputs is None:  # the manifest has them
            return self.artifact
        refs = sorted(one.ref(role) for role, one in self._inputs.items())
        manifest = msgspec.structs.replace(self.artifact.manifest, inputs=refs, seed=self._seed)
        return Artifact(manifest, self.artifact.arrays)

    def path_in(self, folder: Path, name: str) -> Path:
        """Path of a file with this result: its own, or one that is written into a folder.

        Args:
            folder: for results that were not saved.
            name: of the file there, without the suffix of its kind.
        """
        if self._is_as_in_file():
            assert self._file is not None
            return self._file.path
        path = folder / f"{name}{self.KIND.suffix}"
        write_artifact(path, self._stamped())
        return path

    def __getattr__(self, name: str) -> Any:
        if not name.startswith("_") and name != "artifact" and name in self.artifact.arrays:
            return self.artifact.arrays[name]
        raise AttributeError(f"{type(self).__name__!r} has no attribute {name!r}")

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self.artifact.arrays})

    def __repr__(self) -> str:
        return f"{type(self).__name__}: {self._line()}"

    def _line(self) -> str:
        raise NotImplementedError

    def _repr_html_(self) -> str:
        return table(repr(self), runner.facts(self.summary), self.notes)


class Scene(Result):
    """A scene: Gaussians with their ellipsoids, in metres once it is aligned."""

    KIND = SCENE
    mean: _Floats
    scale: _Floats
    quat_wxyz: _Floats
    opacity: _Floats
    color: NDArray[np.uint8]
    loss: _Floats

    def _line(self) -> str:
        manifest = self.artifact.manifest
        is_metric = manifest.unit == "m"
        low, high = (np.array(self.summary[key + "_m" * is_metric]) for key in ("lower", "upper"))
        extent = " x ".join(f"{x:.3g}" for x in high - low)
        unit = f"m, frame {manifest.frame}" if is_metric else "units without metric scale"
        return f"{len(self.artifact['mean']):,} Gaussians, {extent} {unit}"


class Voxels(Result):
    """Voxels that an obstacle touches."""

    KIND = VOXELS
    index: _Ints
    overlap: NDArray[np.uint32]

    def _line(self) -> str:
        manifest = cast(LevelManifest, self.artifact.manifest)
        obstacles = (
            f"of {'an' if manifest.imported.kind == 'octree' else 'a'} {manifest.imported.kind}"
            if manifest.imported is not None
            else f"ellipsoids at {manifest.sigma:.3g} sigma"
        )
        return (
            f"{len(self.artifact['index']):,} occupied of edge {manifest.voxel_size_m:g} m, "
            f"{self.summary['volume_m3']:.3g} m^3, {obstacles}"
        )


class Seen(Result):
    """Voxels that cameras saw to be free and that a vehicle can reach."""

    KIND = SEEN
    index: _Ints
    views: NDArray[np.uint16]

    def _line(self) -> str:
        manifest = cast(LevelManifest, self.artifact.manifest)
        return f"{len(self.artifact['index']):,} free of edge {manifest.voxel_size_m:g} m"


class Cover(Result):
    """Convex polytopes that contain all occupied voxels."""

    KIND = COVER
    vertex: _Ints
    vertex_start: _Ints
    plane_normal: _Ints
    plane_offset: _Ints
    plane_start: _Ints
    member_index: _Ints
    member_start: _Ints
    history: _Floats

    def _line(self) -> str:
        manifest = cast(CoverManifest, self.artifact.manifest)
        facts, growth = self.summary, manifest.conservativeness
        return (
            f"{facts['hulls']:,} hulls, {facts['half_planes']:,} half-planes, volume {growth:.3g} times the "
            f"voxels'; contains all {facts['voxels']:,} voxels"
        )

    def free_points(self, count: int, *, seed: int = 0, jobs: int = 0, **fields: Any) -> _Floats:
        """Free points, far from one another, to choose start and goal of a plan from.

        Args:
            count: how many.
            seed: of the draw.
            jobs: threads; 0 is all processors.
            **fields: parameters of `plan`, such as `radius_m`.

        Returns:
            Shape (count, 3), world frame [m].

        Raises:
            InfeasibleError: there are fewer.
        """
        from alula.cli.verbs.keywords import configured
        from alula.schemas.parameters.configs.plan import PlanConfig
        from alula.stages.planning.endpoints import free_points
        from alula.stages.planning.plan import resolve_plan
        from alula.stages.planning.space import plan_space

        config = resolve_plan(configured("free_points", PlanConfig, fields))
        space = plan_space(config, cover=self.artifact, jobs=jobs)
        return free_points(config, space, count, seed=seed)


class Plan(Result):
    """A trajectory of polynomial pieces."""

    KIND = PLAN
    time: _Floats
    coefficient: _Floats
    waypoint: _Floats
    cell_normal: _Floats
    cell_offset: _Floats
    cell_start: _Ints
    piece_cell: _Ints

    def _line(self) -> str:
        facts, clear = self.summary, self.summary.get("min_clearance_m")
        speed = f"at most {facts['max_speed_m_s']:.3g} m/s"
        line = f"{facts['length_m']:.3g} m in {facts['duration_s']:.3g} s, {speed}"
        return line + (f", {clear:.3g} m from the nearest obstacle" if clear is not None else "")

    def at(self, time_s: ArrayLike, derivative: int = 0) -> _Floats:
        """Position and heading at given times, or a derivative.

        Args:
            time_s: times from the start, any shape [s].
            derivative: 0 position, 1 velocity, 2 acceleration, ...

        Returns:
            Shape (..., 4): x, y, z, yaw in the world frame [m, rad], divided by s^derivative.
        """
        from alula.stages.planning.trajectory import evaluate

        return evaluate(self.artifact["time"], self.artifact["coefficient"], time_s, derivative)


R = TypeVar("R", bound=Result)
RESULTS: dict[str, type[Result]] = {one.KIND.name: one for one in (Scene, Voxels, Seen, Cover, Plan)}


@contextmanager
def on_disk(name: str = "alula-") -> Iterator[Path]:
    """Context with a folder for results that were not saved.

    Args:
        name: how its own name begins.
    """
    with tempfile.TemporaryDirectory(prefix=name, ignore_cleanup_errors=sys.platform == "win32") as folder:
        yield Path(folder)


def source_of(given: Result | _Path) -> Result | File:
    """A result itself, or the file at a path, which is read when it is needed.

    Raises:
        TypeError: it is neither.
    """
    return given if isinstance(given, Result) else File.at(_path(given))


@contextmanager
def named(source: Result | File) -> Iterator[None]:
    """Context whose errors name the file that was read.

    Args:
        source: a file, or a result, which has no name.

    Raises:
        InputError, InfeasibleError: those of the work, after the path of the file if they do not begin so.
    """
    try:
        yield
    except (InputError, InfeasibleError) as error:
        is_named = isinstance(source, Result) or str(error).startswith(str(source.path))
        if is_named or isinstance(error, OutputError):
            raise
        raise error.reworded(f"{source.path}: {error}") from error


def _path(given: _Path) -> Path:
    if not isinstance(given, str | Path):
        raise TypeError(f"a path or a result is needed, not {type(given).__name__}")
    return Path(given).expanduser()
