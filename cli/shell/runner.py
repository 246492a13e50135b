"""Common work of commands that write a file: provenance, skipping of current outputs, writing."""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import msgspec

from alula.cli.shell.options import Common
from alula.cli.shell.present import digits_of, echo, flat, plain, print_json
from alula.cli.shell.progress import shown_progress
from alula.schemas.artifacts.provenance import Provenance, differences, parameters_of, read_provenance
from alula.schemas.atomic import write_text
from alula.schemas.errors import InputError, OutputError, UsageError
from alula.schemas.files import check_no_stream, is_special, printable, reading
from alula.schemas.progress import Progress

INDEX = "index.json"  # as `alula.schemas.artifacts.parts` has it, which imports NumPy

if TYPE_CHECKING:
    from alula.schemas.artifacts.artifact import Artifact
    from alula.schemas.artifacts.kinds import Kind
    from alula.schemas.artifacts.manifest import InputRef


def input_ref(role: str, path: Path, name: str = "") -> InputRef:
    """Describe an input file, with its kind and version when it is an artifact.

    The hash of an artifact in parts is that of its index, which has the hashes of the parts.

    Args:
        path: the file, or the folder of an artifact in parts.
        name: to record in place of the file's own.

    Raises:
        InputError: the file cannot be read.
    """
    from alula.schemas.artifacts.artifact import file_hash
    from alula.schemas.artifacts.manifest import InputRef

    _check_input(path)
    sha256 = file_hash(index_of(path))
    recorded = read_provenance(path)
    schema, version = (recorded.schema, recorded.version) if recorded else ("", "")
    return InputRef(role, schema, version, sha256, name or printable(path.name))


def index_of(path: Path) -> Path:
    """File that names all others of an input: the index of an artifact in parts, else the file itself.

    Args:
        path: a file, or the folder of an artifact in parts.
    """
    index = path / INDEX
    return index if index.is_file() else path


def _check_input(path: Path) -> None:
    path = index_of(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder, not a file")
    check_no_stream(path)
    with reading(path):
        path.open("rb").close()


def run_stage(
    common: Common,
    kind: Kind,
    config: Any,
    inputs: Mapping[str, Path],
    build: Callable[[Progress], Artifact],
    *,
    seed: int | None = None,
    begin: Callable[[Provenance], None] | None = None,
    names: Mapping[str, str] | None = None,
) -> None:
    """Run a stage with an array artifact as its output, unless the output is already current.

    Args:
        config: configuration of the stage; its fields are the recorded parameters.
        inputs: role to path of all files that the output depends on.
        begin: called with the provenance of the output before `build`.
        names: role to name of inputs that are recorded by another name than the file's own.

    Raises:
        UsageError, InputError, OutputError: as `run`.
    """
    from alula.schemas.artifacts.artifact import Artifact, write_artifact

    def make(
        provenance: Callable[[], Provenance], progress: Progress
    ) -> tuple[Callable[[], None], dict[str, Any]]:
        if begin is not None:
            begin(provenance())
        artifact = build(progress)
        recorded = provenance()
        manifest = msgspec.structs.replace(artifact.manifest, inputs=recorded.inputs, seed=seed)
        finished = Artifact(manifest, artifact.arrays)
        return lambda: write_artifact(common.output, finished), manifest.summary

    check_array_name(common.output, kind)
    run_beside(common, kind.name, kind.version, parameters_of(config), inputs, make, seed, names=names)


def check_array_name(output: Path, kind: Kind) -> None:
    """Refuse a name that readers would not recognise as an array artifact.

    Raises:
        UsageError: the name does not end in .npz.
    """
    if not output.name.endswith(".npz"):
        folder = f" or, for a folder of parts, {kind.folder_suffix}" if kind.folder_suffix else ""
        raise UsageError(f"{output}: the output must end in .npz (usually {kind.suffix}){folder}")


def run(
    common: Common,
    schema: str,
    version: str,
    parameters: dict[str, Any],
    inputs: Mapping[str, Path],
    make: Callable[[Provenance, Progress], tuple[Callable[[], None], dict[str, Any]]],
    *,
    seed: int | None = None,
    mark: str = "",
    members: str = "",
) -> None:
    """Produce one output of any kind, a file or a folder.

    Args:
        schema: kind of the output; with `version` it is part of the provenance.
        parameters: all parameters that the output depends on, as plain JSON values.
        inputs: role to path of all files that the output depends on.
        make: function from the provenance to record and a progress callback to a function that writes the
            file atomically, and the summary to print.
        mark: name of the file with the provenance in an output that is a folder; empty for a file.
        members: regular expression of the names of the other files of that folder; a folder with any other
            file is not replaced.

    Raises:
        UsageError: the output exists with other provenance and --force is not given, or is an input.
        InputError: an input cannot be read, or changed during the run.
        OutputError: the output's folder does not exist or the file cannot be written.
    """
    run_beside(
        *(common, schema, version, parameters, inputs),
        lambda provenance, progress: make(provenance(), progress),
        seed,
        mark,
        members,
    )


def run_beside(
    common: Common,
    schema: str,
    version: str,
    parameters: dict[str, Any],
    inputs: Mapping[str, Path],
    make: Callable[[Callable[[], Provenance], Progress], tuple[Callable[[], None], dict[str, Any]]],
    seed: int | None,
    mark: str = "",
    members: str = "",
    names: Mapping[str, str] | None = None,
) -> None:
    """As `run`, but `make` gets a function that returns the provenance, so that hashing runs beside it."""
    target = common.output / mark
    if mark and common.output.exists():
        _check_folder(common.output, target, members)
        _check_no_input(common.output, inputs)
    else:
        check_output(common.output, inputs)
    if common.depfile is not None:
        check_output(common.depfile, {**inputs, "output": common.output})
    for path in inputs.values():
        _check_input(path)
    before = {path: state_of(index_of(path)) for path in inputs.values()}
    shown = names or {}

    def recorded_now() -> Provenance:
        refs = [input_ref(role, path, shown.get(role, "")) for role, path in inputs.items()]
        return Provenance.now(schema, version, parameters, seed, refs)

    provenance = _Meanwhile(recorded_now)
    status = "written"
    summary: dict[str, Any] = {}
    made = common.output if mark == INDEX else target  # an index of parts alone proves nothing
    if target.exists() and (recorded := current(made, provenance(), force=common.force)) is not None:
        status, summary = "unchanged", recorded.summary
        if not common.dry_run:
            os.utime(target)
    if status != "unchanged":
        with shown_progress(common) as progress:
            write, summary = make(provenance, progress)
        for path, state in before.items():
            if state_of(index_of(path)) != state:
                raise InputError(f"{path}: changed while it was read; start again when it is whole")
        if common.dry_run:
            status = "dry-run"
        else:
            write()
    write_depfile(common, target if mark == INDEX else common.output, inputs.values())
    show(common, status, summary)


def write_depfile(common: Common, written: Path, inputs: Iterable[Path]) -> None:
    """Write the file of Make dependencies, if it is asked for and this is no dry run."""
    if common.depfile is not None and not common.dry_run:
        prerequisites = " ".join(["", *(make_escape(index_of(path)) for path in inputs)])
        write_text(common.depfile, make_escape(written, " \t#:*?[%") + f":{prerequisites}\n")


def state_of(path: Path) -> tuple[int, ...]:
    """Attributes that change when a file is written to or replaced; empty where it does not exist."""
    try:
        found = path.stat()
    except OSError:
        return ()
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


class _Meanwhile:
    """Result of a call that runs in a thread beside other work."""

    def __init__(self, call: Callable[[], Provenance]) -> None:
        self._call = call
        self._result: Provenance | None = None
        self._error: Exception | None = None
        # A daemon thread: when the work fails or is interrupted, the command ends without waiting for it.
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._result = self._call()
        except Exception as error:  # noqa: BLE001  raised again where the result is used
            self._error = error

    def __call__(self) -> Provenance:
        self._thread.join()
        if self._error is not None:
            raise self._error
        assert self._result is not None
        return self._result


def current(output: Path, provenance: Provenance, *, force: bool) -> Provenance | None:
    """Recorded provenance of an existing output that is current; None when it must be made.

    Args:
        provenance: provenance that the output must have.
        force: allow the replacement of a file with other provenance.

    Raises:
        UsageError: the output has other provenance or was not made by alula, and `force` is not given.
    """
    if not output.exists():
        return None
    recorded = read_provenance(output, verify=True)
    changed = ["it is not a file of alula's"] if recorded is None else differences(recorded, provenance)
    if changed and not force:
        raise UsageError(f"{output}: exists, but {'; '.join(changed)}; -f replaces it")
    return None if changed else recorded


def check_output(output: Path, inputs: Mapping[str, Path]) -> None:
    """Refuse an output that cannot be written, before any work is done.

    Args:
        inputs: role to path of the inputs, which the output must not replace.

    Raises:
        OutputError: the output is a folder or a device, or its folder is missing or not writable.
        UsageError: the output is also an input.
    """
    if output.is_dir():
        raise OutputError(f"{output}: is a folder, not a file to write")
    if is_special(output):
        raise OutputError(f"{output}: is a device or a pipe; outputs are files")
    if not output.parent.is_dir():
        raise OutputError(f"{output}: the folder {output.parent} does not exist")
    if not os.access(output.parent, os.W_OK | os.X_OK):
        raise OutputError(f"{output}: the folder {output.parent} is not writable")
    _check_no_input(output, inputs)


def _check_no_input(output: Path, inputs: Mapping[str, Path]) -> None:
    for role, path in inputs.items():
        if path.absolute() == output.absolute() or (
            output.exists() and path.exists() and output.samefile(path)
        ):
            raise UsageError(
                f"{output}: is also an input" if role != "output" else f"{output}: is also the output"
            )


def _check_folder(folder: Path, mark: Path, members: str) -> None:
    """Refuse to replace a folder that is no output, whatever --force says.

    Args:
        mark: its file with the provenance, which an output has.
        members: regular expression of the names of its other files.

    Raises:
        OutputError: it is not a folder, or not writable.
        UsageError: it has other files.
    """
    if not folder.is_dir():
        raise OutputError(f"{folder}: is a file, not a folder to write")
    if folder.name in ("", ".."):
        raise UsageError(f"{folder}: give the folder by its name")
    for each in (folder, folder.absolute().parent):
        if not os.access(each, os.W_OK | os.X_OK):
            raise OutputError(f"{folder}: the folder {each} is not writable")
    names = {path.name for path in folder.iterdir()}
    is_output = mark.name in names and all(re.fullmatch(members, name) for name in names - {mark.name})
    if names and not is_output:
        raise UsageError(f"{folder}: is a folder with other files, which is not replaced")


def show(common: Common, status: str, summary: Mapping[str, Any]) -> None:
    """Print the result on stdout, as one JSON object or a line per figure; notes go to stderr.

    Args:
        status: written, unchanged or dry-run.
        summary: figures by name; `notes` is a list of sentences. For people, counts of outcomes and of steps
            of which there were none are left out.
    """
    if common.json:
        print_json({"output": str(common.output), "status": status, "summary": summary})
        return
    if common.quiet:
        return
    echo(f"{common.output}: {status}")
    shown = facts(summary)
    width = max((len(key) for key in shown), default=0)
    for key, value in shown.items():
        echo(f"  {key:<{width}}  {value}")
    for note in summary.get("notes", ()):
        echo(f"note: {note}", err=True)


def facts(summary: Mapping[str, Any]) -> dict[str, str]:
    """Figures of a summary as people read them, by name; those that say nothing are left out.

    Args:
        summary: figures by name; its notes are no figures.
    """
    return {
        key: plain(value, digits=digits_of(key))
        for key, value in flat(summary)
        if key != "notes" and not _says_nothing(key, value)
    }


def _says_nothing(key: str, value: Any) -> bool:
    from alula.schemas.log.run import Outcome

    is_counted = key.endswith("_steps") or (key in get_args(Outcome) and key != "reached")
    return value is None or (is_counted and value == 0 and not isinstance(value, bool))


def make_escape(path: Path, special: str = " \t#:*?[") -> str:
    """Escape a file name for GNU Make; a target needs % escaped too, a prerequisite must not."""
    return re.sub(rf"(\\*)([{re.escape(special)}])", r"\1\1\\\2", str(path)).replace("$", "$$")
