"""`harvester describe`: what it writes is read after names were filled in; it names what a column may be."""

import re

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from identification.recordings.conftest import edit
from kit.mistakes import problem

from fmus.identification.recordings.describe import SENSORS, describe
from fmus.identification.recordings.reading import read
from orchestrator import assemble, run
from orchestrator.data.recording import read_recording
from orchestrator.ssp.load import load

K = np.arange(400)
COLUMNS = {
    "t_ms": 5 * K,
    "Hebel Hub [V]": np.round(6 * np.sin(K / 60), 3),
    "Druck Kolben [bar]": np.round(120 + 30 * np.sin(K / 50), 2),
    "DRUCK_STANGE_psi": np.round(900 + 300 * np.cos(K / 50), 1),
    "manipulator.boom_angle [deg]": np.round(20 + 9 * np.sin(K / 90), 3),
    "stick_angle": np.round(-40 + 9 * np.sin(K / 80), 3),
    "AI_7 (mA)": np.round(9 + 3 * np.sin(K / 70), 3),
}


@pytest.fixture
def log(tmp_path):
    """The columns as a CSV file of a logger."""
    pd.DataFrame(COLUMNS).to_csv(tmp_path / "a.csv", index=False)
    return tmp_path / "a.csv"


def described(folder, columns, **options):
    """What is shown of a log with these columns, and the TOML file that is written."""
    pd.DataFrame(columns).to_csv(folder / "a.csv", index=False)
    shown = describe(folder / "a.csv", **options)
    return shown, (folder / "a.toml").read_text(encoding="utf-8")


def filled_in(file, **units):
    """As a user does it: the lines of all signals without a mark, units in place of "?"."""
    text = re.sub('^# (?=")|.*"NAME".*', "", file.read_text(encoding="utf-8"), flags=re.MULTILINE)
    for column, unit in units.items():
        text = re.sub(rf'("{column}".*unit = )"\?"', rf'\1"{unit}"', text)
    file.write_text(text, encoding="utf-8")


def test_the_file_is_read_after_the_names_are_filled_in(log):
    """Values in SI units are those of the columns."""
    shown = describe(log, procedure="machine")
    filled_in(log.with_suffix(".toml"), stick_angle="deg")
    made = read(log)
    assert (made.procedure, made.source) == ("machine", log)
    expected = {
        "boom_stick.boom_command": COLUMNS["Hebel Hub [V]"],
        "boom_stick.boom_head_pressure": 1e5 * COLUMNS["Druck Kolben [bar]"],
        # NIST SP 811: 1 psi = 6894.757 Pa, seven digits
        "boom_stick.boom_rod_pressure": 6894.757 * COLUMNS["DRUCK_STANGE_psi"],
        "manipulator.boom_angle": np.radians(COLUMNS["manipulator.boom_angle [deg]"]),
        "manipulator.stick_angle": np.radians(COLUMNS["stick_angle"]),
    }
    assert made.signals.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_allclose(made[name], values, rtol=1e-7)  # digits of psi
    np.testing.assert_allclose(made.time, 0.005 * K, atol=1e-12)  # rounding
    assert shown.splitlines()[0] == f"{log}: 400 rows at 200 Hz, time in 't_ms' [ms]"
    assert re.search(r"\nAI_7 \(mA\): 6\S* to 12 mA; anything", shown)


def test_what_remains_a_comment_is_left_out(log):
    """Some names are enough; without any, one line says what is missing."""
    for column in ("Hebel Hub [V]", "manipulator.boom_angle [deg]"):
        edit(log, (column, "AI 1 [V]" if column.endswith("[V]") else "AI 2 [deg]"))
    describe(log)
    problem(lambda: read_recording(log), r"a\.toml: expected at least one table \[signals\.NAME\], got none")
    edit(log.with_suffix(".toml"), ('# "boom_stick.boom_rod', '"boom_stick.boom_rod'))
    assert [*read_recording(log)] == ["boom_stick.boom_rod_pressure"]


def test_a_column_that_can_be_one_signal_only_is_no_comment(tmp_path):
    """By its unit and the words in its name; without a unit, or for a second such column, it is one."""
    columns = {"Zeit [s]": K / 50, "Hub Soll [V]": K % 7}
    columns |= {"Winkel Ausleger (deg)": K % 5, "P Tank [bar]": K % 3}
    unsure = {"Hebel Schwenk": K % 4, "P Kolben [bar]": K % 11, "Druck Tank 2 [bar]": K % 9}
    described(tmp_path, columns | unsure)
    expected = ["boom_stick.boom_command", "manipulator.boom_angle", "swing.tank_pressure"]
    assert [*read_recording(tmp_path / "a.csv")] == expected


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".mat"])
def test_the_trace_of_a_run_is_described_as_it_is(suffix, fmus, tmp_path):
    """All signals with their units, whatever they measure, also those that jump by 360 or have no sensor."""
    system = assemble({"g": fmus.make("gain", units={"u": "bar", "y": "kg"})}, [])
    columns = {"time": K / 50, "g.u": 360 * K + 7e6}
    data = run(system, columns, stop=7, step=0.01, record_step=0.02).write(tmp_path / f"run{suffix}")
    text = describe(data)
    assert "wrap" not in text
    read_back = read_recording(data)
    assert ({*read_back}, dict(read_back.units)) == ({"g.u", "g.y"}, {"g.u": "Pa", "g.y": "kg"})


def test_a_column_with_the_name_of_a_signal_is_described_at_once(tmp_path):
    """In any letter case, with or without the part, if the unit of the file is one of the signal."""
    # without units it cannot know
    described(tmp_path, {"time": K / 50, "BOOM_COMMAND": K % 7, "swing.supply_pressure": K % 5})
    problem(lambda: read_recording(tmp_path / "a.csv"), "expected at least one table")
    fields = {"time": "s", "BOOM_COMMAND": "V", "swing.supply_pressure": "bar", "boom_angle": "Pa"}
    table = pa.table({name: K / 50 for name in fields})
    units = [pa.field(name, pa.float64(), metadata={"unit": unit}) for name, unit in fields.items()]
    pq.write_table(table.cast(pa.schema(units)), tmp_path / "b.parquet")
    describe(tmp_path / "b.parquet")
    assert [*read_recording(tmp_path / "b.parquet")] == ["boom_stick.boom_command", "swing.supply_pressure"]


@pytest.mark.parametrize(
    ("step", "unit", "rows"),
    [
        *((0.02, "s", 400), (0.5, "s", 400), (20, "ms", 400), (1000, "us", 400), (2e6, "ns", 400)),
        *((1, "s", 3), (1, "s", 60), (5, "s", 50), (5, "ms", 400), (1, "ms", 2000), (20, "ms", 3)),
    ],
)
def test_the_unit_of_time_is_that_of_a_logger(step, unit, rows, tmp_path):
    """In the largest unit in which the log has 2 Hz or more; the column need not be the first one.

    A log in steps of a few that would last less than half a second in ms is in seconds.
    """
    k = np.arange(rows)
    text = described(tmp_path, {"n": k, "U": np.sin(k), "Zeit": step * k})[1]
    assert f'column = "Zeit"\nunit = "{unit}"' in text


def test_faults_are_named(tmp_path):
    """Gaps, clipped and constant channels in a line each and in sentences; columns of texts are left out."""
    rng = np.random.default_rng(5)
    pressure = np.round(np.minimum(100 + 8 * np.sin(K / 40) + rng.normal(0, 0.1, K.size), 105), 2)
    flow = np.where((K > 100) & (K < 141), np.nan, 30 + np.sin(K / 9))
    data = {"t": K / 200, "p_bar": pressure, "Q [L/min]": flow, "off": 7, "mode": "auto"}
    shown, _ = described(tmp_path, data)
    assert re.search(r"\np_bar: 9\S+ to 105 bar; clipped \d+ %", shown)
    assert re.search(r"\nQ \[L/min\]: \S+ to \S+ L/min; gaps 10 %", shown)
    assert re.search(r"\noff: 7 to 7 \?; constant", shown)
    assert "a.csv: line 2: column 'mode': expected a number, got 'auto'; left out\n" in shown
    assert "\nQ [L/min]: 40 samples (10 %; first at 0.505 s, longest 0.2 s) without a sample.\n" in shown


def test_a_bench_has_the_names_and_conditions_of_its_procedure(tmp_path):
    """Those that the procedure reads, here of a valve."""
    _, text = described(tmp_path, {"t": K / 200, "U [V]": K % 9, "Q [L/min]": 3 * K}, procedure="valve")
    conditions = '# edge = "P-A"  # or "B-T", "P-B", "A-T"\n# density = { value = ?, unit = "kg/m3" }\n'
    assert f'[experiment]\nprocedure = "valve"\n{conditions}' in text
    describe(tmp_path / "a.csv", tmp_path / "valve.toml", procedure="valve")
    filled_in(tmp_path / "valve.toml")
    assert [*read(tmp_path / "valve.toml")] == ["command", "flow"]


def test_the_keys_of_an_instrument_stand_behind_its_line(tmp_path):
    """As the samples show them, in the unit of the file; digits of the file are no resolution."""
    rng = np.random.default_rng(4)
    flow = 30 * np.sin(K / 40) + rng.normal(0, 0.3, K.size)
    flow = np.where(K % 2, np.nan, np.where(np.abs(flow) < 10, 0, np.round(flow, 4)))
    pressure = np.round((100 + 9 * np.sin(K / 30) + rng.normal(0, 0.1, K.size)) / 0.1) * 0.1
    shown, text = described(tmp_path, {"t": K / 200, "Q [L/min]": flow, "p [bar]": pressure})
    assert "Q [L/min]: reads 0 or at least 10" in shown
    q, p = (line for line in text.splitlines() if "as the samples show" in line)
    # least of 100 readings above 10 L/min, whose slope is 0.75 L/min
    assert float(re.search(r"dead_zone = ([\d.]+),", q)[1]) == pytest.approx(10, abs=1)
    assert "resolution" not in q
    # standard error 1.8 / sqrt(400) = 9 %, three times that, and what rounding adds
    assert float(re.search(r"noise = ([\d.]+),", p)[1]) == pytest.approx(np.hypot(0.1, 0.03), rel=0.3)
    assert p.endswith("resolution = 0.1")


def test_limits_are_proposed_and_only_signals_that_validate_reads(tmp_path):
    """A whole block; the oil's temperature is one of recordings for an identification."""
    data = {"t": K / 200, "p_bar": K % 7, "boom_angle [deg]": K % 9, "Öltemperatur [°C]": 40 + K % 3}
    _, text = described(tmp_path, data)
    assert "oil_temperature" not in text
    (tmp_path / "a.toml").write_text(re.sub("# (.tolerances|angle|pressure)", r"\1", text), encoding="utf-8")
    filled_in(tmp_path / "a.toml")
    read_back = read_recording(tmp_path / "a.csv")
    limits = {name: read_back.criterion(name).tolerance.limit for name in read_back}
    assert set(limits.values()) == {0.1}
    assert len(limits) == 2
    assert "oil_temperature" in described(tmp_path, data, procedure="machine", force=True)[1]


def test_the_format_of_an_existing_file_is_used(tmp_path):
    """A file with [file] alone is what a message asks for; its keys remain."""
    (tmp_path / "a.csv").write_text("x\ny\nz\nt|p\n0|1,5\n0,01|2,5\n", encoding="utf-8")
    form = '[file]\ndelimiter = "|"\ndecimal = ","\nskip_lines = 3\n'
    (tmp_path / "a.toml").write_text(form, encoding="utf-8")
    assert "p: 1.5 to 2.5" in describe(tmp_path / "a.csv")
    text = (tmp_path / "a.toml").read_text(encoding="utf-8")
    assert '[file]\ncsv = "a.csv"\ndelimiter = "|"\ndecimal = ","\nskip_lines = 3\n' in text


def test_a_file_without_a_column_to_describe_gets_none(tmp_path):
    """Nor one whose clock repeats a time."""
    (tmp_path / "a.csv").write_text("t;p\n0;on\n1;off\n", encoding="utf-8")
    (tmp_path / "b.csv").write_text("Uhrzeit;p\n10:00:00;1\n10:00:01;2\n10:00:01;3\n", encoding="utf-8")
    for name, message in {"a": r"line 2: column 'p'", "b": r"line 4: column 'Uhrzeit'.*milliseconds"}.items():
        problem(lambda file=tmp_path / f"{name}.csv": describe(file), message)
        assert not (tmp_path / f"{name}.toml").exists()


MISTAKES = {
    "existing": (("a.csv",), r"a\.toml: expected no such file, got one; --force overwrites it"),
    "procedure": (("a.csv", None, "valv"), r"--procedure: expected one of valve, .*, got 'valv'"),
    "folder": (("a.csv", "b/a.toml"), r"--out .*a\.toml: expected a file .*, in the folder of"),
    "suffix": (("a.csv", "a.csv"), r"--out .*a\.csv: expected a file that ends in \.toml"),
    "no time": (("b.csv", "b.toml"), r"b\.csv: expected a column of increasing times, got none among x, y"),
    "no file": (("c.csv", "c.toml"), r"c\.csv: no such file"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_line_and_nothing_is_overwritten(name, log):
    """An existing description stays as it is, unless `force` is given."""
    folder, old = log.parent, log.with_suffix(".toml")
    old.write_text("mine = 1\n", encoding="utf-8")
    (folder / "b.csv").write_text("x,y\n1,2\n1,3\n0,1\n", encoding="utf-8")
    (data, *rest), message = MISTAKES[name]
    arguments = [folder / rest[0] if rest and rest[0] else None, *rest[1:]]
    problem(lambda: describe(folder / data, *arguments), message)
    assert old.read_text(encoding="utf-8") == "mine = 1\n"
    describe(log, force=True)
    assert old.read_text(encoding="utf-8") != "mine = 1\n"


def test_the_sensors_are_signals_of_the_machine(fmu_dir):
    """With their units; the oil temperature is one of every recording."""
    system = load(fmu_dir / "harvester.ssp")
    parts = [(c.name, c.interface) for c in system.components.values()]
    ports = [(name, v) for name, part in parts for k in ("input", "output") for v in part.of(k)]
    units = {f"{name}.{v.name}": v.unit.name for name, v in ports if v.unit}
    sensors = {name: unit for unit, names in SENSORS.items() for name in names}
    assert sensors.pop("oil_temperature") == "K"
    assert sensors == {name: units[name] for name in sensors}
