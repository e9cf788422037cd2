"""Prediction of a recording: the machine with the estimates, simulated and compared with the measurement.

An input that leaves its range in training makes a prediction an extrapolation.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fmus.composition import declared
from fmus.identification.machine import COMMANDS, zeros
from fmus.identification.pipeline import Identified
from fmus.identification.procedures.momentum_balance import JOINTS
from fmus.identification.recordings.clock import filter_for
from fmus.identification.recordings.masks import good
from fmus.identification.results import coverage_factor
from fmus.machine.machine import wiring
from fmus.machine.parts import FERIC
from fmus.monolith import breakpoints, join, simulate
from fmus.parameters import values
from orchestrator.base.errors import Problem
from orchestrator.base.signals import rms
from orchestrator.base.text import display_unit
from orchestrator.data.recording import Recording, fill_gaps
from orchestrator.data.table import Array

Signals = Mapping[str, Array]
LINES = ("supply_pressure", "tank_pressure")  # inputs of the machine that a recording may have measured
REST = 0.5  # s at the beginning of a recording, over which the initial pose is averaged
SMOOTHING = 0.05  # s, filter against the noise of the pressures of the lines; the pumps are slower
LINE_TOLERANCE = 5e4  # Pa, error of the supply pressure that changes flows by 0.1 %
COMMAND_TOLERANCE = 1e-4  # V, error of a command that changes the opening of a valve by 0.001 %
TOLERANCE = 1e-8  # of CVODES, far below the resolution of sensors; dry friction requires it
WINDOW = 0.1  # s, filter that differentiates angles, wide enough for the encoder's steps
CONSTANT = 1e-9  # range over largest value below which a signal is constant
MARGIN = 0.01  # of the largest value in training, by which an input may leave its range
BRIEF = 0.05  # share of samples between zero and the range in training: a ramp
QUANTITIES = ("angle", "speed", "pressure", "flow")


@dataclass(frozen=True)
class Excitation:
    """Inputs of the machine: commands [V] (n,) over time (n,) [s], and the initial pose [rad].

    lines   measured pressures of supply and return line (n,) [Pa]; the others have their constant value
    """

    time: Array
    commands: Mapping[str, Array]
    pose: Mapping[str, float]
    lines: Mapping[str, Array] = field(default_factory=dict)


def excitation(recording: Recording) -> Excitation:
    """The excitation during a recording of the machine, which is at rest in its first `REST` seconds."""
    pose = {}
    for joint in JOINTS:
        name = f"manipulator.{joint}_angle"
        first = recording[name][recording.time <= recording.time[0] + REST]
        if not np.isfinite(first).any():
            raise Problem(f"{recording.source}: {name}: expected a sample in the first {REST:g} s, got none")
        pose[joint] = float(np.nanmean(first))
    samples = np.column_stack([fill_gaps(recording, signal) for signal in COMMANDS.values()])
    commands = dict(zip(COMMANDS, simplify(recording.time, samples).T, strict=True))
    lines = {}
    for name in (n for n in LINES if f"swing.{n}" in recording.signals):
        smooth = filter_for(recording, SMOOTHING).apply(fill_gaps(recording, f"swing.{name}"))
        at = np.isfinite(smooth)  # not at the ends
        smooth = np.interp(recording.time, recording.time[at], smooth[at])
        lines[name] = simplify(recording.time, smooth[:, None], LINE_TOLERANCE)[:, 0]
    return Excitation(recording.time, commands, pose, lines)


def simplify(time: Array, samples: Array, tolerance: float = COMMAND_TOLERANCE) -> Array:
    """Samples (n, m) on straight lines between few of them.

    The solver restarts at every corner of an input, and rounding in a file makes every sample a corner.
    """
    corners = breakpoints(time, samples, max(tolerance, 1e-12))
    return np.column_stack([np.interp(time, time[corners], column[corners]) for column in samples.T])


def predict(
    excitation: Excitation, parameters: Mapping[str, float], variants: Mapping[str, str] | None = None
) -> Signals:
    """All outputs of the machine, `part.name`, shape (n,) each, and the commands.

    parameters   values by `part.name`; others are those of the files, and a variant may lack some
    variants     part -> its variant, for parts that are not the default ones
    """
    machine = FERIC.chosen(**(variants or {}))
    pose = {f"manipulator.initial_{joint}_angle": angle for joint, angle in excitation.pose.items()}
    known, chosen = {**parameters, **pose}, {part: values(sub) for part, sub in machine.items()}
    for part, own in chosen.items():
        chosen[part] = replace(own, p={n: known.get(f"{part}.{n}", p) for n, p in own.p.items()})
    model = join(machine, *wiring(machine), chosen)
    u = np.tile(model.u, (excitation.time.size, 1))
    for name, samples in {**excitation.commands, **excitation.lines}.items():
        if name in model.inputs:  # a variant with a supply computes the pressures of its lines
            u[:, model.inputs.index(name)] = samples
    try:
        _, y = simulate(model, excitation.time, u, tolerance=TOLERANCE)
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1]
        raise Problem(f"machine with variants {dict(variants or {})}: the solver failed: {reason}") from None
    outputs = dict(zip(model.output_names, y.T, strict=True))
    return outputs | {signal: excitation.commands[name] for name, signal in COMMANDS.items()}


@dataclass(frozen=True)
class RecordingComparison:
    """Measured and predicted signals by name, in SI units, shape (n,); NaN if no good sample was measured.

    Speeds are added to measured angles. Measured and predicted speeds are derivatives by the same filter.

    sd              standard deviation of measured minus predicted, of the signals for which it is known
    sensitivities   identified parameter -> change of the signals by its search variable
    """

    recording: Recording
    measured: Signals
    predicted: Signals
    units: Mapping[str, str]
    sd: Signals = field(default_factory=dict)
    sensitivities: Mapping[str, Signals] = field(default_factory=dict)

    def band(self, name: str) -> tuple[Array, Array]:
        """Lower and upper end of the pointwise 95 % band of the readings of a signal, (n,) each."""
        half = coverage_factor() * self.sd[name]
        return self.predicted[name] - half, self.predicted[name] + half

    def held(self) -> dict[str, float]:
        """Share of the good samples of each signal in its band."""
        shares = {}
        for name in (n for n in self.sd if n in self.measured):
            (low, high), y = self.band(name), self.measured[name]
            if (good := np.isfinite(y)).any():
                shares[name] = float(np.mean(((low <= y) & (y <= high))[good]))
        return shares

    def residual(self) -> dict[str, Array]:
        """Measured - predicted of every signal that has a sensor and is an output of the machine."""
        names = [n for n in self.recording.signals if n in self.predicted]
        return {n: self.measured[n] - self.predicted[n] for n in names}

    def nrmse(self) -> dict[str, float]:
        """NRMSE of all signals that are not constant."""
        errors = {n: nrmse(y, self.predicted[n]) for n, y in self.measured.items() if n in self.predicted}
        return {name: error for name, error in errors.items() if error is not None}


def worst(errors: Mapping[str, float]) -> dict[str, tuple[str, float]]:
    """The signal with the largest NRMSE of each quantity, and its NRMSE."""
    by_quantity = {q: {n: e for n, e in errors.items() if q in n.split("_")} for q in QUANTITIES}
    return {q: max(e.items(), key=lambda item: item[1]) for q, e in by_quantity.items() if e}


def nrmse(measured: Array, predicted: Array) -> float | None:
    """Root mean square residual over the range of the measurement, without gaps; None if it is constant."""
    known = np.isfinite(predicted - measured)
    valid = measured[known]
    span, largest = (float(np.ptp(valid)), float(np.abs(valid).max())) if valid.size else (0.0, 0.0)
    return rms((predicted - measured)[known]) / span if span > CONSTANT * (1 + largest) else None


def compare(recording: Recording, predicted: Signals) -> RecordingComparison:
    """A recording and a prediction over the same samples."""
    smooth = filter_for(recording, WINDOW)
    measured = {n: np.where(good(recording, n), recording[n], np.nan) for n in recording.signals}
    outputs = {n: y for n, y in predicted.items() if n not in COMMANDS.values()}
    units = dict(recording.units)
    for joint in JOINTS:
        angle, speed = f"manipulator.{joint}_angle", f"manipulator.{joint}_speed"
        if angle in measured and angle in predicted:
            measured[speed] = smooth.apply(measured[angle], 1)
            outputs[speed] = smooth.apply(predicted[angle], 1)
            units[speed] = "rad/s"
    return RecordingComparison(recording, measured, outputs, units)


def default_values(identified: Identified) -> dict[str, float]:
    """Values of the parameters of the default parts, by `part.name`; those of variants are left out."""
    return {name: identified.parameters[name].value for name in declared(FERIC.subsystems, "parameters")}


def prediction(identified: Identified) -> RecordingComparison | None:
    """A recording of the machine and its prediction with the estimates; a held-out one if possible."""
    recordings = [*identified.of_machine("test"), *identified.of_machine("train")]
    if not recordings:
        return None
    selected, refined = recordings[0], identified.refined
    predicted = predict(excitation(selected), default_values(identified))
    if refined is None:
        return compare(selected, predicted)
    simulated = (refined.held_out if selected.use == "test" else refined.training)[0]

    def by_name(samples: Array) -> dict[str, Array]:
        return dict(zip(refined.problem.signals, samples.T, strict=True))

    if np.isfinite(simulated.y).all():  # with all corners of the inputs; its readings contain the zeros
        predicted = {**predicted, **by_name(simulated.y)}
        predicted |= {name: predicted[name] - zero.value for name, zero in zeros(refined).items()}
    by_z, sd = refined.uncertainty(simulated.run)
    changes = zip(refined.problem.names, np.moveaxis(by_z, 2, 0), strict=True)
    return replace(
        compare(selected, predicted), sd=by_name(sd), sensitivities={n: by_name(y) for n, y in changes}
    )


@dataclass(frozen=True)
class Extrapolation:
    """An input that leaves the range of its values in training, in SI units.

    recording  name of its file
    training   least and largest value of one sign in training, both 0 if there was none
    reached    the value outside that is farthest from the range
    """

    recording: str
    signal: str
    unit: str
    training: tuple[float, float]
    reached: float

    def __str__(self) -> str:
        shown = display_unit(self.unit)
        low, high, reached = (f"{shown.factor * v:.3g}" for v in (*self.training, self.reached))
        unit = shown.name
        trained = f"{low} to {high} {unit}" if self.training != (0.0, 0.0) else "no value of this sign"
        return f"{self.signal} is {reached} {unit}, in training {trained}"

    def doubt(self) -> str:
        """A sentence: the prediction is doubtful, not the estimates."""
        return f"{self.recording}: {self}: its prediction is an extrapolation, which the bands do not cover."


def extrapolations(
    recording: Recording, training: Mapping[str, Array], signals: Iterable[str]
) -> Iterator[Extrapolation]:
    """The inputs of a recording that are outside their ranges in training.

    training   samples of each signal in training; NaN do not count
    signals    names of the inputs; those without training samples are not compared

    Both signs of a signal have a range of their own, because a valve has other edges for each. An input is
    outside if it is farther from zero than ever in training, or nearer for more than `BRIEF` of its samples
    of this sign: every motion begins at zero, but what holds at 3 V and 5 V need not hold at 1 V.
    """
    for name in signals:
        if name not in recording.signals or not np.isfinite(known := training.get(name, np.zeros(0))).any():
            continue
        sensor = recording.sensor(name)
        margin = 4 * sensor.sd + sensor.resolution + MARGIN * float(np.nanmax(np.abs(known)))
        for sign in (1.0, -1.0):
            values, trained = (s[s > margin] for s in (sign * recording[name], sign * known))
            low, high = (float(trained.min()), float(trained.max())) if trained.size else (0.0, 0.0)
            below = values[values < low - margin]
            reached = values.max() if values.size and values.max() > high + margin else 0.0
            if not reached and below.size > BRIEF * values.size:
                reached = below.min()
            if reached:
                ends, unit = sorted((sign * low, sign * high)), recording.units.get(name, "1")
                outside = sign * float(reached)
                yield Extrapolation(recording.source.name, name, unit, (ends[0], ends[1]), outside)


def extrapolated(identified: Identified) -> list[Extrapolation]:
    """Inputs of the held-out recordings of the machine that leave their ranges in training."""
    training = [r for r in identified.recordings if r.use == "train"]
    ranges = {n: [r[n] for r in training if n in r.signals] for n, *_ in FERIC.inputs.values()}
    valves = [r["command"] for r in training if r.procedure == "valve" and "command" in r.signals]
    for name in COMMANDS.values():  # a bench shows an edge, and the machine has the same for the other sign
        ranges[name] += [sign * volts for volts in valves for sign in (1, -1)]
    known = {n: np.concatenate(values) for n, values in ranges.items() if values}
    return [found for r in identified.of_machine("test") for found in extrapolations(r, known, known)]
