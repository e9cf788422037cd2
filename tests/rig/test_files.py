"""The files of the rig: reproducible, readable, and without true parameter values."""

import tomllib
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from fmus.contract import quantities
from fmus.machine.parts import FAMILIES
from fmus.rig.experiments import EXPERIMENTS, experiment
from fmus.rig.instruments import record
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


def test_another_file_or_signal_changes_nothing():
    """The noise of a signal depends on seed, file and signal alone."""
    e = experiment("hose_resistance", "lumped")
    fewer = replace(e, signals={"flow": e.signals["flow"]})
    assert np.array_equal(record(fewer, 1)["flow"], record(e, 1)["flow"])
    renamed = replace(e, name="another")
    assert not np.array_equal(record(renamed, 1)["flow"], record(e, 1)["flow"])


@EACH
def test_the_table_holds_every_step(name, tmp_path):
    """pandas reads the columns of the description, and each cell is exactly the reading."""
    e = experiment(name, "lumped")
    csv, toml = write(tmp_path, e, 2)
    table, told = pd.read_csv(csv), tomllib.loads(toml.read_text(encoding="utf-8"))
    columns = [spec.get("column", signal) for signal, spec in told["signals"].items()]
    assert list(table) == ["time", *dict.fromkeys(columns)]
    assert table["time"].to_numpy() == pytest.approx(e.time, abs=1e-12)  # twelve digits
    assert np.diff(e.time) == pytest.approx(1 / 200, abs=1e-9)  # rounding
    for signal, readings in record(e, 2).items():
        cells, step = table[signal].to_numpy(), told["signals"][signal].get("resolution", 0.0)
        assert np.abs(cells - readings).max() < 1e-9  # twelve digits of up to 400
        if step:
            assert np.array_equal(np.round(cells / step), np.round(readings / step))


@EACH
def test_the_reader_of_recordings_and_references_reads_it(name, tmp_path):
    """The project's reader gets the signals in SI units, with the sensors of the rig."""
    e = experiment(name, "lumped")
    csv, _ = write(tmp_path, e, 0)
    recording = read_recording(csv)
    assert recording.kind == "simulation"
    shared = {other for signal in e.signals for other in SHARED.get(signal, ())}
    assert set(recording.signals) == set(e.signals) | shared
    assert (recording.procedure, recording.use) == (e.procedure, e.use)
    for signal, true in e.signals.items():
        sensor = recording.sensor(signal)
        error = recording[signal] - true
        good = np.abs(true) > sensor.dead_zone
        # six standard deviations of noise and converter; exact but for rounding without an instrument
        assert np.abs(error[good]).max(initial=0) <= 6 * sensor.sd + 1e-9 * np.abs(true).max()


def test_the_files_of_all_experiments_are_told():
    """Names and procedures of the experiments are those of the shared format."""
    assert {name.rsplit("_", 1)[0] for name in EXPERIMENTS if name[-1].isdigit()} == {
        *("hose_dynamics", "motor_leakage", "machine_train"),
        *(f"damping_{joint}" for joint in ("swing", "boom", "stick")),
    }
    kinds = {"valve", "hose_resistance", "hose_dynamics", "motor_leakage", "damping"}
    assert {experiment(name, "lumped").procedure for name in NAMES} == kinds


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
