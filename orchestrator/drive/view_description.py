"""The view description of a machine: the file `resources/view.toml` in its SSP or in one of its FMUs.

It declares the inputs that an operator drives, which functions the levers have and how these act on the
inputs, the signals of gauges and charts, the drawing, and the training task; no other file knows the machine.
Names are bare, without their component. Names that a system does not have are ignored. A system without the
file has sliders for its free inputs, and gauges and charts for its outputs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.files import Location
from orchestrator.base.signals import bare_name
from orchestrator.base.toml import MAX_BYTES, Rule, read_dataclass
from orchestrator.base.toml import read as read_toml
from orchestrator.base.units import factor_and_offset, parse_unit, reader_unit
from orchestrator.data import gltf
from orchestrator.drive.scene import Scene
from orchestrator.drive.task import NO_TASK, Task
from orchestrator.fmi.description import FmuVariable
from orchestrator.ssp.system import Port, System

FILE = "view.toml"
# Pa, gauge pressure; below it a gauge shows "cavitates": a cavity of some 2 mL (fmus/components/chamber.py)
CAVITATION = -5e4
MOST_GAUGES, MOST_CHARTS, MOST_SLIDERS = 24, 6, 24  # for a system without the file
MOST_WHEELS = 20  # a message of their deflections is short (`sticks.LONGEST`)
WHEELS = Rule(f"at most {MOST_WHEELS} functions", lambda value: len(value) <= MOST_WHEELS)
PAIR, SOME = Rule("two texts", lambda value: len(value) == 2), Rule("a list that is not empty", bool)
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#7d7d7d", "#cc79a7", "#e69f00", "#56b4e9")  # Okabe and Ito 2008


@dataclass(frozen=True)
class DrivenInput:
    """An input that takes commands. Its name is the first of `name` that is an input of the system.

    limit        largest magnitude, in the unit of the FMU
    rate         largest change per second, in that unit, also towards rest
    rest         value without a command
    rest_delay   time for which it keeps its value before it goes to rest [s]
    """

    name: Annotated[tuple[str, ...], SOME]
    limit: float
    rate: float
    rest: float = 0.0
    rest_delay: float = 0.0


@dataclass(frozen=True)
class Pattern:
    """The functions of the lever of each hand: sideways, then fore and aft. wheels: those of thumb wheels."""

    left: Annotated[tuple[str, ...], Rule("two functions", lambda value: len(value) == 2)]
    right: Annotated[tuple[str, ...], Rule("two functions", lambda value: len(value) == 2)]
    wheels: Annotated[tuple[str, ...], WHEELS] = ()

    @property
    def functions(self) -> tuple[str, ...]:
        """All functions, in the order of the deflections."""
        return (*self.left, *self.right, *self.wheels)


@dataclass(frozen=True)
class DriveMode:
    """Inputs that the functions of the levers drive.

    full       for each function: input -> its value at full deflection
    constant   input -> its value while the machine is driven; the mode requires all of these inputs
    words      labels of functions, in place of those of `functions`
    """

    full: Mapping[str, Mapping[str, float]]
    constant: Mapping[str, float] = field(default_factory=dict)
    words: Mapping[str, Annotated[tuple[str, ...], PAIR]] = field(default_factory=dict)

    @property
    def inputs(self) -> set[str]:
        """The inputs that it sets."""
        return {name for driven in (self.constant, *self.full.values()) for name in driven}

    def drives(self, inputs: Collection[str]) -> bool:
        """Can a machine with these inputs be driven in this mode?"""
        any_input = any(name in inputs for driven in self.full.values() for name in driven)
        return any_input and all(name in inputs for name in self.constant)


@dataclass(frozen=True)
class Notice:
    """A text that is shown while the magnitude of a signal is above a value, in the unit of the FMU."""

    name: str
    above: float
    text: str


@dataclass(frozen=True)
class Gauge:
    """One gauge: a signal, its label, the displayed unit, and the range of its bar.

    high       None: the bar grows with the largest value that the page has seen
    fmu_unit   unit of the values; default: the SI unit
    told       words in place of the unit, such as "end of stroke", by other signals
    """

    name: str
    text: str
    unit: str
    high: float | None = None
    low: float = 0.0
    digits: int = 1
    fmu_unit: str = ""
    told: tuple[Notice, ...] = ()

    def __post_init__(self) -> None:
        scale(self.unit, self.fmu_unit, f"gauge {self.name}")
        if self.high is not None and not self.high > self.low:
            raise Problem(f"gauge {self.name}: expected an end above {self.low:g}, got {self.high:g}")


@dataclass(frozen=True)
class GaugeGroup:
    """A titled group of gauges."""

    title: str
    lines: tuple[Gauge, ...]


@dataclass(frozen=True)
class ChartCurve:
    """One curve: a signal. dashed: the second of a pair."""

    name: str
    text: str
    colour: str
    dashed: bool = False


@dataclass(frozen=True)
class Chart:
    """Curves over time.

    ends       possible upper ends of the axis; the first that includes all values is used
    both       True: the axis is symmetric; False: it begins at zero
    fmu_unit   unit of the values of all signals; default: the SI unit
    """

    title: str
    unit: str
    curves: tuple[ChartCurve, ...]
    ends: Annotated[tuple[float, ...], SOME]
    both: bool = True
    fmu_unit: str = ""

    def __post_init__(self) -> None:
        scale(self.unit, self.fmu_unit, f"chart {self.title}")


@dataclass(frozen=True)
class Slider:
    """A slider of the machine on a page: an input, or a tunable parameter.

    unit       displayed unit; low, high and step are in this unit
    rate       largest change of an input per second, in its unit; default: from end to end in 1 s
    start      value at the beginning
    fmu_unit   unit of rate and start; default: the SI unit
    """

    name: str
    text: str
    unit: str
    low: float
    high: float
    step: float
    rate: float = 0.0
    start: float = 0.0
    fmu_unit: str = ""

    def __post_init__(self) -> None:
        scale(self.unit, self.fmu_unit, f"slider {self.name}")
        if not self.high > self.low:
            raise Problem(f"slider {self.name}: expected an end above {self.low:g}, got {self.high:g}")

    @property
    def ends(self) -> tuple[float, float]:
        """Lowest and highest value, in the unit of the FMU."""
        factor = scale(self.unit, self.fmu_unit)
        return self.low / factor, self.high / factor

    def driven(self, start: float) -> DrivenInput:
        """The input that it sets, which rests at its start value; all in the unit of the FMU."""
        low, high = self.ends
        return DrivenInput((self.name,), max(abs(low), abs(high), abs(start)), self.rate or high - low, start)


@dataclass(frozen=True)
class Slowed:
    """Why the machine is slower than commanded, in the status line under `title`. Names are signals.

    share       of the commanded speed that it has; below 90 % a text is shown
    driven      above 0.5 while that share counts
    uses        use of a limit, which acts above 1 -> text
    otherwise   text while none acts
    """

    title: str
    share: str
    driven: str
    uses: Annotated[Mapping[str, str], SOME]
    otherwise: str


@dataclass(frozen=True)
class ViewDescription:
    """Content of the file.

    full_pressure   end of the colour scale [Pa]
    signals         also recorded
    functions       function of a lever -> labels of its positive and negative end
    patterns        which function each lever has, by name; the first is the default
    """

    gauges: tuple[GaugeGroup, ...]
    charts: tuple[Chart, ...]
    full_pressure: float = 25e6
    signals: tuple[str, ...] = ()
    notices: tuple[Notice, ...] = ()
    axes: tuple[DrivenInput, ...] = ()
    functions: Mapping[str, Annotated[tuple[str, ...], PAIR]] = field(default_factory=dict)
    patterns: Mapping[str, Pattern] = field(default_factory=dict)
    modes: Mapping[str, DriveMode] = field(default_factory=dict)
    scene: Scene | None = None
    sliders: tuple[Slider, ...] = ()
    task: Task = NO_TASK
    slowed: Slowed | None = None

    def __post_init__(self) -> None:
        """Refuse functions that are not declared."""
        used = [(f"patterns.{n}", f) for n, p in self.patterns.items() for f in p.functions]
        used += [(f"modes.{n}", f) for n, m in self.modes.items() for f in (*m.full, *m.words)]
        for where, name in used:
            if name not in self.functions:
                hint = suggest(name, self.functions) or f"; there are {', '.join(self.functions) or 'none'}"
                raise Problem(f"{where}: unknown function {name!r}{hint}")

    def free(self, axes: Iterable[str]) -> list[str]:
        """Bare names of the axes that no mode of the sticks drives."""
        driven = {name for mode in self.modes.values() for name in mode.inputs}
        return [bare for bare in map(bare_name, axes) if bare not in driven]

    @property
    def curves(self) -> tuple[str, ...]:
        """The signals of the charts."""
        return tuple(curve.name for chart in self.charts for curve in chart.curves)

    @property
    def shown(self) -> tuple[str, ...]:
        """All signals that the page uses, in the order in which they are recorded."""
        scene = self.scene
        drawn = (*scene.signals, *scene.pressures.values()) if scene else ()
        lines = [line for group in self.gauges for line in group.lines]
        told = (notice.name for notice in (*self.notices, *(n for line in lines for n in line.told)))
        return tuple(dict.fromkeys((*drawn, *(g.name for g in lines), *self.curves, *told, *self.signals)))

    def driven(self, system: System) -> Mapping[str, DrivenInput]:
        """Inputs that an operator drives, by name: those in the file, and the free inputs that have a slider.

        Raises `Problem` if none of those in the file exists.
        """
        inputs = {port.variable for port in system.ports("input")}
        named = [(next((n for n in a.name if n in inputs), None), a) for a in self.axes]
        axes = {name: driven for name, driven in named if name}
        if self.axes and not axes:
            expected = f"expected an input to drive, such as {self.axes[0].name[-1]}"
            found = ", ".join(sorted(inputs)[:6]) or "none"
            raise Problem(f"{system.source or system.name}: {expected}, found {found}")
        free = {port.variable: port for port in _free_inputs(system)}
        slid = (s for s in self.sliders if s.name in free and s.name not in axes)
        return axes | {s.name: s.driven(_start(system, free[s.name])) for s in slid}

    def watched(self, system: System) -> tuple[str, ...]:
        """`component.variable` of the shown outputs that the system has.

        Outputs with the name of a driven input, such as those of a lever program, are left out.
        """
        driven = self.driven(system)
        outputs = by_bare_name(str(port) for port in system.ports("output"))
        return tuple(dict.fromkeys(outputs[n] for n in self.shown if n in outputs and n not in driven))


def view_description(system: System) -> ViewDescription:
    """The file of a system or of its first FMU that has one; else gauges and charts of its outputs."""
    name, source = f"resources/{FILE}", system.source
    places = list[Callable[[str], Location]]()
    places += [source.resolve] if source and str(source).endswith(".ssd") else []
    places += [component.source.member for component in system.components.values() if component.source]
    place = next((place for place in places if place(name).exists), None)
    if place is None:
        return of_variables(system)
    file = place(name)
    try:
        return _with_meshes(
            read_dataclass(ViewDescription, read_toml(Path(str(file)), file.read(MAX_BYTES))), place
        )
    except Problem as problem:
        raise Problem(f"{problem}; build a system again that another version built") from None


def _with_meshes(description: ViewDescription, place: Callable[[str], Location]) -> ViewDescription:
    """With the meshes of its scene, which are beside it; place: of a name in the system or FMU."""
    scene, meshes = description.scene, dict[str, tuple[gltf.Mesh, ...]]()
    for name in {shape.file for shape in scene.shapes if shape.kind == "mesh"} if scene else ():
        meshes[name] = gltf.read_file(place(f"resources/{name}"))
    return replace(description, scene=replace(scene, meshes=meshes)) if scene else description


def of_variables(system: System) -> ViewDescription:
    """Gauges for the real outputs, grouped by unit, charts of the first, and sliders for the free inputs."""
    names = by_bare_name(str(port) for port in system.ports("output"))
    outputs = {bare: system.variable(system.port(name)) for bare, name in names.items()}
    by_unit = dict[tuple[str, str], list[str]]()
    for bare, variable in [(n, v) for n, v in outputs.items() if v.is_real][:MOST_GAUGES]:
        by_unit.setdefault(_units(variable), []).append(bare)
    ends = tuple(m * 10.0**k for k in range(-3, 13) for m in (1, 2, 5))
    groups, charts = list[GaugeGroup](), list[Chart]()
    for (unit, fmu_unit), shown in by_unit.items():
        texts = [name.replace("_", " ") for name in shown]
        lines = (_gauge(n, text, outputs[n]) for n, text in zip(shown, texts, strict=True))
        groups.append(GaugeGroup(unit, tuple(lines)))
        curves = tuple(map(ChartCurve, shown, texts, COLOURS))
        charts.append(Chart("Outputs", unit, curves, ends, fmu_unit=fmu_unit))
    sliders = tuple(_slider(system, port) for port in _free_inputs(system)[:MOST_SLIDERS])
    return ViewDescription(tuple(groups), tuple(charts[:MOST_CHARTS]), sliders=sliders)


def _gauge(name: str, text: str, variable: FmuVariable) -> Gauge:
    """From the declared minimum to the maximum if there are both, else without ends."""
    unit, fmu_unit = _units(variable)
    low, high = (bound * scale(unit, fmu_unit) for bound in variable.bounds)
    if not math.isfinite(high - low) or low >= high:
        return Gauge(name, text, unit, fmu_unit=fmu_unit)
    digits = max(0, 2 - math.floor(math.log10(max(-low, high))))  # three that count, as in panels.js
    return Gauge(name, text, unit, high, low, digits, fmu_unit)


def _free_inputs(system: System) -> list[Port]:
    """Real inputs without a connection, but for those that take the slope of another one."""
    taken = {connection.target for connection in system.connections}
    for name, component in system.components.items():
        taken |= {Port(name, slope) for slope in component.interface.rate_inputs.values()}
    free = {port.variable: port for port in system.ports("input") if port not in taken}
    return [port for port in free.values() if system.variable(port).is_real]


def _start(system: System, port: Port) -> float:
    """The start value of an input; 0 without one."""
    start = float(system.components[port.component].value(port.variable))
    return start if math.isfinite(start) else 0.0


def _slider(system: System, port: Port) -> Slider:
    """From the declared minimum to the maximum, else as far around the start value as it is large.

    It goes from end to end within 1 s.
    """
    variable, start = system.variable(port), _start(system, port)
    reach = 2 * abs(start) or variable.nominal or 1.0
    low, high = (
        bound if math.isfinite(bound) else start + sign * reach
        for sign, bound in zip((-1, 1), variable.bounds, strict=True)
    )
    if not low < high:
        low, high = start - reach, start + reach
    unit, fmu_unit = _units(variable)
    factor = scale(unit, fmu_unit)
    step = 10.0 ** math.floor(math.log10(factor * (high - low) / 200))
    text = port.variable.replace("_", " ")
    return Slider(port.variable, text, unit, factor * low, factor * high, step, high - low, start, fmu_unit)


def _units(variable: FmuVariable) -> tuple[str, str]:
    """The displayed unit, and that of the FMU; "1" for an unknown unit."""
    unit = variable.unit.name if variable.unit else "1"
    try:
        parse_unit(unit)
    except Problem:
        return "1", "1"
    shown = reader_unit(unit)
    return (unit, unit) if parse_unit(shown).offset != parse_unit(unit).offset else (shown, unit)


def scale(unit: str, fmu_unit: str, context: str = "") -> float:
    """Factor from the unit of the FMU, or the SI unit, to the displayed unit; raises `Problem`."""
    return factor_and_offset(fmu_unit, unit, context)[0] if fmu_unit else 1 / parse_unit(unit, context).factor


def by_bare_name(names: Iterable[str]) -> Mapping[str, str]:
    """Bare name -> full name.

    If several components have the name, the one whose name is its prefix is used: `supply_flow` is the
    variable of `supply`, not of a drive.
    """
    full = dict[str, str]()
    for name in names:
        component, _, bare = name.rpartition(".")
        if bare not in full or (component and bare.startswith(component.rpartition(".")[2])):
            full[bare] = name
    return full
