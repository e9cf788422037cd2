"""A scenario: the inputs that it drives, their values over time, and the connections that it replaces."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem, Unsupported, suggest
from orchestrator.base.files import SIMILAR, Location, find
from orchestrator.base.options import seconds
from orchestrator.base.signals import bare_name
from orchestrator.base.text import first_names
from orchestrator.base.units import IDENTITY, LinearTransformation, from_user_unit
from orchestrator.data.table import READABLE, Array
from orchestrator.data.trace import JUMP, Data, Trace, as_trace, read_trace
from orchestrator.fmi.description import WHOLE, FmuVariable, Value
from orchestrator.ssp.system import Port, System

if TYPE_CHECKING:
    from orchestrator.engine.c_library import Binding
    from orchestrator.engine.time_grid import Grid
    from orchestrator.fmi.calls import Call

# Change of slope at a sample, times the shorter interval next to it, over the range of the column:
ALWAYS_CORNER = 1e-3  # above this value the sample is a corner
NEVER_CORNER = 1e-6  # below this value the sample is not a corner
# between them it is a corner if the change exceeds those at both neighbours by this factor
CORNER_RATIO = 10.0


class ScenarioFile(NamedTuple):
    """The scenario of a user: its trace, its name in messages, and its file; None without them."""

    trace: Trace | None
    label: str
    file: Path | Location | None


ScenarioSource: TypeAlias = "Data | str | Path | Location | ScenarioFile | None"


def read_scenario(scenario: ScenarioSource) -> ScenarioFile:
    """The scenario in a file or in other data; once read, as it is."""
    if isinstance(scenario, ScenarioFile):
        return scenario
    if isinstance(scenario, str | Path):
        scenario = find(scenario, READABLE)
    if isinstance(scenario, Path | Location):
        return ScenarioFile(read_trace(scenario), str(scenario), scenario)
    return ScenarioFile(None if scenario is None else as_trace(scenario, "scenario"), "scenario", None)


class ScenarioTable:
    """Columns over time: linear between the samples, held before the first and after the last.

    Where two samples have the same time, columns jump from the first to the second.
    """

    def __init__(self, time: NDArray[np.float64], columns: NDArray[np.float64]) -> None:
        """time: shape (n,) [s], increasing. columns: shape (n, k).

        arrays   for C: times [s]; of each interval the values at its anchor, the slopes, and the anchor [s]
        """
        intervals, changes = np.diff(time)[:, None], np.diff(columns, axis=0)
        slopes = np.divide(changes, intervals, out=np.zeros_like(changes), where=intervals > 0)
        hold = np.zeros((1, columns.shape[1]))
        self._slopes = np.concatenate([hold, slopes, hold])
        self._base = np.concatenate([columns[:1], columns])
        anchor = np.concatenate([time[:1], time]).astype(np.float64)
        self.arrays = time.astype(np.float64), self._base, self._slopes, anchor

    def on(self, times: Grid) -> ScenarioTable:
        """The table whose samples at communication points have exactly their times, whatever the rounding."""
        time = times.aligned(self.arrays[0])
        if np.array_equal(time, self.arrays[0]):
            return self
        table = copy(self)
        table.arrays = time, self._base, self._slopes, np.concatenate([time[:1], time])
        return table

    @property
    def jumps(self) -> Array:
        """Times [s] at which columns jump, shape (n,)."""
        time: Array = self.arrays[0]
        jumps: Array = time[1:][time[1:] == time[:-1]]
        return jumps

    def delayed(self, times: Grid) -> ScenarioTable:
        """The table whose columns jump at communication points only.

        A column that jumps inside a step holds the value of its beginning, and jumps at its end. Others have
        a straight line; at a jump of another column they may have moved a little.
        """
        time, columns, slopes = self.arrays[0], self._base[1:], np.abs(self._slopes)
        moves = 2.0 * JUMP * np.maximum(slopes[:-2], slopes[2:])
        at, sizes, jumps = time[1:], np.abs(np.diff(columns, axis=0)), self.jumps
        jumping = (at == time[:-1])[:, None] & (sizes > moves)
        begins = np.unique(times.before(jumps[jumps != times.nearest(jumps)]))
        ends, rows = times.nearest(begins + times.step), list[Array]()
        for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
            first, last = np.searchsorted(at, begin, side="right"), np.searchsorted(at, end)
            held = jumping[first:last].any(axis=0)
            rows += [self.at(begin), np.where(held, self.at(begin), self.at(end, before=True)), self.at(end)]
        step = np.searchsorted(begins, time) - 1
        kept = (step < 0) | (time >= ends[step])
        places = np.repeat(np.searchsorted(time[kept], begins, side="right"), 3)
        time = np.insert(time[kept], places, np.column_stack([begins, ends, ends]).ravel())
        return ScenarioTable(time, np.insert(columns[kept], places, rows, axis=0))

    def interval(self, t: float) -> int:
        """Index of the interval that contains t; interval 0 is before the first sample."""
        return int(np.searchsorted(self.arrays[0], t, side="right"))

    def at(self, t: float, before: bool = False) -> NDArray[np.float64]:
        """All columns at time t [s], shape (k,); at a jump after it, or before it."""
        k = int(np.searchsorted(self.arrays[0], t, side="left")) if before else self.interval(t)
        return np.asarray(self._base[k] + (t - self.arrays[3][k]) * self._slopes[k])

    def corners(self) -> list[float]:
        """Times [s] at which the slope of a column jumps.

        The ends of ramps are corners. Samples of a smooth curve are not, because the slope changes by similar
        amounts at all of them.
        """
        jumps = np.abs(np.diff(self._slopes, axis=0))  # at each sample
        intervals = np.diff(self.arrays[0])
        shorter = np.minimum(np.append(intervals, np.inf), np.insert(intervals, 0, np.inf))  # 0 at a jump
        ranges = np.ptp(self._base, axis=0)
        relative = shorter[:, None] * jumps / np.where(ranges > 0, ranges, np.inf)
        padded = np.pad(relative, ((1, 1), (0, 0)))
        neighbours = np.maximum(padded[:-2], padded[2:])
        isolated = (relative > CORNER_RATIO * neighbours) & (relative > NEVER_CORNER)
        is_corner = ((relative > ALWAYS_CORNER) | isolated).any(axis=1)
        return [float(t) for t in self.arrays[0][is_corner]]

    def slope(self, t: float) -> NDArray[np.float64]:
        """The slopes just after t, shape (k,)."""
        return np.asarray(self._slopes[self.interval(t)])

    def sample(self, t: float) -> NDArray[np.float64]:
        """The last sample at or before t, for inputs that are not continuous, shape (k,)."""
        return np.asarray(self._base[self.interval(t)])


@dataclass(frozen=True)
class Scenario:
    """Inputs and the columns of a table that drive them: input -> column and linear map.

    passed   inputs of the system that are passed to its outputs -> column
    """

    table: ScenarioTable
    columns: Mapping[Port, tuple[int, LinearTransformation]]
    passed: Mapping[Port, int] = field(default_factory=dict)

    def released(self, system: System) -> System:
        """The system without the connections that the scenario replaces.

        A component without inputs is a scenario itself: if the scenario drives one of the inputs that it
        feeds, all its connections are removed, and the other inputs keep their start values. A connection to
        the declared rate input of a driven input is removed too. A connection to an undeclared rate input
        stays: the slope that the run sets takes precedence over it.
        """
        targets = {*self.columns, *self.rates(system)}
        replaced = [c for c in system.connections if c.target in targets]
        sources = dict.fromkeys(c.source.component for c in replaced)
        signal_sources = [name for name in sources if not system.components[name].interface.of("input")]
        notes = [self._replacement_note(system, component) for component in signal_sources]
        others = [str(c) for c in replaced if c.source.component not in signal_sources]
        notes += [f"the scenario replaces {', '.join(others)}"] if others else []
        dropped = {*replaced, *(c for c in system.connections if c.source.component in signal_sources)}
        kept = tuple(c for c in system.connections if c not in dropped)
        notes, instead = [*system.notes, *notes], (*system.driven_instead, *signal_sources)
        return replace(system, connections=kept, notes=tuple(notes), driven_instead=instead)

    def on(self, times: Grid, system: System, divides: bool) -> tuple[Scenario, Grid]:
        """The scenario on a grid, and the grid with its jumps.

        divides   steps are divided at its corners, too

        FMUs with a fixed step get a jump at the communication point that follows.
        """
        table = self.table.on(times)
        fixed = [name for name, c in system.components.items() if not c.interface.variable_step]
        jumps = table.jumps[(table.jumps > times.start) & (table.jumps < times.stop)]
        if fixed and (jumps != times.nearest(jumps)).any():
            late = f"{first_names(fixed)}: the FMU has a fixed step: jumps inside of a step act at its end"
            table, times = table.delayed(times), replace(times, notes=(*times.notes, late))
        corners = tuple(table.corners() if divides else ())
        return replace(self, table=table), replace(times, jumps=tuple(table.jumps.tolist()), corners=corners)

    def rates(self, system: System) -> dict[Port, Port]:
        """The inputs that are declared as time derivatives of driven inputs, and these inputs."""
        rates, continuous = system.rate_ports, [p for p in self.columns if system.variable(p).is_continuous]
        found = {rates[port]: port for port in continuous if port in rates}
        return {rate: port for rate, port in found.items() if rate not in self.columns}

    def _slopes(self, system: System) -> Iterator[Port]:
        """The rate inputs, by name, of driven inputs whose slope is set by the run."""
        for port in self.columns:
            if port.variable in system.components[port.component].interface.ramp_inputs:
                yield Port(port.component, f"{port.variable}_rate")

    def _replacement_note(self, system: System, component: str) -> str:
        targets = [c.target for c in system.connections if c.source.component == component]
        covered = {*self.columns, *self.rates(system), *self._slopes(system)}
        uncovered = ", ".join(str(port) for port in targets if port not in covered)
        consequence = (
            f"; inputs that are not in the scenario keep their start values: {uncovered}" if uncovered else ""
        )
        return f"the scenario replaces {component}{consequence}"

    def initial(self, system: System, t: float) -> dict[Port, Value]:
        """Values of the driven inputs at the start."""
        interpolated, sampled = self.table.at(t), self.table.sample(t)
        values: dict[Port, Value] = {}
        for port, (column, linear) in self.columns.items():
            variable = system.variable(port)
            if variable.is_real:
                values[port] = linear(float((interpolated if variable.is_continuous else sampled)[column]))
            else:
                values[port] = int(linear(float(round(float(sampled[column])))))
        for rate, port in self.rates(system).items():
            column, linear = self.columns[port]
            values[rate] = linear.factor * float(self.table.slope(t)[column])
        return values

    def overruled(self, system: System, start: Mapping[str, Value | str]) -> tuple[str, ...]:
        """Notes on start values that have no effect, because the scenario drives the input."""
        names = [name for name in start if any(port in self.columns for port, _ in system.targets(name))]
        return tuple(
            f"{n} is driven by the scenario: the start value {start[n]} has no effect" for n in names
        )


def drive(system: System, trace: Trace, label: str = "scenario") -> Scenario:
    """The scenario in a trace, whose columns have names that `System.targets` accepts.

    A column with another unit than its input is converted.
    """
    if not trace.signals:
        raise Problem(f"{label}: expected a column for each input to drive, got none besides 'time'")
    columns: dict[Port, tuple[int, LinearTransformation]] = {}
    for k, name in enumerate(trace.signals):
        for port, linear in _targets(system, name, label):
            if port in columns:
                raise Problem(f"{label}: column {name!r} drives {port}, which another column drives too")
            unit = system.inputs[name].unit if name in system.inputs else system.unit(port)
            given = trace.units.get(name)
            if given == "1" and unit and unit.name not in ("", "1"):
                full = (system.variable(port).nominal or 1.0) / 100
                entry = f'unit = "{unit.name}", factor = {full:g} in {Path(label).with_suffix(".toml")}'
                share = f"of a command say how many {unit.name} are 100 %, such as {entry}"
                raise Problem(f"{label}: column {name!r}: unit '%' or '1': {share}")
            if unit and given and given != unit.name:
                linear = from_user_unit(given, unit, f"{label}: column {name!r}").then(linear)
            columns[port] = (k, linear)
    table = np.stack([np.asarray(v, dtype=np.float64) for v in trace.signals.values()], axis=1)
    moving = {k for port, (k, _) in columns.items() if system.variable(port).is_continuous}
    held = {k for k, _ in columns.values()} - moving
    for port, (k, _) in columns.items():
        _check_integers(
            system.variable(port), trace.time, table[:, k], f"{label}: column {[*trace.signals][k]!r}"
        )
    passed = {Port("", name): k for k, name in enumerate(trace.signals) if system.passed(name)}
    return Scenario(ScenarioTable(*_with_jumps(trace.time, table, [*held])), columns, passed)


def _with_jumps(time: Array, columns: Array, held: Sequence[int]) -> tuple[Array, Array]:
    """Samples with two of the same time at each jump: a ramp of `JUMP` at most, or a change of a held column.

    held   columns that drive inputs which are not continuous
    """
    time = time.astype(np.float64)
    long = np.diff(time) > JUMP + 4.0 * np.spacing(np.abs(time[1:]))
    alone = np.append(True, long[:-1]) & np.append(long[1:], True)
    feet = np.flatnonzero(~long & alone)
    time[feet] = time[feet + 1]
    changes = (np.diff(columns[:, held], axis=0) != 0.0).any(axis=1)
    tops = 1 + np.flatnonzero(changes & (np.diff(time) > 0.0))
    before = columns[tops]
    before[:, held] = columns[tops - 1][:, held]
    return np.insert(time, tops, time[tops]), np.insert(columns, tops, before, axis=0)


def _check_integers(variable: FmuVariable, time: Array, values: Array, context: str) -> None:
    """Refuse fractions for an Integer, Enumeration or Boolean variable, and what a float64 may round."""
    wrong = ~(np.abs(values) <= WHOLE) | (values != np.rint(values))
    if not variable.is_real and wrong.any():
        k = int(np.argmax(wrong))
        expected = "0 or 1, a Boolean" if variable.kind == "Boolean" else f"whole numbers up to {WHOLE}"
        value = f"{values[k]:.{17 if values[k].is_integer() else 15}g}"
        raise Problem(f"{context}: expected {expected}, got {value} in row {k + 1}, at {time[k]:.9g} s")


def _targets(system: System, name: str, label: str) -> tuple[tuple[Port, LinearTransformation], ...]:
    """The inputs that a column drives."""
    try:
        tuned = [p for p in system.ports("parameter") if p.variable == name and _tunable(system.variable(p))]
        is_input = name in system.inputs or name in {p.variable for p in system.ports("input")}
        meant = [name] if is_input or not tuned else [*map(str, tuned)]
        targets = tuple(target for one in meant for target in system.targets(one))
    except Problem as problem:
        if isinstance(problem, Unsupported) or name in {p.variable for p in system.ports("input")}:
            raise Problem(f"{label}: column {problem}") from None
        inputs = system.ports("input")
        names = dict.fromkeys([*system.inputs, *(p.variable for p in inputs)])
        suggestion = suggest(name, [*names, *map(str, inputs)])
        found = f"inputs: {', '.join(names) or 'none'}"
        raise Problem(
            f"{label}: column {name!r} is not an input of the system{suggestion}; {found}"
        ) from None
    for port, _ in targets:
        variable = system.variable(port)
        if (variable.causality != "input" and not _tunable(variable)) or not variable.is_number:
            got = f"{variable.kind} {variable.causality}{f' {port}' * (name != str(port))}"
            raise Problem(f"{label}: column {name!r}: expected an input or a tunable parameter, got a {got}")
    return targets


def _tunable(variable: FmuVariable) -> bool:
    """Is it a parameter that may be set at communication points (FMI 2.0.5, 2.2.7)?"""
    return variable.causality == "parameter" and variable.variability == "tunable"


# ---- for the engine in C


# members of `Scenario` in engine.h for continuous, discrete, integer, rate and passed inputs: columns of the
# table, indices of the targets, factors and offsets of the maps between them; "": C needs none
MEMBERS = (
    ("columns", "targets", "factor", "offset"),
    ("discrete_columns", "discrete", "discrete_factor", "discrete_offset"),
    ("integer_columns", "integers", "integer_factor", "integer_offset"),
    ("rate_columns", "rates", "rate_factor", ""),
    ("passed_columns", "passed", "", ""),
)
COUNTS = ("count", "discrete_count", "integer_count", "rate_count", "passed_count")


class DrivenInputs:
    """The inputs that a scenario drives, for native/scenario.c.

    continuous   continuous Real inputs, which follow a straight line over a step; their rate inputs have the
                 slope at communication points, because rate outputs depend on it
    held         discrete Real inputs, and Integer, Enumeration and Boolean inputs, which keep the value of
                 the last sample
    """

    def __init__(
        self,
        scenario: Scenario,
        system: System,
        reals: Mapping[Port, int],
        integers: Mapping[Port, int],
        set_calls: Sequence[Call],
    ) -> None:
        """reals, integers: index of each port in the arrays of values; set_calls: set the driven inputs."""
        of_system = {p: (k, IDENTITY) for p, k in scenario.passed.items() if p in reals or p in integers}
        columns = {**scenario.columns, **of_system}
        variables = {port: system.variable(port) for port in columns}
        self.continuous = [p for p, v in variables.items() if v.is_continuous and p.component]
        passed = [p for p, v in variables.items() if v.is_continuous and not p.component]
        discrete = [p for p, v in variables.items() if v.is_real and not v.is_continuous]
        others = [p for p, v in variables.items() if not v.is_real]
        rates = {rate: columns[port] for rate, port in scenario.rates(system).items()}
        self.table, self.set_calls, self.held = scenario.table, set_calls, [*discrete, *others]
        self.mapped = [(columns[p][0], integers[p], columns[p][1]) for p in others]
        self.at_end, self.at_midpoint = np.zeros(len(self.continuous)), np.zeros(len(self.continuous))
        self._arrays, self._counts = dict[str, NDArray[Any]](), dict[str, int]()
        groups = (self.continuous, discrete, others, rates, passed)
        for names, count, targets in zip(MEMBERS, COUNTS, groups, strict=True):
            index, kind = (integers, np.int64) if targets is others else (reals, np.float64)
            sources = [rates[p] if p in rates else columns[p] for p in targets]
            arrays = (
                np.array([column for column, _ in sources], np.int64),
                np.array([index[p] for p in targets], np.int64),
                np.array([linear.factor for _, linear in sources]).astype(kind),
                np.array([linear.offset for _, linear in sources]).astype(kind),
            )
            self._arrays |= {name: array for name, array in zip(names, arrays, strict=True) if name}
            self._counts[count] = len(targets)

    def members(self, at: Callable[[NDArray[Any]], int], inputs: Sequence[int]) -> dict[str, int]:
        """The members of the C structure that any number of machines have in common; `at`: the address.

        inputs   index of each continuous input among the coupling inputs
        """
        arrays = dict(zip(("time", "base", "slopes", "anchor"), self.table.arrays, strict=True))
        sizes = {"samples": len(arrays["time"]), "width": arrays["base"].shape[1], **self._counts}
        arrays |= {**self._arrays, "inputs": np.array(inputs, np.int32)}
        return {name: at(array) for name, array in arrays.items()} | sizes

    def fill(self, binding: Binding, inputs: Sequence[int]) -> Any:
        """Fill the C structure, and return it; inputs: index of each continuous input among all inputs."""
        struct = binding.h.Scenario(
            **self.members(binding.constant, inputs),
            **binding.all_at(self, "at_end at_midpoint"),
            evaluated_at=np.nan,
            since=np.nan,
            table=binding.value_table(self.mapped),
            input_writes=binding.program(self.set_calls),
        )
        binding.simulation.scenario = binding.pointer(struct)
        return struct


def with_changes(
    system: System,
    trace: Trace | None,
    changes: Mapping[str, Value | str],
    span: tuple[float, float],
    label: str = "scenario",
) -> Trace:
    """A scenario with more inputs, which jump from value to value.

    changes   name -> "VALUE@TIME", several with commas; without a time from the start of the span [s] on
    label     of the scenario, for messages
    """
    for name in changes:
        if trace is not None and name in trace.signals:
            raise Problem(f"fault {name}: expected an input that the scenario does not drive")
    columns = {name: values_over_time(system, name, str(text), *span) for name, text in changes.items()}
    time = np.unique(np.concatenate([[*span], *(t for t, _ in columns.values())]))
    if trace is not None:
        time = np.unique(np.concatenate([time, trace.time]))
    known, held = Trace(time, {}), dict[str, Array]()
    if trace is not None:
        known, rows = trace.at(time), np.searchsorted(trace.time, time, side="right") - 1
        for name, values in trace.signals.items():
            if any(not system.variable(port).is_continuous for port, _ in _targets(system, name, label)):
                held[name] = values[np.maximum(rows, 0)]
    added = {name: np.interp(time, *steps) for name, steps in columns.items()}
    return replace(known, signals={**known.signals, **held, **added})


def values_over_time(
    system: System, name: str, text: str, begin: float, end: float = inf
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners of an input that takes values at times within a span [s]: times [s], and values in its unit."""
    if not get_close_matches(
        bare_name(name), map(bare_name, [*system.names(), *system.inputs]), cutoff=SIMILAR
    ):
        built = "FMUs have faults as inputs if they were made by: harvester build --faults"
        raise Problem(f"fault {name}: unknown variable; {built}")
    port, items = system.targets(name)[0][0], text.split(",")
    times, values = [begin], [float(system.components[port.component].value(port.variable))]
    for item in items:
        given, _, at = item.partition("@")
        if not at and len(items) > 1:
            hint = "; a decimal point separates digits, a comma values" if len(items) == 2 else ""
            raise Problem(f"fault {name}: expected VALUE@TIME for each of several values, got {item!r}{hint}")
        started = system.with_start({name: given}, origin="")
        value = float(started.components[port.component].value(port.variable))
        time = float(seconds(at, f"fault {name}") or 0.0) if at else begin
        if not (isfinite(value) and isfinite(time)):
            raise Problem(f"fault {name}: expected finite numbers, got {item}")
        if not begin <= time < end:
            raise Problem(f"fault {name}: expected a time from {begin:g} s to {end:g} s, the end, got {at}")
        if time < times[-1] and len(times) > 1:
            raise Problem(f"fault {name}: expected times in order, got {at} after {times[-1]:g} s")
        if not at:
            return np.array([begin]), np.array([value])
        if time <= times[-1]:  # the start, or the last value given for this time
            values[-1] = value
            continue
        times += [max(time - JUMP, np.nextafter(times[-1], inf)), time]
        values += [values[-1], value]
    return np.array(times), np.array(values)
