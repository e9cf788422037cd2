"""The subsystems joined into one ODE and integrated tightly: the truth for co-simulation.

The equations are those of `fmus.composition`: no signal is held or extrapolated. Between the breakpoints of a
piecewise linear scenario CVODES (BDF) integrates with the exact Jacobian; at each breakpoint it starts anew,
because the input has a kink there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from fmus.composition import couple
from fmus.contract import Subsystem, column, quantities
from fmus.parameters import Values, values
from orchestrator.base.interrupts import DeferredInterrupts

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Monolith:
    """One ODE. Names are `component.variable`; `inputs` are the machine's inputs.

    right_hand_side   (X, U, P) -> dX/dt
    outputs           (X, U, P) -> Y, all outputs of all subsystems
    start             (X_start, U, P) -> X at the start, consistent with the pose
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    output_names: tuple[str, ...]
    right_hand_side: ca.Function
    outputs: ca.Function
    start: ca.Function
    x: Array
    u: Array
    p: Array
    nominal: Array


def join(
    subsystems: Mapping[str, Subsystem],
    connections: Sequence[tuple[str, str]],
    inputs: Mapping[str, Sequence[str]],
    numbers: Mapping[str, Values] | None = None,
) -> Monolith:
    """Join subsystems by (source output, target input) pairs; `inputs` feeds the machine's inputs.

    Inputs that nobody feeds keep their start value. Raises Problem on an algebraic loop.
    """
    numbers = numbers or {name: values(sub) for name, sub in subsystems.items()}
    constant = {f"{n}.{v}": value for n, nums in numbers.items() for v, value in nums.u.items()}
    whole = couple(subsystems, connections, inputs, constant)
    return Monolith(
        states=whole.states,
        inputs=whole.inputs,
        parameters=whole.parameters,
        output_names=whole.outputs,
        right_hand_side=whole.function("F", whole.dx),
        outputs=whole.function("Y", whole.y),
        start=whole.function("X0", whole.start),
        x=np.concatenate([list(n.x.values()) for n in numbers.values()]),
        u=np.array([constant[next(iter(targets))] for targets in inputs.values()]),
        p=np.concatenate([list(n.p.values()) for n in numbers.values()]),
        nominal=np.array([q.nominal for s in subsystems.values() for q in quantities(s.states).values()]),
    )


def breakpoints(time: Array, samples: Array, tolerance: float = 1e-9) -> NDArray[np.int64]:
    """Indices where piecewise linear samples (n, m) over time (n,) change slope; with both ends.

    tolerance   largest distance of a sample from the line through its neighbours that counts as none; what
                rounding of the samples makes is none either, such as of a pressure in Pa
    """
    rounding = 8 * np.finfo(float).eps * np.abs(samples).max(axis=0)
    gaps = np.diff(time)[:, None]
    kink = np.abs(np.diff(np.diff(samples, axis=0) / gaps, axis=0)) * np.minimum(gaps[1:], gaps[:-1])
    return np.concatenate(
        [[0], 1 + np.nonzero((kink > np.maximum(tolerance, rounding)).any(axis=1))[0], [len(samples) - 1]]
    )


def simulate(
    model: Monolith,
    time: Array,
    inputs: Array,
    p: Array | None = None,
    tolerance: float = 1e-12,
) -> tuple[Array, Array]:
    """States (n, nx) and outputs (n, ny) at `time` (n,), inputs (n, nu) linear between the samples.

    `tolerance` is relative, and absolute times each state's nominal value. `p` are parameters, the pose to
    start from among them (default: of the parameter files).
    """
    scale = ca.DM(model.nominal)
    p = model.p if p is None else p
    t, z = ca.SX.sym("t"), ca.SX.sym("z", len(model.states))
    at, slope, fixed = (
        ca.SX.sym(n, k) for n, k in (("at", inputs.shape[1]), ("slope", inputs.shape[1]), ("p", p.size))
    )
    rate = model.right_hand_side(z * scale, at + slope * t, fixed) / scale
    ode = {"t": t, "x": z, "p": column(at, slope, fixed), "ode": rate}
    options = {"reltol": tolerance, "abstol": tolerance, "max_num_steps": 1_000_000}
    x = model.start(model.x, inputs[0], p).full()[:, 0]
    states = [x]
    corners = breakpoints(time, inputs)
    for first, last in pairwise(corners):
        grid = time[first : last + 1] - time[first]
        slopes = (inputs[last] - inputs[first]) / grid[-1]
        solver = ca.integrator("segment", "cvodes", ode, 0.0, grid[1:], options)
        with DeferredInterrupts(insist=False):  # CasADi asks for signals inside the equations
            result = solver(x0=x / model.nominal, p=np.concatenate([inputs[first], slopes, p]))
        piece = result["xf"].full().T * model.nominal
        states.extend(piece)
        x = piece[-1]
    history = np.array(states)
    outputs = model.outputs.map(len(time))(history.T, inputs.T, ca.repmat(ca.DM(p), 1, len(time)))
    return history, outputs.full().T
