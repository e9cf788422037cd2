"""One syntax of numbers for all texts: that of XML Schema, against float() of Python, which takes more."""

from fractions import Fraction
from math import inf, nan

import pytest
from kit.mistakes import problem

from orchestrator.base.numerals import fraction, integer, real
from orchestrator.base.options import seconds
from orchestrator.data.table import _number
from orchestrator.data.trace import read_trace
from orchestrator.drive.scene import length
from orchestrator.fmi.description import FmuVariable, parse_float, parse_int, parse_numbers

NO_NUMBERS = [
    "1_0",
    "0x10",
    "0x1p3",
    "\u0663",
    "\uff11",
    "infinity",
    "nan(1)",
    "1e5x",
    "1 0",
    "+-1",
    "1e",
    ".",
    "",
    "1__0",
]
NUMBERS = {
    "1": 1.0,
    "+1.": 1.0,
    " .5 ": 0.5,
    "-1e3": -1000.0,
    "INF": inf,
    "-inf": -inf,
    "1E-400": 0.0,
    "1e400": inf,
}


@pytest.mark.parametrize("text", NO_NUMBERS)
def test_what_is_no_number_is_none_anywhere(text):
    """In attributes, cells, options, lengths of a scene."""
    for reader in (real, integer, fraction):
        with pytest.raises(ValueError, match="number"):
            reader(text)
    assert parse_float(text) is parse_int(text) is None
    assert _number(text) is None or not text  # an empty cell is a gap
    problem(lambda: seconds(text, "step"))
    if text not in ("", "1 0"):  # no words, and two
        problem(lambda: length(f"2*{text}", {}))
        with pytest.raises(ValueError, match="number"):
            parse_numbers(text)


def test_numbers_are_those_of_python():
    """Where both take a text."""
    assert {text: real(text) for text in NUMBERS} == NUMBERS
    assert str(real("NaN")) == str(nan)
    assert (integer(" -12"), parse_int("+7")) == (-12, 7)


@pytest.mark.parametrize("text", ["1_0", "\u0661", "0x10", "1_0.5"])
@pytest.mark.parametrize("gap", ["", "nan"])
def test_a_cell_is_refused_with_its_line_and_column(tmp_path, text, gap):
    """Also beside a gap, where the fast reader of NumPy does not go."""
    (tmp_path / "a.csv").write_text(f"time,a,b\n0,1,{gap}\n1,{text},2\n2,3,3\n", "utf-8")
    told = problem(lambda: read_trace(tmp_path / "a.csv"))
    assert told.startswith(f"{tmp_path / 'a.csv'}: line 3: column 'a': expected a number, got {text!r}")


@pytest.mark.parametrize(
    ("attributes", "found"),
    [
        ({"intervalDecimal": "1e999999999"}, "expected a finite number, got '1e999999999'"),
        ({"intervalDecimal": "INF"}, "expected a finite number"),
        ({"intervalDecimal": "1_0"}, "expected a number, got '1_0'"),
        ({"intervalDecimal": "1/3"}, "expected a number, got '1/3'"),
        ({"intervalCounter": "1", "resolution": "0"}, "expected a resolution of 1 or more, got '0'"),
        ({"intervalCounter": "1_0", "resolution": "2"}, "expected a whole number, got '1_0'"),
        ({"intervalDecimal": "1e-999999999"}, Fraction(0)),
        ({"intervalDecimal": "0.1"}, Fraction(1, 10)),
        ({"intervalDecimal": "1e300"}, Fraction(10**300)),
        ({"intervalCounter": "1", "resolution": "3"}, Fraction(1, 3)),
    ],
)
def test_the_interval_of_a_clock_is_a_finite_number(attributes, found):
    """Exactly as it is written, at once, whatever its exponent."""
    clock = FmuVariable(name="c", type="Clock", attributes=attributes)
    if isinstance(found, Fraction):
        assert clock.fraction("interval") == found
    else:
        with pytest.raises(ValueError, match=found):
            clock.fraction("interval")
