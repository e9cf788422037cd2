"""Figures of procedures and of comparisons."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from identification.report.samples import panel, residual, result

from fmus.identification.report import figures
from fmus.identification.report.figures import joint_figure, procedure_figures
from fmus.identification.report.identification_page import _joints
from fmus.identification.report.prediction import RecordingComparison, nrmse
from fmus.identification.results import Curve, Panel
from orchestrator.data.recording import Recording
from orchestrator.pages import plotting
from orchestrator.pages.figures import plot

TIME = np.arange(0.0, 5.0, 0.005)


def drawn(*panels):
    """The figures of a procedure with these panels, residuals among them."""
    return procedure_figures(result(panels=panels), ["simulation"])


def spec(figure):
    """What the page's script gets of a figure."""
    text = str(plot(figure, "x"))
    return json.loads(text[text.index("{") : text.index("</script>")])


def test_a_residual_is_the_strip_below_its_panel():
    """In display units; panels over the same quantity are one figure, another quantity has its own."""
    first, second = drawn(panel(), residual(), replace(panel(), x_label="time", log=True))
    (over_flow,) = first.panels
    assert (first.axis, second.axis) == ("flow [L/min]", "time [L/min]")
    assert (over_flow.label, over_flow.unit, over_flow.error_unit) == ("Drop: pressure drop", "bar", "bar")
    measured = next(line for line in over_flow.lines if line.name == "measured")
    # exact identity: 2e-3 m3/s are 120 L/min, and 1e11 (2e-3)^2 Pa are 4 bar
    assert (measured.time[-1], measured.values[-1]) == pytest.approx((120, 4))
    assert measured.error[-1] == pytest.approx(0.12)
    assert over_flow.errors[0].values == pytest.approx(1e-5 * residual().curves[0].y)
    assert second.panels[0].log


def test_the_script_and_matplotlib_draw_marks_error_bars_and_powers_of_ten():
    """Each curve has places of its own; of a logarithmic panel the script gets the logarithms."""
    (figure,) = drawn(replace(panel(), log=True))
    (chart,) = spec(figure)["charts"]
    assert chart["log"] == 1
    low = 0.8 * 1e11 * 2e-4**2 / 1e5  # a mark or the end of a bar, within the range of all
    assert chart["low"] < np.log10(low) + 0.1 < chart["high"]
    by_name = {line["name"]: line for line in chart["lines"]}
    assert {"x", "low", "high", "mark"} <= by_name["measured"].keys()
    assert by_name["masked: dead zone"]["hollow"] == 1
    assert "mark" not in by_name["eq. (1)"]
    axes = plotting.draw(figure).axes[0]
    assert (axes.get_yscale(), axes.get_xlabel()) == ("log", "flow [L/min]")
    assert len(axes.containers) == 1  # the error bars


def test_a_large_cloud_is_thinned():
    """50 000 points: a page keeps enough of them to see the cloud, a file a bitmap of all."""
    cloud = Panel("x", "y", (Curve("measured", *np.random.default_rng(0).standard_normal((2, 50_000))),))
    (figure,) = drawn(cloud)
    assert max(count for count, *_ in spec(figure)["columns"]) == 2000
    assert len(plotting.svg(plotting.draw(figure))) < 700_000


def test_curves_differ_without_colour():
    """Each kind of curve, and each of several measured ones, differs in mark, line or filling."""
    several = Panel("x", "y", tuple(Curve(f"edge {k}", TIME, k + TIME) for k in range(4)))
    for shown in (panel(), several):
        (figure,) = drawn(shown)
        looks = {
            tuple(str(v) for key, v in line.style.items() if key != "color" and not str(v).startswith("#"))
            for line in figure.panels[0].lines
        }
        assert len(looks) == len(shown.curves)


def test_a_figure_says_whether_its_data_are_simulated():
    """The origin is below the figure, with the paper's figure."""
    (figure,) = drawn(panel())
    assert figure.below == "simulated data (virtual test rig), not FERIC data · cf. Fig. 6 of the paper"
    assert figures.footer(0, ["measurement"]) == "measured data"


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


def test_panels_of_measured_signals():
    """A joint without a flow meter has no panel for flow."""
    names = [n for signals in figures.SIGNALS["swing"].values() for n in signals if "flow" not in n]
    drawn = joint_figure(comparison(dict.fromkeys(names[:4], TIME), {}), "swing")
    assert [panel.label for panel in drawn.panels] == ["command", "angle", "speed", "pressure"]
