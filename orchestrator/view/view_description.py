"""What a machine says of itself to the view: `resources/view.toml` in its SSP or in one of its FMUs.

The file tells which inputs an operator drives and what the functions of the sticks mean for them, which
signals are gauges and charts, and which are the joints and pressures of the drawing. Names are bare, without
their component. What a system does not have is left out. A system without the file can be watched: its
outputs become gauges and charts. `SignalIndex` finds the bare names in the frames of any machine.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from orchestrator.base.errors import Problem
from orchestrator.base.toml import Rule, read_dataclass
from orchestrator.base.toml import read as read_toml
from orchestrator.base.units import parse, reader_unit
from orchestrator.realtime.setup import Axis, Frame, Machine
from orchestrator.ssp.system import System

FILE = "view.toml"
MOST_GAUGES, MOST_CHARTS, MOST_CURVES = 24, 3, 7  # of a system without the file
RANGE = 200.0  # of its gauges, in the unit that is shown
PAIR, SOME = Rule("two texts", lambda value: len(value) == 2), Rule("a list that is not empty", bool)
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#7d7d7d", "#cc79a7", "#e69f00", "#56b4e9")  # Okabe and Ito 2008


@dataclass(frozen=True)
class DrivenInput:
    """An `Axis`; of several names the first that the system has as an input."""

    name: Annotated[tuple[str, ...], SOME]
    limit: float
    rate: float
    rest: float = 0.0
    rest_delay: float = 0.0


@dataclass(frozen=True)
class FullDeflection:
    """For each function: input -> its value at full deflection."""

    swing: Mapping[str, float] = field(default_factory=dict)
    boom: Mapping[str, float] = field(default_factory=dict)
    stick: Mapping[str, float] = field(default_factory=dict)
    curl: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class FunctionWords:
    """The positive and the negative end of a function."""

    boom: Annotated[tuple[str, ...], PAIR] = ("boom up", "boom down")
    stick: Annotated[tuple[str, ...], PAIR] = ("stick in", "stick out")


@dataclass(frozen=True)
class DriveMode:
    """What the functions of the sticks (swing, boom, stick) drive.

    constant   input -> its value while somebody drives; the mode needs all of them
    words      what the page writes at the ends of the sticks
    """

    full: FullDeflection
    constant: Mapping[str, float] = field(default_factory=dict)
    words: FunctionWords = FunctionWords()

    def drives(self, inputs: Collection[str]) -> bool:
        """Can a machine with these inputs be driven in this mode?"""
        any_input = any(name in inputs for driven in vars(self.full).values() for name in driven)
        return any_input and all(name in inputs for name in self.constant)


@dataclass(frozen=True)
class Gauge:
    """One line: a signal in SI units, its text, the unit that it is shown in, and the ends of its bar."""

    name: str
    text: str
    unit: str
    high: float
    low: float = 0.0
    digits: int = 1

    def __post_init__(self) -> None:
        parse(self.unit, f"gauge {self.name}")
        if not self.high > self.low:
            raise Problem(f"gauge {self.name}: expected an end above {self.low:g}, got {self.high:g}")

    @property
    def factor(self) -> float:
        """From the SI to the unit."""
        return 1.0 / parse(self.unit).factor

    @property
    def is_pressure(self) -> bool:
        """The bar of a pressure has its colour."""
        return parse(self.unit).base() == parse("Pa").base()


@dataclass(frozen=True)
class GaugeGroup:
    """Gauges under a title."""

    title: str
    lines: tuple[Gauge, ...]


@dataclass(frozen=True)
class ChartCurve:
    """A signal in SI units; `dashed` is the second of a pair."""

    name: str
    text: str
    colour: str
    dashed: bool = False


@dataclass(frozen=True)
class Chart:
    """Curves over time, and where the axis may end: at the first that is enough.

    both   the axis goes as far below zero; else it begins there
    """

    title: str
    unit: str
    curves: tuple[ChartCurve, ...]
    ends: Annotated[tuple[float, ...], SOME]
    both: bool = True

    def __post_init__(self) -> None:
        parse(self.unit, f"chart {self.title}")

    @property
    def factor(self) -> float:
        """From the SI to the unit."""
        return 1.0 / parse(self.unit).factor


@dataclass(frozen=True)
class SceneSignals:
    """What moves and colours the drawing.

    joints      angles of swing, boom, stick and head, the last in the plane of the arm and out of it
    initial     the parameters with the first of them at the start
    pressures   part of the drawing -> its pressure
    """

    joints: Annotated[tuple[str, ...], Rule("five angles", lambda value: len(value) == 5)]
    initial: Annotated[tuple[str, ...], Rule("three parameters", lambda value: len(value) == 3)]
    pressures: Mapping[str, str]


@dataclass(frozen=True)
class ViewDescription:
    """The file. `full_pressure` ends the scale of colours [Pa]; `signals` are watched, too."""

    gauges: tuple[GaugeGroup, ...]
    charts: tuple[Chart, ...]
    full_pressure: float = 25e6
    signals: tuple[str, ...] = ()
    axes: tuple[DrivenInput, ...] = ()
    modes: Mapping[str, DriveMode] = field(default_factory=dict)
    scene: SceneSignals | None = None

    @property
    def curves(self) -> tuple[str, ...]:
        """The signals of the charts."""
        return tuple(curve.name for chart in self.charts for curve in chart.curves)

    @property
    def shown(self) -> tuple[str, ...]:
        """All signals that the page reads, in the order in which they are recorded."""
        scene = self.scene
        drawn = (*scene.joints, *scene.pressures.values()) if scene else ()
        gauges = (line.name for group in self.gauges for line in group.lines)
        return tuple(dict.fromkeys((*drawn, *gauges, *self.curves, *self.signals)))

    def driven(self, system: System) -> tuple[Axis, ...]:
        """The inputs of a system that an operator drives; Problem if it has none of those in the file."""
        inputs = {port.variable for port in system.ports("input")}
        named = [(next((n for n in a.name if n in inputs), None), a) for a in self.axes]
        found = tuple(Axis(n, a.limit, a.rate, a.rest, a.rest_delay) for n, a in named if n)
        if self.axes and not found:
            raise Problem(
                f"{system.source or system.name}: expected an input to drive, such as"
                f" {self.axes[0].name[-1]}, found {', '.join(sorted(inputs)[:6]) or 'none'}"
            )
        return found

    def watched(self, system: System) -> tuple[str, ...]:
        """`component.variable` of the outputs that are shown, as far as the system has them.

        What would drive a driven input otherwise, such as a program of levers, is not shown.
        """
        driven = {axis.name for axis in self.driven(system)}
        found = by_bare_name(str(port) for port in system.ports("output"))
        return tuple(dict.fromkeys(found[n] for n in self.shown if n in found and n not in driven))


def view_description(system: System) -> ViewDescription:
    """The file of a system, or of the first FMU in it that has one; else its outputs as gauges and charts."""
    name, home = f"resources/{FILE}", system.source
    files = [home.resolve(name)] if home and str(home).endswith(".ssd") else []
    files += [component.source.member(name) for component in system.components.values() if component.source]
    for file in files:
        with suppress(Problem):  # there is no such file
            data = file.read()
            break
    else:
        return of_outputs(system)
    return read_dataclass(ViewDescription, read_toml(Path(str(file)), data))


def of_outputs(system: System) -> ViewDescription:
    """Gauges of the outputs that are real numbers, a group for each unit, and charts of the first ones."""
    names = by_bare_name(str(port) for port in system.ports("output"))
    outputs = {bare: system.variable(system.port(name)) for bare, name in names.items()}
    by_unit = dict[str, list[str]]()
    for bare, variable in [(n, v) for n, v in outputs.items() if v.is_real][:MOST_GAUGES]:
        by_unit.setdefault(_shown_unit(variable.unit.name if variable.unit else "1"), []).append(bare)
    groups = tuple(
        GaugeGroup(unit, tuple(Gauge(n, n.replace("_", " "), unit, RANGE, -RANGE) for n in bare))
        for unit, bare in by_unit.items()
    )
    ends = tuple(m * 10.0**k for k in range(-3, 7) for m in (1, 2, 5))
    charts = tuple(
        Chart("Outputs", unit, tuple(_curves(bare[:MOST_CURVES])), ends)
        for unit, bare in list(by_unit.items())[:MOST_CHARTS]
    )
    return ViewDescription(groups, charts)


def _shown_unit(unit: str) -> str:
    """The unit that a reader is shown; none in the place of one that is not known."""
    try:
        parse(unit)
    except Problem:
        return "1"
    return reader_unit(unit)


def _curves(names: Iterable[str]) -> Iterator[ChartCurve]:
    for name, colour in zip(names, COLOURS, strict=False):
        yield ChartCurve(name, name.replace("_", " "), colour)


def by_bare_name(names: Iterable[str]) -> Mapping[str, str]:
    """Bare name -> full name. Where several have it, the component that the name begins with is meant:
    `supply_flow` is that of `supply`, not what one drive takes."""
    found = dict[str, str]()
    for name in names:
        component, _, bare = name.rpartition(".")
        if bare not in found or (component and bare.startswith(component.rpartition(".")[2])):
            found[bare] = name
    return found


def columns(names: Sequence[str]) -> Mapping[str, int]:
    """Bare name -> place among the names."""
    place = {name: k for k, name in enumerate(names)}
    return {bare: place[full] for bare, full in by_bare_name(names).items()}


class SignalIndex:
    """Where each value stands in the frames of one machine; what is not there is not a number."""

    def __init__(self, machine: Machine) -> None:
        self._signals, self._axes = columns(machine.signals), columns(machine.axes)

    def knows(self, name: str) -> bool:
        """Is there such a signal or axis?"""
        return name in self._signals or name in self._axes

    def value(self, frame: Frame, name: str) -> float:
        """A signal by its bare name; what drives the machine comes first."""
        if name in self._axes:
            return float(frame.axes[self._axes[name]])
        if name in self._signals:
            return float(frame.values[self._signals[name]])
        return math.nan

    def column(self, name: str) -> tuple[str, int] | None:
        """Where a bare name stands: among the "axes" or among the "values"."""
        if name in self._axes:
            return "axes", self._axes[name]
        return ("values", self._signals[name]) if name in self._signals else None
