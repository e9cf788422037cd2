"""`AccuracySearch`: finds coupling, step and FMU tolerance for an accuracy that the user asks for.

Runs follow each other until the estimated error of one is small enough. The first settings follow from the
accuracy and from what the FMUs can do, later ones from the error of the last run:

- FMUs with directional derivatives: each run estimates its error (`ErrorPropagation`). Equal steps come
  first. If their error is too large, shorter ones and a stricter guard follow that the order of convergence
  gives, and adaptive steps by `hermite` after equal ones by `hermite`, or where these would be very short.
- other FMUs: equal steps, shortened until the change from run to run is small enough.

None of these estimates sees what a signal does between communication points. So components without inputs
first step alone (`Sources`). The other components have to tell the slopes of their outputs, or steps are
shorter than suggested. Steps of two runs have an irrational ratio, so that no period divides both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.signals import largest, selected
from orchestrator.base.text import first_names
from orchestrator.data.trace import Trace
from orchestrator.data.trace_writer import TraceSink
from orchestrator.engine.job import Job, Request
from orchestrator.engine.refinement import Progress, estimated_error
from orchestrator.engine.result import Result, RunEnd, RunFailed, changes
from orchestrator.engine.time_grid import Grid, step_length
from orchestrator.ssp.coupling import LARGEST_STEP, Coupling
from orchestrator.ssp.dependencies import estimates_errors, influential_events, influential_inputs
from orchestrator.ssp.masters import Master
from orchestrator.ssp.power_bonds import ANGULAR_VELOCITY, VELOCITY, find_bonds
from orchestrator.ssp.system import Port, System

RANGE = 1e-6, 0.1  # of an accuracy
MOST_RUNS = 10
FMU_TOLERANCE = 3e-2  # of the solvers in FMUs, over the accuracy
TIGHTEST, LOOSEST = 1e-8, 1e-4  # limits of that tolerance
# Of further runs with equal steps, unless `hermite`. Their guard gets stricter with the square of the step:
# so errors of divided steps fall, too.
FURTHER = Coupling("gauss-seidel", order=3, guard=0.005)
# First run by least accuracy: coupling, and its step over the one that the system suggests. On the machine
# these steps suffice in nine of ten cases. Order 3 needs half the steps of order 2 at 1e-3.
FIRST = (
    (3e-3, Coupling("gauss-seidel"), 7),
    (3e-4, FURTHER, 10),
    (0.0, Coupling("hermite"), 5),
)
# Steps are divided where an input moves by more, and at corners of the scenario, if the FMUs can go back.
# Without, a valve that opens within a step costs an order: 15 times the error at 2 ms.
GUARD = 0.01
INSIDE = 0.5  # error inside the FMUs, over their tolerance
FIRST_TOLERANCE = 0.5  # of adaptive steps, over the accuracy; their error is up to a third of the tolerance
STRICTEST = 1e-10  # tolerance of adaptive steps
SHORTEST = 0.01  # of adaptive steps and of those without an estimate, over the suggested step: see jumps
PATIENCE = 2  # of adaptive runs, if FMUs allow, that hardly help
UNSTABLE = 50.0  # error over the accuracy from which a step is taken for unstable
MOST_DIVISIONS = 10.0  # of a step, or of a tolerance, between two runs
MOST_POWER = 4  # of GOLDEN, by which a step without an estimate is divided
JUMP, LEAST_JUMP = 10.0, 0.01  # change of a signal over that of the steps around it, and over its range
# By whether a master repeats steps, as hermite: largest estimated error that is accepted, over the accuracy,
# because estimates are not exact, and the order with which it decreases with the step. Where hermite is not
# accurate enough, cavities and friction limit the order.
ACCEPTED, ORDER = {False: 0.6, True: 0.5}, {False: 3.0, True: 2.0}
AIM = 0.35  # error that a further run aims at, over the accuracy
# The ratio of two steps that ratios of whole numbers approximate worst: no period divides both.
GOLDEN = (1.0 + math.sqrt(5.0)) / 2.0
# Looks at sources in a step over GOLDEN; fewer if they tell their slopes, or for more than MOST_LOOKS in all.
LOOKS, LOOKS_WITH_SLOPES, MOST_LOOKS = 10, 2, 10**6


@dataclass(frozen=True)
class Settings:
    """What a run of the search uses; step [s]: None for adaptive steps; tolerance: of the FMUs."""

    coupling: Coupling
    step: float | None
    tolerance: float

    @property
    def text(self) -> str:
        """Master and step."""
        adaptive = self.coupling.adaptive
        step = f"a step of {self.step:.3g} s" if self.step else f"adaptive steps, {adaptive:.2g}"
        return f"{self.coupling.text}, {step}"

    @property
    def repeats(self) -> bool:
        """Does the master repeat steps?"""
        return self.coupling.method.repeats


class AccuracySearch:
    """The runs until one is accurate enough.

    settings   of the next run
    runs       number of those before it
    """

    def __init__(self, request: Request) -> None:
        """The RMS error of outputs over their range is to be at most the accuracy of the options.

        Outputs without a choice: velocities of power bonds, else all. Tolerance of the FMUs without a choice:
        by the accuracy.

        Raises Problem for an accuracy out of range, for patterns without outputs, and for a choice that the
        search makes.
        """
        system, options = request.system, request.options
        accuracy, coupling = options.accuracy or 0.0, options.coupling
        for name in ("step",) if options.step is not None else coupling.names:
            value = options.step if name == "step" else getattr(coupling, name)
            value = value.name if isinstance(value, Master) else value
            raise Problem(f"accuracy {accuracy:g}: expected no {name}, which follows from it, got {value}")
        low, high = RANGE
        if not low <= accuracy <= high:
            raise Problem(f"accuracy: expected {low:g} to {high:g}, got {accuracy:g}")
        interfaces = [component.interface for component in system.components.values()]
        self.accuracy, self.decisive = accuracy, decisive_signals(system, options.accuracy_of)
        self._given, self.runs = request, 0
        self._nominals = {name: system.variable(system.port(name)).nominal for name in self.decisive}
        self._tolerance = options.tolerance or fmu_tolerance(accuracy)
        self._repeats = all(i.rollback for i in interfaces)
        self._adapts = self._repeats and all(i.variable_step for i in interfaces)
        self._estimates = estimates_errors(system)
        self._sources = Sources(system, self._estimates, self._adapts)
        targets = {connection.target for connection in system.connections}
        self._has_rate_wires = not targets.isdisjoint(system.rate_ports.values())
        self._progress, self._error = Progress(), math.inf
        self._last: Result | None = None
        self.settings = self._best = self._first()

    @property
    def request(self) -> Request:
        """That of the next run, which records the signals that decide."""
        settings, given = self.settings, self._given.options
        record = None if given.record is None else (*given.record, *self.decisive, *self._sources.causes)
        options = replace(
            given,
            coupling=settings.coupling,
            step=settings.step,
            tolerance=settings.tolerance,
            error_estimate=True,
            record=record,
        )
        return self._given.with_options(options)

    def _first(self) -> Settings:
        longest = self._sources.longest
        if not self._estimates and self._repeats:  # the first run is only there to be compared
            return Settings(Coupling("hermite"), GOLDEN * longest, self._tolerance)
        if not self._estimates:
            return Settings(Coupling("gauss-seidel"), longest, self._tolerance)
        jumping = self._sources.jumping
        coupling, steps = next((c, n) for least, c, n in FIRST if self.accuracy >= least or jumping)
        return Settings(self._guarded(coupling), min(steps * self._sources.base, longest), self._tolerance)

    def sources_alone(self, job: Job) -> Job | None:
        """Before the first run, that of the components without inputs; None without any."""
        return None if self.runs else self._sources.alone(job)

    def heed(self, end: RunEnd, looks: TraceSink) -> None:
        """Take no steps that would not see what sources do, before the first run."""
        self._sources.heed(end, looks, math.sqrt(self.accuracy))
        self.settings = self._best = self._first()

    def _guarded(self, coupling: Coupling) -> Coupling:
        return replace(coupling, guard=(coupling.guard or GUARD) if self._adapts else None)

    def accepts(self, result: Result) -> bool:
        """Is the estimated error of a run small enough?"""
        self.runs += 1
        if self.settings.step is not None:
            self.settings = replace(self.settings, step=result.card.step)
        self._estimates &= result.card.errors_of_inputs
        errors = self._errors(result)
        self._last = result
        if errors is None:
            self._error = math.inf
            return False
        inside = INSIDE * self.settings.tolerance
        self._error = math.hypot(max(errors, default=0.0), inside)
        in_vain = self._estimates and self._sources.unseen(
            result, much=True
        )  # no estimate will see these jumps
        return bool(in_vain) or self._error <= ACCEPTED[self.settings.repeats] * self.accuracy

    def _errors(self, result: Result) -> list[float] | None:
        """The errors of the signals that decide, without an estimate as at order 1; None: unknown."""
        ratio, last = 1.0, self._last
        if result.card.errors_of_inputs:
            errors = result.card.errors
        elif last is None:
            return None
        else:
            ratio = last.card.step / result.card.step
            errors = changes(None, last, replace(result, trace=result.trace.at(last.trace.time)))
            errors = tuple(replace(e, rms=estimated_error(e, ratio) / ratio) for e in errors)
        return [e.relative_rms(self._nominals[e.name]) for e in errors if e.name in self._nominals]

    def noted(self, result: Result) -> Result:
        """The accepted result with a note on its accuracy."""
        last = f" in run {self.runs}" * (self.runs > 1)
        reached = f"estimated RMS error {self._error:.1e} of the range{last}"
        reason, where = self._sources.reason(result)
        if reason:
            reached = f"not known, because {reason}; {where}: {reached}"
        goal = f"accuracy {self.accuracy:g} of {first_names(self.decisive)}"
        return result.noted(f"{goal}: {reached}, tolerance of the FMUs {self.settings.tolerance:g}")

    def goes_on(self) -> bool:
        """Choose stricter settings after a run that failed; False without time, or after too many runs."""
        self.runs += 1
        self._next(math.inf)
        return self.runs < MOST_RUNS and not self._given.is_late

    def choose_stricter(self, result: Result) -> None:
        """Choose settings after a run that is not accepted; raises RunFailed with it if that is in vain."""
        error, progress = self._error, self._progress
        last_resort = self.settings.coupling.adaptive is not None or not self._adapts
        if progress.add(error, counts=last_resort):
            self._best = self.settings
        known = progress.least < math.inf
        stagnates, late = progress.idle >= PATIENCE and known, self._given.is_late
        shortest = (self.settings.step or math.inf) < GOLDEN * SHORTEST * self._sources.base
        if stagnates or late or shortest or self.runs >= MOST_RUNS:
            after = f"{self._given.options.time_limit:g} s" if late else f"{self.runs} runs"
            why = "further runs hardly change it" * stagnates or f"after {after}"
            settings, accepted = self._best.text, ACCEPTED[self._best.repeats] * self.accuracy
            limit = f", where {accepted:.1e} is accepted," * (progress.least <= self.accuracy)
            reached = (
                f"estimated RMS error {progress.least:.1e} of the range{limit} with {settings}; " * known
            )
            raise RunFailed(Problem(f"accuracy {self.accuracy:g}: not reached: {reached}{why}"), result)
        self._next(error)

    def cost(self, span: float) -> str:
        """What the next run will take at most, and why there is one; span: to simulate [s]."""
        step = self.settings.step or SHORTEST * self._sources.base
        runs = "1 run" if self.runs == 1 else f"{self.runs} runs"
        least = self._progress.least
        before = f"the least error of {runs} is {least:.1e}" if least < math.inf else "a run to compare with"
        return f"accuracy {self.accuracy:g}: {before}; {self.settings.text}, up to {span / step:.2g} steps"

    def _next(self, error: float) -> None:
        """Change the settings after a run with this error."""
        last, excess = self.settings, error / self.accuracy
        if last.coupling.adaptive is not None:
            ratio = within(AIM / excess, 1.0 / MOST_DIVISIONS, 0.5)
            self.settings = self._adaptive(last.coupling.adaptive * ratio)
            return
        assert last.step is not None
        if not self._estimates:
            self.settings = replace(last, step=last.step / self._ratio(excess))
            return
        jumping = self._sources.jumping
        unstable, adapts = excess > UNSTABLE, self._adapts and not jumping
        if unstable and adapts and not self._has_rate_wires:  # equal steps would have to be very short
            self.settings = self._adaptive(FIRST_TOLERANCE * self.accuracy)
            return
        ratio = within((AIM / excess) ** (1.0 / ORDER[last.repeats]), 1.0 / MOST_DIVISIONS, 0.8)
        ratio = 0.5 if unstable else ratio
        if adapts and (last.repeats or ratio * last.step < self._sources.base):
            self.settings = self._adaptive(FIRST_TOLERANCE * self.accuracy)
            return
        coupling = last.coupling if last.repeats or jumping else self._guarded(FURTHER)
        if coupling.guard and last.coupling.guard and last.coupling.order == FURTHER.order:
            coupling = replace(coupling, guard=last.coupling.guard * ratio**2)
        self.settings = Settings(coupling, ratio * last.step, self._tolerance)

    def _ratio(self, excess: float) -> float:
        """Of a step to the next one without an estimate, a power of GOLDEN; excess: error over accuracy."""
        if not self.settings.repeats:  # of order 1, which two steps close to each other would not show
            return GOLDEN**2
        if excess == math.inf:
            return GOLDEN
        power = math.log(excess / AIM) / math.log(GOLDEN) / ORDER[True]
        return math.pow(GOLDEN, within(math.ceil(power), 1, MOST_POWER))

    def _adaptive(self, tolerance: float) -> Settings:
        adaptive, smallest = max(tolerance, STRICTEST), SHORTEST * self._sources.base
        largest = min(self._sources.longest, LARGEST_STEP)
        coupling = Coupling("hermite", adaptive=adaptive, smallest=smallest, largest=largest)
        return Settings(coupling, None, self._tolerance)


def fmu_tolerance(accuracy: float) -> float:
    """The tolerance of the solvers in FMUs for an accuracy."""
    return within(FMU_TOLERANCE * accuracy, TIGHTEST, LOOSEST)


def within(value: float, low: float, high: float) -> float:
    """The nearest value between both limits."""
    return min(max(value, low), high)


def decisive_signals(system: System, patterns: Sequence[str] = ()) -> list[str]:
    """The outputs that match; without patterns the velocities of power bonds, else all outputs."""
    names = [str(p) for p in system.ports("output") if system.variable(p).is_continuous]
    if patterns:
        expected = "expected continuous outputs of the system, found none"
        return selected(names, patterns, lambda pattern: f"accuracy of {pattern}: {expected}")
    units = {bond.flow: system.variable(bond.flow).unit for bond in find_bonds(system)}
    speeds = {port for port, unit in units.items() if unit and unit.dimension in (VELOCITY, ANGULAR_VELOCITY)}
    sources = {str(c.source) for c in system.connections if c.target in speeds}
    return [name for name in names if name in sources] or names


# ---- components without inputs


class Sources:
    """The outputs that influence states, and the steps that see all that they do, also between two points.

    base      the suggested step [s]
    longest   the longest step [s]; over GOLDEN the suggested one, where nothing proves longer ones
    causes    outputs whose jumps an estimate would not see
    jumping   outputs that jump
    hidden    outputs that move between any two points
    """

    def __init__(self, system: System, estimated: bool, divided: bool) -> None:
        """estimated: runs estimate their errors; divided: steps are divided at jumps."""
        ports = influential_outputs(system)
        seen_at_jumps = estimated and divided
        self.causes = [str(p) for p in ports if not (seen_at_jumps and followed(system, p))]
        fed = {name for name, component in system.components.items() if component.interface.of("input")}
        self._divided = {str(p) for p in ports if p.component not in fed}.difference(self.causes)
        self.jumping, self.hidden = set[str](), list[str]()
        self._events = influential_events(system)
        known = estimated and all(followed(system, port) for port in ports)
        # an estimate proves longer steps than an FMU suggests
        self.base = step_length(system.coupled(Coupling()), system.step if known else None)
        self.longest = math.inf if known else self.base / GOLDEN

    def alone(self, job: Job) -> Job | None:
        """A run of the components without inputs that influence others, by short steps; None without any."""
        driven = {port.component for port in job.scenario.columns} if job.scenario else set()
        fed = driven | {c.target.component for c in job.system.connections}
        ports = [port for port in influential_outputs(job.system) if port.component not in fed]
        components = {port.component: job.system.components[port.component] for port in ports}
        if not ports:
            return None
        slopes = all(component.interface.output_derivatives for component in components.values())
        times = job.times
        span, unit = times.stop - times.start, self.base / GOLDEN
        looks = max(min(LOOKS_WITH_SLOPES if slopes else LOOKS, MOST_LOOKS * unit / span), 1.0)
        record = tuple(str(port) for port in ports)
        options = replace(job.options, record=record, error_estimate=False)
        close = Grid(times.start, unit / looks, math.ceil(span / unit * looks))
        return Job(System(job.system.name, components), None, close, Coupling("jacobi"), options)

    def heed(self, end: RunEnd, looks: TraceSink, part: float) -> None:
        """Take no steps that would not see what the run `alone` did.

        part   of its range by which a signal may leave the values at both ends of a step
        """
        if end.interrupted:
            raise KeyboardInterrupt
        trace, spacing = looks.trace, end.lengths[1]
        if end.problem:
            self.hidden = list(trace.signals)
            return
        for name, values in trace.signals.items():
            wanted = min(round(min(self.longest, LARGEST_STEP) / spacing), len(values) - 1)
            samples = seen(values, wanted, part)
            if samples == 1 < wanted:
                self.hidden.append(name)
            elif samples < wanted:
                self.longest = min(self.longest, (samples - 1) * spacing)
        self.jumping = {name for name in trace.signals if jumps(trace, name)}

    def reason(self, result: Result) -> tuple[str, str]:
        """Why the accuracy of a run is unknown, and where its estimate holds; else empty."""
        if self._events:
            return f"of {self._events}", "without"
        trace = result.trace
        jumping = self.unseen(result) or [n for n in self.causes if n in self.jumping or jumps(trace, n)]
        if jumping:
            return f"{first_names(jumping)} jumps", "without jumps"
        if self.hidden:
            return f"{first_names(self.hidden)} moves between any two points", "at the points"
        return "", ""

    def unseen(self, result: Result, much: bool = False) -> list[str]:
        """The outputs that jump inside of steps, without sources at whose jumps steps are divided.

        much   only those that make the result unreliable
        """
        found = result.card.unseen.items()
        jumping = (n for n, of in found if of.unreliable or not much)
        return [n for n in jumping if n not in self._divided or result.card.unseen[n].hidden]


def seen(values: NDArray[np.float64], most: int, part: float) -> int:
    """The longest distance of two looks, up to `most` samples, between which a signal hides nothing.

    It may leave the values at both ends by this part of its range.
    """
    span, samples = part * np.ptp(values), most
    while samples > 1:
        first, last = values[:-samples], values[samples:]
        above = largest(values, samples + 1) - np.maximum(first, last)
        below = np.minimum(first, last) + largest(-values, samples + 1)
        if max(above.max(), below.max()) <= span:
            break
        samples = 2 * samples // 3
    return samples


def jumps(trace: Trace, name: str) -> bool:
    """Does a signal change in one step by much more than in the steps around it would do?"""
    changes, lengths = np.abs(np.diff(trace[name])), np.diff(trace.time)
    rates = np.pad(changes / lengths, 1)
    rates[-1] = rates[-2]  # a stroke may begin in the last step
    around = np.maximum(rates[:-2], rates[2:]) * lengths
    return bool((changes > np.maximum(JUMP * around, LEAST_JUMP * np.ptp(trace[name]))).any())


def influential_outputs(system: System) -> list[Port]:
    """The outputs, other than texts, that feed an input which influences a state."""
    influential = influential_inputs(system)
    sources = dict.fromkeys(c.source for c in system.connections if c.target in influential)
    return [port for port in sources if system.variable(port).is_number]


def followed(system: System, output: Port) -> bool:
    """Is an output known between two points? Its slopes are, or its component can be stepped alone."""
    interface = system.components[output.component].interface
    known = interface.output_derivatives or not interface.of("input")
    return system.variable(output).is_continuous and known
