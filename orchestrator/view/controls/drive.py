"""From functions to the driven inputs of a machine.

levers   swing, boom and stick command [V], or the levers of a controller that is not engaged
tip      velocity of the tip in cylinder coordinates [m/s, rad/s], for a controller that is engaged:
         radial = -stick, vertical = boom, swing = swing, so that each hand keeps its direction
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from orchestrator.errors import Problem
from orchestrator.view.controls.patterns import Functions

LEVERS, TIP = "levers", "tip"
ENGAGED = "engaged"
VELOCITIES = ("radial_velocity", "vertical_velocity", "swing_velocity")
LEVER_NAMES = {name: (f"{name}_lever", f"{name}_command") for name in ("swing", "boom", "stick")}


@dataclass(frozen=True)
class Full:
    """What full deflection means: levers [V], tip along the radius and up [m/s], swing [rad/s]. Our choice.

    4 V swing this machine at 0.84 rad/s, as fast as the work cycle does; 6 V would be 1.35 rad/s, and a stop
    either hard or 50 degrees long.
    """

    swing_lever: float = 4.0
    lever: float = 6.0
    tip: float = 1.0
    swing: float = 0.4


def modes(axes: Sequence[str]) -> tuple[str, ...]:
    """The modes in which a machine with these axes can be driven."""
    known = {_tail(name) for name in axes}
    levers = any(names & known for names in map(set, LEVER_NAMES.values()))
    tip = {*VELOCITIES, ENGAGED} <= known
    return (*([LEVERS] if levers else []), *([TIP] if tip else []))


def commands(wanted: Functions, mode: str, axes: Sequence[str], full: Full) -> dict[str, float]:
    """Values of the driven inputs, by axis. An axis that the mode does not need is left out: it rests."""
    if mode not in modes(axes):
        possible = " or ".join(modes(axes)) or "nothing that sticks can drive"
        raise Problem(f"mode: this machine takes {possible}, found {mode}")
    values = _tip(wanted, full) if mode == TIP else _levers(wanted, full)
    return {name: values[_tail(name)] for name in axes if _tail(name) in values}


def left_over(named: Collection[str], axes: Sequence[str], values: Iterable[float]) -> bool:
    """Is an axis still away from rest that a mode does not name? Then another mode has the machine."""
    return any(value != 0 for name, value in zip(axes, values, strict=True) if name not in named)


def _levers(wanted: Functions, full: Full) -> Mapping[str, float]:
    most = {"swing": full.swing_lever, "boom": full.lever, "stick": full.lever}
    return {alias: most[name] * getattr(wanted, name) for name, both in LEVER_NAMES.items() for alias in both}


def _tip(wanted: Functions, full: Full) -> Mapping[str, float]:
    velocity = (0.0 - full.tip * wanted.stick, full.tip * wanted.boom, full.swing * wanted.swing)
    return {ENGAGED: 1.0, **dict(zip(VELOCITIES, velocity, strict=True))}


def _tail(name: str) -> str:
    return name.rpartition(".")[2]
