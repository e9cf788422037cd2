"""Valve procedure (section 4(a), Fig. 5): opening of the metering edges over the command.

    C_R = (P_in - P_out)/(Q|Q|), eq. (1)        C_R = rho/(2 C_d^2 A(V)^2), eq. (2)

The data are means over each step with their standard errors, and `openings` makes a line or a curve of them.
If a straight line with a dead band suffices for each edge, area and dead band are the result, fitted to all
edges together unless these differ. Otherwise each edge gets a table of up to ten points, the same one if the
edges do not differ.

Validity: steady flow above the dead zone of the meter; the opening rises with the command. Only the product
C_d A sqrt(2/rho) is measured: the area is valid for the known C_d and the density, which is that of the
recording if it has one.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import stats

from fmus.identification.balance import UNLIKELY, probability
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures.experiment_data import STEP_SIGNALS
from fmus.identification.procedures.openings import (
    CERTAIN,
    SAME,
    Known,
    Line,
    Nodes,
    OpeningCurve,
    Openings,
    ValveSteps,
    fit_openings,
)
from fmus.identification.procedures.valve_text import panels, remarks
from fmus.identification.recordings.masks import noise, steady
from fmus.identification.results import BAR, LITRES_PER_MINUTE, Estimate, Finding, ProcedureResult
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array

SIGNALS: Mapping[str, str] = {"command": "V", "pressure_in": "Pa", "pressure_out": "Pa", "flow": "m3/s"}
VOLTAGES = (1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 10.0)  # V, at which C_R is reported
REAL = 0.01, 1.5  # full commands, between which the largest command of a bench is
MIN_VOLTAGES = 3  # different commands at which the flow must be measured
# sign of the command that opens each edge, correction E7 in docs/equations.md
COMMAND_SIGN = {"P-A": 1, "B-T": 1, "P-B": -1, "A-T": -1}
SAME_WAY = {"P-A": "B-T", "B-T": "P-A", "P-B": "A-T", "A-T": "P-B"}  # edges that one direction opens
WRONG_NOISE = 2.0  # factor up to which a noise is known
NOISE_ERROR = 0.05  # standard deviation of the logarithm of a noise that was found
SAME_OIL = 0.01  # relative difference of two densities of one oil
FAULTS = (  # in the order of their findings; those of repeated steps follow
    *(
        "zero of a pressure sensor",
        "zero of a flow meter",
        "falling opening",
        "dead band",
        "density",
        "noise",
    ),
)
Test = tuple[float, str]  # probability and sentence of a finding
UNEVEN = 1.3  # scatter over its noise that ripple and errors of a standard error may cause


def identify(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ProcedureResult:
    """Area and dead band or opening curve of the valve's edges, and C_R over the command."""
    tests = data.training_recordings(recordings, "valve", SIGNALS)
    found = identify_openings(tests, parameters)
    zero = zero_of(found)
    corrected = found.steps.without_zero(zero.value)
    declared = all(r.sensor("flow").zero_error is not None for r in tests)
    return ProcedureResult(
        procedure="valve",
        title="Valve: C_R of the metering edges over the command",
        figure=5,
        estimates=tuple(_of_line(found, found.line, found.common) if found.line else _of_curves(found)),
        panels=panels(corrected, found),
        remarks=tuple(remarks(corrected, found, zero, declared)),
        others=(*_resistances(found), zero, *_of_edges(found)),
        findings=tuple(_findings(tests, found)),
        listed=tuple(_tables(found, parameters)),
    )


def identify_openings(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> Openings:
    """The openings of the edges with their bands."""
    tests = data.training_recordings(recordings, "valve", SIGNALS)
    c = Known.of(parameters)
    steps = data.concatenate([_steps_of(_with_its_noise(r, c), c) for r in tests])
    readings = [r for e in steps.edges if (r := closed_reading(steps.of(e), c))]
    flow_zero, sd = 0.0, max(r.sensor("flow").zero_error or 0.0 for r in tests) / 3**0.5
    if readings:
        weight = [error**-2.0 for _, error in readings]
        flow_zero, sd = float(np.average([q for q, _ in readings], weights=weight)), sum(weight) ** -0.5
    steps = steps[steps.command > SAME * c.full_command]
    steps = _opened(replace(steps, flow=steps.flow - flow_zero), c)
    for edge in steps.edges:
        own = steps.of(edge)
        voltages = Nodes.of(own, c).command.size if own.good.any() else 0
        if voltages < MIN_VOLTAGES:
            raise Problem(
                f"valve {edge}: expected flow at {MIN_VOLTAGES} voltages or more, got {voltages}; left "
                f"out of {own.command.size} steps: {own.omissions() or 'none'}"
            )
    limit = max(sum(data.zero_limits([r], ("pressure_in", "pressure_out")).values()) for r in tests)
    found = fit_openings(steps, replace(c, zero=limit, flow_zero=sd))
    return replace(found, flow_zero=(flow_zero, sd) if readings else None)


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


def _noises(recording: Recording, c: Known) -> Iterator[tuple[str, float, float]]:
    """Signals with a declared noise, their fastest noise [SI], and their scatter within a step."""
    steps = _stretches(recording, c)[2]
    for name in STEP_SIGNALS:
        sensor, samples = recording.sensor(name), recording[name]
        outside = np.where(np.abs(samples) <= sensor.dead_zone, np.nan, samples)
        scatter = [float(np.std(x)) for s in steps if (x := outside[s])[np.isfinite(x)].size == x.size > 1]
        fast = noise(samples, sensor)
        if sensor.noise > 0 and scatter and np.isfinite(fast):
            yield name, fast, max(fast, float(np.median(scatter)))


def _with_its_noise(recording: Recording, c: Known) -> Recording:
    """The recording with the noise of its data where the declared one is wrong.

    Samples would look stuck with a noise that is much too large, and a dead zone certain with one too small.
    """
    sensors = dict(recording.sensors)
    for name, fast, scatter in _noises(recording, c):
        declared = sensors[name].noise
        if declared > WRONG_NOISE * scatter > 0 or fast > WRONG_NOISE * declared:
            sensors[name] = replace(sensors[name], noise=scatter if declared > scatter else fast)
    return replace(recording, sensors=sensors)


def _steps_of(recording: Recording, c: Known) -> ValveSteps:
    """All steps of a recording; a reading in the dead zone of the meter is one, too."""
    edge, command, steps = _stretches(recording, c)
    means, meter = data.step_means(recording, steps), recording.sensor("flow")
    sign = np.where(means.drop < 0, -1.0, 1.0)
    flow = sign * means.flow
    highest = (flow + CERTAIN * means.flow_error)[means.good]  # flow along the drop that noise allows
    wrong_way = int(np.count_nonzero(highest < 0))
    if wrong_way > highest.size / 2:
        raise Problem(
            f"{recording.source}: flow: expected a flow from the higher to the lower pressure, got the "
            f"opposite direction in {wrong_way} of {highest.size} steps: change the sign of the flow, "
            "or exchange pressure_in and pressure_out"
        )
    middle = np.array([command[step].mean() for step in steps])
    size = np.sqrt([step.stop - step.start for step in steps])
    of_dead = np.array([np.nanstd(recording["flow"][step]) for step in steps]) / size
    error = np.where(means.dead, np.maximum(of_dead, meter.resolution / 12**0.5), means.flow_error)
    temperature = next((n for n in recording.signals if "temperature" in n), "")
    warmth = recording[temperature] if temperature else np.full(recording.time.size, np.nan)
    density = data.stated(recording, "density") or c.density
    drop = means.drop[np.isfinite(means.drop)]
    usual = [float(np.median(e[means.good])) if means.good.any() else 0.0 for e in (means.drop_error, error)]
    return ValveSteps(
        **vars(means)
        | {
            "drop": sign * means.drop,
            "drop_error": np.maximum(means.drop_error, usual[0]),
            "flow": flow,
            "flow_error": np.where(means.good, np.maximum(error, usual[1]), error),
        },
        command=np.abs(middle),
        command_error=np.array([command[step].std() for step in steps]) / size,
        supply_drop=np.ones(len(steps)) * np.max(np.abs(drop), initial=0.0),
        time=np.array([recording.time[step].mean() for step in steps]),
        temperature=np.array([np.nanmean(warmth[step]) if temperature else np.nan for step in steps]),
        change=np.sign(np.diff(middle, prepend=middle[:1])),
        density=np.full(len(steps), density),
        idle_flow=np.where(means.dead, meter.dead_zone + CERTAIN * meter.noise, np.nan),
        edge=np.full(len(steps), edge),
    )


def _opened(steps: ValveSteps, c: Known) -> ValveSteps:
    """Good steps are those with a certain flow; the others bound the opening."""
    certain = steps.flow - c.leakage * (2 * steps.drop - steps.supply_drop) > CERTAIN * steps.flow_error
    most = np.maximum(steps.flow, 0.0) + CERTAIN * steps.flow_error
    idle = np.where(steps.good & ~certain, most, steps.idle_flow)
    return replace(steps, good=steps.good & certain & (steps.drop > 0), idle_flow=idle)


def closed_reading(steps: ValveSteps, c: Known) -> tuple[float, float] | None:
    """Mean flow [m3/s] of a closed edge and its standard error: readings that no command changes.

    None if less than two commands have it, or a meter in its dead zone shows nothing.
    """
    told = np.isfinite(steps.flow + steps.drop) & (steps.flow_error > 0)
    s = steps[(steps.good | steps.dead) & told]
    s = s[np.argsort(s.command)]
    flow = s.flow - c.leakage * (2 * s.drop - s.supply_drop)
    last = np.flatnonzero(np.diff(s.command) > SAME * c.full_command)  # of each command but the highest
    found = None
    for k in last + 1:
        weight = s.flow_error[:k] ** -2.0
        mean = float(np.average(flow[:k], weights=weight))
        if stats.chi2.sf(float(weight @ (flow[:k] - mean) ** 2), k - 1) < UNLIKELY:
            break
        if k > last[0] + 1 and s.flow[:k].any():
            found = mean, float(weight.sum() ** -0.5)
    return found


# ---- tests of what the procedure takes for granted -----------------------------------------------------


def _findings(recordings: Sequence[Recording], found: Openings) -> Iterator[Finding]:
    """One finding per assumption: the edge that contradicts it most, for as many edges as were tested."""
    if len(found.nodes) == 1:
        (edge,) = found.nodes
        sentence = f"valve: only the edge {edge} was measured; the other three are taken to be like it."
        yield Finding("one measured edge", 0.0, sentence)
    yield from (f for f in data.signal_findings(recordings, STEP_SIGNALS, "valve") if f.fault != "noise")
    tests: dict[str, list[Test]] = {fault: [] for fault in FAULTS}
    for fault, test in (*_edge_tests(found), *_recording_tests(recordings, found)):
        tests.setdefault(fault, []).append(test)
    for fault, several in tests.items():
        if several:
            p, sentence = min(several)
            yield Finding(fault, min(1.0, len(several) * p), sentence)


def _edge_tests(found: Openings) -> Iterator[tuple[str, Test]]:
    """Tests of each edge: zeros that a straight line wants, its fall, its start, steps with one command."""
    limit, bar = found.known.zero, BAR[1]
    for edge, free in found.any_zero.items():
        if free.is_zero(found.known) and free.p >= UNLIKELY:
            sentence = (
                f"valve, edge {edge}: the opening is straight if the zeros of the two pressures differ by "
                f"{free['zero'] / bar:.3g} bar, which is more than the declared {limit / bar:.3g} bar."
            )
            yield FAULTS[0], (probability(free["zero"], free.sd("zero"), limit), sentence)
    for edge, (p, fall) in found.falling.items():
        sentence = f"valve {edge}: the opening falls by {100 * fall:.2g} % while the command rises."
        yield "falling opening", (p, sentence)
    for edge in found.nodes:
        starts = [*_start(edge, found)]
        p, sentence = min(starts, key=lambda test: test[0])
        yield "dead band", (min(1.0, p * len(starts)), sentence)
    for edge, again in found.repeated.items():
        if "lag" in again.names:
            size, unit = (1, "V of the command") if again.by_command else (100, "% of the flow")
            lag = f"valve {edge}: after a rising command the opening lags by {size * again['lag']:.2g} {unit}"
            yield "hysteresis", (again.probability("lag"), f"{lag}, against a falling one.")
            way = f"{again.span:.2g} degrees of temperature" if again.warm else f"{again.span:.2g} s"
            drift = f"the area at the same command changes by {100 * again['drift']:.2g} % over {way}."
            yield "oil temperature", (again.probability("drift"), f"valve {edge}: {drift}")
        if "zero" in again.names:
            sentence = (
                f"valve {edge}: the area does not depend on the pressures if their zeros differ by "
                f"{again['zero'] / bar:.3g} bar, which is more than the declared {limit / bar:.3g} bar."
            )
            yield FAULTS[0], (probability(again["zero"], again.sd("zero"), limit), sentence)
        times = again.times_noise
        uneven = f"valve {edge}: steps with one command scatter {times:.2g} times as much as their noise."
        yield "model", (float(stats.chi2.sf(again.chi_square / UNEVEN**2, again.freedom)), uneven)


def _recording_tests(recordings: Sequence[Recording], found: Openings) -> Iterator[tuple[str, Test]]:
    """Tests of the oil and the sensors: the reading at closed edges, the density, noise known to a factor."""
    c = found.known
    if found.flow_zero:
        (zero, sd), unit = found.flow_zero, LITRES_PER_MINUTE[1]
        limit = max(r.sensor("flow").zero_error or 0.0 for r in recordings)  # undeclared it is none
        sentence = (
            f"valve: the flow meter reads {zero / unit:.2g} L/min at closed edges, and {limit / unit:.2g} "
            "L/min is declared; the reading is subtracted."
        )
        yield "zero of a flow meter", (probability(zero, sd, limit), sentence)
    for recording in recordings:
        if density := data.stated(recording, "density"):
            sentence = (
                f"valve: {recording.source.name} was recorded with an oil of {density:.4g} kg/m3, not the "
                f"machine's of {c.density:.4g} kg/m3; the areas are those of the recorded oil."
            )
            yield "density", (0.0 if abs(density / c.density - 1) > SAME_OIL else 1.0, sentence)
        for name, fast, scatter in _noises(recording, c):
            # fast changes are not above the noise, and the scatter is not below it
            sensor, (unit_name, one) = recording.sensor(name), LITRES_PER_MINUTE if name == "flow" else BAR
            large = np.log(fast / (WRONG_NOISE * sensor.sd)) if fast > 0 else -np.inf
            small = np.log(sensor.noise / (WRONG_NOISE * np.hypot(scatter, sensor.resolution / 2)))
            sentence = (
                f"{recording.source.name}: {name}: the noise is declared as {sensor.noise / one:.2g} "
                f"{unit_name}, the data show {scatter / one:.2g} {unit_name}."
            )
            yield "noise", (float(stats.norm.sf(max(large, small) / NOISE_ERROR)), sentence)


def _start(edge: str, found: Openings) -> Iterator[Test]:
    """An edge that is open at zero command, closed where its opening would give a flow, another rounding."""
    line, nodes = found.line or (found.lines[edge] if found.straight else None), found.nodes[edge]
    if line:
        first, sd = line["start0"], line.sd("start0")
    else:
        a, v, s = nodes.area, nodes.command, nodes.sd
        length = (v[1] - v[0]) / (a[1] - a[0])
        first, sd = float(v[0] - a[0] * length), float(length * np.hypot(s[0], s[1] * a[0] / a[1]))
    yield (
        float(stats.norm.sf(-first / sd)),
        f"valve {edge}: the opening begins at {first:.2g} V: an underlapped spool, or a command with an "
        "offset. The machine has no opening at zero command.",
    )
    # steps at which the meter reads nothing, from the highest command on, although the opening is open;
    # below the lowest node the least area is that of the steepest start
    command, bound = found.steps.of(edge).idle(found.known)
    lowest, latest = nodes.command[0], float(found.curves[edge].start.max())
    steep = np.clip((command - latest) / max(lowest - latest, 1e-9), 0.0, None) * nodes.area[0]
    inside = np.interp(command, nodes.command, nodes.area)
    least = np.where(command >= lowest, inside, steep * (latest < lowest))
    p = stats.norm.sf((least - bound) / np.interp(command, nodes.command, nodes.sd))
    for k in np.argsort(-command):
        yield (
            float(p[k]),
            f"valve {edge}: the flow meter reads nothing at {command[k]:.3g} V, although the opening gives a "
            "flow: the opening has a step, or the meter was stuck.",
        )
    if line:
        yield (
            line.as_known,
            f"valve {edge}: the opening does not begin with a rounding of {found.known.rounding.value:.3g} V "
            f"as known, but with one of {line.law()[2]:.2g} V.",
        )


# ---- estimates -----------------------------------------------------------------------------------------


def zero_of(found: Openings) -> Estimate:
    """Difference of the two pressures without flow."""
    zero, sd = found.zero
    if lines := [found.line] if found.line else list(found.lines.values()) if found.straight else []:
        zero, sd = float(np.mean([line["zero"] for line in lines])), max(line.sd("zero") for line in lines)
    return Estimate.normal("pressures without flow", zero, "Pa", sd, "pressure_in - pressure_out")


def _of_line(found: Openings, line: Line, curve: OpeningCurve, edge: str = "") -> Iterator[Estimate]:
    """Area and dead band of a straight opening; the latter is as uncertain as a foot without a flow."""
    suffix = f"[{edge}]" if edge else ""
    count = sum(int(n.steps.command.size) for e, n in found.nodes.items() if edge in ("", e))
    note, full = f"fit of {count} steps, section 4(a)", found.known.full_command
    name, (area, sd), about = f"valve_area{suffix}", line.area(full), f"{note}, with C_d and density as known"
    if curve.last_measured < full * (1 - SAME):
        yield curve.estimate(name, "m2", f"{about}, extrapolated", curve.draws[:, -1], area)
    else:
        sd = float(np.hypot(sd, area * found.known.drift / 3**0.5))
        yield Estimate.normal(name, area, "m2", sd, about)
    _, start, rounding = line.law()
    name, width = f"valve_dead_band{suffix}", f"valve_command_rounding{suffix}"
    if "rounding" in line.names:
        value, sd = line.combination({"start0": 1.0, "rounding": -0.5})
        yield Estimate.normal(name, value, "V", sd, note, minimum=0.0)
        yield Estimate.normal(width, rounding, "V", line.sd("rounding"), note)
        return
    note = f"{note}, rounding {rounding:.3g} V as known; the interval is that of any foot"
    yield curve.estimate(name, "V", note, np.maximum(curve.start, 0.0), max(start - rounding / 2, 0.0))
    if rounding < found.known.rounding.value:
        note = "twice the start of the straight opening, so that the dead band is not negative"
        yield Estimate(width, rounding, "V", rounding / 12**0.5, 0.0, rounding, note)


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
    return curve.estimate(name, "V", note, np.maximum(curve.start, 0.0), float(curve.commands[0]))


def _of_edges(found: Openings) -> Iterator[Estimate]:
    """Area and start of each edge; openings at the points of the tables with their band."""
    if found.straight:
        for edge, line in found.lines.items():
            yield from _of_line(found, line, found.own[edge], edge)
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
        if found.line:
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
    c, distinct = found.known, found.distinct()
    for edge, curve in distinct.items():
        suffix = "" if len(distinct) == 1 else f"[{edge}]"
        for voltage in VOLTAGES:
            areas = curve.draws_at(voltage)
            if curve.first_measured <= voltage <= c.full_command * (1 + SAME) and areas.min() > 0:
                draws, note = c.resistance(areas), "eq. (2) with the fitted opening"
                yield curve.estimate(f"C_R({voltage:g} V){suffix}", "Pa.s2/m6", note, draws)
    if line := found.line:
        note = "zero of the straight part of the opening, extrapolated"
        yield Estimate.normal("dead_band + rounding/2", line["start0"], "V", line.sd("start0"), note)
