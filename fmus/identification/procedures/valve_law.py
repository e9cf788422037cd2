"""The opening law of the valve, fitted to the steps of its test; the paper's polynomial for comparison.

Flow through one metering edge as a function of command and pressure drop, with exact derivatives:

    (Q - L) sqrt(Q^2 + Q_t^2) = K^2 dp        L = G dp - G (dp_s - dp)
    K = C_d a(V) A sqrt(2/rho)                C_R = 1/K^2, eqs. (1), (2)

with the leakage G of the open edge, less that of the closed edge of the same port, which has the rest of the
drop dp_s from supply to tank. The opening a(V) and the inverse of the turbulent law are those of
`fmus.components.spool_valve`, so what is fitted is what the machine simulates. a(V) rises with V for any
positive area: the fitted C_R is positive and falls with the command, whatever the data.

Validity: the leakage is a small part of the flow (below a tenth).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from functools import cache

import casadi as ca
import numpy as np
import statsmodels.api as sm
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy import stats

from fmus.components import spool_valve
from fmus.identification.procedures.bench_data import (
    SETTLE,
    SHORTEST,
    filled,
    joined,
    left_out,
    step_means,
    value,
    where,
)
from fmus.identification.procedures.regression import UNLIKELY, Guess, Regression, fit
from fmus.identification.recordings.masks import steady
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

OPENS = {"P-A": 1, "B-T": 1, "P-B": -1, "A-T": -1}  # sign of the command, correction E7 in docs/equations.md
STEP_VOLTAGES = 3  # that must be measured
SURE = 5.0  # standard errors from which on the sign of a mean is no chance


@dataclass(frozen=True)
class ValveSteps:
    """One entry per step; arrays of shape (n,).

    command      magnitude [V]
    drop, flow   means [Pa], [m3/s] with their standard errors; both positive where the edge is open
    whole        drop from supply to tank [Pa]: the largest one over the edge, when it is nearly closed
    dead         the flow meter reads nothing useful
    clipped      an instrument is at an end of its range
    good         measured: neither dead nor clipped, samples there, flow along the drop
    edge         "P-A", ... of each
    """

    command: Array
    drop: Array
    drop_error: Array
    flow: Array
    flow_error: Array
    whole: Array
    dead: Mask
    clipped: Mask
    good: Mask
    edge: NDArray[np.str_]

    @property
    def edges(self) -> tuple[str, ...]:
        """The edges, in the order of the recordings."""
        return tuple(dict.fromkeys(map(str, self.edge)))

    def of(self, edge: str) -> ValveSteps:
        """The steps of one edge."""
        return where(self, self.edge == edge)

    @property
    def measured(self) -> ValveSteps:
        """The steps that are measured."""
        return where(self, self.good)

    def enough(self) -> ValveSteps:
        """The measured steps of each edge, which must be at three voltages or more."""
        for edge in self.edges:
            own = self.of(edge)
            voltages = np.unique(own.measured.command).size
            if voltages < STEP_VOLTAGES:
                lost = left_out(own.dead, own.clipped, own.good) or "none"
                raise Problem(
                    f"valve {edge}: flow is measured at {voltages} voltages, expected at least "
                    f"{STEP_VOLTAGES}; left out of {own.command.size} steps: {lost}"
                )
        return self.measured

    @property
    def resistance(self) -> Array:
        """C_R [Pa.s2/m6] of each step, eq. (1)."""
        return self.drop / (self.flow * np.abs(self.flow))

    @property
    def resistance_error(self) -> Array:
        """Standard error of C_R: of the drop, and twice that of the flow."""
        relative = np.hypot(self.drop_error / self.drop, 2 * self.flow_error / self.flow)
        return np.abs(self.resistance) * relative


def valve_steps(recordings: Sequence[Recording]) -> ValveSteps:
    """The steps of all edges; only those with a command that opens the edge."""
    return joined([_of_one(recording) for recording in recordings])


def _of_one(recording: Recording) -> ValveSteps:
    edge, commands = recording.text_condition("edge"), recording["command"]
    if edge not in OPENS:
        raise Problem(f"{recording.source}: [experiment] edge is {edge!r}, expected {', '.join(OPENS)}")
    if not (commands * OPENS[edge] > 0).any():
        expected = "positive" if OPENS[edge] > 0 else "negative"
        raise Problem(f"{recording.source}: expected {expected} commands, which open {edge}, found none")
    command = filled(commands)  # a command holds over a lost sample
    whole = replace(recording, signals={**recording.signals, "command": command})
    parts = [p for p in steady(whole, "command", SETTLE, SHORTEST) if command[p.start] * OPENS[edge] > 0]
    means = step_means(recording, parts)
    sign = np.where(means.drop < 0, -1.0, 1.0)
    along = sign * means.flow
    largest = (along + SURE * means.flow_error)[means.good]  # flow along the drop that noise allows
    against = int(np.count_nonzero(largest < 0))
    if against > largest.size / 2:
        raise Problem(
            f"{recording.source}: flow is against the drop pressure_in - pressure_out in {against} of "
            f"{largest.size} steps, expected along it: turn the sign of the flow or the order of the "
            "pressures"
        )
    return ValveSteps(
        command=np.abs([command[part].mean() for part in parts]),
        drop=sign * means.drop,
        drop_error=means.drop_error,
        flow=along,
        flow_error=means.flow_error,
        whole=np.full(len(parts), np.max(np.abs(means.drop), initial=0.0, where=np.isfinite(means.drop))),
        dead=means.dead,
        clipped=means.clipped,
        good=means.good & (along > 0),
        edge=np.full(len(parts), edge),
    )


@dataclass(frozen=True)
class Constants:
    """What is known of the valve and its oil."""

    discharge_coefficient: float
    full_command: float
    leakage: float
    transition_flow: float
    density: float

    @classmethod
    def of(cls, known: Mapping[str, Number]) -> Constants:
        """From the parameters of the machine; the three valves are identical (section 4(a))."""
        names = ("discharge_coefficient", "full_command", "leakage", "transition_flow")
        rest = {name: value(known, f"boom_stick.valve_{name}") for name in names}
        return cls(**rest, density=value(known, "boom_stick.density"))


@dataclass(frozen=True)
class Law:
    """What is fitted: area [m2] at full command, dead band [V] and rounding [V] of the opening."""

    area: float
    dead_band: float
    rounding: float


@cache
def _functions() -> tuple[ca.Function, ca.Function]:
    names = "command drop whole area dead_band rounding c_d full leakage transition density"
    given = [ca.SX.sym(name) for name in names.split()]
    command, drop, whole, area, dead_band, rounding, c_d, full, leakage, transition, density = given
    share = spool_valve.opening(command, dead_band, full, rounding)
    square = (spool_valve.flow_gain(area, c_d, density) * share) ** 2
    y = square * drop
    leak = leakage * (2 * drop - whole)
    # (Q - leak) sqrt(Q^2 + Q_t^2) = y: one Newton step, which leaves leak^3/Q^2
    near = y * spool_valve.turbulent_factor(y, transition) + leak / 2
    speed = ca.sqrt(near**2 + transition**2)
    flow = near - ((near - leak) * speed - y) / (speed + (near - leak) * near / speed)
    slope = ca.gradient(flow, drop)
    return ca.Function("flow", given, [flow, slope]), ca.Function("square_gain", given, [square])


def flow(command: Array, drop: Array, whole: Array, law: Law, constants: Constants) -> tuple[Array, Array]:
    """Flow [m3/s] out of the port and its derivative by the drop [m3/(s.Pa)].

    command      > 0 [V]
    drop, whole  over the edge, and from supply to tank [Pa]
    """
    rows = (array[None, :] for array in (command, drop, whole))
    result = _functions()[0](*rows, *astuple(law), *astuple(constants))
    return result[0].full()[0], result[1].full()[0]


def resistance(command: Array, law: Law, constants: Constants) -> Array:
    """C_R [Pa.s2/m6] at commands [V] by eq. (2); infinite where the edge is closed."""
    square: Array = _functions()[1](command[None, :], 0.0, 0.0, *astuple(law), *astuple(constants)).full()[0]
    return np.divide(1.0, square, out=np.full_like(square, np.inf), where=square > 0)


DETERMINED = 0.25  # largest relative standard deviation of a rounding that the data determine
ROUNDINGS = (1e-3, 2.0)  # V, within which it is searched
# of the mean drop: standard deviation of what two transducers may differ by, 0.25 % of their range each
ZERO = 0.007


@dataclass(frozen=True)
class ValveFit:
    """A fit of `steps`; `rounded` if the data determine the rounding of the foot."""

    steps: ValveSteps
    regression: Regression
    constants: Constants
    rounding: float
    rounded: bool = False

    def law(self, values: Mapping[str, float] | None = None) -> Law:
        """The law of these values, by default of the fitted ones."""
        v = self.regression.as_dict() if values is None else values
        return Law(v["area"], v["dead_band"], v.get("rounding", self.rounding))


def fit_valve(steps: ValveSteps, constants: Constants, rounding: Number) -> ValveFit:
    """Weighted fit of the flow; the rounding is fitted only if the data determine it, else taken as known.

    Where no step falls on the rounded foot, dead band and rounding w show in the sum V_db + w/2 alone. What
    the pressures differ by without flow is estimated along, as "zero" [Pa].
    """
    fixed = ValveFit(steps, _fit(steps, constants, rounding, zero=True), constants, rounding.value)
    law = fixed.law()
    if np.count_nonzero(steps.command < law.dead_band + law.rounding) < 2:
        return fixed
    free = _fit(steps, constants, rounding, zero=True, free=True)
    low, high = ROUNDINGS
    if free.sd("rounding") > DETERMINED * free["rounding"] or not 1.01 * low < free["rounding"] < 0.99 * high:
        return fixed
    return replace(fixed, regression=free, rounded=True)


def _fit(
    steps: ValveSteps, constants: Constants, rounding: Number, *, zero: bool, free: bool = False
) -> Regression:
    """The fit with a rounding that is free, or held by its standard deviation [V], or fixed."""
    # the guess is the straight line of K = Q/sqrt(dp) over the command
    line, offset = np.polyfit(steps.command, steps.flow / np.sqrt(steps.drop), 1)
    foot = float(np.clip(-offset / line, 0.0, steps.command.min()))
    gain = line * (constants.full_command - foot)
    area = gain / (constants.discharge_coefficient * np.sqrt(2 / constants.density))
    start = {
        "area": Guess(float(area), low=0.0),
        "dead_band": Guess(max(foot - rounding.value / 2, 0.05), scale=1.0),
    }
    held: dict[str, tuple[float, float]] = {}
    if free or rounding.sd:
        start["rounding"] = Guess(rounding.value, low=ROUNDINGS[0], high=ROUNDINGS[1])
    if rounding.sd and not free:
        held["rounding"] = (rounding.value, rounding.sd)
    if zero:
        sd = ZERO * float(steps.drop.mean())
        start["zero"], held["zero"] = Guess(0.0, scale=sd), (0.0, sd)

    def residual(v: Mapping[str, float]) -> Array:
        law = Law(v["area"], v["dead_band"], v.get("rounding", rounding.value))
        modelled, slope = flow(steps.command, steps.drop - v.get("zero", 0.0), steps.whole, law, constants)
        weighted: Array = (steps.flow - modelled) / np.hypot(steps.flow_error, slope * steps.drop_error)
        return np.append(weighted, [(v[n] - value) / sd for n, (value, sd) in held.items()])

    return fit(residual, start, f"valve ({', '.join(steps.edges)})")


def asymmetry(steps: ValveSteps, constants: Constants, rounding: Number) -> tuple[float, dict[str, float]]:
    """Probability of the edges' differences if they are equal, and the area [m2] of each.

    Chi-square of the common fit less those of each edge, without a zero of the pressures: all edges have the
    same, and it would take a difference of theirs for its own.
    """
    common = _fit(steps, constants, rounding, zero=False)
    own = {edge: _fit(steps.of(edge), constants, rounding, zero=False) for edge in steps.edges}
    alone = sum(one.chi_square for one in own.values())
    freedom = sum(one.freedom for one in own.values())
    scale = alone / freedom if stats.chi2.sf(alone, freedom) < UNLIKELY else 1.0
    gained = (common.chi_square - alone) / scale
    areas = {edge: one["area"] for edge, one in own.items()}
    return (float(stats.chi2.sf(gained, common.freedom - freedom)) if len(own) > 1 else 1.0), areas


def polynomial(x: Array, y: Array) -> Polynomial:
    """The paper's C_R(V): plain least squares; the degree, up to 8, has the lowest AIC."""
    domain = (float(x.min()), float(x.max()))
    scaled = (2 * x - sum(domain)) / (domain[1] - domain[0])
    top = min(8, np.unique(x).size - 2)
    fits = [sm.OLS(y, np.vander(scaled, n + 1, increasing=True)).fit() for n in range(1, max(top, 1) + 1)]
    return Polynomial(min(fits, key=lambda fit: fit.aic).params, domain=domain, window=(-1.0, 1.0))


def impossible(curve: Polynomial, x: Array) -> Mask:
    """Where a polynomial cannot be a resistance over the command: negative, or rising."""
    mask: Mask = (curve(x) < 0) | (curve.deriv()(x) > 0)
    return mask
