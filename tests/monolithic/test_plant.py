"""The equations of connected components, against the same by hand, and what their FMUs are asked."""

from contextlib import closing
from itertools import pairwise

import numpy as np
import pytest
from kit.mistakes import problem, table

from orchestrator import reference
from orchestrator.base.errors import Problem
from orchestrator.base.units import LinearTransformation
from orchestrator.engine.plant import Plant, differences
from orchestrator.fmi.instance import MAX_EVENT_ITERATIONS
from orchestrator.ssp.load import assemble
from orchestrator.ssp.system import Inlet, Port


@pytest.mark.parametrize(("x0", "step"), [(0.0, 6e-6), (0.5, 6e-6), (1.25, 7.5e-6), (-4.0, 2.4e-5)])
def test_differences_are_central(x0, step):
    """Of (x - x0)^3 + 2 x the derivative is 2, and its error is the square of the step."""
    x, y, rest = np.array([7.0, x0]), np.zeros(1), np.ones(2)

    def evaluate():
        y[0] = (x[1] - x0) ** 3 + 2.0 * (x[1] - x0)

    (of_other, of_x), *zeros = differences(evaluate, (x[:1], x[1:]), (y, rest)).tolist()
    assert (of_other, zeros) == (0.0, [[0.0, 0.0]] * 2)
    assert of_x == pytest.approx(2.0 + step**2, abs=1e-14)  # rounding; the square is 4e-11 or more
    assert (x.tolist(), y.tolist()) == ([7.0, x0], [0.0])
    # the optimum for rounding of functions of magnitude 1, to 1 %
    assert pytest.approx(np.cbrt(np.finfo(float).eps), rel=1e-2) == 6e-6


@pytest.fixture
def chain(fmu):
    """g and r of an input w = (g.u - 3) / 2 = (r.u - 1) / 10; from g to p, and back to front to q."""
    fmus = {"q": fmu("lag", 3), "g": fmu("gain", 2), "room": fmu("room", 3), "p": fmu("lag", 2)}
    start = {"g.a": 2.0, "p.a": 3.0, "p.b": 5.0, "q.a": 7.0, "q.b": 11.0, "r.u": -14.0}
    wires = [("g.y", "p.u"), ("p.y", "q.u", -1.0, 4.0)]
    system = assemble(fmus | {"r": fmu("gain", 3)}, wires, start)
    w = [(Port("g", "u"), LinearTransformation(2.0, 3.0)), (Port("r", "u"), LinearTransformation(10.0, 1.0))]
    with closing(Plant(system, [Inlet("w", None, tuple(w))])) as plant:
        plant.start((1.5, 4.0))
        yield plant


def test_values_and_times_of_a_chain(chain):
    """g.y = 4 w + 6, p.y = xp + 5 g.y, q.u = 4 - p.y; w at the start follows from g.u = 0 or r.u = -14."""
    v = dict(zip(map(str, chain.inputs), range(4), strict=True))
    assert chain.u.tolist() == [-1.5]
    assert chain.v[v["r.u"]] == 10 * -1.5 + 1
    for t in (1.5, 2.5):  # the time is that of the start until another is set
        chain.settle(np.array([20.0, 0.0, 30.0]), np.array([0.5]))
        assert chain.slaves["q"].get("time") == t
        assert {n: chain.v[k] for n, k in v.items()} == {"g.u": 4.0, "p.u": 8.0, "q.u": -66.0, "r.u": 6.0}
        assert chain.f.tolist() == [7 * -66.0 - 20, 0.0, 3 * 8.0 - 30]
        assert chain.u.tolist() == [0.5]
        chain.set_time(2.5)


def test_matrices_of_a_chain(chain):
    """States of q, room and p; outputs of q, g, room, p and r; from w."""
    y = ["q.x", "q.y", "g.y", "room.T", "p.x", "p.y", "r.y"]
    assert [*map(str, chain.outputs)] == y
    # linear functions: rounding of values up to 1e3, over twice the step of the differences
    a, b = [[-1, 0, -7], [0, -1, 0], [0, 0, -1]], [[7 * -20], [0], [3 * 4]]
    c = [[1, 0, 0], [1, 0, -11], [0, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1], [0, 0, 0]]
    d = [[0], [11 * -20], [4], [0], [0], [20], [5]]
    for found, wanted in zip(chain.matrices(), (a, b, c, d), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-7)


def test_a_loop_through_components_with_states(fmu):
    """p.u = 1 - q.y and q.u = p.y: 56 p.u = 1 - xq - 11 xp; D is that of the components alone."""
    fmus = {"p": fmu("lag", 2), "room": fmu("room", 2), "q": fmu("lag", 3)}
    start = {"p.b": 5.0, "q.b": 11.0}
    system = assemble(fmus, [("p.y", "q.u"), ("q.y", "p.u", -1.0, 1.0)], start)
    with closing(Plant(system)) as plant:
        plant.start((0.0, 1.0))
        plant.settle(np.array([2.0, 0.0, 3.0]), np.zeros(0))
        u = (1 - 3 - 22) / 56
        # the tolerance of Newton's method is 1e-13
        assert plant.v == pytest.approx([u, 2 + 5 * u], rel=1e-12)
        wanted = [[0, 0], [5, 0], [0, 0], [0, 0], [0, 11]]
        np.testing.assert_allclose(plant._feedthrough(), wanted, rtol=0, atol=1e-9)
        assert plant.x.tolist() == [2.0, 0.0, 3.0]


@table(__file__, "slopes", "before, after, u")
def test_the_slope_of_a_loop_is_renewed_where_it_has_changed(fmu, before, after, u):
    """u = c - y and y = a u + b u^3, first with a = 1, then with a and b before and after a change."""
    c = u + after[0] * u + after[1] * u**3
    system = assemble({"g": fmu("gain", 2)}, [("g.y", "g.u", -1.0, c)], {"g.a": 1.0, "g.b": 0.0})
    with closing(Plant(system)) as plant:
        plant.start((0.0, 1.0))
        for parameters, solution in ((before, c / (1 + before[0])), (after, u)):
            for name, value in zip("ab", parameters, strict=True):
                plant.slaves["g"].set(name, value)
            plant.settle(np.zeros(0), np.zeros(0))
            # the tolerance of Newton's method is 1e-13
            assert plant.v == pytest.approx([solution], rel=1e-12)


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("length", [1, 2, 3, 5])
def test_the_substitutions_are_as_many_as_the_components_in_a_row(fmu, length, closed):
    """Each takes the values on by one component; a loop has no such number."""
    names = [f"g{k}" for k in range(length)][::-1]
    wires = [(f"{a}.y", f"{b}.u") for a, b in pairwise([*names, *names[:closed]])]
    with closing(Plant(assemble({n: fmu("gain", 2) for n in names}, wires))) as plant:
        assert plant._count_substitutions() == (0 if closed else length)


@pytest.mark.parametrize(
    ("given", "magnitude"),
    [(2.5, 2.5), (0.5, 0.5), (0.0, 3.0), (-1.0, 3.0), (np.nan, 3.0), (np.inf, 3.0), (None, 3.0)],
)
def test_the_magnitude_of_a_state_is_positive(chain, monkeypatch, given, magnitude):
    """That which the FMU gives, else the nominal value of its description, else 1."""

    def get(into):
        if given is None:
            raise Problem("not supported")
        into[:] = given

    for slave in chain.slaves.values():
        monkeypatch.setattr(slave, "get_nominals", get)
    room = magnitude if magnitude == given else 1.0
    assert chain.magnitudes().tolist() == [magnitude, room, magnitude]


@pytest.mark.parametrize("more", [0, 1])
def test_discrete_states_settle_in_at_most_100_iterations(chain, monkeypatch, more):
    """One more is refused; the time of the next event is that of the last iteration."""
    calls = []

    def update():
        calls.append(0)
        return len(calls) < 100 + more, False, float(len(calls))

    monkeypatch.setattr(chain.slaves["g"].fmu, "update_discrete_states", update)
    if more:
        problem(chain.event, "at most 100 event iterations, got more: the discrete states do")
    else:
        chain.event()
        assert chain.next_event == 100.0
    assert len(calls) == MAX_EVENT_ITERATIONS


def test_steps_that_ask_for_an_event_or_the_end(fmu):
    """x = 1 - exp(-t) starts again from 0 after each step beyond 0.5, at 0.69 s and 1.39 s; or it ends."""
    fmus = {"still": fmu("lag", 3), "b": fmu("lag", 2)}
    start = {"b.u": 1.0, "b.limit": 0.5}
    system = assemble(fmus, [], start)
    result = reference(system, stop=2.0, record_step=0.01)
    # times at which x would be 0, up to the error of the solver
    begins = np.unique(np.round(result.time + np.log(1 - result["b.x"]), 9))
    # steps of 5 ms at the default tolerance: an event is at most one late
    assert begins == pytest.approx([0.0, np.log(2.0), 2 * np.log(2.0)], abs=1e-2)
    assert result.card.notes[-1].endswith(", 2 events")
    for ending in ("still", "b"):
        last = {f"{ending}.u": 1.0, f"{ending}.limit": 0.5, f"{ending}.last": 1}
        result = reference(assemble(fmus, [], last), stop=2.0, record_step=0.01)
        assert result.trace.time[-1] == pytest.approx(0.69)
        assert result.card.notes[-1] == f"{ending} requested the end of the simulation"


def test_a_level_drives_a_continuous_input(fmu):
    """A Real that changes at events: y = (2 level + 1) / 2, after the event at a time."""
    fmus = {"c": fmu("counter", 2), "g": fmu("gain", 3)}
    system = assemble(fmus, [("c.level", "g.u", 2.0, 1.0)])
    assert reference(system, stop=2.0, record_step=0.5)["g.y"].tolist() == [0.5, 0.5, 1.5, 1.5, 2.5]


def test_an_indicator_without_states_is_of_the_present_input(fmu):
    """y = t, then 2 - t: off from 0.5 on, where the indicator is 0, on again from 0.25 down."""
    trace = {"time": [0.0, 1.0, 2.0], "y": [0.0, 1.0, 0.0]}
    name = "thermo2"
    options = {"record_step": 0.25, "set": {f"{name}.low": 0.25, f"{name}.high": 0.5}}
    result = reference(fmu("thermo", 2), trace, **options)
    assert result[f"{name}.on"].tolist() == [1, 1, 0, 0, 0, 0, 0, 1, 1]
    assert result.card.steps == 0
    assert result.card.step == result.card.simulated == 2.0
    # the corner at 1 s is none: inputs are continuous there
    assert result.card.notes[-1] == "monolithic solution: 0 evaluations, 0 Jacobians, 2 events"
