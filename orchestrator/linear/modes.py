"""Modes of a linear model: eigenvalues, how much each state takes part in them, and what to call them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eig, matrix_balance

from orchestrator.linear.naming import labelled, name

if TYPE_CHECKING:
    from orchestrator.linear.result import Named

Array = NDArray[np.float64]
ZERO = 1e-18  # of the norm of the balanced matrix: what is left of a zero after that


@dataclass(frozen=True)
class Mode:
    """One real eigenvalue, or a pair of complex ones of which this has the positive imaginary part.

    value     [1/s]
    share     how much each state takes part in it: participation factors, the sum of which is 1
    name      in words, from the names of these states
    members   those that make most of it, the largest first
    """

    value: complex
    share: Array
    name: str
    members: tuple[str, ...]

    @property
    def oscillates(self) -> bool:
        """Is it a pair?"""
        return self.value.imag > 0.0

    @property
    def frequency(self) -> float:
        """Of the undamped mode, |value| / 2 pi [Hz]; of a real eigenvalue 0."""
        return abs(self.value) / (2.0 * math.pi) if self.oscillates else 0.0

    @property
    def damping(self) -> float:
        """Damping ratio [1]; of a real eigenvalue 1 where it decays, -1 where it grows, 0 where it stays."""
        return -self.value.real / abs(self.value) if self.value else 0.0

    @property
    def time_constant(self) -> float:
        """Of the decay [s]; negative where it grows, infinite where it stays."""
        return -1.0 / self.value.real if self.value.real else math.inf

    def described(self) -> dict[str, Any]:
        """For a file."""
        lasts = self.time_constant
        return {
            "name": self.name,
            "states": list(self.members),
            "real": self.value.real,
            "imaginary": self.value.imag,
            "frequency": self.frequency,
            "damping": self.damping,
            "time_constant": lasts if math.isfinite(lasts) else None,
        }


def modes(a: Array, states: Sequence[Named]) -> tuple[Mode, ...]:
    """The modes of dx/dt = A x, the slowest first."""
    values, left, right = eigen(a, np.array([s.size for s in states]))
    labels, found = labelled(states), []
    for k in np.lexsort((values.imag, np.abs(values))):
        if values[k].imag >= 0.0:
            share = np.abs(left[:, k] * right[:, k])
            share = share / share.sum() if share.sum() else share
            units = [s.unit for s in states]
            found.append(Mode(complex(values[k]), share, *name(complex(values[k]), share, labels, units)))
    return tuple(_apart(found))


def _apart(found: Sequence[Mode]) -> Iterator[Mode]:
    """The same with numbers behind names that occur more than once."""
    names = [m.name for m in found]
    for k, mode in enumerate(found):
        number = f" ({names[: k + 1].count(mode.name)})" if names.count(mode.name) > 1 else ""
        yield replace(mode, name=mode.name + number)


def eigen(a: Array, size: Array) -> tuple[NDArray[np.complex128], ...]:
    """Eigenvalues, and left and right eigenvectors of the matrix in the scaled states.

    States in Pa and in m3/s stand in one matrix, and rates from 0 to 1e7 1/s. So states are scaled by their
    magnitudes, then by powers of 2 until rows and columns are alike (LAPACK's balancing). What a slow
    eigenvalue then has as rounding of the fast ones, its Rayleigh quotient with both vectors takes off: the
    error left is of second order.
    """
    if not len(a):
        empty = np.zeros(0, complex)
        return empty, np.zeros((0, 0), complex), np.zeros((0, 0), complex)
    scaled, _ = matrix_balance(a * size / size[:, None], permute=False)
    values, left, right = eig(scaled, left=True, right=True)
    over = np.einsum("ik,ik->k", left.conj(), right)
    upper = np.einsum("ik,ij,jk->k", left.conj(), scaled, right)
    usable = np.abs(over) > 1e-6  # else nearly defective: left and right vectors are at right angles
    values = np.where(usable, upper / np.where(usable, over, 1.0), values)
    values[np.abs(values) <= ZERO * np.linalg.norm(scaled)] = 0.0
    values.imag[np.abs(values.imag) <= 1e-12 * np.abs(values)] = 0.0
    return values, left, right
