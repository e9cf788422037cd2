"""An axis, its equations at one instant, and the subsystem of a list of axes.

The axes of a part have the lines, the oil and, unless one has its own, the valve in common. What an axis
declares has its name in the part: `boom_head_pressure`.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from fmus import ports
from fmus.components import load_sensing
from fmus.components.circuit import Circuit
from fmus.components.load_sensing import Sensed
from fmus.components.oil import at_temperature
from fmus.contract import Group, Quantity, Scalar, Subsystem, Terminal, make_group, nested, quantities
from fmus.ports import LineInputs

Names = tuple[str, str]  # of the two sides of an actuator


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
    terminal   power port, by the name of the axis
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
    terminal: Callable[[str], Terminal]

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
    """

    name: str
    actuator: Actuator
    inputs: type[Group]
    named: Callable[[str], str] | None = None
    own_valve: bool = False

    def of(self, values: Mapping[str, Scalar]) -> dict[str, Scalar]:
        """Values of the axis by their names in the part."""
        return {f"{self.name}_{n}": value for n, value in values.items()}


@dataclass(frozen=True)
class Drive:
    """The drive of an axis at one instant.

    circuit   with the chambers of the actuator
    load      its load pressure, from those of the nodes `at`
    others    rates of the states that are not in the circuit
    shown     outputs that are not in the circuit
    stored, heat   energy [J] and dissipated power [W] beside the circuit
    """

    circuit: Circuit
    load: Sensed
    at: Names
    others: Mapping[str, Scalar] = field(default_factory=dict)
    shown: Mapping[str, Scalar] = field(default_factory=dict)
    stored: Scalar = 0
    heat: Scalar = 0

    def rates(self) -> dict[str, Scalar]:
        """Time derivative of the state, by name."""
        return {**self.circuit.rates, **self.others}

    def observe(self) -> dict[str, Scalar]:
        """Outputs by name."""
        known = {**self.circuit.outputs(), **self.shown}
        known["stored_energy"] += self.stored
        known["dissipated_power"] += self.heat
        return known

    def load_pressure(self, u: Any) -> load_sensing.LoadPressure:
        """To the load-sensing line."""
        return self.load(both(self.circuit.pressures, self.at), both(self.circuit.rates, self.at), u)


def _none(*_: Any) -> dict[str, Scalar]:
    return {}


@dataclass(frozen=True)
class Model:
    """An axis at one fidelity. Its functions get x, u, its own parameters and those of the part.

    parameters  of the axis
    states      of the axis
    drive       (x, u, own, p) -> drive
    initial     (u, own, p) -> {state: value}
    outputs     beyond those of every variant
    derive      (own, p) -> {parameter: value}
    require     (u, own, p) -> {statement: margin}; "{}" stands for the name of the axis
    common      parameters that all axes share
    """

    parameters: type[Group]
    states: type[Group]
    drive: Callable[[Any, Any, Any, Any], Drive]
    initial: Callable[[Any, Any, Any], Mapping[str, Scalar]]
    outputs: type[Group] | None = None
    derive: Callable[[Any, Any], Mapping[str, Scalar]] = _none
    require: Callable[[Any, Any, Any], Mapping[str, Scalar]] = _none
    common: tuple[type[Group], ...] = ()


@dataclass(frozen=True)
class Fidelity:
    """What a variant consists of.

    model     of an axis
    common    parameters that all axes share
    valve     parameters of a valve
    require   (valve, p) -> requirements of a valve and of the common parameters
    """

    model: Callable[[Axis], Model]
    common: tuple[type[Group], ...]
    valve: type[Group]
    require: Callable[[Any, Any], Mapping[str, Scalar]]


# ---- the part


class Totals(Group):
    """Outputs of all axes together."""

    supply_flow: Scalar = Quantity("m3/s", "Flow from the supply line", 1e-3)
    return_flow: Scalar = Quantity("m3/s", "Flow into the return line, with the case drain of motors", 1e-3)
    load_pressure: Scalar = Quantity("Pa", "Highest load pressure of the axes, to the load-sensing line", 1e7)
    load_pressure_rate: Scalar = ports.rate_output("{}_load_pressure", "Pa/s", 1e8)
    stored_energy: Scalar = Quantity("J", "Energy of oil compression and of the moving oil columns", 1e3)
    dissipated_power: Scalar = Quantity("W", "Power dissipated by metering edges, lines and leakage", 1e4)


SUMMED = ("supply_flow", "return_flow", "stored_energy", "dissipated_power", "convected_power")


def part(
    name: str,
    axes: Sequence[Axis],
    fidelity: Fidelity,
    *,
    text: str,
    validity: str,
    values: Path | None = None,
    stiff: bool = True,
) -> Subsystem:
    """The subsystem of a list of axes; `text`, `validity`, `values` and `stiff` as in `Subsystem`."""
    models = {axis: fidelity.model(axis) for axis in axes}
    states = make_group("States", {}, **{axis.name: m.states for axis, m in models.items()})
    outputs = make_group("Outputs", _outputs(name, models))

    def each(x: Any, u: Any, p: Any) -> Iterator[tuple[Axis, Model, Any, Any, Any]]:
        """Axes with their states, inputs and parameters."""
        lines = vars(LineInputs.of(u))
        for axis, model in models.items():
            own = SimpleNamespace(**lines, **vars(getattr(u, axis.name)))
            yield axis, model, getattr(x, axis.name), own, getattr(p, axis.name)

    def drives(x: Any, u: Any, p: Any) -> dict[Axis, tuple[Drive, Any]]:
        return {axis: (m.drive(x_i, u_i, own, p), u_i) for axis, m, x_i, u_i, own in each(x, u, p)}

    def dynamics(x: Any, u: Any, p: Any) -> Any:
        rates: dict[str, Scalar] = {}
        for axis, (drive, _) in drives(x, u, p).items():
            rates |= axis.of(drive.rates())
        return nested(states, rates)

    def observe(x: Any, u: Any, p: Any) -> Any:
        found = drives(x, u, p)
        shown = {axis: drive.observe() for axis, (drive, _) in found.items()}
        load = reduce(load_sensing.highest, (drive.load_pressure(u_i) for drive, u_i in found.values()))
        known = {f"{name}_load_pressure": load.value, f"{name}_load_pressure_rate": load.rate}
        known |= {n: sum(own[n] for own in shown.values()) for n in SUMMED}
        for axis, own in shown.items():
            known |= axis.of(own)
        return nested(outputs, known)

    def initial(x: Any, u: Any, p: Any) -> dict[str, Scalar]:
        start: dict[str, Scalar] = {}
        for axis, model, _, u_i, own in each(x, u, p):
            start |= axis.of(model.initial(u_i, own, p))
        return start

    def require(x: Any, u: Any, p: Any) -> dict[str, Scalar]:
        found = {} if all(axis.own_valve for axis in axes) else dict(fidelity.require(p.valve, p))
        for axis, model, _, u_i, own in each(x, u, p):
            found |= axis.of(fidelity.require(own.valve, p)) if axis.own_valve else {}
            found |= {n.replace("{}", axis.name): margin for n, margin in model.require(u_i, own, p).items()}
        return found

    def derive(p: Any) -> dict[str, Scalar]:
        return {
            (axis.named or f"{axis.name}_{{}}".format)(n): value
            for axis, model in models.items()
            for n, value in model.derive(getattr(p, axis.name), p).items()
        }

    return at_temperature(
        Subsystem(
            name=name,
            parameters=_parameters(models, fidelity),
            states=states,
            inputs=make_group("Inputs", {}, LineInputs, **{axis.name: axis.inputs for axis in axes}),
            outputs=outputs,
            dynamics=dynamics,
            observe=observe,
            circuits=lambda x, u, p: {axis.name: d.circuit for axis, (d, _) in drives(x, u, p).items()},
            initial=initial,
            require=require,
            derive=derive,
            values=values,
            terminals=(
                *(axis.actuator.terminal(axis.name) for axis in axes),
                *(ports.lever(axis.name) for axis in axes),
                ports.supply_line(),
                ports.return_line(),
                ports.load_sensing_line(name),
            ),
            text=text,
            validity=validity,
            stiff=stiff,
        )
    )


def _parameters(models: Mapping[Axis, Model], fidelity: Fidelity) -> type[Any]:
    """Common parameters, valve and axes."""
    kinds = [group for axis, m in models.items() for group in (*m.common, *axis.actuator.common)]
    parts: dict[str, Any] = {} if all(axis.own_valve for axis in models) else {"valve": fidelity.valve}
    for axis, m in models.items():
        with_valve = {"valve": fidelity.valve} if axis.own_valve else {}
        own = make_group("Own", {}, m.parameters, **with_valve)
        parts[axis.name] = (own, axis.name, axis.named)
    return make_group("Parameters", {}, *dict.fromkeys((*fidelity.common, *kinds)), **parts)


def _outputs(name: str, models: Mapping[Axis, Model]) -> dict[str, Quantity]:
    """Pressures and flows of each axis, then its other outputs, totals, and what this variant adds."""
    kinds = {axis: axis.actuator for axis in models}
    of_axes = [
        *((axis, group) for axis, kind in kinds.items() for group in (kind.pressures, kind.flows)),
        *((axis, kind.outputs) for axis, kind in kinds.items()),
    ]
    added = [(axis, m.outputs) for axis, m in models.items() if m.outputs]
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
