"""The message for a bad file is one line with file, row and column, what was expected and what was read."""

import re

import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io

from fmus.identification.recordings.reading import read, read_folder, require
from orchestrator.base.errors import Problem


def refused(path, *parts):
    """Reading fails with a message of one line that contains all parts in order."""
    with pytest.raises(Problem) as caught:
        read(path)
    message = str(caught.value)
    assert "\n" not in message
    assert re.search(".*".join(re.escape(part) for part in parts), message), message


def lines(csv, number, text):
    """Replace a line of the file, counted from 1."""
    written = csv.read_text(encoding="utf-8").splitlines()
    written[number - 1] = text
    csv.write_text("\n".join(written), encoding="utf-8")


@pytest.mark.parametrize(
    ("line", "parts"),
    [
        ("20,0,error,1", ("line 6", "column 'P1'", "a number", "'error'")),
        ("20,0,1.5 bar,1", ("line 6", "column 'P1'", "a number", "'1.5 bar'")),
        ("20,0,inf,1", ("line 6", "column 'P1'", "finite", "inf")),
        ("20,0,True,1", ("line 6", "column 'P1'", "a number", "'True'")),
        ("20,0,2.5", ("line 6", "expected 4 cells, got 3")),
        ("20,0,2.5,1,1", ("line 6", "expected 4 cells, got 5")),
        ('20,0,"2,5",1', ("line 6", "column 'P1'", "a number", "'2,5'", 'set decimal = ","')),
        (",0,2.5,1", ("line 6", "column 't'", "expected a time, got none")),
        ("15,0,2.5,1", ("line 6", "column 't'", "increasing times", "15 after 15")),
        ("14.5,0,2.5,1", ("line 6", "column 't'", "increasing times", "14.5 after 15")),
    ],
)
def test_bad_line_of_a_csv_is_named(csv, line, parts):
    """Lines are counted as in an editor, blank lines included."""
    lines(csv, 6, line)
    refused(csv, "a.csv", *parts)
    lines(csv, 3, "\n" + csv.read_text(encoding="utf-8").splitlines()[2])
    refused(csv, "a.csv", parts[0].replace("6", "7"), *parts[1:])


def test_bad_files_of_text(csv):
    """Wrong names, wrong encoding, an empty file."""
    good = csv.read_text(encoding="utf-8")
    csv.write_text(good.replace("P1", "P2", 1), encoding="utf-8")
    refused(csv, "a.csv", "expected a column 'P1', got t, U, P2")
    csv.write_text(good.replace("Q", "P1", 1), encoding="utf-8")
    refused(csv, "a.csv", "expected the column 'P1' once, got it 2 times")
    csv.write_bytes(good.encode().replace(b"10.0", b"1\xb5.0", 1))
    refused(csv, "a.csv", "line 4", "UTF-8", "0xb5")
    for mark, shown in ((";", "';'"), ("\t", "'\\t'")):
        csv.write_text(good.replace(",", mark), encoding="utf-8")
        refused(csv, "a.csv", "line 1", "separated by ',' (the default)", f"got {shown}: set delimiter = ")
    csv.write_text("t,U,P1,Q\n0,0,0,0\n", encoding="utf-8")
    refused(csv, "a.csv", "two or more rows of numbers, got 1")
    csv.write_text("", encoding="utf-8")
    refused(csv, "a.csv", "two or more rows of numbers, got an empty file")
    csv.write_text(good.replace("\n0.0,", '\n"0.0,', 1), encoding="utf-8")
    refused(csv, "a.csv", "line 2: expected 4 cells, got 1")


def test_marks_that_cannot_be_told_apart(csv):
    """A decimal comma needs another delimiter: the message contains its origin and a remedy."""
    meta = csv.with_suffix(".toml")
    good = meta.read_text(encoding="utf-8")
    for option, delimiter in (("", "','"), ('delimiter = ","', "','")):
        meta.write_text(f'{good}\n[file]\ndecimal = ","\n{option}\n', encoding="utf-8")
        origin = "as set" if option else "the default"
        refused(
            csv,
            "a.csv",
            "delimiter: expected another character",
            f'got {delimiter} ({origin}): set delimiter = ";"',
        )
    meta.write_text(f'{good}\n[file]\ndecimal = "."\ndelimiter = ";;"\n', encoding="utf-8")
    refused(csv, "a.csv", "delimiter: expected one character", "got ';;'")


def test_the_message_on_a_wrong_dimension_has_the_word_of_the_file(csv):
    """The message on a flow in lpm3 contains the unit of the file, not only the SI unit."""
    meta = csv.with_suffix(".toml")
    meta.write_text(meta.read_text(encoding="utf-8").replace("L/min", "lpm3"), encoding="utf-8")
    with pytest.raises(Problem, match=r"signal flow is in lpm3 \(m9/s3\), expected m3/s"):
        require(read(csv), {"flow": "m3/s"})


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
    scipy.io.savemat(path, {**columns, "U": columns["U"][:-1]})
    refused(path, "a.mat", "columns of one length", "U 39")
    scipy.io.savemat(path, {**columns, "P1": "text"})
    refused(path, "a.mat", "column 'P1'", "numbers", "'text'")
    scipy.io.savemat(path, {**columns, "P1": columns["P1"] + 1j})
    refused(path, "a.mat", "column 'P1'", "numbers", "complex")
    scipy.io.savemat(path, {**columns, "P1": np.where(columns["t"] == 10, np.inf, 1.0)})
    refused(path, "a.mat", "row 3", "column 'P1'", "finite", "inf")
    scipy.io.savemat(path, {**columns, "t": columns["t"][::-1]})
    refused(path, "a.mat", "row 2", "column 't'", "increasing", "190 after 195")
    scipy.io.savemat(path, {"run": columns})
    refused(path, "a.mat", "expected a column", "got run.")
    path.write_bytes(b"no mat file" * 50)
    refused(path, "a.mat", "expected a MATLAB file")
    with h5py.File(path, "w") as file:
        file["P1"] = np.zeros((1, 4))
    refused(path, "a.mat", "expected a column", "got P1")


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("noise = 0.1", "nose = 0.1", ("signals.pressure_in", "unknown key 'nose'", "did you mean noise")),
        ("noise = 0.1", "noise = -1", ("signals.pressure_in: noise: expected 0 or more, got -1",)),
        ("noise = 0.1", 'noise = "0.1"', ("noise: expected a number, got '0.1'",)),
        ("span = [1.0, 401.0]", "span = [401, 1]", ("span: expected [lowest, highest], got [401, 1]",)),
        ("span = [1.0, 401.0]", "span = [1]", ("span: expected 2 numbers, got [1]",)),
        ("factor = 40.0", "factor = 0", ("factor: expected another number than 0, got 0",)),
        ('unit = "bar"', 'unit = "barn"', ("signals.pressure_in", "unit 'barn'", "psi")),
        ('unit = "bar"\n', "", ("signals.pressure_in: unit: expected a text, got nothing",)),
        ('unit = "ms"', 'unit = "mm"', ("time: unit: expected a unit of time", "got 'mm'")),
        ('"valve"', '"value"', ("procedure: expected one of valve, hose_resistance", "got 'value'")),
        ("[experiment]", '[experiment]\nuse = "fit"', ("use: expected one of train, test, got 'fit'",)),
        (
            '{ value = 4.0, unit = "ft" }',
            "4.0",
            ("experiment: length: expected a text or a table of value, unit, got 4.0",),
        ),
        (
            '{ value = 4.0, unit = "ft" }',
            '{ value = "4", unit = "ft" }',
            ("experiment.length: value: expected a number, got '4'",),
        ),
        ("[time]", "[tim]", ("unknown key 'tim'; did you mean time",)),
        ("[time]", "[time]\nstart = 7", ("samples from 7 s to inf s", "got -1.5 s")),
        ("[time]", "[file]\nskiplines = 1\n[time]", ("file", "unknown key 'skiplines'", "skip_lines")),
        ("[time]", "[time", ("expected TOML, got",)),
    ],
)
def test_bad_meta_file_is_named_with_what_is_known(csv, old, new, parts):
    """A misspelt key and a wrong value are refused with the allowed keys or values."""
    meta = csv.with_suffix(".toml")
    text = meta.read_text(encoding="utf-8")
    assert old in text
    meta.write_text(text.replace(old, new, 1), encoding="utf-8")
    refused(csv, "a.", *parts)


def test_files_that_are_not_there(csv):
    """The message on a path that cannot be read says what kind of file was expected."""
    refused(csv.with_name("b.csv"), "b.csv", "got no such file")
    refused(csv.with_name("a.xlsx"), "a.xlsx", ".csv, .parquet, .mat or .toml file, got no such file")
    refused(csv.parent.with_suffix(".csv"), "got no such file")
    csv.with_suffix(".mat").write_bytes(b"")
    refused(csv.with_suffix(".toml"), "one data file a.csv, .parquet or .mat, got a.csv, a.mat")
    csv.with_suffix(".toml").unlink()
    refused(csv, "a.toml", "describes the columns", "no such file")
    with pytest.raises(Problem, match=r"\.toml files with a table \[experiment\], got none, only a\.csv"):
        read_folder(csv.parent)
    with pytest.raises(Problem, match="expected a folder of recordings, got a file"):
        read_folder(csv)
