"""Recognises and corrects what loggers do to samples: held samples, delays, wraps of angles, error codes.

Also recognised are rates in another unit than stated.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from math import pi

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.files import tell_once
from orchestrator.base.units import parse_unit
from orchestrator.data.description import SignalDescription
from orchestrator.data.logger_files import Array, at_times

SAME = 1e-9  # relative difference of equal values, which a scale may have rounded
RUNS = 20  # runs of equal values, from which a hold is recognised
SLOWEST = 1.0  # s: a bus sends more often; what is held for longer is a step of an experiment
LEVELS = 8  # different values, from which a signal has a range
RARE = 0.05  # largest share of error codes at one end
STEP = 1.5  # times the smallest step
FEW = 4  # different error codes
# a rate over the change of its signal -> what explains that
RATIOS = {180 / pi: "deg/s read as rad/s", pi / 180: "rad/s read as deg/s"}
RATIOS |= {1e3: "thousandths read as whole units, or ms as s", 1e-3: "whole units read as thousandths"}
SCALE = 0.1  # largest error of a gyro's scale
ALIKE = 0.9  # least R2 of a signal and the integral of its rate


def corrected(raw: Array, time: Array, spec: SignalDescription) -> Array:
    """The samples of a column in the unit of its description, corrected as its keys state.

    time   of each sample, in the unit of `delay`
    """
    codes = [v for v in spec.invalid if not isinstance(v, str)]  # words are gaps anyway
    code = np.logical_or.reduce([np.abs(raw - v) <= SAME * abs(v) for v in codes], initial=False)
    values = spec.factor * np.where(code, np.nan, raw) + spec.offset
    if spec.wrap:
        known = np.isfinite(values)
        values[known] = np.unwrap(values[known], period=spec.wrap)
    if spec.held:  # also if there are gaps between its samples
        known = np.isfinite(values)
        values[known] = np.where(is_new(values[known], time[known]), values[known], np.nan)
    return delayed(values, time, spec.delay) if spec.delay else values


def delayed(values: Array, time: Array, delay: float) -> Array:
    """A signal later by a delay; its ends keep their values."""
    moved = at_times(time, time + delay, values)
    moved[time < time[0] + delay], moved[time > time[-1] + delay] = values[0], values[-1]
    return moved


def log_faults(raw: Array, spec: SignalDescription, step: float) -> Iterator[str]:
    """What a logger has probably done to a column, with the key that corrects it; step: between rows [s]."""
    values = corrected(raw, step * np.arange(len(raw), dtype=np.float64), replace(spec, delay=0.0))
    if codes := _codes(values):
        raws = ", ".join(f"{(code - spec.offset) / spec.factor:.10g}" for code in codes)
        count = int(np.isin(values, codes).sum())
        yield f"{count} samples far from all others: error codes? invalid = [{raws}] makes them gaps"
        values = values[~np.isin(values, codes)]
    step *= len(raw) / max(np.isfinite(values).sum(), 1)  # between samples of a slower group
    values = values[np.isfinite(values)]
    turn, jumps = _wraps(values, spec.unit)
    if jumps:
        yield f"jumps {jumps} times by about {turn:.6g}; wrap = {turn:.10g} unwraps an angle"
    sizes = np.abs(np.diff(values))
    # steps of one size are those of a converter that follows a slow signal
    hold = hold_of(values)
    if 0 < hold * step < SLOWEST and np.median(sizes[sizes > 0]) > STEP * sizes[sizes > 0].min():
        yield f"each value is held for {hold:.3g} samples, slower than the log: held = true uses each once"


def rate_faults(
    time: Array, signals: Mapping[str, Array], units: Mapping[str, str]
) -> Iterator[tuple[str, str]]:
    """Rates [rad/s, m/s] that are a factor of units off the change of the signal that moves like them."""
    known = {n: np.isfinite(v) for n, v in signals.items()}
    of = {n: np.interp(time, time[k], signals[n][k]) for n, k in known.items() if k.any() and len(time) > 2}
    for name in (n for n in of if units.get(n) in ("rad/s", "m/s")):
        others = [n for n in of if f"{units.get(n)}/s" == units[name]]
        turned = np.append(0.0, np.cumsum((of[name][1:] + of[name][:-1]) / 2 * np.diff(time)))
        rows = np.array([turned, *(of[n] for n in others)])
        slopes, starts = np.polyfit(time, rows.T, 1)  # a slope of the integral is the zero of a gyro
        rows -= np.outer(slopes, time) + starts[:, None]
        both, squares = np.abs(rows @ rows[0])[1:], np.maximum((rows**2).sum(axis=1), 1e-30)
        alike, ratios = both**2 / (squares[1:] * squares[0]), both / squares[1:]
        for ratio, other in ((ratios[k], others[k]) for k in np.flatnonzero(alike > ALIKE)[:1]):
            if meant := next((text for r, text in RATIOS.items() if abs(ratio / r - 1) < SCALE), ""):
                yield name, f"{ratio:.3g} times as fast as {other} changes: {meant}?"


def unwrapping(raw: Array, spec: SignalDescription, column: str) -> SignalDescription:
    """The description with the key `wrap`, and a line, if the column is an angle that jumps by a turn."""
    values = corrected(raw, raw, replace(spec, delay=0.0, held=False))
    turn, jumps = _wraps(values[np.isfinite(values)], spec.unit)
    if spec.unit == "1" or not jumps:  # without a unit it may be no angle
        return spec
    tell_once(f"{column}: jumps {jumps} times by about {turn:.6g}; unwrapped, as with wrap = {turn:.10g}")
    return replace(spec, wrap=turn)


def _wraps(values: Array, unit: str) -> tuple[float, int]:
    """A turn in the unit of an angle, 360 without a unit, and how often successive values differ by one."""
    if unit in ("", "1"):
        turn = 360.0
    elif parse_unit(unit).exponents == parse_unit("rad").exponents:
        turn = parse_unit("rev").factor / parse_unit(unit).factor
    else:
        return 0.0, 0
    in_one = values.size and np.ptp(values) < 1.1 * turn  # an angle that was not unwrapped
    return turn, int(in_one and (np.abs(np.abs(np.diff(values)) / turn - 1) < 0.1).sum())


def _codes(values: Array) -> list[float]:
    """A few rare values, farther from all others than these are from each other."""
    known = values[np.isfinite(values)]
    low, high = np.quantile(known, [RARE, 1 - RARE]) if known.size else (0.0, 0.0)
    far = (known < 2 * low - high) | (known > 2 * high - low)
    codes, counts = np.unique(known[far], return_counts=True)
    others = known[~far]
    if not 0 < len(codes) <= FEW or counts.min() < 2 or len(np.unique(others)) < LEVELS:
        return []
    distance = np.maximum(others.min() - codes, codes - others.max())
    return [*map(float, codes)] if distance.min() > np.ptp(others) else []


def _runs(values: Array) -> NDArray[np.int64]:
    """Where runs of equal values begin."""
    return np.flatnonzero(np.diff(values, prepend=np.nan) != 0)


def hold_of(values: Array) -> float:
    """Rows for which a slower source is held, on average; 0 if the values do not change in such a rhythm."""
    starts = _runs(values)[1:]
    lengths = np.diff(starts)
    if len(lengths) < RUNS or (usual := int(np.bincount(lengths).argmax())) < 2:
        return 0.0
    period = float(lengths[np.abs(lengths - usual) <= 1].mean())
    count = np.concatenate(([0.0], np.cumsum(np.round(lengths / period))))
    late = starts - np.polyval(np.polyfit(count, starts, 1), count)
    return period if np.quantile(np.abs(late), 0.95) < 1 else 0.0


def is_new(values: Array, time: Array) -> NDArray[np.bool_]:
    """Whether each sample is a new one of a source that is held, also if it has the same value.

    Without a rhythm, as of a lever that seldom moves, a run that is longer than usual has several samples. A
    source with runs that are all too long for a bus is not held.
    """
    starts, rows = _runs(values), np.arange(len(values))
    run = np.searchsorted(starts, rows, side="right") - 1
    hold = round(hold_of(values))
    if not hold:
        lengths, lasts = np.diff(starts[1:]), np.diff(time[starts[1:]])  # the first and the last run are cut
        hold = round(float(np.median(lengths[lasts < SLOWEST]))) if (lasts < SLOWEST).any() else 1
    left = np.append(starts[1:], len(values))[run] - rows
    return np.asarray(((rows - starts[run]) % hold == 0) & (left > hold / 2) | (rows == starts[run]))
