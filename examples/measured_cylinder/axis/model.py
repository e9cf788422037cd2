"""A servo valve, two lines, a cylinder and the mass that it moves, from the components of the harvester.

    spool       x'' of second order [spool_valve.spool_rates]; it stands for the command V x
    edges       dp = Q (|Q| + Q_t) / (K_e o(V x))^2, K_e = C_d A_e sqrt(2 / rho), four areas A_e [orifice]
                beside each a laminar leakage G dp
                1 / K^2 = 1 / (K_e o)^2 + C_R of bores and lines, each edge its own [spool_valve]
    chambers    dP/dt = (Q -+ A v) / (C + (V_line + V(x)) kappa(P))    C: walls of the line [cylinder]
                kappa: oil with entrained air, which makes a chamber soft at low pressure [chamber]
    piston      m dv/dt = A_head P_head - A_rod P_rod - F_friction - F_load + F_stop
    friction    LuGre with Stribeck curve [friction]; end stops by Hunt and Crossley [cylinder]

o is the opening of the valve over the command, a straight line behind a dead band, each edge its own. With
the resistance in series it is a curve of three numbers, which three voltages determine.

Signs: positions are measured from the zero of the sensor; speed and force are positive if they extend the
rod, which a positive command does. The load is positive if it presses the rod in.
Validity: constant supply and tank pressure at the valve; walls of the lines linear in the pressure.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import casadi as ca

from fmus.components import chamber, cylinder, friction, orifice, spool_valve
from fmus.components.spool_valve import SpoolState
from fmus.contract import Group, Quantity, Scalar, Subsystem

DAMPING_RATIO = 0.7  # of the spool, usual in data sheets of servo valves
SPOOL_SPEED = 1e3  # 1/s, of the spool: not limited


def _area(edge: str) -> Quantity:
    return Quantity("m2", f"Opening area of the edge {edge} at full command", 1e-6, minimum=0.0)


def _dead_band(edge: str, command: str) -> Quantity:
    return Quantity("V", f"Largest {command} at which the edge {edge} is closed", 0.1)


def _resistance(edge: str) -> Quantity:
    text = f"Turbulent resistance C_R of bores and line in series with the edge {edge}"
    return Quantity("Pa.s2/m6", text, 1e14, minimum=0.0)


class AxisParameters(Group):
    """Parameters; values and sources are in parameters.toml."""

    area_pa: Scalar = _area("P-A")
    area_at: Scalar = _area("A-T")
    area_pb: Scalar = _area("P-B")
    area_bt: Scalar = _area("B-T")
    dead_band_pa: Scalar = _dead_band("P-A", "command")
    dead_band_at: Scalar = _dead_band("A-T", "negative command")
    dead_band_pb: Scalar = _dead_band("P-B", "negative command")
    dead_band_bt: Scalar = _dead_band("B-T", "command")
    forward_factor: Scalar = Quantity("1", "Factor of the flow through P-A and B-T", minimum=0.1)
    backward_factor: Scalar = Quantity("1", "Factor of the flow through P-B and A-T", minimum=0.1)
    full_command: Scalar = Quantity("V", "Command at which the valve is fully open", minimum=0.1)
    command_rounding: Scalar = Quantity("V", "Command range over which an edge begins to open", minimum=1e-3)
    discharge_coefficient: Scalar = Quantity(
        "1", "Discharge coefficient of the metering edges", minimum=0.1, maximum=1.0
    )
    leakage: Scalar = Quantity("m3/(s.Pa)", "Laminar leakage of each edge", 1e-13, minimum=1e-17)
    transition_flow: Scalar = Quantity("m3/s", "Flow Q_t below which edges are laminar", 1e-7, minimum=1e-10)
    spool_frequency: Scalar = Quantity("Hz", "Natural frequency of the spool", 50.0, minimum=0.1)
    resistance_pa: Scalar = _resistance("P-A")
    resistance_at: Scalar = _resistance("A-T")
    resistance_pb: Scalar = _resistance("P-B")
    resistance_bt: Scalar = _resistance("B-T")
    supply_pressure: Scalar = Quantity("Pa", "Supply pressure at the valve", 1e6, minimum=0.0)
    tank_pressure: Scalar = Quantity("Pa", "Return pressure at the valve", 1e5, minimum=0.0)
    density: Scalar = Quantity("kg/m3", "Density of the oil", 1e3, minimum=100.0)
    bulk_modulus: Scalar = Quantity("Pa", "Bulk modulus of the oil", 1e9, minimum=1e7)
    air_share: Scalar = Quantity(
        "1", "Volume of free air at atmospheric pressure per volume of oil", 1e-2, minimum=0.0, maximum=1.0
    )
    air_exponent: Scalar = Quantity("1", "Polytropic exponent of the air", minimum=1.01, maximum=1.7)
    line_volume: Scalar = Quantity("m3", "Volume of the line to each chamber", 1e-5, minimum=1e-9)
    head_line_capacitance: Scalar = Quantity(
        "m3/Pa", "Capacitance of the walls of the line to the head side", 1e-13, minimum=0.0
    )
    rod_line_capacitance: Scalar = Quantity(
        "m3/Pa", "Capacitance of the walls of the line to the rod side", 1e-13, minimum=0.0
    )
    bore: Scalar = Quantity("m", "Bore", 1e-2, minimum=1e-3)
    rod: Scalar = Quantity("m", "Rod diameter", 1e-2, minimum=0.0)
    stroke: Scalar = Quantity("m", "Stroke", 0.1, minimum=1e-3)
    retracted: Scalar = Quantity("m", "Reading of the position sensor with the rod retracted", 1e-2)
    mass: Scalar = Quantity("kg", "Mass of piston, rod and load", minimum=1e-3)
    load: Scalar = Quantity("N", "Constant force that presses the rod in", 10.0)
    coulomb_friction: Scalar = Quantity("N", "Friction at fast slip", 100.0, minimum=0.0)
    static_ratio: Scalar = Quantity("1", "Break-away friction over that at fast slip", minimum=1.0)
    stribeck_speed: Scalar = Quantity("m/s", "Speed over which the friction falls", 0.01, minimum=1e-4)
    bristle_deflection: Scalar = Quantity("m", "Deflection of the seals before slip", 1e-4, minimum=1e-7)
    bristle_damping_time: Scalar = Quantity(
        "s", "Damping of the seals over their stiffness", 1e-3, minimum=0.0
    )
    viscous_friction: Scalar = Quantity("N.s/m", "Viscous friction of the piston", 100.0, minimum=0.0)
    stop_stiffness: Scalar = Quantity("N/m", "Stiffness of the end stops", 1e6, minimum=1.0)
    stop_damping: Scalar = Quantity("s/m", "Contact damping of the end stops", minimum=0.0)
    stop_rounding: Scalar = Quantity("m", "Depth over which a stop begins to act", 1e-4, minimum=1e-6)


class AxisState(Group):
    """Spool, pressures, piston, and deflection of the seals."""

    spool_position: Scalar = Quantity("1", "Position of the spool, relative to its stroke", 0.1)
    spool_speed: Scalar = Quantity("1/s", "Speed of the spool, relative to its stroke", 10.0)
    head_pressure: Scalar = Quantity("Pa", "Pressure at the head side", 1e6)
    rod_pressure: Scalar = Quantity("Pa", "Pressure at the rod side", 1e6)
    position: Scalar = Quantity("m", "Position of the piston, as its sensor reads it", 0.1, absolute=1e-4)
    speed: Scalar = Quantity("m/s", "Speed of the piston", 0.1)
    bristle: Scalar = Quantity("m", "Deflection of the seals", 1e-4)


class AxisInputs(Group):
    """The command, and what differs from run to run."""

    command: Scalar = Quantity("V", "Command to the servo valve, positive extends the rod", 1.0)
    forward_gain: Scalar = Quantity("1", "Flow through P-A and B-T in this run, relative to the mean")
    backward_gain: Scalar = Quantity("1", "Flow through P-B and A-T in this run, relative to the mean")


class AxisOutputs(Group):
    """What the sensors measure, and flows and forces."""

    head_pressure: Scalar = Quantity("Pa", "Pressure at the head side", 1e6)
    rod_pressure: Scalar = Quantity("Pa", "Pressure at the rod side", 1e6)
    position: Scalar = Quantity("m", "Position of the piston, as its sensor reads it", 0.1)
    speed: Scalar = Quantity("m/s", "Speed of the piston", 0.1)
    head_flow: Scalar = Quantity("m3/s", "Flow from the valve into the head side", 1e-5)
    rod_flow: Scalar = Quantity("m3/s", "Flow from the valve into the rod side", 1e-5)
    friction_force: Scalar = Quantity("N", "Friction against the motion", 100.0)


@dataclass(frozen=True)
class Axis:
    """All that the rates and the outputs have in common."""

    head_flow: Scalar
    rod_flow: Scalar
    capacitances: tuple[Scalar, Scalar]
    resistance: friction.Resistance
    acceleration: Scalar


def square_gain(edge: str, command: Scalar, gain: Scalar, p: AxisParameters) -> Scalar:
    """K^2 [m6/(s2.Pa)] of an edge with what is in series, at a command [V] in its direction.

    gain   flow in this run, relative to the mean
    """
    full = orifice.flow_gain(getattr(p, f"area_{edge}"), p.discharge_coefficient, p.density)
    curve = (getattr(p, f"dead_band_{edge}"), p.full_command, p.command_rounding)
    share = spool_valve.opening(command, *curve)
    square = (full * share) ** 2
    return gain**2 * square / (1 + getattr(p, f"resistance_{edge}") * square)


def port_flows(x: AxisState, u: AxisInputs, p: AxisParameters) -> tuple[Scalar, Scalar]:
    """Flows [m3/s] out of the ports A and B into the lines."""
    volts = x.spool_position * p.full_command
    forward = volts > 0
    behind_a = ca.if_else(forward, p.supply_pressure, p.tank_pressure)
    behind_b = p.supply_pressure + p.tank_pressure - behind_a
    ahead = (volts, p.forward_factor * u.forward_gain, p)
    back = (-volts, p.backward_factor * u.backward_gain, p)
    a = square_gain("pa", *ahead) + square_gain("at", *back)
    b = square_gain("bt", *ahead) + square_gain("pb", *back)

    def flow(pressure: Scalar, behind: Scalar, square: Scalar) -> Scalar:
        leakage = p.leakage * (p.supply_pressure + p.tank_pressure - 2 * pressure)
        return leakage + orifice.root(square * (behind - pressure), p.transition_flow)

    return flow(x.head_pressure, behind_a, a), flow(x.rod_pressure, behind_b, b)


def evaluate(x: AxisState, u: AxisInputs, p: AxisParameters) -> Axis:
    """Flows, capacitances and forces at a state."""
    head, rod = cylinder.areas(p.bore, p.rod)
    inside = x.position - p.retracted
    volumes = cylinder.volumes(inside, p.stroke, head, rod, p.line_volume)
    oil = chamber.AeratedOil(
        density=p.density,
        bulk_modulus=p.bulk_modulus,
        viscosity=0.0,
        air_share=p.air_share,
        air_exponent=p.air_exponent,
    )
    dry = friction.Bristles(
        p.coulomb_friction, p.static_ratio, p.stribeck_speed, p.bristle_deflection, p.bristle_damping_time
    )
    resistance = friction.lugre(x.speed, x.bristle, dry, p.viscous_friction)
    stop = cylinder.stop_force(inside, x.speed, p.stroke, p.stop_stiffness, p.stop_damping, p.stop_rounding)
    force = cylinder.force(head, rod, x.head_pressure, x.rod_pressure)
    return Axis(
        *port_flows(x, u, p),
        capacitances=(
            p.head_line_capacitance + volumes[0] * oil.compliance(x.head_pressure),
            p.rod_line_capacitance + volumes[1] * oil.compliance(x.rod_pressure),
        ),
        resistance=resistance,
        acceleration=(force - resistance.force - p.load + stop) / p.mass,
    )


def dynamics(x: AxisState, u: AxisInputs, p: AxisParameters) -> AxisState:
    """Time derivative of the state."""
    axis = evaluate(x, u, p)
    head, rod = cylinder.areas(p.bore, p.rod)
    spool = spool_valve.Spool(
        frequency=p.spool_frequency,
        damping=DAMPING_RATIO,
        speed=SPOOL_SPEED,
        **{f"overlap_{edge}": 0.0 for edge in ("pa", "at", "pb", "bt")},
    )
    commanded = spool_valve.commanded_position(u.command, p.full_command)
    moved = spool_valve.spool_rates(spool, SpoolState(x.spool_position, x.spool_speed), commanded)
    return AxisState(
        spool_position=moved.position,
        spool_speed=moved.speed,
        head_pressure=chamber.pressure_rate(
            x.head_pressure, axis.head_flow - head * x.speed, axis.capacitances[0]
        ),
        rod_pressure=chamber.pressure_rate(
            x.rod_pressure, axis.rod_flow + rod * x.speed, axis.capacitances[1]
        ),
        position=x.speed,
        speed=axis.acceleration,
        bristle=axis.resistance.deflection_rate,
    )


def observe(x: AxisState, u: AxisInputs, p: AxisParameters) -> AxisOutputs:
    """Outputs; they depend on the state alone."""
    axis = evaluate(x, u, p)
    return AxisOutputs(
        head_pressure=x.head_pressure,
        rod_pressure=x.rod_pressure,
        position=x.position,
        speed=x.speed,
        head_flow=axis.head_flow,
        rod_flow=axis.rod_flow,
        friction_force=axis.resistance.force,
    )


AXIS = Subsystem(
    name="axis",
    text="Servo valve, lines, cylinder and mass of a test rig",
    parameters=AxisParameters,
    states=AxisState,
    inputs=AxisInputs,
    outputs=AxisOutputs,
    dynamics=dynamics,
    observe=observe,
    values=Path(__file__).with_name("parameters.toml"),
)
