"""Modes of a linear model: eigenvalues, how much each state takes part in them, and what to call them.

A mode is named by the states that take part in it. Nothing here knows a machine, all comes from the model
descriptions of the FMUs: the unit of a state says what it is (a motion, a pressure, a flow), the words of its
name say what it belongs to, so that boom_speed and boom_rod_pressure make "boom on its oil".
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eig, matrix_balance

from orchestrator.base.units import DeclaredUnit

if TYPE_CHECKING:
    from orchestrator.linear.model import LinearVariable

MAIN_PARTICIPATION, MAIN_COUNT = (
    0.8,
    4,
)  # states are listed until they have this share of a mode, and at most so many
MIN_PARTICIPATION = 0.04  # a state with less is not listed
MIN_KIND_PARTICIPATION = 0.12  # of a mode that a kind of states has to have, to be in its name
KINDS = {  # exponents of kg, m, s without the radian
    (0, 1, 0): "position",
    (0, 1, -1): "speed",
    (1, -1, -2): "pressure",
    (0, 3, -1): "flow",
    (0, 3, 0): "volume",
}
ROTATION_KINDS = {0: "position", -1: "speed"}  # with the radian: by the exponent of the second
QUANTITIES = {"angle", "flow", "position", "pressure", "speed", "velocity", "volume"}
MOTION = {"position", "speed"}
OIL = {"pressure", "flow"}


def short_names(states: Sequence[LinearVariable]) -> list[str]:
    """Names of states without their component, where that is enough."""
    bare = [s.name.rpartition(".")[2] for s in states]
    return [b if bare.count(b) == 1 else s.name for b, s in zip(bare, states, strict=True)]


def mode_name(
    value: complex, share: NDArray[np.float64], labels: Sequence[str], units: Sequence[DeclaredUnit | None]
) -> tuple[str, tuple[str, ...]]:
    """What a mode is, and the names of the states that make most of it, the largest first."""
    weight = dict[str, float]()
    for part, unit in zip(share, units, strict=True):
        weight[quantity_kind(unit)] = weight.get(quantity_kind(unit), 0.0) + float(part)
    kinds = {k for k, total in weight.items() if total >= MIN_KIND_PARTICIPATION}
    main = tuple(labels[i] for i in _main_states(share))
    return _phrase(value, kinds, main), main


def quantity_kind(unit: DeclaredUnit | None) -> str:
    """What a quantity with this unit is; empty where that is not known."""
    if unit is None or unit.exponents is None:
        return ""
    *base, radian = unit.exponents
    if any(base[3:]):
        return ""
    if radian == 1 and not any(base[:2]):
        return ROTATION_KINDS.get(base[2], "")
    return KINDS.get((base[0], base[1], base[2]), "")


def _main_states(share: NDArray[np.float64]) -> list[int]:
    """The states to name, the largest first."""
    order, found, total = np.argsort(-share, kind="stable"), list[int](), 0.0
    for i in order[:MAIN_COUNT]:
        if found and (total >= MAIN_PARTICIPATION or share[i] < MIN_PARTICIPATION):
            break
        found.append(int(i))
        total += float(share[i])
    return found


def _phrase(value: complex, kinds: set[str], names: Sequence[str]) -> str:
    """The words before the list of states."""
    what = _subject(names)
    both = " and " in what
    s, its = ("", "their") if both else ("s", "its")
    if value == 0.0:
        how = "where" if kinds & MOTION else "as"
        return f"{what} stay{s} {how} {'they are' if both else 'it is'}"
    if value.real > 0.0:
        return f"{what} swing{s} up" if value.imag else f"{what} drift{s} off"
    moves, oil = bool(kinds & MOTION), kinds & OIL
    if value.imag and moves:
        return f"{what} on {its} oil" if oil else f"{what} swing{s}"
    if value.imag:
        return f"oil of {what} swings" if oil else f"{what} swing{s}"
    if kinds == {"position"}:
        return f"{what} return{s} to {its} place{'s' * both}"
    if moves:
        return f"{what} against {its} oil" if oil else f"{what} come{s} to rest"
    if oil == {"flow"}:
        return f"flow of {what} follows its pressures"
    return f"pressure of {what} settles" if oil else f"{what} settle{s}"


def _subject(names: Sequence[str]) -> str:
    """The words that all names begin with, else the first words, those that stand there most often first.

    boom_rod_pressure and boom_rod_flow are of the boom rod; boom_speed and boom_rod_pressure of the boom.
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


Array = NDArray[np.float64]
ZERO_EIGENVALUE = 1e-18  # of the norm of the balanced matrix: what is left of a zero after that


@dataclass(frozen=True)
class Mode:
    """One real eigenvalue, or a pair of complex ones of which this has the positive imaginary part.

    value     [1/s]
    share     how much each state takes part in it: participation factors, the sum of which is 1
    name      in words, from the names of these states
    members   those that make most of it, the largest first
    """

    value: complex
    participation: Array
    name: str
    main_states: tuple[str, ...]

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

    def as_dict(self) -> dict[str, Any]:
        """For a file."""
        lasts = self.time_constant
        return {
            "name": self.name,
            "states": list(self.main_states),
            "real": self.value.real,
            "imaginary": self.value.imag,
            "frequency": self.frequency,
            "damping": self.damping,
            "time_constant": lasts if math.isfinite(lasts) else None,
        }


def modes(a: Array, states: Sequence[LinearVariable]) -> tuple[Mode, ...]:
    """The modes of dx/dt = A x, the slowest first."""
    values, left, right = eigen(a, np.array([s.nominal for s in states]))
    labels, found = short_names(states), []
    for k in np.lexsort((values.imag, np.abs(values))):
        if values[k].imag >= 0.0:
            share = np.abs(left[:, k] * right[:, k])
            share = share / share.sum() if share.sum() else share
            units = [s.unit for s in states]
            found.append(
                Mode(complex(values[k]), share, *mode_name(complex(values[k]), share, labels, units))
            )
    return tuple(_numbered(found))


def _numbered(found: Sequence[Mode]) -> Iterator[Mode]:
    """The modes, with numbers behind names that occur more than once."""
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
    values[np.abs(values) <= ZERO_EIGENVALUE * np.linalg.norm(scaled)] = 0.0
    values.imag[np.abs(values.imag) <= 1e-12 * np.abs(values)] = 0.0
    return values, left, right
