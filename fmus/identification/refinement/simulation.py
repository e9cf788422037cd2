"""The interface of a simulator, which computes a segment of a trajectory and its sensitivities.

That of a `Subsystem` is `compiled_model.CompiledModel`.
"""

from dataclasses import dataclass
from typing import Protocol

from orchestrator.data.table import Array


class SimulationFailed(Exception):
    """A simulation that ended early: the reason, and the time [s] that it reached."""

    def __init__(self, reason: str, time: float) -> None:
        super().__init__(f"{reason} at t = {time:.9g} s")
        self.reason, self.time = reason, time


@dataclass(frozen=True)
class SegmentSolution:
    """A segment of n samples; the sensitivities are empty arrays if none were requested.

    y          outputs at the samples, shape (n, ny)
    x          states at the last sample, shape (nx,)
    y_x, y_p   sensitivities of y to the initial states and to the parameters, (n, ny, nx), (n, ny, np)
    x_x, x_p   sensitivities of x to the same, (nx, nx), (nx, np)
    steps      number of solver steps, 0 if unknown
    """

    y: Array
    x: Array
    y_x: Array
    y_p: Array
    x_x: Array
    x_p: Array
    steps: int = 0


class Simulator(Protocol):
    """The interface of a model to the refinement.

    states, inputs, outputs, free   names; `free` are the parameters to be estimated
    nominal                         nominal values of the states, shape (nx,)
    p0                              initial values of the free parameters, shape (np,)
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    free: tuple[str, ...]
    nominal: Array
    p0: Array

    def start(self, p: Array, u0: Array, /) -> tuple[Array, Array]:
        """Initial states at inputs `u0`, shape (nx,), and their derivatives by p, shape (nx, np)."""

    def segment(
        self, x: Array, p: Array, time: Array, inputs: Array, sensitivities: bool = True, /
    ) -> SegmentSolution:
        """Simulate from the states `x` over `time` (n,) with `inputs` (n, nu), linear between the samples."""
