"""Man pages: what the help shows, in roff that formatters take without a warning."""

import re
import shutil
import subprocess

import click
import pytest

from alula.cli.main import COMMANDS, cli, run
from alula.cli.shell.manual import escaped, man_pages

HAS_GROFF = pytest.mark.skipif(shutil.which("groff") is None, reason="groff is not installed")


@pytest.fixture(scope="module")
def pages():
    return man_pages()


def formatted(page, *options):
    words = ["groff", "-man", "-Tascii", "-P-cbou", "-rLL=200n", *options]
    done = subprocess.run(words, input=page, capture_output=True, text=True, check=True)
    return done.stdout, done.stderr


def test_each_command_has_a_page_with_all_of_its_options(pages):
    assert set(pages) == {"alula.1", *(f"alula-{name}.1" for name in COMMANDS)}
    for name in COMMANDS:
        page = pages[f"alula-{name}.1"]
        for param in cli.get_command(click.Context(cli), name).params:
            if isinstance(param, click.Option):
                assert all(f"\\fB{escaped(option)}\\fR" in page for option in param.opts), (name, param.opts)
        assert ".SH EXAMPLES\n.nf\nalula" in page
        assert page.isascii()
        assert f"\\&\\fBalula\\-{escaped(name)}(1)\\fR" in pages["alula.1"]


@HAS_GROFF
def test_formatters_have_no_warning(pages):
    for name, page in pages.items():
        assert formatted(page, "-ww", "-z", "-Tutf8") == ("", ""), name


@HAS_GROFF
def test_a_page_has_the_groups_and_the_examples_of_the_help(pages):
    shown, _ = formatted(pages["alula-plan.1"])
    headings = re.findall(r"^ *[A-Z].*$", shown, re.MULTILINE)
    for heading in (
        "NAME",
        "SYNOPSIS",
        "OPTIONS",
        "   Limits of the motion",
        "   Common options",
        "EXIT STATUS",
    ):
        assert heading in headings
    assert '\n       alula plan room.cover.npz -o room.plan.npz --start "-1 0 1" --goal "3 2 1.2"\n' in shown
    assert "       --speed FLOAT\n              Maximum speed [m/s].  [default: 1.0]\n" in shown


@HAS_GROFF
@pytest.mark.parametrize("text", [".SH x", "'tis \\fB\\n(dy", "--a `b` ^c ~d \"e\" 'f'", "a.b\\", "-"])
def test_text_is_printed_as_it_is(text):
    assert formatted(f".nf\n{escaped(text)}\n", "-ww")[0].split() == text.split()


def test_help_writes_the_pages_to_a_folder(tmp_path, capsys):
    assert run(["help", "--man", str(tmp_path / "share/man1")]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'share/man1'}: {len(COMMANDS) + 1} man pages\n"
    assert {path.name: path.read_text() for path in (tmp_path / "share/man1").iterdir()} == man_pages()
    (tmp_path / "file").write_text("")
    assert run(["help", "--man", str(tmp_path / "file")]) == 3
    assert capsys.readouterr().err == f"alula: {tmp_path / 'file'}: cannot be made: File exists\n"
    assert run(["help", "merge", "--man", str(tmp_path)]) == 2
