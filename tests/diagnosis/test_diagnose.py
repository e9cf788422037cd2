"""`harvester diagnose`: what it makes of recordings as they come."""

import re

import numpy as np
import pandas as pd
import pytest
from kit.mistakes import problem, table

from orchestrator import read_trace
from orchestrator.__main__ import main
from orchestrator.base.files import Location
from orchestrator.data.trace import trace_of
from orchestrator.results.diagnosis import Diagnosis, Finding, _named, diagnose, learned, readings

COMMANDS = ("swing_command", "boom_command", "stick_command")


@pytest.fixture
def columns():
    """Two seconds of readings that change, of an arm that rests; the pressures hold it."""
    return resting(2.0)


def resting(length):
    """The same over a time [s]."""
    rng, time = np.random.default_rng(2), np.arange(0, length + 0.005, 0.01)
    sizes = {"boom_angle": 0.3, "stick_angle": -1.5, "swing_angle": 0.1}
    sizes |= {"supply_pressure": 2e7, "tank_pressure": 4e5}
    sizes |= {"boom_head_pressure": 8.8e6, "boom_rod_pressure": 1.7e6}
    sizes |= {"stick_head_pressure": 1.1e6, "stick_rod_pressure": 3.4e6}
    sizes |= {"swing_pressure_a": 3e6, "swing_pressure_b": 3e6, "oil_temperature": 330.0}
    found = {"time": time} | {n: v * (1 + 1e-3 * rng.normal(size=len(time))) for n, v in sizes.items()}
    found |= {f"{a}_speed": 2e-3 * rng.normal(size=len(time)) for a in ("swing", "boom", "stick")}
    return found | {n: 0.1 * np.sin(time + k) for k, n in enumerate(COMMANDS)}


def written(folder, columns, name="log.csv"):
    """A recording as a file."""
    pd.DataFrame(columns).to_csv(folder / name, index=False, float_format="%.9g")
    return folder / name


@pytest.fixture
def told(fmu, columns, tmp_path, capsys):
    """told(): status and text of the command."""

    def diagnosed():
        file = written(tmp_path, columns)
        return main(["diagnose", str(file), f"--fmu={fmu}", f"--out={tmp_path}"]), capsys.readouterr().out

    return diagnosed


def test_a_recording_without_a_fault_ends_with_status_0(told, columns, tmp_path, monkeypatch):
    """What cannot be told comes first; it is said that nothing was found, and where the report is."""
    monkeypatch.setattr("orchestrator.results.diagnosis.ENOUGH", 20.0)
    columns |= resting(20.0)
    status, told = told()
    assert not status
    assert told.index("Cannot be told at the end: ") < told.index("log.csv: nothing found")
    assert "Nothing found." in (tmp_path / "diagnosis.html").read_text()


def without_pressures(columns):
    """As of a log of angles and commands alone."""
    for name in [n for n in columns if "pressure" in n]:
        del columns[name]


LITTLE = {
    "only 2 s of readings, expected 180 s": (180.0, lambda _: None),
    "only ": (2.0, without_pressures),
}


@pytest.mark.parametrize("lacking", LITTLE)
def test_a_recording_that_is_not_enough_ends_with_status_3(told, columns, lacking, monkeypatch):
    """Seconds of readings, or none of the pressures: nothing was found, which says nothing."""
    enough, change = LITTLE[lacking]
    monkeypatch.setattr("orchestrator.results.diagnosis.ENOUGH", enough)
    change(columns)
    status, text = told()
    assert status == 3
    assert f"not known whether it is healthy: {lacking}" in text


def test_a_sensor_that_is_not_connected_ends_with_status_1(told, columns, tmp_path):
    """The reading and the sensor are named, in the table and in the report."""
    columns["boom_rod_pressure"][120:] = -1.5e7
    status, told = told()
    assert status == 1
    assert "The reading of boom rod pressure is wrong" in told
    assert "boom rod pressure sensor" in told
    assert "<h2>The reading of boom rod pressure is wrong</h2>" in (tmp_path / "diagnosis.html").read_text()


def test_findings_of_a_long_recording_are_stored_less_often(fmu, columns, tmp_path, monkeypatch):
    """A day of work fits into memory; what is told, and since when, is the same to the coarser step."""
    columns["boom_rod_pressure"][120:] = -1.5e7
    file = written(tmp_path, columns)
    fine = diagnose(fmu, file)
    monkeypatch.setattr("orchestrator.results.diagnosis.ROWS", 50)
    coarse = diagnose(fmu, file)
    assert len(coarse.result.time) <= 51 < len(fine.result.time)
    assert [f.name for f in coarse.broken] == [f.name for f in fine.broken] != []
    for a, b in zip(coarse.broken, fine.broken, strict=True):
        assert a.since == pytest.approx(b.since, abs=0.04)


def test_what_can_hardly_be_judged_does_not_read_as_healthy(told, columns, tmp_path, monkeypatch):
    """Two arms of three without pressures: status 3, in words and in the report."""
    monkeypatch.setattr("orchestrator.results.diagnosis.ENOUGH", 2.0)
    lost = [n for n in columns if n.startswith(("swing_pressure", "stick_", "supply", "tank"))]
    for name in (n for n in lost if not n.endswith("command")):
        del columns[name]
    status, text = told()
    assert status == 3
    assert "log.csv: not known whether it is healthy: only " in text
    assert "Not known whether it is healthy: only " in (tmp_path / "diagnosis.html").read_text()


@pytest.mark.parametrize(("every", "is_told"), [(1, True), (2, False), (10, False)])
def test_a_slow_log_is_told_and_a_few_equal_readings_are_no_fault(fmu, columns, tmp_path, every, is_told):
    """A pressure that stands still for 0.25 s: 25 readings of 100 Hz, but three of 10 Hz."""
    columns["stick_rod_pressure"] = 3.4e6 + 1e6 * np.sin(3 * columns["time"])
    columns["stick_head_pressure"] = 3e6 + 2e6 * np.cos(3 * columns["time"])
    columns["stick_head_pressure"][100:125] = columns["stick_head_pressure"][100]
    found = diagnose(fmu, written(tmp_path, {n: c[::every] for n, c in columns.items()}))
    assert ("stick_head_pressure_sensor" in [f.name for f in found.broken]) == is_told
    remarks = [line for line in found.remarks if " Hz, expected 100 Hz or more: " in line]
    assert len(remarks) == (every > 1)
    for line in remarks:
        assert all(text in line for text in (f"log.csv: {100 / every:.3g} Hz", f"over {every} times as long"))


def test_a_log_below_10_hz_is_refused(fmu, columns, tmp_path):
    """Nothing is certain at 8 Hz, nor at one sample a second."""
    for every in (12, 100):
        file = written(tmp_path, {n: c[::every] for n, c in columns.items()})
        problem(lambda file=file: diagnose(fmu, file), r"Hz, expected 100 Hz or more, at least 9\.5 Hz")


@pytest.mark.parametrize("late", [1e9, 4000.0])
def test_readings_that_stop_for_long_are_refused(fmu, columns, tmp_path, late):
    """One wrong time would be ten million years of work in which nothing was measured."""
    columns["time"] = np.append(columns["time"][:-1], late)
    told = rf"log.csv: expected readings all the time, got none from 1\.99 s to {late:g} s"
    problem(lambda: diagnose(fmu, written(tmp_path, columns)), told.replace("+", r"\+"))


def test_findings_that_are_judged_together_are_told_so():
    """What may be healthy alone is left out beside a certain size of its part; else one of them is told."""

    def finding(name, size, deviation, healthy):
        one = (np.array([v]) for v in (0.0, size, deviation, 1.0))
        return Finding(name, f"Size of {name}", "1", "valve", *one, healthy)

    gain, band = finding("gain", 0.6, 0.3, 1.0), finding("band", 0.2, 0.6, 0.0)
    leak = finding("leak", 0.6, 0.1, 0.0)
    for found, names in (([gain, band], ["gain"]), ([gain, leak], ["leak"]), ([leak], ["leak"])):
        told = Diagnosis("log", found, None, ())
        assert [f.name for f in told.broken] == names
        assert told.verdict.startswith("1 fault found")
        assert ("its interval holds the healthy size" in told.text()) == (names == ["gain"])


@pytest.mark.parametrize("factor", [180 / np.pi, np.pi / 180, 1e3])
def test_a_gyro_in_another_unit_is_named(fmu, columns, tmp_path, factor):
    """Beside its angle, without units in the file: those are the FMU's."""
    columns["boom_angle"] = 0.3 + 0.2 * np.sin(3 * columns["time"])
    columns["boom_speed"] = factor * 0.6 * np.cos(3 * columns["time"])
    (line,) = diagnose(fmu, written(tmp_path, columns)).remarks
    assert f"log.csv: boom_speed: {factor:.3g} times as fast as boom_angle changes: " in line


@table(__file__, "lacking", "states, name")
def test_a_column_that_is_missing_is_named_and_the_rest_goes_on(fmu, columns, tmp_path, states, name):
    """One line; what needs it cannot be told, and what does not still can."""
    del columns[name]
    found = diagnose(fmu, written(tmp_path, columns))
    (line,) = found.remarks
    assert f"no column {name}" in line
    assert not found.broken
    state = {f.name: f.state[-1] for f in found.findings}
    assert {n: state[n] for n in states} == states


def test_a_reading_that_is_constant_counts_as_missing(fmu, columns, tmp_path):
    """With its value, and without an alarm: the logger may have had no sensor there."""
    columns["stick_rod_pressure"][:] = 4.2e6
    found = diagnose(fmu, written(tmp_path, columns))
    (line,) = found.remarks
    assert "stick_rod_pressure is 4.2e+06 all the time" in line
    assert not found.broken


@pytest.mark.parametrize("without", [(), ("speed",), ("speed", "pressure")])
@pytest.mark.parametrize("function", ["swing", "boom", "stick"])
def test_a_function_that_stands_still_has_no_missing_sensor(fmu, columns, tmp_path, function, without):
    """5 V do not move it: its angle is constant, and true. It is its valve, unless all of it is constant."""
    own = [n for n in columns if n.startswith(f"{function}_") and any(part in n for part in without)]
    for n in (f"{function}_angle", *own):
        columns[n] = np.full(len(columns["time"]), columns[n][0])
    columns[f"{function}_command"] = 5.0 * np.clip(columns["time"] - 0.5, 0, 1)
    found = diagnose(fmu, written(tmp_path, columns))
    line = "its sensor counts as missing" if "pressure" in without else f"the {function} stands still under"
    assert f"{function}_angle is" in found.remarks[0]
    assert all(line in remark for remark in found.remarks)
    assert [f.repair for f in found.broken] == ([] if "pressure" in without else [f"{function} valve"])
    states = {f.name: f.state for f in found.findings}
    assert (states[f"{function}_angle_sensor"] == -1).all()  # it may stand still as well
    assert states["supply_pressure_sensor"][-1] == 0


def moves_by_gyro(columns):
    """0.2 rad/s for half a second, to and fro."""
    columns["swing_speed"] = columns["swing_speed"] + 0.2 * np.sign(np.sin(2 * np.pi * columns["time"]))


def moves_by_pressures(columns):
    """No gyro; an open valve brings both lines to the middle between supply and return line, by 70 bar."""
    del columns["swing_speed"]
    for n in ("swing_pressure_a", "swing_pressure_b"):
        columns[n] = columns[n] + 7e6 * (np.abs(columns["swing_command"]) > 1)


@pytest.mark.parametrize("moves", [moves_by_gyro, moves_by_pressures])
@pytest.mark.parametrize("value", [0.0, 0.7])
def test_a_constant_angle_of_a_function_that_moves_is_a_missing_sensor(fmu, columns, tmp_path, moves, value):
    """Its value does not matter; nothing is told of the valve."""
    columns["swing_angle"] = np.full(len(columns["time"]), value)
    columns["swing_command"] = 5.0 * np.clip(columns["time"] - 0.5, 0, 1)
    moves(columns)
    found = diagnose(fmu, written(tmp_path, columns))
    assert f"swing_angle is {value:g} all the time; its sensor counts as missing" in found.remarks[0]
    assert not found.broken


def test_rows_out_of_order_are_sorted(columns, tmp_path, capsys):
    """The readings are those of the rows in order, with a line that counts what was out of order."""
    rows = np.arange(len(columns["time"]))
    rows[50:60] = rows[50:60][::-1]
    file = written(tmp_path, {n: c[rows] for n, c in columns.items()})
    trace = readings(file)
    assert trace.time == pytest.approx(columns["time"])
    assert trace["boom_angle"] == pytest.approx(columns["boom_angle"], rel=1e-8)
    assert "out of order" in capsys.readouterr().err
    problem(lambda: trace_of(Location(file), None), "expected a time after")


def test_which_readings_count(tmp_path):
    """Of two rows at one time the last counts; of a run that of the component, then that behind a sensor."""
    file = tmp_path / "twice.csv"
    file.write_text("time,a\n0,1\n1,2\n1,3\n2,4\n1,9\n")
    assert readings(file)["a"].tolist() == [1, 9, 4]
    file = tmp_path / "run.csv"
    file.write_text("time,part.a,sensors.a_measured\n0,1,2\n1,1,3\n2,1,4\n")
    assert _named(read_trace(file), "diagnosis", ["a"], file)["a"].tolist() == [2, 3, 4]
    assert _named(read_trace(file), "part", ["a"], file)["a"].tolist() == [1, 1, 1]


def test_missing_samples_keep_the_one_before(columns, tmp_path, capsys):
    """With a line; a column without any value is a missing one."""
    columns["boom_angle"][30:40] = np.nan
    columns["stick_angle"][:] = np.nan
    trace = readings(written(tmp_path, columns))
    assert trace["boom_angle"][39] == pytest.approx(columns["boom_angle"][29])
    assert "stick_angle" not in trace
    told = capsys.readouterr().err
    assert "boom_angle lacks 10 of 201 samples" in told
    assert "stick_angle has no values" in told


def test_pressures_in_bar_are_told_or_converted(fmu, columns, tmp_path):
    """Without units they count as Pa, which is doubted; `supply_pressure [bar]` is the same reading."""
    bar = {n: v / 1e5 if "pressure" in n else v for n, v in columns.items()}
    found = diagnose(fmu, written(tmp_path, bar))
    assert any("did you mean" in line and "bar" in line for line in found.remarks)
    bar = dict((f"{n} [bar]", v / 1e5) if "pressure" in n else (n, v) for n, v in columns.items())
    one, other = (diagnose(fmu, written(tmp_path, c, f"{k}.csv")) for k, c in enumerate((columns, bar)))
    for f, g in zip(one.findings, other.findings, strict=True):
        assert g.size == pytest.approx(f.size, rel=1e-4, abs=1e-4 * max(abs(f.size).max(), 1e-12)), f.name


@pytest.mark.parametrize(
    ("name", "factor", "offset", "meant"),
    [("oil_temperature", 1, -273.15, "degC"), ("boom_command", 1000, 0, "%"), ("stick_command", 300, 0, "%")],
)
def test_readings_in_a_unit_that_cannot_be_are_refused(fmu, columns, tmp_path, name, factor, offset, meant):
    """Oil of 57 K; commands beyond one and a half times that which opens the valve."""
    columns[name] = factor * columns[name] + offset
    problem(lambda: diagnose(fmu, written(tmp_path, columns)), rf"{name}: expected .*; did you mean {meant}")


def gap(columns):
    """Readings of half a second are missing."""
    for n in columns:
        columns[n] = np.delete(columns[n], slice(80, 130))


def splice(columns):
    """Two recordings in one: all angles are others from one reading to the next."""
    for n in (n for n in columns if n.endswith("angle")):
        columns[n][120:] += 0.3


def outlier(columns):
    """The code of a bus for a reading that is not available."""
    columns["boom_rod_pressure"][70] = 6.5535e8


def hold(columns):
    """Pressures every 50 ms, in a log of 100 Hz; they change, as a held one does not stand still."""
    rows = np.arange(len(columns["time"])) // 5 * 5
    for n in (n for n in columns if n.endswith("pressure")):
        columns[n] = (columns[n] * (1 + 0.2 * np.sin(3 * columns["time"])))[rows]


INTERRUPTED = {
    "gaps of readings: 1, the longest of 0.51 s; nothing is judged in them": gap,
    "two or more angles jump at 1.2 s: two recordings?": splice,
    "boom_rod_pressure: outliers left out, far from the readings before and after: 1": outlier,
    "20 Hz, expected 100 Hz or more": hold,
}


@pytest.mark.parametrize("line", INTERRUPTED)
def test_what_a_logger_does_is_told_and_no_fault(fmu, columns, tmp_path, line):
    """Each in a line; nothing is told of the machine because of it."""
    INTERRUPTED[line](columns)
    found = diagnose(fmu, written(tmp_path, columns))
    assert any(line in remark for remark in found.remarks)
    assert [f.name for f in found.broken] == []


def test_an_arm_that_is_shaken_has_no_outliers(fmu, tmp_path):
    """Readings of a simulated stick at 50 Hz; the column stops with 727 kg in a swinging head: all are true.

    Without the one of -2.558 rad/s, which is far from both beside it, the angle jumps.
    """
    angle = [-0.947, -0.951, -0.983, -0.991, -0.935, -0.953, -0.963, -0.932, -0.963, -0.948, -0.950, -0.969]
    speed = [0.005, -0.770, -1.779, 1.460, 2.329, -2.558, 1.758, -0.479, -0.794, 1.459, -1.517, 0.039]
    columns = resting(8.0)
    columns["time"] = 2 * columns["time"]
    columns["stick_angle"][:] = angle[0]
    columns["stick_angle"][70:82], columns["stick_speed"][70:82] = angle, speed
    columns["stick_angle"][82:] = angle[-1]
    found = diagnose(fmu, written(tmp_path, columns))
    assert not any("outliers" in remark for remark in found.remarks)
    assert "stick_angle_sensor" not in [f.name for f in found.broken]


def test_a_supply_that_sags_with_a_chamber_is_no_outlier(fmu, columns, tmp_path):
    """One row of both, half as far in the chamber: a pump that is overrun."""
    columns["supply_pressure"][120] -= 8e6
    columns["boom_head_pressure"][120] -= 4e6
    found = diagnose(fmu, written(tmp_path, columns))
    assert not any("outliers" in remark for remark in found.remarks)


@pytest.mark.parametrize(("bar", "degree"), [(0.1, 0.01), (0.5, 0.05), (1.0, 0.1)])
def test_rounded_readings_are_no_wrong_sensors(fmu, columns, tmp_path, bar, degree):
    """A slow joint whose angle is even for some readings, and a pressure beside one that changes.

    The resolution is taken from the readings; with that of the FMU both are told from 0.5 bar on. One step of
    a supply pressure that is held is no outlier.
    """
    time = columns["time"]
    columns["boom_angle"], columns["boom_speed"] = 0.3 + 0.03 * time, 0.03 + 0 * time
    columns["boom_speed"] += 2e-3 * np.random.default_rng(1).normal(size=len(time))
    columns["boom_head_pressure"] = 8.8e6 + 5e5 * np.sin(4 * time)
    columns["boom_rod_pressure"] = 1.7e6 + 4e4 * np.sin(4 * time)
    for n in (n for n in columns if n.endswith(("pressure", "pressure_a", "pressure_b", "angle"))):
        step = np.radians(degree) if n.endswith("angle") else 1e5 * bar
        columns[n] = step * np.round(columns[n] / step)
    columns["supply_pressure"][:] = 2e7
    columns["supply_pressure"][70] += 1e5 * bar
    found = diagnose(fmu, written(tmp_path, columns))
    assert [f.name for f in found.broken] == []
    assert not any("outliers" in remark for remark in found.remarks)


def lacking(columns, *instead):
    """Without the command of the boom, with these in place of it."""
    others = {n: v for n, v in columns.items() if n != "boom_command"}
    return others | dict.fromkeys(instead, columns["boom_command"])


REFUSED = {
    r"no column has the name of an input of diagnosis\.fmu: .*log\.toml .* harvester describe ": lambda c: {
        "time": c["time"],
        "speed": c["time"],
    },
    "expected the column boom_command": lacking,
    r"expected one column boom_command, got a\.boom_command, b\.boom_command": lambda c: lacking(
        c, "a.boom_command", "b.boom_command"
    ),
    "expected one column boom_angle, got boom_angle, part.boom_angle": lambda c: (
        c | {"part.boom_angle": c["boom_angle"]}
    ),
    r"expected one column boom_command, got part\.boom_command, sensors\.boom_command_measured": lambda c: (
        lacking(c, "part.boom_command", "sensors.boom_command_measured")
    ),
    r"log\.csv: boom_command: expected a unit like V, got %": lambda c: lacking(c, "boom_command [%]"),
}


@pytest.mark.parametrize("message", REFUSED)
def test_a_recording_without_the_inputs_is_refused(fmu, columns, tmp_path, message):
    """Of something else; without a command, with one in %, or with two columns of one reading."""
    problem(lambda: diagnose(fmu, written(tmp_path, REFUSED[message](columns))), message)


def test_another_fmu_is_refused(fmu_dir, columns, tmp_path):
    """It has no findings."""
    told = "no column|expected outputs NAME, NAME_deviation and NAME_state"
    problem(lambda: diagnose(fmu_dir / "swing.fmu", written(tmp_path, columns)), told)


def test_what_is_learned_is_a_parameter_set(fmu, columns, tmp_path):
    """It is read back with the values that were found."""
    file, target = written(tmp_path, columns), tmp_path / "healthy.ssv"
    found = diagnose(fmu, file)
    target.write_bytes(learned(found))
    again = diagnose(fmu, file, [target])
    assert {f.name for f in again.findings} == {f.name for f in found.findings}


def test_a_broken_machine_is_not_learned_without_a_word(fmu, columns, tmp_path, capsys):
    """What is broken even by the values that were learned is told, with status 1, and how many these are."""
    lines, arguments = [], [f"--fmu={fmu}", f"--learn={tmp_path / 'healthy.ssv'}", f"--out={tmp_path}"]
    for status in (0, 1):
        assert main(["diagnose", str(written(tmp_path, columns)), *arguments]) == status
        lines.append(capsys.readouterr().out)
        columns["boom_rod_pressure"][120:] = -1.5e7
    for out in lines:
        assert re.search(r"healthy\.ssv: \d+ of \d+ values of the healthy machine; not learned: swing_", out)
    fault = "warning: not a healthy machine: The reading of boom rod pressure is wrong; look at: boom rod"
    assert [fault in out for out in lines] == [False, True]


@pytest.mark.parametrize(("unit", "factor", "is_told"), [("bar", 1e-5, False), ("psi", 1e-5, True)])
def test_pressures_with_the_unit_of_others_are_told(fmu, columns, tmp_path, unit, factor, is_told):
    """The highest supply pressure is far from the nominal one: bar in the file are named psi."""
    named = dict((f"{n} [{unit}]", factor * v) if "pressure" in n else (n, v) for n, v in columns.items())
    remarks = diagnose(fmu, written(tmp_path, named)).remarks
    assert any("is the unit of the readings right?" in line for line in remarks) == is_told


def test_a_folder_is_no_recording(fmu, tmp_path):
    """One line."""
    problem(lambda: diagnose(fmu, tmp_path), "expected a file, got a folder")


def test_the_default_fmu_has_a_hint(tmp_path, columns, capsys, monkeypatch):
    """One line that says how to make it."""
    monkeypatch.chdir(tmp_path)
    assert main(["diagnose", str(written(tmp_path, columns))]) == 2
    told = "no such file; name one with --fmu FILE, or make it with: harvester build --faults --fmi 2 --out "
    assert told in capsys.readouterr().err
