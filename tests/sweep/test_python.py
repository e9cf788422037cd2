"""A study that is built in Python is the one that a file describes, and is checked like one."""

from __future__ import annotations

from dataclasses import replace

import pytest
from kit.mistakes import problem
from sweep.studies import GAIN, content, run, study

from orchestrator.studies import Factor, Output, Study, read_results, read_study, sweep
from orchestrator.studies.cases import resolve


@pytest.fixture
def built(gain) -> Study:
    """The study of the gain in Python."""
    return Study(
        "A gain",
        str(gain),
        runs=12,
        seed=3,
        stop=0.2,
        step=0.01,
        factors=(Factor("gain.factor", "uniform", {"minimum": 1, "maximum": 3}),),
        outputs=(Output("end", "gain.y", "final", band=True),),
        fixed={"gain.u": (200, "cm")},
    )


def test_python_and_file_give_the_same_results(built, gain, one, tmp_path):
    """Byte by byte: units and names of outputs come from the FMU in both."""
    text = GAIN.replace('"gain.fmu"', f'"{gain.as_posix()}"')
    run(study(tmp_path, text, gain), one, "file")
    results = sweep(built, tmp_path / "python", client=one)
    assert content(tmp_path / "python") == content(tmp_path / "file")
    assert results.study == resolve(read_study(tmp_path / "study.toml"))[0]
    assert read_results(tmp_path / "python").table.equals(results.table)
    assert not (tmp_path / "python" / "study.toml").exists()


def test_a_resolved_study_is_resolved(built):
    """Its numbers are in the units of the FMUs already."""
    first = resolve(built)[0]
    assert resolve(first)[0] == first
    assert first.fixed == {"gain.u": 2.0}


# what a file is told of when it is read, and one mistake that file and Python share
@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"method": "latim"}, "method: expected one of latin, sobol, grid, saltelli, morris, got 'latim'"),
        ({"runs": 0}, "runs: expected a whole number of at least 1, got 0"),
        ({"outputs": (Output("end", "gain.y", "last"),)}, "outputs.end: measure: expected one of maximum"),
        ({"method": "grid", "runs": 0}, "distribution: expected values, as the method is grid"),
        ({"fixed": {"gain.w": 1.0}}, "unknown variable 'gain.w'"),
    ],
    ids=str,
)
def test_mistakes_name_the_study(built, changed, expected):
    """In one line, by the title of the study."""
    line = problem(lambda: resolve(replace(built, **changed)))
    assert line.startswith("study 'A gain': ")
    assert expected in line


@pytest.mark.parametrize(
    ("distribution", "numbers", "expected"),
    [
        ("even", {"minimum": 1, "maximum": 3}, "distribution: expected one of uniform, normal"),
        ("normal", {"mean": 1, "sd": 0}, "sd: expected a positive number, got 0"),
        ("values", {"values": [1, 1]}, "values: expected different numbers, got [1, 1]"),
    ],
)
def test_a_factor_refuses_impossible_numbers(distribution, numbers, expected):
    """When it is made."""
    line = problem(lambda: Factor("gain.factor", distribution, numbers))
    assert line.startswith(f'factors."gain.factor": {expected}')
