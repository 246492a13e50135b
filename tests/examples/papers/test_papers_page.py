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
from papers.claims import claim_of, judged
from papers.collected import PAPERS, collect
from papers.compared import VERDICTS, Papers, read_comparison, write_comparison_record
from papers.fastbridge.claims import FASTBRIDGE_PAPER
from papers.markdown import papers_markdown
from papers.page import papers_page, sentence
from papers.record import Made, command_of, comparison_record
from papers.verdicts import PaperRow, exact
from support.papers import PRODUCER, SVG, jerk_rows, record, value
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
    shown = Values(html)
    for paper in again.papers:
        for name, count in paper.counts.items():
            assert shown.counts.get((paper.name, name.replace(" ", "-")), 0) == count
        for claim in paper.claims:
            known = shown.rows[f"{paper.name}-{claim.name}"]
            assert len(known) == len(claim.rows)
            assert shown.verdicts[f"{paper.name}-{claim.name}"] == claim.verdict.replace(" ", "-")
            for cells, row in zip(known, claim.rows, strict=True):
                texts = [text for text, _ in cells]
                assert texts[:4] == [row.quantity, row.published, row.ours, row.interval]
                assert all(words in texts[4] for words in (row.verdict, row.why, row.command))
                for place, name in ((2, "ours"), (3, "interval")):
                    assert cells[place][1] == [n.value for n in row.numbers if n.cell == name]
    jerk = next(claim for claim in again.papers[1].claims if claim.name == "mean-jerk")
    assert [[n.value for n in row.numbers] for row in jerk.rows] == [[3.4567891, 3.1, 3.87654], [0.2]]
    assert [(row.ours[n.at :][: len(n.shown)], n.shown) for row in jerk.rows for n in row.numbers[:1]] == [
        ("3.46", "3.46"),
        ("0.2", "0.2"),
    ]
    assert 'data-flights="500"' in html
    assert "no flights" in html


def test_a_claim_counts_once_and_as_its_least_favourable_measurement():
    papers, html = page_of(record(jerk_rows()))
    ours = papers.papers[1]
    assert [c.verdict for c in ours.claims if c.name in ("mean-jerk", "proposition-1")] == [
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
    speed = next(claim for claim in papers.papers[3].claims if claim.name == "speed")
    assert speed.rows[0].command == "make -C examples/geofencing page"
    assert "not in these records" in html


def test_later_records_fill_what_the_first_leaves_open():
    first = record([value("mean-jerk", "a"), value("loop-times", "loop mean")])
    few = {"setting": "quick"}
    second = record(
        [
            *(value("mean-jerk", "b", **few), value("max-jerk", "c", **few)),
            *(value("loop-times", "loop mean", **few), value("loop-times", "loop max", **few)),
        ],
        setting="quick",
    )
    papers, html = page_of(first, second)
    rows = {c.name: [(r.quantity, r.setting) for r in c.rows] for c in papers.papers[1].claims}
    assert rows["mean-jerk"] == [("a", "full")]
    assert rows["max-jerk"] == [("c", "quick")]
    assert rows["loop-times"] == [("loop mean", "full"), ("loop max", "quick")]  # a table, cell by cell
    assert "6 flights (quick setting)" in html
    with pytest.raises(InputError, match="'polly' is no known paper"):
        collect([record([], paper="polly")], PRODUCER)
    with pytest.raises(InputError, match="'gone', which is no claim"):
        collect([record([value("gone", "a")])], PRODUCER)


def test_our_figures_stand_beside_theirs_in_words_and_in_the_colours_of_the_page():
    names = ("figure-2-room", "figure-3-room", "figure-3-paths-room")
    drawings = {("fastbridge", name): SVG for name in names}
    papers, html = page_of(record([], figures=names, setting="quick"), drawings=drawings)
    figures = {c.name: [f.name for f in c.figures] for c in papers.papers[1].claims if c.figures}
    assert figures == {
        "figure-2-left": ["figure-2-room"],
        "figure-3-paths": ["figure-3-paths-room"],
        "mean-jerk": ["figure-3-room"],
    }
    right = next(c for c in papers.papers[1].claims if c.name == "figure-2-right")
    assert right.see == "figure-2-left"  # one figure has both
    assert '<a href="#fastbridge-figure-2-left-drawn">the figure above</a>' in html
    assert html.count("stroke: var(--c0072b2)") == 3
    assert "Our figure-2-room (quick setting)" in html
    assert 'id="fastbridge-figure-2-room-line"' in html
    assert "Peak error of the acceleration over the speed" in html
    for paper in papers.papers:
        for claim in paper.claims:
            assert claim.kind != "figure" or claim.shows


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
    assert jerk[3:7] == ["× 0.53", "× 3.46", "3.1 to 3.877", "refuted"]
    assert jerk[8] == "500"
    assert jerk[9].startswith("`make -C examples/fastbridge x")


def test_a_row_names_the_command_of_its_runs_of_its_test_or_of_the_whole_comparison(tmp_path):
    made = Made("make -C examples/fastbridge QUICK=1", "out/quick", "fastbridge.html", "quick", "here")
    flown = PaperRow("Abstract, Figure 3", "mean jerk, ratio", "", exact(2.0), "", "refuted", "")
    runs = ("room/a@1.run.mcap", "room/b@1.run.mcap", "times.json")
    rows = [
        flown.made_from(runs, 4),
        PaperRow("Proposition 1", "rates", "", "", "", "reproduced", ""),
        PaperRow("Proposition 3", "a state", "", "", "", "reproduced", ""),
    ]
    figure = Figure("figure-2-room", "t", "words", SVG)
    made_of = comparison_record(FASTBRIDGE_PAPER, rows, [figure], made, PRODUCER)
    assert [row.command for row in made_of.rows] == [
        "make -C examples/fastbridge QUICK=1 out/quick/room/{a@1,b@1}.run.mcap out/quick/times.json",
        ".venv/bin/pytest tests/unit/filtering/test_equations_fastbridge.py -k realisation_gap",
        "make -C examples/fastbridge QUICK=1 out/quick/fastbridge.html",
    ]
    assert [row.setting for row in made_of.rows] == ["quick", "full", "quick"]  # a test is the same in both
    one = flown.made_from(runs[:1], 2)
    assert command_of(one, claim_of(FASTBRIDGE_PAPER, one.item, one.quantity), made).endswith(
        "room/a@1.run.mcap"
    )
    path = tmp_path / "r.json"
    path.write_text(write_comparison_record(made_of))
    assert read_comparison(path) == made_of
    path.write_text(json.dumps({**json.loads(path.read_text()), "version": "2.0"}))
    with pytest.raises(InputError, match="no alula/comparison of version 1"):
        read_comparison(path)
    with pytest.raises(InputError, match="belongs to none"):
        comparison_record(
            FASTBRIDGE_PAPER, [PaperRow("x", "y", "", "", "", "better", "")], [], made, PRODUCER
        )


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
