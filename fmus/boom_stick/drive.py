"""Equations of a cylinder drive (valve, two hoses, single-ended cylinder), and of boom and stick together.

Eq. (9a) with the corrections E3, E4, E6, E7, E8 of docs/equations.md:

    I dQ/dt      = P_port - P - C_R,hose Q|Q|           for the head and the rod line
    C_h dP_h/dt  = Q_h - A_h x'        C_h = C_hose + (V_0 + A_h x) / beta
    C_r dP_r/dt  = Q_r + A_r x'        C_r = C_hose + (V_0 + A_r (L - x)) / beta

Without line dynamics (the limit I -> 0) the line flows Q_h, Q_r of the ports A and B follow from the
pressures (`spool_valve.ports_from_pressure`). The hose is a volume, and a resistance in series with the open
edge. Valid for motions that are slow compared with the oil column of the hose. Its time constant is I / (2
C_R Q): 10 ms for 3 m of 3/4 in hose at 40 L/min through an edge of 40 mm2, less for a smaller edge.

Signs: line flows are positive into the cylinder; x from the closed end; x' and F extend.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from fmus import ports
from fmus.boom_stick.variables import AXES, AxisInputs, BoomStickInputs, DriveInputs, OilState, Pressures
from fmus.components import chamber, cylinder, hose, load_sensing, opening_curve, spool_valve
from fmus.components.cylinder import Cylinder
from fmus.components.hose import Hose, LumpedHose
from fmus.components.oil import at_temperature
from fmus.components.opening_curve import OpeningCurves
from fmus.components.spool_valve import EdgeFlows, Valve
from fmus.contract import Group, Scalar, Subsystem, Terminal
from fmus.ports import LineInputs

PARAMETERS = Path(__file__).with_name("parameters.toml")
Pair = tuple[Scalar, Scalar]  # (head side, rod side)


@dataclass(frozen=True)
class CylinderDrive:
    """One drive at one instant.

    curves         tables of its valve
    bulk_modulus   of the oil [Pa]
    x, u           pressures and line flows; inputs
    ports          of the valve: A at the head side, B at the rod side
    """

    cylinder: Cylinder
    hose: LumpedHose
    valve: Valve
    curves: OpeningCurves
    bulk_modulus: Scalar
    x: OilState
    u: AxisInputs
    ports: tuple[EdgeFlows, EdgeFlows]

    def capacitances(self) -> Pair:
        """C_h and C_r [m3/Pa]."""
        head, rod = self.cylinder.areas
        at_head, at_rod = self.cylinder.volumes(0)  # with the piston at x = 0
        return (
            self.hose.capacitance + at_head / self.bulk_modulus + head / self.bulk_modulus * self.u.position,
            self.hose.capacitance + at_rod / self.bulk_modulus - rod / self.bulk_modulus * self.u.position,
        )

    def pressure_rates(self) -> Pair:
        """Time derivatives of the pressures [Pa/s]."""
        (head, rod), (c_head, c_rod), x = self.cylinder.areas, self.capacitances(), self.x
        return (
            chamber.pressure_rate(x.head_pressure, x.head_flow - head * self.u.velocity, c_head),
            chamber.pressure_rate(x.rod_pressure, x.rod_flow + rod * self.u.velocity, c_rod),
        )

    def rates(self) -> Pressures:
        """Time derivative of the state."""
        (port_a, port_b), x = self.ports, self.x
        head, rod = self.pressure_rates()
        line = (self.hose.inertance, self.hose.resistance, self.valve.transition_flow)
        return OilState(
            head_pressure=head,
            rod_pressure=rod,
            head_flow=hose.flow_rate(port_a.pressure, x.head_pressure, x.head_flow, *line),
            rod_flow=hose.flow_rate(port_b.pressure, x.rod_pressure, x.rod_flow, *line),
        )

    def hose_heat(self) -> Scalar:
        """Power [W] dissipated by the hoses."""
        return sum(
            q * spool_valve.turbulent_drop(q, self.hose.resistance, self.valve.transition_flow)
            for q in (self.x.head_flow, self.x.rod_flow)
        )

    def observe(self) -> dict[str, Any]:
        """Outputs by name without prefix, for `joint_outputs`.

        The convected power is P^2 / (2 beta) times the volume rate of the growing chamber, minus that of the
        shrinking one. It is required for the energy balance (docs/equations.md, section 7).
        """
        (head, rod), x, u, rates = self.cylinder.areas, self.x, self.u, self.pressure_rates()
        pressures = (x.head_pressure, x.rod_pressure)
        compression = sum(map(chamber.stored_energy, pressures, self.capacitances()))
        edges = sum(spool_valve.throttling_loss(n, u.supply_pressure, u.tank_pressure) for n in self.ports)
        bands = opening_curve.meter_in_dead_bands(self.curves, self.valve.dead_band, self.valve.dead_band)
        return {
            **vars(x),
            "force": cylinder.force(head, rod, *pressures),
            "force_rate": cylinder.force(head, rod, *rates),
            "void_volume": sum(map(chamber.cavity_volume, pressures)),
            "supply_flow": sum(node.supply for node in self.ports),
            "return_flow": sum(node.tank for node in self.ports),
            "stored_energy": compression + self.hose.inertance * (x.head_flow**2 + x.rod_flow**2) / 2,
            "dissipated_power": edges + self.hose_heat(),
            "convected_power": (head * x.head_pressure**2 - rod * x.rod_pressure**2)
            * u.velocity
            / (2 * self.bulk_modulus),
            LOAD: load_sensing.load_pressure(
                u.command, u.command_rate, bands, self.valve.full_command, pressures, rates, u
            ),
        }


def inputs(u: BoomStickInputs) -> Iterator[AxisInputs]:
    """Inputs of the boom drive and of the stick drive."""
    for axis in AXES:
        yield AxisInputs(**vars(DriveInputs.of(u, axis)), **vars(LineInputs.of(u)))


def derive(hose_group: type[Hose], p: Any) -> dict[str, Scalar]:
    """Parameters of the hoses that are derived from length and bore; hose_group: `Hose` or a sub-group.

    Walls are rigid in variants without a modulus for them.
    """
    oil = (p.density, p.bulk_modulus, p.hose_reference_resistance, getattr(p, "hose_wall_modulus", math.inf))
    return {
        f"{axis}_hose_{name}": value
        for axis in AXES
        for name, value in hose.derived_parameters(hose_group.of(p, f"{axis}_hose"), *oil).items()
    }


# ---- both drives

TOTALS = ("supply_flow", "return_flow", "stored_energy", "dissipated_power", "convected_power")
LOAD = "load_pressure"  # of one drive, a `load_sensing.LoadPressure`


def joint_outputs(boom: Mapping[str, Any], stick: Mapping[str, Any]) -> dict[str, Scalar]:
    """Outputs of both drives: those in TOTALS summed, and the higher LOAD."""
    load = load_sensing.highest(boom[LOAD], stick[LOAD])
    return {
        **prefixed(boom, stick, (*TOTALS, LOAD)),
        **{name: boom[name] + stick[name] for name in TOTALS},
        "boom_stick_load_pressure": load.value,
        "boom_stick_load_pressure_rate": load.rate,
    }


def prefixed(
    boom: Mapping[str, Scalar], stick: Mapping[str, Scalar], without: Iterable[str] = ()
) -> dict[str, Scalar]:
    """Values of both drives by name with the prefixes boom_ and stick_."""
    both = zip(AXES, (boom, stick), strict=True)
    return {f"{axis}_{name}": v for axis, values in both for name, v in values.items() if name not in without}


def holding_pressures(u: BoomStickInputs, p: Any) -> dict[str, Scalar]:
    """Initial pressures of the chambers of boom and stick, in balance with the holding forces."""
    state: dict[str, Scalar] = {}
    preload = u.tank_pressure + p.initial_preload
    for axis in AXES:
        load, areas = getattr(u, f"{axis}_holding_force"), Cylinder.of(p, axis).areas
        head, rod = cylinder.holding_pressures(load, *areas, preload)
        state |= {f"{axis}_head_pressure": head, f"{axis}_rod_pressure": rod}
    return state


def require_cylinders(u: BoomStickInputs, p: Any) -> dict[str, Scalar]:
    """Requirements of the cylinders: rods thinner than bores, chambers with positive volume."""
    conditions: dict[str, Scalar] = {}
    for axis in AXES:
        size = Cylinder.of(p, axis)
        v_head, v_rod = size.volumes(getattr(u, f"{axis}_position"))
        conditions[f"{axis}_rod is thinner than {axis}_bore"] = size.areas[1]
        conditions[f"head chamber of the {axis} cylinder has a positive volume at {axis}_position"] = v_head
        conditions[f"rod chamber of the {axis} cylinder has a positive volume at {axis}_position"] = v_rod
    return conditions


def require(x: Group, u: BoomStickInputs, p: Any) -> dict[str, Scalar]:
    """Requirements of cylinders and valve."""
    return spool_valve.requirements(p) | require_cylinders(u, p)


TERMINALS: tuple[Terminal, ...] = (
    *(ports.rod(axis, drives=True) for axis in AXES),
    *(ports.lever(axis) for axis in AXES),
    ports.supply_line(),
    ports.return_line(),
    ports.load_sensing_line("boom_stick"),
)


def variant(
    drives: Callable[[Any, BoomStickInputs, Any], Iterable[Any]],
    hoses: type[Hose],
    states: type[Any],
    outputs: type[Any],
    text: str,
    parameters: type[Any],
    initial: Callable[[Any, Any, Any], Mapping[str, Scalar]],
    require: Callable[[Any, Any, Any], Mapping[str, Scalar]],
    validity: str,
    stiff: bool = True,
) -> Subsystem:
    """A variant with the parameters of warm oil; the others are those of `Subsystem`.

    drives   (x, u, p) -> boom and stick drive, with the methods `rates` and `observe` of `CylinderDrive`
    """

    def dynamics(x: Any, u: BoomStickInputs, p: Any) -> Any:
        """Time derivative of the state."""
        boom, stick = (vars(d.rates()) for d in drives(x, u, p))
        return states(**prefixed(boom, stick))

    def observe(x: Any, u: BoomStickInputs, p: Any) -> Any:
        """Outputs; forces depend only on the state, their rates and the flows also on the inputs."""
        boom, stick = (d.observe() for d in drives(x, u, p))
        return outputs(**joint_outputs(boom, stick))

    return at_temperature(
        Subsystem(
            name="boom_stick",
            states=states,
            inputs=BoomStickInputs,
            outputs=outputs,
            dynamics=dynamics,
            observe=observe,
            derive=partial(derive, hoses),
            values=PARAMETERS,
            terminals=TERMINALS,
            text=text,
            parameters=parameters,
            initial=initial,
            require=require,
            validity=validity,
            stiff=stiff,
        )
    )
