"""A first trajectory: what is measured, the rest by simulation from one segment to the next."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fmus.contract import ModelError
from fmus.identification.refinement.failed import Failed
from fmus.identification.refinement.problem import Run
from fmus.identification.refinement.simulator import Simulator

Array = NDArray[np.float64]

REST = 0.1  # s: a recording that starts at rest is averaged so long for its first state


def input_matrix(run: Run, simulator: Simulator) -> Array:
    """Inputs in the simulator's order, shape (n, nu)."""
    missing = [name for name in simulator.inputs if name not in run.inputs]
    if missing:
        raise ModelError(f"{run.name}: input {missing[0]} is missing, expected for the simulation")
    columns = [run.inputs[name] for name in simulator.inputs]
    return np.column_stack(columns) if columns else np.zeros((len(run.time), 0))


def first_state(run: Run, simulator: Simulator, p: Array, inputs: Array) -> Array:
    """The state that a run begins from, shape (nx,): measured as far as possible."""
    state = simulator.start(p, inputs[0])[0].copy()
    span = max(1, int(np.searchsorted(run.time, run.time[0] + REST))) if run.rest else 1
    for j, name in enumerate(simulator.states):
        if name in run.rest:
            state[j] = 0.0
        elif name in run.guess and np.isfinite(run.guess[name][:span]).any():
            state[j] = np.nanmean(run.guess[name][:span])
    return state


def first_states(run: Run, simulator: Simulator, p: Array, inputs: Array, edges: tuple[int, ...]) -> Array:
    """States at the start of each segment, shape (segments, nx)."""
    states = [first_state(run, simulator, p, inputs)]
    for first, last in pairwise(edges[:-1]):
        window = slice(first, last + 1)
        try:
            end = simulator.segment(states[-1], p, run.time[window], inputs[window], False).x.copy()
        except Failed:
            end = states[-1].copy()
        for j, name in enumerate(simulator.states):
            if name in run.guess and np.isfinite(run.guess[name][last]):
                end[j] = run.guess[name][last]
        states.append(end)
    return np.array(states)
