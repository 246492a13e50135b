"""Make the pictures of docs/tutorial.md: `python docs/tutorial_pictures.py FOLDER`.

FOLDER is where the tutorial's commands ran. This needs Chromium, playwright of the development group, and a
minute.
"""

from __future__ import annotations

import io
import shutil
import sys
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

from alula.cli.main import run

PICTURES = Path(__file__).parent / "pictures"
SOFTWARE = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
WIDTH = 900  # [px]

VIEWS = {
    "splat": ["room.metric.scene.npz"],
    "voxels": ["room.voxels.npz"],
    "cover": ["room.cover.npz"],
    "plan": ["room.metric.scene.npz", "room.cover.npz", "room.plan.npz"],
    "flight": ["room.metric.scene.npz", "hoops.run.mcap"],
}


def save(picture: bytes, name: str) -> None:
    """Write a picture as WebP, small enough for a repository."""
    image = Image.open(io.BytesIO(picture)).convert("RGB")
    path = PICTURES / f"tutorial-{name}.webp"
    image.save(path, quality=80, method=6)
    sys.stdout.write(f"{path}: {path.stat().st_size} bytes\n")


def view(page: Page, folder: Path, name: str, inputs: list[str]) -> None:
    """Take a picture of a page of `alula view`, at the middle of a flight if one is played."""
    target = folder / f"{name}.html"
    if run(["view", *(str(folder / each) for each in inputs), "-o", str(target), "-f", "-q"]):
        raise SystemExit(f"cannot view {inputs}")
    page.goto(target.absolute().as_uri())
    page.wait_for_timeout(8000)
    page.evaluate("document.getElementById('alula-head')?.removeAttribute('open')")
    if name == "flight":
        page.evaluate("alulaSeek(3.4)")
    page.wait_for_timeout(8000)
    save(page.screenshot(timeout=120_000), name)


def main() -> None:
    """Take all pictures."""
    folder = Path(sys.argv[1])
    with sync_playwright() as play:
        program = shutil.which("chromium") or shutil.which("chromium-browser")
        browser = play.chromium.launch(executable_path=program, args=SOFTWARE)
        page = browser.new_page(viewport={"width": WIDTH, "height": 540}, color_scheme="light")
        for name, inputs in VIEWS.items():
            view(page, folder, name, inputs)
        page.goto((folder / "room.html").absolute().as_uri())
        page.wait_for_timeout(5000)
        save(page.screenshot(timeout=120_000), "report")
        browser.close()


if __name__ == "__main__":
    main()
