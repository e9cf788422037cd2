"""Figures: nothing lost by decimation, everything drawn that was asked for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.mistakes import problem
from matplotlib.figure import Figure
from validation.conftest import Edit

from orchestrator.data.recording import read_recording
from orchestrator.data.trace import Trace
from orchestrator.pages import plotting
from orchestrator.pages.plotting import decimate, png, svg
from orchestrator.results.layout import FigureSpec, PanelSpec
from orchestrator.results.validation import Validation, validate
from orchestrator.results.validation_report import draw

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
    made = draw(SPEC, outcome, trace)
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
        judged = validate(trace, read_recording(edited(old, new)), rate=False)
        return sum("error" in axes.get_ylabel() for axes in draw(SPEC, judged, trace).axes)

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
    assert expected in problem(lambda: draw(spec, outcome, trace))


def test_an_embedded_figure_is_reproducible_and_follows_the_page(outcome, trace, monkeypatch) -> None:
    """Drawn twice it is the same SVG, so that a report changes only when its numbers do.

    Inline it has colours by variable, ids of its own and text as text; with too many points it is a picture.
    """
    one, other = (draw(ANGLE, outcome, trace) for _ in range(2))
    assert svg(one) == svg(other)
    text = str(plotting.embed(one, "f7-", "Shaft"))
    assert text.startswith("<svg")
    assert "http" not in text
    inside = ("var(--fig-dark0, #06406b)", 'id="f7-', "url(#f7-", ">Angle<")
    assert [words for words in inside if words not in text] == []
    monkeypatch.setattr(plotting, "SVG_LIMIT", 10)
    text = str(plotting.embed(other, "f-", 'A "title"'))
    assert text.startswith('<img class="paper" alt="A &#34;title&#34;" src="data:image/png;base64,iVBOR')
