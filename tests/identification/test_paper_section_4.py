"""examples/paper_section_4: the paper's estimators, and the example on a few recordings of the rig."""

import importlib
import runpy
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from identification.procedures import bench
from identification.procedures.lumped_machine import KNOWN, recording

from fmus.identification.recordings.reading import add
from fmus.rig.experiments import experiment
from fmus.rig.recordings import write
from orchestrator.data.recording import Sensor

EXAMPLE = Path(__file__).parents[2] / "examples" / "paper_section_4"
sys.path.append(str(EXAMPLE))  # of a script, which imports what lies beside it
as_printed = importlib.import_module("as_printed")
FEW = ("hose_resistance", "hose_dynamics_1", "hose_dynamics_3", "motor_leakage_1", "motor_leakage_2")


def test_intervals_of_a_line_and_of_means_are_those_of_independent_samples():
    """White noise: errors over 200 seeds are as large as the standard deviations by samples and by groups."""
    x, z = np.linspace(-1.0, 2.0, 50), []
    for seed in range(200):
        noise = np.random.default_rng(seed).normal(0.0, 0.3, (4, x.size))
        line = as_printed.line("B", 9, [(x, 2 * x + one) for one in noise], "1", ("x", "y"))
        means = as_printed.mean_of_means("I", [2 + one for one in noise], "1")
        z.append([(e.value - 2) / e.sd for e in (line.by_samples, means.by_samples)])
        half = means.by_groups.high - means.by_groups.value
        assert half == pytest.approx(3.182 * means.by_groups.sd, rel=1e-3)  # Student's t of four groups
    # mean square of 200 normal numbers, four standard deviations
    np.testing.assert_allclose(np.mean(np.square(z), axis=0), 1.0, atol=4 * np.sqrt(2 / 200))


def perfect_stick():
    """The stick in motion, by perfect instruments, the tank's among them."""
    read = recording("stick")
    return add(read, "swing.tank_pressure", np.zeros(read.time.size), "Pa")


def test_13_is_attenuated_by_a_coarse_encoder_and_corrected():
    """Pairs of opposite noise: (13) loses what noise in the speed adds to x'^T x'; corrected it does not."""
    sd, angle, perfect = 2e-3, "manipulator.stick_angle", perfect_stick()  # rad
    described = replace(perfect, sensors={angle: Sensor("coarse", sd)})
    random, found = np.random.default_rng(5), []
    for _ in range(8):
        noise = sd * random.standard_normal(perfect.time.size)
        for sign in (1, -1):
            shaken = bench.changed(described, {angle: perfect[angle] + sign * noise})
            _, *both = as_printed.over_filters("stick", [shaken], KNOWN)[2]  # the longest filter
            found.append(both)
    lost, left = np.mean(found, axis=0) / KNOWN["manipulator.stick_piston_damping"].value - 1
    assert lost < -0.02
    # what is even in the noise beyond attenuation: a tenth of it
    assert abs(left) < 0.2 * abs(lost)


def test_the_example_runs_on_a_few_recordings(tmp_path, capsys):
    """C_R of (1) misses the truth by 60 half intervals, ours holds it; the other estimates are near."""
    for name in FEW:
        write(tmp_path, experiment(name, "lumped"), 0)
    main = runpy.run_path(str(EXAMPLE / "run.py"))["main"]
    pairs = main([str(tmp_path), "--out", str(tmp_path / "out")])
    lines = capsys.readouterr().out.splitlines()
    names = [one.by_samples.name for one, _, _ in pairs]
    assert [line.split()[1] for line in lines[1:6]] == [name.partition(".")[2] for name in names]
    for one, own, true in pairs:
        off, half = abs(one.by_samples.value - true), one.by_samples.high - one.by_samples.value
        assert own.low < true < own.high, own
        if one.figure == 6:
            assert off > 50 * half
            assert lines[1].split()[6::4] == ["no", "yes"]
        else:
            # noise and the bias of two groups, 0.25 % with this seed
            assert off < 0.01 * true
    assert (tmp_path / "out" / "section_4.png").stat().st_size > 0
