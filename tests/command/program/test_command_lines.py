"""Every command line of README.md and docs/ runs, or the real parser accepts it where it cannot run here."""

import itertools
import os
import re
import shutil
import subprocess
from pathlib import Path

import click
import pytest

from alula.cli.main import COMMANDS, cli, run
from support.files.command_lines import PAGES, CommandLine, command_lines, spans
from support.files.doc_files import DocFiles
from support.paths import DOCS, EXAMPLES, ROOT

LINES = [line for page in PAGES for line in command_lines(page)]
ALULA = [line for line in LINES if line.words[0] == "alula"]

# Command lines that are parsed and not run: pattern, reason.
PARSED = (
    (r"^alula fly .*sim:", "flies in real time; its checks run in a test of their own"),
    (r"^alula fly ", "needs a vehicle; tests/realtime flies"),
    (r"^alula identify ", "measures a vehicle in real time"),
    (r"^alula sim-vehicle ", "serves until it is stopped"),
    (r"^alula demo$", "runs the example of the room; tests/examples does"),
    (r"^alula view (?!.* -o )", "serves a browser until it is stopped"),
    (r"^alula doctor", "is about the machine"),
    (r"^alula verify city.cover", "needs a cover in parts; tests/command/covers/test_city.py proves one"),
    (r"^alula import-splat (-|https:)", "reads a stream, or from another machine"),
)
HELP = "docs/guide/commands.md"  # the examples of the help: parsed
ELLIPSIS = re.compile(r" \.\.\. ")  # leaves a part out

# Command lines of other programs: pattern, reason why they are not run.
ELSEWHERE = (
    (
        r"^(git|docker|bash|sudo|apt-get|apt|pip|pipx|uv|curl|wget|unzip|mkdir|export) ",
        "prepares the machine",
    ),
    (r"^(cat|cd|eval|source|\.) ", "of the shell"),
    (r"^(\./waf|Tools/\S+|~/\S+) ", "builds or starts an autopilot"),
    (r"^make px4_sitl_sih ", "builds PX4"),
    (r"^make CRAZYFLIE_BASE=", "builds the firmware of a Crazyflie, from its sources"),
    (r"^make upload ", "writes to a board"),
)


def parse(words: tuple[str, ...]) -> click.Context:
    """Parse a command line as the program does: options, types, arguments."""
    top = cli.make_context("alula", list(words[1:2]), resilient_parsing=True)
    command = cli.get_command(top, words[1])
    assert command is not None, f"no command is called {words[1]}"
    return command.make_context(words[1], list(words[2:]), parent=click.Context(cli, info_name="alula"))


def reason(table, text: str) -> str | None:
    return next((why for pattern, why in table if re.search(pattern, text)), None)


def runs(line: CommandLine) -> bool:
    return line.page != HELP and not ELLIPSIS.search(str(line)) and not reason(PARSED, " ".join(line.words))


PAGE = """# A page

Text with `alula info FILE --json`, and a list:

1. A step:

    ```sh
    alula info a.npz   # what it is
    cd inner && alula view a.npz \\
      -o page.html
    ```

```toml
alula = "no command"
```

    make -n demo
    a table of text

```
LIVE=1 .venv/bin/alula doctor > found.txt &
what it prints
```
"""


def test_command_lines_are_found_in_all_kinds_of_blocks(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    found = {(line.number, line.folder, line.words) for line in command_lines(page)}
    assert found == {
        (8, "", ("alula", "info", "a.npz")),
        (9, "inner", ("cd", "inner")),
        (9, "inner", ("alula", "view", "a.npz", "-o", "page.html")),
        (17, "", ("make", "-n", "demo")),
        (21, "", ("alula", "doctor")),
    }
    assert spans(page) == ["alula info FILE --json"]


@pytest.mark.parametrize(
    "line", ["alula voxelise a.npz", "alula merge a.npz -o b.npz --hull 3", "alula merge a.npz"]
)
def test_a_wrong_command_line_is_refused(line):
    with pytest.raises((click.ClickException, AssertionError)):
        parse(tuple(line.split()))


def test_pages_have_command_lines():
    assert len(ALULA) > 150
    assert len([line for line in ALULA if runs(line)]) > 70
    assert {line.words[1] for line in ALULA} == set(COMMANDS)


@pytest.mark.parametrize("page", sorted({line.page for line in ALULA}))
def test_command_lines_are_parsed(page):
    for line in ALULA:
        if line.page == page and not ELLIPSIS.search(str(line)):
            try:
                parse(line.words)
            except click.ClickException as error:
                pytest.fail(f"{line}: {error.format_message()}")


def test_command_lines_within_sentences_have_only_options_that_exist():
    found = [(page.name, text) for page in PAGES for text in spans(page)]
    assert len(found) > 50
    for page, text in found:
        name = text.split()[1]
        assert name in COMMANDS, f"{page}: {text}"
        top = cli.make_context("alula", [name], resilient_parsing=True)
        command = cli.get_command(top, name)
        assert command is not None
        params = command.get_params(click.Context(command, top, name))
        known = {option for param in params for option in (*param.opts, *param.secondary_opts)} | {"-h"}
        for option in re.findall(r"(?<=[ \[])--?[a-zA-Z][\w-]*", text):
            assert option in known, f"{page}: {text}: {option}"


def test_command_lines_of_other_programs_are_known():
    for line in LINES:
        text = " ".join(line.words)
        if line.words[0] in ("alula", "make") or reason(ELSEWHERE, text):
            continue
        assert line.words[0] in ("python", "python3"), f"{line}: neither run nor in a table of this test"
        if "-m" in line.words or "-c" in line.words:
            continue
        script = next(word for word in line.words if word.endswith(".py"))
        folders = (ROOT, EXAMPLES / "rehearsal")
        path = next((folder / script for folder in folders if (folder / script).is_file()), None)
        assert path is not None, f"{line}: there is no {script}"
        for option in re.findall(r"(?<= )--[\w-]+", text):
            assert f'"{option}"' in path.read_text(), f"{line}: {script} has no {option}"


@pytest.mark.parametrize(
    "words",
    sorted({line.words for line in LINES if line.words[0] == "make"}),
    ids=lambda words: " ".join(words),
)
def test_make_lines_have_targets(words):
    if reason(ELSEWHERE, " ".join(words)):
        return
    folders = [ROOT, EXAMPLES / "rehearsal"]  # of the pages that work in the latter
    ends = [
        subprocess.run(
            [words[0], "-n", *words[1:]],
            cwd=folder,
            capture_output=True,
            text=True,
            env=os.environ,
            check=False,
        )
        for folder in folders
        if folder == ROOT or "-C" not in words
    ]
    assert 0 in [end.returncode for end in ends], ends[0].stderr


SHORT = {"--trials": "2", "--gaussians": "3000"}
LIGHT = ("info", "scenario", "demo-scene")
LIGHT_IN_THE_GARDEN = (*LIGHT, "import-splat", "scale-align", "voxelize", "merge", "export")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return DocFiles(tmp_path_factory.mktemp("docs"))


def shortened(words: tuple[str, ...]) -> list[str]:
    """The words with few trials: flights of random pairs, or of a scenario that says how many."""
    result = [SHORT.get(before, word) for before, word in zip(("", *words), words, strict=False)]
    if words[1] != "simulate" or "--trials" in words or "--pairs-from" in words:
        return result
    source = Path(words[2])
    many = source.name.endswith((".cover.npz", ".scene.npz")) or (
        source.suffix == ".toml" and re.search(r"^(trials|count) = (?!1$)", source.read_text(), re.MULTILINE)
    )
    return [*result, "--trials", "2"] if many else result


def inputs(words: tuple[str, ...]) -> list[str]:
    """Names that may be those of files which the line reads."""
    pairs = itertools.pairwise(words[1:])
    return [word.partition("=")[2] or word for before, word in pairs if before != "-o" and word[0] != "-"]


def place_of(line: CommandLine) -> str:
    places = [place for place in ("garden", "shed") if any(word.startswith(place) for word in line.words)]
    return places[0] if places else "room"


def cases():
    seen = set()
    for line in filter(runs, ALULA):
        if line.words not in seen:
            seen.add(line.words)
            light = LIGHT_IN_THE_GARDEN if place_of(line) == "garden" else LIGHT
            is_quick = line.words[1] in light and (line.page, line.words[1]) not in seen
            seen.add((line.page, line.words[1]))
            marks = [] if is_quick else [pytest.mark.slow]
            yield pytest.param(line, id=f"{line.page}: {' '.join(line.words)}", marks=marks)


def put_inputs(line: CommandLine, files: DocFiles, tmp_path: Path) -> Path:
    """Put the files that a line reads into a folder, and the examples; the folder in which it runs."""
    here = tmp_path / "place" / line.folder
    here.mkdir(parents=True, exist_ok=True)
    for part in ("room", "world", "dr-acbf", "geofencing", "vehicles"):
        ignored = shutil.ignore_patterns("out", "*.py")
        shutil.copytree(
            EXAMPLES / part, tmp_path / "place/examples" / part, ignore=ignored, dirs_exist_ok=True
        )
    texts = [(here / name).read_text() for name in inputs(line.words) if (here / name).is_file()]
    place = place_of(line)
    for name in inputs(line.words):
        target = here / name
        if not target.exists() and files.put(name, target, place) and name.endswith(".toml"):
            texts.append(target.read_text())
    for text in texts:  # files that a scenario names
        for name in re.findall(r'^\w+ = "([\w./-]+\.(?:npz|toml))"', text, re.MULTILINE):
            if not (here / name).exists():
                files.put(name, here / name, place)
    for position, word in enumerate(line.words[:-1]):
        if word == "-o":
            Path(here / line.words[position + 1]).parent.mkdir(parents=True, exist_ok=True)
    return here


@pytest.mark.parametrize("line", list(cases()))
def test_command_lines_run(line, files, tmp_path, monkeypatch, capsys):
    here = put_inputs(line, files, tmp_path)
    monkeypatch.chdir(here)
    code = run(shortened(line.words)[1:])
    printed = capsys.readouterr()
    assert code in ((0, 4) if line.words[1] == "simulate" else (0,)), printed.err
    for position, word in enumerate(line.words[:-1]):
        if word == "-o":
            assert (here / line.words[position + 1]).exists()


IN_SIMULATION = {
    line.words: line for line in ALULA if line.words[1] == "fly" and "sim:" in str(line) and line.page != HELP
}


@pytest.mark.every(5)
@pytest.mark.parametrize("words", sorted(IN_SIMULATION), ids=lambda words: " ".join(words))
def test_flights_of_the_simulated_vehicle_pass_their_checks(
    words, files, tmp_path, monkeypatch, capsys, quick_clock
):
    here = put_inputs(IN_SIMULATION[words], files, tmp_path)
    monkeypatch.chdir(here)
    code = run([*words[1:], "--dry-run"])
    printed = capsys.readouterr()
    assert code == 0, printed.err
    assert printed.out.startswith(f"{words[words.index('-o') + 1]}: dry-run")


PYTHON = [
    pytest.param("\n".join(blocks), id=page.name)
    for page in sorted((DOCS / "howto").glob("*.md"))
    if (blocks := re.findall(r"^```python\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL))
]


@pytest.mark.slow
@pytest.mark.parametrize("blocks", PYTHON)
def test_python_of_how_to_guides_runs(blocks, files, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name in re.findall(r"[\w.]+\.(?:npz|mcap|ply)", blocks):
        assert files.put(name, tmp_path / name, "garden")
    exec(compile(blocks, "how-to", "exec"), {})
    assert capsys.readouterr().out.strip()
