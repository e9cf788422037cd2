"""Sensors: what they read of a signal, and what a fault of one does."""

import casadi as ca
import numpy as np
import pytest
from kit import shards
from kit.cranes import machine
from kit.equations import Part

from fmus.controller.paths import start_angles
from fmus.machine.build import harvester
from fmus.machine.parts import FERIC, feric
from fmus.machine.path_following import HARVESTER, first_point, follow
from fmus.package_files import data
from fmus.sensors import noise, sensors
from orchestrator import load, run

OF = Part(sensors({"pressure": "Pa", "angle": "rad"}))
QUIET = Part(sensors({"pressure": "Pa"}), pressure_noise=0.0, pressure_resolution=0.0)
P = OF.p


def reading(of, x, **u):
    """Of the pressure."""
    return of(x, **u)[1]["pressure_measured"]


def test_the_noise_is_white_and_of_unit_variance():
    """Of 20 000 samples: mean, variance, and the correlations with the next sample and another signal.

    Four standard deviations of each; the sum of four uniform numbers has a kurtosis of 2.7.
    """
    n, k = ca.SX.sym("n"), 20_000
    of = ca.Function("f", [n], [noise(n, 1.0, 0), noise(n, 1.0, 1), noise(n, 2.0, 0)])
    first, other, seeded = (np.array(v)[0] for v in of(np.arange(k)[None, :]))
    near = 4 / np.sqrt(k)
    assert abs(first.mean()) < near
    assert abs(first.var() - 1) < near * np.sqrt(1.7)
    for pair in ((first[1:], first[:-1]), (first, other), (first, seeded)):
        assert abs(np.corrcoef(*pair)[0, 1]) < near


def test_a_reading_has_noise_and_resolution():
    """Over 2000 samples at a constant pressure: multiples of the resolution, mean within its error."""
    x = OF.start(pressure_lagged=1.2e7, pressure_delayed=1.2e7)
    found = []
    for k in range(2000):
        x[OF.at("clock")] = (k + 0.5) * P["noise_period"]
        found.append(reading(OF, x))
    steps = np.array(found) / P["pressure_resolution"]
    assert steps == pytest.approx(np.round(steps), abs=1e-9)
    spread = np.hypot(P["pressure_noise"], P["pressure_resolution"] / np.sqrt(12))
    assert np.mean(found) == pytest.approx(1.2e7, abs=4 * spread / np.sqrt(2000))
    assert np.std(found) == pytest.approx(spread, rel=0.08)  # 4/sqrt(2 n)


def test_lag_and_delay():
    """A sine of 10 Hz: amplitude and phase are those of (1 + i w T)^-1 exp(-i w tau), to 0.5 % and 0.2 deg.

    The all-pass has the phase of the delay within (w tau)^3/12, 0.15 deg at 5 ms; the rest is the mean over
    a time that is no whole number of periods.
    """
    w, (lag, delay) = 2 * np.pi * 10, (QUIET.p["pressure_lag"], QUIET.p["pressure_delay"])
    time = np.arange(0, 1, 1e-3)
    shown = QUIET.follow(time, lambda t: {"pressure": 5e6 + 1e6 * ca.sin(w * t)})
    found = shown["pressure_measured"][-300:] - 5e6
    wave = np.exp(1j * w * time[-300:])
    response = 2j * np.mean(found * wave.conj()) / 1e6
    expected = np.exp(-1j * w * delay) / (1 + 1j * w * lag)
    assert abs(response) == pytest.approx(abs(expected), rel=5e-3)
    assert np.angle(response / expected) == pytest.approx(0, abs=np.radians(0.2))


def test_faults_of_a_sensor():
    """Bias, standstill, noise, no connection; the range ends the reading."""
    x = QUIET.start(pressure_lagged=5e6, pressure_delayed=5e6)
    assert reading(QUIET, x, pressure_bias=2e5) == pytest.approx(5.2e6, rel=1e-12)
    assert QUIET(x, pressure=8e6)[0][QUIET.at("pressure_lagged")] > 0
    assert QUIET(x, pressure=8e6, pressure_stuck=1.0)[0][QUIET.at("pressure_lagged")] == 0
    assert reading(QUIET, x, pressure_noise_added=1e5) != 5e6
    assert reading(QUIET, x, pressure_lost=1.0) == QUIET.p["pressure_unconnected"]
    high = QUIET.start(pressure_lagged=9e7, pressure_delayed=9e7)
    assert reading(QUIET, high) == QUIET.p["pressure_highest"]


def test_a_machine_with_faults_has_sensors_for_all_that_its_controller_measures():
    """Each measured input of the controller comes from a reading; the other wires are the same."""
    for made in (feric(faults=True), machine(faults=True)):
        wires, own = made.sensed(made.controller_wires), made.sensors.name
        into = {target: source for source, target in wires}
        for name in made.measured:
            assert into[f"controller.{name}"] == f"{own}.{name}_measured"
            assert (into[f"{own}.{name}"], f"controller.{name}") in made.controller_wires
        others = {w for w in made.controller_wires if w[1].partition(".")[2] not in made.measured}
        assert others <= set(wires)
    assert FERIC.sensed(FERIC.controller_wires) == FERIC.controller_wires


@pytest.fixture(scope="module")
def sensed(tmp_path_factory):
    """The machine with its controller behind sensors."""
    folder = tmp_path_factory.mktemp("sensed")
    harvester(faults=True).write(folder)
    return load(folder / "harvester_sensors.ssp")


@shards.machine
def test_noise_and_resolution_divide_no_steps(sensed):
    """The pump suggests shorter steps, so there is a guard; at the start it adds 381, without noise, too.

    With a division at each change of the tank pressure by its resolution there were 27 000.
    """
    found = run(sensed, swap={"supply": "engine_pump"}, step=1e-3, stop=2.0, record="sensors.*")
    assert found.coupling.guard_tolerance > 0
    assert 2000 <= found.card.steps < 2500


@shards.machine
def test_the_controller_draws_a_line_behind_sensors(sensed):
    """With lag, delay, noise and resolution, valves with hysteresis: within 15 mm, without sensors 5 mm.

    The noise costs a few millimetres, by its seed (docs/faults.md). A boom angle that is 2 deg off puts the
    tip off by 2 deg times its distance from the boom pivot, 4 to 4.5 m: 0.14 to 0.16 m, and 15 mm.
    """
    names, path = HARVESTER, data("scenarios/line.csv")
    start = start_angles("line", first_point(path, names.path), {})
    found = follow(sensed, names, path, "lumped", True, start)
    assert found.largest < 15e-3
    biased = follow(sensed, names, path, "lumped", True, {**start, "sensors.boom_angle_bias": np.radians(2)})
    assert 0.125 < biased.largest < 0.175
