"""Detailed drives: spool dynamics, lines of lumps, oil with air, relief and anti-cavitation valves.

Cylinder, with the valves of `orifice` at the cylinder:

    C_h dP_h/dt = Q_h - A_h x' - Q_relief,h + Q_anti,h        C_h = (V_0 + A_h x) kappa(P_h)
    C_r dP_r/dt = Q_r + A_r x' - Q_relief,r + Q_anti,r        C_r = (V_0 + A_r (L - x)) kappa(P_r)

Motor, with cross-port relief valves, and anti-cavitation valves from the return line, at the motor:

    C_a dP_a/dt = Q_a - D w - (P_a - P_b)/R_in - (P_a - P_t)/R_ex - Q_cross + Q_anti,a      C = V_m kappa(P)
    C_b dP_b/dt = Q_b + D w + (P_a - P_b)/R_in - (P_b - P_t)/R_ex + Q_cross + Q_anti,b

with the flows Q out of the lines of `fmus.components.hose`, kappa of `chamber`, the spool of `spool_valve`.
The volume V_m of a motor side is separate here, while `lumped` adds it to the capacitance of the line. So the
pressures of the motor ports are states, and the torque depends only on states.

`boom_head_valve_flow` is the flow at the valve, `boom_head_flow` that into the cylinder; `swing_flow_a` is
the flow at the valve, `swing_motor_flow_a` that at the motor. The number of lumps changes that of the states.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from fmus.components import chamber, hose, load_sensing, motor, opening_curve, spool_valve
from fmus.components.chamber import AeratedOil
from fmus.components.circuit import Circuit, Node
from fmus.components.hose import HoseWall, HydraulicLine, LineStates
from fmus.components.load_sensing import Sensed
from fmus.components.orifice import Reliefs
from fmus.components.spool_valve import CurvedEdges, Spool, SpoolState
from fmus.contract import Group, Quantity, Scalar, make_group, quantities
from fmus.drives import cylinder as cylinders
from fmus.drives import motor as motors
from fmus.drives.cylinder import CYLINDER
from fmus.drives.drive import Actuator, Axis, Drive, Fidelity, Model, both, valve_of
from fmus.drives.motor import MOTOR
from fmus.parameters import group_of


class Common(AeratedOil, Reliefs, HoseWall):
    """Parameters that all axes share."""


class SpoolOutput(Group):
    """Position of the spool."""

    spool_position: Scalar = spool_valve.position("Spool position of the {} valve")


class CylinderOutputs(cylinders.Signals, SpoolOutput):
    """Signals of spool, valve and relief valves, and of the oil in the cylinder."""

    head_valve_pressure: Scalar = chamber.port_pressure("Pressure at port A of the {} valve")
    rod_valve_pressure: Scalar = chamber.port_pressure("Pressure at port B of the {} valve")
    head_bulk_modulus: Scalar = Quantity(
        "Pa", "Effective bulk modulus of the oil at the head side of the {}", 1e9
    )
    rod_bulk_modulus: Scalar = Quantity(
        "Pa", "Effective bulk modulus of the oil at the rod side of the {}", 1e9
    )


class MotorOutputs(motors.Signals, SpoolOutput):
    """Signals of spool, valve and relief valves, of both ends of the lines, and of the oil in the motor."""

    motor_flow_a: Scalar = Quantity("m3/s", "Flow from {} line A to the motor", 1e-3)
    motor_flow_b: Scalar = Quantity("m3/s", "Flow from {} line B to the motor", 1e-3)
    valve_pressure_a: Scalar = chamber.port_pressure("Pressure at port A of the {} valve")
    valve_pressure_b: Scalar = chamber.port_pressure("Pressure at port B of the {} valve")
    bulk_modulus_a: Scalar = Quantity("Pa", "Effective bulk modulus of the oil at motor port A", 1e9)
    bulk_modulus_b: Scalar = Quantity("Pa", "Effective bulk modulus of the oil at motor port B", 1e9)


class SpoolStates(Group):
    """Position and speed of a spool."""

    spool_position: Scalar = Quantity("1", "Spool position of the {} valve, relative to its stroke")
    spool_speed: Scalar = Quantity("1/s", "Spool speed of the {} valve", 10.0)


@dataclass(frozen=True)
class Lines:
    """Both lines of an axis, by the names of their states."""

    kind: Actuator
    lines: tuple[LineStates, LineStates]

    @classmethod
    def of(cls, kind: Actuator, outputs: type[Group], lumps: int) -> "Lines":
        """Lines of so many lumps each."""
        declared = {**quantities(kind.flows), **quantities(outputs)}
        begin, end, text = kind.line
        a, b = (
            hose.line_states(
                {
                    name: declared[name]
                    for name in (kind.pattern.format(side=side, of=of) for of in kind.ends)
                },
                *(begin.format(side=side), end.format(side=side)),
                *(text.format(side=side, Side=side.upper()), lumps),
            )
            for side in kind.sides
        )
        return cls(kind, (a, b))

    @property
    def chambers(self) -> tuple[tuple[str, LineStates], ...]:
        """Pressure at the end of each line, and the line."""
        return tuple(zip(self.kind.names("pressure"), self.lines, strict=True))

    def states(self) -> type[Any]:
        """The group of the states of an axis."""
        declared = quantities(self.kind.pressures)
        members = {
            name: q for end, line in self.chambers for name, q in ({end: declared[end]} | line.all()).items()
        }
        return make_group("States", members, SpoolStates)

    def start(self, u: Any, own: Any, p: Any, pressures: Mapping[str, Scalar]) -> dict[str, Scalar]:
        """Initial values: oil at rest at these pressures [Pa] of the chambers, spool at its command."""
        position = spool_valve.commanded_position(u.command, valve_of(own, p).full_command)
        state: dict[str, Scalar] = {"spool_position": position, "spool_speed": 0.0}
        for end, line in self.chambers:
            state |= dict.fromkeys(line.all(), 0.0)
            state |= dict.fromkeys(line.pressures, pressures[end])
        return state

    def supplied(self, x: Any, u: Any, own: Any, p: Any) -> tuple[Circuit, Sensed, dict[str, Scalar]]:
        """From the edges to the chambers; load pressure; rates of the spool."""
        line = line_of(self.kind, own, p)
        valve, ports = valve_of(own, p), self.kind.names("valve_pressure")
        spool = getattr(own, "spool", None) or p.spool
        state = SpoolState(x.spool_position, x.spool_speed)
        flows = both(x, self.kind.names(self.kind.ends[0]))
        found = spool_valve.spool_ports(valve, spool, state.position, flows, u, p)
        nodes = {
            n: Node(port.pressure, of) for n, port, of in zip(ports, found, spool_valve.PORTS, strict=True)
        }
        whole = Circuit(nodes, spool_valve.branches(found, ports))
        for port, (end, states), of in zip(ports, self.chambers, ("1.", "2."), strict=True):
            whole |= hose.ladder(line, states, x, port, end, of)
        full = valve.full_command
        bands = opening_curve.meter_in_dead_bands(valve, spool.overlap_pa, spool.overlap_pb, full)
        sensed = partial(load_sensing.load_pressure, state.position, state.speed, bands, 1)
        rates = spool_valve.spool_rates(spool, state, spool_valve.commanded_position(u.command, full))
        return whole, sensed, {"spool_position": rates.position, "spool_speed": rates.speed}

    def shown(self, x: Any, p: AeratedOil) -> dict[str, Scalar]:
        """Spool, and the oil in the chambers."""
        moduli = (1 / p.compliance(getattr(x, end)) for end, _ in self.chambers)
        named = dict(zip(self.kind.names("bulk_modulus"), moduli, strict=True))
        return {"spool_position": x.spool_position, **named}


def line_of(kind: Actuator, own: Any, p: Any) -> HydraulicLine:
    """Parameters of each of the two hoses of a cylinder, or lines of a motor."""
    line: Any = kind.hose(own)
    return HydraulicLine(line.length, line.bore, line.friction(p), p.hose_wall_modulus, p)


def lumps_of(path: Path) -> Callable[[Axis], int]:
    """Lumps of each line that the values of a parameters.toml need below 75 Hz (`hose.lumps_needed`)."""

    def lumps(axis: Axis) -> int:
        own = {axis.name: (MODELS[axis.actuator][0], axis.name, axis.named)}
        return needed(
            axis, group_of(path, make_group("Parameters", {}, Common, *axis.actuator.common, **own))
        )

    return lumps


def needed(axis: Axis, p: Any) -> int:
    """Lumps of each line of an axis that the parameters of its part need below 75 Hz."""
    return hose.default_lumps(line_of(axis.actuator, getattr(p, axis.name), p))


def _cylinder(lines: Lines, x: Any, u: Any, own: Any, p: Any) -> Drive:
    supplied, load, rates = lines.supplied(x, u, own, p)
    whole = cylinders.ends(x, u, own, p) | supplied
    whole |= Circuit({}, cylinders.reliefs(p.relief, own, p, cylinders.CHAMBERS))
    return Drive(whole, load, cylinders.CHAMBERS, cylinders.force(own), rates, lines.shown(x, p))


def _motor(lines: Lines, x: Any, u: Any, own: Any, p: Any) -> Drive:
    supplied, load, rates = lines.supplied(x, u, own, p)
    whole = supplied | motors.ends(x, u, 0, own.motor_volume, p)
    whole |= Circuit({}, motor.branches(motors.LINES, own.displacement * u.speed, *own.leakage))
    whole |= Circuit({}, motors.reliefs(own, p))
    return Drive(whole, load, motors.LINES, motors.torque(own), rates, lines.shown(x, p))


# parameters, outputs and drive of an axis
MODELS: Mapping[Actuator, tuple[type[Group], type[Group], Callable[..., Drive]]] = {
    CYLINDER: (cylinders.LineDrive, CylinderOutputs, _cylinder),
    MOTOR: (motors.LineDrive, MotorOutputs, _motor),
}


def detailed(lumps: Callable[[Axis], int]) -> Fidelity:
    """This fidelity with so many lumps in each line of an axis."""

    def model(axis: Axis) -> Model:
        parameters, outputs, drive = MODELS[axis.actuator]
        lines = Lines.of(axis.actuator, outputs, lumps(axis))
        return Model(parameters, lines.states(), partial(drive, lines), lines.start, outputs)

    return Fidelity(model, common=(Common,), valve=CurvedEdges, require=spool_valve.requirements, spool=Spool)
