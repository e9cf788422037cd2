"""Reading reference traces and measurements: what is read, and what every mistake is told."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from orchestrator.base.errors import Problem
from orchestrator.data.description import Tolerance
from orchestrator.data.recording import read_recording

Edit = Callable[[str, str], Path]


def test_reads_columns_units_groups_and_limits(folder: Path) -> None:
    """The CSV and its meta file become signals in SI units with the limit of their group."""
    found = read_recording(folder / "ref.csv")
    angle = found.criterion("shaft.angle")
    assert (angle.group, angle.label) == ("angle", "Shaft <angle>")
    assert angle.tolerance == Tolerance("nrmse", 0.01)
    # 2 bar
    assert found.criterion("pump.pressure").tolerance == Tolerance("maximum", 2e5)
    assert (found.units["shaft.angle"], found.unit_label("shaft.angle")) == ("rad", "deg (rad)")
    assert len(found.time) == len(found["shaft.angle"]) == 201
    assert (found.title, found.source.name, found.metadata["kind"]) == (
        "Shaft test",
        "ref.csv",
        "measurement",
    )


def test_toml_path_finds_the_csv(folder: Path) -> None:
    """The TOML's path works as well as the CSV's."""
    assert read_recording(folder / "ref.toml").source == folder / "ref.csv"


def test_a_users_own_recording(tmp_path: Path) -> None:
    """Semicolons, decimal commas, a logger's head, milliseconds, other names, calibration and offset."""
    csv, toml = tmp_path / "rig.csv", tmp_path / "mapping.toml"
    csv.write_text("logger 7\nt;POS;U\n1000;45,0;1,0\n1500;90,0;2,5\n", encoding="utf-8-sig")
    toml.write_text(
        '[file]\ndelimiter = ";"\ndecimal = ","\nskip_lines = 1\n'
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
    edited(
        "[tolerances]",
        '[experiment]\nprocedure = "valve"\nlength = { value = 4.0, unit = "m" }\n[tolerances]',
    )
    found = read_recording(edited('label = "Shaft', f'{instrument}label = "Shaft'))
    assert found.metadata == before.metadata
    for name, signal in found.signals.items():
        np.testing.assert_array_equal(signal, before[name])
    with pytest.raises(Problem, match="unknown key 'deadzone'"):
        read_recording(edited("dead_zone", "deadzone"))


def test_a_signals_own_limit_beats_its_groups(edited: Edit) -> None:
    """A limit in the signal's table wins, and "none" takes the judgement away."""
    path = edited('label = "Shaft <angle>"', 'tolerance = { metric = "fit", limit = 90 }')
    assert read_recording(path).criterion("shaft.angle").tolerance == Tolerance("fit", 90)
    path = edited('tolerance = { metric = "fit", limit = 90 }', 'tolerance = "none"')
    assert read_recording(path).criterion("shaft.angle").tolerance is None


MISTAKES = [
    ("[tolerances]", "[tolerance]", r"ref.toml: unknown key 'tolerance'; did you mean tolerances"),
    ("title =", "titel =", r"ref.toml: reference: unknown key 'titel'; did you mean title\?$"),
    ("title =", "q =", r"ref.toml: reference: unknown key 'q'; there are title, kind, origin"),
    ('"Shaft test"', "7", r"reference: title: expected a text, got 7$"),
    ("[reference]", "[reference", r"ref.toml: expected TOML, got "),
    (
        "[reference]",
        '[reference]\nkind = "guess"',
        r"reference: kind: expected one of simulation, measurement, published, got 'guess'$",
    ),
    (
        "[reference]",
        '[reference]\nkind = "simulation"',
        r"reference: expected origin, made_by, solver, relative_tolerance, date, change for a trace of kind",
    ),
    ('metric = "nrmse"', 'metric = "mae"', r"tolerances.angle: metric: expected one of nrmse.*, got 'mae'$"),
    ("limit = 0.01", "limit = 0", r"tolerances.angle: limit: expected a number above 0, got 0$"),
    ("limit = 0.01", "limit = true", r"limit: expected a number, got True$"),
    (", limit = 0.01", "", r"tolerances.angle: limit: expected a number above 0, got nothing$"),
    (
        '{ metric = "nrmse", limit = 0.01 }',
        "0.01",
        r"tolerances: angle: expected a table of metric, limit or 'none', got 0.01$",
    ),
    ('group = "angle"', 'group = "angel"', r"group: expected one of angle, pressure, got 'angel'$"),
    ('unit = "deg"', 'unit = "degrees"', r'ref.toml: signals."shaft.angle": unit \'degrees\' is unknown'),
    ('unit = "deg"\n', "", r'signals."shaft.angle": unit: expected a text, got nothing$'),
    ('unit = "deg"', 'unit = "deg"\nrange = 0', r"range: expected a number above 0, got 0$"),
    ('unit = "deg"', 'unit = "deg"\nfactor = true', r"factor: expected a number, got True$"),
    (
        'unit = "deg"',
        'unit = "deg"\ncolumn = "shaft"',
        (
            r"ref.csv: expected a column 'shaft', "
            r"got time, shaft"
        ),
    ),
    (
        "[reference]",
        '[time]\nunit = "bar"\n[reference]',
        r"time: unit: expected a unit of time .*, got 'bar'$",
    ),
    ("[reference]", '[file]\ncsv = "no.csv"\n[reference]', r"no.csv: no such file"),
    ("[reference]", '[file]\ndecimal = ";"\n[reference]', r"\[file\] decimal: expected '.' or ',', got ';'"),
    ("\n0.02,", "\n0.005,", r"ref.csv: line 4: column 'time': expected increasing .*, got 0.005 after 0.01"),
    ("\n0.02,", "\nabc,", r"ref.csv: line 4: column 'time': expected a number, got 'abc'"),
    ("\n0.02,", "\nnan,", r"ref.csv: line 4: column 'time': expected a time, got none"),
    ("\n0.02,", "\ninf,", r"ref.csv: line 4: column 'time': expected a finite number, got inf"),
    ("\n0.02,", "\n0.02,,", r"ref.csv: line 4: expected 3 cells, got 4"),
    ("time,shaft.angle,", "time,time,", r"ref.csv: expected a column 'shaft.angle', got "),
    (",pump.pressure", ",shaft.angle", r"ref.csv: expected a column 'pump.pressure', got "),
]


@pytest.mark.parametrize(("old", "new", "message"), MISTAKES)
def test_every_mistake_is_named(edited: Edit, old: str, new: str, message: str) -> None:
    """The message about a mistake in the TOML or CSV file contains file, position, expected and got."""
    path = edited(old, new)
    with pytest.raises(Problem, match=message):
        read_recording(path)


def test_column_that_stands_twice_is_refused(edited: Edit) -> None:
    """Two columns with one name are ambiguous."""
    edited('unit = "bar"', 'unit = "bar"\ncolumn = "shaft.angle"')
    path = edited("shaft.angle,pump.pressure", "shaft.angle,shaft.angle")
    with pytest.raises(Problem, match=r"ref.csv: expected the column 'shaft.angle' once, got it 2 times"):
        read_recording(path)


def test_missing_and_empty_files(tmp_path: Path) -> None:
    """A missing file, a folder, a missing meta file, one without signals, a CSV without numbers are named."""
    csv, toml = tmp_path / "a.csv", tmp_path / "a.toml"
    expected = r"a.csv: expected a .csv, .parquet, .mat or .toml file, got no such file"
    with pytest.raises(Problem, match=expected):
        read_recording(csv)
    with pytest.raises(Problem, match=r"expected a .csv, .parquet, .mat or .toml file, got a folder"):
        read_recording(tmp_path)
    csv.write_text("time,x\n0,1\n", encoding="utf-8")
    with pytest.raises(
        Problem, match=r"a.toml: expected a TOML file that describes the columns, got no such"
    ):
        read_recording(csv)
    toml.write_text("[time]\n", encoding="utf-8")
    with pytest.raises(Problem, match=r"a.toml: expected at least one table \[signals.NAME\], got none"):
        read_recording(csv)
    toml.write_text('[signals.x]\nunit = "m"\n', encoding="utf-8")
    with pytest.raises(Problem, match=r"a.csv: expected two or more rows of numbers, got 1"):
        read_recording(csv)
    csv.write_text("", encoding="utf-8")
    with pytest.raises(Problem, match=r"a.csv: expected two or more rows of numbers, got an empty file"):
        read_recording(csv)
    csv.write_bytes(b"time,x\n\xff\xfe,1\n")
    with pytest.raises(Problem, match=r"a.csv: line 2: expected text in UTF-8, got the byte 0xff"):
        read_recording(csv)
