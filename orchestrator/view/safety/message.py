"""What a browser may say about its sticks, and nothing else.

    {"n": 17, "sticks": [lx, ly, rx, ry], "dead_man": true}

n counts up within one connection; deflections are -1 to 1, x to the right, y away from the operator.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from orchestrator.errors import Problem
from orchestrator.view.controls.patterns import Sticks

LONGEST = 256  # bytes; an honest message has about 80
KEYS = {"n", "sticks", "dead_man"}


@dataclass(frozen=True)
class Message:
    """One look at the hands of the driver."""

    number: int
    sticks: Sticks
    dead_man: bool


def parse(raw: str | bytes) -> Message:
    """The message; Problem tells in one line what is wrong with it. Never any other exception."""
    if isinstance(raw, bytes):
        raise Problem(f"message: expected text, found {len(raw)} bytes of binary data")
    # characters are counted before they are encoded: a huge message is not copied
    if len(raw) > LONGEST:
        raise Problem(f"message: expected at most {LONGEST} characters, found {len(raw)}")
    try:
        found = json.loads(raw, parse_constant=_constant)
    except (ValueError, RecursionError) as error:
        raise Problem("message: expected JSON, found something else") from error
    if not isinstance(found, dict) or set(found) != KEYS:
        raise Problem(f"message: expected an object with {', '.join(sorted(KEYS))}, found {_short(found)}")
    return Message(_number(found["n"]), _sticks(found["sticks"]), _switch(found["dead_man"]))


def _constant(word: str) -> float:
    raise ValueError(f"{word} is no JSON")


def _number(found: Any) -> int:
    if type(found) is not int or not 0 <= found < 2**53:
        raise Problem(f"message: n: expected a whole number from 0 to 2^53 - 1, found {_short(found)}")
    return found


def _sticks(found: Any) -> Sticks:
    if not isinstance(found, list) or len(found) != 4:
        raise Problem(f"message: sticks: expected four numbers, found {_short(found)}")
    for value in found:
        # a bool is an int in Python; the comparison is false for what is not a number
        if type(value) not in (int, float) or not -1 <= value <= 1:
            raise Problem(f"message: sticks: expected numbers from -1 to 1, found {_short(value)}")
    return Sticks(*map(float, found))


def _switch(found: Any) -> bool:
    if not isinstance(found, bool):
        raise Problem(f"message: dead_man: expected true or false, found {_short(found)}")
    return found


def _short(found: Any) -> str:
    text = ascii(found)
    return text if len(text) <= 60 else f"{text[:57]}..."
