"""Viscous damping of swing gear and pistons (section 4(d), eq. (13), Fig. 9).

    x' B = a        a = tau - M q'' - V - G        x' = q' of the swing, J q' of a piston

with tau of measured pressures and M, V, G of the manipulator, the viscous friction of the joints as known.
Both sides are filtered alike and the acceleration is moved onto the filter (`momentum_balance`), so that B is
least squares of impulses and momenta (`momentum_fit`).

The paper's estimator is shown for comparison (`as_printed`), B = (x'^T x')^-1 x'^T a at every sample, with
one Savitzky-Golay filter for all: angles, their first and second derivatives, and pressures. The noise v of
the speed q' is in x' = J q' and takes off B what it adds to the denominator; in a it is with df/dq':

    B = (sum x' a - sd(v)^2 sum df/dq') / (sum x'^2 - sd(v)^2 sum J^2)        corrected

(Fuller 1987, Measurement Error Models, section 1.2). The noise of q'' is not correlated with v: one kernel
is even, the other odd. J = 1 for the swing, whose x' is its speed.

Validity: viscous friction, everything else known. What is not, B takes in, as the paper says: the remarks
tell how much, and whether dry friction can be seen.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import statsmodels.api as sm
from numpy.typing import NDArray

from fmus.identification.estimate import Estimate, coverage_factor
from fmus.identification.procedure_result import Curve, Panel, ProcedureResult
from fmus.identification.procedures import momentum_balance
from fmus.identification.procedures.experiment_data import (
    condition,
    noise_sd,
    tank_pressure,
    training_recordings,
)
from fmus.identification.procedures.momentum_balance import (
    ANGLES,
    JOINTS,
    ORDER,
    PARAMETERS,
    PRESSURES,
    SmoothedRecording,
    apply,
    motion,
    numbers,
    samples,
)
from fmus.identification.procedures.momentum_fit import (
    KnownParameterEffect,
    MomentumSolution,
    known_parameter_effect,
    solve,
)
from fmus.identification.recordings.clock import uniform_rate
from fmus.identification.recordings.derivatives import SavitzkyGolay
from fmus.identification.recordings.masks import good_all
from fmus.identification.recordings.reading import require
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

Array = NDArray[np.float64]

SIGNALS: Mapping[str, str] = momentum_balance.SIGNALS  # of the pressures those of the joint that moves
SIZES = (ORDER + 1, 9, 21)  # samples of the derivative filter to compare
SIGN = 0.03  # of the root mean square speed, over which the sign of a dry friction is rounded
MOVES = 3.0  # standard deviations of its noise above which a root mean square speed is one
STANDS = 1e-6  # rad/s: rounding
CLOUD = 1500  # points that are drawn
LITTLE = 0.1  # of a standard deviation: what is smaller is not mentioned
CLEAR = 4.0  # standard deviations from which on a dry friction is said to be seen


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
class PrintedEstimate:
    """B by (13) with a filter of `window` [s], as it is and with the noise of the speed taken off."""

    window: float
    value: float
    corrected: float


@dataclass(frozen=True)
class JointDamping:
    """The result of one joint's recordings.

    speed, resistance   x' and a of (13), filtered, shape (n,)
    known               what errors of the known parameters do
    dry                 dry friction next to B, its standard deviation, and the B that then is left
    standing            names of files in which the joint stands, which are left out
    """

    contact: Contact
    records: tuple[SmoothedRecording, ...]
    solution: MomentumSolution
    speed: Array
    resistance: Array
    printed: tuple[PrintedEstimate, ...]
    known: KnownParameterEffect
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


def identify(recordings: Sequence[Recording], known: Mapping[str, Number]) -> ProcedureResult:
    """B of each joint of which there are recordings."""
    own = training_recordings(recordings, "damping", dict.fromkeys(ANGLES, "rad"))
    for r in own:
        require(r, dict.fromkeys(PRESSURES[condition(r, "joint", CONTACTS)], "Pa"))
    parts = {joint: [r for r in own if r.text_condition("joint") == joint] for joint in CONTACTS}
    joints = [joint_damping(CONTACTS[joint], part, known) for joint, part in parts.items() if part]
    return ProcedureResult(
        procedure="damping",
        title="Viscous damping of the joints: resistance over speed",
        figure=9,
        estimates=tuple(
            Estimate.normal(
                one.contact.parameter,
                one.value,
                one.contact.unit,
                one.known.total,
                "eq. (13) by impulses and momenta" + one.known.note(),
                minimum=0.0,
            )
            for one in joints
            if one.value > 0
        ),
        panels=tuple(panel for one in joints for panel in panels(one)),
        remarks=tuple(f"{one.contact.parameter}: {text}" for one in joints for text in _remarks(one)),
        others=tuple(estimate for one in joints for estimate in _others(one)),
    )


def joint_damping(
    contact: Contact, recordings: Sequence[Recording], known: Mapping[str, Number]
) -> JointDamping:
    """B of one contact."""
    p, row = numbers(known), JOINTS.index(contact.joint)
    every = [(r, samples(r, [contact.joint], p)) for r in recordings]
    moving = [(r, s) for r, s in every if _moves(s, row)]
    records = tuple(s for _, s in moving)
    if not records:
        where = ", ".join(str(r.source) for r in recordings)
        raise Problem(f"{where}: the {contact.joint} stands, expected it to move: no damping to see")
    solution = solve(records, [contact.joint], (contact.theta,), p)
    arms = [levers(contact.joint, s.q, p) for s in records]
    # where the equation holds, B times the speed is the resistance but for the residual
    speed, resistance = [], []
    for s, arm, e in zip(records, arms, solution.equations, strict=True):
        own = arm[s.middle][s.good]
        slope, error = e.slope[0, 0][s.good] / own, e.error[0][s.good] / own
        speed.append(-slope)
        resistance.append(error - slope * (solution.values[0] + solution.mean_effect[0]))
    return JointDamping(
        contact=contact,
        records=records,
        solution=solution,
        speed=np.concatenate(speed),
        resistance=np.concatenate(resistance),
        printed=tuple(as_printed([r for r, _ in moving], contact.joint, contact.theta, p)),
        known=known_parameter_effect(solution, 0, known),
        dry=_dry(row, records, arms, solution),
        standing=tuple(r.source.name for r, s in every if not _moves(s, row)),
    )


def _moves(s: SmoothedRecording, joint: int) -> bool:
    """Is the speed above its noise?"""
    noise = s.filters.gain(np.ones(1)) * s.angle_noise[joint]
    return bool(np.sqrt(np.mean(s.w[joint] ** 2)) > max(MOVES * noise, STANDS))


def levers(joint: str, q: Array, p: Array) -> Array:
    """x' over the joint's speed at angles q (3, n): 1 or the moment arm of the cylinder [m], shape (n,)."""
    if joint == "swing":
        return np.ones(q.shape[1])
    arms: Array = np.array(motion(()).pistons(q, p)[1].full())
    return np.array(arms[JOINTS.index(joint) - 1])


def _dry(
    row: int, records: Sequence[SmoothedRecording], arms: Sequence[Array], solution: MomentumSolution
) -> tuple[float, float, float]:
    """A constant friction against the motion as one more unknown, and an offset: least squares."""
    y, columns = [], []
    for s, arm, e in zip(records, arms, solution.equations, strict=True):
        speed = arm * s.w[row]
        against = np.tanh(speed / (SIGN * np.sqrt(np.mean(speed**2))))
        filtered = apply(s.filters.bump, np.array([arm * against, arm]))[:, s.good]
        y.append(e.error[0][s.good])
        columns.append(np.column_stack([-e.slope[0, 0][s.good], *filtered]))
    matrix = np.concatenate(columns)
    scale = np.linalg.norm(matrix, axis=0)
    lags = {"maxlags": 8 * records[0].filters.loss // records[0].filters.every}
    fit = sm.OLS(np.concatenate(y), matrix / scale).fit(cov_type="HAC", cov_kwds=lags)
    left = solution.values[0] + fit.params[0] / scale[0]
    return float(fit.params[1] / scale[1]), float(fit.bse[1] / scale[1]), float(left)


def as_printed(recordings: Sequence[Recording], joint: str, theta: str, p: Array) -> list[PrintedEstimate]:
    """(13) over all recordings, for filters from the shortest to a long one; theta is the damping."""
    at, step = p.copy(), 1 / uniform_rate(recordings[0])
    at[PARAMETERS.index(theta)] = 0.0
    estimates = []
    for size in SIZES:
        sums = np.sum([_sums(r, joint, at, size) for r in recordings], axis=0)
        product, square, of_product, of_square = map(float, sums)
        corrected = (product - of_product) / (square - of_square)
        estimates.append(PrintedEstimate(size * step, product / square, corrected))
    return estimates


def _sums(recording: Recording, joint: str, p: Array, size: int) -> Array:
    """Sums of x' a and x'^2, and what the noise adds to them in the mean."""
    row, rate = JOINTS.index(joint), uniform_rate(recording)
    kernel = SavitzkyGolay(rate, (size - 1) / rate, ORDER)
    bad = ~good_all(recording, (*ANGLES, *PRESSURES[joint]))
    there = momentum_balance.covered(bad, size)
    value, slope, curve = (weights[::-1] for weights in kernel.weights)
    raw = momentum_balance.angles(recording)
    q, w, bend = (apply(k, raw)[:, there] for k in (value, slope, curve))
    pressures = apply(value, momentum_balance.pressures(recording, PRESSURES[joint]))[:, there]
    printed = motion(()).printed(q, w, bend, pressures, tank_pressure(recording), p)
    error, by_speed, arm = (x.full()[row] for x in printed)
    v = kernel.gain(1) * noise_sd(recording, ANGLES[row])
    product, square = w[row] @ error, np.sum((arm * w[row]) ** 2)
    return np.array([product, square, v**2 * by_speed.sum(), v**2 * np.sum(arm**2)])


def panels(one: JointDamping) -> tuple[Panel, Panel, Panel]:
    """Resistance over speed with the line, its residual, and B over the length of the filter."""
    step = max(1, len(one.speed) // CLOUD)
    x, a = one.speed[::step], one.resistance[::step]
    ends = np.array([x.min(), x.max()])
    line = Panel(
        x_label=one.contact.speed,
        y_label=one.contact.resistance,
        curves=(Curve("a, measured", x, a), Curve("B x'", ends, one.value * ends, "fit", line=True)),
        title=one.contact.joint,
        x_unit=(one.contact.speed_unit, 1.0),
        y_unit=(one.contact.resistance_unit, 1.0),
    )
    residual = replace(line, y_label="residual", curves=(Curve("a - B x'", x, a - one.value * x),), title="")
    lengths = np.array([p.window for p in one.printed])
    plain, corrected = (np.array([getattr(p, n) for p in one.printed]) for n in ("value", "corrected"))
    half = np.full(2, coverage_factor() * one.sd)
    curves = (
        Curve("(13), a at every sample", lengths, plain, "compared", line=True),
        Curve("(13), noise taken off", lengths, corrected, "corrected", line=True),
        Curve("this estimate", lengths[[0, -1]], np.full(2, one.value), "fit", line=True, error=half),
    )
    filters = Panel(
        x_label=f"length of the {one.contact.joint}'s derivative filter",
        y_label="B",
        curves=curves,
        x_unit=("s", 1.0),
        y_unit=(one.contact.unit, 1.0),
    )
    return line, residual, filters


def _others(one: JointDamping) -> Iterator[Estimate]:
    """B by these recordings alone where that is another interval, and a dry friction."""
    name, unit = one.contact.parameter, one.contact.unit
    if one.known.matters:
        label = f"{name}, the rest known exactly"
        yield Estimate.normal(label, one.value, unit, one.sd, "by the recordings alone")
    dry, sd, _ = one.dry
    if dry > 0:  # one that pushes is no friction: a remark says so where it is clear
        force, note = one.contact.resistance_unit, "as one more unknown of (13)"
        yield Estimate.normal(f"dry friction next to {name}", dry, force, sd, note)


def _remarks(one: JointDamping) -> Iterator[str]:
    """What the reader must know, without the parameter's name."""
    unit = one.contact.unit
    if one.value <= 0:
        yield (
            f"{one.value:.3g} {unit} is no damping, so it is not handed on: something that is taken as known "
            "is wrong."
        )
    yield _used(one)
    for name in one.standing:
        yield f"in {name} the joint stands, so it is left out."
    noise, residual = (math.sqrt(max(c[0, 0], 0.0)) for c in (one.solution.noise, one.solution.residual))
    yield (
        f"the noise of the sensors gives a standard deviation of {noise:.3g} {unit}, the residuals one of "
        f"{residual:.3g}. "
        + (
            "Noise does not explain them: the model lacks something, and the interval covers it."
            if one.solution.lacks
            else "Noise explains them, and the interval is that of the noise."
        )
    )
    bias = float(one.solution.mean_effect[0])
    if abs(bias) >= LITTLE * one.sd:  # by errors in variables
        yield (
            f"the encoders' noise in the speed moves this estimate by {100 * bias / one.value:+.2g} %, which "
            "is taken off."
        )
    first = one.printed[0]
    share = 100 * (first.value / first.corrected - 1)
    yield (
        f"(13) as printed, with a derivative over {first.window * 1e3:.3g} ms, gives {first.value:.4g} "
        f"{unit}; the encoders' noise makes {share:+.2g} % of it, without which it is {first.corrected:.4g}."
    )
    yield from one.known.remarks(one.value, unit)
    dry, sd, left = one.dry
    if not np.isfinite(sd) or abs(dry) < CLEAR * sd:
        return
    if dry < 0:
        yield (
            "resistance grows more than in proportion to the speed: dry friction next to B would be "
            "negative, which is no law of friction. Something else moves the residual, such as a number that "
            "is taken as known."
        )
    else:
        yield (
            f"the residual has the sign of the speed. A dry friction of {dry:.3g} +- {sd:.2g} "
            f"{one.contact.resistance_unit} next to a damping of {left:.4g} {unit} fits better; the viscous "
            "law takes it into B, at the speeds of these recordings."
        )


def _used(one: JointDamping) -> str:
    share = 100 * (1 - len(one.speed) / sum(s.good.size for s in one.records))
    seconds = len(one.speed) * one.records[0].filters.step
    text = f"{seconds:.3g} s of {len(one.records)} recordings are used"
    if not share:
        return f"{text}, nothing is left out."
    ends = sum(s.touched for s in one.records)
    stops = f"; in {ends} samples a piston was at an end of its stroke" if ends else ""
    return f"{text}, {share:.2g} % is left out because of clipped or missing samples nearby{stops}."
