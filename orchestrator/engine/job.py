"""What a run is: a system and all choices for it, and how it ends."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from orchestrator.base.errors import Problem
from orchestrator.base.processes import machine_memory
from orchestrator.base.text import first_names
from orchestrator.data.trace import SAME_TIME, Trace
from orchestrator.data.trace_writer import TraceSink
from orchestrator.engine.result import (
    DIVIDED,
    SHORTER,
    BondEnergy,
    Card,
    EstimatedError,
    relative_errors,
    unreliable_energies,
    unreliable_errors,
)
from orchestrator.engine.scenario import Scenario
from orchestrator.engine.time_grid import Grid
from orchestrator.fmi.interface import MODEL_EXCHANGE
from orchestrator.fmi.messages import Log
from orchestrator.ssp.coupling import SHORTER_STEP_GUARD, Coupling
from orchestrator.ssp.masters import Master
from orchestrator.ssp.provenance import Provenance
from orchestrator.ssp.system import Component, System
from orchestrator.worker.process import WorkerLimits

if TYPE_CHECKING:
    from orchestrator.fmi.calls import Slave

ENDS_EARLY = "the run ends early: "  # begins the note on a run that an FMU asked to end

Opener: TypeAlias = "Callable[[Component], Slave]"


def open_slave(component: Component) -> Slave:
    """Instantiate the FMU of a component."""
    if component.source is None:
        raise Problem(f"{component.name}: expected an FMU file, got none")
    if component.interface.kind == MODEL_EXCHANGE:
        from orchestrator.engine.stepped_fmu import SteppedFmu

        return SteppedFmu(component, component.source)
    from orchestrator.fmi.cosimulation import CoSimulationFmu

    return CoSimulationFmu(component.name, component.interface, component.source, component.start)


@dataclass(frozen=True)
class Record:
    """Selection of signals, points and power bonds to record.

    signals   names; default: all outputs, all connected inputs and all inputs of the system
    step      interval between recorded points [s], a multiple of the communication step; adaptive runs hit
              the points exactly; the first and the last point are always recorded; default: every
              communication point
    bonds     power bonds, as pairs of input names, whose energy error is recorded; default: those that follow
              from the units
    """

    signals: Sequence[str] | None = None
    step: float | None = None
    bonds: Sequence[tuple[str, str]] | None = None


@dataclass(frozen=True)
class Execution:
    """Options of `run` that do not change the system, by the same names.

    error_estimate   "fast": without a measurement that needs two steps of each FMU by `hermite` and
                     `interface-jacobian`
    time_limit       of all runs of a command together, see `begun`; otherwise of a run, without the start of
                     its process
    memory_limit     [GB]
    open             a function other than `open_slave` needs this process
    until            condition that ends the run, see `engine.until`
    deadline         end of the time limit, by `time.monotonic` [s]
    """

    tolerance: float | None = None
    error_estimate: bool | Literal["fast"] = False
    accuracy: float | None = None
    accuracy_of: Sequence[str] = ()
    progress: bool = False
    isolate: bool = True
    time_limit: float = math.inf
    memory_limit: float = math.inf
    open: Opener = open_slave
    until: Any = None
    deadline: float = math.inf

    def begun(self) -> Execution:
        """These options from now on: the time limit ends all runs that follow."""
        time_limit = math.inf if self.time_limit is None else self.time_limit
        memory_limit = math.inf if self.memory_limit is None else self.memory_limit
        deadline = time.monotonic() + time_limit
        return replace(self, time_limit=time_limit, memory_limit=memory_limit, deadline=deadline)

    @property
    def late(self) -> bool:
        """Has the time limit passed?"""
        return time.monotonic() >= self.deadline

    @property
    def worker_limits(self) -> WorkerLimits:
        """The limits of a process; their time begins with the command."""
        memory = min(1e9 * self.memory_limit, machine_memory())
        return WorkerLimits(total_time=self.time_limit, memory=memory)

    @property
    def began(self) -> float:
        """When the command began, by `time.monotonic` [s]; of use only with a time limit.

        Infinite if the limit is that of a run.
        """
        return self.deadline - self.time_limit

    @property
    def isolated(self) -> bool:
        """Is the run in a process of its own?"""
        return self.isolate and self.open is open_slave

    def check(self, own: Master | None = None) -> None:
        """Refuse options that have no effect, and limits that cannot be enforced; own: a user's master."""
        if self.accuracy_of and self.accuracy is None:
            raise Problem(f"accuracy_of {self.accuracy_of[0]}: expected an accuracy, got none")
        if self.error_estimate not in (True, False, "fast"):
            raise Problem(f'error_estimate: expected True, False or "fast", got {self.error_estimate!r}')
        here = [] if self.isolate else ["isolate=False"]
        here += [] if self.open is open_slave else ["a function `open`"]
        here += [f"master {own.name}"] if own else []
        for name, limit in (("time_limit", self.time_limit), ("memory_limit", self.memory_limit)):
            if not limit > 0:
                raise Problem(f"{name}: expected a positive number, got {limit:g}")
            if limit < math.inf and here:
                got = f"got {here[0]}, which needs the calling process"
                raise Problem(f"{name}: expected a run in a process of its own, {got}")


@dataclass
class RunEnd:
    """How a run ended, without its rows.

    t             simulated until this time [s]
    steps, ...    as in `Card`
    errors        estimated during the run, by output
    logs          messages of the FMUs
    notes         remarks on the run
    problem       why the run ended early; None if it is complete
    interrupted   the user ended it
    died          the process of the run has ended
    """

    t: float
    steps: int = 0
    passes: int = 0
    repeated: int = 0
    lengths: tuple[float, float] = (0.0, 0.0)
    wall: float = 0.0
    bonds: tuple[BondEnergy, ...] = ()
    errors: Mapping[str, EstimatedError] = field(default_factory=dict)
    inside: Mapping[str, float] = field(default_factory=dict)
    logs: tuple[Log, ...] = ()
    notes: tuple[str, ...] = ()
    problem: Problem | None = None
    interrupted: bool = False
    died: bool = False

    @property
    def complete(self) -> bool:
        """Did the run reach its stop time, or the time at which an FMU asked to end it?"""
        return self.problem is None and not self.interrupted


@dataclass(frozen=True)
class Job:
    """A run: a system, its communication points and all other choices; provenance: of files and values."""

    system: System
    scenario: Scenario | None
    times: Grid
    coupling: Coupling
    record: Record = Record()
    execution: Execution = Execution()
    provenance: Provenance = field(default_factory=Provenance)

    def card(self, end: RunEnd, sink: TraceSink, trace: Trace) -> Card:
        """The accuracy card of a run that has ended, with this trace."""
        times, adaptive, simulated = self.times, self.coupling.adaptive, end.t - self.times.start
        interfaces = {name: component.interface for name, component in self.system.components.items()}
        left_out = (f"{n}: {i.unsupported_note}" for n, i in interfaces.items() if i.unsupported)
        same = ("steps", "passes", "repeated", "lengths", "wall", "bonds", "inside")
        errors = relative_errors(end.errors, trace, self.system.nominals)
        card = Card(
            master=self.coupling.text,
            step=times.step if adaptive is None else simulated / max(end.steps, 1),
            record_step=times.every * times.step if not times.free else 0.0,
            simulated=simulated,
            adaptive=adaptive,
            warnings=(*self.system.warnings, *(line for log in end.logs for line in log.warnings(sink))),
            notes=(*self.system.notes, *left_out, *end.notes),
            errors=errors,
            errors_of_inputs=bool(end.errors),
            **{name: getattr(end, name) for name in same},
        )
        divisible = guarded(self.system, Coupling("hermite"))  # which has a guard by default
        unguarded = divisible and not self.coupling.estimates_error and not self.coupling.method.step
        energies = unreliable_energies(end.bonds, DIVIDED if unguarded else SHORTER)
        return card.doubted(*energies, *unreliable_errors(errors, self.system))

    def stricter(self) -> Job:
        """The same adaptive run at a tenth of its tolerance."""
        c = self.coupling
        assert c.adaptive is not None
        tolerance = None if c.tolerance is None else c.tolerance / 10
        return replace(self, coupling=replace(c, adaptive=c.adaptive / 10, tolerance=tolerance))


def guarded(system: System, coupling: Coupling) -> bool:
    """Are steps with too large an error divided? All components need rollback and steps of any length."""
    interfaces = [component.interface for component in system.components.values()]
    return coupling.guard_tolerance > 0 and all(i.rollback and i.variable_step for i in interfaces)


def with_default_guard(system: System, step: float | None) -> System:
    """The system with a guard if an FMU suggests a shorter step than the system does, unless one is chosen.

    It holds for steps of any length: the suggestion is that of the FMU's own parameters.

    step   of the run [s], chosen by the user; None: the suggested one
    """
    coupling = system.coupling or Coupling()
    if coupling.guard is not None or coupling.estimates_error or system.step is None:
        return system
    length, limit = step or system.step, system.step * (1.0 - SAME_TIME)
    steps = {name: c.interface.step or math.inf for name, c in system.components.items()}
    shorter = {name: s for name, s in steps.items() if s < limit}
    if not shorter:
        return system
    note = f"{first_names(shorter)}: steps of {min(shorter.values()):g} s are suggested"
    guard = replace(coupling, guard=SHORTER_STEP_GUARD)
    if not guarded(system, guard):
        return replace(system, notes=(*system.notes, f"{note}; this run has steps of {length:g} s"))
    reason = f"those of {length:g} s are divided where an input is off by {SHORTER_STEP_GUARD:g} (guard)"
    suggestion = replace(system.suggestion, coupling=guard)
    return replace(system, suggestion=suggestion, notes=(*system.notes, f"{note}; {reason}"))
