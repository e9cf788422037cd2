"""Text files as loggers and Excel write them: the same numbers as a scenario, a recording or a trace."""

from pathlib import Path

import numpy as np
import pytest
from kit.mistakes import problem, table

from orchestrator import Trace, assemble, read_recording, read_trace, run, write_trace
from orchestrator.base import files
from orchestrator.data.table import read_columns, time_axis
from orchestrator.engine.scenario import drive

HERE = Path(__file__)
DESCRIBED = HERE.with_name("test_text_files_described.toml").read_text(encoding="utf-8")
HEADER = HERE.with_suffix(".lvm").read_text(encoding="utf-8")  # with places for what differs


@pytest.fixture(autouse=True)
def _anew(monkeypatch):
    """Lines that are told once are told in each test."""
    monkeypatch.setattr(files, "_told", set())


@pytest.fixture
def log(tmp_path):
    """log(text, described): a file with this text, and its description beside it."""

    def write(text, described="", encoding="utf-8"):
        path = tmp_path / "log.csv"
        path.write_text(text, encoding=encoding)
        if described:
            path.with_suffix(".toml").write_text(described, encoding="utf-8")
        return path

    return write


@table(__file__, "files", "text, expected, told")
def test_what_loggers_write_is_read(log, capsys, text, expected, told):
    """Times in s from 0, other values in SI units, and a line that says what was found in the file."""
    path = log(text)
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
def test_what_is_not_clear_is_refused_in_one_line(log, text, message):
    """File, line, column, what was expected and found, and the way out."""
    path = log(text)
    told = problem(lambda: read_trace(path))
    assert told.startswith(str(path))
    assert all(words in told for words in message.split("|")), told


def test_one_description_for_every_use(log):
    """Names, units, calibration and clock of the .toml file hold for a trace, and so for a scenario, too."""
    path = log("Zeit;Druck;egal;u\nStunden;V;psi;V\n0,0;0,25;x;500\n20,5;0,5;y;250\n", DESCRIBED, "cp1252")
    for read in (read_trace, read_recording):
        trace = read(path)
        np.testing.assert_allclose(trace.time, [0.5, 0.5205], rtol=1e-14)  # roundings, here and below
        np.testing.assert_allclose(trace["p"], [8e5, 18e5], rtol=1e-14)
        np.testing.assert_allclose(trace["u"], [0.5, 0.25], rtol=1e-14)
        assert dict(trace.units) == {"p": "Pa", "u": "V"}
    # one that only says how the file is written: the names in the file hold; a window of the time, too
    meta = '[file]\nskip_lines = 1\n[time]\ncolumn = "Messzeit"\nunit = "ms"\nstart = 0.5\n'
    trace = read_trace(log("Logger 7\nn;Messzeit;u\n1;0;0\n2;500;1,5\n3;1000;2\n", meta))
    assert (trace.time.tolist(), trace["u"].tolist()) == ([0.5, 1.0], [1.5, 2.0])


@pytest.mark.parametrize("other", ['system = "a.ssp"\n[factors]\n', "[parameters.x]\nvalue = 1\n"])
def test_a_study_of_the_same_name_is_no_description(log, other):
    """Nor is a parameter file; a misspelt description is refused."""
    assert read_trace(log("time,u\n0,1\n1,2\n", other))["u"].tolist() == [1, 2]
    misspelt = log("time,u\n0,1\n1,2\n", '[signal.u]\nunit = "V"\n')
    problem(lambda: read_trace(misspelt), "unknown key 'signal'; did you mean signals")


WORDS_OF_LOGGERS = {
    "P [bar]": (["1.5", "Not available", "2", "Error", "2.5", "Error", "3"], "2 'Error', 1 'Not available'"),
    "P": (["#N/A", "#DIV/0!", "1", "---", "2", "3", "4"], "1 '#N/A', 1 '#DIV/0!', 1 '---'"),
    "P1": (["OFL"] * 20 + ["1 bar"] * 21, "20 'OFL'"),
}


@pytest.mark.parametrize("name", WORDS_OF_LOGGERS)
def test_words_in_a_column_of_numbers_are_gaps(name, log, capsys):
    """Their number is told; a column of texts is left out. In a scenario each of them is a mistake."""
    cells, told = WORDS_OF_LOGGERS[name]
    rows = [f"{k},{cell},{'OK' if k else 'start 1'}" for k, cell in enumerate(cells)]
    path = log("\n".join([f"t [s],{name},Status", *rows]) + "\n")
    (values,) = read_recording(path).values()
    numbers = np.array([float(cell.split()[0]) if cell[0].isdigit() else np.nan for cell in cells])
    np.testing.assert_array_equal(values, numbers * (1 if name == "P" else 1e5))  # bar
    line = f"{path}: column {name!r}: gaps in place of {told}\n"
    line += f"{path}: line 2: column 'Status': expected a number, got 'start 1'; left out\n"
    assert capsys.readouterr().err == line
    described = f'[time]\ncolumn = "t"\n[signals.p]\ncolumn = "{name}"\nunit = "bar"\n'
    np.testing.assert_array_equal(read_recording(log(path.read_text(), described))["p"], 1e5 * numbers)
    path.with_suffix(".toml").unlink()
    problem(lambda: read_trace(path), "column 'P.*: expected a number, got '")
    none = log("time,p\n0e,q\n0,1\n1,1O5\n2,3\n")  # nothing else is left to read
    problem(lambda: read_recording(none), "log.csv: line 2: column 'time': expected a number, got '0e'$")


@table(__file__, "stated", "keys, first, told")
def test_lines_and_rows_that_are_stated_count(log, capsys, keys, first, told):
    """Also a stated 0; rows of numbers are never left out without a line."""
    text = "time;a\ns;V\nKanal 0;Kanal 1\n0;1\n1;2\n2;3\n"
    (values,) = read_trace(log(text, f"[file]\n{keys}\n")).values()
    assert values[0] == first
    assert told in capsys.readouterr().err


@table(__file__, "labview", "rows, columns")
def test_a_labview_file_has_times_and_units_in_its_header(tmp_path, rows, columns):
    """With a column of times for each channel, for all or none; the file may have commas and points, too."""
    between = "\t" if columns == "Multi" else ""
    text = HEADER.format(columns=columns, between=between, end=f"{between}\t") + rows
    commas = text.replace(",", ".").replace("\t", ",").replace("Separator,Tab", "Separator,Comma")
    for name, content in (("tabs.lvm", text), ("commas.lvm", commas)):
        path = tmp_path / name
        path.write_text(content, encoding="utf-8")
        trace = read_trace(path)
        assert trace.time.tolist() == [0, 0.02, 0.04]
        found = {n: (v.tolist(), trace.units[n]) for n, v in trace.items()}
        assert found == {"P 1": ([1.5e5, 2.5e5, 3.5e5], "Pa"), "U": ([-2, -3, -4], "V")}
    for old, new, told in (
        ("{between}\t0,02", "{between}\t0,04", "expected one Delta_X, got 0,020000, 0,040000"),
        ("Delta_X", "Rate", "got one without X0, Delta_X or names"),
        ("X0\t", "***End_of_Header***\nX0\t", "expected one header of channels, got 2"),
    ):
        changed = HEADER.replace(old, new).format(columns=columns, between=between, end=f"{between}\t")
        path.write_text(changed + rows, encoding="utf-8")
        assert told in problem(lambda: read_trace(path))


def test_two_rows_of_an_event_in_a_described_file(log):
    """A step of a command, as in a trace; the clock of an experiment never repeats a time."""
    text, described = "Zeit;u\n0;0\n1;0\n1;3\n2;3\n", '[time]\ncolumn = "Zeit"\n[signals.u]\nunit = "V"\n'
    path = log(text, described)
    for trace in (read_trace(path), read_recording(path)):
        assert (trace.time.tolist(), trace["u"].tolist()) == ([0, 1 - 1e-6, 1, 2], [0, 0, 3, 3])
    log(text, f'[experiment]\nprocedure = "rest"\n{described}')
    problem(lambda: read_recording(path), "line 4: column 'Zeit': expected increasing times, got 1 after 1")


def test_another_unit_in_the_file_than_in_its_description_is_told(log, capsys):
    """The description holds; a calibrated column has another unit anyway."""
    meta = '[signals.p]\nunit = "bar"\n[signals.q]\nunit = "bar"\nfactor = 40.0\n'
    path = log("time,p,q\ns,psi,V\n0,1,1\n1,2,2\n", meta)
    assert read_recording(path)["p"].tolist() == [1e5, 2e5]
    told = capsys.readouterr().err.splitlines()
    assert told[-1] == f"{path}: column 'p': in psi, but read in bar, as log.toml states"


def test_the_unit_of_the_clock_may_be_in_its_name(log):
    """A description that states none takes it; the name is that with or without its unit."""
    for clock, column in (("clock", "P [bar]"), ("clock [ms]", "P")):
        meta = f'[time]\ncolumn = "{clock}"\n[signals.p]\ncolumn = "{column}"\nunit = "bar"\n'
        path = log("clock [ms],P [bar]\n0,1\n20,2\n", meta)
        assert read_recording(path).time.tolist() == [0, 0.02]
        assert read_trace(path)["p"].tolist() == [1e5, 2e5]


def test_names_of_a_run_stay_as_they_are(tmp_path):
    """A variable of an FMU may be called x [bar]; what a run wrote is not converted."""
    path = tmp_path / "run.csv"
    write_trace(Trace(np.arange(3.0), {"x [bar]": np.arange(3.0)}), path)
    path.with_suffix(".run.json").write_text("{}", encoding="utf-8")
    assert read_trace(path)["x [bar]"].tolist() == [0, 1, 2]


def test_gaps_of_recordings_and_scenarios(log):
    """A recording has empty cells and lost rows, a described scenario gaps up to 0.1 s, any other none."""
    rows = [f"{k},{k}" if k % 9 else f"{k}," for k in range(300) if k % 100]
    path = log("\n".join(["time,u", *rows]) + "\n")
    assert np.isnan(read_recording(path)["u"]).sum() == sum(1 for k in range(300) if k % 100 and k % 9 == 0)
    problem(lambda: read_trace(path), "line 10: column 'u': expected a number, got none")
    meta = '[signals.u]\nunit = "V"\n'
    assert read_trace(log("time,u\n0,1\n0.05,\n0.1,3\n", meta))["u"].tolist() == [1, 2, 3]
    path = log("time,u\n0,1\n0.05,\n0.2,3\n", meta)
    problem(lambda: read_trace(path), r"u: expected gaps of at most 0\.1 s, got one from 0\.05 s to 0\.05 s")


def test_a_column_in_another_unit_drives_its_input(fmus, log):
    """The input of the FMU is in bar; another quantity is refused, and a column without a unit is in bar."""
    system = assemble({"a": fmus.make("gain", "in_bar", units={"u": "bar", "y": "bar"})}, [])
    for header, first in (("u [kPa]", 0.03), ("u (MPa)", 30.0), ("u", 3.0)):
        path = log(f"time,{header}\n0,3\n1,3\n")
        (_, linear), *_ = drive(system, read_trace(path)).columns.values()
        # the file's factor, and that of the FMU: two roundings
        assert linear(read_trace(path)["u"][0]) == pytest.approx(first, rel=1e-14)
    path = log("time,u\ns,V\n0,3\n1,3\n")
    problem(lambda: run(system, path), r"log.csv: column 'u': expected a unit like bar, got 'V'")


@pytest.mark.parametrize("channels", ["1;2;3", ";1;2", "7;8;9"])
def test_numbers_of_channels_below_the_units_are_no_samples(channels, log, capsys):
    """Numbers in turn, without a time or with one behind that of the next row; others are samples."""
    path = log(f"Zeit;P;U\ns;bar;V\n{channels}\n0,0;1,5;3\n0,1;2,5;3\n")
    assert read_trace(path)["P"].tolist() == [1.5e5, 2.5e5]
    assert "line 3 left out" in capsys.readouterr().err
    plain = log("Zeit;P;U\ns;bar;V\n0;1;2\n1;2;3\n2;3;4\n")
    assert read_trace(plain)["P"].tolist() == [1e5, 2e5, 3e5]


def test_a_decimal_comma_may_come_late(log):
    """The first comma decides, however late it comes."""
    rows = "".join(f"{k};{k % 5}\n" for k in range(60))
    assert read_trace(log(f"time;u\n{rows}60;2,5\n"))["u"][-1] == 2.5


PLAIN = "Zeit [s];Druck [bar]\n0,0;1,5\n0,1;2,5\n"
ABOVE = ["Prüfling: Harvester\nGerät;XY\n\n", "Prüfer: A, B\n", "Messung;Nr;7;von;9\n\n"]


@pytest.mark.parametrize("above", ABOVE, ids=["title", "commas", "wide"])
def test_lines_above_the_names_are_left_out(above, log, capsys):
    """The names are in the last line before rows of their width; the message numbers the lines."""
    path = log(above + PLAIN)
    columns = read_columns(path, None)
    found = {n: v.tolist() for n, v in columns.values.items()}
    assert found == {"Zeit [s]": [0, 0.1], "Druck [bar]": [1.5, 2.5]}
    line = above.count("\n") + 1
    assert columns.location(0) == f"{path}: line {line + 1}"
    assert f"the names are in line {line}\n" in capsys.readouterr().err


@table(__file__, "days", "text, second")
def test_date_and_time_of_day_in_two_columns(log, text, second):
    """They are one time, over midnight and over whole days, too; the column of dates is a part of it."""
    columns = read_columns(log(text), None)
    assert [*columns.values] == ["Uhrzeit", "p"]
    assert columns.values["p"].tolist() == [86.5, 86.9]
    assert time_axis(columns, "Uhrzeit").tolist() == [0.0, second]
