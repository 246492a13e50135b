"""Live view of a flight in a browser, in a process for which the flight never waits."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections import deque
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from alula.schemas.errors import AlulaError
from alula.schemas.log.channels import Safety, State, Supervisor
from alula.schemas.log.foxglove import UPRIGHT, SceneUpdate
from alula.schemas.text import html_text, one_line
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.flight.loop.supervisor_table import Event
from alula.stages.flight.recorder.pipe import FlightPipe, next_message
from alula.stages.flight.recorder.samples import LineSample, PlanSample, StepSample, TickSample, decoded
from alula.stages.flight.recorder.served import HOST, NICE, open_served
from alula.stages.show.drawing.content import Body, Content, Lines, Part, segments_of
from alula.stages.show.viewing.compose import Shown, content_of, fence_parts
from alula.stages.show.viewing.corridor import NEW_PLAN_COLOR, PLAN_COLOR
from alula.stages.show.viewing.draw import Vehicle, draw, draw_part
from alula.stages.show.viewing.files import read_files
from alula.stages.show.viewing.logged_map import map_of
from alula.stages.show.viewing.shapes import balls

_POSE_S = 0.05  # between updates of the pose
_TEXT_S = 0.2  # between updates of the text
_PATH_S = 0.5  # between updates of the path
_PATH_POINTS = 3000
_LINES = 8  # number of messages shown
_SILENT_S = 1.0  # without a message, after which the view says so
_REPORTED_DISARMED = (Event.DISARMED.value, Event.LANDED_AWAY.value)  # events that need a disarmed vehicle
_LAST_S = 0.5  # for the last words to reach the browsers
_GAUSSIANS = 60_000
_NOT_SHOWN = "not shown: "
_COLOURS = {
    FilterStatus.OK: (40, 160, 70),
    FilterStatus.FILTERED: (235, 150, 20),
    FilterStatus.SHORTENED: (235, 150, 20),
}
_OTHER = (210, 40, 40)


class ViewHead(msgspec.Struct, frozen=True, kw_only=True):
    """First message to the view: the map as logged, the plan, and names.

    Attributes:
        plan: points of the plan, world frame [m].
        rotors_m: places of the rotors, body frame [m].
        files: scene and plan, to show the splat and the corridor.
        fence: box of the fence, XMIN YMIN ZMIN XMAX YMAX ZMAX [m]; None without one.
        stale_s: age from which a position is shown as stale [s].
    """

    name: str
    filter: str
    vehicle: str
    radius_m: float
    map_message: SceneUpdate
    plan: list[tuple[float, float, float]]
    rotors_m: list[tuple[float, float]] = []
    files: list[str] = []
    fence: list[float] | None = None
    stale_s: float = 0.15


def open_view(port: int, head: ViewHead) -> tuple[FlightPipe, str]:
    """Start the process of the view and wait until a browser can connect to it.

    Args:
        head: facts that are known before the flight.

    Returns:
        The pipe to the process, and the address for the browser.

    Raises:
        UsageError: the port is taken.
        OutputError: the process does not start.
    """
    code = "from alula.stages.flight.recorder.live_view import main; main()"
    pipe, found = open_served("--live", port, code, msgspec.msgpack.encode(head))
    return pipe, f"http://{HOST}:{found}"


def _content(head: ViewHead) -> Content:
    """Everything that is known before the flight: splat, hulls or ellipsoids, fence, plan and corridor."""
    shown = Shown(title=head.name)
    notes: tuple[str, ...] = ()
    try:
        shown = read_files([Path(file) for file in head.files], head.name)
    except AlulaError as error:  # the flight has its own copy; only the picture lacks something
        notes = (f"{_NOT_SHOWN}{one_line(str(error))}",)
    points = np.array(head.plan)
    content = content_of(
        Shown(
            title=head.name,
            scenes=shown.scenes,
            plans=shown.plans,
            maps={"map": map_of(head.map_message)},
            around=points,
        ),
        most_gaussians=_GAUSSIANS,
    )
    own: list[Part] = fence_parts(head.fence, points)
    if not shown.plans:
        curve = Lines(name="Plan/curve", segments=segments_of(points), color=PLAN_COLOR, width_px=3.0)
        own += [curve, balls("Plan/goal", points[-1:], max(0.03, 0.5 * head.radius_m), PLAN_COLOR)]
    return replace(content, parts=(*content.parts, *own), notes=(*content.notes, *notes))


class _View:
    def __init__(self, server: Any, head: ViewHead) -> None:
        self.server, self.head = server, head
        self.lock = threading.Lock()
        self.lines: deque[str] = deque(maxlen=_LINES)
        self.points: list[tuple[float, float, float]] = []
        self.colours: list[tuple[int, int, int]] = []
        self.pose_s = self.text_s = self.path_s = -np.inf
        self.heard_s = time.monotonic()
        self.state, self.ending = "idle", ""
        self.is_armed = False  # as last reported
        self.plans = 0
        self.sample: TickSample | None = None
        server.gui.configure_theme(show_share_button=False, show_logo=False)
        content = _content(head)
        draw(server, content)
        self.lines.extend(note for note in content.notes if note.startswith(_NOT_SHOWN))
        rotors = np.array([(x, y, 0.0) for x, y in head.rotors_m]).reshape(-1, 3)
        self.vehicle = Vehicle(server.scene, "Vehicle", Body(radius_m=head.radius_m, rotors_m=rotors))
        self.vehicle.move(np.array(head.plan[0]), np.array((1.0, 0.0, 0.0, 0.0)))
        # HTML, not Markdown: viser renders either as it is, and only HTML has one simple rule of escaping.
        self.text = server.gui.add_html(self._head() + "<p>waiting for the flight</p>")

    def take(self, message: bytes) -> None:
        """Process a message of the flight."""
        sample = decoded(message)
        with self.lock:
            self.heard_s = time.monotonic()
            if isinstance(sample, TickSample):
                self.is_armed = bool(sample.supervisor.armed)
                self._tick(sample)
            elif isinstance(sample, StepSample):
                step = sample.supervisor
                self.state = step.state_name
                self.ending = sample.words or step.event_name or ""
                if step.event_name in _REPORTED_DISARMED:  # which ends the flight: no tick follows
                    self.is_armed = False
                self._say()
            elif isinstance(sample, PlanSample):
                self._plan(sample)
            elif isinstance(sample, LineSample):
                self.lines.append(f"{sample.time_s:.1f} s  {sample.words}")
                self._say()

    def watch(self) -> None:
        """Say so when no message has come for some time."""
        with self.lock:
            if time.monotonic() - self.heard_s > _SILENT_S:
                self._say()

    def end(self) -> None:
        """Show the last state of a flight that has ended."""
        with self.lock:
            if self.sample is not None and self.sample.state is not None:
                self._move(self.sample.state)
            self._path(np.inf)
            last = (
                "the vehicle last reported that it is armed" if self.is_armed else "the vehicle is disarmed"
            )
            where = self.ending or self.state
            self.text.content = self._page(f"The flight has ended: {where}; {last}. This view is closed.")

    def _plan(self, plan: PlanSample) -> None:
        self.plans += 1
        points = np.array(plan.points)
        curve = Lines(
            name=f"New plan {self.plans}", segments=segments_of(points), color=NEW_PLAN_COLOR, width_px=4.0
        )
        draw_part(self.server.scene, curve)

    def _tick(self, sample: TickSample) -> None:
        now = time.monotonic()
        self.sample = sample
        if sample.state is not None and now - self.pose_s > _POSE_S:
            self.pose_s = now
            self._move(sample.state)
            if self.is_armed:
                status = None if sample.safety is None else FilterStatus(sample.safety.status)
                self.points.append(sample.state.position_m.tuple)
                self.colours.append((90, 90, 90) if status is None else _COLOURS.get(status, _OTHER))
        self._path(now)
        if now - self.text_s > _TEXT_S:
            self._say()

    def _move(self, state: State) -> None:
        turn = state.attitude or UPRIGHT
        self.vehicle.move(state.position_m.array, np.array((turn.w, turn.x, turn.y, turn.z)))

    def _path(self, now: float) -> None:
        if now - self.path_s <= _PATH_S or len(self.points) < 2:
            return
        self.path_s = now
        if len(self.points) > _PATH_POINTS:
            self.points, self.colours = self.points[::2], self.colours[::2]
        colours = np.repeat(np.array(self.colours[1:], np.uint8)[:, None, :], 2, axis=1)
        path = Lines(
            name="Flown path", segments=segments_of(np.array(self.points)), color=colours, width_px=4.0
        )
        draw_part(self.server.scene, path)

    def _say(self) -> None:
        now = time.monotonic()
        self.text_s = now
        silent_s = now - self.heard_s
        words = f"NO DATA from the flight for {silent_s:.0f} s" if silent_s > _SILENT_S else ""
        self.text.content = self._page(words)

    def _page(self, words: str) -> str:
        line = f"<p><b>{html_text(words)}</b></p>" if words else ""
        if self.sample is None:
            cells = f"<tr><td>state</td><td>{html_text(self.state)}</td></tr>"
        else:
            cells = "".join(
                f"<tr><td>{html_text(name)}</td><td>{html_text(value)}</td></tr>"
                for name, value in self._rows(self.sample)
            )
        lines = "".join(f"<li>{html_text(line)}</li>" for line in reversed(self.lines))
        return f"{self._head()}{line}<table>{cells}</table><ul>{lines}</ul>"

    def _rows(self, sample: TickSample) -> list[tuple[str, str]]:
        loop = sample.supervisor
        rows = [
            ("time", f"{loop.time_s:.1f} s"),
            ("state", self.state),
            ("mode", f"{loop.mode}, {'armed' if loop.armed else 'disarmed'}"),
            ("battery", _percent(loop.battery_share)),
            ("age of the position", _age(loop.state_age_s, self.head.stale_s)),
            ("tick, late", f"{1e3 * (loop.tick_s or 0.0):.2f}, {1e3 * (loop.late_s or 0.0):.2f} ms"),
        ]
        if sample.state is not None:
            rows.append(("speed", f"{float(np.linalg.norm(sample.state.velocity_m_s.array)):.2f} m/s"))
        return rows if sample.safety is None else rows + _filter_rows(loop, sample.safety)

    def _head(self) -> str:
        return f"<p><b>{html_text(self.head.name)}</b> behind {html_text(self.head.filter)}</p>"


def _filter_rows(loop: Supervisor, done: Safety) -> list[tuple[str, str]]:
    sent = ", ".join(_number(value) for value in done.sent_values or ())
    margin = done.h_m if done.margin_unit is None else done.margin
    return [
        ("filter", FilterStatus(done.status).name.lower() + (", infeasible" if done.infeasible else "")),
        ("h", _number(margin, 3)),
        ("deciding obstacle", "none" if done.active is None or done.active < 0 else str(done.active)),
        ("fence h", f"{_number(loop.fence_h_m)} m"),
        ("fence λ", _number(loop.fence_share) + (", the fence flies" if loop.fence_flies else "")),
        ("behind the plan", f"{_number(loop.error_m)} m"),
        ("sent", f"{done.sent} {sent}"),
    ]


def _number(value: float | None, digits: int = 2) -> str:
    return "unknown" if value is None else f"{value:.{digits}f}"


def _age(age_s: float | None, stale_s: float) -> str:
    """Age of a position in words; one that is too old to fly by is called stale."""
    if age_s is None:
        return "no position"
    return f"{1e3 * age_s:.0f} ms{', STALE' if age_s > stale_s else ''}"


def _percent(fraction: float | None) -> str:
    return "not reported" if fraction is None else f"{fraction:.0%}"


def main() -> None:
    """Run the process of the view: read messages from standard input until the pipe ends."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # it ends with the pipe
    os.nice(NICE)
    source, port = sys.stdin.buffer, int(sys.argv[1])
    head = msgspec.msgpack.decode(next_message(source), type=ViewHead)
    out = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # viser prints to standard output

    class Server(_viser().ViserServer):  # type: ignore[misc]
        def request_share_url(self, verbose: bool = True) -> None:
            """Do nothing: sharing would give other machines access."""

    server = Server(host=HOST, port=port, label=f"alula fly: {one_line(head.name)}", verbose=False)
    view = _View(server, head)
    os.write(out, f"{server.get_port()}\n".encode())
    os.close(out)
    threading.Thread(target=_watch, args=(view,), daemon=True).start()
    while message := next_message(source):
        view.take(message)
    view.end()
    server.flush()
    time.sleep(_LAST_S)
    os._exit(0)  # the server's threads do not end by themselves


def _watch(view: _View) -> None:
    while True:
        time.sleep(_SILENT_S / 2)
        view.watch()


def _viser() -> Any:
    import viser

    return viser
