"""Download of an input into a temporary file, bounded and checked."""

from __future__ import annotations

import base64
import hashlib
import http.client
import ssl
import tempfile
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any
from urllib.parse import quote, unquote, urlsplit

from alula import __version__
from alula.cli.shell.addresses import Address, is_allowed
from alula.schemas.errors import AlulaError, InputError
from alula.schemas.progress import Progress

TIMEOUT_S = 30.0  # without a byte
_PIECE = 2**20
_KEPT = "/%:@!$&'()*+,;=~-._?"  # characters of an address that stay as they are


@contextmanager
def downloaded(
    address: Address, most_bytes: int, sha256: str = "", progress: Progress | None = None
) -> Iterator[Path]:
    """Context with a temporary file that has the content of an address; errors name the address.

    Args:
        sha256: that it must have, in lower case; empty for any.
        progress: called with the bytes done and the bytes in all; 0 where these are unknown.

    Raises:
        InputError: it cannot be reached, is too long, is cut, or has another hash.
    """
    with tempfile.TemporaryDirectory(prefix="alula-") as folder:
        copy = Path(folder) / address.name
        try:
            with copy.open("wb") as file:
                found = _copy(address, file, most_bytes, progress)
        except OSError as error:
            raise InputError(f"{address}: {_reason(error)}") from error
        except http.client.IncompleteRead as error:
            raise InputError(f"{address}: the connection ended before the end of the file") from error
        except (http.client.HTTPException, ValueError) as error:
            raise InputError(f"{address}: the answer of the server is not valid") from error
        except InputError as error:
            raise InputError(f"{address}: {error}") from error
        if sha256 and found != sha256:
            raise InputError(f"{address}: has SHA-256 {found}, not that of --sha256")
        try:
            yield copy
        except AlulaError as error:  # users do not know the name of the copy
            error.args = tuple(str(a).replace(str(copy), str(address)) for a in error.args)
            raise


def _request(address: Address) -> urllib.request.Request:
    """The request of an address; user and password are not sent to where it may be redirected."""
    parts = urlsplit(address.text)
    query = f"?{quote(parts.query, safe=_KEPT)}" if parts.query else ""
    place = str(Address(f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}"))
    request = urllib.request.Request(
        f"{place}{quote(parts.path or '/', safe=_KEPT)}{query}",
        headers={"User-Agent": f"alula/{__version__}"},
    )
    if parts.username is not None:
        pair = f"{unquote(parts.username)}:{unquote(parts.password or '')}".encode()
        request.add_unredirected_header("Authorization", f"Basic {base64.b64encode(pair).decode()}")
    return request


class _Redirects(urllib.request.HTTPRedirectHandler):
    """Follows redirects to https; to http of this machine only from there."""

    def redirect_request(self, req: Any, fp: Any, code: int, msg: str, headers: Any, newurl: str) -> Any:
        """Refuse a redirect to any other address."""
        if not is_allowed(newurl, from_loopback=urlsplit(req.full_url).scheme == "http"):
            fp.close()
            raise InputError("is redirected to an address that is not https")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def _copy(address: Address, file: IO[bytes], most_bytes: int, progress: Progress | None) -> str:
    """Read an address into a file; its SHA-256."""
    request = _request(address)
    handlers: list[urllib.request.BaseHandler] = [
        _Redirects(),
        urllib.request.HTTPSHandler(context=ssl.create_default_context()),
    ]
    if request.type == "http":  # of this machine, which no proxy reaches
        handlers.append(urllib.request.ProxyHandler({}))
    digest, done = hashlib.sha256(), 0
    with urllib.request.build_opener(*handlers).open(request, timeout=TIMEOUT_S) as answer:
        if (coding := answer.headers.get("Content-Encoding", "identity")) != "identity":
            raise InputError(f"is sent in the coding {coding[:20]!r}, which was not asked for")
        total = answer.length or 0
        if total > most_bytes:
            raise InputError(f"has {total} bytes, more than --max-download allows ({most_bytes})")
        while piece := answer.read(_PIECE):
            done += len(piece)
            if done > most_bytes:
                raise InputError(f"is longer than --max-download allows ({most_bytes} bytes)")
            file.write(piece)
            digest.update(piece)
            if progress is not None:
                progress(done, total)
        if done < total:
            raise InputError(f"the connection ended after {done} of {total} bytes")
    return digest.hexdigest()


def _reason(error: OSError) -> str:
    """Why a download failed, in words."""
    if isinstance(error, urllib.error.HTTPError):
        error.close()
        if error.code in (301, 302, 303, 307, 308):
            return "is redirected too often, or not to https"
        words = http.client.responses.get(error.code, "")
        return f"the server answers {error.code} {words}".rstrip()
    cause = error.reason if isinstance(error, urllib.error.URLError) else error
    if isinstance(cause, ssl.SSLCertVerificationError):
        return f"the certificate of the server is not valid: {cause.verify_message}"
    if isinstance(cause, ssl.SSLError):
        return f"no secure connection: {cause.reason or 'TLS failed'}"
    if isinstance(cause, TimeoutError):
        return f"no answer for {TIMEOUT_S:g} s"
    return f"cannot be downloaded: {getattr(cause, 'strerror', None) or cause}"
