"""A recording of the machine beside its prediction: with speeds, without samples no sensor could read."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from fmus.identification.recordings.derivatives import filter_for
from fmus.identification.recordings.masks import good
from fmus.identification.report import traces
from fmus.identification.report.attribution import SMALL, Explanation, changes, explain, slopes
from fmus.identification.report.content import Picture
from fmus.identification.report.prediction import COMMANDS, JOINTS, Array, Drive, Signals, drive, predict
from fmus.identification.report.traces import FIGURES, Line, rows
from fmus.identification.report.wording import counterpart, origin, sentences
from orchestrator.data.recording import Recording

WINDOW = 0.1  # s, of the filter that differentiates angles: wide enough for the encoder's steps


@dataclass(frozen=True)
class Compared:
    """Measured and predicted signals by name, SI, shape (n,); NaN where nothing usable was measured.

    measured angles have their speeds beside them; the predicted speeds went through the same filter.
    """

    recording: Recording
    measured: Signals
    predicted: Signals
    units: Mapping[str, str]

    @property
    def noise(self) -> dict[str, float]:
        """Standard deviation of a sample of each sensor."""
        return {name: self.recording.sensor(name).sd for name in self.recording.signals}

    def residual(self) -> dict[str, Array]:
        """Measured - predicted of every signal that has a sensor and is an output of the machine."""
        names = [n for n in self.recording.signals if n in self.predicted]
        return {n: self.measured[n] - self.predicted[n] for n in names}

    def nrmse(self) -> dict[str, float]:
        """Root mean square residual over the range of the measurement, of all signals that move."""
        found = {
            name: Line(name, self.units[name], self.measured[name], self.predicted[name]).nrmse
            for name in self.measured
            if name in self.predicted
        }
        return {name: value for name, value in found.items() if value is not None}


def compare(recording: Recording, predicted: Signals) -> Compared:
    """A recording beside a prediction over the same samples."""
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
    """The recording beside what the machine with these numbers does at its commands."""
    return compare(recording, predict(drive(recording), numbers))


def _message(values: Array) -> bool:
    return bool(np.isfinite(values).any())


def attribute(
    seen: Compared, numbers: Mapping[str, float], identified: Iterable[str], given: Drive | None = None
) -> Explanation:
    """Which effect the residual shows.

    numbers      of the identified machine
    identified   those of them that were fitted, and so may have covered for an effect
    given        what drove the machine, by default what the recording tells
    """
    given = given or drive(seen.recording)
    return explain(
        seen.residual(),
        changes(given, numbers),
        step=float(np.median(np.diff(given.time))),
        noise=seen.noise,
        small={
            n: SMALL * float(np.nanmax(y) - np.nanmin(y)) for n, y in seen.measured.items() if _message(y)
        },
        absorbed=slopes(given, numbers, identified),
    )


def figure(seen: Compared, joint: str, title: str = "") -> Figure:
    """Command, angle, speed, flow and pressures of a joint, as in the paper's Figs. 10 and 11."""
    recording = seen.recording
    return traces.draw(
        title or f"{joint.capitalize()}: {recording.title}",
        recording.time,
        rows(joint, seen.measured, seen.predicted, seen.units),
        number=FIGURES[joint],
        kinds=[recording.kind],
    )


def picture(seen: Compared, joint: str) -> Picture:
    """The same with its caption, for the page."""
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
