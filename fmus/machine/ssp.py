"""Systems of a machine as SSP files, and which ports of its FMUs belong together.

NAME.ssp            machine, supply and operator
NAME_actuation.ssp  the same with the electrical actuation of the valves
NAME_control.ssp    machine, supply, actuation and controller
NAME_sensors.ssp    the same with sensors before the controller, and the diagnosis; only with faults

All have the parameter set `winter_oil`; those with the controller have `compensated`: section flows that it
needs with compensated drives.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from fmus.contract import Subsystem, quantities
from fmus.machine.machine import ARM, Connections, Machine
from fmus.parameters import values
from orchestrator.ssp.load import assemble
from orchestrator.ssp.write import write_ssp

ACTUATED, CONTROLLED, SENSED = "_actuation", "_control", "_sensors"  # ends of the names of systems
COMPENSATED = "compensated"  # variant of the drives, parameter set of the controller
WINTER, WINTER_GRADE = "winter_oil", {"oil_viscosity_40": 46e-6, "oil_viscosity_100": 8.2e-6}  # HVLP 46, m2/s


@dataclass(frozen=True)
class SystemPlan:
    """What the systems of a kind are besides their components: stop time [s], parameter sets, those bound."""

    stop: float
    sets: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    bound: tuple[str, ...] = ()


def systems(machine: Machine) -> Iterator[tuple[str, tuple[Subsystem, ...], Connections]]:
    """End of the name, what gives the commands or reads, and its connections.

    Those with the operator have no inputs: Ecos and libcosim reject them, and FMPy delays them by one step.
    The machine with the controller is at rest without inputs.
    """
    operator, controller, head = machine.operator, machine.controller, machine.actuation
    if operator:
        yield "", (operator,), machine.operator_wires
    if operator and head:
        yield ACTUATED, (head, operator), machine.actuated(machine.operator_wires, operator)
    if controller and head:
        wires = machine.actuated(machine.controller_wires, controller)
        yield CONTROLLED, (head, controller), wires
        if machine.sensors and machine.diagnosis:
            drivers = (machine.sensors, head, controller, machine.diagnosis)
            yield SENSED, drivers, machine.sensed(wires)


def write_systems(
    machine: Machine,
    folder: Path,
    fmus: Mapping[str, Path],
    step: float,
    operated: SystemPlan,
    controlled: SystemPlan,
    resources: Mapping[str, bytes],
) -> list[Path]:
    """Write the systems to `folder` of which all components have an FMU.

    fmus         .fmu files by component
    step         communication step [s]
    operated     of the systems with the operator
    controlled   of those with the controller
    resources    files of the systems
    """
    found, parts = list[Path](), [n for n in reversed(machine.subsystems) if n != ARM]
    for end, subs, wires in systems(machine):
        drivers = [sub.name for sub in subs]
        # some tools initialise in the order of the file: sources of holding forces and pressures are first
        order, flows = (ARM, *machine.feeding, *parts, *drivers), section_flows(machine, *subs)
        plan = controlled if machine.controller in subs else operated
        sets = {**plan.sets, WINTER: winter_oil(machine)} | ({COMPENSATED: flows} if flows else {})
        if fmus.keys() >= {*order}:
            system = assemble(
                {n: fmus[n] for n in order},
                machine.connections + wires + machine.supply_wires,
                name=f"{machine.name}{end}",
                stop=plan.stop,
                step=step,
                shared=machine.shared,
                common=machine.oil,
            )
            path = Path(folder) / f"{machine.name}{end}.ssp"
            found.append(write_ssp(system, path, sets, plan.bound, resources=resources))
    return found


def section_flows(machine: Machine, *readers: Subsystem | None) -> dict[str, float]:
    """Flows of the compensated sections, for the controller and the diagnosis."""
    found, drives = dict[str, float](), [v[COMPENSATED] for v in machine.parts.values() if COMPENSATED in v]
    for sub in filter(None, readers):
        known = quantities(sub.parameters)
        flows = ((n, x) for s in drives for n, x in values(s).p.items() if n in known)
        found |= {f"{sub.name}.{n}": x for n, x in flows if n.endswith("_section_flow")}
    return found


def winter_oil(machine: Machine) -> dict[str, float]:
    """Viscosities of a hydraulic oil of index 150, for all parts that contain oil."""
    known = {
        part: {n for s in v.values() for n in quantities(s.parameters)}
        for part, v in machine.families.items()
    }
    return {f"{part}.{n}": v for part, names in known.items() for n, v in WINTER_GRADE.items() if n in names}


def all_wires(machine: Machine) -> Connections:
    """Connections of a machine in any of its systems."""
    return tuple(dict.fromkeys((*machine.wires, *(wire for *_, wires in systems(machine) for wire in wires))))


def wired_ports(machine: Machine) -> Iterator[tuple[str, str, str, str, str]]:
    """FMU, port, other FMU, its port, the rate port in both; without rates of the same name in both."""
    wires = all_wires(machine)
    for start, end in wires:
        (source, output), (target, name) = start.split("."), end.split(".")
        rate = machine.rate_of.get(name, "")
        wired = (f"{source}.{rate}", f"{target}.{rate}") in wires
        if name in machine.rate_of or name not in machine.rate_of.values() or name != output:
            yield source, output, target, name, rate if wired else ""


def with_partners(machine: Machine, sub: Subsystem) -> Subsystem:
    """The subsystem with its connections to other FMUs of the machine."""
    whole = sub.component == machine.name
    own = machine.subsystems if whole else (sub.component,)
    ends: dict[str, tuple[list[str], set[str]]] = {}
    for source, output, target, name, rate in wired_ports(machine):
        for part, port, other, its in ((source, output, target, name), (target, name, source, output)):
            # the supply needs the flow into each drive, which the machine in one FMU does not have
            if part in own and other not in own and not (whole and other in machine.feeding):
                others, rates = ends.setdefault(port, ([], set()))
                others.append(other if its == port else f"{other}.{its}")
                rates.add(rate)
    rows = [(port, tuple(others), max(rates)) for port, (others, rates) in ends.items()]
    return replace(sub, connections=tuple(rows))
