"""The HTML page and the JSON file of an identification."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from identification.report.samples import AREA, page, result, traces
from lxml import html

from fmus.identification.report import identification_page as texts
from fmus.identification.report.identification_page import NAME, report
from fmus.identification.results import Estimate


@pytest.fixture(scope="module")
def text():
    """A page with everything on it."""
    return report(page(figures=(("Swing", traces(), "A caption."),))).html()


SHOWN = (
    "Simulated data (virtual test rig), not FERIC data",
    *("40.10", "39.90 to 40.30", "+0.25 %"),  # valve area in mm2, its interval, change
    *("1 of 30 steps is masked.", "head_mass: the data leave it open by 80 %.", "1 sample clipped."),
    *("123", "0.61 %", "swinging head", "quiet_one"),
    "harvester build --parameters parameters.toml",
)


def test_the_page_has_all_sections_and_escapes_its_texts(text):
    """Each entry of the contents has its section, ids are unique; remarks are no markup; colours vary."""
    tree = html.fromstring(text)
    sections = {s.get("id") for s in tree.iter("section")}
    assert sections == {
        *("values-before", "hose-resistance", "joint-refinement", "effects-in-the-residual"),
        *("swing-over-time", "data-quality", "next-steps"),
    }
    assert [expected for expected in SHOWN if expected not in tree.text_content()] == []
    ids = [e.get("id") for e in tree.iter() if e.get("id")]
    assert len(ids) == len(set(ids))
    assert {a.get("href")[1:] for a in tree.iter("a")} <= set(ids)
    assert "A &lt;b&gt;remark&lt;/b&gt; &amp; more." in text


def test_the_first_screen_has_the_intervals_the_doubts_and_the_worst_fit():
    """Doubtful estimates first, with the reason; the verdict names them; warnings, names in them as code."""
    told, sure = ("At a bound.", "It has no `zero_error` & more."), page()["parameters"][0]
    doubtful = sure | {"estimate": replace(AREA, name="other_area"), "doubt": "at a bound"}
    worst = ("swing.swing_pressure_a", traces(), "NRMSE 5 %")
    shown = report(page(warnings=told, parameters=(sure, doubtful), worst=(worst,)))
    assert (
        shown.verdict == "2 parameters with 95 % intervals from 1 recording; doubtful: other_area; 2 warnings"
    )
    assert shown.passed is False
    assert shown.text().count("warning: ") == 2
    tree = html.fromstring(shown.html())
    first, second = tree.xpath("//header//div[@class='figures']/div[1]//tr[td]")
    assert "at a bound" in first.text_content()
    assert "valve_area" in second.text_content()
    assert tree.xpath("//header//h2")[0].text_content() == "Worst fit: swing.swing_pressure_a"
    assert [p.text_content() for p in tree.xpath("//section[@id='warnings']//p")] == [
        line.replace("`", "") for line in told
    ]
    assert report(page()).passed


@pytest.mark.filterwarnings("error")
def test_what_is_not_there_is_left_out():
    """Sections, if there were only procedures; the correlations of a refinement of one parameter."""
    found = report(page(refinement=None, explanation=None, qualities=(), commands={})).html()
    sections = {s.get("id") for s in html.fromstring(found).iter("section")}
    assert sections == {"values-before", "hose-resistance"}

    one = {"names": ("head_mass",), "correlation": np.ones((1, 1))}
    assert "Large correlations (2)" in report(page()).html()
    assert "Large correlations" not in report(page(refinement=page()["refinement"] | one)).html()


def test_values_are_written_in_si(tmp_path):
    """The JSON file has the values of the page in SI units, and null for an open end of an interval."""
    endless = Estimate("a", 1.0, "1", np.inf, -np.inf, np.inf, "")
    shown = page(explanation=None, results=(result(estimates=(endless,), others=(AREA,)),))
    _, data = report(shown).write(tmp_path / "new" / f"{NAME}.html")
    found = json.loads(data.read_text(encoding="utf-8"), parse_constant=pytest.fail)  # of Infinity and NaN
    estimate = found["parameters"][0]["estimate"]
    assert (estimate["value"], estimate["unit"], estimate["low"]) == (4.01e-5, "m2", 3.99e-5)
    assert found["refinement"]["correlation"][0][1] == 0.9
    assert found["results"][0]["others"][0]["name"] == "valve_area"
    assert found["results"][0]["estimates"][0]["high"] is None
    assert "panels" not in found["results"][0]
    assert found["explanation"] is None


def test_numbers_have_few_digits_in_display_units():
    """Significant digits, typeset powers of ten; SI values are converted, and the unit is typeset."""
    given = [(9.996, 3), (-1234.5, 2), (3.127e11, 3), (float("nan"), 3)]
    shown = ["10.0", "\N{MINUS SIGN}1200", "3.13·10¹¹", "\N{EN DASH}"]
    assert [texts.number(value, digits) for value, digits in given] == shown
    assert texts.value(AREA) == "40.10"
    assert [texts.number(4e-5, 4, *unit) for unit in (["m2"], [])] == ["40.00", "4.000·10⁻⁵"]
    assert [texts.change(1.1, before) for before in (1.0, None)] == ["+10 %", texts.DASH]
    assert texts.probability(1e-9) == "< 0.001"


@given(st.floats(1e-12, 1e12), st.floats(1e-6, 0.3))
def test_a_value_has_the_digits_of_its_interval(value, share):
    """Value and interval are rounded by less than a tenth of the interval."""
    half = value * share
    estimate = Estimate("a", value, "1", half / 2, value - half, value + half, "")
    shown = texts.value(estimate).replace("·10", "e")
    shown = shown.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))
    # the last of two digits of the half width, and at most seven digits at all
    assert abs(float(shown) - value) <= max(0.1 * half, 1e-6 * value)
