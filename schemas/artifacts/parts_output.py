"""Writing of artifacts in parts: the parts first, the index last, then the folder gets its name.

The parts are written into `NAME.KEY.partial` beside the destination; the key follows from the provenance. An
interrupted run leaves this folder, which has no index and so passes for nothing whole. The same command finds
its parts there and makes only the others.
"""

from __future__ import annotations

import hashlib
import secrets
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from alula.schemas.artifacts.artifact import Artifact, file_hash, read_artifact, write_artifact
from alula.schemas.artifacts.kinds import Kind
from alula.schemas.artifacts.manifest import Manifest, producer
from alula.schemas.artifacts.parts import INDEX, PartRef, count_of, described, encode_index, whole_arrays
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.atomic import atomic_output, replace_folder, sync_folder
from alula.schemas.errors import InputError, LinkError, OutputError

SUFFIX = ".partial"
_UNKNOWN = "0" * 64

Domain = Sequence[Sequence[int]]


@dataclass(frozen=True, slots=True)
class WrittenPart:
    """A part that exists: its reference and its manifest."""

    ref: PartRef
    manifest: Manifest


def part_name(kind: Kind, *numbers: int) -> str:
    """Name of a part, such as `part-00003-001.scene.npz`.

    Args:
        numbers: not negative; they tell it from the other parts.
    """
    first, *others = numbers
    return f"part-{first:05d}" + "".join(f"-{number:03d}" for number in others) + kind.suffix


def write_part(
    folder: Path | None, name: str, artifact: Artifact, domain: Domain | None = None
) -> WrittenPart:
    """Write a part; also in another process than that of the writer.

    Args:
        folder: `PartsWriter.folder`; None writes nothing.
        artifact: a scene, voxels or a cover that is not empty, with its inputs.

    Raises:
        OutputError: the file cannot be written.
    """
    if folder is not None:
        write_artifact(folder / name, artifact, is_final=False)
    return _written(folder, name, artifact, domain)


def kept_part(folder: Path | None, name: str, kind: Kind, domain: Domain | None = None) -> WrittenPart | None:
    """Part that an interrupted run of the same command has finished; None where there is none.

    Args:
        folder: `PartsWriter.folder`.
    """
    if folder is None or not (folder / name).is_file():
        return None
    try:
        artifact = read_artifact(folder / name, kind)
        return _written(folder, name, artifact, domain) if count_of(artifact) else None
    except InputError:  # it is made again
        return None


def _written(folder: Path | None, name: str, artifact: Artifact, domain: Domain | None) -> WrittenPart:
    ref = PartRef(
        file=name,
        sha256=_UNKNOWN if folder is None else file_hash(folder / name),
        bytes=1 if folder is None else (folder / name).stat().st_size,
        count=1,
        lower=[0.0] * 3,
        upper=[0.0] * 3,
        domain=None if domain is None else [[int(c) for c in corner] for corner in domain],
    )
    return WrittenPart(described(artifact, ref), artifact.manifest)


class PartsWriter:
    """An artifact in parts that is being written; made by `parts_output`.

    Attributes:
        path: the folder to make.
        folder: where `write_part` writes; None for a dry run.
        kind: of the whole and of each part.
    """

    def __init__(self, path: Path, kind: Kind, folder: Path | None) -> None:
        self.path, self.folder, self.kind = path, folder, kind
        self._parts: list[WrittenPart] = []

    def __len__(self) -> int:
        return len(self._parts)

    @property
    def manifests(self) -> list[Manifest]:
        """Manifests of the parts taken so far."""
        return [part.manifest for part in self._parts]

    def take(self, part: WrittenPart) -> None:
        """Append a part to the whole."""
        self._parts.append(part)

    def whole(self, provenance: Provenance, **fields: Any) -> Manifest:
        """Manifest of the whole.

        Args:
            **fields: fields of the kind's manifest that neither the parts nor the provenance determine.
        """
        return self.kind.manifest(
            schema=self.kind.name,
            version=self.kind.version,
            producer=producer(),
            parameters=provenance.parameters,
            inputs=provenance.inputs,
            seed=provenance.seed,
            arrays=whole_arrays(self.kind, self.manifests),
            **fields,
        )

    def finish(self, whole: Manifest) -> None:
        """Write the index and give the folder its name; a dry run writes nothing.

        Raises:
            OutputError: the index cannot be written, or the folder cannot be renamed.
        """
        folder, path = self.folder, self.path
        if folder is None:
            return
        refs = [part.ref for part in self._parts]
        with atomic_output(folder / INDEX, is_final=False) as file:
            file.write(encode_index(self.kind, whole, refs))
        listed = {INDEX, *(ref.file for ref in refs)}
        old = path.parent / f".{path.name}.{secrets.token_hex(6)}.tmp"
        try:
            for left in folder.iterdir():  # of an interrupted run
                if left.name not in listed:
                    left.unlink()
            sync_folder(folder)
            replace_folder(folder, path, old)
        except OSError as error:
            raise OutputError(f"{path}: cannot write: {error.strerror or error}") from error
        finally:
            shutil.rmtree(old, ignore_errors=True)


@contextmanager
def parts_output(
    path: Path, kind: Kind, provenance: Provenance, *, dry_run: bool = False
) -> Iterator[PartsWriter]:
    """Context with a writer of an artifact in parts, whose `finish` makes the folder appear.

    After an interruption, or the loss of all workers, the finished parts stay, unless there are none; after
    any other exception all that the run has written is removed.

    Args:
        path: the folder to write; an earlier one is replaced.
        provenance: of the whole; parts of an interrupted run with the same are used again.

    Raises:
        OutputError: the folder cannot be created, written or renamed.
    """
    if dry_run:
        yield PartsWriter(path, kind, None)
        return
    folder = partial_folder(path, provenance)
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot write: {error.strerror or error}") from error
    try:
        yield PartsWriter(path, kind, folder)
    except LinkError:  # workers were lost, but their finished work was not
        raise
    except Exception:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    finally:
        with suppress(OSError):
            folder.rmdir()  # only without parts


def partial_folder(path: Path, provenance: Provenance) -> Path:
    """Folder of the finished parts of an interrupted run.

    Args:
        provenance: of the whole; the names of inputs do not count.
    """
    unnamed = [msgspec.structs.replace(ref, name="") for ref in provenance.inputs]
    record = msgspec.structs.replace(provenance, inputs=unnamed, summary={})
    key = hashlib.sha256(msgspec.json.encode(record, order="sorted")).hexdigest()[:12]
    return path.parent / f"{path.name}.{key}{SUFFIX}"
