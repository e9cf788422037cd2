"""Sticks: the message of a browser, control patterns, response curve, and the inputs that they drive.

A message has exactly this form:

    {"n": 17, "sticks": [lx, ly, rx, ry], "dead_man": true}

n counts up within one connection. Deflections are -1 to 1: x to the right, y away from the operator.
Positive functions: swing to the left, boom up, stick in, curl closed.

    pattern   left stick: sideways, fore and aft   right stick: sideways, fore and aft
    ISO       swing, stick away and in             curl, boom down and up
    SAE       swing, boom down and up              curl, stick away and in

ISO is the excavator pattern of ISO 10968 and SAE J1177. SAE is the backhoe pattern of SAE J1814, in which the
hands for boom and stick are exchanged. In both, left swings to the left, and pulling back raises the boom or
draws the stick in. Neither standard covers harvesters. Their makers use patterns of their own, mostly like
ISO, with a rotator instead of the curl and thumb switches for feeding and cutting. The harvester has no
rotator and no curl, so that axis has no function there, and the page shows so.

The response curve s(x) is the fraction of full speed at deflection x. It is odd, monotone, continuous, and 1
at full deflection:

    s(x) = sign(x) ((1 - c) u + c u^3),   u = max(0, (|x| - d) / (1 - d))

d is the dead zone, because a worn stick does not return to zero exactly. c is the progression: 0 is linear,
1 purely cubic. Remote controls call a linear plus cubic curve "expo".

The machine declares the inputs that the functions drive in each mode (`view_description`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from orchestrator.base.errors import Problem, suggest
from orchestrator.drive.view_description import DriveMode, FunctionLabels


@dataclass(frozen=True)
class StickAxes:
    """Deflections [1], -1 to 1: x to the right, y away from the operator."""

    left_x: float = 0.0
    left_y: float = 0.0
    right_x: float = 0.0
    right_y: float = 0.0


@dataclass(frozen=True)
class CraneFunctions:
    """Fractions of full speed [1], -1 to 1: swing to the left, boom up, stick in, curl closed."""

    swing: float = 0.0
    boom: float = 0.0
    stick: float = 0.0
    curl: float = 0.0


@dataclass(frozen=True)
class Pattern:
    """A control pattern. boom: the hand whose stick moves the boom; the other one moves the stick."""

    name: str
    source: str
    boom: str


PATTERNS: Mapping[str, Pattern] = {
    "ISO": Pattern("ISO", "ISO 10968, SAE J1177: excavator", boom="right"),
    "SAE": Pattern("SAE", "SAE J1814: backhoe", boom="left"),
}


def pattern(name: str) -> Pattern:
    """The pattern of this name. Raises `Problem` if there is none."""
    if name not in PATTERNS:
        raise Problem(f"pattern: expected {' or '.join(PATTERNS)}, found {name}{suggest(name, PATTERNS)}")
    return PATTERNS[name]


def functions(sticks: StickAxes, chosen: Pattern, curve: ResponseCurve) -> CraneFunctions:
    """Crane functions at these deflections. The response curve is the same for each function."""
    left, right = response(sticks.left_y, curve), response(sticks.right_y, curve)
    boom, stick = (right, left) if chosen.boom == "right" else (left, right)
    swing, curl = response(sticks.left_x, curve), response(sticks.right_x, curve)
    return CraneFunctions(0.0 - swing, 0.0 - boom, 0.0 - stick, 0.0 - curl)  # 0 - x avoids -0


def legend(chosen: Pattern, words: FunctionLabels, has_curl: bool) -> dict[str, str]:
    """Labels of both ends of each stick axis: `left_up`, `left_down`, ... -> label."""
    boom, stick = (dict(zip(("down", "up"), ends, strict=True)) for ends in (words.boom, words.stick))
    hands = {chosen.boom: boom, "left" if chosen.boom == "right" else "right": stick}
    closed, opened = ("curl closed", "curl open") if has_curl else ("(no curl)", "(no curl)")
    sideways = {"left_left": "swing left", "left_right": "swing right"}
    sideways |= {"right_left": closed, "right_right": opened}
    return sideways | {f"{hand}_{end}": text for hand, ends in hands.items() for end, text in ends.items()}


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


def response(deflection: float, curve: ResponseCurve) -> float:
    """Fraction of full speed [1], -1 to 1, at a deflection, which is clipped to -1 to 1."""
    beyond = (min(abs(deflection), 1.0) - curve.dead_zone) / (1 - curve.dead_zone)
    if not beyond > 0:  # also if the deflection is NaN
        return 0.0
    return math.copysign((1 - curve.progression) * beyond + curve.progression * beyond**3, deflection)


LONGEST = 256  # characters; an ordinary message has about 80
KEYS = {"n", "sticks", "dead_man"}


@dataclass(frozen=True)
class Message:
    """The sticks at one instant."""

    number: int
    sticks: StickAxes
    dead_man: bool


def parse(raw: str | bytes) -> Message:
    """Parse a message. Raises `Problem`, and no other exception, for an invalid one."""
    if isinstance(raw, bytes):
        raise Problem(f"message: expected text, found {len(raw)} bytes of binary data")
    # checked before parsing, so that a huge message is not copied
    if len(raw) > LONGEST:
        raise Problem(f"message: expected at most {LONGEST} characters, found {len(raw)}")
    try:
        data = json.loads(raw, parse_constant=_constant)
    except (ValueError, RecursionError) as error:
        raise Problem("message: expected JSON, found something else") from error
    if not isinstance(data, dict) or set(data) != KEYS:
        raise Problem(f"message: expected an object with {', '.join(sorted(KEYS))}, found {_short(data)}")
    number, dead_man = data["n"], data["dead_man"]
    if type(number) is not int or not 0 <= number < 2**53:
        raise Problem(f"message: n: expected a whole number from 0 to 2^53 - 1, found {_short(number)}")
    if not isinstance(dead_man, bool):
        raise Problem(f"message: dead_man: expected true or false, found {_short(dead_man)}")
    return Message(number, _sticks(data["sticks"]), dead_man)


def _constant(word: str) -> float:
    raise ValueError(f"{word} is not JSON")


def _sticks(value: Any) -> StickAxes:
    if not isinstance(value, list) or len(value) != 4:
        raise Problem(f"message: sticks: expected four numbers, found {_short(value)}")
    for deflection in value:
        # a bool is an int in Python; the comparison is False for NaN
        if type(deflection) not in (int, float) or not -1 <= deflection <= 1:
            raise Problem(f"message: sticks: expected numbers from -1 to 1, found {_short(deflection)}")
    return StickAxes(*map(float, value))


def _short(value: Any) -> str:
    text = ascii(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


NO_LOADS: Mapping[str, float] = MappingProxyType({})


def modes(declared: Mapping[str, DriveMode], axes: Sequence[str]) -> tuple[str, ...]:
    """Names of the modes in which a machine with these axes can be driven."""
    inputs = {_bare(name) for name in axes}
    return tuple(name for name, mode in declared.items() if mode.drives(inputs))


def commands(
    commanded: CraneFunctions, mode: DriveMode, axes: Sequence[str], loads: Mapping[str, float] = NO_LOADS
) -> dict[str, float]:
    """Values of the driven inputs, by axis. Axes that the mode does not use are left out, so they rest.

    loads   input -> value, of inputs that no stick drives
    """
    values = {**mode.constant, **loads}
    for function, driven in vars(mode.full).items():
        values |= {name: full * getattr(commanded, function) + 0.0 for name, full in driven.items()}  # no -0
    return {name: values[_bare(name)] for name in axes if _bare(name) in values}


def uncommanded(commanded: Collection[str], axes: Sequence[str], values: Iterable[float]) -> bool:
    """Is an axis without a command still away from zero? Then the previous mode has not come to rest."""
    return any(value != 0 for name, value in zip(axes, values, strict=True) if name not in commanded)


def _bare(name: str) -> str:
    return name.rpartition(".")[2]
