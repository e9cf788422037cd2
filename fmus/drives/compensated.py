"""Drives of a load-sensing machine: compensated sections, relief valves, load holding.

The lines are volumes with elastic walls and air, as in `quasistatic`, and the sections sense the pressures of
their ports (`pressure_compensator`). Forces and torques depend only on states.

**Cylinder** with counterbalance valves at the cylinder, and relief and anti-cavitation valves of `orifice` at
the valve. For each side, head (port A) or rod (port B), with the pressures P_V of the hose at the valve and
P_C of the chamber:

    C_V dP_V/dt    = Q_port - Q_C - Q_relief + Q_anti         Q_port = Q_in - Q_out of `pressure_compensator`
    C_C dP_C/dt    = Q_C -+ A x'                              C_C = V_C(x) kappa(P_C)
    dy/dt          = (y_0 - y)/T                              Q_C, y_0 of `counterbalance_valve`

C_V = A l (kappa(P_V) + 1/E_wall), with kappa of `chamber`. Each counterbalance valve is piloted by the hose
of the other side. Hoses are resistances in series with these valves; flows follow from pressures.

A side may be without a valve (`Axis.held`). Then its hose is a part of the chamber, and the friction of the
hose in series with the meter-out edge.

The boom's counterbalance valve meters when the boom is lowered: its meter-out edge is wide, so that no more
pressure is needed than opens the valve. Behind a compensated section this is stable only with a low pilot
ratio (docs/equations.md). The other meter-out edges are so small that their counterbalance valves are fully
open in motion.

**Motor** with crossover reliefs, make-up from the return line, and a holding brake with the torque T of
`motor`:

    C dP_a/dt = Q_a - D w - (P_a - P_b)/R_in - (P_a - P_t)/R_ex - Q_cross + Q_anti,a
    C dP_b/dt = Q_b + D w + (P_a - P_b)/R_in - (P_b - P_t)/R_ex + Q_cross + Q_anti,b
    torque    = D (P_a - P_b) - T             D = D_m N                   eqs. (8), (11), (12)

A closed valve blocks the ports, which have no counterbalance valves. The brake is released as soon as the
command leaves the dead band and the supply has pressure.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any

from fmus.components import chamber, counterbalance_valve, hose, motor, spool_valve
from fmus.components import pressure_compensator as compensator
from fmus.components.chamber import AeratedOil, Air
from fmus.components.circuit import Branch, Circuit, Kind, Node
from fmus.components.counterbalance_valve import Counterbalance, Restriction
from fmus.components.hose import HoseWall, in_series
from fmus.components.load_sensing import sensed
from fmus.components.motor import Brake
from fmus.components.orifice import AntiCavitation, PressureValve, Reliefs
from fmus.components.pressure_compensator import Compensator, Section, SectionOutputs, SectionValve
from fmus.contract import Group, Quantity, Scalar, make_group, quantities
from fmus.drives import cylinder as cylinders
from fmus.drives import motor as motors
from fmus.drives.cylinder import CHAMBERS, CYLINDER, PORTS
from fmus.drives.drive import Drive, Fidelity, Model, Names, both, valve_of
from fmus.drives.motor import LINES, MOTOR


class Common(AeratedOil, HoseWall, compensator=Compensator):
    """Parameters that all axes share."""


def _section_flow(side: str = "") -> Quantity:
    text = f"Flow of the {{}} section{side} at full command"
    return Quantity("m3/s", text, 1e-3, minimum=1e-6, group="{} section")


def _edges(
    section: Section, ports: tuple[compensator.SectionPort, ...], nodes: Names, supply: Scalar
) -> dict[str, Branch]:
    """The edges of a section, with compensator and check valve in series, and lines behind meter-out."""
    made = spool_valve.branches((ports[0].edges, ports[1].edges), nodes)
    for name, port in zip(("P-A", "P-B"), ports, strict=True):
        taken = supply - port.edges.pressure - port.metering_drop
        made[name] = replace(made[name], series={Kind.COMPENSATOR: taken})
    behind = zip(("A-T", "B-T"), section.lines, strict=True)
    return made | {name: in_series(made[name], line) for name, line in behind if line}


# ---- cylinder


class CylinderCommon(
    Group,
    anti_cavitation=AntiCavitation,
    counterbalance=Counterbalance,
    port_relief=(PressureValve, "port relief"),
):
    """Parameters that all cylinders share."""

    neutral_area: Scalar = Quantity(
        "m2", "Area that connects each port to the return line in neutral", 1e-6, minimum=0.0, group="Neutral"
    )


class CylinderDrive(cylinders.VolumeDrive):
    """Cylinder, hoses and section."""

    section_flow: Scalar = _section_flow(" to the head side")
    rod_section_flow: Scalar = _section_flow(" to the rod side")
    head_return_area: Scalar = Quantity(
        "m2", "Area of the meter-out edge from the head side of the {} at full command", 1e-4, minimum=1e-9
    )
    rod_return_area: Scalar = Quantity(
        "m2", "Area of the meter-out edge from the rod side of the {} at full command", 1e-4, minimum=1e-9
    )


class PilotRatios(Group):
    """Of the counterbalance valves."""

    head_pilot_ratio: Scalar = Quantity(
        "1", "Pilot ratio R of the counterbalance valve at the head side of the {} cylinder", minimum=0.0
    )
    rod_pilot_ratio: Scalar = Quantity(
        "1", "Pilot ratio R of the counterbalance valve at the rod side of the {} cylinder", minimum=0.0
    )


class AtValve(Group):
    """Pressures at the valve and openings of the counterbalance valves."""

    head_valve_pressure: Scalar = chamber.pressure("Pressure at port A of the {} valve")
    rod_valve_pressure: Scalar = chamber.pressure("Pressure at port B of the {} valve")
    head_counterbalance_opening: Scalar = Quantity(
        "1", "Opening of the counterbalance valve at the head side of the {} cylinder"
    )
    rod_counterbalance_opening: Scalar = Quantity(
        "1", "Opening of the counterbalance valve at the rod side of the {} cylinder"
    )


class CylinderState(cylinders.Pressures, AtValve):
    """Pressures and counterbalance valves."""


class CylinderOutputs(cylinders.Signals, SectionOutputs, AtValve):
    """Signals of section, counterbalance valves and relief valves."""


def cylinder_section(own: Any, p: Any, sides: Sequence[str] = CYLINDER.sides) -> Section:
    """Parameters of the section of a cylinder; sides: those with a counterbalance valve."""
    flows = (own.section_flow, own.rod_section_flow)
    areas = (own.head_return_area, own.rod_return_area)
    friction, (head, rod) = own.hose.friction(p), (side in sides for side in CYLINDER.sides)
    neutral = (p.neutral_area if head else 0, p.neutral_area if rod else 0)
    lines = (None if head else friction, None if rod else friction)
    return Section(valve_of(own, p), p.compensator, flows, areas, neutral, p, lines)


def _ports(sides: Sequence[str]) -> Names:
    """Nodes at the valve: hoses before counterbalance valves, else the chambers."""
    named = zip(CYLINDER.sides, PORTS, CHAMBERS, strict=True)
    a, b = (port if side in sides else chamber for side, port, chamber in named)
    return a, b


def _cylinder(sides: Sequence[str], x: Any, u: Any, own: Any, p: Any) -> Drive:
    section, line, at = cylinder_section(own, p, sides), own.hose, _ports(sides)
    ports = compensator.section_ports(section, u.command, both(x, at), u)
    edges, valve = (ports[0].edges, ports[1].edges), section.valve
    friction = line.friction(p)
    around = Restriction(valve, friction, p)
    nodes, branches = dict[str, Node](), dict[str, Branch]()
    whole = cylinders.ends(x, u, own, p)
    for side, port, end, of in zip(CYLINDER.sides, PORTS, CHAMBERS, ("1", "2"), strict=True):
        if side in sides:
            opening = getattr(x, f"{side}_counterbalance_opening")
            law = partial(counterbalance_valve.flow, p.counterbalance, opening, around)
            between = Branch(port, end, Kind.COUNTERBALANCE, law, f"Q_C{of}")
            branches[f"{side}_flow"] = in_series(between, friction)
            nodes[port] = line.node(getattr(x, port), p, u.oil_temperature, f"C_V{of}")
        else:
            known, volume = whole.nodes[end], hose.area(line.bore) * line.length
            walls = line.at_temperature(p, u.oil_temperature) - volume / p.bulk_modulus
            nodes[end] = replace(known, volume=known.volume + volume, capacitance=walls)
    whole |= Circuit(
        nodes,
        {
            **_edges(section, ports, at, u.supply_pressure),
            **cylinders.reliefs(p.port_relief, own, p, at),
            **branches,
        },
    )
    shown = {
        **vars(x),
        **vars(compensator.shown(section, ports, u.command)),
        "head_valve_flow": edges[0].line,
        "rod_valve_flow": edges[1].line,
        **{f"{n}_flow": e.line for n, e in zip(CYLINDER.sides, edges, strict=True) if n not in sides},
    }
    rates = _opening_rates(x, u, own, p, sides)
    return Drive(whole, sensed(valve, u), at, cylinders.force(own), rates, shown)


def _opening_rates(x: Any, u: Any, own: Any, p: Any, sides: Sequence[str]) -> dict[str, Scalar]:
    """Rates of the openings of the counterbalance valves, each piloted by the other side."""
    c, lines, found = p.counterbalance, both(x, _ports(sides)), dict[str, Scalar]()
    named = zip(CYLINDER.sides, both(x, CHAMBERS), reversed(lines), lines, strict=True)
    for side, pressure, pilot, line in (row for row in named if row[0] in sides):
        ratio, opening = getattr(own, f"{side}_pilot_ratio"), f"{side}_counterbalance_opening"
        target = counterbalance_valve.balance(c, ratio, pressure, pilot, line, u.tank_pressure)
        found[opening] = (target - getattr(x, opening)) / c.lag
    return found


@cache
def cylinder_model(sides: tuple[str, ...] = CYLINDER.sides) -> Model:
    """A cylinder; sides: those with a counterbalance valve, whose hoses neutral has drained at the start."""

    def of(group: type[Group], *bases: type[Any]) -> type[Any]:
        """Without what belongs to the valves of the other sides."""
        valves = {*quantities(AtValve), *quantities(PilotRatios)}
        others = {n for n in valves if n.partition("_")[0] not in sides}
        own = {n: q for n, q in quantities(group).items() if n not in others}
        return make_group(group.__name__, own, *bases)

    def start(u: Any, *_: object) -> dict[str, Scalar]:
        drained = dict.fromkeys((f"{n}_valve_pressure" for n in sides), u.tank_pressure)
        return drained | dict.fromkeys((f"{n}_counterbalance_opening" for n in sides), 0.0)

    drive = partial(_cylinder, sides)
    groups = (of(PilotRatios, CylinderDrive), of(CylinderState), drive, start, of(CylinderOutputs))
    return Model(*groups, common=(CylinderCommon,))


# ---- motor


class MotorDrive(motors.VolumeDrive, brake=(Brake, "{}")):
    """Motor, lines, section and brake."""

    section_flow: Scalar = _section_flow()
    return_area: Scalar = Quantity(
        "m2",
        "Area of each meter-out edge of the {} at full command",
        1e-4,
        minimum=1e-9,
    )


class BrakeState(Group):
    """State of the brake."""

    brake_torque: Scalar = Quantity("N.m", "Torque of the {} brake, against the motion", 1e4)
    brake_applied: Scalar = Quantity("1", "Part of its torque that the {} brake can hold")


class MotorState(motors.Pressures, BrakeState):
    """Pressures at the motor, brake."""


class MotorOutputs(motors.Signals, SectionOutputs, BrakeState):
    """Signals of section, relief valves and brake."""


def motor_section(own: Any, p: Any) -> Section:
    """Parameters of the section of a motor."""
    flows, areas = (own.section_flow, own.section_flow), (own.return_area, own.return_area)
    lines = (own.line.friction(p),) * 2
    return Section(valve_of(own, p), p.compensator, flows, areas, (0.0, 0.0), p, lines)


def _release(u: Any, own: Any, p: Any) -> Scalar:
    """f of the brake."""
    in_use = 1 - motor_section(own, p).neutral(u.command)
    return own.brake.released(in_use, u.supply_pressure - u.tank_pressure)


def _motor(x: Any, u: Any, own: Any, p: Any) -> Drive:
    section, line, brake = motor_section(own, p), own.line, own.brake
    ports = compensator.section_ports(section, u.command, both(x, LINES), u)
    edges = (ports[0].edges, ports[1].edges)
    volume = hose.area(line.bore) * line.length + own.motor_volume
    whole = motors.ends(x, u, own.capacitance(p, u.oil_temperature), volume, Air.of(p)) | Circuit(
        {},
        {
            **_edges(section, ports, LINES, u.supply_pressure),
            **motor.branches(LINES, own.displacement * u.speed, *own.leakage),
            **motors.reliefs(own, p),
        },
    )
    held = brake.hold(x.brake_torque, x.brake_applied, u.speed)
    rates = {
        "brake_torque": held.rate,
        "brake_applied": brake.applied_rate(x.brake_applied, _release(u, own, p)),
    }

    def effort(whole: Circuit) -> dict[str, Scalar]:
        driven = motors.torque(own)(whole)
        braked = {
            "torque": driven["torque"] - x.brake_torque,
            "torque_rate": driven["torque_rate"] - held.rate,
        }
        return driven | braked

    shown = {
        **vars(x),
        **vars(compensator.shown(section, ports, u.command)),
        "flow_a": edges[0].line,
        "flow_b": edges[1].line,
    }
    return Drive(
        whole, sensed(section.valve, u), LINES, effort, rates, shown, held.stored, {"brake_heat": held.heat}
    )


def _motor_start(u: Any, own: Any, p: Any, _: object) -> dict[str, Scalar]:
    """The brake as the command has it, without torque."""
    return {"brake_torque": 0.0, "brake_applied": 1 - _release(u, own, p)}


OF_MOTOR = Model(
    parameters=MotorDrive,
    states=MotorState,
    outputs=MotorOutputs,
    drive=_motor,
    start=_motor_start,
    common=(Reliefs,),
)
COMPENSATED = Fidelity(
    lambda axis: OF_MOTOR if axis.actuator == MOTOR else cylinder_model(axis.held),
    common=(Common,),
    valve=SectionValve,
    require=lambda valve, p: compensator.requirements(valve, p.compensator),
)
