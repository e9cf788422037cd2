"""An axis with a motor and its gear between two lines: its variables, and what is alike at every fidelity.

    torque = D (P_1 - P_2)           D = D_m N                                   eqs. (8), (11), (12)

Signs: flows are positive towards the motor; a positive speed and torque turn counter-clockwise seen from
above, and so does a positive command.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from fmus import ports
from fmus.components import chamber, circuit, hose
from fmus.components.chamber import Oil
from fmus.components.circuit import TANK, Branch, Circuit, Kind, Node
from fmus.components.cylinder import holding_pressures
from fmus.components.hose import HoseSize, ShortLine
from fmus.components.oil import DENSITY, LAMINAR, TURBULENT
from fmus.components.orifice import Liquid
from fmus.contract import Group, Quantity, Scalar
from fmus.drives.drive import Actuator, Totals, both, valve_of

SENSE = "turns counter-clockwise"  # what a positive command does
Pair = tuple[Scalar, Scalar]  # (line A, line B), or (motor port 1, motor port 2)


class Preload(Group):
    """Initial pressure of the drive."""

    initial_preload: Scalar = Quantity(
        "Pa", "Initial pressure of both lines of the motor", 1e6, minimum=1e3, group="Start"
    )


class Line(HoseSize):
    """A line of the motor."""

    turbulent_resistance: Scalar = Quantity(
        "Pa.s2/m6",
        "Turbulent resistance C_R of each {}, beside the laminar one; 0: laminar",
        1e10,
        minimum=0.0,
        warmed=TURBULENT,
    )

    def friction(self, oil: Liquid) -> ShortLine:
        """Friction of the line."""
        dynamic = oil.kinematic_viscosity * oil.density
        return ShortLine(hose.laminar_resistance(self.length, self.bore, dynamic), self.turbulent_resistance)


class VolumeLine(Line):
    """A line with the oil of its motor side as a volume."""

    capacitance: Scalar = Quantity(
        "m3/Pa",
        "Capacitance C of each line with its motor side; 0: derived from both volumes and bulk modulus",
        1e-12,
        minimum=0.0,
    )


class LumpedLine(VolumeLine):
    """A line as one lump."""

    inertance: Scalar = Quantity(
        "kg/m4",
        "Inertance I of each {}; 0: derived from length, bore and density",
        1e6,
        minimum=0.0,
        warmed=DENSITY,
    )
    resistance: Scalar = Quantity(
        "Pa.s/m3",
        "Laminar resistance R_1 = R_2 of each {}; 0: derived from length, bore and viscosity",
        1e6,
        minimum=0.0,
        warmed=LAMINAR,
    )


class MotorSize(Group):
    """Size of motor and gear."""

    motor_displacement: Scalar = Quantity(
        "m3/rad", "Displacement D_m of the {} motor", 1e-5, minimum=1e-9, group="{} motor and gear"
    )
    gear_ratio: Scalar = Quantity("1", "Gear ratio N: motor speed over {} speed", 10.0, minimum=0.1)
    motor_volume: Scalar = Quantity("m3", "Volume of each motor side, without the line", 1e-3, minimum=1e-9)

    @property
    def displacement(self) -> Scalar:
        """D [m3/rad], displacement per angle of the shaft."""
        return self.motor_displacement * self.gear_ratio


class Motor(MotorSize):
    """Motor and gear."""

    internal_leakage_resistance: Scalar = Quantity(
        "Pa.s/m3", "Cross-port leakage resistance R_in of the {} motor", 1e12, minimum=1e6, warmed=LAMINAR
    )
    external_leakage_resistance: Scalar = Quantity(
        "Pa.s/m3",
        "Case leakage resistance R_ex of each port of the {} motor",
        1e12,
        minimum=1e6,
        warmed=LAMINAR,
    )

    @property
    def leakage(self) -> Pair:
        """R_in and R_ex [Pa.s/m3]."""
        return self.internal_leakage_resistance, self.external_leakage_resistance


class VolumeDrive(Motor, line=(VolumeLine, "{} line")):
    """Motor and lines without line dynamics."""

    def capacitance(self, oil: Oil, temperature: Scalar) -> Scalar:
        """C [m3/Pa] of each line with its motor side, with the oil at a temperature [K]."""
        volume = hose.area(self.line.bore) * self.line.length + self.motor_volume
        return self.line.capacitance + hose.warmed_compliance(volume, oil, temperature)


class LumpedDrive(VolumeDrive, line=(LumpedLine, "{} line")):
    """Motor and lines, each line one lump."""


class LineDrive(Motor, line=(Line, "{} line")):
    """Motor and lines, each of many lumps."""


class Pressures(Group):
    """Pressures of both lines."""

    pressure_a: Scalar = chamber.pressure("Pressure of {} line A")
    pressure_b: Scalar = chamber.pressure("Pressure of {} line B")


class Flows(Group):
    """Flows into both lines."""

    flow_a: Scalar = Quantity("m3/s", "Flow into {} line A", 1e-3)
    flow_b: Scalar = Quantity("m3/s", "Flow into {} line B", 1e-3)


class Inputs(Group):
    """Command and motion of the shaft; the rate inputs are exact time derivatives."""

    command: Scalar = ports.command("{}", SENSE, "command_rate")
    command_rate: Scalar = ports.rate_input("{}_command", "V/s", 10.0)
    speed: Scalar = Quantity("rad/s", "Speed of the {}, counter-clockwise", 1.0, rate="acceleration")
    acceleration: Scalar = ports.rate_input("{}_speed", "rad/s2")


class HeldInputs(Inputs):
    """With a load at the start, as on a slope."""

    holding_torque: Scalar = Quantity(
        "N.m", "Torque that holds the {} at the start; only used for initialisation", 1e4
    )


class Outputs(Group):
    """Torque and its rate (to the mechanics), ports and case drain of the motor, cavities."""

    torque: Scalar = Quantity(
        "N.m", "Torque of the drive on the {} column, with that of a holding brake", 1e4
    )
    torque_rate: Scalar = ports.rate_output("{}_torque", "N.m/s", 1e5)
    motor_pressure_a: Scalar = chamber.port_pressure("Pressure P_1 at motor port A")
    motor_pressure_b: Scalar = chamber.port_pressure("Pressure P_2 at motor port B")
    drain_flow: Scalar = Quantity("m3/s", "Case drain flow of the motor: external leakage", 1e-5)
    void_volume: Scalar = chamber.cavity("the {} motor and its lines")
    oil_velocity: Scalar = hose.oil_velocity("Velocity of the oil in the lines of the {}, the higher one")


class Signals(Group):
    """Signals of the relief valves."""

    relief_flow: Scalar = Quantity("m3/s", "Flow of the crossover relief valves from line A to line B", 1e-3)
    anti_cavitation_flow: Scalar = Quantity(
        "m3/s", "Flow of both anti-cavitation valves of the {} motor", 1e-3
    )


def ends(x: Any, u: Any, capacitance: Scalar, *oil: Any) -> Circuit:
    """The lines, and both sides of the motor; oil: their volume [m3] and what is in it, as of `Node`."""
    nodes = {
        n: Node(getattr(x, n), of, capacitance, *oil) for n, of in zip(LINES, ("C_1", "C_2"), strict=True)
    }
    return Circuit({**circuit.lines(u), **nodes}, {})


def reliefs(own: Any, p: Any) -> dict[str, Branch]:
    """Crossover relief valves at the motor, and make-up from the return line."""
    back = partial(p.anti_cavitation.flow, valve_of(own, p), p)
    return {
        "crossover_relief": Branch(*LINES, Kind.RELIEF, p.relief.cross_flow, "Q_cross"),
        "anti_cavitation_a": Branch(TANK, LINES[0], Kind.ANTI_CAVITATION, back, "Q_anti,a"),
        "anti_cavitation_b": Branch(TANK, LINES[1], Kind.ANTI_CAVITATION, back, "Q_anti,b"),
    }


def torque(own: Motor) -> Callable[[Circuit], dict[str, Scalar]]:
    """Torque and its rate of a motor directly at the lines."""
    return lambda whole: from_ports(own, both(whole.pressures, LINES), both(whole.rates, LINES))


def from_ports(own: Motor, pressures: Pair, rates: Pair) -> dict[str, Scalar]:
    """Torque and its rate, from the pressures of the motor's ports and their rates."""
    return {
        "torque": own.displacement * (pressures[0] - pressures[1]),
        "torque_rate": own.displacement * (rates[0] - rates[1]),
        "motor_pressure_a": pressures[0],
        "motor_pressure_b": pressures[1],
    }


def initial(u: Any, own: Motor, p: Any) -> dict[str, Scalar]:
    """Initial pressures of both lines: at the preload, or above it as far as a torque has to be held."""
    preload = u.tank_pressure + p.initial_preload
    if not hasattr(u, "holding_torque"):
        return dict.fromkeys(LINES, preload)
    d = own.displacement
    return dict(zip(LINES, holding_pressures(u.holding_torque, d, d, preload), strict=True))


def derive(own: Any, p: Any) -> dict[str, Scalar]:
    """Parameters of a line with its motor side; walls are rigid in variants without a modulus for them."""
    size, wall = (own.line.length, own.line.bore), getattr(p, "hose_wall_modulus", math.inf)
    parameters = {
        "capacitance": hose.capacitance(*size, p.bulk_modulus, wall) + own.motor_volume / p.bulk_modulus,
        "inertance": hose.inertance(*size, p.density),
        "resistance": hose.laminar_resistance(*size, p.viscosity),
    }
    return {f"line_{n}": value for n, value in parameters.items() if hasattr(own.line, n)}


MOTOR = Actuator(
    sides=("a", "b"),
    pattern="{of}_{side}",
    line=("line", "_{side}", "{{}} line {Side}"),
    ends=("flow", "motor_flow"),
    pressures=Pressures,
    flows=Flows,
    outputs=Outputs,
    totals=Totals,
    common=(Preload,),
    hose=lambda own: own.line,
    terminal=lambda axis: ports.shaft(axis, True, "holding_torque"),
    power=("torque", "speed"),
    initial=initial,
    derive=derive,
)
LINES = MOTOR.names("pressure")
