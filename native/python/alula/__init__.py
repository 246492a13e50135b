"""alula: from a Gaussian splat to a safe flight.

The functions are named like the commands, take files or results, and return results that show what they are:

    scene = alula.align(alula.import_splat("room.ply"), scale=2.7)
    cover = alula.merge(alula.voxelize(scene, size_m=0.05), hulls=300)
    alula.verify(cover, scene=scene)
    start, goal = cover.free_points(2)
    run = alula.simulate(alula.plan(cover, start=start, goal=goal), map=cover)

They are imported when they are first used, so that `import alula` takes milliseconds.
"""

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from alula.cli.verbs.align import align
    from alula.cli.verbs.import_splat import import_splat
    from alula.cli.verbs.import_voxels import import_voxels
    from alula.cli.verbs.merge import merge
    from alula.cli.verbs.observe import observe
    from alula.cli.verbs.pages import Page
    from alula.cli.verbs.plan import plan
    from alula.cli.verbs.read import read
    from alula.cli.verbs.report import report
    from alula.cli.verbs.results import Cover, Plan, Scene, Seen, Voxels
    from alula.cli.verbs.runs import Run
    from alula.cli.verbs.simulate import simulate
    from alula.cli.verbs.verify import Proof, verify
    from alula.cli.verbs.view import view
    from alula.cli.verbs.voxelize import voxelize
    from alula.schemas.errors import AlulaError, CheckError, InfeasibleError, InputError, UsageError
    from alula.stages.filtering import public as filtering

_PLACES = {
    "cli.verbs.read": ("read",),
    "cli.verbs.voxelize": ("voxelize",),
    "cli.verbs.merge": ("merge",),
    "cli.verbs.verify": ("verify", "Proof"),
    "cli.verbs.runs": ("Run",),
    "cli.verbs.simulate": ("simulate",),
    "cli.verbs.pages": ("Page",),
    "cli.verbs.report": ("report",),
    "cli.verbs.view": ("view",),
    "cli.verbs.align": ("align",),
    "cli.verbs.import_splat": ("import_splat",),
    "cli.verbs.import_voxels": ("import_voxels",),
    "cli.verbs.observe": ("observe",),
    "cli.verbs.plan": ("plan",),
    "cli.verbs.results": ("Scene", "Voxels", "Seen", "Cover", "Plan"),
    "schemas.errors": ("AlulaError", "UsageError", "InputError", "CheckError", "InfeasibleError"),
}

__all__ = [
    "AlulaError",
    "CheckError",
    "Cover",
    "InfeasibleError",
    "InputError",
    "Page",
    "Plan",
    "Proof",
    "Run",
    "Scene",
    "Seen",
    "UsageError",
    "Voxels",
    "align",
    "filtering",
    "import_splat",
    "import_voxels",
    "merge",
    "observe",
    "plan",
    "read",
    "report",
    "simulate",
    "verify",
    "view",
    "voxelize",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    from importlib import import_module

    if name == "filtering":
        found = globals()[name] = import_module("alula.stages.filtering.public")
        return found
    for place, names in _PLACES.items():
        if name in names:
            found = globals()[name] = getattr(import_module(f"alula.{place}"), name)
            return found
    raise AttributeError(f"module 'alula' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*__all__, "__version__", "__doc__"})
