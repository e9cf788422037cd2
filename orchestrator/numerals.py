"""Numbers and truth values as XML Schema writes them.

Python reads more than that: 1_000, digits of other scripts, Infinity. What another tool would read otherwise,
or not at all, is refused here.
"""

from __future__ import annotations

import re
from math import isfinite

_REAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?inf|nan", re.ASCII | re.IGNORECASE)
_WHOLE = re.compile(r"[+-]?\d{1,400}", re.ASCII)  # no more digits than a float has room for
_TRUTH = {"true": True, "1": True, "false": False, "0": False}


def real(text: str) -> float:
    """A number, also one that is not finite; ValueError for any other text."""
    if not _REAL.fullmatch(text.strip()):
        raise ValueError(text)
    return float(text)


def finite(text: str) -> float:
    """A finite number; ValueError for any other text."""
    value = real(text)
    if not isfinite(value):
        raise ValueError(text)
    return value


def whole(text: str) -> int:
    """A whole number; ValueError for any other text."""
    if not _WHOLE.fullmatch(text.strip()):
        raise ValueError(text)
    return int(text)


def truth(text: str) -> bool:
    """true, false, 1 or 0; ValueError for any other text."""
    try:
        return _TRUTH[text.strip()]
    except KeyError:
        raise ValueError(text) from None
