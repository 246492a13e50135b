"""Tensors of a PyTorch checkpoint, read without PyTorch and without running what a pickle may ask for."""

from __future__ import annotations

import io
import pickletools
import struct
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import ArtifactError

_LEGACY = b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19"  # the number that old files begin with, pickled
_PICKLE_LIMIT = 2**21
_STORAGES = {
    "FloatStorage": "f4", "DoubleStorage": "f8", "HalfStorage": "f2", "BFloat16Storage": "",
    "LongStorage": "i8", "IntStorage": "i4", "ShortStorage": "i2", "CharStorage": "i1", "ByteStorage": "u1",
    "BoolStorage": "?", "ComplexFloatStorage": "c8", "ComplexDoubleStorage": "c16", "UntypedStorage": "u1",
}  # fmt: skip
_DICT, _TENSOR, _PARAMETER, _INERT = "dict", "tensor", "parameter", "inert"
# Names that a checkpoint may ask for. None of them is ever looked up: each stands for what is done here.
# The inert ones make values that no Gaussian needs: optimizers' learning rates are NumPy scalars.
_GLOBALS = {
    "collections OrderedDict": _DICT,
    "torch._utils _rebuild_tensor_v2": _TENSOR,
    "torch._utils _rebuild_parameter": _PARAMETER,
    "numpy.core.multiarray scalar": _INERT,
    "numpy._core.multiarray scalar": _INERT,
    "numpy dtype": _INERT,
    "_codecs encode": _INERT,
    "torch device": _INERT,
    "torch Size": _INERT,
}


@dataclass(frozen=True, slots=True)
class _Global:
    """A name that a pickle asked for, and what stands for it."""

    name: str
    does: str


class _Opaque:
    """A value that nothing looks into."""


_MARK = _Opaque()


@dataclass(frozen=True, slots=True)
class _Storage:
    """A run of numbers in a member of the archive."""

    dtype: str
    key: str
    count: int


@dataclass(frozen=True, slots=True)
class Tensor:
    """What the pickle says of a tensor; nothing of it is checked before `Checkpoint.array`."""

    storage: _Storage
    offset: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]


class Checkpoint:
    """A checkpoint: its tree of plain values and tensors.

    Attributes:
        tree: what was saved: dictionaries, lists, tuples, strings, numbers and `Tensor`s.
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
        self.tree = _unpickled(bytes(pickled))

    def _member(self, name: str) -> memoryview:
        full = f"{self._name}/{name}"
        if full not in self._members:
            raise ArtifactError(f"checkpoint: member {full[:100]!r} is missing")
        start, size = self._members[full]
        return self._buffer[start : start + size]

    def array(self, tensor: Tensor, what: str) -> NDArray[Any]:
        """A view of the numbers of a tensor.

        Args:
            tensor: from `tree`.
            what: for messages.

        Raises:
            ArtifactError: it is not of floating-point numbers, or not within its storage.
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
        # More numbers than are stored can only be the same ones again, and parameters never are.
        if count and (tensor.offset < 0 or max(last + 1, count) > storage.count):
            raise ArtifactError(
                f"checkpoint: {what}: shape {sizes} with strides {tensor.strides} from {tensor.offset} "
                f"reaches outside of {storage.count} numbers"
            )
        steps = tuple(stride * dtype.itemsize for stride in tensor.strides)
        offset = tensor.offset * dtype.itemsize if count else 0
        return np.ndarray(sizes, dtype, data, offset, steps) if count else np.empty(sizes, dtype)


def is_checkpoint(head: bytes) -> bool:
    """Whether bytes are the start of a file that PyTorch saved."""
    if head.startswith(_LEGACY):
        return True
    if len(head) < 30 or not head.startswith(b"PK\x03\x04"):
        return False
    name = head[30 : 30 + int.from_bytes(head[26:28], "little")]
    return name.endswith(b"/data.pkl")


class _Reader(io.RawIOBase):
    """A file of the bytes of a buffer, without a copy."""

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
    """Where the members of a ZIP archive begin and how long they are; all of them stored as they are."""
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


def _unpickled(data: bytes) -> Any:
    """Run a pickle on a machine that can only build plain values and `Tensor`s."""
    machine = _Machine()
    try:
        for name, argument in _opcodes(data):
            if name == "STOP":
                return machine.pop()
            machine.step(name, argument)
    # What arguments raise that are cut off, and stacks that do not hold what an opcode needs.
    except (ValueError, IndexError, KeyError, TypeError, struct.error) as error:
        raise ArtifactError(f"checkpoint: data.pkl is damaged: {error}") from error
    raise AssertionError("unreachable: opcodes end with STOP or an error")


def _opcodes(data: bytes) -> Iterator[tuple[str, Any]]:
    """The opcodes of a pickle that are known, with their arguments."""
    at = 0
    while True:
        code = data[at : at + 1]
        at += 1
        if code not in _OPCODES:
            names = {known.code.encode("latin-1"): known.name for known in pickletools.opcodes}
            name = names.get(code, repr(code))
            raise ArtifactError(
                f"checkpoint: data.pkl uses opcode {name}, which is refused" if code
                else "checkpoint: truncated: data.pkl has no end"
            )  # fmt: skip
        name, form = _OPCODES[code]
        argument: Any = None
        if form == "lines":
            ends = [data.index(b"\n", at)]
            ends.append(data.index(b"\n", ends[0] + 1))
            argument = f"{data[at : ends[0]].decode()} {data[ends[0] + 1 : ends[1]].decode()}"
            at = ends[1] + 1
        elif form:
            argument = struct.unpack_from(form.rstrip("*"), data, at)[0]
            at += struct.calcsize(form.rstrip("*"))
        if form.endswith("*"):  # that many bytes follow
            if argument > len(data) - at:
                raise ValueError(f"{argument} bytes are announced, there are {len(data) - at}")
            start, at = at, at + argument
            argument = data[start:at]
            argument = (
                int.from_bytes(argument, "little", signed=True) if name == "LONG1" else argument.decode()
            )
        yield name, argument


_OPCODES = {
    b".": ("STOP", ""), b"(": ("MARK", ""), b"N": ("NONE", ""), b"}": ("EMPTY_DICT", ""),
    b"]": ("EMPTY_LIST", ""), b")": ("EMPTY_TUPLE", ""), b"\x88": ("NEWTRUE", ""), b"\x89": ("NEWFALSE", ""),
    b"t": ("TUPLE", ""), b"\x85": ("TUPLE1", ""), b"\x86": ("TUPLE2", ""), b"\x87": ("TUPLE3", ""),
    b"a": ("APPEND", ""), b"e": ("APPENDS", ""), b"s": ("SETITEM", ""), b"u": ("SETITEMS", ""),
    b"R": ("REDUCE", ""), b"b": ("BUILD", ""), b"Q": ("BINPERSID", ""), b"c": ("GLOBAL", "lines"),
    b"\x80": ("PROTO", "<B"), b"q": ("BINPUT", "<B"), b"r": ("LONG_BINPUT", "<I"),
    b"h": ("BINGET", "<B"), b"j": ("LONG_BINGET", "<I"), b"J": ("BININT", "<i"), b"K": ("BININT1", "<B"),
    b"M": ("BININT2", "<H"), b"G": ("BINFLOAT", ">d"), b"\x8a": ("LONG1", "<B*"),
    b"X": ("BINUNICODE", "<I*"),
}  # fmt: skip


class _Machine:
    """The stack machine of pickles, without its powers.

    It knows the opcodes of protocol 2, which PyTorch writes, that make containers, strings and
    numbers. Names become `_Global`s if they are listed, whatever else they could stand for; calling one
    makes a value defined here. So no code can be named, let alone run. Work and memory are bounded by
    the number of opcodes: keys are plain, so nothing is hashed deeply, and places of the memo are keys
    of a dictionary.
    """

    def __init__(self) -> None:
        self.stack: list[Any] = []
        self.memo: dict[int, Any] = {}

    def pop(self) -> Any:
        """Take the top of the stack, which is not a mark."""
        value = self.stack.pop()
        if value is _MARK:
            raise ValueError("a mark where there must be a value")
        return value

    def pop_to_mark(self) -> list[Any]:
        """Take everything above the last mark, and the mark."""
        at = len(self.stack) - 1
        while self.stack[at] is not _MARK:  # raises IndexError below the bottom
            at -= 1
            if at < 0:
                raise ValueError("no mark")
        values = self.stack[at + 1 :]
        del self.stack[at:]
        return values

    def step(self, name: str, argument: Any) -> None:
        """One opcode."""
        if name in _CONSTANTS:
            self.stack.append(_CONSTANTS[name]())
        elif name in _ARGUMENTS:
            self.stack.append(argument)
        elif name == "PROTO":
            pass
        elif name in ("BINPUT", "LONG_BINPUT"):
            self.memo[argument] = self.pop()
            self.stack.append(self.memo[argument])
        elif name in ("BINGET", "LONG_BINGET"):
            self.stack.append(self.memo[argument])
        elif name in ("TUPLE", "TUPLE1", "TUPLE2", "TUPLE3"):
            values = (
                self.pop_to_mark() if name == "TUPLE" else [self.pop() for _ in range(int(name[-1]))][::-1]
            )
            self.stack.append(tuple(values))
        elif name in ("APPEND", "APPENDS"):
            values = self.pop_to_mark() if name == "APPENDS" else [self.pop()]
            if type(self.stack[-1]) is not list:
                raise ValueError("appending to what is no list")
            self.stack[-1].extend(values)
        elif name in ("SETITEM", "SETITEMS"):
            values = self.pop_to_mark() if name == "SETITEMS" else [self.pop(), self.pop()][::-1]
            self.set_items(values)
        elif name == "GLOBAL":
            self.stack.append(_global(argument))
        elif name == "BINPERSID":
            self.stack.append(_storage(self.pop()))
        elif name == "REDUCE":
            arguments = self.pop()
            self.stack.append(_called(self.pop(), arguments))
        elif name == "BUILD":  # attributes of dictionaries and scalars, such as `_metadata`; not needed
            self.pop()
            if not isinstance(self.stack[-1], dict | _Opaque) or self.stack[-1] is _MARK:
                raise ArtifactError("checkpoint: data.pkl sets the state of an object, which is refused")

    def set_items(self, values: list[Any]) -> None:
        """Put keys and values, by turns, into the dictionary on top."""
        target = self.stack[-1]
        if type(target) is not dict or len(values) % 2:
            raise ValueError("items for what is no dictionary")
        for key, value in zip(values[::2], values[1::2], strict=True):
            if not isinstance(key, str | int | float | None):
                raise ValueError("a key that is neither text nor a number")
            target[key] = value


_CONSTANTS: dict[str, Callable[[], Any]] = {
    "NONE": lambda: None,
    "NEWTRUE": lambda: True,
    "NEWFALSE": lambda: False,
    "EMPTY_DICT": dict,
    "EMPTY_LIST": list,
    "EMPTY_TUPLE": tuple,
    "MARK": lambda: _MARK,
}
_ARGUMENTS = ("BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT", "BINUNICODE")


def _global(argument: str) -> _Global:
    """A name, written as module, space, name.

    Raises:
        ArtifactError: it is not one of those that checkpoints need.
    """
    module, _, name = argument.partition(" ")
    if module in ("torch", "torch.storage") and name in _STORAGES:
        return _Global(name, "storage")
    if argument not in _GLOBALS:
        raise ArtifactError(
            f"checkpoint: data.pkl asks for {argument.replace(' ', '.')[:100]!r}, which no splat needs"
        )
    return _Global(argument, _GLOBALS[argument])


def _storage(pid: Any) -> _Storage:
    match pid:
        case ("storage", _Global(name=name, does="storage"), str(key), str(), int(count)) if count >= 0:
            return _Storage(_STORAGES[name], key, count)
    raise ArtifactError("checkpoint: data.pkl refers to something that is no storage of numbers")


def _called(function: Any, arguments: Any) -> Any:
    """What a listed name makes of its arguments."""
    match function, arguments:
        case _Global(does="dict"), ():
            return {}
        case _Global(does="dict"), ([*pairs],):
            values = [value for pair in pairs for value in _pair(pair)]
            made = _Machine()
            made.stack.append({})
            made.set_items(values)
            return made.stack[0]
        case _Global(does="tensor"), (_Storage() as storage, int(offset), tuple(shape), tuple(strides), *_):
            if all(type(value) is int for value in (offset, *shape, *strides)):
                return Tensor(storage, offset, shape, strides)
        case _Global(does="parameter"), (Tensor() as tensor, *_):
            return tensor
        case _Global(does="inert"), tuple():
            return _Opaque()
    name = function.name if isinstance(function, _Global) else type(function).__name__
    raise ArtifactError(f"checkpoint: data.pkl calls {name.replace(' ', '.')} in a way that is refused")


def _pair(pair: Any) -> tuple[Any, Any]:
    key, value = pair
    return key, value
