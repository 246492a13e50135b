"""Tensors of a PyTorch checkpoint, read without PyTorch and without running any code of the pickle."""

from __future__ import annotations

import io
import struct
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import ArtifactError
from alula.stages.reconstruction.formats.torch_pickle import Tensor, unpickled

_LEGACY = b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19"  # the number that old files begin with, pickled
_PICKLE_LIMIT = 2**21


class Checkpoint:
    """A checkpoint: its tree of plain values and tensors.

    Attributes:
        tree: the saved object, made of dictionaries, lists, tuples, strings, numbers and `Tensor`s.
    """

    def __init__(self, buffer: memoryview) -> None:
        self._buffer = buffer
        self._members = _stored_members(buffer)
        pickles = [name for name in self._members if name.endswith("/data.pkl") and name.count("/") == 1]
        if len(pickles) != 1:
            raise ArtifactError(f"checkpoint: {len(pickles)} members NAME/data.pkl, so not a PyTorch archive")
        self._name = pickles[0].partition("/")[0]
        order = self._member("byteorder") if f"{self._name}/byteorder" in self._members else b"little"
        if bytes(order) not in (b"little", b"big"):
            raise ArtifactError(f"checkpoint: byte order {bytes(order[:20])!r} is not known")
        self._order = "<" if bytes(order) == b"little" else ">"
        pickled = self._member("data.pkl")
        if len(pickled) > _PICKLE_LIMIT:
            raise ArtifactError(f"checkpoint: data.pkl has {len(pickled)} bytes; more than {_PICKLE_LIMIT}")
        self.tree = unpickled(bytes(pickled))

    def _member(self, name: str) -> memoryview:
        full = f"{self._name}/{name}"
        if full not in self._members:
            raise ArtifactError(f"checkpoint: member {full[:100]!r} is missing")
        start, size = self._members[full]
        return self._buffer[start : start + size]

    def array(self, tensor: Tensor, what: str) -> NDArray[Any]:
        """View of the numbers of a tensor.

        Raises:
            ArtifactError: the numbers are not floating-point, or not within the tensor's storage.
        """
        storage = tensor.storage
        if storage.dtype not in ("f2", "f4"):
            raise ArtifactError(
                f"checkpoint: {what} is of type {storage.dtype or 'bfloat16'}, not single or half precision"
            )
        data = self._member(f"data/{storage.key}")
        dtype = np.dtype(self._order + storage.dtype)
        if storage.count * dtype.itemsize > len(data):
            raise ArtifactError(
                f"checkpoint: truncated: {what}: {storage.count} numbers of {dtype.itemsize} bytes "
                f"in {len(data)} bytes"
            )
        sizes = tensor.shape
        if len(sizes) != len(tensor.strides) or len(sizes) > 8 or min((*sizes, *tensor.strides, 0)) < 0:
            raise ArtifactError(f"checkpoint: {what}: shape {sizes} with strides {tensor.strides}")
        count = 1
        for size in sizes:
            count *= size
        last = tensor.offset + sum((n - 1) * s for n, s in zip(sizes, tensor.strides, strict=True))
        # More numbers than are stored would have to repeat some, which parameters never do.
        if count and (tensor.offset < 0 or max(last + 1, count) > storage.count):
            raise ArtifactError(
                f"checkpoint: {what}: shape {sizes} with strides {tensor.strides} from {tensor.offset} "
                f"reaches outside of {storage.count} numbers"
            )
        steps = tuple(stride * dtype.itemsize for stride in tensor.strides)
        offset = tensor.offset * dtype.itemsize if count else 0
        return np.ndarray(sizes, dtype, data, offset, steps) if count else np.empty(sizes, dtype)


def is_checkpoint(head: bytes) -> bool:
    """Test whether bytes are the start of a file that PyTorch saved."""
    if head.startswith(_LEGACY):
        return True
    if len(head) < 30 or not head.startswith(b"PK\x03\x04"):
        return False
    name = head[30 : 30 + int.from_bytes(head[26:28], "little")]
    return name.endswith(b"/data.pkl")


class _Reader(io.RawIOBase):
    """File object over the bytes of a buffer, without a copy."""

    def __init__(self, buffer: memoryview) -> None:
        self._buffer = buffer
        self._at = 0

    def seekable(self) -> bool:
        return True

    def readable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        at = offset + (0, self._at, len(self._buffer))[whence]
        if at < 0:
            raise OSError("before the start")
        self._at = at
        return at

    def tell(self) -> int:
        return self._at

    def read(self, size: int = -1) -> bytes:
        end = len(self._buffer) if size is None or size < 0 else self._at + size
        part = bytes(self._buffer[self._at : end])
        self._at += len(part)
        return part


def _stored_members(buffer: memoryview) -> dict[str, tuple[int, int]]:
    """Offsets and lengths of the members of a ZIP archive, which must all be stored uncompressed."""
    if bytes(buffer[: len(_LEGACY)]) == _LEGACY:
        raise ArtifactError(
            "checkpoint: of the format of PyTorch before 1.6, which is not read; load and save it again"
        )
    try:
        with zipfile.ZipFile(_Reader(buffer)) as archive:
            infos = archive.infolist()
    except (zipfile.BadZipFile, OSError, ValueError, EOFError, NotImplementedError, struct.error) as error:
        raise ArtifactError(f"checkpoint: truncated, or not a ZIP archive: {error}") from error
    members: dict[str, tuple[int, int]] = {}
    for info in infos:
        name = info.filename
        if name in members:
            raise ArtifactError(f"checkpoint: member {name[:100]!r} occurs twice")
        if info.compress_type != zipfile.ZIP_STORED or info.flag_bits & 1:
            raise ArtifactError(f"checkpoint: member {name[:100]!r} is compressed; PyTorch stores them plain")
        at = info.header_offset
        local = bytes(buffer[at : at + 30]) if at >= 0 else b""
        if len(local) < 30 or local[:4] != b"PK\x03\x04":
            raise ArtifactError(f"checkpoint: member {name[:100]!r} is not where the directory says")
        start = at + 30 + sum(struct.unpack_from("<2H", local, 26))
        if info.file_size != info.compress_size or start + info.file_size > len(buffer):
            raise ArtifactError(f"checkpoint: truncated: member {name[:100]!r} is not all there")
        members[name] = (start, info.file_size)
    return members
