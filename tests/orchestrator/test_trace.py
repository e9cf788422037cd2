"""Trace files: numbers survive bit for bit, and every mistake names file, line and column."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from kit.mistakes import problem, table

from orchestrator import Problem, Trace, read_trace, write_trace
from orchestrator.data import csv_text
from orchestrator.data.table import split_unit
from orchestrator.data.trace_writer import by_repr


@pytest.fixture
def trace():
    values = np.random.default_rng(1).standard_normal(50) * 10.0 ** np.arange(-25, 25)
    return Trace(np.arange(50) * 0.1, {"a.y": values, "b.x, odd": -values}, {"a.y": "Pa"})


def test_the_text_of_a_number_is_the_shortest_one():
    """C writes what Python's repr does: any bits, both neighbours of powers of two and ten, ties, no numbers.

    exact identity: bytes
    """
    bits = np.random.default_rng(0).integers(0, 1 << 64, 20_000, dtype=np.uint64).view(float)
    powers = np.array([*2.0 ** np.arange(-1074, 1024), *(float(f"1e{n}") for n in range(-323, 309))])
    with np.errstate(over="ignore", invalid="ignore"):
        near = [*(np.nextafter(powers, way) for way in (-np.inf, np.inf)), bits.round(3)]
    others = [0.0, -0.0, 9007199254740993.0, 5e-324, 1e16, 9.5e-5, 0.1 + 0.2, np.nan, np.inf, -np.inf]
    values = np.concatenate([bits, powers, -powers, *near, np.arange(-99, 100) / 8, others])
    assert csv_text.rows_text(values[:, None]) == by_repr(values[:, None])


# without NUL, with which MATLAB fills texts up
NAME = st.text(
    st.characters(exclude_categories=["Cs"], exclude_characters="\0") | st.sampled_from(" ,;\"'\n\r\t.#"),
    min_size=1,
)


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".mat"])
@given(names=st.lists(NAME, min_size=1, max_size=5, unique=True), unit=NAME)
def test_any_names_survive(tmp_path_factory, suffix, names, unit):
    """Names with line breaks, commas, quotes and white space, and any unit, are read as they were written.

    In a text file without metadata, a name that ends in a unit in brackets is a name and its unit.
    """
    names = [name if name != "time" else "a.time" for name in names]
    assume(suffix != ".csv" or all(split_unit(name)[0] == name for name in names))
    time = np.arange(3.0)
    signals = {name: time + i for i, name in enumerate(names)}
    path = tmp_path_factory.getbasetemp() / f"names{suffix}"
    back = read_trace(write_trace(Trace(time, signals, {names[0]: unit}), path))
    assert list(back.signals) == list(signals)
    assert all((back[name] == values).all() for name, values in signals.items())
    assert back.units == ({names[0]: unit} if suffix != ".csv" else {})


def test_an_unknown_signal_is_told_with_what_it_could_be(trace):
    """As a KeyError, like those of a mapping, and as a Problem in plain words."""
    for kind in (KeyError, Problem):
        with pytest.raises(kind, match=r"^no signal b.y in the run; did you mean a.y\?$"):
            trace["b.y"]
    problem(lambda: trace.select(["pump"]), r"^no signal pump in the run; there are a.y, b.x, odd$")


def test_values_at_any_times_and_windows_of_a_trace():
    """A window has the samples at its ends, though they differ in the last digit: 3 * 0.3 is below 0.9."""
    ramp = Trace(np.array([1.0, 2.0]), {"u": np.array([10.0, 20.0])})  # linear between, held outside
    np.testing.assert_array_equal(ramp.at([0.0, 1.5, 9.0])["u"], [10.0, 15.0, 20.0])
    assert ramp.at(1.5)["u"] == [15.0]
    assert "at 1 times" in repr(ramp.at(1.5))
    time = 0.3 * np.arange(6)
    assert time[3] < 0.9
    assert Trace(time, {"u": time}).window(0.9, 1.5).time[0] == time[3]
    assert len(Trace(time, {"u": time}).window(0.0, 0.9 - 1e-3).time) == 3


@table(__file__, "mistakes", "text, message")
def test_mistakes_in_a_csv_are_located(tmp_path, text, message):
    """File, line as an editor counts it, and column, expected and got."""
    path = tmp_path / "bad.csv"
    path.write_bytes(text.encode())
    assert problem(lambda: read_trace(path), message).startswith(str(path))


@table(__file__, "other_tools", "text, time, u")
def test_files_as_other_tools_write_them(tmp_path, text, time, u):
    """Rows of one event, whose first and last are its limits; a last comma."""
    (tmp_path / "t.csv").write_text(text, encoding="utf-8")
    trace = read_trace(tmp_path / "t.csv")
    np.testing.assert_allclose(trace.time, time, rtol=1e-15)  # rounding of 0.1 - 1e-6
    np.testing.assert_array_equal(trace["u"], u)


def test_missing_rows_of_a_uniform_file_are_a_gap(tmp_path):
    """A recording at 200 Hz that lacks ten rows is refused; a file with irregular times is not."""
    time = np.arange(100) * 0.005
    gap, path = np.delete(time, slice(40, 50)), tmp_path / "gap.csv"
    write_trace(Trace(gap, {"u": gap}), path)
    told = r"line 42: expected a sample every 0.005 s, got none between 0.195 and 0.25 s"
    problem(lambda: read_trace(path), told)
    points = np.array([0, 0.1, 0.15, 2, 5, 20])
    write_trace(Trace(points, {"u": points}), path)
    assert len(read_trace(path).time) == 6


def test_unknown_formats_and_missing_files_are_told(tmp_path, trace):
    """The file name is in the message."""
    problem(lambda: write_trace(trace, tmp_path / "a.txt"), "a.txt: expected a file name ending in .csv, ")
    problem(lambda: read_trace(tmp_path / "none.csv"), r"none.csv: no such file")
    (tmp_path / "fake.parquet").write_text("time,u")
    problem(lambda: read_trace(tmp_path / "fake.parquet"), r"fake.parquet: expected a Parquet file")
