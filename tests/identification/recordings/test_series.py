"""A file of numbers without a description becomes a recording."""

import numpy as np
import pytest
from kit.mistakes import table

from fmus.identification.recordings.reading import read_series
from orchestrator.base.errors import Problem

VALUES = np.stack([np.linspace(-1, 1, 1024), np.sin(np.linspace(0, 20, 1024))], axis=1)


@pytest.mark.parametrize("mark", [" ", "\t", ",", ";", "   "])
def test_plain_text_is_read_whatever_separates_it(tmp_path, mark):
    """Two columns of numbers without names, units and time become two signals at the given rate."""
    path = tmp_path / "actuator.dat"
    np.savetxt(path, VALUES, fmt="%.17g", delimiter=mark)
    found = read_series(path, {"command": 0, "pressure": 1}, rate=50.0, units={"pressure": "bar"})
    np.testing.assert_array_equal(found["command"], VALUES[:, 0])
    # one multiplication: one rounding
    np.testing.assert_allclose(found["pressure"], 1e5 * VALUES[:, 1], rtol=1e-15)
    np.testing.assert_array_equal(found.time, np.arange(1024) / 50)
    assert found.units == {"command": "1", "pressure": "Pa"}
    assert (found.procedure, found.title) == ("", "actuator")


def test_only_the_columns_asked_for_must_be_numbers(tmp_path):
    """A date in another column does not matter; a named column is selected by its name."""
    path = tmp_path / "named.csv"
    path.write_text("when,u\nMonday,1\nTuesday,2\n", encoding="utf-8")
    np.testing.assert_array_equal(read_series(path, {"command": "u"})["command"], [1, 2])
    np.testing.assert_array_equal(read_series(path, {"command": 1}, skip_lines=1)["command"], [1, 2])


@table(__file__, "mistakes", "columns, options, message")
def test_what_cannot_be_read_is_named(tmp_path, columns, options, message):
    """A message of one line for each error of the file or the call."""
    path = tmp_path / "plain.txt"
    path.write_text("1 2\n3 4\n5 x\n", encoding="utf-8")
    with pytest.raises(Problem) as caught:
        read_series(path, columns, **options)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text", ["0,5;1\n1;-2,5e1\n", "0,5 1\n1 -2,5e1\n", "0.5,1\n1,-25\n", "0.5 1\n1 -25\n"]
)
def test_a_decimal_comma_is_found(tmp_path, text):
    """A comma inside cells with another delimiter is decimal; otherwise it is the delimiter."""
    (tmp_path / "a.txt").write_text(text)
    found = read_series(tmp_path / "a.txt", {"u": 0, "y": 1})
    np.testing.assert_array_equal(found["u"], [0.5, 1.0])
    np.testing.assert_array_equal(found["y"], [1.0, -25.0])
