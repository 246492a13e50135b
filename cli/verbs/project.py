"""A first project for a splat: what `init` chooses, and the files that it writes."""

from __future__ import annotations

import math
import os
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from alula.cli.verbs.project_files import MAKEFILE, README, SCENARIO
from alula.schemas.errors import AlulaError, CheckError, InfeasibleError, InputError, OutputError, UsageError

if TYPE_CHECKING:
    from alula.cli.verbs.results import Cover, Scene
    from alula.stages.planning.space import PlanSpace
    from alula.stages.reconstruction.import_splat import Screened
    from alula.stages.reconstruction.look import Up

HULLS = 300
MOST_VOXELS = 100_000  # of the chosen size: minutes of `merge`
NEEDED_M, _MOST_NEEDED = 0.1, 400_000  # a size at which doors stay open for the default vehicle [m]
FINEST_M = 0.05  # a third of the radius of the default vehicle [m]
_EDGES = 100  # voxels along the diagonal of a small thing, which may then be finer
_SIZES = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)  # times a power of ten
_BEYOND_M = 1.5  # around a thing without free space in its box, where flights go around it [m]
_ROOMY = 2.0  # extent of a map below which it is hardly larger than the vehicle [m]
_WIDE, _HIGH = 4.0, 1.5  # extents of a scene of unknown scale in which the default vehicle has room [m]

_LEAST = 20  # Gaussians of a scene
_KEPT = 0.9  # fraction of the Gaussians that haze and floaters must leave, else they stay
_KEEP_M = 0.25  # radius and margin of the default vehicle
_MARGINS_M = (0.1, 0.2, 0.3)  # of a plan, until the filter does not act along it [m]
LEARN_SCALE = (
    "a splat does not tell its scale; learn it from two points clicked in alula view, which shows their "
    "distance, and a tape measure (--metres-per-unit), from a known height (--height), or from COLMAP "
    "cameras with GPS or surveyed positions (alula scale-align --colmap --reference)"
)


@dataclass(frozen=True, slots=True)
class Choices:
    """All that a project fixes.

    Attributes:
        voxelizing: options of `voxelize` besides the size.
        beyond_m: distance around the mapped box that is assumed to be free [m].
        start_m, goal_m: of the plan [m].
        stand_m: where the rehearsed vehicle stands before it takes off [m].
        margin_m: distance that the plan keeps from the hulls beyond the vehicle's radius [m].
        assumed: sentences by subject.
        scale: metres per unit.
    """

    importing: str
    aligning: str
    voxelizing: str
    size_m: float
    beyond_m: float
    start_m: tuple[float, ...]
    goal_m: tuple[float, ...]
    stand_m: tuple[float, ...]
    margin_m: float
    assumed: dict[str, str]
    scale: float
    is_scale_assumed: bool


@dataclass(frozen=True, slots=True)
class Way:
    """Start and goal of a plan, where the vehicle stands, what is assumed to be free, and the margin [m]."""

    start_m: tuple[float, ...]
    goal_m: tuple[float, ...]
    stand_m: tuple[float, ...]
    beyond_m: float
    margin_m: float
    words: str


def folder_of(splat: Path, output: Path | None) -> Path:
    """The folder to write, which must be new or empty.

    Raises:
        OutputError: it cannot be made.
        UsageError: it has files.
    """
    name = re.sub(r"[^\w.-]", "-", splat.resolve().name.split(".")[0], flags=re.ASCII).strip("-.") or "scene"
    folder = output if output is not None else Path(name)
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: is a file, not a folder to write; -o names another")
    if folder.is_dir() and any(folder.iterdir()):
        raise UsageError(f"{folder}: is a folder with files, which are not replaced; -o names another")
    parent = folder.absolute().parent
    if not parent.is_dir() or not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(f"{folder}: the folder {parent} does not exist or is not writable")
    return folder


def look(
    splats: Sequence[Path],
    *,
    colmap: Path | None = None,
    up: str | None = None,
    metres_per_unit: float | None = None,
    height_m: float | None = None,
    lod: int | None = None,
    jobs: int = 0,
) -> Choices:
    """Look at a splat and choose; the map is made in memory, so that start and goal are free in it.

    Args:
        splats: its files and folders, in one frame.
        colmap: COLMAP model with cameras in its frame.
        up: axis that points up, such as "+z".
        height_m: height of all that is shown, instead of the scale [m].
        lod: level of detail of a streamed splat; the finest if None.

    Raises:
        UsageError: the scale is out of range or given twice.
        InputError: the splat or the model cannot be read.
        InfeasibleError: no way through the scene was found.
    """
    from alula.cli.verbs.merge import merge
    from alula.cli.verbs.voxelize import voxelize
    from alula.stages.reconstruction.look import crop_of, height_of

    if up is not None and colmap is not None:
        raise UsageError("--up and --colmap both tell up; give one of them")
    if metres_per_unit is not None and height_m is not None:
        raise UsageError("--metres-per-unit and --height both give the scale; give one of them")
    for name, value in (("--metres-per-unit", metres_per_unit), ("--height", height_m)):
        if value is not None and not (1e-6 <= value <= 1e6):
            raise UsageError(f"{name} must be between 1e-06 and 1e+06, not {value:g}")
    assumed: dict[str, str] = {}
    scene, importing = _imported(splats, lod, assumed)
    upward = _up(scene, colmap, up, assumed)
    height = height_of(scene.mean, upward.direction)
    scale = metres_per_unit
    if height_m is not None:
        if not height > 0:
            raise InputError(f"{splats[0]}: is flat, so that --height gives no scale")
        scale = float(f"{height_m / height:.6g}")
        assumed["scale"] = f"1 unit is {scale:g} m, because all that is shown is {height_m:g} m high"
    elif scale is not None:
        assumed["scale"] = (
            f"1 unit is {scale:g} m, as given; all that is shown is {height * scale:.3g} m high"
        )
    else:
        scale = _roomy(scene, height)
        assumed["scale"] = (
            f"ASSUMED, not known: 1 unit is {scale:g} m, so that all that is shown is {height * scale:.3g} m "
            "high"
        )
        if scale != 1:
            assumed["scale"] += (
                f"; at 1 m a unit it would be {height:.3g} m high, too small for the vehicle to fly in"
            )
    metric, aligning = _aligned(scene, upward, scale, assumed)
    del scene  # large, like the next one
    box = crop_of(metric.mean)
    voxelizing = ""
    fields: dict[str, Any] = {}
    if box is not None and (box[1] - box[0]).min() >= 6 * _KEEP_M:
        crop = _rounded((*box[0], *box[1]))
        voxelizing, fields["crop"] = "--crop " + " ".join(map(repr, crop)), crop
        assumed["crop"] = (
            f"nothing beyond the box {_words(crop)} m counts as an obstacle; {1 - box[2]:.1%} of the "
            f"Gaussians are outside"
        )
    else:
        assumed["crop"] = "none; the Gaussians lie close enough together"
    diagonal_m = math.dist(metric.mean.min(axis=0), metric.mean.max(axis=0))
    size = _size(metric, min(FINEST_M, diagonal_m / _EDGES), fields, jobs)
    voxels = voxelize(metric, size_m=size, jobs=jobs, **fields)
    assumed["voxels"] = (
        f"{size:g} m, {len(voxels.index):,} of them; coarser ones close narrow passages, finer ones take "
        f"longer (make VOXEL=...)"
    )
    cover = merge(voxels, hulls=HULLS, jobs=jobs)
    grown = cover.artifact.manifest.conservativeness  # type: ignore[attr-defined]
    assumed["hulls"] = (
        f"{HULLS}, with {grown:.3g} times the volume of the voxels; more of them are tighter (make HULLS=...)"
    )
    is_known = metres_per_unit is not None or height_m is not None
    way = undisturbed_way(cover, scale, assumed, is_scale_known=is_known, jobs=jobs)
    assumed["start, goal"] = f"{_words(way.start_m)} and {_words(way.goal_m)} m, {way.words}"
    assumed["vehicle"] = (
        f"of the plan and its rehearsal a quadrotor of radius 0.15 m with a margin of {way.margin_m:g} m, at "
        "most 1 m/s; the simulated flights move a point of the same radius by velocities, which polytope-cbf "
        "filters"
    )
    return Choices(
        importing, aligning, voxelizing, size, way.beyond_m, way.start_m, way.goal_m, way.stand_m,
        way.margin_m, assumed, scale, not is_known,
    )  # fmt: skip


def write_project(folder: Path, splats: Sequence[Path], chosen: Choices, trials: int) -> None:
    """Write the files of a project.

    Args:
        folder: new or empty.

    Raises:
        OutputError: a file cannot be written.
    """
    from alula.cli.shell.runner import make_escape
    from alula.schemas.atomic import write_text

    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made: {error.strerror}") from error
    relative = [Path(os.path.relpath(each.absolute(), folder.absolute())) for each in splats]
    values = {
        "NAME": folder.resolve().name,
        "SPLATS": " ".join(map(make_escape, relative)),
        "WORDS": shlex.join(map(str, relative)).replace("$", "$$"),
        "IMPORT": chosen.importing,
        "ALIGN": chosen.aligning,
        "VOXELIZE": chosen.voxelizing,
        "SIZE": f"{chosen.size_m:g}",
        "HULLS": str(HULLS),
        "TRIALS": str(trials),
        "MARGIN": f"{chosen.margin_m:g}",
        "BEYOND": f"{chosen.beyond_m:g}",
        "START": " ".join(map(repr, chosen.start_m)),
        "GOAL": " ".join(map(repr, chosen.goal_m)),
        "STAND": ",".join(map(repr, chosen.stand_m)),
        "ASSUMED": "\n".join(f"- **{name}**: {sentence}." for name, sentence in chosen.assumed.items())
        + (f"\n\nTo replace the assumed scale: {LEARN_SCALE}." if chosen.is_scale_assumed else ""),
    }
    for name, text in (("scenario.toml", SCENARIO), ("README.md", README), ("Makefile", MAKEFILE)):
        write_text(folder / name, re.sub(r"@(\w+)@", lambda match: values[match[1]], text))


def _imported(splats: Sequence[Path], lod: int | None, assumed: dict[str, str]) -> tuple[Scene, str]:
    """The scene, without haze and floaters where that leaves most of it, and the options that make it."""
    from alula.cli.shell.bar import shown
    from alula.cli.verbs.import_splat import SplatFiles
    from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
    from alula.stages.reconstruction.faint import FAINT

    files = SplatFiles(splats, lod=lod)
    fields: dict[str, Any] = {} if lod is None else {"lod": lod}

    def screened(**more: Any) -> Screened:
        with shown("import_splat") as progress:
            return files.screened(ImportSplatConfig(**fields, **more), progress)

    try:
        found = screened()
    except InputError as error:
        if "--drop-nan" not in str(error):
            raise
        fields["drop_nan"] = True
        found = screened()
        if found.kept < _KEPT * len(found.removal):
            raise
    if found.kept < _LEAST:
        raise InputError(
            f"{splats[0]}: {found.kept} Gaussians are no scene to fly in; alula info says what the file has"
        )
    is_cut = "drop_nan" in fields
    words = ([] if lod is None else [f"--lod {lod}"]) + (["--drop-nan"] if is_cut else [])
    total = len(found.removal) if is_cut else found.kept
    removed = [f"{total - found.kept:,} by --drop-nan and the minimum opacity"] if is_cut else []
    for option, more in (
        (f"--min-opacity {FAINT:g}", {"min_opacity": FAINT}),
        ("--drop-floaters", {"drop_floaters": True}),
    ):
        try:
            tried = screened(**more)
        except AlulaError:
            continue
        if tried.kept >= _KEPT * total:
            removed.append(f"{found.kept - tried.kept:,} by {option}")
            fields |= more
            words.append(option)
            found = tried
    assumed["left out"] = f"of {total:,} Gaussians " + (", ".join(removed) or "none")
    return files.scene(found), " ".join(words)


def _up(scene: Scene, colmap: Path | None, up: str | None, assumed: dict[str, str]) -> Up:
    from alula.schemas.artifacts.manifest import SceneManifest
    from alula.stages.reconstruction.look import convention_of, up_given, up_of, up_of_cameras

    if up is not None:
        found = up_given(up)
    elif colmap is None:
        manifest = scene.artifact.manifest
        assert isinstance(manifest, SceneManifest)
        found = up_of(scene.mean, convention_of(manifest.source))
    else:
        import numpy as np

        from alula.schemas.parameters.configs.scale_align import MIN_NEAR
        from alula.stages.alignment.colmap import read_model
        from alula.stages.alignment.model_frame import model_frame

        cameras = read_model(colmap)
        assert cameras.axes is not None  # of every COLMAP model
        assert cameras.landmarks is not None
        try:
            frame = model_frame(cameras.landmarks, lambda: np.asarray(scene.mean, np.float64), MIN_NEAR)
        except CheckError as error:
            raise CheckError(f"{error}; or give --up instead of --colmap") from error
        if frame.scene_from_model is not None:
            cameras = cameras.moved(frame.scene_from_model)
        if frame.warnings:
            assumed["cameras"] = "; ".join(frame.warnings)
        assert cameras.axes is not None
        found = up_of_cameras(cameras.axes)
    assumed["up"] = f"({_words(found.direction)}) in the frame of the splat: {found.why}"
    return found


def _aligned(scene: Scene, up: Up, scale: float, assumed: dict[str, str]) -> tuple[Scene, str]:
    """The scene in metres with z up, on its floor if there is one, and the options that make it."""
    from alula.cli.verbs.align import align
    from alula.cli.verbs.results import Scene

    words = f"--scale {scale!r} --up {' '.join(map(repr, up.direction))}"
    try:
        found, words = align(scene, scale=scale, up=up.direction, floor=True), f"{words} --floor"
        assumed["floor"] = "the level plane with most of the Gaussians near it; z = 0 lies there"
    except (CheckError, InputError):
        assumed["floor"] = "none was found; z = 0 is that of the splat"
        found = align(scene, scale=scale, up=up.direction)
    return Scene(found.artifact), words  # without the scene that it was made from


def _roomy(scene: Scene, height: float) -> float:
    """Metres per unit of a scene of unknown scale: 1, or the next round number at which the vehicle fits."""
    import numpy as np

    width = float(np.sort(np.ptp(np.percentile(scene.mean, (1, 99), axis=0), axis=0))[-1])
    least = max(_WIDE / max(width, 1e-6), _HIGH / max(height, 1e-6))
    rounds = (digit * 10.0**power for power in range(7) for digit in (1, 2, 5))
    return next((each for each in rounds if each >= least), 1.0)


def _size(scene: Scene, finest_m: float, fields: dict[str, Any], jobs: int) -> float:
    """Smallest size of voxels, at least `finest_m`, of which there are not too many.

    There are at most `MOST_VOXELS`; of the size that the vehicle needs to pass through a door, four times as
    many.
    """
    from alula.cli.verbs.voxelize import voxelize

    step = _step_of(max(finest_m, 1e-4))
    for size in map(_at, range(step, step + 40)):
        most = _MOST_NEEDED if size == NEEDED_M else MOST_VOXELS
        try:
            if len(voxelize(scene, size_m=size, jobs=jobs, max_voxels=most, **fields).index) <= most:
                return size
        except (InputError, InfeasibleError):  # too many; refused before the work where they are far too many
            continue
    raise InfeasibleError("no size of voxels leaves few enough of them; crop the splat in an editor first")


def _step_of(size_m: float) -> int:
    step = 0
    while _at(step) < size_m:
        step += 1
    while _at(step - 1) >= size_m:
        step -= 1
    return step


def _at(step: int) -> float:
    """The size with a number, 1.0, 1.5, 2.0, ... [m]."""
    power, digit = divmod(step, len(_SIZES))
    return float(f"{_SIZES[digit] * 10.0**power:.2g}")


def _ends(cover: Cover, margin_m: float, scale: float, *, is_scale_known: bool, jobs: int) -> Way:
    """Start, goal and place to stand of a plan that exists; around the map where there is no way in it."""
    import dataclasses

    from alula.schemas.parameters.configs.plan import PlanConfig
    from alula.stages.planning.ends import ends_of
    from alula.stages.planning.plan import resolve_plan
    from alula.stages.planning.space import plan_space

    config = resolve_plan(PlanConfig(interface="velocity", margin_m=margin_m))
    space = plan_space(config, cover=cover.artifact, jobs=jobs)
    failure: InfeasibleError | None = None
    for beyond in (0.0, _BEYOND_M):
        try:
            own = dataclasses.replace(config, beyond_map_m=beyond)
            found = ends_of(own, space, cover.artifact, jobs=jobs)
        except InfeasibleError as error:
            failure = error
            continue
        words = "two free points far apart with a way between them"
        if beyond:
            words += (
                f", around what was captured: ASSUMED, not known, is that nothing is within {beyond:g} m of "
                "the box around it"
            )
            if max(_extent(space)) < _ROOMY:
                words += "; it is hardly larger than the vehicle: is the scale right?"
        if not found.is_plain:
            words += "; not both are 0.5 to 2 m above the ground with room above them"
        return Way(found.start, found.goal, found.stand, beyond, margin_m, words)
    extent = " x ".join(f"{x:.3g}" for x in _extent(space))
    raise InfeasibleError(
        f"{failure}; the map is {extent} m at {scale:g} m a unit, and the vehicle with its margin "
        f"{2 * _KEEP_M:g} m wide{'' if is_scale_known else ': is the scale right (--metres-per-unit)?'}"
    )


def undisturbed_way(
    cover: Cover, scale: float, assumed: dict[str, str], *, is_scale_known: bool, jobs: int
) -> Way:
    """The way with the smallest margin along whose plan the filter does not act and leads nothing off it.

    Start and goal of a larger margin have more room. Where the filter always acts it is the first.

    Args:
        scale: metres per unit, for messages.
        assumed: sentences by subject; one about the distance is added.

    Raises:
        InfeasibleError: no way through the scene was found.
    """
    from alula.cli.verbs.plan import plan

    ways: list[Way] = []
    for margin in _MARGINS_M:
        try:
            way = _ends(cover, margin, scale, is_scale_known=is_scale_known, jobs=jobs)
        except InfeasibleError:
            if not ways:
                raise
            break
        ways.append(way)
        if way.beyond_m > ways[0].beyond_m:
            break
        try:
            found = plan(
                cover, start=way.start_m, goal=way.goal_m, interface="velocity", margin_m=margin,
                beyond_map_m=way.beyond_m, jobs=jobs,
            )  # fmt: skip
        except InfeasibleError:
            continue
        if not found.summary.get("notes"):
            if len(ways) > 1:
                keep = found.artifact.manifest.radius_m  # type: ignore[attr-defined]
                assumed["distance"] = (
                    f"the plan keeps {keep:g} m from the hulls, where the filter does not act"
                )
            return way
    assumed["distance"] = (
        f"the plan keeps {_KEEP_M:g} m from the hulls, and the filter acts along it: a flight may leave the "
        "plan's tube, and make fly-rehearsal then ends with exit code 4"
    )
    return ways[0]


def _extent(space: PlanSpace) -> list[float]:
    """Edges of the mapped box [m]."""
    box = space.box()
    return [0.0, 0.0, 0.0] if box is None else (box[1] - box[0]).tolist()


def _rounded(values: Any) -> tuple[float, ...]:
    return tuple(round(float(value), 3) for value in values)


def _words(values: Any) -> str:
    return " ".join(f"{value:g}" for value in values)
