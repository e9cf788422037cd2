"""Drives at the paper's fidelity: a spool valve, and two lines of one lump each.

    I dQ/dt = P_port - P - dp(Q)     for both lines, with the ports of `spool_valve`, dp of `hose.Friction`

Motor: the lines are short, so their friction is laminar, R_line between line and motor port, and the
turbulent C_R is zero unless it is measured. With the motor ports P_1, P_2 of `fmus.components.motor`

    C dP_a/dt = Q_a - (P_a - P_1) / R_line              C dP_b/dt = Q_b - (P_b - P_2) / R_line
    torque    = D_m N (P_1 - P_2)                       eqs. (8), (9a), corrections E1, E2, E5

The torque depends on the speed with 2 D^2 R_line (28 N.m.s/rad), which is required for conservation of power.
"""

from collections.abc import Callable
from typing import Any

from fmus.components import motor, spool_valve
from fmus.components.chamber import Oil
from fmus.components.circuit import Circuit, Node
from fmus.components.hose import ShortLine, column
from fmus.components.load_sensing import sensed
from fmus.components.spool_valve import CurvedValve
from fmus.contract import Scalar
from fmus.drives import cylinder as cylinders
from fmus.drives import motor as motors
from fmus.drives.cylinder import CYLINDER
from fmus.drives.drive import Actuator, Drive, Fidelity, Model, Names, both, valve_of
from fmus.drives.motor import MOTOR


class CylinderState(cylinders.Flows, cylinders.Pressures):
    """Pressures and flows of a cylinder."""


class MotorState(motors.Flows, motors.Pressures):
    """Pressures and flows of a motor."""


def _supplied(
    kind: Actuator,
    x: Any,
    u: Any,
    own: Any,
    p: Any,
    inertance: Scalar,
    drop: Callable[[Scalar], Scalar],
    symbols: Names,
) -> Circuit:
    """Edges of the valve, and the oil columns to the chambers; drop: of a column by its friction."""
    flows, ports, chambers = (kind.names(n) for n in ("flow", "valve_pressure", "pressure"))
    valve, q = valve_of(own, p), both(x, flows)
    found = spool_valve.ports_from_flow(valve, u.command, q, u, p)
    columns = zip(flows, ports, chambers, q, symbols, strict=True)
    return Circuit(
        {n: Node(port.pressure, of) for n, port, of in zip(ports, found, spool_valve.PORTS, strict=True)},
        {
            **spool_valve.branches(found, ports),
            **{
                n: column(start, end, flow, sign, inertance, drop(flow))
                for n, start, end, flow, sign in columns
            },
        },
    )


def _cylinder(x: Any, u: Any, own: Any, p: Any) -> Drive:
    line = (own.hose.inertance, own.hose.friction(p).drop)
    supplied = _supplied(CYLINDER, x, u, own, p, *line, ("I_1, R_1", "I_2, R_2"))
    whole = cylinders.ends(x, u, own, p, own.hose.at_temperature(p, u.oil_temperature)) | supplied
    return Drive(whole, sensed(valve_of(own, p), u), cylinders.CHAMBERS, cylinders.force(own))


def _motor(x: Any, u: Any, own: Any, p: Any) -> Drive:
    line, ports = own.line, MOTOR.names("motor_pressure")
    turbulent = ShortLine(0, line.turbulent_resistance)
    supplied = _supplied(MOTOR, x, u, own, p, line.inertance, turbulent.drop, ("I_1", "I_2"))
    around = motors.ends(x, u, own.capacitance(p, u.oil_temperature))
    whole = around | supplied
    whole |= motor.behind_lines(
        around.nodes, motors.LINES, ports, line.resistance, own.displacement * u.speed, *own.leakage
    )

    def effort(whole: Circuit) -> dict[str, Scalar]:
        """The motor's ports are linear in the pressures, so the rates of the pressures give their rates."""
        rates = motor.port_pressures(
            *(*both(whole.rates, motors.LINES), u.tank_pressure_rate, line.resistance),
            *(own.displacement * u.acceleration, *own.leakage),
        )
        return motors.from_ports(own, both(whole.pressures, ports), rates)

    return Drive(whole, sensed(valve_of(own, p), u), motors.LINES, effort)


MODELS = {
    CYLINDER: Model(
        parameters=cylinders.LumpedDrive,
        states=CylinderState,
        drive=_cylinder,
        start=lambda *_: dict.fromkeys(CYLINDER.names("flow"), 0),
    ),
    MOTOR: Model(
        parameters=motors.LumpedDrive,
        states=MotorState,
        drive=_motor,
        start=lambda *_: dict.fromkeys(MOTOR.names("flow"), 0),
    ),
}
LUMPED = Fidelity(
    lambda axis: MODELS[axis.actuator], common=(Oil,), valve=CurvedValve, require=spool_valve.requirements
)
