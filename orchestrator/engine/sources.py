"""What components without inputs do between two points: they step alone before the first run of a search.

The estimates of errors do not see it. So no step of a search is too long to see all that they do.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.signals import largest
from orchestrator.base.text import first_names
from orchestrator.data.trace import Trace
from orchestrator.data.trace_writer import TraceSink
from orchestrator.engine.job import Job
from orchestrator.engine.result import RunEnd
from orchestrator.engine.time_grid import Grid, step_length
from orchestrator.ssp.coupling import LARGEST_STEP, Coupling
from orchestrator.ssp.dependencies import influential_events, influential_inputs
from orchestrator.ssp.system import Port, System

JUMP, LEAST_JUMP = 10.0, 0.01  # change of a signal over that of the steps around it, and over its range
# The ratio of two steps that ratios of whole numbers approximate worst: no period divides both.
GOLDEN = (1.0 + math.sqrt(5.0)) / 2.0
# Looks at sources in a step over GOLDEN; fewer if they tell their slopes, or for more than MOST_LOOKS in all.
LOOKS, LOOKS_WITH_SLOPES, MOST_LOOKS = 10, 2, 10**6


class Sources:
    """The outputs that influence states, and the steps that see all that they do.

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
        options = {**job.options, "record": [str(port) for port in ports], "error_estimate": False}
        options.pop("until", None)
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

    def reason(self, trace: Trace) -> tuple[str, str]:
        """Why the accuracy of a run with this trace is unknown, and where its estimate holds; else empty."""
        if self._events:
            return f"of {self._events}", "without"
        jumping = [n for n in self.causes if n in self.jumping or jumps(trace, n)]
        if jumping:
            return f"{first_names(jumping)} jumps", "without jumps"
        if self.hidden:
            return f"{first_names(self.hidden)} moves between any two points", "at the points"
        return "", ""


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
    return [port for port in sources if system.variable(port).kind != "String"]


def followed(system: System, output: Port) -> bool:
    """Is an output known between two points? Its slopes are, or its component can be stepped alone."""
    interface = system.components[output.component].interface
    known = interface.output_derivatives or not interface.of("input")
    return system.variable(output).is_continuous and known
