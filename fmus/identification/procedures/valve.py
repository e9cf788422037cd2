"""Valve procedure (section 4(a), Fig. 5): areas of the metering edges over the command.

    C_R = (P_in - P_out)/(Q|Q|), eq. (1)        C_R = rho/(2 C_d^2 A(V)^2), eq. (2)

The data are means over each step with their standard errors. The steps of all edges are samples of one law of
`balance`, with the flow q of `orifice.Edge` at the effective area A:

    Q - L = q(A, dp)        L = G dp - G (dp_s - dp)        A = (a_i + k_i (x - V_i)) (1 + drift t)

a_i is the unknown area at each command V_i, k_i the known slope between its neighbours, L the leakage
(coefficient G) of the open edge minus that of the closed edge at the same port, which has the rest of the
pressure drop dp_s from supply to tank. x = V - s lag/2 is the position of a spool with hysteresis, s = 1
after a rising command and -1 after a falling one; t is the time or the temperature. Lag and drift are tested,
and estimated with the areas where they are significant. The zeros of the three sensors are unknowns, too, and
the leakage, which is assumed, not measured (prior: the known one, with a standard deviation as large).

A straight line is this law with fewer unknowns, the opening of `components.spool_valve`:

    A = k ramp(x - V_t + w/2, w) (1 + drift t)        dead band V_t - w/2, rounding w

If chi-square against the free areas does not refute it, it is the result. Otherwise a table of up to nine of
the areas is. Both are those of all edges together unless these differ. The flow hardly tells w apart from a
dead band, so their intervals are those of the profile likelihood over all w with a dead band above zero. w is
as known if the data allow it, else sharp if they allow that.

Validity: steady flow above the dead zone of the meter; leakage below a tenth of it. Only the product
C_d A sqrt(2/rho) is measured: the area is valid for the known C_d and the density, which is that of the
recording if it has one. No interval covers commands between those of a table.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np
from scipy import optimize, stats
from scipy.interpolate import PchipInterpolator

from fmus.components.chamber import Liquid
from fmus.components.opening_curve import POINTS
from fmus.components.orifice import Edge
from fmus.identification import balance
from fmus.identification.balance import SMALLEST, UNLIKELY, Law, Samples, Solution, probability
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures.experiment_data import SETTLING_TIME, SHORTEST_STEP, Means
from fmus.identification.procedures.procedure import Computed, misfit
from fmus.identification.recordings.masks import MIN_GOOD, in_dead_zone, steady
from fmus.identification.results import (
    BAR,
    LITRES_PER_MINUTE,
    Curve,
    Estimate,
    Finding,
    Panel,
    ProcedureResult,
    coverage_factor,
)
from fmus.parameters import Number
from fmus.smooth import ramp
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Mask, Recording
from orchestrator.data.table import Array

READ = {"pressure_in": "Pa", "pressure_out": "Pa", "flow": "m3/s"}
SIGNALS: Mapping[str, str] = {"command": "V", **READ}
VOLTAGES = (1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 10.0)  # V, at which C_R is reported
REAL = 0.01, 1.5  # full commands, between which the largest command of a bench is
MIN_VOLTAGES = 3  # different commands at which the flow must be measured
# sign of the command that opens each edge, correction E7 in docs/equations.md
COMMAND_SIGN = {"P-A": 1, "B-T": 1, "P-B": -1, "A-T": -1}
SAME_WAY = {"P-A": "B-T", "B-T": "P-A", "P-B": "A-T", "A-T": "P-B"}  # edges that one direction opens
OTHER_SIZE = 3.0  # times the known area: a wrong unit is more likely than such a valve
SAME_OIL = 0.01  # relative difference of two densities of one oil
SAME = 2e-3  # of the full command: steps that are closer have one command
CERTAIN = 4.0  # standard errors above which a flow is certain
SHARP, WIDTHS = 1e-3, 17  # V, the shortest rounding that the machine reads; number of roundings of a profile
EXPONENTS = 0.7, 3.0, 231  # of an opening where it begins: a step begins below, a rounding ends with 3
FURTHER = 10.0  # limits of a zero up to which it may be a fault of a sensor
COMMAND, RESISTANCE = "command [V]", "C_R [Pa.s2/m6]"  # labels of axes
PRESSURES = ("pressure_in", "pressure_out")
CHANNELS = (*PRESSURES, "flow", "command", "supply drop", "change", "course", "density", "viscosity")
EFFECTS, LINE = ("lag", "drift"), ("slope", "start")  # unknowns of all edges, and of one straight opening
LEAK, LEAK_SD = "leak", 1.0  # of the leakage over the known one, less one: it is assumed, not measured
FINE, DRAWN = 1000, 96  # roundings between those of a profile, and commands at which an opening is drawn
FACTOR = coverage_factor()
Test = tuple[float, str]  # probability and sentence of a finding
Solve = Callable[..., Solution]  # (samples, start, *unknowns that are held) -> the fit of all samples


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
        valve = {name: data.parameter_value(parameters, f"boom_stick.valve_{name}") for name in names}
        rounding = data.parameter(parameters, "boom_stick.valve_command_rounding")
        oil = {n: data.parameter_value(parameters, f"boom_stick.{n}") for n in ("density", "viscosity")}
        return cls(**valve, **oil, rounding=rounding)

    def resistance(self, area: Array) -> Array:
        """C_R [Pa.s2/m6] of effective areas [m2] by eq. (2); infinite if the edge is closed."""
        square = 2 * (self.discharge_coefficient * area) ** 2 / self.density
        return np.divide(1.0, square, out=np.full_like(square, np.inf), where=square > 0)


@lru_cache(maxsize=1)
def laws() -> Mapping[str, Law]:
    """The laws of a closed edge, of the area at a command, and of a straight line."""
    z, known = ca.SX.sym("z", len(CHANNELS)), ca.SX.sym("known", 5)
    p_in, p_out, flow, command, supply_drop, change, course, density, viscosity = ca.vertsplit(z)
    coefficient, reynolds, leakage, slope, at = ca.vertsplit(known)
    u = {name: ca.SX.sym(name) for name in ("area", *LINE, "rounding", *EFFECTS, LEAK)}
    x, drop = command - u["lag"] * change / 2, p_in - p_out
    edge = Edge(discharge_coefficient=coefficient, transition_reynolds=reynolds)
    oil = Liquid(density=density, viscosity=viscosity)

    def law(area: ca.SX, *names: str) -> Law:
        through = edge.flow(area * (1 + u["drift"] * course), drop, oil)
        balanced = flow - leakage * (1 + u[LEAK]) * (2 * drop - supply_drop) - through
        return balance.law(z, {n: u[n] for n in (*names, *EFFECTS, LEAK)}, known, balanced)

    width = ca.fmax(u["rounding"], SHARP)
    return {
        "closed": law(ca.SX(0.0)),
        "node": law(u["area"] + slope * (x - at), "area"),
        "line": law(u["slope"] * ramp(x - u["start"] + width / 2, width), *LINE, "rounding"),
    }


def identify(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ProcedureResult:
    """Area, dead band and rounding or table of the valve's edges, and C_R over the command."""
    tests = data.training_recordings(recordings, "valve", SIGNALS)
    found = identify_openings(tests, parameters)
    zero = data.pressure_offset(found.solution)
    return ProcedureResult(
        procedure="valve",
        title="Valve: C_R of the metering edges over the command",
        figure=5,
        estimates=tuple(_estimates(found)),
        panels=panels(found),
        remarks=tuple(_remarks(found, zero)),
        others=(*_resistances(found), zero, *_others(found)),
        findings=tuple(_findings(tests, found, parameters)),
        listed=tuple(_tables(found, parameters)),
    )


def identify_openings(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ValveFit:
    """The openings of the edges."""
    tests = data.training_recordings(recordings, "valve", SIGNALS)
    c = Known.of(parameters)
    steps = data.concatenate([_steps_of(r, c) for r in tests])
    steps = data.concatenate([_classified(steps.of(e), c) for e in steps.edges])
    steps = steps[(steps.command > SAME * c.full_command) | steps.closed]
    for edge in steps.edges:
        own = steps.of(edge)
        if (voltages := len(own.grouped(c))) < MIN_VOLTAGES:
            raise Problem(
                f"valve {edge}: expected flow at {MIN_VOLTAGES} voltages or more, got {voltages}; left "
                f"out of {own.command.size} steps: {own.omissions() or 'none'}"
            )
    limits = data.zero_limits(tests, PRESSURES) | data.declared_limits(tests, ["flow"])
    if (shut := steps[steps.closed]).flow.size:  # which show the zero: it is free
        seen = np.abs(shut.flow) + CERTAIN * shut.flow_error
        limits["flow"] = max(limits.get("flow", 0.0), 2 * float(seen.max()))
    return fit(steps, c, limits)


# ---- steps -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ValveSteps(Means):
    """Means over the steps of one or several edges, of the signals `READ`.

    along                    oil temperature, or time from the start, from its mean, over its range
    command, command_error   magnitude [V] and its standard error
    supply_drop              pressure drop from supply to tank [Pa]: the largest over an edge, nearly closed
    change                   1 if the command was lower before, -1 if it was higher, 0 for the first step
    density, viscosity       of the tested oil [kg/m3], [Pa.s]
    edge                     "P-A", "P-B", "A-T" or "B-T"
    closed                   a closed edge: its reading is the zero of the flow meter and the leakage
    idle_flow                flow [m3/s] that the reading allows at most, if a flow is not certain; else NaN
    """

    command: Array
    command_error: Array
    supply_drop: Array
    change: Array
    density: Array
    viscosity: Array
    edge: Array
    closed: Mask
    idle_flow: Array

    @property
    def drop(self) -> Array:
        """Pressure drop [Pa]."""
        return np.asarray(self.means[0] - self.means[1])

    @property
    def flow(self) -> Array:
        """Flow [m3/s]."""
        return np.asarray(self.means[2])

    @property
    def flow_error(self) -> Array:
        """Standard error of the flow [m3/s]."""
        return np.asarray(self.errors[2])

    @property
    def edges(self) -> tuple[str, ...]:
        """The edges, in the order of the recordings."""
        return tuple(dict.fromkeys(map(str, self.edge)))

    def of(self, edge: str) -> ValveSteps:
        """The steps of one edge; of all for the name ""."""
        return self[self.edge == edge] if edge else self

    def grouped(self, c: Known) -> list[ValveSteps]:
        """The steps with a flow, those with one command together; commands ascend."""
        s = self[self.good]
        s = s[np.argsort(s.command, kind="stable")]
        ends = np.flatnonzero(np.diff(s.command) > SAME * c.full_command) + 1
        return [s[rows] for rows in np.split(np.arange(s.command.size), ends) if rows.size]

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

    def idle(self, c: Known) -> tuple[Array, Array]:
        """Commands of steps whose flow is not told from zero, and the largest areas that read so."""
        shut = self[~self.good & np.isfinite(self.idle_flow)]
        most = np.array([*shut.means[:2], np.sign(shut.drop) * shut.idle_flow])
        return shut.command, replace(shut, means=most).effective(c)

    def samples(
        self, c: Known, law: str, names: Mapping[str, str], slope: float = 0.0, at: float = 0.0
    ) -> Samples:
        """The steps in one of the laws; names: those of its unknowns among the unknowns of all steps."""
        others = self.supply_drop, self.change, self.along, self.density, self.viscosity
        raw = np.array([*self.means, self.command, *others])
        noise = [*self.errors, self.command_error, *np.zeros_like(others)]
        known = c.discharge_coefficient, c.transition_reynolds, c.leakage, slope, at
        found = balance.samples_of(laws()[law], CHANNELS, raw, np.array(noise), known)
        return replace(found, names=tuple(names.get(n, n) for n in found.names))


def _stretches(recording: Recording, c: Known) -> tuple[str, Array, list[slice]]:
    """The edge, its opening command [V] and the steps in which it is held, also those at zero."""
    edge, samples = data.condition(recording, "edge", COMMAND_SIGN), recording["command"]
    largest, full = float(np.nanmax(np.abs(samples))), c.full_command
    if not REAL[0] * full < largest < REAL[1] * full:  # such as mV taken as V
        expected = f"expected a full command of about {full:g} V, got {largest:g} V: is its unit right?"
        raise Problem(f"{recording.source}: command: {expected}")
    command = COMMAND_SIGN[edge] * recording.interpolated("command")  # a missing sample does not end a step
    if not (command > 0).any():
        expected = "positive" if COMMAND_SIGN[edge] > 0 else "negative"
        raise Problem(f"{recording.source}: command: expected {expected} values, which open {edge}, got none")
    gapless = replace(recording, signals={**recording.signals, "command": command})
    stretches = steady(gapless, "command", SETTLING_TIME, SHORTEST_STEP)
    steps = [step for step in stretches if command[step.start] > -SAME * full]
    if not steps:
        expected = (
            f"expected commands that are held for {SETTLING_TIME + SHORTEST_STEP:g} s or longer, got none"
        )
        raise Problem(f"{recording.source}: {expected}")
    return edge, command, steps


def _steps_of(recording: Recording, c: Known) -> ValveSteps:
    """All steps of a recording; a reading in the dead zone of the meter is one, too."""
    edge, command, steps = _stretches(recording, c)
    # samples would look stuck with a noise that is much too large, a dead zone certain with one too small
    scatter, sensors = _scatter(recording, c), dict(recording.sensors)
    for name in READ:
        sensors[name] = replace(recording.sensor(name), noise=data.noise_sd(scatter, name))
    recording = replace(recording, sensors=sensors)
    means, meter = data.means_over(recording, READ, steps), recording.sensor("flow")
    drop, flow = means.means[0] - means.means[1], means.means[2]
    highest = (np.sign(drop) * flow + CERTAIN * means.errors[2])[means.good]  # along the drop
    wrong_way = int(np.count_nonzero(highest < 0))
    if wrong_way > highest.size / 2:
        raise Problem(
            f"{recording.source}: flow: expected a flow from the higher to the lower pressure, got the "
            f"opposite direction in {wrong_way} of {highest.size} steps: change the sign of the flow, "
            "or exchange pressure_in and pressure_out"
        )
    middle = np.array([command[step].mean() for step in steps])
    size = np.sqrt([step.stop - step.start for step in steps])
    oil = {n: data.stated(recording, n) or getattr(c, n) for n in ("density", "viscosity")}
    largest = drop[np.nanargmax(np.abs(drop))] if np.isfinite(drop).any() else 0.0
    errors, in_dead = means.errors.copy(), np.array([np.nanstd(recording["flow"][step]) for step in steps])
    errors[2, means.dead] = np.maximum(in_dead / size, meter.resolution / 12**0.5)[means.dead]
    if means.good.any():  # of few samples, an error is too small by chance
        usual = np.median(errors[:, means.good], axis=1, keepdims=True)
        errors[:, means.good] = np.maximum(errors[:, means.good], usual)
    along = (means.along - means.along.mean()) / (float(np.ptp(means.along)) or 1.0)
    return ValveSteps(
        **vars(means) | {"errors": errors, "along": along},
        command=np.abs(middle),
        command_error=np.array([command[step].std() for step in steps]) / size,
        supply_drop=np.full(len(steps), largest),
        change=np.sign(np.diff(middle, prepend=middle[:1])),
        **{n: np.full(len(steps), value) for n, value in oil.items()},
        edge=np.full(len(steps), edge),
        closed=np.zeros(len(steps), dtype=bool),
        idle_flow=np.where(means.dead, meter.dead_zone + CERTAIN * meter.noise, np.nan),
    )


def _scatter(recording: Recording, c: Known) -> Recording:
    """The recording less its means over the steps; gaps elsewhere, and in the dead zone of the meter."""
    signals, sensors = dict(recording.signals), dict(recording.sensors)
    steps = _stretches(recording, c)[2]
    for name in READ:
        sensor = recording.sensor(name)
        read = np.where(in_dead_zone(recording[name], sensor), np.nan, recording[name])
        signals[name], sensors[name] = np.full_like(read, np.nan), replace(sensor, dead_zone=0.0)
        for step in steps:
            if np.isfinite(read[step]).mean() >= MIN_GOOD:
                signals[name][step] = read[step] - np.nanmean(read[step])
    return replace(recording, signals=signals, sensors=sensors)


def _classified(steps: ValveSteps, c: Known) -> ValveSteps:
    """Good steps are those with a certain flow; the others bound the opening."""
    closed, zero = _closed(steps, c)
    along = np.sign(steps.drop) * (steps.flow - zero)
    leak = c.leakage * np.abs(2 * steps.drop - steps.supply_drop)
    certain = along - leak > CERTAIN * steps.flow_error
    most = np.maximum(along, 0.0) + CERTAIN * steps.flow_error
    idle = np.where(steps.good & ~certain, most, steps.idle_flow)
    idle = np.where(steps.command > SAME * c.full_command, idle, np.nan)
    good = steps.good & certain & ~closed & (steps.command > SAME * c.full_command)
    return replace(steps, good=good, closed=closed, idle_flow=idle)


def _closed(steps: ValveSteps, c: Known) -> tuple[Mask, float]:
    """Steps of a closed edge, whose readings no command changes, and their mean [m3/s].

    None if less than two commands have it, or a meter in its dead zone shows nothing.
    """
    usable = np.isfinite(steps.flow + steps.drop) & (steps.flow_error > 0) & (steps.good | steps.dead)
    order = np.flatnonzero(usable)[np.argsort(steps.command[usable], kind="stable")]
    s, closed, zero = steps[order], np.zeros(steps.flow.size, dtype=bool), 0.0
    flow = s.flow - c.leakage * (2 * s.drop - s.supply_drop)
    last = np.flatnonzero(np.diff(s.command) > SAME * c.full_command)  # of each command but the highest
    for k in last + 1:
        weight = s.flow_error[:k] ** -2.0
        mean = float(np.average(flow[:k], weights=weight))
        if stats.chi2.sf(float(weight @ (flow[:k] - mean) ** 2), k - 1) < UNLIKELY:
            break
        if k > last[0] + 1 and s.flow[:k].any():
            closed, zero = np.isin(np.arange(steps.flow.size), order[:k]), mean
    return closed, zero


# ---- openings ----------------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def _ramp() -> ca.Function:
    """(command; slope, start, rounding) -> area of a straight opening, and its derivatives by these."""
    command, theta = ca.SX.sym("command"), ca.SX.sym("theta", 3)
    slope, start, width = ca.vertsplit(theta)
    area = slope * ramp(command - start + width / 2, width)
    return ca.Function("ramp", [command, theta], [area, ca.densify(ca.jacobian(area, theta).T)])


@dataclass(frozen=True)
class Table:
    """The opening as the machine reads it: a monotone cubic through at most nine of the measured commands.

    It is fitted to all measured areas.

    start     of the opening [V]
    command   of the nodes [V], ascending; the last one is full command
    areas     at these [m2], with pointwise 95 % intervals; open at a full command that was not measured
    p         probability of residuals as large if the curve can follow the areas
    off       largest of these over the last area, and its command
    """

    start: float
    command: Array
    areas: Sequence[Estimate]
    p: float
    off: tuple[float, float]

    def drawn(self, command: Array) -> Array:
        """Areas [m2] as the machine has them, at commands (n,)."""
        return _cubic(self.start, self.command, np.array([e.value for e in self.areas]), command)


def _cubic(start: float, nodes: Array, areas: Array, command: Array) -> Array:
    """As in the machine: a monotone cubic, zero up to the start, constant above the last node.

    Its slope begins with zero, here by a further point before the start.
    """
    before = 2 * start - nodes[0]
    cubic = PchipInterpolator([before, start, *nodes], [0.0, 0.0, *areas])
    return np.asarray(np.where(command <= start, 0.0, cubic(np.clip(command, before, nodes[-1]))))


def _kept(start: float, command: Array, area: Array, noise: Array, most: int) -> list[int]:
    """Indices of at most so many nodes: one by one that is left out which costs the least chi-square."""
    kept = [*range(area.size)]
    while len(kept) > most:
        fewer = [kept[:k] + kept[k + 1 :] for k in range(len(kept) - 1)]
        off = [((_cubic(start, command[n], area[n], command) - area) / noise) ** 2 for n in fewer]
        kept = fewer[int(np.argmin(np.sum(off, axis=1)))]
    return kept


@dataclass(frozen=True)
class Opening:
    """Areas of an edge where a flow was measured: free ones, or those of a straight line.

    command      [V], shape (m,), ascending
    area         at these [m2], with their covariance, and the noise that they do not have in common
    start        of the opening [V]
    zero         command at which the line, or that through the lowest two areas, is zero [V]; its sd
    full_command   [V]
    drift        relative change of the areas over the experiment: the machine may be as warm as at either end
    line         slope, start, rounding of a straight line and their covariance; None for free areas
    rounding     of its start [V], if that is not the known one
    """

    command: Array
    area: Array
    covariance: Array
    noise: Array
    start: Estimate
    zero: tuple[float, float]
    full_command: float
    drift: float = 0.0
    line: tuple[Array, Array] | None = None
    rounding: Estimate | None = None

    @property
    def sd(self) -> Array:
        """Standard deviations of the areas [m2]."""
        return np.sqrt(np.diag(self.covariance))

    @cached_property
    def areas(self) -> Sequence[Estimate]:
        """The areas with pointwise 95 % intervals."""
        return [self._estimate(*both) for both in zip(self.area, self.sd, strict=True)]

    def _estimate(self, area: float, sd: float) -> Estimate:
        e = Estimate.normal("", float(area), "m2", float(sd), "")
        return replace(e, low=e.low - self.drift * e.value, high=e.high + self.drift * e.value)

    @property
    def reached(self) -> bool:
        """Whether a flow was measured at full command."""
        return bool(self.command[-1] >= self.full_command * (1 - SAME))

    @property
    def full(self) -> Estimate:
        """Area at full command [m2]."""
        on_line = self.line and self.reached
        return self._estimate(*self.near(self.full_command)) if on_line else self.table.areas[-1]

    @cached_property
    def table(self) -> Table:
        """The curve whose squares of (curve - area) / noise are least; it does not fall."""
        v, area, start, size = self.command, self.area, self.start.value, self.area[-1]
        kept = _kept(start, v, area, self.noise, POINTS - 1 - (not self.reached))
        first, nodes = np.maximum(np.diff(area[kept], prepend=0.0), 0.0) / size, v[kept]

        def residual(rises: Array) -> Array:
            return np.asarray((_cubic(start, nodes, np.cumsum(rises) * size, v) - area) / self.noise)

        found: Any = optimize.least_squares(residual, first + SMALLEST, bounds=(0.0, np.inf), x_scale="jac")
        off, freedom = found.fun * self.noise, area.size - len(kept)
        by_area = np.tri(len(kept)) @ np.linalg.pinv(found.jac / size) / self.noise
        # what the curve cannot follow is an error, too
        sds = np.sqrt(np.diag(by_area @ (self.covariance + np.diag(off**2)) @ by_area.T))
        areas = [self._estimate(*both) for both in zip(np.cumsum(found.x) * size, sds, strict=True)]
        if not self.reached:  # to full command leads the last chord of the areas; its upper end is open
            slope = (size - area[-2]) / float(v[-1] - v[-2])
            value = max(float(size + slope * (self.full_command - v[-1])), areas[-1].value)
            nodes, areas = np.append(nodes, self.full_command), [*areas, replace(areas[-1], value=value)]
            areas[-1] = replace(areas[-1], high=math.inf)
        worst = int(np.abs(off).argmax())
        p = float(stats.chi2.sf(2 * found.cost, freedom)) if freedom else 1.0
        return Table(start, nodes, areas, p, (float(abs(off[worst] / size)), float(v[worst])))

    def on_line(self, command: Array) -> tuple[Array, Array]:
        """Areas of the straight line at commands, and their covariance."""
        assert self.line
        (area,), by_line = balance.evaluated(_ramp(), command[None], self.line[0])
        return area, by_line.T @ self.line[1] @ by_line

    def near(self, command: float) -> tuple[float, float]:
        """Area and its standard deviation at a command; below the lowest free area nothing is known."""
        if self.line:
            (area,), ((variance,),) = self.on_line(np.array([command]))
            return float(area), math.sqrt(variance)
        area, sd = (float(np.interp(command, self.command, x, left=0.0)) for x in (self.area, self.sd))
        return area, sd

    def at(self, command: float) -> Estimate | None:
        """Area where it is known: between the measured commands for a line, else at these."""
        k = int(np.argmin(np.abs(self.command - command)))
        if abs(self.command[k] - command) <= SAME * self.command[-1]:
            return self.areas[k]
        inside = self.line and self.command[0] < command < self.command[-1]
        return self._estimate(*self.near(command)) if inside else None

    def drawn(self, command: Array) -> Array:
        """Areas [m2] as the machine has them, at commands (n,)."""
        return self.on_line(command)[0] if self.line else self.table.drawn(command)

    def falling(self) -> tuple[float, float]:
        """Probability that a rising opening falls as much between any two nodes; largest fall in parts."""
        first, second = np.triu_indices(self.area.size, 1)
        fall, variance = self.area[first] - self.area[second], np.diag(self.covariance)
        sd = np.sqrt(variance[first] + variance[second] - 2 * self.covariance[first, second])
        p = min(1.0, fall.size * float(stats.norm.sf(np.max(fall / sd))))
        return p, float(np.max(1 - self.area / np.maximum.accumulate(self.area)))


def free_opening(
    steps: ValveSteps, c: Known, solution: Solution, command: Array, names: list[str]
) -> Opening:
    """The opening with free areas, unknowns of a fit.

    It begins where the power (V - V_0)^n through the lowest three areas does: anywhere below the first area,
    but not before the last command but one that has no flow.
    """
    fitted, inside = solution.fit, command < c.full_command * (1 + SAME)
    rows, v = [fitted.names.index(n) for n in np.array(names)[inside]], command[inside]
    area, covariance = fitted.values[rows], fitted.covariance[np.ix_(rows, rows)]
    scatter = max(1.0, fitted.times_noise) if fitted.misfit else 1.0
    noise = scatter / np.array([np.linalg.norm(solution.column(fitted.names[k])) for k in rows])
    n = np.linspace(*EXPONENTS)
    roots = area[:3, None] ** (1 / n)
    slope = np.diff(roots, axis=0) / np.diff(v[:3])[:, None]
    k = int(np.argmin(np.abs(slope[1] / slope[0] - 1)))
    # a meter in its dead zone does not tell that the edge is closed
    shut = np.unique(np.round(steps.command[steps.closed & ~steps.dead & (steps.command < v[0])], 2))
    low = float(shut[-2]) if len(shut) > 1 else 0.0
    value = min(max(float(v[0] - roots[0, k] / slope[0, k]), low), float(v[0]) - SHARP)
    start = Estimate("", value, "V", float(v[0] - low) / 12**0.5, low, float(v[0]), "")
    length = (v[1] - v[0]) / (area[1] - area[0])
    sd = length * np.hypot(math.sqrt(covariance[0, 0]), math.sqrt(covariance[1, 1]) * area[0] / area[1])
    zero = float(v[0] - area[0] * length), float(sd)
    return Opening(v, area, covariance, noise, start, zero, c.full_command, _drift(solution))


def straight_opening(
    steps: ValveSteps, c: Known, solution: Solution, label: str, rounding: Estimate, note: str = ""
) -> Opening:
    """The opening on a line; its dead band holds each rounding that the data allow.

    note   if the rounding is the known one, and the data do not tell it
    """
    fitted, names = solution.fit, [f"{n}{label}" for n in LINE]
    told = "rounding" in fitted.names  # an unknown of the fit, else it is independent
    rows = [fitted.names.index(n) for n in (*names, *(["rounding"] * told))]
    covariance, by_line = np.zeros((3, 3)), np.array([0.0, 1.0, -0.5])
    covariance[: len(rows), : len(rows)] = fitted.covariance[np.ix_(rows, rows)]
    half = FACTOR * math.sqrt(by_line @ covariance @ by_line)
    if not told:
        covariance[2, 2] = rounding.sd**2
    w, (slope, zero) = rounding.value, (fitted[n] for n in names)
    shortest, longest = (w, w) if told else (rounding.low, rounding.high)
    ends = (max(x, 0.0) for x in (zero - w / 2, zero - longest / 2 - half, zero - shortest / 2 + half))
    middle, low, high = ends
    start = Estimate("", middle, "V", math.sqrt(by_line @ covariance @ by_line), low, high, note)
    command = np.array([s.command.mean() for s in steps.grouped(c)])
    command, nothing = command[command < c.full_command * (1 + SAME)], np.empty(0)
    opening = Opening(
        *(command, nothing, nothing, nothing, start, (zero, fitted.sd(names[1])), c.full_command),
        drift=_drift(solution),
        line=(np.array([slope, zero, w]), covariance),
        rounding=None if note else rounding,
    )
    area, of_areas = opening.on_line(command)
    return replace(opening, area=area, covariance=of_areas, noise=np.full(area.size, SMALLEST * area[-1]))


def _drift(solution: Solution) -> float:
    """Relative change of the areas over the experiment, if that is estimated."""
    return abs(solution.fit["drift"]) if "drift" in solution.fit.names else 0.0


# ---- fits --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Openings:
    """Openings of one form, free areas or straight lines, by edge; one of all edges has the label "".

    cost   chi-square of the best rounding, with the zeros
    """

    solution: Solution
    cost: float
    of: Mapping[str, Opening]


@dataclass(frozen=True)
class ValveFit:
    """Fits of the steps of all edges: free areas, and straight lines.

    nodes      free areas of each edge
    pooled     free areas of all edges together; None if there is no fit, as the following
    lines      a straight line for each edge
    line       one line for all edges
    scatter    residuals over the noise that steps with one command have, 1 unless it is significantly more
    effects    lag [V] and drift [1], and their standard deviations
    freed      those of them that are estimated with the openings
    """

    steps: ValveSteps
    known: Known
    limits: Mapping[str, float]
    nodes: Openings
    pooled: Openings | None
    lines: Openings | None
    line: Openings | None
    scatter: float
    effects: Mapping[str, tuple[float, float]]
    freed: tuple[str, ...]

    def _chance(self, fewer: Openings | None, more: Openings) -> float:
        """Probability of a chi-square that is larger by as much for fewer unknowns; 0 if they have no fit."""
        if not fewer:
            return 0.0
        terms = fewer.solution.fit.freedom - more.solution.fit.freedom
        return float(stats.chi2.sf(max(fewer.cost - more.cost, 0.0) / self.scatter**2, max(terms, 1)))

    @cached_property
    def p(self) -> float:
        """Probability that all openings are straight lines, by chi-square against the free areas."""
        return self._chance(self.lines, self.nodes)

    @property
    def straight(self) -> Openings | None:
        """A straight line for each edge, if that suffices."""
        return self.lines if self.p >= UNLIKELY else None

    @property
    def each(self) -> Openings:
        """Those of each edge: straight lines, or free areas."""
        return self.straight or self.nodes

    @cached_property
    def equal(self) -> float:
        """Probability that equal edges differ as much."""
        return self._chance(self.line if self.straight else self.pooled, self.each)

    @cached_property
    def common(self) -> Opening | None:
        """One straight line for all edges, if that suffices; the machine has none that begins below zero."""
        if not (self.straight and self.line and self.equal > UNLIKELY):
            return None
        zero, sd = self.line.of[""].zero
        return self.line.of[""] if zero > -CERTAIN * sd else None

    @property
    def solution(self) -> Solution:
        """The fit whose zeros and residuals are those of the procedure."""
        return self.each.solution

    @cached_property
    def corrected(self) -> ValveSteps:
        """The steps without the zero of the pressures, at the commands that they would have without a lag."""
        lag = self.effects["lag"][0] if "lag" in self.freed else 0.0
        command = np.maximum(self.steps.command - lag * self.steps.change / 2, 0.0)
        zeros = np.array([[data.pressure_offset(self.solution).value], [0.0], [0.0]])
        return replace(self.steps, means=self.steps.means - zeros, command=command)

    @cached_property
    def openings(self) -> Mapping[str, Opening]:
        """Edge -> its opening; the same object for equal edges."""
        together = self.common
        if self.pooled and not self.straight and self.equal > UNLIKELY:
            together = self.pooled.of[""]
        return dict.fromkeys(self.nodes.of, together) if together else self.each.of

    @property
    def distinct(self) -> Mapping[str, Opening]:
        """The openings without repetitions: of one only the name is ""."""
        return self.openings if len(set(map(id, self.openings.values()))) > 1 else {"": self.widest}

    @property
    def widest(self) -> Opening:
        """That of the edge that opens furthest."""
        return max(self.openings.values(), key=lambda opening: opening.full.value)


def fit(steps: ValveSteps, c: Known, limits: Mapping[str, float]) -> ValveFit:
    """Areas and lines of all edges; limits: largest zeros of the sensors.

    A zero of the pressures far outside its limit is taken where the data contradict all zeros within: steps
    with one command at several pressures, or a straight line, which bends with a zero.
    """
    near = None
    with suppress(Problem):
        near = _fit(steps, c, limits)
    limit = sum(limits[n] for n in PRESSURES)
    outside = near is not None and probability(*free_offset(near.solution), limit) < UNLIKELY
    if near and near.straight and not outside:
        return near
    far = _fit(steps, c, {n: x * FURTHER ** (n in PRESSURES) for n, x in limits.items()})
    within = abs(data.pressure_offset(far.solution).value) < FURTHER * limit
    return far if near is None or (within and (outside or far.straight)) else near


def free_offset(solution: Solution) -> tuple[float, float]:
    """`offset` by the data alone, without the priors of the two zeros."""
    # both zeros have the same effect but for its sign
    change, sd = solution.free(PRESSURES[0], PRESSURES[1:])
    return data.pressure_offset(solution).value + change, sd


def _fit(steps: ValveSteps, c: Known, limits: Mapping[str, float]) -> ValveFit:
    freed, each, effects = tuple[str, ...](), steps.edges, dict[str, tuple[float, float]]()

    def solved(samples: Sequence[Samples], start: Mapping[str, float], *held: str) -> Solution:
        start = {**start, **dict.fromkeys((*EFFECTS, LEAK), 0.0)}
        tested = [*held, *(n for n in EFFECTS if n not in freed)]
        return balance.solve(samples, start, "valve", limits, tested, {LEAK: LEAK_SD})

    try:
        nodes = _nodes(steps, c, solved, each)
    except Problem:  # residuals are too large without
        freed = ("lag",)
        nodes = _nodes(steps, c, solved, each)
    column = nodes.solution.column
    # hysteresis and drift, with each other free
    if tested := [n for n in EFFECTS if n not in freed and np.any(column(n))]:
        values, covariance = nodes.solution.effects(np.array([column(n) for n in tested]))
        pairs = zip(map(float, values), map(float, np.sqrt(np.diag(covariance))), strict=True)
        effects = dict(zip(tested, pairs, strict=True))
    freed += tuple(n for n, (value, sd) in effects.items() if probability(value, sd) < UNLIKELY)
    if freed:
        nodes = _nodes(steps, c, solved, each)
    fitted, pooled = nodes.solution.fit, None
    effects |= {n: (fitted[n], fitted.sd(n)) for n in freed}
    with suppress(Problem):  # edges that differ much
        alone = len(each) == 1
        pooled = replace(nodes, of={"": nodes.of[each[0]]}) if alone else _nodes(steps, c, solved, ("",))
    scatter = fitted.times_noise if fitted.misfit else 1.0
    lines, line = (_lines(steps, c, solved, scatter, labels) for labels in (each, ("",)))
    return ValveFit(steps, c, limits, nodes, pooled, lines, line, scatter, effects, freed)


def _nodes(steps: ValveSteps, c: Known, solved: Solve, labels: Sequence[str]) -> Openings:
    """Free areas of each edge, or of all together for the label ""."""
    samples, start, own = list[Samples](), dict[str, float](), dict[str, tuple[Array, list[str]]]()
    for edge in labels:
        groups = steps.of(edge).grouped(c)
        at, mean = np.array([(s.command.mean(), s.effective(c).mean()) for s in groups]).T
        own[edge] = at, [f"area{edge} {x:.4g} V" for x in at]
        start |= dict(zip(own[edge][1], mean, strict=True))
        each = zip(groups, own[edge][1], np.gradient(mean, at), at, strict=True)
        samples += [s.samples(c, "node", {"area": name}, slope, x) for s, name, slope, x in each]
    if (shut := steps[steps.closed]).drop.size:
        samples.append(shut.samples(c, "closed", {}))
    solution = solved(samples, start)
    found = {edge: free_opening(steps.of(edge), c, solution, *nodes) for edge, nodes in own.items()}
    return Openings(solution, solution.cost, found)


def _lines(
    steps: ValveSteps, c: Known, solved: Solve, scatter: float, labels: Sequence[str]
) -> Openings | None:
    """A line for each edge, or one for all for the label "", with its rounding; None if there is no fit."""
    samples, start = list[Samples](), dict[str, float]()
    read = np.isfinite(steps.errors).all(axis=0) & ~steps.dead & ~steps.clipped
    for label in labels:
        s, names = steps[read].of(label), {n: f"{n}{label}" for n in LINE}
        samples.append(s.samples(c, "line", names))
        slope, level = np.polyfit(s.command[s.good], s[s.good].effective(c), 1)
        start |= dict(zip(names.values(), (float(slope), float(-level / slope)), strict=True))
    shut = steps[steps.closed & steps.dead]  # tells the zero of the meter, not that the edge is closed
    if shut.flow.size:
        samples.append(shut.samples(c, "closed", {}))

    def at(width: float, *held: str) -> Solution | None:
        with suppress(Problem):
            return solved(samples, {**start, "rounding": width}, *held)
        return None

    def openings(solution: Solution, cost: float, width: Estimate, note: str = "") -> Openings:
        of = {n: straight_opening(steps.of(n), c, solution, n, width, note) for n in labels}
        return Openings(solution, cost, of)

    if not (sharp := at(SHARP, "rounding")):
        return None
    longest = max(2 * min(sharp.fit[f"start{label}"] for label in labels), SHARP)
    guess, prior = c.rounding.value, c.rounding.sd or c.rounding.value
    known = min(max(guess, SHARP), longest)
    tried = np.unique([*(SHARP + (longest - SHARP) * np.linspace(0, 1, WIDTHS) ** 2), known])
    fits = {float(w): found for w in tried if (found := at(float(w), "rounding"))}
    widths, cost = np.array(list(fits)), np.array([found.cost for found in fits.values()]) / scatter**2
    k, least = int(cost.argmin()), float(cost.min()) * scatter**2
    if min(cost[0], cost[-1]) > cost[k] + FACTOR**2:
        start |= {n: fits[float(widths[k])].fit[n] for n in start}
        free = at(float(widths[k]))
        if free and SHARP < (w := free.fit["rounding"]) < longest and (sd := free.fit.sd("rounding")) < prior:
            return openings(free, free.cost, Estimate.normal("", w, "V", sd, "", minimum=SHARP))
    allowed = cost <= cost.min() + FACTOR**2  # by the data alone
    k = int(np.argmin(np.abs(widths - known)))
    width = float(widths[k if allowed[k] else 0 if allowed[0] else cost.argmin()])
    cost += ((widths - guess) / prior) ** 2
    fine = np.union1d(np.linspace(widths[0], widths[-1], FINE), widths)
    likely = fine[np.interp(fine, widths, np.sqrt(cost - cost.min())) <= FACTOR]  # in standard deviations
    low, high = min(float(likely[0]), width), max(float(likely[-1]), width)
    note = f"rounding {guess:.3g} V as known; the interval is that of any rounding" * (width == guess)
    rounding = Estimate("", width, "V", (high - low) / 2 / FACTOR, low, high, "")
    return openings(fits[width], least, rounding, note)


# ---- tests of what the procedure takes for granted -----------------------------------------------------


def _findings(
    recordings: Sequence[Recording], found: ValveFit, parameters: Mapping[str, Number]
) -> Iterator[Finding]:
    """One finding per assumption: the edge that contradicts it most, for as many edges as were tested."""
    scatters = [_scatter(r, found.known) for r in recordings]
    for every, noise in ((scatters, True), (recordings, False)):
        found_in = data.signal_findings(every, READ, "valve")
        yield from (f for f in found_in if (f.fault == "noise") == noise)
    yield from _zeros(recordings, found)
    # the noise of these alone is tested: commands and what was known are exact
    own = [replace(s, raw=s.raw[: len(READ)], sd=s.sd[: len(READ)]) for s in found.nodes.solution.samples]
    yield misfit("valve", replace(found.nodes.solution, samples=own))
    lag, drift = (found.effects.get(name, (0.0, 0.0)) for name in EFFECTS)
    told = f"after a rising command the opening lags by {lag[0]:.2g} +- {lag[1]:.1g} V"
    yield Finding("hysteresis", probability(*lag), f"valve: {told}, against a falling one")
    word, (percent, sd) = data.course(recordings[0], [slice(0, 1)])[1], (100 * x for x in drift)
    told = f"changes with the {word} by {percent:.2g} +- {sd:.1g} % over all of it"
    yield Finding("oil temperature", probability(*drift), f"valve: the area {told}")
    for recording in recordings:
        if density := data.stated(recording, "density"):
            other = abs(density / found.known.density - 1) > SAME_OIL
            yield Finding(
                "density",
                0.0 if other else 1.0,
                f"valve: {recording.source.name} was recorded with an oil of {density:.4g} kg/m3, not the "
                f"machine's of {found.known.density:.4g} kg/m3; the areas are those of the recorded oil",
            )
    falls = [(n.falling(), e) for e, n in found.nodes.of.items()]
    (p, fall), edge = min(falls)
    sentence = f"valve {edge}: the opening falls by {100 * fall:.2g} % while the command rises"
    yield Finding("falling opening", min(1.0, len(falls) * p), sentence)
    starts = [test for edge in found.nodes.of for test in _start(edge, found)]
    p, sentence = min(starts, key=lambda test: test[0])
    yield Finding("dead band", min(1.0, len(starts) * p), sentence)
    known, largest = parameters.get("boom_stick.valve_area"), found.widest.full.value
    ratio = largest / known.value if known else 1.0
    yield Finding(
        "unit",
        0.0 if max(ratio, 1 / ratio) > OTHER_SIZE else 1.0,
        f"valve: the area at full command is {1e6 * largest:.3g} mm2, {ratio:.2g} times the known one: "
        "is the unit of each signal right? If the valve has this size, state it in the parameters",
    )


def _zeros(recordings: Sequence[Recording], found: ValveFit) -> Iterator[Finding]:
    """The zeros of the pressures, and that of the meter, against what is declared."""
    declared = data.zero_limits(recordings, PRESSURES) | data.declared_limits(recordings, ["flow"])
    (value, sd), (unit, one) = free_offset(found.solution), BAR
    limit = sum(declared[n] for n in PRESSURES)
    yield Finding(
        "zero of a pressure sensor",
        probability(value, sd, limit) if abs(value) < FURTHER * limit else 1.0,
        f"valve: the data fit best if the zeros of the two pressures differ by {value / one:.3g} +- "
        f"{sd / one:.2g} {unit}; declared are {limit / one:.3g} {unit}",
    )
    if found.steps.closed.any():
        value, sd = found.solution.every["flow"], found.solution.every.sd("flow")
        limit, (unit, one) = declared.get("flow", 0.0), LITRES_PER_MINUTE
        yield Finding(
            "zero of a flow meter",
            probability(value, sd, limit),
            f"valve: the flow meter reads {value / one:.2g} {unit} at closed edges, and {limit / one:.2g} "
            f"{unit} is declared; the reading is subtracted",
        )


def _start(edge: str, found: ValveFit) -> Iterator[Test]:
    """An edge that is open at zero command, or closed where its opening would give a flow."""
    opening = found.each.of[edge]
    first, sd = opening.zero
    yield (
        float(stats.norm.sf(-first / sd)),
        f"valve {edge}: the opening begins at {first:.2g} V: an underlapped spool, or a command with an "
        "offset. The machine has no opening at zero command",
    )
    for command, bound in sorted(zip(*found.corrected.of(edge).idle(found.known), strict=True), reverse=True):
        area, sd = opening.near(command)
        yield (
            float(stats.norm.sf((area - bound) / sd)) if area else 1.0,
            f"valve {edge}: the flow meter reads nothing at {command:.3g} V, although the opening gives a "
            "flow: the opening has a step, or the meter was stuck",
        )


# ---- estimates -----------------------------------------------------------------------------------------


def _estimates(found: ValveFit) -> Iterator[Estimate]:
    """Those of the one straight opening; of several the largest area and the first start."""
    if found.common:
        yield from _of(found.widest, "", f"fit of {np.count_nonzero(found.steps.good)} steps")
        return
    area, *_ = _of(found.widest, "", "largest of all edges")
    start = min((opening.start for opening in found.openings.values()), key=lambda start: start.value)
    note = "first start of an opening; the tables of the edges replace it"
    yield from (area, replace(start, name="valve_dead_band", note=note))


def _of(opening: Opening, suffix: str, note: str) -> Iterator[Estimate]:
    """Area, dead band and rounding of an opening."""
    where = "" if opening.reached else f", extrapolated from {opening.command[-1]:.3g} V"
    about = f"{note}, section 4(a), with C_d and density as known{where}"
    yield replace(opening.full, name=f"valve_area{suffix}", note=about)
    about = ", ".join(filter(None, (note, "section 4(a)", opening.start.note)))
    yield replace(opening.start, name=f"valve_dead_band{suffix}", note=about)
    if opening.rounding:
        yield replace(opening.rounding, name=f"valve_command_rounding{suffix}", note=about)


def _others(found: ValveFit) -> Iterator[Estimate]:
    """The hysteresis, where it is significant; area and start of each edge."""
    if "lag" in found.freed:
        note = "from steps with rising and falling commands"
        yield Estimate.normal("hysteresis", found.effects["lag"][0], "V", found.effects["lag"][1], note)
    for edge, opening in found.openings.items():
        own = found.straight.of[edge] if found.straight else opening
        yield from _of(own, f"[{edge}]", f"fit of {np.count_nonzero(found.steps.of(edge).good)} steps")


def _tables(found: ValveFit, parameters: Mapping[str, Number]) -> Iterator[Estimate]:
    """Points of the tables of all edges as parameters; an untested edge gets the table of another.

    Empty tables take the place of known ones if a straight line suffices.
    """

    def exact(name: str, value: float, unit: str, note: str) -> Estimate:
        return Estimate(name, value, unit, 0.0, value, value, note, f"{name.rpartition('_')[0]}s")

    for edge, other in SAME_WAY.items():
        name = f"valve_{edge.replace('-', '').lower()}"
        if found.common:
            known = parameters.get(f"boom_stick.{name}_command_2")
            if known and known.value > 0:
                note = "no table: a straight line suffices, section 4(a)"
                yield exact(f"{name}_command_1", 0.0, "V", note)
                yield exact(f"{name}_opening_1", 0.0, "1", note)
            continue
        source = next(e for e in (edge, other, *found.openings) if e in found.openings)
        table, note = found.openings[source].table, f"edge {source}, section 4(a); relative to valve_area"
        for i, command in enumerate((table.start, *table.command), 1):
            yield exact(f"{name}_command_{i}", float(command), "V", note)
        yield exact(f"{name}_opening_1", 0.0, "1", note)
        full = found.widest.full.value
        for k, e in enumerate(table.areas, 2):
            value, sd, low, high = (x / full for x in (e.value, e.sd, e.low, e.high))
            yield Estimate(f"{name}_opening_{k}", value, "1", sd, low, high, note, f"{name}_openings")


def _resistances(found: ValveFit) -> Iterator[Estimate]:
    """C_R at the voltages of `VOLTAGES`, and the zero of a straight opening."""
    for edge, opening in found.distinct.items():
        suffix = f"[{edge}]" if edge else ""
        for voltage in VOLTAGES:
            if (e := opening.at(voltage)) and e.low > 0:
                low, value, high = map(float, found.known.resistance(np.array([e.high, e.value, e.low])))
                name, note = f"C_R({voltage:g} V){suffix}", "eq. (2) with the fitted opening"
                yield Estimate(name, value, "Pa.s2/m6", 2 * value * e.sd / e.value, low, high, note)
    if found.common:
        note = "zero of the straight part of the opening, extrapolated"
        yield Estimate.normal("dead_band + rounding/2", found.common.zero[0], "V", found.common.zero[1], note)


# ---- remarks and panels --------------------------------------------------------------------------------


def _remarks(found: ValveFit, zero: Estimate) -> Iterator[str]:
    """Masked steps, line or table, commands that were not reached, edges, zeros, what was taken as known."""
    steps, c = found.steps, found.known
    if (dead := steps[steps.dead]).command.size:
        yield (
            f"{dead.command.size} of {steps.command.size} steps, up to {dead.command.max():.3g} V, are "
            "masked: the flow is in the dead zone of the meter, the flat region of Fig. 5."
        )
    if omissions := steps[~steps.dead & ~steps.good & ~steps.closed].omissions():
        yield f"Other steps are left out: {omissions}."
    test = f"chi-square test against the free areas, {_chance(found.p)}"
    if found.straight:
        yield f"A straight line with a dead band suffices ({test})."
        known, opening = c.rounding.value, next(iter(found.openings.values()))
        if not opening.rounding:
            yield (
                "The data determine the zero of the extrapolated straight part, not the rounding of its "
                f"start. The dead band is this zero minus half the known rounding of {known:.3g} V."
            )
        elif "rounding" not in found.solution.fit.names:
            yield f"The opening begins as sharply as the data allow, the known rounding is {known:.3g} V."
    else:
        yield (
            f"A straight line does not suffice ({test}). The openings are tables, valve_pa_commands, "
            "valve_pa_openings and so on, which the machine reads in place of valve_dead_band."
        )
    for edge, opening in found.distinct.items() if not found.straight else ():
        table, (off, command) = opening.table, opening.table.off
        if table.p < UNLIKELY:
            yield (
                f"{edge or 'All edges'}: no table of {len(table.areas)} points can "
                f"follow all measured areas (chi-square test, {_chance(table.p)}): it is off by "
                f"{100 * off:.2g} % of the largest area at {command:.3g} V."
            )
    for edge, opening in found.openings.items():
        if not opening.reached:
            yield (
                f"{edge}: no flow was measured above {opening.command[-1]:.3g} V, so the area at "
                f"{c.full_command:.3g} V is extrapolated. Hold the full command twice in such an experiment."
            )
    edges = found.openings
    if len(edges) < 2:
        yield f"Only the edge {next(iter(edges))} was tested; the other three are taken to be like it."
    elif found.equal > UNLIKELY:
        chance = f"chi-square test, p = {found.equal:.2g}"
        yield f"The {len(edges)} edges do not differ significantly ({chance})."
    else:
        by_edge = ", ".join(f"{e} {1e6 * opening.full.value:.4g} mm2" for e, opening in edges.items())
        yield f"The edges differ significantly (chi-square test, {_chance(found.equal)}): {by_edge}."
    yield from data.pressure_offset_remark(zero)
    oil = ("density", steps.density, "kg/m3"), ("viscosity", steps.viscosity, "Pa.s")
    used = (f"{n} {', '.join(f'{x:.4g}' for x in np.unique(values))} {unit}" for n, values, unit in oil)
    yield f"Known: C_d = {c.discharge_coefficient:.4g}, {', '.join(used)}."
    if not steps.closed.any():
        limit = found.limits.get("flow", 0.0) / LITRES_PER_MINUTE[1]
        covered = f"cover {limit:.2g} L/min, not more" if limit else "do not cover it (`zero_error`)"
        yield (
            f"No reading shows the zero of the flow meter: the intervals {covered}. A recording at rest "
            "shows it, unless the meter has a dead zone."
        )


def _chance(p: float) -> str:
    return f"p = {p:.2g}" if p > 1e-9 else "p < 1e-09"


def panels(found: ValveFit) -> tuple[Panel, ...]:
    """C_R with the fit, K = Q/sqrt(dp) with masked steps and intervals, residual."""
    steps, c = found.corrected, found.known
    good, dead = steps[steps.good], steps[steps.dead & (steps.drop != 0)]
    # K is straight above the foot of a straight opening, so it also shows the dead band
    root, gain = np.sqrt(np.abs(good.drop)), c.discharge_coefficient * math.sqrt(2 / c.density)
    masked = np.abs(dead.flow) / np.sqrt(np.abs(dead.drop))
    gains = [
        Curve("measured", good.command, np.abs(good.flow) / root, error=good.flow_error / root),
        Curve("masked: dead zone of the meter", dead.command, masked, "masked"),
    ]
    points, lines, residuals = list[Curve](), list[Curve](), list[Curve]()
    for edge, opening in found.distinct.items():
        label = f": {edge}" if edge else ""
        volts = np.unique([*np.linspace(0.0, c.full_command, DRAWN), opening.start.value, *opening.command])
        area = opening.drawn(volts)
        seen = volts >= opening.command[0]  # towards the foot it is infinite
        lines.append(Curve(f"fit, eq. (2){label}", volts[seen], c.resistance(area[seen]), "fit", line=True))
        gains.append(Curve(f"fit{label}", volts, gain * area, "fit", line=True))
    for edge, opening in found.openings.items():
        s = good.of(edge)
        resistance, drop_error = np.abs(s.drop) / s.flow**2, np.hypot(*s.errors[:2]) / np.abs(s.drop)
        own = resistance * np.hypot(drop_error, 2 * s.flow_error / s.flow)  # twice, as C_R ~ 1/Q^2
        points.append(Curve(edge, s.command, resistance, error=own))
        area = s.effective(c)
        left = (area - opening.drawn(s.command)) / area * np.abs(s.flow)
        error = np.hypot(s.flow_error, s.flow * drop_error / 2)
        residuals.append(Curve(edge, s.command, left, error=error))
    return (
        Panel(COMMAND, RESISTANCE, (*points, *lines), "Resistance of each edge", log=True),
        Panel(COMMAND, "K = Q / sqrt(dp) [m3/(s.Pa^0.5)]", tuple(gains), "Opening, as it was fitted"),
        Panel(COMMAND, "flow, measured - fitted", tuple(residuals), "Residual", y_unit=LITRES_PER_MINUTE),
    )


VALVE = Computed("valve", SIGNALS, identify)
