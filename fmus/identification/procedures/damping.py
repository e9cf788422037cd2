"""The paper's (13) as printed: B = (x'^T x')^-1 x'^T a, with a = tau - M q'' - V - G at every sample.

One Savitzky-Golay filter for all: angles, their first and second derivatives, and pressures. The noise v of
the speed q' is in x' = J q' and takes off B what it adds to the denominator; in a it is with df/dq':

    B = (sum x' a - sd(v)^2 sum df/dq') / (sum x'^2 - sd(v)^2 sum J^2)        corrected

(Fuller 1987, Measurement Error Models, section 1.2). The noise of q'' is not correlated with v: one kernel
is even, the other odd. J = 1 for the swing, whose x' is its speed.

Damping of one joint from its recordings: the solution, its doubts, and what the figure needs.

Figure 9: resistance over speed with the line, its residual, and B over the length of the filter.

What the reader of a damping must know, in sentences.

Viscous damping of swing gear and pistons (section 4(d), eq. (13), Fig. 9).

    x' B = a        a = tau - M q'' - V - G        x' = q' of the swing, J q' of a piston

with tau of measured pressures and M, V, G of the manipulator, the viscous friction of the joints as known.
Both sides are filtered alike and the acceleration is moved onto the filter (`balance.modulation`), so that
B is least squares of impulses and momenta; the paper's estimator is shown beside it (`as_printed`).

Validity: viscous friction, everything else known. What is not, B takes in, as the paper says: the remarks
tell how much, and whether dry friction can be seen.

Damping, section 4(d), eq. (13), Fig. 9: `procedure`, one `joint` at a time, (13) `as_printed`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import statsmodels.api as sm
from numpy.typing import NDArray

from fmus.identification.known import Curve, Estimate, Finding, Panel
from fmus.identification.procedures import momentum_balance
from fmus.identification.procedures.known_values import filled, noise_of, tank_pressure, training
from fmus.identification.procedures.momentum_balance import (
    ALL_PRESSURES,
    ANGLES,
    JOINTS,
    ORDER,
    PARAMETERS,
    PRESSURES,
    Samples,
    motion,
    numbers,
    samples,
)
from fmus.identification.procedures.momentum_balance import SIGNALS as MACHINE
from fmus.identification.procedures.momentum_fit import Doubt, Solution, doubt, solve
from fmus.identification.procedures.regression import WIDTH, symmetrical
from fmus.identification.recordings.clock import uniform_rate
from fmus.identification.recordings.derivatives import SavitzkyGolay
from fmus.identification.recordings.masks import good_all
from fmus.identification.recordings.reading import require
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

Array = NDArray[np.float64]
SIZES = (ORDER + 1, 9, 21)  # samples of the derivative filter to compare


@dataclass(frozen=True)
class Plain:
    """B by (13) with a filter of `window` [s], as it is and with the noise of the speed taken off."""

    window: float
    value: float
    corrected: float


def levers(joint: str, q: Array, p: Array) -> Array:
    """x' over the joint's speed at angles q (3, n): 1 or the moment arm of the cylinder [m], shape (n,)."""
    if joint == "swing":
        return np.ones(q.shape[1])
    arms: Array = np.array(motion(()).pistons(q, p)[1].full())
    return np.array(arms[JOINTS.index(joint) - 1])


def least_squares(recordings: Sequence[Recording], joint: str, theta: str, p: Array) -> list[Plain]:
    """(13) over all recordings, for filters from the shortest to a long one; theta is the damping."""
    at, step = p.copy(), 1 / uniform_rate(recordings[0])
    at[PARAMETERS.index(theta)] = 0.0
    return [_solved(size * step, [_sums(r, joint, at, size) for r in recordings]) for size in SIZES]


def _solved(window: float, sums: Sequence[Array]) -> Plain:
    product, square, of_product, of_square = np.sum(sums, axis=0)
    return Plain(window, product / square, (product - of_product) / (square - of_square))


def _sums(recording: Recording, joint: str, p: Array, size: int) -> Array:
    """Sums of x' a and x'^2, and what the noise adds to them in the mean."""
    row, rate = JOINTS.index(joint), uniform_rate(recording)
    kernel = SavitzkyGolay(rate, (size - 1) / rate, ORDER)
    there = momentum_balance.spread(~good_all(recording, (*ANGLES, *PRESSURES[joint])), size)
    value, slope, curve = (weights[::-1] for weights in kernel.weights)
    raw = np.array([filled(recording[n]) for n in ANGLES])
    q, w, bend = (momentum_balance.apply(k, raw)[:, there] for k in (value, slope, curve))
    zero, needed = np.zeros(recording.time.size), PRESSURES[joint]
    measured = [filled(recording[n]) if n in needed else zero for n in ALL_PRESSURES]
    pressures = momentum_balance.apply(value, np.array(measured))[:, there]
    f, tank = motion(()), tank_pressure(recording)
    error, by_speed, arm = (x.full()[row] for x in f.printed(q, w, bend, pressures, tank, p))
    v = kernel.gain(1) * noise_of(recording, ANGLES[row])
    product, square = w[row] @ error, np.sum((arm * w[row]) ** 2)
    return np.array([product, square, v**2 * by_speed.sum(), v**2 * np.sum(arm**2)])


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
        raise Problem(f"{where}: the {contact.joint} stands, expected it to move: no damping to see")
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
        filtered = momentum_balance.apply(s.filters.bump, np.array([arm * against, arm]))[:, s.good]
        y.append(e.error[0][s.good])
        columns.append(np.column_stack([-e.slope[0, 0][s.good], *filtered]))
    matrix = np.concatenate(columns)
    scale = np.linalg.norm(matrix, axis=0)
    lags = {"maxlags": 8 * records[0].filters.loss // records[0].filters.every}
    fit = sm.OLS(np.concatenate(y), matrix / scale).fit(cov_type="HAC", cov_kwds=lags)
    left = solution.values[0] + fit.params[0] / scale[0]
    return float(fit.params[1] / scale[1]), float(fit.bse[1] / scale[1]), float(left)


CLOUD = 1500  # points that are drawn


def panels(found: Sequence[JointDamping]) -> tuple[Panel, ...]:
    """Three for each joint."""
    return tuple(panel for one in found for panel in (*_line(one), _filters(one)))


def _line(one: JointDamping) -> tuple[Panel, Panel]:
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
    residual = (Curve("a - B x'", x, a - one.value * x),)
    return line, replace(line, y_label="residual", curves=residual, title="")


def _filters(one: JointDamping) -> Panel:
    x = np.array([plain.window for plain in one.plain])
    ends = np.array([x[0], x[-1]])
    curves = (
        Curve("(13), a at every sample", x, np.array([p.value for p in one.plain]), "compared", line=True),
        Curve("(13), noise taken off", x, np.array([p.corrected for p in one.plain]), "corrected", line=True),
        Curve("this estimate", ends, np.full(2, one.value), "fit", True, np.full(2, WIDTH * one.sd)),
    )
    return Panel(
        x_label=f"length of the {one.contact.joint}'s derivative filter",
        y_label="B",
        curves=curves,
        x_unit=("s", 1.0),
        y_unit=(one.contact.unit, 1.0),
    )


LITTLE = 0.1  # of a standard deviation: what is smaller is not told
SEEN = 4.0  # standard deviations from which on a dry friction is said to be seen


def remarks(one: JointDamping) -> list[str]:
    """For one joint; each begins with the parameter."""
    texts = [
        _used(one),
        *(f"in {name} the joint stands, so it is left out." for name in one.standing),
        _doubt(one),
        *_attenuated(one),
        _printed(one),
        *one.doubt.remarks(one.value, one.contact.unit),
        *_dry_remark(one),
    ]
    return [f"{one.contact.parameter}: {text}" for text in texts]


def _used(one: JointDamping) -> str:
    samples = sum(s.good.size for s in one.records)
    share = 100 * (1 - len(one.speed) / samples)
    seconds = len(one.speed) * one.records[0].filters.step
    text = f"{seconds:.3g} s of {len(one.records)} recordings are used"
    if not share:
        return f"{text}, nothing is left out."
    ends = sum(s.touched for s in one.records)
    stops = f"; in {ends} samples a piston was at an end of its stroke" if ends else ""
    return f"{text}, {share:.2g} % is left out because of clipped or missing samples nearby{stops}."


def _doubt(one: JointDamping) -> str:
    noise, residual = (math.sqrt(max(c[0, 0], 0.0)) for c in (one.solution.noise, one.solution.residual))
    text = (
        f"the noise of the sensors gives a standard deviation of {noise:.3g} {one.contact.unit}, the "
        f"residuals one of {residual:.3g}."
    )
    if one.solution.lacks:
        return f"{text} Noise does not explain them: the model lacks something, and the interval covers it."
    return f"{text} Noise explains them, and the interval is that of the noise."


def _attenuated(one: JointDamping) -> list[str]:
    """The bias by errors in variables, where it is not lost in the interval."""
    bias = float(one.solution.mean_effect[0])
    if abs(bias) < LITTLE * one.sd:
        return []
    return [
        f"the encoders' noise in the speed moves this estimate by {100 * bias / one.value:+.2g} %, which is "
        "taken off."
    ]


def _printed(one: JointDamping) -> str:
    first = one.plain[0]
    share = 100 * (first.value / first.corrected - 1)
    return (
        f"(13) as printed, with a derivative over {first.window * 1e3:.3g} ms, gives {first.value:.4g} "
        f"{one.contact.unit}; the encoders' noise makes {share:+.2g} % of it, without which it "
        f"is {first.corrected:.4g}."
    )


def _dry_remark(one: JointDamping) -> list[str]:
    dry, sd, left = one.dry
    if not np.isfinite(sd) or abs(dry) < SEEN * sd:
        return []
    if dry < 0:
        return [
            "resistance grows more than in proportion to the speed: dry friction beside B would be negative, "
            "which is no law of friction. Something else moves the residual, such as a number that is taken "
            "as known."
        ]
    return [
        f"the residual has the sign of the speed. A dry friction of {dry:.3g} +- {sd:.2g} "
        f"{one.contact.resistance_unit} beside a damping of {left:.4g} {one.contact.unit} fits better; the "
        "viscous law takes it into B, at the speeds of these recordings."
    ]


SIGNALS: Mapping[str, str] = MACHINE  # of the pressures those of the joint that moves


def identify(recordings: Sequence[Recording], known: Mapping[str, Number]) -> Finding:
    """B of each joint of which there are recordings."""
    own = training(recordings, "damping", dict.fromkeys(ANGLES, "rad"))
    for r in own:
        if r.word("joint") not in CONTACTS:
            raise Problem(
                f"{r.source}: [experiment] joint is {r.word('joint')!r}, expected {', '.join(CONTACTS)}"
            )
        require(r, dict.fromkeys(PRESSURES[r.word("joint")], "Pa"))
    parts = {joint: [r for r in own if r.word("joint") == joint] for joint in CONTACTS}
    found = [joint_damping(CONTACTS[joint], part, known) for joint, part in parts.items() if part]
    return Finding(
        procedure="damping",
        title="Viscous damping of the joints: resistance over speed",
        figure=9,
        estimates=tuple(_estimate(one) for one in found if one.value > 0),
        panels=panels(found),
        remarks=tuple(text for one in found for text in (*_refused(one), *remarks(one))),
        others=tuple(estimate for one in found for estimate in _others(one)),
    )


def _estimate(one: JointDamping) -> Estimate:
    note = "eq. (13) by impulses and momenta" + one.doubt.note()
    return _positive(symmetrical(one.contact.parameter, one.value, one.contact.unit, one.doubt.total, note))


def _positive(e: Estimate) -> Estimate:
    """The interval of a quantity that cannot be negative."""
    return Estimate(e.name, e.value, e.unit, e.sd, max(e.low, 0.0), e.high, e.note)


def _refused(one: JointDamping) -> list[str]:
    if one.value > 0:
        return []
    return [
        f"{one.contact.parameter}: {one.value:.3g} {one.contact.unit} is no damping, so it is not handed on: "
        "something that is taken as known is wrong."
    ]


def _others(one: JointDamping) -> list[Estimate]:
    """A dry friction, and B by these recordings alone where that is another interval."""
    name, unit = one.contact.parameter, one.contact.unit
    dry, sd, _ = one.dry
    found = []
    if one.doubt.matters:
        label = f"{name}, the rest known exactly"
        found.append(symmetrical(label, one.value, unit, one.sd, "by the recordings alone"))
    if dry > 0:  # one that pushes is no friction: a remark tells of it where it is clear
        label = f"dry friction beside {name}"
        force = one.contact.resistance_unit
        found.append(symmetrical(label, dry, force, sd, "as one more unknown of (13)"))
    return found


__all__ = ["SIGNALS", "identify"]
