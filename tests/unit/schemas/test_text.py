"""Text of files and links on its way to a terminal and to a page."""

from hypothesis import given
from hypothesis import strategies as st

from alula.schemas.text import html_text, one_line


def test_escape_sequences_and_marks_of_direction_do_not_pass():
    assert one_line("a\x1b[2Jb\x07\x9b1m\u202ec\x7f") == "a?[2Jb??1m?c?"
    assert one_line("covered\r\nnot covered\u2028x\ty") == "covered  not covered x y"
    assert one_line("Größe 3 m², λ → 漢字") == "Größe 3 m², λ → 漢字"


@given(st.text())
def test_any_text_becomes_printable_text_of_the_same_length(text):
    line = one_line(text)
    assert line.isprintable()
    assert len(line) == len(text)
    assert one_line(line) == line


def test_html_shows_the_text_and_does_nothing_else():
    assert html_text("<img src=x onerror=\"a('&')\">") == (
        "&lt;img src=x onerror=&quot;a(&#x27;&amp;&#x27;)&quot;&gt;"
    )
