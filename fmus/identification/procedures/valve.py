"""Valve procedure (section 4(a), Fig. 5): opening of the metering edges over the command.

    C_R = (P_in - P_out)/(Q|Q|), eq. (1)        C_R = rho/(2 C_d^2 A(V)^2), eq. (2)

The data are means over each step with their standard errors; `valve_fit` fits them. If a straight line with a
dead band suffices for each edge, area, dead band and rounding are the result, fitted to all edges together
unless these differ. Otherwise each edge gets a table of up to ten points, the same one if the edges do not
differ.

Validity: steady flow above the dead zone of the meter; the opening rises with the command. Only the product
C_d A sqrt(2/rho) is measured: the area is valid for the known C_d and the density, which is that of the
recording if it has one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from fmus.identification.balance import UNLIKELY, probability
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures import opening_curve
from fmus.identification.procedures.experiment_data import STEP_SIGNALS
from fmus.identification.procedures.fit import Fit, Procedure
from fmus.identification.procedures.opening_curve import OpeningCurve
from fmus.identification.procedures.valve_fit import (
    CERTAIN,
    PRESSURES,
    SAME,
    Known,
    ValveFit,
    ValveSteps,
    fit,
    free_offset,
    offset,
    require_nodes,
)
from fmus.identification.recordings.masks import in_dead_zone, steady
from fmus.identification.results import (
    BAR,
    CONFIDENCE,
    LITRES_PER_MINUTE,
    Curve,
    Estimate,
    Finding,
    Panel,
    ProcedureResult,
)
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Mask, Recording
from orchestrator.data.table import Array

SIGNALS: Mapping[str, str] = {"command": "V", "pressure_in": "Pa", "pressure_out": "Pa", "flow": "m3/s"}
VOLTAGES = (1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 10.0)  # V, at which C_R is reported
REAL = 0.01, 1.5  # full commands, between which the largest command of a bench is
MIN_VOLTAGES = 3  # different commands at which the flow must be measured
# sign of the command that opens each edge, correction E7 in docs/equations.md
COMMAND_SIGN = {"P-A": 1, "B-T": 1, "P-B": -1, "A-T": -1}
SAME_WAY = {"P-A": "B-T", "B-T": "P-A", "P-B": "A-T", "A-T": "P-B"}  # edges that one direction opens
OTHER_SIZE = 3.0  # times the known area: a wrong unit is more likely than such a valve
SAME_OIL = 0.01  # relative difference of two densities of one oil
MOST = 0.5  # share of the samples of a step that show its scatter
COMMAND, RESISTANCE = "command [V]", "C_R [Pa.s2/m6]"  # labels of axes
Test = tuple[float, str]  # probability and sentence of a finding


@dataclass(frozen=True)
class Openings:
    """Openings of the tested edges.

    curves      edge -> its opening with a band; the same object for equal edges
    common      whether all edges have one straight line
    own         edge -> its straight opening, if a line suffices for each
    """

    fit: ValveFit
    curves: Mapping[str, OpeningCurve]
    common: bool
    own: Mapping[str, OpeningCurve]

    @property
    def straight(self) -> bool:
        """Whether a straight line suffices for each edge."""
        return self.fit.straight

    @property
    def first(self) -> OpeningCurve:
        """The opening of the first edge, which all have if they are equal."""
        return next(iter(self.curves.values()))

    @property
    def largest(self) -> float:
        """Area at full command of the edge that opens furthest [m2]."""
        return max(float(curve.areas[-1]) for curve in self.curves.values())

    def distinct(self) -> dict[str, OpeningCurve]:
        """One entry for all edges with the same curve; its name is "all" then."""
        if all(curve is self.first for curve in self.curves.values()) and len(self.curves) > 1:
            return {"all": self.first}
        return dict(self.curves)


def identify(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ProcedureResult:
    """Area, dead band and rounding or opening curve of the valve's edges, and C_R over the command."""
    tests = data.training_recordings(recordings, "valve", SIGNALS)
    found = identify_openings(tests, parameters)
    value, sd = offset(found.fit.solution)
    zero = Estimate.normal("pressures without flow", value, "Pa", sd, "pressure_in - pressure_out")
    return ProcedureResult(
        procedure="valve",
        title="Valve: C_R of the metering edges over the command",
        figure=5,
        estimates=tuple(_of_line(found, "") if found.common else _of_curves(found)),
        panels=panels(found),
        remarks=tuple(_remarks(found, zero)),
        others=(*_resistances(found), zero, *_effects(found), *_of_edges(found)),
        findings=(*_findings(tests, found), _size(found, parameters)),
        listed=tuple(_tables(found, parameters)),
    )


def identify_openings(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> Openings:
    """The openings of the edges with their bands."""
    tests = data.training_recordings(recordings, "valve", SIGNALS)
    c = Known.of(parameters)
    steps = data.concatenate([_steps_of(r, c) for r in tests])
    parts = [_classified(steps.of(e), c) for e in steps.edges]
    steps = data.concatenate(parts)
    steps = steps[(steps.command > SAME * c.full_command) | steps.closed]
    require_nodes(steps, c, MIN_VOLTAGES)
    limits = data.zero_limits(tests, PRESSURES) | data.declared_limits(tests, ["flow"])
    if (shut := steps[steps.closed]).flow.size:  # which show the zero: it is free
        seen = np.abs(shut.flow) + CERTAIN * shut.flow_error
        limits["flow"] = max(limits.get("flow", 0.0), 2 * float(seen.max()))
    found = fit(steps, c, limits)
    # the machine may be as warm as the oil was at either end
    drift = abs(found.effects["drift"][0]) if "drift" in found.freed else 0.0
    edges, steps = steps.edges, found.corrected
    if not found.straight:
        rises = {e: nodes.falling()[0] >= UNLIKELY for e, nodes in found.nodes.items()}
        if found.pooled and found.equal > UNLIKELY:
            one = opening_curve.of_nodes(found.pooled, steps, c, drift, monotone=all(rises.values()))
            return Openings(found, dict.fromkeys(edges, one), False, {})
        curves = {
            e: opening_curve.of_nodes(n, steps.of(e), c, drift, monotone=rises[e])
            for e, n in found.nodes.items()
        }
        return Openings(found, curves, False, {})
    own = {e: opening_curve.of_line(found.lines, e, steps.of(e), c, drift) for e in edges}
    label, line = found.line.labels[0], found.line.solution.fit
    start, sd = line[f"start{label}"], line.sd(f"start{label}")
    if found.equal <= UNLIKELY or start <= -CERTAIN * sd:  # the machine has no opening at zero command
        return Openings(found, own, False, own)
    one = opening_curve.of_line(found.line, label, steps, c, drift)
    return Openings(found, dict.fromkeys(edges, one), True, own)


# ---- steps -------------------------------------------------------------------------------------------


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
    stretches = steady(gapless, "command", data.SETTLING_TIME, data.SHORTEST_STEP)
    return edge, command, [step for step in stretches if command[step.start] > -SAME * full]


def _steps_of(recording: Recording, c: Known) -> ValveSteps:
    """All steps of a recording; a reading in the dead zone of the meter is one, too."""
    edge, command, steps = _stretches(recording, c)
    # samples would look stuck with a noise that is much too large, a dead zone certain with one too small
    scatter, sensors = _scatter(recording, c), dict(recording.sensors)
    for name in STEP_SIGNALS:
        sensors[name] = replace(recording.sensor(name), noise=data.noise_sd(scatter, name))
    recording = replace(recording, sensors=sensors)
    means, meter = data.step_means(recording, steps), recording.sensor("flow")
    highest = (np.sign(means.drop) * means.flow + CERTAIN * means.flow_error)[means.good]  # along the drop
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
    largest = means.drop[np.nanargmax(np.abs(means.drop))] if np.isfinite(means.drop).any() else 0.0
    of_dead = np.array([np.nanstd(recording["flow"][step]) for step in steps]) / size
    flow_error = np.where(means.dead, np.maximum(of_dead, meter.resolution / 12**0.5), means.flow_error)
    errors = means.drop_error, flow_error
    usual = [float(np.median(e[means.good])) if means.good.any() else 0.0 for e in errors]
    along, _ = data.course(recording, steps)
    return ValveSteps(
        **vars(means)
        | {
            "drop_error": np.maximum(means.drop_error, usual[0]),
            "flow_error": np.where(means.good, np.maximum(flow_error, usual[1]), flow_error),
        },
        command=np.abs(middle),
        command_error=np.array([command[step].std() for step in steps]) / size,
        supply_drop=np.full(len(steps), largest),
        course=(along - along.mean()) / (float(np.ptp(along)) or 1.0),
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
    for name in STEP_SIGNALS:
        sensor = recording.sensor(name)
        read = np.where(in_dead_zone(recording[name], sensor), np.nan, recording[name])
        signals[name], sensors[name] = np.full_like(read, np.nan), replace(sensor, dead_zone=0.0)
        for step in steps:
            if np.isfinite(read[step]).mean() > MOST:
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


# ---- tests of what the procedure takes for granted -----------------------------------------------------


def _findings(recordings: Sequence[Recording], found: Openings) -> Iterator[Finding]:
    """One finding per assumption: the edge that contradicts it most, for as many edges as were tested."""
    fitted, label = found.fit, "valve"
    scatters = [_scatter(r, fitted.known) for r in recordings]
    for every, noise in ((scatters, True), (recordings, False)):
        found_in = data.signal_findings(every, STEP_SIGNALS, label)
        yield from (f for f in found_in if (f.fault == "noise") == noise)
    yield from _zeros(recordings, fitted)
    yield Fit(label, recordings, STEP_SIGNALS, fitted.by_nodes, ()).model()
    drift = fitted.effects.get("drift", (0.0, 0.0))
    if hysteresis := _hysteresis(fitted):
        sentence = (
            "valve: after a rising command the opening lags by {:.2g} +- {:.1g} {}, against a falling one"
        )
        yield Finding("hysteresis", probability(*hysteresis[:2]), sentence.format(*hysteresis))
    word = data.course(recordings[0], [slice(0, 1)])[1]
    percent = [100 * x for x in drift]
    sentence = (
        f"valve: the area changes with the {word} by {percent[0]:.2g} +- {percent[1]:.1g} % over all of it"
    )
    yield Finding("oil temperature", probability(*drift), sentence)
    for recording in recordings:
        if density := data.stated(recording, "density"):
            other = abs(density / fitted.known.density - 1) > SAME_OIL
            yield Finding(
                "density",
                0.0 if other else 1.0,
                f"valve: {recording.source.name} was recorded with an oil of {density:.4g} kg/m3, not the "
                f"machine's of {fitted.known.density:.4g} kg/m3; the areas are those of the recorded oil",
            )
    falls = [(n.falling(), e) for e, n in fitted.nodes.items()]
    (p, fall), edge = min(falls)
    sentence = f"valve {edge}: the opening falls by {100 * fall:.2g} % while the command rises"
    yield Finding("falling opening", min(1.0, len(falls) * p), sentence)
    starts = [test for edge in fitted.nodes for test in _start(edge, found)]
    p, sentence = min(starts, key=lambda test: test[0])
    yield Finding("dead band", min(1.0, len(starts) * p), sentence)


def _size(found: Openings, parameters: Mapping[str, Number]) -> Finding:
    """Whether the area is far from the known one, as with a pressure in another unit."""
    known = parameters.get("boom_stick.valve_area")
    ratio = found.largest / known.value if known else 1.0
    return Finding(
        "unit",
        0.0 if max(ratio, 1 / ratio) > OTHER_SIZE else 1.0,
        f"valve: the area at full command is {1e6 * found.largest:.3g} mm2, {ratio:.2g} times the known one: "
        "is the unit of each signal right? If the valve has this size, state it in the parameters",
    )


def _zeros(recordings: Sequence[Recording], fitted: ValveFit) -> Iterator[Finding]:
    """The zeros of the pressures, and that of the meter, against what is declared."""
    declared = data.zero_limits(recordings, PRESSURES)
    zero, sd = free_offset(fitted.solution)
    limit, (unit, one) = sum(declared.values()), BAR
    yield Finding(
        "zero of a pressure sensor",
        probability(zero, sd, limit),
        f"valve: the data fit best if the zeros of the two pressures differ by {zero / one:.3g} +- "
        f"{sd / one:.2g} {unit}; declared are {limit / one:.3g} {unit}",
    )
    if fitted.steps.closed.any():
        zero, sd, (unit, one) = (
            fitted.solution.every["flow"],
            fitted.solution.every.sd("flow"),
            LITRES_PER_MINUTE,
        )
        limit = data.declared_limits(recordings, ["flow"]).get("flow", 0.0)
        yield Finding(
            "zero of a flow meter",
            probability(zero, sd, limit),
            f"valve: the flow meter reads {zero / one:.2g} {unit} at closed edges, and {limit / one:.2g} "
            f"{unit} is declared; the reading is subtracted",
        )


def _start(edge: str, found: Openings) -> Iterator[Test]:
    """An edge that is open at zero command, closed where its opening would give a flow, another rounding."""
    fitted, nodes, c = found.fit, found.fit.nodes[edge], found.fit.known
    if fitted.straight:
        first, sd = fitted.lines.solution.fit[f"start{edge}"], fitted.lines.solution.fit.sd(f"start{edge}")
    else:
        a, v, s = nodes.area, nodes.command, nodes.sd
        length = (v[1] - v[0]) / (a[1] - a[0])
        first, sd = float(v[0] - a[0] * length), float(length * np.hypot(s[0], s[1] * a[0] / a[1]))
    yield (
        float(stats.norm.sf(-first / sd)),
        f"valve {edge}: the opening begins at {first:.2g} V: an underlapped spool, or a command with an "
        "offset. The machine has no opening at zero command",
    )
    # steps at which the meter reads nothing, from the highest command on, although the opening is open;
    # below the lowest node the least area is that of the steepest start
    command, bound = fitted.corrected.of(edge).idle(c)
    lowest, latest = nodes.command[0], float(found.curves[edge].start.max())
    steep = np.clip((command - latest) / max(lowest - latest, 1e-9), 0.0, None) * nodes.area[0]
    least = np.where(
        command >= lowest, np.interp(command, nodes.command, nodes.area), steep * (latest < lowest)
    )
    p = stats.norm.sf((least - bound) / np.interp(command, nodes.command, nodes.sd))
    for k in np.argsort(-command):
        yield (
            float(p[k]),
            f"valve {edge}: the flow meter reads nothing at {command[k]:.3g} V, although the opening gives a "
            "flow: the opening has a step, or the meter was stuck",
        )
    if fitted.straight and fitted.lines.told:
        known = c.rounding.value
        yield (
            fitted.lines.as_known(known),
            f"valve {edge}: the opening does not begin with a rounding of {known:.3g} V as known, but with "
            f"one of {fitted.lines.line(edge)[2]:.2g} V",
        )


# ---- estimates -----------------------------------------------------------------------------------------


def _of_line(found: Openings, edge: str) -> Iterator[Estimate]:
    """Area, dead band and rounding of a straight opening; edge "": of all."""
    lines, curve = (found.fit.lines, found.own[edge]) if edge else (found.fit.line, found.first)
    label = edge or lines.labels[0]
    suffix, full = f"[{edge}]" if edge else "", found.fit.known.full_command
    steps = found.fit.steps.of(edge) if edge else found.fit.steps
    note = f"fit of {np.count_nonzero(steps.good)} steps, section 4(a)"
    about = f"{note}, with C_d and density as known"
    area = lines.area(label, full)[0]
    if curve.last_measured < full * (1 - SAME):
        about += ", extrapolated"
    yield curve.estimate(f"valve_area{suffix}", "m2", about, curve.draws[:, -1], area)
    _, start, width = lines.line(label)
    told = "" if lines.told else f", rounding {width:.3g} V as known; the interval is that of any rounding"
    rounding = _shortest(f"valve_command_rounding{suffix}", width, lines.draws["rounding"], note)
    name, band = f"valve_dead_band{suffix}", np.maximum(curve.start, 0.0)
    found_band = _shortest(name, max(start - width / 2, 0.0), band, f"{note}{told}")
    if rounding.low <= lines.widths[0]:  # a sharp start is not excluded
        sharp = float(np.quantile(lines.draws[f"start{label}"], (1 + CONFIDENCE) / 2))
        found_band = replace(found_band, high=max(found_band.high, sharp))
    yield found_band
    if lines.told:
        yield rounding
    elif width < found.fit.known.rounding.value:
        note = "twice the start of the straight opening, so that the dead band is not negative"
        yield Estimate(f"valve_command_rounding{suffix}", width, "V", width / 12**0.5, 0.0, width, note)


def _shortest(name: str, value: float, draws: Array, note: str) -> Estimate:
    """An estimate in V with the shortest interval of the draws: a bound may be the likeliest value."""
    ordered, count = np.sort(draws), math.ceil(CONFIDENCE * draws.size)
    first = int(np.argmin(ordered[count - 1 :] - ordered[: draws.size - count + 1]))
    low, high = float(ordered[first]), float(ordered[first + count - 1])
    return Estimate(name, value, "V", float(draws.std()), min(low, value), max(high, value), note)


def _of_curves(found: Openings) -> Iterator[Estimate]:
    """Area of the edge that opens furthest, and the first start of an opening."""
    curves = found.curves.values()
    note = "at full command by the opening curve, with C_d and density as known"
    yield _full_area(max(curves, key=lambda curve: float(curve.areas[-1])), "valve_area", note)
    note = "start of the opening curve; the tables of the edges replace it"
    yield _first(min(curves, key=lambda curve: float(curve.commands[0])), "valve_dead_band", note)


def _full_area(curve: OpeningCurve, name: str, note: str) -> Estimate:
    return curve.estimate(name, "m2", f"{note}, section 4(a)", curve.draws[:, -1], float(curve.areas[-1]))


def _first(curve: OpeningCurve, name: str, note: str) -> Estimate:
    start = np.maximum(curve.start, 0.0)
    found = curve.estimate(name, "V", note, start, float(curve.commands[0]))
    # each exponent below the lowest node is as likely, also the ends of their range
    return replace(found, low=min(found.low, float(start.min())), high=max(found.high, float(start.max())))


def _of_edges(found: Openings) -> Iterator[Estimate]:
    """Area and start of each edge; openings at the points of the tables with their band."""
    if found.straight:
        for edge in found.own:
            yield from _of_line(found, edge)
        return
    note = "point of the table, relative to valve_area; the interval is that of the 95 % band"
    for edge, curve in found.distinct().items():
        yield _full_area(curve, f"valve_area[{edge}]", "at full command")
        yield _first(curve, f"valve_dead_band[{edge}]", "start of the opening")
        for point in curve.openings(found.largest, note):
            yield replace(point, name=f"opening[{edge}]({point.name} V)")


def _tables(found: Openings, parameters: Mapping[str, Number]) -> Iterator[Estimate]:
    """Points of the tables of all edges as parameters; an untested edge gets the table of another.

    Empty tables take the place of known ones if a straight line suffices.
    """

    def exact(name: str, value: float, unit: str, note: str) -> Estimate:
        return Estimate(name, value, unit, 0.0, value, value, note, f"{name.rpartition('_')[0]}s")

    tested = found.curves
    for edge, other in SAME_WAY.items():
        name = f"valve_{edge.replace('-', '').lower()}"
        if found.common:
            known = parameters.get(f"boom_stick.{name}_command_2")
            if known and known.value > 0:
                note = "no table: a straight line suffices, section 4(a)"
                yield exact(f"{name}_command_1", 0.0, "V", note)
                yield exact(f"{name}_opening_1", 0.0, "1", note)
            continue
        source = edge if edge in tested else other if other in tested else next(iter(tested))
        note = f"opening curve of edge {source}, section 4(a); relative to valve_area"
        for i, command in enumerate(tested[source].commands, 1):
            yield exact(f"{name}_command_{i}", float(command), "V", note)
        yield exact(f"{name}_opening_1", 0.0, "1", note)
        for i, point in enumerate(tested[source].openings(found.largest, note), 2):
            yield replace(point, name=f"{name}_opening_{i}", listed=f"{name}_openings")


def _resistances(found: Openings) -> Iterator[Estimate]:
    """C_R at the voltages of `VOLTAGES`, and the zero of a straight opening."""
    c, distinct = found.fit.known, found.distinct()
    for edge, curve in distinct.items():
        suffix = "" if len(distinct) == 1 else f"[{edge}]"
        for voltage in VOLTAGES:
            areas = curve.draws_at(voltage)
            if curve.first_measured <= voltage <= c.full_command * (1 + SAME) and areas.min() > 0:
                draws, note = c.resistance(areas), "eq. (2) with the fitted opening"
                yield curve.estimate(f"C_R({voltage:g} V){suffix}", "Pa.s2/m6", note, draws)
    if found.common:
        note = "zero of the straight part of the opening, extrapolated"
        line = found.fit.line
        yield line.solution.fit.estimate("dead_band + rounding/2", "V", note, f"start{line.labels[0]}")


def _hysteresis(fitted: ValveFit) -> tuple[float, float, str] | None:
    """Its size in V or in % of the flow, standard deviation and unit; None if no command was repeated."""
    if "lag" in fitted.effects:
        return *fitted.effects["lag"], "V"
    if "share" in fitted.effects:
        value, sd = fitted.effects["share"]
        return 100 * value, 100 * sd, "% of the flow"
    return None


def _effects(found: Openings) -> Iterator[Estimate]:
    """The hysteresis of the spool, where it is significant."""
    if "lag" in found.fit.freed:
        value, sd = found.fit.effects["lag"]
        yield Estimate.normal("hysteresis", value, "V", sd, "from steps with rising and falling commands")


# ---- remarks and panels --------------------------------------------------------------------------------


def _remarks(found: Openings, zero: Estimate) -> Iterator[str]:
    """Masked steps, line or curve, extrapolation, edges, zeros, what was taken as known."""
    steps, c = found.fit.steps, found.fit.known
    if (dead := steps[steps.dead]).command.size:
        yield (
            f"{dead.command.size} of {steps.command.size} steps, up to {dead.command.max():.3g} V, are "
            "masked: the flow is in the dead zone of the meter, the flat region of Fig. 5."
        )
    if omissions := steps[~steps.dead & ~steps.good & ~steps.closed].omissions():
        yield f"Other steps are left out: {omissions}."
    edge, p = min(found.fit.p.items(), key=lambda item: item[1])
    test = f"test of the residuals, {edge}: {_chance(p)}"
    if found.straight:
        yield f"A straight line with a dead band suffices ({test})."
        if not found.fit.lines.told:
            yield (
                "The data determine the zero of the extrapolated straight part, not the rounding of its "
                f"start. The dead band is this zero minus half the known rounding of "
                f"{found.fit.lines.line(edge)[2]:.3g} V."
            )
    else:
        yield (
            f"A straight line does not suffice ({test}). The openings are tables, valve_pa_commands, "
            "valve_pa_openings and so on, which the machine reads in place of valve_dead_band."
        )
    for edge, curve in found.curves.items():
        if curve.last_measured < c.full_command * (1 - SAME):
            yield (
                f"{edge}: no flow was measured above {curve.last_measured:.3g} V, so the area at "
                f"{c.full_command:.3g} V is extrapolated. Hold the full command twice in such an experiment."
            )
    edges = list(found.curves)
    if len(edges) < 2:
        yield f"Only the edge {edges[0]} was tested; the other three are taken to be like it."
    elif found.fit.equal > UNLIKELY:
        chance = f"chi-square test, p = {found.fit.equal:.2g}"
        yield f"The {len(edges)} edges do not differ significantly ({chance})."
    else:
        by_edge = ", ".join(f"{e} {curve.areas[-1] * 1e6:.4g} mm2" for e, curve in found.curves.items())
        yield f"The edges differ significantly (chi-square test, {_chance(found.fit.equal)}): {by_edge}."
    yield from data.pressure_offset_remark(zero)
    oil = ("density", steps.density, "kg/m3"), ("viscosity", steps.viscosity, "Pa.s")
    used = (f"{n} {', '.join(f'{x:.4g}' for x in np.unique(values))} {unit}" for n, values, unit in oil)
    yield f"Known: C_d = {c.discharge_coefficient:.4g}, {', '.join(used)}."
    if not steps.closed.any():
        limit = found.fit.limits.get("flow", 0.0) / LITRES_PER_MINUTE[1]
        covered = f"cover {limit:.2g} L/min, not more" if limit else "do not cover it (`zero_error`)"
        yield (
            f"No reading shows the zero of the flow meter: the intervals {covered}. A recording at rest "
            "shows it, unless the meter has a dead zone."
        )


def _chance(p: float) -> str:
    return f"p = {p:.2g}" if p > 1e-9 else "p < 1e-09"


def panels(found: Openings) -> tuple[Panel, ...]:
    """C_R with the fit, K = Q/sqrt(dp) with masked steps, residual."""
    steps, c = found.fit.corrected, found.fit.known
    good, dead = steps[steps.good], steps[steps.dead & (steps.drop != 0)]
    # K is straight above the foot of a straight opening, so it also shows the dead band
    root, gain = np.sqrt(np.abs(good.drop)), c.discharge_coefficient * math.sqrt(2 / c.density)
    gains = [
        Curve("measured", good.command, np.abs(good.flow) / root, error=good.flow_error / root),
        Curve(
            "masked: dead zone of the meter",
            dead.command,
            np.abs(dead.flow) / np.sqrt(np.abs(dead.drop)),
            "masked",
        ),
    ]
    points, lines, residuals = list[Curve](), list[Curve](), list[Curve]()
    distinct = found.distinct()
    for edge, curve in distinct.items():
        label = f": {edge}" if len(distinct) > 1 else ""
        seen = curve.command >= curve.first_measured  # towards the foot it is infinite
        resistance = c.resistance(curve.area[seen])
        lines.append(Curve(f"fit, eq. (2){label}", curve.command[seen], resistance, "fit", line=True))
        band = gain * curve.low, gain * curve.high
        gains.append(Curve(f"fit{label}", curve.command, gain * curve.area, "fit", line=True, band=band))
    for edge, curve in found.curves.items():
        s = good.of(edge)
        points.append(Curve(edge, s.command, np.abs(s.resistance), error=s.resistance_error))
        area = s.effective(c)
        left = (area - np.interp(s.command, curve.command, curve.area)) / area * np.abs(s.flow)
        error = np.hypot(s.flow_error, s.flow * s.drop_error / s.drop / 2)
        residuals.append(Curve(edge, s.command, left, error=error))
    return (
        Panel(COMMAND, RESISTANCE, (*points, *lines), "Resistance of each edge", log=True),
        Panel(COMMAND, "K = Q / sqrt(dp) [m3/(s.Pa^0.5)]", tuple(gains), "Opening, as it was fitted"),
        Panel(COMMAND, "flow, measured - fitted", tuple(residuals), "Residual", y_unit=LITRES_PER_MINUTE),
    )


VALVE = Procedure("valve", SIGNALS, identify)
