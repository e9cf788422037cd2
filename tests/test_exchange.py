"""Co-Simulation and Model Exchange, FMI 2.0 and FMI 3.0: four ways to the same numbers."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from exchange import Piece, integrated, stepped
from fmpy import read_model_description

from fmus.contract import quantities
from fmus.machine import ALL
from fmus.monolith import breakpoints
from fmus.parameters import values
from fmus.scenarios import COMMANDS, WORK_CYCLE, WORK_CYCLE_STOP, sample

# tolerances that leave less than 1e-8 of range: the worst error, of an acceleration, was measured as 3e-8 at
# 1e-12 and 8e-10 at 1e-14 with CVode, 5e-9 at 1e-11 and 5e-10 at 1e-12 with the FMU's own solver
EXCHANGE, STEPPED = 1e-14, 5e-12
BAR = 1e-8


def compare(path: Path, found: dict[str, np.ndarray], expected: dict[str, np.ndarray], bar: float) -> None:
    """Every output within `bar` of its range; of its nominal value where it does not move, as voids."""
    nominal = {v.name: float(v.nominal or 1) for v in read_model_description(str(path)).modelVariables}
    for name, values_ in expected.items():
        spread = np.ptp(values_)
        scale = spread if name == "time" or spread > 1e-3 * nominal[name] else nominal[name]
        deviation = np.max(np.abs(found[name] - values_)) / scale
        assert deviation <= bar, f"{name}: {deviation:.1e}, expected below {bar:.0e}"


def work_cycle() -> list[Piece]:
    """The commands, linear between their corners; each with its rate."""
    time, commands = sample(WORK_CYCLE, WORK_CYCLE_STOP)
    pieces = []
    for a, b in pairwise(breakpoints(time, commands)):
        terms = {}
        for name, at, after in zip(COMMANDS, commands[a], commands[b], strict=True):
            slope = (after - at) / (time[b] - time[a])
            terms |= {name: (at, slope, 0.0), f"{name}_rate": (slope, 0.0, 0.0)}
        pieces.append((time[a], time[b], terms))
    return pieces


def test_four_ways_through_the_work_cycle_agree(fmu_dir, fmi3_dir):
    """harvester.fmu, all equations of the machine, over 42 s: every output within 1e-8 of its range."""
    old, new = fmu_dir / "harvester.fmu", fmi3_dir / "harvester.fmu"
    pieces, step = work_cycle(), 0.1  # all corners lie on it; the solvers make their own steps inside
    exact = integrated(old, pieces, EXCHANGE, step)
    for path in (old, new):
        compare(path, stepped(path, pieces, STEPPED, step), exact, BAR)
    compare(new, integrated(new, pieces, EXCHANGE, step), exact, BAR)


STOP, LENGTH = 2.0, 0.05  # s, of the run and of a piece
PUSH = {  # what moves an input: amplitude of one sine over the run
    **{command: 4.0 for command in COMMANDS},
    **{"swing_speed": 0.3, "boom_velocity": 0.1, "stick_velocity": -0.1},
    **{"swing_torque": 1e4, "boom_force": 2e3, "stick_force": -1e3},
}


def wave(name: str) -> list[Piece]:
    """Every input moves, straight from one piece to the next, with rates and positions that belong to it."""
    inputs, start = quantities(ALL[name].inputs), values(ALL[name]).u
    corners = np.arange(round(STOP / LENGTH) + 1) * LENGTH
    at = {n: start[n] + PUSH[n] * np.sin(2 * np.pi * corners / STOP) for n in inputs if n in PUSH}
    where = {n: start[n] for n in inputs if n.endswith("position")}
    pieces = []
    for k, begin in enumerate(corners[:-1]):
        terms = {}
        for n, path in at.items():
            slope = (path[k + 1] - path[k]) / LENGTH
            terms |= {n: (path[k], slope, 0.0), inputs[n].rate: (slope, 0.0, 0.0)}
        for n in where:
            v, a, _ = terms[inputs[n].rate]
            terms[n] = (where[n], v, a / 2)
            where[n] += v * LENGTH + a * LENGTH**2 / 2
        pieces.append((begin, corners[k + 1], terms))
    return pieces


@pytest.mark.parametrize("name", ["swing", "boom_stick", "manipulator"])
def test_four_ways_through_each_part_agree(fmu_dir, fmi3_dir, name):
    """With all inputs moving; in Co-Simulation the rate inputs move them."""
    old, new = fmu_dir / f"{name}.fmu", fmi3_dir / f"{name}.fmu"
    pieces = wave(name)
    exact = integrated(old, pieces, EXCHANGE, LENGTH)
    for path in (old, new):
        compare(path, stepped(path, pieces, STEPPED, LENGTH), exact, BAR)
    compare(new, integrated(new, pieces, EXCHANGE, LENGTH), exact, BAR)
