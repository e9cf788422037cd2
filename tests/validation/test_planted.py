"""The reference of the work cycle judges every signal, and notices errors as small as planted here."""

import numpy as np
import pytest
from kit import shards

from benchmarks.planted import DAMAGES, META, PARAMETERS, RIGHT, column_of, damaged, judged, limit, wrong
from orchestrator import Trace, load, run
from orchestrator.data.recording import read_recording
from orchestrator.results.validation import validate

REFERENCE = read_recording(META)
PERFECT = Trace(REFERENCE.time, REFERENCE.signals, REFERENCE.units)
NEAR = 0.5  # by which the limit of a signal may differ from ten times the error on another computer


def test_every_signal_of_a_run_has_a_limit(system):
    """All but the outputs of the operator and the inputs that are played: rates of commands, and payload."""
    found = run(system, stop=0.02, record_step=0.02).trace
    played = {"swing.swing_command_rate", "boom_stick.boom_command_rate", "boom_stick.stick_command_rate"}
    expected = {n for n in found if not n.startswith("operator_input.")} - played
    assert set(REFERENCE.signals) == expected - {"manipulator.payload_mass"}
    assert all(REFERENCE.criterion(name).tolerance for name in REFERENCE.signals)
    columns = column_of(system)
    inputs = {n for n in REFERENCE.signals if columns[n] != n}
    assert len(inputs) == 38
    for name in inputs:
        np.testing.assert_array_equal(REFERENCE[name], REFERENCE[columns[name]])


def test_the_reference_meets_itself_also_without_a_signal():
    """Without a planted error; a machine in one FMU lacks signals without label, which is noted."""
    assert validate(PERFECT, REFERENCE).passed
    found = validate(PERFECT.select(n for n in PERFECT if n != "manipulator.tip_x"), REFERENCE)
    assert "1 signals of the reference are not in the run: manipulator.tip_x" in found.notes
    assert len(found.rows) == len(REFERENCE.signals) - 1


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_run_fails(name):
    """In a run that is perfect otherwise."""
    assert not validate(damaged(PERFECT, DAMAGES[name]), REFERENCE).passed


@pytest.mark.parametrize("name", shards.few([], PARAMETERS, shards.machine))
def test_a_parameter_that_is_one_percent_off_fails(system, name):
    """With the default master."""
    assert not judged(system, set=wrong(system, name)).passed


@pytest.mark.parametrize("name", shards.few([], RIGHT, shards.machine))
def test_the_right_machine_passes(built, name):
    """With every master at a sensible step, in FMI 2.0 and 3.0, and in one FMU."""
    file, options = RIGHT[name]
    found = judged(load(built / file), **options)
    assert found.passed, found


@shards.machine
def test_limits_follow_from_the_error_of_the_default_master(system):
    """Ten times, as `python -m benchmarks.planted limits` writes them."""
    for row in judged(system).rows:
        assert row.tolerance.limit == pytest.approx(limit(row), rel=NEAR), row.signal
