"""What the refinement needs of a model: segments of a trajectory, with their sensitivities."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Piece(Protocol):
    """A segment of n samples: outputs, the state at the end, their derivatives.

    `y_x` means the derivative of y with respect to the state at the segment's start, `x_p` that of the
    end state with respect to the free parameters, and so on.
    """

    @property
    def y(self) -> Array:
        """Shape (n, ny)."""

    @property
    def x(self) -> Array:
        """Shape (nx,)."""

    @property
    def y_x(self) -> Array:
        """Shape (n, ny, nx)."""

    @property
    def y_p(self) -> Array:
        """Shape (n, ny, np)."""

    @property
    def x_x(self) -> Array:
        """Shape (nx, nx)."""

    @property
    def x_p(self) -> Array:
        """Shape (nx, np)."""


class Simulator(Protocol):
    """A model as the refinement sees it; names, magnitudes of the states, start values of the parameters.

    `refinement.model.Model` is the one with exact sensitivities, `refinement.differences` has others.
    """

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs."""

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the free parameters."""

    @property
    def nominal(self) -> Array:
        """Magnitudes of the states, shape (nx,)."""

    @property
    def p0(self) -> Array:
        """Values of the free parameters to begin with, shape (np,)."""

    def start(self, p: Array, u0: Array, /) -> tuple[Array, Array]:
        """State at rest at inputs `u0`, and its derivative with respect to p."""

    def segment(self, x: Array, p: Array, time: Array, inputs: Array, sensitivities: bool = True, /) -> Piece:
        """From state `x` over `time` (n,) with `inputs` (n, nu), linear between the samples."""
