"""Steps of the valve test: command, mean drop and mean flow of each, and which of them are measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fmus.contract import ModelError
from fmus.identification.procedures.shared.given import filled
from fmus.identification.procedures.shared.step_means import SETTLE, SHORTEST, left_out, step_means
from fmus.identification.recordings.masks import steady
from fmus.identification.recordings.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

OPENS = {"P-A": 1, "B-T": 1, "P-B": -1, "A-T": -1}  # sign of the command, correction E7 in docs/equations.md
VOLTAGES = 3  # that must be measured
SURE = 5.0  # standard errors from which on the sign of a mean is no chance


@dataclass(frozen=True)
class Points:
    """One entry per step; arrays of shape (n,).

    command      magnitude [V]
    drop, flow   means [Pa], [m3/s] with their standard errors; both positive where the edge is open
    whole        drop from supply to tank [Pa]: the largest one over the edge, when it is nearly closed
    dead         the flow meter reads nothing useful
    clipped      an instrument is at an end of its range
    good         measured: neither dead nor clipped, samples there, flow along the drop
    edge         "P-A", ... of each
    """

    command: Array
    drop: Array
    drop_error: Array
    flow: Array
    flow_error: Array
    whole: Array
    dead: Mask
    clipped: Mask
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

    def enough(self) -> Points:
        """The measured steps of each edge, which must be at three voltages or more."""
        for edge in self.edges:
            own = self.of(edge)
            voltages = np.unique(own.measured.command).size
            if voltages < VOLTAGES:
                raise ModelError(
                    f"valve {edge}: flow is measured at {voltages} voltages, expected at least {VOLTAGES}; "
                    f"left out of {own.command.size} steps: {own.left_out or 'none'}"
                )
        return self.measured

    @property
    def left_out(self) -> str:
        """How many steps are not measured and why; empty if all are."""
        return left_out(self.dead, self.clipped, self.good)

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
    """The steps of all edges; only those with a command that opens the edge."""
    each = [_of_one(recording) for recording in recordings]
    return Points(**{name: np.concatenate([vars(one)[name] for one in each]) for name in vars(each[0])})


def _of_one(recording: Recording) -> Points:
    command, opens = filled(recording["command"]), _opens(recording)  # a command holds over a lost sample
    whole = replace(recording, signals={**recording.signals, "command": command})
    parts = [one for one in steady(whole, "command", SETTLE, SHORTEST) if command[one.start] * opens > 0]
    found = step_means(recording, parts)
    sign = np.where(found.drop < 0, -1.0, 1.0)
    along = sign * found.flow
    _check_direction(recording, (along + SURE * found.flow_error)[found.good])
    return Points(
        command=np.abs([command[one].mean() for one in parts]),
        drop=sign * found.drop,
        drop_error=found.drop_error,
        flow=along,
        flow_error=found.flow_error,
        whole=np.full(len(parts), np.max(np.abs(found.drop), initial=0.0, where=np.isfinite(found.drop))),
        dead=found.dead,
        clipped=found.clipped,
        good=found.good & (along > 0),
        edge=np.full(len(parts), recording.word("edge")),
    )


def _opens(recording: Recording) -> int:
    """Sign of the commands that open the edge."""
    edge, command = recording.word("edge"), recording["command"]
    if edge not in OPENS:
        raise ModelError(f"{recording.source}: [experiment] edge is {edge!r}, expected {', '.join(OPENS)}")
    if not (command * OPENS[edge] > 0).any():
        expected = "positive" if OPENS[edge] > 0 else "negative"
        raise ModelError(f"{recording.source}: expected {expected} commands, which open {edge}, found none")
    return OPENS[edge]


def _check_direction(recording: Recording, most: Array) -> None:
    """Refuse a meter that counts against the drop; `most`: the largest flow along it that noise allows."""
    against = int(np.count_nonzero(most < 0))
    if against > most.size / 2:
        raise ModelError(
            f"{recording.source}: flow is against the drop pressure_in - pressure_out in {against} of "
            f"{most.size} steps, expected along it: turn the sign of the flow or the order of the pressures"
        )
