"""All pages in a browser: accessible (WCAG 2.1 AA), usable by keys alone, without requests, with plots."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from identification.report import samples
from kit import shards
from sweep.synthetic import ISHIGAMI, ishigami, results
from view.standin import LONG, URL, started

from fmus.identification.report.identification_page import report as identification
from orchestrator.data.description import Tolerance
from orchestrator.data.recording import Criterion, Recording
from orchestrator.data.trace import Trace
from orchestrator.pages import figures
from orchestrator.pages.figures import TraceFigure, TraceLine, TracePanel, bars, pack, plot, plot_scripts
from orchestrator.pages.plotting import draw
from orchestrator.results.comparison import compare
from orchestrator.results.comparison_report import report as comparison
from orchestrator.results.diagnosis import Diagnosis, Finding
from orchestrator.results.layout import FigureSpec, PanelSpec
from orchestrator.results.validation import validate
from orchestrator.results.validation_report import validation_report
from orchestrator.studies.analysis.analyse import analyse
from orchestrator.studies.convergence.convergence_report import report as converged_report
from orchestrator.studies.convergence.convergence_study import (
    ConvergenceStudy,
    SettingRun,
    as_reference,
    choose,
)
from orchestrator.studies.study_page import study_report

pytestmark = shards.browser

RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"]
TIME = np.linspace(0.0, 4.0, 801)
LIMIT, ABOUT = Tolerance("nrmse", 0.05), {"kind": "simulation"}
PLOT = "() => document.querySelector('.plot').plot"
RANGE, CHARTS = f"{PLOT}.range", f"{PLOT}.charts.map(({{plot}}) => plot.%s)"


def run(offset: float) -> Trace:
    """Angle and pressure over 4 s."""
    pressure = 1e7 + 1e6 * np.cos(9 * TIME) + 1e5 * offset
    signals = {"arm.angle": np.sin(TIME) + offset, "pump.pressure": pressure}
    return Trace(TIME, signals, {"arm.angle": "rad", "pump.pressure": "Pa"})


def validated() -> str:
    """A report with everything on it."""
    known = run(0.0)
    criteria = {name: Criterion(tolerance=LIMIT, group=name.partition(".")[2]) for name in known.signals}
    about = {"criteria": criteria, "metadata": ABOUT}
    reference = Recording(TIME, known.signals, known.units, Path("ref.csv"), **about)
    panels = PanelSpec("Angle", ("arm.angle",)), PanelSpec("Pressure", ("pump.pressure",), ("head",))
    spec = FigureSpec("Arm", panels)
    checked = validate(run(0.01), reference)
    return validation_report("Arm", checked, (spec,), run(0.01), {"facts": {"step [s]": 0.001}}).html()


def studied() -> str:
    """A study with bands over time."""
    found = results(ishigami, ISHIGAMI, "saltelli", 32)
    return study_report(found, analyse(found)).html()


def diagnosed() -> str:
    """A diagnosis with a fault, its interval and what it is in a healthy machine."""
    state = np.where(TIME > 2, 1.0, np.where(TIME > 1, 0.0, -1.0))
    leak = Finding("leak", "Leakage", "m2", "hose", TIME, 1e-6 * TIME, np.full_like(TIME, 1e-7), state)
    return Diagnosis("monday.csv", [leak], None, ()).report().html()


def identified() -> str:
    """An identification with a figure and a warning."""
    figures = (("Swing", samples.traces(), "Measured."),)
    return identification(samples.page(figures=figures, warnings=("At a bound.",))).html()


def converged() -> str:
    """Two settings at three steps, whose errors are known; the coarsest one is unstable."""
    known = run(0.0)
    reference = as_reference(Recording(TIME, known.signals, known.units, Path("ref.csv")), quantities=())
    errors = {step: validate(run(2e4 * step**2), reference) for step in (1e-3, 2e-3, 1e-2)}
    runs = [
        SettingRun(setting, step, found, round(4.0 / step), 4.0, (1e-5 / step,))
        for setting in choose(["hermite", "jacobi order 0"])[-5:]
        for step, found in errors.items()
    ]
    return converged_report(ConvergenceStudy(reference, tuple(runs))).html()


PAGES: dict[str, Callable[[], str]] = {
    "report": validated,
    "comparison": lambda: comparison(
        compare({"usual": run(0.0), "other": run(0.01), "third": run(0.02)})
    ).html(),
    "study": studied,
    "convergence": converged,
    "diagnosis": diagnosed,
    "identification": identified,
}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], str]:
    """Address of a page on disk, made once."""
    folder = tmp_path_factory.mktemp("pages")

    def address(name: str) -> str:
        file = folder / f"{name}.html"
        if not file.exists():
            file.write_text(PAGES[name](), encoding="utf-8")
        return file.as_uri()

    return address


@pytest.fixture(scope="module")
def view(fmu_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of the operator's page, served by another process."""
    with started(fmu_dir, tmp_path_factory.mktemp("results")) as (_, said):
        yield said[URL]


@pytest.fixture
def opened(chromium: Any) -> Iterator[Callable[..., Any]]:
    """Opens a page in a window of its own; complaints and requests of the page are kept."""
    contexts = []

    def opening(address: str, scheme: str = "light", width: int = 1100) -> Any:
        context = chromium.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(1e3 * LONG)
        page.asked, page.complaints = [], []
        page.on("request", lambda request: page.asked.append(request.url))
        page.on("pageerror", lambda error: page.complaints.append(str(error)))
        page.goto(address)
        return page

    yield opening
    for context in contexts:
        context.close()


def drawn(page: Any) -> None:
    """Wait for all plots, each unfolded and scrolled into view."""
    page.evaluate("document.querySelectorAll('details:has(.plot)').forEach(d => d.open = true)")
    for host in page.locator(".plot").all():
        host.scroll_into_view_if_needed()
        host.locator(".live canvas").first.wait_for()
    every = "every(h => h.classList.contains('drawn'))"
    page.wait_for_function(f"() => [...document.querySelectorAll('.plot')].{every}")


def violations(page: Any) -> list[str]:
    """What axe-core finds: rule and element."""
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(page, options={"runOnly": RULES}).response["violations"]
    return [f"{v['id']}: {node['html'][:200]}" for v in found for node in v["nodes"]]


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_accessible_and_asks_for_nothing(name: str, scheme: str, files: Any, opened: Any) -> None:
    """No violation of WCAG 2.1 AA by axe-core, all details open; no error, no request but for the file."""
    page = opened(files(name), scheme)
    drawn(page)
    page.evaluate("document.querySelectorAll('details').forEach(d => d.open = true)")
    assert violations(page) == []
    assert page.complaints == []
    assert [url for url in page.asked if not url.startswith("data:")] == [files(name)]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_operators_page_is_accessible(scheme: str, view: str, opened: Callable[..., Any]) -> None:
    """No violation by axe-core: the page, its task, and its dialogs, one after the other."""
    page = opened(view, scheme)
    page.locator(".hm-gauge").first.wait_for()
    page.wait_for_function("() => document.querySelector('.hm-foot').innerText.includes('running')")
    assert violations(page) == []
    page.get_by_role("button", name="Training task").click()
    page.get_by_text("pick: ").wait_for()
    assert violations(page) == []
    for name, text in (("Keys", "the machine rests without it"), ("Machine", "Pose"), ("Replay", "Replay")):
        page.locator(".hm-bar").get_by_role("button", name=name, exact=True).click()
        page.locator("dialog[open]").get_by_text(text).first.wait_for()
        assert violations(page) == []
        page.keyboard.press("Escape")


@pytest.mark.parametrize("width", [420, 1100, 1400])
@pytest.mark.parametrize("name", PAGES)
def test_a_page_fits_into_the_window(name: str, width: int, files: Any, opened: Any) -> None:
    """Nothing is wider than the window but tables, which scroll in themselves."""
    page = opened(files(name), width=width)
    drawn(page)
    assert page.evaluate("document.documentElement.scrollWidth") <= width


@pytest.mark.parametrize("name", ["diagnosis", "study"])
def test_tables_of_texts_are_read_on_a_phone(name: str, files: Any, opened: Any) -> None:
    """At 390 px each cell has a line with the head of its column, and nothing of it is scrolled sideways."""
    page = opened(files(name), width=390)
    page.evaluate("document.querySelectorAll('details').forEach(d => d.open = true)")
    hidden = "[...document.querySelectorAll('.stack')].map(t => t.scrollWidth - t.clientWidth)"
    assert max(page.evaluate(hidden)) <= 0
    cells = "[...document.querySelectorAll('.stack td + td')].filter(t => t.textContent)"
    head = "t.closest('table').rows[0].cells[t.cellIndex].textContent"
    shown = page.evaluate(f"{cells}.map(t => [{head}, getComputedStyle(t, '::before').content])")
    assert shown
    assert [(head, content) for head, content in shown if head not in content] == []


@pytest.mark.parametrize("width", [360, 420, 1100])
def test_the_operators_page_fits_into_the_window(width: int, view: str, opened: Callable[..., Any]) -> None:
    """Sticks, their labels and the status line lie inside the window."""
    page = opened(view, width=width)
    page.locator(".hm-gauge").first.wait_for()
    page.wait_for_function("() => document.querySelector('.hm-foot').innerText.includes('load')")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    outside = """() => [
      ...document.querySelectorAll('.hm-stick text, .hm-foot span, .hm-hands button, .hm-bar button')]
      .filter(e => e.getBoundingClientRect().left < 0 || e.getBoundingClientRect().right > innerWidth)
      .map(e => e.textContent)"""
    assert page.evaluate(outside) == []


def test_the_picture_follows_the_theme(view: str, opened: Callable[..., Any]) -> None:
    """In a dark browser the picture is dark, too, and the toolbar has a contrast of 4.5 : 1 (WCAG AA)."""
    page = opened(view, "dark")
    page.locator(".hm-stage canvas").wait_for()
    assert page.evaluate("document.querySelector('.harvester-machine').machine.scene.scheme") == "dark"
    parts = "getComputedStyle(document.querySelector('%s')).%s.match(/[0-9.]+/g).slice(0, 3).map(Number)"
    asked = (".hm-bar button", "color"), (".hm-bar button", "backgroundColor")
    colours = [page.evaluate(parts % names) for names in asked]
    ink, ground = (luminance(colour) for colour in colours)
    assert (ink + 0.05) / (ground + 0.05) > 4.5


def luminance(colour: list[float]) -> float:
    """Relative luminance of an sRGB colour, 0 to 1 (WCAG 2.1)."""
    parts = [c / 255 for c in colour]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return float(np.dot((0.2126, 0.7152, 0.0722), linear))


def test_every_colour_has_contrast() -> None:
    """Curves have 3 : 1 with a white page, text 4.5 : 1 (WCAG 2.1, 1.4.11 and 1.4.3)."""
    for name, colour in figures.PALETTE.variables().items():
        contrast = 1.05 / (luminance([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) + 0.05)
        limit = {"grid": 1.0, "ink": 4.5, "soft": 4.5, "good": 4.5, "bad": 4.5}.get(name, 3.0)
        assert contrast >= limit, f"{name}: {contrast:.2f}"


def test_a_plot_is_zoomed_by_keys(files: Callable[[str], str], opened: Callable[..., Any]) -> None:
    """Tab reaches skip link and toolbar; buttons zoom, shift, reset and hide a curve; the slider reads."""
    page = opened(files("report"))
    drawn(page)
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.className") == "skip"
    page.keyboard.press("Enter")
    for _ in range(40):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.getAttribute('aria-label')") == "Zoom in":
            break
    page.keyboard.press("Enter")
    # of 0 to 4 s the middle half; samples are rounded to a millionth of the range
    assert page.evaluate(RANGE) == pytest.approx([1.0, 3.0], abs=1e-5)
    for _ in range(3):
        page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    assert page.evaluate(RANGE) == pytest.approx([1.5, 3.5], abs=1e-5)
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    assert page.evaluate(RANGE) == pytest.approx([0.0, 4.0], abs=1e-5)
    page.keyboard.press("Tab")
    page.keyboard.press("End")
    assert page.locator(".plot .clock").first.text_content() == "t = 4.000 s"
    read = page.locator(".plot .values").first.text_content()
    number = re.findall(r"reference (\S+);", read)[0].replace("\N{MINUS SIGN}", "-")
    # four digits are printed
    assert float(number) == pytest.approx(np.degrees(np.sin(4.0)), 1e-3)
    page.keyboard.press("Tab")
    page.keyboard.press("Space")
    assert page.evaluate(CHARTS % "series.slice(1).map(s => s.show)")[0] == [False, True]


def test_a_plot_is_zoomed_by_the_mouse(files: Callable[[str], str], opened: Callable[..., Any]) -> None:
    """Dragging over a panel zooms all panels of the figure; a double click resets them."""
    page = opened(files("report"))
    drawn(page)
    over = page.locator(".plot .u-over").first
    over.scroll_into_view_if_needed()
    box = over.bounding_box()
    page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 20)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 20, steps=5)
    page.mouse.up()
    # a pixel of some 900 is 4 ms
    assert page.evaluate(RANGE) == pytest.approx([1.0, 2.0], abs=0.02)
    scales = page.evaluate(CHARTS % "scales.x.min")
    assert scales == pytest.approx([page.evaluate(RANGE)[0]] * len(scales))
    over.dblclick()
    assert page.evaluate(RANGE) == pytest.approx([0.0, 4.0], abs=1e-5)


def test_paper_has_the_plots(files: Callable[[str], str], opened: Callable[..., Any]) -> None:
    """Printed from a dark screen nothing is light, and what only a screen can use is not there."""
    page = opened(files("report"), "dark")
    drawn(page)
    light = """() => { const c = document.querySelector('.live canvas'), data = c.getContext('2d')
      .getImageData(0, 0, c.width, c.height).data, seen = [];
      for (let k = 0; k < data.length; k += 4) if (data[k + 3] === 255) seen.push(data[k]);
      return seen.filter(red => red > 226).length; }"""
    # labels of axes are #e8eaed on a dark screen; on paper the grid is #dfe2e6
    before = page.evaluate(light)
    page.emulate_media(media="print")
    # all but a few pixels of two curves on each other
    page.wait_for_function(f"({light})() < {before / 10}")
    assert page.evaluate("getComputedStyle(document.querySelector('.tools input')).display") == "none"


def test_without_scripts_a_figure_is_a_table(files: Callable[[str], str], chromium: Any) -> None:
    """Of the extremes of each curve."""
    context = chromium.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(files("comparison"))
    page.get_by_text("Extremes of").first.click()
    assert page.locator(".plot table").first.is_visible()
    context.close()


def shown_alone(figure: TraceFigure, folder: Path, opened: Callable[..., Any]) -> Any:
    """A page of a phone's width with one figure, drawn."""
    file = folder / "one.html"
    file.write_text(f"<!doctype html><meta charset=utf-8>{plot(figure, 'One')}{plot_scripts()}", "utf-8")
    page = opened(file.as_uri(), width=360)
    drawn(page)
    return page


@pytest.mark.parametrize(
    ("steps", "labels", "reach"),
    [
        ([3.0], ["2.8", "3", "3.2"], "2.688 to 3.348"),  # log10(3) and a tenth of it on both sides
        ([3.0, 4.0], ["3", "3.5", "4"], "2.983 to 4.023"),  # log10 of 3 and 4, and 2 % of the length
        ([1.0, 10.0], ["1", "2", "5", "10"], "0.955 to 10.47"),
    ],
)
def test_a_short_logarithmic_axis_has_labels(steps, labels, reach, tmp_path, opened) -> None:
    """Round values if fewer than two of 1, 2, 5 are inside; the range of values; a cross in the key."""
    style = {"color": "#000000", "marker": "x"}
    line = TraceLine(np.log10(steps), np.ones(len(steps)), style, key="unstable")
    ticks = {k + float(np.log10(m)): f"{m * 10.0**k:g}" for k in (-1, 0, 1) for m in (1, 2, 5)}
    figure = TraceFigure([TracePanel("", [line])], axis="step [ms]", ticks=ticks, key=[("unstable", style)])
    page = shown_alone(figure, tmp_path, opened)
    assert page.evaluate(CHARTS % "axes[0]._values")[0] == labels
    assert page.locator(".clock").text_content() == reach
    assert page.locator(".curve path").get_attribute("d") == "M10 1L16 7M10 7L16 1"
    assert {text.get_text() for text in draw(figure).axes[0].get_xticklabels()} & set(labels)


@pytest.mark.parametrize("word", ["short", "boom_stick.coulomb_friction_of_the_piston\n(times its value)"])
def test_words_leave_room_for_their_bars(word: str, tmp_path: Path, opened: Callable[..., Any]) -> None:
    """At most 45 % of the width; each line of a longer label is cut there and whole in the tooltip."""
    panel = TracePanel("", [bars([(0.0, 0.0, 1.0)], 0.4, "#000000")], words={0.0: word})
    page = shown_alone(TraceFigure([panel], (0.0, 1.0), axis="share"), tmp_path, opened)
    width = page.locator(".live").evaluate("e => e.clientWidth")
    assert page.evaluate(CHARTS % "axes[1]._size")[0] <= np.ceil(0.45 * width)  # whole pixels
    (label,) = page.evaluate(CHARTS % "axes[1]._values")[0]
    assert (label == word) == (word == "short")
    lines = zip(label.split("\n"), word.split("\n"), strict=True)
    assert all(whole.startswith(line.removesuffix("…")) for line, whole in lines)
    assert page.locator(".u-axis").nth(1).get_attribute("title") == word.replace("\n", " ")


def test_samples_survive_packing(files: Callable[[str], str], opened: Callable[..., Any]) -> None:
    """The browser has the samples of the run, within a millionth of their range; gaps stay gaps."""
    page = opened(files("identification"))
    drawn(page)
    own = "[...document.querySelectorAll('.plot')].find(h => !h.plot.spec.axis).plot"
    data = page.evaluate(f"() => {own}.charts[0].plot.data")
    line = samples.traces().panels[0].lines[0]
    assert data[0] == pytest.approx(line.time, abs=2e-6 * 5)
    got = np.array([np.nan if v is None else v for v in data[1]])
    assert np.array_equal(np.isnan(got), np.isnan(line.values))
    np.testing.assert_allclose(got, line.values, atol=2e-6 * np.nanmax(line.values))


def test_packing_is_compact_and_exact_at_the_ends() -> None:
    """A ramp of 2000 samples takes less than one byte each; least and largest value are exact."""
    packed = pack([np.linspace(-3.0, 7.0, 2000)])
    assert len(packed["data"]) < 2000
    ((count, low, step),) = packed["columns"]
    assert (count, low) == (2000, -3.0)
    # the largest place but the one for NaN; rounding only
    assert low + (2**figures.DIGITS - 2) * step == pytest.approx(7.0, rel=1e-12)


def test_a_long_run_keeps_its_peaks() -> None:
    """Of 60 001 samples at most 2500 are embedded, with the spike of one of them."""
    time = np.linspace(0.0, 60.0, 60_001)
    spike = np.zeros(time.size)
    spike[31_234] = 5.0
    figure = TraceFigure([TracePanel("bar", [TraceLine(time, spike, {"color": "#000000"})])])
    spec = json.loads(re.search(r'json">(.*?)</script>', str(plot(figure, "Spike")), re.DOTALL)[1])
    ((count, *_), (_, low, step)) = spec["columns"]
    assert count <= figures.SAMPLES + 2
    assert low + (2**figures.DIGITS - 2) * step == pytest.approx(5.0)
    assert '<td class="n">5</td><td class="n">31.23</td>' in str(plot(figure, "Spike"))


def test_vendored_files_are_those_of_their_authors() -> None:
    """Each file has the hash in the table, and each file is in the table."""
    folder = figures.VENDOR.parent
    table = (folder / "README.md").read_text(encoding="utf-8")
    listed = dict(re.findall(r"^\| (\S+/\S+) \|.*\| ([0-9a-f]{64}) \|$", table, re.MULTILINE))
    inside = (f for f in folder.rglob("*") if f.is_file() and f.parent != folder)
    found = {f.relative_to(folder).as_posix(): f for f in inside}
    assert listed.keys() == found.keys()
    for name, file in found.items():
        assert hashlib.sha256(file.read_bytes()).hexdigest() == listed[name], name
