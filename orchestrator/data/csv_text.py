"""Rows of numbers as text of a CSV file: each the shortest decimal that is read back as the same float64.

C does it, see native/csv_text.c, with the bytes of Python's `repr`, which takes ten times as long.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orchestrator.base import compiler
from orchestrator.base.compiler import host, shared_library
from orchestrator.base.errors import Problem

recipe = partial(compiler.recipe, "csv_text", Path(__file__).parent / "native")  # for a platform
LONGEST = 25  # characters of a value and its comma, such as -2.2250738585072014e-308
POWERS = range(-292, 325)  # of ten, by which float64 values are scaled


def rows_text(rows: NDArray[np.float64]) -> bytes | None:
    """The lines of some rows, shape (rows, columns), each with its end; None without the library."""
    write = _compiled()
    return write(np.ascontiguousarray(rows, np.float64)) if write else None


@cache
def _compiled() -> Callable[[NDArray[np.float64]], bytes] | None:
    try:
        function = ctypes.CDLL(str(shared_library(*recipe(host())))).csv_rows
    except (OSError, Problem):
        return None
    powers = np.array([_power(n) for n in POWERS], np.uint64)
    function.restype, size, pointer = ctypes.c_int64, ctypes.c_int64, ctypes.c_void_p
    function.argtypes = pointer, size, size, pointer, pointer

    def write(rows: NDArray[np.float64]) -> bytes:
        text = np.empty(rows.size * LONGEST, np.uint8)
        length = function(rows.ctypes.data, *rows.shape, powers.ctypes.data, text.ctypes.data)
        return text[:length].tobytes()

    return write


def _power(n: int) -> tuple[int, int]:
    """Lower and upper 64 bits of 10^n, rounded up to 128 significant bits."""
    large = 10 ** abs(n)
    shift = 128 - large.bit_length()  # of 10^n
    if n < 0:  # 2^(bits + 127) / 10^-n has 128 bits
        bits = -(-(1 << (large.bit_length() + 127)) // large)
    else:
        bits = large << shift if shift >= 0 else -(-large >> -shift)
    return bits & (1 << 64) - 1, bits >> 64
