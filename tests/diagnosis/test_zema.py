"""The benchmark on the recording of a test rig, on a small one with the same format and known wear."""

import io
import itertools
import sys
import zipfile
from urllib.error import URLError

import numpy as np
import pytest

from benchmarks import zema
from benchmarks.zema import ATMOSPHERE, BAR, CHECKS, LITRE, counted, judged, parts, read

LAGS = {100: 1.3, 90: 1.4, 80: 1.5, 73: 1.6}  # s
LEAKS = {0: 0.0, 1: 0.25, 2: 0.36}  # L/min
COOLERS = {100: 150.0, 20: 75.0, 3: 40.0}  # W/K
VOLUME, WARM = 0.45, 1.17  # L of gas; precharge at 328 K over that when it was filled
STEPS = ((19, 142, 152), (29, 152, 162), (39, 162, 152), (49, 152, 147))  # s, bar
SENSORS = sorted({n for c in CHECKS for n in c.needs})


def cycle(cooler, valve, pump, accumulator, noise):
    """Sensors of a cycle, in the units of the archive, 10 samples a second."""
    oil = {100: 45.0, 20: 50.0, 3: 55.0}[cooler] + 273.15
    hot = WARM * (accumulator + ATMOSPHERE / BAR) * oil / 328

    def given(before, after):
        """Oil [L] when the pressure [bar] changes."""
        law = [max(0.0, 1 - hot / (p + ATMOSPHERE / BAR)) for p in (before, after)]
        return VOLUME * (law[0] - law[1])

    t = np.arange(0, 60, 0.1) + 0.05
    p = np.select([t < 8 + LAGS[valve], t < 19, t < 29, t < 39, t < 49], [190, 142, 152, 162, 152], 147.0)
    flow = 7.9 - 0.01 * (p - 150) + 0.02 * (oil - 323) - LEAKS[pump]
    flow[t < 8 + LAGS[valve]] = 0
    for second, before, after in STEPS:
        flow[(t > second) & (t < second + 1)] += 60 * given(before, after)
    load = np.where(t < 8 + LAGS[valve], 0, p - 25)
    p[(t > 10) & (t < 11)] += 250 * given(190, 142)
    flow_cooling, warm = 9.2, oil + 1
    drop = COOLERS[cooler] * (warm - 293.15) / (870 * 1900 * flow_cooling * LITRE + COOLERS[cooler] / 2)
    values = {"PS1": p, "PS2": load, "FS1": flow, "FS2": np.full(60, flow_cooling)}
    values |= {n: np.full(60, x - 273.15) for n, x in (("TS1", oil), ("TS3", warm), ("TS4", warm - drop))}
    return {n: v + 1e-3 * noise.standard_normal(len(v)) for n, v in values.items()}


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """All conditions in order, two cycles each, the first one of a cooler not stable."""
    noise, path = np.random.default_rng(1), tmp_path_factory.mktemp("zema") / "hydraulic.zip"
    levels = [c for c in itertools.product(*(check.levels for check in CHECKS)) for _ in range(2)]
    rows = [cycle(*one, noise) for one in levels]
    profile = [(*one, int(n % 96 == 0)) for n, one in enumerate(levels)]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, table in [("profile", profile), *((n, [r[n] for r in rows]) for n in SENSORS)]:
            digits = "%.4g" if name[0] == "T" else "%.3f"
            np.savetxt(text := io.StringIO(), table, digits, "\t")
            file.writestr(f"{name}.txt", text.getvalue())
    return path


@pytest.fixture(scope="module")
def recording(archive):
    """What was read of it."""
    return read(archive)[0]


@pytest.mark.parametrize(
    ("name", "truth", "tolerance"),
    [
        ("cooler", COOLERS, 0.1),  # W/K; noise and digits of temperatures: 4e-4 K of drops of at least 3 K
        ("valve", LAGS, 1e-3),  # s; noise of pressure: 1e-3 of 117 bar
        ("pump", LEAKS, 1e-3),  # L/min; noise of the flow
        ("accumulator", {v: v for v in (130, 115, 100, 90)}, 0.5),  # bar; the grid of PRECHARGE
    ],
)
def test_sizes_and_levels_are_those_that_were_set(recording, name, truth, tolerance):
    """By other runs, and at another oil temperature; each worn cycle alarms."""
    check = next(c for c in CHECKS if c.name == name)
    level = recording.level(name)
    for part in parts(recording, check.apart).values():
        size, nearest, alarm = judged(check, recording, part)
        for value, expected in truth.items():
            np.testing.assert_allclose(size[level == value], expected, atol=tolerance)
        assert np.array_equal(nearest, level)
        assert alarm[level != check.levels[0]].all()
        assert alarm[level == check.levels[0]].mean() < 0.03  # three deviations of noise; two would be 0.025
    counts = counted(check, recording, nearest)
    assert counts.sum() == recording.stable.sum()
    assert np.trace(counts) == counts.sum()


def test_a_load_that_is_not_reached_is_not_told(recording):
    """The accumulator of such a cycle has no size; the pump has one by the other loads."""
    flow = recording["FS1"].copy()
    flow[7, 23:28] = 1 * LITRE
    other = zema.Recording({**recording.sensors, "FS1": flow}, recording.levels, recording.stable)
    assert np.flatnonzero(np.isnan(zema.precharge(other, other.stable))).tolist() == [7]
    assert np.isfinite(zema.missing_flow(other, other.stable)).all()


def run(monkeypatch, *arguments):
    """The command."""
    monkeypatch.setattr(sys, "argv", ["zema", *map(str, arguments)])
    zema.main()


def test_the_command_prints_each_check(archive, monkeypatch, capsys):
    """With balanced accuracy, and what was published."""
    run(monkeypatch, "--data", archive)
    printed = capsys.readouterr().out
    assert printed.count("balanced accuracy 100.0%") == 2 * len(CHECKS)
    assert all(text in printed for text in zema.PUBLISHED.values())


def test_a_sensor_that_is_missing_leaves_out_its_check(archive, tmp_path, monkeypatch, capsys):
    """With a line; the others are made, here from a folder."""
    with zipfile.ZipFile(archive) as file:
        file.extractall(tmp_path)
    (tmp_path / "TS4.txt").unlink()
    run(monkeypatch, "--data", tmp_path)
    printed = capsys.readouterr().out
    assert f"{tmp_path}: no TS4.txt\n" in printed
    assert "cooler: left out, needs TS4\n" in printed
    assert printed.count("balanced accuracy") == 6


def no_network(*_, **__):
    """As without a network."""
    raise URLError("no route to host")


def test_what_is_wrong_is_told_in_one_line(archive, tmp_path, monkeypatch):
    """No network, no such file, another file, a sensor of other cycles."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(zema, "urlopen", no_network)
    other, folder = tmp_path / "other.zip", tmp_path / "folder"
    other.write_text("no archive")
    with zipfile.ZipFile(archive) as file:
        file.extractall(folder)
    (folder / "FS1.txt").write_text("1\t2\t3\n")
    cases = {
        "no route to host; fetch it elsewhere": [],
        "nowhere: no such file": ["--data", "nowhere"],
        "neither a folder nor a zip": ["--data", other],
        "no profile.txt": ["--data", tmp_path],
        "FS1.txt has 1 cycles of 3 samples": ["--data", folder],
    }
    for text, arguments in cases.items():
        with pytest.raises(SystemExit, match=text) as stopped:
            run(monkeypatch, *arguments)
        assert "\n" not in str(stopped.value)
