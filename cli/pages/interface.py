"""The reference page of the Python interface: which functions and classes are public."""

from __future__ import annotations

PUBLIC: dict[str, tuple[str, tuple[str, ...]]] = {
    "import alula": (
        "Functions named like the commands, for scripts and notebooks; how-to guide: "
        "[Use alula from Python](../howto/python.md). Keyword arguments are the options of the command; "
        "`help` lists them.",
        (
            "cli.verbs.read.read",
            "cli.verbs.import_splat.import_splat",
            "cli.verbs.align.align",
            "cli.verbs.voxelize.voxelize",
            "cli.verbs.observe.observe",
            "cli.verbs.merge.merge",
            "cli.verbs.verify.verify",
            "cli.verbs.plan.plan",
            "cli.verbs.simulate.simulate",
            "cli.verbs.report.report",
            "cli.verbs.view.view",
            "cli.verbs.results.Result",
            "cli.verbs.results.Cover",
            "cli.verbs.results.Plan",
            "cli.verbs.verify.Proof",
            "cli.verbs.runs.Run",
            "cli.verbs.pages.Page",
        ),
    ),
    "Stages": (
        "Functions from values to values, without files, clock or output. Each is named like its command.",
        (
            "stages.reconstruction.demo_scene.demo_scene",
            "stages.reconstruction.import_splat.import_splat",
            "stages.alignment.scale_align.scale_align",
            "stages.alignment.scale_align.scale_only",
            "stages.compression.voxelize.voxelize",
            "stages.planning.observe.observe",
            "stages.compression.merge.merge",
            "stages.compression.verify.verify",
            "stages.planning.plan.plan",
            "stages.planning.verify.verify_plan",
            "stages.simulation.simulate.simulate_world",
            "stages.simulation.summary.world_summary",
            "stages.export.export.export",
        ),
    ),
    "Reading and writing files": (
        "Readers refuse what is damaged, of another kind or too new, with an error of one line.",
        (
            "stages.reconstruction.formats.registry.read_splats",
            "schemas.artifacts.artifact.Artifact",
            "schemas.artifacts.artifact.read_artifact",
            "schemas.artifacts.artifact.read_manifest",
            "schemas.artifacts.artifact.make_artifact",
            "schemas.artifacts.artifact.write_artifact",
            "schemas.log.run.read_run",
            "schemas.log.flights.read_flights",
            "schemas.log.flights.Flight",
            "schemas.scenarios.vehicle.read_vehicle",
            "schemas.scenarios.mission.read_mission",
            "schemas.scenarios.scenario.read_scenario",
            "schemas.scenarios.scenario.decoded",
        ),
    ),
    "Safety filters": (
        "A filter of your own has the methods of `SafetyFilter`; "
        "[Write a filter of your own](../howto/own-filter.md). `alula.filtering` has what it is made of.",
        (
            "stages.filtering.registry.make_filter",
            "stages.filtering.protocol.SafetyFilter",
            "stages.filtering.protocol.FlightState",
            "stages.filtering.protocol.Nominal",
            "stages.filtering.protocol.FilterResult",
            "stages.filtering.protocol.FilterStatus",
            "stages.filtering.protocol.FilterWorld",
        ),
    ),
    "Errors": (
        "Every error that a user can act on is an `AlulaError`; each class has the exit code of the command.",
        ("schemas.errors",),
    ),
}
"""The public names by subject: what the subject has in common, and the names below `alula`."""


def interface_page() -> str:
    """The page for mkdocstrings: a directive for each public name."""
    parts = [
        """# Python interface

Use alula as a library with the functions and classes of this page. `examples/library/fly_a_scene.py` takes a
splat to judged flights in 20 lines. Array arguments state shape, frame and unit. Other functions may change
without notice.
"""
    ]
    for subject, (what, names) in PUBLIC.items():
        parts.append(f"## {subject}\n\n{what}\n")
        parts += [f"::: alula.{name}\n" for name in names]
    return "\n".join(parts)
