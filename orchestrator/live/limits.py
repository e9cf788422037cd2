"""What an axis may do: never beyond its limit, never faster than its rate, to rest not before its time."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

import numpy as np

from orchestrator.errors import Problem
from orchestrator.live.setup import Array, Axis, Setup


class Limits:
    """The axes of a machine and how far they move in one frame.

    rest   where they go when nobody commands, shape (axes,)
    """

    def __init__(self, axes: Sequence[Axis], frame: float) -> None:
        """frame: [s]"""
        self.rest = np.array([axis.rest for axis in axes], dtype=np.float64)
        self._limit = np.array([axis.limit for axis in axes], dtype=np.float64)
        self._reach = frame * np.array([axis.rate for axis in axes], dtype=np.float64)

    def toward(self, now: Array, wanted: Array) -> Array:
        """One frame from `now` in the direction of `wanted`; what is no number is taken as rest."""
        sane = np.where(np.isnan(wanted), self.rest, wanted)
        move = np.clip(np.clip(sane, -self._limit, self._limit) - now, -self._reach, self._reach)
        return np.clip(now + move, -self._limit, self._limit)


class Linger:
    """Keeps axes where they are until rest has been wanted of them for their `linger`."""

    def __init__(self, axes: Sequence[Axis], frame: float) -> None:
        """frame: [s]"""
        self._rest = np.array([axis.rest for axis in axes], dtype=np.float64)
        self._frames = np.array([round(axis.linger / frame) for axis in axes])
        self._left = np.zeros_like(self._frames)

    def outlast(self, now: Array, wanted: Array) -> Array:
        """What is wanted of this frame; to be called once in each. What is no number is rest."""
        resting = np.isnan(wanted) | (wanted == self._rest)
        self._left = np.where(resting, np.maximum(self._left - 1, -1), self._frames)
        return np.where(resting & (self._left >= 0), now, wanted)


def check(setup: Setup) -> None:
    """Refuse a setup that is wrong for any machine."""
    for name, value in (("frame", setup.frame), ("patience", setup.patience)):
        if not (isfinite(value) and value > 0):
            raise Problem(f"{name}: expected a positive time, got {value:g} s")
    for what, names in (("axis", [a.name for a in setup.axes]), ("signal", list(setup.signals))):
        if twice := [n for i, n in enumerate(names) if n in names[:i]]:
            raise Problem(f"{what} {twice[0]}: expected it once, got it twice")
    for axis in setup.axes:
        _check(axis)


def _check(axis: Axis) -> None:
    """Refuse an axis that cannot move, that rests beyond its limit, or never."""
    for name, value in (("limit", axis.limit), ("rate", axis.rate)):
        if not (isfinite(value) and value > 0):
            raise Problem(f"axis {axis.name}: expected a positive {name}, got {value:g}")
    if not (isfinite(axis.linger) and axis.linger >= 0):
        raise Problem(f"axis {axis.name}: expected a linger of 0 s or more, got {axis.linger:g} s")
    if not abs(axis.rest) <= axis.limit:
        raise Problem(f"axis {axis.name}: expected a rest within {axis.limit:g}, got {axis.rest:g}")
