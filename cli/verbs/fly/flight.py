"""Flight of `alula fly`: open the link, fly, close the link, write log and record."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from alula.cli.shell.interruption import InterruptedWithAdvice
from alula.cli.shell.options import Common
from alula.cli.shell.present import echo
from alula.cli.verbs.fly.conduct import Interrupts, failed_checks, is_of_vehicle, priority, signals, stop
from alula.cli.verbs.fly.contact import reach
from alula.schemas.errors import CheckError, LinkError, OutputError

if TYPE_CHECKING:
    from alula.schemas.artifacts.provenance import Provenance
    from alula.schemas.log.run import TrialResult
    from alula.stages.flight.links.protocol import Link
    from alula.stages.flight.loop.control_loop import ControlLoop
    from alula.stages.flight.mission import PlannedFlight
    from alula.stages.flight.recorder.channels import FlightHead
    from alula.stages.flight.recorder.log import FlightRecorder
    from alula.stages.flight.recorder.pipe import FlightPipe

_CLOSE_S = 2.0  # maximum time until the live view ends
_SHOWN = ("rate_hz", "ticks", "tick_p99_s", "lateness_p99_s", "overruns", "dropped_samples")


class _Flown(NamedTuple):
    """Verdict on a flight, if there is one, and messages about an incomplete log or record."""

    trial: TrialResult | None
    trouble: list[str]


def fly(
    mission: PlannedFlight,
    link: Link,
    provenance: Provenance,
    common: Common,
    live: int | None = None,
    foxglove: int | None = None,
    start_ns: int | None = None,
    paths: Mapping[str, Path] | None = None,
) -> None:
    """Fly a mission over a link.

    Args:
        link: to the vehicle; not yet open.
        start_ns: log time of the start, nanoseconds since 1970-01-01 UTC; None: by this machine's clock.
        paths: files of plan and maps by role, for new plans in flight and for the live view; None for none.

    Raises:
        CheckError: a check failed, or the plan was not finished.
        LinkError: the link or the vehicle failed.
        KeyboardInterrupt: the operator ended the flight.
        OutputError: the flight went well, but its log or record is not complete.
    """
    from alula.stages.flight.loop.checks import FlightChecks
    from alula.stages.flight.loop.control_loop import ControlLoop
    from alula.stages.flight.mission import (
        head_facts,
        make_clock,
        make_commander,
        make_guard,
        make_needs,
        make_options,
        wanted_setpoints,
    )
    from alula.stages.flight.recorder.channels import FlightHead
    from alula.stages.flight.recorder.log import FlightRecorder
    from alula.stages.flight.replan.of_mission import make_planner, make_replanner
    from alula.stages.runlog.cloud import cloud_message
    from alula.stages.runlog.maps import map_message

    interrupts = Interrupts()
    planner = None if common.dry_run or paths is None else make_planner(mission, paths)
    frame, points = mission.map.manifest.frame, _points(mission)
    head = FlightHead(
        provenance=provenance,
        map_message=map_message(mission.map, {"sigma": mission.config.sigma}, [points], frame, 0),
        cloud=None
        if mission.world.static.scene is None
        else cloud_message(mission.world.static.scene, [points], frame, 0),
        plan=points.tolist(),
        **head_facts(mission),
    )
    views = _open_views(live, foxglove, mission, head, paths or {}, common)
    recorder = FlightRecorder(
        None if common.dry_run else common.output,
        head,
        replaces=common.force,
        echo=not common.quiet,
        views=views,
        rate_hz=mission.config.rate_hz,
        start_ns=start_ns,
    )
    # From here on messages are sent to the vehicle; everything that takes long has been done.
    try:
        with signals(stop):
            contact = reach(link, str(provenance.parameters.get("link", "")), quiet=common.quiet)
            if planner is not None and link.status.own_safety is not None:
                planner.know(link.status.own_safety)
            checks = FlightChecks(
                make_needs(mission, wanted_setpoints(mission)),
                changed=contact.changed,
                trouble=contact.trouble,
                by_hand=mission.config.frame_check == "hand",
            )
            loop = ControlLoop(
                link,
                make_commander(mission, link.accepts),
                make_guard(mission, link.accepts),
                make_clock(mission),
                checks,
                float(mission.start[2]),
                recorder,
                make_options(mission.config, dry_run=common.dry_run),
                watchdog=contact.watchdog,
                replanner=None if planner is None else make_replanner(mission, planner),
                interrupts=lambda: interrupts.number,
            )
            with signals(interrupts.count):
                with priority():
                    loop.run()
                link.close()
                _report_texts(link, recorder, loop.taken[-1][0] if loop.taken else 0.0)
                flown = _finish(mission, loop, recorder, provenance, common)
    except BaseException:
        with signals(interrupts.count):  # an interrupt here would leave the vehicle's parameters changed
            link.close()
        _report_texts(link, recorder, 0.0)
        recorder.finish(None)
        recorder.discard()
        raise
    finally:
        for view in views:
            view.close(_CLOSE_S)
        if planner is not None:
            planner.close()
    _conclude(loop, flown, common)


def _report_texts(link: Link, recorder: FlightRecorder, time_s: float) -> None:
    """Report what the link found at its end: parameters that could not be restored, and their values."""
    from alula.schemas.log.foxglove import WARNING

    for text in link.status.texts:
        recorder.say(time_s, WARNING, f"vehicle: {text}")
    link.status.texts.clear()


def _open_views(
    live: int | None,
    foxglove: int | None,
    mission: PlannedFlight,
    head: FlightHead,
    paths: Mapping[str, Path],
    common: Common,
) -> list[FlightPipe]:
    from alula.stages.flight.recorder.foxglove_server import open_foxglove

    views = []
    try:
        if live is not None:
            views.append(_open_view(live, mission, head, paths, common))
        if foxglove is not None:
            server, address = open_foxglove(foxglove, head)
            views.append(server)
            if not common.quiet:
                echo(f"Foxglove: {address}", err=True)
    except BaseException:
        for view in views:
            view.close(_CLOSE_S)
        raise
    return views


def _open_view(
    port: int, mission: PlannedFlight, head: FlightHead, paths: Mapping[str, Path], common: Common
) -> FlightPipe:
    """Start the live view with the map, the plan and the names in the log's head, and the splat's file."""
    from alula.stages.flight.recorder.live_view import ViewHead, open_view

    facts = ViewHead(
        name=head.name,
        filter=head.filter,
        vehicle=head.vehicle,
        radius_m=mission.world.vehicle.body.radius_m,
        map_message=head.map_message,
        plan=head.plan,
        rotors_m=[]
        if mission.world.vehicle.rotors is None
        else list(mission.world.vehicle.rotors.positions_m),
        files=[str(paths[role]) for role in ("scene", "plan") if role in paths],
        fence=None if mission.config.fence is None else list(mission.config.fence),
        stale_s=mission.config.stale_s,
    )
    view, address = open_view(port, facts)
    if not common.quiet:
        echo(f"live view: {address}", err=True)
    return view


def _points(mission: PlannedFlight) -> Any:
    """Points of the plan every 0.1 s, shape (T, 3), world frame [m]."""
    from alula.stages.planning.plan_samples import sample_plan

    return sample_plan(mission.plan, 0.1)


def _finish(
    mission: PlannedFlight,
    loop: ControlLoop,
    recorder: FlightRecorder,
    provenance: Provenance,
    common: Common,
) -> _Flown:
    """Complete the log and write the record; a flight that never took off leaves neither."""
    import msgspec

    from alula.cli.shell.run_files import record_text
    from alula.cli.shell.runner import show
    from alula.schemas.artifacts.artifact import encode_artifact
    from alula.schemas.atomic import atomic_output
    from alula.schemas.log.run import RunRecord, record_path
    from alula.stages.flight.judge import guarantee_of, judge, summary_of, timing_of
    from alula.stages.flight.mission import describe

    rows, log = recorder.rows, common.output
    timing = timing_of(loop.counters, recorder.dropped, mission.config.rate_hz)
    if len(rows) == 0:
        is_whole = recorder.finish(None)
        recorder.discard()
        if common.dry_run and loop.checks.result:
            show(common, "dry-run", {v.name: v.words for v in loop.checks.verdicts} | timing)
        if not recorder.has_flown:
            return _Flown(None, [])
        if not common.quiet:
            echo(f"{recorder.where}: log of a take-off without a flight; it has no verdict", err=True)
        return _Flown(None, [] if is_whole else [_cut(recorder.where)])
    for number, (time_s, plan) in enumerate(loop.joined, 1):
        recorder.attach(f"new-{number}.plan.npz", time_s, encode_artifact(plan))
    new_plans = len(loop.joined)
    trial = judge(mission, rows, loop.supervision.cause, common.jobs, loop.joined)
    summary = summary_of(trial, loop.supervision, loop.taken, new_plans)
    if mission.notes:
        summary["notes"] = mission.notes
    record = RunRecord.of(
        provenance,
        name=mission.config.name,
        filter=mission.config.filter,
        vehicle=describe(mission),
        trials=[trial],
        summary=summary,
        guarantee=guarantee_of(mission, trial, new_plans),
    )
    trouble = [] if recorder.finish(record) else [_cut(recorder.where)]
    if trouble:
        summary = summary | {"notes": [*mission.notes, "the log is not complete: its writer failed"]}
        record = msgspec.structs.replace(record, summary=summary)
    if recorder.where != log:
        trouble.append(f"{log}: could not be replaced; the log of this flight is {recorder.where}")
    timing = timing_of(loop.counters, recorder.dropped, mission.config.rate_hz)
    if recorder.is_viewed:
        timing |= {"unseen_samples": recorder.unseen}
    try:
        with atomic_output(record_path(log)) as beside:
            beside.write(record_text(record, timing))
    except OutputError as error:  # the result of the flight is still shown
        trouble.append(str(error))
    show(common, "written", summary | {key: timing[key] for key in _SHOWN if key in timing})
    return _Flown(trial, trouble)


def _cut(log: Path | None) -> str:
    return f"{log}: the log was cut because its writer failed; it is readable up to its last complete chunk"


def _conclude(loop: ControlLoop, flown: _Flown, common: Common) -> None:
    """Raise the error that the flight ended with; see `fly`."""
    from alula.stages.flight.loop.supervisor import Event
    from alula.stages.planning.adherence import complaint

    cause, trial = loop.supervision.cause, flown.trial
    trouble = "; ".join(flown.trouble)
    missed = None if trial is None else complaint(trial.plan)
    is_well = cause is Event.PLAN_FINISHED and trial is not None and not trial.collision and missed is None
    if trouble and is_well:
        raise OutputError(f"the flight went well, but {trouble}")
    if trouble:
        echo(trouble, err=True)
    if is_well or cause is Event.CHECKS_PASSED_DRY:
        return
    if cause in (Event.INTERRUPT, Event.INTERRUPT_IN_AIR, Event.INTERRUPT_ON_GROUND):
        raise InterruptedWithAdvice("the flight ended early")
    if loop.checks.result is not True:
        raise failed_checks(loop)
    if loop.has_finished and cause is Event.LANDED_AWAY:
        raise CheckError(f"{common.output}: the plan was flown, but the vehicle {loop.ending}")
    if loop.has_finished and cause is not Event.PLAN_FINISHED:
        raise LinkError(f"the plan was flown, but not landed as planned: {loop.ending}")
    if is_of_vehicle(loop):
        raise LinkError(f"the flight ended early: {loop.ending}")
    if cause is not Event.PLAN_FINISHED:
        raise CheckError(f"{common.output}: the plan was not finished: {loop.ending}")
    if trial is not None and trial.collision:
        raise CheckError(f"{common.output}: the flight came closer to the map than the vehicle's radius")
    raise CheckError(f"{common.output}: the plan was flown, but {missed}")
