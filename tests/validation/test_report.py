"""The report: one file, complete, offline, and the same numbers as JSON."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit import shards
from kit.mistakes import problem, table
from markupsafe import Markup
from matplotlib.figure import Figure
from validation.conftest import Edit

from fmus.machine.build import data
from orchestrator.data.recording import read_recording
from orchestrator.data.trace import Trace
from orchestrator.engine.result import Card
from orchestrator.pages.figures import VENDOR
from orchestrator.pages.plotting import decimate, draw, png, svg
from orchestrator.results.layout import FigureSpec, Layout, PanelSpec, read_layout
from orchestrator.results.validation import Validation, validate
from orchestrator.results.validation_report import traces, validation_report

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


Written = Callable[..., tuple[str, dict[str, Any]]]


@pytest.fixture(scope="module")
def contents(outcome: Validation, trace: Trace) -> dict[str, Any]:
    """A report with everything in it."""
    rows = PanelSpec("Command", ("pump.command",)), PanelSpec("Angle", ("shaft.angle",))
    pressure = (PanelSpec("Pressure", ("pump.pressure",)),)
    pump = {"name": "pump", "file": "pump.fmu", "version": "1.2", "guid": "{1-2-3}", "fmi": "2.0"}
    volume = {"component": "pump", "name": "volume", "value": 1.5e-3, "unit": "m3", "text": "Dead volume"}
    return {
        "title": "Shaft & pump",
        "validation": outcome,
        "figures": (FigureSpec("Shaft", rows), FigureSpec("Pump", pressure, caption="Taken at the <port>.")),
        "trace": trace,
        "run": {
            "facts": {"system": "shaft.ssp", "share": np.float64(0.5), "of": {"stopped": False, "at": None}},
            "components": (pump,),
            "parameters": (volume | {"source": "assumed", "changed": True},),
            "accuracy": Card(
                master="jacobi", step=1e-2, record_step=1e-2, steps=200, simulated=2.0, wall=0.8
            ),
            "warnings": ("pump: pressure above 300 bar at 1.2 s",),
        },
        "machine": Markup("<p>machine</p>"),
    }


@pytest.fixture(scope="module")
def files(contents: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Written:
    """The HTML and the JSON of a report that differs from it."""

    def write(**other: Any) -> tuple[str, dict[str, Any]]:
        folder = tmp_path_factory.mktemp("report")
        files = validation_report(**contents | other).write(folder / "out" / "report.html")
        assert [file.name for file in files] == ["report.html", "report.json"]
        html, numbers = (file.read_text(encoding="utf-8") for file in files)
        return html, json.loads(numbers)

    return write


@pytest.fixture(scope="module")
def page(files: Written) -> str:
    """The written HTML."""
    return files()[0]


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


def test_shows_what_ran_and_how_well(page: str, outcome: Validation) -> None:
    """Signals, units, limits, facts, FMUs, parameters, card and warnings are all in the text."""
    expected = [row.signal for row in outcome.rows]
    expected += ["Shaft &amp; pump", "✓ pass", "max. error ≤ 2 bar", "NRMSE ≤ 1 %", "Shaft &lt;angle&gt;"]
    expected += ["shaft.ssp", "{1-2-3}", "Dead volume", "1 changed for this run", "2.5 times real time"]
    expected += ["pressure above 300 bar", "Taken at the &lt;port&gt;.", "compared at the 201 samples"]
    text = page.replace("<wbr>", "").lower()
    assert [one for one in expected if one.lower() not in text] == []


def test_the_page_answers_first(page: str) -> None:
    """Verdict, the signal that uses most of its limit, and the machine are above all sections."""
    head = page[page.index("<header>") : page.index("</header>")]
    order = [
        "✓ pass",
        "Pass: 2 of 2 signals",
        "Worst signal: pump.<wbr>pressure",
        "Uses 50",
        "<p>machine</p>",
    ]
    places = [head.index(text) for text in order]
    assert places == sorted(places)
    for title in ("Signals", "Run", "Reference"):
        assert f'<details class="folded"><summary><h2>{title}</h2>' in page


def test_json_has_the_same_numbers(files: Written, contents: dict[str, Any]) -> None:
    """report.json holds the exact numbers of the comparison and everything that was handed in."""
    (_, data), validation = files(), contents["validation"]
    assert list(data)[:3] == ["title", "verdict", "passed"]  # as of every command
    assert data["passed"] is True
    assert data["verdict"] == validation.verdict
    for row, stored in zip(validation.rows, data["signals"], strict=True):
        assert (stored["signal"], stored["unit"], stored["passed"]) == (row.signal, row.unit, row.passed)
        for name in ("rmse", "nrmse", "fit", "maximum_error", "vaf"):
            assert stored["metrics"][name] == getattr(row.metrics, name)
    assert data["signals"][1]["tolerance"]["limit"] == 2e5
    assert data["facts"] == contents["run"]["facts"]  # a number of NumPy is one
    assert data["accuracy"]["steps"] == 200
    assert data["parameters"][0]["value"] == 1.5e-3
    assert data["reference"]["file"] == "ref.csv"


def test_a_missed_limit_is_plain_to_see(edited: Edit, trace: Trace, files: Written) -> None:
    """A failed run says so at the top, in the table and in the figure, in words and not by colour alone."""
    failed = validate(trace, read_recording(edited("limit = 2.0", "limit = 0.9")))
    page, data = files(validation=failed)
    expected = ["✗ fail", "1 of 2 signals within their limits", "✗ 1 bar"]
    expected += ['<span class="mark fail">fail</span>', "Uses 111.2 % of its limit"]
    assert [text for text in expected if text not in page] == []
    assert data["passed"] is False


def test_a_simulated_reference_is_told_as_one(page: str, outcome: Validation, files: Written) -> None:
    """What a pass means, only where the reference is a simulation; notes and warnings follow the machine."""
    line = "Reference: a simulation of the same equations."
    assert line not in page  # a measurement
    simulated = replace(outcome, about={**outcome.about, "kind": "simulation"})
    other, data = files(
        validation=simulated, run={"notes": ("no --scenario given",), "warnings": ("hot",)}, figures=()
    )
    assert line in other
    assert "No --scenario given." in other
    assert other.index('id="motion"') < other.index("Warnings of the run")
    assert "no --scenario given" in data["notes"]


def test_least_report(outcome: Validation) -> None:
    """A comparison alone makes a report: no figures, machine, parameters or card are needed."""
    page = validation_report("Bare", outcome).html()
    assert "<code>shaft.<wbr>angle</code>" in page, "a name that may break after its dot"
    assert all(f'id="{name}"' not in page for name in ("motion", "parameters", "warnings-of-the-run"))


def test_stays_small_for_a_long_run(outcome: Validation) -> None:
    """Three actuators over 60 s at 1 ms, every sample noisy, stay under 3 MB."""
    t = np.arange(60_001) * 1e-3
    noise = np.random.default_rng(0).standard_normal((2, len(t)))
    row = replace(outcome.rows[0], time=t, simulation=noise[0], reference=noise[1])
    rows = tuple(replace(row, signal=f"s{k}") for k in range(15))
    panels = [PanelSpec(f"Row {k % 5}", (f"s{k}",)) for k in range(15)]
    specs = [FigureSpec(f"Figure {n}", tuple(panels[5 * n : 5 * n + 5])) for n in range(3)]
    outcome = replace(outcome, rows=rows, window=(0.0, 60.0))
    assert len(validation_report("Long", outcome, figures=specs).html()) < 3e6


@shards.browser
def test_no_column_is_cut_off_in_a_browser(outcome: Validation, tmp_path: Path, chromium: Any) -> None:
    """At 1100 pixels the table of the longest names of the machine fits; a narrower window scrolls it."""
    names = ("boom_stick.boom_head_pressure", "boom_stick.stick_head_pressure")
    rows = tuple(
        replace(row, signal=name, label="Stick head pressure")
        for row, name in zip(outcome.rows, names, strict=True)
    )
    html, _ = validation_report("", replace(outcome, rows=rows)).write(tmp_path / "wide.html")
    hidden = "[...document.querySelectorAll('.wide')].map(w => w.scrollWidth - w.clientWidth)"
    for width, fits in ((1100, True), (500, False)):
        page = chromium.new_page(viewport={"width": width, "height": 800})
        page.goto(html.as_uri())
        page.evaluate("document.querySelectorAll('details').forEach(d => d.open = true)")
        assert (max(page.evaluate(hidden)) <= 0) == fits
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        page.close()


# ---- Figures: nothing lost by decimation, everything drawn that was asked for

ANGLE = FigureSpec("Angle", (PanelSpec("Angle", ("shaft.angle",)),))
COMMAND = PanelSpec("Command", ("pump.command",))
SPEC = FigureSpec("Shaft", (COMMAND, *ANGLE.panels, PanelSpec("Pressure", ("pump.pressure",), ("head",))))
SAMPLES = st.floats(-1e6, 1e6) | st.just(np.nan)


@given(values=st.lists(SAMPLES, min_size=1, max_size=300), buckets=st.integers(1, 40))
def test_decimation_keeps_the_extremes_and_the_ends(values: list[float], buckets: int) -> None:
    """Largest, smallest, first and last sample survive in order, also beside gaps, in the promised number."""
    y = np.array(values)
    t = np.arange(len(y), dtype=float)
    kept_t, kept_y = decimate(t, y, buckets)
    assert len(kept_t) <= 2 * buckets + 2
    if np.isfinite(y).any():
        assert (np.nanmin(kept_y), np.nanmax(kept_y)) == (np.nanmin(y), np.nanmax(y))
    assert (kept_t[0], kept_t[-1]) == (0.0, len(y) - 1.0)
    assert np.all(np.diff(kept_t) > 0)


@pytest.fixture(scope="module")
def figure(outcome: Validation, trace: Trace) -> Figure:
    """The figure of SPEC, drawn."""
    made = draw(traces(SPEC, outcome, trace))
    made.draw_without_rendering()
    return made


def test_panels_and_error_strips(figure: Figure) -> None:
    """A compared signal gets a panel and an error strip in display units, a command its panel only.

    The PNG of the figure for a README is one.
    """
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == ["Command\n[V]", "Angle\n[deg]", "error\n[deg]", "Pressure\n[bar]", "error\n[bar]"]
    assert png(figure, dpi=40).startswith(b"\x89PNG")


def test_signals_that_are_not_judged_have_no_error_strip(edited: Edit, trace: Trace) -> None:
    """Unless the reference states no limits at all: then the errors are what there is to see."""

    def strips(old: str, new: str) -> int:
        judged = validate(trace, read_recording(edited(old, new)))
        return sum("error" in axes.get_ylabel() for axes in draw(traces(SPEC, judged, trace)).axes)

    assert strips('angle = { metric = "nrmse", limit = 0.01 }', 'angle = "none"') == 1
    assert strips('pressure = { metric = "maximum", limit = 2.0 }', 'pressure = "none"') == 2


def test_reference_is_solid_and_simulation_dotted(figure: Figure) -> None:
    """As in the paper: solid line measured, dotted line simulated; the error is simulation - reference."""
    reference, simulation = figure.axes[3].lines
    assert reference.get_linestyle() == "-"
    assert simulation.get_linestyle() != "-"
    # 1 bar put in by the fixture; 12 digits in the CSV
    np.testing.assert_allclose(figure.axes[4].lines[1].get_ydata(), 1.0, rtol=1e-6)


def test_names_and_verdict_stand_at_the_panel(figure: Figure) -> None:
    """The names above it, off the curves; beside them the judged number, its limit and whether it holds."""
    panel = figure.axes[3]
    assert panel.get_legend().get_window_extent().y0 >= panel.get_window_extent().y1
    assert [text.get_text() for text in panel.texts] == ["✓ head 1 bar\nmax. error ≤ 2 bar"]


def test_unknown_signal_is_refused(outcome: Validation, trace: Trace) -> None:
    """The message contains the figure and its unknown signal."""
    spec = FigureSpec("Shaft", (PanelSpec("Angle", ("shaft.angel",)),))
    expected = "figure 'Shaft': expected a signal of the comparison or of the run, got 'shaft.angel'"
    assert expected in problem(lambda: traces(spec, outcome, trace))


def test_a_drawn_figure_is_reproducible(outcome, trace) -> None:
    """Drawn twice it is the same SVG, so that a file changes only when its numbers do."""
    one, other = (svg(draw(traces(ANGLE, outcome, trace))) for _ in range(2))
    assert one == other
    assert ">Angle<" in one  # text as text


# ---- Layouts: what a report shows, read from a file

LAYOUT = Path(__file__).with_name("layout.toml").read_text(encoding="utf-8")


def layout_file(folder: Path, text: str) -> Path:
    path = folder / "l.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_all_that_a_layout_holds(tmp_path: Path, trace: Trace) -> None:
    """Title and figures with their panels come out as they were written."""
    layout = read_layout(layout_file(tmp_path, LAYOUT))
    panels = (
        PanelSpec("Angle", ("shaft.angle",)),
        PanelSpec("Pressures", ("pump.pressure", "pump.command"), ("p", "u")),
    )
    assert (layout.title, layout.figures) == ("Shaft", (FigureSpec("Turning", panels, "of the shaft"),))
    layout.check(trace)


def test_an_empty_file_and_the_projects_own_are_layouts(tmp_path: Path, trace: Trace) -> None:
    """Nothing is needed; the project has one figure per actuator with five rows."""
    layout = read_layout(layout_file(tmp_path, ""))
    assert layout == Layout(source=layout.source)
    layout.check(trace)
    layout = read_layout(data("reference/work_cycle.layout.toml"))
    assert [len(figure.panels) for figure in layout.figures] == [5, 5, 5]


def test_what_a_run_lacks_can_be_left_out(tmp_path: Path, trace: Trace) -> None:
    """Signals with their names, rows and figures without signals."""
    layout = read_layout(layout_file(tmp_path, LAYOUT))
    assert layout.within(trace) == layout
    kept = layout.within(trace.select(["pump.command"]))
    assert [f.panels for f in kept.figures] == [(PanelSpec("Pressures", ("pump.command",), ("u",)),)]
    assert layout.within(trace.select([])).figures == ()


@table(__file__, "lacking", "old, new, expected")
def test_a_signal_that_the_run_lacks_is_named(tmp_path, trace, old: str, new: str, expected: str) -> None:
    """With the file, the place and what it could be."""
    path = layout_file(tmp_path, LAYOUT.replace(old, new, 1))
    assert f"l.toml: {expected}" in problem(lambda: read_layout(path).check(trace))


@table(__file__, "mistakes", "text, expected")
def test_mistakes_name_file_place_and_what_was_expected(tmp_path: Path, text: str, expected: str) -> None:
    """A wrong layout is refused when it is read, before anything runs."""
    path = layout_file(tmp_path, text)
    line = problem(lambda: read_layout(path))
    assert line.startswith(f"{path}: ")
    assert expected in line


def test_a_missing_file_and_a_folder_are_told(tmp_path: Path) -> None:
    """As what they are."""
    problem(lambda: read_layout(tmp_path / "none.toml"), r"none.toml: no such file")
    problem(lambda: read_layout(tmp_path), "expected a file, got a folder")
