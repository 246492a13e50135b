"""Live view of a flight in a browser, in a process for which the flight never waits."""

from __future__ import annotations

import importlib.util
import os
import signal
import sys
import time
from collections import deque
from typing import Any

import msgspec
import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import UsageError
from alula.schemas.text import html_text, one_line
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.flight.recorder.channels import LineSample, StepSample
from alula.stages.flight.recorder.pipe import FlightPipe, next_message
from alula.stages.flight.recorder.samples import FilterSample, TickSample
from alula.stages.flight.recorder.served import HOST, NICE, open_served

_POSE_S = 0.05  # between updates of the pose
_TEXT_S = 0.2  # between updates of the text
_PATH_S = 0.5  # between updates of the path
_PATH_POINTS = 3000
_LINES = 8  # number of messages shown
_PLAN, _MAP, _VEHICLE = (40, 110, 220), (140, 153, 173), (250, 210, 40)
_COLOURS = {
    FilterStatus.OK: (40, 160, 70),
    FilterStatus.FILTERED: (235, 150, 20),
    FilterStatus.SHORTENED: (235, 150, 20),
}
_OTHER = (210, 40, 40)


class ViewHead(msgspec.Struct, frozen=True, kw_only=True):
    """First message to the view: the map as logged, the plan, and names.

    Attributes:
        name, filter, vehicle: as in `FlightHead`.
        radius_m: radius of the vehicle [m].
        map_message: the map as `foxglove.SceneUpdate`.
        plan: points of the plan, world frame [m].
    """

    name: str
    filter: str
    vehicle: str
    radius_m: float
    map_message: dict[str, Any]
    plan: list[tuple[float, float, float]]


def require_viser() -> None:
    """Check that viser is installed.

    Raises:
        UsageError: viser is not installed.
    """
    if importlib.util.find_spec("viser") is None:
        raise UsageError("--live needs viser, which is not installed: pip install 'alula[live]'")


def open_view(port: int, head: ViewHead) -> tuple[FlightPipe, str]:
    """Start the process of the view and wait until a browser can connect to it.

    Args:
        port: to listen on, of loopback.
        head: facts that are known before the flight.

    Returns:
        The pipe to the process, and the address for the browser.

    Raises:
        UsageError: viser is not installed, or the port is taken.
        OutputError: the process does not start.
    """
    require_viser()
    code = "from alula.stages.flight.recorder.live_view import main; main()"
    pipe, found = open_served("--live", port, code, msgspec.msgpack.encode(head))
    return pipe, f"http://{HOST}:{found}"


class _View:
    """Contents of the view, in its process."""

    def __init__(self, server: Any, head: ViewHead) -> None:
        self.server, self.head = server, head
        self.lines: deque[str] = deque(maxlen=_LINES)
        self.points: list[tuple[float, float, float]] = []
        self.colours: list[tuple[int, int, int]] = []
        self.pose_s = self.text_s = self.path_s = -np.inf
        self.state = "idle"
        server.gui.configure_theme(show_share_button=False, show_logo=False)
        scene = server.scene
        scene.set_up_direction("+z")
        self._map(head.map_message)
        plan = np.array(head.plan)
        scene.add_line_segments("/plan", _segments(plan), _PLAN, thickness=0.02)
        scene.add_icosphere("/goal", 0.06, color=_PLAN, position=plan[-1])
        self.vehicle = scene.add_frame(
            "/vehicle", axes_length=2 * head.radius_m, axes_radius=0.1 * head.radius_m, position=plan[0]
        )
        scene.add_icosphere("/vehicle/body", head.radius_m, color=_VEHICLE)
        # HTML, not Markdown: viser renders either as it is, and only HTML has one simple rule of escaping.
        self.text = server.gui.add_html(self._head() + "<p>waiting</p>")
        centre, size = plan.mean(axis=0), max(2.0, float(np.ptp(plan, axis=0).max()))
        server.initial_camera.position = centre + size * np.array((-0.5, -1.0, 1.0))
        server.initial_camera.look_at = centre

    def _map(self, message: dict[str, Any]) -> None:
        """Show hulls as one mesh and ellipsoids as scaled spheres."""
        (entity,) = message["entities"]
        if triangles := entity.get("triangles"):
            points = [np.array([[p["x"], p["y"], p["z"]] for p in hull["points"]]) for hull in triangles]
            first = np.cumsum([0, *(len(part) for part in points[:-1])])
            faces = [
                np.array(hull["indices"], np.int32).reshape(-1, 3) + start
                for hull, start in zip(triangles, first, strict=True)
            ]
            self.server.scene.add_mesh_simple(
                "/map", np.vstack(points), np.vstack(faces), color=_MAP, opacity=0.35, flat_shading=True
            )
        if spheres := entity.get("spheres"):
            from trimesh.creation import icosphere

            ball = icosphere(subdivisions=1, radius=0.5)
            turn, where = ([sphere["pose"][key] for sphere in spheres] for key in ("orientation", "position"))
            self.server.scene.add_batched_meshes_simple(
                "/map",
                np.asarray(ball.vertices, np.float32),
                np.asarray(ball.faces, np.uint32),
                batched_wxyzs=np.array([[q["w"], q["x"], q["y"], q["z"]] for q in turn]),
                batched_positions=np.array([[p["x"], p["y"], p["z"]] for p in where]),
                batched_scales=np.array([[s["size"][axis] for axis in "xyz"] for s in spheres]),
                batched_colors=np.array(
                    [[round(255 * s["color"][c]) for c in "rgb"] for s in spheres], np.uint8
                ),
                opacity=0.6,
            )

    def take(self, message: bytes) -> None:
        """Process a message of the flight."""
        kind, body = message[:1], message[1:]
        if kind == b"t":
            self._tick(msgspec.msgpack.decode(body, type=TickSample))
        elif kind == b"s":
            self.state = msgspec.msgpack.decode(body, type=StepSample).state
        elif kind == b"l":
            line = msgspec.msgpack.decode(body, type=LineSample)
            self.lines.append(f"{line.time_s:.1f} s  {line.words}")

    def _tick(self, sample: TickSample) -> None:
        now = time.monotonic()
        if sample.position is not None and sample.attitude_wxyz is not None and now - self.pose_s > _POSE_S:
            self.pose_s = now
            self.vehicle.position, self.vehicle.wxyz = sample.position, sample.attitude_wxyz
            if sample.armed:
                status = None if sample.filter is None else FilterStatus(sample.filter.status)
                self.points.append(sample.position)
                self.colours.append((90, 90, 90) if status is None else _COLOURS.get(status, _OTHER))
        if now - self.path_s > _PATH_S and len(self.points) > 1:
            self.path_s = now
            if len(self.points) > _PATH_POINTS:
                self.points, self.colours = self.points[::2], self.colours[::2]
            colours = np.repeat(np.array(self.colours[1:], np.uint8)[:, None, :], 2, axis=1)
            self.server.scene.add_line_segments(
                "/path", _segments(np.array(self.points)), colours, thickness=0.025
            )
        if now - self.text_s > _TEXT_S:
            self.text_s = now
            self.text.content = self._words(sample)

    def _words(self, sample: TickSample) -> str:
        rows = [
            ("time", f"{sample.time_s:.1f} s"),
            ("state", self.state),
            ("mode", f"{sample.mode}{', armed' if sample.armed else ''}"),
            ("battery", _percent(sample.battery_share)),
            ("age of the position", "none" if sample.age_s is None else f"{1e3 * sample.age_s:.0f} ms"),
            ("tick, late", f"{1e3 * sample.tick_s:.2f}, {1e3 * sample.late_s:.2f} ms"),
        ]
        if sample.velocity is not None:
            rows.append(("speed", f"{float(np.linalg.norm(sample.velocity)):.2f} m/s"))
        if sample.filter is not None:
            rows += _filter_rows(sample.filter)
        cells = "".join(
            f"<tr><td>{html_text(name)}</td><td>{html_text(value)}</td></tr>" for name, value in rows
        )
        lines = "".join(f"<li>{html_text(line)}</li>" for line in reversed(self.lines))
        return f"{self._head()}<table>{cells}</table><ul>{lines}</ul>"

    def _head(self) -> str:
        return f"<p><b>{html_text(self.head.name)}</b> behind {html_text(self.head.filter)}</p>"


def _filter_rows(done: FilterSample) -> list[tuple[str, str]]:
    sent = ", ".join(f"{value:.2f}" for value in done.sent_values)
    return [
        ("filter", FilterStatus(done.status).name.lower() + (", infeasible" if done.infeasible else "")),
        ("h", f"{done.margin:.3f}"),
        ("active rows", str(done.active)),
        ("fence h", f"{done.fence_h_m:.2f} m"),
        ("fence λ", f"{done.fence_share:.2f}" + (", the fence flies" if done.fence_flies else "")),
        ("behind the plan", f"{done.error_m:.2f} m"),
        ("sent", f"{done.sent} {sent}"),
    ]


def _percent(fraction: float | None) -> str:
    return "not reported" if fraction is None else f"{fraction:.0%}"


def _segments(points: FloatArray) -> FloatArray:
    """A path of N points as segments, shape (N - 1, 2, 3)."""
    return np.stack([points[:-1], points[1:]], axis=1)


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
    while message := next_message(source):
        view.take(message)
    os._exit(0)  # the server's threads do not end by themselves


def _viser() -> Any:
    import viser

    return viser
