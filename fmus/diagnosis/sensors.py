"""Sensors of one function: readings out of range, and readings that stand still.

A reading stands still if it does not leave its lag although another one of the function says that it should,
by more than the resolution of both: angle and speed each other, pressures each other.
"""

from __future__ import annotations

import casadi as ca

from fmus.contract import Quantity, Scalar
from fmus.controller.arm import ControlledAxis
from fmus.diagnosis.axis import MOVES, Axis, Finding, signals_of
from fmus.diagnosis.estimates import Told, counted, either, latched, shown, whether

STILL = (1e-5, 1e-6, 2e3, 2e3)  # rad, rad/s, Pa: distance from its lag at which a reading stands still
LIVELY, STEPS = 5e3, 5  # Pa, and resolutions, from the lag of a pressure that changes
LOADED = 20  # resolutions: a pressure below it may be as even as that of the return line


def findings(axis: ControlledAxis) -> dict[str, Finding]:
    """By the names of the readings, which have that of the axis."""
    return {
        f"{n}_sensor": Finding("1", f"1: the reading of {n} is wrong", 1.0, f"{n} sensor")
        for n in signals_of(axis)
    }


def states(axis: ControlledAxis) -> dict[str, Quantity]:
    """Clocks and latches."""
    found = dict[str, Quantity]()
    for k, n in enumerate(signals_of(axis)):
        found[f"still_{k}"] = Quantity("s", f"Time for which {n} stands still although it should change")
        found[f"bad_{k}"] = Quantity("1", f"1: the reading of {n} is wrong")
    return found


def _stands(a: Axis) -> list[tuple[Scalar, Scalar]]:
    """Of each reading: 1 if it stands still; 1 if another one says that it should not."""
    p, outside = a.p, a.outside
    moves = MOVES + 2 * p.angle_resolution / p.lag
    differ = whether(ca.fabs(a.rate(0) - a.reading(1)) > moves)
    turns = whether(ca.fabs(a.reading(1)) > moves) * (1 - outside[1])
    goes = whether(ca.fabs(a.rate(0)) > moves) * (1 - outside[0])
    changes = [turns * differ, goes * differ]
    lively, least = LIVELY + STEPS * p.pressure_resolution, p.zero_limit + LOADED * p.pressure_resolution
    for k in (2, 3):  # an empty chamber has a constant pressure
        changes.append(whether(ca.fabs(a.behind(5 - k)) > lively) * whether(a.reading(k) > least))
    still = (whether(ca.fabs(a.behind(k)) < width) for k, width in enumerate(STILL))
    return list(zip(still, changes, strict=True))


def rates(a: Axis) -> dict[str, Scalar]:
    """Of clocks and latches."""
    found = dict[str, Scalar]()
    for k, (n, (still, changed), out) in enumerate(
        zip(signals_of(a.axis), _stands(a), a.outside, strict=True)
    ):
        clock, bad = getattr(a, f"still_{k}"), getattr(a, f"bad_{k}")
        found[f"still_{k}"] = counted(clock, still * a.connected, changed)
        longest = a.p.still_motion if k < 2 else a.p.still_time
        wrong = either(out * a.connected, whether(clock > longest)) * getattr(a.p, f"{n}_fitted")
        found[f"bad_{k}"] = latched(bad, wrong, a.u.reset)
    return found


def told(a: Axis) -> dict[str, Told]:
    """Of the latches."""
    return {
        f"{n}_sensor": shown(getattr(a, f"bad_{k}"), getattr(a.p, f"{n}_fitted"))
        for k, n in enumerate(signals_of(a.axis))
    }
