"""FMUs for Model Exchange as components of a co-simulation, alone and beside those for Co-Simulation."""

import gc
import platform
from contextlib import closing
from functools import partial
from itertools import count
from math import exp
from time import perf_counter
from types import SimpleNamespace

import numpy as np
import pytest
from kit.mistakes import problem
from kit.needs import needs

from orchestrator import Master, assemble, load, reference, run
from orchestrator.engine.integration import Integration
from orchestrator.engine.job import open_slave
from orchestrator.engine.radau import Radau

VERSIONS = (2, 3)


def begun(fmu):
    """The component of an FMU, at the beginning of its first step."""
    (component,) = load(fmu).components.values()
    slave = open_slave(component)
    slave.setup(0.0, 10.0, None)
    slave.enter()
    slave.exit()
    return slave


def test_a_step_event_is_that_of_the_fmu(fmu):
    """x' = 1 - x; after a solver's step to x > 0.3 the FMU sets x to 0."""
    result = run(fmu("lag", 2), stop=1.0, step=0.01, set={"lag2.u": 1.0, "lag2.limit": 0.3})
    t, x = result.trace.time, result["lag2.x"]
    assert x.max() < 0.31
    assert (np.diff(x) < 0).sum() == 2  # it takes log(1 / 0.7) = 0.36 s each time
    np.testing.assert_allclose(x[t < 0.35], 1 - np.exp(-t[t < 0.35]), atol=1e-7)  # before the first event


@pytest.mark.parametrize("version", VERSIONS)
def test_an_input_is_a_cubic_inside_of_a_step(fmu, version):
    """x' = u - x with u = 1 + 2 t + 3 t^2 + 4 t^3: x = P(t) - P(0) e^-t with P = u - u' + u'' - u'''."""
    with closing(begun(fmu("lag", version))) as slave:
        slave.writer(["u"], np.ones(1))()
        orders = np.array([2.0, 6.0, 24.0])
        slave.input_derivative_writer(["u"] * 3, orders, [1, 2, 3])()
        for t, h in ((0.0, 0.25), (0.25, 0.75)):
            slave.step(t, h)
            orders[:] = [2 + 6 * 0.25 + 12 * 0.25**2, 6 + 24 * 0.25, 24]  # of the second step
            slave.input_derivative_writer(["u"] * 3, orders, [1, 2, 3])()
        end, start = 10 - 20 + 30 - 24, 1 - 2 + 6 - 24
        # the tolerance of the solver is 1e-8
        assert slave.get("x") == pytest.approx(end - start * exp(-1), abs=1e-7)
        assert slave.get("u") == pytest.approx(10.0, rel=1e-12)


def test_a_matrix_that_is_singular_to_rounding_makes_a_step_shorter():
    """x' = k (y - x), y' = k (x - y) with k = 1e20 1/s rests at x = y; in 1 + h k, the 1 is lost."""
    matrix, rest = 1e20 * np.array([[-1.0, 1.0], [1.0, -1.0]]), np.ones(2)

    class Stiff(Integration):
        def rates(self, _, x, into):
            into[:] = matrix @ x

        def jacobian(self, *arguments):
            arguments[-1][:] = matrix

    plant = SimpleNamespace(x=rest, indicator_count=0, magnitudes=lambda: rest)
    t, x, _ = Radau(Stiff(plant, 1e-6, 0.0)).toward(1.0, 0.0, rest).advance()
    assert 0.0 < t < 1.0
    np.testing.assert_array_equal(x, rest)


# ---- steps that are repeated


@pytest.mark.parametrize("version", VERSIONS)
def test_a_step_can_be_repeated(fmu, version):
    """From a saved state it has the same result, whatever the solver has learnt since."""
    with closing(begun(fmu("swing", version))) as slave:
        slave.step(0.0, 0.1)
        saved, found = slave.save(), []
        for _ in range(2):
            slave.restore(saved)
            slave.step(0.1, 0.1)
            found.append((slave.get("x"), slave.get("v")))
        assert found[0] == pytest.approx(found[1], rel=1e-8)  # the tolerance of the solver is 1e-8


def test_a_step_with_an_event_needs_the_state_of_the_fmu(fmu):
    """The ball keeps nothing but its states, but nobody knows; so masters do not repeat its steps."""
    with closing(begun(fmu("ball", 2))) as slave:
        assert not slave.interface.rollback
        saved = slave.save()
        slave.step(0.0, 0.5)  # the impact is at 0.45 s
        problem(lambda: slave.restore(saved), "expected an FMU that can save its state, to repeat a step")


@pytest.mark.parametrize("call", [3, 8, 20])
def test_an_interrupt_inside_of_the_solver_is_not_taken_for_a_step_that_failed(fmu, monkeypatch, call):
    """At evaluations of rates and of the Jacobian: after other exceptions a solver takes a shorter step."""
    with closing(begun(fmu("swing", 2))) as slave:
        settle, calls = slave._plant.settle_at, count(1)

        def interrupted(time, x):
            if next(calls) == call:
                raise KeyboardInterrupt
            settle(time, x)

        monkeypatch.setattr(slave._plant, "settle_at", interrupted)
        with pytest.raises(KeyboardInterrupt):
            slave.step(0.0, 0.5)
        assert next(calls) == call + 1


def test_a_closed_component_refuses_calls(fmu):
    """In one line; its solver would call functions that are gone."""
    slave = begun(fmu("ball", 2))
    read, write, saved = slave.reader(["h"], np.zeros(1)), slave.writer(["e"], np.zeros(1)), slave.save()
    slave.close()
    calls = [read, write, slave.save, lambda: slave.restore(saved), lambda: slave.step(0.0, 0.1)]
    calls += [lambda: slave.get("h"), lambda: slave.set("e", 1.0), lambda: slave.reader(["h"], np.zeros(1))]
    calls += [lambda: slave.get_nominals(np.zeros(2)), slave.exit]
    for call in calls:
        problem(call, "^ball2: expected an FMU that runs, got one that is closed$")


# ---- the floating-point environment


WARNING = ": the FMU changed the floating-point environment"
FUNCTIONS = ["instantiate", "initialise", "time", "calculate", "set", "events", "update", "completed"]
FUNCTIONS += ["nominals", "terminate"]


def collected(_phase, _info):
    """Some arithmetic, which other libraries do when garbage is collected."""
    return perf_counter() * 1.1


HOWS = ["round", "flush", "trap"] if platform.machine() in ("x86_64", "AMD64") else ["round"]


@needs("POSIX", "the FMU sees no environment variables of a test there")
@pytest.mark.parametrize("how", HOWS)
def test_an_fmu_changes_rounding_and_traps_for_itself_only(fmu, monkeypatch, request, how):
    """In any function: the bits of a run without it, a warning that names it, and no trap outside of it."""
    system = assemble({"lag": fmu("lag", 2), "ball": fmu("ball", 2)}, ["ball.h -> lag.u"])
    mine = Master("mine", step=lambda them, t, h: [one.step(t, h) for one in them.values()])
    options = {"stop": 0.6, "step": 0.1, "set": {"lag.limit": 0.3}, "isolate": False}
    usual = [run(system, master=master, **options) for master in ("jacobi", mine)]
    truth = reference(system, stop=0.6)
    monkeypatch.setenv("HYBRID_HOW", how)
    gc.callbacks.append(collected)
    request.addfinalizer(partial(gc.callbacks.remove, collected))
    request.addfinalizer(partial(gc.set_threshold, *gc.get_threshold()))
    gc.set_threshold(1)  # collections whenever they may be, with arithmetic in them
    # in a process of its own first, in which a trap ends this test only
    cases = [("all", "jacobi", {"isolate": True}), ("all", mine, {})]
    cases += [(function, ("jacobi", mine)[k % 2], {}) for k, function in enumerate(FUNCTIONS)]
    for where, master, more in cases:
        monkeypatch.setenv("HYBRID_WHERE", where)
        found = run(system, master=master, **options | more)
        assert found.trace == usual[master is mine].trace, where
        warned = {line.split()[0].strip(":") for line in found.card.warnings if WARNING in line}
        expected = {"all": {"lag", "ball"}, "terminate": set()}  # no row is after that
        assert warned == expected.get(where, warned & {"lag", "ball"})
        assert warned or where == "terminate"
        assert 1.0 + 2.0**-60 == 1.0
        assert np.float64(5e-324) * 1.0 != 0.0
        with np.errstate(all="ignore"):
            assert np.float64(1.0) / 0.0 == np.inf
    monkeypatch.setenv("HYBRID_WHERE", "all")
    assert reference(system, stop=0.6).trace == truth.trace


# ---- beside components in Co-Simulation


COMMAND = {"time": [0.0, 0.05], "boom_command": [0.0, 5.0], "swing_command": [0.0, 3.0]}
TIMES = {"stop": 0.05, "record_step": 5e-3}


def differences(found, truth):
    """The largest difference of each signal over its range, or if that is less, over 0.1 % of nominal."""
    names = [n for n in found.trace.signals if n in truth.trace.signals]
    assert len(names) > 40
    nominals = truth.system.nominals
    scales = {n: max(np.ptp(truth[n]), 1e-3 * (nominals.get(n) or 1.0)) for n in names}
    return {n: np.abs(found[n] - truth[n]).max() / scale for n, scale in scales.items()}


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel", "hermite"])
def test_model_exchange_has_the_coupling_error_of_co_simulation(fmu_dir, master):
    """The manipulator beside the other parts, integrated here or by the method inside its FMU, at 1 ms."""
    system = load(fmu_dir / "harvester.ssp")
    mixed = system.in_kind("ModelExchange", "manipulator")
    assert [c.interface.kind for c in mixed.components.values()].count("ModelExchange") == 1
    options = {**TIMES, "step": 1e-3, "master": master, "tolerance": 1e-10}
    found = differences(run(mixed, COMMAND, **options), run(system, COMMAND, **options))
    # errors of both solvers; those of the coupling, the same for both, are above 1e-5
    assert max(found.values()) < 1e-6, max(found, key=found.get)
