"""A test bench for the supply: a load that takes oil, integration, and rest, by names."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

from fmus.contract import quantities, symbolic
from fmus.parameters import values
from fmus.supply import VARIANTS

SUB = VARIANTS["engine_pump"]
MODEL = symbolic(SUB)
NUMBERS = values(SUB).p
STATES, OUTPUTS, INPUTS = (list(quantities(g)) for g in (SUB.states, SUB.outputs, SUB.inputs))
NOMINAL = np.array([q.nominal for q in quantities(SUB.states).values()])
FUNCTION = MODEL.function()
L_MIN = 1e-3 / 60  # m3/s


def constants(**changes: float) -> list[float]:
    """The parameters in order, some of them changed."""
    return list((NUMBERS | changes).values())


def rest(p: list[float]) -> np.ndarray:
    """The state at the start."""
    return MODEL.initial()([0.0] * len(STATES), [0.0] * len(INPUTS), p).full()[:, 0]


def show(x: np.ndarray, flow: float, p: list[float]) -> dict[str, float]:
    """All outputs at a state and a flow that swing takes and gives back."""
    y = FUNCTION(x, drawing(flow), p)[1].full()[:, 0]
    return dict(zip(OUTPUTS, map(float, y), strict=True))


def drawing(flow: float) -> list[float]:
    """Inputs: swing takes a flow and gives it back."""
    taken = {"supply_flow_swing": flow, "return_flow_swing": flow}
    return [taken.get(name, 0.0) for name in INPUTS]


def orifice(gain: ca.SX, pressure: ca.SX) -> ca.SX:
    """Flow through an orifice of C_R = 1 / gain^2 to the tank."""
    return gain * pressure / (pressure**2 + 1e5**2) ** 0.25


def at(x: np.ndarray, gain: float, p: list[float]) -> dict[str, float]:
    """All outputs while an orifice takes oil."""
    return show(x, float(orifice(gain, x[STATES.index("supply_pressure")])), p)


def through_orifices(gains, p: list[float], hold: float, samples: int = 40) -> tuple[np.ndarray, dict]:
    """Time (n,) and outputs (n,) from rest through a row of orifices, each open for `hold` seconds."""
    z, gain = ca.SX.sym("z", len(STATES)), ca.SX.sym("gain")
    flow = orifice(gain, z[STATES.index("supply_pressure")] * NOMINAL[STATES.index("supply_pressure")])
    u = ca.vertcat(*(flow if name.endswith("swing") else 0 for name in INPUTS))
    rate = FUNCTION(z * NOMINAL, u, ca.DM(p))[0] / NOMINAL
    grid = np.linspace(0, hold, samples + 1)
    options = {"reltol": 1e-10, "abstol": 1e-10, "max_num_steps": 100_000}
    solver = ca.integrator("s", "cvodes", {"x": z, "p": gain, "ode": rate}, 0.0, grid[1:], options)
    x, rows, times = rest(p) / NOMINAL, [], []
    for k, g in enumerate(gains):
        path = solver(x0=x, p=g)["xf"].full()
        rows += [at(column * NOMINAL, g, p) for column in path.T]
        times += list(grid[1:] + k * hold)
        x = path[:, -1]
    return np.array(times), {name: np.array([row[name] for row in rows]) for name in OUTPUTS}


def settled(gain: float, **changes: float) -> Mapping[str, float]:
    """Outputs after four seconds with one orifice open; the slowest time constant is a few tenths."""
    _, y = through_orifices([gain], constants(**changes), 4.0, 2)
    return {name: float(v[-1]) for name, v in y.items()}
