"""One offline page: the scene and its flights as viser records them, and what is said about them around it."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from html import escape
from typing import Any

from alula.schemas.configs.view import MOST_GAUSSIANS
from alula.stages.viewing.content import Content
from alula.stages.viewing.draw import Span, draw, record
from alula.stages.viewing.overlay import BEFORE, MARKUP, SCRIPT, STYLE
from alula.stages.viewing.plots import flight_data

HOST = "127.0.0.1"
MOST_BYTES = 7_000_000
LIGHT_GAUSSIANS = 20_000
_DATA = re.compile(r'window\.__VISER_EMBED_DATA__="([A-Za-z0-9+/=]*)";')
# The policy blocks every request. viser's code, workers and the decoder of the data are inside the page.
POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data: blob:; font-src data:; "
    "script-src 'unsafe-inline' 'unsafe-eval' blob: data:; worker-src blob: data:; connect-src data: blob:"
)
_DARK = "{darkMode:false}"
_DARK_BY_SYSTEM = "{darkMode:matchMedia('(prefers-color-scheme: dark)').matches}"


@contextmanager
def recording() -> Iterator[Any]:
    """Context with a `viser.ViserServer` to draw into; it listens on loopback while the context is open."""
    import viser

    with redirect_stdout(io.StringIO()):  # viser prints its address
        server = viser.ViserServer(host=HOST, port=0, verbose=False)
    try:
        yield server
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()


def page(
    content: Content, light: Content | None = None, *, provenance_line: str = "", other: str = ""
) -> str:
    """Write the page of a view; it loads nothing from elsewhere, and the same content gives the same text.

    Args:
        content: of the view.
        light: the same with fewer Gaussians, for a browser without a GPU.
        provenance_line: put into the head, where `read_provenance` finds it; without <, > and --.
        other: how to see a flight that the page does not play, in words; "" when it plays all.

    Returns:
        The HTML text.
    """
    text, spans = _recorded(content)
    found = _DATA.search(text)
    assert found is not None
    data = f'"{found[1]}"'
    if light is not None:
        few = _DATA.search(_recorded(light)[0])
        assert few is not None
        data = f'alulaDraws("{few[1]}",{light.gaussians},"{found[1]}",{content.gaussians})'
    text = f"{text[: found.start()]}window.__VISER_EMBED_DATA__={data};{text[found.end() :]}"
    return _around(text, content, spans, provenance_line, other)


def _recorded(content: Content) -> tuple[str, list[Span]]:
    """viser's page of a content, and where the flights lie on its timeline."""
    with recording() as server:
        draw(server, content)
        serializer = server.get_scene_serializer()
        spans = record(server, content.plays, serializer.insert_sleep)
        return serializer.as_html(), spans


def within(
    make: Callable[[int], Content],
    *,
    maximum: int = MOST_BYTES,
    most_gaussians: int = MOST_GAUSSIANS,
    **options: Any,
) -> tuple[str, Content]:
    """Write the page of a view in at most `maximum` bytes, with fewer Gaussians if it must be.

    For browsers without a GPU it also has the scene with at most `LIGHT_GAUSSIANS`, and never fewer.

    Args:
        make: content of a view with at most so many Gaussians.
        maximum: number of bytes.
        most_gaussians: number to begin with.
        options: as of `page`.

    Returns:
        The page, and what it shows.
    """
    content = make(most_gaussians)
    count = content.gaussians
    light = make(LIGHT_GAUSSIANS) if count > LIGHT_GAUSSIANS else None
    text = page(content, light, **options)
    if len(text) <= maximum or light is None:
        return text, content
    bare = len(page(light, light, **options))
    each = (len(text) - bare) / (count - LIGHT_GAUSSIANS)
    while len(text) > maximum and count > LIGHT_GAUSSIANS:
        room = int(0.98 * (maximum - bare) / each) + LIGHT_GAUSSIANS
        count = max(min(room, int(0.95 * count)), LIGHT_GAUSSIANS)
        content = make(count)
        text = page(content, light, **options)
    return text, content


def _around(text: str, content: Content, spans: list[Span], provenance_line: str, other: str) -> str:
    """Add title, policy, and what stands over the scene, to the page of viser."""
    facts = {
        "title": content.title,
        "flights": flight_data(content.plays, spans),
        "legend": content.legend,
        "notes": list(content.notes),
        "other": other,
    }
    data = json.dumps(facts, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
    head = (
        (f"<!-- {provenance_line} -->" if provenance_line else "")
        + f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        + f"<style>{STYLE}</style><script>{BEFORE}</script>"
    )
    body = (
        MARKUP.replace("TITLE", escape(content.title))
        + f'<script type="application/json" id="alula-data">{data}</script><script>{SCRIPT}</script>'
    )
    start, end = text.index("<head>") + len("<head>"), text.rindex("</body>")
    inner = text[start:end].replace(_DARK, _DARK_BY_SYSTEM, 1)
    before, _, rest = inner.partition("<title>")
    inner = f"{before}<title>{escape(content.title)}{rest[rest.index('</title>'):]}" if rest else inner
    return text[:start] + head + inner + body + text[end:]
