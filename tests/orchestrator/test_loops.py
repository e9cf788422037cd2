"""Algebraic loops through direct feed-through are found, solved and told."""

import re
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from kit import shards
from kit.any_fmu.models import TELLS, Workshop
from kit.any_fmu.outcome import in_python
from kit.mistakes import problem, table

from orchestrator import Problem, assemble, run
from orchestrator.engine.c_library import library
from orchestrator.engine.network import initialise
from orchestrator.engine.run import open_slave
from orchestrator.fmi.calls import address
from orchestrator.ssp.coupling import Coupling
from orchestrator.ssp.dependencies import output_order

# Solutions are as good as the residual, 1e-10 of the magnitude, times what the loop makes of it, at most 5.
CLOSE = 1e-9
MUTE = {"maxOutputDerivativeOrder": 0}
PAIR = ["p.y -> q.u", "q.y -> p.u"]
HERE = {"step": 0.1, "stop": 1.0, "isolate": False}  # a process whose run was refused is not used again


@dataclass(frozen=True)
class Kind:
    """FMUs of one version of FMI, with or without directional derivatives."""

    fmus: Workshop
    directional: bool

    def make(self, model: str, slopes: bool = True) -> Path:
        """An FMU, with or without slopes of its outputs."""
        able = {TELLS[self.fmus.fmi]: str(self.directional).lower(), "maxOutputDerivativeOrder": int(slopes)}
        return self.fmus.make(model, f"{model}_{self.directional}_{slopes}", able=able)


OTHERS = [("fmus", False), ("fmus3", True)]


@pytest.fixture(
    params=[("fmus", True), ("fmus3", False), *(pytest.param(o, marks=shards.search) for o in OTHERS)],
    ids=str,
)
def kind(request) -> Kind:
    """Each version of FMI, and both ways to a Jacobian; what differs between the versions is one call."""
    name, directional = request.param
    return Kind(request.getfixturevalue(name), directional)


def forced(kind: Kind, there: float, back: float, bend: float = 0.0, slopes: bool = True):
    """p.y = w + there p.u + bend p.u^2 with w = 2 + sin t, and p.u = back p.y."""
    files = {"s": kind.make("source", slopes), "p": kind.make("bent", slopes), "q": kind.make("gain", slopes)}
    start = {"s.offset": 2.0, "p.factor": there, "p.bend": bend, "q.factor": back}
    return assemble(files, ["s.y -> p.w", *PAIR], start)


@pytest.mark.parametrize(("there", "back"), [(0.5, 0.5), (3.0, -2.0), (3.0, 2.0), (-1e4, 1e3)])
def test_linear_loops_are_solved_at_every_point(kind, there, back):
    """Also if copied values would diverge, and at the first point; the note has connections and method."""
    result = run(forced(kind, there, back), step=0.1, stop=1.0)
    exact, rounded = result.trace["s.y"] / (1 - there * back), there * back == -1e7
    # At a gain of 1e7 all but 2e-7 of w, up to 3, is taken from it: u and its product are rounded, by at most
    # 2.7e-16 and 2.2e-16 of the sum. Measured 3.8e-16, and 2.3e-16 by a fused multiplication and addition
    bound = {"rtol": 0, "atol": 5e-16} if rounded else {"rtol": CLOSE}
    np.testing.assert_allclose(result.trace["p.y"], exact, **bound)
    np.testing.assert_allclose(result.trace["p.u"], back * exact, rtol=CLOSE)
    note, method = result.card.notes[-1], "directional derivatives" if kind.directional else "differences"
    assert note.startswith("algebraic loop ")
    assert all(part in note for part in (*PAIR, f"Newton's method with {method}, "))
    # the Jacobian of a linear loop is kept: one evaluation, and one after a step, except at first; at a gain
    # of 1e7 rounding is more than the residual that is wanted
    assert rounded or " 1.9 evaluations each" in note


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel", "hermite"])
def test_a_loop_that_is_not_linear_is_solved(kind, both, master):
    """The root near w of y = w - y / 2 - y^2 / 5 is found at each of 1000 steps, by C and by Python."""
    result = both(forced(kind, 0.5, -1.0, -0.2, slopes=False), master, step=0.02, stop=20.0).result
    assert result.card.steps == 1000
    root = (np.sqrt(1.5**2 + 0.8 * result.trace["s.y"]) - 1.5) / 0.4
    np.testing.assert_allclose(result.trace["p.y"], root, rtol=CLOSE)


@pytest.mark.parametrize("undeclared", [False, True])
def test_hermite_keeps_its_order_around_a_loop(fmus, both, order, undeclared):
    """A mass whose force and displacement are in a loop of gain 2: copied values would diverge."""
    mass = fmus.make("mass_a", f"looped_{undeclared}", interpolates=True, undeclared=undeclared)
    soft = fmus.make("gain", f"soft_{undeclared}", units={"u": "N"}, undeclared=undeclared, able=MUTE)
    start = {"g.factor": -0.02, "m.spring": 100.0}
    system = assemble({"m": mass, "g": soft}, ["m.force -> g.u", "g.y -> m.x2"], start)
    omega = np.sqrt(100 + 100 / 3)  # F = 100 (-0.02 F - x) = -100 x / 3

    def error(h):
        trace = both(system, Coupling("hermite", guard=0, tolerance=1e-10), step=h).result.trace
        return np.abs(trace["m.x"] - 100 / omega * np.sin(omega * trace.time)).max()

    # measured 4.0; the next term of the error is a part h omega = 0.06 of it at the larger step
    assert order(error, 5e-3) == pytest.approx(4, abs=0.1)


def test_derivatives_that_fail_are_replaced_by_differences(fmus):
    """Derivatives are declared but the call fails: they are not used, and the note reports differences."""

    def failing(component):
        slave = in_python(component)
        slave.directional_derivative = lambda *_: Mock(side_effect=Problem("no derivatives today"))
        return slave

    result = run(forced(Kind(fmus, True), 0.5, 0.5), step=0.1, stop=2.0, open=failing)
    np.testing.assert_allclose(result.trace["p.y"], result.trace["s.y"] / 0.75, rtol=CLOSE)
    assert "Newton's method with differences," in result.card.notes[-1]


def test_units_are_converted_inside_a_loop(each):
    """A wire with factor 1e5 and one with an offset of 273.15 K: the solution of the two equations."""
    files = {"p": each.make("gain", "warm", units={"u": "Pa", "y": "K", "offset": "K"})}
    files |= {"q": each.make("gain", "pressed", units={"u": "degC", "y": "bar", "offset": "bar"})}
    start = {"p.factor": 2e-5, "p.offset": 280.0, "q.factor": -3.0, "q.offset": 5.0}
    trace = run(assemble(files, PAIR, start), step=0.1, stop=0.3).trace
    kelvin = (2 * (3 * 273.15 + 5) + 280) / 7  # y_p = 2e-5 * 1e5 * y_q + 280 and y_q = -3 (y_p - 273.15) + 5
    np.testing.assert_allclose(trace["p.y"], kelvin, rtol=CLOSE)
    # differences of kelvins: 1e-10 of 300 K is 1e-8 of 3 K
    np.testing.assert_allclose(trace["q.u"], kelvin - 273.15, rtol=1e-7)
    np.testing.assert_allclose(trace["p.u"], 1e5 * (5 - 3 * (kelvin - 273.15)), rtol=1e-7)


@table(__file__, "loops", "wires, start, solution")
def test_small_loops(kind, wires, start, solution):
    """The solutions of their equations, of three components and of one with itself."""
    files = {name: kind.make("gain") for name in ("a", "b", "c", "out")}
    trace = run(assemble(files, [tuple(w) for w in wires], start), step=0.1, stop=0.3).trace
    for name, exact in solution.items():
        np.testing.assert_allclose(trace[f"{name}.y"], exact / 7, rtol=CLOSE)


def test_two_loops_one_behind_the_other_and_a_stage_after_them(kind):
    """The first loop drives the second, whose output goes through one more gain at the same instant."""
    files = {"s": kind.make("source"), "p": kind.make("bent"), "r": kind.make("bent")}
    files |= {name: kind.make("gain") for name in ("q", "t", "after")}
    wires = ["t.y -> after.u", "r.y -> t.u", "t.y -> r.u", "q.y -> r.w", *PAIR, "s.y -> p.w"]
    start = {"q.factor": -6.0, "r.factor": 4.0, "t.factor": 2.0, "after.factor": 0.5}
    system = assemble(files, wires, start)
    result = run(system, step=0.1, stop=1.0)
    first = -6 * result.trace["s.y"] / 7
    for name, exact in {"q.y": first, "t.y": -2 * first / 7, "after.y": -first / 7}.items():
        # values begin at 0, where the residual is compared with the largest so far
        np.testing.assert_allclose(result.trace[name], exact, rtol=0, atol=CLOSE)
    assert [stages for _, stages in output_order(system).cycles] == [(1,), (2,)]
    assert sum("algebraic loop" in note for note in result.card.notes) == 2


def test_single_precision_is_as_good_as_it_can_be(fmus3):
    """A loop through Float32: the note reports a residual at the level of their rounding."""
    files = {"p": fmus3["bent"], "w": fmus3["wide"]}
    wires = ["p.y -> w.float32_in", "w.float32_out -> p.u"]
    result = run(assemble(files, wires, {"p.factor": -2.0, "p.w": 1.0}), step=0.1, stop=1.0)
    # half a unit in the last place of a float is 6e-8; the loop makes at most 3 of it
    np.testing.assert_allclose(result.trace["p.y"], 1 / 3, rtol=2e-7)
    assert "residual at most" in result.card.notes[-1]


def test_wrong_derivatives_are_not_used(fmus3):
    """Differences are used for an FMU whose directional derivatives are NaN."""
    files = {"t": fmus3["types"], "g": fmus3["gain"]}
    system = assemble(files, ["t.real_out -> g.u", "g.y -> t.real_in"], {"g.factor": -0.25, "g.offset": 3.0})
    result = run(system, step=0.01, stop=0.1)
    np.testing.assert_allclose(result.trace["g.y"], 3.0 / 1.25, rtol=CLOSE)  # y = 3 - 0.25 y
    assert "with differences and directional derivatives" in result.card.notes[-1]


def test_loops_are_solved_in_initialisation_mode(kind):
    """Inputs and outputs are consistent before the first step."""
    system = forced(kind, 3.0, -2.0, 0.1)
    slaves = {name: open_slave(component) for name, component in system.components.items()}
    initialise(system, slaves, {}, (0.0, 1.0))
    y = slaves["p"].get("y")
    assert y == pytest.approx((7 - np.sqrt(49 - 3.2)) / 0.8, rel=CLOSE)  # y = 2 - 6 y + 0.4 y^2
    assert slaves["p"].get("u") == pytest.approx(-2 * y, rel=CLOSE)
    for slave in slaves.values():
        slave.close()


def test_a_loop_without_solution_is_named(kind):
    """One line with the connections: y = y + 1; an output that is NaN is named."""
    system = assemble({n: kind.make("gain") for n in "pq"}, PAIR, {"p.offset": 1.0})
    message = problem(lambda: run(system, **HERE), "^algebraic loop .*: no solution at t = 0 s")
    assert all(part in message for part in PAIR)
    odd = forced(kind, float("nan"), 0.5)
    problem(lambda: run(odd, **HERE), r"loop .*: no solution at t = 0 s: p\.y is nan")


def test_a_loop_that_loses_its_solution_ends_the_run(kind, both):
    """y = w + y^2 / 4 has none above w = 1: the record is kept, the message has time and residual."""
    system = forced(kind, 0.0, 1.0, 0.25).with_start({"s.offset": 0.5})
    outcome = both(system, "jacobi", stop=2.0)
    assert re.match(r"algebraic loop .*: no solution at t = 0\.6 s.*residual of", outcome.error)
    assert outcome.result.trace.time[-1] == pytest.approx(0.5)  # sin 0.5 < 0.5 < sin 0.6


def test_a_loop_that_nobody_declared_is_solved(each):
    """If copied values do not settle there is a loop, and the note reports that it was solved."""
    files = {name: each.make("gain", f"silent_{name}", undeclared=True) for name in "pq"}
    start = {"p.factor": 3.0, "p.offset": 1.0, "q.factor": -2.0}
    result = run(assemble(files, PAIR, start), step=0.1, stop=1.0)
    np.testing.assert_allclose(result.trace["p.y"], 1 / 7, rtol=CLOSE)
    assert "direct dependencies are not declared" in result.card.notes[-1]
    assert "Newton's method" in result.card.notes[-1]


def test_whole_numbers_have_no_newton_step(each, both):
    """A loop of them is refused; where no dependencies are declared they may not be in it, and are copied."""
    loop = ["a.int_out -> b.int_in", "b.int_out -> a.int_in"]
    system = assemble({name: each["types"] for name in "ab"}, loop)
    told = r"algebraic loop .*expected Real signals, .* got Integer [ab]\.int_out"
    problem(lambda: run(system, **HERE), told)
    files = {name: each.make("types", f"silent_{name}", undeclared=True) for name in "ab"}
    files["c"] = each.make("bent", "silent_c", undeclared=True)
    wires = ["a.real_out -> b.real_in", "b.real_out -> c.u", "c.y -> a.real_in", "a.int_out -> b.int_in"]
    start = {"a.gain": 3.0, "b.gain": -2.0, "c.w": 1.0, "a.int_in": 4}
    result = both(assemble(files, wires, start), "jacobi").result
    np.testing.assert_allclose(result.trace["c.y"], 1 / 7, rtol=CLOSE)
    np.testing.assert_array_equal(result.trace["b.int_out"], 6)
    assert any("not Real are read 4 times per step" in note for note in result.card.notes)


@pytest.mark.parametrize("undeclared", [False, True])
def test_fmus_called_by_python_and_by_c_agree_on_loops_of_several(each, both, undeclared):
    """Two nested loops that are not linear."""
    files = {"s": each["source"]}
    files |= {n: each.make("bent", f"{n}_{undeclared}", undeclared=undeclared) for n in "abc"}
    wires = ["a.y -> b.u", "b.y -> c.u", "c.y -> a.u", ("b.y", "a.w", -40.0), "s.y -> b.w", "a.y -> c.w"]
    start = {"a.bend": 0.3, "b.factor": 5.0, "c.factor": -3.0, "c.bend": 0.05}
    system = assemble(files, wires, start | {"s.offset": 0.5, "s.amplitude": 3.0})
    trace = both(system, "jacobi", step=0.02, stop=20.0).result.trace
    y = {n: trace[f"{n}.y"] for n in "abc"}
    np.testing.assert_allclose(y["b"], trace["s.y"] + 5 * y["a"], rtol=0, atol=1e-7)  # 1e-10 of 100
    np.testing.assert_allclose(y["a"], y["c"] + 0.3 * y["c"] ** 2 - 40 * y["b"], rtol=0, atol=1e-6)


@pytest.mark.parametrize("n", range(1, 7))
def test_linear_equations(n):
    """Exact up to rounding, also with zeros on the diagonal; a singular matrix and NaN are detected."""
    random = np.random.default_rng(n)
    matrix, right = random.normal(size=(n, n)), random.normal(size=n)
    if n > 1:
        matrix[np.arange(n), np.arange(n)] = 0.0
    factors, rows, found = matrix.copy(), np.zeros(n, np.int32), right.copy()
    assert library().loop_factorise(address(factors), address(rows), n)
    assert (np.abs(np.tril(factors, -1)) <= 1.0).all()  # the pivot is the largest number of its column
    library().loop_substitute(address(factors), address(rows), address(found), n)
    # rounding times the condition of these matrices, below 100
    np.testing.assert_allclose(matrix @ found, right, rtol=0, atol=1e-13)
    first = np.arange(n * n).reshape(n, n) == 0
    odd = (np.where(first, x, matrix) for x in (np.nan, np.inf))
    for singular in (np.full((n, n), float(n > 1)), *odd):
        assert not library().loop_factorise(address(singular), address(rows), n)
