"""What a report says is guaranteed, in plain words, and the exact statements behind it."""

from __future__ import annotations

from alula.schemas.parameters.flight_defaults import NO_FILTER
from alula.stages.reporting.fenced import is_fenced
from alula.stages.reporting.material import NOT_JUDGED, Material, coverage, elsewhere, omitted
from alula.stages.reporting.plain import deviations
from alula.stages.reporting.table import text

GUARANTEES = "Guarantees and their limits"  # heading in every format


def guarantees(material: Material) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Proofs and checks of a report, and their limits, in plain words; equal lines once."""
    proofs, limits = [], []
    covered = coverage(material.certificate)
    if covered is True or covered == "in part":
        level = material.certificate.get("level") if material.certificate is not None else None
        sigma = level.get("sigma") if isinstance(level, dict) else None
        imported = level.get("imported") if isinstance(level, dict) else None
        size = f" up to {deviations(sigma)}" if isinstance(sigma, int | float) else ""
        what = f"every Gaussian of the scan{size}"
        if isinstance(imported, dict):
            what = f"the whole {text(imported.get('kind'))} that was imported"
        missing = "; ".join(omitted(material.certificate))
        proofs.append(f"Proven: {what} lies inside the map{', except ' * bool(missing)}{missing}.")
    elif covered == "voxels only":
        proofs.append("Proven: every voxel of the scan lies inside the map. The scan itself was not checked.")
    elif covered is False:
        limits.append("The map leaves out obstacles that the scan shows.")
    elif material.cover is not None:
        limits.append("This report has no certificate of alula verify that the map covers the scan.")
    for run in material.runs:
        claims, trials = run.record.guarantee.claims, run.record.trials
        touched = sum(trial.collision for trial in trials)
        if others := elsewhere(run, material):
            limits.append(
                f"{run.label} flew in another {' and another '.join(others)} than this report is about: what "
                "is proven here says nothing about its flights."
            )
        if claims.get("plan_certified") is True:
            proofs.append(
                "Proven before take-off: the plan keeps clear of the map that the statement below names."
            )
        if touched and (claims.get("proven_by_filter") or claims.get("every_step_certified")):
            limits.append(
                f"The proofs of {run.label} do not cover what its flights touched: see its statement below."
            )
        elif claims.get("proven_by_filter") is True:
            proofs.append(
                f"Proven beforehand: {run.record.filter} lets the vehicle touch no hull of the map, under "
                "the conditions of its statement below."
            )
        elif claims.get("every_step_certified") is True:
            against = claims.get("certified_against")
            parts = " and ".join(map(str, against)) if isinstance(against, list) and against else "the map"
            proofs.append(f"Proven at each step of {run.label}: a manoeuvre clear of {parts} remained.")
        elif run.record.trials and run.record.filter != NO_FILTER:
            limits.append(f"No proof beforehand says that {run.record.filter} keeps these flights clear.")
        chain = claims.get("chain")
        if isinstance(chain, dict) and chain.get("holds") is True and not touched:
            proofs.append(
                f"Proven for {run.label} where the map covers the scan: its flights met nothing of the scan, "
                "under the assumptions of its statement."
            )
        elif isinstance(chain, dict) and isinstance(broken := chain.get("broken_by"), list) and broken:
            limits.append(f"Nothing is proven of {run.label} and the scan: {' '.join(map(str, broken))}")
        if run.record.trials and claims.get("continuous_time") is True:
            proofs.append("Checked after the flights: every distance, along the whole path, not by samples.")
        elif run.record.trials and "ended_by" in run.record.summary:
            proofs.append("Checked after the flight: the path that the vehicle measured.")
            limits.append("Errors of the vehicle's own position are not covered.")
        elif not run.record.trials:
            limits.append(f"{run.label} is {NOT_JUDGED}.")
    if material.certificate is not None and (left_out := material.certificate.get("left_out")):
        limits.append(f"The map leaves out, on purpose: {left_out}.")
    scanned = (t.map_clearance_m is not None for run in material.runs for t in run.record.trials)
    if material.cover is not None or (not any(map(is_fenced, material.runs)) and any(scanned)):
        limits.append("What the scan does not show is not in the map: glass, thin wires, what moved since.")
    return tuple(dict.fromkeys(proofs)), tuple(dict.fromkeys(limits))


def statements(material: Material) -> list[tuple[str, str]]:
    """The exact statements, by subject; equal ones of several runs together."""
    found = []
    if material.cover is not None and material.cover.manifest.guarantee is not None:
        found.append(("The map", material.cover.manifest.guarantee.statement))
    by_statement: dict[str, list[str]] = {}
    for run in material.runs:
        if statement := run.record.guarantee.statement:
            by_statement.setdefault(statement, []).append(run.label)
    return found + [(", ".join(labels), statement) for statement, labels in by_statement.items()]
