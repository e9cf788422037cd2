"""The limits of decisions: just below nothing is said, just above it is."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from identification.procedures import bench, lumped_machine
from identification.procedures.bench import BAR, changed, with_sensors
from identification.procedures.test_findings import UP_AND_DOWN, at_rest, hose, names, warmer
from kit.mistakes import problem

from fmus.identification.balance import Regression
from fmus.identification.procedures import damping, experiment_data, momentum_balance, rest, valve
from fmus.identification.procedures.hoses import HOSE_RESISTANCE
from fmus.identification.procedures.procedure import misfit
from fmus.identification.recordings.reading import take
from fmus.parameters import Number
from orchestrator.data.recording import Recording

DAMPING = "manipulator.boom_piston_damping"


def regression(chi_square, value=0.0):
    return Regression(("x",), np.array([value]), np.eye(1), chi_square, 40)


def test_a_fit_of_chance_is_no_misfit_and_no_significant_term():
    """Chi-square of 40 at a probability of 0.2 and 0.05 %; a term of 3.5 and of 4 standard deviations."""
    assert not regression(71.0).misfit  # sf 0.0019
    assert regression(76.1).misfit  # sf 0.0005
    assert [regression(40.0, x).significant("x") for x in (3.5, -4.0)] == [False, True]


def test_noise_known_to_a_factor_of_two_is_no_error_of_the_model():
    """Residuals of 2 and of 3.5 times the noise; the former is what the declaration leaves open."""
    samples = SimpleNamespace(sd=np.ones((1, 1)), raw=np.ones((1, 9)))
    fits = (SimpleNamespace(fit=regression(40 * k**2), samples=[samples]) for k in (2.0, 3.5))
    twice, more = (misfit("", solution).p for solution in fits)
    assert twice > 0.5
    assert more < 1e-3


def test_zero_of_a_sensor_without_range_is_ten_times_its_noise_at_least():
    """Readings of 1 bar with a noise of 0.1 bar: 1 bar; of 800 bar: 0.25 % of them, 2 bar."""
    record = with_sensors(at_rest(pressure_in=0.0), high=np.inf, low=-np.inf)
    limits = [
        experiment_data.zero_limit(changed(record, {"pressure_in": np.full(2001, size)}), "pressure_in")
        for size in (1.0 * BAR, 800.0 * BAR)
    ]
    assert limits == pytest.approx([1.0 * BAR, 2.0 * BAR])


def test_lengths_of_one_hose_differ_by_less_than_a_thousandth():
    """0.8 mm in a metre are the tape's, 2 mm are another hose."""

    def sizes(factor):
        (record,) = bench.moving_hose(1, groups=1, length=1.0)
        own = {**bench.HOSE, "length": bench.LENGTH * factor}
        return experiment_data.one_size([record, replace(record, conditions=own)], "length")

    assert sizes(1.0008) == bench.LENGTH
    assert "identify one part at a time" in problem(lambda: sizes(1.002))


@pytest.mark.parametrize(("rates", "steady"), [(2.5, True), (7.0, False)])
def test_a_signal_is_steady_below_four_standard_deviations_of_its_rate(rates, steady):
    """A ramp for a quarter of the time, with rates in standard deviations of the rate by noise."""
    time, noise = np.arange(4001) / 200, 1e-3
    derivative = experiment_data.filter_for(at_rest(pressure_in=0.0), experiment_data.RATE_WINDOW, 2)
    rate = rates * derivative.gain(1) * noise
    values = rate * np.clip(time - 7.5, 0.0, 5.0) + noise * np.random.default_rng(1).standard_normal(4001)
    sensors = {"x": bench.Sensor("x", noise)}
    record = Recording(time, {"x": values}, {"x": "Pa"}, Path("ramp.csv"), sensors=sensors)
    stretches = experiment_data.steady_stretches(record, ["x"])
    assert any(s.start < 2000 < s.stop for s in stretches) == steady


def noise_finding(factor, count=2001):
    """What the first samples of a pressure at rest say, if its sensor declares so much less noise."""
    record = with_sensors(at_rest(pressure_in=BAR), noise=0.1 * BAR / factor, resolution=0.0)
    return next(experiment_data.signal_findings([take(record, slice(count))], ["pressure_in"], ""), None)


@pytest.mark.parametrize(("factor", "named"), [(1.8, False), (3.5, True)])
def test_a_noise_is_wrong_if_it_is_off_by_more_than_a_factor_of_two(factor, named):
    """Ten seconds of a sensor that declares its noise too small."""
    assert (noise_finding(factor).p < 1e-3) == named


def test_few_samples_tell_no_noise():
    """A hundred samples are not tested. A factor of three in 150 samples is two standard errors, chance."""
    assert noise_finding(3, 100) is None
    assert 1e-3 < noise_finding(3, 150).p < 0.5


@pytest.mark.parametrize(("change", "named"), [(0.015, False), (0.035, True)])
def test_a_resistance_may_change_by_two_percent_over_the_flows(change, named):
    """C_R that grows in proportion to the flow, at steps in no order, so that time explains nothing."""
    flows = np.random.default_rng(2).permutation(np.linspace(20.0, 275.0, 40))

    def drop(q):
        return bench.friction(q) * (1 + change * (q / bench.LITRES - 147.5) / 255.0)

    (record,) = bench.steady_hose(1, drop, flows)
    found = names(HOSE_RESISTANCE.identify([record], bench.KNOWN))
    assert ("model" in found) == named


def test_time_is_not_told_from_flow_if_both_only_rise():
    """A drop that falls by 3 % is not named with steps up only; up and down it is, see test_findings.py."""
    assert "oil temperature" not in hose(warmer, sorted(UP_AND_DOWN))


@pytest.mark.parametrize(("speed", "moves"), [(2.0, False), (5.0, True)])
def test_a_joint_moves_if_its_speed_is_above_its_noise(speed, moves):
    """A root mean square speed of 2 and of 5 standard deviations of its noise."""
    record = lumped_machine.recording("boom", seed=1, length=4.0)
    s = momentum_balance.joint_samples(record, "boom", (DAMPING,), lumped_machine.P)
    derivative, time = s.channels[4][1], np.arange(record.time.size)
    noise = np.linalg.norm(derivative) * experiment_data.noise_sd(record, momentum_balance.ANGLES[1])
    rate = speed * noise / (derivative @ np.arange(derivative.size))  # per sample, of a straight line
    raw = np.array([time * rate if k == 1 else x for k, x in enumerate(s.raw)])
    assert damping.moves(record, replace(s, raw=raw), 1) == moves


def test_an_end_stop_acts_within_two_millimetres():
    """Samples of a piston 1 mm from its end are left out, those at 3 mm are used."""
    record, p = lumped_machine.recording("boom", length=4.0), lumped_machine.P.copy()
    angles = np.array([record[n] for n in momentum_balance.ANGLES])
    position = np.array(momentum_balance.HARVESTER.pistons(angles, p)[0])[0]
    stroke = momentum_balance.PARAMETERS.index("manipulator.boom_stroke")
    used = []
    for gap in (0.1, 3e-3, 1e-3):
        p[stroke] = position.max() + gap
        used.append(momentum_balance.joint_samples(record, "boom", (DAMPING,), p).starts.size)
    assert used[0] == used[1] > used[2]


def test_steps_within_two_thousandths_have_one_command():
    """Steps of 3 and 3.01 V are one command, of 3 and 3.04 V two."""
    for second, voltages in ((3.01, 5), (3.04, 6)):
        edge = bench.edge("P-A", 1, steps=(1.5, 2.0, 3.0, second, 6.0, 10.0))
        found = valve.identify_openings([edge], bench.KNOWN)
        assert found.nodes.of["P-A"].command.size == voltages


@pytest.mark.parametrize(("factor", "refused"), [(0.008, True), (0.02, False), (1.2, False), (2.0, True)])
def test_a_command_in_a_wrong_unit_is_refused(factor, refused):
    """Commands up to 0.08, 0.2, 12 and 20 V with a full command of 10 V: one line, or a result."""
    record = bench.edge("P-A", 1)
    record = changed(record, {"command": record["command"] * factor})
    if refused:
        assert "is its unit right?" in problem(lambda: valve.identify([record], bench.KNOWN))
    else:
        assert "valve_area" in bench.named(valve.identify([record], bench.KNOWN))


@pytest.mark.parametrize(("factor", "named"), [(1.008, False), (1.015, True)])
def test_an_oil_of_another_density_is_named_from_one_percent_on(factor, named):
    """The density in the description, against the machine's."""
    record = bench.edge("P-A", 1)
    record = replace(record, conditions={**record.conditions, "density": bench.DENSITY * factor})
    assert ("density" in names(valve.identify([record], bench.KNOWN))) == named


@pytest.mark.parametrize(("limits", "refused"), [(15.0, False), (30.0, True)])
def test_a_reading_of_twenty_limits_is_no_zero(limits, refused):
    """Limits of 1 bar, 0.25 % of the range: 15 bar is a zero that is named, 30 bar is a load."""

    def result():
        return rest.identify([at_rest(pressure_in=limits * BAR)], {})

    if refused:
        assert problem(result) == (
            "rest.csv: pressure_in: expected a reading near zero, with the pump off and all pressures "
            "relieved, got 30 bar"
        )
    else:
        assert names(result()) == {"zero of a pressure sensor"}


@pytest.mark.parametrize(("factor", "named"), [(2.8, False), (3.2, True), (0.36, False), (0.3, True)])
def test_a_valve_of_another_size_is_named(factor, named):
    """An area of so many times the known one, as of a pressure in psi that is declared in bar."""
    record = bench.edge("P-A", 1, area=bench.AREA)
    known = bench.KNOWN | {"boom_stick.valve_area": Number(bench.AREA / factor, "m2", "assumed", "")}
    assert ("unit" in names(valve.identify([record], known))) == named
