"""Whole runs: time, records, partial results, the accuracy card."""

import sys
from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest
from kit.mistakes import problem, table

from orchestrator import Coupling, Interrupted, Problem, Trace, run
from orchestrator.base.errors import Ended
from orchestrator.data.trace_writer import RowLayout, TraceInMemory
from orchestrator.engine import simulation_loop
from orchestrator.engine.result import Card, signal_errors
from orchestrator.engine.run import ProgressBar
from orchestrator.fmi.description import FmuVariable
from orchestrator.fmi.interface import FmuInterface
from orchestrator.fmi.messages import WARNING, Log
from orchestrator.ssp.system import Component, System


class Mock:
    """A slave in Python: y counts the steps, or rests; notes every step it takes."""

    def __init__(self, component, action, growth):
        self.name, self.interface, self.log = component.name, component.interface, Log(component.name)
        self.action, self.growth = action, growth
        self.steps, self.value, self.closed = [], 0.0, False

    def setup(self, start, stop, tolerance):
        self.span, self.tolerance = (start, stop), tolerance

    def nothing(self, *_): ...

    enter = exit = set = nothing

    def get(self, _variable):
        return self.value

    def reader(self, _variables, into):
        return lambda: into.fill(self.value)

    def writer(self, *_):
        return self.nothing

    def step(self, t, h):
        self.value += self.growth
        if self.action:
            self.action(t)
        self.steps.append((t, h))

    def close(self):
        self.closed = True


def mocked(action=None, growth=1.0, own=None, **options):
    """A run of one mock, with the tolerance `own` in its file; returns the result and the mock."""
    y = {"y": FmuVariable("y", causality="output")}
    face = FmuInterface(y, {"y": frozenset()}, {"y": frozenset()}, tolerance=own)
    component = Component("m", face)
    made = Mock(component, action, growth)
    try:
        return run(System("mock", {"m": component}), open=lambda _: made, **options), made
    finally:
        assert made.closed


def test_time_does_not_drift():
    """Point n is start + n * step in floating point, and each step is exactly the step."""
    result, mock = mocked(step=1 / 60, start=0.1, stop=0.1 + 600)
    np.testing.assert_array_equal(result.trace.time, 0.1 + np.arange(36001) * (1 / 60))
    starts, lengths = np.array(mock.steps).T
    np.testing.assert_array_equal(starts, result.trace.time[:-1])
    assert {*lengths} == {1 / 60}
    assert mock.span == (0.1, max(result.trace.time[-1], starts[-1] + lengths[-1]))


def test_time_starts_and_ends_where_it_is_told(fmus, oscillator):
    """A sine that begins at 3 s, in an FMU that checks times without tolerance; the end is a whole step."""
    trace = run(str(fmus["source"]), step=0.1, start=3.0, stop=63.0).trace
    # same argument, another library's sine: a few ulp
    np.testing.assert_allclose(trace["source.y"], np.sin(trace.time), atol=1e-15)
    result, _ = mocked(step=0.1, stop=0.25)
    np.testing.assert_array_equal(result.trace["m.y"], [0, 1, 2])
    assert result.card.notes == ("0.25 s is not a multiple of the step: the run ends at 0.2 s",)
    result = run(oscillator, start=2.0, step=0.1)  # without any stop time: one second, as in FMPy, and a note
    assert (result.trace.time[0], result.trace.time[-1]) == (2.0, 3.0)
    note = "neither the system nor its FMUs suggest a stop time: the run ends at 3 s"
    assert note in result.card.notes


@pytest.mark.parametrize("mine", [None, 1e-9])
@pytest.mark.parametrize("own", [None, 1e-4])
def test_an_fmu_solves_to_the_tolerance_asked_for_else_to_its_own(own, mine):
    """Its own is that of its DefaultExperiment; an FMU by Dymola is 3.4e-3 of its range off without."""
    assert mocked(own=own, tolerance=mine, step=0.1, stop=0.2)[1].tolerance == (mine or own)


@pytest.mark.parametrize(("reached", "last"), [(0.45, (0.45, 5)), (0.4, (0.4, 4)), (np.nan, (0.4, 4))])
@pytest.mark.parametrize("record_step", [0.1, 0.3])
def test_the_time_at_which_an_fmu_ends_the_run_is_its_last_row(reached, last, record_step):
    """With the values of then (FMI 2.0.5, 4.2.2), unless it did nothing in its last step."""

    def end(t):
        if t > 0.35:
            ended = Ended("enough")
            ended.reached = reached
            raise ended

    result, _ = mocked(end, step=0.1, stop=1.0, record_step=record_step)
    assert (result.trace.time[-1], result.trace["m.y"][-1]) == last
    before = [0.0, 0.1, 0.2, 0.3, 0.4][: last[1]] if record_step == 0.1 else [0.0, 0.3]
    np.testing.assert_allclose(result.trace.time[:-1], before)  # products of the step: rounding
    assert result.complete
    assert result.card.simulated == last[0]


@table(__file__, "wrong_options", "options, message")
def test_wrong_options_are_told(oscillator, options, message):
    """Name, expected, got."""
    assert problem(lambda: run(oscillator, isolate=False, **options)).startswith(message)


def test_the_rate_input_of_a_driven_input_has_its_slope(each):
    """Just after each communication point; without it rate outputs that depend on it are wrong."""
    drift = str(each["drift"])
    scenario = {"time": [0.5, 1.0, 1.5], "u": [0.0, 2.0, 1.0]}
    trace = run(drift, scenario, step=0.25, stop=2.0, record=["drift.u", "drift.u_rate"]).trace
    np.testing.assert_array_equal(trace["drift.u_rate"], [0, 0, 4, 4, -2, -2, 0, 0, 0])
    assert "drift.u_rate" not in run(drift, scenario, step=0.25).trace.signals  # it follows from the scenario
    given = run(drift, scenario | {"u_rate": [7.0, 7.0, 7.0]}, step=0.25).trace
    np.testing.assert_array_equal(given["drift.u_rate"], 7.0)


def test_outside_its_scenario_a_run_holds_the_first_and_last_values(fmus):
    """Notes report it, and a start value without effect; feed-through follows from the first instant on."""
    scenario = Trace(np.array([0.5, 1.0]), {"u": np.array([5.0, 6.0])})
    result = run(str(fmus["gain"]), scenario, step=0.25, stop=2.0, set={"gain.u": 7.0, "gain.factor": 2.0})
    np.testing.assert_array_equal(result.trace["gain.u"], [5, 5, 5, 5.5, 6, 6, 6, 6, 6])
    np.testing.assert_array_equal(result.trace["gain.y"], 2 * result.trace["gain.u"])
    assert result.card.notes == (
        "gain.u is driven by the scenario: the start value 7.0 has no effect",
        "the scenario begins at 0.5 s; before that time its first values are held",
        "the scenario ends at 1 s; after that time its last values are held",
    )


def test_ctrl_c_keeps_what_was_recorded():
    """KeyboardInterrupt carries the result, and the FMUs are closed."""

    def stop(t):
        if t > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted) as caught:
        mocked(stop, step=0.1, stop=1.0)
    assert len(caught.value.result.trace.time) == 7


def test_warnings_that_differ_in_numbers_only_are_merged():
    """The first stands for all, as a value that was noticed; times are no such numbers."""
    log = Log("m")
    for log.time, force in ((0.5, 2.0), (1.5, -30.5), (2.5, 4e0)):
        log.add(WARNING, f"fmi2DoStep: force = {force:g} N at t = {log.time} s is above 1 N")
    log.add(WARNING, "void = 3e-7 m3")
    log.add(WARNING, "the step was cut at t = 1.0 s")
    log.add(WARNING, "the step was cut at t = 2.0 s")
    assert log.warnings() == [
        "m: force = 2 N at t = 0.5 s is above 1 N (the first of 3)",
        "m at t = 2.5 s: void = 3e-7 m3",
        "m: the step was cut at t = 1.0 s (2 times, first at t = 2.5 s)",
    ]
    forces = np.array([0.0, -758.0, 60.0])
    record = TraceInMemory()
    record.begin(RowLayout(("m.force", "void"), {"m.force": "N"}))
    for t, force in enumerate(forces):  # rows that arrive one by one
        record.append(np.array([float(t)]), np.array([[force, force]]))
    peak, void, _ = log.warnings(record)
    assert peak.endswith("(at most 758 N at t = 1 s; the first of 3)")
    assert void == "m at t = 2.5 s: void = 3e-7 m3"  # of another component


def test_card_counts_and_times(monkeypatch, oscillator):
    """Steps, simulated time, wall time and real-time factor, with a clock that goes on by 0.25 s a look."""
    clock = count()
    times = {"perf_counter": lambda: 0.25 * next(clock), "monotonic": lambda: 0.0}
    monkeypatch.setattr(simulation_loop, "time", SimpleNamespace(**times))
    card = run(oscillator, step=1e-2, stop=1.0, isolate=False).card
    assert (card.steps, card.simulated) == (100, 1.0)
    assert (card.wall, card.real_time_factor) == (0.25, 4.0)


def estimated(nominals=None, **signals):
    """Error estimates of signals given as 'unit: amplitude', all with errors of second order."""
    time = np.linspace(0, 1, 11)
    sizes = {name: float(text.split()[1]) for name, text in signals.items()}
    units = {name: text.split()[0] for name, text in signals.items()}
    runs = (Trace(time, {n: a * time * (1 + h**2 / 1e3) for n, a in sizes.items()}, units) for h in (1, 2, 4))
    return signal_errors(*runs, nominals)


def test_signals_that_stand_still_have_no_error():
    """Below 1e-6 of the nominal value; without one, below 1e-9 of the widest signal in the same unit."""
    kept = estimated({"p": 1e7, "q": 1e7}, p="Pa 11", q="Pa 9", a="rad 1", b="rad 1e-10", c="rad 1e-8")
    assert [e.name for e in kept] == ["p", "a", "c"]
    assert estimated(a="rad 1e-30") == ()


def test_the_estimate_tells_the_worst_of_each_unit():
    """A small signal with a large share does not hide another unit; change in the unit, share, order."""
    card = Card(master="jacobi", step=1e-3, errors=estimated(a="rad 1", b="rad 2", v="m3 1e-7"))
    assert [(e.name, e.unit) for e in card.worst] == [("b", "rad"), ("v", "m3")]
    # change from h = 2 to h = 1: 1e-3 (4 - 1) of the amplitude 2 rad
    assert card.worst[0].change == pytest.approx(6e-3, rel=1e-9)
    assert card.worst[0].order == pytest.approx(2, abs=1e-9)  # rounding only
    assert card.text().splitlines()[-2].split() == ["b", "6.00e-03", "rad", "3.0e-03", "2.00"]


def test_without_an_estimate_the_run_is_complete():
    """A note reports why there is none: a system at rest, or a failure at half the step."""

    def fail(t):
        if t == 0.25:
            raise Problem("m: too small a step")

    for action, growth, note in (
        (None, 0.0, "no error estimate: no output changes"),
        (fail, 1.0, "no error estimate, the run at half the step failed: m: too small a step"),
    ):
        result, _ = mocked(action, growth, step=0.5, stop=2.0, error_estimate=True)
        assert (result.complete, len(result.trace.time), result.card.errors) == (True, 5, ())
        assert result.card.notes == (note,)


def test_progress_shows_on_long_runs_only(monkeypatch, capsys, oscillator):
    """There is no output before the delay, and a bar on stderr after it."""

    def shown():
        run(oscillator, step=0.01, stop=10.0, progress=True)
        return capsys.readouterr().err

    assert shown() == ""
    monkeypatch.setattr(ProgressBar, "delay", 0.0)
    assert shown() == ""  # not a terminal
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert "10 s simulated" in shown()


def test_options_in_a_coupling_and_in_the_call(oscillator):
    """What only the call has is added to a `Coupling`, whose other settings stay."""
    settings = run(oscillator, step=0.1, stop=1.0, master=Coupling("jacobi", 2), guard=1e-2).coupling.settings
    assert settings == Coupling("jacobi", 2, guard=1e-2).settings


@pytest.mark.parametrize(
    ("given", "option", "value", "got"),
    [
        (Coupling("hermite", tolerance=0.1), "coupling_tolerance", 0.2, "0.2 and Coupling(tolerance=0.1)"),
        (Coupling("jacobi", 2), "order", 3, "3 and Coupling(order=2)"),
    ],
)
def test_an_option_is_given_once(oscillator, given, option, value, got):
    """Where a coupling and the call have it, none of them wins in silence."""
    told = problem(lambda: run(oscillator, step=0.1, stop=1.0, master=given, **{option: value}))
    assert told == f"{option}: expected one value, got {got}"
