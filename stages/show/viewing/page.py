"""One offline page: scene and flights as viser records them, and what is said about them around it."""

from __future__ import annotations

import json
import re
from base64 import b64encode
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from alula.schemas.parameters.configs.view import MOST_GAUSSIANS
from alula.stages.reporting.page import POLICY
from alula.stages.show.drawing.content import Content, Gaussians
from alula.stages.show.viewing.draw import Span, draw, record
from alula.stages.show.viewing.encode import still_webp
from alula.stages.show.viewing.film import still
from alula.stages.show.viewing.light import LIGHT_GAUSSIANS, lightened
from alula.stages.show.viewing.overlay import MARKUP, asset, style
from alula.stages.show.viewing.plots import flight_data

HOST = "127.0.0.1"
MOST_BYTES = 7_000_000
_AROUND_BYTES = 350_000  # of what stands around the scene
_IN_A_PAGE = 1.07  # viser's data compress worse than the arrays alone (measured: 1.06)
_STILL_PX, _STILL_BYTES = (1000, 625), 150_000  # of the picture for browsers without WebGL
_DATA = re.compile(r'window\.__VISER_EMBED_DATA__="([A-Za-z0-9+/=]*)";')
_DARK = "{darkMode:false}"
_DARK_BY_SYSTEM = "{darkMode:matchMedia('(prefers-color-scheme: dark)').matches}"


@contextmanager
def _silent() -> Iterator[None]:
    """Viser prints its address and its end with rich, which a notebook shows wherever stdout leads."""
    from rich import get_console

    console = get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


@contextmanager
def recording() -> Iterator[Any]:
    """Context with a `viser.ViserServer` to draw into; it listens on loopback while the context is open."""
    import viser

    with _silent():
        server = viser.ViserServer(host=HOST, port=0, verbose=False)
    try:
        yield server
    finally:
        with _silent():
            server.stop()


@dataclass(frozen=True, slots=True)
class _Recording:
    """viser's page without its data, the data, and where the flights lie on the timeline."""

    before: str
    data: str
    after: str
    spans: list[Span]

    @property
    def frame_bytes(self) -> int:
        return len(self.before) + len(self.after)


def page(content: Content, *, provenance_line: str = "") -> str:
    """Write the page of a view; it loads nothing from elsewhere, and the same content gives the same text.

    Args:
        provenance_line: put into the head, where `read_provenance` finds it; without <, > and --.
    """
    found = _record(content)
    return _around(found, f'"{found.data}"', content, provenance_line, _image(content))


def _image(content: Content) -> str:
    """HTML of a still picture, with its data."""
    data = b64encode(still_webp(still(content, _STILL_PX), _STILL_BYTES)).decode()
    return f'<img alt="The scene as it looks at first" src="data:image/webp;base64,{data}">'


def within(
    make: Callable[[int], Content],
    *,
    maximum: int = MOST_BYTES,
    gaussians: int | None = None,
    provenance_line: str = "",
) -> tuple[str, Content]:
    """Write the page of a view in at most `maximum` bytes, with fewer Gaussians if it must be.

    For browsers without a GPU it also has the scene as `lightened`. It never has fewer Gaussians than that.

    Args:
        make: content of a view with at most so many Gaussians.
        gaussians: show so many, whatever the number of bytes; None: at most `MOST_GAUSSIANS`, and fewer where
            the page would be too large.
        provenance_line: as of `page`.
    """
    content = make(MOST_GAUSSIANS if gaussians is None else gaussians)
    light = lightened(content, make)
    image = _image(content)
    few = _record(light)
    if light is content:
        return _around(few, f'"{few.data}"', content, provenance_line, image), content
    each = _bytes_each(content)
    room: float = maximum - few.frame_bytes - 2 * len(few.data) - _AROUND_BYTES
    while True:
        count = max(LIGHT_GAUSSIANS, LIGHT_GAUSSIANS + int(room / each))
        if gaussians is None and count < content.gaussians:
            content = make(count)
        many = _record(content)
        data = f'alulaDraws("{few.data}",{json.dumps(_less(light, content))},"{many.data}")'
        text = _around(many, data, content, provenance_line, image)
        if gaussians is not None or len(text) <= maximum or content.gaussians <= LIGHT_GAUSSIANS:
            return text, content
        room -= 1.2 * (len(text) - maximum)


def _less(light: Content, content: Content) -> str:
    """What a browser without a GPU leaves out, in words."""
    if light.gaussians == content.gaussians:
        return "fewer edges and points of paths, because this browser draws without a GPU"
    return f"{light.gaussians:,} of {content.gaussians:,} Gaussians, because this browser draws without a GPU"


def _bytes_each(content: Content) -> float:
    """Bytes of a page per Gaussian: packed as viser packs them, compressed, and in base 64."""
    import zstandard

    compressor, size, count = zstandard.ZstdCompressor(level=6), 0, 0
    for part in content.parts:
        if isinstance(part, Gaussians):
            upper = part.covariance.reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]].astype(np.float16)
            opacity = np.round(255 * part.opacity[:, None]).astype(np.uint8)
            words = (part.mean.view(np.uint8), np.ascontiguousarray(upper).view(np.uint8))
            packed = np.hstack([*words, part.color, opacity])
            size, count = size + len(compressor.compress(packed.tobytes())), count + len(packed)
    return max(_IN_A_PAGE * 4 / 3 * size / max(count, 1), 1.0)


def _record(content: Content) -> _Recording:
    with recording() as server:
        draw(server, content)
        serializer = server.get_scene_serializer()
        spans = record(server, content.plays, serializer.insert_sleep)
        text: str = serializer.as_html()
    found = _DATA.search(text)
    assert found is not None
    return _Recording(text[: found.start()], found[1], text[found.end() :], spans)


def _around(found: _Recording, data: str, content: Content, provenance_line: str, image: str) -> str:
    """Add the data, a title, a policy, and what stands over the scene, to the page of viser."""
    facts = {
        "title": content.title,
        "flights": flight_data(content.plays, found.spans),
        "legend": content.legend,
        "notes": list(content.notes),
    }
    facts_text = json.dumps(facts, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
    camera = {"position": [*content.camera.position], "look_at": [*content.camera.look_at]}
    before, script = (asset(name) for name in ("before.js", "overlay.js"))
    head = (
        (f"\n<!-- {provenance_line} -->\n" if provenance_line else "")
        + f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        + f"<style>{style()}</style><script>window.alulaCamera={json.dumps(camera)};{before}</script>"
        f"<script>{asset('measure.js')}</script>"
    )
    body = (
        MARKUP.replace("STILL", image).replace("TITLE", escape(content.title), 1)
        + f'<script type="application/json" id="alula-data">{facts_text}</script><script>{script}</script>'
    )
    start, end = found.before.index("<head>") + len("<head>"), found.after.rindex("</body>")
    first, _, titled = found.before[start:].partition("<title>")
    titled = titled[titled.index("</title>") :] if titled else ""
    inner = f"{first}<title>{escape(content.title)}{titled}" if titled else found.before[start:]
    after = found.after.replace(_DARK, _DARK_BY_SYSTEM, 1)
    end += len(after) - len(found.after)
    return (
        f"{found.before[:start]}{head}{inner}window.__VISER_EMBED_DATA__={data};"
        f"{after[:end]}{body}{after[end:]}"
    )
