"""Text files as loggers and Excel write them: the same numbers as a scenario, a recording or a trace."""

import numpy as np
import pytest
from kit.any_fmu.models import Workshop
from kit.mistakes import problem, table

from fmus.identification.recordings.reading import read_series
from orchestrator import Trace, assemble, read_recording, read_trace, run, write_trace
from orchestrator.base import files
from orchestrator.data.table import read_columns, time_axis
from orchestrator.engine.scenario import drive


@pytest.fixture(autouse=True)
def _anew(monkeypatch):
    """Lines that are told once are told in each test."""
    monkeypatch.setattr(files, "_told", set())


@table(__file__, "files", "text, expected, told")
def test_what_loggers_write_is_read(tmp_path, capsys, text, expected, told):
    """Times in s from 0, other values in SI units, and a line that says what was found in the file."""
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    trace, recording = read_trace(path), read_recording(path)
    line = capsys.readouterr().err
    assert all(words in line for words in told.split("|")), line
    assert bool(line) == bool(told)
    np.testing.assert_allclose(trace.time, expected.pop("time"), rtol=0, atol=1e-12)  # six digits are kept
    units = expected.pop("units", {})
    assert (list(trace), dict(trace.units)) == (list(expected), units)
    expected = {name: np.asarray(values, float) for name, values in expected.items()}
    for name, values in expected.items():
        # one factor and one offset: a few roundings
        np.testing.assert_allclose(trace[name], values, rtol=1e-14)
    assert recording.signals.keys() == trace.keys()
    assert all((recording[name] == trace[name]).all() for name in trace)


@table(__file__, "mistakes", "text, message")
def test_what_is_not_clear_is_refused_in_one_line(tmp_path, text, message):
    """File, line, column, what was expected and found, and the way out."""
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    told = problem(lambda: read_trace(path))
    assert told.startswith(str(path))
    assert all(words in told for words in message.split("|")), told


DESCRIBED = """
[file]
delimiter = ";"
decimal = ","
skip_rows = 1
[time]
column = "Zeit"
unit = "ms"
offset = 0.5
[signals.p]
column = "Druck"
unit = "bar"
factor = 40.0
offset = -2.0
[signals.u]
unit = "mV"
"""


def test_one_description_for_every_use(tmp_path):
    """Names, units, calibration and clock of the .toml file hold for a trace, and so for a scenario, too."""
    path = tmp_path / "log.csv"
    path.write_text("Zeit;Druck;egal;u\nStunden;V;psi;V\n0,0;0,25;x;500\n20,5;0,5;y;250\n", encoding="cp1252")
    path.with_suffix(".toml").write_text(DESCRIBED, encoding="utf-8")
    for read in (read_trace, read_recording):
        trace = read(path)
        np.testing.assert_allclose(trace.time, [0.5, 0.5205], rtol=1e-14)  # roundings, here and below
        np.testing.assert_allclose(trace["p"], [8e5, 18e5], rtol=1e-14)
        np.testing.assert_allclose(trace["u"], [0.5, 0.25], rtol=1e-14)
        assert dict(trace.units) == {"p": "Pa", "u": "V"}


def test_a_description_may_only_say_how_the_file_is_written(tmp_path):
    """Then the names in the file hold; a window of the time, too."""
    path = tmp_path / "log.csv"
    path.write_text("Logger 7\nn;Messzeit;u\n1;0;0\n2;500;1,5\n3;1000;2\n", encoding="utf-8")
    meta = '[file]\nskip_lines = 1\n[time]\ncolumn = "Messzeit"\nunit = "ms"\nstart = 0.5\n'
    path.with_suffix(".toml").write_text(meta, encoding="utf-8")
    trace = read_trace(path)
    assert (trace.time.tolist(), trace["u"].tolist()) == ([0.5, 1.0], [1.5, 2.0])


@pytest.mark.parametrize("other", ['system = "a.ssp"\n[factors]\n', "[parameters.x]\nvalue = 1\n"])
def test_a_study_of_the_same_name_is_no_description(tmp_path, other):
    """Nor is a parameter file; a misspelt description is refused."""
    path = tmp_path / "lift.csv"
    path.write_text("time,u\n0,1\n1,2\n", encoding="utf-8")
    path.with_suffix(".toml").write_text(other, encoding="utf-8")
    assert read_trace(path)["u"].tolist() == [1, 2]
    path.with_suffix(".toml").write_text('[signal.u]\nunit = "V"\n', encoding="utf-8")
    problem(lambda: read_trace(path), "unknown key 'signal'; did you mean signals")


def test_a_described_scenario_has_short_gaps_only(tmp_path):
    """As a recording whose commands are played: linear over 0.1 s, refused beyond."""
    path = tmp_path / "log.csv"
    path.with_suffix(".toml").write_text('[signals.u]\nunit = "V"\n', encoding="utf-8")
    path.write_text("time,u\n0,1\n0.05,\n0.1,3\n", encoding="utf-8")
    assert read_trace(path)["u"].tolist() == [1, 2, 3]
    path.write_text("time,u\n0,1\n0.05,\n0.2,3\n", encoding="utf-8")
    problem(lambda: read_trace(path), r"u: expected gaps of at most 0\.1 s, got one from 0\.05 s to 0\.05 s")


def test_two_rows_of_an_event_in_a_described_file(tmp_path):
    """A step of a command, as in a trace; the clock of an experiment never repeats a time."""
    path = tmp_path / "log.csv"
    path.write_text("Zeit;u\n0;0\n1;0\n1;3\n2;3\n", encoding="utf-8")
    described = '[time]\ncolumn = "Zeit"\n[signals.u]\nunit = "V"\n'
    path.with_suffix(".toml").write_text(described, encoding="utf-8")
    for trace in (read_trace(path), read_recording(path)):
        assert (trace.time.tolist(), trace["u"].tolist()) == ([0, 1 - 1e-6, 1, 2], [0, 0, 3, 3])
    path.with_suffix(".toml").write_text(f'[experiment]\nprocedure = "rest"\n{described}', encoding="utf-8")
    problem(lambda: read_recording(path), "line 4: column 'Zeit': expected increasing times, got 1 after 1")


def test_another_unit_in_the_file_than_in_its_description_is_told(tmp_path, capsys):
    """The description holds; a calibrated column has another unit anyway."""
    path = tmp_path / "log.csv"
    path.write_text("time,p,q\ns,psi,V\n0,1,1\n1,2,2\n", encoding="utf-8")
    meta = '[signals.p]\nunit = "bar"\n[signals.q]\nunit = "bar"\nfactor = 40.0\n'
    path.with_suffix(".toml").write_text(meta, encoding="utf-8")
    assert read_recording(path)["p"].tolist() == [1e5, 2e5]
    told = capsys.readouterr().err.splitlines()
    assert told[-1] == f"{path}: column 'p': in psi, but read in bar, as log.toml states"


def test_the_unit_of_the_clock_may_be_in_its_name(tmp_path):
    """A description that states none takes it; the name is that with or without its unit."""
    path = tmp_path / "log.csv"
    path.write_text("clock [ms],P [bar]\n0,1\n20,2\n", encoding="utf-8")
    for clock, column in (("clock", "P [bar]"), ("clock [ms]", "P")):
        meta = f'[time]\ncolumn = "{clock}"\n[signals.p]\ncolumn = "{column}"\nunit = "bar"\n'
        path.with_suffix(".toml").write_text(meta, encoding="utf-8")
        assert read_recording(path).time.tolist() == [0, 0.02]
        assert read_trace(path)["p"].tolist() == [1e5, 2e5]


def test_names_of_a_run_stay_as_they_are(tmp_path):
    """A variable of an FMU may be called x [bar]; what a run wrote is not converted."""
    path = tmp_path / "run.csv"
    write_trace(Trace(np.arange(3.0), {"x [bar]": np.arange(3.0)}), path)
    path.with_suffix(".run.json").write_text("{}", encoding="utf-8")
    assert read_trace(path)["x [bar]"].tolist() == [0, 1, 2]


def test_a_recording_without_a_description_may_have_gaps(tmp_path):
    """Empty cells and lost rows; a scenario has none."""
    path = tmp_path / "log.csv"
    rows = [f"{k},{k}" if k % 9 else f"{k}," for k in range(300) if k % 100]
    path.write_text("\n".join(["time,u", *rows]) + "\n", encoding="utf-8")
    assert np.isnan(read_recording(path)["u"]).sum() == sum(1 for k in range(300) if k % 100 and k % 9 == 0)
    problem(lambda: read_trace(path), "line 10: column 'u': expected a number, got none")


def test_a_column_in_another_unit_drives_its_input(fmus: Workshop, tmp_path):
    """The input of the FMU is in bar; another quantity is refused, and a column without a unit is in bar."""
    system = assemble({"a": fmus.make("gain", "in_bar", units={"u": "bar", "y": "bar"})}, [])
    path = tmp_path / "log.csv"
    for header, first in (("u [kPa]", 0.03), ("u (MPa)", 30.0), ("u", 3.0)):
        path.write_text(f"time,{header}\n0,3\n1,3\n", encoding="utf-8")
        (_, linear), *_ = drive(system, read_trace(path)).columns.values()
        # the file's factor, and that of the FMU: two roundings
        assert linear(read_trace(path)["u"][0]) == pytest.approx(first, rel=1e-14)
    path.write_text("time,u\ns,V\n0,3\n1,3\n", encoding="utf-8")
    problem(lambda: run(system, path), r"log.csv: column 'u': expected a unit like bar, got 'V'")


def test_a_series_of_numbers_without_names_is_read_alike(tmp_path):
    """Columns by index, in whatever form; the kind of file that public data sets have."""
    path = tmp_path / "log.txt"
    path.write_text("0,5\t1\n1\t-2,5\n", encoding="utf-8")
    assert read_series(path, {"u": 0, "y": 1})["y"].tolist() == [1.0, -2.5]


def test_a_decimal_comma_may_come_late(tmp_path):
    """The first comma decides, however late it comes."""
    path = tmp_path / "log.csv"
    path.write_text("time;u\n" + "".join(f"{k};{k % 5}\n" for k in range(60)) + "60;2,5\n", encoding="utf-8")
    assert read_trace(path)["u"][-1] == 2.5


PLAIN = "Zeit [s];Druck [bar]\n0,0;1,5\n0,1;2,5\n"
ABOVE = {
    "title": "Prüfling: Harvester\nGerät;XY\n\n",
    "commas": "Prüfer: A, B\n",
    "wide": "Messung;Nr;7;von;9\n\n",
}


@pytest.mark.parametrize("name", ABOVE)
def test_lines_above_the_names_are_left_out(name, tmp_path, capsys):
    """The names are in the last line before rows of their width; the message numbers the lines."""
    path = tmp_path / "a.csv"
    path.write_text(ABOVE[name] + PLAIN, encoding="utf-8")
    columns = read_columns(path, None)
    assert {n: v.tolist() for n, v in columns.values.items()} == {
        "Zeit [s]": [0, 0.1],
        "Druck [bar]": [1.5, 2.5],
    }
    line = ABOVE[name].count("\n") + 1
    assert columns.location(0) == f"{path}: line {line + 1}"
    assert f"the names are in line {line}\n" in capsys.readouterr().err


@pytest.mark.parametrize(
    "text",
    [
        "Datum;Uhrzeit;p\n27.11.2026;23:59:59,990;86,5\n28.11.2026;00:00:00,010;86,9\n",
        "Uhrzeit;Datum;p\n23:59:59,99;27.11.2026;86,5\n00:00:00,01;28.11.2026;86,9\n",
        "Datum,Uhrzeit,p\n2026-11-27,23:59:59.990,86.5\n2026-11-28,00:00:00.010,86.9\n",
    ],
)
def test_date_and_time_of_day_in_two_columns(text, tmp_path):
    """They are one time, over midnight, too; the column of dates is a part of it."""
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    columns = read_columns(tmp_path / "a.csv", None)
    assert [*columns.values] == ["Uhrzeit", "p"]
    assert columns.values["p"].tolist() == [86.5, 86.9]
    assert time_axis(columns, "Uhrzeit").tolist() == [0.0, 0.02]
