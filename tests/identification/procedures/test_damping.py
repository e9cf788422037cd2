"""Damping, eq. (13): true values come back, intervals hold them, doubts and faults are told."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from identification.procedures.bench import changed
from identification.procedures.lumped_machine import ENCODER, KNOWN, recording
from kit import shards
from kit.mistakes import problem, table

from fmus.identification import results
from fmus.identification.procedures.damping import BY_JOINT, identify, of_joint
from fmus.identification.procedures.procedure import fit_of

JOINTS = tuple(BY_JOINT)


def truth(joint):
    """The value that the machine was simulated with."""
    return KNOWN[BY_JOINT[joint].theta].value


def found(record):
    """B, its standard deviation."""
    joint = record.conditions["joint"]
    fit = fit_of(*of_joint(joint, [record], KNOWN), KNOWN)
    return fit[BY_JOINT[joint].theta], fit.sd(BY_JOINT[joint].theta)


@pytest.mark.parametrize("joint", JOINTS)
def test_perfect_instruments_give_the_true_damping(joint):
    """The machine was integrated by another route, CVODES on the joined subsystems; B comes back."""
    # 5e-4 for the swing, whose lines empty and fill with a jerk between two samples; 1e-5 for the pistons
    assert found(recording(joint))[0] == pytest.approx(truth(joint), rel=1e-3 if joint == "swing" else 5e-5)


@shards.search
def test_intervals_have_their_coverage():
    """Of 60 independent intervals 95 % cover the truth; standard deviations are neither small nor large."""
    cases = [(truth(joint), *found(recording(joint, seed=seed))) for joint in JOINTS for seed in range(20)]
    # the bar; five standard deviations and more
    assert all(value == pytest.approx(true, rel=0.02) for true, value, _ in cases)
    z = np.array([(value - true) / sd for true, value, sd in cases])
    # binomial, 0.95 of 60: 51 or less by chance in 0.3 %; seeds are fixed
    assert np.count_nonzero(np.abs(z) < 1.96) >= 52
    # chi-square with 60 degrees of freedom: between 33 and 95 in 99.4 %
    assert 33 < np.sum(z**2) < 95


def test_the_result_has_all_joints_with_figure_and_remarks():
    """One call with all recordings: three estimates by names of parameters.toml, Fig. 9, no false alarm."""
    result = identify([recording(j, seed=1) for j in JOINTS], KNOWN)
    assert {e.name: e.unit for e in result.estimates} == {c.parameter: c.unit for c in BY_JOINT.values()}
    for e, joint in zip(result.estimates, JOINTS, strict=True):
        # 3.3 standard deviations: 1 in 1000, seeds are fixed
        assert abs(e.value - truth(joint)) < 3.3 * e.sd
        assert e.low < e.value < e.high
    assert result.figure == 9
    assert len(result.panels) == 6
    assert not any("dry friction" in text or "incomplete" in text for text in result.remarks)
    assert results.named(result.findings) == []


def with_dry(dry):
    """A constant force against the motion, hidden in the head pressure."""
    clean = recording("boom", seed=2)
    velocity = np.gradient(recording("boom")["manipulator.boom_angle"], clean.time)
    area = np.pi / 4 * KNOWN["boom_stick.boom_bore"].value ** 2
    name = "boom_stick.boom_head_pressure"
    pressure = clean[name] + dry * np.tanh(velocity / 1e-3) / area
    return identify([changed(clean, {name: pressure})], KNOWN)


def test_dry_friction_is_reported_and_estimated_with_b():
    """A constant force against the motion does not raise B; along the motion it is a remark."""
    dry = 1500.0
    result, pushed = with_dry(dry), with_dry(-dry)
    (b,) = result.estimates
    assert abs(b.value - truth("boom")) < 3.3 * b.sd
    assert b.value == pytest.approx(truth("boom"), rel=0.05)  # without the column it was 1.7 times as large
    friction = next(e for e in result.others if e.name.startswith("dry friction"))
    assert friction.value == pytest.approx(dry, rel=0.02)  # where the sign changes it is rounded
    assert any("dry friction" in text for text in result.remarks)
    assert "dry friction" in {f.fault for f in results.named(result.findings)}
    assert "dry friction" not in {f.fault for f in results.named(pushed.findings)}
    assert not any(e.name.startswith("dry friction") for e in pushed.others)
    assert any("negative, which is impossible" in text for text in pushed.remarks)


def test_uncertainty_of_a_known_parameter_widens_the_interval():
    """0.1 % of the bore is 1.3 % of the damping: it widens the interval, and the note contains it."""
    record = recording("boom", seed=1)
    plain = identify([record], KNOWN)
    exact = plain.estimates[0]
    # what is assumed exact is listed only if it would shift B beyond its interval
    told = next(text for text in plain.remarks if "assumes exact geometry and masses" in text)
    assert "boom_stick.boom_bore" in told
    assert "valve" not in told
    assert "+0 %" not in told
    bore = KNOWN["boom_stick.boom_bore"]
    doubted = KNOWN | {"boom_stick.boom_bore": replace(bore, sd=1e-3 * bore.value)}
    result = identify([record], doubted)
    assert result.estimates[0].sd > 5 * exact.sd
    assert "by the known parameters" in result.estimates[0].note
    assert any("boom_stick.boom_bore" in text for text in result.remarks)
    alone = next(e for e in result.others if "known exactly" in e.name)
    assert alone.sd == pytest.approx(exact.sd)


def test_clipped_and_missing_samples_are_left_out():
    """Pressures at the end of the range and gaps shift B by what their windows tell, and a remark says so."""
    record = recording("stick", seed=3)
    name = "boom_stick.stick_rod_pressure"
    pressure = record[name].copy()
    pressure[1000:1100] = 0.0
    pressure[1500:1510] = np.nan
    result, (whole, whole_sd) = identify([changed(record, {name: pressure})], KNOWN), found(record)
    (b,) = result.estimates
    # an estimate with all windows has no correlation with its difference to one with less (Hausman 1978)
    assert abs(b.value - whole) < 3.3 * np.sqrt(b.sd**2 - whole_sd**2)
    assert any("left out" in text for text in result.remarks)


def test_a_recording_with_the_joint_at_rest_is_left_out():
    """A remark contains the name of the file, and B is that of the other recording."""
    record = recording("boom", seed=1)
    random = np.random.default_rng(6)
    still = {n: np.full_like(x, x[0]) for n, x in record.signals.items()}
    pressures = {n: x + 1e4 * random.standard_normal(x.size) for n, x in still.items() if "pressure" in n}
    lazy = replace(record, source=Path("lazy.csv"), signals=still | pressures)
    result = identify([record, lazy], KNOWN)
    assert any("in lazy.csv the joint is at rest" in text for text in result.remarks)
    assert result.estimates[0].value == identify([record], KNOWN).estimates[0].value


@table(__file__, "mistakes", "change, message")
def test_wrong_data_are_refused_in_one_line(change, message):
    """A wrong joint, none, no recording at all, only one that is held out."""
    assert message in problem(lambda: identify([replace(recording("boom"), **change)], KNOWN))


def test_a_missing_signal_and_a_joint_at_rest_are_refused():
    """The message contains the signal and the file; a joint at rest does not determine its damping."""
    record = recording("boom")
    less = replace(record, signals={n: x for n, x in record.signals.items() if "rod" not in n})
    still = changed(record, {n: np.full_like(x, x[0]) for n, x in record.signals.items()})
    still = replace(still, sensors={"manipulator.boom_angle": ENCODER})
    for wrong, message in (
        (less, "damping_boom.csv: expected the signal boom_stick.boom_rod_pressure"),
        (still, "manipulator.boom_angle: expected a joint in motion"),
    ):
        assert message in problem(lambda wrong=wrong: identify([wrong], KNOWN))
