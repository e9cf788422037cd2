"""What the benches share: supply, return line, throttle, and a small ODE solved like the machine.

All benches have a supply of constant pressure and a return line whose filter keeps `RETURN` [Pa], so that no
pressure comes near zero. Throttles obey eq. (1).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from fmus import boom_stick, swing
from fmus.boom_stick.detailed_variables import DetailedParameters
from fmus.boom_stick.variables import BoomStickParameters
from fmus.components.spool_valve import turbulent_factor
from fmus.contract import Scalar, column
from fmus.monolith import Monolith, simulate
from fmus.parameters import values
from fmus.swing.detailed_variables import DetailedParameters as DetailedSwing
from fmus.swing.variables import SwingParameters

Array = NDArray[np.float64]
Named: TypeAlias = dict[str, Scalar]
Equations: TypeAlias = Callable[[Named, Named], tuple[Named, Named]]

SUPPLY = 20.684e6  # Pa, the machine's
RETURN = 0.5e6  # Pa
TOLERANCE = 1e-10  # relative, of CVODES


def lumped() -> BoomStickParameters:
    """Numbers of the lumped boom and stick drives: valve, hoses, oil."""
    return BoomStickParameters(**values(boom_stick.VARIANTS["lumped"]).p)


def detailed() -> DetailedParameters:
    """Numbers of the detailed boom and stick drives."""
    return DetailedParameters(**values(boom_stick.VARIANTS["detailed"]).p)


def lumped_swing() -> SwingParameters:
    """Numbers of the lumped swing drive: motor and lines."""
    return SwingParameters(**values(swing.VARIANTS["lumped"]).p)


def detailed_swing() -> DetailedSwing:
    """Numbers of the detailed swing drive."""
    return DetailedSwing(**values(swing.VARIANTS["detailed"]).p)


def start_flow(leakage: Scalar) -> Scalar:
    """Flow [m3/s] out of a shut port that stands at `RETURN`: what leaks from the supply.

    leakage   of an edge [m3/(s.Pa)]; the edge to the tank has the return line on both sides
    """
    return leakage * (SUPPLY - RETURN)


def throttle(drop: Scalar, resistance: float, transition_flow: Scalar) -> Scalar:
    """Flow [m3/s] through a throttle C_R [Pa.s2/m6] from the pressure drop, eq. (1)."""
    y = drop / resistance
    return y * turbulent_factor(y, transition_flow)


def run(
    states: Mapping[str, tuple[Scalar, float]],
    equations: Equations,
    time: Array,
    inputs: Mapping[str, Array],
) -> dict[str, Array]:
    """Outputs of a bench over time, each of shape (n,).

    states      value at the start and nominal value of each
    equations   (states, inputs) -> (rates, outputs), by name
    inputs      samples (n,) of each, straight lines between them
    """
    x, u = {n: ca.SX.sym(n) for n in states}, {n: ca.SX.sym(n) for n in inputs}
    rates, outputs = equations(dict(x), dict(u))
    arguments = [column(*x.values()), column(*u.values()), ca.SX.sym("p", 0)]
    start = np.array([float(value) for value, _ in states.values()])
    model = Monolith(
        states=tuple(states),
        inputs=tuple(inputs),
        parameters=(),
        output_names=tuple(outputs),
        right_hand_side=ca.Function("F", arguments, [column(*(rates[n] for n in states))]),
        outputs=ca.Function("Y", arguments, [column(*outputs.values())]),
        start=ca.Function("X0", arguments, [ca.SX(ca.DM(start))]),
        x=start,
        u=np.array([samples[0] for samples in inputs.values()]),
        p=np.zeros(0),
        nominal=np.array([nominal for _, nominal in states.values()]),
    )
    _, found = simulate(model, time, np.column_stack(list(inputs.values())), tolerance=TOLERANCE)
    return dict(zip(outputs, found.T, strict=True))
