"""Metrics of the error of a simulated signal against its reference.

With the error e = simulation - reference y over n common samples:

    maximum error   max |e|                             [unit of the signal]
    RMSE            sqrt(mean(e^2))                     [unit of the signal]
    NRMSE           RMSE / (max y - min y)              over the range of the whole reference
    fit             100 (1 - ||e|| / ||y - mean y||)    [%]
    VAF             100 (1 - var e / var y)             [%]  variance accounted for; ignores an offset
    ISO/TS 18571    rating.py, only if it is asked for

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
from orchestrator.results.rating import Rating, rate

# Range over nominal value of a signal at rest, whose errors would otherwise be divided by noise.
AT_REST, HARDLY_MOVES = 1e-3, "the reference hardly moves"
GIVEN = "NRMSE over the given range"
HUGE = 1e150  # magnitudes whose squares leave the range of a float are refused


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
    iso18571: Rating | None = None  # None if it was not asked for
    notes: tuple[str, ...] = ()

    def value(self, metric: str) -> float | None:
        """Value of a metric by its name in a description."""
        if metric == "maximum":
            return self.maximum_error
        value: float | Rating | None = getattr(self, metric)
        return value.overall if isinstance(value, Rating) else value


def measure(
    time: Array,
    simulation: Array,
    reference: Array,
    *,
    span: float | None = None,
    floor: float = 0.0,
    recording: Array | None = None,
    rated: bool = False,
    where: str,
) -> Metrics:
    """Metrics of one signal on common samples, all arrays of shape (n,).

    span       denominator of NRMSE instead of the range of the reference
    floor      smallest denominator of NRMSE otherwise, such as `AT_REST` times the nominal value
    recording  the recording, shape (m,), that contains `reference`; its range is the range of the reference
    rated      whether to rate the signal by ISO/TS 18571
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
        notes = (*notes, "the reference is constant in this window: no fit or VAF")
    return Metrics(
        maximum_error=float(abs(error[largest])),
        time_of_maximum=float(time[largest]),
        maximum_relative=_relative(error, reference),
        rmse=rmse,
        nrmse=rmse / denominator if denominator > 0 else (0.0 if rmse == 0 else None),
        normalised_by=denominator,
        fit=None if is_constant else 100 * (1 - float(np.linalg.norm(error)) / norm),
        vaf=None if is_constant else 100 * (1 - float(np.var(error) / np.var(reference))),
        iso18571=rate(time, simulation, reference) if rated else None,
        notes=notes,
    )


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
        return magnitude, ("the reference is constant: NRMSE over its magnitude, no fit or VAF",)
    return 0.0, ("the reference is zero: NRMSE is undefined unless the error is zero, too; judge it by rmse",)


def _relative(error: Array, reference: Array) -> float | None:
    """max |e| / |y| over the samples; None if y is zero at a sample and e is not."""
    differs = error != 0
    if np.any(np.abs(reference[differs]) <= TINY):
        return None
    return float(np.max(np.abs(error[differs] / reference[differs]), initial=0.0))
