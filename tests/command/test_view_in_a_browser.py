"""Pages of views in Debian's Chromium: no error, no request, a picture of the scene, a timeline."""

import shutil
from contextlib import contextmanager

import numpy as np
import pytest

from alula.cli.main import run
from alula.stages.viewing.compose import Shown, content_of
from alula.stages.viewing.page import page
from support.fabricate import box, make_cover, make_scene, make_trial
from support.viewed_runs import run_of

pytestmark = [pytest.mark.slow, pytest.mark.process]

SOFTWARE = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
SIZE = {"width": 420, "height": 360}


@contextmanager
def browser(*, flags=(), **options):
    """A page of Chromium, and what it printed as errors and asked for elsewhere."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is needed")
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        pytest.skip("needs Chromium: apt-get install chromium")
    with api.sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=program, args=[*SOFTWARE, *flags])
        shown = chromium.new_page(viewport=SIZE, **options)
        errors, requests = [], []
        shown.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
        shown.on("pageerror", lambda e: errors.append(str(e)))
        shown.on(
            "request",
            lambda r: None if r.url.startswith(("data:", "blob:", "file:")) else requests.append(r.url),
        )
        yield shown, errors, requests
        chromium.close()


def pixels(shown):
    """The canvas of the scene as an array of red, green and blue."""
    import io

    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(shown.screenshot(timeout=60_000))).convert("RGB")).astype(int)


def test_a_page_shows_its_scene_and_scrubbing_moves_the_vehicle(tmp_path):
    scene = make_scene(300, low=(0, -1, 0), high=(5, 1, 0.5))
    scene["color"][:] = (200, 30, 30)
    cover = make_cover([box((0, 40, 0), (100, 42, 30))])
    runs = [run_of([make_trial(0)])]
    content = content_of(Shown(title="seen", scenes=[("s", scene)], covers=[("c", cover)], runs=runs))
    (tmp_path / "page.html").write_text(page(content))
    with browser(color_scheme="dark") as (shown, errors, requests):
        shown.goto(f"file://{tmp_path}/page.html")
        shown.wait_for_function("window.alulaTime && alulaTime() !== null", timeout=60_000)
        shown.evaluate("document.getElementById('alula-head').open = false")
        shown.evaluate("alulaSeek(0.5)")
        shown.wait_for_function("Math.abs(alulaTime() - 0.5) < 0.02", timeout=20_000)
        shown.wait_for_timeout(2500)
        early = pixels(shown)
        shown.evaluate("alulaSeek(4.5)")
        shown.wait_for_function("Math.abs(alulaTime() - 4.5) < 0.02", timeout=20_000)
        shown.wait_for_timeout(2500)
        late = pixels(shown)
        words = shown.text_content("#alula-now")
        dark = shown.evaluate("getComputedStyle(document.getElementById('alula')).getPropertyValue('--ink')")
    assert errors == []
    assert all(url.startswith(("data:", "blob:", "file:")) for url in requests)
    red = (early[..., 0] > early[..., 1] + 60) & (early[..., 0] > early[..., 2] + 60)
    assert red.mean() > 0.01  # the scene's own colour
    moved = np.abs(early - late).sum(axis=2) > 60
    scene_rows = moved[: SIZE["height"] - 130]
    assert scene_rows.sum() > 60
    assert "4.5 s" in words
    assert dark.strip() == "#e8ecf1"


@pytest.mark.parametrize("lacks", ["WebGL", "scripts", "nothing"])
def test_a_page_is_a_picture_where_webgl_or_scripts_are_missing(lacks, tmp_path):
    scene = make_scene(300, low=(0, -1, 0), high=(5, 1, 0.5))
    scene["color"][:] = (200, 30, 30)
    content = content_of(Shown(title="seen", scenes=[("s", scene)], runs=[run_of([make_trial(0)])]))
    (tmp_path / "page.html").write_text(page(content))
    flags = ["--disable-3d-apis"] if lacks == "WebGL" else []
    with browser(flags=flags, java_script_enabled=lacks != "scripts") as (shown, _, requests):
        shown.goto(f"file://{tmp_path}/page.html")
        still = shown.locator("#alula-still")
        if lacks == "nothing":
            shown.wait_for_function("window.alulaTime && alulaTime() !== null", timeout=60_000)
            assert not still.is_visible()
            return
        still.wait_for(state="visible", timeout=60_000)
        assert still.locator("img").evaluate("image => image.decode().then(() => image.naturalWidth)") == 1000
        seen = pixels(shown)
    assert requests == []
    red = (seen[..., 0] > seen[..., 1] + 60) & (seen[..., 0] > seen[..., 2] + 60)
    assert red.mean() > 0.01


def test_the_view_in_a_report_runs_in_its_sandbox(pipeline, tmp_path):
    words = ["report", str(pipeline / "tiny.run.mcap"), "--cover", str(pipeline / "tiny.cover.npz")]
    words += ["--scene", str(pipeline / "tiny.metric.scene.npz"), "-o", str(tmp_path / "r.html"), "-q"]
    assert run(words) == 0
    with browser() as (shown, errors, requests):
        shown.goto(f"file://{tmp_path}/r.html")
        shown.locator("iframe").scroll_into_view_if_needed()
        frame = shown.locator("iframe").element_handle().content_frame()
        frame.wait_for_function("window.alulaTime && alulaTime() !== null", timeout=60_000)
        frame.evaluate("alulaSeek(1)")
        frame.wait_for_function("Math.abs(alulaTime() - 1) < 0.02", timeout=20_000)
        words = frame.text_content("#alula-words")
    assert errors == []
    assert all(url.startswith(("data:", "blob:", "file:", "about:")) for url in requests)
    assert "reached its goal" in words
