"""`alula view`: what it writes, what it serves and to whom, and what it refuses."""

import http.client
import json
import re
import threading

import pytest
from PIL import Image

from alula.cli.main import run
from alula.schemas.artifacts.provenance import read_provenance
from alula.schemas.errors import UsageError
from alula.stages.show.viewing.serve import PageServer


def facts(text):
    return json.loads(re.search(r'id="alula-data">(.*?)</script>', text, re.DOTALL)[1])


def test_a_page_of_everything_names_its_inputs(pipeline, tmp_path, capsys):
    kinds = ("metric.scene.npz", "cover.npz", "plan.npz", "seen.npz", "run.mcap")
    files = [str(pipeline / f"tiny.{kind}") for kind in kinds]
    out = tmp_path / "page.html"
    assert run(["view", *files, "-o", str(out), "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)["summary"]
    assert summary["flights_played"] == 1
    assert summary["gaussians"] > 0
    made = read_provenance(out)
    assert made.schema == "alula/view"
    assert [ref.name for ref in made.inputs] == [f"tiny.{kind}" for kind in kinds]
    page = facts(out.read_text())
    assert page["title"] == "tiny.metric, tiny"
    (flight,) = page["flights"]
    assert {plot["name"] for plot in flight["plots"]} >= {"speed [m/s]", "clearance [m]"}


def test_a_splat_file_is_opened_directly(pipeline, tmp_path, capsys):
    out = tmp_path / "page.html"
    words = ["view", str(pipeline / "tiny.ply"), "--up", "-y", "--gaussians", "50", "-o", str(out), "--json"]
    assert run(words) == 0
    summary = json.loads(capsys.readouterr().out)["summary"]
    assert 45 <= summary["gaussians"] <= 50
    assert "by contribution" in summary["notes"][0]


PICTURES = {
    "shot.png": ["--size", "64x48"],
    "film.webp": ["--size", "64x48", "--seconds", "1", "--frames-per-second", "3"],
    "film.gif": ["--size", "64x48", "--seconds", "1", "--frames-per-second", "3", "--camera", "orbit"],
}


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_is_of_its_inputs_and_the_same_each_time(name, pipeline, tmp_path, capsys):
    files = [str(pipeline / f"tiny.{kind}") for kind in ("metric.scene.npz", "plan.npz", "run.mcap")]
    out, words = tmp_path / name, PICTURES[name]
    assert run(["view", *files, "-o", str(out), *words, "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)["summary"]
    with Image.open(out) as image:
        assert image.size == (summary["columns"], summary["rows"]) == (64, 48)
        assert getattr(image, "n_frames", 1) == summary.get("frames", 1)
    made = read_provenance(out)
    assert made.schema == "alula/view"
    assert [ref.name for ref in made.inputs] == ["tiny.metric.scene.npz", "tiny.plan.npz", "tiny.run.mcap"]
    assert run(["view", *files, "-o", str(out), *words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["status"] == "unchanged"
    again = tmp_path / f"again-{name}"
    assert run(["view", *files, "-o", str(again), *words, "--jobs", "1", "-q"]) == 0
    assert again.read_bytes() == out.read_bytes()
    assert run(["info", str(out)]) == 0
    assert "a page, a picture or a moving picture" in " ".join(capsys.readouterr().out.split())
    assert run(["view", *files, "-o", str(out), *words, "--size", "32x32"]) == 2
    assert 'size was "64x48", now "32x32"' in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "words", "message"),
    [
        ("page.html", ["--size", "64x48"], "--size needs an output that ends in .png, .webp, .gif"),
        ("shot.png", ["--seconds", "3"], "--seconds needs an output that ends in .webp, .gif"),
        ("shot.png", ["--size", "big"], "--size must be like 640x400, not big"),
        ("shot.jpeg", [], "the output must end in .html, .png, .webp or .gif"),
    ],
)
def test_options_of_other_outputs_are_refused(name, words, message, pipeline, tmp_path, capsys):
    out = tmp_path / name
    assert run(["view", str(pipeline / "tiny.cover.npz"), "-o", str(out), *words]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not out.exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["tiny.run.mcap", "--flight", "7"], "--flight 7: no log has the samples of that flight"),
        (["tiny.cover.npz", "tiny.cover.npz"], "tiny.cover.npz: is named twice"),
        (["tiny.cover.npz", "--gaussians=-1"], "--gaussians must be at least 0"),
        (["tiny.toml"], "tiny.toml: is not an artifact, a run, or a splat of a known format"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_one_line(words, message, pipeline, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(pipeline)
    out = tmp_path / "page.html"
    assert run(["view", *words, "-o", str(out)]) in (2, 3)
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not out.exists()


def ask(server, path, host=None):
    port = int(server.url.rsplit(":", 1)[1].rstrip("/"))
    link = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    link.request("GET", path, headers={} if host is None else {"Host": host})
    answer = link.getresponse()
    found = answer.status, answer.read().decode()
    link.close()
    return found


def test_the_page_is_served_to_this_machine_with_any_flight():
    with PageServer(lambda flight: None if flight == 9 else f"page {flight}", 0) as server:
        threading.Thread(target=server.run, daemon=True).start()
        assert ask(server, "/") == (200, "page None")
        assert ask(server, "/?flight=3") == (200, "page 3")
        assert ask(server, "/?flight=9")[0] == 404
        assert ask(server, "/?flight=-1")[0] == 404
        assert ask(server, "/../etc/passwd")[0] == 404
        assert ask(server, "/", "evil.example:80")[0] == 403
        with pytest.raises(UsageError, match="in use"):
            PageServer(lambda flight: "", int(server.url.rsplit(":", 1)[1].rstrip("/")))
        server.stop()
