"""The machine that is shown now: live, or a replay in its place, under one name for whoever holds it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from orchestrator.files.trace import Trace
from orchestrator.live.setup import Array, Frame, Machine, Setup


class Current:
    """A `Machine` that hands everything on to another one, which may be exchanged.

    factor      the speed that was asked for last, of whichever machine
    exchanges   counts the exchanges: frames of before have nothing to do with those of after
    """

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self.exchanges, self.factor = 0, 1.0

    def exchange(self, machine: Machine) -> None:
        """Show another machine from now on; the one before stands still."""
        if self.machine.drives:
            self.machine.command({})
        self.machine.pause()
        machine.speed(self.factor)
        self.machine = machine
        self.exchanges += 1

    @property
    def axes(self) -> Sequence[str]:
        return self.machine.axes

    @property
    def signals(self) -> Sequence[str]:
        return self.machine.signals

    @property
    def units(self) -> Mapping[str, str]:
        return self.machine.units

    @property
    def drives(self) -> bool:
        return self.machine.drives

    def command(self, values: Mapping[str, float]) -> None:
        self.machine.command(values)

    def play(self) -> None:
        self.machine.play()

    def pause(self) -> None:
        self.machine.pause()

    def speed(self, factor: float) -> None:
        self.machine.speed(factor)
        self.factor = factor

    def restart(self, setup: Setup | None = None) -> None:
        self.machine.restart(setup)
        self.exchanges += 1

    def latest(self) -> Frame:
        return self.machine.latest()

    def since(self, number: int) -> tuple[NDArray[np.int64], Array, Array, Array]:
        return self.machine.since(number)

    def trace(self) -> Trace:
        return self.machine.trace()

    def close(self) -> None:
        self.machine.close()
