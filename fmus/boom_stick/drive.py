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
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from fmus import ports
from fmus.boom_stick.variables import AXES, AxisInputs, BoomStickInputs, DriveInputs
from fmus.components import circuit, cylinder, hose, load_sensing, spool_valve
from fmus.components.chamber import Oil
from fmus.components.circuit import GROUND, TANK, Branch, Circuit, Kind, Node
from fmus.components.cylinder import Cylinder
from fmus.components.hose import Hose
from fmus.components.load_sensing import Sensed
from fmus.components.oil import at_temperature
from fmus.components.orifice import PressureValve
from fmus.contract import Group, Scalar, Subsystem, Terminal, quantities
from fmus.ports import LineInputs

PARAMETERS = Path(__file__).with_name("parameters.toml")
Pair = tuple[Scalar, Scalar]  # (head side, rod side)
CHAMBERS = ("head_pressure", "rod_pressure")
PORTS = ("head_valve_pressure", "rod_valve_pressure")  # A at the head side, B at the rod side


@dataclass(frozen=True)
class Drive:
    """One drive at one instant.

    circuit   with the nodes CHAMBERS
    load      its load pressure, from the pressures of the nodes `at`
    others    rates of the states that are not in the circuit
    shown     outputs of the variant that are not in the circuit
    """

    cylinder: Cylinder
    u: AxisInputs
    circuit: Circuit
    load: Sensed
    others: Mapping[str, Scalar] = field(default_factory=dict)
    shown: Mapping[str, Scalar] = field(default_factory=dict)
    at: tuple[str, str] = CHAMBERS

    def rates(self) -> dict[str, Scalar]:
        """Time derivative of the state, by name."""
        return {**self.circuit.rates, **self.others}

    def observe(self) -> dict[str, Any]:
        """Outputs by name without prefix, for `joint_outputs`."""
        pressures, rates, areas = self.circuit.pressures, self.circuit.rates, self.cylinder.areas
        sensed, sensed_rates = ((of[self.at[0]], of[self.at[1]]) for of in (pressures, rates))
        return {
            **self.circuit.outputs(),
            **self.shown,
            "force": cylinder.force(*areas, *(pressures[name] for name in CHAMBERS)),
            "force_rate": cylinder.force(*areas, *(rates[name] for name in CHAMBERS)),
            LOAD: self.load(sensed, sensed_rates, self.u),
        }


def cylinder_circuit(size: Cylinder, u: AxisInputs, x: Any, oil: Oil, capacitance: Scalar = 0) -> Circuit:
    """The lines, the chambers, and the piston as two gyrators; capacitance: of each hose [m3/Pa]."""
    (head, rod), (v_head, v_rod) = size.areas, size.volumes(u.position)
    return Circuit(
        {
            **circuit.lines(u),
            "head_pressure": Node(x.head_pressure, "C_1", capacitance, v_head, oil),
            "rod_pressure": Node(x.rod_pressure, "C_2", capacitance, v_rod, oil),
        },
        {
            "head_piston": Branch("head_pressure", GROUND, Kind.PISTON, head * u.velocity, "gy_1"),
            "rod_piston": Branch(GROUND, "rod_pressure", Kind.PISTON, rod * u.velocity, "gy_2"),
        },
    )


def reliefs(p: Any, relief: str, at: tuple[str, str]) -> dict[str, Branch]:
    """Relief and anti-cavitation valves at two nodes; relief: prefix of the parameters."""
    out, back = PressureValve.of(p, relief), PressureValve.of(p, "anti_cavitation")
    return {
        "head_relief": Branch(at[0], TANK, Kind.RELIEF, out.flow),
        "rod_relief": Branch(at[1], TANK, Kind.RELIEF, out.flow),
        "head_anti_cavitation": Branch(TANK, at[0], Kind.ANTI_CAVITATION, back.flow),
        "rod_anti_cavitation": Branch(TANK, at[1], Kind.ANTI_CAVITATION, back.flow),
    }


def inputs(u: BoomStickInputs, axis: str) -> AxisInputs:
    """Inputs of one drive."""
    return AxisInputs(**vars(DriveInputs.of(u, axis)), **vars(LineInputs.of(u)))


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
    drive: Callable[[str, Any, AxisInputs, Any], Drive],
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

    drive   (axis, x, inputs of the axis, p) -> drive
    """

    def drives(x: Any, u: BoomStickInputs, p: Any) -> Iterator[Drive]:
        """Boom and stick drive."""
        return (drive(axis, x, inputs(u, axis), p) for axis in AXES)

    def dynamics(x: Any, u: BoomStickInputs, p: Any) -> Any:
        """Time derivative of the state."""
        boom, stick = (d.rates() for d in drives(x, u, p))
        return states(**prefixed(boom, stick))

    def observe(x: Any, u: BoomStickInputs, p: Any) -> Any:
        """Outputs; forces depend only on the state, their rates and the flows also on the inputs."""
        boom, stick = (d.observe() for d in drives(x, u, p))
        known = joint_outputs(boom, stick)
        return outputs(**{name: known[name] for name in quantities(outputs)})

    def circuits(x: Any, u: BoomStickInputs, p: Any) -> dict[str, Circuit]:
        """The circuits of both drives."""
        return {axis: d.circuit for axis, d in zip(AXES, drives(x, u, p), strict=True)}

    return at_temperature(
        Subsystem(
            name="boom_stick",
            states=states,
            inputs=BoomStickInputs,
            outputs=outputs,
            dynamics=dynamics,
            observe=observe,
            circuits=circuits,
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
