"""The output files of an example's comparison."""

from alula.stages.reporting.figures import Figure
from alula.stages.reporting.table import Table
from papers.comparison import this_machine, write_comparison

TABLE = Table("t", "A table", ("who", "what"), (("x", 1 / 3),))
READ = Table("t", "As read", ("who",), (("x",),))


def test_tables_figures_and_pages_are_written(tmp_path):
    source = tmp_path / "a.txt"
    source.write_text("a")
    figure = Figure("f", "A figure", "in words", "<svg/>")
    output, page = tmp_path / "out/all", tmp_path / "page.md"
    output.parent.mkdir()
    write_comparison(
        output,
        "All",
        [("source", source)],
        {"found": "much"},
        [TABLE],
        [figure],
        read=[READ],
        markdown=page,
        head=f"On {this_machine()}.",
    )
    assert sorted(path.name for path in output.parent.iterdir()) == ["all.html", "all.md", "f.svg", "t.csv"]
    assert (output.parent / "t.csv").read_text() == f"who,what\nx,{1 / 3!r}\n"
    assert (output.parent / "f.svg").read_text() == "<svg/>"
    text = (output.parent / "all.md").read_text()
    assert text.startswith("# All\n\n## In short\n\n- found: much\n")
    assert "## As read" in text
    assert page.read_text() == text.replace("# All\n", f"# All\n\nOn {this_machine()}.\n", 1)
    html = (output.parent / "all.html").read_text()
    assert all(words in html for words in ("much", "As read", "a.txt", "in words"))
    assert "A table" not in html


def test_without_others_the_pages_show_the_tables(tmp_path):
    write_comparison(tmp_path / "all", "All", [], {}, [TABLE], [])
    assert "| x | 0.3333 |" in (tmp_path / "all.md").read_text()
