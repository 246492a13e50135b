"""Pages of reports in Chromium: no error, no request, the width of a phone, light and dark."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.artifact import write_artifact
from support.fabricate import box, make_cover, make_plan, make_record, make_scene, make_trial, write_run

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium"),
]
# A copy of a page gets this script, which its policy allows; the page itself has none.
ASK = (
    "<script>addEventListener('load', () => {{ {act} document.title = JSON.stringify("
    "[document.documentElement.scrollWidth, innerWidth, getComputedStyle(document.body).backgroundColor]) "
    "}})</script></main>"
)


@pytest.fixture(scope="module")
def pages(tmp_path_factory) -> dict[str, Path]:
    """A report of each kind."""
    folder = tmp_path_factory.mktemp("pages")
    cover = make_cover([box((0, 0, 0), (80, 60, 2)), box((40, 10, 0), (50, 30, 60))], summary={"voxels": 900})
    write_artifact(folder / "c.cover.npz", cover)
    write_artifact(folder / "s.scene.npz", make_scene(300))
    write_artifact(folder / "p.plan.npz", make_plan())
    trials = [make_trial(i, clearance=0.1 * i - 0.05) for i in range(3)]
    for name in ("a", "b"):
        write_run(folder / f"{name}.run.mcap", make_record(trials), hulls=2)
    a, b = (str(folder / f"{name}.run.mcap") for name in "ab")
    words = {
        "flights": [a, "--cover", str(folder / "c.cover.npz"), "--scene", str(folder / "s.scene.npz")],
        "comparison": [a, b],
        "cover": ["--cover", str(folder / "c.cover.npz")],
        "plan": ["--plan", str(folder / "p.plan.npz")],
    }
    for name, each in words.items():
        assert run(["report", *each, "-o", str(folder / f"{name}.html"), "-q"]) == 0
    return {name: folder / f"{name}.html" for name in words}


def browse(page: Path, *words: str, width: int = 1280) -> subprocess.CompletedProcess[str]:
    command = [
        *(CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--v=0"),
        *("--hide-scrollbars", f"--user-data-dir={page.parent / 'profile'}", f"--window-size={width},900"),
        *(*words, page.as_uri()),
    ]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)


def asked(page: Path, width: int, act: str = "", *words: str) -> list:
    copy = page.with_name(f"{page.stem}-asked.html")
    copy.write_text(page.read_text().replace("</main>", ASK.format(act=act)))
    found = browse(copy, "--dump-dom", *words, width=width).stdout
    return re.search(r"<title>\[(\d+),(\d+),\"([^\"]*)\"\]", found.replace("&quot;", '"')).groups()


# Without a graphics card, and what viser says of itself; Chromium logs every line as INFO.
_HARMLESS = ("WebGL", "GPU", "Detected chrome version", "Embedded data loaded!")


@pytest.mark.parametrize("kind", ["flights", "comparison", "cover", "plan"])
def test_a_page_loads_without_an_error_and_asks_for_nothing(pages, kind):
    said = browse(pages[kind], "--screenshot=" + str(pages[kind].with_suffix(".png"))).stderr
    console = [line for line in said.splitlines() if "CONSOLE" in line]
    assert not [line for line in console if not any(word in line for word in _HARMLESS)], console
    assert pages[kind].with_suffix(".png").stat().st_size > 20_000


@pytest.mark.parametrize("kind", ["flights", "comparison", "cover", "plan"])
@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_is_wider_than_the_window(pages, kind, width):
    needed, given, _ = asked(pages[kind], width)
    assert int(needed) <= int(given)


def test_the_box_switches_between_light_and_dark(pages):
    """A click without a script of the page: the style sheet alone does it."""
    light = asked(pages["cover"], 1280)[2]
    dark = asked(pages["cover"], 1280, "document.querySelector('.switch input').click();")[2]
    assert np.sum([int(n) for n in re.findall(r"\d+", light)]) > 700
    assert np.sum([int(n) for n in re.findall(r"\d+", dark)]) < 100
    by_system = asked(pages["cover"], 1280, "", "--blink-settings=preferredColorScheme=0")[2]
    assert by_system == dark
