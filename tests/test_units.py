"""Unit strings mean what the SI says."""

import math

import pytest

from fmus.contract import ModelError
from fmus.units import DISPLAY, display, parse, per_second


@pytest.mark.parametrize(
    ("unit", "base"),
    [
        ("1", {}),
        ("Pa", {"kg": 1, "m": -1, "s": -2}),
        ("m3/s", {"m": 3, "s": -1}),
        ("N.m", {"kg": 1, "m": 2, "s": -2}),
        ("N.m.s/rad", {"kg": 1, "m": 2, "s": -1, "rad": -1}),
        ("Pa.s2/m6", {"kg": 1, "m": -7}),
        ("kg.m2", {"kg": 1, "m": 2}),
        ("V", {"kg": 1, "m": 2, "s": -3, "A": -1}),
        ("m3/(s.V.Pa)", {"m": 2, "s": 4, "A": 1, "kg": -2}),
        ("m3/s/Pa", {"m": 4, "s": 1, "kg": -1}),
        ("s-1", {"s": -1}),
    ],
)
def test_unit_has_the_base_units_of_the_si(unit, base):
    """Each unit of the models is a product of base units with factor one."""
    assert parse(unit).base() == base
    assert parse(unit).factor == 1.0


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("bar", 1e5), ("L/min", 1e-3 / 60), ("deg", math.pi / 180), ("kN", 1e3), ("mm2", 1e-6)],
)
def test_other_units_have_their_factor(unit, factor):
    """A unit that is not SI carries its factor to SI."""
    # the same few multiplications in another order: a few rounding errors
    assert parse(unit).factor == pytest.approx(factor, rel=1e-15)


def test_display_units_have_the_dimension_of_their_unit():
    """A pressure is shown in bar, not in degrees."""
    for unit, shown in DISPLAY.items():
        assert parse(unit).exponents == parse(shown).exponents
        assert display(unit)[0] == shown
    # exact powers of ten and 60: rounding only
    assert display("Pa")[1] == pytest.approx(1e-5, rel=1e-15)
    assert display("m3/s")[1] == pytest.approx(6e4, rel=1e-15)
    assert display("kg") is None


@pytest.mark.parametrize("unit", ["1", "rad", "rad/s", "m3/s", "Pa", "N.m", "N/s", "J/(kg.K)", "m/s2"])
def test_derivative_unit_is_the_unit_per_second(unit):
    """The unit of a derivative has one power of the second less."""
    assert parse(per_second(unit)).exponents == parse(unit).times(parse("s"), -1).exponents


@pytest.mark.parametrize(
    ("unit", "word"), [("Pascal", "Pascal"), ("N/m.s", "ambiguous"), ("m^2", r"m\^2"), ("", "symbol")]
)
def test_wrong_unit_is_refused_by_name(unit, word):
    """A unit outside the grammar is an error that shows it."""
    with pytest.raises(ModelError, match=word):
        parse(unit)
