"""What is particular to FMI 3.0: types, names, steps, and what is refused; and systems of both versions."""

import os
from pathlib import Path

import fmpy
import numpy as np
import pytest
from kit.mistakes import problem, table

from orchestrator import Problem, Trace, assemble, load, run
from orchestrator.base.files import Location
from orchestrator.fmi import library
from orchestrator.fmi.interface import read_interface
from orchestrator.fmi.messages import with_variable_names

BLOB = '<Binary name="blob" valueReference="401" causality="output"/>'


def refusal(file, set=None, scenario=None, **more):
    """The line of a run that does not begin, or ends at once."""
    return problem(lambda: run(str(file), scenario, step=0.1, stop=0.5, set=set or {}, isolate=False, **more))


def test_texts_are_parameters(fmus3, opened):
    """From the initialisation mode on; test_system.py has start values of all types."""
    slave = opened(fmus3["types"])
    slave.setup(0.0, 1.0, None)
    slave.set("label", "crane")
    slave.enter()
    assert slave.get("echo") == "hello crane"
    assert slave.get("bool_out") is True


@pytest.mark.parametrize(("name", "value"), [("Int8", 200), ("UInt16", -1)])
def test_values_must_fit(fmus3, name, value):
    """At the start; test_any_variables.py has values of scenarios, connections and outputs."""
    port = f"{name.lower()}_in"
    message = refusal(fmus3["wide"], {f"wide.{port}": value})
    assert f"{port}: expected a value in the range of {name}, got {value}" in message


def test_an_alias_is_the_variable_itself(fmus3):
    """Dependencies hold for both names; test_any_variables.py has values and connections."""
    face = read_interface(Location(fmus3.make("gain", "gain_alias", aliases={"u": "in", "y": "out"})))
    assert face.direct_inputs("out") == face.direct_inputs("y") == {"u", "in"}


def test_inputs_without_a_rate_input_accept_no_derivative(fmus3, started):
    """FMI 3.0 has no function that gives inputs a slope; whoever asks for it is told."""
    slave = started(fmus3["fails"])
    with pytest.raises(Problem, match="it: u: the FMU accepts no derivative of order 1 of this input"):
        slave.input_derivative_writer(["u"], np.zeros(1))


def test_the_resources_are_a_path(fmus, fmus3, started):
    """With a separator at its end; none when the FMU has no such folder. FMI 2.0 gets a URI."""
    for workshop, model in ((fmus3, "types"), (fmus, "types")):
        slave = started(workshop.make(model, "resourceful", extra={"resources/x.txt": ""}))
        told = slave.get("resources")
        if workshop is fmus3:
            assert told.endswith(os.sep)
            assert Path(told, "x.txt").is_file()
        else:
            assert told.startswith("file://")
    bare = started(fmus3["types"])
    assert bare.get("resources") == ""


def test_messages_tell_names():
    """FMI 3.0 writes variables as #12#, FMI 2.0 with a letter for the type; both write # twice."""
    for mark in ("12", "r12", "i12", "b12", "s12"):
        text = f"#{mark}# of pump ##4 is above #13#, #1"
        assert with_variable_names(text, {mark: "a.p"}) == "a.p of pump #4 is above #13#, #1"


def test_binaries_lie_in_the_folder_of_the_platform_tuple(fmus, fmus3, monkeypatch, opened):
    """In FMI 2.0 it comes first on ARM: linux64 does not tell the processor, but may still do."""
    misplaced = fmus3.make("gain", "misplaced", platform=fmpy.platform)  # FMI 2.0's folder does not count
    problem(lambda: opened(misplaced), rf"expected binaries/{fmpy.platform_tuple}/misplaced")
    monkeypatch.setattr(library, "PLATFORM_TUPLE", "aarch64-linux")
    monkeypatch.setattr(library, "FMI2_PLATFORM", "linux64")
    assert library.platform_folders(2) == ["aarch64-linux", "linux64"]
    opened(fmus.make("gain", "arm", platform="aarch64-linux")).close()
    problem(lambda: opened(fmus.make("gain", "windows", platform="win64")), "binaries/aarch64-linux/windows")
    monkeypatch.setattr(library, "PLATFORM_TUPLE", "x86_64-linux")
    assert library.platform_folders(2) == ["linux64", "x86_64-linux"]


# ---- what is refused


@table(__file__, "refused", "changes, message")
def test_other_fmus_are_refused_by_name(fmus3, changes, message):
    """Other interfaces, versions and units of time; betas of 3.0 are another standard, but 3.0.2 is 3.0."""
    assert message in problem(lambda: load(fmus3.make("gain", "odd", **changes)))
    assert read_interface(Location(fmus3.make("gain", "patched", version="3.0.2"))).model.major == 3


def test_a_binary_is_no_number(fmus3):
    """One that nothing needs, and no function gives, is left alone; test_clocks.py has others."""
    fmu, port = fmus3.make("gain", "mixed", more=BLOB), "mixed.blob"
    result = run(str(fmu), step=0.1, stop=0.2, set={"u": 2.0})
    assert list(result.trace.signals) == ["mixed.y", "mixed.u"]
    assert result.texts == ()
    column = Trace(np.array([0.0, 1.0]), {port: np.zeros(2)})
    wired = problem(lambda: assemble({"s": fmus3["source"], "mixed": fmu}, [f"s.y -> {port}"]))
    assert "expected an output and an input, got output and output" in wired
    assert "cannot be set" in refusal(fmu, {port: "00"})
    assert "expected an input or a tunable parameter, got a Binary output" in refusal(fmu, scenario=column)
    assert f"{port}" in refusal(fmu, record=[port])


def test_the_experiment_of_a_single_fmu_is_run(each):
    """Start, stop and step."""
    fmu = each.make("source", "later", experiment='startTime="5" stopTime="6" stepSize="0.25"')
    time = run(str(fmu)).trace.time
    np.testing.assert_array_equal(time, [5.0, 5.25, 5.5, 5.75, 6.0])
