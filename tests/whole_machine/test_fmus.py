"""What every FMU of the machine must do, in FMPy: validate, CS = ME, rollback, derivatives, clear errors."""

from __future__ import annotations

import zipfile
from typing import Any

import casadi as ca
import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu
from kit.fmu import driving
from lxml import etree

from fmus.contract import quantities, symbolic
from fmus.machine.parts import ALL, SUBSYSTEMS
from fmus.machine.reference import trace, work_cycle
from fmus.machine.tables import variant_names
from fmus.parameters import values
from orchestrator import load

NAMES = tuple(SUBSYSTEMS)
NUMBERS = {name: values(sub) for name, sub in SUBSYSTEMS.items()}
STOP = 4.0  # s
TURN = 2 * np.pi / STOP  # rad/s


def cos(angle: Any) -> Any:
    """Of numbers or symbols."""
    return np.cos(angle) if isinstance(angle, np.ndarray | float) else ca.cos(angle)


def sin(angle: Any) -> Any:
    """Of numbers or symbols."""
    return cos(angle - np.pi / 2)


def swing_of(amplitude: float, middle: float, t: Any) -> tuple[Any, Any, Any]:
    """middle + amplitude/TURN (1 - cos(TURN t)) and its first and second derivative."""
    return (
        middle + amplitude / TURN * (1 - cos(TURN * t)),
        amplitude * sin(TURN * t),
        amplitude * TURN * cos(TURN * t),
    )


def stimulus(name: str, t: Any) -> dict[str, Any]:
    """One period of every input, both directions, with consistent positions, velocities and rates."""
    start, command = NUMBERS[name].u, 4 * sin(TURN * t)
    if name == "swing":
        _, speed, acceleration = swing_of(0.5, 0.0, t)
        return {"swing_command": command, "swing_speed": speed, "swing_acceleration": acceleration}
    if name == "boom_stick":
        signals = {"boom_command": command, "stick_command": -command}
        for a, amplitude in (("boom", 0.12), ("stick", -0.12)):
            motion = swing_of(amplitude, start[f"{a}_position"], t)
            signals |= dict(zip((f"{a}_position", f"{a}_velocity", f"{a}_acceleration"), motion, strict=True))
        return signals
    signals = {}
    for n, amplitude in (("swing_torque", 1e4), ("boom_force", 2e3), ("stick_force", -1e3)):
        push = amplitude * sin(TURN * t)
        signals |= {n: start[n] + push, f"{n}_rate": amplitude * TURN * cos(TURN * t)}
    return signals | {"payload_mass": 200 + 150 * sin(TURN * t)}


def start_values(name: str) -> dict[str, float]:
    """Values of the stimulus at the start."""
    return {n: float(v[0]) for n, v in stimulus(name, np.zeros(1)).items()}


@pytest.mark.parametrize("name", ALL)
def test_fmpy_finds_no_problem(fmu_dir, name):
    """Schema, model structure, units and names pass FMPy's validation."""
    assert validate_fmu(str(fmu_dir / f"{name}.fmu")) == []


def staircase(name: str) -> np.ndarray:
    """Steps of commands, forces and swing speed at 0.2, 1.2, 2.0 and 3.0 s, as FMPy wants them."""
    start = values(SUBSYSTEMS[name]).u
    levels = np.array([0.0, 1.0, 0.0, -1.0, 0.0])
    height = {n: 4.0 for n in start if n.endswith("command")}
    height |= {"swing": {"swing_speed": 0.3}, "manipulator": {"swing_torque": 1e4, "boom_force": 2e3}}.get(
        name, {}
    )
    corners = [0.0, *np.repeat([0.2, 1.2, 2.0, 3.0], 2), STOP]
    table = np.zeros(len(corners), dtype=[("time", float), *((n, float) for n in height)])
    table["time"] = corners
    for n, h in height.items():
        table[n] = start[n] + h * np.repeat(levels, 2)
    return table


def test_only_derivatives_of_states_say_so_in_fmi_2(fmu_dir):
    """Of every FMU: OMSimulator counts the variables with the attribute `derivative` as states.

    Rate inputs are marked by an annotation; the orchestrator knows them all the same.
    """
    paths = [*fmu_dir.glob("*.fmu"), *fmu_dir.glob("variants/*.fmu")]
    assert len(paths) == len(variant_names()) + 7  # usual parts, operator, controller, the whole machine
    for path in paths:
        with zipfile.ZipFile(path) as archive:
            root = etree.fromstring(archive.read("modelDescription.xml"))
        said = root.findall("ModelVariables/ScalarVariable/Real[@derivative]")
        assert len(said) == len(root.findall("ModelStructure/Derivatives/Unknown")), path.name
        sub = next((s for s in ALL.values() if s.name == path.stem), None)
        declared = {n: q.rate for n, q in quantities(sub.inputs).items() if q.rate} if sub else {}
        if declared:
            (component,) = load(path).components.values()
            assert component.interface.rate_inputs == declared


@pytest.mark.parametrize("name", NAMES)
def test_fmpy_runs_co_simulation_and_model_exchange_alike(fmu_dir, name):
    """simulate_fmu: CS with the FMU's own solver and ME with CVode agree to 1e-4 of range on every output.

    The inputs are staircases, because FMPy holds inputs between output points, in ME too.
    """
    step = 5e-3
    common = {"filename": str(fmu_dir / f"{name}.fmu"), "stop_time": STOP, "output_interval": step}
    cs = fmpy.simulate_fmu(fmi_type="CoSimulation", input=staircase(name), **common)
    me = fmpy.simulate_fmu(
        fmi_type="ModelExchange",
        solver="CVode",
        relative_tolerance=1e-8,
        input=staircase(name),
        **common,
    )
    last = np.searchsorted(me["time"], cs["time"] + step / 2) - 1  # ME has two rows at a step
    jump = np.isin(np.round(cs["time"], 9), [0.2, 1.2, 2.0, 3.0])  # CS recorded these before the step
    for output in cs.dtype.names[1:]:
        spread = np.ptp(me[output])
        deviation = np.max(np.abs(cs[output] - me[output][last])[~jump])
        # the bar of the issue; solvers 1e-6 and 1e-8 per step; a void of 1e-12 m3 is no signal
        assert deviation <= 1e-4 * spread + 1e-12, f"{output}: {deviation / spread:.2g} of range"


def exact_states(name: str, time: np.ndarray) -> np.ndarray:
    """States at `time` under the stimulus, by CVODES on the equations themselves."""
    sub = SUBSYSTEMS[name]
    model, v = symbolic(sub), values(sub)
    t = ca.SX.sym("t")
    moving = stimulus(name, t)
    u = [moving.get(n, ca.SX(value)) for n, value in v.u.items()]
    nominal = np.array([q.nominal for q in quantities(sub.states).values()])
    z = ca.SX.sym("z", nominal.size)
    (rate,) = ca.substitute(
        [model.dx], [model.x, model.u, model.p], [z * nominal, ca.vertcat(*u), ca.DM(list(v.p.values()))]
    )
    u0 = [start_values(name).get(n, value) for n, value in v.u.items()]
    x0 = model.initial()(list(v.x.values()), u0, list(v.p.values())).full()[:, 0]
    options = {"reltol": 1e-10, "abstol": 1e-10, "max_num_steps": 10**6}
    solver = ca.integrator("exact", "cvodes", {"x": z, "t": t, "ode": rate / nominal}, 0.0, time[1:], options)
    return np.vstack([x0, solver(x0=x0 / nominal)["xf"].full().T * nominal])


@pytest.mark.parametrize("name", NAMES)
def test_co_simulation_follows_moving_inputs(fmu_dir, name):
    """CS at 1 ms with rate ports and FMI input derivatives against CVODES on the equations: 1e-5 of range."""
    step, every = 1e-3, 50
    inputs, states = list(stimulus(name, np.zeros(1))), list(quantities(SUBSYSTEMS[name].states))
    plain = [n for n in inputs if n.endswith("command") or n == "payload_mass"]  # no rate port
    table = stimulus(name, np.arange(round(STOP / step) + 1) * step)
    slopes = np.array([np.diff(table[k]) / step for k in plain])
    found = []
    with driving(fmu_dir / f"{name}.fmu", **start_values(name)) as fmu:
        references = [fmu.references[k] for k in plain]
        for n in range(round(STOP / step)):
            if n % every == 0:
                found.append(fmu.get(*states))
            fmu.set(**{k: float(v[n]) for k, v in table.items()})
            fmu.fmu.setRealInputDerivatives(references, [1] * len(plain), slopes[:, n])
            fmu.step(step)
        found.append(fmu.get(*states))
    exact = exact_states(name, np.linspace(0, STOP, len(found)))
    deviation = np.max(np.abs(np.array(found) - exact) / np.ptp(exact, axis=0), axis=0)
    # solver 1e-6 per step; inputs bend inside a step by H^2/8 of their second derivative, 1e-6 of range
    assert np.all(deviation < 1e-5), dict(zip(states, deviation, strict=True))


@pytest.mark.parametrize("name", NAMES)
def test_compiled_equations_equal_the_python_equations(fmu_dir, name):
    """Derivatives and outputs through the ME interface are those of dynamics() and observe()."""
    sub = SUBSYSTEMS[name]
    v, model = values(sub), symbolic(sub).function()
    states, rng = list(quantities(sub.states)), np.random.default_rng(3)
    shape = stimulus(name, np.array(1.0))
    with driving(fmu_dir / f"{name}.fmu", "me", **start_values(name)) as fmu:
        x0 = fmu.get(*states)
        for _ in range(20):
            x = x0 * (1 + 0.05 * rng.standard_normal(x0.size)) + 1e-4 * rng.standard_normal(x0.size)
            u = v.u | {n: float(s) * rng.uniform(0.5, 1.5) for n, s in shape.items()}
            u = {n: v.u[n] if n.endswith("position") else value for n, value in u.items()}
            fmu.set(**u)
            fmu.fmu.setContinuousStates(_doubles(x), x.size)
            dx, y = (part.full()[:, 0] for part in model(x, list(u.values()), list(v.p.values())))
            # the same operations in another order; differences of pressures lose up to six digits
            assert np.allclose(
                fmu.get(*(f"der_{n}" for n in states)), dx, rtol=1e-9, atol=1e-9 * np.abs(dx).max()
            )
            assert np.allclose(fmu.get(*quantities(sub.outputs)), y, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_a_restored_state_repeats_the_step_bit_for_bit(fmu_dir, name):
    """Save, step, restore, step again: the same bits; also through serialised bytes in a second instance."""
    outputs = list(quantities(SUBSYSTEMS[name].outputs))
    moving = {
        n: 1.01 * v + 0.01 for n, v in start_values(name).items() if "pressure" not in n and "angle" not in n
    }
    path = fmu_dir / f"{name}.fmu"
    with driving(path, **start_values(name)) as fmu, driving(path) as other:
        fmu.set(**moving)
        fmu.step(1e-3, 20)
        state, time = fmu.fmu.getFMUState(), fmu.time
        data = fmu.fmu.serializeFMUState(state)
        first = fmu.step(1e-3, 7).get(*outputs)
        fmu.fmu.setFMUState(state)
        fmu.time = time
        again = fmu.step(1e-3, 7).get(*outputs)
        other.fmu.setFMUState(other.fmu.deSerializeFMUstate(data))
        other.time = time
        elsewhere = other.step(1e-3, 7).get(*outputs)
        fmu.fmu.freeFMUState(state)
    assert first.tobytes() == again.tobytes() == elsewhere.tobytes()


@pytest.mark.parametrize("name", NAMES)
def test_directional_derivatives_equal_central_differences(fmu_dir, name):
    """Jacobian of outputs and derivatives with respect to inputs and states, to 1e-6 relative."""
    sub = SUBSYSTEMS[name]
    states, inputs = list(quantities(sub.states)), list(quantities(sub.inputs))
    unknowns = [*(f"der_{n}" for n in states), *quantities(sub.outputs)]
    # away from rest: commands open the valves, the oil and the arm move
    moving = {n: 3.0 for n in inputs if n.endswith("command")} | {
        n: 0.05 for n in inputs if n.endswith("velocity")
    }
    extra = (
        {"initial_preload": 8e6} if name == "swing" else {}
    )  # no void: its exponential needs smaller differences
    nominal = {n: q.nominal for n, q in (quantities(sub.states) | quantities(sub.inputs)).items()}
    with driving(fmu_dir / f"{name}.fmu", **start_values(name), **extra) as cs:
        cs.set(**moving)
        x0 = cs.step(1e-3, 60).get(*states)
    with driving(fmu_dir / f"{name}.fmu", "me", **(start_values(name) | moving)) as fmu:

        def evaluate(known: str, shift: float) -> np.ndarray:
            x = x0.copy()
            u = dict(zip(inputs, base, strict=True))
            if known in states:
                x[states.index(known)] += shift
            else:
                u[known] += shift
            fmu.set(**u)
            fmu.fmu.setContinuousStates(_doubles(x), len(x))
            return fmu.get(*unknowns)

        base = fmu.get(*inputs)
        evaluate(states[0], 0.0)
        scale = np.array([nominal[n] for n in states + inputs])
        row = np.max(np.abs(fmu.derivative(unknowns, states + inputs)) * scale, axis=1)
        for known in states + inputs:
            evaluate(known, 0.0)
            exact = fmu.derivative(unknowns, [known])[:, 0]
            h = 1e-5 * nominal[known]
            # Richardson: error of order h^4; what is left is rounding, 1e-16 of larger terms over 1e-5
            one, two = ((evaluate(known, k * h) - evaluate(known, -k * h)) / (2 * k * h) for k in (1, 2))
            difference = (4 * one - two) / 3
            worst = np.abs(exact - difference) - 1e-6 * np.abs(exact) - 1e-9 * row / nominal[known]
            bad = int(np.argmax(worst))
            assert worst[bad] <= 0, (
                f"d {unknowns[bad]} / d {known}: {exact[bad]:.9g} against {difference[bad]:.9g}"
            )


def _doubles(x: np.ndarray):
    import ctypes

    return (ctypes.c_double * x.size)(*x)


@pytest.mark.parametrize(
    ("name", "signal", "rate"),
    [
        ("swing", "swing_torque", "swing_torque_rate"),
        ("boom_stick", "boom_force", "boom_force_rate"),
        ("boom_stick", "stick_force", "stick_force_rate"),
        ("manipulator", "boom_velocity", "boom_acceleration"),
        ("manipulator", "stick_velocity", "stick_acceleration"),
        ("manipulator", "swing_speed", "swing_acceleration"),
        ("manipulator", "boom_position", "boom_velocity"),
    ],
)
def test_rate_outputs_are_the_time_derivatives(fmu_dir, name, signal, rate):
    """The rate port equals the slope of its signal along the run, by central differences."""
    push = {"swing_command": 3.0, "boom_command": 3.0, "stick_command": -3.0, "swing_torque": 8e3}
    push |= {"boom_force": 1.1e5, "stick_force": -1e4}
    inputs = quantities(SUBSYSTEMS[name].inputs)
    h = 1e-5
    with driving(fmu_dir / f"{name}.fmu", **start_values(name)) as fmu:
        still = {
            n: 0.0 for n in inputs if n.endswith(("acceleration", "rate"))
        }  # inputs held from step to step
        fmu.set(**{n: v for n, v in push.items() if n in inputs}, **still)
        before = fmu.step(1e-3, 300).get(signal)[0]
        middle = fmu.step(h).get(rate)[0]
        after = fmu.step(h).get(signal)[0]
    scale = quantities(SUBSYSTEMS[name].outputs)[rate].nominal
    # difference formula: h^2/6 (600 rad/s)^2 of the rate; solver tolerance 1e-6 over 2 h
    assert (after - before) / (2 * h) == pytest.approx(middle, rel=2e-4, abs=2e-4 * scale)


@pytest.mark.parametrize(
    ("name", "start", "message"),
    [
        ("boom_stick", {"boom_bore": -0.1}, "boom_bore"),
        ("boom_stick", {"boom_dead_volume": -1e-3}, "boom_dead_volume"),
        ("boom_stick", {"boom_rod": 0.2}, "boom_rod is thinner than boom_bore"),
        ("boom_stick", {"boom_position": 3.0}, "rod chamber of the boom cylinder has a positive volume"),
        ("boom_stick", {"supply_pressure": float("nan")}, "supply_pressure"),
        ("manipulator", {"boom_closed_length": 0.3}, "boom_closed_length is above the shortest reach"),
        ("manipulator", {"stick_stroke": 2.0}, "stick_closed_length + stick_stroke is below the longest"),
        (
            "manipulator",
            {"initial_boom_angle": 2.5},
            "boom_angle keeps the pins of the boom cylinder out of line",
        ),
        (
            "manipulator",
            {"initial_boom_angle": -0.8},
            "boom_angle [rad], at the start initial_boom_angle, keeps the boom piston above its closed end",
        ),
        ("swing", {"line_capacitance": -1e-15}, "line_capacitance"),
        ("swing", {"valve_full_command": 0.5}, "valve_full_command exceeds valve_dead_band"),
        (
            "boom_stick",
            {"valve_bt_command_1": 2.0, "valve_bt_command_2": 1.0},
            "valve_bt_commands ascend by at least 0.001 V",
        ),
    ],
)
def test_impossible_values_are_refused_by_name(fmu_dir, name, start, message, capsys):
    """A negative volume, a linkage that does not close or a NaN is an error with a message."""
    with pytest.raises(FMICallException), driving(fmu_dir / f"{name}.fmu", **start):
        pass
    logged = capsys.readouterr()
    assert message in logged.out + logged.err


def test_reference_trace_is_what_the_monolith_gives():
    """The stored work cycle equals a new solution to the digits it is written with."""
    from fmus.machine.build import data
    from fmus.machine.reference import EVERY, SIGNALS

    stored = np.loadtxt(data("reference/work_cycle.csv"), delimiter=",", skiprows=1)
    time, signals = trace()
    assert np.allclose(stored[:, 0], time[::EVERY], atol=1e-12)
    for k, name in enumerate(SIGNALS):
        spread = np.ptp(signals[:, k])
        # nine digits of the largest value, and 1e-11 per step of the solver on another machine's libm
        assert np.max(np.abs(stored[:, k + 1] - signals[::EVERY, k])) <= 1e-7 * spread + 1e-12, name


def test_shipped_work_cycle_is_what_its_moves_give():
    """data/scenarios/work_cycle.csv is the list of moves in fmus/machine/work_cycle.py, nothing else."""
    from fmus.machine.build import data

    stored = np.loadtxt(data("scenarios/work_cycle.csv"), delimiter=",", skiprows=1)
    time, commands = work_cycle()
    # ten digits
    assert np.allclose(stored, np.column_stack([time, commands]), rtol=1e-9, atol=1e-9)


def test_command_beyond_the_range_is_warned_of(fmu_dir, capsys):
    """70 V, meant as percent, opens the valve like 10 V and is told once; 10 V with rounding is legal."""
    with driving(fmu_dir / "swing.fmu") as fmu:
        fmu.set(swing_command=10.0 * (1 + 1e-6), swing_command_rate=0.0)  # printed as 10 V
        assert fmu.step(1e-3, 5).get("swing_flow_a")[0] > 0
        assert "swing_command" not in capsys.readouterr().out
        fmu.set(swing_command=70.0)
        fmu.step(1e-3, 5)
    assert capsys.readouterr().out.count("swing_command = 70 V at t = 0.006 s is above 10 V") == 1
