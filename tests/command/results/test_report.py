"""The page of a report: self-contained, escaped, deterministic, and skipped when unchanged."""

import csv
import json
import re
import time
from html.parser import HTMLParser
from pathlib import Path

import msgspec
import numpy as np
import pytest

from alula.cli.main import run
from alula.cli.shell.runner import input_ref
from alula.schemas.artifacts.artifact import write_artifact
from alula.schemas.artifacts.provenance import Provenance, read_provenance
from alula.schemas.artifacts.report import Report
from alula.stages.reporting.table import Table, folded, text
from support.scenes.fabricate import (
    box,
    make_cover,
    make_plan,
    make_record,
    make_scene,
    make_trial,
    write_run,
)

EVIL = 'x"><script>alert(1)</script><img src=http://evil.example/a.png>'


class Links(HTMLParser):
    """All resources that a page and its frames would load, and all texts."""

    def __init__(self):
        super().__init__()
        self.found, self.tags, self.texts, self.labels = [], [], [], []
        self.values: list[tuple[str, dict[str, str]]] = []  # tag and attributes of what has a value

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        known = dict(attrs)
        if tag == "data" or "data-value" in known:
            self.values.append((tag, known))
        if known.get("role") == "img":
            self.labels.append(known.get("aria-label"))
        for name, value in attrs:
            if name in ("src", "href", "xlink:href", "data", "action", "poster", "srcset"):
                self.found.append(value)
            if name != "srcdoc" and "url(" in (value or ""):
                self.found += re.findall(r"url\(([^)]*)\)", value)
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
    names = (("c.json", "m.cover.npz"), ("other.json", "m.plan.npz"), ("plan.json", "m.cover.npz"))
    for name, of in names:
        made = Provenance.now("alula/certificate", "1.0", {}, None, [input_ref("cover", folder / of)])
        record = {"covered": True, "checks": [], "left_out": "dust", "provenance": msgspec.to_builtins(made)}
        record |= {"schema": "alula/certificate", "version": "1.0"}
        record |= {"given": ["plan", "cover"]} if name == "plan.json" else {}
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
    *("--plan", "m.plan.npz", "--certificate", "c.json"),
)


@pytest.fixture(scope="module")
def everything(folder, tmp_path_factory) -> Path:
    """The page of all inputs."""
    return made_from(folder, EVERYTHING, tmp_path_factory.mktemp("everything") / "1.html")


def test_a_page_loads_nothing_from_anywhere(everything):
    page = everything.read_text()
    links = Links()
    links.feed(page)
    assert links.tags.count("svg") == 7
    assert links.tags.count("iframe") == 1
    assert links.tags.count("script") == 1  # which moves the marker in the curves
    assert all(link.startswith(("data:", "#")) for link in links.found), links.found[:3]
    assert "default-src 'none'" in page
    assert len(page) < 12e6


def read(page: Path) -> Links:
    links = Links()
    links.feed(page.read_text())
    return links


def test_every_image_says_what_it_shows(everything):
    links = read(everything)
    assert len(links.labels) == links.tags.count("svg")
    assert all(links.labels)
    assert any("3 reached" in alt or "1 collision" in alt for alt in links.labels)


def test_drawings_on_one_page_share_no_ids(everything):
    page = everything.read_text()
    ids = re.findall(r'<[a-zA-Z]+ id="([^"]*)"', page[page.index("<main>") :])
    assert len(ids) == len(set(ids))


def test_a_page_says_the_verdict_first_and_folds_its_tables(everything):
    page = re.sub(r'srcdoc="[^"]*"', "", everything.read_text())
    marks = (
        'class="verdict',
        "<svg",
        "Look around",
        "Guarantees and their limits",
        "<h2>Figures",
        "<h2>Tables",
        "Written by",
    )
    places = [page.index(mark) for mark in marks]
    assert places == sorted(places)
    assert "1 of 5 flights touched an obstacle." in page
    tables = page[page.index("<h2>Tables") :]
    assert tables.count("<details") == tables.count("<table") + 1  # and the makers
    assert "<details open" not in tables


def test_numbers_of_the_page_are_those_of_the_json(report, everything):
    """Each rounded number of the page has its value beside it; the JSON has the same ones and no others."""
    path = report(*EVERYTHING, out="1.json")
    record = msgspec.json.decode(path.read_bytes(), type=Report)
    links = read(everything)
    shown = {
        (known["data-of"], known["data-key"]): json.loads(known["value"])
        for tag, known in links.values
        if tag == "data"
    }
    assert shown == {
        (subject.title, number.key): number.value for subject in record.subjects for number in subject.numbers
    }
    cells = [json.loads(known["data-value"]) for tag, known in links.values if tag != "data"]
    read_as = [folded(Table(t.name, t.title, tuple(t.columns), t.rows, t.note)) for t in record.differences]
    in_json = [
        value
        for table in (*read_as, *record.tables)
        for row in table.rows
        for value in row
        if isinstance(value, int | float) and not isinstance(value, bool)
    ]
    assert cells == in_json
    assert [figure.description for figure in record.figures] == links.labels
    assert record.verdict in links.texts
    for words in (*record.guaranteed, *record.not_guaranteed):
        assert words in links.texts


def test_the_numbers_are_those_of_the_record(report, folder):
    path = report("a.run.mcap", "--cover", "m.cover.npz")
    links = Links()
    links.feed(path.read_text())
    from alula.schemas.log.run import read_run

    record = read_run(folder / "a.run.mcap")
    for key in ("success_rate", "min_map_clearance_m", "mean_path_ratio", "collisions"):
        assert text(record.summary[key]) in links.texts, key
    assert {"2 of 3", "5.0 cm deep"} <= set(links.texts)
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
    assert links.tags.count("script") == 1  # of the page itself
    assert "b" in links.tags  # ours, in cards
    assert f"filter {EVIL}" in "".join(links.texts)
    assert EVIL in links.texts
    assert "evil.example" not in "".join(links.found)
    assert "<script" not in (tmp_path / "r.md").read_text()
    found = read_provenance(tmp_path / "r.html")
    assert found.inputs[0].name == evil.name


@pytest.mark.slow
def test_equal_inputs_give_equal_bytes(report, everything, monkeypatch):
    first = everything
    monkeypatch.setattr("alula.cli.verbs.report._LARGE_BYTES", 0)  # figures come from another process
    second = report(*EVERYTHING, out="2.html")
    for suffix in (".md", ".csv"):
        mine, other = (path.with_suffix(suffix).read_text() for path in (first, second))
        assert mine.replace("1.csv", "2.csv").replace("1.md", "2.md") == other
    swap = lambda path: path.read_text().replace('"2.csv"', '"1.csv"').replace('"2.md"', '"1.md"')  # noqa: E731
    assert swap(first) == swap(second)


def test_an_unchanged_report_is_left_alone(report, capsys):
    path = report("--cover", "m.cover.npz")
    made = path.stat().st_ino
    capsys.readouterr()
    report("--cover", "m.cover.npz")
    assert "unchanged" in capsys.readouterr().out
    assert path.stat().st_ino == made
    report("--cover", "m.cover.npz", "--title", "other", code=2)
    report("--cover", "m.cover.npz", "--title", "other", "-f")
    assert "<h1>other</h1>" in path.read_text()


def test_missing_tables_beside_an_unchanged_page_are_written_again(report):
    path = report("--cover", "m.cover.npz")
    before = path.with_suffix(".md").read_bytes()
    path.with_suffix(".md").unlink()
    path.with_suffix(".csv").unlink()
    report("--cover", "m.cover.npz")
    assert path.with_suffix(".md").read_bytes() == before
    assert path.with_suffix(".csv").exists()


@pytest.mark.every(2)
@pytest.mark.parametrize("suffix", [".md", ".csv"])
def test_foreign_files_beside_the_page_are_kept(report, tmp_path, suffix, capsys):
    diary = tmp_path / f"r{suffix}"
    diary.write_text("a diary")
    report("--cover", "m.cover.npz", code=2)
    assert diary.name in capsys.readouterr().err
    assert diary.read_text() == "a diary"
    assert not (tmp_path / "r.html").exists()
    report("--cover", "m.cover.npz", "-f")
    assert diary.read_text() != "a diary"


def test_a_report_without_runs_shows_the_map(report):
    page = report("--cover", "m.cover.npz").read_text()
    assert "half-planes" in page


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ([], 2, "needs a run"),
        (["a.run.mcap", "--table", "nothing"], 2, "this report has"),
        (["m.cover.npz"], 3, "not an MCAP log"),
        (["a.run.mcap", "--cover", "m.scene.npz"], 3, "alula/cover is needed"),
        (["a.run.mcap", "--certificate", "a.run.mcap"], 3, "not a certificate"),
        (["a.run.mcap", "--cover", "m.cover.npz", "--certificate", "other.json"], 3, "of another cover"),
        (["a.run.mcap", "--cover", "m.cover.npz", "--certificate", "plan.json"], 3, "of kind alula/plan"),
        (["a.run.mcap", "--title", " "], 2, "must not be empty"),
    ],
)
def test_wrong_words_are_refused_in_one_line(report, tmp_path, capsys, words, code, message):
    report(*words, code=code)
    error = capsys.readouterr().err
    assert message in error
    assert len(error.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_the_suffix_names_the_format(report, capsys):
    report("a.run.mcap", out="r.docx", code=2)
    assert "must end in .html, .md, .csv, .json, .tex, .pdf or .png" in capsys.readouterr().err
    page = report("a.run.mcap", "--format", "md", out="r.txt").read_text()
    assert "**1 of 3 flights touched an obstacle.**" in page


@pytest.mark.every(4)
@pytest.mark.parametrize("suffix", ["md", "json", "tex", "pdf", "png"])
def test_every_format_knows_what_it_was_made_from(report, tmp_path, suffix, capsys):
    """It is left alone when nothing changed, and a file that somebody else wrote is kept."""
    words = ("--cover", "m.cover.npz", "--title", "Ümlaut (a\\b) $x$")
    path = report(*words, out=f"r.{suffix}")
    found = read_provenance(path)
    assert (found.schema, found.parameters["format"]) == ("alula/report", suffix)
    assert found.parameters["title"] == words[-1]
    raw = path.read_bytes()
    starts = {"pdf": b"%PDF-", "png": b"\x89PNG", "json": b"{", "tex": b"% alula-provenance", "md": b"<!--"}
    assert raw.startswith(starts[suffix])
    names = sorted(file.name for file in tmp_path.iterdir())
    if suffix == "tex":
        figures = [name for name in names if name.endswith(".pdf")]
        assert sorted(re.findall(rb"includegraphics\[width=[^]]*\]{([^}]*)}", raw)) == [
            name.encode() for name in figures
        ]
        assert figures
        assert all(read_provenance(tmp_path / name) is not None for name in figures)
        assert all(b"/Type0" in (tmp_path / name).read_bytes() for name in figures)  # TrueType fonts
        (tmp_path / figures[0]).unlink()
    else:
        assert names == [path.name]
    capsys.readouterr()
    report(*words, out=f"r.{suffix}")
    assert "unchanged" in capsys.readouterr().out
    assert sorted(file.name for file in tmp_path.iterdir()) == names
    report(*words, "-f", out=f"r.{suffix}")
    assert path.read_bytes() == raw
    path.write_text("a diary")
    report(*words, out=f"r.{suffix}", code=2)
    assert path.read_text() == "a diary"


@pytest.mark.slow
def test_a_document_of_latex_escapes_what_latex_would_read(report, folder, tmp_path):
    log = tmp_path / "50% of_x & y$.run.mcap"
    log.write_bytes((folder / "b.run.mcap").read_bytes())
    words = (str(log), "a.run.mcap", "--title", r"100 % [\input{x}] of {a_b} ~#1 λ 漢")
    raw = report(*words, out="two of #2.tex").read_text()
    body = raw[raw.index(r"\begin{document}") :]
    assert r"100 \% {[}\textbackslash{}input\{x\}{]} of \{a\_b\} \textasciitilde{}\#1 $\lambda$ ?" in body
    assert r"\input" not in body.replace(r"\textbackslash{}input", "")
    assert r"50\% of\_x \& y\$" in body
    bare = re.sub(r"\\[\\{}%$#&_]", "", body)
    assert bare.count("{") == bare.count("}")
    assert bare.count("$") % 2 == 0
    for begun in re.findall(r"\\begin{(\w+)}", body):
        assert body.count(rf"\begin{{{begun}}}") == body.count(rf"\end{{{begun}}}")
    shown = re.findall(r"includegraphics\[[^]]*\]{([^}]*)}", body)
    assert shown
    assert all((tmp_path / name).exists() and re.fullmatch(r"[\w.+-]+", name) for name in shown)


def test_a_table_of_trials_is_replaced_and_a_diary_is_not(report, tmp_path):
    path = report("a.run.mcap", out="r.csv")
    assert len(path.read_text().splitlines()) == 4
    report("b.run.mcap", out="r.csv")
    assert len(path.read_text().splitlines()) == 3
    path.write_text("a diary")
    report("a.run.mcap", out="r.csv", code=2)
    assert path.read_text() == "a diary"


def test_a_figure_that_is_somebody_elses_is_kept(report, tmp_path, capsys):
    diary = tmp_path / "r-still.pdf"
    diary.write_text("a diary")
    report("--cover", "m.cover.npz", out="r.tex", code=2)
    assert diary.name in capsys.readouterr().err
    assert diary.read_text() == "a diary"
    assert not (tmp_path / "r.tex").exists()


@pytest.mark.slow
def test_two_runs_of_3000_trials_are_reported_in_ten_seconds_of_processor_time(tmp_path):
    rng = np.random.default_rng(1)
    for name in ("a", "b"):
        trials = [make_trial(i, clearance=float(c)) for i, c in enumerate(rng.uniform(-0.05, 0.5, 3000))]
        write_run(tmp_path / f"{name}.run.mcap", make_record(trials), steps=10)
    begin = time.process_time()
    words = [str(tmp_path / "a.run.mcap"), str(tmp_path / "b.run.mcap"), "-o", str(tmp_path / "r.html"), "-q"]
    assert run(["report", *words]) == 0
    assert time.process_time() - begin < 10
    assert (tmp_path / "r.html").stat().st_size < 8e6


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
