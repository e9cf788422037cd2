"""The systems that are run, and how the error of a run is measured."""

from __future__ import annotations

import csv
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from benchmarks.peers import manipulator, oscillator, others
from benchmarks.peers.ssp import wires, without_rates
from fmus.machine.build import data, harvester
from orchestrator import reference

SPEEDS = tuple(f"manipulator.{joint}_speed" for joint in ("swing", "boom", "stick"))
STOP = 12.0  # s of the work cycle: by then all three joints have moved both ways
ORDER = ("wired", "cut", "m1", "oscillator", "motor", "truck")
WORST = "rms over range of the worst"

Signals = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Case:
    """One system.

    judged    the signals that the error is of
    truth     their true values at times [s], shape (n,)
    sample    the error is taken at its multiples [s]; all steps divide it
    target    error at which the wall time is compared
    largest   the largest error counts, not the root mean square
    own       the FMUs are exports of this project, which can be timed by themselves
    """

    name: str
    title: str
    system: Path
    stop: float
    judged: tuple[str, ...]
    truth: Callable[[np.ndarray], Signals]
    sample: float
    target: float = 1e-3
    largest: bool = False
    own: bool = True

    @property
    def recorded(self) -> tuple[str, ...]:
        """Every output that a wire carries, and the judged."""
        return tuple(dict.fromkeys([*(start for start, _ in wires(self.system)), *self.judged]))

    @property
    def fed(self) -> tuple[str, ...]:
        """Every input that a wire feeds."""
        return tuple(end for _, end in wires(self.system))

    @cached_property
    def _true(self) -> tuple[np.ndarray, Signals]:
        """Times [s] after the start, and the truth there."""
        times = self.sample * np.arange(1, round(self.stop / self.sample) + 1)
        return times, self.truth(times)

    def error(self, time: np.ndarray, found: Signals) -> float:
        """Difference of the worst judged signal from the truth, over the range, or the largest value."""
        times, truth = self._true
        worst = 0.0
        for name in self.judged:
            difference = np.abs(np.interp(times, time, found[name]) - truth[name])
            if self.largest:
                share = difference.max() / np.abs(truth[name]).max()
            else:
                share = np.sqrt(np.mean(difference**2)) / np.ptp(truth[name])
            worst = max(worst, float(share))
        return worst


def cases(folder: Path, foreign: Path | None = None, chosen: Collection[str] = ()) -> list[Case]:
    """Build those that are chosen (default: all) in `folder`; `foreign` has the FMUs of other people."""
    builders = {"wired": _wired, "cut": _cut, "m1": _m1, "oscillator": _oscillator}
    if foreign:
        builders |= {"motor": partial(_motor, foreign), "truck": partial(_truck, foreign)}
    if unknown := set(chosen) - set(builders):
        raise SystemExit(
            f"case {unknown.pop()}: expected {', '.join(builders)} (motor, truck: with --foreign)"
        )
    return [build(folder) for name, build in builders.items() if not chosen or name in chosen]


def _wired(folder: Path) -> Case:
    harvester().write(folder)
    title = f"Work cycle, {WORST} joint speed"
    return Case("wired", title, folder / "harvester.ssp", STOP, SPEEDS, _work_cycle, 0.04)


def _cut(folder: Path) -> Case:
    if not (folder / "harvester.ssp").exists():
        harvester().write(folder)
    system = without_rates(folder / "harvester.ssp", folder / "cut.ssp")
    title = f"Work cycle without rate wires, {WORST} joint speed"
    return Case("cut", title, system, STOP, SPEEDS, _work_cycle, 0.04)


def _m1(folder: Path) -> Case:
    system, judged = manipulator.build(folder), ("hydraulics.p_1", "hydraulics.p_2")
    title = f"Benchmark M1, {WORST} pressure"
    return Case("m1", title, system, manipulator.STOP, judged, _reference(system, manipulator.STOP), 0.02)


def _oscillator(folder: Path) -> Case:
    def truth(time: np.ndarray) -> Signals:
        return {"mass_a.x": oscillator.exact(time)}

    title = "Undamped two-mass oscillator, largest error over largest value of x1"
    system = oscillator.build(folder)
    return Case("oscillator", title, system, 10.0, ("mass_a.x",), truth, 0.02, 1e-2, largest=True, own=False)


def _motor(foreign: Path, folder: Path) -> Case:
    system, judged = others.motor(foreign, folder), ("machine.I", "mass.wA")
    title = f"DC motor (FMUs by Dymola), {WORST} of current and speed"
    return Case("motor", title, system, 1.0, judged, _reference(system, 1.0), 0.02, own=False)


def _truck(foreign: Path, folder: Path) -> Case:
    system, judged = others.truck(foreign / others.TRUCK, folder), ("chassis.zChassis", "wheel.zWheel")
    title = f"Quarter truck (FMUs by 20-sim), {WORST} position"
    return Case("truck", title, system, 3.0, judged, others.truck_solution, 0.01, 1e-2, own=False)


def _work_cycle(time: np.ndarray) -> Signals:
    """The monolithic solution of the equations, which has a sample every 20 ms."""
    path = data("reference/work_cycle.csv")
    with path.open(encoding="utf-8") as file:
        names = next(csv.reader(file))
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    return {n: np.interp(time, rows[:, 0], rows[:, names.index(n)]) for n in SPEEDS}


def _reference(system: Path, stop: float) -> Callable[[np.ndarray], Signals]:
    """The monolithic solution of the FMUs."""

    def truth(time: np.ndarray) -> Signals:
        trace = reference(system, stop=stop, record_step=time[0]).trace
        return {name: values[1:] for name, values in trace.signals.items()}

    return truth
