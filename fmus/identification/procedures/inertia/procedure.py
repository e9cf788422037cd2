"""Inertial parameters from joint motion and torque; the paper took them from CAD.

The balance of momenta (`balance`) is linear in masses and moments of inertia about the centres of mass, the
geometry and the centres being known. All joints count; the dampings of swing and pistons are found along with
them, so that an error of theirs cannot go into the inertia. Parameters that the motion does not tell stay as
they are known, and the remarks name them. What data can tell at best are the base parameters (`others`).

Validity: rigid links, viscous friction; what is known is right.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from fmus.contract import ModelError, quantities
from fmus.identification.finding import Estimate, Finding
from fmus.identification.procedures.balance import motion
from fmus.identification.procedures.balance.doubt import doubt
from fmus.identification.procedures.balance.motion import JOINTS
from fmus.identification.procedures.balance.samples import Samples, numbers, samples
from fmus.identification.procedures.balance.solution import Solution, solve
from fmus.identification.procedures.inertia.base_estimates import base_estimates
from fmus.identification.procedures.inertia.panels import panels
from fmus.identification.procedures.shared.given import training
from fmus.identification.procedures.shared.regression import symmetrical
from fmus.identification.recordings.recording import Recording
from fmus.manipulator import MANIPULATOR
from fmus.parameters import Number

Array = NDArray[np.float64]
SIGNALS: Mapping[str, str] = motion.SIGNALS
FREE = ("head_mass", "stick_inertia", "boom_inertia", "column_inertia")
DAMPINGS = ("swing_damping", "boom_piston_damping", "stick_piston_damping")
WINDOW = 0.4  # s: longer than usual, so that the small inertias, which show in fast motion only, are not bent
EVERY = 3  # smoothed samples thinned out: 67 per second of 200
TELLS = 0.25  # standard deviation over value above which data do not tell a parameter


def identify(
    recordings: Sequence[Recording], known: Mapping[str, Number], free: Sequence[str] = FREE
) -> Finding:
    """Masses and inertias `free` of the manipulator, from recordings of the machine, else of its joints."""
    own = _usable(recordings)
    p = numbers(known)
    records = [samples(r, JOINTS, p, window=WINDOW, every=EVERY) for r in own]
    names, dropped = list(free), list[str]()
    solution = _solve(records, names, p)
    while names and (worst := _worst(solution, len(names))) is not None:
        dropped.append(names.pop(worst))
        solution = _solve(records, names, p)
    return Finding(
        procedure="inertia",
        title="Inertial parameters: what the joints' torques ask for",
        figure=0,
        estimates=tuple(_estimate(solution, k, known) for k in range(len(names))),
        panels=panels(records, solution),
        remarks=tuple(_remarks(own, solution, names, dropped, known)),
        others=(*_dampings(solution, len(names)), *base_estimates(records, solution, p)),
    )


def _usable(recordings: Sequence[Recording]) -> list[Recording]:
    """Recordings to train with in which the machine moves: of the whole machine if there are any."""
    for procedure in ("machine", "damping"):
        if any(r.procedure == procedure and r.use == "train" for r in recordings):
            return list(training(recordings, procedure, SIGNALS))
    there = ", ".join(sorted({r.procedure for r in recordings})) or "no recording"
    raise ModelError(
        f"inertia: expected a recording of the machine or of a joint to train with, found {there}"
    )


def _solve(records: Sequence[Samples], names: Sequence[str], p: Array) -> Solution:
    theta = tuple(f"manipulator.{n}" for n in (*names, *DAMPINGS))
    return solve(records, JOINTS, theta, p)


def _worst(solution: Solution, count: int) -> int | None:
    """The parameter that the data tell least, if one is not told at all."""
    ratios = [sd / abs(value) for sd, value in zip(solution.sd, solution.values, strict=True)][:count]
    ratios = [math.inf if value <= 0 else r for r, value in zip(ratios, solution.values, strict=False)]
    return ratios.index(max(ratios)) if max(ratios) > TELLS else None


def _unit(name: str) -> str:
    return quantities(MANIPULATOR.parameters)[name].unit


def _estimate(solution: Solution, k: int, known: Mapping[str, Number]) -> Estimate:
    name = solution.theta[k].partition(".")[2]
    by_known = doubt(solution, k, known)
    note = "balance of the joints' momenta" + by_known.note()
    return symmetrical(name, float(solution.values[k]), _unit(name), by_known.total, note)


def _dampings(solution: Solution, first: int) -> list[Estimate]:
    found = zip(DAMPINGS, solution.values[first:], solution.sd[first:], strict=True)
    return [
        symmetrical(f"{n}, found along", float(v), _unit(n), float(sd), "unknown of the same balance")
        for n, v, sd in found
    ]


def _remarks(
    own: Sequence[Recording],
    solution: Solution,
    names: Sequence[str],
    dropped: Sequence[str],
    known: Mapping[str, Number],
) -> Iterator[str]:
    seconds = sum(float(r.time[-1] - r.time[0]) for r in own)
    yield f"{seconds:.3g} s of {len(own)} recordings are used: {', '.join(r.title for r in own)}."
    for name in dropped:
        yield f"{name}: this motion does not tell it; it stays as it is known."
    if solution.lacks:
        yield (
            "Noise does not explain the residuals: the model lacks something, such as dry friction or a head "
            "that swings. The intervals are those of the residuals."
        )
    for k, name in enumerate(names):
        for text in doubt(solution, k, known).remarks(float(solution.values[k]), _unit(name)):
            yield f"{name}: {text}"
