"""A machine: variants of parts that are connected by their terminals."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import permutations
from typing import TypeAlias

from fmus.components.chamber import AeratedOil
from fmus.contract import Subsystem, quantities
from fmus.controller.variables import Setpoints
from fmus.diagnosis import diagnosis
from fmus.faults import faulty
from fmus.parameters import numbers
from fmus.sensors import sensors
from orchestrator.base.errors import Problem

HOLDING = ("_holding_force", "_holding_torque")
ARM = "manipulator"  # the part without hydraulics
Connections: TypeAlias = tuple[tuple[str, str], ...]
Inputs: TypeAlias = Mapping[str, tuple[str, ...]]  # external input -> component inputs that it feeds


def plugged(chosen: Iterable[Subsystem]) -> Connections:
    """Connections of the terminals that fit, in which each output feeds the input of the same member.

    Terminals fit if they have one name. Those of the supply end with the name of the part behind them:
    `supply_line_swing` fits `supply_line` of swing.
    """
    wires = []
    for source, target in permutations(chosen, 2):
        outputs, inputs = quantities(source.outputs), quantities(target.inputs)
        sockets = {t.name: {m.name: m.variable for m in t.members} for t in target.terminals}
        for plug in source.terminals:
            names = (
                plug.name,
                f"{plug.name}_{source.component}",
                plug.name.removesuffix(f"_{target.component}"),
            )
            for socket in (sockets[name] for name in dict.fromkeys(names) if name in sockets):
                pairs = ((m.variable, socket[m.name]) for m in plug.members)
                fitting = ((out, into) for out, into in pairs if out in outputs and into in inputs)
                wires += [
                    (f"{source.component}.{out}", f"{target.component}.{into}") for out, into in fitting
                ]
    return tuple(wires)


def wiring(chosen: Mapping[str, Subsystem]) -> tuple[Connections, Inputs]:
    """Connections and external inputs of a machine of these parts, with or without supply.

    Parts that have an input of one name share it. The inputs of one part come first, then those of several.
    """
    connections, inputs = plugged(chosen.values()), dict[str, tuple[str, ...]]()
    fed = {target for _, target in connections}
    for part, sub in chosen.items():
        for name in quantities(sub.inputs):
            if (end := f"{part}.{name}") not in fed:
                inputs[name] = (*inputs.get(name, ()), end)
    ends = sorted(inputs.values(), key=lambda e: len(e) > 1)
    return connections, {e[0].partition(".")[2]: e for e in ends}


@dataclass(frozen=True, eq=False)
class Machine:
    """Parts with their variants, the supplies of their lines, and what gives their commands.

    name       of the machine in one FMU, and begin of the names of its systems
    parts      part -> variant -> subsystem, the default variant first
    supplies   the same; the machine in one FMU does not contain them
    operator, controller   each gives the commands in a system of its own; the controller also measures
    actuation  what is between the commands and the valves, in some systems
    shared     parameter -> parts that it describes together
    faults     whether its parts have faults as inputs; then it has sensors and a diagnosis (`with_faults`)
    """

    name: str
    parts: Mapping[str, Mapping[str, Subsystem]]
    supplies: Mapping[str, Mapping[str, Subsystem]] = field(default_factory=dict)
    operator: Subsystem | None = None
    controller: Subsystem | None = None
    actuation: Subsystem | None = None
    shared: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    faults: bool = False

    @cached_property
    def sensors(self) -> Subsystem | None:
        """What is between the machine and the controller, in some systems."""
        return sensors(self.measured) if self.faults and self.controller else None

    @cached_property
    def diagnosis(self) -> Subsystem | None:
        """What looks at the readings of the sensors and the commands of the controller there."""
        if not self.faults or self.controller is None:
            return None
        known = numbers(self.controller)["parameters"]
        return diagnosis(self.controller.model.arm, known, self.subsystems[ARM])

    @property
    def drivers(self) -> list[Subsystem]:
        """What is connected to the machine in some systems only: all but the operator."""
        return [*filter(None, (self.controller, self.actuation, self.sensors, self.diagnosis))]

    @property
    def families(self) -> dict[str, Mapping[str, Subsystem]]:
        """Variants of parts and supplies."""
        return {**self.parts, **self.supplies}

    @cached_property
    def subsystems(self) -> dict[str, Subsystem]:
        """Default variants of the parts."""
        return {part: next(iter(variants.values())) for part, variants in self.parts.items()}

    @cached_property
    def feeding(self) -> dict[str, Subsystem]:
        """Default variants of the supplies."""
        return {part: next(iter(variants.values())) for part, variants in self.supplies.items()}

    @cached_property
    def components(self) -> dict[str, Subsystem]:
        """Default variants of parts and supplies, and the operator."""
        return {**self.subsystems, **self.feeding} | (
            {self.operator.name: self.operator} if self.operator else {}
        )

    def chosen(self, **variants: str) -> dict[str, Subsystem]:
        """Parts by name, in their default variants except for the variants in the arguments.

        Example: chosen(boom_stick="detailed", supply="engine_pump"). A supply is included only if it is an
        argument.
        """
        families = self.families
        for part, variant in variants.items():
            family = families.get(part)
            if family is None or variant not in family:
                named = (
                    f"variant of {part}: {', '.join(family)}" if family else f"part: {', '.join(families)}"
                )
                raise Problem(f"{part}={variant}: expected a {named}")
        return self.subsystems | {part: families[part][variant] for part, variant in variants.items()}

    # ---- connections

    @cached_property
    def _wiring(self) -> tuple[Connections, Inputs]:
        return wiring(self.subsystems)

    @property
    def connections(self) -> Connections:
        """Connections of the parts."""
        return self._wiring[0]

    @property
    def inputs(self) -> Inputs:
        """External input of the parts -> component inputs that it feeds."""
        return self._wiring[1]

    def _added(self, part: Subsystem) -> Connections:
        """The connections of one more component with the parts."""
        return tuple(w for w in plugged((*self.subsystems.values(), part)) if w not in self.connections)

    @cached_property
    def supply_wires(self) -> Connections:
        """Connections of supplies and parts."""
        return tuple(wire for sub in self.feeding.values() for wire in self._added(sub))

    @cached_property
    def operator_wires(self) -> Connections:
        """Connections of the operator."""
        return self._added(self.operator) if self.operator else ()

    def actuated(self, wires: Connections, driver: Subsystem) -> Connections:
        """The wires of what gives the commands, with the actuation between it and the valves."""
        if self.actuation is None:
            return wires
        valves = self._added(self.actuation)
        fed = {target for _, target in valves}
        others = (wire for wire in wires if wire[1] not in fed)
        return (*others, *plugged((driver, self.actuation)), *valves)

    def sensed(self, wires: Connections) -> Connections:
        """The wires of the controller, with the sensors between it and the machine."""
        if self.sensors is None or self.controller is None:
            return wires
        signals, found = quantities(self.sensors.inputs), list[tuple[str, str]]()
        for source, target in wires:
            component, _, name = target.partition(".")
            if component == self.controller.name and name in signals:
                found.append((source, f"{self.sensors.name}.{name}"))
                source = f"{self.sensors.name}.{name}_measured"
            found.append((source, target))
        if self.diagnosis:
            others = (self.controller, *self.subsystems.values(), *self.feeding.values())
            for name in quantities(self.diagnosis.inputs):
                givers = [f"{sub.name}.{name}" for sub in others if name in quantities(sub.outputs)]
                source = f"{self.sensors.name}.{name}_measured" if name in signals else next(iter(givers), "")
                found += [(source, f"{self.diagnosis.name}.{name}")] if source else []
        return tuple(found)

    @property
    def measured(self) -> dict[str, str]:
        """Signals of the machine that the controller measures -> their units."""
        if self.controller is None:
            return {}
        declared = quantities(self.controller.inputs)
        names = (target.partition(".")[2] for _, target in self.controller_wires)
        return {n: declared[n].unit for n in names if n in declared}

    @cached_property
    def controller_wires(self) -> Connections:
        """Connections of the controller, which measures what it has an input for."""
        if self.controller is None:
            return ()
        measured = (
            (f"{sub.name}.{name}", f"{self.controller.name}.{name}")
            for name in quantities(self.controller.inputs)
            if name not in quantities(Setpoints)
            for sub in (*self.subsystems.values(), *self.feeding.values())
            if name in quantities(sub.outputs)
        )
        return (*self._added(self.controller), *measured)

    @cached_property
    def oil(self) -> dict[str, tuple[str, ...]]:
        """Parameters of the oil -> parts of which a variant has them: they have one oil."""
        of = {n: {p for s in v.values() for p in quantities(s.parameters)} for n, v in self.families.items()}
        return {p: tuple(n for n in of if p in of[n]) for p in quantities(AeratedOil)}

    @cached_property
    def wires(self) -> Connections:
        """All connections of parts, supplies, operator and controller."""
        return self.connections + self.operator_wires + self.supply_wires + self.controller_wires

    @cached_property
    def rate_of(self) -> dict[str, str]:
        """Input -> input with its exact time derivative."""
        subs = (*self.subsystems.values(), *self.feeding.values())
        return {n: q.rate for sub in subs for n, q in quantities(sub.inputs).items() if q.rate}

    @cached_property
    def rates(self) -> Connections:
        """Connections of rate ports, which are optional; a velocity is also a rate, but has one itself."""
        only_rates = {*self.rate_of.values()} - {*self.rate_of}
        return tuple(wire for wire in self.connections if wire[1].partition(".")[2] in only_rates)

    @cached_property
    def holding(self) -> Connections:
        """Connections for initialisation only: forces of the pose, from which initial pressures follow."""
        return tuple(wire for wire in self.connections if wire[0].endswith(HOLDING))


def with_faults(machine: Machine) -> Machine:
    """The machine with faults as inputs (`fmus.faults`), sensors and a diagnosis.

    Its parts have the additions of `fmus.faults`, and its actuation the conditions of the valves.
    """

    def faulty_of(families: Mapping[str, Mapping[str, Subsystem]]) -> dict[str, dict[str, Subsystem]]:
        return {part: {v: faulty(sub) for v, sub in family.items()} for part, family in families.items()}

    head = machine.actuation and faulty(machine.actuation)
    parts, supplies = faulty_of(machine.parts), faulty_of(machine.supplies)
    return replace(machine, parts=parts, supplies=supplies, actuation=head, faults=True)
