"""The page of all papers in Chromium: no error, no request, the width of a phone, dark, and its choice."""

import re
import shutil
import subprocess

import pytest

from papers.collected import collect
from papers.page import papers_page
from support.flights.papers import PRODUCER, SVG, jerk_rows, record

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium"),
]
# The page has no script and forbids any; a copy may run this one.
ASK = (
    "<script>addEventListener('load', () => {{ {act} document.title = JSON.stringify("
    "[document.documentElement.scrollWidth, innerWidth, getComputedStyle(document.body).backgroundColor, "
    "[...document.querySelectorAll('tbody')].filter(b => b.offsetHeight).length, "
    "Math.ceil(Math.max(...[...document.querySelectorAll('main :not(svg *)')].map(e => "
    "e.getBoundingClientRect().right)))]) }})</script></main>"
)


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    names = ("figure-2-room", "figure-3-room")
    papers = collect([record(jerk_rows(), figures=names)], PRODUCER)
    path = tmp_path_factory.mktemp("papers") / "papers.html"
    path.write_text(papers_page(papers, {("fastbridge", name): SVG for name in names}))
    return path


def browse(path, *words, width=1280):
    command = [
        *(CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--v=0"),
        *("--hide-scrollbars", f"--user-data-dir={path.parent / 'profile'}", f"--window-size={width},900"),
        *(*words, path.as_uri()),
    ]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)


def asked(path, act="", *words, width=1280):
    copy = path.with_name("asked.html")
    text = path.read_text().replace("default-src 'none';", "default-src 'none'; script-src 'unsafe-inline';")
    copy.write_text(text.replace("</main>", ASK.format(act=act)))
    found = browse(copy, "--dump-dom", *words, width=width).stdout.replace("&quot;", '"')
    known = re.search(r'<title>\[(\d+),(\d+),"([^"]*)",(\d+),(\d+)\]', found)
    needed, given, colour, shown, right = known.groups()
    return int(needed), int(given), [int(part) for part in re.findall(r"\d+", colour)], int(shown), int(right)


def test_it_loads_without_an_error(page):
    said = browse(page, f"--screenshot={page.with_suffix('.png')}").stderr
    assert not [line for line in said.splitlines() if "CONSOLE" in line]
    assert page.with_suffix(".png").stat().st_size > 20_000


@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_is_wider_than_the_window(page, width):
    """Chromium's window is at least 500 wide: a narrower page is laid out in a part of it."""
    act = f"document.documentElement.style.width = '{width}px';"
    needed, given, _, _, right = asked(page, act, width=width)
    assert needed <= given
    assert width / 2 < right <= width


def test_it_follows_the_system_into_the_dark_and_the_box_switches_back(page):
    dark = "--blink-settings=preferredColorScheme=0"
    assert sum(asked(page)[2]) > 700
    assert sum(asked(page, "", dark)[2]) < 100
    assert sum(asked(page, "document.querySelector('.switch input').click();", dark)[2]) > 700


def test_the_choice_shows_the_claims_of_one_verdict(page):
    every = asked(page)[3]
    refuted = asked(page, "document.querySelector('#only-refuted').click();")[3]
    assert every > 200
    assert refuted == 1
