"""Reader of PyTorch's pickles that can only make plain values and descriptions of tensors."""

from __future__ import annotations

import pickletools
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from alula.schemas.errors import ArtifactError

_STORAGES = {
    "FloatStorage": "f4", "DoubleStorage": "f8", "HalfStorage": "f2", "BFloat16Storage": "",
    "LongStorage": "i8", "IntStorage": "i4", "ShortStorage": "i2", "CharStorage": "i1", "ByteStorage": "u1",
    "BoolStorage": "?", "ComplexFloatStorage": "c8", "ComplexDoubleStorage": "c16", "UntypedStorage": "u1",
}  # fmt: skip
_DICT, _TENSOR, _PARAMETER, _INERT = "dict", "tensor", "parameter", "inert"
# Names that a checkpoint may use. None of them is ever imported: this module implements each of them.
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
    """A name that a pickle uses, and its implementation here."""

    name: str
    does: str


class _Opaque:
    """A value that is never read."""


_MARK = _Opaque()


@dataclass(frozen=True, slots=True)
class Storage:
    """A run of numbers in a member of the archive."""

    dtype: str
    key: str
    count: int


@dataclass(frozen=True, slots=True)
class Tensor:
    """Description of a tensor in a pickle; `Checkpoint.array` checks it."""

    storage: Storage
    offset: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]


def unpickled(data: bytes) -> Any:
    """Read the object of a pickle: dictionaries, lists, tuples, text, numbers and `Tensor`s.

    Raises:
        ArtifactError: the pickle is damaged, or uses anything else; the message names it.
    """
    machine = _Machine()
    try:
        for name, argument in _opcodes(data):
            if name == "STOP":
                return machine.pop()
            machine.step(name, argument)
    # These come from truncated arguments, and from stacks that lack what an opcode needs.
    except (ValueError, IndexError, KeyError, TypeError, struct.error) as error:
        raise ArtifactError(f"checkpoint: data.pkl is damaged: {error}") from error
    raise AssertionError("unreachable: opcodes end with STOP or an error")


def _opcodes(data: bytes) -> Iterator[tuple[str, Any]]:
    """Known opcodes of a pickle, with their arguments."""
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
    """Restricted stack machine of pickles.

    It implements the opcodes of protocol 2, which PyTorch writes, that make containers, strings and
    numbers. Only listed names are accepted; they become `_Global`s, and calling one makes a value defined
    here. So a pickle cannot run code. The number of opcodes bounds work and memory: keys are plain values,
    so nothing is hashed deeply, and the memo is a dictionary.
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
        """Execute one opcode."""
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


def _storage(pid: Any) -> Storage:
    match pid:
        case ("storage", _Global(name=name, does="storage"), str(key), str(), int(count)) if count >= 0:
            return Storage(_STORAGES[name], key, count)
    raise ArtifactError("checkpoint: data.pkl refers to something that is no storage of numbers")


def _called(function: Any, arguments: Any) -> Any:
    """Result of calling a listed name with arguments."""
    match function, arguments:
        case _Global(does="dict"), ():
            return {}
        case _Global(does="dict"), ([*pairs],):
            values = [value for pair in pairs for value in _pair(pair)]
            made = _Machine()
            made.stack.append({})
            made.set_items(values)
            return made.stack[0]
        case _Global(does="tensor"), (Storage() as storage, int(offset), tuple(shape), tuple(strides), *_):
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
