"""The master that foretells inputs from the joined linearisations, on the undamped two-mass oscillator."""

from ctypes import byref, c_double

import numpy as np
import pytest
from kit.any_fmu.models import DEPENDS, RATES, STATES, TELLS, V, oscillator_of, telling
from scipy.linalg import expm, lu_factor

from orchestrator import Coupling, Trace, assemble, run
from orchestrator.base.files import Location
from orchestrator.data.trace_writer import TraceInMemory
from orchestrator.engine.c_library import Binding, engine_h, library
from orchestrator.engine.job import Job
from orchestrator.engine.linear_system import JoinedSystem, Linearisation
from orchestrator.engine.simulation_loop import simulation
from orchestrator.engine.time_grid import Grid
from orchestrator.fmi.calls import address
from orchestrator.fmi.interface import read_interface
from orchestrator.ssp.masters import interface_jacobian_plan


def predicting(**choices):
    """This master, without the guard."""
    return Coupling("interface-jacobian", **({} if "adaptive" in choices else {"guard": 0}), **choices)


def follow(system, step=1e-3, stop=10.0, record_step=None, **choices):
    """A run with this master."""
    return run(system, master=predicting(**choices), step=step, stop=stop, record_step=record_step)


# ---- accuracy


def test_order_four(open_oscillator, worst):
    """Halving the step divides the error by sixteen, and the errors are those of exact components."""
    errors = [worst(follow(open_oscillator, step=h)) for h in (2e-2, 1e-2, 5e-3)]
    # measured 4.02 and 3.99: the cubic through thirds of the step, and the method in between
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx(4, abs=0.1)
    assert errors[1] < 3e-6  # 2.5e-6 with components that are solved exactly
    hermite = run(open_oscillator, master=Coupling("hermite", guard=0, passes=1), step=2e-2, stop=10.0)
    assert errors[0] < worst(hermite) / 100  # one pass without rollback, too; measured 4.0e-5 and 1.9e-2


@pytest.mark.parametrize("factors", [{"a": 3}, {"b": 4}, {"a": 2, "b": 5}])
def test_components_with_steps_of_their_own(open_oscillator, worst, factors):
    """Each substep gets its part of the polynomial."""
    # as with one step for all: 2.5e-6
    assert worst(follow(open_oscillator, step=1e-2, factors=factors)) < 3e-6


def test_inputs_that_move_at_lines_keep_the_order(fmus3, worst, order):
    """FMI 3.0 with rate inputs: the line with the same mean and moment keeps order four."""
    also = {m: [*STATES[m], RATES[m]] for m in ("mass_a", "mass_b")}
    lines = oscillator_of(*(telling(fmus3, m, f"{m}_lines", also=also[m]) for m in also))
    found = order(lambda h: worst(follow(lines, step=h)), 2e-2)
    # a line instead of the cubic acts differently on a linear system from h^4 on, docs/coupling.md
    assert found == pytest.approx(4, abs=0.2)


# ---- steps that are chosen


def test_adaptive_steps_keep_the_tolerance(open_oscillator, worst):
    """1e-5 in under 1000 steps; some are repeated, and rejected steps have no effect."""
    result = follow(open_oscillator, adaptive=1e-5, record_step=0.1)
    assert result.card.repeated > 0
    assert result.card.steps < 1000  # measured 849
    assert worst(result) < 2e-5  # measured 5e-6: errors of all steps add up, and the estimate is rough


def test_a_repeated_step_is_predicted_anew(open_oscillator):
    """A step that is computed three times with the same length has the same result."""

    def ends(rejected):
        coupling = Coupling("interface-jacobian", adaptive=1e-3)
        job = Job(open_oscillator, None, Grid(0.0, 0.5, 1, first=1e-2, free=True), coupling)
        sink = TraceInMemory()
        with simulation(job, sink) as opened:
            state, tries = opened.state, 0
            size = engine_h().StepSize.from_address(state.step_size)
            state.patience = 0.0  # one step at a time
            opened.begin()
            while state.done < 1:
                size.h = 1e-2
                state.error_tolerance = 1e-300 if tries % (rejected + 1) < rejected else 1e300
                tries += 1
                opened.advance()
            return (state.steps, state.repeated), sink.trace["a.x"]

    (counts, once), (more, thrice) = ends(0), ends(2)
    assert counts == (50, 0)
    assert more == (50, 100)
    np.testing.assert_array_equal(thrice, once)


@pytest.mark.parametrize("choices", [{}, {"factors": {"b": 3}}, {"adaptive": 1e-5}], ids=str)
def test_fmus_called_by_c_and_by_python_give_the_same_numbers(open_oscillator, both, choices):
    """Bit for bit over 1000 steps, and the same steps where they are chosen."""
    stop = 1.0 if "adaptive" not in choices else 10.0
    outcome = both(open_oscillator, predicting(**choices), step=1e-3, stop=stop)
    assert outcome.error == ""
    assert outcome.result.card.steps >= 300


# ---- what components cannot do


def closed(workshop, model):
    return workshop.make(model, f"{model}_closed", interpolates=workshop.fmi == 2)


def without_derivatives(result):
    """The components that a note names for it."""
    return [note.split()[0] for note in result.card.notes if "no directional derivatives" in note]


@pytest.mark.parametrize("which", ["a", "b", "ab"])
def test_components_that_do_not_tell_are_continued(fmus, worst, which):
    """Inputs from a component without derivatives are extrapolated, and a note names it."""
    files = {n: (closed if n in which else telling)(fmus, f"mass_{n}") for n in "ab"}
    result = follow(oscillator_of(**files))
    assert without_derivatives(result) == sorted(which, reverse=True)
    assert worst(result) < 5e-8  # as one pass of hermite, 3e-8; with everything told 7e-10


def test_derivatives_that_fail_are_told(fmus):
    """Inputs from an FMU whose derivatives are NaN are extrapolated, with a note."""
    rates = [V("der_y", "local", depends=["u"], derives="y", place=14)]
    more = {"able": {TELLS[2]: "true"}, "also": rates, "changes": {"y": {"depends": ["y"]}}}
    files = {n: fmus.make("fails", f"nan_{n}", interpolates=True, **more) for n in ("one", "other")}
    system = assemble(files, ["one.y -> other.u", "other.y -> one.u"])
    assert without_derivatives(follow(system, step=0.1, stop=0.5)) == ["one", "other"]


# ---- what FMUs tell


def test_states_are_read_from_the_model_structure(fmus, fmus3):
    """States, their derivatives, and what these and the outputs depend on, in both versions of FMI."""
    for workshop in (fmus, fmus3):
        face = read_interface(Location(telling(workshop, "mass_a")))
        assert face.states == {"x": "der_x", "v": "der_v"}
        assert face.dependencies["der_v"] == {"x2", "x"}
        assert face.dependencies["force"] == {"x2", "x"}
    silent = read_interface(Location(telling(fmus, "mass_a", "silent", undeclared=True)))
    assert silent.states == {"x": "der_x", "v": "der_v"}
    assert silent.dependencies["der_v"] is None
    assert read_interface(Location(fmus["mass_a"])).states == {}


@pytest.mark.parametrize(("undeclared", "calls"), [(False, 2), (True, 3)])
def test_one_call_for_knowns_that_share_nothing(fmus, started, undeclared, calls):
    """x and v affect different unknowns, so one call gives both columns if dependencies are declared."""
    slave = started(telling(fmus, "mass_a", f"calls_{undeclared}", undeclared=undeclared))
    tangent = Linearisation(slave, ["x2"], ["force"], np.zeros(2))
    assert len(tangent.columns) == calls
    # x' = v, v' = -10 x + 100 (x2 - x), force = 100 (x2 - x): exact
    np.testing.assert_array_equal(tangent.matrix(), [[0, 1, 0], [-110, 0, 100], [-100, 0, 100]])


def test_an_algebraic_loop_is_part_of_the_linear_system(fmus):
    """Two masses with feed-through: a step that is a hundred times as long has the same accuracy."""
    units = {"force": {"depends": DEPENDS["force"], "unit": "m"}}
    same = {y: {"depends": DEPENDS[y]} for y in ("x", "v")}
    files = {n: telling(fmus, "mass_a", f"loop_{n}", changes=units | same) for n in "pq"}
    system = assemble(files, ["p.force -> q.x2", "q.force -> p.x2"], {"p.coupling": 0.5, "q.coupling": 0.3})
    coarse, fine = (follow(system, step=h, stop=1.0) for h in (1e-1, 1e-3))
    assert coarse.card.notes[0].startswith("algebraic loop")
    # 0.33 rad per step of 0.1 s: 1e-6 of the amplitude of 30 m
    assert coarse.trace["p.x"][-1] == pytest.approx(fine.trace["p.x"][-1], abs=3e-5)


# ---- what leads


def test_sources_and_scenarios_lead(fmus, order):
    """A component that depends on no other one steps first; an integrator behind a sine and a ramp."""
    integrator = fmus.make("fails", "led", interpolates=True)
    system = assemble({"sum": integrator, "sine": fmus["source"]}, ["sine.y -> sum.u"])

    def error(h):
        return abs(follow(system, step=h, stop=1.0).trace["sum.y"][-1] - (1 - np.cos(1.0)))

    # slopes of the sine are differences of four values, third order: the integral of the cubic, fourth
    assert order(error, 0.1) > 3
    ramp = Trace(np.array([0.0, 1.0]), {"u": np.array([0.0, 1.0])})
    end = run(str(integrator), ramp, master="interface-jacobian", step=0.1).trace["led.y"][-1]
    assert end == pytest.approx(0.5, abs=1e-12)  # exact for a ramp; rounding of 4000 inner steps


def test_a_chain_behind_a_source_is_leading(fmus, open_oscillator):
    """A chain behind a source steps in its order, each component with the interpolated output before it."""
    files = {"last": closed(fmus, "mass_b"), "middle": closed(fmus, "mass_a"), "first": fmus["source"]}
    chain = assemble(files, ["middle.force -> last.force", "first.y -> middle.x2"], {"first.omega": 20.0})
    assert interface_jacobian_plan(chain, predicting()).order == [2, 1, 0]
    plan = interface_jacobian_plan(open_oscillator, predicting())
    assert plan.prediction.leading_count == 0
    coarse, fine = (follow(chain, step=h, stop=1.0) for h in (1e-2, 1e-3))
    assert coarse.card.notes == fine.card.notes
    assert not without_derivatives(coarse)
    # the source tells no slope: its 20 m/s are missed at the start, 2000 N/s h^2 / 12, over 33 rad/s: 5e-4 m
    np.testing.assert_allclose(coarse.trace["last.x"], fine.trace["last.x"][::10], rtol=0, atol=6e-4)


# ---- The joined linear system compared with the exact solution of its equations


class Joined(JoinedSystem):
    """A joined system with the functions of the engine."""

    def join(self):
        self.binding = Binding()
        self.state = self.struct(self.binding)
        library().linear_system_join(byref(self.state.system))

    def predict(self, h):
        library().prediction_prepare(byref(self.state), c_double(h))
        library().prediction_solve(byref(self.state))


def random(n, m, seed, direct=True):
    """A joined system with random matrices, and A + B K C, B K, K C and K without padding."""
    rng = np.random.default_rng(seed)
    joined = Joined(n, m)
    joined.has_feedthrough = direct
    a, b, c = rng.normal(size=(n, n)) - 2 * np.eye(n), rng.normal(size=(n, m)), rng.normal(size=(m, n))
    d = 0.3 * rng.normal(size=(m, m)) / m if direct else np.zeros((m, m))
    joined.a[:, :n], joined.b[:, :n], joined.c[:, :m], joined.d[:, :m] = a.T, b.T, c.T, d.T
    joined.f[:n], joined.course[:, :m] = rng.normal(size=n), rng.normal(size=(3, m))
    k = np.linalg.inv(np.eye(m) - d)
    return joined, (a + b @ k @ c, b @ k, k @ c, k)


def exact(joined, matrices, h):
    """The change of the inputs up to h/3, 2h/3 and h: states and powers of time as one linear system."""
    closed, push, told, k = matrices
    n, m = joined.n, joined.m
    course = joined.course[:, :m]
    big = np.zeros((n + 4, n + 4))
    big[:n, :n], big[:n, n] = closed, joined.f[:n]
    for power in range(3):  # the columns behind f are for s, s^2 and s^3
        big[:n, n + 1 + power] = push @ course[power]
        big[n + 1 + power, n + power] = power + 1
    found = []
    for s in (h / 3, 2 * h / 3, h):
        state = (expm(big * s) @ np.eye(n + 4)[n])[:n]
        found.append(told @ state + k @ (course.T @ [s, s**2, s**3]))
    return np.array(found)


@pytest.mark.parametrize("direct", [False, True])
@pytest.mark.parametrize(("n", "m"), [(1, 1), (5, 3), (8, 8), (18, 15)])
def test_the_prediction_converges_with_order_three(n, m, direct):
    """Three steps of a method of order three: halving the step divides the error of the end by sixteen."""
    joined, matrices = random(n, m, n, direct)
    errors = []
    for h in (0.02, 0.01):
        joined.join()
        joined.predict(h)
        errors.append(np.max(np.abs(joined.v[:, :m] - exact(joined, matrices, h))))
    # the local error of order three goes with h^4
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.3)


def test_a_stiff_system_comes_to_rest():
    """Far beyond the fast rates the changes are those of the equilibrium: the method is L-stable."""
    joined = Joined(2, 2)
    joined.a[0, 0], joined.a[1, 1] = -1e9, -1e7
    joined.c[0, 0] = joined.c[1, 1] = 1.0
    joined.f[:2] = 3e9, -2e7
    joined.join()
    joined.predict(0.1)
    # the stability function falls with one over the fast rate times the step, 1e-6 and less
    np.testing.assert_allclose(joined.v[:, :2], [[3.0, -2.0]] * 3, rtol=1e-5)


def test_connections_without_a_solution_are_no_system():
    """Outputs that are copied to their own inputs have no unique solution."""
    joined = Joined(1, 2)
    joined.has_feedthrough = True
    joined.d[0, 1] = joined.d[1, 0] = 1.0
    joined.join()
    assert not joined.state.system.usable


@pytest.mark.parametrize("n", [1, 2, 7, 18])
def test_inverse(n):
    """Matrix times inverse is the identity, also if rows must be exchanged; a singular one has none."""
    matrix = np.random.default_rng(n).normal(size=(n, n))
    np.fill_diagonal(matrix, 0.0 if n > 1 else 2.0)
    wide = -(-n // 8) * 8  # rows are padded
    found, rows = np.zeros((n, wide)), np.zeros(n, np.int32)
    assert not library().matrix_invert(address(found), address(rows), n, wide)
    found[:, :n] = matrix
    assert library().matrix_invert(address(found), address(rows), n, wide)
    # rounding times the condition of the matrix, below 1e4
    np.testing.assert_allclose(found[:, :n] @ matrix, np.eye(n), atol=1e-11)
    assert rows.tolist() == lu_factor(matrix)[1].tolist()  # the largest pivots
    if n > 1:
        assert not library().matrix_invert(address(np.ones((n, wide))), address(rows), n, wide)
