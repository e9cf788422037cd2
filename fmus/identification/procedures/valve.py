"""Valve procedure (section 4(a), Fig. 5): opening of the metering edges over the command.

    C_R = (P_in - P_out)/(Q|Q|), eq. (1)        C_R = rho/(2 C_d^2 A(V)^2), eq. (2)

The data are means over each step with their standard errors. Two descriptions of A(V) are compared:

- a straight line with a dead band and a rounded foot (`valve_law`), fitted to the flow;
- a curve of any rising shape (`opening_posterior`), with its 95 % band; a table of up to ten points
  (`opening_fit`) describes it for the machine.

If the data of no edge prefer the curve significantly (likelihood ratio), a straight line suffices: area and
dead band are the result, fitted to all edges together unless these differ. Otherwise each edge gets a table,
the same one if the edges do not differ. The difference of the two pressures without flow, an offset of the
transducers, is estimated as well, within the zero errors of their data sheets.

Validity: steady flow above the dead zone of the meter; the opening rises with the command. Only the product
C_d A sqrt(2/rho) is measured: the area is valid for the known C_d and density.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.polynomial import Polynomial

from fmus.identification.estimate import Estimate
from fmus.identification.finding import Finding
from fmus.identification.procedure_result import BAR, ProcedureResult
from fmus.identification.procedures.experiment_data import (
    difference_limit,
    parameter,
    pressure_offset_remark,
    select,
    training_recordings,
)
from fmus.identification.procedures.opening_fit import SAME, OpeningCurve
from fmus.identification.procedures.regression import misfit_remark, misfit_warning
from fmus.identification.procedures.valve_law import (
    ValveConstants,
    ValveFit,
    ValveSteps,
    impossible,
    polynomial,
    resistance,
    resistance_of,
    valve_steps,
)
from fmus.identification.procedures.valve_openings import EQUAL, Openings, fit_openings
from fmus.identification.procedures.valve_panels import by_curve, log_polynomial, panels
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

SIGNALS: Mapping[str, str] = {"command": "V", "pressure_in": "Pa", "pressure_out": "Pa", "flow": "m3/s"}
VOLTAGES = (1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 10.0)  # V, at which C_R is reported
ROUNDING = "boom_stick.valve_command_rounding"
UNREAL = 100.0  # times the full command, or a part of it
METER_NOISE = 4.0  # standard deviations above its dead zone in which a meter may still read nothing
SAME_WAY = {"P-A": "B-T", "B-T": "P-A", "P-B": "A-T", "A-T": "P-B"}  # edges that one direction opens


def identify(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ProcedureResult:
    """Area and dead band or opening curve of the valve's edges, and C_R over the command."""
    openings = identify_openings(recordings, parameters)
    constants, zero = openings.constants, openings.zero
    corrected = replace(openings.steps, drop=openings.steps.drop - zero.value)
    estimates = _with_foot(openings) if openings.line else _of_curves(openings)
    return ProcedureResult(
        procedure="valve",
        title="Valve: C_R of the metering edges over the command",
        figure=5,
        estimates=tuple(estimates),
        panels=panels(corrected, openings.areas(), openings.curves, constants),
        remarks=tuple(remarks(corrected, openings)),
        others=(*_curve(openings), zero, *_of_edges(openings)),
        findings=tuple(_findings(openings)),
        warnings=tuple(_warnings(openings)),
        listed=tuple(_no_tables(parameters) if openings.line else _tables(openings)),
    )


def identify_openings(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> Openings:
    """The openings of the edges with their bands."""
    tests = training_recordings(recordings, "valve", SIGNALS)
    constants = ValveConstants.of(parameters)
    for recording in tests:
        _check_commands(recording, constants.full_command)
    limit = difference_limit(tests, ("pressure_in", "pressure_out"))
    meters = [recording.sensor("flow") for recording in tests]
    # up to this flow a meter may read nothing; without a dead zone there is no such flow
    idle = max((m.dead_zone + METER_NOISE * m.noise if m.dead_zone else 0.0) for m in meters)
    rounding = parameter(parameters, ROUNDING)
    return fit_openings(valve_steps(tests), constants, rounding, limit, idle)


def _check_commands(recording: Recording, full: float) -> None:
    """Raise Problem for commands that no valve of this kind gets, such as mV taken as V."""
    largest = float(np.nanmax(np.abs(recording["command"])))
    if not full / UNREAL < largest < full * UNREAL:
        expected = f"expected a full command of about {full:g} V, got {largest:g} V: is its unit right?"
        raise Problem(f"{recording.source}: command: {expected}")


def _findings(openings: Openings) -> Iterator[Finding]:
    """Tests of what the procedure takes for granted: zeros within their declaration, rising openings."""
    for edge, fitted in openings.separate.items():
        if (p := fitted.zero_probability()) is not None:
            zero, limit = fitted.free_zero["zero"] / BAR[1], openings.zero_limit / BAR[1]
            yield Finding(
                "zero of a pressure sensor",
                p,
                f"valve {edge}: a straight opening fits if the zeros of the two pressures differ by "
                f"{zero:.3g} bar, but not within the declared {limit:.3g} bar.",
            )
    for edge, (p, fall) in openings.falling.items():
        sentence = f"valve {edge}: the opening falls by {100 * fall:.2g} % while the command rises."
        yield Finding("falling opening", p, sentence)


def _warnings(openings: Openings) -> Iterator[str]:
    """Residuals far above the noise, an opening that no result can describe."""
    if openings.line:
        yield from misfit_warning(openings.line.regression.times_noise, "valve: the straight opening")
        yield from _below_zero(openings.line)
    elif openings.straight:
        for edge, fitted in openings.separate.items():
            yield from misfit_warning(fitted.regression.times_noise, f"valve {edge}: the straight opening")
    else:
        yield from misfit_warning(openings.scatter, "valve: the mean of steps with one command")
    for edge, command in openings.idle.items():
        yield (
            f"valve {edge}: the flow meter reads zero at {command:.3g} V, although the estimated "
            "opening gives a flow well above the dead zone of the meter: the opening has a step, or "
            "the meter was stuck."
        )


def _below_zero(line: ValveFit) -> Iterator[str]:
    """A sentence if the dead band is one that the machine refuses, because the known rounding is too long."""
    law = line.law()
    if law.dead_band < 0:
        longest = max(2 * law.dead_band + law.rounding, 0.0)
        yield (
            f"valve: the dead band is {law.dead_band:.3g} V, which the model does not accept. The "
            f"straight opening starts at {longest / 2:.3g} V, so valve_command_rounding must be at "
            f"most {longest:.3g} V instead of {law.rounding:.3g} V: change this value in "
            "parameters.toml and identify again."
        )


def _with_foot(openings: Openings) -> Iterator[Estimate]:
    """The straight line of all edges; the dead band is as uncertain as a foot that no flow shows."""
    assert openings.line
    start = next(iter(openings.curves.values())).draws.start
    for estimate in _of_line(openings.line):
        if estimate.name == "valve_dead_band" and "rounding" not in openings.line.regression.names:
            low, high = np.quantile(start, [0.025, 0.975])
            low, high = min(float(low), estimate.low), max(float(high), estimate.high)
            yield replace(estimate, low=low, high=high, sd=max(float(start.std()), estimate.sd))
        else:
            yield estimate


def _of_line(fitted: ValveFit, edge: str = "") -> Iterator[Estimate]:
    fit, suffix = fitted.regression, f"[{edge}]" if edge else ""
    note = f"fit of {len(fitted.steps.flow)} steps, section 4(a)"
    yield fit.estimate(f"valve_area{suffix}", "m2", f"{note}, with C_d and density as known", "area")
    rounding = "" if fitted.rounding_estimated else f", rounding {fitted.rounding:g} V as known"
    yield fit.estimate(f"valve_dead_band{suffix}", "V", note + rounding, "dead_band")
    if fitted.rounding_estimated:
        yield fit.estimate(f"valve_command_rounding{suffix}", "V", note, "rounding")


def _of_curves(openings: Openings) -> Iterator[Estimate]:
    """Area of the edge that opens furthest, and the first start of an opening."""
    largest = max(openings.curves.values(), key=lambda curve: float(curve.areas[-1]))
    yield _full_area(
        largest, "valve_area", "at full command by the opening curve, with C_d and density as known"
    )
    earliest = min(openings.curves.values(), key=lambda curve: float(curve.commands[0]))
    note = "start of the opening curve; the tables of the edges replace it"
    yield earliest.estimate("valve_dead_band", "V", note, earliest.draws.start, float(earliest.commands[0]))


def _full_area(curve: OpeningCurve, name: str, note: str) -> Estimate:
    return curve.estimate(
        name, "m2", f"{note}, section 4(a)", curve.draws.area[:, -1], float(curve.areas[-1])
    )


def _of_edges(openings: Openings) -> Iterator[Estimate]:
    """Area and start of each edge; openings at the points of the tables with their band."""
    if openings.line or openings.straight:
        for edge, fitted in openings.separate.items():
            yield from _of_line(fitted, edge)
        return
    full = max(float(curve.areas[-1]) for curve in openings.curves.values())
    for edge, curve in openings.distinct().items():
        yield _full_area(curve, f"valve_area[{edge}]", "at full command")
        start = float(curve.commands[0])
        yield curve.estimate(
            f"valve_dead_band[{edge}]", "V", "start of the opening", curve.draws.start, start
        )
        yield curve.estimate(f"exponent[{edge}]", "1", "of the power law, 1: a line", curve.draws.exponent)
        for command, area, low, high in zip(
            curve.commands[1:], curve.areas[1:], *curve.band_at(curve.commands[1:]), strict=True
        ):
            note = "point of the table, relative to valve_area; the interval is that of the 95 % band"
            sd = float(curve.draws_at(command).std()) / full
            name = f"opening[{edge}]({command:.3g} V)"
            yield Estimate(name, area / full, "1", sd, low / full, high / full, note)


def _tables(openings: Openings) -> Iterator[Estimate]:
    """Points of the tables of all edges as parameters; an untested edge gets the table of another."""
    tested = openings.curves
    largest = max(float(curve.areas[-1]) for curve in tested.values())
    note = "opening curve of edge {}, section 4(a); relative to valve_area"
    for edge, other in SAME_WAY.items():
        source = edge if edge in tested else other if other in tested else next(iter(tested))
        curve, name = tested[source], edge.replace("-", "").lower()
        for i, command in enumerate(curve.commands, 1):
            listed = f"valve_{name}_commands"
            yield _entry(f"valve_{name}_command_{i}", float(command), "V", 0.0, note.format(source), listed)
        for i, (command, area) in enumerate(zip(curve.commands, curve.areas, strict=True), 1):
            sd = float(curve.draws_at(command).std()) / largest if i > 1 else 0.0
            opening, listed = float(area) / largest, f"valve_{name}_openings"
            yield _entry(f"valve_{name}_opening_{i}", opening, "1", sd, note.format(source), listed)


def _no_tables(parameters: Mapping[str, Number]) -> Iterator[Estimate]:
    """Empty tables in place of known ones, because a straight line suffices."""
    for edge in SAME_WAY:
        name, note = edge.replace("-", "").lower(), "no table: a straight line suffices, section 4(a)"
        known = parameters.get(f"boom_stick.valve_{name}_command_2")
        if known and known.value > 0:
            for kind, unit in (("command", "V"), ("opening", "1")):
                yield _entry(f"valve_{name}_{kind}_1", 0.0, unit, 0.0, note, f"valve_{name}_{kind}s")


def _entry(name: str, value: float, unit: str, sd: float, note: str, listed: str) -> Estimate:
    return replace(Estimate.normal(name, value, unit, sd, note, minimum=0.0), listed=listed)


def _curve(openings: Openings) -> Iterator[Estimate]:
    """C_R at the voltages of `VOLTAGES`, and the foot of a straight opening."""
    constants, line = openings.constants, openings.line
    if line is None:
        for edge, curve in openings.distinct().items():
            suffix = "" if len(openings.distinct()) == 1 else f"[{edge}]"
            for voltage in VOLTAGES:
                if curve.first_measured <= voltage <= constants.full_command:
                    draws = resistance_of(curve.draws_at(voltage), constants)
                    name, note = f"C_R({voltage:g} V){suffix}", "eq. (2) with the opening curve"
                    yield curve.estimate(name, "Pa.s2/m6", note, draws)
        return
    law, fit = line.law(), line.regression
    for voltage in VOLTAGES:
        if law.dead_band + law.rounding / 4 < voltage <= constants.full_command:
            yield fit.derived(
                f"C_R({voltage:g} V)",
                "Pa.s2/m6",
                "eq. (2) with the fitted opening",
                partial(lambda v, p: float(resistance(np.array([v]), line.law(p), constants)[0]), voltage),
            )
    yield fit.derived(
        "dead_band + rounding/2",
        "V",
        "zero of the straight part of the opening, extrapolated",
        lambda p: p["dead_band"] + p.get("rounding", line.rounding) / 2,
    )


TINY = 1e-9  # smaller probabilities are not told apart


def remarks(steps: ValveSteps, openings: Openings) -> Iterator[str]:
    """All remarks; `steps` are corrected for the offset of the transducers."""
    good, dead = steps.measured(), select(steps, steps.dead)
    if dead.command.size:
        yield (
            f"{dead.command.size} of {steps.command.size} steps, up to {dead.command.max():.3g} V, are "
            "masked: the flow is in the dead zone of the meter, the flat region of Fig. 5. The curve in this "
            f"region is {'the extrapolated opening law' if openings.straight else 'extrapolated'}."
        )
    if omissions := select(steps, ~steps.dead).omissions():
        yield f"Other steps are left out: {omissions}."
    yield from _line_or_curve(openings)
    yield from _full_command(good, openings.constants.full_command)
    yield _edges_remark(openings)
    for edge, steps_of in by_curve(good, openings.curves).items():
        label = f"{edge}: " if edge else ""
        yield label + _polynomial_remark(steps_of, openings.constants)
        yield label + _logarithm_remark(steps_of)
    if openings.line:
        yield from misfit_remark(openings.line.regression, "The opening law")
    yield from pressure_offset_remark(openings.zero.value, openings.zero.sd)
    percent = 100 * BAR[1] / (2 * float(good.drop.mean()))  # A ~ Q / sqrt(dp)
    yield (
        "The intervals cover the noise of the instruments, but not calibration errors. An error of "
        "1 % in the gain of the flow meter changes the area by 1 %, and an error of 1 bar between "
        f"the two pressures by {percent:.2g} %."
    )


def _line_or_curve(openings: Openings) -> Iterator[str]:
    edge, probability = min(openings.probability.items(), key=lambda item: item[1])
    test = f"likelihood ratio test against a curve, {edge}: {_chance(probability)}"
    if openings.straight:
        yield f"A straight line with a dead band suffices ({test})."
        if openings.line and not openings.line.rounding_estimated:
            yield (
                "No flow was measured at the rounded start of the opening, so the data determine "
                "only the zero of the extrapolated straight part. The dead band is this zero minus "
                f"half the known rounding of {openings.line.rounding:.3g} V: a rounding that is 0.1 "
                "V larger makes the dead band 0.05 V smaller."
            )
        return
    yield (
        f"A straight line does not suffice ({test}). The openings are tables, valve_pa_commands, "
        "valve_pa_openings and so on, which the machine reads in place of valve_dead_band."
    )
    for edge, curve in openings.distinct().items():
        half = (curve.high - curve.low) / 2 / curve.area.clip(1e-12)
        percent = 100 * float(np.median(half[curve.command >= curve.first_measured]))
        low, high = np.quantile(curve.draws.start, [0.025, 0.975])
        exponent = float(np.median(curve.draws.exponent))
        yield (
            f"{edge}: the opening starts at {curve.commands[0]:.3g} V ({low:.3g} to {high:.3g} V) and rises "
            f"about as the power {exponent:.3g} of the command behind it. The 95 % band is "
            f"{percent:.2g} % wide to either side above {curve.first_measured:.3g} V."
        )


def _full_command(good: ValveSteps, full: float) -> Iterator[str]:
    """A sentence if an edge was not measured at full command, where its area is defined."""
    for edge in good.edges:
        highest = float(good.of(edge).command.max())
        if highest < full - SAME:
            yield (
                f"{edge}: no flow was measured above {highest:.3g} V, so the area at {full:.3g} V is "
                "extrapolated. Hold the full command twice in such an experiment."
            )


def _edges_remark(openings: Openings) -> str:
    edges = list(openings.curves)
    if len(edges) < 2:
        return f"Only the edge {edges[0]} was tested."
    kind = "chi-square test" if openings.straight else "likelihood ratio test"
    if openings.equal > EQUAL:
        return f"The {len(edges)} edges do not differ significantly ({kind}, p = {openings.equal:.2g})."
    areas = {
        edge: openings.separate[edge].regression["area"] if openings.straight else curve.areas[-1]
        for edge, curve in openings.curves.items()
    }
    by_edge = ", ".join(f"{edge} {area * 1e6:.4g} mm2" for edge, area in areas.items())
    return f"The edges differ significantly ({kind}, {_chance(openings.equal)}): {by_edge}."


def _chance(probability: float) -> str:
    return f"p = {probability:.2g}" if probability > TINY else f"p < {TINY:g}"


def _polynomial_remark(good: ValveSteps, constants: ValveConstants) -> str:
    paper = polynomial(good.command, good.resistance)
    commands = np.linspace(good.command.min(), constants.full_command, 2000)
    bad = impossible(paper, commands)
    subject = f"The paper's form, a polynomial (degree {paper.degree()} by AIC),"
    if not bad.any():
        return f"{subject} stays positive and falls: C_R = {_in_powers(paper)} Pa.s2/m6, V in volts."
    voltages, negative = commands[bad], "is negative or " if (paper(commands) < 0).any() else ""
    return (
        f"{subject} is shown but not used: between {voltages.min():.2g} and {voltages.max():.2g} V it "
        f"{negative}rises with the command in places, which is impossible for C_R."
    )


def _logarithm_remark(good: ValveSteps) -> str:
    fitted = log_polynomial(good)
    error = float(np.abs(fitted(good.command) - np.log(good.resistance)).max())
    return (
        f"The same form for the logarithm (degree {fitted.degree()} by AIC) stays positive: ln C_R = "
        f"{_in_powers(fitted)}, C_R in Pa.s2/m6, V from {good.command.min():.3g} to "
        f"{good.command.max():.3g} V; the largest error of a step is {100 * error:.2g} %."
    )


def _in_powers(curve: Polynomial) -> str:
    """A polynomial in powers of the command V."""
    terms = [f"{c:.6g}" + ("" if k == 0 else " V" if k == 1 else f" V^{k}") for k, c in _terms(curve)]
    return " + ".join(terms).replace("+ -", "- ")


def _terms(curve: Polynomial) -> Iterator[tuple[int, float]]:
    return enumerate(map(float, curve.convert(domain=(-1, 1), window=(-1, 1)).coef))
