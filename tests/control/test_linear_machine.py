"""Linear models of the harvester: eigenvalues of the monolithic Jacobian, operating points, steady states."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from kit import equations, shards
from scipy.optimize import linear_sum_assignment

from fmus.machine import parts
from fmus.machine.poses import POSES
from orchestrator import linearize, run
from orchestrator.linear.modes import eigen

MACHINES = {
    "lumped": {},
    "detailed": {"swing": "detailed", "boom_stick": "detailed"},
    "pendulum": {"manipulator": "pendulum"},
    "quasistatic": {"swing": "quasistatic", "boom_stick": "quasistatic"},
    "pumped": {"manipulator": "pendulum_friction", "supply": "engine_pump"},
    "load_sensing": {"supply": "load_sensing"},
    "compensated": {"swing": "compensated", "boom_stick": "compensated"},
    "today": {"swing": "compensated", "boom_stick": "compensated", "supply": "load_sensing"},
    "all": parts.MACHINES["detailed"],
}
SPEEDS = (("swing", 0.3), ("boom", -0.1), ("stick", 0.2))
SAME = 1e-6  # relative, what is promised of eigenvalues


@cache
def monolith(machine):
    """Names of states and inputs of the monolithic equations, and their Jacobian by CasADi as a function."""
    whole = equations.machine(**{"supply": "ideal"} | MACHINES[machine])
    x, u = ca.SX.sym("x", len(whole.states)), ca.SX.sym("u", len(whole.inputs))
    rate = whole.right_hand_side(x, u, whole.p)
    jacobians = [ca.densify(ca.jacobian(rate, v)) for v in (x, u)]
    return whole.states, whole.inputs, ca.Function("J", [x, u], jacobians)


def truth(linear, machine="lumped"):
    """(A, B) of the monolithic equations at the state and inputs of a linear model."""
    states, inputs, jacobians = monolith(machine)
    at, given = {s.name: v for s, v in zip(linear.states, linear.x0, strict=True)}, dict(told(linear))
    a, b = jacobians([at[n] for n in states], [given.get(n, 0.0) for n in inputs])
    order = [states.index(s.name) for s in linear.states]
    columns = [inputs.index(i.name) for i in linear.inputs]
    return a.full()[np.ix_(order, order)], b.full()[np.ix_(order, columns)]


def told(linear):
    return ((i.name, v) for i, v in zip(linear.inputs, linear.u0, strict=True))


def matched(linear, a):
    """All eigenvalues of a are those of the linear model."""
    size = np.array([s.nominal for s in linear.states])
    wanted, found = (eigen(m, size)[0] for m in (a, linear.a))
    apart = np.abs(wanted[:, None] - found) / np.maximum(np.abs(wanted), 1e-12)[:, None]  # zero: to 1e-18
    assert apart[linear_sum_assignment(apart)].max() <= SAME


@pytest.fixture(scope="module")
def found(fmu_dir):
    """The linear model of a machine in a pose: at rest, with joints at speeds or as it starts; found once."""

    @cache
    def at(machine, pose, speeds):
        steady = {} if speeds is None else {"steady": True, "speeds": dict(speeds)}
        return linearize(fmu_dir / "harvester.ssp", parameters=[pose], swap=MACHINES[machine], **steady)

    return at


KINDS = ("lumped", "quasistatic", "load_sensing", "all")  # "all" has every other part
CASES = [
    *shards.few([(m, "reach", ()) for m in KINDS], [(m, "reach", ()) for m in MACHINES], shards.machine),
    *((m, "close", SPEEDS) for m in KINDS),
]


@pytest.mark.parametrize(("machine", "pose", "speeds"), [*(("lumped", p, None) for p in POSES), *CASES])
def test_eigenvalues_are_the_monolithic_ones(found, machine, pose, speeds):
    """As it starts in each pose, and in steady states at rest and moving, of every fidelity: to 1e-6 each."""
    linear = found(machine, pose, speeds)
    a, b = truth(linear, machine)
    matched(linear, a)
    # the same products in another order
    room = {"rtol": 1e-12} if speeds is None else {"rtol": 1e-9, "atol": 1e-12 * np.abs(b).max()}
    np.testing.assert_allclose(linear.b, b, **room)


@pytest.mark.parametrize(("machine", "pose", "speeds"), CASES)
def test_a_steady_state_is_steady(found, machine, pose, speeds):
    """Joints are where the pose has them, at their speeds; the rest rests to 1e-8 of its size per second."""
    linear, wanted = found(machine, pose, speeds), dict(speeds)
    for state, x, rate in zip(linear.states, linear.x0, linear.f0, strict=True):
        joint, _, kind = state.name.removeprefix("manipulator.").partition("_")
        speed = wanted.get(joint, 0.0)
        if joint in ("swing", "boom", "stick") and kind == "angle":
            assert (x, rate) == (getattr(POSES[pose], joint), speed)
        elif state.name != "supply.reservoir_volume":
            assert abs(rate) <= 1e-8 * state.nominal, state.name  # rounding: 2e-10 are seen
        if joint in ("swing", "boom", "stick") and kind == "speed":
            assert x == speed


def test_along_a_run_the_point_is_that_of_the_run(fmu_dir):
    """At 2.5 s of the work cycle states are those of the run, and eigenvalues the monolithic ones."""
    linear = linearize(fmu_dir / "harvester.ssp", time=2.5)
    names = [s.name for s in linear.states]
    trace = run(fmu_dir / "harvester.ssp", stop=2.5, record=names).trace
    np.testing.assert_array_equal(linear.x0, [trace[n][-1] for n in names])
    assert linear.u0[0] == pytest.approx(3.6, rel=1e-12)  # the lever of the swing is at the top of its stroke
    matched(linear, truth(linear)[0])


@pytest.mark.parametrize("speeds", [{}, {"boom": 0.1}, {"boom": -0.1}, {"stick": 0.2}], ids=str)
def test_a_load_sensing_supply_does_not_hunt(fmu_dir, speeds):
    """Valves closed, lifting, lowering, stick moving: all oscillations are damped, the pump by 0.15."""
    system = fmu_dir / "harvester.ssp"
    linear = linearize(system, steady=True, speeds=speeds, swap=MACHINES["load_sensing"])
    swinging = [m for m in linear.modes if m.oscillates]
    assert min(m.damping for m in swinging) > 0.004  # of the boom on closed valves, with any supply
    (pump,) = (m for m in swinging if "pump" in m.name)  # measured: 92 to 97 Hz, 0.18 to 0.22
    assert pump.damping > 0.15
