"""Missions that `simulate` flies: a scenario, or a map or plan and what options say, with all its files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from alula.schemas.errors import UsageError

if TYPE_CHECKING:
    from alula.schemas.artifacts.artifact import Artifact
    from alula.schemas.artifacts.manifest import InputRef, Manifest
    from alula.schemas.artifacts.provenance import Provenance
    from alula.schemas.log.run import RunRecord
    from alula.schemas.scenarios.scenario import Scenario
    from alula.schemas.scenarios.vehicle import Vehicle
    from alula.stages.simulation.pairs import Pairs
    from alula.stages.simulation.simulate import WorldRun

MAPS = ("cover", "scene", "seen", "plan")  # roles of the artifacts of a mission
_ROLES = {"vehicle.file": "vehicle", "mission.pairs_from": "pairs"}  # of files whose keys are named otherwise


def scenario_of(
    source: Path,
    *,
    map_path: Path | None = None,
    scene_path: Path | None = None,
    vehicle: str | None = None,
    pairs_path: Path | None = None,
    planned: bool = False,
    filters: list[str] | None = None,
    speed_m_s: float | None = None,
    trials: int | None = None,
    seed: int | None = None,
    given: Mapping[str, Any] | None = None,
) -> Scenario:
    """The scenario that a source and options describe; options replace its values, `given` replaces them all.

    Args:
        source: scenario (.toml), cover, scene or plan.
        map_path: cover or scene to fly in.
        vehicle: name of a built-in vehicle, or a file.
        given: other values, by the path of their key.

    Raises:
        UsageError: options contradict one another, or a value is not one.
        InputError: a file cannot be read or is of another kind.
    """
    from alula.schemas.scenarios.scenario import changed, read_scenario
    from alula.schemas.scenarios.source import source_tree, vehicle_table

    changes: dict[str, Any] = {}
    if planned:
        changes["mission.planned"] = True
    if pairs_path is not None:
        changes["mission.pairs_from"] = _relative(pairs_path, source)
    if trials is not None:
        changes["rules.trials"] = trials
    if seed is not None:
        changes["rules.seed"] = seed
    others = dict(given or {})
    _check_paths(others, filters)
    if source.suffix == ".toml":
        from alula.cli.verbs.sources import map_files

        if map_path is not None:
            changes |= {
                f"world.{role}": _relative(path, source) for role, path in map_files(map_path).items()
            }
        if scene_path is not None:
            changes["world.scene"] = _relative(scene_path, source)
        if vehicle is not None:
            key, name = next(iter(vehicle_table(vehicle).items()))
            changes[f"vehicle.{key}"] = name if key == "type" else _relative(Path(name), source)
        if filters is not None:
            changes["safety.filters"] = filters
        if speed_m_s is not None:
            changes["mission.speed_m_s"] = speed_m_s
        return read_scenario(source, changes | others)
    from alula.cli.verbs.sources import source_files
    from alula.stages.filtering.registry import filter_kind

    files = source_files(source, map_path, scene_path)
    chosen = others.pop("safety.filters", filters)
    chosen = [chosen] if isinstance(chosen, str) else chosen
    tree = source_tree(files, filter_kind, filters=chosen, vehicle=vehicle, speed_m_s=speed_m_s)
    return changed(tree, str(source), changes | others)


def names_of(filters: str) -> list[str]:
    """Names of filters in their order; only the single name `none` flies without any.

    Args:
        filters: names with commas between them.

    Raises:
        UsageError: a name is empty, or `none` is not alone.
    """
    names = [name.strip() for name in filters.split(",")]
    if "" in names or ("none" in names and names != ["none"]):
        raise UsageError(f"--filter needs names of filters, or only none, not {filters!r}")
    return names


def _relative(path: Path, source: Path) -> str:
    """Name of a file as the scenario names it, relative to its folder; without a scenario, as it is."""
    inside = source.suffix == ".toml" and source.parent != Path()
    return str(path.resolve()) if inside and not path.is_absolute() else str(path)


def _check_paths(given: Mapping[str, Any], filters: list[str] | None) -> None:
    """Refuse names without a table, such as those of filters' parameters, and say their whole paths."""
    from alula.schemas.scenarios.text import keys_of

    for path in given:
        if "." in path or path == "name":
            continue
        likely = [key.path for key in keys_of() if key.path.rpartition(".")[2] == path]
        own = [key for key in likely if key.split(".")[1] in (filters or ())] or likely
        hint = f"is it {' or '.join(own[:3])}?" if own else "alula scenario --keys lists all"
        raise UsageError(f"--set {path}: needs the whole path of a key; {hint}")


@dataclass(frozen=True, slots=True)
class Trials:
    """All that the trials of a scenario depend on.

    Attributes:
        scenario: with all of its values.
        parameters: what a run records of both, without the names of files.
        pairs: start and goal of each trial, where they come from another run.
        pairs_run: record of that run.
    """

    scenario: Scenario
    vehicle: Vehicle
    parameters: dict[str, Any]
    seed: int
    paths: dict[str, Path]
    pairs: Pairs | None
    pairs_run: RunRecord | None = None

    @classmethod
    def of(cls, scenario: Scenario, source: Path) -> Trials:
        """Read what the scenario names besides maps.

        Args:
            source: file that it comes from; files that a .toml names lie beside it.

        Raises:
            InputError: a file cannot be read.
        """
        import msgspec

        from alula.schemas.log.run import read_run
        from alula.schemas.parameters.filter_options import TABLES
        from alula.schemas.scenarios.defaults import vehicle_of
        from alula.schemas.scenarios.scenario import FILES
        from alula.schemas.scenarios.vehicle import contents
        from alula.stages.simulation.pairs import pairs_flown

        folder = source.parent if source.suffix == ".toml" else Path()
        vehicle = vehicle_of(scenario, folder)
        # The content of files is hashed; their names have no influence on results.
        parameters = msgspec.json.decode(msgspec.json.encode(scenario), type=dict[str, Any])
        paths = {"scenario": source} if source.suffix == ".toml" else {}
        for key in FILES:
            table, name = key.split(".")
            if (file := parameters[table].pop(name)) is not None:
                paths[_ROLES.get(key, name)] = folder / file
        pairs = pairs_run = None
        if "pairs" in paths:
            pairs_run = read_run(paths["pairs"])
            pairs = pairs_flown(pairs_run.trials, scenario.rules.trials)
        dropped = ("schema", "version", "fly")
        parameters = {key: value for key, value in parameters.items() if key not in dropped}
        parameters["vehicle_file"] = contents(vehicle)
        # Without filters, those two say how encounters and flights in a fence are measured.
        told = scenario.safety.filters or ("dr-acbf", "geofence")
        safety = parameters["safety"]
        safety |= safety.pop("others")
        shown = ("filters", *(TABLES.get(name, name) for name in told))
        parameters["safety"] = {name: safety[name] for name in shown if name in safety}
        seed = parameters["rules"].pop("seed")
        return cls(scenario, vehicle, parameters, seed, paths, pairs, pairs_run)

    def summary_of(self, flown: WorldRun, provenance: Provenance, cover: Artifact | None) -> dict[str, Any]:
        """Summary of a run; notes say how it differs from that of its pairs, and its cover from its scene."""
        from alula.stages.simulation.certificate import misfits
        from alula.stages.simulation.summary import world_summary, world_words
        from alula.stages.unlike import Flown, unlike, unlike_words

        summary = world_summary(flown)
        notes = misfits(flown, cover, provenance.inputs)
        if self.pairs_run is not None:
            found = unlike(self.pairs_run, Flown(world_words(flown.scenario, flown.vehicle), provenance))
            notes.append(unlike_words(found, self.paths["pairs"].name, "this run"))
        if notes := [note for note in notes if note]:
            summary["notes"] = [*notes, *summary.get("notes", ())]
        return summary

    def read(self, role: str) -> Artifact | None:
        """Read one of the files that is an artifact; None where the scenario names none.

        Raises:
            InputError: the file cannot be read, or is of another kind.
        """
        from alula.schemas.artifacts.kinds import COVER, PLAN, SCENE, SEEN
        from alula.schemas.artifacts.parts_join import read_whole

        kinds = {"cover": COVER, "scene": SCENE, "seen": SEEN, "plan": PLAN}
        return read_whole(self.paths[role], kinds[role]) if role in self.paths else None

    def note_of_map(self, manifest: Manifest, refs: Sequence[InputRef]) -> str | None:
        """A note where the map is of the plan's scene but not the file that it was made in.

        Args:
            refs: files of the run, and what is known of their origins.

        Raises:
            InputError: the plan was made in another map, and the scenario does not allow it.
        """
        from alula.schemas.artifacts.lineage import require_own_map

        return require_own_map(
            self.paths["plan"],
            manifest,  # type: ignore[arg-type]
            refs,
            [path.parent for path in self.paths.values()],
            allow_other=self.scenario.mission.allow_other_map,
            insist="--set mission.allow_other_map=true",
        )
