"""An axis, its equations at one instant, and the subsystem of a list of axes.

The axes of a part have the lines, the oil and, unless one has its own, the valve in common. What an axis
declares has its name in the part: `boom_head_pressure`.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca

from fmus import ports
from fmus.components import hose, load_sensing
from fmus.components.additions import Addition, Place
from fmus.components.circuit import HEATS, Circuit
from fmus.components.hose import HoseSize
from fmus.components.load_sensing import Sensed
from fmus.components.oil import at_temperature
from fmus.contract import (
    Group,
    Quantity,
    Scalar,
    Subsystem,
    Terminal,
    make_group,
    nested,
    quantities,
    unknown,
)
from fmus.ports import LineInputs
from orchestrator.base.errors import Problem

Additions = tuple[tuple[str, type[Addition]], ...]  # name and component
Names = tuple[str, str]  # of the two sides of an actuator


def _none(*_: Any) -> dict[str, Scalar]:
    return {}


@dataclass(frozen=True)
class Actuator:
    """A cylinder or a motor between two chambers.

    sides      names of its sides; the first one is at port A of the valve
    pattern    name of a variable of a side: "{side}_{of}"
    line       begin and end of the names of what is inside a line, and the line in descriptions
    ends       flows at both ends of a line, from the valve
    pressures, flows, outputs   variables of an axis in every variant
    totals     outputs of all axes together
    common     parameters that all axes of this kind share
    hose       one of both hoses or lines, by the parameters of an axis
    terminal   power port, by the name of the axis
    power      the variables of an axis whose product is its mechanical power
    initial    (u, own, p) -> pressures of the chambers at the start, by name
    derive     (own, p) -> {parameter: value}
    require    (u, own, p) -> {statement: margin}; "{}" stands for the name of the axis
    """

    sides: Names
    pattern: str
    line: tuple[str, str, str]
    ends: Names
    pressures: type[Group]
    flows: type[Group]
    outputs: type[Group]
    totals: type[Group]
    common: tuple[type[Group], ...]
    hose: Callable[[Any], HoseSize]
    terminal: Callable[[str], Terminal]
    power: Names
    initial: Callable[[Any, Any, Any], Mapping[str, Scalar]]
    derive: Callable[[Any, Any], Mapping[str, Scalar]]
    require: Callable[[Any, Any, Any], Mapping[str, Scalar]] = _none

    def names(self, of: str) -> Names:
        """Names of a variable of both sides, without that of the axis."""
        a, b = (self.pattern.format(side=side, of=of) for side in self.sides)
        return a, b


def both(values: Any, names: Names) -> tuple[Scalar, Scalar]:
    """Two variables of a group, or of names."""
    a, b = ((values[n] if isinstance(values, Mapping) else getattr(values, n)) for n in names)
    return a, b


@dataclass(frozen=True)
class Axis:
    """An axis of a part.

    name        begin of the names of its variables
    actuator    what moves it
    inputs      command and motion
    named       names of its parameters from those in their group; default: with the name of the axis
    own_valve   whether the axis has a valve with parameters of its own
    additions   components beside those of its model, with the begin of their names
    held        sides of a cylinder that have a counterbalance valve in compensated drives
    """

    name: str
    actuator: Actuator
    inputs: type[Group]
    named: Callable[[str], str] | None = None
    own_valve: bool = False
    additions: Additions = ()
    held: tuple[str, ...] = ("head", "rod")

    def of(self, values: Mapping[str, Scalar]) -> dict[str, Scalar]:
        """Values of the axis by their names in the part."""
        return {f"{self.name}_{n}": value for n, value in values.items()}

    def parameter(self, name: str) -> str:
        """Name of a parameter of the axis in the part."""
        return self.named(name) if self.named else f"{self.name}_{name}"


@dataclass(frozen=True)
class Drive:
    """The drive of an axis at one instant.

    circuit   with the chambers of the actuator
    load      its load pressure, from those of the nodes `at`
    effort    (circuit) -> force or torque, and its rate
    others    rates of the states that are not in the circuit
    shown     outputs that are not in the circuit
    stored, heats   energy [J] and dissipated power [W], by the names of `HEATS`, beside the circuit
    """

    circuit: Circuit
    load: Sensed
    at: Names
    effort: Callable[[Circuit], Mapping[str, Scalar]]
    others: Mapping[str, Scalar] = field(default_factory=dict)
    shown: Mapping[str, Scalar] = field(default_factory=dict)
    stored: Scalar = 0
    heats: Mapping[str, Scalar] = field(default_factory=dict)

    def rates(self) -> dict[str, Scalar]:
        """Time derivative of the state, by name."""
        return {**self.circuit.rates, **self.others}

    def observe(self) -> dict[str, Scalar]:
        """Outputs by name."""
        known = {**self.circuit.outputs(), **self.effort(self.circuit), **self.shown, **self.heats}
        known["stored_energy"] += self.stored
        known["dissipated_power"] += sum(self.heats.values())
        return known

    def load_pressure(self, u: Any) -> load_sensing.LoadPressure:
        """To the load-sensing line."""
        return self.load(both(self.circuit.pressures, self.at), both(self.circuit.rates, self.at), u)


@dataclass(frozen=True)
class Model:
    """An axis at one fidelity. Its functions get x, u, its own parameters and those of the part.

    parameters  of the axis
    states      of the axis
    drive       (x, u, own, p) -> drive
    start       (u, own, p, pressures) -> values at the start of the states beside these of the chambers
    outputs     beyond those of every variant
    common      parameters that all axes share
    """

    parameters: type[Group]
    states: type[Group]
    drive: Callable[[Any, Any, Any, Any], Drive]
    start: Callable[[Any, Any, Any, Mapping[str, Scalar]], Mapping[str, Scalar]] = _none
    outputs: type[Group] | None = None
    common: tuple[type[Group], ...] = ()


@dataclass(frozen=True)
class Fidelity:
    """What a variant consists of.

    model     of an axis
    common    parameters that all axes share
    valve     parameters of a valve
    spool     parameters of its spool, if it has dynamics
    require   (valve, p) -> requirements of a valve and of the common parameters
    """

    model: Callable[[Axis], Model]
    common: tuple[type[Group], ...]
    valve: type[Group]
    require: Callable[[Any, Any], Mapping[str, Scalar]]
    spool: type[Group] | None = None

    def of_valve(self, spool: str) -> dict[str, Any]:
        """Groups of a valve with its spool; spool: begin of the names of that."""
        spools = {"spool": (self.spool, "{}", f"{spool}_{{}}".format)} if self.spool else {}
        return spools | {"valve": self.valve}


# ---- the part


class Totals(Group):
    """Outputs of all axes together."""

    supply_flow: Scalar = Quantity("m3/s", "Flow from the supply line", 1e-3)
    return_flow: Scalar = Quantity("m3/s", "Flow into the return line, with the case drain of motors", 1e-3)
    load_pressure: Scalar = Quantity("Pa", "Highest load pressure of the axes, to the load-sensing line", 1e7)
    load_pressure_rate: Scalar = ports.rate_output("{}_load_pressure", "Pa/s", 1e8)
    stored_energy: Scalar = Quantity("J", "Energy of oil compression and of the moving oil columns", 1e3)
    dissipated_power: Scalar = Quantity("W", "Power dissipated by metering edges, lines and leakage", 1e4)


class Powers(Group):
    """What an axis takes and gives."""

    hydraulic_power: Scalar = Quantity(
        "W", "Hydraulic power into the {}: pressure times flow, supply minus return", 1e4
    )
    mechanical_power: Scalar = Quantity("W", "Mechanical power of the {} on its load", 1e4)


SUMMED = ("supply_flow", "return_flow", "stored_energy", "dissipated_power", "convected_power")


@dataclass(frozen=True)
class _Instant:
    """An axis with its states, inputs and parameters, and the parameters of the part."""

    axis: Axis
    model: Model
    x: Any
    u: Any
    own: Any
    p: Any

    @property
    def drive(self) -> Drive:
        """The drive with its additions."""
        drive = self.model.drive(self.x, self.u, self.own, self.p)
        circuit = drive.circuit
        for name, _ in self.axis.additions:
            own: Addition = getattr(self.own, name)
            added = own.added(Place(name, circuit, getattr(self.x, name, None), self.u, self.own, self.p))
            circuit |= added
            ends = {end for branch in added.branches.values() for end in (branch.start, branch.end)}
            if missing := ends - circuit.nodes.keys():
                where = f"{self.axis.name}: {name}: expected a node {min(missing)}"
                raise Problem(f"{where}, got {', '.join(circuit.nodes)}")
        return replace(drive, circuit=circuit)


@dataclass(frozen=True)
class _Part:
    """The functions of the subsystem of a list of axes."""

    name: str
    models: Mapping[Axis, Model]
    fidelity: Fidelity
    states: type[Any]
    outputs: type[Any]

    def at(self, x: Any, u: Any, p: Any) -> Iterator[_Instant]:
        """The axes at one instant; x may be anything for what does not depend on it."""
        lines = vars(LineInputs.of(u))
        for axis, model in self.models.items():
            inputs = SimpleNamespace(**lines, **vars(getattr(u, axis.name)))
            yield _Instant(axis, model, getattr(x, axis.name), inputs, getattr(p, axis.name), p)

    def dynamics(self, x: Any, u: Any, p: Any) -> Any:
        """Time derivative of the state."""
        rates: dict[str, Scalar] = {}
        for a in self.at(x, u, p):
            rates |= a.axis.of(a.drive.rates())
        return nested(self.states, rates)

    def observe(self, x: Any, u: Any, p: Any) -> Any:
        """Outputs; forces and torques depend on the state, their rates and the flows also on the inputs."""
        found = [(a, a.drive) for a in self.at(x, u, p)]
        shown = {a.axis: drive.observe() for a, drive in found}
        for a, _ in found:
            kind, own = a.axis.actuator, shown[a.axis]
            effort, motion = kind.power
            own["mechanical_power"] = own[effort] * getattr(a.u, motion)
            fastest = ca.fmax(*map(ca.fabs, both(own, kind.names("flow"))))
            own["oil_velocity"] = fastest / hose.area(kind.hose(a.own).bore)
        load = reduce(load_sensing.highest, (drive.load_pressure(a.u) for a, drive in found))
        known = {f"{self.name}_load_pressure": load.value, f"{self.name}_load_pressure_rate": load.rate}
        known |= {n: sum(own[n] for own in shown.values()) for n in SUMMED}
        for axis, own in shown.items():
            known |= axis.of(own)
        return nested(self.outputs, known)

    def powers(self, *groups: type[Any]) -> dict[Axis, type[Group]]:
        """Powers of each axis with the heats that it has, from the groups of states, inputs, parameters."""
        drives = {a.axis: a.drive for a in self.at(*map(unknown, groups))}
        has = {axis: {*drive.circuit.heats, *drive.heats} for axis, drive in drives.items()}
        of = {axis: {n: q for n, q in HEATS.items() if n in has[axis]} for axis in has}
        return {axis: make_group("Powers", heats, Powers) for axis, heats in of.items()}

    def circuits(self, x: Any, u: Any, p: Any) -> dict[str, Circuit]:
        """Circuits by axis."""
        return {a.axis.name: a.drive.circuit for a in self.at(x, u, p)}

    def initial(self, x: Any, u: Any, p: Any) -> dict[str, Scalar]:
        """Initial values of the states."""
        start: dict[str, Scalar] = {}
        for a in self.at(x, u, p):
            pressures = a.axis.actuator.initial(a.u, a.own, p)
            start |= a.axis.of({**pressures, **a.model.start(a.u, a.own, p, pressures)})
            for name, _ in a.axis.additions:
                start |= a.axis.of({f"{name}_{n}": v for n, v in getattr(a.own, name).start().items()})
        return start

    def require(self, x: Any, u: Any, p: Any) -> dict[str, Scalar]:
        """Requirements of valves and axes."""
        found = dict(self.fidelity.require(p.valve, p)) if hasattr(p, "valve") else {}
        for a in self.at(x, u, p):
            found |= a.axis.of(self.fidelity.require(a.own.valve, p)) if a.axis.own_valve else {}
            required = a.axis.actuator.require(a.u, a.own, p)
            found |= {n.replace("{}", a.axis.name): margin for n, margin in required.items()}
        return found

    def derive(self, p: Any) -> dict[str, Scalar]:
        """Derived parameters."""
        return {
            axis.parameter(n): value
            for axis in self.models
            for n, value in axis.actuator.derive(getattr(p, axis.name), p).items()
        }


def part(
    name: str,
    axes: Sequence[Axis],
    fidelity: Fidelity,
    *,
    text: str,
    validity: str,
    values: Path | None = None,
    numbers: Mapping[str, Mapping[str, Any]] | None = None,
    stiff: bool = True,
) -> Subsystem:
    """The subsystem of a list of axes; the other arguments are those of `Subsystem`."""
    models = {axis: fidelity.model(axis) for axis in axes}
    states = make_group("States", {}, **{axis.name: _states(axis, m) for axis, m in models.items()})
    inputs = make_group("Inputs", {}, LineInputs, **{axis.name: axis.inputs for axis in axes})
    parameters = _parameters(models, fidelity)
    of = _Part(name, models, fidelity, states, Totals)
    powers = of.powers(states, inputs, parameters)
    of = replace(of, outputs=make_group("Outputs", _outputs(name, models, powers)))
    return at_temperature(
        Subsystem(
            name=name,
            parameters=parameters,
            states=states,
            inputs=inputs,
            outputs=of.outputs,
            dynamics=of.dynamics,
            observe=of.observe,
            circuits=of.circuits,
            initial=of.initial,
            require=of.require,
            derive=of.derive,
            values=values,
            numbers=numbers,
            terminals=_terminals(name, axes),
            text=text,
            validity=validity,
            stiff=stiff,
        )
    )


def _terminals(name: str, axes: Sequence[Axis]) -> tuple[Terminal, ...]:
    """Actuators with the motion that their axis has as inputs, levers and lines."""
    actuators = list[Terminal]()
    for axis in axes:
        terminal = axis.actuator.terminal(axis.name)
        known = [axis.of(quantities(g)) for g in (axis.inputs, axis.actuator.outputs)]
        members = tuple(m for m in terminal.members if any(m.variable in names for names in known))
        actuators.append(replace(terminal, members=members))
    lines = (ports.supply_line(), ports.return_line(), ports.load_sensing_line(name))
    return (*actuators, *(ports.lever(axis.name) for axis in axes), *lines)


def _states(axis: Axis, model: Model) -> type[Any]:
    """States of an axis, with those of its additions."""
    added = {name: a.states for name, a in axis.additions if a.states}
    return make_group("States", {}, model.states, **added) if added else model.states


def _parameters(models: Mapping[Axis, Model], fidelity: Fidelity) -> type[Any]:
    """Common parameters, valve and axes."""
    kinds = [group for axis, m in models.items() for group in (*m.common, *axis.actuator.common)]
    parts: dict[str, Any] = {} if all(axis.own_valve for axis in models) else fidelity.of_valve("spool")
    for axis, m in models.items():
        inner: dict[str, Any] = fidelity.of_valve("valve_spool") if axis.own_valve else {}
        inner |= {name: (added, "{}") for name, added in axis.additions}
        parts[axis.name] = (make_group("Own", {}, m.parameters, **inner), axis.name, axis.named)
    return make_group("Parameters", {}, *dict.fromkeys((*fidelity.common, *kinds)), **parts)


def _outputs(
    name: str, models: Mapping[Axis, Model], powers: Mapping[Axis, type[Group]]
) -> dict[str, Quantity]:
    """Pressures and flows of each axis, then its other outputs, totals, what a variant adds, powers."""
    kinds = {axis: axis.actuator for axis in models}
    of_axes = [
        *((axis, group) for axis, kind in kinds.items() for group in (kind.pressures, kind.flows)),
        *((axis, kind.outputs) for axis, kind in kinds.items()),
    ]
    added = [*((axis, m.outputs) for axis, m in models.items() if m.outputs), *powers.items()]
    totals = {n: q for kind in kinds.values() for n, q in quantities(kind.totals).items()}

    def declared(groups: Sequence[tuple[Axis, type[Group]]]) -> dict[str, Quantity]:
        return {
            f"{axis.name}_{n}": q.of(axis.name, str)
            for axis, group in groups
            for n, q in quantities(group).items()
        }

    of_part = {f"{name}_{n}" if n.startswith("load") else n: q.of(name, str) for n, q in totals.items()}
    return declared(of_axes) | of_part | declared(added)


def valve_of(own: Any, p: Any) -> Any:
    """The valve of an axis: its own, or the common one."""
    return getattr(own, "valve", None) or p.valve
