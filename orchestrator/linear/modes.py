"""Modes of a linear model: eigenvalues, participation factors of the states, and names.

The name of a mode is derived from its participating states. It depends only on the model descriptions of the
FMUs: the unit of a state gives its quantity (position, speed, pressure, flow), the words of its name give the
part of the machine. The states boom_speed and boom_rod_pressure give the name
"hydraulic oscillation of boom".
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.text import short_names
from orchestrator.base.units import DeclaredUnit, parse_unit
from orchestrator.data.table import Array

# Main states: the fewest with this sum of participation factors, up to this number.
MAIN_PARTICIPATION, MAIN_COUNT = 0.8, 4
MIN_PARTICIPATION = 0.04  # smallest participation factor of a main state
MIN_KIND_PARTICIPATION = 0.12  # smallest participation of a quantity that influences the name
# quantity -> units of its kind, whose exponents tell it
UNITS = {"position": "m rad", "speed": "m/s rad/s", "pressure": "Pa", "flow": "m3/s", "volume": "m3"}
KINDS = {parse_unit(unit).exponents: kind for kind, units in UNITS.items() for unit in units.split()}
QUANTITIES = {"angle", "flow", "position", "pressure", "speed", "velocity", "volume"}
MOTION = {"position", "speed"}
OIL = {"pressure", "flow"}


class LinearVariable(NamedTuple):
    """A state, input or output of a linear model."""

    name: str
    unit: DeclaredUnit | None
    description: str
    nominal: float


def mode_name(
    value: complex, participation: Array, labels: Sequence[str], units: Sequence[DeclaredUnit | None]
) -> tuple[str, tuple[str, ...]]:
    """The name of a mode, and the names of its main states in descending order of participation."""
    totals = dict[str, float]()
    for factor, unit in zip(participation, units, strict=True):
        totals[quantity_kind(unit)] = totals.get(quantity_kind(unit), 0.0) + float(factor)
    kinds = {kind for kind, total in totals.items() if total >= MIN_KIND_PARTICIPATION}
    main = tuple(labels[i] for i in _main_states(participation))
    return _phrase(value, kinds, main), main


def quantity_kind(unit: DeclaredUnit | None) -> str:
    """The quantity that has a unit; empty if unknown."""
    return KINDS.get(unit.exponents, "") if unit and unit.exponents else ""


def _main_states(participation: Array) -> list[int]:
    """Indices of the main states in descending order of participation."""
    order, indices, total = np.argsort(-participation, kind="stable"), list[int](), 0.0
    for i in order[:MAIN_COUNT]:
        if indices and (total >= MAIN_PARTICIPATION or participation[i] < MIN_PARTICIPATION):
            break
        indices.append(int(i))
        total += float(participation[i])
    return indices


def _phrase(value: complex, kinds: set[str], names: Sequence[str]) -> str:
    """The name of a mode from its eigenvalue, the quantities of its states and their names."""
    subject = _subject(names)
    if value == 0.0:
        return f"integrator of {subject}"
    if value.real > 0.0:
        return f"growing oscillation of {subject}" if value.imag else f"divergence of {subject}"
    moves, oil = bool(kinds & MOTION), kinds & OIL
    if value.imag and moves:
        return f"{'hydraulic ' * bool(oil)}oscillation of {subject}"
    if value.imag:
        return f"{'oil ' * bool(oil)}oscillation of {subject}"
    if kinds == {"position"}:
        return f"position decay of {subject}"
    if moves:
        return f"overdamped hydraulic motion of {subject}" if oil else f"speed decay of {subject}"
    if oil == {"flow"}:
        return f"flow decay of {subject}"
    return f"pressure decay of {subject}" if oil else f"decay of {subject}"


def _subject(names: Sequence[str]) -> str:
    """The common first words of names, or else the two most frequent first words.

    boom_rod_pressure and boom_rod_flow give "boom rod"; boom_speed and boom_rod_pressure give "boom".
    """
    common = list[str]()
    for words in zip(*(n.replace(".", "_").split("_") for n in names), strict=False):
        if len(set(words)) > 1 or words[0] in QUANTITIES:
            break
        common.append(words[0])
    if common:
        return " ".join(common)
    first = [n.replace(".", "_").partition("_")[0] for n in names]
    return " and ".join(sorted(dict.fromkeys(first), key=lambda w: (-first.count(w), first.index(w)))[:2])


ZERO_EIGENVALUE = 1e-18  # relative to the norm of the balanced matrix; smaller eigenvalues are zero


@dataclass(frozen=True)
class Mode:
    """A real eigenvalue, or the one with positive imaginary part of a complex pair.

    value           eigenvalue [1/s]
    participation   participation factor of each state, with the sum 1
    name            derived from the names of the main states
    main_states     names in descending order of participation
    """

    value: complex
    participation: Array
    name: str
    main_states: tuple[str, ...]

    @property
    def oscillates(self) -> bool:
        """True for a pair of complex eigenvalues."""
        return self.value.imag > 0.0

    @property
    def frequency(self) -> float:
        """Undamped natural frequency |value| / 2 pi [Hz]; 0 for a real eigenvalue."""
        return abs(self.value) / (2.0 * math.pi) if self.oscillates else 0.0

    @property
    def damping(self) -> float:
        """Damping ratio [1]; 1, 0 or -1 for a negative, zero or positive real eigenvalue."""
        return -self.value.real / abs(self.value) if self.value else 0.0

    @property
    def time_constant(self) -> float:
        """Time constant of the decay [s]; negative if unstable, infinite if marginally stable."""
        return -1.0 / self.value.real if self.value.real else math.inf

    def as_dict(self) -> dict[str, Any]:
        """The mode for a JSON file."""
        return {
            "name": self.name,
            "states": list(self.main_states),
            "real": self.value.real,
            "imaginary": self.value.imag,
            "frequency": self.frequency,
            "damping": self.damping,
            "time_constant": self.time_constant if math.isfinite(self.time_constant) else None,
        }


def modes(a: Array, states: Sequence[LinearVariable]) -> tuple[Mode, ...]:
    """The modes of dx/dt = A x: oscillations, then the others, slowest first. Equal names are numbered."""
    if not states:
        return ()
    values, left, right = eigen(a, np.array([s.nominal for s in states]))
    labels = list(short_names(s.name for s in states).values())
    units, result = [s.unit for s in states], list[Mode]()
    for k in np.lexsort((values.imag, np.abs(values), values.imag == 0.0)):
        value = complex(values[k])
        if value.imag >= 0.0:
            factors = np.abs(left[:, k] * right[:, k])
            participation = factors / factors.sum() if factors.sum() else factors
            result.append(Mode(value, participation, *mode_name(value, participation, labels, units)))
    names = [m.name for m in result]
    for k, name in enumerate(names):
        if names.count(name) > 1:
            result[k] = replace(result[k], name=f"{name} ({names[: k + 1].count(name)})")
    return tuple(result)


def eigen(a: Array, nominal: Array) -> tuple[NDArray[np.complex128], ...]:
    """Eigenvalues, left and right eigenvectors of the matrix in scaled states.

    nominal   nominal values of the states

    The matrix combines states in Pa and in m3/s, and rates from 0 to 1e7 1/s. The states are therefore scaled
    by their nominal values, and then by powers of 2 until the norms of rows and columns agree (balancing in
    LAPACK). The Rayleigh quotient with left and right eigenvector then removes the rounding error of slow
    eigenvalues in the presence of fast ones, up to an error of second order.
    """
    from scipy.linalg import eig, matrix_balance

    scaled, _ = matrix_balance(a * nominal / nominal[:, None], permute=False)
    values, left, right = eig(scaled, left=True, right=True)
    denominator = np.einsum("ik,ik->k", left.conj(), right)
    numerator = np.einsum("ik,ij,jk->k", left.conj(), scaled, right)
    usable = np.abs(denominator) > 1e-6  # else the matrix is nearly defective: the vectors are orthogonal
    values[usable] = numerator[usable] / denominator[usable]
    values[np.abs(values) <= ZERO_EIGENVALUE * np.linalg.norm(scaled)] = 0.0
    values.imag[np.abs(values.imag) <= 1e-12 * np.abs(values)] = 0.0
    return values, left, right
