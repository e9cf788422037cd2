"""The masters on the undamped two-mass oscillator, whose exact solution is known."""

import numpy as np
import pytest
from scipy.linalg import expm

from orchestrator import Trace, assemble, run
from orchestrator.base.files import Location
from orchestrator.engine.masters import gauss_seidel_order
from orchestrator.fmi.description import FmuInterface, FmuVariable, read_interface
from orchestrator.ssp.dependencies import output_order
from orchestrator.ssp.system import Component, Connection, Port, System


def worst(result, exact):
    """Largest error of the first mass' position over its largest position."""
    truth = exact(result.trace.time)[:, 0]
    return np.abs(result.trace["a.x"] - truth).max() / np.abs(truth).max()


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
def test_held_inputs_converge_with_order_one(oscillator, exact, master):
    """Halving the communication step halves the error."""
    errors = [worst(run(oscillator, master=master, step=h, stop=2.0), exact) for h in (1e-3, 5e-4)]
    # first order; at these steps the next term of the error expansion is still felt (measured 1.04, 1.02)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(1, abs=0.15)


@pytest.mark.parametrize("interpolates", [False, True])
def test_gauss_seidel_interpolates(fmus, interpolates):
    """An integrator behind a sine has order 2 with interpolated inputs and with held mean values."""
    integrator = fmus.make("fails", f"integrator_{interpolates}", interpolates=interpolates)
    system = assemble({"sum": integrator, "sine": fmus["source"]}, ["sine.y -> sum.u"])
    errors = []
    for h in (0.02, 0.01):
        trace = run(system, master="gauss-seidel", step=h, stop=1.0).trace
        errors.append(abs(trace["sum.y"][-1] - (1 - np.cos(1.0))))
    # the trapezoidal rule; the next term of its expansion is below 2 % at these steps
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.02)


def test_feed_through_is_read_after_the_inputs_are_set(oscillator, exact):
    """At a step of 1e-2 the error is about 1; masters that read the force too early have 60."""
    # 0.94795 is the error of the scheme itself, from exact solutions of each mass over each step; the FMUs'
    # own integration error at 1/13 of a step per radian is below 1e-4 of that
    result = run(oscillator, master="jacobi", step=1e-2, stop=10.0)
    assert worst(result, exact) == pytest.approx(0.94795, rel=1e-3)


def test_jacobi_is_what_it_should_be(oscillator):
    """The result equals that of the scheme with the exact solution of each mass over a step."""
    first = expm(np.array([[0, 1, 0], [-110, 0, 100], [0, 0, 0]]) * 0.01)  # of x, v and the held position
    second = expm(np.array([[0, 1, 0], [-1000, 0, -1], [0, 0, 0]]) * 0.01)  # of x, v and the held force
    a, b, found = np.array([0.0, 100.0]), np.array([0.0, -100.0]), []
    for _ in range(201):
        found.append((a[0], b[0]))
        position, force = b[0], 100 * (b[0] - a[0])
        a, b = (first @ [*a, position])[:2], (second @ [*b, force])[:2]
    trace = run(oscillator, master="jacobi", step=0.01, stop=2.0).trace
    # the FMUs' Runge-Kutta steps are 0.008 rad long: an error of 0.008^4 / 120 per rad over 66 rad
    np.testing.assert_allclose(np.stack([trace["a.x"], trace["b.x"]], axis=1), found, rtol=0, atol=1e-6)


def test_recorded_force_belongs_to_recorded_positions(oscillator):
    """The output with feed-through is consistent with the positions at every recorded point."""
    trace = run(oscillator, step=1e-2, stop=0.1).trace
    # same numbers, same formula: a few ulp
    np.testing.assert_allclose(trace["a.force"], 100 * (trace["b.x"] - trace["a.x"]), rtol=1e-14)
    np.testing.assert_array_equal(trace["a.force"], trace["b.force"])


def test_undeclared_dependencies_still_give_the_feed_through_its_inputs(fmus, oscillator):
    """Two FMUs without declared dependencies may form a loop: outputs are read repeatedly, with a note."""
    files = {m[-1]: fmus.make(m, f"{m}_silent", undeclared=True) for m in ("mass_a", "mass_b")}
    silent = assemble(files, ["a.force -> b.force", "b.x -> a.x2"])
    result, declared = (run(s, master="jacobi", step=1e-2, stop=0.5) for s in (silent, oscillator))
    np.testing.assert_array_equal(result.trace["b.x"], declared.trace["b.x"])
    assert "direct dependencies are not declared" in result.card.notes[0]


def test_gauss_seidel_takes_feed_through_last(oscillator):
    """The component whose output needs the other's position steps after it."""
    assert gauss_seidel_order(oscillator) == ["b", "a"]


def order(wires, through=(), interpolating="", rated=()):
    """Order of components a, b, c; connection "ab" is from a to b, with feed-through if in `through`.

    rated   connections whose input has a rate port, which is connected as well
    """
    faces = {}
    for name in "abc":
        inputs = {
            f"from_{w[0]}": FmuVariable(f"from_{w[0]}", causality="input") for w in wires if w[1] == name
        }
        direct = frozenset(f"from_{w[0]}" for w in through if w[1] == name)
        faces[name] = FmuInterface(
            {"y": FmuVariable("y", causality="output")} | inputs,
            {"y": direct},
            can_interpolate_inputs=name in interpolating,
            rate_inputs={f"from_{w[0]}": f"rate_{w[0]}" for w in rated if w[1] == name},
        )
    connections = tuple(
        Connection(Port(w[0], y), Port(w[1], f"{y}_{w[0]}".replace("y_", "from_")))
        for y, chosen in (("y", wires), ("rate", rated))
        for w in chosen
    )
    return "".join(
        gauss_seidel_order(System("s", {n: Component(n, f) for n, f in faces.items()}, connections))
    )


@pytest.mark.parametrize(
    ("wires", "through", "interpolating", "expected"),
    [
        ((), (), "", "abc"),  # the given order
        (("cb", "ba"), (), "", "cba"),  # a chain from its source on
        (("ab", "ba", "ca"), (), "", "cab"),  # both wait for one when c is gone: the given order
        (("ab", "ba", "ca", "ac"), (), "", "bac"),  # the fewest waiting inputs: two of a, one of each other
        (("ba", "ca", "ab", "ac"), ("ab", "ac"), "", "abc"),  # two inputs that are held before one direct
        (("ab", "ba", "ca"), (), "a", "cba"),  # of equals the one that interpolates comes later
        (("aa", "ba"), ("aa",), "", "bac"),  # its own output is nothing to wait for
    ],
)
def test_gauss_seidel_order_by_its_rules(wires, through, interpolating, expected):
    """Fewest waiting inputs that feed through, then fewest waiting, then those that hold their inputs."""
    assert order(wires, through, interpolating) == expected


def test_an_input_with_a_rate_port_is_waited_for_last():
    """Of two components that feed each other through, the one that hears rates steps first."""
    loop = ("ab", "ba")
    assert order(loop, loop, rated=("ba",)) == "cab"  # nothing feeds c
    assert order(loop, loop, rated=("ab",)) == "cba"
    # a has two direct inputs with rates to wait for, b and c one each that they would have to hold
    assert order(("ba", "ca", "ab", "ac"), ("ba", "ca", "ab", "ac"), rated=("ba", "ca")) == "abc"


def test_stages_follow_the_feed_through(oscillator):
    """Positions are read in the first stage, the force one stage later."""
    stages = {str(port): s for port, s in output_order(oscillator).stages.items()}
    assert stages == {"a.force": (1,), "a.x": (0,), "a.v": (0,), "b.x": (0,), "b.v": (0,)}


def test_a_chain_of_gains_passes_in_one_instant(fmus):
    """Feed-through over four components takes no communication step."""
    files = {"source": fmus["source"]} | {f"g{i}": fmus["gain"] for i in range(4)}
    wires = ["g2.y -> g3.u", "g0.y -> g1.u", "g1.y -> g2.u", "source.y -> g0.u"]
    start = {f"g{i}.factor": 2.0 for i in range(4)}
    trace = run(assemble(files, wires, start), step=0.1, stop=1.0).trace
    np.testing.assert_array_equal(trace["g3.y"], 16 * trace["source.y"])  # powers of two: exact
    assert trace["g3.y"][3] != 0


@pytest.mark.parametrize("interpolates", [False, True])
def test_driven_inputs_move_inside_the_step(fmus, interpolates):
    """An integrator follows a ramp exactly, with slopes and with the mean over each step."""
    ramp = Trace(np.array([0.0, 1.0]), {"u": np.array([0.0, 1.0])})
    fmu = fmus.make("fails", f"ramped_{interpolates}", interpolates=interpolates)
    end = run(str(fmu), ramp, step=0.1).trace[f"ramped_{interpolates}.y"][-1]
    assert end == pytest.approx(0.5, abs=1e-12)  # exact for polynomials; rounding of 4000 inner steps


def test_declared_rate_inputs_take_the_slope(each):
    """`derivative` between two inputs stands in for the function that FMI 3.0 lacks; units must fit."""
    face = read_interface(Location(each["glide"]))
    assert face.rate_inputs == {"position": "velocity", "velocity": "acceleration"}
    assert face.ramp_inputs == {"velocity"}
    odd = each.make("drift", "odd_rate", units={"u_rate": "m"})
    assert read_interface(Location(odd)).ramp_inputs == set()
    ramp = Trace(np.array([0.0, 1.0]), {"u": np.array([0.0, 1.0])})
    end = run(str(each["drift"]), ramp, step=0.1).trace["drift.y"][-1]
    assert end == pytest.approx(0.5, abs=1e-12)  # exact for a ramp; rounding of 4000 inner steps


@pytest.mark.parametrize("rated", [False, True])
def test_gauss_seidel_moves_inputs_by_their_rate_inputs(each, rated):
    """Order 2 behind a sine, as with interpolation, also if the rate input is connected."""
    files = {"sum": each["drift"], "sine": each["source"], "rate": each["source"]}
    wires = ["sine.y -> sum.u", *(["rate.y -> sum.u_rate"] if rated else [])]
    units = {"rate": each.make("source", "rate_source", units={"y": "m/s"})}
    system = assemble(files | units, wires)
    errors = []
    for h in (0.02, 0.01):
        trace = run(system, master="gauss-seidel", step=h, stop=1.0).trace
        errors.append(abs(trace["sum.y"][-1] - (1 - np.cos(1.0))))
    # the trapezoidal rule; the next term of its expansion is below 2 % at these steps
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.02)


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
def test_a_driven_input_takes_its_rate_input_with_it(each, master):
    """A connection to the rate input would change the driven input, so it is removed."""
    wrong = each.make("gain", "wrong_rate", units={"y": "m/s"})
    system = assemble({"g": wrong, "sum": each["drift"]}, ["g.y -> sum.u_rate"], {"g.offset": 7.0})
    ramp = Trace(np.array([0.0, 1.0]), {"sum.u": np.array([0.0, 1.0])})
    result = run(system, ramp, master=master, step=0.1)
    assert result.trace["sum.y"][-1] == pytest.approx(0.5, abs=1e-12)  # exact for a ramp; rounding
    assert "the scenario replaces g.y -> sum.u_rate" in result.card.notes


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
def test_positions_move_at_their_velocity(each, master):
    """An input with a connected rate input starts each step at its old value."""
    system = assemble(
        {"sum": each["glide"], "mass": each["mass_b"]},
        ["mass.x -> sum.position", "mass.v -> sum.velocity"],
        {"mass.spring": 1.0},
    )
    errors = []
    for h in (0.02, 0.01):
        trace = run(system, master=master, step=h, stop=1.0).trace
        errors.append(abs(trace["sum.y"][-1] + 100 * (1 - np.cos(1.0))))  # x = -100 sin t
    order = {"jacobi": 2, "gauss-seidel": 3}[master]  # velocity held, or interpolated
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.05)


def test_parameters_of_the_run_do_not_leak_into_the_system(oscillator):
    """A second run of a system gives bit-identical results."""
    first = run(oscillator, step=1e-2, stop=0.2, set={"a.mass": 2.0})
    again, plain = (
        run(oscillator, step=1e-2, stop=0.2, set={"a.mass": 2.0}),
        run(oscillator, step=1e-2, stop=0.2),
    )
    np.testing.assert_array_equal(first.trace["a.x"], again.trace["a.x"])
    assert not np.array_equal(first.trace["a.x"], plain.trace["a.x"])
