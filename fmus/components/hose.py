"""A hose: what follows from length and bore, one lump of it, and a line of many lumps.

    I = rho l/A       C = A l/beta       C_R = C_R0 (l/l_0) (D_0/D)^4.75       R = 128 mu l/(pi D^4)

**One lump** is valid below the frequency of eq. (3), C0/(2 pi l): 51 Hz for the longest hose.

**A line** is a chain of N T-lumps with a compliant wall:

    inlet  I/2N  C/N  I/N  C/N ... I/2N  outlet        sections of I/2 - C - I/2

    w I dQ/dt  = P_in - P_out - w Q sqrt(R^2 + (C_R Q)^2) - w sum_i R_i (Q - q_i)       w = 1/2N or 1/N
    C_k dP/dt  = Q_in - Q_out        C_k = V/N (kappa(P) + 1/E_wall)
    dq_i/dt    = (Q - q_i)/T_i       with frequency-dependent friction

C_R of the turbulent law: the drop changes over from the laminar one at Q = R/C_R, for the longest hose at
Re 2500. Both ends give flows, so pressures are put in. Valid below the bandwidth that `lumps_needed` was
asked for; the T-lumps have the exact wave numbers of the line and too low frequencies, by sin(t)/t with
t = k l/2N.

**Frequency-dependent friction** of laminar flow: Trikha's three terms as a passive network. The wall's
friction follows a change of the flow with the memory of the boundary layer (W. Zielke, J. Basic
Engineering 90 (1968) 109): over the whole line, with the steady resistance R,

    dp = R Q + R/2 int dQ/dt(t') W(nu (t - t')/r^2) dt',        W(T) ~ sum_i m_i exp(-n_i T)

    m = 40, 8.1, 1        n = 8000, 200, 26.4          (A. K. Trikha, J. Fluids Engineering 97 (1975) 97)

Each term is a resistance R_i = m_i R/2 with an inertance L_i = R_i r^2/(n_i nu) in parallel that carries q_i:

    drop R_i (Q - q_i)        dq_i/dt = (Q - q_i)/T_i,  T_i = r^2/(n_i nu)        heat R_i (Q - q_i)^2

so energy is stored (L_i q_i^2/2) and lost, never made. The inertances add up to I/3, as they must: slow flow
has the inertance 4/3 I of its parabolic profile. Up to w r^2/nu = `RANGE` the real part, which damps, is
within 26 % of Zielke's and the whole impedance within 2.5 %; steady friction alone has 4 % of the real part
there. The range ends at 700 Hz for a 3/4 in hose and 20 mm2/s. Turbulent flow has a shorter memory: there
the terms are an upper bound.

Signs: flows are positive from inlet to outlet; pressures are gauge.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import casadi as ca

from fmus.components import chamber
from fmus.components.chamber import Fluid
from fmus.components.spool_valve import turbulent_drop
from fmus.contract import Group, Quantity, Scalar

REFERENCE_LENGTH, REFERENCE_BORE = 4.0, 0.01905  # [m] of the hose whose resistance the others are scaled from
BANDWIDTH = 75.0  # Hz: modes of a line up to here, which recordings at the paper's 200 Hz show, ...
ERROR = 0.05  # ... have frequencies within this share, unless the number of lumps is given

WEIGHTS = (40.0, 8.1, 1.0)  # m_i
DECAYS = (8000.0, 200.0, 26.4)  # n_i
TERMS = len(WEIGHTS)
RANGE = 2e4  # largest w r^2/nu


class HoseSize(Group):
    """Length and bore of a hose."""

    length: Scalar = Quantity("m", "Length of each {}", minimum=1e-3, group="{}s")
    bore: Scalar = Quantity("m", "Bore of each {}", 0.01, minimum=1e-4)


class Hose(HoseSize):
    """With its friction."""

    resistance: Scalar = Quantity(
        "Pa.s2/m6", "Turbulent resistance C_R of each {}; 0: of length and bore, eq. (10)", 1e10, minimum=0.0
    )


class VolumeHose(Hose):
    """A hose as a volume with a resistance."""

    capacitance: Scalar = Quantity(
        "m3/Pa", "Capacitance of each {}; 0: of length, bore and bulk modulus", 1e-12, minimum=0.0
    )


class LumpedHose(VolumeHose):
    """A hose as one lump."""

    inertance: Scalar = Quantity(
        "kg/m4", "Inertance of each {}; 0: of length, bore and density", 1e7, minimum=0.0
    )


class ReferenceHose(Group):
    """What the resistance of every hose is scaled from."""

    hose_reference_resistance: Scalar = Quantity(
        *("Pa.s2/m6", "C_R of 4 m of 3/4 in hose (19.05 mm), from which eq. (10) leads to the others", 1e10),
        minimum=0.0,
        group="Hoses",
    )


class HoseWall(Group):
    """How the walls of all hoses give way."""

    hose_wall_modulus: Scalar = Quantity(
        *("Pa", "Pressure over relative growth of a hose's volume by its wall", 1e9),
        minimum=1e7,
        group="Hose walls",
    )


def derived(
    h: Hose, density: Scalar, bulk_modulus: Scalar, reference_resistance: Scalar
) -> dict[str, Scalar]:
    """The numbers of a hose that follow from its length and bore."""
    ratios = (h.length / REFERENCE_LENGTH, h.bore / REFERENCE_BORE)
    found = {
        "resistance": scaled_resistance(reference_resistance, *ratios),
        "capacitance": capacitance(h.length, h.bore, bulk_modulus),
        "inertance": inertance(h.length, h.bore, density),
    }
    return {name: value for name, value in found.items() if hasattr(h, name)}


def flow_rate(
    inlet: Scalar,
    outlet: Scalar,
    flow: Scalar,
    inertance: Scalar,
    resistance: Scalar,
    transition_flow: Scalar,
) -> Scalar:
    """dQ/dt [m3/s2] of the oil column: I dQ/dt = P_in - P_out - C_R Q |Q|, eq. (9a) with correction E3."""
    return (inlet - outlet - turbulent_drop(flow, resistance, transition_flow)) / inertance


def area(diameter: Scalar) -> Scalar:
    """Cross-section [m2] of a bore [m]."""
    return math.pi / 4 * diameter**2


def inertance(length: Scalar, diameter: Scalar, density: Scalar) -> Scalar:
    """I = rho l / A [kg/m4]."""
    return density * length / area(diameter)


def capacitance(length: Scalar, diameter: Scalar, bulk_modulus: Scalar) -> Scalar:
    """C = A l / beta [m3/Pa] with a rigid wall."""
    return area(diameter) * length / bulk_modulus


def scaled_resistance(resistance: Scalar, length_ratio: Scalar, diameter_ratio: Scalar) -> Scalar:
    """C_R [Pa.s2/m6] of another hose at the same flow, eq. (10): C_R ~ l / D^4.75.

    Blasius: turbulent flow in a smooth pipe, Re 3e3 to 1e5. C_R belongs to one reference
    flow: the true drop grows as Q^1.75, so C_R falls by 16 % per doubling of Q (E10).
    """
    return resistance * length_ratio / diameter_ratio**4.75


def laminar_resistance(length: Scalar, diameter: Scalar, viscosity: Scalar) -> Scalar:
    """R = 128 mu l / (pi D^4) [Pa.s/m3], Hagen-Poiseuille, Re < 2300."""
    return 128 * viscosity * length / (math.pi * diameter**4)


def frequency_limit(length: Scalar, density: Scalar, bulk_modulus: Scalar) -> Scalar:
    """Highest frequency [Hz] at which one lump describes the line, eq. (3): C0 / (2 pi l)."""
    return ca.sqrt(bulk_modulus / density) / (2 * math.pi * length)


# ---- a line of many lumps


def _numbers(line: Line) -> tuple[tuple[Scalar, Scalar], ...]:
    """(R_i, 1/T_i) of each term, for the whole line."""
    diffusion = line.fluid.viscosity / line.fluid.density / (line.bore / 2) ** 2
    r = line.laminar_resistance
    return tuple((m * r / 2, n * diffusion) for m, n in zip(WEIGHTS, DECAYS, strict=True))


def drop(line: Line, flow: Scalar, within: Sequence[Scalar]) -> Scalar:
    """Pressure [Pa] beyond the steady drop."""
    return sum(r * (flow - q) for (r, _), q in zip(_numbers(line), within, strict=True))


def layer_rates(line: Line, flow: Scalar, within: Sequence[Scalar]) -> tuple[Scalar, ...]:
    """dq_i/dt [m3/s2]."""
    return tuple(n * (flow - q) for (_, n), q in zip(_numbers(line), within, strict=True))


def layer_energy(line: Line, within: Sequence[Scalar]) -> Scalar:
    """Energy [J] that the profile of the flow holds beyond I Q^2/2."""
    return sum(r / n * q**2 / 2 for (r, n), q in zip(_numbers(line), within, strict=True))


def layer_heat(line: Line, flow: Scalar, within: Sequence[Scalar]) -> Scalar:
    """Power [W] turned into heat beyond the steady friction; never negative."""
    return sum(r * (flow - q) ** 2 for (r, _), q in zip(_numbers(line), within, strict=True))


def impedance(line: Line, omega: float) -> complex:
    """dp/Q [Pa.s/m3] of the whole line, laminar, for a flow of angular frequency `omega` [rad/s]."""
    memory = sum(r * 1j * omega / (1j * omega + n) for r, n in _numbers(line))
    return complex(1j * omega * line.inertance + line.laminar_resistance + memory)


@dataclass(frozen=True)
class Line:
    """Length and bore [m], turbulent resistance C_R [Pa.s2/m6], modulus of the wall [Pa], oil."""

    length: Scalar
    bore: Scalar
    resistance: Scalar
    wall_modulus: Scalar
    fluid: Fluid

    @property
    def volume(self) -> Scalar:
        """Volume [m3]."""
        return area(self.bore) * self.length

    @property
    def inertance(self) -> Scalar:
        """I [kg/m4]."""
        return inertance(self.length, self.bore, self.fluid.density)

    @property
    def laminar_resistance(self) -> Scalar:
        """R [Pa.s/m3]."""
        return laminar_resistance(self.length, self.bore, self.fluid.viscosity)


@dataclass(frozen=True)
class LineState:
    """N+1 flows [m3/s] from inlet to outlet, N pressures [Pa], and for each flow those of its layers, if any.

    Also their rates, or their names.
    """

    flows: tuple[Any, ...]
    pressures: tuple[Any, ...]
    layers: tuple[tuple[Any, ...], ...]

    def each(self, function: Callable[[Any], Any]) -> LineState:
        """The state with a function of every entry in its place."""
        return LineState(
            tuple(map(function, self.flows)),
            tuple(map(function, self.pressures)),
            tuple(tuple(map(function, one)) for one in self.layers),
        )

    def all(self) -> tuple[Any, ...]:
        """All entries in order."""
        return (*self.flows, *self.pressures, *(q for one in self.layers for q in one))


def shares(lumps: int) -> tuple[float, ...]:
    """Which part of the line each flow runs through: half a lump at both ends."""
    return (0.5 / lumps, *(1 / lumps,) * (lumps - 1), 0.5 / lumps)


def _friction(line: Line, x: LineState) -> tuple[Scalar, ...]:
    """Pressure drop [Pa] over the whole line if it had each of the flows."""
    steady = (q * ca.sqrt(line.laminar_resistance**2 + (line.resistance * q) ** 2) for q in x.flows)
    if not x.layers:
        return tuple(steady)
    more = (drop(line, q, one) for q, one in zip(x.flows, x.layers, strict=True))
    return tuple(a + b for a, b in zip(steady, more, strict=True))


def rates(line: Line, x: LineState, inlet: Scalar, outlet: Scalar) -> LineState:
    """Time derivative of the state between two pressures [Pa]."""
    n = len(x.pressures)
    nodes = (inlet, *x.pressures, outlet)
    driving = (a - b for a, b in pairwise(nodes))
    flows = tuple(
        (dp / w - drop) / line.inertance
        for dp, w, drop in zip(driving, shares(n), _friction(line, x), strict=True)
    )
    pressures = tuple(
        chamber.pressure_rate(p, q_in - q_out, _capacitance(line, p) / n, 1 / n)
        for p, (q_in, q_out) in zip(x.pressures, pairwise(x.flows), strict=True)
    )
    return LineState(
        flows, pressures, tuple(layer_rates(line, q, one) for q, one in zip(x.flows, x.layers, strict=False))
    )


def _capacitance(line: Line, pressure: Scalar) -> Scalar:
    return line.volume * (chamber.compliance(line.fluid, pressure) + 1 / line.wall_modulus)


def stored_energy(line: Line, x: LineState) -> Scalar:
    """Energy [J] of the compressed oil, the stretched wall, the cavities and the moving columns."""
    n = len(x.pressures)
    springs = sum(
        line.volume * (chamber.energy_density(line.fluid, p) + p**2 / (2 * line.wall_modulus))
        + chamber.stored_energy(p, 0.0)
        for p in x.pressures
    )
    moving = sum(w * q**2 for w, q in zip(shares(n), x.flows, strict=True))
    within = sum(w * layer_energy(line, one) for w, one in zip(shares(n), x.layers, strict=False))
    return springs / n + line.inertance * moving / 2 + within


def heat(line: Line, x: LineState) -> Scalar:
    """Power [W] turned into heat by friction; never negative."""
    w = shares(len(x.pressures))
    if not x.layers:
        return sum(a * q * drop for a, q, drop in zip(w, x.flows, _friction(line, x), strict=True))
    steady = _friction(line, LineState(x.flows, x.pressures, ()))
    return sum(
        a * (q * drop + layer_heat(line, q, one))
        for a, q, drop, one in zip(w, x.flows, steady, x.layers, strict=True)
    )


def cavity_volume(x: LineState) -> Scalar:
    """Volume of the cavities [m3]."""
    return sum(chamber.cavity_volume(p) for p in x.pressures) / len(x.pressures)


def names(first: str, last: str, inner: str, side: str, lumps: int, unsteady_friction: bool) -> LineState:
    """Names of the states: `first` and `last` flow at the ends, the others from `inner` and `side`."""
    flows = (first, *(f"{inner}_flow{side}_{k}" for k in range(1, lumps)), last)
    pressures = tuple(f"{inner}_pressure{side}_{k}" for k in range(1, lumps + 1))
    within = tuple(
        tuple(f"{inner}_layer{side}_{k}_{i}" for i in range(1, TERMS + 1)) for k in range(lumps + 1)
    )
    return LineState(flows, pressures, within if unsteady_friction else ())


def lumps_needed(
    length: float, bore: float, bandwidth: float, error: float, fluid: Fluid, wall_modulus: float = math.inf
) -> int:
    """How many T-lumps give every mode up to `bandwidth` [Hz] within the share `error` of its frequency.

    A mode between open or shut ends has a wave number k. The ladder has the same k, and

        gamma(s_ladder) = gamma(s_line) sin(t)/t,        t = k l/2N,        gamma(s)^2 = Z(s) s C/l

    with the impedance Z of the line's friction: without friction the frequencies themselves are low by
    1 - sin(t)/t. So N = k l/2t with sin(t)/t = 1 - error and k = |gamma| at the bandwidth. Viscosity slows
    the waves down: a narrow bore needs more lumps. With a chamber at an end the ladder's k is a bit higher,
    its error smaller. Air is left out, though it slows the waves at low pressure.
    """
    modulus = 1 / (1 / fluid.bulk_modulus + 1 / wall_modulus)
    line = Line(length, bore, 0.0, wall_modulus, fluid)
    omega = 2 * math.pi * bandwidth
    slower = abs(impedance(line, omega)) / (omega * line.inertance)
    phase = omega * length * math.sqrt(fluid.density / modulus * slower)
    return max(1, math.ceil(phase / (2 * _angle(error)) * (1 - 1e-12)))


def _angle(error: float) -> float:
    """t in (0, pi) with sin(t)/t = 1 - error, by bisection."""
    low, high = 0.0, math.pi
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if math.sin(middle) > (1 - error) * middle else (low, middle)
    return low


def states(
    x: LineState, where: str, first: Quantity | None = None, last: Quantity | None = None
) -> Iterator[tuple[str, Quantity]]:
    """The states of a line by name; `first` and `last` in the place of the flows at its ends."""
    inner = (f"Flow from lump {k} to {k + 1} of {where}" for k in range(1, len(x.pressures)))
    middle = [Quantity("m3/s", text, 1e-3) for text in inner]
    ends = (Quantity("m3/s", f"Flow into {where}", 1e-3), Quantity("m3/s", f"Flow out of {where}", 1e-3))
    yield from zip(x.flows, (first or ends[0], *middle, last or ends[1]), strict=True)
    for k, name in enumerate(x.pressures, 1):
        yield name, chamber.pressure(f"Pressure of lump {k} of {where}")
    for k, within in enumerate(x.layers):
        for i, name in enumerate(within, 1):
            text = f"Flow in {where} that friction term {i} of flow {k} remembers"
            yield name, Quantity("m3/s", text, 1e-3)


def advised_lumps(line: Line) -> int:
    """How many lumps a line needs for `BANDWIDTH` and `ERROR`."""
    return lumps_needed(line.length, line.bore, BANDWIDTH, ERROR, line.fluid, line.wall_modulus)
