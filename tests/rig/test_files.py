"""The files of the rig: reproducible, readable, and without true parameter values."""

import tomllib

import numpy as np
import pandas as pd
import pytest

from fmus.contract import quantities
from fmus.machine.parts import FAMILIES
from fmus.rig.experiments import experiment, record
from fmus.rig.recordings import SHARED, readme, write
from orchestrator.data.recording import read_recording

# one of each procedure; those on the machine are the short ones
NAMES = ("valve_bt", "hose_resistance", "hose_dynamics_4", "motor_leakage_2", "damping_boom_1")
EACH = pytest.mark.parametrize("name", NAMES)


@EACH
def test_seeds(name, tmp_path):
    """Equal seeds give equal bytes; another seed changes only the noise."""
    e = experiment(name, "lumped")
    for folder, seed in (("a", 4), ("b", 4), ("c", 5)):
        (tmp_path / folder).mkdir()
        write(tmp_path / folder, e, seed)
    a, b, c = ((tmp_path / folder / f"{name}.csv").read_bytes() for folder in "abc")
    assert a == b
    assert a != c
    one, other = record(e, 4), record(e, 5)
    for signal, instrument in e.instruments.items():
        differ = np.mean(one[signal] != other[signal])
        # two readings with the noise of a step or more are equal by chance in less than a third of the cases;
        # a turbine in its dead zone reads zero whatever the seed
        turning = np.mean(np.abs(e.signals[signal]) * 60e3 > instrument.dead_zone)
        assert differ == 0 if instrument.noise == 0 else differ >= 0.6 * turning, signal


@pytest.mark.parametrize("name", [*NAMES, "seal_leakage"])
def test_a_table_holds_every_step_and_the_reader_of_recordings_reads_it(name, tmp_path):
    """Each cell is the reading, exactly; the project's reader gets the signals in SI units, with sensors."""
    e = experiment(name, "lumped")
    csv, toml = write(tmp_path, e, 2)
    table, told = pd.read_csv(csv), tomllib.loads(toml.read_text(encoding="utf-8"))
    columns = [spec.get("column", signal) for signal, spec in told["signals"].items()]
    assert list(table) == ["time", *dict.fromkeys(columns)]
    assert table["time"].to_numpy() == pytest.approx(e.time, abs=1e-12)  # twelve digits
    for signal, readings in record(e, 2).items():
        assert np.abs(table[signal].to_numpy() - readings).max() < 1e-9  # twelve digits of up to 400
    recording = read_recording(csv)
    shared = {other for signal in e.signals for other in SHARED.get(signal, ())}
    assert set(recording.signals) == set(e.signals) | shared
    assert (recording.kind, recording.procedure, recording.use) == ("simulation", e.procedure, e.use)
    for signal, true in e.signals.items():
        sensor = recording.sensor(signal)
        good = np.abs(true) > sensor.dead_zone
        # six standard deviations of noise and converter; exact but for rounding without an instrument
        error = np.abs(recording[signal] - true)[good].max(initial=0)
        assert error <= 6 * sensor.sd + 1e-9 * np.abs(true).max()


@pytest.mark.parametrize("machine", ["lumped", "detailed"])
def test_no_truth_in_the_files(machine, tmp_path):
    """The files contain no name or value of a parameter that is to be identified."""
    written = readme(machine, 0)
    for name in NAMES[:4]:
        _, toml = write(tmp_path, experiment(name, machine), 0)
        written += toml.read_text(encoding="utf-8")
    names = {n for family in FAMILIES.values() for sub in family.values() for n in quantities(sub.parameters)}
    told = {"density", "viscosity"}  # of the oil, known before
    assert not [n for n in names - told if n in written]
    found = (4e-5, 3.2e10, 1.361e7, 7.126e-13, 2.0e12, 1.1e12)  # valve, hose, motor
    # as Python and as C write them; 1100000000000.0 holds 1100000000000
    spelled = {text for v in found for text in (repr(v), f"{v:g}", f"{v:.0f}", f"{v:.1e}")}
    assert not [text for text in spelled - {"0"} if text in written]
    assert "simulated" in written.lower()
