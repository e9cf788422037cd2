"""Monolithic reference of the co-simulation: connected subsystems as one ODE, solved with tight tolerances.

The equations are those of `fmus.composition`: no signal is held or extrapolated. CVODES (BDF) integrates with
the exact Jacobian between the breakpoints of a piecewise linear scenario, and restarts at each breakpoint.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from fmus.composition import couple
from fmus.contract import Subsystem, Symbolic, column, quantities
from fmus.parameters import Values, values
from orchestrator.base.errors import Problem
from orchestrator.base.interrupts import DeferredInterrupts
from orchestrator.data.table import Array

SAME_TIME = 1e-10  # s: times closer than this are equal; six times the rounding unit of 1e5 s


@dataclass(frozen=True)
class Monolith:
    """One ODE. Names are `component.variable`; `inputs` are the names of the external inputs.

    right_hand_side   (X, U, P) -> dX/dt
    outputs           (X, U, P) -> Y, all outputs of all subsystems
    start             (X_start, U, P) -> initial X
    x, u, p           start values of states and inputs, parameter values
    nominal           nominal values of the states
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
    known: Mapping[str, Symbolic] | None = None,
) -> Monolith:
    """Join subsystems by (source output, target input) pairs.

    Unconnected inputs keep their start value. Raises Problem on an algebraic loop.

    inputs    external input -> `component.variable` of each input that it feeds
    numbers   parameter and start values by component; default: those of the subsystems
    known     expressions of components that are known already
    """
    numbers = numbers or {name: values(sub) for name, sub in subsystems.items()}
    constant = {f"{n}.{v}": value for n, group in numbers.items() for v, value in group.u.items()}
    coupled = couple(subsystems, connections, inputs, constant, known)
    x, u, p = start_values(numbers, inputs)
    return Monolith(
        states=coupled.states,
        inputs=coupled.inputs,
        parameters=coupled.parameters,
        output_names=coupled.outputs,
        right_hand_side=coupled.of("F", coupled.dx),
        outputs=coupled.of("Y", coupled.y),
        start=coupled.of("X0", coupled.start),
        x=x,
        u=u,
        p=p,
        nominal=np.array([q.nominal for s in subsystems.values() for q in quantities(s.states).values()]),
    )


def start_values(
    numbers: Mapping[str, Values], inputs: Mapping[str, Sequence[str]]
) -> tuple[Array, Array, Array]:
    """`x`, `u` and `p` of a `Monolith` from the values of its components; inputs: as in `join`."""
    constant = {f"{n}.{v}": value for n, group in numbers.items() for v, value in group.u.items()}
    x, p = (
        np.concatenate([list(g.values()) for g in of])
        for of in zip(*((n.x, n.p) for n in numbers.values()), strict=True)
    )
    return x, np.array([constant[next(iter(targets))] for targets in inputs.values()]), p


def merge_times(first: Array, second: Array) -> Array:
    """The times of `first`, and those of `second` that differ from all of them by more than `SAME_TIME`.

    Two grids that should share a time often differ by its rounding: 3 * 0.1 is not 0.3. Raises Problem if
    two times of one grid are equal to `SAME_TIME`, because a jump between them would be lost.
    """
    for time in (first, second):
        refuse_equal_times(time)
    after = np.searchsorted(first, second)
    nearest = np.minimum(
        np.abs(second - first[np.maximum(after - 1, 0)]),
        np.abs(second - first[np.minimum(after, len(first) - 1)]),
    )
    return np.sort(np.concatenate([first, second[nearest > SAME_TIME]]))


def refuse_equal_times(time: Array) -> None:
    """Raise Problem unless each time [s] exceeds the one before by more than `SAME_TIME`."""
    short = np.nonzero(~(np.diff(time) > SAME_TIME))[0]
    if short.size:
        a, b = time[short[0]], time[short[0] + 1]
        raise Problem(
            f"times: expected steps of more than {SAME_TIME:g} s, got {b - a:.3g} s after t = {a:.9g} s; "
            "fmus.monolith.merge_times joins two nearly equal grids"
        )


def breakpoints(time: Array, samples: Array, tolerance: float = 1e-9) -> NDArray[np.int64]:
    """Indices at which piecewise linear samples (n, m) over time (n,) change slope, and of both ends.

    Corners are found from each sample and its neighbours. Where the samples of a curve are so dense that no
    single one is a corner, the worst sample between two corners becomes one [Douglas, Peucker 1973].

    tolerance   distance of a sample from the line between corners up to which it is on the line;
                at least the rounding error of the samples, for example of a pressure in Pa
    """
    rounding = 8 * np.finfo(float).eps * np.abs(samples).max(axis=0)
    allowed = np.maximum(tolerance, rounding)
    gaps = np.diff(time)[:, None]
    kink = np.abs(np.diff(np.diff(samples, axis=0) / gaps, axis=0)) * np.minimum(gaps[1:], gaps[:-1])
    corners = [0, *(1 + np.nonzero((kink > allowed).any(axis=1))[0]), len(samples) - 1]
    spans, found = list(pairwise(corners)), {*corners}
    while spans:
        first, last = spans.pop()
        worst = _farthest_from_the_line(time[first : last + 1], samples[first : last + 1], allowed)
        if worst:
            found.add(first + worst)
            spans += [(first, first + worst), (first + worst, last)]
    return np.array(sorted(found), dtype=np.int64)


def _farthest_from_the_line(time: Array, samples: Array, allowed: Array) -> int:
    """Index of the sample that is farthest from the line between first and last; 0: all are on it."""
    share = (time - time[0]) / (time[-1] - time[0])
    line = samples[0] + share[:, None] * (samples[-1] - samples[0])
    distance = (np.abs(samples - line) / allowed).max(axis=1)[1:-1]
    return int(np.argmax(distance)) + 1 if (distance > 1).any() else 0


def simulate(
    model: Monolith, time: Array, inputs: Array, p: Array | None = None, tolerance: float = 1e-12
) -> tuple[Array, Array]:
    """States (n, nx) and outputs (n, ny) at `time` (n,), inputs (n, nu) linear between the samples.

    Raises Problem if two times are equal but for rounding; see `merge_times`.

    p           parameter values, including the initial pose; default: those of the model
    tolerance   relative tolerance, and absolute tolerance divided by the nominal value of each state

    CVODES bounds the root mean square of the errors of the n states. A tolerance smaller by sqrt(n) bounds
    that of each state, so states at rest leave no more error to the others.
    """
    refuse_equal_times(time)
    tolerance /= np.sqrt(len(model.states))
    scale = ca.DM(model.nominal)
    p = model.p if p is None else p
    t, z = ca.SX.sym("t"), ca.SX.sym("z", len(model.states))
    u0, slope, constants = (
        ca.SX.sym(n, k) for n, k in (("u0", inputs.shape[1]), ("slope", inputs.shape[1]), ("p", p.size))
    )
    rate = model.right_hand_side(z * scale, u0 + slope * t, constants) / scale
    ode = {"t": t, "x": z, "p": column(u0, slope, constants), "ode": rate}
    options = {"reltol": tolerance, "abstol": tolerance, "max_num_steps": 1_000_000}
    x = model.start(model.x, inputs[0], p).full()[:, 0]
    states = [x]
    for first, last in pairwise(breakpoints(time, inputs)):
        grid = time[first : last + 1] - time[first]
        slopes = (inputs[last] - inputs[first]) / grid[-1]
        solver = ca.integrator("segment", "cvodes", ode, 0.0, grid[1:], options)
        with DeferredInterrupts(
            second_at_once=False
        ):  # CasADi checks for signals while it evaluates equations
            result = solver(x0=x / model.nominal, p=np.concatenate([inputs[first], slopes, p]))
        segment = result["xf"].full().T * model.nominal
        states.extend(segment)
        x = segment[-1]
    history = np.array(states)
    outputs = model.outputs.map(len(time))(history.T, inputs.T, ca.repmat(ca.DM(p), 1, len(time)))
    return history, outputs.full().T
