"""`reference`: the monolithic solution of a system of FMUs, to which co-simulations converge.

All FMUs are in Model Exchange. Connections are equations (`plant`), so no signal is held or extrapolated. One
implicit multistep method with variable order integrates all states (CVODE of SUNDIALS: A. C. Hindmarsh et al.
2005, ACM Trans. Math. Softw. 31(3) 363-396), with the Jacobian of the
connected system from directional derivatives, or from differences where an FMU has none. Recorded values
between steps are those of its polynomial. The method restarts at every event (`integration`) and at every
sample at which a scenario changes its slope.

The absolute tolerance follows from the magnitudes that the FMUs give (GetNominalsOfContinuousStates). The
error grows from step to step. After 3 s of strokes with cavitation it is 6e-9 of the range of the worst
signal, a rate with peaks, at a tolerance of 3e-14, 2e-8 at 1e-13 and 1e-7 at 1e-12.
"""

import time as wall_time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import chain
from math import ceil
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
from orchestrator.engine.integration import Integration, Solver, known
from orchestrator.engine.job import Job, Request
from orchestrator.engine.options import ReferenceOptions, RunOptions, same
from orchestrator.engine.plant import Plant
from orchestrator.engine.refinement import Progress, compared, estimated_error
from orchestrator.engine.result import Card, Event, Result, RunFailed
from orchestrator.engine.run import ProgressBar, co_simulate
from orchestrator.engine.scenario import Scenario, ScenarioSource
from orchestrator.engine.time_grid import Grid, step_length
from orchestrator.fmi.messages import LogMessage
from orchestrator.ssp.coupling import Coupling
from orchestrator.ssp.load import configured
from orchestrator.ssp.plausible import doubts_told
from orchestrator.ssp.system import Inlet, System

SOLVER = "none, all FMUs as one ODE (CVODE)"  # on the card, in place of a master
TOLERANCE = 2e-14  # default, relative; absolute: times the magnitude of the state
ROOT = 2  # status of a step of CVODE that ends at a state event
SAME_TIME = 1e-12  # times closer than this fraction of the span are equal
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
    `tightened`. A note on the card says so. `card.errors` has the change of each output when the step is
    halved, from which its error follows; the largest is in the note, and at most `tolerance` or 1e-6 of the
    range if that is affordable.

    Raises Problem for a mistake and if the solver fails.
    """
    given = chosen(ReferenceOptions, options, "reference")
    record_step, tolerance = given.record_step, given.tolerance
    if not 1e-14 <= tolerance <= 1e-2:
        raise Problem(f"tolerance {tolerance:g}: expected 1e-14 to 1e-2")
    if not 0 < record_step < np.inf:
        raise Problem(f"record step: expected a positive time, got {record_step:g} s")
    require("reference", "the reference solution", "sksundae")

    other = configured(system, cut=given.cut, swap=given.swap)
    rest = replace(same(RunOptions, given), cut=(), swap={}, tolerance=None, progress=progress)
    try:
        return _solve(other, scenario, record_step, tolerance, replace(rest, record_step=None))
    except NotExchangeable as problem:
        reason = str(problem)
    rest = replace(rest, tolerance=FMU_TOLERANCE)

    def co_simulated(step: float, master: Coupling) -> Result:
        return co_simulate(Request.of(other, scenario, replace(rest, coupling=master, step=step)))

    return tightened(co_simulated, first_step(record_step, step_length(other, None)), tolerance, reason)


def _solve(
    system: System, scenario: ScenarioSource, record_step: float, tolerance: float, options: RunOptions
) -> Result:
    """The monolithic solution."""
    job = Job.of(system, scenario, replace(options, step=record_step))
    times = job.times
    plant = Plant(job.system, [*_inlets(job.system, job.scenario)])
    try:
        with ProgressBar(times.stop - times.start, job.options.progress) as bar:
            result = _Recorded(plant, job.scenario, times, tolerance).result(bar)
        return replace(result, provenance=job.provenance)
    finally:
        plant.close()


def _inlets(system: System, scenario: Scenario | None) -> Iterator[Inlet]:
    """The continuous inputs that a scenario drives, one external input each."""
    for port, (_, linear) in (scenario.columns if scenario else {}).items():
        variable = system.variable(port)
        if variable.is_continuous:
            yield Inlet(str(port), variable.unit, ((port, linear),))


class CvodeSolver:
    """CVODE of scikit-sundae."""

    def __init__(self, of: Integration, t: float, x: Array, target: float) -> None:
        from sksundae.cvode import CVODE

        self._of, self._t, self._target = of, t, target
        count = of.plant.indicator_count
        indicators = partial(of.guarded, "indicators", of.plant.indicators)
        events: dict[str, Any] = {"eventsfn": indicators, "num_events": count} if count else {}
        absolute = of.tolerance * of.plant.magnitudes()
        self._method = CVODE(of.rates, jacfn=of.jacobian, rtol=of.tolerance, atol=absolute, **events)
        self._method.init_step(t, x)

    def advance(self) -> tuple[float, Array, bool]:
        """One step."""
        while True:
            step = self._solved(self._method.step(self._target, method="onestep", tstop=self._target))
            if step.t > self._t:  # after an interpolation the solver returns its last step once more
                self._t = float(step.t)
                if self._of.plant.indicator_count:
                    self._of.settle(self._t, step.y)
                    known(self._of.plant, self._t, self._of.plant.indicators())
                return self._t, step.y, step.status == ROOT

    def inside(self, t: float) -> Array:
        """The states at a time [s] inside the last step."""
        for _ in range(3):  # after an event the solver may report this event once more
            step = self._solved(self._method.step(t, method="normal", tstop=self._target))
            if self._of.equal(step.t, t):
                break
        states: Array = step.y
        return states

    def _solved(self, step: Any) -> Any:
        """The step, if it succeeded."""
        if not step.success or self._of.broken:
            raise self._of.failed(self._t, step.message)
        self._of.problem = None
        return step


class _Recorded(Integration):
    """An integration whose values are recorded; `result` is that from start to stop.

    rows   recorded times and values
    """

    def __init__(self, plant: Plant, scenario: Scenario | None, times: Grid, tolerance: float) -> None:
        super().__init__(plant, tolerance, SAME_TIME * max(times.stop - times.start, abs(times.stop)))
        self.scenario, self.times = scenario, times
        ports = plant.system.ports("output")
        variables = {port: plant.system.variable(port) for port in ports}
        self._discrete = [p for p, v in variables.items() if not v.is_continuous and v.is_number]
        columns = scenario.columns if scenario else {}
        self.sampled = [p for p in columns if not plant.system.variable(p).is_continuous]

    def result(self, bar: ProgressBar) -> Result:
        """The result from start to stop."""
        began, plant, times = wall_time.perf_counter(), self.plant, self.times
        driven = self.scenario.initial(plant.system, times.start) if self.scenario else {}
        with doubts_told(plant.system):
            plant.start((times.start, times.stop), driven)
        if self.scenario:
            plant.drive(self.scenario)
            plant.jumped(times.start)
        check_room(times.rows, len([*plant.outputs, *plant.inputs, *plant.states, *self._discrete]))
        self._points: list[float] = [*(times.start + times.step * np.arange(times.rows)).tolist(), np.inf]
        self._rows = list[Array]()
        x = plant.x.copy()
        self.arrived(times.start, x)
        with DeferredInterrupts() as interrupts:
            self._interrupts, self._bar = interrupts, bar
            self.run(times.start, x, times.stop, self._breaks())
        return self._result(wall_time.perf_counter() - began)

    def _breaks(self) -> list[float]:
        """Times [s] at which the slope of a scenario jumps, or the value of a discrete input; infinity."""
        if self.scenario is None:
            return [np.inf]
        time, base, slopes, _ = self.scenario.table.arrays
        change = np.abs(np.diff(slopes, axis=0))
        scale = np.abs(slopes).max(axis=0)
        corners = (change > CORNER * scale).any(axis=1)
        corners[1:] |= time[1:] == time[:-1]
        columns = [self.scenario.columns[p][0] for p in self.sampled]
        corners |= (np.diff(base, axis=0)[:, columns] != 0.0).any(axis=1)
        return [*map(float, time[corners]), np.inf]

    # ---- on the way

    def solver(self, t: float, x: Array, target: float) -> Solver:
        """A solver that begins at a time [s] and a state."""
        return CvodeSolver(self, t, x, target)

    def changed(self, t: float) -> None:
        """The scenario has the values after its jumps up to a time [s]."""
        self.plant.jumped(t)

    def check(self, t: float) -> None:
        """Raise KeyboardInterrupt if the user has interrupted; show the progress."""
        self._interrupts.check()
        self._bar.update(t - self.times.start)

    def stepped(self, solver: Solver, t: float) -> None:
        """Record the points before t, inside of the last step."""
        while self.before(point := self.next_point(), t):
            self.arrived(point, solver.inside(point))

    def set_discrete(self, t: float) -> None:
        """Set the inputs that the scenario drives and that are not continuous."""
        values = self.scenario.initial(self.plant.system, t) if self.scenario else {}
        for port in self.sampled:
            self.plant.slaves[port.component].set(port.variable, values[port])

    def next_point(self) -> float:
        """The time of the next row [s]; infinite if there is none."""
        return self._points[len(self._rows)]

    def arrived(self, t: float, x: Array) -> None:
        """Add a row if t is the next recorded point, or replace that of the same time."""
        again = self.equal(t, self._points[len(self._rows) - 1])  # of no row: infinity
        if not again and not self.equal(t, self.next_point()):
            return
        self.settle(t, x)
        plant = self.plant
        others = [float(plant.slaves[p.component].get(p.variable)) for p in self._discrete]
        row = np.concatenate([plant.y, plant.v, plant.x, others])
        if again:
            self._rows[-1] = row
        else:
            self._rows.append(row)

    # ---- the result

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
            events=tuple(Event(t, causes) for t, causes in self.happened),
        )
        messages: list[LogMessage] = [m for slave in plant.slaves.values() for m in slave.log.messages]
        return Result(plant.system, Trace(time, signals, units), card, tuple(messages))


# ---- a tight co-simulation in place of a monolithic solution, with its own error estimate

GUARD = 1e-6  # estimated relative error of an input above which the first run divides a step
PASS_TOLERANCE = 1e-9  # relative mismatch of an input at which the passes over a step end
FMU_TOLERANCE = 1e-10  # of the solvers in the FMUs, relative
BOUND = 1e-6  # smallest bound of the estimated RMS error, relative to the range of a signal
LARGEST_STEP = 1e-3  # [s], of the first run
MAX_STEPS = 10**6  # of all runs together


def first_step(record_step: float, suggested: float) -> float:
    """The first step [s]: a fraction of the record step, not above the suggestion and LARGEST_STEP."""
    return record_step / ceil(record_step / min(record_step, suggested, LARGEST_STEP) - 1e-9)


def master(refinement: float) -> Coupling:
    """The master of the highest order that works with all FMUs; refinement: step over that of the first run.

    The guard gets stricter with the square of the step. Otherwise errors of divided steps, of which there are
    many if FMUs hold their inputs, would not fall with the step, and the estimate would miss them.
    """
    return Coupling("hermite", guard=GUARD * refinement**2, tolerance=PASS_TOLERANCE)


CoSimulate = Callable[[float, Coupling], Result]  # a run with a step [s] and a master


def tightened(run: CoSimulate, first: float, bound: float, reason: str) -> Result:
    """The run with the smallest estimated error; raises RunFailed if no run is complete.

    The step is halved until the estimate meets a bound, hardly falls any more, or the next run would cost too
    much. The estimate of a run compares it with those at half and at twice its step. It does not see errors
    that do not depend on the step. So the solvers of the FMUs and the passes of the master get tight
    tolerances, and steps in which an input jumps are divided by a guard.

    run      co-simulates; `first`: the step of the first run [s]
    bound    of the estimated RMS error of each signal, relative to its range; at least BOUND
    reason   why there is no monolithic solution, for the card
    """
    runs, progress = _runs(run, first), Progress()
    best = next(runs)
    for result in compared(chain([best], runs)):
        error = max(map(estimated_error, result.card.errors), default=0.0)
        first_estimate = progress.least == np.inf
        if progress.add(error) or first_estimate:
            best = result
        if error <= max(bound, BOUND) or progress.idle:
            break
    return _with_note(best, reason)


def _runs(run: CoSimulate, first: float) -> Iterator[Result]:
    """Complete runs, each at half the step of the one before; the first ones may fail at too large a step."""
    complete, failure, step = False, None, first
    spent = last = 0.0
    while spent + 2 * last <= MAX_STEPS:
        try:
            result = run(step, master(step / first))
        except RunFailed as failed:
            result, failure = failed.result, failed
            if complete or failed.final:
                break
        else:
            complete = True
            yield result
        last = max(result.card.steps, first / step)  # also of runs that fail at the start
        spent, step = spent + last, step / 2
    if failure and not complete:
        raise failure


def _with_note(result: Result, reason: str) -> Result:
    """The result with the reason and the largest estimate on its card."""
    worst = max(result.card.errors, key=estimated_error, default=None)
    estimate = "no estimate of its error, because no output changes or there is no run at half the step"
    if worst:
        estimate = f"estimated RMS error at most {estimated_error(worst):.1e} of range, in {worst.name}"
    what = "no monolithic solution, but a co-simulation with a small step"
    return result.noted(f"{what}: {estimate}; reason: {reason}")
