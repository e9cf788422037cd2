"""Names of signals, and measures of the samples of one signal: whether it moves, its range, its RMS."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem, UnknownSignal

Array = NDArray[np.float64]
CONSTANT = 1e-9  # range over magnitude of a constant signal: rounding of the digits in a CSV file
CONSTANT_OF_NOMINAL = 1e-6  # the same over a nominal value
TINY = 1e-150  # magnitudes whose squares leave the range of a float count as zero


def bare_name(signal: str) -> str:
    """The name of a signal without its component: `boom_angle` of `manipulator.boom_angle`."""
    return signal.rpartition(".")[2]


def matching(names: Collection[str], pattern: str) -> list[str]:
    """The signals that a name or a pattern selects, in which only * and ? are wild; `y` selects y[1], y[2].

    A pattern without a dot matches names behind their last dot: `boom_*` selects manipulator.boom_angle, but
    not boom_stick.stick_force. A pattern with a dot matches component.variable, `boom_stick.*`, or, as
    both may have dots, if it matches none, what follows a dot: `frame.*` selects arm.frame.x.
    """
    if pattern in names:
        return [pattern]
    plain, of = pattern.replace("[", "[[]"), str if "." in pattern else bare_name
    for form in (f"{behind}{plain}{index}" for index in ("", "[[]*]") for behind in ("", "*.")):
        if found := [name for name in names if fnmatchcase(of(name), form)]:
            return found
    return []


def selected(names: Collection[str], patterns: Iterable[str], missing: Callable[[str], str]) -> list[str]:
    """The signals that any of some names and patterns selects, in the order of the signals.

    missing   the message of the Problem for one that selects none
    """
    chosen = set[str]()
    for pattern in patterns:
        if not (matches := matching(names, pattern)):
            raise Problem(missing(pattern))
        chosen.update(matches)
    return [name for name in names if name in chosen]


def completions(names: Collection[str]) -> list[str]:
    """The names, then each that only one signal has without its component."""
    bare = [bare_name(name) for name in names]
    return [*names, *(name for name in bare if bare.count(name) == 1 and name not in names)]


def found(names: Collection[str], name: object, among: str = "the run") -> str:
    """The signal of a name, which may lack the component if only one signal has it; raises UnknownSignal.

    among   what has the signals, for the message
    """
    if isinstance(name, str):
        same = [name] if name in names else [other for other in names if other.endswith(f".{name}")]
        if len(same) == 1:
            return same[0]
    raise UnknownSignal(name, names, among=among)


def moves(signal: Array, recording: Array | None = None) -> bool:
    """Whether a signal, possibly a part of a recording, varies beyond the rounding of a text file."""
    magnitude = float(np.max(np.abs(signal if recording is None else recording)))
    return not np.ptp(signal) <= max(TINY, CONSTANT * magnitude)


def span(signal: Array) -> float:
    """The range of a signal; 0 if it does not move."""
    return float(np.ptp(signal)) if moves(signal) else 0.0


def rms(values: Array) -> float:
    """Root mean square; 0 without values."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else 0.0


def largest(values: Array, count: int) -> Array:
    """The largest of each `count` values in a row, shape (n - count + 1,)."""
    width = 1
    while 2 * width <= count:
        values, width = np.maximum(values[:-width], values[width:]), 2 * width
    rest = count - width
    return np.maximum(values[: len(values) - rest], values[rest:])
