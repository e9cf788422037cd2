"""Misspelt names in a recording are refused or reported."""

from pathlib import Path

import numpy as np
from kit.mistakes import problem, table

from fmus.identification.machine import signal_names
from fmus.identification.pipeline import PROCEDURES, identify
from fmus.identification.procedures import valve
from fmus.identification.recording_names import name_remarks
from orchestrator.data.recording import Recording


def recording(procedure, names, **conditions):
    time = np.arange(3.0)
    signals, units = dict.fromkeys(names, time), dict.fromkeys(names, "1")
    return Recording(Path("run.csv"), time, signals, units, procedure=procedure, conditions=conditions)


def remarks(recordings):
    return list(name_remarks(recordings, {name: module.SIGNALS for name, module in PROCEDURES.items()}))


# each mistake once: both procedures have the signals of the machine
@table(__file__, "signals", "procedure, wrong, right")
def test_a_misspelt_signal_of_the_machine_is_refused(procedure, wrong, right):
    """One line with the file, the signal and a similar name, before the identification starts."""
    message = problem(lambda: identify([recording(procedure, [*signal_names().values(), wrong])]))
    assert message == f"run.csv: signal {wrong}: expected an input or output of the machine, such as {right}"


def test_an_unknown_signal_is_reported():
    """A temperature, or a spare channel of a test bench, is not a mistake; a remark lists it as not used."""
    (text,) = remarks([recording("machine", [*signal_names().values(), "oil_temperature"])])
    assert text == "run.csv: not used, because the machine has no such signal: oil_temperature"
    (text,) = remarks([recording("valve", [*valve.SIGNALS, "oil_temperature"])])
    assert text == "run.csv: not used, because valve needs no such signal: oil_temperature"
    (text,) = remarks([recording("valve", ["pressure_inn"])])
    assert "pressure_inn (misspelt pressure_in?)" in text


def test_all_signals_of_the_machine_may_be_recorded():
    """Signals and conditions that are read have no remark."""
    assert remarks([recording("machine", signal_names().values(), tank_pressure=1e5)]) == []
    assert remarks([recording("valve", valve.SIGNALS, edge="P-A", length=4.0, note="warm")]) == []


@table(__file__, "conditions", "procedure, wrong, right")
def test_a_misspelt_condition_is_refused(procedure, wrong, right):
    """A key of [experiment] that differs by case or a letter from one that is read."""
    message = problem(lambda: remarks([recording(procedure, [], **{wrong: "x"})]))
    assert message == f"run.csv: [experiment] unknown key {wrong}, expected {right}"
