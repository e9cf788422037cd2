"""Numbers, units and tables as a reader sees them."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from markupsafe import Markup

from orchestrator.base.text import (
    TextTable,
    display_unit,
    error_display_unit,
    join_words,
    number,
    percentage,
    sentences,
    typeset,
)
from orchestrator.base.units import pretty
from orchestrator.pages.html_page import json_values

TABLE = TextTable(["name", "value"], [["a", "1"], ["<b>", "unstable"]], title="Title", strong=["unstable"])


@given(st.floats(-1e12, 1e12), st.integers(1, 6), st.booleans())
def test_a_number_is_rounded_to_its_digits(value, digits, zeros):
    """By at most half a unit of the last digit, however it is written."""
    error = abs(float(number(value, digits, zeros=zeros)) - value)
    # exact identity: the rounding itself, and that of binary numbers
    assert error <= 0.5001 * abs(value) * 10.0 ** (1 - digits)


@pytest.mark.parametrize(
    ("value", "text"), [(None, "-"), (float("nan"), "-"), (float("inf"), "-"), (0.005, "0.5 %"), (1, "100 %")]
)
def test_a_share_is_a_percentage(value, text):
    """A dash where there is no finite number."""
    assert percentage(value) == text


def test_print_has_other_signs_than_a_terminal():
    """Powers of ten, minus signs and dashes; dates and names stay; words become lists and sentences."""
    assert typeset("-1e-07 at 2026-11-21, a-1") == "\N{MINUS SIGN}1·10⁻⁷ at 2026-11-21, a-1"
    assert typeset("-") == "\N{EN DASH}"
    text = "R is 2.5e-13 +- 1e+03 Pa, eq. (1), stage1end"
    assert typeset(text) == "R is 2.5·10⁻¹³ ± 1·10³ Pa, eq. (1), stage1end"
    units = {"Pa.s2/m6": "Pa·s²/m⁶", "m3/(s.Pa^0.5)": "m³/(s·Pa^0.5)", "L/min": "L/min", "s-1": "s⁻¹"}
    assert {unit: pretty(unit) for unit in units} == units
    assert error_display_unit("m").ascii(1e-3) == "1 mm"
    assert display_unit("1").text(-0.5) == "\N{MINUS SIGN}0.5"
    assert display_unit("m3/(s.V)").text(9.38e-13) == "9.38·10⁻¹³ m³/(s·V)"
    assert error_display_unit("N.m").text(-2e-4) == "\N{MINUS SIGN}2·10⁻⁷ kN·m"
    joined = [join_words(words) for words in (["a"], ["a", "b"], ["a", "b", "c"])]
    assert joined == ["a", "a and b", "a, b and c"]
    assert sentences("one", "", "two.") == "One. Two."


def test_one_table_for_terminal_document_and_page():
    """Aligned; what stands out is bold; pages escape; a row of one cell is the heading of a group."""
    assert TABLE.lines() == ["name     value", "a            1", "<b>   unstable"]
    assert TABLE.markdown().splitlines()[1:] == ["|---|--:|", "|a|1|", "|<b>|**unstable**|"]
    assert "<td>&lt;b&gt;</td>" in TABLE.html()
    assert "<td><code>" in TextTable(["x"], [[Markup("<code>y</code>")]]).html()
    assert '<th colspan="2" scope="rowgroup">all</th>' in TextTable(["x", "y"], [["all"], ["a", "b"]]).html()


@pytest.mark.parametrize(
    ("rows", "heads"),
    [([["a", "", "1"], ["b", "", ""]], "x z"), ([["all"], ["", "2", ""]], "x y"), ([], "x y z")],
)
def test_a_page_has_no_column_without_text(rows, heads):
    """Numbers stay right-aligned; the heading of a group spans the columns that are left."""
    page = TextTable(["x", "y", "z"], rows).html()
    assert re.findall("<th[^>]*>([xyz])</th>", page) == heads.split()
    assert page.count('<th class="n">') == len(heads.split()) - 1
    assert ("scope" in page) == ('colspan="2"' in page)


def test_json_knows_no_infinity():
    """What is not finite is null, also deep inside."""
    found = json_values({"a": (float("inf"), [1.5, True, None]), 2: "x"})
    assert found == {"a": [None, [1.5, True, None]], "2": "x"}
