"""Units for a reader: bar and mm instead of Pa and thousandths of a metre, one unit for all of an output."""

import re

import pytest
from kit.mistakes import table
from sweep.pages import UNIT, shown
from sweep.synthetic import finding, results, uniform

from orchestrator.base.text import display_unit
from orchestrator.studies.analysis.analyse import analyse, sentences
from orchestrator.studies.study_page import distribution_text, scatter, study_report


@table(__file__, "units", "unit, largest, shown, scale")
def test_the_unit_follows_from_the_largest_number(unit, largest, shown, scale):
    """mm and mm/s where all is small, else the units of all other reports."""
    own = display_unit(unit, largest)
    assert own.name == shown
    assert own.factor == pytest.approx(scale, rel=1e-15)  # rounding


@pytest.mark.parametrize("case", ["failed runs", "morris", "no bands"])
def test_a_small_length_is_told_in_mm_everywhere(case: str) -> None:
    """Sentences, tiles, tables and axes; the numbers for machines stay in m."""
    _, _, page, numbers = shown(case)
    assert re.search(r"the median is 4\.\d+ mm", " ".join(numbers["sentences"]["peak"]))
    assert "Statistics, in mm" in page
    assert not re.search(r"0\.00\d+ m\b", page)
    assert 0.004 <= numbers["findings"][0]["spread"]["median"] <= 0.0051


def test_no_text_mixes_two_units_of_one_quantity() -> None:
    """No sentence mixes m and mm; a factor has the unit of the largest number of its distribution."""
    said = " ".join(sentences(finding(results(lambda x: 0.2 * x["x1"], UNIT, "saltelli", 32, unit="m"))))
    assert " m" in said
    assert "mm" not in said
    assert distribution_text(uniform("bore", 0.001, 0.05)) == "1 to 50 mm"
    assert distribution_text(uniform("bore", 0.001, 0.5)) == "0.001 to 0.5 m"


def test_the_command_line_prints_bar() -> None:
    """And never powers of ten of Pa."""
    found = results(lambda x: 1.2631e7 + 1e3 * x["x1"], UNIT, "latin", 20)
    text = study_report(found, analyse(found)).text()
    line = next(line for line in text.splitlines() if line.startswith("peak "))
    assert line.split()[:6] == ["peak", "126", "bar", "126", "to", "126"]


def test_what_is_set_for_all_runs_has_its_unit() -> None:
    """The unit is that of the results; a name that sets several variables has none."""
    page = shown("one factor").page
    assert "<th>supply.pressure</th><td>206.84 bar</td>" in page
    assert "<th>levers</th><td>3.6</td>" in page


@pytest.mark.parametrize(("case", "lines"), [("no bands", 1), ("morris", 0)])
def test_morris_has_no_line_through_its_levels(case: str, lines: int) -> None:
    """Medians of few points at four levels zigzag for factors that do nothing; the caption names no line."""
    found, analysis, page, _ = shown(case)
    own = analysis.findings[0]
    made = scatter(found, found.study.outputs[0], own, own.sensitivity)
    drawn = {factor: [line.style for line in figure.panels[0].lines] for factor, figure in made.items()}
    assert {factor: sum("marker" not in s for s in styles) for factor, styles in drawn.items()} == {
        "x1": lines,
        "x2": lines,
    }
    assert ("the line is the median" in page) == bool(lines)
