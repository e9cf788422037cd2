"""Options have one declaration: Python, the command line, study files and SSP annotations read them alike."""

import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import typer
from kit.mistakes import entry, problem, table
from kit.ssp import gain, ssd, system

from orchestrator import Coupling, batch, linearize, reference, run
from orchestrator.__main__ import main
from orchestrator.base.options import chosen, given, option_texts
from orchestrator.cli import app
from orchestrator.engine import arguments
from orchestrator.engine.job import open_slave
from orchestrator.engine.options import RunOptions
from orchestrator.engine.result import read_metadata
from orchestrator.ssp.coupling import CouplingOptions

GROUPS = {
    run: arguments.RunArguments,
    batch: arguments.BatchArguments,
    reference: arguments.ReferenceArguments,
    linearize: arguments.LinearArguments,
}
ROOT = Path(__file__).parents[2]
COMMANDS = typer.main.get_command(app).commands


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_of_a_command_has_a_text(name):
    """An option without one is missing in the docstring of its declaration."""
    assert [p.name for p in COMMANDS[name].params if not p.help] == []


@pytest.mark.parametrize("function", GROUPS, ids=lambda function: function.__name__)
def test_the_docstring_of_a_function_has_its_options(function):
    """Each with the text that is the help of the command line."""
    for name, text in option_texts(GROUPS[function]).items():
        assert text
        assert f"    {name} " in function.__doc__
        assert text in " ".join(function.__doc__.split())


def test_the_default_that_a_text_states_is_what_happens(fmus, zip_ssp):
    """Of a file with a start time, with and without a scenario, and of an FMU with a DefaultExperiment."""
    told = option_texts(arguments.RunArguments)
    assert all(text in told[name] for name, text in entry(__file__, "defaults").items())
    experiment = 'startTime="0.25" stopTime="1.25" stepSize="0.125" tolerance="1e-4"'
    fmu = fmus.make("gain", "timed", experiment=experiment)
    ssp = zip_ssp(ssd(system([gain("g", source="g.fmu")], [])), {"g.fmu": fmu})  # from 0.5 to 1.5 s
    result, alone = run(ssp), run(fmus["gain"], stop=1.0, step=0.5).time
    driven = run(ssp, {"time": [0.0, 2.0], "g.u": [0.0, 1.0]})
    assert (result.time[0], alone[0]) == (0.5, 0.0)
    assert (result.time[-1], driven.time[-1], run(fmu).time[-1]) == (1.5, 2.0, 1.25)
    assert result.card.step == 0.125
    assert len(alone) == 3
    given = []

    def noted(component):
        slave = open_slave(component)
        setup = slave.setup
        slave.setup = lambda *span: given.append(span[2]) or setup(*span)
        return slave

    run(ssp, isolate=False, open=noted)
    run(ssp, isolate=False, open=noted, tolerance=1e-6)
    assert given == [1e-4, 1e-6]


def test_the_keywords_are_those_of_the_records(monkeypatch):
    """engine/arguments.py is what tools/keywords.py makes of engine/options.py."""
    monkeypatch.syspath_prepend(ROOT / "tools")
    keywords = import_module("keywords")
    assert keywords.FILE.read_text("utf-8") == keywords.text()


def test_a_record_tells_what_was_chosen():
    """By the names of the options, whether they are of the coupling or not; defaults and None are not."""
    options = {"stop": "2000 ms", "coupling_tolerance": 1e-6, "master": "hermite", "cut": "a.*", "yes": None}
    record = chosen(RunOptions, options, "run")
    assert (record.stop, record.cut, record.coupling.tolerance) == (2.0, ("a.*",), 1e-6)
    assert given(record) == {n: v for n, v in options.items() if n != "yes"} | {"stop": 2.0, "cut": ("a.*",)}
    assert chosen(RunOptions, given(record), "run") == record
    assert given(chosen(RunOptions, {"master": Coupling("jacobi", order=1)}, "run")) == {
        "master": "jacobi",
        "order": 1,
    }


@pytest.mark.parametrize("function", GROUPS, ids=lambda function: function.__name__)
def test_an_unknown_option_is_a_type_error_with_the_nearest_name(function):
    """Before anything is read: the system does not exist."""
    arguments = ({"a.b": [1.0]},) if function is batch else ()
    told = rf"^{function.__name__}\(\) has no option 'parametrs'; did you mean par"
    with pytest.raises(TypeError, match=told):
        function("none.ssp", *arguments, parametrs="reach")


@table(__file__, "wrong_values", "option, message")
def test_a_wrong_value_is_refused_in_one_line(option, message):
    """With what is expected, before the system is read."""
    assert problem(lambda: run("none.ssp", **option)).startswith(message)


def test_quantities_have_units_in_python_and_on_the_command_line(fmus, tmp_path, capsys):
    """A text with a unit is the number of seconds; None is the default; one name is a list of one."""
    more = {"record": "gain.y", "time_limit": None, "parameters": None, "isolate": False}
    told = run(fmus["gain"], step="50ms", stop="0.2 s", **more)
    same = run(fmus["gain"], step=0.05, stop=0.2, **more)
    assert list(told.trace.signals) == ["gain.y"]
    assert "'reach'" in problem(lambda: run(fmus["gain"], parameters="reach", isolate=False))
    assert told.trace.time.tolist() == same.trace.time.tolist()
    assert told.trace.window("50 ms", 0.1).time.tolist() == same.trace.time[1:3].tolist()
    out = str(tmp_path / "o.csv")
    assert main(["run", str(fmus["gain"]), "--step", "50ms", "--stop", "200 ms", "--out", out]) == 0
    assert "4 steps" in capsys.readouterr().out


def test_options_work_without_docstrings():
    """python -OO drops them: the help has no texts, and nothing fails."""
    code = "from orchestrator.__main__ import main; main(['run', '--help'])"
    told = subprocess.run([sys.executable, "-OO", "-c", code], capture_output=True, text=True, check=True)
    assert "--coupling-tolerance TOL" in told.stdout


# ---- Choices about the coupling: mistakes, combinations, and their record in the metadata


@table(__file__, "choices", "choices, message")
def test_a_wrong_value_or_a_choice_without_effect_is_told(choices, message):
    """What was expected and what was given; also where the choice is the default of the master."""
    assert problem(lambda: Coupling(**choices)).startswith(message)


def test_choices_add_to_the_usual_ones_unless_they_name_a_master():
    """Single choices change, factors by component; a master replaces the others."""
    usual = Coupling("hermite", passes=3, factors={"a": 2, "b": 3})
    merged = CouplingOptions(passes=2, factors={"a": 5}).added_to(usual)
    assert merged == Coupling("hermite", passes=2, factors={"a": 5, "b": 3})
    assert CouplingOptions("hermite", order=2).added_to(usual) == Coupling("hermite", order=2)
    assert CouplingOptions().added_to(None) == Coupling() == Coupling("gauss-seidel")
    problem(lambda: CouplingOptions(passes=2).added_to(Coupling("jacobi")), "expected the master hermite")


def test_the_text_tells_what_is_not_usual():
    """Only the name of the master if nothing else was chosen."""
    assert Coupling("hermite").text == "hermite"
    steps = {"a": 4, "b": 1, "c": 2}
    more = Coupling("jacobi", 1, factors=steps, adaptive=1e-3)
    assert more.text == "jacobi of order 1 with 4 of a and 2 of c in each step"
    assert Coupling("hermite", passes=1).text == "hermite in one pass"
    assert Coupling("hermite", passes=5).text == "hermite in up to 5 passes"


def test_the_settings_are_those_with_an_effect():
    """Defaults filled in, so that a run can be repeated when defaults have changed."""
    assert Coupling("jacobi").settings == {"master": "jacobi", "order": 0}
    assert Coupling("hermite", adaptive=1e-3).settings == {
        **{"master": "hermite", "order": 3, "passes": 8},
        "tolerance": pytest.approx(3e-4, rel=1e-12),  # rounding only
        **{"adaptive": 1e-3, "smallest": 1e-7, "largest": 0.1},
    }


@table(__file__, "couplings", "choices, order")
def test_the_settings_make_the_same_coupling(choices, order):
    """The coupling in the metadata of a trace can be used for another run."""
    coupling = Coupling(**choices)
    assert (choices | {"order": order}).items() <= coupling.settings.items()
    again = Coupling(**coupling.settings)
    assert again.settings == coupling.settings


def test_the_card_and_the_side_file_tell_steps_passes_and_settings(oscillator, tmp_path):
    """Of an adaptive run the tolerance, the range of the steps, passes, repeats, and all settings."""
    result = run(oscillator, master=Coupling("hermite", adaptive=1e-3), step=1e-3, stop=1.0)
    card, text = result.card, result.card.text()
    shortest, longest = card.lengths
    assert shortest < longest
    assert f"master hermite, tolerance 0.001, {card.steps} steps of {1e3 * shortest:.3g} to" in text
    assert card.passes > card.steps
    assert "passes each" in text
    result.write(tmp_path / "o.csv")
    facts = read_metadata(tmp_path / "o.csv")
    assert facts.coupling == result.coupling.settings
    assert (facts.steps, facts.passes, facts.repeated) == (card.steps, card.passes, card.repeated)
    assert tuple(facts.lengths) == card.lengths
    assert facts.adaptive


def test_the_estimate_of_an_adaptive_run_is_near_its_error(oscillator, exact):
    """A run at a tenth of the tolerance, at the same recorded points."""
    coupling = Coupling("hermite", adaptive=1e-3)
    result = run(oscillator, master=coupling, stop=2.0, record_step=0.1, error_estimate=True)
    truth = exact(result.trace.time)[:, 0]
    error = np.abs(result.trace["a.x"] - truth).max() / np.ptp(result.trace["a.x"])
    (found,) = [e for e in result.card.errors if e.name == "a.x"]
    # these FMUs hold their inputs: the error is of order 2, the step is chosen for order 4, so the error goes
    # with the root of the tolerance; 15 %, because the errors of both runs are not in proportion everywhere
    assert found.largest == pytest.approx((1 - 10**-0.5) * error, rel=0.15)
    assert found.order is None
    told = "change of the signals at a tenth of the tolerance; the error is 1.1 to 1.5 times this change"
    assert told in result.card.text()


def test_without_a_record_step_there_is_no_estimate_of_an_adaptive_run(oscillator):
    """Two such runs have no common points; a note suggests a record step."""
    card = run(oscillator, master=Coupling(adaptive=1e-2), stop=0.5, error_estimate=True).card
    assert not card.errors
    told = "no error estimate: two adaptive runs have common times only with a record step; set --record-step"
    assert told in card.notes


@table(__file__, "times", "options, message")
def test_times_that_adaptive_steps_cannot_tell_are_refused(oscillator, options, message):
    """Before the run begins, which would never end."""
    problem(lambda: run(oscillator, master=Coupling("jacobi", adaptive=1e-2), **options), message)


def test_adaptive_steps_get_no_shorter_than_the_times_can_tell(oscillator):
    """A tolerance that is never met leads to the smallest step, which must still advance the time."""
    at = 1e9  # [s], where times differ by 1e-7 s at least
    hopeless = Coupling("jacobi", adaptive=1e-300, smallest=1e-300)
    card = run(oscillator, master=hopeless, start=at, stop=at + 1e-2, step=1e-3).card
    assert card.lengths[0] > 1e-5
    assert card.simulated == pytest.approx(1e-2, abs=1e-7)  # [s]: rounding of times
