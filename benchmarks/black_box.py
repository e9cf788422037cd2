"""Simulators without sensitivities of their own, for comparison: finite differences and black boxes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from fmus.identification.refinement.compiled_model import CompiledModel, SegmentSolution
from orchestrator.data.table import Array

STEP = 1e-5  # relative step of the difference quotients; suits a simulation with about ten digits


class FiniteDifferences:
    """A simulator whose sensitivities are forward difference quotients of its own segments.

    step   relative to the magnitude of each state and parameter
    """

    def __init__(self, model: CompiledModel | BlackBox, step: float = STEP) -> None:
        self.model, self.step = model, step
        self.states, self.inputs, self.outputs = model.states, model.inputs, model.outputs
        self.free, self.nominal, self.p0, self.start = model.free, model.nominal, model.p0, model.start

    def segment(
        self, x: Array, p: Array, time: Array, inputs: Array, sensitivities: bool = True
    ) -> SegmentSolution:
        """A segment of the model; its sensitivities take one more simulation per state and parameter."""
        base = self.model.segment(x, p, time, inputs, False)
        if not sensitivities:
            return base
        nx, xp = len(x), np.concatenate([x, p])
        dy, dx = np.zeros((*base.y.shape, xp.size)), np.zeros((nx, xp.size))
        nominal = np.concatenate([self.nominal, np.where(p == 0, 1.0, np.abs(p))])
        for j, step in enumerate(self.step * nominal):
            changed = xp.copy()
            changed[j] += step
            other = self.model.segment(changed[:nx], changed[nx:], time, inputs, False)
            dy[..., j], dx[..., j] = (other.y - base.y) / step, (other.x - base.x) / step
        return replace(base, y_x=dy[..., :nx], y_p=dy[..., nx:], x_x=dx[:, :nx], x_p=dx[:, nx:])


class BlackBox:
    """Any simulator of whole runs: `simulate(p, time, inputs)` returns the outputs, shape (n, ny).

    Its states cannot be set, so that each run is one segment (single shooting). Its sensitivities are finite
    differences. Of several recordings, `simulate` is called from several threads.
    """

    def __init__(
        self,
        simulate: Callable[[Array, Array, Array], Array],
        inputs: Sequence[str],
        outputs: Sequence[str],
        free: Sequence[str],
        p0: Array,
        step: float = STEP,
    ) -> None:
        self.simulate, self.step = simulate, step
        self.states: tuple[str, ...] = ()
        self.inputs, self.outputs, self.free = tuple(inputs), tuple(outputs), tuple(free)
        self.nominal, self.p0 = np.zeros(0), p0

    def start(self, p: Array, u0: Array) -> tuple[Array, Array]:
        """Empty arrays, as there are no states."""
        del u0
        return np.zeros(0), np.zeros((0, len(p)))

    def segment(
        self, x: Array, p: Array, time: Array, inputs: Array, sensitivities: bool = True
    ) -> SegmentSolution:
        """One whole run; its sensitivities take one more run per parameter."""
        if sensitivities:
            return FiniteDifferences(self, self.step).segment(x, p, time, inputs)
        y, empty = self.simulate(p, time, inputs), np.zeros((0, 0))
        return SegmentSolution(y, x, np.zeros((*y.shape, 0)), np.zeros((*y.shape, 0)), empty, empty)
