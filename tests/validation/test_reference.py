"""Reading reference traces and measurements: what is read, and what every mistake is told."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from orchestrator.base.errors import Problem
from orchestrator.results.metrics import Tolerance
from orchestrator.results.reference import read_reference

Edit = Callable[[str, str], Path]


def test_reads_columns_units_groups_and_limits(folder: Path) -> None:
    """The CSV and its meta file become signals in the file's own units with the limit of their group."""
    found = read_reference(folder / "ref.csv")
    angle = found.signals["shaft.angle"]
    assert (angle.unit, angle.group, angle.label) == ("deg", "angle", "Shaft <angle>")
    assert angle.tolerance == Tolerance("nrmse", 0.01)
    assert len(found.time) == len(angle.values) == 201
    assert (found.title, found.source, found.about["kind"]) == ("Shaft test", "ref.csv", "measurement")


def test_toml_path_finds_the_csv(folder: Path) -> None:
    """The TOML's path works as well as the CSV's."""
    assert read_reference(folder / "ref.toml").source == "ref.csv"


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
    found = read_reference(toml, csv)
    np.testing.assert_array_equal(found.time, [0.0, 0.5])
    np.testing.assert_array_equal(found.signals["m.angle"].values, [45.0, 90.0])
    np.testing.assert_array_equal(found.signals["p.pressure"].values, [20.0, 80.0])
    assert (found.start, found.stop, found.signals["p.pressure"].span) == (0.1, 0.4, 100)
    assert found.signals["m.angle"].tolerance is None


def test_a_recording_for_identification_is_read(edited: Edit) -> None:
    """The experiment and an instrument are allowed and change nothing; a misspelt key is refused."""
    instrument = 'sensor = "encoder"\nnoise = 0.1\nresolution = 0.01\nspan = [0.0, 360.0]\ndead_zone = 0.0\n'
    before = read_reference(edited('label = "Shaft', 'label = "Shaft'))
    edited(
        "[tolerances]",
        '[experiment]\nprocedure = "valve"\nlength = { value = 4.0, unit = "m" }\n[tolerances]',
    )
    found = read_reference(edited('label = "Shaft', f'{instrument}label = "Shaft'))
    assert found.about == before.about
    for name, signal in found.signals.items():
        np.testing.assert_array_equal(signal.values, before.signals[name].values)
    with pytest.raises(Problem, match="unknown key 'deadzone'"):
        read_reference(edited("dead_zone", "deadzone"))


def test_a_signals_own_limit_beats_its_groups(edited: Edit) -> None:
    """A limit in the signal's table wins, and "none" takes the judgement away."""
    path = edited('label = "Shaft <angle>"', 'tolerance = { metric = "fit", limit = 90 }')
    assert read_reference(path).signals["shaft.angle"].tolerance == Tolerance("fit", 90)
    path = edited('tolerance = { metric = "fit", limit = 90 }', 'tolerance = "none"')
    assert read_reference(path).signals["shaft.angle"].tolerance is None


MISTAKES = [
    ("[tolerances]", "[tolerance]", r"ref.toml: unknown key 'tolerance', expected one of reference, file"),
    ("title =", "titel =", r"ref.toml: \[reference\]: unknown key 'titel', expected one of title, kind"),
    ('"Shaft test"', "7", r"\[reference\]: title is 7, expected str"),
    ("[reference]", "[reference", r"ref.toml: expected TOML, got "),
    (
        "[reference]",
        '[reference]\nkind = "guess"',
        r"kind is 'guess', expected one of simulation, measurement",
    ),
    (
        "[reference]",
        '[reference]\nkind = "simulation"',
        r"of kind 'simulation' must tell origin, made_by, solver, relative_tolerance, date, change, got none",
    ),
    ('metric = "nrmse"', 'metric = "mae"', r"\[tolerances\] angle: metric is 'mae', expected one of nrmse"),
    ("limit = 0.01", "limit = 0", r"\[tolerances\] angle: limit is 0, expected a number above 0"),
    ("limit = 0.01", "limit = true", r"limit is True, expected a number above 0"),
    (", limit = 0.01", "", r"angle: expected { metric = NAME, limit = NUMBER } or \"none\", got {'metric'"),
    ('group = "angle"', 'group = "angel"', r"group is 'angel', expected one of angle, pressure"),
    ('unit = "deg"', 'unit = "degrees"', r"ref.toml: \[signals.'shaft.angle'\]: unit 'degrees' is unknown"),
    ('unit = "deg"\n', "", r"\[signals.'shaft.angle'\]: expected a unit, got none"),
    ('unit = "deg"', 'unit = "deg"\nrange = 0', r"range is 0, expected more than 0"),
    ('unit = "deg"', 'unit = "deg"\nfactor = true', r"factor is True, expected int or float"),
    ('unit = "deg"', 'unit = "deg"\ncolumn = "shaft"', r"ref.csv: column 'shaft' expected, got shaft.angle"),
    ("[reference]", '[time]\nunit = "bar"\n[reference]', r"column 'time': unit 'bar' cannot be converted"),
    ("[reference]", '[file]\ncsv = "no.csv"\n[reference]', r"no.csv: expected a CSV file, got no such file"),
    ("[reference]", '[file]\ndecimal = ";"\n[reference]', r"expected a one-character delimiter and decimal"),
    ("\n0.02,", "\n0.005,", r"ref.csv: column 'time': expected increasing times, got 0.005 after 0.01"),
    ("\n0.02,", "\nabc,", r"ref.csv: line 4: column 'time': expected a number, got 'abc'"),
    ("\n0.02,", "\nnan,", r"ref.csv: line 4: column 'time': expected a finite number, got 'nan'"),
    ("\n0.02,", "\n0.02,,", r"ref.csv: line 4: expected 3 cells, got 4"),
    ("time,shaft.angle,", "time,time,", r"ref.csv: column 'shaft.angle' expected, got "),
    (",pump.pressure", ",shaft.angle", r"ref.csv: column 'pump.pressure' expected, got "),
]


@pytest.mark.parametrize(("old", "new", "message"), MISTAKES)
def test_every_mistake_is_named(edited: Edit, old: str, new: str, message: str) -> None:
    """A mistake in the TOML or the CSV is told with file, place, expected and got."""
    path = edited(old, new)
    with pytest.raises(Problem, match=message):
        read_reference(path)


def test_column_that_stands_twice_is_refused(edited: Edit) -> None:
    """Of two columns of one name nobody knows which is meant."""
    edited('unit = "bar"', 'unit = "bar"\ncolumn = "shaft.angle"')
    path = edited("shaft.angle,pump.pressure", "shaft.angle,shaft.angle")
    with pytest.raises(Problem, match=r"ref.csv: column 'shaft.angle' expected once, got it 2 times"):
        read_reference(path)


def test_missing_and_empty_files(tmp_path: Path) -> None:
    """A missing file, a folder, a missing meta file, one without signals, a CSV without numbers are named."""
    csv, toml = tmp_path / "a.csv", tmp_path / "a.toml"
    with pytest.raises(Problem, match=r"a.csv: expected a .csv or .toml file, got no such file"):
        read_reference(csv)
    with pytest.raises(Problem, match=r"expected a .csv or .toml file, got a folder"):
        read_reference(tmp_path)
    csv.write_text("time,x\n0,1\n", encoding="utf-8")
    with pytest.raises(
        Problem, match=r"a.toml: expected a TOML file that describes the columns, got no such"
    ):
        read_reference(csv)
    toml.write_text("[time]\n", encoding="utf-8")
    with pytest.raises(Problem, match=r"a.toml: expected at least one table \[signals.NAME\], got none"):
        read_reference(csv)
    toml.write_text('[signals.x]\nunit = "m"\n', encoding="utf-8")
    with pytest.raises(Problem, match=r"a.csv: expected two or more rows of numbers, got 1"):
        read_reference(csv)
    csv.write_text("", encoding="utf-8")
    with pytest.raises(Problem, match=r"a.csv: column 'time' expected, got no header"):
        read_reference(csv)
    csv.write_bytes(b"time,x\n\xff\xfe,1\n")
    with pytest.raises(Problem, match=r"a.csv: expected text in UTF-8, got "):
        read_reference(csv)
