"""`alula verify`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli import grouped, options
from alula.cli.present import echo, print_json

if TYPE_CHECKING:
    from alula.schemas.artifacts.artifact import Artifact
    from alula.schemas.artifacts.certificate import Certificate
    from alula.schemas.artifacts.kinds import Kind
    from alula.schemas.artifacts.parts import Parts
    from alula.schemas.progress import Progress

EXAMPLES = """\b
Examples:
  alula verify room.cover.npz --voxels room.voxels.npz --scene room.metric.scene.npz
  alula verify room.cover.npz --voxels room.voxels.npz -o room.certificate.json
  alula verify room.map.bin --cover room.cover.npz --voxels room.voxels.npz
  alula verify city.tiles --voxels city.voxels.npz --scene city.metric.scene.npz --key my.key
  alula verify room.plan.npz --map room.cover.npz --scene room.metric.scene.npz
  alula verify among.plan.npz --map room.scene.npz
  alula verify room.seen.npz --voxels room.voxels.npz --scene room.metric.scene.npz
  alula verify city.cover --voxels city.voxels --scene city.metric.scene -o city.certificate.json
  alula verify shed.cover.npz --voxels shed.voxels.npz --source shed.obj
  alula verify city.cover/part-00003.cover.npz --certificate city.certificate.json --voxels city.voxels
"""


@grouped.command(epilog=EXAMPLES)
@click.argument("proven", metavar="COVER", type=options.input_path())
@click.option("--cover", type=options.input_path(), help="The cover that an onboard map must contain.")
@click.option(
    "--map", "map_path", type=options.input_path(), help="The cover or scene that a plan keeps away from."
)
@click.option(
    "--allow-other-map",
    is_flag=True,
    help="Prove a plan against a map that it was not made in, nor in one of the same scene.",
)
@click.option("--within", type=options.input_path(), help="Seen space (.seen.npz) that a plan stays in.")
@click.option("--voxels", type=options.input_path(), help="The voxels that the cover must contain.")
@click.option("--scene", type=options.input_path(), help="The scene that the voxels must contain.")
@click.option(
    "--source",
    type=options.input_path(),
    help="The mesh, cloud or OctoMap that the voxels of import-voxels must contain.",
)
@click.option(
    "--key", "key_path", type=options.input_path(), help="Key that must have signed the index of tiles."
)
@click.option(
    "--certificate",
    "listed",
    type=options.input_path(),
    help="Certificate of a cover in parts: prove one of its parts again, and that it is the listed one.",
)
@options.scheduler("Send the parts of a cover")
@click.option(
    "-o", "--output", type=options.PATH, help="Certificate to write when every check holds (.json)."
)
@options.common("-f", "--force", is_flag=True, help="Replace an output of other provenance.")
@options.common("-n", "--dry-run", is_flag=True, help="Check everything, write nothing.")
@options.common(
    "--jobs",
    type=options.JOBS,
    default=0,
    help="Threads, of a cover in parts processes; 0 is all processors.",
    show_default=True,
)
@options.common("--depfile", type=options.PATH, help="Also write Make dependencies to this file.")
@options.reporting
def command(
    proven: Path,
    cover: Path | None,
    map_path: Path | None,
    allow_other_map: bool,
    within: Path | None,
    voxels: Path | None,
    scene: Path | None,
    source: Path | None,
    key_path: Path | None,
    listed: Path | None,
    scheduler: str | None,
    output: Path | None,
    force: bool,
    dry_run: bool,
    jobs: int,
    depfile: Path | None,
    json: bool,
    quiet: bool,
    verbose: int,
) -> None:
    """Prove independently that a cover contains the ellipsoids of a scene.

    The proof uses the files alone and other algorithms than those that made them: exact integers for hulls
    and voxels, separating planes for ellipsoids. It covers what the files show: without --scene no
    ellipsoid is checked, without --voxels only the voxels that the cover lists. The first line of the
    answer names the level of the ellipsoids with the fraction of a Gaussian's mass inside, the files that
    were missing, and what was not checked for that reason. When something is not proven, the exit code is
    4, the message names the first failure, and no certificate is written. An onboard map (.bin) is proven
    from its own bytes, against voxels or a cover. Of tiles, a folder, each tile is proven to contain
    every voxel, by its hulls within its reach and by its walls beyond, and every byte is compared with
    the index; without --voxels against the cover in the folder. Seen voxels (.seen.npz) are proven to
    touch no obstacle of the voxels or the scene, and to be reached by their ball; what the cameras saw is
    not proven again. A plan is proven against the map of --map, a cover or the scene that it was made in:
    clearance, corridor, limits of the motion, continuity; with --scene beside a cover, against its
    ellipsoids, too; with --within against the space that was not seen. The voxels of import-voxels are proven
    to contain the map of --source, the file that they were made from, alone or with the cover: again by
    separating planes, by rays for the inside of a solid mesh, in rational numbers for an OctoMap.

    The parts of a cover that merge --block made are proven one by one, each with the voxels and ellipsoids of
    its cube; --jobs processes or the workers of --scheduler share them. The certificate lists the hashes of
    their proofs under one root (a Merkle tree). With --certificate one part is proven again, against this
    list.

    Memory: the scene (56 bytes per Gaussian), at most 250 bytes per voxel, or per member of a hull where
    hulls share voxels, and 4,000 per hull. More than 67,108,864 voxels are refused. A cover in parts is
    proven in cells of at most 262,144 voxels and 524,288 Gaussians: 250 MB per job, 60 bytes per voxel of
    one part, and a part of the voxels and of the scene, whatever their number. Of tiles, memory holds one
    image, the cover, and where voxels and scene are in parts a few parts and cells of them.
    """
    import os

    from alula.cli import runner
    from alula.cli.progress import shown_progress
    from alula.cli.sources import map_role
    from alula.cli.verify_parts import has_domains, verified, verified_part
    from alula.schemas.artifacts.artifact import read_manifest
    from alula.schemas.artifacts.certificate import CERTIFICATE_SCHEMA, CERTIFICATE_VERSION, certificate_text
    from alula.schemas.artifacts.kinds import COVER, PLAN, SCENE, SEEN, VOXELS
    from alula.schemas.artifacts.lineage import require_own_map
    from alula.schemas.artifacts.parts_join import read_whole
    from alula.schemas.artifacts.provenance import Provenance, read_provenance
    from alula.schemas.artifacts.signing_key import read_key
    from alula.schemas.artifacts.tiles import TILES, WHOLE, is_tiles, open_tiles
    from alula.schemas.atomic import write_text
    from alula.schemas.errors import CheckError, UsageError
    from alula.stages.compression.imported_files import read_imported
    from alula.stages.compression.onboard.image import read_map
    from alula.stages.compression.onboard.verify_tiles import verify_tiles

    if output is not None and output.suffix != ".json":
        raise UsageError(f"{output}: the certificate must end in .json")
    if output is None and depfile is not None:
        raise UsageError("--depfile needs a certificate to write; give -o")
    target = output if output is not None else Path("certificate")
    common = options.Common(target, force, dry_run, json, quiet, verbose, 0, jobs, depfile)
    if is_tiles(proven):
        if map_path is not None or within is not None:
            raise UsageError("tiles are proven against --voxels, --scene and --cover; leave out other files")
        cover = proven / WHOLE if cover is None else cover
    elif key_path is not None:
        raise UsageError("--key is for tiles")
    is_plan = map_path is not None or _is_plan(proven)
    is_map = not is_plan and (cover is not None or _is_map(proven))
    known_as = None if is_plan or is_map else read_provenance(proven)
    is_seen = known_as is not None and known_as.schema == SEEN.name
    is_voxels = source is not None and known_as is not None and known_as.schema == VOXELS.name
    if source is not None and (is_plan or is_map or is_seen or proven.is_dir() or listed is not None):
        raise UsageError("--source is for a cover or voxels, each one file")
    if is_voxels and (voxels is not None or scene is not None):
        raise UsageError("voxels are proven against --source alone; leave out other files")
    if is_plan and (map_path is None or cover is not None or voxels is not None):
        raise UsageError(
            "a plan is proven against the map of --map, --scene and --within; leave out other files"
        )
    if listed is not None:
        if is_plan or is_map or is_seen or proven.is_dir():
            raise UsageError(f"{proven}: --certificate is for one part of a cover, a file")
        if output is not None:
            raise UsageError("--certificate compares with a certificate and writes none; leave out -o")
        _show(common, "checked", verified_part(proven, listed, voxels, scene))
        return
    is_parted = not (is_plan or is_map or is_seen) and has_domains(proven)
    if scheduler is not None and not is_parted:
        raise UsageError("--scheduler is for covers in parts, as merge --block makes them")
    if (within is not None or allow_other_map) and not is_plan:
        raise UsageError(f"{'--within' if within is not None else '--allow-other-map'} is for plans")
    if map_path is not None and map_role(map_path) == "scene":
        if scene is not None:
            raise UsageError(f"{map_path} is a scene; --scene is for plans that are proven against a cover")
        map_path, scene = None, map_path
    role = "plan" if is_plan else "map" if is_map else "seen" if is_seen else "cover"
    inputs = {"voxels" if is_voxels else role: proven}
    inputs = {"map": proven / TILES} if is_tiles(proven) else inputs
    inputs |= {"cover": map_path} if map_path is not None else {}
    inputs |= {"within": within} if within is not None else {}
    inputs |= {"cover": cover} if cover is not None else {}
    inputs |= {"voxels": voxels} if voxels is not None else {}
    inputs |= {"scene": scene} if scene is not None else {}
    inputs |= {"source": source} if source is not None else {}
    if output is not None:
        runner.check_output(output, inputs)
    refs = [runner.input_ref(role, path) for role, path in inputs.items()]
    provenance = Provenance.now(CERTIFICATE_SCHEMA, CERTIFICATE_VERSION, {}, None, refs)
    if is_plan:
        require_own_map(
            proven,
            read_manifest(proven),  # type: ignore[arg-type]
            provenance.inputs,
            [path.parent for path in inputs.values()],
            allow_other=allow_other_map,
            insist="--allow-other-map",
        )
    known = output is not None and runner.current(output, provenance, force=force) is not None
    with shown_progress(common) as progress:
        sha256 = {ref.role: ref.sha256 for ref in provenance.inputs}
        certificate: Certificate
        if is_parted:
            certificate = verified(proven, voxels, scene, sha256, jobs, scheduler, progress)
        else:
            kinds = {
                **{"plan": PLAN, "seen": SEEN, "cover": COVER},
                **{"within": SEEN, "voxels": VOXELS, "scene": SCENE},
            }
            # Tiles are proven with a few parts of the voxels and the scene in memory; all else as a whole.
            open_one: Any = _open if is_tiles(proven) else read_whole
            read: dict[str, Any] = {
                role: open_one(path, kinds[role]) for role, path in inputs.items() if role in kinds
            }
            if source is not None:
                read["source"] = read_imported(source)
            if is_tiles(proven):
                tiles = open_tiles(proven, None if key_path is None else read_key(key_path))
                certificate = verify_tiles(tiles, **read, sha256=sha256, jobs=jobs, progress=progress)
            else:
                if is_map:
                    read = {"map": read_map(proven.read_bytes(), proven), **read}
                certificate = prove(read, sha256=sha256, jobs=jobs, progress=progress)
    if not certificate.covered:
        _show(common, "failed", certificate)
        raise CheckError(f"{proven}: {certificate.complaint()}")
    status = "checked"
    if output is not None:
        text = certificate_text(certificate, provenance)
        # An existing certificate is never trusted: it is compared with the new one.
        status = (
            "dry-run"
            if dry_run
            else "unchanged"
            if known and output.read_bytes() == text.encode()
            else "written"
        )
        if status == "written":
            write_text(output, text)
        elif status == "unchanged":
            os.utime(output)
    _show(common, status, certificate)


def _open(path: Path, kind: Kind) -> Artifact | Parts:
    """Voxels or a scene as parts, which are not joined; all else as a whole."""
    from alula.schemas.artifacts.kinds import COVER
    from alula.schemas.artifacts.parts import open_parts
    from alula.schemas.artifacts.parts_join import read_whole

    return read_whole(path, kind) if kind is COVER else open_parts(path, kind)


def prove(
    files: Mapping[str, Any], *, sha256: Mapping[str, str], jobs: int = 0, progress: Progress | None = None
) -> Certificate:
    """Prove the first of the files against the others, by the stage for its kind.

    Args:
        files: artifacts by role, the proven one first: `plan`, `seen`, `cover`, `voxels`, or `map`, an
            onboard map; `source` is a map as `read_imported` returns it.
        sha256: of the files, by role.
        jobs: threads; 0 is all processors.
        progress: called with (done, total).

    Raises:
        InputError: a file has another frame, or is too large.
    """
    from alula.stages.compression.onboard.verify import verify_map
    from alula.stages.compression.verify import verify, verify_voxels
    from alula.stages.planning.verify import verify_plan
    from alula.stages.planning.verify_seen import verify_seen

    (role, proven), *rest = files.items()
    against = dict(rest)
    if role == "plan":
        return verify_plan(proven, **against, sha256=sha256, jobs=jobs)
    stages = {"map": verify_map, "seen": verify_seen, "cover": verify, "voxels": verify_voxels}
    stage: Any = stages[role]
    certificate: Certificate = stage(proven, **against, sha256=sha256, jobs=jobs, progress=progress)
    return certificate


def _is_plan(path: Path) -> bool:
    """Test whether a file is a plan; the reader reports a file that cannot be read."""
    from alula.schemas.artifacts.artifact import read_manifest
    from alula.schemas.artifacts.kinds import PLAN
    from alula.schemas.errors import AlulaError
    from alula.schemas.files import is_special

    if is_special(path):
        return False
    try:
        return read_manifest(path).schema == PLAN.name
    except (AlulaError, OSError):
        return False


def _is_map(path: Path) -> bool:
    """Test whether a file begins like an onboard map; the reader reports a file that cannot be read."""
    from alula.schemas.files import is_special
    from alula.stages.compression.onboard.image import is_map

    if is_special(path):
        return False
    try:
        with path.open("rb") as file:
            return is_map(file.read(4))
    except OSError:
        return False


def _show(common: options.Common, status: str, certificate: Certificate) -> None:
    """Print the result on stdout: one JSON object, or a line per check."""
    import msgspec

    if common.json:
        print_json({"status": status, **msgspec.to_builtins(certificate)})
    elif not common.quiet:
        echo(certificate.statement)
        width = max(len(check.name) for check in certificate.checks)
        for check in certificate.checks:
            answer = "ok" if check.ok else f"{check.failed} failed"
            echo(f"  {check.name:<{width}}  {answer:<10} {check.checked:>9}  {check.detail}")
        echo(f"  outside the proof: {certificate.left_out}")
        for note in certificate.notes:
            echo(f"  note: {note}")
