"""The rides as a table for people and as numbers for programs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from orchestrator.tracking.causes import cause
from orchestrator.tracking.follow import Ride

HEAD = ("path", "machine", "feedback", "largest [mm]", "at [s]", "RMS [mm]", "last [mm]", "times as large")
NAMES = 3  # columns of words
MM = 1e3
LOST = 0.1  # m: ten times what is usual on a path that can be followed


def rows(rides: Sequence[Ride]) -> list[tuple[str, ...]]:
    """One row for each ride; the last cell is its largest error over that with feedback."""
    found: list[tuple[str, ...]] = []
    for ride in rides:
        errors = ride.largest, ride.rms, ride.last
        largest, rms, last = (f"{MM * x:.1f}" for x in errors)
        other = twin(ride, rides)
        times = "" if ride.feedback or other is None else f"{ride.largest / other.largest:.1f}"
        words = ride.path, ride.machine, "yes" if ride.feedback else "no"
        found.append((*words, largest, f"{ride.when:.1f}", rms, last, times))
    return found


def twin(ride: Ride, rides: Sequence[Ride]) -> Ride | None:
    """The same ride with feedback turned the other way."""
    same = (r for r in rides if (r.path, r.machine) == (ride.path, ride.machine))
    return next((r for r in same if r.feedback != ride.feedback), None)


def text(rides: Sequence[Ride]) -> str:
    """The table, with what failed or went far off below it."""
    lines = [HEAD, *rows(rides)]
    if all(r.feedback for r in rides):  # nothing to compare with
        lines = [line[:-1] for line in lines]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    table = ["  ".join(map(_cell, range(len(line)), line, widths)).rstrip() for line in lines]
    early = [r for r in rides if r.failure]
    failed = [f"{r.path}, {r.machine}: ended early at {r.time[-1]:.3g} s: {r.failure}" for r in early]
    lost = [r for r in rides if r.feedback and not r.failure and r.largest > LOST]
    away = [
        f"{r.path}, {r.machine}: the tip is up to {r.largest:.2f} m away, {r.last:.2f} m at the end{cause(r)}"
        for r in lost
    ]
    return "\n".join([*table, *failed, *away])


def _cell(place: int, content: str, width: int) -> str:
    return content.ljust(width) if place < NAMES else content.rjust(width)


def data(rides: Sequence[Ride]) -> list[dict[str, Any]]:
    """All numbers."""
    return [
        {
            "path": r.path,
            "machine": r.machine,
            "feedback": r.feedback,
            "highest speed asked for [m/s]": r.speed,
            "duration [s]": float(r.time[-1]),
            "largest error [m]": r.largest,
            "largest outwards, sideways, upwards [m]": np.abs(r.parts).max(axis=0).tolist(),
            "time of the largest error [s]": r.when,
            "RMS error [m]": r.rms,
            "error at the end [m]": r.last,
            "largest uses of limits": {name: float(use.max()) for name, use in r.uses.items()},
            "failure": r.failure,
        }
        for r in rides
    ]
