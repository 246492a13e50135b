"""`alula scale-align`."""

from __future__ import annotations

import dataclasses
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli import grouped, options, parted, runner
from alula.cli.alignment_table import show_alignment
from alula.cli.interruption import handlers_kept
from alula.cli.options import PATH, Common, Numbers, NumbersOption
from alula.cli.present import print_json
from alula.schemas.configs.scale_align import Distance, ScaleAlignConfig
from alula.schemas.errors import UsageError
from alula.schemas.files import text_of
from alula.schemas.progress import Progress
from alula.schemas.provenance import Provenance, parameters_of

if TYPE_CHECKING:
    from alula.schemas.parts import Parts
    from alula.schemas.parts_output import PartsWriter
    from alula.stages.alignment.align_parts import PartsAligner
    from alula.stages.alignment.evidence import Correspondences
    from alula.stages.alignment.nerfstudio import TrainingFrame
    from alula.stages.alignment.scale_align import Evidence

EXAMPLES = """\b
Examples:
  alula scale-align room.scene.npz -o metric.scene.npz --colmap sparse/0 --reference poses.csv --max-rms 0.02
  alula scale-align room.scene.npz -o metric.scene.npz --distance "0 0 0" "1 0 0" 2.5 --up "0 -1 0" --floor
  alula scale-align city.scene -o metric.scene --transform utm.json"""


@dataclasses.dataclass(frozen=True, slots=True)
class Files:
    """Files with the evidence for the alignment, one field per option."""

    colmap: Path | None = None
    cameras: Path | None = None
    reference: Path | None = None
    poses: Path | None = None
    nerfstudio: Path | None = None
    correspondences: Path | None = None
    cloud: Path | None = None
    initial: Path | None = None
    transform: Path | None = None

    def inputs(self) -> dict[str, Path]:
        """All files by role; a model or run folder has several."""
        from alula.stages.alignment import colmap, nerfstudio

        single = ("cameras", "reference", "poses", "correspondences", "cloud", "initial", "transform")
        found = {role: path for role in single if (path := getattr(self, role)) is not None}
        if self.colmap is not None:
            found |= {f"colmap {part}": path for part, path in colmap.model_files(self.colmap).items()}
        if self.nerfstudio is not None:
            found |= nerfstudio.transform_files(self.nerfstudio)
        return found


@grouped.command("scale-align", epilog=EXAMPLES)
@click.argument("scene", type=options.input_path())
@click.option("--colmap", type=PATH, help="COLMAP model (folder) with cameras in the scene's frame.")
@click.option("--cameras", type=PATH, help="CSV image,x,y,z of cameras in the scene's frame.")
@click.option(
    "--reference",
    type=PATH,
    help="CSV of the same cameras in the world: image,x,y,z [m] or image,lat,lon,alt.",
)
@grouped.option(
    "--poses",
    group="Cameras",
    type=PATH,
    help="CSV image,x,y,z,qw,qx,qy,qz: camera to world, axes x right, y down, z forward (OpenCV, COLMAP); "
    "--cameras then needs them too.",
)
@grouped.option(
    "--nerfstudio",
    group="Cameras",
    type=PATH,
    help="Run folder or dataparser_transforms.json: map the scene back to the frame of the source poses; "
    "--colmap or --cameras are then in that frame.",
)
@grouped.option(
    "--correspondences", group="Points", type=PATH, help="CSV sx,sy,sz,wx,wy,wz of points in both frames."
)
@click.option(
    "--distance",
    "distances",
    type=Numbers(7),
    cls=NumbersOption,
    multiple=True,
    metavar="'X Y Z' 'X Y Z' METRES",
    help="Two points of the scene and their distance; repeatable; determines the scale alone.",
)
@grouped.option(
    "--cloud", group="Points", type=PATH, help="Surveyed cloud [m]: PLY, PCD, XYZ, PTS or .npz (points)."
)
@grouped.option(
    "--initial",
    group="Points",
    type=PATH,
    help="First guess for --cloud, a file like that of --transform; cameras or --correspondences can replace "
    "it; default: the identity.",
)
@click.option("--transform", type=PATH, help="JSON: 4x4 matrix, or scale, rotation and translation_m.")
@options.from_config(ScaleAlignConfig)
@options.output(".scene.npz, or a folder .scene")
@click.pass_context
def command(
    context: click.Context,
    /,
    scene: Path,
    distances: tuple[tuple[float, ...], ...],
    config: ScaleAlignConfig,
    common: Common,
    **paths: Path | None,
) -> None:
    """Give a scene metric scale and a named world frame.

    Give one kind of evidence: --colmap or --cameras with --reference or --poses, --nerfstudio,
    --correspondences, --distance, --cloud, --transform or --scale. The alignment is checked before
    anything is written. The 3D points of --colmap show whether its cameras are in the frame of the splat. A
    scene that is aligned already may be aligned again, or only levelled.

    A scene in parts gives a folder of parts, -o NAME.scene: one similarity for all parts. Memory then holds
    300 bytes per Gaussian of a part per job, and 24 bytes for each of at most 4,194,304 centres, evenly
    chosen, where --floor or --cloud compares them. An output .npz takes 300 bytes per Gaussian of the scene.
    """
    from alula.schemas.artifact import Artifact
    from alula.schemas.kinds import SCENE
    from alula.schemas.manifest import Manifest
    from alula.schemas.parts import open_parts
    from alula.schemas.parts_join import read_whole
    from alula.stages.alignment.align_parts import PartsAligner
    from alula.stages.alignment.scale_align import scale_align
    from alula.stages.progress import share

    pairs: tuple[Distance, ...] = tuple(
        ((a, b, c), (d, e, f), metres) for a, b, c, d, e, f, metres in distances
    )
    config = dataclasses.replace(config, distances=pairs)
    files = Files(**paths)
    if files.colmap is not None or files.reference is not None:
        with handlers_kept(), suppress(ImportError):  # the stages say that it is not installed
            import pycolmap  # noqa: F401
    check_evidence(config, files)
    for name, option, path, needed in (
        ("min_fitness", "--min-fitness", files.cloud, "--cloud"),
        ("max_angle_deg", "--angle-threshold", files.poses, "--poses"),
        ("min_near", "--min-near", files.colmap, "--colmap"),
        ("min_matched", "--min-matched", files.reference or files.poses, "--reference or --poses"),
    ):
        if path is None and options.is_given(context, name):
            raise UsageError(f"{option} goes with {needed}")
    inputs = {"scene": scene} | files.inputs()

    shown: list[dict[str, Any]] = []

    def report(alignment: dict[str, Any]) -> None:
        shown.append(alignment)
        if not (common.quiet or common.json):
            show_alignment(alignment, common.verbose)

    def build(progress: Progress) -> Artifact:
        return scale_align(config, read_whole(scene, SCENE), evidence_of(config, files), common.seed, report)

    def build_parts(writer: PartsWriter, recorded: Provenance, progress: Progress) -> Manifest:
        half = share(progress, 0, 0.5), share(progress, 0.5, 1)
        parts = open_parts(scene, SCENE)
        found = evidence_of(config, files)
        aligner = PartsAligner(config, parts, found, common.seed, report, common.jobs, half[0])
        align_parts(aligner, parts, writer, common.jobs, half[1])
        return writer.whole(recorded, **aligner.whole(writer.manifests))

    def run(common: Common) -> None:
        if parted.is_parted(common.output, SCENE.folder_suffix):
            parameters = parameters_of(config)
            parted.run_parts(common, SCENE, parameters, inputs, build_parts, seed=common.seed)
        else:
            runner.run_stage(common, SCENE, config, inputs, build, seed=common.seed)

    if not common.json:
        run(common)
        return
    # Print the whole record, not only the summary that every command prints.
    run(dataclasses.replace(common, json=False, quiet=True))
    status = "unchanged" if not shown else "dry-run" if common.dry_run else "written"
    answer: dict[str, Any] = {"output": str(common.output), "status": status}
    if status == "dry-run":
        print_json({**answer, "alignment": shown[0]})
        return
    manifest = open_parts(common.output, SCENE).manifest
    print_json({**answer, "summary": manifest.summary, "alignment": _recorded(manifest)})


def align_parts(
    aligner: PartsAligner, parts: Parts, writer: PartsWriter, jobs: int, progress: Progress | None
) -> None:
    """Map and write each part that an interrupted run has not finished.

    Args:
        aligner: of the scene.
        parts: of the scene.
        writer: of the aligned scene.
        jobs: threads, each with one part.
        progress: called with (done, total) parts.
    """
    import msgspec

    from alula.schemas.artifact import Artifact, file_hash
    from alula.schemas.kinds import SCENE
    from alula.schemas.manifest import InputRef
    from alula.schemas.parts_output import WrittenPart, kept_part, part_name, write_part
    from alula.stages.distribute import distribute

    def work(number: int) -> WrittenPart:
        ref = parts.refs[number]
        name = ref.file if parts.is_folder else part_name(SCENE, 0)
        if (kept := kept_part(writer.folder, name, SCENE)) is not None:
            return kept
        part = aligner.part(number)
        sha256 = ref.sha256 if parts.is_folder else file_hash(parts.path)
        source = InputRef("scene", SCENE.name, SCENE.version, sha256, parts.file(number).name)
        manifest = msgspec.structs.replace(part.manifest, inputs=[source])
        return write_part(writer.folder, name, Artifact(manifest, part.arrays))

    for done, made in enumerate(distribute(work, range(len(parts)), jobs=jobs)):
        writer.take(made)
        if progress is not None:
            progress(done + 1, len(parts))


def _recorded(manifest: Any) -> dict[str, Any]:
    found: dict[str, Any] = manifest.alignment
    return found


def check_evidence(config: ScaleAlignConfig, files: Files) -> None:
    """Refuse combinations of options that are contradictory, redundant or incomplete.

    Args:
        config: of the alignment.
        files: with the evidence.

    Raises:
        UsageError: there is such a combination.
    """
    given = {
        "--colmap": files.colmap, "--cameras": files.cameras, "--correspondences": files.correspondences,
        "--distance": config.distances or None, "--cloud": files.cloud, "--transform": files.transform,
        "--scale": config.scale,
    }  # fmt: skip
    kinds = [name for name, value in given.items() if value is not None]
    cameras = [name for name in kinds if name in ("--colmap", "--cameras")]
    known = [name for name, path in (("--reference", files.reference), ("--poses", files.poses)) if path]
    if len(known) > 1:
        raise UsageError("--reference and --poses exclude each other; give one of them")
    if bool(known) != bool(cameras):
        raise UsageError("--reference and --poses need --colmap or --cameras, and these need one of them")
    if files.nerfstudio is not None and not cameras:
        kinds.append("--nerfstudio")
    if files.cloud is not None:
        first = [name for name in kinds if name != "--cloud"] + (["--initial"] if files.initial else [])
        if len(first) > 1 or not set(first) <= {"--colmap", "--cameras", "--correspondences", "--initial"}:
            raise UsageError(
                "--cloud takes one first guess: --initial, --correspondences, or cameras; not "
                + " and ".join(first)
            )
    elif files.initial is not None:
        raise UsageError("--initial is the first guess for --cloud; a similarity to apply is --transform")
    elif len(kinds) != 1 and not (not kinds and config.levels):
        what = f"not {' and '.join(kinds)}" if kinds else "none was given"
        raise UsageError(f"exactly one of {', '.join([*given, '--nerfstudio'])} is needed, {what}")
    if config.origin is not None and files.reference is None:
        raise UsageError("--origin goes with the lat,lon,alt of --reference")


def evidence_of(config: ScaleAlignConfig, files: Files) -> Evidence | None:
    """Read the evidence for the alignment.

    Args:
        config: of the alignment.
        files: with the evidence.

    Raises:
        InputError: a file cannot be read.
    """
    from alula.stages.alignment import cloud_files, tables
    from alula.stages.alignment.cloud import Cloud
    from alula.stages.alignment.scale_align import Given, scale_only
    from alula.stages.alignment.transforms import parse_transform

    points = None
    if files.correspondences is not None:
        points = tables.parse_pairs(text_of(files.correspondences), files.correspondences.name)
    elif files.reference is not None or files.poses is not None:
        points = _cameras(config, files)
    if files.cloud is not None:
        initial = parse_transform(text_of(files.initial), files.initial.name) if files.initial else points
        return Cloud(files.cloud.name, cloud_files.read_cloud(files.cloud), initial)
    if points is not None:
        return points
    if config.scale is not None:
        return Given(scale_only(config.scale), "scale", facts={"unmeasured": ["rotation", "translation"]})
    if files.transform is not None:
        return parse_transform(text_of(files.transform), files.transform.name)
    if files.nerfstudio is not None:
        frame = _training_frame(files.nerfstudio)
        warning = "the scene is in the frame of the source poses; it is in metres only if those were"
        return Given(frame.original_from_training, "nerfstudio", (warning, *frame.warnings), frame.facts)
    return config.distances or None


def _cameras(config: ScaleAlignConfig, files: Files) -> Correspondences:
    """Cameras of the scene and of the world; those of the scene are mapped to the training frame."""
    from alula.stages.alignment import colmap, evidence, tables

    oriented = files.poses is not None
    if files.poses is not None:
        wanted = tables.parse_positions(text_of(files.poses), files.poses.name, orientations=True)
    else:
        assert files.reference is not None
        wanted = tables.parse_reference(text_of(files.reference), files.reference.name, config.origin)
    if files.cameras is not None:
        found = tables.parse_positions(text_of(files.cameras), files.cameras.name, orientations=oriented)
    else:
        assert files.colmap is not None
        found = colmap.read_model(files.colmap)
    points = evidence.match(found, wanted, orientations=oriented, min_matched=config.min_matched)
    if files.nerfstudio is None:
        return points
    frame = _training_frame(files.nerfstudio)
    return evidence.in_training_frame(frame.original_from_training, points, frame.facts, frame.warnings)


def _training_frame(path: Path) -> TrainingFrame:
    from alula.stages.alignment import nerfstudio

    found = nerfstudio.transform_files(path)
    data = found.get("nerfstudio data")
    name = found["nerfstudio"].name
    return nerfstudio.parse_training_frame(
        text_of(found["nerfstudio"]), name, text_of(data) if data else None
    )
