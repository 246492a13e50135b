"""Pages of views in Chromium without WebGL or without scripts: a picture of the scene."""

from contextlib import contextmanager

import pytest

from alula.stages.viewing.compose import Shown, content_of
from alula.stages.viewing.page import page
from support.browser import SOFTWARE, Opened, chromium_program, near
from support.fabricate import make_scene, make_trial
from support.viewed_pages import RED
from support.viewed_runs import run_of

pytestmark = [pytest.mark.slow, pytest.mark.process]


@contextmanager
def chromium(flags, **options):
    """A page of a browser with other flags, and what it asked for elsewhere."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is needed")
    if (program := chromium_program()) is None:
        pytest.skip("needs Chromium: .ci/system-packages --browser")
    with api.sync_playwright() as play:
        browser = play.chromium.launch(executable_path=program, args=[*SOFTWARE, *flags])
        shown = browser.new_page(viewport={"width": 420, "height": 360}, **options)
        requests = []
        inner = ("data:", "blob:", "file:")
        shown.on("request", lambda r: None if r.url.startswith(inner) else requests.append(r.url))
        yield shown, requests
        browser.close()


@pytest.mark.parametrize("lacks", ["WebGL", "scripts", "nothing"])
def test_a_page_is_a_picture_where_webgl_or_scripts_are_missing(lacks, tmp_path):
    scene = make_scene(300, low=(0, -1, 0), high=(5, 1, 0.5), color=RED)
    content = content_of(Shown(title="seen", scenes=[("s", scene)], runs=[run_of([make_trial(0)])]))
    (tmp_path / "page.html").write_text(page(content))
    flags = ["--disable-3d-apis"] if lacks == "WebGL" else []
    with chromium(flags, java_script_enabled=lacks != "scripts") as (shown, requests):
        shown.goto(f"file://{tmp_path}/page.html")
<<<<<<< HEAD
        still = shown.locator("#alula-still")
        if lacks == "nothing":
            shown.wait_for_function("window.alulaTime && alulaTime() !== null", timeout=60_000)
            assert not still.is_visible()
            return
        still.wait_for(state="visible", timeout=60_000)
        assert still.locator("img").evaluate("image => image.decode().then(() => image.naturalWidth)") == 1000
        seen = Opened(shown).pixels()
    assert requests == []
    assert near(seen, RED) > 0.01
=======
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


def test_two_clicks_measure_the_distance_between_gaussians(tmp_path):
    scene = make_scene(400, low=(0, 0, 0), high=(0.1, 0.1, 0.1))
    scene["mean"][200:] += np.float32((4, 0, 0))
    content = content_of(Shown(title="two", scenes=[("s", scene)]))
    (tmp_path / "page.html").write_text(page(content))
    with browser() as (shown, errors, _):
        shown.goto(f"file://{tmp_path}/page.html")
        shown.wait_for_selector("#alula-measure:not([hidden])", timeout=60_000, state="attached")
        shown.wait_for_timeout(2500)
        shown.evaluate("document.getElementById('alula-head').open = true")
        shown.click("#alula-measure button")
        shown.evaluate("document.getElementById('alula-head').open = false")
        seen = np.abs(pixels(shown) - 255).sum(axis=2) > 100
        columns = np.flatnonzero(seen[60:300].any(axis=0))
        places = []
        for x in (columns.min() + 3, columns.max() - 3):
            places.append((int(x), 60 + int(np.flatnonzero(seen[60:300, x]).mean())))
        for x, y in places:
            shown.mouse.click(x, y)
            shown.wait_for_timeout(200)
        words = shown.text_content("#alula-measure span")
    assert errors == []
    assert words.startswith("distance ")
    assert float(words.split()[1]) == pytest.approx(4, abs=0.2)
>>>>>>> 45d6a4c2 (Measure the distance of two clicked Gaussians in the view)
