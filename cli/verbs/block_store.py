"""Finished covers of blocks in a folder, so that an interrupted merge continues from them."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import msgspec

from alula.cli.shell.interruption import InterruptedWithAdvice
from alula.schemas.artifacts.artifact import Artifact, read_artifact, write_artifact
from alula.schemas.artifacts.kinds import COVER
from alula.schemas.artifacts.manifest import InputRef
from alula.schemas.artifacts.parts_output import part_name
from alula.schemas.errors import InputError, LinkError, OutputError
from alula.stages.compression.merge_blocks import CoverStore


class FolderStore(CoverStore):
    """Covers as files: `block-LEVEL-X-Y-Z.cover.npz` before the last merges, `part-N.cover.npz` after them.

    A damaged file counts as missing.
    """

    def __init__(self, folder: Path, inputs: Sequence[InputRef]) -> None:
        self._folder, self._inputs = folder, list(inputs)
        self._checked: set[tuple[int, ...]] = set()

    def path(self, key: tuple[int, ...]) -> Path:
        """File of a cover.

        Args:
            key: (level, x, y, z), or (number,) of a part.
        """
        if len(key) == 1:
            return self._folder / part_name(COVER, *key)
        return self._folder / f"block-{'-'.join(map(str, key))}{COVER.suffix}"

    def has(self, key: tuple[int, ...]) -> bool:
        """See `CoverStore`."""
        if key not in self._checked and self.path(key).is_file():
            with suppress(InputError):
                read_artifact(self.path(key), COVER)
                self._checked.add(key)
        return key in self._checked

    def get(self, key: tuple[int, ...]) -> Artifact:
        """See `CoverStore`."""
        return read_artifact(self.path(key), COVER, is_checked=True)

    def put(self, key: tuple[int, ...], cover: Artifact) -> None:
        """See `CoverStore`."""
        manifest = msgspec.structs.replace(cover.manifest, inputs=self._inputs)
        write_artifact(self.path(key), Artifact(manifest, cover.arrays), is_final=False)
        self._checked.add(key)

    def drop(self, key: tuple[int, ...]) -> None:
        """See `CoverStore`."""
        self._checked.discard(key)
        self.path(key).unlink(missing_ok=True)

    def __len__(self) -> int:
        return len([*self._folder.glob(f"*{COVER.suffix}")])


@contextmanager
def covers_kept_in(folder: Path | None, inputs: Sequence[InputRef]) -> Iterator[CoverStore]:
    """Context with a store in a folder, which stays after an interruption or the loss of all workers.

    Args:
        folder: None for a dry run.

    Raises:
        OutputError: the folder cannot be made.
        InterruptedWithAdvice: the command was interrupted, and the folder allows it to continue.
    """
    if folder is None:
        yield CoverStore()
        return
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot write: {error.strerror or error}") from error
    store = FolderStore(folder, inputs)
    try:
        yield store
    except KeyboardInterrupt as interruption:
        if not len(store):
            raise
        raise InterruptedWithAdvice(
            f"the same command continues from {folder.name}, {len(store):,} covers of blocks"
        ) from interruption
    except LinkError as error:
        raise LinkError(f"{error}; the same command continues from {folder.name}") from error
    except Exception:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    finally:
        with suppress(OSError):
            folder.rmdir()  # only when it is empty
