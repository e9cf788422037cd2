"""Damping of one joint from its recordings: the solution, its doubts, and what the figure needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import statsmodels.api as sm
from numpy.typing import NDArray

from fmus.contract import ModelError
from fmus.identification.procedures.balance import modulation
from fmus.identification.procedures.balance.doubt import Doubt, doubt
from fmus.identification.procedures.balance.motion import JOINTS
from fmus.identification.procedures.balance.samples import Samples, numbers, samples
from fmus.identification.procedures.balance.solution import Solution, solve
from fmus.identification.procedures.damping.as_printed import Plain, least_squares, levers
from fmus.identification.recordings.recording import Recording
from fmus.parameters import Number

Array = NDArray[np.float64]
SIGN = 0.03  # of the root mean square speed, over which the sign of a dry friction is rounded

MOVES = 3.0  # standard deviations of its noise above which a root mean square speed is one
STANDS = 1e-6  # rad/s: rounding


@dataclass(frozen=True)
class Contact:
    """Where the friction is: its parameter, the words and units of speed and resistance."""

    joint: str
    parameter: str
    unit: str
    speed: str
    speed_unit: str
    resistance: str
    resistance_unit: str

    @property
    def theta(self) -> str:
        """The parameter by part and name."""
        return f"manipulator.{self.parameter}"


CONTACTS = {
    "swing": Contact(
        "swing", "swing_damping", "N.m.s/rad", "swing speed", "rad/s", "torque of the gear's friction", "N.m"
    ),
    **{
        j: Contact(
            j, f"{j}_piston_damping", "N.s/m", f"speed of the {j} piston", "m/s", "force of its friction", "N"
        )
        for j in ("boom", "stick")
    },
}


@dataclass(frozen=True)
class JointDamping:
    """What one joint's recordings told.

    speed, resistance   x' and a of (13), filtered, shape (n,)
    doubt               by the known parameters
    dry                 dry friction beside B, its standard deviation, and the B that then is left
    standing            names of files in which the joint stands, which are left out
    """

    contact: Contact
    records: tuple[Samples, ...]
    solution: Solution
    speed: Array
    resistance: Array
    plain: tuple[Plain, ...]
    doubt: Doubt
    dry: tuple[float, float, float]
    standing: tuple[str, ...]

    @property
    def value(self) -> float:
        """B."""
        return float(self.solution.values[0])

    @property
    def sd(self) -> float:
        """Standard deviation by these recordings."""
        return float(self.solution.sd[0])


def joint_damping(
    contact: Contact, recordings: Sequence[Recording], known: Mapping[str, Number]
) -> JointDamping:
    """B of one contact."""
    p = numbers(known)
    row = JOINTS.index(contact.joint)
    every = [(r, samples(r, [contact.joint], p)) for r in recordings]
    moving = [(r, s) for r, s in every if _moves(s, row)]
    records = tuple(s for _, s in moving)
    if not records:
        where = ", ".join(str(r.source) for r in recordings)
        raise ModelError(f"{where}: the {contact.joint} stands, expected it to move: no damping to see")
    solution = solve(records, [contact.joint], (contact.theta,), p)
    arms = [levers(contact.joint, s.q, p) for s in records]
    speed, resistance = _cloud(records, arms, solution)
    return JointDamping(
        contact=contact,
        records=records,
        solution=solution,
        speed=speed,
        resistance=resistance,
        plain=tuple(least_squares([r for r, _ in moving], contact.joint, contact.theta, p)),
        doubt=doubt(solution, 0, known),
        dry=_dry(row, records, arms, solution),
        standing=tuple(r.source.name for r, s in every if not _moves(s, row)),
    )


def _moves(s: Samples, joint: int) -> bool:
    """Is the speed above its noise?"""
    noise = s.filters.gain(np.ones(1)) * s.angle_noise[joint]
    return bool(np.sqrt(np.mean(s.w[joint] ** 2)) > max(MOVES * noise, STANDS))


def _cloud(records: Sequence[Samples], arms: Sequence[Array], solution: Solution) -> tuple[Array, Array]:
    """Speed and resistance where the equation holds; B times the one is the other but for the residual."""
    speed, resistance = [], []
    for s, arm, e in zip(records, arms, solution.equations, strict=True):
        own = arm[s.middle][s.good]
        slope, error = e.slope[0, 0][s.good] / own, e.error[0][s.good] / own
        speed.append(-slope)
        resistance.append(error - slope * (solution.values[0] + solution.mean_effect[0]))
    return np.concatenate(speed), np.concatenate(resistance)


def _dry(
    row: int, records: Sequence[Samples], arms: Sequence[Array], solution: Solution
) -> tuple[float, float, float]:
    """A constant friction against the motion as one more unknown, and an offset: least squares."""
    y, columns = [], []
    for s, arm, e in zip(records, arms, solution.equations, strict=True):
        speed = arm * s.w[row]
        against = np.tanh(speed / (SIGN * np.sqrt(np.mean(speed**2))))
        filtered = modulation.apply(s.filters.bump, np.array([arm * against, arm]))[:, s.good]
        y.append(e.error[0][s.good])
        columns.append(np.column_stack([-e.slope[0, 0][s.good], *filtered]))
    matrix = np.concatenate(columns)
    scale = np.linalg.norm(matrix, axis=0)
    lags = {"maxlags": 8 * records[0].filters.loss // records[0].filters.every}
    fit = sm.OLS(np.concatenate(y), matrix / scale).fit(cov_type="HAC", cov_kwds=lags)
    left = solution.values[0] + fit.params[0] / scale[0]
    return float(fit.params[1] / scale[1]), float(fit.bse[1] / scale[1]), float(left)
