"""Common equations of all variants of the swing drive: motor and gear, outputs, requirements, terminals.

torque = D (P_1 - P_2)           D = D_m N                                   eqs. (8), (11), (12)
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fmus import ports
from fmus.components import hose, spool_valve
from fmus.components.circuit import TANK, Branch, Circuit, Kind
from fmus.components.load_sensing import Sensed
from fmus.components.motor import BrakeTorque
from fmus.components.oil import at_temperature
from fmus.components.orifice import PressureValve
from fmus.contract import Scalar, Subsystem, Terminal, quantities
from fmus.swing.variables import LinePressures, SwingInputs

PARAMETERS = Path(__file__).with_name("parameters.toml")
Pair = tuple[Scalar, Scalar]  # (line A, line B), or (motor port 1, motor port 2)
LINES = ("swing_pressure_a", "swing_pressure_b")


def displacement(p: Any) -> Scalar:
    """D [m3/rad], displacement per swing angle."""
    return p.motor_displacement * p.gear_ratio


@dataclass(frozen=True)
class Drive:
    """The drive at one instant.

    circuit       with the nodes LINES
    load          its load pressure, from those of the lines
    others        rates of the states that are not in the circuit
    shown         outputs of the variant that are not in the circuit
    ports         pressures of the ports of the motor, and their rates; default: those of the lines
    brake         torque [N.m] against the motion, and what it does
    """

    circuit: Circuit
    load: Sensed
    others: Mapping[str, Scalar] = field(default_factory=dict)
    shown: Mapping[str, Scalar] = field(default_factory=dict)
    ports: tuple[Pair, Pair] | None = None
    brake: tuple[Scalar, BrakeTorque] = (0, BrakeTorque(0, 0, 0))

    def rates(self) -> dict[str, Scalar]:
        """Time derivative of the state, by name."""
        return {**self.circuit.rates, **self.others}

    def observe(self, u: SwingInputs, p: Any) -> dict[str, Scalar]:
        """Outputs by name."""
        lines, line_rates = (
            (of["swing_pressure_a"], of["swing_pressure_b"])
            for of in (self.circuit.pressures, self.circuit.rates)
        )
        (one, two), (rate_1, rate_2) = self.ports or (lines, line_rates)
        load, (torque, brake), known = self.load(lines, line_rates, u), self.brake, self.circuit.outputs()
        return {
            **known,
            "swing_torque": displacement(p) * (one - two) - torque,
            "swing_torque_rate": displacement(p) * (rate_1 - rate_2) - brake.rate,
            "swing_load_pressure": load.value,
            "swing_load_pressure_rate": load.rate,
            "swing_motor_pressure_a": one,
            "swing_motor_pressure_b": two,
            "swing_drain_flow": self.circuit.through(Kind.DRAIN),
            "swing_void_volume": known["void_volume"],
            "swing_anti_cavitation_flow": known["anti_cavitation_flow"],
            "stored_energy": known["stored_energy"] + brake.stored,
            "dissipated_power": known["dissipated_power"] + brake.heat,
            **self.shown,
        }


def reliefs(p: Any) -> dict[str, Branch]:
    """Crossover relief valves at the motor, and make-up from the return line."""
    back = PressureValve.of(p, "anti_cavitation")
    return {
        "swing_relief_flow": Branch(*LINES, Kind.RELIEF, PressureValve.of(p, "relief").cross_flow),
        "anti_cavitation_a": Branch(TANK, LINES[0], Kind.ANTI_CAVITATION, back.flow),
        "anti_cavitation_b": Branch(TANK, LINES[1], Kind.ANTI_CAVITATION, back.flow),
    }


def motor(u: SwingInputs, p: Any) -> tuple[Scalar, Scalar, Scalar]:
    """Displaced flow D w [m3/s] and leakage resistances [Pa.s/m3], for `fmus.components.motor`."""
    return displacement(p) * u.swing_speed, p.internal_leakage_resistance, p.external_leakage_resistance


def derive_capacitance(p: Any) -> dict[str, Scalar]:
    """Capacitance of a line with its motor side; walls are rigid in variants without a modulus for them."""
    wall = getattr(p, "hose_wall_modulus", math.inf)
    line = hose.capacitance(p.line_length, p.line_bore, p.bulk_modulus, wall)
    return {"line_capacitance": line + p.motor_volume / p.bulk_modulus}


def derive(p: Any) -> dict[str, Scalar]:
    """Parameters of the lines that are derived from length and bore."""
    size = (p.line_length, p.line_bore)
    return derive_capacitance(p) | {
        "line_inertance": hose.inertance(*size, p.density),
        "line_resistance": hose.laminar_resistance(*size, p.viscosity),
    }


def initial_pressures(x: object, u: SwingInputs, p: Any) -> dict[str, Scalar]:
    """Initial state of both lines: at the preload, no torque."""
    return dict.fromkeys(quantities(LinePressures), u.tank_pressure + p.initial_preload)


def require(x: object, u: object, p: Any) -> dict[str, Scalar]:
    """Requirements of the valve."""
    return spool_valve.requirements(p)


TERMINALS: tuple[Terminal, ...] = (
    ports.shaft("swing", drives=True),
    ports.lever("swing"),
    ports.supply_line(),
    ports.return_line(),
    ports.load_sensing_line("swing"),
)


def variant(
    drive: Callable[[Any, SwingInputs, Any], Drive],
    states: type[Any],
    outputs: type[Any],
    text: str,
    parameters: type[Any],
    initial: Callable[[Any, Any, Any], Mapping[str, Scalar]],
    validity: str,
    require: Callable[[Any, Any, Any], Mapping[str, Scalar]] = require,
    derive: Callable[[Any], Mapping[str, Scalar]] = lambda _: {},
    stiff: bool = True,
) -> Subsystem:
    """A variant with the parameters of warm oil; the others are those of `Subsystem`.

    drive   (x, u, p) -> drive
    """

    def observe(x: Any, u: SwingInputs, p: Any) -> Any:
        """Outputs."""
        known = drive(x, u, p).observe(u, p)
        return outputs(**{name: known[name] for name in quantities(outputs)})

    return at_temperature(
        Subsystem(
            name="swing",
            inputs=SwingInputs,
            states=states,
            outputs=outputs,
            dynamics=lambda x, u, p: states(**drive(x, u, p).rates()),
            observe=observe,
            circuits=lambda x, u, p: {"swing": drive(x, u, p).circuit},
            values=PARAMETERS,
            terminals=TERMINALS,
            text=text,
            parameters=parameters,
            initial=initial,
            require=require,
            derive=derive,
            validity=validity,
            stiff=stiff,
        )
    )
