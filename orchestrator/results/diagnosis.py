"""What is broken in a machine, from a recording: an FMU that diagnoses, run over it, and a report.

Its findings are those of `orchestrator.drive.findings`. A parameter NAME_fitted says whether there is a
reading NAME; a parameter NAME_reference is the size of the healthy machine.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location, require, tell_once
from orchestrator.base.text import DisplayUnit, TextTable, first_names, grouped, number
from orchestrator.data.corrections import hold_of, is_new, rate_faults
from orchestrator.data.description import description_next_to
from orchestrator.data.recording import read_recording
from orchestrator.data.table import READABLE, Array
from orchestrator.data.trace import Trace, trace_of
from orchestrator.drive.findings import findings as findings_in
from orchestrator.drive.page import Replayed, fragment
from orchestrator.engine.result import Result
from orchestrator.engine.run import run
from orchestrator.engine.scenario import ScenarioFile
from orchestrator.pages.figures import DASHES, PALETTE, TraceArea, TraceFigure, TraceLine, TracePanel
from orchestrator.results.report import PAGE, TERMINAL, Figure, Machine, Part, Report, Section, Table, Text
from orchestrator.ssp.load import load
from orchestrator.ssp.system import Component, System
from orchestrator.ssp.write import parameter_set

STEP = 0.01  # s
LONGEST_GAP = 3600.0  # s, in which a machine may be off; a longer one is longer than all readings around it
ROWS = 100_000  # of the findings at most, 0.3 s apart over a day of 8 h: a hundred outputs fit into memory
INTERVAL = 1.96  # deviations of a 95 % interval
SLOW, SLOWEST = 1.2, 10.5  # steps of a log from which faults are told later; from which none is certain
ENOUGH = 180.0  # s of readings, from which nothing found means something
GAP, LATE = 0.25, 5.0  # s and steps between two readings: from both on it is a gap
FASTEST, OFF = 3.0, 0.02  # rad/s and rad, m/s and m: what moves more between two readings was spliced
SPIKE = 20.0  # times the usual changes of a reading, by which a single one is no reading
ROUNDED = 0.02  # of the largest reading, within which a single change is rounding: a step of 1 bar at 200 bar
ALONE = 0.25  # of its change, by which those before and after an outlier may change
BEYOND = 1.5  # times the full command of a valve
# settings for readings of each step
COUNTED = ("still_time", "delay_limit")
KNOWN = 100.0  # a deviation of the prior over one from which a size can be learned that is never told
STATES = {1.0: "a fault", 0.0: "none", -1.0: "not known"}
FITTED, REFERENCE = "_fitted", "_reference"
COLDEST = 200.0  # K
# parameter of the usual size of a reading, and times that size, or one over it, which are doubtful: units of
# pressure differ by 7 (psi, kPa) or more
NOMINAL, UNUSUAL = "nominal_", 5.0
# share of full command from which a function was commanded; s, over which readings are means; how much these
# differ at most if it stands still: of a gyro, an angle, and pressures from one mean to the next
COMMANDED, STANDS = 0.1, 0.5
MOTION = {("rad/s", "m/s"): 0.03, ("rad", "m"): OFF, ("Pa",): 1e6}
EVEN = 1e6  # Pa, below which a return line may have one pressure, and above which that of a pump is held
LITRE = 1 / 6e4  # L/min in m3/s
# unit -> factor and unit for a reader, of quantities whose usual one is another
SHOWN = {
    "m2": (1e6, "mm²"),
    "m3/s": (1 / LITRE, "L/min"),
    "m3/(s.Pa)": (1e7 / LITRE, "L/min at 100 bar"),
    "Pa.s/m3": (1e-5 * 200 * LITRE, "bar at 200 L/min"),
    "s": (1e3, "ms"),
}
GREY = "Grey: 95 % interval. Dashed: the healthy machine. Gaps: cannot be told."
MARKED = "Light blue in the picture: where the faults are, if they are on the arm"
BLIND = (
    "A reading is missing or wrong, old and new readings contradict each other, or the machine did not do"
    " what would show it: rest, motion or flow for long enough"
)
TOGETHER = "its interval holds the healthy size, but the others of its part tell the fault with it"
MOST_TOLD = 3  # faults in the first sentence, the most certain first
READ_ONLY = (" sensor", "cooler", "tare")  # ends of repairs that one reading alone tells


@dataclass(frozen=True)
class Finding:
    """What an FMU tells of one thing that may be broken; size, deviation and state over the time [s].

    healthy   size of the healthy machine
    words     the fault in a sentence, of a smaller size and of a larger one
    """

    name: str
    text: str
    unit: str
    repair: str
    time: Array
    size: Array
    deviation: Array
    state: Array
    healthy: float = 0.0
    words: tuple[str, ...] = ()

    @property
    def broken(self) -> bool:
        """Whether it is a fault at any time."""
        return bool((self.state > 0).any())

    @property
    def since(self) -> float:
        """When it was first told [s]."""
        return float(self.time[(self.state > 0).argmax()])

    @property
    def last(self) -> int:
        """Row in which it was told last."""
        return int(np.flatnonzero(self.state > 0)[-1])

    @property
    def certainty(self) -> float:
        """Size over deviation where it was told last; infinite of what has no deviation."""
        size, deviation = abs(self.size[self.last]), self.deviation[self.last]
        return float(size / deviation) if deviation > 0 else math.inf

    @property
    def may_be_healthy(self) -> bool:
        """Whether its own 95 % interval holds the healthy size: it is told together with others only."""
        return bool(abs(self.size[self.last] - self.healthy) < INTERVAL * self.deviation[self.last])

    @property
    def shown(self) -> tuple[float, str]:
        """Factor and unit for a reader."""
        if self.unit in SHOWN:
            return SHOWN[self.unit]
        display = DisplayUnit(self.unit, {"Pa": "bar"}.get(self.unit, self.unit))
        return display.factor, display.name

    @property
    def sentence(self) -> str:
        """The fault as a mechanic says it, where it was told last."""
        text = self.text if self.text[1:2].isupper() else self.text[:1].lower() + self.text[1:]
        below, *above = self.words or (text,)
        return [below, *above][-1] if self.size[self.last] > self.healthy else below

    def usual(self) -> str:
        """The size of the healthy machine, of what has a size."""
        factor, unit = self.shown
        return f"{number(factor * self.healthy)} {unit}".removesuffix(" 1") if self.deviation.any() else ""

    def extent(self) -> str:
        """The size with its 95 % interval, where it was told last."""
        factor, unit = self.shown
        size, off = factor * self.size[self.last], INTERVAL * factor * self.deviation[self.last]
        if not off:
            return "" if self.unit == "1" else f"{number(size)} {unit}"
        low, high = (number(v) for v in (size - off, size + off))
        return f"{number(size)} ({low} to {high}) {unit}".rstrip()


@dataclass(frozen=True)
class Diagnosis:
    """Findings of a recording, the broken ones first, and what was found in the recording itself."""

    source: str
    findings: Sequence[Finding]
    result: Result
    remarks: Sequence[str]
    readings: Trace | None = None

    @property
    def broken(self) -> list[Finding]:
        """The faults, in the order of their certainty.

        What may be healthy by its own interval is one only if nothing else tells the same repair; then it
        is the most certain such finding, which is judged together with others.
        """
        told = sorted((f for f in self.findings if f.broken), key=lambda f: (-f.certainty, f.since))
        certain = {f.repair for f in told if not f.may_be_healthy}
        kept = {f.repair: f for f in reversed(told) if f.repair not in certain}
        return [f for f in told if not f.may_be_healthy or kept.get(f.repair) is f]

    @property
    def blind(self) -> dict[str, list[Finding]]:
        """What cannot be told at the end of the recording, by repair; without what is broken."""
        broken = {f.repair for f in self.broken}
        unknown = (f for f in self.findings if f.state[-1] < 0 and f.repair not in broken)
        return grouped(unknown, attrgetter("repair"))

    @property
    def sound(self) -> dict[str, list[Finding]]:
        """What has no fault at the end, as far as all that tells it can be told, by repair."""
        healthy = (f for f in self.findings if not f.broken and f.state[-1] == 0)
        known = grouped(healthy, attrgetter("repair"))
        broken = {f.repair for f in self.broken}
        return {n: some for n, some in known.items() if n not in broken and n not in self.blind}

    @property
    def shortness(self) -> str:
        """That the recording is too short to learn a machine or to call it healthy; empty if it is not."""
        length = float(self.findings[0].time[-1] - self.findings[0].time[0])
        return f"only {length:.3g} s of readings, expected {ENOUGH:g} s" if length < ENOUGH - 1 else ""

    @property
    def lacking(self) -> str:
        """Why it is not known whether the machine is healthy if nothing was found; empty if it is."""
        if self.shortness:
            return self.shortness
        sound, all_of = len(self.sound), len(self.sound) + len(self.blind)
        if 2 * sound < all_of:
            return f"only {sound} of {all_of} parts can be judged"
        return (
            "" if any(not n.endswith(READ_ONLY) for n in self.sound) else "nothing but sensors can be judged"
        )

    @property
    def is_known(self) -> bool:
        """Whether a fault was told, or enough was seen to say that there is none."""
        return bool(self.broken) or not self.lacking

    @property
    def verdict(self) -> str:
        """What was found, in words."""
        if self.broken:
            told = [*dict.fromkeys(f.sentence for f in self.broken)]
            count = "1 fault found" if len(self.broken) == 1 else f"{len(self.broken)} faults found"
            return f"{count}: {'; '.join(told[:MOST_TOLD])}{'; ...' * (len(told) > MOST_TOLD)}"
        return f"not known whether it is healthy: {self.lacking}" if self.lacking else "nothing found"

    def table(self) -> TextTable:
        """The faults."""
        rows = [[f.text, f.repair, f.extent(), f.usual(), f"{f.since:.2f}"] for f in self.broken]
        head = ("fault", "look at", "size (95 % interval)", "healthy", "found at [s]")
        return TextTable(head, rows, left=(0, 1, 2, 3))

    def report(self, machine: Markup = Markup()) -> Report:  # noqa: B008  immutable
        """What is broken, with its picture; without a fault, what was not examined comes first.

        machine   the machine with the marked parts, as HTML
        """
        blind = [f"{name}: {'; '.join(f.text for f in some)}" for name, some in self.blind.items()]
        told = [f"{self.source}: {self.verdict}"]
        at_end = [f"Cannot be told at the end: {', '.join(self.blind)}"] if self.blind else []
        time = self.findings[0].time
        interval = "; intervals hold the size with 95 %" if self.broken else ""
        unknown = Section(
            "What cannot be told at the end",
            [Text([BLIND, *blind] if blind else [])],
            folded=bool(self.broken),
        )
        sound = Section("No fault", [Text([", ".join(self.sound)] if self.sound else [])])
        parts: list[Part] = [
            Text(self.remarks, "soft"),
            *([Table(self.table())] if self.broken else []),
            Text([f"{f.text}: {TOGETHER}" for f in self.broken if f.may_be_healthy], "soft"),
            Text([*told, *at_end] if self.broken else [*at_end, *told], only=TERMINAL),
            Text([MARKED] if machine else (), "soft", only=PAGE),
            Machine(machine),
            *(Section(f.text, [_told(f), Figure(_figure(f), f.text, GREY)]) for f in self.broken),
            *([sound, unknown] if self.broken else [unknown, sound]),
        ]
        data = {"source": self.source, "remarks": self.remarks, "findings": [_data(f) for f in self.findings]}
        passed = False if self.broken else True if self.is_known else None
        lead = [f"{number(time[0])} to {number(time[-1])} s{interval}"]
        states = "no fault", f"{len(self.broken)} fault{'s' * (len(self.broken) > 1)}"
        return Report(f"Diagnosis of {self.source}", self.verdict, parts, data, passed, lead, states)

    def text(self) -> str:
        """For a terminal."""
        return self.report().text(verdict=False)


def _told(f: Finding) -> Text:
    """When a fault was told, its size beside the healthy one, and the repair."""
    healthy = f"; healthy: {usual}" if (usual := f.usual()) else ""
    size = [f"{f.extent()}{healthy}"] if f.extent() else []
    return Text([f"Look at: {f.repair}", *size, f"Found at {number(f.since)} s"], only=PAGE)


def _data(f: Finding) -> dict[str, Any]:
    """A finding for programs; size and deviation where it was told last, else at the end."""
    row = f.last if f.broken else -1
    since = f.since if f.broken else None
    names = {name: getattr(f, name) for name in ("name", "text", "unit", "repair", "broken", "healthy")}
    return {**names, "since [s]": since, "size": f.size[row], "deviation": f.deviation[row]}


def readings(file: Path) -> Trace:
    """A recording; rows out of order are sorted, and samples that are missing keep the value before them."""
    place = Location(require(file, READABLE))
    description = description_next_to(file)
    if description and description.signals:
        recording = read_recording(file)
        trace = Trace(recording.time, recording.signals, recording.units)
    else:
        trace = trace_of(place, description, gaps=True, sort=True)
    signals = dict[str, Array]()
    for name, values in trace.signals.items():
        known = np.isfinite(values)
        if not known.any():
            tell_once(f"{file}: {name} has no values; it counts as missing")
            continue
        if not known.all():
            lacking = f"{int((~known).sum())} of {len(values)} samples"
            tell_once(f"{file}: {name} lacks {lacking}; they keep the one before")
            rows = np.maximum.accumulate(np.where(known, np.arange(len(values)), known.argmax()))
            values = values[rows]
        signals[name] = values
    return Trace(trace.time, signals, trace.units)


def columns_of(inputs: Iterable[str], component: str, columns: Iterable[str], file: Path) -> dict[str, str]:
    """The columns of inputs: NAME or NAME_measured, also of a component; Problem if it could be two.

    Of a run, whose columns all are of components, that of the component counts, then the one behind a sensor.
    """
    found, columns = dict[str, str](), [*columns]
    of_run = all("." in c for c in columns)
    for name in inputs:
        exact = [c for c in columns if of_run and c == f"{component}.{name}"]
        behind = [c for c in columns if f".{c}".endswith(f".{name}_measured")]
        others = [c for c in columns if f".{c}".endswith(f".{name}")]
        these = exact or (behind or others if of_run else [*others, *behind])
        if len(these) > 1:
            text = f"{file}: expected one column {name}, got {', '.join(these)}"
            raise Problem(f"{text}; leave the others out")
        found |= dict.fromkeys([name], *these) if these else {}
    return found


def _named(trace: Trace, component: str, inputs: Collection[str], file: Path) -> Trace:
    """The columns of inputs, by their names."""
    found = columns_of(inputs, component, trace.signals, file)
    units = {n: trace.units[c] for n, c in found.items() if c in trace.units}
    return Trace(trace.time, {n: trace.signals[c] for n, c in found.items()}, units)


def diagnose(
    fmu: Path, recording: Path, parameters: Sequence[Path] = (), set: Mapping[str, float] | None = None
) -> Diagnosis:
    """Run an FMU that diagnoses over a recording whose columns have the names of its inputs.

    parameters   parameter sets (.ssv), such as that of a healthy machine (`learned`)
    set          values of parameters

    A reading that is missing or constant is named, and left out. Raises Problem if a command is missing.
    """
    system = load(fmu)
    (component,) = system.components.values()
    inputs = [n for n, v in component.interface.variables.items() if v.causality == "input"]
    trace = _named(readings(recording), component.name, inputs, recording)
    if not trace.signals:
        names = first_names(sorted(inputs), 8)
        text = f"{recording}: no column has the name of an input of {fmu.name}: {names}"
        beside = f"{recording.with_suffix('.toml').name} beside it can name others"
        raise Problem(f"{text}; {beside}, begin it with: harvester describe {recording}")
    return _examined(system, trace, str(recording), parameters, set or {})


def over(
    fmu: Path, time: Array, signals: Mapping[str, Array], set: Mapping[str, float] | None = None
) -> Diagnosis:
    """Of signals with the names of the inputs, of shape (n,) each."""
    return _examined(load(fmu), Trace(np.asarray(time), dict(signals)), "signals", (), set or {})


def _examined(
    system: System, trace: Trace, source: str, parameters: Sequence[Path], set: Mapping[str, float]
) -> Diagnosis:
    """Check the readings, and run the FMU over them.

    source   of the readings, for messages
    """
    (component,) = system.components.values()
    variables, (trace, values, remarks) = component.interface.variables, _checked(component, trace, source)
    found = {f.signals[0].partition(".")[2]: f for f in findings_in(system)[0] if f.repair}
    if not found:
        raise Problem(f"{component.source}: expected outputs NAME, NAME_deviation and NAME_state, found none")
    outputs = [n for n, v in variables.items() if v.causality == "output"]
    start, stop = float(trace.time[0]), float(trace.time[-1])
    record_step = STEP * max(1, math.ceil((stop - start) / STEP / ROWS))
    times: dict[str, Any] = {"start": start, "stop": stop, "step": STEP, "record_step": record_step}
    scenario = ScenarioFile(trace, source, None)
    result = run(system, scenario, record=outputs, parameters=parameters, set=values | dict(set), **times)
    time, (component,), findings = np.asarray(result.time), result.system.components.values(), []
    for name, f in found.items():
        sizes, off, state = (np.asarray(result[f"{name}{end}"]) for end in ("", "_deviation", "_state"))
        reference, about = f"{name}{REFERENCE}", (f.text, variables[name].unit_name or "1", f.repair)
        healthy = float(component.value(reference)) if reference in variables else 0.0
        findings.append(Finding(name, *about, time, sizes, off, state, healthy, f.words))
    remarks += [w for w in result.system.warnings if "did you mean" in w and REFERENCE not in w]
    name, valves = Path(source).name, {f.repair for f in findings if "_gain_" in f.name}
    if len(valves) > 1 and valves <= {f.repair for f in findings if f.broken}:
        text = "the valves of all functions differ from those of the healthy machine"
        remarks.append(f"{name}: {text}; is it a recording of another one? --learn makes the values of each")
    return Diagnosis(name, findings, result, remarks, trace)


def _checked(component: Component, trace: Trace, source: str) -> tuple[Trace, dict[str, float], list[str]]:
    """Readings that the FMU can use, values of its parameters for them, and lines about what was found."""
    if len(trace.time) < 2:
        raise Problem(f"{source}: expected two or more rows of numbers, got 1")
    steps = np.diff(trace.time)
    if steps.max(initial=0.0) > LONGEST_GAP and steps.max() > len(steps) * np.median(steps):
        k = int(steps.argmax())
        gap = f"{trace.time[k]:g} s to {trace.time[k + 1]:g} s"
        raise Problem(f"{source}: expected readings all the time, got none from {gap}")
    _refuse_units(component, trace, source)
    resolutions = {n: _resolution(v) for n, v in trace.signals.items()}
    trace, period, remarks = _usable(component, trace, source)
    missing, more = _without(component, trace, source)
    units = {n: trace.units.get(n) or component.interface.variables[n].unit_name or "" for n in trace}
    remarks += more
    remarks += [f"{source}: {n}: {fault}" for n, fault in rate_faults(trace.time, trace.signals, units)]
    for name in (n for n in trace if f"{NOMINAL}{n}" in component.interface.variables):
        highest, nominal = (float(v) for v in (trace[name].max(), component.value(f"{NOMINAL}{name}")))
        if not nominal / UNUSUAL < highest < nominal * UNUSUAL:
            shown = DisplayUnit(units[name], {"Pa": "bar"}.get(units[name], units[name]))
            highest, nominal = shown.factor * highest, shown.factor * nominal
            told = f"at most {number(highest)} {shown.name}, usually about {number(nominal)} {shown.name}"
            remarks.append(f"{source}: {name}: {told}; is the unit of the readings right?")
    values = {f"{component.name}.{n}{FITTED}": 0.0 for n in missing}
    if (slow := period / STEP) > SLOW:
        rate = f"{source}: {1 / STEP / slow:.3g} Hz, expected {1 / STEP:g} Hz or more"
        if slow > SLOWEST:
            raise Problem(f"{rate}, at least {1 / STEP / SLOWEST:.2g} Hz")
        remarks.insert(
            0, f"{rate}: sensors that stand still and lags are judged over {slow:.3g} times as long"
        )
        settings = [n for n in COUNTED if n in component.interface.variables]
        values |= {f"{component.name}.{n}": slow * float(component.value(n)) for n in settings}
    for kind, unit in (("pressure", "Pa"), ("angle", "rad")):
        if (name := f"{kind}_resolution") in component.interface.variables:
            own = [r for n, r in resolutions.items() if units[n] == unit]
            values[f"{component.name}.{name}"] = max([float(component.value(name)), *own])
    return trace, values, remarks


def _resolution(values: Array) -> float:
    """Step of a reading that was rounded; 0 of one that was not."""
    steps = np.diff(np.unique(values))
    steps = steps[steps > 1e-6 * max(np.ptp(values), 1e-300)]
    if len(steps) < 2:
        return 0.0
    step = float(np.quantile(steps, 0.02))
    off = (values - values[0]) / step
    return step if (np.abs(off - np.round(off)) < 0.05).mean() > 0.95 else 0.0


def _refuse_units(component: Component, trace: Trace, source: str) -> None:
    """Raise Problem if a reading cannot have the unit of its input."""
    variables = component.interface.variables
    for name, values in trace.signals.items():
        unit, size = variables[name].unit_name or "1", float(np.abs(values).max())
        if unit != "1" and trace.units.get(name) == "1":
            raise Problem(f"{source}: {name}: expected a unit like {unit}, got % or another unit of ratios")
        full = [float(component.value(n)) for n in variables if n.endswith("_full_command")]
        if unit == "K" and values.min() < COLDEST:
            raise Problem(f"{source}: {name}: expected K, got {values.min():.4g} K; did you mean degC?")
        if name.endswith("_command") and full and size > BEYOND * max(full):
            text = f"expected at most {max(full):g} {unit}, got {size:.4g} {unit}"
            raise Problem(f"{source}: {name}: {text}; did you mean % or mV?")


def _usable(component: Component, trace: Trace, source: str) -> tuple[Trace, float, list[str]]:
    """The readings without holds and single wrong ones, marked where they were interrupted; lines about it.

    The second value is the time between two of them [s], of the slowest.
    """
    variables, remarks, signals = component.interface.variables, list[str](), dict(trace.signals)
    held, alone, turned = 1.0, dict[str, Any](), dict[str, Array]()
    steps, jumps = np.diff(trace.time), np.zeros(len(trace.time) - 1)
    for name, values in trace.signals.items():
        if name.endswith("_command") or not np.ptp(values):
            continue
        if (rows_held := hold_of(values)) > 1:
            held, new = max(held, rows_held), is_new(values, trace.time)
            values = np.asarray(np.interp(trace.time, trace.time[new], values[new]), np.float64)
            signals[name] = values
        before, after = np.diff(values)[:-1], np.diff(values)[1:]
        usual = float(np.quantile(np.abs(np.diff(values)), 0.95))
        least = max(SPIKE * usual, 0.2 * np.ptp(values), ROUNDED * np.abs(values).max())
        change = np.where(before * after < 0, np.minimum(np.abs(before), np.abs(after)), 0.0)
        spikes = (change > least) & (np.abs(before + after) < 0.2 * np.abs(before))
        # not amid others that change as much, or with another reading: an arm that is shaken, a pump overrun
        spikes[1:] &= np.abs(before[:-1]) < ALONE * np.abs(before[1:])
        spikes[:-1] &= np.abs(after[1:]) < ALONE * np.abs(before[:-1])
        alone[name], turned[name] = spikes, change
    for name, spikes in alone.items():
        unit = variables[name].unit_name
        for other in (n for n in turned if n != name and variables[n].unit_name == unit):
            spikes &= turned[other] < ALONE * turned[name]
        if rows := [int(k) for k in np.flatnonzero(spikes) + 1]:
            values = signals[name]
            signals[name] = values.copy()
            signals[name][rows] = values[[k - 1 for k in rows]]
            remarks.append(
                f"{source}: {name}: outliers left out, far from the readings before and after: {len(rows)}"
            )
        if variables[name].unit_name in ("rad", "m"):
            jumps += np.abs(np.diff(signals[name])) > FASTEST * steps + OFF
    gaps, splices = (steps > GAP) & (steps > LATE * np.median(steps)), jumps > 1
    if gaps.any():
        what = f"gaps of readings: {int(gaps.sum())}, the longest of {steps.max():.3g} s"
        remarks.append(f"{source}: {what}; nothing is judged in them")
    if splices.any():
        at = f"{trace.time[int(splices.argmax()) + 1]:.6g} s"
        remarks.append(
            f"{source}: two or more angles jump at {at}: two recordings? Nothing is judged over the jump"
        )
    if "gap" in variables and (gaps | splices).any():
        off = gaps | splices
        signals["gap"] = (np.append(off, False) | np.insert(off, 0, False)).astype(np.float64)
    return Trace(trace.time, signals, trace.units), held * float(np.median(steps)), remarks


def _without(component: Component, trace: Trace, source: str) -> tuple[list[str], list[str]]:
    """Readings that are missing or constant, and lines about them."""
    variables, missing, remarks = component.interface.variables, list[str](), list[str]()
    still = _standing(component, trace)
    for name, v in variables.items():
        if v.causality != "input":
            continue
        fitted = f"{name}{FITTED}" in variables
        if name in trace.signals:
            at_rest = abs(trace.signals[name][0]) < EVEN
            even = (name.startswith("tank_") and at_rest) or (name.startswith("supply_") and not at_rest)
            if fitted and len(trace.time) > 1 and np.ptp(trace.signals[name]) == 0 and not even:
                missing += [] if name in still else [name]
                counts = still.get(name, "its sensor counts as missing")
                remarks.append(f"{source}: {name} is {trace.signals[name][0]:.6g} all the time; {counts}")
        elif fitted:
            missing.append(name)
            remarks.append(f"{source}: no column {name}; what needs it is not examined")
        elif name.endswith("_command"):
            raise Problem(f"{source}: expected the column {name}, got {first_names(trace.signals, 8)}")
        elif v.unit_name not in (None, "1"):
            remarks.append(f"{source}: no column {name}; its start value counts")
    return missing, remarks


def _standing(component: Component, trace: Trace) -> dict[str, str]:
    """Readings of functions that stand still though they are commanded, with a line that says so.

    A function does if its gyro says so, or else its angle; if both are constant, pressures that no valve
    joins to a line. If all of its readings are constant it is not known.
    """
    variables, commands = component.interface.variables, [n for n in trace if n.endswith("_command")]
    full = min((float(component.value(n)) for n in variables if n.endswith("_full_command")), default=0.0)
    rows, own = round(STANDS / float(np.median(np.diff(trace.time)))) or 1, dict[str, list[str]]()
    for name in (n for n in trace if n not in commands):
        of = (n for n in commands if name.startswith(n.removesuffix("command")))
        own.setdefault(max(of, key=len, default=""), []).append(name)
    found, count = dict[str, str](), len(trace.time) // rows
    for command in (n for n in own if n and count > 1 and np.abs(trace[n]).max() > COMMANDED * full):
        live = [n for n in own[command] if np.ptp(trace[n])]
        for units, most in MOTION.items():
            seen = [n for n in live if variables[n].unit_name in units]
            means = [trace[n][: count * rows].reshape(count, rows).mean(1) for n in seen]
            if means and all(np.ptp(np.diff(v) if "Pa" in units else v) < most for v in means):
                line = f"the {command.removesuffix('_command')} stands still under its commands"
                found |= dict.fromkeys(own[command], line)
            if means:
                break
    return found


def picture(diagnosis: Diagnosis, fmu: Path) -> Markup:
    """The machine that replays the readings, its faults marked; empty without a system next to the FMU."""
    faults = [f.name for f in diagnosis.broken]
    beside = sorted(fmu.parent.glob("*.ssp"), key=lambda path: (len(path.name), path.name))
    if not (faults and beside and diagnosis.readings):
        return Markup()
    try:
        return fragment(beside[0], Replayed(diagnosis.readings), faults=faults)
    except Problem:
        return Markup()


def learning(diagnosis: Diagnosis) -> str:
    """How many of the values of the healthy machine were learned, and which were not."""
    (component,) = diagnosis.result.system.components.values()
    known, variables = learned_values(diagnosis), component.interface.variables
    every = [f.name for f in diagnosis.findings if f"{f.name}{REFERENCE}" in variables]
    lacking = [name for name in every if f"{component.name}.{name}{REFERENCE}" not in known]
    rest = f"; not learned: {first_names(lacking, 8)}" if lacking else ""
    return f"{len(known)} of {len(every)} values of the healthy machine{rest}"


def learned_values(diagnosis: Diagnosis) -> dict[str, float]:
    """Sizes of a healthy machine as references, by parameter.

    Each is the mean with the weights of its deviations while it was told, in the last two thirds if it was
    told there.
    """
    (component,) = diagnosis.result.system.components.values()
    found = dict[str, float]()
    for f in diagnosis.findings:
        known = f.state >= 0
        if not known.any():  # what is judged against a healthy machine alone
            known = f.deviation < f.deviation[0] / KNOWN
        name = f"{f.name}{REFERENCE}"
        if name in component.interface.variables and known.any() and f.deviation[-1] > 0:
            late = known & (np.arange(len(known)) > len(known) // 3)
            weight = (late if late.any() else known) / np.maximum(f.deviation, 1e-300) ** 2
            found[f"{component.name}.{name}"] = float((weight * f.size).sum() / weight.sum())
    return found


def learned(diagnosis: Diagnosis) -> bytes:
    """The same as a parameter set (.ssv)."""
    (component,) = diagnosis.result.system.components.values()
    variables = component.interface.variables
    values = {n: (variables[n.partition(".")[2]], v) for n, v in learned_values(diagnosis).items()}
    return parameter_set("healthy", values)


def _figure(f: Finding) -> TraceFigure:
    """Size with its 95 % interval and that of the healthy machine over the time, and when it is a fault."""
    factor, unit = f.shown
    size, off = factor * f.size, INTERVAL * factor * f.deviation
    known = f.state >= 0
    size, low, high = (np.where(known, v, np.nan) for v in (size, size - off, size + off))
    line = TraceLine(f.time, size, {"color": PALETTE.ink, "linewidth": 1.3})
    dashed = {"color": PALETTE.good, "linewidth": 1.3, "linestyle": DASHES}
    healthy = TraceLine(f.time[[0, -1]], np.full(2, factor * f.healthy), dashed, "healthy")
    areas = [TraceArea(f.time, low, high, PALETTE.faint)] if off.any() else []
    state = TraceLine(f.time, f.state, {"color": PALETTE.ink, "linewidth": 1.3})
    told = TracePanel("", [state], "State", heights=(1.2, 1.0), words=STATES)
    panels = [TracePanel(unit, [line, healthy], "Size", areas=areas), told]
    return TraceFigure(panels if off.any() else panels[1:])
