"""The monolithic solution of systems of FMUs: events, algebraic loops, mixed versions, the machine."""

from contextlib import nullcontext
from itertools import product
from math import exp, inf, log, nan, sqrt

import numpy as np
import pytest
from kit import shards
from kit.any_fmu.description import packed
from kit.any_fmu.edit import edited
from kit.any_fmu.models import oscillation, oscillator_of
from kit.mistakes import problem, table
from kit.ssp import ssd, system, wire
from scipy.integrate import solve_ivp

from benchmarks import monolithic
from orchestrator import Coupling, Result, RunFailed, Trace, assemble, load, reference, run, write_ssp
from orchestrator.base.errors import Problem
from orchestrator.engine import refinement
from orchestrator.engine.refinement import estimated_error
from orchestrator.engine.result import Card, SignalError
from orchestrator.engine.run import co_simulate
from orchestrator.fmi.interface import FmuInterface
from orchestrator.monolithic import reference as solving
from orchestrator.monolithic.reference import BOUND, first_step, master, tightened
from orchestrator.ssp.system import Component, System

VERSIONS = (2, 3)
MIXED = list(product(VERSIONS, VERSIONS))


@pytest.mark.parametrize("implementation", ["", 'implementation="ModelExchange"'])
def test_an_ssp_may_ask_for_model_exchange(fmu, tmp_path, implementation):
    """A thermostat whose truth is mapped to its contrary: the cold room is heated for ever, or never."""
    for target, right in (("true", lambda t: 1 - np.exp(-t)), ("false", np.zeros_like)):
        entries = "".join(f'<ssc:MapEntry source="{on}" target="{target}"/>' for on in ("false", "true"))
        table = f"<ssc:BooleanMappingTransformation>{entries}</ssc:BooleanMappingTransformation>"
        parts = "".join(
            f"""<ssd:Component name="{name}" source="{name}.fmu" {implementation}><ssd:Connectors>
<ssd:Connector name="on" kind="{kind}"/></ssd:Connectors></ssd:Component>"""
            for name, kind in (("t", "output"), ("r", "input"))
        )
        files = {"SystemStructure.ssd": ssd(system([parts], [wire("t.on", "r.on", table)]), "")}
        files |= {"t.fmu": fmu("thermo", 2).read_bytes(), "r.fmu": fmu("room", 2).read_bytes()}
        result = reference(packed(tmp_path / f"{target}.ssp", files), stop=1.0, record_step=0.25)
        # errors of the solver
        np.testing.assert_allclose(result["r.T"], right(result.trace.time), atol=1e-11)


def test_a_system_of_model_exchange_alone_is_read_as_it_was_written(fmu, tmp_path):
    """The file asks for Model Exchange, as the FMUs have nothing else; the run is the same."""
    pair = assemble({"t": fmu("thermo", 2), "r": fmu("room", 2)}, ["t.on -> r.on"])
    again = load(write_ssp(pair, tmp_path / "again.ssp"))
    assert {c.interface.kind for c in again.components.values()} == {"ModelExchange"}
    results = [run(s, step=0.1, stop=1.0) for s in (pair, again)]
    assert results[0].trace == results[1].trace


# both solvers: the error of the one as a co-simulation is that of its tolerance, 1e-8
WAYS = [(reference, 20.0, {"record_step": 0.1}, 1e-9), (run, 5.0, {"step": 0.05}, 1e-7)]


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize(("solve", "stop", "steps", "error"), WAYS)
def test_an_oscillator_that_is_not_linear_is_that_of_another_solver(fmu, version, solve, stop, steps, error):
    """Van der Pol's from (2, 0), in one piece or in steps, against an explicit Runge-Kutta method."""
    result = solve(fmu("swing", version), stop=stop, **steps)
    tight = {"method": "DOP853", "t_eval": result.time, "rtol": 1e-13, "atol": 1e-14}
    exact = solve_ivp(lambda _, x: [x[1], (1 - x[0] ** 2) * x[1] - x[0]], (0.0, stop), [2.0, 0.0], **tight).y
    found = [result[f"swing{version}.{name}"] for name in ("x", "v")]
    np.testing.assert_allclose(found, exact, rtol=0, atol=error)


def height(t: float, e: float = 0.7, g: float = 9.81, slowest: float = 0.7 * 0.01) -> float:
    """Height of the ball at t, from flight to flight; it rests when it leaves slower than `slowest`."""
    begin, h, v = 0.0, 1.0, 0.0
    while True:
        flight = (v + sqrt(v * v + 2 * g * h)) / g
        if begin + flight > t:
            return h + v * (t - begin) - g * (t - begin) ** 2 / 2
        begin, h, v = begin + flight, 0.0, e * (g * flight - v)
        if v < slowest:
            return 0.0


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize(
    ("solve", "options"), [(reference, {"record_step": 0.01, "tolerance": 1e-11}), (run, {"step": 0.05})]
)
def test_a_ball_bounces_at_the_right_times(fmu, version, solve, options):
    """Until it rests after 19 impacts, several in one step, the height is that of the closed form."""
    result = solve(fmu("ball", version), stop=3.0, **options)
    exact = [height(t) for t in result.time]
    # an event time is off by 1e-11 s; flights are parabolas, which the methods solve up to their tolerance
    assert np.abs(result[f"ball{version}.h"] - exact).max() < 1e-9
    assert result[f"ball{version}.h"][-1] == result[f"ball{version}.v"][-1] == 0.0
    assert solve is run or "19 events" in result.card.notes[-1]


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize(
    ("solve", "options"), [(reference, {"record_step": 0.5}), (run, {"step": 0.3}), (run, {"step": 0.5})]
)
def test_a_time_event_is_at_its_time_and_may_end_the_simulation(fmu, version, solve, options):
    """Inside of a step, at its end, and at the end of the run; a recorded point has the value after it."""
    name = f"counter{version}"
    result = solve(fmu("counter", version), stop=9.0, set={f"{name}.last": 3}, **options)
    assert result[f"{name}.count"].tolist() == np.floor(result.trace.time + 1e-9).tolist()
    assert result.trace.time[-1] == 3.0
    ends = {reference: "requested the end of the simulation"}
    assert ends.get(solve, "the FMU requests the end of the simulation at t = 3 s") in result.card.notes[-1]
    assert name in result.card.notes[-1]


@pytest.mark.parametrize(("of_room", "of_thermo"), MIXED)
def test_discrete_signals_reach_other_fmus_in_event_mode(fmu, of_room, of_thermo):
    """A thermostat heats a room: T rises to 0.6, then moves between 0.4 and 0.6 on exponentials."""
    fmus = {"room": fmu("room", of_room), "thermo": fmu("thermo", of_thermo)}
    system = assemble(fmus, ["room.T -> thermo.y", "thermo.on -> room.on"])
    result = reference(system, stop=3.0, record_step=0.01)
    first, half = -log(0.4), log(1.5)

    def exact(t: float) -> float:
        s = (t - first) % (2 * half)
        if t < first:
            return 1 - exp(-t)
        return 0.6 * exp(-s) if s < half else 1 - 0.6 * exp(half - s)

    # the thermostat switches 1e-9 beside its thresholds
    assert np.abs(result["room.T"] - [exact(t) for t in result.trace.time]).max() < 1e-8


@pytest.mark.parametrize(("of_a", "of_b"), MIXED)
@pytest.mark.parametrize(("gain", "cubic"), [(-0.25, 0.0), (1.0, 0.0), (3.0, 0.0), (3.0, 0.3)])
def test_a_loop_is_solved(fmu, of_a, of_b, gain, cubic):
    """u = 1 - 2 (a u + b u^3): from a gain of 1 on repeated substitution would diverge."""
    fmus = {"a": fmu("gain", of_a), "b": fmu("gain", of_b), "ball": fmu("ball", 2)}
    wires = [("a.y", "b.u"), ("b.y", "a.u", -1.0, 1.0)]
    start = {"a.a": gain, "a.b": cubic, "b.a": 2.0}
    u = reference(assemble(fmus, wires, start), stop=1.0, record_step=0.5)["a.u"]
    assert u == pytest.approx(1 - 2 * (gain * u + cubic * u**3), rel=1e-12)


def test_a_loop_without_solution_is_told(fmu):
    """u = u + 1."""
    fmus = {"a": fmu("gain", 2), "ball": fmu("ball", 2)}
    system = assemble(fmus, [("a.y", "a.u", 1.0, 1.0)], {"a.a": 1.0})
    problem(lambda: reference(system, stop=1.0), "loop")


@table(__file__, "refused", "options, message")
def test_an_option_out_of_range_is_refused(fmu, options, message):
    """Before anything is loaded; a tolerance below rounding, or so large that the result is no reference."""
    problem(lambda: reference(fmu("ball", 2), **options), message)


# ---- the machine


OTHERS = {"boom_stick": "quasistatic", "manipulator": "friction", "supply": "engine_pump"}


@pytest.mark.parametrize(
    ("variants", "stop"),
    [({}, 1.0), *(pytest.param(variants, 2.0, marks=shards.machine) for variants in ({}, OTHERS))],
)
def test_the_fmus_solve_the_equations(fmu_dir, variants, stop):
    """Against the joined equations and CVODES of CasADi, and a co-simulation with its own error estimate."""
    found = monolithic.compared(fmu_dir / "harvester.ssp", variants, stop=stop)
    # measured 1e-9 to 8e-9, in rates that have peaks when a cavity closes
    assert found.equations.largest < monolithic.EQUAL, found.equations
    # measured 1.0 to 1.62; `benchmarks.monolithic` prints all combinations
    assert found.ratio < monolithic.WITHIN, found.cosimulation


# ---- FMUs for co-simulation only

CO_SIMULATION = ("<ModelExchange.*?</ModelExchange>", "")


def test_an_fmu_for_co_simulation_only_is_co_simulated(fmu_dir, tmp_path):
    """The card says so, and its estimates of the errors hold against the monolithic solution."""
    fmu = edited(fmu_dir / "manipulator.fmu", tmp_path / "manipulator.fmu", CO_SIMULATION)
    options = {"stop": 1.0, "record_step": 5e-3}
    truth = reference(fmu_dir / "harvester.ssp", monolithic.STROKES, **options)
    result = reference(fmu_dir / "harvester.ssp", monolithic.STROKES, swap={"manipulator": fmu}, **options)
    note = result.card.notes[-1]
    told = "no monolithic solution, but a co-simulation with a small step: estimated RMS error"
    assert note.startswith(told)
    assert note.endswith(f"{fmu}: expected an FMU for model exchange, got one for co-simulation only")
    found = monolithic.differences(truth, result.trace)
    estimates = {e.name: estimated_error(e) for e in result.card.errors}
    assert len(estimates) > 50
    assert max(estimates.values()) <= BOUND
    for name, error in found.items():
        if name in estimates:
            # the estimate is not a bound; 1e-9: errors of the solvers
            assert error.rms < 2 * estimates[name] + 1e-9, name


def test_an_fmu_that_hides_its_states_is_co_simulated(fmu_dir, tmp_path):
    """Its states cannot be set by name, so that nothing else remains."""
    fmu = edited(fmu_dir / "manipulator.fmu", tmp_path / "manipulator.fmu", (r' derivative="\d+"', ""))
    note = reference(fmu, stop=0.02).card.notes[-1]
    assert note.startswith("no monolithic solution, but a co-simulation with a small step")
    assert "that lists all continuous states and their derivatives" in note


def test_without_a_common_interface_it_is_a_co_simulation_of_both(fmu_dir, tmp_path):
    """One FMU for Co-Simulation only, one for Model Exchange only; a note names the first."""
    swing = edited(fmu_dir / "swing.fmu", tmp_path / "swing.fmu", CO_SIMULATION)
    exchange = ("<CoSimulation.*?</CoSimulation>", "")
    supply = edited(fmu_dir / "supply.fmu", tmp_path / "supply.fmu", exchange)
    swap = {"swing": swing, "supply": supply}
    note = reference(fmu_dir / "harvester.ssp", swap=swap, stop=0.005, record_step=0.005).card.notes[-1]
    assert f"{swing}: expected an FMU for model exchange, got one for co-simulation only" in note


# ---- The tight co-simulation: its steps, its choice among the runs, the estimate of the error

SYSTEM = System("s", {"a": Component("a", FmuInterface({}))})


@table(__file__, "first_steps", "record_step, suggested, steps")
def test_the_first_step_divides_the_record_step(record_step, suggested, steps):
    """By the smallest whole number for which it exceeds neither the suggestion nor 1 ms."""
    assert first_step(record_step, suggested) == record_step / steps


def test_the_guard_gets_stricter_with_the_square_of_the_step():
    """From 1e-6 on; a quarter of the step has a sixteenth. Passes end at a thousandth of the bound 1e-6."""
    assert master(1.0) == Coupling("hermite", guard=1e-6, tolerance=1e-9)
    assert master(0.25).guard == 1e-6 / 16


@pytest.mark.parametrize(
    ("order", "factor"),
    [(None, 2), (0.5, 2), (1.0, 2), (2.0, 4 / 3), (3.0, 8 / 7), (4.0, 16 / 15), (6.0, 16 / 15)],
)
def test_the_error_follows_from_the_change_by_its_order(order, factor):
    """2^p / (2^p - 1) times the change, p from 1 to 4, the order of the master."""
    assert estimated_error(SignalError("y", 1.0, 0.3, order)) == pytest.approx(0.3 * factor, rel=1e-15)
    assert estimated_error(SignalError("y", 1.0, nan, order)) == inf


def outcome(step, steps):
    """The result of a run with a step and a number of steps."""
    card = Card(master="hermite", step=step, record_step=0.1, steps=steps, simulated=1.0, wall=0.1)
    return Result(SYSTEM, Trace(np.zeros(1), {}), card)


@table(__file__, "best_runs", "errors, bound, best, tried")
def test_the_best_run_is_taken(monkeypatch, errors, bound, best, tried):
    """Until the estimate meets the bound or hardly falls; each run is compared with those beside it."""
    steps, compared = [], []

    def changes(*runs):
        compared.append([None if r is None else r.card.step for r in runs])
        return tuple(SignalError("y", 1.0, e / 2) for e in errors[len(compared) - 1 :][:1])

    def co_simulated(step, coupling):
        assert coupling == master(step / 0.25)
        steps.append(step)
        return outcome(step, 1)

    monkeypatch.setattr(refinement, "changes", changes)
    result = tightened(co_simulated, 0.25, bound, "because")
    assert steps == [0.25 * 0.5**k for k in range(tried)]
    assert compared == [[*h] for h in zip([None, *steps], steps, steps[1:], strict=False)]
    assert result.card.step == 0.25 * 0.5**best
    expected = [inf if e != e else e for e in errors[best:][:1]]
    assert [estimated_error(e) for e in result.card.errors] == expected


@pytest.mark.parametrize(
    ("steps", "runs"),
    [([100_000, 300_000], 3), ([100_001, 300_000], 2), ([333_333], 2), ([333_334], 1), ([], 19)],
)
def test_all_runs_together_have_at_most_a_million_steps(monkeypatch, steps, runs):
    """The next has twice as many as the last. Those that fail at the start count 1, 2, 4 ... up to 2^18."""
    done, errors = [], iter([1.0, 0.1, 0.01, 0.001])

    def co_simulated(step, _):
        done.append(step)
        assert len(done) < 100
        if not steps:
            raise RunFailed(Problem("no solution"), outcome(step, 0))
        return outcome(step, [*steps, 10**6][len(done) - 1])

    monkeypatch.setattr(refinement, "changes", lambda *_: (SignalError("y", 1.0, next(errors)),))
    with nullcontext() if steps else pytest.raises(RunFailed, match="no solution"):
        tightened(co_simulated, 1.0, 0.0, "because")
    assert len(done) == runs


def test_first_steps_may_fail_and_a_run_may_have_no_estimate():
    """Without a run at half the step the card says so, with the reason for the co-simulation."""

    def co_simulated(step, _):
        if step != 0.25:
            raise RunFailed(Problem("diverged"), outcome(step, 1))
        return outcome(step, 4)

    card = tightened(co_simulated, 1.0, 1e-5, "because").card
    assert card.step == 0.25
    assert "no estimate of its error" in card.notes[-1]
    assert card.notes[-1].endswith("reason: because")


def test_its_error_is_what_it_says(fmus):
    """Two masses without Model Exchange against their closed form: 4e-8 and 4e-7, estimated to 1 %."""
    result = solving.reference(oscillator_of(fmus["mass_a"], fmus["mass_b"]), record_step=0.01)
    truth = oscillation(result.time)
    for name, k in (("a.x", 0), ("b.x", 1)):
        rms = float(np.sqrt(np.mean((result[name] - truth[:, k]) ** 2)))
        claimed = next(estimated_error(e) for e in result.card.errors if e.name == name)
        assert claimed == pytest.approx(rms / np.ptp(truth[:, k]), rel=0.01)
        assert claimed < 1e-6


def test_the_solvers_in_the_fmus_get_a_tight_tolerance(fmus, monkeypatch):
    """1e-10, a ten-thousandth of the smallest bound; the steps divide the record step."""
    given = []

    def noted(request):
        given.append(request.options)
        return co_simulate(request)

    monkeypatch.setattr(solving, "co_simulate", noted)
    ramp = {"time": [0.0, 1.0], "u": [0.0, 1.0]}
    result = solving.reference(fmus["gain"], ramp, record_step=0.1, set={"gain.factor": 2.0})
    assert [g.step for g in given] == [0.1 / 100, 0.1 / 200]
    assert {(g.tolerance, g.record_step) for g in given} == {(1e-10, 0.1)}
    assert result["gain.y"] == pytest.approx(2.0 * result.time, abs=1e-12)  # rounding
