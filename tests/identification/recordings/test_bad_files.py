"""The message for a bad file is one line with file, row and column, what was expected and what was read."""

import re

import h5py
import numpy as np
import pandas as pd
import scipy.io
from identification.recordings.conftest import edit
from kit.mistakes import problem, table

from fmus.identification.recordings.reading import read, read_folder


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


@table(__file__, "texts", "old, new, told")
def test_bad_text_of_a_csv_is_named(csv, old, new, told):
    """Wrong names, a quotation mark without an end."""
    edit(csv, (old, new))
    refused(csv, "a.csv", told)


def test_a_letter_in_another_encoding_is_named(csv):
    """In a number."""
    csv.write_bytes(csv.read_bytes().replace(b"10.0", b"1\xb5.0", 1))
    refused(csv, "a.csv", "line 4", "expected a number, got '1µ.0'")


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
