"""`verify`: what is proven and against which files, checked, and the certificate of the proof."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from alula.cli.shell import runner
from alula.cli.verbs.results import Cover, File, Result, Scene, Source, source_of
from alula.cli.verbs.sources import map_role
from alula.cli.verbs.verb import verb
from alula.schemas.artifacts.certificate import (
    CERTIFICATE_SCHEMA,
    CERTIFICATE_VERSION,
    Certificate,
    PartsCertificate,
    certificate_text,
)
from alula.schemas.artifacts.kinds import COVER, PLAN, SCENE, SEEN, VOXELS
from alula.schemas.artifacts.provenance import Provenance, read_provenance
from alula.schemas.errors import AlulaError, ArtifactError, CheckError, UsageError, WrongKindError
from alula.schemas.progress import Progress

if TYPE_CHECKING:
    from alula.schemas.artifacts.manifest import InputRef
    from alula.schemas.artifacts.parts import Parts

_LIMIT = 2**28  # of a certificate [B]
_KINDS = {"plan": PLAN, "seen": SEEN, "cover": COVER, "within": SEEN, "voxels": VOXELS, "scene": SCENE}


@verb()
def verify(
    proven: Source,
    *,
    voxels: Source | None = None,
    scene: Source | None = None,
    source: str | Path | None = None,
    cover: Source | None = None,
    map: Source | None = None,
    within: Source | None = None,
    allow_other_map: bool = False,
    key: str | Path | None = None,
    certificate: str | Path | None = None,
    scheduler: str | None = None,
    jobs: int = 0,
) -> Proving:
    """Prove a cover, a plan, an onboard map or seen space, by other algorithms than those that made it.

    Args:
        proven: a cover, an onboard map, tiles or seen space, which voxels and scene must agree with; a plan;
            or voxels of a source.
        voxels: that the cover must contain.
        scene: that the voxels must contain, or that a plan keeps away from.
        source: mesh, cloud or OctoMap that the voxels of `import_voxels` must contain.
        cover: that an onboard map must contain.
        map: cover or scene that a plan keeps away from.
        within: seen space that a plan stays in.
        allow_other_map: prove a plan against a map that it was not made in.
        key: file of the key that must have signed the index of tiles.
        certificate: of a cover in parts, to prove one of its parts again.
        scheduler: address of a dask.distributed scheduler, for the parts of a cover.
        jobs: threads, of a cover in parts processes; 0 is all processors.

    Returns:
        The certificate of a proof that holds.

    Raises:
        InputError: a plan was not made in this map.
        CheckError: something is not proven; the message names the first failure.
        UsageError: the files do not go together.
    """
    from alula.schemas.artifacts.tiles import TILES, WHOLE, is_tiles

    found = source_of(proven)
    tiles = found.path if isinstance(found, File) and is_tiles(found.path) else None
    if tiles is not None:
        if map is not None or within is not None:
            raise UsageError("tiles are proven against --voxels, --scene and --cover; leave out other files")
        cover = tiles / WHOLE if cover is None else cover
    elif key is not None:
        raise UsageError("--key is for tiles")
    given = {"has_map": map is not None, "has_cover": cover is not None, "has_source": source is not None}
    role = _role_of(found, **given)
    is_folder = isinstance(found, File) and found.path.is_dir()
    is_cover = role in ("cover", "voxels")
    if source is not None and (not is_cover or is_folder or certificate is not None):
        raise UsageError("--source is for a cover or voxels, each one file")
    if role == "voxels" and (voxels is not None or scene is not None):
        raise UsageError("voxels are proven against --source alone; leave out other files")
    if role == "plan" and (map is None or cover is not None or voxels is not None):
        raise UsageError(
            "a plan is proven against the map of --map, --scene and --within; leave out other files"
        )
    if certificate is not None:
        if not is_cover or is_folder:
            raise UsageError(f"{_name(found)}: --certificate is for one part of a cover, a file")
        role = "part"
    elif is_cover and _has_domains(found):
        role = "parts"
    if role != "part":
        if scheduler is not None and role != "parts":
            raise UsageError("--scheduler is for covers in parts, as merge --block makes them")
        if (within is not None or allow_other_map) and role != "plan":
            raise UsageError(f"{'--within' if within is not None else '--allow-other-map'} is for plans")
    if map is not None and _map_role(at := source_of(map)) == "scene":
        if scene is not None:
            raise UsageError(f"{_name(at)} is a scene; --scene is for plans that are proven against a cover")
        map, scene = None, map
    named = "cover" if role in ("part", "parts") else role
    inputs: dict[str, Result | File] = {named: found} if tiles is None else {"map": File.at(tiles / TILES)}
    against = {"cover": map if map is not None else cover, "within": within, "voxels": voxels, "scene": scene}
    inputs |= {name: source_of(one) for name, one in against.items() if one is not None}
    inputs |= {} if source is None else {"source": source_of(source)}
    key_path, listed = (None if one is None else Path(one).expanduser() for one in (key, certificate))
    role = role if tiles is None else "tiles"
    return Proving(role, found, inputs, key_path, listed, allow_other_map, scheduler, jobs)


@dataclass(frozen=True, slots=True)
class Proving:
    """A proof before its work, with files that go together.

    Attributes:
        role: `plan`, `map` (an onboard map), `seen`, `cover`, `voxels`, `tiles`, `parts` (a cover whose parts
            are proven one by one) or `part` (one of these).
        inputs: all files and results by role, the proven one first.
        certificate: of the cover of a `part`.
    """

    role: str
    proven: Result | File
    inputs: Mapping[str, Result | File]
    key: Path | None
    certificate: Path | None
    allow_other_map: bool
    scheduler: str | None
    jobs: int

    def make(self, progress: Progress) -> Proof:
        """The proof, if it holds.

        Raises:
            CheckError: something is not proven.
        """
        provenance = self.provenance()
        self.check_map(provenance)
        certificate = self.prove(progress, provenance.inputs)
        self.require(certificate)
        return Proof(certificate, provenance)

    def paths(self) -> dict[str, Path]:
        """Paths of the inputs that are files, by role."""
        return {role: one.path for role, one in self.inputs.items() if isinstance(one, File)}

    def require(self, certificate: Certificate) -> None:
        """Refuse a proof that does not hold.

        Raises:
            CheckError: a check fails; the message names the first failure.
        """
        if not certificate.covered:
            raise CheckError(f"{_name(self.proven)}: {certificate.complaint()}")

    def provenance(self) -> Provenance:
        """Provenance of the certificate."""
        refs = [one.ref(role) for role, one in self.inputs.items()]
        return Provenance.now(CERTIFICATE_SCHEMA, CERTIFICATE_VERSION, {}, None, refs)

    def check_map(self, provenance: Provenance) -> None:
        """Refuse a map that a plan was not made in.

        Raises:
            InputError: it is another map, and this is not allowed.
        """
        from alula.schemas.artifacts.artifact import read_manifest
        from alula.schemas.artifacts.lineage import require_own_map

        if self.role != "plan":
            return
        plan, results = self.proven, [one for one in self.inputs.values() if isinstance(one, Result)]
        files = [one.path.parent for one in self.inputs.values() if isinstance(one, File)]
        require_own_map(
            Path(_name(plan)),
            read_manifest(plan.path) if isinstance(plan, File) else plan.manifest,  # type: ignore[arg-type]
            [*provenance.inputs, *(ref for one in results if one is not plan for ref in one.origins())],
            [*files, *(folder for one in results for folder in one.folders())],
            allow_other=self.allow_other_map,
            insist="--allow-other-map",
        )

    def prove(self, progress: Progress, refs: Sequence[InputRef] = ()) -> Certificate:
        """The certificate, whether the proof holds or not.

        Args:
            refs: the inputs; those that the proven file does not record become notes.

        Raises:
            InputError: a file cannot be read, has another frame, or is too large.
            CheckError: a part is not that of its certificate.
        """
        if self.role == "part":
            return self._part()
        sha256 = {ref.role: ref.sha256 for ref in refs}
        known: dict[str, Any] = {"sha256": sha256, "jobs": self.jobs}
        if self.role == "plan":
            from alula.stages.planning.verify import verify_plan

            plan, *rest = self._read().items()
            return verify_plan(plan[1], **dict(rest), **known)
        known["progress"] = progress
        if self.role == "parts":
            from alula.stages.compression.verify_parts import verify_parts

            known |= self._others() | {"scheduler": self.scheduler}
            return verify_parts(self.proven.parts(COVER), **known)
        if self.role == "tiles":
            return self._tiles(known)
        from alula.stages.compression.onboard.verify import verify_map
        from alula.stages.compression.verify import verify, verify_voxels
        from alula.stages.planning.verify_seen import verify_seen

        stages = {"map": verify_map, "seen": verify_seen, "cover": verify, "voxels": verify_voxels}
        (_, proven), *rest = self._read().items()
        stage: Any = stages[self.role]
        certificate: Certificate = stage(proven, **dict(rest), **known)
        return certificate

    def _read(self) -> dict[str, Any]:
        from alula.stages.compression.imported_files import read_imported
        from alula.stages.compression.onboard.image import read_map

        found: dict[str, Any] = {
            role: one.read(_KINDS[role]) for role, one in self.inputs.items() if role in _KINDS
        }
        if isinstance(source := self.inputs.get("source"), File):
            found["source"] = read_imported(source.path)
        if self.role == "map" and isinstance(self.proven, File):
            found = {"map": read_map(self.proven.path.read_bytes(), self.proven.path), **found}
        return found

    def _others(self) -> dict[str, Parts]:
        """Voxels and scene as parts, of which few are in memory at a time."""
        kinds = {"voxels": VOXELS, "scene": SCENE}
        return {role: self.inputs[role].parts(kind) for role, kind in kinds.items() if role in self.inputs}

    def _tiles(self, known: dict[str, Any]) -> Certificate:
        from alula.schemas.artifacts.signing_key import read_key
        from alula.schemas.artifacts.tiles import open_tiles
        from alula.stages.compression.onboard.verify_tiles import verify_tiles

        assert isinstance(self.proven, File)
        known |= {"cover": self.inputs["cover"].read(COVER)} | self._others()
        tiles = open_tiles(self.proven.path, None if self.key is None else read_key(self.key))
        return verify_tiles(tiles, **known)

    def _part(self) -> Certificate:
        """Prove one part again, against the list of a certificate."""
        from alula.schemas.artifacts.artifact import file_hash
        from alula.schemas.decode import MalformedError, decode_json
        from alula.schemas.files import read_small
        from alula.stages.compression.verify_parts import prove_part

        assert self.certificate is not None
        raw = read_small(self.certificate, _LIMIT)
        try:
            whole = decode_json(raw, PartsCertificate)
        except MalformedError as error:
            raise ArtifactError(
                f"{self.certificate}: is no certificate of a cover in parts ({error})"
            ) from error
        part, others = self.proven.read(COVER), self._others()
        proven = self.proven
        sha256 = file_hash(proven.path) if isinstance(proven, File) else proven.ref("cover").sha256
        try:
            return prove_part(whole, part, sha256, others.get("voxels"), others.get("scene"))
        except ArtifactError as error:
            raise error.reworded(f"{self.certificate}: {error}") from error


class Proof:
    """The certificate of a proof that holds."""

    def __init__(self, certificate: Certificate, provenance: Provenance) -> None:
        self.certificate = certificate
        self.statement = certificate.statement
        self._provenance = provenance

    def save(self, path: str | Path, *, force: bool = False) -> Proof:
        """Write the certificate that `alula verify` would write.

        Raises:
            UsageError: another file is there.
            OutputError: the file cannot be written.
        """
        from alula.schemas.atomic import write_text

        target = Path(path).expanduser()
        check_name(target)
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


def check_name(output: Path) -> None:
    """Refuse a name that is not that of a certificate.

    Raises:
        UsageError: the name does not end in .json.
    """
    if output.suffix != ".json":
        raise UsageError(f"{output}: the certificate must end in .json")


def _name(one: Result | File) -> str:
    return str(one.path) if isinstance(one, File) else f"the {type(one).__name__.lower()}"


def _role_of(proven: Result | File, *, has_map: bool, has_cover: bool, has_source: bool) -> str:
    """What is to be proven, from its content; the reader reports a file that cannot be read."""
    path = proven.path if isinstance(proven, File) else None
    kind = "" if isinstance(proven, File) else proven.KIND.name
    if has_map or kind == PLAN.name or (path is not None and _is_plan(path)):
        return "plan"
    if kind and has_cover:
        raise WrongKindError(f"a result is {kind}, but --cover is for an onboard map")
    if path is not None:
        if has_cover or _is_map(path):
            return "map"
        recorded = read_provenance(path)
        kind = "" if recorded is None else recorded.schema
    return {SEEN.name: "seen", VOXELS.name: "voxels" if has_source else "cover"}.get(kind, "cover")


def _map_role(map: Result | File) -> str:
    if isinstance(map, File):
        return map_role(map.path)
    if not isinstance(map, Cover | Scene):
        raise WrongKindError(f"a result is {map.KIND.name}, but {COVER.name} or {SCENE.name} is needed")
    return map.KIND.name.removeprefix("alula/")


def _has_domains(cover: Result | File) -> bool:
    """Test whether the parts of a cover can be proven one by one; the reader reports what is wrong."""
    from alula.schemas.artifacts.parts import is_parts, open_parts

    if isinstance(cover, Result) or not is_parts(cover.path):
        return False
    try:
        return all(ref.domain is not None for ref in open_parts(cover.path, COVER).refs)
    except AlulaError:
        return False


def _is_plan(path: Path) -> bool:
    from alula.schemas.artifacts.artifact import read_manifest
    from alula.schemas.files import is_special

    if is_special(path):
        return False
    try:
        return read_manifest(path).schema == PLAN.name
    except (AlulaError, OSError):
        return False


def _is_map(path: Path) -> bool:
    """Test whether a file begins like an onboard map."""
    from alula.schemas.files import is_special
    from alula.stages.compression.onboard.image import is_map

    if is_special(path):
        return False
    try:
        with path.open("rb") as file:
            return is_map(file.read(4))
    except OSError:
        return False
