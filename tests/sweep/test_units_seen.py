"""Units for a reader: bar and mm instead of Pa and thousandths of a metre, one unit for all of an output."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from sweep.synthetic import finding, results, uniform

from orchestrator.base.text import display_unit
from orchestrator.studies.analysis.analyse import analyse
from orchestrator.studies.analysis.analysis_text import sentences
from orchestrator.studies.parameter_study import summary
from orchestrator.studies.report.study_figures import scatter
from orchestrator.studies.report.study_page import NUMBERS, PAGE, distribution_text, write

SPACE = (uniform("x1", 0.0, 1.0), uniform("x2", 0.0, 1.0))


@pytest.mark.parametrize(
    ("unit", "largest", "shown", "scale"),
    [
        ("m", 0.00492, "mm", 1e3),
        ("m", -0.05, "mm", 1e3),
        ("m", 0.5, "m", 1.0),
        ("m/s", 0.02, "mm/s", 1e3),
        ("Pa", 1.2631e7, "bar", 1e-5),
        ("Pa", 0.01, "bar", 1e-5),
        ("", 0.01, "", 1.0),
    ],
)
def test_the_unit_follows_from_the_largest_number(
    unit: str, largest: float, shown: str, scale: float
) -> None:
    """mm and mm/s where all is small, else the units of all other reports."""
    own = display_unit(unit, largest)
    assert own.name == shown
    assert own.factor == pytest.approx(scale, rel=1e-15)  # rounding


@pytest.mark.parametrize("method", ["saltelli", "morris", "latin"])
def test_a_small_length_is_told_in_mm_everywhere(method: str, tmp_path: Path) -> None:
    """Sentences, tiles, tables and axes; the numbers for machines stay in m."""
    found = results(lambda x: 0.004 + 1e-3 * x["x1"] + 1e-4 * x["x2"], SPACE, method, 32, unit="m")
    said = " ".join(sentences(finding(found)))
    assert re.search(r"the median is 4\.\d+ mm", said)
    write(tmp_path, found, analyse(found))
    page = (tmp_path / PAGE).read_text("utf-8")
    assert "Statistics, in mm" in page
    assert not re.search(r"0\.00\d+ m\b", page)
    spread = json.loads((tmp_path / NUMBERS).read_text("utf-8"))["findings"][0]["spread"]
    assert 0.004 <= spread["median"] <= 0.0051


def test_one_large_number_keeps_all_in_metres() -> None:
    """No sentence mixes m and mm."""
    said = " ".join(sentences(finding(results(lambda x: 0.2 * x["x1"], SPACE, "saltelli", 32, unit="m"))))
    assert " m" in said
    assert "mm" not in said


def test_a_factor_is_told_in_one_unit_too() -> None:
    """By the largest number of its distribution."""
    assert distribution_text(uniform("bore", 0.001, 0.05)) == "1 to 50 mm"
    assert distribution_text(uniform("bore", 0.001, 0.5)) == "0.001 to 0.5 m"


def test_the_command_line_prints_bar() -> None:
    """And never powers of ten of Pa."""
    text = summary(results(lambda x: 1.2631e7 + 1e3 * x["x1"], SPACE, "latin", 20))
    name, low, mean, high, unit = text.splitlines()[-1].split()
    assert (name, unit) == ("peak", "bar")
    assert 126.31 <= float(low) <= float(mean) <= float(high) <= 126.32


def test_what_is_set_for_all_runs_has_its_unit(tmp_path: Path) -> None:
    """The unit is that of the results; a name that sets several variables has none."""
    found = results(lambda x: x["x1"], SPACE, "latin", 20)
    study = replace(found.study, fixed={"supply.pressure": 2.0684e7, "levers": 3.6})
    found = replace(found, study=study, units={**found.units, "start:supply.pressure": "Pa"})
    write(tmp_path, found, analyse(found))
    page = (tmp_path / PAGE).read_text("utf-8")
    assert "<th>supply.pressure</th><td>206.84 bar</td>" in page
    assert "<th>levers</th><td>3.6</td>" in page


@pytest.mark.parametrize(("method", "lines"), [("latin", 1), ("sobol", 1), ("morris", 0)])
def test_morris_has_no_line_through_its_levels(method: str, lines: int, tmp_path: Path) -> None:
    """Medians of few points at four levels zigzag for factors that do nothing; the caption names no line."""
    found = results(lambda x: x["x1"] + x["x2"], SPACE, method, 32)
    own = finding(found)
    assert own.sensitivity is not None
    made = scatter(found, found.study.outputs[0], own, own.sensitivity)
    assert made is not None
    assert [len(axes.get_lines()) for axes in made.axes] == [lines, lines]
    write(tmp_path, found, analyse(found))
    assert ("the line is the median" in (tmp_path / PAGE).read_text("utf-8")) == bool(lines)
