"""Numbers outside what an FMU declares of its variables are refused before anything is run."""

import math
from pathlib import Path

import pytest
from kit.any_fmu.edit import edited
from kit.mistakes import table
from sweep.studies import FACTOR, GAIN, machine, refused, resolved, study, uniform

from orchestrator.ssp.load import load

TYPE = '<TypeDefinitions><SimpleType name="Few"><Real max="5"/></SimpleType></TypeDefinitions>'


@pytest.fixture(scope="module")
def bounded(gain: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The gain whose offset is -0.01 to 0.02 m by itself, and whose factor is at most 5 by its type."""
    return edited(
        gain,
        tmp_path_factory.mktemp("bounded") / "gain.fmu",
        (r'(name="offset"[^>]*>\s*<Real)', r'\1 min="-0.01" max="0.02"'),
        (r'(name="factor"[^>]*>\s*<Real)', r'\1 declaredType="Few"'),
        ("(</UnitDefinitions>)", rf"\1{TYPE}"),
    )


def _file(folder: Path, fmu: Path, name: str, numbers: str, fixed: str = "") -> Path:
    """The study of the gain with another factor, and more fixed numbers."""
    text = GAIN.replace(FACTOR, f'[factors]\n"gain.{name}" = {{ {numbers} }}\n')
    text = text.replace('"gain.u" = 2', f'"gain.u" = 2\n{fixed}')
    return study(folder, text.replace('"latin"\nruns = 12', '"grid"') if "values" in numbers else text, fmu)


def test_minimum_and_maximum_of_a_variable_are_read(bounded: Path) -> None:
    """Its own, and where it has none that of its type."""
    known = load(bounded).components["gain"].interface.variables
    assert known["offset"].bounds == (-0.01, 0.02)
    assert known["factor"].bounds == (-math.inf, 5.0)


@table(__file__, "outside", "name, numbers, expected")
def test_numbers_outside_are_refused(bounded, tmp_path, name, numbers, expected):
    """In one line, in the unit of the FMU, whatever that of the study; shares are of the start value 1."""
    line = refused(_file(tmp_path, bounded, name, numbers))
    assert line.startswith("factors.")
    assert line.endswith(expected)


@table(__file__, "inside", "name, numbers")
def test_numbers_up_to_the_ends_are_accepted(bounded: Path, tmp_path: Path, name: str, numbers: str) -> None:
    """Also where a unit is converted; tails of distributions without ends are not looked at."""
    assert resolved(_file(tmp_path, bounded, name, numbers)).factors[0].name == f"gain.{name}"


def test_fixed_values_are_checked_and_scale_relative_factors(bounded: Path, tmp_path: Path) -> None:
    """A value outside is refused; relative numbers refer to the fixed value, not to the start value 0."""
    file = _file(tmp_path, bounded, "factor", uniform(1, 2), '"gain.offset" = 0.05')
    assert refused(file) == "fixed: gain.offset: expected at most 0.02 m, got 0.05 m"
    shares = uniform(1, 3, ", relative = true")
    assert resolved(_file(tmp_path, bounded, "offset", shares, '"gain.offset" = 0.005')).factors[0].relative
    line = refused(_file(tmp_path, bounded, "offset", shares, '"gain.offset" = 0.01'))
    assert line.endswith("maximum: expected at most 0.02 m, got 0.03 m (3 times 0.01)")


@table(__file__, "impossible", "name, numbers, expected")
def test_the_machine_refuses_what_cannot_be(fmu_dir, tmp_path, name, numbers, expected):
    """A mass and a duration are not negative."""
    assert expected in refused(machine(tmp_path, fmu_dir, name, numbers))
