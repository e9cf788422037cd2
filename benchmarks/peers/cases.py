"""The systems that are run, and how the error of a run is measured."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.peers import oscillator
from benchmarks.peers.ssp import wires, without_rates
from fmus.machine.build import build_machine, data

SPEEDS = tuple(f"manipulator.{joint}_speed" for joint in ("swing", "boom", "stick"))
STOP = 12.0  # s of the work cycle: by then all three joints have moved both ways
SAMPLE = 0.04  # s; the reference has a sample every 20 ms, all steps have one every 40 ms

Signals = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Case:
    """One system.

    judged    the signals that the error is of
    error     of the times [s] and the judged signals at them
    target    error at which the wall time is compared
    """

    name: str
    title: str
    system: Path
    stop: float
    judged: tuple[str, ...]
    error: Callable[[np.ndarray, Signals], float]
    target: float

    @property
    def recorded(self) -> tuple[str, ...]:
        """Every output that a wire carries, and the judged."""
        return tuple(dict.fromkeys([*(start for start, _ in wires(self.system)), *self.judged]))

    @property
    def fed(self) -> tuple[str, ...]:
        """Every input that a wire feeds."""
        return tuple(end for _, end in wires(self.system))


def cases(folder: Path) -> list[Case]:
    """Build all of them in `folder`."""
    build_machine(folder)
    wired = folder / "harvester.ssp"
    cut = without_rates(wired, folder / "cut.ssp")
    machine = (STOP, SPEEDS, speed_error, 1e-3)
    swinging = (10.0, ("mass_a.x",), position_error, 1e-2)
    worst = "error: worst joint speed, rms over range"
    return [
        Case("wired", f"harvester.ssp, work cycle; {worst}", wired, *machine),
        Case("cut", f"harvester.ssp without rate wires, work cycle; {worst}", cut, *machine),
        Case(
            "oscillator",
            "undamped two-mass oscillator; error: largest of x1, over its largest value",
            oscillator.build(folder),
            *swinging,
        ),
    ]


def speed_error(time: np.ndarray, found: Signals) -> float:
    """Worst joint speed: root mean square of the difference from the monolithic solution, over its range."""
    truth = reference()
    rows = (truth["time"] > SAMPLE / 2) & (truth["time"] < time[-1] + SAMPLE / 4)
    rows &= np.abs(truth["time"] / SAMPLE - np.round(truth["time"] / SAMPLE)) < 1e-3
    worst = 0.0
    for name in SPEEDS:
        true = truth[name][rows]
        difference = np.interp(truth["time"][rows], time, found[name]) - true
        worst = max(worst, float(np.sqrt(np.mean(difference**2)) / np.ptp(true)))
    return worst


def position_error(time: np.ndarray, found: Signals) -> float:
    """Largest difference from the exact solution over its largest value."""
    true = oscillator.exact(time)
    return float(np.max(np.abs(found["mass_a.x"] - true)) / np.max(np.abs(true)))


def reference() -> Signals:
    """The monolithic solution of the work cycle."""
    path = data("reference/work_cycle.csv")
    with path.open(encoding="utf-8") as file:
        names = next(csv.reader(file))
    return dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))
