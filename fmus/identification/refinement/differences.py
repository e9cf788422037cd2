"""Sensitivities by finite differences: of a model's segments, and of whole runs of any simulator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmus.identification.refinement.simulation import PieceResult, Simulator

Array = NDArray[np.float64]

STEP = 1e-5  # relative; suits a simulation with about ten digits, see `Differences.step`


@dataclass(frozen=True)
class Derived:
    """A piece of which the derivatives are quotients."""

    y: Array
    x: Array
    y_x: Array
    y_p: Array
    x_x: Array
    x_p: Array


def _perturbed(
    run: Callable[[Array], tuple[Array, Array]], at: Array, steps: Array, central: bool
) -> tuple[Array, Array]:
    """Derivatives of both results of `run` with respect to its argument, last axis."""
    columns: list[tuple[Array, Array]] = []
    y, x = run(at)
    for j, step in enumerate(steps):
        moved = at.copy()
        moved[j] += step
        above = run(moved)
        moved[j] = at[j] - step
        below = run(moved) if central else (y, x)
        width = 2 * step if central else step
        columns.append(((above[0] - below[0]) / width, (above[1] - below[1]) / width))
    if not columns:
        return np.zeros((*y.shape, 0)), np.zeros((*x.shape, 0))
    return np.stack([c[0] for c in columns], axis=-1), np.stack([c[1] for c in columns], axis=-1)


class Differences:
    """A simulator with the derivatives replaced by difference quotients of its own segments.

    step   relative to the magnitude of each state and parameter
    """

    def __init__(self, model: Simulator, step: float = STEP, central: bool = False) -> None:
        self.model, self.step, self.central = model, step, central
        self.states, self.inputs, self.outputs = model.states, model.inputs, model.outputs
        self.free, self.nominal, self.p0, self.start = model.free, model.nominal, model.p0, model.start

    def segment(
        self, x: Array, p: Array, time: Array, inputs: Array, sensitivities: bool = True
    ) -> PieceResult | Derived:
        """As the model's, over n + 1 simulations."""
        base = self.model.segment(x, p, time, inputs, False)
        if not sensitivities:
            return base
        nx = len(x)

        def run(both: Array) -> tuple[Array, Array]:
            piece = self.model.segment(both[:nx], both[nx:], time, inputs, False)
            return piece.y, piece.x

        sizes = np.concatenate([self.nominal, np.where(p == 0, 1.0, np.abs(p))])
        y_, x_ = _perturbed(run, np.concatenate([x, p]), self.step * sizes, self.central)
        return Derived(base.y, base.x, y_[..., :nx], y_[..., nx:], x_[..., :nx], x_[..., nx:])


class BlackBox:
    """Any simulator of whole runs: `simulate(p, time, inputs)` gives the outputs, shape (n, ny).

    It has no states that could be set, so each run is one segment: single shooting.
    `simulate` is called from several threads; give `refine` one thread if it cannot bear that.
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
        """No state, so nothing."""
        del u0
        return np.zeros(0), np.zeros((0, len(p)))

    def segment(self, x: Array, p: Array, time: Array, inputs: Array, sensitivities: bool = True) -> Derived:
        """One whole run, over n + 1 simulations."""
        y, none, sizes = self.simulate(p, time, inputs), np.zeros((0, 0)), np.where(p == 0, 1.0, np.abs(p))
        y_p = np.zeros((*y.shape, 0))
        if sensitivities:
            y_p, _ = _perturbed(lambda q: (self.simulate(q, time, inputs), x), p, self.step * sizes, False)
        return Derived(y, x, np.zeros((*y.shape, 0)), y_p, none, np.zeros((0, len(p))))
