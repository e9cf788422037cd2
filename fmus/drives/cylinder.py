"""An axis with a single-ended cylinder: its variables, and what is alike at every fidelity.

Eq. (9a) with the corrections E3, E4, E6, E7, E8 of docs/equations.md, for the head (port A) and the rod side:

    C_h dP_h/dt  = Q_h - A_h x'        C_h = C_hose + (V_0 + A_h x) / beta
    C_r dP_r/dt  = Q_r + A_r x'        C_r = C_hose + (V_0 + A_r (L - x)) / beta
    F            = A_h P_h - A_r P_r                                                        eq. (6a)

Signs: flows are positive into the cylinder; x from the closed end; velocities and forces are positive if they
extend the rod; a positive command extends the rod.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from fmus import ports
from fmus.components import chamber, circuit, cylinder, hose
from fmus.components.chamber import Oil
from fmus.components.circuit import GROUND, TANK, Branch, Circuit, Kind, Node
from fmus.components.cylinder import Cylinder
from fmus.components.hose import Hose, LumpedHose, ReferenceHose, VolumeHose
from fmus.components.orifice import PressureValve
from fmus.contract import Group, Quantity, Scalar
from fmus.drives.drive import Actuator, Names, Totals, both, valve_of

SENSE = "extends the rod"  # what a positive command does


class Preload(Group):
    """Initial pressure of the drives."""

    initial_preload: Scalar = Quantity(
        "Pa", "Initial pressure of the unloaded side of a cylinder", 1e6, minimum=1e3, group="Start"
    )


class Pressures(Group):
    """Pressures of a cylinder."""

    head_pressure: Scalar = chamber.pressure("Pressure at the head side of the {} cylinder")
    rod_pressure: Scalar = chamber.pressure("Pressure at the rod side of the {} cylinder")


class Flows(Group):
    """Flows into a cylinder."""

    head_flow: Scalar = Quantity("m3/s", "Flow into the head side of the {} cylinder", 1e-3)
    rod_flow: Scalar = Quantity("m3/s", "Flow into the rod side of the {} cylinder", 1e-3)


class Inputs(Group):
    """Command and motion of the piston; the rate inputs carry exact time derivatives."""

    command: Scalar = ports.command("{}", SENSE, "command_rate")
    command_rate: Scalar = ports.rate_input("{}_command", "V/s", 10.0)
    position: Scalar = Quantity(
        "m", "Piston position of the {} cylinder from its closed end", rate="velocity"
    )
    velocity: Scalar = Quantity("m/s", "Piston velocity of the {} cylinder", 0.1, rate="acceleration")
    acceleration: Scalar = ports.rate_input("{}_velocity", "m/s2")
    holding_force: Scalar = Quantity(
        "N", "Force that holds the {} at the start; only used for initialisation", 1e5
    )


class Outputs(Group):
    """Force and its rate (to the mechanics), and cavities."""

    force: Scalar = Quantity("N", "Hydraulic force of the {} cylinder", 1e5)
    force_rate: Scalar = ports.rate_output("{}_force", "N/s", 1e6)
    void_volume: Scalar = chamber.cavity("the {} cylinder and its hoses")
    oil_velocity: Scalar = hose.oil_velocity("Velocity of the oil in the hoses of the {}, the higher one")


class CylinderTotals(Totals):
    """Outputs of all axes together; oil takes compression energy along into the chambers."""

    convected_power: Scalar = Quantity(
        "W", "Compression energy convected by oil into growing volumes, minus that out of shrinking ones", 1e3
    )


class Signals(Group):
    """Signals at the valve, where a machine has its sensors, and of the relief valves."""

    head_valve_flow: Scalar = Quantity("m3/s", "Flow from the valve into the head hose of the {}", 1e-3)
    rod_valve_flow: Scalar = Quantity("m3/s", "Flow from the valve into the rod hose of the {}", 1e-3)
    relief_flow: Scalar = Quantity("m3/s", "Flow of both relief valves of the {} cylinder", 1e-3)
    anti_cavitation_flow: Scalar = Quantity(
        "m3/s", "Flow of both anti-cavitation valves of the {} cylinder", 1e-3
    )


class VolumeDrive(Cylinder, hose=(VolumeHose, "{} hose")):
    """Cylinder and hoses without line dynamics."""


class LumpedDrive(Cylinder, hose=(LumpedHose, "{} hose")):
    """Cylinder and hoses, each hose one lump."""


class LineDrive(Cylinder, hose=(Hose, "{} hose")):
    """Cylinder and hoses, each hose a line."""


def ends(x: Any, u: Any, own: Cylinder, oil: Oil, capacitance: Scalar = 0) -> Circuit:
    """The lines, the chambers, and the piston as two gyrators; capacitance: of each hose [m3/Pa]."""
    (head, rod), (v_head, v_rod) = own.areas, own.volumes(u.position)
    return Circuit(
        {
            **circuit.lines(u),
            "head_pressure": Node(x.head_pressure, "C_1", capacitance, v_head, oil),
            "rod_pressure": Node(x.rod_pressure, "C_2", capacitance, v_rod, oil),
        },
        {
            "head_piston": Branch(
                "head_pressure", GROUND, Kind.PISTON, head * u.velocity, "gy_1", mechanics=PISTON
            ),
            "rod_piston": Branch(
                GROUND, "rod_pressure", Kind.PISTON, rod * u.velocity, "gy_2", mechanics=PISTON
            ),
        },
    )


def reliefs(relief: PressureValve, own: Any, p: Any, at: Names) -> dict[str, Branch]:
    """Relief and anti-cavitation valves at two nodes."""
    back = partial(p.anti_cavitation.flow, valve_of(own, p), p)
    return {
        "head_relief": Branch(at[0], TANK, Kind.RELIEF, relief.flow, "Q_relief,h"),
        "rod_relief": Branch(at[1], TANK, Kind.RELIEF, relief.flow, "Q_relief,r"),
        "head_anti_cavitation": Branch(TANK, at[0], Kind.ANTI_CAVITATION, back, "Q_anti,h"),
        "rod_anti_cavitation": Branch(TANK, at[1], Kind.ANTI_CAVITATION, back, "Q_anti,r"),
    }


def force(own: Cylinder) -> Callable[[Circuit], dict[str, Scalar]]:
    """Force and its rate."""
    return lambda whole: {
        "force": cylinder.force(*own.areas, *both(whole.pressures, CHAMBERS)),
        "force_rate": cylinder.force(*own.areas, *both(whole.rates, CHAMBERS)),
    }


def initial(u: Any, own: Cylinder, p: Any) -> dict[str, Scalar]:
    """Initial pressures of the chambers, in balance with the holding force."""
    found = cylinder.holding_pressures(u.holding_force, *own.areas, u.tank_pressure + p.initial_preload)
    return dict(zip(CHAMBERS, found, strict=True))


def require(u: Any, own: Cylinder, _: object) -> dict[str, Scalar]:
    """Requirements: a rod thinner than the bore, chambers with positive volume."""
    v_head, v_rod = own.volumes(u.position)
    return {
        "{}_rod is thinner than {}_bore": own.areas[1],
        "head chamber of the {} cylinder has a positive volume at {}_position": v_head,
        "rod chamber of the {} cylinder has a positive volume at {}_position": v_rod,
    }


def derive(own: Any, p: Any) -> dict[str, Scalar]:
    """Parameters of the hoses; walls are rigid in variants without a modulus for them."""
    of = (p.hose_reference_resistance, getattr(p, "hose_wall_modulus", math.inf))
    return {f"hose_{name}": value for name, value in hose.derived_parameters(own.hose, p, *of).items()}


CYLINDER = Actuator(
    sides=("head", "rod"),
    pattern="{side}_{of}",
    line=("{side}_hose", "", "the {side} hose of the {{}}"),
    ends=("valve_flow", "flow"),
    pressures=Pressures,
    flows=Flows,
    outputs=Outputs,
    totals=CylinderTotals,
    common=(Preload, ReferenceHose),
    hose=lambda own: own.hose,
    terminal=lambda axis: ports.rod(axis, drives=True),
    power=("force", "velocity"),
    initial=initial,
    derive=derive,
    require=require,
)
PISTON = ("ẋ", "B")  # speed of a piston, and damping of its seals, which is in the mechanics
CHAMBERS = CYLINDER.names("pressure")
PORTS = CYLINDER.names("valve_pressure")
