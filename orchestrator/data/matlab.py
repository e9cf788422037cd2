"""Reads the variables of MATLAB files: version 7.3 (HDF5, by h5py), versions 5 to 7, version 4 (by SciPy).

A damaged or hostile file is refused in one line. Nothing outside of the file is read, and no memory is taken
for values that are only declared. The reader of version 5 is our own: SciPy's does not check the types of
elements and the depth of structs in its compiled code, so that a flipped bit can end the process.
"""

from __future__ import annotations

import math
import os
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.extras import require
from orchestrator.base.files import ANY_RATIO, MAX_RATIO, Location
from orchestrator.base.processes import FLOAT64

MAX_BYTES = 8 << 30  # of a file or its numbers: 100 signals at 200 Hz for ten hours are 5.8 GB
MAX_VARIABLES = 10_000  # of an HDF5 file, read in some seconds; loggers record some thousand
MAX_SHOWN, MAX_SAID = 40, 120  # characters of a name or a cell, and of what a library says, in a message

# version 5: types of elements, classes of arrays (MAT-File Format, MathWorks, tables 1-1 and 1-3)
NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
TEXTS = {2: "latin-1", 4: "utf-16-{}e", 16: "utf-8", 17: "utf-16-{}e", 18: "utf-32-{}e"}
MATRIX, COMPRESSED = 14, 15
CELL, STRUCT, OBJECT, CHAR, SPARSE, NUMERIC = 1, 2, 3, 4, 5, range(6, 16)
OTHERS = {
    CELL: "a cell array",
    STRUCT: "an array of structs",
    OBJECT: "an object",
    CHAR: "an array of texts",
    SPARSE: "a sparse array",
}
COMPLEX = 0x800
HEADER = 128  # bytes
HDF5 = b"\x89HDF\r\n\x1a\n"  # signature of version 7.3


@dataclass(frozen=True)
class NotNumbers:
    """A variable whose content is not read. what: its kind for a message, such as "a cell array"."""

    what: str


def read_variables(file: Location) -> dict[str, Any]:
    """Arrays and texts by name, scalar structs as dictionaries, anything else as `NotNumbers`."""
    with foreign(file, "a MATLAB"):
        if not file.members and _is_version_7_3(file):
            require("files", f"{file}: a MATLAB file of version 7.3", "h5py")
            import h5py

            with h5py.File(file.path, "r") as opened:
                return _Hdf5(file).group(opened)
        data = file.read(MAX_BYTES)
        if 0 in data[:4]:  # in version 5 a text begins here
            return _version_4(file, data)
        return _version_5(file, data)


def _is_version_7_3(file: Location) -> bool:
    """True if a file has the signature of HDF5 at byte 0, or after a header of 512, 1024, 2048, ... bytes."""
    with file.opened() as opened:
        size, start = opened.seek(0, os.SEEK_END), 0
        while start < size:
            opened.seek(start)
            if opened.read(len(HDF5)) == HDF5:
                return True
            start = max(512, 2 * start)
    return False


def check_size(file: Location, size: int, what: str, packed: float = math.inf) -> None:
    """Refuse what the memory of a computer cannot hold, or much more than is packed, before it is read."""
    if size > (most := min(MAX_BYTES, max(ANY_RATIO, MAX_RATIO * packed))):
        got = f"{what} of {size / 2**30:.3g} GiB"
        raise Problem(f"{file}: expected at most {most / 2**30:.3g} GiB of samples, got {got}")


def shortened(text: str) -> str:
    """The beginning of a name or a cell, for a message."""
    return text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}..."


@contextmanager
def foreign(file: Location | Path, kind: str) -> Iterator[None]:
    """Context in which whatever a library raises for a damaged file is a Problem; kind: such as "an MF4"."""
    try:
        yield
    except Problem:
        raise
    except Exception as error:  # which ones, libraries do not document
        said = shorten(str(error), MAX_SAID, placeholder=" ...")
        cause = f"{type(error).__name__}{said and f': {said}'}"
        raise Problem(f"{file}: expected {kind} file, got a damaged one ({cause})") from None


# ---- version 7.3


@dataclass
class _Hdf5:
    """Reader of an HDF5 file. Nothing outside of the file is read: no links, no external or virtual storage.

    open     addresses of the groups around the variable that is read; damage can make a group contain itself
    arrays   contents by address: a hard link is a second name of the same content
    count    number of the variables that were read
    size     bytes of their numbers in memory
    """

    file: Location
    open: list[int] = field(default_factory=list)
    arrays: dict[int, Any] = field(default_factory=dict)
    count: int = 0
    size: int = 0

    def group(self, group: Any) -> dict[str, Any]:
        """A group (a struct) as a dictionary; links and references (cells) are not followed."""
        import h5py

        address = h5py.h5o.get_info(group.id).addr
        if address in self.open:
            raise Problem(f"{self.file}: {group.name}: expected a struct, got one that contains itself")
        self.open.append(address)
        result: dict[str, Any] = {}
        for name in group:
            if name.startswith("#"):
                continue
            self.count += 1
            if self.count > MAX_VARIABLES:
                raise Problem(f"{self.file}: expected at most {MAX_VARIABLES} variables, got more")
            link = group.get(name, getlink=True)
            if not isinstance(link, h5py.HardLink):
                target = getattr(link, "filename", None) or getattr(link, "path", "?")
                result[name] = NotNumbers(f"a link to {target}")
            elif isinstance(item := group[name], h5py.Group):
                result[name] = self.group(item)
            elif isinstance(item, h5py.Dataset):
                place = h5py.h5o.get_info(item.id).addr
                if place not in self.arrays:
                    self.arrays[place] = self.content(name, item)
                result[name] = self.arrays[place]
        self.open.pop()
        return result

    def content(self, name: str, item: Any) -> Any:
        """The content of a variable: numbers as an array, a text as str."""
        if item.is_virtual or item.external:
            return NotNumbers("values in another file")
        kind = item.attrs.get("MATLAB_class")
        if item.shape is None or np.any(item.attrs.get("MATLAB_empty", 0)):
            return NotNumbers("an empty array")
        text = kind == b"char"
        if item.dtype.kind not in ("u" if text else "fiub"):
            return NotNumbers(f"of type {kind.decode() if isinstance(kind, bytes) else item.dtype}")
        self.size += FLOAT64 * item.size
        check_size(
            self.file, self.size, f"variables up to {shortened(name)!r}", self.file.path.stat().st_size
        )
        values = np.asarray(item).T  # HDF5 has the dimensions in reverse order
        return "".join(map(chr, values.ravel())) if text else values


# ---- versions 4 and 5


def _version_4(file: Location, data: bytes) -> dict[str, Any]:
    require("files", f"{file}: a MATLAB file of version 4", "scipy")
    import scipy.io

    size = sum(FLOAT64 * math.prod(shape) for _, shape, _ in scipy.io.whosmat(BytesIO(data)))
    check_size(file, size, "variables", len(data))
    return {n: v for n, v in scipy.io.loadmat(BytesIO(data)).items() if isinstance(v, np.ndarray)}


def _version_5(file: Location, data: bytes) -> dict[str, Any]:
    order = {b"IM": "<", b"MI": ">"}.get(data[HEADER - 2 : HEADER])
    if order is None:
        raise ValueError("no header of version 5, 7 or 7.3")
    result, size = dict[str, Any](), 0
    for kind, content in _elements(memoryview(data)[HEADER:], order):
        if kind == COMPRESSED:
            most = max(ANY_RATIO, MAX_RATIO * len(data)) - size
            unpacked = zlib.decompressobj().decompress(content, most + 1)
            size += len(unpacked)
            check_size(file, size, "variables", len(data))
            kind, content = _next(_elements(memoryview(unpacked), order))
        if kind == MATRIX:
            name, value = _matrix(content, order)
            if name:  # the workspace of functions has no name
                result[name] = value
    return result


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Type and content of each element; a small element has both in eight bytes."""
    at = 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        start, end = at + 8, at + 8 + size
        at = end if kind == COMPRESSED else end + -size % 8
        if small := kind >> 16:
            kind, size = kind & 0xFFFF, small
            start, end, at = start - 4, start - 4 + size, start
        if end > len(data) or small > 4:
            raise ValueError(f"an element of {size} bytes where {len(data) - start} are left")
        yield kind, data[start:end]


def _next(elements: Iterator[tuple[int, memoryview]]) -> tuple[int, memoryview]:
    for element in elements:
        return element
    raise ValueError("an array without all of its parts")


def _matrix(data: memoryview, order: str) -> tuple[str, Any]:
    """Name and content of an array."""
    if not data:  # an empty field of a struct
        return "", NotNumbers("an empty array")
    parts = _elements(data, order)
    flags = int(_numbers(*_next(parts), order)[0])
    shape = tuple(map(int, _numbers(*_next(parts), order)))
    name = bytes(_next(parts)[1]).decode()
    if flags & 0xFF in NUMERIC:
        values = _numbers(*_next(parts), order).reshape(shape, order="F")
        return name, values.astype(complex) if flags & COMPLEX else values
    if flags & 0xFF == CHAR and shape[0] == 1:
        kind, content = _next(parts)
        return name, bytes(content).decode(TEXTS[kind].format("l" if order == "<" else "b"), "replace")
    if flags & 0xFF == STRUCT and shape == (1, 1):
        length = int(_numbers(*_next(parts), order)[0])
        names = bytes(_next(parts)[1])
        fields = [names[i : i + length].split(b"\0")[0].decode() for i in range(0, len(names), length)]
        contents = [_matrix(content, order)[1] for _, content in parts]
        return name, dict(zip(fields, contents, strict=True))
    return name, NotNumbers(OTHERS.get(flags & 0xFF, "an object"))


def _numbers(kind: int, content: memoryview, order: str) -> NDArray[Any]:
    if kind not in NUMBERS:
        raise ValueError(f"an element of type {kind} where numbers are expected")
    return np.frombuffer(content, f"{order}{NUMBERS[kind]}")
