"""Sticks and thumb wheels: the message of a browser, response curve, functions, and the inputs they drive.

A message has exactly this form:

    {"n": 17, "sticks": [lx, ly, rx, ry, wheel 1, ...], "dead_man": true}

n counts up within one connection. Deflections are -1 to 1: x and wheels to the right, y away from the
operator. Wheels that are missing are at rest.

The machine declares which function each axis has in each control pattern, and the inputs that the functions
drive in each mode (`view_description`). A function is positive to the left and towards the operator.

The response curve s(x) is the fraction of full speed at deflection x. It is odd, monotone, continuous, and 1
at full deflection:

    s(x) = sign(x) ((1 - c) u + c u^3),   u = max(0, (|x| - d) / (1 - d))

d is the dead zone, because a worn stick does not return to zero exactly. c is the progression: 0 is linear,
1 purely cubic. Remote controls call a linear plus cubic curve "expo".
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from orchestrator.base.signals import bare_name
from orchestrator.drive.view_description import MOST_WHEELS, DriveMode, Pattern

CURVE: Mapping[str, float] = MappingProxyType({"dead_zone": 0.08, "progression": 0.6})  # [1], of all axes


@dataclass(frozen=True)
class StickAxes:
    """Deflections [1], -1 to 1: x and wheels to the right, y away from the operator."""

    left_x: float = 0.0
    left_y: float = 0.0
    right_x: float = 0.0
    right_y: float = 0.0
    wheels: tuple[float, ...] = ()


def functions(sticks: StickAxes, chosen: Pattern) -> dict[str, float]:
    """Functions at these deflections, -1 to 1: fractions of full speed."""
    deflections = (sticks.left_x, sticks.left_y, sticks.right_x, sticks.right_y, *sticks.wheels)
    pairs = zip(chosen.functions, itertools.chain(deflections, itertools.repeat(0.0)), strict=False)
    return {name: 0.0 - response(x) for name, x in pairs}  # no -0


def legend(chosen: Pattern, words: Mapping[str, Sequence[str]], mode: DriveMode) -> dict[str, str]:
    """Labels of both ends of each axis: `left_up`, `left_down`, ..., `wheel1_left`, ... -> label.

    A function that the machine lacks has none.
    """
    labels, ends_of = dict[str, str](), (("left", "right"), ("down", "up"))
    wheels = ((f"wheel{k}", (name,)) for k, name in enumerate(chosen.wheels, 1))
    for hand, driven in (("left", chosen.left), ("right", chosen.right), *wheels):
        for function, ends in zip(driven, ends_of, strict=False):
            texts = {**words, **mode.words}[function] if mode.full.get(function) else ("", "")
            labels |= {f"{hand}_{end}": text for end, text in zip(ends, texts, strict=True)}
    return labels


def response(deflection: float) -> float:
    """Fraction of full speed [1], -1 to 1, at a deflection, which is clipped to -1 to 1."""
    dead_zone, progression = CURVE["dead_zone"], CURVE["progression"]
    beyond = (min(abs(deflection), 1.0) - dead_zone) / (1 - dead_zone)
    if not beyond > 0:  # also if the deflection is NaN
        return 0.0
    return math.copysign((1 - progression) * beyond + progression * beyond**3, deflection)


LONGEST = 256  # characters; a message has about 80, with all wheels 220
KEYS = {"n", "sticks", "dead_man"}


@dataclass(frozen=True)
class Message:
    """The sticks at one instant."""

    number: int
    sticks: StickAxes
    dead_man: bool


def parse(raw: str | bytes) -> Message | None:
    """The message in a text; None for anything else."""
    if isinstance(raw, bytes) or len(raw) > LONGEST:  # before parsing, so that a huge message is not copied
        return None
    try:
        data = json.loads(raw)
    except (ValueError, RecursionError):
        return None
    if not isinstance(data, dict) or set(data) != KEYS:
        return None
    number, axes, dead_man = data["n"], data["sticks"], data["dead_man"]
    if type(number) is not int or not 0 <= number < 2**53 or not isinstance(dead_man, bool):
        return None
    if not isinstance(axes, list) or not 4 <= len(axes) <= 4 + MOST_WHEELS:
        return None
    # a bool is an int in Python; the comparison is False for NaN
    if not all(type(x) in (int, float) and -1 <= x <= 1 for x in axes):
        return None
    left_x, left_y, right_x, right_y, *wheels = map(float, axes)
    return Message(number, StickAxes(left_x, left_y, right_x, right_y, tuple(wheels)), dead_man)


NO_LOADS: Mapping[str, float] = MappingProxyType({})


def modes(declared: Mapping[str, DriveMode], axes: Sequence[str]) -> tuple[str, ...]:
    """Names of the modes in which a machine with these axes can be driven."""
    inputs = {bare_name(name) for name in axes}
    return tuple(name for name, mode in declared.items() if mode.drives(inputs))


def commands(
    commanded: Mapping[str, float],
    mode: DriveMode,
    axes: Sequence[str],
    loads: Mapping[str, float] = NO_LOADS,
) -> dict[str, float]:
    """Values of the driven inputs, by axis. Axes that the mode does not use are left out, so they rest.

    loads   input -> value, of inputs that no stick drives
    """
    values = {**mode.constant, **loads}
    for function, driven in mode.full.items():
        share = commanded.get(function, 0.0)
        values |= {name: full * share + 0.0 for name, full in driven.items()}  # no -0
    return {name: values[bare_name(name)] for name in axes if bare_name(name) in values}


def uncommanded(
    commanded: Collection[str], axes: Sequence[str], values: Iterable[float], declared: Iterable[DriveMode]
) -> bool:
    """Is an axis of another mode still away from zero? Then the previous mode has not come to rest."""
    driven = {name for mode in declared for part in (mode.constant, *mode.full.values()) for name in part}
    others = ((name, value) for name, value in zip(axes, values, strict=True) if name not in commanded)
    return any(value != 0 and bare_name(name) in driven for name, value in others)
