"""The page of all papers, as data: its numbers are those of the records, and no claim is left out."""

import json
import re
from html.parser import HTMLParser

import msgspec
import pytest

from alula.schemas.errors import InputError
from alula.stages.reporting.figures import Figure
from alula.stages.reporting.palette import variables
from alula.stages.reporting.table import markdown_cell
from papers.claims import Claim, Paper, Row, judged, shown
from papers.collected import Papers, collect
from papers.compared import VERDICTS, Measured, read_comparison, write_comparison_record
from papers.markdown import papers_markdown
from papers.page import papers_page, sentence
from papers.papers import FASTBRIDGE, PAPERS
from papers.record import Made, command_of, comparison_record
from support.flights.papers import PRODUCER, SVG, jerk_rows, record, value
from support.paths import ROOT


class Values(HTMLParser):
    """Rows of the tables by claim: texts of the cells, and the exact values in each."""

    def __init__(self, text):
        super().__init__()
        self.rows, self.verdicts, self.counts = {}, {}, {}
        self.claim, self.cells, self.open, self.inside = None, None, False, []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        known = dict(attrs)
        if tag == "tbody":
            self.claim, self.rows[known["id"]] = known["id"], []
            self.verdicts[known["id"]] = known["data-verdict"]
        elif tag == "tr" and known.get("class") == "value":
            self.cells = []
            self.rows[self.claim].append(self.cells)
        elif tag == "tr":
            self.cells = None
        elif tag == "td" and self.cells is not None:
            self.cells.append(["", []])
            self.open = True
        elif tag == "b" and "data-of" in known:
            self.counts[known["data-of"], known["data-key"]] = int(known["data-value"])
        elif "data-value" in known and self.cells:
            self.cells[-1][1].append(float(known["data-value"]))

    def handle_endtag(self, tag):
        if tag == "td":
            self.open = False

    def handle_data(self, data):
        if self.open and self.cells:
            self.cells[-1][0] += data


def page_of(*records, drawings=None):
    papers = collect(records, PRODUCER)
    return papers, papers_page(papers, drawings or {})


def test_every_number_on_the_page_is_that_of_the_record():
    papers, html = page_of(record(jerk_rows()))
    again = msgspec.json.decode(write_comparison_record(papers), type=Papers)
    assert again == papers
    seen = Values(html)
    for paper in again.papers:
        for name, count in paper.counts.items():
            assert seen.counts.get((paper.name, name.replace(" ", "-")), 0) == count
        for claim in paper.claims:
            known = seen.rows[f"{paper.name}-{claim.claim.name}"]
            assert len(known) == len(claim.rows)
            assert seen.verdicts[f"{paper.name}-{claim.claim.name}"] == claim.verdict.replace(" ", "-")
            for cells, found in zip(known, claim.rows, strict=True):
                row, texts = claim.texts(found), [text for text, _ in cells]
                assert texts[:4] == [row.quantity, row.published, row.ours, row.interval]
                assert all(words in texts[4] for words in (row.verdict, row.why, found.command))
                for place, name in ((2, "ours"), (3, "interval")):
                    assert cells[place][1] == [n.value for n in row.numbers if n.cell == name]
    jerk = next(claim for claim in again.papers[1].claims if claim.claim.name == "mean-jerk")
    rows = [jerk.texts(found) for found in jerk.rows]
    assert [[n.value for n in row.numbers] for row in rows] == [[3.4567891, 3.1, 3.87654], [0.2]]
    assert [(row.ours[n.at :][: len(n.shown)], n.shown) for row in rows for n in row.numbers[:1]] == [
        ("3.46", "3.46"),
        ("0.20", "0.20"),
    ]
    assert 'data-flights="500"' in html
    assert "no flights" in html


def test_a_claim_counts_once_and_as_its_least_favourable_measurement():
    papers, html = page_of(record(jerk_rows()))
    ours = papers.papers[1]
    assert [c.verdict for c in ours.claims if c.claim.name in ("mean-jerk", "proposition-1")] == [
        "reproduced",
        "refuted",
    ]
    assert sum(ours.counts.values()) == len(ours.claims)
    assert papers.counts["refuted"] == 1
    assert sentence(papers.counts) in html
    assert judged(["not comparable", "better"]) == "better"
    assert judged(["not available here", "not comparable"]) == "not comparable"


def test_what_no_record_judges_says_so_with_the_command_that_would():
    papers, html = page_of()
    assert (
        sum(papers.counts.values())
        == papers.counts["not available here"]
        == sum(len(paper.claims) for paper in PAPERS)
    )
    speed = next(claim for claim in papers.papers[3].claims if claim.claim.name == "speed")
    assert speed.rows[0].command == "make -C examples/geofencing page"
    assert "not in these records" in html


def test_later_records_fill_what_the_first_leaves_open():
    one, other = "table-1/mpc/s/1", "table-1/mpc/s/2"
    first = record([value("saved-mpc"), value(one)], paper="dr-acbf")
    names = ("saved-mpc", "saved-qp", one, other)
    second = record([value(name, setting="quick") for name in names], paper="dr-acbf", setting="quick")
    papers, html = page_of(first, second)
    rows = {c.claim.name: [(r.row, r.setting) for r in c.rows] for c in papers.papers[2].claims}
    assert rows["saved-mpc"] == [("saved-mpc", "full")]
    assert rows["saved-qp"] == [("saved-qp", "quick")]
    assert rows["table-1/mpc/s"] == [(one, "full"), (other, "quick")]  # a table, cell by cell
    assert "6 flights (quick setting)" in html
    with pytest.raises(InputError, match="'polly' is no known paper"):
        collect([record([], paper="polly")], PRODUCER)
    with pytest.raises(InputError, match="'gone' is the row of no claim"):
        collect([record([value("gone")])], PRODUCER)


def test_our_figures_stand_beside_theirs_in_words_and_in_the_colours_of_the_page():
    names = ("figure-2-room", "figure-3-room", "figure-3-paths-room")
    drawings = {("fastbridge", name): SVG for name in names}
    papers, html = page_of(record([], figures=names, setting="quick"), drawings=drawings)
    figures = {c.claim.name: [f.name for f in c.figures] for c in papers.papers[1].claims if c.figures}
    assert figures == {
        "figure-2-left": ["figure-2-room"],
        "figure-3-paths": ["figure-3-paths-room"],
        "mean-jerk": ["figure-3-room"],
    }
    right = next(c for c in papers.papers[1].claims if c.claim.name == "figure-2-right")
    assert right.see == "figure-2-left"  # one figure has both
    assert '<a href="#fastbridge-figure-2-left-drawn">the figure above</a>' in html
    assert html.count("stroke: var(--c0072b2)") == 3
    assert "Our figure-2-room (quick setting)" in html
    assert 'id="fastbridge-figure-2-room-line"' in html
    assert "Peak error of the acceleration over the speed" in html
    for paper in papers.papers:
        for claim in paper.claims:
            assert claim.claim.kind != "figure" or claim.claim.shows


def test_the_page_asks_for_nothing_and_escapes_what_it_shows():
    _, html = page_of(record(jerk_rows()))
    assert "<script" not in html
    assert re.findall(r'(?:src|href)="(?!#)([^"]*)"', html) == [
        "data:,",
        *(f"../../../docs/results/{paper.page}" for paper in PAPERS),
    ]
    assert "&lt;why&gt;" in html
    assert "b &amp; c" in html
    for name in VERDICTS:
        assert f'id="only-{name.replace(" ", "-")}"' in html


def test_the_markdown_page_has_the_same_rows():
    papers, _ = page_of(record(jerk_rows()))
    lines = papers_markdown(papers, "A head.").split("\n")
    assert lines[2] == "A head."
    assert f"**{sentence(papers.counts)}**" in lines
    cells = [re.split(r"(?<!\\) \| ", line[2:-2]) for line in lines if line.startswith("| ")]
    rows = [row for row in cells if len(row) == 10 and row[0] not in ("where", "---")]
    assert len(rows) == sum(len(claim.rows) for paper in papers.papers for claim in paper.claims)
    jerk = next(row for row in rows if row[2] == "mean jerk, ratio")
    assert jerk[3:7] == ["× 0.53", "× 3.46", "3.1 to 3.88", "refuted"]
    assert jerk[8] == "500"
    assert jerk[9].startswith("`make -C examples/fastbridge x")


def test_a_row_names_the_command_of_its_runs_of_its_test_or_of_the_whole_comparison(tmp_path):
    made = Made("make -C examples/fastbridge QUICK=1", "out/quick", "fastbridge.html", "quick", "here")
    runs = ["room/a@1.run.mcap", "room/b@1.run.mcap", "times.json"]
    rows = [
        Measured(row="mean-jerk", verdict="refuted", values={"value": 2.0}, runs=runs, flights=4),
        Measured(row="proposition-1", verdict="reproduced"),
        Measured(row="proposition-3", verdict="reproduced"),
    ]
    figure = Figure("figure-2-room", "t", "words", SVG)
    made_of = comparison_record(FASTBRIDGE, rows, [figure], made, PRODUCER)
    assert [row.command for row in made_of.rows] == [
        "make -C examples/fastbridge QUICK=1 out/quick/room/{a@1,b@1}.run.mcap out/quick/times.json",
        ".venv/bin/pytest tests/unit/filtering/test_equations_fastbridge.py -k realisation_gap",
        "make -C examples/fastbridge QUICK=1 out/quick/fastbridge.html",
    ]
    assert [row.setting for row in made_of.rows] == ["quick", "full", "quick"]  # a test is the same in both
    one = Measured(row="mean-jerk", verdict="refuted", runs=runs[:1])
    assert command_of(one, FASTBRIDGE.row("mean-jerk")[0], made).endswith("room/a@1.run.mcap")
    path = tmp_path / "r.json"
    path.write_text(write_comparison_record(made_of))
    assert read_comparison(path) == made_of
    path.write_text(json.dumps({**json.loads(path.read_text()), "version": "1.0"}))
    with pytest.raises(InputError, match="no papers/comparison of version 2"):
        read_comparison(path)
    with pytest.raises(InputError, match="'x' is the row of no claim"):
        comparison_record(FASTBRIDGE, [Measured(row="x", verdict="better")], [], made, PRODUCER)


def test_a_text_takes_what_was_measured_and_keeps_the_digits_that_it_rounds():
    row = Row(
        item="i",
        quantity="of {count!s:,}",
        ours=["{a:.1f} and {b}", " beside {others:{} ({})}", " of {gone}"],
        interval="{low} to {high} %",
        why={"refuted": "{a!t} or {word!s}"},
    )
    values = {"count": 12345, "a": 0.123456, "b": 20000.4, "others": [[1.5, "x"], [2.0, "y"]], "word": "so"}
    found = Measured(row="r", verdict="refuted", values=values)
    said = shown(row, found)
    assert (said.quantity, said.ours) == ("of 12,345", "0.1 and 20,000 beside 1.5 (x), 2 (y)")
    assert (said.interval, said.why) == ("", "0.1235 or so")  # its ends are not known
    assert [said.ours[n.at :][: len(n.shown)] for n in said.numbers] == ["0.1", "20,000", "1.5", "2"]
    assert [n.value for n in said.numbers] == [0.123456, 20000.4, 1.5, 2.0]
    assert shown(row, msgspec.structs.replace(found, low=1.0, high=2.0)).interval == "1 to 2 %"
    assert shown(row, msgspec.structs.replace(found, verdict="better")).why == ""


def test_every_row_has_a_name_of_its_own_and_a_text_that_can_be_filled():
    for paper in PAPERS:
        for claim, row in paper.known.values():
            assert claim.rows
            assert row.quantity
            found = Measured(row=row.name, verdict=row.verdict or "not comparable")
            assert row.verdict is None or all(shown(row, found).cells[:2])
    twice = Claim(name="a", where="", says="", rows=[Row(item="i", quantity="q")] * 2)
    with pytest.raises(InputError, match="the same name"):
        Paper("p", "", "", "", "", (twice,))


def test_the_tests_that_claims_name_exist():
    named = 0
    for paper in PAPERS:
        for claim in paper.claims:
            if not claim.how.startswith(".venv/bin/pytest "):
                continue
            words, _, chosen = claim.how.removeprefix(".venv/bin/pytest ").partition(" -k ")
            paths = [ROOT / word for word in words.split()]
            assert all(path.exists() for path in paths), claim.how
            text = "".join(path.read_text() for path in paths if path.is_file())
            assert not chosen or re.search(rf"def test_\w*{chosen}", text), claim.how
            named += 1
    assert named >= 15


def test_figures_of_papers_are_drawn_in_the_colours_of_the_palette():
    for path in (ROOT / "examples/papers").rglob("*.py"):
        assert not re.findall(r'"#[0-9a-f]{6}"', path.read_text()), path.name
    assert "--c0072b2" in variables(dark=True)


def test_every_claim_stands_on_the_committed_page():
    rows = (ROOT / "docs/results/papers.md").read_text().split("\n")
    for paper in PAPERS:
        for claim in paper.claims:
            words = f"| {markdown_cell(claim.where)} | {markdown_cell(claim.says)} | "
            assert sum(row.startswith(words) for row in rows) == 1, claim.name
