"""Figures of procedures, of comparisons and of correlations."""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from identification.report.samples import panel, residual, result
from matplotlib.image import imread

from fmus.identification.report import figures, report_texts
from fmus.identification.report.figures import draw_procedure, joint_figure, opening_panel
from fmus.identification.report.identification_page import _joints
from fmus.identification.report.prediction import RecordingComparison, nrmse
from fmus.identification.results import Curve, Estimate, Panel
from orchestrator.data.recording import Recording
from orchestrator.pages import plotting
from orchestrator.pages.figures import plot

TIME = np.arange(0.0, 5.0, 0.005)


def drawn(*panels, **more):
    """The axes of a figure with these panels, residuals among them."""
    return draw_procedure(result(panels=panels, **more), ["simulation"])


def test_a_residual_is_below_its_panel_over_the_same_axis():
    """Panels over the same quantity share their x axis, the lowest one labels it; zero is in the middle."""
    top, below = drawn(panel(), residual()).axes
    top.set_xlim(1, 2)
    assert below.get_xlim() == (1, 2)
    assert (top.get_xlabel(), below.get_xlabel()) == ("", "flow [L/min]")
    assert top.get_position().y0 > below.get_position().y1
    low, high = below.get_ylim()
    # exact identity: rounding only
    assert low == pytest.approx(-high)


def test_values_are_shown_in_the_units_of_the_panel():
    """SI inside, L/min and bar on the axes."""
    axes = drawn(panel()).axes[0]
    fit = next(line for line in axes.lines if line.get_label() == "eq. (1)")
    # exact identity: rounding only
    np.testing.assert_allclose(fit.get_xdata(), np.linspace(12, 120, 30))
    np.testing.assert_allclose(fit.get_ydata()[-1], 4.0)
    assert axes.get_ylabel() == "pressure drop [bar]"


def looks(axes):
    """Mark, line, dashes and filling of each curve, without its colour."""
    handles, _ = axes.get_legend_handles_labels()
    lines = [handle[0] if isinstance(handle, tuple) else handle for handle in handles]
    # the pattern of a line is its linestyle with its dashes
    return {
        (x.get_marker(), x.get_linestyle(), str(x._dash_pattern), x.get_markerfacecolor() == "none")
        for x in lines
    }


def test_tables_of_openings_are_drawn_with_their_intervals():
    """Edges with the same table share a curve, with bars to the ends of the intervals; else no panel."""

    def table(edge, *openings):
        for kind, unit in (("command", "V"), ("opening", "1")):
            for k, y in enumerate(openings, 1):
                ends = (2.0 * k,) * 3 if unit == "V" else (y, y - 0.1, y + 0.3)
                stem = f"valve_{edge}_{kind}"
                yield Estimate(f"{stem}_{k}", ends[0], unit, 0.1, *ends[1:], "", f"{stem}s")

    drawn_panel = opening_panel([*table("pa", 0.2, 1.0), *table("bt", 0.2, 1.0), *table("at", 0.3, 0.9)])
    assert [curve.label for curve in drawn_panel.curves] == ["P-A, B-T", "A-T"]
    (axes,) = drawn(drawn_panel).axes
    first, _ = (np.concatenate(bars.get_segments()) for bars in axes.collections)
    # exact identity: rounding only
    assert {(x, round(y, 9)) for x, y in first} == {(2, 0.1), (2, 0.5), (4, 0.9), (4, 1.3)}
    empty = [replace(e, value=0.0) for e in table("pa", 1.0)]
    assert opening_panel(empty) is None


def test_curves_differ_without_colour():
    """Each kind of curve, and each of several compared ones, differs in mark, line or filling.

    Of two lines the measurement is broad and solid, the fit thin and dotted.
    """
    laws = (
        tuple(Curve(f"law {k}", TIME, k + TIME, "compared", line=joined) for k in range(4))
        for joined in (True, False)
    )
    for shown in (panel(), *(Panel("x", "y", curves) for curves in laws)):
        assert len(looks(drawn(shown).axes[0])) == len(shown.curves)
    curves = (Curve("m", TIME, np.sin(TIME), line=True), Curve("f", TIME, np.cos(TIME), "fit", line=True))
    measured, fit = drawn(Panel("time", "x", curves)).axes[0].lines
    assert measured.get_linewidth() > 1.5 * fit.get_linewidth()
    assert (measured.get_linestyle(), fit.get_linestyle()) == ("-", "--")


def test_panels_have_columns_and_nothing_is_cut_off():
    """Another quantity has a column of its own, many panels over one have two; all labels are inside."""
    figure = drawn(panel(), residual(), replace(panel(), x_label="time", log=True))
    left, _, right = figure.axes
    assert right.get_position().x0 > left.get_position().x1
    plotting.png(figure)
    for axes in figure.axes:
        box = axes.get_tightbbox(figure.canvas.get_renderer()).transformed(figure.transFigure.inverted())
        assert min(box.x0, box.y0) > -1e-3
        assert max(box.x1, box.y1) < 1 + 1e-3
    axes = drawn(panel(), panel(), panel(), residual()).axes
    assert len({round(a.get_position().x0, 2) for a in axes}) == 2
    axes[0].set_xlim(3, 4)
    assert {a.get_xlim() for a in axes} == {(3, 4)}


def test_figures_are_small_reproducible_and_crisp():
    """50 000 points are a bitmap in the SVG, which is the same twice; a PNG has more pixels than shown."""
    many = np.random.default_rng(0).standard_normal((2, 50_000))
    cloud = Panel("x", "y", (Curve("measured", *many),))
    assert len(plotting.svg(drawn(cloud))) < plotting.SVG_LIMIT
    one, other = (plotting.svg(draw_procedure(result())) for _ in range(2))
    assert one == other
    assert imread(io.BytesIO(plotting.png(draw_procedure(result())))).shape[1] > 1000


def test_a_figure_says_whether_its_data_are_simulated():
    """The origin is in the figure and in its caption, with the paper's figure."""
    assert "not FERIC data" in plotting.svg(drawn(panel()))
    caption = report_texts.caption(result(), ["simulation", "simulation"])
    assert caption.lower().count("simulated data (virtual test rig), not feric data") == 1
    assert caption.count("Simulated data (virtual test rig), not FERIC data.") == 1  # it begins a sentence
    assert "Fig. 6 of the paper" in caption
    caption = report_texts.caption(result(figure=0), ["measurement"])
    assert "imulated" not in caption
    assert "Fig." not in caption
    assert "Measured data." in caption


def comparison(measured, predicted):
    """A recording of the swing next to its prediction."""
    units = {"swing.swing_command": "V", "manipulator.swing_angle": "rad", "swing.swing_pressure_a": "Pa"}
    units |= {"swing.swing_flow_a": "m3/s", "manipulator.swing_speed": "rad/s"}
    about = {"title": "A", "procedure": "machine", "use": "test", "kind": "simulation"}
    recording = Recording(TIME, measured, units, Path("a.csv"), **about)
    return RecordingComparison(recording, measured, predicted, units)


def test_traces_have_their_residual_below():
    """A predicted signal has a strip with measured - predicted in its unit; a command has no strip."""
    pressure = 1e7 + 1e6 * np.sin(TIME)  # with a prediction that is 1 % of its range off
    measured = {"swing.swing_command": TIME, "swing.swing_pressure_a": pressure}
    predicted = {"swing.swing_pressure_a": pressure + 2e4 * np.cos(9 * TIME)}
    drawn = plotting.draw(joint_figure(comparison(measured, predicted), "swing"))
    command, pressure, strip = drawn.axes
    assert command.get_ylabel() == "command\n[V]"
    assert pressure.get_ylabel() == "pressure\n[bar]"
    error = strip.lines[-1].get_ydata()
    # 2e4 Pa are 0.2 bar, and the prediction begins above the measurement
    assert np.max(np.abs(error)) == pytest.approx(0.2, rel=1e-3)
    assert error[0] == pytest.approx(-0.2)
    measured, predicted = pressure.lines
    assert (measured.get_linestyle(), predicted.get_linestyle()) == ("-", "--")
    assert [text.get_text() for text in pressure.texts] == ["line A\nNRMSE 0.71 %"]
    assert "cf. Fig. 10" in plotting.svg(drawn)


@pytest.mark.filterwarnings("error")
def test_a_flow_in_the_dead_zone_is_drawn():
    """Always in the dead zone: the panel is empty, without a warning."""
    lost = {"swing.swing_flow_a": np.full(TIME.size, np.nan)}
    drawn = joint_figure(comparison(lost, {"swing.swing_flow_a": TIME}), "swing")
    assert len(plotting.draw(drawn).axes) == 2
    assert "flow into A" in plot(drawn, "Swing")


def test_only_joints_that_move_are_drawn():
    """By a hundredth of a radian from end to end."""
    motion = {f"manipulator.{j}_angle": a * np.sin(TIME) for j, a in (("swing", 0.004), ("stick", 0.006))}
    seen = comparison({}, motion | {"manipulator.boom_angle": 0 * TIME})
    assert [title for title, _, _ in _joints(seen)] == ["Stick"]


def test_nrmse_is_over_the_range():
    """NRMSE is the root mean square residual over the range of the measurement, without gaps."""
    measured = np.array([0.0, 1.0, 2.0, np.nan, 4.0])
    # exact identity: every residual is 0.4, the range is 4
    assert nrmse(measured, measured + 0.4) == pytest.approx(0.1)
    assert nrmse(np.ones(5), np.zeros(5)) is None
    assert nrmse(np.full(5, np.nan), np.zeros(5)) is None
    # one part in a thousand million is rounding of a constant
    assert [nrmse(np.array([0, x]), np.zeros(2)) is None for x in (0.8e-9, 1.2e-9)] == [True, False]


def test_panels_of_measured_signals_and_correlations():
    """A joint without a flow meter has no panel for flow; each pair is drawn once, large ones with value."""
    names = [n for signals in figures.SIGNALS["swing"].values() for n in signals if "flow" not in n]
    drawn = joint_figure(comparison(dict.fromkeys(names[:4], TIME), {}), "swing")
    assert [panel.label for panel in drawn.panels] == ["command", "angle", "speed", "pressure"]
    names = ["a", "b", "c"]
    correlation = np.array([[1.0, 0.9, 0.1], [0.9, 1.0, -0.4], [0.1, -0.4, 1.0]])
    axes = figures.draw_correlation(names, correlation).axes[0]
    assert sorted(t.get_text() for t in axes.texts) == ["0.9", "\N{MINUS SIGN}0.4"]
    assert [t.get_text() for t in axes.get_xticklabels()] == ["a", "b"]
    assert [t.get_text() for t in axes.get_yticklabels()] == ["b", "c"]
