"""The sensitivities of the machine against methods that share no code with the compiled ones."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit import shards
from kit.properties import examples

from fmus import swing
from fmus.contract import quantities
from fmus.identification.refinement.compiled_model import CompiledModel
from fmus.machine.one_block import HARVESTER
from fmus.machine.work_cycle import COMMANDS, Move, sample
from fmus.monolith import join, simulate
from fmus.parameters import values

OUTPUTS = (
    *("swing_pressure_a", "boom_head_pressure", "stick_rod_pressure", "boom_head_flow"),
    *("swing_angle", "boom_angle", "stick_speed", "tip_radius"),
)
FREE = (
    *("valve_area", "valve_dead_band", "line_capacitance", "motor_displacement", "bulk_modulus"),
    *("boom_hose_resistance", "stick_hose_inertance", "boom_joint_damping", "head_mass"),
    *("swing_initial_preload", "initial_boom_angle"),
)
NUMBERS = values(HARVESTER)
# all axes at once: a ramp out of the dead band, a hold, a ramp back
MOVES = (
    Move("swing", 0.05, 3.0, 0.2, 0.2, 0.3),
    Move("boom", 0.1, 3.2, 0.2, 0.3, 0.2),
    Move("stick", 0.15, -3.0, 0.2, 0.2, 0.2),
)
TIME, COMMANDED = sample(MOVES, 1.0)


@cache
def model(tolerance: float) -> CompiledModel:
    """The machine, cached because its equations take a quarter of a second."""
    return CompiledModel(HARVESTER, OUTPUTS, FREE, NUMBERS, tolerance)


def inputs(machine: CompiledModel) -> np.ndarray:
    """Commands, and the other inputs with the values of the parameter file."""
    rows = np.tile([NUMBERS.u[name] for name in machine.inputs], (TIME.size, 1))
    for name, column in zip(COMMANDS, COMMANDED.T, strict=True):
        rows[:, machine.inputs.index(name)] = column
    return rows


# a valve, a line, a mass and an initial state until all axes move; all until a line is emptied
@pytest.mark.parametrize(
    ("chosen", "count"),
    [
        (("valve_dead_band", "line_capacitance", "head_mass", "initial_boom_angle"), 91),
        pytest.param(FREE, 150, marks=shards.machine),
    ],
    ids=["some", "all"],
)
def test_sensitivities_are_differences_of_another_solver(chosen: Sequence[str], count: int) -> None:
    """Each column, with the effect on the initial state: CVODES with a parameter changed up and down."""
    machine = model(1e-10)
    rows = inputs(machine)[:count]
    x0, start = machine.start(machine.p0, rows[0])
    piece = machine.segment(x0, machine.p0, TIME[:count], rows)
    found = piece.y_p + piece.y_x @ start
    every = list(quantities(HARVESTER.inputs))
    block = join({"block": HARVESTER}, (), {n: [f"block.{n}"] for n in every}, {"block": NUMBERS})
    assert list(block.inputs) == every
    u = np.tile([NUMBERS.u[name] for name in every], (count, 1))
    u[:, [every.index(name) for name in COMMANDS]] = COMMANDED[:count]
    measured = [block.output_names.index(f"block.{name}") for name in OUTPUTS]

    def solved(name: str = "", change: float = 0.0) -> np.ndarray:
        p = np.where(np.array(block.parameters) == f"block.{name}", 1 + change, 1) * block.p
        return simulate(block, TIME[:count], u, p, tolerance=1e-12)[1][:, measured]

    # errors of both solvers, measured 3e-8, most from 0.795 s: an emptied line is full again
    y = solved()
    assert (np.abs(piece.y - y).max(axis=0) < 1e-6 * np.abs(y).max(axis=0)).all()
    for name in chosen:
        expected = (solved(name, 1e-3) - solved(name, -1e-3)) / (2e-3 * NUMBERS.p[name])
        away = np.abs(found[:, :, FREE.index(name)] - expected).max(axis=0)
        # the errors of the outputs over the change of the parameter, and its square in the difference
        error = 1e-11 * np.abs(y).max(axis=0) / (1e-3 * NUMBERS.p[name])
        assert (away < 1e-4 * np.abs(expected).max(axis=0) + 100 * error).all(), name


@examples(20)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_derivatives_are_those_of_the_program(seed: int) -> None:
    """Where no step size can change, differences of the program itself agree in any direction, however large
    the error of its steps: nothing in the derivative of a step is left out."""
    machine, rng = model(1e9), np.random.default_rng(seed)  # every step is accepted, one for each sample
    rows = inputs(machine)
    x0, _ = machine.start(machine.p0, rows[0])
    moving = model(1e-6).segment(x0, machine.p0, TIME[:61], rows[:61], False).x
    # without a payload: the force of a pick-up begins with a kink, across which differences are wrong
    scale = np.where(["payload" in n or "held" in n for n in machine.states], 0.0, machine.nominal)
    x0 = moving + 1e-2 * scale * rng.uniform(-1, 1, x0.size)
    time = np.linspace(0.3, 0.31, 21)
    rows = np.column_stack([np.interp(time, TIME, row) for row in rows.T])
    vx, vp = scale * rng.uniform(-1, 1, x0.size), machine.p0 * rng.uniform(-1, 1, machine.p0.size)

    def moved(e: float) -> np.ndarray:
        piece = machine.segment(x0 + e * vx, machine.p0 + e * vp, time, rows, False)
        assert piece.steps == 20
        return piece.y

    def central(e: float) -> np.ndarray:
        return (moved(e) - moved(-e)) / (2 * e)

    piece = machine.segment(x0, machine.p0, time, rows)
    found = piece.y_x @ vx + piece.y_p @ vp
    expected = (4 * central(1e-5) - central(2e-5)) / 3
    # rounding over the step of 1e-5, and a third derivative that jumps (fmax): measured up to 1e-7
    assert (np.abs(found - expected).max(axis=0) < 1e-6 * np.abs(found).max(axis=0)).all()


# ---- points of opening curves, in the variants of a drive that have them

POINTS = ((0.8, 0.0), (1.5, 0.012), (3.0, 0.06), (5.0, 0.19), (7.5, 0.55), (10.0, 1.0))
DRIVE_OUTPUTS = ("swing_pressure_a", "swing_torque", "supply_flow")
CURVES = (
    *("valve_area", "valve_pa_opening_3", "valve_pa_opening_4", "valve_pa_command_3"),
    *("valve_bt_opening_4", "valve_bt_command_1", "valve_bt_command_2"),
)


def with_tables(sub):
    """The values of a drive with a table in each edge."""
    v = values(sub)
    points = {
        f"valve_{edge}_{what}_{i}": x
        for edge in ("pa", "at", "pb", "bt")
        for i, point in enumerate(POINTS, 1)
        for what, x in zip(("command", "opening"), point, strict=True)
    }
    return replace(v, p={**v.p, **points})


@pytest.mark.parametrize("variant", ["lumped", "quasistatic", "detailed"])
def test_derivatives_by_points_are_those_of_differences(variant):
    """A command that sweeps the first four points of P-A and B-T, at a speed that follows it."""
    sub = swing.VARIANTS[variant]
    numbers = with_tables(sub)
    model = CompiledModel(sub, DRIVE_OUTPUTS, CURVES, numbers, tolerance=1e-9)
    time = np.linspace(0.0, 0.4, 41)
    rows = np.tile([numbers.u[name] for name in model.inputs], (time.size, 1))
    rows[:, model.inputs.index("swing_command")] = 4.5 * time / 0.4
    rows[:, model.inputs.index("swing_speed")] = 0.2 * (time / 0.4) ** 2

    def simulated(p, sensitivities=False):
        x, _ = model.start(p, rows[0])
        return model.segment(x, p, time, rows, sensitivities)

    exact = simulated(model.p0, sensitivities=True).y_p
    for j, name in enumerate(CURVES):
        step = 1e-4 * model.p0[j]
        change = step * (np.arange(len(CURVES)) == j)
        ahead, behind = (simulated(model.p0 + sign * change).y for sign in (1, -1))
        difference = (ahead - behind) / (2 * step)
        scale = np.abs(difference).max(axis=0)
        assert (scale > 0).all(), name
        # the error of the difference, with kinks of the second derivative at the points
        assert (np.abs(exact[:, :, j] - difference).max(axis=0) < 1e-3 * scale).all(), name
