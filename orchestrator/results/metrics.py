"""Metrics of the error of a simulated signal against its reference.

With the error e = simulation - reference y over n common samples:

    maximum error   max |e|                             [unit of the signal]
    RMSE            sqrt(mean(e^2))                     [unit of the signal]
    NRMSE           RMSE / (max y - min y)              over the range of the whole reference
    fit             100 (1 - ||e|| / ||y - mean y||)    [%]
    VAF             100 (1 - var e / var y)             [%]  variance accounted for; ignores an offset
    ISO/TS 18571    rating 0..1 of corridor, phase, magnitude and slope: iso18571.py

A constant reference has no range: then NRMSE uses the magnitude of the reference, fit and VAF are None, and
a note is added. If a signal moves by less than 0.1 % of its nominal value, this floor is the divisor. The
description of the reference declares which metric is judged, and its limit
(`orchestrator.data.description.Tolerance`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.base.signals import TINY, moves, rms
from orchestrator.data.table import Array
from orchestrator.results import iso18571

# Samples of the rating at equal steps. The 10 kHz of the standard are meant for crash pulses of 0.1 s, which
# also have 1000 samples.
ISO_SAMPLES = 1000
ISO_MINIMUM = 30
# Range over nominal value of a signal at rest, whose errors would otherwise be divided by noise.
AT_REST, HARDLY_MOVES = 1e-3, "the reference hardly moves"
GIVEN = "NRMSE over the given range"
HUGE = 1e150  # magnitudes whose squares leave the range of a float are refused


@dataclass(frozen=True)
class Rating:
    """ISO/TS 18571: overall rating and its parts, each 0..1; all None when not rated, with the reason."""

    overall: float | None = None
    corridor: float | None = None
    phase: float | None = None
    magnitude: float | None = None
    slope: float | None = None
    reason: str = ""

    @property
    def grade(self) -> str:
        """Grade of the overall rating in the standard."""
        if self.overall is None:
            return "not rated"
        grades = ((0.94, "excellent"), (0.80, "good"), (0.58, "fair"))
        return next((grade for limit, grade in grades if self.overall > limit), "poor")


@dataclass(frozen=True)
class Metrics:
    """Metrics of one signal; None if a metric is undefined, with the reason in the notes."""

    maximum_error: float
    time_of_maximum: float  # [s]
    maximum_relative: float | None  # max |e| / |y|, sample by sample
    rmse: float
    nrmse: float | None
    normalised_by: float  # denominator of NRMSE, in the unit of the signal
    fit: float | None  # [%]
    vaf: float | None  # [%]
    iso: Rating
    notes: tuple[str, ...] = ()

    def value(self, metric: str) -> float | None:
        """Value of a metric by its name in a description."""
        if metric == "maximum":
            return self.maximum_error
        value: float | None = self.iso.overall if metric == "iso" else getattr(self, metric)
        return value


def measure(
    time: Array,
    simulation: Array,
    reference: Array,
    *,
    span: float | None = None,
    floor: float = 0.0,
    recording: Array | None = None,
    rate: bool = True,
    where: str,
) -> Metrics:
    """Metrics of one signal on common samples, all arrays of shape (n,).

    span       denominator of NRMSE instead of the range of the reference
    floor      smallest denominator of NRMSE otherwise, such as `AT_REST` times the nominal value
    recording  the recording, shape (m,), that contains `reference`; its range is the range of the reference
    rate       whether to compute the ISO/TS 18571 rating
    where      file and signal, for messages
    """
    _check(time, simulation, reference, where)
    error = simulation - reference
    largest = int(np.argmax(np.abs(error)))
    rmse = rms(error)
    recording = reference if recording is None else recording
    denominator, notes = _denominator(recording, span, floor)
    norm = float(np.linalg.norm(reference - reference.mean()))
    is_constant = not moves(reference, recording)
    if is_constant and moves(recording):
        notes = (*notes, "the reference is constant in this window: no fit, VAF or ISO rating")
    not_rated = "the reference is constant" if is_constant else ""
    reason = not_rated if rate else "not requested"
    return Metrics(
        maximum_error=float(abs(error[largest])),
        time_of_maximum=float(time[largest]),
        maximum_relative=_relative(error, reference),
        rmse=rmse,
        nrmse=rmse / denominator if denominator > 0 else (0.0 if rmse == 0 else None),
        normalised_by=denominator,
        fit=None if is_constant else 100 * (1 - float(np.linalg.norm(error)) / norm),
        vaf=None if is_constant else 100 * (1 - float(np.var(error) / np.var(reference))),
        iso=Rating(reason=reason) if reason else iso_rating(time, simulation, reference),
        notes=notes,
    )


def iso_rating(time: Array, simulation: Array, reference: Array) -> Rating:
    """ISO/TS 18571 rating of a simulation against its reference, shape (n,) each, or why there is none."""
    if not moves(reference):
        return Rating(reason="the reference is constant")
    if len(time) < ISO_MINIMUM:
        return Rating(reason=f"{len(time)} samples are fewer than {ISO_MINIMUM}")
    if np.array_equal(simulation, reference):
        return Rating(1.0, 1.0, 1.0, 1.0, 1.0)
    equal_steps = np.linspace(time[0], time[-1], ISO_SAMPLES)
    curves = (np.interp(equal_steps, time, y) for y in (simulation, reference))
    with np.errstate(all="ignore"):  # a part of a signal may be constant: 0 divided by 0
        parts = iso18571.rate(*curves)
    if not np.all(np.isfinite(parts)):
        return Rating(reason="the shifted reference is constant, its slope cannot be rated")
    return Rating(*parts)


def _check(time: Array, simulation: Array, reference: Array, where: str) -> None:
    """Refuse different lengths, fewer than two samples, and values that are not finite."""
    if not len(time) == len(simulation) == len(reference) or len(time) < 2:
        got = f"{len(time)}, {len(simulation)}, {len(reference)} of time, simulation and reference"
        raise Problem(f"{where}: expected equal numbers of samples, at least 2, got {got}")
    for name, values in (("time", time), ("simulation", simulation), ("reference", reference)):
        bad = np.flatnonzero(~(np.abs(values) < HUGE))
        if len(bad):
            got = f"{values[bad[0]]} in the {name} at sample {bad[0]}"
            raise Problem(f"{where}: expected finite numbers, got {got}")


def _denominator(reference: Array, span: float | None, floor: float = 0.0) -> tuple[float, tuple[str, ...]]:
    """Denominator of NRMSE, and a note if it is not the range of the reference."""
    if span is not None:
        return span, (f"{GIVEN} of {span:g}",)
    if floor and (floor >= np.max(np.abs(reference)) or (floor > np.ptp(reference) and moves(reference))):
        return floor, (f"{HARDLY_MOVES}: NRMSE over {floor:.3g}, {100 * AT_REST:g} % of the nominal value",)
    if moves(reference):
        return float(np.ptp(reference)), ()
    magnitude = float(np.max(np.abs(reference)))
    if magnitude > TINY:
        return magnitude, ("the reference is constant: NRMSE over its magnitude, no fit, VAF or ISO rating",)
    return 0.0, ("the reference is zero: NRMSE is undefined unless the error is zero, too; judge it by rmse",)


def _relative(error: Array, reference: Array) -> float | None:
    """max |e| / |y| over the samples; None if y is zero at a sample and e is not."""
    differs = error != 0
    if np.any(np.abs(reference[differs]) <= TINY):
        return None
    return float(np.max(np.abs(error[differs] / reference[differs]), initial=0.0))
