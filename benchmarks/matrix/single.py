"""Single FMUs: each alone with its start values, and the whole machine while a lever moves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from statistics import fmean

import numpy as np
from fmpy import read_model_description

from benchmarks.matrix.cells import percent, remark, two
from benchmarks.matrix.present import OURS, Tool
from benchmarks.matrix.running import Outcome, Rows, carried_out
from benchmarks.matrix.systems import KINDS, SIGNALS, STEP

ALONE, STROKE = 1.0, 6.0  # s
RUN = {"stop": ALONE, "step": STEP}
INTERVALS = (1e-3, 1e-2)  # s
MOVED = ("boom_command", (0.0, 0.5, 0.8, 1.7, 2.0, 6.0), (0.0, 0.0, 4.0, 4.0, 0.0, 0.0))
MOVES = 0.01  # of the largest range of its kind: a signal that moves less says nothing
ALONE_HEAD = (
    "tool",
    "FMI",
    "ran",
    "largest deviation over nominal value",
    "wall time each",
    "messages of the others",
)
STROKES_HEAD = ("tool", "FMI", "output interval", "largest [%]", "NRMSE [%]", "wall time, or what happens")


def _top(build: Path, fmi: int) -> Path:
    return build / "fmi3" if fmi == 3 else build


# ---- each FMU alone


@dataclass
class Tally:
    """What one tool makes of the FMUs on one side; `worst` is a deviation and where it is."""

    ran: int = 0
    walls: list[float] = field(default_factory=list)
    worst: tuple[float, str] = (0.0, "")
    problems: dict[str, list[str]] = field(default_factory=dict)

    def add(self, name: str, found: Outcome, truth: Outcome, nominals: Mapping[str, float]) -> None:
        """Count one FMU; one that did not run, or has nothing to be compared with, is a problem."""
        found = found.until(ALONE)
        problem = found.problem or (truth.problem and f"our own run: {truth.problem}")
        if problem:
            self.fail(name, problem)
            return
        self.ran += 1
        self.walls.append(found.wall)
        for variable, nominal in nominals.items():
            exact = np.interp(found.rows["time"], truth.rows["time"], truth.rows[variable])
            share = float(np.abs(found.rows[variable] - exact).max() / nominal)
            self.worst = max(self.worst, (share, f"{name}.{variable}"))

    def fail(self, name: str, problem: str) -> None:
        """Count one FMU that did not run."""
        self.problems.setdefault(remark(problem), []).append(name)

    def cells(self, count: int) -> tuple[str, str, str, str]:
        """How many ran, the largest deviation, the wall time of those that ran, messages of the others."""
        share, where = self.worst
        deviation = f"{share:.1g} ({where})" if share > 0 else "0"
        told = "; ".join(f"{', '.join(names)}: {text}" for text, names in self.problems.items())
        shown = (deviation, f"{fmean(self.walls):.2g} s") if self.ran else ("", "")
        return (f"{self.ran} of {count}", *shown, told)


def alone(tools: Sequence[Tool], build: Path, folder: Path) -> Iterator[tuple[str, ...]]:
    """Every FMU in every tool, against our own run of its FMI 2.0 file."""

    @cache
    def own(path: Path, names: tuple[str, ...]) -> Outcome:
        return carried_out(OURS, folder, path=str(path), fmi=2, record=names, **RUN).until(ALONE)

    for tool in tools:
        for fmi, side in tool.alone:
            top, tally = _top(build, fmi), Tally()
            paths = [*sorted(top.glob("*.fmu")), *sorted((top / "variants").glob("*.fmu"))]
            for path in paths:
                try:
                    nominals = outputs(path)
                except Exception as problem:  # FMPy raises whatever it stumbles over
                    tally.fail(path.stem, str(problem) or type(problem).__name__)
                    continue
                truth = own(build / path.relative_to(top), tuple(nominals))
                job = {"path": str(path), "fmi": fmi, "side": side, "record": tuple(nominals), **RUN}
                tally.add(path.stem, carried_out(tool, folder, **job), truth, nominals)
            yield (tool.name, f"{fmi}.0 {side}", *tally.cells(len(paths)))


def outputs(path: Path) -> dict[str, float]:
    """The outputs of an FMU with their nominal values."""
    variables = read_model_description(str(path), validate=False).modelVariables
    return {v.name: float(v.nominal or 1) for v in variables if v.causality == "output"}


# ---- a lever is moved


def strokes(tools: Sequence[Tool], build: Path, folder: Path) -> Iterator[tuple[str, ...]]:
    """Largest error and NRMSE of what moves, by tool, side and output interval."""
    base = {"stop": STROKE, "record": [n.split(".")[1] for n in SIGNALS], "input": MOVED}
    truth = carried_out(OURS, folder, path=str(build / "harvester.fmu"), fmi=2, step=STEP, **base)
    truth = truth.until(STROKE)
    if truth.problem:
        yield (OURS.name, "2.0 CS", "1 ms", "", "", remark(truth.problem))
        return
    for tool in tools:
        for fmi, side in tool.strokes:
            path = str(_top(build, fmi) / "harvester.fmu")
            for interval in INTERVALS:
                found = carried_out(tool, folder, path=path, fmi=fmi, side=side, step=interval, **base)
                shown = _stroke(found.until(STROKE), truth.rows)
                yield (tool.name, f"{fmi}.0 {side}", f"{1e3 * interval:g} ms", *shown)


def _stroke(found: Outcome, truth: Rows) -> tuple[str, str, str]:
    """Largest error, NRMSE and wall time; or what happens."""
    if found.problem:
        return ("", "", remark(found.problem))
    worst, rms = 0.0, 0.0
    time = found.rows["time"]
    last = np.append(np.diff(time) > 1e-9, True)  # of several rows at one time
    for name in moving(truth):
        error = (found.rows[name] - np.interp(time, truth["time"], truth[name]))[last]
        worst = max(worst, float(np.abs(error).max() / np.ptp(truth[name])))
        rms = max(rms, float(np.sqrt(np.mean(error**2)) / np.ptp(truth[name])))
    return (percent(worst), percent(rms), f"{two(found.wall)} s")


def moving(truth: Rows) -> list[str]:
    """The signals whose range is not small beside the largest of their kind."""
    kinds = {n: next(k for k in KINDS if k in n) for n in truth if n != "time"}
    largest = {k: max((np.ptp(truth[n]) for n in kinds if kinds[n] == k), default=0.0) for k in KINDS}
    return [n for n, kind in kinds.items() if np.ptp(truth[n]) > MOVES * largest[kind]]
