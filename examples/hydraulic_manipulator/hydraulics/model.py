"""Hydraulics: supply and tank at constant pressure, an open-centre valve, a symmetrical cylinder.

    V_i / beta_i dp_i/dt = q_i - dV_i/dt                V_1 = A (l/2 + s0 - s1), V_2 = A (l/2 + s1 - s0)
    q_1 = kappa       c sqrt(p_P - p_1) - (1 - kappa) c sqrt(p_1 - p_T)       c = a_v C_d sqrt(2 / rho)
    q_2 = (1 - kappa) c sqrt(p_P - p_2) - kappa       c sqrt(p_2 - p_T)
    beta = (1 + a p + b p^2) / (a + 2 b p)              of a density that goes with 1 + a p + b p^2
    F = A (p_2 - p_1)                                   of the states alone: no feed-through of s1_dot

All four edges of the valve are open at once, kappa divides their areas. A square root counts as
zero when its difference is negative. Near zero it is r(dp) = dp / (dp^2 + dp_t^2)^(1/4), which has a
finite derivative and is below the root by the share (dp_t / dp)^2 / 4 at most: 1 % at 5 dp_t.

Signs: flows q_i are positive into a chamber; s1 is the length of the actuator, the force is
positive when it extends; chamber 2 grows with s1.
Source: the benchmark of F. Gonzalez et al., README.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import casadi as ca

from fmus.contract import Group, Quantity, Scalar, Subsystem


class HydraulicsParameters(Group):
    """Parameters; values and sources are in parameters.toml."""

    piston_area: Scalar = Quantity("m2", "Piston area A of both sides", 1e-2, minimum=1e-6)
    cylinder_length: Scalar = Quantity("m", "Length l of both chambers together", minimum=1e-3)
    centre: Scalar = Quantity("m", "Actuator length s0 with the piston in the middle")
    valve_area: Scalar = Quantity("m2", "Area a_v of a fully open edge", 1e-4, minimum=0.0)
    discharge_coefficient: Scalar = Quantity(
        "1", "Discharge coefficient C_d of the edges", minimum=0.1, maximum=1.0
    )
    transition_pressure: Scalar = Quantity(
        "Pa", "Pressure difference below which an edge is laminar", 1e3, minimum=1.0
    )
    density: Scalar = Quantity("kg/m3", "Density of the oil in the edges", 1e3, minimum=100.0)
    compressibility: Scalar = Quantity(
        "Pa-1", "Coefficient a of the density: 1/beta at zero pressure", 1e-9, minimum=1e-12
    )
    compressibility_slope: Scalar = Quantity("Pa-2", "Coefficient b of the density", 1e-18)
    supply_pressure: Scalar = Quantity("Pa", "Supply pressure p_P", 1e7, tunable=True)
    tank_pressure: Scalar = Quantity("Pa", "Tank pressure p_T", 1e5, tunable=True)


class HydraulicsState(Group):
    """Chamber pressures."""

    p_1: Scalar = Quantity("Pa", "Pressure of chamber 1, which shrinks as s1 grows", 1e6)
    p_2: Scalar = Quantity("Pa", "Pressure of chamber 2, which grows with s1", 1e6)


class HydraulicsInputs(Group):
    """Valve position and the motion of the actuator; the rate inputs carry exact time derivatives."""

    kappa: Scalar = Quantity(
        "1", "Valve position: share of the edges P-1 and 2-T", 0.5, minimum=0.0, maximum=1.0
    )
    s1: Scalar = Quantity("m", "Length of the actuator", rate="s1_dot")
    s1_dot: Scalar = Quantity("m/s", "Velocity of the actuator", 0.1, rate="s1_ddot")
    s1_ddot: Scalar = Quantity("m/s2", "Rate port: time derivative of s1_dot, may stay unconnected")
    holding_force: Scalar = Quantity(
        "N", "Force that holds the arm at the start; used only to initialise", 1e4
    )


class HydraulicsOutputs(HydraulicsState):
    """The state; the force and its rate for the arm; flows and heat for a look at the balances."""

    force: Scalar = Quantity("N", "Hydraulic force of the cylinder, friction not included", 1e4)
    force_rate: Scalar = Quantity("N/s", "Rate port: exact time derivative of force", 1e5)
    flow_1: Scalar = Quantity("m3/s", "Flow into chamber 1", 1e-3)
    flow_2: Scalar = Quantity("m3/s", "Flow into chamber 2", 1e-3)
    supply_flow: Scalar = Quantity("m3/s", "Flow taken from the supply", 1e-2)
    return_flow: Scalar = Quantity("m3/s", "Flow given to the tank", 1e-2)
    dissipated_power: Scalar = Quantity("W", "Heat of the four edges", 1e5)
    holding_kappa: Scalar = Quantity("1", "Valve position that keeps holding_force at rest", 0.5)


@dataclass(frozen=True)
class Edges:
    """Pressure differences [Pa] and flows [m3/s] of the edges P-1, 1-T, P-2, 2-T."""

    drops: tuple[Scalar, Scalar, Scalar, Scalar]
    flows: tuple[Scalar, Scalar, Scalar, Scalar]

    @property
    def into_chambers(self) -> tuple[Scalar, Scalar]:
        """q_1 and q_2 [m3/s]."""
        return self.flows[0] - self.flows[1], self.flows[2] - self.flows[3]


def regular_root(dp: Scalar, transition: Scalar) -> Scalar:
    """r(dp) [Pa^(1/2)], the signed square root, differentiable within `transition` [Pa] around zero."""
    return dp / (dp**2 + transition**2) ** 0.25


def one_way_flow(area: Scalar, dp: Scalar, density: Scalar, discharge: Scalar, transition: Scalar) -> Scalar:
    """Volume flow [m3/s] at a pressure difference dp [Pa]: zero for dp < 0."""
    return discharge * area * ca.sqrt(2 / density) * regular_root(ca.fmax(dp, 0), transition)


def edges(x: HydraulicsState, u: HydraulicsInputs, p: HydraulicsParameters) -> Edges:
    """The four edges of the valve."""
    drops = (
        p.supply_pressure - x.p_1,
        x.p_1 - p.tank_pressure,
        p.supply_pressure - x.p_2,
        x.p_2 - p.tank_pressure,
    )
    shares = (u.kappa, 1 - u.kappa, 1 - u.kappa, u.kappa)
    rest = (p.density, p.discharge_coefficient, p.transition_pressure)
    flows = [one_way_flow(share * p.valve_area, dp, *rest) for share, dp in zip(shares, drops, strict=True)]
    return Edges(drops, (flows[0], flows[1], flows[2], flows[3]))


def bulk_modulus(pressure: Scalar, p: HydraulicsParameters) -> Scalar:
    """beta(p) [Pa]; valid below the pressure -a / 2b, where the density would stop growing."""
    return relative_density(pressure, p) / (p.compressibility + 2 * p.compressibility_slope * pressure)


def relative_density(pressure: Scalar, p: HydraulicsParameters) -> Scalar:
    """Density [1] over that at zero pressure: 1 + a p + b p^2, so that beta = rho dp/drho."""
    return 1 + p.compressibility * pressure + p.compressibility_slope * pressure**2


def volumes(s1: Scalar, p: HydraulicsParameters) -> tuple[Scalar, Scalar]:
    """Chamber volumes V_1, V_2 [m3]."""
    stroke = s1 - p.centre
    return p.piston_area * (p.cylinder_length / 2 - stroke), p.piston_area * (p.cylinder_length / 2 + stroke)


def dynamics(x: HydraulicsState, u: HydraulicsInputs, p: HydraulicsParameters) -> HydraulicsState:
    """Time derivative of the state."""
    (v_1, v_2), (q_1, q_2) = volumes(u.s1, p), edges(x, u, p).into_chambers
    swept = p.piston_area * u.s1_dot
    return HydraulicsState(
        p_1=bulk_modulus(x.p_1, p) / v_1 * (q_1 + swept),
        p_2=bulk_modulus(x.p_2, p) / v_2 * (q_2 - swept),
    )


def observe(x: HydraulicsState, u: HydraulicsInputs, p: HydraulicsParameters) -> HydraulicsOutputs:
    """Outputs; the force depends on the state alone, its rate and the flows on the inputs too."""
    dx, valve = dynamics(x, u, p), edges(x, u, p)
    q_1, q_2 = valve.into_chambers
    p_1, _ = standing_pressures(u.holding_force, p)
    from_supply, to_tank = (
        regular_root(dp, p.transition_pressure) for dp in (p.supply_pressure - p_1, p_1 - p.tank_pressure)
    )
    return HydraulicsOutputs(
        **vars(x),
        force=p.piston_area * (x.p_2 - x.p_1),
        force_rate=p.piston_area * (dx.p_2 - dx.p_1),
        flow_1=q_1,
        flow_2=q_2,
        supply_flow=valve.flows[0] + valve.flows[2],
        return_flow=valve.flows[1] + valve.flows[3],
        dissipated_power=sum(q * dp for q, dp in zip(valve.flows, valve.drops, strict=True)),
        holding_kappa=to_tank / (from_supply + to_tank),
    )


def standing_pressures(force: Scalar, p: HydraulicsParameters) -> tuple[Scalar, Scalar]:
    """Pressures [Pa] at rest under a force [N]: p_1 + p_2 = p_P + p_T and A (p_2 - p_1) = F."""
    middle, half = (p.supply_pressure + p.tank_pressure) / 2, force / (2 * p.piston_area)
    return middle - half, middle + half


def initial(x: HydraulicsState, u: HydraulicsInputs, p: HydraulicsParameters) -> dict[str, Scalar]:
    """Pressures that carry the holding force; they stay if kappa starts at holding_kappa."""
    p_1, p_2 = standing_pressures(u.holding_force, p)
    return {"p_1": p_1, "p_2": p_2}


def require(x: HydraulicsState, u: HydraulicsInputs, p: HydraulicsParameters) -> dict[str, Scalar]:
    """Chambers with volume, and oil that is denser at higher pressure."""
    v_1, v_2 = volumes(u.s1, p)
    return {
        "chamber 1 has a positive volume at s1": v_1,
        "chamber 2 has a positive volume at s1": v_2,
        "bulk modulus at p_1 is positive": bulk_modulus(x.p_1, p),
        "bulk modulus at p_2 is positive": bulk_modulus(x.p_2, p),
    }


HYDRAULICS = Subsystem(
    name="hydraulics",
    text="Supply, valve and symmetrical cylinder of the hydraulic manipulator benchmark",
    parameters=HydraulicsParameters,
    states=HydraulicsState,
    inputs=HydraulicsInputs,
    outputs=HydraulicsOutputs,
    dynamics=dynamics,
    observe=observe,
    initial=initial,
    require=require,
    values=Path(__file__).with_name("parameters.toml"),
)
