"""Comparison of a recording with its prediction: residuals, goodness of fit, attribution, and figures.

The figures show measured and predicted signals of a joint over time, as in the paper's Figs. 10 and 11. The
measurement is a solid line, the prediction a dotted one, and the strip below each panel shows the residual.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from fmus.identification.machine import COMMANDS
from fmus.identification.procedures.momentum_balance import JOINTS
from fmus.identification.recordings.derivatives import filter_for
from fmus.identification.recordings.masks import good
from fmus.identification.report.attribution import (
    SMALL,
    Explanation,
    effect_changes,
    explain,
    rms,
    sensitivities,
    unexplained,
)
from fmus.identification.report.prediction import Signals, excitation, predict
from fmus.identification.report.report_texts import counterpart, footer, origin
from orchestrator.base.text import display_unit, percentage, sentences
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array
from orchestrator.pages.figures import PALETTE, REFERENCE, SIMULATION, TraceFigure, TraceLine, TracePanel

WINDOW = 0.1  # s, filter that differentiates angles, wide enough for the encoder's steps
CONSTANT = 1e-9  # range over largest value below which a signal is constant
# joint -> label of a panel -> signals and labels of its curves, as in the paper's Figs. 10 and 11
SIGNALS: Mapping[str, Mapping[str, Mapping[str, str]]] = {
    "swing": {
        "command": {"swing.swing_command": ""},
        "angle": {"manipulator.swing_angle": ""},
        "speed": {"manipulator.swing_speed": ""},
        "flow into A": {"swing.swing_flow_a": ""},
        "pressure": {"swing.swing_pressure_a": "line A", "swing.swing_pressure_b": "line B"},
    },
    **{
        joint: {
            "command": {f"boom_stick.{joint}_command": ""},
            "angle": {f"manipulator.{joint}_angle": ""},
            "speed": {f"manipulator.{joint}_speed": ""},
            "flow into head": {f"boom_stick.{joint}_head_flow": ""},
            "pressure": {
                f"boom_stick.{joint}_head_pressure": "head",
                f"boom_stick.{joint}_rod_pressure": "rod",
            },
        }
        for joint in ("boom", "stick")
    },
}
FIGURES = {"swing": 10, "boom": 0, "stick": 11}


@dataclass(frozen=True)
class RecordingComparison:
    """Measured and predicted signals by name, in SI units, shape (n,); NaN if no good sample was measured.

    Speeds are added to measured angles. Measured and predicted speeds are derivatives by the same filter.
    """

    recording: Recording
    measured: Signals
    predicted: Signals
    units: Mapping[str, str]

    def residual(self) -> dict[str, Array]:
        """Measured - predicted of every signal that has a sensor and is an output of the machine."""
        names = [n for n in self.recording.signals if n in self.predicted]
        return {n: self.measured[n] - self.predicted[n] for n in names}

    def nrmse(self) -> dict[str, float]:
        """NRMSE of all signals that are not constant."""
        common = [name for name in self.measured if name in self.predicted]
        errors = {name: nrmse(self.measured[name], self.predicted[name]) for name in common}
        return {name: error for name, error in errors.items() if error is not None}


def nrmse(measured: Array, predicted: Array) -> float | None:
    """Root mean square residual over the range of the measurement, without gaps; None if it is constant."""
    residual = predicted - measured
    valid = measured[np.isfinite(residual)]
    if not valid.size:
        return None
    span = float(np.ptp(valid))
    return rms(residual) / span if span > CONSTANT * (1 + float(np.abs(valid).max())) else None


def compare(recording: Recording, predicted: Signals) -> RecordingComparison:
    """A recording and a prediction over the same samples."""
    smooth = filter_for(recording, WINDOW)
    measured = {n: np.where(good(recording, n), recording[n], np.nan) for n in recording.signals}
    commands = set(COMMANDS.values())
    outputs, units = {n: y for n, y in predicted.items() if n not in commands}, dict(recording.units)
    for joint in JOINTS:
        angle, speed = f"manipulator.{joint}_angle", f"manipulator.{joint}_speed"
        if angle in measured and angle in predicted:
            measured[speed] = smooth.apply(measured[angle], 1)
            outputs[speed] = smooth.apply(predicted[angle], 1)
            units[speed] = "rad/s"
    return RecordingComparison(recording, measured, outputs, units)


def compare_prediction(recording: Recording, parameters: Mapping[str, float]) -> RecordingComparison:
    """A recording and its prediction by the machine with these parameter values."""
    return compare(recording, predict(excitation(recording), parameters))


def attribute(
    comparison: RecordingComparison,
    parameters: Mapping[str, float],
    identified: Iterable[str],
    processes: int = 1,
) -> Explanation:
    """Which effect the residual shows.

    parameters   values of the identified machine
    identified   names of the fitted parameters, whose errors may look like an effect
    processes    number of processes that simulate the machine
    """
    recording, measured, residual = comparison.recording, comparison.measured, comparison.residual()
    inputs, effects, absorbed = excitation(recording), {}, {}
    ranges = {n: float(np.nanmax(y) - np.nanmin(y)) for n, y in measured.items() if np.isfinite(y).any()}
    small = {name: SMALL * span for name, span in ranges.items()}
    noise = {name: recording.sensor(name).sd for name in recording.signals}
    if unexplained(residual, noise, small):  # else the simulations, most of the time, would tell nothing
        default = predict(inputs, parameters)
        effects = effect_changes(inputs, parameters, default, processes)
        absorbed = sensitivities(inputs, parameters, identified, default, processes)
    step = float(np.median(np.diff(inputs.time)))
    return explain(residual, effects, step=step, noise=noise, small=small, absorbed=absorbed)


def figure(comparison: RecordingComparison, joint: str) -> TraceFigure:
    """Command, angle, speed, flow and pressures of a joint, if they were measured."""
    recording, time = comparison.recording, comparison.recording.time
    panels = [
        _panel(label, measured, comparison)
        for label, curves in SIGNALS[joint].items()
        if (measured := {n: curve for n, curve in curves.items() if n in comparison.measured})
    ]
    return TraceFigure(
        panels,
        (float(time[0]), float(time[-1])),
        f"{joint.capitalize()}: {recording.title}",
        footer(FIGURES[joint], [recording.kind]),
        (("measured", REFERENCE), ("predicted", SIMULATION)),
    )


def _panel(label: str, curves: Mapping[str, str], comparison: RecordingComparison) -> TracePanel:
    """Signals of one quantity with their residuals and NRMSE; a command is an input and has none."""
    time, unit = comparison.recording.time, display_unit(comparison.units[next(iter(curves))])
    lines, residuals, remarks = list[TraceLine](), list[TraceLine](), list[tuple[str, str]]()
    for index, (signal, curve) in enumerate(curves.items()):
        light, dark = PALETTE.pair(index)
        measured = comparison.measured[signal]
        if signal not in comparison.predicted:
            lines.append(TraceLine(time, unit.factor * measured, {"color": dark, "linewidth": 1.2}))
            continue
        predicted = comparison.predicted[signal]
        broad, dotted = {"color": light, "linewidth": 2.6}, {**SIMULATION, "color": dark}
        lines.append(TraceLine(time, unit.factor * measured, broad, curve, "measured"))
        lines.append(TraceLine(time, unit.factor * predicted, dotted, curve, "predicted"))
        residuals.append(TraceLine(time, unit.factor * (measured - predicted), {"color": dark}, curve))
        if (error := nrmse(measured, predicted)) is not None:
            remarks.append((f"{curve}\nNRMSE {percentage(error, 2)}".strip(), dark))
    return TracePanel(
        unit.display,
        lines,
        label,
        errors=residuals,
        error_label="residual",
        error_unit=unit.display,
        remarks=remarks,
        heights=(2.7 if residuals else 1.6, 1.2),
    )


@dataclass(frozen=True)
class CaptionedFigure:
    """A figure with title and caption."""

    title: str
    figure: TraceFigure
    caption: str


def captioned_figure(comparison: RecordingComparison, joint: str) -> CaptionedFigure:
    """The figure of a joint with its caption, for the page."""
    recording = comparison.recording
    held_out = "not used for fitting" if recording.use == "test" else "used for fitting"
    caption = sentences(
        f"Measured and predicted signals of the {joint} over {recording.title}, {held_out}",
        origin([recording.kind]),
        counterpart(FIGURES[joint]),
        f"Speeds: both angles differentiated by one filter, {1000 * WINDOW:.0f} ms wide",
        "Flows in the dead zone of the meter are left out",
    )
    return CaptionedFigure(joint.capitalize(), figure(comparison, joint), caption)
