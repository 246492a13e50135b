"""Pages of every kind in Chromium: no error, no request, the scene, a timeline, light and dark."""

import re

import numpy as np
import pytest

from support.files.browser import drawn, near, opened
from support.files.viewed_pages import RED, write_files, write_page, write_simulated

pytestmark = [pytest.mark.process, pytest.mark.slow]

HULL, BLUE, GREEN, GATE, YELLOW, TOUCH = (
    *((140, 153, 173), (86, 180, 233), (46, 158, 91), (230, 159, 0), (250, 200, 40)),
    (204, 77, 26),
)
# Of each view: its files, colors of its parts, and the least fraction of the picture that shows each.
VIEWS = {
    "scene": (["s.scene.npz"], {RED: 0.01}),
    "cover": (["c.cover.npz"], {}),
    "voxels": (["v.voxels.npz"], {}),
    "plan": (["p.plan.npz"], {}),
    "gates": (["gates.plan.npz"], {GATE: 0.001}),
    "seen": (["tiny.seen.npz"], {BLUE: 0.01}),
    "run": (["a.run.mcap", "s.scene.npz", "c.cover.npz"], {RED: 0.01}),
    "moving": (["moving.run.mcap"], {TOUCH: 0.0001}),
    "fenced": (["fenced.run.mcap"], {}),
    "flight": (["flight.run.mcap"], {}),
}
REPORTS = {
    "run": ["a.run.mcap", "--cover", "c.cover.npz", "--scene", "s.scene.npz"],
    "pairs": ["a.run.mcap", "b.run.mcap"],
    "fenced": ["fenced.run.mcap"],
    "moving": ["moving.run.mcap"],
    "flight": ["flight.run.mcap"],
    "cover": ["--cover", "c.cover.npz"],
    "plan": ["--plan", "p.plan.npz"],
}
PHONE = {"width": 390, "height": 700}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")
    write_files(folder)
    return folder


@pytest.fixture(scope="module")
def simulated(files):
    write_simulated(files)
    return files


@pytest.fixture
def folder(request, files):
    """Where the files of a kind are; logs and seen space are made only when they are needed."""
    name = request.node.callspec.params["name"]
    if name == "seen":
        source = request.getfixturevalue("pipeline") / "tiny.seen.npz"
        (files / source.name).write_bytes(source.read_bytes())
    if name in ("fenced", "moving", "flight"):
        request.getfixturevalue("simulated")
    return files


def ready(shown):
    """Wait until the view has its timeline, or its scene without one."""
    frame = shown.frame()
    frame.wait_for_function(
        "document.querySelector('canvas') && (!JSON.parse(document.getElementById('alula-data').textContent)"
        ".flights.length || (window.alulaTime && alulaTime() !== null))"
    )
    return frame


def seek(frame, time):
    frame.evaluate(f"alulaSeek({time})")
    frame.wait_for_function(f"Math.abs(alulaTime() - {time}) < 0.02")


def check_picture(shown, colors):
    shown.until(lambda: drawn(shown.scene()) > 0.01, "the canvas stays blank")
    for color, least in colors.items():
        shown.until(
            lambda color=color, least=least: near(shown.scene(), color) > least, f"nothing is {color}"
        )


def check_timeline(shown, frame):
    """The vehicle is elsewhere at another time, and the words say which."""
    flight = frame.evaluate("JSON.parse(document.getElementById('alula-data').textContent).flights[0]")
    times = [round(flight["begin"] + part * (flight["end"] - flight["begin"]), 1) for part in (0.1, 0.9)]
    words = []
    seek(frame, times[0])
    shown.page.wait_for_timeout(1500)
    early = shown.scene()
    for time in times:
        seek(frame, time)
        shown.until(
            lambda time=time: f"{time - flight['begin']:.1f} s" in frame.text_content("#alula-now"), "words"
        )
        words.append(frame.text_content("#alula-now"))
    assert words[0] != words[1]
    shown.until(
        lambda: (np.abs(shown.scene() - early).sum(axis=2) > 60).sum() > 20, "the vehicle does not move"
    )


@pytest.mark.parametrize("name", VIEWS)
def test_a_view_shows_its_scene_and_its_flight(name, folder, browser):
    words, colors = VIEWS[name]
    page = write_page(folder, "view", name, *words)
    with opened(browser, page.as_uri()) as shown:
        frame = ready(shown)
        frame.evaluate("document.getElementById('alula-head').open = false")
        check_picture(shown, colors)
        if any(word.endswith(".mcap") for word in words):
            check_timeline(shown, frame)
        assert shown.fits()
        light = shown.scene()
    if name != "run" and any(word.endswith(".mcap") for word in words):
        return  # one page with a timeline stands for all
    with opened(browser, page.as_uri(), dark=True, **PHONE) as shown:
        frame = ready(shown)
        check_picture(shown, colors)
        dark = shown.scene()
        assert shown.fits()
        ink = frame.evaluate("getComputedStyle(document.getElementById('alula')).getPropertyValue('--ink')")
        assert ink.strip() == "#e4e8ed"
    assert np.percentile(light, 90) > 200
    assert np.percentile(dark, 10) < 60


@pytest.mark.parametrize("name", REPORTS)
def test_a_report_and_the_view_in_it(name, folder, browser):
    page = write_page(folder, "report", name, *REPORTS[name])
    with opened(browser, page.as_uri(), **PHONE, dark=True) as shown:
        assert shown.fits()
        assert background(shown) < 100
        assert shown.pixels().std() > 10
    with opened(browser, page.as_uri(), width=900, height=800) as shown:
        assert shown.fits()
        assert background(shown) > 700
        switch(shown, dark=True)
        switch(shown, dark=False)
        frame = ready(shown)
        shown.until(lambda: drawn(view_of(shown)) > 0.004, "the canvas stays blank")  # a thin line is a plan
        if shown.page.locator("figure[data-time]").count():
            check_curves(shown, frame)


@pytest.mark.parametrize("window", [{"width": 1280, "height": 800}, PHONE], ids=["wide", "phone"])
def test_a_report_neither_scrolls_nor_takes_the_focus_by_itself(window, files, browser):
    page = write_page(files, "report", "run", *REPORTS["run"])
    with opened(browser, page.as_uri(), **window) as shown:

        def place():
            return shown.page.evaluate("[window.scrollX, window.scrollY, document.activeElement.tagName]")

        def wait():
            frame = shown.page.frames[1]
            frame.wait_for_function("window.alulaTime && alulaTime() > 0")
            shown.page.wait_for_timeout(500)
            return frame

        if window is PHONE:  # the view is loaded when it comes near
            shown.page.evaluate("window.scrollTo(0, 300)")
        before = place()
        assert before[2] == "BODY"
        frame = wait()
        assert place() == before
        chart = shown.page.locator("figure[data-time] svg").first
        chart.click()  # scrolls there, as a person does
        before, time = place(), frame.evaluate("alulaTime()")
        chart.click(position={"x": 100, "y": 60})
        frame.wait_for_function(f"alulaTime() !== {time}")
        shown.page.wait_for_timeout(500)
        assert place() == before
        frame.locator("#alula-plots canvas").first.click()
        time = frame.evaluate("alulaTime()")
        shown.page.keyboard.press("ArrowRight")  # goes to the view, not to its field of the time
        frame.wait_for_function(f"alulaTime() > {time} + 0.3")


def switch(shown, *, dark):
    """Click until the colors change: a page that loads its view may miss a click."""

    def has_changed():
        if (background(shown) < 100) != dark:
            shown.page.locator(".switch input").click()
            shown.page.wait_for_timeout(500)
        return (background(shown) < 100) == dark

    shown.until(has_changed, "the colors do not change")


def background(shown):
    color = shown.page.evaluate("getComputedStyle(document.body).backgroundColor")
    return sum(int(n) for n in re.findall(r"\d+", color)[:3])


def view_of(shown):
    """The canvas of the view in a report."""
    box = shown.page.locator("iframe").bounding_box()
    top, left = max(0, round(box["y"])), round(box["x"])
    return shown.pixels()[
        top + 60 : round(box["y"] + box["height"]) - 160, left + 5 : left + round(box["width"]) - 5
    ]


def check_curves(shown, frame):
    """A marker in the curves follows the view, and a click in them moves the view."""
    chart = shown.page.locator("figure[data-time]").first
    axis, flights = (
        chart.evaluate("figure => JSON.parse(figure.dataset.time)"),
        frame.evaluate("JSON.parse(document.getElementById('alula-data').textContent).flights"),
    )
    (flight,) = [f for f in flights if (f["run"], f["trial"]) == (axis["run"], axis["trial"])]
    box = chart.locator("svg").bounding_box()

    def place(time):
        part = (time - axis["begin"]) / (axis["end"] - axis["begin"])
        return box["width"] * (axis["left"] + part * (axis["right"] - axis["left"]))

    def mark():
        found = chart.locator("line.now").bounding_box()
        return -1.0 if found is None else found["x"] - box["x"]

    # The timeline takes two decimals, and rounds them to one when its field loses the focus.
    worst = flight["begin"] + max(0.01, flight["worst"])
    frame.wait_for_function(f"Math.abs(alulaTime() - {worst}) <= 0.051")
    middle = round(0.5 * (flight["end"] - flight["begin"]), 1)
    seek(frame, flight["begin"] + middle)
    chart.scroll_into_view_if_needed()
    box = chart.locator("svg").bounding_box()
    shown.until(lambda: abs(mark() - place(flight["from"] + middle)) < 4, "the marker does not follow")
    asked = flight["from"] + 0.8 * (flight["end"] - flight["begin"])
    chart.locator("svg").click(position={"x": place(asked), "y": 0.5 * box["height"]})
    now = flight["begin"] + asked - flight["from"]
    near = 0.02 * (axis["end"] - axis["begin"])
    frame.wait_for_function(f"Math.abs(alulaTime() - {now}) < {near}")
    shown.until(lambda: abs(mark() - place(asked)) < 8, "the marker does not follow a click")
