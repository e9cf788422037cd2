"""Misspelt names in a recording are refused or reported."""

from pathlib import Path

import numpy as np
from kit.mistakes import problem, table

from fmus.composition import declared
from fmus.identification.machine import signal_names
from fmus.identification.pipeline import GROUPS, PROCEDURES, check_names, identify
from fmus.identification.procedures import valve
from fmus.machine.parts import FERIC
from orchestrator.data.recording import Recording

UNITS = {n: q.unit for group in GROUPS for n, q in declared(FERIC.subsystems, group).items()} | valve.SIGNALS


def recording(procedure, names, **conditions):
    time = np.arange(3.0)
    signals, units = dict.fromkeys(names, time), {name: UNITS.get(name, "1") for name in names}
    return Recording(time, signals, units, Path("run.csv"), procedure=procedure, conditions=conditions)


def check(*recordings):
    check_names(recordings, {name: p.signals for name, p in PROCEDURES.items()})


# each mistake once: both procedures have the signals of the machine
@table(__file__, "signals", "procedure, wrong, right")
def test_a_misspelt_signal_of_the_machine_is_refused(procedure, wrong, right):
    """One line with the file, the signal and a similar name, before the identification starts."""
    message = problem(lambda: identify([recording(procedure, [*signal_names().values(), wrong])]))
    assert message.startswith(f"run.csv: signal {wrong}: {procedure} does not read it; it reads inputs and")
    assert f"did you mean {right}" in message


def test_a_signal_that_is_not_read_is_refused():
    """A spare channel would be ignored: the line says what the procedure reads."""
    message = problem(lambda: check(recording("motor_leakage", ["pressure_a", "spare"])))
    assert message.startswith(
        "run.csv: signal spare: motor_leakage does not read it; it reads drain_flow, flow_a, pressure_a, "
        "pressure_b and oil_temperature"
    )


def test_all_that_is_read_may_be_recorded():
    """All signals of the machine, the oil's temperature, the conditions, a note; at rest any sensor."""
    check(
        recording("machine", [*signal_names().values(), "oil_temperature"], tank_pressure=1e5),
        recording("valve", valve.SIGNALS, edge="P-A", note="warm"),
        recording("rest", ["pressure_in", "anything"]),
    )


@table(__file__, "conditions", "procedure, wrong, right")
def test_a_condition_that_is_not_read_is_refused(procedure, wrong, right):
    """A key of [experiment] that differs from one that is read, or that has no meaning for the procedure."""
    message = problem(lambda: check(recording(procedure, [], **{wrong: "x"})))
    assert message == f"run.csv: [experiment] {wrong}: {procedure} does not read it; it reads {right}"
