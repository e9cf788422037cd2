"""Units of files and figures."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from kit.mistakes import problem, table

from orchestrator.base.errors import Problem
from orchestrator.base.units import convert, factor_and_offset, parse_unit, reader_unit


@table(__file__, "samples", "unit, value, si, name")
def test_known_samples(unit: str, value: float, si: float, name: str) -> None:
    """A known sample comes out right in SI and back again."""
    # exact definitions; the digits printed in the table
    assert convert(np.array([value]), unit, name, "x")[0] == pytest.approx(si, rel=1e-8)
    assert convert(np.array([si]), name, unit, "x")[0] == pytest.approx(value, rel=1e-8)


POWERS = ["km999", "km-999", "m100", "m" + "9" * 5000, "km99.km99", "(" * 5000 + "m" + ")" * 5000]


UNKNOWN = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))["unknown"]


@pytest.mark.parametrize("unit", [*UNKNOWN, *POWERS])
def test_unknown_unit_is_refused(unit: str) -> None:
    """A unit that is not known, or can be read in two ways, is named, not guessed."""
    expected = f"file: unit '{unit}' is unknown, expected one like bar"
    assert problem(lambda: parse_unit(unit, "file")).startswith(expected[:1000])  # a long message is cut


def test_wrong_quantity_is_refused() -> None:
    """Units of different quantities cannot be converted, a frequency is no angular speed."""
    with pytest.raises(Problem, match="boom: unit 'bar' cannot be converted, expected a unit like 'rad'"):
        factor_and_offset("bar", "rad", "boom")
    with pytest.raises(Problem, match="'Hz' cannot be converted"):
        factor_and_offset("Hz", "rad/s", "x")


def test_same_unit_needs_no_table() -> None:
    """A unit that stays the same may be unknown."""
    assert factor_and_offset("furlong", "furlong", "x") == (1.0, 0.0)


def test_display_units() -> None:
    """Readers see bar, L/min, deg, deg/s and kN; other units stay as they are."""
    seen = {"Pa": "bar", "m3/s": "L/min", "rad": "deg", "rad/s": "deg/s", "N": "kN"}
    same = {unit: unit for unit in ("V", "m", "odd", "")}
    assert {unit: reader_unit(unit) for unit in seen | same} == seen | same
