"""Components that a circuit may have in addition to those of its model. Their default values do nothing.

An addition is a group of parameters that knows its nodes and branches, so the machine of a maker needs no
other equations. `Axis("boom", CYLINDER, Inputs, additions=(("cushion", Cushion),))` gives an axis a cushion
with the parameters boom_cushion_length and boom_cushion_resistance. Heat, stored energy and flows follow from
the circuit.
"""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import casadi as ca

from fmus.components import oil
from fmus.components.chamber import ATMOSPHERE
from fmus.components.circuit import GROUND, TANK, Branch, Circuit, Kind, Node
from fmus.components.orifice import PressureValve
from fmus.contract import Group, Quantity, Scalar
from fmus.smooth import ramp, s_curve
from orchestrator.base.errors import Problem

CLOSED = 1e-3  # share of its capacitance that an accumulator without oil keeps, so that its rate is finite


@dataclass(frozen=True)
class Place:
    """Where an addition is.

    name      of the addition, with which its nodes begin
    circuit   to which it is added
    x, u      its states, and the inputs of the axis
    own, p    parameters of the axis and of the part
    """

    name: str
    circuit: Circuit
    x: Any
    u: Any
    own: Any
    p: Any


class Addition(Group):
    """Parameters of a component in addition. `states` are pressures of its nodes, and outputs of a supply."""

    states: ClassVar[type[Group] | None] = None

    def start(self) -> dict[str, Scalar]:
        """Initial values of its states."""
        return {}

    def added(self, at: Place) -> Circuit:
        """Its nodes and branches; those of a name that the circuit has replace it."""
        raise NotImplementedError


class PistonLeakage(Addition):
    """Laminar leakage past the piston of a cylinder."""

    conductance: Scalar = Quantity(
        "m3/(s.Pa)", "Leakage past the piston of the {}", 1e-13, minimum=0.0, value=0.0, warmed=oil.LEAKAGE
    )

    def added(self, at: Place) -> Circuit:
        """From the head side to the rod side."""
        leak = Branch("head_pressure", "rod_pressure", Kind.LEAKAGE, lambda drop: self.conductance * drop)
        return Circuit({}, {at.name: leak})


class Leaks(Addition):
    """Sharp-edged openings from both sides of an actuator to the outside; its fields are the chambers.

    They are in the hoses: at the valve if a variant has its pressure, as in front of counterbalance valves,
    else at the chamber.
    """

    def added(self, at: Place) -> Circuit:
        """From each side to the atmosphere; no air flows in."""
        valve, found = getattr(at.own, "valve", None) or at.p.valve, dict[str, Branch]()
        for chamber, area in vars(self).items():
            before = chamber.replace("pressure", "valve_pressure")
            filled = before in at.circuit.nodes and at.circuit.nodes[before].capacitance is not None
            node = before if filled else chamber

            def flow(drop: Scalar, area: Scalar = area) -> Scalar:
                return valve.flow(area, ca.fmax(drop, 0), at.p)

            found[f"{at.name}_{chamber}"] = Branch(node, GROUND, Kind.LEAKAGE, flow)
        return Circuit({}, found)


def _opening(side: str) -> Quantity:
    return Quantity("m2", f"Opening to the outside at {side} of the {{}}", 1e-6, minimum=0.0, value=0.0)


class CylinderLeaks(Leaks):
    """Of a cylinder."""

    head_pressure: Scalar = _opening("the head side")
    rod_pressure: Scalar = _opening("the rod side")


class MotorLeaks(Leaks):
    """Of a motor."""

    pressure_a: Scalar = _opening("line A")
    pressure_b: Scalar = _opening("line B")


class OwnReliefs(PressureValve, Addition):
    """Relief valves of an actuator of its own."""

    pressure: Scalar = Quantity(
        "Pa", "Pressure at which a relief valve of the {} opens", 1e7, minimum=0.0, value=35e6
    )
    gain: Scalar = Quantity(
        "m3/(s.Pa)",
        "Flow of a relief valve of the {} per pressure above the opening pressure",
        1e-9,
        minimum=0.0,
        value=0.0,
    )
    rounding: Scalar = Quantity(
        "Pa",
        "Pressure range over which a relief valve of the {} begins to open",
        1e5,
        minimum=1.0,
        value=1e5,
    )


class CrossoverReliefs(OwnReliefs):
    """Two relief valves between the lines of a motor."""

    def added(self, at: Place) -> Circuit:
        """Both as one branch."""
        return Circuit({}, {at.name: Branch("pressure_a", "pressure_b", Kind.RELIEF, self.cross_flow)})


class ChamberReliefs(OwnReliefs):
    """A relief valve at each chamber of a cylinder, to the return line."""

    rod_pressure: Scalar = Quantity(
        "Pa", "The same at the rod side of the {} cylinder; 0: as at the head side", 1e7, minimum=0.0, value=0
    )

    def added(self, at: Place) -> Circuit:
        """One from each side."""
        own = ca.if_else(self.rod_pressure > 0, self.rod_pressure, self.pressure)
        sides = {"head": self, "rod": replace(self, pressure=own)}
        return Circuit(
            {},
            {
                f"{at.name}_{side}": Branch(f"{side}_pressure", TANK, Kind.RELIEF, valve.flow)
                for side, valve in sides.items()
            },
        )


class Cushion(Addition):
    """Cushions at both ends of the stroke: dp = R y Q^2 for flow out of the chamber.

    y rises from 0 at `length` before the end to 1 at the end, smoothly. Oil flows in freely.
    """

    length: Scalar = Quantity(
        "m", "Length before each end over which the {} is cushioned", 0.01, minimum=1e-4, value=0.05
    )
    resistance: Scalar = Quantity(
        "Pa.s2/m6",
        "Turbulent resistance of the cushion of the {} at the end of the stroke",
        1e12,
        minimum=0.0,
        value=0.0,
    )

    def added(self, at: Place) -> Circuit:
        """The oil columns of both lines with the drop of the cushion."""
        if any(getattr(at.circuit.branches.get(n), "drop", None) is None for n in ("head_flow", "rod_flow")):
            raise Problem(
                f"{at.name}: expected lines with oil columns, as in lumped and detailed, got others"
            )
        left = {"head_flow": at.u.position, "rod_flow": at.own.stroke - at.u.position}
        return Circuit({}, {n: self._throttled(at.circuit.branches[n], way) for n, way in left.items()})

    def _throttled(self, branch: Branch, left: Scalar) -> Branch:
        flow: Any = branch.flow
        closed, outward = s_curve(1 - left / self.length), ca.fmin(flow, 0)
        taken = -self.resistance * closed * outward**2
        return replace(branch, drop=branch.drop + taken, series={Kind.THROTTLE: taken})


class CushionWithoutColumn(Cushion):
    """Of a drive whose lines have no oil column: it does nothing, and its heat is 0."""

    def added(self, at: Place) -> Circuit:
        """A throttle without flow, so that the drive has the outputs of one with a cushion."""
        return Circuit({}, {at.name: Branch("head_pressure", "rod_pressure", Kind.THROTTLE, 0.0)})


class Regeneration(Addition):
    """An edge with a check valve from the rod side to the head side, which a positive command opens."""

    area: Scalar = Quantity(
        "m2", "Area of the regeneration edge of the {} at full command", 1e-5, minimum=0.0, value=0.0
    )
    command: Scalar = Quantity(
        "V", "Command at which the regeneration edge of the {} begins to open", minimum=0.0, value=1.0
    )

    def added(self, at: Place) -> Circuit:
        """The edge."""
        valve = getattr(at.own, "valve", None) or at.p.valve
        rounding = valve.command_rounding
        opening = ramp(ca.fmin(at.u.command, valve.full_command) - self.command, rounding)
        area = self.area * opening / ramp(valve.full_command - self.command, rounding)

        def flow(drop: Scalar) -> Scalar:
            return valve.flow(area, ca.fmax(drop, 0), at.p)

        return Circuit({}, {at.name: Branch("rod_pressure", "head_pressure", Kind.CHECK, flow)})


class AccumulatorState(Group):
    """State of an accumulator."""

    pressure: Scalar = Quantity("Pa", "Pressure of the oil in the {}", 1e7)


class Accumulator(Addition):
    """Gas accumulator at the supply line behind a laminar throttle; empty below its precharge.

    C(P) = V_0/(n p_0) (p_0/p)^(1 + 1/n), the polytropic law of a gas of volume V_0 at the precharge p_0, with
    absolute pressures. Below p_0 the bladder closes the port: C falls to `CLOSED` of C(p_0).
    """

    volume: Scalar = Quantity("m3", "Gas volume of the {} at its precharge", 1e-2, minimum=1e-6, value=1e-2)
    precharge: Scalar = Quantity("Pa", "Precharge of the {}", 1e7, minimum=1e5, value=10e6)
    exponent: Scalar = Quantity(
        "1", "Polytropic exponent of the gas of the {}", minimum=1.01, maximum=1.7, value=1.4
    )
    conductance: Scalar = Quantity(
        "m3/(s.Pa)", "Conductance of the throttle at the {}; 0: shut off", 1e-9, minimum=0.0, value=0.0
    )
    states: ClassVar[type[Group] | None] = AccumulatorState

    def compliance(self, pressure: Scalar) -> Scalar:
        """C/V_0 [1/Pa] at a gauge pressure."""
        s, start, p = self._gas(pressure)
        return ca.if_else(pressure > self.precharge, s / start * (start / p) ** (1 + s), CLOSED * s / start)

    def energy_density(self, pressure: Scalar) -> Scalar:
        """Energy [J/m3], the integral of P C/V_0 from 0."""
        s, start, p = self._gas(pressure)
        oil_share = 1 - (start / p) ** s
        polytropic = s / (1 - s) * (start**s * p ** (1 - s) - start) - ATMOSPHERE * oil_share
        return CLOSED * s / start * ca.fmin(pressure, self.precharge) ** 2 / 2 + polytropic

    def _gas(self, pressure: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """1/n, and the absolute pressures [Pa] of the precharge and of the gas."""
        start = self.precharge + ATMOSPHERE
        return 1 / self.exponent, start, ca.fmax(pressure + ATMOSPHERE, start)

    def start(self) -> dict[str, Scalar]:
        """Without oil."""
        return {"pressure": self.precharge}

    def added(self, at: Place) -> Circuit:
        """Behind its throttle at the supply line."""
        node = f"{at.name}_pressure"
        throttle = Branch("supply_pressure", node, Kind.THROTTLE, lambda drop: self.conductance * drop)
        return Circuit({node: Node(at.x.pressure, "C_a", 0, self.volume, self)}, {at.name: throttle})
