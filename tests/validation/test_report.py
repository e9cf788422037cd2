"""The report: one file, complete, offline, and the same numbers as JSON."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from kit import shards
from markupsafe import Markup
from validation.conftest import Edit

from orchestrator.data.recording import read_recording
from orchestrator.data.trace import Trace
from orchestrator.pages.figures import VENDOR
from orchestrator.results.layout import FigureSpec, PanelSpec
from orchestrator.results.validation import Validation, validate
from orchestrator.results.validation_report import Report, ReportedComponent, ReportedParameter, write_report

VOID = {"meta", "link", "br", "wbr", "input", "img"}


class Page(HTMLParser):
    """Collects addresses and checks that every element is closed in its turn."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.ids: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href")]
        self.ids += [value or "" for name, value in attrs if name == "id"]

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def report(outcome: Validation, trace: Trace) -> Report:
    """A report with everything in it."""
    rows = PanelSpec("Command", ("pump.command",)), PanelSpec("Angle", ("shaft.angle",))
    pressure = (PanelSpec("Pressure", ("pump.pressure",)),)
    return Report(
        "Shaft & pump",
        outcome,
        figures=(FigureSpec("Shaft", rows), FigureSpec("Pump", pressure, caption="Taken at the <port>.")),
        trace=trace,
        facts={"system": "shaft.ssp", "communication step [s]": 1e-3, "stopped early": False},
        components=(ReportedComponent("pump", "pump.fmu", version="1.2", guid="{1-2-3}", fmi="2.0"),),
        parameters=(
            ReportedParameter("pump", "volume", 1.5e-3, "m3", "Dead volume", "assumed", changed=True),
        ),
        card={"real-time factor": np.float64(31.25), "energy residual [J]": {"shaft": 1e-3}, "order": None},
        machine=Markup("<p>machine</p>"),
        warnings=("pump: pressure above 300 bar at 1.2 s",),
    )


@pytest.fixture(scope="module")
def files(report: Report, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The written HTML and JSON."""
    return write_report(tmp_path_factory.mktemp("report") / "out" / "report.html", report)


@pytest.fixture(scope="module")
def page(files: tuple[Path, Path]) -> str:
    """The written HTML."""
    return files[0].read_text(encoding="utf-8")


def written(folder: Path, report: Report) -> str:
    """The HTML of another report."""
    return write_report(folder / "report.html", report)[0].read_text(encoding="utf-8")


def test_is_one_file_that_needs_no_network(page: str) -> None:
    """Every address points into the page itself or holds its data; ids are unique; nothing names a host."""
    parser = Page()
    parser.feed(page)
    assert parser.open == []
    assert len(parser.ids) == len(set(parser.ids))
    inside = {f"#{name}" for name in parser.ids}
    assert [a for a in parser.addresses if a not in inside and not a.startswith("data:")] == []
    library = (VENDOR / "uPlot.iife.min.js").read_text(encoding="utf-8")  # names its home in a comment
    assert not re.search(r"https?:|//\w+\.\w+|@import|url\((?!#)", page.replace(library, ""))


def test_shows_what_ran_and_how_well(page: str, report: Report) -> None:
    """Signals, units, limits, facts, FMUs, parameters, card and warnings are all in the text."""
    expected = [row.signal for row in report.validation.rows]
    expected += ["Shaft &amp; pump", "✓ pass", "max. error ≤ 2 bar", "NRMSE ≤ 1 %", "Shaft &lt;angle&gt;"]
    expected += ["shaft.ssp", "{1-2-3}", "Dead volume", "1 changed for this run", "31.25", "0.001"]
    expected += ["pressure above 300 bar", "Taken at the &lt;port&gt;.", "compared at the 201 samples"]
    text = page.replace("<wbr>", "").lower()
    assert [one for one in expected if one.lower() not in text] == []


def test_json_has_the_same_numbers(report: Report, files: tuple[Path, Path]) -> None:
    """report.json holds the exact numbers of the comparison and everything that was handed in."""
    path = files[1]
    data = json.loads(path.read_text(encoding="utf-8"))
    assert path.name == "report.json"
    assert data["passed"] is True
    assert data["verdict"] == report.validation.verdict
    for row, stored in zip(report.validation.rows, data["signals"], strict=True):
        assert (stored["signal"], stored["unit"], stored["passed"]) == (row.signal, row.unit, row.passed)
        for name in ("rmse", "nrmse", "fit", "maximum_error", "vaf"):
            assert stored["metrics"][name] == getattr(row.metrics, name)
        assert stored["metrics"]["iso"]["reason"] == "not requested"
    assert data["signals"][1]["tolerance"]["limit"] == 2e5
    assert data["accuracy"] == report.card  # a number of NumPy is one
    assert data["parameters"][0]["value"] == 1.5e-3
    assert data["reference"]["file"] == "ref.csv"


def test_a_missed_limit_is_plain_to_see(report: Report, edited: Edit, trace: Trace, tmp_path: Path) -> None:
    """A failed run says so at the top, in the table and in the figure, in words and not by colour alone."""
    failed = validate(trace, read_recording(edited("limit = 2.0", "limit = 0.9")), rate=False)
    page = written(tmp_path, replace(report, validation=failed))
    expected = ["✗ fail", "1 of 2 signals within their limits", "✗ 1 bar"]
    expected += ['<span class="mark fail">fail</span>']
    assert [text for text in expected if text not in page] == []
    assert json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))["passed"] is False


def test_a_simulated_reference_is_told_as_one(page: str, report: Report, tmp_path: Path) -> None:
    """What a pass means, only where the reference is a simulation; notes and warnings follow the machine."""
    line = "Reference: a simulation of the same equations."
    assert line not in page  # a measurement
    simulated = replace(report.validation, about={**report.validation.about, "kind": "simulation"})
    noted = replace(report, validation=simulated, notes=("no --scenario given",), figures=())
    other = written(tmp_path, noted)
    assert line in other
    assert "No --scenario given." in other
    assert other.index('id="motion"') < other.index("Warnings of the run")
    assert "no --scenario given" in json.loads((tmp_path / "report.json").read_text("utf-8"))["notes"]


def test_least_report(outcome: Validation, tmp_path: Path) -> None:
    """A comparison alone makes a report: no figures, machine, parameters or card are needed."""
    page = written(tmp_path, Report("Bare", outcome))
    assert "<code>shaft.<wbr>angle</code>" in page, "a name that may break after its dot"
    assert "<script" not in page


def test_stays_small_for_a_long_run(report: Report, tmp_path: Path) -> None:
    """Three actuators over 60 s at 1 ms, every sample noisy, stay under 3 MB."""
    t = np.arange(60_001) * 1e-3
    noise = np.random.default_rng(0).standard_normal((2, len(t)))
    row = replace(report.validation.rows[0], time=t, simulation=noise[0], reference=noise[1])
    rows = tuple(replace(row, signal=f"s{k}") for k in range(15))
    panels = [PanelSpec(f"Row {k % 5}", (f"s{k}",)) for k in range(15)]
    specs = [FigureSpec(f"Figure {n}", tuple(panels[5 * n : 5 * n + 5])) for n in range(3)]
    outcome = replace(report.validation, rows=rows, window=(0.0, 60.0))
    big = Report("Long", outcome, figures=specs)
    assert write_report(tmp_path / "report.html", big)[0].stat().st_size < 3e6


@shards.browser
def test_no_column_is_cut_off_in_a_browser(report: Report, tmp_path: Path, chromium: Any) -> None:
    """At 1100 pixels the table of the longest names of the machine fits; a narrower window scrolls it."""
    names = ("boom_stick.boom_head_pressure", "boom_stick.stick_head_pressure")
    rows = tuple(
        replace(row, signal=name, label="Stick head pressure")
        for row, name in zip(report.validation.rows, names, strict=True)
    )
    html, _ = write_report(tmp_path / "wide.html", Report("", replace(report.validation, rows=rows)))
    hidden = "[...document.querySelectorAll('.wide')].map(w => w.scrollWidth - w.clientWidth)"
    for width, fits in ((1100, True), (500, False)):
        page = chromium.new_page(viewport={"width": width, "height": 800})
        page.goto(html.as_uri())
        assert (max(page.evaluate(hidden)) <= 0) == fits
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        page.close()
