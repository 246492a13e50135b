"""`alula help`, `-V`, and what shells complete."""

import os
import re
import subprocess
import sys

import click
import pytest

from alula import __version__
from alula.cli.main import COMMANDS, cli, run
from alula.cli.shell.grouped import COMMON, MANY, MOST
from alula.schemas.parameters.flight_defaults import COMPARATORS, FILTERS
from alula.stages.filtering.registry import filter_names


def completed(words, folder="."):
    """Answers of the program when bash asks what could follow."""
    environment = os.environ | {
        "_ALULA_COMPLETE": "bash_complete",
        "COMP_WORDS": " ".join(words),
        "COMP_CWORD": str(len(words) - 1) if not words[-1].endswith(" ") else str(len(words)),
    }
    done = subprocess.run(
        [sys.executable, "-P", "-m", "alula.cli"],
        env=environment,
        capture_output=True,
        text=True,
        cwd=folder,
        check=True,
    )
    return [line.partition(",")[2] for line in done.stdout.splitlines()]


def test_help_of_a_command_is_that_of_its_option(capsys):
    assert run(["help", "voxelize"]) == 0
    shown = capsys.readouterr().out
    assert run(["voxelize", "-h"]) == 0
    assert shown.strip() == capsys.readouterr().out.strip()
    assert run(["help"]) == 0
    assert "import-splat" in capsys.readouterr().out


def test_help_of_an_unknown_command_is_refused(capsys):
    assert run(["help", "fry"]) == 2
    assert capsys.readouterr().err == "alula: no command is called 'fry' (alula help lists them)\n"


def sections(name):
    """Headings of a command's help, each with the names of its options."""
    top = cli.make_context("alula", [name], resilient_parsing=True)
    with click.Context(cli.get_command(top, name), top) as own:
        return {
            heading: [
                next(word for word in names.replace(",", " ").split() if word[:2] == "--")
                for names, _ in shown
            ]
            for heading, shown in own.command.sections(own).items()
        }


@pytest.mark.parametrize("name", COMMANDS)
def test_at_most_ten_options_come_before_the_groups_and_the_common_ones_last(name):
    found = sections(name)
    command = cli.get_command(click.Context(cli), name)
    shown = [option for options in found.values() for option in options]
    known = [{*p.opts, *p.secondary_opts} for p in command.params if isinstance(p, click.Option)]
    has_more = len(known) + 1 > MANY
    assert len(shown) == len(set(shown)) == len(known) + 1 + has_more  # and --help, --help-all
    assert all(any(option in names for option in shown) for names in known)
    first, *_ = found
    assert first == "Options"
    assert 1 <= len(found["Options"]) <= MOST
    assert "--output" not in shown or found["Options"][0] == "--output"
    if len(shown) <= MOST:
        assert list(found) == ["Options"]
        return
    *_, last = found
    assert last == COMMON
    assert found[COMMON][-4:] == ["--json", "--quiet", "--verbose", "--help"]
    assert not {"--force", "--dry-run", "--seed", "--jobs", "--depfile"} & {*shown} - {*found[COMMON]}


def test_a_group_has_a_heading_of_its_own_in_the_help(capsys):
    assert run(["import-splat", "-h"]) == 0
    shown = capsys.readouterr().out
    places = [
        shown.index(text) for text in ("\nOptions:\n", "--turn", "\nFiltering:\n", "--drop-nan", "\nCommon")
    ]
    assert places == sorted(places)
    assert sections("observe")["Obstacles"][0] == "--confidence"  # a parameter of voxelize, where it matters


def test_fly_shows_ten_options_and_all_of_them_when_asked(capsys):
    assert run(["fly", "-h"]) == 0
    short = capsys.readouterr().out
    assert len(sections("fly")["Options"]) == 10
    assert [line for line in short.splitlines() if re.fullmatch(r"\w.*:", line)] == ["Options:"]
    assert "alula fly --help-all shows" in short
    assert run(["fly", "--help-all"]) == 0
    whole = capsys.readouterr().out
    assert all(option in whole for options in sections("fly").values() for option in options)
    assert run(["plan", "--help-all"]) == 2


def test_the_commands_are_listed_in_four_groups(capsys):
    assert run(["--help"]) == 0
    shown = capsys.readouterr().out
    places = [shown.index(f"\n{name}:\n") for name in ("Pipeline", "Vehicle", "Look", "Tools")]
    assert places == sorted(places)
    assert all(f"\n  {name} " in shown for name in COMMANDS)


def test_the_help_of_simulate_names_every_filter_and_those_for_research_apart(capsys):
    assert run(["simulate", "-h"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert {*FILTERS, *COMPARATORS} == {*filter_names()} - {"none"}
    text, _, research = shown.partition("For research, to compare with these: ")
    assert all(name in text for name in FILTERS)
    assert research.startswith(", ".join(COMPARATORS))


def test_the_version_has_a_short_option(capsys):
    assert run(["-V"]) == 0
    assert __version__ in capsys.readouterr().out


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_scripts_of_shells_name_the_program(shell, capsys):
    assert run(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert "_ALULA_COMPLETE" in script
    assert len(script.splitlines()) > 5


def test_the_script_of_bash_completes_commands_in_bash(tmp_path):
    (tmp_path / "alula").write_text(f'#!/bin/sh\nexec {sys.executable} -P -m alula.cli "$@"\n')
    (tmp_path / "alula").chmod(0o755)
    code = """
eval "$(alula completion bash)"
COMP_WORDS=(alula vox) COMP_CWORD=1
_alula_completion alula
echo "${COMPREPLY[@]}"
"""
    environment = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    done = subprocess.run(["bash", "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["voxelize"]


def test_filters_complete_after_a_comma():
    found = completed(["alula", "simulate", "--filter", "geofence,cone-"])
    assert found == [f"geofence,{name}" for name in filter_names() if name.startswith("cone-")]


def test_vehicles_and_options_complete():
    assert "crazyflie21" in completed(["alula", "simulate", "--vehicle", "cr"])
    assert "--min-opacity" in completed(["alula", "import-splat", "--min"])


def test_help_has_the_same_names_whatever_context_a_command_was_first_used_in(monkeypatch):
    """Click keeps the option that it makes in the first context, and all tests share the commands."""
    command = cli.get_command(click.Context(cli), "plan")
    monkeypatch.setattr(command, "_help_option", None)
    command.get_help(click.Context(command))
    assert "-h, --help" in command.get_help(click.Context(command, help_option_names=["-h", "--help"]))
