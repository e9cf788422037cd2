"""Sticks: what a message of a browser says about them, what they mean, and which inputs they drive.

A message, and nothing else:

    {"n": 17, "sticks": [lx, ly, rx, ry], "dead_man": true}

n counts up within one connection; deflections are -1 to 1, x to the right, y away from the operator.
Functions count as the machine does: swing positive to the left, boom positive up, stick positive folds in,
curl closes.

    pattern   left stick: sideways, fore and aft   right stick: sideways, fore and aft
    ISO       swing, stick away and in             curl, boom down and up
    SAE       swing, boom down and up              curl, stick away and in

ISO is the pattern of ISO 10968 and SAE J1177, the excavator's. SAE is that of SAE J1814, the backhoe's: the
hands for boom and stick are exchanged. In both, left swings to the left, and pulling back raises the boom or
draws the stick in. Neither standard is about harvesters. Their makers have patterns of their own, mostly
like ISO, with a rotator instead of the curl and thumb switches for feeding and cutting; this is not one of
them. The model has no rotator and no curl, so that axis does nothing here, and it is shown as such.

A deflection x means the share s of full speed, odd, never falling, continuous, and 1 at full deflection:

    s(x) = sign(x) ((1 - c) u + c u^3),   u = max(0, (|x| - d) / (1 - d))

with the dead zone d, because a worn stick does not come back to zero exactly, and the progression c: 0 is a
straight line, 1 a pure cubic. The form is ours; linear plus cubic is what remote controls call "expo".

Which inputs the functions drive in which mode, and how far, says the machine (`view_description`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from orchestrator.base.errors import Problem, suggest
from orchestrator.view.view_description import DriveMode, FunctionWords


@dataclass(frozen=True)
class StickAxes:
    """Deflections [1], -1 to 1: x to the right, y away from the operator."""

    left_x: float = 0.0
    left_y: float = 0.0
    right_x: float = 0.0
    right_y: float = 0.0


@dataclass(frozen=True)
class CraneFunctions:
    """Shares of full speed [1], -1 to 1: swing to the left, boom up, stick in, curl closed."""

    swing: float = 0.0
    boom: float = 0.0
    stick: float = 0.0
    curl: float = 0.0


@dataclass(frozen=True)
class Pattern:
    """Which stick raises the boom; the other one moves the stick. The rest is the same in both."""

    name: str
    source: str
    boom: str


PATTERNS: Mapping[str, Pattern] = {
    "ISO": Pattern("ISO", "ISO 10968, SAE J1177: excavator", boom="right"),
    "SAE": Pattern("SAE", "SAE J1814: backhoe", boom="left"),
}


def pattern(name: str) -> Pattern:
    """The pattern of this name; Problem if there is none."""
    if name not in PATTERNS:
        raise Problem(f"pattern: expected {' or '.join(PATTERNS)}, found {name}{suggest(name, PATTERNS)}")
    return PATTERNS[name]


def functions(sticks: StickAxes, chosen: Pattern, curve: ResponseCurve) -> CraneFunctions:
    """What the deflections mean. The curve comes first, so that it is the same for each function."""
    left, right = shaped(sticks.left_y, curve), shaped(sticks.right_y, curve)
    boom, stick = (right, left) if chosen.boom == "right" else (left, right)
    return CraneFunctions(  # 0 - x is no -0
        swing=0.0 - shaped(sticks.left_x, curve),
        boom=0.0 - boom,
        stick=0.0 - stick,
        curl=0.0 - shaped(sticks.right_x, curve),
    )


def legend(chosen: Pattern, words: FunctionWords) -> dict[str, str]:
    """What each end of each axis does, for the page: `left_up`, `left_down`, ... -> words."""
    boom, stick = (dict(zip(("down", "up"), ends, strict=True)) for ends in (words.boom, words.stick))
    hands = {chosen.boom: boom, "left" if chosen.boom == "right" else "right": stick}
    return {
        "left_left": "swing left",
        "left_right": "swing right",
        "right_left": "(no curl)",
        "right_right": "(no curl)",
        **{f"{hand}_{end}": words for hand, ends in hands.items() for end, words in ends.items()},
    }


@dataclass(frozen=True)
class ResponseCurve:
    """Dead zone and progression [1] of all four axes."""

    dead_zone: float = 0.08
    progression: float = 0.6

    def __post_init__(self) -> None:
        if not 0 <= self.dead_zone < 1:
            raise Problem(f"curve: expected a dead zone from 0 to below 1, found {self.dead_zone}")
        if not 0 <= self.progression <= 1:
            raise Problem(f"curve: expected a progression from 0 to 1, found {self.progression}")


def shaped(deflection: float, curve: ResponseCurve) -> float:
    """Share of full speed [1], -1 to 1, that a deflection means; beyond the stop is the stop."""
    beyond = (min(abs(deflection), 1.0) - curve.dead_zone) / (1 - curve.dead_zone)
    if not beyond > 0:  # also where the deflection is not a number
        return 0.0
    return math.copysign((1 - curve.progression) * beyond + curve.progression * beyond**3, deflection)


LONGEST = 256  # bytes; an honest message has about 80
KEYS = {"n", "sticks", "dead_man"}


@dataclass(frozen=True)
class Message:
    """The sticks at one instant."""

    number: int
    sticks: StickAxes
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


def _sticks(found: Any) -> StickAxes:
    if not isinstance(found, list) or len(found) != 4:
        raise Problem(f"message: sticks: expected four numbers, found {_short(found)}")
    for value in found:
        # a bool is an int in Python; the comparison is false for what is not a number
        if type(value) not in (int, float) or not -1 <= value <= 1:
            raise Problem(f"message: sticks: expected numbers from -1 to 1, found {_short(value)}")
    return StickAxes(*map(float, found))


def _switch(found: Any) -> bool:
    if not isinstance(found, bool):
        raise Problem(f"message: dead_man: expected true or false, found {_short(found)}")
    return found


def _short(found: Any) -> str:
    text = ascii(found)
    return text if len(text) <= 60 else f"{text[:57]}..."


def modes(known: Mapping[str, DriveMode], axes: Sequence[str]) -> tuple[str, ...]:
    """The modes in which a machine with these axes can be driven."""
    inputs = {_bare(name) for name in axes}
    return tuple(name for name, mode in known.items() if mode.drives(inputs))


def commands(wanted: CraneFunctions, mode: DriveMode, axes: Sequence[str]) -> dict[str, float]:
    """Values of the driven inputs, by axis. An axis that the mode does not need is left out: it rests."""
    values = dict(mode.constant)
    for function, driven in vars(mode.full).items():
        values |= {name: full * getattr(wanted, function) + 0.0 for name, full in driven.items()}  # no -0
    return {name: values[_bare(name)] for name in axes if _bare(name) in values}


def left_over(named: Collection[str], axes: Sequence[str], values: Iterable[float]) -> bool:
    """Is an axis still away from rest that a mode does not name? Then another mode has the machine."""
    return any(value != 0 for name, value in zip(axes, values, strict=True) if name not in named)


def _bare(name: str) -> str:
    return name.rpartition(".")[2]
