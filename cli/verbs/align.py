"""`scale-align`: the evidence for an alignment, checked and read, and the scene in metres."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import msgspec

from alula.cli.shell.interruption import handlers_kept
from alula.cli.verbs.keywords import configured
from alula.cli.verbs.results import File, Scene, Source, source_of
from alula.cli.verbs.verb import Step, verb
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.errors import UsageError
from alula.schemas.files import text_of
from alula.schemas.parameters.configs.scale_align import ScaleAlignConfig
from alula.schemas.progress import Progress

if TYPE_CHECKING:
    from alula.schemas.artifacts.artifact import Artifact
    from alula.schemas.artifacts.manifest import Manifest
    from alula.schemas.artifacts.parts import Parts
    from alula.schemas.artifacts.parts_output import PartsWriter
    from alula.schemas.artifacts.provenance import Provenance
    from alula.schemas.parameters.keywords import ScaleAlignFields
    from alula.stages.alignment.evidence import Correspondences
    from alula.stages.alignment.nerfstudio import TrainingFrame
    from alula.stages.alignment.scale_align import Aligner, Evidence


@verb(ScaleAlignConfig, without=("distances",))
def align(
    scene: Source,
    *,
    distances: Sequence[tuple[Sequence[float], Sequence[float], float]] = (),
    colmap: str | Path | None = None,
    cameras: str | Path | None = None,
    reference: str | Path | None = None,
    poses: str | Path | None = None,
    nerfstudio: str | Path | None = None,
    correspondences: str | Path | None = None,
    cloud: str | Path | None = None,
    initial: str | Path | None = None,
    transform: str | Path | None = None,
    seed: int = 0,
    **fields: Unpack[ScaleAlignFields],
) -> Step[Scene]:
    """Give a scene metric scale and a named world frame, as `alula scale-align`.

    Args:
        scene: of `import_splat`.
        distances: two points of the scene and their distance in metres, each.
        colmap: COLMAP model with cameras in the scene's frame.
        cameras: CSV of cameras in the scene's frame.
        reference: CSV of the same cameras in the world, in metres or by latitude and longitude.
        poses: CSV of the same cameras with their orientations.
        nerfstudio: run folder whose training frame the scene has.
        correspondences: CSV of points in both frames.
        cloud: surveyed cloud in metres.
        initial: first guess for the cloud.
        transform: JSON of a similarity.
        seed: of all randomness.
        **fields: as in the signature.

    Raises:
        UsageError: there is no evidence, or pieces of it contradict one another.
        CheckError: the alignment does not hold.
    """
    files = {
        "colmap": colmap, "cameras": cameras, "reference": reference, "poses": poses,
        "nerfstudio": nerfstudio, "correspondences": correspondences, "cloud": cloud,
        "initial": initial, "transform": transform,
    }  # fmt: skip
    given = Files(**{role: Path(path).expanduser() for role, path in files.items() if path is not None})
    return given.step(scene, given.config_of(fields, distances), seed)


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

    def config_of(self, fields: Mapping[str, Any], distances: Sequence[Any]) -> ScaleAlignConfig:
        """The configuration of an alignment by these files.

        Raises:
            UsageError: options are contradictory, redundant or incomplete.
        """
        config = configured("align", ScaleAlignConfig, {**fields, "distances": tuple(distances)})
        if self.colmap is not None or self.reference is not None:
            with handlers_kept(), suppress(ImportError):  # the stages say that it is not installed
                import pycolmap  # noqa: F401
        _check_evidence(config, self)
        for name, option, path, needed in (
            ("min_fitness", "--min-fitness", self.cloud, "--cloud"),
            ("max_angle_deg", "--angle-threshold", self.poses, "--poses"),
            ("min_near", "--min-near", self.colmap, "--colmap"),
            ("min_matched", "--min-matched", self.reference or self.poses, "--reference or --poses"),
        ):
            if path is None and name in fields:
                raise UsageError(f"{option} goes with {needed}")
        return config

    def step(
        self,
        scene: Source,
        config: ScaleAlignConfig,
        seed: int,
        report: Callable[[dict[str, Any]], None] = lambda alignment: None,
        jobs: int = 0,
    ) -> Step[Scene]:
        """The alignment of a scene.

        Args:
            report: called with what was found, before it is checked.
            jobs: threads, each with one part, where the output is a folder.
        """
        source = source_of(scene)

        def build(progress: Progress) -> Artifact:
            from alula.stages.alignment.scale_align import scale_align

            found = source.read(SCENE)
            return scale_align(config, found, evidence_of(config, self), seed, report)

        def into(writer: PartsWriter, recorded: Provenance, progress: Progress) -> Manifest:
            from alula.stages.alignment.scale_align import Aligner
            from alula.stages.progress import share

            parts = source.parts(SCENE)
            known, begun = (config, parts, evidence_of(config, self), seed), share(progress, 0, 0.5)
            aligner = Aligner(*known, report, jobs, begun)
            _align_parts(aligner, parts, writer, jobs, share(progress, 0.5, 1))
            return writer.whole(recorded, **aligner.whole(writer.manifests))

        inputs = {role: File.at(path) for role, path in self.inputs().items()}
        return Step(Scene, config, {"scene": source} | inputs, build, seed, into)


def _align_parts(
    aligner: Aligner, parts: Parts, writer: PartsWriter, jobs: int, progress: Progress | None
) -> None:
    """Map and write each part that an interrupted run has not finished."""
    from alula.schemas.artifacts.artifact import Artifact, file_hash
    from alula.schemas.artifacts.manifest import InputRef
    from alula.schemas.artifacts.parts_output import WrittenPart, kept_part, part_name, write_part
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


def _check_evidence(config: ScaleAlignConfig, files: Files) -> None:
    """Refuse combinations of options that are contradictory, redundant or incomplete."""
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
