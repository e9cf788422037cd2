"""Messages of a worker process to its parent, as bytes that hold nothing but data.

FMUs are machine code in the worker, so any byte may come from one of them. The parent therefore unpickles
nothing. It reads frames:

    HEAD    magic, number of the frame, sizes of text and arrays in bytes, CRC-32 of number, sizes and text
    text    JSON: name of the message, and its content, in which {"@": [offset, type, shape]} is an array
    arrays  raw values
    TAIL    the magic backwards, and the number again

Frames are numbered, so a process that an FMU has forked cannot repeat one. Others can only add bytes to a
pipe, not change any, and added bytes move the tail; so the arrays need no checksum, which would take a part
of the time of a run. The parent names the types of the messages that it takes. What does not fit them raises
Garbled.
"""

from __future__ import annotations

import json
import math
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from itertools import repeat
from types import NoneType, UnionType
from typing import Any, BinaryIO, Union, get_args, get_origin, get_type_hints

from orchestrator.base.errors import Problem

HEAD, TAIL = struct.Struct("<4sIIQI"), struct.Struct("<4sI")
MAGIC = b"hvw1"
MOST_TEXT = 1 << 24  # bytes: 64 000 names of 250 characters
MOST_BYTES = 1 << 27  # of arrays: 256 points of 65 000 signals; the parent keeps a few frames at most
ARRAY = "@"
DISCONNECTED = 94  # exit status of a worker: an FMU has closed the connection to the parent


class Garbled(Exception):
    """Bytes that are no message, or no message of the kind that is expected."""


# ---- the worker


def packed(number: int, name: str, content: Any) -> list[bytes | memoryview]:
    """A message as the parts of a frame; content: numbers, texts, lists, mappings, arrays, dataclasses."""
    arrays: list[bytes | memoryview] = []

    def other(value: Any) -> Any:
        """What JSON has no form for."""
        if is_dataclass(value):
            return {f.name: getattr(value, f.name) for f in fields(value) if not f.metadata.get("local")}
        if isinstance(value, Exception | Mapping):
            return dict(value) if isinstance(value, Mapping) else str(value)
        if isinstance(value, bytes):
            kind, shape = "", [len(value)]
        elif not value.shape:  # a number of NumPy
            return value.item()
        else:
            kind, shape, whole = value.dtype.str, value.shape, value.size and value.flags.c_contiguous
            value = memoryview(value).cast("B") if whole else value.tobytes()
        arrays.append(value)
        return {ARRAY: [sum(map(len, arrays[:-1])), kind, shape]}

    text = json.dumps([name, content], default=other).encode()
    size = sum(map(len, arrays))
    if len(text) > MOST_TEXT or size > MOST_BYTES:
        got = f"{len(text) / 1e6:.3g} MB and {size / 1e6:.3g} MB"
        most = f"{MOST_TEXT / 1e6:.3g} MB of texts and {MOST_BYTES / 1e6:.3g} MB of numbers"
        raise Problem(f"{name}: expected at most {most}, got {got}")
    head = HEAD.pack(MAGIC, number, len(text), size, _checksum(number, text, size))
    return [head + text, *arrays, TAIL.pack(MAGIC[::-1], number)]


def _checksum(number: int, text: bytes, size: int) -> int:
    return zlib.crc32(text, zlib.crc32(struct.pack("<IIQ", number, len(text), size)))


# ---- the parent


def read_message(source: BinaryIO, number: int, contents: Callable[[], Mapping[str, Any]]) -> tuple[str, Any]:
    """The next message, whose frame must have this number; contents: returns type of the content by its name.

    Raises EOFError at the end of the bytes, also within a frame, and Garbled for other bytes.
    """
    magic, numbered, size, array_size, checksum = HEAD.unpack(_exactly(source, HEAD.size))
    if magic != MAGIC or numbered != number or size > MOST_TEXT or array_size > MOST_BYTES:
        raise Garbled
    text, arrays = bytes(_exactly(source, size)), _exactly(source, array_size)
    tail = TAIL.unpack(_exactly(source, TAIL.size))
    if tail != (MAGIC[::-1], number) or checksum != _checksum(number, text, array_size):
        raise Garbled
    try:
        name, content = json.loads(text)
        return name, typed(contents()[name], content, arrays)
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise Garbled from error


def _exactly(source: BinaryIO, size: int) -> bytearray:
    """The next bytes, in memory of their own, which arrays can be views of."""
    data = bytearray(size)
    if source.readinto(data) != size:  # type: ignore[attr-defined]  # of a buffered file
        raise EOFError
    return data


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)


def typed(kind: Any, value: Any, arrays: bytearray) -> Any:
    """A value of JSON as a value of a type; raises Garbled, or an error of Python, if it is none.

    Types: the basic ones, tuples, lists, mappings from text, arrays with the type of their values,
    dataclasses, and errors that are made of a text.
    """
    origin, arguments = get_origin(kind), get_args(kind)
    if kind is Any:
        return _plain(value, arrays)
    if origin in (Union, UnionType):  # with None
        (other,) = (argument for argument in arguments if argument is not NoneType)
        return None if value is None else typed(other, value, arrays)
    if origin in (tuple, list, Sequence):
        kinds = repeat(arguments[0], len(value)) if origin is not tuple or ... in arguments else arguments
        items = [typed(k, v, arrays) for k, v in zip(kinds, _of(list, value), strict=True)]
        return tuple(items) if origin is tuple else items
    if origin in (dict, Mapping):
        return {k: typed(arguments[1], v, arrays) for k, v in _of(dict, value).items()}
    if origin is not None:
        return _array(get_args(arguments[1])[0], value, arrays)
    if is_dataclass(kind):
        sent = {f.name: _hints(kind)[f.name] for f in fields(kind) if not f.metadata.get("local")}  # type: ignore[arg-type]
        return kind(**{name: typed(sent[name], v, arrays) for name, v in _of(dict, value).items()})  # type: ignore[operator]
    if issubclass(kind, Exception):
        return kind(_of(str, value))
    return float(value) if kind is float and type(value) is int else _of(kind, value)


def _of(kind: type, value: Any) -> Any:
    if type(value) is not kind:
        raise Garbled
    return value


def _plain(value: Any, arrays: bytearray) -> Any:
    """A value of JSON with the bytes that it contains."""
    if isinstance(value, list):
        return [_plain(v, arrays) for v in value]
    if isinstance(value, dict) and value.keys() == {ARRAY}:
        offset, _, (size,) = value[ARRAY]
        return bytes(arrays[offset : offset + size])
    return {k: _plain(v, arrays) for k, v in value.items()} if isinstance(value, dict) else value


def _array(kind: Any, value: Any, arrays: bytearray) -> Any:
    """The array of a type of NumPy at a place among the bytes of a message."""
    import numpy as np  # by the parent, which has imported NumPy

    dtype = np.dtype(kind)
    offset, name, shape = _of(dict, value)[ARRAY]
    if name != dtype.str or any(type(n) is not int or n < 0 for n in (offset, *shape)):
        raise Garbled
    return np.frombuffer(arrays, dtype, math.prod(shape), offset).reshape(shape)
