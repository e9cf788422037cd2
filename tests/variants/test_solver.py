"""The C code of each part at work against its equations and the solver in NumPy (kit/solver.py)."""

import numpy as np
import pytest
from kit import shards
from kit.equations import Part
from kit.every import EVERY, native, row
from kit.fmu import driving
from kit.solver import Solver

from fmus.contract import quantities
from fmus.controller import CONTROLLER
from fmus.export.model_description import COMMUNICATION_STEP
from orchestrator import run

# parts that differ in kind in every run: the code around the equations is the same for all
FEW = ("swing_lumped", "manipulator_rigid", "operator_input", "controller")
EACH = [
    *((name, False) for name in FEW),
    # the cycle begins with these seconds; the controller is no part of the machine that plays it
    *(pytest.param(name, True, marks=shards.machine) for name in EVERY if name != CONTROLLER.name),
]
STOP = 3.0  # s: boom and swing are moved in this part of the work cycle


def whole_cycle(sub, folder):
    """The inputs of 42 s, one row for each step, from the machine with this variant, and the step [s]."""
    swap, step = {sub.component: sub.variant} if sub.variant else {}, 5e-3
    trace = run(folder / "harvester.ssp", swap=swap, step=step).trace
    known = {n: f"{sub.component}.{n}" for n in quantities(sub.inputs)}
    samples = {n: trace[name].tolist() for n, name in known.items() if name in trace.signals}
    return [{n: v[k] for n, v in samples.items()} for k in range(trace.time.size - 1)], step


@pytest.mark.parametrize(("name", "whole"), EACH)
def test_the_c_code_is_the_equations_with_the_solver_in_numpy(fmu_dir, name, whole):
    """States and outputs agree to 1e-9 over the work cycle: the same inner steps of the same methods."""
    sub, step = EVERY[name], COMMUNICATION_STEP
    rows = [row(sub, k) for k in range(round(STOP / step))]
    if whole:
        rows, step = whole_cycle(sub, fmu_dir)
    part = Part(sub)
    solver, names = Solver(part, rows[0]), [*part.states, *part.outputs]
    compiled, states, inputs = [], [], []
    with driving(native(name, fmu_dir), **rows[0]) as fmu:
        for u in rows:
            solver.step(step, **u)
            compiled.append(fmu.set(**u).step(step).get(*names))
            states.append(solver.x)
            inputs.append(fmu.get(*part.inputs))
    found, p = np.array(compiled), np.array([*part.p.values()])[:, None]
    y = part.function.map(len(rows))(np.array(states).T, np.array(inputs).T, p)[1].full().T
    expected = np.hstack([states, y])
    assert np.ptp(found, axis=0).any()  # it worked
    nominal = np.array([q.nominal for g in (sub.states, sub.outputs) for q in quantities(g).values()])
    # another step would differ by the tolerance, 1e-6; below 1e-12 of its magnitude a signal is rounding
    room = 1e-9 * np.abs(found).max(axis=0) + 1e-12 * nominal
    assert (np.abs(expected - found) <= room).all()
