"""Pages in Chromium: what they draw, print as errors and ask for, without a graphics card."""

import io
import shutil
import subprocess
import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache

import numpy as np
import pytest

PROGRAMS = ("chromium", "google-chrome", "chromium-browser")
SOFTWARE = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
PATIENCE_S = 90.0  # on a machine with much else to do
PLOTS_PX, BAR_PX = 118, 41  # at the bottom of a view


@cache
def chromium_program():
    """The browser's path; Ubuntu's chromium may be the name of a snap that is not there."""
    for name in PROGRAMS:
        path = shutil.which(name)
        if path and subprocess.run([path, "--version"], capture_output=True, check=False).returncode == 0:
            return path
    return None


@pytest.fixture(scope="module")
def browser():
    """Chromium, one for all pages of a module."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is needed")
    program = chromium_program()
    if program is None:
        pytest.skip("needs Chromium: .ci/system-packages --browser")
    with api.sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=program, args=SOFTWARE)
        yield chromium
        chromium.close()


@dataclass
class Opened:
    """A page that is open."""

    page: object
    errors: list = field(default_factory=list)
    requests: list = field(default_factory=list)

    def frame(self):
        """The page of the view: the frame in a report, or the page itself."""
        frames = self.page.locator("iframe")
        if frames.count() == 0:
            return self.page
        # Without a handle: Playwright describes one by its attributes, of which one is the whole view.
        self.page.evaluate("document.querySelector('iframe').scrollIntoView()")
        self.until(lambda: [one.url for one in self.page.frames][1:] == ["about:srcdoc"], "no frame")
        return self.page.frames[1]

    def pixels(self):
        """What is seen, shape (height, width, 3)."""
        from PIL import Image

        shot = self.page.screenshot(timeout=1e3 * PATIENCE_S)
        return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)

    def scene(self):
        """The canvas of a view, without what lies over it below."""
        found = self.pixels()
        return found[: len(found) - PLOTS_PX - BAR_PX]

    def until(self, condition, what):
        """Wait for a condition of the picture."""
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, what
            self.page.wait_for_timeout(200)

    def fits(self):
        """Nothing is wider than the window."""
        return self.page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


@contextmanager
def opened(browser, address, *, width=640, height=520, dark=False, allowed=()):
    """Open a page; at the end it must have printed no error and asked for nothing but `allowed`."""
    context = browser.new_context(
        viewport={"width": width, "height": height}, color_scheme="dark" if dark else "light"
    )
    page = context.new_page()
    page.set_default_timeout(1e3 * PATIENCE_S)
    found, allowed = Opened(page), (address, "data:", "blob:", "about:", *allowed)
    page.on("console", lambda m: found.errors.append(m.text) if m.type == "error" else None)
    page.on("pageerror", lambda e: found.errors.append(str(e)))
    page.on("request", lambda r: None if r.url.startswith(allowed) else found.requests.append(r.url))
    page.on("websocket", lambda w: None if w.url.startswith(allowed) else found.requests.append(w.url))
    try:
        page.goto(address)
        yield found
        assert found.errors == []
        assert found.requests == []
    finally:
        context.close()


def near(pixels, color):
    """Fraction of pixels whose hue is about that of a color: channels after brightness was taken out."""
    own, other = (x - x.mean(axis=-1, keepdims=True) for x in (pixels, np.array(color, float)))
    size = np.linalg.norm(own, axis=-1)
    alike = (own @ other) > 0.9 * size * np.linalg.norm(other)
    return float((alike & (size > 10)).mean())


def drawn(pixels):
    """Fraction of pixels that differ from the most common color, which is the background."""
    packed = pixels @ np.array([65536, 256, 1])
    values, counts = np.unique(packed, return_counts=True)
    background = values[counts.argmax()]
    color = np.array([background >> 16, background >> 8 & 255, background & 255])
    return float((np.abs(pixels - color).sum(axis=-1) > 24).mean())
