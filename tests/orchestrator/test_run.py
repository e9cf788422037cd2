"""Whole runs: time, records, partial results, the accuracy card."""

import time

import numpy as np
import pytest

from orchestrator import Interrupted, Problem, RunFailed, Trace, assemble, progress, run
from orchestrator.interface import Interface, Variable
from orchestrator.log import Log
from orchestrator.system import Component, System


class Mock:
    """A slave in Python: y counts the steps; notes every step it takes."""

    def __init__(self, component, action=None):
        self.name, self.interface, self.log = component.name, component.interface, Log(component.name)
        self.steps, self.value, self.action, self.closed = [], 0.0, action, False

    def setup(self, start, stop, _tolerance):
        self.span = (start, stop)

    def enter(self): ...

    def exit(self): ...

    def set(self, *_): ...

    def get(self, _variable):
        return self.value

    def reader(self, _variables, into):
        def read():
            into[:] = self.value

        return read

    def writer(self, *_):
        return lambda: None

    def step(self, t, h):
        if self.action:
            self.action(t)
        self.steps.append((t, h))
        self.value += 1.0

    def close(self):
        self.closed = True


def mocked(action=None, **options):
    """A run of one mock; returns the result and the mock."""
    face = Interface({"y": Variable("y", causality="output")}, {"y": frozenset()}, {"y": frozenset()})
    system = System("mock", {"m": Component("m", face)})
    made = []

    def make(component):
        made.append(Mock(component, action))
        return made[-1]

    try:
        return run(system, open=make, **options), made[-1]
    finally:
        assert made[-1].closed


def test_time_does_not_drift():
    """Point n is start + n * step in floating point, and each step ends exactly where the next one begins."""
    result, mock = mocked(step=1 / 60, start=0.1, stop=0.1 + 600)
    np.testing.assert_array_equal(result.trace.time, 0.1 + np.arange(36001) * (1 / 60))
    starts, lengths = np.array(mock.steps).T
    np.testing.assert_array_equal(starts, result.trace.time[:-1])
    np.testing.assert_array_equal(starts + lengths, result.trace.time[1:])
    assert mock.span == (0.1, result.trace.time[-1])


def test_time_starts_where_it_is_told(fmus):
    """A sine that begins at 3 s; the FMU checks times without tolerance."""
    trace = run(str(fmus["source"]), step=0.1, start=3.0, stop=63.0).trace
    # same argument, another library's sine: a few ulp
    np.testing.assert_allclose(trace["source.y"], np.sin(trace.time), atol=1e-15)


def test_a_time_that_is_no_multiple_of_the_step_is_told():
    """The run ends at the last whole step."""
    result, _ = mocked(step=0.1, stop=0.25)
    np.testing.assert_array_equal(result.trace["m.y"], [0, 1, 2])
    assert result.card.notes == ("0.25 s is no multiple of the step: the run ends at 0.2 s",)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"step": 0.0, "stop": 1.0}, r"step: expected a positive time, got 0 s"),
        ({"step": 2.0, "stop": 1.0}, r"step: expected at most the time from 0 to 1 s, got 2 s"),
        ({"step": 0.1, "stop": -1.0}, r"stop time: expected more than the start time 0 s, got -1 s"),
        ({"step": 0.1}, r"no stop time"),
        ({"step": 0.1, "stop": float("inf")}, r"stop time: expected a finite time, got inf s"),
        ({"start": float("nan"), "stop": 1.0}, r"start time: expected a finite time, got nan s"),
        ({"step": 0.1, "stop": 1.0, "master": "jakobi"}, r"unknown master 'jakobi', expected one of jacobi"),
        ({"step": 0.1, "stop": 1.0, "record": ["a.q"]}, r"unknown variable 'a.q'"),
    ],
)
def test_wrong_options_are_told(oscillator, options, message):
    """Name, expected, got."""
    with pytest.raises(Problem, match=message):
        run(oscillator, **options)


def test_outputs_exist_at_the_first_instant(fmus):
    """Also behind feed-through, and with the scenario's first value."""
    level = Trace(np.array([0.0, 1.0]), {"u": np.array([5.0, 5.0])})
    trace = run(str(fmus["gain"]), level, step=0.5, set={"gain.factor": 2.0}).trace
    np.testing.assert_array_equal(trace["gain.y"], [10.0, 10.0, 10.0])


def test_outputs_exist_at_the_first_instant_in_a_chain(fmus):
    """Initialisation passes values through several components."""
    files = {"s": fmus["source"], "p": fmus["gain"], "q": fmus["gain"]}
    system = assemble(
        files, ["p.y -> q.u", "s.y -> p.u"], {"s.offset": 1.0, "p.factor": 2.0, "q.factor": 3.0}
    )
    assert run(system, step=0.5, stop=1.0).trace["q.y"][0] == 6.0


def test_chosen_signals_are_recorded_in_order(oscillator):
    """Also parameters and inputs."""
    trace = run(oscillator, step=0.01, stop=0.02, record=["b.force", "a.mass", "a.x"]).trace
    assert list(trace.signals) == ["b.force", "a.mass", "a.x"]
    np.testing.assert_array_equal(trace["a.mass"], 1.0)


def test_a_run_longer_than_its_scenario_holds_the_last_values(fmus):
    """And says so."""
    scenario = Trace(np.array([0.5, 1.0]), {"u": np.array([5.0, 6.0])})
    result = run(str(fmus["gain"]), scenario, step=0.25, stop=2.0)
    np.testing.assert_array_equal(result.trace["gain.u"], [5, 5, 5, 5.5, 6, 6, 6, 6, 6])
    assert result.card.notes == (
        "the scenario begins at 0.5 s; until there its first values are held",
        "the scenario ends at 1 s; after that its last values are held",
    )


@pytest.mark.parametrize("how", [2, 3, 4])
def test_a_failure_keeps_what_was_recorded(fmus, how):
    """Discard, error and fatal in the middle of a run."""
    system = assemble({"s": fmus["source"], "bad": fmus["fails"]}, ["s.y -> bad.u"])
    with pytest.raises(RunFailed, match=r"bad: the step failed at t = 0.5 s") as caught:
        run(system, step=0.1, stop=1.0, set={"bad.when": 0.45, "bad.how": how})
    result = caught.value.result
    np.testing.assert_allclose(result.trace.time, np.arange(6) * 0.1)
    assert not result.complete
    assert result.card.steps == 5


def test_not_a_number_ends_the_run(fmus):
    """An FMU that says OK but returns NaN is named, with signal and time."""
    with pytest.raises(RunFailed, match=r"fails.y: expected a finite value, got nan at t = 0.4 s") as caught:
        run(str(fmus["fails"]), step=0.1, stop=1.0, set={"fails.when": 0.25, "fails.how": 5})
    trace = caught.value.result.trace
    np.testing.assert_allclose(trace.time, np.arange(4) * 0.1)  # up to the last point with numbers
    assert np.isfinite(trace["fails.y"]).all()


def test_ctrl_c_keeps_what_was_recorded():
    """KeyboardInterrupt carries the result, and the FMUs are closed."""

    def stop(t):
        if t > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted) as caught:
        mocked(stop, step=0.1, stop=1.0)
    assert len(caught.value.result.trace.time) == 7


def test_warnings_of_the_fmus_stand_in_the_card(fmus):
    """Once per text, with the number of times."""
    card = run(str(fmus["fails"]), step=0.1, stop=1.0, set={"fails.when": 0.45, "fails.how": 1}).card
    assert card.warnings == ("fails at t = 0.5 s: the oil is warm at: 0 (5 times)",)
    assert "warning: fails at t = 0.5 s" in card.text()


def test_card_counts_and_times(oscillator):
    """Steps, simulated time, real-time factor."""
    began = time.perf_counter()
    card = run(oscillator, step=1e-2, stop=1.0).card
    assert (card.steps, card.simulated) == (100, 1.0)
    assert 0 < card.wall < time.perf_counter() - began
    assert card.real_time_factor == 1.0 / card.wall


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
def test_error_estimate_is_close_to_the_error(oscillator, exact, master):
    """The change at half the step is half the error of a first-order method, and the order is found."""
    result = run(oscillator, master=master, step=5e-4, stop=1.0, error_estimate=True)
    estimate = {e.name: e for e in result.card.errors}["a.x"]
    true = np.abs(result.trace["a.x"] - exact(result.trace.time)[:, 0]).max() / np.ptp(result.trace["a.x"])
    # first order: e(h) - e(h/2) = e(h)/2; the second-order term is 5 % of the error at this step
    assert estimate.largest == pytest.approx(true / 2, rel=0.1)
    assert estimate.order == pytest.approx(1, abs=0.15)  # as above
    assert "change at half the step" in result.card.text()


def test_a_failure_at_half_the_step_keeps_the_run():
    """The run that was asked for is complete; only its error estimate is missing, and that is told."""

    def fail(t):
        if t == 0.25:
            raise Problem("m: too small a step")

    result, _ = mocked(fail, step=0.5, stop=2.0, error_estimate=True)
    assert (result.complete, len(result.trace.time), result.card.errors) == (True, 5, ())
    assert result.card.notes == ("no error estimate, the run at half the step failed: m: too small a step",)


def test_progress_shows_on_long_runs_only(monkeypatch, capsys, oscillator):
    """Nothing before the patience is over, a bar on stderr after that."""
    run(oscillator, step=0.01, stop=10.0, progress=True)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(progress, "PATIENCE", 0.0)
    monkeypatch.setenv("FORCE_COLOR", "1")
    run(oscillator, step=0.01, stop=10.0, progress=True)
    assert "10 s simulated" in capsys.readouterr().err


def test_notes_of_the_system_reach_the_card(fmus):
    """Shown once."""
    files = {"s": fmus.make("source", "note_s", units={"y": "odd"}), "g": fmus["gain"]}
    card = run(assemble(files, ["s.y -> g.u"]), step=0.1, stop=0.2).card
    assert card.text().count("not both defined") == 1
