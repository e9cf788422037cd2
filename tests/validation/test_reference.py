"""References and measurements in files of any kind: what is read and written, and what mistakes are told."""

from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.io
from kit.mistakes import problem, table
from validation.conftest import Edit

from orchestrator.data.description import Origin, Tolerance
from orchestrator.data.recording import Recording, fill_gaps, read_recording, write_recording
from orchestrator.data.trace import Trace
from orchestrator.results.validation import validate

ORIGIN = Origin(
    title='The "joined" machine',
    origin="monolith, version 1",
    made_by="make reference",
    solver="Radau, order 5",
    relative_tolerance=1e-10,
    absolute_tolerance=1e-8,
    date=date(2026, 1, 31),
    change="first version",
)


def test_reads_columns_units_groups_and_limits(folder: Path) -> None:
    """The CSV and its meta file become signals in SI units with the limit of their group."""
    found = read_recording(folder / "ref.csv")
    assert read_recording(folder / "ref.toml").source == found.source == folder / "ref.csv"
    angle = found.criterion("shaft.angle")
    assert (angle.group, angle.label) == ("angle", "Shaft <angle>")
    assert angle.tolerance == Tolerance("nrmse", 0.01)
    # 2 bar
    assert found.criterion("pump.pressure").tolerance == Tolerance("maximum", 2e5)
    assert (found.units["shaft.angle"], found.unit_label("shaft.angle")) == ("rad", "deg (rad)")
    assert len(found.time) == len(found["shaft.angle"]) == 201
    assert (found.title, found.metadata["kind"]) == ("Shaft test", "measurement")


def test_a_users_own_recording(tmp_path: Path) -> None:
    """Semicolons, decimal commas, a logger's head, milliseconds, other names, calibration and offset."""
    csv, toml = tmp_path / "rig.csv", tmp_path / "mapping.toml"
    csv.write_text("logger 7\n\nt;POS;U\n1000;45,0;1,0\n1500;90,0;2,5\n\n", encoding="utf-8-sig")
    toml.write_text(
        '[file]\ndelimiter = ";"\ndecimal = ","\nskip_lines = 2\n'
        '[time]\ncolumn = "t"\nunit = "ms"\noffset = -1\nstart = 0.1\nstop = 0.4\n'
        '[signals."m.angle"]\ncolumn = "POS"\nunit = "deg"\n'
        '[signals."p.pressure"]\ncolumn = "U"\nunit = "bar"\nfactor = 40.0\noffset = -20\nrange = 100\n',
        encoding="utf-8",
    )
    found = read_recording(toml, csv)
    np.testing.assert_array_equal(found.time, [0.0, 0.5])
    # one multiplication, and a second of the unit: a rounding each
    np.testing.assert_allclose(found["m.angle"], np.radians([45.0, 90.0]), rtol=1e-15)
    np.testing.assert_allclose(found["p.pressure"], [20e5, 80e5], rtol=1e-15)
    assert (found.start, found.stop, found.criterion("p.pressure").span) == (0.1, 0.4, 100e5)
    assert found.criterion("m.angle").tolerance is None


def test_a_recording_for_identification_is_read(edited: Edit) -> None:
    """The experiment and the instrument are there and change no sample; a misspelt key is refused."""
    instrument = 'sensor = "encoder"\nnoise = 0.1\nresolution = 0.01\nspan = [0.0, 360.0]\ndead_zone = 0.0\n'
    before = read_recording(edited('label = "Shaft', 'label = "Shaft'))
    experiment = '[experiment]\nprocedure = "valve"\nlength = { value = 4.0, unit = "m" }\n'
    edited("[tolerances]", f"{experiment}[tolerances]")
    found = read_recording(edited('label = "Shaft', f'{instrument}label = "Shaft'))
    assert found.metadata == before.metadata
    for name, signal in found.signals.items():
        np.testing.assert_array_equal(signal, before[name])
    problem(lambda: read_recording(edited("dead_zone", "deadzone")), "unknown key 'deadzone'")


def test_a_signals_own_limit_beats_its_groups(edited: Edit) -> None:
    """A limit in the signal's table wins, and "none" takes the judgement away."""
    path = edited('label = "Shaft <angle>"', 'tolerance = { metric = "fit", limit = 90 }')
    assert read_recording(path).criterion("shaft.angle").tolerance == Tolerance("fit", 90)
    path = edited('tolerance = { metric = "fit", limit = 90 }', 'tolerance = "none"')
    assert read_recording(path).criterion("shaft.angle").tolerance is None


@table(__file__, "mistakes", "old, new, message")
def test_every_mistake_is_named(edited: Edit, old: str, new: str, message: str) -> None:
    """The message about a mistake in the TOML or CSV file contains file, position, expected and got."""
    path = edited(old, new)
    problem(lambda: read_recording(path), message)


def test_missing_and_empty_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A missing file, a folder, a meta file without signals, a CSV without numbers are named."""
    monkeypatch.chdir(tmp_path)  # which has no folder build
    csv, toml = tmp_path / "a.csv", tmp_path / "a.toml"

    def line(path: Path = csv) -> str:
        return problem(lambda: read_recording(path))

    kinds = "expected a .csv, .parquet, .mat or .toml file, got "
    assert line().endswith("a.csv: no such file")
    assert line(tmp_path).endswith(f"{kinds}a folder")
    csv.write_text("time,x\n0,1\n", encoding="utf-8")
    toml.write_text("[tolerances]\n", encoding="utf-8")
    assert "a.toml: expected at least one table [signals.NAME], got none" in line()
    toml.write_text('[signals.x]\nunit = "m"\n', encoding="utf-8")
    assert "a.csv: expected two or more rows of numbers, got 1" in line()
    csv.write_text("", encoding="utf-8")
    assert "a.csv: expected two or more rows of numbers, got an empty file" in line()
    csv.write_bytes(b"time,x\n\x81,1\n")  # no text in Windows-1252, either
    assert "a.csv: line 2: expected text in UTF-8, got the byte 0x81" in line()


@pytest.mark.parametrize("encoding", ["utf-8-sig", "cp1252", "utf-16", "utf-16-le", "utf-16-be"])
def test_the_encoding_of_a_logger_needs_no_key(tmp_path: Path, capsys, encoding: str) -> None:
    """Semicolons, decimal commas and an umlaut; what is guessed is told once."""
    csv = tmp_path / "a.csv"
    csv.write_bytes("time;Zylinderl\u00e4nge\n0;1,5\n1;2,5\n".encode(encoding))
    text = '[file]\ndelimiter = ";"\ndecimal = ","\n[signals.x]\ncolumn = "Zylinderl\u00e4nge"\nunit = "m"\n'
    csv.with_suffix(".toml").write_text(text, encoding="utf-8")
    for _ in range(2):
        assert read_recording(csv)["x"].tolist() == [1.5, 2.5]
    told = [line.rpartition(" ")[2] for line in capsys.readouterr().err.splitlines()]
    usual = {"utf-8-sig": [], "cp1252": ["Windows-1252"]}
    assert told == usual.get(encoding, [encoding.upper()])


@pytest.mark.parametrize("kind", ["parquet", "mat"])
def test_parquet_and_matlab_are_compared_like_csv(folder: Path, trace: Trace, kind: str) -> None:
    """The same columns in another file give the same metrics; a gap is left out and counted."""
    cells = pd.read_csv(folder / "ref.csv")
    cells.loc[20:29, "shaft.angle"] = np.nan
    csv = read_recording(folder / "ref.toml")
    (folder / "ref.csv").unlink()
    if kind == "parquet":
        cells.to_parquet(folder / "ref.parquet")
    else:
        text = (folder / "ref.toml").read_text(encoding="utf-8")
        for name in ("shaft.angle", "pump.pressure"):  # a dot is a struct in MATLAB
            column = f'[signals."{name}"]\ncolumn = "{name.replace(".", "_")}"'
            text = text.replace(f'[signals."{name}"]', column)
        (folder / "ref.toml").write_text(text, encoding="utf-8")
        columns = {name.replace(".", "_"): cells[name].to_numpy() for name in cells}
        scipy.io.savemat(folder / "ref.mat", columns)
    found = validate(trace, read_recording(folder / "ref.toml"))
    expected = validate(trace, csv)
    assert found["pump.pressure"].metrics == expected["pump.pressure"].metrics
    assert found["shaft.angle"].notes == ("10 of 201 samples are in gaps of the reference, left out",)
    assert len(found["shaft.angle"].time) == 191


def test_short_gaps_of_a_command_are_bridged() -> None:
    """What drives a run has a value at every time; a signal without any sample is left out of a trace."""
    time = np.arange(0.0, 2.0, 0.01)
    short = np.where((time > 0.495) & (time < 0.555), np.nan, time)
    made = Recording(time, {"short": short, "none": np.full(200, np.nan)}, {}, Path("ref.csv"))
    np.testing.assert_allclose(fill_gaps(made, "short"), time, atol=1e-15)  # a straight line, rounding
    np.testing.assert_allclose(made.without_gaps()["short"], time, atol=1e-15)
    assert "none" not in made.without_gaps().signals


def test_written_trace_is_read_back(tmp_path: Path, trace: Trace) -> None:
    """Numbers, units, groups, limits and the story of a reference survive the files."""
    meta = write_recording(
        tmp_path / "ref.csv",
        trace,
        ORIGIN,
        tolerances={"angle": Tolerance("nrmse", 0.0005)},
        groups={"shaft.angle": "angle", "pump.command": "command"},
        labels={"shaft.angle": "Shaft angle"},
    )
    found = read_recording(meta)
    assert found.metadata["title"] == 'The "joined" machine'
    assert found.metadata["date"] == "2026-01-31"
    assert found.criterion("shaft.angle").tolerance == Tolerance("nrmse", 0.0005)
    assert found.criterion("pump.command").tolerance is None
    assert found.file_units["pump.pressure"] == "Pa"
    outcome = validate(trace, found)
    assert outcome.passed
    # nine digits in the CSV
    np.testing.assert_allclose(outcome["pump.pressure"].reference, trace["pump.pressure"], rtol=1e-8)


def test_reason_of_the_change_is_required(tmp_path: Path, trace: Trace) -> None:
    """Nobody records a reference again without saying why."""
    line = problem(lambda: write_recording(tmp_path / "ref.csv", trace, replace(ORIGIN, change=" "), {}, {}))
    assert line.endswith("ref.csv: expected the reason of this change of the reference, got none")
