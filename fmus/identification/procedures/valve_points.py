"""Steps of the valve test: command, mean drop and mean flow of each, and which of them are measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fmus.identification.procedures.levels import levels
from fmus.identification.recordings.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Points:
    """One entry per step; arrays of shape (n,).

    command      magnitude [V]
    drop, flow   means [Pa], [m3/s] with their standard errors; both positive where the edge is open
    dead         the flow meter reads nothing useful
    good         measured: neither dead nor clipped
    edge         "P-A", ... of each
    """

    command: Array
    drop: Array
    drop_error: Array
    flow: Array
    flow_error: Array
    dead: Mask
    good: Mask
    edge: NDArray[np.str_]

    @property
    def edges(self) -> tuple[str, ...]:
        """The edges, in the order of the recordings."""
        return tuple(dict.fromkeys(map(str, self.edge)))

    def where(self, mask: Mask) -> Points:
        """The steps of a mask."""
        return Points(**{name: array[mask] for name, array in vars(self).items()})

    def of(self, edge: str) -> Points:
        """The steps of one edge."""
        return self.where(self.edge == edge)

    @property
    def measured(self) -> Points:
        """The steps that are measured."""
        return self.where(self.good)

    @property
    def resistance(self) -> Array:
        """C_R [Pa.s2/m6] of each step, eq. (1)."""
        return self.drop / (self.flow * np.abs(self.flow))

    @property
    def resistance_error(self) -> Array:
        """Standard error of C_R: of the drop, and twice that of the flow."""
        relative = np.hypot(self.drop_error / self.drop, 2 * self.flow_error / self.flow)
        return np.abs(self.resistance) * relative


def points(recordings: Sequence[Recording]) -> Points:
    """The steps of all edges; only those with a command."""
    each = [_of_one(recording) for recording in recordings]
    return Points(**{name: np.concatenate([vars(one)[name] for one in each]) for name in vars(each[0])})


def _of_one(recording: Recording) -> Points:
    stretches = [one for one in held(recording["command"], recording.time) if recording["command"][one.start]]
    drop = levels(recording, "pressure_in", stretches) - levels(recording, "pressure_out", stretches)
    flow = levels(recording, "flow", stretches)
    sign = np.where(drop.mean < 0, -1.0, 1.0)
    return Points(
        command=np.abs([recording["command"][one].mean() for one in stretches]),
        drop=sign * drop.mean,
        drop_error=drop.error,
        flow=sign * flow.mean,
        flow_error=flow.error,
        dead=flow.dead,
        good=flow.useful & drop.useful & (sign * flow.mean > 0),
        edge=np.full(len(stretches), recording.word("edge")),
    )


def held(command: Array, time: Array, least: float = 0.5, settle: float = 0.5) -> list[slice]:
    """Stretches [at least `least` s] of a constant command, without the first `settle` share of each."""
    corners = np.flatnonzero(np.diff(command)) + 1
    ends = np.concatenate([[0], corners, [len(command)]])
    whole = [(a, b) for a, b in pairwise(ends) if time[b - 1] - time[a] >= least]
    return [slice(int(a + settle * (b - a)), int(b)) for a, b in whole]
