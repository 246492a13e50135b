"""`alula verify`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from alula.cli.shell import grouped, options
from alula.cli.shell.present import echo, print_json

if TYPE_CHECKING:
    from alula.schemas.artifacts.certificate import Certificate

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
@click.argument("proven", metavar="COVER", type=options.PATH)
@click.option("--cover", type=options.PATH, help="The cover that an onboard map must contain.")
@click.option("--map", "map_path", type=options.PATH, help="The cover or scene that a plan keeps away from.")
@click.option(
    "--allow-other-map",
    is_flag=True,
    help="Prove a plan against a map that it was not made in, nor in one of the same scene.",
)
@click.option("--within", type=options.PATH, help="Seen space (.seen.npz) that a plan stays in.")
@click.option("--voxels", type=options.PATH, help="The voxels that the cover must contain.")
@click.option("--scene", type=options.PATH, help="The scene that the voxels must contain.")
@click.option(
    "--source",
    type=options.PATH,
    help="The mesh, cloud or OctoMap that the voxels of import-voxels must contain.",
)
@click.option("--key", "key_path", type=options.PATH, help="Key that must have signed the index of tiles.")
@click.option(
    "--certificate",
    "listed",
    type=options.PATH,
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

    from alula.cli.shell import runner
    from alula.cli.shell.progress import shown_progress
    from alula.cli.verbs.verify import check_name, verify
    from alula.schemas.artifacts.certificate import certificate_text
    from alula.schemas.atomic import write_text
    from alula.schemas.errors import CheckError, UsageError

    if output is not None:
        check_name(output)
    elif depfile is not None:
        raise UsageError("--depfile needs a certificate to write; give -o")
    target = output if output is not None else Path("certificate")
    common = options.Common(target, force, dry_run, json, quiet, verbose, 0, jobs, depfile)
    step = verify.step(
        proven,
        voxels=voxels,
        scene=scene,
        source=source,
        cover=cover,
        map=map_path,
        within=within,
        allow_other_map=allow_other_map,
        key=key_path,
        certificate=listed,
        scheduler=scheduler,
        jobs=jobs,
    )
    if listed is not None:
        if output is not None:
            raise UsageError("--certificate compares with a certificate and writes none; leave out -o")
        _show(common, "checked", step.prove(lambda done, total: None))
        return
    inputs = step.paths()
    if output is not None:
        runner.check_output(output, inputs)
        if depfile is not None:
            runner.check_output(depfile, {**inputs, "output": output})
    provenance = step.provenance()
    step.check_map(provenance)
    known = output is not None and runner.current(output, provenance, force=force) is not None
    with shown_progress(common) as progress:
        certificate = step.prove(progress, provenance.inputs)
    try:
        step.require(certificate)
    except CheckError:
        _show(common, "failed", certificate)
        raise
    status = "checked"
    if output is not None:
        text = certificate_text(certificate, provenance)
        # An existing certificate is never trusted: it is compared with the new one.
        is_same = known and output.read_bytes() == text.encode()
        status = "dry-run" if dry_run else "unchanged" if is_same else "written"
        if status == "written":
            write_text(output, text)
        elif status == "unchanged":
            os.utime(output)
        runner.write_depfile(common, output, inputs.values())
    _show(common, status, certificate)


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
