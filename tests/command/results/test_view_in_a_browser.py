"""Pages of views in Chromium: a picture without WebGL or scripts, and a length between two clicks."""

from contextlib import contextmanager

import numpy as np
import pytest

from alula.stages.show.viewing import light
from alula.stages.show.viewing import page as pages
from alula.stages.show.viewing.compose import Shown, content_of
from alula.stages.show.viewing.page import page, within
from support.files.browser import SOFTWARE, Opened, chromium_program, near
from support.files.viewed_pages import RED
from support.flights.viewed_runs import run_of
from support.scenes.fabricate import make_scene, make_trial

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


def test_a_browser_without_a_gpu_shows_the_picture_until_somebody_turns_it(tmp_path, monkeypatch):
    for module in (pages, light):
        monkeypatch.setattr(module, "LIGHT_GAUSSIANS", 100)
    scene = make_scene(300, low=(0, -1, 0), high=(5, 1, 0.5), color=RED)
    shown_parts = Shown(title="seen", scenes=[("s", scene)], runs=[run_of([make_trial(0)])])
    text, _ = within(lambda most: content_of(shown_parts, most_gaussians=most))
    (tmp_path / "page.html").write_text(text)
    with chromium([]) as (shown, requests):
        shown.goto(f"file://{tmp_path}/page.html")
        still = shown.locator("#alula-still")
        still.wait_for(state="visible", timeout=60_000)
        assert "of 300 Gaussians, because this browser draws without a GPU" in still.text_content()
        shown.wait_for_function("window.alulaTime && alulaTime() > 0", timeout=60_000)
        time = shown.evaluate("alulaTime()")
        shown.wait_for_timeout(600)
        assert shown.evaluate("alulaTime()") == time  # nothing plays behind the picture
        still.locator("button").click()
        assert not still.is_visible()
    assert requests == []


def test_a_narrow_window_shows_the_whole_scene(tmp_path):
    scene = make_scene(2000, low=(-2, -2, -2), high=(2, 2, 2), color=RED)
    (tmp_path / "page.html").write_text(page(content_of(Shown(title="whole", scenes=[("s", scene)]))))
    with chromium([]) as (shown, _):
        shown.set_viewport_size({"width": 300, "height": 600})
        shown.goto(f"file://{tmp_path}/page.html")
        shown.evaluate("document.getElementById('alula-head').open = false")
        opened = Opened(shown)
        opened.until(lambda: near(opened.pixels(), RED) > 0.05, "nothing is red")
        seen = opened.pixels()
    assert near(seen[:, 100:200], RED) > 0.05
    assert max(near(seen[:, :4], RED), near(seen[:, -4:], RED)) < 0.02  # 0.5 where the scene is cropped


def test_two_clicks_measure_the_distance_between_gaussians(tmp_path):
    scene = make_scene(400, low=(0, 0, 0), high=(0.1, 0.1, 0.1), color=RED)
    scene["mean"][200:] += np.float32((4, 0, 0))
    content = content_of(Shown(title="two", scenes=[("s", scene)]))
    (tmp_path / "page.html").write_text(page(content))
    with chromium([]) as (shown, _):
        shown.goto(f"file://{tmp_path}/page.html")
        shown.wait_for_selector("#alula-measure:not([hidden])", timeout=60_000, state="attached")
        shown.wait_for_timeout(2500)
        shown.evaluate("document.getElementById('alula-head').open = true")
        shown.click("#alula-measure button")
        shown.evaluate("document.getElementById('alula-head').open = false")
        found = Opened(shown).pixels()[60:300]
        seen = (found[..., 0] > found[..., 1] + 60) & (found[..., 0] > found[..., 2] + 60)
        columns = np.flatnonzero(seen.any(axis=0))
        for x in (int(columns.min()) + 3, int(columns.max()) - 3):
            shown.mouse.click(x, 60 + int(np.flatnonzero(seen[:, x]).mean()))
            shown.wait_for_timeout(200)
        words = shown.text_content("#alula-measure span")
    assert words.startswith("distance ")
    assert float(words.split()[1]) == pytest.approx(4, abs=0.2)
