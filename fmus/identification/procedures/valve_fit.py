"""Openings of metering edges over the command: laws of `balance` for steady steps.

    Q - L = q(A, dp)        L = G dp - G (dp_s - dp)

q is the flow of `orifice.Edge` at the effective area A, L the leakage (coefficient G) of the open edge minus
that of the closed edge at the same port, which has the rest of the pressure drop dp_s from supply to tank.
With the position x = V - s lag/2 of a spool with hysteresis, s = 1 after a rising command and -1 after a
falling one, and with f = 1 + drift t for an oil or a spool that changes with the time or the temperature t,

    nodes    A = (a_i + k_i (x - V_i)) f         a_i free for each command V_i
    line     A = k ramp(x - V_t + w/2, w) f      as `components.spool_valve`

A hysteresis that is a part of the flow instead, f = 1 + drift t - s share/2, is the other form that is tried.

Steps without a flow count for the line; for the nodes those at a closed edge do, which show the zero of the
flow meter. All estimates have the zeros of the three sensors as further unknowns, and the
leakage, which is assumed, not measured (prior: the known one, with a standard deviation as large). Lag and
drift are tested, and estimated with the openings where they are significant.

The flow hardly tells the rounding w apart from a dead band. So lines are fitted for many roundings, each with
its probability by the data and by what is known: its value, and a standard deviation as large if none is
stated. Draws of slope, V_t and w from all of them then hold sharp and rounded starts.

Validity: steady flow; the leakage is a small part of it (below a tenth).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np
from scipy import stats

from fmus.components.chamber import Liquid
from fmus.components.orifice import Edge
from fmus.identification import balance
from fmus.identification.balance import UNLIKELY, Law, Normal, Samples, Solution, probability
from fmus.identification.procedures.experiment_data import StepMeans, parameter, parameter_value
from fmus.parameters import Number
from fmus.smooth import ramp
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Mask
from orchestrator.data.table import Array

SAME = 2e-3  # of the full command: steps that are closer have one command
CERTAIN = 4.0  # standard errors above which a flow is certain
SHARP, WIDEST, WIDTHS = 1e-3, 2.0, 17  # V, of roundings that are tried, and their number
UNLIKELY_WIDTH = (
    1e-4  # of the largest probability; until this number of roundings is above it, the next ones are closer
)
FEWEST_WIDTHS, ZOOMS = 6, 8
FURTHER = 10.0  # limits of a zero up to which it may be a fault of a sensor
DRAWS = 2000  # of lines: the 2.5 % quantile has an error of a tenth of a standard deviation
PRESSURES = ("pressure_in", "pressure_out")
SENSORS = (*PRESSURES, "flow")
CHANNELS = (*SENSORS, "command", "supply drop", "change", "course", "density", "viscosity")
OF_EDGE = ("slope", "start", "square", "cube")  # unknowns of one opening; lag and drift are those of all
EFFECTS = ("lag", "share", "drift")
LEAK, LEAK_SD = "leak", 1.0  # of the leakage over the known one, less one: it is assumed, not measured


@dataclass(frozen=True)
class Known:
    """Parameters of the valve and its oil before the valve is measured; rounding: its sd may be unknown."""

    discharge_coefficient: float
    full_command: float
    leakage: float
    transition_reynolds: float
    density: float
    viscosity: float
    rounding: Number

    @classmethod
    def of(cls, parameters: Mapping[str, Number]) -> Known:
        """From the parameters of the machine, whose three valves are identical (section 4(a))."""
        names = ("discharge_coefficient", "full_command", "leakage", "transition_reynolds")
        valve = {name: parameter_value(parameters, f"boom_stick.valve_{name}") for name in names}
        rounding = parameter(parameters, "boom_stick.valve_command_rounding")
        oil = {name: parameter_value(parameters, f"boom_stick.{name}") for name in ("density", "viscosity")}
        return cls(**valve, **oil, rounding=rounding)

    def constants(self, width: float = SHARP, slope: float = 0.0, command: float = 0.0) -> tuple[float, ...]:
        """The known constants of the laws."""
        valve = self.discharge_coefficient, self.transition_reynolds, self.leakage
        return *valve, self.full_command, width, slope, command

    def resistance(self, area: Array) -> Array:
        """C_R [Pa.s2/m6] of effective areas [m2] by eq. (2); infinite if the edge is closed."""
        square = 2 * (self.discharge_coefficient * area) ** 2 / self.density
        return np.divide(1.0, square, out=np.full_like(square, np.inf), where=square > 0)


@lru_cache(maxsize=1)
def laws() -> Mapping[str, Law]:
    """The laws of a closed edge, of a node, and of a straight line that may be bent."""
    z, known = ca.SX.sym("z", len(CHANNELS)), ca.SX.sym("known", 7)
    p_in, p_out, flow, command, supply_drop, change, course, density, viscosity = ca.vertsplit(z)
    coefficient, reynolds, leakage, full, width, slope, at = ca.vertsplit(known)
    u = {name: ca.SX.sym(name) for name in ("area", *OF_EDGE, *EFFECTS, LEAK)}
    x, drop = command - u["lag"] * change / 2, p_in - p_out
    line = u["slope"] * ramp(x - u["start"] + width / 2, width)
    bent = line + u["slope"] * full * (u["square"] * (x / full) ** 2 + u["cube"] * (x / full) ** 3)
    edge = Edge(discharge_coefficient=coefficient, transition_reynolds=reynolds)
    oil = Liquid(density=density, viscosity=viscosity)

    def law(area: ca.SX, *names: str) -> Law:
        through = edge.flow(area * (1 + u["drift"] * course - u["share"] * change / 2), drop, oil)
        balanced = flow - leakage * (1 + u[LEAK]) * (2 * drop - supply_drop) - through
        return balance.law(z, {n: u[n] for n in (*names, *EFFECTS, LEAK)}, known, balanced)

    return {
        "closed": law(ca.SX(0.0)),
        "node": law(u["area"] + slope * (x - at), "area"),
        "line": law(bent, *OF_EDGE),
    }


@dataclass(frozen=True)
class ValveSteps(StepMeans):
    """Means over the steps of one or several edges.

    command, command_error   magnitude [V] and its standard error
    supply_drop              pressure drop from supply to tank [Pa]: the largest over an edge, nearly closed
    course                   oil temperature, or time from the start, from its mean, over its range
    change                   1 if the command was lower before, -1 if it was higher, 0 for the first step
    density, viscosity       of the tested oil [kg/m3], [Pa.s]
    edge                     "P-A", "P-B", "A-T" or "B-T"
    closed                   a closed edge: its reading is the zero of the flow meter and the leakage
    idle_flow                flow [m3/s] that the reading allows at most, if a flow is not certain; else NaN
    """

    command: Array
    command_error: Array
    supply_drop: Array
    course: Array
    change: Array
    density: Array
    viscosity: Array
    edge: Array
    closed: Mask
    idle_flow: Array

    @property
    def edges(self) -> tuple[str, ...]:
        """The edges, in the order of the recordings."""
        return tuple(dict.fromkeys(map(str, self.edge)))

    def of(self, edge: str) -> ValveSteps:
        """The steps of one edge."""
        return self[self.edge == edge]

    @property
    def read(self) -> ValveSteps:
        """The steps whose meter was not in its dead zone and whose instruments were in their range."""
        told = np.isfinite(self.flow_error + self.drop_error)
        return self[told & ~self.dead & ~self.clipped]

    def idle(self, c: Known) -> tuple[Array, Array]:
        """Commands of steps whose flow is not told from zero, and the largest areas that read so."""
        shut = self[~self.good & np.isfinite(self.idle_flow)]
        return shut.command, replace(shut, flow=np.sign(shut.drop) * shut.idle_flow).effective(c)

    def effective(self, c: Known) -> Array:
        """Effective areas [m2] with the zeros at zero."""
        flow = np.abs(self.flow)
        net = np.abs(self.flow - c.leakage * (2 * self.drop - self.supply_drop))
        gain = c.discharge_coefficient * np.sqrt(2 / self.density)
        laminar = c.transition_reynolds * self.viscosity / self.density * math.sqrt(math.pi / 4)
        area = np.zeros_like(flow)
        for _ in range(4):  # an error of (Q_t/2Q)^4
            area = np.sqrt(net * (flow + laminar * np.sqrt(area)) / np.abs(self.drop)) / gain
        return area

    def samples(self, c: Known, law: str, names: Mapping[str, str], *constants: float) -> Samples:
        """The steps in one of the laws; names: those of its unknowns among the unknowns of all steps."""
        none = np.zeros_like(self.drop)
        # only the difference of the pressures counts, so that at the outlet is taken as zero
        columns = {
            "pressure_in": (self.drop, self.drop_error),
            "pressure_out": (none, none),
            "flow": (self.flow, self.flow_error),
            "command": (self.command, self.command_error),
            "supply drop": (self.supply_drop, none),
            "change": (self.change, none),
            "course": (self.course, none),
            "density": (self.density, none),
            "viscosity": (self.viscosity, none),
        }
        raw, noise = (np.array([columns[n][k] for n in CHANNELS]) for k in (0, 1))
        found = balance.samples_of(laws()[law], CHANNELS, raw, noise, c.constants(*constants))
        return replace(found, names=tuple(names.get(n, n) for n in found.names))


@dataclass(frozen=True)
class Nodes:
    """Free areas of one opening at its commands.

    command   of each node [V], shape (m,), ascending
    names     of their areas among the unknowns of the solution
    """

    command: Array
    names: tuple[str, ...]
    solution: Solution

    @cached_property
    def _rows(self) -> list[int]:
        return [self.solution.fit.names.index(n) for n in self.names]

    @cached_property
    def area(self) -> Array:
        """Of the nodes [m2]."""
        return np.asarray(self.solution.fit.values[self._rows])

    @cached_property
    def covariance(self) -> Array:
        """Of the areas [m4]."""
        return np.asarray(self.solution.fit.covariance[np.ix_(self._rows, self._rows)])

    @property
    def sd(self) -> Array:
        """Standard deviations of the areas [m2]."""
        return np.sqrt(np.diag(self.covariance))

    def draws(self, random: np.random.Generator) -> Array:
        """Areas that noise and zeros allow [m2], shape (DRAWS, m)."""
        return normal_draws(self.area, self.covariance, random)

    def falling(self) -> tuple[float, float]:
        """Probability that a rising opening falls as much between any two nodes; largest fall in parts."""
        first, second = np.triu_indices(self.area.size, 1)
        fall, variance = self.area[first] - self.area[second], np.diag(self.covariance)
        sd = np.sqrt(variance[first] + variance[second] - 2 * self.covariance[first, second])
        p = min(1.0, fall.size * float(stats.norm.sf(np.max(fall / sd))))
        return p, float(np.max(1 - self.area / np.maximum.accumulate(self.area)))


def normal_draws(mean: Array, covariance: Array, random: np.random.Generator, count: int = DRAWS) -> Array:
    """Draws of a normal distribution, shape (count, n)."""
    scale = np.maximum(np.sqrt(np.diag(covariance)), 1e-300)
    unit = random.multivariate_normal(np.zeros(mean.size), covariance / np.outer(scale, scale), count)
    return np.asarray(mean + scale * unit)


@dataclass(frozen=True)
class Lines:
    """Straight openings of one or several edges, which share zeros and rounding.

    labels        of the openings: names of edges, or "" for one of all
    widths        roundings that were tried [V], ascending, with their probabilities, (n,) each
    solutions     the fit for each of them
    best          index of the most probable one
    known, prior  rounding before, and its standard deviation [V]
    scatter       residuals over the noise that steps with one command have
    """

    labels: tuple[str, ...]
    widths: Array
    weights: Array
    solutions: Sequence[Solution]
    best: int
    known: float
    prior: float
    scatter: float

    @property
    def solution(self) -> Solution:
        """That of the most probable rounding."""
        return self.solutions[self.best]

    @property
    def cost(self) -> float:
        """Chi-square of the best fit, its zeros included, by the scatter."""
        return min(s.cost for s in self.solutions) / self.scatter**2

    @property
    def rounding(self) -> tuple[float, float]:
        """Mean and standard deviation [V]."""
        mean = float(self.weights @ self.widths)
        return mean, math.sqrt(float(self.weights @ (self.widths - mean) ** 2))

    @property
    def told(self) -> bool:
        """Whether the data tell the rounding better than what was known."""
        return self.rounding[1] < self.prior / 2

    def as_known(self, width: float) -> float:
        """Probability of data that contradict a rounding [V] as much."""
        near = self.solutions[int(np.argmin(np.abs(self.widths - width)))]
        return float(stats.chi2.sf(near.cost / self.scatter**2 - self.cost, 1))

    @cached_property
    def draws(self) -> Mapping[str, Array]:
        """Slope [m2/V] and start V_t [V] of each opening by name, and "rounding" [V], shape (DRAWS,)."""
        random, names = np.random.default_rng(0), self.solution.fit.names
        step = _spacing(self.widths)
        rows = []
        for count, width, half, s in zip(
            random.multinomial(DRAWS, self.weights),
            self.widths,
            step / 2 * (self.widths.size > 1),
            self.solutions,
            strict=True,
        ):
            some = normal_draws(s.fit.values, s.fit.covariance, random, int(count))
            around = np.clip(width + half * random.uniform(-1, 1, (int(count), 1)), SHARP, None)
            rows.append(np.hstack([some, around]))
        columns = random.permutation(np.concatenate(rows)).T
        return dict(zip((*names, "rounding"), columns, strict=True))

    def p(self, label: str) -> float:
        """Probability of residuals as large of one opening, also along a parabola or cubic."""
        found = self.solution
        chi_square, freedom, commands = 0.0, -2, 0
        for s, part in zip(found.samples, found.parts, strict=True):
            if f"slope{label}" in s.names:
                chi_square, freedom = chi_square + float(part.e @ part.e), freedom + part.e.size
                commands += np.unique(np.round(s.raw[CHANNELS.index("command")], 2)).size
        p = float(stats.chi2.sf(chi_square / self.scatter**2, max(freedom, 1)))
        if commands > 4:
            columns = np.array([found.column(f"{n}{label}") for n in ("square", "cube")])
            bend, covariance = found.effects(columns)
            size = np.sqrt(np.diag(covariance))
            correlation = covariance / np.outer(size, size)
            smooth = float(bend / size @ np.linalg.pinv(correlation, rcond=1e-9) @ (bend / size))
            p = min(1.0, 2 * min(p, float(stats.chi2.sf(smooth, 2))))
        return p

    def line(self, label: str) -> tuple[float, float, float]:
        """Slope [m2/V], start V_t [V] and rounding [V]; one that is not told is as known, up to 2 V_t."""
        slope, start = (self.solution.fit[f"{n}{label}"] for n in ("slope", "start"))
        width = self.rounding[0] if self.told else min(self.known, 2 * start)
        return slope, start, max(width, SHARP)

    def area(self, label: str, command: float) -> tuple[float, float]:
        """Area [m2] at a command behind the foot, and its standard deviation."""
        slope, start = self.draws[f"slope{label}"], self.draws[f"start{label}"]
        best, first, _ = self.line(label)
        return best * (command - first), float(np.std(slope * (command - start)))

    def areas(self, label: str, command: Array) -> Array:
        """Areas [m2] in each draw at commands (n,), shape (DRAWS, n)."""
        d = self.draws
        slope, start, width = (d[n][:, None] for n in (f"slope{label}", f"start{label}", "rounding"))
        return np.asarray(slope * straight(command - start + width / 2, width))


def _spacing(x: Array) -> Array:
    """Distance of neighbouring values, of one alone 1."""
    return np.asarray(np.gradient(x)) if x.size > 1 else np.ones(1)


def straight(z: Array, width: Array | float) -> Array:
    """`fmus.smooth.ramp` of arrays."""
    s = np.clip(z / width, 0.0, 1.0)
    return np.asarray(width * (s**3 - s**4 / 2) + np.maximum(z - width, 0.0))


@dataclass(frozen=True)
class ValveFit:
    """Fits of the steps of all edges: free nodes, and straight lines.

    nodes      edge -> its nodes; edges have the zeros in common
    pooled     nodes of all edges together; None if they have no fit, as the following
    each_line  a straight line for each edge
    one_line   one line for all edges
    scatter    residuals over the noise that steps with one command have, 1 unless it is significantly more
    effects    lag [V] or share [1], and drift [1], and their standard deviations
    freed      those of them that are estimated with the openings
    """

    steps: ValveSteps
    known: Known
    limits: Mapping[str, float]
    nodes: Mapping[str, Nodes]
    pooled: Nodes | None
    each_line: Lines | None
    one_line: Lines | None
    scatter: float
    effects: Mapping[str, tuple[float, float]]
    freed: tuple[str, ...]

    @property
    def lines(self) -> Lines:
        """A straight line for each edge, if there is such a fit."""
        assert self.each_line
        return self.each_line

    @property
    def line(self) -> Lines:
        """One straight line for all edges, if there is such a fit."""
        assert self.one_line
        return self.one_line

    @cached_property
    def corrected(self) -> ValveSteps:
        """The steps without the zero of the pressures, at the commands that they would have without a lag."""
        lag = self.effects["lag"][0] if "lag" in self.freed else 0.0
        command = np.maximum(self.steps.command - lag * self.steps.change / 2, 0.0)
        return replace(self.steps.without_zero(offset(self.solution)[0]), command=command)

    @cached_property
    def p(self) -> Mapping[str, float]:
        """Edge -> probability that its opening is a straight line."""
        return {edge: self.lines.p(edge) if self.each_line else 0.0 for edge in self.nodes}

    @property
    def straight(self) -> bool:
        """Whether a straight line suffices for each edge."""
        return min(self.p.values()) >= UNLIKELY / len(self.p)

    @property
    def solution(self) -> Solution:
        """The fit whose zeros and residuals are those of the procedure."""
        return self.lines.solution if self.straight else self.by_nodes

    @property
    def by_nodes(self) -> Solution:
        """The fit of the nodes."""
        return next(iter(self.nodes.values())).solution

    @property
    def equal(self) -> float:
        """Probability that equal edges differ as much."""
        edges = len(self.nodes)
        if edges == 1:
            return 1.0
        if self.straight and self.one_line:
            return float(stats.chi2.sf(self.line.cost - self.lines.cost, 2 * (edges - 1)))
        if self.straight or not self.pooled:
            return 0.0
        more = sum(n.command.size for n in self.nodes.values()) - self.pooled.command.size
        further = self.pooled.solution.cost - self.by_nodes.cost
        return float(stats.chi2.sf(further / self.scatter**2, more))


def fit(steps: ValveSteps, c: Known, limits: Mapping[str, float]) -> ValveFit:
    """Nodes and lines of all edges; limits: largest zeros of the sensors.

    A zero far outside its limit is estimated where the data contradict all zeros within.
    """
    wide = {n: x * FURTHER ** (n in PRESSURES) for n, x in limits.items()}
    try:
        found = _fit(steps, c, limits)
    except Problem:  # no zero within its limit is near the data
        return _fit(steps, c, wide)
    largest = FURTHER * sum(limits[n] for n in PRESSURES)
    seen = _outside(found.solution, largest / FURTHER)
    if not (seen or found.straight):  # a line bends with a zero
        lines = _lines(steps, c, wide, found.freed, found.scatter)
        straight = lines is not None and replace(found, each_line=lines).straight
        seen = straight and lines is not None and abs(offset(lines.solution)[0]) < largest
    other = _fit(steps, c, wide) if seen else found
    return other if abs(offset(other.solution)[0]) < largest else found


def _outside(solution: Solution, limit: float) -> bool:
    """Whether the data want a zero of the pressures outside its limit."""
    return probability(*free_offset(solution), limit) < UNLIKELY


def offset(solution: Solution) -> tuple[float, float]:
    """Pressure difference without flow [Pa], and its standard deviation."""
    return solution.every.combination({"pressure_in": 1.0, "pressure_out": -1.0})


def free_offset(solution: Solution) -> tuple[float, float]:
    """`offset` by the data alone, without the priors of the two zeros."""
    normal, names = solution.normal, list(solution.every.names)
    k, other = (names.index(n) for n in PRESSURES)
    kept = np.arange(len(names)) != other  # both zeros have the same effect but for its sign
    alone = Normal(normal.columns[kept], np.where(np.arange(len(names)) == k, 0.0, normal.prior)[kept])
    e, row = solution.residual, k - (other < k)
    step = alone.step(e, solution.every.values[kept])
    left = e + step @ alone.columns
    scatter = max(1.0, float(left @ left) / max(solution.fit.freedom, 1))
    return offset(solution)[0] + float(step[row]), math.sqrt(alone.inverse[row, row] * scatter)


def _fit(steps: ValveSteps, c: Known, limits: Mapping[str, float]) -> ValveFit:
    freed: tuple[str, ...] = ()
    try:
        nodes = _nodes(steps, c, limits, freed, own=True)
    except Problem:  # residuals are too large without
        freed = ("lag",)
        nodes = _nodes(steps, c, limits, freed, own=True)
    solution = next(iter(nodes.values())).solution
    effects = _effects(solution, freed)
    freed += tuple(n for n, (value, sd) in effects.items() if probability(value, sd) < UNLIKELY)
    if freed:
        nodes = _nodes(steps, c, limits, freed, own=True)
        solution = next(iter(nodes.values())).solution
        effects = {**effects, **{n: (solution.fit[n], solution.fit.sd(n)) for n in freed}}
    scatter = solution.fit.times_noise if solution.fit.misfit else 1.0
    one = len(nodes) == 1
    pooled = next(iter(nodes.values())) if one else None
    if not one:
        with suppress(Problem):  # edges that differ much
            pooled = _nodes(steps, c, limits, freed, own=False)[""]
    lines = _lines(steps, c, limits, freed, scatter)
    line = lines if one or not lines else _lines(steps, c, limits, freed, scatter, lines)
    return ValveFit(steps, c, limits, nodes, pooled, lines, line, scatter, effects, freed)


def _effects(solution: Solution, freed: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Hysteresis, in the form that the residuals of the nodes show best, and drift, with each other free.

    Those that are estimated already are left out.
    """
    found = []
    for form in ("lag", "share"):
        names = [n for n in (form, "drift") if n not in freed and np.any(solution.column(n))]
        if not names or (freed and form == "share"):
            continue
        columns = np.array([solution.column(n) for n in names])
        values, covariance = solution.effects(columns)
        left = solution.residual + values @ columns
        pairs = zip(names, values, np.diag(covariance), strict=True)
        found.append((float(left @ left), {n: (float(v), math.sqrt(s)) for n, v, s in pairs}))
    return min(found, key=lambda tried: tried[0], default=(0.0, {}))[1]


def _grouped(steps: ValveSteps, own: bool) -> Iterator[tuple[str, ValveSteps]]:
    """The steps of each edge, or all together under the name ""."""
    yield from ((e, steps.of(e)) for e in steps.edges) if own else [("", steps)]


def _nodes(
    steps: ValveSteps, c: Known, limits: Mapping[str, float], freed: Sequence[str], *, own: bool
) -> dict[str, Nodes]:
    samples, start, commands = list[Samples](), dict[str, float](), dict[str, list[float]]()
    for label, group in _grouped(steps, own):
        shut = group[group.closed]
        if shut.drop.size:
            samples.append(shut.samples(c, "closed", {}))
        s = group[group.good]
        s = s[np.argsort(s.command, kind="stable")]
        area, first = s.effective(c), np.flatnonzero(np.diff(s.command) > SAME * c.full_command) + 1
        parts = np.split(np.arange(s.command.size), first)
        at, mean = (np.array([x[k].mean() for k in parts]) for x in (s.command, area))
        slopes = np.gradient(mean, at)
        commands[label] = at.tolist()
        for k, command, a, slope in zip(parts, at, mean, slopes, strict=True):
            name = f"area{label} {command:.4g} V"
            samples.append(s[k].samples(c, "node", {"area": name}, SHARP, slope, command))
            start[name] = float(a)
    start |= dict.fromkeys((*EFFECTS, LEAK), 0.0)
    tested = [n for n in EFFECTS if n not in freed]
    solution = balance.solve(samples, start, "valve", limits, tested, {LEAK: LEAK_SD})
    return {
        label: Nodes(np.array(at), tuple(f"area{label} {x:.4g} V" for x in at), solution)
        for label, at in commands.items()
    }


def _lines(
    steps: ValveSteps,
    c: Known,
    limits: Mapping[str, float],
    freed: Sequence[str],
    scatter: float,
    own: Lines | None = None,
) -> Lines | None:
    """A line for each edge, or with these one for all, at their roundings; None if they have no fit."""
    start, groups = dict[str, float](), list[tuple[str, ValveSteps]]()
    for label, group in _grouped(steps, own is None):
        s = group[group.good]
        slope, level = np.polyfit(s.command, s.effective(c), 1)
        start |= {f"slope{label}": float(slope), f"start{label}": float(-level / slope)}
        start |= {f"{n}{label}": 0.0 for n in ("square", "cube")}
        groups.append((label, group.read))
    start |= dict.fromkeys((*EFFECTS, LEAK), 0.0)
    tested = [n for n in start if n.startswith(("square", "cube")) or (n in EFFECTS and n not in freed)]
    value, sd = c.rounding.value, c.rounding.sd or c.rounding.value
    fits: dict[float, Solution] = {}
    shut = steps[steps.closed & steps.dead]  # tells the zero of the meter, not that the edge is closed

    def cost(width: float) -> float:
        """Minus twice the logarithm of the probability of a rounding."""
        if width not in fits:
            samples = [
                s.samples(c, "line", {n: f"{n}{label}" for n in OF_EDGE}, width) for label, s in groups
            ]
            if shut.flow.size:
                samples.append(shut.samples(c, "closed", {}))
            with suppress(Problem):  # a rounding that no line has
                fits[width] = balance.solve(samples, start, "valve", limits, tested, {LEAK: LEAK_SD})
        if width not in fits:
            return math.inf
        return fits[width].cost / scatter**2 + ((width - value) / sd) ** 2

    tried = np.unique(np.clip([*np.linspace(SHARP, WIDEST, WIDTHS), value], SHARP, WIDEST))
    if own:
        tried = own.widths[own.weights > UNLIKELY_WIDTH * own.weights.max()]
    elif c.rounding.sd:
        tried = np.linspace(max(value - 4 * sd, SHARP), value + 4 * sd, 2 * WIDTHS + 1)
    costs = np.array([cost(float(w)) for w in tried])
    for _ in range(ZOOMS if np.isfinite(costs.min()) else 0):
        likely = np.flatnonzero(costs < costs.min() - 2 * math.log(UNLIKELY_WIDTH))
        if own or c.rounding.sd or likely.size >= FEWEST_WIDTHS:
            break
        low, high = tried[max(likely[0] - 1, 0)], tried[min(likely[-1] + 1, tried.size - 1)]
        tried = np.linspace(low, high, WIDTHS // 2)
        costs = np.array([cost(float(w)) for w in tried])
    if not np.isfinite(costs.min()):
        return None
    weights = np.exp((costs.min() - costs) / 2) * _spacing(tried)
    tried, costs, weights = (x[np.isfinite(costs)] for x in (tried, costs, weights))
    solutions = [fits[float(w)] for w in tried]
    labels = tuple(label for label, _ in groups)
    best = int(np.argmin(costs))
    return Lines(labels, tried, weights / weights.sum(), solutions, best, value, min(sd, WIDEST / 4), scatter)


def require_nodes(steps: ValveSteps, c: Known, least: int) -> None:
    """Refuse edges with a flow at fewer voltages."""
    for edge in steps.edges:
        own = steps.of(edge)
        command = np.sort(own.command[own.good])
        voltages = int(np.count_nonzero(np.diff(command) > SAME * c.full_command)) + bool(command.size)
        if voltages < least:
            raise Problem(
                f"valve {edge}: expected flow at {least} voltages or more, got {voltages}; left "
                f"out of {own.command.size} steps: {own.omissions() or 'none'}"
            )
