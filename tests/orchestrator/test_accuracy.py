"""Runs of an accuracy that is asked for: against closed forms and the monolithic solution."""

from dataclasses import replace

import numpy as np
import pytest
from kit import shards
from kit.any_fmu.models import TELLS, Workshop, oscillator_of, telling
from kit.any_fmu.outcome import NO_ROLLBACK
from kit.mistakes import problem, table

from orchestrator import Coupling, Problem, Result, RunFailed, Trace, assemble, reference, run
from orchestrator.base.options import chosen
from orchestrator.data.trace_writer import RowLayout, TraceInMemory
from orchestrator.engine import accuracy as accuracy_search
from orchestrator.engine.job import Request
from orchestrator.engine.options import RunOptions
from orchestrator.engine.result import Card, RunEnd, SignalError
from orchestrator.engine.run import run_to_file, simulate
from orchestrator.ssp.coupling import Suggestion

SPEEDS = "manipulator.*_speed"


def accurate(system, exact, asked):
    """The card of a run whose RMS errors of both positions, over their ranges, are as asked."""
    result = run(system, stop=10.0, record_step=0.1, accuracy=asked)
    found = np.stack([result.trace["a.x"], result.trace["b.x"]], axis=1)
    mean = np.mean(np.square(found - exact(result.trace.time)), axis=0)
    assert np.max(np.sqrt(mean) / np.ptp(found, axis=0)) <= asked
    return result.card


@pytest.mark.parametrize("asked", [1e-2, 1e-4, 1e-6])
def test_an_oscillator_is_as_accurate_as_asked(open_oscillator, exact, asked):
    """An undamped oscillator keeps every error, and still the accuracy holds against the closed form."""
    assert f"accuracy {asked:g} of" in accurate(open_oscillator, exact, asked).notes[-1]


def test_steps_are_shortened_without_an_estimate(moving, exact):
    """Without directional derivatives the estimate follows from the change since the run before."""
    card = accurate(moving, exact, 1e-4)
    assert not card.errors_of_inputs
    assert " in run " in card.notes[-1]


@pytest.mark.parametrize(("able", "most"), [(True, 7200), (False, 70_500)])
def test_a_search_costs_no_more_steps_than_it_must(fmus, exact, monkeypatch, able, most):
    """Steps of the FMUs in all runs: 0.6 of those with order 2 and steps 2.6 times shorter in each run.

    These were 12 000 of FMUs with directional derivatives, and 117 500 of others.
    """
    ends = []

    def counted(job, sink):
        ends.append(simulate(job, sink))
        return ends[-1]

    monkeypatch.setattr("orchestrator.engine.run.simulate", counted)
    make = telling if able else Workshop.make
    accurate(oscillator_of(*(make(fmus, f"mass_{n}", f"{n}_{able}") for n in "ab")), exact, 1e-3)
    assert 2 * sum(end.passes + end.repeated for end in ends) <= most


def test_decisive_outputs_are_recorded_and_named(open_oscillator):
    """A selection of signals is extended by them; the note has up to four, and no number of a first run."""
    chosen = {"accuracy_of": ["a.x", "b.x"], "record": ["a.x"]}
    result = run(open_oscillator, stop=10.0, accuracy=0.1, **chosen)
    assert list(result.trace.signals) == ["a.x", "b.x"]
    note = result.card.notes[-1]
    assert note.startswith("accuracy 0.1 of a.x, b.x: estimated RMS error ")
    assert " of the range, tolerance of the FMUs " in note


JUMP = {"time": [0.0, 0.37, 0.37, 1.0], "u": [0.0, 0.0, 1.0, 1.0]}
RAMP = {"time": [0.0, 0.3, 0.7, 1.0], "u": [0.0, 0.0, 1.0, 1.0]}


@pytest.mark.parametrize(("scenario", "known"), [(JUMP, False), (RAMP, True)])
def test_a_signal_that_jumps_makes_the_accuracy_unknown(fmus, scenario, known):
    """Both runs that are compared may have the jump late by the same time; corners are no jumps."""
    system = assemble({"g": fmus["gain"], "d": fmus["drift"]}, ["g.y -> d.u"])
    given = {"g.u" if name == "u" else name: values for name, values in scenario.items()}
    note = run(system, given, stop=1.0, accuracy=1e-2, accuracy_of=["d.y"], record=["d.y"]).card.notes[-1]
    assert note.startswith("accuracy 0.01 of d.y: ")
    assert ("not known, because g.y jumps; without jumps: estimated RMS error" in note) == (not known)


def test_a_switch_makes_the_accuracy_unknown(fmus):
    """A Boolean jumps whenever it changes."""
    system = assemble({"a": fmus["types"], "b": fmus["types"]}, ["a.bool_out -> b.bool_in"])
    for flag, known in ((1, False), (0, True)):
        scenario = {"time": [0.0, 0.37, 1.0], "a.bool_in": [0, flag, flag], "a.real_in": [0.0, 0.0, 1.0]}
        note = run(system, scenario, stop=1.0, accuracy=1e-2, accuracy_of=["a.real_out"]).card.notes[-1]
        assert ("not known, because a.bool_out jumps" in note) == (not known)


NO_SLOPES = {"maxOutputDerivativeOrder": 0}
FREE = 100 / np.sqrt(1000)  # m, amplitude of a mass of 1 kg on 1000 N/m that begins at -100 m/s
OMEGA, TONE = np.sqrt(1000), 1000 * np.pi  # rad/s, of that mass, and of 500 Hz
PWM = {"height": 24e3, "period": 5e-3, "width": 1.5e-3}
PULSE = {"height": 1e5, "period": 10.0, "begin": 0.31415, "width": 0.8e-3}


def pulled(pulses, t):
    """The position of the mass: each edge of a pulse is a step of the force."""
    x = -FREE * np.sin(OMEGA * t)
    for begin in np.arange(pulses.get("begin", 0.0), t[-1], pulses["period"]):
        for edge, sign in ((begin, -1), (begin + pulses["width"], 1)):
            x += sign * pulses["height"] / 1000 * (1 - np.cos(OMEGA * np.maximum(t - edge, 0.0)))
    return x


def shaken(tone, t):
    """The same for a force amplitude * sin(omega t)."""
    amplitude = tone["amplitude"] / (TONE**2 - OMEGA**2)
    return amplitude * np.sin(TONE * t) - (FREE + amplitude * TONE / OMEGA) * np.sin(OMEGA * t)


def fed_mass(fmus, kind, model, **start):
    """A mass that is pulled by a source."""
    able = NO_SLOPES | (NO_ROLLBACK if kind == "poor" else {})
    source = fmus.make(model, f"{model}_{kind}", able=able, units={"y": "N"})
    make, tells = (telling, {TELLS[2]: "true"}) if kind == "rich" else (Workshop.make, {})
    mass = make(fmus, "mass_b", f"b_{kind}", able=able | tells)
    return assemble({"s": source, "b": mass}, ["s.y -> b.force"], {f"s.{n}": v for n, v in start.items()})


SOURCES = {
    **{"pwm": ("pulses", PWM, pulled), "pulse": ("pulses", PULSE, pulled)},
    "tone": ("source", {"amplitude": 1e5, "omega": TONE}, shaken),
}


@pytest.mark.parametrize("kind", ["rich", "plain", "poor"])
@pytest.mark.parametrize("source", SOURCES)
def test_a_source_between_points_is_not_overlooked(fmus, source, kind):
    """One whose period divides the suggested step of 1 ms, or a pulse shorter than it; jumps are told."""
    model, start, exact = SOURCES[source]
    result = run(fed_mass(fmus, kind, model, **start), stop=0.5, accuracy=1e-2, accuracy_of=["b.x"])
    note, x = result.card.notes[-1], exact(start, result.trace.time)
    assert ("not known, because s.y jumps" in note) == (kind != "rich" and source != "tone")
    if "not known" not in note:
        assert np.sqrt(np.mean(np.square(result.trace["b.x"] - x))) <= 1e-2 * np.ptp(x)


def test_a_source_that_no_step_resolves_is_told(fmus):
    """A tone of 10 kHz, where the FMUs suggest 1 ms."""
    system = fed_mass(fmus, "rich", "source", amplitude=1.0, omega=2e4 * np.pi)
    note = run(system, stop=0.1, accuracy=1e-2, accuracy_of=["b.x"]).card.notes[-1]
    assert "not known, because s.y moves between any two points; at the points: estimated" in note


def asked(system, accuracy):
    """The request of an accuracy of a.x."""
    return Request.of(system, None, RunOptions(accuracy=accuracy, accuracy_of=("a.x",)))


def looked_at(system, stop, scenario=None):
    """The search of an accuracy, and how it looks at the sources of a system."""
    options = RunOptions(accuracy=1e-2, stop=stop, isolate=False)
    search = accuracy_search.AccuracySearch(Request.of(system, scenario, options))
    return search, search.sources_alone(search.request.job())


@pytest.mark.parametrize(("stop", "step"), [(1.0, 61.80340e-6), (123.6068, 123.6068e-6), (1e4, 618.0340e-6)])
def test_sources_are_looked_at_a_million_times_at_most(fmus, stop, step):
    """Ten times in 0.618 ms, less often in a long run, and at least once."""
    _, job = looked_at(fed_mass(fmus, "plain", "pulses", **PWM), stop)
    assert list(job.system.components) == ["s"]
    assert job.times.step == pytest.approx(step, rel=1e-6)  # as printed above
    assert stop <= job.times.stop < stop + 1.01 * step


@pytest.mark.parametrize(("last", "jumps"), [(0.0, False), (0.02, False), (5.0, False)])
def test_a_stroke_that_begins_in_the_last_look_is_no_jump(last, jumps):
    """Nothing after it tells whether it goes on; a jump before it is seen."""
    values = np.array([0.0, 0.0, 0.1, 0.2, 0.2, 0.2, 0.2 + last])
    trace = Trace(np.arange(7.0), {"s.y": values})
    assert accuracy_search.jumps(trace, "s.y") is jumps
    assert accuracy_search.jumps(Trace(np.arange(7.0), {"s.y": np.where(values > 0.1, 9.0, 0.0)}), "s.y")


def test_looks_at_sources_that_are_none_and_looks_that_fail(fmus):
    """What a scenario drives is no source; after a failed look nobody knows what the source does later."""
    system = assemble({"g": fmus["gain"], "d": fmus["drift"]}, ["g.y -> d.u"])
    assert looked_at(system, 1.0)[1] is not None
    assert looked_at(system, 1.0, {"time": RAMP["time"], "g.u": RAMP["u"]})[1] is None
    search, _ = looked_at(fed_mass(fmus, "plain", "pulses", **PWM), 1.0)
    looks = TraceInMemory()
    looks.begin(RowLayout(("s.y",), {}))
    search.heed(RunEnd(0.0, problem=Problem("broke")), looks)
    assert search._sources.hidden == ["s.y"]
    with pytest.raises(KeyboardInterrupt):  # which ends the command
        search.heed(RunEnd(0.0, interrupted=True), looks)


def test_what_is_hidden_between_samples():
    """A pulse is seen by steps that are no longer, a sine by steps with a flat arc, and a ramp by any."""
    seen, n = accuracy_search.seen, np.arange(1000)
    assert 3 <= seen(np.where((n > 500) & (n <= 506), 1.0, 0.0), 60, 0.1) <= 6
    # 1 - cos(pi m / 100) = 0.2 at m = 20.5; the search shortens by a third each time
    assert 13 <= seen(np.sin(2 * np.pi * n / 100), 60, 0.1) <= 20
    assert seen(n.astype(float), 60, 1e-3) == 60
    assert seen(np.where(n == 500, 1.0, 0.0), 60, 0.1) == 1
    assert seen(np.zeros(1000), 60, 0.1) == 60


@pytest.mark.parametrize(("able", "step", "largest"), [({}, 7e-3, 0.1), (NO_SLOPES, *[0.6180340e-3] * 2)])
def test_steps_are_longer_than_suggested_only_where_slopes_are_told(fmus, able, step, largest):
    """The FMUs suggest nothing, so that it is 1 ms; else over the golden ratio."""
    rich = {TELLS[2]: "true", **able}
    system = oscillator_of(*(telling(fmus, f"mass_{n}", f"{n}_{len(able)}", able=rich) for n in "ab"))
    search = accuracy_search.AccuracySearch(asked(system, 1e-2))
    assert search.settings.step == pytest.approx(step, rel=1e-6)  # as printed above
    search._next(1.0)
    coupling = search.settings.coupling
    assert coupling.adaptive is None or coupling.largest == pytest.approx(largest, rel=1e-6)


def test_no_period_divides_both_of_two_steps(moving):
    """Their ratio is the golden one; at order 1 the change is 0.618 times the error."""
    search = accuracy_search.AccuracySearch(asked(moving, 1e-2))
    t = np.linspace(0.0, 1.0, 101)
    for k, step in enumerate((1e-3, 0.6180340e-3)):
        assert search.settings.step == pytest.approx(step, rel=1e-6)  # as printed above
        trace = Trace(t, {"a.x": t + 0.01 * (2 - k)})
        result = Result(moving, trace, Card(master="any", step=step))
        assert not search.accepts(result)
        search.choose_stricter(result)
    assert search._error == pytest.approx(0.01 / 0.6180340, rel=1e-4)  # see INSIDE


def searched(system, accuracy, *errors, adapts=True):
    """The settings of the run that follows runs with these errors, over the accuracy; None if none does."""
    search = accuracy_search.AccuracySearch(asked(system, accuracy))
    search._adapts = adapts
    for rms in accuracy * np.array(errors):
        found = {"errors": (SignalError("a.x", rms, rms, change=rms),), "errors_of_inputs": True}
        result = Result(
            system, Trace(np.zeros(1), {}), Card(master="any", step=search.settings.step, **found)
        )
        if search.accepts(result):
            return None
        search.choose_stricter(result)
    return search.settings


@table(__file__, "next_step", "asked, error, ratio")
def test_the_next_step(open_oscillator, asked, error, ratio):
    """By the order of convergence, as if nothing but the step mattered."""
    settings = searched(open_oscillator, asked, error, adapts=asked == 1e-3)  # hermite would adapt its steps
    first = {1e-3: 10e-3, 1e-4: 5e-3}[asked]  # 10 and 5 times the suggested step of 1 ms
    assert (settings.step / first if settings else 0) == pytest.approx(ratio, rel=1e-4)  # see INSIDE


def test_adaptive_steps_follow_where_equal_ones_would_be_too_short(open_oscillator):
    """At half of the accuracy beyond 50 times that error; then by the aim of 0.35, at most by half."""
    # equal steps are divided where a signal jumps, if the FMUs can go back: first by a guard of 0.5 %, then
    # by one that falls with the square of the step, 0.07^(1/3)
    for adapts, guard in ((True, 0.005 * 0.07 ** (2 / 3)), (False, None)):
        chosen = searched(open_oscillator, 1e-3, 5.0, adapts=adapts).coupling.guard
        assert chosen == (guard and pytest.approx(guard, rel=1e-5))  # see INSIDE
    assert searched(open_oscillator, 1e-2, 5.0).coupling.guard == 0.005  # the first one with that master
    for further, adaptive in (((), 5e-4), ((0.6,), 2.5e-4), ((1.4,), 1.25e-4), ((35.0,), 5e-5)):
        settings = searched(open_oscillator, 1e-3, 51.0, *further)
        assert settings.coupling.adaptive == pytest.approx(adaptive, rel=1e-4)  # see INSIDE
        assert settings.coupling.smallest == 1e-5  # a hundredth of the suggested step: the work is bounded
    # equal steps down to the suggested one: 10 ms times 0.07^(1/3); 0.00778^(2/3) would be below
    assert searched(open_oscillator, 1e-3, 5.0).step == pytest.approx(4.12128e-3, rel=1e-5)
    assert searched(open_oscillator, 1e-3, 45.0, 45.0).coupling.adaptive == pytest.approx(5e-4, rel=1e-9)
    # after equal steps by hermite, whose error falls slowly where a valve opens
    assert searched(open_oscillator, 1e-4, 0.51).coupling.adaptive == pytest.approx(5e-5, rel=1e-9)


def test_the_error_inside_the_fmus_counts(open_oscillator):
    """It is taken for half of their tolerance, if the user wants a loose one."""
    loose = RunOptions(accuracy=1e-6, accuracy_of=("a.x",), tolerance=1e-5)
    search = accuracy_search.AccuracySearch(Request.of(open_oscillator, None, loose))
    card = Card(master="any", step=search.settings.step, errors_of_inputs=True)
    result = Result(open_oscillator, Trace(np.zeros(1), {}), card)
    assert not search.accepts(result)
    search.choose_stricter(result)
    told = "accuracy 1e-06: the least error of 1 run is 5.0e-06; hermite, adaptive"
    assert search.cost(10.0).startswith(told)


def test_a_search_ends_where_further_runs_change_nothing(open_oscillator):
    """With the error that was reached, by which settings, and why it ends; the last result is not lost."""
    with pytest.raises(RunFailed) as failed:
        searched(open_oscillator, 1e-3, 10.0, 8.0, 7.0, 6.0, 5.9)
    assert str(failed.value) == (
        "accuracy 0.001: not reached: estimated RMS error 5.9e-03 of the range with hermite, adaptive steps, "
        "5e-05; further runs hardly change it"
    )
    assert failed.value.result.card.master == "any"
    assert searched(open_oscillator, 1e-3, 10.0, 8.0, 7.0, 6.0, 4.0) is not None  # two thirds are progress


@pytest.mark.parametrize(("asked", "tolerance"), [(1e-6, 3e-8), (1e-3, 3e-5), (1e-7, 1e-8), (1e-1, 1e-4)])
def test_the_solvers_of_the_fmus_are_more_accurate_than_the_run(asked, tolerance):
    """By 3 % of the accuracy, within limits."""
    assert accuracy_search.fmu_tolerance(asked) == pytest.approx(tolerance, rel=1e-12)  # one product


DETAILED = {"boom_stick": "detailed", "supply": "engine_pump"}


@pytest.mark.parametrize(
    ("asked", "variants"),
    [(1e-2, {}), *(pytest.param(*case, marks=shards.machine) for case in ((1e-4, {}), (1e-3, DETAILED)))],
)
def test_the_machine_is_as_accurate_as_asked(fmu_dir, asked, variants):
    """The RMS error of the joint speeds is below the accuracy, against the monolithic solution."""
    inputs = {"time": [0.0, 0.5, 0.8, 2.0], "boom_command": [0.0, 0.0, 4.0, 4.0]}
    case = {"swap": variants, "stop": 2.0}
    result = run(fmu_dir / "harvester.ssp", inputs, accuracy=asked, accuracy_of=[SPEEDS], **case)
    true = reference(fmu_dir / "harvester.ssp", inputs, record_step=1e-3, **case).trace
    for name in ("manipulator.boom_speed", "manipulator.stick_speed"):
        t = result.trace.time
        error = result.trace[name] - np.interp(t, true.time, true[name])
        # linear interpolation over 1 ms: (pi 11 Hz 1 ms)^2 / 2 of an 11 Hz oscillation, 6e-4 of its
        # amplitude, which is below a tenth of the range
        limit = asked * np.ptp(true[name]) + 6e-5 * np.ptp(true[name])
        assert np.sqrt(np.trapezoid(np.square(error), t) / t[-1]) <= limit


def test_an_unstable_first_run_is_repeated(open_oscillator, exact, monkeypatch):
    """A first step beyond the limit of stability is followed by shorter ones, up to so many runs."""
    monkeypatch.setattr(accuracy_search, "FIRST", ((0.0, Coupling("jacobi"), 1000),))
    assert " in run " in accurate(open_oscillator, exact, 1e-3).notes[-1]
    monkeypatch.setattr(accuracy_search, "MOST_RUNS", 1)
    monkeypatch.setattr(accuracy_search, "FIRST", ((0.0, Coupling("gauss-seidel"), 50),))
    told = r"accuracy 1e-06: not reached: .* with gauss-seidel, a step of 0.05 s; after 1 runs"
    problem(lambda: run(open_oscillator, stop=2.0, accuracy=1e-6), told)


@table(__file__, "refused", "choices, message")
def test_what_follows_from_the_accuracy_is_not_chosen(open_oscillator, choices, message):
    """Master and step together with an accuracy, wrong values and unknown outputs are refused."""
    assert problem(lambda: run(open_oscillator, stop=1.0, **choices)).startswith(message)


@table(__file__, "default", "suggested, choices, note")
def test_the_default_accuracy(fmu_dir, system, tmp_path, monkeypatch, suggested, choices, note):
    """A default applies only if neither the user nor the system chooses; an accuracy overrides the system."""
    suggestion = Suggestion(Coupling("gauss-seidel"), 1e-3) if suggested else Suggestion()
    system = replace(system, suggestion=suggestion)
    monkeypatch.setattr("orchestrator.ssp.load.load", lambda *_: system)
    out = tmp_path / "trace.csv"
    options = chosen(RunOptions, {"stop": 0.2, "isolate": False} | choices, "run")
    result, _ = run_to_file(fmu_dir / "harvester.ssp", None, out, default_accuracy=1e-3, options=options)
    assert any(n.startswith("accuracy") for n in result.card.notes) == note
    assert [p.name for p in tmp_path.iterdir() if "partial" in p.name] == []


def test_failed_runs_leave_no_file(open_oscillator, tmp_path, monkeypatch):
    """A run that fails is followed by another one; its partial file is replaced."""
    goes_on = []
    accepts = accuracy_search.AccuracySearch.accepts

    def fail_once(self, result):
        if not goes_on:
            goes_on.append(True)
            raise RunFailed(Problem("broke"), replace(result, complete=False))
        return accepts(self, result)

    monkeypatch.setattr(accuracy_search.AccuracySearch, "accepts", fail_once)
    monkeypatch.setattr("orchestrator.data.trace_writer.MAX_KEPT", 0)  # the rows are only in the file
    monkeypatch.setattr("orchestrator.ssp.load.load", lambda *_: open_oscillator)
    out = tmp_path / "trace.csv"
    options = RunOptions(stop=1.0, accuracy=1e-2, isolate=False)
    result, summary = run_to_file(tmp_path, None, out, options=options)
    assert " in run " in result.card.notes[-1]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["trace.csv", "trace.run.json"]
    assert str(out) in summary
