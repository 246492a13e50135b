"""`observe`: the space that cameras saw to be free and that a vehicle can reach."""

from __future__ import annotations

import dataclasses
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from alula.cli.shell.interruption import handlers_kept
from alula.cli.verbs.keywords import configured
from alula.cli.verbs.results import File, Result, Seen, Source, source_of
from alula.cli.verbs.verb import Step, verb
from alula.schemas.artifacts.kinds import SCENE, VOXELS
from alula.schemas.errors import InputError, UsageError
from alula.schemas.files import text_of
from alula.schemas.parameters.configs.config import flags_of
from alula.schemas.parameters.configs.observe import ObserveConfig
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.schemas.progress import Progress

if TYPE_CHECKING:
    from alula.schemas.artifacts.artifact import Artifact
    from alula.schemas.parameters.keywords import ObserveFields
    from alula.stages.planning.pinholes import Pinholes


@verb(ObserveConfig)
def observe(
    scene: Source,
    *,
    colmap: str | Path | None = None,
    cameras: str | Path | None = None,
    nerfstudio: str | Path | None = None,
    voxels: Source | None = None,
    vehicle: str | Path | None = None,
    jobs: int = 0,
    **fields: Unpack[ObserveFields],
) -> Step[Seen]:
    """Mark the space that cameras saw to be free and that a vehicle can reach.

    Args:
        scene: in metres, of `align`.
        colmap: COLMAP model (folder) with cameras in the frame of the splat's file.
        cameras: CSV of cameras in that frame, with their intrinsics.
        nerfstudio: run folder; the cameras are in the frame of its source poses.
        voxels: the obstacles, of the scene; their level is used.
        vehicle: that must be able to go there, a built-in one by its name, or a file.
        jobs: threads; 0 is all processors.
        **fields: as in the signature.

    Raises:
        UsageError: options contradict one another.
        InputError: a file cannot be read, or the voxels are of another scene.
        InfeasibleError: no camera sees a voxel, or there is no room for the vehicle.
    """
    from alula.schemas.scenarios.vehicles import vehicle_named
    from alula.stages.alignment import colmap as models
    from alula.stages.alignment import nerfstudio as training
    from alula.stages.planning.observe import observe as stage

    config = configured("observe", ObserveConfig, fields)
    given = {"--colmap": colmap, "--cameras": cameras, "--reach": config.reach}
    kinds = [name for name, value in given.items() if value is not None]
    if len(kinds) != 1:
        raise UsageError(f"exactly one of {', '.join(given)} is needed, not {' and '.join(kinds) or 'none'}")
    if nerfstudio is not None and config.reach is not None:
        raise UsageError("--nerfstudio goes with --colmap or --cameras")
    if colmap is None and "min_near" in fields:
        raise UsageError("--min-near goes with --colmap")
    if config.radius_m is not None and vehicle is not None:
        raise UsageError("--radius is that of the vehicle; leave out --vehicle")
    for level in dataclasses.fields(VoxelizeConfig) if voxels is not None else ():
        if level.name in fields:
            raise UsageError(f"the level is that of --voxels; leave out {flags_of(level)[0]}")
    source = source_of(scene)
    obstacles = None if voxels is None else source_of(voxels)
    model, table, run = (None if one is None else Path(one) for one in (colmap, cameras, nerfstudio))
    files: dict[str, Path] = {}
    if config.radius_m is None:
        flown, files = vehicle_named(vehicle)
        config = dataclasses.replace(config, radius_m=flown.body.radius_m)
    if model is not None:
        with handlers_kept(), suppress(ImportError):  # the stage says that it is not installed
            import pycolmap  # noqa: F401
        files = files | {f"colmap {part}": path for part, path in models.model_files(model).items()}
    if table is not None:
        files = files | {"cameras": table}
    if run is not None:
        files = files | training.transform_files(run)
    inputs: dict[str, Result | File] = {"scene": source}
    inputs |= {role: File.at(path) for role, path in files.items()}
    inputs |= {} if obstacles is None else {"voxels": obstacles}

    def build(progress: Progress) -> Artifact:
        metric = source.read(SCENE)
        marked = None if obstacles is None else obstacles.read(VOXELS)
        if marked is not None and obstacles is not None:
            recorded = next((ref for ref in marked.manifest.inputs if ref.role == "scene"), None)
            if recorded is not None and recorded.sha256 != source.ref("scene").sha256:
                where = f"{obstacles.path}: was" if isinstance(obstacles, File) else "the voxels were"
                raise InputError(f"{where} made from another scene, {recorded.name}")
        found = None if config.reach is not None else _pinholes(model, table, run)
        return stage(config, metric, found, marked, jobs=jobs, progress=progress)

    return Step(Seen, config, inputs, build)


def _pinholes(colmap: Path | None, cameras: Path | None, nerfstudio: Path | None) -> Pinholes:
    """Read the cameras, in the frame that the scene was trained in."""
    from alula.stages.alignment import nerfstudio as training
    from alula.stages.alignment.similarity import inverse
    from alula.stages.alignment.tables import parse_pinholes
    from alula.stages.planning.pinholes import Pinholes, read_pinholes

    if colmap is not None:
        found = read_pinholes(colmap)
    else:
        assert cameras is not None
        found = Pinholes(*parse_pinholes(text_of(cameras), cameras.name))
    if nerfstudio is None:
        return found
    path = training.transform_files(nerfstudio)["nerfstudio"]
    frame = training.parse_training_frame(text_of(path), path.name)
    return found.moved(inverse(frame.original_from_training))
