"""`demo-scene`: the built-in scene and its cameras, in files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from alula.cli.shell import runner
from alula.cli.shell.options import Common
from alula.schemas.artifacts.manifest import VERSION
from alula.schemas.artifacts.provenance import Provenance, parameters_of
from alula.schemas.atomic import atomic_output, write_text
from alula.schemas.errors import OutputError, UsageError
from alula.schemas.parameters.configs.demo_scene import DemoSceneConfig
from alula.schemas.progress import Progress
from alula.stages.reconstruction.demo_cameras import colmap_model, demo_cameras, positions_csv
from alula.stages.reconstruction.demo_scene import demo_scene
from alula.stages.reconstruction.formats.ply import encode_ply
from alula.stages.reconstruction.formats.splats import Splats
from alula.stages.reconstruction.room import hoop_centres

SCHEMA = "alula/demo-scene"


def write_scene(
    config: DemoSceneConfig,
    common: Common,
    *,
    colmap: Path | None = None,
    cameras: Path | None = None,
    reference: Path | None = None,
) -> None:
    """Write the scene as a PLY file, and its cameras as a COLMAP model and as CSV files.

    Raises:
        UsageError: two outputs are the same file, or the output does not end in .ply.
        OutputError: a file cannot be written.
    """
    if common.output.suffix.lower() != ".ply":
        raise UsageError(f"{common.output}: the output must end in .ply")
    sides = [path for path in (cameras, reference) if path is not None]
    if len({path.absolute() for path in (*sides, common.output)}) <= len(sides):
        raise UsageError("--output, --cameras and --reference must be different files")
    for path in sides:
        runner.check_output(path, {})
    if colmap is not None and colmap.absolute() in {path.absolute() for path in (*sides, common.output)}:
        raise UsageError(f"{colmap}: --colmap is a folder, which is also an output file")
    if colmap is not None and colmap.exists() and not colmap.is_dir():
        raise OutputError(f"{colmap}: is a file, but --colmap is a folder to write")
    walk = demo_cameras(config.images, common.seed)

    def missing() -> bool:
        model = [colmap / name for name in ("cameras.txt", "images.txt", "points3D.txt")] if colmap else []
        return not all(path.is_file() for path in (*sides, *model))

    def write_sides(splats: Splats) -> None:
        if cameras is not None:
            write_text(cameras, positions_csv(walk.names, walk.centre_scene))
        if reference is not None:
            write_text(reference, positions_csv(walk.names, walk.reference_world))
        if colmap is not None:
            try:
                colmap.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise OutputError(f"{colmap}: cannot make the folder: {error.strerror}") from error
            for name, text in colmap_model(walk, splats, common.seed).items():
                write_text(colmap / name, text)

    def make(provenance: Provenance, progress: Progress) -> tuple[Callable[[], None], dict[str, Any]]:
        splats = demo_scene(config, common.seed)
        summary = {
            "gaussians": len(splats),
            "images": len(walk.names),
            "hoop_centres_m": [" ".join(f"{x:g}" for x in centre) for centre in hoop_centres()],
        }

        def write() -> None:
            write_sides(splats)  # the .ply is the target of a Makefile rule: it comes last
            with atomic_output(common.output) as file:
                for part in encode_ply(splats, [provenance.line(summary)]):
                    file.write(part)

        return write, summary

    parameters = parameters_of(config)
    runner.run(common, SCHEMA, VERSION, parameters, {}, make, seed=common.seed)
    if not common.dry_run and missing():  # the .ply existed already, but not all of the other files
        write_sides(demo_scene(config, common.seed))
