"""`import-voxels`: a mesh, a cloud or an OctoMap, and the voxels that it touches."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from alula.cli.verbs.keywords import configured
from alula.cli.verbs.results import File, Voxels
from alula.cli.verbs.verb import Step, verb
from alula.schemas.errors import InfeasibleError, InputError
from alula.schemas.parameters.configs.import_voxels import ImportVoxelsConfig
from alula.schemas.progress import Progress

if TYPE_CHECKING:
    from alula.schemas.artifacts.artifact import Artifact
    from alula.schemas.parameters.keywords import ImportVoxelsFields


@verb(ImportVoxelsConfig)
def import_voxels(source: str | Path, *, jobs: int = 0, **fields: Unpack[ImportVoxelsFields]) -> Step[Voxels]:
    """Mark every voxel that a mesh, a point cloud or the octree of an OctoMap touches.

    Args:
        source: the file.
        jobs: threads; 0 is all processors.
        **fields: as in the signature.

    Raises:
        InputError: the file cannot be read, a mesh is not watertight, or there are far more voxels than
            `max_voxels`.
        InfeasibleError: nothing of it touches the crop.
    """
    config = configured("import_voxels", ImportVoxelsConfig, fields)
    path = Path(source).expanduser()

    def build(progress: Progress) -> Artifact:
        from alula.stages.compression.import_voxels import import_voxels as stage
        from alula.stages.compression.imported_files import read_imported

        found = read_imported(path)
        try:
            return stage(config, found, jobs=jobs, progress=progress)
        except (InputError, InfeasibleError) as error:
            raise error.reworded(f"{path}: {error}") from error

    return Step(Voxels, config, {"source": File.at(path)}, build)
