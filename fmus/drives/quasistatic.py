"""Drives without line dynamics: a spool valve directly at a cylinder or a motor with gear.

The limit of `lumped` for lines without inertance (I -> 0): the flows Q follow from the pressures
(`spool_valve.ports_from_pressure`). A line is a volume, and its friction in series with the open edge. Valid
for motions that are slow compared with the oil column of the line. Its time constant is I / (2 C_R Q): 10 ms
for 3 m of 3/4 in hose at 40 L/min through an edge of 40 mm2, less for a smaller edge.

Motor:

    C dP_a/dt = Q_a - D w - (P_a - P_b) / R_in - (P_a - P_t) / R_ex
    C dP_b/dt = Q_b + D w + (P_a - P_b) / R_in - (P_b - P_t) / R_ex           eqs. (8), (11), (12)

The pressures are those of the motor ports. The torque depends only on states.
"""

from typing import Any

from fmus.components import motor, spool_valve
from fmus.components.chamber import Oil
from fmus.components.circuit import Circuit
from fmus.components.hose import Law, in_series
from fmus.components.load_sensing import sensed
from fmus.components.spool_valve import CurvedValve
from fmus.contract import Scalar
from fmus.drives import cylinder as cylinders
from fmus.drives import motor as motors
from fmus.drives.cylinder import CYLINDER
from fmus.drives.drive import Actuator, Drive, Fidelity, Model, both, valve_of
from fmus.drives.motor import MOTOR


def _supplied(
    kind: Actuator, x: Any, u: Any, own: Any, p: Any, line: Law
) -> tuple[Circuit, dict[str, Scalar]]:
    """Edges of the valve at the chambers, and the flows."""
    chambers = kind.names("pressure")
    found = spool_valve.ports_from_pressure(valve_of(own, p), u.command, both(x, chambers), u, p, line)
    flows = dict(zip(kind.names("flow"), (port.line for port in found), strict=True))
    edges = spool_valve.branches(found, chambers)
    return Circuit({}, {name: in_series(edge, line) for name, edge in edges.items()}), flows


def _cylinder(x: Any, u: Any, own: Any, p: Any) -> Drive:
    supplied, flows = _supplied(CYLINDER, x, u, own, p, own.hose.friction(p))
    whole = cylinders.ends(x, u, own, p, own.hose.at_temperature(p, u.oil_temperature)) | supplied
    return Drive(whole, sensed(valve_of(own, p), u), cylinders.CHAMBERS, cylinders.force(own), shown=flows)


def _motor(x: Any, u: Any, own: Any, p: Any) -> Drive:
    supplied, flows = _supplied(MOTOR, x, u, own, p, own.line.friction(p))
    whole = motors.ends(x, u, own.capacitance(p, u.oil_temperature)) | supplied
    whole |= Circuit({}, motor.branches(motors.LINES, own.displacement * u.speed, *own.leakage))
    return Drive(whole, sensed(valve_of(own, p), u), motors.LINES, motors.torque(own), shown=flows)


MODELS = {
    CYLINDER: Model(cylinders.VolumeDrive, cylinders.Pressures, _cylinder),
    MOTOR: Model(motors.VolumeDrive, motors.Pressures, _motor),
}
QUASISTATIC = Fidelity(
    lambda axis: MODELS[axis.actuator], common=(Oil,), valve=CurvedValve, require=spool_valve.requirements
)
