"""The machine as an object of identification: its parameters and signals by name, and the joint refinement.

Parameters are addressed by `part.name`. Their values are those of the parameter files, replaced by estimates.
A parameter file uses the bare `name` if the parts do not differ. A recording calls a signal `part.name`.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches

import numpy as np

from fmus.composition import declared, flat_names
from fmus.contract import quantities
from fmus.identification.balance import limit_sd, probability
from fmus.identification.procedures.procedure import SHIFT
from fmus.identification.recordings.clock import period
from fmus.identification.recordings.reading import MACHINE, add
from fmus.identification.refinement.compiled_model import delay_of, zero_of
from fmus.identification.refinement.problem import (
    EstimationProblem,
    FreeParameter,
    RecordingMap,
    free_parameters,
)
from fmus.identification.refinement.refine import RefinementResult
from fmus.identification.results import Estimate, Finding
from fmus.machine.one_block import HARVESTER, HIDDEN, TOTALS
from fmus.machine.parts import FERIC
from fmus.parameters import Number, Values, derived, entry_name, numbers, read, values
from orchestrator.base.errors import Problem
from orchestrator.data.corrections import delayed
from orchestrator.data.recording import Recording

Parameters = Mapping[str, Number]

# Parameters that a work cycle excites. Left out, because it does not excite them or other parameters have the
# same effect: inertances and resistances of the swing's lines (time constants below a millisecond), rounding
# and leakage of the valve, inertances of the hoses, geometry, displacement of the motor (on its type plate).
FREE = (
    *("valve_area", "valve_dead_band"),
    *("line_capacitance", "internal_leakage_resistance", "external_leakage_resistance"),
    *("boom_hose_capacitance", "boom_hose_resistance", "stick_hose_capacitance", "stick_hose_resistance"),
    *("column_inertia", "boom_mass", "stick_mass", "stick_inertia", "head_mass"),
    *("swing_damping", "boom_piston_damping", "stick_piston_damping"),
)
PRIOR_SD = 0.3  # relative, of a value that was not measured: the scatter of the literature
COMMANDS = {name: FERIC.inputs[name][0] for name in ("swing_command", "boom_command", "stick_command")}
# s, less if it would remove more than the noise of the sensor
SMOOTHING = {"supply_pressure": 20.0, "tank_pressure": 20.0}
RETURN = FERIC.inputs["tank_pressure"][0]


def nominal() -> dict[str, Number]:
    """All parameters of the parts and their variants from the parameter files, also the derived ones."""
    return {
        f"{part}.{name}": number
        for part, sub in FERIC.subsystems.items()
        for in_file in [read(sub.folder / "parameters.toml")["parameters"]]
        for name, number in (in_file | dict(numbers(sub)["parameters"]) | derived(sub)).items()
    }


def targets_of(name: str, parameters: Parameters) -> list[str]:
    """The parameters `part.name` that a name refers to: a bare name to those of all parts."""
    return [full for full in parameters if name in (full, full.partition(".")[2])]


def short_name(name: str, parameters: Parameters) -> str:
    """The bare name if it refers to the same parameters, else the name."""
    bare = name.rpartition(".")[2]
    return bare if targets_of(bare, parameters) == targets_of(name, parameters) else name


def lookup(name: str, parameters: Parameters) -> Number:
    """The parameter with this name, with or without part."""
    return parameters[targets_of(name, parameters)[0]]


def updated(parameters: Parameters, estimates: Iterable[Estimate]) -> dict[str, Number]:
    """The parameters with estimates in place of known values; a bare name sets it in every part."""
    result = dict(parameters)
    for estimate in estimates:
        targets = targets_of(estimate.name, parameters)
        if not targets:
            raise Problem(f"estimates: expected parameters of the machine, got {estimate.name}")
        if estimate.listed and estimate.name == entry_name(estimate.listed, 1):  # a new list replaces all
            stem = estimate.name.rpartition("_")[0]
            entries = [n for n in result if n.partition(".")[2].rpartition("_")[0] == stem]
            result |= {n: replace(result[n], value=0.0, sd=None) for n in entries}
        result |= dict.fromkeys(targets, estimate.number())
    return result


def _flat_names() -> dict[str, str]:
    """`part.name` -> variable of `HARVESTER`."""
    tables = {name: numbers(sub) for name, sub in FERIC.subsystems.items()}
    return dict(flat_names(FERIC.subsystems, tables, FERIC.inputs, TOTALS, HIDDEN))


def signal_names() -> dict[str, str]:
    """Input or output of `HARVESTER` -> signal of a recording, such as "swing.supply_pressure"."""
    names = {name: targets[0] for name, targets in FERIC.inputs.items()}
    flat, outputs = _flat_names(), quantities(HARVESTER.outputs)
    for variable in declared(FERIC.subsystems, "outputs"):
        if variable in flat and flat[variable] in outputs:
            names.setdefault(flat[variable], variable)
    return names


def parameter_names() -> dict[str, str]:
    """Parameter of `HARVESTER` -> its name in parameters.toml, `part.name` if the parts differ."""
    flat, variables = _flat_names(), declared(FERIC.subsystems, "parameters")
    return {flat[v]: flat[v] if v.partition(".")[2] == flat[v] else v for v in variables}


def check_free(names: Sequence[str]) -> dict[str, str]:
    """Name in parameters.toml -> parameter of `HARVESTER`. Raises Problem if one of `names` is missing."""
    flat_of = {name: flat for flat, name in parameter_names().items()}
    for name in names:
        if name not in flat_of:
            similar = get_close_matches(name, flat_of, 1) or [", ".join(sorted(flat_of))]
            raise Problem(f"free parameters: expected a parameter of the machine ({similar[0]}), got {name}")
    return flat_of


def problem(
    recordings: Sequence[Recording], parameters: Parameters, names: Sequence[str] = FREE
) -> EstimationProblem:
    """The joint refinement as an output-error problem; recordings with use "test" are held out.

    The zeros of sensors that declare a `zero_error` are free as well, and delays with a `delay_error`.

    parameters   their values are the priors, with their standard deviations or `PRIOR_SD`
    names        free parameters, as in parameters.toml
    """
    flat_of, signals = check_free(names), signal_names()
    for recording in recordings:
        for command in COMMANDS.values():
            _ = recording[command]  # a drive without its command would be simulated at rest
    train, test = ([r for r in recordings if r.use == use] for use in ("train", "test"))
    defaults, outputs = values(HARVESTER), _measured_outputs(train)
    p = {flat: lookup(name, parameters).value for name, flat in flat_of.items()}
    fixed = Values(p, defaults.u, defaults.x)
    known = {flat_of[name]: lookup(name, parameters) for name in names}
    priors = {n: (k.value, k.sd or PRIOR_SD * abs(k.value) or None) for n, k in known.items()}
    zero_at_rest = ("_speed", "_flow", "_flow_a", "_flow_b")
    mapping = RecordingMap(
        HARVESTER,
        outputs=outputs,
        signals=signals,
        smooth=SMOOTHING,
        rest=[n for n in quantities(HARVESTER.states) if n.endswith(zero_at_rest)],
        values=fixed,
    )
    free = [  # on a logarithmic scale at most a factor of ten from the value
        replace(f, low=max(f.low, f.value / 10), high=min(f.high, f.value * 10)) if f.log else f
        for f in free_parameters(HARVESTER, list(known), priors, fixed)
    ]
    measured = {n: signals[n] for n in outputs}
    return EstimationProblem(
        sub=HARVESTER,
        outputs=outputs,
        free=(*free, *_errors(train, measured)),
        training=tuple(map(mapping.run, train)),
        held_out=tuple(map(mapping.run, test)),
        fixed=fixed,
        labels=parameter_names() | measured,
    )


def _errors(recordings: Sequence[Recording], signals: Mapping[str, str]) -> Iterator[FreeParameter]:
    """The zeros of sensors that declare a `zero_error`, the delays of inputs with a `delay_error`.

    A reading is the output of the model plus its zero. An encoder that was mounted 2 degrees off makes the
    masses wrong that carry the arm, with intervals that do not know of it. The zero is bounded by the
    declared error, so that it cannot take the place of a force that the model lacks. A command of the time of
    its request, and not of that at which the valve acts, makes capacitances, dampings and leakages wrong by
    up to several times.

    signals   measured output -> its signal
    """
    units = {n: q.unit for n, q in quantities(HARVESTER.outputs).items()}
    errors = [
        (zero_of(n), units[n], [r.sensor(s).zero_error or 0.0 for r in recordings])
        for n, s in signals.items()
    ]
    for n in quantities(HARVESTER.inputs):
        errors.append((delay_of(n), "s", [r.sensor(FERIC.inputs[n][0]).delay_error for r in recordings]))
    for name, unit, stated in errors:
        if (most := max(stated)) > 0:
            yield FreeParameter(name, 0.0, unit, limit_sd(most), -most, most, scale=most)


def _measured_outputs(training: Sequence[Recording]) -> tuple[str, ...]:
    """Outputs that a training recording has a sensor for."""
    if not training:
        raise Problem("joint refinement: expected a recording of the machine to train with, got none")
    names = signal_names()
    outputs = [n for n in quantities(HARVESTER.outputs) if n in names]
    measured = tuple(n for n in outputs if any(names[n] in r.signals for r in training))
    if not measured:
        expected = ", ".join(names[n] for n in outputs)
        raise Problem(f"{training[0].source}: measured signals: expected one of {expected}, got none")
    return measured


def with_return_line(recording: Recording) -> Recording:
    """The recording, with the stated pressure of the return line as a signal if it was not measured."""
    if RETURN in recording.signals or "tank_pressure" not in recording.conditions:
        return recording
    stated = np.full(recording.time.size, recording.numeric_condition("tank_pressure"))
    return add(recording, RETURN, stated, "Pa")


def assumptions(recordings: Sequence[Recording]) -> list[str]:
    """Sentences on inputs that are neither measured nor stated and therefore constant."""
    usual = values(HARVESTER).u
    lines = {
        FERIC.inputs[f"{line}_pressure"][0]: (line, usual[f"{line}_pressure"]) for line in ("supply", "tank")
    }
    return [
        f"{r.source.name}: the {line} pressure is not measured, assumed constant at {constant / 1e5:g} bar"
        for r in recordings
        for signal, (line, constant) in lines.items()
        if signal not in r.signals
    ]


def estimates(refined: RefinementResult) -> tuple[Estimate, ...]:
    """The estimated parameters of the machine, as parameters.toml calls them: no `zeros` or `delays`."""
    return tuple(e for e in refined.estimates() if not e.name.startswith((zero_of(""), delay_of(""))))


def zeros(refined: RefinementResult) -> dict[str, Estimate]:
    """Signal -> estimated zero of its sensor."""
    of_sensors = [e for e in refined.estimates() if e.name.startswith(zero_of(""))]
    return {refined.problem.label(e.name.removeprefix(zero_of(""))): e for e in of_sensors}


def delays(refined: RefinementResult) -> dict[str, Estimate]:
    """Signal -> by how much it acts later than its time stamps, as far as that was estimated."""
    of_inputs = [e for e in refined.estimates() if e.name.startswith(delay_of(""))]
    return {FERIC.inputs[e.name.removeprefix(delay_of(""))][0]: e for e in of_inputs}


def sensor_sentences(refined: RefinementResult) -> list[str]:
    """One sentence on each estimated zero of a sensor, in display units, and on each estimated delay."""
    found = [("zero of the sensor", name, e, 3) for name, e in zeros(refined).items()]
    found += [("delay", name, e, e.digits) for name, e in delays(refined).items()]
    return [
        f"{what} of {signal}: {value} {unit} ({low} to {high} {unit})"
        for what, signal, e, digits in found
        for value, low, high, unit in [e.displayed(digits)]
    ]


def findings(refined: RefinementResult) -> tuple[Finding, ...]:
    """Tests of the residuals and of the times of the inputs that declare a `delay_error`.

    Does each signal have the noise of its sensor, and nothing else? Does each input act when it was logged?
    """
    tests = {name: test for name, test in refined.whiteness.items() if np.isfinite(test.rms)}
    found = []
    if tests:
        name, worst = min(tests.items(), key=lambda item: (item[1].excess, -item[1].rms))
        p = min(1.0, len(tests) * worst.excess)  # the least of several p-values [Bonferroni]
        rms = f"{worst.rms:.3g} times the noise of its sensor"
        sentence = f"the model misses {name} by more than noise: the residual is {rms}."
        found.append(Finding("model", p, sentence))
    tolerance = SHIFT * min(period(run.time) for run in refined.problem.training)
    for name, e in delays(refined).items():
        late = f"{name} acts {1e3 * e.value:.3g} +- {1e3 * e.sd:.2g} ms later than logged"
        p = probability(e.value, e.sd, tolerance)
        found.append(Finding("time shift", p, f"{late}; the estimates are without this delay."))
    return tuple(found)


def corrected(recordings: Sequence[Recording], refined: RefinementResult) -> list[Recording]:
    """The recordings of the machine without the estimated zeros of its sensors and delays of its inputs."""
    result = []
    for r in recordings:
        if r.procedure == MACHINE:
            own = {n: r[n] - e.value for n, e in zeros(refined).items() if n in r.signals}
            late = {n: delayed(r[n], r.time, e.value) for n, e in delays(refined).items() if n in r.signals}
            r = replace(r, signals={**r.signals, **own, **late})
        result.append(r)
    return result
