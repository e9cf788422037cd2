"""A run in pieces of one frame, whose inputs are decided from frame to frame.

The loop, the masters and the FMUs are those of `run`. A scenario with a row at each frame gives the same
numbers to the last bit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from math import isfinite

import numpy as np

from orchestrator.coupling.drive import Drive, drive
from orchestrator.coupling.grid import Grid, communication_step
from orchestrator.coupling.network import Network
from orchestrator.errors import Problem
from orchestrator.files.trace import Trace
from orchestrator.live.limits import Limits, check
from orchestrator.live.ramp import Ramp
from orchestrator.live.setup import Array, Setup
from orchestrator.runs.job import Job, Opener
from orchestrator.runs.recorder import Recorder
from orchestrator.runs.simulation import open_slave
from orchestrator.settings import Coupling
from orchestrator.system.parameters import with_sets
from orchestrator.system.ssp import load
from orchestrator.system.system import Port, System

NEVER = 1 << 40  # steps, more than anybody waits for


class Latest(Recorder):
    """Keeps the values of the latest communication point only: `values`, in the order of the ports."""

    def __init__(self, network: Network, times: Grid, chosen: Sequence[Port] | None = None) -> None:
        super().__init__(network, replace(times, steps=1), chosen)
        self.values = np.zeros(len(self._ports))
        self._reals = np.array([self._ports.index(p) for p in self._real], dtype=np.intp)
        self._wholes = np.array([self._ports.index(p) for p in self._whole], dtype=np.intp)

    def _keep(self) -> None:
        if self.filled:
            self.values[self._reals] = self.fresh.reals[self.filled - 1]
            self.values[self._wholes] = self.fresh.wholes[self.filled - 1]
            self.filled = 0


class Engine:
    """A machine that goes on by one frame whenever it is told.

    t        simulated time [s]
    axes     what drives it at t, shape (axes,)
    values   of the signals at t, shape (signals,)
    units    of axes and signals, where they have one
    notes    what there is to say about how it runs
    """

    def __init__(self, setup: Setup, open: Opener = open_slave) -> None:
        """Raises Problem for a mistake in the setup."""
        check(setup)
        system = with_sets(load(setup.system).swapped(setup.swap), setup.parameters).with_start(setup.set)
        coupling = system.coupling or Coupling()
        coupling.check(system.components)
        times, self._steps = _grid(system, coupling, setup)
        limits = Limits(setup.axes, setup.frame)
        self.t, self.axes = times.start, limits.rest.copy()
        self._ramp = Ramp(self.t, self._at(times, self._steps), self.axes)
        driven = _drive(system, setup, self._ramp)
        system = driven.released(system) if driven else system
        self._times = times
        self.units = _units(system, setup)
        job = Job(system, driven, coupling, setup.signals, (), None, True, open)
        with ExitStack() as stack:
            opened = stack.enter_context(job.opened(times, Latest))
            self._march, self._latest = opened.march, opened.recorder
            self._march.begin()
            self._latest.settle()
            told = system.suggestion.notes(setup.step is not None)
            self.notes = (*system.notes, *told, *opened.network.notes, *self._march.notes)
            self._undo = stack.pop_all()
        assert isinstance(self._latest, Latest)
        self.values = self._latest.values

    def advance(self, axes: Array) -> None:
        """One frame, in which the axes move at straight lines to these values, shape (axes,)."""
        march = self._march
        march.total = march.done + self._steps
        self._ramp.aim(self.t, self._at(self._times, march.total), axes)
        while march.done < march.total:
            march.block()
            self._latest.settle()
        self.t = march.t
        self.axes[:] = axes

    def close(self) -> None:
        """Free the FMUs. May be repeated."""
        self._undo.close()

    @staticmethod
    def _at(times: Grid, steps: int) -> float:
        return times.start + steps * times.step


def _grid(system: System, coupling: Coupling, setup: Setup) -> tuple[Grid, int]:
    """The communication points, without end, and how many of them are a frame."""
    start, step = system.start or 0.0, communication_step(system, setup.step)
    if not (isfinite(step) and step > 0):
        raise Problem(f"step: expected a positive time, got {step:g} s")
    if coupling.adaptive is not None:
        return Grid(start, setup.frame, NEVER, first=step), 1
    ratio = setup.frame / step
    if ratio > NEVER:
        raise Problem(f"step: expected at least {setup.frame / NEVER:.3g} s, got {step:g} s")
    steps = round(ratio)
    if steps < 1 or abs(ratio - steps) > 1e-6 * steps:
        raise Problem(f"frame: expected a multiple of the step {step:g} s, got {setup.frame:g} s")
    return Grid(start, step, NEVER), steps


def _drive(system: System, setup: Setup, ramp: Ramp) -> Drive | None:
    """The axes bound to the inputs that they drive."""
    if not setup.axes:
        return None
    still = {axis.name: np.full(2, axis.rest) for axis in setup.axes}
    bound = drive(system, Trace(ramp.arrays[0].copy(), still), "axes")
    return replace(bound, table=ramp)


def _units(system: System, setup: Setup) -> Mapping[str, str]:
    """Of the axes those that commands are given in, of the signals those of the FMUs."""
    units = {}
    for axis in setup.axes:
        inlet = system.inputs.get(axis.name)
        units[axis.name] = inlet.unit if inlet else system.unit(system.targets(axis.name)[0][0])
    for name in setup.signals:
        units[name] = system.variable(system.port(name)).unit
    return {name: unit.name for name, unit in units.items() if unit}
