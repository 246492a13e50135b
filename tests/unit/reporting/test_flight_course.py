"""Reports on the course of a real flight: its states, its end, and its path without a verdict."""

import msgspec
import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.log.channels import Supervisor
from alula.schemas.log.cut import read_logged
from alula.schemas.log.flights import Course, Line, Step, flights_of
from alula.schemas.log.foxglove import Log, SceneEntity, SceneUpdate, Time
from alula.stages.flight.recorder.log import FlightRecorder
from alula.stages.reporting.brief import brief
from alula.stages.reporting.curves import broken, paths_of, spells
from alula.stages.reporting.flight_curves import worst_flights
from alula.stages.reporting.headline import headline
from alula.stages.reporting.material import NOT_JUDGED, Material, Run
from alula.stages.reporting.tables import all_tables, course_rows, course_tables
from alula.stages.show.still import draw
from support.flights.flight_logs import head_of, record_of
from support.flights.flights import fly, mission
from support.scenes.fabricate import make_record, make_trial

COURSE = Course(
    (
        Step(0.0, "checks", "start", "run the checks"),
        Step(2.0, "fly", "take-off height reached", "take control"),
        Step(3.0, "hold", "state too old", "hold"),
        Step(3.5, "hold", "order refused", "hold"),
        Step(4.0, "fly", "all is well again", "take control"),
        Step(9.0, "done", "disarmed", "nothing"),
    ),
    (Line(0.5, 2, "check level: holds"), Line(3.0, 3, "state too old: holding")),
    9.0,
)


def run_of(log):
    found = read_logged(log)
    return Run("f", found.record, found.flights.by_trial, found.flights.hulls, found.flights.course)


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    log, made = tmp_path_factory.mktemp("flown") / "f.run.mcap", mission()
    recorder = FlightRecorder(log, head_of(made), echo=False)
    loop, _ = fly(made, recorder=recorder)
    assert recorder.finish(record_of(made, loop, recorder))
    return log, loop


def test_times_of_messages_count_from_the_start():
    start = 1_777_636_800_750_000_000
    map_ = SceneUpdate(entities=[SceneEntity(timestamp=Time.of(start), frame_id="world", id="map")])
    line = Log(Time.of(start + 2_500_000_000), 2, "words", "fly")
    step = Supervisor(time_s=0.0, state=1, state_name="checks", event_name="start")
    found = [("/map", map_), ("/log", line), ("/supervisor", step)]
    course = flights_of([(topic, msgspec.json.encode(message)) for topic, message in found]).course
    assert course.lines == (Line(pytest.approx(2.5, abs=1e-9), 2, "words"),)


def test_states_follow_one_another_and_those_that_stay_are_one():
    found = spells(COURSE)
    assert [(one.state, one.begin_s, one.end_s) for one in found] == [
        ("checks", 0.0, 2.0),
        ("fly", 2.0, 3.0),
        ("hold", 3.0, 4.0),
        ("fly", 4.0, 9.0),
    ]
    assert spells(None) == ()
    assert spells(Course((COURSE.steps[0],), (), 1.5))[0].end_s == 1.5  # a log that was cut


def test_tables_have_every_step_and_every_line():
    simulated, real = (
        Run("s", make_record([make_trial(0)])),
        Run("r", make_record([make_trial(0)]), course=COURSE),
    )
    steps, messages = course_tables([simulated, real])
    assert (steps.name, messages.name) == ("course-2", "messages-2")
    assert steps.rows[2] == (3.0, "state too old", "hold", "hold")
    assert len(steps.rows) == 6
    assert [row[1:] for row in messages.rows] == [
        ("", "check level: holds"),
        ("warning", "state too old: holding"),
    ]
    assert course_tables([simulated]) == []
    assert course_rows({"trials": 1}) == {}
    assert course_rows({"ended_by": "battery low", "holds": 2})["ended by"] == "battery low"


def test_a_real_flight_is_reported_with_states_end_and_verdict(flown):
    log, loop = flown
    material = Material("t", (run_of(log),))
    course = material.runs[0].course
    assert [step.state for step in course.steps] == [taken.step.state.value for _, taken in loop.taken]
    assert {"checks", "take-off", "fly", "land"} <= {spell.state for spell in spells(course)}
    tables = {table.name: table for table in all_tables(material)}
    assert tables["course"].rows[-1][1:3] == ("disarmed", "done")
    assert any("check clearance: holds" in row[2] for row in tables["messages"].rows)
    rows = dict(row[:2] for row in tables["runs"].rows)
    assert (rows["ended by"], rows["holds"]) == ("plan finished", 0)
    assert rows["minimum clearance to the hulls [m]"] > 0
    assert headline(material)["ended_by"] == "plan finished"
    shown = brief(material)
    assert (shown.verdict, shown.tone) == ("The flight reached the goal and touched nothing.", "good")
    assert [number.key for number in shown.subjects[0].numbers][-1] == "max_tracking_error_m"
    figures = {figure.name: figure for figure in draw(material)}
    assert figures.keys() == {"still", "flight-1", "map-1"}  # a single flight is no distribution
    assert "take-off" in figures["flight-1"].svg
    assert "States of the supervisor: checks 0.00 to" in figures["flight-1"].alt


def test_a_flight_that_was_cut_is_drawn_without_a_verdict(flown, tmp_path):
    whole = flown[0].read_bytes()
    log = tmp_path / "cut.run.mcap"
    log.write_bytes(whole[: len(whole) * 3 // 4])
    found = run_of(log)
    assert found.record.trials == []
    (path,) = paths_of(found)
    assert path.outcome == NOT_JUDGED
    assert len(path.position_world) > 50
    shown = brief(Material("t", (found,)))
    assert shown.tone == "bad"
    assert shown.verdict.startswith("Not judged: the log of this flight was cut")
    assert shown.subjects[0].numbers == ()
    (drawn,) = worst_flights(Material("t", (found,)))
    assert (drawn.outcome, drawn.closest_m) == (None, None)
    assert run(["report", str(log), "-o", str(tmp_path / "cut.html"), "-q"]) == 0
    page = (tmp_path / "cut.html").read_text()
    assert "1 not judged" in page
    assert "Course of cut (cut)" in page


def test_no_line_is_drawn_over_a_time_without_answers():
    time_s = np.array([0.0, 0.01, 0.02, 1.5, 1.51])
    at, values = broken(time_s, np.arange(5.0))
    np.testing.assert_array_equal(values, [0, 1, 2, np.nan, 3, 4])
    np.testing.assert_array_equal(at, [0.0, 0.01, 0.02, 0.02, 1.5, 1.51])
    assert broken(time_s[:1], np.ones(1))[1].tolist() == [1.0]
    assert len(broken(np.arange(0, 50, 0.5), np.ones(100))[0]) == 100  # a log of few samples has no gaps


def test_a_tick_without_numbers_is_no_step():
    tick = Supervisor(time_s=1.0, state=4, state_name="fly")
    found = flights_of([("/supervisor", msgspec.json.encode(tick))])
    assert found.course == Course((), (), 1.0)
    assert flights_of([]).course is None
