"""Unit strings mean what the SI says; other units are converted, or refused by name."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.mistakes import problem, table

from fmus.export.model_description import base_unit
from orchestrator.base import units
from orchestrator.base.errors import Problem


@table(__file__, "base", "unit, base")
def test_unit_has_the_base_units_of_the_si(unit, base):
    """Each unit of the models is a product of base units with factor one."""
    assert units.parse_unit(unit).base() == base
    assert units.parse_unit(unit).factor == 1.0


def test_display_units_have_the_dimension_of_their_unit():
    """A pressure is shown in bar, not in degrees."""
    for unit, shown in units.DISPLAY.items():
        assert units.parse_unit(unit).exponents == units.parse_unit(shown).exponents
        assert units.display_conversion(unit)[0] == shown
    # exact powers of ten and 60: rounding only
    assert units.display_conversion("Pa")[1] == pytest.approx(1e-5, rel=1e-15)
    assert units.display_conversion("m3/s")[1] == pytest.approx(6e4, rel=1e-15)
    assert units.display_conversion("kg") is None


@pytest.mark.parametrize("unit", ["1", "rad", "rad/s", "m3/s", "Pa", "N.m", "N/s", "J/(kg.K)", "m/s2"])
def test_derivative_unit_is_the_unit_per_second(unit):
    """The unit of a derivative has one power of the second less."""
    assert (
        units.parse_unit(units.per_second(unit)).exponents
        == units.parse_unit(unit).times(units.parse_unit("s"), -1).exponents
    )


@table(__file__, "wrong", "unit, word")
def test_wrong_unit_is_refused_by_name(unit, word):
    """A unit outside the grammar is an error that shows it."""
    problem(lambda: base_unit(unit), word)


@table(__file__, "logged", "unit, value, si, name")
def test_units_of_loggers_become_si(unit, value, si, name):
    """A value in a unit of a logger comes out right in the SI unit of the same quantity."""
    found = units.parse_unit(units.normalised(unit))
    assert units.si_unit(units.normalised(unit)) == name
    # the digits printed in the table
    assert found.factor * value + found.offset == pytest.approx(si, rel=1e-8)
    assert (units.parse_unit(name).factor, units.parse_unit(name).offset) == (1.0, 0.0)


PARTS = st.tuples(
    st.sampled_from(
        ["bar", "kN", "mm", "L", "min", "deg", "rev", "psi", "gpm", "A", "K", "g", "J", "%", "ms"]
    ),
    st.integers(-3, 3).filter(bool),
)


@given(parts=st.lists(PARTS, min_size=1, max_size=4))
def test_any_product_has_an_si_unit(parts):
    """It has the same dimension and factor 1."""
    text = ".".join(f"{symbol}{power}" for symbol, power in parts)
    unit, si = units.parse_unit(text), units.parse_unit(units.si_unit(text))
    assert si.exponents == unit.exponents
    assert si.factor == 1.0


# ---- samples and mistakes


@table(__file__, "samples", "unit, value, si, name")
def test_known_samples(unit: str, value: float, si: float, name: str) -> None:
    """A known sample comes out right in SI and back again."""
    # exact definitions; the digits printed in the table
    assert units.convert(np.array([value]), unit, name, "x")[0] == pytest.approx(si, rel=1e-8)
    assert units.convert(np.array([si]), name, unit, "x")[0] == pytest.approx(value, rel=1e-8)


POWERS = ["km999", "km-999", "m100", "m" + "9" * 5000, "km99.km99", "(" * 5000 + "m" + ")" * 5000]


UNKNOWN = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))["unknown"]


@pytest.mark.parametrize("unit", [*UNKNOWN, *POWERS])
def test_unknown_unit_is_refused(unit: str) -> None:
    """A unit that is not known, or can be read in two ways, is named, not guessed."""
    expected = f"file: unit '{unit}' is unknown, expected one like bar"[:1000]  # a long message is cut
    assert problem(lambda: units.parse_unit(unit, "file")).startswith(expected)


def test_wrong_units_are_refused() -> None:
    """The nearest known unit is proposed; units of other quantities cannot be converted."""
    assert "; did you mean bar" in problem(lambda: units.parse_unit("barr"))
    # a degree in German, not 1e9 rad
    assert problem(lambda: units.parse_unit("Grad")).endswith("; did you mean deg?")
    with pytest.raises(Problem, match="boom: unit 'bar' cannot be converted, expected a unit like 'rad'"):
        units.factor_and_offset("bar", "rad", "boom")
    problem(lambda: units.factor_and_offset("Hz", "rad/s", "x"), "'Hz' cannot be converted")


def test_unknown_and_display_units() -> None:
    """A unit that stays the same may be unknown; readers see bar, L/min, deg, deg/s and kN, else the unit."""
    assert units.factor_and_offset("furlong", "furlong", "x") == (1.0, 0.0)
    seen = {"Pa": "bar", "m3/s": "L/min", "rad": "deg", "rad/s": "deg/s", "N": "kN"}
    same = {unit: unit for unit in ("V", "m", "odd", "")}
    assert {unit: units.reader_unit(unit) for unit in seen | same} == seen | same
