"""The functions of `import alula` that make and prove artifacts; each is named like its command."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from alula.cli import runner
from alula.cli.library.bar import shown
from alula.cli.verbs.keywords import configured, keywords
from alula.cli.verbs.results import RESULTS, Cover, File, Plan, Result, Scene, Seen, Voxels
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.errors import CheckError, InfeasibleError, InputError, UsageError, WrongKindError
from alula.schemas.parameters.configs.merge import MergeConfig
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig

if TYPE_CHECKING:
    from alula.cli.verbs.runs import Run
    from alula.schemas.artifacts.certificate import Certificate
    from alula.schemas.parameters.keywords import (
        MergeFields,
        VoxelizeFields,
    )

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
    from alula.schemas.artifacts.parts_join import read_whole
    from alula.schemas.artifacts.salvage import is_artifact_like
    from alula.schemas.log.mcap import MAGIC

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
    from alula.schemas.artifacts.artifact import Artifact
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
        from alula.schemas.artifacts.certificate import certificate_text
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
    from alula.schemas.artifacts.certificate import CERTIFICATE_SCHEMA, CERTIFICATE_VERSION

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
        from alula.schemas.artifacts.lineage import require_own_map

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
    return Proof(certificate, Provenance.now(CERTIFICATE_SCHEMA, CERTIFICATE_VERSION, {}, None, refs))


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
