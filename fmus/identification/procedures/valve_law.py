"""Opening law of the valve and its fit to the steps of an experiment; the paper's polynomial for comparison.

Flow through one metering edge as a function of command and pressure drop, with exact derivatives:

    (Q - L) sqrt(Q^2 + Q_t^2) = K^2 dp        L = G dp - G (dp_s - dp)
    K = C_d a(V) A sqrt(2/rho)                C_R = 1/K^2, eqs. (1), (2)

L is the leakage (coefficient G) of the open edge minus that of the closed edge at the same port. The closed
edge has the rest of the pressure drop dp_s from supply to tank. The opening a(V) and the inverse of the
turbulent law are those of `fmus.components.spool_valve`, so the fitted law is the one that the machine
simulates. Since a(V) rises with V, the fitted C_R is positive and falls with the command for any data.

Validity: the leakage is a small part of the flow (below a tenth).
"""

from __future__ import annotations

import math
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
from fmus.identification.procedures.experiment_data import (
    SETTLING_TIME,
    SHORTEST_STEP,
    StepMeans,
    concatenate,
    condition,
    interpolated,
    parameter_value,
    select,
    step_means,
)
from fmus.identification.procedures.regression import UNLIKELY, Guess, Regression, fit
from fmus.identification.recordings.masks import steady
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Mask, Recording
from orchestrator.data.table import Array

# sign of the command that opens each edge, correction E7 in docs/equations.md
COMMAND_SIGN = {"P-A": 1, "B-T": 1, "P-B": -1, "A-T": -1}
MIN_VOLTAGES = 3  # different commands at which the flow must be measured
CERTAIN = 5.0  # standard errors above which the sign of a mean is certain


@dataclass(frozen=True)
class ValveSteps(StepMeans):
    """Means over the steps of one or several edges; drop and flow are positive if the edge is open.

    command       magnitude [V]
    supply_drop   pressure drop from supply to tank [Pa]: the largest drop over an edge, nearly closed
    edge          "P-A", "P-B", "A-T" or "B-T"
    """

    command: Array
    supply_drop: Array
    edge: NDArray[np.str_]

    @property
    def edges(self) -> tuple[str, ...]:
        """The edges, in the order of the recordings."""
        return tuple(dict.fromkeys(map(str, self.edge)))

    def of(self, edge: str) -> ValveSteps:
        """The steps of one edge."""
        return select(self, self.edge == edge)

    def checked(self) -> ValveSteps:
        """The measured steps; each edge must be measured at three voltages or more."""
        for edge in self.edges:
            steps = self.of(edge)
            voltages = np.unique(steps.measured().command).size
            if voltages < MIN_VOLTAGES:
                raise Problem(
                    f"valve {edge}: expected flow at {MIN_VOLTAGES} voltages or more, got {voltages}; left "
                    f"out of {steps.command.size} steps: {steps.omissions() or 'none'}"
                )
        return self.measured()


def valve_steps(recordings: Sequence[Recording]) -> ValveSteps:
    """The steps of all recordings; only those with a command that opens the edge."""
    return concatenate([_steps_of(recording) for recording in recordings])


def _steps_of(recording: Recording) -> ValveSteps:
    edge, samples = condition(recording, "edge", COMMAND_SIGN), recording["command"]
    opening = COMMAND_SIGN[edge]
    if not (samples * opening > 0).any():
        expected = "positive" if opening > 0 else "negative"
        raise Problem(f"{recording.source}: command: expected {expected} values, which open {edge}, got none")
    command = interpolated(samples)  # a missing sample does not end a step
    gapless = replace(recording, signals={**recording.signals, "command": command})
    stretches = steady(gapless, "command", SETTLING_TIME, SHORTEST_STEP)
    steps = [step for step in stretches if command[step.start] * opening > 0]
    means = step_means(recording, steps)
    sign = np.where(means.drop < 0, -1.0, 1.0)
    flow = sign * means.flow
    highest = (flow + CERTAIN * means.flow_error)[means.good]  # flow along the drop that noise allows
    reversed_steps = int(np.count_nonzero(highest < 0))
    if reversed_steps > highest.size / 2:
        raise Problem(
            f"{recording.source}: flow: expected a flow from the higher to the lower pressure, got the "
            f"opposite direction in {reversed_steps} of {highest.size} steps: change the sign of the flow, "
            "or exchange pressure_in and pressure_out"
        )
    supply_drop = np.max(np.abs(means.drop), initial=0.0, where=np.isfinite(means.drop))
    return ValveSteps(
        **{**vars(means), "drop": sign * means.drop, "flow": flow, "good": means.good & (flow > 0)},
        command=np.abs([command[step].mean() for step in steps]),
        supply_drop=np.full(len(steps), supply_drop),
        edge=np.full(len(steps), edge),
    )


@dataclass(frozen=True)
class ValveConstants:
    """Known parameters of the valve and its oil."""

    discharge_coefficient: float
    full_command: float
    leakage: float
    transition_flow: float
    density: float

    @classmethod
    def of(cls, parameters: Mapping[str, Number]) -> ValveConstants:
        """From the parameters of the machine, whose three valves are identical (section 4(a))."""
        names = ("discharge_coefficient", "full_command", "leakage", "transition_flow")
        valve = {name: parameter_value(parameters, f"boom_stick.valve_{name}") for name in names}
        return cls(**valve, density=parameter_value(parameters, "boom_stick.density"))


@dataclass(frozen=True)
class OpeningLaw:
    """Fitted parameters: area [m2] at full command, dead band [V] and rounding [V] of the opening."""

    area: float
    dead_band: float
    rounding: float


@cache
def _functions() -> tuple[ca.Function, ca.Function]:
    names = "command drop supply_drop area dead_band rounding c_d full leakage transition density"
    arguments = [ca.SX.sym(name) for name in names.split()]
    command, drop, supply_drop, area, dead_band, rounding, c_d, full, leakage, transition, density = arguments
    opening = spool_valve.opening(command, dead_band, full, rounding)
    square_gain = (spool_valve.flow_gain(area, c_d, density) * opening) ** 2
    y = square_gain * drop
    leak = leakage * (2 * drop - supply_drop)
    # (Q - leak) sqrt(Q^2 + Q_t^2) = y: one Newton step from q, with an error of leak^3/Q^2
    q = y * spool_valve.turbulent_factor(y, transition) + leak / 2
    rounded = ca.sqrt(q**2 + transition**2)
    flow = q - ((q - leak) * rounded - y) / (rounded + (q - leak) * q / rounded)
    outputs = [flow, ca.gradient(flow, drop)]
    return ca.Function("flow", arguments, outputs), ca.Function("square_gain", arguments, [square_gain])


def flow(
    command: Array, drop: Array, supply_drop: Array, law: OpeningLaw, constants: ValveConstants
) -> tuple[Array, Array]:
    """Flow [m3/s] out of the port and its derivative with respect to the drop [m3/(s.Pa)].

    command       > 0 [V]
    drop          pressure drop over the edge [Pa]
    supply_drop   pressure drop from supply to tank [Pa]
    """
    rows = (array[None, :] for array in (command, drop, supply_drop))
    result = _functions()[0](*rows, *astuple(law), *astuple(constants))
    return result[0].full()[0], result[1].full()[0]


def flow_through(
    area: Array, drop: Array, supply_drop: Array, constants: ValveConstants
) -> tuple[Array, Array]:
    """Flow [m3/s] through effective areas [m2] and its derivative with respect to the drop, as `flow`."""
    opened = OpeningLaw(area[None, :], 0.0, ROUNDING_BOUNDS[0])  # type: ignore[arg-type]
    rows = (array[None, :] for array in (np.full_like(area, constants.full_command), drop, supply_drop))
    result = _functions()[0](*rows, *vars(opened).values(), *astuple(constants))
    return result[0].full()[0], result[1].full()[0]


def resistance_of(area: Array, constants: ValveConstants) -> Array:
    """C_R [Pa.s2/m6] of effective areas [m2] by eq. (2); infinite if the edge is closed."""
    square = 2 * (constants.discharge_coefficient * area) ** 2 / constants.density
    return np.divide(1.0, square, out=np.full_like(square, np.inf), where=square > 0)


def resistance(command: Array, law: OpeningLaw, constants: ValveConstants) -> Array:
    """C_R [Pa.s2/m6] at commands [V] by eq. (2); infinite if the edge is closed."""
    square: Array = _functions()[1](command[None, :], 0.0, 0.0, *astuple(law), *astuple(constants)).full()[0]
    return np.divide(1.0, square, out=np.full_like(square, np.inf), where=square > 0)


ROUNDING_BOUNDS = (1e-3, 2.0)  # V, of the fitted rounding
FREE = 1e3  # times the limit of a zero: no prior


@dataclass(frozen=True)
class ValveFit:
    """The opening law fitted to `steps`.

    zero_limit          largest difference of the pressures without flow [Pa], by their data sheets
    free_zero           the fit with any difference of the pressures without flow
    rounding            the known rounding [V]
    rounding_estimated  whether the data determine the rounding, so that it is among the fitted parameters
    """

    steps: ValveSteps
    regression: Regression
    constants: ValveConstants
    rounding: float
    zero_limit: float
    free_zero: Regression
    rounding_estimated: bool = False

    def zero_probability(self) -> float | None:
        """Probability of data that want a zero so far outside its limit, if it is not; None without a test.

        There is none if a straight line does not explain the data with any zero.
        """
        if self.free_zero.misfit:
            return None
        beyond = abs(self.free_zero["zero"]) - self.zero_limit
        return 2 * float(stats.norm.sf(beyond / self.free_zero.sd("zero"))) if beyond > 0 else 1.0

    def law(self, values: Mapping[str, float] | None = None) -> OpeningLaw:
        """The opening law with these parameter values, by default the fitted ones."""
        v = self.regression.as_dict() if values is None else values
        return OpeningLaw(v["area"], v["dead_band"], v.get("rounding", self.rounding))


def fit_valve(steps: ValveSteps, constants: ValveConstants, rounding: Number, zero_limit: float) -> ValveFit:
    """Weighted least squares of the flow; the rounding is fitted only if the data determine it.

    If no step is on the rounded foot of the opening, the data determine only the sum V_db + w/2 of dead band
    and half the rounding w. The difference of the pressures without flow, "zero" [Pa], is always estimated,
    with the limit `zero_limit` [Pa] of the transducers' data sheets as prior.
    """
    regression, free_zero = _fit_within(steps, constants, rounding, zero_limit)
    known_rounding = ValveFit(steps, regression, constants, rounding.value, zero_limit, free_zero)
    law = known_rounding.law()
    if np.count_nonzero(steps.command < law.dead_band + law.rounding) < 2:
        return known_rounding
    free, free_zero = _fit_within(steps, constants, rounding, zero_limit, free=True)
    low, high = ROUNDING_BOUNDS
    if not free.determined("rounding") or not 1.01 * low < free["rounding"] < 0.99 * high:
        return known_rounding
    return replace(known_rounding, regression=free, free_zero=free_zero, rounding_estimated=True)


def _fit_within(
    steps: ValveSteps, constants: ValveConstants, rounding: Number, limit: float, *, free: bool = False
) -> tuple[Regression, Regression]:
    """The fit with the data sheets' limit [Pa] as prior of the zero, and the fit with any zero.

    The prior is as wide as a uniform distribution up to the limit, so that its interval holds the limit.
    """
    free_zero = _fit(steps, constants, rounding, zero_sd=FREE * limit, free=free)
    return _fit(steps, constants, rounding, zero_sd=limit / math.sqrt(3), free=free), free_zero


def _fit(
    steps: ValveSteps,
    constants: ValveConstants,
    rounding: Number,
    *,
    zero_sd: float = 0.0,
    free: bool = False,
) -> Regression:
    """The fit with a rounding that is free, or has the prior of its standard deviation [V], or is fixed.

    zero_sd   standard deviation [Pa] of the prior of the pressures' difference without flow; 0: it is zero
    """
    # the guess is the straight line of K = Q/sqrt(dp) over the command
    slope, intercept = np.polyfit(steps.command, steps.flow / np.sqrt(steps.drop), 1)
    foot = float(np.clip(-intercept / slope, 0.0, steps.command.min()))
    gain = slope * (constants.full_command - foot)
    area = gain / (constants.discharge_coefficient * np.sqrt(2 / constants.density))
    start = {
        "area": Guess(float(area), low=0.0),
        "dead_band": Guess(max(foot - rounding.value / 2, 0.05), magnitude=1.0),
    }
    priors: dict[str, tuple[float, float]] = {}
    if free or rounding.sd:
        start["rounding"] = Guess(rounding.value, low=ROUNDING_BOUNDS[0], high=ROUNDING_BOUNDS[1])
    if rounding.sd and not free:
        priors["rounding"] = (rounding.value, rounding.sd)
    if zero_sd:
        start["zero"], priors["zero"] = Guess(0.0, magnitude=zero_sd), (0.0, zero_sd)

    def residual(v: Mapping[str, float]) -> Array:
        law = OpeningLaw(v["area"], v["dead_band"], v.get("rounding", rounding.value))
        drop = steps.drop - v.get("zero", 0.0)
        fitted, derivative = flow(steps.command, drop, steps.supply_drop, law, constants)
        weighted: Array = (steps.flow - fitted) / np.hypot(steps.flow_error, derivative * steps.drop_error)
        return np.append(weighted, [(v[name] - mean) / sd for name, (mean, sd) in priors.items()])

    return fit(residual, start, f"valve ({', '.join(steps.edges)})")


def asymmetry(
    steps: ValveSteps, constants: ValveConstants, rounding: Number
) -> tuple[float, dict[str, float]]:
    """Probability that equal edges differ as much as these, and the area [m2] of each edge.

    Likelihood ratio test of one common fit against a fit of each edge. The difference of the pressures
    without flow is not estimated: all edges have the same one, and each fit would take up a part of the
    difference between the edges with it.
    """
    common = _fit(steps, constants, rounding)
    fits = {edge: _fit(steps.of(edge), constants, rounding) for edge in steps.edges}
    separate = sum(fitted.chi_square for fitted in fits.values())
    freedom = sum(fitted.freedom for fitted in fits.values())
    scale = separate / freedom if stats.chi2.sf(separate, freedom) < UNLIKELY else 1.0
    ratio = (common.chi_square - separate) / scale
    areas = {edge: fitted["area"] for edge, fitted in fits.items()}
    return (float(stats.chi2.sf(ratio, common.freedom - freedom)) if len(fits) > 1 else 1.0), areas


def polynomial(x: Array, y: Array) -> Polynomial:
    """The paper's C_R(V) by unweighted least squares; the degree, up to 8, is that of the lowest AIC."""
    domain = (float(x.min()), float(x.max()))
    scaled = (2 * x - sum(domain)) / (domain[1] - domain[0])
    highest = min(8, np.unique(x).size - 2)
    fits = [sm.OLS(y, np.vander(scaled, n + 1, increasing=True)).fit() for n in range(1, max(highest, 1) + 1)]
    return Polynomial(min(fits, key=lambda fit: fit.aic).params, domain=domain, window=(-1.0, 1.0))


def impossible(curve: Polynomial, x: Array) -> Mask:
    """True if a polynomial cannot be the resistance of a valve at x: it is negative, or it rises."""
    mask: Mask = (curve(x) < 0) | (curve.deriv()(x) > 0)
    return mask
