"""Reading reference traces and measurements: what is read, and what every mistake is told."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from kit.mistakes import table

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


@table(__file__, "mistakes", "old, new, message")
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
