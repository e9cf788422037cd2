"""`reference`: the monolithic solution of a system of FMUs, to which co-simulations converge.

All FMUs are in Model Exchange. Connections are equations (`plant`), so no signal is held or extrapolated. One
implicit multistep method with variable order integrates all states (CVODE of SUNDIALS: A. C. Hindmarsh et al.
2005, ACM Trans. Math. Softw. 31(3) 363-396), with the Jacobian of the connected system from directional
derivatives, or from differences where an FMU has none. Recorded values between steps are those of its
polynomial. The method restarts at every event and at every sample at which a scenario changes its slope:

    time event       announced by an FMU
    state event      an event indicator changes its sign; located by CVODE to rounding
    step event       an FMU asks for it after an accepted step

The absolute tolerance follows from the magnitudes that the FMUs give (GetNominalsOfContinuousStates). The
error grows from step to step. After 3 s of strokes with cavitation it is 6e-9 of the range of the worst
signal, a rate with peaks, at a tolerance of 3e-14, 2e-8 at 1e-13 and 1e-7 at 1e-12.
"""

import time as wall_time
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from orchestrator.base.errors import NotExchangeable, Problem
from orchestrator.base.extras import require
from orchestrator.base.interrupts import DeferredInterrupts
from orchestrator.base.options import chosen, documented
from orchestrator.base.processes import check_room
from orchestrator.data.table import Array
from orchestrator.data.trace import Trace
from orchestrator.engine.arguments import ReferenceArguments
from orchestrator.engine.result import Card, Result
from orchestrator.engine.run import ProgressBar, ScenarioSource, opened, prepare, run
from orchestrator.engine.scenario import Scenario
from orchestrator.engine.time_grid import RECORD_STEP, Grid, step_length
from orchestrator.fmi.messages import LogMessage
from orchestrator.monolithic.plant import Plant
from orchestrator.monolithic.tight import FMU_TOLERANCE, first_step, tightened
from orchestrator.ssp.coupling import Coupling
from orchestrator.ssp.plausible import doubts_told
from orchestrator.ssp.system import Inlet, System

SOLVER = "none, all FMUs as one ODE (CVODE)"  # on the card, in place of a master
TOLERANCE = 2e-14  # default, relative; absolute: times the magnitude of the state
MAX_EVENTS = 1000  # at one time
SAME_TIME = 1e-12  # times closer than this fraction of the span are equal
ROOT = 2  # status of a step of CVODE that ends at a state event
CORNER = 1e-9  # relative change of a slope that restarts the solver


@documented(ReferenceArguments)
def reference(
    system: System | str | Path,
    scenario: ScenarioSource = None,
    *,
    progress: bool = False,
    **options: Unpack[ReferenceArguments],
) -> Result:
    """Solve a system as one ODE, for comparison with co-simulations.

        from orchestrator import compare, reference, run

        truth = reference("build/harvester.ssp", "data/scenarios/boom_up.csv")
        fast = run("build/harvester.ssp", "data/scenarios/boom_up.csv", master="jacobi", step=5e-3)
        print(compare({"truth": truth, "jacobi": fast}).worst("jacobi", "speed").signal)

    system, scenario   as for `run`
    progress           show a progress bar if it takes longer than a second

    The trace has all outputs, connected inputs and states. At the time of an event it has the values after
    the event.

    If an FMU has no Model Exchange or does not list its states, the result is a tight co-simulation, see
    `tight`. A note on the card says so. `card.errors` has the change of each output when the step is halved,
    from which its error follows; the largest is in the note, and at most `tolerance` or 1e-6 of the range if
    that is affordable.

    Raises Problem for a mistake and if the solver fails.
    """
    given = chosen(ReferenceArguments, options, "reference")
    record_step, tolerance = given.pop("record_step", RECORD_STEP), given.pop("tolerance", TOLERANCE)
    if not 1e-14 <= tolerance <= 1e-2:
        raise Problem(f"tolerance {tolerance:g}: expected 1e-14 to 1e-2")
    if not 0 < record_step < np.inf:
        raise Problem(f"record step: expected a positive time, got {record_step:g} s")
    require("reference", "the reference solution", "sksundae")

    rest = {name: value for name, value in given.items() if name not in ("cut", "swap")}
    rest |= {"progress": progress}
    try:
        return _solve(opened(system, dict(given), exchange=True), scenario, record_step, tolerance, rest)
    except NotExchangeable as problem:
        reason = str(problem)
    try:
        other = opened(system, given)
    except Problem as problem:
        raise Problem(f"neither a monolithic solution ({reason}) nor a co-simulation ({problem})") from None
    rest |= {"record_step": record_step, "tolerance": FMU_TOLERANCE}

    def co_simulated(step: float, master: Coupling) -> Result:
        return run(other, scenario, master=master, step=step, **rest)

    return tightened(co_simulated, first_step(record_step, step_length(other, None)), tolerance, reason)


def _solve(
    system: System, scenario: ScenarioSource, record_step: float, tolerance: float, options: dict[str, Any]
) -> Result:
    """The monolithic solution."""
    job, times = prepare(system, scenario, step=record_step, isolate=False, **options)
    plant = Plant(job.system, [*_inlets(job.system, job.scenario)])
    try:
        with ProgressBar(times.stop - times.start, job.execution.progress) as bar:
            result = _Integration(plant, job.scenario, times, tolerance).run(bar)
        return replace(result, provenance=job.provenance)
    finally:
        plant.close()


def _inlets(system: System, scenario: Scenario | None) -> Iterator[Inlet]:
    """The continuous inputs that a scenario drives, one external input each."""
    for port, (_, linear) in (scenario.columns if scenario else {}).items():
        variable = system.variable(port)
        if variable.is_continuous:
            yield Inlet(str(port), variable.unit, ((port, linear),))


class _Integration:
    """One integration; `run` returns the result.

    rows   recorded times and values
    """

    def __init__(self, plant: Plant, scenario: Scenario | None, times: Grid, tolerance: float) -> None:
        self.plant, self.scenario, self.times, self.tolerance = plant, scenario, times, tolerance
        self.counts = Counter[str]()
        self._problem: BaseException | None = None
        self._at: tuple[float, bytes] = (np.nan, b"")
        ports = plant.system.ports("output")
        variables = {port: plant.system.variable(port) for port in ports}
        self._discrete = [p for p, v in variables.items() if not v.is_continuous and v.kind != "String"]
        columns = scenario.columns if scenario else {}
        self._sampled = [p for p in columns if not plant.system.variable(p).is_continuous]

    # ---- the equations

    def settle(self, t: float, x: Array) -> None:
        """Evaluate the plant at a time [s] and a state."""
        at = (t, x.tobytes())
        if at == self._at:
            return
        self._at = (np.nan, b"")
        self.plant.settle_at(t, x)
        self._at = at

    def _guarded(self, count: str, values: Callable[[], Array], t: float, x: Array, into: Array) -> None:
        """NaN instead of an exception: CVODE then takes a shorter step, and fails if that does not help."""
        try:
            self.counts[count] += 1
            self.settle(t, x)
            into[:] = values()
        except BaseException as problem:
            self._problem = problem
            into[:] = np.nan

    def _jacobian(self, t: float, x: Array, _: Array, into: Array) -> None:
        self._guarded("Jacobians", lambda: self.plant.matrices().a, t, x, into)

    # ---- the integration

    def run(self, bar: ProgressBar) -> Result:
        """The result from start to stop."""

        def check(t: float) -> None:
            interrupts.check()
            bar.update(t - times.start)

        began, plant, times = wall_time.perf_counter(), self.plant, self.times
        system = plant.system
        driven = self.scenario.initial(system, times.start) if self.scenario else {}
        with doubts_told(system):
            plant.start((times.start, times.stop), driven)
        if self.scenario:
            plant.drive(self.scenario)
        check_room(times.rows, len([*plant.outputs, *plant.inputs, *plant.states, *self._discrete]))
        self._points: list[float] = [*(times.start + times.step * np.arange(times.rows)).tolist(), np.inf]
        self._same = SAME_TIME * max(times.stop - times.start, abs(times.stop))
        self._rows = list[Array]()
        breaks = self._breaks()
        t, x, repeated = times.start, plant.x.copy(), 0
        self.settle(t, x)
        self._record(t, x)
        with DeferredInterrupts() as interrupts:
            while self._before(t, times.stop) and not plant.ended:
                check(t)
                begin, change = t, breaks[bisect_right(breaks, t + self._same)]
                ends = times.stop, plant.next_event, change
                target = max(end for end in ends if self._equal(end, min(ends)))
                if self._before(t, target):
                    t, x, event = self._advance(t, x, target, check)
                else:
                    t, event = max(t, target), True
                event |= self._equal(t, plant.next_event) or bool(self._sampled and self._equal(t, change))
                repeated = 1 if self._before(begin, t) else repeated + 1
                if repeated > MAX_EVENTS:
                    expected = f"expected at most {MAX_EVENTS} events at one time"
                    raise Problem(f"{system.name}: t = {t:.9g} s: {expected}")
                if event:
                    x = self._event(t, x)
                self._record(t, x)
        return self._result(wall_time.perf_counter() - began)

    def _breaks(self) -> list[float]:
        """Times [s] at which the slope of a scenario jumps, or the value of a discrete input; infinity."""
        if self.scenario is None:
            return [np.inf]
        time, base, slopes, _ = self.scenario.table.arrays
        change = np.abs(np.diff(slopes, axis=0))
        scale = np.abs(slopes).max(axis=0)
        corners = (change > CORNER * scale).any(axis=1)
        columns = [self.scenario.columns[p][0] for p in self._sampled]
        corners |= (np.diff(base, axis=0)[:, columns] != 0.0).any(axis=1)
        return [*map(float, time[corners]), np.inf]

    def _solver(self, t: float, x: Array) -> Any:
        from sksundae.cvode import CVODE

        count = self.plant.indicator_count
        indicators = partial(self._guarded, "indicators", self.plant.indicators)
        options: dict[str, Any] = {"eventsfn": indicators, "num_events": count} if count else {}
        solver = CVODE(
            partial(self._guarded, "evaluations", lambda: self.plant.f),
            jacfn=self._jacobian,
            rtol=self.tolerance,
            atol=self.tolerance * self.plant.magnitudes(),
            **options,
        )
        solver.init_step(t, x)
        return solver

    def _advance(
        self, t: float, x: Array, target: float, check: Callable[[float], None]
    ) -> tuple[float, Array, bool]:
        """Integrate to `target` [s], the first event or the end; returns time, states, True for an event."""
        if not len(x):
            return self._without_states(t, x, target)
        solver = self._solver(t, x)
        while self._before(t, target):
            check(t)
            step = self._solved(solver.step(target, method="onestep", tstop=target), t)
            if step.t <= t:  # after an interpolation the solver returns its last step once more
                continue
            t, x = float(step.t), step.y
            self.counts["steps"] += 1
            self._interpolate(solver, t, target)
            self._at = (np.nan, b"")
            event = self.plant.completed_step(t, x) or step.status == ROOT
            if event or self.plant.ended:
                return t, x, event
        return target, x, False

    def _without_states(self, t: float, x: Array, target: float) -> tuple[float, Array, bool]:
        """Outputs alone over the recorded points; an event indicator is evaluated only there."""
        before = self.plant.indicators()
        while self._before(t, target):
            t = min(self._next_point(), target)
            self.settle(t, x)
            after = self.plant.indicators()
            event = self.plant.completed_step(t, x) or bool(((before > 0) != (after > 0)).any())
            if event or self.plant.ended:
                return t, x, event
            self._record(t, x)
        return target, x, False

    def _solved(self, step: Any, t: float) -> Any:
        """The step, if it succeeded."""
        if not step.success:
            if self._problem is not None:
                raise self._problem
            where = f"{self.plant.system.name}: the solver failed after t = {t:.9g} s"
            raise Problem(f"{where}: {step.message.rstrip('.')}; a larger tolerance may help")
        if isinstance(self._problem, KeyboardInterrupt):
            raise self._problem
        self._problem = None
        return step

    def _interpolate(self, solver: Any, t: float, target: float) -> None:
        """Record the points before t, inside of the last step."""
        while self._before(point := self._next_point(), t):
            for _ in range(3):  # after an event the solver may report this event once more
                inside = self._solved(solver.step(point, method="normal", tstop=target), t)
                if self._equal(inside.t, point):
                    break
            self.settle(point, inside.y)
            self._record(point, inside.y)

    def _event(self, t: float, x: Array) -> Array:
        """Event mode at a time; the states after it."""
        self.counts["events"] += 1
        self.settle(t, x)

        def set_discrete() -> None:
            if self.scenario:
                values = self.scenario.initial(self.plant.system, t)
                for port in self._sampled:
                    self.plant.slaves[port.component].set(port.variable, values[port])

        self.plant.event(set_discrete)
        self._at = (np.nan, b"")
        return self.plant.x.copy()

    # ---- the result

    def _before(self, a: float, b: float) -> bool:
        """Is a time earlier than another, and not the same?"""
        return a < b - self._same

    def _equal(self, a: float, b: float) -> bool:
        return not (self._before(a, b) or self._before(b, a))

    def _next_point(self) -> float:
        """The time of the next row [s]; infinite if there is none."""
        return self._points[len(self._rows)]

    def _record(self, t: float, x: Array) -> None:
        """Add a row if t is the next recorded point, or replace that of the same time."""
        again = self._equal(t, self._points[len(self._rows) - 1])  # of no row: infinity
        if not again and not self._equal(t, self._next_point()):
            return
        self.settle(t, x)
        plant = self.plant
        others = [float(plant.slaves[p.component].get(p.variable)) for p in self._discrete]
        row = np.concatenate([plant.y, plant.v, plant.x, others])
        if again:
            self._rows[-1] = row
        else:
            self._rows.append(row)

    def _result(self, wall: float) -> Result:
        plant, counts = self.plant, self.counts
        ports = [*plant.outputs, *plant.inputs, *plant.states, *self._discrete]
        rows = np.array(self._rows)
        wanted = {p: k for k, p in enumerate(ports)}
        wanted |= {p: k for k, p in enumerate(plant.outputs)}
        time = np.asarray(self._points[: len(rows)], np.float64)
        signals = {str(p): rows[:, k] for p, k in wanted.items()}
        units = {str(p): u.name for p in wanted if (u := plant.system.unit(p))}
        simulated = float(time[-1] - time[0])
        notes = [
            *plant.system.notes,
            *self.times.notes,
            *plant.notes,
            f"monolithic solution: {counts['evaluations']} evaluations, {counts['Jacobians']} Jacobians,"
            f" {counts['events']} events",
        ]
        notes += [f"{plant.ended} requested the end of the simulation"] if plant.ended else []
        card = Card(
            master=SOLVER,
            step=simulated / max(counts["steps"], 1),
            record_step=self.times.step,
            steps=counts["steps"],
            simulated=simulated,
            wall=wall,
            warnings=plant.system.warnings,
            notes=tuple(notes),
        )
        messages: list[LogMessage] = [m for slave in plant.slaves.values() for m in slave.log.messages]
        return Result(plant.system, Trace(time, signals, units), card, tuple(messages))
