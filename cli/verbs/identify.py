"""`identify`: a flight of steps on a real vehicle, and the vehicle file that they determine."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from alula.cli.shell.interruption import InterruptedWithAdvice
from alula.cli.shell.options import Common
from alula.cli.shell.present import echo
from alula.cli.shell.route import Route
from alula.cli.verbs.fly.conduct import Interrupts, failed_checks, is_of_vehicle, priority, signals, stop
from alula.cli.verbs.fly.contact import reach
from alula.schemas.errors import CheckError, LinkError, UsageError
from alula.schemas.parameters.configs.identify import IdentifyConfig

if TYPE_CHECKING:
    from alula.schemas.artifacts.provenance import Provenance
    from alula.schemas.scenarios.vehicle import Vehicle
    from alula.stages.flight.links.protocol import Link
    from alula.stages.flight.loop.control_loop import ControlLoop
    from alula.stages.identification.step_flight import StepFlight
    from alula.stages.identification.survey import Survey


def identify(
    address: str, config: IdentifyConfig, common: Common, *, route: Route, vehicle_name: str | None = None
) -> None:
    """Fly steps on the vehicle at an address, fit its response to them, and write its file.

    Raises:
        UsageError: the output exists, the box is too small, or options contradict one another.
        CheckError: a check does not hold, or the steps do not determine the lag.
        LinkError: the link or the vehicle failed.
        InterruptedWithAdvice: the flight was interrupted.
    """
    from alula.cli.shell.runner import check_output, input_ref
    from alula.schemas.artifacts.manifest import VERSION
    from alula.schemas.artifacts.provenance import Provenance, parameters_of
    from alula.schemas.scenarios.vehicle import VEHICLE_SCHEMA, contents
    from alula.schemas.scenarios.vehicles import vehicle_named
    from alula.stages.identification.survey import make_survey

    guess, paths = vehicle_named(vehicle_name)
    check_output(common.output, paths)
    if common.output.exists() and not (common.force or common.dry_run):
        raise UsageError(f"{common.output}: exists; use -f to replace it")
    make_survey(config, guess)  # before anything is sent
    link = route.link(
        address, guess, state_rate_hz=config.rate_hz, flies_rates=config.rates, watches_throttle=True
    )
    parameters = parameters_of(config) | {"vehicle": contents(guess)} | route.parameters(address)
    refs = [input_ref(role, path) for role, path in paths.items()]
    _fly(config, guess, link, Provenance.now(VEHICLE_SCHEMA, VERSION, parameters, None, refs), common)


def _fly(config: IdentifyConfig, guess: Vehicle, link: Link, provenance: Provenance, common: Common) -> None:
    from alula.schemas.log.foxglove import INFO, SceneUpdate
    from alula.stages.flight.loop.checks import FlightChecks
    from alula.stages.flight.loop.control_loop import ControlLoop
    from alula.stages.flight.recorder.channels import FlightHead
    from alula.stages.flight.recorder.log import FlightRecorder
    from alula.stages.identification.survey import (
        make_step_flight,
        make_step_guard,
        make_step_needs,
        make_step_options,
        make_survey,
    )
    from alula.stages.vehicles.own_limits import PARAMETERS
    from alula.stages.vehicles.setpoints import RatesSetpoint, VelocitySetpoint

    interrupts = Interrupts()
    head = FlightHead(
        name="identify",
        filter="none",
        vehicle=guess.name,
        frame="world",
        is_splat=False,
        log_every=1,
        radius_m=guess.body.radius_m,
        provenance=provenance,
        map_message=SceneUpdate(),
    )
    recorder = FlightRecorder(None, head, echo=not common.quiet, rate_hz=config.rate_hz)
    try:
        with signals(stop):
            contact = reach(link, str(provenance.parameters["link"]), quiet=common.quiet)
            if not {VelocitySetpoint, *([RatesSetpoint] if config.rates else [])} <= link.accepts:
                raise LinkError("identify needs a link that accepts velocities, with --rates also body rates")
            read: Any = getattr(link, "read_parameters", None)
            parameters: dict[str, float] = {} if read is None else read(PARAMETERS)
            survey = make_survey(config, guess, parameters)
            if not common.quiet:
                for words in survey.steps.skipped:
                    echo(f"left out: {words}", err=True)
            hover = getattr(link, "hover", None)
            steps = make_step_flight(
                survey,
                throttle=lambda: float("nan") if hover is None else hover.newest,
                say=lambda now_s, words: loop.say(now_s, INFO, f"step: {words}"),
            )
            loop = ControlLoop(
                link,
                steps,
                make_step_guard(survey, link.accepts),
                steps,
                FlightChecks(make_step_needs(survey), changed=contact.changed, trouble=contact.trouble),
                float(survey.centre[2]),
                recorder,
                make_step_options(survey, dry_run=common.dry_run),
                watchdog=contact.watchdog,
                interrupts=lambda: interrupts.number,
            )
            with signals(interrupts.count):
                with priority():
                    loop.run()
                link.close()
    finally:
        with signals(interrupts.count):  # an interrupt here would leave the vehicle's parameters changed
            link.close()
            recorder.finish(None)
            recorder.discard()
        for text in link.status.texts:
            echo(f"vehicle: {text}", err=True)
    _conclude(survey, steps, loop, (contact.said, parameters), provenance, common)


def _conclude(
    survey: Survey,
    steps: StepFlight,
    loop: ControlLoop,
    of_vehicle: tuple[str, dict[str, float]],
    provenance: Provenance,
    common: Common,
) -> None:
    """Raise the error that the flight ended with, or fit the steps and write the file."""
    from alula.cli.shell.runner import show
    from alula.schemas.atomic import write_text
    from alula.schemas.scenarios.vehicle import check_vehicle, contents, vehicle_text
    from alula.stages.flight.loop.supervisor import Event
    from alula.stages.identification.fit import fit
    from alula.stages.identification.result import disagreements, identified_vehicle
    from alula.stages.vehicles.own_limits import rate_notes

    cause = loop.supervision.cause
    if cause in (Event.INTERRUPT, Event.INTERRUPT_IN_AIR, Event.INTERRUPT_ON_GROUND):
        raise InterruptedWithAdvice("the flight ended early; no file was written")
    if loop.checks.result is not True:
        error = failed_checks(loop)
        is_away = any(
            verdict.name in ("start", "fence") and not verdict.holds for verdict in loop.checks.verdicts
        )
        raise error.reworded(f"{error}; here the plan is the box's centre") if is_away else error
    if cause is Event.CHECKS_PASSED_DRY:
        checks = {verdict.name: verdict.words for verdict in loop.checks.verdicts}
        show(
            common,
            "dry-run",
            {"steps": len(survey.steps.flown), "left_out": len(survey.steps.skipped)} | checks,
        )
        return
    if not loop.has_finished:
        words = f"the flight ended early, and no file was written: {loop.ending}"
        raise LinkError(words) if is_of_vehicle(loop) else CheckError(words)
    (said, parameters), config = of_vehicle, survey.config
    found = fit(steps.tape.recording(), survey.vehicle.body.gravity_m_s2)
    vehicle = identified_vehicle(
        survey.vehicle, found, config.speeds_m_s, name=config.name, autopilot=said, date=config.date
    )
    check_vehicle(vehicle)
    notes = disagreements(found, survey.vehicle, parameters)
    notes += rate_notes(parameters) if config.rates else []
    notes += [f"without a usable response: {name}" for name in found.left_out]
    if cause is not Event.PLAN_FINISHED:
        notes.append(f"all steps were flown, but: {loop.ending}")
    assert vehicle.velocities is not None
    assert vehicle.identified is not None
    summary: dict[str, Any] = contents(vehicle.velocities) | contents(vehicle.identified)
    write_text(common.output, vehicle_text(vehicle, [provenance.line()]))
    show(common, "written", summary | {"notes": notes})
