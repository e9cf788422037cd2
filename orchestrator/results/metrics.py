"""How far a simulated signal is from its reference, as numbers.

With the error e = simulation - reference y over n common samples:

    maximum error   max |e|                             [unit of the signal]
    RMSE            sqrt(mean(e^2))                     [unit of the signal]
    NRMSE           RMSE / (max y - min y)              over the range of the whole reference
    fit             100 (1 - ||e|| / ||y - mean y||)    [%]
    VAF             100 (1 - var e / var y)             [%]  variance accounted for: blind to an offset
    ISO/TS 18571    rating 0..1 of corridor, phase, magnitude and slope: iso18571.py

A constant reference has no range: NRMSE then falls back to the magnitude of the reference, fit and VAF
are None, and a note says so. Which of the numbers is judged, and its limit, stand in the description of the
reference (`orchestrator.data.description.Tolerance`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.data.table import Array
from orchestrator.results import iso18571

# The rating compares shapes over the whole window, so it is computed on this many equal steps.
# (The standard's 10 kHz is meant for crash pulses of 0.1 s: the same 1000 samples.)
ISO_SAMPLES = 1000
ISO_MINIMUM = 30
# Below this share of its magnitude the range of a signal is rounding of the digits in a CSV file.
CONSTANT = 1e-9
# Outside these magnitudes squares leave the range of a float: smaller counts as zero, larger is refused.
TINY, HUGE = 1e-150, 1e150


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
        """The standard's word for the overall rating."""
        if self.overall is None:
            return "not rated"
        grades = ((0.94, "excellent"), (0.80, "good"), (0.58, "fair"))
        return next((word for limit, word in grades if self.overall > limit), "poor")


@dataclass(frozen=True)
class Metrics:
    """Numbers of one signal; None where a number is undefined, with a note that says why."""

    maximum_error: float
    time_of_maximum: float  # [s]
    maximum_relative: float | None  # max |e| / |y|, sample by sample
    rmse: float
    nrmse: float | None
    normalised_by: float  # what NRMSE divides by, in the signal's unit
    fit: float | None  # [%]
    vaf: float | None  # [%]
    iso: Rating
    notes: tuple[str, ...] = ()

    def value(self, metric: str) -> float | None:
        """The number of a metric by its name in a description."""
        if metric == "maximum":
            return self.maximum_error
        found: float | None = self.iso.overall if metric == "iso" else getattr(self, metric)
        return found


def measure(
    time: Array,
    simulation: Array,
    reference: Array,
    *,
    span: float | None = None,
    whole: Array | None = None,
    rate: bool = True,
    where: str,
) -> Metrics:
    """Metrics of one signal on common samples, all arrays of shape (n,).

    span    what NRMSE divides by instead of the range of the reference
    whole   the recording, shape (m,), of which `reference` is a part: its range is the range of the reference
    rate    compute the ISO/TS 18571 rating too
    where   file and signal, for messages
    """
    _check(time, simulation, reference, where)
    error = simulation - reference
    worst = int(np.argmax(np.abs(error)))
    rmse = float(np.sqrt(np.mean(error**2)))
    whole = reference if whole is None else whole
    by, notes = _normaliser(whole, span)
    spread = float(np.linalg.norm(reference - reference.mean()))
    flat = constant(reference, whole)
    if flat and not constant(whole):
        notes = (*notes, "the reference stands still in this window: no fit, VAF or ISO rating")
    iso = Rating(reason="not asked for")
    if rate:
        iso = Rating(reason="the reference is constant") if flat else iso_rating(time, simulation, reference)
    return Metrics(
        maximum_error=float(abs(error[worst])),
        time_of_maximum=float(time[worst]),
        maximum_relative=_relative(error, reference),
        rmse=rmse,
        nrmse=rmse / by if by > 0 else (0.0 if rmse == 0 else None),
        normalised_by=by,
        fit=None if flat else 100 * (1 - float(np.linalg.norm(error)) / spread),
        vaf=None if flat else 100 * (1 - float(np.var(error) / np.var(reference))),
        iso=iso,
        notes=notes,
    )


def constant(signal: Array, whole: Array | None = None) -> bool:
    """Whether the signal, perhaps a part of a whole, stands still but for the rounding of a text file."""
    magnitude = float(np.max(np.abs(signal if whole is None else whole)))
    return bool(np.ptp(signal) <= max(TINY, CONSTANT * magnitude))


def iso_rating(time: Array, simulation: Array, reference: Array) -> Rating:
    """ISO/TS 18571 rating of a simulation against its reference, shape (n,) each, or why there is none."""
    if constant(reference):
        return Rating(reason="the reference is constant")
    if len(time) < ISO_MINIMUM:
        return Rating(reason=f"{len(time)} samples are fewer than {ISO_MINIMUM}")
    if np.array_equal(simulation, reference):
        return Rating(1.0, 1.0, 1.0, 1.0, 1.0)
    even = np.linspace(time[0], time[-1], ISO_SAMPLES)
    curves = (np.interp(even, time, y) for y in (simulation, reference))
    with np.errstate(all="ignore"):  # a part of a signal may stand still: 0 divided by 0
        parts = iso18571.rate(*curves)
    if not np.all(np.isfinite(parts)):
        return Rating(reason="the shifted reference stands still, its slope cannot be rated")
    return Rating(*parts)


def _check(time: Array, simulation: Array, reference: Array, where: str) -> None:
    """Same length, at least two samples, finite."""
    if not len(time) == len(simulation) == len(reference) or len(time) < 2:
        lengths = f"{len(time)}, {len(simulation)}, {len(reference)}"
        raise Problem(
            f"{where}: expected as many samples (2 or more) in time, simulation and reference, got {lengths}"
        )
    for name, values in (("time", time), ("simulation", simulation), ("reference", reference)):
        bad = np.flatnonzero(~(np.abs(values) < HUGE))
        if len(bad):
            raise Problem(
                f"{where}: expected finite numbers, got {values[bad[0]]} in the {name} at sample {bad[0]}"
            )


def _normaliser(reference: Array, span: float | None) -> tuple[float, tuple[str, ...]]:
    """What NRMSE divides by, and a note when it is not the range of the reference."""
    if span is not None:
        return span, (f"NRMSE over the given range of {span:g}",)
    if not constant(reference):
        return float(np.ptp(reference)), ()
    magnitude = float(np.max(np.abs(reference)))
    if magnitude > TINY:
        return magnitude, ("the reference is constant: NRMSE over its magnitude, no fit, VAF or ISO rating",)
    return 0.0, ("the reference is zero throughout: no NRMSE unless the error is zero too; judge it by rmse",)


def _relative(error: Array, reference: Array) -> float | None:
    """max |e| / |y| over the samples, None where y is zero and e is not."""
    off = error != 0
    if np.any(np.abs(reference[off]) <= TINY):
        return None
    return float(np.max(np.abs(error[off] / reference[off]), initial=0.0))
