"""The published benchmark of a hydraulic manipulator: equations and coupled run."""

import sys
from functools import cache

import casadi as ca
import numpy as np
import pytest
import run  # of the example, see conftest.py
import steps
from arm import ARM
from fmpy.validation import validate_fmu
from hydraulics import HYDRAULICS, model
from kit.equations import Part
from kit.mistakes import table
from machine import SUBSYSTEMS, solve

from fmus.parameters import values
from orchestrator import Trace, read_trace
from orchestrator import reference as monolithic
from orchestrator import run as orchestrate
from orchestrator.data.recording import read_recording
from orchestrator.ssp.coupling import Coupling
from orchestrator.studies.convergence.convergence_study import choose


def parameters():
    return HYDRAULICS.parameters(**values(HYDRAULICS).p)


def test_hydraulic_power_balance():
    """Power from the supply = to the tank + heat + on the piston + into compression, at random states."""
    p, rng = parameters(), np.random.default_rng(1)
    for _ in range(5):
        x = HYDRAULICS.states(p_1=rng.uniform(0.2e6, 7.5e6), p_2=rng.uniform(0.2e6, 7.5e6))
        motion = {"s1": rng.uniform(0.35, 0.65), "s1_dot": rng.uniform(-0.3, 0.3), "s1_ddot": 0.0}
        u = HYDRAULICS.inputs(kappa=rng.uniform(0, 1), holding_force=8829.0, **motion)
        dx, y = model.dynamics(x, u, p), model.observe(x, u, p)
        chambers = zip(vars(x).values(), model.volumes(u.s1, p), vars(dx).values(), strict=True)
        compression = sum(pi * vi / model.bulk_modulus(pi, p) * rate for pi, vi, rate in chambers)
        received = p.supply_pressure * y.supply_flow - p.tank_pressure * y.return_flow
        used = y.dissipated_power + y.force * u.s1_dot + compression
        assert float(received) == pytest.approx(float(used), rel=1e-12)  # exact identity: rounding only


def test_published_equilibrium():
    """Holding force, pressures and valve position at the start are the published numbers."""
    p, arm = parameters(), Part(ARM)(list(values(ARM).x.values()))[1]
    motion = {n: arm[n] for n in ("s1", "s1_dot", "holding_force")}
    u = HYDRAULICS.inputs(kappa=0.45, s1_ddot=0.0, **motion)
    pressures = model.initial(None, u, p)
    kappa = float(model.observe(HYDRAULICS.states(**pressures), u, p).holding_kappa)
    found = [arm["s1"], arm["holding_force"], *pressures.values(), kappa]
    # printed with eight digits
    np.testing.assert_allclose(found, [0.5, 8829, 3170846.2, 4529153.8, 0.45434559], rtol=2e-8)


def test_the_cut_has_no_feed_through():
    """The force depends on the pressures alone, length and velocity on the arm's state alone."""
    for sub, names in ((HYDRAULICS, ["force"]), (ARM, ["s1", "s1_dot", "holding_force"])):
        part = Part(sub)
        for name in names:
            assert not ca.depends_on(part.expressions["y"][name], part.model.u), name


def test_joined_ode_follows_the_reference():
    """The equations joined into one ODE give the authors' monolithic solution of M1."""
    reference = read_recording(run.REFERENCE)
    found = solve(read_trace(run.M1), reference.time)

    # an independent Radau solution differs by 1.7e-6 m and 150 Pa: what the authors' step of 0.05 ms leaves;
    # velocity and force: of the same size relative to their range, 0.08 m/s and 6 kN
    bars = {"arm.s1": 2e-6, "hydraulics.p_1": 150, "hydraulics.p_2": 150, "arm.s1_dot": 1e-4, "arm.f_h": 12}
    for name, bar in bars.items():
        assert np.max(np.abs(found[name] - reference[name])) < bar, name


@pytest.fixture(scope="module")
def run_m1(manipulator_systems):
    """(ports, step, master) -> outcome; each run is made once."""
    systems = manipulator_systems
    return cache(lambda ports, step, master="jacobi": run.simulate(systems[ports], run.M1, step, master))


@pytest.mark.parametrize("name", SUBSYSTEMS)
def test_fmus_are_valid(manipulator_systems, name):
    """FMPy's validation finds nothing in either FMU."""
    assert validate_fmu(str(manipulator_systems["rates"].with_name(f"{name}.fmu"))) == []


@pytest.mark.parametrize("ports", ["rates", "held"])
def test_monolithic_solution_of_the_fmus_is_the_joined_ode(manipulator_systems, ports):
    """The two FMUs as one ODE follow the joined equations, so they are as close to the published solution."""
    found = monolithic(manipulator_systems[ports], run.M1, stop=10.0, record_step=0.01).trace
    expected = solve(read_trace(run.M1), found.time)
    for name in ("arm.s1", "arm.s1_dot", "arm.f_h", "hydraulics.p_1", "hydraulics.p_2"):
        # both solvers: measured 2e-12 to 1.4e-11
        assert np.abs(found[name] - expected[name]).max() < 1e-10 * np.ptp(expected[name]), name


# gauss-seidel with rate ports: test_command_line
RUNS = [("rates", "jacobi"), ("held", "jacobi"), ("held", "gauss-seidel"), ("rates", "gauss-seidel")]


@pytest.mark.parametrize(("ports", "master"), RUNS[:3])
def test_published_solution_is_met_at_1_ms(run_m1, ports, master):
    """At 1 ms s1 is within 5e-5 m and p_1, p_2 within 0.5 % of the published solution at all its samples."""
    validation = run_m1(ports, 1e-3, master).validation
    limits = {row.signal: (row.tolerance.metric, row.tolerance.limit) for row in validation.judged}
    pressures = dict.fromkeys(("hydraulics.p_1", "hydraulics.p_2"), ("maximum_relative", 0.005))
    assert limits == {"arm.s1": ("maximum", 5e-5)} | pressures
    assert all(len(row.time) == 1001 for row in validation.rows)
    assert validation.passed


def test_order_of_convergence(run_m1):
    """Halving the step halves the error of s1 with held inputs; rate ports gain a factor ten and an order."""
    held, rates = ([run_m1(p, step).error("arm.s1") for step in (1e-3, 0.5e-3)] for p in ("held", "rates"))
    # measured 1.4e-5 m and 1.1e-6 m
    assert held[0] < 2e-5
    assert rates[0] < held[0] / 10
    # orders 1 and 2 (measured 2.0 and 5.0; the fast pressures are only just resolved at 1 ms)
    assert 1.9 < held[0] / held[1] < 2.3
    assert rates[0] / rates[1] > 3.8


@pytest.mark.parametrize(("ports", "master"), RUNS[1:])
def test_stable_at_20_ms(run_m1, ports, master):
    """At 20 ms the run stays within 1 mm and 2.5 % of the joined ODE, the step response included."""
    outcome = run_m1(ports, 20e-3, master)
    assert outcome.result.complete
    # measured 5.4e-4 m and 2 %; the ramps of kappa take 20 ms instead of 1 ms and 2 ms
    assert outcome.error("arm.s1") < 1e-3
    assert all(outcome.relative(f"hydraulics.p_{n}") < 0.025 for n in (1, 2))
    # once the last ramp is 2 s old nothing swings
    late = outcome.result.trace.time > 8
    speed = outcome.result.trace["arm.s1_dot"] - outcome.truth["arm.s1_dot"]
    assert np.max(np.abs(speed[late])) < 1e-3


def by_hermite(manipulator_systems, step=None, **choices):
    """A run with rate ports: its result, and the largest error of s1 [m] from the joined ODE."""
    master = Coupling("hermite", **({} if "adaptive" in choices else {"guard": 0}), **choices)
    result = orchestrate(manipulator_systems["rates"], run.M1, master=master, step=step)
    truth = solve(read_trace(run.M1), result.trace.time)
    return result, float(np.max(np.abs(result.trace["arm.s1"] - truth["arm.s1"])))


@table(__file__, "steps", "step, bar")
def test_hermite_is_stable_at_large_steps(manipulator_systems, step, bar):
    """The authors' schemes end at 40 ms."""
    result, error = by_hermite(manipulator_systems, step)
    assert result.complete
    assert error < bar


@cache
def manoeuvre(ramp: float) -> tuple[Trace, np.ndarray]:
    """M1 with ramps of this length [s], and the truth every 10 ms."""
    kappa = 0.4543455896 + np.array([0, 0, -0.01, -0.01, 0.02, 0.02])
    given = Trace(np.array([0, 2, 2 + ramp, 6, 6 + ramp, 10.0]), {"kappa": kappa}, {"kappa": "1"})
    return given, solve(given, np.arange(1001) * 1e-2)["arm.s1"]


@table(__file__, "ramps", "ramp, step, limit")
def test_linear_prediction_is_stable_at_large_steps(manipulator_systems, ramp, step, limit):
    """Ramps of 0.2 s: micrometres at 100 ms, where the authors' schemes stop at 40 ms."""
    given, truth = manoeuvre(ramp)
    trace = orchestrate(
        manipulator_systems["rates"], given, master="interface-jacobian", step=step, stop=10.0
    ).trace
    every = round(step / 1e-2)
    assert np.max(np.abs(trace["arm.s1"] - truth[::every])) < limit


def test_all_masters_in_one_call(manipulator_systems):
    """The study of README.md: who is stable at which step, and the errors of a single run in its table."""
    settings = choose(["jacobi plain", "jacobi order 0", "hermite to tolerance"])
    found = steps.manipulator(manipulator_systems["rates"], settings, (1e-3, 0.1), repeats=1)
    stable = {(row.setting.label, row.step): row.stable for row in found.runs}
    lost = [case for case, kept in stable.items() if not kept]
    assert lost == [("jacobi order 0", 0.1)]
    held = run.simulate(manipulator_systems["held"], run.M1, 1e-3, "jacobi")
    # plain is without rate ports; the same runs but for the order in which values are summed
    largest = found.runs[0].errors["arm.s1"].metrics.maximum_error
    assert largest == pytest.approx(held.error("arm.s1"), rel=1e-6)


def test_command_line(tmp_path, monkeypatch, capsys):
    """The script builds, runs, prints the verdict, writes system, trace and picture, and exits with 0."""
    monkeypatch.setattr(sys, "argv", ["run.py", "--out", str(tmp_path)])
    assert run.main() == 0
    assert "pass: 3 of 3 signals within their limits" in capsys.readouterr().out
    assert {p.suffix for p in tmp_path.iterdir()} == {".fmu", ".ssp", ".csv", ".png"}
