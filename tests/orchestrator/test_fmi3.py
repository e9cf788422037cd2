"""What is particular to FMI 3.0: types, names, steps, and what is refused; and systems of both versions."""

import os
from pathlib import Path

import fmpy
import numpy as np
import pytest
from kit.any_fmu.models import WIDTHS, oscillator_of
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


@pytest.mark.parametrize("master", ["jacobi", "gauss-seidel"])
def test_both_versions_give_the_same_numbers_also_mixed(fmus, fmus3, master):
    """The same equations behind both: bit for bit, whoever sends and whoever receives."""
    traces = []
    for first in (fmus, fmus3):
        for second in (fmus, fmus3):
            system = oscillator_of(first["mass_a"], second["mass_b"])
            traces.append(run(system, master=master, step=1e-2, stop=0.5).trace)
    assert all(other == traces[0] for other in traces[1:])
    assert np.ptp(traces[0]["a.x"]) > 1.0


def test_numbers_of_all_widths_pass(fmus3):
    """From a scenario through an FMU and a connection; Float32 keeps seven digits."""
    lower = {kind: 0 if kind.startswith("U") else -7 for kind in WIDTHS}
    columns = {f"{kind.lower()}_in": np.array([lower[kind], 100.0]) for kind in WIDTHS}
    columns["float32_in"] = np.array([0.1, 1.1])
    files = {"p": fmus3["wide"], "q": fmus3["wide"]}
    wires = [f"p.{name}_out -> q.{name}_in" for name in ("float32", *(k.lower() for k in WIDTHS))]
    scenario = Trace(np.array([0.0, 1.0]), {f"p.{name}": values for name, values in columns.items()})
    # a structural parameter, which the FMU refuses in any other mode than the configuration mode
    trace = run(assemble(files, wires), scenario, step=0.5, set={"p.size": 9}).trace
    np.testing.assert_array_equal(trace["p.size_out"], 9)
    for kind in WIDTHS:
        np.testing.assert_array_equal(trace[f"q.{kind.lower()}_out"], [lower[kind], lower[kind], 100])
    np.testing.assert_array_equal(trace["q.float32_out"], np.float32([0.1, 0.6, 1.1]).astype(float))


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
    """At the start and from a scenario; test_any_variables.py has values of connections and outputs."""
    port = f"{name.lower()}_in"
    message = refusal(fmus3["wide"], {f"wide.{port}": value})
    assert f"{port}: expected a value in the range of {name}, got {value}" in message
    message = refusal(fmus3["wide"], scenario=Trace(np.array([0.0, 0.4]), {port: np.array([0.0, value])}))
    assert f"{port}: expected a value in the range of {name.lower()}, got {value}" in message


def test_an_alias_is_the_variable_itself(fmus3):
    """Values, connections and dependencies hold for both names: here no false algebraic loop arises."""
    aliases = {"u": "in", "y": "out"}
    gain = fmus3.make("gain", "gain_alias", aliases=aliases)
    face = read_interface(Location(gain))
    assert face.direct_inputs("out") == face.direct_inputs("y") == {"u", "in"}
    system = assemble({"s": fmus3["source"], "g": gain, "h": gain}, ["s.y -> g.in", "g.out -> h.u"])
    trace = run(system, step=0.1, stop=0.3, set={"g.factor": 2.0, "h.factor": 3.0}).trace
    np.testing.assert_array_equal(trace["h.out"], 6 * trace["s.y"])


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
