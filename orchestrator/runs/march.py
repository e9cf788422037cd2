"""From communication point to communication point: the reference for native/march.c, which does it in C."""

from __future__ import annotations

from contextlib import suppress

from orchestrator.coupling.grid import Grid
from orchestrator.coupling.network import Network
from orchestrator.coupling.sweep import Sweep
from orchestrator.runs import native
from orchestrator.runs.energy import Monitor
from orchestrator.runs.recorder import BLOCK, Recorder


class March:
    """A run in progress.

    t        the communication point that is reached [s]
    done     how many steps of the grid are done
    steps    communication steps that were taken
    passes   passes over all components, of all steps
    """

    def __init__(
        self, network: Network, sweep: Sweep, times: Grid, recorder: Recorder, monitor: Monitor
    ) -> None:
        self._network, self._sweep, self._times = network, sweep, times
        self._recorder, self._monitor = recorder, monitor
        self.t = times.start
        self.done = self.steps = self.passes = 0
        self._keeps = sweep.plan.passes > 1

    def begin(self) -> None:
        """Make everything known at the start, and record it."""
        self._network.begin(self.t)
        self._monitor.begin()
        self._recorder.add(self.t)

    def block(self) -> None:
        """Go on until as many points are to be recorded as fit into a block, or to the end."""
        for _ in range(BLOCK):
            if self.done == self._times.steps:
                return
            after = self._times.start + (self.done + 1) * self._times.step
            self._step(after - self.t)
            self.t = after
            self.done += 1
            self._recorder.add(after)

    def _step(self, h: float) -> None:
        network, monitor = self._network, self._monitor
        if self._keeps:
            network.keep()
        self._sweep.step(self.t, h)
        monitor.stepped(h)
        network.settle(self.t, h)
        network.accept(h)
        monitor.settled()
        self.steps += 1
        self.passes += self._sweep.passes


def marching(
    network: Network, sweep: Sweep, times: Grid, recorder: Recorder, monitor: Monitor, fast: bool
) -> March:
    """A run that is ready to begin: in C if that is wanted and possible, else in Python."""
    from orchestrator.runs.compiled import Compiled

    if fast and not isinstance(native.library(), str):
        with suppress(TypeError):
            return Compiled(network, sweep, times, recorder, monitor)
    return March(network, sweep, times, recorder, monitor)
