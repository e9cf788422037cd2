"""The HTML page and the JSON file of an identification."""

import json
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from identification.report.samples import AREA, page, result, traces
from lxml import html

from fmus.identification.report import report_texts
from fmus.identification.report.figures import estimates_picture
from fmus.identification.report.identification_page import render, write_page
from fmus.identification.results import Estimate
from orchestrator.pages.figures import VENDOR


@pytest.fixture(scope="module")
def text():
    """A page with everything on it."""
    return render(page(figures=(("Swing", traces(), "A caption."),)))


def test_the_page_needs_no_network(text):
    """No style, script, font or picture from elsewhere."""
    library = (VENDOR / "uPlot.iife.min.js").read_text(encoding="utf-8")  # names its home in a comment
    assert not re.findall(r"(?:src|href)=\"(?!data:|#)[^\"]*\"", text)
    assert "http" not in re.sub(r"https?://www\.w3\.org/\S*", "", text.replace(library, ""))
    assert "<script" not in render(page())


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
    assert sections == {"parameters", "hose_resistance", "refinement", "residual", "trace-1", "data", "next"}
    assert [expected for expected in SHOWN if expected not in tree.text_content()] == []
    ids = [e.get("id") for e in tree.iter() if e.get("id")]
    assert len(ids) == len(set(ids))
    assert {a.get("href")[1:] for a in tree.iter("a")} <= set(ids)
    assert "A &lt;b&gt;remark&lt;/b&gt; &amp; more." in text
    assert "Area of &lt;all&gt; edges" in text
    assert "var(--fig-ink, #1c2024)" in text
    assert re.search(r"color: #1c2024|stroke: #1c2024", text) is None


def test_warnings_are_above_the_estimates(text):
    """A block with every warning before the tiles, names in it typeset as code; no block without warnings."""
    told = ("At a bound.", "It has no `zero_error` & more.")
    (block,) = html.fromstring(render(page(warnings=told))).xpath("//header/div[@class='warning']")
    assert [row.text_content() for row in block.iter("li")] == [line.replace("`", "") for line in told]
    assert [code.text for code in block.iter("code")] == ["zero_error"]
    assert block.xpath("following-sibling::div[@class='tiles']")
    assert not html.fromstring(text).xpath("//*[@class='warning']")


@pytest.mark.filterwarnings("error")
def test_what_is_not_there_is_left_out():
    """Sections, if there were only procedures; the matrix of a refinement of one parameter."""
    found = render(page(refinement=None, explanation=None, qualities=(), commands={}))
    sections = {s.get("id") for s in html.fromstring(found).iter("section")}
    assert sections == {"parameters", "hose_resistance"}

    one = {"names": ("head_mass",), "correlation": np.ones((1, 1))}
    shown = render(page(refinement=page()["refinement"] | one))
    assert "Correlation of the estimates" not in shown
    assert "Joint refinement" in shown


def test_values_are_written_in_si(tmp_path):
    """The JSON file has the values of the page in SI units, and null for an open end of an interval."""
    endless = Estimate("a", 1.0, "1", np.inf, -np.inf, np.inf, "")
    shown = page(explanation=None, results=(result(estimates=(endless,), others=(AREA,)),))
    written, data = write_page(tmp_path / "new", shown)
    assert (written.name, data.name) == ("identification.html", "identification.json")
    found = json.loads(data.read_text(encoding="utf-8"), parse_constant=pytest.fail)  # of Infinity and NaN
    estimate = found["parameters"][0]["estimate"]
    assert (estimate["value"], estimate["unit"], estimate["low"]) == (4.01e-5, "m2", 3.99e-5)
    assert found["refinement"]["correlation"][0][1] == 0.9
    assert found["results"][0]["others"][0]["name"] == "valve_area"
    assert found["results"][0]["estimates"][0]["high"] is None
    assert "panels" not in found["results"][0]
    assert found["explanation"] is None


def test_numbers_have_few_digits():
    """Significant digits, typeset powers of ten."""
    given = [(9.996, 3), (-1234.5, 2), (3.127e11, 3), (float("nan"), 3)]
    shown = ["10.0", "\N{MINUS SIGN}1200", "3.13·10¹¹", "\N{EN DASH}"]
    assert [report_texts.number(value, digits) for value, digits in given] == shown


@given(st.floats(1e-12, 1e12), st.floats(1e-6, 0.3))
def test_a_value_has_the_digits_of_its_interval(value, share):
    """Value and interval are rounded by less than a tenth of the interval."""
    half = value * share
    estimate = Estimate("a", value, "1", half / 2, value - half, value + half, "")
    shown = report_texts.value(estimate).replace("·10", "e")
    shown = shown.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))
    # the last of two digits of the half width, and at most seven digits at all
    assert abs(float(shown) - value) <= max(0.1 * half, 1e-6 * value)


def test_parameters_are_shown_in_display_units():
    """SI values are converted to the display unit, and the unit is typeset."""
    assert report_texts.value(AREA) == "40.10"
    assert report_texts.number(4e-5, 4, "m2") == "40.00"
    assert report_texts.number(4e-5, 4) == "4.000·10⁻⁵"
    assert report_texts.half_width(AREA) == "± 0.50 %"
    wide = Estimate("a", 10.0, "1", 10.0, 2.0, 32.0, "")
    assert report_texts.half_width(wide) == "\N{MULTIPLICATION SIGN}÷ 4.0"
    narrow = Estimate("a", 10.0, "1", 2.0, 5.5, 14.5, "")
    assert report_texts.half_width(narrow) == "± 45 %"
    assert "÷" in report_texts.half_width(Estimate("a", 10.0, "1", 3.0, 4.5, 15.5, ""))
    assert report_texts.change(1.1, 1.0) == "+10 %"
    assert report_texts.change(1.1, None) == report_texts.DASH
    assert report_texts.probability(1e-9) == "< 0.001"


def places(*found):
    """Those of value, low, high and value before in the picture, and the reach of its axis."""
    rows = [
        {"estimate": Estimate("a", v, "1", 1, low, high, ""), "prior": prior} for v, low, high, prior in found
    ]
    reach, drawn = estimates_picture(rows)
    return reach, [ends for _, ends in drawn]


def test_the_picture_shows_values_over_those_before():
    """Twice is at the right end of an axis to 2, half at the left one; what leaves the axis is cut."""
    ends = [[50, 100, 100], [0, 0, pytest.approx(25)]]
    assert places((2.0, 1.0, 2.0, 1.0), (0.5, 0.5, 2**-0.5, 1.0)) == (2, ends)
    assert places((-3.0, -3.0, -1.5, -1.5)) == (2, ends[:1])
    reach, ends = places((1.0, -np.inf, np.inf, None), (1.0, -1.0, 100.0, 0.0), (0.0, 0.0, 1.0, None))
    assert (reach, ends) == (10, [[0, 50, 100], [0, 50, 100]])
    assert places() == (1.1, [])
