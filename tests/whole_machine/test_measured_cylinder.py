"""examples/measured_cylinder on recordings of independent equations, in the format of the measured files."""

import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from kit import shards
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from orchestrator.base.errors import Problem

pytestmark = shards.machine

EXAMPLE = Path(__file__).parents[2] / "examples" / "measured_cylinder"
NAMES = ("run", "fit", "figure", "prediction", "recordings", "axis", "axis.model")

STEP, RATE = 1e-3, 1000  # s, Hz of the synthetic recordings
HEAD, ROD = np.pi / 4 * 0.016**2, np.pi / 4 * (0.016**2 - 0.010**2)  # m2
SUPPLY, TANK, MASS, STROKE, ZERO = 4.4e6, 1.0e5, 3.0, 0.195, 0.0056
GAIN, DEAD_BAND, BORES = 6.3e-9, 0.2, 2.5e14  # m3/(s.V.Pa^0.5), V, Pa.s2/m6
LEAKAGE, CAPACITANCE = 2e-13, 4e-13  # m3/(s.Pa), m3/Pa
SLIDING, STICTION, DECAY, VISCOUS = 65.0, 80.0, 0.003, 60.0  # N, N, m/s, N.s/m
HOLD = {1: 7.0, 2: 4.0, 3: 3.0, 4: 2.5, 5: 2.0}  # s until the command returns
NOISE = {"position": 0.02, "pressure": 0.05}  # V, MPa
# openings forwards and backwards, relative to the mean, of the two runs of each step: their mean is exactly 1
GAINS = {"A": (1.01, 0.99), "B": (0.99, 1.01)}


def edge(command: float, drop: float, gain: float) -> float:
    """Flow [m3/s] through an edge, its bores and its leakage."""
    k = GAIN * gain * max(0.0, command - DEAD_BAND)
    return np.sign(drop) * k / np.sqrt(1 + BORES * k**2) * np.sqrt(abs(drop)) + LEAKAGE * drop


def rates(_: float, x: np.ndarray, command: float, gains: tuple[float, float]) -> list[float]:
    """dx/dt of pressures [Pa], position [m] from the closed end, and speed [m/s]."""
    head, rod, position, speed = x
    ahead, back = gains
    into_head = edge(command, SUPPLY - head, ahead) - edge(-command, head - TANK, back)
    into_rod = edge(-command, SUPPLY - rod, back) - edge(command, rod - TANK, ahead)
    friction = (SLIDING + (STICTION - SLIDING) * np.exp(-((speed / DECAY) ** 2))) * np.tanh(speed / 1e-3)
    beyond = not 0 <= position <= STROKE
    stop = 3e6 * (max(0.0, -position) - max(0.0, position - STROKE)) - 3e3 * speed * beyond
    force = HEAD * head - ROD * rod - friction - VISCOUS * speed + stop
    filling = (into_head - HEAD * speed, into_rod + ROD * speed)
    return [*(flow / CAPACITANCE for flow in filling), speed, force / MASS]


def simulated(volts: int, gains: tuple[float, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time (n,), command (n,), states (n, 4) of a step forwards and one backwards."""
    hold, length = HOLD[volts], 2 * HOLD[volts]
    time = np.arange(round(length * RATE) + 1) * STEP
    x, states = np.array([0.25e6, 3.9e6, 0.0, 0.0]), []
    corners = [(0.0, 0.1, 0.0), (0.1, hold, volts), (hold, hold + 0.1, 0.0), (hold + 0.1, length, -volts)]
    accuracy = {"rtol": 1e-5, "atol": [1e2, 1e2, 1e-7, 1e-6], "max_step": 0.02}
    for begin, end, command in corners:
        samples = np.append(time[(time >= begin - 1e-9) & (time < end - 1e-9)], end)
        solved = solve_ivp(rates, (begin, end), x, "LSODA", samples, args=(command, gains), **accuracy)
        states.append(solved.y.T[:-1])
        x = solved.y[:, -1]
    command = np.select([time < 0.1, time < hold, time < hold + 0.1], [0, volts, 0], -volts).astype(float)
    return time, command, np.vstack([*states, x])


def write_run(folder: Path, volts: int, chamber: str, repeat: int) -> None:
    """One .mat file with the variables of the measurements."""
    random = np.random.default_rng([volts, ord(chamber), repeat])
    time, command, states = simulated(volts, GAINS[chamber])
    column = 0 if chamber == "A" else 1
    raw = (states[:, 2] + ZERO) / 0.02 + NOISE["position"] * random.standard_normal(len(time))
    code = 20 / 4096
    position = np.clip(code * np.round(raw / code), -10, 10 - code)
    pressure = 1e-6 * states[:, column] + NOISE["pressure"] * random.standard_normal(len(time))
    table = {
        "t": time,
        "w_verdadero2": command,
        "poloha_bez_filtr2": position,
        "poloha_s_filtr2": lfilter([0.05], [1, -0.95], position),
        "pressure_bez_filtr1": pressure,
        "pressure_s_filtr1": lfilter([0.05], [1, -0.95], pressure),
    }
    path = folder / f"m_find_b_p{chamber}_{volts}V_sample_{repeat}.mat"
    scipy.io.savemat(path, {name: values[:, None] for name, values in table.items()}, oned_as="column")


@pytest.fixture(scope="module")
def example():
    """The modules of the example; they are scripts with plain names."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(EXAMPLE)
        for name in NAMES:
            patch.delitem(sys.modules, name, raising=False)
        yield import_module("run")
        for name in NAMES:
            sys.modules.pop(name, None)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """One run of each step and pressure; one file is there twice."""
    target = tmp_path_factory.mktemp("measured")
    for volts in HOLD:
        for chamber in "AB":
            write_run(target, volts, chamber, 1)
    copy = target / "m_find_b_pB_3V_sample_9.mat"
    copy.write_bytes((target / "m_find_b_pB_3V_sample_1.mat").read_bytes())
    return target


def test_held_out_steps_are_predicted(example, folder, tmp_path, capsys):
    """Identified on +-1, 3 and 5 V, the FMU predicts +-2 and 4 V within the bars, and its bands hold."""
    errors = example.main([str(folder), "--draws", "40", "--out", str(tmp_path)])
    printed = capsys.readouterr().out
    assert "m_find_b_pB_3V_sample_9.mat: the same content as m_find_b_pB_3V_sample_1.mat" in printed
    assert "6 runs to identify, 4 to predict" in printed
    assert (tmp_path / "axis.fmu").is_file()
    assert (tmp_path / "result.png").stat().st_size > 10_000
    for volts in (2, 4):
        found = errors[volts]
        # the bars of the example, see its README
        assert found.stroke < 0.01
        assert np.max(np.abs(found.speeds)) < 0.02
        # the scatter is that of the design, so hardly any run leaves its band
        assert all(0.90 <= share <= 1.0 for share in found.held.values())
        # both runs differ from the mean by 1 %: 10 to 20 ms at a stop, where a pressure changes by 3 MPa
        assert max(found.pressures.values()) < 0.04 * SUPPLY


@pytest.mark.usefixtures("example")
def test_descriptions_are_written_next_to_the_files(folder):
    """A recording is read by its TOML file: SI units, range of the converter, use."""
    import recordings

    files = recordings.files(folder)
    (recording,) = recordings.read([f for f in files if (f.volts, f.chamber, f.repeat) == (2, "B", 1)])
    text = (folder / "m_find_b_pB_2V_sample_1.toml").read_text(encoding="utf-8")
    assert 'use = "test"' in text
    assert recording.units == {"command": "V", "position": "m", "rod_pressure": "Pa"}
    assert recording.sensor("position").high == pytest.approx(0.2 - 0.02 * 20 / 4096)
    assert recording.conditions["step"] == 2.0
    # noise of a mean over 0.5 s
    late = recording.time > recording.time[-1] - 0.5
    assert recording["rod_pressure"][late].mean() == pytest.approx(SUPPLY, rel=0.02)


@pytest.mark.usefixtures("example")
def test_scatter_of_the_speeds_is_that_of_the_openings(folder):
    """The gains are relative to the mean of a step; their covariance is pooled over the steps."""
    import fit
    import recordings

    found = fit.scatter(list(recordings.read(recordings.select(recordings.files(folder), (1, 5), None))))
    assert len(found.gains) == 4
    for volts in (1, 5):
        gains = [g for name, g in found.gains.items() if f"{volts}V" in name]
        np.testing.assert_allclose(np.mean(gains, axis=0), 1)  # by definition, rounding only
    # two openings of +-1 % have a standard deviation of 1.414 %; the flow o / sqrt(1 + R o^2) changes by less
    opened = GAIN * (np.array([1, 5]) - DEAD_BAND)
    expected = 0.01414 * np.sqrt(np.mean(1 / (1 + BORES * opened**2) ** 2))
    # the noise of a speed is 0.05 %, and the pressures change a little, too
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), expected, rtol=0.1)
    assert found.degrees == 2


def test_a_folder_without_recordings_is_refused(example, tmp_path):
    """One line says what was expected."""
    with pytest.raises(Problem, match="expected files such as m_find_b_pA_1V_sample_1"):
        example.main([str(tmp_path)])
