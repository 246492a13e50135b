"""Serve the page of a view on this machine only."""

from __future__ import annotations

from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, HTTPServer
from types import TracebackType
from typing import Self
from urllib.parse import parse_qs, urlsplit

from alula.schemas.errors import UsageError
from alula.stages.show.viewing.page import HOST

_KEPT = 8  # pages


class PageServer:
    """Server of one page on loopback, and with ?flight=N of the same page with another flight.

    It answers requests for this machine's own address only, so that a page of another site cannot read it.

    Args:
        make: writes the page that plays a flight, None without such a flight; the flight None is the default.
        port: to listen on; 0 takes a free one.

    Raises:
        UsageError: the port is taken.
    """

    def __init__(self, make: Callable[[int | None], str | None], port: int) -> None:
        pages: dict[int | None, bytes | None] = {}

        def page(flight: int | None) -> bytes | None:
            if flight not in pages:
                while len(pages) >= _KEPT:
                    pages.pop(next(iter(pages)))
                text = make(flight)
                pages[flight] = None if text is None else text.encode()
            return pages[flight]

        page(None)  # errors appear before the address does
        try:
            self._server = HTTPServer((HOST, port), _handler(page))
        except OSError as error:
            raise UsageError(f"--port {port}: {error.strerror}") from error
        self.url = f"http://{HOST}:{self._server.server_port}/"

    def run(self) -> None:
        """Answer requests until an exception ends it."""
        self._server.serve_forever()

    def stop(self) -> None:
        """End `run`, from another thread."""
        self._server.shutdown()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.server_close()


def _handler(page: Callable[[int | None], bytes | None]) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            """Send the page."""
            port = self.server.server_port  # type: ignore[attr-defined]
            if self.headers.get("Host") not in (f"{HOST}:{port}", f"localhost:{port}"):
                self._send(403, b"only for this machine\n", "text/plain")
                return
            asked = urlsplit(self.path)
            flight = parse_qs(asked.query).get("flight", [""])[0]
            if asked.path != "/" or (flight and not flight.isascii()) or (flight and not flight.isdecimal()):
                self._send(404, b"not found\n", "text/plain")
                return
            found = page(int(flight) if flight else None)
            if found is None:
                self._send(404, b"no log has the samples of that flight\n", "text/plain")
            else:
                self._send(200, found, "text/html; charset=utf-8")

        def _send(self, code: int, body: bytes, kind: str) -> None:
            self.send_response(code)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            """Print nothing."""

    return Handler
