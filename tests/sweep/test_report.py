"""The page of a study: it stands alone, shows what is there, and is the same for the same results."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from sweep.synthetic import ISHIGAMI, ishigami, results, uniform

from orchestrator.base.text import display_unit
from orchestrator.studies.analysis.analyse import analyse
from orchestrator.studies.analysis.analysis_text import sentences
from orchestrator.studies.report.study_figures import bands, medians, quantiles
from orchestrator.studies.report.study_page import NUMBERS, PAGE, write
from orchestrator.studies.store import Results
from orchestrator.studies.study import Choice, Factor

TWO = Choice("swing", ("lumped", "detailed"))
MANY = Choice("parameters", ("near", "nominal", "reach", "raised"))
ONE = (uniform("x1", 0.0, 1.0),)


def _some(table: pd.DataFrame) -> np.ndarray:
    return (table["run"] % 25 == 0).to_numpy()


CASES: dict[str, Callable[[], Results]] = {
    "saltelli": lambda: results(ishigami, ISHIGAMI, "saltelli", 32, [TWO]),
    "latin": lambda: results(ishigami, ISHIGAMI, "latin", 220),
    "morris": lambda: results(ishigami, ISHIGAMI, "morris", 6, [TWO, MANY]),
    "failed runs": lambda: results(ishigami, ISHIGAMI, "saltelli", 32, [MANY], failed=_some),
    "all failed": lambda: results(ishigami, ISHIGAMI, "latin", 20, failed=lambda t: np.ones(len(t), bool)),
    "constant": lambda: results(lambda x: np.full(len(x["x1"]), 3e6), ONE, "latin", 20),
    "one factor": lambda: results(lambda x: x["x1"], ONE, "latin", 20),
    "one run": lambda: results(lambda x: x["x1"], ONE, "latin", 1),
    "choices only": lambda: results(lambda x: 1.0 * (x["swing"] == "lumped"), (), "grid", 0, [TWO]),
    "grid": lambda: results(
        lambda x: x["x1"] ** 2, [Factor("x1", "values", {"values": (1.0, 2.0)}, relative=True)], "grid", 0
    ),
    "no bands": lambda: replace(results(ishigami, ISHIGAMI, "latin", 30), bands=None),
}


def _written(folder: Path, found: Results) -> tuple[str, dict[str, object]]:
    write(folder, found, analyse(found))
    return (folder / PAGE).read_text("utf-8"), json.loads((folder / NUMBERS).read_text("utf-8"))


@pytest.mark.parametrize("name", CASES)
def test_the_page_stands_alone(name: str, tmp_path: Path) -> None:
    """Whatever came of a study there is a page, with no address of another file or server in it."""
    found = CASES[name]()
    page, numbers = _written(tmp_path, found)
    assert page.rstrip().endswith("</html>")
    places = re.findall(r"""(?:src|href|xlink:href)\s*=\s*["']([^"']*)|url\(([^)]*)\)|@import""", page)
    assert {p for pair in places for p in pair if p and not p.startswith(("#", "data:"))} == set()
    assert "nan" not in re.sub(r"base64,[^\"]*", "", page).lower().replace("nance", "")
    assert numbers["runs"] == len(found.table)


def test_failed_runs_are_shown_with_their_reason(tmp_path: Path) -> None:
    """Counts, reason, and that the numbers are without them."""
    found = CASES["failed runs"]()
    page, _ = _written(tmp_path, found)
    bad = int((found.table["status"] != "ok").sum())
    assert f"{bad} of {len(found.table)} runs failed or ended early" in page
    assert "state became inf at 0.4 s" in page


def test_equal_results_have_equal_pages(tmp_path: Path) -> None:
    """The same bytes, so that a page can be kept under version control."""
    pages = [_written(tmp_path, CASES["saltelli"]()) for _ in range(2)]
    assert pages[0] == pages[1]


def test_the_page_says_what_the_analysis_says(tmp_path: Path) -> None:
    """The sentences and the numbers in brackets are those of analysis.json."""
    found = CASES["saltelli"]()
    page, numbers = _written(tmp_path, found)
    told = sentences(analyse(found).findings[0])
    assert numbers["sentences"] == {"peak": told}
    assert all(sentence in page for sentence in told)
    findings = numbers["findings"]
    assert isinstance(findings, list)
    assert findings[0]["unit"] == "Pa"
    assert findings[0]["sensitivity"]["effects"][0]["name"] == "x1"


def test_names_of_users_do_not_become_markup(tmp_path: Path) -> None:
    """A title with < in it is shown as it is."""
    found = CASES["one factor"]()
    page, _ = _written(tmp_path, replace(found, study=replace(found.study, title="<b>peaks</b>")))
    assert "&lt;b&gt;peaks&lt;/b&gt;" in page
    assert "<b>peaks</b>" not in page


def test_bands_are_quantiles_over_the_runs() -> None:
    """At each time those of all runs, by an independent route."""
    found = CASES["latin"]()
    assert found.bands is not None
    time, bands = quantiles(found.bands, "part.pressure")
    at = found.bands.loc[np.isclose(found.bands["time"], time[5]), "part.pressure"]
    # rounding only
    assert bands[:, 5] == pytest.approx(at.quantile([0, 0.05, 0.5, 0.95, 1]).to_numpy(), rel=1e-12)


def test_the_line_of_a_scatter_is_the_median_in_bins() -> None:
    """On a staircase the medians are its steps, where there are few values and where there are many."""
    x = np.repeat([1.0, 2.0, 3.0], 5)
    assert medians(x, 10 * x)[1].tolist() == [10.0, 20.0, 30.0]
    many = np.linspace(0, 1, 240)
    assert medians(many, many)[1] == pytest.approx((np.arange(12) + 0.5) / 12, abs=1 / 240)  # one sample


def test_a_browser_shows_the_page_without_any_request(tmp_path: Path, chromium: Any) -> None:
    """In Chromium: nothing is asked from anywhere, no error, and nothing is wider than a narrow window."""
    _written(tmp_path, CASES["failed runs"]())
    asked: list[str] = []
    page = chromium.new_page(viewport={"width": 700, "height": 800})
    page.on("request", lambda request: asked.append(request.url))
    page.on("pageerror", lambda error: asked.append(str(error)))
    page.goto((tmp_path / PAGE).as_uri())
    width = page.evaluate("document.documentElement.scrollWidth")
    figures = page.evaluate("[...document.querySelectorAll('figure svg')].map(s => s.clientHeight)")
    page.close()
    assert [url for url in asked if not url.startswith("data:")] == [(tmp_path / PAGE).as_uri()]
    assert width <= 700
    assert len(figures) >= 5
    assert min(figures) > 100


@pytest.mark.parametrize("choice", [None, TWO])
def test_the_drawn_bands_are_those_of_pandas(choice: Choice | None) -> None:
    """Median, area and dashed lines in bar, over all runs and by option, where some runs failed."""
    found = results(ishigami, ISHIGAMI, "saltelli", 32, [TWO], failed=_some)
    assert found.bands is not None
    (panel,) = bands(found, "part.pressure", display_unit("Pa"), choice).panels
    ended = found.bands.merge(found.table[found.table["status"] == "ok"], on="run")
    groups = [ended] if choice is None else [ended[ended[choice.column] == o] for o in choice.options]
    quantiles = [
        part.groupby("time")["part.pressure"].quantile([0, 0.05, 0.5, 0.95, 1]).unstack() / 1e5
        for part in groups
    ]
    columns = [0.5, 0.0, 1.0] if choice is None else [0.5]
    expected = [own[column] for own in quantiles for column in columns]
    assert len(panel.lines) == len(expected)
    for line, own in zip(panel.lines, expected, strict=True):
        # rounding only: of sums, of numbers near zero too
        assert line.values == pytest.approx(own.to_numpy(), rel=1e-12, abs=1e-12)
        assert line.time == pytest.approx(own.index.to_numpy(), rel=1e-12)
    for area, own in zip(panel.areas, quantiles, strict=True):
        assert area.low == pytest.approx(own[0.05].to_numpy(), rel=1e-12, abs=1e-12)
        assert area.high == pytest.approx(own[0.95].to_numpy(), rel=1e-12, abs=1e-12)
