"""Every file format gives the same recording, in SI, with all entries of its description."""

import math
import re
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io
from identification.recordings.conftest import META, edit
from kit.mistakes import problem, table

from fmus.identification.recordings import reading
from fmus.identification.recordings.reading import read, read_folder
from orchestrator.base.units import factor_and_offset
from orchestrator.data.recording import Recording


def mat_73(path, columns):
    """A MATLAB file of version 7.3: HDF5 after a header of 512 bytes, dimensions reversed."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in columns.items():
            file[name] = values[None, :]
            file[name].attrs["MATLAB_class"] = np.bytes_("double")


WRITERS = {
    ".parquet": lambda path, columns: pd.DataFrame(columns).to_parquet(path),  # NaN becomes null
    "5.mat": lambda path, columns: scipy.io.savemat(path, {n: v[:, None] for n, v in columns.items()}),
    "4.mat": lambda path, columns: scipy.io.savemat(path, columns, format="4"),
    "7.3.mat": mat_73,
}


def same(one, other):
    """Compare two recordings except for the names of their files."""
    np.testing.assert_array_equal(one.time, other.time)
    for name in one.signals:
        np.testing.assert_array_equal(one[name], other[name])
    assert list(one.signals) == list(other.signals)
    fields = ("title", "procedure", "use", "conditions", "units", "sensors")
    assert all(getattr(one, field) == getattr(other, field) for field in fields)


def test_values_are_si_and_the_description_is_complete(csv, columns):
    """Milliseconds, volts of a transducer in bar and litres per minute become s, Pa and m3/s."""
    found = reading.read(csv)
    # the same two or three multiplications in another order: a few rounding errors, here and below
    np.testing.assert_allclose(found.time, columns["t"] / 1000 - 1.5, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(found["pressure_in"], (40 * columns["P1"] + 1) * 1e5, rtol=1e-14)
    np.testing.assert_allclose(found["flow"], columns["Q"] / 6e4, rtol=1e-14)
    assert math.isnan(found["pressure_in"][7])
    assert found.units == {"command": "V", "pressure_in": "Pa", "flow": "m3/s"}
    assert (found.procedure, found.use, found.conditions["edge"]) == ("valve", "train", "P-A")
    assert found.numeric_condition("length") == pytest.approx(4 * 0.3048, rel=1e-14, abs=0)
    sensor = found.sensor("pressure_in")
    assert (sensor.noise, sensor.resolution, sensor.low, sensor.high) == pytest.approx((1e4, 2e4, 1e5, 401e5))
    assert (sensor.zero_error, sensor.delay_error) == pytest.approx((5e4, 0.1))
    assert found.sensor("flow").dead_zone == pytest.approx(10 / 6e4)
    assert found.sensor("flow").zero_error is None  # exact in the joint refinement
    assert "command" not in found.sensors


@pytest.mark.parametrize("kind", WRITERS)
def test_every_kind_of_file_gives_the_same_recording(csv, columns, kind):
    """CSV, Parquet and MATLAB files with the same columns give bit-identical recordings."""
    expected = reading.read(csv)
    other = csv.with_suffix(Path(kind).suffix or kind)
    WRITERS[kind](other, columns)
    same(reading.read(other), expected)
    csv.unlink()
    same(reading.read(csv.with_suffix(".toml")), expected)


def test_columns_of_matlab_structs_and_matrices(csv, columns):
    """A column may be a field of a struct or a column of a matrix, in both versions of MATLAB files."""
    expected = reading.read(csv)
    changes = {'"t"': '"run.clock.t"', '"U"': '"run.U"', '"P1"': '"data(:,2)"', '"Q"': '"data(:,1)"'}
    matrix = np.stack([columns["Q"], columns["P1"]], axis=1)
    old, new = csv.with_name("old.mat"), csv.with_name("new.mat")
    scipy.io.savemat(old, {"run": {"U": columns["U"], "clock": {"t": columns["t"]}}, "data": matrix})
    with h5py.File(new, "w") as file:
        file["run/U"], file["run/clock/t"], file["data"] = columns["U"][None], columns["t"][None], matrix.T
    for path in (old, new):
        path.with_suffix(".toml").write_text(META, encoding="utf-8")
        edit(path.with_suffix(".toml"), *changes.items())
        same(reading.read(path), replace(expected, title=path.stem))


def test_what_loggers_write_for_no_sample_is_a_gap(csv):
    """nan, NA, null and blanks are gaps like an empty cell."""
    for word in ("nan", "NA", "null", "  ", "N/A"):
        lines = csv.read_text(encoding="utf-8").splitlines()
        cells = lines[3].split(",")
        cells[2] = word
        lines[3] = ",".join(cells)
        csv.write_text("\n".join(lines), encoding="utf-8")
        assert np.flatnonzero(np.isnan(reading.read(csv)["pressure_in"])).tolist() == [2, 7]


def test_a_part_and_conditions_of_two_forms_are_read(csv):
    """start and stop of [time] apply to the time after unit and offset.

    The text "870 kg/m3" is what { value = 870, unit = "kg/m3" } is; a text without a unit stays one.
    """
    stated = 'density = "0.87 g/cm3"\nviscosity = { value = 20, unit = "mPa.s" }\nnote = "70 in winter"'
    part = ("[time]", "[time]\nstart = -1.45\nstop = -1.4")
    edit(csv.with_suffix(".toml"), ("[experiment]", f"[experiment]\n{stated}"), part)
    read = reading.read(csv)
    assert len(read.time) == 11  # 0.05 s at 200 Hz, both ends
    assert read.numeric_condition("density") == pytest.approx(870.0, rel=1e-12)
    assert read.numeric_condition("viscosity") == pytest.approx(0.02, rel=1e-12)
    assert read.conditions["note"] == "70 in winter"


def test_folder_has_its_experiments_only(csv):
    """In the order of their names; other data are reported with the reason, and are no experiment."""
    plain = META[META.index("[time]") :]
    for name, meta in {"b": META.replace('"valve"', '"machine"'), "trace": plain}.items():
        csv.with_name(f"{name}.csv").write_bytes(csv.read_bytes())
        csv.with_name(f"{name}.toml").write_text(meta, encoding="utf-8")
    found = reading.read_folder(csv.parent)
    assert [(one.source.name, one.procedure) for one in found] == [("a.csv", "valve"), ("b.csv", "machine")]
    assert reading.read(csv.with_name("trace.csv")).procedure == ""
    csv.with_name("c.mat").write_bytes(b"")
    assert reading.unused_files(csv.parent, found) == [
        "c.mat: left out, c.toml is missing.",
        "trace.csv: left out, trace.toml has no table [experiment].",
    ]


def test_required_signals_have_their_dimension(csv):
    """A procedure that needs a pressure refuses a flow under that name, and a missing signal."""
    found = reading.read(csv)
    reading.require(found, {"pressure_in": "Pa", "flow": "m3/s"})
    told = r"a\.csv: signal flow is in L/min \(m3/s\), expected Pa"
    problem(lambda: reading.require(found, {"flow": "Pa"}), told)
    told = r"a\.csv: expected the signal pressure_out.*got command, pressure_in"
    problem(lambda: reading.require(found, {"pressure_out": "Pa"}), told)


USUAL = {"Pa": (1e5, 1e7), "m3/s": (1e-4, 1e-3), "m": (0.1, 1), "m/s": (0.1, 1), "V": (1, 10)}
USUAL |= {"rad": (0.1, 1), "rad/s": (0.1, 10), "N": (1e3, 1e5), "kg": (10, 1e3)}


@pytest.mark.parametrize(("unit", "low", "high"), [(unit, *sizes) for unit, sizes in USUAL.items()])
def test_signals_far_from_usual_are_doubted(unit, low, high):
    """Ten thousand times as large or small as usual; a time of hours may be in milliseconds."""
    time = np.linspace(0, 9e3, 3)
    for peak, usual in ((1e4 * high, high), (1e-4 * low, low)):
        made = Recording(time, {"x": peak * np.ones(3)}, {"x": unit}, Path("a.csv"))
        (told,) = reading.doubtful([made])
        size, shown = re.search(r"usually about (\S+) ([^;]+);", told).groups()
        assert float(size) * factor_and_offset(shown, unit, "x")[0] == pytest.approx(
            usual, rel=5e-3
        )  # digits
    usual = replace(made, signals={"x": high * np.ones(3)})
    assert reading.doubtful([usual]) == []
    assert reading.doubtful([replace(usual, time=1.2 * time)]) == ["a.csv: 10800 s; did you mean ms?"]
    assert reading.doubtful([replace(made, procedure="rest")]) == []  # a zero, of any size


@pytest.mark.parametrize(("share", "lever", "motion", "named"), [
    (1.0, 0.0, 1.0, True), (-1.0, 0.0, 1.0, True), (0.55, 0.0, 1.0, True), (0.45, 0.0, 1.0, False),
    (1.0, 0.03, 1.0, False), (1.0, 0.01, 1.0, True), (1.0, 0.0, 0.01, False),
])  # fmt: skip
def test_the_pitch_of_a_stick_is_no_angle(share, lever, motion, named):
    """It follows the boom while the lever of the stick is at rest; a wide or quiet boom tells nothing."""
    time = np.arange(4000) / 200
    boom = 0.3 * motion * np.sin(time)
    signals = {reading.BOOM: boom, reading.STICK: share * boom - 1.2}
    signals |= {reading.LEVER: np.where(time > 19, 5, 5 * lever)}
    units = {reading.BOOM: "rad", reading.STICK: "rad", reading.LEVER: "V"}
    made = Recording(time, signals, units, Path("a.csv"), procedure="machine")
    told = reading.doubtful([made])
    assert [("pitch of an inertial sensor" in line) for line in told] == [True] * named


# ---- The message for a bad file is one line with file, row and column, what was expected and what was read


def refused(path, *parts):
    """Reading fails with a message of one line that has all parts in order, also those between "..."."""
    message = problem(lambda: read(path))
    each = [re.escape(piece) for part in parts for piece in part.split(" ... ")]
    assert re.search(".*".join(each), message), message


@table(__file__, "lines", "line, told")
def test_bad_line_of_a_csv_is_named(csv, line, told):
    """Lines are counted as in an editor, blank lines included."""
    written = csv.read_text(encoding="utf-8").splitlines()
    written[5] = line
    for number, more in ((6, ""), (7, "\n")):
        written[2] = more + written[2]
        csv.write_text("\n".join(written), encoding="utf-8")
        refused(csv, "a.csv", f"line {number}", told)


@table(__file__, "descriptions", "old, new, told")
def test_bad_description_is_named_with_what_is_known(csv, old, new, told):
    """A misspelt key and a wrong value are refused with the allowed keys or values."""
    edit(csv.with_suffix(".toml"), (old, new))
    refused(csv, "a.", told)


def test_bad_parquet(csv, columns):
    """A row of a Parquet file is counted from 1."""
    path = csv.with_suffix(".parquet")
    text = [f"{v}" for v in columns["P1"]]
    text[11] = "off"
    pd.DataFrame({**columns, "P1": text}).to_parquet(path)
    refused(path, "a.parquet", "row 12", "column 'P1'", "a number", "'off'")
    pd.DataFrame({**columns, "t": pd.to_datetime(columns["t"], unit="ms")}).to_parquet(path)
    refused(path, "a.parquet", "row 1", "column 't'", "numbers", "timestamp")
    pd.DataFrame({**columns, "Q": np.where(columns["t"] == 10, np.inf, 1.0)}).to_parquet(path)
    refused(path, "a.parquet", "row 3", "column 'Q'", "finite", "inf")
    pd.DataFrame({"t": columns["t"]}).to_parquet(path)
    refused(path, "a.parquet", "expected a column", "got t")
    path.write_bytes(b"no parquet")
    refused(path, "a.parquet", "expected a Parquet file")


def test_bad_mat(csv, columns):
    """A row of a vector is counted from 1, as MATLAB does."""
    path = csv.with_suffix(".mat")
    for name, values, *told in (
        ("U", columns["U"][:-1], "columns of one length", "U 39"),
        ("P1", "text", "column 'P1'", "numbers", "'text'"),
        ("P1", columns["P1"] + 1j, "column 'P1'", "numbers", "complex"),
        ("P1", np.where(columns["t"] == 10, np.inf, 1.0), "row 3", "column 'P1'", "finite", "inf"),
        ("t", columns["t"][::-1], "row 2", "column 't'", "increasing", "190 after 195"),
    ):
        scipy.io.savemat(path, {**columns, name: values})
        refused(path, "a.mat", *told)
    scipy.io.savemat(path, {"run": columns})
    refused(path, "a.mat", "expected a column", "got run.")
    path.write_bytes(b"no mat file" * 50)
    refused(path, "a.mat", "expected a MATLAB file")
    with h5py.File(path, "w") as file:
        file["P1"] = np.zeros((1, 4))
    refused(path, "a.mat", "expected a column", "got P1")


def test_files_that_are_not_there(csv):
    """The message on a path that cannot be read says what kind of file was expected."""
    refused(csv.with_name("b.csv"), "b.csv", "no such file")
    refused(csv.with_name("a.xlsx"), "a.xlsx", "no such file")
    refused(csv.parent.with_suffix(".csv"), "no such file")
    csv.with_suffix(".mat").write_bytes(b"")
    refused(csv.with_suffix(".toml"), "one data file a.csv, .parquet or .mat, got a.csv, a.mat")
    csv.with_suffix(".toml").unlink()
    assert np.isnan(read(csv)["P1"]).any()  # all columns are signals
    problem(lambda: read_folder(csv.parent), r"\.toml files with a table .experiment., got none, only a.csv")
    for number in range(17):
        csv.with_name(f"b{number:02}.csv").touch()
    problem(lambda: read_folder(csv.parent), "got none, only a.csv, a.mat, b00.csv and 16 more")
    problem(lambda: read_folder(csv), "expected a folder of recordings, got a file")
