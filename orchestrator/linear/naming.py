"""What a mode is, in words, from the states that take part in it: their names and their units.

Nothing here knows a machine. The unit tells what a state is (a motion, a pressure, a flow), the words of its
name what it belongs to: boom_speed and boom_rod_pressure make "boom on its oil".
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from orchestrator.units import Unit

if TYPE_CHECKING:
    from orchestrator.linear.result import Named

ENOUGH, MANY = 0.8, 4  # states are told until they have this share of a mode, and at most so many
SMALL = 0.04  # a state with less is not told
PART = 0.12  # of a mode that a kind of states has to have, to be in its name
KINDS = {  # exponents of kg, m, s without the radian
    (0, 1, 0): "position",
    (0, 1, -1): "speed",
    (1, -1, -2): "pressure",
    (0, 3, -1): "flow",
    (0, 3, 0): "volume",
}
TURNING = {0: "position", -1: "speed"}  # with the radian: by the exponent of the second
QUANTITIES = {"angle", "flow", "position", "pressure", "speed", "velocity", "volume"}
MOTION = {"position", "speed"}
OIL = {"pressure", "flow"}


def labelled(states: Sequence[Named]) -> list[str]:
    """Names of states without their component, where that is enough."""
    bare = [s.name.rpartition(".")[2] for s in states]
    return [b if bare.count(b) == 1 else s.name for b, s in zip(bare, states, strict=True)]


def name(
    value: complex, share: NDArray[np.float64], labels: Sequence[str], units: Sequence[Unit | None]
) -> tuple[str, tuple[str, ...]]:
    """What a mode is, and the names of the states that make most of it, the largest first."""
    weight = dict[str, float]()
    for part, unit in zip(share, units, strict=True):
        weight[kind(unit)] = weight.get(kind(unit), 0.0) + float(part)
    kinds = {k for k, total in weight.items() if total >= PART}
    main = tuple(labels[i] for i in _told(share))
    return _phrase(value, kinds, main), main


def kind(unit: Unit | None) -> str:
    """What a quantity with this unit is; empty where that is not known."""
    if unit is None or unit.exponents is None:
        return ""
    *base, radian = unit.exponents
    if any(base[3:]):
        return ""
    if radian == 1 and not any(base[:2]):
        return TURNING.get(base[2], "")
    return KINDS.get((base[0], base[1], base[2]), "")


def _told(share: NDArray[np.float64]) -> list[int]:
    """The states to name, the largest first."""
    order, found, total = np.argsort(-share, kind="stable"), list[int](), 0.0
    for i in order[:MANY]:
        if found and (total >= ENOUGH or share[i] < SMALL):
            break
        found.append(int(i))
        total += float(share[i])
    return found


def _phrase(value: complex, kinds: set[str], names: Sequence[str]) -> str:
    """The words before the list of states."""
    what = _subject(names)
    both = " and " in what
    s, its = ("", "their") if both else ("s", "its")
    if value == 0.0:
        how = "where" if kinds & MOTION else "as"
        return f"{what} stay{s} {how} {'they are' if both else 'it is'}"
    if value.real > 0.0:
        return f"{what} swing{s} up" if value.imag else f"{what} drift{s} off"
    moves, oil = bool(kinds & MOTION), kinds & OIL
    if value.imag and moves:
        return f"{what} on {its} oil" if oil else f"{what} swing{s}"
    if value.imag:
        return f"oil of {what} swings" if oil else f"{what} swing{s}"
    if kinds == {"position"}:
        return f"{what} return{s} to {its} place{'s' * both}"
    if moves:
        return f"{what} against {its} oil" if oil else f"{what} come{s} to rest"
    if oil == {"flow"}:
        return f"flow of {what} follows its pressures"
    return f"pressure of {what} settles" if oil else f"{what} settle{s}"


def _subject(names: Sequence[str]) -> str:
    """The words that all names begin with, else the first words, those that stand there most often first.

    boom_rod_pressure and boom_rod_flow are of the boom rod; boom_speed and boom_rod_pressure of the boom.
    """
    common = list[str]()
    for words in zip(*(n.replace(".", "_").split("_") for n in names), strict=False):
        if len(set(words)) > 1 or words[0] in QUANTITIES:
            break
        common.append(words[0])
    if common:
        return " ".join(common)
    first = [n.replace(".", "_").partition("_")[0] for n in names]
    return " and ".join(sorted(dict.fromkeys(first), key=lambda w: (-first.count(w), first.index(w)))[:2])
