"""The sensitivities of the machine against methods that share no code with the compiled ones."""

from collections.abc import Sequence
from functools import cache
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from equations.test_opening_curve import numbers_of
from hypothesis import given
from hypothesis import strategies as st
from kit import shards
from kit.equations import EDGES
from kit.properties import examples

from fmus import swing
from fmus.contract import quantities, symbolic
from fmus.identification.refinement.compiled_model import CompiledModel, SegmentSolution
from fmus.machine.one_block import HARVESTER
from fmus.monolith import breakpoints
from fmus.operator_input.work_cycle import COMMANDS, Move, sample
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


def driven(inputs: Sequence[str]) -> np.ndarray:
    """Commands, and the other inputs with the values of the parameter file."""
    rows = np.tile([NUMBERS.u[name] for name in inputs], (TIME.size, 1))
    for name, column in zip(COMMANDS, COMMANDED.T, strict=True):
        rows[:, inputs.index(name)] = column
    return rows


def started(tolerance: float) -> tuple[CompiledModel, np.ndarray, np.ndarray, np.ndarray]:
    """The machine, its inputs (n, nu), its states at the start and their derivatives."""
    machine = model(tolerance)
    rows = driven(machine.inputs)
    return machine, rows, *machine.start(machine.p0, rows[0])


def variational(chosen: Sequence[str], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Outputs and their derivatives by some parameters from the start on, (n, ny) and (n, ny, np).

    CVODES integrates the states with the variational equations dS/dt = J S + f_p, both in magnitudes;
    from one kink of the inputs to the next, as in `fmus.monolith.simulate`.
    """
    sym = symbolic(HARVESTER)
    nx, scale = sym.x.numel(), np.array([q.nominal for q in quantities(HARVESTER.states).values()])
    names = list(quantities(HARVESTER.parameters))
    rows = [list(quantities(HARVESTER.outputs)).index(name) for name in OUTPUTS]
    y = ca.vertcat(*[sym.y[i] for i in rows])
    p = np.array([NUMBERS.p[name] for name in names])
    free = [names.index(name) for name in chosen]
    own = ca.SX.zeros(p.size, len(free))
    for j, i in enumerate(free):
        own[i, j] = p[i]  # the derivative by the parameter over its value: columns of one magnitude
    s = ca.SX.sym("s", nx, len(free))
    known = [sym.x, sym.u, sym.p]

    def along(value: ca.SX) -> ca.SX:
        return ca.jacobian(value, sym.x) @ s + ca.jacobian(value, sym.p) @ own

    at, slope, t = ca.SX.sym("at", sym.u.numel()), ca.SX.sym("slope", sym.u.numel()), ca.SX.sym("t")
    z = ca.SX.sym("z", nx * (1 + len(free)))
    weights = np.tile(scale, 1 + len(free))
    spread = [z[:nx] * scale, ca.reshape(z[nx:] * weights[nx:], nx, len(free))]
    rate = ca.Function("rate", [*known, s], [ca.vertcat(sym.dx, ca.vec(along(sym.dx)))], {"cse": True})
    evaluate = ca.Function("evaluate", [*known, s], [y, along(y)])
    ode = {"t": t, "x": z, "p": ca.vertcat(at, slope)}
    ode["ode"] = rate(spread[0], at + slope * t, p, spread[1]) / weights
    x = np.array(list(NUMBERS.x.values()))
    u = driven(list(quantities(HARVESTER.inputs)))
    at_start = ca.substitute(along(sym.start), s, ca.SX.zeros(nx, len(free)))
    begin = ca.Function("begin", known, [sym.start, at_start])
    x0, s0 = (value.full() for value in begin(x, u[0], p))
    state = np.concatenate([x0.T.ravel(), s0.T.ravel()]) / weights
    history = [state]
    options = {"reltol": 1e-11, "abstol": 1e-11, "max_num_steps": 100_000}
    for first, last in pairwise(breakpoints(TIME[:count], u[:count])):
        grid = TIME[first : last + 1] - TIME[first]
        solver = ca.integrator("variational", "cvodes", ode, 0.0, grid[1:], options)
        ends = solver(x0=state, p=np.concatenate([u[first], (u[last] - u[first]) / grid[-1]]))["xf"].full().T
        history.extend(ends)
        state = ends[-1]
    found = [
        evaluate(row[:nx] * scale, u[i], p, (row[nx:] * weights[nx:]).reshape(len(free), nx).T)
        for i, row in enumerate(history)
    ]
    outputs = np.array([a.full()[:, 0] for a, _ in found])
    return outputs, np.array([b.full() for _, b in found]) / p[free]


# a valve, a line, a mass and an initial state until all axes move; all until they stop
@pytest.mark.parametrize(
    ("chosen", "count"),
    [
        (("valve_dead_band", "line_capacitance", "head_mass", "initial_boom_angle"), 91),
        pytest.param(FREE, TIME.size, marks=shards.machine),
    ],
    ids=["some", "all"],
)
def test_sensitivities_are_those_of_the_variational_equations(chosen: Sequence[str], count: int) -> None:
    """Every sensitivity to a parameter, including its effect on the initial state, while all axes move."""
    machine, rows, x0, start = started(1e-10)
    piece = machine.segment(x0, machine.p0, TIME[:count], rows[:count])
    found = (piece.y_p + piece.y_x @ start)[:, :, [FREE.index(name) for name in chosen]]
    y, expected = variational(chosen, count)
    # errors of both solvers, measured 3e-8 and 2e-6, most from 0.795 s: an emptied line is full again
    assert (np.abs(piece.y - y).max(axis=0) < 1e-6 * np.abs(y).max(axis=0)).all()
    assert (np.abs(found - expected).max(axis=0) < 2e-5 * np.abs(expected).max(axis=0)).all()


@examples(20)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_derivatives_are_those_of_the_program(seed: int) -> None:
    """Where no step size can change, differences of the program itself agree in any direction, however large
    the error of its steps: nothing in the derivative of a step is left out."""
    rng = np.random.default_rng(seed)
    machine, rows, x0, _ = started(1e9)  # every step is accepted, one for each sample
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


@cache
def whole_run() -> SegmentSolution:
    """All of it in one segment."""
    machine, rows, x0, _ = started(1e-10)
    return machine.segment(x0, machine.p0, TIME, rows)


@examples(10)
@given(cut=st.integers(1, TIME.size - 2))
def test_two_pieces_are_one(cut: int) -> None:
    """Two consecutive segments give the whole by the chain rule, as multiple shooting requires."""
    (machine, rows, x0, _), whole = started(1e-10), whole_run()
    first = machine.segment(x0, machine.p0, TIME[: cut + 1], rows[: cut + 1])
    second = machine.segment(first.x, machine.p0, TIME[cut:], rows[cut:])
    assert np.array_equal(first.y, whole.y[: cut + 1])
    assert np.array_equal(first.y_p, whole.y_p[: cut + 1])
    by_x, by_p = second.y_x @ first.x_x, second.y_p + second.y_x @ first.x_p
    for found, expected in ((by_x, whole.y_x[cut:]), (by_p, whole.y_p[cut:])):
        # the second piece begins with other steps: errors of the solver, measured 1e-8
        scale = np.maximum(np.abs(expected), np.abs(found)).max(axis=0)
        assert (np.abs(found - expected).max(axis=0) <= 1e-6 * scale).all()
    assert np.array_equal(second.y[-1, 4:6], second.x[12:14])  # two angles are outputs and states


# ---- Sensitivities with respect to the points of opening curves, in the variants of a drive that have them

SWING_OUTPUTS = ("swing_pressure_a", "swing_torque", "supply_flow")
POINTS = (
    *("valve_area", "valve_pa_opening_3", "valve_pa_opening_4", "valve_pa_command_3"),
    *("valve_bt_opening_4", "valve_bt_command_1", "valve_bt_command_2"),
)


@pytest.mark.parametrize("variant", ["lumped", "quasistatic", "detailed"])
def test_derivatives_by_points_are_those_of_differences(variant):
    """A command that sweeps the first four points of P-A and B-T, at a speed that follows it."""
    sub = swing.VARIANTS[variant]
    numbers = values(sub)
    for edge in EDGES:
        numbers.p.update(numbers_of(edge))
    model = CompiledModel(sub, SWING_OUTPUTS, POINTS, numbers, tolerance=1e-9)
    time = np.linspace(0.0, 0.4, 41)
    rows = np.tile([numbers.u[name] for name in model.inputs], (time.size, 1))
    rows[:, model.inputs.index("swing_command")] = 4.5 * time / 0.4
    rows[:, model.inputs.index("swing_speed")] = 0.2 * (time / 0.4) ** 2

    def simulated(p, sensitivities=False):
        x, _ = model.start(p, rows[0])
        return model.segment(x, p, time, rows, sensitivities)

    exact = simulated(model.p0, sensitivities=True).y_p
    for j, name in enumerate(POINTS):
        step = 1e-4 * model.p0[j]
        change = step * (np.arange(len(POINTS)) == j)
        ahead, behind = (simulated(model.p0 + sign * change).y for sign in (1, -1))
        difference = (ahead - behind) / (2 * step)
        scale = np.abs(difference).max(axis=0)
        assert (scale > 0).all(), name
        # the error of the difference, with kinks of the second derivative at the points
        assert (np.abs(exact[:, :, j] - difference).max(axis=0) < 1e-3 * scale).all(), name
