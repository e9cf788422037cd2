"""Units of files and figures."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from orchestrator.base.errors import Problem
from orchestrator.base.units import convert, factor_and_offset, parse_unit, reader_unit

# Unit, value in it, value in SI, SI unit: by definition (pound 0.45359237 kg, inch 25.4 mm, gallon 231 in3).
SAMPLES = [
    ("bar", 206.84, 20.684e6, "Pa"),
    ("psi", 3000.0, 20.6842719e6, "Pa"),
    ("MPa", 20.684, 20.684e6, "Pa"),
    ("mbar", 1013.25, 101325.0, "Pa"),
    ("L/min", 60.0, 1e-3, "m3/s"),
    ("l/min", 329.0, 5.48333333e-3, "m3/s"),
    ("gpm", 1.0, 6.30901964e-5, "m3/s"),
    ("gal/min", 1.0, 6.30901964e-5, "m3/s"),
    ("cm3/s", 1e6, 1.0, "m3/s"),
    ("deg", 180.0, pi, "rad"),
    ("°/s", 90.0, pi / 2, "rad/s"),
    ("rpm", 60.0, 2 * pi, "rad/s"),
    ("kN", 1.5, 1500.0, "N"),
    ("kN.m", 31.0, 31e3, "N.m"),
    ("lbf", 1.0, 4.4482216152605, "N"),
    ("hp", 152.0, 113.3463805e3, "W"),
    ("mm", 725.0, 0.725, "m"),
    ("mm2", 1e6, 1.0, "m2"),
    ("in3", 231.0, 3.785411784e-3, "m3"),
    ("ms", 5.0, 5e-3, "s"),
    ("mV", 250.0, 0.25, "V"),
    ("degC", 40.0, 313.15, "K"),
    ("degF", 212.0, 373.15, "K"),
    ("%", 50.0, 0.5, "1"),
    ("s-1", 2.0, 2.0, "Hz"),
    ("m³/(s·Pa)", 1.0, 1.0, "m3/s/Pa"),
    ("N*m*s/rad", 1.0, 1.0, "N.m.s/rad"),
    ("m s-1", 2.0, 2.0, "m/s"),
    (" kN  m ", 2.0, 2000.0, "N.m"),
    ("L / min", 60.0, 1e-3, "m3/s"),
    ("N.m/(rad/s)", 3.0, 3.0, "N.m.s/rad"),
    ("Pa/(kg/s)", 3.0, 3.0, "m-1.s-1"),
    ("W/((m2 K))", 3.0, 3.0, "kg.s-3.K-1"),
    ("m**2.s^-1", 3.0, 3.0, "m2/s"),
    ("\u03bcm", 3.0, 3e-6, "m"),
    ("degC2", 3.0, 3.0, "K2"),
    ("degF-1", 5.0, 9.0, "K-1"),
    ("W/degC", 3.0, 3.0, "W/K"),
]


@pytest.mark.parametrize(("unit", "value", "si", "name"), SAMPLES)
def test_known_samples(unit: str, value: float, si: float, name: str) -> None:
    """A known sample comes out right in SI and back again."""
    # exact definitions; the digits printed in SAMPLES
    assert convert(np.array([value]), unit, name, "x")[0] == pytest.approx(si, rel=1e-8)
    assert convert(np.array([si]), name, unit, "x")[0] == pytest.approx(value, rel=1e-8)


NAMES = ["furlong", "PSI", "barg", "Nm", "3", "kpsi", "m/furlong", "Unit Not Applicable", "[m]"]
SLIPS = ["m s -1", "m 3", "(m", "m)", "m(s)", "m..s", "m/", "/m", "()", "()m", "N//m", "N/m.s", "m/s kg"]
POWERS = ["km999", "km-999", "m100", "m" + "9" * 5000, "km99.km99", "(" * 5000 + "m" + ")" * 5000]


@pytest.mark.parametrize("unit", [*NAMES, *SLIPS, *POWERS])
def test_unknown_unit_is_refused(unit: str) -> None:
    """A unit that is not known, or can be read in two ways, is named, not guessed."""
    with pytest.raises(Problem) as problem:
        parse_unit(unit, "file")
    expected = f"file: unit '{unit}' is unknown, expected one like bar"
    assert str(problem.value).startswith(expected[:1000])  # a long message is cut


def test_wrong_quantity_is_refused() -> None:
    """Units of different quantities cannot be converted, a frequency is no angular speed."""
    with pytest.raises(Problem, match="boom: unit 'bar' cannot be converted, expected a unit like 'rad'"):
        factor_and_offset("bar", "rad", "boom")
    with pytest.raises(Problem, match="'Hz' cannot be converted"):
        factor_and_offset("Hz", "rad/s", "x")


def test_same_unit_needs_no_table() -> None:
    """A unit that stays the same may be unknown."""
    assert factor_and_offset("furlong", "furlong", "x") == (1.0, 0.0)


@pytest.mark.parametrize(
    ("unit", "display"),
    [
        ("Pa", "bar"),
        ("m3/s", "L/min"),
        ("rad", "deg"),
        ("rad/s", "deg/s"),
        ("N", "kN"),
        ("V", "V"),
        ("m", "m"),
        ("odd", "odd"),
        ("", ""),
    ],
)
def test_display_units(unit: str, display: str) -> None:
    """Readers see bar, L/min, deg, deg/s and kN; other units stay as they are."""
    assert reader_unit(unit) == display
