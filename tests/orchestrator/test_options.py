"""Options have one declaration: Python, the command line, study files and SSP annotations read them alike."""

import subprocess
import sys
from dataclasses import fields

import pytest
import typer
from kit.mistakes import problem, table
from kit.ssp import gain, ssd, system

from orchestrator import Coupling, batch, linearize, reference, run
from orchestrator.__main__ import main
from orchestrator.base.options import option_texts
from orchestrator.cli import app
from orchestrator.engine import arguments
from orchestrator.engine.job import open_slave
from orchestrator.ssp.coupling import FIELDS, CouplingArguments

GROUPS = {
    run: arguments.RunArguments,
    batch: arguments.BatchArguments,
    reference: arguments.ReferenceArguments,
    linearize: arguments.LinearArguments,
}
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


DEFAULTS = {
    "start": "default: the start time in the system, else 0.",
    "stop": "default: the end of the scenario, else the stop time in the system or its FMUs.",
    "step": "default: the step in the system or its FMUs, 1e-3 for the harvester.",
    "record_step": "default: every step.",
    "tolerance": "else the tolerance in the DefaultExperiment of each FMU.",
}


def test_the_default_that_a_text_states_is_what_happens(fmus, zip_ssp):
    """Of a file with a start time, with and without a scenario, and of an FMU with a DefaultExperiment."""
    told = option_texts(arguments.RunArguments)
    assert all(text in told[name] for name, text in DEFAULTS.items())
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


def test_the_options_of_a_coupling_are_its_fields():
    """In the same order, by the same names but one."""
    names = [FIELDS.get(name, name) for name in CouplingArguments.__annotations__]
    assert names == [field.name for field in fields(Coupling)]


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
