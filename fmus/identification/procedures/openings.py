"""Opening of metering edges over the command from steady steps: straight line or curve, with its 95 % band.

Each step gives the effective area of the edge from its flow and pressure drop,

    a = sqrt((Q - L) (|Q| + Q_t) / dp) / (C_d sqrt(2/rho))        L = G dp - G (dp_s - dp)

Q_t is that of `orifice.Edge` at a, below 0.1 L/min. L is the leakage (coefficient G) of the open edge minus
that of the closed edge at the same port, which has the rest of the pressure drop dp_s from supply to tank.
Means over steps with one command are the nodes of the opening. With the zeros z of the pressure drop and
z_q of the flow meter, and the noise e,

    a_i = A(V_i) + (da/ddp) z + (da/dQ) z_q + e_i

- Line: A(V) = k ramp(V - V_t + w/2, w), straight behind a foot of length w, as `components.spool_valve`.
- Curve: A(V_i) is free at each node. Between nodes it lies between their chord and the straight continuations
  of its neighbours, where a kink would be, or the monotone cubic.

The zeros have the data sheets' limits as priors: the standard deviation of a uniform distribution. Where no
flow was measured the opening is bounded by what any valve does. Below the lowest node it is a power
a_1 ((V - V_0) / (V_1 - V_0))^n with the slope of the opening there and an unknown exponent, not above what
a meter without reading allows. Above the highest node its slope is between zero and twice the last one.
The band is simultaneous: 95 of 100 curves that the data allow lie in it over their whole length [Besag et
al., Statistical Science 10 (1995) 3, section 6.3].

Validity: steady flow; the leakage is a small part of it (below a tenth).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats
from scipy.interpolate import PchipInterpolator
from scipy.optimize import isotonic_regression

from fmus.components.orifice import CLOSED
from fmus.identification.balance import UNLIKELY, Regression
from fmus.identification.procedures.experiment_data import StepMeans, parameter, parameter_value
from fmus.identification.results import CONFIDENCE, Estimate
from fmus.parameters import Number
from orchestrator.data.recording import Mask
from orchestrator.data.table import Array

SAME = 2e-3  # of the full command: steps that are closer have one command
DRAWS = 2000  # curves: the 2.5 % quantile of one has an error of a tenth of a standard deviation
POINTS, GRID = 10, 96  # of a table; commands at which curves are drawn, besides the measured ones
FOOT = (0.8, 3.5)  # exponents of a curve below its lowest node: a notch begins with 1 to 2, a rounding with 3
# of a straight line: 1 for a sharp start, 2 for a rounding that ends at the lowest node
SHORT_FOOT = (0.9, 2.1)
CURVED = 1.3  # times the change of slope to the lowest node by which a parabola through three is bent
UNDERLAP = 1.2  # largest exponent of an edge that is open at zero command
ROUNDING = (1e-3, 2.0)  # V, of the fitted rounding
CERTAIN = 4.0  # standard errors above which a flow is certain
ZEROS = 21  # zeros with which a falling opening is tested
LARGEST = 10.0  # limits of a zero up to which it may be a fault of a sensor
UNTOLD = 2.0  # limits of a zero above which its standard deviation tells nothing
CLOSE = 0.1  # half bands: errors of a table below it do not count
SEARCH: Mapping[str, Any] = {"method": "dogbox", "ftol": 1e-12, "xtol": 1e-12, "gtol": 1e-12}  # of a line


@dataclass(frozen=True)
class Known:
    """Parameters of the valve and its oil, and what is known of the sensors, before the valve is measured.

    rounding     of the foot of a straight line [V]; its sd may be unknown
    zero         largest difference of the two pressures without flow [Pa], by their data sheets
    flow_zero    standard deviation of the flow meter's zero [m3/s]; 0 if nothing is declared or found
    drift        largest part by which areas may differ from those that were measured
    """

    discharge_coefficient: float
    full_command: float
    leakage: float
    transition_reynolds: float
    density: float
    viscosity: float
    rounding: Number
    zero: float = 0.0
    flow_zero: float = 0.0
    drift: float = 0.0

    @classmethod
    def of(cls, parameters: Mapping[str, Number]) -> Known:
        """From the parameters of the machine, whose three valves are identical (section 4(a))."""
        names = ("discharge_coefficient", "full_command", "leakage", "transition_reynolds")
        valve = {name: parameter_value(parameters, f"boom_stick.valve_{name}") for name in names}
        rounding = parameter(parameters, "boom_stick.valve_command_rounding")
        oil = {name: parameter_value(parameters, f"boom_stick.{name}") for name in ("density", "viscosity")}
        return cls(**valve, **oil, rounding=rounding)

    @property
    def zero_sd(self) -> float:
        """That of a uniform distribution up to the limit, so that its 95 % interval holds the limit."""
        return self.zero / math.sqrt(3)

    def resistance(self, area: Array) -> Array:
        """C_R [Pa.s2/m6] of effective areas [m2] by eq. (2); infinite if the edge is closed."""
        square = 2 * (self.discharge_coefficient * area) ** 2 / self.density
        return np.divide(1.0, square, out=np.full_like(square, np.inf), where=square > 0)


@dataclass(frozen=True)
class ValveSteps(StepMeans):
    """Means over the steps of one or several edges; drop and flow are positive if the edge is open.

    command, command_error   magnitude [V] and its standard error
    supply_drop              pressure drop from supply to tank [Pa]: the largest over an edge, nearly closed
    time, temperature        of the middle of the step [s], of the oil (NaN if not recorded)
    change                   1 if the command was lower before, -1 if it was higher, 0 for the first step
    density                  of the tested oil [kg/m3]
    idle_flow                flow [m3/s] up to which the meter may read what it reads
    edge                     "P-A", "P-B", "A-T" or "B-T"
    """

    command: Array
    command_error: Array
    supply_drop: Array
    time: Array
    temperature: Array
    change: Array
    density: Array
    idle_flow: Array
    edge: Array

    @property
    def edges(self) -> tuple[str, ...]:
        """The edges, in the order of the recordings."""
        return tuple(dict.fromkeys(map(str, self.edge)))

    def of(self, edge: str) -> ValveSteps:
        """The steps of one edge."""
        return self[self.edge == edge]

    def idle(self, c: Known) -> tuple[Array, Array]:
        """Commands of steps whose flow is not told from zero, and the largest areas that read so."""
        shut = self[~self.good & np.isfinite(self.idle_flow) & (self.drop > 0)]
        return shut.command, replace(shut, flow=shut.idle_flow).effective(c)[0]

    def effective(self, c: Known, zero: float = 0.0, flow_zero: float = 0.0) -> tuple[Array, Array, Array]:
        """Effective areas [m2] without the zeros, and their derivatives by drop and flow."""
        drop, flow = self.drop - zero, self.flow - flow_zero
        net = np.maximum(flow - c.leakage * (2 * drop - self.supply_drop), 1e-3 * np.abs(flow) + 1e-15)
        gain = c.discharge_coefficient * np.sqrt(2 / self.density)
        laminar = c.transition_reynolds * c.viscosity / self.density * math.sqrt(math.pi / 4)
        area = slowed = np.zeros_like(flow)
        for _ in range(3):  # an error of (Q_t/2Q)^3
            slowed = np.abs(flow) + laminar * np.sqrt(area + CLOSED)
            area = np.sqrt(net * slowed / drop) / gain
        share = area / (2 - (slowed - np.abs(flow)) / (2 * slowed) * area / (area + CLOSED))
        by_flow = share * (1 / net + np.sign(flow) / slowed)
        return area, -share * (1 / drop + 2 * c.leakage / net), by_flow


@dataclass(frozen=True)
class Nodes:
    """The steps of one opening, and means over those with one command: n steps, m nodes.

    steps           the measured steps, sorted by command
    index           node of each step
    levels, slope   areas of the steps [m2], and [m2/V] there
    by_drop         derivatives of the areas by drop and flow
    by_flow
    error           standard errors of the areas
    """

    known: Known
    steps: ValveSteps
    index: NDArray[np.int64]
    levels: Array
    slope: Array
    by_drop: Array
    by_flow: Array
    error: Array

    @classmethod
    def of(cls, steps: ValveSteps, c: Known, scatter: float = 1.0) -> Nodes:
        """The nodes of the measured steps, whose errors are `scatter` times their noise."""
        s = steps[steps.good]
        s = s[np.argsort(s.command, kind="stable")]
        area, by_drop, by_flow = s.effective(c)
        index = np.concatenate([[0], np.cumsum(np.diff(s.command) > SAME * c.full_command)])
        middle, voltage = (np.bincount(index, x) / np.bincount(index) for x in (area, s.command))
        slope = np.gradient(middle, voltage)[index] if voltage.size > 1 else np.zeros_like(area)
        noise = np.hypot(np.hypot(by_flow * s.flow_error, by_drop * s.drop_error), slope * s.command_error)
        return cls(c, s, index, area, np.asarray(slope), by_drop, by_flow, np.asarray(scatter * noise))

    def mean(self, x: Array) -> Array:
        """Means (m,) of values of the steps (n,), weighted by the errors of their areas."""
        weight = self.error**-2.0
        return np.asarray(np.bincount(self.index, weight * x) / np.bincount(self.index, weight))

    def within(self, x: Array) -> Array:
        """Deviations of values of the steps from the means of their nodes, over the errors, shape (n,)."""
        return np.asarray((x - self.mean(x)[self.index]) / self.error)

    @cached_property
    def command(self) -> Array:
        """Of the nodes [V]."""
        return np.asarray(np.bincount(self.index, self.steps.command) / np.bincount(self.index))

    @cached_property
    def at_node(self) -> Array:
        """Areas that the steps would have at the commands of their nodes [m2]."""
        return self.levels - self.slope * (self.steps.command - self.command[self.index])

    @cached_property
    def area(self) -> Array:
        """Of the nodes [m2]."""
        return self.mean(self.at_node)

    @cached_property
    def sd(self) -> Array:
        """Standard errors of the nodes' areas [m2]."""
        return np.asarray(np.bincount(self.index, self.error**-2.0) ** -0.5)

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the steps about their nodes."""
        return self.levels.size - self.command.size

    def scattered(self) -> float:
        """Scatter of steps with one command over their noise: 1 unless significantly larger."""
        chi_square = float(np.sum(self.within(self.at_node) ** 2))
        likely = _tail(chi_square, self.freedom) >= UNLIKELY
        return 1.0 if likely else math.sqrt(chi_square / self.freedom)

    def draws(self, random: np.random.Generator) -> Array:
        """Areas that noise and zeros allow, shape (DRAWS, m)."""
        noise, zeros = random.standard_normal((DRAWS, self.sd.size)), random.standard_normal((2, DRAWS, 1))
        by_zero, by_flow = self.mean(self.by_drop), self.mean(self.by_flow)
        by_zeros = by_zero * self.known.zero_sd * zeros[0] + by_flow * self.known.flow_zero * zeros[1]
        return np.asarray(self.area + self.sd * noise - by_zeros)

    def falling(self) -> tuple[float, float]:
        """Probability that a rising opening falls as much, and its largest fall in parts of it.

        Chi-square of the areas about the closest ones that rise (isotonic regression), whose freedom is the
        number of areas that it joins [Robertson, Wright and Dykstra, Order Restricted Statistical Inference
        (1988), section 2.3]; with the zero of the pressures for which it is least.
        """
        best, by_zero = (math.inf, 1, 0.0), self.mean(self.by_drop)
        for zero in np.linspace(-self.known.zero, self.known.zero, ZEROS):
            areas = self.area - by_zero * zero
            rising = isotonic_regression(areas, weights=self.sd**-2.0).x
            joined = max(self.sd.size - np.unique(rising).size, 1)
            top = np.maximum.accumulate(areas)
            best = min(best, (float(np.sum(((areas - rising) / self.sd) ** 2)), joined, max(1 - areas / top)))
        return _tail(*best[:2]), float(best[2])


def _tail(chi_square: float, freedom: int) -> float:
    return float(stats.chi2.sf(chi_square, freedom)) if freedom > 0 else 1.0


@dataclass(frozen=True)
class Repeated(Regression):
    """Effects that are common to all nodes, by steps with one command, and the scatter that is left.

    names        of those that the steps tell apart: "lag" of the opening, "drift" of the area [1], and last
                 "zero" of the pressure drop [Pa]
    warm         whether the drift is one with the temperature, not with time, over `span` [degrees] or [s]
    by_command   whether the lag is one of the command [V], not a part of the flow
    """

    warm: bool
    span: float
    by_command: bool

    def probability(self, name: str) -> float:
        """That of an effect as large, by the scatter of the steps; the lag has two forms to choose from."""
        forms = 2 if "lag" in self.names else 1
        return min(1.0, forms * 2 * float(stats.t.sf(abs(self[name]) / self.sd(name), self.freedom)))


def repeated(steps: ValveSteps, c: Known) -> Repeated | None:
    """Regression of the steps about their nodes on lag, drift and zero; None if they tell none of these."""
    zero, largest = 0.0, 0.4 * float(steps.drop[steps.good].min())
    for _ in range(8):  # Gauss-Newton
        found = _effects(Nodes.of(steps.without_zero(zero), c))
        if not found or "zero" not in found.names:
            break
        step, zero = found["zero"], float(np.clip(zero + found["zero"], -largest, largest))
        found = replace(found, values=np.array([*found.values[:-1], zero]))
        if abs(step) < 0.01 * found.sd("zero"):
            break
    return found


def _effects(nodes: Nodes) -> Repeated | None:
    s, deviation = nodes.steps, nodes.within(nodes.at_node)
    warm = bool(np.isfinite(s.temperature).all() and np.ptp(s.temperature) > 0)
    cause = s.temperature if warm else s.time
    span = float(np.ptp(cause)) or 1.0
    columns = {
        "drift": nodes.within(nodes.levels * (cause - cause.mean()) / span),
        # of the drops, not of the scatter of the areas
        "zero": nodes.within(nodes.by_drop * nodes.area[nodes.index] / nodes.levels),
    }
    fits: list[Repeated] = []
    for by_command in (True, False):
        columns["lag"] = nodes.within(-(nodes.slope if by_command else nodes.levels) * s.change / 2)
        for names in (("lag", "drift", "zero"), ("lag", "drift"), ("zero",)):
            x, freedom = np.array([columns[n] for n in names]), nodes.freedom - len(names)
            size = np.linalg.norm(x, axis=1)
            if freedom < 2 or not size.all() or np.linalg.matrix_rank(x.T / size) < len(names):
                continue
            inverse = np.linalg.inv(x @ x.T)
            values = inverse @ x @ deviation
            left = float(np.sum((deviation - values @ x) ** 2))
            covariance = inverse * max(1.0, left / freedom)
            fit = Repeated(names, values, covariance, left, freedom, warm, span, by_command)
            if names[-1] == "zero" and fit.sd("zero") > UNTOLD * nodes.known.zero:
                continue
            fits.append(fit)
            break
    return min(fits, key=lambda fit: fit.chi_square, default=None)


def without_drift(steps: ValveSteps, drifting: Mapping[str, Repeated]) -> ValveSteps:
    """The steps with the flows that they would have in the middle of their experiment."""
    flow = steps.flow.copy()
    for edge, found in drifting.items():
        own = steps.edge == edge
        cause = steps.temperature if found.warm else steps.time
        away = np.nan_to_num(cause[own] - cause[own & steps.good].mean()) / found.span
        flow[own] *= 1 - found["drift"] * away
    return replace(steps, flow=flow)


def zero_by_pressures(each: Collection[Repeated], known: Known) -> tuple[float, float]:
    """Zero [Pa] of the pressure drop by steps with one command at several drops, and its standard deviation.

    A zero beyond its limit is that of the data alone.
    """
    seen = [r for r in each if "zero" in r.names]
    weight = np.array([r.sd("zero") ** -2.0 for r in seen])
    by_data, precision = float(weight @ [r["zero"] for r in seen]), max(weight.sum(), 1e-300)
    if stats.norm.sf((abs(by_data / precision) - known.zero) * precision**0.5) >= UNLIKELY:
        precision = weight.sum() + known.zero_sd**-2.0
    return by_data / precision, precision**-0.5


# ---- straight line -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Line(Regression):
    """Straight openings with one zero, fitted to `nodes.steps`; one group of steps or several.

    values     slope [m2/V] and zero V_t [V] of each group, then zero [Pa], if free flow zero [m3/s]
               and rounding [V]
    p          probability of residuals as large, also along a parabola or cubic
    as_known   that of the known rounding against another one
    """

    p: float
    rounding: float
    as_known: float = 1.0

    def is_zero(self, known: Known) -> bool:
        """Whether a zero that was fitted without its prior may be one."""
        return self.freedom >= 4 and abs(self["zero"]) < LARGEST * known.zero

    def law(self) -> tuple[float, float, float]:
        """Slope [m2/V], zero [V] and rounding [V] of the first opening; a known rounding ends at 0 V."""
        start = self["start0"]
        rounding = self["rounding"] if "rounding" in self.names else min(self.rounding, 2 * start)
        return self["slope0"], start, max(rounding, ROUNDING[0])

    def area(self, command: float) -> tuple[float, float]:
        """Area [m2] of the first opening at a command [V] behind the foot, and its standard deviation."""
        slope, start, _ = self.law()
        sd = self.combination({"slope0": command - start, "start0": -slope})[1]
        return slope * (command - start), sd

    def draws(self) -> tuple[Array, Array, Array]:
        """`law` in draws of the estimates' normal distribution, shape (DRAWS, 1) each."""
        scale = np.sqrt(np.diag(self.covariance))
        normal = np.random.default_rng(0).multivariate_normal(
            np.zeros(scale.size), self.covariance / np.outer(scale, scale), DRAWS
        )
        p = {n: (self[n] + s * x)[:, None] for n, s, x in zip(self.names, scale, normal.T, strict=True)}
        width = p.get("rounding", np.full((DRAWS, 1), self.rounding))
        return p["slope0"], p["start0"], np.maximum(width, ROUNDING[0])


def straight(z: Array, width: Array | float) -> Array:
    """`fmus.smooth.ramp` of arrays."""
    s = np.clip(z / width, 0.0, 1.0)
    return np.asarray(width * (s**3 - s**4 / 2) + np.maximum(z - width, 0.0))


def _law(p: tuple[Array | float, Array | float, Array | float], command: Array) -> Array:
    """Areas of lines: slope, zero and rounding, at commands."""
    return np.asarray(p[0] * straight(command - p[1] + p[2] / 2, p[2]))


def fit_line(nodes: Nodes, group: Array | None = None, *, any_zero: bool = False, foot: bool = False) -> Line:
    """Least squares of straight openings.

    group      number of the opening of each step; by default all have one
    any_zero   without the prior of the zero of the pressures
    foot       with a free rounding
    """
    c, s, v = nodes.known, nodes.steps, nodes.steps.command
    group = np.zeros(v.size, dtype=int) if group is None else group
    count = int(group.max()) + 1
    area = s.effective(c)[0]
    slope, level = np.polyfit(v, area, 1, w=1 / nodes.error)
    # name -> scale, start over the scale, mean and standard deviation of the prior
    unknowns = {f"slope{g}": (float(slope), 1.0, 0.0, math.inf) for g in range(count)}
    unknowns |= {f"start{g}": (1.0, float(-level / slope), 0.0, math.inf) for g in range(count)}
    unknowns["zero"] = c.zero, 0.0, 0.0, math.inf if any_zero else c.zero_sd
    if c.flow_zero:
        unknowns["flow_zero"] = c.flow_zero, 0.0, 0.0, c.flow_zero
    if foot or c.rounding.sd:
        width, sd = c.rounding.value, math.inf if foot else c.rounding.sd or 0.0
        unknowns["rounding"] = 1.0, float(np.clip(width, 0.01, 1.9)), width, sd
    names = tuple(unknowns)
    scale, start, mean, prior = np.array(list(unknowns.values())).T
    told = np.isfinite(prior)

    def residual(x: Array) -> Array:
        p = dict(zip(names, x * scale, strict=True))
        slopes, starts = (np.array([p[f"{n}{g}"] for g in range(count)])[group] for n in ("slope", "start"))
        w = max(p.get("rounding", c.rounding.value), ROUNDING[0])
        measured = s.effective(c, p["zero"], p.get("flow_zero", 0.0))[0]
        left = (measured - _law((slopes, starts, w), v)) / nodes.error
        return np.append(left, ((x * scale - mean) / prior)[told])

    largest = 0.4 * float(s.drop.min()) / c.zero
    limits = {"rounding": ROUNDING, "zero": (-largest, largest)}
    bounds = np.array([limits.get(n, (-np.inf, np.inf)) for n in names]).T
    fit = optimize.least_squares(residual, start, "3-point", bounds, **SEARCH)
    found, r, jacobian = fit.x, fit.fun, fit.jac
    chi_square, freedom = float(r @ r), r.size - len(names)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * np.outer(scale, scale)
    p = _tail(chi_square, freedom)
    if nodes.command.size > 4 and count == 1:  # a smooth deviation is tested apart from single steps
        x = v / v.max()
        smooth = np.zeros((r.size, 2))
        smooth[: v.size] = np.column_stack([x**2, x**3]) * (area.max() / nodes.error)[:, None]
        # a zero may look like a cubic: what is below the noise in this is noise of the regressors
        wide = np.hstack([jacobian, smooth])
        x, _, rank, _ = np.linalg.lstsq(wide, r, rcond=1 / float(np.linalg.norm(wide, 2)))
        left, more = r - wide @ x, int(rank) - len(names)
        p = min(1.0, 2 * min(p, _tail(chi_square - float(left @ left), more)))
    return Line(names, found * scale, np.asarray(covariance), chi_square, freedom, p, c.rounding.value)


def line(nodes: Nodes, *, any_zero: bool = False) -> Line:
    """The straight line of one opening; its rounding is free if steps on the foot determine it."""
    rounding = nodes.known.rounding

    def with_rounding(value: float) -> Line:
        other = replace(nodes.known, rounding=replace(rounding, value=value))
        return fit_line(replace(nodes, known=other), any_zero=any_zero)

    fixed = fit_line(nodes, any_zero=any_zero)
    if np.count_nonzero(nodes.steps.command < fixed["start0"] + ROUNDING[1] / 2) < 2 or rounding.sd:
        return fixed
    free, sharp = fit_line(nodes, any_zero=any_zero, foot=True), with_rounding(ROUNDING[0])
    better = fixed.chi_square - min(free.chi_square, sharp.chi_square)
    as_known = _tail(better, 1)
    certain = free.determined("rounding") and free["rounding"] < 0.99 * ROUNDING[1]
    if certain and sharp.chi_square - free.chi_square > CERTAIN**2:
        return replace(free, as_known=as_known)
    if better < CERTAIN**2:
        return fixed
    # the known rounding is wrong, as of a sharp start
    other = ROUNDING[0] if sharp.chi_square < free.chi_square + CERTAIN else free["rounding"]
    return replace(with_rounding(other), as_known=as_known)


# ---- curves and their band ---------------------------------------------------------------------------


@dataclass(frozen=True)
class OpeningCurve:
    """An opening with its band.

    command           grid [V] from zero to full command, shape (k,)
    draws             curves that the data allow [m2], shape (DRAWS, k)
    area, low, high   the opening through the points of the table, and the ends of the 95 % band [m2]
    commands, areas   points of the table [V], [m2]; the first one is the start of the opening, with area 0
    start             start of the opening [V] in each curve; negative: the edge is open at zero command
    first_measured    lowest command [V] with a measured flow; below it the curve is extrapolated
    last_measured     highest one, as well
    """

    command: Array
    draws: Array
    area: Array
    low: Array
    high: Array
    commands: Array
    areas: Array
    start: Array
    first_measured: float
    last_measured: float

    def band_at(self, command: Array) -> tuple[Array, Array]:
        """Ends of the band at commands [V]."""
        low, high = (np.interp(command, self.command, end) for end in (self.low, self.high))
        return np.asarray(low), np.asarray(high)

    def openings(self, largest: float, note: str) -> Iterator[Estimate]:
        """Points of the table behind the start, relative to an area [m2]; each has its command as name."""
        for command, area in zip(self.commands[1:], self.areas[1:], strict=True):
            numbers = np.array([area, self.draws_at(command).std(), *self.band_at(command)]) / largest
            value, sd, low, high = map(float, numbers)
            yield Estimate(f"{command:.3g}", value, "1", sd, low, high, note)

    def draws_at(self, command: float) -> Array:
        """Effective area [m2] of each curve at the nearest command [V] of the grid."""
        return np.asarray(self.draws[:, np.argmin(np.abs(self.command - command))])

    def estimate(self, name: str, unit: str, note: str, draws: Array, value: float | None = None) -> Estimate:
        """An estimate from its value in each curve: median, standard deviation, 95 % interval."""
        tail = (1 - CONFIDENCE) / 2
        low, middle, high = (float(x) for x in np.quantile(draws, [tail, 0.5, 1 - tail]))
        value = middle if value is None else value
        return Estimate(name, value, unit, float(draws.std()), min(low, value), max(high, value), note)


def tabulated(commands: Array, areas: Array, command: Array) -> Array:
    """Monotone cubic through the points of a table, 0 up to the first and constant after the last point.

    The slope at the first point is zero, as in the machine: here by a further point before it.
    """
    before = commands[0] - (commands[1] - commands[0])
    cubic = PchipInterpolator([before, *commands], [0.0, *areas])
    return np.asarray(np.where(command <= commands[0], 0.0, cubic(np.clip(command, before, commands[-1]))))


def curve(nodes: Nodes, steps: ValveSteps, fitted: Line | None, monotone: bool) -> OpeningCurve:
    """The opening with its band: the fitted line, or without one the curve through the nodes.

    steps      of the edges of this opening, also those without a flow
    monotone   whether the band is that of an opening that rises
    """
    c, random = nodes.known, np.random.default_rng(0)
    v = nodes.command[nodes.command < c.full_command * (1 + SAME)]
    bounds = np.column_stack(steps.idle(c))
    inside = [*v, *bounds[bounds[:, 0] < c.full_command, 0], 0.02]
    grid = np.unique(np.round([*np.linspace(0.0, c.full_command, GRID), *inside], 6))
    between = (grid >= v[0] - 1e-6) & (grid <= v[-1] + 1e-6)
    if fitted:
        p = fitted.draws()
        middle, start = _law(fitted.law(), grid), fitted["start0"] - fitted.law()[2] / 2
        draws, values, exponents = _law(p, grid), _law(p, v), SHORT_FOOT
        starts = (p[1] - p[2] / 2)[:, 0]
    else:
        values = nodes.draws(random)[:, : v.size]
        mean = isotonic_regression(nodes.area[: v.size], weights=nodes.sd[: v.size] ** -2.0).x
        draws, exponents = np.empty((DRAWS, grid.size)), FOOT
        draws[:, between] = _kinked(v, values, grid[between], random)
        middle = PchipInterpolator(v, mean)(np.clip(grid, v[0], v[-1]))
    first, second = (np.diff(values[:, :3], axis=1) / np.diff(v[:3])).T
    # between the slope of the first chord and that of a parabola, and beyond
    bend = random.uniform(0.0, CURVED, DRAWS) * (second - first) * (v[1] - v[0]) / (v[2] - v[0])
    slope = np.maximum(first - bend, 0.3 * first)
    below, above = grid < v[0] - 1e-6, grid > v[-1] + 1e-6
    if not fitted or "rounding" not in fitted.names:
        least = 1e-6 * nodes.area.max()  # noise may leave none
        area = np.maximum(values[:, 0], least)
        slope = np.maximum(slope, 1e-3 * area / v[0])
        starts = _starts(v[0], area, slope, exponents, bounds[bounds[:, 0] < v[0]], random)
        largest = [np.min(bounds[bounds[:, 0] >= x, 1], initial=np.inf) for x in grid[below]]
        draws[:, below] = np.minimum(_powers(v[0], area, slope, starts, grid[below]), largest)
        if not fitted:
            start = float(np.median(starts))
            one = np.maximum(middle[between][:1], least), np.median(slope, keepdims=True), np.array([start])
            middle[below] = np.minimum(_powers(v[0], *one, grid[below])[0], largest)
    last = np.diff(values[:, -2:], axis=1) / (v[-1] - v[-2])
    way = grid[above] - v[-1]
    draws[:, above] = values[:, -1:] + random.uniform(0.0, 2.0, (DRAWS, 1)) * last * way
    middle[above] = np.interp(v[-1], grid, middle) + max(float(np.median(last)), 0.0) * way
    draws = np.maximum(draws, 0.0) * (1 + c.drift * random.uniform(-1.0, 1.0, (DRAWS, 1)))
    low, high = simultaneous_band(draws)
    if monotone:  # a rising curve that is in the band is in this one, too
        low, high = np.maximum.accumulate(low), np.minimum.accumulate(high[::-1])[::-1]
    points = table(grid, np.maximum.accumulate(middle), (high - low) / 2, max(start, 0.0))
    area = tabulated(*points, grid)
    ends = np.minimum(low, area), np.maximum(high, area)
    return OpeningCurve(grid, draws, area, *ends, *points, starts, float(v[0]), float(v[-1]))


def _kinked(v: Array, values: Array, grid: Array, random: np.random.Generator) -> Array:
    """Curves through values at nodes v: in each interval anywhere that a cubic, a chord or a kink may be."""
    j = np.clip(np.searchsorted(v, grid, "right") - 1, 0, v.size - 2)
    secant = np.diff(values, axis=1) / np.diff(v)
    cubic = PchipInterpolator(v, values, axis=1)(grid)
    chord = values[:, j] + secant[:, j] * (grid - v[j])
    before = values[:, j] + secant[:, np.maximum(j - 1, 0)] * (grid - v[j])
    after = values[:, j + 1] - secant[:, np.minimum(j + 1, v.size - 2)] * (v[j + 1] - grid)
    low = np.minimum(np.minimum(chord, cubic), np.maximum(before, after))
    high = np.maximum(np.maximum(chord, cubic), np.minimum(before, after))
    return np.asarray(low + random.uniform(size=(len(values), v.size - 1))[:, j] * (high - low))


def _powers(first: float, area: Array, slope: Array, start: Array, grid: Array) -> Array:
    """Openings (n, k) that begin at `start` and have area and slope, (n,) each, at the lowest node."""
    length = first - start[:, None]
    exponent = length * (slope / area)[:, None]
    share = np.clip((grid - start[:, None]) / length, 0.0, None)
    return np.asarray(area[:, None] * np.where(share > 0, share**exponent, 0.0))


def _starts(
    first: float,
    area: Array,
    slope: Array,
    exponents: tuple[float, float],
    bounds: Array,
    random: np.random.Generator,
) -> Array:
    """Starts of `_powers` that the bounds below the lowest node allow; without any the latest.

    exponents   least and largest exponent
    bounds      commands and largest areas of steps without a flow, shape (m, 2)
    """
    tangent, (low, high) = area / slope, exponents
    longest = first / tangent  # the exponent that begins at zero command
    high_of = np.where(longest < UNDERLAP, UNDERLAP, np.minimum(high, longest))
    latest = start = first - low * tangent
    free: Mask = np.ones(start.size, dtype=bool)
    for _ in range(8):
        exponent = low + (high_of - low) * random.uniform(size=start.size)
        start = np.where(free, first - exponent * tangent, start)
        free = np.asarray((_powers(first, area, slope, start, bounds[:, 0]) > bounds[:, 1]).any(axis=1))
    return np.where(free, latest, start)


def simultaneous_band(draws: Array) -> tuple[Array, Array]:
    """Ends of a band that holds 95 % of the curves over their whole length, shape (k,) each.

    A curve is as extreme as its most extreme point; the band leaves out the most extreme 5 % of the curves.
    """
    count, ordered = draws.shape[0], np.sort(draws, axis=0)
    below = stats.rankdata(draws, "max", axis=0)  # curves at or below this one, itself included
    above = count + 1 - stats.rankdata(draws, "min", axis=0)
    rank = np.minimum(below, above).min(axis=1)
    k = max(int(np.quantile(rank, 1 - CONFIDENCE)), 1)
    return ordered[k - 1], ordered[count - k]


def table(command: Array, area: Array, half_band: Array, start: float) -> tuple[Array, Array]:
    """Up to ten points of a curve, between which its largest error in half bands is as small as possible.

    Each further point is where the table is farthest off; then points move as long as this is better.
    """
    tolerance = np.maximum(half_band, 1e-4 * area.max())
    inner = [int(k) for k in np.flatnonzero(command > start + 0.01) if area[k] > 0]

    def points(chosen: Collection[int]) -> tuple[Array, Array]:
        order = sorted(chosen)
        return np.array([start, *command[order]]), np.array([0.0, *area[order]])

    def error(chosen: Collection[int]) -> Array:
        return np.asarray(np.abs(tabulated(*points(chosen), command) - area)[inner] / tolerance[inner])

    chosen = {inner[-1]}
    while len(chosen) < min(POINTS - 1, len(inner)) and (off := error(chosen)).max() > CLOSE:
        chosen.add(max((k for k in inner if k not in chosen), key=lambda k: float(off[inner.index(k)])))
    best, improved = float(error(chosen).max()), True
    while improved and best > CLOSE:
        improved = False
        for k in sorted(chosen - {inner[-1]}):
            at = inner.index(k)
            near = (at + step for step in (-1, 1, -2, 2, -4, 4))
            for other in [inner[i] for i in near if 0 <= i < len(inner) - 1]:
                moved = chosen - {k} | {other}
                if len(moved) == len(chosen) and (worst := float(error(moved).max())) < best:
                    chosen, best, improved, k = moved, worst, True, other
    return points(chosen)


# ---- all edges ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Openings:
    """Openings of the tested edges.

    steps     all steps, also those without a flow
    nodes     edge -> its nodes
    lines     edge -> its straight line
    line      the straight line of all edges together, if it suffices
    any_zero  edge, or "all" -> its straight line with any zero of the pressures
    curves    edge -> its opening with a band; the same object for equal edges
    equal     probability that equal edges differ as much
    falling   edge -> probability that a rising opening falls as much, and its largest fall
    repeated  edge -> what its steps with one command tell
    zero      of the pressure drop [Pa] by these steps and its standard deviation; curves are without it
    own       edge -> its straight opening with a band, if a line suffices
    flow_zero reading of the flow meter at closed edges [m3/s] and its sd, which is subtracted; None if unseen
    """

    steps: ValveSteps
    known: Known
    nodes: Mapping[str, Nodes]
    lines: Mapping[str, Line]
    line: Line | None
    any_zero: Mapping[str, Line]
    curves: Mapping[str, OpeningCurve]
    equal: float
    falling: Mapping[str, tuple[float, float]]
    repeated: Mapping[str, Repeated]
    zero: tuple[float, float]
    own: Mapping[str, OpeningCurve] = field(default_factory=dict)
    flow_zero: tuple[float, float] | None = None

    @property
    def straight(self) -> bool:
        """Whether a straight line suffices for each edge."""
        return min(line.p for line in self.lines.values()) >= UNLIKELY / len(self.lines)

    @property
    def common(self) -> OpeningCurve:
        """The curve of the first edge, which all have if they are equal."""
        return next(iter(self.curves.values()))

    @property
    def largest(self) -> float:
        """Area at full command of the edge that opens furthest [m2]."""
        return max(float(curve.areas[-1]) for curve in self.curves.values())

    def distinct(self) -> dict[str, OpeningCurve]:
        """One entry for all edges with the same curve; its name is "all" then."""
        if len({id(curve) for curve in self.curves.values()}) == 1 and len(self.curves) > 1:
            return {"all": self.common}
        return dict(self.curves)


def fit_openings(steps: ValveSteps, known: Known) -> Openings:
    """Straight line or curves of all edges: a line if it suffices for each, one opening if they are equal."""
    edges = steps.edges
    found_again = {e: r for e in edges if (r := repeated(steps.of(e), known))}
    drifting = {
        e: r for e, r in found_again.items() if "drift" in r.names and r.probability("drift") < UNLIKELY
    }
    largest = max((abs(r["drift"]) for r in drifting.values()), default=0.0)
    steps, known = without_drift(steps, drifting), replace(known, drift=largest)
    zero, zero_sd = zero_by_pressures(found_again.values(), known)
    corrected, by_curve = steps.without_zero(zero), replace(known, zero=3**0.5 * zero_sd)
    scatter = max(Nodes.of(corrected.of(e), known).scattered() for e in edges)
    measured = {e: Nodes.of(steps.of(e), known, scatter) for e in edges}
    nodes = {e: Nodes.of(corrected.of(e), by_curve, scatter) for e in edges}
    any_zero = {e: line(n, any_zero=True) for e, n in measured.items()}
    lines = {e: line(n) for e, n in measured.items()}
    for e, free in any_zero.items():  # a zero outside its declaration is named, and used
        if lines[e].p < UNLIKELY / len(edges) <= free.p and free.is_zero(known):
            lines[e] = free
    falling = {e: n.falling() for e, n in nodes.items()}
    found = Openings(
        steps, known, nodes, lines, None, any_zero, {}, 1.0, falling, found_again, (zero, zero_sd)
    )
    if found.straight:
        return _straight(replace(found, nodes=measured), scatter)
    pooled = Nodes.of(corrected, by_curve, scatter)
    equal = _tail(*_difference(nodes.values(), pooled))
    rises = {e: p >= UNLIKELY for e, (p, _) in falling.items()}
    if equal > UNLIKELY:
        curves = dict.fromkeys(edges, curve(pooled, corrected, None, monotone=all(rises.values())))
    else:
        curves = {e: curve(n, corrected.of(e), None, monotone=rises[e]) for e, n in nodes.items()}
    return replace(found, curves=curves, equal=equal)


def _straight(found: Openings, scatter: float) -> Openings:
    """The straight line of all edges together, unless they differ or are open at zero command."""
    steps, known, edges = found.steps, found.known, found.steps.edges
    pooled = Nodes.of(steps, known, scatter)
    group = np.array([edges.index(str(e)) for e in pooled.steps.edge])
    any_common = any(found.lines[e] is found.any_zero[e] for e in edges)
    common = line(pooled, any_zero=any_common)
    foot = "rounding" in common.names and not known.rounding.sd
    apart = fit_line(pooled, group, any_zero=any_common, foot=foot)
    equal = _tail(common.chi_square - apart.chi_square, 2 * (len(edges) - 1))
    own = {e: curve(n, steps.of(e), found.lines[e], monotone=True) for e, n in found.nodes.items()}
    found = replace(found, own=own, curves=own, equal=equal)
    if equal <= UNLIKELY or common["start0"] <= -CERTAIN * common.sd("start0"):
        return found
    any_zero = {"all": line(pooled, any_zero=True)} if len(edges) > 1 else found.any_zero
    one = curve(pooled, steps, common, monotone=True)
    return replace(found, line=common, any_zero=any_zero, curves=dict.fromkeys(edges, one))


def _difference(each: Collection[Nodes], pooled: Nodes) -> tuple[float, int]:
    """Chi-square of the nodes of edges about those of all together, and its degrees of freedom."""
    chi_square, freedom = 0.0, -pooled.command.size
    for nodes in each:
        near = np.argmin(np.abs(pooled.command[:, None] - nodes.command), axis=0)
        chi_square += float(np.sum(((nodes.area - pooled.area[near]) / nodes.sd) ** 2))
        freedom += nodes.command.size
    return chi_square, freedom
