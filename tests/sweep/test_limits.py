"""Numbers outside what an FMU declares of its variables are refused before anything is run."""

from __future__ import annotations

from pathlib import Path

import pytest
from kit.any_fmu.edit import edited
from sweep.studies import GAIN, study

from orchestrator import Problem
from orchestrator.ssp.load import load
from orchestrator.studies.cases import resolve
from orchestrator.studies.study import read

FACTOR = '[factors."gain.factor"]\ndistribution = "uniform"\nminimum = 1\nmaximum = 3\n'
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


def _uniform(low: float, high: float, more: str = "") -> str:
    return f'distribution = "uniform", minimum = {low}, maximum = {high}{more}'


def test_minimum_and_maximum_of_a_variable_are_read(bounded: Path) -> None:
    """Its own, and where it has none that of its type."""
    known = load(bounded).components["gain"].interface.variables
    assert (known["offset"].minimum, known["offset"].maximum) == (-0.01, 0.02)
    assert (known["factor"].minimum, known["factor"].maximum) == (None, 5.0)


@pytest.mark.parametrize(
    ("name", "numbers", "expected"),
    [
        (
            "offset",
            _uniform(-0.02, 0),
            'factors."gain.offset": minimum: expected at least -0.01 m, got -0.02 m',
        ),
        ("offset", _uniform(0, 21, ', unit = "mm"'), "maximum: expected at most 0.02 m, got 0.021 m"),
        ("factor", _uniform(1, 6), 'factors."gain.factor": maximum: expected at most 5, got 6'),
        ("factor", _uniform(0.5, 7, ", relative = true"), "maximum: expected at most 5, got 7 (7 times 1)"),
        (
            "offset",
            'distribution = "triangular", minimum = 0, mode = 0.01, maximum = 0.03',
            "maximum: expected at most 0.02 m, got 0.03 m",
        ),
        (
            "factor",
            'distribution = "values", values = [1, 5, 5.5]',
            "values: expected at most 5, got 5.5",
        ),
        ("factor", 'distribution = "normal", mean = 8, sd = 1', "mean: expected at most 5, got 8"),
    ],
)
def test_numbers_outside_are_refused(
    bounded: Path, tmp_path: Path, name: str, numbers: str, expected: str
) -> None:
    """In one line, in the unit of the FMU, whatever that of the study; shares are of the start value 1."""
    file = _file(tmp_path, bounded, name, numbers)
    with pytest.raises(Problem) as wrong:
        resolve(read(file))[0]
    assert str(wrong.value).startswith(f"{file}: factors.")
    assert str(wrong.value).endswith(expected)


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        ("offset", _uniform(-10, 20, ', unit = "mm"')),
        ("offset", _uniform(-1, 2, ', unit = "cm"')),
        ("factor", _uniform(-100, 5)),
        ("factor", 'distribution = "normal", mean = 5, sd = 1'),
        ("factor", 'distribution = "lognormal", mean = 1, sd = 3'),
    ],
)
def test_numbers_up_to_the_ends_are_accepted(bounded: Path, tmp_path: Path, name: str, numbers: str) -> None:
    """Also where a unit is converted; tails of distributions without ends are not looked at."""
    assert resolve(read(_file(tmp_path, bounded, name, numbers)))[0].factors[0].name == f"gain.{name}"


def test_fixed_values_are_checked_and_scale_relative_factors(bounded: Path, tmp_path: Path) -> None:
    """A value outside is refused; relative numbers refer to the fixed value, not to the start value 0."""
    file = _file(tmp_path, bounded, "factor", _uniform(1, 2), '"gain.offset" = 0.05')
    with pytest.raises(Problem, match=r"fixed: gain.offset: expected at most 0.02 m, got 0.05 m$"):
        resolve(read(file))[0]
    shares = _uniform(1, 3, ", relative = true")
    file = _file(tmp_path, bounded, "offset", shares, '"gain.offset" = 0.005')
    assert resolve(read(file))[0].factors[0].relative
    file = _file(tmp_path, bounded, "offset", shares, '"gain.offset" = 0.01')
    with pytest.raises(Problem, match=r"maximum: expected at most 0.02 m, got 0.03 m \(3 times 0.01\)$"):
        resolve(read(file))[0]


@pytest.mark.parametrize(
    ("name", "numbers", "expected"),
    [
        ("manipulator.head_mass", _uniform(-900, 400, ', unit = "kg"'), "at least 0.001 kg, got -900 kg"),
        ("operator_input.swing_1_rise", _uniform(-1, 0.5), "minimum: expected at least 0 s, got -1 s"),
    ],
)
def test_the_machine_refuses_what_cannot_be(
    fmu_dir: Path, tmp_path: Path, name: str, numbers: str, expected: str
) -> None:
    """A mass and a duration are not negative."""
    text = f'system = "{(fmu_dir / "harvester.ssp").as_posix()}"\nmethod = "latin"\nruns = 2\n'
    text += f'[factors]\n"{name}" = {{ {numbers} }}\n'
    text += '[outputs]\nend = { signal = "manipulator.swing_angle", measure = "final" }\n'
    file = tmp_path / "study.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(Problem, match=expected):
        resolve(read(file))[0]
