"""Linear models of systems whose solution is known: two masses on springs, a loop of direct feed-through."""

# ruff: noqa: ARG005  (dynamics and observe take x, u, p, whatever a toy uses)

import json

import numpy as np
import pytest
from kit import mistakes
from kit.any_fmu.edit import edited
from kit.toy import toy

from fmus.contract import quantities
from fmus.export.build import build
from fmus.parameters import Values
from orchestrator import assemble, linearize, run

# ---- a mass, a spring between two, a lag with feed-through


def ones(sub):
    """All parameters 1, all else 0."""
    p, x, u = (quantities(group) for group in (sub.parameters, sub.states, sub.inputs))
    return Values(dict.fromkeys(p, 1.0), dict.fromkeys(u, 0.0), dict.fromkeys(x, 0.0))


WAY = {"position": "m", "speed": "m/s"}
MASS = toy(
    "mass",
    p={"mass": "kg", "stiffness": "N/m", "damping": "N.s/m"},
    **{"x": WAY, "y": WAY, "u": {"force": "N", "pull": "N"}},
    f=lambda x, u, p: {
        "position": x.speed,
        "speed": (u.force + u.pull - p.stiffness * x.position - p.damping * x.speed) / p.mass,
    },
    g=lambda x, u, p: {"position": x.position, "speed": x.speed},
)
SIDES = {"force": 1, "reaction": -1}
SPRING = toy(
    "spring",
    p={"stiffness": "N/m"},
    x={},
    u={"left": "m", "right": "m"},
    y={"force": "N", "reaction": "N"},
    f=lambda x, u, p: {},
    g=lambda x, u, p: {n: sign * p.stiffness * (u.right - u.left) for n, sign in SIDES.items()},
)
LAG = toy(  # dx/dt = u - x,  y = x + gain u
    "lag",
    p={"gain": "1"},
    x={"x": "1"},
    u={"u": "1", "w": "1"},
    y={"y": "1"},
    f=lambda x, u, p: {"x": u.u + u.w - x.x},
    g=lambda x, u, p: {"y": x.x + p.gain * (u.u + u.w)},
)
OPERATOR = toy(
    "operator",
    p={"size": "N"},
    **{"x": {}, "u": {}, "y": {"pull": "N"}},
    f=lambda x, u, p: {},
    g=lambda x, u, p: {"pull": p.size},
)

# ---- two masses on springs

WIRES = [
    *("a.position -> spring.left", "b.position -> spring.right"),
    *("spring.force -> a.force", "spring.reaction -> b.force"),
]


@pytest.fixture(scope="module", params=(2, 3))
def fmus(request, once):
    """Folder with the FMUs of the toys, of either version."""

    def make(folder):
        for sub in (MASS, SPRING, LAG, OPERATOR):
            build(sub, folder, values=ones(sub), fmi=request.param)

    return once(f"linear_parts{request.param}", make)


def masses(fmus, **start):
    """Two masses of 1 kg and 1 N/m to the ground, a spring between them."""
    parts = {"a": fmus / "mass.fmu", "b": fmus / "mass.fmu", "spring": fmus / "spring.fmu"}
    return assemble(parts, WIRES, {k.replace("__", "."): v for k, v in start.items()})


def test_two_masses_have_the_modes_of_the_book(fmus):
    """In phase w = sqrt(k/m), in antiphase sqrt((k + 2 c)/m), each with the damping d/(2 m w)."""
    linear = linearize(masses(fmus, a__damping=0.1, b__damping=0.1, spring__stiffness=4.0), inputs=["a.pull"])
    told = np.array([[m.frequency, m.damping] for m in linear.modes])
    w = np.sqrt([1.0, 9.0])
    wanted = np.column_stack([w / (2 * np.pi), 0.1 / (2 * w)])
    np.testing.assert_allclose(told, wanted, rtol=1e-12)  # closed form: rounding only


def test_matrices_are_those_of_newtons_law(fmus):
    """A, B, C and D of the two masses, written by hand."""
    system = masses(fmus, a__mass=2.0, spring__stiffness=3.0)
    linear = linearize(system, inputs=["b.pull"], outputs=["a.speed", "spring.force"])
    assert [s.name for s in linear.states] == ["a.position", "a.speed", "b.position", "b.speed"]
    a = [[0, 1, 0, 0], [-2, -0.5, 1.5, 0], [0, 0, 0, 1], [3, 0, -4, -1]]
    np.testing.assert_allclose(linear.a, a, rtol=1e-15)  # sums and quotients of small whole numbers
    np.testing.assert_array_equal(linear.b, [[0], [0], [0], [1]])
    np.testing.assert_array_equal(linear.c, [[0, 1, 0, 0], [-3, 0, 3, 0]])
    np.testing.assert_array_equal(linear.d, [[0], [0]])


@pytest.mark.parametrize("gain", [0.5, -3.0])
def test_a_loop_of_direct_feedthrough_is_solved(fmus, gain):
    """Two lags in a circle, v = y2 + u, w = y1: y = (x1 + g x2 + g u) / (1 - g^2), by elimination."""
    parts = {n: fmus / "lag.fmu" for n in ("one", "two")}
    system = assemble(parts, ["two.y -> one.u", "one.y -> two.u"], {"one.gain": gain, "two.gain": gain})
    linear = linearize(system, inputs=["one.w"], outputs=["one.y", "two.y"])
    k = 1.0 / (1.0 - gain**2)
    c = k * np.array([[1.0, gain], [gain, 1.0]])
    d = k * np.array([[gain], [gain**2]])
    a = np.array([[-1.0, 0.0], [0.0, -1.0]]) + c[::-1]
    b = np.array([[1.0], [0.0]]) + d[::-1]
    for told, wanted in zip((linear.a, linear.b, linear.c, linear.d), (a, b, c, d), strict=True):
        np.testing.assert_allclose(told, wanted, rtol=1e-13, atol=1e-15)  # one small linear system: rounding


def test_a_loop_without_one_solution_is_told(fmus):
    """With gains 1 the loop says 0 = x1 + x2 + u: one line, no number."""
    parts = {n: fmus / "lag.fmu" for n in ("one", "two")}
    system = assemble(parts, ["two.y -> one.u", "one.y -> two.u"])
    assert "algebraic loop" in mistakes.problem(lambda: linearize(system, inputs=["one.w"]))


def test_wires_with_factors_scale_the_matrices(fmus):
    """A wire y -> -2 y + 1 makes x' = u - x with u = -2 x: the eigenvalue is -3, the state at rest 1/3."""
    system = assemble({"lag": fmus / "lag.fmu"}, [("lag.y", "lag.u", -2.0, 1.0)], {"lag.gain": 0.0})
    linear = linearize(system, inputs=["lag.w"], steady=True)
    assert linear.modes[0].value == pytest.approx(-3.0, rel=1e-14)  # -1 - 2
    assert linear.x0[0] == pytest.approx(1 / 3, rel=1e-10)  # Newton's method stops at 1e-11 of the terms


def test_unconnected_inputs_of_one_name_keep_their_values(fmus):
    """A pull of 6 N at mass a alone: mass b stays at rest, and each input has its own column."""
    linear = linearize(masses(fmus, a__pull=6.0))
    rates = dict(zip([s.name for s in linear.states], linear.f0, strict=True))
    assert (rates["a.speed"], rates["b.speed"]) == (6.0, 0.0)
    assert {"a.pull", "b.pull"} <= {i.name for i in linear.inputs}
    assert "pull" in {i.name for i in linearize(masses(fmus)).inputs}


def test_an_input_has_one_value(fmus):
    """One name for two masses is refused where their pulls differ: at the start, or by a scenario later."""
    told = mistakes.problem(lambda: linearize(masses(fmus, a__pull=6.0), inputs=["pull"]))
    assert told == "input pull: expected one value, got a.pull = 6, b.pull = 0; name them one by one"
    ramp = {"time": [0.0, 1.0], "a.pull": [0.0, 4.0]}
    told = mistakes.problem(lambda: linearize(masses(fmus), ramp, time=0.5, step=0.5))
    assert told == "input pull: expected one value, got a.pull = 2, b.pull = 0; name them one by one"
    linear = linearize(masses(fmus), ramp, time=0.5, step=0.5, inputs=["a.pull", "b.pull"])
    assert linear.u0.tolist() == [2.0, 0.0]


def test_a_steady_state_balances_what_pulls(fmus):
    """The masses hang where the springs balance a pull of 6 N: solved by hand, every rate zero."""
    system = masses(fmus, a__pull=6.0, spring__stiffness=1.0)
    linear = linearize(system, inputs=["b.pull"], steady=True)
    np.testing.assert_allclose(linear.x0, [4.0, 0.0, 2.0, 0.0], atol=1e-9)  # 2 a - b = 6, 2 b - a = 0
    assert np.abs(linear.f0).max() < 1e-9  # N/kg, of terms of some N


@pytest.mark.parametrize("time", [0.5, 4.0])
def test_a_time_is_that_of_a_step_to_a_millionth_of_it(fmus, time):
    """Then the point is the end of the run; else the mistake is told. The step is 0.5 s."""
    system, told = masses(fmus, a__pull=6.0, b__pull=6.0), "expected a multiple of the communication step"
    mistakes.problem(lambda: linearize(system, time=time + 0.6e-6, step=0.5), told)
    linear = linearize(system, time=time + 0.4e-6, step=0.5)
    names = [s.name for s in linear.states]
    trace = run(system, step=0.5, stop=time, record=names).trace
    np.testing.assert_array_equal(linear.x0, [trace[n][-1] for n in names])


def test_the_start_is_a_time(fmus):
    """Time 0 is the start, nothing runs; without nominal values in the FMUs all are 1."""
    system = masses(fmus, a__pull=6.0, b__pull=6.0)
    start, at = linearize(system), linearize(system, time=0.0)
    assert start.time == at.time == 0.0
    np.testing.assert_array_equal(start.x0, np.zeros(4))
    np.testing.assert_array_equal(at.f0, [0.0, 6.0, 0.0, 6.0])
    assert {s.nominal for s in start.states} == {1.0}


def test_inputs_that_an_operator_gives_are_inputs(fmus):
    """Named by the variable if no other component has it, else with it; the operator is left out."""
    parts = {n: fmus / f"{n}.fmu" for n in ("mass", "operator")}
    one = linearize(assemble(parts, ["operator.pull -> mass.pull"]))
    assert [i.name for i in one.inputs] == ["force", "pull"]
    assert [n for n in one.notes if n.endswith("inputs of the linear model or of the scenario: operator")]
    two = linearize(assemble(parts | {"other": fmus / "mass.fmu"}, ["operator.pull -> mass.pull"]))
    assert [i.name for i in two.inputs] == ["force", "pull", "mass.pull"]
    both = mistakes.problem(lambda: linearize(assemble({"m": fmus / "mass.fmu"}), inputs=["m.pull", "pull"]))
    assert both.startswith("--input m.pull and pull: expected inputs with different targets")


def test_without_directional_derivatives_differences_do_and_a_note_says_so(fmus, tmp_path):
    """The same model, whose description does not offer derivatives, differs by the error of differences."""
    no_derivatives = (r"providesDirectionalDerivatives?", "needsNothing")
    plain = edited(fmus / "mass.fmu", tmp_path / "mass.fmu", no_derivatives)
    told, exact = (linearize(assemble({"m": f}), inputs=["m.pull"]) for f in (plain, fmus / "mass.fmu"))
    np.testing.assert_allclose(told.a, exact.a, atol=1e-9)  # central differences of a linear model: rounding
    assert any("finite differences" in note for note in told.notes)
    assert not any("finite differences" in note for note in exact.notes)


def test_files_hold_the_arrays_and_the_names(fmus, tmp_path):
    """What is written reads back bit for bit, with a name for each row and each mode."""
    linear = linearize(masses(fmus), inputs=["a.pull"])
    arrays, names = linear.save(tmp_path / "linear.npz")
    with np.load(arrays) as stored:
        for name, value in zip("ABCD", (linear.a, linear.b, linear.c, linear.d), strict=True):
            np.testing.assert_array_equal(stored[name], value)
    described = json.loads(names.read_text())
    assert names.read_text().startswith('{\n "title": ')  # to read by eye: one blank for each level
    assert [s["name"] for s in described["states"]] == [s.name for s in linear.states]
    assert len(described["modes"]) == len(linear.modes) == 2


def test_python_control_takes_it(fmus):
    """The StateSpace of python-control has the same poles, and the names with _ for dots."""
    linear = linearize(masses(fmus), inputs=["a.pull"], outputs=["b.position"])
    plant = linear.to_control()
    np.testing.assert_allclose(np.sort_complex(plant.poles()), np.sort_complex(np.linalg.eigvals(linear.a)))
    assert plant.state_labels[0] == "a_position"
    assert plant.output_labels == ["b_position"]
