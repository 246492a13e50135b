"""Options with several numbers take one word in quotes, several words, or both, in every command."""

import click
import pytest

from alula.cli.shell.options import Numbers, NumbersOption


@click.command()
@click.option("--start", type=Numbers(3), cls=NumbersOption, required=True)
@click.option("--via", type=Numbers(3), cls=NumbersOption, multiple=True)
@click.option("--bounds", type=Numbers(6), cls=NumbersOption, default=None)
@click.option("--other")
@click.argument("names", nargs=-1)
def command(**values):
    return values


def parsed(*words):
    return command.main(list(words), standalone_mode=False)


BOX = (0.0, 0.0, -1.0, 4.0, 5.0, 6.5)


@pytest.mark.parametrize(
    "words",
    [
        ["--start", "-1 2 3e0", "--bounds", "0 0 -1 4 5 6.5"],
        ["--start", "-1,2,3", "--bounds", "0,0,-1,4,5,6.5"],
        ["--start", "-1, 2, 3", "--bounds", "0 0 -1", "4 5 6.5"],
        ["--start=-1", "2", "3", "--bounds=0", "0", "-1", "4,5", "6.5"],
        ["--bounds", "0", "0", "-1", "4", "5", "6.5", "--start", "-1", "2", "3"],
    ],
)
def test_all_forms_give_the_same_numbers(words):
    found = parsed("7", *words, "8", "room")
    assert found["start"] == (-1, 2, 3)
    assert found["bounds"] == BOX
    assert found["names"] == ("7", "8", "room")  # no more numbers than needed are taken


def test_an_option_may_be_repeated():
    found = parsed(
        "--start", "0 0 0", "--via", "1", "2", "3", "--via", "4 5 6", "--other", "x", "--via", "7,8,9"
    )
    assert found["via"] == ((1, 2, 3), (4, 5, 6), (7, 8, 9))
    assert found["bounds"] is None


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--start", "0 0"], "'0 0' is not 3 numbers; write 3 words, or one in quotes: \"x y z\""),
        (["--start", "0", "0", "--other", "1"], "'0 0' is not 3 numbers"),
        (["--start", "1 2 3 4"], "'1 2 3 4' is not 3 numbers"),
        (["--start", ""], "'' is not 3 numbers"),
        (["--start", "1 2 x"], "'x' is not a number"),
        (["--start", "1 2 nan"], "'nan' is not finite"),
        (["--start", "1", "2", "inf"], "'1 2' is not 3 numbers"),
        (["--start", "0 0 0", "--bounds", "0 0 0 1 1"], 'is not 6 numbers; .* "x0 y0 z0 x1 y1 z1"'),
        (["--start"], "requires an argument"),
    ],
)
def test_other_words_are_refused_with_the_form(words, message):
    with pytest.raises(click.UsageError, match=message):
        parsed(*words)


def test_every_command_takes_both_forms(tmp_path, capsys, monkeypatch):
    from alula.cli.main import run

    monkeypatch.chdir(tmp_path)
    plan = ["plan", "none.npz", "-o", "p.plan.npz"]
    align = ["scale-align", "none.npz", "-o", "s.scene.npz"]
    for words in (
        [*plan, "--start", "0 0 1", "--goal", "1 2 3", "--bounds", "-5 -5 -5 5 5 5"],
        [*plan, "--start", "0", "0", "1", "--goal", "1,2", "3", "--bounds", "-5", "-5", "-5", "5,5,5"],
        ["voxelize", "none.npz", "-o", "v.voxels.npz", "--crop", "0 0 0 1 1 1"],
        ["import-splat", "none.ply", "-o", "s.scene.npz", "--crop-sphere", "0", "0", "0", "2"],
        [*align, "--distance", "0 0 0", "1 0 0", "2.5", "--up", "0 0 1"],
        [*align, *["--distance", "0", "0", "0", "1", "0", "0", "2.5", "--up", "0,0,1"]],
    ):
        assert run(words) == 3, words
        assert "none." in capsys.readouterr().err
