"""`AccuracySearch`: finds coupling, step and FMU tolerance for an accuracy that the user asks for.

Runs follow each other until the estimated error of one is small enough. The first settings follow from the
accuracy and from what the FMUs can do, later ones from the error of the last run:

- FMUs with directional derivatives: each run estimates its error (`ErrorPropagation`). Equal steps come
  first. If their error is too large, shorter ones follow that the order of convergence gives, and adaptive
  steps by `hermite` after equal ones by `hermite`, or where these would be very short.
- other FMUs: equal steps, shortened until the change from run to run is small enough.

None of these estimates sees what a signal does between communication points. So components without inputs
first step alone, by short steps (`sources_alone`), and no step is too long to see all that they do (`heed`).
The other components have to tell the slopes of their outputs, or steps are shorter than suggested. Steps of
two runs have an irrational ratio, so that no period divides both.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.signals import largest, matching
from orchestrator.base.text import first_names
from orchestrator.data.trace import Trace
from orchestrator.data.trace_writer import TraceSink
from orchestrator.engine.job import Job, Options, is_late
from orchestrator.engine.result import Result, RunEnd, RunFailed, SignalError, signal_errors
from orchestrator.engine.time_grid import Grid, step_length
from orchestrator.ssp.coupling import LARGEST_STEP, Coupling, take_coupling
from orchestrator.ssp.dependencies import influential_events, influential_inputs
from orchestrator.ssp.masters import Master
from orchestrator.ssp.power_bonds import ANGULAR_VELOCITY, VELOCITY, find_bonds
from orchestrator.ssp.system import Port, System

RANGE = 1e-6, 0.1  # of an accuracy
MOST_RUNS = 10
FMU_TOLERANCE = 3e-2  # of the solvers in FMUs, over the accuracy
TIGHTEST, LOOSEST = 1e-8, 1e-4  # limits of that tolerance
# First run by least accuracy: coupling, and its step over the one that the system suggests. On the machine
# these steps suffice in nine of ten cases, and no others do so at a lower cost.
FIRST = (
    (3e-3, Coupling("gauss-seidel"), 7),
    (3e-4, Coupling("gauss-seidel", order=2), 4),
    (0.0, Coupling("hermite"), 5),
)
FURTHER = Coupling("gauss-seidel", order=2)  # coupling of further runs with equal steps, unless `hermite`
# Steps are divided where an input moves by more, and at corners of the scenario, if the FMUs can go back.
# Without, a valve that opens within a step costs an order: 15 times the error at 2 ms.
GUARD = 0.01
INSIDE = 0.5  # error inside the FMUs, over their tolerance
SHORT_STEP = 1.0  # over the suggested one; below it adaptive steps are cheaper
FIRST_TOLERANCE = 0.5  # of adaptive steps, over the accuracy; their error is up to a third of the tolerance
STRICTEST = 1e-10  # tolerance of adaptive steps
SHORTEST = 0.01  # of adaptive steps and of those without an estimate, over the suggested step: see jumps
JUMP, LEAST_JUMP = 10.0, 0.01  # change of a signal over that of the steps around it, and over its range
# The search ends after so many runs, adaptive ones if FMUs allow, that leave more than this of the error.
STAGNATION, PATIENCE = 0.7, 2
# The ratio of two steps that ratios of whole numbers approximate worst: no period divides both.
GOLDEN = (1.0 + math.sqrt(5.0)) / 2.0  # of the suggested step to the first, where nothing proves longer ones
RATIO = GOLDEN**2  # of steps of two runs without an estimate
# Looks at sources in a step over GOLDEN; fewer if they tell their slopes, or for more than MOST_LOOKS in all.
LOOKS, LOOKS_WITH_SLOPES, MOST_LOOKS = 10, 2, 10**6
UNSTABLE = 50.0  # error over the accuracy from which a step is taken for unstable
MOST_DIVISIONS = 10.0  # of a step, or of a tolerance, between two runs


@dataclass(frozen=True)
class Experience:
    """What is known of the errors of a master.

    accepted   largest estimated error that is accepted, over the accuracy: estimates are not exact
    aim        error that a further run aims at, over the accuracy
    order      with which the error decreases with the step
    """

    accepted: float
    aim: float
    order: float


EXTRAPOLATING = Experience(0.6, 0.35, 3.0)
HERMITE = Experience(0.5, 0.35, 2.0)  # where it is not accurate enough, cavities and friction limit the order


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
    def experience(self) -> Experience:
        """That with the master."""
        return HERMITE if self.coupling.method.repeats else EXTRAPOLATING


class AccuracySearch:
    """The runs until one is accurate enough.

    settings   of the next run
    runs       number of those before it
    """

    def __init__(self, system: System, options: Options) -> None:
        """The RMS error of outputs over their range is to be at most the accuracy of the options.

        Outputs without a choice: velocities of power bonds, else all. Tolerance of the FMUs without a choice:
        by the accuracy.

        Raises Problem for an accuracy out of range, for patterns without outputs, and for a choice that the
        search makes.
        """
        accuracy: float = options["accuracy"]
        chosen = {"step": options.get("step"), **take_coupling({**options})}
        if isinstance(master := chosen.get("master"), Master):
            chosen["master"] = master.name
        for name, value in chosen.items():
            if value is not None:
                asked = f"accuracy {accuracy:g}"
                raise Problem(f"{asked}: expected no {name}, which follows from it, got {value}")
        low, high = RANGE
        if not low <= accuracy <= high:
            raise Problem(f"accuracy: expected {low:g} to {high:g}, got {accuracy:g}")
        interfaces = [component.interface for component in system.components.values()]
        self.accuracy, self.decisive = accuracy, decisive_signals(system, options.get("accuracy_of") or ())
        self._given = options
        self._nominals = {name: system.variable(system.port(name)).nominal for name in self.decisive}
        self._least, self._idle, self.runs = math.inf, 0, 0
        self._previous: Result | None = None
        self._tolerance = options.get("tolerance") or fmu_tolerance(accuracy)
        self._repeats = all(i.rollback for i in interfaces)
        self._adapts = self._repeats and all(i.variable_step for i in interfaces)
        self._estimates, self._events = estimates_errors(system), influential_events(system)
        targets = {connection.target for connection in system.connections}
        # outputs whose jumps the estimate would not see: it sees those at which steps are divided
        sources, divided = influential_outputs(system), self._estimates and self._adapts
        self._causes = [str(port) for port in sources if not (divided and followed(system, port))]
        self._jumping, self._hidden = set[str](), list[str]()
        known = self._estimates and all(followed(system, port) for port in sources)
        # an estimate proves longer steps than an FMU suggests
        suggested = system.step if known else None
        self._base = step_length(system.coupled(Coupling()), suggested)
        self._longest = math.inf if known else self._base / GOLDEN
        self._has_rate_wires = not targets.isdisjoint(system.rate_ports.values())
        self.settings = self._best = self._first()

    @property
    def options(self) -> Options:
        """Those of the next run, which records the signals that decide."""
        given, settings = self._given, self.settings
        found = {
            **given,
            "master": settings.coupling,
            "tolerance": settings.tolerance,
            "error_estimate": True,
        }
        if settings.step is not None:
            found["step"] = settings.step
        if (record := given.get("record")) is not None:
            found["record"] = [*record, *self.decisive, *self._causes]
        return found

    def _first(self) -> Settings:
        if not self._estimates:
            master = "hermite" if self._repeats else "gauss-seidel"
            return Settings(Coupling(master), self._longest, self._tolerance)
        coupling, steps = next((c, n) for least, c, n in FIRST if self.accuracy >= least or self._jumping)
        return Settings(self._guarded(coupling), min(steps * self._base, self._longest), self._tolerance)

    def sources_alone(self, job: Job) -> Job | None:
        """A run of the components without inputs that influence others, by short steps; None without any."""
        driven = {port.component for port in job.scenario.columns} if job.scenario else set()
        fed = driven | {c.target.component for c in job.system.connections}
        ports = [port for port in influential_outputs(job.system) if port.component not in fed]
        components = {port.component: job.system.components[port.component] for port in ports}
        if not ports or self.runs:
            return None
        slopes = all(component.interface.output_derivatives for component in components.values())
        times = job.times
        span, unit = times.stop - times.start, self._base / GOLDEN
        looks = max(min(LOOKS_WITH_SLOPES if slopes else LOOKS, MOST_LOOKS * unit / span), 1.0)
        options = {**job.options, "record": [str(port) for port in ports], "error_estimate": False}
        options.pop("until", None)
        close = Grid(times.start, unit / looks, math.ceil(span / unit * looks))
        return Job(System(job.system.name, components), None, close, Coupling("jacobi"), options)

    def heed(self, end: RunEnd, looks: TraceSink) -> None:
        """Take no steps that would not see what sources do, before the first run; see `sources_alone`."""
        if end.interrupted:
            raise KeyboardInterrupt
        trace, spacing = looks.trace, end.lengths[1]
        if end.problem:
            self._hidden = list(trace.signals)
            return
        for name, values in trace.signals.items():
            wanted = min(round(min(self._longest, LARGEST_STEP) / spacing), len(values) - 1)
            samples = seen(values, wanted, math.sqrt(self.accuracy))
            if samples == 1 < wanted:
                self._hidden.append(name)
            elif samples < wanted:
                self._longest = min(self._longest, (samples - 1) * spacing)
        self._jumping = {name for name in trace.signals if _jumps(trace, name)}
        self.settings = self._best = self._first()

    def _guarded(self, coupling: Coupling) -> Coupling:
        return replace(coupling, guard=GUARD) if self._adapts else coupling

    def judge(self, result: Result) -> Result | None:
        """The result with a note on its accuracy, or None if another run is needed; see `settings`."""
        self.runs += 1
        if self.settings.step is not None:
            self.settings = replace(self.settings, step=result.card.step)
        self._estimates &= result.card.errors_of_inputs
        previous, self._previous = self._previous, result
        errors = result.card.errors if result.card.errors_of_inputs else self._changes(result, previous)
        decisive = (e for e in errors if e.name in self._nominals)
        error = max((e.relative_rms(self._nominals[e.name]) for e in decisive), default=0.0)
        error = math.hypot(error, INSIDE * self.settings.tolerance)
        known = result.card.errors_of_inputs or previous is not None
        if known and error <= self.settings.experience.accepted * self.accuracy:
            last = f" in run {self.runs}" * (self.runs > 1)
            reached = f"estimated RMS error {error:.1e} of the range{last}"
            jumping = [n for n in self._causes if n in self._jumping or _jumps(result.trace, n)]
            if self._events:
                reached = f"not known, because of {self._events}; without: {reached}"
            elif jumping:
                reached = f"not known, because {first_names(jumping)} jumps; without jumps: {reached}"
            elif self._hidden:
                moves = f"{first_names(self._hidden)} moves between any two points"
                reached = f"not known, because {moves}; at the points: {reached}"
            tolerance = f"tolerance of the FMUs {self.settings.tolerance:g}"
            goal = f"accuracy {self.accuracy:g} of {first_names(self.decisive)}"
            return result.noted(f"{goal}: {reached}, {tolerance}")
        self._continue(error if known else math.inf, result)
        return None

    def goes_on(self) -> bool:
        """Choose stricter settings after a run that failed; False without time, or after too many runs."""
        self.runs += 1
        self._next(math.inf)
        return self.runs < MOST_RUNS and not is_late(self._given)

    def _changes(self, result: Result, previous: Result | None) -> Iterator[SignalError]:
        """The errors by the changes since the run before: at order 1; at higher orders they are smaller."""
        for e in signal_errors(result.trace.at(previous.trace.time), previous.trace) if previous else ():
            yield replace(e, rms=e.rms / (RATIO - 1.0))

    def _continue(self, error: float, result: Result) -> None:
        """Choose stricter settings, or raise RunFailed with the last result if that is in vain."""
        last_resort = self.settings.coupling.adaptive is not None or not self._adapts
        self._idle = self._idle + 1 if last_resort and error > STAGNATION * self._least else 0
        if error < self._least:
            self._least, self._best = error, self.settings
        stagnates, late = self._idle >= PATIENCE and self._least < math.inf, is_late(self._given)
        shortest = (self.settings.step or math.inf) < RATIO * SHORTEST * self._base
        if stagnates or late or shortest or self.runs >= MOST_RUNS:
            after = f"{self._given['time_limit']:g} s" if late else f"{self.runs} runs"
            why = "further runs hardly change it" * stagnates or f"after {after}"
            known, settings = self._least < math.inf, self._best.text
            reached = f"estimated RMS error {self._least:.1e} of the range with {settings}; " * known
            raise RunFailed(Problem(f"accuracy {self.accuracy:g}: not reached: {reached}{why}"), result)
        self._next(error)

    def cost(self, span: float) -> str:
        """What the next run will take at most, and why there is one; span: to simulate [s]."""
        step = self.settings.step or SHORTEST * self._base
        runs = "1 run" if self.runs == 1 else f"{self.runs} runs"
        before = f"the least error of {runs} is {self._least:.1e}"
        return f"accuracy {self.accuracy:g}: {before}; {self.settings.text}, up to {span / step:.2g} steps"

    def _next(self, error: float) -> None:
        """Change the settings after a run with this error."""
        last, excess = self.settings, error / self.accuracy
        if last.coupling.adaptive is not None:
            ratio = within(last.experience.aim / excess, 1.0 / MOST_DIVISIONS, 0.5)
            self.settings = self._adaptive(last.coupling.adaptive * ratio)
            return
        assert last.step is not None
        if not self._estimates:
            self.settings = replace(last, step=last.step / RATIO)
            return
        unstable, adapts = excess > UNSTABLE, self._adapts and not self._jumping
        if unstable and adapts and not self._has_rate_wires:  # equal steps would have to be very short
            self.settings = self._adaptive(FIRST_TOLERANCE * self.accuracy)
            return
        known = last.experience
        ratio = within((known.aim / excess) ** (1.0 / known.order), 1.0 / MOST_DIVISIONS, 0.8)
        step = last.step * (0.5 if unstable else ratio)
        if adapts and (known is HERMITE or step < SHORT_STEP * self._base):
            self.settings = self._adaptive(FIRST_TOLERANCE * self.accuracy)
        else:
            kept = known is HERMITE or self._jumping
            coupling = last.coupling if kept else self._guarded(FURTHER)
            self.settings = Settings(coupling, step, self._tolerance)

    def _adaptive(self, tolerance: float) -> Settings:
        adaptive, smallest = max(tolerance, STRICTEST), SHORTEST * self._base
        largest = min(self._longest, LARGEST_STEP)
        coupling = Coupling("hermite", adaptive=adaptive, smallest=smallest, largest=largest)
        return Settings(coupling, None, self._tolerance)


def fmu_tolerance(accuracy: float) -> float:
    """The tolerance of the solvers in FMUs for an accuracy."""
    return within(FMU_TOLERANCE * accuracy, TIGHTEST, LOOSEST)


def within(value: float, low: float, high: float) -> float:
    """The nearest value between both limits."""
    return min(max(value, low), high)


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


def _jumps(trace: Trace, name: str) -> bool:
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
    return [port for port in sources if system.variable(port).kind != "String"]


def followed(system: System, output: Port) -> bool:
    """Is an output known between two points? Its slopes are, or its component can be stepped alone."""
    interface = system.components[output.component].interface
    known = interface.output_derivatives or not interface.of("input")
    return system.variable(output).is_continuous and known


def estimates_errors(system: System) -> bool:
    """Do the FMUs declare what the estimate of errors during a run needs, and have no events?"""
    wired = {connection.target.component for connection in system.connections}
    fed = wired & {port.component for port in influential_inputs(system)}
    linear = all(system.components[name].interface.linearisable for name in fed)
    return bool(fed) and linear and not influential_events(system)


def decisive_signals(system: System, patterns: Sequence[str] = ()) -> list[str]:
    """The outputs that match; without patterns the velocities of power bonds, else all outputs."""
    names = [str(p) for p in system.ports("output") if system.variable(p).is_continuous]
    selected = {pattern: matching(names, pattern) for pattern in patterns}
    for pattern, matches in selected.items():
        if not matches:
            raise Problem(f"accuracy of {pattern}: expected continuous outputs of the system, found none")
    if patterns:
        return [name for name in names if any(name in matches for matches in selected.values())]
    units = {bond.flow: system.variable(bond.flow).unit for bond in find_bonds(system)}
    speeds = {port for port, unit in units.items() if unit and unit.dimension in (VELOCITY, ANGULAR_VELOCITY)}
    sources = {str(c.source) for c in system.connections if c.target in speeds}
    return [name for name in names if name in sources] or names
