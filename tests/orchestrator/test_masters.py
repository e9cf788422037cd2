"""The masters on the undamped two-mass oscillator, whose exact solution is known."""

import numpy as np
import pytest
from kit.any_fmu.models import oscillator_of
from kit.any_fmu.outcome import MASTERS
from kit.mistakes import problem, table

from orchestrator import Master, Problem, RunFailed, Trace, assemble, batch, run
from orchestrator.base.files import Location
from orchestrator.fmi.description import FmuVariable
from orchestrator.fmi.interface import FmuInterface, read_interface
from orchestrator.ssp.coupling import Coupling
from orchestrator.ssp.dependencies import gauss_seidel_order, output_order
from orchestrator.ssp.masters import gauss_seidel_plan
from orchestrator.ssp.system import Component, Connection, Port, System

RAMP = np.array([0.0, 1.0])  # in time and value
FOLLOWS = {  # an input -> the model
    **{"by a curve": "fails", "at its mean": "fails"},
    **{"by its rate input": "drift", "by its connected rate input": "drift"},
}


def integrator(workshop, how):
    """An FMU that integrates an input which it follows so."""
    curved = workshop.fmi == 2 and how == "by a curve"
    return workshop.make(FOLLOWS[how], f"sum_{[*FOLLOWS].index(how)}", interpolates=curved)


@pytest.mark.parametrize("how", FOLLOWS)
def test_gauss_seidel_has_order_two_behind_a_sine(each, order, how):
    """However the FMU of an integrator follows its input, also if the rate input is connected."""
    rate = each.make("source", "rate_source", units={"y": "m/s"})
    files = {"sum": integrator(each, how), "sine": each["source"], "rate": rate}
    wired = ["rate.y -> sum.u_rate"] if "connected" in how else []
    system = assemble(files, ["sine.y -> sum.u", *wired])

    def error(h):
        return abs(run(system, master="gauss-seidel", step=h, stop=1.0)["sum.y"][-1] - (1 - np.cos(1.0)))

    # the trapezoidal rule; the next term of its expansion is below 2 % at these steps
    assert order(error, 0.02) == pytest.approx(2, abs=0.02)


# in a step of two seconds the second half begins at 1 s, where the input is half of its end
@pytest.mark.parametrize(
    ("how", "stop", "choices"),
    [
        *((how, 1.0, {"step": 0.1}) for how in [*FOLLOWS][:3]),
        ("by a curve", 2.0, {"step": 2.0, "factors": {"sum": 2}}),
    ],
)
def test_driven_inputs_move_inside_the_step(each, how, stop, choices):
    """An integrator is exact for a ramp, with slopes, with the mean over each step, and by its rate input."""
    system = assemble({"sum": integrator(each, how)})
    end = run(system, Trace(stop * RAMP, {"u": stop * RAMP}), **choices).trace["sum.y"][-1]
    assert end == pytest.approx(stop**2 / 2, abs=1e-12)  # exact for polynomials; rounding of 4000 inner steps


@pytest.mark.parametrize("master", [*MASTERS, Coupling("gauss-seidel", 3)])
def test_a_factor_at_a_connection_only_scales(bounce, master):
    """A spring of a quarter of the stiffness, between two factors of 2, is the same spring, to the bit."""
    files = {name: part.source.path for name, part in bounce(True).components.items()}

    def moved(factor):
        wires = [("spring.force", "mass.force", factor, 0), ("mass.v", "spring.v", factor, 0)]
        start = {"mass.spring": 0.0, "spring.stiffness": 100.0 / factor**2}
        return run(assemble(files, wires, start), master=master, step=1e-2, stop=0.2)

    one, two = moved(1.0), moved(2.0)
    np.testing.assert_array_equal(two["mass.v"], one["mass.v"])
    np.testing.assert_array_equal(two["spring.stretch"], 2 * one["spring.stretch"])


def test_an_output_with_feed_through_is_read_after_the_positions_and_fits_them(oscillator):
    """A stage later, and its component steps last; so force and positions agree at each recorded point."""
    stages = {str(port): s for port, s in output_order(oscillator).stages.items()}
    assert stages == {"a.force": (1,), "a.x": (0,), "a.v": (0,), "b.x": (0,), "b.v": (0,)}
    assert gauss_seidel_order(oscillator) == ["b", "a"]
    trace = run(oscillator, step=1e-2, stop=0.1).trace
    # same numbers, same formula: a few ulp
    np.testing.assert_allclose(trace["a.force"], 100 * (trace["b.x"] - trace["a.x"]), rtol=1e-14)
    np.testing.assert_array_equal(trace["a.force"], trace["b.force"])


def test_undeclared_dependencies_still_give_the_feed_through_its_inputs(fmus, oscillator):
    """Two FMUs without declared dependencies may form a loop: outputs are read repeatedly, with a note."""
    silent = oscillator_of(*(fmus.make(m, f"{m}_silent", undeclared=True) for m in ("mass_a", "mass_b")))
    result, declared = (run(s, master="jacobi", step=1e-2, stop=0.5) for s in (silent, oscillator))
    np.testing.assert_array_equal(result.trace["b.x"], declared.trace["b.x"])
    assert "direct dependencies are not declared" in result.card.notes[0]


@table(__file__, "orders", "wires, through, interpolating, rated, expected")
def test_gauss_seidel_order_by_its_rules(wires, through, interpolating, rated, expected):
    """Fewest waiting inputs with feed-through but without rate, then fewest waiting, then those that hold.

    wires    "ab" is a connection from a to b, with feed-through if in `through`
    rated    connections whose input has a rate port, which is connected as well
    """
    through, rated, faces = through.split(), rated.split(), {}
    for name in "abc":
        sources = [w[0] for w in wires.split() if w[1] == name]
        faces[name] = FmuInterface(
            {
                "y": FmuVariable("y", causality="output"),
                **{f"from_{s}": FmuVariable(f"from_{s}", causality="input") for s in sources},
            },
            {"y": frozenset(f"from_{w[0]}" for w in through if w[1] == name)},
            can_interpolate_inputs=name in interpolating,
            rate_inputs={f"from_{w[0]}": f"rate_{w[0]}" for w in rated if w[1] == name},
        )
    connections = [
        *(Connection(Port(w[0], "y"), Port(w[1], f"from_{w[0]}")) for w in wires.split()),
        *(Connection(Port(w[0], "rate"), Port(w[1], f"rate_{w[0]}")) for w in rated),
    ]
    system = System("s", {n: Component(n, f) for n, f in faces.items()}, tuple(connections))
    assert "".join(gauss_seidel_order(system)) == expected


def test_a_chain_of_gains_passes_in_one_instant(fmus):
    """Feed-through over four components takes no communication step, also at the first instant."""
    files = {"source": fmus["source"]} | {f"g{i}": fmus["gain"] for i in range(4)}
    wires = ["g2.y -> g3.u", "g0.y -> g1.u", "g1.y -> g2.u", "source.y -> g0.u"]
    start = {"source.offset": 1.0} | {f"g{i}.factor": 2.0 for i in range(4)}
    trace = run(assemble(files, wires, start), step=0.1, stop=1.0).trace
    np.testing.assert_array_equal(trace["g3.y"], 16 * trace["source.y"])  # powers of two: exact
    assert trace["g3.y"][0] == 16


def test_rate_inputs_are_found_by_declaration_and_unit(each):
    """`derivative` between two inputs stands in for the function that FMI 3.0 lacks; units must fit."""
    face = read_interface(Location(each["glide"]))
    assert face.rate_inputs == {"position": "velocity", "velocity": "acceleration"}
    assert face.ramp_inputs == {"velocity"}
    odd = each.make("drift", "odd_rate", units={"u_rate": "m"})
    assert read_interface(Location(odd)).ramp_inputs == set()


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
def test_a_driven_input_takes_its_rate_input_with_it(each, master):
    """A connection to the rate input would change the driven input, so it is removed."""
    wrong = each.make("gain", "wrong_rate", units={"y": "m/s"})
    system = assemble({"g": wrong, "sum": each["drift"]}, ["g.y -> sum.u_rate"], {"g.offset": 7.0})
    result = run(system, Trace(RAMP, {"sum.u": RAMP}), master=master, step=0.1)
    assert result.trace["sum.y"][-1] == pytest.approx(0.5, abs=1e-12)  # exact for a ramp; rounding
    assert "the scenario replaces g.y -> sum.u_rate" in result.card.notes


@pytest.mark.parametrize(("master", "expected"), [("jacobi", 2), ("gauss-seidel", 3)])
def test_positions_move_at_their_velocity(each, order, master, expected):
    """An input with a connected rate input starts at its old value; the velocity is held, or interpolated."""
    files = {"sum": each["glide"], "mass": each["mass_b"]}
    wires = ["mass.x -> sum.position", "mass.v -> sum.velocity"]
    system = assemble(files, wires, {"mass.spring": 1.0})

    def error(h):
        trace = run(system, master=master, step=h, stop=1.0).trace
        return abs(trace["sum.y"][-1] + 100 * (1 - np.cos(1.0)))  # x = -100 sin t

    assert order(error, 0.02) == pytest.approx(expected, abs=0.05)


def test_parameters_of_the_run_do_not_leak_into_the_system(oscillator):
    """A second run of a system gives bit-identical results."""
    masses = {"a.mass": 2.0}, {"a.mass": 2.0}, {}
    first, again, plain = (run(oscillator, step=1e-2, stop=0.2, set=m).trace["a.x"] for m in masses)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, plain)


# ---- masters of one's own


def stepping(components, time, length):
    """All components step with the inputs that they have."""
    for component in components.values():
        component.step(time, length)


def exchanging(components, time, length):
    """Half a step, an exchange, and the other half."""
    for start in (time, time + length / 2):
        stepping(components, start, length / 2)
        components.exchange(start + length / 2)


@pytest.mark.parametrize(
    ("mine", "known", "follow", "order"),
    [
        ({"step": stepping}, "jacobi", "held", None),
        ({"plan": gauss_seidel_plan}, "gauss-seidel", "curves", 2),
    ],
)
def test_a_master_of_ones_own_is_the_known_one_bit_for_bit(oscillators, mine, known, follow, order):
    """A function that only steps gets the exchanges of jacobi; a plan runs in C, with all options."""
    masters = Master("mine", **mine), known
    own, ours = (run(oscillators(follow), master=m, order=order, step=1e-2, stop=1.0) for m in masters)
    assert own.card.master == ("mine" if order is None else "mine of order 2")
    assert own.trace == ours.trace


def test_an_exchange_within_a_function_is_that_of_the_engine(oscillators):
    """Two half steps with an exchange between them are two steps of jacobi."""
    halves = run(oscillators("held"), master=Master("halves", step=exchanging), step=1 / 64, stop=1.0)
    whole = run(oscillators("held"), master="jacobi", step=1 / 128, stop=1.0)
    for name, values in whole.trace.signals.items():
        np.testing.assert_array_equal(halves.trace[name], values[::2])


def test_a_mistake_in_a_function_is_told_with_the_rows(oscillators):
    """A problem, another exception of any kind, and a component that was not stepped, or too far."""

    def refuses(components, time, length):
        stepping(components, time, length)
        if time > 0.025:
            raise Problem(f"no step from {time:.2f} s")

    def divides(components, time, length):
        stepping(components, time, length)
        if time > 0.025:
            raise ZeroDivisionError

    def names(components, time, length):
        stepping(components, time, length)
        components.send("c")

    def forgets(components, time, length):
        components["a"].step(time, length)

    def hurries(components, time, length):
        stepping(components, time, 2 * length)

    for function, rows, text in (
        (refuses, 4, r"no step from 0\.03 s"),
        (divides, 4, r"^master mine: the function failed at t = 0\.03 s: ZeroDivisionError\(\)"),
        (names, 1, r"^master mine: the function failed at t = 0 s: KeyError\(\"no component 'c'"),
        (forgets, 1, r"^master mine: the function: expected steps of all .* to t = 0\.01 s, not of b"),
        (hurries, 1, r"^master mine: the function: expected steps of all .* to t = 0\.01 s, not of a"),
    ):
        with pytest.raises(RunFailed, match=text) as failed:
            run(oscillators(), master=Master("mine", step=function), step=1e-2, stop=1.0)
        np.testing.assert_allclose(failed.value.result.trace.time, 1e-2 * np.arange(rows), rtol=1e-12)


def test_components_refuse_calls_after_the_run(each):
    """Whatever a function has kept, in one line: a call into an FMU that is gone would end the process."""
    kept = {}

    def keeping(components, time, length):
        a, values = components["a"], np.zeros(1)
        calls = [a.reader(["x"], values), a.writer(["x2"], values)]
        kept.update(components=components, calls=calls, state=a.save())
        components.send("b")
        stepping(components, time, length)
        a.free_state(kept["state"])
        problem(a.close, "^a: close: expected to leave this to the run")

    run(oscillator_of(each["mass_a"], each["mass_b"]), master=Master("m", step=keeping), step=0.1, stop=0.2)
    components, values = kept["components"], np.zeros(1)
    a = components["a"]
    calls = [
        *kept["calls"],
        *(lambda: a.get("x"), lambda: a.set("x2", 1.0), lambda: a.step(0.2, 0.1), a.save, a.enter),
        *(lambda: a.restore(kept["state"]), lambda: a.free_state(kept["state"])),
        *(lambda: a.reader(["x"], values), lambda: a.output_derivative_reader(["x"], values)),
        *(lambda: components.send("a"), lambda: components.send("b")),
    ]
    for call in calls:
        problem(call, "^[ab]: expected an FMU that runs, got one that is closed$")
    problem(lambda: components.exchange(0.2), "^exchange: expected components that run")


def test_send_takes_all_types(each):
    """Reals with a transformation, and narrower types to wider ones: the inputs have what the outputs say."""
    sent = []

    def sending(components, time, length):
        stepping(components, time, length)
        components.send("p")
        p, q, r = components["p"].get, components["q"].get, components["r"].get
        assert q("real_in") == 0.5 * p("int_out") + 1
        assert q("int_in") == 3 * p("bool_out") - 1
        assert q("enum_in") == p("enum_out")
        assert r("real_in") == 2 * p("real_out") + 1
        sent.append((p("int_out"), p("bool_out"), p("enum_out"), p("real_out")))

    wires = [("p.int_out", "q.real_in", 0.5, 1.0), ("p.bool_out", "q.int_in", 3, -1)]
    wires += ["p.enum_out -> q.enum_in", ("p.real_out", "r.real_in", 2.0, 1.0)]
    moved = {"time": [0, 0.25, 0.5], "p.int_in": [3, 5, 5], "p.bool_in": [0, 1, 1], "p.real_in": [1, 2, 3]}
    system = assemble(dict.fromkeys("pqr", each["types"]), wires)
    run(system, {**moved, "p.enum_in": [1, 2, 2]}, master=Master("m", step=sending), step=0.25, stop=0.75)
    assert len(sent) == 3
    assert all(len({*values}) > 1 for values in zip(*sent, strict=True))


@table(__file__, "functions", "options, message")
def test_what_a_function_cannot_do_is_refused(oscillators, options, message):
    """In one line that names the option."""
    mine = Master("mine", step=stepping)
    problem(lambda: run(oscillators(), master=mine, stop=0.1, **options), f"^{message}")


def test_a_limit_names_what_keeps_the_run_in_this_process(oscillators):
    """In the words of the call."""
    told = "^time_limit: expected a run in a process of its own, got {}, which needs the calling process$"
    for options, got in (({"isolate": False}, "isolate=False"), ({"open": print}, "a function `open`")):
        problem(lambda more=options: run(oscillators(), time_limit=5.0, **more), told.format(got))


def test_a_master_of_ones_own_is_a_plan_or_a_function_and_in_no_batch(oscillators):
    """Neither and both are refused; its functions cannot be in the other processes of a batch."""
    problem(lambda: Master("mine"), r"mine: expected a function `plan` or a function `step`, got neither")
    problem(lambda: Master("mine", plan=gauss_seidel_plan, step=stepping), r"got both")
    message = "batch: expected one of the masters .*, got mine, whose functions are in the calling process"
    for mine in (Master("mine", step=stepping), Master("mine", plan=gauss_seidel_plan)):
        problem(lambda mine=mine: batch(oscillators(), {"a.mass": [1.0]}, master=mine), message)
