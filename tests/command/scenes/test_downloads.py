"""Inputs at addresses of the web, from a server of this machine: content, hash, limits, redirects, errors."""

import gzip
import hashlib
import json
import shutil
import ssl
import subprocess
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import click
import pytest

from alula.cli.main import run
from alula.cli.shell import download
from alula.cli.shell.addresses import Address, ByteCount
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.artifacts.parts import open_parts
from alula.schemas.errors import UsageError
from support.files import splat_files

SPLAT = splat_files.splat(splat_files.some_gaussians(50))["a.splat"]
SHA256 = hashlib.sha256(SPLAT).hexdigest()
ELSEWHERE = {
    "/moved": "/a.splat",
    "/unsafe": "http://192.0.2.1/a.splat",
    "/file": "file:///etc/passwd",
    "/circle": "/circle",
    "/down": "http://127.0.0.1:1/a.splat",
}


class Handler(BaseHTTPRequestHandler):
    """Serves files of memory, and answers that are wrong in one way each."""

    protocol_version = "HTTP/1.0"

    def do_GET(self):
        self.server.seen.append((self.path, dict(self.headers)))
        path = self.path.partition("?")[0]
        if path in ELSEWHERE:
            self.answer(302, b"", Location=ELSEWHERE[path])
        elif path == "/cut.splat":
            self.answer(200, SPLAT[:320], **{"Content-Length": str(len(SPLAT))})
        elif path == "/endless":
            self.send_response(200)
            self.end_headers()
            while not self.wfile.closed:
                try:
                    self.wfile.write(bytes(2**16))
                except OSError:
                    return
        elif path == "/gzip.splat":
            self.answer(200, gzip.compress(SPLAT), **{"Content-Encoding": "gzip"})
        elif path == "/nonsense":
            self.wfile.write(b"\x00no HTTP\x1b[2J\r\n\r\n")
        elif path == "/silent":
            self.server.over.wait(10)
        elif path in self.server.files:
            self.answer(200, self.server.files[path])
        else:
            self.answer(404, b"<html>")

    def answer(self, code, body, **headers):
        self.send_response(code, "\x1b[2J")
        for name, value in ({"Content-Length": str(len(body))} | headers).items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


@pytest.fixture
def server(monkeypatch, tmp_path):
    monkeypatch.setenv("http_proxy", "http://192.0.2.1:1")  # loopback needs no proxy
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as made:
        made.seen, made.files, made.over = [], {"/a.splat": SPLAT}, threading.Event()
        made.at = f"http://127.0.0.1:{made.server_port}"
        thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield made
        made.over.set()
        made.shutdown()
        thread.join()
    assert list((tmp_path / "temporary").iterdir()) == []  # copies are removed


def test_a_download_is_read_like_the_file_and_recorded_without_secrets(server, tmp_path, capsys):
    (tmp_path / "a.splat").write_bytes(SPLAT)
    out = tmp_path / "s.scene.npz"
    secret = f"{server.at.replace('//', '//anna:pass%20word@')}/a.splat?token=hidden#part"
    assert run(["import-splat", secret, "-o", str(out), "--json"]) == 0
    (ref,) = read_artifact(out, SCENE).manifest.inputs
    assert (ref.role, ref.name, ref.sha256) == ("splat", f"{server.at}/a.splat", SHA256)
    path, headers = server.seen[0]
    assert path == "/a.splat?token=hidden"
    assert headers["Authorization"] == "Basic YW5uYTpwYXNzIHdvcmQ="
    assert b"hidden" not in out.read_bytes()
    capsys.readouterr()
    # The same bytes from another address or a file: nothing to do.
    for same in (f"{server.at}/moved", str(tmp_path / "a.splat")):
        assert run(["import-splat", same, "-o", str(out), "--format", "auto"]) == 0
        assert "unchanged" in capsys.readouterr().out
    server.files["/a.splat"] = SPLAT[32:]
    assert run(["import-splat", f"{server.at}/a.splat", "-o", str(out)]) == 2
    assert "its inputs were different; -f replaces it" in capsys.readouterr().err


def test_downloads_and_files_are_joined_in_their_order(server, tmp_path):
    (tmp_path / "b.splat").write_bytes(SPLAT[:640])
    words = [f"{server.at}/a.splat", str(tmp_path / "b.splat"), "-o", str(tmp_path / "s.scene.npz")]
    assert run(["import-splat", *words, "--sha256", SHA256.upper()]) == 0
    made = read_artifact(tmp_path / "s.scene.npz", SCENE).manifest
    assert [(ref.role, ref.name) for ref in made.inputs] == [
        ("splat", f"{server.at}/a.splat"),
        ("splat 2", "b.splat"),
    ]
    assert run(["import-splat", *words[:2], f"{server.at}/a.splat", *words[2:]]) == 2  # named twice


def test_a_folder_of_parts_records_the_address(server, tmp_path):
    (tmp_path / "b.splat").write_bytes(SPLAT[:640])
    out = tmp_path / "city.scene"
    assert run(["import-splat", f"{server.at}/a.splat?x=1", str(tmp_path / "b.splat"), "-o", str(out)]) == 0
    names = {ref.name for ref in open_parts(out, SCENE).manifest.inputs}
    assert names == {f"{server.at}/a.splat", "b.splat"}


@pytest.mark.parametrize(
    ("path", "options", "words"),
    [
        ("/missing.splat", [], "the server answers 404 Not Found"),
        ("/unsafe", [], "is redirected to an address that is not https"),
        ("/file", [], "is redirected too often, or not to https"),
        ("/circle", [], "is redirected too often"),
        ("/cut.splat", [], f"the connection ended after 320 of {len(SPLAT)} bytes"),
        ("/gzip.splat", [], "is sent in the coding 'gzip'"),
        ("/nonsense", [], "the answer of the server is not valid"),
        ("/silent", [], "no answer for 0.2 s"),
        (
            "/a.splat",
            ["--max-download", "1kB"],
            f"has {len(SPLAT)} bytes, more than --max-download allows (1000)",
        ),
        ("/endless", ["--max-download", "0.1MB"], "is longer than --max-download allows (100000 bytes)"),
        ("/a.splat", ["--sha256", "0" * 64], f"has SHA-256 {SHA256}, not that of --sha256"),
        ("/text", [], "not a"),
    ],
)
@pytest.mark.parametrize("command", ["import-splat", "info"])
def test_a_bad_download_is_one_line_and_no_file(
    command, path, options, words, server, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(download, "TIMEOUT_S", 0.2)
    server.files["/text"] = b"hello"
    output = ["-o", str(tmp_path / "s.scene.npz")] if command == "import-splat" else []
    assert run([command, f"{server.at}{path}?token=hidden", *output, *options]) == 3
    error = capsys.readouterr().err
    assert error.startswith(f"alula: {server.at}{path}: ")
    assert words in error or (path == "/text" and "is not an artifact" in error)
    assert error.count("\n") == 1
    assert "hidden" not in error
    assert "\x1b" not in error
    assert "alula-" not in error  # the name of the copy
    assert not (tmp_path / "s.scene.npz").exists()


def test_user_and_password_do_not_follow_a_redirect(server, capsys):
    assert run(["info", f"{server.at.replace('//', '//anna:secret@')}/moved", "-q"]) == 0
    (_, first), (path, second) = server.seen
    assert ("Authorization" in first, path, "Authorization" in second) == (True, "/a.splat", False)


def test_info_explains_a_download(server, capsys):
    assert run(["info", f"{server.at}/a.splat?x=1", "--json", "--sha256", SHA256]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["file"] == f"{server.at}/a.splat"
    assert facts["bytes"] == len(SPLAT)
    server.files["/cut.spz"] = splat_files.spz(splat_files.some_gaussians(50))["a.spz"][:90]
    assert run(["info", f"{server.at}/cut.spz", "--json"]) == 3
    shown = capsys.readouterr()
    assert "alula-" not in shown.out + shown.err
    assert f"{server.at}/cut.spz: " in json.loads(shown.out)["damage"]


def test_a_server_that_is_not_there_is_one_line(capsys):
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as made:
        port = made.server_port
    assert run(["info", f"http://127.0.0.1:{port}/a.splat"]) == 3
    assert "cannot be downloaded: Connection refused" in capsys.readouterr().err


@pytest.mark.skipif(shutil.which("openssl") is None, reason="makes a certificate with openssl")
def test_https_needs_a_certificate_and_never_leads_to_http(server, tmp_path, capsys, monkeypatch):
    files = [tmp_path / "key.pem", tmp_path / "certificate.pem"]
    make = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    made = [*make, "-subj", "/CN=127.0.0.1", "-addext", "subjectAltName=IP:127.0.0.1"]
    subprocess.run([*made, "-keyout", files[0], "-out", files[1]], capture_output=True, check=True)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(files[1], files[0])
    server.socket = context.wrap_socket(server.socket, server_side=True)
    at = f"https://127.0.0.1:{server.server_port}"
    assert run(["info", f"{at}/a.splat"]) == 3
    assert "the certificate of the server is not valid: self" in capsys.readouterr().err
    monkeypatch.setenv("SSL_CERT_FILE", str(files[1]))
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    assert run(["info", f"{at}/a.splat", "-q"]) == 0
    assert run(["info", f"{at}/down"]) == 3
    assert "is redirected to an address that is not https" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["info", "http://example.org/a.splat"], "http is not safe against changes on the way; use https"),
        (["info", "http://localhost/a.splat"], "use https"),
        (["info", "https:///a.splat"], "the address is not valid; write https://host/path"),
        (["info", "https://host:99999/a"], "the address is not valid"),
        (["info", "https://host/a b"], "the address has a blank or a control character"),
        (["info", "a.splat", "--sha256", "0" * 64], "--sha256 is for downloads, one for each"),
        (["info", "https://host/a", "--sha256", "xyz"], "'xyz' is no SHA-256: 64 hexadecimal digits"),
        (["info", "https://host/a", "--max-download", "2 pounds"], "'2 pounds' is no size"),
        (
            ["voxelize", "https://host/a", "-o", "v.voxels.npz"],
            "addresses are inputs of import-splat and info",
        ),
        (
            ["import-splat", "a.splat", "-o", "https://host/a"],
            "addresses are inputs of import-splat and info",
        ),
        (
            ["import-splat", "https://host/a", "-o", "s.scene.npz", "--depfile", "d"],
            "the input is an address",
        ),
    ],
)
def test_wrong_usage_is_one_line_and_asks_no_server(words, error, capsys, monkeypatch):
    monkeypatch.setattr("socket.socket.connect", lambda *_: pytest.fail("connects"))
    assert run(words) == 2
    shown = capsys.readouterr().err
    assert error in shown
    assert shown.count("\n") == 1


def test_sizes_have_units():
    read = ByteCount().convert
    sizes = {"7": 7, "20MB": 20 * 10**6, "1.5GB": 1500 * 10**6, "2GiB": 2**31, "3 kB": 3000, "1M": 10**6}
    assert {text: read(text, None, None) for text in sizes} == sizes
    for text in ("0", "-1", "1TB", "GB", "1e3", "nan", ""):
        with pytest.raises(click.BadParameter):
            read(text, None, None)


def test_an_address_names_a_file_by_its_path_alone():
    names = {"a/room.spz?x=/y.ply": "room.spz", "a%20b.splat": "a b.splat", "": "download", "..": "download"}
    names |= {"a/%2e%2e%2fetc": "etc", "x/%00.ply": "download", ".hidden": "download"}
    assert {path: Address(f"https://host/{path}").name for path in names} == names
    assert str(Address("https://u:p@[2001:db8::1]:8443/a?k=v#f")) == "https://[2001:db8::1]:8443/a"
    with pytest.raises(UsageError):
        Address("ftp://host/a")
