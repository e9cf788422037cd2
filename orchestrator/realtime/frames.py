"""A scenario of one frame: straight lines from what the inputs are to what they shall be at its end.

What the operator wants, as long as he keeps saying so.

What an axis may do: never beyond its limit, never faster than its rate, to rest not before its time.

A run in pieces of one frame, whose inputs are decided from frame to frame.

The loop, the masters and the FMUs are those of `run`. A scenario with a row at each frame gives the same
numbers to the last bit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from math import inf, isfinite

import numpy as np

from orchestrator.base.coupling import Coupling
from orchestrator.base.errors import Problem
from orchestrator.data.trace import Trace
from orchestrator.engine.job import Execution, Job, Opener, Record, open_slave
from orchestrator.engine.network import Network
from orchestrator.engine.recorder import Recorder
from orchestrator.engine.scenario import Scenario, ScenarioTable, drive
from orchestrator.engine.time_grid import Grid, communication_step
from orchestrator.realtime.setup import Array, Axis, Setup
from orchestrator.realtime.shared_memory import Orders
from orchestrator.ssp.load import load
from orchestrator.ssp.parameter_sets import with_sets
from orchestrator.ssp.swap import with_swaps
from orchestrator.ssp.system import Port, System


class Ramp(ScenarioTable):
    """A table of two rows that is written anew for each frame, in place, because C has its address."""

    def __init__(self, begin: float, end: float, values: Array) -> None:
        """values, shape (axes,), hold from `begin` to `end` [s]."""
        super().__init__(np.array([begin, end]), np.stack([values, values]))

    def aim(self, begin: float, end: float, values: Array) -> None:
        """From the values at the end of the last frame to these, between two times [s]."""
        times, base, slopes, anchor = self.arrays
        base[0] = base[1] = base[2]
        base[2] = values
        np.subtract(base[2], base[1], out=slopes[1])
        slopes[1] /= end - begin
        times[0] = anchor[0] = anchor[1] = begin
        times[1] = anchor[2] = end


class Hand:
    """The watchdog of the commands: without a new one for `patience` [s] the axes are wanted at rest.

    Age counts from when a command was first seen, on the clock of the one who looks.
    """

    def __init__(self, rest: Array, patience: float, serial: int) -> None:
        """serial: of a command that is too old already."""
        self._rest, self._patience, self._serial = rest, patience, serial
        self._values, self._seen = rest, -inf

    def wanted(self, orders: Orders, now: float) -> Array:
        """Values of the axes, shape (axes,), at `now` [s]."""
        if orders.serial != self._serial:
            self._serial, self._values, self._seen = orders.serial, orders.values, now
        return self._values if now - self._seen <= self._patience else self._rest


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


NEVER = 1 << 40  # steps, more than anybody waits for


class Latest(Recorder):
    """Keeps the values of the latest communication point only: `values`, in the order of the ports."""

    def __init__(self, network: Network, times: Grid, chosen: Sequence[Port] | None = None) -> None:
        super().__init__(network, replace(times, steps=1), chosen)
        self.values = np.zeros(len(self._ports))
        self._reals = np.array([self._ports.index(p) for p in self._real], dtype=np.intp)
        self._wholes = np.array([self._ports.index(p) for p in self._whole], dtype=np.intp)

    def _keep(self) -> None:
        if last := self.made.filled:
            self.values[self._reals] = self.fresh.reals[last - 1]
            self.values[self._wholes] = self.fresh.wholes[last - 1]
            self.made.filled = 0


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
        system = with_sets(with_swaps(load(setup.system), setup.swap), setup.parameters)
        system = system.with_start(setup.set)
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
        job = Job(system, driven, coupling, Record(setup.signals, bonds=()), Execution(open=open))
        with ExitStack() as stack:
            opened = stack.enter_context(job.opened(times, Latest))
            self._loop, self._latest = opened.loop, opened.recorder
            self._loop.begin()
            told = system.suggestion.notes(setup.step is not None)
            self.notes = (*system.notes, *told, *opened.network.notes)
            self._undo = stack.pop_all()
        assert isinstance(self._latest, Latest)
        self.values = self._latest.values

    def advance(self, axes: Array) -> None:
        """One frame, in which the axes move at straight lines to these values, shape (axes,)."""
        state = self._loop.state
        state.total = state.done + self._steps
        self._ramp.aim(self.t, self._at(self._times, state.total), axes)
        while state.done < state.total:
            self._loop.advance()
        self.t = state.t
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


def _drive(system: System, setup: Setup, ramp: Ramp) -> Scenario | None:
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
