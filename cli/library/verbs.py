"""The functions of `import alula` that make and prove artifacts; each is named like its command."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from alula.cli import runner
from alula.cli.library.bar import shown
from alula.cli.verbs.keywords import configured, keywords
from alula.cli.verbs.results import RESULTS, Cover, File, Plan, Result, Scene, Seen, Voxels
from alula.schemas.configs.import_splat import ImportSplatConfig
from alula.schemas.configs.import_voxels import ImportVoxelsConfig
from alula.schemas.configs.merge import MergeConfig
from alula.schemas.configs.scale_align import ScaleAlignConfig
from alula.schemas.configs.voxelize import VoxelizeConfig
from alula.schemas.errors import CheckError, InfeasibleError, InputError, UsageError, WrongKindError
from alula.schemas.provenance import Provenance

if TYPE_CHECKING:
    from alula.cli.verbs.runs import Run
    from alula.schemas.keywords import (
        ImportSplatFields,
        MergeFields,
        ScaleAlignFields,
        VoxelizeFields,
    )
    from alula.stages.compression.verify import Certificate

Source = Result | str | Path


def read(path: str | Path) -> Scene | Voxels | Seen | Cover | Plan | Run:
    """Read an artifact, or the log of a run, that a command or `save` wrote.

    Args:
        path: the file.

    Returns:
        A result of its kind. Large arrays are mapped, not copied.

    Raises:
        InputError: the file cannot be read, is damaged, or is a splat file, which `import_splat` reads.
    """
    from alula.schemas.mcap_log import MAGIC
    from alula.schemas.parts_join import read_whole
    from alula.schemas.salvage import is_artifact_like

    file = Path(path).expanduser()
    with_magic = b""
    if file.is_file():
        with file.open("rb") as opened:
            with_magic = opened.read(len(MAGIC))
    if with_magic == MAGIC:
        from alula.cli.verbs.runs import Run

        return Run.read(file)
    if file.is_file() and not is_artifact_like(file):
        raise InputError(f"{file}: is not an artifact or a run; alula.import_splat reads splat files")
    state = File.at(file)
    artifact = read_whole(file)
    found: Any = RESULTS[artifact.kind.name](artifact, file=state)
    return found  # type: ignore[no-any-return]


@keywords(ImportSplatConfig)
def import_splat(*splats: str | Path, **fields: Unpack[ImportSplatFields]) -> Scene:
    """Read Gaussian splat files into a scene.

    Args:
        *splats: files, or the output folder of a trainer; several that share one frame become one scene.
        **fields: as in the signature.

    Raises:
        InputError: a file cannot be read, or no Gaussian is left.
    """
    if not splats:
        raise UsageError("import_splat needs a splat file")
    config = configured("import_splat", ImportSplatConfig, fields)
    return splats_of(*splats, format=config.format, lod=config.lod)(config)


def splats_of(
    *splats: str | Path, format: str = "auto", lod: int | None = None
) -> Callable[[ImportSplatConfig], Scene]:
    """Read Gaussian splat files once, to make scenes of them with several configurations.

    Args:
        *splats: as of `import_splat`.
        format: of the files.
        lod: level of detail of a streamed splat.

    Raises:
        InputError: a file cannot be read.
    """
    from alula.cli.import_parts import inputs_of
    from alula.schemas.files import printable
    from alula.stages.progress import share
    from alula.stages.reconstruction.formats.capture import joined
    from alula.stages.reconstruction.import_splat import import_splat as stage
    from alula.stages.reconstruction.pieces import find_splats

    found = find_splats([Path(path).expanduser() for path in splats], format, lod)
    inputs = {role: File.at(path) for files in inputs_of(found) for role, path in files.items()}
    with shown("import_splat") as progress:
        whole = joined(
            [
                (
                    printable(one.path.name),
                    one.decode(share(progress, k / len(found), (k + 1) / len(found))),
                )
                for k, one in enumerate(found)
            ]
        )
    return lambda config: Scene(_named(splats[0], lambda: stage(config, whole)), inputs)


@keywords(ScaleAlignConfig, without=("distances",))
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
) -> Scene:
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
    from alula.cli.scale_align import Files, check_evidence, evidence_of
    from alula.stages.alignment.scale_align import scale_align

    pairs = [(*start, *end, metres) for start, end, metres in distances]
    config = configured("align", ScaleAlignConfig, fields)
    points = tuple(
        ((float(a), float(b), float(c)), (float(d), float(e), float(f)), float(metres))
        for a, b, c, d, e, f, metres in pairs
    )
    config = dataclasses.replace(config, distances=points)
    given = {
        "colmap": colmap, "cameras": cameras, "reference": reference, "poses": poses,
        "nerfstudio": nerfstudio, "correspondences": correspondences, "cloud": cloud,
        "initial": initial, "transform": transform,
    }  # fmt: skip
    files = Files(**{role: Path(path).expanduser() for role, path in given.items() if path is not None})
    check_evidence(config, files)
    source = Scene.of(scene)
    inputs = {"scene": source} | {role: File.at(path) for role, path in files.inputs().items()}
    with shown("align"):
        artifact = scale_align(
            config, source.artifact, evidence_of(config, files), seed, lambda alignment: None
        )
    return Scene(artifact, inputs, seed=seed)


@keywords(VoxelizeConfig)
def voxelize(
    scene: Source,
    *,
    tile_m: float | None = None,
    scheduler: str | None = None,
    jobs: int = 0,
    **fields: Unpack[VoxelizeFields],
) -> Voxels:
    """Mark every voxel that an obstacle touches.

    Args:
        scene: in metres, of `align`.
        tile_m: edge of a tile, which bounds the memory [m].
        scheduler: address of a dask.distributed scheduler.
        jobs: threads; 0 is all processors.
        **fields: as in the signature.

    Raises:
        InputError: the scene is not in metres.
        InfeasibleError: there are far more voxels than `max_voxels`.
    """
    from alula.stages.compression.voxelize import voxelize as stage

    _one_level(fields)
    config = configured("voxelize", VoxelizeConfig, fields)
    source = Scene.of(scene)
    with shown("voxelize") as progress:
        how: dict[str, Any] = {"tile_m": tile_m, "scheduler": scheduler, "jobs": jobs, "progress": progress}
        return Voxels(_named(scene, lambda: stage(config, source.artifact, **how)), {"scene": source})


@keywords(ImportVoxelsConfig)
def import_voxels(source: str | Path, *, jobs: int = 0, **fields: Any) -> Voxels:
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
    from alula.stages.compression.import_voxels import import_voxels as stage
    from alula.stages.compression.imported_files import read_imported

    config = configured("import_voxels", ImportVoxelsConfig, fields)
    path = Path(source).expanduser()
    inputs = {"source": File.at(path)}
    with shown("import_voxels") as progress:
        read_in = read_imported(path)
        return Voxels(_named(source, lambda: stage(config, read_in, jobs=jobs, progress=progress)), inputs)


@keywords(MergeConfig)
def merge(source: Source, *, jobs: int = 0, **fields: Unpack[MergeFields]) -> Cover:
    """Cover voxels with a limited number of convex polytopes.

    Args:
        source: voxels, or a cover to merge further.
        jobs: threads; 0 is all processors.
        **fields: as in the signature.

    Raises:
        InfeasibleError: there is no cover within the limits.
    """
    from alula.schemas.artifact import Artifact
    from alula.stages.compression.merge import merge as stage

    config = configured("merge", MergeConfig, fields)
    found = source if isinstance(source, Result) else read(source)
    if not isinstance(found, Voxels | Cover):
        what = f"{source}: is" if not isinstance(source, Result) else "a result is"
        raise WrongKindError(f"{what} {type(found).__name__.lower()}, but voxels or a cover are needed")
    whole = Artifact(found.manifest, found.artifact.arrays)  # the cover names the files of its voxels
    with shown("merge") as progress:
        return Cover(stage(config, whole, jobs=jobs, progress=progress), {"source": found})


class Proof:
    """The certificate of a proof that holds.

    Attributes:
        certificate: checks and their results.
        statement: the verdict in a sentence.
    """

    def __init__(self, certificate: Certificate, provenance: Provenance) -> None:
        self.certificate = certificate
        self.statement = certificate.statement
        self._provenance = provenance

    def save(self, path: str | Path, *, force: bool = False) -> Proof:
        """Write the certificate that `alula verify` would write.

        Args:
            path: the file (.json).
            force: replace a file of other provenance.

        Raises:
            UsageError: another file is there.
            OutputError: the file cannot be written.
        """
        from alula.cli.verify import certificate_text
        from alula.schemas.atomic import write_text

        target = Path(path).expanduser()
        if target.suffix != ".json":
            raise UsageError(f"{target}: the certificate must end in .json")
        runner.check_output(target, {})
        runner.current(target, self._provenance, force=force)
        write_text(target, certificate_text(self.certificate, self._provenance))
        return self

    def __repr__(self) -> str:
        return f"Proof: {self.statement}"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{escape(one.name)}</td><td>{'ok' if one.ok else one.failed}</td>"
            f"<td>{one.checked:,}</td><td>{escape(one.detail)}</td></tr>"
            for one in self.certificate.checks
        )
        return f"<div><b>{escape(repr(self))}</b><table>{rows}</table></div>"


def verify(
    proven: Source,
    *,
    voxels: Source | None = None,
    scene: Source | None = None,
    source: str | Path | None = None,
    map: Source | None = None,
    within: Source | None = None,
    allow_other_map: bool = False,
    jobs: int = 0,
) -> Proof:
    """Prove a cover, a plan or seen space independently, by other algorithms than those that made it.

    Args:
        proven: a cover or seen space, which voxels and scene must agree with; voxels of a source; or a plan.
        voxels: that the cover must contain.
        scene: that the voxels must contain, or that a plan keeps away from.
        source: mesh, cloud or OctoMap that the voxels of `import_voxels` must contain.
        map: cover or scene that a plan keeps away from.
        within: seen space that a plan stays in.
        allow_other_map: prove a plan against a map that it was not made in.
        jobs: threads; 0 is all processors.

    Raises:
        InputError: a plan was not made in this map.
        CheckError: something is not proven; the message names the first failure.
        UsageError: the files do not go together.
    """
    from alula.cli.verify import prove
    from alula.stages.compression.verify import SCHEMA, VERSION

    found = proven if isinstance(proven, Result) else read(proven)
    role = type(found).__name__.lower()
    if not isinstance(found, Cover | Seen | Plan | Voxels):
        raise WrongKindError("verify proves a cover, voxels of a source, seen space or a plan")
    if source is not None and role not in ("cover", "voxels"):
        raise UsageError("`source` is for covers and voxels")
    if role == "voxels" and (voxels is not None or scene is not None):
        raise UsageError("voxels are proven against `source`")
    if role == "plan" and (map is None or voxels is not None):
        raise UsageError("a plan is proven against `map`, `scene` and `within`")
    if role != "plan" and (map is not None or within is not None):
        raise UsageError("`map` and `within` are for plans")
    files: dict[str, Result] = {role: found}
    if map is not None:
        one = map if isinstance(map, Result) else read(map)
        if not isinstance(one, Cover | Scene) or (isinstance(one, Scene) and scene is not None):
            raise UsageError("`map` is a cover, or a scene without another one")
        files["cover" if isinstance(one, Cover) else "scene"] = one
    files |= {} if within is None else {"within": Seen.of(within)}
    files |= {} if voxels is None else {"voxels": Voxels.of(voxels)}
    files |= {} if scene is None else {"scene": Scene.of(scene)}
    refs = [one.ref(name) for name, one in files.items()]
    if isinstance(found, Plan):
        from alula.schemas.lineage import require_own_map

        require_own_map(
            Path("the plan" if isinstance(proven, Result) else proven),
            found.manifest,  # type: ignore[arg-type]
            [ref for one in files.values() if one is not found for ref in one.origins()],
            [folder for one in files.values() for folder in one.folders()],
            allow_other=allow_other_map,
            insist="allow_other_map=True",
        )
    against: dict[str, Any] = {}
    if source is not None:
        from alula.stages.compression.imported_files import read_imported

        path = Path(source).expanduser()
        against = {"source": read_imported(path)}
        refs.append(File.at(path).ref("source"))
    with shown("verify") as progress:
        certificate = prove(
            {name: one.artifact for name, one in files.items()} | against,
            sha256={ref.role: ref.sha256 for ref in refs},
            jobs=jobs,
            progress=progress,
        )
    if not certificate.covered:
        name = f"{proven}" if not isinstance(proven, Result) else role
        raise CheckError(f"{name}: {certificate.complaint()}")
    return Proof(certificate, Provenance.now(SCHEMA, VERSION, {}, None, refs))


def _one_level(fields: Mapping[str, Any]) -> None:
    if fields.get("confidence") is not None and "sigma" in fields:
        raise UsageError("--confidence sets sigma; give one of --confidence and --sigma")


def _named(source: object, call: Callable[[], Any]) -> Any:
    """The result of a call, whose errors name the file that it read."""
    try:
        return call()
    except (InputError, InfeasibleError) as error:
        if isinstance(source, Result):
            raise
        raise error.reworded(f"{source}: {error}") from error
