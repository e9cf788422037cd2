"""A recording of the machine next to its prediction: residuals, the effect they show, and figures.

The figures show measured and predicted signals of a joint over time, as in the paper's Figs. 10 and 11: the
measurement is a solid line, the prediction a dotted one, and the strip below each shows their difference.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from fmus.identification.recordings.derivatives import filter_for
from fmus.identification.recordings.masks import good
from fmus.identification.report.attribution import SMALL, Explanation, changes, explain, slopes
from fmus.identification.report.prediction import COMMANDS, JOINTS, Array, Excitation, Signals, drive, predict
from fmus.identification.report.report_texts import counterpart, footer, origin
from orchestrator.base.plotting import (
    PALETTE,
    REFERENCE,
    SIMULATION,
    TraceLine,
    TracePanel,
    draw_traces,
    legend_entry,
)
from orchestrator.base.text import display_unit, percentage, sentences
from orchestrator.data.recording import Recording

WINDOW = 0.1  # s, of the filter that differentiates angles: wide enough for the encoder's steps
# Below this share of the largest value the range of a signal that stands still is not shown.
REST = 1e-9
# what the paper's Figs. 10 and 11 show, and the same for the boom: label -> signals with their names
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
class Compared:
    """Measured and predicted signals by name, SI, shape (n,); NaN where nothing usable was measured.

    Measured angles have their speeds with them; the predicted speeds went through the same filter.
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
        """Root mean square residual over the range of the measurement, of all signals that move."""
        common = [name for name in self.measured if name in self.predicted]
        found = {name: relative_error(self.measured[name], self.predicted[name]) for name in common}
        return {name: value for name, value in found.items() if value is not None}


def relative_error(measured: Array, predicted: Array) -> float | None:
    """Root mean square residual over the range of the measurement, gaps left out; None if it stands still."""
    known = np.isfinite(measured) & np.isfinite(predicted)
    if not known.any():
        return None
    span = float(np.ptp(measured[known]))
    error = float(np.sqrt(np.mean((predicted[known] - measured[known]) ** 2)))
    return error / span if span > REST * (1 + float(np.abs(measured[known]).max())) else None


def compare(recording: Recording, predicted: Signals) -> Compared:
    """A recording next to a prediction over the same samples."""
    smooth = filter_for(recording, WINDOW)
    measured = {n: np.where(good(recording, n), recording[n], np.nan) for n in recording.signals}
    given = set(COMMANDS.values())
    shown, units = {n: y for n, y in predicted.items() if n not in given}, dict(recording.units)
    for joint in JOINTS:
        angle, speed = f"manipulator.{joint}_angle", f"manipulator.{joint}_speed"
        if angle in measured and angle in predicted:
            measured[speed] = smooth.apply(measured[angle], 1)
            shown[speed] = smooth.apply(predicted[angle], 1)
            units[speed] = "rad/s"
    return Compared(recording, measured, shown, units)


def predicted(recording: Recording, numbers: Mapping[str, float]) -> Compared:
    """The recording next to what the machine with these numbers does at its commands."""
    return compare(recording, predict(drive(recording), numbers))


def attribute(
    seen: Compared, numbers: Mapping[str, float], identified: Iterable[str], given: Excitation | None = None
) -> Explanation:
    """Which effect the residual shows.

    numbers      of the identified machine
    identified   those of them that were fitted, and so may have covered for an effect
    given        what drove the machine, by default what the recording holds
    """
    given, recording = given or drive(seen.recording), seen.recording
    spans = {n: float(np.nanmax(y) - np.nanmin(y)) for n, y in seen.measured.items() if np.isfinite(y).any()}
    return explain(
        seen.residual(),
        changes(given, numbers),
        step=float(np.median(np.diff(given.time))),
        noise={name: recording.sensor(name).sd for name in recording.signals},
        small={name: SMALL * span for name, span in spans.items()},
        absorbed=slopes(given, numbers, identified),
    )


def figure(seen: Compared, joint: str, title: str = "") -> Figure:
    """Command, angle, speed, flow and pressures of a joint, of the signals that were measured."""
    recording, time = seen.recording, seen.recording.time
    panels = [
        _panel(label, names, seen)
        for label, signals in SIGNALS[joint].items()
        if (names := {signal: name for signal, name in signals.items() if signal in seen.measured})
    ]
    return draw_traces(
        panels,
        (float(time[0]), float(time[-1])),
        title or f"{joint.capitalize()}: {recording.title}",
        footer(FIGURES[joint], [recording.kind]),
        (legend_entry("measured", **REFERENCE), legend_entry("predicted", **SIMULATION)),
    )


def _panel(label: str, names: Mapping[str, str], seen: Compared) -> TracePanel:
    """Signals of one quantity; their errors as numbers at the right. What is given, a command, has none."""
    time, unit = seen.recording.time, display_unit(seen.units[next(iter(names))])
    lines, errors, remarks = list[TraceLine](), list[TraceLine](), list[tuple[str, str]]()
    for place, (signal, name) in enumerate(names.items()):
        light, dark = PALETTE.pair(place)
        measured = seen.measured[signal]
        if signal not in seen.predicted:
            lines.append(TraceLine(time, unit.factor * measured, {"color": dark, "linewidth": 1.2}))
            continue
        predicted = seen.predicted[signal]
        lines.append(TraceLine(time, unit.factor * measured, {"color": light, "linewidth": 2.6}))
        lines.append(TraceLine(time, unit.factor * predicted, {**SIMULATION, "color": dark}))
        errors.append(TraceLine(time, unit.factor * (measured - predicted), {"color": dark}))
        if (error := relative_error(measured, predicted)) is not None:
            remarks.append((f"{name}\nNRMSE {percentage(error, 2)}".strip(), dark))
    return TracePanel(
        unit.display,
        lines,
        label,
        errors=errors,
        error_label="residual",
        error_unit=unit.display,
        remarks=remarks,
        heights=(2.7 if errors else 1.6, 1.2),
    )


@dataclass(frozen=True)
class Picture:
    """A figure with its caption."""

    title: str
    figure: Figure
    caption: str


def picture(seen: Compared, joint: str) -> Picture:
    """The figure of a joint with its caption, for the page."""
    recording = seen.recording
    held_out = "not used for fitting" if recording.use == "test" else "used for fitting"
    text = sentences(
        f"Measured and predicted signals of the {joint} over {recording.title}, {held_out}",
        origin([recording.kind]),
        counterpart(FIGURES[joint]),
        f"Speeds: both angles differentiated by one filter, {1000 * WINDOW:.0f} ms wide",
        "Flows in the dead zone of the meter are left out",
    )
    return Picture(joint.capitalize(), figure(seen, joint), text)
