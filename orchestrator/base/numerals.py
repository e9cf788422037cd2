"""Numbers in texts that others have written: cells, attributes, options, one syntax for all.

That of XML Schema. Python would also accept 1_000, digits of other scripts and Infinity.
"""

from __future__ import annotations

import re
from fractions import Fraction
from math import isfinite

_REAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?inf|nan", re.ASCII | re.IGNORECASE)
_INTEGER = re.compile(r"[+-]?\d{1,400}", re.ASCII)  # the largest float has 309 digits
_BOOLEANS = {"true": True, "1": True, "false": False, "0": False}


def real(text: str) -> float:
    """A number, finite or not; ValueError for any other text."""
    if not _REAL.fullmatch(text.strip()):
        raise ValueError(f"expected a number, got {text!r}")
    return float(text)


def finite(text: str) -> float:
    """A finite number; ValueError for any other text."""
    value = real(text)
    if not isfinite(value):
        raise ValueError(f"expected a finite number, got {text!r}")
    return value


def fraction(text: str) -> Fraction:
    """A number exactly as it is written; ValueError for one that is no finite float64."""
    return Fraction(text.strip()) if finite(text) else Fraction(0)  # 1e-999999999 has as many digits


def integer(text: str) -> int:
    """A whole number; ValueError for any other text."""
    if not _INTEGER.fullmatch(text.strip()):
        raise ValueError(f"expected a whole number, got {text!r}")
    return int(text)


def boolean(text: str) -> bool:
    """true, false, 1 or 0; ValueError for any other text."""
    try:
        return _BOOLEANS[text.strip()]
    except KeyError:
        raise ValueError(f"expected true or false, got {text!r}") from None
