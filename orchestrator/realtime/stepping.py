"""The process that steps a machine in real time: it reads commands and writes frames, each by its deadline.

In each frame the command is read (`CommandWatchdog`) and limited to what each axis may do
(`RateLimiter`). The inputs move linearly to the command while `FrameStepper` makes the communication steps.
Loop, masters and FMUs are those of `run`: a scenario with a row at each frame gives bit-equal results.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from math import inf, isfinite
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.text import first_names
from orchestrator.data.table import Array
from orchestrator.data.trace import JUMP, SAME_TIME, Trace
from orchestrator.data.trace_writer import RowLayout, TraceSink
from orchestrator.engine.job import Request
from orchestrator.engine.options import RunOptions, same
from orchestrator.engine.recorder import EnergyMonitor
from orchestrator.engine.result import SMALL_EXCHANGE, UNRELIABLE, energies_above
from orchestrator.engine.scenario import ScenarioFile, ScenarioTable, values_over_time
from orchestrator.engine.simulation_loop import simulation
from orchestrator.engine.time_grid import Grid, step_length
from orchestrator.realtime.deadlines import DeadlineClock, latency_bin, raise_priority
from orchestrator.realtime.setup import Axis, Setup, State, Task
from orchestrator.realtime.shared_memory import Command, SharedState, attach
from orchestrator.ssp.coupling import Coupling
from orchestrator.ssp.system import System
from orchestrator.worker.main import Channel

GRACE = 2.0  # [s] for the last frame and for closing the FMUs
POLL = 0.01  # [s] between two readings of the command while the machine is paused
LOAD_SPAN = 1.0  # [s] over which the load is averaged
RECENT = 1.0  # [s] in which the energies before fade to a third
NEVER = 1 << 40  # steps: more than any session has


def main(channel: Channel) -> None:
    """Run until the parent closes the channel."""
    task: Task = channel.get()
    channel.grace = GRACE
    tempfile.tempdir = str(channel.folder)  # where the FMUs are unpacked
    shared = SharedState(
        channel.keep(attach(task.address)), len(task.setup.axes), len(task.setup.signals), task.rows
    )
    details: dict[str, Any] = {}
    try:
        with closing(FrameStepper(task.setup)) as stepper:
            details |= {"units": dict(stepper.units), "notes": [*stepper.notes, raise_priority()]}
            shared.write_frame(task.first, stepper.t, stepper.axes, stepper.values)
            with shared.writing() as status:
                status["last"] = task.first
            shared.set_state(State.PAUSED, json.dumps(details))
            _loop(stepper, task, shared, details, channel.ended)
        shared.set_state(State.ENDED, json.dumps(details))
    except Exception as problem:
        message = str(problem) if isinstance(problem, Problem) else f"{type(problem).__name__}: {problem}"
        shared.set_state(State.FAILED, json.dumps(details | {"message": " ".join(message.split())}))
    channel.ended.wait()


def _loop(
    stepper: FrameStepper, task: Task, shared: SharedState, details: dict[str, Any], ended: Event
) -> None:
    """Make one frame after the other, each when it is due, until the parent ends."""
    setup, clock, number = task.setup, DeadlineClock(), task.first
    limiter = RateLimiter(setup.axes, setup.frame)
    nothing = np.full(len(setup.axes), np.nan)
    command = Command(False, 1.0, 0, nothing)
    watchdog, running = CommandWatchdog(nothing, setup.timeout, task.serial), False
    while not ended.is_set():
        if running:
            clock.wait()
        else:
            time.sleep(POLL)
        began = time.monotonic()
        command = shared.read_command() or command  # none while it is being written
        shared.heartbeat()
        commanded, length = watchdog.commanded(command, began), setup.frame / command.speed
        if command.playing != running:
            running = command.playing
            shared.set_state(State.RUNNING if running else State.PAUSED, json.dumps(details))
            clock.begin(length)
        elif running:
            stepper.advance(limiter.toward(stepper.axes, commanded))
            number += 1
            shared.write_frame(number, stepper.t, stepper.axes, stepper.values)
            _publish(shared, number, clock, began, length)
            if (doubt := stepper.unreliable) != details.get("unreliable", ""):
                details["notes"] += [] if "unreliable" in details else [f"at t = {stepper.t:.3g} s: {doubt}"]
                details["unreliable"] = doubt
                shared.set_state(State.RUNNING, json.dumps(details))
            clock.done(length)


def _publish(shared: SharedState, number: int, clock: DeadlineClock, began: float, length: float) -> None:
    """Make the frame visible to readers, and record its latency and load."""
    with shared.writing() as status:
        now = time.monotonic()
        latency, load = now - clock.due, (now - began) / length
        status["latencies"][latency_bin(latency)] += 1
        status["last"] = number
        status["frames"] += 1
        status["missed"] += latency > length
        status["load"] += (load - status["load"]) * min(length / LOAD_SPAN, 1.0)
        status["worst"], status["slipped"] = max(status["worst"], latency), clock.slipped


class Ramp(ScenarioTable):
    """A scenario table of one frame. It is updated in place, because the C loop holds its address."""

    def __init__(self, begin: float, end: float, values: Array) -> None:
        """values, shape (axes,), hold from `begin` to `end` [s]."""
        super().__init__(np.array([begin, end]), np.stack([values, values]))

    def aim(self, begin: float, end: float, values: Array) -> None:
        """Set the frame from `begin` to `end` [s]: from the last values of the previous frame to `values`."""
        times, base, slopes, anchor = self.arrays
        base[0] = base[1] = base[2]
        base[2] = values
        np.subtract(base[2], base[1], out=slopes[1])
        slopes[1] /= end - begin
        times[0] = anchor[0] = anchor[1] = begin
        times[1] = anchor[2] = end


class CommandWatchdog:
    """Commands nothing for all axes if there is no new command for `timeout` [s].

    The age of a command counts from when this process first read it, so clocks of processes are not compared.
    """

    def __init__(self, nothing: Array, timeout: float, serial: int) -> None:
        """nothing: NaN, shape (axes,); serial: number of the last command that is already too old."""
        self._nothing, self._timeout, self._serial = nothing, timeout, serial
        self._values, self._seen = nothing, -inf

    def commanded(self, command: Command, now: float) -> Array:
        """Commanded values of the axes, shape (axes,), at `now` [s]; NaN for an axis without a command."""
        if command.serial != self._serial:
            self._serial, self._values, self._seen = command.serial, command.values, now
        return self._values if now - self._seen <= self._timeout else self._nothing


class RateLimiter:
    """Keeps each axis within its limit and its rate of change; one without a command rests after its delay.

    rest   values without a command, shape (axes,)
    """

    def __init__(self, axes: Sequence[Axis], frame: float) -> None:
        """frame: [s]"""
        self.rest = np.array([axis.rest for axis in axes], dtype=np.float64)
        self._limit = np.array([axis.limit for axis in axes], dtype=np.float64)
        self._reach = frame * np.array([axis.rate for axis in axes], dtype=np.float64)
        self._delay = np.array([round(axis.rest_delay / frame) for axis in axes])  # in frames
        self._left = np.zeros_like(self._delay)

    def toward(self, now: Array, commanded: Array) -> Array:
        """Values one frame after `now`, moved towards `commanded`; NaN: no command. Called once per frame."""
        resting = np.isnan(commanded)
        self._left = np.where(resting, np.maximum(self._left - 1, -1), self._delay)
        target = np.where(resting, np.where(self._left >= 0, now, self.rest), commanded)
        move = np.clip(np.clip(target, -self._limit, self._limit) - now, -self._reach, self._reach)
        return np.clip(now + move, -self._limit, self._limit)


class LatestValues(TraceSink):
    """A sink that keeps only the values of the latest communication point, shape (signals,)."""

    def begin(self, layout: RowLayout, rows: int = 0) -> None:
        """Allocate the values."""
        super().begin(layout, rows)
        self.values = np.zeros(len(layout.names))

    def append_points(self, times: Array, reals: Array, integers: NDArray[np.int64]) -> None:
        """Keep the last of the points."""
        if len(times):
            self.values[:] = self.layout.values(reals[-1:], integers[-1:])[0]


class RecentEnergies:
    """Energy errors of the coupling over the last seconds: those before fade."""

    def __init__(self, monitor: EnergyMonitor) -> None:
        self._monitor, self._t = monitor, -inf
        self._before = self._recent = np.zeros(monitor.energies_array.shape)
        self._most = 0.0

    def doubt(self, t: float) -> str:
        """Why the motion is not reliable at t [s]; empty if it is. Call it once per frame."""
        sums, monitor = self._monitor.energies_array, self._monitor
        self._recent = self._recent * np.exp((self._t - t) / RECENT) + (sums - self._before)
        self._before, self._t = sums, t
        residual, _, exchanged = self._recent
        self._most = max(self._most, float(exchanged.max(initial=0.0)))
        # at rest nearly nothing is exchanged, and no error matters
        above = energies_above(residual, exchanged) & (exchanged > SMALL_EXCHANGE * self._most)
        names = [bond.name for bond, is_above in zip(monitor.bonds, above, strict=True) if is_above]
        error = f"energy error of the coupling above {UNRELIABLE:.0%} of what {first_names(names)} exchanged"
        return f"{error}; the motion is not reliable, take shorter steps" if names else ""


class FrameStepper:
    """Steps a system of FMUs frame by frame.

    t        simulated time [s]
    axes     values of the axes at t, shape (axes,)
    values   values of the signals at t, shape (signals,)
    units    units of axes and signals, without those that have none
    notes    remarks on the run
    unreliable   why the motion is not reliable at t, in one line; empty if it is
    """

    unreliable = ""

    def __init__(self, setup: Setup) -> None:
        """Raises Problem for a mistake in the setup."""
        setup.check()
        of_setup = replace(same(RunOptions, setup), record=tuple(setup.signals), fault={})
        request = Request.of(setup.system, None, of_setup)
        system = request.system
        times, self._steps = _grid(system, system.coupling or Coupling(), setup)
        limits = RateLimiter(setup.axes, setup.frame)
        self.t, self.axes = times.start, limits.rest.copy()
        self._faults = {}
        for name, text in setup.fault.items():
            meant = {port for port, _ in system.targets(name)}
            if any(meant & {port for port, _ in system.targets(axis.name)} for axis in setup.axes):
                raise Problem(f"fault {name}: expected an input that nobody drives here")
            self._faults[name] = values_over_time(system, name, str(text), self.t)
        first = np.concatenate([self.axes, self._faults_at(self.t)])
        self._ramp = Ramp(self.t, times.start + self._steps * times.step, first)
        at_rest = None
        if first.size:
            names = (*(axis.name for axis in setup.axes), *setup.fault)
            columns = {n: np.full(2, value) for n, value in zip(names, first, strict=True)}
            at_rest = Trace(self._ramp.arrays[0].copy(), columns)
        driving = replace(request, scenario=ScenarioFile(at_rest, "axes", None))
        stop = times.start + self._steps * times.step
        job = driving.with_options(replace(driving.options, stop=stop)).job()
        driven = job.scenario and replace(job.scenario, table=self._ramp)
        job = replace(job, scenario=driven, times=times)
        self._times = times
        self.units = _units(job.system, setup)
        latest = LatestValues()
        with ExitStack() as stack:
            self._loop = stack.enter_context(simulation(job, latest))
            self._loop.begin()
            self.notes = (*job.system.notes, *job.system.warnings, *self._loop.network.notes)
            self._exit = stack.pop_all()
        self._energies = RecentEnergies(self._loop.energy)
        self.values = latest.values[: len(setup.signals)]

    def advance(self, axes: Array) -> None:
        """Step one frame, in which the axes move linearly to these values, shape (axes,)."""
        state = self._loop.state
        state.total = state.done + self._steps
        end = self._times.start + state.total * self._times.step
        self._ramp.aim(self.t, end, np.concatenate([axes, self._faults_at(end)]))
        while state.done < state.total:
            self._loop.advance()
        self.t = state.t
        self.axes[:] = axes
        self.unreliable = self._energies.doubt(self.t)

    def _faults_at(self, t: float) -> Array:
        """Values of the faults at t [s]; one for that time acts in the frame that follows."""
        return np.array(
            [np.interp(t - JUMP, *corners) for corners in self._faults.values()], dtype=np.float64
        )

    def close(self) -> None:
        """Free the FMUs. May be repeated."""
        self._exit.close()


def _grid(system: System, coupling: Coupling, setup: Setup) -> tuple[Grid, int]:
    """The communication points, and the number of them in a frame."""
    start, step = system.start or 0.0, step_length(system, setup.step)
    if not (isfinite(step) and step > 0):
        raise Problem(f"step: expected a positive time, got {step:g} s")
    if coupling.adaptive is not None:
        return Grid(start, setup.frame, NEVER, first=step), 1
    ratio = setup.frame / step
    if ratio > NEVER:
        raise Problem(f"step: expected at least {setup.frame / NEVER:.3g} s, got {step:g} s")
    steps = round(ratio)
    if steps < 1 or abs(ratio - steps) > SAME_TIME * steps:
        raise Problem(f"frame: expected a multiple of the step {step:g} s, got {setup.frame:g} s")
    return Grid(start, step, NEVER), steps


def _units(system: System, setup: Setup) -> Mapping[str, str]:
    """Units of the axes, as commands use them, and of the signals, as the FMUs declare them."""
    units = {}
    for axis in setup.axes:
        inlet = system.inputs.get(axis.name)
        units[axis.name] = inlet.unit if inlet else system.unit(system.targets(axis.name)[0][0])
    for name in setup.signals:
        units[name] = system.variable(system.port(name)).unit
    return {name: unit.name for name, unit in units.items() if unit}
