"""What the live view sends to the browser shows the vehicle's words and runs none of them."""

from html.parser import HTMLParser
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from alula.schemas.log.channels import Supervisor
from alula.schemas.log.foxglove import SceneUpdate
from alula.stages.flight.loop.supervisor import Event
from alula.stages.flight.recorder.live_view import ViewHead, _View
from alula.stages.flight.recorder.samples import LineSample, PlanSample, StepSample, encoded
from support.flights.flight_logs import sample

OURS = {"p", "b", "table", "tr", "td", "ul", "li"}
HOSTILE = (
    "<script>fetch('//evil')</script>",
    "<img src=x onerror=alert(1)>",
    "</li></ul><iframe srcdoc='<script>alert(1)</script>'>",
    "[x](javascript:alert(1)) ![y](/etc/passwd) {alert(1)}",
    "| a | b |\n| --- | --- |\n# c\nexport const d = alert(1)",
    "\x1b]8;;http://evil\x07\u202e&lt;script&gt;",
)


class Page(HTMLParser):
    """Tags, attributes and text of a page."""

    def __init__(self, content: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: set[str] = set()
        self.attributes: list[object] = []
        self.text = ""
        self.feed(content)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.attributes += attrs

    def handle_data(self, data):
        self.text += data


def contents(words: str, monkeypatch) -> list[str]:
    """All text that the view gives to viser for hostile names, modes, states and messages."""
    monkeypatch.setattr("alula.stages.flight.recorder.live_view._TEXT_S", -1.0)
    server = MagicMock()
    server.gui.add_html.return_value = SimpleNamespace(content="")
    head = ViewHead(
        name=words,
        filter=words,
        vehicle=words,
        radius_m=0.1,
        map_message=SceneUpdate(),
        plan=[(0.0, 0.0, 1.0), (1.0, 0.0, 1.0)],
    )
    view = _View(server, head)
    view.take(encoded(step(words, "e", words)))
    view.take(encoded(LineSample(0.1, 2, words)))
    view.take(encoded(sample(3, mode=words)))
    assert not server.gui.add_markdown.called
    (first,) = server.gui.add_html.call_args.args
    return [first, view.text.content]


@pytest.mark.parametrize("words", HOSTILE)
def test_words_of_the_vehicle_and_names_are_shown_as_text(words, monkeypatch):
    first, later = (Page(content) for content in contents(words, monkeypatch))
    for page in (first, later):
        assert page.tags <= OURS
        assert not page.attributes
    shown = "".join(c if c.isprintable() else " " if c.isspace() else "?" for c in words)
    assert first.text.count(shown) == 2
    assert later.text.count(shown) == 5  # name, filter, state, mode, message


def view_of(**fields):
    server = MagicMock()
    server.gui.add_html.return_value = SimpleNamespace(content="")
    plan = [(0.0, 0.0, 1.0), (1.0, 0.0, 1.0)]
    head = ViewHead(
        name="n", filter="f", vehicle="v", radius_m=0.1, map_message=SceneUpdate(), plan=plan, **fields
    )
    return _View(server, head), server


def tick(**fields):
    return encoded(sample(3, **fields))


def step(state, event, words):
    return StepSample(
        Supervisor(time_s=9.0, state=9, state_name=state, event_name=event, action_name="a"), words
    )


def test_the_last_words_say_how_the_flight_ended_however_lately_it_was_told():
    view, _ = view_of()
    view.take(tick(mode="LAND", armed=True))
    view.take(encoded(step("done", "disarmed", "disarmed: it is over")))
    view.take(tick(mode="LAND", armed=False))  # too soon after the text before to be written at once
    assert "The flight has ended" not in view.text.content
    view.end()
    text = Page(view.text.content).text
    assert "The flight has ended: disarmed: it is over; the vehicle is disarmed." in text
    assert "LAND, disarmed" in text
    view.take(tick(armed=True))
    view.end()
    assert "last reported that it is armed" in Page(view.text.content).text


@pytest.mark.parametrize("event", [Event.DISARMED, Event.LANDED_AWAY])
def test_a_flight_that_ends_disarmed_is_not_said_to_be_armed(event):
    view, _ = view_of()
    view.take(tick(mode="LAND", armed=True))
    view.take(encoded(step("done", event.value, "disarmed: it is over")))
    view.end()
    text = Page(view.text.content).text
    assert "The flight has ended: disarmed: it is over; the vehicle is disarmed." in text
    assert "last reported that it is armed" not in text


def test_stale_positions_and_silence_are_called_so(monkeypatch):
    view, _ = view_of(stale_s=0.2)
    monkeypatch.setattr("alula.stages.flight.recorder.live_view._TEXT_S", -1.0)
    view.take(tick(state_age_s=0.1))
    assert "STALE" not in view.text.content
    view.take(tick(state_age_s=0.3))
    assert "300 ms, STALE" in Page(view.text.content).text
    view.watch()
    assert "NO DATA" not in view.text.content
    view.heard_s -= 7.0
    view.watch()
    assert "NO DATA from the flight for 7 s" in Page(view.text.content).text


def test_scene_plan_and_fence_stand_before_the_flight_and_a_missing_file_is_named(tmp_path):
    view, server = view_of(files=[str(tmp_path / "gone.scene.npz")], fence=[-1, -1, 0, 2, 2, 3])
    names = {call.args[0] for call in server.scene.add_line_segments.call_args_list}
    assert {"/Plan/curve", "/Fence/edges"} <= names
    assert any("not shown" in line for line in view.lines)


def test_a_new_plan_is_drawn_beside_those_before():
    view, server = view_of()
    points = [(0.0, 0.0, 1.0), (0.5, 0.5, 1.0), (1.0, 0.0, 1.0)]
    for _ in range(2):
        view.take(encoded(PlanSample(2.0, points)))
    drawn = {call.args[0]: call.args[1] for call in server.scene.add_line_segments.call_args_list}
    assert {"/New plan 1", "/New plan 2", "/Plan/curve"} <= drawn.keys()
    assert drawn["/New plan 1"].tolist() == [list(map(list, points[:2])), list(map(list, points[1:]))]
