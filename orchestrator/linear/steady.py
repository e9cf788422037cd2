"""Steady states: joints held or moving at given speeds, all the rest at rest.

Which states are which is read off the linearised equations and the names, not off the machine:

- a position is a state whose time derivative is another state, its speed, and nothing else;
- a joint is a position with an input whose name begins with the same word: boom_angle and boom_command.
  Its angle is held where it is, its speed is given (default 0), and the input is found;
- a state on which nothing depends, such as oil in a tank, stays where it is and need not be steady.

All other states and the inputs of the joints are found, so that the time derivatives of all states but the
positions of joints are zero. Where that leaves directions free, such as a command in its dead band, they are
where settling left them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from orchestrator.errors import Problem
from orchestrator.linear.newton import Joint
from orchestrator.linear.plant import Matrices, Plant
from orchestrator.linear.search import Search
from orchestrator.units import BASES, Unit

ROUNDED = 12  # digits after the point, of a command in a note
SETTLE = "let a run settle with --time in place of --steady"
METRE, RADIAN = (tuple(int(b == base) for b in BASES) for base in ("m", "rad"))


def steady(plant: Plant, speeds: Mapping[str, float] | None = None) -> tuple[str, ...]:
    """Bring the plant from where it is into a steady state; `speeds` of joints by name. Returns notes."""
    given = speeds or {}
    for name, value in given.items():
        if not math.isfinite(value):
            raise Problem(f"--speed {name}={value}: expected a finite number")
    matrices = plant.matrices()
    joints = _joints(plant, matrices)
    for name in given:
        if name not in joints:
            raise Problem(f"--speed {name}: no such joint, expected {', '.join(joints) or 'none'}")
    idle = [i for i in range(len(plant.x)) if not matrices.a[:, i].any()]
    search = Search(plant, joints.values(), idle)
    if not search.run(given):
        told = ", ".join(f"{plant.states[j.speed]} = {given.get(n, 0.0):g}" for n, j in joints.items())
        worst = search.equations.worst()
        other = "expected slower joints" if any(given.values()) else SETTLE
        raise Problem(f"no steady state found with {told or 'all free'}: {worst} is not at rest; {other}")
    return _told(plant, joints, idle, search.equations.free)


def _joints(plant: Plant, m: Matrices) -> dict[str, Joint]:
    """The joints by the first word of their names."""
    inputs = [inlet.name.rpartition(".")[2] for inlet in plant.choice.inputs]
    found: dict[str, Joint] = {}
    for i, j in _positions(m):
        word = _word(plant.states[i].variable)
        if not _moves(plant.system.variable(plant.states[i]).unit):
            continue
        mine = [k for k, name in enumerate(inputs) if _word(name) == word]
        mine = [k for k in mine if k < plant.choice.asked] or mine  # a named input goes before a usual one
        if not mine:
            continue
        if len(mine) > 1 or word in found:
            names = ", ".join(plant.choice.inputs[k].name for k in mine)
            other = f"{SETTLE}, or name one with --input"
            raise Problem(f"--steady: {plant.states[i]} has more than one input, {names}: {other}")
        found[word] = Joint(word, i, j, mine[0])
    return found


def _positions(m: Matrices) -> Iterator[tuple[int, int]]:
    """States whose time derivative is another state, with that state."""
    for i, row in enumerate(m.a):
        told = np.flatnonzero(row)
        if len(told) == 1 and row[told[0]] == 1.0 and told[0] != i and not m.b[i].any():
            yield i, int(told[0])


def _moves(unit: Unit | None) -> bool:
    """Is this the unit of an angle or a length?"""
    if unit is None or unit.exponents is None:
        return True
    return unit.exponents in (METRE, RADIAN)


def _word(name: str) -> str:
    return name.partition("_")[0]


def _told(plant: Plant, joints: Mapping[str, Joint], idle: list[int], free: int) -> tuple[str, ...]:
    held = [str(plant.states[j.position]) for j in joints.values()]
    rest = [str(plant.states[i]) for i in idle if str(plant.states[i]) not in held]
    notes = [f"held: {', '.join(held)}" if held else "no joint is held: all states were found"]
    notes += [f"nothing depends on these states, they stay: {', '.join(rest)}"] if rest else []
    others = [plant.choice.inputs[j.input] for j in joints.values() if j.input >= plant.choice.asked]
    values = dict(zip((i.name for i in plant.choice.inputs), plant.u.round(ROUNDED), strict=True))
    told = (f"{i.name} = {values[i.name]:.6g} {i.unit.name if i.unit else ''}".rstrip() for i in others)
    notes += [f"found, and constant: {', '.join(told)}"] if others else []
    what = "one direction is" if free == 1 else f"{free} directions are"
    notes += [f"{what} steady anywhere, such as a command in its dead band"] if free else []
    return tuple(notes)
