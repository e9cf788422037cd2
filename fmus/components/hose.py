"""Hoses: parameters derived from length and bore, one lump, and a line of many lumps with friction.

    I = rho l/A     C = A l (1/beta + 1/E_wall)     R = 128 mu l/(pi D^4)
    C_R = C_R0 (l/l_0) (D_0/D)^4.75 (mu/mu_0)^(1/4)                              at the flow Q_0, eq. (10)

**One lump** is valid below the frequency of eq. (3), C0/(2 pi l): 51 Hz for the longest hose.

**A line** is a chain of N T-lumps with a compliant wall:

    inlet  I/2N  C/N  I/N  C/N ... I/2N  outlet        sections of I/2 - C - I/2

    w I dQ/dt  = P_in - P_out - w dp(Q)                         w = 1/2N or 1/N, dp of `Friction`
    C_k dP/dt  = Q_in - Q_out        C_k = V/N (kappa(P) + 1/E_wall)

Inputs are the pressures at both ends, outputs the flows. Valid below the bandwidth in `lumps_needed`: the
T-lumps have the exact wave numbers of the line, but their frequencies are too low by the factor sin(t)/t with
t = k l/2N.
Friction is that of steady flow, which damps the modes of a hose less than the boundary layer does.

Signs: flows are positive from inlet to outlet; pressures are gauge.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, TypeAlias

import casadi as ca

from fmus.components import chamber
from fmus.components import oil as oils
from fmus.components.chamber import AeratedOil, Air, Oil
from fmus.components.circuit import Branch, Circuit, Kind, Node
from fmus.components.orifice import Edge, Liquid, root
from fmus.contract import Group, Quantity, Scalar

REFERENCE_LENGTH, REFERENCE_BORE = 4.0, 0.01905  # [m], hose from which all resistances are scaled
# Q_0 [m3/s] and mu_0 [Pa.s]: the paper states neither. Blasius gives its C_R at 170 L/min with 8 mPa.s
REFERENCE_FLOW, REFERENCE_VISCOSITY = 170 / 60000, 8e-3
CRITICAL = 2300  # Reynolds number
LEAST = 1e-12  # added to |Q|/Q_c, so that its root has a derivative at 0, where s is 0
BANDWIDTH = 75.0  # Hz: highest mode of a line that recordings at the paper's 200 Hz show
FREQUENCY_ERROR = 0.05  # largest relative error of the frequencies of modes up to BANDWIDTH


class HoseSize(Group):
    """Length and bore of a hose."""

    length: Scalar = Quantity("m", "Length of each {}", minimum=1e-3, group="{}s")
    bore: Scalar = Quantity("m", "Bore of each {}", 0.01, minimum=1e-4)


class Hose(HoseSize):
    """A hose with its friction."""

    resistance: Scalar = Quantity(
        "Pa.s2/m6",
        "Turbulent resistance C_R of each {} at 170 L/min; 0: derived from length and bore, eq. (10)",
        1e10,
        minimum=0.0,
        warmed=oils.TURBULENT,
    )

    def friction(self, oil: Liquid) -> Friction:
        """Friction of the hose."""
        return Friction.of(self, self.resistance, oil)


class VolumeHose(Hose):
    """A hose as a volume with a resistance."""

    capacitance: Scalar = Quantity(
        "m3/Pa", "Capacitance of each {}; 0: derived from length, bore and bulk modulus", 1e-12, minimum=0.0
    )

    def at_temperature(self, oil: Oil, temperature: Scalar) -> Scalar:
        """C [m3/Pa] with the oil at a temperature [K]."""
        return self.capacitance + warmed_compliance(area(self.bore) * self.length, oil, temperature)

    def node(self, pressure: Scalar, oil: AeratedOil, temperature: Scalar, symbol: str) -> Node:
        """The hose as a volume with air in its oil."""
        volume, capacitance = area(self.bore) * self.length, self.at_temperature(oil, temperature)
        return Node(pressure, symbol, capacitance, volume, Air.of(oil))


class LumpedHose(VolumeHose):
    """A hose as one lump."""

    inertance: Scalar = Quantity(
        "kg/m4",
        "Inertance of each {}; 0: derived from length, bore and density",
        1e7,
        minimum=0.0,
        warmed=oils.DENSITY,
    )


class ReferenceHose(Group):
    """Resistance of the reference hose, from which that of every hose is scaled."""

    hose_reference_resistance: Scalar = Quantity(
        "Pa.s2/m6",
        "C_R of a 3/4 in hose (19.05 mm) of 4 m at 170 L/min with 8 mPa.s, for eq. (10)",
        1e10,
        minimum=2e10,  # below, the drop of any hose would fall with the flow at Re 2300 (see `Friction`)
        group="Hoses",
    )


class HoseWall(Group):
    """Compliance of the walls of all hoses."""

    hose_wall_modulus: Scalar = Quantity(
        "Pa",
        "Pressure over relative growth of a hose's volume by its wall",
        1e9,
        minimum=1e7,
        group="Hose walls",
    )


OIL_VELOCITY = 6.0  # m/s: by the usual rule for the size of hoses under pressure


def oil_velocity(text: str) -> Quantity:
    """Declaration of the velocity of the oil in hoses."""
    meaning = "the oil is fast in the hoses: hoses of the next size waste less pressure and heat"
    return Quantity("m/s", text, 1.0, warn_above=OIL_VELOCITY, meaning=meaning)


def warmed_compliance(volume: Scalar, oil: Oil, temperature: Scalar) -> Scalar:
    """V/beta [m3/Pa] of a volume [m3] of oil at a temperature [K], minus that at `oils.REFERENCE`."""
    return volume * (1 - oils.bulk_modulus_ratio(temperature)) / oil.bulk_modulus


def derived_parameters(
    h: Hose, oil: Oil, reference_resistance: Scalar, wall_modulus: Scalar
) -> dict[str, Scalar]:
    """Parameters of a hose that are derived from its length and bore."""
    ratios = (h.length / REFERENCE_LENGTH, h.bore / REFERENCE_BORE, oil.viscosity / REFERENCE_VISCOSITY)
    parameters = {
        "resistance": scaled_resistance(reference_resistance, *ratios),
        "capacitance": capacitance(h.length, h.bore, oil.bulk_modulus, wall_modulus),
        "inertance": inertance(h.length, h.bore, oil.density),
    }
    return {name: value for name, value in parameters.items() if hasattr(h, name)}


@dataclass(frozen=True)
class Friction:
    """Steady friction of a hose: dp = Q (R + s (T - R)), laminar below and turbulent above Re 2300.

        R = 128 mu l/(pi D^4)        T = C_R (Q_0/|Q|)^(1/4) |Q|        s = 1 - 1/(1 + (Q/Q_c)^8)

    Hagen-Poiseuille and Blasius, with a smooth passage: s is 5 % at Re 1600 and 95 % at 3300. The drop rises
    with the flow if T is at least R at Re 2300, for which C_R has to be 0.6 of Blasius' at least.

    laminar      R [Pa.s/m3]
    turbulent    C_R at the flow Q_0 = `REFERENCE_FLOW` [Pa.s2/m6]
    critical     Q_c of Re 2300 [m3/s]
    """

    laminar: Scalar
    turbulent: Scalar
    critical: Scalar

    @classmethod
    def of(cls, size: HoseSize, turbulent: Scalar, oil: Liquid) -> Friction:
        """That of a hose with this C_R."""
        critical = math.pi / 4 * CRITICAL * size.bore * oil.kinematic_viscosity
        dynamic = oil.kinematic_viscosity * oil.density
        return cls(laminar_resistance(size.length, size.bore, dynamic), turbulent, critical)

    def _shares(self, flow: Scalar) -> tuple[Scalar, Scalar]:
        """s, and sqrt(|Q|/Q_c)."""
        z = ca.fabs(flow) * (1 / self.critical)
        power = ((z**2) ** 2) ** 2
        return power / (1 + power), ca.sqrt(z + LEAST)

    def coefficients(self, flow: Scalar = None) -> tuple[Scalar, Scalar]:
        """b and a of dp = b Q + a Q |Q| at a flow [m3/s]; without one, R and C_R."""
        if flow is None:
            return self.laminar, self.turbulent
        share, half = self._shares(flow)
        at_critical = self.turbulent * (REFERENCE_FLOW / self.critical) ** 0.25
        return (1 - share) * self.laminar, share * at_critical / ca.sqrt(half)

    def drop(self, flow: Scalar) -> Scalar:
        """Pressure drop [Pa] at a flow [m3/s], with its sign."""
        return self.drop_and_slope(flow)[0]

    def drop_and_slope(self, flow: Scalar) -> tuple[Scalar, Scalar]:
        """Drop [Pa] at a flow [m3/s], with its sign; its derivative [Pa.s/m3], at least drop/flow."""
        share, half = self._shares(flow)
        scale = self.turbulent * (REFERENCE_FLOW / self.critical) ** 0.25 * self.critical
        more = share * (scale * half * ca.sqrt(half) - self.laminar)  # s (T - R)
        resistance = self.laminar + more
        slope = resistance + 8 * (1 - share) * more + 0.75 * (more + share * self.laminar)
        return flow * resistance, ca.fmax(slope, resistance)


@dataclass(frozen=True)
class ShortLine:
    """Steady friction of a short line: dp = R Q + C_R Q |Q|, laminar at any flow if C_R is 0."""

    laminar: Scalar
    turbulent: Scalar

    def coefficients(self, _: Scalar = None) -> tuple[Scalar, Scalar]:
        """R and C_R."""
        return self.laminar, self.turbulent

    def drop(self, flow: Scalar) -> Scalar:
        """Pressure drop [Pa] at a flow [m3/s], with its sign."""
        return flow * (self.laminar + self.turbulent * ca.fabs(flow))


Law: TypeAlias = Friction | ShortLine


def flow_in_series(edge: Edge, area: Scalar, drop: Scalar, oil: Liquid, line: Law) -> Scalar:
    """Flow [m3/s] through an opening [m2] of a valve and a line, with the sign of the drop [Pa].

    With b and a of the line at a flow Q_k, dp = (C_R + a) Q_{k+1} |Q_{k+1}| + (C_R Q_t + b) Q_{k+1}, which
    is exact where b and a are constant. Twice this, and a step of Newton's method follows. Around Re 2700
    with an opening of 40 mm2, 140 mm2, 260 mm2 and 4 m of 3/4 in hose the drop is off by less than 0.1, 0.4
    and 2.1 %.
    """
    square, laminar = edge.square(area, oil), edge.transition_flow(area, oil)
    y = square * drop

    def solved(linear: Scalar, turbulent: Scalar) -> Scalar:
        return root(y, laminar + square * linear, 1 + square * turbulent)

    flow = solved(*line.coefficients())
    if isinstance(line, ShortLine):
        return flow
    flow = solved(*line.coefficients(flow))
    line_drop, slope = line.drop_and_slope(flow)
    size = ca.fabs(flow)
    return flow - (flow * (size + laminar) + square * line_drop - y) / (2 * size + laminar + square * slope)


def column(start: str, end: str, flow: Scalar, symbol: str, inertance: Scalar, drop: Scalar) -> Branch:
    """The oil column of one lump: I dQ/dt = P_start - P_end - drop, eq. (9a) with correction E3."""
    return Branch(start, end, Kind.COLUMN, flow, symbol, inertance, drop)


def in_series(branch: Branch, line: Law) -> Branch:
    """A branch whose law contains that of a line in series."""
    return replace(branch, series={Kind.RESISTANCE: line.drop})


def area(diameter: Scalar) -> Scalar:
    """Cross-section [m2] of a bore [m]."""
    return math.pi / 4 * diameter**2


def inertance(length: Scalar, diameter: Scalar, density: Scalar) -> Scalar:
    """I = rho l / A [kg/m4]."""
    return density * length / area(diameter)


def capacitance(
    length: Scalar, diameter: Scalar, bulk_modulus: Scalar, wall_modulus: Scalar = math.inf
) -> Scalar:
    """C = A l (1/beta + 1/E_wall) [m3/Pa]; E_wall is infinite for a rigid wall."""
    volume = area(diameter) * length
    return volume / bulk_modulus + volume / wall_modulus


def scaled_resistance(
    resistance: Scalar, length_ratio: Scalar, diameter_ratio: Scalar, viscosity_ratio: Scalar = 1
) -> Scalar:
    """C_R [Pa.s2/m6] of another hose at the same flow, eq. (10): C_R ~ l mu^(1/4) / D^4.75.

    Blasius: turbulent flow in a smooth pipe, Re 3e3 to 1e5. The true drop grows as Q^1.75, so C_R is valid at
    one flow and falls by 16 % per doubling of Q (E10).
    """
    return resistance * length_ratio / diameter_ratio**4.75 * viscosity_ratio**0.25


def laminar_resistance(length: Scalar, diameter: Scalar, viscosity: Scalar) -> Scalar:
    """R = 128 mu l / (pi D^4) [Pa.s/m3], Hagen-Poiseuille, Re < 2300."""
    return 128 * viscosity * length / (math.pi * diameter**4)


def frequency_limit(length: Scalar, density: Scalar, bulk_modulus: Scalar) -> Scalar:
    """Highest frequency [Hz] at which one lump is valid for the line, eq. (3): C0 / (2 pi l)."""
    return ca.sqrt(bulk_modulus / density) / (2 * math.pi * length)


# ---- a line of many lumps


@dataclass(frozen=True)
class HydraulicLine:
    """Parameters of a line: length, bore [m], friction, wall modulus [Pa], oil."""

    length: Scalar
    bore: Scalar
    friction: Law
    wall_modulus: Scalar
    fluid: AeratedOil

    @property
    def volume(self) -> Scalar:
        """Volume [m3]."""
        return area(self.bore) * self.length

    @property
    def inertance(self) -> Scalar:
        """I [kg/m4]."""
        return inertance(self.length, self.bore, self.fluid.density)


@dataclass(frozen=True)
class LineStates:
    """States of a line of N lumps, by name.

    flows       N+1 flows [m3/s] from inlet to outlet
    pressures   N pressures [Pa]
    """

    flows: Mapping[str, Quantity]
    pressures: Mapping[str, Quantity]

    def all(self) -> dict[str, Quantity]:
        """All states in order."""
        return {**self.flows, **self.pressures}


def length_fractions(lumps: int) -> tuple[float, ...]:
    """Fraction of the length of the line for each flow: half a lump at both ends, else one lump."""
    return (0.5 / lumps, *(1 / lumps,) * (lumps - 1), 0.5 / lumps)


def ladder(line: HydraulicLine, states: LineStates, x: Any, inlet: str, outlet: str, of: str = "") -> Circuit:
    """The line between two nodes, from a state x; of: begin of the indices of its symbols."""
    n = len(states.pressures)
    wall = line.volume / n / line.wall_modulus
    nodes = {
        name: Node(getattr(x, name), f"C_{of}{k}", wall, line.volume / n, line.fluid, cavity=1 / n)
        for k, name in enumerate(states.pressures, 1)
    }
    branches: dict[str, Branch] = {}
    ends = pairwise((inlet, *states.pressures, outlet))
    parts = zip(states.flows, length_fractions(n), ends, strict=True)
    for k, (name, w, (start, end)) in enumerate(parts, 1):
        q = getattr(x, name)
        branches[name] = column(start, end, q, f"I_{of}{k}", w * line.inertance, w * line.friction.drop(q))
    return Circuit(nodes, branches)


def line_states(ends: Mapping[str, Quantity], inner: str, side: str, line: str, lumps: int) -> LineStates:
    """States of a line.

    ends          both flows at its ends
    inner, side   begin and end of the other names
    line          the line in descriptions: "swing line A"
    """
    (first, first_flow), (last, last_flow) = ends.items()
    middle = {
        f"{inner}_flow{side}_{k}": Quantity("m3/s", f"Flow from lump {k} to {k + 1} of {line}", 1e-3)
        for k in range(1, lumps)
    }
    pressures = {
        f"{inner}_pressure{side}_{k}": chamber.pressure(f"Pressure of lump {k} of {line}")
        for k in range(1, lumps + 1)
    }
    return LineStates({first: first_flow, **middle, last: last_flow}, pressures)


def lumps_needed(
    length: float,
    bore: float,
    bandwidth: float,
    error: float,
    fluid: AeratedOil,
    wall_modulus: float = math.inf,
) -> int:
    """Number of T-lumps that give every mode up to `bandwidth` [Hz] a relative frequency error <= `error`.

    A mode between open or closed ends has a wave number k. The ladder has the same k, and

        gamma(s_ladder) = gamma(s_line) sin(t)/t,        t = k l/2N,        gamma(s)^2 = Z(s) s C/l

    with the impedance Z = R + s I of the line. Without friction the frequencies are too low by the fraction
    1 - sin(t)/t. So N = k l/2t with sin(t)/t = 1 - error and k = |gamma| at the bandwidth. Viscosity reduces
    the wave speed, so a narrow bore needs more lumps. With a chamber at an end k of the ladder is a little
    higher and its error smaller. Air is neglected, although it reduces the wave speed at low pressure.
    """
    modulus = 1 / (1 / fluid.bulk_modulus + 1 / wall_modulus)
    line = HydraulicLine(
        length, bore, ShortLine(laminar_resistance(length, bore, fluid.viscosity), 0.0), wall_modulus, fluid
    )
    omega = 2 * math.pi * bandwidth
    viscous_factor = math.hypot(1.0, line.friction.laminar / (omega * line.inertance))
    phase = omega * length * math.sqrt(fluid.density / modulus * viscous_factor)
    return max(1, math.ceil(phase / (2 * _angle(error)) * (1 - 1e-12)))


def _angle(error: float) -> float:
    """t in (0, pi) with sin(t)/t = 1 - error, by bisection."""
    low, high = 0.0, math.pi
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if math.sin(middle) > (1 - error) * middle else (low, middle)
    return low


def default_lumps(line: HydraulicLine) -> int:
    """Number of lumps of a line for `BANDWIDTH` and `FREQUENCY_ERROR`."""
    return lumps_needed(line.length, line.bore, BANDWIDTH, FREQUENCY_ERROR, line.fluid, line.wall_modulus)
