"""The page of a report: self-contained, escaped, deterministic, and skipped when unchanged."""

import csv
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import msgspec
import pytest

from alula.cli.main import run
from alula.cli.runner import input_ref
from alula.schemas.artifact import write_artifact
from alula.schemas.provenance import Provenance, read_provenance
from alula.stages.reporting.table import text
from support.fabricate import box, make_cover, make_plan, make_record, make_scene, make_trial, write_run

EVIL = 'x"><script>alert(1)</script><img src=http://evil.example/a.png>'


class Links(HTMLParser):
    """All resources that a page and its frames would load, and all texts."""

    def __init__(self):
        super().__init__()
        self.found, self.tags, self.texts = [], [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        for name, value in attrs:
            if name in ("src", "href", "data", "action", "poster", "srcset") or "url(" in (value or "")[:200]:
                self.found.append(value)
            if name == "srcdoc":
                inner = Links()
                inner.feed(value)
                self.found += inner.found

    def handle_data(self, data):
        self.texts.append(data.strip())


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    cover = make_cover(
        [box((0, 0, 0), (20, 20, 30)), box((40, 10, 0), (50, 30, 60))], summary={"voxels": 900}
    )
    write_artifact(folder / "m.cover.npz", cover)
    write_artifact(folder / "m.scene.npz", make_scene(300))
    write_artifact(folder / "m.plan.npz", make_plan())
    trials = [make_trial(i, clearance=0.1 * i - 0.05) for i in range(3)]
    write_run(folder / "a.run.mcap", make_record(trials), timing={"filter_p50_s": 0.00021}, hulls=2)
    write_run(folder / "b.run.mcap", make_record(trials[1:], filter_name=EVIL, name=EVIL), hulls=2)
    for name, of in (("c.json", "m.cover.npz"), ("other.json", "m.plan.npz")):
        made = Provenance.now("alula/certificate", "1.0", {}, None, [input_ref("cover", folder / of)])
        record = {"covered": True, "checks": [], "left_out": "dust", "provenance": msgspec.to_builtins(made)}
        record |= {"schema": "alula/certificate", "version": "1.0"}
        (folder / name).write_text(json.dumps(record))
    return folder


def made_from(folder, words, out, code=0):
    known = {p.name: str(p) for p in folder.iterdir()}
    assert run(["report", *(known.get(word, word) for word in words), "-o", str(out)]) == code
    return out


@pytest.fixture
def report(folder, tmp_path):
    return lambda *words, code=0, out="r.html": made_from(folder, words, tmp_path / out, code)


EVERYTHING = (
    *("a.run.mcap", "b.run.mcap", "--cover", "m.cover.npz", "--scene", "m.scene.npz"),
    *("--plan", "m.plan.npz", "--certificate", "c.json", "--paper", "polymerge"),
)


@pytest.fixture(scope="module")
def everything(folder, tmp_path_factory) -> Path:
    """The page of all inputs."""
    return made_from(folder, EVERYTHING, tmp_path_factory.mktemp("everything") / "1.html")


def test_a_page_loads_nothing_from_anywhere(everything):
    page = everything.read_text()
    links = Links()
    links.feed(page)
    assert links.tags.count("img") == 5
    assert links.tags.count("iframe") == 1
    assert links.tags.count("script") == 0
    assert all(link.startswith("data:") for link in links.found), links.found[:3]
    assert "default-src 'none'" in page
    assert len(page) < 12e6


def test_every_image_says_what_it_shows(everything):
    page = everything.read_text()
    words = re.findall(r'<img src="data:image/svg\+xml;base64,[^"]*" alt="([^"]+)"', page)
    assert len(words) == page.count("<img ")
    assert any("3 reached" in alt or "1 collision" in alt for alt in words)


def test_the_numbers_are_those_of_the_record(report, folder):
    path = report("a.run.mcap", "--cover", "m.cover.npz")
    links = Links()
    links.feed(path.read_text())
    from alula.schemas.run import read_run

    record = read_run(folder / "a.run.mcap")
    for key in ("success_rate", "min_map_clearance_m", "mean_path_ratio", "collisions"):
        assert text(record.summary[key]) in links.texts, key
    assert text(0.00021) in links.texts
    assert "1.375" in links.texts
    shown = path.with_suffix(".md").read_text()
    assert f"| success rate | {text(record.summary['success_rate'])} |" in shown
    with path.with_suffix(".csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["map_clearance_m"]) for row in rows] == [t.map_clearance_m for t in record.trials]


def test_names_cannot_inject_anything(report, folder, tmp_path):
    evil = tmp_path / "a--><b>&quot;.run.mcap"
    evil.write_bytes((folder / "b.run.mcap").read_bytes())
    page = report(str(evil), "--title", EVIL).read_text()
    links = Links()
    links.feed(page)
    assert "script" not in links.tags
    assert "b" in links.tags  # ours, in cards
    assert f"filter {EVIL}" in "".join(links.texts)
    assert EVIL in links.texts
    assert "evil.example" not in "".join(links.found)
    assert "<script" not in (tmp_path / "r.md").read_text()
    found = read_provenance(tmp_path / "r.html")
    assert found.inputs[0].name == evil.name


def test_equal_inputs_give_equal_bytes(report, everything):
    first = everything
    second = report(*EVERYTHING, out="2.html")
    for suffix in (".md", ".csv"):
        mine, other = (path.with_suffix(suffix).read_text() for path in (first, second))
        assert mine.replace("1.csv", "2.csv").replace("1.md", "2.md") == other
    swap = lambda path: path.read_text().replace('"2.csv"', '"1.csv"').replace('"2.md"', '"1.md"')  # noqa: E731
    assert swap(first) == swap(second)


def test_an_unchanged_report_is_left_alone(report, capsys):
    path = report("a.run.mcap")
    made = path.stat().st_ino
    capsys.readouterr()
    report("a.run.mcap")
    assert "unchanged" in capsys.readouterr().out
    assert path.stat().st_ino == made
    report("a.run.mcap", "--title", "other", code=2)
    report("a.run.mcap", "--title", "other", "-f")
    assert "<h1>other</h1>" in path.read_text()


def test_missing_tables_beside_an_unchanged_page_are_written_again(report):
    path = report("a.run.mcap")
    before = path.with_suffix(".md").read_bytes()
    path.with_suffix(".md").unlink()
    path.with_suffix(".csv").unlink()
    report("a.run.mcap")
    assert path.with_suffix(".md").read_bytes() == before
    assert path.with_suffix(".csv").exists()


@pytest.mark.every(2)
@pytest.mark.parametrize("suffix", [".md", ".csv"])
def test_foreign_files_beside_the_page_are_kept(report, tmp_path, suffix, capsys):
    diary = tmp_path / f"r{suffix}"
    diary.write_text("a diary")
    report("a.run.mcap", code=2)
    assert diary.name in capsys.readouterr().err
    assert diary.read_text() == "a diary"
    assert not (tmp_path / "r.html").exists()
    report("a.run.mcap", "-f")
    assert diary.read_text() != "a diary"


def test_a_report_without_runs_shows_the_map(report):
    page = report("--cover", "m.cover.npz", "--paper", "polymerge").read_text()
    assert "PolyMerge, Table I" in page
    assert "half-planes" in page


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ([], 2, "needs a run"),
        (["a.run.mcap", "--table", "nothing"], 2, "this report has"),
        (["a.run.mcap", "--paper", "bible"], 2, "polymerge"),
        (["m.cover.npz"], 3, "not an MCAP log"),
        (["a.run.mcap", "--cover", "m.scene.npz"], 3, "alula/cover is needed"),
        (["a.run.mcap", "--certificate", "a.run.mcap"], 3, "not a certificate"),
        (["a.run.mcap", "--cover", "m.cover.npz", "--certificate", "other.json"], 3, "of another cover"),
        (["a.run.mcap", "--title", " "], 2, "must not be empty"),
    ],
)
def test_wrong_words_are_refused_in_one_line(report, tmp_path, capsys, words, code, message):
    report(*words, code=code)
    error = capsys.readouterr().err
    assert message in error
    assert len(error.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_the_page_must_be_html(report, capsys):
    report("a.run.mcap", out="r.pdf", code=2)
    assert ".html" in capsys.readouterr().err


def test_a_message_that_is_not_as_documented_is_damage(tmp_path, capsys):
    log = tmp_path / "bad.run.mcap"
    write_run(log, make_record([make_trial(0)]))
    raw = log.read_bytes()
    from mcap.writer import Writer

    with log.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/state", "json", writer.register_schema("x", "jsonschema", b"{}"))
        writer.add_message(channel, 0, b'{"trial": 0, "time_s": "noon"}', 0)
        from mcap.reader import make_reader

        (tmp_path / "copy").write_bytes(raw)
        with (tmp_path / "copy").open("rb") as old:
            for record in make_reader(old).iter_metadata():
                writer.add_metadata(record.name, record.metadata)
        writer.finish()
    assert run(["report", str(log), "-o", str(tmp_path / "r.html")]) == 3
    assert "Expected `float`, got `str`" in capsys.readouterr().err


@pytest.mark.parametrize("far", [1e308, -1e200, 1e13])
def test_a_log_of_what_nobody_measured_is_refused_in_one_line(tmp_path, capsys, far):
    log = tmp_path / "far.run.mcap"
    write_run(log, make_record([msgspec.structs.replace(make_trial(0), goal_m=(far, 0.0, 0.0))]))
    assert run(["report", str(log), "-o", str(tmp_path / "r.html")]) == 3
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{log}: " in line
    assert (
        f"a position of {abs(far):.3g} is too large to be measured" in line or "`$.trials[0].goal_m" in line
    )
    assert not (tmp_path / "r.html").exists()
