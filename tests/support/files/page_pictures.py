"""Pictures of pages of every kind for the documentation.

    python -P tests/support/files/page_pictures.py examples/room/out docs/pictures

The first folder is what `make demo` and `make -C examples/room course` leave, the second gets the pictures.
"""

from __future__ import annotations

import io
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2]))

import numpy as np
from PIL import Image
from playwright.sync_api import sync_playwright

from alula.schemas.log.foxglove import Vector3
from alula.stages.flight.recorder.live_view import ViewHead, open_view
from alula.stages.flight.recorder.samples import PlanSample, encoded
from alula.stages.runlog.maps import map_message
from support.files.browser import SOFTWARE, chromium_program
from support.files.viewed_pages import write_page, write_simulated
from support.flights.flight_logs import sample
from support.flights.flights import mission

SIZE, WIDE = {"width": 800, "height": 500}, {"width": 1100, "height": 600}
PHONE = {"width": 390, "height": 700}
SETTLES_MS = 25_000  # of a whole splat on a processor
# A page draws less where there is no GPU; here it must not notice.
WHOLE = """{
  const get = WebGL2RenderingContext.prototype.getParameter;
  WebGL2RenderingContext.prototype.getParameter = function (name) {
    return name === 37446 ? "" : get.call(this, name);
  };
}"""
MOST_BYTES = 120_000

# Name of a picture: command, files of the room or of the simulated logs, part of the first flight, dark.
PAGES = {
    "view-gates": ("view", ["course.run.mcap", "course.plan.npz", "room.metric.scene.npz"], 0.42, False),
    "view-deciding": ("view", ["hoops.run.mcap"], 0.6, True),
    "view-moving": ("view", ["moving.run.mcap"], 0.35, False),
    "view-fence": ("view", ["fenced.run.mcap"], 0.6, True),
    "report-flight": ("report", ["flight.run.mcap"], None, False),
    "report-fence": ("report", ["fenced.run.mcap"], None, True),
    "report-moving": ("report", ["moving.run.mcap"], None, False),
}


def save(shot: bytes, target: Path) -> None:
    """Write a picture as WebP, below `MOST_BYTES`."""
    Image.open(io.BytesIO(shot)).convert("RGB").save(target, quality=72, method=6)
    assert target.stat().st_size < MOST_BYTES, target


@contextmanager
def shown(browser: object, address: str, size: dict[str, int], *, dark: bool):
    """A page that has drawn its scene."""
    context = browser.new_context(viewport=size, color_scheme="dark" if dark else "light")
    page = context.new_page()
    page.add_init_script(WHOLE)
    page.set_default_timeout(120_000)
    page.goto(address)
    yield page
    context.close()


def main(room: Path, folder: Path) -> None:
    """Make all pictures."""
    with tempfile.TemporaryDirectory() as name, sync_playwright() as play:
        work = Path(name)
        write_simulated(work)
        for path in room.iterdir():
            if path.is_file():
                (work / path.name).symlink_to(path.resolve())
        browser = play.chromium.launch(executable_path=chromium_program(), args=SOFTWARE)
        wanted = sys.argv[3:] or [*PAGES, "view-phone", "live"]
        for picture, (command, files, part, dark) in PAGES.items():
            if picture not in wanted:
                continue
            page_file = write_page(work, command, picture, *files)
            with shown(browser, page_file.as_uri(), SIZE if command == "view" else WIDE, dark=dark) as page:
                if command == "view":
                    at_part(page, part)
                first = None if command == "view" else {"x": 0, "y": 0, "width": WIDE["width"], "height": 515}
                save(page.screenshot(clip=first), folder / f"{picture}.webp")
        if "view-phone" in wanted:
            page_file = write_page(work, "view", "view-phone", "hoops.run.mcap", "room.metric.scene.npz")
            with shown(browser, page_file.as_uri(), PHONE, dark=True) as page:
                at_part(page, 0.5)
                save(page.screenshot(), folder / "view-phone.webp")
        if "live" in wanted:
            live(browser, folder / "live.webp")
        browser.close()


def at_part(page: object, part: float | None) -> None:
    """Seek a part of the first flight, once the scene is drawn."""
    if part is not None:
        page.wait_for_function("window.alulaTime && alulaTime() !== null")
        page.evaluate(
            f"(f => alulaSeek(f.begin + {part} * (f.end - f.begin)))"
            "(JSON.parse(document.getElementById('alula-data').textContent).flights[0])"
        )
    page.wait_for_timeout(SETTLES_MS)


def live(browser: object, target: Path) -> None:
    """The live view of a flight past a ball, with a new plan."""
    made = mission(velocity_lag_s=0.0)
    path = np.column_stack(
        [np.linspace(0.3, 3.7, 200), 2 + 0.6 * np.sin(np.linspace(0, 3, 200)), np.ones(200)]
    )
    head = ViewHead(
        name="flight",
        filter="polytope-cbf",
        vehicle="v",
        radius_m=0.15,
        map_message=map_message(made.map, {"sigma": 1.0}, [path], "world", 0),
        plan=[(0.3, 2.0, 1.0), (3.7, 2.0, 1.0)],
    )
    pipe, address = open_view(0, head)
    with shown(browser, address, WIDE, dark=False) as page:
        page.wait_for_selector("canvas")
        page.wait_for_timeout(3000)
        pipe.offer(encoded(PlanSample(1.0, path[60:].tolist())))
        for i, point in enumerate(path[:140].tolist()):
            seen = sample(i)
            seen.state.position_m = Vector3(*point)
            pipe.offer(encoded(seen))
            page.wait_for_timeout(60)
        save(page.screenshot(), target)
    pipe.close(10.0)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
