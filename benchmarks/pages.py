"""How large pages are, how fast they are written, and how soon they answer in a browser without a GPU.

The built-in room with 200,000 Gaussians and 1,000 hulls, and a run of it. Chromium draws on the processor. A
report answers when a click on its box of colours has repainted it. A view answers when a time that was sought
is shown in a frame that was drawn after it. Both times count from the request for the page; `cpu_s` are the
seconds of all processes of the browser until then, which other programs hardly change. In turns with each
page a small view is opened, of one flight among 20 hulls, so that the ratio shows what the contents cost.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parent))
sys.path.sort(key=sys.path[-1].__eq__)  # last: a module of the same name elsewhere comes first

from scenes import room, voxels_of

from alula.cli.main import run
from alula.schemas.artifacts.artifact import write_artifact
from alula.schemas.parameters.configs.merge import MergeConfig
from alula.stages.compression.merge import merge

_SOFTWARE = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox")
_SCENARIO = """
schema = "alula/scenario"
version = "2.0"
name = "pairs"
[vehicle]
type = "single-integrator"
radius_m = 0.12
[world]
cover = "{cover}.cover.npz"
[safety]
filters = ["polytope-cbf"]
[rules]
trials = {trials}
logged = {trials}
"""
_PATIENCE_MS = 120_000
# Counts the calls that draw in WebGL, before the page's own code.
_COUNT = """
window.alulaDrawn = 0;
for (const name of ["drawElements", "drawArrays", "drawElementsInstanced", "drawArraysInstanced"]) {
  const draw = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...words) {
    window.alulaDrawn++;
    return draw.apply(this, words);
  };
}
"""
# Seeks a time as soon as there is a timeline, and again if the view goes elsewhere by itself, as it does once
# in a report; the answer is the time since the request for this page [ms].
_SEEK = """() => new Promise(done => {
  let sought = null, before = 0;
  const look = () => {
    const now = window.alulaTime ? alulaTime() : null;
    const isThere = sought !== null && Math.abs(now - sought) < 0.05;
    if (now !== null && !isThere) { sought ??= now + 0.5; before = alulaDrawn; alulaSeek(sought); }
    if (isThere && alulaDrawn > before)
      requestAnimationFrame(() => requestAnimationFrame(() => done(performance.now())));
    else setTimeout(look, 5);
  };
  look();
})"""
_REPAINT = """() => new Promise(done => {
  const color = () => getComputedStyle(document.body).backgroundColor, before = color();
  document.querySelector(".switch input").click();
  const painted = () => done(color() === before ? NaN : performance.now());
  requestAnimationFrame(() => requestAnimationFrame(painted));
})"""


def write_pages(folder: Path, gaussians: int, hulls: int, trials: int) -> dict[str, Any]:
    """Write scene, cover, run and pages into a folder; return sizes and times of the commands."""
    scene = room(gaussians)
    write_artifact(folder / "room.scene.npz", scene)
    write_artifact(folder / "room.cover.npz", merge(MergeConfig(hulls=hulls), voxels_of(scene, 0.05)))
    write_artifact(folder / "small.cover.npz", merge(MergeConfig(hulls=20), voxels_of(scene, 0.2)))
    for name, cover, count in (
        ("some", "room", min(100, trials)),
        ("all", "room", trials),
        ("one", "small", 1),
    ):
        (folder / f"{name}.toml").write_text(_SCENARIO.format(trials=count, cover=cover))
        _alula("simulate", folder / f"{name}.toml", "-o", folder / f"{name}.run.mcap")
    artifacts = ("--cover", folder / "room.cover.npz", "--scene", folder / "room.scene.npz")
    report_s = _alula("report", folder / "some.run.mcap", *artifacts, "-o", folder / "report.html")
    many_s = _alula("report", folder / "all.run.mcap", "-o", folder / "many.html")
    files = (folder / "some.run.mcap", folder / "room.cover.npz", folder / "room.scene.npz")
    view_s = _alula("view", *files, "-o", folder / "view.html")
    _alula("view", folder / "one.run.mcap", "-o", folder / "small.html")
    return {
        "report_mb": (folder / "report.html").stat().st_size / 1e6,
        "report_s": report_s,
        "view_mb": (folder / "view.html").stat().st_size / 1e6,
        "view_s": view_s,
        "report_of_all_trials_s": many_s,
    }


def _alula(*words: object) -> float:
    """Run a command; return its wall seconds."""
    begin = time.perf_counter()
    code = run([*map(str, words), "-q"])
    if code != 0:
        raise SystemExit(f"alula {words[0]} ended with {code}")
    return time.perf_counter() - begin


def cpu_s(profile: str) -> float:
    """CPU seconds of all processes of the browser with a profile, by the kernel's counters."""
    ticks = 0
    for process in Path("/proc").iterdir():
        try:
            if process.name.isdecimal() and profile in (process / "cmdline").read_text(errors="replace"):
                words = (process / "stat").read_text().rpartition(")")[2].split()
                ticks += int(words[11]) + int(words[12])
        except OSError:  # it has just ended
            continue
    return ticks / os.sysconf("SC_CLK_TCK")


def answer(page: Path, *, is_report: bool) -> dict[str, float]:
    """Open a page in a new browser and measure when it answers.

    Args:
        page: to open.
        is_report: its box of colours is clicked first, then the view in it is brought into sight.
    """
    from playwright.sync_api import sync_playwright

    program = next(filter(None, map(shutil.which, ("chromium", "google-chrome", "chromium-browser"))))
    with sync_playwright() as play, tempfile.TemporaryDirectory(prefix="alula-browser-") as profile:
        context = play.chromium.launch_persistent_context(
            profile, executable_path=program, args=list(_SOFTWARE), viewport={"width": 1280, "height": 800}
        )
        shown = context.pages[0]
        shown.set_default_timeout(_PATIENCE_MS)
        shown.add_init_script(_COUNT)
        before = cpu_s(profile)
        begin = time.perf_counter()
        shown.goto(page.as_uri(), wait_until="commit")
        found = {}
        frame: Any = shown
        if is_report:
            shown.wait_for_selector(".switch input")
            found["page_s"] = shown.evaluate(_REPAINT) / 1e3
            # Without a handle: Playwright describes one by its attributes, of which one is the whole view.
            shown.evaluate("document.querySelector('iframe').scrollIntoView()")
            while len(shown.frames) < 2 or shown.frames[1].url != "about:srcdoc":
                shown.wait_for_timeout(5)
            frame = shown.frames[1]
        frame.evaluate(_SEEK)
        found["view_s"] = time.perf_counter() - begin
        found["cpu_s"] = cpu_s(profile) - before
        context.close()
    return found


def measured(folder: Path, runs: int) -> list[dict[str, Any]]:
    """Answers of report and view, each in turns with the small view: medians, minima and ratios."""
    rows = []
    for name in ("report", "view"):
        ours, small = [], []
        for _ in range(runs):
            ours.append(answer(folder / f"{name}.html", is_report=name == "report"))
            small.append(answer(folder / "small.html", is_report=False))
        row: dict[str, Any] = {"page": name}
        for key in ours[0]:
            row[key] = statistics.median(one[key] for one in ours)
            row[f"least_{key}"] = min(one[key] for one in ours)
        for key in small[0]:
            row[f"small_{key}"] = statistics.median(one[key] for one in small)
            row[f"{key}_ratio"] = statistics.median(a[key] / b[key] for a, b in zip(ours, small, strict=True))
        rows.append(row | {"runs": ours})
    return rows


def main() -> int:
    """Write and open the pages; return 1 when one is too large or no browser answers."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gaussians", type=int, default=200_000)
    parser.add_argument("--hulls", type=int, default=1000)
    parser.add_argument("--trials", type=int, default=3000, help="of the run whose report is timed")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write all figures to FILE")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="alula-bench-") as name:
        folder = Path(name)
        written = write_pages(folder, options.gaussians, options.hulls, options.trials)
        rows = measured(folder, options.runs)
    for key, value in written.items():
        print(f"{key}: {value:.2f}")
    for row in rows:
        print(
            ", ".join(f"{key} {value:.2f}" for key, value in row.items() if isinstance(value, float)),
            f"({row['page']})",
        )
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    if options.json is not None:
        document = {
            "machine": f"{platform.machine()}, {os.cpu_count()} processors",
            "load": os.getloadavg(),
            "written": written,
            "answers": rows,
        }
        options.json.write_text(json.dumps(document, indent=2) + "\n")
    return 0 if max(written["report_mb"], written["view_mb"]) < 8 else 1


if __name__ == "__main__":
    sys.exit(main())
