"""Steps of the valve test: command, mean drop and mean flow of each, and which of them are measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmus.identification.procedures.shared.step_means import SETTLE, SHORTEST, step_means
from fmus.identification.recordings.masks import steady
from fmus.identification.recordings.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Points:
    """One entry per step; arrays of shape (n,).

    command      magnitude [V]
    drop, flow   means [Pa], [m3/s] with their standard errors; both positive where the edge is open
    whole        drop from supply to tank [Pa]: the largest one over the edge, when it is nearly closed
    dead         the flow meter reads nothing useful
    good         measured: neither dead nor clipped
    edge         "P-A", ... of each
    """

    command: Array
    drop: Array
    drop_error: Array
    flow: Array
    flow_error: Array
    whole: Array
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
    command = recording["command"]
    parts = [one for one in steady(recording, "command", SETTLE, SHORTEST) if command[one.start]]
    found = step_means(recording, parts)
    sign = np.where(found.drop < 0, -1.0, 1.0)
    return Points(
        command=np.abs([command[one].mean() for one in parts]),
        drop=sign * found.drop,
        drop_error=found.drop_error,
        flow=sign * found.flow,
        flow_error=found.flow_error,
        whole=np.full(len(parts), np.nanmax(np.abs(found.drop))),
        dead=found.dead,
        good=found.good & (sign * found.flow > 0),
        edge=np.full(len(parts), recording.word("edge")),
    )
