"""The page of a study: it stands alone, shows what is there, and is the same for the same results."""

import json
import re

import numpy as np
import pytest
from sweep.pages import CASES, TWO, UNIT, shown, written
from sweep.synthetic import ISHIGAMI, effects, every, finding, ishigami, results

from orchestrator.base.text import display_unit
from orchestrator.pages.figures import TraceFigure, TraceLine, TracePanel, plot
from orchestrator.pages.plotting import draw
from orchestrator.studies.analysis.analyse import sentences
from orchestrator.studies.study import Choice
from orchestrator.studies.study_page import _dots, bands, histogram, medians, tornado


@pytest.mark.parametrize("case", CASES)
def test_the_page_stands_alone(case: str) -> None:
    """Whatever came of a study there is a page, with no address of another file or server in it."""
    found, _, page, numbers = shown(case)
    assert page.rstrip().endswith("</html>")
    places = re.findall(r"""(?:src|href|xlink:href)\s*=\s*["']([^"']*)|url\(([^)]*)\)|@import""", page)
    assert {p for pair in places for p in pair if p and not p.startswith(("#", "data:"))} == set()
    assert "nan" not in re.sub(r"base64,[^\"]*", "", page).lower().replace("nance", "")
    assert numbers["runs"] == len(found.table)


def test_failed_runs_are_shown_with_their_reason() -> None:
    """Counts, and a row for each kind of reason with its first run; that the numbers are without them."""
    found, analysis, page, _ = shown("failed runs")
    bad = int((found.table["status"] != "ok").sum())
    assert f"{bad} of {len(found.table)} runs failed or ended early" in page
    assert "state became inf at 0.4 s" in page
    assert "(run 50; the numbers differ from run to run)" in page
    told = [(f.reason, f.examples[:3], f.various) for f in analysis.failures]
    assert ("mass is -2 kg", (50, 100, 150), True) in told
    assert sum(f.count for f in analysis.failures) == bad


def test_equal_results_have_equal_pages_which_say_what_the_analysis_says() -> None:
    """The same bytes, a title with < in it as it is; sentences and numbers in brackets of analysis.json."""
    again = written(CASES["one factor"]())
    assert (again.page, again.numbers) == shown("one factor")[2:]
    assert "&lt;b&gt;peaks&lt;/b&gt;" in again.page
    assert "<b>peaks</b>" not in again.page
    _, analysis, page, numbers = shown("saltelli")
    told = sentences(analysis.findings[0])
    assert numbers["sentences"] == {"peak": told}
    assert all(sentence in page for sentence in told)
    assert numbers["findings"][0]["unit"] == "Pa"
    assert numbers["findings"][0]["sensitivity"]["effects"][0]["name"] == "x1"


@pytest.mark.parametrize(("case", "choices"), [("saltelli", ", 1 choice"), ("latin", "")])
def test_one_option_is_no_choice(case: str, choices: str) -> None:
    """It says what all runs have."""
    _, _, page, numbers = shown(case)
    names = {effect["name"] for effect in numbers["findings"][0]["sensitivity"]["effects"]}
    assert names == {"x1", "x2", "x3", *(["swing"] if choices else [])}
    assert f"3 factors{choices}, " in page
    assert "By parameters" not in page
    assert "reach (in all runs)" in page


def test_the_number_at_the_top_is_called_the_median() -> None:
    """With the unit; or it says that all runs have the same number, or that none has one."""
    page = shown("latin").page
    heads = re.findall(r"<th[^>]*>([^<]*)</th>", page[: page.index("</header>")])
    assert heads == ["output", "median", "in nine of ten runs", "what it is"]
    assert '30 bar</td><td class="n">in all 20 runs<' in shown("constant").page
    assert '<td class="n">no run has it<' in shown("all failed").page


def test_the_line_of_a_scatter_is_the_median_in_bins() -> None:
    """On a staircase the medians are its steps, where there are few values and where there are many."""
    x = np.repeat([1.0, 2.0, 3.0], 5)
    assert medians(x, 10 * x)[1].tolist() == [10.0, 20.0, 30.0]
    many = np.linspace(0, 1, 240)
    assert medians(many, many)[1] == pytest.approx((np.arange(12) + 0.5) / 12, abs=1 / 240)  # one sample


@pytest.mark.parametrize("choice", [None, TWO])
def test_the_drawn_bands_are_those_of_pandas(choice):
    """Median, area and dashed lines in bar, over all runs and by option, where some runs failed."""
    found = results(ishigami, ISHIGAMI, "saltelli", 32, [TWO], failed=every(25))
    (panel,) = bands(found, "part.pressure", display_unit("Pa"), choice).panels
    ended = found.bands.merge(found.table[found.table["status"] == "ok"], on="run")
    groups = [ended] if choice is None else [ended[ended[choice.column] == o] for o in choice.options]
    levels, pressures = [0, 0.05, 0.5, 0.95, 1], [part.groupby("time")["part.pressure"] for part in groups]
    quantiles = [pressure.quantile(levels).unstack() / 1e5 for pressure in pressures]
    columns = [0.5, 0.0, 1.0] if choice is None else [0.5]
    expected = [own[column] for own in quantiles for column in columns]
    for line, own in zip(panel.lines, expected, strict=True):
        # rounding only: of sums, of numbers near zero too
        assert line.values == pytest.approx(own.to_numpy(), rel=1e-12, abs=1e-12)
        assert line.time == pytest.approx(own.index.to_numpy(), rel=1e-12)
    for area, own in zip(panel.areas, quantiles, strict=True):
        assert area.low == pytest.approx(own[0.05].to_numpy(), rel=1e-12, abs=1e-12)
        assert area.high == pytest.approx(own[0.95].to_numpy(), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("choices", [(), (TWO,)])
@pytest.mark.parametrize("runs", [8, 16])
def test_shares_end_within_the_axis(runs, choices):
    """All marks, of a linear model (8) and of Sobol' indices (16); a cap at 100 % is in sight."""
    study = results(lambda x: 1e5 * (10 * x["x1"] ** 4 + 0.1 * x["x2"]), UNIT, "saltelli", runs, choices)
    found = finding(study)
    estimate = effects(found)["x1"].estimates[found.sensitivity.measure]
    assert estimate.ceiling > 1.03  # beyond the axis, if it were drawn as it is
    figure = tornado(found, found.sensitivity)
    for line in figure.panels[0].lines:
        assert 0.0 <= np.nanmin(line.time) <= np.nanmax(line.time) <= 100.0
    assert figure.window == (0.0, 100.0)
    whole = ("total", "total, choice", "first order") if runs == 16 else ("factor", "choice")
    expected = {"95 %", *(name for name in whole if choices or "choice" not in name)}
    assert {line.name for line in figure.panels[0].lines} == expected
    assert figure.panels[0].words[0.0] == "x1"  # on top, which is the largest row


def test_a_histogram_counts_every_run_once() -> None:
    """Stacked options: the outline of all is drawn first, and its steps are the counts of all runs."""
    found = results(ishigami, ISHIGAMI, "saltelli", 32, [TWO], failed=every(25))
    counted = finding(found)
    figure = histogram(found, found.study.outputs[0], counted, TWO)
    first, second, lines = figure.panels[0].lines
    assert len(draw(figure).axes[0].patches) == 2  # also for a file
    done = (found.table["status"] == "ok").to_numpy()
    # exact identity: counts
    assert first.values[1:-1:2].sum() == done.sum()
    assert second.values[1:-1:2].sum() == (done & (found.table[TWO.column] == TWO.options[0])).sum()
    spread = counted.spread
    quantiles = [spread.low, spread.median, spread.high]
    assert lines.time[::3] == pytest.approx(np.array(quantiles) / 1e5, rel=1e-12)  # rounding


@pytest.mark.parametrize(("count", "told"), [(4, ""), (5, "e"), (7, "e, f, g")])
def test_options_without_a_colour_are_named(count: int, told: str) -> None:
    """Bands have four colours; the line below names the other options."""
    page = written(results(ishigami, ISHIGAMI, "latin", 28, [Choice("pose", tuple("abcdefg"[:count]))])).page
    assert re.findall("not drawn: (.*?); ", page) == [told] * bool(told)


@pytest.mark.parametrize("runs", [2000, 2003])
def test_at_most_two_thousand_dots_are_embedded(runs: int) -> None:
    """Of all options together, in proportion; the caption counts them."""
    x, groups = np.linspace(0.0, 1.0, runs), (slice(0, 501), slice(501, runs))
    dots = [TraceLine(x[rows], x[rows], {"color": "#000000", "marker": "o"}) for rows in groups]
    figure = TraceFigure([TracePanel("", dots)], axis="x")
    spec = json.loads(re.search(r'json">(.*?)</script>', str(plot(figure, "Dots")), re.DOTALL)[1])
    counts = [columns[0] for columns in spec["columns"][::2]]
    assert sum(counts) == 2000
    assert counts[0] == pytest.approx(501 * 2000 / runs, abs=1)  # a whole number
    assert _dots(runs) == ("A dot for each run" if runs == 2000 else "Dots for 2000 of 2003 runs")
